"""Loops sampled over frequency and end mass, and what a law leaves there of every limit: what a search works on.

The variables are those of a law's form, then the inner end mass in kg. Everything here is sampled and only proposes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, reduce
from math import inf, log, log10, pi

import numpy as np
from flint import fmpq_poly
from pydantic import Field

from beamdesign.controllers import SENSED, Controller, Sensed
from beamdesign.controllers.protocol import Form, at_pace
from beamdesign.plant.assembly import mass_unit_kg, pace
from beamdesign.plant.linear import BilinearPlant, LinearModel, PairOver
from beamdesign.plant.members import VertexModel
from beamdesign.polynomial import at_points
from beamdesign.proofs.certificate import Kind
from beamdesign.prototype import Goal

LIMITED: tuple[Kind, ...] = (
    "peak_sensitivity", "compliance", "loop_gain", "controller_effort", "gain_margin", "peak_compliance",
)  # fmt: skip
"""What a goal limits, in the order of everything that is listed by limit."""


def goal_limits(goal: Goal) -> dict[Kind, float]:
    """The limits that a goal sets, in this order; of the peak compliance in multiples of that with the servo off."""
    lower = getattr(goal, "peak_at_lower_gains", LARGEST_AT_LOWER_GAINS) if goal.lower_gains else inf
    given = (goal.peak_sensitivity, goal.compliance_m_per_N, goal.loop_gain, goal.controller_effort_A_per_V)
    limits = zip(LIMITED, (*given, lower, goal.peak_over_passive), strict=True)
    return {kind: limit for kind, limit in limits if limit is not None and limit < inf}


LARGEST_AT_LOWER_GAINS = 10.0
"""Peak sensitivity that an optimiser allows at any lower gain, so that the loop is stable there."""


class _Calmer(Goal):
    """A goal of an optimiser alone."""

    peak_at_lower_gains: float = Field(description="instead of LARGEST_AT_LOWER_GAINS")


def calmer(goal: Goal, peak: float = LARGEST_AT_LOWER_GAINS) -> Goal:
    """A goal with a limit of an optimiser's own at lower gains; with the largest, as it is stated."""
    own = {name: getattr(goal, name) for name in Goal.model_fields}
    return Goal(**own) if peak == LARGEST_AT_LOWER_GAINS else _Calmer(**own, peak_at_lower_gains=peak)


RELAXED_PEAK = 3.0
"""An optimiser keeps members that only have to be stable within the limit of sensitivity times this."""


def ends(members: Sequence[VertexModel]) -> list[tuple[LinearModel, float, bool]]:
    """Rig, factor on the gain and whether it is to perform, of every member at the ends of what it is asked."""
    found = []
    for member in members:
        inside = member.performance
        asked = member.gain if inside is None else inside
        found += [(member.rig, factor, inside is not None) for factor in sorted({asked.low, asked.high}) if factor > 0]
    return found


def form_for(form: Form, figures: Mapping[str, float]) -> Form:
    """A form whose bounds, and whose unit of the mass inside, go with the figures of a rig."""
    return at_pace(form, pace(figures), mass_unit_kg(figures))


@dataclass(frozen=True)
class Samples:
    """Responses at n points, each divided by the plant's denominator without inner end mass there.

    [0] is without inner end mass, [1] what a kilogram of it adds. With K_k the law from each of p sensors,
    L = sum K_k control_k / plant, and x / F_d = (disturbance + sum K_k crossed_k) / plant / (1 + L), where
    plant = 1 + inner end mass times denominator.

    Attributes:
        frequency_Hz: (n,).
        row: (n,) number of the row of neighbouring frequencies, of one plant at one outer end mass, a point is on.
        denominator: (n,) what a kilogram inside adds to the denominator.
        control: (p, 2, n) current to what is sensed.
        disturbance: (2, n) force to displacement.
        crossed: (p, 2, n) what feedback of a sensor adds to that, see `beamdesign.plant.linear.Plant`.
        outer_end_mass: (n,) kg.
        relaxed: (n,) factor on the limit of sensitivity; where it is above one, nothing else is limited.
    """

    frequency_Hz: np.ndarray
    row: np.ndarray
    denominator: np.ndarray
    control: np.ndarray
    disturbance: np.ndarray
    crossed: np.ndarray
    outer_end_mass: np.ndarray
    relaxed: np.ndarray

    def joined(self, other: "Samples") -> "Samples":
        """With the points of another, in rows of their own."""
        pairs = {one.name: (getattr(self, one.name), getattr(other, one.name)) for one in fields(self)}
        whole = {name: np.concatenate(pair, axis=-1) for name, pair in pairs.items()}
        whole["row"] = np.append(self.row, other.row + self.row.max() + 1)
        return Samples(**whole)

    @cached_property
    def onward(self) -> np.ndarray:
        """(n - 1,) whether the next point is on the same row."""
        return np.diff(self.row) == 0

    @cached_property
    def rows(self) -> list[np.ndarray]:
        """Positions of the points of each row."""
        return [np.flatnonzero(self.row == row) for row in np.unique(self.row)]

    def at(self, inner: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Plant (n,), then control (p, n), disturbance (n,) and crossed (p, n) over it, with a mass inside (kg)."""
        plant = 1 + inner * self.denominator
        control = (self.control[:, 0] + inner * self.control[:, 1]) / plant
        crossed = (self.crossed[:, 0] + inner * self.crossed[:, 1]) / plant
        return plant, control, (self.disturbance[0] + inner * self.disturbance[1]) / plant, crossed

    def servo_off(self, inner: float) -> float:
        """Largest |x / F_d| (m/N) without a law, of all points that are to perform, with a mass inside (kg).

        Between neighbouring frequencies F_d / x is interpolated: of one mass on a spring it is quadratic in frequency.
        """
        plant = 1 + inner * self.denominator
        without = (self.disturbance[0] + inner * self.disturbance[1]) / plant
        size = np.where(self.relaxed == 1.0, np.abs(without), 0.0)
        k = int(size.argmax())
        near = np.arange(max(k - 2, 0), min(k + 3, len(size)))
        near = near[(self.row[near] == self.row[k]) & (size[near] > 0)]
        if k in (near[0], near[-1]):
            return float(size[k])
        at = self.frequency_Hz[near] / self.frequency_Hz[k] - 1
        scale = float(np.abs(at).max())
        terms = np.linalg.solve(np.vander(at / scale), size[k] / without[near])
        low, high = (float(self.frequency_Hz[i] / self.frequency_Hz[k]) - 1 for i in (k - 1, k + 1))
        between = np.linspace(low, high, _BETWEEN)
        return float(size[k] / min(1.0, np.abs(np.polyval(terms, between / scale)).min()))


_BETWEEN = 1001
"""How many frequencies are looked at about the highest point."""


def samples(
    plant: BilinearPlant, frequency_Hz: np.ndarray, outer_kg: Sequence[float], factor: float = 1.0, relaxed: float = 1.0
) -> Samples:
    """A grid of frequencies at each of some outer end masses (kg), with the plant's gain times a factor."""
    masses, s = np.asarray(outer_kg, dtype=float)[:, None], 2j * pi * frequency_Hz

    def on_axis(polynomial: fmpq_poly) -> np.ndarray:
        return at_points(polynomial, s)

    def rows(pair: tuple[PairOver, PairOver]) -> list[np.ndarray]:
        """(masses, f) without and per kilogram of inner end mass."""
        (own, inner), (outer, both) = (map(on_axis, row) for row in pair)
        return [own + masses * outer, inner + masses * both]

    bare, added = rows(plant.denominator)

    def over(parts: Sequence[np.ndarray]) -> np.ndarray:
        return np.array([(part / bare).ravel() for part in parts])

    free = [[np.tile(on_axis(p), (len(masses), 1)) for p in pair] for pair in (plant.disturbance, *plant.crossed)]
    count = len(frequency_Hz)
    return Samples(
        np.tile(frequency_Hz, len(masses)),
        np.repeat(np.arange(len(masses)), count),
        (added / bare).ravel(),
        factor * np.array([over(rows(one)) for one in plant.control]),
        over(free[0]),
        factor * np.array([over(one) for one in free[1:]]),
        np.repeat(masses.ravel(), count),
        np.full(count * len(masses), relaxed),
    )


def rig_samples(
    members: Sequence[VertexModel],
    frequency_Hz: np.ndarray,
    outer_end_masses: Sequence[float],
    sensors: tuple[Sensed, ...] = SENSED[:1],
    relaxed: float = 1.0,
) -> Samples:
    """Samples of all members of a rig at the ends of their gains.

    Args:
        members: linear members of the rig.
        frequency_Hz: (f,) ascending.
        outer_end_masses: kg.
        sensors: of `beamdesign.controllers.SENSORS`.
        relaxed: factor on the limit of sensitivity of members that are to perform.
    """
    parts = [
        samples(rig.polynomials(sensors), frequency_Hz, outer_end_masses, factor, relaxed if performs else RELAXED_PEAK)
        for rig, factor, performs in ends(members)
    ]
    return reduce(Samples.joined, parts)


def sampled_masses(masses_kg: tuple[float, float], count: int = 3) -> list[float]:
    """Outer end masses of samples, kg."""
    return [float(mass) for mass in np.unique(np.linspace(*masses_kg, count))]


@dataclass(frozen=True)
class Design:
    """A form of law, variables of it with the mass inside and what sections there are, and their value on samples."""

    form: Form
    variables: np.ndarray
    value: float = 0.0

    @property
    def law(self) -> Controller:
        """Its controller."""
        return self.form.record(self.variables[: self.form.size])

    @property
    def inner_end_mass(self) -> float:
        """Mass inside, kg, rounded; one that is next to nothing is none."""
        mass, unit = float(self.variables[self.form.size]), self.form.mass_unit_kg
        return round(mass, 6 - round(log10(unit))) if mass >= _LEAST_INSIDE * unit else 0.0

    @property
    def chosen(self) -> np.ndarray:
        """Its sections."""
        return self.variables[self.form.size + 1 :]

    def louder(self, by: float) -> "Design":
        """With its first variable, which is the logarithm of a gain, larger by so much."""
        return replace(self, variables=np.append(self.variables[0] + by, self.variables[1:]))


@dataclass(frozen=True)
class Slacks:
    """Logarithms by which a law keeps each limit at each point, and their derivatives by the variables.

    Attributes:
        values: (6, n) log of limit over |S|, |x / F_d|, |L|, |C S|, C from the displacement sensor's volts, the largest
            |S| of all lower gains, and |x / F_d| again, whose limit at every frequency is a multiple of the largest
            without a law of all points, as `LIMITED` lists them; infinite where a limit does not count.
        slopes: (6, n, v); none where none were asked for.
        settled: whether 1 + L winds about the origin on no row: the loop is stable as far as the samples tell, at lower
            gains where the goal wants it.
        servo_off_m_per_N: the largest |x / F_d| without a law of all points.
    """

    values: np.ndarray
    slopes: np.ndarray
    settled: bool
    servo_off_m_per_N: float

    @property
    def sensitivity(self) -> np.ndarray:
        """(n,) log of limit over |S|."""
        return np.asarray(self.values[0])

    @property
    def compliance(self) -> np.ndarray:
        """(n,) log of limit over |x / F_d|."""
        return np.asarray(self.values[1])

    def violation(self, inside: float = 0.0) -> float:
        """By how much the limits other than the compliance, to be kept with so much to spare, are missed at worst."""
        return max(0.0, inside - float(self.values[OTHERS].min()))


COMPLIANCE, OTHERS = 1, [0, 2, 3, 4, 5]
"""Places in `LIMITED`."""


def slacks(
    points: Samples, goal: Goal, form: Form, variables: np.ndarray, slopes: bool = True, unsettled: bool = True
) -> Slacks:
    """What a law leaves of every limit at every point.

    Args:
        points: of the loops.
        goal: its limits; those that are None are kept by an infinite slack.
        form: of the law.
        variables: (v,) those of the form, then the mass inside, kg; more behind them does not count.
        slopes: whether to work out derivatives.
        unsettled: whether to work out anything of loops that are not settled; else no limit counts of them.
    """
    s, own_variables = 2j * pi * points.frequency_Hz, variables[: form.size]
    inner = float(variables[form.size])
    own = form.responses(own_variables, s)
    of_own = form.slopes(own_variables, s) if slopes else None
    return slacks_of(points, goal, own, inner, of_own, form.mass_unit_kg, unsettled)


def counting(points: Samples, goal: Goal) -> np.ndarray:
    """(6, n) at which points each limit counts."""
    performs = points.relaxed == 1.0
    far, everywhere = performs & (points.frequency_Hz >= goal.loop_gain_from_Hz), np.full(len(performs), True)
    peaked = points.relaxed < RELAXED_PEAK
    where = np.array([everywhere, performs, far, performs, everywhere, peaked])
    limits = goal_limits(goal)
    return where & np.array([kind in limits for kind in LIMITED])[:, None]


def slacks_of(
    points: Samples,
    goal: Goal,
    own: np.ndarray,
    inner: float,
    of_own: np.ndarray | None = None,
    mass_unit: float = 1.0,
    unsettled: bool = True,
) -> Slacks:
    """The same of a law whose responses are known.

    Args:
        points: of the loops.
        goal: its limits.
        own: (p, n) the law at the points.
        inner: mass inside, kg.
        of_own: (p, n, v) its derivatives by all variables but the mass; none for no slopes.
        mass_unit: of what size a mass is (kg), for its slope.
        unsettled: as in `slacks`.
    """
    plant, control, disturbance, crossed = points.at(inner)
    loop = (own * control).sum(axis=0)
    settled = _settled(points, goal, loop)
    if not (settled or unsettled):
        return Slacks(np.full((len(LIMITED), len(loop)), np.inf), np.empty(0), False, 0.0)
    moved = disturbance + (own * crossed).sum(axis=0)
    closed = np.log(np.abs(1 + loop))
    share = np.clip(-loop.real / np.maximum(np.abs(loop) ** 2, 1e-300), 0.0, 1.0)  # of the gain, with |1 + k L| least
    lower, limits = 1 + share * loop, goal_limits(goal)
    with np.errstate(divide="ignore"):
        compliance, effort = closed - np.log(np.abs(moved)), closed - np.log(np.abs(own[0]))
        softest = compliance + np.log(without := points.servo_off(inner))
        left = np.array([closed, compliance, -np.log(np.abs(loop)), effort, np.log(np.abs(lower)), softest])
    stated = np.log([limits.get(kind, 1.0) for kind in LIMITED])
    left = np.where(counting(points, goal), left + stated[:, None], np.inf)
    left[0] += np.log(points.relaxed)
    if of_own is None:
        return Slacks(left, np.empty(0), settled, without)
    shrinks = points.denominator / plant
    of_loop, of_moved = ((by[:, :, None] * of_own).sum(axis=0) for by in (control, crossed))
    by_mass = (own * points.control[:, 1]).sum(axis=0) / plant - loop * shrinks
    of_loop = np.column_stack([of_loop, by_mass])
    by_mass = (points.disturbance[1] + (own * points.crossed[:, 1]).sum(axis=0)) / plant - moved * shrinks
    of_moved = np.column_stack([of_moved, by_mass])
    of_closed = (of_loop / (1 + loop)[:, None]).real
    of_effort = of_closed.copy()
    of_effort[:, :-1] -= (of_own[0] / own[0][:, None]).real
    of_compliance, of_loop_gain = of_closed - (of_moved / moved[:, None]).real, -(of_loop / loop[:, None]).real
    of_lower = (share[:, None] * of_loop / lower[:, None]).real
    of_softest = of_compliance.copy()
    step = _STEP * mass_unit
    of_softest[:, -1] += log(points.servo_off(inner + step) / points.servo_off(inner - step)) / (2 * step)
    slopes = np.array([of_closed, of_compliance, of_loop_gain, of_effort, of_lower, of_softest])
    return Slacks(left, slopes, settled, without)


def _settled(points: Samples, goal: Goal, loop: np.ndarray) -> bool:
    """Whether loop transfer functions (n,) are stable as far as samples tell, see `Slacks`."""
    steps = np.diff(np.angle(1 + loop))
    steps = (steps + pi) % (2 * pi) - pi
    same = points.onward
    if not (np.abs(np.bincount(points.row[1:][same], weights=steps[same])) < pi).all():
        return False
    return not (goal.lower_gains and _passes_behind(loop[:-1][same], loop[1:][same]).any())


_LEAST_INSIDE = 1e-4
"""Of the mass inside in its unit, what is not none."""

_STEP = 1e-4
"""Of the mass inside in its unit, for the slope of what its largest compliance is without a law."""


def _passes_behind(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Whether the chords between points of a loop cross the real axis to the left of -1."""
    crosses = (start.imag < 0) != (end.imag < 0)
    at = start.real * end.imag - end.real * start.imag
    return np.asarray(crosses & (at / np.where(crosses, end.imag - start.imag, 1.0) < -1))


def sampled_bandwidth(points: Samples, compliance: np.ndarray) -> float:
    """Least frequency (Hz), interpolated, from which some row misses the compliance; 0 where one misses it at once."""
    reached = (first_miss(points.frequency_Hz[on], compliance[on]) for on in points.rows)
    return min(*reached, float(points.frequency_Hz.max()), np.inf)


def first_miss(frequency_Hz: np.ndarray, slack: np.ndarray) -> float:
    """From where a slack is negative, interpolated, Hz; 0 where it is at once, infinite where it never is."""
    k = int(np.argmax(slack < 0))
    if slack[k] >= 0 or k == 0:
        return np.inf if slack[k] >= 0 else 0.0
    share = slack[k - 1] / (slack[k - 1] - slack[k])
    return float(frequency_Hz[k - 1] * (frequency_Hz[k] / frequency_Hz[k - 1]) ** share)
