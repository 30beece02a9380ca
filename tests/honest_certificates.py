"""Certificates as they were written, of every kind that is forged, and what tells whether one is valid, and of what."""

import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, partial
from typing import Any, Literal

import numpy as np
import pytest
import truth_of_arm_plane
import truth_of_box
import truth_of_contact
import truth_of_mass_range
import truth_of_stages
from flint import fmpq
from forging import Table, is_number

from beamdesign import Prototype, certify, check
from beamdesign.checker import Unreadable, reading, work
from beamdesign.checker.prototype import differences
from beamdesign.checker.rig import Rig
from beamdesign.controllers import Lag, Observer, Proportional, Scheduled, Section, Stage, Structured
from beamdesign.plant.actuators.ball_screw import BallScrew
from beamdesign.plant.actuators.servo_cylinder import ServoCylinder
from beamdesign.proofs import error_over_box
from beamdesign.proofs.absolute_stability import slope_over_box
from beamdesign.proofs.arm.result import certify_plane
from beamdesign.proofs.box import Box, certify_box
from beamdesign.proofs.box_claims import BoxClaim, claim_over_box
from beamdesign.proofs.certificate import Asked, Row
from beamdesign.proofs.contact import Wall
from beamdesign.proofs.error_over_box import errors_over_box
from beamdesign.proofs.lyapunov import stages_certificate, switching
from beamdesign.proofs.mass_family import stage_families
from beamdesign.proofs.tolerance_box import tolerance_box
from beamdesign.proofs.writer import prototype_table
from beamdesign.prototype import Arm, Beam, Payload, Sensor, Servovalve, Tolerance
from beamdesign.synthesis.end_stiffness import contact_text, judge

AT_LEAST = 500
"""Mutations for every kind of certificate, shared out among those of a kind."""
SHARE = 8
"""Of the work that is done for a file, all that honest certificates come to: one over this."""
CLAIMS = ("decay_rate", 3.0), ("gain_margin", 1.05)
OF_THE_RIG = ("rig", "controller", "effect", "payload", "goal", "arm", "compliance", "material", "plane")


@dataclass(frozen=True)
class Honest:
    """A certificate as it was written, and the prototype that it is of."""

    text: str
    prototype: Prototype
    largest_kg: float

    @property
    def table(self) -> Table:
        """As it is read."""
        return tomllib.loads(self.text)

    @property
    def given(self) -> Mapping[str, Any]:
        """The prototype as it is compared."""
        return prototype_table(self.prototype, self.largest_kg)


def _paper() -> Prototype:
    """The appendix of Zalucky and Hardt (1984) in SI, with a lag and 4.5 kg inside; the outer beam by its geometry."""
    return Prototype(
        name="paper",
        outer_beam=Beam(
            stiffness_N_per_m=486_800.0, material="6061-T6", free_length_m=1.195, width_m=0.14, wall_m=0.0023,
            end_mass_kg=2.93, damping_ratio=0.05,
        ),
        inner_beam=Beam(stiffness_N_per_m=157_500.0, effective_mass_kg=1.6, damping_ratio=0.05),
        actuator=ServoCylinder(piston_area_m2=1.13e-4, oil_stiffness_N_per_m=1.3e7),
        servovalve=Servovalve(
            flow_gain_m3_per_s_per_A=1.13e-2, leakage_m3_per_s_per_Pa=3.8e-13, natural_frequency_Hz=150.0,
            damping_ratio=0.5,
        ),
        sensor=Sensor(gain_V_per_m=1180.0),
        controller=Lag(gain_A_per_V=0.15, pole_Hz=1.75, zero_Hz=26.0),
        payload=Payload(inner_end_mass_kg=4.5, outer_end_mass_kg=(0.0, 6.8)),
    )  # fmt: skip


def certified(prototype: Prototype, masses: tuple[float, float], *claims: tuple[str, float]) -> Honest:
    """A certificate over a range of outer end masses, with what is claimed beside the best figures."""
    return Honest(certify(prototype, *masses, [Asked(*claim) for claim in claims]).text, prototype, masses[1])


def _stable() -> Honest:
    return certified(_paper(), (3.0, 6.8), *CLAIMS)


def _unstable() -> Honest:
    """With both crossings in the range."""
    return certified(_paper(), (0.0, 20.0))


def _effects() -> Honest:
    """Spans, a gain that varies, one more coordinate, filters."""
    slower = Lag(gain_A_per_V=0.05, pole_Hz=1.75, zero_Hz=26.0)
    effects: dict[str, dict[str, float]] = {"seal_friction": {}, "unequal_piston_areas": {}, "sensor_lag": {}}
    return certified(_paper().but(controller=slower, effects=effects), (3.0, 4.0))


def _sections() -> Honest:
    """Which also bounds the loop's gain and its effort."""
    section = Section(zero_Hz=30.0, zero_damping_ratio=0.6, pole_Hz=35.0, pole_damping_ratio=0.5)
    law = Structured(gain_A_per_V=0.08, pole_Hz=1.75, zero_Hz=26.0, section=(section,))
    return certified(_paper().but(controller=law), (3.0, 5.0), CLAIMS[0], ("controller_effort", 0.3))


def _sensors() -> Honest:
    """A lag in a realisation of its own, with a share of the load pressure, behind the sensor's filter."""
    pole, zero = 2 * np.pi * 1.75, 2 * np.pi * 26.0
    law = Observer(
        gain_A_per_V=0.1, sensors=("displacement_m", "load_pressure_Pa"), a=((-pole,),),
        b=((pole * (1 - pole / zero), 1e-9),), c=(1.0,), d=(pole / zero, 1e-9),
    )  # fmt: skip
    return certified(
        _paper().but(controller=law, sensor=Sensor(gain_V_per_m=1180.0, filter_Hz=400.0)), (4.0, 6.0), CLAIMS[1]
    )


def _tame() -> Prototype:
    """With less gain, which is stable at every mass and under many a change of it."""
    payload = Payload(inner_end_mass_kg=2.5, outer_end_mass_kg=(0.0, 6.8))
    return _paper().but(controller=Lag(gain_A_per_V=0.05, pole_Hz=1.7, zero_Hz=20.0), payload=payload)


def _moving() -> Honest:
    """Of the nonlinear loop: a multiplier, a gain that changes, bounded errors."""
    rig = _tame().but(effects={"valve_hysteresis": {}, "carrier_ripple": {}, "seal_friction": {}})
    return Honest(certify(rig, 3.0, 3.1, nonlinear=True).text, rig, 3.1)


def _sides() -> Honest:
    """Of unequal sides of the piston while the current saturates."""
    rig = _tame().but(effects={"unequal_piston_areas": {}, "sensor_lag": {}})
    return Honest(certify(rig, 3.0, 3.1, nonlinear=True).text, rig, 3.1)


def screw() -> Prototype:
    """The beams with a ball screw, whose lag is stable at every mass."""
    actuator = BallScrew(
        lead_m=0.02, screw_stiffness_N_per_m=8e7, screw_damping_N_s_per_m=600.0, torque_constant_N_m_per_A=1.2,
        rotor_inertia_kg_m2=8e-4, rotor_friction_N_m_s_per_rad=5e-3, speed_feedback_A_s_per_rad=0.5,
        current_loop_Hz=1000.0,
    )  # fmt: skip
    law = Lag(gain_A_per_V=800.0, pole_Hz=1.2, zero_Hz=18.0)
    payload = Payload(inner_end_mass_kg=2.0, outer_end_mass_kg=(0.0, 6.8))
    return _paper().but(name="screw", actuator=actuator, servovalve=None, controller=law, payload=payload)


def _screw() -> Honest:
    """With effects and what is proved of its nonlinear loop."""
    rig = screw().but(effects={"seal_friction": {}, "sensor_lag": {}, "motor_current_limit": {}})
    rig = rig.but(actuator=rig.actuator.but(speed_feedback_A_s_per_rad=2.0))
    return Honest(certify(rig, 3.0, 3.1, nonlinear=True).text, rig, 3.1)


def _screw_box() -> Honest:
    rig = screw().but(tolerance=Tolerance(torque_constant=0.03, rotor_inertia=0.03, lead=0.001))
    box = tolerance_box(rig, 1.0, None, (0.0, 2.0))
    claims = [claim_over_box(rig, box, one) for one in (Asked("peak_sensitivity", 2.5), Asked("compliance", 1e-7, 2.0))]
    assert all(claim.holds for claim in claims), [claim.reason for claim in claims]
    return Honest(certify_box(rig, box, volumes=False).write(claims), rig, 2.0)


def _plane(name: Literal["y", "z"], sideways_m: float) -> Honest:
    rig = _tame().but(arm=Arm(offset_m=(0.05, sideways_m, 0.0), end_polar_inertia_kg_m2=0.0073))
    return Honest(certify_plane(rig, name, 0.0, 6.8).text, rig, 6.8)


def _port() -> Honest:
    """Against walls of up to 1 GN/m."""
    rig, masses, wall = _tame(), (0.0, 6.8), Wall((fmpq(0), fmpq(10**9)))
    return Honest(contact_text(rig, judge(rig, None, masses, wall)), rig, 6.8)


def _box(gain_A_per_V: float, sigmas: float) -> Honest:
    tolerance = Tolerance(stiffness=0.03, flow_gain=0.05)
    law = Lag(gain_A_per_V=gain_A_per_V, pole_Hz=1.7, zero_Hz=20.0)
    rig = _tame().but(tolerance=tolerance, controller=law)
    found = certify_box(rig, tolerance_box(rig, sigmas, None, (0.0, 2.0)), volumes=False)
    assert found.certificate
    return Honest(found.certificate, rig, 2.0)


def _performing_box() -> Honest:
    """With what is claimed of every member."""
    rig = _tame().but(tolerance=Tolerance(stiffness=0.03, flow_gain=0.05))
    box = tolerance_box(rig, 1.0, None, (0.0, 2.0))
    asked = Asked("peak_sensitivity", 2.5), Asked("compliance", 6e-8, 2.5), Asked("controller_effort", 1.0)
    claims = [claim_over_box(rig, box, one) for one in asked]
    return Honest(certify_box(rig, box, volumes=False).write(claims), rig, 2.0)


def _lower_gains() -> Honest:
    """Stable at every lower gain, and with little loop gain at high frequencies."""
    rig = _tame().but(tolerance=Tolerance(stiffness=0.03, flow_gain=0.05))
    box = tolerance_box(rig, 1.0, None, (0.0, 2.0))
    asked = Asked("gain_margin", 0.0), Asked("gain_margin", 0.5), Asked("loop_gain", 0.2, from_Hz=250.0)
    claims = [claim_over_box(rig, box, one) for one in asked]
    assert all(claim.holds for claim in claims), [claim.reason for claim in claims]
    return Honest(certify_box(rig, box, volumes=False).write(claims), rig, 2.0)


def _resting() -> Honest:
    """Comes to rest while the current saturates."""
    rig = _tame().but(tolerance=Tolerance(stiffness=0.03, flow_gain=0.05))
    box = tolerance_box(rig, 1.0, None, (0.0, 2.0))
    claim, reason = slope_over_box(rig, box)
    assert claim is not None, reason
    return Honest(certify_box(rig, box, volumes=False).write([claim]), rig, 2.0)


def erring(effects: dict[str, dict[str, float]]) -> tuple[Prototype, Box, list[BoxClaim], list[Row]]:
    """A rig with two figures off, and how far its errors move the tip."""
    rig = _tame().but(tolerance=Tolerance(stiffness=0.03, flow_gain=0.05), effects=effects)
    box = tolerance_box(rig, 1.0, ["outer_stiffness", "flow_gain"], (0.0, 2.0))
    return rig, box, *errors_over_box(rig, box)


@contextmanager
def coarsely() -> Iterator[None]:
    """Bounds of errors over one piece of the outer end mass and fewer bands: larger ones, and quick to prove."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(error_over_box, "_HALVINGS", 0)
        patch.setattr(error_over_box, "_EXCESS", 0.05)
        yield


def _erring() -> Honest:
    with coarsely():
        rig, box, claims, rows = erring({"valve_hysteresis": {}})
    assert claims, rows
    return Honest(certify_box(rig, box, volumes=False).write(claims), rig, 2.0)


def _changing(law: Lag | Proportional | Scheduled, masses: tuple[float, float]) -> Honest:
    """A payload that changes however it likes, and a law that stays or several that take turns."""
    rig = _tame().but(controller=law)
    return Honest(stages_certificate(rig, switching(stage_families(rig), *masses), ""), rig, 6.8)


def _unsettled() -> Honest:
    return _changing(Lag(gain_A_per_V=0.15, pole_Hz=1.75, zero_Hz=26.0), (0.0, 6.8))


def _steady() -> Honest:
    return _changing(Proportional(gain_A_per_V=0.004), (0.0, 1.0))


def _stages() -> Honest:
    stages = (
        Stage(outer_end_mass_kg=(0.0, 4.0), gain_A_per_V=0.05, pole_Hz=1.7, zero_Hz=20.0),
        Stage(outer_end_mass_kg=(3.0, 6.8), gain_A_per_V=0.06, pole_Hz=1.7, zero_Hz=20.0),
    )
    return _changing(Scheduled(stage=stages), (2.0, 3.0))


Truth = Callable[[dict[str, Any]], bool | None]
FORGED: dict[str, tuple[Truth, dict[str, tuple[Callable[[], Honest], int]]]] = {
    "beamdesign.mass_range": (
        truth_of_mass_range.true,
        {
            "stable": (_stable, 90),
            "unstable": (_unstable, 210),
            "effects": (_effects, 60),
            "sections": (_sections, 60),
            "sensors": (_sensors, 80),
            "moving": (_moving, 80),
            "sides": (_sides, 60),
            "screw": (_screw, 60),
        },
    ),
    "beamdesign.arm_plane": (
        truth_of_arm_plane.true,
        {"twisted": (partial(_plane, "z", 0.1), 350), "straight": (partial(_plane, "y", 0.0), 150)},
    ),
    "beamdesign.box": (
        truth_of_box.true,
        {
            "stable": (partial(_box, 0.05, 1.0), 300),
            "performing": (_performing_box, 100),
            "lower_gains": (_lower_gains, 50),
            "screw": (_screw_box, 50),
            "resting": (_resting, 60),
            "erring": (_erring, 40),
            "unstable": (partial(_box, 0.4, 1.0), 50),
        },
    ),
    "beamdesign.contact": (truth_of_contact.true, {"walls": (_port, 500)}),
    "beamdesign.stages": (
        truth_of_stages.true,
        {"steady": (_steady, 200), "unsettled": (_unsettled, 200), "stages": (_stages, 100)},
    ),
}
"""For every kind of certificate a model of what it states, and certificates with how many mutations of each."""
EACH = [(kind, name) for kind, (_, made) in FORGED.items() for name in made]


@cache
def honest(kind: str, name: str) -> Honest:
    """One of the certificates."""
    return FORGED[kind][1][name][0]()


@contextmanager
def share_of_work(share: int = SHARE) -> Iterator[None]:
    """Certificates may ask for no more than one over `share` of what is done, so that it takes less to refuse one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(work, "OF_ANY", work.OF_ANY // share)
        patch.setattr(work, "PER_BYTE", work.PER_BYTE // share)
        yield


def valid(text: str, prototype: Any = None) -> bool:
    """Whether a certificate is proved again; nothing else may come of it than a verdict, or that it cannot be read."""
    try:
        return check(text, prototype).valid
    except Unreadable:
        return False


def is_another(table: Table, prototype: Mapping[str, Any]) -> bool:
    """Whether a certificate is told to be of another rig than a prototype; that takes no proof."""
    read = reading.Table(table)
    try:
        return any(differences(read, Rig(read), prototype))
    except Unreadable:
        return True


def figures(value: Any) -> Any:
    """A table with its numbers by their value."""
    if isinstance(value, dict):
        return {key: figures(item) for key, item in value.items()}
    if isinstance(value, list):
        return [figures(item) for item in value]
    return Fraction(value) if is_number(value) else value
