"""How far a sweep has got, from what its folder holds."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from beamdesign.study import store
from beamdesign.study.case import in_words
from beamdesign.study.code_digest import code_digest
from beamdesign.study.sampling import Plan
from beamdesign.study.sweep_file import task_of
from beamdesign.study.sweep_run import ADAPTIVE


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
    code = code_digest(task_of(laid.sweep).place)
    current = {record["address"]: record for record in everything.records if record["code_sha256"] == code}
    addresses, complete = list(cases), True
    if laid.sweep.study.method in ADAPTIVE:
        index = store.read_index(folder) if everything.records else {}
        asked = index.get("rows", [])
        addresses = [address for address in asked if address in current]
        complete = index.get("complete", False) and len(addresses) == len(asked)
    rows = [current[address] for address in addresses if address in current]
    refused = [one for address, one in cases.items() if one.problems and address not in current]
    remaining = len(addresses) - len(rows) - len(refused) if complete else None
    seconds = [record["seconds"] for record in rows]
    left = remaining * sum(seconds) / len(seconds) if remaining and seconds else None
    results = [(row["status"], row["reason"]) for row in rows] + [
        ("refused", in_words(one.problems)) for one in refused
    ]
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
