"""The rigs within the tolerances that leave a law least of its limits: what a robust search adds to its samples.

They are sought at every sampled point by linearising: the logarithms of all plant responses are known to second order
in each figure (cross terms left out), from rigs with one figure off. The worst rig of a point is that of the linearised
slack, linearised anew where it is: the first-order reliability method (A. M. Hasofer and N. C. Lind, Exact and
invariant second-moment code format, J. Eng. Mech. Div. ASCE 100, 1974). Here it only proposes: what is proposed is
sampled itself, and a design is proved over the whole box.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import pi
from typing import NamedTuple

import numpy as np

from beamdesign.controllers.form import Form
from beamdesign.plant.members import VertexModel
from beamdesign.prototype import Goal
from beamdesign.synthesis.loop_limits import LIMITED
from beamdesign.synthesis.loop_samples import Samples
from beamdesign.synthesis.loop_slacks import counting, least_gain_share, limit_logarithms
from beamdesign.synthesis.rig_spread import RigSpread

_LINEARISED = 4
"""How often a worst rig is sought anew from where the last one was."""

_MOST = 3
"""How many rigs are proposed for each limit at once, those with the least slack."""


class Cut(NamedTuple):
    """A rig that is off, at one outer end mass, as something that limits are held on.

    Attributes:
        z: by how many standard deviations each figure is off.
        outer_end_mass_kg: the mass.
        frequency_Hz: about which it is sampled more closely.
    """

    z: tuple[float, ...]
    outer_end_mass_kg: float
    frequency_Hz: float


@dataclass(frozen=True)
class Neighbours:
    """Samples of a rig, and of rigs with one figure off.

    Attributes:
        spread: how far the figures may be off.
        here: samples of the nominal rig.
        off: d pairs of samples of such rigs, one figure each a step larger, and smaller.
    """

    spread: RigSpread
    here: Samples
    off: tuple[tuple[Samples, Samples], ...]

    def worst(
        self, goal: Goal, form: Form, variables: np.ndarray, bandwidth_Hz: float, missed: float
    ) -> list[tuple[float, Cut]]:
        """The worst rigs of each limit that they may miss by more than so much (logarithm), the worst first.

        Args:
            goal: the limits.
            form: of the law.
            variables: (v,) those of the form, then the mass inside, kg.
            bandwidth_Hz: up to which compliance counts.
            missed: by how much at least.
        """
        found: list[tuple[float, Cut]] = []
        counts = counting(self.here, goal)
        counts[1] &= self.here.frequency_Hz <= bandwidth_Hz
        limits = limit_logarithms(goal)
        own = form.responses(variables[: form.size], 2j * pi * self.here.frequency_Hz)
        curves = self._curves(float(variables[form.size]))
        for kind, limit in enumerate(limits):
            if not counts[kind].any():
                continue
            z, least = self._found(kind, own, float(variables[form.size]), curves)
            slack = np.where(counts[kind], least + limit, np.inf)
            chosen: list[tuple[float, Cut]] = []
            for k in np.argsort(slack):
                if slack[k] >= -missed or len(chosen) == _MOST:
                    break
                at = float(self.here.outer_end_mass[k]), float(self.here.frequency_Hz[k])
                cut = Cut(tuple(map(float, self.spread.rounded(z[:, k]))), *at)
                if all(cut[:2] != other[:2] for _, other in chosen):
                    chosen.append((float(-slack[k]), cut))
            found += chosen
        return sorted(found, key=lambda pair: -pair[0])

    def _found(self, kind: int, own: np.ndarray, inner: float, curves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(d, n) deviations of the worst rigs, and (n,) what they leave of a limit of one."""
        _, control, disturbance, crossed = self.here.at(inner)
        p, effort = len(own), -np.log(np.abs(own[0]))
        parts = np.concatenate([own * control, disturbance[None], own * crossed])  # as `_responses` lists them
        best = z = np.zeros((len(self.off), parts.shape[1]))
        least = np.full(parts.shape[1], np.inf)
        for _ in range(_LINEARISED):
            off = parts * np.exp(_moved(z, curves))
            slope = curves[0] + z[:, None] * curves[1]
            loop, moved = off[:p].sum(axis=0), off[p:].sum(axis=0)
            by = np.einsum("rn,drn->dn", off[:p], slope[:, :p])
            if LIMITED[kind] == "loop_gain":
                slack, down = -np.log(np.abs(loop)), -(by / loop).real
            else:
                share = least_gain_share(loop) if LIMITED[kind] == "gain_margin" else 1.0
                slack, down = np.log(np.abs(1 + share * loop)), (share * by / (1 + share * loop)).real
            if LIMITED[kind] == "compliance":
                pushed = np.einsum("rn,drn->dn", off[p:], slope[:, p:])
                slack, down = slack - np.log(np.abs(moved)), down - (pushed / moved).real
            if LIMITED[kind] == "controller_effort":
                slack = slack + effort
            better = slack < least
            best, least = np.where(better, z, best), np.minimum(slack, least)
            z = self.spread.worst(down)
        return best, least

    def _curves(self, inner: float) -> np.ndarray:
        """(2, d, r, n) first and second derivatives of the logarithms of all responses by the deviations."""
        here, step = _responses(self.here, inner), self.spread.step
        up, down = (
            np.array(
                [
                    np.log(np.divide(_responses(one, inner), here, out=np.ones_like(here), where=here != 0))
                    for one in side
                ]
            )
            for side in zip(*self.off, strict=True)
        )
        return np.array([(up - down) / (2 * step), (up + down) / step**2])


def _responses(points: Samples, inner: float) -> np.ndarray:
    """(r, n) from current to each sensor, then from force to displacement, then what feedback adds to that."""
    _, control, disturbance, crossed = points.at(inner)
    return np.concatenate([control, disturbance[None], crossed])


def _moved(z: np.ndarray, curves: np.ndarray) -> np.ndarray:
    """(r, n) by how much the logarithms of the responses move."""
    return np.einsum("dn,drn->rn", z, curves[0]) + np.einsum("dn,drn->rn", z * z / 2, curves[1])


def neighbours(
    spread: RigSpread,
    sampled: Callable[[Sequence[VertexModel]], Samples],
    members: Callable[[np.ndarray], Sequence[VertexModel]],
) -> Neighbours:
    """Samples of the nominal rig and of its neighbours.

    Args:
        spread: how far the figures may be off.
        sampled: samples of the members of a rig.
        members: those of the rig with figures off by (d,) standard deviations.
    """
    ways = spread.step * np.eye(len(spread.deviations))
    here = sampled(members(0 * ways[0]))
    return Neighbours(spread, here, tuple((sampled(members(z)), sampled(members(-z))) for z in ways))
