"""From measured files to a data set: which column is which, in which unit, with which sign; all of it told.

What can be told from names and units is not asked. Where two columns may be meant, or none, nothing is guessed: the
answer says which there are, and how to name one.
"""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from io import StringIO
from itertools import count
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from beamdesign.arguments import takes
from beamdesign.bench_prototype import AnyPrototype, BenchPrototype, read_any_prototype
from beamdesign.controllers import Controller
from beamdesign.diagnosis.data.bench_set import BenchSet, read_bench_set, runs_of
from beamdesign.diagnosis.data.channels import NOTHING, Channels, asked, channels_of
from beamdesign.diagnosis.data.dataset import Dataset, read_dataset
from beamdesign.diagnosis.data.measured_files import (
    NUMBER,
    SPELT,
    UNITS,
    Column,
    Measured,
    Response,
    numbers_of,
    read_measured,
    unit_of,
)
from beamdesign.diagnosis.data.stamps import Clock, evened, filled
from beamdesign.files import fresh_folder, write_whole
from beamdesign.prototype import Prototype
from beamdesign.quantities import MassOrNone, range_of
from beamdesign.records import InputError, Problem
from beamdesign.result import Result, finite
from beamdesign.structure.arm import in_plane

_ANOTHER = (
    "; each file is a record of its own, so what another recorder wrote goes into it first: shift its times until a"
    " channel that both recorded agrees, and interpolate its columns at the times of this file"
)
_PER_FORCE = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "g": 9.80665}


@dataclass(frozen=True)
class Taken:
    """What became of one channel.

    Attributes:
        channel: column of the record; empty for columns that were not taken.
        name: of the column it is from; empty where it is zero throughout.
        unit: that it was taken in.
        factor: it was multiplied by, sign included.
        offset: that was taken off, in the unit of the channel.
        words: what was assumed; empty where nothing was.
    """

    channel: str
    name: str
    unit: str = ""
    factor: float = 1.0
    offset: float = 0.0
    words: str = ""

    def row(self) -> tuple[str, str, str]:
        """Channel, what it is from, and what was assumed."""
        factor = "" if self.factor == 1 else f" x {self.factor:.6g}"
        offset = f", {self.offset:.4g} taken off" if self.offset else ""
        source = f"{self.name}{f' [{self.unit}]' * bool(self.unit)}{factor}{offset}" if self.name else "0"
        return self.channel, source, self.words


@dataclass(frozen=True, repr=False)
class Imported(Result):
    """A data set that was written, and what each of its records was taken from."""

    dataset: Dataset | BenchSet
    taken: Mapping[str, tuple[Taken, ...]]
    paths: tuple[Path, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as `gap import --json` writes them."""
        return finite({"taken": self.taken, "files": self.paths})

    def rows(self) -> list[tuple[str, str, str, str]]:
        """File, channel, what it is from, and what was assumed."""
        return [(name.removeprefix("records/"), *one.row()) for name, of in self.taken.items() for one in of]


@takes()
def import_measured(
    files: Sequence[Path | str] | Path | str,
    prototype: Path | str,
    out: Path | str,
    columns: Sequence[str] = (),
    outer_end_masses_kg: Sequence[float] | float = (0.0,),
    inner_end_mass_kg: float | None = None,
    rest_s: float = 0.0,
    stages: Sequence[int] = (),
    clock: Clock | None = None,
) -> Imported:
    """Write a data set of measured files: records/NAME.csv, dataset.toml and the prototype.

    Runs of a bench with the same command are one condition; neither masses nor stages nor a rest are stated of them.

    Args:
        files: CSV, MATLAB and universal files, or one.
        prototype: the model that was believed, with its controller.
        out: folder.
        columns: that names and units do not tell, each `CHANNEL = NAME [UNIT]`, with a minus sign before NAME to turn
            it round; of several of one channel that counts which a file has. `t_s = 0.001 [s]` states the interval
            where no column has times.
        outer_end_masses_kg: payload of every file, or one for all.
        inner_end_mass_kg: mass added inside; that of the prototype where None.
        rest_s: how long everything rests at the beginning: the mean of that time is taken off. Every record goes on
            after it.
        stages: of a scheduled controller the number, from 1, of the stage that acted: of every file, or one for all;
            not needed where a payload lies in the range of one stage alone.
        clock: whether stamps that jitter are of an even clock (`even`) or tell when samples were really taken
            (`stamps`), which become values at even times; else the samples tell. Of a bench stamps stay as they are.

    Raises:
        InputError: with everything that cannot be told, and how to tell it.
    """
    prototype, out = Path(prototype), Path(out)
    files = [files] if isinstance(files, Path | str) else files
    if twice := [str(path) for path, count in Counter(Path(f).resolve() for f in files).items() if count > 1]:
        raise InputError("gap import", [("FILES", f"{', '.join(twice)} stands there more than once")])
    if (out / "dataset.toml").exists():
        raise InputError(out, [("--out", "holds a data set already, which is not written over; name another folder")])
    model = read_any_prototype(prototype)
    channels = channels_of(model)
    named, bench = asked(columns, channels), isinstance(model, BenchPrototype)
    masses = [outer_end_masses_kg] if isinstance(outer_end_masses_kg, float | int) else [*outer_end_masses_kg]
    stated = _stated(model, files, masses, inner_end_mass_kg, rest_s, stages)
    entries: dict[str, list[dict[str, object]]] = {"record": [], "frequency_response": []}
    taken, tables, sources = dict[str, tuple[Taken, ...]](), dict[str, Mapping[str, np.ndarray]](), dict[str, Path]()
    for path, at in zip(map(Path, files), stated, strict=True):
        found = read_measured(path)
        if found.responses and bench:
            raise InputError(path, [(found.responses[0].name, "a bench has no frequency responses")])
        if found.columns:
            name = f"records/{_fresh(path.stem, tables)}.csv"
            raw, rows, done = _record(found, named, channels, rest_s)
            tables[name], put = (raw, "") if bench else evened(path, raw, clock)
            taken[name] = tuple(replace(one, words=put) if put and one.channel == "t_s" else one for one in rows)
            sources[name] = path
            recorded = {} if bench or "current_A" in tables[name] else {"current_recorded": False}
            note = {"note": "; ".join(filter(None, (*done, put)))} if done or put else {}
            entries["record"].append(at | {"file": name} | recorded | note)
        for response in found.responses:
            name = f"records/{_fresh(f'{path.stem}_{response.name}', tables)}.csv"
            tables[name], taken[name] = _compliance(response, path)
            sources[name] = path
            entries["frequency_response"].append(at | {"file": name})
    made = {"prototype.toml": prototype.read_bytes()} | dict.fromkeys(tables, b"")
    if there := [name for name, held in made.items() if (out / name).exists() and (out / name).read_bytes() != held]:
        reason = f"holds {', '.join(there)} already, which is not written over; name another folder"
        raise InputError(out, [("--out", reason)])
    if bench:
        entries["record"] = runs_of(tables)
    rig = {"rig": model.rig} if bench else {}
    listed = {key: rows for key, rows in entries.items() if rows}
    index = {"name": out.resolve().name, **rig, "prototype": "prototype.toml", **listed}
    read = read_bench_set if bench else read_dataset
    with fresh_folder(out) as fresh:
        (fresh / "records").mkdir(exist_ok=True)
        for name, table in tables.items():
            write_whole(fresh / name, _csv(table))
        write_whole(fresh / "prototype.toml", prototype.read_text(encoding="utf-8"))
        write_whole(fresh / "dataset.toml", tomli_w.dumps(index))
        try:
            read(fresh)
        except InputError as error:  # which leaves nothing behind, so that what was given is named
            given = {str(fresh / name): f"{path}, as {name}" for name, path in sources.items()}
            source = given.get(error.source, error.source.replace(str(fresh), str(out)))
            raise InputError(source, error.problems) from error
    return Imported(read(out), taken, tuple(out / n for n in ("dataset.toml", "prototype.toml", *tables)))


def _stated(
    model: AnyPrototype,
    files: Sequence[Path | str],
    outer_end_masses_kg: Sequence[float],
    inner_end_mass_kg: float | None,
    rest_s: float,
    stages: Sequence[int],
) -> list[dict[str, object]]:
    """What dataset.toml states of each file: end masses, and the law that acted where it is given; of a bench nothing.

    Raises:
        InputError: for what cannot be, and what a bench does not have.
    """
    if isinstance(model, BenchPrototype):
        given = {"--outer-end-mass": any(outer_end_masses_kg), "--inner-end-mass": inner_end_mass_kg is not None}
        given |= {"--rest-s": rest_s != 0, "--stage": len(stages) > 0}
        if wrong := [(option, "is nothing that a bench has") for option, said in given.items() if said]:
            raise InputError("gap import", wrong)
        return [{}] * len(files)
    masses = _of_each(files, "--outer-end-mass", outer_end_masses_kg)
    inner = model.payload.inner_end_mass_kg if inner_end_mass_kg is None else inner_end_mass_kg
    plausible, stated = range_of(MassOrNone), (("--outer-end-mass", masses), ("--inner-end-mass", [inner]))
    off = ((option, kg) for option, some in stated for kg in some if kg not in plausible)
    if wrong := [(option, plausible.refusal(kg, "mass_kg")) for option, kg in off]:
        raise InputError("gap import", wrong)
    laws = (law and law.model_dump(mode="json", exclude_none=True) for law in _acted(model, files, masses, stages))
    return [
        {"outer_end_mass_kg": mass, "inner_end_mass_kg": inner} | ({"controller": law} if law else {})
        for mass, law in zip(masses, laws, strict=True)
    ]


def _acted(
    model: Prototype, files: Sequence[Path | str], masses_kg: Sequence[float], stages: Sequence[int]
) -> list[Controller | None]:
    """The law that acted in each file, where the stage is given; else None, by which it is told from the payload.

    Raises:
        InputError: where that cannot be told, and for stages that there are not.
    """
    if (schedule := in_plane(model).schedule) is None:
        if stages:
            raise InputError("gap import", [("--stage", f"{model.name} has no scheduled controller")])
        return [None] * len(files)
    stages = stages and _of_each(files, "--stage", stages)
    laws, wrong = [law for law, _ in schedule.laws], list[Problem]()
    if none := sorted({stage for stage in stages if not 1 <= stage <= len(laws)}):
        wrong.append(Problem("--stage", f"there is no {', '.join(map(str, none))}; stages are 1 to {len(laws)}"))
    for path, mass in () if stages else zip(files, masses_kg, strict=True):
        try:
            schedule.law_for(mass)
        except ValueError as error:
            wrong.append(Problem("--stage", f"of {path}: {error}; give the number of the stage that acted"))
    if wrong:
        raise InputError("gap import", wrong)
    return [laws[stage - 1] for stage in stages] if stages else [None] * len(files)


def _of_each(files: Sequence[Path | str], option: str, given: Sequence[Any]) -> list[Any]:
    """What is given of each file, or of all of them at once; refused where it is neither."""
    if len(given) not in (1, len(files)):
        reason = f"give one for all, or one for each of {len(files)} files; there are {len(given)}"
        raise InputError("gap import", [(option, reason)])
    return [*given] * (len(files) if len(given) == 1 else 1)


def _csv(table: Mapping[str, np.ndarray]) -> str:
    text = StringIO()
    np.savetxt(text, np.column_stack(list(table.values())), "%.9g", ",", header=",".join(table), comments="")
    return text.getvalue()


def _fresh(name: str, known: Mapping[str, object]) -> str:
    """A file name of plain letters that no other record has."""
    plain = re.sub(r"[^A-Za-z0-9_.-]+", "_", name).strip("_.") or "record"
    names = (plain if k == 1 else f"{plain}_{k}" for k in count(1))
    return next(name for name in names if f"records/{name}.csv" not in known)


def _record(
    found: Measured, named: Mapping[str, Sequence[tuple[str, str, float]]], channels: Channels, rest_s: float
) -> tuple[dict[str, np.ndarray], tuple[Taken, ...], list[str]]:
    """Columns, what they are from, and what was done to them."""
    table, taken, wrong = dict[str, np.ndarray](), list[Taken](), list[Problem]()
    chosen, signs = dict[str, Column](), dict[str, float]()
    free, there = list(found.columns), f"the file has {_listed(found.columns)}"
    for channel, ways in named.items():
        meant = [(column, way) for way in ways for column in _called(*way[:2], found)]
        numbers = [way for way in ways if NUMBER.match(way[0])]
        if channel not in channels.needed and not meant and any(name == NOTHING for name, _, _ in numbers):
            continue
        if channel == "t_s" and not meant:
            sample = np.arange(len(found.columns[0].values))
            meant = [(Column(way[0], "s", numbers_of([way[0]])[0] * sample), way) for way in numbers]
        if len(meant) == 1:
            ((column, (_, unit, signs[channel])),) = meant
            chosen[channel] = replace(column, unit=unit or column.unit)
            free = [one for one in free if one is not column]
        else:
            are = f"are {len(meant)} columns" if meant else "is no column"
            which = ": name one with its own unit, as NAME [UNIT], or rename one in the file" if meant else ""
            names = " or ".join(repr(name) for name, _, _ in ways)
            wrong.append(Problem(channel, f"there {are} {names}{which}; {there}"))
    for channel in (one for one in channels.known if one not in named):
        alike = channels.alike(channel, free)
        if len(alike) == 1:
            chosen[channel] = alike[0]
            free.remove(alike[0])
        elif not alike and (other := channels.alike(channel, found.others)):
            lengths = f"{len(other[0].values)} values, where the others have {len(found.columns[0].values)}"
            wrong.append(Problem(channel, f"{other[0].name!r} has {lengths}: give all of them at the same times"))
        elif alike or channel in (*channels.needed, *channels.asked):
            names = " or ".join(repr(one.name) for one in alike)
            which = f"may be {names}" if alike else "is not told by any name or unit"
            none = f", or say that there is none, --column '{channel} = {NOTHING}'"
            if channel in channels.needed:
                none = ", or state the interval, --column 't_s = 0.001 [s]'" if channel == "t_s" else _ANOTHER
            how = f"name it, --column '{channel} = NAME [UNIT]'{none}"
            wrong.append(Problem(channel, f"{which}: {how}; {there}"))
    if channels.either and not {*channels.either} & {*chosen, *(problem.key for problem in wrong)}:
        how = f"--column '{channels.either[0]} = NAME [UNIT]'"
        words = f"is not told by any name, and no other of {', '.join(channels.either)}: name one, {how}"
        wrong.append(Problem(channels.either[0], f"{words}; {there}"))
    asked_for = {*chosen, *named, *(problem.key for problem in wrong)}
    for channel in (one for one in channels.inputs if one not in asked_for):
        why, how = "by its unit", f"name it, --column '{channel} = NAME [UNIT]'"
        if not (perhaps := channels.by_unit(channel, free)) and (perhaps := channels.by_name(channel, free)):
            why = f"by its name, though not by its unit {perhaps[0].unit!r}"
            how = f"give it in {', '.join(UNITS[channels.known[channel][0]])}"
        if perhaps:
            which, none = " or ".join(repr(one.name) for one in perhaps), f"--column '{channel} = {NOTHING}'"
            wrong.append(Problem(channel, f"may be {which}, {why}: {how}, or say that there is none, {none}"))
    # A row without a time is none; where the interval is stated instead, it is a sample that was lost.
    rows = ~np.all([np.isnan(column.values) for column in chosen.values()] or [[]], axis=0)
    for channel, column in chosen.items():
        said = column.unit or channels.ending(channel, column.name)
        factor, words = channels.factor(channel, said)
        if factor is None:
            wrong.append(Problem(channel, f"{column.name!r} is in {said!r}: {words}"))
            continue
        sign = signs.get(channel, 1.0)
        values = column.values[rows]
        table[channel] = sign * factor * values
        missing = ~np.isfinite(values) if channel == "t_s" else np.isinf(values)
        if lost := np.flatnonzero(missing).tolist():
            first = f"the first is number {lost[0] + 1} of {len(values)}"
            wrong.append(Problem(channel, f"{column.name!r} has {len(lost)} values that are not finite: {first}"))
        taken.append(Taken(channel, column.name, said or channels.known[channel][0], sign * factor, 0.0, words))
    if wrong:
        raise InputError(found.path, wrong)
    table, notes = filled(found.path, table)
    taken = [replace(one, words="; ".join(filter(None, (one.words, notes.get(one.channel))))) for one in taken]
    table["t_s"] = table["t_s"] - table["t_s"][0]
    length = float(np.ptp(table["t_s"]))
    if rest_s and not 0 < rest_s < length:
        reason = f"is {rest_s:g} s; it is to end before the record does, at {length:g} s"
        raise InputError(found.path, [("--rest-s", reason)])
    resting = table["t_s"] < rest_s
    for k, one in enumerate(taken):
        if one.channel != "t_s" and resting.any():
            offset = float(table[one.channel][resting].mean())
            table[one.channel] = table[one.channel] - offset
            taken[k] = replace(one, offset=offset)
    for channel in (one for one in channels.inputs if one not in table):
        table[channel] = np.zeros(len(table["t_s"]))
        taken.append(Taken(channel, "", words="no column: taken as zero"))
    if free:
        taken.append(Taken("", _listed(free), words="not taken"))
    return {channel: table[channel] for channel in channels.known if channel in table}, tuple(taken), [*notes.values()]


def _called(name: str, unit: str, found: Measured) -> list[Column]:
    """The columns of a name; of several those that are in the unit stated."""
    alike = [column for column in found.columns if column.name == name]
    return alike if len(alike) == 1 else [column for column in alike if unit in ("", column.unit)] or alike


def _listed(columns: Sequence[Column]) -> str:
    return ", ".join(f"{one.name} [{one.unit}]" if one.unit else one.name for one in columns)


def _compliance(found: Response, path: Path) -> tuple[dict[str, np.ndarray], tuple[Taken, ...]]:
    """Magnitude and phase of the compliance: a velocity is divided by j w, an acceleration by -w^2.

    Per volt of the command it is a response to that. Where the phase is not known there is none.
    """
    above = found.frequency_Hz > 0
    s = 2j * pi * found.frequency_Hz[above]
    answer, _, over = found.unit.translate(SPELT).replace(" ", "").rpartition("/")
    answer, over = (answer, over) if answer else (over, "")
    driven = "V" if unit_of(over) == "V" else "N"
    length = re.sub(r"/s(\^?2|²|/s)?$", "", answer)
    scale = _PER_FORCE.get(length or "m")
    newton = UNITS[driven].get(over or "N")
    if scale is None or newton is None:
        reason = f"its unit {found.unit!r} is no motion over a force or a command that is known here, such as mm/N"
        raise InputError(path, [(found.name, reason)])
    power = {"displacement": 0, "velocity": 1, "acceleration": 2}[found.answer]
    values = found.values[above] * scale / newton / s**power
    words = "" if found.unit else "no unit stated: taken as SI over N"
    words = "; ".join(part for part in (words, f"{found.answer} divided by (j w)^{power}" if power else "") if part)
    column = f"magnitude_m_per_{driven}"
    table = {"frequency_Hz": found.frequency_Hz[above], column: np.abs(values)}
    if np.iscomplexobj(found.values):
        table["phase_deg"] = np.degrees(np.unwrap(np.angle(values)))
    return table, (Taken(column, found.name, found.unit, scale / newton, 0.0, words),)
