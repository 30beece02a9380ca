"""What a diagnosis loses with half of the records: the cases of an opened blind check, diagnosed from every second one.

The folder of the check (made by `beamdesign gap blindcheck`) is left as it is. In another folder the same sealed
answers stand beside data sets that lack the first, the third, ... of their records (of the eight of a full case these
are the small command, the small force, the steps of load and the command with a payload), but keep responses and
gains. They are diagnosed blind, as the check's own were, and both are scored, over the cases that both have. What is
printed is a table of Markdown. A run that was stopped goes on by the same call. Usage, from the root of the project:

    python studies/benchmarks/half_the_records.py RUN_FOLDER OUT_FOLDER [--workers 2]
"""

import argparse
import json
import shutil
import tomllib
from collections.abc import Sequence
from pathlib import Path

import tomli_w

from beamdesign.code_digest import folder_digest
from beamdesign.files import write_whole
from beamdesign.validation.blindcheck import Check, begin_check, diagnose_all, open_all, read_answers
from beamdesign.validation.blindcheck_result import target_rows
from beamdesign.validation.case_plan import Planned, read_seal, sealed, write_seal
from beamdesign.validation.scoring import Outcome, scores, split

LEAST = 4
"""Records that a set has to have for half of them to be worth a diagnosis."""


def halved(whole: Path, folder: Path) -> bool:
    """Write a data set with every second record of another; whether there were enough of them."""
    index = tomllib.loads((whole / "dataset.toml").read_text(encoding="utf-8"))
    records = index.get("record", [])
    if len(records) < LEAST:
        return False
    kept = records[1::2]
    if not folder.is_dir():
        shutil.copytree(whole, folder)
        for row in records:
            if row not in kept:
                (folder / row["file"]).unlink()
        (folder / "dataset.toml").write_text(tomli_w.dumps(index | {"record": kept}), encoding="utf-8")
    return True


def half_of(run: Path, folder: Path) -> tuple[Check, Check]:
    """A check whose answers have been opened, and the same with half of its records, sealed anew."""
    plan = json.loads((run / "plan.json").read_text(encoding="utf-8"))
    cases = tuple(Planned(**c | {"names": tuple(c["names"])}) for c in plan["cases"])
    whole = Check(run, cases, plan["short"], plan["seed"])
    half = begin_check(folder, len(cases), plan["seed"], plan["short"], cases)
    if not half.seal.is_file():
        seal = read_seal(whole.seal)
        diagnosed = (key for key in seal.sets if whole.place(key).result.is_file())
        kept = [key for key in diagnosed if halved(whole.sets / key, half.sets / key)]
        for file in (f"{key}.{kind}" for key in kept for kind in ("json", "npz")):
            write_whole(half.answers / file, (whole.answers / file).read_bytes())
        digests = {key: folder_digest(half.sets / key) for key in kept}
        write_seal(sealed(read_answers(half.answers), digests, seal.truth), half.seal)
    return whole, half


def table(whole: Sequence[Outcome], half: Sequence[Outcome]) -> str:
    """Scores of both, over the cases whose gap stands out of the noise."""
    sides = [{row[0]: row for row in target_rows(scores(split(side)[0]))} for side in (whole, half)]
    lines = ["|  | all records | half of them | of | target |", "| --- | --- | --- | --- | --- |"]
    for name, row in sides[0].items():
        lines.append(f"| {name} | {row[1]} | {sides[1][name][1]} | {row[3]}; {sides[1][name][3]} | {row[4]} |")
    return "\n".join(lines)


def main(given: Sequence[str] | None = None) -> tuple[tuple[Outcome, ...], tuple[Outcome, ...]]:
    """Print the table; give the outcomes of both."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("run", type=Path, help="folder of a check that has been scored")
    arguments.add_argument("out", type=Path, help="folder for that with half of the records")
    arguments.add_argument("--workers", type=int, default=2)
    chosen = arguments.parse_args(given)
    whole, half = half_of(chosen.run, chosen.out)
    diagnose_all(half, chosen.workers)
    both = {o.key: o for o in open_all(half)}
    first = tuple(o for o in open_all(whole, unfinished=True) if o.key in both)
    second = tuple(both[o.key] for o in first)
    print(table(first, second))
    return first, second


if __name__ == "__main__":
    main()
