"""Figures 8 to 16 of the paper drawn again from the model, each with the paper's claim beside it.

The paper's own curves are not reproduced: what it says about them in words is, and is marked.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import floor

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from beamdesign.loop import LoopAtMass, critical_gain
from beamdesign.prototype import COMPLIANCE_LIMIT_M_PER_N
from beamdesign.quantity_text import decibels, from_decibels
from beamdesign.report.canvas import new_figure, note
from beamdesign.report.figures import plot_compliance, plot_critical_gain, plot_loop_bode, plot_root_locus
from beamdesign.validation.paper.claims import at, gain_cliff, phase_lead_deg, stable_masses
from beamdesign.validation.paper.figure_claims import (
    FORCES_PEAK_TO_PEAK_N,
    MEASURED,
    NUMBERS,
    RESOLUTION_M,
    TESTED_HZ,
    FigureClaim,
    figure_claims,
    nonlinear_compliance,
    pair_Hz,
)
from beamdesign.validation.paper.rig import INNER_END_MASS_KG, OUTER_END_MASS_KG, beam_damping, lag, proportional

_ARROW = {"arrowstyle": "->", "linewidth": 0.8}


@dataclass(frozen=True)
class Drawing:
    """One figure of the page.

    Attributes:
        name: file name without suffix.
        title: what it shows, with the paper's figure number.
        claim: what the paper says about it, in our words.
        caption: what the model shows.
        figure: the matplotlib figure.
        checks: what the paper says about it, one by one; also written below the axes.
    """

    name: str
    title: str
    claim: str
    caption: str
    figure: Figure
    checks: tuple[FigureClaim, ...] = ()


def _claimed(axes: Axes, bandwidth_Hz: float) -> None:
    """Mark a printed bandwidth on the limit."""
    axes.plot(
        [bandwidth_Hz], [COMPLIANCE_LIMIT_M_PER_N], "v", color="black", fillstyle="none", markersize=8,
        label=f"paper: limit met up to {bandwidth_Hz:g} Hz",
    )  # fmt: skip
    axes.legend(fontsize=8, loc="best")


def _compliance(curves: Mapping[str, LoopAtMass], claimed_Hz: float | None = None) -> Figure:
    figure = new_figure()
    axes = plot_compliance(figure.add_subplot(), curves)
    axes.set_ylim(*(float(from_decibels(level)) for level in (-165, -45)))
    if claimed_Hz is not None:
        _claimed(axes, claimed_Hz)
    return figure


def _bode(
    curves: Mapping[str, LoopAtMass], markings: Callable[[Axes, Axes], None] = lambda magnitude, phase: None
) -> Figure:
    figure = new_figure(height_mm=130.0)
    magnitude, phase = figure.subplots(2, 1, sharex=True)
    plot_loop_bode(magnitude, phase, curves)
    markings(magnitude, phase)
    return figure


def _spike(phase: Axes, loop: LoopAtMass, words: str) -> None:
    """Name the phase spike between pole and zero."""
    frequency = float(np.sqrt(np.prod(pair_Hz(loop))))
    response = loop.loop_response(np.geomspace(0.1, frequency, 4000))
    level = float(np.degrees(np.unwrap(np.angle(response)))[-1])
    note(phase, words, (frequency, level), (-70, 0), "right", "center", arrowprops=_ARROW)


def root_locus() -> Drawing:
    """Figure 8."""
    limit = critical_gain(proportional(24.0))
    figure = new_figure(height_mm=115.0)
    whole, close = figure.subplots(1, 2, width_ratios=(3, 2))
    marked = {"12 mA/V": 12.0, "24 mA/V, paper's limit": 24.0, "48 mA/V": 48.0}
    for axes in (whole, close):
        plot_root_locus(axes, at(proportional(1.0)), list(np.geomspace(0.05, 60.0, 240)), marked)
    whole.set_xlim(-1100, 250)
    whole.set_ylim(-1150, 1150)
    whole.set_xticks([-1000, -500, 0])
    words = f"{1e3 * limit.gain_A_per_V:.1f} mA/V\n{limit.frequency_Hz:.0f} Hz"
    note(whole, words, (0.0, 2 * np.pi * limit.frequency_Hz), (-52, -48), arrowprops=_ARROW)
    close.set_xlim(-50, 10)
    close.set_ylim(290, 360)
    close.set_title("the beams' pair", fontsize=9)
    close.set_ylabel("")
    close.get_legend().remove()
    handles, labels = whole.get_legend_handles_labels()
    whole.get_legend().remove()
    figure.legend(handles, labels, loc="outside upper center", ncols=5, fontsize=8)
    return Drawing(
        "figure_08", "Figure 8: root locus, proportional control", "The largest stable gain is 24 mA/V.",
        f"The valve's pair crosses at {1e3 * limit.gain_A_per_V:.1f} mA/V and {limit.frequency_Hz:.0f} Hz. The oil's"
        " pair, near 3400 rad/s, lies outside the picture.",
        figure,
    )  # fmt: skip


def proportional_compliance() -> Drawing:
    """Figure 9."""
    loop = at(proportional(24.0))
    return Drawing(
        "figure_09", "Figure 9: closed-loop compliance, proportional control", "The -100 dB goal is met below 4 Hz.",
        f"At 24 mA/V the model meets it up to {loop.bandwidth_Hz():.2f} Hz.",
        _compliance({"proportional, 24 mA/V": loop}, 4.0),
    )  # fmt: skip


def lag_compliance() -> Drawing:
    """Figure 10."""
    loop, before = at(lag(300.0)), at(proportional(24.0))
    figure = _compliance({"lag, 300 mA/V": loop, "proportional, 24 mA/V": before}, 10.0)
    axes = figure.axes[0]
    for frequency, printed in ((0.5, 22), (2.0, 20), (20.0, 4)):
        low, high = (abs(one.compliance_response(np.array([frequency]))[0]) for one in (loop, before))
        axes.annotate("", (frequency, low), (frequency, high), arrowprops={"arrowstyle": "<->", "linewidth": 0.9})
        note(axes, f"{decibels(high) - decibels(low):.1f} dB (paper {printed})", (frequency, low), (5, -11), "left")
    return Drawing(
        "figure_10", "Figure 10: closed-loop compliance, lag compensator",
        "The goal is met below 10 Hz; 22 dB better than proportional below 2 Hz, 20 to 4 dB from there to 20 Hz,"
        " no better above 25 Hz.",
        f"At 300 mA/V the model meets the goal up to {loop.bandwidth_Hz():.2f} Hz.",
        figure,
    )  # fmt: skip


def lag_open_loop() -> Drawing:
    """Figure 11."""
    loop = at(lag(300.0))
    pole, zero = pair_Hz(loop)

    def markings(magnitude: Axes, phase: Axes) -> None:
        for axes in (magnitude, phase):
            for frequency in (50.0, 55.0):
                axes.axvline(frequency, color="0.7", linewidth=0.8, linestyle=":")
        note(magnitude, "paper: 50 and 55 Hz", (50.0, magnitude.get_ylim()[0]), (-6, 6), "right")
        _spike(phase, loop, "spike up")

    return Drawing(
        "figure_11", "Figure 11: open loop, lag compensator",
        "Peaks at 50 Hz (zero) and 55 Hz (pole); the phase spike between them points up.",
        f"Zero at {zero:.1f} Hz, pole at {pole:.1f} Hz, 300 mA/V; gain margin {loop.margins().gain_up:.3f}.",
        _bode({"lag, 300 mA/V": loop}, markings),
    )  # fmt: skip


def loaded_open_loop() -> Drawing:
    """Figure 12."""
    loop, bare = at(lag(300.0), OUTER_END_MASS_KG), at(lag(300.0))
    (onset_kg, onset_Hz), *_ = stable_masses(300.0, 0.0)
    answer = "stable" if loop.stable else "unstable"
    pole, zero = pair_Hz(loop)

    def markings(magnitude: Axes, phase: Axes) -> None:
        for name, frequency, side in (("pole", pole, "right"), ("zero", zero, "left")):
            for axes in (magnitude, phase):
                axes.axvline(frequency, color="0.7", linewidth=0.8, linestyle=":")
            place = (frequency, magnitude.get_ylim()[0])
            note(magnitude, f"{name} {frequency:.1f} Hz", place, (-4 if side == "right" else 4, 6), side)
        _spike(phase, loop, "spike down, past -180 degrees")

    return Drawing(
        "figure_12", "Figure 12: open loop with 6.8 kg on the outer beam, unstable",
        "Pole and zero have changed places, the spike points down, and the loop is unstable at the same gain.",
        f"At 300 mA/V the model is {answer} with 6.8 kg; it is lost from {onset_kg:.2f} kg, at {onset_Hz:.1f} Hz.",
        _bode({"lag, 300 mA/V, 6.8 kg": loop, "without the mass": bare}, markings),
    )  # fmt: skip


def loaded_compliance() -> Drawing:
    """Figure 13."""
    limit = 1e3 * critical_gain(lag(10.0), OUTER_END_MASS_KG).gain_A_per_V
    printed, own = at(lag(10.0), OUTER_END_MASS_KG), at(lag(floor(limit)), OUTER_END_MASS_KG)
    return Drawing(
        "figure_13", "Figure 13: compliance with 6.8 kg at its largest gain",
        "The largest gain is 10 mA/V, 30 times lower than without the mass.",
        f"The model's largest gain is {limit:.1f} mA/V with fixed dashpots. The goal is met up to"
        f" {printed.bandwidth_Hz():.2f} Hz at 10 mA/V and {own.bandwidth_Hz():.2f} Hz at {floor(limit)} mA/V.",
        _compliance({"lag, 10 mA/V, 6.8 kg": printed, f"lag, {floor(limit)} mA/V, 6.8 kg": own}),
    )  # fmt: skip


def relieved_compliance() -> Drawing:
    """Figure 14."""
    limit = 1e3 * critical_gain(lag(200.0, INNER_END_MASS_KG), OUTER_END_MASS_KG).gain_A_per_V
    gain = floor(min(limit, 200.0))
    loop = at(lag(gain, INNER_END_MASS_KG), OUTER_END_MASS_KG)
    bare = at(lag(gain, INNER_END_MASS_KG))
    edges = stable_masses(150.0, INNER_END_MASS_KG)
    return Drawing(
        "figure_14", "Figure 14: compliance with 6.8 kg outside and 4.5 kg inside",
        "4.5 kg inside allow 200 mA/V; the goal is met up to 8 Hz.",
        f"The model's largest gain is {limit:.1f} mA/V; at {gain} mA/V the goal is met up to"
        f" {loop.bandwidth_Hz():.2f} Hz. The remedy needs its payload: without it the loop is"
        f" {'stable' if bare.stable else 'unstable'} at that gain, and at 150 mA/V it is stable only between"
        f" {edges[0][0]:.3f} kg (crossing at {edges[0][1]:.0f} Hz) and {edges[1][0]:.2f} kg ({edges[1][1]:.0f} Hz).",
        _compliance({f"lag, {gain} mA/V, 6.8 kg outer, 4.5 kg inner": loop}, 8.0),
    )  # fmt: skip


def _measured(figure_number: int, label: str) -> Figure:
    """Linear curve of a measured case with the nonlinear rig's points where the paper tested."""
    case = MEASURED[figure_number]
    figure = _compliance({label: at(case.rig, case.outer_end_mass_kg)})
    axes = figure.axes[0]
    axes.axvspan(axes.get_xlim()[0], TESTED_HZ[-1], color="0.93", zorder=0)
    note(axes, "tested", (TESTED_HZ[-1], axes.get_ylim()[0]), (-5, 6), "right")
    for force, marker in zip(FORCES_PEAK_TO_PEAK_N, "s^", strict=True):
        axes.plot(
            TESTED_HZ, nonlinear_compliance(figure_number, force), marker, color="black", fillstyle="none",
            markersize=5 if marker == "s" else 8, label=f"nonlinear rig, {force:g} N peak to peak",
        )  # fmt: skip
    force = FORCES_PEAK_TO_PEAK_N[-1]
    axes.axhline(
        RESOLUTION_M / force, color="0.45", linewidth=1.0, linestyle="-.",
        label=f"resolution {1e6 * RESOLUTION_M:g} μm under {force:g} N peak to peak",
    )  # fmt: skip
    axes.legend(fontsize=8, loc="upper left")
    axes.set_ylim(*(float(from_decibels(level)) for level in (-165, -25)))
    return figure


def measured_compliance() -> Drawing:
    """Figure 15."""
    lead = phase_lead_deg(np.array([2.0, 10.0]))
    return Drawing(
        "figure_15", "Figure 15: predicted compliance for the tests without end mass",
        "Tests from 0 to 10 Hz agreed with the prediction, phase lead included; below 2 Hz noise hid the motion.",
        "The test's gain is not printed: drawn at 200 mA/V, the measured limit, with the 400 Hz filter. Displacement"
        f" leads force by {lead[0]:.0f} degrees at 2 Hz and {lead[1]:.0f} at 10 Hz. The measured points are not"
        " published as numbers; in their place stands the nonlinear rig, with orifices and unequal piston sides.",
        _measured(15, "lag, 200 mA/V, filter"),
    )  # fmt: skip


def measured_loaded_compliance() -> Drawing:
    """Figure 16."""
    loop = at(MEASURED[16].rig, OUTER_END_MASS_KG)
    return Drawing(
        "figure_16", "Figure 16: predicted compliance for the tests with 6.8 kg outside and 4.5 kg inside",
        "Tests agreed with the prediction.",
        "The test's gain is not printed: drawn at 150 mA/V, the measured limit, with the 400 Hz filter. The goal is"
        f" met up to {loop.bandwidth_Hz():.2f} Hz. Points: the nonlinear rig.",
        _measured(16, "lag, 150 mA/V, 6.8 kg outer, 4.5 kg inner, filter"),
    )  # fmt: skip


def gain_over_mass() -> Drawing:
    """Critical gain over the outer end mass: the cliff that the paper describes in words."""
    cliff = gain_cliff()
    masses = [float(mass) for mass in np.linspace(0.0, OUTER_END_MASS_KG, 69)]
    rigs = {
        "lag": lag(300.0),
        "lag, beam damping 0.03": beam_damping(0.03)(lag(300.0), 0.0),
        "lag, 4.5 kg inner": lag(200.0, INNER_END_MASS_KG),
    }
    curves = {name: [critical_gain(rig, mass).gain_A_per_V for mass in masses] for name, rig in rigs.items()}
    figure = new_figure()
    axes = plot_critical_gain(figure.add_subplot(), masses, curves)
    for mass, gain, name in ((0.0, 300.0, ""), (6.8, 10.0, ""), (6.8, 200.0, "paper's predictions")):
        axes.plot([mass], [gain], "v", color="black", fillstyle="none", markersize=8, clip_on=False, label=name or None)
    axes.legend(fontsize=8, loc="best")
    return Drawing(
        "critical_gain_over_mass", "Critical gain over the outer end mass",
        "When pole and zero change places, the gain has to come down by 75 % at once, and further with more mass.",
        f"At {cliff.outer_end_mass_kg:.3f} kg the model's gain falls by {100 * cliff.reduction:.0f} %, from"
        f" {cliff.before_mA_per_V:.0f} to {cliff.after_mA_per_V:.0f} mA/V.",
        figure,
    )  # fmt: skip


DRAWINGS: tuple[Callable[[], Drawing], ...] = (
    root_locus,
    proportional_compliance,
    lag_compliance,
    lag_open_loop,
    loaded_open_loop,
    loaded_compliance,
    relieved_compliance,
    measured_compliance,
    measured_loaded_compliance,
    gain_over_mass,
)
"""All figures, in the order of the page."""

NUMBERED: dict[int, Callable[[], Drawing]] = dict(zip(NUMBERS, DRAWINGS, strict=False))
"""Those of them that have a number in the paper."""


def drawn(draw: Callable[[], Drawing]) -> Drawing:
    """Draw a figure with what the paper says about it, checked, below."""
    drawing = draw()
    number = next((number for number, one in NUMBERED.items() if one is draw), None)
    if number is None:
        return drawing
    checks = figure_claims(number)
    lines = [f"{'✓' if c.holds else '✗'} {c.claim}: paper {c.paper}; model {c.model}" for c in checks]
    drawing.figure.supxlabel("\n".join(lines), x=0.02, ha="left", fontsize=7.5, linespacing=1.4)
    width, height = drawing.figure.get_size_inches()
    drawing.figure.set_size_inches(width, height + 0.16 * len(lines))
    return replace(drawing, checks=checks)
