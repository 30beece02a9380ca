"""Fits made by this process or by several, and those kept that were made before."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from functools import partial
from multiprocessing import active_children

import numpy as np

from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.fitting.evidence import evidence_of
from beamdesign.diagnosis.fitting.fit import Evidence, Fit
from beamdesign.diagnosis.fitting.fit_cache import FitCache, Task
from beamdesign.diagnosis.fitting.hypothesis import NOTHING
from beamdesign.diagnosis.fitting.starts import fit_from_starts, resonances
from beamdesign.plant.effects import library
from beamdesign.plant.empirical import laws
from beamdesign.progress import end_at_once, help_another
from beamdesign.prototype import Prototype
from beamdesign.time_limit import TimeUp, heed, leave_out, left_for_steps

RESONANT = {name for name, law in library().items() if any(q.name == "frequency_Hz" for q in law.parameters)}
"""Laws that resonate."""
_LEARNT = {law.name for law in laws()}
_QUICK = 3  # iterations that show whether a pair is worth fitting


class Fitters:
    """Processes that make fits, or this one where one worker is enough.

    Attributes:
        data: to be fitted.
        evidence: of them.
        late: tasks that there was no time for; those still there at the end are said to be left out.
    """

    def __init__(self, data: Dataset, workers: int, kept: FitCache | None = None, synchronised: bool = False):
        self.data, self.evidence = data, evidence_of(data, synchronised)
        self.late: list[Task] = []
        # The same task to records that are followed is another fit. Unknowns are those of the prototype that is fitted.
        part = ("in step",) if synchronised else ()
        self._kept = kept and replace(kept, prototype=data.prototype, part=(*kept.part, *part))
        self._others = active_children()
        self._begun = partial(ProcessPoolExecutor, workers, initializer=_begin, initargs=(data, synchronised))
        self._pool = self._begun() if workers > 1 else None

    def __enter__(self) -> "Fitters":
        return self

    def __exit__(self, *error: object) -> None:
        leave_out(*(str(task.hypothesis) for task in self.late))
        self._close(at_once=error[0] is not None)

    def _close(self, at_once: bool) -> None:
        """End the processes; at once where nobody wants to wait for the fits that are being made."""
        if self._pool is not None and at_once:
            end_at_once(self._pool, self._others)
        elif self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def __call__(self, tasks: Iterable[Task], progress: Callable[[int], None] = lambda k: None) -> list[Fit]:
        """Fits in the order of the tasks; where the time is up in the midst of them, those that are finished."""
        given = list(tasks)
        results = self._results(given, progress)
        self.late += [task for k, task in enumerate(given) if k not in results]
        return [results[k] for k in range(len(given)) if k in results]

    def finished(self, tasks: Sequence[Task]) -> list[Fit]:
        """Fits that are finished in time, with no word on the others."""
        return list(self._results(tasks).values())

    def each(self, *tasks: Task) -> list[Fit]:
        """Fits in the order of the tasks, all of them.

        Raises:
            TimeUp: where the time is up in the midst of them.
        """
        results = self._results(tasks)
        if len(results) < len(tasks):
            raise TimeUp
        return [results[k] for k in range(len(tasks))]

    def _results(self, given: Sequence[Task], progress: Callable[[int], None] = lambda k: None) -> dict[int, Fit]:
        """Fits by the positions of their tasks."""
        results: dict[int, Fit] = {}
        for k, task in enumerate(given):
            if self._kept is not None and (before := self._kept.recall(task)) is not None:
                results[k] = before
        try:
            for k, found in self._made({k: task for k, task in enumerate(given) if k not in results}):
                results[k] = found
                if self._kept is not None:
                    self._kept.keep(given[k], found)
                progress(len(results))
        except (TimeUp, TimeoutError):
            self._close(at_once=True)
            self._pool = self._pool and self._begun()
        return results

    def _made(self, tasks: dict[int, Task]) -> Iterator[tuple[int, Fit]]:
        """Fits as they come, each with its position."""
        if self._pool is None:
            for k, task in tasks.items():
                heed()
                yield k, fitted(task, self.data.prototype, self.evidence)
            return
        if tasks:
            heed()
        futures = {self._pool.submit(_fitted_here, task): k for k, task in tasks.items()}
        timeout = left_for_steps()
        for future in as_completed(futures, timeout if timeout < np.inf else None):
            yield futures[future], future.result()


_here: tuple[Prototype, tuple[Evidence, ...]] | None = None


def _begin(data: Dataset, synchronised: bool) -> None:
    global _here
    help_another()
    _here = data.prototype, evidence_of(data, synchronised)


def _fitted_here(task: Task) -> Fit:
    assert _here is not None
    return fitted(task, *_here)


def fitted(task: Task, prototype: Prototype, evidence: Sequence[Evidence]) -> Fit:
    """The best of fits from the most promising starts."""
    some = [evidence[k] for k in task.on] or evidence
    # Where no fit has found yet what resonates, a few iterations do not come to a narrow resonance.
    if task.quick and not RESONANT & _LEARNT & {*task.hypothesis.effects}:
        return fit_from_starts(task.hypothesis, prototype, some, task.known, (), 1, task.hints, _QUICK, bool(task.on))
    peaks = resonances(some, prototype, task.known, task.hypothesis)
    return fit_from_starts(task.hypothesis, prototype, some, task.known, peaks, hints=task.hints)


def refit(
    data: Dataset, best: Fit, workers: int = 1, kept: FitCache | None = None, synchronised: bool = False
) -> tuple[Fit, Fit]:
    """Tolerances alone, and the hypothesis of a fit, fitted again to fewer data.

    Args:
        data: what is left of those that the fit was made to.
        best: the fit; another one begins with its figures, so that it ends at the same optimum where there are several.
        workers: processes.
        kept: fits of an earlier run.
        synchronised: whether models follow the records.

    Raises:
        TimeUp: where steps are to be broken off, and the time is up.
    """
    # The same task to fewer data is another fit, and must not be taken from those to all of them.
    if kept is not None:
        kept = replace(kept, part=(*kept.part, *(piece.name for piece in evidence_of(data))))
    with Fitters(data, workers, kept, synchronised) as fitters:
        (null,) = fitters.each(Task(NOTHING, {}))
        if best.hypothesis == NOTHING:
            return null, null
        begun = fitters.each(Task(best.hypothesis, null.values), Task(best.hypothesis, best.values))
        return null, min(begun, key=lambda f: f.cost)
