"""All kinds of controllers on one plot, at equal proof: bandwidth proved and bandwidth that nonlinear rigs deliver.

Every prototype named is of one rig. Each is certified anew over the payload of the first, with the same claims: stable,
peak sensitivity, loop gain above a frequency and controller effort within the limits of the first one's goal. A
proportional controller and a lag are tuned on the spot within the same limits. Then all are measured on the same rigs,
drawn from tolerances, with orifices, saturation and a second beam mode (see delivered_bandwidth.py). A scheduled
controller counts stage by stage, each over its own payloads: the least of them is its bandwidth. Usage, from the root,
where NAME is what a design is called in table and picture:

    python studies/benchmarks/controllers_compared.py PICTURE.svg [NAME=]PROTOTYPE... [--rigs 12]
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from delivered_bandwidth import delivered, deviations_of, drawn, rig_of
from matplotlib.figure import Figure

from beamdesign import Prototype, certify, read_prototype, tune
from beamdesign.proofs.certificate import Asked, goal_claims
from beamdesign.prototype import Goal
from beamdesign.report.canvas import new_figure, save
from beamdesign.structure.lumped import figures

Range = tuple[float, float]


@dataclass(frozen=True)
class Design:
    """One controller.

    Attributes:
        name: in the table.
        stages: its prototypes, each with the payloads that it is for; one but for a scheduled controller.
    """

    name: str
    stages: tuple[tuple[Prototype, Range], ...]


@dataclass(frozen=True)
class Row:
    """What one controller promises and delivers.

    Attributes:
        name: of the design.
        proved_Hz: least bandwidth over its stages; 0 where some is not stable.
        missed: claims that are refuted, in words.
        stable: how many measured rigs are stable.
        reached_Hz: (rigs,) measured bandwidths.
    """

    name: str
    proved_Hz: float
    missed: tuple[str, ...]
    stable: int
    reached_Hz: np.ndarray


def tuned(prototype: Prototype, masses: Range, kind: str) -> Design | None:
    """A controller of a simple kind, tuned for the rig and limits of a prototype; None where nothing is proved."""
    found = tune(prototype, masses, kind, sigmas=0.0)
    return None if found.best is None else Design(f"{kind} (tuned here)", ((found.prototype, masses),))


def read(name: str, path: Path, first: Prototype, masses: Range) -> Design:
    """A design from its file, with the goal and the effects of the first; it has to be for the same rig."""
    rig = read_prototype(path).but(goal=first.goal, effects=first.effects)
    stages = rig.stages(rig.schedule.outer_end_mass_kg if rig.schedule is not None else masses)
    if figures(stages[0].prototype) != figures(first):
        raise SystemExit(f"{path}: another rig than the first prototype's")
    return Design(name, tuple((stage.prototype, stage.outer_end_mass_kg) for stage in stages))


def row(design: Design, rigs: int, force_N: float) -> Row:
    """Certify a design, and measure it on drawn rigs: the ends of each stage's payloads in turn."""
    proved, missed = [], []
    for prototype, masses in design.stages:
        asked = (Asked("peak_sensitivity", prototype.goal.peak_sensitivity), *goal_claims(prototype.goal))
        found = certify(prototype, *masses, asked)
        proved.append(found.guaranteed.bandwidth_Hz if found.guaranteed else 0.0)
        missed += [] if found.holds else [found.reason]
    measured = []
    for k in range(rigs):
        prototype, masses = design.stages[k // 2 % len(design.stages)]
        rig = drawn(rig_of(prototype), deviations_of(prototype), rigs)[k]
        measured.append(delivered(rig, masses[k % 2], force_N, seed=k))
    reached = np.array([one.bandwidth_Hz for one in measured])
    return Row(design.name, min(proved), tuple(missed), sum(one.stable for one in measured), reached)


def plot(figure: Figure, rows: Sequence[Row], goal: Goal, masses: Range) -> Figure:
    """A bar for what is proved, light where a claim is missed; a tick for each rig, a dot at their median."""
    axes = figure.add_subplot()
    for k, one in enumerate(rows):
        bar = axes.barh(k, one.proved_Hz, color="0.95" if one.missed else "0.82", edgecolor="black", height=0.6)
        (ticks,) = axes.plot(one.reached_Hz, [k] * len(one.reached_Hz), "|", color="black", markersize=14)
        (dot,) = axes.plot(np.median(one.reached_Hz), k, "o", color="black", markersize=5)
        if one.stable < len(one.reached_Hz):
            words = f"{len(one.reached_Hz) - one.stable} of {len(one.reached_Hz)} rigs not stable"
            axes.annotate(
                words, (max(one.reached_Hz.max(), one.proved_Hz), k), (6, 0), textcoords="offset points", va="center"
            )
    axes.legend([bar, ticks, dot], ["proved", "delivered by each rig drawn", "their median"], loc="upper right")
    axes.set_yticks(range(len(rows)), [one.name for one in rows])
    axes.invert_yaxis()
    axes.set_xlim(-0.3, 1.45 * max(max(one.proved_Hz, one.reached_Hz.max()) for one in rows))
    axes.set_xlabel("bandwidth, Hz")
    axes.grid(True, axis="x", color="0.9")
    axes.set_axisbelow(True)
    limits = [f"{masses[0]:g} to {masses[1]:g} kg", f"peak sensitivity ≤ {goal.peak_sensitivity:g}"]
    if goal.loop_gain is not None:
        limits.append(f"|L| ≤ {goal.loop_gain:g} from {goal.loop_gain_from_Hz:g} Hz")
    if goal.controller_effort_A_per_V is not None:
        limits.append(f"|C/(1+L)| ≤ {1e3 * goal.controller_effort_A_per_V:g} mA/V")
    axes.set_title(", ".join(limits), fontsize=8)
    return figure


def _named(text: str) -> tuple[str, Path]:
    name, _, path = text.rpartition("=")
    return name or Path(path).stem, Path(path)


def main() -> None:
    """Print a row for every controller and draw them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("picture", type=Path)
    parser.add_argument("prototypes", nargs="+")
    parser.add_argument("--rigs", type=int, default=12)
    parser.add_argument("--force-N", type=float, default=40.0)
    given = parser.parse_args()
    named = [_named(text) for text in given.prototypes]
    first = read_prototype(named[0][1])
    goal, masses = first.goal, first.payload.outer_end_mass_kg
    if masses is None:
        parser.error(f"{named[0][1]} states no payload")
    designs = [tuned(first, masses, kind) for kind in ("proportional", "lag")]
    designs += [read(name, path, first, masses) for name, path in named]
    print(f"{'':34} {'proved, Hz':>10} {'stable':>9}  {'least':>6} {'median':>6} {'largest':>7}  delivered, Hz")
    rows = []
    for design in designs:
        if design is None:
            continue
        one = row(design, given.rigs, given.force_N)
        least, middle, most = one.reached_Hz.min(), np.median(one.reached_Hz), one.reached_Hz.max()
        stable = f"{one.stable} of {len(one.reached_Hz)}"
        print(f"{one.name:34} {one.proved_Hz:10.4g} {stable:>9}  {least:6.1f} {middle:6.1f} {most:7.1f}", flush=True)
        for words in one.missed:
            print(f"    not at equal proof: {words}")
        rows.append(one)
    figure = plot(new_figure(190.0, 30.0 + 11.0 * len(rows)), rows, goal, masses)
    save(figure, given.picture.with_suffix(""), ("svg",))
    print(given.picture)


if __name__ == "__main__":
    main()
