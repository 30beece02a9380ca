"""`beamdesign certify-switching`: what is proved while the payload changes in motion."""

from pathlib import Path
from typing import Annotated

import typer

from beamdesign.cli.certificate_file import certificate_file, write_certificate
from beamdesign.cli.completion import toml_files
from beamdesign.cli.figures import mass_range, refuse_implausible
from beamdesign.cli.output import JsonOption, RangeOption, file_to_write, progress, say, write_json


def certify_switching(
    prototype: Annotated[
        Path, typer.Argument(autocompletion=toml_files, help="The prototype.toml, with its controller.")
    ],
    outer_end_mass: RangeOption = None,
    rate: Annotated[
        float | None,
        typer.Option(metavar="KG_PER_S", help="Prove stability up to this rate of change; else find the largest."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            callback=file_to_write,
            help="File for the certificate; else STEM.stages.toml in this folder.",
        ),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Prove stability while the payload changes in motion.

    That is gripping, releasing, filling, pouring; of a scheduled controller any change of its stage as well. Lyapunov
    functions come from a semidefinite program and are verified in rational arithmetic; what only the solver claims is
    reported as unverified. Exit status 0 if the rate asked for, or else some rate, is proved both for payload that
    joins with the tip's velocity and for payload at rest; of a scheduled controller, if changes of stage as the
    schedule makes them are proved, and the rate if one is asked for; 1 otherwise.
    """
    from beamdesign import quantities as q
    from beamdesign.proof.stage_family import stage_families
    from beamdesign.prototype import read_prototype
    from beamdesign.records import InputError

    record = read_prototype(prototype)
    if record.controller is None:
        raise InputError(prototype, [("controller", "missing; write it there, or let `beamdesign tune` find one")])
    try:
        families = stage_families(record)
    except ValueError as error:
        raise InputError(prototype, [("controller.stage", str(error))]) from error
    low, high = mass_range(outer_end_mass, record.outer_end_mass_kg, prototype)
    problems = []
    if not low < high:
        problems.append(("--outer-end-mass", f"{low:g}:{high:g} holds one mass, which cannot change"))
    schedule = record.schedule
    path = certificate_file(out, f"{prototype.stem}.stages.toml")
    refuse_implausible("certify-switching", {"--rate": (rate, q.MassRate)}, problems)

    from beamdesign.proof.lyapunov import describe, switching, switching_fields
    from beamdesign.proof.stage_tables import stages_certificate

    with progress("Lyapunov functions") as update:
        found = switching(families, low, high, rate, schedule.dwell_s if schedule else 0.0, update)
    lines = describe(found)
    several = f"{len(families)} stages, " if schedule else ""
    say(f"{record.name}: {several}outer end mass changing between {low:g} and {high:g} kg")
    for line in lines:
        say(f"  {line}")
    write_certificate(path, stages_certificate(record, found, f"{record.name}\n" + "\n".join(lines)))
    say(f"certificate: {path}")
    write_json(json, switching_fields(found) | {"certificate": path})
    if not found.stable:
        raise typer.Exit(1)
