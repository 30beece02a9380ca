"""What a data set cannot tell apart, against closed forms and by what its records can and cannot show."""

from dataclasses import replace

import numpy as np
import pytest
from gap_sets import believed, measured, scenario

from beamdesign.diagnosis.fitting.evidence import evidence_of
from beamdesign.diagnosis.fitting.hypothesis import together
from beamdesign.diagnosis.separability import _judged, indistinguishable
from beamdesign.time_limit import TimeUp, share, within


@pytest.fixture(scope="module")
def sound():
    return measured(believed(), scenario(0.5))


def of(data, *names):
    return indistinguishable(data, evidence_of(data), [together(name) for name in names])


def test_what_is_left_of_two_vectors_has_its_closed_form():
    """Tolerance e1 at the price of its prior leaves 1/(1 + 1) of its share; two signatures at an angle leave a sine."""
    angle = 0.3
    columns = np.array(
        [[1.0, 0, 0], [2.0, 50.0, 0], [0, 100.0 * np.cos(angle), 100.0 * np.sin(angle)], [0.0, 100.0, 0.0]]
    ).T
    found = _judged(columns.T @ columns, 1, [(1,), (2,), (3,)], ("a", "b", "c"))
    # 2 e1 less what a tolerance of unit prior takes: 4 - 2 * 2 / 2 = 2.
    np.testing.assert_allclose(found.visible, [np.sqrt(2 + 2500), 100.0, 100.0], rtol=1e-9)
    assert found.separation[1, 2] == pytest.approx(100 * np.sin(angle), rel=1e-6)
    assert found.cosine[1, 2] == pytest.approx(np.cos(angle), rel=1e-6)
    assert found.classes == (("a", "c"),)  # sqrt(2) of the first stands out of the third, less than is seen
    assert ("a", "c") in found.close


def test_small_signals_hide_a_saturation(sound):
    """A limit of 10 mA that the current never reaches does nothing; with forces that reach it, it shows."""
    small = replace(sound, records=tuple(r for r in sound.records if "small" in r.name))
    largest = max(float(np.abs(r.measured["current_A"]).max()) for r in small.records)
    assert largest < 10e-3
    assert "current_saturation" in of(small, "current_saturation", "sensor_lag").invisible
    assert max(float(np.abs(r.measured["current_A"]).max()) for r in sound.records) > 10e-3
    assert of(sound, "current_saturation", "sensor_lag").invisible == ()


def test_lag_and_delay_are_close_and_a_deadband_is_not(sound):
    """To first order in frequency a lag is a delay; a deadband is neither."""
    found = of(sound, "sensor_lag", "transport_delay", "valve_deadband")
    assert found.cosine[0, 1] > 0.98
    assert ("sensor_lag", "transport_delay") in found.close
    assert found.cosine[0, 2] < 0.7
    assert found.separation[0, 2] > 5 * found.separation[0, 1]
    np.testing.assert_array_equal(found.separation, found.separation.T)


def test_one_slow_record_makes_a_class_of_lag_and_delay():
    """Below 20 Hz the two differ by less than the model counts as exact."""
    plan = scenario(0.5)
    slow = plan.record[1].but(input=(plan.record[1].input[0].but(low_Hz=2.0, high_Hz=20.0),))
    data = measured(believed(), plan.but(record=(slow,)))
    found = of(data, "sensor_lag", "transport_delay")
    assert found.separation[0, 1] < 2.0
    assert found.classes == (("sensor_lag", "transport_delay"),) or set(found.invisible)


def test_a_cause_that_makes_the_model_unstable_is_left_out():
    """A loop near its critical gain does not survive half a millisecond of delay, nor half or a quarter of that."""
    rig = believed()
    data = measured(rig, scenario(0.5))
    hot = rig.controller.but(gain_A_per_V=0.28)
    records = tuple(replace(r, controller=hot) for r in data.records[:1])
    found = of(replace(data, records=records), "transport_delay", "valve_deadband")
    assert found.names == ("valve_deadband",)


def test_no_more_is_told_than_there_is_time_for(sound):
    with within(0.0), share(1.0, within_steps=True), pytest.raises(TimeUp):
        of(sound, "sensor_lag")
