"""`beamdesign spec` and `code`: what is needed to build a prototype and to accept it, and its controller as C code."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from beamdesign.cli.command import CommandResult, Figure, command, mass_range, with_controller
from beamdesign.cli.output import default_folder, echo, echo_table, progress, refuse

if TYPE_CHECKING:
    from beamdesign.build.realisation.code import ProvedCode


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
    the range; a higher rate or a longer word may be.

    Args:
        prototype: the prototype.toml, with a controller.
        rate_Hz: sampling rate.
        out: folder for the C files; else NAME.code here.
        word_length: bits of a fixed-point word with its sign, 8 to 32; else 32.
        in_floats: in floats of 32 bits instead.
        full_scale_V: largest error (V); words are scaled so that it overflows nothing.
        largest_current_A: limit; else the valve's rated current, or the gain times the full scale.
        any_computing_time: prove it for every computing time up to one period as well, which takes a minute.
        compile_here: compile it with the system's C compiler and run its self-test.
    """
    from beamdesign.records import InputError

    record = with_controller(prototype)
    assert record.controller is not None
    masses = mass_range(outer_end_mass, record.payload.outer_end_mass_kg or (0.0, 0.0), prototype)

    from beamdesign.build.realisation.c_code import compiler
    from beamdesign.build.realisation.code import code as realised

    if compile_here and compiler() is None:
        refuse("--compile", ("(compiler)", "neither cc, gcc nor clang is on the path; set CC or leave it"))
    bits = None if in_floats else word_length or 32
    with progress("realising") as update:
        try:
            found = realised(
                record, rate_Hz, masses, bits, full_scale_V, largest_current_A, any_computing_time, progress=update
            )
        except InputError as error:
            refuse(prototype, *error.problems)
    folder = out or default_folder(f"{prototype.resolve().stem}.code")
    if found.reason:
        echo(f"{record.name}: {found.reason}")
        return CommandResult(found.to_dict() | {"files": []}, yes=False)
    paths = found.write(folder)
    _echo(found)
    if record.payload.outer_end_mass_kg is None and outer_end_mass is None:
        echo("the prototype states no payload: proved without any; --outer-end-mass LO:HI asks for a range")
    return CommandResult(found.to_dict() | {"files": paths}, not compile_here or _compiles(folder), paths)


def _compiles(folder: Path) -> bool:
    """Compile in a folder of its own, so that nothing but sources is left in the one asked for."""
    import subprocess
    from shutil import copy
    from tempfile import TemporaryDirectory

    from beamdesign.build.realisation.c_code import HEADER, LAW, SELF_TEST, compile_self_test

    with TemporaryDirectory() as scratch:
        for name in (HEADER, LAW, SELF_TEST):
            copy(folder / name, scratch)
        program = compile_self_test(Path(scratch))
        passed = subprocess.run([str(program)], check=False).returncode == 0
    echo("compiled; the self-test passes to the last bit" if passed else "compiled, but THE SELF-TEST FAILS here")
    return passed


def _echo(code: "ProvedCode") -> None:
    made, found, masses = code.realisation, code.judgement, code.outer_end_mass_kg
    words = "floats of 32 bits" if made.word_length is None else f"words of {made.word_length} bits"
    echo_table(f"{code.prototype.name} at {made.rate_Hz:g} Hz in {words}: the law alone", ("", "computed"), code.rows())
    if found.reason:
        echo(f"stability as realised: not looked at, {found.reason}")
        return
    when = "at once or one period late" if found.any_time is None else "after any computing time up to one period"
    echo(f"proved: stable for {masses[0]:g} to {masses[1]:g} kg, the current held, put out {when}")
    title = f"Worst of {len(found.masses)} masses, computed"
    echo_table(title, ("", "continuous", "as realised, at once", "one period late"), code.loop_rows())
    effects = [at.rounding for at in found.masses if at.rounding is not None]
    if effects:
        echo(
            f"rounding moves the tip by at most {1e6 * max(one.displacement_m for one in effects):.3g} um"
            f" (expected {1e6 * max(one.expected_displacement_m for one in effects):.3g} um RMS) and the current by"
            f" {1e3 * max(one.current_A for one in effects):.3g} mA, limit cycles included"
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
    payloads, and the rule by which they change. Exit status 1 if the loop is not stable over the range, with the
    reason.

    Args:
        prototype: the prototype.toml, with a controller.
        out: folder for the specification; else NAME.specification here.
        sampling_rate_Hz: of the difference equation; else at least 40 times the crossover.
        load_N: load for the ratings; else the prototype's largest force or payload's weight.
        noise_share: share of the motion that the goal allows, which sensor noise may cause.
    """
    record = with_controller(prototype)
    masses = mass_range(outer_end_mass, record.payload.outer_end_mass_kg or (0.0, 0.0), prototype)

    from beamdesign.build.folder import write_specification
    from beamdesign.build.specification import specify

    folder = out or default_folder(f"{prototype.resolve().stem}.specification")
    with progress("specifying", "5 to 60 s") as update:
        found = specify(record, masses, sampling_rate_Hz, load_N, noise_share, progress=update)
        update(1.0, "writing")
        paths = write_specification(found, folder)
    fields = found.to_dict() | {"files": paths}
    if found.reason:
        echo(f"{record.name}: {found.reason}")
        return CommandResult(fields, yes=False)
    echo_table(f"{record.name}: specification", ("figure", "value", "basis"), found.rows())
    if record.payload.outer_end_mass_kg is None and outer_end_mass is None:
        echo("the prototype states no payload: specified without any; --outer-end-mass LO:HI asks for a range")
    return CommandResult(fields, files=paths.values())
