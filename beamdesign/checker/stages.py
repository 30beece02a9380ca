"""Stability while the payload or the stage of the law changes in motion; one law is the case of one stage.

What a claim says, with W = M_m + m, D picking out the velocity v of the tip, V = x' P(m) x, for m in its range and for
every stage i, so that any stage may act at any time:

- stage_change: A_i(m)' P + P A_i(m) < 0 at every mass that stays.
- any_change: A_i(m)' P + P A_i(m) < 0 with one P at both ends, so in between, A being affine in 1 / W. Then the loop is
  stable however fast m changes, v being continuous (payload joins and leaves with the tip's velocity).
- payload_rate: A_i' P + P A_i + r dP/dm < 0 for r = rate and r = -rate; joining "from_rest" also with
  - (r / W) (D P + P D), r = rate, so that payload may be at rest, or at any part of the tip's velocity, when it joins.
- payload_jumps: A_i' P + P A_i + 2 decay P < 0 while m stays, J' P(m2) J < factor P(m1) at a jump, where J keeps v, or
  if "from_rest" any share of it down to (M_m + low) / (M_m + high); and log(factor) < 2 decay dwell (Hespanha and
  Morse, 1999).
- stage_dwell: a P_i(m) for each stage, A_i' P_i + P_i A_i + 2 decay P_i < 0, P_j < factor P_i, and log(factor) <
  2 decay dwell: masses stay, and the stage changes no more often on average.
- counterexamples: "frozen", a mass and a stage at which A_i(m) is not Hurwitz; "cycle", two pairs of them in turn, v
  continuous, with |trace M^k| above the order of the product M of two matrix exponentials for one k, so with a spectral
  radius of M above one.

What has to be definite is the same as for the prover, in code of its own. Definiteness of symmetric rational matrices,
and of matrix polynomials in the mass on an interval, is settled by another method than the prover's, which takes minors
and Bernstein coefficients of matrices: the signs of the characteristic polynomial at one end, and no root of the
determinant up to the other, on the way to which an eigenvalue would have to pass zero.
"""

from collections.abc import Callable, Sequence

from flint import arb, arb_mat, ctx, fmpq, fmpq_mat

from beamdesign.checker.mass_range import Statements
from beamdesign.checker.reading import Table, Unreadable, short, span
from beamdesign.checker.rig import Rig
from beamdesign.checker.roots import NONE, Pair, interpolated, is_hurwitz, pieces
from beamdesign.checker.state_space import VELOCITY, StateSpace, bounded

# Definiteness.


def positive(matrix: fmpq_mat) -> bool:
    """Whether a symmetric matrix M is positive definite: as all roots of det(sI + M) are real, its signs decide."""
    return all(value > 0 for value in (-matrix).charpoly().coeffs())


def positive_between(value: Callable[[fmpq], fmpq_mat], degree: int, low: fmpq, high: fmpq) -> bool:
    """Whether a symmetric matrix polynomial of at most some degree in the mass is positive definite on [low, high]."""
    if not positive(value(low)):
        return False
    count = degree * value(low).nrows() + 1
    points = (low + (high - low) * fmpq(k, count) for k in range(count))
    determinant = interpolated(lambda mass: value(mass).det(), points)
    return bool(determinant(high) != 0) and pieces([determinant], low, high)[1] == 0


# What the certificate states.


MOST_CLAIMS = 32
"""And as many counterexamples."""
MOST_CYCLES = 100_000
LARGEST_DEGREE = 4
"""Of P in the mass."""
LARGEST_EXPONENT = fmpq(10) ** 9
"""Of a matrix exponential: the largest entry of A times the time."""
CYCLE_PRECISION_BITS = 512


def statements(table: Table, rig: Rig) -> Statements:
    """Every statement of the certificate: whether it was proved, and it or its failure in words."""
    low, high = masses = table.range("outer_end_mass_kg", least=0)
    laws = rig.schedule.stages if rig.schedule is not None else [rig.law] if rig.law is not None else []
    loops = [StateSpace(rig, law) for law in laws]
    if not loops or low == high:
        raise Unreadable("there is no [controller], or no mass that changes")
    claims, against = table.tables("claim"), table.tables("counterexample")
    if max(len(claims), len(against)) > MOST_CLAIMS:
        raise Unreadable(f"it has more than {MOST_CLAIMS} claims or counterexamples")
    something = bool(claims or against)
    yield something, f"{'something' if something else 'nothing'} is claimed"
    for claim in claims:
        kind, within = claim.word("kind", *_CLAIMS), claim.range("outer_end_mass_kg", least=0)
        if not low <= within[0] < within[1] <= high:
            raise Unreadable(f"{claim.place_of('outer_end_mass_kg')} is not within that of the certificate")
        words, proved = _CLAIMS[kind](loops, claim, within)
        if kind == "stage_dwell" and rig.schedule is not None:
            kept = rig.schedule.dwell >= claim.number("dwell_s")
            words += f", {'kept' if kept else 'NOT kept'} by the schedule's dwell_s of {short(rig.schedule.dwell)}"
        several = ", whichever stage acts when" if len(loops) > 1 and kind != "stage_dwell" else ""
        yield proved, f"{'stable' if proved else 'not proved stable'} from {span(within)} kg{several}: {words}"
    for example in against:
        yield _COUNTEREXAMPLES[example.word("kind", *_COUNTEREXAMPLES)](loops, example, masses)


# The claims.


class Function:
    """V = x' P(m) x, of the lower triangles of the coefficients of m^0, m^1, ... under the key P."""

    def __init__(self, table: Table, order: int) -> None:
        place, self.coefficients = table.place_of("P"), []
        for entries in table.entries("P"):
            rows = Table({"P": entries}, place).rows("P")
            if [len(row) for row in rows] != list(range(1, order + 1)):
                raise Unreadable(f"{place} must be lower triangles of order {order}")
            whole = [rows[max(i, j)][min(i, j)] for i in range(order) for j in range(order)]
            self.coefficients.append(bounded(fmpq_mat(order, order, whole)))
        self.degree = len(self.coefficients) - 1
        if not 0 <= self.degree <= LARGEST_DEGREE:
            raise Unreadable(f"{place} must be of degree 0 to {LARGEST_DEGREE} in the mass")

    def at(self, mass: fmpq) -> fmpq_mat:
        """P(m)."""
        return sum((p * mass**k for k, p in enumerate(self.coefficients)), self.coefficients[0] * 0)

    def slope(self, mass: fmpq) -> fmpq_mat:
        """dP/dm."""
        terms = (p * (k * mass ** (k - 1)) for k, p in enumerate(self.coefficients) if k)
        return sum(terms, self.coefficients[0] * 0)

    def positive(self, masses: Pair) -> bool:
        """Whether it is positive definite at all masses."""
        return positive_between(self.at, self.degree, *masses)

    def falls(
        self, loop: StateSpace, masses: Pair, decay: fmpq = NONE, rate: fmpq = NONE, resting: bool = False
    ) -> bool:
        """Whether it falls as exp(-2 decay t) at all masses while they change at one rate, payload at rest or not."""

        def fall(mass: fmpq) -> fmpq_mat:
            total, p = loop.bare_mass + mass, self.at(mass)
            rise = _both(loop.matrix(mass), p) + p * (2 * decay) + self.slope(mass) * rate
            return (_both(_velocity(loop.order), p) * rate if resting else p * 0) - rise * total

        return positive_between(fall, self.degree + 1, *masses)


def _both(left: fmpq_mat, p: fmpq_mat) -> fmpq_mat:
    product = p * left
    return product + product.transpose()


def _velocity(order: int) -> fmpq_mat:
    """D, which picks out the velocity of the tip."""
    pick = fmpq_mat(order, order)
    pick[VELOCITY, VELOCITY] = fmpq(1)
    return pick


Claimed = tuple[str, bool]
"""A claim in words, and whether it was proved."""


def _stage_change(loops: Sequence[StateSpace], claim: Table, masses: Pair) -> Claimed:
    function = Function(claim, loops[0].order)
    return "a payload that stays", function.positive(masses) and all(function.falls(loop, masses) for loop in loops)


def _any_change(loops: Sequence[StateSpace], claim: Table, masses: Pair) -> Claimed:
    function = Function(claim, loops[0].order)
    p = function.coefficients[0]
    falls = (positive(-_both(loop.matrix(mass), p)) for loop in loops for mass in masses)
    return "any matched change of the payload", function.degree == 0 and positive(p) and all(falls)


def _payload_rate(loops: Sequence[StateSpace], claim: Table, masses: Pair) -> Claimed:
    function, rate = Function(claim, loops[0].order), claim.at_least("rate_kg_per_s", 0, above=True)
    joins, from_rest = _joining(claim)
    cases = [(rate, False), (-rate, False)] + [(rate, True)] * from_rest
    proved = function.positive(masses) and all(
        function.falls(loop, masses, NONE, *case) for loop in loops for case in cases
    )
    return f"|dm/dt| up to {short(rate)} kg/s, {joins}", proved


def _payload_jumps(loops: Sequence[StateSpace], claim: Table, masses: Pair) -> Claimed:
    function, (factor, decay, words, enough) = Function(claim, loops[0].order), _dwell(claim)
    joins, from_rest = _joining(claim)
    bare = loops[0].bare_mass
    shares = [fmpq(1), (bare + masses[0]) / (bare + masses[1])][: 1 + from_rest]
    proved = (
        enough
        and function.degree <= 1  # affine in m: the extremes of both masses and of the share of v suffice
        and function.positive(masses)
        and all(function.falls(loop, masses, decay) for loop in loops)
        and all(
            positive(function.at(before) * factor - _after(function.at(after), share))
            for before in masses
            for after in masses
            for share in shares
        )
    )
    return f"sudden changes of the payload every {words}, {joins}", proved


def _stage_dwell(loops: Sequence[StateSpace], claim: Table, masses: Pair) -> Claimed:
    factor, decay, words, enough = _dwell(claim)
    functions = [Function(one, loops[0].order) for one in claim.tables("stage")]
    if len(functions) != len(loops):
        raise Unreadable(f"{claim.place} needs a P for each stage")
    proved = (
        enough
        and all(f.degree <= 1 and f.positive(masses) for f in functions)
        and all(f.falls(loop, masses, decay) for f, loop in zip(functions, loops, strict=True))
        and all(  # affine in m: both ends suffice
            positive(one.at(mass) * factor - two.at(mass))
            for mass in masses
            for one in functions
            for two in functions
            if one is not two
        )
    )
    return f"changes of stage every {words}, at a payload that stays", proved


def _joining(claim: Table) -> tuple[str, bool]:
    """How payload joins, in words, and whether it may be at rest when it does."""
    joining = claim.word("joining", "matched", "from_rest")
    return f"payload {joining.replace('_', ' ')}", joining == "from_rest"


def _dwell(claim: Table) -> tuple[fmpq, fmpq, str, bool]:
    """Growth at a change, decay between, the time between in words, and whether that is enough."""
    dwell, factor, decay = (claim.at_least(key, 0, above=True) for key in ("dwell_s", "factor", "decay_per_s"))
    return factor, decay, f"{short(dwell)} s on average", bool(arb(factor).log() < arb(2 * decay * dwell))


def _after(p: fmpq_mat, share: fmpq) -> fmpq_mat:
    """J' P J, J multiplying the velocity by `share`."""
    n = p.nrows()
    scale = [share if i == VELOCITY else fmpq(1) for i in range(n)]
    return fmpq_mat(n, n, [p[i, j] * scale[i] * scale[j] for i in range(n) for j in range(n)])


_CLAIMS: dict[str, Callable[[Sequence[StateSpace], Table, Pair], Claimed]] = {
    "stage_change": _stage_change,
    "any_change": _any_change,
    "payload_rate": _payload_rate,
    "payload_jumps": _payload_jumps,
    "stage_dwell": _stage_dwell,
}


# The counterexamples.


def _frozen(loops: Sequence[StateSpace], example: Table, masses: Pair) -> tuple[bool, str]:
    stage, mass = example.whole("stage", 1, len(loops)), example.number("outer_end_mass_kg")
    proved = masses[0] <= mass <= masses[1] and not is_hurwitz(loops[stage - 1].matrix(mass).charpoly())
    return proved, f"{'unstable' if proved else 'not unstable'} at {short(mass)} kg that stays, stage {stage}"


def _cycle(loops: Sequence[StateSpace], example: Table, masses: Pair) -> tuple[bool, str]:
    stages = [
        Table({"stage": stage}, example.place).whole("stage", 1, len(loops)) for stage in example.entries("stages")
    ]
    weights, times = example.numbers("outer_end_mass_kg"), example.numbers("time_s")
    cycles = example.whole("cycles", 1, MOST_CYCLES)
    if not len(stages) == len(weights) == len(times) == 2 or min(times) <= 0:
        raise Unreadable(f"{example.place}: a cycle has two stages, two masses and two times above zero")
    proved = masses[0] <= min(weights) and max(weights) <= masses[1]
    if proved:
        turns = [loops[k - 1].matrix(m) * t for k, m, t in zip(stages, weights, times, strict=True)]
        if max(abs(entry) for turn in turns for entry in turn.entries()) > LARGEST_EXPONENT:
            raise Unreadable(f"{example.place}: the times are too long to work with")
        with ctx.workprec(CYCLE_PRECISION_BITS):
            first, second = (arb_mat(turn).exp() for turn in turns)
            proved = bool(abs(((second * first) ** cycles).trace()) > loops[0].order)
    words = " and ".join(
        f"{short(m)} kg with stage {k} for {short(t)} s" for k, m, t in zip(stages, weights, times, strict=True)
    )
    return proved, f"{'the motion grows' if proved else 'growth is not proved'} for {words}, in turn"


_COUNTEREXAMPLES: dict[str, Callable[[Sequence[StateSpace], Table, Pair], tuple[bool, str]]] = {
    "frozen": _frozen,
    "cycle": _cycle,
}
