"""Named warnings about data: of a record that does not obey its controller, and of tolerances that are not stated.

Without tolerances every figure would be vouched for to the last digit; a prototype that states none is given some.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from beamdesign.controllers import Controller
from beamdesign.diagnosis.data.dataset import TimeRecord
from beamdesign.diagnosis.examination.nominal import ControllerFit, Rival, demanded, refitted, rivals
from beamdesign.parameters import PARAMETERS
from beamdesign.prototype import Prototype, Tolerance


@dataclass(frozen=True)
class Caution:
    """Something about a data set that whoever reads a verdict on it should know.

    Attributes:
        name: short, for programs: `clipped`, `no_content`, `controller`, ...
        record: name of the record, empty for the set as a whole.
        text: in words, with what to do.
        left_out: whether the record was left out.
        limits_confidence: whether a verdict must not be a confident one.
    """

    name: str
    record: str
    text: str
    left_out: bool = False
    limits_confidence: bool = False

    def __str__(self) -> str:
        out = "; the record was left out" if self.left_out else ""
        return f"{self.record}: {self.text}{out}" if self.record else f"{self.text}{out}"


TYPICAL = Tolerance(**{row.tolerance: row.typical for row in PARAMETERS.values()})
"""Standard deviations of figures taken from drawings and data sheets: what an engineer would grant before a look."""


def with_tolerances(prototype: Prototype) -> tuple[Prototype, tuple[Caution, ...]]:
    """The prototype as it is where it states a tolerance of any figure, else with typical ones and a word on it."""
    stated = prototype.tolerance.model_dump()
    if any(value for key, value in stated.items() if not key.endswith("_end_mass")):
        return prototype, ()
    taken = ", ".join(f"{key} {value:.2g}" for key, value in TYPICAL.model_dump().items() if value)
    text = (
        f"the prototype states no [tolerance] for any figure; typical ones are taken ({taken}): better state your own"
    )
    return prototype.but(tolerance=TYPICAL), (Caution("tolerances", "", text),)


DISOBEDIENT = 0.05
"""Relative residual of the controller's equation from which something must be said."""
_NOISY = 0.4
"""The same as a share of the noise, which is known only so well."""
_GRAVE = 0.1
_HOPELESS = 0.5
_EXPLAINED = 0.25  # of the residual may remain
_SAME_GAIN = 0.02
_OFFSET = 0.2
_MOST = 0.6


def contradictions(
    records: Sequence[TimeRecord], fits: Mapping[str, ControllerFit], prototype: Prototype
) -> list[Caution]:
    """Say of every record that does not obey its controller what it obeys instead.

    Args:
        records: usable ones.
        fits: of each, by name.
        prototype: believed.
    """
    gains = [fits[r.name].gain for r in records]
    common = max(gains, default=1.0) - min(gains, default=1.0) < _SAME_GAIN * max(map(abs, gains), default=1.0)
    found = []
    for record in records:
        fit = fits[record.name]
        if fit.residual > max(DISOBEDIENT, _NOISY * fit.noise):
            found.append(_verdict(record, fit, _others(record, records, prototype), prototype, common))
        elif abs(fit.offset_A) > _OFFSET * float(np.std(record.measured["current_A"])):
            text = (
                f"a constant {fit.offset_A:.3g} A of the current is none of the controller's doing: check for an offset"
            )
            found.append(Caution("offset", record.name, text, limits_confidence=True))
    return found


def lost_by_recorder(caution: Caution, fits: Mapping[str, ControllerFit]) -> Caution:
    """Say of lost samples who lost them: the sensor, so that the controller did not see them either, or the recorder.

    Args:
        caution: any; others than `stuck` come back as they are.
        fits: by name of the record.
    """
    fit = fits.get(caution.record)
    if caution.name != "stuck" or fit is None:
        return caution
    if fit.explained > max(DISOBEDIENT, _NOISY * fit.noise):
        return replace(caution, text=f"{caution.text} by the recorder, for the current went on", left_out=True)
    return replace(caution, text=f"{caution.text} by the sensor, for the current followed them: repair it")


def _others(record: TimeRecord, records: Sequence[TimeRecord], prototype: Prototype) -> dict[Controller, str]:
    found: dict[Controller, str] = {}
    for other in records:
        if other.controller != record.controller:
            found.setdefault(other.controller, f"that of record {other.name}")
    for law, _ in () if prototype.controller is None else prototype.controller.laws:
        if law != record.controller:
            found.setdefault(law, "that of the prototype")
    return found


def _verdict(
    record: TimeRecord, fit: ControllerFit, others: Mapping[Controller, str], prototype: Prototype, common: bool
) -> Caution:
    enough = _EXPLAINED * fit.residual
    gain = prototype.sensor.gain_V_per_m
    known = rivals(record, gain, ((words, controller) for controller, words in others.items()))
    if known and known[0].residual < min(enough, DISOBEDIENT, fit.with_limit):
        return _contradicts(record, fit, known[0])
    if fit.limit_A is not None:
        text = f"the current saturates at {fit.limit_A:.3g} A"
        return Caution("saturated_current", record.name, text)
    if fit.with_gain < enough:
        words = f"the current is {fit.gain:.3g} times what the stated controller gives"
        if common:
            text = (
                f"{words}, as in all records: check gain_A_per_V, sensor.gain_V_per_m, the unit of current_A and the "
                "amplifier"
            )
            return Caution("amplifier_gain", record.name, text, limits_confidence=True)
        text = f"contradicts its controller: {words}; correct its gain_A_per_V"
        return Caution("controller", record.name, text, left_out=True, limits_confidence=True)
    other = refitted(record, gain)
    late = min(fit.with_delay, fit.with_lag)
    if other.residual < min(enough, 0.5 * late):
        return _contradicts(record, fit, other)
    if late < 0.5 * fit.residual:
        return _late(record, fit)
    text = (
        f"{fit.residual:.0%} of the current's rms is not what the stated controller makes of command and displacement"
    )
    if fit.residual > _HOPELESS:
        text = f"contradicts its controller: {text} (do the columns belong to one run?)"
        return Caution("controller", record.name, text, left_out=True, limits_confidence=True)
    line = _line(record, gain)
    text += (
        f", most of that at {line:.3g} Hz: hum" if line else ": something between sensor and valve is not in the model"
    )
    return Caution("controller_mismatch", record.name, text, limits_confidence=fit.residual > _GRAVE)


def _line(record: TimeRecord, sensor_gain: float) -> float | None:
    """Frequency (Hz) that carries most of what the equation leaves, if one does."""
    if (asked := demanded(record, record.controller, sensor_gain)) is None:
        return None
    left = record.measured["current_A"] - asked
    power = np.abs(np.fft.rfft((left - left.mean()) * np.hanning(len(left)))) ** 2
    peak = int(np.argmax(power))
    if power[max(peak - 2, 0) : peak + 3].sum() < _MOST * power.sum():
        return None
    return float(np.fft.rfftfreq(len(left), record.step)[peak])


def _late(record: TimeRecord, fit: ControllerFit) -> Caution:
    if fit.with_delay <= fit.with_lag and fit.delay_s < 0:
        text = f"current_A is {-1e3 * fit.delay_s:.3g} ms ahead of displacement_m: the channels are shifted in time"
        return Caution("shifted_channels", record.name, text, left_out=True, limits_confidence=True)
    dead = fit.with_delay < 0.7 * fit.with_lag
    words = f"by {1e3 * fit.delay_s:.3g} ms" if dead else f"with a time constant of {1e3 * fit.lag_s:.3g} ms"
    text = f"the current follows the controller late, {words}: an amplifier or coil that lags, or shifted channels"
    return Caution("amplifier_lag", record.name, text, limits_confidence=fit.residual > _GRAVE)


def _contradicts(record: TimeRecord, fit: ControllerFit, rival: Rival) -> Caution:
    text = (
        f"contradicts its controller ({described(record.controller)}), which misses the current by {fit.residual:.0%} "
        f"of its rms; {rival.words} ({described(rival.controller)}) misses it by {rival.residual:.1%}: "
        "correct dataset.toml"
    )
    return Caution("controller", record.name, text, left_out=True, limits_confidence=True)


def described(controller: Controller) -> str:
    """A controller in words."""
    return f"{controller.words()}, {controller.gain_A_per_V:.3g} A/V"
