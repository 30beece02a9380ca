"""`beamdesign certify`: stability and performance proved over a range of end masses, and proved again from text."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from beamdesign.cli.by_stage import beside, by_stage
from beamdesign.cli.certificate_file import certificate_file, write_certificate
from beamdesign.cli.completion import toml_files
from beamdesign.cli.figures import mass_range, refuse_implausible
from beamdesign.cli.output import JsonOption, RangeOption, file_to_write, say, say_table, write_json

if TYPE_CHECKING:
    from beamdesign.crossing import Crossing
    from beamdesign.design.rig_spread import Shape
    from beamdesign.proof.certificate import Asked, Certificate, Guaranteed
    from beamdesign.prototype import Goal, InStage, Prototype


def certify(
    prototype: Annotated[
        Path | None, typer.Argument(autocompletion=toml_files, help="The prototype.toml to certify.")
    ] = None,
    outer_end_mass: RangeOption = None,
    bandwidth_Hz: Annotated[
        float | None, typer.Option("--bandwidth-Hz", help="Claim the goal's compliance up to this frequency.")
    ] = None,
    peak_sensitivity: Annotated[
        float | None, typer.Option("--peak-sensitivity", help="Claim that max |1/(1+L)| is at most this.")
    ] = None,
    loop_gain: Annotated[
        float | None,
        typer.Option("--loop-gain", help="Claim that |L| is at most this from the goal's loop_gain_from_Hz up."),
    ] = None,
    controller_effort_A_per_V: Annotated[
        float | None,
        typer.Option("--controller-effort-A-per-V", help="Claim that |C/(1+L)| is at most this at every frequency."),
    ] = None,
    decay_rate_per_s: Annotated[
        float | None, typer.Option("--decay-rate-per-s", help="Claim that every pole decays faster than this.")
    ] = None,
    gain_margin: Annotated[
        float | None, typer.Option("--gain-margin", help="Claim stability with the gain times all from 1 to this.")
    ] = None,
    robust: Annotated[
        float,
        typer.Option(
            metavar="SIGMAS",
            help="Also prove it of the worst rigs so many standard deviations off, as `tune`.",
        ),
    ] = 0.0,
    robust_box: Annotated[
        bool, typer.Option("--robust-box", help="So many of every figure at once; else of all together.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            callback=file_to_write,
            help="File for the certificate; else STEM.certificate.toml in this folder.",
        ),
    ] = None,
    replay: Annotated[
        Path | None,
        typer.Option(metavar="CERTIFICATE", help="Prove this certificate again; with PROTOTYPE, also that it is its."),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Prove stability and performance over a payload range.

    For every outer end mass of the range; the proof is written down. All decisions are exact, none is sampled.
    Of a prototype with effects, all linear members that stand for them are proved, of a scheduled controller each law
    over its own payloads. With --robust, rigs whose figures
    are off are sought on samples, and each is decided exactly as the nominal one is.
    Exit status 0 if the loop is stable over the whole range and every claim that was made holds, 1 otherwise.
    """
    from beamdesign import quantities as q
    from beamdesign.prototype import read_prototype
    from beamdesign.records import InputError

    figures = {
        "--bandwidth-Hz": (bandwidth_Hz, q.Frequency),
        "--peak-sensitivity": (peak_sensitivity, q.LoopGain),
        "--loop-gain": (loop_gain, q.LoopGain),
        "--controller-effort-A-per-V": (controller_effort_A_per_V, q.LawGain),
        "--decay-rate-per-s": (decay_rate_per_s, q.DecayRate),
        "--gain-margin": (gain_margin, q.GainFactor),
        "--robust": (robust or None, q.Sigmas),
    }
    if replay is not None:
        given: dict[str, Any] = {name: value for name, (value, _) in figures.items()}
        given |= {"--outer-end-mass": outer_end_mass, "--out": out}
        if meaningless := [
            (name, "has no meaning with --replay") for name, value in given.items() if value is not None
        ]:
            raise InputError("certify", meaningless)
        _replay(replay, None if prototype is None else read_prototype(prototype), json)
        return
    refuse_implausible("certify", figures)
    if prototype is None:
        raise InputError("certify", [("PROTOTYPE", "missing; or give --replay CERTIFICATE")])
    record = read_prototype(prototype)
    if record.controller is None:
        raise InputError(prototype, [("controller", "missing; write it there, or let `beamdesign tune` find one")])
    masses = mass_range(outer_end_mass, record.outer_end_mass_kg, prototype)
    shape: Shape = "box" if robust_box else "ball"
    claims, stem = {name: value for name, (value, _) in figures.items()}, prototype.stem

    def proved(stage: "InStage") -> tuple[dict[str, Any], bool]:
        path = certificate_file(beside(out, stage), f"{stem}{stage.suffix}.certificate.toml")
        return _proved(stage, _asked(stage.prototype, claims), (robust, shape), path)

    by_stage(record, masses, proved, json)


def _proved(
    stage: "InStage", asked: list["Asked"], sought: tuple[float, "Shape"], path: Path
) -> tuple[dict[str, Any], bool]:
    """Prove, say and write of one law; what is known of it, and whether all of it holds."""
    from beamdesign.proof.certifying import certify as prove

    record, (robust, shape) = stage.prototype, sought
    certificate = prove(record, *stage.outer_end_mass_kg, asked)
    write_certificate(path, certificate.text)
    _say(record, certificate)
    say(f"certificate: {path}")
    fields = _fields(certificate) | (_between(record, certificate, path) if record.effects else {})
    holds = certificate.holds
    if robust > 0:
        from beamdesign.cli.robustness import certified_rigs

        every, told = certified_rigs(record, stage.outer_end_mass_kg, asked, robust, shape, path)
        holds, fields = holds and every, fields | told
    return fields | {"certificate": path}, holds


def _between(record: "Prototype", certificate: "Certificate", path: Path) -> dict[str, Any]:
    """What is known between the members of a prototype with effects; its certificate goes beside the other."""
    from beamdesign.proof.between import between, in_words

    verdict = between(record, *certificate.outer_end_mass_kg) if certificate.stable else None
    if certificate.stable and (words := in_words(verdict)):
        say(f"  {words}")
    fields: dict[str, Any] = {"stable_between": None if verdict is None else verdict.stable}
    if verdict is not None and verdict.certificate:
        beside = path.with_suffix(".between.toml")
        write_certificate(beside, verdict.certificate)
        say(f"certificate of that: {beside}")
        fields["certificate_between"] = beside
    return fields


def _asked(record: "Prototype", figures: dict[str, float | None]) -> list["Asked"]:
    """The claims made on the command line."""
    from beamdesign.proof.certificate import Asked

    asked = []
    if (bandwidth := figures["--bandwidth-Hz"]) is not None:
        asked.append(Asked("compliance", record.goal.compliance_m_per_N, bandwidth))
    if (peak := figures["--peak-sensitivity"]) is not None:
        asked.append(Asked("peak_sensitivity", peak))
    if (gain := figures["--loop-gain"]) is not None:
        asked.append(Asked("loop_gain", gain, from_Hz=record.goal.loop_gain_from_Hz))
    if (effort := figures["--controller-effort-A-per-V"]) is not None:
        asked.append(Asked("controller_effort", effort))
    if (rate := figures["--decay-rate-per-s"]) is not None:
        asked.append(Asked("decay_rate", rate))
    if (factor := figures["--gain-margin"]) is not None:
        asked.append(Asked("gain_margin", factor))
    return asked


def _say(record: "Prototype", certificate: "Certificate") -> None:
    from beamdesign.proof.certificate import describe

    low, high = certificate.outer_end_mass_kg
    if certificate.stable:
        say(f"{record.name}: stable for every outer end mass from {low:g} to {high:g} kg")
    else:
        say(f"{record.name}: NOT stable from {low:g} to {high:g} kg: {certificate.stability.reason}")
        for least, most in certificate.stable_ranges_kg:
            say(f"  stable from {least:.7g} to {most:.7g} kg")
    if certificate.crossings:
        rows = [(f"{crossing.value:.7g}", _hertz(crossing)) for crossing in certificate.crossings]
        say_table("a root pair lies on the imaginary axis at", ("outer_end_mass_kg", "frequency_Hz"), rows)
    for side, crossing in _neighbours(certificate).items():
        if crossing is not None:
            say(f"  the next crossing {side} the range is at {crossing.value:.7g} kg, {_hertz(crossing)} Hz")
    if certificate.guaranteed is not None:
        found, goal = certificate.guaranteed, record.goal
        say(f"  guaranteed: |x/F_d| at most {goal.compliance_m_per_N:.4g} m/N up to {found.bandwidth_Hz:.6g} Hz")
        met = "within" if found.peak_sensitivity <= goal.peak_sensitivity else "beyond"
        say(
            f"  guaranteed: peak sensitivity at most {found.peak_sensitivity:.6g}, {met} the goal of"
            f" {goal.peak_sensitivity:g}"
        )
        for words in _beyond_peak(found, goal):
            say(f"  guaranteed: {words}")
    for claim in certificate.claims:
        say(f"  {'proved' if claim.holds else 'REFUTED'}: {describe(claim)}")
        if not claim.holds:
            say(f"    {claim.reason}")
    say(f"method: {certificate.method}")
    for line in certificate.scope:
        say(f"  {line}")
    if record.arm is not None and (any(record.arm.offset_m) or any(record.arm.sensor_m or ())):
        say("  payload and sensor on the beam's axis at the tip; with the offsets of [arm] and torsion: beamdesign arm")


def _beyond_peak(found: "Guaranteed", goal: "Goal") -> list[str]:
    """Loop gain and effort beside the goal's limits, as far as it sets any."""
    lines = []
    if found.loop_gain is not None and goal.loop_gain is not None:
        met = "within" if found.loop_gain <= goal.loop_gain else "beyond"
        lines.append(
            f"loop gain |L| at most {found.loop_gain:.6g} from {goal.loop_gain_from_Hz:g} Hz up, {met} the goal of"
            f" {goal.loop_gain:g}"
        )
    if found.controller_effort_A_per_V is not None and goal.controller_effort_A_per_V is not None:
        met = "within" if found.controller_effort_A_per_V <= goal.controller_effort_A_per_V else "beyond"
        lines.append(
            f"controller effort |C/(1+L)| at most {found.controller_effort_A_per_V:.6g} A/V, {met} the goal of"
            f" {goal.controller_effort_A_per_V:g} A/V"
        )
    return lines


def _hertz(crossing: "Crossing") -> str:
    return f"{crossing.frequency_Hz:.6g}" if crossing.finite else "infinite"


def _neighbours(certificate: "Certificate") -> dict[str, "Crossing | None"]:
    """The next crossings outside the range, as far as masses go."""
    below, above = certificate.stability.below, certificate.stability.above
    return {"below": below if below is not None and below.value >= 0 else None, "above": above}


def _fields(certificate: "Certificate") -> dict[str, Any]:
    return {
        "stable": certificate.stable,
        "stable_ranges_kg": certificate.stable_ranges_kg,
        "crossings": [_crossing(crossing) for crossing in certificate.crossings],
        "method": certificate.method,
        "scope": certificate.scope,
        "outer_end_mass_kg": certificate.outer_end_mass_kg,
        "holds": certificate.holds,
        "reason": certificate.reason,
        "next_crossings": {side: _crossing(crossing) for side, crossing in _neighbours(certificate).items()},
        "guaranteed": certificate.guaranteed,
        "claims": [
            {
                "kind": claim.kind,
                "limit": claim.limit,
                "bandwidth_Hz": claim.bandwidth_Hz,
                "from_Hz": claim.from_Hz,
                "holds": claim.holds,
                "reason": claim.reason,
                "witness": None
                if claim.witness is None
                else {
                    "outer_end_mass_kg": claim.witness_outer_end_mass_kg,
                    "frequency_Hz": claim.witness_frequency_Hz,
                    "gain_factor": claim.witness_gain_factor,
                },
            }
            for claim in certificate.claims
        ],
    }


def _crossing(crossing: "Crossing | None") -> dict[str, float] | None:
    if crossing is None:
        return None
    return {"outer_end_mass_kg": crossing.value, "frequency_Hz": crossing.frequency_Hz}


def _replay(path: Path, record: "Prototype | None", json: Path | None) -> None:
    """Prove a certificate again from what it states; exit status 1 where that fails."""
    from beamdesign.checker import Unreadable, check
    from beamdesign.proof.rig_tables import prototype_table
    from beamdesign.records import InputError

    try:
        verdict = check(path, None if record is None else lambda *of: prototype_table(record, *of))
    except Unreadable as error:
        raise InputError(path, [("(certificate)", str(error))]) from error
    for words in verdict.lines():
        say(words)
    say(f"{path}: {'valid' if verdict.valid else 'NOT valid'}")
    fields = {"valid": verdict.valid, "reasons": verdict.failed, "checked": verdict.proved}
    write_json(json, fields | {"not_checked": verdict.open, "about": verdict.about})
    if not verdict.valid:
        raise typer.Exit(1)
