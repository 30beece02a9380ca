"""A frequency response as it is measured: one sine after the other, simulated until it repeats itself.

What a deadband, a hysteresis, friction or a limit makes of a sine depends on its force, and no linear loop says it. The
nonlinear rig does, and its derivatives with it; of the motion the first harmonic is taken, as an analyser does (A. Gelb
and W. E. Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design, 1968, section 2.2).
"""

from dataclasses import dataclass
from functools import cache, cached_property
from math import ceil

import numpy as np

from beamdesign.diagnosis.data.dataset import FrequencyResponse, TimeRecord
from beamdesign.diagnosis.fitting.hypothesis import Placement
from beamdesign.diagnosis.fitting.replay import DISPLACEMENT, Replay, law_of_play
from beamdesign.plant.assembly import Structure, assemble
from beamdesign.prototype import Prototype

_SETTLES_S, _SETTLES_PERIODS, _LISTENS_S = 0.5, 4, 0.05
_RISES_S = 0.1  # of the force, to its amplitude
_SAMPLE_S, _LEAST_SAMPLES = 0.5e-3, 16  # of a period


@cache
def depends_on_size(kinds: Structure) -> bool:
    """Whether a rig's response to a sine depends on the size of the sine, and can be told by simulating it.

    A joint with play is left out: rod and beam hammer on each other, and no two motions have that in common.
    """
    if law_of_play(kinds.effects):
        return False
    function = assemble(kinds).function
    return any(function.which_depends("x", ["rate", "y"], 2))


@dataclass(frozen=True)
class SweptSine:
    """The sines of a frequency response, ready to be simulated with any figures and any effects.

    Attributes:
        measured: the response, whose force has the amplitude stated.
        prototype: that was believed.
    """

    measured: FrequencyResponse
    prototype: Prototype

    @cached_property
    def _sines(self) -> list[tuple[Replay, np.ndarray]]:
        """Of every line its sine, and what takes the first harmonic of the displacement over the force from it."""
        return [self._sine(float(hertz)) for hertz in self.measured.frequencies_Hz]

    def _sine(self, hertz: float) -> tuple[Replay, np.ndarray]:
        taken = self.measured
        each = max(_LEAST_SAMPLES, ceil(1 / (hertz * _SAMPLE_S)))
        settles, listens = max(_SETTLES_PERIODS, ceil(_SETTLES_S * hertz)), ceil(_LISTENS_S * hertz)
        times = np.arange((settles + listens) * each + 1) / (each * hertz)
        turns, rises = 2 * np.pi * hertz * times, np.minimum(times / _RISES_S, 1.0)
        inputs = np.zeros((len(times), 2))
        inputs[:, 0] = taken.amplitude_N * np.sin(turns) * (0.5 - 0.5 * np.cos(np.pi * rises))
        listened = np.zeros(len(times), complex)
        window = slice(settles * each, -1)
        listened[window] = 2j * np.exp(-1j * turns[window]) / (listens * each * taken.amplitude_N)
        still = {DISPLACEMENT: np.zeros(len(times))}
        masses = taken.outer_end_mass, taken.inner_end_mass
        return Replay(TimeRecord(taken.name, times, inputs, still, *masses, taken.controller), self.prototype), listened

    def response(self, placement: Placement, z: np.ndarray) -> np.ndarray | None:
        """(N,) complex response with the unknowns at z, m/N; None where the simulated loop diverges."""
        found = np.zeros(len(self._sines), complex)
        for k, (job, listened) in enumerate(self._sines):
            moved = job.simulated(placement, z, (DISPLACEMENT,))
            if moved is None:
                return None
            found[k] = listened @ moved[:, 0]
        return found

    def response_with_slopes(self, placement: Placement, z: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """The response (N,) and its derivatives by z (N, K); None where the simulated loop diverges."""
        found, slopes = np.zeros(len(self._sines), complex), np.zeros((len(self._sines), len(z)), complex)
        for k, (job, listened) in enumerate(self._sines):
            moved = job.simulated_with_slopes(placement, z, (DISPLACEMENT,))
            if moved is None:
                return None
            found[k], slopes[k] = listened @ moved[0][:, 0], listened @ moved[1][:, 0]
        return found, slopes
