"""What can be measured next on a rig: each signal at each setting of controller and masses that its records had.

Signals stay within about what the records have already asked of it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import Any

import numpy as np

from beamdesign.controllers.protocol import ANY_PAYLOAD
from beamdesign.diagnosis.data.dataset import Dataset, TimeRecord
from beamdesign.diagnosis.data.dataset_index import OFF
from beamdesign.diagnosis.data.input_noise import denoised
from beamdesign.diagnosis.diagnosis import controller_text
from beamdesign.plant.assembly import pace
from beamdesign.scenario import Input, LoadSteps, Multisine, Scenario, ScenarioRecord, Sine
from beamdesign.spelling import shorter
from beamdesign.structure.lumped import figures

DURATION_S, SAMPLE_S, _SLOW_HZ = 4.0, 0.5e-3, 0.5
_BANDS_HZ = ((1.0, 20.0), (1.0, 80.0), (30.0, 200.0), (100.0, 400.0))
"""The last for what differs in the order of its phase only, such as a lag and a delay.

All of these are for a rig as quick as the published one; of a quicker or slower one frequencies are so much higher or
lower, and records so much shorter or longer.
"""
_SHARES = (0.1, 1.0, 2.0)
"""Of the largest peak of an input recorded so far."""
_PAYLOADS = (0.5, 1.5)
"""Of the largest payload so far."""
_ANOTHER_PAYLOAD = 1.3  # effort
_LOUDER = 1.3  # effort beyond the largest peak so far: a rig may do there what no record has shown, and no rival has
_NOISE = 0.5  # of a signal's rms: what is left without noise, where it is noise


def information(between: np.ndarray, weights: Sequence[float], causes: Sequence[object] = ()) -> float:
    """Least expected information about which causes it is, bits.

    That about which rival it is, less what of it is about which law of the same causes. Rivals are a mixture of
    Gaussians of one covariance: bounds from below are those of their Bhattacharyya distances d^2 / 8, from above those
    of Kullback and Leibler, d^2 / 2: A. Kolchinsky and B. D. Tracey, Entropy 19 (2017) 361, equation (10).

    Args:
        between: (R, R) separations in standard deviations.
        weights: (R,) probabilities, up to a factor.
        causes: (R,) of each rival; each of its own if none.
    """
    p = np.asarray(weights) / np.sum(weights)
    kinds = [*(causes or range(len(p)))]

    def bound(among: Sequence[int], per: float) -> float:
        own, apart = p[[*among]] / p[[*among]].sum(), between[np.ix_(among, among)]
        return float(-own @ np.log2(np.exp(-(apart**2) / per) @ own))

    laws = [[k for k, own in enumerate(kinds) if own == kind] for kind in dict.fromkeys(kinds)]
    return max(0.0, bound(range(len(p)), 8) - sum(float(p[own].sum()) * bound(own, 2) for own in laws))


@dataclass(frozen=True)
class Experiment:
    """Something that could be measured.

    Attributes:
        texts: each record in words.
        scenario: which simulates or prescribes them.
        effort: against an experiment on the rig as it stands.
        added: channel of an added sensor; empty for none.
        causes: of each of the rivals; those of several laws for the same ones are alike.
        between: (R, R) by how much it separates rivals, units of misfit (square root), the lesser of both cases; empty
            where that is not worked out.
    """

    texts: tuple[str, ...]
    scenario: Scenario
    effort: float = 1.0
    added: str = ""
    causes: tuple[tuple[str, ...], ...] = ()
    between: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)), repr=False)

    @property
    def text(self) -> str:
        """In words."""
        if len(self.texts) == 1:
            return self.texts[0]
        numbered = (f"({k}) {one}" for k, one in enumerate(self.texts, start=1))
        return f"{len(self.texts)} records of {self.scenario.duration_s:g} s: {'; '.join(numbered)}"

    @property
    def least(self) -> float:
        """Between the first rival and the one of other causes closest to it."""
        return float(min(self.between[0, k] for k, own in enumerate(self.causes) if own != self.causes[0]))

    @property
    def wide_apart(self) -> "Experiment":
        """As one that leaves nothing open."""
        return replace(self, between=np.where(np.eye(len(self.causes)), 0.0, inf))

    def bits(self, weights: Sequence[float]) -> float:
        """See `information`."""
        return information(self.between, weights, self.causes)

    def worth(self, weights: Sequence[float]) -> tuple[float, float]:
        """By which experiments are compared: information for the effort, then the least separation.

        Where several tell all but a hundredth of a bit, the one counts that leaves most room for what no rival is
        quite.
        """
        return round(self.bits(weights) / self.effort, 2), self.least / self.effort


def menu(data: Dataset) -> Iterator[Experiment]:
    """All records: each signal at each setting of controller and masses, and at payloads not yet measured."""
    name = f"{shorter(data.prototype.name)}: next experiment"
    stated, quick = data.prototype.outer_end_mass_kg or ANY_PAYLOAD, pace(figures(data.prototype))
    for record, outer, inner, effort in _settings(data):
        law, payload = record.controller, f"a payload of {outer:.3g} kg" if outer > 0 else "no payload"
        beyond = f" (more than the {stated[1]:g} kg that the prototype is stated for)" if outer > stated[1] else ""
        for signal, words, louder in _signals(data, quick, commanded=law != OFF):
            acting = f"servo off, {inner:.3g} kg inside" if law == OFF else controller_text(law, inner)
            text = f"{words}, {payload}{beyond}, {acting}"
            row = ScenarioRecord(
                name="next", input=(signal,), outer_end_mass_kg=outer, inner_end_mass_kg=inner, controller=law
            )
            length, step = DURATION_S / quick, SAMPLE_S / quick
            plan = Scenario(name=name, duration_s=length, sample_s=step, start="rest", record=(row,))
            yield Experiment((text,), plan, effort * louder)


def _settings(data: Dataset) -> list[tuple[TimeRecord, float, float, float]]:
    """Record whose controller is used, payload, inner end mass, effort."""
    seen: dict[object, TimeRecord] = {}
    for r in data.records:
        seen.setdefault((r.controller, r.masses), r)
    found = [(r, *r.masses, 1.0) for r in seen.values()]
    heaviest = max(data.records, key=lambda r: r.outer_end_mass)
    laws = () if data.prototype.controller is None else data.prototype.controller.laws
    ranges = [masses for law, masses in laws if law == heaviest.controller] or [ANY_PAYLOAD]
    if heaviest.outer_end_mass > 0:
        for share in _PAYLOADS:
            outer = round(share * heaviest.outer_end_mass, 2)
            if any(low <= outer <= high for low, high in ranges):
                found.append((heaviest, outer, heaviest.inner_end_mass, _ANOTHER_PAYLOAD))
    return found


def _signals(data: Dataset, quick: float, commanded: bool) -> Iterator[tuple[Input, str, float]]:
    channels = ((1, "amplitude_V", "V", "command"), (0, "amplitude_N", "N", "force on the tip"))
    for column, key, unit, words in channels[0 if commanded else 1 :]:
        largest = max(_peak(r, column) for r in data.records)
        if largest <= 0:
            continue
        for share in _SHARES:
            peak = float(f"{share * largest:.2g}")
            size: dict[str, Any] = {key: peak}
            effort = _LOUDER if share > 1 else 1.0
            for low, high in _BANDS_HZ:
                tones = _at_pace(Multisine(low_Hz=low, high_Hz=high, **size), quick)
                text = f"{words}: many lines from {quick * low:g} to {quick * high:g} Hz with a peak of {peak:g} {unit}"
                yield tones, text, effort
            sine = _at_pace(Sine(frequency_Hz=_SLOW_HZ, fade_s=0.2, **size), quick)
            yield sine, f"{words}: slow sine, {quick * _SLOW_HZ:g} Hz, {peak:g} {unit}", effort
            if column == 0:
                steps = _at_pace(LoadSteps(rise_s=0.03, **size), quick)
                yield steps, f"{words}: load steps of {peak:g} {unit}, both ways", effort


def _at_pace(signal: Input, pace: float) -> Input:
    """The same so many times as quick."""
    given = signal.model_dump(exclude_none=True)
    quicker = {name: value * pace for name, value in given.items() if name.endswith("_Hz")}
    return signal.but(**quicker, **{name: value / pace for name, value in given.items() if name.endswith("_s")})


def _peak(record: TimeRecord, column: int) -> float:
    """Largest value of an input; 0 where it is the noise of its sensor."""
    signal = record.inputs[:, column]
    still = denoised(signal)[0] if column else record.denoised[0]
    return float(np.abs(signal).max()) if np.std(still) > _NOISE * np.std(signal) else 0.0
