"""Samples whose rig may be off: each limit is held, at every point, on the worst rig within the tolerances there.

The logarithms of all plant responses are known to second order in each figure (cross terms left out), from rigs with
one figure off. The worst rig of a point is that of the linearised slack, linearised anew where it is: the first-order
reliability method (A. M. Hasofer and N. C. Lind, Exact and invariant second-moment code format, J. Eng. Mech. Div. ASCE
100, 1974). Sampled, as everything that proposes; the worst rigs of a result are proved one by one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from math import pi

import numpy as np

from beamdesign.controllers.form import Form
from beamdesign.design.loop_samples import COMPLIANCE, Samples, sampled_bandwidth, slacks
from beamdesign.design.rig_spread import RigSpread
from beamdesign.members import Member
from beamdesign.prototype import Goal

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
