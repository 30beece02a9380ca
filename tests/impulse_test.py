"""The critical gain by experiment in simulation: the gain is raised until a kick no longer dies out.

`beamdesign.plant.harmonic_balance` predicts what it finds: where the curve of gain over amplitude falls, a larger kick
finds a lower gain; where it rises, the oscillation settles on it.
"""

from dataclasses import dataclass, replace
from math import exp, inf, log

import numpy as np

from beamdesign import Prototype, simulate
from beamdesign.loop import CriticalGain
from beamdesign.scenario import Scenario, ScenarioRecord, Step
from beamdesign.simulation import Oscillation, oscillation

_KEPT = 0.98  # of the amplitude over the time watched: what loses less is said not to die out
_STILL_M = 1e-9
_TRAVEL_M = 0.02  # an oscillation that passes it has no cycle to settle on


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
    """How the tip oscillates after a kick at one gain (A/V).

    None where it is still; growth is infinite where it left the rig's travel.
    """
    if prototype.controller is None:
        raise ValueError("the prototype has no [controller]")
    begins = 0.02
    push = Step(amplitude_N=kick.force_N, at_s=begins, rise_s=0.002, length_s=0.005)
    row = ScenarioRecord(name="kick", input=(push,), outer_end_mass_kg=outer_end_mass, preload_N=kick.preload_N)
    scenario = Scenario(
        name="kick", duration_s=begins + kick.settle_s + kick.watch_s, displacement_limit_m=_TRAVEL_M, record=(row,)
    )
    rig = prototype.but(controller=prototype.controller.but(gain_A_per_V=gain))
    record = simulate(rig, scenario).records[0]
    if record.diverged_at_s is not None:
        last = record.oscillation or Oscillation(0.0, scenario.displacement_limit_m, inf)
        return replace(last, growth_per_s=inf)  # it has left the scene: its last turns say nothing more
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
    """The gain between `low` and `high` (A/V) from which on a kick no longer dies out, with its frequency.

    An oscillation that settles on a limit cycle has not died out, though it does not grow either.

    Args:
        prototype: rig with its effects; the controller's breaks are kept.
        outer_end_mass: payload, kg.
        low: a gain at which the kick dies out.
        high: a gain at which it does not.
        kick: size of the push; with nonlinear effects the answer depends on it.
        tolerance: relative, of the gain.

    Raises:
        ValueError: where it does not die out at `low`, or does at `high`.
    """
    kick = kick or Kick()

    def stays(gain: float) -> tuple[bool, float]:
        found = ringing(prototype, gain, outer_end_mass, kick)
        if found is None or found.amplitude < _STILL_M:
            return False, 0.0
        return found.growth_per_s > log(_KEPT) / kick.watch_s, found.frequency_Hz

    (at_low, _), (at_high, frequency) = stays(low), stays(high)
    if at_low:
        raise ValueError(f"the kick does not die out at {low:g} A/V")
    if not at_high:
        raise ValueError(f"the kick dies out at {high:g} A/V")
    while high / low > 1 + tolerance:
        middle = exp((log(low) + log(high)) / 2)
        kept, seen = stays(middle)
        frequency = seen or frequency
        low, high = (low, middle) if kept else (middle, high)
    return CriticalGain(exp((log(low) + log(high)) / 2), frequency)
