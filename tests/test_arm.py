"""The arm: statics against closed forms and finite elements, coupled loops against matrices put together by hand."""

import json
import tomllib
from contextlib import suppress
from copy import deepcopy
from dataclasses import replace
from fractions import Fraction
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from arm_assembled import DENSITY_KG_PER_M3, LENGTH_M, SHEAR_PA, assemble, tube
from arm_elements import lever, matrices
from flint import fmpq
from forging import sealed_text
from loop_effort import effort_response
from plane_at_payload import at_tip
from scipy.integrate import solve_ivp
from scipy.linalg import eigh
from truth_of_arm_plane import Plane, true
from typer.testing import CliRunner

from beamdesign import InputError, Prototype, arm, certify, check, read_prototype, write_prototype
from beamdesign.checker import Unreadable
from beamdesign.cli import app
from beamdesign.controllers import Lag, Observer
from beamdesign.loop import LoopAtMass, loop
from beamdesign.polynomial import exact as exactly
from beamdesign.proofs.arm import PlaneLoop, plane_loop
from beamdesign.proofs.arm.both_planes import both_planes, prove_anywhere
from beamdesign.proofs.arm.remaining import (
    at_point,
    held,
    inner_travel,
    offset_for_goal_m,
    remaining,
    tip_compliance,
    twist_remedy,
)
from beamdesign.proofs.arm.result import certify_plane, frequencies
from beamdesign.proofs.writer import prototype_table
from beamdesign.prototype import Arm, Payload
from beamdesign.structure.arm import arm_figures
from beamdesign.structure.lumped import weighing_mass

END_INERTIA = 0.01
OFFSET = (0.08, 0.15, 0.0)


@pytest.fixture
def link(paper: Prototype) -> Prototype:
    """The published rig with its outer tube, a tame lag (1.7/20 Hz at 50 mA/V) and 2.5 kg inside."""
    tube = {"width_m": 0.140, "wall_m": 0.0023, "free_length_m": LENGTH_M, "material": "6061-T6"}
    return paper.but(
        outer_beam=paper.outer_beam.but(**tube),
        controller=Lag(gain_A_per_V=0.05, pole_Hz=1.7, zero_Hz=20.0),
        payload=Payload(inner_end_mass_kg=2.5, outer_end_mass_kg=(0.0, 6.8)),
        arm=Arm(end_polar_inertia_kg_m2=END_INERTIA),
    )


def at(link: Prototype, *offset: float) -> Prototype:
    assert link.arm is not None
    return link.but(arm=link.arm.but(offset_m=offset))


# Statics.


def test_a_held_end_turns_by_a_quarter_of_what_a_free_one_does_under_a_moment(link: Prototype):
    """Propped cantilever, Roark's Formulas, table 8.1: reaction 3 M / 2 L, slope M L / 4 E I."""
    figures = arm_figures(link)
    length, rigidity = figures.length, figures.bending_rigidity
    moment = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 7.0])  # about z: bends in y
    tip = tip_compliance(figures)
    compliance, actuators = held(tip, (0.0, 0.0))
    assert (tip @ moment)[5] == pytest.approx(7.0 * length / rigidity)
    assert (tip @ moment)[1] == pytest.approx(7.0 * length**2 / (2 * rigidity))
    assert (compliance @ moment)[1] == pytest.approx(0.0, abs=1e-15)
    assert (compliance @ moment)[5] == pytest.approx(7.0 * length / (4 * rigidity))
    assert actuators @ moment == pytest.approx([-1.5 * 7.0 / length, 0.0], abs=1e-9)


def test_a_force_on_the_tip_turns_the_end_only_without_servo(link: Prototype):
    figures = arm_figures(link)
    force = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    tip = tip_compliance(figures)
    assert (tip @ force)[2] == pytest.approx(1 / 486_800.0)
    assert (tip @ force)[4] == pytest.approx(-1.5 / (486_800.0 * LENGTH_M))
    assert (held(tip, (0.0, 0.0))[0] @ force)[[2, 4]] == pytest.approx([0.0, 0.0], abs=1e-18)


def test_compliance_of_the_held_tip_is_that_of_the_closed_loop(link: Prototype):
    closed = loop(link).at(0.0).static_compliance()
    servo = held(tip_compliance(arm_figures(link)), (closed, closed))[0]
    assert servo[1, 1] == pytest.approx(closed, rel=1e-9)
    assert servo[2, 2] == pytest.approx(closed, rel=1e-9)
    np.testing.assert_allclose(servo, servo.T, atol=1e-22)


@pytest.mark.parametrize("servo", [False, True])
def test_statics_are_those_of_finite_elements(link: Prototype, servo: bool):
    """Ends of Hermite elements deflect exactly; the servos are springs at the tip."""
    offset, closed = (0.08, 0.15, -0.06), (4e-9, 9e-9)
    figures = arm_figures(link)
    stiffness, _ = matrices(3, LENGTH_M, figures.bending_rigidity, figures.torsional_stiffness * LENGTH_M, 1.0, 1.0)
    if servo:
        for k, compliance in enumerate(closed):
            stiffness[k - 5, k - 5] += 1 / compliance - 486_800.0
    there = np.zeros((3, len(stiffness)))
    there[:, -5:] = lever(offset)
    expected = there @ np.linalg.solve(stiffness, there.T)
    tip = tip_compliance(figures)
    tip[0, 0] = 0.0  # these elements do not stretch
    found = at_point(held(tip, closed)[0] if servo else tip, offset)[:3, :3]
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-16)


def test_what_remains_is_twist_and_the_levers_on_the_end_that_turns(link: Prototype):
    """A servo without any error leaves F a_x^2 L / 4 E I and F a_y^2 L / G J at the payload."""
    figures = arm_figures(link)
    x, y, force = 0.1, 0.2, -1000.0
    case = remaining(figures, (0.0, 0.0, force), (x, y, 0.0), (x, y, 0.0), (0.0, 0.0))
    turning = force * x**2 * LENGTH_M / (4 * figures.bending_rigidity)
    twist = force * y**2 / figures.torsional_stiffness
    assert case.from_turning_m[2] == pytest.approx(turning)
    assert case.from_twist_m[2] == pytest.approx(twist)
    assert case.error_m[2] == pytest.approx(turning + twist)
    assert case.actuators_N[1] == pytest.approx(-force * (1 + 1.5 * x / LENGTH_M))
    alone = remaining(figures, (0.0, 0.0, force), (x, y, 0.0), (x, y, 0.0), None)
    assert alone.rotation_rad[0] == case.rotation_rad[0]  # no servo does anything about twist
    assert alone.tip_m[2] == pytest.approx(force / 486_800.0 * (1 + 1.5 * x / LENGTH_M))


def test_the_wider_tube_of_the_remedy_twists_as_asked(link: Prototype):
    rig, force, allowed = at(link, 0.0, 0.12, 0.0), (0.0, 0.0, -1500.0), 4e-5
    remedy = twist_remedy(rig, force, allowed, 6.8)
    for key, size in (("width_m", remedy.width_m), ("wall_m", remedy.wall_m)):
        beam = rig.outer_beam.but(**{key: size})
        other = rig.but(outer_beam=beam)
        case = remaining(arm_figures(other), force, (0.0, 0.12, 0.0), (0.0, 0.12, 0.0), None)
        assert case.shares_m["twist"] == pytest.approx(allowed, rel=1e-5)
    assert remedy.counterweight_kg_m == pytest.approx(6.8 * 0.12)
    most = offset_for_goal_m(rig)
    assert most**2 / arm_figures(rig).torsional_stiffness == pytest.approx(rig.goal.compliance_m_per_N)


# Frequencies.


@pytest.mark.parametrize(
    ("offset", "payload", "torsion"),
    [((0.0, 0.0, 0.0), 0.0, 0.025), ((0.0, 0.15, 0.0), 6.8, 0.01), (OFFSET, 6.8, 0.04), ((0.1, 0.2, -0.15), 6.8, 0.04)],
)
def test_frequencies_are_those_of_finite_elements(
    link: Prototype, offset: tuple[float, float, float], payload: float, torsion: float
):
    """Two shapes of bending and one of twist stand for all, so that frequencies come out too high, and a little only.

    An offset along the beam also hangs the payload on the end that turns, which the shapes leave out.
    """
    rig, figures = at(link, *offset), arm_figures(link)
    second, constant = tube(0.140, 0.0023)
    area = 4 * 0.0023 * (0.140 - 0.0023)
    per_length = DENSITY_KG_PER_M3 * area
    twist = SHEAR_PA * constant
    stiffness, mass = matrices(
        12, LENGTH_M, figures.bending_rigidity, twist, per_length, 2 * DENSITY_KG_PER_M3 * second
    )
    module = 3.9 - 0.236 * per_length * LENGTH_M
    mass[[-5, -4], [-5, -4]] += module
    mass[-3, -3] += END_INERTIA
    there = np.zeros((3, len(mass)))
    there[:, -5:] = lever(offset)
    mass += payload * there.T @ there
    expected = np.sqrt(eigh(stiffness, mass, eigvals_only=True)) / (2 * pi)
    found = frequencies(rig, payload).modes_Hz
    assert np.abs(found[:2] / expected[:2] - 1).max() < 3e-3
    assert found[2] == pytest.approx(expected[2], rel=torsion)
    assert found[2] > expected[2]


def test_torsion_alone_is_a_twisted_bar_with_an_end_inertia(link: Prototype):
    """k tan k = I_bar / I_end, e.g. Blevins, Formulas for Natural Frequency and Mode Shape (1979), table 8-20."""
    from scipy.optimize import brentq

    figures = arm_figures(link)
    bar = 3 * (figures.polar_inertia - END_INERTIA)
    wave = brentq(lambda k: k * np.tan(k) - bar / END_INERTIA, 0.1, 1.5)
    exact = wave * np.sqrt(figures.torsional_stiffness / bar) / (2 * pi)
    assert frequencies(link, 0.0).torsion_held_Hz == pytest.approx(exact, rel=0.03)


# The loops.


def test_without_offset_the_arm_is_the_single_loop(link: Prototype):
    own = certify(link, 0.0, 6.8)
    for name in ("y", "z"):
        plane, found = plane_loop(link, name), certify_plane(link, name, 0.0, 6.8)
        assert plane.characteristic == loop(link).characteristic
        assert found.stability.stable_ranges == own.stable_ranges_kg
        assert found.guaranteed is not None
        assert own.guaranteed is not None
        assert found.guaranteed.tip_bandwidth_Hz == found.guaranteed.load_bandwidth_Hz == own.guaranteed.bandwidth_Hz
        assert found.guaranteed.peak_sensitivity == pytest.approx(own.guaranteed.peak_sensitivity, rel=2e-4)


@pytest.mark.parametrize("payload", [0.0, 2.3, 6.8, 31.0])
@pytest.mark.parametrize("offset", [OFFSET, (0.0, 0.0, 0.2), (-0.05, -0.1, 0.0)])
def test_poles_are_those_of_matrices_put_together_by_hand(
    link: Prototype, payload: float, offset: tuple[float, float, float]
):
    rig = at(link, *offset)
    expected = np.linalg.eigvals(assemble(rig, payload, offset, END_INERTIA).a)
    found = np.concatenate([at_tip(plane_loop(rig, name), payload).poles() for name in ("y", "z")])
    assert len(found) == len(expected)
    for pole in found:
        assert np.abs(expected - pole).min() < 1e-6 * abs(pole)


@pytest.mark.parametrize("offset", [(0.1, 0.1, -0.2), (0.0, 0.15, 0.15)])
def test_poles_with_both_planes_coupled_are_those_of_matrices_put_together_by_hand(
    link: Prototype, offset: tuple[float, float, float]
):
    second = Lag(gain_A_per_V=0.03, pole_Hz=1.0, zero_Hz=20.0)
    assert link.arm is not None
    rig = link.but(arm=link.arm.but(offset_m=offset, second_controller=second))
    for payload in (0.0, 1.7, 6.8):
        expected = np.linalg.eigvals(assemble(rig, payload, offset, END_INERTIA).a)
        found = both_planes(rig).poles(payload)
        assert len(found) == len(expected)
        for pole in found:
            assert np.abs(expected - pole).min() < 1e-6 * abs(pole)


def at_load(plane: PlaneLoop, payload: float) -> LoopAtMass:
    """The loop at one payload (kg), its compliance being that of the payload's centre."""
    return replace(at_tip(plane, payload), disturbance=plane.load.at(exactly(payload)))


def test_responses_are_those_of_matrices_put_together_by_hand(link: Prototype):
    """Of tip, payload, twist and loop, at a payload other than those the polynomials were made at."""
    rig, payload, frequency = at(link, *OFFSET), 3.7, np.array([0.5, 8.0, 40.0, 150.0, 260.0])
    plane, by_hand = plane_loop(rig, "z"), assemble(rig, payload, OFFSET, END_INERTIA)
    s = 2j * pi * frequency

    def solved(a: np.ndarray, right: np.ndarray) -> np.ndarray:
        return np.stack([np.linalg.solve(at * np.eye(len(a)) - a, right) for at in s])

    motion = by_hand.motion @ solved(by_hand.a, by_hand.b)
    rest = 3 * OFFSET[0] ** 2 / (4 * 486_800.0 * LENGTH_M**2)
    moved = at_load(plane, payload).compliance_response(frequency)
    np.testing.assert_allclose(moved, motion[:, 2, 2] + rest, rtol=1e-7)
    gain = -solved(by_hand.opened, by_hand.valve) @ by_hand.current
    np.testing.assert_allclose(at_tip(plane, payload).loop_response(frequency), gain, rtol=1e-7)
    full = both_planes(rig).response(payload, frequency)
    motion[:, [1, 2], [1, 2]] += rest
    np.testing.assert_allclose(full, motion, rtol=1e-6, atol=1e-14)


SENSORS = [((0.0, 0.15, 0.0), (0.0, 0.15, 0.0)), (OFFSET, (0.0, 0.1, 0.05)), ((0.0, 0.1, -0.1), (0.0, 0.1, -0.1))]


@pytest.mark.parametrize(("offset", "sensor"), SENSORS)
def test_servos_that_measure_elsewhere_are_those_put_together_by_hand(
    link: Prototype, offset: tuple[float, float, float], sensor: tuple[float, float, float]
):
    """Poles and responses at the payload, in one plane and in both coupled; these sensors stand level with the tip."""
    assert link.arm is not None
    rig = link.but(arm=link.arm.but(offset_m=offset, sensor_m=sensor))
    model, frequency = both_planes(rig), np.array([0.5, 8.0, 40.0, 150.0])
    for payload in (0.0, 2.9, 6.8):
        by_hand = assemble(rig, payload, offset, END_INERTIA)
        expected = np.linalg.eigvals(by_hand.a)
        found = model.poles(payload)
        assert len(found) == len(expected)
        assert max(np.abs(expected / pole - 1).min() for pole in found) < 1e-6
        solved = [np.linalg.solve(2j * pi * f * np.eye(len(by_hand.a)) - by_hand.a, by_hand.b) for f in frequency]
        motion = by_hand.motion @ np.stack(solved)
        rest = 3 * offset[0] ** 2 / (4 * 486_800.0 * LENGTH_M**2)
        motion[:, [1, 2], [1, 2]] += rest
        np.testing.assert_allclose(model.response(payload, frequency), motion, rtol=1e-6, atol=1e-14)
        if offset[2] == 0:
            z = plane_loop(rig, "z")
            np.testing.assert_allclose(at_load(z, payload).compliance_response(frequency), motion[:, 2, 2], rtol=1e-6)
            gain = by_hand.opened, by_hand.valve, by_hand.current
            returned = [
                -gain[2] @ np.linalg.solve(2j * pi * f * np.eye(len(gain[0])) - gain[0], gain[1]) for f in frequency
            ]
            np.testing.assert_allclose(at_tip(z, payload).loop_response(frequency), returned, rtol=1e-6)


def with_pressure(link: Prototype, A_per_Pa: float) -> Prototype:
    """The lag as a law of one state, with the load pressure fed back beside it."""
    law = link.controller
    assert isinstance(law, Lag)
    rate, share = 2 * pi * law.pole_Hz, law.pole_Hz / law.zero_Hz
    sensors = ("displacement_m", "load_pressure_Pa")
    direct = [share, A_per_Pa / law.gain_A_per_V]
    two = Observer.of(law.gain_A_per_V, sensors, [[-rate]], [[rate, 0.0]], [1 - share], direct)
    return link.but(controller=two)


@pytest.mark.parametrize("sensor", [None, (0.0, 0.1, 0.05)])
@pytest.mark.parametrize("offset", [OFFSET, (0.0, 0.1, -0.1)])
def test_added_sensors_are_those_put_together_by_hand(
    link: Prototype, offset: tuple[float, float, float], sensor: tuple[float, float, float] | None
):
    """Load pressure fed back: poles, loop, payload with the servo and without, wherever displacement is measured."""
    assert link.arm is not None
    lag = link.but(arm=link.arm.but(offset_m=offset, sensor_m=sensor))
    gain, frequency = 1e-10, np.array([0.5, 8.0, 40.0, 150.0])
    rig, s = with_pressure(lag, gain), 2j * pi * frequency
    rest = 3 * offset[0] ** 2 / (4 * 486_800.0 * LENGTH_M**2)
    for payload in (0.0, 2.9, 6.8):
        by_hand = assemble(lag, payload, offset, END_INERTIA, gain)
        expected, found = np.linalg.eigvals(by_hand.a), both_planes(rig).poles(payload)
        assert len(found) == len(expected)
        assert max(np.abs(expected / pole - 1).min() for pole in found) < 1e-6
        for servo, a in ((True, by_hand.a), (False, by_hand.passive)):
            motion = by_hand.motion @ np.stack([np.linalg.solve(x * np.eye(len(a)) - a, by_hand.b) for x in s])
            motion[:, [1, 2], [1, 2]] += rest
            response = both_planes(rig).response(payload, frequency, servo)
            np.testing.assert_allclose(response, motion, rtol=1e-6, atol=1e-14)
            if servo and offset[2] == 0:
                load = at_load(plane_loop(rig, "z"), payload).compliance_response(frequency)
                np.testing.assert_allclose(load, motion[:, 2, 2], rtol=1e-6)
        if offset[2] == 0:
            cut = [np.linalg.solve(x * np.eye(len(by_hand.a)) - by_hand.opened, by_hand.valve) for x in s]
            loop_gain = at_tip(plane_loop(rig, "z"), payload).loop_response(frequency)
            np.testing.assert_allclose(loop_gain, [-by_hand.current @ one for one in cut], rtol=1e-6)


def test_certificates_of_added_sensors_are_proved_again(link: Prototype):
    """In both planes, the second law among them; a limit below what was proved is not."""
    rig = with_pressure(at(link, 0.05, 0.05, 0.0), 1e-10)
    assert rig.arm is not None
    goal = link.goal.but(loop_gain=0.25, controller_effort_A_per_V=0.06)
    rig = rig.but(goal=goal, arm=rig.arm.but(second_controller=with_pressure(link, -1e-10).controller))
    for name in ("y", "z"):
        found = certify_plane(rig, name, 0.0, 6.8)
        assert check(found.text, prototype_table(rig)).valid
        (limit,) = (c["limit"] for c in tomllib.loads(found.text)["claim"] if c["kind"] == "peak_sensitivity")
        assert not check(
            sealed_text(found.text.replace(f'limit = "{limit}"', f'limit = "{0.999 * float(limit)}"'))
        ).valid


@pytest.mark.parametrize("pressure", [0.0, 1e-10])
@pytest.mark.parametrize("sensor", [None, (0.0, 0.15, 0.0), (0.08, 0.15, 0.0), (0.05, -0.1, 0.1)])
def test_at_rest_the_loops_are_the_statics(link: Prototype, sensor: tuple[float, float, float] | None, pressure: float):
    """The mode's compliance and what stands beside it make up the exact one, wherever the servos measure."""
    assert link.arm is not None
    link = with_pressure(link, pressure) if pressure else link
    rig = link.but(arm=link.arm.but(offset_m=OFFSET, sensor_m=sensor))
    closed = loop(link).at(0.0).static_compliance()
    servo = held(tip_compliance(arm_figures(rig)), (closed, closed), sensor or (0.0, 0.0, 0.0))[0]
    exact = at_point(servo, OFFSET)
    plane = plane_loop(rig, "z")
    assert at_load(plane, 4.0).static_compliance() == pytest.approx(exact[2, 2], rel=1e-9)
    slow = both_planes(rig).response(4.0, np.array([1e-4]))[0]
    np.testing.assert_allclose(slow[1:3, 1:3].real, exact[1:3, 1:3], rtol=1e-5, atol=1e-14)


def test_servos_that_measure_at_the_payload_hold_it_but_not_its_roll(link: Prototype):
    figures, force, place = arm_figures(link), (0.0, 0.0, -1000.0), (0.08, 0.15, 0.0)
    at_tip = remaining(figures, force, place, place, (0.0, 0.0))
    there = remaining(figures, force, place, place, (0.0, 0.0), place)
    assert there.size_m < 1e-12 < at_tip.size_m
    assert (
        there.rotation_rad[0] == at_tip.rotation_rad[0] == pytest.approx(-1000.0 * 0.15 / figures.torsional_stiffness)
    )
    assert link.arm is not None
    rig = link.but(arm=link.arm.but(offset_m=(0.0, 0.15, 0.0), sensor_m=(0.0, 0.15, 0.0)))
    goal = certify_plane(at(link, 0.0, 0.15, 0.0), "z", 0.0, 6.8).guaranteed, certify_plane(rig, "z", 0.0, 6.8)
    assert goal[0] is not None
    assert goal[0].load_bandwidth_Hz == 0.0
    assert goal[1].guaranteed is not None
    assert goal[1].guaranteed.load_bandwidth_Hz > 3.0
    outcome = check(goal[1].text, prototype_table(rig))
    assert outcome.valid, outcome.failed
    elsewhere = goal[1].text.replace('sensor_m = [\n    "0",\n    "0.15"', 'sensor_m = [\n    "0",\n    "0"')
    assert elsewhere != goal[1].text
    assert not check(sealed_text(elsewhere)).valid
    with pytest.raises(InputError, match="sensor_m"):
        prove_anywhere(rig, (0.0, 6.8), (0.0, 0.01, 0.0))


def test_a_force_in_time_moves_the_payload_as_the_proved_polynomials_say(link: Prototype):
    """A force at 12 Hz from rest, integrated until the transient has died: amplitude and phase of what is left."""
    rig, payload, frequency = at(link, 0.0, 0.15, 0.0), 5.0, 12.0
    by_hand = assemble(rig, payload, (0.0, 0.15, 0.0), END_INERTIA)
    w = 2 * pi * frequency

    def rate(time: float, state: np.ndarray) -> np.ndarray:
        return by_hand.a @ state + by_hand.b[:, 2] * 100.0 * np.sin(w * time)

    settled = 12 / frequency
    times = np.linspace(settled, settled + 1 / frequency, 65)[:-1]
    run = solve_ivp(
        rate, (0.0, float(times[-1])), np.zeros(len(by_hand.a)), "Radau", times, rtol=1e-6, atol=1e-12, jac=by_hand.a
    )
    moved = by_hand.motion[2] @ run.y
    found = 2j * np.mean(moved * np.exp(-1j * w * times)) / 100.0
    expected = at_load(plane_loop(rig, "z"), payload).compliance_response(np.array([frequency]))[0]
    assert found == pytest.approx(expected, rel=2e-3)


def test_payloads_at_which_roots_cross_are_where_poles_by_hand_cross(link: Prototype):
    """A payload 0.5 m to the side is stable up to some mass; poles by hand change sides there."""
    offset = (0.0, 0.5, 0.0)
    rig = at(link, *offset)
    found = certify_plane(rig, "z", 0.0, 6.8)
    assert not found.stable
    (crossing,) = found.crossings
    for factor, stable in ((1 - 1e-5, True), (1 + 1e-5, False)):
        poles = np.linalg.eigvals(assemble(rig, factor * crossing.value, offset, END_INERTIA).a)
        assert (poles.real.max() < 0) == stable
    assert check(found.text, prototype_table(rig)).valid


def test_guarantees_hold_and_are_tight_on_a_grid(link: Prototype):
    rig = at(link, 0.0, 0.05, 0.0)
    found = certify_plane(rig, "z", 0.0, 6.8).guaranteed
    assert found is not None
    plane, frequency = plane_loop(rig, "z"), np.geomspace(0.1, 500.0, 4000)
    members = [at_tip(plane, mass) for mass in np.linspace(0.0, 6.8, 18)]
    loads = [at_load(plane, mass) for mass in np.linspace(0.0, 6.8, 18)]
    peak = max(np.abs(member.sensitivity_response(frequency)).max() for member in members)
    assert peak <= found.peak_sensitivity <= 1.002 * peak
    for looked_at, bandwidth in ((members, found.tip_bandwidth_Hz), (loads, found.load_bandwidth_Hz)):
        below, above = bandwidth * np.linspace(0.02, 1.0, 60), np.array([1.002 * bandwidth])
        goal = rig.goal.compliance_m_per_N
        assert all(np.abs(member.compliance_response(below)).max() <= goal for member in looked_at)
        assert any(np.abs(member.compliance_response(above)).max() > goal for member in looked_at)


def test_both_planes_without_a_second_offset_are_the_product_of_the_single_ones(link: Prototype):
    rig, mass = at(link, *OFFSET), fmpq(5, 2)
    both = both_planes(rig).at(2.5)
    y, z = (plane_loop(rig, name).characteristic.at(mass) for name in ("y", "z"))
    assert both == y * z
    with pytest.raises(ValueError, match="both planes"):
        plane_loop(at(link, 0.0, 0.1, 0.1), "z")


def test_a_payload_off_to_both_sides_is_proved_in_ball_arithmetic(link: Prototype):
    rig = at(link, 0.0, 0.1, -0.1)
    verdict = both_planes(rig).prove(0.0, 6.8)
    assert verdict.stable
    assert check(verdict.certificate).valid
    near = arm(at(link, 0.0, 0.03, -0.03), (5.0, 6.8), (0.0, 0.0, -100.0))
    assert near.stable
    assert near.sampled_load_Hz is not None
    response = np.abs(both_planes(at(link, 0.0, 0.03, -0.03)).response(6.8, np.array([0.99 * near.sampled_load_Hz[1]])))
    assert 0.9 * link.goal.compliance_m_per_N < response[0, 2, 2] <= link.goal.compliance_m_per_N
    far = arm(at(link, 0.0, 0.5, 0.5), (0.0, 6.8), (0.0, 0.0, -100.0))
    assert far.stable is False
    assert far.with_servo is None
    assert not all(stable for _, stable in far.sampled_stable)


@pytest.mark.parametrize(
    ("offset", "within"), [((0.02, 0.05, 0.0), (0.03, 0.05, 0.0)), ((0.0, 0.05, 0.0), (0.0, 0.0, 0.03))]
)
def test_a_payload_anywhere_within_bounds_is_proved_at_once(
    link: Prototype, offset: tuple[float, float, float], within: tuple[float, float, float]
):
    rig = at(link, *offset)
    found = prove_anywhere(rig, (0.0, 6.8), within)
    assert list(found) == (["both"] if within[2] else ["y", "z"])
    for verdict in found.values():
        assert verdict.stable, verdict.reason
        assert check(verdict.certificate).valid
    random = np.random.default_rng(5)
    for _ in range(30):
        place = tuple(float(a) for a in np.array(offset) + random.uniform(-1, 1, 3) * within)
        poles = np.linalg.eigvals(assemble(at(link, *place), random.uniform(0, 6.8), place, END_INERTIA).a)
        assert poles.real.max() < 0


def test_the_family_over_places_is_the_polynomial_of_the_place(link: Prototype):
    """The polynomial that a certificate states, put in numbers, against that of one place, exactly."""

    from beamdesign.proofs.box_member import member
    from beamdesign.proofs.statement import PolynomialFamily

    rig = at(link, 0.05, -0.1, 0.15)
    family = prove_anywhere(rig, (2.5, 2.5), (0.0, 0.0, 0.0))["both"]
    table = tomllib.loads(family.certificate)
    assert "along_m 0.05, sideways_squared_m2 0.01, upwards_squared_m2 0.0225" in table["name"]
    assert member(PolynomialFamily("", table["p"], {}).over({}), {}).plain == both_planes(rig).at(2.5)


def test_a_place_that_is_not_stable_is_found(link: Prototype):
    found = prove_anywhere(link, (0.0, 6.8), (0.0, 0.6, 0.0))
    assert found["z"].stable is False
    point = found["z"].unstable_point
    assert point is not None
    place = (0.0, float(point["sideways_squared_m2"]) ** 0.5, 0.0)
    payload = float(point["outer_end_mass"])
    assert np.linalg.eigvals(assemble(at(link, *place), payload, place, END_INERTIA).a).real.max() > 0
    with pytest.raises(ValueError, match="must not be negative"):
        prove_anywhere(link, (0.0, 6.8), (-0.1, 0.0, 0.0))


def test_the_inner_tip_gives_way_until_the_tubes_touch(link: Prototype):
    figures, place = arm_figures(link), (0.0, 0.0, 0.0)
    case = remaining(figures, (300.0, -800.0, -2000.0), place, place, (0.0, 0.0))
    inner = link.inner_beam.but(width_m=0.100)
    travel = inner_travel(link.but(inner_beam=inner), case)
    # Weight of the outer beam on the tip, and the inner beam's own: w L^4 / 8EI of a tube, Roark's table 8.1, case 2a.
    own = 2000.0 + 9.80665 * (weighing_mass(link.outer_beam) + weighing_mass(inner) + link.payload.inner_end_mass_kg)
    assert travel.travel_m == pytest.approx((-800.0 / 157_500.0, -own / 157_500.0))
    assert travel.gap_m == pytest.approx(0.0177)
    assert not travel.touches
    assert inner_travel(link.but(inner_beam=inner.but(width_m=0.115)), case).touches


@pytest.mark.parametrize("key", ["controller", "arm.second_controller"])
def test_several_laws_are_refused_by_the_key_at_which_they_stand(link: Prototype, key: str):
    several = read_prototype(Path(__file__).parent.parent / "studies" / "scheduled" / "prototype.toml").controller
    there = {"controller": several} if key == "controller" else {"arm": link.arm.but(second_controller=several)}
    with pytest.raises(InputError) as told:
        arm(link.but(**there), (0.0, 1.0))
    assert [problem.key for problem in told.value.problems] == [f"{key}.kind"]


def test_the_second_controller_acts_sideways_only(link: Prototype):
    assert link.arm is not None
    second = Lag(gain_A_per_V=0.02, pole_Hz=1.7, zero_Hz=20.0)
    rig = link.but(arm=link.arm.but(second_controller=second, offset_m=OFFSET))
    assert plane_loop(rig, "z") == plane_loop(at(link, *OFFSET), "z")
    alone = link.but(controller=second)
    assert plane_loop(rig, "y").loop_denominator == plane_loop(at(alone, *OFFSET), "y").loop_denominator
    held_still = arm(rig, (0.0, 6.8), (0.0, -50.0, 0.0)).compliances["tip", True]
    assert held_still is not None
    expected = loop(alone).at(0.0).static_compliance(), loop(link).at(0.0).static_compliance()
    assert np.diag(held_still)[1:3] == pytest.approx(expected)


# Certificates.


FALSE = (
    ('offset_m = [\n    "0.05",\n    "0.05"', 'offset_m = [\n    "0.05",\n    "0.6"', "not proved"),
    ('kind = "peak_sensitivity", limit = "1.', 'kind = "peak_sensitivity", limit = "0.', "not proved: peak"),
    ('bandwidth_Hz = "', 'bandwidth_Hz = "1', "not proved: tip compliance"),
    ("holds = true", "holds = false", "holds after all"),
    ('stiffness_N_m_per_rad = "1', 'stiffness_N_m_per_rad = "2', "not so: torsional stiffness"),
    ('damping_N_m_s_per_rad = "', 'damping_N_m_s_per_rad = "1', "not so: torsional damping"),
    ('polar_inertia_kg_m2 = "0.01"', 'polar_inertia_kg_m2 = "0.02"', "not so: polar inertia"),
    ('corner_radius_m = "0"', 'corner_radius_m = "0.004"', "not so: torsional stiffness"),
    ('density_kg_per_m3 = "2700"', 'density_kg_per_m3 = "2800"', "not so: polar inertia"),
)


def test_certificates_are_proved_again_and_false_ones_refused(link: Prototype):
    rig = at(link, 0.05, 0.05, 0.0).but(goal=link.goal.but(loop_gain=0.25, controller_effort_A_per_V=0.06))
    for name in ("y", "z"):
        text = certify_plane(rig, name, 0.0, 6.8).text
        outcome = check(text, prototype_table(rig))
        assert outcome.valid, outcome.failed
        assert sum("compliance" in words for words in outcome.proved) == 2
        assert any("loop gain" in words for words in outcome.proved)
        assert any("controller effort" in words for words in outcome.proved)
    for old, new, words in FALSE:
        assert old in text
        outcome = check(sealed_text(text.replace(old, new, 1)))
        assert any(words in reason for reason in outcome.failed), (old, outcome.failed)
    for old, new in (("free_length_m", "length_m"), ('name = "z"', 'name = "y"'), ("tip_comp", "comp")):
        with pytest.raises(Unreadable):  # torsion has no part in the other plane
            check(sealed_text(text.replace(old, new)))


@pytest.mark.parametrize("sensor", [None, (0.05, 0.1, 0.0)])
def test_the_model_of_the_truth_is_the_arm(link: Prototype, sensor: tuple[float, float, float] | None):
    """Poles and responses of a plane with load pressure fed back, against the matrices put together by hand."""
    assert link.arm is not None
    lag = link.but(arm=link.arm.but(offset_m=OFFSET, sensor_m=sensor))
    rig, payload, frequency = with_pressure(lag, 1e-10), 2.9, np.array([0.5, 8.0, 40.0, 150.0])
    model = Plane(tomllib.loads(certify_plane(rig, "z", 0.0, 6.8).text))
    by_hand = assemble(lag, payload, OFFSET, END_INERTIA, 1e-10)
    expected, found = np.linalg.eigvals(by_hand.a), model.poles(payload)
    assert max(np.abs(expected / pole - 1).min() for pole in found) < 1e-6
    w = 2 * pi * frequency
    load = at_load(plane_loop(rig, "z"), payload).compliance_response(frequency)
    np.testing.assert_allclose(model.magnitudes("load_compliance", payload, w), np.abs(load), rtol=1e-9)
    for kind, response in (
        ("tip_compliance", at_tip(plane_loop(rig, "z"), payload).compliance_response(frequency)),
        ("peak_sensitivity", at_tip(plane_loop(rig, "z"), payload).sensitivity_response(frequency)),
        ("controller_effort", effort_response(at_tip(plane_loop(rig, "z"), payload), frequency)),
    ):
        np.testing.assert_allclose(model.magnitudes(kind, payload, w), np.abs(response), rtol=1e-9)
    cut = [np.linalg.solve(1j * x * np.eye(len(by_hand.a)) - by_hand.opened, by_hand.valve) for x in w]
    loop_gain = [abs(by_hand.current @ one) for one in cut]
    np.testing.assert_allclose(model.magnitudes("loop_gain", payload, w), loop_gain, rtol=1e-6)


MUTATIONS = (
    (("arm", "offset_m", 0), "0.9"),
    (("arm", "offset_m", 1), "0.6"),
    (("arm", "sensor_m"), ["0", "-0.5", "0"]),
    (("arm", "end_polar_inertia_kg_m2"), "0.1"),
    (("arm", "torsional_stiffness_N_m_per_rad"), "100000"),
    (("arm", "torsional_damping_ratio"), "0.01"),
    (("material", "6061-T6", "shear_modulus_Pa"), "26999999000"),
    (("plane", "free_length_m"), "1.2"),
    (("plane", "section", "corner_radius_m"), "0.001"),
    (("plane", "torsion", "damping_N_m_s_per_rad"), "4"),
    (("rig", "sensor_gain_V_per_m"), "2400"),
    (("rig", "outer_damping_N_s_per_m"), "137"),
    (("rig", "valve_frequency_rad_per_s"), "900"),
    (("controller", "law", "numerators", 0, 0), "0.04"),
    (("outer_end_mass_kg",), ["0", "20"]),
    (("stability", "stable"), False),
    (("stability", "stays_stable_to_kg"), "infinite"),
    (("claim", 0, "limit"), "0.00000005"),
    (("claim", 0, "bandwidth_Hz"), "3.6"),
    (("claim", 1, "limit"), "1.7"),
    (("claim", 1), {"kind": "peak_sensitivity", "limit": "3", "holds": False}),
)


def changed(table: dict[str, Any], place: tuple[Any, ...], value: Any) -> dict[str, Any]:
    """A certificate's table with another value, under its own checksum."""
    inner = table = deepcopy(table)
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    return tomllib.loads(sealed_text(tomli_w.dumps(table)))


def test_truth_of_arm_plane(link: Prototype):
    """What is honest is not false, and true with room to spare; what is false in floats is never valid."""
    honest = tomllib.loads(certify_plane(at(link, 0.05, 0.1, 0.0), "z", 0.0, 6.8).text)
    assert true(honest) is not False
    roomy = deepcopy(honest)
    roomy["claim"] = [claim | {"limit": str(Fraction(claim["limit"]) * 11 / 10)} for claim in honest["claim"]]
    assert true(roomy) is True
    assert check(sealed_text(tomli_w.dumps(roomy))).valid
    for place, value in MUTATIONS:
        forged = changed(honest, place, value)
        assert true(forged) is False, place
        with suppress(Unreadable):
            assert not check(tomli_w.dumps(forged)).valid, place
    unstable = tomllib.loads(certify_plane(at(link, 0.0, 0.5, 0.0), "z", 0.0, 6.8).text)
    assert true(unstable) is not False
    for place, value in (
        (("stability", "range", 0, "stable"), False),
        (("stability", "range", 1, "sample"), "0"),
        (("stability", "crossing", 0, "frequency_Hz"), ["1", "2"]),
        (("stability", "crossing"), []),
    ):
        assert true(changed(unstable, place, value)) is False


def test_a_certificate_is_of_the_arm_that_it_was_made_for_and_of_no_other(link: Prototype):
    """The payload elsewhere, another sensor, section, length or law in one plane: proved as before, of another arm."""
    second = Lag(gain_A_per_V=0.03, pole_Hz=1.0, zero_Hz=20.0)
    rig = at(link, 0.05, 0.05, 0.0)
    assert rig.arm is not None
    rig = rig.but(arm=rig.arm.but(second_controller=second))
    beam = rig.outer_beam
    others = [
        rig.but(arm=rig.arm.but(offset_m=(0.05, 0.95, 0.0))),
        rig.but(arm=rig.arm.but(sensor_m=(0.0, 0.01, 0.0))),
        rig.but(outer_beam=beam.but(free_length_m=1.19)),
        rig.but(arm=None),
    ]
    sections = {"wall_m": 0.0024}, {"material": "6063-T6"}, {"width_m": None, "wall_m": None, "material": None}
    with_torsion = [rig.but(outer_beam=beam.but(**section)) for section in sections]
    for name, unlike in (("y", others), ("z", others + with_torsion)):
        text = certify_plane(rig, name, 0.0, 6.8).text
        assert check(text, prototype_table(rig)).valid
        for other in unlike:
            assert any("not of this prototype" in words for words in check(text, prototype_table(other)).failed)
    upwards = rig.but(controller=Lag(gain_A_per_V=0.04, pole_Hz=1.7, zero_Hz=20.0))
    sideways = rig.but(arm=rig.arm.but(second_controller=second.but(gain_A_per_V=0.02)))
    for name, other in (("y", sideways), ("z", upwards)):
        assert not check(certify_plane(rig, name, 0.0, 6.8).text, prototype_table(other)).valid
    given = rig.but(arm=rig.arm.but(torsional_stiffness_N_m_per_rad=1.2e5, torsional_damping_ratio=0.02))
    bare = given.but(outer_beam=beam.but(width_m=None, wall_m=None, material=None))
    for other in (given, bare):
        assert check(certify_plane(other, "z", 0.0, 6.8).text, prototype_table(other)).valid
    assert not check(certify_plane(given, "z", 0.0, 6.8).text, prototype_table(bare)).valid


@pytest.mark.parametrize("beam", ["outer_beam", "inner_beam"])
def test_across_a_rectangular_tube_a_plane_is_that_of_no_prototype(link: Prototype, beam: str):
    """Measured figures, which win over the section, are those of the plane z."""
    table = prototype_table(link)
    text = certify_plane(link, "y", 0.0, 6.8).text
    assert check(text, table).valid
    table[beam] = {**table[beam], "shape": "rectangle", "depth_m": 0.2}
    assert "rectangular tube" in " ".join(check(text, table).failed)


def test_a_section_that_is_no_table_cannot_be_read(link: Prototype):
    honest = tomllib.loads(certify_plane(link, "y", 0.0, 6.8).text)
    with pytest.raises(Unreadable, match=r"plane\.section"):
        check(tomli_w.dumps(changed(honest, ("plane", "section"), "x")), prototype_table(link))


def test_a_lag_written_as_an_observer_is_the_lag(link: Prototype):
    rate, share = 2 * pi * 1.7, 1.7 / 20.0
    same = Observer.of(0.05, ("displacement_m",), [[-rate]], [[rate]], [1 - share], [share])
    rig = at(link, *OFFSET)
    own, other = (certify_plane(arm, "z", 0.0, 6.8) for arm in (rig, rig.but(controller=same)))
    assert own.guaranteed is not None
    assert other.guaranteed is not None
    assert other.guaranteed.tip_bandwidth_Hz == pytest.approx(own.guaranteed.tip_bandwidth_Hz, rel=1e-6)
    assert other.guaranteed.peak_sensitivity == pytest.approx(own.guaranteed.peak_sensitivity, rel=2e-4)
    outcome = check(other.text, prototype_table(rig.but(controller=same)))
    assert outcome.valid, outcome.failed


# Input and command line.


def test_missing_figures_are_all_named_at_once(paper: Prototype):
    rig = paper.but(controller=Lag(gain_A_per_V=0.05, pole_Hz=1.7, zero_Hz=20.0))
    with pytest.raises(InputError) as caught:
        arm_figures(rig)
    keys = [problem.key for problem in caught.value.problems]
    assert keys == ["outer_beam.free_length_m", "arm.torsional_stiffness_N_m_per_rad", "arm.end_polar_inertia_kg_m2"]
    given = Arm(torsional_stiffness_N_m_per_rad=1e5, end_polar_inertia_kg_m2=0.02)
    figures = arm_figures(rig.but(arm=given, outer_beam=rig.outer_beam.but(free_length_m=1.2)))
    assert (figures.torsional_stiffness, figures.polar_inertia, figures.axial_stiffness) == (1e5, 0.02, None)
    with pytest.raises(InputError, match=r"effects\.sensor_lag"):
        both_planes(rig.but(arm=given, outer_beam=rig.outer_beam.but(free_length_m=1.2), effects={"sensor_lag": {}}))


def run(*arguments: str | Path):
    return CliRunner().invoke(app, ["arm", *map(str, arguments)])


def test_the_command_proves_writes_and_says_no(link: Prototype, tmp_path: Path):
    path, answer = tmp_path / "link.toml", tmp_path / "answer.json"
    write_prototype(link, path)
    done = run(
        path, "--offset-m", "0,0.1,0", "--force-N", "500", "--allowed-mm", "0.02", "--out", tmp_path, "--json", answer
    )
    assert done.exit_code == 0, done.output
    assert "stable for every outer end mass from 0 to 6.8 kg" in done.output
    fields = json.loads(answer.read_text())
    assert fields["with_servo"]["shares_m"]["twist"] == pytest.approx(
        500 * 0.1**2 / arm_figures(link).torsional_stiffness
    )
    assert fields["with_servo"]["size_m"] < 0.1 * fields["without_servo"]["size_m"]
    assert [plane["coupled_with_torsion"] for plane in fields["planes"]] == [False, True]
    for name in ("certificate_y.toml", "certificate_z.toml"):
        assert check(tmp_path / name, tmp_path / "prototype.toml").valid
        assert not check(tmp_path / name, path).valid  # its payload stands elsewhere
    for name in ("compliance.csv", "remaining.csv", "response.csv", "arm.svg", "arm.png", "prototype.toml"):
        assert (tmp_path / name).stat().st_size > 0
    again = run(tmp_path / "prototype.toml", "--force-N", "500", "--json", tmp_path / "again.json")
    assert again.exit_code == 0
    assert json.loads((tmp_path / "again.json").read_text())["planes"] == fields["planes"]
    refused = run(path, "--offset-m", "0,0.5,0", "--force-N", "500")
    assert refused.exit_code == 1
    assert "plane z, with torsion: NOT stable" in refused.output
    both = run(path, "--offset-m=0,-0.1,0.1")
    assert both.exit_code == 0
    assert "bandwidth and peaks are not proved" in both.output
    assert "stable from 0 to 6.8 kg, for exactly these figures" in both.output
    there = run(path, "--offset-m", "0,0.1,0", "--sensor-m", "0,0.1,0", "--force-N", "500", "--json", answer)
    assert there.exit_code == 0
    assert json.loads(answer.read_text())["with_servo"]["size_m"] < 0.2 * fields["with_servo"]["size_m"]
    anywhere = run(path, "--offset-m", "0,0.1,0", "--within-m", "0,0.5,0")
    assert anywhere.exit_code == 1
    asked = "plane z, for every payload and every place of its centre asked for, of exactly these figures"
    assert f"{asked}: NOT stable" in anywhere.output
    elsewhere = run(path, "--sensor-m", "0,0.1,0", "--within-m", "0,0.5,0")
    assert "servos that measure at the tip" in str(elsewhere.exception)
    assert not elsewhere.output  # it was refused behind half of its tables


@pytest.mark.usefixtures("few_climbs")
@pytest.mark.parametrize("command", [("certify",), ("certify-box",), ("certify-switching", "--rate", "1")])
def test_proofs_of_one_loop_say_what_they_leave_aside_of_an_arm(
    link: Prototype, tmp_path: Path, command: tuple[str, ...]
):
    """At 0.5 m to the side the plane z is not stable with torsion, as the command above finds."""
    path = tmp_path / "link.toml"
    for offset, told in ((0.5, True), (0.0, False)):
        write_prototype(at(link, 0.0, offset, 0.0), path)
        written = tmp_path / "certificate.toml"
        asked = [*command, str(path), "--outer-end-mass", "2:2.5", "--out", str(written)]
        done = CliRunner().invoke(app, [*asked, "--json", str(tmp_path / "answer.json")])
        assert done.exit_code == 0, done.output
        aside = json.loads((tmp_path / "answer.json").read_text())["arm_left_aside"]
        for said in (done.output, aside):
            assert ("payload and sensor on the beam's axis at the tip" in said) is told


def test_the_checker_says_what_a_certificate_of_one_loop_leaves_aside_of_an_arm(link: Prototype):
    """At 0.9 m to the side, and with a law of ten times the gain across, the arm of matrices by hand is not stable."""
    strong = Lag(gain_A_per_V=0.5, pole_Hz=1.7, zero_Hz=20.0)
    assert link.arm is not None
    across = link.but(arm=link.arm.but(second_controller=strong))
    for rig, by_hand, offset, told in (
        (link, link, (0.0, 0.0, 0.0), []),
        (at(link, 0.0, 0.9, 0.0), link, (0.0, 0.9, 0.0), ["[arm] offset_m"]),
        (across, link.but(controller=strong), (0.0, 0.0, 0.0), ["[arm.second_controller]"]),
    ):
        worst = np.linalg.eigvals(assemble(by_hand, 6.0, offset, END_INERTIA).a).real.max()
        assert (worst > 1.0) == bool(told)
        verdict = check(certify(rig, 5.5, 6.0).text, prototype_table(rig, 6.0))
        assert verdict.valid, verdict.failed
        assert "stable from 5.5 to 6 kg" in verdict.proved
        assert [line.partition(":")[0] for line in verdict.open if line.startswith("[arm")] == told
        assert not any("[arm" in line for line in check(certify_plane(rig, "z", 5.5, 6.0).text).open)


def test_motions_and_contacts_of_one_loop_say_what_they_leave_aside_of_an_arm(link: Prototype, tmp_path: Path):
    """Its offsets and the law across; simulated in one of its planes nothing is left aside."""
    path, scenario = tmp_path / "link.toml", tmp_path / "scenario.toml"
    scenario.write_text('name = "rest"\nduration_s = 0.01\n[[record]]\nname = "rest"\nouter_end_mass_kg = 2.0\n')
    across = link.arm.but(offset_m=(0.0, 0.1, 0.0), second_controller=Lag(gain_A_per_V=0.04, pole_Hz=1.7, zero_Hz=20.0))
    moved = ["simulate", str(path), "--scenario", str(scenario), "--out", str(tmp_path / "out"), "--no-plots"]
    for command, plane, told in ((moved, None, True), (moved, "y", False), (["stiffness", str(path)], "y", True)):
        write_prototype(link.but(arm=across.but(plane=plane)), path)
        done = CliRunner().invoke(app, command)
        assert done.exit_code == 0, done.output
        for words in ("payload and sensor on the beam's axis at the tip", "and not that of [arm.second_controller]"):
            assert (words in done.output) is told


def test_a_sweep_tells_what_the_command_tells(link: Prototype):
    from beamdesign.sweep.answers import arm as compute
    from beamdesign.sweep.case import ArmOptions

    rig = at(link, 0.0, 0.1, 0.0)
    answer = compute(rig, ArmOptions(force_N=500.0))
    expected = arm(rig, (0.0, 6.8), (0.0, 0.0, -500.0))
    assert expected.with_servo is not None
    sure = [plane.guaranteed for plane in expected.planes]
    assert answer.outputs["error_m"] == expected.with_servo.size_m
    assert answer.outputs["error_by_twist_m"] == pytest.approx(500 * 0.1**2 / expected.figures.torsional_stiffness)
    assert answer.outputs["peak_sensitivity"] == max(plane.peak_sensitivity for plane in sure if plane is not None)
    assert answer.outputs["load_bandwidth_Hz"] == 0.0
    refused = compute(at(link, 0.0, 0.5, 0.0), ArmOptions())
    assert refused.outputs["stable"] is False
    assert "plane z" in refused.reason
    assert "error_m" not in refused.outputs
    assert refused.outputs["force_N"] == pytest.approx(6.8 * 9.80665)


def test_the_shipped_study_draws_what_it_prints(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    import runpy
    import sys

    root = Path(__file__).parent.parent
    rig = root / "studies" / "prototypes" / "arm.toml"
    monkeypatch.setattr(sys, "argv", ["arm_offset.py", str(tmp_path / "arm.svg"), str(rig), "--points", "2"])
    runpy.run_path(str(root / "studies" / "arm_offset.py"), run_name="__main__")
    said = capsys.readouterr().out
    shipped = read_prototype(rig)
    assert shipped.arm is not None
    far = shipped.but(arm=shipped.arm.but(offset_m=(0.05, 0.3, 0.0)))
    peak = max(certify_plane(far, name, 0.0, 6.8).guaranteed.peak_sensitivity for name in ("y", "z"))
    assert f"0.300 m: {peak:.5g}" in said
    assert "<svg" in (tmp_path / "arm.svg").read_text()


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--offset-m", "0.1,0.1", "expected three figures"),
        ("--offset-m", "0.1,nan,0", "outside the plausible range"),
        ("--force-N", "-5", "outside the plausible range"),
        ("--force-N", "much", "expected a force in N"),
        ("--allowed-mm", "0", "outside the plausible range"),
        ("--within-m", "0,-0.1,0", "outside the plausible range"),
    ],
)
def test_bad_options_are_refused(link: Prototype, tmp_path: Path, option: str, value: str, words: str):
    write_prototype(link, tmp_path / "link.toml")
    done = run(tmp_path / "link.toml", f"{option}={value}")
    assert isinstance(done.exception, InputError)
    assert words in str(done.exception)
