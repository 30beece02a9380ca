"""Draw what the end of a link feels like when it is told to have a stiffness, from nearly none to that of its servo.

Usage, from the root of the project:

    python studies/apparent_stiffness.py studies/prototypes/tame_lag.toml studies/apparent_stiffness.svg

Every law is searched and proved anew for the nominal figures; one takes some five seconds. With --rigs 40 it has to
suit so many rigs drawn from the tolerances as well.
"""

import argparse
from collections.abc import Sequence
from math import pi
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from beamdesign import Prototype, read_prototype, stiffness
from beamdesign.loop import close_loop, loop
from beamdesign.quantities import quantity
from beamdesign.report.canvas import new_figure, save
from beamdesign.structure.lumped import figures
from beamdesign.synthesis.end_stiffness import SHARE, EndStiffness, controller_of, sensed

STIFFNESSES_N_PER_M = (1e4, 3e4, 1e5, 2.2e5, 4.5e5, 1e6, 3e6, 1e7, 1e8)
FREQUENCIES_HZ = np.geomspace(0.05, 300.0, 800)


def plot_apparent_stiffness(figure: Figure, prototype: Prototype, found: Sequence[EndStiffness]) -> Figure:
    """Draw apparent stiffness over frequency on the left, its proved band over the stiffness on the right.

    Args:
        figure: drawn on.
        prototype: with the servo that is drawn for comparison, and its payload.
        found: proved laws, by rising stiffness.
    """
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    _curves(left, prototype, found)
    _bands(right, prototype, found)
    return figure


def _curves(axes: Axes, prototype: Prototype, found: Sequence[EndStiffness]) -> None:
    given, s = figures(prototype), 2j * pi * FREQUENCIES_HZ
    servo = np.abs(loop(prototype).at(0.0).stiffness_response(FREQUENCIES_HZ))
    beam = np.abs(given["outer_mass"] * s**2 + given["outer_damping"] * s + given["outer_stiffness"])
    axes.loglog(FREQUENCIES_HZ, servo, color="0.55", linestyle="--", label="servo alone, its own lag")
    axes.loglog(FREQUENCIES_HZ, beam, color="0.55", linestyle=":", linewidth=2.0, label="outer beam alone")
    for one in found:
        if one.law is None:  # judged as it is: the servo
            continue
        closed = close_loop(sensed(prototype), controller_of(prototype, one.law))
        curve = np.abs(closed.at(0.0).stiffness_response(FREQUENCIES_HZ))
        axes.loglog(FREQUENCIES_HZ, curve, color="black", linewidth=1.0)
        end = np.interp(one.band_Hz, FREQUENCIES_HZ, curve)
        axes.plot(one.band_Hz, end, marker="o", color="black", markerfacecolor=_fill(one), markersize=5)
        axes.annotate(
            quantity(one.end_stiffness_N_per_m, "N/m"), (FREQUENCIES_HZ[0], one.end_stiffness_N_per_m),
            xytext=(3, 3), textcoords="offset points", fontsize=7,
        )  # fmt: skip
    axes.set_xlim(FREQUENCIES_HZ[0], FREQUENCIES_HZ[-1])
    axes.set_ylim(3e3, 1e9)
    axes.set_xlabel("frequency, Hz")
    axes.set_ylabel("|F / x| at the tip without payload, N/m")
    axes.set_title("Apparent stiffness; marks: end of the proved band", fontsize=9)
    axes.grid(True, which="major", color="0.85", linewidth=0.6)
    axes.legend(fontsize=7, loc="upper right")


def _bands(axes: Axes, prototype: Prototype, found: Sequence[EndStiffness]) -> None:
    for passive, label in (
        (True, "passive at the tip, proved"),
        (False, "stable against every wall, proved; not passive"),
    ):
        points = [(one.end_stiffness_N_per_m, one.band_Hz) for one in found if one.passivity.holds is passive]
        if points:
            axes.loglog(
                *zip(*points, strict=True), linestyle="none", marker="o", color="black",
                markerfacecolor="black" if passive else "white", label=label,
            )  # fmt: skip
    masses = prototype.payload.outer_end_mass_kg or (0.0, 0.0)
    stiffnesses = np.geomspace(found[0].end_stiffness_N_per_m, found[-1].end_stiffness_N_per_m, 50)
    moving = figures(prototype)["outer_mass"] + masses[1]
    inertia = np.sqrt(SHARE * stiffnesses / moving) / (2 * pi)
    axes.loglog(stiffnesses, inertia, color="0.55", linestyle="--", label=f"inertia of {moving:.3g} kg alone")
    axes.axvline(figures(prototype)["outer_stiffness"], color="0.55", linestyle=":", linewidth=2.0)
    axes.set_ylim(top=3e3)  # the legend stands above
    axes.set_xlabel("stiffness of the end at rest, N/m")
    axes.set_ylabel(f"band within {SHARE:.0%}, Hz")
    axes.set_title(f"Proved for {masses[0]:g} to {masses[1]:g} kg; dotted: outer beam", fontsize=9)
    axes.grid(True, which="major", color="0.85", linewidth=0.6)
    axes.legend(fontsize=7, loc="upper left")


def _fill(one: EndStiffness) -> str:
    return "black" if one.passivity.holds else "white"


def main() -> None:
    """Print every law and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("prototype", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--rigs", type=int, default=0)
    given = parser.parse_args()
    prototype = read_prototype(given.prototype)
    masses = prototype.payload.outer_end_mass_kg
    if masses is None or prototype.controller is None:
        raise SystemExit("the prototype needs a controller and a payload range")
    found = []
    for asked in STIFFNESSES_N_PER_M:
        best = stiffness(prototype, asked, masses, rigs=given.rigs).best
        if best is None or best.law is None:
            print(f"{asked:g} N/m: no law found", flush=True)
            continue
        found.append(best)
        contact = "passive" if best.passivity.holds else "not passive"
        servo = ", ".join(f"{key} {value}" for key, value in best.law.servo.model_dump().items())
        print(
            f"{asked:g} N/m: within 10 % up to {best.band_Hz:.4g} Hz, command up to {best.command_Hz:.4g} Hz,"
            f" {contact}, lasting contact up to {best.stiffest_wall_N_per_m:.4g} N/m, one-sided walls up to"
            f" {best.unilateral_contact.stiffness_N_per_m:.4g} N/m; {servo},"
            f" force filter {best.law.force_filter_Hz:g} Hz",
            flush=True,
        )
    save(plot_apparent_stiffness(new_figure(230.0, 105.0), prototype, found), given.picture.with_suffix(""), ("svg",))
    print(given.picture)


if __name__ == "__main__":
    main()
