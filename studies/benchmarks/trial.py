"""A controller on trial on a true rig: whether the loop comes to rest, what it holds, and how much gain it would bear.

Everything is measured in time, as on a rig, because dead time, play, friction and digital steps only show there. The
rig is not shaken by anything but the trial: hum, noise and dropouts of the sensor are left out.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from beamdesign.validation.truth.case import Case, Drive, Run, run_figures, step_of
from beamdesign.validation.truth.nominal import assembled
from beamdesign.validation.truth.rig import SAMPLE_S, Motion, march

WATCHED_S = 1.5
"""After each of kick, load on and load off."""
KICK_S, RISE_S = 5e-3, 0.03
KICK_SHARE = 0.1
"""Of the largest load of the rig's records: height of the kick, and RMS of the force under which it is measured."""
COMMAND_V = 0.1
"""RMS of the command under which it is measured, for a sensor of the published gain (1180 V/m)."""
GAIN_FACTORS = (0.1, 10.0)
"""Within which the factor on the gain is looked for."""

_SETTLE_S, _LISTEN_S = 2.0, 4.0
_FADES, _FLOORS = 0.97, 2.0
_STEP, _NEAR = 1.25, 1.02


@dataclass(frozen=True)
class Trial:
    """What one payload showed.

    Attributes:
        outer_end_mass_kg: payload.
        restless: after which of kick, load on and load off it does not come to rest, in words; empty where it does.
        frequency_Hz: (f,) lines.
        compliance_m_per_N: (f,) outer tip over force, under a small random one; infinite where it is restless.
        peak_sensitivity: largest |1 - y / r| over the lines, r the command and y what comes back of it; likewise.
        gain_factor: least factor on the controller's gain at which a kick does not die away, to 2 %: below one where it
            does not with its own; infinite or 0 where there is none within `GAIN_FACTORS`.
    """

    outer_end_mass_kg: float
    restless: str
    frequency_Hz: np.ndarray
    compliance_m_per_N: np.ndarray
    peak_sensitivity: float
    gain_factor: float

    @property
    def safe(self) -> bool:
        """Whether it comes to rest after everything."""
        return not self.restless


def on_trial(case: Case, controller: dict[str, Any], inner_end_mass_kg: float, outer_end_mass_kg: float) -> Trial:
    """Put a controller on the true rig of a case, kick it, load it, relieve it, and measure it.

    Args:
        case: whose rig, with its true figures, background and effects.
        controller: table of the contract; a lag or a proportional one, as the rig's own electronics can be.
        inner_end_mass_kg: on the inner tip.
        outer_end_mass_kg: payload.

    Raises:
        ValueError: for another kind of controller.
    """
    if controller["kind"] not in ("lag", "proportional"):
        raise ValueError(f"the true rig has no {controller['kind']} controller")
    rig = _Rig(case, controller, inner_end_mass_kg, outer_end_mass_kg)
    restless = rig.restless()
    lines = np.unique(np.round(np.geomspace(0.25, 300.0, 70) * 4)) / 4
    factor = rig.gain_factor()
    if restless:
        return Trial(outer_end_mass_kg, restless, lines, np.full(len(lines), np.inf), float("inf"), factor)
    force, motion = rig.driven(lines, 0, KICK_SHARE * case.scales.force)
    compliance = np.abs(_at_lines(motion.outer, lines) / _at_lines(force, lines))
    volts = case.nominal["sensor"]["gain_V_per_m"]
    command, motion = rig.driven(lines, 1, COMMAND_V * volts / 1180)
    sensitivity = np.abs(1 - _at_lines(motion.displacement * volts, lines) / _at_lines(command, lines))
    return Trial(outer_end_mass_kg, "", lines, compliance, float(sensitivity.max()), factor)


def at_rest(displacement: np.ndarray, floor_m: float) -> bool:
    """Whether what a record shows dies away.

    In its last third it has to swing less than in the one before, by 3 % at least, or by no more than twice the noise
    floor. Swings are RMS about a straight line, so that creep and drift are none.
    """
    third = len(displacement) // 3
    middle, last = (_swing(part) for part in (displacement[-2 * third : -third], displacement[-third:]))
    return bool(last <= max(_FADES * middle, _FLOORS * floor_m))


def _swing(part: np.ndarray) -> float:
    from scipy.signal import detrend

    return float(np.std(detrend(part)))


def _at_lines(wave: np.ndarray, lines: np.ndarray) -> np.ndarray:
    count = round(_LISTEN_S / SAMPLE_S)
    return np.asarray(np.fft.rfft(wave[-count:])[np.round(lines * _LISTEN_S).astype(int)])


class _Rig:
    """The rig with one controller and payload."""

    def __init__(self, case: Case, controller: dict[str, Any], inner: float, outer: float):
        idle = Drive("disturbance_N", "lines", 0.0, 1.0, 0)
        self._case = case
        self._figures = run_figures(case, Run("trial", idle, controller, outer, inner)) | {"hum": 0.0}
        self._step = step_of(self._figures)
        self._record, self._modes = assembled(self._figures)

    def _march(self, inputs: np.ndarray, factor: float = 1.0) -> Motion:
        record = self._record.copy()
        record["gain"] *= factor
        return march(record, self._modes, inputs, None, self._step)

    def _times(self, duration_s: float) -> np.ndarray:
        return np.arange(2 * round(duration_s / self._step) + 1) * (self._step / 2)

    def _kicked(self, factor: float) -> bool:
        times = self._times(WATCHED_S)
        inputs = np.zeros((len(times), 3))
        inputs[times < KICK_S, 0] = KICK_SHARE * self._case.scales.force
        motion = self._march(inputs, factor)
        return motion.bounded and at_rest(motion.outer, self._case.noise.floor_m)

    def restless(self) -> str:
        """After what it does not come to rest."""
        times = self._times(3 * WATCHED_S)
        inputs = np.zeros((len(times), 3))
        inputs[times < KICK_S, 0] = KICK_SHARE * self._case.scales.force
        on, off = (np.clip((times - k * WATCHED_S) / RISE_S, 0, 1) for k in (1, 2))
        inputs[:, 0] += self._case.scales.force * (np.cos(np.pi * off) - np.cos(np.pi * on)) / 2
        motion = self._march(inputs)
        if not motion.bounded:
            return "leaves its bounds"
        each = round(WATCHED_S / SAMPLE_S)
        found = [
            name
            for k, name in enumerate(("kick", "load on", "load off"))
            if not at_rest(motion.outer[k * each : (k + 1) * each], self._case.noise.floor_m)
        ]
        return f"does not come to rest after {', '.join(found)}" if found else ""

    def gain_factor(self) -> float:
        """See `Trial.gain_factor`."""
        low, high = GAIN_FACTORS
        calm, restless = (1.0, np.inf) if self._kicked(1.0) else (0.0, 1.0)
        while np.isinf(restless):
            if calm * _STEP > high:
                return float("inf")
            calm, restless = (calm * _STEP, restless) if self._kicked(calm * _STEP) else (calm, calm * _STEP)
        while calm == 0.0:
            if restless / _STEP < low:
                return 0.0
            calm, restless = (restless / _STEP, restless) if self._kicked(restless / _STEP) else (0.0, restless / _STEP)
        while restless > _NEAR * calm:
            middle = float(np.sqrt(calm * restless))
            calm, restless = (middle, restless) if self._kicked(middle) else (calm, middle)
        return float(np.sqrt(calm * restless))

    def driven(self, lines: np.ndarray, channel: int, rms: float) -> tuple[np.ndarray, Motion]:
        """Drive force (0) or command (1) with lines of equal height and random phase; the drive at the samples."""
        times = self._times(_SETTLE_S + _LISTEN_S - SAMPLE_S)
        phases = np.random.default_rng([self._case.seed, channel]).uniform(0, 2 * np.pi, len(lines))
        period = round(2 * _LISTEN_S / self._step)
        spectrum = np.zeros(period // 2 + 1, dtype=complex)
        spectrum[np.round(lines * _LISTEN_S).astype(int)] = np.exp(1j * phases)
        wave = np.fft.irfft(spectrum, period)
        wave *= rms / np.sqrt(np.mean(wave**2))
        inputs = np.zeros((len(times), 3))
        inputs[:, channel] = wave[np.arange(len(times)) % period]
        return inputs[:: round(2 * SAMPLE_S / self._step), channel], self._march(inputs)
