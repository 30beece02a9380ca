"""The blind check: cases with sealed answers are diagnosed from their data alone, then the answers are opened.

The folder of a check holds `plan.json`, `sets/` (the data, one folder per case), `answers/` (sealed), `sealed.json`,
`fits/`, `predictions/` and `found/` (what was diagnosed). Whatever is finished is not done again, so that a check that
was stopped in any way goes on by the same call; after a change of the judgement alone, fits are taken from the disk.
"""

import json
import os
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass
from multiprocessing import active_children, get_context
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from beamdesign.arguments import takes
from beamdesign.code_digest import code_digest, folder_digest
from beamdesign.files import write_whole
from beamdesign.progress import Progress, end_at_once, silent
from beamdesign.records import InputError
from beamdesign.result import picked
from beamdesign.validation import case_plan
from beamdesign.validation.blind_diagnosis import Place, begin_blind, diagnose_blind, program
from beamdesign.validation.case_plan import Planned, Seal
from beamdesign.validation.scoring import Outcome, outcome

if TYPE_CHECKING:
    from beamdesign.validation.blindcheck_result import Scored


@dataclass(frozen=True)
class Check:
    """A blind check and where it is kept.

    Attributes:
        folder: of everything that belongs to it.
        cases: planned.
        short: whether records are few and short.
        seed: of the plan.
    """

    folder: Path
    cases: tuple[Planned, ...]
    short: bool
    seed: int

    @property
    def answers(self) -> Path:
        """Folder of the answers."""
        return self.folder / "answers"

    @property
    def plan(self) -> Path:
        """File with what every case was to be."""
        return self.folder / "plan.json"

    @property
    def telling(self) -> tuple[str, ...]:
        """What tells an answer: closed to whoever diagnoses."""
        return str(self.answers), str(self.plan)

    @property
    def sets(self) -> Path:
        """Folder of the data sets."""
        return self.folder / "sets"

    @property
    def seal(self) -> Path:
        """File with the digests."""
        return self.folder / "sealed.json"

    @property
    def not_drawn(self) -> dict[str, str]:
        """Cases that could not be drawn, with the reason."""
        return {path.stem: path.read_text().strip() for path in sorted((self.folder / "not_drawn").glob("*.txt"))}

    def place(self, key: str) -> Place:
        """Where the files of one case are, for who diagnoses it."""
        found, predicted = self.folder / "found" / f"{key}.json", self.folder / "predictions" / f"{key}.npz"
        return Place(self.sets / key, found, predicted, self.folder / "fits" / key)


@takes()
def blindcheck(
    folder: Path | str,
    cases: int = 200,
    seed: int = 1,
    short: bool = False,
    workers: int = 2,
    progress: Progress = silent,
) -> "Scored":
    """Check the diagnosis blind, or go on with a check: draw cases, seal answers, diagnose, open, score.

    Args:
        folder: of the check; the result stands there as result.json, result.md and result.svg.
        cases: how many.
        seed: of the plan; another one gives other cases.
        short: whether records are few and short, instead of eight of 4 s each.
        workers: cases that are diagnosed at the same time.
        progress: told the share done of drawing, then of diagnosing.

    Raises:
        InputError: where the folder holds another check, or an answer is not what was sealed.
    """
    check = begin_check(Path(folder), cases, seed, short)
    draw_and_seal(check, workers, progress)
    diagnose_all(check, workers, progress)
    found = scored(check)
    if found.yes:  # else no case could be drawn
        found.write(check.folder)
    return found


def begin_check(folder: Path, count: int, seed: int, short: bool, cases: Sequence[Planned] | None = None) -> Check:
    """Plan a check, or take up the one that the folder holds.

    Args:
        folder: of the check.
        count: of cases.
        seed: of the plan.
        short: whether records are few and short.
        cases: instead of those that count and seed plan.

    Raises:
        InputError: where the folder holds another check.
    """
    planned = tuple(case_plan.plan(count, seed) if cases is None else cases)
    rows = [asdict(c) | {"names": list(c.names)} for c in planned]
    fields = {"seed": seed, "short": short, "cases": rows}
    check = Check(folder, planned, short, seed)
    if not check.plan.is_file():
        write_whole(check.plan, json.dumps(fields, indent=1) + "\n")
    elif json.loads(check.plan.read_text(encoding="utf-8")) != fields:
        raise InputError(check.plan, [("(plan)", "the folder holds another check; name another folder")])
    return check


def draw_and_seal(check: Check, workers: int = 2, progress: Progress = silent) -> Seal:
    """Draw all cases and seal their answers, unless that has been done.

    Raises:
        ValueError: where sealed.json is no seal.
        OSError: where something cannot be written.
    """
    if check.seal.is_file():
        return case_plan.read_seal(check.seal)
    jobs = {case.key: (case_plan.draw, case, check.short, check.sets, check.answers) for case in check.cases}
    for key, reason in _done(jobs, _processes(min(workers, len(jobs))), progress, "drawing cases"):
        if reason:
            write_whole(check.folder / "not_drawn" / f"{key}.txt", reason + "\n")
    answers = read_answers(check.answers)
    digests = {key: folder_digest(check.sets / key) for key in answers}
    seal = case_plan.sealed(answers, digests, code_digest(case_plan.__name__))
    case_plan.write_seal(seal, check.seal)
    return seal


def diagnose_all(check: Check, workers: int = 2, progress: Progress = silent, rejudge: bool = False) -> None:
    """Diagnose all sealed cases, each from its data alone, in processes that have never had an answer.

    Each process keeps what it has compiled for the next case.

    Args:
        check: drawn and sealed.
        workers: processes.
        progress: told the share done.
        rejudge: whether fits of an earlier program count.
    """
    now = program()
    jobs = {key: (diagnose_blind, check.place(key), now, rejudge) for key in case_plan.read_seal(check.seal).sets}
    pool = _processes(min(workers, len(jobs)), begin_blind, (check.telling,))
    for _ in _done(jobs, pool, progress, "diagnosing"):
        pass


def open_all(check: Check, unfinished: bool = False) -> tuple[Outcome, ...]:
    """Open the answers of a check that has been diagnosed, and put them beside what was said.

    Args:
        check: diagnosed.
        unfinished: whether cases that have not been diagnosed may be left out; their answers stay closed.

    Raises:
        InputError: where an answer or a data set is not what was sealed, or a case has not been diagnosed.
    """
    seal = case_plan.read_seal(check.seal)
    missing = {key for key in seal.answers if not check.place(key).result.is_file()}
    closed = missing if unfinished else set[str]()
    answers = read_answers(check.answers, closed)
    changed = (key for key in case_plan.broken(seal, answers) if key not in closed)
    problems = [(key, "the answer is not the one that was sealed") for key in changed]
    answered = []
    for key in (key for key in seal.answers if key not in closed):
        if key in missing:
            problems.append((key, "not diagnosed"))
            continue
        found = json.loads(check.place(key).result.read_text(encoding="utf-8"))
        if found["set_sha256"] != seal.sets[key]:
            problems.append((key, "what was diagnosed are not the data that were sealed"))
        elif key in answers:
            answered.append((key, answers[key], found, _squares(check, key, answers[key], found, problems)))
    if problems:
        raise InputError(check.seal, problems)
    return tuple(outcome(*case) for case in answered)


def scored(check: Check, unfinished: bool = False) -> "Scored":
    """Open the answers of a check and score them; see `open_all`."""
    from beamdesign.validation.blindcheck_result import Scored  # which draws

    seal, answered = case_plan.read_seal(check.seal), open_all(check, unfinished)
    made = [json.loads(check.place(case.key).result.read_text(encoding="utf-8")) for case in answered]
    length = "short" if check.short else "full"
    setting = {
        "records": "Five records of 1.75 s each." if check.short else "Eight records of 4 s each.",
        "planned": len(check.cases),
        "scored": len(answered),
        **picked(check, "seed short"),
        **picked(seal, "seal=whole truth"),
        "fitted_by": _all(found.get(key) for found in made for key in ("fitted_by", "added_by")),
        "judged_by": _all(found.get("judged_by") for found in made),
        "not_drawn": check.not_drawn,
        "command": f"beamdesign gap blindcheck --cases {len(check.cases)} --seed {check.seed} --{length}",
    }
    return Scored(answered, setting)


def _all(digests: Iterable[Any]) -> str:
    """One digest, or several where a check was made by several versions of the program."""
    return ", ".join(sorted({str(digest) for digest in digests if digest}))


def read_answers(folder: Path, closed: Collection[str] = ()) -> dict[str, dict[str, Any]]:
    """All answers by case, but for those that stay closed."""
    paths = (path for path in sorted(folder.glob("*.json")) if path.stem not in closed)
    return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in paths}


def _squares(
    check: Check, key: str, answer: dict[str, Any], found: dict[str, Any], problems: list[tuple[str, str]]
) -> dict[str, float]:
    """See `squares`; none where there is nothing to compare."""
    truth = check.answers / f"{key}.npz"
    if "diagnosis" not in found or "displacements_sha256" not in answer:
        return {}
    with np.load(truth, allow_pickle=False) as held:
        records = dict(held)
    if case_plan.displacements_digest(records) != answer["displacements_sha256"]:
        problems.append((key, "the noise-free records are not those that were sealed"))
        return {}
    with np.load(check.place(key).predictions, allow_pickle=False) as held:
        return squares(records, dict(held))


def squares(truth: dict[str, np.ndarray], predicted: dict[str, np.ndarray]) -> dict[str, float]:
    """Mean squares of errors against noise-free displacements, each record over its own power, by who predicted.

    Args:
        truth: by record.
        predicted: as `RECORD/before`, `RECORD/tuned` and `RECORD/after`; where a loop diverges it counts as an error of
            the whole.
    """
    found: dict[str, list[float]] = {}
    for key, signal in predicted.items():
        name, _, word = key.rpartition("/")
        exact, given = truth[name].astype(float), signal.astype(float)
        error = exact - given if np.all(np.isfinite(given)) else exact
        found.setdefault(word, []).append(float(np.mean(error**2) / np.var(exact)))
    return {word: float(np.mean(each)) for word, each in found.items()}


@contextmanager
def _processes(
    workers: int, begin: Callable[..., None] | None = None, given: tuple[Any, ...] = ()
) -> Iterator[ProcessPoolExecutor]:
    """New processes that have nothing from this one but what they are given; ended at once when it is interrupted."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # one process per core is enough
        os.environ.setdefault(name, "1")
    others = active_children()
    pool = ProcessPoolExecutor(max(1, workers), get_context("spawn"), begin, given)
    try:
        yield pool
    except BaseException:
        end_at_once(pool, others)
        raise
    pool.shutdown()


def _done(
    jobs: Mapping[str, tuple[Any, ...]],
    processes: AbstractContextManager[ProcessPoolExecutor],
    progress: Progress,
    words: str,
) -> Iterator[tuple[str, Any]]:
    """The key and what came of each job (a function and what it is given), as they get done."""
    with processes as pool:
        with _no_script():
            keys = {pool.submit(*job): key for key, job in jobs.items()}
        for done, future in enumerate(as_completed(keys), 1):
            yield keys[future], future.result()
            progress(done / len(keys), words)


@contextmanager
def _no_script() -> Iterator[None]:
    """Processes begun meanwhile do not run the script that began them: it may know the truth model, or begin more."""
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script
