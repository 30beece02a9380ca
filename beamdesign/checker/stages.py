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

from collections.abc import Callable, Mapping, Sequence
from itertools import permutations

from flint import arb, arb_mat, ctx, fmpq, fmpq_mat

from beamdesign.checker.law import SENSED, VELOCITY, Law, Row, Stage
from beamdesign.checker.reading import Statements, Table, Unreadable, short, span
from beamdesign.checker.rig import Rig
from beamdesign.checker.roots import NONE, Pair, determinant_of, interpolated, is_hurwitz, pieces
from beamdesign.checker.work import of_determinant, spend

# The closed loop of a rig without effects as x' = A(m) x.
#
# It is from equations (7) to (16) of Zalucky and Hardt (1984). Lyapunov functions are of states, so these are the
# prover's; that one builds its matrices by differentiating the assembled rig, this writes down the equations.


MOST_STATES = 32
MOST_BITS = 2_048
"""Of the numerators and of the common denominator of a matrix."""
_PLANT = ("x", "v", "c", "y", "u", "q", "r")
"""Tip, its velocity, cylinder, inner tip, its velocity, flow, its rate."""


class StateSpace:
    """The closed loop with one law.

    The states are X_m, X_m', X_c, X_f, X_f', Q_0, Q_0' or, with a screw, the nut's travel, its speed and the motor's
    current in the places of X_c, Q_0 and Q_0', the filtered volts where there is a filter, and those of the
    law: of one that stays in observer form; of a stage those that all stages share and none resets, output and rate of
    each second-order section and the current.

    Attributes:
        bare_mass: M_m, kg.
        order: number of states.
    """

    def __init__(self, rig: Rig, law: Law | Stage) -> None:
        if rig.effects:
            raise Unreadable("the equations of a changing payload have no effects")
        self.bare_mass = rig.figures["outer_mass_kg"]
        first = len(_PLANT) + ("filter_frequency_rad_per_s" in rig.figures)
        self.order = first + law.order
        if self.order > MOST_STATES:
            raise Unreadable(f"the loop has {self.order} states, more than {MOST_STATES}")
        self._rows = [[fmpq(0)] * self.order for _ in range(self.order)]
        sensed = self._plant(rig)
        into = self._rows[_PLANT.index("r")]
        if rig.kind == "ball_screw":
            drive = rig.figures["current_loop_rad_per_s"]
        else:
            drive = rig.figures["valve_frequency_rad_per_s"] ** 2 * rig.figures["flow_gain_m3_per_s_per_A"]
        for j, weight in enumerate(law.close(self._rows, first, sensed)):
            into[j] += drive * weight
        bounded(self.matrix(fmpq(0)))

    def matrix(self, mass: fmpq) -> fmpq_mat:
        """A(m), (order, order)."""
        total = self.bare_mass + mass
        rows = ([entry / total for entry in row] if k == VELOCITY else row for k, row in enumerate(self._rows))
        return fmpq_mat(self.order, self.order, [entry for row in rows for entry in row])

    def _plant(self, rig: Rig) -> dict[str, Row]:
        """Fill in the rows of the rig; what is sensed, as rows over the states."""
        f, rows = rig.figures, self._rows
        x, v, c, y, u, q, _ = range(len(_PLANT))
        rows[x][v] = rows[y][u] = fmpq(1)
        screw = rig.kind == "ball_screw"
        spring = f["screw_stiffness_N_per_m"] if screw else f["oil_stiffness_N_per_m"]
        # The actuator's force is K_c (X_c - X_m), or K_s d + c_s d' with d = X_n - (X_m - X_f), X_n the nut's travel.
        force = {c: spring, x: -spring}
        if screw:
            damping = f["screw_damping_N_s_per_m"]
            force |= {y: spring, q: damping, v: -damping, u: damping}
        # (7), (9): (M_m + m) X_m'' = F - K_m X_m - b_m X_m', which `matrix` divides by the mass
        rows[v][x], rows[v][v] = -f["outer_stiffness_N_per_m"], -f["outer_damping_N_s_per_m"]
        # (8), (10): (M_f + n) X_f'' = -F - K_f X_f - b_f X_f'
        inner = f["inner_mass_kg"] + rig.inner_end_mass
        rows[u][y], rows[u][u] = -f["inner_stiffness_N_per_m"] / inner, -f["inner_damping_N_s_per_m"] / inner
        for j, weight in force.items():
            rows[v][j] += weight
            rows[u][j] -= weight / inner
        (self._screw if screw else self._cylinder)(f, force)
        gain, filtered = f["sensor_gain_V_per_m"], f.get("filter_frequency_rad_per_s")
        volts = {x: gain}
        if filtered is not None:
            rows[len(_PLANT)][x], rows[len(_PLANT)][len(_PLANT)] = filtered * gain, -filtered
            volts = {len(_PLANT): fmpq(1)}
        per_area = 1 if screw else 1 / f["piston_area_m2"]
        felt = {j: per_area * weight for j, weight in force.items()}
        seen: dict[str, Mapping[int, fmpq]] = {SENSED[0]: volts, SENSED[1]: {y: fmpq(1)}, SENSED[2 + screw]: felt}
        return {name: [weights.get(j, fmpq(0)) for j in range(self.order)] for name, weights in seen.items()}

    def _screw(self, f: Mapping[str, fmpq], force: Mapping[int, fmpq]) -> None:
        """Rows of the nut's travel, of its speed and of the motor's current."""
        _, _, c, _, _, q, r = range(len(_PLANT))
        rows, lead, torque = self._rows, f["lead_m_per_rad"], f["torque_constant_N_m_per_A"]
        # J X_n'' = h (K_t i - h F) - b X_n'
        rows[c][q], rows[q][r] = fmpq(1), lead * torque / f["rotor_inertia_kg_m2"]
        rows[q][q] = -f["rotor_friction_N_m_s_per_rad"] / f["rotor_inertia_kg_m2"]
        for j, weight in force.items():
            rows[q][j] -= lead * lead * weight / f["rotor_inertia_kg_m2"]
        # i' = w_c (I - k_w X_n' / h - i)
        rows[r][r] = -f["current_loop_rad_per_s"]
        rows[r][q] = -f["current_loop_rad_per_s"] * f["speed_feedback_A_s_per_rad"] / lead

    def _cylinder(self, f: Mapping[str, fmpq], force: Mapping[int, fmpq]) -> None:
        """Rows of the cylinder's end and of the valve's flow."""
        _, _, c, _, u, q, r = range(len(_PLANT))
        rows, area, w = self._rows, f["piston_area_m2"], f["valve_frequency_rad_per_s"]
        # (14) to (16): X_c' = X_f' + (Q_0 - K_pq K_c (X_c - X_m) / A) / A
        rows[c][u], rows[c][q] = fmpq(1), 1 / area
        for j, weight in force.items():
            rows[c][j] -= f["leakage_m3_per_s_per_Pa"] * weight / (area * area)
        # (13): Q_0'' = w^2 (K_q I - Q_0) - 2 xi w Q_0'
        rows[q][r] = fmpq(1)
        rows[r][q], rows[r][r] = -w * w, -2 * f["valve_damping_ratio"] * w


def bounded(matrix: fmpq_mat) -> fmpq_mat:
    """A matrix whose numbers are not too long to work with.

    Raises:
        Unreadable: for another.
    """
    above, below = matrix.numer_denom()
    longest = max([int(below), *(abs(int(entry)) for entry in above.entries())])
    if longest.bit_length() > MOST_BITS:
        raise Unreadable(f"the numbers of a matrix have more than {MOST_BITS} bits over their common denominator")
    return matrix


# Definiteness.


def positive(matrix: fmpq_mat) -> bool:
    """Whether a symmetric matrix M is positive definite: as all roots of det(sI + M) are real, its signs decide."""
    spend(of_determinant(matrix))
    return all(value > 0 for value in (-matrix).charpoly().coeffs())


def positive_between(value: Callable[[fmpq], fmpq_mat], degree: int, low: fmpq, high: fmpq) -> bool:
    """Whether a symmetric matrix polynomial of at most some degree in the mass is positive definite on [low, high]."""
    if not positive(value(low)):
        return False
    count = degree * value(low).nrows() + 1
    points = (low + (high - low) * fmpq(k, count) for k in range(count))
    determinant = interpolated(lambda mass: determinant_of(value(mass)), points)
    return bool(determinant(high) != 0) and pieces([determinant], low, high)[1] == 0


# What the certificate states.


MOST_CLAIMS = 32
"""And as many counterexamples."""
MOST_CYCLES = 100_000
LARGEST_DEGREE = 4
"""Of P in the mass."""
LARGEST_EXPONENT = fmpq(10) ** 18
"""Of a matrix exponential: the largest entry of A times the time; with sections behind a filter entries are 1e10."""
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
        words, proved = _CLAIMS[kind](Claim(loops, claim, kind, within))
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

    def falls(self, loop: StateSpace, masses: Pair, decay: fmpq, rate: fmpq, resting: bool) -> bool:
        """Whether it falls as exp(-2 decay t) at all masses while they change at one rate, payload at rest or not."""

        def fall(mass: fmpq) -> fmpq_mat:
            total, p, n = loop.bare_mass + mass, self.at(mass), loop.order
            product = p * loop.matrix(mass)
            rise = product + product.transpose() + p * (2 * decay) + self.slope(mass) * rate
            # D P + P D, where D picks out the velocity of the tip
            joined = [p[i, j] * ((i == VELOCITY) + (j == VELOCITY)) for i in range(n) for j in range(n)]
            return fmpq_mat(n, n, joined) * (rate if resting else NONE) - rise * total

        return positive_between(fall, self.degree + 1, *masses)


Proved = tuple[str, bool]
"""A claim in words, and whether it was proved."""


class Claim:
    """What is claimed of every loop over some masses, by functions: one along every loop, or each along its own."""

    def __init__(self, loops: Sequence[StateSpace], table: Table, kind: str, masses: Pair) -> None:
        self.loops, self.table, self.masses = loops, table, masses
        own = table.tables("stage") if kind == "stage_dwell" else [table]
        self.functions = [Function(one, loops[0].order) for one in own]

    def _stage_change(self) -> Proved:
        return "a payload that stays", self._fall()

    def _any_change(self) -> Proved:
        return "any matched change of the payload", self.functions[0].degree == 0 and self._fall()

    def _payload_rate(self) -> Proved:
        rate, (joins, from_rest) = self.table.at_least("rate_kg_per_s", 0, above=True), self._joining()
        cases = [(rate, False), (-rate, False)] + [(rate, True)] * from_rest
        return f"|dm/dt| up to {short(rate, up=False)} kg/s, {joins}", self._fall(cases=cases)

    def _payload_jumps(self) -> Proved:
        bare, masses, (joins, from_rest) = self.loops[0].bare_mass, self.masses, self._joining()
        shares = [fmpq(1), (bare + masses[0]) / (bare + masses[1])][: 1 + from_rest]
        ends = [self.functions[0].at(mass) for mass in masses]
        words, proved = self._dwell([(before, _after(p, share)) for before in ends for p in ends for share in shares])
        return f"sudden changes of the payload {words}, {joins}", proved

    def _stage_dwell(self) -> Proved:
        if len(self.functions) != len(self.loops):
            raise Unreadable(f"{self.table.place} needs a P for each stage")
        pairs = permutations(self.functions, 2)
        words, proved = self._dwell([(one.at(mass), two.at(mass)) for one, two in pairs for mass in self.masses])
        return f"changes of stage {words}, at a payload that stays", proved

    def _joining(self) -> tuple[str, bool]:
        """How payload joins, in words, and whether it may be at rest when it does."""
        joining = self.table.word("joining", "matched", "from_rest")
        return f"payload {joining.replace('_', ' ')}", joining == "from_rest"

    def _fall(self, decay: fmpq = NONE, cases: Sequence[tuple[fmpq, bool]] = ((NONE, False),)) -> bool:
        """Whether the functions are positive and fall in all cases of a rate."""
        functions, masses = self.functions, self.masses
        pairs = zip(functions * len(self.loops) if len(functions) == 1 else functions, self.loops, strict=True)
        return all(one.positive(masses) for one in functions) and all(
            one.falls(loop, masses, decay, *case) for one, loop in pairs for case in cases
        )

    def _dwell(self, changes: Sequence[tuple[fmpq_mat, fmpq_mat]]) -> Proved:
        """The time between changes, each with P before and after it, and whether what falls between allows it."""
        dwell, factor, decay = (self.table.at_least(key, 0, above=True) for key in ("dwell_s", "factor", "decay_per_s"))
        proved = (
            bool(arb(factor).log() < arb(2 * decay * dwell))
            and all(one.degree <= 1 for one in self.functions)  # affine in m: extremes of masses and share suffice
            and self._fall(decay)
            and all(positive(before * factor - after) for before, after in changes)
        )
        return f"every {short(dwell, up=True)} s on average", proved


def _after(p: fmpq_mat, share: fmpq) -> fmpq_mat:
    """J' P J, J multiplying the velocity by `share`."""
    n = p.nrows()
    scale = [share if i == VELOCITY else fmpq(1) for i in range(n)]
    return fmpq_mat(n, n, [p[i, j] * scale[i] * scale[j] for i in range(n) for j in range(n)])


_CLAIMS = {
    "stage_change": Claim._stage_change,
    "any_change": Claim._any_change,
    "payload_rate": Claim._payload_rate,
    "payload_jumps": Claim._payload_jumps,
    "stage_dwell": Claim._stage_dwell,
}


# The counterexamples.


def _frozen(loops: Sequence[StateSpace], example: Table, masses: Pair) -> tuple[bool, str]:
    stage, mass = example.whole("stage", 1, len(loops)), example.number("outer_end_mass_kg")
    proved = masses[0] <= mass <= masses[1] and not is_hurwitz(loops[stage - 1].matrix(mass).charpoly())
    return proved, f"{'unstable' if proved else 'not unstable'} at {short(mass)} kg that stays, stage {stage}"


def _cycle(loops: Sequence[StateSpace], example: Table, masses: Pair) -> tuple[bool, str]:
    stages = [Table({"stage": k}, example.place).whole("stage", 1, len(loops)) for k in example.entries("stages")]
    weights, times = example.numbers("outer_end_mass_kg"), example.numbers("time_s")
    cycles = example.whole("cycles", 1, MOST_CYCLES)
    if not len(stages) == len(weights) == len(times) == 2 or min(times) <= 0:
        raise Unreadable(f"{example.place}: a cycle has two stages, two masses and two times above zero")
    proved = masses[0] <= min(weights) and max(weights) <= masses[1]
    if proved:
        turns = [loops[k - 1].matrix(m) * t for k, m, t in zip(stages, weights, times, strict=True)]
        if max(abs(entry) for turn in turns for entry in turn.entries()) > LARGEST_EXPONENT:
            raise Unreadable(f"{example.place}: the times are too long to work with")
        spend(120 * loops[0].order ** 3)
        with ctx.workprec(CYCLE_PRECISION_BITS):
            first, second = (arb_mat(turn).exp() for turn in turns)
            proved = bool(abs(((second * first) ** cycles).trace()) > loops[0].order)
    words = " and ".join(
        f"{short(m)} kg with stage {k} for {short(t)} s" for k, m, t in zip(stages, weights, times, strict=True)
    )
    return proved, f"{'the motion grows' if proved else 'growth is not proved'} for {words}, in turn"


_COUNTEREXAMPLES = {"frozen": _frozen, "cycle": _cycle}
