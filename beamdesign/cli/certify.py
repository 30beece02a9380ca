"""`beamdesign certify`, `certify-box` and `certify-switching`: proofs over payloads, tolerances and changes."""

from collections.abc import Callable
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

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
    toml_files,
    with_controller,
)
from beamdesign.cli.output import certificate_file, echo, echo_table, progress, refuse, write_certificate
from beamdesign.json_text import picked

if TYPE_CHECKING:
    from beamdesign.polynomial import Crossing
    from beamdesign.proofs.arm.result import PlaneGuaranteed
    from beamdesign.proofs.box import Box, BoxVerdict
    from beamdesign.proofs.certificate import Asked, Certificate, Decided, Guaranteed
    from beamdesign.proofs.tolerance_box import Scaling
    from beamdesign.prototype import Goal, InStage, Prototype
    from beamdesign.synthesis.rig_spread import Shape


@command
def certify(
    prototype: Annotated[Path | None, typer.Argument(autocompletion=toml_files)] = None,
    outer_end_mass: MassRange = None,
    bandwidth_Hz: Annotated[float | None, Figure("Frequency")] = None,
    peak_sensitivity: Annotated[float | None, Figure("LoopGain")] = None,
    loop_gain: Annotated[float | None, Figure("LoopGain")] = None,
    controller_effort_A_per_V: Annotated[float | None, Figure("LawGain")] = None,
    decay_rate_per_s: Annotated[float | None, Figure("DecayRate")] = None,
    gain_margin: Annotated[float | None, Figure("GainFactor")] = None,
    robust: Annotated[float, Figure("Sigmas", metavar="SIGMAS")] = 0.0,
    robust_box: bool = False,
    nonlinear: bool = False,
    out: OutFile = None,
    replay: Annotated[Path | None, typer.Option(metavar="CERTIFICATE")] = None,
) -> CommandResult:
    """Prove stability and performance over a payload range.

    For every outer end mass of the range; the proof is written down. All decisions are exact, none is sampled.
    Of a prototype with effects, all linear members that stand for them are proved, of a scheduled controller each law
    over its own payloads. With --robust, rigs whose figures
    are off are sought on samples, and each is decided exactly as the nominal one is.
    Exit status 0 if the loop is stable over the whole range and every claim that was made holds, 1 otherwise.

    Args:
        prototype: the prototype.toml to certify.
        outer_end_mass: range of mass on the outer tip, kg; else the prototype's.
        bandwidth_Hz: claim the goal's compliance up to this frequency.
        peak_sensitivity: claim that max |1/(1+L)| is at most this.
        loop_gain: claim that |L| is at most this from the goal's loop_gain_from_Hz up.
        controller_effort_A_per_V: claim that |C/(1+L)| is at most this at every frequency.
        decay_rate_per_s: claim that every pole decays faster than this.
        gain_margin: claim stability with the gain times all from 1 to this.
        robust: also prove it of the worst rigs so many standard deviations off, as `tune`.
        robust_box: so many of every figure at once; else of all together.
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
            "--robust": robust or None,
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
    shape: Shape = "box" if robust_box else "ball"
    stem = prototype.stem

    from beamdesign.proofs.certifying import certify as prove

    def proved(stage: "InStage") -> tuple[dict[str, Any], bool]:
        path = certificate_file(beside(out, stage), f"{stem}{stage.suffix}.certificate.toml")
        rig, asked = stage.prototype, _asked(stage.prototype, claims)
        certificate = prove(rig, *stage.outer_end_mass_kg, asked, nonlinear)
        write_certificate(path, certificate.text)
        _echo(rig, certificate)
        echo(f"certificate: {path}")
        fields = certificate.to_dict() | (_between(rig, certificate, path) if rig.effects else {})
        holds = certificate.holds
        if robust > 0:
            from beamdesign.cli.tune import certified_rigs

            every, words = certified_rigs(rig, stage.outer_end_mass_kg, asked, robust, shape, path)
            holds, fields = holds and every, fields | words
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

    echo_stability(record.name, certificate)
    for side, crossing in certificate.next_crossings.items():
        if crossing is not None:
            echo(f"  the next crossing {side} the range is at {crossing.value:.7g} kg, {_hertz(crossing)} Hz")
    if certificate.guaranteed is not None:
        found, goal = certificate.guaranteed, record.goal
        echo(f"  guaranteed: |x/F_d| at most {goal.compliance_m_per_N:.4g} m/N up to {found.bandwidth_Hz:.6g} Hz")
        echo_against_goal(found, goal)
    for claim in certificate.claims:
        echo(f"  {'proved' if claim.holds else 'REFUTED'}: {describe(claim)}")
        if not claim.holds:
            echo(f"    {claim.reason}")
    for row in certificate.nonlinear:
        bound = "" if row.bound_m is None else f", the tip strays by at most {row.bound_m:.4g} m"
        echo(f"  {'proved' if row.proved else 'NOT PROVED'} while it moves: {', '.join(row.effects)}{bound}")
        echo(f"    {row.covers}")
    echo(f"method: {certificate.method}")
    for line in certificate.scope:
        echo(f"  {line}")
    if record.arm is not None and (any(record.arm.offset_m) or any(record.arm.sensor_m or ())):
        echo(
            "  payload and sensor on the beam's axis at the tip; with the offsets of [arm] and torsion: beamdesign arm"
        )


def echo_stability(name: str, found: "Decided") -> None:
    """Whether a loop is stable over a range of payloads, where else it is, and where that changes."""
    low, high = found.outer_end_mass_kg
    if found.stable:
        echo(f"{name}: stable for every outer end mass from {low:g} to {high:g} kg")
    else:
        echo(f"{name}: NOT stable from {low:g} to {high:g} kg: {found.stability.reason}")
        for least, most in found.stability.stable_ranges:
            echo(f"  stable from {least:.7g} to {most:.7g} kg")
    if found.crossings:
        rows = [(f"{crossing.value:.7g}", _hertz(crossing)) for crossing in found.crossings]
        echo_table("a root pair lies on the imaginary axis at", ("outer_end_mass_kg", "frequency_Hz"), rows)


def echo_against_goal(found: "Guaranteed | PlaneGuaranteed", goal: "Goal") -> None:
    """What is guaranteed beside the goal's limits, as far as it sets any."""
    for name, words, more in (
        ("peak_sensitivity", "peak sensitivity", ""),
        ("loop_gain", "loop gain |L|", f" from {goal.loop_gain_from_Hz:g} Hz up"),
        ("controller_effort_A_per_V", "controller effort |C/(1+L)|", " A/V"),
    ):
        value, limit = getattr(found, name), getattr(goal, name)
        if value is not None and limit is not None:
            met = "within" if value <= limit else "beyond"
            echo(f"  guaranteed: {words} at most {value:.6g}{more}, {met} the goal of {limit:g}")


def _hertz(crossing: "Crossing") -> str:
    return f"{crossing.frequency_Hz:.6g}" if crossing.finite else "infinite"


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
    """Prove stability and performance for all tolerances at once.

    Figures, end masses and a delay vary together; the proof is written down.

    Proved stable, or refuted by a member that is proved not to be stable, or undecided on a stated share of the box;
    of a stable box the best bandwidth and peak sensitivity are found that are proved of every member. A search finds
    the worst members, but nothing that is claimed is sampled. Exit status 0 if the whole box is proved stable, 1
    otherwise.

    Args:
        prototype: the prototype.toml to certify.
        outer_end_mass: range of mass on the outer tip, kg; else the prototype's.
        sigmas: standard deviations to either side of every figure.
        only: let this figure vary; may be repeated. Default: all.
        delay_s: allow every pure delay in the loop up to this, s.
        scaling: find the largest scaling of the tolerances that is stable.
        budget: most pieces of frequency and parameters to look at, for each claim.
        seconds: most time for each search.
        out: file for the certificate; else STEM.box.toml in this folder.
    """
    record = with_controller(prototype)
    masses = mass_range(outer_end_mass, record.outer_end_mass_kg or (0.0, 0.0), prototype)

    from beamdesign.proofs.box import certify_box as prove
    from beamdesign.proofs.box_claims import best_over_box, guaranteed_fields
    from beamdesign.proofs.certificate import describe
    from beamdesign.proofs.tolerance_box import largest_scaling, tolerance_box

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
            update(0.6, "scaling the tolerances" if scaling else "")
            found = largest_scaling(rig, box, budget=budget) if scaling else None
        _echo_box(rig, box, verdict)
        if found is not None:
            echo(f"scaling of the tolerances ({sigmas:g} standard deviations are 1): {found.reason}")
        for claim in claims:
            echo(f"  guaranteed for every member: {describe(claim.asked.decided(stage.outer_end_mass_kg, True))}")
        text = verdict.write(claims)
        if text:
            write_certificate(path, text)
            echo(f"certificate: {path}")
        fields = _box_fields(box, verdict, found) | {"certificate": path if text else None}
        fields["guaranteed"] = guaranteed_fields(claims) | {"outer_end_mass_kg": stage.outer_end_mass_kg}
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
