"""Records of a rig, and their exact derivatives by its parameters, by Runge-Kutta steps of generated machine code.

The steps are compiled by numba once and kept on disk; the equations come as an address, see `machine_code`.

The tangent of the very Runge-Kutta scheme is carried along with the states: S' = (df/dx) S + df/dp in every stage, S
being dx/dp (forward sensitivities; Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, 2nd ed. 1993,
section I.14, and internal differentiation after Bock, 1981, for the scheme's own tangent). What comes out is thus the
derivative of what `integrate` computes, not of the flow that it approximates.

At a kink of a law (a stop, a deadband's edge, friction at rest) the derivative is that of one side. The laws are
continuous, so that a record that crosses kinks is still differentiable where the crossings are transversal. There the
derivative of fixed steps approaches that of the motion in first order of the step only: with hard contact it may be off
by some ten per cent at steps at which the record itself is right to 1e-4, and shorter `substeps` mend it.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, TypeVar

import casadi as ca
import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from beamdesign.plant.assembly import Structure, assemble
from beamdesign.plant.component import SAMPLED
from beamdesign.plant.equilibrium import MOST_STEPS, places_of, scales
from beamdesign.plant.machine_code import Body, MachineCode, add_product, machine_code, rows_of, trace
from beamdesign.sampling import COMMAND, ERROR

NOT_SAMPLED = np.zeros(6)
_KEPT = 512  # structures, about 0.7 MB each: more than one diagnosis meets, so that many in a row do not fill a machine


@lru_cache(_KEPT)
def compiled(kinds: Structure, free: tuple[str, ...] = (), outputs: tuple[int, ...] = ()) -> MachineCode:
    """Machine code of a structure's equations: functions `law` (rates of the states) and `output`.

    With free parameters its states are x, then S row by row, and its output is y, then the derivatives of the outputs
    named by their places, row by row.
    """
    assembly = assemble(kinds)
    function = assembly.function
    if free:
        t, x, u, p = function.sx_in()
        rate, y = function(t, x, u, p)
        jacobians = [ca.jacobian(a, b) for a in (rate, y[list(outputs)]) for b in (x, p)]
        chosen = places_of(assembly, free)
        jacobians[1], jacobians[3] = jacobians[1][:, chosen], jacobians[3][:, chosen]
        function = ca.Function("sensitivity", [t, x, u, p], ca.cse([ca.densify(rate), ca.densify(y), *jacobians]))
    traced = trace(function)

    def stored(which: int, body: Body) -> None:
        for entry, value in enumerate(traced.outputs[which]):
            body.store(body.read(value), "out", entry)
        if free:
            a, b = (rows_of(traced, function, 2 * which + 2 + k) for k in range(2))
            add_product(body, a, b, len(assembly.states), len(traced.outputs[which]), len(free))

    return machine_code(traced.values, {"law": lambda body: stored(0, body), "output": lambda body: stored(1, body)})


def half_steps(samples: np.ndarray, substeps: int) -> np.ndarray:
    """Samples interpolated to every half integration step by cubics through four neighbours.

    Args:
        samples: (N, m), N at least 4.
        substeps: steps per sample interval.

    Returns:
        (2 substeps (N - 1) + 1, m), the samples themselves among them.
    """
    share = np.arange(2 * substeps) / (2 * substeps)
    nodes = (-1.0, 0.0, 1.0, 2.0)
    factors = ([(share - other) / (node - other) for other in nodes if other != node] for node in nodes)
    weights = np.column_stack([np.prod(part, axis=0) for part in factors])
    # At both ends the neighbour that is missing lies on the cubic through the first (last) four samples.
    ghost = np.array([4.0, -6.0, 4.0, -1.0])
    padded = np.vstack([ghost @ samples[:4], samples, ghost @ samples[:-5:-1]])
    windows = np.lib.stride_tricks.sliding_window_view(padded, 4, axis=0)
    fine = np.einsum("nmk,sk->nsm", windows, weights, optimize=True).reshape(-1, samples.shape[1])
    return np.vstack([fine, samples[-1:]])


FINE_S = 0.5e-3
"""Interval up to which cubics tell a measured input between its samples."""


def measured_half_steps(samples: np.ndarray, step_s: float, substeps: int) -> np.ndarray:
    """What was measured of inputs, interpolated to every half integration step.

    Midway between samples, cubics through four neighbours lose 2 % of what lies at 0.15 of the sampling rate, which is
    300 Hz at `FINE_S`, and 22 % at twice that. So inputs that were sampled more coarsely are taken as band-limited: a
    straight line from end to end, and sines that begin and end at it.

    Args:
        samples: (N, m), N at least 4.
        step_s: sampling interval.
        substeps: steps per sample interval.

    Returns:
        (2 substeps (N - 1) + 1, m), the samples themselves among them.
    """
    if step_s <= (1 + 1e-6) * FINE_S:
        return half_steps(samples, substeps)
    count, parts = len(samples) - 1, 2 * substeps
    fine = np.linspace(samples[0], samples[-1], count * parts + 1)
    for column, spectrum in enumerate(beyond_line(samples).T):
        fine[:, column] += parts * np.fft.irfft(spectrum, 2 * count * parts)[: len(fine)]
    return fine


def beyond_line(samples: np.ndarray) -> np.ndarray:
    """Spectrum of samples less the straight line from end to end, continued as its point reflection about its ends.

    Args:
        samples: (N, m).

    Returns:
        (N, m), of the 2 (N - 1) samples of a period, as `numpy.fft.rfft` gives it.
    """
    beyond = samples - np.linspace(samples[0], samples[-1], len(samples))
    return np.asarray(np.fft.rfft(np.concatenate([beyond, -beyond[-2:0:-1]]), axis=0))


def integrate(
    kinds: Structure,
    times: np.ndarray,
    inputs: np.ndarray,
    start: np.ndarray,
    parameters: np.ndarray,
    substeps: int,
    bound: float,
    digital: np.ndarray = NOT_SAMPLED,
    free: tuple[str, ...] = (),
    derived: tuple[int, ...] = (),
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs of a rig over a record by fixed-step Runge-Kutta of fourth order, and its states at the end.

    Args:
        kinds: structure of the rig.
        times: (N,) equally spaced, s.
        inputs: (2 substeps (N - 1) + 1, 2) disturbance (N) and command (V) at every half step.
        start: (n,) states at the first time; behind them, with free parameters, their derivatives row by row.
        parameters: in the order of the assembly.
        substeps: steps per sample interval.
        bound: of the fifth output, the displacement of the outer tip (m), at which the record ends.
        digital: the sampled controller, see `beamdesign.sampling`.
        free: parameters to differentiate by, see `integrate_with_sensitivities`.
        derived: positions of the outputs whose derivatives follow them, row by row.

    Returns:
        (M, 6) outputs as in `Assembly.outputs`; M < N where the rig passed the bound, or left the numbers, after M
        samples. And the states at the last sample that was kept, to go on from.
    """
    if len(inputs) != 2 * substeps * (len(times) - 1) + 1:
        raise ValueError(f"{len(inputs)} input points do not fit {len(times)} samples of {substeps} steps")
    assembly, code = assemble(kinds), compiled(kinds, free, derived)
    y, state = np.zeros((len(times), len(assembly.outputs) + len(derived) * len(free))), np.array(start, dtype=float)
    address, c = (code.address["law"], code.address["output"]), code.prepared(parameters)
    times, inputs, digital = (np.ascontiguousarray(given, dtype=float) for given in (times, inputs, digital))
    checked = len(assembly.states)
    kept = steps(*address, times, inputs, state, checked, c, int(substeps), float(bound), digital, y)
    return y[:kept], state


Motion = TypeVar("Motion")
_APART, _DOUBLINGS, _ROUNDING = 1e-2, 6, 1e-8  # of an output's peak; at most; of a usual size


def refined(
    course: Callable[[int], Motion], of: Callable[[Motion], np.ndarray], outputs: Sequence[str], steps: int
) -> tuple[Motion, int]:
    """A motion at no more steps than it takes for twice as many to give the same.

    How stiff a rig gets under way nothing tells before: a valve that is open, or a curve far out, is not as at rest.

    Args:
        course: gives the motion at so many times the usual steps.
        of: its outputs (M, k); M less where it ends sooner.
        outputs: names of the k.
        steps: usual ones in all; no more than `MOST_STEPS` are tried.

    Returns:
        The motion, and up to which sample the outputs of twice as many steps are the same; M where they are throughout,
        and where twice the usual ones are too many.
    """
    found = course(1)
    same = len(of(found))
    for factor in (2**k for k in range(1, _DOUBLINGS + 1)):
        if factor * steps > MOST_STEPS:
            break
        finer = course(factor)
        y, z = of(found), of(finer)
        both = min(len(y), len(z))
        apart = np.abs(y[:both] - z[:both]) > _APART * np.abs(z).max(axis=0) + _ROUNDING * scales(outputs)
        same = int(apart.any(axis=1).argmax()) if apart.any() else both
        if same == len(y) == len(z):
            break
        found = finer
    return found, same


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
    """Outputs of a record as `integrate` gives them, and their derivatives.

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
    whole = np.concatenate([np.asarray(start, dtype=float), np.asarray(start_sensitivity, dtype=float).ravel()])
    asked = tuple(free), chosen
    rows, _ = integrate(kinds, times, inputs, whole, parameters, substeps, bound, NOT_SAMPLED, *asked)
    return rows[:, :count], rows[:, count:].reshape(len(rows), len(chosen), len(free))


def _call(typing: Any, address: Any, t: Any, x: Any, u: Any, c: Any, out: Any) -> Any:
    """Call the function (t, x, u, c, out) at an address; all but t are contiguous arrays of doubles."""

    def lower(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        arrays = [
            context.make_array(kind)(context, builder, value).data
            for kind, value in zip(signature.args[2:], arguments[2:], strict=True)
        ]
        kind = ir.FunctionType(ir.VoidType(), [ir.DoubleType(), *(array.type for array in arrays)])
        builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), [arguments[1], *arrays])
        return context.get_dummy_value()

    return types.void(address, t, x, u, c, out), lower


_evaluate: Any = intrinsic(_call)


def _steps(law, output, times, inputs, x, checked, c, substeps, bound, digital, y_out):  # type: ignore[no-untyped-def]
    """Classical Runge-Kutta over a record; gives the number of samples that stayed finite and within `bound`.

    Args:
        law: address of the function that gives the rates of x.
        output: address of the function that gives one row of `y_out`.
        times: (N,) s.
        inputs: (2 substeps (N - 1) + 1, 2).
        x: (n,) states at the start; overwritten.
        checked: how many of them, from the first, must stay finite.
        c: what `prepare` left.
        substeps: steps per sample interval.
        bound: of the fifth output.
        digital: the sampled controller z+ = A z + B e, i = C z + D e: period in steps or 0, delay in periods, least
            volt, current before the record, n, k, what each of the k readings is (`ERROR`, `COMMAND` or a place among
            the outputs), A and B above C and D row by row, z at the first sample.
        y_out: (N, m) filled row by row.
    """
    samples, n = times.shape[0], x.shape[0]
    k1, k2, k3, k4, trial = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    y, u0, u1, u2 = np.zeros(y_out.shape[1]), np.zeros(3), np.zeros(3), np.zeros(3)
    period, delay = int(digital[0]), int(digital[1])
    queue = np.full(delay + 1, digital[3])
    held, ticks, order, sensed = digital[3], 0, int(digital[4]), int(digital[5])
    width = order + sensed
    entries = 6 + sensed
    own = entries + (order + 1) * width  # where z begins
    given, after = np.zeros(width), np.zeros(order + 1)
    given[:order] = digital[own : own + order]
    if period == 0:
        held = 0.0
    for k in range(samples):
        last = k + 1 == samples
        h = 0.0 if last else (times[k + 1] - times[k]) / substeps
        for sub in range(substeps):
            half = 2 * (k * substeps + sub)
            t = times[k] + sub * h
            u0[0], u0[1], u0[2] = inputs[half, 0], inputs[half, 1], held
            if period > 0 and half % (2 * period) == 0:
                _evaluate(output, t, x, u0, c, y)
                for j in range(sensed):
                    place = int(digital[6 + j])
                    if place == ERROR:
                        volts = y[5]
                        if digital[2] > 0.0:
                            volts = digital[2] * np.floor(volts / digital[2] + 0.5)
                        given[order + j] = u0[1] - volts
                    elif place == COMMAND:
                        given[order + j] = u0[1]
                    else:
                        given[order + j] = y[place]
                for i in range(order + 1):
                    total = 0.0
                    for j in range(width):
                        total += digital[entries + i * width + j] * given[j]
                    after[i] = total
                given[:order] = after[:order]
                queue[ticks % (delay + 1)] = after[order]
                held = queue[(ticks + 1) % (delay + 1)]
                ticks += 1
                u0[2] = held
            if sub == 0:
                _evaluate(output, t, x, u0, c, y_out[k])
                for j in range(checked):
                    if not abs(x[j]) < np.inf:
                        return k
                if not abs(y_out[k, 4]) <= bound:
                    return k
                if last:
                    return samples
            u1[0], u1[1], u1[2] = inputs[half + 1, 0], inputs[half + 1, 1], held
            u2[0], u2[1], u2[2] = inputs[half + 2, 0], inputs[half + 2, 1], held
            _evaluate(law, t, x, u0, c, k1)
            for j in range(n):
                trial[j] = x[j] + 0.5 * h * k1[j]
            _evaluate(law, t + 0.5 * h, trial, u1, c, k2)
            for j in range(n):
                trial[j] = x[j] + 0.5 * h * k2[j]
            _evaluate(law, t + 0.5 * h, trial, u1, c, k3)
            for j in range(n):
                trial[j] = x[j] + h * k3[j]
            _evaluate(law, t + h, trial, u2, c, k4)
            for j in range(n):
                x[j] += h / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j])
    return samples


def as_machine_code(function: Any, **options: Any) -> Any:
    """A function that is compiled when it is called first, and kept for other processes."""
    try:
        return njit(cache=True, **options)(function)
    except RuntimeError:  # no folder that could be written to; each process then compiles for itself
        return njit(**options)(function)


steps = as_machine_code(_steps, error_model="numpy", nogil=True)
