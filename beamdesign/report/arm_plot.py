"""Pictures of an arm: how it deflects under its load with the servos and without, what remains, and over frequency."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from beamdesign.proofs.arm.both_planes import BothPlanes
from beamdesign.proofs.arm.plane import arm_of
from beamdesign.proofs.arm.remaining import Remaining, Vector
from beamdesign.proofs.arm.result import ArmResult
from beamdesign.prototype import Prototype
from beamdesign.report.canvas import LIMIT, STYLES, finish, new_figure
from beamdesign.spelling import in_plot

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
        columns = {
            f"{direction}_{'servo' if servo else 'no_servo'}_{mass:g}_kg_m_per_N": values
            for (direction, servo, mass), values in self.magnitude.items()
        }
        return [
            {"frequency_Hz": float(f)} | {name: float(values[k]) for name, values in columns.items()}
            for k, f in enumerate(self.frequency_Hz)
        ]


def compliance_curves(model: BothPlanes, found: ArmResult) -> Curves:
    """Compliance at the payload's centre at both ends of the range; with the servos only where they are stable."""
    frequency = np.geomspace(0.1, 500.0, 600)
    magnitude = {}
    for servo in (False, True) if found.stable else (False,):
        for mass in dict.fromkeys(found.outer_end_mass_kg):
            response = model.response(mass, frequency, servo)
            for direction, i in (("y", 1), ("z", 2)):
                magnitude[direction, servo, mass] = np.abs(response[:, i, i])
    return Curves(frequency, magnitude)


def draw_arm(prototype: Prototype, found: ArmResult, force_N: Vector, curves: Curves) -> Figure:
    """Side view and end view, deflections enlarged; what remains, by cause; compliance at the payload."""
    figure = new_figure(220.0, 150.0)
    side, end, bars, over = figure.subplots(2, 2).ravel()
    draw_side(side, prototype, found)
    draw_end(end, prototype, found)
    draw_remaining(bars, dict(zip(_CASES, (found.without, found.with_servo), strict=True)))
    draw_compliance(over, curves, prototype.goal.compliance_m_per_N)
    load = ", ".join(f"{value:.4g}" for value in force_N)
    figure.suptitle(f"{in_plot(prototype.name)}: ({load}) N on the payload's centre", fontsize=10)
    return figure


def _cases(found: ArmResult) -> list[tuple[str, str, Remaining]]:
    both = zip(_CASES, _COLOURS, (found.without, found.with_servo), strict=True)
    return [(name, colour, case) for name, colour, case in both if case is not None]


def _enlarged(size_m: float, room_m: float) -> float:
    """A round factor that makes a motion fill about the room for it."""
    factor = room_m / max(size_m, 1e-12)
    power = 10.0 ** np.floor(np.log10(factor))
    return float(power * max(step for step in (1, 2, 5) if step * power <= factor))


def draw_side(axes: Axes, prototype: Prototype, found: ArmResult) -> Axes:
    """The outer beam's axis seen from the side, with the lever to the payload; x along the beam, z upwards."""
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


def draw_end(axes: Axes, prototype: Prototype, found: ArmResult) -> Axes:
    """The tube's end seen from outside, towards the clamp, with the lever to the payload; y to the right, z upwards."""
    width = prototype.outer_beam.width_m or 0.1
    payload = np.array(arm_of(prototype).offset_m[1:])
    reach = max(width, float(np.abs(payload).max()))
    twist = abs(found.without.rotation_rad[0])
    factor = _enlarged(max(twist * reach, 1e-3 * found.without.size_m), 0.2 * reach)
    corners = width / 2 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]])
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
    axes.set_aspect("equal")
    axes.set_title(f"the end seen from outside, {factor:g} times", fontsize=9)
    axes.set(xlabel="y, m", ylabel="z, m")
    axes.margins(0.15)
    axes.legend(fontsize=8, loc="best")
    return axes


def draw_remaining(axes: Axes, cases: dict[str, Remaining | None]) -> Axes:
    """How far each cause alone moves the point that counts, and all together, logarithmically."""
    names = [*CAUSES, "all"]
    for k, (case_name, case) in enumerate(cases.items()):
        if case is None:
            continue
        sizes = [1e3 * size for size in (*case.shares_m.values(), case.size_m)]
        places = np.arange(len(names)) + 0.4 * (k - 0.5)
        axes.bar(places, np.maximum(sizes, 1e-9), width=0.38, color=_COLOURS[k], label=case_name)
        for place, size in zip(places, sizes, strict=True):
            axes.text(place, max(size, 1e-4), f"{size:.2g}", ha="center", va="bottom", fontsize=7)
    axes.set_yscale("log")
    most = max(1e3 * case.size_m for case in cases.values() if case is not None)
    axes.set_ylim(1e-4, 5 * max(most, 1e-3))
    axes.set_xticks(range(len(names)), [*CAUSES.values(), "error"])
    axes.set_ylabel("mm")
    axes.set_title("what a steady load leaves, by cause", fontsize=9)
    axes.legend(fontsize=8)
    return axes


def draw_compliance(axes: Axes, curves: Curves, goal: float) -> Axes:
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
