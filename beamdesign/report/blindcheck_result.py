"""The result of a blind check as fields for programs and as a page of Markdown."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from math import isfinite
from typing import Any

from beamdesign.gap.baselines import NAMES
from beamdesign.gap.outcome import Outcome
from beamdesign.gap.scoring import SMALL, Bin, Score, baseline_scores, calibration, confusion, scores, split


def result_fields(outcomes: Sequence[Outcome], setting: Mapping[str, Any]) -> dict[str, Any]:
    """Everything that a check has shown.

    Args:
        outcomes: of all cases.
        setting: what the check was: its cases, seed, seal and programs.
    """
    large, small = split(outcomes)
    bins, _ = calibration(large)
    return {
        "setting": dict(setting),
        "scores": [score_fields(s) for s in scores(large)],
        "scores_small_gaps": [score_fields(s) for s in scores(small)] if small else [],
        "baselines": {name: [score_fields(s) for s in baseline_scores(name, large)] for name in NAMES},
        "confusion": confusion(large),
        "confusion_small_gaps": confusion(small),
        "reliability": [asdict(b) for b in bins],
        "cases": [case_fields(o) for o in outcomes],
    }


def score_fields(score: Score) -> dict[str, Any]:
    """One score, rounded, with its target."""
    fields = asdict(score) | {"reached": score.reached}
    return {key: _rounded(value) for key, value in fields.items()}


def case_fields(o: Outcome) -> dict[str, Any]:
    """One case in short."""
    fields: dict[str, Any] = {
        "case": o.key,
        "kind": o.kind,
        "truth": o.effects,
        "gap_over_floor": o.gap_over_floor,
        "verdict": o.verdict,
        "chosen": o.chosen,
        "named": o.named,
        "on_truth": [o.probability.get(name, 0.0) for name in o.effects],
        "no_gap": o.no_gap,
        "unknown": o.unknown,
        "where": o.where,
        "where_truly": o.subsystem,
        "closed": o.closed,
        "interval": o.interval,
        "closed_truly": o.closed_truly,
        "parameter_error": o.parameter_error,
        "seconds": o.seconds,
        "baselines": o.baselines,
    }
    return {key: _rounded(value) for key, value in fields.items()}


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.4g}") if isfinite(value) else None
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    if isinstance(value, Mapping):
        return {key: _rounded(item) for key, item in value.items()}
    return value


def markdown(outcomes: Sequence[Outcome], setting: Mapping[str, Any]) -> str:
    """The same as a page for people."""
    large, small = split(outcomes)
    bins, _ = calibration(large)
    kinds = {kind: sum(o.kind == kind for o in outcomes) for kind in ("null", "single", "parameter", "pair", "outside")}
    parts = [
        "# Blind check of the diagnosis",
        f"{len(outcomes)} cases: {kinds['null']} nulls, {kinds['single']} single effects, {kinds['parameter']} wrong "
        f"figures, {kinds['pair']} pairs, {kinds['outside']} effects outside the library. {setting['records']} "
        "The cases come from a truth model that shares no effect code with the diagnosis; each was diagnosed from its "
        "data alone, in a process that could not read the answers, which had been sealed by their digests before.",
        "\n".join(f"- {words}: {setting[key]}" for key, words in _SETTING.items() if setting.get(key) is not None),
        "## Against the targets",
        f"Nulls, and cases whose gap is at least {SMALL:g} times the noise floor. Bounds are 95 %: Clopper and Pearson "
        "for rates, bootstrap for means and medians.",
        _targets(scores(large)),
        "## Baselines on the same cases",
        _compared(large),
        "## Named first (columns) against the truth (rows)",
        "A `+` marks two effects, by the one with the larger gap.",
        _matrix(confusion(large)),
        "## Probabilities, stated and true",
        _reliability(bins),
    ]
    if small:
        parts += [
            f"## Gaps below {SMALL:g} times the noise floor",
            f"{len(small)} cases.",
            _targets(tuple(s for s in scores(small) if s.of), False),
            _matrix(confusion(small)),
        ]
    return "\n\n".join(parts) + "\n"


_SETTING = {
    "seed": "seed of the plan",
    "seal": "SHA-256 of the seal",
    "truth": "program that drew the cases",
    "fitted_by": "program that made the fits",
    "judged_by": "program that judged",
    "command": "command",
}


def _targets(found: Sequence[Score], with_target: bool = True) -> str:
    rows = []
    for s in found:
        cases = f"{s.count} of {s.of}" if s.count is not None else f"{s.of}"
        bounds = f"{figure(s, s.low)} to {figure(s, s.high)}" if isfinite(s.low) and s.of else ""
        row = (s.name, figure(s, s.value), bounds, cases)
        rows.append((*row, target(s), {True: "yes", False: "no", None: ""}[s.reached]) if with_target else row)
    heads = ("", "found", "95 % bounds", "cases")
    return _table((*heads, "target", "reached") if with_target else heads, rows)


def figure(score: Score, value: float) -> str:
    """A value in the way of its score: rates in percent."""
    if not isfinite(value) or not score.of:
        return "-"
    return f"{value:.1%}" if score.count is not None or score.name.startswith("mean prob") else f"{value:.3g}"


def target(score: Score) -> str:
    """In words; empty without one."""
    if score.target is None:
        return ""
    shown = [f"{t:.0%}" if score.name != "calibration error" else f"{t:g}" for t in score.target]
    return f"{score.sense} {' and '.join(shown)}"


def _compared(outcomes: Sequence[Outcome]) -> str:
    ours = {s.name: s for s in scores(outcomes)}
    others = [{s.name: s for s in baseline_scores(name, outcomes)} for name in NAMES]
    rows = []
    for name in others[0]:
        first = ours.get(name)
        rows.append(
            (name, figure(first, first.value) if first else "", *(figure(o[name], o[name].value) for o in others))
        )
    return _table(("", "diagnosis", *NAMES), rows)


def _matrix(found: Mapping[str, Mapping[str, int]]) -> str:
    columns = sorted({name for row in found.values() for name in row}, key=lambda n: (n.startswith("parameter:"), n))
    rows = [(label, *(str(row[c]) if c in row else "" for c in columns)) for label, row in found.items()]
    return _table(("truth", *columns), rows)


def _reliability(bins: Sequence[Bin]) -> str:
    rows = [(f"{b.low:.0%} to {b.high:.0%}", str(b.count), f"{b.stated:.1%}", f"{b.true:.1%}") for b in bins]
    return _table(("stated", "statements", "mean stated", "true"), rows)


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
