"""What was believed of a bench, and how far a fit may move it."""

from dataclasses import dataclass, replace
from math import hypot

from beamdesign.bench_prototype import BenchPrototype
from beamdesign.gap.bench.hypothesis import BenchHypothesis
from beamdesign.gap.bench.model import NOTHING
from beamdesign.rig.bench_parameters import bench_parameters
from beamdesign.rig.effects import library


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


STEADY_EFFECTS = ("unequal_piston_areas", "pressure_dependent_flow", "valve_deadband", "seal_friction")
"""Effects that have a part in steady motion."""


def believed(prototype: BenchPrototype) -> tuple[BenchHypothesis, dict[str, float]]:
    """Causes that a prototype already holds, and the figures of the steady model as it has them."""
    actuator, valve, effects = prototype.actuator, prototype.servovalve, prototype.effects
    figure = bench_parameters(prototype)
    at = NOTHING | {
        "flow_gain": valve.flow_gain_m3_per_s_per_V,
        "piston_area": actuator.piston_area_m2,
        "supply_pressure": figure.get("pressure_dependent_flow.supply_pressure_Pa", actuator.supply_pressure_Pa),
        "tank_pressure": actuator.tank_pressure_Pa,
        "asymmetry": figure.get("unequal_piston_areas.asymmetry", 0.0),
        "deadband_V": figure.get("valve_deadband.half_width_A", 0.0) / valve.amplifier_A_per_V,
        "piston_leakage": actuator.piston_leakage_m3_per_s_per_Pa,
        "line_loss": actuator.line_loss_Pa_s2_per_m6,
        "edge_b": valve.edge_b_ratio,
        "constant_load_N": actuator.constant_load_N,
        "coulomb_N": figure.get("seal_friction.coulomb_N", 0.0),
        "viscous": figure.get("seal_friction.viscous_N_s_per_m", 0.0),
        "breakaway_ratio": figure.get("seal_friction.breakaway_ratio", 1.0),
        "stribeck_m_per_s": figure.get("seal_friction.stribeck_m_per_s", NOTHING["stribeck_m_per_s"]),
    }
    kind = "coulomb"
    if "seal_friction" not in effects:
        kind = "none"
    elif at["coulomb_N"] == 0:
        kind = "viscous"
    elif at["constant_load_N"] != 0:
        kind = "coulomb with offset"
    elif at["breakaway_ratio"] > 1:
        kind = "stribeck"
    causes = BenchHypothesis(
        "pressure_dependent_flow" in effects,
        "unequal_piston_areas" in effects,
        "valve_deadband" in effects,
        at["piston_leakage"] > 0,
        at["line_loss"] > 0 and "pressure_dependent_flow" in effects,
        at["edge_b"] != 1 and "pressure_dependent_flow" in effects,
        kind,
    )
    return causes, at


def priors(prototype: BenchPrototype, hypothesis: BenchHypothesis, largest_V: float) -> dict[str, Prior]:
    """Priors of everything a fit may move: tolerances of the prototype, then those of the library's effects.

    Args:
        prototype: what was believed.
        hypothesis: the causes.
        largest_V: command from which the largest flow follows.
    """
    known, at = believed(prototype)
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
    own |= {name: replace(own[name], middle=at[name]) for name in known.figures}
    return found | {name: own[name] for name in hypothesis.figures}
