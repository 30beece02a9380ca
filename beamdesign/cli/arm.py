"""`beamdesign arm` and `certify-switching`: both planes, torsion and what error remains; a payload that changes."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import beamdesign
from beamdesign.cli.certify import echo_against_goal, echo_stability
from beamdesign.cli.command import (
    CommandResult,
    Figure,
    OutFile,
    by_stage,
    command,
    figures_of,
    mass_range,
    with_controller,
)
from beamdesign.cli.output import certificate_file, echo, echo_table, progress, refuse, spare, write_certificate
from beamdesign.files import fresh_folder, settled, write_whole
from beamdesign.result import picked

if TYPE_CHECKING:
    from beamdesign.proofs.arm.remaining import TwistRemedy, Vector
    from beamdesign.proofs.arm.result import ArmResult
    from beamdesign.proofs.box import BoxVerdict
    from beamdesign.prototype import InStage, Prototype


_Place = Annotated[str | None, typer.Option(metavar="X,Y,Z")]


@command
def arm(
    prototype: Path,
    offset_m: _Place = None,
    sensor_m: _Place = None,
    outer_end_mass: str | None = None,
    force_N: Annotated[str | None, typer.Option(metavar="F")] = None,
    within_m: _Place = None,
    allowed_mm: Annotated[float | None, Figure("Millimetres")] = None,
    out: Path | None = None,
) -> CommandResult:
    """Work out the link as an arm.

    One compensator upwards (z), one sideways (y), and torsion of the outer beam under a payload that stands off its
    axis: stability proved over the payload, compliance and bandwidth at tip and payload, and the error that a steady
    load leaves, with the servos and without: what the tip does, what its turning in bending adds, what twist adds.
    Exit status 0 if both loops are proved stable over the range (and over every place asked for), 1 otherwise.

    Args:
        prototype: the prototype.toml, with a controller.
        offset_m: payload's centre from the tip; else that of [arm].
        sensor_m: where the servos measure, from the tip; else as in [arm].
        force_N: load on the payload's centre, downwards, or X,Y,Z; else weight and largest force.
        within_m: prove stability for every place of the centre up to so far away, too.
        allowed_mm: error that twist may leave; says which tube keeps it.
        out: folder for certificates, tables, picture and prototype.
    """
    from beamdesign.structure.arm import arm_of, sensor_of

    record = beamdesign.read_prototype(prototype)
    spare([prototype], out, ["prototype.toml"])
    stated = (("offset_m", "--offset-m", offset_m), ("sensor_m", "--sensor-m", sensor_m))
    given = {name: _three(text, option, "Position") for name, option, text in stated if text is not None}
    record = record.but(arm=arm_of(record).but(**given))
    within = None if within_m is None else _three(within_m, "--within-m", "Distance")
    masses = mass_range(outer_end_mass, record.outer_end_mass_kg, prototype)

    from beamdesign.proofs.arm.both_planes import prove_anywhere
    from beamdesign.proofs.arm.remaining import inner_travel, offset_for_goal_m, twist_remedy
    from beamdesign.quantities import rigs_in_words

    def worked_out(stage: "InStage") -> tuple[dict[str, Any], bool]:
        own, payloads, _ = stage
        force = _force(own, force_N, payloads[1], prototype)
        places = {} if within is None else prove_anywhere(own, payloads, within)  # or refused, before anything is told
        found = beamdesign.arm(own, payloads, force)
        _echo_figures(own, found)
        _echo_proof(own, found)
        for name, verdict in places.items():
            planes = "both planes" if name == "both" else f"plane {name}"
            every = f"every payload and every place of its centre asked for, of {rigs_in_words(0.0)}"
            echo(f"{planes}, for {every}: {_VERDICTS[verdict.stable]}")
            if verdict.reason:
                echo(f"  {verdict.reason}")
        _echo_compliance(found)
        _echo_remaining(found, force)
        travel = None if found.with_servo is None else inner_travel(own, found.with_servo)
        if travel is not None:
            gap = "" if travel.gap_m is None else f", of a gap of {1e3 * travel.gap_m:.4g} mm"
            y, z = (1e3 * value + 0.0 for value in travel.travel_m)
            touches = ": the tubes TOUCH" if travel.touches else ""
            echo(f"the inner tip gives way by {y:.4g} mm in y, {z:.4g} mm in z, of its weight too{gap}{touches}")
        most = offset_for_goal_m(own)
        if any(sensor_of(own)):
            echo("the servos hold the point that they measure, twist or not; how the end turns, they do not see")
        else:
            goal = f"the goal's {own.goal.compliance_m_per_N:.4g} m/N"
            echo(f"twist alone moves the payload by {goal} at {most:.4g} m off the axis, and servos that")
            echo("  measure at the tip do nothing about it; --sensor-m proves and works out others")
        remedy = None
        if allowed_mm is not None:
            remedy = twist_remedy(own, force, allowed_mm * 1e-3, payloads[1])
            _echo_remedy(remedy)
        files: dict[str, Any] = {}
        if out is not None:
            folder = out / stage.suffix[1:]
            with fresh_folder(folder, ("certificate_*.toml",)) as fresh:
                written = _written(own, found, force, places, fresh)
            files = settled(written, fresh, folder)
            echo(f"folder: {folder}")
        fields = found.to_dict() | {
            "force_N": force,
            "offset_for_goal_m": most,
            "twist_remedy": remedy,
            "inner_travel": travel,
            "within_m": within,
            "anywhere": {name: picked(verdict, "stable reason") for name, verdict in places.items()},
        }
        yes = found.stable is True and all(verdict.stable is True for verdict in places.values())
        return fields | {"files": files}, yes

    return by_stage(record, masses, worked_out)


def _three(text: str, option: str, quantity: str) -> "Vector":
    x, y, z = figures_of(option, text, quantity, "three figures as X,Y,Z, such as 0,0.1,0", count=3)
    return x, y, z


def _force(record: "Prototype", text: str | None, payload: float, source: Path) -> "Vector":
    """The load: given, or weight of the largest payload and the prototype's largest force, downwards."""
    from beamdesign.proofs.arm.result import usual_load_N

    if text is None:
        if not any(load := usual_load_N(record, payload)):
            refuse(source, ("payload.largest_force_N", "missing, and no payload has weight; give --force-N"))
        return load
    if "," in text:
        return _three(text, "--force-N", "SignedForce")
    (down,) = figures_of("--force-N", text, "Force", "a force in N, which acts downwards, or three as X,Y,Z", count=1)
    return 0.0, 0.0, -down


_NO_YES = ("no", "yes")
_VERDICTS = {True: "stable", False: "NOT stable", None: "UNDECIDED"}


def _echo_figures(record: "Prototype", found: "ArmResult") -> None:
    """Where the payload is, what stands for what, natural frequencies."""
    from beamdesign.structure.arm import arm_of, sensor_of

    def place(point: "Vector") -> str:
        return ", ".join(f"{name} {value:g}" for name, value in zip("xyz", point, strict=True))

    centre = place(arm_of(record).offset_m)
    echo(f"{record.name}: payload's centre at {centre} m from the tip (x along the beam, y sideways, z upwards)")
    if any(sensor := sensor_of(record)):
        echo(f"  servos measure at {place(sensor)} m from the tip")
    echo(*found.figures.notes, before="  ")
    rows = [
        (f"{at.outer_end_mass_kg:g}", *at.modes_Hz, at.torsion_held_Hz, at.turning_held_Hz) for at in found.frequencies
    ]
    columns = ("payload, kg", "1st", "2nd", "3rd", "tip held: torsion", "turning")
    echo_table("Natural frequencies of the outer beam, Hz", columns, rows)


def _echo_proof(record: "Prototype", found: "ArmResult") -> None:
    """What is proved of the planes."""
    from beamdesign.quantities import mass_range_text, rigs_in_words, stated_bandwidth

    asked, goal = mass_range_text(found.outer_end_mass_kg), record.goal
    limit = f"{goal.compliance_m_per_N:.15g} m/N"
    if found.both is not None:
        reason = f": {found.both.reason}" if found.both.reason else ""
        verdict = f"{_VERDICTS[found.both.stable]} from {asked}, for {rigs_in_words(0.0)}"
        echo(f"both planes, coupled by the payload: {verdict}{reason}")
        echo("  method: zero exclusion in ball arithmetic over the payload; bandwidth and peaks are not proved")
        if found.sampled_load_Hz is not None:
            in_y, in_z = found.sampled_load_Hz
            echo(f"  sampled: a force on the payload moves it by at most {limit} up to")
            echo(f"    {in_y:.4g} Hz in y and {in_z:.4g} Hz in z")
        for mass, stable in found.sampled_stable:
            echo(f"  at {mass:g} kg: {'stable' if stable else 'not stable'} (poles, sampled)")
    for plane in found.planes:
        with_what = "with torsion" if plane.coupled else "without torsion, which the payload does not bring in"
        echo_stability(f"plane {plane.name}, {with_what}", plane, f"for {rigs_in_words(0.0)}")
        if (sure := plane.guaranteed) is None:
            continue
        if sure.tip_bandwidth_Hz > 0:
            echo(f"  guaranteed at the tip: at most {limit} up to {stated_bandwidth(sure.tip_bandwidth_Hz)}")
        else:
            echo(f"  at the tip even a steady force moves it by more than {limit}, the goal")
        if sure.load_bandwidth_Hz > 0:
            echo(f"  guaranteed at the payload: at most {limit} up to {stated_bandwidth(sure.load_bandwidth_Hz)}")
        else:
            static = f"{sure.load_static_m_per_N:.4g} m/N"
            echo(f"  at the payload even a steady force moves it by {static}, beyond the goal")
        echo_against_goal(sure, goal)


def _echo_compliance(found: "ArmResult") -> None:
    """Steady compliance at the tip and at the payload."""
    rows = []
    for place in ("tip", "payload"):
        passive, active = found.compliances[place, False], found.compliances[place, True]
        assert passive is not None
        for direction, i, turn in (("y", 1, 5), ("z", 2, 4)):
            cells = [1e9 * float(passive[k, i]) + 0.0 for k in (i, turn, 3)]  # no negative zero
            driven: list[Any] = ["-"] * 3 if active is None else [1e9 * float(active[k, i]) + 0.0 for k in (i, turn, 3)]
            rows.append((f"{place}, {direction}", *cells, *driven))
    columns = ("at", "moves", "turns", "twists", "servo: moves", "turns", "twists")
    echo_table("Under 1 N, steady, the outer beam alone and with both servos: nm, nrad", columns, rows)


def _echo_remaining(found: "ArmResult", force: "Vector") -> None:
    """What a load leaves, by cause."""
    rows = []
    for words, case in (("alone", found.without), ("servos", found.with_servo)):
        if case is not None:
            turns = [1e3 * value + 0.0 for value in case.rotation_rad]
            sizes = (case.size_m, *case.shares_m.values())
            rows.append((words, *(f"{1e3 * size:.3g}" for size in sizes), *(f"{angle:.3g}" for angle in turns)))
    load = ", ".join(f"{value:g}" for value in force)
    columns = ("beam", "error", "tip", "turning", "twist", "about x", "y", "z")
    echo_table(f"What a steady load of ({load}) N leaves: mm, by cause; mrad of the end", columns, rows)
    if found.with_servo is None:
        echo("with servo: nothing is told of loops that are not proved stable")
    else:
        y, z = found.with_servo.actuators_N
        echo(f"actuators: {y + 0.0:.4g} N in y, {z + 0.0:.4g} N in z")


def _echo_remedy(remedy: "TwistRemedy") -> None:
    """What would keep twist small."""
    echo(f"to keep twist at {1e3 * remedy.allowed_m:g} mm: G J / L of {remedy.needed_N_m_per_rad:.6g} N m/rad")
    if remedy.width_m is not None:
        echo(f"  outer tube {1e3 * remedy.width_m:.4g} mm wide, wall as it is: {remedy.width_added_kg:.3g} kg more")
    if remedy.wall_m is not None:
        fits = "" if remedy.wall_fits is not False else ", in which the inner tube does not fit"
        echo(f"  or wall {1e3 * remedy.wall_m:.4g} mm, width as it is: {remedy.wall_added_kg:.3g} kg more{fits}")
    elif remedy.width_m is not None:
        echo("  no wall up to a tenth of the width does it")
    if remedy.counterweight_kg_m > 0:
        echo(f"  or, against weight alone, {remedy.counterweight_kg_m:.4g} kg m on the other side of the axis")


def _written(
    record: "Prototype", found: "ArmResult", force: "Vector", places: Mapping[str, "BoxVerdict"], out: Path
) -> dict[str, Any]:
    from beamdesign.columns import csv_text
    from beamdesign.plant.assembly import pace
    from beamdesign.proofs.arm.both_planes import both_planes
    from beamdesign.report.canvas import save
    from beamdesign.report.drawing import compliance_curves, draw_arm
    from beamdesign.structure.lumped import figures

    texts = {f"certificate_{plane.name}": plane.text for plane in found.planes}
    if found.both is not None and found.both.certificate:
        texts["certificate_both"] = found.both.certificate
    texts |= {f"certificate_anywhere_{name}": one.certificate for name, one in places.items() if one.certificate}
    motions = ("x_m", "y_m", "z_m", "about_x_rad", "about_y_rad", "about_z_rad")
    loads = ("force_x_N", "force_y_N", "force_z_N", "moment_x_N_m", "moment_y_N_m", "moment_z_N_m")
    compliance = [
        {"at": at, "servo": _NO_YES[servo], "motion": motion} | dict(zip(loads, map(float, row), strict=True))
        for (at, servo), matrix in found.compliances.items()
        if matrix is not None
        for motion, row in zip(motions, matrix, strict=True)
    ]
    remaining = [
        {"servo": servo, "cause": cause} | dict(zip(("x_m", "y_m", "z_m"), vector, strict=True))
        for servo, case in zip(_NO_YES, (found.without, found.with_servo), strict=True)
        if case is not None
        for cause, vector in (*case.causes_m.items(), ("all", case.error_m))
    ]
    curves = compliance_curves(both_planes(record), found, pace(figures(record)))
    tables: dict[str, Any] = {"compliance": compliance, "remaining": remaining, "response": curves.rows()}
    kinds = dict.fromkeys(texts, "toml") | dict.fromkeys(tables, "csv")
    files: dict[str, Any] = {name: out / f"{name}.{kind}" for name, kind in kinds.items()}
    for name, text in (texts | {name: csv_text(rows) for name, rows in tables.items()}).items():
        write_whole(files[name], text)
    files |= {"figures": save(draw_arm(record, found, force, curves), out / "arm"), "prototype": out / "prototype.toml"}
    beamdesign.write_prototype(record, files["prototype"])
    return files


@command
def certify_switching(
    prototype: Path,
    outer_end_mass: str | None = None,
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
        rate: prove stability up to this rate of change; else find the largest.
        out: file for the certificate; else STEM.stages.toml in this folder.
    """
    record = with_controller(prototype)
    low, high = mass_range(outer_end_mass, record.outer_end_mass_kg, prototype)
    if not low < high:
        refuse("certify-switching", ("--outer-end-mass", f"{low:g}:{high:g} holds one mass, which cannot change"))
    path = certificate_file(out, prototype, "stages")

    from beamdesign.proofs.lyapunov import describe, stages_certificate
    from beamdesign.structure.arm import left_aside

    try:
        with progress("Lyapunov functions") as update:
            found = beamdesign.certify_switching(record, (low, high), rate, update)
    except ValueError as error:
        refuse(prototype, ("controller.stage", str(error)))
    lines = describe(found)
    if aside := left_aside(record):
        lines.append(aside)
    several = f"{len(found.families)} stages, " if record.schedule else ""
    echo(f"{record.name}: {several}outer end mass changing between {low:.15g} and {high:.15g} kg")
    echo(*lines, before="  ")
    write_certificate(path, stages_certificate(record, found, f"{record.name}\n" + "\n".join(lines)))
    return CommandResult(found.to_dict() | {"arm_left_aside": aside, "certificate": path}, found.yes)
