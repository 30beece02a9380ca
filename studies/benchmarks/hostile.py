"""Mutated inputs thrown at every command, and kills while results are written: what the program makes of them.

Each mutant runs as `python -m beamdesign` in a folder of its own, within 20 s and 4 GB; `hostile_inputs.py` says what
is a fault. Each kill is a SIGKILL of `run`, `spec`, `code`, `gap diagnose` or `study run` into a folder that holds the
result of another input, half of them at any time and half at a change of the folder: its files have to be all of the
older result or all of the new one, and those of the same command given once more the bytes of an undisturbed run.
Usage, from the root of the project:

    python studies/benchmarks/hostile.py [--mutants 3000] [--kills 60] [--seed 1] [--workers 2] [--out FILE]
    python studies/benchmarks/hostile.py --only SEED [SEED ...]

Exit status 1 if there is any fault.
"""

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from hostile_inputs import (
    COMMANDS,
    ENOUGH,
    ENVIRONMENT,
    Command,
    ask,
    begun_in_a_fork,
    faults,
    laid_out,
    make,
    mutant,
    tree,
)  # fmt: skip

STATUSES = ("0", "1", "2", "taken", "other", "faults")
"""Columns of the table; `taken` are inputs that were examined and then worked on, which is ended."""


@dataclass
class Met:
    """What a mutant or a kill came to."""

    kind: str
    label: str
    status: str
    seconds: float
    faults: list[str]
    said: str = ""


def met(stock: Path, scratch: Path, seed: int) -> Met:
    """Run the mutant of a seed in a folder that is removed afterwards."""
    folder = scratch / str(seed)
    made = mutant(seed, folder, stock)
    before = tree(folder)
    answer = ask(made)
    found = faults(made, answer, before)
    _remove(folder)
    status = "taken" if answer.status == ENOUGH else str(answer.status)
    last = (answer.err.strip() or answer.out.strip()).splitlines()[-1:]
    return Met(made.kind, str(made), status, answer.seconds, found, "".join(last)[:300])


def as_shipped(stock: Path, scratch: Path, command: Command) -> str:
    """What is wrong with a command's answer to its inputs as they are shipped: its mutants would show nothing."""
    made = laid_out(command, scratch / f"shipped_{COMMANDS.index(command)}", stock)
    before = tree(made.folder)
    answer = ask(made)
    found = faults(made, answer, before) + (["refused"] if answer.status == 2 else [])
    _remove(made.folder)
    return f"as shipped: {command.line}: {'; '.join(found)}: {answer.err.strip()[-200:]}" if found else ""


@dataclass
class Killed:
    """A command that writes a set of files, given another input than the one whose results its folder holds."""

    older: str
    newer: str
    apart: tuple[str, ...] = ()
    """Folders of the results that are kept from run to run, file by file."""
    folder: str = "out"
    results: dict[str, dict[str, str]] = field(default_factory=dict)
    changes: int = 0
    seconds: float = 0.0


OTHERS = {
    "made/lighter.toml": ("studies/prototype.toml", "", "tip_force_N = 2000.0", "tip_force_N = 1000.0"),
    "made/gains": ("studies/gaps/paper_gains", "dataset.toml", "relative_std = 0.05", "relative_std = 0.1"),
}
"""Inputs that differ in one thing from shipped ones: by their place, what is shipped, the file, and the difference."""
KILLED = {
    "run": Killed("run made/lighter.toml --out out", "run studies/prototype.toml --out out"),
    "spec": Killed(
        "spec studies/prototypes/tame_lag.toml --load-N 500 --out out",
        "spec studies/prototypes/tame_lag.toml --load-N 700 --out out",
    ),
    "code": Killed(
        "code studies/prototypes/tame_lag.toml --rate-Hz 10000 --out out",
        "code studies/prototypes/tame_lag.toml --rate-Hz 5000 --out out",
    ),
    "gap diagnose": Killed(
        "gap diagnose made/gains --workers 1 --out out",
        "gap diagnose studies/gaps/paper_gains --workers 1 --out out",
        ("fits",),
    ),
    "study run": Killed(
        "study run studies/sweeps/lag_breaks.toml --cases 4 --out out",
        "study run studies/sweeps/lag_breaks.toml --cases 6 --out out",
        ("cases",),
    ),
}


def results(folder: Path, apart: Iterable[str]) -> dict[str, str]:
    """Digests of the files that a finished run leaves; without leftovers of killed ones, which have a leading dot."""
    return {
        name: digest
        for name, digest in tree(folder).items()
        if not any(part in apart or part.startswith(".") for part in Path(name).parts)
    }


class Forked:
    """A command in a quick fork, to be waited for and killed as one in a process of its own."""

    def __init__(self, line: str, work: Path) -> None:
        said = work / ".said"
        said.unlink(missing_ok=True)
        self._process = begun_in_a_fork(line.split(), work, (said, said), {"PYTHONIOENCODING": "utf-8"})
        self.pid = self._process.pid or 0
        while self.poll() is None and not said.exists():  # until then it is not yet in a group of its own
            time.sleep(0.001)

    def poll(self) -> int | None:
        """Exit status, negative of a signal; None while it runs."""
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        """Exit status once it has ended.

        Raises:
            subprocess.TimeoutExpired: where it has not within so many seconds.
        """
        self._process.join(timeout)
        if self._process.exitcode is None:
            raise subprocess.TimeoutExpired(".", timeout or 0.0)
        return self._process.exitcode


def prepare(stock: Path, forked: bool = False) -> None:
    """Make the older results and those of an undisturbed run, and count the changes that its folder goes through."""
    for target, (source, file, old, new) in OTHERS.items():
        (shutil.copytree if file else shutil.copyfile)(stock / source, stock / target)
        changed = stock / target / file
        changed.write_text(changed.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    for name, kill in KILLED.items():
        work = stock / "kills" / name.replace(" ", "_")
        work.mkdir(parents=True)
        for folder in ("studies", "made"):
            (work / folder).symlink_to(stock / folder)
        _finished(kill.older, work, forked)
        kill.results["older"] = results(work / kill.folder, kill.apart)
        shutil.copytree(work / kill.folder, work / "older")
        begun = time.monotonic()
        kill.changes = _watched(_begun(kill.newer, work, forked), work)
        kill.seconds = time.monotonic() - begun
        kill.results["newer"] = results(work / kill.folder, kill.apart)
        assert kill.results["newer"] != kill.results["older"]


def killed(stock: Path, scratch: Path, seed: int, forked: bool = False) -> Met:
    """Kill one command at a moment that the seed decides, judge its folder, and run it once more."""
    dice = random.Random(seed)
    name = list(KILLED)[seed % len(KILLED)]
    kill, prepared = KILLED[name], stock / "kills" / name.replace(" ", "_")
    work = scratch / f"kill_{seed}"
    shutil.copytree(prepared / "older", work / kill.folder)
    for folder in ("studies", "made"):
        (work / folder).symlink_to(stock / folder)
    begun = time.monotonic()
    process = _begun(kill.newer, work, forked)
    if dice.random() < 0.5:
        after = dice.uniform(0.0, kill.seconds)
        when = f"after {after:.3f} s"
        with suppress(subprocess.TimeoutExpired):
            process.wait(after)
    else:
        change, pause = dice.randint(1, kill.changes), dice.choice((0.0, dice.uniform(0.0, 0.005)))
        when = f"{pause * 1e3:.1f} ms after change {change} of {kill.changes}"
        _watched(process, work, change)
        time.sleep(pause)
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    ended = process.wait() != -signal.SIGKILL
    left = results(work / kill.folder, kill.apart)
    which = [age for age, digests in kill.results.items() if digests == left]
    found = []
    if not which:
        mixed = Counter(_age(kill, path, left.get(path)) for path in {*left, *kill.results["newer"]})
        found.append(f"neither the older nor the newer results: {dict(mixed)}")
    _finished(kill.newer, work, forked)
    resumed = results(work / kill.folder, kill.apart)
    wrong = [path for path, digest in kill.results["newer"].items() if resumed.get(path) != digest]
    if wrong:
        found.append(f"resumed, and other than undisturbed: {', '.join(wrong)}")
    leftovers = [path for path in tree(work) if ".fresh" in path]
    if leftovers:
        found.append(f"left behind: {leftovers[0]}")
    status = "ended before" if ended else which[0] if which else "mixed"
    _remove(work)
    return Met(f"kill of {name}", f"kill {seed}: {kill.newer}, {when}", status, time.monotonic() - begun, found)


def _age(kill: Killed, path: str, digest: str | None) -> str:
    if digest is None:
        return "missing"
    ages = [age for age in ("older", "newer") if kill.results[age].get(path) == digest]
    return " and ".join(ages) or "neither"


def _begun(line: str, work: Path, forked: bool) -> subprocess.Popen[bytes] | Forked:
    if forked:
        return Forked(line, work)
    words = [sys.executable, "-m", "beamdesign", *line.split()]
    with (work / ".said").open("wb") as said:
        return subprocess.Popen(words, cwd=work, stdout=said, stderr=said, start_new_session=True, env=ENVIRONMENT)


def _finished(line: str, work: Path, forked: bool) -> None:
    process = _begun(line, work, forked)
    if process.wait() not in (0, 1):
        raise RuntimeError(f"{line}: {(work / '.said').read_text(encoding='utf-8')[-500:]}")


def _watched(process: subprocess.Popen[bytes] | Forked, work: Path, change: int | None = None) -> int:
    """Wait until the names in a folder have changed so many times, or the process ends; the changes seen."""
    seen, changes = _names(work), 0
    while process.poll() is None and (change is None or changes < change):
        if (now := _names(work)) != seen:
            seen, changes = now, changes + 1
    return max(changes, 1)


def _names(folder: Path) -> list[tuple[str, int]]:
    found = []
    for where, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if name not in ("cases", "fits")]
        for name in names:
            with suppress(FileNotFoundError):
                path = os.path.join(where, name)
                found.append((path, os.lstat(path).st_ino))
    return sorted(found)


def _remove(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)


def table(answers: Sequence[Met]) -> str:
    """Answers by what was mutated or killed, and by exit status; then the faults, by what they are."""
    rows: dict[str, Counter[str]] = defaultdict(Counter)
    for one in answers:
        column = one.status if one.status in STATUSES else "other"
        for row in (one.kind, "all"):
            rows[row].update([column, *(["faults"] if one.faults else [])])
    lines = [f"{'':24}" + "".join(f"{name:>9}" for name in STATUSES)]
    lines += [
        f"{row:24}" + "".join(f"{rows[row][name]:9d}" for name in STATUSES)
        for row in sorted(rows, key=lambda name: (name == "all", name))
    ]
    kinds: dict[str, list[Met]] = defaultdict(list)
    for one in answers:
        for fault in one.faults:
            kinds[fault.split(":")[0].split(", and wrote")[0]].append(one)
    for kind, several in sorted(kinds.items(), key=lambda item: -len(item[1])):
        lines += ["", f"{len(several)} x {kind}"]
        lines += [
            f"  {one.label}\n      {one.status}, {one.seconds:.1f} s, {one.faults}: {one.said}" for one in several
        ]
    return "\n".join(lines)


def main(given: Sequence[str] | None = None) -> int:
    """Run mutants and kills, and print the table; 1 if there is any fault."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mutants", type=int, default=3000)
    parser.add_argument("--kills", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1, help="of the first; the others follow")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, help="write the table to this file as well")
    parser.add_argument("--only", type=int, nargs="+", metavar="SEED", help="these mutants alone")
    chosen = parser.parse_args(given)
    seeds = chosen.only or range(chosen.seed, chosen.seed + chosen.mutants)
    kills = [] if chosen.only else range(chosen.seed, chosen.seed + chosen.kills)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(chosen.workers) as pool:
        stock, scratch = make(Path(folder) / "stock"), Path(folder) / "scratch"
        scratch.mkdir()
        if seeds and not chosen.only:
            print(*filter(None, pool.map(partial(as_shipped, stock, scratch), COMMANDS)), sep="\n", flush=True)
        answers: list[Met] = []
        tried = [pool.submit(met, stock, scratch, seed) for seed in seeds]
        for count, done in enumerate(as_completed(tried), start=1):
            answers.append(one := done.result())
            if one.faults or chosen.only:
                print(f"{one.label}\n    {one.status}, {one.seconds:.1f} s, {one.faults}: {one.said}", flush=True)
            if count % 100 == 0:
                print(f"{count} of {len(seeds)} mutants", file=sys.stderr, flush=True)
        if kills:
            prepare(stock)
        for done in as_completed([pool.submit(killed, stock, scratch, seed) for seed in kills]):
            answers.append(one := done.result())
            print(f"{one.label}: {one.status} {one.faults or ''}", flush=True)
    shown = table(answers)
    print(shown)
    if chosen.out:
        chosen.out.write_text(shown + "\n", encoding="utf-8")
    return int(any(one.faults for one in answers))


if __name__ == "__main__":
    sys.exit(main())
