"""What may make a bench differ from what was believed of it."""

from dataclasses import dataclass
from itertools import product
from math import hypot

from beamdesign.bench_prototype import BenchPrototype
from beamdesign.rig.effects import library

FRICTIONS = ("none", "viscous", "coulomb", "coulomb with offset", "stribeck")
_FRICTION_FIGURES = {
    "none": (),
    "viscous": ("viscous",),
    "coulomb": ("coulomb_N",),
    "coulomb with offset": ("coulomb_N", "constant_load_N"),
    "stribeck": ("coulomb_N", "breakaway_ratio", "stribeck_m_per_s"),
}


@dataclass(frozen=True)
class BenchHypothesis:
    """A set of causes.

    Attributes:
        orifices: flow goes with the root of the pressure drop.
        unequal_areas: the sides differ as bore and rod say.
        deadband: the valve opens only beyond a command.
        leakage: oil passes the piston.
        lines: lines to and from the valve lose pressure as oil flows.
        edge: the valve's edge from the supply to chamber b passes more or less than the others.
        friction: one of `FRICTIONS`.
        wrong_flow_gain: the flow gain is free of its tolerance.
    """

    orifices: bool = False
    unequal_areas: bool = False
    deadband: bool = False
    leakage: bool = False
    lines: bool = False
    edge: bool = False
    friction: str = "none"
    wrong_flow_gain: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Causes as contracts name them, sorted."""
        named = {
            "pressure_dependent_flow": self.orifices,
            "unequal_piston_areas": self.unequal_areas,
            "valve_deadband": self.deadband,
            "parameter:piston_leakage": self.leakage,
            "parameter:line_loss": self.lines,
            "parameter:edge_b": self.edge,
            "seal_friction": self.friction != "none",
            "parameter:constant_load": self.friction == "coulomb with offset",
            "parameter:flow_gain": self.wrong_flow_gain,
        }
        return tuple(sorted(name for name, there in named.items() if there))

    @property
    def causes(self) -> int:
        """How many causes, Stribeck's excess and the offset of friction counted as more than Coulomb's."""
        return len(self.names) + (self.friction == "stribeck")

    @property
    def figures(self) -> tuple[str, ...]:
        """Figures of the model that are fitted beside those with tolerances."""
        own = {
            "asymmetry": self.unequal_areas,
            "deadband_V": self.deadband,
            "piston_leakage": self.leakage,
            "line_loss": self.lines,
            "edge_b": self.edge,
        }
        return (*(name for name, there in own.items() if there), *_FRICTION_FIGURES[self.friction])

    def __str__(self) -> str:
        words = [name for name in self.names if name not in ("seal_friction", "parameter:constant_load")]
        if self.friction != "none":
            words.append(f"seal_friction ({self.friction})")
        return " + ".join(words) or "tolerances only"


def candidates() -> tuple[BenchHypothesis, ...]:
    """Every combination of causes; lines and edges show only where flow heeds pressure."""
    yes = (False, True)
    found = [
        BenchHypothesis(orifices, areas, deadband, leakage, lines, edge, friction)
        for orifices, areas, deadband, leakage in product(yes, yes, yes, yes)
        for lines, edge in product(yes, yes)
        for friction in FRICTIONS
        if orifices or not (lines or edge)
    ]
    return (*found, BenchHypothesis(wrong_flow_gain=True))


@dataclass(frozen=True)
class Prior:
    """Normal distribution of one figure within bounds; of its logarithm where `relative`."""

    middle: float
    spread: float
    low: float
    high: float
    relative: bool = False


_DROP_STD = 0.2
"""Standard deviation of the logarithm of flow that comes with orifices: a gain that was believed of a linear valve
belongs to no pressure drop, and half as much again of that is a fifth more flow."""
_WIDE = 1.0  # standard deviation of the logarithm of a figure that is free of its tolerance
_AREA_RATIO_STD = 0.02  # of the asymmetry that bore and rod give
_TANK_STD = 0.03  # of the supply: nothing is believed of the tank, and gauges are off by as much
_LEAST_TOLERANCE = 1e-4
_LOAD_STD_N = 20.0
_EDGE_STD = 0.1
_LOST = 0.1  # share of pressure lost in a line, or of flow past the piston, at the largest flow: one deviation


def priors(prototype: BenchPrototype, hypothesis: BenchHypothesis, largest_V: float) -> dict[str, Prior]:
    """Priors of everything a fit may move: tolerances of the prototype, then those of the library's effects.

    Args:
        prototype: what was believed.
        hypothesis: the causes.
        largest_V: command from which the largest flow follows.
    """
    actuator, valve, tolerance = prototype.actuator, prototype.servovalve, prototype.tolerance
    supply, gain, volts = actuator.supply_pressure_Pa, valve.flow_gain_m3_per_s_per_V, valve.amplifier_A_per_V
    flow = gain * largest_V
    effect = {f"{e.name}.{q.name}": q for e in library().values() for q in e.parameters}
    width, coulomb = effect["valve_deadband.half_width_A"], effect["seal_friction.coulomb_N"]
    viscous, speed = effect["seal_friction.viscous_N_s_per_m"], effect["seal_friction.stribeck_m_per_s"]
    ratio = effect["seal_friction.breakaway_ratio"]

    def tolerated(value: float, spread: float) -> Prior:
        return Prior(value, max(spread, _LEAST_TOLERANCE), value / 10, 10 * value, True)

    vouched = hypot(tolerance.flow_gain, _DROP_STD if hypothesis.orifices else 0.0)
    found = {
        "flow_gain": tolerated(gain, _WIDE if hypothesis.wrong_flow_gain else vouched),
        "piston_area": tolerated(actuator.piston_area_m2, tolerance.piston_area),
        "supply_pressure": tolerated(supply, tolerance.supply_pressure),
        "tank_pressure": Prior(actuator.tank_pressure_Pa, _TANK_STD * supply, 0.0, supply / 2),
    }
    own = {
        "asymmetry": Prior(actuator.asymmetry, _AREA_RATIO_STD, -0.5, 0.5),
        "deadband_V": Prior(0.0, width.spread / volts, 0.0, min(width.high / volts, 0.9 * largest_V)),
        "piston_leakage": Prior(0.0, _LOST * flow / supply, 0.0, 5 * _LOST * flow / supply),
        "line_loss": Prior(0.0, _LOST * supply / flow**2, 0.0, 5 * _LOST * supply / flow**2),
        "edge_b": Prior(1.0, _EDGE_STD, 0.5, 1.5),
        "coulomb_N": Prior(coulomb.default, coulomb.spread, coulomb.low, coulomb.high),
        "viscous": Prior(viscous.default, viscous.spread, viscous.low, viscous.high),
        "constant_load_N": Prior(actuator.constant_load_N, _LOAD_STD_N, -10 * _LOAD_STD_N, 10 * _LOAD_STD_N),
        "breakaway_ratio": Prior(ratio.default, ratio.spread, ratio.low, ratio.high),
        "stribeck_m_per_s": Prior(speed.default, speed.spread, speed.low, speed.high, True),
    }
    return found | {name: own[name] for name in hypothesis.figures}
