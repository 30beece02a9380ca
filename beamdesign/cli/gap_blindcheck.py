"""`beamdesign gap blindcheck`: the diagnosis on cases whose answers are sealed until it is done."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from beamdesign.cli.output import JsonOption, folder_to_write, progress, say, say_table, write_json

INTERRUPTED = 130
"""Exit status of a run that was interrupted, as shells have it."""


def blindcheck(
    out: Annotated[
        Path,
        typer.Option(metavar="DIR", callback=folder_to_write, help="Folder of the check; one that is there goes on."),
    ] = Path("blindcheck"),
    cases: Annotated[int, typer.Option(min=1, max=10000, help="How many cases.")] = 200,
    seed: Annotated[int, typer.Option(min=0, help="Of the plan; another one gives other cases.")] = 1,
    short: Annotated[bool, typer.Option("--short/--full", help="Few short records, or eight of 4 s each.")] = False,
    workers: Annotated[int, typer.Option(min=1, max=64, help="Cases that are diagnosed at the same time.")] = 2,
    draw_only: Annotated[
        bool, typer.Option("--draw-only", help="Draw the cases and seal the answers; no more.")
    ] = False,
    rejudge: Annotated[
        bool,
        typer.Option("--rejudge", help="Take the fits of the folder, even those of another version of the program."),
    ] = False,
    json: JsonOption = None,
) -> None:
    """Check the diagnosis blind.

    Cases are drawn from a truth model of its own: nulls, single effects, wrong figures, pairs, and effects that the
    library does not hold. Their answers are sealed by SHA-256 before the first diagnosis. Each case is diagnosed from
    its data alone, in a process that cannot open an answer. Then the answers are opened, checked against the seal and
    scored against the targets and against three baselines: result.json and result.md in the folder.

    A check that was stopped goes on by the same command; what is finished is not done again. After a change of how fits
    are judged, the same command judges anew with the fits that are there.
    """
    try:
        _blindcheck(out, cases, seed, short, workers, draw_only, rejudge, json)
    except KeyboardInterrupt:
        print(f"interrupted: the same command goes on with what is in {out}", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None


def _blindcheck(
    out: Path, cases: int, seed: int, short: bool, workers: int, draw_only: bool, rejudge: bool, json: Path | None
) -> None:
    from beamdesign.gap.blindcheck import begin_check, diagnose_all, draw_and_seal, open_all
    from beamdesign.gap.outcome import outcome
    from beamdesign.report.blindcheck_result import markdown, result_fields
    from beamdesign.whole_file import write_whole

    check = begin_check(out, cases, seed, short)
    with progress("drawing") as update:
        seal = draw_and_seal(check, workers, update)
    say(f"sealed: {len(seal.answers)} answers in {check.seal}, SHA-256 {seal.whole}")
    if draw_only:
        return
    with progress("diagnosing") as update:
        diagnose_all(check, workers, update, rejudge)
    opened = open_all(check)
    found = [outcome(case) for case in opened]
    setting = {
        "records": "Five records of 1.75 s each." if short else "Eight records of 4 s each.",
        "seed": seed,
        "planned": cases,
        "short": short,
        "seal": seal.whole,
        "truth": seal.truth,
        "fitted_by": _all({case.found.get("fitted_by") for case in opened}),
        "judged_by": _all({case.found.get("judged_by") for case in opened}),
        "command": f"beamdesign gap blindcheck --cases {cases} --seed {seed} --{'short' if short else 'full'}",
    }
    fields = result_fields(found, setting)
    paths = out / "result.json", out / "result.md"
    for path in (paths[0], json):
        write_json(path, fields)
    write_whole(paths[1], markdown(found, setting))
    say_result(found)
    for path in paths:
        say(str(path))


def _all(digests: set[Any]) -> str:
    """One digest, or several where a check was made by several versions of the program."""
    return ", ".join(sorted(str(digest) for digest in digests if digest))


def say_result(found: list[Any]) -> None:
    """The scores for people."""
    from beamdesign.gap.baselines import NAMES
    from beamdesign.gap.scoring import baseline_scores, confusion, scores, split
    from beamdesign.report.blindcheck_result import figure, target

    large, small = split(found)
    ours = scores(large)
    say_table(
        f"{len(large)} cases (and {len(small)} with a gap below three floors, apart)",
        ("", "found", "95 % bounds", "of", "target", "reached"),
        [
            (
                s.name,
                figure(s, s.value),
                f"{figure(s, s.low)} to {figure(s, s.high)}" if s.low == s.low and s.of else "",
                str(s.of),
                target(s),
                {True: "yes", False: "no", None: ""}[s.reached],
            )
            for s in ours
        ],
    )
    others = {name: {s.name: s for s in baseline_scores(name, large)} for name in NAMES}
    by_name = {s.name: s for s in ours}
    rows = []
    for score in others[NAMES[0]]:
        first = by_name.get(score)
        each = (others[name][score] for name in NAMES)
        rows.append((score, figure(first, first.value) if first else "", *(figure(s, s.value) for s in each)))
    say_table("baselines on the same cases", ("", "diagnosis", *NAMES), rows)
    named = confusion(found)
    rows = [(label, ", ".join(f"{name} {count}" for name, count in row.items())) for label, row in named.items()]
    say_table("named first, all cases", ("truth", "named"), rows)
