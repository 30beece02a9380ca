"""From the prototype of a bench to the structure and the figures of its rig."""

from collections.abc import Mapping
from math import pi

from beamdesign.bench_prototype import BenchPrototype
from beamdesign.records import InputError, Problem
from beamdesign.rig.assembly import RIGS, Structure
from beamdesign.rig.effects import library, problems

_STOP_DAMPING_RATIO = 0.5
SENSOR_V_PER_M = 50.0
"""Volts of the displacement sensor; effects in volts count on it, nothing else does."""


def problems_on_rig(tables: Mapping[str, Mapping[str, float]], rig: str) -> list[Problem]:
    """What is wrong with effects of a prototype on a kind of rig: also those that need a port it does not have."""
    found = list(problems(tables))
    ports, words = RIGS[rig].ports, RIGS[rig].words
    lacking = {
        name: [port for port in library()[name].laws if port not in ports] for name in tables if name in library()
    }
    return found + [
        Problem(f"effects.{name}", f"acts on {', '.join(missing)}, which {words} does not have")
        for name, missing in lacking.items()
        if missing
    ]


def bench_structure(prototype: BenchPrototype) -> Structure:
    """What decides the equations of a bench.

    Raises:
        InputError: where an effect or one of its parameters is unknown, out of bounds or not for a bench.
    """
    if wrong := problems_on_rig(prototype.effects, prototype.kind):
        raise InputError(prototype.name, wrong)
    filtered = prototype.sensors.displacement_filter_Hz is not None
    return Structure(None, filtered, tuple(sorted(prototype.effects)), prototype.kind)


def bench_parameters(prototype: BenchPrototype) -> dict[str, float]:
    """Parameters of the bench's assembly in its order, SI: figures of the rig and of its effects."""
    actuator, valve, sensors = prototype.actuator, prototype.servovalve, prototype.sensors
    stop_damping = 2 * _STOP_DAMPING_RATIO * (actuator.stop_stiffness_N_per_m * actuator.moving_mass_kg) ** 0.5
    values = {
        "piston_area": actuator.piston_area_m2,
        "stroke": actuator.stroke_m,
        "moving_mass": actuator.moving_mass_kg,
        "dead_volume": actuator.dead_volume_m3,
        "bulk_modulus": actuator.oil_bulk_modulus_Pa,
        "stop_stiffness": actuator.stop_stiffness_N_per_m,
        "stop_damping": stop_damping,
        "constant_load": actuator.constant_load_N,
        "supply_pressure": actuator.supply_pressure_Pa,
        "tank_pressure": actuator.tank_pressure_Pa,
        "line_loss": actuator.line_loss_Pa_s2_per_m6,
        "edge_b": valve.edge_b_ratio,
        "flow_gain": valve.flow_gain_m3_per_s_per_V / valve.amplifier_A_per_V,
        "leakage": valve.leakage_m3_per_s_per_Pa,
        "piston_leakage": actuator.piston_leakage_m3_per_s_per_Pa,
        "valve_frequency": 2 * pi * valve.natural_frequency_Hz,
        "valve_damping_ratio": valve.damping_ratio,
        "gain": valve.amplifier_A_per_V,
        "null": valve.null_V,
        "sensor_gain": SENSOR_V_PER_M,
        "sensor_zero": sensors.displacement_zero_m,
        "believed_sensor_gain": SENSOR_V_PER_M,
        "filter_frequency": 2 * pi * (sensors.displacement_filter_Hz or 1.0),
        "pressure_filter_frequency": 2 * pi * sensors.pressure_filter_Hz,
    }
    own = {  # what an effect that is named alone takes from the bench itself
        "pressure_dependent_flow.supply_pressure_Pa": actuator.supply_pressure_Pa,
        "unequal_piston_areas.asymmetry": actuator.asymmetry,
    }
    for name in sorted(prototype.effects):
        given = prototype.effects[name]
        for q in library()[name].parameters:
            key = f"{name}.{q.name}"
            values[key] = float(given.get(q.name, own.get(key, q.default)))
    return values
