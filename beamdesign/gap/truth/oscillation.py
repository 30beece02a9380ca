"""The gain at which the true rig's loop begins to oscillate, found as on a rig: by turning it up."""

from typing import Any

import numpy as np

from beamdesign.gap.truth.believed import assembled, controller_figures
from beamdesign.gap.truth.case import Case, Run, run_figures, step_of
from beamdesign.gap.truth.rig import march

RELATIVE_STD = 0.03
_WATCHED_S = 1.5


def sustained(case: Case, run: Run, gain_A_per_V: float) -> bool:
    """Whether a short push (5 ms at a tenth of the largest load) is still there, not less, in the last third."""
    figures = run_figures(case, run) | controller_figures(run.controller | {"gain_A_per_V": gain_A_per_V})
    step = step_of(figures)
    times = np.arange(2 * round(_WATCHED_S / step) + 1) * (step / 2)
    inputs = np.zeros((len(times), 3))
    inputs[times < 5e-3, 0] = 0.1 * case.scales.force
    record, modes = assembled(figures)
    motion = march(record, modes, inputs, None, step)
    if not motion.bounded:
        return True
    third = len(motion.displacement) // 3
    middle, last = motion.displacement[third : 2 * third], motion.displacement[2 * third :]
    return bool(np.std(last) > max(0.97 * np.std(middle), 2 * case.noise.floor_m))


def critical_gain(case: Case, run: Run) -> float:
    """Least gain (A/V) at which the oscillation is sustained, to 1 %, starting from a fifth of the run's own.

    Raises:
        ValueError: where it oscillates at a fifth already, or at no gain up to 100 times its own.
    """
    own = float(run.controller["gain_A_per_V"])
    low = 0.2 * own
    if sustained(case, run, low):
        raise ValueError(f"{run.name} oscillates at a fifth of its gain")
    high = low
    while not sustained(case, run, high):
        low, high = high, 1.5 * high
        if high > 100 * own:
            raise ValueError(f"{run.name} oscillates at no gain")
    while high > 1.01 * low:
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if sustained(case, run, middle) else (middle, high)
    return float(np.sqrt(low * high))


def measured_gains(case: Case) -> list[dict[str, Any]]:
    """Critical gains of every setting among the runs, with the scatter of reading them, as tables of the contract."""
    rng = np.random.default_rng([case.seed, 5])
    found: list[dict[str, Any]] = []
    seen = set()
    for run in case.runs:
        setting = (run.controller["kind"], run.outer_end_mass_kg)
        if setting in seen:
            continue
        seen.add(setting)
        try:
            gain = critical_gain(case, run)
        except ValueError:
            continue  # on a rig, too, nothing is noted down then
        found.append(
            {
                "controller": {key: value for key, value in run.controller.items() if key != "gain_A_per_V"},
                "outer_end_mass_kg": run.outer_end_mass_kg,
                "inner_end_mass_kg": run.inner_end_mass_kg,
                "gain_A_per_V": float(f"{gain * np.exp(RELATIVE_STD * rng.normal()):.3g}"),
                "relative_std": RELATIVE_STD,
            }
        )
    return found
