"""Closing the loop: a true rig drawn once more, a controller on trial on it, and what may not be opened.

The truth model has its own equations and solver; what a trial measures is held against the exact linear loop.
"""

import json
from dataclasses import replace
from itertools import pairwise
from math import pi

import numpy as np
import opened_cases as opened
import pytest
from closing_the_loop import attempt, payloads, promised_gain_factor
from deciding_experiment import taken
from half_the_records import half_of, halved
from one_start import best_start_alone
from opened_cases import opened_case, opened_keys, true_rig, unlike
from trial import at_rest, on_trial

from beamdesign import InputError, Prototype, critical_gain, read_dataset
from beamdesign.code_digest import folder_digest
from beamdesign.controllers import Lag
from beamdesign.diagnosis.fitting.hypothesis import NOTHING
from beamdesign.diagnosis.fitting.replay import Replay
from beamdesign.diagnosis.redesign import Redesign, redesign
from beamdesign.loop import loop
from beamdesign.scenario import Multisine, Scenario, ScenarioRecord, inputs_of
from beamdesign.validation.case_plan import Planned, displacements_digest, draw, read_seal, sealed, write_seal
from beamdesign.validation.truth.case import Case, Departure, noise_free
from beamdesign.validation.truth.effects import Scales
from beamdesign.validation.truth.nominal import rig_figures
from beamdesign.validation.truth.rig import Noise

LAG = {"kind": "lag", "gain_A_per_V": 0.06, "pole_Hz": 1.75, "zero_Hz": 26.0}
PLANNED = Planned(3, "single", ("transport_delay",), 11)
FLOOR_M = 5e-7


@pytest.fixture
def lagged(remedy: Prototype) -> Prototype:
    """The paper's remedy at a gain that it bears without payload, too."""
    return remedy.but(controller=Lag(**LAG))


def rig(prototype: Prototype, *departures: Departure) -> Case:
    """The rig as it is believed, with nothing else in it."""
    kept = {"name", "outer_beam", "inner_beam", "actuator", "servovalve", "sensor"}
    believed = prototype.model_dump(include=kept, exclude_none=True)
    scales = Scales(rig_figures(believed, {}, {}), 900.0, 7.5e-3)
    noise = Noise(FLOOR_M, 0.0, 0.5, 2e-5, 0.0)
    return Case(1, "single", believed, {}, {}, (), departures, (), noise, 1.75, scales)


# Coming to rest


def test_what_grows_or_goes_on_is_not_at_rest_and_what_fades_or_drifts_is():
    times = np.arange(0, 1.5, 5e-4)
    wave = 1e-4 * np.sin(2 * pi * 40 * times)
    assert not at_rest(wave, FLOOR_M)
    assert not at_rest(wave * np.exp(0.5 * times), FLOOR_M)
    assert at_rest(wave * np.exp(-0.5 * times), FLOOR_M)
    assert at_rest(2e-4 * times, FLOOR_M)
    assert at_rest(wave * 1e-2, FLOOR_M)


# On trial


@pytest.mark.parametrize("mass_kg", [0.0, 6.8])
def test_a_sound_rig_shows_what_its_linear_loop_promises(lagged: Prototype, mass_kg: float):
    """Compliance and peak sensitivity to 3 %, critical gain to the 2 % it is looked for; small motion is linear."""
    found = on_trial(rig(lagged), LAG, 4.5, mass_kg)
    exact = loop(lagged).at(mass_kg)
    assert found.safe
    seen = found.frequency_Hz < 150
    expected = np.abs(exact.compliance_response(found.frequency_Hz[seen]))
    np.testing.assert_allclose(found.compliance_m_per_N[seen], expected, rtol=0.03)
    on_lines = np.abs(exact.sensitivity_response(found.frequency_Hz)).max()
    assert found.peak_sensitivity == pytest.approx(on_lines, rel=0.03)
    factor = critical_gain(lagged, mass_kg).gain_A_per_V / LAG["gain_A_per_V"]
    assert found.gain_factor == pytest.approx(factor, rel=0.03)


def test_dead_time_takes_as_much_gain_as_its_phase(lagged: Prototype):
    """Where the exact loop's response, turned by the dead time, first crosses the negative axis (Nyquist)."""
    delay_s = 2e-3
    found = on_trial(rig(lagged, Departure("transport_delay", delay_s / 0.5e-3)), LAG, 4.5, 0.0)
    lines = np.geomspace(1, 300, 40_000)
    turned = loop(lagged).at(0.0).loop_response(lines) * np.exp(-2j * pi * lines * delay_s)
    crossed = [k for k, (a, b) in enumerate(pairwise(turned.imag)) if a * b <= 0 and turned.real[k] < 0]
    assert found.gain_factor == pytest.approx(1 / max(-turned.real[k] for k in crossed), rel=0.03)


def test_gain_far_above_the_critical_one_is_unsafe_and_little_gain_is_safe(lagged: Prototype):
    high = LAG | {"gain_A_per_V": 3 * critical_gain(lagged, 0.0).gain_A_per_V}
    found = on_trial(rig(lagged), high, 4.5, 0.0)
    assert not found.safe
    assert "bounds" in found.restless
    assert found.gain_factor == pytest.approx(1 / 3, rel=0.03)
    assert np.isinf(found.compliance_m_per_N).all()
    assert on_trial(rig(lagged), LAG | {"gain_A_per_V": 1e-3}, 4.5, 0.0).safe


def test_other_controllers_are_refused(lagged: Prototype):
    with pytest.raises(ValueError, match="no structured controller"):
        on_trial(rig(lagged), {"kind": "structured"}, 0.0, 0.0)


# From what is known of an effect to a controller that is safe


def test_a_dead_time_that_nobody_knew_of_is_unsafe_until_the_controller_is_tuned_with_it(paper: Prototype):
    """3 ms: both designs are proved for their prototypes, but only one prototype has what is there."""
    case = rig(paper, Departure("transport_delay", 6.0))
    masses = (0.0, 2.0)
    with best_start_alone():
        made = [redesign(one, masses) for one in (paper, paper.but(effects={"transport_delay": {"delay_s": 3e-3}}))]
    believed, diagnosed = attempt(case, "believed", made[0]), attempt(case, "diagnosed", made[1])
    assert believed.made.prototype is not None
    assert believed.promised_gain_factor > 2
    assert not believed.safe
    assert (believed.bandwidth_Hz, believed.peak_sensitivity, believed.keeps_promise) == (0.0, np.inf, False)
    assert diagnosed.safe
    assert diagnosed.keeps_promise
    assert diagnosed.gain_factor == pytest.approx(diagnosed.promised_gain_factor, rel=0.05)
    assert payloads(masses) == (0.0, 1.0, 2.0)


def test_without_a_design_nothing_is_claimed(paper: Prototype):
    found = attempt(rig(paper), "believed", Redesign((0.0, 60.0), reason="no lag controller was found"))
    assert not found.safe
    assert not found.keeps_promise
    assert found.gain_factor == 0


def test_the_promised_gain_factor_is_the_least_over_the_payloads(lagged: Prototype):
    each = [critical_gain(lagged, mass).gain_A_per_V / 0.06 for mass in (0.0, 3.4, 6.8)]
    assert promised_gain_factor(lagged, (0.0, 3.4, 6.8)) == pytest.approx(min(each))


# Answers


@pytest.fixture(scope="module")
def scored(tmp_path_factory):
    """A check of one case, as if it had been diagnosed and scored."""
    folder = tmp_path_factory.mktemp("check")
    assert draw(PLANNED, True, folder / "sets", folder / "answers") == ""
    key = PLANNED.key
    answer = json.loads((folder / f"answers/{key}.json").read_text())
    row = {"number": PLANNED.number, "kind": PLANNED.kind, "names": list(PLANNED.names), "seed": PLANNED.seed}
    other = row | {"number": 4, "seed": 12}
    (folder / "plan.json").write_text(json.dumps({"seed": 0, "short": True, "cases": [row, other]}))
    digest = folder_digest(folder / "sets" / key)
    write_seal(sealed({key: answer}, {key: digest}), folder / "sealed.json")
    (folder / "found").mkdir()
    (folder / f"found/{key}.json").write_text(json.dumps({"set_sha256": digest, "fitted_by": ""}))
    (folder / "result.json").write_text(json.dumps({"cases": [{"case": key, "verdict": "effect"}]}))
    return folder


def test_the_rig_drawn_again_is_the_one_that_made_the_records(scored):
    """Its noise-free displacements have the digest that was sealed; those recorded differ from them by noise."""
    assert opened_keys(scored) == {"0003": "effect"}
    taken_up = opened_case(scored, "0003")
    case = true_rig(taken_up)
    assert case.names == ("transport_delay",)
    again = noise_free(case)
    records = {name: motion.displacement.astype(np.float32) for name, motion in again.items()}
    assert displacements_digest(records) == taken_up.answer["displacements_sha256"]
    recorded = np.genfromtxt(scored / "sets/0003/records/01_command_small.csv", delimiter=",", names=True)
    off = recorded["displacement_m"] - again["01_command_small"].displacement
    assert 0.5 < np.std(off) / case.noise.floor_m < 2


def test_another_rig_is_not_passed_off_as_the_true_one(scored, monkeypatch):
    taken_up = opened_case(scored, "0003")
    factors = taken_up.answer["tolerance_factors"]
    wrong = {**taken_up.answer, "tolerance_factors": {**factors, "flow_gain": factors["flow_gain"] * 1.001}}
    sealed_before = {name: value for name, value in taken_up.answer.items() if name != "displacements_sha256"}
    monkeypatch.setattr("beamdesign.validation.truth.drawing.draw_case", lambda *given, **more: None)
    monkeypatch.setattr("beamdesign.validation.truth.case.answer", lambda case: sealed_before)
    true_rig(taken_up)
    with pytest.raises(InputError, match=r"tolerance_factors\.flow_gain differs"):
        true_rig(replace(taken_up, answer=wrong))


def test_trees_of_values_are_compared_to_rounding():
    assert unlike({"a": [1.0, {"b": 2.0}]}, {"a": [1.0 + 1e-12, {"b": 2.0}]}) == ""
    assert unlike({"a": [1.0, {"b": 2.0}]}, {"a": [1.0, {"b": 2.1}]}) == "a[1].b"
    assert unlike({"a": 1}, {}) == "a"
    assert unlike([1.0], [1.0, 2.0], "a") == "a"


def test_a_sealed_answer_stays_closed(scored, monkeypatch):
    """Case 0004 is planned, but not scored: whatever its answer says is not even read."""
    (scored / "answers/0004.json").write_text("not to be read")
    read = []
    plain = opened._read
    monkeypatch.setattr(opened, "_read", lambda path, key="": (read.append(path.parent.name), plain(path, key))[1])
    with pytest.raises(InputError, match="its answer is sealed"):
        opened_case(scored, "0004")
    assert "answers" not in read
    with pytest.raises(InputError, match="no case of this check"):
        opened_case(scored, "0009")


@pytest.mark.parametrize(
    ("file", "change", "words"),
    [
        ("answers/0003.json", ("transport_delay", "sensor_lag"), "not the one that was sealed"),
        ("sets/0003/prototype.toml", ("name", "# \nname"), "not those that were sealed"),
        ("sealed.json", ('"whole": "', '"whole": "0'), "digest of the whole"),
        ("result.json", ("cases", "rows"), "not what a blind check writes"),
        ("result.json", None, "no blind check that has been scored"),
    ],
)
def test_what_was_changed_is_refused(scored, file, change, words):
    path = scored / file
    before = path.read_text()
    try:
        path.unlink() if change is None else path.write_text(before.replace(*change))
        with pytest.raises(InputError, match=words):
            opened_case(scored, "0003")
    finally:
        path.write_text(before)


def test_a_record_that_is_asked_for_is_taken_on_the_rig_of_the_case(scored, tmp_path):
    """A wave that is given drives the true rig: what it does is near what is believed, and not the same."""
    taken_up = opened_case(scored, "0003")
    before = read_dataset(scored / "sets/0003")
    first = before.records[0]
    lines = Multisine(amplitude_V=float(np.abs(first.inputs[:, 1]).max()), low_Hz=1.0, high_Hz=80.0)
    row = ScenarioRecord(
        name="next", input=(lines,), controller=first.controller, outer_end_mass_kg=first.outer_end_mass
    )
    plan = Scenario(name="asked", duration_s=2.0, sample_s=first.step, start="rest", record=(row,))
    after = taken(taken_up, plan, "load_pressure_Pa", tmp_path / "set")
    assert [r.name for r in after.records] == [*(r.name for r in before.records), "next"]
    new = after.records[-1]
    assert np.abs(new.inputs[:, 1] - inputs_of(row, plan)[: len(new.times), 1]).max() < 1e-6
    assert "load_pressure_Pa" in new.measured
    believed = Replay(new, before.prototype)
    placement = NOTHING.placement(before.prototype)
    predicted = believed.simulated(placement, np.zeros(len(placement.unknowns)), ("displacement_m",))
    assert 0.8 < np.corrcoef(predicted[:, 0], new.measured["displacement_m"])[0, 1] < 1


def test_a_check_is_halved_with_its_answers_sealed_and_its_own_sets_left(scored, tmp_path):
    """Every second record stays, and the rest of the index; a seal of its own says which data they are."""
    before = read_dataset(scored / "sets/0003")
    whole, half = half_of(scored, tmp_path / "half")
    kept = read_dataset(half.sets / "0003")
    assert [r.name for r in kept.records] == [r.name for r in before.records[1::2]]
    np.testing.assert_array_equal(
        kept.records[0].measured["displacement_m"], before.records[1].measured["displacement_m"]
    )
    assert kept.prototype == before.prototype
    assert folder_digest(whole.sets / "0003") == read_seal(whole.seal).sets["0003"]
    seal = read_seal(half.seal)
    assert seal.answers == read_seal(whole.seal).answers
    assert seal.sets == {"0003": folder_digest(half.sets / "0003")}
    assert half_of(scored, tmp_path / "half") == (whole, half)  # goes on
    (few := tmp_path / "few").mkdir()
    (few / "dataset.toml").write_text('record = [{file = "a.csv"}, {file = "b.csv"}, {file = "c.csv"}]')
    assert not halved(few, tmp_path / "none")
