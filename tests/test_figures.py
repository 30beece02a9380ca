"""Drawings: what is on the axes, both scales in step, no text cut off, the same file for the same data."""

import subprocess
import sys
from pathlib import Path

import control
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from beamdesign import Prototype, critical_gain, read_prototype, state_space
from beamdesign.diagnosis.diagnosis import BandGap
from beamdesign.loop import LoopAtMass, loop
from beamdesign.quantities import decibels, from_decibels
from beamdesign.report.canvas import STYLES, new_figure, save
from beamdesign.report.charts import TradePoint, plot_trade
from beamdesign.report.figures import (
    frequency_grid,
    plot_compliance,
    plot_critical_gain,
    plot_loop_bode,
    plot_nyquist,
    plot_pole_zero,
    plot_root_locus,
    plot_sensitivity,
    root_branches,
)
from beamdesign.report.gap_folder import band_picture
from beamdesign.validation.paper_figures import DRAWINGS


@pytest.fixture
def loaded(remedy: Prototype) -> LoopAtMass:
    return loop(remedy).at(6.8)


@pytest.fixture
def tame() -> Prototype:
    """A loop that is stable with every payload."""
    return read_prototype(Path(__file__).parent.parent / "studies" / "prototypes" / "tame_lag.toml")


def labels(axes: Axes) -> list[str]:
    legend = axes.get_legend()
    assert legend is not None
    return [text.get_text() for text in legend.get_texts()]


def cut_off(figure: Figure) -> list[str]:
    """Axes (with ticks, labels and title) and legends that reach beyond the edge of the figure."""
    figure.draw_without_rendering()
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    page = figure.bbox.padded(0.5)
    parts = [(axes.get_ylabel() or axes.get_title(), axes.get_tightbbox(renderer)) for axes in figure.axes]
    parts += [("legend", legend.get_window_extent(renderer)) for legend in figure.legends]
    return [
        name
        for name, box in parts
        if not (page.x0 <= box.x0 <= box.x1 <= page.x1 and page.y0 <= box.y0 <= box.y1 <= page.y1)
    ]


def test_compliance_is_drawn_with_its_limit_and_bandwidth(loaded: LoopAtMass, remedy: Prototype):
    axes = new_figure().add_subplot()
    assert plot_compliance(axes, {"6.8 kg": loaded, "no payload": loop(remedy).at(0.0)}) is axes
    curve = axes.lines[0]
    frequencies, magnitudes = np.asarray(curve.get_xdata()), np.asarray(curve.get_ydata())
    np.testing.assert_allclose(magnitudes, np.abs(loaded.compliance_response(frequencies)))
    assert labels(axes)[0] == f"6.8 kg: {loaded.bandwidth_Hz():.2f} Hz"
    assert labels(axes)[1] == "no payload (unstable)"
    assert "5.71e-08 m/N = 0.0057 cm/kN = -100 dB" in labels(axes)[2]
    limit = next(line for line in axes.lines if str(line.get_label()).startswith("limit"))
    assert set(np.asarray(limit.get_ydata())) == {5.71e-8}
    dots = [line for line in axes.lines if line.get_marker() == "o"]
    assert [tuple(np.ravel(dot.get_xydata())) for dot in dots] == [(loaded.bandwidth_Hz(), 5.71e-8)]


def test_decibel_scale_follows_the_metric_one(loaded: LoopAtMass):
    figure = new_figure()
    axes = plot_compliance(figure.add_subplot(), {"loop": loaded})
    twin = next(other for other in figure.axes if other is not axes)
    for limits in ((1e-11, 1e-4), (1e-9, 1e-6)):
        axes.set_ylim(*limits)
        assert twin.get_ylim() == pytest.approx([float(decibels(end)) for end in limits])
    assert twin.get_ylabel() == "dB re 1 in/lbf"
    assert axes.get_ylabel().endswith("m/N")


def test_decibels_and_back():
    levels = np.array([-165.0, -100.0, 0.0])
    np.testing.assert_allclose(decibels(from_decibels(levels)), levels)
    assert decibels(0.0) == -np.inf


def test_curves_reach_the_top_of_sharp_resonances(remedy: Prototype):
    """At the edge of stability the resonance is far narrower than an even grid's steps."""
    gain = critical_gain(remedy, 6.8).gain_A_per_V * (1 - 1e-3)
    assert remedy.controller is not None
    edge = loop(remedy.but(controller=remedy.controller.but(gain_A_per_V=gain))).at(6.8)
    pole = min((p for p in edge.poles() if p.imag > 0), key=lambda p: abs(p.real))
    peak = abs(edge.compliance_response(np.array([abs(pole.imag) / (2 * np.pi)])))[0]
    drawn = np.abs(edge.compliance_response(frequency_grid([edge]))).max()
    assert drawn == pytest.approx(peak, rel=0.01)
    assert np.abs(edge.compliance_response(np.geomspace(0.1, 1000, 800))).max() < 0.5 * peak


def test_loop_bode_starts_at_the_phase_of_the_loop_and_is_continuous(loaded: LoopAtMass):
    magnitude, phase = new_figure().subplots(2, 1, sharex=True)
    assert plot_loop_bode(magnitude, phase, {"loop": loaded}) == (magnitude, phase)
    angles = np.asarray(phase.lines[0].get_ydata())
    assert -30 < angles[0] < 0
    assert np.abs(np.diff(angles)).max() < 30
    assert {float(axes.lines[-1].get_ydata()[0]) for axes in (magnitude, phase)} == {0.0, -180.0}


def test_bode_bars_are_the_margins_of_python_control(tame: Prototype):
    """Their ends, and the crossovers, by `control.margin` of the same matrices at the same payload."""
    for mass in (0.0, 6.8):
        magnitude, phase = new_figure().subplots(2, 1, sharex=True)
        plot_loop_bode(magnitude, phase, {"loop": loop(tame).at(mass)}, marked=["loop"])
        opened = state_space(tame, mass, loop="open")["sensor_V", "command_V"]
        gain, degrees, at_gain, at_phase = control.margin(opened)
        gain_bar, phase_bar = (
            next(np.asarray(line.get_xydata()) for line in axes.lines if line.get_marker() == "_")
            for axes in (magnitude, phase)
        )
        np.testing.assert_allclose(
            gain_bar, [[at_gain / (2 * np.pi), 0], [at_gain / (2 * np.pi), -20 * np.log10(gain)]]
        )
        assert phase_bar[:, 0] == pytest.approx(at_phase / (2 * np.pi), rel=1e-8)
        assert abs(np.diff(phase_bar[:, 1])[0]) == pytest.approx(degrees, rel=1e-3)  # read off the curve
        assert phase_bar[0, 1] % 360 == 180
        assert labels(magnitude)[0] == f"loop: gain margin {gain:.3g} = {20 * np.log10(gain):.1f} dB"
        assert labels(phase)[0] == f"loop: phase margin {degrees:.1f}°"


def test_an_unstable_loop_has_no_margins_drawn(remedy: Prototype):
    magnitude, phase = new_figure().subplots(2, 1, sharex=True)
    plot_loop_bode(magnitude, phase, {"loop": loop(remedy).at(0.0)}, marked=["loop"])
    assert [len(axes.lines) for axes in (magnitude, phase)] == [2, 2]


def test_nyquist_keeps_out_of_the_disc_exactly_where_the_peak_sensitivity_is_within_its_bound(tame: Prototype):
    """The nearest point is at the modulus margin that python-control finds; the curve is L of the matrices."""
    closed = loop(tame).at(6.8)
    opened = state_space(tame, 6.8, loop="open")["sensor_V", "command_V"]
    distance = min(control.stability_margins(opened, returnall=True)[2])
    for peak, touches in ((0.999 / distance, True), (1.001 / distance, False)):
        axes = plot_nyquist(new_figure().add_subplot(), {"loop": closed}, peak)
        curve, nearest = (np.asarray(line.get_xydata()) @ [1, 1j] for line in axes.lines[:2])
        disc = axes.patches[0].get_path()
        assert np.abs(disc.vertices @ [1, 1j] + 1) == pytest.approx(1 / peak)
        assert disc.contains_points(np.column_stack([curve.real, curve.imag])).any() == touches
        assert abs(nearest[0] + 1) == pytest.approx(distance, rel=1e-4)


def test_root_locus_runs_from_the_open_loop_poles_through_the_marked_ones(loaded: LoopAtMass):
    """In Hz; at the ends and at the marks the roots are those that numpy finds of the coefficients."""
    axes = new_figure().add_subplot()
    assert plot_root_locus(axes, loaded, [1e-7, 1e-2, 3.0], {"set gain": 1.0}) is axes
    assert labels(axes) == ["set gain", "open-loop poles", "zeros"]
    below, above = (
        np.array([float(c) for c in reversed(p.coeffs())]) for p in (loaded.loop_denominator, loaded.loop_numerator)
    )

    def roots_Hz(factor: float) -> np.ndarray:
        return np.sort_complex(np.roots(np.polyadd(below, factor * above))) / (2 * np.pi)

    branches = [np.asarray(line.get_xydata()) @ [1, 1j] for line in axes.lines[: len(below) - 1]]
    marked = next(np.asarray(line.get_xydata()) @ [1, 1j] for line in axes.lines if line.get_label() == "set gain")
    for found, factor in (
        ([branch[0] for branch in branches], 1e-7),
        (marked, 1.0),
        ([branch[-1] for branch in branches], 3.0),
    ):
        np.testing.assert_allclose(np.sort_complex(np.round(found, 9)), np.round(roots_Hz(factor), 9), rtol=1e-6)


@pytest.mark.parametrize("mass", [0.0, 6.8])
def test_branches_of_a_root_locus_never_jump_though_they_meet(tame: Prototype, mass: float):
    """Two of them meet on the real axis and leave it; every step is short, there too."""
    branches = root_branches(loop(tame).at(mass), np.geomspace(1e-3, 10.0, 41).tolist())
    size = np.abs(branches[1:])
    jumps = np.abs(np.diff(branches, axis=0)) / np.maximum(size, 0.01 * np.abs(branches[0]).max())
    assert jumps.max() <= 0.01
    joined = (np.abs(branches.imag) < 1e-6 * np.abs(branches)).any(axis=0) & (branches.imag != 0).any(axis=0)
    assert joined.sum() >= 2


def test_pole_zero_map(loaded: LoopAtMass):
    axes = plot_pole_zero(new_figure().add_subplot(), loaded.poles(), loaded.compliance_zeros())
    assert labels(axes) == ["open-loop poles", "zeros"]
    assert [len(line.get_xdata()) for line in axes.lines[:2]] == [8, 6]


def test_sensitivity_names_its_peak(loaded: LoopAtMass, remedy: Prototype):
    axes = new_figure().add_subplot()
    plot_sensitivity(axes, {"6.8 kg": loaded, "no payload": loop(remedy).at(0.0)})
    assert labels(axes) == [f"6.8 kg, peak {loaded.peak_sensitivity():.2f}", "no payload, unstable", "limit 2"]
    assert np.asarray(axes.lines[0].get_ydata()).max() == pytest.approx(loaded.peak_sensitivity(), rel=1e-3)


def test_jump_of_the_critical_gain_is_a_gap():
    axes = plot_critical_gain(new_figure().add_subplot(), [0.0, 1.0, 2.0, 3.0], {"lag": [0.30, 0.35, 0.05, 0.04]})
    np.testing.assert_array_equal(np.asarray(axes.lines[0].get_ydata()), [300, 350, np.nan, 50, 40])


def test_gains_of_motors_are_drawn_in_amperes():
    axes = plot_critical_gain(new_figure().add_subplot(), [0.0, 1.0], {"lag": [150.0, 160.0]})
    np.testing.assert_array_equal(np.asarray(axes.lines[0].get_ydata()), [150, 160])
    assert axes.get_ylabel() == "critical gain, A/V"


def test_styles_differ_in_grey():
    assert len({tuple(style.values()) for style in STYLES}) == len(STYLES) == 8
    assert {style["color"] for style in STYLES} <= {"black", "0.45"}


@pytest.mark.parametrize("draw", DRAWINGS, ids=lambda draw: draw.__name__)
def test_published_figures_have_axes_captions_and_no_text_cut_off(draw):
    drawing = draw()
    assert len(drawing.caption) > 40
    assert drawing.claim
    assert cut_off(drawing.figure) == []
    title = drawing.figure._suptitle.get_window_extent()
    assert title.width > 0
    for axes in drawing.figure.axes:
        assert not title.overlaps(axes.get_tightbbox())
        assert axes.get_ylabel() or axes.get_title()


def test_saved_files_are_the_same_for_the_same_data(tmp_path: Path, loaded: LoopAtMass):
    def saved(folder: str) -> list[bytes]:
        (tmp_path / folder).mkdir()
        figure = new_figure(80.0, 60.0)
        plot_pole_zero(figure.add_subplot(), loaded.poles(), loaded.open_loop_zeros())
        return [path.read_bytes() for path in save(figure, tmp_path / folder / "map", ("png", "svg", "pdf"))]

    first, second = saved("one"), saved("two")
    assert first == second
    assert first[0].startswith(b"\x89PNG")
    assert b"real part, Hz" in first[1], "text stays text"
    assert first[2].startswith(b"%PDF")


def test_nothing_touches_pyplot():
    """Figures are made without a window system and leave no global state behind."""
    code = (
        "import sys, beamdesign.report.figures, beamdesign.report.canvas; sys.exit('matplotlib.pyplot' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_logarithmic_scale_within_a_decade_has_numbers(remedy: Prototype):
    axes = new_figure().add_subplot()
    plot_critical_gain(axes, [0.0, 3.0, 6.0], {"one": [0.2, 0.4, 0.8]})
    axes.figure.draw_without_rendering()
    low, high = axes.get_ylim()
    labels = [
        label.get_text()
        for minor in (False, True)
        for label in axes.yaxis.get_ticklabels(minor=minor)
        if low <= label.get_position()[1] <= high and label.get_text()
    ]
    assert len(labels) > 1


def test_a_scale_with_one_decade_in_it_has_further_numbers_of_the_same_kind():
    bands = [BandGap(0.2, 5.0, 0.011, 0.009, 0.006, 0.007), BandGap(5.0, 15.0, 0.06, 0.04, 0.009, 0.01)]
    (axes,) = band_picture(bands).axes
    axes.figure.draw_without_rendering()
    labels = [label.get_text() for label in axes.yaxis.get_ticklabels(minor=True) if label.get_text()]
    assert {"0.02", "0.04"} <= set(labels)


def test_a_front_without_a_proved_design_has_no_scale_of_masses():
    axes = plot_trade(new_figure().add_subplot(), [], failed_Hz=[10.0, 12.0])
    assert list(axes.get_yticks()) == []
    axes = plot_trade(new_figure().add_subplot(), [TradePoint(6.8, 3.0, 9.0)], failed_Hz=[10.0])
    assert len(axes.get_yticks()) > 0
