"""What was measured as evidence: time records here, critical gains and frequency responses in files of their own.

A record is simulated with given figures, and its derivatives with it. A model may be made to follow it instead, for
motion that cannot be repeated: see `InjectedRecord`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from math import ceil

import numpy as np

from beamdesign.diagnosis.data.dataset import Dataset, TimeRecord
from beamdesign.diagnosis.fitting.fit import Evidence
from beamdesign.diagnosis.fitting.gain_evidence import GainEvidence
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, Placement, Unknown, given
from beamdesign.diagnosis.fitting.linear_evidence import ResponseEvidence
from beamdesign.diagnosis.fitting.weighting import (
    LOWEST_HZ,
    SHARE,
    Weighting,
    banded,
    blurred,
    faded,
    rising,
    weighting,
)
from beamdesign.plant.assembly import Structure, assemble, parameters_of
from beamdesign.plant.compiled import equilibrium_sensitivity, integrate, integrate_with_sensitivities
from beamdesign.plant.equilibrium import equilibrium, linearise
from beamdesign.prototype import Prototype
from beamdesign.simulation import half_steps

FURTHEST_M = 0.5
_RADIANS = 1.2  # of the fastest pole, per integration step: Runge-Kutta of fourth order is stable to 2.7
_LONGEST_S = 0.25e-3


@dataclass(frozen=True)
class Replay:
    """One record, ready to be simulated with any figures and any effects.

    Attributes:
        record: measured.
        prototype: that was believed.
    """

    record: TimeRecord
    prototype: Prototype
    _inputs: dict[int, np.ndarray] = field(default_factory=dict, repr=False, compare=False)
    _nominal: dict[tuple[str, ...], np.ndarray] = field(default_factory=dict, repr=False, compare=False)
    _substeps: dict[object, int] = field(default_factory=dict, repr=False, compare=False)

    def placed(self, placement: Placement) -> Placement:
        """The unknowns of a hypothesis in the equations with the law of this record."""
        return placement.under(self.record.controller.equations)

    def parameters(self, placement: Placement, z: np.ndarray) -> np.ndarray:
        """(P,) parameters with the unknowns at z, in the order of the assembly of `placed`."""
        effects = placement.assembly.kinds.effects
        if effects not in self._nominal:
            tables = {name: given(name, self.prototype) for name in effects}
            rig = self.prototype.but(controller=self.record.controller, effects=tables)
            figures = parameters_of(rig, self.record.outer_end_mass, self.record.inner_end_mass)
            self._nominal[effects] = np.array(list(figures.values()))
        return self.placed(placement).parameters(self._nominal[effects], z)

    def simulated(self, placement: Placement, z: np.ndarray, channels: tuple[str, ...]) -> np.ndarray | None:
        """(N, C) channels of the record with the unknowns at z; None where the simulated loop diverges."""
        found = self.simulated_with_slopes(placement, z, channels, sloped=False)
        return None if found is None else found[0]

    def noise_response(
        self, placement: Placement, z: np.ndarray, channels: tuple[str, ...], frequencies_Hz: np.ndarray
    ) -> np.ndarray:
        """(F, C) what channels read of a sine of 1 m of noise at the displacement's sensor, which the loop feeds back.

        By the linear loop at rest, no more than `_LOUDEST`, as a believed loop may be next to unstable; without a loop
        where the rig has no equilibrium.
        """
        placed, parameters = self.placed(placement), self.parameters(placement, z)
        heard = np.array([[complex(name == DISPLACEMENT) for name in channels]] * len(frequencies_Hz))
        try:
            loop = linearise(placed.assembly, at_rest(placed, parameters), np.zeros(3), parameters)
        except ValueError:
            return heard
        rows = [placed.assembly.outputs.index(name) for name in channels]
        whole = 2j * np.pi * frequencies_Hz[:, None, None] * np.eye(len(loop.a)) - loop.a
        moved = np.linalg.solve(whole, loop.b[:, [1]].astype(complex))[:, :, 0] @ loop.c[rows].T + loop.d[rows, 1]
        # noise at the sensor is a command with the other sign
        found = heard - self.prototype.sensor.gain_V_per_m * moved
        return np.asarray(found * np.minimum(1.0, _LOUDEST / np.abs(found[:, channels.index(DISPLACEMENT)]))[:, None])

    def simulated_with_slopes(
        self, placement: Placement, z: np.ndarray, channels: tuple[str, ...], sloped: bool = True
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Channels (N, C) and their derivatives by z (N, C, K); None where the simulated loop diverges.

        Without slopes there are no derivatives, and it takes a fraction of the time.
        """
        # Steps are counted anew only for another structure, or where the unknowns have gone a long way.
        key = (placement.assembly.kinds, placement.unknowns, tuple(np.round(z).astype(int)))
        parameters, placement = self.parameters(placement, z), self.placed(placement)
        assembly, times = placement.assembly, self.record.times
        columns = [assembly.outputs.index(name) for name in channels]
        try:
            start = at_rest(placement, parameters)
        except ValueError:
            return None
        if key not in self._substeps:
            self._substeps[key] = _steps(self.record.step, placement, parameters, start)
        substeps = self._substeps[key]
        if substeps not in self._inputs:
            self._inputs[substeps] = half_steps(self.record.inputs, substeps)
        inputs = self._inputs[substeps]
        if not sloped:
            y, _ = integrate(assembly.kinds, times, inputs, start, parameters, substeps, FURTHEST_M)
            return (y[:, columns], np.zeros(0)) if len(y) == len(times) else None
        names = tuple(assembly.parameters[k] for k in placement.moved)
        moved = equilibrium_sensitivity(assembly, start, np.zeros(3), parameters, names)
        y, dy = integrate_with_sensitivities(
            assembly.kinds, times, inputs, start, moved, parameters, names, substeps, FURTHEST_M, columns
        )
        if len(y) < len(times) or not np.all(np.isfinite(dy)):
            return None
        slopes = placement.slopes(parameters, z)[list(placement.moved)]
        return y[:, columns], (dy.reshape(-1, len(names)) @ slopes).reshape(*dy.shape[:2], -1)


def at_rest(placement: Placement, parameters: np.ndarray) -> np.ndarray:
    """Equilibrium without load, which masses have no part in: found once for all records of one law.

    Raises:
        ValueError: where there is none.
    """
    assembly = placement.assembly
    key = (assembly.kinds, parameters[_rigs_own(assembly.kinds)].tobytes())
    if key not in _found:
        if len(_found) > _KEPT:
            _found.clear()
        _found[key] = equilibrium(assembly, np.zeros(3), parameters)
    return _found[key]


_KEPT = 64
_found: dict[tuple[Structure, bytes], np.ndarray] = {}
_NO_PART = ("outer_end_mass", "inner_end_mass")


@cache
def _rigs_own(kinds: Structure) -> list[int]:
    return [k for k, name in enumerate(assemble(kinds).parameters) if name not in _NO_PART]


def _steps(sample_s: float, placement: Placement, parameters: np.ndarray, rest: np.ndarray) -> int:
    """Integration steps per sample: enough for the fastest pole at rest, and with a joint that has play bearing.

    What happens within the short while that a joint bears need be stable, not exact; more so where a record is followed
    than from rest, where it cannot be repeated anyway.
    """
    assembly = placement.assembly
    points = [(rest, 1.0)]
    if PLAY in assembly.kinds.effects:
        bearing = rest.copy()
        play = parameters[assembly.parameters.index(f"{PLAY}.play_m")]
        bearing[assembly.states.index(f"{PLAY}.rod_m")] = rest[assembly.states.index("inner_m")] + play / 2 + _BEARING_M
        points.append((bearing, _BRIEFLY if assembly.kinds.own_share == 1.0 else _FOLLOWING))
    try:
        fastest = max(
            float(np.abs(np.linalg.eigvals(linearise(assembly, x, np.zeros(3), parameters).a)).max()) * share
            for x, share in points
        )
    except np.linalg.LinAlgError:
        fastest = 1e4
    return max(1, ceil(sample_s / min(_LONGEST_S, _RADIANS / fastest) - 1e-9))


PLAY = "joint_backlash"
_BEARING_M, _BRIEFLY, _FOLLOWING = 2e-6, 0.45, 0.75  # shares: how much the poles of a joint that bears count


DISPLACEMENT = "displacement_m"
_LOUDEST = 10.0
Figure = GainEvidence | ResponseEvidence
"""What is not a time record."""
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
        return float(self.weight.noise[self._displacement].sum() / self._power)

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
        return self.job.simulated(placement, z, self.weight.channels)

    def misfit(self, predicted: np.ndarray) -> np.ndarray:
        """(M,) measured less predicted, weighed."""
        return self.weight(self.measured - predicted)

    def linearised(self, placement: Placement, z: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """The residual and its derivative by z."""
        found = self.job.simulated_with_slopes(placement, z, self.weight.channels)
        if found is None:
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


def figures_of(data: Dataset) -> tuple[Figure, ...]:
    """Frequency responses and critical gains of a data set.

    They are predicted by a linear loop, which is blind to friction, deadband and the like. Beside records, which these
    laws are fitted to, they count as no better than that loop is where such laws are at work.
    """
    rough = ROUGH if data.records else 0.0
    responses = (ResponseEvidence(taken, data.prototype, share=max(SHARE, rough)) for taken in data.responses)
    return (*responses, *(GainEvidence(taken, data.prototype, rough=rough) for taken in data.gains))


def record_evidence(data: Dataset) -> tuple[RecordEvidence, ...]:
    """All time records of a data set."""
    jobs = [Replay(taken.cleaned, data.prototype) for taken in data.records]
    rise = rising(filter(None, map(_at_the_sensor, jobs)))
    found = []
    for job in jobs:
        channels = tuple(job.record.measured)
        measured = np.column_stack([job.record.measured[name] for name in channels])
        found.append(RecordEvidence(job, in_the_loop(weighting(job.record, channels), job, rise), measured))
    return tuple(found)


def _at_the_sensor(job: Replay) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Frequencies, powers per sample of the displacement measured and of that predicted, as noise of the sensor."""
    placement, record = NOTHING.placement(job.prototype), job.record
    predicted = job.simulated(placement, np.zeros(len(placement.unknowns)), (DISPLACEMENT,))
    if predicted is None:
        return None
    moved, count = np.column_stack([record.measured[DISPLACEMENT], predicted]), len(record.times)
    frequencies = np.fft.rfftfreq(count, record.step)
    kept = frequencies > LOWEST_HZ
    power = np.abs(np.fft.rfft(moved * faded(count)[:, None], axis=0)[kept]) ** 2 / count
    own = power / _heard(job, (DISPLACEMENT,), frequencies[kept])
    return frequencies[kept], own[:, 0], own[:, 1]


def _heard(job: Replay, channels: tuple[str, ...], frequencies_Hz: np.ndarray) -> np.ndarray:
    """(F, C) power that channels have of the sensor's noise in the believed loop, over that noise's own."""
    placement = NOTHING.placement(job.prototype)
    return np.abs(job.noise_response(placement, np.zeros(len(placement.unknowns)), channels, frequencies_Hz)) ** 2


def in_the_loop(weight: Weighting, job: Replay, rise: Callable[[np.ndarray], np.ndarray] | None = None) -> Weighting:
    """A weighing that counts as noise what the believed loop makes of its sensor's noise, beyond what the top shows.

    Args:
        weight: by white noise.
        job: of the record.
        rise: of the noise's power per sample beyond white noise, by frequency.
    """
    lines = np.append(weight.frequencies_Hz, 0.5 / job.record.step)  # the last one: where noise was read off
    power = _heard(job, weight.channels, lines)
    count = len(weight.fade)
    white = weight.noise_std[weight.channels.index(DISPLACEMENT)] ** 2 * count
    more = white * np.maximum(power[:-1] - power[-1], 0.0)
    return blurred(weight, more if rise is None else more + count * rise(weight.frequencies_Hz)[:, None] * power[:-1])


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
        if PLAY not in placement.assembly.kinds.effects:
            return super().linearised(_injected(placement), z)
        here = self.residual(placement, z)
        if here is None:
            return None
        slopes = np.zeros((len(here), len(z)))
        for k, unknown in enumerate(placement.unknowns):
            ends = []
            for step in _secant(unknown, float(z[k]), self.secant):
                moved = z.copy()
                moved[k] = np.clip(z[k] + step, *unknown.bounds)
                there = self.residual(placement, moved) if moved[k] != z[k] else None
                ends.append((z[k], here) if there is None else (moved[k], there))
            if ends[0][0] != ends[1][0]:
                slopes[:, k] = (ends[0][1] - ends[1][1]) / (ends[0][0] - ends[1][0])
        return here, slopes

    def blurred(self, placement: Placement, z: np.ndarray) -> "InjectedRecord | None":
        """The record with what a model cannot predict of it counted as noise; None where the model's loop diverges."""
        power = spread(self, placement, z)
        return None if power is None else replace(self, weight=blurred(self.taken.weight, power))


def _secant(unknown: Unknown, z: float, step: float) -> tuple[float, float]:
    """Steps to either side, in prior standard deviations; of a play that is small against its prior, by a share."""
    if unknown.name == PLAY + ".play_m":
        step = step * min(1.0, 2 * _SHARE * unknown.value(z) / unknown.spread)
    return step, -step


def with_output_injection(taken: RecordEvidence) -> InjectedRecord:
    """A record as one that a model follows."""
    record, rig = taken.record, taken.job.prototype
    inputs = record.inputs.copy()
    inputs[:, 1] -= (1 - OWN_SHARE) * rig.sensor.gain_V_per_m * record.measured["displacement_m"]
    return InjectedRecord(Replay(replace(record, inputs=inputs), rig), taken.weight, taken.measured, taken)


def spread(piece: InjectedRecord, placement: Placement, z: np.ndarray) -> np.ndarray | None:
    """(F, C) mean power, about every line, of the difference of motions that differ by the sensor's noise alone.

    It is that of one motion from their mean; None where the model's loop diverges.
    """
    weight, rig = piece.taken.weight, piece.job.prototype
    noise_V = rig.sensor.gain_V_per_m * weight.noise_std[weight.channels.index("displacement_m")]
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
