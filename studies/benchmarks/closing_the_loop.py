"""Controllers tuned on what was believed and on what was diagnosed, on true rigs of a blind check.

Each case of a check that `beamdesign gap blindcheck` has scored is diagnosed once more from its kept fits. A lag is
tuned and proved over the payload range for the believed prototype and for the diagnosed one, as `gap diagnose
--redesign` does, and both are put on the rig that made the records, in time. Safe is a loop that comes to rest after a
kick, the largest load of the records put on, and that load taken off, at the least, the middle and the largest
payload. A promise is kept by a safe loop whose measured bandwidth and peak sensitivity are those proved, to a tenth.
Usage, from the root of the project:

    python studies/benchmarks/closing_the_loop.py RUN_FOLDER [--cases 0002 0009 ...] [--re-tuned]

Without --cases these are all cases whose verdict is `effect`.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import inf
from pathlib import Path

import numpy as np
from delivered_bandwidth import MEASURED_WITHIN
from opened_cases import diagnosed, opened_case, opened_keys, true_rig
from trial import Trial, on_trial

from beamdesign import InputError, Prototype
from beamdesign.diagnosis.diagnosis import updated_prototype
from beamdesign.diagnosis.redesign import Redesign, payload_range, redesign
from beamdesign.loop import loop
from beamdesign.synthesis.loop_samples import first_miss
from beamdesign.validation.bounds import clopper_pearson
from beamdesign.validation.truth.case import Case

COLUMNS = (
    "case", "truth", "verdict", "tuned for", "safe", "bandwidth, Hz: proved", "true", "peak sensitivity: proved",
    "true", "gain factor to instability: model", "true", "promise kept",
)  # fmt: skip
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


def rows(closed: Closed) -> list[tuple[str, ...]]:
    """One row for every controller of a case."""
    verdict = f"{closed.verdict}: {', '.join(closed.chosen)}" if closed.chosen else closed.verdict.replace("_", " ")
    head = (closed.key, ", ".join(closed.truth), verdict)
    return [
        (*(head if k == 0 else ("", "", "")), one.tuned_for, *_figures(one)) for k, one in enumerate(closed.attempts)
    ]


def _figures(one: Attempt) -> tuple[str, ...]:
    guarantee = one.made.prototype.guarantee if one.made.prototype else None
    if guarantee is None:
        return ("no controller found", *[""] * 7)
    restless = [f"{t.outer_end_mass_kg:.3g} kg {t.restless}" for t in one.trials if t.restless]
    figures = (
        guarantee.bandwidth_Hz, one.bandwidth_Hz, guarantee.peak_sensitivity, one.peak_sensitivity,
        one.promised_gain_factor, one.gain_factor,
    )  # fmt: skip
    safe = f"no: {'; '.join(restless)}" if restless else "yes"
    return (safe, *(f"{value:.3g}" for value in figures), "yes" if one.keeps_promise else "no")


def totals(done: Sequence[Closed]) -> list[tuple[str, ...]]:
    """How many were safe and kept their promise, with 95 % bounds (Clopper and Pearson)."""
    found: list[tuple[str, ...]] = []
    for name in ("believed", "re-tuned", "diagnosed"):
        tried = [one for closed in done for one in closed.attempts if one.tuned_for == name]
        if tried:
            made = [one for one in tried if one.made.prototype]
            safe, kept = sum(one.safe for one in made), sum(one.keeps_promise for one in made)
            found.append((name, _rate(len(made), len(tried)), _rate(safe, len(made)), _rate(kept, len(made))))
    return found


def _rate(count: int, of: int) -> str:
    low, high = clopper_pearson(count, of)
    return f"{count} of {of} ({low:.0%} to {high:.0%})"


def line(cells: Sequence[str]) -> str:
    """A row in Markdown."""
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Print a row for every controller, then the totals."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="of a blind check that has been scored")
    parser.add_argument("--cases", nargs="+", metavar="KEY", help="else all whose verdict is `effect`")
    parser.add_argument("--re-tuned", action="store_true", help="also for the figures fitted without any cause")
    given = parser.parse_args()
    keys = given.cases or [key for key, verdict in opened_keys(given.folder).items() if verdict == "effect"]
    for key in keys:
        opened_case(given.folder, key)  # says at once what is wrong
    print(line(COLUMNS), line(["---"] * len(COLUMNS)), sep="\n", flush=True)
    done = []
    for k, key in enumerate(keys, start=1):
        told = partial(_tell, f"{key} ({k} of {len(keys)})")
        done.append(close_the_loop(given.folder, key, given.re_tuned, told))
        print(*map(line, rows(done[-1])), sep="\n", flush=True)
        for one in done[-1].attempts:
            if one.made.reason:
                told(f"tuning on what is {one.tuned_for}: {one.made.reason}")
    heads = ("tuned for", "controller found", "safe, of those found", "promise kept, of those found")
    print("", line(heads), line(["---"] * len(heads)), *map(line, totals(done)), sep="\n")


def _tell(case: str, doing: str) -> None:
    print(f"{case}: {doing}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
