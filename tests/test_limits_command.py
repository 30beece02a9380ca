"""The `limits` command: every section printed and in JSON, the figure drawn, no as an answer."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from beamdesign import InputError, Prototype, critical_gain, read_prototype, write_prototype
from beamdesign.cli import app
from beamdesign.docs import pages
from beamdesign.plant.linear_reach import reach, single_mode_reach, with_published_effects
from beamdesign.prototype import Supply
from beamdesign.report.canvas import new_figure
from beamdesign.report.charts import plot_envelope
from beamdesign.synthesis import operating_limits
from beamdesign.synthesis.operating_limits import envelope
from beamdesign.validation.paper_rig import INNER_END_MASS_KG, lag

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def rig() -> Prototype:
    bare = lag(150.0, INNER_END_MASS_KG)
    return bare.but(
        servovalve=bare.servovalve.but(rated_current_A=0.015),
        actuator=bare.actuator.but(stroke_m=0.03),
        supply=Supply(flow_m3_per_s=1.5e-4),
        sensor=bare.sensor.but(resolution_m=5e-6),
    )


def test_all_sections_are_printed_and_written(tmp_path: Path, rig: Prototype, monkeypatch: pytest.MonkeyPatch):
    """The linear model's reach at one frequency of three, all of which `golden` has."""
    monkeypatch.setattr(operating_limits, "LINEAR_HZ", (10.0,))
    write_prototype(rig, tmp_path / "p.toml")
    ran = CliRunner().invoke(
        app,
        [
            "limits",
            str(tmp_path / "p.toml"),
            "--payload",
            "6.8",
            "--out",
            str(tmp_path / "o"),
            "--json",
            str(tmp_path / "a"),
        ],
    )
    assert ran.exit_code == 0, ran.output
    answer = json.loads((tmp_path / "a").read_text())
    assert answer["outer_end_mass_kg"] == 6.8
    least = np.min(list(answer["actuator"]["limits_N"].values()), axis=0)
    np.testing.assert_allclose(answer["actuator"]["load_N"], least)
    assert answer["sensor"]["hidden_N"] == pytest.approx(5e-6 / answer["sensor"]["static_error_m_per_N"])
    assert "sensor.noise_V not given" in ran.output
    modes = answer["modes"]
    assert modes["critical_gain_A_per_V"] == pytest.approx(critical_gain(rig, 6.8).gain_A_per_V)
    assert modes["gain_margin_eaten"] == pytest.approx(0.023, abs=0.01)
    loads = {(r["varied"], len(r["effects"]), r["frequency_Hz"]): r["limit"] for r in answer["linear_amplitude"]}
    assert loads["load", 2, 10.0] < 0.3 * loads["load", 1, 10.0]
    smallest = answer["limit_cycles"][0]
    assert smallest["amplitude_m"] == 1e-6
    assert smallest["gain_A_per_V"] == pytest.approx(critical_gain(rig, 6.8).gain_A_per_V, rel=0.15)
    assert sorted(path.name for path in (tmp_path / "o").iterdir()) == ["envelope.png", "envelope.svg"]
    for words in ("supply flow", "second mode, inner beam", "constant load, equal piston sides", "Limit cycles"):
        assert words in ran.output


def test_an_unstable_loop_has_no_limits(tmp_path: Path, rig: Prototype):
    write_prototype(rig, tmp_path / "p.toml")
    ran = CliRunner().invoke(app, ["limits", str(tmp_path / "p.toml"), "--payload", "0", "--json", str(tmp_path / "a")])
    assert ran.exit_code == 1
    assert "not stable with 0 kg" in json.loads((tmp_path / "a").read_text())["reason"]


def test_a_controller_is_needed(tmp_path: Path, paper: Prototype):
    write_prototype(paper, tmp_path / "p.toml")
    ran = CliRunner().invoke(app, ["limits", str(tmp_path / "p.toml")])
    assert isinstance(ran.exception, InputError)


def test_the_figure_shows_every_limit_and_what_governs(rig: Prototype):
    found = envelope(rig, 6.8)
    axes = plot_envelope(new_figure().add_subplot(), found, asked_N=500.0)
    words = [text.get_text() for text in axes.get_legend().get_texts()]
    assert words == [*found.limits_N, "envelope", "asked for, 500 N"]
    thick = max(axes.lines, key=lambda line: line.get_linewidth())
    np.testing.assert_allclose(thick.get_ydata(), found.load_N)
    named = {text.get_text().replace("\n", " ") for text in axes.texts}
    assert named <= set(found.governing)
    assert "supply flow" in named


def test_the_page_on_effects_tells_how_far_the_linear_model_holds():
    """Figures of the table in the page, from the prototype it names."""
    text = pages()["effects"]
    rig = read_prototype(ROOT / "studies" / "prototypes" / "published_lag.toml")
    real = with_published_effects(rig)
    equal = rig.but(effects={"pressure_dependent_flow": {}})
    assert (
        f"| {10 * round(reach(equal, 'load', 10.0).limit / 10)} N; {reach(real, 'load', 10.0).limit:.0f} N with" in text
    )
    assert f"force about no load | {reach(real, 'force', 10.0).limit / 1e3:.1f} kN |" in text
    modes = single_mode_reach(rig)
    assert f"compliance within 10 % | {modes.closed_loop_Hz:.0f} Hz | second mode of the inner beam, " in text
    assert f"{modes.inner_modes_Hz[1]:.0f} Hz |" in text
    assert f"critical gain | {100 * modes.gain_margin_eaten:.0f} % of it is lost" in text
