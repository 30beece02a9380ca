"""`beamdesign codesign`: sections, inner end mass and controller together, at least moving mass."""

from pathlib import Path
from typing import Annotated

import typer

from beamdesign.cli.completion import toml_files
from beamdesign.cli.figures import mass_range, refuse_implausible
from beamdesign.cli.output import (
    JsonOption,
    RangeOption,
    default_folder,
    folder_to_write,
    progress,
    say,
    say_table,
    write_json,
)
from beamdesign.files import write_set


def codesign(
    study: Annotated[Path, typer.Argument(autocompletion=toml_files, help="The study file with the design problem.")],
    bandwidth_Hz: Annotated[float, typer.Option("--bandwidth-Hz", help="Bandwidth to guarantee, Hz.")],
    outer_end_mass: RangeOption = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            callback=folder_to_write,
            help="Folder for prototype.toml and certificate.toml; else STEM-codesign.",
        ),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Find the lightest link that guarantees a bandwidth.

    Both sections, the inner end mass and the controller are chosen together; the moving mass counts both beams over
    their full length and the inner end mass. The result is proved for every mass of the payload range, not sampled.
    Exit status 1 if no design can be proved.
    """
    from beamdesign.design import codesign as room
    from beamdesign.problem import read_problem
    from beamdesign.quantities import Bandwidth
    from beamdesign.records import to_toml
    from beamdesign.report.quantity import at_least, at_most, mass_range_text
    from beamdesign.study.design_run import CERTIFICATE_NAME, certified

    problem = read_problem(study)
    masses = mass_range(outer_end_mass, problem.payload.outer_end_mass_kg, study)
    refuse_implausible("codesign", {"--bandwidth-Hz": (bandwidth_Hz, Bandwidth)})
    with progress("co-design") as update:
        found = room.codesign(problem, masses, bandwidth_Hz, progress=update)
    point = found.point
    if point is None:
        say(found.reason)
        fields = ("prototype", "moving_mass_kg", "beam_mass_kg", "inner_end_mass_kg", "guaranteed")
        write_json(json, dict.fromkeys(fields) | {"reason": found.reason, "attempts": found.attempts})
        raise typer.Exit(1)
    certificate, guaranteed = certified(point.prototype, point.proved, masses)
    folder = out or default_folder(f"{study.stem}-codesign")
    paths = write_set(
        folder,
        {"prototype": ("prototype.toml", to_toml(guaranteed)), "certificate": (CERTIFICATE_NAME, certificate.text)},
    )
    rows = [
        ("moving mass", f"{point.moving_mass_kg:.3f} kg"),
        ("of which both beams", f"{point.beam_mass_kg:.3f} kg"),
        ("of which inner end mass", f"{point.inner_end_mass_kg:.3f} kg"),
        ("outer beam", f"{point.outer.width_m * 1e3:.2f} x {point.outer.wall_m * 1e3:.3f} mm"),
        ("inner beam", f"{point.inner.width_m * 1e3:.2f} x {point.inner.wall_m * 1e3:.3f} mm"),
        *((name, str(value)) for name, value in point.proved.controller.model_dump().items()),
        ("governing structural check", point.governing),
        ("guaranteed bandwidth", at_least(point.proved.bandwidth_Hz, "Hz")),
        ("guaranteed peak sensitivity", at_most(point.proved.peak_sensitivity, "1")),
        ("for every outer end mass", mass_range_text(masses)),
    ]
    say_table(f"{problem.name}: lightest proved design for {bandwidth_Hz:g} Hz", ("figure", "value"), rows)
    say(f"prototype: {paths['prototype']}")
    write_json(
        json,
        {
            **paths,
            "moving_mass_kg": point.moving_mass_kg,
            "beam_mass_kg": point.beam_mass_kg,
            "inner_end_mass_kg": point.inner_end_mass_kg,
            "outer": point.outer._asdict(),
            "inner": point.inner._asdict(),
            "controller": point.proved.controller.model_dump(),
            "governing": point.governing,
            "checks": [
                {"name": c.name, "value": c.value, "limit": c.limit, "utilisation": c.utilisation} for c in point.checks
            ],
            "guaranteed": {
                "bandwidth_Hz": point.proved.bandwidth_Hz,
                "peak_sensitivity": point.proved.peak_sensitivity,
                "outer_end_mass_kg": list(masses),
            },
            "attempts": found.attempts,
        },
    )
