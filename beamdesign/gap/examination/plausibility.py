"""Whether a data set can be what it says it is: looked at after reading, before anything is concluded from it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from beamdesign.gap.data.dataset import Dataset, TimeRecord
from beamdesign.gap.examination import sound_records
from beamdesign.gap.examination.caution import Caution
from beamdesign.gap.examination.controller_equation import ControllerFit, controller_fit
from beamdesign.gap.examination.controller_words import contradictions, lost_by_recorder
from beamdesign.gap.examination.readings import Reading, as_it_stands, other_readings, other_units
from beamdesign.gap.examination.sound_responses import check_gains, check_responses
from beamdesign.gap.examination.typical_tolerances import with_tolerances
from beamdesign.records import InputError, Problem

__all__ = ["Caution", "Examination", "examine"]


@dataclass(frozen=True)
class Examination:
    """A data set with what is to be said about it.

    Attributes:
        data: the set without records that cannot be used; with typical tolerances where none are stated.
        warnings: named, in words.
        controllers: how each record that was kept obeys its controller, by name of the record.
    """

    data: Dataset
    warnings: tuple[Caution, ...] = ()
    controllers: Mapping[str, ControllerFit] = field(default_factory=dict)

    @property
    def limits_confidence(self) -> bool:
        """Whether a verdict on this set must not be a confident one."""
        return any(warning.limits_confidence for warning in self.warnings)

    @property
    def words(self) -> tuple[str, ...]:
        """Warnings as lines of text, those of reading first; what holds of several records alike is said once."""
        of: dict[tuple[str, bool], list[str]] = {}
        for warning in self.warnings:
            of.setdefault((warning.text, warning.left_out), []).append(warning.record)
        lines = (str(Caution("", ", ".join(names), text, out)) for (text, out), names in of.items())
        return (*self.data.warnings, *lines)


def examine(data: Dataset) -> Examination:
    """Check a data set.

    Args:
        data: as read.

    Raises:
        InputError: where a column is plainly not what its name says, or no usable evidence remains.
    """
    prototype, missing = with_tolerances(data.prototype)
    data = replace(data, prototype=prototype)
    warnings = list(missing)
    records = _usable(data.records, sound_records.signals, warnings)
    records = _usable(records, lambda r: sound_records.law(r, data.prototype), warnings)
    warnings += _refuse_misread(data, records)
    records = _usable(records, lambda r: sound_records.suitability(r, data.prototype), warnings)
    found = sound_records.twins(records)
    warnings += found
    records = _without(records, found)
    held = {r.name: controller_fit(r, data.prototype.sensor.gain_V_per_m) for r in records}
    fits = {name: fit for name, fit in held.items() if fit is not None}
    warnings = [lost_by_recorder(caution, fits) for caution in warnings]
    records = _without(records, warnings)
    stuck = [caution.record for caution in warnings if caution.name == "stuck"]
    found = contradictions([r for r in records if r.name in fits and r.name not in stuck], fits, data.prototype)
    warnings += found
    records = _without(records, found)
    found = sound_records.masses(records, data.prototype)
    warnings += found
    records = _without(records, found)
    for record in records:
        warnings += sound_records.remarks(record, data.prototype)
    check_responses(data.responses, data.prototype)
    warnings += check_gains(data.gains, data.prototype, data.folder)
    if data.records and not records and not (data.responses or data.gains):
        raise InputError(data.folder, [Problem(w.record or "record", w.text) for w in warnings if w.left_out])
    warnings = _half_gone(data.records, warnings)
    kept = {r.name: fits[r.name] for r in records if r.name in fits}
    return Examination(replace(data, records=tuple(records)), tuple(warnings), kept)


def _usable(
    records: Sequence[TimeRecord], check: "sound_records.Check", warnings: list[Caution]
) -> tuple[TimeRecord, ...]:
    kept = []
    for record in records:
        found = check(record)
        warnings += found
        if not any(caution.left_out for caution in found):
            kept.append(record)
    return tuple(kept)


def _without(records: Sequence[TimeRecord], found: Sequence[Caution]) -> tuple[TimeRecord, ...]:
    out = {caution.record for caution in found if caution.left_out}
    return tuple(record for record in records if record.name not in out)


def _half_gone(records: Sequence[TimeRecord], warnings: Sequence[Caution]) -> list[Caution]:
    """Where half the records had to go, what is left is no ground for confidence."""
    gone = {caution.record for caution in warnings if caution.left_out}
    if 2 * len(gone) < len(records) or not gone:
        return list(warnings)
    text = f"{len(gone)} of {len(records)} records had to be left out; what remains cannot bear a confident answer"
    return [*warnings, Caution("few_records", "", text, limits_confidence=True)]


def _refuse_misread(data: Dataset, records: Sequence[TimeRecord]) -> list[Caution]:
    """Refuse a set of which a column, read otherwise, would make sense; warn where a rig might do that too."""
    refused: dict[str, tuple[Reading, ...]] = {}
    doubtful: dict[str, tuple[Reading, ...]] = {}
    for record in records:
        if as_it_stands(record, data.prototype):
            if more := other_units(record, data.prototype):
                refused[record.name] = more
            continue
        found = other_readings(record, data.prototype)
        if found:
            (refused if found[0].sure else doubtful)[record.name] = found
    # A small factor (pounds for newtons) is believed where no record with that input speaks against it.
    if doubtful:
        alike = [r.name for r in records if r.excitation in ("disturbance", "both")]
        if all(name in doubtful or name in refused for name in alike):
            refused |= doubtful
    if not refused:
        return [
            Caution("units", name, f"{found[0].key}: perhaps {found[0].words}", limits_confidence=True)
            for name, found in doubtful.items()
        ]
    sources = {record.name: record.source or record.name for record in records}
    problems = []
    for name, readings in refused.items():
        problems += [(name, problem) for problem in _merged(readings)]
    if len(refused) == 1:
        raise InputError(sources[problems[0][0]], [problem for _, problem in problems])
    of: dict[Problem, list[str]] = {}
    for name, problem in problems:
        of.setdefault(problem, []).append(name)
    raise InputError(data.folder, [Problem(p.key, f"{', '.join(names)}: {p.reason}") for p, names in of.items()])


def _merged(readings: Sequence[Reading]) -> list[Problem]:
    """One problem per column; readings of several columns that explain as much are alternatives to the first."""
    first, *others = readings
    if all(reading.fault == 0 for reading in readings):
        return [Problem(reading.key, reading.words) for reading in readings]
    words = "; or ".join(f"{reading.key}: {reading.words}" for reading in others[:2])
    return [Problem(first.key, first.words + (f" (or else {words})" if words else ""))]
