"""`beamdesign certify-box` and `certify-switching`: proofs over tolerances, and while the payload changes."""

from math import inf
from typing import TYPE_CHECKING, Annotated, Any

import typer

from beamdesign.cli.certify import certificate_file, write_certificate
from beamdesign.cli.command import (
    CommandResult,
    Figure,
    MassRange,
    OutFile,
    TomlFile,
    beside,
    by_stage,
    command,
    mass_range,
    with_controller,
)
from beamdesign.cli.output import echo, echo_table, progress
from beamdesign.json_text import picked

if TYPE_CHECKING:
    from beamdesign.proofs.box import Box, BoxVerdict
    from beamdesign.proofs.tolerance_box import Scaling
    from beamdesign.prototype import InStage, Prototype


@command
def certify_box(
    prototype: TomlFile,
    outer_end_mass: MassRange = None,
    sigmas: Annotated[float, Figure("Sigmas")] = 3.0,
    only: Annotated[list[str] | None, typer.Option(metavar="FIGURE")] = None,
    delay_s: Annotated[float, Figure("Delay")] = 0.0,
    scaling: Annotated[bool, typer.Option("--scaling/--no-scaling")] = False,
    budget: Annotated[int, typer.Option(min=1, max=1_000_000)] = 4000,
    seconds: Annotated[float, Figure("TimeLimit")] = inf,
    out: OutFile = None,
) -> CommandResult:
    """Prove stability for all tolerances at once.

    Figures, end masses and a delay vary together; the proof is written down.

    Proved stable, or refuted by a member that is proved not to be stable, or undecided on a stated share of the box;
    nothing is sampled. Exit status 0 if the whole box is proved stable, 1 otherwise.

    Args:
        prototype: the prototype.toml to certify.
        outer_end_mass: range of mass on the outer tip, kg; else the prototype's.
        sigmas: standard deviations to either side of every figure.
        only: let this figure vary; may be repeated. Default: all.
        delay_s: allow every pure delay in the loop up to this, s.
        scaling: find the largest scaling of the tolerances that is stable.
        budget: most pieces of frequency and parameters to look at.
        seconds: most time for the search of one box.
        out: file for the certificate; else STEM.box.toml in this folder.
    """
    record = with_controller(prototype)
    masses = mass_range(outer_end_mass, record.outer_end_mass_kg or (0.0, 0.0), prototype)

    from beamdesign.proofs.box import certify_box as prove
    from beamdesign.proofs.tolerance_box import largest_scaling, tolerance_box

    def proved(stage: "InStage") -> tuple[dict[str, Any], bool]:
        path = certificate_file(beside(out, stage), f"{prototype.stem}{stage.suffix}.box.toml")
        asked = None if outer_end_mass is None else stage.outer_end_mass_kg
        delays = (0.0, delay_s) if delay_s else None
        rig, box = stage.prototype, tolerance_box(stage.prototype, sigmas, only or None, asked, delay_s=delays)
        with progress("branch and bound") as update:
            update(0.1, f"{len(box.names)} figures")
            verdict = prove(rig, box, budget, seconds)
            update(0.5, "scaling the tolerances" if scaling else "")
            found = largest_scaling(rig, box, budget=budget) if scaling else None
        _echo_box(rig, box, verdict)
        if found is not None:
            echo(f"scaling of the tolerances ({sigmas:g} standard deviations are 1): {found.reason}")
        if verdict.certificate:
            write_certificate(path, verdict.certificate)
            echo(f"certificate: {path}")
        fields = _box_fields(box, verdict, found) | {"certificate": path if verdict.certificate else None}
        return fields, verdict.stable is True

    return by_stage(record, masses, proved)


def _echo_box(record: "Prototype", box: "Box", verdict: "BoxVerdict") -> None:
    from beamdesign.proofs.tolerance_box import figure_key
    from beamdesign.rational import nearest

    words = {True: "stable for every member of the box", False: "NOT stable throughout the box", None: "undecided"}
    echo(f"{record.name}: {words[verdict.stable]}")
    rows = []
    for name, (low, high) in box.ranges.items():
        key, factor = figure_key(name)
        row = [key, nearest(low) / factor, nearest(high) / factor]
        rows.append(row if verdict.unstable_point is None else [*row, nearest(verdict.unstable_point[name]) / factor])
    last = () if verdict.unstable_point is None else ("not stable at",)
    echo_table(f"{len(box.names)} figures, all at once", ("figure", "from", "to", *last), rows)
    if verdict.stable is not True:
        echo(f"  {verdict.reason.rpartition(': ')[2] if verdict.stable is False else verdict.reason}")
        if verdict.volumes is not None:
            shares = [nearest(share) for share in verdict.volumes]
            echo("  share of the box proved stable {:.6g}, proved not stable {:.3g}, undecided {:.3g}".format(*shares))
    if record.effects:
        echo("  effects are covered as linear loops at frozen values, not as the nonlinear loop")
    echo(f"method: zero exclusion, {verdict.pieces} pieces proved in ball arithmetic, one member by an exact test")


def _box_fields(box: "Box", verdict: "BoxVerdict", scaling: "Scaling | None") -> dict[str, Any]:
    from beamdesign.proofs.tolerance_box import figure_key, in_units
    from beamdesign.rational import nearest

    def point(of: Any) -> dict[str, float] | None:
        return None if of is None else in_units(of, list(of))

    shares = [None] * 3 if verdict.volumes is None else [nearest(share) for share in verdict.volumes]
    return {
        **picked(verdict, "stable reason pieces looked_at"),
        "box": {
            key: [nearest(low) / factor, nearest(high) / factor]
            for name, (low, high) in box.ranges.items()
            for key, factor in [figure_key(name)]
        },
        "stable_fraction": shares[0],
        "unstable_fraction": shares[1],
        "undecided_fraction": shares[2],
        "unstable_point": point(verdict.unstable_point),
        "largest_scaling": None
        if scaling is None
        else picked(scaling, "proved refuted limit reason") | {"unstable_point": point(scaling.unstable_point)},
    }


@command
def certify_switching(
    prototype: TomlFile,
    outer_end_mass: MassRange = None,
    rate: Annotated[float | None, Figure("MassRate", metavar="KG_PER_S")] = None,
    out: OutFile = None,
) -> CommandResult:
    """Prove stability while the payload changes in motion.

    That is gripping, releasing, filling, pouring; of a scheduled controller any change of its stage as well. Lyapunov
    functions come from a semidefinite program and are verified in rational arithmetic; what only the solver claims is
    reported as unverified. Exit status 0 if the rate asked for, or else some rate, is proved both for payload that
    joins with the tip's velocity and for payload at rest; of a scheduled controller, if changes of stage as the
    schedule makes them are proved, and the rate if one is asked for; 1 otherwise.

    Args:
        prototype: the prototype.toml, with its controller.
        outer_end_mass: range of mass on the outer tip, kg; else the prototype's.
        rate: prove stability up to this rate of change; else find the largest.
        out: file for the certificate; else STEM.stages.toml in this folder.
    """
    from beamdesign.proofs.mass_family import stage_families
    from beamdesign.records import InputError

    record = with_controller(prototype)
    try:
        families = stage_families(record)
    except ValueError as error:
        raise InputError(prototype, [("controller.stage", str(error))]) from error
    low, high = mass_range(outer_end_mass, record.outer_end_mass_kg, prototype)
    if not low < high:
        reason = f"{low:g}:{high:g} holds one mass, which cannot change"
        raise InputError("certify-switching", [("--outer-end-mass", reason)])
    schedule = record.schedule
    path = certificate_file(out, f"{prototype.stem}.stages.toml")

    from beamdesign.proofs.lyapunov import describe, stages_certificate, switching, switching_fields

    with progress("Lyapunov functions") as update:
        found = switching(families, low, high, rate, schedule.dwell_s if schedule else 0.0, update)
    lines = describe(found)
    several = f"{len(families)} stages, " if schedule else ""
    echo(f"{record.name}: {several}outer end mass changing between {low:g} and {high:g} kg")
    for line in lines:
        echo(f"  {line}")
    write_certificate(path, stages_certificate(record, found, f"{record.name}\n" + "\n".join(lines)))
    echo(f"certificate: {path}")
    return CommandResult(switching_fields(found) | {"certificate": path}, found.stable)
