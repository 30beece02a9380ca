"""A rig built to a design: the truth model with its tolerances drawn and an effect in it, run in the designed loop.

It shares no effect code with the diagnosis, so that what is found on its records is found and not read back.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from beamdesign.controllers import Controller
from beamdesign.prototype import Prototype
from beamdesign.records import InputError
from beamdesign.structure.lumped import lumped_beam
from beamdesign.validation.truth.case import Case, Departure, Drive, Run, run_figures, take
from beamdesign.validation.truth.drawing import linear_critical_gain
from beamdesign.validation.truth.effects import KINDS, Scales
from beamdesign.validation.truth.nominal import assembled, draw_true, rig_figures
from beamdesign.validation.truth.rig import Noise
from beamdesign.validation.truth.rig_kinds import on

_GAIN_SHARE = 0.6
"""Of the critical gain of the rig without its effect: records are not taken closer to it, as nobody would."""

LINEAR = (
    "none", "sensor_lag", "mount_compliance", "second_beam_mode", "entrained_air", "coil_lag", "structural_damping",
    "unequal_piston_areas",
)  # fmt: skip
"""Effects that the linearised truth has in it; of others (delay, friction, play) its critical gain tells nothing."""

_NOISE = Noise(displacement_m=0.5e-6, quantum_m=2e-7, force_N=0.5, current_A=2e-5, drift_m=0.2e-6)
_HABITS = {"bulk_modulus": 1.2e9, "supply": 17e6, "leakage_across": 0.4, "stroke_on": 1.0}


class RunawayError(Exception):
    """A rig that cannot be run in any loop like the designed one."""


def nominal_table(prototype: Prototype) -> dict[str, Any]:
    """A prototype as the truth model reads it: lumped figures, tolerances, nothing of its controller."""
    stated = {"name", "actuator", "servovalve", "sensor", "tolerance"}
    table = prototype.model_dump(mode="json", exclude_none=True, include=stated)
    for name, beam in (("outer_beam", prototype.outer_beam), ("inner_beam", prototype.inner_beam)):
        lumped = lumped_beam(beam)
        table[name] = {
            "stiffness_N_per_m": lumped.stiffness,
            "effective_mass_kg": lumped.mass,
            "damping_ratio": beam.damping_ratio,
        }
    return table


def virtual_rig(
    prototype: Prototype, masses_kg: tuple[float, float], effect: str, severity: float, seed: int, duration_s: float
) -> Case:
    """Build a rig to a design and plan its records, in the designed loop or as near to it as the rig bears.

    Args:
        prototype: with its lag and inner end mass.
        masses_kg: payload range; records are taken at both ends.
        effect: a key of `beamdesign.validation.truth.effects.KINDS`, or none.
        severity: of it; 1 is what a careful designer would not overlook.
        seed: of tolerances, effect and signals.
        duration_s: of each record.

    Raises:
        InputError: for an unknown effect.
        RunawayError: where a record of it has no end.
    """
    possible = on("ball_screw" if prototype.rig == "ball_screw" else "lag", KINDS)
    if effect not in ("none", *possible):
        reason = f"no effect {effect!r} of such a rig; there are none, {', '.join(possible)}"
        raise InputError("options", [("effect", reason)])
    law, nominal = prototype.own_controller, nominal_table(prototype)
    rng = np.random.default_rng(seed)
    factors = draw_true(nominal, rng)
    scales = Scales(rig_figures(nominal, factors, _HABITS), 900.0, 7.5e-3)
    departures = () if effect == "none" else (Departure(effect, severity, KINDS[effect].shape(rng)),)
    kind = "null" if effect == "none" else "single"
    case = Case(seed, kind, nominal, factors, dict(_HABITS), (), departures, (), _NOISE, duration_s, scales)
    inner = prototype.payload.inner_end_mass_kg
    runs = []
    for number, (name, channel, size, highest, mass) in enumerate(
        (
            ("01_disturbance", "disturbance_N", 150.0, 200.0, masses_kg[0]),
            ("02_command", "command_V", 0.1, 300.0, masses_kg[0]),
            ("03_payload_disturbance", "disturbance_N", 100.0, 150.0, masses_kg[1]),
            ("04_payload_command", "command_V", 0.1, 250.0, masses_kg[1]),
        )
    ):
        gain = min(law.gain_A_per_V, _GAIN_SHARE * critical_gain(case.only(), law, mass, inner))
        table = law.but(gain_A_per_V=float(f"{gain:.3g}")).model_dump()
        runs.append(Run(name, Drive(channel, "lines", size, highest, seed + 100 * number), table, mass, inner))  # type: ignore[arg-type]
    whole = replace(case, runs=tuple(runs))
    if not all(take(whole, run).bounded for run in whole.runs):
        raise RunawayError(f"a record of this rig runs away: {effect} of severity {severity:g} is too much for it")
    return whole


def runs(case: Case, design: Prototype, masses_kg: tuple[float, float]) -> bool:
    """Whether the virtual rig, simulated under a disturbance with a design's loop, stays bounded at both payloads."""
    drive = Drive("disturbance_N", "lines", 150.0, 200.0, case.seed + 999)
    law, inner = design.own_controller, design.payload.inner_end_mass_kg
    return all(take(case, Run("", drive, law.model_dump(), mass, inner)).bounded for mass in masses_kg)


def critical_gain(case: Case, law: Controller, outer_end_mass_kg: float, inner_end_mass_kg: float) -> float:
    """Gain at which the true rig, linearised, begins to oscillate with the breaks of a lag, A/V."""
    unit = law.but(gain_A_per_V=1.0).model_dump()
    run = Run("", Drive("disturbance_N", "lines", 1.0, 10.0, 0), unit, outer_end_mass_kg, inner_end_mass_kg)
    return float(linear_critical_gain(*assembled(run_figures(case, run))))


def gain_margin(case: Case, design: Prototype, masses_kg: tuple[float, float]) -> float:
    """Least critical gain of the virtual rig at both ends of the payload, over a design's gain; 1 is the brink."""
    law, inner = design.own_controller, design.payload.inner_end_mass_kg
    return min(critical_gain(case, law, mass, inner) for mass in masses_kg) / law.gain_A_per_V
