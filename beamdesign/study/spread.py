"""How the figures of a prototype spread: its [tolerance] as distributions of the keys of its file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from beamdesign.lumped import lumped_beam
from beamdesign.parameters import PARAMETERS
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem

CUT_SIGMAS = 4.0
"""Draws are of a normal distribution cut off here; 6 in 100 000 would lie beyond."""


@dataclass(frozen=True)
class Figure:
    """One figure that spreads.

    Attributes:
        key: where it stands in a prototype file.
        value: nominal; a pair for the payload range, whose ends spread together.
        deviation: relative standard deviation.
    """

    key: str
    value: float | tuple[float, float]
    deviation: float

    def at(self, sigmas: float) -> Any:
        """Its value so many standard deviations off."""
        factor = 1 + sigmas * self.deviation
        if isinstance(self.value, tuple):
            return [_rounded(part * factor) for part in self.value]
        return _rounded(self.value * factor)


def _rounded(value: float) -> float:
    return float(f"{value:.12g}")


def spreading(prototype: Prototype, instead: Mapping[str, float], sigmas: float = CUT_SIGMAS) -> tuple[Figure, ...]:
    """The figures of a prototype that have a tolerance, each beam's own.

    Lumped figures of beams that come from a geometry are spread as if measured: a measured figure wins.

    Args:
        prototype: the nominal one.
        instead: relative standard deviations by name of [tolerance] that replace its own.
        sigmas: largest number of deviations that will be asked for.

    Raises:
        InputError: where no figure has a tolerance, a name is unknown, or a figure would reach zero.
    """
    names = type(prototype.tolerance).model_fields
    unknown = [
        Problem(f"spread.tolerance.{n}", f"unknown; there are {', '.join(names)}") for n in instead if n not in names
    ]
    if unknown:
        raise InputError(prototype.name, unknown)
    deviation = prototype.tolerance.model_dump() | dict(instead)
    found: list[Figure] = []
    lumped = {name: lumped_beam(getattr(prototype, name)) for name in ("outer_beam", "inner_beam")}
    for row in PARAMETERS.values():
        beam = lumped.get(row.place.split(".")[0])
        measured = {} if beam is None else {"stiffness": beam.stiffness, "effective_mass": beam.mass}
        if (value := measured.get(row.tolerance, row.stated(prototype))) is not None:
            found.append(Figure(row.place, value, deviation[row.tolerance]))
    found = [figure for figure in found if figure.deviation > 0 and figure.value not in (0.0, (0.0, 0.0))]
    if not found:
        raise InputError(prototype.name, [Problem("tolerance", "states no standard deviation, so nothing spreads")])
    if wide := [figure for figure in found if figure.deviation * sigmas >= 1]:
        reason = "{:g} standard deviations of {:g} reach zero"
        raise InputError(prototype.name, [Problem(f.key, reason.format(sigmas, f.deviation)) for f in wide])
    return tuple(found)


def varied_at(figures: Sequence[Figure], sigmas: np.ndarray) -> dict[str, Any]:
    """Values by key, each figure so many standard deviations off; (n,)."""
    return {figure.key: figure.at(float(z)) for figure, z in zip(figures, sigmas, strict=True)}


def drawn(figures: Sequence[Figure], count: int, seed: int) -> np.ndarray:
    """(count, n) independent draws in standard deviations, for shares of which binomial bounds hold."""
    return from_unit(np.random.default_rng(seed).random((count, len(figures))))


def from_unit(unit: np.ndarray) -> np.ndarray:
    """Standard deviations of the cut normal distribution from shares between 0 and 1."""
    from scipy.stats import truncnorm

    return np.asarray(truncnorm.ppf(unit, -CUT_SIGMAS, CUT_SIGMAS))
