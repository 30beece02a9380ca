"""`beamdesign limits`: how far a prototype, and the linear model of it, can be trusted."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from beamdesign.cli.command import Figure, Result, RigArgument, by_stage, command, out_folder, ready_to_run, write_drawn
from beamdesign.cli.output import say, say_table
from beamdesign.json_text import picked

if TYPE_CHECKING:
    from beamdesign.prototype import InStage, Prototype

_SHOWN_HZ = (0.1, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
_LINEAR_HZ = (1.0, 10.0, 50.0)
_AMPLITUDES_M = (1e-6, 1e-5, 1e-4, 3e-4, 1e-3)


@command
def limits(
    prototype: RigArgument,
    payload: Annotated[
        float | None,
        Figure("Mass on the outer tip; the prototype's largest payload by default.", "MassOrNone", metavar="KG"),
    ] = None,
    preload: Annotated[float, Figure("Constant force on the outer tip.", "SignedForce", metavar="N")] = 0.0,
    out: Annotated[Path | None, out_folder("Folder for the envelope as a figure.")] = None,
) -> Result:
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
    from beamdesign.synthesis.operating_limits import envelope, sensor_reach

    found = envelope(rig, mass, preload)
    fields: dict[str, Any] = {"outer_end_mass_kg": mass, "preload_N": preload, "stable": not found.reason}
    if found.reason:
        say(f"{rig.name}: {found.reason}; a loop that is not stable has no operating limits")
        return fields | {"reason": found.reason}, False
    fields["actuator"] = _actuator(f"{rig.name} with {mass:g} kg outside", found)
    reach = sensor_reach(rig, mass)
    fields["sensor"] = reach
    _say_sensor(reach)
    fields["modes"] = _modes(rig, mass)
    fields["linear_amplitude"] = _linear(rig, mass)
    fields["limit_cycles"] = _cycles(rig, mass)
    fields["figures"] = [] if out is None else _draw(found, rig.payload.largest_force_N, preload, out)
    return fields, True


def _actuator(title: str, found: Any) -> dict[str, Any]:
    import numpy as np

    shown = [int(np.argmin(np.abs(np.log(found.frequency_Hz / f)))) for f in _SHOWN_HZ]
    rows = [
        (
            float(found.frequency_Hz[k]), float(found.load_N[k]), found.governing[k],
            1e6 * float(found.displacement_m[k]), float(found.supply_power_W[k]),
        )
        for k in shown
    ]  # fmt: skip
    say_table(
        f"{title}: largest amplitude of a force on the tip",
        ("frequency, Hz", "force, N", "governed by", "tip moves, um", "supply power, W"),
        rows,
    )
    for limit, key in found.missing.items():
        say(f"{limit}: not looked at, {key} is not given")
    return picked(found, "frequency_Hz load_N governing limits_N displacement_m supply_power_W missing")


def _say_sensor(reach: Any) -> None:
    say(f"sensor: static error {1e8 * reach.static_error_m_per_N:.3g} um under 100 N")
    if reach.resolution_m is not None:
        say(f"  resolution {1e6 * reach.resolution_m:.3g} um: hides constant forces up to {reach.hidden_N:.4g} N")
    if reach.noise_m is not None:
        share = "" if reach.rated_share is None else f", {100 * reach.rated_share:.3g} % of the largest"
        noise = f"{1e6 * reach.noise_m:.3g} um RMS, followed where slow"
        say(f"  noise {noise}; {1e3 * reach.current_noise_A:.3g} mA{share}")
    missing = [
        key for key, value in (("resolution_m", reach.resolution_m), ("noise_V", reach.noise_m)) if value is None
    ]
    if missing:
        say(f"  not looked at: {', '.join(f'sensor.{key}' for key in missing)} not given")


def _modes(rig: Any, mass: float) -> dict[str, Any]:
    from beamdesign.plant.higher_modes import single_mode_reach
    from beamdesign.records import InputError

    try:
        found = single_mode_reach(rig, mass)
    except (InputError, ValueError) as error:
        say(f"higher modes: not looked at, {error}")
        return {"reason": str(error)}
    rows = [
        ("outer beam's tip compliance within 10 % up to, Hz", found.outer_Hz),
        ("inner beam's", found.inner_Hz),
        ("closed-loop compliance within 10 % up to, Hz", found.closed_loop_Hz),
        ("second mode, outer beam, Hz", found.outer_modes_Hz[1]),
        ("second mode, inner beam, Hz", found.inner_modes_Hz[1]),
        ("critical gain with one mode per beam, mA/V", 1e3 * found.critical_gain_A_per_V),
        ("with all modes, mA/V", 1e3 * found.critical_gain_all_A_per_V),
        ("of the critical gain taken by them, %", 100 * found.gain_margin_eaten),
    ]
    say_table("One bending mode per beam", ("", ""), rows)
    names = (*type(found).__dataclass_fields__, "gain_margin_eaten")
    return {name: getattr(found, name) for name in names}


def _linear(rig: Any, mass: float) -> list[dict[str, Any]]:
    from beamdesign.cli.output import progress
    from beamdesign.plant.linear_reach import Varied, reach, with_published_effects

    real = with_published_effects(rig)
    equal = real.but(effects={name: given for name, given in real.effects.items() if name != "unequal_piston_areas"})
    asked: list[tuple[str, Varied, Any]] = [
        ("constant load, N", "load", real),
        ("constant load, equal piston sides, N", "load", equal),
        ("force amplitude, N", "force", real),
        ("air, volume share", "air", real),
    ]
    results, rows = [], []
    with progress("linear amplitude") as update:
        for number, (words, varied, there) in enumerate(asked):
            update(number / len(asked), words)
            for frequency in _LINEAR_HZ:
                found = reach(there, varied, frequency, mass)
                ended = abs(found.departure) > 0.095
                results.append(
                    {
                        "varied": varied,
                        "effects": sorted(there.effects),
                        "frequency_Hz": frequency,
                        **picked(found, "limit departure"),
                        "reached": ended,
                    }
                )
                bound = found.limit if ended else f"more than {found.limit:.4g}"
                rows.append((words, frequency, bound, 100 * found.departure))
    say_table(
        f"Linear amplitude within 10 % up to ({', '.join(sorted(real.effects))})",
        ("varied", "at, Hz", "limit", "off there, %"),
        rows,
    )
    return results


def _cycles(rig: Any, mass: float) -> list[dict[str, Any]]:
    from beamdesign.plant.harmonic_balance import limit_cycles
    from beamdesign.plant.linear_reach import with_published_effects

    real = with_published_effects(rig)
    results = []
    for amplitude in _AMPLITUDES_M:
        try:
            (cycle,) = limit_cycles(real, [amplitude], mass)
        except ValueError:  # there is none of that amplitude, or harmonic balance does not cover an effect
            continue
        results.append(
            {
                "amplitude_m": amplitude,
                **picked(cycle, "gain_A_per_V frequency_Hz=motion.frequency_Hz stable"),
            }
        )
    rows = [
        (1e6 * row["amplitude_m"], 1e3 * row["gain_A_per_V"], row["frequency_Hz"], "yes" if row["stable"] else "no")
        for row in results
    ]
    own = 1e3 * rig.controller.gain_A_per_V
    say_table(
        f"Limit cycles by harmonic balance; the prototype's gain is {own:.4g} mA/V",
        ("amplitude, um", "gain, mA/V", "frequency, Hz", "settles there"),
        rows,
    )
    return results


def _draw(found: Any, asked: float | None, preload: float, out: Path) -> list[Path]:
    from beamdesign.report.canvas import new_figure
    from beamdesign.report.figures import plot_envelope

    figure = new_figure(170.0, 105.0)
    axes = plot_envelope(figure.add_subplot(), found, asked)
    if preload:
        axes.set_title(f"on top of {preload:g} N", fontsize=9)
    return write_drawn(out, "envelope", figure)
