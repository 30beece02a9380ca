"""Effects as changes of the true rig's figures, each with a severity that may be turned up and down."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from math import pi, sqrt
from typing import Any

import numpy as np

Shape = dict[str, Any]
"""Figures by name; all but a law's matrices are single numbers."""


def rounded(value: float, digits: int = 3) -> float:
    """As a person states it: to so many significant digits."""
    return float(f"{value:.{digits}g}")


@dataclass(frozen=True)
class Scales:
    """Magnitudes of one rig by which effects are sized.

    Attributes:
        figures: of the rig without the effect.
        force: largest load, N.
        current: RMS under the large disturbance, A.
    """

    figures: Mapping[str, float]
    force: float
    current: float


@dataclass(frozen=True)
class Kind:
    """One effect that a rig may have.

    Attributes:
        name: of the contract, or of an effect outside it.
        subsystem: where it sits.
        shape: draws what does not grow with the severity.
        figures: from scales, shape and severity to changed figures; keys that begin with `modes.` change the outer
            beam's modes, see `outer_modes`.
        range: least and largest severity.
        stated: figures in the units of the contract's effects, for the answer.
    """

    name: str
    subsystem: str
    shape: Callable[[np.random.Generator], Shape]
    figures: Callable[[Scales, Shape, float], Shape]
    range: tuple[float, float]
    stated: Callable[[Mapping[str, float]], Shape] = field(default=lambda f: {})


_QUICKEST = 3e4
"""rad/s; a lag quicker than this is none, and would not fit into the steps of the simulation."""


def _lag(scales: Scales, shape: Shape, severity: float) -> Shape:
    rate = 2 * pi * 400 / severity
    if 2 * rate > _QUICKEST:
        return {}
    if shape["order"] > 1.5:  # the same delay at low frequency
        return {"lag_rate": 2 * shape["zeta"] * rate, "lag_order": 2.0, "lag_damping_ratio": shape["zeta"]}
    return {"lag_rate": rate, "lag_order": 1.0}


def _stated_lag(f: Mapping[str, float]) -> Shape:
    rate = f["lag_rate"] / (2 * f["lag_damping_ratio"] if f["lag_order"] > 1.5 else 1.0)
    return {"break_Hz": rate / (2 * pi), "order": f["lag_order"]}


def _areas(scales: Scales, shape: Shape, severity: float) -> Shape:
    mean = 0.5 * (scales.figures["area_a"] + scales.figures["area_b"])
    part = min(0.12 * severity, 0.45) * shape["side"]
    return {"area_a": mean * (1 + part), "area_b": mean * (1 - part), "metering": shape["metering"]}


def _stated_areas(f: Mapping[str, float]) -> Shape:
    part = (f["area_a"] - f["area_b"]) / (f["area_a"] + f["area_b"])
    # With orifices at both edges speed goes with the root of the area that drives: the other way round, and half.
    return {"area_ratio_part": part, "asymmetry": -part / 2 if f["metering"] > 0.5 else part}


def _seal(scales: Scales, shape: Shape, severity: float) -> Shape:
    coulomb = scales.force / 15 * severity
    return {
        "coulomb": coulomb,
        "breakaway": coulomb * shape["breakaway"],
        "stribeck_speed": shape["stribeck"],
        "stribeck_power": shape["power"],
        "bristle_stiffness": coulomb / shape["presliding"],
        "bristle_damping": shape["micro"] * sqrt(coulomb / shape["presliding"]),
        "viscous": coulomb * shape["viscous"],
    }


def _spool(scales: Scales, shape: Shape, severity: float) -> Shape:
    width = scales.current / 75 * severity
    if shape["magnet"] > 0:
        return {"magnet_share": shape["magnet"], "magnet_width": width / (0.6 * shape["magnet"])}
    return {"spool_friction": width, "spool_travel": width * shape["travel"], "spool_sharpness": shape["sharpness"]}


def _stated_spool(f: Mapping[str, float]) -> Shape:
    # A little of the one may lie in the background of the other.
    return {"half_width_A": 0.6 * f["magnet_share"] * f["magnet_width"] + f["spool_friction"]}


def _mount(scales: Scales, shape: Shape, severity: float) -> Shape:
    stiffness = 10 * scales.figures["modes.stiffness"] / severity
    rate = 2 * pi * shape["hertz"]
    slide, slide_rate = stiffness * shape["slide"], rate * shape["slide_rate"]
    return {
        "mount_on": 1.0,
        "mount_stiffness": stiffness,
        "mount_mass": stiffness / rate**2,
        "mount_damping": 2 * shape["zeta"] * stiffness / rate,
        "mount_inner_ratio": shape["inner_ratio"],
        "slide_stiffness": slide,
        "slide_mass": slide / slide_rate**2,
        "slide_damping": 2 * shape["zeta"] * slide / slide_rate,
        "sensor_on_mount": shape["sensor_on_mount"],
    }


def _stated_mount(f: Mapping[str, float]) -> Shape:
    rate = sqrt(f["mount_stiffness"] / f["mount_mass"])
    return {
        "stiffness_N_per_m": f["mount_stiffness"],
        "frequency_Hz": rate / (2 * pi),
        "damping_ratio": f["mount_damping"] * rate / (2 * f["mount_stiffness"]),
        "sensor_share": f["sensor_on_mount"],
    }


def _play(scales: Scales, shape: Shape, severity: float) -> Shape:
    play = 50e-6 * severity
    if "lead" in scales.figures:  # of a nut between the flanks of its screw
        return {"lost_motion": play}
    rod, inner = shape["rod"], scales.figures["inner_mass"]
    return {
        "joint_on": 1.0, "play": play, "contact": shape["contact"], "contact_loss": shape["loss"],
        "rod_mass": rod * inner, "inner_mass": (1 - rod) * inner,  # the rod was weighed with the inner beam
    }  # fmt: skip


def _stated_play(f: Mapping[str, float]) -> Shape:
    if f["lead"] > 0:
        return {"play_m": f["lost_motion"]}
    return {"play_m": f["play"], "rod_mass_kg": f["rod_mass"]}


def _appendage(inner: float, scales: Scales, shape: Shape, severity: float) -> Shape:
    return {
        "appendage_mass": 0.05 * severity * scales.figures["inner_mass"], "appendage_inner": inner,
        "appendage_rate": 2 * pi * shape["hertz"], "appendage_damping_ratio": shape["zeta"],
    }  # fmt: skip


def _loss(scales: Scales, shape: Shape, severity: float) -> Shape:
    return dict.fromkeys(("loss_1", "loss_2", "loss_3", "loss_4"), 0.05 * severity * scales.figures["modes.stiffness"])


def _log(low: float, high: float) -> Callable[[np.random.Generator], float]:
    return lambda rng: float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _between(low: float, high: float) -> Callable[[np.random.Generator], float]:
    return lambda rng: float(rng.uniform(low, high))


def _one_of(*values: float) -> Callable[[np.random.Generator], float]:
    return lambda rng: float(rng.choice(values))


def _draws(**each: Callable[[np.random.Generator], float]) -> Callable[[np.random.Generator], Shape]:
    return lambda rng: {name: draw(rng) for name, draw in each.items()}


def _drift(
    name: str, subsystem: str, figure: str, size: float, bounds: tuple[float, float], span: tuple[float, float]
) -> Kind:
    """A figure that rises or falls over the record, by a share within bounds."""
    draws = _draws(sign=_one_of(1, -1))
    return Kind(name, subsystem, draws, lambda s, q, v: {figure: float(np.clip(size * v * q["sign"], *bounds))}, span)


_LISTED = (
    Kind(
        "sensor_lag", "sensor", _draws(order=_one_of(1, 1, 2), zeta=_between(0.6, 1.0)), _lag, (0.17, 8), _stated_lag
    ),
    Kind(
        "transport_delay", "controller", _draws(), lambda s, q, v: {"delay": 0.5e-3 * v}, (0.2, 9),
        lambda f: {"delay_s": f["delay"]},
    ),
    Kind(
        "unequal_piston_areas", "actuator", _draws(side=_one_of(1, 1, -1), metering=_one_of(0, 0, 1)), _areas,
        (0.05, 3.6), _stated_areas,
    ),
    Kind(
        "pressure_dependent_flow", "servovalve", _draws(laminar=_log(5e3, 2e5)),
        lambda s, q, v: {
            "orifice": 1.0, "laminar": q["laminar"],
            "supply": float(np.clip(2.5 * s.force / s.figures["area_a"] / v, 0.5e6, 45e6)),
        },
        (0.4, 3.5), lambda f: {"supply_pressure_Pa": f["supply"]},
    ),
    Kind(
        "entrained_air", "oil", _draws(exponent=_between(1.0, 1.4), saturation=_log(1e8, 1e9), supply=_log(5e6, 15e6)),
        lambda s, q, v: {
            "air_share": 0.05 * v, "air_exponent": q["exponent"], "air_saturation": q["saturation"],
            # A bench does not load a cylinder beyond its stall.
            "supply": max(q["supply"], 1.2 * s.force / s.figures["area_a"]),
        },
        (0.05, 6),
        lambda f: {
            "air_fraction": f["air_share"], "oil_bulk_modulus_Pa": f["bulk_modulus"], "supply_pressure_Pa": f["supply"]
        },
    ),
    Kind(
        "seal_friction", "actuator",
        _draws(
            breakaway=_between(1.0, 1.6), stribeck=_log(2e-3, 3e-2), power=_between(1, 2), presliding=_log(4e-6, 4e-5),
            micro=_between(0.1, 0.6), viscous=_between(0, 4),
        ),
        _seal, (0.01, 5),
        lambda f: {
            "coulomb_N": f["coulomb"], "breakaway_ratio": f["breakaway"] / f["coulomb"],
            "stribeck_m_per_s": f["stribeck_speed"], "presliding_m": f["coulomb"] / f["bristle_stiffness"],
            "viscous_N_s_per_m": f["viscous"],
        },
    ),
    Kind(
        "valve_deadband", "servovalve", _draws(rounding=_between(0.04, 0.3)),
        lambda s, q, v: {"overlap": s.current / 35 * v, "overlap_rounding": q["rounding"]}, (0.02, 15),
        lambda f: {"half_width_A": f["overlap"]},
    ),
    Kind(
        "valve_hysteresis", "servovalve",
        _draws(magnet=_one_of(0, 0, 0.6, 0.9), travel=_between(0.3, 1.5), sharpness=_between(1, 2)), _spool, (0.02, 15),
        _stated_spool,
    ),
    Kind(
        "current_saturation", "amplifier", _draws(knee=_between(6, 20)),
        lambda s, q, v: {"current_limit": 3 * s.current / v, "current_knee": q["knee"]}, (0.7, 12),
        lambda f: {"limit_A": f["current_limit"]},
    ),
    Kind(
        "motor_current_limit", "amplifier", _draws(knee=_between(6, 20)),
        lambda s, q, v: {"motor_limit": 3 * s.current / v, "motor_knee": q["knee"]}, (2.5, 25),
        lambda f: {"limit_A": f["motor_limit"]},
    ),
    Kind(
        "second_beam_mode", "structure",
        _draws(mass=_between(0, 0.3), tip=_between(0, 0.15), zeta=_log(0.004, 0.03)),
        lambda s, q, v: {
            # A heavy tip holds the higher modes still: that is how the effect becomes small.
            "modes.softness": v, "modes.joint_mass": q["mass"], "modes.zeta": q["zeta"],
            "modes.tip_share": q["tip"] + 0.3 * max(0.0, 1 / v - 1), "modes.count": 4.0,
        },
        (0.02, 25),
    ),
    Kind(
        "mount_compliance", "structure",
        _draws(
            hertz=_log(40, 250), zeta=_log(0.008, 0.06), slide=_log(4, 40), slide_rate=_between(0.8, 2),
            inner_ratio=_between(0.95, 1.15), sensor_on_mount=_one_of(0, 0, 1),
        ),
        _mount, (0.03, 5), _stated_mount,
    ),
    Kind(
        "joint_backlash", "structure",
        _draws(contact=_log(5e10, 2e11), loss=_log(0.5, 5), rod=_between(0.06, 0.2)), _play, (0.01, 12), _stated_play,
    ),
)  # fmt: skip

_OUTSIDE = (
    Kind(
        "supply_sag", "oil", _draws(rate=_log(2, 60)),
        lambda s, q, v: {
            "sag_rate": q["rate"], "sag_droop": 0.2 * v * s.figures["supply"] / (s.figures["flow_gain"] * s.current)
        },
        (0.02, 4.5),
    ),
    _drift("flow_gain_drift", "servovalve", "flow_drift", 0.2, (-0.9, 3.0), (0.05, 8)),
    _drift("sensor_gain_drift", "sensor", "sensor_drift", 0.1, (-0.7, 1.5), (0.02, 8)),
    Kind(
        "sensor_cubic", "sensor", _draws(sign=_one_of(1, -1)),
        lambda s, q, v: {"sensor_cubic": q["sign"] * 0.05 * v / (2e-3) ** 2}, (0.02, 30),
    ),
    Kind("sensor_stiction", "sensor", _draws(), lambda s, q, v: {"sensor_play": 2e-6 * v}, (0.05, 60)),
    Kind(
        "coil_lag", "amplifier", _draws(),
        lambda s, q, v: {"coil_rate": 2 * pi * 400 / v} if 2 * pi * 400 / v < _QUICKEST else {}, (0.15, 8)
    ),
    Kind(
        "command_hum", "controller", _draws(hertz=_one_of(50, 60, 100), phase=_between(0, 6.28)),
        lambda s, q, v: {
            "hum": 1e-3 * v * s.figures["sensor_gain"] / 1180, "hum_rate": 2 * pi * q["hertz"], "hum_phase": q["phase"]
        },
        (0.05, 100),
    ),
    Kind(
        "coarse_output", "controller", _draws(hold=_one_of(0.5e-3, 1e-3)),
        lambda s, q, v: {"current_step": s.current / 100 * v, "current_hold": q["hold"]}, (0.02, 60),
    ),
    Kind("structural_damping", "structure", _draws(), _loss, (0.02, 8)),
    Kind(
        "beam_hardening", "structure", _draws(sign=_one_of(1, 1, -0.3)),
        lambda s, q, v: {"hardening": q["sign"] * 0.1 * v / (2e-3) ** 2}, (0.02, 30),
    ),
    Kind(
        "payload_slosh", "structure", _draws(hertz=_log(6, 40), zeta=_log(0.01, 0.1)),
        lambda s, q, v: {
            "slosh_share": 1 - 1 / (1 + 0.2 * v), "slosh_frequency": 2 * pi * q["hertz"],
            "slosh_damping_ratio": q["zeta"],
        },
        (0.01, 20),
    ),
    Kind(
        "sensor_bracket", "sensor", _draws(zeta=_log(0.01, 0.1), share=_between(0.5, 1)),
        lambda s, q, v: {
            "bracket_rate": 2 * pi * 400 / v, "bracket_damping_ratio": q["zeta"], "bracket_share": q["share"]
        },
        (0.3, 5),
    ),
    Kind(
        "sensor_curved", "sensor", _draws(sign=_one_of(1, -1)),
        lambda s, q, v: {"sensor_square": q["sign"] * 0.05 * v / 2e-3}, (0.02, 15),
    ),
    Kind("quadratic_drag", "actuator", _draws(), lambda s, q, v: {"drag": s.force / 0.2**2 * v}, (0.02, 30)),
    Kind(
        "squeezed_seal", "actuator", _draws(speed=_log(5e-4, 5e-3)),
        lambda s, q, v: {"squeezed": 0.05 * v * s.figures.get("area_a", 1.0), "squeezed_speed": q["speed"]}, (0.05, 6),
    ),
    Kind(
        "growing_leakage", "actuator", _draws(),
        lambda s, q, v: {"leakage_growth": v * s.figures["area_a"] / s.force}, (0.2, 60),
    ),
    Kind("warming_oil", "oil", _draws(), lambda s, q, v: {"warming": 0.1 * v}, (0.05, 5)),
    *(
        Kind(of, "structure", _draws(hertz=_log(15, 150), zeta=_log(0.005, 0.08)), partial(_appendage, at), (0.02, 10))
        for of, at in (("appendage_outer", 0.0), ("appendage_inner", 1.0))
    ),
    Kind(
        "cable", "structure", _draws(), lambda s, q, v: {"cable": 0.05 * v * s.figures["modes.stiffness"]}, (0.02, 10),
    ),
    Kind(
        "sensor_dropout", "sensor", _draws(length=_log(5e-3, 4e-2)),
        lambda s, q, v: {"dropouts_per_s": 0.4 * v, "dropout_s": q["length"]}, (0.6, 8),
    ),
)  # fmt: skip

_OF_SCREWS = (
    Kind(
        "torque_ripple", "actuator", _draws(harmonic=_one_of(18, 24, 36)),
        lambda s, q, v: {"torque_ripple": 0.05 * v, "ripple_per_turn": q["harmonic"]}, (0.02, 15),
    ),
    _drift("torque_drift", "actuator", "torque_drift", 0.2, (-0.9, 3.0), (0.05, 8)),
)  # fmt: skip
OF_CYLINDERS = (
    "unequal_piston_areas", "pressure_dependent_flow", "entrained_air", "valve_deadband", "valve_hysteresis",
    "supply_sag", "flow_gain_drift", "growing_leakage", "warming_oil",
    "coil_lag",  # of a motor it is a slower current loop, which is a figure
)  # fmt: skip

KINDS: dict[str, Kind] = {kind.name: kind for kind in (*_LISTED, *_OUTSIDE, *_OF_SCREWS)}
OF_SCREWS = (*(kind.name for kind in _OF_SCREWS), "motor_current_limit")
LISTED = tuple(kind.name for kind in _LISTED)
OUTSIDE = tuple(kind.name for kind in (*_OUTSIDE, *_OF_SCREWS))
