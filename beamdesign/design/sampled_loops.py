"""Loops sampled over frequency and end mass, with derivatives by the figures of a controller: what a search works on.

The variables are the logarithms of a controller's figures (gain, pole and zero of its lag, four of each second-order
section), then the inner end mass in kg. Everything here is sampled and only proposes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import log, pi
from typing import Protocol

import numpy as np

from beamdesign.design.loop_search import GridPlant
from beamdesign.prototype import Goal


@dataclass(frozen=True)
class Samples:
    """Plant responses at n points, each divided by the plant's denominator without inner end mass there.

    Attributes:
        frequency_Hz: (n,).
        row: (n,) number of the row of neighbouring frequencies, of one plant at one outer end mass, a point is on.
        denominator: (n,) what a kilogram inside adds to the denominator.
        control: (2, n) current to sensor voltage: without, and per kilogram of, inner end mass.
        disturbance: (2, n) force to displacement, likewise.
        looser: (n,) factor on the limit of sensitivity; where it is above one, nothing else is limited.
    """

    frequency_Hz: np.ndarray
    row: np.ndarray
    denominator: np.ndarray
    control: np.ndarray
    disturbance: np.ndarray
    looser: np.ndarray

    def joined(self, other: "Samples") -> "Samples":
        """With the points of another, in rows of their own."""
        row = np.append(self.row, other.row + (self.row.max() + 1 if len(self.row) else 0))
        return Samples(
            np.append(self.frequency_Hz, other.frequency_Hz),
            row,
            np.append(self.denominator, other.denominator),
            np.hstack([self.control, other.control]),
            np.hstack([self.disturbance, other.disturbance]),
            np.append(self.looser, other.looser),
        )

    def worst(self, goal: Goal, variables: np.ndarray) -> tuple["Samples", ...]:
        """The samples on which each limit is held, as of `Slacks.held_on`: these, where the rig's figures stand."""
        return (self,) * 4


def samples(grid: GridPlant, outer_end_masses: Sequence[float], looser: float = 1.0) -> Samples:
    """A grid of frequencies at each of some outer end masses (kg)."""
    masses = np.asarray(outer_end_masses, dtype=float)
    bare = grid.denominator[0, 0] + masses[:, None] * grid.denominator[1, 0]
    added = grid.denominator[0, 1] + masses[:, None] * grid.denominator[1, 1]
    count = len(grid.frequency_Hz)
    return Samples(
        np.tile(grid.frequency_Hz, len(masses)),
        np.repeat(np.arange(len(masses)), count),
        (added / bare).ravel(),
        np.array([(one / bare).ravel() for one in grid.control]),
        np.array([(one / bare).ravel() for one in grid.disturbance]),
        np.full(count * len(masses), looser),
    )


@dataclass(frozen=True)
class Slacks:
    """Logarithms by which a controller keeps each limit at each point, and their derivatives by the variables.

    Attributes:
        sensitivity: (n,) log of limit over |S|.
        compliance: (n,) log of limit over |x / F_d|.
        loop_gain: (n,) log of limit over |L|, infinite below the frequency from which it is limited.
        effort: (n,) log of limit over |C S|.
        slopes: for each of these, in this order, (n, v).
        settled: whether 1 + L winds about the origin on no row: the loop is stable as far as the samples tell.
        held_on: for each of these limits, in this order, the samples that it was held against.
    """

    sensitivity: np.ndarray
    compliance: np.ndarray
    loop_gain: np.ndarray
    effort: np.ndarray
    slopes: tuple[np.ndarray, ...]
    settled: bool
    held_on: tuple[Samples, ...] = ()

    @property
    def violation(self) -> float:
        """By how much the limits other than the compliance are missed at worst."""
        return self.violation_inside(0.0)

    def violation_inside(self, inside: float) -> float:
        """The same for limits that are to be kept with so much to spare."""
        return max(0.0, *(inside - float(part.min()) for part in (self.sensitivity, self.loop_gain, self.effort)))


def controller_log(logarithms: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Logarithm of K C(s), (n,), and its derivatives (n, v) by the logarithms of the figures."""
    figures = np.exp(logarithms)
    value = np.full(len(s), logarithms[0], dtype=complex)
    slopes = np.zeros((len(s), len(figures)), dtype=complex)
    slopes[:, 0] = 1.0
    for k, sign in ((1, -1.0), (2, 1.0)):
        u = s / (2 * pi * figures[k])
        value += sign * np.log(1 + u)
        slopes[:, k] = -sign * u / (1 + u)
    for first in range(3, len(figures), 4):
        for k, sign in ((first, 1.0), (first + 2, -1.0)):
            u, damping = s / (2 * pi * figures[k]), figures[k + 1]
            factor = 1 + 2 * damping * u + u * u
            value += sign * np.log(factor)
            slopes[:, k] = -sign * (2 * damping * u + 2 * u * u) / factor
            slopes[:, k + 1] = sign * 2 * damping * u / factor
    return value, slopes


def slacks(points: Samples, goal: Goal, variables: np.ndarray, slopes: bool = True) -> Slacks:
    """What a controller leaves of every limit at every point.

    Args:
        points: of the loops.
        goal: its limits; those that are None are kept by an infinite slack.
        variables: (v,).
        slopes: whether to work out derivatives.
    """
    held_on = points.worst(goal, variables)
    if all(one is points for one in held_on):
        return replace(_slacks(points, goal, variables, slopes), held_on=held_on)
    distinct = {id(one): one for one in held_on}
    found = {key: _slacks(one, goal, variables, slopes) for key, one in distinct.items()}
    each = [found[id(one)] for one in held_on]
    return Slacks(
        each[0].sensitivity,
        each[1].compliance,
        each[2].loop_gain,
        each[3].effort,
        tuple(one.slopes[k] for k, one in enumerate(each)) if slopes else (),
        _slacks(points, goal, variables, slopes=False).settled,
        held_on,
    )


def _slacks(points: Samples, goal: Goal, variables: np.ndarray, slopes: bool) -> Slacks:
    inner, count = float(variables[-1]), len(variables)
    law, of_law = controller_log(variables[:-1], 2j * pi * points.frequency_Hz)
    plant = 1 + inner * points.denominator
    sensed = points.control[0] + inner * points.control[1]
    moved = points.disturbance[0] + inner * points.disturbance[1]
    loop = np.exp(law) * sensed / plant
    closed = np.log(np.abs(1 + loop))
    performs = points.looser == 1.0
    from_there = performs & (points.frequency_Hz >= goal.loop_gain_from_Hz)
    found = (
        closed + log(goal.peak_sensitivity) + np.log(points.looser),
        np.where(performs, closed + np.log(np.abs(plant / moved)) + log(goal.compliance_m_per_N), np.inf),
        np.full(len(law), np.inf)
        if goal.loop_gain is None
        else np.where(from_there, log(goal.loop_gain) - np.log(np.abs(loop)), np.inf),
        np.full(len(law), np.inf)
        if goal.controller_effort_A_per_V is None
        else np.where(performs, closed - law.real + log(goal.controller_effort_A_per_V), np.inf),
    )
    turned = np.angle(1 + loop)
    steps = np.diff(turned)
    steps = (steps + pi) % (2 * pi) - pi
    same = np.diff(points.row) == 0
    settled = bool((np.abs(np.bincount(points.row[1:][same], weights=steps[same])) < pi).all())
    if not slopes:
        return Slacks(*found, (), settled)
    of_loop = np.zeros((len(law), count), dtype=complex)
    of_loop[:, :-1] = of_law
    of_loop[:, -1] = points.control[1] / sensed - points.denominator / plant
    of_closed = (of_loop * (loop / (1 + loop))[:, None]).real
    of_compliance = of_closed.copy()
    of_compliance[:, -1] += (points.denominator / plant - points.disturbance[1] / moved).real
    of_effort = of_closed.copy()
    of_effort[:, :-1] -= of_law.real
    return Slacks(*found, (of_closed, of_compliance, -of_loop.real, of_effort), settled)


class Rows(Protocol):
    """Points on rows of neighbouring frequencies, with or without added sensors."""

    @property
    def frequency_Hz(self) -> np.ndarray:
        """(n,)."""
        ...

    @property
    def row(self) -> np.ndarray:
        """(n,) number of its row."""
        ...


def sampled_bandwidth(points: Rows, compliance: np.ndarray) -> float:
    """Least frequency (Hz), interpolated, from which some row misses the compliance; 0 where one misses it at once."""
    reached = np.inf
    for row in np.unique(points.row):
        on = points.row == row
        frequency, slack = points.frequency_Hz[on], compliance[on]
        over = np.nonzero(slack < 0)[0]
        if not len(over):
            continue
        k = int(over[0])
        if k == 0:
            return 0.0
        share = slack[k - 1] / (slack[k - 1] - slack[k])
        reached = min(reached, float(frequency[k - 1] * (frequency[k] / frequency[k - 1]) ** share))
    return float(min(reached, points.frequency_Hz.max()))
