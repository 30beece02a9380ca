"""The pictures of a certified prototype, each a figure with its caption, for reports of any format.

Their charts of what is stable over the outer end mass are exact: ranges on one axis, gains over mass.
"""

from collections.abc import Mapping, Sequence
from decimal import ROUND_FLOOR
from itertools import pairwise
from math import asin, degrees, inf, isfinite
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from beamdesign.loop import Loop, LoopAtMass
from beamdesign.polynomial import exact, is_hurwitz, nearest
from beamdesign.proofs.stability import StabilityMap, stable_ranges
from beamdesign.prototype import Guarantee, InStage, Prototype
from beamdesign.quantities import decimal, masses_text, quantity, read_in, rigs_in_words, stated_bandwidth
from beamdesign.report import figures
from beamdesign.report.canvas import LIMIT, finish, new_figure, note
from beamdesign.report.charts import TradePoint, plot_stable_bands, plot_trade
from beamdesign.report.drawing import draw_section, draw_side

FAMILY = 41
"""Masses of the range whose compliances are shaded, and whose poles are drawn."""

_STABLE = "0.72"
"""Grey of what is stable."""

LOCUS_GAIN = 10.0
"""Largest gain of the root locus over that of the design."""


class CaptionedFigure(NamedTuple):
    """One figure with what stands below it.

    Attributes:
        name: a word, unique among the pictures of a report.
        figure: to be saved or shown inline.
        caption: what to see in it.
    """

    name: str
    figure: Figure
    caption: str


def prototype_picture(prototype: Prototype, tip_force_N: float) -> CaptionedFigure:
    """Section and both load cases, to scale."""
    figure = new_figure(190, 88)
    axes = figure.subplot_mosaic([["section", "on"], ["section", "off"]], width_ratios=[1.0, 3.4])
    draw_section(prototype, axes["section"])
    draw_side(prototype, tip_force_N, axes["on"], servo_on=True)
    draw_side(prototype, tip_force_N, axes["off"], servo_on=False)
    return CaptionedFigure(
        "prototype",
        figure,
        "Drawn to scale, deflections too (not exaggerated); lengths in mm. Dashed: where the loaded beam lies without"
        " the load. Hatched: the base, and the plug that clamps the inner beam.",
    )


def loop_pictures(prototype: Prototype, loop: Loop) -> list[CaptionedFigure]:
    """Compliance, sensitivity, the loop by Bode and by Nyquist, poles, stable masses and stable gains over the payload.

    Raises:
        ValueError: without a controller or a range of outer end masses.
    """
    bounds, controller = prototype.payload.outer_end_mass_kg, prototype.controller
    if bounds is None or controller is None:
        raise ValueError("the pictures need [controller] and payload.outer_end_mass_kg")
    goal, span = prototype.goal, masses_text(bounds)
    ends = tuple(dict.fromkeys(bounds))
    curves = {f"{decimal(mass)} kg": loop.at(mass) for mass in InStage(prototype, bounds).looked_at_kg}

    pictures: list[CaptionedFigure] = []

    def framed(name: str, height_mm: float, caption: str, rows: int = 1, columns: int = 1) -> list[Axes]:
        """The axes of a further picture."""
        figure = new_figure(150, height_mm)
        pictures.append(CaptionedFigure(name, figure, caption))
        found = figure.subplots(rows, columns, sharex=True, sharey=columns > 1, squeeze=False)
        return [axes for row in found for axes in row]

    proved = own if (own := prototype.guarantee) and own.outer_end_mass_kg == bounds else None
    caption = (
        "Closed-loop compliance, displacement of the outer tip per disturbance force on it, for masses on the outer"
        " tip; dots where each curve first passes the limit. In colour, with the largest mass: the same rig with its"
        " servo off, which asks for no current; and, where sections are stated, one tube of the outer one's width,"
        " material and length that weighs as much as both tubes together."
    )
    if proved is not None:
        caption += (
            f" The thick line is proved for {rigs_in_words(proved.sigmas)}: with the servo on and every mass of"
            f" {span} no curve passes above it, up to {stated_bandwidth(proved.bandwidth_Hz)}; of the law and the"
            f" figures that stand in {proved.certificate}."
        )
    if len(ends) > 1:
        caption += f" Shaded: between the least and the largest at {FAMILY} masses of the range, drawn and not proved."
    (axes,) = framed("compliance", 105, caption)
    if len(ends) > 1:
        family = [loop.at(float(mass)) for mass in np.linspace(*bounds, FAMILY)]
        figures.shade_compliance(axes, family, f"{FAMILY} masses of {span}")
    figures.plot_compliance(axes, curves, goal.compliance_m_per_N, beside=figures.passive_curves(prototype, bounds[1]))
    axes.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
    if proved is not None:
        line = [axes.get_xlim()[0], proved.bandwidth_Hz], [goal.compliance_m_per_N] * 2
        axes.plot(*line, color="black", linewidth=3, solid_capstyle="butt")

    (axes,) = framed("sensitivity", 75, "Sensitivity |1/(1+L)|: how much the loop amplifies where it does not help.")
    figures.plot_sensitivity(axes, curves, goal.peak_sensitivity)

    caption = (
        "The loop transfer function L of the nominal rig. Dots: where |L| = 1. Bars, at the ends of the payload: the"
        " gain margin, and the phase margin at the crossover where it is least."
    )
    upper, lower = framed("loop", 125, caption, rows=2)
    figures.plot_loop_bode(upper, lower, curves, marked=[f"{decimal(mass)} kg" for mass in bounds])

    caption = "L of the nominal rig about the point -1, marked +; dots: nearest to it, 1 over the peak sensitivity."
    peak = goal.peak_sensitivity if proved is None else proved.peak_sensitivity
    if proved is not None and peak > 1:
        gain, phase = (decimal(one, 3, ROUND_FLOOR) for one in (peak / (peak - 1), degrees(2 * asin(0.5 / peak))))
        caption += (
            f" Shaded: no L enters this disc, proved for {rigs_in_words(proved.sigmas)} and every mass of {span}; so"
            f" each has a gain margin of at least {gain} and a phase margin of at least {phase}°."
        )
    (axes,) = framed("nyquist", 82, caption)
    figures.plot_nyquist(axes, curves, peak)
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)

    reach = max(_locus_reach(loop.at(mass)) for mass in ends)
    faster = f"poles faster than {decimal(reach, 3)} Hz"
    goes = f"as the outer end mass goes from {span}: computed at the dots" if len(ends) > 1 else f"with {span} outside"
    plot_pole_paths(framed("poles", 90, f"Closed-loop poles {goes}; {faster} are left out.")[0], loop, *bounds, reach)

    caption = (
        f"Root locus: closed-loop poles as the gain goes from none to {LOCUS_GAIN:g} times this design's, with"
        f" {' and '.join(f'{mass:g} kg' for mass in ends)} on the outer tip. Squares: at this design's gain of"
        f" {quantity(controller.gain_A_per_V, 'A/V')}. Left of the dashed line is stable; {faster} lie outside."
    )
    panels, factors = framed("locus", 88, caption, columns=len(ends)), np.geomspace(1e-3, LOCUS_GAIN, 41).tolist()
    for panel, mass in zip(panels, ends, strict=True):
        figures.plot_root_locus(panel, loop.at(mass), factors, {"this gain": 1.0})
        panel.set(xlim=(-0.7 * reach, 0.25 * reach), ylim=(-0.04 * reach, reach))
        panel.xaxis.set_major_locator(MaxNLocator(4))  # two panels share the width
        panel.set_title(f"{decimal(mass)} kg outside", fontsize=9)
    for panel in panels[1:]:
        panel.set_ylabel("")
        if (legend := panel.get_legend()) is not None:  # it says what the first one does
            legend.remove()

    wide = wider_map(loop, *bounds)
    caption = (
        "Stable and unstable masses on the outer tip, exact, beyond the range asked for as well; where the verdict"
        " changes a pole pair crosses the axis at the frequency given."
    )
    plot_stable_ranges(framed("ranges", 48, caption)[0], {"": wide}, bounds)

    masses = [float(mass) for mass in np.linspace(0, nearest(wide.ranges[-1].high), 121)]
    caption = (
        "Stable gains over the outer end mass with this design's breaks and inner end mass: exact at 121 masses"
        " and where a range of gains begins or ends, joined by lines."
    )
    plot_stable_gains(framed("gains", 85, caption)[0], loop, controller.gain_A_per_V, masses, bounds)
    return pictures


def trade_picture(points: tuple[TradePoint, ...], guarantee: Guarantee, moving_mass_kg: float) -> CaptionedFigure:
    """Proved designs of a front beside this one."""
    figure = new_figure(150, 85)
    plot_trade(figure.subplots(), points, (guarantee.bandwidth_Hz, moving_mass_kg))
    of = {point.sigmas for point in points if point.sigmas is not None}
    rigs = f" for {' or '.join(rigs_in_words(sigmas) for sigmas in sorted(of))}" if of else ""
    other = "" if of <= {guarantee.sigmas} else f", this design for {rigs_in_words(guarantee.sigmas)}"
    return CaptionedFigure(
        "trade",
        figure,
        "Lightest proved designs over the bandwidth they guarantee, sections, end mass and controller chosen together;"
        f" points are proved{rigs}{other}, the lines between them are not.",
    )


def _locus_reach(loop: LoopAtMass) -> float:
    """Somewhat beyond the fastest oscillation at which the loop is lost within the gains drawn, Hz.

    Where none of them loses it, beyond the oscillation at the least gain that does; where no gain does, beyond all.
    """
    crossings = [c for c in loop.gain_crossings() if 0 < c.value < inf]
    lost = [c for c in crossings if c.value < LOCUS_GAIN] or crossings[:1]
    oscillations = [c.frequency_Hz for c in lost] or [abs(pole.imag) / (2 * np.pi) for pole in loop.poles()]
    return 1.35 * max([1.0, *oscillations])


def wider_map(loop: Loop, low: float, high: float) -> StabilityMap:
    """What is stable from no mass to well beyond a range: up to the first crossing above it, or three times its end."""
    inside = stable_ranges(loop.characteristic, exact(low), exact(high))
    beyond = inside.above.value if inside.above is not None and isfinite(inside.above.value) else inf
    end = 1.25 * beyond if beyond < 8 * max(high, 1.0) else 3 * max(high, 1.0)
    return stable_ranges(loop.characteristic, exact(0.0), exact(float(f"{end:.3g}")))


def plot_stable_ranges(axes: Axes, maps: Mapping[str, StabilityMap], asked_kg: tuple[float, float]) -> Axes:
    """Bars over the outer end mass: grey where stable, hatched where not; crossings marked with mass and frequency.

    Args:
        axes: drawn on, in kg.
        maps: exact maps by label, from the top.
        asked_kg: the range that had to be stable, marked by a bracket line under each bar.
    """
    for row, found in enumerate(maps.values()):
        for part in found.ranges:
            low, high = nearest(part.low), nearest(part.high)
            words, colour, hatch = ("stable", _STABLE, None) if part.stable else ("unstable", "white", "////")
            edge: dict[str, Any] = {"edgecolor": "black", "linewidth": 0.6, "hatch": hatch}
            axes.barh(-row, high - low, left=low, height=0.5, color=colour, **edge)
            if high - low > 0.12 * (nearest(found.high) - nearest(found.low)):
                box = {"facecolor": colour, "edgecolor": "none", "pad": 1.5}
                axes.text((low + high) / 2, -row, words, ha="center", va="center", fontsize=8, bbox=box)
        crossings = [crossing for crossing in found.crossings if crossing.finite]
        places = [-inf, *(crossing.value for crossing in crossings), inf]
        near = 0.13 * nearest(found.high)
        for before, crossing, after in zip(places, crossings, places[2:], strict=False):
            axes.plot([crossing.value] * 2, [-row - 0.25, -row + 0.33], color="black", linewidth=1.2)
            words = f"{crossing.value:.4g} kg\n{crossing.frequency_Hz:.3g} Hz"
            crowded = crossing.value - before < near, after - crossing.value < near
            aside = {(True, False): "left", (False, True): "right"}.get(crowded, "center")  # two stand back to back
            note(axes, words, (crossing.value, -row + 0.33), (0, 1), aside, va="bottom")
        axes.plot(asked_kg, [-row - 0.34] * 2, "|-", color="black", linewidth=1.6, markersize=7)
    note(axes, "range asked for", (sum(asked_kg) / 2, -len(maps) + 1 - 0.34), (0, -3), va="top")
    end = max(nearest(found.high) for found in maps.values())
    axes.set(xlim=(-0.015 * end, 1.015 * end), ylim=(-len(maps) + 1 - 0.75, 0.85))
    axes.set_yticks([-row for row in range(len(maps))], list(maps), fontsize=8)
    axes.tick_params(left=False)
    for side in ("left", "right", "top"):
        axes.spines[side].set_visible(False)
    axes.set_xlabel("outer end mass, kg")
    return axes


def stable_gains(loop: Loop, mass_kg: float) -> list[tuple[float, float]]:
    """Intervals of factors on the gain in which the loop is stable at one outer end mass: exact, not swept.

    Args:
        loop: at factor 1.
        mass_kg: the outer end mass.

    Returns:
        Disjoint intervals of positive factors, ascending; the last may be unbounded.
    """
    here = loop.at(mass_kg)
    edges = [0.0, *(c.value for c in here.gain_crossings() if 0 < c.value < inf), inf]
    stable = []
    for start, end in pairwise(edges):
        inside = (start + end) / 2 if end < inf else 2 * start + 1
        if end > start and is_hurwitz(here.loop_denominator + here.loop_numerator * exact(inside)):
            stable.append((start, end))
    return stable


def _stable_over(loop: Loop, masses_kg: Sequence[float]) -> dict[float, list[tuple[float, float]]]:
    """Stable factors by mass: at each one, and ever closer to where an interval appears or vanishes between two."""
    found = {mass: stable_gains(loop, mass) for mass in masses_kg}
    pairs, least = list(pairwise(masses_kg)), 1e-9 * (masses_kg[-1] - masses_kg[0])
    while pairs:
        low, high = pairs.pop()
        if len(found[low]) != len(found[high]) and high - low > least:
            middle = (low + high) / 2
            found[middle] = stable_gains(loop, middle)
            pairs += [(low, middle), (middle, high)]
    return found


def plot_stable_gains(
    axes: Axes, loop: Loop, gain_A_per_V: float, masses_kg: Sequence[float], asked_kg: tuple[float, float] | None
) -> Axes:
    """The region of stable gains over the outer end mass, with the chosen gain over the range that had to be stable.

    Args:
        axes: drawn on: kg, and mA/V or A/V.
        loop: the loop at the chosen gain.
        gain_A_per_V: the chosen gain.
        masses_kg: ascending; the region's edge is exact at each of them, and at more where an interval of gains ends,
            and joined by lines.
        asked_kg: the range that had to be stable.
    """
    unit, factor = read_in(gain_A_per_V, "A/V")
    gain = factor * gain_A_per_V
    found = _stable_over(loop, masses_kg)
    limits = [gain * edge for intervals in found.values() for pair in intervals for edge in pair if 0 < edge < inf]
    least, most = min([gain / 3, *(0.5 * edge for edge in limits)]), max([gain * 3, *(1.5 * edge for edge in limits)])
    least = max(least, gain / 30)
    low, high = ([[gain * pair[end] for pair in pairs] for pairs in found.values()] for end in (0, 1))
    edge, within = {"color": "black", "linewidth": 1.0}, (least / 10, most * 10)
    plot_stable_bands(axes, list(found), low, high, "stable", edge, _STABLE, within)
    span = asked_kg or (masses_kg[0], masses_kg[-1])
    axes.plot(span, [gain, gain], "|--", color="black", linewidth=1.4, markersize=9, label=f"gain {gain:.4g} {unit}")
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(lambda value, position: f"{value:g}")
    axes.yaxis.set_minor_locator(NullLocator())
    axes.set(ylim=(least, most), xlim=(masses_kg[0], masses_kg[-1]))
    axes.set(xlabel="outer end mass, kg", ylabel=f"gain, {unit}")
    axes.legend(fontsize=8, loc="best")  # no grid over the shading
    return axes


def plot_pole_paths(axes: Axes, loop: Loop, low_kg: float, high_kg: float, reach_Hz: float = inf) -> Axes:
    """Closed-loop poles in the upper half plane as the outer end mass goes through its range.

    Args:
        axes: drawn on, in Hz.
        loop: the closed loop.
        low_kg: least mass, marked by circles.
        high_kg: largest mass, marked by squares; may be the same.
        reach_Hz: distance from the origin up to which poles are drawn.
    """
    whole = (loop.at(mass).poles() / (2 * np.pi) for mass in np.linspace(low_kg, high_kg, FAMILY))
    paths = [poles[(poles.imag >= 0) & (np.abs(poles) <= reach_Hz)] for poles in whole]
    track = np.concatenate(paths)
    axes.plot(track.real, track.imag, ".", color="0.45", markersize=2.5)
    ends = {low_kg: (paths[0], "o")} | ({high_kg: (paths[-1], "s")} if high_kg > low_kg else {})
    for mass, (poles, marker) in ends.items():
        style: dict[str, Any] = {"color": "black", "markersize": 5, "fillstyle": "none"}
        axes.plot(poles.real, poles.imag, marker, label=f"{mass:g} kg", **style)
    axes.axvline(0.0, **LIMIT)
    axes.set_ylim(bottom=-0.04 * axes.get_ylim()[1])
    return finish(axes, "real part, Hz (stable to the left of the line)", "imaginary part, Hz")
