"""`beamdesign limits`: how far a prototype, and the linear model of it, can be trusted."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from beamdesign.cli.command import (
    CommandResult,
    Figure,
    RigArgument,
    by_stage,
    command,
    out_folder,
    ready_to_run,
    write_drawn,
)
from beamdesign.cli.output import echo, echo_table, progress

if TYPE_CHECKING:
    from beamdesign.prototype import InStage, Prototype
    from beamdesign.synthesis.limits import Limits


@command
def limits(
    prototype: RigArgument,
    payload: Annotated[
        float | None,
        Figure("Mass on the outer tip; the prototype's largest payload by default.", "MassOrNone", metavar="KG"),
    ] = None,
    preload: Annotated[float, Figure("Constant force on the outer tip.", "SignedForce", metavar="N")] = 0.0,
    out: Annotated[Path | None, out_folder("Folder for the envelope as a figure.")] = None,
) -> CommandResult:
    """State the limits of a rig and of its linear model.

    What the actuator can carry over frequency and which limit governs; what the sensor hides; up to what frequency and
    gain one bending mode per beam is enough; up to what load, force and air in the oil the linear amplitude holds; at
    what gains the nonlinear loop oscillates by itself, over amplitude. Exit status 1 where the loop is not stable.
    """
    rig = ready_to_run(prototype)
    mass = payload if payload is not None else (rig.outer_end_mass_kg or (0.0, 0.0))[1]

    def stated(stage: "InStage") -> tuple[dict[str, Any], bool]:
        return _stated(stage.prototype, mass, preload, out and out / stage.suffix[1:])

    return by_stage(rig, (mass, mass), stated)


def _stated(rig: "Prototype", mass: float, preload: float, out: Path | None) -> tuple[dict[str, Any], bool]:
    """Work out, say and draw of one law; what is known of it, and whether its loop is stable."""
    from beamdesign.synthesis.limits import limits as worked_out

    with progress("limits") as update:
        found = worked_out(rig, mass, preload, update)
    if found.reason:
        echo(f"{rig.name}: {found.reason}; a loop that is not stable has no operating limits")
        return found.to_dict(), False
    _echo(found)
    figures = [] if out is None else _draw(found.envelope, rig.payload.largest_force_N, preload, out)
    return found.to_dict() | {"figures": figures}, True


def _echo(found: "Limits") -> None:
    from beamdesign.plant.linear_reach import with_published_effects

    rig, mass = found.prototype, found.outer_end_mass_kg
    echo_table(
        f"{rig.name} with {mass:g} kg outside: largest amplitude of a force on the tip",
        ("frequency, Hz", "force, N", "governed by", "tip moves, um", "supply power, W"),
        found.rows(),
    )
    for limit, key in found.envelope.missing.items():
        echo(f"{limit}: not looked at, {key} is not given")
    _echo_sensor(found.sensor)
    if isinstance(found.modes, str):
        echo(f"higher modes: not looked at, {found.modes}")
    else:
        echo_table("One bending mode per beam", ("", ""), found.mode_rows())
    effects = ", ".join(sorted(with_published_effects(rig).effects))
    echo_table(
        f"Linear amplitude within 10 % up to ({effects})",
        ("varied", "at, Hz", "limit", "off there, %"),
        found.linear_rows(),
    )
    assert rig.controller is not None
    echo_table(
        f"Limit cycles by harmonic balance; the prototype's gain is {1e3 * rig.controller.gain_A_per_V:.4g} mA/V",
        ("amplitude, um", "gain, mA/V", "frequency, Hz", "settles there"),
        found.cycle_rows(),
    )


def _echo_sensor(reach: Any) -> None:
    echo(f"sensor: static error {1e8 * reach.static_error_m_per_N:.3g} um under 100 N")
    if reach.resolution_m is not None:
        echo(f"  resolution {1e6 * reach.resolution_m:.3g} um: hides constant forces up to {reach.hidden_N:.4g} N")
    if reach.noise_m is not None:
        share = "" if reach.rated_share is None else f", {100 * reach.rated_share:.3g} % of the largest"
        noise = f"{1e6 * reach.noise_m:.3g} um RMS, followed where slow"
        echo(f"  noise {noise}; {1e3 * reach.current_noise_A:.3g} mA{share}")
    missing = [
        key for key, value in (("resolution_m", reach.resolution_m), ("noise_V", reach.noise_m)) if value is None
    ]
    if missing:
        echo(f"  not looked at: {', '.join(f'sensor.{key}' for key in missing)} not given")


def _draw(found: Any, asked: float | None, preload: float, out: Path) -> list[Path]:
    from beamdesign.report.canvas import new_figure
    from beamdesign.report.figures import plot_envelope

    figure = new_figure(170.0, 105.0)
    axes = plot_envelope(figure.add_subplot(), found, asked)
    if preload:
        axes.set_title(f"on top of {preload:g} N", fontsize=9)
    return write_drawn(out, "envelope", figure)
