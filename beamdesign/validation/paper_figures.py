"""Figures 8 to 16 of the paper drawn again from the model, each with what the paper says about it, checked.

The paper's own curves are not reproduced: what it says about them in words is, and is marked; the words stand in
`paper.toml`. A number holds as a `Claim` agrees: within 5 % or the rounding of the print. What is said in words holds
where the model does the same.

The paper's measured points are lost. Where it measured, from 0 to 10 Hz under 50 to 500 N peak to peak, the response of
the nonlinear rig (orifices, unequal piston sides, the sensor's filter) stands in for them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from math import floor
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from beamdesign.loop import LoopAtMass, critical_gain
from beamdesign.plant.harmonic_balance import forced_motion
from beamdesign.plant.linear_reach import with_published_effects
from beamdesign.prototype import COMPLIANCE_LIMIT_M_PER_N, Prototype
from beamdesign.quantities import decibels, from_decibels
from beamdesign.report.canvas import new_figure, note
from beamdesign.report.figures import plot_compliance, plot_critical_gain, plot_loop_bode, plot_root_locus
from beamdesign.validation.paper_claims import CM_PER_100_N, Claim, FigureClaim, paper_words
from beamdesign.validation.paper_rig import (
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

_Drawn = tuple[Figure, dict[str, Any]]
"""A figure, and what is recomputed for the words about it."""
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
        title: what it shows, with the paper's figure number; written above the axes.
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

    def __post_init__(self) -> None:
        width, height = self.figure.get_size_inches()
        self.figure.set_size_inches(width, height + 0.2)
        self.figure.suptitle(self.title, fontsize=10)


def _with_words(number: int, draw: Callable[[], _Drawn]) -> Callable[[], Drawing]:
    """A figure of the paper, with what `paper.toml` says about it; its checks are written below the axes."""

    @wraps(draw)
    def drawn() -> Drawing:
        figure, known = draw()
        stated = next(one for one in paper_words()["figures"] if one["number"] == number)
        checks = tuple(FigureClaim(number, *_checked(check, known)) for check in stated["checks"])
        lines = [f"{'✓' if c.holds else '✗'} {c.claim}: paper {c.paper}; model {c.model}" for c in checks]
        figure.supxlabel("\n".join(lines), x=0.02, ha="left", fontsize=7.5, linespacing=1.4)
        width, height = figure.get_size_inches()
        figure.set_size_inches(width, height + 0.16 * len(lines))
        title, caption = f"Figure {number}: {stated['title']}", stated["caption"].format(**known)
        return Drawing(f"figure_{number:02}", title, stated["claim"], caption, figure, checks)

    return drawn


def _checked(check: Sequence[Any], known: Mapping[str, Any]) -> tuple[str, str, str, bool]:
    """What a check is about, paper, model, and whether it holds."""
    about, paper, *more = check
    if isinstance(paper, str):
        words, holds = more
        return about, paper.format(**known), words.format(**known), bool(known[holds])
    name, unit, digit = more
    agrees = Claim("", about, unit, paper, known[name], "", digit).agrees
    return about, f"{paper:g} {unit}".strip(), f"{known[name]:.3g} {unit}".strip(), agrees


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
    note(phase, words, (between, level), (-70, 0), "right", va="center", arrowprops=_ARROW)
    return figure, magnitude


def root_locus() -> _Drawn:
    """Figure 8."""
    limit = critical_gain(proportional(24.0))
    poles = np.sort(np.abs(at(proportional(24.0)).poles()))
    figure = new_figure(height_mm=115.0)
    whole, close = figure.subplots(1, 2, width_ratios=(3, 2))
    marked = {"12 mA/V": 12.0, "24 mA/V, paper's limit": 24.0, "48 mA/V": 48.0}
    for axes in (whole, close):
        plot_root_locus(axes, at(proportional(1.0)), [0.05, 60.0], marked)
    whole.set(xlim=(-175, 40), ylim=(-185, 185), xticks=[-150, -100, -50, 0])
    words = f"{1e3 * limit.gain_A_per_V:.1f} mA/V\n{limit.frequency_Hz:.0f} Hz"
    note(whole, words, (0.0, limit.frequency_Hz), (-52, -48), arrowprops=_ARROW)
    close.set(xlim=(-8, 1.6), ylim=(42, 57.5), ylabel="")
    close.set_title("the beams' pair", fontsize=9)
    close.legend(fontsize=8, loc="lower left")
    whole.get_legend().remove()
    return figure, {
        "limit": 1e3 * limit.gain_A_per_V,
        "limit_Hz": limit.frequency_Hz,
        "roots": float(len(poles)),
        "fastest": poles[-1],
        "times": poles[-1] / poles[-3],
        "fast": poles[-2] > 2 * poles[-3],
    }


def proportional_compliance() -> _Drawn:
    """Figure 9."""
    loop = at(proportional(24.0))
    slow, following = np.sort(np.abs(loop.open_loop_poles()))[:2]
    still = loop.static_compliance()
    return _compliance({"proportional, 24 mA/V": loop}, 4.0), {
        "bandwidth": loop.bandwidth_Hz(),
        "still": still,
        "still_dB": 20 * np.log10(still / COMPLIANCE_LIMIT_M_PER_N),
        "definite": 0 < still < COMPLIANCE_LIMIT_M_PER_N,
        "slow": slow,
        "following": following,
        "near": 0 < slow < 0.05 * following,
    }


def lag_compliance() -> _Drawn:
    """Figure 10."""
    loop, before = at(lag(300.0)), at(proportional(24.0))
    figure = _compliance({"lag, 300 mA/V": loop, "proportional, 24 mA/V": before}, 10.0)
    axes = figure.axes[0]
    known = {"bandwidth": loop.bandwidth_Hz(), "static_cm": CM_PER_100_N * loop.static_compliance()}
    for frequency, printed in ((0.5, 22), (2.0, 20), (20.0, 4)):
        low, high = (abs(one.compliance_response(np.array([frequency]))[0]) for one in (loop, before))
        gained = float(decibels(high) - decibels(low))
        axes.annotate("", (frequency, low), (frequency, high), arrowprops={"arrowstyle": "<->", "linewidth": 0.9})
        note(axes, f"{gained:.1f} dB (paper {printed})", (frequency, low), (5, -11), "left")
        known[f"better_{frequency:g}"] = gained
    above = float(lag_advantage_dB(np.geomspace(25.0, 100.0, 200)).max())
    return figure, known | {"above": above, "no_better": above < 0.5}


def lag_open_loop() -> _Drawn:
    """Figure 11."""
    loop = at(lag(300.0))
    (pole, zero), spike = pair_Hz(loop), phase_spike_deg(loop)
    figure, magnitude = _bode({"lag, 300 mA/V": loop}, (50.0, 55.0), "spike up")
    note(magnitude, "paper: 50 and 55 Hz", (50.0, magnitude.get_ylim()[0]), (-6, 6), "right")
    return figure, {"pole": pole, "zero": zero, "margin": loop.margins().gain_up, "spike": spike, "up": spike > 0}


def loaded_open_loop() -> _Drawn:
    """Figure 12."""
    loop, bare = at(lag(300.0), OUTER_END_MASS_KG), at(lag(300.0))
    (pole, zero), spike = pair_Hz(loop), phase_spike_deg(loop)
    moved_Hz = critical_gain(lag(300.0), OUTER_END_MASS_KG).frequency_Hz
    (onset_kg, onset_Hz), *_ = stable_masses(300.0, 0.0)
    curves = {"lag, 300 mA/V, 6.8 kg": loop, "without the mass": bare}
    figure, magnitude = _bode(curves, (pole, zero), "spike down, past -180 degrees")
    for name, frequency, side, aside in (("pole", pole, "right", -4), ("zero", zero, "left", 4)):
        note(magnitude, f"{name} {frequency:.1f} Hz", (frequency, magnitude.get_ylim()[0]), (aside, 6), side)
    return figure, {
        "answer": "stable" if loop.stable else "unstable",
        "unstable": not loop.stable,
        "onset_kg": onset_kg,
        "onset_Hz": onset_Hz,
        "pole": pole,
        "zero": zero,
        "below": pole < zero,
        "spike": spike,
        "down": spike < 0,
        "moved_Hz": moved_Hz,
        "moves": abs(moved_Hz / pole - 1) < 0.05,
        "lost": 100 * gain_cliff().reduction,
    }


def loaded_compliance() -> _Drawn:
    """Figure 13."""
    bare, limit = (critical_gain_mA_per_V(lag(10.0), mass) for mass in (0.0, OUTER_END_MASS_KG))
    printed, own = at(lag(10.0), OUTER_END_MASS_KG), at(lag(floor(limit)), OUTER_END_MASS_KG)
    figure = _compliance({"lag, 10 mA/V, 6.8 kg": printed, f"lag, {floor(limit)} mA/V, 6.8 kg": own})
    reached = {"printed_Hz": printed.bandwidth_Hz(), "own_Hz": own.bandwidth_Hz(), "own": floor(limit)}
    return figure, reached | {"limit": limit, "lower": bare / limit}


def relieved_compliance() -> _Drawn:
    """Figure 14."""
    limit = critical_gain_mA_per_V(lag(200.0, INNER_END_MASS_KG), OUTER_END_MASS_KG)
    loaded = critical_gain_mA_per_V(lag(10.0), OUTER_END_MASS_KG)
    gain = floor(min(limit, 200.0))
    loop, bare = (at(lag(gain, INNER_END_MASS_KG), mass) for mass in (OUTER_END_MASS_KG, 0.0))
    (from_kg, from_Hz), (to_kg, to_Hz), *_ = stable_masses(150.0, INNER_END_MASS_KG)
    return _compliance({f"lag, {gain} mA/V, 6.8 kg outer, 4.5 kg inner": loop}, 8.0), {
        "limit": limit,
        "gain": gain,
        "bandwidth": loop.bandwidth_Hz(),
        "answer": "stable" if bare.stable else "unstable",
        "from_kg": from_kg,
        "from_Hz": from_Hz,
        "to_kg": to_kg,
        "to_Hz": to_Hz,
        "regained": limit / loaded,
    }


def _tested(rig: Prototype, mass_kg: float, label: str) -> _Drawn:
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
    return figure, {
        "bandwidth": loop.bandwidth_Hz(),
        "off": 100 * max(off),
        "agree": max(off) < 0.1,
        "least_lead": lead.min(),
        "most_lead": lead.max(),
        "leads": lead.min() > 0,
        "low": low,
        "middle": middle,
        "better": low < middle / 2,
        "fast": fast,
        "minimal": fast < low,
        "largest": own,
        "hidden_um": 1e6 * hidden,
        "hidden": hidden < RESOLUTION_M,
        "static_um": 1e8 * loop.static_compliance(),
    }


def measured_compliance() -> _Drawn:
    """Figure 15."""
    figure, known = _tested(filtered(lag(200.0)), 0.0, "lag, 200 mA/V, filter")
    lead = np.degrees(np.angle(at(lag(200.0)).compliance_response(np.array([2.0, 10.0]))))
    return figure, known | {"unfiltered_2": lead[0], "unfiltered_10": lead[1]}


def measured_loaded_compliance() -> _Drawn:
    """Figure 16."""
    rig = filtered(lag(150.0, INNER_END_MASS_KG))
    return _tested(rig, OUTER_END_MASS_KG, "lag, 150 mA/V, 6.8 kg outer, 4.5 kg inner, filter")


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


_IN_ORDER = (
    root_locus, proportional_compliance, lag_compliance, lag_open_loop, loaded_open_loop, loaded_compliance,
    relieved_compliance, measured_compliance, measured_loaded_compliance,
)  # fmt: skip
NUMBERED = {number: _with_words(number, draw) for number, draw in enumerate(_IN_ORDER, start=8)}
"""Figures by their number in the paper."""
DRAWINGS = (*NUMBERED.values(), gain_over_mass)
"""All figures, in the order of the page."""
