"""Critical gains as evidence."""

from dataclasses import dataclass, field
from math import log, tau

import numpy as np

from beamdesign.gap.data.dataset import MeasuredGain
from beamdesign.gap.fitting.linear_model import LinearModel, linear_model
from beamdesign.gap.fitting.onset import Onset, onset, onset_slopes
from beamdesign.gap.fitting.unknowns import Placement
from beamdesign.prototype import Prototype

FREQUENCY_STD = 0.02
"""Relative, of the frequency that was noted with a critical gain."""


@dataclass(frozen=True)
class GainEvidence:
    """A critical gain in units of misfit: the logarithm of measured over predicted, over its relative error.

    Where the frequency of the oscillation was noted, it is a second such figure.

    Attributes:
        measured: the gain.
        prototype: that was believed.
        load: constant force on the outer tip under which it was measured, N.
        rough: relative error of the linear loop itself, beside that of the measurement.
        offset: added to the logarithm of the model's gain, where it is to be judged from another starting point.
    """

    measured: MeasuredGain
    prototype: Prototype
    load: float = 0.0
    rough: float = 0.0
    offset: float = 0.0
    _models: dict[object, LinearModel] = field(default_factory=dict, repr=False, compare=False)
    _last: dict[object, Onset | None] = field(default_factory=dict, repr=False, compare=False)

    @property
    def name(self) -> str:
        """In words."""
        masses = f"{self.measured.outer_end_mass:g} kg outer, {self.measured.inner_end_mass:g} kg inner"
        return f"critical gain, {self.measured.controller.words()}, {masses}"

    @property
    def condition(self) -> object:
        """Under which it was measured: masses, breaks of the controller, load."""
        law = self.measured.controller.model_dump(exclude={"gain_A_per_V"})
        masses = (self.measured.outer_end_mass, self.measured.inner_end_mass)
        return ("critical gain", *masses, *law.values(), self.load)

    @property
    def expected(self) -> float:
        """Misfit that noise alone leaves: one per figure."""
        stds = np.array([self.measured.relative_std, FREQUENCY_STD][: len(self.units)])
        return float(np.sum((stds / self.units) ** 2))

    @property
    def units(self) -> np.ndarray:
        """(M,) relative error that is one unit, of every row of the residual."""
        stds = np.hypot([self.measured.relative_std, FREQUENCY_STD], self.rough)
        return np.asarray(stds[: 1 if self.measured.frequency_Hz is None else 2])

    def model(self, placement: Placement) -> LinearModel:
        """The linear loop of this setting."""
        key = (placement.assembly.kinds, placement.unknowns)
        if key not in self._models:
            taken = self.measured
            self._models[key] = linear_model(
                placement, self.prototype, taken.controller, taken.outer_end_mass, taken.inner_end_mass, self.load
            )
        return self._models[key]

    def predicted(self, placement: Placement, z: np.ndarray) -> Onset | None:
        """Gain and frequency of the model; None where it oscillates at no gain."""
        # A fit asks for the derivatives where it has just asked for the figures.
        key = (placement.assembly.kinds, placement.unknowns, z.tobytes())
        if key not in self._last:
            self._last.clear()
            self._last[key] = onset(self.model(placement), z, self.measured.raised_from)
        return self._last[key]

    @property
    def floor(self) -> float:
        """No record, so no displacement."""
        return 0.0

    def error(self, residual: np.ndarray) -> float:
        """No record, so no displacement."""
        return 0.0

    def residual(self, placement: Placement, z: np.ndarray) -> np.ndarray | None:
        """(1,) or (2,) measured less predicted."""
        at = self.predicted(placement, z)
        return None if at is None else self._misfit(at)

    def linearised(self, placement: Placement, z: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """The residual and its derivative by z."""
        at = self.predicted(placement, z)
        if at is None:
            return None
        gain, frequency = onset_slopes(self.model(placement), z, at)
        rows = np.array([-gain, -frequency][: len(self.units)])
        return self._misfit(at), rows / self.units[:, None]

    def _misfit(self, at: Onset) -> np.ndarray:
        taken = self.measured
        figures = [log(taken.gain / at.gain) - self.offset]
        if taken.frequency_Hz is not None:
            figures.append(log(tau * taken.frequency_Hz / at.frequency))
        return np.array(figures) / self.units
