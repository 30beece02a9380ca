"""`beamdesign run`: from a study file to a certified prototype."""

from pathlib import Path
from typing import Annotated

import typer

from beamdesign.cli.completion import toml_files
from beamdesign.cli.output import JsonOption, folder_to_write, progress, say, say_table, write_json


def run(
    study: Annotated[
        Path, typer.Argument(autocompletion=toml_files, help="The study file, such as studies/prototype.toml.")
    ],
    out: Annotated[
        Path, typer.Option(metavar="DIR", callback=folder_to_write, help="Folder for the results; made if need be.")
    ],
    json: JsonOption = None,
) -> None:
    """Carry a study to a certified prototype.

    Sections are sized, controller and inner end mass tuned, and the guarantee proved; with the prototype come its
    certificate, a report and a specification. Exit status 1 if there is no design, with the reason.
    """
    from beamdesign.problem import read_problem
    from beamdesign.report.quantity import at_least, at_most, mass_range_text
    from beamdesign.report.result_folder import write_result_folder
    from beamdesign.study.design_run import run_design

    problem = read_problem(study)
    with progress("designing") as update:
        result = run_design(problem, update)
        if result.prototype is not None:
            update(0.95, "drawing the report")
            folder = write_result_folder(result, out)
    if result.prototype is None:
        say(f"no design: {result.reason}")
        write_json(
            json, {"prototype": None, "certificate": None, "mass_kg": None, "report": None, "reason": result.reason}
        )
        raise typer.Exit(1)
    payload, end, reached = result.prototype.payload, result.suffix.replace(".", "_"), result.guarantees
    moving = result.sizing.beam_mass_kg + payload.inner_end_mass_kg
    rows = [
        ("outer beam", f"{result.sizing.outer.width_m * 1e3:.4g} x {result.sizing.outer.wall_m * 1e3:.3g} mm"),
        ("inner beam", f"{result.sizing.inner.width_m * 1e3:.4g} x {result.sizing.inner.wall_m * 1e3:.3g} mm"),
        ("mass of both beams and inner end mass", f"{moving:.3f} kg"),
        ("governing check", result.sizing.governing),
    ]
    for one in reached:
        rows += [
            ("guaranteed bandwidth", at_least(one.bandwidth_Hz, "Hz")),
            ("guaranteed peak sensitivity", at_most(one.peak_sensitivity, "1")),
            ("for every outer end mass", mass_range_text(one.outer_end_mass_kg)),
        ]
    say_table(f"{problem.name}: designed and certified", ("", ""), rows)
    for path in folder.values():
        say(str(path))
    write_json(
        json,
        {
            "prototype": folder["prototype"],
            "certificate": folder[f"certificate{end}"],
            "mass_kg": moving,
            "beam_mass_kg": result.sizing.beam_mass_kg,
            "inner_end_mass_kg": payload.inner_end_mass_kg,
            "report": folder[f"report{end}"],
            "specification": folder[f"specification{end}"],
            "guaranteed": reached[0].model_dump(),
            **({"stages": [one.model_dump() for one in reached]} if result.laws else {}),
        },
    )
