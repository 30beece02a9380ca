"""Records of a rig by generated machine code; see `machine_code` for the equations and `stepper` for the steps.

How many steps a record takes is found here too; what would fill the machine is refused before it is begun. And exact
derivatives of records, and of the rig's equilibrium, with respect to its parameters.

The tangent of the very Runge-Kutta scheme is carried along with the states: S' = (df/dx) S + df/dp in every stage, S
being dx/dp (forward sensitivities; Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, 2nd ed. 1993,
section I.14, and internal differentiation after Bock, 1981, for the scheme's own tangent). What comes out is thus the
derivative of what `integrate` computes, not of the flow that it approximates.

At a kink of a law (a stop, a deadband's edge, friction at rest) the derivative is that of one side. The laws are
continuous, so that a record that crosses kinks is still differentiable where the crossings are transversal. There the
derivative of fixed steps approaches that of the motion in first order of the step only: with hard contact it may be off
by some ten per cent at steps at which the record itself is right to 1e-4, and shorter `substeps` mend it.
"""

from collections.abc import Iterable, Sequence
from functools import cache
from math import ceil, log
from operator import itemgetter

import casadi as ca
import numpy as np

from beamdesign.plant.assembly import Assembly, Structure, assemble
from beamdesign.plant.component import SAMPLED
from beamdesign.plant.equilibrium import linearise, not_held, scales
from beamdesign.plant.machine_code import Body, MachineCode, Trace, machine_code, trace
from beamdesign.records import InputError

NOT_SAMPLED = np.zeros(6)


@cache
def compiled(kinds: Structure) -> MachineCode:
    """Machine code of a structure's equations: functions `law` (rates of the states) and `output`."""
    traced = trace(assemble(kinds).function)

    def stored(which: int, body: Body) -> None:
        for entry, value in enumerate(traced.outputs[which]):
            body.store(body.read(value), "out", entry)

    return machine_code(traced.values, {"law": lambda body: stored(0, body), "output": lambda body: stored(1, body)})


def integrate(
    kinds: Structure,
    times: np.ndarray,
    inputs: np.ndarray,
    start: np.ndarray,
    parameters: np.ndarray,
    substeps: int,
    bound: float,
    digital: np.ndarray = NOT_SAMPLED,
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs of a rig over a record by fixed-step Runge-Kutta of fourth order, and its states at the end.

    Args:
        kinds: structure of the rig.
        times: (N,) equally spaced, s.
        inputs: (2 substeps (N - 1) + 1, 2) disturbance (N) and command (V) at every half step.
        start: (n,) states at the first time.
        parameters: in the order of the assembly.
        substeps: steps per sample interval.
        bound: of the fifth output, the displacement of the outer tip (m), at which the record ends.
        digital: the sampled controller, see `beamdesign.simulation.SampledLaw`.

    Returns:
        (M, 6) outputs as in `Assembly.outputs`; M < N where the rig passed the bound, or left the numbers, after M
        samples. And the states (n,) at the last sample that was kept, to go on from.
    """
    code, width = compiled(kinds), len(assemble(kinds).outputs)
    return stepped(code, times, inputs, start, len(start), parameters, substeps, bound, digital, width)


def stepped(
    code: MachineCode,
    times: np.ndarray,
    inputs: np.ndarray,
    start: np.ndarray,
    checked: int,
    parameters: np.ndarray,
    substeps: int,
    bound: float,
    digital: np.ndarray,
    width: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Rows (M, width) of a code's `output` along the record that its `law` makes, and the states at the last of them.

    Args:
        code: functions `law` and `output`, the fifth of whose entries is held against `bound`.
        times: (N,) s.
        inputs: (2 substeps (N - 1) + 1, 2).
        start: (n,) whatever the law takes as states.
        checked: how many of them, from the first, must stay finite.
        parameters: of the code's `prepare`.
        substeps: steps per sample interval.
        bound: m.
        digital: as of `beamdesign.plant.stepper`.
        width: entries that `output` gives.
    """
    from beamdesign.plant.stepper import steps

    if len(inputs) != 2 * substeps * (len(times) - 1) + 1:
        raise ValueError(f"{len(inputs)} input points do not fit {len(times)} samples of {substeps} steps")
    y, state = np.zeros((len(times), width)), np.array(start, dtype=float)
    kept = steps(
        code.address["law"],
        code.address["output"],
        np.ascontiguousarray(times, dtype=float),
        np.ascontiguousarray(inputs, dtype=float),
        state,
        int(checked),
        code.prepared(parameters),
        int(substeps),
        float(bound),
        np.ascontiguousarray(digital, dtype=float),
        y,
    )
    return y[:kept], state


LONGEST_STEP_S = 1e-4
MOST_STEPS = 20_000_000
"""Of one record: half a minute, and about a gigabyte of inputs."""
_NUDGE = 1 + 1e-6  # on each figure, to find those that the fastest pole comes from

Place = tuple[np.ndarray, np.ndarray]
"""States and inputs about which a rig is linearised."""


def substeps_at(
    assembly: Assembly, places: Iterable[Place], parameters: np.ndarray, times: np.ndarray, steps_per_radian: float
) -> int:
    """Steps per sample: at most 0.1 ms each, and so many per radian of the fastest pole at any of the places.

    Args:
        assembly: the rig.
        places: where its poles are looked at.
        parameters: in the assembly's order.
        times: (N,) s, at least two, equally spaced but for their jitter.
        steps_per_radian: of the fastest pole.

    Raises:
        InputError: where the record would take more than `MOST_STEPS`, naming the figures that make it so stiff.
    """
    rates = [(1.0, None), *((_fastest_pole(assembly, place, parameters), place) for place in places)]
    fastest, stiffest = max(rates, key=itemgetter(0))
    sample_s = (times[-1] - times[0]) / (len(times) - 1)
    needed = sample_s / min(LONGEST_STEP_S, 1 / (steps_per_radian * fastest)) - 1e-9
    if stiffest is not None:
        reason = _why(assembly, stiffest, parameters) if needed * len(times) > MOST_STEPS else ""
        refuse_too_many(needed * len(times), "(figures)", reason)
    return max(1, ceil(needed))


def refuse_too_many(steps: float, key: str, reason: str) -> None:
    """Refuse a record of too many steps.

    Raises:
        InputError: naming the key and the reason why so many are needed.
    """
    if not steps <= MOST_STEPS:
        words = f"{reason}, so that a record takes {steps:.3g} integration steps; {MOST_STEPS:.3g} are the most"
        raise InputError("simulation", [(key, words)])


def _fastest_pole(assembly: Assembly, place: Place, parameters: np.ndarray) -> float:
    """Modulus of the fastest pole, rad/s; infinite where the equations leave the numbers."""
    a = linearise(assembly, *place, parameters).a
    return float(np.abs(np.linalg.eigvals(a)).max()) if np.isfinite(a).all() else np.inf


def _why(assembly: Assembly, place: Place, parameters: np.ndarray) -> str:
    """The three figures that move the fastest pole most."""
    fastest, moved = _fastest_pole(assembly, place, parameters), []
    for k, (name, value) in enumerate(zip(assembly.parameters, parameters, strict=True)):
        nudged = parameters.copy()
        nudged[k] *= _NUDGE
        moved.append((abs(log(_fastest_pole(assembly, place, nudged) / fastest)), f"{name} {value:g}"))
    words = ", ".join(words for _, words in sorted(moved, reverse=True)[:3])
    return f"the fastest motion is of {fastest / (2 * np.pi):.3g} Hz, above all by {words} in SI"


_LANES = 8  # widest vector of doubles a processor has; LLVM splits it for others


def integrate_with_sensitivities(
    kinds: Structure,
    times: np.ndarray,
    inputs: np.ndarray,
    start: np.ndarray,
    start_sensitivity: np.ndarray,
    parameters: np.ndarray,
    free: Sequence[str],
    substeps: int,
    bound: float,
    outputs: Sequence[int] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs of a record as `compiled.integrate` gives them, and their derivatives.

    Args:
        kinds: structure of the rig, with a continuous controller.
        times: (N,) equally spaced, s.
        inputs: (2 substeps (N - 1) + 1, 2) disturbance (N) and command (V) at every half step.
        start: (n,) states at the first time.
        start_sensitivity: (n, P) their derivatives, as from `equilibrium_sensitivity`.
        parameters: in the order of the assembly.
        free: names of the P parameters to differentiate by, as in `Assembly.parameters`.
        substeps: steps per sample interval.
        bound: of the fifth output, the displacement of the outer tip (m), at which the record ends.
        outputs: positions in `Assembly.outputs` of the K outputs whose derivatives are asked for; all unless given.

    Returns:
        y: (M, 6) outputs; M < N where the rig passed the bound, or left the numbers, after M samples.
        dy: (M, K, P) derivatives, per unit of each parameter.

    Raises:
        ValueError: at a sampled controller, an unknown parameter, or shapes that do not fit.
    """
    if kinds.controller == SAMPLED:
        raise ValueError("sensitivities are those of a continuous controller")
    if start_sensitivity.shape != (len(start), len(free)):
        raise ValueError(f"start sensitivity of {start_sensitivity.shape}, not {(len(start), len(free))}")
    count = len(assemble(kinds).outputs)
    chosen = tuple(range(count)) if outputs is None else tuple(outputs)
    code = compiled_with_sensitivities(kinds, tuple(free), chosen)
    whole = np.concatenate([np.asarray(start, dtype=float), np.asarray(start_sensitivity, dtype=float).ravel()])
    width = count + len(chosen) * len(free)
    rows, _ = stepped(code, times, inputs, whole, len(start), parameters, substeps, bound, NOT_SAMPLED, width)
    return rows[:, :count], rows[:, count:].reshape(len(rows), len(chosen), len(free))


def equilibrium_sensitivity(
    assembly: Assembly, x: np.ndarray, u: np.ndarray, parameters: np.ndarray, free: Sequence[str]
) -> np.ndarray:
    """Derivatives (n, P) of an equilibrium by the implicit function theorem.

    States that `equilibrium` holds (the `memory` of effects) do not move. Where the remaining equations do not
    determine the equilibrium (as within play), it is the smallest change, in typical magnitudes, that satisfies them.

    Args:
        assembly: the rig.
        x: (n,) states that `equilibrium` found.
        u: (3,) inputs.
        parameters: in the assembly's order.
        free: names of the P parameters to differentiate by.

    Raises:
        ValueError: at an unknown parameter.
    """
    names = tuple(free)
    of_states, of_parameters = (np.asarray(value) for value in _rest(assembly.kinds, names)(0.0, x, u, parameters))
    moving = not_held(assembly)
    weight = scales(assembly)[moving]
    scaled = of_states[np.ix_(moving, moving)] / weight[:, None] * weight[None, :]
    change = np.zeros((len(x), len(names)))
    right = -of_parameters[moving] / weight[:, None]
    if np.linalg.cond(scaled) < 1e14:
        change[moving] = weight[:, None] * np.linalg.solve(scaled, right)
    else:
        change[moving] = weight[:, None] * np.linalg.lstsq(scaled, right, rcond=1e-13)[0]
    return change


@cache
def _rest(kinds: Structure, free: tuple[str, ...]) -> ca.Function:
    assembly = assemble(kinds)
    t, x, u, p = assembly.function.sx_in()
    rate, _ = assembly.function(t, x, u, p)
    matrices = [ca.densify(ca.jacobian(rate, x)), ca.densify(ca.jacobian(rate, p)[:, _places(assembly, free)])]
    return ca.Function("rest", [t, x, u, p], matrices)


def _places(assembly: Assembly, free: tuple[str, ...]) -> list[int]:
    """Where among the parameters of an assembly the free ones are."""
    unknown = [name for name in free if name not in assembly.parameters]
    if unknown:
        raise ValueError(f"no parameter {', '.join(unknown)} in this structure")
    return [assembly.parameters.index(name) for name in free]


@cache
def compiled_with_sensitivities(kinds: Structure, free: tuple[str, ...], outputs: tuple[int, ...]) -> MachineCode:
    """Machine code whose states are x, then S row by row, and whose output is y, then its derivatives row by row."""
    assembly = assemble(kinds)
    t, x, u, p = assembly.function.sx_in()
    rate, y = assembly.function(t, x, u, p)
    rows, chosen = y[list(outputs)], _places(assembly, free)
    jacobians = [ca.jacobian(a, b) for a in (rate, rows) for b in (x, p)]
    jacobians[1], jacobians[3] = jacobians[1][:, chosen], jacobians[3][:, chosen]
    function = ca.Function("sensitivity", [t, x, u, p], ca.cse([ca.densify(rate), ca.densify(y), *jacobians]))
    traced = trace(function)

    def stored(which: int, first: int, body: Body) -> None:
        for entry, value in enumerate(traced.outputs[which]):
            body.store(body.read(value), "out", entry)
        a, b = (_rows(traced, function, first + k) for k in range(2))
        _product(body, a, b, len(assembly.states), len(traced.outputs[which]), len(free))

    return machine_code(
        traced.values, {"law": lambda body: stored(0, 2, body), "output": lambda body: stored(1, 4, body)}
    )


Rows = list[list[tuple[int, int]]]
"""Of a sparse matrix: per row its columns and the values there, by position in a trace."""


def _rows(traced: Trace, function: ca.Function, output: int) -> Rows:
    shape = function.sparsity_out(output)
    rows: Rows = [[] for _ in range(shape.size1())]
    for row, column, value in zip(*shape.get_triplet(), traced.outputs[output], strict=True):
        rows[row].append((column, value))
    return rows


def _product(body: Body, a: Rows, b: Rows, states: int, before: int, width: int) -> None:
    """Write out A S + B row by row behind the first entries of `out`; S follows the states in `x` likewise."""
    for row, (of_states, of_parameters) in enumerate(zip(a, b, strict=True)):
        first = 0
        while first < width:
            lanes = next(size for size in (_LANES, 4, 2, 1) if size <= width - first)
            kind, total = f"<{lanes} x double>", "zeroinitializer"
            for column, value in of_parameters:
                if first <= column < first + lanes:
                    total = body.line(f"insertelement {kind} {total}, double {body.read(value)}, i32 {column - first}")
            for column, value in of_states:
                s = body.load("x", states + column * width + first, kind)
                single = body.line(f"insertelement {kind} poison, double {body.read(value)}, i32 0")
                spread = body.line(f"shufflevector {kind} {single}, {kind} poison, <{lanes} x i32> zeroinitializer")
                part = body.line(f"fmul contract {kind} {spread}, {s}")
                total = part if total == "zeroinitializer" else body.line(f"fadd contract {kind} {total}, {part}")
            body.store(total, "out", before + row * width + first, kind)
            first += lanes
