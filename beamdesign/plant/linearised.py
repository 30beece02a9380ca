"""The assembly's plant with linear laws in descriptor form, as functions of its parameters alone.

E(m, n) x' = A x + B u, y = C x + D u with E = I + P diag(m, n) V: an end mass is the force that the acceleration of its
tip takes off that tip, and nothing else depends on it. All polynomials of the plant are minors of one pencil s E - A,
bordered by B, C and D. They are expanded without division and, the pencil being sparse, with few equal terms that
cancel: coefficients keep their relative accuracy, in floats as in rationals and symbols.
"""

import operator
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product

import casadi as ca
from flint import fmpq

from beamdesign.plant.actuators import Actuator
from beamdesign.plant.assembly import INPUTS, RIGS, Assembly, Structure, join
from beamdesign.plant.component import SAMPLED
from beamdesign.plant.effects import Effect, Parameter, in_volts, library
from beamdesign.plant.machine_code import trace
from beamdesign.polynomial import exact
from beamdesign.records import InputError

SOURCES = ("disturbance_N", "sampled_current_A")
_SEEN = ("outer_displacement_m", "measured_V", "inner_displacement_m")
SEEN = (*_SEEN, "load_pressure_Pa")
"""What the tip does, what the controller hears of it, and what added sensors may read, of a hydraulic rig; of another
what its actuator feels in the place of the load pressure."""

_FROM = {
    "displacement_m": "outer_m",  # X_m, the outer beam's at its tip
    "velocity_m_per_s": "outer_m_per_s",
    "inner_displacement_m": "inner_m",  # X_f
    "inner_velocity_m_per_s": "inner_m_per_s",
}


def linear_states(actuator: type[Actuator]) -> tuple[str, ...]:
    """Those of Zalucky and Hardt (1984), equations (7) to (18), or with another actuator as many of its own.

    Behind them come `filtered_V` where the sensor has a filter, those of effects, and an actuator's unseen one where
    that is driven and shows, such as `mean_pressure_Pa` of the chambers.
    """
    first, *others = actuator.linear_states
    beams = list(_FROM)
    return (*beams[:2], first, *beams[2:], *others)


Pairs = tuple[tuple[int, int], ...]
"""A minor: places in `SOURCES` and `SEEN` of what it is from and to."""

Terms = dict[int, ca.SX]
"""A polynomial in s, m and n: coefficients by `S`, `M` and `N` times their powers, added up."""

S, M, N = 1, 1 << 8, 1 << 9


@dataclass(frozen=True)
class LinearAssembly:
    """The linear plant of an assembly.

    Attributes:
        function: its parameters (one vector) to P (n, 2), V (2, n), A (n, n), B (n, 2), C (4, n) and D (4, 2), from
            disturbance and current to what is in `SEEN`, all sparse. The end masses among the parameters do not matter.
        states: names of the n states.
        parameters: names of the parameters.
    """

    function: ca.Function
    states: tuple[str, ...]
    parameters: tuple[str, ...]


def linear_effect(effect: Effect) -> Effect:
    """An effect with its linear laws, which see the figures of its spans as further parameters.

    One that is but a factor on the gain has it on the sensor's volts.

    Raises:
        ValueError: where the effect has no linear member.
    """
    if effect.linear is None:
        raise ValueError(f"{effect.name} has no linear member")
    if effect.linear.laws is None:
        return effect
    linear = in_volts(effect.linear) if effect.linear.gain and not effect.linear.laws else effect.linear
    assert linear.laws is not None  # those of a factor
    figures = tuple(Parameter(name, 0.0, 0.0, 0.0, 0.0, "of a linear member") for name in linear.figures)
    parameters = effect.parameters + figures
    return replace(effect, laws=linear.laws, states=linear.states, parameters=parameters, memory=(), linear=None)


@cache
def linear_assembly(filtered: bool, names: tuple[str, ...], rig: str = "twin_beam") -> LinearAssembly:
    """The plant with the linear members of the named effects, derived from the assembly by differentiation.

    Args:
        filtered: whether the prototype's own low-pass filter follows the sensor.
        names: effects, sorted.
        rig: of two beams, one of `beamdesign.plant.assembly.RIGS`.

    Raises:
        ValueError: where an effect has no linear member.
        InputError: where one has a member whose laws are not linear after all.
        ArithmeticError: where an end mass acts otherwise than by the acceleration of its tip.
    """
    members = [linear_effect(library()[name]) for name in names]
    joined = join(Structure(SAMPLED, filtered, tuple(member.name for member in members), rig), members)
    t, x, u, p = joined.function.sx_in()
    rate, y = joined.function(t, x, u, p)
    actuator = RIGS[rig].actuator
    assert actuator is not None  # there are two beams
    seen = (*_SEEN, actuator.feels[0])
    inputs, outputs = [INPUTS.index(name) for name in SOURCES], [joined.outputs.index(name) for name in seen]
    tip, inner_tip = (ca.jacobian(y[outputs[k]], x) for k in (0, 2))
    states, to, back = _coordinates(joined, actuator, x, p, tip)
    a, b, c = ca.jacobian(rate, x), ca.jacobian(rate, u)[:, inputs], ca.jacobian(y, x)[outputs, :]
    whole = [to @ a @ back, to @ b, c @ back, ca.jacobian(y, u)[outputs, inputs]]
    free = zip(("time", *joined.states, *INPUTS), [t, *ca.vertsplit(x), *ca.vertsplit(u)], strict=True)
    if bent := [name for name, one in free if any(ca.depends_on(matrix, one) for matrix in whole)]:
        words = f"what is to stand for it in proofs is not linear: its slopes change with {', '.join(bent)}"
        raise InputError(rig, [(f"effects.{', '.join(names)}", words)])
    masses = ca.vertcat(*(p[joined.parameters.index(f"{side}_end_mass")] for side in ("outer", "inner")))
    bare = [ca.substitute(matrix, masses, ca.DM([0, 0])) for matrix in whole]
    slope = ca.substitute(
        ca.jacobian(whole[0][:, (inner := states.index("inner_displacement_m"))], masses[1]), masses, 0 * masses
    )
    velocity = ca.vertcat(tip, inner_tip) @ back @ bare[0]
    # What a force on the inner tip does: as the spring of the inner beam without a mass there and with a little.
    pushed = -slope / (velocity[1, :] @ bare[0])[inner]
    drawn = random.Random(1984)  # parameters of no particular value: what vanishes for these vanishes for all
    sample = [fmpq(drawn.randrange(10**8, 10**9), drawn.randrange(10**8, 10**9)) for _ in joined.parameters]
    found = [_without_zeros(matrix, p, sample) for matrix in (ca.horzcat(bare[1][:, 0], pushed), velocity, *bare)]
    _check_masses(found, whole[:2], p, sample, masses)
    kept = _driven_or_seen(found, states, actuator.unseen)
    push, velocity, a, b, c, d = found
    found = [push[kept, :], velocity[:, kept], a[kept, kept], b[kept, :], c[:, kept], d]
    function = ca.Function("linear", [p], found, ["p"], ["P", "V", "A", "B", "C", "D"])
    return LinearAssembly(function, tuple(states[k] for k in kept), joined.parameters)


def _coordinates(
    joined: Assembly, actuator: type[Actuator], x: ca.SX, p: ca.SX, tip: ca.SX
) -> tuple[list[str], ca.SX, ca.SX]:
    """Names of the linear states z, and the matrices of z = to x and x = back z."""
    old = dict(zip(joined.states, ca.vertsplit(x), strict=True))
    figure = dict(zip(joined.parameters, ca.vertsplit(p), strict=True))
    unseen = [actuator.unseen] if actuator.unseen else []
    more = [name for name in old if name not in {*_FROM.values(), *actuator.states}]
    states = [*linear_states(actuator), *more, *unseen]
    z = ca.SX.sym("z", len(states))
    new = dict(zip(states, ca.vertsplit(z), strict=True))
    of_old = {_FROM.get(name, name): value for name, value in new.items()}
    without = ca.vertcat(*(0.0 if name in actuator.states else of_old[name] for name in old))
    of_old |= actuator.from_linear(new, figure, tip @ without)  # the tip moves with no state of the actuator
    of_new = {name: old[_FROM.get(name, name)] for name in (*_FROM, *more)} | actuator.to_linear(old, figure, tip @ x)
    to = ca.jacobian(ca.vertcat(*(of_new[name] for name in states)), x)
    return states, to, ca.jacobian(ca.vertcat(*(of_old[name] for name in old)), z)


def _without_zeros(matrix: ca.SX, p: ca.SX, sample: Sequence[fmpq]) -> ca.SX:
    """A matrix without the entries that vanish identically, whose terms CasADi does not cancel."""
    function = ca.Function("entries", [p], [matrix])
    found, kept = evaluate_exactly(function, sample)[0], ca.SX(*matrix.shape)
    for i, j, value in zip(*matrix.sparsity().get_triplet(), found, strict=True):
        if value != 0:
            kept[i, j] = matrix[i, j]
    return kept


def _check_masses(
    found: Sequence[ca.SX], loaded: Sequence[ca.SX], p: ca.SX, sample: Sequence[fmpq], masses: ca.SX
) -> None:
    """Compare E x' = A x + B u with the rates that the assembly has with both end masses."""
    push, velocity, a, b, *_ = found
    inertia = push @ ca.diag(masses) @ velocity
    missing = ca.horzcat(*(rate + inertia @ rate - bare for rate, bare in zip(loaded, (a, b), strict=True)))
    if _without_zeros(missing, p, sample).nnz():
        raise ArithmeticError("an end mass enters this rig otherwise than by the acceleration of its tip")


def _driven_or_seen(found: Sequence[ca.SX], states: Sequence[str], unseen: str) -> list[int]:
    """Places of the states less the unseen one where nothing drives it, or where it shows in nothing."""
    push, velocity, a, b, c, _ = found
    others = [place for place, name in enumerate(states) if name != unseen]
    if not unseen:
        return others
    k = states.index(unseen)
    drives = push[k, :].nnz() + a[k, others].nnz() + b[k, :].nnz()
    shows = velocity[:, k].nnz() + a[others, k].nnz() + c[:, k].nnz()
    return [*others, k] if drives and shows else others


_OPERATIONS: dict[int, Callable[..., fmpq]] = {
    ca.OP_ADD: operator.add,
    ca.OP_SUB: operator.sub,
    ca.OP_MUL: operator.mul,
    ca.OP_DIV: operator.truediv,
    ca.OP_NEG: operator.neg,
    ca.OP_SQ: lambda value: value * value,
    ca.OP_TWICE: lambda value: value + value,
    ca.OP_INV: lambda value: 1 / value,
}


_traced = cache(trace)
"""Read once, since CasADi hands instructions out slowly."""


def evaluate_exactly(function: ca.Function, inputs: Sequence[fmpq]) -> list[list[fmpq]]:
    """Run the instructions of a one-input CasADi SX function in rationals.

    Only rational operations occur in a linearised law: sums, products, quotients, squares and doublings.

    Args:
        function: SX function of one dense vector.
        inputs: that vector's entries.

    Returns:
        one list per output, its structural entries column by column.

    Raises:
        NotImplementedError: at an operation that is not rational.
    """
    traced, work = _traced(function), list[fmpq]()
    for value in traced.values:
        if operation := _OPERATIONS.get(value.code):
            work.append(operation(*[work[place] for place in value.of]))
        elif value.code == ca.OP_INPUT:
            work.append(inputs[value.of[1]])
        elif value.code == ca.OP_CONST:
            work.append(exact(value.constant))
        else:
            raise NotImplementedError(f"CasADi operation {value.code} is not rational")
    return [[work[place] for place in output] for output in traced.outputs]


@cache
def transfer_polynomials(of: LinearAssembly, wanted: tuple[Pairs, ...]) -> ca.Function:
    """Minors of the pencil s E - A, bordered by B, C and D, as functions of the parameters of a linear assembly.

    Of no pair it is the determinant, the plant's denominator d; of one pair of a source and an output the numerator
    from the one to the other; of two it is that of both at once, (N_11 N_22 - N_12 N_21) / d, which is a polynomial
    since a second minor of adj(sE - A) is the determinant times the complementary minor (Jacobi; R. A. Horn and C. R.
    Johnson, Matrix Analysis, 2nd ed. 2013, section 0.8.4).

    Args:
        of: the linear assembly.
        wanted: the minors.

    Returns:
        For each minor four vectors of coefficients in s, ascending, that multiply 1, n, m and m n, the outer end mass
        being m and the inner one n.
    """
    p = ca.SX.sym("p", len(of.parameters))
    outputs = []
    for terms in _minors(of.function.call([p]), wanted, len(of.states)):
        for mass in (0, N, M, M + N):
            powers = [power - mass for power in terms if power - power % M == mass]
            outputs.append(ca.vertcat(*(terms.pop(mass + k, 0) for k in range(max(powers, default=-1) + 1))))
        assert not terms  # each mass acts with rank one
    return ca.Function("transfer_polynomials", [p], ca.cse([ca.densify(one) for one in outputs]))


def _minors(matrices: Sequence[ca.SX], wanted: Sequence[Pairs], size: int) -> list[Terms]:
    """The minors as polynomials in s and both end masses; minors of minors are shared."""
    # The mass forces are unknowns of their own: f = s diag(m, n) V x and (s I - A) x + P f = B u.
    # Rows of outputs are expanded first: each has come past all of the pencil's.
    one, inputs = ca.SX(1), size + 2
    rows: dict[int, dict[int, Terms]] = {k: {k: {S if k < size else 0: one}} for k in range(inputs)}
    past = (-1) ** inputs
    places = ((0, size, 1), (size, 0, -1), (0, 0, -1), (0, inputs, -1), (inputs, 0, past), (inputs, inputs, past))
    for k, (matrix, (below, beside, sign)) in enumerate(zip(matrices, places, strict=True)):
        for i, j in zip(*matrix.sparsity().get_triplet(), strict=True):
            power = (S + M, S + N)[i] if k == 1 else 0
            rows.setdefault(below + i, {}).setdefault(beside + j, {})[power] = sign * matrix[i, j]
    order = _order(rows, inputs)
    reached = [set[int]().union(*(rows[row] for row in order[k:])) for k in range(inputs + 1)]

    @cache
    def minor(border: tuple[int, ...], k: int, columns: tuple[int, ...]) -> Terms:
        if not columns:
            return {0: ca.SX(1)}
        if not border and not reached[k].issuperset(columns):
            return {}
        row, rest = (rows.get(border[0], {}), (border[1:], k)) if border else (rows[order[k]], ((), k + 1))
        total: Terms = {}
        for position, column in enumerate(columns):
            if column in row and (below := minor(*rest, columns[:position] + columns[position + 1 :])):
                for (power, one), (other, two) in product(row[column].items(), below.items()):
                    both, term = total.get(power + other, ca.SX(0)), one * two
                    total[power + other] = both - term if position % 2 else both + term
        return total

    found = []
    for pairs in wanted:
        sources, outputs = ([inputs + pair[k] for pair in pairs] for k in (0, 1))
        found.append(dict(minor(tuple(outputs), 0, (*range(inputs), *sources))))
    return found


def _order(rows: Mapping[int, Mapping[int, Terms]], size: int) -> list[int]:
    """Rows in such an order that few columns at a time are begun and not done with: so there are few minors."""
    left, found, columns = set(range(size)), list[int](), set[int]()

    def begun(row: int) -> set[int]:
        return (columns | set(rows[row])) & set[int]().union(*(rows[other] for other in left if other != row))

    while left:
        found.append(min(sorted(left), key=lambda row: (len(begun(row)), len(rows[row]))))
        columns |= set(rows[found[-1]])
        left.remove(found[-1])
    return found
