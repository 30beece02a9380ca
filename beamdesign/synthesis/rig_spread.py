"""Rigs that a prototype may turn out to be: its figures off by so many standard deviations of its tolerances.

Of samples whose rig may be off each limit is held, at every point, on the worst rig within the tolerances there.
The logarithms of all plant responses are known to second order in each figure (cross terms left out), from rigs with
one figure off. The worst rig of a point is that of the linearised slack, linearised anew where it is: the first-order
reliability method (A. M. Hasofer and N. C. Lind, Exact and invariant second-moment code format, J. Eng. Mech. Div. ASCE
100, 1974). Sampled, as everything that proposes; the worst rigs of a result are proved one by one.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import pi
from typing import Literal

import numpy as np

from beamdesign.controllers.form import Form
from beamdesign.parameters import TOLERANCES
from beamdesign.plant.changed_figures import CHANGEABLE, with_figures
from beamdesign.plant.members import Member, served
from beamdesign.prototype import Goal, Prototype
from beamdesign.records import InputError, Problem
from beamdesign.synthesis.loop_samples import COMPLIANCE, Samples, sampled_bandwidth, slacks

Shape = Literal["ball", "box"]

_CUT = 4.0
_DIGITS = 3
"""To which a deviation is rounded: a thousandth of a standard deviation."""


@dataclass(frozen=True)
class RigSpread:
    """What a prototype may turn out to be.

    Attributes:
        prototype: nominal.
        largest_outer_kg: largest outer end mass, whose weight is the load of effects that depend on it.
        deviations: relative standard deviation by figure, as in `beamdesign.plant.changed_figures`; d of them.
        sigmas: how far the figures are off, in standard deviations.
        shape: "box": each of them up to so many, whatever the others are; "ball": so many in all, the root of the sum
            of the squares, which is how far normal figures are off in any one direction that matters.
        stage: payloads of the law that serves them and all payloads, as of `beamdesign.plant.members.served`.
    """

    prototype: Prototype
    largest_outer_kg: float
    deviations: Mapping[str, float]
    sigmas: float
    shape: Shape = "ball"
    stage: tuple[tuple[float, float], tuple[float, float]] | None = None

    def rig(self, z: np.ndarray) -> Prototype:
        """The prototype with its figures off by (d,) standard deviations."""
        return with_figures(self.prototype, self.factors(z))

    def factors(self, z: np.ndarray) -> dict[str, float]:
        """What the figures are multiplied by, those that change."""
        pairs = zip(z, self.deviations.items(), strict=True)
        return {name: 1 + float(value) * size for value, (name, size) in pairs if value}

    def members(self, z: np.ndarray) -> tuple[Member, ...]:
        """Linear members that a law has to serve of the prototype with its figures off by (d,)."""
        return served(self.rig(z), self.largest_outer_kg, self.stage)

    def worst(self, slopes: np.ndarray) -> np.ndarray:
        """(d, n) deviations that lower n quantities most whose derivatives by the deviations are (d, n)."""
        if self.shape == "box":
            return -self.sigmas * np.sign(slopes)
        return -self.sigmas * slopes / np.maximum(np.linalg.norm(slopes, axis=0), 1e-30)

    def drawn(self, count: int, seed: int, inside: bool = False) -> list[np.ndarray]:
        """Deviations (d,) of rigs drawn at random: normal, cut off at four, or evenly from within the sigmas."""
        random, size = np.random.default_rng(seed), len(self.deviations)
        normal = random.standard_normal((count, size))
        if not inside:
            return [self.rounded(z) for z in np.clip(normal, -_CUT, _CUT)]
        if self.shape == "box":
            return [self.rounded(z) for z in self.sigmas * random.uniform(-1.0, 1.0, (count, size))]
        reach = self.sigmas * random.uniform(size=(count, 1)) ** (1 / size)
        return [self.rounded(z) for z in reach * normal / np.linalg.norm(normal, axis=1, keepdims=True)]

    def rounded(self, z: np.ndarray) -> np.ndarray:
        """(d,) deviations in short figures; rounding leaves the ball by next to nothing."""
        return np.round(z, _DIGITS)


def rig_spread(prototype: Prototype, largest_outer_kg: float, sigmas: float, shape: Shape = "ball") -> RigSpread:
    """The rigs within so many standard deviations of the prototype's `[tolerance]`.

    Tolerances of end masses are left out: the outer one is a range of its own, the inner one is weighed.

    Raises:
        InputError: where no figure has a tolerance, or one could reach zero.
        ValueError: for sigmas that are not positive.
    """
    if not sigmas > 0:
        raise ValueError("robust against nothing: sigmas must be positive")
    lacks = {"filter_frequency"} if prototype.sensor.filter_Hz is None else set()
    every = {name: getattr(prototype.tolerance, TOLERANCES[name]) for name in CHANGEABLE if name in TOLERANCES}
    deviations = {
        name: size for name, size in every.items() if size and name not in lacks and not name.endswith("end_mass")
    }
    if not deviations:
        raise InputError("tolerance", [Problem("tolerance", "no figure has a tolerance: nothing to be robust against")])
    if wide := [name for name, size in deviations.items() if sigmas * size >= 1]:
        reason = "{:g} standard deviations of {:g} reach zero"
        problems = [Problem(TOLERANCES[name], reason.format(sigmas, deviations[name])) for name in wide]
        raise InputError("tolerance", problems)
    return RigSpread(prototype, largest_outer_kg, deviations, sigmas, shape)


_LINEARISED = 4
"""How often a worst rig is sought anew from where the last one was."""


@dataclass(frozen=True)
class WorstSamples(Samples):
    """Samples of a nominal rig with those of rigs that are off by one figure.

    Attributes:
        spread: of the rigs.
        more: d samples, one figure each one step larger.
        less: likewise, smaller.
    """

    spread: RigSpread
    more: tuple[Samples, ...]
    less: tuple[Samples, ...]

    @property
    def step(self) -> float:
        """How much larger or smaller, in standard deviations."""
        return self.spread.sigmas / 2

    def joined(self, other: Samples) -> "WorstSamples":
        """With the points of another, which are of rigs that are off as well."""
        if not isinstance(other, WorstSamples):
            raise TypeError("samples of rigs that are off are joined with such only")
        more = tuple(one.joined(two) for one, two in zip(self.more, other.more, strict=True))
        less = tuple(one.joined(two) for one, two in zip(self.less, other.less, strict=True))
        return replace(self, **vars(super().joined(other)) | {"more": more, "less": less})

    def worst(self, goal: Goal, form: Form, variables: np.ndarray) -> tuple[Samples, ...]:
        """The nominal samples with, at every point, the responses of the rig that is worst for each limit there."""
        curves = self._curves(float(variables[-1]))
        sensitivity, compliance, loop_gain = (
            self._shifted(_moved(z, curves)) for z in self._found(form, variables, curves)
        )
        return sensitivity, compliance, loop_gain, sensitivity

    def deviations(self, form: Form, variables: np.ndarray) -> list[np.ndarray]:
        """(d, n) standard deviations of the worst rigs for sensitivity and effort, for compliance, and for |L|."""
        return self._found(form, variables, self._curves(float(variables[-1])))

    def _found(self, form: Form, variables: np.ndarray, curves: np.ndarray) -> list[np.ndarray]:
        own = form.responses(variables[:-1], 2j * pi * self.frequency_Hz)
        _, control, disturbance, crossed = self.at(float(variables[-1]))
        p = len(own)
        parts = np.concatenate([own * control, disturbance[None], own * crossed])  # as `_responses` lists them
        found = []
        for kind in range(3):
            z = np.zeros((len(self.more), parts.shape[1]))
            best, least = z, np.full(parts.shape[1], np.inf)
            for _ in range(_LINEARISED):
                off = parts * np.exp(_moved(z, curves))
                slope, loop, moved = _slope(z, curves), off[:p].sum(axis=0), off[p:].sum(axis=0)
                by = np.einsum("rn,drn->dn", off[:p], slope[:, :p])
                if kind == 2:
                    slack, down = -np.log(np.abs(loop)), -(by / loop).real
                else:
                    slack, down = np.log(np.abs(1 + loop)), (by / (1 + loop)).real
                if kind == 1:
                    pushed = np.einsum("rn,drn->dn", off[p:], slope[:, p:])
                    slack, down = slack - np.log(np.abs(moved)), down - (pushed / moved).real
                better = slack < least
                best, least = np.where(better, z, best), np.minimum(slack, least)
                z = self.spread.worst(down)
            found.append(best)
        return found

    def _curves(self, inner: float) -> np.ndarray:
        """(2, d, r, n) first and second derivatives of the logarithms of all responses by the deviations."""
        here = _responses(self, inner)
        up, down = (
            np.array(
                [
                    np.log(np.divide(_responses(one, inner), here, out=np.ones_like(here), where=here != 0))
                    for one in side
                ]
            )
            for side in (self.more, self.less)
        )
        return np.array([(up - down) / (2 * self.step), (up + down) / self.step**2])

    def _shifted(self, moved: np.ndarray) -> Samples:
        """Samples of these points with responses whose logarithms are off by (r, n)."""
        p, factor = len(self.control), np.exp(moved)
        nominal = {each.name: getattr(self, each.name) for each in fields(Samples)}
        off = {
            "control": self.control * factor[:p, None],
            "disturbance": self.disturbance * factor[p],
            "crossed": self.crossed * factor[p + 1 :, None],
        }
        return Samples(**nominal | off)


def _responses(points: Samples, inner: float) -> np.ndarray:
    """(r, n) from current to each sensor, then from force to displacement, then what feedback adds to that."""
    _, control, disturbance, crossed = points.at(inner)
    return np.concatenate([control, disturbance[None], crossed])


def _moved(z: np.ndarray, curves: np.ndarray) -> np.ndarray:
    """(r, n) by how much the logarithms of the responses move."""
    return np.einsum("dn,drn->rn", z, curves[0]) + np.einsum("dn,drn->rn", z * z / 2, curves[1])


def _slope(z: np.ndarray, curves: np.ndarray) -> np.ndarray:
    """(d, r, n) derivatives of that."""
    return np.asarray(curves[0] + z[:, None] * curves[1])


def worst_samples(
    spread: RigSpread, members: Sequence[Member], sampled: Callable[[Sequence[Member]], Samples]
) -> WorstSamples:
    """Samples of the rigs within a spread.

    Args:
        spread: how far the figures may be off.
        members: of the nominal rig.
        sampled: samples of the members of a rig at the same points.
    """
    step, count = spread.sigmas / 2, len(spread.deviations)
    more, less = (tuple(sampled(spread.members(side * step * unit)) for unit in np.eye(count)) for side in (1.0, -1.0))
    return WorstSamples(**vars(sampled(members)), spread=spread, more=more, less=less)


MOST_RIGS = 8
"""How many of the worst rigs of a design are proved, at most."""

_NEAR, _APART = 0.08, 0.5
"""Slack (logarithm) up to which a limit counts as reached, and how many of the standard deviations in all two rigs have
to be apart to be two."""


def worst_rigs(
    points: WorstSamples, goal: Goal, form: Form, variables: np.ndarray, most: int = MOST_RIGS
) -> tuple[np.ndarray, ...]:
    """(d,) deviations of each of the worst rigs for all limits that are about to be reached, the worst first."""
    found = slacks(points, goal, form, variables, slopes=False)
    reached = sampled_bandwidth(points, found.compliance)
    limits, compliance, gain = points.deviations(form, variables)
    found.values[COMPLIANCE, points.frequency_Hz > reached] = np.inf
    listed: list[tuple[float, np.ndarray]] = []
    for slack, z in zip(found.values, (limits, compliance, gain, limits), strict=True):
        listed += [(float(slack[k]), points.spread.rounded(z[:, k])) for k in np.nonzero(slack < _NEAR)[0]]
    chosen: list[np.ndarray] = []
    for _, z in sorted(listed, key=lambda pair: pair[0]):
        size = np.linalg.norm(z)
        if len(chosen) < most and all(np.linalg.norm(z - other) > _APART * size for other in chosen):
            chosen.append(z)
    return tuple(chosen)
