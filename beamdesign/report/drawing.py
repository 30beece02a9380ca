"""A twin-beam prototype drawn to scale: cross-section at the clamp, and side view in section under the tip load."""

from typing import TYPE_CHECKING

import numpy as np

from beamdesign.prototype import Beam, Prototype
from beamdesign.report.canvas import note
from beamdesign.structure import beam, section
from beamdesign.structure.lumped import lumped_beam

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_OUTER, _INNER, _BASE, _LINE = "0.55", "#2a78b8", "0.8", "black"


def drawable(prototype: Prototype) -> bool:
    """Whether both beams have the geometry that a drawing needs."""
    return prototype.outer_beam.has_geometry and prototype.inner_beam.has_geometry


def draw_section(prototype: Prototype, axes: "Axes") -> "Axes":
    """Draw both tubes in cross-section, dimensioned in mm.

    Args:
        prototype: with the geometry of both beams.
        axes: to draw on; its scales become equal.

    Raises:
        ValueError: where a beam has no geometry.
    """
    outer_width, outer_wall = _tube_mm(prototype.outer_beam)
    inner_width, inner_wall = _tube_mm(prototype.inner_beam)
    _ring(axes, outer_width, outer_wall, prototype.outer_beam.corner_radius_m * 1e3, _OUTER)
    _ring(axes, inner_width, inner_wall, prototype.inner_beam.corner_radius_m * 1e3, _INNER)
    half, step = outer_width / 2, 0.13 * outer_width
    _dimension(axes, (-half, -half - step), (half, -half - step), f"{outer_width:.4g}", below=True)
    reach = inner_width / 2
    _dimension(axes, (-reach, -half - 2.4 * step), (reach, -half - 2.4 * step), f"{inner_width:.4g}", below=True)
    for x in (-reach, reach):
        axes.plot([x, x], [-reach, -half - 2.6 * step], color=_LINE, linewidth=0.4, linestyle=":")
    gap = section.clearance(outer_width, outer_wall, inner_width)
    for row, text in enumerate((f"outer wall {outer_wall:.3g}", f"inner wall {inner_wall:.3g}", f"gap {gap:.3g}")):
        axes.text(0, reach * (0.34 - 0.34 * row), text, ha="center", va="center", fontsize=7)
    axes.set_xlim(-half - step, half + step)
    axes.set_ylim(-half - 4 * step, half + step)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title("Section, mm", fontsize=9)
    return axes


def draw_side(prototype: Prototype, tip_force_N: float, axes: "Axes", servo_on: bool = True) -> "Axes":
    """Draw the lengthwise section of the rig under the tip load, all of it to one scale, deflections too.

    The tips lie in one plane; each beam is clamped from the end of its free length back to the end of its tube. With
    the servo on the outer beam is held straight and the inner one bends under the whole load; with the servo off the
    outer one carries it alone.

    Args:
        prototype: with the geometry of both beams, lengths included.
        tip_force_N: transverse force on the outer tip, downwards.
        axes: to draw on, in mm; its scales become equal.
        servo_on: which of the two load cases to draw.

    Raises:
        ValueError: where a beam has no geometry.
    """
    outer, inner = prototype.outer_beam, prototype.inner_beam
    outer_width, outer_wall = _tube_mm(outer)
    inner_width, inner_wall = _tube_mm(inner)
    bent = inner if servo_on else outer
    deflection = tip_force_N / lumped_beam(bent).stiffness * 1e3
    for tube, width, wall, colour in (
        (outer, outer_width, outer_wall, _OUTER),
        (inner, inner_width, inner_wall, _INNER),
    ):
        full, free = _lengths_mm(tube)
        x = np.concatenate([[-full], np.linspace(-free, 0.0, 60)])
        sag = deflection * beam.static_shape((x + free).clip(min=0.0) / free) if tube is bent else np.zeros_like(x)
        for side in (-1, 1):
            edges = np.array([side * width / 2, side * (width / 2 - wall)])
            axes.fill_between(x, edges.min() - sag, edges.max() - sag, color=colour, linewidth=0)
        if tube is bent:
            for side in (-1, 1):
                axes.plot([-full, 0], [side * width / 2] * 2, color=_LINE, linewidth=0.5, linestyle=(0, (6, 4)))
    _clamps(axes, prototype)
    _load(axes, outer_width / 2 - (0 if servo_on else deflection), outer_width, tip_force_N)
    gap = section.clearance(outer_width, outer_wall, inner_width)
    which, left = ("inner", "straight") if servo_on else ("outer", "unloaded")
    other = "outer" if servo_on else "inner"
    axes.set_title(
        f"Servo {'on' if servo_on else 'off'}: {which} tip down by {deflection:.3g} mm, {other} beam {left};"
        f" gap left {gap - deflection:.3g} of {gap:.3g} mm",
        fontsize=9,
        loc="left",
    )
    longest = max(_lengths_mm(outer)[0], _lengths_mm(inner)[0])
    axes.set_xlim(-1.04 * longest, 0.1 * longest)
    axes.set_ylim(-1.48 * outer_width, 1.35 * outer_width)
    axes.set_aspect("equal")
    axes.set_axis_off()
    return axes


def _tube_mm(tube: Beam) -> tuple[float, float]:
    if tube.width_m is None or tube.wall_m is None:
        raise ValueError("a drawing needs the width and the wall of both beams")
    return tube.width_m * 1e3, tube.wall_m * 1e3


def _lengths_mm(tube: Beam) -> tuple[float, float]:
    """Full and free length; a tube of unknown full length ends a tenth behind its clamp."""
    if tube.free_length_m is None:
        raise ValueError("a drawing needs the free length of both beams")
    full = tube.length_m if tube.length_m is not None else 1.1 * tube.free_length_m
    return full * 1e3, tube.free_length_m * 1e3


def _ring(axes: "Axes", width: float, wall: float, radius: float, colour: str) -> None:
    outside = _rounded_square(width / 2, radius)
    inside = _rounded_square(width / 2 - wall, max(radius - wall, 0.0))
    # One closed line: round the outside, across the wall, and back round the inside.
    line = np.concatenate([outside, inside[::-1]])
    axes.fill(line[:, 0], line[:, 1], color=colour, linewidth=0)


def _rounded_square(half: float, radius: float) -> np.ndarray:
    """Points (n, 2) round a square of side 2 `half`, its corners rounded, the first point repeated at the end."""
    quarter = np.linspace(0, np.pi / 2, 9)
    corner = half - radius
    points = []
    for k, (x, y) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        angle = quarter + k * np.pi / 2
        points.append(np.column_stack([x * corner + radius * np.cos(angle), y * corner + radius * np.sin(angle)]))
    return np.concatenate([*points, points[0][:1]])


def _dimension(axes: "Axes", start: tuple[float, float], end: tuple[float, float], text: str, below: bool) -> None:
    axes.annotate(
        "", start, end, arrowprops={"arrowstyle": "<|-|>", "color": _LINE, "linewidth": 0.6, "shrinkA": 0, "shrinkB": 0}
    )
    middle = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
    note(axes, text, middle, (0, -2 if below else 2), va="top" if below else "bottom")


def _clamps(axes: "Axes", prototype: Prototype) -> None:
    """The base around the clamped part of the outer tube, the plug that holds the inner one, and the free lengths."""
    from matplotlib.patches import Rectangle

    outer_width, outer_wall = _tube_mm(prototype.outer_beam)
    inner_width, _ = _tube_mm(prototype.inner_beam)
    outer_full, outer_free = _lengths_mm(prototype.outer_beam)
    inner_full, inner_free = _lengths_mm(prototype.inner_beam)
    thick = 0.22 * outer_width
    gap = section.clearance(outer_width, outer_wall, inner_width)
    blocks = [(-outer_full, outer_full - outer_free, side * outer_width / 2, side * thick) for side in (-1, 1)]
    blocks += [(-inner_full, inner_full - inner_free, side * inner_width / 2, side * gap) for side in (-1, 1)]
    for x, length, y, height in blocks:
        axes.add_patch(Rectangle((x, y), length, height, facecolor=_BASE, edgecolor=_LINE, linewidth=0.4, hatch="////"))
    low = -outer_width / 2 - thick
    for free, drop in ((outer_free, 0.28), (inner_free, 0.68)):
        y = low - drop * outer_width
        _dimension(axes, (-free, y), (0, y), f"{free:.4g}", below=False)
    axes.plot([0, 0], [low - 0.73 * outer_width, -outer_width / 2], color=_LINE, linewidth=0.4, linestyle=":")


def _load(axes: "Axes", tip: float, width: float, force: float) -> None:
    axes.annotate(
        f"{force:.4g} N",
        (0, tip),
        xytext=(0, tip + 0.55 * width),
        arrowprops={"arrowstyle": "-|>", "color": _LINE, "linewidth": 1.2, "shrinkB": 0},
        ha="center",
        fontsize=8,
    )
