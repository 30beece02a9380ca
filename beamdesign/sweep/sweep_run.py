"""A sweep carried out, and its table: what is kept is read, the rest computed and kept at once, nothing twice.

Everything that can be checked is checked before anything is written; the table and what goes with it change together.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from beamdesign import records
from beamdesign.code_digest import code_digest
from beamdesign.columns import csv_text
from beamdesign.files import fresh_folder, refuse_irreplaceable, settled, write_whole
from beamdesign.progress import Progress, silent
from beamdesign.records import InputError, Problem
from beamdesign.result import Result, finite, json_text, picked
from beamdesign.sweep import store, workers
from beamdesign.sweep.case import TASKS, Case, in_words
from beamdesign.sweep.methods import ADAPTIVE, Plan, laid_out, reached
from beamdesign.sweep.sweep_file import Sweep, read_sweep

Draw = Callable[[Sweep, Sequence[dict[str, Any]], Mapping[str, Any], Path], list[Path]]
"""Draws the pictures of a finished sweep from its rows and its conclusion into a folder; gives the files."""

CONCLUSION = "conclusion.json"

_SET = (store.INDEX, "table.*", "sensitivity.*", CONCLUSION, "picture.*", "picture_[0-9]*.*")
"""Files that a run writes together, so that they are of one sweep."""


@dataclass(repr=False)
class SweepRun(Result):
    """A sweep carried out: cases come from the store where it has them, from workers otherwise.

    Attributes:
        laid: the sweep as planned.
        folder: with everything in it.
        compute: the workers.
        progress: called with the share done and what is being done.
        again: whether rows that failed are computed again.
        found: records so far by address, in the order of first asking.
        counts: of these by status.
        computed: how many were computed rather than kept from earlier runs.
        unsound: kept results that did not hold, and were computed again.
        records: one per row, when they have been written; so are the others below.
        tables: files of the table.
        files: all files of the set, the index left out.
        conclusion: what the rows come to; of an interrupted run nothing.
    """

    laid: Plan
    folder: Path
    compute: workers.Workers
    progress: Progress
    again: bool = False
    found: dict[str, dict[str, Any]] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    computed: int = 0
    unsound: list[InputError] = field(default_factory=list)
    records: list[dict[str, Any]] = field(default_factory=list)
    tables: list[Path] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)
    conclusion: dict[str, Any] = field(default_factory=dict)

    @property
    def yes(self) -> bool:
        """Whether any case has a result."""
        return bool(self.counts.get("done"))

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as `study run --json` writes them; the rows stand in the files of the table."""
        unsound = store.in_words(self.unsound, "computed again")
        own = {"name": self.laid.sweep.name, "cases": len(self.records), "unsound": unsound}
        return finite(own | picked(self, "counts computed folder tables files conclusion"))

    def rows(self) -> list[tuple[Any, ...]]:
        """The cases: what was varied, how each came out, and its outputs."""
        return [tuple(row.values()) for row in rows(self.records)]

    def __repr__(self) -> str:
        counts = ", ".join(f"{count} {status}" for status, count in self.counts.items())
        return f"<{type(self).__name__}: {self.laid.sweep.name}; {counts}>"

    def evaluate(self, cases: Sequence[Case]) -> list[dict[str, Any]]:
        """Records of cases, in their order.

        Raises:
            InputError: where none of the cases so far has inputs that are accepted; nothing is written then.
        """
        if not self.found and all(one.problems for one in cases):
            # Of the sweep's file where that says what is refused, of the base otherwise.
            reasons, path = _first(problem for one in cases for problem in one.problems), self.laid.path
            own = {"options", *(key for one in cases for key in one.varied)}
            said_here = any(key in own or key.startswith("options.") for key, _ in reasons)
            raise InputError(path if said_here else path.parent / self.laid.sweep.study.base, reasons)
        missing: dict[str, Case] = {}
        for one in cases:
            if one.address in self.found or one.address in missing:
                continue
            try:
                record = store.kept(self.folder, one.address, one)
            except InputError as error:
                if not Path(error.source).is_file():  # a folder or a pipe, which no result can replace
                    raise
                self.unsound.append(error)
                record = None
            if record is None or (self.again and record["status"] == "failed"):
                missing[one.address] = one
                continue
            # The same inputs may have been reached by other varied keys.
            self._have(one, record | {"varied": one.varied})
        waiting = list(missing.values())
        self._tell()
        for place, record in self.compute(waiting) if waiting else ():
            store.keep(self.folder, record)
            self.computed += 1
            self._have(waiting[place], record)
            self._tell()
        for one in cases:  # finished in any order, they stand in that of asking
            self.found[one.address] = self.found.pop(one.address)
        return [self.found[one.address] for one in cases]

    def _have(self, one: Case, record: dict[str, Any]) -> None:
        self.found[one.address] = record
        self.counts[record["status"]] += 1

    def _tell(self) -> None:
        words = ", ".join(f"{count} {status}" for status, count in self.counts.items() if status != "done")
        done, budget = len(self.found), self.laid.budget
        self.progress(min(1.0, done / max(1, budget)), f"{done} of {budget}{': ' + words if words else ''}")

    def write(self, complete: bool, draw: Draw | None) -> None:
        """Write the set of files of a run, in place of that of an earlier one."""
        from beamdesign.sweep.conclusion import conclude  # which draws as well: no reason to wait for that

        laid = self.laid
        order = [one.address for one in laid.cases] or list(self.found)
        self.records = [self.found[address] for address in order if address in self.found]
        self.counts = Counter(record["status"] for record in self.records)
        self.conclusion = conclude(laid, self.records) if complete else {}
        with fresh_folder(self.folder, _SET) as fresh:
            store.write_index(fresh, laid.sweep.name, laid.sweep.study.method, order, complete)
            tables = write_columns(fresh, rows(self.records, order), "table")
            files = list(tables)
            if "sensitivity" in self.conclusion:
                files += write_columns(fresh, self.conclusion["sensitivity"], "sensitivity")
            if draw is not None:
                files += draw(laid.sweep, self.records, self.conclusion, fresh)
            if self.conclusion:
                files.append(fresh / CONCLUSION)
                write_whole(files[-1], json_text(self.conclusion))
        self.tables, self.files = settled(tables, fresh, self.folder), settled(files, fresh, self.folder)


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
    return Plan(path, sweep, base, *laid_out(sweep, base, path, limit), limit)


def run_sweep(
    laid: Plan,
    folder: Path,
    compute: workers.Workers = workers.here,
    progress: Progress | None = None,
    again: bool = False,
    draw: Draw | None = None,
) -> SweepRun:
    """Carry out a sweep; what an interruption leaves is a folder from which the same call goes on.

    Args:
        laid: as planned.
        folder: of the results; made if need be.
        compute: where the cases are computed.
        progress: called with the share done and what is being done.
        again: compute rows again that failed.
        draw: the pictures; none are drawn without.

    Raises:
        InputError: where every case is refused, or results that are there cannot be read; the table, if there is one,
            stays that of the earlier run.
        KeyboardInterrupt: after the finished rows have been written.
    """
    store.addresses(folder)
    for path in (found for pattern in _SET for found in folder.glob(pattern)):
        refuse_irreplaceable(path)
    run = SweepRun(laid, folder, compute, progress or silent, again)
    try:
        if (adapt := ADAPTIVE.get(laid.sweep.study.method)) is not None:
            adapt(laid, run.evaluate)
        else:
            run.evaluate(laid.cases)
    except KeyboardInterrupt:
        if run.found:
            run.write(False, None)
        raise
    if set(run.counts) == {"refused"}:
        reasons = dict.fromkeys(row["reason"] for row in run.found.values())
        raise InputError(laid.path, _first(Problem(*reason.split(": ", 1)) for reason in reasons))
    run.write(True, draw)
    return run


_SHOWN = 5


def _first(problems: Iterable[Problem]) -> list[Problem]:
    """The first few of some problems, each once, and how many more there are."""
    each = list(dict.fromkeys(problems))
    more = [Problem("further", f"{len(each) - _SHOWN} reasons of the same cases")] if len(each) > _SHOWN else []
    return each[:_SHOWN] + more


@dataclass(frozen=True)
class SweepStatus:
    """Where a sweep stands.

    Attributes:
        counts: finished rows by status.
        remaining: rows to go; None where the method finds its cases as it goes and is not through.
        seconds_left: computing time of those, from the mean of the finished ones; None where that is not known.
        reasons: status, reason and number of the rows without a result, the most frequent first.
        stale: results in the folder of another version of the code.
        foreign: results of this version that are no rows of this sweep.
        unsound: words on results that do not hold; they are not used.
        impossible: whether no case of the sweep has inputs that are accepted.
    """

    counts: dict[str, int]
    remaining: int | None
    seconds_left: float | None
    reasons: tuple[tuple[str, str, int], ...]
    stale: int
    foreign: int
    unsound: tuple[str, ...]
    impossible: bool


def sweep_status(laid: Plan, folder: Path) -> SweepStatus:
    """Compare a plan with what is kept in a folder, which need not exist.

    Cases whose inputs are known to be refused count as finished.

    Raises:
        InputError: where what is in the folder cannot be read.
    """
    cases = {one.address: one for one in laid.cases}
    everything = store.gathered(folder, store.addresses(folder), cases)
    code = code_digest(TASKS[laid.sweep.study.task].place)
    current = {record["address"]: record for record in everything.records if record["code_sha256"] == code}
    addresses, complete = list(cases), True
    if laid.sweep.study.method in ADAPTIVE:
        addresses, complete = reached(laid, current)
    rows = [current[address] for address in addresses if address in current]
    refused = [one for address, one in cases.items() if one.problems and address not in current]
    remaining = len(addresses) - len(rows) - len(refused) if complete else None
    seconds = [record["seconds"] for record in rows]
    left = remaining * sum(seconds) / len(seconds) if remaining and seconds else None
    results = [(row["status"], row["reason"]) for row in rows]
    results += [("refused", in_words(one.problems)) for one in refused]
    amiss = Counter(result for result in results if result[0] != "done")
    return SweepStatus(
        dict(Counter(status for status, _ in results)),
        remaining,
        left,
        tuple((status, reason, count) for (status, reason), count in amiss.most_common()),
        len(everything.records) - len(current),
        len(set(current) - set(addresses)),
        tuple(store.in_words(everything.unsound)),
        bool(cases) and all(one.problems for one in cases.values()),
    )


def finished(laid: Plan, folder: Path) -> int:
    """How many cases of a sweep have a file in a folder; none is opened."""
    there = store.addresses(folder)
    rows = {one.address for one in laid.cases} or set(store.read_index(folder)["rows"] if there else ())
    return len(rows.intersection(there))


_DIGITS = 12  # of an address that people are shown


def rows(records: Sequence[dict[str, Any]], order: Sequence[str] = ()) -> list[dict[str, Any]]:
    """Flat rows: number and address, the varied keys, status, outputs, reason; every row has every column.

    Numbers are those of places in `order`, addresses of which some may be without a record, or else consecutive.
    """
    varied = list(dict.fromkeys(key for record in records for key in record["varied"]))
    outputs = list(dict.fromkeys(key for record in records for key in record["outputs"]))
    there, found = {record["address"] for record in records}, []
    numbers = [place for place, address in enumerate(order) if address in there] if order else range(len(records))
    for number, record in zip(numbers, records, strict=True):
        row: dict[str, Any] = {"case": number, "address": record["address"][:_DIGITS]}
        row |= {key: cell(record["varied"].get(key)) for key in varied}
        row["status"] = record["status"]
        # An output may bear the name of a varied key, such as a breadth that was asked for.
        row |= {key: cell(record["outputs"].get(key)) for key in outputs if key not in row}
        row["reason"] = record["reason"]
        found.append(row)
    return found


def cell(value: Any) -> Any:
    """A value as a cell: lists and tables become text."""
    if isinstance(value, list):
        return "; ".join(f"{item:.10g}" if isinstance(item, float) else str(item) for item in value)
    if isinstance(value, dict):
        return ", ".join(f"{key} = {item}" for key, item in value.items())
    return value


def write_columns(folder: Path, table: Sequence[dict[str, Any]], name: str) -> list[Path]:
    """Write flat rows as NAME.csv, and as NAME.parquet where pyarrow is installed; a cell that a row lacks is empty."""
    paths = [folder / f"{name}.csv"]
    write_whole(paths[0], csv_text(table, "\n") if table else "case\n")
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ModuleNotFoundError:
        return paths
    paths.append(folder / f"{name}.parquet")
    columns = dict.fromkeys(column for row in table for column in row)
    arrays = {column: _column([row.get(column) for row in table]) for column in columns}
    content = pa.BufferOutputStream()
    parquet.write_table(pa.table(arrays), content)
    write_whole(paths[1], content.getvalue().to_pybytes())
    return paths


def _column(values: list[Any]) -> Any:
    """One type per column: whole numbers beside others become floats, and anything beside text becomes text."""
    import pyarrow as pa

    kinds = {type(value) for value in values if value is not None}
    wider: type = float if kinds == {int, float} else str
    if len(kinds) > 1:
        values = [None if value is None else wider(value) for value in values]
    return pa.array(values)


def chosen(columns: Sequence[str], asked: str) -> list[str]:
    """Columns that are asked for, by their names or parts of them, in the order of asking.

    Raises:
        InputError: for a name that no column has.
    """
    found: list[str] = []
    wrong = []
    for part in (text.strip() for text in asked.split(",")):
        named = [part] if part in columns else [column for column in columns if part and part in column]
        if not named:
            wrong.append((part, f"no such column; there are {', '.join(columns)}"))
        found += [column for column in named if column not in found]
    if wrong:
        raise InputError("--columns", wrong)
    return found


def worth_showing(table: Sequence[dict[str, Any]]) -> list[str]:
    """Columns for a terminal: number, what varies, outputs that differ; not the address, no constants."""
    names = [name for name in table[0] if name not in ("case", "address")]
    if len(table) == 1:
        names = [name for name in names if table[0][name] not in (None, "")]
    else:
        names = [name for name in names if len({str(row[name]) for row in table}) > 1]
    return ["case", *sorted(names, key=lambda name: name == "reason")]  # which stands last


def ordered(table: Sequence[dict[str, Any]], sort: str | None) -> list[dict[str, Any]]:
    """Rows sorted by a column, those without a value last; -NAME turns the order round.

    Raises:
        InputError: for a column that is not there.
    """
    if sort is None:
        return list(table)
    (name,) = chosen(list(table[0]), sort.removeprefix("-"))[:1]
    having = [row for row in table if row[name] is not None]
    numeric = all(isinstance(row[name], int | float) for row in having)
    having.sort(key=lambda row: row[name] if numeric else str(row[name]), reverse=sort.startswith("-"))
    return [*having, *(row for row in table if row[name] is None)]
