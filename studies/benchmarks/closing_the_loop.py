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
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from closing import Attempt, Closed, close_the_loop
from opened_cases import opened_case, opened_keys

from beamdesign import InputError
from beamdesign.validation.bounds import clopper_pearson

COLUMNS = (
    "case", "truth", "verdict", "tuned for", "safe", "bandwidth, Hz: proved", "true", "peak sensitivity: proved",
    "true", "gain factor to instability: model", "true", "promise kept",
)  # fmt: skip


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
