"""Figures 8 to 16 of the paper drawn again from the model, each with what the paper says about it, checked.

The paper's own curves are not reproduced: what it says about them in words is, and is marked. A number holds as a
`Claim` agrees: within 5 % or the rounding of the print. What is said in words holds where the model does the same.

The paper's measured points are lost. Where it measured, from 0 to 10 Hz under 50 to 500 N peak to peak, the response of
the nonlinear rig (orifices, unequal piston sides, the sensor's filter) stands in for them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import floor
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from beamdesign.loop import LoopAtMass, critical_gain
from beamdesign.plant.harmonic_balance import forced_motion
from beamdesign.plant.linear_reach import with_published_effects
from beamdesign.prototype import COMPLIANCE_LIMIT_M_PER_N, Prototype
from beamdesign.quantity_text import decibels, from_decibels
from beamdesign.report.canvas import new_figure, note
from beamdesign.report.figures import plot_compliance, plot_critical_gain, plot_loop_bode, plot_root_locus
from beamdesign.validation.paper.claims import CM_PER_100_N, Claim, FigureClaim
from beamdesign.validation.paper.rig import (
    INNER_END_MASS_KG,
    OUTER_END_MASS_KG,
    at,
    beam_damping,
    critical_gain_mA_per_V,
    filtered,
    filtered_smaller_side,
    gain_cliff,
    lag,
    lag_advantage_dB,
    pair_Hz,
    phase_spike_deg,
    proportional,
    stable_masses,
)

FORCES_PEAK_TO_PEAK_N = (50.0, 500.0)
TESTED_HZ = (0.5, 1.0, 2.0, 4.0, 7.0, 10.0)
RESOLUTION_M = 5e-6
"""Of the paper's displacement measurement, section Experiments."""
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


def _number(claim: str, paper: float, model: float, unit: str, digit: float = 1.0) -> tuple[str, str, str, bool]:
    """A check of a number, the worth of one in its last printed digit in `unit`."""
    agrees = Claim("", claim, unit, paper, model, "", digit).agrees
    return claim, f"{paper:g} {unit}".strip(), f"{model:.3g} {unit}".strip(), agrees


def _drawing(
    number: int, title: str, claim: str, caption: str, figure: Figure, *checks: tuple[str, str, str, Any]
) -> Drawing:
    """A figure of the paper, with its checks (what about, paper, model, whether it holds) written below the axes."""
    found = tuple(FigureClaim(number, about, paper, model, bool(holds)) for about, paper, model, holds in checks)
    lines = [f"{'✓' if c.holds else '✗'} {c.claim}: paper {c.paper}; model {c.model}" for c in found]
    figure.supxlabel("\n".join(lines), x=0.02, ha="left", fontsize=7.5, linespacing=1.4)
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + 0.16 * len(lines))
    return Drawing(f"figure_{number:02}", f"Figure {number}: {title}", claim, caption, figure, found)


def _compliance(curves: Mapping[str, LoopAtMass], claimed_Hz: float | None = None, highest_dB: float = -45.0) -> Figure:
    """Compliances, with a printed bandwidth marked on the limit."""
    figure = new_figure()
    axes = plot_compliance(figure.add_subplot(), curves)
    axes.set_ylim(*(float(from_decibels(level)) for level in (-165, highest_dB)))
    if claimed_Hz is not None:
        axes.plot(
            [claimed_Hz], [COMPLIANCE_LIMIT_M_PER_N], "v", color="black", fillstyle="none", markersize=8,
            label=f"paper: limit met up to {claimed_Hz:g} Hz",
        )  # fmt: skip
        axes.legend(fontsize=8, loc="best")
    return figure


def _bode(curves: Mapping[str, LoopAtMass], marked_Hz: Sequence[float], words: str) -> tuple[Figure, Axes]:
    """Open loops, frequencies marked, and the first one's phase spike between pole and zero named; and upper axes."""
    figure = new_figure(height_mm=130.0)
    magnitude, phase = figure.subplots(2, 1, sharex=True)
    plot_loop_bode(magnitude, phase, curves)
    for axes in (magnitude, phase):
        for frequency in marked_Hz:
            axes.axvline(frequency, color="0.7", linewidth=0.8, linestyle=":")
    loop = next(iter(curves.values()))
    between = float(np.sqrt(np.prod(pair_Hz(loop))))
    response = loop.loop_response(np.geomspace(0.1, between, 4000))
    level = float(np.degrees(np.unwrap(np.angle(response)))[-1])
    note(phase, words, (between, level), (-70, 0), "right", "center", arrowprops=_ARROW)
    return figure, magnitude


def root_locus() -> Drawing:
    """Figure 8."""
    limit = critical_gain(proportional(24.0))
    poles = np.sort(np.abs(at(proportional(24.0)).poles()))
    figure = new_figure(height_mm=115.0)
    whole, close = figure.subplots(1, 2, width_ratios=(3, 2))
    marked = {"12 mA/V": 12.0, "24 mA/V, paper's limit": 24.0, "48 mA/V": 48.0}
    for axes in (whole, close):
        plot_root_locus(axes, at(proportional(1.0)), list(np.geomspace(0.05, 60.0, 240)), marked)
    whole.set(xlim=(-1100, 250), ylim=(-1150, 1150), xticks=[-1000, -500, 0])
    words = f"{1e3 * limit.gain_A_per_V:.1f} mA/V\n{limit.frequency_Hz:.0f} Hz"
    note(whole, words, (0.0, 2 * np.pi * limit.frequency_Hz), (-52, -48), arrowprops=_ARROW)
    close.set(xlim=(-50, 10), ylim=(290, 360), ylabel="")
    close.set_title("the beams' pair", fontsize=9)
    close.get_legend().remove()
    handles, labels = whole.get_legend_handles_labels()
    whole.get_legend().remove()
    figure.legend(handles, labels, loc="outside upper center", ncols=5, fontsize=8)
    return _drawing(
        8, "root locus, proportional control", "The largest stable gain is 24 mA/V.",
        f"The valve's pair crosses at {1e3 * limit.gain_A_per_V:.1f} mA/V and {limit.frequency_Hz:.0f} Hz. The oil's"
        " pair, near 3400 rad/s, lies outside the picture.",
        figure,
        _number("largest stable gain", 24.0, 1e3 * limit.gain_A_per_V, "mA/V"),
        _number("number of roots", 7.0, float(len(poles)), ""),
        (
            "two roots are very fast and omitted", "two",
            f"{poles[-1]:.0f} rad/s, {poles[-1] / poles[-3]:.1f} times the next", poles[-2] > 2 * poles[-3],
        ),
    )  # fmt: skip


def proportional_compliance() -> Drawing:
    """Figure 9."""
    loop = at(proportional(24.0))
    slow, following = np.sort(np.abs(loop.open_loop_poles()))[:2]
    still = loop.static_compliance()
    return _drawing(
        9, "closed-loop compliance, proportional control", "The -100 dB goal is met below 4 Hz.",
        f"At 24 mA/V the model meets it up to {loop.bandwidth_Hz():.2f} Hz.",
        _compliance({"proportional, 24 mA/V": loop}, 4.0),
        _number("goal met below", 4.0, loop.bandwidth_Hz(), "Hz"),
        (
            "static displacement small but definite", "levels off",
            f"{still:.2g} m/N, {20 * np.log10(still / COMPLIANCE_LIMIT_M_PER_N):.0f} dB from the goal",
            0 < still < COMPLIANCE_LIMIT_M_PER_N,
        ),
        (
            "caused by an open-loop pole near the origin", "not zero", f"-{slow:.2g} rad/s, next {following:.0f}",
            0 < slow < 0.05 * following,
        ),
    )  # fmt: skip


def lag_compliance() -> Drawing:
    """Figure 10."""
    loop, before = at(lag(300.0)), at(proportional(24.0))
    figure = _compliance({"lag, 300 mA/V": loop, "proportional, 24 mA/V": before}, 10.0)
    axes = figure.axes[0]
    better = []
    for frequency, printed in ((0.5, 22), (2.0, 20), (20.0, 4)):
        low, high = (abs(one.compliance_response(np.array([frequency]))[0]) for one in (loop, before))
        gained = float(decibels(high) - decibels(low))
        axes.annotate("", (frequency, low), (frequency, high), arrowprops={"arrowstyle": "<->", "linewidth": 0.9})
        note(axes, f"{gained:.1f} dB (paper {printed})", (frequency, low), (5, -11), "left")
        better.append(_number(f"better than proportional at {frequency:g} Hz", printed, gained, "dB"))
    above = float(lag_advantage_dB(np.geomspace(25.0, 100.0, 200)).max())
    return _drawing(
        10, "closed-loop compliance, lag compensator",
        "The goal is met below 10 Hz; 22 dB better than proportional below 2 Hz, 20 to 4 dB from there to 20 Hz,"
        " no better above 25 Hz.",
        f"At 300 mA/V the model meets the goal up to {loop.bandwidth_Hz():.2f} Hz.",
        figure,
        _number("goal met below", 10.0, loop.bandwidth_Hz(), "Hz"),
        *better,
        ("no better above 25 Hz", "none", f"{above:.2g} dB at most up to 100 Hz", above < 0.5),
        _number("static error under 100 N", 8.5e-4, CM_PER_100_N * loop.static_compliance(), "cm", 1e-5),
    )  # fmt: skip


def lag_open_loop() -> Drawing:
    """Figure 11."""
    loop = at(lag(300.0))
    (pole, zero), spike = pair_Hz(loop), phase_spike_deg(loop)
    figure, magnitude = _bode({"lag, 300 mA/V": loop}, (50.0, 55.0), "spike up")
    note(magnitude, "paper: 50 and 55 Hz", (50.0, magnitude.get_ylim()[0]), (-6, 6), "right")
    return _drawing(
        11, "open loop, lag compensator",
        "Peaks at 50 Hz (zero) and 55 Hz (pole); the phase spike between them points up.",
        f"Zero at {zero:.1f} Hz, pole at {pole:.1f} Hz, 300 mA/V; gain margin {loop.margins().gain_up:.3f}.",
        figure,
        _number("zero", 50.0, zero, "Hz", 5.0),
        _number("pole", 55.0, pole, "Hz", 5.0),
        ("phase spike between them", "positive", f"{spike:+.0f} degrees", spike > 0),
    )  # fmt: skip


def loaded_open_loop() -> Drawing:
    """Figure 12."""
    loop, bare, cliff = at(lag(300.0), OUTER_END_MASS_KG), at(lag(300.0)), gain_cliff()
    (pole, zero), spike = pair_Hz(loop), phase_spike_deg(loop)
    moved_Hz = critical_gain(lag(300.0), OUTER_END_MASS_KG).frequency_Hz
    (onset_kg, onset_Hz), *_ = stable_masses(300.0, 0.0)
    curves = {"lag, 300 mA/V, 6.8 kg": loop, "without the mass": bare}
    figure, magnitude = _bode(curves, (pole, zero), "spike down, past -180 degrees")
    for name, frequency, side, aside in (("pole", pole, "right", -4), ("zero", zero, "left", 4)):
        note(magnitude, f"{name} {frequency:.1f} Hz", (frequency, magnitude.get_ylim()[0]), (aside, 6), side)
    answer = "stable" if loop.stable else "unstable"
    return _drawing(
        12, "open loop with 6.8 kg on the outer beam, unstable",
        "Pole and zero have changed places, the spike points down, and the loop is unstable at the same gain.",
        f"At 300 mA/V the model is {answer} with 6.8 kg; it is lost from {onset_kg:.2f} kg, at {onset_Hz:.1f} Hz.",
        figure,
        ("pole and zero change places", "pole below", f"pole {pole:.0f}, zero {zero:.0f} Hz", pole < zero),
        ("phase spike", "negative", f"{spike:+.0f} degrees", spike < 0),
        (
            "unstable at 300 mA/V with 6.8 kg", "unstable", f"lost from {onset_kg:.2f} kg, at {onset_Hz:.0f} Hz",
            not loop.stable,
        ),
        (
            "the oscillation moves to the outer beam's frequency", f"pole, {pole:.0f} Hz", f"{moved_Hz:.1f} Hz",
            abs(moved_Hz / pole - 1) < 0.05,
        ),
        _number("immediate loss of gain", 75.0, 100 * cliff.reduction, "%"),
    )  # fmt: skip


def loaded_compliance() -> Drawing:
    """Figure 13."""
    bare, limit = (critical_gain_mA_per_V(lag(10.0), mass) for mass in (0.0, OUTER_END_MASS_KG))
    printed, own = at(lag(10.0), OUTER_END_MASS_KG), at(lag(floor(limit)), OUTER_END_MASS_KG)
    return _drawing(
        13, "compliance with 6.8 kg at its largest gain",
        "The largest gain is 10 mA/V, 30 times lower than without the mass.",
        f"The model's largest gain is {limit:.1f} mA/V with fixed dashpots. The goal is met up to"
        f" {printed.bandwidth_Hz():.2f} Hz at 10 mA/V and {own.bandwidth_Hz():.2f} Hz at {floor(limit)} mA/V.",
        _compliance({"lag, 10 mA/V, 6.8 kg": printed, f"lag, {floor(limit)} mA/V, 6.8 kg": own}),
        _number("largest gain with 6.8 kg", 10.0, limit, "mA/V"),
        _number("lower than without the mass", 30.0, bare / limit, "times"),
    )  # fmt: skip


def relieved_compliance() -> Drawing:
    """Figure 14."""
    limit = critical_gain_mA_per_V(lag(200.0, INNER_END_MASS_KG), OUTER_END_MASS_KG)
    loaded = critical_gain_mA_per_V(lag(10.0), OUTER_END_MASS_KG)
    gain = floor(min(limit, 200.0))
    loop, bare = (at(lag(gain, INNER_END_MASS_KG), mass) for mass in (OUTER_END_MASS_KG, 0.0))
    edges = stable_masses(150.0, INNER_END_MASS_KG)
    return _drawing(
        14, "compliance with 6.8 kg outside and 4.5 kg inside",
        "4.5 kg inside allow 200 mA/V; the goal is met up to 8 Hz.",
        f"The model's largest gain is {limit:.1f} mA/V; at {gain} mA/V the goal is met up to"
        f" {loop.bandwidth_Hz():.2f} Hz. The remedy needs its payload: without it the loop is"
        f" {'stable' if bare.stable else 'unstable'} at that gain, and at 150 mA/V it is stable only between"
        f" {edges[0][0]:.3f} kg (crossing at {edges[0][1]:.0f} Hz) and {edges[1][0]:.2f} kg ({edges[1][1]:.0f} Hz).",
        _compliance({f"lag, {gain} mA/V, 6.8 kg outer, 4.5 kg inner": loop}, 8.0),
        _number("largest gain with 4.5 kg inside", 200.0, limit, "mA/V"),
        _number("gain regained", 20.0, limit / loaded, "times"),
        _number("goal met up to", 8.0, loop.bandwidth_Hz(), "Hz"),
    )  # fmt: skip


def _tested(
    number: int, title: str, claim: str, rig: Prototype, mass_kg: float, gain_mA_per_V: float, label: str, words: str
) -> Drawing:
    """Figures 15 and 16: linear curve of a measured case, the nonlinear rig's points (first harmonic) where it tested.

    `rig` is at the measured largest gain, with the 400 Hz filter; the gain of the tests is not printed.
    """
    loop, nonlinear = at(rig, mass_kg), with_published_effects(rig)
    own = critical_gain_mA_per_V(filtered_smaller_side(rig), mass_kg)
    linear = loop.compliance_response(np.array(TESTED_HZ))
    figure = _compliance({label: loop}, highest_dB=-25.0)
    axes = figure.axes[0]
    axes.axvspan(axes.get_xlim()[0], TESTED_HZ[-1], color="0.93", zorder=0)
    note(axes, "tested", (TESTED_HZ[-1], axes.get_ylim()[0]), (-5, 6), "right")
    off = []
    for force, marker, size in zip(FORCES_PEAK_TO_PEAK_N, "s^", (5, 8), strict=True):
        moved = [forced_motion(nonlinear, force / 2, f, mass_kg, harmonics=3).amplitude_m for f in TESTED_HZ]
        points = np.array(moved) / (force / 2)
        off.append(float(np.abs(points / np.abs(linear) - 1).max()))
        axes.plot(
            TESTED_HZ, points, marker, color="black", fillstyle="none", markersize=size,
            label=f"nonlinear rig, {force:g} N peak to peak",
        )  # fmt: skip
    axes.axhline(
        RESOLUTION_M / force, color="0.45", linewidth=1.0, linestyle="-.",
        label=f"resolution {1e6 * RESOLUTION_M:g} μm under {force:g} N peak to peak",
    )  # fmt: skip
    axes.legend(fontsize=8, loc="upper left")
    lead = np.degrees(np.angle(linear))
    bands = ((0.1, 10.0), (10.0, 100.0))
    low, middle = (np.abs(loop.compliance_response(np.geomspace(*ends, 200))).max() for ends in bands)
    fast = float(np.abs(loop.compliance_response(np.array([1000.0])))[0])
    hidden = abs(linear[TESTED_HZ.index(2.0)]) * force
    more = (
        (
            "below 2 Hz the motion is lost in noise", f"resolution {1e6 * RESOLUTION_M:g} um",
            f"{1e6 * hidden:.2g} um p-p under 500 N p-p at 2 Hz", hidden < RESOLUTION_M,
        ),
        _number("predicted static error under 100 N", 0.5, 1e8 * loop.static_compliance(), "um", 0.1),
    ) if number == 15 else ()  # fmt: skip
    return _drawing(
        number, title, claim,
        f"The test's gain is not printed: drawn at {gain_mA_per_V:g} mA/V, the measured limit, with the 400 Hz filter."
        f" {words}",
        figure,
        (
            "tests of 50 to 500 N p-p, 0 to 10 Hz, agree with the linear model", "well",
            f"nonlinear rig within {100 * max(off):.0f} %", max(off) < 0.1,
        ),
        (
            "displacement leads force", "lead",
            f"{lead.min():.0f} to {lead.max():.0f} degrees, {TESTED_HZ[0]:g} to {TESTED_HZ[-1]:g} Hz", lead.min() > 0,
        ),
        (
            "rejection better at 0 to 10 Hz than at 10 to 100 Hz", "considerably",
            f"worst {low:.2g} against {middle:.2g} m/N", low < middle / 2,
        ),
        ("bending minimal at high frequency", "minimal", f"{fast:.2g} m/N at 1000 Hz", fast < low),
        _number("largest gain, measured", gain_mA_per_V, own, "mA/V"),
        *more,
    )  # fmt: skip


def measured_compliance() -> Drawing:
    """Figure 15."""
    lead = np.degrees(np.angle(at(lag(200.0)).compliance_response(np.array([2.0, 10.0]))))
    return _tested(
        15, "predicted compliance for the tests without end mass",
        "Tests from 0 to 10 Hz agreed with the prediction, phase lead included; below 2 Hz noise hid the motion.",
        filtered(lag(200.0)), 0.0, 200.0, "lag, 200 mA/V, filter",
        f"Displacement leads force by {lead[0]:.0f} degrees at 2 Hz and {lead[1]:.0f} at 10 Hz. The measured points are"
        " not published as numbers; in their place stands the nonlinear rig, with orifices and unequal piston sides.",
    )  # fmt: skip


def measured_loaded_compliance() -> Drawing:
    """Figure 16."""
    rig = filtered(lag(150.0, INNER_END_MASS_KG))
    return _tested(
        16, "predicted compliance for the tests with 6.8 kg outside and 4.5 kg inside",
        "Tests agreed with the prediction.",
        rig, OUTER_END_MASS_KG, 150.0, "lag, 150 mA/V, 6.8 kg outer, 4.5 kg inner, filter",
        f"The goal is met up to {at(rig, OUTER_END_MASS_KG).bandwidth_Hz():.2f} Hz. Points: the nonlinear rig.",
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
    root_locus, proportional_compliance, lag_compliance, lag_open_loop, loaded_open_loop, loaded_compliance,
    relieved_compliance, measured_compliance, measured_loaded_compliance, gain_over_mass,
)  # fmt: skip
"""All figures, in the order of the page."""
NUMBERED = dict(enumerate(DRAWINGS[:-1], 8))
"""Those of them that have a number in the paper."""
