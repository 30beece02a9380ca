"""What a certificate for a payload or a stage that changes in motion states, as tables of texts."""

from collections.abc import Iterator, Sequence
from math import isinf

from flint import fmpq, fmpq_mat

from beamdesign.polynomial import exact
from beamdesign.proof.courses import Course
from beamdesign.proof.lyapunov import Switching
from beamdesign.proof.rational import text
from beamdesign.proof.rig_tables import Tables, stated, texts
from beamdesign.proof.writer import certificate
from beamdesign.prototype import Prototype

KIND = "beamdesign.stages"


def stages_certificate(prototype: Prototype, found: Switching, summary: str) -> str:
    """Write the certificate: claims with their Lyapunov functions, and counterexamples, all in exact decimals.

    Args:
        prototype: that it is about, with one law or several that act in turn.
        found: what was proved and refuted of it.
        summary: the result in words, put on top as a comment.
    """
    shared = "which all stages share and none resets" if len(found.families) > 1 else "of which only the velocity jumps"
    notes = {
        "claim": "V = x' P(m) x falls. P lists the matrix coefficients of m^0, m^1, ... by the rows of their lower\n"
        f"# triangles, for the state ({', '.join(found.families[0].states)}),\n# {shared}.",
        "counterexample": "An unstable loop that stays; or two in turn, for which |trace M^cycles| exceeds the order of"
        " M, the\n# transition matrix of one cycle.",
    }
    body = {"claim": list(_claims(found)), "counterexample": list(_counterexamples(found))}
    body = {key: entries for key, entries in body.items() if entries}
    masses = {"outer_end_mass_kg": stated(found.outer_end_mass_kg)}
    return certificate(KIND, prototype, masses | body, summary, notes=notes)


def _claims(found: Switching) -> Iterator[Tables]:
    low, high = map(exact, found.outer_end_mass_kg)
    stages, common = found.stages, found.any_change
    if stages.kind == "any_time" and stages.functions:
        yield _claim("stage_change", low, high) | _function(stages.coefficients)
    if stages.kind == "dwell":
        yield _claim("stage_dwell", low, high, **_dwell(stages)) | {"stage": [_function(p) for p in stages.functions]}
    if common.proved_up_to_kg is not None:
        yield _claim("any_change", low, exact(common.proved_up_to_kg)) | _function(common.coefficients)
    for rate in found.rates:
        if rate.status == "proved" and rate.rate_kg_per_s is not None and not isinf(rate.rate_kg_per_s):
            claim = _claim("payload_rate", low, high, rate_kg_per_s=exact(rate.rate_kg_per_s))
            yield claim | {"joining": rate.joining} | _function(rate.coefficients)
    for sudden in found.sudden:
        if sudden.kind == "dwell":
            claim = _claim("payload_jumps", low, high, **_dwell(sudden))
            yield claim | {"joining": sudden.joining} | _function(sudden.coefficients)


def _claim(kind: str, low: fmpq, high: fmpq, **figures: fmpq) -> Tables:
    named = {name: text(value) for name, value in figures.items()}
    return {"kind": kind, "outer_end_mass_kg": texts((low, high))} | named


def _dwell(course: Course) -> dict[str, fmpq]:
    assert course.dwell_s is not None  # it is proved
    return {"dwell_s": course.dwell_s, "factor": course.factor, "decay_per_s": course.decay_per_s}


def _function(coefficients: Sequence[fmpq_mat]) -> Tables:
    """Matrices by the rows of their lower triangles."""
    return {"P": [[texts([p[i, j] for j in range(i + 1)]) for i in range(p.nrows())] for p in coefficients]}


def _counterexamples(found: Switching) -> Iterator[Tables]:
    if found.frozen.unstable_at is not None:
        yield {"kind": "frozen", "stage": found.frozen.stage + 1, "outer_end_mass_kg": text(found.frozen.unstable_at)}
    cycle = found.any_change.counterexample
    if cycle is not None and cycle.proved:
        yield {
            "kind": "cycle",
            "stages": [k + 1 for k in cycle.stages],
            "outer_end_mass_kg": stated(cycle.outer_end_mass_kg),
            "time_s": stated(cycle.time_s),
            "cycles": cycle.cycles,
        }
