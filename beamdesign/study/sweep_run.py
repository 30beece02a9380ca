"""A sweep carried out: what is kept is read, the rest computed and kept at once, so that nothing is computed twice."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from beamdesign import records
from beamdesign.records import InputError, Problem
from beamdesign.study import store, workers
from beamdesign.study.case import Case
from beamdesign.study.sampling import case_at, points
from beamdesign.study.sweep_file import Sweep, read_sweep
from beamdesign.study.sweep_plan import Plan
from beamdesign.study.table import write_tables

Progress = Callable[[float, str], None]

ADAPTIVE = ("optimise", "worst_case")
"""Methods whose cases follow from the results of earlier ones."""


@dataclass
class Progression:
    """Evaluates cases: from the store where it has them, by workers otherwise; rows in the order of first asking.

    Attributes:
        folder: of the store.
        compute: the workers.
        told: progress.
        budget: how many rows there will be at most.
        again: whether rows that failed are computed again.
        records: of the rows so far, by address, in order.
        computed: how many were computed rather than read.
    """

    folder: Path
    compute: workers.Workers
    told: Progress
    budget: int
    again: bool = False
    records: dict[str, dict[str, Any]] = field(default_factory=dict)
    computed: int = 0

    def evaluate(self, cases: Sequence[Case]) -> list[dict[str, Any]]:
        """Records of cases, in their order."""
        missing: dict[str, Case] = {}
        for found in cases:
            if found.address in self.records or found.address in missing:
                continue
            record = store.kept(self.folder, found.address)
            if record is None or (self.again and record["status"] == "failed"):
                missing[found.address] = found
                continue
            # The same inputs may have been reached by other varied keys.
            self.records[found.address] = record | {"varied": found.varied}
        waiting = list(missing.values())
        self._tell()
        for place, record in self.compute(waiting) if waiting else ():
            store.keep(self.folder, record)
            self.records[waiting[place].address] = record
            self.computed += 1
            self._tell()
        for found in cases:  # finished in any order, they stand in that of asking
            self.records[found.address] = self.records.pop(found.address)
        return [self.records[found.address] for found in cases]

    def _tell(self) -> None:
        counts = Counter(record["status"] for record in self.records.values())
        words = ", ".join(f"{count} {status}" for status, count in counts.items() if status != "done")
        done = len(self.records)
        self.told(min(1.0, done / max(1, self.budget)), f"{done} of {self.budget}{': ' + words if words else ''}")


@dataclass(frozen=True)
class SweepRun:
    """What a run gave.

    Attributes:
        folder: with everything in it.
        records: one per row.
        computed: how many were computed in this run; the others were kept from earlier ones.
        complete: whether the sweep is finished; an interrupted one is not.
        tables: files of the table.
    """

    folder: Path
    records: tuple[dict[str, Any], ...]
    computed: int
    complete: bool
    tables: tuple[Path, ...]

    @property
    def counts(self) -> dict[str, int]:
        """Rows by status."""
        return dict(Counter(record["status"] for record in self.records))


def plan(path: Path, limit: int | None = None) -> Plan:
    """Read a sweep file and lay out its cases.

    Args:
        path: of the file.
        limit: no more cases than so many.

    Raises:
        InputError: for what is wrong with the file or its base; also where no case has a base that can be read.
    """
    sweep = read_sweep(path)
    base = records.read_table(path.parent / sweep.study.base)
    if sweep.study.method in ADAPTIVE or sweep.study.method in ("tolerance", "sensitivity"):
        from beamdesign.study.methods import laid_out

        cases, budget = laid_out(sweep, base, path, limit)
    else:
        cases = _cases(sweep, base, points(sweep, limit), path)
        budget = len(cases)
    return Plan(path, sweep, base, cases, budget, limit)


def _cases(sweep: Sweep, base: Mapping[str, Any], varied: Sequence[Mapping[str, Any]], path: Path) -> tuple[Case, ...]:
    try:
        found = tuple(case_at(sweep, base, values) for values in varied)
    except ValueError as error:
        raise InputError(path, [Problem("vary", str(error))]) from None
    return tuple({one.address: one for one in found}.values())


def default_folder(path: Path) -> Path:
    """Where the results of a sweep file go if nothing else is said: NAME.study in the current folder."""
    return Path(f"{path.stem}.study")


def run_sweep(
    laid: Plan, folder: Path, compute: workers.Workers = workers.here, told: Progress | None = None, again: bool = False
) -> SweepRun:
    """Carry out a sweep; what an interruption leaves is a folder from which the same call goes on.

    Args:
        laid: as planned.
        folder: of the results; made if need be.
        compute: where the cases are computed.
        told: progress.
        again: compute rows again that failed.

    Raises:
        KeyboardInterrupt: after the finished rows have been written.
    """
    progression = Progression(folder, compute, told or (lambda share, words: None), laid.budget, again)
    method = laid.sweep.study.method
    store.write_index(folder, laid.sweep.name, method, [one.address for one in laid.cases], False)
    complete = False
    try:
        if method in ADAPTIVE:
            from beamdesign.study.methods import adapt

            adapt(laid, progression.evaluate)
        else:
            progression.evaluate(laid.cases)
        complete = True
    finally:
        rows = progression.records
        order = [one.address for one in laid.cases] or list(rows)
        found = [rows[address] for address in order if address in rows]
        store.write_index(folder, laid.sweep.name, method, order, complete)
        tables = tuple(write_tables(folder, found))
    return SweepRun(folder, tuple(found), progression.computed, complete, tables)


def refused_alike(records_: Sequence[dict[str, Any]]) -> str:
    """The one reason for which every row was refused; empty where that is not so."""
    reasons = {record["reason"] for record in records_}
    alike = len(reasons) == 1 and all(record["status"] == "refused" for record in records_)
    return next(iter(reasons)) if alike else ""
