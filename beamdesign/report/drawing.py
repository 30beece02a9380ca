"""A twin-beam prototype drawn to scale: cross-section at the clamp, and side view in section under the tip load."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beamdesign.prototype import Beam, Prototype
from beamdesign.report.canvas import note
from beamdesign.structure import beam, section
from beamdesign.structure.lumped import lumped_beam

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_OUTER, _INNER, _BASE, _LINE = "0.55", "#2a78b8", "0.8", "black"


_SHOWN_BEHIND = 0.1
"""A tube whose cut length is not given is drawn this share of its free length into its clamp, and not dimensioned."""


@dataclass(frozen=True)
class Tube:
    """One tube in mm; `cut` is None where the prototype does not give it."""

    width: float
    wall: float
    radius: float
    free: float
    cut: float | None

    @property
    def back(self) -> float:
        """Where it ends, behind the tip at 0."""
        return -(self.cut if self.cut is not None else (1 + _SHOWN_BEHIND) * self.free)


def tubes_of(prototype: Prototype) -> tuple[Tube, Tube]:
    """Outer and inner tube.

    Raises:
        ValueError: where a beam has no geometry.
    """
    return _tube(prototype.outer_beam), _tube(prototype.inner_beam)


def _tube(record: Beam) -> Tube:
    if record.width_m is None or record.wall_m is None or record.free_length_m is None:
        raise ValueError("a drawing needs the width and the wall of both beams, and their free length")
    cut = None if record.length_m is None else _mm(record.length_m)
    return Tube(_mm(record.width_m), _mm(record.wall_m), _mm(record.corner_radius_m), _mm(record.free_length_m), cut)


def _mm(length_m: float) -> float:
    """Millimetres without the noise of floats."""
    return round(1e3 * length_m, 6)


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
    outer, inner = tubes_of(prototype)
    _ring(axes, outer, _OUTER)
    _ring(axes, inner, _INNER)
    half, step = outer.width / 2, 0.13 * outer.width
    _dimension(axes, (-half, -half - step), (half, -half - step), f"{outer.width:.4g}", below=True)
    reach = inner.width / 2
    _dimension(axes, (-reach, -half - 2.4 * step), (reach, -half - 2.4 * step), f"{inner.width:.4g}", below=True)
    for x in (-reach, reach):
        axes.plot([x, x], [-reach, -half - 2.6 * step], color=_LINE, linewidth=0.4, linestyle=":")
    gap = section.clearance(outer.width, outer.wall, inner.width)
    for row, text in enumerate((f"outer wall {outer.wall:.3g}", f"inner wall {inner.wall:.3g}", f"gap {gap:.3g}")):
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
    outer, inner = tubes_of(prototype)
    bent = inner if servo_on else outer
    deflection = tip_force_N / lumped_beam(prototype.inner_beam if servo_on else prototype.outer_beam).stiffness * 1e3
    for tube, colour in ((outer, _OUTER), (inner, _INNER)):
        x = np.concatenate([[tube.back], np.linspace(-tube.free, 0.0, 60)])
        sag = np.zeros_like(x)
        if tube is bent:
            sag = deflection * beam.static_shape((x + tube.free).clip(min=0.0) / tube.free)
        for side in (-1, 1):
            edges = np.array([side * tube.width / 2, side * (tube.width / 2 - tube.wall)])
            axes.fill_between(x, edges.min() - sag, edges.max() - sag, color=colour, linewidth=0)
        if tube is bent:
            for side in (-1, 1):
                axes.plot(
                    [tube.back, 0], [side * tube.width / 2] * 2, color=_LINE, linewidth=0.5, linestyle=(0, (6, 4))
                )
    _clamps(axes, outer, inner)
    _load(axes, outer.width / 2 - (0 if servo_on else deflection), outer.width, tip_force_N)
    gap = section.clearance(outer.width, outer.wall, inner.width)
    which, left = ("inner", "straight") if servo_on else ("outer", "unloaded")
    other = "outer" if servo_on else "inner"
    axes.set_title(
        f"Servo {'on' if servo_on else 'off'}: {which} tip down by {deflection:.3g} mm, {other} beam {left};"
        f" gap left {gap - deflection:.3g} of {gap:.3g} mm",
        fontsize=9,
        loc="left",
    )
    back = min(outer.back, inner.back)
    axes.set_xlim(1.04 * back, -0.1 * back)
    axes.set_ylim(-1.48 * outer.width, 1.35 * outer.width)
    axes.set_aspect("equal")
    axes.set_axis_off()
    return axes


def _ring(axes: "Axes", tube: Tube, colour: str) -> None:
    outside = _rounded_square(tube.width / 2, tube.radius)
    inside = _rounded_square(tube.width / 2 - tube.wall, max(tube.radius - tube.wall, 0.0))
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


def _clamps(axes: "Axes", outer: Tube, inner: Tube) -> None:
    """The base around the clamped part of the outer tube, the plug that holds the inner one, and the free lengths."""
    from matplotlib.patches import Rectangle

    thick = 0.22 * outer.width
    gap = section.clearance(outer.width, outer.wall, inner.width)
    blocks = [
        (tube.back, -tube.free - tube.back, side * tube.width / 2, side * height)
        for tube, height in ((outer, thick), (inner, gap))
        for side in (-1, 1)
    ]
    for x, length, y, height in blocks:
        axes.add_patch(Rectangle((x, y), length, height, facecolor=_BASE, edgecolor=_LINE, linewidth=0.4, hatch="////"))
    low = -outer.width / 2 - thick
    for tube, drop in ((outer, 0.28), (inner, 0.68)):
        y = low - drop * outer.width
        _dimension(axes, (-tube.free, y), (0, y), f"{tube.free:.4g}", below=False)
    axes.plot([0, 0], [low - 0.73 * outer.width, -outer.width / 2], color=_LINE, linewidth=0.4, linestyle=":")


def _load(axes: "Axes", tip: float, width: float, force: float) -> None:
    axes.annotate(
        f"{force:.4g} N",
        (0, tip),
        xytext=(0, tip + 0.55 * width),
        arrowprops={"arrowstyle": "-|>", "color": _LINE, "linewidth": 1.2, "shrinkB": 0},
        ha="center",
        fontsize=8,
    )
