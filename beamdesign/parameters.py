"""The physical parameters of the twin-beam rig, one row each: every other table of them is made from this one.

Symbols are those of Zalucky and Hardt (1984), equations (7) to (18), where the actuator is theirs.
"""

from collections.abc import Mapping
from decimal import ROUND_FLOOR
from math import nextafter

from beamdesign.plant.actuators import KINDS, Actuator
from beamdesign.plant.component import Parameter
from beamdesign.polynomial import exact
from beamdesign.prototype import Tolerance
from beamdesign.quantities import decimal
from beamdesign.records import InputError, Problem


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


_BEAMS = (*_beam("outer", "m"), *_beam("inner", "f"))
_REST = (
    Parameter(
        "sensor_gain", "F", "V/m", "sensor.gain_V_per_m", "sensor_gain", "sensor", 0.005, "the gain of the sensor"
    ),
    Parameter(
        "filter_frequency", "ω_s", "rad/s", "sensor.filter_Hz", "sensor_filter", "sensor", 0.03, "the filter's break"
    ),
    Parameter("outer_end_mass", "m", "kg", "payload.outer_end_mass_kg", "outer_end_mass", "structure"),
    Parameter("inner_end_mass", "n", "kg", "payload.inner_end_mass_kg", "inner_end_mass", "structure"),
)


def rows_of(actuator: type[Actuator]) -> dict[str, Parameter]:
    """Parameters of a rig with an actuator, by name, in the order in which the equations take them."""
    return {row.name: row for row in (*_BEAMS, *actuator.parameters, *_REST)}


PARAMETERS: dict[str, Parameter] = {}
"""Those of all rigs, by name."""

for _kind, _actuator in KINDS.items():
    for _row in (*_BEAMS, *_actuator.parameters, *_REST):
        if PARAMETERS.setdefault(_row.name, _row) != _row:
            raise ValueError(f"{_kind}: its parameter {_row.name} has the name of another one; give it another name")

TOLERANCES = {name: row.tolerance for name, row in PARAMETERS.items()}
"""Key in `[tolerance]` of every parameter."""

TORSION = {
    f"torsional_{name}": Parameter(f"torsional_{name}", symbol, unit, f"arm.torsional_{key}", tolerance, "structure")
    for name, symbol, unit, key, tolerance in (
        ("stiffness", "k_t", "N m/rad", "stiffness_N_m_per_rad", "stiffness"),
        ("damping", "b_t", "N m s/rad", "damping_ratio", "beam_damping_ratio"),
    )
}
"""Those of an arm whose payload twists its outer beam, which are no better known than the same of its bending."""

RIG_TOLERANCES = {name: key for name, key in TOLERANCES.items() if not name.endswith("_end_mass")}
RIG_TOLERANCES |= {name: row.tolerance for name, row in TORSION.items()}
"""The same of the rigs alone, without end masses, and of torsion."""


def typical_of(actuator: type[Actuator]) -> Tolerance:
    """Standard deviations of figures taken from drawings and data sheets: what an engineer grants before a look."""
    return Tolerance(**{row.tolerance: row.typical for row in rows_of(actuator).values()})


TYPICAL = typical_of(KINDS["servo_cylinder"])
"""Those of a hydraulic rig."""


def stated_or_typical(tolerance: Tolerance, actuator: type[Actuator]) -> tuple[Tolerance, str]:
    """Tolerances as they are where any figure has one, else typical ones of the actuator's rig and a word on it.

    Those of end masses are as they are stated either way. A word too on those of another actuator, beside which its
    own are taken as exact.
    """
    stated = [key for key, value in tolerance.model_dump().items() if value and not key.endswith("_end_mass")]
    if stated:
        own = {row.tolerance: getattr(tolerance, row.tolerance) for row in actuator.parameters}
        others = [key for key in stated if key not in {row.tolerance for row in rows_of(actuator).values()}]
        exact = ", ".join(key for key, value in own.items() if not value) or "none"
        words = (
            f"[tolerance] states {', '.join(others)} of another actuator; taken as exact of its own figures: {exact}"
        )
        return tolerance, words if others else ""
    typical = typical_of(actuator)
    taken = ", ".join(f"{key} {value:.2g}" for key, value in typical.model_dump().items() if value)
    typical = typical.but(outer_end_mass=tolerance.outer_end_mass, inner_end_mass=tolerance.inner_end_mass)
    return typical, f"no [tolerance] is stated for any figure; typical ones are taken ({taken}): better state your own"


def refuse_none_left(
    deviations: Mapping[str, float], sigmas: float, place: str = "tolerance", remedies: Mapping[str, str] | None = None
) -> None:
    """Refuse so many relative standard deviations, by key, of which a figure would reach zero.

    Args:
        deviations: by key.
        sigmas: how many.
        place: what holds the keys.
        remedies: what to write instead, by key; `{}` in it stands for the largest of two digits that is allowed.

    Raises:
        InputError: of that place, for every such key.
    """
    wide = {key: size for key, size in deviations.items() if exact(sigmas) * exact(size) >= 1}
    if wide:
        most = decimal(nextafter(1 / sigmas, 0.0), 2, ROUND_FLOOR)
        instead = {key: f"; {words.format(most)}" for key, words in (remedies or {}).items()}
        reasons = {key: f"{sigmas:g} standard deviations of {size:g} reach zero" for key, size in wide.items()}
        raise InputError(place, [Problem(key, reason + instead.get(key, "")) for key, reason in reasons.items()])
