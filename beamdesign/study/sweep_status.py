"""How far a sweep has got, from what its folder holds."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from beamdesign.records import InputError
from beamdesign.study import store
from beamdesign.study.code_digest import code_digest
from beamdesign.study.sweep_file import task_of
from beamdesign.study.sweep_plan import Plan
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
    """

    counts: dict[str, int]
    remaining: int | None
    seconds_left: float | None
    reasons: tuple[tuple[str, str, int], ...]
    stale: int
    foreign: int


def sweep_status(laid: Plan, folder: Path) -> SweepStatus:
    """Compare a plan with what is kept in a folder, which need not exist."""
    everything = store.all_kept(folder)
    code = code_digest(task_of(laid.sweep).module)
    addresses = [one.address for one in laid.cases]
    complete = True
    if laid.sweep.study.method in ADAPTIVE:
        try:
            index = store.read_index(folder)
        except InputError:
            index = {"rows": [], "complete": False}
        current = {record["address"] for record in everything if record["code_sha256"] == code}
        addresses = [address for address in index["rows"] if address in current]
        complete = index["complete"] and len(addresses) == len(index["rows"])
    planned = set(addresses)
    rows = [record for record in everything if record["address"] in planned]
    remaining = len(planned) - len(rows) if complete else None
    seconds = [record["seconds"] for record in rows]
    left = remaining * sum(seconds) / len(seconds) if remaining and seconds else None
    amiss = Counter((row["status"], row["reason"]) for row in rows if row["status"] != "done")
    stale = sum(record["code_sha256"] != code for record in everything)
    return SweepStatus(
        dict(Counter(record["status"] for record in rows)),
        remaining,
        left,
        tuple((status, reason, count) for (status, reason), count in amiss.most_common()),
        stale,
        len(everything) - stale - len(rows),
    )
