"""Draw what a payload beside the axis costs: the error that remains under a load, and the margin of the loops.

Usage, from the root of the project:

    python studies/arm_offset.py studies/arm_offset.svg studies/prototypes/arm.toml studies/prototypes/structured.toml

On the left, for the first prototype: the error at the payload over its sideways offset, by cause. On the right, for
each: the peak sensitivity that is proved for every payload of its range, both planes, torsion included; a curve ends
where some payload is not stable. Offsets along the beam and inertias are those of the prototype.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from beamdesign import Prototype, read_prototype
from beamdesign.proofs.arm import single_loop
from beamdesign.proofs.arm.remaining import offset_for_goal_m, remaining
from beamdesign.proofs.arm.result import certify_plane
from beamdesign.report.canvas import save
from beamdesign.structure.arm import PLANES, arm_figures, arm_of

FARTHEST_M = 0.3


def beside(prototype: Prototype, sideways_m: float) -> Prototype:
    """The prototype with its payload so far to the side, as far along the beam as it was, and level."""
    arm = arm_of(prototype)
    return prototype.but(arm=arm.but(offset_m=(arm.offset_m[0], sideways_m, 0.0), tool_m=None))


def draw_error(axes: Axes, prototype: Prototype, force_N: float) -> None:
    """The error under a force downwards, stacked by cause with servos, and without them."""
    y, z = (single_loop(prototype, name).at(0.0).static_compliance() for name in PLANES)
    offsets = np.linspace(0.0, FARTHEST_M, 61)
    rows, alone, there = [], [], []
    for offset in offsets:
        rig = beside(prototype, float(offset))
        place, figures = arm_of(rig).offset_m, arm_figures(rig)
        held = remaining(figures, (0.0, 0.0, -force_N), place, place, (y, z))
        rows.append([*held.shares_m.values(), held.size_m])
        there.append(remaining(figures, (0.0, 0.0, -force_N), place, place, (y, z), place).size_m)
        alone.append(remaining(figures, (0.0, 0.0, -force_N), place, place, None).size_m)
    tip, turning, twist, error = 1e3 * np.array(rows).T
    axes.plot(offsets, 1e3 * np.array(alone), color="0.5", linewidth=2.2, label="outer beam alone, all together")
    axes.plot(offsets, error, color="#2a78b8", linewidth=2.2, label="with servos, all together")
    axes.plot(offsets, twist, color="black", label="of it: end twists, T L / G J")
    axes.plot(offsets, tip, color="black", linestyle="--", label="of it: tip moves, finite gain")
    axes.plot(offsets, turning, color="black", linestyle=":", label="of it: end turns, M L / 4 E I")
    axes.plot(
        offsets,
        1e3 * np.array(there),
        color="#2a78b8",
        linewidth=1.4,
        linestyle="-.",
        label="servos that measure at the payload",
    )
    most = offset_for_goal_m(prototype)
    goal = 1e3 * prototype.goal.compliance_m_per_N * force_N
    small = {"textcoords": "offset points", "fontsize": 7}
    axes.axhline(goal, color="0.6", linewidth=0.7)
    axes.annotate(f"the goal under this load, {goal:.2g} mm", (FARTHEST_M, goal), (0, -9), ha="right", **small)
    axes.axvline(most, color="0.6", linewidth=0.7)
    axes.annotate(f"{1e3 * most:.0f} mm: twist alone\ntakes up the goal", (most, 1.4), (4, 0), **small)
    axes.set_yscale("log")
    axes.set_ylim(1e-4, 20.0)
    axes.set_xlabel("payload beside the axis, m")
    axes.set_ylabel(f"error at the payload under {force_N:g} N, mm")
    axes.legend(fontsize=7, loc="lower right")
    axes.set_title(f"{prototype.name}: payload {1e3 * arm_of(prototype).offset_m[0]:g} mm beyond the tip", fontsize=9)


def proved_peak(prototype: Prototype, offset_m: float) -> float:
    """The larger of the two planes' peak sensitivities, proved for every payload; infinite where one is not stable."""
    low, high = prototype.payload.outer_end_mass_kg or (0.0, 0.0)
    found = [certify_plane(beside(prototype, offset_m), name, low, high).guaranteed for name in PLANES]
    return max(np.inf if sure is None else sure.peak_sensitivity for sure in found)


def draw_margin(axes: Axes, prototypes: list[Prototype], points: int) -> None:
    """Proved peak sensitivity over the sideways offset."""
    offsets = np.linspace(0.0, FARTHEST_M, points)
    for prototype, style in zip(prototypes, ("-", "--", "-.", ":"), strict=False):
        peaks = np.array([proved_peak(prototype, float(offset)) for offset in offsets])
        stable = np.isfinite(peaks)
        axes.plot(offsets[stable], peaks[stable], color="black", linestyle=style, marker=".", label=prototype.name)
        last = float(offsets[stable][-1])
        end = "" if stable.all() else f"; not stable at {offsets[~stable][0]:.3g} m"
        print(f"{prototype.name}: proved to {last:.3g} m, peak there {peaks[stable][-1]:.4g}{end}")
        for offset, peak in zip(offsets, peaks, strict=True):
            print(f"  {offset:.3f} m: {peak:.5g}")
        if not stable.all():
            axes.plot(last, peaks[stable][-1], marker="x", color="black", markersize=8)
    axes.axhline(2.0, color="black", linewidth=0.7, linestyle=":")
    axes.set_yscale("log")
    axes.set_ylim(1.0, 60.0)
    axes.set_yticks([1, 2, 5, 10, 20, 50], ["1", "2", "5", "10", "20", "50"])
    axes.minorticks_off()
    axes.set_xlim(0.0, FARTHEST_M)
    axes.set_xlabel("payload beside the axis, m")
    axes.set_ylabel("peak sensitivity, proved for every payload")
    axes.set_title("what torsion takes from the loops (x: beyond it some payload is not stable)", fontsize=9)
    axes.legend(fontsize=7)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("picture", type=Path)
    parser.add_argument("prototypes", type=Path, nargs="+")
    parser.add_argument("--force-N", type=float, default=2000.0)
    parser.add_argument("--points", type=int, default=16)
    given = parser.parse_args()
    prototypes = [read_prototype(path) for path in given.prototypes]
    figure = Figure(figsize=(11.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    draw_error(left, prototypes[0], given.force_N)
    draw_margin(right, prototypes, given.points)
    (path,) = save(figure, given.picture.with_suffix(""), ("svg",))
    print(path)


if __name__ == "__main__":
    main()
