"""Fits made, by this process or by several, and those kept that were made before."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from multiprocessing import active_children
from signal import SIG_IGN, SIGINT, signal

from beamdesign.gap.data.dataset import Dataset
from beamdesign.gap.fitting.evidence import evidence_of
from beamdesign.gap.fitting.fit import ITERATIONS, Evidence, Fit, fit
from beamdesign.gap.fitting.followed import followed_evidence
from beamdesign.gap.fitting.hypothesis import Hypothesis
from beamdesign.gap.fitting.kept_fits import KeptFits
from beamdesign.gap.fitting.starts import resonances, starts
from beamdesign.prototype import Prototype

_QUICK = 3  # iterations that show whether a pair is worth fitting


@dataclass(frozen=True)
class Task:
    """One fit to be made.

    Attributes:
        hypothesis: to be fitted.
        known: SI values from a simpler fit.
        hints: SI values of what it lacks, from another.
        on: positions of the pieces of evidence for a quick look; empty for a fit to all of it.
    """

    hypothesis: Hypothesis
    known: dict[str, float]
    hints: dict[str, float] = field(default_factory=dict)
    on: tuple[int, ...] = ()


class Fitters:
    """Processes that make fits, or this one where one worker is enough."""

    def __init__(self, data: Dataset, workers: int, kept: KeptFits | None = None, in_step: bool = False):
        self.data, self.evidence = data, _evidence(data, in_step)
        # The same task to records that are followed is another fit.
        self._kept = replace(kept, part=(*kept.part, "in step")) if kept is not None and in_step else kept
        self._others = active_children()
        self._pool = ProcessPoolExecutor(workers, initializer=_begin, initargs=(data, in_step)) if workers > 1 else None

    def __enter__(self) -> "Fitters":
        return self

    def __exit__(self, *error: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=error[0] is None, cancel_futures=True)
        if error[0] is not None:  # whoever interrupts does not want to wait for the fits that are being made
            for child in active_children():
                if child not in self._others:
                    child.terminate()

    def __call__(self, tasks: Iterable[Task], told: Callable[[int], None] = lambda k: None) -> list[Fit]:
        """Fits in the order of the tasks."""
        given = list(tasks)
        results: dict[int, Fit] = {}
        for k, task in enumerate(given):
            if self._kept is not None and (before := self._kept.recall(task)) is not None:
                results[k] = before
        for k, found in self._made({k: task for k, task in enumerate(given) if k not in results}):
            results[k] = found
            if self._kept is not None:
                self._kept.keep(given[k], found)
            told(len(results))
        return [results[k] for k in range(len(given))]

    def _made(self, tasks: dict[int, Task]) -> Iterator[tuple[int, Fit]]:
        """Fits as they come, each with its position."""
        if self._pool is None:
            for k, task in tasks.items():
                yield k, fitted(task, self.data.prototype, self.evidence)
            return
        futures = {self._pool.submit(_fitted_here, task): k for k, task in tasks.items()}
        for future in as_completed(futures):
            yield futures[future], future.result()


_here: tuple[Prototype, tuple[Evidence, ...]] | None = None


def _begin(data: Dataset, in_step: bool) -> None:
    global _here
    signal(SIGINT, SIG_IGN)  # an interruption is for the process that began it
    _here = data.prototype, _evidence(data, in_step)


def _evidence(data: Dataset, in_step: bool) -> tuple[Evidence, ...]:
    return followed_evidence(data) if in_step else evidence_of(data)


def _fitted_here(task: Task) -> Fit:
    assert _here is not None
    return fitted(task, *_here)


def fitted(task: Task, prototype: Prototype, evidence: Sequence[Evidence]) -> Fit:
    """The best of fits from the most promising starts."""
    placement = task.hypothesis.placement(prototype)
    evidence = [evidence[k] for k in task.on] or evidence
    peaks = resonances(evidence, prototype, task.known) if not task.on else ()
    begun = starts(placement, task.known, evidence, peaks, 1 if task.on else 2, task.hints)
    if not begun:
        reason = "the model's loop is unstable wherever a fit was begun"
        return Fit(task.hypothesis, placement.unknowns, reason=reason)
    iterations = _QUICK if task.on else ITERATIONS
    return min((fit(task.hypothesis, placement, evidence, z, iterations) for z in begun), key=lambda f: f.cost)
