"""`beamdesign certify`: stability and performance proved over a range of end masses, and proved again from text."""

import hashlib
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from beamdesign.cli.command import (
    CommandResult,
    Figure,
    MassRange,
    OutFile,
    beside,
    by_stage,
    command,
    mass_range,
    toml_files,
    with_controller,
)
from beamdesign.cli.output import default_file, echo, echo_table
from beamdesign.files import read_bytes, write_whole
from beamdesign.json_text import picked

if TYPE_CHECKING:
    from beamdesign.polynomial import Crossing
    from beamdesign.proofs.arm.result import PlaneGuaranteed
    from beamdesign.proofs.certificate import Asked, Certificate, Decided, Guaranteed
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
        out: file for the certificate; else STEM.certificate.toml in this folder.
        replay: prove this certificate again; with PROTOTYPE, also that it is its.
    """
    from beamdesign.prototype import read_prototype
    from beamdesign.records import InputError

    claims = {
        "--bandwidth-Hz": bandwidth_Hz,
        "--peak-sensitivity": peak_sensitivity,
        "--loop-gain": loop_gain,
        "--controller-effort-A-per-V": controller_effort_A_per_V,
        "--decay-rate-per-s": decay_rate_per_s,
        "--gain-margin": gain_margin,
    }
    if replay is not None:
        others = {"--robust": robust or None, "--outer-end-mass": outer_end_mass, "--out": out}
        given = [name for name, value in (*claims.items(), *others.items()) if value is not None]
        if given:
            raise InputError("certify", [(name, "has no meaning with --replay") for name in given])
        return _replay(replay, None if prototype is None else read_prototype(prototype))
    if prototype is None:
        raise InputError("certify", [("PROTOTYPE", "missing; or give --replay CERTIFICATE")])
    record = with_controller(prototype)
    masses = mass_range(outer_end_mass, record.outer_end_mass_kg, prototype)
    shape: Shape = "box" if robust_box else "ball"
    stem = prototype.stem

    from beamdesign.proofs.certifying import certify as prove

    def proved(stage: "InStage") -> tuple[dict[str, Any], bool]:
        path = certificate_file(beside(out, stage), f"{stem}{stage.suffix}.certificate.toml")
        rig, asked = stage.prototype, _asked(stage.prototype, claims)
        certificate = prove(rig, *stage.outer_end_mass_kg, asked)
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
        echo(f"{name}: NOT stable from {low:g} to {high:g} kg: {found.reason}")
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
    from beamdesign.records import InputError

    try:
        verdict = check(path, None if record is None else lambda *of: prototype_table(record, *of))
    except Unreadable as error:
        raise InputError(path, [("(certificate)", str(error))]) from error
    for words in verdict.lines():
        echo(words)
    echo(f"{path}: {'valid' if verdict.valid else 'NOT valid'}")
    return CommandResult(picked(verdict, "valid reasons=failed checked=proved not_checked=open about"), verdict.valid)


_TELLING = ("name", "rig", "controller", "effects", "arm")
"""Keys of a certificate that tell whose it is."""


def certificate_file(out: Path | None, default: str) -> Path:
    """Where a certificate is to go, asked before the work for it.

    Raises:
        InputError: where something stands there that is no certificate, or where no file can be written.
    """
    path = default_file(default) if out is None else out
    if path.exists():
        _stated(path, _standing(path))
    return path


def write_certificate(path: Path, text: str) -> None:
    """Write a certificate; one of another prototype that stands there gets a name with its digest, which is said.

    Raises:
        InputError: where something stands there that is no certificate.
    """
    if path.exists() and (standing := _standing(path)) != text.encode():
        older, new = _stated(path, standing), tomllib.loads(text)
        if any(older.get(key) != new.get(key) for key in _TELLING):
            aside = path.with_suffix(f".{hashlib.sha256(standing).hexdigest()[:8]}{path.suffix}")
            write_whole(aside, standing)
            echo(f"the certificate of {older.get('name', 'another prototype')} that stood there is now {aside}")
    write_whole(path, text)


def _standing(path: Path) -> bytes:
    from beamdesign.records import InputError

    try:
        return read_bytes(path, _LARGEST)
    except OSError as error:
        raise InputError(path, [("(file)", f"{error.strerror}; name another file with --out")]) from error


_LARGEST = 10**9  # bytes: whatever stands there is looked at


def _stated(path: Path, standing: bytes) -> dict[str, Any]:
    from beamdesign.records import InputError

    try:
        table = tomllib.loads(standing.decode())
    except (ValueError, RecursionError):
        table = {}
    if not str(table.get("kind", "")).startswith("beamdesign."):
        raise InputError(path, [("(file)", "exists and is no certificate; name another file with --out")])
    return table
