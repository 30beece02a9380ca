"""`beamdesign tune`: controller and inner end mass with the largest guaranteed bandwidth."""

from math import inf
from pathlib import Path
from typing import Annotated

import typer

from beamdesign.cli.completion import toml_files
from beamdesign.cli.output import (
    JsonOption,
    RangeOption,
    folder_to_write,
    mass_range,
    progress,
    say,
    say_table,
    write_json,
)
from beamdesign.whole_file import write_whole

KINDS = ("lag", "proportional")


def tune(
    prototype: Annotated[Path, typer.Argument(autocompletion=toml_files, help="The prototype.toml to tune.")],
    outer_end_mass: RangeOption = None,
    controller: Annotated[str, typer.Option(help="Kind of controller: " + " or ".join(KINDS) + ".")] = "lag",
    largest_inner_end_mass_kg: Annotated[
        float, typer.Option("--largest-inner-end-mass-kg", help="Most mass that may be added inside.")
    ] = 6.0,
    peak_sensitivity: Annotated[
        float | None, typer.Option(help="Limit of the peak sensitivity; else the prototype's goal.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            callback=folder_to_write,
            help="Folder for prototype.toml and certificate.toml; else neither is written.",
        ),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Tune for the largest bandwidth over a payload range.

    Gain, break frequencies and inner end mass are chosen for the largest bandwidth that can be guaranteed: stability,
    peak sensitivity and compliance are proved for every mass of the range, in exact arithmetic, and for all linear
    members of a prototype with effects. Exit status 1 if no design can be proved.
    """
    from beamdesign.design import tuning
    from beamdesign.prototype import read_prototype, write_prototype
    from beamdesign.records import InputError
    from beamdesign.report.quantity import at_least, at_most, mass_range_text
    from beamdesign.study.design_run import CERTIFICATE_NAME, certified

    record = read_prototype(prototype)
    masses = mass_range(outer_end_mass, record.payload.outer_end_mass_kg, prototype)
    if controller not in KINDS:
        raise InputError("--controller", [(controller, f"expected one of {', '.join(KINDS)}")])
    if not 0 <= largest_inner_end_mass_kg < inf:
        raise InputError(
            "--largest-inner-end-mass-kg", [(f"{largest_inner_end_mass_kg:g}", "must be finite and not negative")]
        )
    if peak_sensitivity is not None:
        if not 1 < peak_sensitivity < inf:
            raise InputError("--peak-sensitivity", [(f"{peak_sensitivity:g}", "must be finite and greater than 1")])
        record = record.but(goal=record.goal.but(peak_sensitivity=peak_sensitivity))
    with progress("tuning") as update:
        found = tuning.tune(record, masses, controller, largest_inner_end_mass_kg, update)
    if found.best is None:
        say(found.reason)
        write_json(json, {"controller": None, "inner_end_mass_kg": None, "guaranteed": None, "reason": found.reason})
        raise typer.Exit(1)
    best = found.best
    certificate, guaranteed = certified(found.prototype, best, masses)
    paths: dict[str, Path] = {}
    if out is not None:
        paths = {"prototype": out / "prototype.toml", "certificate": out / CERTIFICATE_NAME}
        write_whole(paths["certificate"], certificate.text)
        write_prototype(guaranteed, paths["prototype"])
    rows = [
        *((name, str(value)) for name, value in best.controller.model_dump().items()),
        ("inner_end_mass_kg", str(best.inner_end_mass_kg)),
        ("guaranteed bandwidth", at_least(best.bandwidth_Hz, "Hz")),
        ("guaranteed peak sensitivity", at_most(best.peak_sensitivity, "1")),
        ("for every outer end mass", mass_range_text(masses)),
    ]
    say_table(f"{record.name}: tuned {controller} controller", ("figure", "value"), rows)
    say(f"proved in exact arithmetic; {found.certificates} stability certificates on the way")
    for line in certificate.scope:
        say(f"  {line}")
    if record.effects:
        from beamdesign.proof.between import between, in_words

        verdict = between(guaranteed, *masses)
        if words := in_words(guaranteed, verdict):
            say(f"  {words}")
        if out is not None and verdict is not None and verdict.certificate:
            paths["certificate_between"] = out / "certificate.between.toml"
            write_whole(paths["certificate_between"], verdict.certificate)
    for kind, path in paths.items():
        say(f"{kind}: {path}")
    write_json(
        json,
        {
            "controller": best.controller.model_dump(),
            "inner_end_mass_kg": best.inner_end_mass_kg,
            "guaranteed": {
                "bandwidth_Hz": best.bandwidth_Hz,
                "peak_sensitivity": best.peak_sensitivity,
                "outer_end_mass_kg": list(masses),
                "method": certificate.method,
                "scope": certificate.scope,
            },
            "starts_bandwidth_Hz": found.starts,
            "stability_certificates": found.certificates,
            **paths,
        },
    )
