"""The critical gain by experiment in simulation: the gain is raised until a kick no longer dies out."""

from dataclasses import dataclass
from math import exp, log

import numpy as np

from beamdesign.loop import CriticalGain
from beamdesign.oscillation import Oscillation, oscillation
from beamdesign.prototype import Prototype
from beamdesign.scenario import Scenario, ScenarioRecord, Step
from beamdesign.simulate import simulate


@dataclass(frozen=True)
class Kick:
    """How the rig is pushed, and how long it is watched.

    Attributes:
        force_N: on the outer tip, for 5 ms.
        preload_N: constant load under which it rests before.
        settle_s: after the kick, before the oscillation is looked at.
        watch_s: how long it is looked at.
    """

    force_N: float = 20.0
    preload_N: float = 0.0
    settle_s: float = 0.5
    watch_s: float = 1.0


def ringing(prototype: Prototype, gain: float, outer_end_mass: float, kick: Kick) -> Oscillation | None:
    """How the tip oscillates after a kick at one gain (A/V); None where it is still."""
    if prototype.controller is None:
        raise ValueError("the prototype has no [controller]")
    begins = 0.02
    push = Step(amplitude_N=kick.force_N, at_s=begins, rise_s=0.002, length_s=0.005)
    row = ScenarioRecord(name="kick", input=(push,), outer_end_mass_kg=outer_end_mass, preload_N=kick.preload_N)
    scenario = Scenario(
        name="kick", duration_s=begins + kick.settle_s + kick.watch_s, displacement_limit_m=1.0, record=(row,)
    )
    rig = prototype.but(controller=prototype.controller.but(gain_A_per_V=gain))
    record = simulate(rig, scenario).records[0]
    if record.diverged_at_s is not None:
        return record.oscillation
    times = record.column("t_s")
    late = times >= begins + kick.settle_s
    signal = record.column("displacement_m")[late]
    return oscillation(times[late], signal - np.mean(signal))


def critical_gain_by_kicks(
    prototype: Prototype,
    outer_end_mass: float,
    low: float,
    high: float,
    kick: Kick | None = None,
    tolerance: float = 1e-3,
) -> CriticalGain:
    """The gain between `low` and `high` (A/V) at which a kick neither grows nor dies out, with its frequency.

    Args:
        prototype: rig with its effects; the controller's breaks are kept.
        outer_end_mass: payload, kg.
        low: a gain at which the kick dies out.
        high: a gain at which it grows.
        kick: size of the push; with nonlinear effects the answer depends on it.
        tolerance: relative, of the gain.

    Raises:
        ValueError: where it does not die out at `low` or does not grow at `high`.
    """
    kick = kick or Kick()

    def growth(gain: float) -> tuple[float, float]:
        found = ringing(prototype, gain, outer_end_mass, kick)
        return (-1.0, 0.0) if found is None else (found.growth_per_s, found.frequency_Hz)

    at_low, at_high = growth(low), growth(high)
    if at_low[0] >= 0:
        raise ValueError(f"the kick does not die out at {low:g} A/V")
    if at_high[0] <= 0:
        raise ValueError(f"the kick does not grow at {high:g} A/V")
    frequency = at_high[1]
    while high / low > 1 + tolerance:
        middle = exp((log(low) + log(high)) / 2)
        rate, seen = growth(middle)
        frequency = seen or frequency
        low, high = (low, middle) if rate > 0 else (middle, high)
    return CriticalGain(exp((log(low) + log(high)) / 2), frequency)
