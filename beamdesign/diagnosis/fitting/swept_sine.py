"""A frequency response as it is measured: one sine after the other, simulated until it repeats itself.

What a deadband, a hysteresis, friction or a limit makes of a sine depends on its size, and no linear loop says it. The
nonlinear rig does, and its derivatives with it; of the motion the first harmonic is taken, as an analyser does (A. Gelb
and W. E. Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design, 1968, section 2.2).
"""

from dataclasses import dataclass
from functools import cache, cached_property
from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from beamdesign.diagnosis.data.dataset import FrequencyResponse, TimeRecord
from beamdesign.diagnosis.fitting.hypothesis import Placement
from beamdesign.diagnosis.fitting.replay import DISPLACEMENT, Begun, Replay, law_of_play
from beamdesign.plant.assembly import Structure, assemble, widened
from beamdesign.prototype import Prototype

if TYPE_CHECKING:
    from beamdesign.diagnosis.fitting.linear_evidence import LinearModel

_LOWEST_HZ, _HIGHEST_HZ = 1.0, 400.0
_SETTLES_S, _SETTLES_PERIODS, _LISTENS_S = 0.5, 4, 0.05
_STEP = 1e-4  # in prior standard deviations, of central differences
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
    """Sines of a frequency response, ready to be simulated with any figures and any effects.

    Attributes:
        measured: the response, with the amplitude of its input.
        prototype: that was believed.
        most: lines that are simulated.
    """

    measured: FrequencyResponse
    prototype: Prototype
    most: int

    @cached_property
    def lines(self) -> np.ndarray:
        """(S,) positions of the lines that are simulated: no more than `most`, even over ln f.

        They lie from 1 to 400 Hz of a rig as quick as the published one.
        """
        hertz = self.measured.frequencies_Hz
        low, high = widened(self.prototype, _LOWEST_HZ, _HIGHEST_HZ)
        inside = np.flatnonzero((hertz >= low) & (hertz <= high))
        if len(inside) <= self.most:
            return inside
        evenly = np.geomspace(hertz[inside[0]], hertz[inside[-1]], self.most)
        return inside[np.unique(np.searchsorted(hertz[inside], evenly * (1 - 1e-9)))]

    @cached_property
    def between(self) -> np.ndarray:
        """(N, S) what gives figures of all lines from those of the simulated ones: straight over ln f, level beyond."""
        octaves = np.log(self.measured.frequencies_Hz)
        return np.column_stack([np.interp(octaves, octaves[self.lines], one) for one in np.eye(len(self.lines))])

    @cached_property
    def _sines(self) -> list[tuple[Replay, np.ndarray]]:
        """Of every such line its sine, and what takes the displacement's first harmonic, over the input, from it."""
        return [self._sine(float(hertz)) for hertz in self.measured.frequencies_Hz[self.lines]]

    def _sine(self, hertz: float) -> tuple[Replay, np.ndarray]:
        taken = self.measured
        assert taken.amplitude is not None
        each = max(_LEAST_SAMPLES, ceil(1 / (hertz * _SAMPLE_S)))
        settles, listens = max(_SETTLES_PERIODS, ceil(_SETTLES_S * hertz)), ceil(_LISTENS_S * hertz)
        times = np.arange((settles + listens) * each + 1) / (each * hertz)
        turns = 2 * np.pi * hertz * times
        inputs = np.zeros((len(times), 2))
        inputs[:, taken.driven_by] = taken.amplitude * np.sin(turns)
        listened = np.zeros(len(times), complex)
        window = slice(settles * each, -1)
        listened[window] = 2j * np.exp(-1j * turns[window]) / (listens * each * taken.amplitude)
        still = {DISPLACEMENT: np.zeros(len(times))}
        masses = taken.outer_end_mass, taken.inner_end_mass
        return Replay(TimeRecord(taken.name, times, inputs, still, *masses, taken.controller), self.prototype), listened

    def response(
        self, placement: Placement, z: np.ndarray, linear: "LinearModel | None", sloped: bool = True
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Response (S,) and the derivatives of its logarithm by z (S, K); None where the simulated loop diverges.

        Each sine begins as the linear loop would go on for ever, so that what has to settle is what the laws that are
        not linear change: beside a resonance of little damping a motion from rest takes seconds to.

        Args:
            placement: of the unknowns.
            z: their values.
            linear: the loop; None where it is not stable, and sines begin at rest.
            sloped: without slopes there are no derivatives, and it takes a fraction of the time.
        """
        found = np.zeros(len(self.lines), complex)
        slopes = np.zeros((len(self.lines), len(z) if sloped else 0), complex)
        begun = [None] * len(self.lines) if linear is None else self._begun(placement, z, linear, sloped)
        for k, (job, listened) in enumerate(self._sines):
            moved = job.simulated_with_slopes(placement, z, (DISPLACEMENT,), sloped, begun[k])
            if moved is None:
                return None
            found[k] = listened @ moved[0][:, 0]
            if sloped:
                slopes[k] = listened @ moved[1][:, 0] / found[k]
        return found, slopes

    def _begun(self, placement: Placement, z: np.ndarray, linear: "LinearModel", sloped: bool) -> list[Begun | None]:
        """Of every sine how it begins."""
        job, _ = self._sines[0]
        p, placed = job.parameters(placement, z), job.placed(placement)
        moved = list(placed.moved) if sloped else []
        step = _STEP * np.abs(placed.slopes(p)[moved]).max(axis=1, initial=0.0)
        nudged = np.zeros((len(p), len(moved)))
        nudged[moved, range(len(moved))] = step
        beside = np.column_stack([p, p[:, None] + nudged, p[:, None] - nudged])
        hertz = self.measured.frequencies_Hz[self.lines]
        states = np.zeros((len(hertz), beside.shape[1], len(placed.assembly.states)))
        places = [placed.assembly.states.index(name) for name in linear.assembly.states]
        states[:, :, places] = self.measured.amplitude * linear.turning(beside, self.measured.driven_by, hertz).imag
        by = (states[:, 1 : len(moved) + 1] - states[:, len(moved) + 1 :]) / (2 * step[:, None])
        return list(zip(states[:, 0], by.transpose(0, 2, 1), strict=True))
