"""What every command shares: its options, the way from them to an answer, and the exit status of that.

An option goes by the name of its parameter, and its help is what the docstring tells of it; some mean the same in every
command (`OPTIONS`).
"""

import glob
import inspect
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from copy import copy
from dataclasses import dataclass
from functools import wraps
from itertools import chain, islice
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_origin, get_type_hints

import typer
from typer.models import ArgumentInfo, OptionInfo

import beamdesign
from beamdesign import time_limit
from beamdesign.cli import output
from beamdesign.cli.output import echo, json_target, refuse
from beamdesign.files import fresh_folder, settled, write_whole
from beamdesign.progress import undisguised

if TYPE_CHECKING:
    from beamdesign.prototype import InStage, Prototype


@dataclass(frozen=True)
class CommandResult:
    """What a command has found.

    Attributes:
        fields: of the JSON file.
        yes: whether the answer is yes; the exit status is 1 where it is no.
        files: that were written, to be told last.
    """

    fields: Mapping[str, Any]
    yes: bool = True
    files: Iterable[Path] = ()


class Figure(OptionInfo):
    """An option for a figure.

    Args:
        quantity: of `beamdesign.quantities`; what lies outside of its range is refused.
        or_infinite: whether `inf` is taken as well.
        metavar: in place of its type.
    """

    def __init__(self, quantity: str, or_infinite: bool = False, metavar: str | None = None):
        super().__init__(default=..., metavar=metavar)
        self.quantity, self.or_infinite = quantity, or_infinite


def command(
    work: Callable[..., CommandResult], problems: Callable[..., Iterable[tuple[str, str]]] | None = None
) -> Callable[..., None]:
    """A command from a function that says what it finds: with `--json`, checked figures, and an exit status.

    Args:
        work: the function, of the options alone.
        problems: what is wrong with the options beside implausible figures, key and reason; given all of them.

    Raises:
        InputError: where options are wrong, with everything that is.
        typer.Exit: with status 1 where the answer is no.
    """
    about, helps = _described(work)
    called = work.__name__.strip("_").replace("_", "-")
    hints = {name: hint for name, hint in get_type_hints(work, include_extras=True).items() if name != "return"}
    hints = {name: _marked(name, hint, helps.get(name)) for name, hint in hints.items()}
    marks = {name: hint.__metadata__[0] for name, hint in hints.items()}
    figures = {name: mark for name, mark in marks.items() if isinstance(mark, Figure)}
    usual = {name: each.default for name, each in inspect.signature(work).parameters.items()}

    @wraps(work)
    def carried_out(json: Path | None = None, **given: Any) -> None:
        wrong = [
            problem
            for name, mark in figures.items()
            if given[name] is not None and not (mark.or_infinite and given[name] == inf)
            for problem in implausible(_option(name), given[name], mark.quantity)
        ]
        wrong += problems(**given) if problems else ()
        if given.get("nominal") and given["sigmas"] not in (0.0, usual["sigmas"]):
            wrong.append(("--sigmas", "has no meaning with --nominal, which guarantees for exactly the figures stated"))
        wrong += output.another_file(json, given.values())
        if wrong:
            refuse(called, *wrong)
        files = {name: given[name] for name in ("prototype", "study", "scenario") if given.get(name)}
        with nullcontext() if sys.stderr.isatty() else output.lines(called), _errors_by_file(files):
            result = work(**given)
        echo(*map(str, result.files))
        if wrong := output.another_file(json, [*result.files, result.fields]):
            refuse(called, *wrong)
        output.write_json(json, result.fields)
        if not result.yes:
            raise typer.Exit(1)

    last = inspect.Parameter("json", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=_JsonOption)
    own = [each.replace(annotation=hints[name]) for name, each in inspect.signature(work).parameters.items()]
    carried_out.__signature__ = inspect.Signature([*own, last])  # type: ignore[attr-defined]
    carried_out.__annotations__ = hints | {"json": _JsonOption, "return": None}
    carried_out.__doc__ = about
    return carried_out


@contextmanager
def _errors_by_file(files: Mapping[str, Path]) -> Iterator[None]:
    """Say what is wrong with a record, by the name that stands in its file or the option's, of the file itself."""
    try:
        yield
    except Exception as error:
        from beamdesign.records import InputError, read_table

        if not isinstance(error, InputError) or error.source in map(str, files.values()):
            raise
        record, named = error.source.partition(", stage ")[0], list[str]()
        for option, path in files.items():
            with suppress(InputError):  # not yet come to
                if record in (str(read_table(path).get("name")), option):
                    named.append(str(path))
        if not named:
            raise
        raise InputError(f"{' or '.join(named)}{error.source.removeprefix(record)}", error.problems) from error


def _described(work: Callable[..., Any]) -> tuple[str, dict[str, str]]:
    """What a docstring tells of a command, and of each of its options."""
    about, _, arguments = inspect.cleandoc(work.__doc__ or "").partition("\n\nArgs:\n")
    each = re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", arguments, re.MULTILINE)
    return about, {name: " ".join(f"{words[:1].upper()}{words[1:]}".split()) for name, words in each}


def _marked(name: str, hint: Any, help: str | None) -> Any:
    """The type of an option with the mark by which typer knows it."""
    usual, usual_help = OPTIONS.get(name, (typer.Option(), None))
    given, mark = get_args(hint)[:2] if get_origin(hint) is Annotated else (hint, usual)
    mark = copy(mark)
    mark.help = help or usual_help
    if isinstance(mark, ArgumentInfo):
        mark.autocompletion = mark.autocompletion or usual.autocompletion
    elif mark.default is ...:  # else it goes by names of its own
        mark.param_decls = (_option(name),)
    return Annotated[given, mark]


def _option(name: str) -> str:
    """With its capitals, which typer would make small, and for a flag without the contrary."""
    return f"--{name.replace('_', '-')}"


def group(about: str, **more: Any) -> typer.Typer:
    """Commands under one name, with their help in plain letters: rich would cost a third of its time."""
    return typer.Typer(no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False, help=about, **more)


@contextmanager
def in_time(minutes: float | None, usually: str) -> Iterator[dict[str, Any]]:
    """Say how long the work takes, limit it, and say what was left out.

    Args:
        minutes: most of it; None for `time_limit.MINUTES`.
        usually: how long it takes where nothing limits it.

    Yields:
        fields of the answer, which are there when the block has ended.
    """
    most = time_limit.MINUTES if minutes is None else minutes
    limit = f"; the best so far is told after {most:g} min, later with --minutes M" if most < inf else ""
    output.note(f"expected time: {usually}{limit}")
    fields: dict[str, Any] = {}
    with time_limit.within(most) as found:
        yield fields
    fields |= {"complete": not found.left_out, "left_out": found.left_out}
    if found.left_out:
        some = ", ".join(found.left_out[:_TOLD]) + (" and others" if len(found.left_out) > _TOLD else "")
        echo(f"not all was tried in {most:g} min; left out: {some}. --minutes M with more of them goes on")


_TOLD = 6

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it: 128 and the number of the signal."""


@contextmanager
def resumed(words: Callable[[], str]) -> Iterator[None]:
    """For work that is kept: an interruption ends it with a line on what there is.

    Args:
        words: what is kept and how to go on; behind the word "interrupted".

    Raises:
        typer.Exit: with status 130 after Ctrl-C.
    """
    try:
        with undisguised():
            yield
    except KeyboardInterrupt:
        print(f"interrupted{words()}", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None


def implausible(option: str, value: float, quantity: str) -> list[tuple[str, str]]:
    """Why the figure of an option is refused; nothing where it lies in the range of its quantity."""
    from beamdesign import quantities
    from beamdesign.arguments import why_implausible

    reason = why_implausible(getattr(quantities, quantity), value, option.replace("-", "_"))
    return [(option, reason)] if reason else []


_DEPTH = 3
_MOST = 400
"""Entries of folders looked at, so that the shell never waits."""


def toml_files(incomplete: str) -> list[str]:
    """TOML files whose path begins as typed, those a few folders down included."""
    return sorted(str(path) for path in _below(incomplete) if path.suffix == ".toml")


def data_sets(incomplete: str) -> list[str]:
    """Folders with a dataset.toml whose path begins as typed."""
    return sorted(str(path.parent) for path in _below(incomplete) if path.name == "dataset.toml")


def _below(incomplete: str) -> list[Path]:
    """Files whose path begins as typed, nearest first; the shell keeps what begins with a point to itself."""
    begun = f"{glob.escape(incomplete)}*"
    found = chain.from_iterable(glob.iglob(begun + "/*" * depth) for depth in range(_DEPTH + 1))
    return [path for path in map(Path, islice(found, _MOST)) if path.is_file()]


OPTIONS: dict[str, tuple[OptionInfo | ArgumentInfo, str]] = {
    "prototype": (typer.Argument(autocompletion=toml_files), ""),
    "study": (typer.Argument(autocompletion=toml_files), ""),
    "file": (typer.Argument(autocompletion=toml_files), ""),
    "dataset": (typer.Argument(autocompletion=data_sets), ""),
    "out": (typer.Option("--out", metavar="DIR", callback=output.folder_to_write), ""),
    "outer_end_mass": (
        typer.Option("--outer-end-mass", metavar="LO:HI"),
        "Range of mass on the outer tip, kg; else the prototype's.",
    ),
    "sigmas": (
        Figure("Sigmas"),
        "Guarantee it for every rig whose figures are up to so many standard deviations of [tolerance] off, all at"
        " once; typical ones where none is stated.",
    ),
    "nominal": (typer.Option(), "Guarantee it for exactly the figures stated."),
    "minutes": (
        Figure("Minutes", or_infinite=True, metavar="M"),
        "Most time for an answer, the best so far; else 2. A larger one goes on searching.",
    ),
}
"""What means the same in every command, by the name of its parameter, with its help where that is the same too."""
OutFile = Annotated[Path | None, typer.Option("--out", metavar="FILE", callback=output.file_to_write)]
_JSON_HELP = "Write the result to this JSON file as well; `-` prints it, and nothing else, to standard output."
_JsonOption = Annotated[Path | None, typer.Option("--json", metavar="FILE", callback=json_target, help=_JSON_HELP)]


def figures_of(
    option: str, text: str, quantity: str, expected: str, separator: str = ",", count: int | None = None
) -> tuple[float, ...]:
    """The figures of an option that takes several as one word, all of one quantity.

    Args:
        option: its name.
        text: as it was given.
        quantity: of `beamdesign.quantities`.
        expected: what the option takes, in words.
        separator: between figures; those of a range, ":", ascend.
        count: how many; None for any number of them.

    Raises:
        InputError: where they are not as many figures, implausible or, in a range, descending.
    """
    try:
        values = tuple(float(part) for part in text.split(separator))
    except ValueError:
        values = ()
    if not values or count not in (None, len(values)):
        refuse(option, (text, f"expected {expected}"))
    if wrong := [problem for value in values for problem in implausible(option, value, quantity)]:
        refuse(option, (text, wrong[0][1]))
    if separator == ":" and values[0] > values[-1]:
        refuse(option, (text, f"empty range: {values[0]:g} is above {values[-1]:g}"))
    return values


def mass_range(text: str | None, default: tuple[float, float] | None, source: str | Path) -> tuple[float, float]:
    """The range of outer end masses in kg, from LO:HI or else from the prototype's payload.

    Raises:
        InputError: where neither gives a range of plausible masses.
    """
    if text is None:
        if default is None:
            refuse(source, ("payload.outer_end_mass_kg", "missing; give it there or as --outer-end-mass LO:HI"))
        return default
    expected = "two masses in kg as LO:HI, such as 0:6.8"
    low, high = figures_of("--outer-end-mass", text, "MassOrNone", expected, ":", 2)
    return low, high


def with_controller(path: Path) -> "Prototype":
    """Read a prototype that has a controller, and effects of the library alone.

    Raises:
        InputError: with everything that is in the way.
    """
    from beamdesign.records import Problem

    record, wrong = beamdesign.read_prototype(path), []
    if record.effects:
        from beamdesign.plant.assembly import sizes
        from beamdesign.plant.effects import problems

        wrong = problems(record.effects, sizes(record))
    if record.controller is None:
        wrong.append(Problem("controller", "missing; write it there, or let `beamdesign tune` find one"))
    if wrong:
        refuse(path, *wrong)
    return record


def write_drawn(out: Path, name: str, figure: Any, rows: Sequence[dict[str, Any]] = ()) -> list[Path]:
    """Write a figure, and the table that it is drawn from, as NAME in a folder, and say which files there are."""
    from beamdesign.columns import csv_text
    from beamdesign.report.canvas import save

    with fresh_folder(out) as fresh:
        files = [fresh / f"{name}.csv"] if rows else []
        for path in files:
            write_whole(path, csv_text(rows))
        files += save(figure, fresh / name)
    files = settled(files, fresh, out)
    echo(*map(str, files))
    return files


def by_stage(
    record: "Prototype", masses_kg: tuple[float, float], work: "Callable[[InStage], tuple[dict[str, Any], bool]]"
) -> CommandResult:
    """Do the work of a command stage by stage, and give its answer; a controller of one law is its only stage.

    The answer is that of the stage that governs: the first whose answer is no, else that of the least guaranteed
    bandwidth. Of several stages those of all stand in it under `stages`.

    Args:
        record: with its controller.
        masses_kg: payloads (least, most), of which each stage gets its own.
        work: gives fields of the answer, and whether it is yes.

    Raises:
        InputError: where some payloads are for no stage.
    """
    found = [work(stage) for stage in record.stages(masses_kg)]
    if record.schedule is not None:
        echo("each stage by itself, while the payload stays in its range; of changes: beamdesign certify-switching")
    return CommandResult(of_all(record, found), all(yes for _, yes in found))


def of_all(record: "Prototype", found: "list[tuple[dict[str, Any], bool]]") -> dict[str, Any]:
    """The answer of the stage that governs; of several stages with those of all under `stages`."""

    def reached(fields: dict[str, Any]) -> float:
        return (fields.get("guaranteed") or {}).get("bandwidth_Hz") or 0.0  # none where it is not proved

    answer, _ = min(found, key=lambda one: (one[1], reached(one[0])))
    return answer if record.schedule is None else answer | {"stages": [fields for fields, _ in found]}
