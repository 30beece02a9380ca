"""What is told of a rig an eighth as long is the same in proportion: E. Buckingham, Physical Review 4, 1914."""

from pathlib import Path

import numpy as np
import pytest
from similar import EIGHTH, factor, similar

from beamdesign import Prototype, certify_box, read_prototype
from beamdesign.build.acceptance import acceptance
from beamdesign.diagnosis.fitting.hypothesis import Hypothesis
from beamdesign.loop import loop
from beamdesign.prototype import Goal
from beamdesign.report.figures import frequency_grid, shown_Hz
from beamdesign.synthesis.operating_limits import envelope
from beamdesign.synthesis.tuning import limited

MASS, _, TIME = EIGHTH


@pytest.fixture(scope="module")
def rig() -> Prototype:
    """That of the paper with a tenth of its gain, which is stable under some payload."""
    rig = read_prototype(Path(__file__).parents[1] / "studies/prototypes/published_lag.toml")
    return rig.but(controller=rig.controller.but(gain_A_per_V=0.02))


@pytest.fixture(scope="module")
def small(rig: Prototype) -> Prototype:
    """An eighth as long, of the same materials: eight times as quick."""
    return similar(rig, EIGHTH)


def test_what_a_box_is_proved_to_keep(rig: Prototype, small: Prototype) -> None:
    """The worst rigs were sought up to 400 Hz alone: a compliance a third above the largest one was proved."""
    found, kept = (certify_box(*of).guaranteed for of in ((rig, (0.0, 0.5)), (small, (0.0, 0.5 * MASS))))
    for key in ("bandwidth_Hz", "peak_sensitivity", "peak_compliance_m_per_N", "servo_off_m_per_N"):
        assert kept[key] == pytest.approx(factor(key, EIGHTH) * found[key], rel=2e-3)


def test_compliances_to_measure_go_up_to_frequencies_so_many_times_as_high(rig: Prototype, small: Prototype) -> None:
    (usual,), (quick,) = acceptance(rig, (1.0,)), acceptance(small, (MASS,))
    assert [*quick.compliance_m_per_N] == [pytest.approx(f / TIME) for f in usual.compliance_m_per_N]
    nominal = [[band.nominal for band in one.compliance_m_per_N.values()] for one in (usual, quick)]
    np.testing.assert_allclose(nominal[1], factor("compliance_m_per_N", EIGHTH) * np.array(nominal[0]), rtol=1e-6)


def test_loads_that_an_actuator_bears_are_told_up_to_frequencies_so_many_times_as_high(
    rig: Prototype, small: Prototype
) -> None:
    usual, quick = envelope(rig), envelope(small)
    np.testing.assert_allclose(quick.frequency_Hz, usual.frequency_Hz / TIME, rtol=1e-9)


@pytest.mark.parametrize(("time", "decades"), [(1.0, 1.0), (TIME, 10.0), (16.0, 0.1)])
def test_curves_of_a_quick_or_a_slow_rig_are_drawn_where_its_modes_are(
    rig: Prototype, time: float, decades: float
) -> None:
    """From 0.1 Hz to 1 kHz were shown of every rig, whatever its bandwidth."""
    closed = loop(similar(rig, (1.0, 1.0, time))).at(0.0)
    assert shown_Hz([closed]) == pytest.approx((0.1 * decades, 1e3 * decades))
    grid = frequency_grid([closed], wider=10.0)
    assert grid[[0, -1]] == pytest.approx([0.01 * decades, 1e4 * decades])


def test_laws_are_learnt_at_frequencies_and_masses_in_proportion(rig: Prototype, small: Prototype) -> None:
    """A lag of the valve's coil at 6.7 kHz, of a rig an eighth as long, was learnt as one at 2 kHz, the highest."""
    for names in (("empirical_current_lag",), ("empirical_outer_force_appendage",), ("empirical_sensor_resonance",)):
        usual, quick = ({u.name: u for u in Hypothesis(names).placement(one).unknowns} for one in (rig, small))
        for name in (name for name in usual if name.startswith("empirical")):
            scale = factor(name.rpartition(".")[2], EIGHTH)
            of = [(one[name].nominal, one[name].low, one[name].high) for one in (usual, quick)]
            assert of[1] == pytest.approx([scale * value for value in of[0]])


def test_limits_of_laws_of_high_order_go_with_the_rig(paper: Prototype) -> None:
    """By similarity: those of a rig an eighth as long are those of the rig, and volts and amperes are but units."""
    usual = limited(paper.but(goal=Goal()), "lqg")
    small = limited(similar(paper, EIGHTH).but(goal=Goal()), "lqg")
    assert small.goal.loop_gain_from_Hz == 8 * usual.goal.loop_gain_from_Hz
    assert small.goal.controller_effort_A_per_V == usual.goal.controller_effort_A_per_V
    sensor, valve = paper.sensor, paper.servovalve
    for volts, amperes in ((4.0, 1.0), (1.0, 0.25)):
        other = paper.but(
            goal=Goal(),
            sensor=sensor.but(gain_V_per_m=volts * sensor.gain_V_per_m),
            servovalve=valve.but(flow_gain_m3_per_s_per_A=valve.flow_gain_m3_per_s_per_A / amperes),
        )
        effort = limited(other, "lqg").goal.controller_effort_A_per_V
        assert effort * volts / amperes == pytest.approx(usual.goal.controller_effort_A_per_V, rel=1e-12)
    quick = limited(similar(paper, EIGHTH).but(goal=Goal()), "lag", {"loop_gain": 0.5})
    assert (quick.goal.loop_gain, quick.goal.loop_gain_from_Hz) == (0.5, small.goal.loop_gain_from_Hz)
    kept = limited(paper.but(goal=Goal(loop_gain_from_Hz=90.0)), "lqg")
    assert kept.goal.loop_gain_from_Hz == 90.0
