"""Samples whose rig may be off: each limit is held, at every point, on the worst rig within the tolerances there.

The logarithms of both plant responses are known to second order in each figure (cross terms left out), from rigs with
one figure off. The worst rig of a point is that of the linearised slack, linearised anew where it is: the first-order
reliability method (A. M. Hasofer and N. C. Lind, Exact and invariant second-moment code format, J. Eng. Mech. Div. ASCE
100, 1974). Sampled, as everything that proposes; the worst rigs of a result are proved one by one.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import pi

import numpy as np

from beamdesign.design.rig_spread import RigSpread
from beamdesign.design.sampled_loops import Samples, controller_log, sampled_bandwidth, slacks
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
        step: in standard deviations.
    """

    spread: RigSpread
    more: tuple[Samples, ...]
    less: tuple[Samples, ...]
    step: float

    def worst(self, goal: Goal, variables: np.ndarray) -> tuple[Samples, ...]:
        """The nominal samples with, at every point, the responses of the rig that is worst for each limit there."""
        curves = self._curves(float(variables[-1]))
        sensitivity, compliance, loop_gain = (self._shifted(z, *curves) for z in self._found(variables, *curves))
        return sensitivity, compliance, loop_gain, sensitivity

    def deviations(self, variables: np.ndarray) -> list[np.ndarray]:
        """(d, n) standard deviations of the worst rigs for sensitivity and effort, for compliance, and for |L|."""
        return self._found(variables, *self._curves(float(variables[-1])))

    def _found(self, variables: np.ndarray, control: np.ndarray, disturbance: np.ndarray) -> list[np.ndarray]:
        inner = float(variables[-1])
        law, _ = controller_log(variables[:-1], 2j * pi * self.frequency_Hz)
        loop = np.exp(law) * (self.control[0] + inner * self.control[1]) / (1 + inner * self.denominator)
        found = []
        for kind in range(3):
            z = np.zeros((len(self.more), len(loop)))
            best, least = z, np.full(len(loop), np.inf)
            for _ in range(_LINEARISED):
                off = loop * np.exp(_moved(z, control))
                slope_control, slope_disturbance = (curve[0] + z * curve[1] for curve in (control, disturbance))
                if kind == 2:
                    slack, slope = -np.log(np.abs(off)), -slope_control.real
                else:
                    slack, slope = np.log(np.abs(1 + off)), (slope_control * (off / (1 + off))).real
                if kind == 1:
                    slack, slope = slack - _moved(z, disturbance).real, slope - slope_disturbance.real
                better = slack < least
                best, least = np.where(better, z, best), np.minimum(slack, least)
                z = self.spread.worst(slope)
            found.append(best)
        return found

    def _curves(self, inner: float) -> tuple[np.ndarray, np.ndarray]:
        """(2, d, n) first and second derivatives of the logarithms of both responses by the deviations."""
        here, curves = _responses(self, inner), []
        more, less = ([_responses(one, inner) for one in side] for side in (self.more, self.less))
        for k in range(2):
            up = np.array([np.log(one[k] / here[k]) for one in more])
            down = np.array([np.log(one[k] / here[k]) for one in less])
            curves.append(np.array([(up - down) / (2 * self.step), (up + down) / self.step**2]))
        return curves[0], curves[1]

    def _shifted(self, z: np.ndarray, control: np.ndarray, disturbance: np.ndarray) -> Samples:
        """Samples of these points with responses of rigs off by (d, n)."""
        moved, pushed = np.exp(_moved(z, control)), np.exp(_moved(z, disturbance))
        return Samples(
            self.frequency_Hz,
            self.row,
            self.denominator,
            self.control * moved,
            self.disturbance * pushed,
            self.looser,
        )


def _responses(points: Samples, inner: float) -> tuple[np.ndarray, np.ndarray]:
    plant = 1 + inner * points.denominator
    return (points.control[0] + inner * points.control[1]) / plant, (
        points.disturbance[0] + inner * points.disturbance[1]
    ) / plant


def _moved(z: np.ndarray, curves: np.ndarray) -> np.ndarray:
    """(n,) by how much the logarithm of a response moves."""
    return (z * (curves[0] + z * curves[1] / 2)).sum(axis=0)


def worst_samples(
    nominal: Samples, spread: RigSpread, sampled: Callable[[tuple[Member, ...]], Samples]
) -> WorstSamples:
    """Samples of the rigs within a spread.

    Args:
        nominal: of the nominal rig.
        spread: how far its figures may be off.
        sampled: samples of the members of a rig at the same points.
    """
    step, count = spread.sigmas / 2, len(spread.deviations)
    more, less = (tuple(sampled(spread.members(side * step * unit)) for unit in np.eye(count)) for side in (1.0, -1.0))
    return WorstSamples(
        nominal.frequency_Hz,
        nominal.row,
        nominal.denominator,
        nominal.control,
        nominal.disturbance,
        nominal.looser,
        spread,
        more,
        less,
        step,
    )


MOST_RIGS = 8
"""How many of the worst rigs of a design are proved, at most."""

_NEAR, _APART = 0.08, 0.5
"""Slack (logarithm) up to which a limit counts as reached, and how many of the standard deviations in all two rigs have
to be apart to be two."""


def worst_rigs(
    points: WorstSamples, goal: Goal, variables: np.ndarray, most: int = MOST_RIGS
) -> tuple[np.ndarray, ...]:
    """(d,) deviations of each of the worst rigs for all limits that are about to be reached, the worst first."""
    found = slacks(points, goal, variables, slopes=False)
    reached = sampled_bandwidth(points, found.compliance)
    limits, compliance, gain = points.deviations(variables)
    below = np.where(points.frequency_Hz <= reached, found.compliance, np.inf)
    listed: list[tuple[float, np.ndarray]] = []
    for slack, z in (
        (found.sensitivity, limits),
        (below, compliance),
        (found.loop_gain, gain),
        (found.effort, limits),
    ):
        listed += [(float(slack[k]), points.spread.rounded(z[:, k])) for k in np.nonzero(slack < _NEAR)[0]]
    chosen: list[np.ndarray] = []
    for _, z in sorted(listed, key=lambda pair: pair[0]):
        size = np.linalg.norm(z)
        if len(chosen) < most and all(np.linalg.norm(z - other) > _APART * size for other in chosen):
            chosen.append(z)
    return tuple(chosen)
