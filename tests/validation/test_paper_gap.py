"""The gap of the published rig: four critical gains against what its authors predicted.

A. Zalucky and D. E. Hardt, "Active Control of Robot Structure Deflections", ASME Journal of Dynamic Systems,
Measurement, and Control 106 (1984) 63-69: measured 15, 200, 7 and 150 mA/V; predicted 24, 300, 10 and 200 mA/V. The
experiments had a 400 Hz low-pass filter behind the sensor and a piston whose sides are unequal; the predictions had
neither.
"""

from math import exp, log
from pathlib import Path

import numpy as np
import pytest

from beamdesign import read_dataset
from beamdesign.diagnosis.diagnosis import Diagnosis
from beamdesign.diagnosis.gain_diagnosis import explain_gains
from beamdesign.validation.paper_rig import CASES, gain_rows

pytestmark = pytest.mark.long

FOLDER = Path(__file__).parents[2] / "studies" / "gaps" / "paper_gains"


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    return explain_gains(read_dataset(FOLDER))


def test_the_data_set_holds_the_published_figures():
    data = read_dataset(FOLDER)
    assert [1e3 * g.gain for g in data.gains] == pytest.approx([15, 200, 7, 150])
    assert [1e3 * g.predicted_gain for g in data.gains] == pytest.approx([24, 300, 10, 200])
    assert [(g.outer_end_mass, g.inner_end_mass) for g in data.gains] == [(0, 0), (0, 0), (6.8, 0), (6.8, 4.4)]
    assert not data.warnings


def test_four_gains_name_no_single_culprit(found: Diagnosis):
    assert found.verdict == "ambiguous"
    assert found.chosen == ()
    (rivals,) = found.classes
    assert "unequal_piston_areas" in rivals
    assert {"parameter:flow_gain", "parameter:sensor_gain"} <= set(rivals)  # which only act as one factor on the loop
    assert max(p for _, p in found.findings["ranked"]) < 0.5
    assert found.next_experiment is not None
    assert found.next_experiment.separation > 1


def test_against_the_papers_own_predictions_one_factor_explains_most(found: Diagnosis):
    ratios = [case.measured_mA_per_V / case.predicted_mA_per_V for case in CASES]
    assert ratios == pytest.approx([0.625, 0.667, 0.7, 0.75], abs=1e-3)
    factor = found.findings["on_predictions"].findings["factor"]
    assert factor.factor == pytest.approx(float(np.exp(np.mean(np.log(ratios)))), rel=1e-12)
    assert factor.factor == pytest.approx(0.68, abs=0.005)
    assert factor.explained > 0.95
    # Not all: the ratios rise by a fifth from the first to the last, where their errors are 5 %.
    assert factor.left > factor.noise
    assert found.findings["on_predictions"].verdict == "ambiguous"
    assert {"sensor_lag", "unequal_piston_areas"} <= set(found.findings["on_predictions"].classes[0])


def test_shares_of_filter_and_smaller_side(found: Diagnosis):
    """The means of the changes that the exact loop has with the filter, and with the smaller side as plain area."""
    rows, shares = gain_rows(), found.findings["shares"]

    def mean(key: str) -> float:
        return float(np.mean([log(row.varied_mA_per_V[key] / row.model_mA_per_V) for row in rows]))

    lag, sides, rest = shares.shares
    assert lag.alone == pytest.approx(mean("with_filter"), abs=1e-6)
    assert sides.alone == pytest.approx(mean("smaller_piston_side"), abs=0.01)
    assert shares.together == pytest.approx(mean("filter_and_smaller_side"), abs=0.01)
    assert lag.share + sides.share == pytest.approx(shares.together, abs=1e-12)
    assert lag.share + sides.share + rest.share == pytest.approx(shares.total, abs=1e-12)
    measured = [log(row.case.measured_mA_per_V / row.model_mA_per_V) for row in rows]
    assert shares.total == pytest.approx(np.mean(measured), abs=1e-6)
    # Most of the gap on the paper's own predictions, half of that on the model's, the rest of it a common factor.
    on_predictions = found.findings["on_predictions"].findings["shares"]
    assert on_predictions.together / on_predictions.total == pytest.approx(0.63, abs=0.02)
    assert shares.together / shares.total == pytest.approx(0.48, abs=0.02)
    assert rest.parameters["factor"] == pytest.approx(exp(rest.share))


def test_what_does_not_replicate_is_said(found: Diagnosis):
    """The case with 6.8 kg outside alone is predicted otherwise by the model, 15 for 10 mA/V: damping decides it."""
    said = [note for note in found.notes if "designers predicted" in note]
    assert len(said) == 1
    assert "6.8 kg outer, 0 kg inner" in said[0]
    assert "15.3 mA/V" in said[0]
    assert any("0.68" in note for note in found.notes)
