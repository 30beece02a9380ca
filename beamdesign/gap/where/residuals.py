"""Records against the tuned nominal model, and the local variables of its equations behind each."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from beamdesign.gap.fitting.evidence import RecordEvidence
from beamdesign.gap.fitting.fit import Fit
from beamdesign.gap.fitting.hypothesis import NOTHING
from beamdesign.gap.fitting.replay import simulated_with_slopes, steps
from beamdesign.gap.where.probe import ENTRIES, SIGNALS, Probe, probe
from beamdesign.prototype import Prototype

_DOUBT = 0.3
_LEAST_NOISE = 1e-6
_HALF_BAND = 2 ** (1 / 4)


@dataclass(frozen=True)
class Residual:
    """One record against the tuned nominal model.

    Attributes:
        evidence: the record.
        probe: its linear rig.
        channels: recorded ones, as signals of the probe.
        left: (N, C) measured less predicted.
        slopes: (N, C, K) of the prediction by the tolerated figures.
    """

    evidence: RecordEvidence
    probe: Probe
    channels: tuple[str, ...]
    left: np.ndarray = field(repr=False)
    slopes: np.ndarray = field(repr=False)

    @property
    def noise(self) -> np.ndarray:
        """(C,) white noise of the channels, at least a millionth of what they hold."""
        rms = np.sqrt(np.mean(self.evidence.measured**2, axis=0))
        return np.asarray(np.maximum(self.evidence.weight.noise_std, _LEAST_NOISE * rms + 1e-30))

    def smoothed(self) -> dict[str, np.ndarray]:
        """(N,) local variables, most probable after the record: every equation may lack something, alike for its size.

        The unknown signals of all entries are independent, each with the spectrum of its equation's own variable times
        `_DOUBT` squared; the channels carry their noise. So no equation is favoured, and what one lacks does not
        explain itself through variables that were made from it.
        """
        weight, probed = self.evidence.weight, self.probe
        nominal = probed.driven(self.evidence.record.inputs)
        spectra = probed.spectrum(self.left * weight.fade[:, None])
        noise = self.noise**2 * len(self.left)
        gain = np.zeros((len(nominal), len(SIGNALS), len(self.channels)), dtype=complex)
        spread = np.zeros((len(nominal), len(self.channels), len(self.channels)), dtype=complex)
        spread[:, range(len(noise)), range(len(noise))] = noise
        for name, entry in ENTRIES.items():
            power = _DOUBT**2 * banded(np.abs(nominal[:, SIGNALS.index(entry.own)]) ** 2)
            through = probed.entry(name, SIGNALS)
            seen = through[:, [SIGNALS.index(c) for c in self.channels]]
            weighed = power[:, None] * seen.conj()
            gain += through[:, :, None] * weighed[:, None, :]
            spread += seen[:, :, None] * weighed[:, None, :]
        moved = np.einsum("fsc,fc->fs", gain, np.linalg.solve(spread, spectra[:, :, None])[:, :, 0])
        return self._signals(nominal + moved)

    def nominal(self) -> dict[str, np.ndarray]:
        """(N,) local variables of the nominal model."""
        return self._signals(self.probe.driven(self.evidence.record.inputs))

    def _signals(self, spectra: np.ndarray) -> dict[str, np.ndarray]:
        probed = self.probe
        found = dict(zip(SIGNALS, probed.signal(spectra).T, strict=True))
        pressure = spectra[:, SIGNALS.index("load_pressure_Pa")]
        found["pressure_rate_Pa_per_s"] = probed.signal(pressure * probed.laplace)
        found["stroke_m"] = found["outer_m"] - found["inner_m"]
        return found


def banded(power: np.ndarray) -> np.ndarray:
    """Mean power about each line, over half an octave."""
    lines = np.arange(len(power))
    low = np.floor(lines / _HALF_BAND).astype(int)
    high = np.minimum(np.ceil(lines * _HALF_BAND).astype(int) + 1, len(power))
    total = np.concatenate([[0.0], np.cumsum(power)])
    return np.asarray((total[high] - total[low]) / (high - low))


def residuals(prototype: Prototype, null: Fit, evidence: Sequence[object]) -> tuple[Residual, ...]:
    """Every record against the model with tuned tolerances."""
    placement = NOTHING.placement(prototype)
    found = []
    probes: dict[object, Probe] = {}
    for piece in evidence:
        if not isinstance(piece, RecordEvidence):
            continue
        substeps = steps(piece.job, placement, null.z)
        made = simulated_with_slopes(piece.job, placement, null.z, piece.weight.channels, substeps)
        if made is None:
            continue
        predicted, slopes = made
        channels = tuple("inner_m" if c == "inner_displacement_m" else c for c in piece.weight.channels)
        taken = piece.record
        key = (taken.outer_end_mass, taken.inner_end_mass, taken.controller, len(taken.times), taken.step)
        if key not in probes:
            probes[key] = probe(piece.job, placement, null.z)
        probed = probes[key]
        found.append(Residual(piece, probed, channels, piece.measured - predicted, slopes))
    return tuple(found)
