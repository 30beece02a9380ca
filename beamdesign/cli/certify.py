"""`beamdesign certify` and `certify-box`: proofs over payloads and tolerances, and how they are printed."""

from collections.abc import Mapping, Sequence
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import beamdesign
from beamdesign.cli.command import CommandResult, Figure, OutFile, by_stage, command, mass_range, with_controller
from beamdesign.cli.output import certificate_file, echo, echo_table, progress, refuse, write_certificate
from beamdesign.result import picked
from beamdesign.time_limit import within

if TYPE_CHECKING:
    from flint import fmpq

    from beamdesign.polynomial import Crossing
    from beamdesign.proofs.absolute_stability import Row
    from beamdesign.proofs.arm.result import PlaneGuaranteed
    from beamdesign.proofs.certificate import Certificate, Decided, Guaranteed, Kind
    from beamdesign.proofs.over_box import BoxGuarantee
    from beamdesign.proofs.tolerance_box import Scaling
    from beamdesign.prototype import Goal, InStage, Prototype


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
    where it is refuted or undecided at a value between the ends of what members freeze, and where an effect lets small
    motion follow none of them: within the play of a joint nothing is proved, and within a dead band, friction or
    hysteresis no compliance. --linear asks of the members alone.

    Args:
        prototype: the prototype.toml to certify.
        bandwidth_Hz: claim the goal's compliance up to this frequency.
        peak_sensitivity: claim that max |1/(1+L)| is at most this.
        loop_gain: claim that |L| is at most this from the goal's loop_gain_from_Hz up.
        controller_effort_A_per_V: claim that |C/(1+L)| is at most this at every frequency.
        decay_rate_per_s: claim that every pole decays faster than this.
        gain_margin: claim stability with the gain times all from 1 to this.
        linear: let the answer be about linear members alone, where effects are in the way of more.
        nonlinear: also prove, of the nominal figures, what holds while effects move, and while the law's current
            saturates, which it does on every rig; the answer is no where something is not proved.
        out: file for the certificate; else STEM.certificate.toml in this folder.
        replay: prove this certificate again; with PROTOTYPE, also that it is its.
    """
    from beamdesign.proofs.certificate import Asked
    from beamdesign.prototype import Goal

    record = None if replay is not None or prototype is None else with_controller(prototype)
    goal = Goal() if record is None else record.goal

    def claim(kind: "Kind", limit: float | None, from_Hz: float = 0.0) -> Asked | None:
        return None if limit is None else Asked(kind, limit, from_Hz=from_Hz)

    claims = {
        "--bandwidth-Hz": Asked("compliance", goal.compliance_m_per_N, bandwidth_Hz) if bandwidth_Hz else None,
        "--peak-sensitivity": claim("peak_sensitivity", peak_sensitivity),
        "--loop-gain": claim("loop_gain", loop_gain, goal.loop_gain_from_Hz),
        "--controller-effort-A-per-V": claim("controller_effort", controller_effort_A_per_V),
        "--decay-rate-per-s": claim("decay_rate", decay_rate_per_s),
        "--gain-margin": claim("gain_margin", gain_margin),
    }
    asked = [one for one in claims.values() if one is not None]
    if replay is not None:
        others = {"--linear": linear, "--nonlinear": nonlinear, "--outer-end-mass": outer_end_mass, "--out": out}
        if given := [name for name, value in {**claims, **others}.items() if value]:
            refuse("certify", *((name, "has no meaning with --replay") for name in given))
        return _replay(replay, None if prototype is None else beamdesign.read_prototype(prototype))
    if record is None or prototype is None:
        refuse("certify", ("PROTOTYPE", "missing; or give --replay CERTIFICATE"))
    masses = mass_range(outer_end_mass, record.outer_end_mass_kg, prototype)

    from beamdesign.proofs.scope import holds_for, near_rest
    from beamdesign.structure.arm import left_aside

    def proved(stage: "InStage") -> tuple[dict[str, Any], bool]:
        rig, path = stage.prototype, certificate_file(out, prototype, "certificate", stage.suffix)
        certificate = beamdesign.certify(rig, stage.outer_end_mass_kg, None, asked, nonlinear, linear)
        _echo(rig, certificate)
        write_certificate(path, certificate.text)
        fields = certificate.to_dict()
        if (inside := certificate.between) is not None and inside.certificate:
            fields["certificate_between"] = path.with_suffix(".between.toml")
            write_certificate(fields["certificate_between"], inside.certificate)
        fields |= {"holds_for": holds_for(rig), "near_rest": near_rest(rig, certificate.nonlinear)}
        fields |= {"arm_left_aside": left_aside(rig), "certificate": path}
        if certificate.holds and not certificate.yes:
            echo(f"{rig.name}: {certificate.reason}; --linear asks of linear members alone")
        return fields, certificate.yes

    return by_stage(record, masses, proved)


def _echo(record: "Prototype", certificate: "Certificate") -> None:
    from beamdesign.proofs.certificate import describe
    from beamdesign.proofs.scope import holds_for
    from beamdesign.quantities import stated_bandwidth

    echo_stability(record.name, certificate, holds_for(record))
    for side, crossing in certificate.next_crossings.items():
        if crossing is not None:
            echo(f"  the next crossing {side} the range is at {crossing.value:.7g} kg, {_hertz(crossing)} Hz")
    if certificate.guaranteed is not None:
        found, goal = certificate.guaranteed, record.goal
        limit = goal.compliance_m_per_N
        if found.bandwidth_Hz > 0:
            echo(f"  guaranteed: |x/F_d| at most {limit:.15g} m/N up to {stated_bandwidth(found.bandwidth_Hz)}")
        else:
            echo(f"  no bandwidth: even a steady force moves the tip by more than {limit:.15g} m/N")
        echo_against_goal(found, goal)
        if isfinite(found.peak_over_passive):
            _echo_over_passive(found.peak_compliance_m_per_N, found.servo_off_m_per_N, found.peak_over_passive, goal)
    for claim in certificate.claims:
        echo(f"  {'proved' if claim.holds else 'REFUTED'}: {describe(claim)}")
        if not claim.holds:
            echo(f"    {claim.reason}")
    _echo_moving(certificate.nonlinear)
    echo(f"method: {certificate.method}")
    echo(*certificate.scope, before="  ")
    if certificate.between is not None:
        echo(f"  {certificate.between.of_frozen}")
    echo_aside(record)


def echo_aside(prototype: "Prototype") -> None:
    """Tell where [arm] has more than the loop that is worked on."""
    from beamdesign.structure.arm import left_aside

    if words := left_aside(prototype):
        echo(f"  {words}")


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
    echo(*verdict.lines(), f"{path}: {'valid' if verdict.valid else 'NOT valid'}")
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
    linear: bool = False,
    nonlinear: bool = False,
    out: OutFile = None,
) -> CommandResult:
    """Prove stability and performance for all tolerances at once.

    Figures, end masses and a delay vary together; the proof is written down.

    Proved stable, or refuted by a member that is proved not to be stable, or undecided on a stated share of the box;
    of a stable box the best bandwidth and peak sensitivity are found that are proved of every member. A search finds
    the worst members, but nothing that is claimed is sampled. Exit status 0 if the whole box is proved stable, and what
    --nonlinear asks of it, 1 otherwise; 1 also where an effect lets small motion follow no linear member, as the play
    of a joint does. --linear asks of the members alone.

    Args:
        prototype: the prototype.toml to certify.
        sigmas: standard deviations to either side of every figure.
        only: let this figure vary; may be repeated. Default: all.
        delay_s: allow every pure delay in the loop up to this, s.
        scaling: find the largest scaling of the tolerances that is stable.
        each: find it of each figure alone, the others staying as far off as they may be.
        budget: most pieces of frequency and parameters to look at, for each claim.
        seconds: most time for all that is searched together; what was found until then is proved all the same, what is
            left out is told, and a step that was begun is brought to its end.
        linear: let the answer be about linear members alone, where effects are in the way of more.
        nonlinear: also prove that every member comes to rest while the law's current saturates, and with the static
            characteristics among its effects, and how far friction, hysteresis, dead band, ripple and resolution move
            its tip; the answer is no where something is not proved.
        out: file for the certificate; else STEM.box.toml in this folder.
    """
    record = with_controller(prototype)
    masses = mass_range(outer_end_mass, record.outer_end_mass_kg or (0.0, 0.0), prototype)

    from beamdesign.structure.arm import left_aside

    def proved(stage: "InStage") -> tuple[dict[str, Any], bool]:
        path = certificate_file(out, prototype, "box", stage.suffix)
        asked = None if outer_end_mass is None else stage.outer_end_mass_kg
        with progress("branch and bound") as update:
            varying = asked, sigmas, only or (), delay_s, nonlinear, scaling, each
            found = beamdesign.certify_box(stage.prototype, *varying, budget, seconds, update)
        _echo_box(found)
        if (scaling or each) and not found.scales:
            words = "nothing scales, as payload and delay stay as asked and nothing else varies"
            echo(f"scaling of the tolerances: {words}")
        if found.text:
            write_certificate(path, found.text)
        if found.proved and found.small_motion and not linear:
            echo(f"{stage.prototype.name}: {found.small_motion}; --linear asks of linear members alone")
        more = {"arm_left_aside": left_aside(stage.prototype), "certificate": path if found.text else None}
        more |= {"reason": found.verdict.reason} if linear else {}
        return found.to_dict() | more, found.proved if linear else found.yes

    with within(seconds / 60):
        return by_stage(record, masses, proved)


def echo_stability(name: str, found: "Decided", holds_for: str) -> None:
    """Whether a loop is stable over a range of payloads, where else it is, and where that changes."""
    from beamdesign.quantities import mass_range_text, stated_range

    asked = mass_range_text(found.outer_end_mass_kg)
    if found.stable:
        echo(f"{name}: stable for every outer end mass from {asked}, {holds_for}")
    else:
        echo(f"{name}: NOT stable from {asked}: {found.stability.reason}")
        for ends in found.stability.closed_ranges:
            echo(f"  stable from {stated_range(ends)} kg")
    if found.crossings:
        rows = [(f"{crossing.value:.7g}", _hertz(crossing)) for crossing in found.crossings]
        echo_table("a root pair lies on the imaginary axis at", ("outer_end_mass_kg", "frequency_Hz"), rows)


def echo_against_goal(found: "Guaranteed | PlaneGuaranteed", goal: "Goal") -> None:
    """What is guaranteed beside the goal's limits, as far as it sets any."""
    from beamdesign.quantities import stated_peak

    for name, words, more in (
        ("peak_sensitivity", "peak sensitivity", ""),
        ("loop_gain", "loop gain |L|", f" from {goal.loop_gain_from_Hz:.15g} Hz up"),
        ("controller_effort_A_per_V", "controller effort |C/(1+L)|", " A/V"),
    ):
        value, limit = getattr(found, name), getattr(goal, name)
        if value is not None and limit is not None:
            met = "within" if value <= limit else "beyond"
            echo(f"  guaranteed: {words} at most {stated_peak(value)}{more}, {met} the goal of {limit:g}")


def _echo_over_passive(peak_m_per_N: float, servo_off_m_per_N: float, ratio: float, goal: "Goal", of: str = "") -> None:
    """The largest compliance at any frequency beside that with the servo off, and the goal."""
    from beamdesign.quantities import at_most

    met = "within" if ratio <= goal.peak_over_passive else "beyond"
    limit = f", {met} the goal of {goal.peak_over_passive:g}" if isfinite(goal.peak_over_passive) else ""
    passive = f"{at_most(ratio, '1')} times the {servo_off_m_per_N:.15g} m/N with the servo off{limit}"
    if servo_off_m_per_N == inf:
        passive = "which nothing bounds with the servo off"
    echo(f"  guaranteed{of}: |x/F_d| at most {peak_m_per_N:.15g} m/N at every frequency, {passive}")


def _hertz(crossing: "Crossing") -> str:
    """The frequency of a crossing, Hz."""
    return f"{crossing.frequency_Hz:.6g}" if crossing.finite else "infinite"


def _echo_box(found: "BoxGuarantee") -> None:
    """Whether a loop is stable over a box, and where it is not; what the box is, and what is proved beside it."""
    from decimal import ROUND_CEILING, ROUND_FLOOR

    from beamdesign.polynomial import nearest
    from beamdesign.proofs.certificate import describe
    from beamdesign.proofs.over_box import of_members
    from beamdesign.proofs.scope import bracketing, holds_for
    from beamdesign.proofs.tolerance_box import figure_key
    from beamdesign.quantities import decimal

    def inwards(end: "fmpq", factor: float, up: bool = False) -> str:
        return f"{float(decimal(nearest(end) / factor, 7, ROUND_CEILING if up else ROUND_FLOOR)):.7g}"

    record, box, verdict, sure = found.prototype, found.box, found.verdict, found.guaranteed
    words = {True: "stable", False: "NOT stable", None: "undecided whether stable"}
    echo(f"{record.name}: {words[verdict.stable]} {holds_for(record, found.sigmas)}")
    point, last = verdict.unstable_point or {}, ("not stable at",) if verdict.unstable_point else ()
    rows = [
        [key, inwards(low, factor, True), inwards(high, factor), *(f"{nearest(one) / factor:.12g}" for one in at)]
        for name, (low, high) in box.ranges.items()
        for (key, factor), at in [(figure_key(name), [point[name]] if name in point else [])]
    ]
    echo_table(f"{len(box.names)} figures, all at once", ("figure", "from", "to", *last), rows)
    if verdict.stable is not True:
        echo(f"  {verdict.reason.rpartition(': ')[2] if verdict.stable is False else verdict.reason}")
        if verdict.volumes is not None:
            stable, unstable, undecided = map(nearest, verdict.volumes)
            most = decimal(undecided, 3, ROUND_CEILING)
            least = f"{decimal(stable, 6, ROUND_FLOOR)}, not stable {decimal(unstable, 3, ROUND_FLOOR)}"
            echo(f"  share of the box proved stable {least}, undecided {most}")
    if record.effects:
        frozen = "covered as linear loops at frozen values, not as the nonlinear loop"
        echo(f"  effects are {frozen if bracketing(record) else 'linear, and parts of every loop'}")
    echo(f"method: zero exclusion, {verdict.pieces} pieces proved in ball arithmetic, one member by an exact test")
    if found.scaling is not None:
        echo(f"scaling of the tolerances ({found.sigmas:g} standard deviations are 1): {found.scaling.reason}")
    if found.each:
        _echo_each(found.each, found.sigmas)
    for claim in found.claims:
        if claim.asked.kind not in ("peak_compliance", "deviation"):  # these beside others, in words of their own
            echo(f"  guaranteed for {of_members([claim])}: {describe(claim.asked)}")
    lacking = (name for name, value in sure.items() if value is None or value is False)
    missing = [name.partition("_Hz")[0].partition("_m_per")[0] for name in lacking]
    if verdict.stable and missing:
        echo(f"  not proved of every member: {', '.join(missing).replace('_', ' ')}")
    if (peak := sure["peak_sensitivity"]) and peak > record.goal.peak_sensitivity:
        echo(f"  the peak sensitivity is not proved within the goal of {record.goal.peak_sensitivity:g}")
    if softest := sure["peak_compliance_m_per_N"]:
        over = sure["servo_off_m_per_N"], sure["peak_over_passive"]
        of = of_members(claim for claim in found.claims if claim.asked.kind == "peak_compliance")
        _echo_over_passive(softest, *over, record.goal, f" for {of}")
    _echo_moving(found.nonlinear or ())
    echo_aside(record)
    if found.left_out:
        echo(f"  left out for want of time: {', '.join(found.left_out)}; more --seconds leave less out")


def _echo_each(found: "Mapping[str, Scaling]", sigmas: float) -> None:
    """How far each figure alone may be off."""
    from decimal import ROUND_CEILING, ROUND_FLOOR

    from beamdesign.proofs.tolerance_box import figure_key
    from beamdesign.quantities import decimal

    columns = "figure", "proved stable up to", "not stable from"
    rows = []
    for name, one in found.items():
        refuted = "none found" if one.refuted is None else decimal(one.refuted * sigmas, rounding=ROUND_CEILING)
        rows.append((figure_key(name)[0], decimal(one.proved * sigmas, rounding=ROUND_FLOOR), refuted))
    echo_table(f"standard deviations that one figure may be off, the others up to {sigmas:g} as before", columns, rows)
