"""Re-prove a certificate about the tip as a port; see `replay.py`, which it builds on.

Nothing here is shared with the programme that wrote the certificate: the loop is rebuilt from the listed figures by the
impedances of its parts, stability is settled by Hurwitz determinants along the edges of the box of end masses and
walls, and inequalities by cutting the frequency axis at their sign changes.

Run as `python -m beamdesign.proof.replay_contact CERTIFICATE`; exit status 0 if it holds, 1 if it does not, 2 if it
cannot be read.
"""

import sys
from collections.abc import Iterator, Sequence
from itertools import pairwise, product
from pathlib import Path
from typing import Any

from flint import fmpq, fmpq_poly

from beamdesign.proof import replay as single
from beamdesign.proof.replay import Family, Malformed, Pair, Replay, S, rational

KIND = "beamdesign.contact"
VERSION = 1
_FIGURES = ("stiffness_N_per_m", "damping_N_s_per_m", "mass_kg")


def replay(source: str | Path) -> Replay:
    """Prove a certificate again.

    Args:
        source: path of the certificate, or its text.

    Raises:
        Malformed: where it cannot be read as a certificate.
    """
    return single.proved_again(source, KIND, VERSION, _statements)


def _statements(table: dict[str, Any]) -> single.Statements:
    """Every statement of the certificate: whether it was proved, and it or its failure in words."""
    masses = rational(table["low"]), rational(table["high"])
    if not 0 <= masses[0] <= masses[1]:
        raise Malformed("the range of masses is empty or negative")
    yield from single._figures(table)
    bare, moved = (single._polynomial(table["polynomials"][name]) for name in ("bare", "moved"))
    rebuilt = single._rebuilt(table)
    same = _same(rebuilt["p0"], rebuilt["disturbance"], bare, moved)
    yield same, "the polynomials follow from the figures" if same else "the polynomials do not follow from the figures"
    if not same:
        return  # what follows would be about some other loop
    free = (fmpq(0), fmpq(0))
    stable = _box(bare, moved, (free, free, masses))
    yield _agrees(table["stability"]["stable"], stable, "stable without a wall for every end mass")
    yield from _passivity(table["passivity"], bare, moved, stable, masses)
    yield from _contact(table["contact"], bare, moved, masses)
    yield _bouncing(table["bouncing"], bare, moved, stable, masses)
    yield _stiffness(table["stiffness"], bare, moved, masses)


def _same(p0: fmpq_poly, n: fmpq_poly, bare: fmpq_poly, moved: fmpq_poly) -> bool:
    """Whether two pairs agree but for one common positive factor."""
    factor = moved[n.degree()] / n[n.degree()]
    return factor > 0 and p0 * factor == bare and n * factor == moved


def _agrees(stated: bool, found: bool, words: str) -> tuple[bool, str]:
    if not isinstance(stated, bool):
        raise Malformed("what is stated must be true or false")
    if stated is found:
        return True, words if found else f"refuted: {words}"
    return False, f"{'not proved' if stated else 'holds after all'}: {words}"


def _member(bare: fmpq_poly, moved: fmpq_poly, environment: Sequence[fmpq]) -> fmpq_poly:
    """Characteristic polynomial with a spring, a dashpot and a mass at the tip."""
    return bare + fmpq_poly(list(environment)) * moved


def _box(bare: fmpq_poly, moved: fmpq_poly, sides: Sequence[Pair]) -> bool:
    """Whether all springs, dashpots and masses of a box are stable.

    The polynomial is affine in all three and of constant degree: the edges decide (Bartlett, Hollot and Huang, 1988).
    """
    corners = sorted(set(product(*sides)))
    for varies in range(3):
        for corner in corners:
            if corner[varies] == sides[varies][0]:
                start = [value if k != varies else fmpq(0) for k, value in enumerate(corner)]
                family = Family(_member(bare, moved, start), S**varies * moved)
                if not family.is_stable_over(*sides[varies]):
                    return False
    return True


def _environment(table: dict[str, Any]) -> list[fmpq]:
    figures = [rational(table[name]) for name in _FIGURES]
    if min(figures) < 0:
        raise Malformed("what is fixed to the tip must not have negative figures")
    return figures


def _passivity(
    table: dict[str, Any], bare: fmpq_poly, moved: fmpq_poly, stable: bool, masses: Pair
) -> Iterator[tuple[bool, str]]:
    """Im(p conj n) / w is negative within the bands and nowhere else; mass and spring at the tip have no part in it."""
    (even, odd), (even_moved, odd_moved) = single._parts(bare), single._parts(moved)
    absorbed = odd * even_moved - even * odd_moved
    far = max(single._bound(absorbed), fmpq(1)) if absorbed.degree() > 0 else fmpq(1)
    ends = [value for band in table["band"] for name in ("outer", "inner") for value in band[name]]
    far = max([far, *(rational(value) + 1 for value in ends if value != "infinite")])
    outer, inner = (
        [
            (rational(band[name][0]), far if band[name][1] == "infinite" else rational(band[name][1]))
            for band in table["band"]
        ]
        for name in ("outer", "inner")
    )
    nested = all(a <= c < d <= b for (a, b), (c, d) in zip(outer, inner, strict=True))
    apart = all(one[1] <= two[0] for one, two in pairwise(outer))
    if not nested or not apart or any(low < 0 for low, _ in outer):
        raise Malformed("the bands do not follow each other")
    for low, high in inner:
        active = all(absorbed(x) < 0 for x in single._pieces([absorbed], low, high)[0])
        words = f"work comes out of the tip for w^2 from {single._short(low)} to {single._short(high)} (rad/s)^2"
        yield active, words if active else f"not proved: {words}"
    edges = [fmpq(0), *(end for band in outer for end in band), far]
    quiet = all(
        absorbed(x) >= 0
        for low, high in zip(edges[0::2], edges[1::2], strict=True)
        if low < high
        for x in single._pieces([absorbed], low, high)[0]
    )
    words = "no work comes out of the tip at any other frequency"
    yield quiet, words if quiet else f"not proved: {words}"
    yield _agrees(table["passive"], stable and not outer, "passive at the tip with every end mass")
    if "troublemaker" in table:
        stiffness, damping, mass = _environment(table["troublemaker"])
        family = Family(_member(bare, moved, (stiffness, damping, mass + masses[0])), moved)
        grows = not family.is_stable(fmpq(0))
        words = "what is fixed to the tip makes the loop unstable"
        yield grows, words if grows else f"not proved: {words}"


def _contact(table: dict[str, Any], bare: fmpq_poly, moved: fmpq_poly, masses: Pair) -> Iterator[tuple[bool, str]]:
    walls = [(rational(table[name][0]), rational(table[name][1])) for name in _FIGURES[:2]]
    if any(not 0 <= low <= high for low, high in walls):
        raise Malformed("a range of walls is empty or negative")
    words = f"stable with every end mass against every wall up to {single._short(walls[0][1])} N/m"
    yield _agrees(table["stable"], _box(bare, moved, (*walls, masses)), words)
    if "witness" in table:
        found = _environment(table["witness"])
        within = all(low <= value <= high for value, (low, high) in zip(found, (*walls, masses), strict=True))
        refutes = within and not Family(_member(bare, moved, found), moved).is_stable(fmpq(0))
        yield refutes, f"the wall that refutes it does {'so' if refutes else 'not'}"


class Popov(single.Slack):
    """|p|^2 / k + Re[(1 + j w q) n conj p] at jw as a quadratic in the mass."""

    def __init__(self, bare: fmpq_poly, moved: fmpq_poly, stiffness: fmpq, multiplier: fmpq):
        carried, turned = S * S * moved, moved * fmpq_poly([1, multiplier])
        self.coefficients = (
            single._inner(carried, carried) / stiffness,
            2 * single._inner(bare, carried) / stiffness + single._inner(turned, carried),
            single._inner(bare, bare) / stiffness + single._inner(turned, bare),
        )


def _bouncing(table: dict[str, Any], bare: fmpq_poly, moved: fmpq_poly, stable: bool, masses: Pair) -> tuple[bool, str]:
    """Popov's criterion for a spring a little stiffer, where equality is enough."""
    stiffness, multiplier = rational(table["stiffness_N_per_m"]), rational(table["multiplier_s"])
    if stiffness < 0 or multiplier < 0:
        raise Malformed("a wall or a multiplier is negative")
    if stiffness == 0:
        return True, "no one-sided wall is claimed to be safe"
    stiffer = stiffness * fmpq(1001, 1000)
    proved = stable and Popov(bare, moved, stiffer, multiplier).nonnegative(*masses, None)
    words = f"comes to rest before every one-sided wall up to {single._short(stiffness)} N/m"
    return proved, words if proved else f"not proved: {words}"


def _stiffness(table: dict[str, Any], bare: fmpq_poly, moved: fmpq_poly, masses: Pair) -> tuple[bool, str]:
    stiffness, share = rational(table["end_stiffness_N_per_m"]), rational(table["share"])
    if stiffness <= 0 or share <= 0:
        raise Malformed("an end stiffness and its share must be positive")
    claim = {"kind": "compliance", "bandwidth_Hz": table["up_to_Hz"]}
    slack = single.Slack(share * stiffness, (moved, fmpq_poly([0])), (bare - stiffness * moved, S * S * moved))
    words = (
        f"end stiffness {single._short(stiffness)} N/m within {single._short(share)} of it up to {table['up_to_Hz']} Hz"
    )
    if table["up_to_Hz"] == "0":
        return True, f"no band is claimed of an end stiffness of {single._short(stiffness)} N/m"
    proved = slack.nonnegative(*masses, single.band(claim)[2])
    return proved, words if proved else f"not proved: {words}"


def main(arguments: Sequence[str]) -> int:
    """Replay the certificate named on the command line; the exit status."""
    return single.told(replay, "python -m beamdesign.proof.replay_contact", arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
