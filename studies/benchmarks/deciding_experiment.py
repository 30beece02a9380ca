"""The experiment that a diagnosis proposes, taken on the true rig of a blind case, and whether it decides.

Each case of a check that `beamdesign gap blindcheck` has scored, whose cause is listed and whose verdict is ambiguous
or unknown, is diagnosed once more from its kept fits. The records that it asks for are taken on the rig that made the
others, with its noise, and added to them; so are as many random ones of the same menu, for comparison. A case is
decided where the verdict is then `effect` and exactly what was in it is held responsible; where nothing is proposed it
is not. What is printed is a section of Markdown, its last rows the shares with their 95 % bounds. Usage, from the root
of the project:

    python studies/benchmarks/deciding_experiment.py RUN_FOLDER [--cases 0002 0009 ...] [--workers 2]
"""

import argparse
import shutil
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import tomli_w
from opened_cases import OpenedCase, check_of, diagnosed, opened_case, opened_keys, true_rig

from beamdesign import InputError, diagnose, read_dataset
from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.experiment_menu import Experiment, menu
from beamdesign.records import parse
from beamdesign.scenario import Scenario, inputs_of
from beamdesign.validation.bounds import clopper_pearson

_OF = {"load_pressure_Pa": "load_pressure", "inner_displacement_m": "inner", "screw_force_N": "screw_force"}
COLUMNS = ("case", "truth", "verdict", "records", "proposed", "bits", "decided", "at random", "decided")
KNOWN = ("single", "parameter", "pair", "triple")
"""Kinds of cases with records whose causes are listed."""
OPEN = ("ambiguous", "unknown")
TARGET = 0.8
"""Share to be decided by the experiment that is proposed."""


def taken(opened: OpenedCase, scenario: Scenario, added: str, folder: Path) -> Dataset:
    """The data set of a case with further records of its rig, written to a folder.

    Args:
        opened: the case.
        scenario: of these records.
        added: channel of a sensor that is added for them; empty for none.
        folder: to be made.
    """
    from beamdesign.validation.truth.case import Drive, Run, recorded, take

    shutil.copytree(opened.folder / "sets" / opened.planned.key, folder)
    index = tomllib.loads((folder / "dataset.toml").read_text(encoding="utf-8"))
    for k, row in enumerate(scenario.record):
        inputs = inputs_of(row, scenario)
        column = int(np.abs(inputs[:, 1]).max() > 0)
        played = tuple(inputs[:, column].tolist())
        drive = Drive(("disturbance_N", "command_V")[column], "given", 0.0, 0.0, 97 + k, played)  # type: ignore[arg-type]
        assert row.controller is not None  # a proposal names it
        table = row.controller.model_dump(mode="json", exclude_none=True)
        outer, inner = row.outer_end_mass_kg or 0.0, row.inner_end_mass_kg or 0.0
        run = Run(row.name, drive, table, outer, inner)
        case = replace(true_rig(opened), runs=(run,), duration_s=scenario.duration_s)
        columns = recorded(case, run)
        if added:
            columns[added] = getattr(take(case, run, noisy=True), _OF[added])
        rows, file = np.column_stack(list(columns.values())), f"records/{row.name}.csv"
        np.savetxt(folder / file, rows, "%.9g", ",", header=",".join(columns), comments="")
        masses = {"outer_end_mass_kg": outer, "inner_end_mass_kg": inner}
        index["record"].append({"file": file, "controller": table} | masses)
    (folder / "dataset.toml").write_text(tomli_w.dumps(index), encoding="utf-8")
    return read_dataset(folder)


def drawn(options: Sequence[Experiment], count: int, random: np.random.Generator) -> Scenario:
    """So many different records of a menu."""
    chosen = [options[k].scenario for k in random.choice(len(options), count, replace=False)]
    rows = (one.record[0].but(name=f"next_{k}") for k, one in enumerate(chosen, start=1))
    return chosen[0].but(record=tuple(rows))


def decides(opened: OpenedCase, scenario: Scenario, added: str = "", workers: int = 2) -> tuple[bool, str]:
    """Whether a diagnosis with these records names just what was in the case, and what it says."""
    with TemporaryDirectory() as name:
        try:
            found = diagnose(taken(opened, scenario, added, Path(name) / "set"), workers)
        except InputError as error:
            return False, f"refused: {error}"
    right = found.verdict == "effect" and set(found.chosen) == set(opened.answer["effects"])
    return right, " + ".join(found.chosen) or found.verdict


def row(values: Sequence[object]) -> None:
    """Print a row of a table of Markdown."""
    print(f"| {' | '.join(map(str, values))} |", flush=True)


def main(argv: Sequence[str] | None = None) -> None:
    """Print a row for every case, then how many were decided."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="of a blind check that has been scored")
    parser.add_argument("--cases", nargs="+", metavar="KEY", help="else all that are open and have a listed cause")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    given = parser.parse_args(argv)
    verdicts, check = opened_keys(given.folder), check_of(given.folder)
    open_ = [key for key, verdict in verdicts.items() if verdict in OPEN]
    cases = [opened_case(given.folder, key) for key in given.cases or open_]
    cases = [one for one in cases if one.planned.kind in KNOWN]
    print("## Another experiment on the true rig\n")
    print(f"{len(cases)} ambiguous or unknown cases with a listed truth, of {len(verdicts)} of `{check}`.\n")
    row(COLUMNS)
    row(["---"] * len(COLUMNS))
    random, counts = np.random.default_rng(0), np.zeros(3, dtype=int)
    for opened in cases:
        data, found = diagnosed(opened)
        if found.verdict not in OPEN:  # as this program judges
            continue
        asked, right, said, bits, count = found.next_experiment, False, "nothing", "", 1
        if asked is not None:
            plan = parse(Scenario, dict(asked.settings["scenario"]), "next")  # type: ignore[call-overload]
            right, said = decides(opened, plan, str(asked.settings["added_sensor"]), given.workers)
            bits, count = f"{asked.information_bits:.2g}", len(plan.record)
        lucky, told = decides(opened, drawn(list(menu(data)), count, random), workers=given.workers)
        counts += (1, right, lucky)
        truth, verdict = " + ".join(opened.answer["effects"]), f"{found.verdict}: {' + '.join(found.chosen)}"
        row((opened.planned.key, truth, verdict, count, said, bits, right, told, lucky))
    print()
    row(("experiment", "decided", "of", "share", "95 % bounds", "target"))
    row(["---"] * 6)
    for name, count, target in zip(("proposed", "at random"), counts[1:], (f"{TARGET:.0%}", ""), strict=True):
        low, high = clopper_pearson(int(count), int(counts[0]))
        share = f"{count / counts[0]:.0%}" if counts[0] else ""
        row((name, count, counts[0], share, f"{low:.0%} to {high:.0%}", target))


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
