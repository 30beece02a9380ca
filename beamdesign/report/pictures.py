"""The pictures of a certified prototype, each a figure with its caption, for reports of any format."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from beamdesign.loop import Loop
from beamdesign.prototype import Prototype
from beamdesign.report.acceptance import representative_masses
from beamdesign.report.canvas import new_figure
from beamdesign.report.drawing import draw_section, draw_side
from beamdesign.report.figures import (
    plot_compliance,
    plot_loop_bode,
    plot_root_locus,
    plot_sensitivity,
    shade_compliance,
)
from beamdesign.report.quantity import at_least, decimal, mass_range_text, quantity
from beamdesign.report.stability_chart import plot_pole_paths, plot_stable_gains, plot_stable_ranges, wider_map
from beamdesign.report.trade_rows import TradePoint, plot_trade

FAMILY = 41
"""Masses of the range whose compliances are shaded."""

LOCUS_GAIN = 10.0
"""Largest gain of the root locus over that of the design."""


@dataclass(frozen=True)
class Picture:
    """One figure with what stands below it.

    Attributes:
        name: a word, unique among the pictures of a report.
        figure: to be saved or shown inline.
        caption: what to see in it.
    """

    name: str
    figure: Figure
    caption: str


def prototype_picture(prototype: Prototype, tip_force_N: float) -> Picture:
    """Section and both load cases, to scale."""
    figure = new_figure(190, 88)
    axes = figure.subplot_mosaic([["section", "on"], ["section", "off"]], width_ratios=[1.0, 3.4])
    draw_section(prototype, axes["section"])
    draw_side(prototype, tip_force_N, axes["on"], servo_on=True)
    draw_side(prototype, tip_force_N, axes["off"], servo_on=False)
    return Picture(
        "prototype",
        figure,
        "Drawn to scale, deflections too (not exaggerated); lengths in mm. Dashed: where the loaded beam lies without"
        " the load. Hatched: the base, and the plug that clamps the inner beam.",
    )


def loop_pictures(prototype: Prototype, loop: Loop) -> list[Picture]:
    """Compliance, sensitivity, loop, poles, stable ranges and stable gains over the payload range.

    Raises:
        ValueError: without a controller or a range of outer end masses.
    """
    bounds, controller = prototype.payload.outer_end_mass_kg, prototype.controller
    if bounds is None or controller is None:
        raise ValueError("the pictures need [controller] and payload.outer_end_mass_kg")
    goal, span = prototype.goal, mass_range_text(bounds)
    curves = {f"{decimal(mass)} kg": loop.at(mass) for mass in representative_masses(bounds)}

    compliance = new_figure(150, 95)
    family = [loop.at(float(mass)) for mass in np.linspace(*bounds, FAMILY)]
    axes = shade_compliance(compliance.subplots(), family, f"{FAMILY} masses of {span}")
    plot_compliance(axes, curves, goal.compliance_m_per_N)
    axes.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
    guarantee = prototype.guarantee
    promised = ""
    if guarantee and guarantee.outer_end_mass_kg == bounds:
        axes.plot(
            [axes.get_xlim()[0], guarantee.bandwidth_Hz],
            [goal.compliance_m_per_N] * 2,
            color="black",
            linewidth=3,
            solid_capstyle="butt",
        )
        promised = (
            f" The thick line is proved: for every mass of {span} no curve passes above it, up to"
            f" {at_least(guarantee.bandwidth_Hz, 'Hz')}."
        )
    pictures = [
        Picture(
            "compliance",
            compliance,
            "Closed-loop compliance, displacement of the outer tip per disturbance force on it, for masses on the outer"
            f" tip; dots where each curve first passes the limit. Shaded: between the least and the largest at {FAMILY}"
            f" masses of the range, drawn and not proved.{promised}",
        )
    ]

    sensitivity = new_figure(150, 75)
    plot_sensitivity(sensitivity.subplots(), curves, goal.peak_sensitivity)
    pictures.append(
        Picture(
            "sensitivity", sensitivity, "Sensitivity |1/(1+L)|: how much the loop amplifies where it does not help."
        )
    )

    bode = new_figure(150, 115)
    upper, lower = bode.subplots(2, 1, sharex=True)
    plot_loop_bode(upper, lower, curves)
    pictures.append(Picture("loop", bode, "The loop transfer function L."))

    poles = new_figure(150, 90)
    plot_pole_paths(poles.subplots(), loop, *bounds)
    pictures.append(
        Picture("poles", poles, f"Closed-loop poles as the outer end mass goes from {span}: computed at the dots.")
    )

    locus = new_figure(150, 88)
    panels = locus.subplots(1, 2, sharex=True, sharey=True)
    reach = max(_locus_reach(loop, mass) for mass in bounds)
    for panel, mass in zip(panels, bounds, strict=True):
        _draw_locus(panel, loop, mass, reach)
    panels[1].set_ylabel("")
    panels[1].get_legend().remove()
    pictures.append(
        Picture(
            "locus",
            locus,
            f"Root locus: closed-loop poles as the gain goes from none to {LOCUS_GAIN:g} times this design's, with"
            f" {bounds[0]:g} kg and {bounds[1]:g} kg on the outer tip. Squares: at this design's gain of"
            f" {quantity(controller.gain_A_per_V, 'A/V')}. Left of the dashed line is stable; poles faster than"
            f" {decimal(reach / (2 * np.pi), 3)} Hz lie outside.",
        )
    )

    wide = wider_map(loop, *bounds)
    ranges = new_figure(150, 48)
    plot_stable_ranges(ranges.subplots(), {"": wide}, bounds)
    pictures.append(
        Picture(
            "ranges",
            ranges,
            "Stable and unstable masses on the outer tip, exact, beyond the range asked for as well; where the verdict"
            " changes a pole pair crosses the axis at the frequency given.",
        )
    )

    gains = new_figure(150, 85)
    end = int(wide.ranges[-1].high.p) / int(wide.ranges[-1].high.q)
    plot_stable_gains(
        gains.subplots(), loop, controller.gain_A_per_V, [float(m) for m in np.linspace(0, end, 121)], bounds
    )
    pictures.append(
        Picture(
            "gains",
            gains,
            "Stable gains over the outer end mass with this design's breaks and inner end mass: exact at 121 masses,"
            " joined by lines.",
        )
    )
    return pictures


def trade_picture(points: tuple[TradePoint, ...], bandwidth_Hz: float, moving_mass_kg: float) -> Picture:
    """Proved designs of a front beside this one."""
    figure = new_figure(150, 85)
    plot_trade(figure.subplots(), points, (bandwidth_Hz, moving_mass_kg))
    return Picture(
        "trade",
        figure,
        "Lightest proved designs over the bandwidth they guarantee, sections, end mass and controller chosen together;"
        " points are proved, the lines between them are not.",
    )


def _locus_reach(loop: Loop, mass_kg: float) -> float:
    """Somewhat beyond the fastest oscillation at which the loop is lost within the gains drawn, rad/s."""
    lost = [c.frequency_Hz for c in loop.at(mass_kg).gain_crossings() if 0 < c.value < LOCUS_GAIN]
    slow = [abs(pole.imag) / (2 * np.pi) for pole in loop.at(mass_kg).poles()]
    return 1.35 * 2 * np.pi * max(lost or [1.0, *slow])


def _draw_locus(axes: Axes, loop: Loop, mass_kg: float, reach: float) -> None:
    """The upper half of a root locus at one mass, up to `reach` in rad/s."""
    at = loop.at(mass_kg)
    factors = np.concatenate([np.geomspace(1e-3, 1.0, 120), np.geomspace(1.0, LOCUS_GAIN, 90)[1:]])
    plot_root_locus(axes, at, [float(factor) for factor in factors], {"this gain": 1.0})
    axes.set_xlim(-0.7 * reach, 0.25 * reach)
    axes.set_ylim(-0.04 * reach, reach)
    axes.set_title(f"{decimal(mass_kg)} kg outside", fontsize=9)
