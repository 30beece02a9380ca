"""Frequency responses as evidence."""

from dataclasses import dataclass, field

import numpy as np

from beamdesign.gap.data.dataset import FrequencyResponse
from beamdesign.gap.fitting.linear_model import LinearModel, linear_model
from beamdesign.gap.fitting.unknowns import Placement
from beamdesign.gap.fitting.weighting import INDEPENDENT, SHARE
from beamdesign.prototype import Prototype
from beamdesign.rig.assembly import INPUTS, OUTPUTS
from beamdesign.rig.equilibrium import Linearisation

_FORCE, _SEEN = INPUTS.index("disturbance_N"), OUTPUTS.index("displacement_m")
_STABLE = 1e-6  # rad/s
_NEIGHBOURS = 4
_LARGEST_NOISE = 0.5
_QUARTER, _MEDIAN = 0.3186, 0.6745  # quantiles of the size of a standard normal deviate


@dataclass(frozen=True)
class ResponseEvidence:
    """A frequency response in units of misfit.

    A line's residual is the logarithm of measured over predicted: that of the magnitude and, where the phase was
    measured, the phase difference in radians. Its unit is 2 % (`weighting.SHARE`) and the scatter of the lines about
    their neighbours together, and a response as a whole counts as no more than `weighting.INDEPENDENT` units.

    The response is that of the linear loop of `linear_model`, to the displacement that the controller sees. The force's
    amplitude has no part in it: what a saturation, or a friction not yet overcome, does to a response it does not say.
    Where the two directions of the valve differ a sine meets both alike, so the mean of both loops stands for them.

    Attributes:
        measured: the response.
        prototype: that was believed.
        unit: (N,) relative error of each line that counts as one unit.
        scale: of all lines, for their number.
        expected: misfit that noise alone leaves.
    """

    measured: FrequencyResponse
    prototype: Prototype
    unit: np.ndarray = field(repr=False)
    scale: float
    expected: float
    _models: dict[object, LinearModel] = field(default_factory=dict, repr=False, compare=False)

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
        return np.tile(self.unit / self.scale, 2 if self.measured.has_phase else 1)

    def model(self, placement: Placement) -> LinearModel:
        """The linear loop of this setting."""
        key = (placement.assembly.kinds, placement.unknowns)
        if key not in self._models:
            taken = self.measured
            self._models[key] = linear_model(
                placement, self.prototype, taken.controller, taken.outer_end_mass, taken.inner_end_mass
            )
        return self._models[key]

    def predicted(self, placement: Placement, z: np.ndarray) -> np.ndarray | None:
        """(N,) complex response of the model, m/N; None where its loop is unstable."""
        found = self._solved(placement, z)
        return None if found is None else found[0]

    @property
    def floor(self) -> float:
        """No record, so no displacement."""
        return 0.0

    def error(self, residual: np.ndarray) -> float:
        """No record, so no displacement."""
        return 0.0

    def residual(self, placement: Placement, z: np.ndarray) -> np.ndarray | None:
        """(N,) or, with phase, (2 N,) measured less predicted, weighed."""
        found = self.predicted(placement, z)
        return None if found is None else self._misfit(found)

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
        return self._misfit(response), -self._weighed(relative)

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
        left = np.linalg.solve(resolvent.transpose(0, 2, 1), np.tile(loop.c[_SEEN, :, None], (len(rates), 1, 1)))[
            ..., 0
        ]
        return right @ loop.c[_SEEN] + loop.d[_SEEN, _FORCE], right, left

    def _misfit(self, predicted: np.ndarray) -> np.ndarray:
        ratio = self.measured.response / (predicted if self.measured.has_phase else np.abs(predicted))
        return self._weighed(np.log(ratio.astype(complex))[:, None])[:, 0]

    def _weighed(self, relative: np.ndarray) -> np.ndarray:
        """Complex (N, K) relative changes as rows of units: magnitudes, then phases where they were measured."""
        shaped = relative * (self.scale / self.unit)[:, None]
        return np.concatenate([shaped.real, shaped.imag]) if self.measured.has_phase else shaped.real


def response_evidence(measured: FrequencyResponse, prototype: Prototype, share: float = SHARE) -> ResponseEvidence:
    """Weigh a frequency response.

    Args:
        measured: the response.
        prototype: that was believed.
        share: relative error of a model that counts as one unit.
    """
    noise = scatter(measured)
    unit = np.sqrt(share**2 + noise**2)
    count = len(unit) * (2 if measured.has_phase else 1)
    scale = min(1.0, float(np.sqrt(INDEPENDENT / count)))
    expected = count / len(unit) * scale**2 * float(np.sum((noise / unit) ** 2))
    return ResponseEvidence(measured, prototype, unit, scale, expected)


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
