"""The pictures of a certified prototype, each a figure with its caption, for reports of any format."""

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from beamdesign.loop import Loop
from beamdesign.prototype import Prototype
from beamdesign.report.acceptance import representative_masses
from beamdesign.report.canvas import new_figure
from beamdesign.report.drawing import draw_section, draw_side
from beamdesign.report.figures import plot_compliance, plot_loop_bode, plot_sensitivity
from beamdesign.report.quantity import at_least, decimal, mass_range_text
from beamdesign.report.stability_chart import plot_pole_paths, plot_stable_gains, plot_stable_ranges, wider_map


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
        "Drawn to scale, deflections too; lengths in mm. Dashed: where the loaded beam lies without the load. Hatched:"
        " the base, and the plug that clamps the inner beam.",
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
    axes = plot_compliance(compliance.subplots(), curves, goal.compliance_m_per_N)
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
            f" tip; dots where each curve first passes the limit.{promised}",
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
    end = float(wide.ranges[-1].high.p) / float(wide.ranges[-1].high.q)
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
