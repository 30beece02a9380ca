"""`beamdesign spec`: the folder it leaves, its drawing, and the data set that comes back to the diagnosis."""

import json
import os
import re
import subprocess
import sys
from decimal import Decimal
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import ezdxf
import numpy as np
import pytest
from ezdxf import bbox, recover
from ezdxf.fonts.fonts import make_font
from typer.testing import CliRunner

from beamdesign import (
    InputError,
    Prototype,
    check,
    read_dataset,
    read_prototype,
    read_scenario,
    simulate,
    specify,
    state_space,
    write_prototype,
)
from beamdesign.build import analogue, tolerances
from beamdesign.build.acceptance import COLUMNS, acceptance_plan, as_specified, write_data_folder
from beamdesign.build.drawing import LAYERS, drawing, dxf_text, missing_geometry, svg_text
from beamdesign.build.folder import document_of
from beamdesign.cli import app
from beamdesign.controllers import Lag, Observer, Scheduled, Stage
from beamdesign.diagnosis.gap_metrics import held_out
from beamdesign.proofs.writer import prototype_table
from beamdesign.prototype import Arm, Tolerance
from beamdesign.report.page import to_markdown
from beamdesign.scenario import Measurement, inputs_of
from beamdesign.structure.lumped import with_figures

pytestmark = pytest.mark.long

PROTOTYPES = Path(__file__).parent.parent / "studies" / "prototypes"


def spec(*given: object) -> "object":
    return CliRunner().invoke(app, ["spec", *map(str, given)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The published rig with a tame lag over a range of payloads, under a name that needs escaping everywhere."""
    place = tmp_path_factory.mktemp("spec")
    found = read_prototype(PROTOTYPES / "published_lag.toml")
    rig = found.but(
        name='A <rig> & "co" | *x*',
        controller=Lag(gain_A_per_V=0.05, pole_Hz=1.7, zero_Hz=20.0),
        payload=found.payload.but(outer_end_mass_kg=(0.0, 6.8), inner_end_mass_kg=1.9),
    )
    write_prototype(rig, place / "rig.toml")
    with pytest.MonkeyPatch.context() as patch:  # `golden` has tolerances to the last per cent
        patch.setattr(tolerances, "_WITHIN", 0.2)
        patch.setattr(tolerances, "_COARSE", 0.2)
        ran = spec(place / "rig.toml", "--out", place / "out", "--json", place / "spec.json")
    assert ran.exit_code == 0, ran.output
    assert "proved" in ran.output
    return place / "out"


class Page(HTMLParser):
    """What a page is made of."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict]] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "link", "br", "rect", "path"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in ("rect", "path"):
            assert self.open.pop() == tag


def test_the_page_stands_alone(folder: Path) -> None:
    text = (folder / "specification.html").read_text()
    page = Page(text)
    assert page.open == []
    tags = [tag for tag, _ in page.tags]
    assert tags.count("svg") == 1
    assert not {"script", "img", "iframe"} & set(tags)
    for tag, given in page.tags:
        for key in ("href", "src"):
            assert given.get(key, "#").startswith(("#", "data:")), tag
    names = [given["id"] for _, given in page.tags if "id" in given]
    assert len(names) == len(set(names))
    links = [given["href"][1:] for tag, given in page.tags if tag == "a"]
    assert set(links) <= set(names)
    assert "prefers-color-scheme: dark" in text
    assert "A &lt;rig&gt; &amp;" in text
    assert "<rig>" not in text


def test_markdown_and_page_say_the_same(folder: Path) -> None:
    markdown, html = ((folder / f"specification.{kind}").read_text() for kind in ("md", "html"))
    titles = [line[3:] for line in markdown.splitlines() if line.startswith("## ")]
    assert titles == re.findall(r"<h2>(.*?)</h2>", html)
    assert titles[-2:] == ["Acceptance test", "How each figure is founded"]
    rows = [line for line in markdown.splitlines() if line.startswith("| ")]
    assert len(rows) - 1 - len(re.findall("<dt>", html)) == html.count("<tr>")
    assert all(len(re.findall(r"(?<!\\)\|", row)) >= 3 for row in rows)


def test_what_is_said_is_in_the_json(folder: Path) -> None:
    fields = json.loads((folder.parent / "spec.json").read_text())
    markdown = (folder / "specification.md").read_text()
    assert fields["certifiable"] is True
    assert fields["outer_end_mass_kg"] == [0.0, 6.8]
    assert fields["digital"]["one_period_late"]["stable"] is True
    coefficients = fields["digital"]["equation"]["coefficients"]
    assert set(coefficients) == {"follow1", "direct1", "gain"}
    for key, value in coefficients.items():
        assert f"{key} = {value!r}" in markdown
    assert len(fields["tolerances"]["figures"]) == 17
    assert fields["acceptance"][0]["outer_end_mass_kg"] == 0.0
    assert {*fields["basis"].values()} >= {"proved", "computed"}
    for path in fields["files"].values():
        assert Path(path).exists()
    assert "certificate" not in json.dumps(fields["tolerances"])


def test_every_certificate_is_proved_again(folder: Path) -> None:
    texts = [folder / "certificate.toml", folder / "tolerances.toml", folder / "delay.toml"]
    components = sorted((folder / "components").glob("*.toml"))[:2]
    rig = prototype_table(read_prototype(folder / "prototype.toml"))
    texts.append(folder / "equal_tolerances.toml")
    assert all(check(path, rig).valid for path in texts)  # not of some expression: of this very rig
    assert all(check(path).valid for path in components)
    delay = json.loads((folder.parent / "spec.json").read_text())["digital"]["delay_s"]
    assert f"{delay:g}"[:4] in texts[2].read_text() or "delay" in texts[2].read_text()


def test_the_drawing_measures_the_prototype(folder: Path) -> None:
    """Read again by ezdxf: no errors, millimetres, and dimensions that measure what the prototype states."""
    document, auditor = recover.readfile(folder / "drawing.dxf")
    assert not auditor.has_errors
    assert document.units == ezdxf.units.MM
    assert set(LAYERS) <= {layer.dxf.name for layer in document.layers}
    space = document.modelspace()
    measured = sorted(round(entity.get_measurement(), 4) for entity in space.query("DIMENSION"))
    # Cut twice, clamped and free, widths, walls, and the gap (140 - 2 * 2.3 - 100) / 2 by hand.
    assert measured == sorted([1500, 1500, 305, 135, 1195, 1365, 140, 100, 2.3, 3.2, 17.7])
    for layer, width, wall in (("OUTER_TUBE", 140.0, 2.3), ("INNER_TUBE", 100.0, 3.2)):
        lines = [np.array(line.get_points("xy")) for line in space.query(f'LWPOLYLINE[layer=="{layer}"]')]
        assert len(lines) == 4  # two walls lengthwise, outside and inside across
        sizes = sorted(np.ptp(line, axis=0).tolist() for line in lines)
        assert sizes[0] == pytest.approx([width - 2 * wall] * 2)
        assert sizes[1] == pytest.approx([width] * 2)
        assert sizes[2] == pytest.approx([1500.0, wall])


@pytest.mark.parametrize("clamped", [0.09, 0.135, 0.3])
def test_no_line_of_the_drawing_runs_through_a_dimension(clamped: float) -> None:
    """Words as wide as ezdxf's font has them, against every upright line of every dimension."""
    rig = read_prototype(PROTOTYPES / "published_lag.toml")
    rig = rig.but(
        outer_beam=rig.outer_beam.but(free_length_m=1.5 - clamped),
        inner_beam=rig.inner_beam.but(free_length_m=1.5 - clamped),
    )
    drawn = [entity for one in drawing(rig).modelspace().query("DIMENSION") for entity in one.virtual_entities()]
    lines = [(one.dxf.start, one.dxf.end) for one in drawn if one.dxftype() == "LINE"]
    lines += [(one.dxf.start, one.dxf.end) for one in drawing(rig).modelspace().query('LINE[layer=="CENTRE"]')]
    upright = [(start.x, *sorted((start.y, end.y))) for start, end in lines if abs(start.x - end.x) < 1e-6]
    words = [one for one in drawn if one.dxftype() == "MTEXT"]
    assert (len(words), {one.dxf.attachment_point for one in words}) == (11, {5})  # each about its middle
    assert len(upright) >= 20
    for one in words:
        high, (x, y, _) = one.dxf.char_height, one.dxf.insert
        wide = make_font("DejaVuSans.ttf", high).text_width(one.text)
        crossing = [
            at for at, low, top in upright if abs(at - x) < wide / 2 and low < y + high / 2 and top > y - high / 2
        ]
        assert crossing == [], one.text


def test_rounded_corners_keep_the_width() -> None:
    """A tube of corner radius r: its outline's bulges turn by a quarter circle of that radius."""
    rig = read_prototype(PROTOTYPES / "published_lag.toml")
    rig = rig.but(outer_beam=rig.outer_beam.but(corner_radius_m=0.008))
    space = drawing(rig).modelspace()
    assert any("140 × 140 × 2.3 mm, corners R 8 mm" in one.dxf.text for one in space.query("TEXT"))
    rounded = [line for line in space.query('LWPOLYLINE[layer=="OUTER_TUBE"]') if len(line) == 8]
    assert len(rounded) == 2
    points = np.array(rounded[0].get_points("xyb"))
    assert np.ptp(points[:, :2], axis=0) == pytest.approx([140.0, 140.0])
    for k in range(8):
        chord = np.hypot(*(points[(k + 1) % 8, :2] - points[k, :2]))
        if points[k, 2]:
            radius = chord * (1 + points[k, 2] ** 2) / (4 * points[k, 2])
            assert radius == pytest.approx(8.0)


def test_a_drawing_tells_the_gap_at_corners_in_a_round_tube_from_that_at_the_middle_of_a_side() -> None:
    """In a bore of 154 mm a square of 100 mm has (154 - 100) / 2 at its sides, and 77 - 50 sqrt(2) at its corners."""
    rig = read_prototype(PROTOTYPES / "published_lag.toml")
    round_tube = rig.outer_beam.but(shape="round", width_m=0.16, wall_m=0.003)
    space = drawing(rig.but(outer_beam=round_tube, inner_beam=rig.inner_beam.but(wall_m=0.003))).modelspace()
    (side,) = [one for one in space.query("DIMENSION") if one.dxf.text.startswith("gap")]
    assert side.dxf.text == "gap at mid-side <>"
    assert side.get_measurement() == pytest.approx(27.0)
    (note,) = [one.dxf.text for one in space.query("TEXT") if "Gap" in one.dxf.text]
    assert f"Gap per side at assembly {77 - 50 * 2**0.5:.4g} at the corners." in note


def test_lumped_figures_give_no_drawing(paper, tmp_path: Path) -> None:
    assert "outer_beam.width_m" in missing_geometry(paper)
    with pytest.raises(ValueError, match="lumped figures only"):
        drawing(paper)


def test_a_tube_of_unknown_cut_length_is_not_dimensioned_there() -> None:
    rig = read_prototype(PROTOTYPES / "published_lag.toml")
    rig = rig.but(inner_beam=rig.inner_beam.but(length_m=None))
    document = drawing(rig)
    assert dxf_text(document)
    measured = sorted(round(entity.get_measurement(), 4) for entity in document.modelspace().query("DIMENSION"))
    assert measured == sorted([1500, 305, 1195, 1365, 140, 100, 2.3, 3.2, 17.7])


def test_a_rig_with_the_geometry_of_one_beam_is_not_called_lumped(paper) -> None:
    half = read_prototype(PROTOTYPES / "tame_lag.toml").but(inner_beam=paper.inner_beam)
    assert missing_geometry(half).startswith("the prototype gives the geometry of one beam only; missing")


def test_one_prototype_gives_the_same_bytes_of_its_drawing() -> None:
    published = read_prototype(PROTOTYPES / "published_lag.toml")
    one, other = (drawing(published) for _ in range(2))
    assert dxf_text(one) == dxf_text(other)
    assert svg_text(one, "") == svg_text(other, "")


@pytest.mark.parametrize("length_m", [0.2, 1.0, 5.0])
def test_the_picture_of_a_drawing_is_as_high_as_the_drawing_is(length_m: float) -> None:
    """By the extents that ezdxf finds in model space; of a link of 5 m the picture was half as high again as wide."""
    sizes = {"free_length_m": length_m, "length_m": length_m + 0.1}
    rig = read_prototype(PROTOTYPES / "paper_remedy.toml")
    document = drawing(rig.but(outer_beam=rig.outer_beam.but(**sizes), inner_beam=rig.inner_beam.but(**sizes)))
    view = ElementTree.fromstring(svg_text(document, "")).get("viewBox", "").split()
    width, height, _ = bbox.extents(document.modelspace()).size
    assert float(view[3]) / float(view[2]) == pytest.approx(height / width, abs=0.04)


def test_what_is_unstable_is_not_specified(tmp_path: Path) -> None:
    """The paper's remedy, unstable below 1.968 kg."""
    ran = spec(PROTOTYPES / "paper_remedy.toml", "--out", tmp_path, "--json", tmp_path / "spec.json")
    assert ran.exit_code == 1, ran.output
    assert "not certifiable from 0 to 6.8 kg: unstable from 0 to 1.968" in ran.output
    fields = json.loads((tmp_path / "spec.json").read_text())
    assert fields["certifiable"] is False
    assert fields["drawing"] == fields["reason"]  # there is none
    assert fields["stable_ranges_kg"][0] == pytest.approx([1.968442, 6.8], abs=1e-5)
    assert "Nothing is specified" in (tmp_path / "specification.md").read_text()
    assert not (tmp_path / "acceptance").exists()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("--sampling-rate-Hz", "40"), "upper break, 26 Hz"),
        (("--sampling-rate-Hz", "nan"), "--sampling-rate-Hz"),
        (("--load-N", "-1"), "--load-N"),
        (("--outer-end-mass", "3:1"), "empty range"),
    ],
)
def test_bad_input_is_named(given: tuple[str, str], said: str, tmp_path: Path) -> None:
    ran = spec(PROTOTYPES / "published_lag.toml", "--out", tmp_path / "out", *given)
    assert isinstance(ran.exception, InputError)
    assert said in str(ran.exception)
    assert not (tmp_path / "out").exists()


def test_an_empty_data_set_says_that_records_are_missing(folder: Path) -> None:
    ran = CliRunner().invoke(app, ["gap", "diagnose", str(folder / "acceptance")])
    assert isinstance(ran.exception, InputError)
    assert (
        "light_force.csv: (file): holds no rows below the column names; fill it in, or leave out what names it"
        in str(ran.exception)
    )


def test_excitations_are_those_of_the_plan(folder: Path) -> None:
    scenario = read_scenario(folder / "acceptance" / "scenario.toml")
    assert {row.outer_end_mass_kg for row in scenario.record} == {0.0, 6.8}
    for row in scenario.record:
        table = np.loadtxt(folder / "acceptance" / "excitation" / f"{row.name}.csv", delimiter=",", skiprows=1)
        assert table[:, 0] == pytest.approx(scenario.times, abs=1e-9)
        assert table[:, 1:] == pytest.approx(inputs_of(row, scenario), abs=2e-3)
        header = (folder / "acceptance" / "records" / f"{row.name}.csv").read_text()
        assert header == ",".join(COLUMNS) + "\n"


def test_excitations_of_a_quick_rig_have_the_times_of_its_shorter_samples(tmp_path: Path) -> None:
    rig = with_figures(
        read_prototype(PROTOTYPES / "tame_lag.toml"), dict.fromkeys(("outer_stiffness", "inner_stiffness"), 64.0)
    )  # eight times as quick, by sqrt(K / M), so that of 0.5 ms 62.5 us are left
    write_data_folder(rig, acceptance_plan(rig, (0.0, 6.8), duration_s=0.05), tmp_path)
    table = np.loadtxt(tmp_path / "excitation" / "light_force.csv", delimiter=",", skiprows=1)
    assert table[:, 0] == pytest.approx(62.5e-6 * np.arange(len(table)), abs=1e-12)


def test_a_light_rig_has_a_second_payload_as_the_rig_that_it_is_a_model_of() -> None:
    """With all forces, masses and flows 256 times less it moves as that one does under 256 times less payload."""
    rig = read_prototype(PROTOTYPES / "tame_lag.toml")
    bare = (getattr(rig, f"{beam}_beam").but(width_m=None, wall_m=None) for beam in ("outer", "inner"))
    rig = rig.but(**dict(zip(("outer_beam", "inner_beam"), bare, strict=True)))  # a tube's own weight does not scale
    of_beams = (f"{beam}_{figure}" for beam in ("outer", "inner") for figure in ("stiffness", "mass", "damping"))
    less = (*of_beams, "piston_area", "oil_stiffness", "flow_gain", "leakage", "inner_end_mass")
    light = with_figures(rig, dict.fromkeys(less, 1 / 256))
    masses = acceptance_plan(rig, (2.0, 2.0)).masses_kg
    assert len(masses) == 2
    as_light = acceptance_plan(light, (2 / 256, 2 / 256)).masses_kg
    assert as_light == pytest.approx([mass / 256 for mass in masses], rel=0.02)  # of two digits


def test_what_a_law_senses_beside_the_displacement_is_to_be_recorded(folder: Path, tmp_path: Path) -> None:
    law = Observer.of(0.05, ("displacement_m", "load_pressure_Pa"), [[-10.0]], [[9.0, 0.0]], [1.0], [0.1, 1e-9])
    rig = read_prototype(folder / "prototype.toml").but(controller=law)
    write_data_folder(rig, acceptance_plan(rig, (0.0, 6.8), duration_s=0.5), tmp_path)
    for path in (tmp_path / "records").iterdir():
        assert path.read_text() == ",".join((*COLUMNS, "load_pressure_Pa")) + "\n"


@pytest.mark.usefixtures("no_pictures")
def test_the_folder_filled_in_is_diagnosed(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A rig with a sensor lag that nobody told of, recorded as the plan says, goes to the diagnosis as it is."""
    from beamdesign.diagnosis import diagnose as diagnosing
    from beamdesign.diagnosis import separability
    from beamdesign.diagnosis.fitting import search as searching
    from beamdesign.diagnosis.fitting.hypothesis import Hypothesis

    rig = read_prototype(folder / "acceptance" / "prototype.toml")
    plan = acceptance_plan(rig, (0.0, 6.8), duration_s=0.5)
    data = tmp_path / "acceptance"
    write_data_folder(rig, plan, data)
    noise = Measurement(seed=3, disturbance_std_N=0.05, current_std_A=1e-6, displacement_std_m=5e-8)
    built = rig.but(effects={"sensor_lag": {"break_Hz": 300.0}})
    for record in simulate(built, read_scenario(data / "scenario.toml").but(measurement=noise)).records:
        assert record.stable, record.reason
        with (data / "records" / f"{record.name}.csv").open("a") as file:
            np.savetxt(file, np.column_stack([record.column(name) for name in COLUMNS]), fmt="%.9g", delimiter=",")
    write_data_folder(rig, plan, data)  # once more: what was recorded stays
    found = read_dataset(data)
    assert not found.warnings
    assert {record.outer_end_mass for record in found.records} == {0.0, 6.8}
    assert held_out(found.records)
    few = tuple(Hypothesis((name,)) for name in ("sensor_lag", "valve_deadband"))
    for room in (searching, separability):
        monkeypatch.setattr(room, "singles", lambda prototype: few)
    monkeypatch.setattr(diagnosing, "next_experiment", lambda *given: None)
    ran = CliRunner().invoke(
        app,
        [
            "gap",
            "diagnose",
            str(data),
            "--out",
            str(tmp_path / "out"),
            "--workers",
            "1",
            "--json",
            str(tmp_path / "d.json"),
        ],
    )
    assert ran.exit_code == 0, ran.output
    diagnosis = json.loads((tmp_path / "d.json").read_text())
    assert diagnosis["chosen"] == ["sensor_lag"]
    assert diagnosis["effects"][0]["parameters"]["break_Hz"]["value"] == pytest.approx(300.0, rel=0.05)


def test_what_was_measured_keeps_the_law_that_it_was_measured_with(tmp_path: Path) -> None:
    rig = read_prototype(PROTOTYPES / "tame_lag.toml")
    faster = rig.but(controller=Lag(gain_A_per_V=0.055, pole_Hz=1.7, zero_Hz=20.0))
    gain = "\n[[critical_gain]]\nouter_end_mass_kg = 0.0\ngain_A_per_V = 0.3\nrelative_std = 0.03\n"
    for name, measured in (("dataset.toml", gain), ("records/light_force.csv", "0,0,0,0,0\n"), ("nothing", "")):
        data = tmp_path / name.partition("/")[0]
        write_data_folder(rig, acceptance_plan(rig, (0.0, 6.8), duration_s=0.5), data)
        with (data / name).open("a") as file:
            file.write(measured)
        before = (data / "dataset.toml").read_text()
        write_data_folder(faster, acceptance_plan(faster, (0.0, 6.8), duration_s=0.5), data)
        assert ((data / "dataset.toml").read_text() == before) == bool(measured)


def test_a_specified_tolerance_is_told_as_it_is_and_on_one_line_of_the_page(folder: Path) -> None:
    """0.0068 is 0.68 %, though a hundredth of it in floats is less; the page breaks nothing between sign and unit."""
    figures = json.loads((folder / "specification.json").read_text())["tolerances"]["figures"]
    lines = (folder / "specification.md").read_text().splitlines()
    page = (folder / "specification.html").read_text()
    rows = [line.split(" | ") for line in lines if " | ± " in line]
    for one, row in zip(figures, rows, strict=True):
        percent = f"{Decimal(repr(one['specified'])) * 100:f}".rstrip("0").rstrip(".")
        assert row[4] == f"± {percent} %"
        assert f"±\u00a0{percent}\u00a0%" in page


def test_tolerances_that_are_stated_stay(folder: Path) -> None:
    rig = read_prototype(folder / "prototype.toml")
    stated = rig.but(tolerance=rig.tolerance.but(stiffness=0.02))
    assert as_specified(stated, {"oil_stiffness": 0.1}).tolerance == stated.tolerance
    taken = as_specified(rig, {"outer_stiffness": 0.01, "inner_stiffness": 0.03, "controller_gain": 0.1}).tolerance
    assert taken.stiffness == pytest.approx(0.03 / np.sqrt(3), rel=0.05)
    assert taken.oil_stiffness == 0
    weighed = rig.but(tolerance=rig.tolerance.but(outer_end_mass=0.01))
    taken = as_specified(weighed, {"oil_stiffness": 0.1}).tolerance
    assert taken.oil_stiffness == pytest.approx(0.1 / np.sqrt(3), rel=0.05)
    assert taken.outer_end_mass == 0.01


def test_an_arm_is_accepted_with_its_payload_on_the_axis_as_is_expected_of_it() -> None:
    """In its plane a payload 0.1 m beyond the tip would move the tip by other than what is expected."""
    rig = read_prototype(PROTOTYPES / "tame_lag.toml").but(arm=Arm(offset_m=(0.1, 0.0, 0.0), plane="z"))
    plan = acceptance_plan(rig, (0.0, 6.8), duration_s=0.5)
    heavy = plan.scenario.but(record=tuple(row for row in plan.scenario.record if row.name == "heavy_force"))
    of_axis, taken, aside = (
        simulate(one, heavy).records[0].column("displacement_m")
        for one in (rig.but(arm=None), as_specified(rig, {}), rig)
    )
    np.testing.assert_allclose(taken, of_axis, rtol=1e-9, atol=1e-15)
    assert np.abs(aside - of_axis).max() > 0.02 * np.abs(of_axis).max()


def test_a_drawing_is_the_same_bytes_in_every_process() -> None:
    """Sets of text are in another order in each, unless their hashes are told."""
    code = (
        "import sys; from beamdesign.prototype import read_prototype;"
        "from beamdesign.build.drawing import drawing, dxf_text;"
        "sys.stdout.write(dxf_text(drawing(read_prototype(sys.argv[1]))))"
    )
    command = [sys.executable, "-c", code, str(PROTOTYPES / "tame_lag.toml")]
    texts = {
        subprocess.run(command, env=os.environ | {"PYTHONHASHSEED": seed}, capture_output=True, check=True).stdout
        for seed in ("1", "4")
    }
    assert len(texts) == 1


GAINS = (0.05, 0.04)


def two_laws() -> Prototype:
    rig = read_prototype(PROTOTYPES / "tame_lag.toml")
    payload = rig.payload.but(outer_end_mass_kg=(1.0, 3.0))
    both = tuple(
        Stage(outer_end_mass_kg=masses, gain_A_per_V=gain, pole_Hz=1.7, zero_Hz=20.0)
        for gain, masses in zip(GAINS, ((1.0, 2.6), (1.7, 3.0)), strict=True)
    )
    return rig.but(controller=Scheduled(stage=both), payload=payload, tolerance=Tolerance())


def test_a_schedule_with_effects_is_specified_and_says_that_changes_are_not_proved(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(analogue, "SERIES", ())
    monkeypatch.setattr(tolerances, "toleranced_figures", lambda prototype: ("flow_gain",))
    found = specify(two_laws().but(effects={"sensor_lag": {"break_Hz": 900.0}}), (1.0, 1.5))
    assert found.yes
    assert found.switching is None
    assert ("changes between the laws", "not covered by any proof", "the prototype has effects") in found.rows()
    text = to_markdown(document_of(found))
    assert "No proof covers changes of stage" in text
    assert "is proved of changes" not in text


def test_a_schedule_whose_period_is_too_long_for_a_law_is_a_no_that_names_a_shorter_one() -> None:
    """At 500 Hz with a period's delay both laws go unstable, which is found before anything takes long."""
    rig = two_laws()
    assert rig.schedule is not None
    slow = specify(rig.but(controller=rig.schedule.but(period_s=2e-3)), (1.0, 3.0))
    assert not slow.yes
    assert "the code of stage 1, sampled at 500 Hz with its current one period late, is not stable" in slow.reason
    assert "as every 0.0002 s (controller.period_s)" in slow.reason
    assert slow.rows() == []


def test_the_payloads_of_a_schedule_are_those_of_its_laws_where_the_prototype_states_none(tmp_path: Path) -> None:
    rig = two_laws()
    assert rig.schedule is not None
    slow = rig.schedule.but(period_s=2e-3)  # which is a no before anything takes long
    write_prototype(rig.but(controller=slow, payload=rig.payload.but(outer_end_mass_kg=None)), tmp_path / "rig.toml")
    ran = spec(tmp_path / "rig.toml", "--out", tmp_path / "out")
    assert ran.exit_code == 1
    assert "stage 1, sampled at 500 Hz" in ran.output
    assert json.loads((tmp_path / "out" / "specification.json").read_text())["outer_end_mass_kg"] == [1.0, 3.0]


def test_an_inner_beam_that_sags_through_the_whole_stroke_is_told() -> None:
    rig = read_prototype(PROTOTYPES / "tame_lag.toml")
    short = rig.but(actuator=rig.actuator.but(stroke_m=1e-4))
    with pytest.raises(InputError, match=r"inner_beam: sags by .* mm by itself, which leaves no stroke"):
        acceptance_plan(short, (0.0, 6.8))


@pytest.fixture(scope="module")
def stages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The specification of two laws, with one series of components and one figure that has a tolerance."""
    place = tmp_path_factory.mktemp("stages")
    write_prototype(two_laws(), place / "rig.toml")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(analogue, "SERIES", (("E96", "E6"),))
        patch.setattr(analogue, "RESISTORS", (0.01,))
        patch.setattr(tolerances, "toleranced_figures", lambda prototype: ("flow_gain",))
        ran = spec(place / "rig.toml", "--out", place / "out")
    assert ran.exit_code == 0, ran.output
    return place / "out"


def test_every_law_of_a_schedule_is_specified_over_its_own_payloads(stages: Path) -> None:
    fields = json.loads((stages / "specification.json").read_text())
    assert [law["outer_end_mass_kg"] for law in fields["stages"]] == [[1.0, 2.6], [1.7, 3.0]]
    for gain, law in zip(GAINS, fields["stages"], strict=True):
        realised = law["analogue"][0]
        assert realised["stable"]
        assert {one["verdict"] for one in realised["tolerances"]} == {"proved"}
        assert realised["controller"]["gain_A_per_V"] == pytest.approx(gain, rel=0.05)
        assert law["digital"]["equation"]["coefficients"]["gain"] == gain
        assert 1 / law["digital"]["delay_s"] == pytest.approx(2000 / 1.5)  # as the schedule samples
        assert law["digital"]["one_period_late"]["stable"]
    reached = [law["guaranteed"]["bandwidth_Hz"] for law in fields["stages"]]
    assert fields["guaranteed"]["bandwidth_Hz"] == min(reached)
    assert reached[1] < reached[0]  # of the smaller gain
    for path in (
        *stages.glob("*.stage_?.toml"),
        *(stages / "components").glob("*"),
        stages / "stages.certificate.toml",
    ):
        assert check(path).valid, path.name
    for number in (1, 2):
        believed_rig = read_prototype(stages / f"acceptance.stage_{number}" / "prototype.toml")
        assert believed_rig.controller is not None
        assert believed_rig.controller.gain_A_per_V == GAINS[number - 1]


def test_the_rule_of_the_switch_and_what_is_proved_of_it_are_told(stages: Path) -> None:
    text = (stages / "specification.md").read_text()
    rows = [line.split("|")[1:-1] for line in text.split("## Changes of stage")[1].splitlines()[4:6]]
    assert [[cell.strip() for cell in row[2:]] for row in rows] == [["any", "2.2 kg"], ["2.1 kg", "any"]]
    fields = json.loads((stages / "specification.json").read_text())["switching"]
    assert fields["stable"]
    assert fields["stage_change"]["status"] == "proved"
    titles = re.findall(r"^## (.*)", text, re.MULTILINE)
    assert {"Digital controller, stage 1", "Digital controller, stage 2", "Tolerances"} <= set(titles)
    Page((stages / "specification.html").read_text())


def test_a_tolerance_is_what_the_loop_bears_with_either_law(stages: Path) -> None:
    """By python-control's eigenvalues."""
    (row,) = json.loads((stages / "specification.json").read_text())["tolerances"]["figures"]
    assert row["specified"] > 0.05
    for law, masses, _ in read_prototype(stages / "prototype.toml").stages((1.0, 3.0)):
        for side in (-1, 1):
            member = with_figures(law, {"flow_gain": 1 + side * row["alone"]})
            assert all(state_space(member, mass).poles().real.max() < 0 for mass in np.linspace(*masses, 9))
