"""Rigs without a gap, drawn by the truth model and diagnosed: what a data set is ranked among by `diagnose.chance`.

Scores are written as they come, so that a run which was stopped goes on by the same command. With `--check` no scores
are written for the package: those of the package's own are ranked against them, and the share below the level is
printed with its 95 % bounds. Usage, from the root of the project:

    python studies/benchmarks/null_scores.py FOLDER [--rigs 200] [--seed 1] [--workers 2] [--full] [--check]
"""

import argparse
import json
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import fill

from beamdesign import diagnose, read_dataset
from beamdesign.diagnosis.verdict import LEVEL, chance
from beamdesign.validation.bounds import clopper_pearson
from beamdesign.validation.case_plan import FIGURES, HISSES, RIGS

_TAB = "    "


def no_gap(seed: int, short: bool) -> float:
    """Probability of no gap that the diagnosis of one rig without a gap comes to."""
    from beamdesign.validation.truth.case import write_case
    from beamdesign.validation.truth.drawing import draw_case
    from beamdesign.validation.truth.loop_figures import loop_figures

    rest, rig = divmod(seed, len(RIGS))
    rest, noise = divmod(rest, len(HISSES))
    case = draw_case(seed, "null", short=short, rig=RIGS[rig], noise=HISSES[noise])
    with TemporaryDirectory() as folder:
        write_case(case, folder, loop_figures(case, Path(folder)) if FIGURES[rest % len(FIGURES)] else {})
        found = diagnose(read_dataset(folder), 1)
    return next((one.probability for one in found.hypotheses if not one.names), 0.0)


def scores(folder: Path, seeds: range, short: bool, workers: int) -> list[float]:
    """Of every seed, those that the folder holds and the others."""
    kept = folder / f"{'short' if short else 'full'}.jsonl"
    folder.mkdir(parents=True, exist_ok=True)
    lines = kept.read_text().splitlines() if kept.is_file() else []
    found: dict[int, float] = dict(json.loads(line) for line in lines)
    with ProcessPoolExecutor(workers) as pool:
        jobs = {pool.submit(no_gap, seed, short): seed for seed in seeds if seed not in found}
        for job in as_completed(jobs):
            found[jobs[job]] = job.result()
            with kept.open("a") as file:
                file.write(json.dumps([jobs[job], job.result()]) + "\n")
    return [found[seed] for seed in seeds]


def main(argv: list[str]) -> int:
    """Draw, diagnose, write or check."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--rigs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1, help="of the first rig; the others count on from it")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--full", action="store_true", help="eight records of 4 s instead of five of 1.75 s")
    parser.add_argument("--check", action="store_true", help="of the level, by the scores of the package")
    given = parser.parse_args(argv)
    seeds = range(given.seed, given.seed + given.rigs)
    found = scores(given.folder, seeds, not given.full, given.workers)
    if given.check:
        below = sum(chance(score) <= LEVEL for score in found)
        low, high = clopper_pearson(below, len(found))
        print(f"{below} of {len(found)} rigs without a gap below {LEVEL:.0%}, 95 % bounds {low:.1%} to {high:.1%}")
        return 0
    rows = fill(", ".join(f"{score:.4g}" for score in sorted(found)), 116, initial_indent=_TAB, subsequent_indent=_TAB)
    (given.folder / "nulls.toml").write_text(f"first_seed = {given.seed}\nno_gap = [\n{rows},\n]\n")
    print(f"{len(found)} scores in {given.folder / 'nulls.toml'}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
