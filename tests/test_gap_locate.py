"""Where a gap lies: indicators against closed forms, and places of effects that were put in."""

from dataclasses import replace

import numpy as np
import pytest
from gap_sets import believed, measured, scenario

from beamdesign import Prototype
from beamdesign.diagnosis.diagnosis import Cause
from beamdesign.diagnosis.fitting.evidence import evidence_of
from beamdesign.diagnosis.fitting.fit import Fit, fit
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, together
from beamdesign.diagnosis.fitting.search import Search
from beamdesign.diagnosis.where.locate import kind_of_effect, laws_of, lines_of, locate, setting
from beamdesign.diagnosis.where.missing import stop, terms
from beamdesign.diagnosis.where.residuals import places, residuals


def tuned(data) -> tuple[Search, Fit, tuple]:
    """Tolerances fitted, no other hypothesis."""
    evidence = evidence_of(data)
    placement = NOTHING.placement(data.prototype)
    null = fit(NOTHING, placement, evidence, np.zeros(len(placement.unknowns)), 4)
    return Search(null, (), sum(e.expected for e in evidence)), null, evidence


def at_believed(data) -> tuple:
    """Residuals of the believed figures."""
    placement = NOTHING.placement(data.prototype)
    null = Fit(NOTHING, placement.unknowns, np.zeros(len(placement.unknowns)), 0.0)
    return residuals(null, evidence_of(data))


@pytest.fixture(scope="module")
def bare() -> Prototype:
    return believed()


@pytest.fixture(scope="module")
def deadband(bare):
    return measured(bare.but(effects={"valve_deadband": {"half_width_A": 0.15e-3}}))


def test_linear_rig_in_frequency_is_the_simulated_one(bare):
    """Two ways to the same response: Runge-Kutta in time, and C (s - A)^-1 B on the padded grid."""
    quiet = scenario(0.5)
    data = measured(bare, quiet.but(measurement=quiet.measurement.but(displacement_std_m=1e-12)))
    for item in at_believed(data):
        expected = item.evidence.predicted(NOTHING.placement(bare), np.zeros(13))
        column = item.channels.index("displacement_m")
        found = item.nominal["displacement_m"]
        assert np.std(found - expected[:, column]) < 2e-3 * np.std(expected[:, column])


@pytest.mark.parametrize("rig", ["twin_beam", "ball_screw"])
def test_what_is_tried_of_a_rig_eight_times_as_slow_is_what_is_tried_of_the_published_one(rig):
    """In time that goes by so many times as slowly every law is the same, but for the unit of its derivatives."""
    signal, s = np.cumsum(np.random.default_rng(3).normal(size=400)), 2j * np.pi * np.geomspace(1.0, 300.0, 40)
    usual, slow = (terms(lambda name: np.geomspace(0.1, 3.0, 6), places(rig), p, 5e-4 / p) for p in (1.0, 1 / 8))
    for one, other in zip(usual, slow, strict=True):
        if one.kind == "linear":
            expected, found = (np.asarray(term.law(at)) for term, at in ((one, s), (other, s / 8)))
            expected, found = expected / expected[0], found / found[0]
        else:
            expected, found = (term.law(*[signal] * len(term.signals)) for term in (one, other))
        np.testing.assert_allclose(found, expected, rtol=1e-9, err_msg=f"{one.words}, {other.words}")


def test_stop_operator_on_a_triangle():
    """Up by 3 from rest with half width 1: clipped at 1; back by 4: falls by 2 to -1 and stays."""
    up, down = np.linspace(0, 3, 31), np.linspace(3, -1, 41)[1:]
    found = stop(1.0, np.concatenate([up, down]))
    np.testing.assert_allclose(found[:31], np.minimum(up, 1.0), atol=1e-12)
    np.testing.assert_allclose(found[31:], np.maximum(1.0 + (down - 3.0), -1.0), atol=1e-12)


def test_distortion_of_a_known_polynomial():
    """Lines at odd multiples: u^2 falls on even ones alone, by Parseval's theorem with its standard deviation."""
    count = 8192
    phase = np.random.default_rng(0).uniform(0, 2 * np.pi, 20)
    time = np.arange(count) / count
    odd = 2 * np.arange(3, 23) + 1
    u = np.cos(2 * np.pi * odd[:, None] * time + phase[:, None]).sum(0)
    # A response holds the lines of the input; what the polynomial adds is the residual.
    bent = lines_of(u, u, 0.01 * u**2, 0.0)
    assert bent is not None
    assert bent[0] == pytest.approx(0.0, abs=1e-12)
    inside = np.abs(np.fft.rfft(u**2))[odd[0] : 3 * odd[-1]] ** 2
    expected = 0.01 * np.sqrt(2 * inside.sum() / count**2 / np.mean(u**2))
    assert bent[1] == pytest.approx(expected, rel=1e-9)
    cubed = lines_of(u, u, 0.01 * u**3, 0.0)
    assert cubed is not None
    assert cubed[1] > 0
    # All of u^3 is at excited lines or at odd ones between 3 times the lowest and the highest.
    assert cubed[0] ** 2 + cubed[1] ** 2 <= 1e-4 * np.mean(u**6) / np.mean(u**2)
    linear = lines_of(u, u, 0.03 * u, 0.0)
    assert linear is not None
    assert linear == (pytest.approx(0.03), pytest.approx(0.0, abs=1e-12))
    assert lines_of(np.random.default_rng(1).normal(size=count), u, u, 0.0) is None  # dense: no grid to read


def test_laws_of_the_valve_explain_a_deadband(deadband):
    search, null, evidence = tuned(deadband)
    laws = laws_of(residuals(null, evidence), null)
    assert laws[0].subsystem == "servovalve"
    assert laws[0].share > 0.4
    where = locate(search, null, evidence, unknown=0.9)
    assert where.subsystem == "servovalve"
    assert where.kind in ("static", "hysteretic")
    assert "servovalve" in where.sentence
    assert "Weighed" not in where.sentence  # no weight is as sure as it looks where the fits know of no cause
    assert "small amplitude" in where.condition
    shown = next(w for w in where.indicators if w.name == "bands and conditions")
    assert len(shown.table["record"]) == len(deadband.records)
    assert "the misfit as fits weigh it" in shown.text
    assert all(0.0 <= w.strength <= 1.0 for w in where.indicators)


def test_fits_decide_where_a_cause_is_known(deadband):
    search, null, evidence = tuned(deadband)
    chosen = replace(null, hypothesis=together("valve_deadband"))
    causes = (Cause("valve_deadband", "servovalve", 0.97, 0.9),)
    where = locate(search, chosen, evidence[:2], causes)
    assert where.subsystem == "servovalve"
    assert where.kind == "static"
    assert where.indicators[0].subsystem == "servovalve"


def test_no_gap_has_no_place(deadband):
    search, null, evidence = tuned(replace(deadband, records=deadband.records[:1]))
    assert locate(search, null, evidence).subsystem == ""
    assert locate(search, null, evidence).sentence == "Tolerances leave no gap to place."  # of whatever was compared


def test_kinds_of_effects_follow_from_their_equations():
    assert kind_of_effect("sensor_lag") == "linear"
    assert kind_of_effect("mount_compliance") == "linear"
    assert kind_of_effect("seal_friction") == "hysteretic"
    assert kind_of_effect("valve_hysteresis_magnetic") == "hysteretic"
    assert kind_of_effect("current_saturation") == "static"
    assert kind_of_effect("parameter:flow_gain") == "linear"


def test_a_record_in_which_nothing_happens_does_no_harm(deadband):
    """All channels zero: no noise, no signal, no vote."""
    first = deadband.records[1]
    still = replace(
        first,
        name="still",
        inputs=np.zeros_like(first.inputs),
        measured={name: np.zeros_like(y) for name, y in first.measured.items()},
    )
    found = at_believed(replace(deadband, records=(first, still)))
    assert all(np.all(np.isfinite(y)) for item in found for y in item.smoothed().values())
    (shown,) = setting(found).indicators
    assert shown.table["relative_error"][1] == 0.0
