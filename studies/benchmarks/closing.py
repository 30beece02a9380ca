"""Closing the loop: controllers tuned on what was believed and on what was diagnosed, both on the true rig.

Only a rig whose truth is known can show whether a diagnosis leads to a controller that holds; the cases of a blind
check are such rigs, once their answers are open.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path

import numpy as np
from delivered import MEASURED_WITHIN
from opened_cases import diagnosed, opened_case, true_rig
from trial import Trial, on_trial

from beamdesign import Prototype
from beamdesign.diagnosis.diagnosis import updated_prototype
from beamdesign.diagnosis.redesign import Redesign, payload_range, redesign
from beamdesign.loop import loop
from beamdesign.synthesis.loop_samples import first_miss
from beamdesign.validation.truth.case import Case

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Attempt:
    """A controller that was tuned and proved for one prototype, on the true rig.

    Attributes:
        tuned_for: `believed`, `re-tuned` (figures fitted, no cause added) or `diagnosed`.
        made: the design; without a prototype where none was found.
        promised_gain_factor: least factor on the gain at which the model's loop is not stable, over the payloads.
        trials: one for the least, the middle and the largest payload; none without a design.
    """

    tuned_for: str
    made: Redesign
    promised_gain_factor: float = 0.0
    trials: tuple[Trial, ...] = ()

    @property
    def safe(self) -> bool:
        """Whether the true loop comes to rest after a kick, a load put on and a load taken off, at every payload.

        The load is the largest of the rig's records. Coming to rest: what is left swings less and less, or by no more
        than twice the noise floor; see `trial.at_rest`.
        """
        return bool(self.trials) and all(trial.safe for trial in self.trials)

    @property
    def bandwidth_Hz(self) -> float:
        """Up to which the true rig keeps the compliance asked for, the least over the payloads; 0 where not safe."""
        prototype = self.made.prototype
        if prototype is None or not self.safe:
            return 0.0
        limit = prototype.goal.compliance_m_per_N
        reached = [first_miss(t.frequency_Hz, np.log(limit / t.compliance_m_per_N)) for t in self.trials]
        return min(*reached, *(float(t.frequency_Hz[-1]) for t in self.trials))

    @property
    def peak_sensitivity(self) -> float:
        """The largest measured over the payloads; infinite where not safe."""
        return max((trial.peak_sensitivity for trial in self.trials), default=inf)

    @property
    def gain_factor(self) -> float:
        """The least over the payloads at which a kick of the true rig does not die away."""
        return min((trial.gain_factor for trial in self.trials), default=0.0)

    @property
    def keeps_promise(self) -> bool:
        """Whether it is safe and delivers bandwidth and peak sensitivity as proved, to a tenth."""
        guarantee = self.made.prototype.guarantee if self.made.prototype else None
        return (
            self.safe
            and guarantee is not None
            and self.bandwidth_Hz >= guarantee.bandwidth_Hz * (1 - MEASURED_WITHIN)
            and self.peak_sensitivity <= guarantee.peak_sensitivity * (1 + MEASURED_WITHIN)
        )


@dataclass(frozen=True)
class Closed:
    """One case.

    Attributes:
        key: of the case.
        truth: what was in it.
        verdict: of the diagnosis.
        chosen: causes named.
        attempts: the believed prototype's first.
    """

    key: str
    truth: tuple[str, ...]
    verdict: str
    chosen: tuple[str, ...]
    attempts: tuple[Attempt, ...]


def close_the_loop(
    folder: Path, key: str, with_retuned: bool = False, progress: Progress = lambda doing: None
) -> Closed:
    """Tune on the believed and on the diagnosed prototype of an opened case, and put both on its true rig.

    Args:
        folder: of a blind check.
        key: of a case whose answer it has opened.
        with_retuned: whether to tune for the prototype with fitted figures but no cause as well.
        progress: told what is being done.

    Raises:
        InputError: see `opened_cases`.
    """
    opened = opened_case(folder, key)
    progress("diagnosing")
    data, found = diagnosed(opened)
    rigs = {"believed": data.prototype}
    if with_retuned and found.search is not None and found.chosen:
        rigs["re-tuned"] = updated_prototype(data.prototype, found.search.null).but(tolerance=data.prototype.tolerance)
    rigs["diagnosed"] = found.prototype
    masses = payload_range(data)
    made = {}
    for name, prototype in rigs.items():
        progress(f"tuning on what is {name}")
        made[name] = redesign(prototype, masses)
    progress("drawing the true rig")
    case = true_rig(opened)
    progress("on trial")
    attempts = tuple(attempt(case, name, one) for name, one in made.items())
    return Closed(key, case.names, found.verdict, tuple(found.chosen), attempts)


def attempt(case: Case, tuned_for: str, made: Redesign) -> Attempt:
    """Put a design on the true rig, at the least, the middle and the largest payload of its range."""
    prototype = made.prototype
    if prototype is None or prototype.controller is None:
        return Attempt(tuned_for, made)
    masses = payloads(made.outer_end_mass_kg)
    table = prototype.controller.model_dump(exclude_none=True)
    inner = prototype.payload.inner_end_mass_kg
    trials = tuple(on_trial(case, table, inner, mass) for mass in masses)
    return Attempt(tuned_for, made, promised_gain_factor(prototype, masses), trials)


def payloads(range_kg: tuple[float, float]) -> tuple[float, ...]:
    """Least, middle and largest, kg."""
    low, high = range_kg
    return tuple(dict.fromkeys((low, (low + high) / 2, high)))


def promised_gain_factor(prototype: Prototype, masses_kg: Sequence[float]) -> float:
    """Least gain margin of the model's loop at rest over these payloads."""
    closed = loop(prototype)
    return min(closed.at(mass).margins().gain_up for mass in masses_kg)
