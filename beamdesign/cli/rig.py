"""`beamdesign spec`, `code` and `limits`: what follows from a prototype.

What is needed to build and to accept it, its controller as C code, and how far it and its model can be trusted.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import beamdesign
from beamdesign.cli.certify import echo_aside
from beamdesign.cli.command import CommandResult, Figure, by_stage, command, mass_range, with_controller, write_drawn
from beamdesign.cli.output import default_folder, echo, echo_table, progress, refuse

if TYPE_CHECKING:
    from beamdesign.build.realisation.code import ProvedCode
    from beamdesign.prototype import InStage
    from beamdesign.synthesis.operating_limits import Limits as OperatingLimits


def _wrong_words(word_length: int | None, in_floats: bool, **others: Any) -> Iterator[tuple[str, str]]:
    if word_length is not None and in_floats:
        yield "--word-length", "floats have their own; leave out this or --float"
    elif word_length is not None and not 8 <= word_length <= 32:
        yield "--word-length", f"must be from 8 to 32 bits, is {word_length}"


@partial(command, problems=_wrong_words)
def code(
    prototype: Path,
    rate_Hz: Annotated[float, Figure("SamplingRate")],
    out: Path | None = None,
    word_length: int | None = None,
    in_floats: Annotated[bool, typer.Option("--float")] = False,
    full_scale_V: Annotated[float, Figure("FullScale")] = 10.0,
    largest_current_A: Annotated[float | None, Figure("LargestCurrent")] = None,
    outer_end_mass: str | None = None,
    any_computing_time: bool = False,
    compile_here: Annotated[bool, typer.Option("--compile")] = False,
) -> CommandResult:
    """Write the controller as C99 as it is proved, an argument per reading.

    Sections in incremental form, coefficients and words of the length asked for, limits with anti-windup, a self-test
    to the last bit. The loop is proved with the rounded coefficients, its current held, at once and one period late;
    what rate and rounding cost in margin is told. Exit status 1, and no code, if that loop is not proved stable over
    the range; a higher rate or a longer word may be. Of a prototype with effects the sampled loop is not worked out:
    the code is written, and says that its loop is not proved.

    Args:
        prototype: the prototype.toml, with a controller.
        rate_Hz: sampling rate.
        out: folder for the C files; else NAME.code here.
        word_length: bits of a fixed-point word with its sign, 8 to 32; else 32.
        in_floats: in floats of 32 bits instead.
        full_scale_V: largest error (V); words are scaled so that it overflows nothing.
        largest_current_A: limit; else the valve's rated current, or the gain times the full scale.
        any_computing_time: prove it for every computing time up to one period as well, the same at every sample, which
            takes a minute.
        compile_here: compile it with the system's C compiler and run its self-test.
    """
    record = with_controller(prototype)
    masses = mass_range(outer_end_mass, record.outer_end_mass_kg or (0.0, 0.0), prototype)

    from beamdesign.build.realisation.c_code import compiler

    if compile_here and compiler() is None:
        refuse("--compile", ("(compiler)", "neither cc, gcc nor clang is on the path; set CC or leave it"))
    bits = None if in_floats else word_length or 32
    with progress("realising") as update:
        found = beamdesign.code(
            record, rate_Hz, masses, bits, full_scale_V, largest_current_A, any_computing_time, progress=update
        )
    folder = out or default_folder(f"{prototype.resolve().stem}.code")
    if found.reason:
        echo(f"{record.name}: {found.reason}")
        return CommandResult(found.to_dict() | {"files": []}, yes=False)
    paths = found.write(folder)
    _echo_code(found)
    if record.outer_end_mass_kg is None and outer_end_mass is None:
        echo("the prototype states no payload: proved without any; --outer-end-mass LO:HI asks for a range")
    return CommandResult(found.to_dict() | {"files": paths}, not compile_here or _compiles(folder), paths)


def _compiles(folder: Path) -> bool:
    """Compile into a folder of its own, so that nothing but sources is left in the one asked for."""
    import subprocess
    from tempfile import TemporaryDirectory

    from beamdesign.build.realisation.c_code import PROGRAM, compiled

    with TemporaryDirectory() as scratch:
        program = compiled(folder, Path(scratch) / "controller_self_test", PROGRAM)
        passed = subprocess.run([str(program)], check=False).returncode == 0
    echo("compiled; the self-test passes to the last bit" if passed else "compiled, but THE SELF-TEST FAILS here")
    return passed


def _echo_code(code: "ProvedCode") -> None:
    from decimal import ROUND_CEILING

    from beamdesign.proofs.scope import holds_for
    from beamdesign.quantities import decimal, mass_range_text

    made, masses = code.realisation, code.outer_end_mass_kg
    words = "floats of 32 bits" if made.word_length is None else f"words of {made.word_length} bits"
    echo_table(f"{code.prototype.name} at {made.rate_Hz:g} Hz in {words}: the law alone", ("", "computed"), code.rows())
    if code.not_judged:
        echo(f"stability as realised: not looked at, {code.not_judged}")
        return
    when = "at once or one period late" if code.any_time is None else "after any computing time up to one period"
    alike = f"the current held, put out {when}, at every sample alike"
    echo(f"proved: stable for {mass_range_text(masses)}, {alike}, {holds_for(code.prototype)}")
    echo_aside(code.prototype)
    title = f"Worst of {len(code.masses)} masses, computed"
    echo_table(title, ("", "continuous", "as realised, at once", "one period late"), code.loop_rows())
    effects = [at.rounding for at in code.masses if at.rounding is not None]
    if effects:
        most_um, expected_um, most_mA = (
            decimal(scale * max(getattr(one, name) for one in effects), 3, ROUND_CEILING)
            for name, scale in (("displacement_m", 1e6), ("expected_displacement_m", 1e6), ("current_A", 1e3))
        )
        echo(
            f"at these masses, one period late, rounding moves the tip by at most {most_um} um at the samples"
            f" (expected {expected_um} um RMS) and the current by {most_mA} mA, limit cycles included"
        )
        if (most := max(one.error_V for one in effects)) > 0.1 * made.full_scale_V:
            echo(f"  that is up to {most:.3g} V of error in {made.full_scale_V:g} V of full scale: take longer words")


@command
def spec(
    prototype: Path,
    out: Path | None = None,
    outer_end_mass: str | None = None,
    sampling_rate_Hz: Annotated[float | None, Figure("SamplingRate")] = None,
    load_N: Annotated[float | None, Figure("Force")] = None,
    noise_share: Annotated[float, Figure("Share")] = 0.1,
) -> CommandResult:
    """Specify what to build and how to accept it.

    Sections, drawing (DXF and SVG), ratings, sensor, the controller as a circuit and as code, each proved again as it
    is realised; tolerances that keep the proof; an acceptance test with limits, and the data set folder to fill in for
    `beamdesign gap diagnose`. Of a scheduled controller circuit, code and acceptance test of each law over its own
    payloads, and the rule by which they change. Exit status 1 if the loop is not stable over the range, or a law of a
    schedule as it samples, with the reason.

    Args:
        prototype: the prototype.toml, with a controller.
        out: folder for the specification; else NAME.specification here.
        sampling_rate_Hz: of the difference equation; else at least 40 times the crossover.
        load_N: load for the ratings, beside the weight of payload and link; else the prototype's largest force or
            payload's weight.
        noise_share: share of the motion that the goal allows, which sensor noise may cause.
    """
    record = with_controller(prototype)
    masses = mass_range(outer_end_mass, record.outer_end_mass_kg or (0.0, 0.0), prototype)

    from beamdesign.build.folder import write_specification

    folder = out or default_folder(f"{prototype.resolve().stem}.specification")
    with progress("specifying", "5 to 60 s, minutes for several laws or with effects") as update:
        found = beamdesign.specify(record, masses, sampling_rate_Hz, load_N, noise_share, progress=update)
        update(1.0, "writing")
        paths = write_specification(found, folder)
    fields = found.to_dict() | {"files": paths}
    if found.reason:
        echo(f"{record.name}: {found.reason}")
        return CommandResult(fields, yes=False)
    echo_table(f"{record.name}: specification", ("figure", "value", "basis"), found.rows())
    if record.outer_end_mass_kg is None and outer_end_mass is None:
        echo("the prototype states no payload: specified without any; --outer-end-mass LO:HI asks for a range")
    return CommandResult(fields, files=paths.values())


@command
def limits(
    prototype: Path,
    payload: Annotated[float | None, Figure("MassOrNone", metavar="KG")] = None,
    preload: Annotated[float, Figure("SignedForce", metavar="N")] = 0.0,
    out: Path | None = None,
) -> CommandResult:
    """State the limits of a rig and of its linear model.

    What the actuator can carry over frequency and which limit governs; what the sensor hides; up to what frequency and
    gain one bending mode per beam is enough; up to what load, force and air in the oil the linear amplitude holds; at
    what gains the nonlinear loop oscillates by itself, over amplitude. Exit status 1 where the loop is not stable.

    Args:
        prototype: the prototype.toml, with a controller.
        payload: mass on the outer tip; the prototype's largest payload by default.
        preload: constant force on the outer tip.
        out: folder for the envelope as a figure.
    """
    rig = with_controller(prototype)
    mass = payload if payload is not None else (rig.outer_end_mass_kg or (0.0, 0.0))[1]

    def stated(stage: "InStage") -> tuple[dict[str, Any], bool]:
        own = stage.prototype
        with progress("limits") as update:
            found = beamdesign.limits(own, mass, preload, update)
        if found.reason:
            echo(f"{own.name}: {found.reason}; a loop that is not stable has no operating limits")
            return found.to_dict(), False
        _echo_limits(found)
        if out is None or found.envelope.reason:
            return found.to_dict() | {"figures": []}, True

        from beamdesign.report.canvas import new_figure
        from beamdesign.report.charts import plot_envelope

        figure = new_figure(170.0, 105.0)
        axes = plot_envelope(figure.add_subplot(), found.envelope, own.payload.largest_force_N)
        if preload:
            axes.set_title(f"on top of {preload:g} N", fontsize=9)
        return found.to_dict() | {"figures": write_drawn(out / stage.suffix[1:], "envelope", figure)}, True

    return by_stage(rig, (mass, mass), stated)


def _echo_limits(found: "OperatingLimits") -> None:
    from beamdesign.plant.linear_reach import with_published_effects
    from beamdesign.quantities import read_in
    from beamdesign.structure.arm import left_aside

    rig, mass = found.prototype, found.outer_end_mass_kg
    title = f"{rig.name} with {mass:g} kg outside: {found.envelope.reason or 'largest amplitude of a force on the tip'}"
    if found.envelope.reason:
        echo(title)
    else:
        heads = ("frequency, Hz", "force, N", "governed by", "tip moves, um", "mean power, W")
        echo_table(title, heads, found.rows())
    for limit, key in found.envelope.missing.items():
        echo(f"{limit}: not looked at, {key} not given")
    if found.left_aside:
        echo(f"forces above and modes below are worked out without {', '.join(found.left_aside)}")
    if words := left_aside(rig):
        echo(f"of a loop with {words}")
    _echo_sensor(found.sensor)
    if isinstance(found.modes, str):
        echo(f"higher modes: not looked at, {found.modes}")
    else:
        echo_table("One bending mode per beam", ("", ""), found.mode_rows())
    if isinstance(found.linear_amplitude, str):
        echo(f"reach of the linear model, limit cycles: not looked at, {found.linear_amplitude}")
        return
    effects = ", ".join(sorted(with_published_effects(rig).effects)) or "no effects"
    title = f"Linear amplitude within 10 % up to ({effects})"
    echo_table(title, ("varied", "at, Hz", "limit", "off there, %"), found.linear_rows())
    if not found.limit_cycles:
        echo("limit cycles: none found by harmonic balance")
        return
    own = rig.own_controller.gain_A_per_V
    unit, factor = read_in(own, "A/V")
    title = f"Limit cycles by harmonic balance; the prototype's gain is {factor * own:.4g} {unit}"
    echo_table(title, ("amplitude, um", f"gain, {unit}", "frequency, Hz", "settles there"), found.cycle_rows())


def _echo_sensor(reach: Any) -> None:
    echo(f"sensor: static error {1e8 * reach.static_error_m_per_N:.3g} um under 100 N")
    if reach.resolution_m is not None:
        echo(f"  resolution {1e6 * reach.resolution_m:.3g} um: hides constant forces up to {reach.hidden_N:.4g} N")
    if reach.noise_m is not None:
        share = "" if reach.rated_share is None else f", {100 * reach.rated_share:.3g} % of the largest"
        noise = f"{1e6 * reach.noise_m:.3g} um RMS, followed where slow"
        echo(f"  noise {noise}; {1e3 * reach.current_noise_A:.3g} mA{share}")
    stated = {"resolution_m": reach.resolution_m, "noise_V": reach.noise_m}
    if missing := [key for key, value in stated.items() if value is None]:
        echo(f"  not looked at: {', '.join(f'sensor.{key}' for key in missing)} not given")
