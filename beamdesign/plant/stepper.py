"""Runge-Kutta steps over a record, compiled by numba once and kept on disk; the equations come as an address."""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

ERROR, COMMAND = -1, -2
"""Readings of a sampled controller that are not among the outputs: the command less the volts, and the command."""


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


def _steps(
    law: Any,
    output: Any,
    times: Any,
    inputs: Any,
    x: Any,
    checked: Any,
    c: Any,
    substeps: Any,
    bound: Any,
    digital: Any,
    y_out: Any,
) -> Any:
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
    k1, k2, k3, k4, trial = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    y, u0, u1, u2 = np.empty(y_out.shape[1]), np.zeros(3), np.zeros(3), np.zeros(3)
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
                _evaluate(output, t, x, u0, c, y)
                for j in range(checked):
                    if not np.isfinite(x[j]):
                        return k
                if not abs(y[4]) <= bound:
                    return k
                for j in range(y.shape[0]):
                    y_out[k, j] = y[j]
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


_OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True}
try:
    steps = njit(cache=True, **_OPTIONS)(_steps)
except RuntimeError:  # no folder that could be written to; each process then compiles for itself
    steps = njit(**_OPTIONS)(_steps)
