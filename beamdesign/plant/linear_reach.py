"""How far the linear model's amplitude holds: the load, the force or the air in the oil at which it is off by a share.

Zalucky and Hardt (1984) conclude from simulations that the linear model predicts the amplitude "as long as loads stay
moderate, and the oil is kept air free". Here the nonlinear response is the harmonic balance of the assembled rig, and
the three words are given figures.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import inf, isfinite
from typing import Literal

import casadi as ca
import numpy as np

from beamdesign.plant.assembly import Structure, assemble, fits
from beamdesign.plant.component import PROPORTIONAL
from beamdesign.plant.fourier_balance import DISPLACEMENT, FreeRig
from beamdesign.plant.harmonic_balance import forced_motion
from beamdesign.prototype import Prototype

Varied = Literal["load", "force", "air"]
PUBLISHED_EFFECTS = ("pressure_dependent_flow", "unequal_piston_areas")
"""What the paper's nonlinear simulations had beside air in the oil."""
_GRID = 16
_SMALL_N = 1.0
SHARE = 0.1
"""Of the amplitude, by which the linear model may be off."""
_HARMONICS = 5


@dataclass(frozen=True)
class Reach:
    """Where the linear model stops.

    Attributes:
        varied: `load`, constant, N, either way, under a small vibration; `force`, amplitude, N, about no load; or
            `air`, volume share of free air, under a small vibration.
        frequency_Hz: of the vibration.
        limit: up to which the amplitude is off by no more than `SHARE`; the largest asked where `departure` is less.
        departure: of the amplitude there, relative to the linear model's; -1 or infinite where there is no balance.
    """

    varied: Varied
    frequency_Hz: float
    limit: float
    departure: float


def departure(
    prototype: Prototype,
    force: float,
    frequency: float,
    outer_end_mass: float = 0.0,
    preload: float = 0.0,
    linear: float | None = None,
) -> float:
    """Relative error of the linear model: amplitude with all effects over that with the linear ones, less one.

    Args:
        prototype: rig with its effects and a controller.
        force: amplitude on the outer tip, N.
        frequency: Hz.
        outer_end_mass: payload, kg.
        preload: constant force, N.
        linear: amplitude of the linear model per newton, where that is known already.

    Returns:
        Infinite where the rig has no periodic response, as beyond what its actuator can hold.
    """
    linear = _linear(prototype, frequency, outer_end_mass) if linear is None else linear
    try:
        motion = forced_motion(prototype, force, frequency, outer_end_mass, preload, _HARMONICS)
    except ValueError:
        return inf
    return motion.amplitude_m / (linear * force) - 1


def _linear(prototype: Prototype, frequency: float, outer_end_mass: float) -> float:
    rig = FreeRig(linear_part(prototype), outer_end_mass)
    model = rig.linear(rig.gain)
    states = np.linalg.solve(2j * np.pi * frequency * np.eye(len(model.a)) - model.a, model.b[:, 0])
    return float(abs(model.c[DISPLACEMENT] @ states + model.d[DISPLACEMENT, 0]))


def linear_part(prototype: Prototype) -> Prototype:
    """The rig with those of its effects alone whose laws are linear, such as a sensor's lag."""
    return prototype.but(
        effects={name: table for name, table in prototype.effects.items() if _is_linear(name, prototype.rig)}
    )


@cache
def _is_linear(effect: str, rig: str) -> bool:
    function = assemble(Structure(PROPORTIONAL, effects=(effect,), rig=rig)).function
    t, x, u, p = function.sx_in()
    return not any(ca.which_depends(ca.vertcat(*function(t, x, u, p)), ca.vertcat(x, u), 2))


def with_published_effects(prototype: Prototype) -> Prototype:
    """The rig with the paper's nonlinear factors but air, beside the effects it has."""
    return prototype.but(
        effects={name: {} for name in PUBLISHED_EFFECTS if fits(name, prototype.rig)} | prototype.effects
    )


def reach(
    prototype: Prototype,
    varied: Varied,
    frequency: float,
    outer_end_mass: float = 0.0,
) -> Reach:
    """The load, force or air fraction up to which the linear model's amplitude is off by no more than `SHARE`.

    The quantity is raised on a grid until that is passed, and the passage is narrowed by bisection: a passage that
    goes back between two points of the grid is not seen.

    Args:
        prototype: rig with a controller and its effects.
        varied: what is raised.
        frequency: of the vibration, Hz.
        outer_end_mass: payload, kg.
    """
    stall = prototype.actuator.strength_N(prototype)
    linear = _linear(prototype, frequency, outer_end_mass)

    def off(there: Prototype, force: float, load: float = 0.0) -> float:
        return departure(there, force, frequency, outer_end_mass, load, linear)

    def airy(fraction: float) -> Prototype:
        return prototype.but(effects=prototype.effects | {"entrained_air": {"air_fraction": fraction}})

    ways: dict[Varied, tuple[float, float, Callable[[float], float]]] = {
        "load": (1e-2, 1.0, lambda at: max((off(prototype, _SMALL_N, way * at * stall) for way in (1, -1)), key=abs)),
        "force": (1e-3, 1.0, lambda at: off(prototype, at * stall)),
        "air": (1e-4, 0.3, lambda at: off(airy(at), _SMALL_N)),
    }
    low, high, at = ways[varied]
    scale = 1.0 if varied == "air" else stall
    grid = np.linspace(low, high, _GRID) if varied == "load" else np.geomspace(low, high, _GRID)
    before = None
    for value in grid:
        found = at(float(value))
        if abs(found) > SHARE:
            if before is None:
                return Reach(varied, frequency, 0.0, found)
            limit = _narrowed(at, before, float(value))
            return Reach(varied, frequency, limit * scale, at(limit))
        before = float(value)
    return Reach(varied, frequency, high * scale, found)


def _narrowed(at: Callable[[float], float], low: float, high: float) -> float:
    while high - low > 5e-4 * high:
        middle = (low + high) / 2
        found = at(middle)
        low, high = (low, middle) if not isfinite(found) or abs(found) > SHARE else (middle, high)
    return low
