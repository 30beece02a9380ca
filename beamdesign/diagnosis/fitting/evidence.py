"""What was measured as evidence: time records here, critical gains and frequency responses in files of their own.

A record is simulated with given figures, and its derivatives with it. A model may be made to follow it instead, for
motion that cannot be repeated: see `InjectedRecord`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from beamdesign.diagnosis.data.dataset import Dataset, TimeRecord
from beamdesign.diagnosis.data.input_noise import band_levels, noise_lines
from beamdesign.diagnosis.fitting.fit import Evidence, linearised
from beamdesign.diagnosis.fitting.gain_evidence import GainEvidence
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, Placement
from beamdesign.diagnosis.fitting.linear_evidence import ResponseEvidence
from beamdesign.diagnosis.fitting.replay import DISPLACEMENT, Replay, law_of_play
from beamdesign.diagnosis.fitting.weighting import (
    HIGHEST_HZ,
    LOWEST_HZ,
    SHARE,
    Rise,
    Weighting,
    banded,
    blurred,
    faded,
    rising,
    spectra,
    weighting,
)
from beamdesign.plant.assembly import assemble, widened
from beamdesign.records import Problem

Figure = GainEvidence | ResponseEvidence
"""What is not a time record."""
ROUGH = 0.1
"""Relative error of a linear loop that stands for a rig with nonlinear laws."""
_LINES, _FEW_LINES = 40, 12  # of a response that are simulated: alone, and beside records


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
        return float(self.weight.noise[self.column].sum() / self._power)

    def error(self, residual: np.ndarray) -> float:
        """Mean square of the displacement's error over that of the displacement, at the frequencies that count."""
        return float(np.sum(np.abs(self.displacement(residual)) ** 2) / self._power)

    @cached_property
    def _power(self) -> float:
        return max(float(np.sum(np.abs(self.displacement(self.weight(self.measured))) ** 2)), 1e-300)

    @property
    def column(self) -> int:
        """Of the displacement among the channels."""
        return self.weight.channels.index(DISPLACEMENT)

    def displacement(self, residual: np.ndarray) -> np.ndarray:
        """(F,) spectrum of the displacement in what is weighed, m."""
        real, imaginary = residual.reshape(2, -1, len(self.weight.channels))[:, :, self.column]
        return (real + 1j * imaginary) / self.weight.scale[self.column]

    def predicted(self, placement: Placement, z: np.ndarray) -> np.ndarray | None:
        """(N, C) channels of the model."""
        return self.job.simulated(placement, z, self.weight.channels)

    def misfit(self, predicted: np.ndarray) -> np.ndarray:
        """(M,) measured less predicted, weighed."""
        return self.weight(self.measured - predicted)

    def linearised(self, placement: Placement, z: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """The residual and its derivative by z."""
        if (found := self.job.simulated_with_slopes(placement, z, self.weight.channels)) is None:
            return None
        predicted, slopes = found
        return self.misfit(predicted), -self.weight(slopes)


def evidence_of(data: Dataset, synchronised: bool = False) -> tuple[Evidence, ...]:
    """Everything in a data set: time records, frequency responses, critical gains.

    Args:
        data: read.
        synchronised: whether its time records are ones that a model follows, see `InjectedRecord`.
    """
    records = record_evidence(data)
    return (*(map(with_output_injection, records) if synchronised else records), *figures_of(data))


def unpredicted(data: Dataset, evidence: Sequence[Evidence]) -> list[Problem]:
    """What keeps the believed model from predicting pieces of evidence, so that no fit begins."""
    placement = NOTHING.placement(data.prototype)
    z = np.zeros(len(placement.unknowns))
    of_records = ("prototype", "its loop is unstable with the controllers and masses of {}")
    of_responses = ("frequency_response", "the believed loop is unstable where a response was taken: {}")
    of_gains = ("critical_gain", "the believed loop oscillates at no gain: {}")
    words = [of_records] * len(data.records) + [of_responses] * len(data.responses) + [of_gains] * len(data.gains)
    lost = ((one, of) for one, of in zip(evidence, words, strict=True) if linearised([one], placement, z) is None)
    return [Problem(key, text.format(one.name)) for one, (key, text) in lost]


def figures_of(data: Dataset) -> tuple[Figure, ...]:
    """Frequency responses and critical gains of a data set.

    They are predicted by a linear loop, which is blind to friction, deadband and the like. Where a response meets such
    laws its sines are simulated, if their amplitude is stated. Beside records, which these laws are fitted to, figures
    count as no better than a linear loop is where such laws are at work, and fewer sines tell as much.
    """
    rough = ROUGH if data.records else 0.0
    lines = _FEW_LINES if rough else _LINES
    responses = (
        ResponseEvidence(taken, data.prototype, share=max(SHARE, rough), swept=0 if taken.amplitude is None else lines)
        for taken in data.responses
    )
    return (*responses, *(GainEvidence(taken, data.prototype, rough=rough) for taken in data.gains))


def record_evidence(data: Dataset) -> tuple[RecordEvidence, ...]:
    """All time records of a data set."""
    jobs = [Replay(taken.cleaned, data.prototype) for taken in data.records]
    measured = [np.column_stack([*job.record.measured.values()]) for job in jobs]
    believed = [_believed(job) for job in jobs]
    quiet = _quietest(jobs, measured, believed)
    pairs = zip(jobs, believed, strict=True)
    rise = rising(at_the_sensor(job, of, quiet[DISPLACEMENT]) for job, of in pairs if of is not None)
    found, band = [], widened(data.prototype, LOWEST_HZ, HIGHEST_HZ)
    for taken, job, seen in zip(data.records, jobs, measured, strict=True):
        channels = tuple(job.record.measured)
        plain = weighting(job.record, channels, band, np.array([quiet[name] for name in channels]))
        found.append(RecordEvidence(job, in_the_loop(plain, job, rise, taken.denoised[1]), seen))
    return tuple(found)


def _quietest(jobs: Sequence[Replay], measured: Sequence[np.ndarray], believed: Sequence[Any]) -> dict[str, np.ndarray]:
    """By channel the least levels of all records: noise is alike however hard a record is driven."""
    least: dict[str, np.ndarray] = {}
    for job, seen, of in zip(jobs, measured, believed, strict=True):
        made = np.zeros_like(seen) if of is None else of
        powers = (spectra(job.record, signals) for signals in (seen, made))
        for name, power, driven in zip(job.record.measured, *powers, strict=True):
            levels = band_levels(power, driven)
            least[name] = np.minimum(least.get(name, levels), levels)
    return least


OWN_SHARE = 0.3
"""Share of its own volts that the model's controller hears: one less the gain of the output injection. With none the
loop is open, and the least error in flow adds up to a drift that no fit can heed."""
_SHARE = 0.15
_MEMBERS = 4


@dataclass(frozen=True)
class InjectedRecord(RecordEvidence):
    """A time record that the model follows: what was measured stands in its command.

    In a joint with play, rod and beam hammer on each other. Two motions that begin a nanometre apart soon have nothing
    in common, so that the right model does no better from rest than any other. One keeps in step when its controller
    hears mostly the volts that were measured, and only a share `OWN_SHARE` of its own: what the hammering has done so
    far is then in the record, and need not be predicted. That is an observer with a fixed gain, and synchronisation by
    coupling to data (H. D. I. Abarbanel, Predicting the Future, Springer 2013, section 3). The plant, which every
    hypothesis about such a joint is about, still has to make all of the displacement. What remains unpredictable even
    so is measured, and counts as noise for every hypothesis alike: see `spread`.

    Attributes:
        taken: the record as it was taken.
        secant: half length of those that stand for derivatives, in prior standard deviations.
    """

    taken: RecordEvidence
    secant: float = 0.5

    @property
    def condition(self) -> object:
        """Under which it was taken."""
        return self.taken.condition

    def predicted(self, placement: Placement, z: np.ndarray) -> np.ndarray | None:
        """(N, C) channels of the model."""
        return super().predicted(_injected(placement), z)

    def linearised(self, placement: Placement, z: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """The residual and its derivative by z.

        Where there is play the derivative of the motion grows without bound along the record (to 1e20 within two
        seconds) and says nothing about figures that are off by more than a hair; secants do. They are taken to both
        sides, so that what is unpredictable here is not in all of them.
        """
        if not law_of_play(placement.assembly.kinds.effects):
            return super().linearised(_injected(placement), z)
        if (here := self.residual(placement, z)) is None:
            return None
        slopes = np.zeros((len(here), len(z)))
        for k, unknown in enumerate(placement.unknowns):
            ends, step = [], self.secant
            if unknown.name.endswith(".play_m"):  # of a play that is small against its prior, by a share
                step *= min(1.0, 2 * _SHARE * unknown.value(float(z[k])) / unknown.spread)
            for by in (step, -step):
                moved = z.copy()
                moved[k] = np.clip(z[k] + by, *unknown.bounds)
                there = self.residual(placement, moved) if moved[k] != z[k] else None
                ends.append((z[k], here) if there is None else (moved[k], there))
            if ends[0][0] != ends[1][0]:
                slopes[:, k] = (ends[0][1] - ends[1][1]) / (ends[0][0] - ends[1][0])
        return here, slopes

    def blurred(self, placement: Placement, z: np.ndarray) -> "InjectedRecord | None":
        """The record with what a model cannot predict of it counted as noise; None where the model's loop diverges."""
        power = spread(self, placement, z)
        return None if power is None else replace(self, weight=blurred(self.taken.weight, power))


def with_output_injection(taken: RecordEvidence) -> InjectedRecord:
    """A record as one that a model follows; with the servo off there is no loop to follow it in."""
    record, rig = taken.record, taken.job.prototype
    inputs = record.inputs.copy()
    inputs[:, 1] -= (1 - OWN_SHARE) * rig.sensor.gain_V_per_m * record.measured["displacement_m"]
    return InjectedRecord(Replay(replace(record, inputs=inputs), rig), taken.weight, taken.measured, taken)


def spread(piece: InjectedRecord, placement: Placement, z: np.ndarray) -> np.ndarray | None:
    """(F, C) mean power, about every line, of the difference of motions that differ by the sensor's noise alone.

    It is that of one motion from their mean; None where the model's loop diverges.
    """
    weight, rig = piece.taken.weight, piece.job.prototype
    noise_V = rig.sensor.gain_V_per_m * weight.noise_std[piece.column]
    random = np.random.default_rng(0)
    motions = []
    for _ in range(_MEMBERS):
        inputs = piece.record.inputs.copy()
        inputs[:, 1] += noise_V * random.standard_normal(len(inputs))
        found = replace(piece, job=Replay(replace(piece.record, inputs=inputs), rig)).predicted(placement, z)
        if found is None:
            return None
        motions.append(weight.lines(found))
    return banded(np.var(motions, axis=0, ddof=1), weight.frequencies_Hz)


def _injected(placement: Placement) -> Placement:
    return replace(placement, assembly=assemble(replace(placement.assembly.kinds, own_share=OWN_SHARE)))


def _believed(job: Replay) -> np.ndarray | None:
    """(N, C) what the believed model makes of the channels measured; None where it diverges."""
    placement = NOTHING.placement(job.prototype)
    return job.simulated(placement, np.zeros(len(placement.unknowns)), tuple(job.record.measured))


def at_the_sensor(job: Replay, believed: np.ndarray, quiet: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies, powers per sample of the displacement measured and of that predicted, as noise of the sensor.

    Args:
        job: of the record.
        believed: (N, C) its channels as predicted.
        quiet: (2, 20) least levels of the displacement; noise that a recorder has taken away is left out.
    """
    record, predicted = job.record, believed[:, [*job.record.measured].index(DISPLACEMENT)]
    moved, count = np.column_stack([record.measured[DISPLACEMENT], predicted]), len(record.times)
    frequencies, taper = np.fft.rfftfreq(count, record.step), faded(count) * record.counted
    power = np.abs(np.fft.rfft(moved * taper[:, None], axis=0)) ** 2 / np.sum(record.counted**2)
    kept = frequencies > LOWEST_HZ
    kept[noise_lines(power[:, 0], quiet).stop :] = False
    own = power[kept] / job.noise_power((DISPLACEMENT,), frequencies[kept])[0]
    return frequencies[kept], own[:, 0], own[:, 1]


def in_the_loop(weight: Weighting, job: Replay, rise: Rise | None, force_noise: np.ndarray) -> Weighting:
    """A weighing that counts as noise what the believed loop makes of noise at its sensor and in the force recorded.

    Args:
        weight: by white noise.
        job: of the record.
        rise: of the sensor's noise, its power per sample beyond white noise, by frequency.
        force_noise: (N,) that is left in the force, its power per sample (N^2), from 0 to the frequency of Nyquist.
    """
    highest = 0.5 / job.record.step
    lines = np.append(weight.frequencies_Hz, highest)  # the last one: where noise was read off
    power, of_force = job.noise_power(weight.channels, lines)
    count = float(np.sum(job.record.counted**2))
    white = weight.noise_std[weight.channels.index(DISPLACEMENT)] ** 2 * count
    more = white * np.maximum(power[:-1] - power[-1], 0.0)  # beyond what the top shows
    if rise is not None:
        more += count * rise(weight.frequencies_Hz)[:, None] * power[:-1]
    left = np.interp(weight.frequencies_Hz, np.linspace(0, highest, len(force_noise)), force_noise)
    # No more than was measured: a believed loop may be next to unstable.
    return blurred(weight, more + np.minimum(count * left[:, None] * of_force[:-1], weight.measured.T))
