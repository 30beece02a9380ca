"""What is said goes no further than what is proved: of which rigs, with which effects, of which laws and payloads."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from finished_run import finished_run
from flint import fmpq
from one_start import best_start_alone
from typer.testing import CliRunner

from beamdesign import InputError, Prototype, code, read_prototype, simulate, write_prototype
from beamdesign.build.ratings import SensorNeed
from beamdesign.build.result_folder import FILES, report_html
from beamdesign.build.specification import specification_of
from beamdesign.cli import app
from beamdesign.controllers import Lag
from beamdesign.loop import loop
from beamdesign.proofs import certifying
from beamdesign.proofs.box import BoxVerdict
from beamdesign.proofs.certificate import Row
from beamdesign.proofs.lmi import Course
from beamdesign.proofs.lyapunov import switching
from beamdesign.proofs.mass_family import stage_families
from beamdesign.proofs.multiplier import Kernel, Multiplier
from beamdesign.quantities import further_rows, start_up
from beamdesign.scenario import Scenario, ScenarioRecord, Step
from beamdesign.structure.lumped import with_figures
from beamdesign.sweep import answers
from beamdesign.sweep.case import CertifyOptions, TuneOptions
from beamdesign.synthesis import tuning
from beamdesign.synthesis.law_design import Proved, forbidden_shares
from beamdesign.synthesis.tuning import Tuning

STUDIES = Path(__file__).parents[1] / "studies"
TAME = read_prototype(STUDIES / "prototypes" / "tame_lag.toml")
MASSES = (0.0, 6.8)


def with_effects(*names: str) -> Prototype:
    return TAME.but(effects={name: {} for name in names})


def of_tame(*effects: str) -> dict[str, object]:
    """What JSON says is guaranteed of the tame lag with some effects."""
    assert TAME.controller is not None
    return Proved(TAME.controller, 2.5, 3.0, 2.0, np.zeros(0)).guaranteed(with_effects(*effects), MASSES)


def test_rest_of_a_saturated_current_names_the_effects_that_are_frozen_in_it() -> None:
    """A joint with play swings for good in a loop that comes to rest with the play frozen."""
    found = of_tame("joint_backlash", "sensor_lag", "current_saturation")
    assert (found["comes_to_rest"], found["at_rest_with_frozen"]) == (True, ["joint_backlash"])
    said = dict(further_rows(found))["while the law's current saturates"]
    assert said == "comes to rest from every state, with joint_backlash frozen"
    kick = (Step(amplitude_N=200.0, at_s=0.05, length_s=0.01),)
    rows = (ScenarioRecord(name="kick", outer_end_mass_kg=0.0, input=kick),)
    scenario = Scenario(name="kick", duration_s=2.0, sample_s=1e-3, start="rest", record=rows)
    moved = simulate(with_effects("joint_backlash"), scenario).records[0].column("displacement_m")
    assert np.ptp(moved[-500:]) > 1e-5

    plain = of_tame("sensor_lag", "current_saturation")
    assert "at_rest_with_frozen" not in plain
    assert dict(further_rows(plain))["while the law's current saturates"] == "comes to rest from every state"


def test_lower_gains_to_keep_away_from_are_said_to_be_of_the_stated_rig_and_a_grid() -> None:
    """Of a beam that is softer by less than two deviations the loop is not stable at more than the stretch told."""
    rig = read_prototype(STUDIES / "prototypes" / "structured.toml")
    ((low, high),) = forbidden_shares(rig, MASSES)
    assert "of exactly these figures and on a grid" in start_up([(low, high)])
    softer = loop(with_figures(rig, {"outer_stiffness": 0.95})).scaled(fmpq(9, 10))
    assert high < 0.7
    assert not softer.at(6.8).stable or not softer.at(0.0).stable


def test_rest_that_is_proved_of_odd_characteristics_alone_is_none_of_every_one() -> None:
    def row(coefficient: int, **more: str) -> Row:
        multiplier = Multiplier(((fmpq(coefficient, 10), Kernel(100, 1)),), fmpq(0))
        return Row(("current_saturation",), "", True, "", None, {"kind": "slope", **more, **multiplier.table()})

    assert row(3).rests
    assert not row(-3).rests
    assert not row(3, place="motor").rests
    assert not replace(row(3), proved=False).rests
    assert not Row(("valve_deadband",), "", True, "", 1e-6).rests


def test_a_tuned_prototype_that_is_undecided_between_frozen_values_is_no_yes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_prototype(with_effects("joint_backlash"), tmp_path / "p.toml")

    def tuned() -> tuple[int, dict[str, object]]:
        asked = ["tune", str(tmp_path / "p.toml"), "--nominal", "--outer-end-mass", "0:0"]
        with best_start_alone():
            done = CliRunner().invoke(app, [*asked, "--json", str(tmp_path / "t.json")])
        return done.exit_code, json.loads((tmp_path / "t.json").read_text())

    status, fields = tuned()
    assert (status, fields["stable_between"]) == (0, True)
    assert "linear members only; of small motion no stability (joint_backlash)" in str(fields["holds_for"])
    assert [one["effect"] for one in fields["near_rest"]] == ["joint_backlash"]  # type: ignore[attr-defined]

    decided = certifying.between

    def undecided(*given: object) -> BoxVerdict:
        found = decided(*given)  # type: ignore[arg-type]
        assert found is not None
        return replace(found, stable=None, reason="left open")

    for module in (certifying, tuning):
        monkeypatch.setattr(module, "between", undecided)
    status, fields = tuned()
    assert (status, fields["stable_between"]) == (1, None)


def test_laws_whose_changes_are_not_proved_are_no_yes(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = read_prototype(STUDIES / "scheduled" / "prototype.toml")
    open_changes = Course("undecided", "nothing was found")
    changes = replace(switching(stage_families(rig), *MASSES, dwell_s=0.1), stages=open_changes)
    laws = tuple(
        Tuning(stage.prototype, stage.outer_end_mass_kg, Proved(law, 1.79, 5.0, 2.0, np.zeros(0)))
        for stage, (law, _) in zip(rig.stages(MASSES), rig.own_controller.laws, strict=True)
    )
    found = Tuning(rig, MASSES, laws[0].best, laws=laws, switching=changes)
    assert (found.yes, found.status) == (False, "no")
    assert replace(found, switching=None).yes
    monkeypatch.setattr(tuning, "tune", lambda *given, **more: found)
    answer = answers.tune(rig, TuneOptions(controller="scheduled"))
    assert answer.reason == "changes between its laws are not proved: nothing was found"
    assert answer.outputs["bandwidth_Hz"] == 5.0


def test_stable_ranges_of_a_sweep_are_rounded_inwards() -> None:
    remedy = read_prototype(STUDIES / "prototypes" / "paper_remedy.toml")
    found = answers.certify(remedy.but(payload=remedy.payload.but(outer_end_mass_kg=(0.0, 20.0))), CertifyOptions())
    ((low, high),) = [[float(end) for end in one.split(" to ")] for one in found.outputs["stable_ranges_kg"]]
    crossings = found.outputs["crossings_kg"]
    assert crossings[0] <= low < crossings[0] + 1e-6
    assert crossings[1] - 1e-5 < high <= crossings[1]


def test_a_sweep_says_no_where_a_value_between_the_ends_of_what_is_frozen_is_refuted() -> None:
    """As the command does of this inner beam that a cable holds, in `test_family_certificate`."""
    rig = TAME.but(
        controller=Lag(gain_A_per_V=0.028, pole_Hz=1.52, zero_Hz=50.7),
        payload=TAME.payload.but(inner_end_mass_kg=4.02, outer_end_mass_kg=(2.07, 2.07)),
        effects={"empirical_inner_reaction_loop": {"size_N": 10480.0}},
    )
    found = answers.certify(rig, CertifyOptions())
    assert (found.outputs["stable"], found.outputs["stable_between"]) == (True, False)
    assert "between the ends" in found.reason
    easy = answers.certify(rig.but(effects={"empirical_inner_reaction_loop": {"size_N": 1.0}}), CertifyOptions())
    assert (easy.outputs["stable_between"], easy.reason) == (True, "")
    assert "stable_between" not in answers.certify(rig.but(effects={}), CertifyOptions()).outputs


def test_a_box_whose_joint_has_play_is_no_yes(tmp_path: Path) -> None:
    """As `certify` says of the stated figures: within the play of a joint nothing is proved."""
    write_prototype(with_effects("joint_backlash"), tmp_path / "p.toml")
    asked = ["certify-box", str(tmp_path / "p.toml"), "--sigmas", "0.1", "--only", "flow_gain"]
    asked += ["--outer-end-mass", "0:0.1", "--out", str(tmp_path / "b.toml"), "--json", str(tmp_path / "b.json")]
    said = []
    for more in ([], ["--linear"]):
        done = CliRunner().invoke(app, [*asked, *more])
        fields = json.loads((tmp_path / "b.json").read_text())
        said.append((done.exit_code, fields["stable"], fields["reason"], "--linear asks" in done.output))
    words = said[0][2]
    assert said == [(1, True, words, True), (0, True, "", False)]
    assert words.startswith("not proved of small motion: stability (joint_backlash")


def test_a_member_that_is_not_stable_is_printed_as_it_is(tmp_path: Path) -> None:
    """To four digits it lay outside the box that is printed beside it."""
    path = STUDIES / "prototypes" / "paper_remedy.toml"
    asked = ["certify-box", str(path), "--outer-end-mass", "0.12345678:1", "--sigmas", "0", "--out"]
    done = CliRunner().invoke(app, [*asked, str(tmp_path / "b.toml"), "--json", str(tmp_path / "b.json")])
    assert done.exit_code == 1
    member = json.loads((tmp_path / "b.json").read_text())["unstable_point"]
    (printed,) = re.findall(r"outer_end_mass_kg +\S+ +\S+ +(\S+)", done.output)
    assert float(printed) == pytest.approx(member["outer_end_mass_kg"], rel=1e-11)


def test_any_computing_time_is_refused_where_no_sampled_loop_is_worked_out() -> None:
    with pytest.raises(InputError, match=r"any_computing_time.*not worked out for a prototype with effects"):
        code(with_effects("sensor_lag"), 10_000.0, any_computing_time=True)
    assert code(with_effects("sensor_lag"), 10_000.0).proved is None


def test_a_report_says_where_each_proof_stands_and_by_what_method_it_is_proved_again() -> None:
    """Of a box it is the same method in other code; figures of the nominal rig stand in a certificate of their own."""
    page = report_html(finished_run(), {**FILES, "certificate_box": "certificate.box.toml"})
    said = " ".join(re.sub("<[^>]*>", " ", page).split())
    for name, method in (("certificate", "another method"), ("certificate.box", "the same method in code of its own")):
        assert f"beamdesign certify --replay {name}.toml" in said
        assert f"by {method}" in said
    assert "With exactly the figures stated it carries" in said


def test_a_specification_says_of_which_rigs_it_is_proved() -> None:
    found = specification_of(finished_run())
    need = SensorNeed(30.0, 2000.0, 300.0, 4.6, 2.1, 1e-4, 0.1, 1e-5, 100.0, 1e-6, 1e-5, None, None)
    assert found.to_dict()["guaranteed"]["rigs"] == "nominal"
    told = replace(found, laws=(), sensor=need).rows()
    assert ("proved", "for exactly these figures", "") in told
    # A break with which the loop is just stable is no bandwidth with which it keeps what is guaranteed.
    assert ("sensor bandwidth from which on the loop is stable", "30 Hz", "proved") in told
    assert ("that costs at most 5 % of the guarantee", "300 Hz", "proved") in told
    slow = replace(found, laws=(), sensor=replace(need, stable_from_Hz=None)).rows()
    assert ("sensor bandwidth from which on the loop is stable", "–", "none proved") in slow


def test_a_box_and_an_end_say_of_which_rigs_and_motion_they_are_proved(tmp_path: Path) -> None:
    """Of a joint with play `certify` says no; the JSON of a box said that it is stable, and no more."""
    write_prototype(with_effects("joint_backlash"), tmp_path / "p.toml")
    asked = ["certify-box", str(tmp_path / "p.toml"), "--outer-end-mass", "0:0", "--sigmas", "0.1", "--seconds", "0"]
    CliRunner().invoke(app, [*asked, "--out", str(tmp_path / "b.toml"), "--json", str(tmp_path / "b.json")])
    fields = json.loads((tmp_path / "b.json").read_text())
    assert [one["claim"] for one in fields["near_rest"]] == ["stability"]
    assert fields["holds_for"].startswith("for every rig within 0.1 standard deviations")
    assert fields["holds_for"].endswith("linear members only; of small motion no stability (joint_backlash)")

    compliant = STUDIES / "prototypes" / "compliant.toml"
    done = CliRunner().invoke(app, ["stiffness", str(compliant), "--out", str(tmp_path / "end")])
    assert "exactly these figures" in done.output
    headline = (tmp_path / "end" / "certificate.contact.toml").read_text().splitlines()[0]
    assert headline.endswith("kg, for exactly these figures.")
