"""What a record is held against: the believed rig as a linear loop, and the equation of its controller.

The loop is quick enough to try many readings of a record against it. The equation, i = K C(s) (command - F x), is the
one that measured channels can check alone: whatever the rig does, command, displacement as the controller saw it and
current must obey it. Where they do not, either the record is not what it says it is, or the amplifier does something of
its own: saturate, lag, have another gain.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf, log, pi, sqrt

import numpy as np
from scipy.optimize import least_squares, minimize_scalar
from scipy.signal import cont2discrete, fftconvolve

from beamdesign.controllers import Controller, Lag
from beamdesign.diagnosis.data.dataset import FrequencyResponse, MeasuredGain, TimeRecord
from beamdesign.diagnosis.data.input_noise import TOP, band_levels, noise_lines
from beamdesign.diagnosis.fitting.weighting import banded, faded, white
from beamdesign.plant.assembly import assemble, parameters_of, structure_of
from beamdesign.plant.component import law_inputs, state_space
from beamdesign.plant.equilibrium import StateSpace, linearise
from beamdesign.prototype import Prototype
from beamdesign.quantities import LawGain, range_of

CHANNELS = ("current_A", "displacement_m", "load_pressure_Pa", "inner_displacement_m")


class NominalLoop(StateSpace):
    """The closed loop of a prototype without effects, from force and command to `CHANNELS`."""

    @property
    def slowest_Hz(self) -> float:
        """Of the modes that swing."""
        swinging = np.abs(self.poles[np.abs(self.poles.imag) > 0.2 * np.abs(self.poles)])
        return float(swinging.min()) / (2 * pi) if len(swinging) else float(np.abs(self.poles).min()) / (2 * pi)

    def responses(self, frequencies_Hz: np.ndarray) -> np.ndarray:
        """(N, 4, 2) from force (N) and command (V) to `CHANNELS`."""
        values, vectors = np.linalg.eig(self.a)
        left, right = self.c @ vectors, np.linalg.solve(vectors, self.b.astype(complex))
        s = 2j * pi * np.asarray(frequencies_Hz)[:, None]
        residues = (left[:, None, :] * right.T[None, :, :]).reshape(8, -1)
        return ((1 / (s - values)) @ residues.T).reshape(-1, 4, 2) + self.d

    def driven(self, inputs: np.ndarray, step_s: float) -> np.ndarray:
        """(N, 4, 2) shares of force and of command in each of `CHANNELS`, from rest.

        Args:
            inputs: (N, 2) force and command, band-limited between samples.
            step_s: sampling interval.
        """
        count = len(inputs)
        padded = 2 * count
        shares = self.responses(np.fft.rfftfreq(padded, step_s))
        spectra = np.fft.rfft(inputs * faded(count)[:, None], padded, axis=0)
        return np.fft.irfft(shares * spectra[:, None, :], padded, axis=0)[:count]


def nominal_loop(prototype: Prototype, taken: TimeRecord | FrequencyResponse | MeasuredGain) -> NominalLoop:
    """The loop of a prototype's own equations about rest, its effects left out.

    Args:
        prototype: believed.
        taken: with the controller and the end masses.
    """
    rig = prototype.but(effects={}, controller=taken.controller)
    assembly = assemble(structure_of(rig))
    parameters = np.array(list(parameters_of(rig, taken.outer_end_mass, taken.inner_end_mass).values()))
    of = linearise(assembly, np.zeros(len(assembly.states)), np.zeros(3), parameters)
    felt = {"load_pressure_Pa": prototype.actuator.feels[0]}
    seen, driven = [assembly.outputs.index(felt.get(name, name)) for name in CHANNELS], slice(2)
    return NominalLoop(of.a, of.b[:, driven], of.c[seen], of.d[seen, driven])


def expected(record: TimeRecord, prototype: Prototype) -> Mapping[str, np.ndarray] | None:
    """(N, 2) shares of force and command by channel of a record; None where the believed loop is unstable."""
    loop = nominal_loop(prototype, record)
    if not loop.stable:
        return None
    shares = loop.driven(record.inputs, record.step)
    felt = CHANNELS.index("load_pressure_Pa")
    return {name: shares[:, k] for k, name in enumerate(CHANNELS)} | {prototype.actuator.feels[0]: shares[:, felt]}


_LONGEST_LAG_S = 0.02
_KNEES = (3.0, 6.0, 12.0, 40.0)
_SATURATION_LEVELS = 24
_TRIED = 4000  # samples
_TRUSTED = 3.0  # by how much saturation must shrink the residual to be believed
_UNSEEN = 1e-6  # of the largest power of a line
_BREAKS_HZ = (0.05, 2000.0)
_GAINS = np.log([1.001 * range_of(LawGain).low, 0.999 * range_of(LawGain).high])
_BELOW, _ENOUGH = 0.8, 10  # of the largest current; samples for each state of a controller
_LEFT = 0.05  # residual that saturation may leave and be believed
_SURE = 3.0  # standard deviations of the noise's power
_SEEN = 0.01  # residual from which it is worth explaining
_CERTAIN = 6.0  # standard errors of a mean, five of a median
_Delay = Callable[[np.ndarray, float], np.ndarray]  # the factor on a spectrum, of angular frequencies and a time


@dataclass(frozen=True)
class ControllerFit:
    """How well a record obeys the controller it is said to have been taken with.

    Every residual is relative to the rms of the current and has the recorder's noise taken out; `noise` is what was
    taken out.

    Attributes:
        residual: of the equation as stated.
        noise: of current and sensors together, white as it was recorded, see `noise_through_law`.
        doubt: what may be left of noise alone, whose power is known no better than the median of as many exponential
            numbers as it has lines tells their mean.
        gain: current over what the controller would give, best in the mean square; 1 where all is well.
        with_gain: residual once that factor is allowed.
        delay_s: best dead time between the equation's current and the measured one, together with a gain.
        with_delay: residual once it is allowed.
        lag_s: best time constant of a first-order lag there, together with a gain.
        with_lag: residual once it is allowed.
        limit_A: level at which the current saturates; None where it does not.
        with_limit: residual once saturation is allowed; `residual` where there is none.
        offset_A: constant that most of the current is off by, which saturation is not; 0 within what noise makes.
    """

    residual: float
    noise: float
    doubt: float
    gain: float
    with_gain: float
    delay_s: float
    with_delay: float
    lag_s: float
    with_lag: float
    limit_A: float | None
    with_limit: float
    offset_A: float


def commanded_current(record: TimeRecord, controller: Controller, sensor_gain: float) -> np.ndarray | None:
    """(N,) current that a controller makes of a record's command and of what was sensed, A.

    Where its states stand at the beginning is not known of a record that was cut out of a longer one: they start where
    they fit the measured current best, an offset of that apart, over all of it that is not near its largest. None where
    the record lacks the current or a channel that the controller hears, or where its states run away when they are
    followed alone.

    Args:
        record: measured.
        controller: any.
        sensor_gain: believed, V/m.
    """
    if any(name not in record.measured for name in ("current_A", *controller.senses)):
        return None
    command, count = record.inputs[:, 1], len(record.times)
    given = {"error_V": command - sensor_gain * record.measured["displacement_m"], "command_V": command}
    sensed = np.column_stack([(given | dict(record.measured)).get(name, np.zeros(count)) for name in law_inputs()])
    a, b, c, d = state_space(controller.equations, controller.figures())
    if not len(a):
        return np.asarray(sensed @ d)
    # Exact for what goes straight from sample to sample; a band-limited signal bends between them, in first order so.
    bent = np.pad(np.diff(sensed, 2, axis=0) / 12, ((1, 1), (0, 0)))
    through = sensed @ d
    a, b, _, d, _ = cont2discrete((a, b, c[None, :], 0 * d[None, :]), record.step, "foh")
    fading = c[None, :]
    with np.errstate(over="ignore", invalid="ignore"):
        while len(fading) < count:
            fading, a = np.vstack([fading, fading @ a]), a @ a
    fading = fading[:count]
    if not np.all(np.isfinite(fading)):
        return None
    pulses = np.vstack([d, fading[:-1] @ b])
    asked = through + fftconvolve(pulses, sensed - bent, axes=0)[:count].sum(axis=1)
    size = np.abs(fading).max(axis=0)
    columns = np.column_stack([fading / np.where(size > 0, size, 1.0), np.ones(count)])
    current = record.measured["current_A"]
    below = np.abs(current) <= _BELOW * np.abs(current).max()  # what a limit cuts off says nothing of what was asked
    below |= below.sum() < _ENOUGH * columns.shape[1]
    shares = np.linalg.lstsq(columns[below], (current - asked)[below], rcond=1e-6)[0]
    return np.asarray(asked + columns[:, :-1] @ shares[:-1])


def noise_through_law(record: TimeRecord, controller: Controller, sensor_gain: float) -> np.ndarray:
    """(F,) power per sample, A^2, from 0 to the frequency of Nyquist, of what a law makes of white noise that it hears.

    A law that resonates, as an observer may, makes of white noise what is anything but white.

    Args:
        record: measured; the noise of a channel is read off its spectrum, see `noise_lines`.
        controller: any, whose channels were recorded.
        sensor_gain: believed, V/m.
    """
    count = len(record.times)
    frequencies = np.fft.rfftfreq(count, record.step)
    frequencies[0] = frequencies[1]  # a law that integrates has nothing to say of the mean
    power = np.zeros(len(frequencies))
    for name, response in controller.sensor_responses(frequencies).items():
        size = controller.gain_A_per_V * (sensor_gain if name == "displacement_m" else 1.0)
        spectrum = np.abs(np.fft.rfft(record.measured[name])) ** 2
        power += white(spectrum[noise_lines(spectrum, band_levels(spectrum))]) / count * np.abs(size * response) ** 2
    return power


def mismatch(measured: np.ndarray, predicted: np.ndarray, through_law: np.ndarray | None = None) -> tuple[float, float]:
    """Rms of what differs over the rms of what was measured: without its noise, and that noise.

    Args:
        measured: (N,).
        predicted: (N,).
        through_law: (F,) see `noise_through_law`; what it has beyond its top is noise as well, as far as it is there,
            and as the top shows that it is not in both: a controller obeys the noise that it has heard itself. White
            if None.
    """
    rms, count = float(np.std(measured)), len(measured)
    if rms == 0:
        return np.inf, 0.0
    difference = measured - predicted
    power, driven = (np.abs(np.fft.rfft(y - y.mean())) ** 2 / count for y in (difference, predicted))
    lines, shaped = np.arange(len(power)), np.zeros(len(power))
    if through_law is not None:
        shaped = np.interp(lines / len(power), np.arange(len(through_law)) / len(through_law), through_law)
    top = noise_lines(power, band_levels(power, np.maximum(driven - 2 * shaped, 0.0)))  # what is heard drives nothing
    noise, level = white(power[top]), float(shaped[top].mean())
    beyond = np.maximum(shaped - level, 0.0) * min(1.0, noise / max(level, 1e-300))
    noise += 2 * float(banded(np.column_stack([beyond, power]), lines).min(axis=1)[1:].sum()) / count
    total = float(np.var(difference))
    return float(np.sqrt(max(total - noise, 0.0))) / rms, float(np.sqrt(noise)) / rms


def controller_fit(record: TimeRecord, sensor_gain: float) -> ControllerFit | None:
    """Hold a record against its controller's equation; None where `commanded_current` cannot tell.

    Args:
        record: measured.
        sensor_gain: believed, V/m.
    """
    if (asked := commanded_current(record, record.controller, sensor_gain)) is None:
        return None
    current = asked + record.counted * (record.measured["current_A"] - asked)  # what does not count is as it should be
    through_law = noise_through_law(record, record.controller, sensor_gain)
    residual, noise = mismatch(current, asked, through_law)
    gain = _gain(current, asked)
    delay = _shifted(current, asked, through_law, record.step, lambda w, t: np.exp(-1j * w * t), both_ways=True)
    lag = _shifted(current, asked, through_law, record.step, lambda w, t: 1 / (1 + 1j * w * t), both_ways=False)
    limit, with_limit, left = _saturated(current, asked, through_law) if residual >= _SEEN else (None, residual, noise)
    if residual < max(_TRUSTED * with_limit, _SEEN) or with_limit > max(_LEFT, left):
        limit, with_limit = None, residual
    with_gain, offset = mismatch(current, gain * asked, through_law)[0], float(np.median(current - asked))
    if abs(offset) < _CERTAIN * float(np.std(current - asked)) / sqrt(len(current)):
        offset = 0.0
    doubt = noise * sqrt(_SURE / (log(2) * sqrt((1 - TOP) * len(current) / 2)))
    return ControllerFit(residual, noise, doubt, gain, with_gain, *delay, *lag, limit, with_limit, offset)


def _gain(current: np.ndarray, asked: np.ndarray) -> float:
    power = float(asked @ asked)
    return float(current @ asked) / power if power > 0 else 0.0


def _shifted(
    current: np.ndarray, asked: np.ndarray, through_law: np.ndarray, step: float, law: _Delay, both_ways: bool
) -> tuple[float, float]:
    """Best time of a law of delay, and the residual with it and a gain."""
    count = len(asked)
    spectrum, given = np.fft.rfft(asked, 2 * count), np.fft.rfft(current, 2 * count)
    rates = 2 * pi * np.fft.rfftfreq(2 * count, step)
    power = np.abs(spectrum) ** 2
    kept = power > _UNSEEN * power.max()  # what is nothing but noise says nothing of times
    rate, source, target = rates[kept], spectrum[kept], given[kept]

    def left(time: float) -> float:
        found = source * law(rate, time)
        size = float(np.vdot(found, found).real)
        return -(float(np.vdot(found, target).real) ** 2) / size if size > 0 else 0.0

    longest = min(_LONGEST_LAG_S, 0.1 * count * step)
    grid = np.concatenate([[0.0], np.geomspace(0.05 * step, longest, 14)])
    if both_ways:
        grid = np.concatenate([-grid[:0:-1], grid])
    values = [left(float(t)) for t in grid]
    k = int(np.argmin(values))
    low, high = float(grid[max(k - 1, 0)]), float(grid[min(k + 1, len(grid) - 1)])
    best = float(minimize_scalar(left, bounds=(low, high), method="bounded", options={"xatol": 1e-3 * step}).x)
    if left(best) > values[k]:
        best = float(grid[k])
    # What passes the end of the record has nowhere to go.
    inside = slice(0, count - max(2, round(0.02 * count)))
    found = np.fft.irfft(spectrum * law(rates, best), 2 * count)[inside]
    return best, mismatch(current[inside], _gain(current[inside], found) * found, through_law)[0]


def _knee(asked: np.ndarray, limit: float, sharpness: float) -> np.ndarray:
    """Asked / (1 + |asked / limit|^sharpness)^(1 / sharpness), for ratios whose powers overflow as well."""
    ratio = np.abs(asked / limit)
    small = np.minimum(ratio, 1 / np.maximum(ratio, 1))
    return np.asarray(np.copysign(limit * np.minimum(ratio, 1), asked) / (1 + small**sharpness) ** (1 / sharpness))


def _saturated(current: np.ndarray, asked: np.ndarray, through_law: np.ndarray) -> tuple[float | None, float, float]:
    """Level of a symmetric limit, sharp or rounded; the residual with it, and the noise taken out of that."""
    largest = float(np.abs(asked).max())
    if largest == 0:
        return None, np.inf, 0.0
    levels = np.abs(current).max() * np.geomspace(0.7, 1.6, _SATURATION_LEVELS)
    trials = [(limit, sharpness) for limit in levels[levels < largest] for sharpness in _KNEES]
    some = slice(None, None, 1 + len(asked) // _TRIED)  # the law holds sample by sample
    errors = [float(np.sum((current[some] - _knee(asked[some], *trial)) ** 2)) for trial in trials]
    if not errors:
        return None, np.inf, 0.0
    level, sharpness = trials[int(np.argmin(errors))]

    def left(limit: float) -> float:
        return float(np.sum((current - _knee(asked, limit, sharpness)) ** 2))

    bounds = (level / 1.05, level * 1.05)
    best = float(minimize_scalar(left, bounds=bounds, method="bounded", options={"xatol": 1e-4 * level}).x)
    return best, *mismatch(current, _knee(asked, best, sharpness), through_law)


def missed_by(record: TimeRecord, controller: Controller, sensor_gain: float) -> float:
    """Residual of another controller's equation, as in `ControllerFit`; infinite where `commanded_current` cannot tell.

    Args:
        record: measured.
        controller: that one.
        sensor_gain: believed, V/m.
    """
    if (asked := commanded_current(record, controller, sensor_gain)) is None:
        return inf
    return mismatch(record.measured["current_A"], asked, noise_through_law(record, controller, sensor_gain))[0]


def refitted(record: TimeRecord, sensor_gain: float) -> Controller:
    """The lag controller that a record obeys best.

    Args:
        record: measured.
        sensor_gain: believed, V/m.
    """
    current = record.measured["current_A"]
    size = float(np.std(current)) or 1.0

    def lag(z: np.ndarray) -> Lag:
        gain = np.exp(np.clip(z[0], *_GAINS))
        pole, zero = np.exp(np.clip(z[1:], *np.log(_BREAKS_HZ)))
        return Lag(gain_A_per_V=float(gain), pole_Hz=float(pole), zero_Hz=float(zero))

    def left(law: Lag) -> np.ndarray:
        asked = commanded_current(record, law, sensor_gain)
        assert asked is not None  # a lag hears the displacement alone, and is stable
        return np.asarray((current - asked) / size)

    own = record.controller
    starts = [(own.gain_A_per_V, 1.0, 1.5), (own.gain_A_per_V, 2.0, 20.0)]
    if breaks := own.lag:
        starts.append((own.gain_A_per_V, breaks.pole_Hz, breaks.zero_Hz))
    fits = (least_squares(lambda z: left(lag(z)), np.log(s), method="lm", max_nfev=60) for s in starts)
    return lag(min(fits, key=lambda f: f.cost).x)


def described(controller: Controller) -> str:
    """A controller in words."""
    return f"{controller.words()}, {controller.gain_A_per_V:.3g} A/V"


_MOST, _LINES = 0.6, 6  # of the power left beyond noise; of hum and its harmonics at most
_STANDS_OUT, _LITTLE = 10.0, 0.02  # times the noise; of the power left, which is not worth a line
_UNHEARD = 0.3  # of a line's power: what the current has of it at most


def lines_left(record: TimeRecord, sensor_gain: float) -> tuple[tuple[float, ...], float]:
    """Lines that carry most of what the equation leaves, each of what those before it leave, and what lies besides.

    Returns:
        their frequencies, Hz; and of the power left the share that is none of them, if the recorder of the displacement
        alone has them, as mains hum: the controller has not heard what the current has nothing of. 1 for other lines,
        which may be of the rig.
    """
    if (asked := commanded_current(record, record.controller, sensor_gain)) is None:
        return (), 1.0
    current, found = record.measured["current_A"], list[float]()
    taper, frequencies = np.hanning(len(asked)), np.fft.rfftfreq(len(asked), record.step)
    left, heard = (np.abs(np.fft.rfft((y - y.mean()) * taper)) ** 2 for y in (current - asked, current))
    level, unheard = white(left), True
    whole = rest = float(left.sum()) - level * len(left)
    while rest > _LITTLE * whole and len(found) < _LINES:
        peak = int(np.argmax(left))
        near = slice(max(peak - 2, 0), peak + 3)
        if left[near].sum() < _MOST * rest or left[peak] < _STANDS_OUT * level:
            break
        found.append(float(frequencies[peak]))
        unheard &= bool(heard[near].sum() < _UNHEARD * left[near].sum())
        rest -= float(left[near].sum())
        left[near] = 0.0
    return tuple(found), max(rest, 0.0) / whole if found and unheard else 1.0
