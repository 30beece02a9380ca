"""The text of a certificate for a payload or a stage that changes in motion, proved again by a stand-alone checker.

That of one law is for `replay_lyapunov`, that of several stages for `replay_stages`: they state their laws in different
states and have different words for the same claims.
"""

from collections.abc import Iterator, Mapping, Sequence
from math import isinf
from types import MappingProxyType

from flint import fmpq, fmpq_mat

from beamdesign.polynomial import exact
from beamdesign.proof.document import controller_lines, quoted, remarks, rig_lines, sealed
from beamdesign.proof.lyapunov import Switching
from beamdesign.proof.rational import text
from beamdesign.prototype import Prototype

KIND, STAGES_KIND = "beamdesign.switching", "beamdesign.stages"
VERSION = 1


def switching_document(prototype: Prototype, found: Switching, summary: str) -> str:
    """Write the certificate: figures, laws, Lyapunov matrices and counterexamples, all in exact decimals.

    Args:
        prototype: whose figures it states, with one law or several that act in turn.
        found: what was proved and refuted of it.
        summary: the result in words, put on top as a comment.
    """
    stages = prototype.schedule is not None
    checker = "-m beamdesign.proof.replay_stages" if stages else "beamdesign/proof/replay_lyapunov.py"
    shared = "which all stages share and none resets" if stages else "of which none but the velocity jumps"
    low, high = (text(exact(value)) for value in found.outer_end_mass_kg)
    head = [
        *remarks(summary),
        "#",
        f"# To prove it again with python-flint alone: python {checker} THIS-FILE.",
        "# All numbers are exact: decimals or quotients, as text. P lists the matrix coefficients of m^0, m^1, ... by",
        f"# the rows of their lower triangles, for the state ({', '.join(found.families[0].states)}),",
        f"# {shared}. The checksum is of the text without its own line.",
        "",
        f'kind = "{STAGES_KIND if stages else KIND}"',
        f"version = {VERSION}",
        "",
    ]
    body = [
        f"name = {quoted(prototype.name)}",
        f'low = "{low}"',
        f'high = "{high}"',
        "",
        *rig_lines(prototype),
        *(controller_lines(prototype) if stages else _law_lines(prototype)),
        *_claims(found),
        *_counterexamples(found),
    ]
    return sealed(head, body)


def _law_lines(prototype: Prototype) -> Iterator[str]:
    """The table of the one law; of kinds that the checker does not know by their figures it proves the polynomials."""
    assert prototype.controller is not None  # there is a loop
    known = prototype.controller.kind in ("proportional", "lag")
    for line in controller_lines(prototype):
        stated = known or line.startswith(("#", "[controller]", "numerator", "denominator"))
        yield line if stated or not line else f"# {line}"
        if line == "[controller]" and not known:
            yield 'kind = "transfer_function"'


def _claims(found: Switching) -> Iterator[str]:
    several = len(found.families) > 1
    low, high = map(exact, found.outer_end_mass_kg)
    stages, common = found.stages, found.any_change
    if stages.kind == "any_time" and several:
        yield "# Any stage may act at any time while the payload stays: V = x' P(m) x falls along every stage."
        yield from _claim("any_stage", low, high)
        yield from _matrices(stages.functions[0])
    if stages.kind == "dwell":
        yield "# The stage may change this often on average: V_i = x' P_i(m) x falls as exp(-2 decay t) along stage i"
        yield "# and is at most factor times any other; P lists the functions of the stages, one after another."
        figures = {"dwell_s": stages.dwell_s, "factor": stages.factor, "decay_per_s": stages.decay_per_s}
        yield from _claim("stage_dwell", low, high, figures)
        yield f"degree = {len(stages.functions[0]) - 1}"
        yield from _matrices([p for function in stages.functions for p in function])
    if common.function is not None and common.proved_up_to_kg is not None:
        yield "# m may change however fast in this range while v is continuous: V = x' P x falls at both ends."
        yield from _claim("any_change", low, exact(common.proved_up_to_kg))
        yield from _matrices([common.function])
    for rate in found.rates:
        if rate.status != "proved" or rate.rate_kg_per_s is None or isinf(rate.rate_kg_per_s):
            continue
        yield "# m may change at up to this rate, |dm/dt|: V = x' P(m) x falls."
        kind = "payload_rate" if several else "bounded_rate"
        yield from _claim(kind, low, high, {"rate_kg_per_s": exact(rate.rate_kg_per_s)}, rate.joining)
        yield from _matrices(rate.coefficients)
    for sudden in found.sudden:
        if sudden.status != "proved" or sudden.dwell_s is None or sudden.dwell_s == 0:
            continue
        yield "# m may jump this often on average: V falls as exp(-2 decay t) and grows at most by factor at a jump."
        kind = "payload_jumps" if several else "sudden_change"
        figures = {"dwell_s": sudden.dwell_s, "factor": sudden.factor, "decay_per_s": sudden.decay_per_s}
        yield from _claim(kind, low, high, figures, sudden.joining)
        yield from _matrices(sudden.coefficients)


def _claim(
    kind: str, low: fmpq, high: fmpq, figures: Mapping[str, fmpq] = MappingProxyType({}), joining: str = ""
) -> Iterator[str]:
    yield "[[claim]]"
    yield f'kind = "{kind}"'
    if joining:
        yield f'joining = "{joining}"'
    for name, value in {"low": low, "high": high, **figures}.items():
        yield f'{name} = "{text(value)}"'


def _matrices(coefficients: Sequence[fmpq_mat]) -> Iterator[str]:
    """Matrices by the rows of their lower triangles, under the key P."""
    yield "P = ["
    for matrix in coefficients:
        yield "  ["
        for i in range(matrix.nrows()):
            yield "    [" + ", ".join(f'"{text(matrix[i, j])}"' for j in range(i + 1)) + "],"
        yield "  ],"
    yield "]"
    yield ""


def _counterexamples(found: Switching) -> Iterator[str]:
    if found.frozen.unstable_at is not None and len(found.families) == 1:
        yield "# A mass that stays, and at which the loop is unstable by Routh's test."
        yield "[[counterexample]]"
        yield 'kind = "frozen"'
        yield f'outer_end_mass_kg = "{text(found.frozen.unstable_at)}"'
        yield ""
    cycle = found.any_change.counterexample
    if cycle is None or not cycle.proved:
        return
    masses, times = ([f'"{text(exact(value))}"' for value in pair] for pair in (cycle.outer_end_mass_kg, cycle.time_s))
    yield "# Repeated changes between two masses, v continuous, or two stages, under which the motion grows:"
    yield "# |trace M^cycles| exceeds the order of M, the transition matrix of one cycle."
    yield "[[counterexample]]"
    if cycle.stages[0] != cycle.stages[1]:
        yield 'kind = "stage_cycle"'
        yield f"stages = {list(cycle.stages)}"
        yield f"outer_end_mass_kg = {masses[0]}"
    else:
        yield 'kind = "cycle"'
        if len(found.families) > 1:
            yield f"stage = {cycle.stages[0]}"
        yield f"outer_end_mass_kg = [{', '.join(masses)}]"
    yield f"time_s = [{', '.join(times)}]"
    yield f"cycles = {cycle.cycles}"
    yield ""
