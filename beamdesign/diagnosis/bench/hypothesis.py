"""What may make a bench differ from what was believed of it: causes, and the figures of the steady model they move."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from math import hypot

from beamdesign.bench_prototype import BenchPrototype
from beamdesign.diagnosis.diagnosis import Estimate
from beamdesign.diagnosis.fitting.hypothesis import Unknown
from beamdesign.plant.bench_simulation import bench_parameters
from beamdesign.plant.effects import library


@dataclass(frozen=True)
class Figure:
    """A figure of the steady model.

    Attributes:
        name: in the model.
        cause: contract name of what moves it beyond its tolerance; empty where nothing does.
        key: by which the parameters of that cause name it.
        place: of the prototype, as `TABLE.KEY`; empty for a parameter of the effect alone.
        none: value with no cause at work, where the prototype does not state it.
    """

    name: str
    cause: str
    key: str = ""
    place: str = ""
    none: float = 0.0


FIGURES = (
    Figure("flow_gain", "parameter:flow_gain", "flow_gain_m3_per_s_per_V", "servovalve.flow_gain_m3_per_s_per_V"),
    Figure("piston_area", "", place="actuator.piston_area_m2"),
    Figure("supply_pressure", "pressure_dependent_flow", "supply_pressure_Pa", "actuator.supply_pressure_Pa"),
    Figure("tank_pressure", "", place="actuator.tank_pressure_Pa"),
    Figure("asymmetry", "unequal_piston_areas", "asymmetry"),
    Figure("deadband_V", "valve_deadband", "half_width_A"),
    Figure(
        "piston_leakage",
        "parameter:piston_leakage",
        "piston_leakage_m3_per_s_per_Pa",
        "actuator.piston_leakage_m3_per_s_per_Pa",
    ),
    Figure("line_loss", "parameter:line_loss", "line_loss_Pa_s2_per_m6", "actuator.line_loss_Pa_s2_per_m6"),
    Figure("edge_b", "parameter:edge_b", "edge_b_ratio", "servovalve.edge_b_ratio", 1.0),
    Figure("coulomb_N", "seal_friction", "coulomb_N"),
    Figure("viscous", "seal_friction", "viscous_N_s_per_m"),
    Figure("constant_load_N", "parameter:constant_load", "constant_load_N", "actuator.constant_load_N"),
    Figure("breakaway_ratio", "seal_friction", "breakaway_ratio", none=1.0),
    Figure("stribeck_m_per_s", "seal_friction", "stribeck_m_per_s", none=0.005),
)
TOLERATED = ("flow_gain", "piston_area", "supply_pressure")
_ALWAYS = (*TOLERATED, "tank_pressure")
NOTHING = {figure.name: figure.none for figure in FIGURES if figure.name not in _ALWAYS}
"""Figures with no cause at work. Beside them stand flow_gain (m3/s/V), piston_area (m2), both pressures (Pa)."""
STEADY_EFFECTS = ("unequal_piston_areas", "pressure_dependent_flow", "valve_deadband", "seal_friction")
"""Effects that have a part in steady motion."""
FRICTIONS = {
    "none": (),
    "viscous": ("viscous",),
    "coulomb": ("coulomb_N",),
    "coulomb with offset": ("coulomb_N", "constant_load_N"),
    "stribeck": ("coulomb_N", "breakaway_ratio", "stribeck_m_per_s"),
}
"""Figures that each kind of friction moves."""
_SUBSYSTEMS = {
    "parameter:piston_leakage": "actuator",
    "parameter:line_loss": "oil",
    "parameter:edge_b": "servovalve",
    "parameter:constant_load": "actuator",
    "parameter:flow_gain": "servovalve",
}


def subsystem(cause: str) -> str:
    """Where a cause sits."""
    return _SUBSYSTEMS[cause] if cause in _SUBSYSTEMS else library()[cause].subsystem


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
        moved = {figure.cause for figure in FIGURES if figure.name in self.figures}
        named = {"pressure_dependent_flow": self.orifices, "parameter:flow_gain": self.wrong_flow_gain}
        return tuple(sorted(moved | {name for name, there in named.items() if there}))

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
        return (*(name for name, there in own.items() if there), *FRICTIONS[self.friction])

    def __str__(self) -> str:
        words = [name for name in self.names if name not in ("seal_friction", "parameter:constant_load")]
        if self.friction != "none":
            words.append(f"seal_friction ({self.friction})")
        return " + ".join(words) or "tolerances only"


def candidates(nominal: BenchHypothesis | None = None) -> tuple[BenchHypothesis, ...]:
    """Every combination of causes, with those already believed; lines and edges show only where flow heeds pressure."""
    nominal = nominal or BenchHypothesis()
    yes = (False, True)
    found = [
        BenchHypothesis(orifices, areas, deadband, leakage, lines, edge, friction)
        for orifices, areas, deadband, leakage in product(yes, yes, yes, yes)
        for lines, edge in product(yes, yes)
        for friction in FRICTIONS
        if orifices or not (lines or edge)
    ]
    held = set(nominal.figures) | set(nominal.names)
    found = [each for each in found if held <= set(each.figures) | set(each.names)]
    return (*found, replace(nominal, wrong_flow_gain=True))


def nominal(prototype: BenchPrototype) -> tuple[BenchHypothesis, dict[str, float]]:
    """Causes that a prototype already holds, and the figures of the steady model as it has them."""
    effects, of_effects = prototype.effects, bench_parameters(prototype)
    at = {}
    for figure in FIGURES:
        table, _, key = figure.place.partition(".")
        stated = getattr(getattr(prototype, table), key) if table else figure.none
        at[figure.name] = of_effects.get(f"{figure.cause}.{figure.key}", stated)
    if "valve_deadband" in effects:
        at["deadband_V"] /= prototype.servovalve.amplifier_A_per_V
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


def unknowns(prototype: BenchPrototype, hypothesis: BenchHypothesis, largest_V: float) -> tuple[Unknown, ...]:
    """Everything a fit may move: within tolerances of the prototype, then under the priors of the library's effects.

    Args:
        prototype: what was believed.
        hypothesis: the causes.
        largest_V: command from which the largest flow follows.
    """
    known, at = nominal(prototype)
    actuator, valve, tolerance = prototype.actuator, prototype.servovalve, prototype.tolerance
    supply, gain, volts = actuator.supply_pressure_Pa, valve.flow_gain_m3_per_s_per_V, valve.amplifier_A_per_V
    flow = gain * largest_V
    width = next(q for q in library()["valve_deadband"].parameters if q.name == "half_width_A")
    friction = {q.name: q for q in library()["seal_friction"].parameters}

    def tolerated(name: str, value: float, spread: float) -> Unknown:
        return Unknown(name, value, max(spread, _LEAST_TOLERANCE), False, value / 10, 10 * value, "figure")

    def free(name: str, middle: float, spread: float, low: float, high: float, linear: bool = True) -> Unknown:
        return Unknown(name, at[name] if name in known.figures else middle, spread, linear, low, high, "effect")

    vouched = hypot(tolerance.flow_gain, _DROP_STD if hypothesis.orifices else 0.0)
    found = (
        tolerated("flow_gain", gain, _WIDE if hypothesis.wrong_flow_gain else vouched),
        tolerated("piston_area", actuator.piston_area_m2, tolerance.piston_area),
        tolerated("supply_pressure", supply, tolerance.supply_pressure),
        free("tank_pressure", actuator.tank_pressure_Pa, _TANK_STD * supply, 0.0, supply / 2),
    )
    lost, loss = _LOST * flow / supply, _LOST * supply / flow**2
    own = [
        free("asymmetry", actuator.asymmetry, _AREA_RATIO_STD, -0.5, 0.5),
        free("deadband_V", 0.0, width.spread / volts, 0.0, min(width.high / volts, 0.9 * largest_V)),
        free("piston_leakage", 0.0, lost, 0.0, 5 * lost),
        free("line_loss", 0.0, loss, 0.0, 5 * loss),
        free("edge_b", 1.0, _EDGE_STD, 0.5, 1.5),
        free("constant_load_N", actuator.constant_load_N, _LOAD_STD_N, -10 * _LOAD_STD_N, 10 * _LOAD_STD_N),
    ]
    for figure in FIGURES:
        if figure.cause == "seal_friction":
            q = friction[figure.key]
            own.append(free(figure.name, q.default, q.spread, q.low, q.high, figure.key != "stribeck_m_per_s"))
    moved = {unknown.name: unknown for unknown in own}
    return found + tuple(moved[name] for name in hypothesis.figures)


def parameters(
    prototype: BenchPrototype, names: tuple[str, ...], values: Mapping[str, float], std: Mapping[str, float]
) -> dict[str, dict[str, Estimate]]:
    """Fitted parameters of causes, by contract names, SI.

    Args:
        prototype: what was believed.
        names: of the causes.
        values: of the fitted figures.
        std: their standard errors.
    """
    found: dict[str, dict[str, Estimate]] = {name: {} for name in names}
    for figure in FIGURES:
        if figure.cause in names and figure.name in values:
            factor = prototype.servovalve.amplifier_A_per_V if figure.name == "deadband_V" else 1.0
            estimate = Estimate(factor * values[figure.name], factor * std[figure.name])
            found[figure.cause][figure.key] = estimate
    return found
