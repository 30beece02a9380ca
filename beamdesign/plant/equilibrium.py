"""Where a rig stands still, and its linearisation there."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from beamdesign.plant.assembly import Assembly, Structure, assemble
from beamdesign.plant.effects import library


@dataclass(frozen=True)
class Linearisation:
    """x' = A x + B u, y = C x + D u about an operating point; names as in the assembly."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray


@cache
def _derivatives(kinds: Structure) -> ca.Function:
    assembly = assemble(kinds)
    t, x, u, p = assembly.function.sx_in()
    rate, y = assembly.function(t, x, u, p)
    matrices = [ca.densify(ca.jacobian(value, of)) for value in (rate, y) for of in (x, u)]
    lean: Any = ca.cse([ca.densify(rate), *matrices])
    return ca.Function("derivatives", [t, x, u, p], lean)


@cache
def _stiffness(kinds: Structure) -> ca.Function:
    """The rates and their Jacobian by the states alone."""
    return _derivatives(kinds).slice("stiffness", [0, 1, 2, 3], [0, 1])


class _InPlace:
    """Rates and Jacobian at time 0 for states written into `x`, without converting anything on the way.

    Converting takes many times as long as evaluating.
    """

    def __init__(self, function: ca.Function, u: np.ndarray, parameters: np.ndarray):
        n = function.nnz_in(1)
        self.x, self.rate, self._transposed = np.zeros(n), np.zeros(n), np.zeros((n, n))
        self.jacobian = self._transposed.T
        self._given = (np.zeros(1), self.x, np.array(u, dtype=float), np.array(parameters, dtype=float))
        buffer: Any
        buffer, self.evaluate = function.buffer()
        for k, array in enumerate(self._given):
            buffer.set_arg(k, array.data)
        for k, array in enumerate((self.rate, self._transposed)):
            buffer.set_res(k, array.data)
        self._buffer = buffer  # CasADi does not hold on to it


def linearise(assembly: Assembly, x: np.ndarray, u: np.ndarray, parameters: np.ndarray) -> Linearisation:
    """Linearise by algorithmic differentiation at time 0.

    Args:
        assembly: the rig.
        x: (n,) states.
        u: (3,) inputs.
        parameters: in the assembly's order.
    """
    values = _derivatives(assembly.kinds)(0.0, x, u, parameters)[1:]
    return Linearisation(*(np.asarray(value) for value in values))


def equilibrium(assembly: Assembly, u: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """States (n,) at which nothing moves under constant inputs.

    Backward Euler steps of growing length, so that play ends where a slow load would have left it. Friction that has no
    direction yet (the `memory` of effects) is held at zero.

    Raises:
        ValueError: where none is found.
    """
    figure = dict(zip(assembly.parameters, parameters, strict=True))
    supply = figure.get("pressure_dependent_flow.supply_pressure_Pa", figure["supply_pressure"])
    x = np.array([supply / 2 if name in ("pressure_a_Pa", "pressure_b_Pa") else 0.0 for name in assembly.states])
    here = _InPlace(_stiffness(assembly.kinds), u, parameters)
    weight = scales(assembly)
    free = not_held(assembly)
    among, ratio = np.ix_(free, free), weight[None, :] / weight[:, None]
    eye, step = np.eye(len(x)), 1e-3
    for _ in range(_MOST_STEPS):
        here.x[:] = x
        here.evaluate()
        change = np.zeros(len(x))
        change[free] = np.linalg.solve((eye / step - here.jacobian * ratio)[among], here.rate[free] / weight[free])
        x = x + weight * change
        if not here.rate[free].any() or (step > _LONG and np.abs(change).max() <= 1e-10):
            return x
        # A long step that hardly moves anything is Newton's; a large change means a law has been left behind.
        step = min(2 * step, 1e9) if np.abs(change).max() < 100.0 else max(step / 2, 1e-5)
    raise ValueError("the rig has no equilibrium under these inputs")


_LONG, _MOST_STEPS = 1e3, 400  # s; steps


def not_held(assembly: Assembly) -> np.ndarray:
    """Places of the states that an equilibrium moves: all but the `memory` of effects."""
    held = {f"{name}.{state}" for name in assembly.kinds.effects for state in library()[name].memory}
    return np.array([k for k, name in enumerate(assembly.states) if name not in held])


def scales(assembly: Assembly) -> np.ndarray:
    """Typical magnitude of each state."""
    sizes = {"_Pa": 1e6, "_m3_per_s": 1e-5, "_m3_per_s2": 1e-2, "_m": 1e-4, "_m_per_s": 1e-2}
    return np.array(
        [next((size for end, size in sizes.items() if name.endswith(end)), 1.0) for name in assembly.states]
    )
