"""The text of a certificate for a payload that changes in motion, which `replay_lyapunov` proves again."""

from collections.abc import Iterator, Sequence
from math import isinf

from flint import fmpq_mat

from beamdesign.polynomial import exact
from beamdesign.proof.document import controller_lines, quoted, remarks, rig_lines, sealed
from beamdesign.proof.lyapunov import Switching
from beamdesign.proof.rational import text
from beamdesign.prototype import Prototype

KIND = "beamdesign.switching"
VERSION = 1


def switching_document(prototype: Prototype, found: Switching, summary: str) -> str:
    """Write the certificate: figures, controller, Lyapunov matrices and counterexamples, all in exact decimals.

    Args:
        prototype: whose figures it states.
        found: what was proved and refuted of it.
        summary: the result in words, put on top as a comment.
    """
    low, high = (text(exact(value)) for value in found.outer_end_mass_kg)
    head = [
        *remarks(summary),
        "#",
        "# To prove it again with python-flint alone: python replay_lyapunov.py THIS-FILE",
        "# (beamdesign/proof/replay_lyapunov.py). All numbers are exact: decimals or quotients, as text. P lists the",
        "# matrix coefficients of m^0, m^1, ... by the rows of their lower triangles, for the state",
        f"# ({', '.join(found.family.states)}).",
        "# The checksum is of the text without its own line.",
        "",
        f'kind = "{KIND}"',
        f"version = {VERSION}",
        "",
    ]
    body = [
        f"name = {quoted(prototype.name)}",
        f'low = "{low}"',
        f'high = "{high}"',
        "",
        *rig_lines(prototype),
        *controller_lines(prototype),
        *_claims(found),
        *_counterexamples(found),
    ]
    return sealed(head, body)


def _claims(found: Switching) -> Iterator[str]:
    low, high = (text(exact(value)) for value in found.outer_end_mass_kg)
    common = found.any_change
    if common.function is not None and common.proved_up_to_kg is not None:
        yield "# m may change however fast in this range while v is continuous: V = x' P x falls at both ends."
        yield "[[claim]]"
        yield 'kind = "any_change"'
        yield f'low = "{low}"'
        yield f'high = "{text(exact(common.proved_up_to_kg))}"'
        yield from matrix_lines([common.function])
    for rate in found.rates:
        if rate.status != "proved" or rate.rate_kg_per_s is None or isinf(rate.rate_kg_per_s):
            continue
        yield "# m may change at up to this rate, |dm/dt|: V = x' P(m) x falls."
        yield "[[claim]]"
        yield 'kind = "bounded_rate"'
        yield f'joining = "{rate.joining}"'
        yield f'low = "{low}"'
        yield f'high = "{high}"'
        yield f'rate_kg_per_s = "{text(exact(rate.rate_kg_per_s))}"'
        yield from matrix_lines(rate.coefficients)
    for sudden in found.sudden:
        if sudden.status != "proved" or sudden.dwell_s is None or sudden.dwell_s == 0:
            continue
        yield "# m may jump this often on average: V falls as exp(-2 decay t) and grows at most by factor at a jump."
        yield "[[claim]]"
        yield 'kind = "sudden_change"'
        yield f'joining = "{sudden.joining}"'
        yield f'low = "{low}"'
        yield f'high = "{high}"'
        yield f'dwell_s = "{text(sudden.dwell_s)}"'
        yield f'factor = "{text(sudden.factor)}"'
        yield f'decay_per_s = "{text(sudden.decay_per_s)}"'
        yield from matrix_lines(sudden.coefficients)


def matrix_lines(coefficients: Sequence[fmpq_mat]) -> Iterator[str]:
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
    if found.frozen.unstable_at is not None:
        yield "# A mass that stays, and at which the loop is unstable by Routh's test."
        yield "[[counterexample]]"
        yield 'kind = "frozen"'
        yield f'outer_end_mass_kg = "{text(found.frozen.unstable_at)}"'
        yield ""
    cycle = found.any_change.counterexample
    if cycle is not None and cycle.proved:
        masses, times = (
            [f'"{text(exact(value))}"' for value in pair] for pair in (cycle.outer_end_mass_kg, cycle.time_s)
        )
        yield "# Repeated jumps between two masses, v continuous, under which the motion grows:"
        yield "# |trace M^cycles| exceeds the order of M, the transition matrix of one cycle."
        yield "[[counterexample]]"
        yield 'kind = "cycle"'
        yield f"outer_end_mass_kg = [{', '.join(masses)}]"
        yield f"time_s = [{', '.join(times)}]"
        yield f"cycles = {cycle.cycles}"
        yield ""
