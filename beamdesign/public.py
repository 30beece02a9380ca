"""Public functions that join engines of several rooms, each imported when it is called.

They take records and give records: a range of mass is a pair in kg, or None for what the prototype states.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from beamdesign.arguments import takes
from beamdesign.progress import Progress, silent
from beamdesign.records import InputError

if TYPE_CHECKING:
    import control
    from matplotlib.figure import Figure

    from beamdesign.proofs.lyapunov import Switching
    from beamdesign.prototype import Prototype
    from beamdesign.sweep.sweep_run import SweepRun

LOOP_OUTPUTS = ("displacement_m", "sensor_V", "current_A")
"""Of the open and the closed loop of `state_space`; the plant has the first two. What added sensors read follows."""

_FASTEST_KG_PER_S = 1e6


@takes("Prototype")
def certify_switching(
    prototype: "Prototype",
    outer_end_mass_kg: tuple[float, float] | None = None,
    rate_kg_per_s: float | None = None,
    progress: Progress = silent,
) -> "Switching":
    """Prove stability while the payload changes in motion, and of several laws while these change.

    Args:
        prototype: with a controller; its schedule says how long a stage stays.
        outer_end_mass_kg: range of payloads; else the prototype's.
        rate_kg_per_s: to be proved up to; else the largest is searched for.
        progress: told the share done and what is being done.

    Raises:
        ValueError: for stages of different states, or a range of one payload.
        InputError: without a range, for effects, or for a rate that is not plausible.
    """
    if rate_kg_per_s is not None and not 0 < rate_kg_per_s <= _FASTEST_KG_PER_S:
        reason = f"is {rate_kg_per_s:g}; above 0 and up to {_FASTEST_KG_PER_S:g} kg/s is plausible"
        raise InputError(prototype.name, [("rate_kg_per_s", reason)])

    from beamdesign.proofs.lyapunov import switching
    from beamdesign.proofs.mass_family import stage_families

    families, schedule = stage_families(prototype), prototype.schedule
    stays = 0.0 if schedule is None else schedule.dwell_s
    return switching(families, *prototype.asked_kg(outer_end_mass_kg), rate_kg_per_s, stays, progress)


@takes("Prototype")
def pictures(prototype: "Prototype") -> "dict[str, Figure]":
    """The pictures of a closed loop that the report of a run has, by name; of a result with a rig: `.pictures()`.

    compliance, sensitivity, loop (Bode diagram with margins), nyquist, poles, locus, ranges, gains; of several laws
    those of each, with the suffix of its stage. As numbers: `beamdesign.loop.loop(prototype, True).at(mass)`, of a
    prototype with effects a linear loop of which bandwidth and peak sensitivity are claimed, at rest where they are.

    Raises:
        ValueError: without a controller.
        InputError: without a range of outer end masses.
    """
    from beamdesign.loop import loop
    from beamdesign.report.pictures import loop_pictures

    stages = prototype.stages(prototype.asked_kg())
    drawn = ((stage, loop_pictures(stage.prototype, loop(stage.prototype, performing=True))) for stage in stages)
    return {one.name + stage.suffix: one.figure for stage, pictures in drawn for one in pictures}


@takes("Prototype")
def state_space(
    prototype: "Prototype", outer_end_mass_kg: float = 0.0, loop: Literal["closed", "open", "plant"] = "closed"
) -> "control.StateSpace":
    """The linear rig at one outer end mass, equations (7) to (18), in SI.

    - "plant": `disturbance_N` and `current_A` to `displacement_m` and `sensor_V`.
    - "open": the controller before the plant, the sensor not fed back: `disturbance_N` and `command_V` to
      `displacement_m`, `sensor_V` and `current_A`. The loop transfer function L is `sensor_V` over `command_V` where
      nothing but the sensor is to be fed back.
    - "closed": the same signals with the sensor subtracted from the command, equation (12).

    Where the controller has added sensors, what they read are further outputs of all three, and are fed back in the
    third: `inner_displacement_m`, `load_pressure_Pa`, `screw_force_N`.

    States are named as in `beamdesign.plant.linearised.linear_states`, then `filtered_V` where the sensor has a filter,
    then `EFFECT_STATE` and `mean_pressure_Pa` where there are such, then `controller_1` and so on for a controller with
    dynamics. A prototype with effects is taken linear at rest.

    Args:
        prototype: its inner end mass is that of `payload.inner_end_mass_kg`.
        outer_end_mass_kg: mass on the outer tip.
        loop: which of the three.

    Raises:
        InputError: for a mass that is not plausible.
        ValueError: for a loop where the prototype has no controller, or a name that is none of the three.
    """
    import control
    import numpy as np

    from beamdesign.arguments import checked_mass_kg
    from beamdesign.plant.linear import SEEN_AS
    from beamdesign.plant.members import family

    mass = checked_mass_kg(prototype.name, outer_end_mass_kg)
    member = family(prototype, mass).rest
    a, b, c = member.rig.matrices(mass, prototype.payload.inner_end_mass_kg)
    b = b * [1.0, member.gain.high]
    added = prototype.controller.added if prototype.controller is not None else ()
    c = c[[0, 1, *(SEEN_AS[name] for name in added)]]
    states = [name.replace(".", "_") for name in member.rig.states]
    if loop == "plant":
        return control.ss(
            a, b, c, np.zeros((len(c), 2)), states=states, inputs=["disturbance_N", "current_A"],
            outputs=[*LOOP_OUTPUTS[:2], *added], name="plant",
        )  # fmt: skip
    law = prototype.own_controller.control_model()
    n, k = len(states), law.nstates
    # The error, in volts, is the command less what is fed back of the sensor; the added sensors have no command.
    fed_back = c[1:] if loop == "closed" else np.zeros((1 + len(added), n))
    disturbance, current, commanded = b[:, :1], b[:, 1:], slice(0, 1)
    dynamics = np.block([[a - current @ law.D @ fed_back, current @ law.C], [-law.B @ fed_back, law.A]])
    inputs = np.block([[disturbance, current @ law.D[:, commanded]], [np.zeros((k, 1)), law.B[:, commanded]]])
    inputs[n:, 1] += prototype.own_controller.state_space()[4]
    shown = np.hstack([c, np.zeros((len(c), k))])
    outputs = np.vstack([shown[:2], np.hstack([-law.D @ fed_back, law.C]), shown[2:]])
    through = np.zeros((len(outputs), 2))
    through[2, 1:] = law.D[:, commanded]
    return control.ss(
        dynamics, inputs, outputs, through,
        states=[*states, *(f"controller_{i + 1}" for i in range(k))], inputs=["disturbance_N", "command_V"],
        outputs=[*LOOP_OUTPUTS, *added], name=f"{loop}_loop",
    )  # fmt: skip


@takes()
def study(
    source: Path | str,
    folder: Path | str,
    workers: int = 1,
    progress: Progress = silent,
    *,
    cases: int | None = None,
    scheduler: str | None = None,
    case_seconds: float | None = None,
    again: bool = False,
) -> "SweepRun":
    """Carry out a sweep; one that was interrupted goes on by the same call, and nothing is computed twice.

    A script that is not a notebook has to begin its work under `if __name__ == "__main__":`, since processes are begun.

    Args:
        source: the sweep's file.
        folder: of the results; made if need be.
        workers: processes of this machine.
        progress: called with the share done and what is being done.
        cases: no more than so many.
        scheduler: address of a Dask cluster that computes instead of this machine.
        case_seconds: after which a case is given up; an hour where None. A cluster gives none up.
        again: compute rows again that failed.

    Raises:
        InputError: for what is wrong with the file, where every case is refused, or for results that cannot be read.
        KeyboardInterrupt: after the finished rows have been written.
    """
    from beamdesign.sweep.conclusion import draw
    from beamdesign.sweep.sweep_run import plan, run_sweep
    from beamdesign.sweep.workers import CASE_SECONDS, cluster, processes

    laid, most = plan(Path(source), cases), CASE_SECONDS if case_seconds is None else case_seconds
    with processes(workers, most) if scheduler is None else cluster(scheduler) as compute:
        return run_sweep(laid, Path(folder), compute, progress, again, draw)
