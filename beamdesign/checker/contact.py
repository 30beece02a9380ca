"""The tip as a port over a range of outer end masses: passivity, contact with walls, its apparent stiffness.

With a mass m, a spring k and a dashpot b at the tip the characteristic polynomial is p + (m s^2 + b s + k) n, and
F / x = p / n + m s^2 + b s + k. Stability on the box of masses and walls rests on its edges: the same method as the
prover's, in code of its own, with another test on each edge. Inequalities are settled by cutting the frequency axis at
every sign change of what decides them.
"""

from collections.abc import Sequence
from itertools import pairwise, product

from flint import fmpq, fmpq_poly

from beamdesign.checker.mass_range import up_to
from beamdesign.checker.reading import Statements, Table, Unreadable, judged, rational, short, span
from beamdesign.checker.rig import Rig
from beamdesign.checker.roots import ZERO, Family, Pair, S, Slack, bound, inner, parts, pieces

FIGURES = ("stiffness_N_per_m", "damping_N_s_per_m", "mass_kg")
STIFFER = fmpq(1001, 1000)
"""Walls that Popov's criterion is checked with, where equality is enough, per wall that is stated."""


def statements(table: Table, rig: Rig) -> Statements:
    """Every statement of the certificate: whether it was proved, and it or its failure in words."""
    masses = table.range("outer_end_mass_kg", least=0)
    if rig.effects:
        raise Unreadable("the tip is proved without effects")
    (loop,) = rig.loops()
    port = Port(loop.closed[0], loop.disturbance)
    if loop.closed[1] != S * S * port.moved:
        raise Unreadable("the end mass does not move with the tip that the force acts on")
    none = fmpq(0), fmpq(0)
    stable = port.stable_on((none, none, masses))
    words = f"stable without a wall for every end mass from {span(masses)} kg"
    yield judged(stable, words, table.table("stability").flag("stable"))
    yield from _passivity(table.table("passivity"), port, stable, masses)
    yield from _contact(table.table("contact"), port, masses)
    yield _one_sided(table.table("bouncing"), port, stable, masses)
    yield _stiffness(table.table("stiffness"), port, stable, masses)


class Port:
    """x / F = moved / bare with nothing fixed to the tip."""

    def __init__(self, bare: fmpq_poly, moved: fmpq_poly) -> None:
        self.bare, self.moved = bare, moved

    def against(self, environment: Sequence[fmpq]) -> fmpq_poly:
        """Characteristic polynomial with a spring, a dashpot and a mass at the tip."""
        return self.bare + fmpq_poly(list(environment)) * self.moved

    def is_stable(self, environment: Sequence[fmpq]) -> bool:
        """Whether it is with these fixed to the tip."""
        return Family(self.against(environment), self.moved).is_stable(fmpq(0))

    def stable_on(self, sides: Sequence[Pair]) -> bool:
        """Whether all springs, dashpots and masses of a box are stable.

        The polynomial is affine in all three and of constant degree: the edges decide (Bartlett, Hollot and Huang,
        1988).
        """
        for varies in range(3):
            for corner in sorted(set(product(*sides))):
                if corner[varies] == sides[varies][0]:
                    start = [value if k != varies else fmpq(0) for k, value in enumerate(corner)]
                    if not Family(self.against(start), S**varies * self.moved).is_stable_over(*sides[varies]):
                        return False
        return True


def _environment(table: Table) -> list[fmpq]:
    return [table.at_least(name, 0) for name in FIGURES]


def _in_words(environment: Sequence[fmpq]) -> str:
    stiffness, damping, mass = map(short, environment)
    return f"{mass} kg, held by {stiffness} N/m and {damping} N s/m"


def _passivity(table: Table, port: Port, stable: bool, masses: Pair) -> Statements:
    """Im(p conj n) / w is negative within the bands and nowhere else; mass and spring at the tip have no part in it."""
    (even, odd), (even_moved, odd_moved) = parts(port.bare), parts(port.moved)
    absorbed = odd * even_moved - even * odd_moved
    bands = table.tables("band")
    outer, within = ([_band(band, name) for band in bands] for name in ("outer", "inner"))
    far = max([fmpq(1), *([bound(absorbed)] if absorbed.degree() > 0 else [])])
    far = max([far, *(end + 1 for band in outer + within for end in band if end is not None)])
    closed = [(low, far if high is None else high) for low, high in outer]
    for (low, high), (a, b) in zip(within, closed, strict=True):
        top = far if high is None else high
        if not a <= low < top <= b:
            raise Unreadable("the inner ends of a band are not within the outer ones")
        active = all(absorbed(x) < 0 for x in pieces([absorbed], low, top)[0])
        inside = f"{short(low, up=True)} to {_end(high, up=False)}"
        yield judged(active, f"work comes out of the tip for w^2 from {inside} (rad/s)^2")
    if any(one[1] > two[0] for one, two in pairwise(closed)):
        raise Unreadable("the bands do not follow each other")
    edges = [fmpq(0), *(end for band in closed for end in band), far]
    gaps = [(low, high) for low, high in zip(edges[0::2], edges[1::2], strict=True) if low < high]
    quiet = all(absorbed(x) >= 0 for low, high in gaps for x in pieces([absorbed], low, high)[0])
    listed = " and ".join(f"{short(low, up=False)} to {_end(high, up=True)}" for low, high in outer)
    where = f"for w^2 outside {listed} (rad/s)^2" if outer else "at any frequency"
    yield judged(quiet, f"no work comes out of the tip {where}")
    yield judged(stable and not outer, "passive at the tip with every end mass", table.flag("passive"))
    if "troublemaker" in table:
        stiffness, damping, mass = found = _environment(table.table("troublemaker"))
        grows = not port.is_stable((stiffness, damping, mass + masses[0]))
        yield judged(grows, f"the loop is not stable with {_in_words(found)}, fixed to the tip")


def _band(table: Table, key: str) -> tuple[fmpq, fmpq | None]:
    """Ends of a band as w^2, None where it has no upper one."""
    ends = table.entries(key)
    if len(ends) != 2:
        raise Unreadable(f"{table.place_of(key)} must be two ends")
    low, high = rational(ends[0]), None if ends[1] == "infinite" else rational(ends[1])
    if low < 0 or (high is not None and high <= low):
        raise Unreadable(f"{table.place_of(key)} is no band")
    return low, high


def _end(value: fmpq | None, up: bool) -> str:
    return "infinity" if value is None else short(value, up)


def _contact(table: Table, port: Port, masses: Pair) -> Statements:
    walls = [table.range(name, least=0) for name in FIGURES[:2]]
    words = ", ".join(map(span, walls))
    holds = port.stable_on((*walls, masses))
    words = f"stable with every end mass against every wall of {words} (N/m, N s/m)"
    yield judged(holds, words, table.flag("stable"))
    if "witness" in table:
        found = _environment(table.table("witness"))
        within = all(low <= value <= high for value, (low, high) in zip(found, (*walls, masses), strict=True))
        refutes = within and not port.is_stable(found)
        words = f"not stable with {_in_words(found)}"
        yield refutes, words if refutes else f"the witness does not refute it: {words}"


class Popov(Slack):
    """|p|^2 / k + Re[(1 + j w q) n conj p] at jw as a quadratic in the mass (Khalil 2002, theorem 7.3)."""

    def __init__(self, port: Port, stiffness: fmpq, multiplier: fmpq) -> None:
        bare, carried, turned = port.bare, S * S * port.moved, port.moved * fmpq_poly([1, multiplier])
        self.coefficients = (
            inner(carried, carried) / stiffness,
            2 * inner(bare, carried) / stiffness + inner(turned, carried),
            inner(bare, bare) / stiffness + inner(turned, bare),
        )


def _one_sided(table: Table, port: Port, stable: bool, masses: Pair) -> tuple[bool, str]:
    """Popov's criterion for a spring a little stiffer, where equality is enough."""
    stiffness, multiplier = table.at_least("stiffness_N_per_m", 0), table.at_least("multiplier_s", 0)
    if stiffness == 0:
        return True, "of no one-sided spring is it claimed that the loop comes to rest before it"
    proved = stable and Popov(port, stiffness * STIFFER, multiplier).nonnegative(*masses, None)
    return judged(proved, f"comes to rest before every one-sided spring up to {short(stiffness, up=False)} N/m")


def _stiffness(table: Table, port: Port, stable: bool, masses: Pair) -> tuple[bool, str]:
    """|F / x - k| is at most a share of k, which is below zero where an end at rest moves against a force.

    Of a loop that is not stable a force says nothing of where the tip will be.
    """
    stiffness, share = table.number("end_stiffness_N_per_m"), table.at_least("share", 0, above=True)
    if stiffness == 0:
        raise Unreadable(f"{table.place_of('end_stiffness_N_per_m')} must not be 0")
    until, band = up_to(table)
    if until == 0:
        return True, f"no band is claimed of an end stiffness of {short(stiffness)} N/m"
    slack = Slack(share * stiffness, (port.moved, ZERO), (port.bare - stiffness * port.moved, S * S * port.moved))
    words = f"end stiffness {short(stiffness)} N/m within {short(share, up=True)} of it {band}"
    return judged(stable and slack.nonnegative(*masses, until), words)
