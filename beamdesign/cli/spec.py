"""`beamdesign spec`: what a workshop and a controls engineer need to build a prototype and to accept it."""

from pathlib import Path
from typing import Annotated

from beamdesign.cli.command import CommandResult, Figure, RigArgument, command, mass_range, out_folder, ready_to_run
from beamdesign.cli.output import RangeOption, default_folder, echo, echo_table, progress


@command
def spec(
    prototype: RigArgument,
    out: Annotated[Path | None, out_folder("Folder for the specification; else NAME.specification here.")] = None,
    outer_end_mass: RangeOption = None,
    sampling_rate_Hz: Annotated[
        float | None, Figure("Of the difference equation; else at least 40 times the crossover.", "SamplingRate")
    ] = None,
    load_N: Annotated[
        float | None, Figure("Load for the ratings; else the prototype's largest force or payload's weight.", "Force")
    ] = None,
    noise_share: Annotated[
        float, Figure("Share of the motion that the goal allows, which sensor noise may cause.", "Share")
    ] = 0.1,
) -> CommandResult:
    """Specify what to build and how to accept it.

    Sections, drawing (DXF and SVG), ratings, sensor, the controller as a circuit and as code, each proved again as it
    is realised; tolerances that keep the proof; an acceptance test with limits, and the data set folder to fill in for
    `beamdesign gap diagnose`. Of a scheduled controller circuit, code and acceptance test of each law over its own
    payloads, and the rule by which they change. Exit status 1 if the loop is not stable over the range, with the
    reason.
    """
    record = ready_to_run(prototype)
    masses = mass_range(outer_end_mass, record.payload.outer_end_mass_kg or (0.0, 0.0), prototype)

    from beamdesign.build.folder import write_specification
    from beamdesign.build.specification import specify

    folder = out or default_folder(f"{prototype.resolve().stem}.specification")
    with progress("specifying") as update:
        found = specify(record, masses, sampling_rate_Hz, load_N, noise_share, progress=update)
        update(1.0, "writing")
        paths = write_specification(found, folder)
    answer = CommandResult(found.to_dict() | {"files": paths}, not found.reason)
    if found.reason:
        echo(f"{record.name}: {found.reason}")
        return answer
    echo_table(f"{record.name}: specification", ("figure", "value", "basis"), found.rows())
    if record.payload.outer_end_mass_kg is None and outer_end_mass is None:
        echo("the prototype states no payload: specified without any; --outer-end-mass LO:HI asks for a range")
    for path in paths.values():
        echo(str(path))
    return answer
