"""`beamdesign remedies`: the paper's four remedies for payload, side by side."""

from pathlib import Path
from typing import Annotated

import typer

from beamdesign.cli.completion import toml_files
from beamdesign.cli.figures import mass_range, refuse_implausible
from beamdesign.cli.output import (
    JsonOption,
    RangeOption,
    folder_to_write,
    progress,
    say,
    say_table,
    write_csv,
    write_json,
)
from beamdesign.files import fresh_folder, settled


def remedies(
    study: Annotated[
        Path,
        typer.Argument(autocompletion=toml_files, help="The study file; its given sections are the ones to remedy."),
    ],
    out: Annotated[
        Path, typer.Option(metavar="DIR", callback=folder_to_write, help="Folder for remedies.csv and the picture.")
    ],
    outer_end_mass: RangeOption = None,
    added_mass_kg: Annotated[
        float, typer.Option("--added-mass-kg", help="Most moving mass that a remedy may add.")
    ] = 4.5,
    json: JsonOption = None,
) -> None:
    """Compare the paper's four remedies for payload.

    They are a stiffer outer beam, a heavier or softer inner beam, more phase, and a lag scheduled on the
    payload. Each is optimised for the same payload range and limits, and proved in the same way.
    """
    from beamdesign.design import remedies as room
    from beamdesign.problem import read_problem
    from beamdesign.quantities import MassOrNone
    from beamdesign.records import InputError
    from beamdesign.report.canvas import new_figure, save
    from beamdesign.report.trade import plot_remedies

    problem = read_problem(study)
    masses = mass_range(outer_end_mass, problem.payload.outer_end_mass_kg, study)
    refuse_implausible("remedies", {"--added-mass-kg": (added_mass_kg, MassOrNone)})
    for name, beam in (("outer_beam", problem.outer_beam), ("inner_beam", problem.inner_beam)):
        if beam.width_m is None:
            raise InputError(study, [(name, "the remedies start from given sections: width_m and wall_m are needed")])
    with progress("remedies") as update:
        found = room.remedies(problem, masses, added_mass_kg, update)
    rows = [
        {
            "remedy": remedy.name,
            "bandwidth_Hz": remedy.bandwidth_Hz,
            "peak_sensitivity": remedy.peak_sensitivity,
            "added_mass_kg": remedy.added_mass_kg,
            "inner_end_mass_kg": remedy.inner_end_mass_kg,
            "outer_width_m": remedy.outer.width_m,
            "outer_wall_m": remedy.outer.wall_m,
            "inner_width_m": remedy.inner.width_m,
            "inner_wall_m": remedy.inner.wall_m,
            "controllers": "; ".join(
                f"{c.gain_A_per_V:.6g} A/V, {c.pole_Hz:.6g}/{c.zero_Hz:.6g} Hz" for c in remedy.controllers
            ),
            "parts_kg": "; ".join(f"{low:g} to {high:g}" for low, high in remedy.parts_kg),
            "reason": remedy.reason,
        }
        for remedy in found
    ]
    figure = new_figure(height_mm=80)
    plot_remedies(figure.add_subplot(), found)
    with fresh_folder(out) as fresh:
        write_csv(fresh / "remedies.csv", rows)
        pictures = save(figure, fresh / "remedies")
    say_table(
        f"{problem.name}: remedies for {masses[0]:g} to {masses[1]:g} kg at the tip, each proved",
        ("remedy", "bandwidth, Hz", "added mass, kg", "lag", "reason"),
        [(row["remedy"], row["bandwidth_Hz"], row["added_mass_kg"], row["controllers"], row["reason"]) for row in rows],
    )
    for path in (out / "remedies.csv", *settled(pictures, fresh, out)):
        say(str(path))
    write_json(json, {"remedies": rows, "outer_end_mass_kg": list(masses), "added_mass_kg": added_mass_kg})
