"""`beamdesign certify-box`: stability proved over a box of tolerances, end masses and delay."""

from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from beamdesign.cli.by_stage import beside, by_stage
from beamdesign.cli.certificate_file import certificate_file, write_certificate
from beamdesign.cli.completion import toml_files
from beamdesign.cli.figures import mass_range, refuse_implausible
from beamdesign.cli.output import (
    JsonOption,
    RangeOption,
    file_to_write,
    progress,
    say,
    say_table,
)

if TYPE_CHECKING:
    from beamdesign.proof.box import Box, BoxVerdict
    from beamdesign.proof.scaling import Scaling
    from beamdesign.prototype import InStage, Prototype


def certify_box(
    prototype: Annotated[Path, typer.Argument(autocompletion=toml_files, help="The prototype.toml to certify.")],
    outer_end_mass: RangeOption = None,
    sigmas: Annotated[float, typer.Option(help="Standard deviations to either side of every figure.")] = 3.0,
    only: Annotated[
        list[str] | None, typer.Option(metavar="FIGURE", help="Let this figure vary; may be repeated. Default: all.")
    ] = None,
    delay_s: Annotated[
        float, typer.Option("--delay-s", help="Allow every pure delay in the loop up to this, s.")
    ] = 0.0,
    scaling: Annotated[bool, typer.Option(help="Find the largest scaling of the tolerances that is stable.")] = False,
    budget: Annotated[
        int, typer.Option(min=1, max=1_000_000, help="Most pieces of frequency and parameters to look at.")
    ] = 4000,
    seconds: Annotated[float, typer.Option(help="Most time for the search of one box.")] = inf,
    out: Annotated[
        Path | None,
        typer.Option(callback=file_to_write, help="File for the certificate; else STEM.box.toml in this folder."),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Prove stability for all tolerances at once.

    Figures, end masses and a delay vary together; the proof is written down.

    Proved stable, or refuted by a member that is proved not to be stable, or undecided on a stated share of the box;
    nothing is sampled. Exit status 0 if the whole box is proved stable, 1 otherwise.
    """
    from beamdesign import quantities as q
    from beamdesign.prototype import read_prototype
    from beamdesign.records import InputError

    refuse_implausible(
        "certify-box",
        {"--sigmas": (sigmas, q.Sigmas), "--delay-s": (delay_s, q.Delay), "--seconds": (seconds, q.TimeLimit)},
    )
    record = read_prototype(prototype)
    if record.controller is None:
        raise InputError(prototype, [("controller", "missing; write it there, or let `beamdesign tune` find one")])
    masses = mass_range(outer_end_mass, record.outer_end_mass_kg or (0.0, 0.0), prototype)

    from beamdesign.proof.tolerance_box import tolerance_box

    def proved(stage: "InStage") -> tuple[dict[str, Any], bool]:
        path = certificate_file(beside(out, stage), f"{prototype.stem}{stage.suffix}.box.toml")
        asked = None if outer_end_mass is None else stage.outer_end_mass_kg
        delays = (0.0, delay_s) if delay_s else None
        box = tolerance_box(stage.prototype, sigmas, only or None, asked, delay_s=delays)
        return _proved(stage.prototype, box, budget, seconds, sigmas if scaling else None, path)

    by_stage(record, masses, proved, json)


def _proved(
    record: "Prototype", box: "Box", budget: int, seconds: float, scaled_sigmas: float | None, path: Path
) -> tuple[dict[str, Any], bool]:
    """Prove, say and write of one law; what is known of it, and whether the whole box is stable."""
    from beamdesign.proof.box import certify_box as prove
    from beamdesign.proof.scaling import largest_scaling

    with progress("branch and bound") as update:
        update(0.1, f"{len(box.names)} figures")
        verdict = prove(record, box, budget, seconds)
        update(0.5, "" if scaled_sigmas is None else "scaling the tolerances")
        found = None if scaled_sigmas is None else largest_scaling(record, box, budget=budget)
    _say(record, box, verdict)
    if found is not None:
        say(f"scaling of the tolerances ({scaled_sigmas:g} standard deviations are 1): {found.reason}")
    if verdict.certificate:
        write_certificate(path, verdict.certificate)
        say(f"certificate: {path}")
    fields = _fields(box, verdict, found) | {"certificate": path if verdict.certificate else None}
    return fields, verdict.stable is True


def _say(record: "Prototype", box: "Box", verdict: "BoxVerdict") -> None:
    from beamdesign.proof.rational import nearest
    from beamdesign.proof.tolerance_box import figure_key

    words = {True: "stable for every member of the box", False: "NOT stable throughout the box", None: "undecided"}
    say(f"{record.name}: {words[verdict.stable]}")
    rows = []
    for name, (low, high) in box.ranges.items():
        key, factor = figure_key(name)
        row = [key, nearest(low) / factor, nearest(high) / factor]
        rows.append(row if verdict.unstable_point is None else [*row, nearest(verdict.unstable_point[name]) / factor])
    last = () if verdict.unstable_point is None else ("not stable at",)
    say_table(f"{len(box.names)} figures, all at once", ("figure", "from", "to", *last), rows)
    if verdict.stable is not True:
        say(f"  {verdict.reason.rpartition(': ')[2] if verdict.stable is False else verdict.reason}")
        if verdict.volumes is not None:
            shares = [nearest(share) for share in verdict.volumes]
            say("  share of the box proved stable {:.6g}, proved not stable {:.3g}, undecided {:.3g}".format(*shares))
    if record.effects:
        say("  effects are covered as linear loops at frozen values, not as the nonlinear loop")
    say(f"method: zero exclusion, {verdict.pieces} pieces proved in ball arithmetic, one member by an exact test")


def _fields(box: "Box", verdict: "BoxVerdict", scaling: "Scaling | None") -> dict[str, Any]:
    from beamdesign.proof.rational import nearest
    from beamdesign.proof.tolerance_box import figure_key, in_units

    def point(of: Any) -> dict[str, float] | None:
        return None if of is None else in_units(of, list(of))

    shares = [None] * 3 if verdict.volumes is None else [nearest(share) for share in verdict.volumes]
    return {
        "stable": verdict.stable,
        "reason": verdict.reason,
        "box": {
            key: [nearest(low) / factor, nearest(high) / factor]
            for name, (low, high) in box.ranges.items()
            for key, factor in [figure_key(name)]
        },
        "stable_fraction": shares[0],
        "unstable_fraction": shares[1],
        "undecided_fraction": shares[2],
        "unstable_point": point(verdict.unstable_point),
        "pieces": verdict.pieces,
        "looked_at": verdict.looked_at,
        "largest_scaling": None
        if scaling is None
        else {
            "proved": scaling.proved,
            "refuted": scaling.refuted,
            "limit": scaling.limit,
            "unstable_point": point(scaling.unstable_point),
            "reason": scaling.reason,
        },
    }
