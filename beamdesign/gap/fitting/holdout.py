"""Which records are kept out of every fit, to measure the gap on."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from beamdesign.gap.data.dataset import TimeRecord

_SHARE = 0.25


def held_out(records: Sequence[TimeRecord]) -> tuple[int, ...]:
    """Positions of a quarter of the records, rounded, at least one of two.

    Each must be a condition of its own whose parts (payload, excitation and, where it can be, controller) are known to
    the fits from other records, and smaller than the largest of its kind: to predict it is to combine, not to guess,
    and what shows only at the largest amplitude (a limit) must be seen by the fits. Among such choices the most
    different records are taken, and of those the most strongly excited.

    Returns:
        none where there is one record only, or where no choice leaves the fits such a view.
    """
    count = max(1, round(_SHARE * len(records)))
    if len(records) < 2:
        return ()
    for demanding in (True, False):
        choices = [c for c in combinations(range(len(records)), count) if _known(records, c, demanding)]
        if choices:
            return max(choices, key=lambda chosen: _value(records, chosen))
    return ()


def _known(records: Sequence[TimeRecord], chosen: Sequence[int], demanding: bool) -> bool:
    rest = [r for k, r in enumerate(records) if k not in chosen]
    if any(r.condition == records[k].condition for k in chosen for r in rest):
        return False  # a replicate in the fits would give it away
    for k in chosen:
        record = records[k]
        alike = [r for r in rest if r.excitation == record.excitation]
        largest = max((_swing(r) for r in alike), default=0.0)
        if not any(_masses(r) == _masses(record) for r in rest) or largest < _swing(record):
            return False
        if demanding and not any(r.controller == record.controller for r in rest):
            return False
    return True


def _value(records: Sequence[TimeRecord], chosen: Sequence[int]) -> tuple[int, float]:
    different = len({_masses(records[k]) for k in chosen}) + len({records[k].excitation for k in chosen})
    largest: dict[str, float] = {}
    for record in records:
        largest[record.excitation] = max(largest.get(record.excitation, 0.0), _size(record))
    strength = sum(_size(records[k]) / max(largest[records[k].excitation], 1e-300) for k in chosen)
    return different, strength


def _size(record: TimeRecord) -> float:
    column = 1 if record.excitation == "command" else 0
    return float(np.sqrt(np.mean(record.inputs[:, column] ** 2)))


def _swing(record: TimeRecord) -> float:
    """Of the current, A: how hard the valve is driven."""
    return float(np.abs(record.measured["current_A"]).max())


def _masses(record: TimeRecord) -> tuple[float, float]:
    return record.outer_end_mass, record.inner_end_mass
