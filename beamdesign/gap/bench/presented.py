"""The diagnosis of a bench as any other diagnosis is printed, drawn and written."""

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from beamdesign.gap.bench.diagnosis import BenchDiagnosis
from beamdesign.gap.bench.replay import ReplayError
from beamdesign.gap.diagnosis import Cause, Diagnosis, Estimate, Gap, NextExperiment, RecordGap, Verdict, Where, Witness

_NAMES = {1: "extending", -1: "retracting"}


@dataclass(frozen=True)
class PresentedBench(Diagnosis):
    """A bench's answer in the common form; its gap is one of steady motions.

    Attributes:
        notes: what cannot be told apart, what is suspicious, in words.
    """

    notes: tuple[str, ...] = ()


def presented(name: str, found: BenchDiagnosis) -> PresentedBench:
    """Put a bench's answer into the common form.

    Its gap is that of steady motions on conditions held out: relative errors of speed, and of pressure over the supply.
    A bench's probabilities are those among known causes, so that of an unknown one is not a number here.

    Args:
        name: of the data set.
        found: the bench's diagnosis; its prototype is one of a bench, and stands as such in the answer.
    """
    causes = tuple(
        Cause(
            c.name,
            c.subsystem,
            c.probability,
            c.share,
            {key: Estimate(float(value), float(std)) for key, (value, std) in c.parameters.items()},
        )
        for c in found.causes
    )
    gap = found.gap
    records = tuple(row for each in found.replay for row in _channels(each))
    return PresentedBench(
        name,
        cast(Verdict, found.verdict),
        found.reason,
        causes,
        found.chosen,
        np.nan,
        _where(found, causes),
        Gap(gap.before, gap.retuned, gap.after, gap.noise_floor, gap.closed, gap.closed_interval, records),
        (),
        _next(found),
        cast(Any, found.prototype),
        found.warnings,
        notes=found.notes,
    )


def _where(found: BenchDiagnosis, causes: tuple[Cause, ...]) -> Where:
    """Steady motion is slow: the band ends at the strokes per second of the fastest condition."""
    if not found.table:
        return Where("", (0.0, 0.0), "")
    fastest = max(abs(row.speed) for row in found.table) / found.prototype.actuator.stroke_m
    worst = max(found.table, key=lambda row: abs(row.predicted[0] - row.speed))
    place = next((c.subsystem for c in causes if c.name in found.chosen), "")
    table: dict[str, tuple[object, ...]] = {
        "condition": tuple(row.condition for row in found.table),
        "direction": tuple(_NAMES[row.direction] for row in found.table),
        "speed_m_per_s": tuple(row.speed for row in found.table),
        "predicted_m_per_s": tuple(row.predicted[0] for row in found.table),
        "pressure_a_Pa": tuple(row.pressures[0] for row in found.table),
        "pressure_b_Pa": tuple(row.pressures[1] for row in found.table),
        "net_force_N": tuple(row.net_force_N for row in found.table),
    }
    text = (
        "Speed and pressures while the piston moves steadily, against those of the chosen causes fitted without each"
        f" condition; the largest error of speed is left at {worst.condition}, {_NAMES[worst.direction]}."
    )
    witness = Witness("steady motions", place, 1.0 if place else 0.0, text, table)
    condition = "in steady motion, at every command that was tried"
    return Where(place, (0.0, float(f"{fastest:.3g}")), condition if place else "", "static", (witness,))


def _channels(each: ReplayError) -> list[RecordGap]:
    """Errors of a condition's simulated records, by channel; nothing lies between believed and diagnosed there."""
    rows = []
    for channel, before in each.before.items():
        floor = each.floor.get(channel, np.nan)
        rows.append(RecordGap(f"{each.condition}, {channel}", True, before, np.nan, each.after[channel], float(floor)))
    return rows


def _next(found: BenchDiagnosis) -> NextExperiment | None:
    asked = found.next_experiment
    if asked is None:
        return None
    text = (
        f"Run the piston out and back at {asked.command_V:.3g} V and measure {asked.channel.replace('_', ' ')}:"
        " there the sets of causes that are left differ most."
    )
    names = tuple(" + ".join(ranked.hypothesis.names) or "no cause" for ranked in found.ranked[:4])
    return NextExperiment(text, names, asked.separation, {"command_V": asked.command_V, "channel": asked.channel})
