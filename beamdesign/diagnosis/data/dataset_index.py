"""dataset.toml: which files came back from a rig, and how each was taken."""

import difflib
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, SerializeAsAny

from beamdesign import quantities as q
from beamdesign import records
from beamdesign.controllers import Controller, Proportional
from beamdesign.files import wrong_kind
from beamdesign.quantities import range_of
from beamdesign.records import FileName, InputError, Longest, Problem, Record

_TOLD = 20  # entries whose files are wrong that are spelt out
_ALIKE = 0.8  # how much of a key must be as in one of ours to be taken for it misspelt


class Taken(Record):
    """What every entry of a data set says of the rig at that time."""

    outer_end_mass_kg: Annotated[q.MassOrNone, Field(description="mass on the outer tip while it was taken")] = 0.0
    inner_end_mass_kg: Annotated[q.MassOrNone, Field(description="mass on the inner tip while it was taken")] = 0.0


OFF = Proportional(gain_A_per_V=range_of(q.LawGain).low)
"""What acts with the servo off: a law that asks for as good as no current."""


class Looped(Taken):
    """What was taken in a loop, or with the servo off."""

    controller: SerializeAsAny[Controller] | None = None
    servo_off: Annotated[
        bool, Field(description="whether no current was asked for: valve shut, or drive of a motor without command")
    ] = False

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """With the servo off no law acts."""
        if table.get("servo_off") and table.get("controller") is not None:
            yield Problem("servo_off", "stands beside a controller, of which none acts then: leave one of them out")

    @property
    def law(self) -> Controller | None:
        """That acted, as far as the entry says; `OFF` with the servo off."""
        return OFF if self.servo_off else self.controller


class TimeEntry(Looped):
    """A time record."""

    file: Annotated[
        FileName,
        Field(description="CSV file beside dataset.toml: t_s, disturbance_N, command_V, current_A, displacement_m"),
    ]
    current_recorded: Annotated[
        bool, Field(description="whether it has the current; without, its controller's equation cannot be checked")
    ] = True
    left_out_s: Annotated[
        tuple[tuple[float, float], ...],
        Field(description="spans of time, each from its beginning to its end, that are not to count"),
    ] = ()
    note: Annotated[
        str, Longest(1000), Field(description="what was done to it before it came here; a diagnosis says so")
    ] = ""

    def refuse_spans(self, index: Path, begin: float, end: float) -> None:
        """Refuse spans of a dataset.toml that do not lie within the record, s, or leave out more than half of it."""
        for span in self.left_out_s:
            if not begin <= span[0] < span[1] <= end:
                words = f"of {self.file}: {list(span)} is no span within its {begin:g} to {end:g} s, beginning first"
                raise InputError(index, [("record.left_out_s", words)])
        if 2 * sum(last - first for first, last in self.left_out_s) > end - begin:
            words = f"of {self.file}: leaves out more than half of it; give the rest as a record of its own"
            raise InputError(index, [("record.left_out_s", words)])


class ResponseEntry(Looped):
    """A frequency response."""

    file: Annotated[
        FileName,
        Field(
            description="CSV file beside dataset.toml: frequency_Hz, magnitude_m_per_N (under a force) or"
            " magnitude_m_per_V (under a command), and optionally phase_deg"
        ),
    ]
    amplitude_N: Annotated[
        q.Force | None, Field(description="amplitude of the force it was taken with; without it, small motion is meant")
    ] = None
    amplitude_V: Annotated[q.Voltage | None, Field(description="the same of a command")] = None


class GainEntry(Taken):
    """A critical gain."""

    controller: Annotated[
        dict[str, Any] | None,
        Field(description="the law whose gain was raised, without the gain; none: the prototype's"),
    ] = None
    gain_A_per_V: Annotated[q.LawGain, Field(description="gain at which sustained oscillation set in")]
    relative_std: Annotated[q.PositiveStd, Field(description="relative standard deviation of that gain")] = 0.03
    frequency_Hz: Annotated[q.Frequency | None, Field(description="frequency of the oscillation")] = None
    load_N: Annotated[q.SignedForce, Field(description="constant force on the outer tip while it was taken")] = 0.0
    predicted_gain_A_per_V: Annotated[q.LawGain | None, Field(description="what its builders had predicted")] = None


class SetFile(Record):
    """What every dataset.toml says."""

    name: Annotated[str, Field(description="what the set is called in reports")] = "data set"
    rig: Annotated[str, Field(description="kind of rig it came from: twin_beam or actuator_bench")] = "twin_beam"
    prototype: Annotated[FileName, Field(description="file of the model that was believed, beside dataset.toml")] = (
        "prototype.toml"
    )


class Index(SetFile):
    """The whole file."""

    record: tuple[TimeEntry, ...] = ()
    frequency_response: tuple[ResponseEntry, ...] = ()
    critical_gain: tuple[GainEntry, ...] = ()


def index_of(folder: Path) -> Path:
    """The dataset.toml of a folder, or that file itself."""
    return folder if folder.is_file() else folder / "dataset.toml"


def kind_of(folder: str | Path) -> str:
    """Kind of rig a data set came from: `twin_beam` or `actuator_bench`.

    Raises:
        InputError: where the folder holds no readable dataset.toml.
    """
    return str(records.read_table(index_of(Path(folder))).get("rig", "twin_beam"))


def read_index(path: Path) -> tuple[Index, list[str]]:
    """Read dataset.toml.

    Returns:
        what it says, and warnings of keys that were left aside.

    Raises:
        InputError: with everything wrong in it.
    """
    raw = records.read_table(path)
    if single := [key for key in _KINDS if isinstance(raw.get(key), dict)]:
        words = "must be a list of tables: write [[{}]] with double brackets"
        raise InputError(path, [Problem(key, words.format(key)) for key in single])
    table, warnings = _known_keys(raw)
    entry = records.parse(Index, table, path)
    if entry.rig != "twin_beam":
        reads = "; beamdesign.read_bench_set reads it" if entry.rig == "actuator_bench" else ""
        raise InputError(path, [("rig", f"{entry.rig!r} is not a rig this reader knows; expected 'twin_beam'{reads}")])
    folder, named = path.parent, entry.prototype
    problems = [] if os.path.isfile(folder / named) else [Problem("prototype", _no_file(folder, named))]
    problems += wrong_files("record.file", [row.file for row in entry.record], folder)
    problems += wrong_files("frequency_response.file", [row.file for row in entry.frequency_response], folder)
    if not (entry.record or entry.frequency_response or entry.critical_gain):
        if other := wrong_kind(raw, "Index", str(path)):
            raise InputError(path, [Problem("(whole file)", other)])
        problems.append(Problem("record", "the set holds no record, no frequency_response and no critical_gain"))
    if problems:
        raise InputError(path, problems)
    return entry, warnings


_KINDS: dict[str, type[Taken]] = {"record": TimeEntry, "frequency_response": ResponseEntry, "critical_gain": GainEntry}


def _known_keys(table: dict[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """What is left of a table without unknown keys, and a warning of each that went."""
    warnings: list[str] = []

    def known(part: dict[str, Any], shape: type[Record], words: str) -> dict[str, Any]:
        ours = shape.model_fields  # what looks like one of them is a mistake of unit or letter, to be refused later
        unknown = [key for key in part if key not in ours and not difflib.get_close_matches(key, ours, 1, _ALIKE)]
        warnings.extend(f"dataset.toml: {words}{key} is not known here and was left aside" for key in unknown)
        return {key: value for key, value in part.items() if key not in unknown}

    kept = known(table, Index, "key ")
    for key, shape in _KINDS.items():
        if isinstance(rows := kept.get(key), list):
            kept[key] = [known(row, shape, f"{key}.") if isinstance(row, dict) else row for row in rows]
    return kept, list(dict.fromkeys(warnings))


def wrong_files(key: str, files: Sequence[str], folder: Path) -> list[Problem]:
    """What is wrong with the files that the entries of a list name: there is none, or an earlier entry is called so.

    Args:
        key: of the problems.
        files: as they are named, one per entry.
        folder: of the dataset.toml.
    """
    wrong, first = [], dict[str, int]()
    for k, file in enumerate(files, start=1):
        if not os.path.isfile(folder / file):  # unlike is_file, bears names that no file can have
            wrong.append(Problem(key, f"entry {k}: {_no_file(folder, file)}"))
        elif (earlier := first.setdefault(Path(file).stem, k)) != k:
            other = files[earlier - 1]
            words = "the same file as" if (folder / file).samefile(folder / other) else f"called like {other} of"
            wrong.append(Problem(key, f"entry {k}: {file} is {words} entry {earlier}; each needs a name of its own"))
        if len(wrong) > _TOLD:
            return [*wrong[:-1], Problem(key, f"and perhaps more of the {len(files) - k + 1} entries from {k} on")]
    return wrong


def _no_file(folder: Path, file: str) -> str:
    """What to say of a file that is not there: its folder may hold one of a similar name."""
    if not file or os.path.exists(folder / file):
        return f"no regular file {file!r}"
    around = (folder / file).parent
    if not os.path.isdir(around):
        return f"no file {file}: there is no folder {Path(file).parent}"
    close = difflib.get_close_matches(Path(file).name, sorted(p.name for p in around.iterdir() if p.is_file()), 1)
    return f"no file {file}" + (f"; did you mean {(Path(file).parent / close[0]).as_posix()}?" if close else "")
