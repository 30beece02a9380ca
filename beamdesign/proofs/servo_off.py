"""The largest compliance with the servo off: no current in the valve, oil spring and leakage as they are.

The closed loop's compliance is this times the sensitivity. It is what the servo is to better, so that limits of the
closed loop's compliance are multiples of it. Everything here is found by numerics and rounded down: no figure is above
what the rig has, so that a limit that is a multiple of it is no laxer than stated.
"""

from collections.abc import Iterable
from dataclasses import replace
from math import inf, pi
from typing import NamedTuple

import numpy as np
from flint import fmpq

from beamdesign.controllers import Proportional
from beamdesign.plant.linear import Plant
from beamdesign.plant.members import VertexModel, family
from beamdesign.polynomial import at_points, exact, nearest, roots, shortened
from beamdesign.proofs.box import Box
from beamdesign.proofs.box_member import Worst, worst_of
from beamdesign.proofs.certificate import Asked
from beamdesign.proofs.rig_family import performing_spans, rig_family
from beamdesign.prototype import Prototype

_GRID = 2 * pi * np.geomspace(1e-2, 1e4, 3000)  # rad/s
_ZOOMS, _POINTS, _PEAKS, _FINE = 6, 41, 3, 1.003
_DIGITS, _ROUNDING = 6, 1e-9
_ABOUT = 0.5, 2.0
"""About the nominal rig's peak, as shares of its frequency, the worst rig of a box is sought."""


class Peak(NamedTuple):
    """The largest compliance of a rig with its servo off, m/N, rounded down, and at which frequency, Hz."""

    compliance_m_per_N: float
    frequency_Hz: float


def servo_off_peak(plants: Iterable[Plant], masses_kg: tuple[float, float]) -> Peak:
    """The largest |x / F_d| of some plants with no current, over all frequencies and a range of outer end masses.

    At a frequency the denominator is affine in the mass, so that the mass at which it is least is known; over the
    frequency a dense grid, to which the poles are added, is refined about its highest points.
    """
    return max((_peak(plant, masses_kg) for plant in plants), default=Peak(0.0, 0.0))


def _peak(plant: Plant, masses_kg: tuple[float, float]) -> Peak:
    constant, slope = plant.denominator.constant, plant.denominator.slope

    def compliance(w: np.ndarray) -> np.ndarray:
        s = 1j * w
        bare, added = at_points(constant, s), at_points(slope, s)
        mass = np.clip(-(np.conj(added) * bare).real / np.maximum(np.abs(added) ** 2, 1e-300), *masses_kg)
        with np.errstate(divide="ignore"):
            return np.asarray(np.abs(at_points(plant.disturbance, s)) / np.abs(bare + mass * added))

    poles = np.concatenate([np.abs(roots(plant.denominator.at(exact(mass)))) for mass in np.linspace(*masses_kg, 9)])
    grid = np.union1d(_GRID, poles[(poles > _GRID[0]) & (poles < _GRID[-1])])
    values = compliance(grid)
    rises = np.diff(values, prepend=-inf) > 0
    tops = np.flatnonzero(rises & np.append(~rises[1:], True))
    best = (float(values.max()), float(grid[values.argmax()]))
    for top in sorted(tops, key=lambda k: -values[k])[:_PEAKS]:
        at, spread = grid[top], _FINE
        for _ in range(_ZOOMS):
            near = at * np.geomspace(1 / spread, spread, _POINTS)
            found = compliance(near)
            at, spread = near[found.argmax()], spread ** (3 / _POINTS)
            best = max(best, (float(found.max()), float(at)))
    return Peak(_rounded(best[0]), best[1] / (2 * pi))


def _rounded(value: float) -> float:
    return nearest(shortened(exact(value * (1 - _ROUNDING)), _DIGITS)) if 0 < value < inf else value


def servo_off_of(members: Iterable[VertexModel], inner_end_mass_kg: float, masses_kg: tuple[float, float]) -> Peak:
    """The same of those linear members of a rig that are to perform: the worst of them all."""
    performing = (member for member in members if member.performance is not None)
    return servo_off_peak((member.rig.plant(inner_end_mass_kg) for member in performing), masses_kg)


def servo_off(prototype: Prototype, masses_kg: tuple[float, float]) -> Peak:
    """The same of a prototype, with or without a controller, over a range of outer end masses.

    Of a prototype without effects that is one rig; where there is one payload, the range is that alone. Of a controller
    with several laws each is compared over its own payloads.
    """
    return servo_off_of(family(prototype, masses_kg[1]).members, prototype.payload.inner_end_mass_kg, masses_kg)


def servo_off_over_box(prototype: Prototype, box: Box) -> tuple[float, Worst]:
    """The largest compliance with the servo off that a search finds over the rigs of a box, m/N, and that rig.

    Whatever it misses makes the figure less, and a limit that is a multiple of it stricter. The box need not have the
    same rig worst with the servo off as with it on: worst is compared with worst.

    Args:
        prototype: any controller does, as no part of it counts.
        box: ranges of its figures; those of the controller do not count.
    """
    idle = prototype.but(controller=Proportional(gain_A_per_V=1.0))
    payloads = box.ranges.get("outer_end_mass", (fmpq(0), fmpq(0)))
    low, high = map(nearest, payloads)
    found = family(idle, high)
    about = servo_off_of(found.members, prototype.payload.inner_end_mass_kg, (low, high))
    shape = rig_family(idle, claim=Asked("compliance", about.compliance_m_per_N), delayed=False, varying=box.ranges)
    ranges = {**box.ranges, **performing_spans(found)}
    kept = {name: ends for name, ends in ranges.items() if name in shape.values and name in box.ranges}
    since, until = (exact(2 * pi * about.frequency_Hz * share) for share in _ABOUT)
    near = replace(shape, since=since, until=until)
    worst = worst_of(near.over({**kept, "controller_gain": (fmpq(0), fmpq(0))}))[0]
    return max(about.compliance_m_per_N, _rounded(worst.ratio * about.compliance_m_per_N)), worst
