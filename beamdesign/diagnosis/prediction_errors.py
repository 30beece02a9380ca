"""What models miss of a record's displacement."""

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Errors:
    """Displacement errors of three models on one record, over the rms of what was measured.

    Where the record does not count there is none; what counts is weighed so that a mean square over all is one over it.

    Attributes:
        name: of the record.
        times: (N,) s.
        measured: (N,) m.
        counted: (N,) by which errors are weighed, its mean square one; none where the record does not count.
        before: (N,) error of the believed prototype.
        tuned: (N,) with the tolerated figures fitted.
        after: (N,) with the chosen causes, by a fit without the held-out records.
        written: (N,) with the chosen causes, by the fit to all records, as the written prototype has it.
        noise: noise of the sensor over the rms.
        pace: how many times as quick as the published rig it was measured on, see `beamdesign.plant.assembly.pace`.
    """

    name: str
    times: np.ndarray = field(repr=False)
    measured: np.ndarray = field(repr=False)
    counted: np.ndarray = field(repr=False)
    before: np.ndarray = field(repr=False)
    tuned: np.ndarray = field(repr=False)
    after: np.ndarray = field(repr=False)
    written: np.ndarray = field(repr=False)
    noise: float
    pace: float = 1.0

    @property
    def quicker(self) -> float:
        """How many times as far up as of the published rig frequencies count."""
        return max(1.0, self.pace)

    @property
    def rms(self) -> float:
        """Of what was measured, where it counts, about its mean, m."""
        return float(np.std(self.measured[self.counted > 0]))

    def predicted(self, model: str) -> np.ndarray:
        """(N,) m, by one of `before`, `tuned`, `after` and `written`; NaN where the record does not count."""
        with np.errstate(invalid="ignore"):
            return np.asarray(self.measured - self.rms * getattr(self, model) / self.counted)

    def diverged(self, model: str) -> bool:
        """Whether a model gave no prediction, which counts as an error of the whole signal."""
        whole = self.counted * self.measured
        return bool(np.allclose(getattr(self, model) * self.rms, whole, rtol=1e-9, atol=0.0))
