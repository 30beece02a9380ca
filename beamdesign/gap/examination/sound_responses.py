"""Whether frequency responses and critical gains are in the units they should be in."""

from collections.abc import Sequence
from math import pi
from pathlib import Path

import numpy as np

from beamdesign.gap.data.dataset import FrequencyResponse, MeasuredGain
from beamdesign.gap.examination.believed_loop import believed_loop
from beamdesign.gap.examination.caution import Caution
from beamdesign.gap.examination.sound_records import HIGH_HZ, LOW_HZ
from beamdesign.loop import critical_gain
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem

_UNITS = {
    "mm/N": 1e3, "um/N": 1e6, "in/lbf": 4.4482216 / 0.0254, "mm/kN": 1e6, "m/kN": 1e3, "m/lbf": 4.4482216,
}  # fmt: skip
_FAR = np.log(3.0)
_NEAR = np.log(2.0)
_COARSE = np.log(12.0)
_FEWEST = 3
_GAIN_FAR = 10.0


def check_responses(responses: Sequence[FrequencyResponse], prototype: Prototype) -> None:
    """Refuse frequency responses that make sense only when read otherwise.

    Raises:
        InputError: of the first file that does, with column and reason.
    """
    for response in responses:
        problems = _problems(response, prototype)
        if problems:
            raise InputError(response.source or response.name, problems)


def _believed(response: FrequencyResponse, prototype: Prototype, frequencies: np.ndarray) -> np.ndarray | None:
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        loop = believed_loop(prototype, response.controller, response.outer_end_mass, response.inner_end_mass)
    return loop.responses(frequencies)[:, 1, 0] if loop.stable else None


def _problems(response: FrequencyResponse, prototype: Prototype) -> list[Problem]:
    frequencies = response.frequencies_Hz
    if len(frequencies) < _FEWEST:
        return [Problem("frequency_Hz", f"only {len(frequencies)} lines: measure at least {_FEWEST}")]
    inside = (frequencies >= LOW_HZ) & (frequencies <= HIGH_HZ)
    if inside.sum() < _FEWEST:
        return [Problem("frequency_Hz", f"fewer than {_FEWEST} lines between {LOW_HZ:g} and {HIGH_HZ:g} Hz")]
    believed = _believed(response, prototype, frequencies)
    slower = _believed(response, prototype, frequencies / (2 * pi))
    if believed is None or slower is None:
        return []
    measured = np.abs(response.response)
    level, shape = _level_and_shape(measured, believed)
    if abs(level) > _FAR:
        for unit, factor in _UNITS.items():
            if abs(level - np.log(factor)) < min(_NEAR, 0.3 * np.log(factor)) and shape < _NEAR:
                return [Problem("magnitude_m_per_N", f"values are in {unit}, by their scale: divide by {factor:g}")]
    problems = []
    slower_level, slower_shape = _level_and_shape(measured, slower)
    if max(shape, abs(level)) > 0.4 and max(slower_shape, abs(slower_level)) < 0.5 * max(shape, abs(level)):
        problems.append(Problem("frequency_Hz", "values are in rad/s, by the place of the resonances: divide by 2 pi"))
        believed = slower
    if response.has_phase and (reason := _phase(response, believed)):
        problems.append(Problem("phase_deg", reason))
    return problems


def _level_and_shape(measured: np.ndarray, believed: np.ndarray) -> tuple[float, float]:
    """Median logarithm of measured over believed, and the typical distance of the lines from it."""
    ratio = np.log(measured / np.abs(believed))
    level = float(np.median(ratio))
    return level, float(np.sqrt(np.mean((ratio - level) ** 2)))


def _phase(response: FrequencyResponse, believed: np.ndarray) -> str:
    """What is wrong with phases, if they make sense only when read otherwise."""
    phases = np.unwrap(np.angle(response.response))
    expected = np.unwrap(np.angle(believed))
    if np.ptp(expected) < 1.0:
        return ""
    as_written = _phase_error(phases, expected)
    if as_written < 0.5:
        return ""
    if _phase_error(np.rad2deg(np.angle(response.response)), expected) < 0.5 * as_written:
        return "values are in radians, by their scale: give degrees"
    if _phase_error(-phases, expected) < 0.4 * as_written:
        return "its sign is the other way round"
    return ""


def _phase_error(phases: np.ndarray, expected: np.ndarray) -> float:
    """Typical distance on the circle, rad."""
    return float(np.sqrt(np.mean(np.angle(np.exp(1j * (phases - expected))) ** 2)))


def check_gains(gains: Sequence[MeasuredGain], prototype: Prototype, folder: Path) -> list[Caution]:
    """Compare critical gains with those believed.

    Raises:
        InputError: where they are in another unit.
    """
    problems, warnings = [], []
    for k, gain in enumerate(gains, start=1):
        law = gain.controller.but(gain_A_per_V=gain.raised_from or gain.gain)
        rig = prototype.but(effects={}, controller=law)
        rig = rig.but(payload=rig.payload.but(inner_end_mass_kg=gain.inner_end_mass))
        try:
            believed = critical_gain(rig, gain.outer_end_mass, from_own=True).gain_A_per_V
        except (ArithmeticError, ValueError):
            continue
        ratio = gain.gain / believed
        if 0.2 < ratio / 1e3 < 3:
            words = f"entry {k}: {gain.gain:g} is {ratio:.0f} times what is believed: is it in mA/V? Divide by 1000"
            problems.append(Problem("critical_gain.gain_A_per_V", words))
        elif not 1 / _GAIN_FAR < ratio < _GAIN_FAR:
            text = (
                f"critical gain {k}, {gain.gain:g} A/V, is {ratio:.3g} times what is believed: check it and its masses"
            )
            warnings.append(Caution("critical_gain", "", text, limits_confidence=True))
    if problems:
        raise InputError(folder / "dataset.toml", problems)
    return warnings
