"""The next experiment: what it promises against closed forms, and whether doing it keeps the promise."""

from dataclasses import replace

import numpy as np
import pytest
from gap_sets import believed, measured, scenario

from beamdesign.diagnosis.experiment import distance, next_experiment
from beamdesign.diagnosis.fitting.evidence import evidence_of
from beamdesign.diagnosis.fitting.fit import fit
from beamdesign.diagnosis.fitting.hypothesis import together
from beamdesign.diagnosis.fitting.starts import starts
from beamdesign.records import parse
from beamdesign.scenario import Measurement, Scenario

TRUTH, RIVAL = "sensor_lag", "transport_delay"


def fitted(name, data, known=None):
    hypothesis = together(name)
    placement = hypothesis.placement(data.prototype)
    evidence = evidence_of(data)
    begun = starts(placement, known or {}, evidence, 1)
    return fit(hypothesis, placement, evidence, begun[0])


@pytest.fixture(scope="module")
def rig():
    return believed().but(effects={TRUTH: {"break_Hz": 120.0}})


@pytest.fixture(scope="module")
def slow(rig):
    """Commands and forces below 20 Hz: they show that something lags, not what."""
    plan = scenario()
    rows = [row.but(input=(row.input[0].but(low_Hz=1.0, high_Hz=20.0),)) for row in (plan.record[1], plan.record[3])]
    return measured(rig, plan.but(record=tuple(rows)))


def test_distance_between_lines_has_its_closed_form():
    """A difference of 3 along a direction that unit prior may move by k leaves 3 / sqrt(1 + k^2)."""
    free = np.array([[2.0], [0.0]])
    assert distance(np.array([3.0, 0.0]), free) == pytest.approx(3 / np.sqrt(5), rel=1e-12)
    assert distance(np.array([0.0, 3.0]), free) == pytest.approx(3.0, rel=1e-12)


def test_doing_what_is_proposed_separates_the_rivals(rig, slow):
    """Carried out on the rig of one rival, the proposed record leaves the other with a misfit near the promise."""
    rivals = [fitted(TRUTH, slow), fitted(RIVAL, slow)]
    before = rivals[1].cost - rivals[0].cost
    proposed = next_experiment(slow, rivals)
    assert proposed is not None
    assert proposed.separates == (TRUTH, RIVAL)
    assert proposed.separation > np.sqrt(max(before, 0.0)) + 2.0  # more than all that was measured so far
    assert "units of misfit" in proposed.text
    plan = parse(Scenario, dict(proposed.settings["scenario"]), "next").but(
        measurement=Measurement(seed=9, disturbance_std_N=0.5, current_std_A=2e-5, displacement_std_m=5e-7)
    )
    assert not proposed.settings["added_sensor"]  # this rig records no further channel
    both = replace(slow, records=slow.records + measured(rig, plan).records)
    after = fitted(RIVAL, both, rivals[1].values).cost - fitted(TRUTH, both, rivals[0].values).cost
    assert after - before > 0.5 * proposed.separation**2


def test_one_rival_alone_needs_no_experiment(slow):
    assert next_experiment(slow, [fitted(TRUTH, slow)]) is None
