"""`beamdesign gap blindcheck`: the diagnosis on cases whose answers are sealed until it is done."""

import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from beamdesign.cli.output import JsonOption, folder_to_write, progress, say, say_table, write_json

if TYPE_CHECKING:
    from beamdesign.gap.blind.blindcheck import Check
    from beamdesign.gap.blind.outcome import Outcome
    from beamdesign.gap.blind.seal import Seal

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
    score_only: Annotated[
        bool, typer.Option("--score-only", help="Diagnose no more; score the cases that are finished.")
    ] = False,
    json: JsonOption = None,
) -> None:
    """Check the diagnosis blind.

    Cases are drawn from a truth model of its own: nulls, single effects, wrong figures, pairs, and effects that the
    library does not hold. Their answers are sealed by SHA-256 before the first diagnosis. Each case is diagnosed from
    its data alone, in a process that cannot open an answer. Then the answers are opened, checked against the seal and
    scored against the targets and against three baselines: result.json, result.md and result.svg in the folder.

    A check that was stopped goes on by the same command; what is finished is not done again. After a change of how fits
    are judged, the same command judges anew with the fits that are there.
    """
    try:
        with progress("drawing") as update:
            check, seal = _sealed(out, cases, seed, short, workers, update)
        say(f"sealed: {len(seal.answers)} answers in {check.seal}, SHA-256 {seal.whole}")
        if draw_only:
            return
        if not score_only:
            with progress("diagnosing") as update:
                _diagnose(check, workers, update, rejudge)
    except KeyboardInterrupt:
        print(f"interrupted: the same command goes on with what is in {out}", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None
    _score(check, seal, score_only, json)


def _sealed(
    out: Path, cases: int, seed: int, short: bool, workers: int, update: Callable[[float, str], None]
) -> tuple["Check", "Seal"]:
    from beamdesign.gap.blind.blindcheck import begin_check, draw_and_seal

    check = begin_check(out, cases, seed, short)
    return check, draw_and_seal(check, workers, update)


def _diagnose(check: "Check", workers: int, update: Callable[[float, str], None], rejudge: bool) -> None:
    from beamdesign.gap.blind.blindcheck import diagnose_all

    diagnose_all(check, workers, update, rejudge)


def _score(check: "Check", seal: "Seal", unfinished: bool, json: Path | None) -> None:
    from beamdesign.files import write_whole
    from beamdesign.gap.blind.blindcheck import open_all
    from beamdesign.gap.blind.outcome import outcome
    from beamdesign.report.blindcheck_result import blindcheck_picture, markdown, result_fields, result_text
    from beamdesign.report.canvas import save

    opened = open_all(check, unfinished)
    if not opened:
        say("no case is finished")
        raise typer.Exit(1)
    found = [outcome(case) for case in opened]
    length = "short" if check.short else "full"
    setting = {
        "records": "Five records of 1.75 s each." if check.short else "Eight records of 4 s each.",
        "planned": len(check.cases),
        "scored": len(found),
        "seed": check.seed,
        "short": check.short,
        "seal": seal.whole,
        "truth": seal.truth,
        "fitted_by": _all(case.found.get(key) for case in opened for key in ("fitted_by", "added_by")),
        "judged_by": _all(case.found.get("judged_by") for case in opened),
        "not_drawn": check.not_drawn,
        "command": f"beamdesign gap blindcheck --cases {len(check.cases)} --seed {check.seed} --{length}",
    }
    fields = result_fields(found, setting)
    paths = check.folder / "result.json", check.folder / "result.md"
    write_json(json, fields)
    write_whole(paths[0], result_text(fields))
    write_whole(paths[1], markdown(found, setting))
    drawn = save(blindcheck_picture(found), check.folder / "result", ("svg",))
    say_result(found)
    for path in (*paths, *drawn):
        say(str(path))


def _all(digests: Iterable[Any]) -> str:
    """One digest, or several where a check was made by several versions of the program."""
    return ", ".join(sorted({str(digest) for digest in digests if digest}))


def say_result(found: "Sequence[Outcome]") -> None:
    """The scores for people."""
    from beamdesign.gap.blind.scoring import confusion, scores, split
    from beamdesign.report.blindcheck_result import BASELINE_COLUMNS, TARGET_COLUMNS, baseline_rows, target_rows

    large, small = split(found)
    title = f"{len(large)} cases (and {len(small)} with a gap below three floors, apart)"
    say_table(title, TARGET_COLUMNS, target_rows(scores(large)))
    say_table("baselines on the same cases", BASELINE_COLUMNS, baseline_rows(large))
    named = confusion(large)
    rows = [(label, ", ".join(f"{name} {count}" for name, count in row.items())) for label, row in named.items()]
    say_table("named first", ("truth", "named"), rows)
