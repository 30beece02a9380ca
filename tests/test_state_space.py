"""Handed-out state spaces against the exact polynomials and against python-control's own interconnection."""

import control
import numpy as np
import pytest

from beamdesign import Prototype, state_space
from beamdesign.controllers import Proportional
from beamdesign.loop import loop
from beamdesign.prototype import Payload

FREQUENCIES_HZ = np.array([0.01, 0.3, 1.75, 10.0, 26.0, 50.0, 54.5, 131.8, 545.0, 2000.0])
S = 2j * np.pi * FREQUENCIES_HZ


@pytest.fixture(params=["lag", "proportional", "lag and filter"])
def rig(request: pytest.FixtureRequest, paper: Prototype, remedy: Prototype) -> Prototype:
    if request.param == "proportional":
        return paper.but(controller=Proportional(gain_A_per_V=0.02), payload=Payload(inner_end_mass_kg=1.0))
    return remedy if request.param == "lag" else remedy.but(sensor=remedy.sensor.but(filter_Hz=400.0))


@pytest.mark.parametrize("mass", [0.0, 6.8])
def test_responses_are_those_of_the_exact_polynomials(rig: Prototype, mass: float):
    exact, closed, opened = loop(rig).at(mass), state_space(rig, mass), state_space(rig, mass, "open")
    found = closed["displacement_m", "disturbance_N"](S)
    np.testing.assert_allclose(found, exact.compliance_response(FREQUENCIES_HZ), rtol=1e-11)
    found = opened["sensor_V", "command_V"](S)
    np.testing.assert_allclose(found, exact.loop_response(FREQUENCIES_HZ), rtol=1e-11)
    np.testing.assert_allclose(np.sort_complex(closed.poles()), np.sort_complex(exact.poles()), rtol=1e-9)


@pytest.mark.parametrize("mass", [0.0, 6.8])
def test_closed_loop_is_the_interconnection_of_plant_and_controller(rig: Prototype, mass: float):
    assert rig.controller is not None
    error = control.summing_junction(["command_V", "-sensor_V"], "error_V", name="error")
    joined = control.interconnect(
        [error, rig.controller.control_model(), state_space(rig, mass, "plant")],
        inputs=["disturbance_N", "command_V"],
        outputs=["displacement_m", "sensor_V", "current_A"],
    )
    np.testing.assert_allclose(state_space(rig, mass)(S), joined(S), rtol=1e-10)


def test_closing_the_open_loop_gives_the_closed_one(rig: Prototype):
    opened, closed = state_space(rig, 3.0, "open"), state_space(rig, 3.0)
    loop_gain = opened["sensor_V", "command_V"](S)
    np.testing.assert_allclose(closed["sensor_V", "command_V"](S), loop_gain / (1 + loop_gain), rtol=1e-9)
    compliance = opened["displacement_m", "disturbance_N"](S)
    fed_back = opened["sensor_V", "disturbance_N"](S) * opened["displacement_m", "command_V"](S)
    expected = compliance - fed_back / (1 + loop_gain)
    np.testing.assert_allclose(closed["displacement_m", "disturbance_N"](S), expected, rtol=1e-7)


def test_current_is_the_controller_of_the_error(rig: Prototype):
    assert rig.controller is not None
    closed = state_space(rig, 1.0)
    law = rig.controller.control_model()(S)
    error = 1 - closed["sensor_V", "command_V"](S)
    np.testing.assert_allclose(closed["current_A", "command_V"](S), law * error, rtol=1e-9)


def test_static_compliance_and_step_end_at_the_same_displacement(remedy: Prototype):
    closed = state_space(remedy, 6.8)["displacement_m", "disturbance_N"]
    assert np.real(closed.dcgain()) == pytest.approx(loop(remedy).at(6.8).static_compliance(), rel=1e-9)
    _, displacement = control.step_response(100.0 * closed, np.linspace(0, 2.0, 4001))
    assert displacement[-1] == pytest.approx(100.0 * loop(remedy).at(6.8).static_compliance(), rel=0.02)


def test_signals_have_names(remedy: Prototype):
    filtered = remedy.but(sensor=remedy.sensor.but(filter_Hz=400.0))
    closed, plant = state_space(filtered), state_space(remedy, loop="plant")
    assert closed.state_labels[-2:] == ["filtered_V", "controller_1"]
    assert closed.input_labels == ["disturbance_N", "command_V"]
    assert closed.output_labels == ["displacement_m", "sensor_V", "current_A"]
    assert plant.input_labels == ["disturbance_N", "current_A"]
    assert plant.state_labels[0] == "displacement_m"


def test_what_cannot_be_had_is_refused(paper: Prototype):
    assert state_space(paper, loop="plant").nstates == 7
    with pytest.raises(ValueError, match="no \\[controller\\]"):
        state_space(paper)
    with pytest.raises(ValueError, match="expected 'closed' or 'open' or 'plant'"):
        state_space(paper, loop="shut")  # type: ignore[arg-type]
