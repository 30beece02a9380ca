"""The prototype of a bench with what a diagnosis has found in it."""

from beamdesign.bench_prototype import BenchPrototype
from beamdesign.gap.bench.fit import SteadyFit

_LEAST_COULOMB_N = 0.0


def parameters(prototype: BenchPrototype, fit: SteadyFit) -> dict[str, dict[str, tuple[float, float]]]:
    """Value and standard deviation of every parameter of a fit's causes, by contract names, SI."""
    amplifier = prototype.servovalve.amplifier_A_per_V
    named = {
        "unequal_piston_areas": {"asymmetry": ("asymmetry", 1.0)},
        "pressure_dependent_flow": {"supply_pressure_Pa": ("supply_pressure", 1.0)},
        "valve_deadband": {"half_width_A": ("deadband_V", amplifier)},
        "seal_friction": {
            "coulomb_N": ("coulomb_N", 1.0),
            "viscous_N_s_per_m": ("viscous", 1.0),
            "breakaway_ratio": ("breakaway_ratio", 1.0),
            "stribeck_m_per_s": ("stribeck_m_per_s", 1.0),
        },
        "parameter:piston_leakage": {"piston_leakage_m3_per_s_per_Pa": ("piston_leakage", 1.0)},
        "parameter:line_loss": {"line_loss_Pa_s2_per_m6": ("line_loss", 1.0)},
        "parameter:edge_b": {"edge_b_ratio": ("edge_b", 1.0)},
        "parameter:constant_load": {"constant_load_N": ("constant_load_N", 1.0)},
        "parameter:flow_gain": {"flow_gain_m3_per_s_per_V": ("flow_gain", 1.0)},
    }
    return {
        name: {
            key: (factor * fit.values[own], factor * fit.std[own])
            for key, (own, factor) in table.items()
            if own in fit.values
        }
        for name, table in named.items()
        if name in fit.hypothesis.names
    }


def amended(prototype: BenchPrototype, fit: SteadyFit, **readings: float | None) -> BenchPrototype:
    """The prototype with a fit's causes as effects and its figures in place of the believed ones.

    Args:
        prototype: what was believed.
        fit: of what is held responsible.
        readings: figures of its sensors that the data show; None: as believed.
    """
    found = {
        name: {key: value for key, (value, _) in table.items()} for name, table in parameters(prototype, fit).items()
    }
    effects = {name: table for name, table in found.items() if not name.startswith("parameter:")}
    if "seal_friction" in effects:
        effects["seal_friction"].setdefault("coulomb_N", _LEAST_COULOMB_N)
    value = fit.values
    actuator = prototype.actuator.but(
        piston_area_m2=value["piston_area"],
        supply_pressure_Pa=value["supply_pressure"],
        tank_pressure_Pa=value["tank_pressure"],
        piston_leakage_m3_per_s_per_Pa=value.get("piston_leakage", prototype.actuator.piston_leakage_m3_per_s_per_Pa),
        line_loss_Pa_s2_per_m6=value.get("line_loss", prototype.actuator.line_loss_Pa_s2_per_m6),
        constant_load_N=value.get("constant_load_N", prototype.actuator.constant_load_N),
    )
    valve = prototype.servovalve.but(
        flow_gain_m3_per_s_per_V=value["flow_gain"],
        edge_b_ratio=value.get("edge_b", prototype.servovalve.edge_b_ratio),
    )
    sensors = prototype.sensors.but(**{key: value for key, value in readings.items() if value is not None})
    return prototype.but(
        actuator=actuator, servovalve=valve, sensors=sensors, effects=dict(prototype.effects) | effects
    )
