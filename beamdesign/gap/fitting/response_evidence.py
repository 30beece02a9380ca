"""Frequency responses as evidence."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from beamdesign.gap.data.dataset import FrequencyResponse
from beamdesign.gap.fitting.linear_model import LinearEvidence
from beamdesign.gap.fitting.unknowns import Placement
from beamdesign.gap.fitting.weighting import INDEPENDENT, SHARE
from beamdesign.rig.assembly import INPUTS, OUTPUTS
from beamdesign.rig.equilibrium import Linearisation

_FORCE, _SEEN = INPUTS.index("disturbance_N"), OUTPUTS.index("displacement_m")
_STABLE = 1e-6  # rad/s
_NEIGHBOURS = 4
_LARGEST_NOISE = 0.5
_QUARTER, _MEDIAN = 0.3186, 0.6745  # quantiles of the size of a standard normal deviate


@dataclass(frozen=True)
class ResponseEvidence(LinearEvidence):
    """A frequency response in units of misfit.

    A line's residual is the logarithm of measured over predicted: that of the magnitude and, where the phase was
    measured, the phase difference in radians. Its unit is 2 % (`weighting.SHARE`) and the scatter of the lines about
    their neighbours together, and a response as a whole counts as no more than `weighting.INDEPENDENT` units.

    The response is that of the linear loop of `linear_model`, to the displacement that the controller sees. The force's
    amplitude has no part in it: what a saturation, or a friction not yet overcome, does to a response it does not say.
    Where the two directions of the valve differ a sine meets both alike, so the mean of both loops stands for them.

    Attributes:
        share: relative error of a model that counts as one unit.
    """

    measured: FrequencyResponse
    share: float = SHARE

    @cached_property
    def _noise(self) -> np.ndarray:
        return scatter(self.measured)

    @cached_property
    def _unit(self) -> np.ndarray:
        """(N,) relative error of each line that counts as one unit."""
        return np.sqrt(self.share**2 + self._noise**2)

    @cached_property
    def _count(self) -> int:
        return len(self._noise) * (2 if self.measured.has_phase else 1)

    @property
    def _scale(self) -> float:
        """Of all lines, for their number."""
        return min(1.0, float(np.sqrt(INDEPENDENT / self._count)))

    @property
    def expected(self) -> float:
        """Misfit that noise alone leaves."""
        each = self._count / len(self._noise) * self._scale**2
        return each * float(np.sum((self._noise / self._unit) ** 2))

    @property
    def name(self) -> str:
        """Of the response."""
        return self.measured.name

    @property
    def condition(self) -> object:
        """Under which it was taken: masses, controller, amplitude."""
        taken = self.measured
        return ("response", taken.outer_end_mass, taken.inner_end_mass, taken.controller, taken.amplitude_N)

    @property
    def units(self) -> np.ndarray:
        """(M,) relative error that is one unit, of every row of the residual."""
        return np.tile(self._unit / self._scale, 2 if self.measured.has_phase else 1)

    def predicted(self, placement: Placement, z: np.ndarray) -> np.ndarray | None:
        """(N,) complex response of the model, m/N; None where its loop is unstable."""
        found = self._solved(placement, z)
        return None if found is None else found[0]

    def linearised(self, placement: Placement, z: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """The residual and its derivative by z."""
        found = self._solved(placement, z)
        if found is None:
            return None
        response, right, left = found
        model = self.model(placement)
        slopes = [model.slopes(z, x) for x in model.points(model.parameters(z))]
        columns = []
        for k in range(len(z)):
            by = _mean([side[k] for side in slopes])
            moved = np.einsum("ni,ij,nj->n", left, by.a, right) + left @ by.b[:, _FORCE]
            columns.append((moved + right @ by.c[_SEEN] + by.d[_SEEN, _FORCE]) / response)
        relative = np.array(columns).reshape(len(z), len(response)).T
        return self.misfit(response), -self._weighed(relative)

    def _solved(self, placement: Placement, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Response (N,), states (N, n) per newton and their adjoints (N, n) at every line."""
        model = self.model(placement)
        p = model.parameters(z)
        try:
            loop = _mean([model.at(p, x) for x in model.points(p)])
        except ValueError:
            return None
        weight = model.weight
        if np.linalg.eigvals(loop.a / weight[:, None] * weight[None, :]).real.max() > _STABLE:
            return None
        rates = 2j * np.pi * self.measured.frequencies_Hz
        resolvent = rates[:, None, None] * np.eye(len(loop.a)) - loop.a
        right = np.linalg.solve(resolvent, np.tile(loop.b[:, _FORCE, None], (len(rates), 1, 1)))[..., 0]
        seen = np.tile(loop.c[_SEEN, :, None], (len(rates), 1, 1))
        left = np.linalg.solve(resolvent.transpose(0, 2, 1), seen)[..., 0]
        return right @ loop.c[_SEEN] + loop.d[_SEEN, _FORCE], right, left

    def misfit(self, predicted: np.ndarray) -> np.ndarray:
        """(N,) or, with phase, (2 N,) measured less predicted, weighed."""
        ratio = self.measured.response / (predicted if self.measured.has_phase else np.abs(predicted))
        return self._weighed(np.log(ratio.astype(complex))[:, None])[:, 0]

    def _weighed(self, relative: np.ndarray) -> np.ndarray:
        """Complex (N, K) relative changes as rows of units: magnitudes, then phases where they were measured."""
        shaped = relative * (self._scale / self._unit)[:, None]
        return np.concatenate([shaped.real, shaped.imag]) if self.measured.has_phase else shaped.real


def scatter(measured: FrequencyResponse) -> np.ndarray:
    """(N,) relative noise of each line: how far magnitudes stand off the straight line between their neighbours'.

    The median over the lines around, so that a single odd line does not count. A resonance bends over more lines than
    these, so it is no more than either a noise that is everywhere the same share, read off the quarter of the lines
    that stand off least, or one that is everywhere the same displacement, read off the highest fifth. Zero for fewer
    than five lines.
    """
    size, place = np.abs(measured.response), np.log(measured.frequencies_Hz)
    magnitude, count = np.log(size), len(place)
    if count < 5:
        return np.zeros(count)
    share = (place[1:-1] - place[:-2]) / (place[2:] - place[:-2])
    off = magnitude[1:-1] - (1 - share) * magnitude[:-2] - share * magnitude[2:]
    single = np.abs(off) / np.sqrt(1 + share**2 + (1 - share) ** 2)
    around = [float(np.median(single[max(0, k - 1 - _NEIGHBOURS) : k + _NEIGHBOURS])) for k in range(count)]
    relative = float(np.quantile(single, 0.25)) / _QUARTER
    last = max(1, count // 5)
    absolute = float(np.median((single * size[1:-1])[-last:])) / _MEDIAN / size
    return np.minimum(np.minimum(np.array(around) / _MEDIAN, np.maximum(relative, absolute)), _LARGEST_NOISE)


def _mean(loops: list[Linearisation]) -> Linearisation:
    return Linearisation(*(sum(getattr(loop, key) for loop in loops) / len(loops) for key in ("a", "b", "c", "d")))
