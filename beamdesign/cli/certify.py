"""`beamdesign certify`, `certify-box` and `certify-switching`: proofs over payloads, tolerances and changes."""

from collections.abc import Callable, Sequence
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from beamdesign.cli.command import (
    CommandResult,
    Figure,
    OutFile,
    beside,
    by_stage,
    command,
    mass_range,
    with_controller,
)
from beamdesign.cli.output import certificate_file, echo, progress, refuse, write_certificate
from beamdesign.cli.proved import (
    box_fields,
    echo_against_goal,
    echo_box,
    echo_each,
    echo_over_passive,
    echo_stability,
    hertz,
)
from beamdesign.result import picked

if TYPE_CHECKING:
    from beamdesign.proofs.absolute_stability import Row
    from beamdesign.proofs.certificate import Asked, Certificate
    from beamdesign.prototype import InStage, Prototype


@command
def certify(
    prototype: Path | None = None,
    outer_end_mass: str | None = None,
    bandwidth_Hz: Annotated[float | None, Figure("Frequency")] = None,
    peak_sensitivity: Annotated[float | None, Figure("LoopGain")] = None,
    loop_gain: Annotated[float | None, Figure("LoopGain")] = None,
    controller_effort_A_per_V: Annotated[float | None, Figure("LawGain")] = None,
    decay_rate_per_s: Annotated[float | None, Figure("DecayRate")] = None,
    gain_margin: Annotated[float | None, Figure("GainFactor")] = None,
    linear: bool = False,
    nonlinear: bool = False,
    out: OutFile = None,
    replay: Annotated[Path | None, typer.Option(metavar="CERTIFICATE")] = None,
) -> CommandResult:
    """Prove stability and performance over a payload range.

    For every outer end mass of the range; the proof is written down. All decisions are exact, none is sampled.
    Of a prototype with effects, all linear members that stand for them are proved, of a scheduled controller each law
    over its own payloads. All of it holds for exactly the
    figures of the prototype.
    Exit status 0 if the loop is stable over the whole range and every claim that was made holds, 1 otherwise; 1 also
    where an effect lets small motion follow none of the members: within the play of a joint nothing is proved, and
    within a dead band, friction or hysteresis no compliance. --linear asks of the members alone.

    Args:
        prototype: the prototype.toml to certify.
        bandwidth_Hz: claim the goal's compliance up to this frequency.
        peak_sensitivity: claim that max |1/(1+L)| is at most this.
        loop_gain: claim that |L| is at most this from the goal's loop_gain_from_Hz up.
        controller_effort_A_per_V: claim that |C/(1+L)| is at most this at every frequency.
        decay_rate_per_s: claim that every pole decays faster than this.
        gain_margin: claim stability with the gain times all from 1 to this.
        linear: let the answer be about linear members alone, where effects are in the way of more.
        nonlinear: also prove, of the nominal figures, what holds while effects move, and while the current saturates,
            which it does on every rig; the answer is no where something is not proved.
        out: file for the certificate; else STEM.certificate.toml in this folder.
        replay: prove this certificate again; with PROTOTYPE, also that it is its.
    """
    from beamdesign.prototype import read_prototype

    claims = {
        "--bandwidth-Hz": bandwidth_Hz,
        "--peak-sensitivity": peak_sensitivity,
        "--loop-gain": loop_gain,
        "--controller-effort-A-per-V": controller_effort_A_per_V,
        "--decay-rate-per-s": decay_rate_per_s,
        "--gain-margin": gain_margin,
    }
    if replay is not None:
        others = {
            "--linear": linear or None,
            "--nonlinear": nonlinear or None,
            "--outer-end-mass": outer_end_mass,
            "--out": out,
        }
        given = [name for name, value in (*claims.items(), *others.items()) if value is not None]
        if given:
            refuse("certify", *((name, "has no meaning with --replay") for name in given))
        return _replay(replay, None if prototype is None else read_prototype(prototype))
    if prototype is None:
        refuse("certify", ("PROTOTYPE", "missing; or give --replay CERTIFICATE"))
    record = with_controller(prototype)
    masses = mass_range(outer_end_mass, record.outer_end_mass_kg, prototype)
    stem = prototype.stem

    from beamdesign.proofs.certifying import certify as prove
    from beamdesign.proofs.near_rest import holds_for, near_rest, uncovered

    def proved(stage: "InStage") -> tuple[dict[str, Any], bool]:
        path = certificate_file(beside(out, stage), f"{stem}{stage.suffix}.certificate.toml")
        rig, asked = stage.prototype, _asked(stage.prototype, claims)
        certificate = prove(rig, *stage.outer_end_mass_kg, asked, nonlinear)
        write_certificate(path, certificate.text)
        bounded = {name for row in certificate.nonlinear if row.bound_m is not None for name in row.effects}
        left = tuple(one for one in near_rest(rig) if one.effect not in bounded)
        _echo(rig, certificate)
        echo(f"certificate: {path}")
        fields = certificate.to_dict() | (_between(rig, certificate, path) if rig.effects else {})
        fields |= {"holds_for": holds_for(rig), "near_rest": left}
        holds = certificate.holds
        if holds and not linear and (reason := uncovered(left, asked)):
            echo(f"{rig.name}: {reason}; --linear asks of linear members alone")
            holds, fields = False, fields | {"reason": reason}
        return fields | {"certificate": path}, holds

    return by_stage(record, masses, proved)


def _between(record: "Prototype", certificate: "Certificate", path: Path) -> dict[str, Any]:
    """What is known between the members of a prototype with effects; its certificate goes beside the other."""
    from beamdesign.proofs.tolerance_box import between, in_words

    verdict = between(record, *certificate.outer_end_mass_kg) if certificate.stable else None
    if certificate.stable and (words := in_words(verdict)):
        echo(f"  {words}")
    fields: dict[str, Any] = {"stable_between": None if verdict is None else verdict.stable}
    if verdict is not None and verdict.certificate:
        beside = path.with_suffix(".between.toml")
        write_certificate(beside, verdict.certificate)
        echo(f"certificate of that: {beside}")
        fields["certificate_between"] = beside
    return fields


def _asked(record: "Prototype", claims: dict[str, float | None]) -> list["Asked"]:
    """The claims made on the command line."""
    from beamdesign.proofs.certificate import Asked

    goal = record.goal
    kinds: dict[str, Callable[[float], Asked]] = {
        "--bandwidth-Hz": lambda bandwidth: Asked("compliance", goal.compliance_m_per_N, bandwidth),
        "--peak-sensitivity": lambda peak: Asked("peak_sensitivity", peak),
        "--loop-gain": lambda gain: Asked("loop_gain", gain, from_Hz=goal.loop_gain_from_Hz),
        "--controller-effort-A-per-V": lambda effort: Asked("controller_effort", effort),
        "--decay-rate-per-s": lambda rate: Asked("decay_rate", rate),
        "--gain-margin": lambda factor: Asked("gain_margin", factor),
    }
    return [kinds[option](value) for option, value in claims.items() if value is not None]


def _echo(record: "Prototype", certificate: "Certificate") -> None:
    from beamdesign.proofs.certificate import describe
    from beamdesign.proofs.near_rest import holds_for
    from beamdesign.quantities import stated_bandwidth

    echo_stability(record.name, certificate, holds_for(record))
    for side, crossing in certificate.next_crossings.items():
        if crossing is not None:
            echo(f"  the next crossing {side} the range is at {crossing.value:.7g} kg, {hertz(crossing)} Hz")
    if certificate.guaranteed is not None:
        found, goal = certificate.guaranteed, record.goal
        bandwidth = stated_bandwidth(found.bandwidth_Hz)
        echo(f"  guaranteed: |x/F_d| at most {goal.compliance_m_per_N:.4g} m/N up to {bandwidth}")
        echo_against_goal(found, goal)
        if isfinite(found.peak_over_passive):
            echo_over_passive(found.peak_compliance_m_per_N, found.servo_off_m_per_N, found.peak_over_passive, goal)
    for claim in certificate.claims:
        echo(f"  {'proved' if claim.holds else 'REFUTED'}: {describe(claim)}")
        if not claim.holds:
            echo(f"    {claim.reason}")
    _echo_moving(certificate.nonlinear)
    echo(f"method: {certificate.method}")
    for line in certificate.scope:
        echo(f"  {line}")
    if record.arm is not None and (any(record.arm.offset_m) or any(record.arm.sensor_m or ())):
        echo(
            "  payload and sensor on the beam's axis at the tip; with the offsets of [arm] and torsion: beamdesign arm"
        )


def _echo_moving(rows: "Sequence[Row]") -> None:
    """What is proved of effects while they move."""
    for row in rows:
        bound = "" if row.bound_m is None else f", the tip strays by at most {row.bound_m:.4g} m"
        echo(f"  {'proved' if row.proved else 'NOT PROVED'} while it moves: {', '.join(row.effects)}{bound}")
        echo(f"    {row.covers}")


def _replay(path: Path, record: "Prototype | None") -> CommandResult:
    """Prove a certificate again from what it states."""
    from beamdesign.checker import Unreadable, check
    from beamdesign.proofs.writer import prototype_table

    try:
        verdict = check(path, None if record is None else lambda *of: prototype_table(record, *of))
    except Unreadable as error:
        refuse(path, ("(certificate)", str(error)))
    for words in verdict.lines():
        echo(words)
    echo(f"{path}: {'valid' if verdict.valid else 'NOT valid'}")
    return CommandResult(picked(verdict, "valid reasons=failed checked=proved not_checked=open about"), verdict.valid)


@command
def certify_box(
    prototype: Path,
    outer_end_mass: str | None = None,
    sigmas: float = 3.0,
    only: Annotated[list[str] | None, typer.Option(metavar="FIGURE")] = None,
    delay_s: Annotated[float, Figure("Delay")] = 0.0,
    scaling: Annotated[bool, typer.Option("--scaling/--no-scaling")] = False,
    each: bool = False,
    budget: Annotated[int, typer.Option(min=1, max=1_000_000)] = 4000,
    seconds: Annotated[float, Figure("TimeLimit")] = inf,
    nonlinear: bool = False,
    out: OutFile = None,
) -> CommandResult:
    """Prove stability and performance for all tolerances at once.

    Figures, end masses and a delay vary together; the proof is written down.

    Proved stable, or refuted by a member that is proved not to be stable, or undecided on a stated share of the box;
    of a stable box the best bandwidth and peak sensitivity are found that are proved of every member. A search finds
    the worst members, but nothing that is claimed is sampled. Exit status 0 if the whole box is proved stable, and what
    --nonlinear asks of it, 1 otherwise.

    Args:
        prototype: the prototype.toml to certify.
        sigmas: standard deviations to either side of every figure.
        only: let this figure vary; may be repeated. Default: all.
        delay_s: allow every pure delay in the loop up to this, s.
        scaling: find the largest scaling of the tolerances that is stable.
        each: find it of each figure alone, the others staying as far off as they may be.
        budget: most pieces of frequency and parameters to look at, for each claim.
        seconds: most time for each search.
        nonlinear: also prove that every member comes to rest while the current saturates, and with the static
            characteristics among its effects, and how far friction, hysteresis, dead band, ripple and resolution move
            its tip; the answer is no where something is not proved.
        out: file for the certificate; else STEM.box.toml in this folder.
    """
    record = with_controller(prototype)
    masses = mass_range(outer_end_mass, record.outer_end_mass_kg or (0.0, 0.0), prototype)

    from beamdesign.proofs.absolute_stability import members
    from beamdesign.proofs.box import certify_box as prove
    from beamdesign.proofs.box_claims import best_over_box, guaranteed_fields
    from beamdesign.proofs.certificate import describe, over_passive
    from beamdesign.proofs.changing_gain import changing_over_box
    from beamdesign.proofs.error_over_box import errors_over_box
    from beamdesign.proofs.servo_off import servo_off_over_box
    from beamdesign.proofs.slope_over_box import box_rows, slope_over_box
    from beamdesign.proofs.tolerance_box import largest_scaling, scaling_of_each, tolerance_box

    def proved(stage: "InStage") -> tuple[dict[str, Any], bool]:
        path = certificate_file(beside(out, stage), f"{prototype.stem}{stage.suffix}.box.toml")
        asked = None if outer_end_mass is None else stage.outer_end_mass_kg
        delays = (0.0, delay_s) if delay_s else None
        rig, box = stage.prototype, tolerance_box(stage.prototype, sigmas, only or None, asked, delay_s=delays)
        with progress("branch and bound") as update:
            update(0.1, f"{len(box.names)} figures")
            verdict = prove(rig, box, budget, seconds)
            update(0.3, "performance" if verdict.stable else "")
            claims = best_over_box(rig, box, budget, seconds) if verdict.stable else ()
            rows: tuple[Row, ...] = ()
            if nonlinear and verdict.stable:
                update(0.5, "with a saturated current")
                lower = next((claim for claim in claims if claim.asked.kind == "gain_margin"), None)
                slope, why = slope_over_box(rig, box, budget, seconds, lower)
                update(0.55, "with errors that are bounded")
                errors, moved = errors_over_box(rig, box, budget, seconds)
                moved += changing_over_box(members(rig, *stage.outer_end_mass_kg), box, claims)
                rows, claims = box_rows(rig, slope, why, moved), (*claims, *([] if slope is None else [slope]), *errors)
            update(0.6, "scaling the tolerances" if scaling else "")
            found = largest_scaling(rig, box, budget=budget) if scaling else None
            alone = scaling_of_each(rig, box, budget=budget) if each and verdict.stable else {}
        echo_box(rig, box, verdict, sigmas)
        if found is not None:
            echo(f"scaling of the tolerances ({sigmas:g} standard deviations are 1): {found.reason}")
        if alone:
            echo_each(alone, sigmas)
        for claim in claims:
            if claim.asked.kind in ("peak_compliance", "deviation"):  # told beside others, in words of their own
                continue
            echo(f"  guaranteed for every member: {describe(claim.asked)}")
        missing = [name.replace("_", " ") for name, value in guaranteed_fields(claims).items() if not value]
        if verdict.stable and missing:
            echo(f"  not proved of every member: {', '.join(missing)}")
        if any(c.asked.kind == "peak_sensitivity" and c.asked.limit > rig.goal.peak_sensitivity for c in claims):
            echo(f"  the peak sensitivity is beyond the goal of {rig.goal.peak_sensitivity:g}")
        figures = guaranteed_fields(claims)
        if softest := figures["peak_compliance_m_per_N"]:
            off, _ = servo_off_over_box(rig, box)
            figures |= {"servo_off_m_per_N": off, "peak_over_passive": (ratio := over_passive(softest, off))}
            echo_over_passive(softest, off, ratio, rig.goal, " for every member")
        _echo_moving(rows)
        text = verdict.write(claims)
        if text:
            write_certificate(path, text)
            echo(f"certificate: {path}")
        fields = box_fields(box, verdict, found, alone) | {"certificate": path if text else None}
        fields["guaranteed"] = figures | {"outer_end_mass_kg": stage.outer_end_mass_kg}
        fields |= {"nonlinear": [row.to_dict() for row in rows]} if nonlinear else {}
        return fields, verdict.stable is True and all(row.proved for row in rows)

    return by_stage(record, masses, proved)


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
    from beamdesign.proofs.mass_family import stage_families

    record = with_controller(prototype)
    try:
        families = stage_families(record)
    except ValueError as error:
        refuse(prototype, ("controller.stage", str(error)))
    low, high = mass_range(outer_end_mass, record.outer_end_mass_kg, prototype)
    if not low < high:
        reason = f"{low:g}:{high:g} holds one mass, which cannot change"
        refuse("certify-switching", ("--outer-end-mass", reason))
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
