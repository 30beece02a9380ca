"""The physical parameters of the twin-beam rig, one row each: every other table of them is made from this one.

Symbols are those of Zalucky and Hardt (1984), equations (7) to (18).
"""

from dataclasses import dataclass
from math import pi
from typing import Any

from beamdesign.prototype import Prototype, Tolerance


@dataclass(frozen=True)
class Parameter:
    """One parameter of the linear model.

    Attributes:
        name: in the model.
        symbol: in the paper.
        unit: of its value in the model, SI.
        place: where it stands in a prototype, as TABLE.KEY; a dashpot by its damping ratio, a beam's lumped figures
            where they are not left to its geometry.
        tolerance: key of its relative standard deviation in `[tolerance]`.
        subsystem: of the rig.
        typical: relative standard deviation where it is taken from drawings and data sheets: what an engineer would
            grant before a look; 0 where that is for whoever mounts it to say.
    """

    name: str
    symbol: str
    unit: str
    place: str
    tolerance: str
    subsystem: str
    typical: float = 0.0

    @property
    def in_turns(self) -> bool:
        """Whether the prototype states it in Hz and the model has it in rad/s."""
        return self.unit == "rad/s" and self.place.endswith("_Hz")

    @property
    def factor(self) -> float:
        """Of the model's value over the prototype's."""
        return 2 * pi if self.in_turns else 1.0

    @property
    def shown_unit(self) -> str:
        """Unit in which people are shown it."""
        return "Hz" if self.in_turns else self.unit

    @property
    def key(self) -> str:
        """Its name with the unit of the model."""
        return with_unit(self.name, self.unit)

    @property
    def shown_key(self) -> str:
        """Its name with the unit in which people are shown it."""
        return with_unit(self.name, self.shown_unit)

    def stated(self, prototype: Prototype) -> Any:
        """What stands at its place in a prototype; None where nothing does."""
        table, key = self.place.split(".")
        return getattr(getattr(prototype, table), key)


def with_unit(name: str, unit: str) -> str:
    """A name with its unit as a suffix: N s/m becomes _N_s_per_m; a plain number has none."""
    return name if unit == "1" else f"{name}_{unit.replace(' ', '_').replace('/', '_per_')}"


def _beam(which: str, letter: str) -> tuple[Parameter, ...]:
    rows = (
        ("stiffness", "K", "N/m", "stiffness_N_per_m", "stiffness", 0.03),
        ("mass", "M", "kg", "effective_mass_kg", "effective_mass", 0.02),
        ("damping", "b", "N s/m", "damping_ratio", "beam_damping_ratio", 0.3),
    )
    return tuple(
        Parameter(f"{which}_{name}", f"{symbol}_{letter}", unit, f"{which}_beam.{key}", tolerance, "structure", typical)
        for name, symbol, unit, key, tolerance, typical in rows
    )


_ROWS = (
    *_beam("outer", "m"),
    *_beam("inner", "f"),
    Parameter("oil_stiffness", "K_c", "N/m", "actuator.oil_stiffness_N_per_m", "oil_stiffness", "oil", 0.15),
    Parameter("piston_area", "A", "m2", "actuator.piston_area_m2", "piston_area", "actuator", 0.005),
    Parameter("flow_gain", "K_q", "m3/s/A", "servovalve.flow_gain_m3_per_s_per_A", "flow_gain", "servovalve", 0.05),
    Parameter("leakage", "K_pq", "m3/s/Pa", "servovalve.leakage_m3_per_s_per_Pa", "leakage", "servovalve", 0.3),
    Parameter(
        "valve_frequency", "ω_n", "rad/s", "servovalve.natural_frequency_Hz", "valve_natural_frequency", "servovalve",
        0.05,
    ),
    Parameter(
        "valve_damping_ratio", "ξ", "1", "servovalve.damping_ratio", "valve_damping_ratio", "servovalve", 0.15
    ),
    Parameter("sensor_gain", "F", "V/m", "sensor.gain_V_per_m", "sensor_gain", "sensor", 0.005),
    Parameter("filter_frequency", "ω_s", "rad/s", "sensor.filter_Hz", "sensor_filter", "sensor", 0.03),
    Parameter("outer_end_mass", "m", "kg", "payload.outer_end_mass_kg", "outer_end_mass", "structure"),
    Parameter("inner_end_mass", "n", "kg", "payload.inner_end_mass_kg", "inner_end_mass", "structure"),
)  # fmt: skip

PARAMETERS = {row.name: row for row in _ROWS}
"""By name, in the order in which the equations take them."""

TOLERANCES = {row.name: row.tolerance for row in _ROWS}
"""Key in `[tolerance]` of every parameter."""

RIG_TOLERANCES = {name: key for name, key in TOLERANCES.items() if not name.endswith("_end_mass")}
"""The same of the rig alone, without end masses."""

TYPICAL = Tolerance(**{row.tolerance: row.typical for row in _ROWS})
"""Standard deviations of figures taken from drawings and data sheets: what an engineer would grant before a look."""


def stated_or_typical(tolerance: Tolerance) -> tuple[Tolerance, str]:
    """Tolerances as they are where any figure has one, else typical ones and a word on it."""
    if any(value for key, value in tolerance.model_dump().items() if not key.endswith("_end_mass")):
        return tolerance, ""
    taken = ", ".join(f"{key} {value:.2g}" for key, value in TYPICAL.model_dump().items() if value)
    return TYPICAL, f"no [tolerance] is stated for any figure; typical ones are taken ({taken}): better state your own"
