"""The commands run, codesign, front and remedies as a user calls them, on the templates, at small size."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_codesign import violations
from test_figures import cut_off
from typer.testing import CliRunner

from beamdesign import check, read_problem, read_prototype
from beamdesign.cli import app
from beamdesign.controllers import Lag
from beamdesign.report.canvas import new_figure
from beamdesign.report.charts import plot_remedies, read_trade
from beamdesign.structure.section import Tube
from beamdesign.synthesis import codesign as front_room
from beamdesign.synthesis import remedies
from beamdesign.synthesis.checks import Check
from beamdesign.synthesis.codesign import Codesign, CodesignPoint
from beamdesign.synthesis.law_design import Proved
from beamdesign.synthesis.remedies import Remedy
from beamdesign.templates import start

PAYLOAD = (0.0, 6.8)


def call(folder: Path, *arguments: str, status: int = 0) -> tuple[dict[str, Any], str]:
    """Fields of the JSON that a command writes, and what it prints."""
    answer = folder / "answer.json"
    done = CliRunner().invoke(app, [*arguments, "--json", str(answer)])
    assert done.exit_code == status, done.output + str(done.exception)
    return json.loads(answer.read_text()), done.output


@pytest.mark.usefixtures("one_start")
def test_run_carries_the_template_of_a_study_to_a_certified_prototype(tmp_path: Path) -> None:
    (study,) = start("study", tmp_path / "link.toml")
    fields, said = call(tmp_path, "run", str(study), "--nominal", "--out", str(tmp_path / "out"))
    assert {"prototype", "certificate", "mass_kg", "report"} <= set(fields)
    prototype = read_prototype(fields["prototype"])
    assert prototype.guarantee is not None
    assert violations(prototype, PAYLOAD, prototype.guarantee.bandwidth_Hz, prototype.guarantee.peak_sensitivity) == []
    assert check(Path(fields["certificate"])).valid
    assert "<svg" in Path(fields["report"]).read_text(encoding="utf-8")
    assert fields["mass_kg"] == pytest.approx(fields["beam_mass_kg"] + prototype.payload.inner_end_mass_kg)
    assert f"{fields['mass_kg']:.3f} kg" in said


def test_run_that_finds_no_design_says_why_and_leaves_no_folder(tmp_path: Path) -> None:
    (study,) = start("study", tmp_path / "link.toml")
    study.write_text(study.read_text().replace("tip_force_N = 2000.0", "tip_force_N = 2e6"))
    asked = "--nominal", "--outer-end-mass", "0:400"  # which counts in place of the study's own
    fields, said = call(tmp_path, "run", str(study), *asked, "--out", str(tmp_path / "out"), status=1)
    assert fields["prototype"] is None
    assert "\nno design: " in said
    assert fields["reason"] in said
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("one_start")
def test_codesign_and_front_of_the_template_are_proved_and_agree(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (study,) = start("codesign", tmp_path / "link.toml")
    asked = ["--nominal", "--outer-end-mass", "0:1", "--bandwidth-Hz", "3.8", "--out", str(tmp_path / "one")]
    fields, _ = call(tmp_path, "codesign", str(study), *asked)
    assert {"prototype", "moving_mass_kg", "beam_mass_kg", "inner_end_mass_kg", "guaranteed"} <= set(fields)
    assert fields["guaranteed"]["bandwidth_Hz"] >= 3.8
    assert fields["moving_mass_kg"] == pytest.approx(fields["beam_mass_kg"] + fields["inner_end_mass_kg"])
    assert violations(read_prototype(fields["prototype"]), (0.0, 1.0), 3.8, 2.0) == []
    # The published tubes with 4.5 kg inside move 14.65 kg for that bandwidth.
    assert fields["moving_mass_kg"] < 14.65

    out = tmp_path / "front"
    # What the first command found is not searched for again; and 400 Hz stand for what cannot be had.
    problem = read_problem(study)
    held = CodesignPoint(
        outer=Tube(**fields["outer"]),
        inner=Tube(**fields["inner"]),
        beam_mass_kg=fields["beam_mass_kg"],
        checks=(Check(fields["governing"], 1.0, 1.0, "1"),),
        prototype=read_prototype(fields["prototype"]),
        proved=Proved(Lag(**fields["controller"]), fields["inner_end_mass_kg"], 3.8, 2.0, np.zeros(0)),
    )
    known = {3.8: Codesign(3.8, PAYLOAD, held, ()), 400.0: Codesign(400.0, PAYLOAD, None, (), "400 Hz are too many")}
    monkeypatch.setattr(front_room, "codesign", lambda asked, masses, bandwidth_Hz, *rest, **more: known[bandwidth_Hz])
    assert problem.payload.outer_end_mass_kg == PAYLOAD
    front, said = call(tmp_path, "front", str(study), "--nominal", "--bandwidths-Hz", "3.8,400", "--out", str(out))
    near, far = front["points"]
    assert near["proved"] is True
    assert near["moving_mass_kg"] == pytest.approx(fields["moving_mass_kg"], rel=1e-12)
    assert far["proved"] is False
    assert "400 Hz" in far["reason"]
    assert [row["bandwidth_asked_Hz"] for row in front["efficient"]] == [3.8]
    assert {path.name for path in out.iterdir()} == {"front.csv", "front.png", "front.svg"}
    assert str(out / "front.csv") in said
    assert "proved for exactly these figures" in said
    assert [point.sigmas for point in read_trade(out)] == [0.0]


@pytest.mark.usefixtures("one_start")
def test_remedies_are_compared_on_the_template(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remedies, "SCHEDULE_PARTS", 2)
    monkeypatch.setattr(remedies, "FREEDOMS", (remedies.UNTOUCHED, remedies.FREEDOMS[3]))
    (study,) = start("codesign", tmp_path / "link.toml")
    # Without its end mass the rig is softer at its resonance than with the servo off.
    text = study.read_text().replace("peak_over_passive = 1.0", "peak_over_passive = inf")
    assert "outer_end_mass_kg = [0.0, 6.8]" in text
    study.write_text(text.replace("outer_end_mass_kg = [0.0, 6.8]", "outer_end_mass_kg = [0.0, 1.0]"))
    out = tmp_path / "out"
    fields, _ = call(tmp_path, "remedies", str(study), "--nominal", "--out", str(out))
    untouched, phase, scheduled = fields["remedies"]
    # Of a range within that of the template, for which `test_study_shipped.py` finds 0.817 Hz.
    assert untouched["bandwidth_Hz"] > 0.81
    assert phase["bandwidth_Hz"] > untouched["bandwidth_Hz"]
    assert scheduled["bandwidth_Hz"] >= phase["bandwidth_Hz"]  # what is proved of the whole range holds on its parts
    assert len(scheduled["controllers"].split("; ")) == 2
    assert {path.name for path in out.iterdir()} == {"remedies.csv", "remedies.png", "remedies.svg"}


def test_remedies_of_which_none_is_proved_are_a_no(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (study,) = start("codesign", tmp_path / "link.toml")
    tube = Tube(0.14, 0.0023)
    failed = Remedy("stiffer outer beam", 0.0, 0.0, 2.0, tube, tube, 0.0, (), (PAYLOAD,), "no gain")
    proved = replace(failed, name="more phase from the controller", bandwidth_Hz=3.0, reason="")
    for found, status in (((failed, failed), 1), ((failed, proved), 0)):
        monkeypatch.setattr(remedies, "remedies", lambda *_, given=found: given)
        fields, said = call(tmp_path, "remedies", str(study), "--out", str(tmp_path / "out"), status=status)
        assert fields["sigmas"] == 2.0
        assert "is not taken" not in said
        assert "for every rig within 2 standard deviations" in " ".join(said.split())


def test_what_remedies_do_not_take_of_a_study_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sections of stock sizes and a law of another kind were asked for, and others came without a word."""
    tube = Tube(0.14, 0.0023)
    failed = Remedy("stiffer outer beam", 0.0, 0.0, 2.0, tube, tube, 0.0, (), (PAYLOAD,), "no gain")
    monkeypatch.setattr(remedies, "remedies", lambda *_: (failed,))
    (study,) = start("codesign", tmp_path / "link.toml")
    text = study.read_text(encoding="utf-8")
    other = text.replace('choose = "free"', 'choose = "stock"').replace('kind = "lag"', 'kind = "lqg"')
    study.write_text(other, encoding="utf-8")
    _, said = call(tmp_path, "remedies", str(study), "--out", str(tmp_path / "out"), status=1)
    for key in ("sections.choose = 'stock'", "controller.kind = 'lqg'"):
        assert f"{key} is not taken" in " ".join(said.split())


def test_a_lag_scheduled_on_the_payload_is_told_to_be_proved_of_payloads_that_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tube, lag = Tube(0.14, 0.0023), Lag(gain_A_per_V=0.1, pole_Hz=1.0, zero_Hz=30.0)
    proved = (Proved(lag, 0.0, 3.0, 2.0, np.zeros(0)),)
    fixed = Remedy("controller with more phase", 0.0, 3.0, 2.0, tube, tube, 0.0, proved, ((0.0, 6.8),))
    scheduled = replace(fixed, name="lag scheduled on the payload", proved=2 * proved, parts_kg=((0, 4), (3, 6.8)))
    (study,) = start("codesign", tmp_path / "link.toml")
    for found, told in ((scheduled, 1), (replace(scheduled, reason="no gain"), 0)):
        monkeypatch.setattr(remedies, "remedies", lambda *_, found=found: (fixed, found))
        _, said = call(tmp_path, "remedies", str(study), "--out", str(tmp_path / "out"))
        assert " ".join(said.split()).count("while these stay; no change between them") == told


def test_remedies_without_given_sections_are_refused(tmp_path: Path) -> None:
    (study,) = start("study", tmp_path / "link.toml")
    done = CliRunner().invoke(app, ["remedies", str(study), "--out", str(tmp_path / "out")])
    assert "start from given sections: width_m and wall_m are needed" in str(done.exception)


@pytest.mark.parametrize("bandwidth", [0.2, 6.2, 123.456])
def test_labels_in_the_picture_of_the_remedies_lie_within_its_frame(bandwidth: float) -> None:
    proved = Proved(Lag(gain_A_per_V=0.1, pole_Hz=1.0, zero_Hz=30.0), 0.0, bandwidth, 2.0, np.zeros(0))
    tube = Tube(0.14, 0.0023)
    best = Remedy("heavier or softer inner beam", 4.5, bandwidth, 2.0, tube, tube, 4.5, (proved,), (PAYLOAD,))
    found = [best, replace(best, name="none", bandwidth_Hz=0.0, reason="no gain")]
    axes = plot_remedies(new_figure(height_mm=80).add_subplot(), found)
    assert cut_off(axes.figure) == []
    axes.figure.draw_without_rendering()
    frame = axes.get_window_extent()
    labels = [text for text in axes.texts if re.search("Hz|proved", text.get_text())]
    assert len(labels) == 2
    for text in labels:
        box = text.get_window_extent()
        assert frame.x0 < box.x0 < box.x1 < frame.x1
