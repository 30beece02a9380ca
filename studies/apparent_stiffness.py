"""Draw what the end of a link feels like when it is told to have a stiffness, from nearly none to that of its servo.

Usage, from the root of the project:

    python studies/apparent_stiffness.py studies/prototypes/tame_lag.toml studies/apparent_stiffness.svg

Every law is searched and proved anew for the nominal figures; one takes some five seconds. With --rigs 40 it has to
suit so many rigs drawn from the tolerances as well.
"""

import argparse
from pathlib import Path

from apparent_stiffness_picture import plot_apparent_stiffness

from beamdesign import read_prototype, stiffness
from beamdesign.report.canvas import new_figure, save

STIFFNESSES_N_PER_M = (1e4, 3e4, 1e5, 2.2e5, 4.5e5, 1e6, 3e6, 1e7, 1e8)


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
