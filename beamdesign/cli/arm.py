"""`beamdesign arm`: two compensators across each other and torsion: what is proved, and what error remains."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from beamdesign.cli.arm_words import (
    say_compliance,
    say_figures,
    say_place,
    say_proof,
    say_remaining,
    say_remedy,
    say_travel,
)
from beamdesign.cli.by_stage import by_stage
from beamdesign.cli.completion import toml_files
from beamdesign.cli.figures import figures_of, mass_range, refuse_implausible
from beamdesign.cli.output import (
    JsonOption,
    RangeOption,
    folder_to_write,
    say,
)

if TYPE_CHECKING:
    from beamdesign.arm.remaining import Remaining, TwistRemedy, Vector
    from beamdesign.arm.result import ArmResult
    from beamdesign.prototype import InStage, Prototype


def arm(
    prototype: Annotated[
        Path, typer.Argument(autocompletion=toml_files, help="The prototype.toml, with a controller.")
    ],
    offset_m: Annotated[
        str | None,
        typer.Option("--offset-m", metavar="X,Y,Z", help="Payload's centre from the tip; else that of [arm]."),
    ] = None,
    sensor_m: Annotated[
        str | None,
        typer.Option("--sensor-m", metavar="X,Y,Z", help="Where the servos measure, from the tip; else as in [arm]."),
    ] = None,
    outer_end_mass: RangeOption = None,
    force_N: Annotated[
        str | None,
        typer.Option(
            "--force-N",
            metavar="F",
            help="Load on the payload's centre, downwards, or X,Y,Z; else weight and largest force.",
        ),
    ] = None,
    within_m: Annotated[
        str | None,
        typer.Option(
            "--within-m", metavar="X,Y,Z", help="Prove stability for every place of the centre up to so far away, too."
        ),
    ] = None,
    allowed_mm: Annotated[
        float | None,
        typer.Option("--allowed-mm", help="Error that twist may leave; says which tube keeps it."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", callback=folder_to_write, help="Folder for certificates, tables, picture and prototype."
        ),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Work out the link as an arm.

    One compensator upwards (z), one sideways (y), and torsion of the outer beam under a payload that stands off its
    axis: stability proved over the payload, compliance and bandwidth at tip and payload, and the error that a steady
    load leaves, with the servos and without: what the tip does, what its turning in bending adds, what twist adds.
    Exit status 0 if both loops are proved stable over the range (and over every place asked for), 1 otherwise.
    """
    from beamdesign import quantities as q
    from beamdesign.arm.figures import arm_of
    from beamdesign.prototype import read_prototype

    refuse_implausible("arm", {"--allowed-mm": (allowed_mm, q.Millimetres)})
    record = read_prototype(prototype)
    given = arm_of(record)
    if offset_m is not None:
        given = given.but(offset_m=_three(offset_m, "--offset-m", q.Position))
    if sensor_m is not None:
        given = given.but(sensor_m=_three(sensor_m, "--sensor-m", q.Position))
    record = record.but(arm=given)
    within = None if within_m is None else _three(within_m, "--within-m", q.Distance)
    masses = mass_range(outer_end_mass, record.outer_end_mass_kg, prototype)

    def worked_out(stage: "InStage") -> tuple[dict[str, Any], bool]:
        force = _force(stage.prototype, force_N, stage.outer_end_mass_kg[1], prototype)
        folder = out and out / stage.suffix[1:]
        return _worked_out(stage, force, within, allowed_mm, folder)

    by_stage(record, masses, worked_out, json)


def _worked_out(
    stage: "InStage", force: "Vector", within: "Vector | None", allowed_mm: float | None, out: Path | None
) -> tuple[dict[str, Any], bool]:
    """Work out, say and write of one law; what is known of it, and whether both loops are proved stable."""
    from beamdesign.arm.anywhere import prove_anywhere
    from beamdesign.arm.figures import sensor_of
    from beamdesign.arm.remaining import inner_travel, offset_for_goal_m, twist_remedy
    from beamdesign.arm.result import work_out

    record, masses, _ = stage
    found = work_out(record, masses, force)
    say_figures(record, found)
    say_proof(record, found)
    places = {} if within is None else prove_anywhere(record, masses, within)
    for name, verdict in places.items():
        say_place(name, verdict)
    say_compliance(found)
    say_remaining(found, force)
    travel = None if found.with_servo is None else inner_travel(record, found.with_servo)
    if travel is not None:
        say_travel(travel)
    most = offset_for_goal_m(record)
    goal = record.goal.compliance_m_per_N
    if any(sensor_of(record)):
        say("the servos hold the point that they measure, twist or not; how the end turns, they do not see")
    else:
        say(f"twist alone moves the payload by the goal's {goal:.4g} m/N at {most:.4g} m off the axis, and servos that")
        say("  measure at the tip do nothing about it; --sensor-m proves and works out others")
    remedy = None
    if allowed_mm is not None:
        remedy = twist_remedy(record, force, allowed_mm * 1e-3, masses[1])
        say_remedy(remedy)
    files: dict[str, Any] = {}
    if out is not None:
        from beamdesign.cli.arm_folder import write_folder

        files = write_folder(record, found, force, places, out)
        say(f"folder: {out}")
    fields = _fields(found, force, most, remedy) | {
        "inner_travel": travel,
        "within_m": within,
        "anywhere": {name: {"stable": verdict.stable, "reason": verdict.reason} for name, verdict in places.items()},
    }
    yes = found.stable is True and all(verdict.stable is True for verdict in places.values())
    return fields | {"files": files}, yes


def _three(text: str, option: str, quantity: Any) -> "Vector":
    x, y, z = figures_of(option, text, quantity, "three figures as X,Y,Z, such as 0,0.1,0", count=3)
    return x, y, z


def _force(record: "Prototype", text: str | None, payload: float, source: Path) -> "Vector":
    """The load: given, or weight of the largest payload and the prototype's largest force, downwards."""
    from beamdesign.members import STANDARD_GRAVITY
    from beamdesign.quantities import Force, SignedForce
    from beamdesign.records import InputError

    if text is None:
        down = payload * STANDARD_GRAVITY + (record.payload.largest_force_N or 0.0)
        if down == 0:
            reason = "missing, and no payload has weight; give --force-N"
            raise InputError(source, [("payload.largest_force_N", reason)])
        return 0.0, 0.0, -down
    if "," in text:
        return _three(text, "--force-N", SignedForce)
    (down,) = figures_of("--force-N", text, Force, "a force in N, which acts downwards, or three as X,Y,Z", count=1)
    return 0.0, 0.0, -down


def _fields(found: "ArmResult", force: "Vector", most: float, remedy: "TwistRemedy | None") -> dict[str, Any]:
    both = found.both
    return {
        "stable": found.stable,
        "reason": found.reason,
        "outer_end_mass_kg": found.outer_end_mass_kg,
        "figures": found.figures,
        "planes": [
            {
                "plane": plane.name,
                "coupled_with_torsion": plane.coupled,
                "stable": plane.stable,
                "stable_ranges_kg": plane.stability.stable_ranges,
                "crossings": [
                    {"outer_end_mass_kg": c.value, "frequency_Hz": c.frequency_Hz if c.finite else None}
                    for c in plane.crossings
                ],
                "guaranteed": plane.guaranteed,
            }
            for plane in found.planes
        ],
        "both_planes": None if both is None else {"stable": both.stable, "reason": both.reason, "pieces": both.pieces},
        "sampled_stable": found.sampled_stable,
        "sampled_load_Hz": found.sampled_load_Hz,
        "compliance": {
            "payload_without_servo": found.passive.tolist(),
            "payload_with_servo": None if found.active is None else found.active.tolist(),
            "tip_without_servo": found.tip_passive.tolist(),
            "tip_with_servo": None if found.tip_active is None else found.tip_active.tolist(),
        },
        "force_N": force,
        "without_servo": _case(found.without),
        "with_servo": None if found.with_servo is None else _case(found.with_servo),
        "frequencies": found.frequencies,
        "offset_for_goal_m": most,
        "twist_remedy": remedy,
    }


def _case(case: "Remaining") -> dict[str, Any]:
    names = type(case).__dataclass_fields__
    return {name: getattr(case, name) for name in names} | {"size_m": case.size_m, "shares_m": case.shares_m}
