"""What may make a bench differ from what was believed of it: causes, and the figures of the steady model they move."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations
from math import hypot
from typing import Any

import numpy as np

from beamdesign.bench_prototype import BenchPrototype
from beamdesign.diagnosis.diagnosis import Estimate
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.hypothesis import Hypothesis, Unknown
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
_ALWAYS = ("flow_gain", "piston_area", "supply_pressure", "tank_pressure")
NO_CAUSE: dict[str, Any] = {figure.name: figure.none for figure in FIGURES if figure.name not in _ALWAYS}
"""Figures with no cause at work. Beside them stand flow_gain (m3/s/V), piston_area (m2), both pressures (Pa)."""
STEADY_EFFECTS = ("unequal_piston_areas", "pressure_dependent_flow", "valve_deadband", "seal_friction")
"""Effects that have a part in steady motion."""
ORIFICES, FLOW_GAIN = "pressure_dependent_flow", "parameter:flow_gain"
FRICTIONS: dict[str, tuple[str, ...]] = {
    "seal_friction (viscous)": ("viscous",),
    "seal_friction (coulomb)": ("coulomb_N",),
    "seal_friction (coulomb with offset)": ("coulomb_N", "constant_load_N"),
    "seal_friction (stribeck)": ("coulomb_N", "breakaway_ratio", "stribeck_m_per_s"),
}
_OF_ORIFICES = {"parameter:line_loss": ("line_loss",), "parameter:edge_b": ("edge_b",)}
_OTHERS: dict[str, tuple[str, ...]] = {
    ORIFICES: (),
    "unequal_piston_areas": ("asymmetry",),
    "valve_deadband": ("deadband_V",),
    "parameter:piston_leakage": ("piston_leakage",),
    **_OF_ORIFICES,
}
LAWS = {**_OTHERS, **FRICTIONS, FLOW_GAIN: ()}
"""Figures that each law moves beside those that are moved always."""
_CAUSES = {figure.name: figure.cause for figure in FIGURES}
_SUBSYSTEMS = {"parameter:line_loss": "oil", "parameter:edge_b": "servovalve", FLOW_GAIN: "servovalve"}


def subsystem(cause: str) -> str:
    """Where a cause sits."""
    return library()[cause].subsystem if cause in library() else _SUBSYSTEMS.get(cause, "actuator")


@dataclass(frozen=True)
class SteadyPlacement:
    """How unknowns enter the steady model.

    Attributes:
        unknowns: in the order of z.
        orifices: whether flow goes with the root of the pressure drop.
        base: figures that are not moved.
    """

    unknowns: tuple[Unknown, ...]
    orifices: bool
    base: Mapping[str, Any] = field(default_factory=lambda: NO_CAUSE)

    def figures(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """All of `FIGURES` by name at z, (K,) or (m, K): (1,) or (m, 1) each of those that are moved."""
        moved = [(u, u.spread * z[..., k, None]) for k, u in enumerate(self.unknowns)]
        return {**self.base} | {u.name: u.nominal + by if u.linear else u.nominal * np.exp(by) for u, by in moved}


def placed(found: Fit) -> SteadyPlacement:
    """How the unknowns of a fit enter the steady model."""
    return SteadyPlacement(found.unknowns, ORIFICES in found.hypothesis.names)


@dataclass(frozen=True)
class BenchHypothesis(Hypothesis):
    """A set of laws at work on a bench; its names are those of `LAWS`, sorted."""

    @property
    def figures(self) -> tuple[str, ...]:
        """Figures of the model that are fitted beside those with tolerances."""
        return tuple(figure for name in self.names for figure in LAWS[name])

    @property
    def causes(self) -> tuple[str, ...]:
        """Causes as contracts name them, sorted."""
        moving = {name for name in self.names if not LAWS[name]}
        return tuple(sorted(moving | {_CAUSES[figure] for figure in self.figures}))

    @property
    def size(self) -> int:
        """How many causes, Stribeck's excess and the offset of friction counted as more than Coulomb's."""
        return len(self.causes) + ("breakaway_ratio" in self.figures)

    def __str__(self) -> str:
        return " + ".join(self.names) or "tolerances only"


def laws(*names: str) -> BenchHypothesis:
    """Several laws at once."""
    return BenchHypothesis(tuple(sorted(set(names))))


def candidates(known: BenchHypothesis | None = None) -> tuple[BenchHypothesis, ...]:
    """Every combination of causes, with those already believed; lines and edges show only where flow heeds pressure."""
    known = known or laws()
    held = {*known.figures, *known.causes}
    found = (
        laws(*some, *friction)
        for count in range(len(_OTHERS) + 1)
        for some in combinations(_OTHERS, count)
        for friction in ((), *((name,) for name in FRICTIONS))
        if ORIFICES in some or not _OF_ORIFICES.keys() & set(some)
    )
    return (*(each for each in found if held <= {*each.figures, *each.causes}), known | laws(FLOW_GAIN))


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
    orifices = ORIFICES in effects
    there = {
        **{name: name in effects for name in (ORIFICES, "unequal_piston_areas", "valve_deadband")},
        "parameter:piston_leakage": at["piston_leakage"] > 0,
        "parameter:line_loss": orifices and at["line_loss"] > 0,
        "parameter:edge_b": orifices and at["edge_b"] != 1,
    }
    found = laws(*(name for name, held in there.items() if held))
    if "seal_friction" not in effects:
        return found, at
    kinds = {
        "viscous": at["coulomb_N"] == 0,
        "coulomb with offset": at["constant_load_N"] != 0,
        "stribeck": at["breakaway_ratio"] > 1,
    }
    kind = next((kind for kind, there in kinds.items() if there), "coulomb")
    return found | laws(f"seal_friction ({kind})"), at


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


def steady_placement(prototype: BenchPrototype, hypothesis: BenchHypothesis, largest_V: float) -> SteadyPlacement:
    """Everything a fit may move: within tolerances of a prototype, then under the priors of the library's effects.

    Args:
        prototype: what was believed.
        hypothesis: of what is at work.
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

    vouched = hypot(tolerance.flow_gain, _DROP_STD if ORIFICES in hypothesis.names else 0.0)
    found = (
        tolerated("flow_gain", gain, _WIDE if FLOW_GAIN in hypothesis.names else vouched),
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
    return SteadyPlacement((*found, *(moved[name] for name in hypothesis.figures)), ORIFICES in hypothesis.names)


def parameters(prototype: BenchPrototype, found: Fit) -> dict[str, dict[str, Estimate]]:
    """Fitted parameters of causes, by contract names, SI.

    Args:
        prototype: what was believed.
        found: a fit of the causes.
    """
    own: dict[str, dict[str, Estimate]] = {name: {} for name in found.hypothesis.causes}
    std = found.standard_errors
    for figure in FIGURES:
        if figure.cause in own and figure.name in std:
            factor = prototype.servovalve.amplifier_A_per_V if figure.name == "deadband_V" else 1.0
            own[figure.cause][figure.key] = Estimate(factor * found.values[figure.name], factor * std[figure.name])
    return own
