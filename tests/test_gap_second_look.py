"""Records that no model repeats from rest because the rig's loop oscillates by itself."""

from dataclasses import replace

import numpy as np
import pytest
from gap_sets import LAG, believed, measured, scenario

from beamdesign import critical_gain
from beamdesign.diagnosis import second_look as looking
from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.fitting import search as searching
from beamdesign.diagnosis.fitting.evidence import record_evidence
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.fitters import refit
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, Hypothesis
from beamdesign.diagnosis.fitting.search import Search
from beamdesign.diagnosis.judgement import Judgement
from beamdesign.diagnosis.passing import Look
from beamdesign.diagnosis.second_look import grows, rings

SLOW_Hz = 45.0  # a sensor's break that costs the loop its margin
SLOWED = Hypothesis(("sensor_lag",))
FEW = (SLOWED, Hypothesis(("unequal_piston_areas",)), Hypothesis(("parameter:flow_gain",)))
SLOW_RIG = believed().but(effects={"sensor_lag": {"break_Hz": SLOW_Hz}})


def taken_at(share: float) -> Dataset:
    """Two records of the published rig with a slow sensor, at a share of its critical gain.

    That gain is exact, from the characteristic polynomial of the linear loop: no simulation has a part in it.
    """
    gain = share * critical_gain(SLOW_RIG).gain_A_per_V
    plan = scenario()
    rows = [row.but(controller=LAG.but(gain_A_per_V=gain)) for row in plan.record if row.name.startswith("command")]
    return measured(SLOW_RIG, plan.but(record=tuple(rows)))


@pytest.fixture(scope="module")
def unstable():
    return taken_at(1.03)


@pytest.fixture(scope="module")
def stable():
    return taken_at(0.97)


def growing(data: Dataset, hypothesis: Hypothesis) -> list[bool]:
    placement = hypothesis.placement(believed())
    z = np.array([u.z(SLOW_Hz) if u.name == "sensor_lag.break_Hz" else 0.0 for u in placement.unknowns])
    return [grows(piece, placement, z) for piece in record_evidence(data)]


def test_motion_grows_beyond_the_critical_gain_alone(stable, unstable):
    assert growing(stable, SLOWED) == [False, False]
    assert growing(unstable, SLOWED) == [True, True]
    assert growing(unstable, NOTHING) == [False, False]  # the believed rig has no slow sensor


def test_a_rig_that_oscillates_leaves_one_frequency(unstable):
    placement = NOTHING.placement(believed())
    small = record_evidence(unstable)[0]
    z = np.zeros(len(placement.unknowns))
    assert rings(small, placement, z)
    step = small.record.step
    random = np.random.default_rng(2).normal(0, 1e-5, len(small.record.times))
    assert not rings(replace(small, measured=small.predicted(placement, z) + random[:, None]), placement, z)
    hum = 1e-5 * np.sin(2 * np.pi * 50 * step * np.arange(len(random)))
    assert rings(replace(small, measured=small.predicted(placement, z) + hum[:, None]), placement, z)


@pytest.fixture
def few(monkeypatch, single_causes):
    """Three candidates, one at a time, and no search for play, which has tests of its own."""
    monkeypatch.setattr(searching, "singles", lambda prototype: FEW)
    monkeypatch.setattr(looking, "backlash_impacts", lambda *given: None)


def nothing_found(data: Dataset) -> Look:
    unknowns = NOTHING.unknowns(believed())
    null = Fit(NOTHING, unknowns, np.zeros(len(unknowns)))
    return Look(data, Search(null, (), 1.0), Judgement({}, 1.0, null))


@pytest.mark.usefixtures("few")
def test_what_makes_a_loop_oscillate_is_found_in_step(unstable):
    found = looking.second_look(nothing_found(unstable))
    assert found is not None
    best = found.judged.best
    assert best.hypothesis == SLOWED
    assert best.values["sensor_lag.break_Hz"] == pytest.approx(SLOW_Hz, rel=0.02)
    assert found.judged.unknown < 0.05
    assert "command_small, command_large: the rig's loop oscillates by itself" in found.words[0]
    assert found.follows == "oscillates"
    _, again = refit(unstable, best, synchronised=True)
    assert again.values["sensor_lag.break_Hz"] == pytest.approx(SLOW_Hz, rel=0.02)


@pytest.mark.usefixtures("few")
def test_a_loop_that_does_not_oscillate_is_not_explained_in_step(stable):
    assert looking.second_look(nothing_found(stable)) is None
