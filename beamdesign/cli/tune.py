"""`beamdesign tune`: controller and inner end mass with the largest guaranteed bandwidth."""

from pathlib import Path
from typing import Annotated

import typer

from beamdesign.cli.output import JsonOption, RangeOption, mass_range, progress, say, say_table, write_json

KINDS = ("lag", "proportional")


def tune(
    prototype: Annotated[Path, typer.Argument(help="The prototype.toml to tune.")],
    outer_end_mass: RangeOption = None,
    controller: Annotated[str, typer.Option(help="Kind of controller: " + " or ".join(KINDS) + ".")] = "lag",
    largest_inner_end_mass_kg: Annotated[
        float, typer.Option("--largest-inner-end-mass-kg", min=0.0, help="Most mass that may be added inside.")
    ] = 6.0,
    peak_sensitivity: Annotated[
        float | None, typer.Option(min=1.0, help="Limit of the peak sensitivity; else the prototype's goal.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for prototype.toml and certificate.toml.")] = None,
    json: JsonOption = None,
) -> None:
    """Tune controller and inner end mass for the largest guaranteed bandwidth over a payload range.

    The guarantee (stability, peak sensitivity, compliance) is proved for every mass of the range, in exact arithmetic.
    """
    from beamdesign.design import tuning
    from beamdesign.prototype import read_prototype, write_prototype
    from beamdesign.records import InputError
    from beamdesign.study.design_run import CERTIFICATE_NAME, certified

    record = read_prototype(prototype)
    masses = mass_range(outer_end_mass, record.payload.outer_end_mass_kg, prototype)
    if controller not in KINDS:
        raise InputError("--controller", [(controller, f"expected one of {', '.join(KINDS)}")])
    if peak_sensitivity is not None:
        if not 1 < peak_sensitivity < float("inf"):
            raise InputError("--peak-sensitivity", [(str(peak_sensitivity), "must be finite and greater than 1")])
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
        out.mkdir(parents=True, exist_ok=True)
        paths = {"prototype": out / "prototype.toml", "certificate": out / CERTIFICATE_NAME}
        paths["certificate"].write_text(certificate.text, encoding="utf-8")
        write_prototype(guaranteed, paths["prototype"])
    rows = [(name, value) for name, value in best.controller.model_dump().items()]
    rows += [
        ("inner_end_mass_kg", best.inner_end_mass_kg),
        ("guaranteed bandwidth_Hz", best.bandwidth_Hz),
        ("guaranteed peak_sensitivity", best.peak_sensitivity),
        ("for every outer_end_mass_kg", f"{masses[0]:g} to {masses[1]:g}"),
    ]
    say_table(f"{record.name}: tuned {controller} controller", ("figure", "value"), rows)
    say(f"proved in exact arithmetic; {found.certificates} stability certificates on the way")
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
            },
            "starts_bandwidth_Hz": found.starts,
            "stability_certificates": found.certificates,
            **paths,
        },
    )
