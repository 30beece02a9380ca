"""A rig so many times as quick, with records so many times as short, is the same rig: Buckingham's theorem."""

from dataclasses import astuple, replace

import numpy as np
import pytest
from as_quick import as_quick
from gap_sets import LAG, believed, measured, scenario

from beamdesign.build.acceptance import acceptance_plan
from beamdesign.controllers import Controller
from beamdesign.diagnosis.data.dataset import Dataset, TimeRecord
from beamdesign.diagnosis.examination.plausibility import examine
from beamdesign.diagnosis.experiment_menu import menu
from beamdesign.diagnosis.fitting.evidence import record_evidence
from beamdesign.diagnosis.fitting.fit import fit
from beamdesign.diagnosis.fitting.hypothesis import NOTHING
from beamdesign.diagnosis.gap_metrics import errors, gap
from beamdesign.diagnosis.where.locate import setting
from beamdesign.diagnosis.where.residuals import residuals


def law_as_quick(law: Controller, pace: float) -> Controller:
    given = {name: pace * value for name, value in law.model_dump().items() if name.endswith("_Hz")}
    return law.but(**given)


def set_as_quick(data: Dataset, pace: float) -> Dataset:
    """The same displacements and currents, sooner, under forces larger by the square."""

    def record(one: TimeRecord) -> TimeRecord:
        law = law_as_quick(one.controller, pace)
        return replace(one, times=one.times / pace, inputs=one.inputs * (pace**2, 1.0), controller=law)

    rig = as_quick(data.prototype, pace).but(controller=law_as_quick(LAG, pace))
    return replace(data, prototype=rig, records=tuple(map(record, data.records)))


@pytest.fixture(scope="module")
def slow() -> Dataset:
    """Three records of a rig whose sensor lags."""
    plan = scenario()
    return measured(believed().but(effects={"sensor_lag": {"break_Hz": 150.0}}), plan.but(record=plan.record[2:5]))


def test_records_weigh_the_same(slow: Dataset) -> None:
    """Residuals of a quicker rig are the same at every line, so that fits to it are as sure."""
    of: list[list[np.ndarray]] = []
    for data in (slow, set_as_quick(slow, 4.0)):
        z = np.zeros(len(NOTHING.placement(data.prototype).unknowns))
        of.append([piece.residual(NOTHING.placement(data.prototype), z) for piece in record_evidence(data)])
    for one, other in zip(*of, strict=True):
        np.testing.assert_allclose(other, one, atol=2e-3 * np.abs(one).max())


def test_errors_are_told_as_surely_and_by_bands_of_the_rig(slow: Dataset) -> None:
    gaps = []
    for data in (slow, set_as_quick(slow, 4.0)):
        placement, pieces = NOTHING.placement(data.prototype), record_evidence(data)
        null = fit(NOTHING, placement, pieces, np.zeros(len(placement.unknowns)), 1)
        gaps.append(gap([errors(piece, null, null, null) for piece in pieces], (0,)))
    one, other = gaps
    assert other.closed_interval == pytest.approx(one.closed_interval, abs=1e-3)
    for ours, theirs in zip(one.bands, other.bands, strict=True):
        assert astuple(theirs) == pytest.approx((4 * ours.low_Hz, 4 * ours.high_Hz, *astuple(ours)[2:]), rel=2e-3)


def test_a_slow_rig_counts_from_lower_frequencies_on(slow: Dataset) -> None:
    lowest = [record_evidence(set_as_quick(slow, pace))[0].weight.frequencies_Hz[0] for pace in (1.0, 0.125)]
    assert lowest[1] == pytest.approx(0.125 * lowest[0])


def test_where_a_gap_lies_in_frequency_goes_with_the_rig(slow: Dataset) -> None:
    bands = []
    for data in (slow, set_as_quick(slow, 4.0)):
        placement = NOTHING.placement(data.prototype)
        pieces = record_evidence(data)
        null = fit(NOTHING, placement, pieces, np.zeros(len(placement.unknowns)), 1)
        bands.append(setting(residuals(null, pieces)).band_Hz)
    assert bands[1] == pytest.approx(4.0 * np.array(bands[0]))


@pytest.mark.parametrize("pace", [4.0, 0.25])
def test_what_is_to_be_measured_next_goes_with_the_rig(slow: Dataset, pace: float) -> None:
    """As many samples, of inputs so many times as quick."""
    for one, other in zip(menu(slow), menu(set_as_quick(slow, pace)), strict=True):
        np.testing.assert_allclose(other.scenario.times * pace, one.scenario.times, atol=1e-9)
        (ours,), (theirs,) = (plan.record[0].input for plan in (one.scenario, other.scenario))
        for name, value in ours.model_dump(exclude_none=True).items():
            times = pace if name.endswith("_Hz") else 1 / pace if name.endswith("_s") else pace**2
            if name.endswith(("_Hz", "_s", "_N")):
                assert getattr(theirs, name) == pytest.approx(times * value, rel=0.05)


def test_a_quick_rig_needs_no_longer_records(slow: Dataset) -> None:
    """A second of the published rig is an eighth of one that is eight times as quick: refused as too short before."""
    assert len(examine(set_as_quick(slow, 8.0)).data.records) == len(slow.records)


def test_the_acceptance_test_goes_with_the_rig() -> None:
    one, other = (
        acceptance_plan(as_quick(believed(), pace).but(controller=law_as_quick(LAG, pace)), (0.0, 2.0)).scenario
        for pace in (1.0, 4.0)
    )
    np.testing.assert_allclose(4 * other.times, one.times, atol=1e-9)
    assert [row.name for row in other.record] == [row.name for row in one.record]
    (ours,), (theirs,) = (plan.record[0].input for plan in (one, other))
    assert (ours.low_Hz, ours.high_Hz, theirs.low_Hz, theirs.high_Hz) == (1.0, 250.0, 4.0, 1000.0)
