"""`beamdesign certify-switching` for a prototype with a scheduled controller: changes between its stages."""

from pathlib import Path

import typer

from beamdesign.cli.certificate_file import certificate_file, write_certificate
from beamdesign.cli.figures import mass_range
from beamdesign.cli.output import progress, say, write_json
from beamdesign.cli.tune_scheduled import switching_fields


def certify_stages(path: Path, outer_end_mass: str | None, out: Path | None, json: Path | None) -> None:
    """Prove stability while the stage changes, and the payload with it.

    Args:
        path: prototype with a scheduled controller.
        outer_end_mass: LO:HI as on the command line; else the payloads that the stages cover.
        out: file for the certificate; else STEM.stages.toml in this folder.
        json: file for the answer.

    Raises:
        InputError: where the prototype is wrong, or its laws cannot share their states.
        typer.Exit: with status 1 where changes of stage as the schedule makes them are not proved.
    """
    from beamdesign.polynomial import exact
    from beamdesign.proof.stage_document import in_words, stage_document
    from beamdesign.proof.stage_family import stage_families
    from beamdesign.proof.stage_switching import stage_switching
    from beamdesign.records import InputError
    from beamdesign.scheduling.record import read_scheduled

    rig = read_scheduled(path)
    low, high = mass_range(outer_end_mass, rig.schedule.outer_end_mass_kg, path)
    if not low < high:
        raise InputError("certify-switching", [("--outer-end-mass", f"{low:g}:{high:g} holds one mass alone")])
    try:
        families = stage_families(rig)
    except ValueError as error:
        raise InputError(path, [("controller.stage", str(error))]) from error
    certificate = certificate_file(out, f"{path.stem}.stages.toml")
    with progress("changes of stage") as update:
        found = stage_switching(families, exact(low), exact(high), update)
    lines = in_words(found, rig.schedule.dwell_s)
    say(f"{rig.prototype.name}: {len(families)} stages, payloads from {low:g} to {high:g} kg")
    for line in lines:
        say(f"  {line}")
    write_certificate(certificate, stage_document(rig, found, f"{rig.prototype.name}\n" + "\n".join(lines)))
    say(f"certificate: {certificate}")
    write_json(json, switching_fields(found) | {"certificate": certificate})
    if not found.suffices(rig.schedule.dwell_s):
        raise typer.Exit(1)
