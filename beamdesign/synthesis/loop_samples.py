"""Loops sampled over frequency and end mass: what a search works on. Everything here is sampled and only proposes.

Of samples whose rig may be off each limit is held, at every point, on the worst rig within the tolerances there.
The logarithms of all plant responses are known to second order in each figure (cross terms left out), from rigs with
one figure off. The worst rig of a point is that of the linearised slack, linearised anew where it is: the first-order
reliability method (A. M. Hasofer and N. C. Lind, Exact and invariant second-moment code format, J. Eng. Mech. Div. ASCE
100, 1974). The worst rigs of a result are proved one by one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from math import pi

import numpy as np
from flint import fmpq_poly

from beamdesign.controllers import SENSED, Sensed
from beamdesign.controllers.form import Form
from beamdesign.plant.linear import BilinearPlant, PairOver
from beamdesign.plant.members import VertexModel
from beamdesign.polynomial import at_points
from beamdesign.prototype import Goal
from beamdesign.synthesis.loop_limits import RELAXED_PEAK, ends
from beamdesign.synthesis.rig_spread import RigSpread

COARSE_HZ = np.concatenate(
    [np.geomspace(0.05, 5, 25), np.geomspace(5.3, 150, 130), np.geomspace(155, 1e3, 25), [3e3, 1e4, 1e5]]
)
FINE_HZ = np.concatenate(
    [
        np.geomspace(0.01, 0.98, 20),
        np.geomspace(1, 4.9, 80),
        np.geomspace(5, 60, 250),
        np.geomspace(61, 150, 60),
        np.geomspace(153, 1200, 60),
        np.geomspace(1300, 1e5, 10),
    ]
)
"""Fine where peaks may be sharp; far above everything, the law's effort still grows."""

MODES_HZ = np.geomspace(155.0, 700.0, 100)
"""Further samples of rigs with effects, among which may be a second mode."""

_LINEARISED = 4
"""How often a worst rig is sought anew from where the last one was."""


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
        spread: of the rigs that are off, on the worst of which limits are held at every point; None for these alone.
        off: d pairs of samples of such rigs, one figure each a step larger, and smaller.
    """

    frequency_Hz: np.ndarray
    row: np.ndarray
    denominator: np.ndarray
    control: np.ndarray
    disturbance: np.ndarray
    crossed: np.ndarray
    outer_end_mass: np.ndarray
    relaxed: np.ndarray
    spread: RigSpread | None = None
    off: tuple[tuple["Samples", "Samples"], ...] = ()

    def joined(self, other: "Samples") -> "Samples":
        """With the points of another, of rigs that are off likewise, in rows of their own."""
        arrays = {name: value for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        whole = {name: np.concatenate([value, getattr(other, name)], axis=-1) for name, value in arrays.items()}
        whole["row"] = np.append(self.row, other.row + self.row.max() + 1)
        off = tuple(
            (larger.joined(more), smaller.joined(less))
            for (larger, smaller), (more, less) in zip(self.off, other.off, strict=True)
        )
        return replace(self, **whole, off=off)  # type: ignore[arg-type]  # all of them are arrays

    def at(self, inner: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Plant (n,), then control (p, n), disturbance (n,) and crossed (p, n) over it, with a mass inside (kg)."""
        plant = 1 + inner * self.denominator
        control = (self.control[:, 0] + inner * self.control[:, 1]) / plant
        crossed = (self.crossed[:, 0] + inner * self.crossed[:, 1]) / plant
        return plant, control, (self.disturbance[0] + inner * self.disturbance[1]) / plant, crossed

    def worst(self, goal: Goal, form: Form, variables: np.ndarray) -> tuple["Samples", ...]:
        """The samples that each limit is held on, as of `Slacks.held_on`: of the worst rig at every point, or these."""
        if self.spread is None:
            return (self,) * 4
        curves = self._curves(float(variables[form.size]))
        sensitivity, compliance, loop_gain = (
            self._shifted(_moved(z, curves)) for z in self._found(form, variables, curves)
        )
        return sensitivity, compliance, loop_gain, sensitivity

    def deviations(self, form: Form, variables: np.ndarray) -> list[np.ndarray]:
        """(d, n) standard deviations of the worst rigs for sensitivity and effort, for compliance, and for |L|."""
        return self._found(form, variables, self._curves(float(variables[form.size])))

    def _found(self, form: Form, variables: np.ndarray, curves: np.ndarray) -> list[np.ndarray]:
        assert self.spread is not None
        own = form.responses(variables[: form.size], 2j * pi * self.frequency_Hz)
        _, control, disturbance, crossed = self.at(float(variables[form.size]))
        p = len(own)
        parts = np.concatenate([own * control, disturbance[None], own * crossed])  # as `_responses` lists them
        found = []
        for kind in range(3):
            z = np.zeros((len(self.off), parts.shape[1]))
            best, least = z, np.full(parts.shape[1], np.inf)
            for _ in range(_LINEARISED):
                off = parts * np.exp(_moved(z, curves))
                slope = curves[0] + z[:, None] * curves[1]
                loop, moved = off[:p].sum(axis=0), off[p:].sum(axis=0)
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
        assert self.spread is not None
        here, step = _responses(self, inner), self.spread.step
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

    def _shifted(self, moved: np.ndarray) -> "Samples":
        """Samples of these points with responses whose logarithms are off by (r, n)."""
        p, factor = len(self.control), np.exp(moved)
        return replace(
            self,
            control=self.control * factor[:p, None],
            disturbance=self.disturbance * factor[p],
            crossed=self.crossed * factor[p + 1 :, None],
            spread=None,
            off=(),
        )


def _responses(points: Samples, inner: float) -> np.ndarray:
    """(r, n) from current to each sensor, then from force to displacement, then what feedback adds to that."""
    _, control, disturbance, crossed = points.at(inner)
    return np.concatenate([control, disturbance[None], crossed])


def _moved(z: np.ndarray, curves: np.ndarray) -> np.ndarray:
    """(r, n) by how much the logarithms of the responses move."""
    return np.einsum("dn,drn->rn", z, curves[0]) + np.einsum("dn,drn->rn", z * z / 2, curves[1])


def samples(
    plant: BilinearPlant,
    frequency_Hz: np.ndarray,
    outer_end_masses: Sequence[float],
    factor: float = 1.0,
    relaxed: float = 1.0,
) -> Samples:
    """A grid of frequencies at each of some outer end masses (kg), with the plant's gain times a factor."""
    masses, s = np.asarray(outer_end_masses, dtype=float)[:, None], 2j * pi * frequency_Hz

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
        sensors: of `beamdesign.controllers.SENSED`.
        relaxed: factor on the limit of sensitivity of members that are to perform.
    """
    parts = [
        samples(rig.polynomials(sensors), frequency_Hz, outer_end_masses, factor, relaxed if performs else RELAXED_PEAK)
        for rig, factor, performs in ends(members)
    ]
    return reduce(Samples.joined, parts)


def worst_samples(
    spread: RigSpread, members: Sequence[VertexModel], sampled: Callable[[Sequence[VertexModel]], Samples]
) -> Samples:
    """Samples of the rigs within a spread.

    Args:
        spread: how far the figures may be off.
        members: of the nominal rig.
        sampled: samples of the members of a rig at the same points.
    """
    ways = spread.step * np.eye(len(spread.deviations))
    off = tuple((sampled(spread.members(z)), sampled(spread.members(-z))) for z in ways)
    return replace(sampled(members), spread=spread, off=off)
