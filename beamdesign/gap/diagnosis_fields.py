"""A diagnosis as plain fields for programs: names and units of its JSON file."""

from typing import Any

from beamdesign.gap.diagnosis import Cause, Diagnosis
from beamdesign.gap.gains.classes import GainDiagnosis
from beamdesign.gap.judgement import judge
from beamdesign.json_text import plain

_LISTED = 12


def diagnosis_fields(found: Diagnosis) -> dict[str, Any]:
    """Everything a diagnosis says, in plain values.

    `effects` come best first; `gap` holds errors over the rms of the signal, on records held out of the fits that
    measure it (those that choose a cause see all); `next_experiment` is None where the verdict is clear.
    """
    fields = {
        "verdict": found.verdict,
        "sentences": found.sentences,
        "effects": [_cause(cause) for cause in found.causes],
        "chosen": found.chosen,
        "probability_unknown": found.probability_unknown,
        "where": found.where,
        "gap": found.gap,
        "classes": found.classes,
        "next_experiment": found.next_experiment,
        "warnings": found.warnings,
        "hypotheses": _hypotheses(found),
        "data_set": found.name,
    }
    if found.separability is not None:
        told = found.separability
        fields["before_fitting"] = {
            "not_told_apart": told.classes,
            "nearly_alike": told.close,
            "not_visible": told.invisible,
        }
    if isinstance(found, GainDiagnosis):
        own = ("notes", "silent", "shares", "factor", "ranked")
        fields |= {name: getattr(found, name) for name in own}
        if found.on_predictions is not None:
            fields["on_predictions"] = diagnosis_fields(found.on_predictions)
    return {name: plain(value) for name, value in fields.items()}


def _cause(cause: Cause) -> dict[str, Any]:
    return {
        "name": cause.name,
        "probability": cause.probability,
        "parameters": cause.parameters,
        "subsystem": cause.subsystem,
        "share": cause.share,
        "flags": cause.flags,
    }


def _hypotheses(found: Diagnosis) -> list[dict[str, Any]]:
    """The most probable of all that were fitted."""
    if found.search is None or isinstance(found, GainDiagnosis):
        return []
    judged = judge(found.search)
    ranked = list(judged.of_causes.items())[:_LISTED]
    return [
        {"names": names, "probability": p, "share_left": found.search.excess(found.search.best_of(names))}
        for names, p in ranked
        if p > 1e-6
    ]
