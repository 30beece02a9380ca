"""What was measured as evidence: time records here, critical gains and frequency responses in files of their own."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from beamdesign.gap.data.dataset import Dataset, TimeRecord
from beamdesign.gap.fitting.fit import Evidence
from beamdesign.gap.fitting.gain_evidence import GainEvidence
from beamdesign.gap.fitting.replay import Replay, replay, simulated, simulated_with_slopes, steps
from beamdesign.gap.fitting.response_evidence import ResponseEvidence
from beamdesign.gap.fitting.unknowns import Placement
from beamdesign.gap.fitting.weighting import SHARE, Weighting, weighting

DISPLACEMENT = "displacement_m"
ROUGH = 0.1
"""Relative error of a linear loop that stands for a rig with nonlinear laws."""


@dataclass(frozen=True)
class RecordEvidence(Evidence):
    """A time record in units of misfit.

    Attributes:
        job: the record, ready to be simulated.
        weight: of its channels.
        measured: (N, C) those channels.
    """

    job: Replay
    weight: Weighting
    measured: np.ndarray = field(repr=False)
    _steps: dict[object, int] = field(default_factory=dict, repr=False, compare=False, kw_only=True)

    @property
    def name(self) -> str:
        """Of the record."""
        return self.record.name

    @property
    def record(self) -> TimeRecord:
        """As measured."""
        return self.job.record

    @property
    def condition(self) -> object:
        """Under which it was taken."""
        return self.record.condition

    @property
    def expected(self) -> float:
        """Misfit that noise alone leaves."""
        return self.weight.expected

    @property
    def floor(self) -> float:
        """Mean square of the displacement's noise over that of the displacement, at the frequencies that count."""
        column, count = self._displacement, len(self.record.times)
        return float(self.weight.noise_std[column] ** 2 * count * self.weight.kept.sum() / self._power)

    def error(self, residual: np.ndarray) -> float:
        """Mean square of the displacement's error over that of the displacement, at the frequencies that count."""
        return float(np.sum(np.abs(self.displacement(residual)) ** 2) / self._power)

    @cached_property
    def _power(self) -> float:
        return max(float(np.sum(np.abs(self.displacement(self.weight(self.measured))) ** 2)), 1e-300)

    @property
    def _displacement(self) -> int:
        return self.weight.channels.index(DISPLACEMENT)

    def displacement(self, residual: np.ndarray) -> np.ndarray:
        """(F,) spectrum of the displacement in what is weighed, m."""
        column = self._displacement
        real, imaginary = residual.reshape(2, -1, len(self.weight.channels))[:, :, column]
        return (real + 1j * imaginary) / self.weight.scale[column]

    def predicted(self, placement: Placement, z: np.ndarray) -> np.ndarray | None:
        """(N, C) channels of the model."""
        return simulated(self.job, placement, z, self.weight.channels, self._substeps(placement, z))

    def misfit(self, predicted: np.ndarray) -> np.ndarray:
        """(M,) measured less predicted, weighed."""
        return self.weight(self.measured - predicted)

    def linearised(self, placement: Placement, z: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """The residual and its derivative by z."""
        found = simulated_with_slopes(self.job, placement, z, self.weight.channels, self._substeps(placement, z))
        if found is None:
            return None
        predicted, slopes = found
        return self.misfit(predicted), -self.weight(slopes)

    def _substeps(self, placement: Placement, z: np.ndarray) -> int:
        # Counted anew only for another structure, or where the unknowns have gone a long way from where they were.
        key = (placement.assembly.kinds, tuple(np.round(z).astype(int)))
        if key not in self._steps:
            self._steps[key] = steps(self.job, placement, z)
        return self._steps[key]


def evidence_of(data: Dataset) -> tuple[Evidence, ...]:
    """Everything in a data set: time records, frequency responses, critical gains.

    Responses and gains are predicted by a linear loop, which is blind to friction, deadband and the like. Beside
    records, which these laws are fitted to, they count as no better than that loop is where such laws are at work.
    """
    rough = ROUGH if data.records else 0.0
    responses = tuple(ResponseEvidence(taken, data.prototype, share=max(SHARE, rough)) for taken in data.responses)
    gains = tuple(GainEvidence(taken, data.prototype, rough=rough) for taken in data.gains)
    return (*record_evidence(data), *responses, *gains)


def record_evidence(data: Dataset) -> tuple[RecordEvidence, ...]:
    """All time records of a data set."""
    found = []
    for record in (taken.cleaned for taken in data.records):
        channels = tuple(record.measured)
        weight = weighting(record, channels)
        measured = np.column_stack([record.measured[name] for name in channels])
        found.append(RecordEvidence(replay(record, data.prototype), weight, measured))
    return tuple(found)
