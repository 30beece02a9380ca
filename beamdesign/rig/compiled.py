"""A rig's equations as machine code: straight-line Python written out from CasADi instructions, compiled by numba.

No compiler is needed on the machine, and nothing is kept on disk; the first record of a new structure waits for the
compilation, all later ones (other figures, other payloads) do not.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from beamdesign.rig.assembly import INPUTS, OUTPUTS, Structure, assemble

_BINARY = {
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_POW: "{0} ** {1}",
    ca.OP_CONSTPOW: "{0} ** {1}",
    ca.OP_FMIN: "min({0}, {1})",
    ca.OP_FMAX: "max({0}, {1})",
    ca.OP_LT: "1.0 if {0} < {1} else 0.0",
    ca.OP_LE: "1.0 if {0} <= {1} else 0.0",
    ca.OP_EQ: "1.0 if {0} == {1} else 0.0",
    ca.OP_NE: "1.0 if {0} != {1} else 0.0",
    ca.OP_AND: "1.0 if {0} != 0.0 and {1} != 0.0 else 0.0",
    ca.OP_OR: "1.0 if {0} != 0.0 or {1} != 0.0 else 0.0",
    ca.OP_IF_ELSE_ZERO: "{1} if {0} != 0.0 else 0.0",
}
_UNARY = {
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_SQRT: "math.sqrt({0})",
    ca.OP_EXP: "math.exp({0})",
    ca.OP_LOG: "math.log({0})",
    ca.OP_SIN: "math.sin({0})",
    ca.OP_COS: "math.cos({0})",
    ca.OP_TANH: "math.tanh({0})",
    ca.OP_FABS: "abs({0})",
    ca.OP_SIGN: "(1.0 if {0} > 0.0 else 0.0) - (1.0 if {0} < 0.0 else 0.0)",
    ca.OP_NOT: "1.0 if {0} == 0.0 else 0.0",
    ca.OP_ASSIGN: "{0}",
}


@dataclass(frozen=True)
class Source:
    """Python source of a rig's equations.

    Attributes:
        prepare: `prepare(p, c)` fills c with what depends on parameters alone, worked out once per record.
        law: `law(t, x, u, c, rate, y)` fills its last two.
        constants: length of c.
    """

    prepare: str
    law: str
    constants: int


_ARGUMENTS = ("t", "x", "u", "p")
_PARAMETERS = 3


def source(function: ca.Function) -> Source:
    """Write out the instructions of a CasADi SX function (t, x, u, p) -> (rate, y) as straight lines of Python.

    Raises:
        NotImplementedError: at an operation that has no line of Python here.
    """
    held: dict[int, str] = {}  # what each work register holds
    early: list[str] = []
    late: list[str] = []
    fixed: set[str] = set()  # names that depend on parameters alone
    kept: dict[str, int] = {}  # those of them that the law reads, and where

    def read(register: int) -> str:
        name = held[register]
        if name not in fixed or not name.startswith("v"):
            return name
        return f"c[{kept.setdefault(name, len(kept))}]"

    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        target, origin = function.instruction_output(k), function.instruction_input(k)
        if code == ca.OP_OUTPUT:
            late.append(f"{('rate', 'y')[target[0]]}[{target[1]}] = {read(origin[0])}")
            continue
        name = f"v{k}"
        if code == ca.OP_CONST:
            name = f"({float(function.instruction_constant(k))!r})"
            fixed.add(name)
        elif code == ca.OP_INPUT:
            argument = _ARGUMENTS[origin[0]]
            line = f"{name} = {argument}" + ("" if argument == "t" else f"[{origin[1]}]")
            (early if origin[0] == _PARAMETERS else late).append(line)
            fixed |= {name} if origin[0] == _PARAMETERS else set()
        elif code in _BINARY or code in _UNARY:
            pattern = _BINARY.get(code) or _UNARY[code]
            sources = origin if code in _BINARY else origin[:1]
            if all(held[register] in fixed for register in sources):
                fixed.add(name)
                early.append(f"{name} = " + pattern.format(*(held[register] for register in sources)))
            else:
                late.append(f"{name} = " + pattern.format(*(read(register) for register in sources)))
        else:
            raise NotImplementedError(f"CasADi operation {code}")
        held[target[0]] = name
    early += [f"c[{slot}] = {name}" for name, slot in kept.items()]
    return Source(_function("prepare(p, c)", early), _function("law(t, x, u, c, rate, y)", late), len(kept))


def _function(head: str, lines: list[str]) -> str:
    return f"def {head}:\n    " + "\n    ".join([*lines, "return"]) + "\n"


def _integrate(
    law: Any, times: Any, inputs: Any, x: Any, c: Any, substeps: int, bound: float, digital: Any, y_out: Any
) -> int:
    """Classical Runge-Kutta over a record; gives the number of samples that stayed finite and within `bound`.

    `inputs` holds 2 * substeps points per sample interval. `digital` is (period in half steps or 0, delay in periods,
    gain, b0, b1, a1, least volt): the sampled controller's law i = gain (b0 e + b1 e_old) - a1 i_old.
    """
    samples = times.shape[0]
    n, m = x.shape[0], inputs.shape[1]
    k1, k2, k3, k4, trial = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    y, u0, u1, u2 = np.empty(y_out.shape[1]), np.empty(m), np.empty(m), np.empty(m)
    period, delay = int(digital[0]), int(digital[1])
    queue = np.zeros(delay + 1)
    old_error, old_current, ticks = digital[7], digital[8], 0
    queue[:] = digital[8]
    held = digital[8]
    for k in range(samples):
        sub = 0
        while True:
            half = 2 * (k * substeps + sub)
            h = (times[k + 1] - times[k]) / substeps if k + 1 < samples else 0.0
            t = times[k] + sub * h
            for j in range(m):
                u0[j] = inputs[half, j]
            if period > 0 and half % (2 * period) == 0:
                u0[2] = held
                law(t, x, u0, c, k1, y)
                volts = y[5]
                if digital[6] > 0.0:
                    volts = digital[6] * np.floor(volts / digital[6] + 0.5)
                error = u0[1] - volts
                old_current = digital[2] * (digital[3] * error + digital[4] * old_error) - digital[5] * old_current
                old_error = error
                queue[ticks % (delay + 1)] = old_current
                held = queue[(ticks + 1) % (delay + 1)]
                ticks += 1
            if period > 0:
                u0[2] = held
            law(t, x, u0, c, k1, y)
            if sub == 0:
                ok = True
                for j in range(n):
                    ok = ok and np.isfinite(x[j])
                if not ok or not abs(y[4]) <= bound:
                    return k
                for j in range(y.shape[0]):
                    y_out[k, j] = y[j]
                if k + 1 == samples:
                    return samples
            for j in range(m):
                u1[j], u2[j] = inputs[half + 1, j], inputs[half + 2, j]
            if period > 0:
                u1[2], u2[2] = held, held
            for j in range(n):
                trial[j] = x[j] + 0.5 * h * k1[j]
            law(t + 0.5 * h, trial, u1, c, k2, y)
            for j in range(n):
                trial[j] = x[j] + 0.5 * h * k2[j]
            law(t + 0.5 * h, trial, u1, c, k3, y)
            for j in range(n):
                trial[j] = x[j] + h * k3[j]
            law(t + h, trial, u2, c, k4, y)
            for j in range(n):
                x[j] += h / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j])
            sub += 1
            if sub == substeps:
                break
    return samples


@cache
def _stepper() -> Any:
    import numba

    return numba.njit(_integrate, error_model="numpy")


@dataclass(frozen=True)
class Compiled:
    """Machine code of a structure's equations; see `Source` for the two functions."""

    prepare: Callable[..., None]
    law: Callable[..., None]
    constants: int


@cache
def compiled(kinds: Structure) -> Compiled:
    """Write out and hand over to numba the equations of a structure; numba compiles at the first call."""
    import math

    import numba

    written = source(assemble(kinds).function)
    space: dict[str, Any] = {"math": math}
    exec(written.prepare, space)
    exec(written.law, space)
    return Compiled(
        numba.njit(space["prepare"], error_model="numpy"),
        numba.njit(space["law"], error_model="numpy"),
        written.constants,
    )


NOT_SAMPLED = np.zeros(9)


def integrate(
    kinds: Structure,
    times: np.ndarray,
    inputs: np.ndarray,
    start: np.ndarray,
    parameters: np.ndarray,
    substeps: int,
    bound: float,
    digital: np.ndarray = NOT_SAMPLED,
) -> np.ndarray:
    """Outputs of a rig over a record by fixed-step Runge-Kutta of fourth order.

    Args:
        kinds: structure of the rig.
        times: (N,) equally spaced, s.
        inputs: (2 substeps (N - 1) + 1, 2) disturbance (N) and command (V) at every half step.
        start: (n,) states at the first time.
        parameters: in the order of the assembly.
        substeps: steps per sample interval.
        bound: displacement of the outer tip (m) at which the record ends.
        digital: the sampled controller, see `beamdesign.sampled`.

    Returns:
        (M, 6) outputs as in `assembly.OUTPUTS`; M < N where the rig passed the bound after M samples.
    """
    if len(inputs) != 2 * substeps * (len(times) - 1) + 1:
        raise ValueError(f"{len(inputs)} input points do not fit {len(times)} samples of {substeps} steps")
    given = np.zeros((len(inputs), len(INPUTS)))
    given[:, :2] = inputs
    y = np.zeros((len(times), len(OUTPUTS)))
    code = compiled(kinds)
    constants = np.zeros(code.constants)
    code.prepare(parameters, constants)
    kept = _stepper()(
        code.law, times, given, np.array(start, float), constants, substeps, bound, np.array(digital, float), y
    )
    return y[:kept]
