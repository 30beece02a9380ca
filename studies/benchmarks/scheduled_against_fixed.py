"""A scheduled controller beside the fixed lag, on the nonlinear rig: estimates, load steps, delivered bandwidth.

Rigs are drawn from tolerances and get the effects that the linear design leaves out. Both controllers are sampled alike
and hear the same noise. Usage, from the root of the project:

    python studies/benchmarks/scheduled_against_fixed.py [--rigs 6] [--force-N 40] [--picture PICTURE.svg]
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from delivered_bandwidth import DEVIATIONS, MEASURED_WITHIN, drawn, response, rig_of

from beamdesign import Prototype, read_prototype, tune
from beamdesign.controllers import Lag, Scheduled, Stage
from beamdesign.report.canvas import STYLES, new_figure, save
from beamdesign.report.figures import BESIDE
from beamdesign.scenario import Course, Multisine, Scenario, ScenarioRecord, inputs_of
from beamdesign.simulation import SimulatedRecord, simulate_scheduled

SCHEDULED = Path(__file__).parents[1] / "scheduled" / "prototype.toml"
NOISE_V = 0.002
LOADED_S, RISE_S = 0.1, 0.005
PAYLOADS_KG = (0.0, 2.3, 4.5, 6.8)
COMMAND_V = 0.05
DRAWN = 4
"""One sample in so many is drawn."""


def schedule_of(rig: Prototype) -> Scheduled:
    """Its several laws."""
    assert rig.schedule is not None
    return rig.schedule


def fixed_beside(rig: Prototype) -> Prototype:
    """The lag over the same payloads, with its own mass inside, as the law of every stage."""
    tuned = tune(rig, schedule_of(rig).outer_end_mass_kg, sigmas=0.0).prototype
    law = tuned.controller
    assert isinstance(law, Lag)
    stages = [
        Stage(
            outer_end_mass_kg=stage.outer_end_mass_kg,
            gain_A_per_V=law.gain_A_per_V,
            pole_Hz=law.pole_Hz,
            zero_Hz=law.zero_Hz,
        )
        for stage in schedule_of(rig).stage
    ]
    return tuned.but(controller=schedule_of(rig).but(stage=tuple(stages)))


def built(rig: Prototype, count: int) -> list[Prototype]:
    """The nonlinear rig as designed, then others off by tolerances."""
    plain = rig_of(rig)
    deviations = {name: size for name, size in DEVIATIONS.items() if name != "filter_frequency"}
    return [plain, *drawn(plain, deviations, count - 1)] if count > 1 else [plain]


def load_step(rig: Prototype, height_N: float, duration_s: float, at: Sequence[tuple[float, float]]) -> np.ndarray:
    """A force (N,) that goes to a share of the height at each of some times."""
    times = np.arange(round(duration_s / schedule_of(rig).period_s)) * schedule_of(rig).period_s
    force, before = np.zeros(len(times)), 0.0
    for begins, share in at:
        rise = 0.5 - 0.5 * np.cos(np.pi * np.clip((times - begins) / RISE_S, 0, 1))
        force += height_N * (share - before) * rise
        before = share
    return force


def random_force(rig: Prototype, height_N: float, duration_s: float, seed: int) -> np.ndarray:
    """A multisine from 1 to 100 Hz, (N,)."""
    signal = Multisine(amplitude_N=height_N, low_Hz=1.0, high_Hz=100.0, seed=seed)
    plan = Scenario(
        name="force", duration_s=duration_s, sample_s=schedule_of(rig).period_s, record=(ScenarioRecord(name="force"),)
    )
    return inputs_of(ScenarioRecord(name="force", input=(signal,)), plan)[:, 0]


@dataclass(frozen=True)
class Guessed:
    """Estimates of one kind of record: errors of those that count, time until the first one, records without any."""

    errors_kg: np.ndarray
    waits_s: np.ndarray
    none: int
    right: int
    count: int


def guessed(rig: Prototype, rigs: Sequence[Prototype], kind: str, height_N: float) -> Guessed:
    """The estimates at the end of records, each begun with the lightest stage."""
    errors, waits, none, right, count = [], [], 0, 0, 0
    for k, one in enumerate(rigs):
        for payload in PAYLOADS_KG:
            force, command = np.zeros(1200), None
            if kind == "load step":
                force = load_step(rig, height_N, 0.6, [(LOADED_S, 1.0)])
            elif kind == "random force":
                force = random_force(rig, height_N, 0.6, k)
            else:
                command = load_step(rig, COMMAND_V, 0.6, [(LOADED_S, 1.0)])
            course = Course(force, ((0.0, payload),), command_V=command)
            found = simulate_scheduled(rig, course, one, noise_V=NOISE_V, seed=k)
            counts = found.column("estimate_std_kg") <= schedule_of(rig).estimator.largest_std_kg
            count += 1
            low, high = schedule_of(rig).stage[round(found.column("stage")[-1]) - 1].outer_end_mass_kg
            right += low <= payload <= high
            if not counts.any():
                none += 1
                continue
            errors.append(float(found.column("estimate_kg")[np.nonzero(counts)[0][-1]]) - payload)
            waits.append(float(found.column("t_s")[np.argmax(counts)]) - LOADED_S)
    return Guessed(np.array(errors), np.array(waits), none, right, count)


@dataclass(frozen=True)
class Step:
    """Peak after a load step, time until the tip stays below a tenth of it, and the bandwidth that is delivered."""

    peak_m: float
    settled_s: float
    bandwidth_Hz: float


def stepped(rig: Prototype, one: Prototype, payload: float, height_N: float, adaptive: bool, seed: int) -> Step:
    """The second of two load steps, and the compliance under a random force after them."""
    force = load_step(rig, height_N, 1.2, [(LOADED_S, 1.0), (0.7, 0.0)])
    course = Course(np.append(force, random_force(rig, height_N, 4.0, seed)), ((0.0, payload),))
    still = Course(np.append(force, np.zeros(len(course.force_N) - len(force))), ((0.0, payload),))
    found, quiet = (
        simulate_scheduled(rig, each, one, adaptive=adaptive, noise_V=NOISE_V, seed=seed) for each in (course, still)
    )
    if not (found.stable and quiet.stable):
        return Step(np.inf, np.inf, 0.0)
    moved, times = quiet.column("displacement_m"), quiet.column("t_s")
    second = (times >= 0.7) & (times < 1.2)
    answer = moved[second] - np.mean(moved[times > 1.15])
    peak = float(np.abs(answer).max())
    out = np.nonzero(np.abs(answer) > 0.1 * peak)[0]
    settled = float(times[second][out[-1]] - 0.7) if len(out) else 0.0
    late = slice(len(force), len(found.samples))
    difference = (found.column("displacement_m") - moved)[late]
    return Step(peak, settled, _bandwidth(course.force_N[late], difference, rig))


def _bandwidth(force: np.ndarray, moved: np.ndarray, rig: Prototype) -> float:
    """Up to which the measured compliance keeps to the goal, Hz."""
    frequency, compliance = response(force, moved, 1 / schedule_of(rig).period_s, 2.0, 90.0)
    over = np.nonzero(compliance > (1 + MEASURED_WITHIN) * rig.goal.compliance_m_per_N)[0]
    return float(frequency[over[0] - 1]) if len(over) and over[0] else 0.0


def gripped(rig: Prototype, one: Prototype, height_N: float, adaptive: bool) -> SimulatedRecord:
    """A load comes and goes; then the largest payload is gripped, at rest, and the load comes and goes again."""
    high = schedule_of(rig).outer_end_mass_kg[1]
    force = load_step(rig, height_N, 2.4, [(0.2, 1.0), (0.6, 0.0), (1.2, 1.0), (1.6, 0.0), (2.0, 1.0)])
    course = Course(force, ((0.0, 0.0), (0.9, high)), "from_rest")
    return simulate_scheduled(rig, course, one, adaptive=adaptive, noise_V=NOISE_V, seed=1)


def draw(fixed: SimulatedRecord, scheduled: SimulatedRecord, rig: Prototype, path: Path) -> Path:
    """The tip with both controllers, and the payload with its estimate and the stage, as SVG."""
    figure = new_figure(190, 120)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    beside = BESIDE[1] | {"linestyle": "-"}
    for record, words, style in ((fixed, "fixed lag", beside), (scheduled, "scheduled", STYLES[0])):
        moved = 1e6 * record.column("displacement_m")[::DRAWN]
        above.plot(record.column("t_s")[::DRAWN], moved, label=words, lw=0.9, **style)
    above.set_ylabel("tip of the outer beam, µm")
    above.legend(loc="upper left", frameon=False)
    times, stage = scheduled.column("t_s")[::DRAWN], scheduled.column("stage")[::DRAWN]
    ranges = np.array([one.outer_end_mass_kg for one in schedule_of(rig).stage])[stage.astype(int) - 1]
    below.fill_between(
        times, ranges[:, 0], ranges[:, 1], color="0.88", lw=0, step="post", label="range of the stage that acts"
    )
    below.plot(times, scheduled.column("outer_end_mass_kg")[::DRAWN], label="payload", **STYLES[3])
    known = scheduled.column("estimate_std_kg") <= schedule_of(rig).estimator.largest_std_kg
    estimate = np.where(known, scheduled.column("estimate_kg"), np.nan)
    below.plot(times, estimate[::DRAWN], label="estimate", lw=1.2, **STYLES[0])
    below.set(ylabel="payload, kg", xlabel="time, s", xlim=(0, times[-1]), ylim=(-0.6, 8.4))
    below.legend(loc="upper left", frameon=False, ncols=3)
    return save(figure, path.with_suffix(""), ("svg",))[0]


def main() -> None:
    """Print the tables and draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rigs", type=int, default=6)
    parser.add_argument("--force-N", type=float, default=40.0)
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args()
    rig = read_prototype(SCHEDULED)
    rigs = built(rig, given.rigs)
    print(f"estimates of the payload, {len(rigs)} nonlinear rigs with {', '.join(map(str, PAYLOADS_KG))} kg")
    heads = f"{'bias, kg':>9} {'std, kg':>8} {'worst, kg':>9} {'first after':>12} {'none':>9} {'stage right':>12}"
    print(f"{'record':14} {heads}")
    for kind in ("load step", "random force", "command step"):
        found = guessed(rig, rigs, kind, given.force_N)
        some = len(found.errors_kg) > 0
        figures = (
            (found.errors_kg.mean(), found.errors_kg.std(), np.abs(found.errors_kg).max(), np.median(found.waits_s))
            if some
            else (np.nan,) * 4
        )
        print(
            f"{kind:14} {figures[0]:9.2f} {figures[1]:8.2f} {figures[2]:9.2f} {figures[3]:10.3f} s"
            f" {found.none:3} of {found.count:2} {found.right:5} of {found.count:2}"
        )
    fixed = fixed_beside(rig)
    others = built(fixed, given.rigs)
    print(f"\nload steps of {given.force_N:g} N, medians of {len(rigs)} rigs: fixed lag, scheduled")
    print(f"{'payload, kg':>11} {'peak, um':>16} {'settled, ms':>16} {'delivered, Hz':>16}")
    for payload in PAYLOADS_KG:
        one = [stepped(fixed, each, payload, given.force_N, False, k) for k, each in enumerate(others)]
        two = [stepped(rig, each, payload, given.force_N, True, k) for k, each in enumerate(rigs)]
        rows = [
            tuple(float(np.median([getattr(each, name) for each in them])) for them in (one, two))
            for name in ("peak_m", "settled_s", "bandwidth_Hz")
        ]
        told = [f"{scale * a:8.4g}{scale * b:8.4g}" for (a, b), scale in zip(rows, (1e6, 1e3, 1.0), strict=True)]
        print(f"{payload:11g} " + " ".join(told))
    if given.picture is not None:
        both = gripped(fixed, others[0], given.force_N, False), gripped(rig, rigs[0], given.force_N, True)
        print(draw(*both, rig, given.picture))


if __name__ == "__main__":
    main()
