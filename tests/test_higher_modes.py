"""Beams with all their modes: against the closed form of the continuous beam, and in the loop against the exact one."""

from math import cos, cosh, pi, sin, sinh

import numpy as np
import pytest

from beamdesign import InputError, Prototype, critical_gain
from beamdesign.controllers import Section, Structured
from beamdesign.loop import loop
from beamdesign.plant.linear_reach import exact_compliance, signals, single_compliance, single_mode_reach, with_mass
from beamdesign.prototype import Beam
from beamdesign.structure.lumped import natural_frequencies
from beamdesign.validation.paper_rig import INNER_END_MASS_KG, OUTER, lag, proportional

PER_LENGTH = OUTER.tube.mass_per_length(OUTER.material.density_kg_per_m3)


def receptance(frequency: float, rigidity: float, per_length: float, length: float, end_mass: float) -> float:
    """Tip compliance of the clamped-free beam without damping.

    R. E. D. Bishop and D. C. Johnson, The Mechanics of Vibration (1960), table 7.1(c): the tip's direct receptance.
    """
    wave = ((2 * pi * frequency) ** 2 * per_length / rigidity) ** 0.25
    z = wave * length
    bare = (sin(z) * cosh(z) - cos(z) * sinh(z)) / (rigidity * wave**3 * (1 + cos(z) * cosh(z)))
    return 1 / (1 / bare - end_mass * (2 * pi * frequency) ** 2)


@pytest.fixture
def undamped() -> Beam:
    return OUTER.but(damping_ratio=0.0)


@pytest.mark.parametrize("added", [0.0, 6.8])
def test_modes_add_up_to_the_continuous_beam(undamped: Beam, added: float):
    rigidity = OUTER.stiffness_N_per_m * OUTER.free_length_m**3 / 3
    end_mass = OUTER.effective_mass_kg - 0.236 * PER_LENGTH * OUTER.free_length_m
    compliance = with_mass(exact_compliance(undamped, "outer_beam"), added)
    for frequency in (1e-3, 10.0, 100.0, 300.0, 700.0, 1500.0):
        figures = (rigidity, PER_LENGTH, OUTER.free_length_m, end_mass + added)
        expected = receptance(frequency, *figures)
        assert compliance(np.array([frequency]))[0] == pytest.approx(expected, rel=2e-3)


def test_a_mass_moves_the_resonances_to_those_of_the_loaded_beam(undamped: Beam):
    """Joined by dynamic stiffness here, in the boundary condition there."""
    rigidity = OUTER.stiffness_N_per_m * OUTER.free_length_m**3 / 3
    end_mass = OUTER.effective_mass_kg - 0.236 * PER_LENGTH * OUTER.free_length_m
    compliance = with_mass(exact_compliance(undamped, "outer_beam"), 5.0)
    for frequency in natural_frequencies(rigidity, PER_LENGTH, OUTER.free_length_m, end_mass + 5.0, 3):
        below, above = (1 / compliance(np.array([share * frequency]))[0].real for share in (0.999, 1.001))
        assert below * above < 0


@pytest.mark.parametrize(("rig", "mass"), [(proportional(20.0), 0.0), (lag(150.0, INNER_END_MASS_KG), 6.8)])
def test_with_one_mode_each_the_loop_is_the_linear_models(rig: Prototype, mass: float):
    frequencies = np.array([0.3, 5.0, 40.0, 150.0, 600.0])
    outer = with_mass(single_compliance(rig, "outer_beam"), mass)
    inner = with_mass(single_compliance(rig, "inner_beam"), rig.payload.inner_end_mass_kg)
    found = signals(rig, outer, inner, frequencies)
    exact, gain = loop(rig).at(mass), rig.controller.gain_A_per_V
    np.testing.assert_allclose(gain * found.loop_per_gain, exact.loop_response(frequencies), rtol=1e-9)
    closed = found.compliance / (1 + gain * found.loop_per_gain)
    np.testing.assert_allclose(closed, exact.compliance_response(frequencies), rtol=1e-9)


def test_the_papers_assumption_holds_on_its_rig():
    """Higher modes take less than a tenth of the gain and leave the compliance below 100 Hz alone."""
    found = single_mode_reach(lag(200.0))
    assert found.critical_gain_A_per_V == pytest.approx(critical_gain(lag(200.0)).gain_A_per_V)
    assert found.outer_modes_Hz[0] == pytest.approx(56.2, rel=0.02)
    assert found.outer_modes_Hz[1] > 300.0
    assert found.closed_loop_Hz > 100.0
    assert abs(found.gain_margin_eaten) < 0.1


def test_a_loop_that_is_stable_at_no_low_gain_is_judged_at_its_own():
    """By the exact loop of one mode each; a law between two resonances, which turns a tenth of its gain unstable."""
    section = Section(zero_Hz=13.5, zero_damping_ratio=0.18, pole_Hz=9.8, pole_damping_ratio=0.1)
    law = Structured(gain_A_per_V=0.068, pole_Hz=7.8, zero_Hz=38.0, section=(section,))
    rig = lag(1.0).but(controller=law)
    assert not loop(rig.but(controller=law.but(gain_A_per_V=0.0068))).at(0.0).stable
    found = single_mode_reach(rig)
    assert found.critical_gain_A_per_V == critical_gain(rig, from_own=True).gain_A_per_V > law.gain_A_per_V
    assert found.critical_gain_all_A_per_V == pytest.approx(found.critical_gain_A_per_V, rel=0.15)
    assert found.closed_loop_Hz > 50.0


def test_one_mode_reaches_less_far_the_lighter_the_tip():
    """A mass at the tip nearly pins it in the higher modes, so that they do not show there."""
    rig = lag(100.0)
    spread = rig.outer_beam.but(effective_mass_kg=0.236 * PER_LENGTH * OUTER.free_length_m * 1.01)
    near, far = (single_mode_reach(rig.but(outer_beam=beam)) for beam in (spread, rig.outer_beam))
    assert near.outer_Hz < far.outer_Hz


def test_geometry_is_needed(paper: Prototype):
    with pytest.raises(InputError, match="geometry"):
        single_mode_reach(paper.but(controller=lag(1.0).controller))
