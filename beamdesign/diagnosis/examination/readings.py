"""Other ways to read a record: a column in another unit, sign or place, another controller or amplifier than stated.

A record is held against two things. Its controller's equation, which no effect of the rig can bend but saturation;
and the believed loop, from which a real rig departs, but hardly by a factor of three. A record that does not fit both
as it stands, and does once one column is read otherwise, is one whose column was written otherwise.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from math import inf, log, sqrt
from typing import Any, NamedTuple

import numpy as np

from beamdesign.controllers import Controller
from beamdesign.diagnosis.data.dataset import INPUTS, MEASURED, TimeRecord
from beamdesign.diagnosis.data.measured_files import UNITS
from beamdesign.diagnosis.examination import nominal
from beamdesign.diagnosis.examination.nominal import ControllerFit
from beamdesign.diagnosis.examination.off_zero import off_zero
from beamdesign.diagnosis.examination.sound_records import Caution, rms
from beamdesign.prototype import Prototype
from beamdesign.quantities import LawGain, range_of

COLUMNS = (*INPUTS, *MEASURED)
_WRITTEN = {
    "disturbance_N": "kN lbf kgf",
    "command_V": "mV",
    "current_A": "mA uA",
    "displacement_m": "mm um cm inches mil",
    "load_pressure_Pa": "bar MPa kPa psi",
    "screw_force_N": "kN lbf kgf",
    "inner_displacement_m": "mm um inches",
}
_SPELT_OUT = {"mil": "thousandths of an inch"}
_UNITS = {
    column: {_SPELT_OUT.get(unit, unit): 1 / UNITS[column.rpartition("_")[2]][unit] for unit in units.split()}
    for column, units in _WRITTEN.items()
}
"""By column: how large one SI unit is when written in another."""
_TIMES = {"ms": 1e3, "us": 1e6}
_SENSOR_GAINS = {"V/mm": 1e-3, "V/cm": 1e-2, "V/inch": 0.0254}
_FAR, _UNLIKE = log(3.0), 0.3  # beyond which a record is not taken as it stands
_NEAR, _ALIKE = log(2.0), 0.6  # within which another reading is believed
_NEAR_EQUATION, _ALIKE_EQUATION = log(1.12), 0.9
_ALIKE_BENT = 0.8  # with a current that saturates
_COARSE = 12.0  # a factor that is believed though the current saturates
_SURE = 0.2  # fault of a reading that leaves next to nothing to explain
_FAR_MORE = log(8.0)
_FEWEST = 16


@dataclass(frozen=True)
class View:
    """A record as read, with the model it is held against."""

    record: TimeRecord
    prototype: Prototype

    def column(self, name: str) -> np.ndarray:
        """(N,) one of `COLUMNS`."""
        if name in INPUTS:
            return self.record.inputs[:, INPUTS.index(name)]
        return self.record.measured[name]

    @property
    def columns(self) -> list[str]:
        """Those of `COLUMNS` that there are."""
        return [name for name in COLUMNS if name in (*INPUTS, *self.record.measured)]

    @property
    def driven(self) -> list[str]:
        """Columns that hold more than one value."""
        return [name for name in self.columns if np.ptp(self.column(name)) > 0]

    def of(self, **changes: Any) -> "View":
        """The same with other fields of the record."""
        return replace(self, record=replace(self.record, **changes))

    def having(self, **columns: np.ndarray) -> "View":
        """The same with some columns replaced."""
        inputs = np.column_stack([columns.get(name, self.column(name)) for name in INPUTS])
        others = {name: values for name, values in columns.items() if name not in INPUTS}
        return self.of(inputs=inputs, measured={**self.record.measured, **others})


@dataclass(frozen=True)
class Reading:
    """One way to read a record.

    Attributes:
        key: column of the record, or key of dataset.toml or prototype.toml.
        words: what it would be, and what to do.
        factor: by which values are too large; 1 where that is not what is wrong.
        fault: how far it still is from equation and loop; 0 where it fits both.
    """

    key: str
    words: str
    factor: float = 1.0
    fault: float = 0.0

    @property
    def sure(self) -> bool:
        """Whether it may be believed of one record against all others."""
        return self.coarse or self.fault < _SURE

    @property
    def coarse(self) -> bool:
        """Whether nothing that a rig does could pass for it."""
        return self.factor == 1.0 or not 1 / _COARSE < abs(self.factor) < _COARSE


class _Likeness(NamedTuple):
    """Logarithm of measured over predicted rms, and their correlation."""

    scale: float
    correlation: float

    def within(self, scale: float, correlation: float) -> bool:
        return abs(self.scale) <= scale and self.correlation >= correlation

    @property
    def fault(self) -> float:
        return abs(self.scale) + 1 - self.correlation


def _likeness(measured: np.ndarray, predicted: np.ndarray) -> _Likeness:
    a, b = measured - measured.mean(), predicted - predicted.mean()
    size_a, size_b = rms(a), rms(b)
    if not (size_a > 0 and size_b > 0 and np.isfinite(size_b)):
        return _Likeness(np.inf, 0.0)
    return _Likeness(log(size_a / size_b), float(np.mean(a * b)) / (size_a * size_b))


def _equation(view: View) -> _Likeness:
    asked = nominal.commanded_current(view.record, view.record.controller, view.prototype.sensor.gain_V_per_m)
    # Where the equation cannot be held against the record, nothing speaks against either.
    return _Likeness(0.0, 1.0) if asked is None else _likeness(view.record.measured["current_A"], asked)


def _loop(view: View) -> tuple[_Likeness, ...] | None:
    if (shares := nominal.expected(view.record, view.prototype)) is None:
        return None
    seen = ((name, view.record.measured[name]) for name in reversed(MEASURED) if name in view.record.measured)
    return tuple(_likeness(values, shares[name].sum(axis=1)) for name, values in seen)


def as_it_stands(record: TimeRecord, prototype: Prototype) -> bool:
    """Whether a record may be taken as it stands: it roughly obeys its controller, and roughly does as believed."""
    view = View(record, prototype)
    return all(part.within(_FAR, _UNLIKE) for part in (_equation(view), *(_loop(view) or ())))


def other_units(record: TimeRecord, prototype: Prototype) -> tuple[Reading, ...]:
    """Units in which the further columns of a record are, where not in their own, and signs that are not theirs."""
    more = [name for name in _UNITS if name not in COLUMNS and name in record.measured]
    shares = nominal.expected(record, prototype) if more else None
    found: list[Reading] = []
    if shares is None:
        return ()
    for name in more:
        scale, alike = _likeness(record.measured[name], shares[name].sum(axis=1))
        if abs(scale) < _FAR and alike < -_ALIKE:
            found.append(Reading(name, "its sign is the other way round"))
        if not _FAR_MORE < abs(scale) < np.inf:
            continue
        unit, factor = min(_UNITS[name].items(), key=lambda item: abs(scale - log(item[1])))
        if abs(scale - log(factor)) < _FAR:
            found.append(_in_unit(name, unit, factor))
    return tuple(found)


def other_readings(record: TimeRecord, prototype: Prototype) -> tuple[Reading, ...]:
    """Ways to read a record under which it fits its controller and the believed loop; best first, none if none does."""
    if len(record.times) < _FEWEST:
        return ()
    view = View(record, prototype)
    compared = _loop(view) is not None
    for candidates, bent in ((_single, False), (_single, True), (_double, False)):
        tried = ((one, _fault(changed, bent, compared)) for one, changed in candidates(view) if one.coarse or not bent)
        found = sorted((replace(one, fault=fault) for one, fault in tried if fault is not None), key=lambda r: r.fault)
        if found:
            return tuple(r for r in found if r.fault < found[0].fault + 0.05)
    return ()


def _fault(view: View, bent: bool, compared: bool) -> float | None:
    """How far a view is from equation and loop; None where it is too far to be believed.

    Args:
        view: read in one way.
        bent: whether the current may saturate and the gap be a large one.
        compared: whether the record as it stands has a believed loop to be compared with; then a reading under which
            that loop is unstable explains nothing.
    """
    equation = _equation(view)
    if not equation.within(*((_NEAR, _ALIKE_BENT) if bent else (_NEAR_EQUATION, _ALIKE_EQUATION))):
        return None
    if (loop := _loop(view)) is None:
        return None if compared else equation.fault + 1
    if not all(part.within(*((_FAR, _UNLIKE) if bent else (_NEAR, _ALIKE))) for part in loop):
        return None
    return equation.fault + 0.2 * sum(part.fault for part in loop)


_Candidate = tuple[Reading, View]


def _scaled(view: View, factors: dict[str, float]) -> View:
    return view.having(**{name: view.column(name) / factor for name, factor in factors.items()})


def _factor_words(factor: float) -> str:
    return f"divide by {factor:g}" if factor >= 1 else f"multiply by {1 / factor:.6g}"


def _in_unit(name: str, unit: str, factor: float) -> Reading:
    return Reading(name, f"values are in {unit}, by their scale: {_factor_words(factor)}", factor)


def _single(view: View) -> Iterator[_Candidate]:
    driven = view.driven
    for name in driven:
        for unit, factor in _UNITS[name].items():
            yield _in_unit(name, unit, factor), _scaled(view, {name: factor})
        yield Reading(name, "its sign is the other way round"), _scaled(view, {name: -1.0})
    words = "values are the sensor's volts, by their scale: divide by sensor.gain_V_per_m"
    yield Reading("displacement_m", words), _scaled(view, {"displacement_m": view.prototype.sensor.gain_V_per_m})
    for a, b in combinations(view.columns, 2):
        if a in driven or b in driven:
            swapped = {a: view.column(b), b: view.column(a)}
            yield Reading(a, f"it and {b} stand in each other's place"), view.having(**swapped)
    yield from _of_settings(view)


def _of_settings(view: View) -> Iterator[_Candidate]:
    """Times, and figures outside the columns."""
    record, prototype = view.record, view.prototype
    for unit, factor in _TIMES.items():
        words = f"times are in {unit}, by the speed of the motion: {_factor_words(factor)}"
        yield Reading("t_s", words), view.of(times=record.times / factor)
    if (gain := record.controller.gain_A_per_V / 1e3) in range_of(LawGain):
        words = "the gain is in mA/V, by its scale: divide by 1000"
        law = record.controller.but(gain_A_per_V=gain)
        yield Reading("controller.gain_A_per_V", words), view.of(controller=law)
    for unit, factor in _SENSOR_GAINS.items():
        sensor = prototype.sensor.but(gain_V_per_m=prototype.sensor.gain_V_per_m / factor)
        reading = Reading("sensor.gain_V_per_m", f"the prototype's gain is in {unit}, by its scale")
        yield reading, replace(view, prototype=prototype.but(sensor=sensor))
    if max(record.masses) > 100:
        masses = {"outer_end_mass": record.outer_end_mass / 1e3, "inner_end_mass": record.inner_end_mass / 1e3}
        reading = Reading("outer_end_mass_kg, inner_end_mass_kg", "the masses are in grams, by their scale")
        yield reading, view.of(**masses)


def _double(view: View) -> Iterator[_Candidate]:
    """Two columns at once, in units that go together."""
    for a, b in combinations(view.driven, 2):
        for (unit_a, factor_a), (unit_b, factor_b) in product(_UNITS[a].items(), _UNITS[b].items()):
            units = f"values are in {unit_a} and {unit_b}, by their scale"
            words = f"{units}: {_factor_words(factor_a)} and {_factor_words(factor_b)}"
            yield Reading(f"{a}, {b}", words), _scaled(view, {a: factor_a, b: factor_b})
        yield Reading(f"{a}, {b}", "both signs are the other way round"), _scaled(view, {a: -1.0, b: -1.0})


DISOBEDIENT = 0.05
"""Relative residual of the controller's equation from which something must be said."""
_GRAVE = 0.1
_HOPELESS = 0.5
_EXPLAINED = 0.25  # of the residual may remain
_SHORTEST = 0.05
"""Of a sample: channels are shifted by more, if at all."""
_SAME_GAIN = 0.02
_ODD_ONE = 3  # records: two whose gains differ do not say which is wrong
_PERIODS = 2.5  # in a record: with fewer what it holds is no tone
_LARGE_OFFSET = 0.2  # of a channel's deviation: more may be an amplifier's


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
    usual = float(np.median(gains)) if len(gains) >= _ODD_ONE else np.nan
    found = []
    for record in records:
        fit = fits[record.name]
        # No more than another gain, which one record has and the others have not, is told of less.
        odd = abs(fit.gain - usual) > _SAME_GAIN * abs(usual) and fit.with_gain < _EXPLAINED * fit.residual
        if _plain(fit.residual, fit) or (odd and fit.residual > fit.doubt):
            found.append(_verdict(record, fit, records, prototype, common))
        elif off := off_zero(record, fit, prototype.sensor.gain_V_per_m):
            ((name, by),) = off.items()
            text = f"a constant {fit.offset_A:.3g} A of the current is none of the controller's doing"
            text += (
                f": {name} begins {by:.3g} {name[-1]} off its zero, which is taken off; check what measures it"
                * bool(by)
            )
            text += ": check for an offset" * (not by)
            limits = not 0 < abs(by) <= _LARGE_OFFSET * float(np.std(record.measured[name]))
            found.append(Caution("offset", record.name, text, limits_confidence=limits))
    return found


def _plain(residual: float, fit: ControllerFit) -> bool:
    return residual > max(DISOBEDIENT, fit.doubt)


def lost_by_recorder(caution: Caution, fits: Mapping[str, ControllerFit]) -> Caution:
    """Say of lost samples who lost them: the sensor, so that the controller did not see them either, or the recorder.

    Args:
        caution: any; others than `stuck` come back as they are.
        fits: by name of the record.
    """
    fit = fits.get(caution.record)
    if caution.name != "stuck" or fit is None:
        return caution
    if _plain(min(fit.residual, fit.with_gain, fit.with_delay, fit.with_lag, fit.with_limit), fit):
        return replace(caution, text=f"{caution.text} by the recorder, for the current went on", left_out=True)
    return replace(caution, text=f"{caution.text} by the sensor, for the current followed them: repair it")


def _verdict(
    record: TimeRecord, fit: ControllerFit, records: Sequence[TimeRecord], prototype: Prototype, common: bool
) -> Caution:
    enough, gain = _EXPLAINED * fit.residual, prototype.sensor.gain_V_per_m

    def contradicts(words: str) -> Caution:
        return Caution("controller", record.name, f"contradicts its controller{words}", True, True)

    def obeys(other: Controller, words: str, residual: float) -> Caution:
        return contradicts(
            f" ({nominal.described(record.controller)}), which misses the current by {fit.residual:.0%} of its rms;"
            f" {words} ({nominal.described(other)}) misses it by {residual:.1%}: correct dataset.toml"
        )

    laws = () if prototype.controller is None else prototype.controller.laws
    others = {law: "that of the prototype" for law, _ in laws}
    others |= {other.controller: f"that of record {other.name}" for other in reversed(records)}
    left = {law: nominal.missed_by(record, law, gain) for law in others if law != record.controller}
    nearest = min(left, key=lambda law: left[law], default=record.controller)
    if left.get(nearest, inf) < min(enough, DISOBEDIENT, fit.with_limit):
        return obeys(nearest, others[nearest], left[nearest])
    if fit.limit_A is not None:
        return Caution("saturated_current", record.name, f"the current saturates at {fit.limit_A:.3g} A")
    if fit.with_gain < enough:
        words = f"the current is {fit.gain:.3g} times what the stated controller gives"
        if not common:
            return contradicts(f": {words}; correct its gain_A_per_V")
        words += ", as in all records: check gain_A_per_V, sensor.gain_V_per_m, the unit of current_A and the amplifier"
        return Caution("amplifier_gain", record.name, words, limits_confidence=True)
    times = (fit.with_delay, fit.delay_s), (fit.with_lag, fit.lag_s)
    late = min((left for left, time in times if abs(time) > _SHORTEST * record.step), default=inf)
    best = nominal.refitted(record, gain)
    if (best_left := nominal.missed_by(record, best, gain)) < min(enough, 0.5 * late):
        return obeys(best, "the one that fits best", best_left)
    if late < 0.5 * fit.residual:
        return _late(record, fit)
    made = "what the stated controller makes of command and displacement"
    text = f"{fit.residual:.0%} of the current's rms is not {made}"
    if fit.residual > _HOPELESS:
        return contradicts(f": {text} (do the columns belong to one run?)")
    text += ": something between sensor and valve is not in the model"
    lines, besides = nominal.lines_left(record, gain)
    grave = fit.residual
    if lines:
        what = f"at {' and '.join(f'{line:.3g}' for line in lines)} Hz: hum"
        if slow := lines[0] * float(np.ptp(record.times)) < _PERIODS:
            what = "slower than the record is long: a channel drifts, or its gain is off"
        text = f"{fit.residual:.0%} of the current's rms is not {made}, most of that {what}"
        if not slow:  # hum of the displacement's recorder is taken off before anything is weighed
            grave *= sqrt(besides)
    return Caution("controller_mismatch", record.name, text, limits_confidence=grave > _GRAVE)


def _late(record: TimeRecord, fit: ControllerFit) -> Caution:
    if fit.with_delay <= fit.with_lag and fit.delay_s < 0:
        text = f"current_A is {-1e3 * fit.delay_s:.3g} ms ahead of displacement_m: the channels are shifted in time"
        return Caution("shifted_channels", record.name, text, left_out=True, limits_confidence=True)
    dead = fit.with_delay < 0.7 * fit.with_lag
    words = f"by {1e3 * fit.delay_s:.3g} ms" if dead else f"with a time constant of {1e3 * fit.lag_s:.3g} ms"
    text = f"the current follows the controller late, {words}: an amplifier or coil that lags, or shifted channels"
    return Caution("amplifier_lag", record.name, text, limits_confidence=fit.residual > _GRAVE)
