"""Hostile inputs: a few hundred mutants of shipped ones, and the judge that says what is a fault of an answer.

`studies/benchmarks/hostile.py` does the same with thousands, slow commands and kills; `--only SEED` repeats one.
"""

import shutil
from collections.abc import Callable
from itertools import count, islice
from pathlib import Path

import hostile
import pytest
from hostile_inputs import COMMANDS, Answer, ask, command_of, faults, laid_out, make, mutant, stock_in, tree

pytestmark = pytest.mark.long

QUICK = [command for command in COMMANDS if command.quick]
SEEDS = list(islice((seed for seed in count(1) if command_of(seed).quick), 300))
AT_A_TIME = 10


@pytest.fixture(scope="session")
def stock(made_once: Callable[[str, Callable[[Path], None]], Path]) -> Path:
    """What the mutants are made from; only to be read."""
    return stock_in(made_once("stock", lambda folder: make(folder, QUICK, forked=True)))


@pytest.mark.parametrize("first", range(0, len(SEEDS), AT_A_TIME))
def test_mutants_are_met_without_a_fault(stock: Path, tmp_path: Path, tried: Callable[[int], int], first: int) -> None:
    wrong = []
    for seed in SEEDS[first : first + tried(AT_A_TIME)]:
        made = mutant(seed, tmp_path / str(seed), stock)
        before = tree(made.folder)
        answer = ask(made, forked=True)
        wrong += [f"{made}: {fault}: {answer.err[-200:]}" for fault in faults(made, answer, before)]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("number", range(0, len(QUICK), 3))
def test_inputs_as_they_are_shipped_are_taken(stock: Path, tmp_path: Path, number: int) -> None:
    """Otherwise their mutants would show nothing."""
    made = laid_out(QUICK[number], tmp_path / "as_shipped", stock)
    before = tree(made.folder)
    answer = ask(made, forked=True)
    assert answer.status != 2, answer.err
    assert faults(made, answer, before) == []


def test_a_mutant_follows_from_its_seed_alone(stock: Path, tmp_path: Path) -> None:
    for seed in SEEDS[:10]:
        one, other = (mutant(seed, tmp_path / f"{side}{seed}", stock) for side in "ab")
        assert (one.words, one.label, tree(one.folder)) == (other.words, other.label, tree(other.folder))


TRACEBACK = "Traceback (most recent call last):"
FAULTS = {
    "no answer": (Answer(None, 20.0, "", ""), ""),
    "signal 9": (Answer(-9, 1.0, "", ""), ""),
    "exit status 3": (Answer(3, 1.0, "", ""), ""),
    "traceback": (Answer(1, 1.0, "", TRACEBACK), ""),
    "control characters": (Answer(0, 1.0, "\x1b[31mred", ""), ""),
    "ran code": (Answer(0, 1.0, "", ""), "ran"),
    "outside": (Answer(0, 1.0, "", ""), "escape.csv"),
    "refused, and wrote": (Answer(2, 1.0, "", "prototype.toml: name: missing"), "around/work/out/table.csv"),
    "without a source": (Answer(2, 1.0, "", "that will not do"), ""),
    "believed": (Answer(0, 1.0, "", ""), "around/work/out/table.csv"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_is_seen(stock: Path, tmp_path: Path, fault: str) -> None:
    answer, written = FAULTS[fault]
    made = laid_out(COMMANDS[0], tmp_path / "judged", stock)
    if fault == "believed":
        made.believed["out/table.csv"] = "another"
    before = tree(made.folder)
    assert faults(made, Answer(0, 1.0, "", ""), before) == ([] if fault != "believed" else faults(made, answer, before))
    if written:
        (made.folder / written).write_text("fresh")
    (found,) = faults(made, answer, before)
    assert fault in found


def test_a_folder_killed_while_it_is_written_is_of_one_result(
    stock: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hostile, "KILLED", {"code": hostile.KILLED["code"]})
    stock = Path(shutil.copytree(stock, tmp_path / "stock", symlinks=True))
    hostile.prepare(stock, forked=True)
    kill = hostile.KILLED["code"]
    assert set(kill.results["older"].values()).isdisjoint(kill.results["newer"].values())
    assert [one.label for one in (hostile.killed(stock, tmp_path, seed, True) for seed in range(3)) if one.faults] == []
    for path in ("controller.c", "controller.h"):  # one file of another result is seen
        mixed = {**kill.results["older"], path: kill.results["newer"][path]}
        assert mixed not in kill.results.values()
