"""Pictures and page of simulated records: what is on them, for stable and for diverging loops."""

import json
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from honest_certificates import screw
from typer.testing import CliRunner

from beamdesign import Prototype, read_prototype, write_prototype
from beamdesign.cli import app
from beamdesign.report.charts import plot_record, write_record_page
from beamdesign.simulation import SimulatedRecord

STUDIES = Path(__file__).parent.parent / "studies"
KICK = str(STUDIES / "scenarios" / "kick.toml")


def record(**changes) -> SimulatedRecord:
    times = np.arange(10_001) * 1e-4
    wave = np.sin(2 * np.pi * 300 * times)
    columns = {
        "t_s": times,
        "disturbance_N": np.zeros_like(times),
        "command_V": 0.2 * wave,
        "current_A": 0.009 * wave,
        "displacement_m": 5e-5 * wave * times,
        "load_pressure_Pa": 2e6 * wave,
        "inner_displacement_m": 1e-3 * wave,
    }
    return SimulatedRecord(
        "one", np.column_stack(list(columns.values())), columns=tuple(columns), **({"stable": True} | changes)
    )


def labels(figure) -> list[str]:
    return [axes.get_ylabel() for axes in figure.axes]


def test_panels_carry_units_that_fit_and_leave_out_what_is_zero():
    figure = plot_record(record(), {})
    assert labels(figure) == ["command, mV", "displacement, μm", "inner tip, mm", "current, mA", "pressure, MPa"]
    assert figure.axes[-1].get_xlabel() == "time, s"


def test_a_long_record_keeps_its_peaks():
    """Thinned for the picture, but no extreme is lost."""
    shown = record()
    line = plot_record(shown, {}).axes[1].lines[0]
    assert len(line.get_xdata()) < 4000
    assert np.ptp(line.get_ydata()) == pytest.approx(1e6 * np.ptp(shown.column("displacement_m")), rel=1e-12)


def test_limits_are_drawn_where_they_matter_and_the_end_where_it_diverged():
    limits = {"current_A": (0.01, "amplifier's limit"), "displacement_m": (0.02, "limit")}
    figure = plot_record(record(stable=False, diverged_at_s=0.99), limits)
    legends = {
        axes.get_ylabel(): [t.get_text() for t in axes.get_legend().get_texts()]
        for axes in figure.axes
        if axes.get_legend()
    }
    assert legends["current, mA"] == ["current", "amplifier's limit 10 mA"]
    assert legends["displacement, μm"] == ["displacement", "diverged"]  # 0.05 mm is far from the limit of 20 mm
    assert all(any(line.get_xdata()[0] == 0.99 for line in axes.lines) for axes in figure.axes)


def test_a_record_that_ends_at_its_first_sample_is_drawn():
    """Warnings are errors here: its axis had the same beginning and end."""
    whole = record(stable=False, diverged_at_s=5e-4)
    figure = plot_record(replace(whole, samples=whole.samples[:1]), {})
    assert figure.axes[-1].get_xlim() == pytest.approx((0.0, 5.1e-4))


def test_command_draws_every_record_and_a_page_that_needs_nothing_else(tmp_path: Path, remedy: Prototype):
    write_prototype(remedy.but(effects={"current_saturation": {"limit_A": 0.05}}), tmp_path / "p.toml")
    arguments = ["simulate", str(tmp_path / "p.toml"), "--scenario", KICK, "--out", str(tmp_path / "out")]
    ran = CliRunner().invoke(app, [*arguments, "--json", str(tmp_path / "a.json")])
    assert ran.exit_code == 1, ran.output
    answer = json.loads((tmp_path / "a.json").read_text())
    names = {Path(path).name for path in answer["figures"]}
    assert names == {f"{name}.{kind}" for name in ("with_payload", "without_payload") for kind in ("svg", "png")}
    page = Path(answer["report"]).read_text(encoding="utf-8")
    assert "1 of 2 records not stable" in page
    assert "limit_A = 0.05" in page
    assert not re.search(r'(src|href)="(?!#|data:)', page)
    pictures = re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL)
    assert len(pictures) == 2
    for picture in pictures:
        words = [text.text or "" for text in ElementTree.fromstring(picture).iter("{http://www.w3.org/2000/svg}text")]
        assert "time, s" in words
        assert not any("payload:" in one for one in words), "the heading and the caption say that"
    assert sorted(re.findall("<figcaption>(\\w+)", page)) == ["stable", "under"]
    again = CliRunner().invoke(app, [*arguments[:-1], str(tmp_path / "bare"), "--no-plots"])
    assert again.exit_code == 1
    assert sorted(path.name for path in (tmp_path / "bare").iterdir()) == ["with_payload.csv", "without_payload.csv"]


@pytest.mark.parametrize(
    ("source", "limit_A"), [("prototypes/tame_lag.toml", 0.01), ("ball_screw", 30.0)], ids=["valve", "drive"]
)
def test_the_limit_that_is_drawn_is_that_of_the_rig_however_it_saturates(
    source: str, limit_A: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """A drive's usual limit is what it gives at 10 V."""
    rig = screw() if source == "ball_screw" else read_prototype(STUDIES / source)
    if source == "ball_screw":
        rig = rig.but(actuator=rig.actuator.but(peak_current_A=30.0))
    write_prototype(rig.but(effects={"current_saturation_soft": {}}), tmp_path / "p.toml")
    drawn: dict[str, tuple[float, str]] = {}

    def noted(*given):
        drawn.update(given[-1])
        return {"records": given[2]}

    monkeypatch.setattr("beamdesign.cli.simulation.write_folder", noted)
    kick = Path(KICK).read_text(encoding="utf-8").replace("duration_s = 3.0", "duration_s = 0.1")
    (tmp_path / "s.toml").write_text(kick, encoding="utf-8")
    CliRunner().invoke(
        app, ["simulate", str(tmp_path / "p.toml"), "--scenario", str(tmp_path / "s.toml"), "--out", "o"]
    )
    assert drawn["current_A"] == (limit_A, "amplifier's limit")


def test_stages_have_whole_numbers():
    one = record()
    staged = replace(
        one,
        columns=(*one.columns[:-1], "stage"),
        samples=np.column_stack([one.samples[:, :-1], one.samples[:, 0] * 0 + 1]),
    )
    (panel,) = [axes for axes in plot_record(staged, {}).axes if axes.get_ylabel() == "stage, no."]
    assert all(tick == round(tick) for tick in panel.get_yticks())


def test_a_legend_covers_no_curve():
    figure = plot_record(record(), {"current_A": (0.01, "amplifier's limit")})
    figure.canvas.draw()
    (axes,) = [one for one in figure.axes if one.get_legend()]
    legend = axes.get_legend().get_window_extent()
    assert legend.y0 >= axes.bbox.y1 - 1
    assert not any(legend.overlaps(one.get_tightbbox()) for one in figure.axes if one is not axes)


def test_the_page_of_records_states_currents_in_their_unit_and_only_where_there_are_some(tmp_path: Path):
    times = np.linspace(0.0, 1.0, 50)
    wave = np.sin(20 * times)
    columns = {"t_s": times, "displacement_m": 1e-4 * wave, "current_A": 13.5 * wave}
    for names, told in ((tuple(columns), True), (("t_s", "displacement_m"), False)):
        samples = np.column_stack([columns[name] for name in names])
        one = SimulatedRecord("records", samples, columns=names, stable=True)
        page, _ = write_record_page("rig", "scenario", {}, [one], {}, tmp_path)
        text = page.read_text(encoding="utf-8")
        assert ("largest current" in text) is told
        largest = float(np.abs(columns["current_A"]).max())
        assert (f"{largest:.4g} A</td>" in text) is told
    # The record is called as the table of all is: each has a link of its own.
    links, parts = (re.findall(pattern, text) for pattern in (r'<a href="#([^"]*)"', r'<section id="([^"]*)"'))
    assert links == parts == ["records", "records-2"]
