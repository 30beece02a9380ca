"""The believed prototype with what a fit has found: figures re-tuned, effects added."""

from math import pi, sqrt
from typing import Any

from beamdesign import lumped
from beamdesign.gap.fitting.fit import Fit
from beamdesign.gap.fitting.unknowns import SUPPLY
from beamdesign.prototype import Beam, Prototype


def amended(prototype: Prototype, found: Fit) -> Prototype:
    """Put a fit's figures and effects into a prototype.

    A proof that stood for the believed figures does not stand for the new ones, so the guarantee is dropped.
    """
    figures = lumped.figures(prototype) | {u: v for u, v in found.values.items() if "." not in u}
    # The model's dashpot goes with the root of K M of its beam; so does the fitted one.
    believed = lumped.figures(prototype)
    for beam in ("outer", "inner"):
        for part in ("stiffness", "mass"):
            figures[f"{beam}_damping"] *= sqrt(figures[f"{beam}_{part}"] / believed[f"{beam}_{part}"])
    effects: dict[str, dict[str, float]] = {name: dict(table) for name, table in prototype.effects.items()}
    for name in found.hypothesis.effects:
        own = {
            u.name.removeprefix(name + "."): u.value(z)
            for u, z in zip(found.unknowns, found.z, strict=True)
            if u.name.startswith(name + ".")
        }
        effects[name] = {key: float(value) for key, value in own.items()}
    changes: dict[str, Any] = {
        "outer_beam": _beam(prototype.outer_beam, "outer", figures),
        "inner_beam": _beam(prototype.inner_beam, "inner", figures),
        "actuator": prototype.actuator.but(
            piston_area_m2=figures["piston_area"], oil_stiffness_N_per_m=figures["oil_stiffness"]
        ),
        "servovalve": prototype.servovalve.but(
            flow_gain_m3_per_s_per_A=figures["flow_gain"],
            leakage_m3_per_s_per_Pa=figures["leakage"],
            natural_frequency_Hz=figures["valve_frequency"] / (2 * pi),
            damping_ratio=figures["valve_damping_ratio"],
        ),
        "sensor": prototype.sensor.but(
            gain_V_per_m=figures["sensor_gain"],
            filter_Hz=None if prototype.sensor.filter_Hz is None else figures["filter_frequency"] / (2 * pi),
        ),
        "supply": prototype.supply.but(pressure_Pa=found.values.get(SUPPLY, prototype.supply.pressure_Pa)),
        "effects": effects,
        "guarantee": None,
    }
    return prototype.but(**changes)


def _beam(beam: Beam, name: str, figures: dict[str, float]) -> Beam:
    stiffness, mass, dashpot = (figures[f"{name}_{part}"] for part in ("stiffness", "mass", "damping"))
    ratio = dashpot / (2 * sqrt(stiffness * mass))
    return beam.but(stiffness_N_per_m=stiffness, effective_mass_kg=mass, damping_ratio=ratio)
