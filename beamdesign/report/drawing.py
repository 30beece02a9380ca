"""A twin-beam prototype drawn to scale, in section and from the side; and as an arm, with what a load leaves of it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beamdesign.prototype import Beam, Prototype
from beamdesign.quantities import decimal
from beamdesign.report.canvas import LIMIT, STYLES, finish, new_figure, note
from beamdesign.spelling import in_plot
from beamdesign.structure import lumped
from beamdesign.structure.lumped import lumped_beam
from beamdesign.structure.section import Tube, at_corners, clearances
from beamdesign.structure.shapes import tube_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from beamdesign.proofs.arm.both_planes import BothPlanes
    from beamdesign.proofs.arm.remaining import Remaining, Vector
    from beamdesign.proofs.arm.result import ArmResult

_OUTER, _INNER, _BASE, _LINE = "0.55", "#2a78b8", "0.8", "black"


_SHOWN_BEHIND = 0.1
"""A tube whose cut length is not given is drawn this share of its free length into its clamp, and not dimensioned."""


@dataclass(frozen=True)
class Drawn:
    """One tube in mm, its section too; `cut` is None where the prototype does not give it."""

    section: Tube
    free: float
    cut: float | None

    @property
    def width(self) -> float:
        """Outside size across the load."""
        return float(self.section.width_m)

    @property
    def depth(self) -> float:
        """Outside size along the load, which a lengthwise section shows."""
        return float(self.section.depth_m)

    @property
    def wall(self) -> float:
        """Its thickness."""
        return float(self.section.wall_m)

    @property
    def outlines(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Half the width, half the depth and the corner radius, outside and inside."""
        width, depth, radius, wall = self.width / 2, self.depth / 2, float(self.section.corner_radius_m), self.wall
        return (width, depth, radius), (width - wall, depth - wall, max(radius - wall, 0.0))

    @property
    def back(self) -> float:
        """Where it ends, behind the tip at 0."""
        return -(self.cut if self.cut is not None else (1 + _SHOWN_BEHIND) * self.free)


def tubes_of(prototype: Prototype) -> tuple[Drawn, Drawn]:
    """Outer and inner tube.

    Raises:
        ValueError: where a beam has no geometry.
    """
    return _tube(prototype.outer_beam), _tube(prototype.inner_beam)


def _tube(record: Beam) -> Drawn:
    if record.tube is None or record.free_length_m is None:
        raise ValueError("a drawing needs the width and the wall of both beams, and their free length")
    sizes = {key: getattr(record, key) for key in ("width_m", "wall_m", "depth_m", "corner_radius_m")}
    section = tube_of({key: _mm(size) for key, size in sizes.items() if size is not None} | {"shape": record.shape})
    assert section is not None  # in metres it was one
    return Drawn(section, _mm(record.free_length_m), None if record.length_m is None else _mm(record.length_m))


def gap_text(outer: Drawn, inner: Drawn) -> str:
    """Gap per side, mm, in words; both where it is another along the load than across it."""
    along, *across = clearances(outer.section, inner.section)
    if at_corners(outer.section, inner.section):
        return f"{along:.4g} at the corners"
    return f"{along:.4g}" if not across else f"{along:.4g} along the load, {across[0]:.4g} across"


def _mm(length_m: float) -> float:
    """Millimetres without the noise of floats."""
    return round(1e3 * length_m, 6)


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
    half, low, step = outer.width / 2, -outer.depth / 2, 0.13 * outer.width
    reach, edge = inner.width / 2, 0.0 if inner.section.shape == "round" else -inner.depth / 2
    for tube, drop in ((outer, step), (inner, 2.4 * step)):
        words = f"{'Ø ' if tube.section.shape == 'round' else ''}{tube.width:.4g}"
        _dimension(axes, (-tube.width / 2, low - drop), (tube.width / 2, low - drop), words, below=True)
    for x in (-reach, reach):
        axes.plot([x, x], [edge, low - 2.6 * step], color=_LINE, linewidth=0.4, linestyle=":")
    along, *across = clearances(outer.section, inner.section)
    where = " at corners" if at_corners(outer.section, inner.section) else ""
    lines = [f"outer wall {outer.wall:.3g}", f"inner wall {inner.wall:.3g}", f"gap {along:.3g}{where}"]
    top, row, bottom = 0.34 * reach, 0.34 * reach, low - 4 * step
    if across:
        pairs = (("depths", outer.depth, inner.depth), ("walls", outer.wall, inner.wall))
        lines = [*(f"{name} {a:.4g} and {b:.4g}" for name, a, b in pairs), f"gaps {along:.3g}, {across[0]:.3g} across"]
    if across or inner.width < 0.6 * outer.width:  # no room for words inside: they stand below
        top, row, bottom = bottom, 0.12 * outer.depth, bottom - 0.36 * outer.depth
    for k, text in enumerate(lines):
        axes.text(0, top - row * k, text, ha="center", va="center", fontsize=7)
    axes.set(xlim=(-half - step, half + step), ylim=(bottom, step - low), aspect="equal")
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
            sag = deflection * lumped.static_shape((x + tube.free).clip(min=0.0) / tube.free)
        for side in (-1, 1):
            edges = np.array([side * tube.depth / 2, side * (tube.depth / 2 - tube.wall)])
            axes.fill_between(x, edges.min() - sag, edges.max() - sag, color=colour, linewidth=0)
            if tube is bent:
                axes.plot([tube.back, 0], edges[[0, 0]], color=_LINE, linewidth=0.5, linestyle=(0, (6, 4)))
    back = min(outer.back, inner.back)
    room = max(outer.depth, -back / 11)  # for a dimension and its words, of a slender link too
    _clamps(axes, outer, inner, room)
    tip = outer.depth / 2 - (0 if servo_on else deflection)
    arrow = {"arrowstyle": "-|>", "color": _LINE, "linewidth": 1.2, "shrinkB": 0}
    load, above = f"{decimal(tip_force_N)} N", (0, tip + 0.55 * room)
    axes.annotate(load, (0, tip), xytext=above, arrowprops=arrow, ha="center", fontsize=8)
    gap = clearances(outer.section, inner.section)[0]
    which, other, left = ("inner", "outer", "straight") if servo_on else ("outer", "inner", "unloaded")
    axes.set_title(
        f"Servo {'on' if servo_on else 'off'}: {which} tip down by {deflection:.3g} mm, {other} beam {left};\n"
        f"gap left {gap - deflection:.3g} of {gap:.3g} mm",
        fontsize=9,
    )
    low, high = -0.72 * outer.depth - 0.82 * room, 0.5 * outer.depth + 0.85 * room
    axes.set(xlim=(1.04 * back, -0.1 * back), ylim=(low, high), aspect="equal")
    axes.set_axis_off()
    return axes


def _ring(axes: "Axes", tube: Drawn, colour: str) -> None:
    outside, inside = (_rounded(*outline) for outline in tube.outlines)
    # One closed line: round the outside, across the wall, and back round the inside.
    line = np.concatenate([outside, inside[::-1]])
    axes.fill(line[:, 0], line[:, 1], color=colour, linewidth=0)


def _rounded(half_width: float, half_depth: float, radius: float) -> np.ndarray:
    """Points (n, 2) round a rectangle, its corners rounded, the first point repeated at the end."""
    quarter = np.linspace(0, np.pi / 2, 9)
    points = []
    for k, (x, y) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        centre, angle = np.array([x * (half_width - radius), y * (half_depth - radius)]), quarter + k * np.pi / 2
        points.append(centre + radius * np.column_stack([np.cos(angle), np.sin(angle)]))
    return np.concatenate([*points, points[0][:1]])


def _dimension(axes: "Axes", start: tuple[float, float], end: tuple[float, float], text: str, below: bool) -> None:
    arrow = {"arrowstyle": "<|-|>", "color": _LINE, "linewidth": 0.6, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", start, end, arrowprops=arrow)
    middle = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
    note(axes, text, middle, (0, -2 if below else 2), va="top" if below else "bottom")


def _clamps(axes: "Axes", outer: Drawn, inner: Drawn, room: float) -> None:
    """The base around the clamped part of the outer tube, the plug that holds the inner one, and the free lengths."""
    from matplotlib.patches import Rectangle

    thick = 0.22 * outer.depth
    gap = (outer.depth - inner.depth) / 2 - outer.wall
    blocks = [
        (tube.back, -tube.free - tube.back, side * tube.depth / 2, side * height)
        for tube, height in ((outer, thick), (inner, gap))
        for side in (-1, 1)
    ]
    for x, length, y, height in blocks:
        axes.add_patch(Rectangle((x, y), length, height, facecolor=_BASE, edgecolor=_LINE, linewidth=0.4, hatch="////"))
    low = -outer.depth / 2 - thick
    for tube, drop in ((outer, 0.38), (inner, 0.74)):
        y = low - drop * room
        _dimension(axes, (-tube.free, y), (0, y), decimal(tube.free), below=False)
    axes.plot([0, 0], [low - 0.79 * room, -outer.depth / 2], color=_LINE, linewidth=0.4, linestyle=":")


CAUSES = {"tip": "tip moves", "turning": "end turns", "twist": "end twists"}
_CASES = ("without servo", "with servo")
_COLOURS = ("0.5", "#2a78b8")


@dataclass(frozen=True)
class Curves:
    """Compliance at the payload's centre over frequency, by the modes of the loops.

    Attributes:
        frequency_Hz: (N,).
        magnitude: by (direction, servo, payload in kg): |motion along the force| per force, m/N, (N,).
    """

    frequency_Hz: np.ndarray
    magnitude: dict[tuple[str, bool, float], np.ndarray]

    def rows(self) -> list[dict[str, float]]:
        """One row per frequency, a column per curve."""
        columns = {"frequency_Hz": self.frequency_Hz} | {
            f"{direction}_{'servo' if servo else 'no_servo'}_{mass:g}_kg_m_per_N": values
            for (direction, servo, mass), values in self.magnitude.items()
        }
        return [dict(zip(columns, row, strict=True)) for row in np.column_stack([*columns.values()]).tolist()]


def compliance_curves(model: "BothPlanes", found: "ArmResult", quick: float = 1.0) -> Curves:
    """Compliance at the payload's centre at both ends of the range; with the servos only where they are stable.

    It is looked at from 0.1 to 500 Hz of an arm as quick as the published rig, of one so many times as quick likewise.
    """
    frequency = quick * np.geomspace(0.1, 500.0, 600)
    magnitude = {}
    for servo in (False, True) if found.stable else (False,):
        for mass in dict.fromkeys(found.outer_end_mass_kg):
            response = model.response(mass, frequency, servo)
            for direction, i in (("y", 1), ("z", 2)):
                magnitude[direction, servo, mass] = np.abs(response[:, i, i])
    return Curves(frequency, magnitude)


def draw_arm(prototype: Prototype, found: "ArmResult", force_N: "Vector", curves: Curves) -> "Figure":
    """Side view and end view, deflections enlarged; what remains, by cause; compliance at the payload."""
    figure = new_figure(220.0, 150.0)
    side, end, bars, over = figure.subplots(2, 2).ravel()
    draw_arm_side(side, prototype, found)
    draw_end(end, prototype, found)
    draw_remaining(bars, found)
    draw_compliance(over, curves, prototype.goal.compliance_m_per_N)
    load = ", ".join(f"{value:.4g}" for value in force_N)
    figure.suptitle(f"{in_plot(prototype.name)}: ({load}) N on the payload's centre", fontsize=10)
    return figure


def _cases(found: "ArmResult") -> "list[tuple[str, str, Remaining]]":
    both = zip(_CASES, _COLOURS, (found.without, found.with_servo), strict=True)
    return [(name, colour, case) for name, colour, case in both if case is not None]


def _enlarged(size_m: float, room_m: float) -> float:
    """A round factor that makes a motion fill about the room for it."""
    factor = room_m / max(size_m, 1e-12)
    power = 10.0 ** np.floor(np.log10(factor))
    return float(power * max(step for step in (1, 2, 5) if step * power <= factor))


def draw_arm_side(axes: "Axes", prototype: Prototype, found: "ArmResult") -> "Axes":
    """The outer beam's axis seen from the side, with the lever to the payload; x along the beam, z upwards."""
    from beamdesign.structure.arm import arm_of

    length, payload = found.figures.length, arm_of(prototype).offset_m
    factor = _enlarged(found.without.size_m, 0.2 * length)
    x = np.linspace(0.0, length, 60)
    share = x / length
    axes.plot([0, length], [0, 0], color="0.8", linewidth=1, linestyle=(0, (6, 4)))
    for name, colour, case in _cases(found):
        tip, slope = case.tip_m[2], -case.rotation_rad[1]
        # The cubic with the end's deflection and slope, clamped at the base.
        line = tip * share**2 * (3 - 2 * share) + slope * length * share**2 * (share - 1)
        axes.plot(x, factor * line, color=colour, linewidth=2, label=name)
        lever = np.array([payload[0], payload[2]])
        turned = lever + factor * slope * np.array([-lever[1], lever[0]])
        there = np.array([length, factor * tip]) + turned
        axes.plot([length, there[0]], [factor * tip, there[1]], color=colour, linewidth=0.9)
        axes.plot(*there, marker="o", color=colour, markersize=5)
    axes.axvline(0.0, color="black", linewidth=3)
    axes.set_title(f"from the side, deflections {factor:g} times", fontsize=9)
    axes.set(xlabel="x, m", ylabel="z, m")
    axes.margins(y=0.3)
    axes.legend(fontsize=8, loc="lower left")
    return axes


def draw_end(axes: "Axes", prototype: Prototype, found: "ArmResult") -> "Axes":
    """The tube's end seen from outside, towards the clamp, with the lever to the payload; y to the right, z upwards."""
    from beamdesign.structure.arm import arm_of

    tube = prototype.outer_beam.tube or Tube(0.1, 0.01)
    payload = np.array(arm_of(prototype).offset_m[1:])
    reach = max(tube.width_m, float(np.abs(payload).max()))
    twist = abs(found.without.rotation_rad[0])
    factor = _enlarged(max(twist * reach, 1e-3 * found.without.size_m), 0.2 * reach)
    corners = _rounded(tube.width_m / 2, tube.depth_m / 2, tube.corner_radius_m if tube.shape == "round" else 0.0)
    axes.plot(*corners.T, color="0.8", linewidth=1, linestyle=(0, (6, 4)))
    axes.plot(*np.array([[0, 0], payload]).T, color="0.8", linewidth=1, linestyle=(0, (6, 4)))
    for name, colour, case in _cases(found):
        if name == _CASES[0] and found.with_servo is not None:
            continue  # its deflection would leave the picture at this scale, and its twist is the same
        moved, angle = factor * np.array(case.tip_m[1:]), factor * case.rotation_rad[0]
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        axes.plot(*(corners @ turn.T + moved).T, color=colour, linewidth=2, label=name)
        there = turn @ payload + moved
        axes.plot(*np.array([moved, there]).T, color=colour, linewidth=0.9)
        axes.plot(*there, marker="o", color=colour, markersize=5)
    axes.set_aspect("equal", adjustable="datalim")  # a narrow box would leave no room for its labels
    axes.set_title(f"the end seen from outside, {factor:g} times", fontsize=9)
    axes.set(xlabel="y, m", ylabel="z, m")
    axes.margins(0.15)
    axes.legend(fontsize=8, loc="best")
    return axes


def draw_remaining(axes: "Axes", found: "ArmResult") -> "Axes":
    """How far each cause alone moves the point that counts, and all together, logarithmically."""
    names, cases = [*CAUSES, "all"], _cases(found)
    for k, (case_name, colour, case) in enumerate(cases):
        sizes = [1e3 * size for size in (*case.shares_m.values(), case.size_m)]
        places = np.arange(len(names)) + 0.4 * (k - 0.5)
        axes.bar(places, np.maximum(sizes, 1e-9), width=0.38, color=colour, label=case_name)
        for place, size in zip(places, sizes, strict=True):
            axes.text(place, max(size, 1e-4), f"{size:.2g}", ha="center", va="bottom", fontsize=6)
    axes.set_yscale("log")
    most = max(1e3 * case.size_m for *_, case in cases)
    axes.set_ylim(1e-4, 5 * max(most, 1e-3))
    axes.set_xticks(range(len(names)), [*CAUSES.values(), "error"])
    axes.set_ylabel("mm")
    axes.set_title("what a steady load leaves, by cause", fontsize=9)
    axes.legend(fontsize=8)
    return axes


def draw_compliance(axes: "Axes", curves: Curves, goal: float) -> "Axes":
    """Compliance at the payload's centre in z over frequency; grey without servo, blue with."""
    for (direction, servo, mass), values in curves.magnitude.items():
        if direction != "z":
            continue
        light = mass == min(key[2] for key in curves.magnitude)
        axes.loglog(
            curves.frequency_Hz, values, color=_COLOURS[servo], linestyle=STYLES[0 if light else 2]["linestyle"],
            linewidth=1.2, label=f"{_CASES[servo]}, {mass:g} kg",
        )  # fmt: skip
    axes.axhline(goal, **LIMIT, label="goal")
    finish(axes, "frequency, Hz", "m/N", legend=None)
    axes.set_title("force and motion of the payload's centre, z", fontsize=9)
    # Room for the legend below the curves.
    axes.set_ylim(bottom=0.001 * min(goal, *(float(values[0]) for values in curves.magnitude.values())))
    axes.legend(fontsize=7, loc="lower left")
    return axes
