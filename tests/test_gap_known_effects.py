"""The second way round: data sets whose believed prototype states effects already, by records of rigs simulated."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gap_sets import LAG, believed, measured, scenario
from slow_sensor import shortened

from beamdesign import InputError, Prototype, critical_gain, diagnose, read_dataset
from beamdesign.diagnosis import diagnose as diagnosing
from beamdesign.diagnosis import separability
from beamdesign.diagnosis.data.dataset import Dataset, MeasuredGain
from beamdesign.diagnosis.diagnosis import updated_prototype
from beamdesign.diagnosis.fitting import search as searching
from beamdesign.diagnosis.fitting.evidence import record_evidence
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.hypothesis import (
    NOTHING,
    Hypothesis,
    known_effects,
    learnable,
    pairs,
    singles,
    subsystem,
)
from beamdesign.diagnosis.learning import with_scales
from beamdesign.diagnosis.second_look import without_impacts
from beamdesign.diagnosis.where.residuals import residuals

pytestmark = pytest.mark.long

QUIET = LAG.but(gain_A_per_V=0.06)
LAGS: dict[str, Any] = {"sensor_lag": {"break_Hz": 250.0}}
FRICTION: dict[str, Any] = {"seal_friction": {"coulomb_N": 30.0}}
CURVE: dict[str, Any] = {"empirical_outer_reaction_curve": {"cube": 0.4, "reach_m": 1e-3, "size_N": 500.0}}
FEW = ("sensor_lag", "without:sensor_lag", "mount_compliance", "parameter:flow_gain")


def rig(effects: dict[str, Any]) -> Prototype:
    """The published rig with effects and with a gain at which a slow sensor leaves it stable."""
    return believed().but(effects=effects, controller=QUIET)


def records(true: dict[str, Any], stated: dict[str, Any], lacking: str = "command_small") -> Dataset:
    """Four records of a rig with some effects, whose prototype states others."""
    plan = scenario(0.6)
    rows = [row for row in plan.record if row.name not in ("load_steps", lacking)]
    slower = plan.but(record=tuple(row.but(controller=QUIET) for row in rows))
    return measured(rig(true), slower, rig(stated))


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer causes, so that it takes less time; masses are weighed in tests of their own."""
    monkeypatch.setattr(diagnosing, "with_own_mass", lambda data, kept: (data, kept, ()))
    for room in (searching, separability):
        monkeypatch.setattr(room, "singles", lambda prototype: tuple(h for h in singles(prototype) if str(h) in FEW))


@pytest.mark.parametrize("stated", [LAGS, FRICTION, CURVE], ids=lambda table: next(iter(table)))
def test_what_the_prototype_states_is_no_gap(stated: dict[str, Any], few: None) -> None:
    found = diagnose(records(stated, stated), 1)
    assert found.verdict == "no_gap"
    assert found.gap.before < 3 * found.gap.noise_floor
    assert found.prototype.effects == stated
    assert next(iter(stated)) in "".join(found.notes)


@pytest.mark.parametrize(
    ("true", "cause", "figure"),
    [
        ({"sensor_lag": {"break_Hz": 140.0}}, "sensor_lag", ("break_Hz", 140.0)),
        (LAGS | {"mount_compliance": {"stiffness_N_per_m": 3e6}}, "mount_compliance", ("stiffness_N_per_m", 3e6)),
        ({}, "without:sensor_lag", None),
    ],
    ids=["grown", "another beside it", "gone"],
)
def test_what_has_changed_since_is_the_cause(
    true: dict[str, Any], cause: str, figure: tuple[str, float] | None, few: None
) -> None:
    found = diagnose(records(true, LAGS), 1)
    assert (found.verdict, found.chosen) == ("effect", (cause,))
    assert found.where.subsystem == subsystem(cause)
    assert found.gap.after < 3 * found.gap.noise_floor < 0.3 * found.gap.before
    assert set(found.prototype.effects) == set(true)
    (named,) = (one for one in found.causes if one.name == cause)
    if figure is None:
        assert not named.parameters
        assert "the lack of sensor_lag" in found.sentences
    else:
        name, value = figure
        assert named.parameters[name].value == pytest.approx(value, rel=0.02)


def test_the_rig_behind_the_indicators_has_the_effects_that_are_stated() -> None:
    """What is driven through the linear rig with its lag is what was simulated with it, to the sensors' noise."""
    missed = []
    for stated in (LAGS, {}):
        data = records(LAGS, stated)
        placement = NOTHING.placement(data.prototype)
        null = Fit(NOTHING, placement.unknowns, np.zeros(len(placement.unknowns)))
        found = residuals(null, record_evidence(data))
        missed.append([np.std(i.nominal["displacement_m"] - i.evidence.measured[:, i.evidence.column]) for i in found])
    known, plain = missed
    assert max(known) < 3 * scenario().measurement.displacement_std_m < min(plain)


def test_an_effect_is_not_paired_with_its_absence_nor_its_own_law() -> None:
    among = singles(rig(LAGS))
    assert Hypothesis(("without:sensor_lag",)) in among
    for pair in pairs(among):
        assert not {"sensor_lag", "without:sensor_lag"} <= {*pair.causes}
    (lacking,) = (h for h in among if h.names == ("without:sensor_lag",))
    assert "sensor_lag" not in lacking.placement(rig(LAGS)).assembly.kinds.effects
    assert not [h for h in singles(rig({})) if "without" in str(h)]


def test_another_law_stands_for_the_one_that_was_stated() -> None:
    stated = rig({"current_saturation": {"limit_A": 0.02}} | FRICTION)
    soft = Hypothesis(("current_saturation_soft",))
    placement = soft.placement(stated)
    assert placement.assembly.kinds.effects == ("current_saturation_soft", "seal_friction")
    found = Fit(soft, placement.unknowns, np.zeros(len(placement.unknowns)))
    assert set(updated_prototype(stated, found).effects) == {"current_saturation_soft", "seal_friction"}


def test_scales_of_a_law_are_no_law_that_is_known() -> None:
    data = records(CURVE, CURVE)
    (name,) = CURVE
    assert known_effects(data.prototype) == (name,)
    assert name not in {h.names[0] for h in learnable(data.prototype)}
    placement = NOTHING.placement(data.prototype)
    scaled = with_scales(data, Fit(NOTHING, placement.unknowns, np.zeros(len(placement.unknowns))))
    assert len(scaled.prototype.effects) > 1
    assert known_effects(scaled.prototype) == (name,)
    assert scaled.prototype.effects[name] == CURVE[name]


def test_play_by_which_nothing_repeats_from_rest_is_looked_for_anew() -> None:
    play = {"joint_backlash": {"play_m": 3e-5}}
    data, said = without_impacts(records(play | LAGS, play | LAGS))
    assert data.prototype.effects == LAGS
    assert "joint_backlash" in said[0]
    data, said = without_impacts(records(LAGS, LAGS))
    assert (data.prototype.effects, said) == (LAGS, ())


def test_play_that_is_looked_for_anew_and_not_found_stays_as_it_was_stated(
    few: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(searching, "singles", lambda prototype: tuple(Hypothesis((name,)) for name in FEW[2:]))
    for look in ("channels_in_time", "what_passed", "learn", "second_look", "next_experiment"):
        monkeypatch.setattr(diagnosing, look, lambda *given: None)
    play = {"joint_backlash": {"play_m": 3e-5}}
    found = diagnose(records(play, play, "payload_disturbance"), 1)
    assert found.chosen == ()
    assert found.prototype.effects == play
    assert any("joint_backlash" in words for words in found.warnings)


def test_critical_gains_are_held_against_the_effects_that_are_stated(few: None) -> None:
    """A gain that the exact loop of the prototype has, its lag included, speaks of no gap; without the lag it does."""
    lagging = rig(LAGS)
    masses = (0.0, 3.4, 6.8), lagging.payload.inner_end_mass_kg
    found = [(mass, critical_gain(lagging, mass).gain_A_per_V) for mass in masses[0]]
    gains = tuple(MeasuredGain(QUIET.but(gain_A_per_V=gain), mass, masses[1], 0.01) for mass, gain in found)
    known, plain = (diagnose(Dataset("gains", Path(), rig(e), gains=gains), 1) for e in (LAGS, {}))
    assert known.verdict == "no_gap"
    assert known.gap.before < 0.02 < plain.gap.before
    assert "sensor_lag" in known.notes[0]


def test_an_effect_that_is_not_known_is_refused_before_anything_is_fitted(tmp_path: Path) -> None:
    prototype = shortened(tmp_path / "slow", 20) / "prototype.toml"
    prototype.write_text(prototype.read_text() + "\n[effects.sensor_lag]\nfrequency_Hz = 250.0\n")
    with pytest.raises(InputError, match="break_Hz"):
        read_dataset(prototype.parent)
