"""Experiments that can be done with a rig, within about what its records have already asked of it."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from beamdesign.controllers import Controller
from beamdesign.controllers.protocol import ANY_PAYLOAD
from beamdesign.gap.data.dataset import Dataset, TimeRecord
from beamdesign.gap.data.inputs import without_noise
from beamdesign.prototype import Prototype
from beamdesign.scenario import Input, LoadSteps, Multisine, Scenario, ScenarioRecord, Sine
from beamdesign.spelling import shorter

DURATION_S = 4.0
SAMPLE_S = 0.5e-3
_BANDS_HZ = ((1.0, 20.0), (1.0, 80.0), (30.0, 200.0))
_SHARES = (0.1, 1.0, 2.0)
"""Of the largest peak of an input recorded so far."""
_PAYLOADS = (0.5, 1.5)
"""Of the largest payload so far."""
_ANOTHER_PAYLOAD = 1.3  # effort
_NOISE = 0.5  # of a signal's rms: what is left without noise, where it is noise


@dataclass(frozen=True)
class Experiment:
    """Something that could be measured.

    Attributes:
        text: in words.
        signal: what drives the rig.
        controller: of the loop.
        outer_end_mass: payload, kg.
        inner_end_mass: kg.
        effort: against an experiment on the rig as it stands.
        settings: for a program.
    """

    text: str
    signal: Input
    controller: Controller
    outer_end_mass: float
    inner_end_mass: float
    effort: float = 1.0
    settings: dict[str, Any] = field(default_factory=dict, hash=False)


def scenario_of(experiment: Experiment, prototype: Prototype) -> Scenario:
    """A scenario that simulates, or prescribes, one experiment."""
    row = ScenarioRecord(
        name="next",
        input=(experiment.signal,),
        outer_end_mass_kg=experiment.outer_end_mass,
        inner_end_mass_kg=experiment.inner_end_mass,
        controller=experiment.controller,
    )
    name = f"{shorter(prototype.name)}: next experiment"
    return Scenario(name=name, duration_s=DURATION_S, sample_s=SAMPLE_S, start="rest", record=(row,))


def menu(data: Dataset) -> Iterator[Experiment]:
    """All experiments: each signal at each setting of controller and masses, and at payloads not yet measured."""
    settings = _settings(data)
    for record, outer, inner, effort in settings:
        for signal, words in _signals(data):
            payload = f"a payload of {outer:.3g} kg" if outer > 0 else "no payload"
            controller = record.controller
            text = f"{words}, {payload}, {controller.kind} controller of {controller.gain_A_per_V:.3g} A/V"
            table = signal.model_dump(mode="json", exclude_none=True) | {
                "outer_end_mass_kg": outer,
                "inner_end_mass_kg": inner,
            }
            yield Experiment(text, signal, controller, outer, inner, effort, table)


def _settings(data: Dataset) -> list[tuple[TimeRecord, float, float, float]]:
    """Record whose controller is used, payload, inner end mass, effort."""
    seen: dict[object, TimeRecord] = {}
    for r in data.records:
        seen.setdefault((r.controller, r.outer_end_mass, r.inner_end_mass), r)
    found = [(r, r.outer_end_mass, r.inner_end_mass, 1.0) for r in seen.values()]
    heaviest = max(data.records, key=lambda r: r.outer_end_mass)
    laws = () if data.prototype.controller is None else data.prototype.controller.laws
    ranges = [masses for law, masses in laws if law == heaviest.controller] or [ANY_PAYLOAD]
    if heaviest.outer_end_mass > 0:
        for share in _PAYLOADS:
            outer = round(share * heaviest.outer_end_mass, 2)
            if any(low <= outer <= high for low, high in ranges):
                found.append((heaviest, outer, heaviest.inner_end_mass, _ANOTHER_PAYLOAD))
    return found


def _signals(data: Dataset) -> Iterator[tuple[Input, str]]:
    for column, key, unit, words in ((1, "amplitude_V", "V", "command"), (0, "amplitude_N", "N", "force on the tip")):
        largest = max(_peak(r.inputs[:, column]) for r in data.records)
        if largest <= 0:
            continue
        for share in _SHARES:
            peak = float(f"{share * largest:.2g}")
            size: dict[str, Any] = {key: peak}
            for low, high in _BANDS_HZ:
                told = f"{words}: many lines from {low:g} to {high:g} Hz with a peak of {peak:g} {unit}"
                yield Multisine(low_Hz=low, high_Hz=high, **size), told
            yield Sine(frequency_Hz=0.5, fade_s=0.2, **size), f"{words}: slow sine, 0.5 Hz, {peak:g} {unit}"
            if column == 0:
                yield LoadSteps(rise_s=0.03, **size), f"{words}: load steps of {peak:g} {unit}, both ways"


def _peak(signal: np.ndarray) -> float:
    """Largest value of an input; 0 where it is the noise of its sensor."""
    if float(np.std(without_noise(signal))) <= _NOISE * float(np.std(signal)):
        return 0.0
    return float(np.abs(signal).max())
