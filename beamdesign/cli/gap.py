"""`beamdesign gap`: from records of a built rig back to the model."""

from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

import beamdesign
from beamdesign.cli.command import CommandResult, command, group, in_time, resumed
from beamdesign.cli.output import default_folder, echo, echo_table, in_words, named_files, progress, refuse, spare
from beamdesign.files import fresh_folder, settled
from beamdesign.time_limit import share

if TYPE_CHECKING:
    from beamdesign.diagnosis.data.dataset import Dataset
    from beamdesign.diagnosis.diagnosis import Diagnosis
    from beamdesign.validation.scoring import Outcome

gap = group("Compare a built rig with its model. Where they differ, why, and how far the difference closes.")

_DIAGNOSING = 0.6  # of the time, where a controller is to be designed as well
_SECONDS_PER_SAMPLE = 1.5e-3  # on two processes, where one cause explains all; six times that for a second look
_SECONDS_PER_FIGURE = 2.0  # likewise, without records
_SECONDS_PER_SWEEP = 10.0  # of a response whose sines are simulated
_WORTH_FIGURES = 0.1  # probability of a cause from which its figures are printed

_Workers = Annotated[int, typer.Option(min=1, max=64)]


@gap.command()
@command
def diagnose(
    dataset: Path, out: Path | None = None, redesign: bool = False, workers: _Workers = 2, minutes: float | None = None
) -> CommandResult:
    """Diagnose the gap between a prototype and its rig.

    Every cause that is known, alone, in pairs and, where pairs explain but a part, three at once, is fitted to all
    records with the tolerances of the prototype. The gap is then measured by fits without some of the records, on
    those. Exit status 0 whatever the verdict is. An interrupted run is taken up where it stopped by the same command:
    finished fits are kept in the folder `fits` of the results.

    Args:
        dataset: folder with dataset.toml, the prototype believed and CSV files.
        out: folder for prototype.toml, diagnosis.json and report.html; else NAME.diagnosis here.
        redesign: tune and prove a controller for the diagnosed prototype as well.
        workers: processes that fit at the same time.
        minutes: most time for an answer, the best of what was compared until then; else 2. The same command goes on.
    """
    from beamdesign.diagnosis.data.dataset_index import index_of, kind_of
    from beamdesign.report.gap_folder import NAMES, write_gap_folder

    index = index_of(dataset).resolve()
    other = "" if index.name == "dataset.toml" else f".{index.stem}"
    folder = out or default_folder(f"{index.parent.name}{other}.diagnosis")
    spare(named_files(index_of(dataset)), folder, NAMES.values())
    if kind_of(dataset) != "actuator_bench":
        return _diagnose(dataset, folder, redesign, workers, minutes)

    if redesign:
        refuse("--redesign", (str(dataset), "a bench has no controller to design"))
    data = beamdesign.read_bench_set(dataset)
    with in_time(minutes, "half a minute to 2 min"):
        with progress("diagnosing") as update:
            found = beamdesign.diagnose(data, progress=update)
        echo_diagnosis(found)
    paths, fields = write_gap_folder(folder, found)
    return CommandResult(fields, files=paths.values())


def _diagnose(dataset: Path, folder: Path, renew: bool, workers: int, minutes: float | None) -> CommandResult:
    from beamdesign.diagnosis.diagnosis import controller_text
    from beamdesign.diagnosis.fitting.fit_cache import fit_cache
    from beamdesign.diagnosis.redesign import designer_terms, payload_range, redesign
    from beamdesign.report.gap_folder import write_gap_folder
    from beamdesign.report.gap_tables import terms_table
    from beamdesign.structure.arm import off_axis

    data = beamdesign.read_dataset(dataset)
    kept = fit_cache(folder / "fits", data)
    renewed = None
    with resumed(lambda: f": {kept.count} fits are kept in {kept.folder}; the same command goes on from there"):
        with in_time(minutes, _usually(data)):
            with share(_DIAGNOSING if renew else 1.0), progress("diagnosing") as update:
                found = beamdesign.diagnose(data, workers, update, kept)
            echo_diagnosis(found)
            if renew:
                with progress("redesigning") as update:
                    renewed = redesign(found.prototype, payload_range(data), update)
        new = [] if renewed is None else [stage for _, stage in renewed.proofs]
        terms = designer_terms(data, found.prototype, new)
        with progress("drawing"):
            paths, fields = write_gap_folder(folder, found, data, terms, renewed)
    for loop in terms:
        title = ("new: " if loop.new else "") + controller_text(loop.controller, loop.inner_end_mass_kg)
        promised = terms_table(loop)
        echo_table(title, promised.heads, promised.rows)
    if words := next((loop.diagnosed.holds_for for loop in terms if loop.diagnosed.holds_for), ""):
        echo(f"what is promised as diagnosed is proved {words}")
    if found.reserve:
        echo(found.reserve)
    if renewed is not None and renewed.reason:
        echo(f"no new controller: {renewed.reason}")
    if renewed is None:
        low, high = payload_range(data)
        written = quote(str(paths["prototype"]))
        if off_axis(data.prototype):
            echo(f"loops of both planes: beamdesign arm {written}")
        else:
            echo(f"to tune on what was found: beamdesign tune {written} --outer-end-mass {low:g}:{high:g}")
    return CommandResult(fields, files=paths.values())


def _usually(data: "Dataset") -> str:
    """How long a diagnosis takes, from how much has to be simulated."""
    if data.records:
        least = _SECONDS_PER_SAMPLE * sum(len(record.times) for record in data.records)
    else:
        sweeps = sum(response.amplitude is not None for response in data.responses)
        least = _SECONDS_PER_FIGURE * (len(data.gains) + len(data.responses)) + _SECONDS_PER_SWEEP * sweeps
    return f"{in_words(least)} to {in_words(6 * least)}"


def echo_diagnosis(found: "Diagnosis") -> None:
    """The answer for people."""
    from beamdesign.report.gap_tables import figure_name

    echo(f"{found.name}: {found.verdict.replace('_', ' ')}{' so far' * bool(found.left_out)}")
    echo(found.sentences)
    echo(*found.warnings, before="warning: ")
    echo("")
    if found.causes:
        echo_table("causes", ("cause", "subsystem", "probability", "share of the gap"), found.rows())
    for cause in found.causes:
        if cause.name in found.chosen or cause.probability > _WORTH_FIGURES:
            for key, q in cause.parameters.items():
                echo(f"{cause.name}: {figure_name(key)} = {q.value:.4g} ± {q.std:.2g}")
            echo(*[f"like {cause.like}"] * bool(cause.like), *cause.flags, before=f"{cause.name}: ")
    where = found.where
    if where.subsystem:
        echo(f"where: {', '.join(filter(None, (where.place, where.kind, where.condition)))}")
    if where.sentence:
        echo(where.sentence)
    _echo_gap(found)
    echo(*found.notes)
    known = "known before any fit, of causes of their usual size: these data cannot"
    separability = found.separability
    for alike in separability.classes if separability is not None else ():
        echo(f"{known} tell apart {', '.join(alike)}")
    if separability is not None and separability.invisible:
        echo(f"{known} show {', '.join(separability.invisible)}")
    for rivals in found.classes:
        echo(f"these data cannot tell apart: {'; '.join(rivals)}")
    if found.next_experiment is not None:
        echo(f"measure next: {found.next_experiment.text}")


def _echo_gap(found: "Diagnosis") -> None:
    from beamdesign.report.gap_tables import closed_text

    gap = found.gap
    if not gap.records:
        return
    of_all = "held out" if any(record.held_out for record in gap.records) else "all"
    named: list[tuple[str, str, Any]] = [
        (one.record, "held out" if one.held_out else "fitted", one) for one in gap.records
    ]
    rows = []
    for name, how, one in (*named, (f"{of_all} together", "", gap)):
        shares = (100 * error for error in (one.before, one.tuned, one.after, one.noise_floor))
        rows.append((name, how, *(f"{share:.3g}" if isfinite(share) else "" for share in shares)))
    columns = ("record", "", "believed", "re-tuned", "with cause", "noise")
    echo_table("prediction error, per cent", columns, rows)
    low, high = (closed_text(value) for value in gap.closed_interval)
    echo(f"closed: {closed_text(gap.closed)} of the explainable gap, 90 % interval {low} to {high}")


@gap.command("import")
@command
def import_(
    files: Annotated[list[Path], typer.Argument()],
    prototype: Annotated[Path, typer.Option(metavar="FILE")],
    out: Path,
    column: Annotated[list[str] | None, typer.Option(metavar="'CHANNEL = NAME [UNIT]'")] = None,
    outer_end_mass: Annotated[list[float] | None, typer.Option(metavar="KG")] = None,
    inner_end_mass: Annotated[float | None, typer.Option(metavar="KG")] = None,
    rest_s: Annotated[float, typer.Option(metavar="SECONDS", min=0.0)] = 0.0,
    stage: Annotated[list[int] | None, typer.Option(metavar="N")] = None,
    clock: Literal["even", "stamps"] | None = None,
) -> CommandResult:
    """Make a data set of CSV, MATLAB and universal files.

    Columns are told by their names and units, and what was taken for what is printed. Where that cannot be told, the
    answer says which columns there are. Frequency responses of universal files become compliances. Runs of an
    actuator bench with the same command become replicates of one condition.

    Args:
        files: .csv or other text, .mat, .uff, .unv; one record each.
        prototype: the model that was believed, with the controller that acted.
        out: folder for dataset.toml, prototype.toml and records.
        column: name a column, with its unit, and a minus sign before NAME to turn it round, such as
            'current_A = -i_valve [mA]', or 0 instead of NAME where there is none; again for each, and for each
            name that a channel has in other files.
        outer_end_mass: payload while they were taken; once, or once for each file.
        inner_end_mass: mass added inside; else the prototype's.
        rest_s: how long everything rests at the beginning; the mean of that time is taken off every channel.
        stage: of a scheduled controller the stage that acted, from 1; once, or once for each file. Needed where a
            payload lies in the ranges of two.
        clock: whether time stamps that jitter are of an even clock and came late, or tell when samples were really
            taken; else the samples tell, and what was done is printed.
    """
    from beamdesign.diagnosis.data.dataset import Dataset

    masses = outer_end_mass or (0.0,)
    found = beamdesign.import_measured(
        files, prototype, out, column or (), masses, inner_end_mass, rest_s, stage or (), clock
    )
    echo_table("what was taken for what", ("file", "channel", "from", "note"), found.rows())
    if not outer_end_mass and isinstance(found.dataset, Dataset):
        echo("mass on the outer tip: taken as 0 kg in every file, as none is stated; --outer-end-mass KG states it")
    echo(f"next:    beamdesign gap diagnose {quote(str(out))}")
    return CommandResult(found.to_dict(), files=found.paths)


@gap.command()
@command
def predict(prototype: Path, dataset: Path, out: Path) -> CommandResult:
    """Predict the records of a data set from its inputs alone.

    Times, forces, commands, end masses and controllers are read; measured columns are not, and may be missing or not
    finite. Displacements are stated as the data set states them: the sensor's volts over the gain believed there. A
    loop that diverges ends its record there, and the exit status is 1.

    Args:
        prototype: the prototype.toml to simulate, with the effects it names.
        dataset: folder with dataset.toml, the prototype believed and CSV files.
        out: folder for one CSV file per record.
    """
    from beamdesign.columns import write_tables
    from beamdesign.diagnosis.data.dataset_index import index_of

    measured = named_files(index_of(dataset))
    spare([*measured, prototype], out, [path.with_suffix(".csv").name for path in measured])
    with progress("simulating") as update:
        found = beamdesign.predict(prototype, dataset, update)
    with fresh_folder(out) as fresh:
        written = write_tables({record.name: (record.columns, record.samples) for record in found.records}, fresh)
    paths = settled(written, fresh, out)
    title = f"{prototype} under the inputs of {dataset}"
    echo_table(title, ("record", "samples", "peak displacement_m", ""), found.rows())
    echo(f"records: {len(paths)} files in {out}")
    return CommandResult({"records": paths} | found.to_dict(), found.yes)


@gap.command()
@command
def blindcheck(
    out: Path = Path("blindcheck"),
    cases: Annotated[int, typer.Option(min=1, max=10000)] = 200,
    seed: Annotated[int, typer.Option(min=0)] = 1,
    short: Annotated[bool, typer.Option("--short/--full")] = False,
    workers: _Workers = 2,
    draw_only: bool = False,
    rejudge: bool = False,
    score_only: bool = False,
) -> CommandResult:
    """Check the diagnosis blind.

    Cases are drawn from a truth model of its own: nulls, single effects, wrong figures, two and three effects at once,
    and effects that the library does not hold. A fifth have frequency responses and critical gains beside their
    records, a few have these alone. Their answers are sealed by SHA-256 before the first diagnosis. Each case is
    diagnosed from its data alone, in a process that cannot open an answer. Then the answers are opened, checked against
    the seal and scored against the targets and against three baselines: result.json, result.md and result.svg in the
    folder.

    A check that was stopped goes on by the same command; what is finished is not done again. After a change of how fits
    are judged, the same command judges anew with the fits that are there.

    Args:
        out: folder of the check; one that is there goes on.
        cases: how many cases.
        seed: of the plan; another one gives other cases.
        short: few short records, or eight of 4 s each.
        workers: cases that are diagnosed at the same time.
        draw_only: draw the cases and seal the answers; no more.
        rejudge: take the fits of the folder, even those of another version of the program.
        score_only: diagnose no more; score the cases that are finished.
    """
    from beamdesign.validation.blindcheck import begin_check, diagnose_all, draw_and_seal, scored

    with resumed(lambda: f": the same command goes on with what is in {out}"):
        with progress("drawing") as update:
            check = begin_check(out, cases, seed, short)
            seal = draw_and_seal(check, workers, update)
        echo(f"sealed: {len(seal.answers)} answers in {check.seal}, SHA-256 {seal.whole}")
        if draw_only:
            return CommandResult({"planned": len(check.cases), "seal": seal.whole})
        if not score_only:
            with progress("diagnosing", "1 to 5 minutes a case") as update:
                diagnose_all(check, workers, update, rejudge)
    found = scored(check, score_only)
    if not found.yes:
        echo(found.reason)
        return CommandResult(found.to_dict(), yes=False)
    files = found.write(check.folder)
    echo_result(found.outcomes)
    return CommandResult(found.to_dict(), files=files)


def echo_result(found: "Sequence[Outcome]") -> None:
    """The scores for people."""
    from beamdesign.validation import blindcheck_result as tables
    from beamdesign.validation.scoring import scores, split

    large, small = split(found)
    title = f"{len(large)} cases (and {len(small)} with a gap below three floors, apart)"
    echo_table(title, tables.TARGET_COLUMNS, tables.target_rows(scores(large)))
    echo_table("baselines on the same cases", tables.BASELINE_COLUMNS, tables.baseline_rows(large))
    named = tables.confusion(large)
    rows = [(label, ", ".join(f"{name} {count}" for name, count in row.items())) for label, row in named.items()]
    echo_table("named first", ("truth", "named"), rows)
