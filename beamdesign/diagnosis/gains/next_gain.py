"""Which further critical gain or frequency response would tell rival explanations apart, and how well."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import exp, log, sqrt, tau

import numpy as np

from beamdesign.controllers import Controller
from beamdesign.diagnosis.data.dataset import Dataset, FrequencyResponse, MeasuredGain
from beamdesign.diagnosis.diagnosis import NextExperiment
from beamdesign.diagnosis.experiment import distance
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.gain_evidence import FREQUENCY_STD, GainEvidence
from beamdesign.diagnosis.fitting.linear_evidence import ResponseEvidence
from beamdesign.diagnosis.gains.search import Figure

_LOAD_SHARE = 0.3  # of what the piston can hold at the supply
_LINES = np.geomspace(1.0, 300.0, 30)
_ENOUGH = 5.0  # a separation beyond which more is no better
_OPEN_LOOP_MARGIN = 0.5
_RIVALS = 8


@dataclass(frozen=True)
class Experiment:
    """Something that could be measured.

    Attributes:
        text: in words.
        settings: for a program.
        pieces: as evidence, with figures that one of the rivals predicts.
        effort: by which the separation is divided when experiments are compared: number of set-ups.
    """

    text: str
    settings: dict[str, object]
    pieces: tuple[Figure, ...]
    effort: float = 1.0


def next_experiment(data: Dataset, rivals: Sequence[Fit], weights: Sequence[float]) -> NextExperiment | None:
    """The experiment that separates rivals best for its effort.

    The separation of two rivals is the distance between what they predict, in standard deviations of the measurement's
    noise and of both predictions together; that of an experiment is its mean square over pairs, weighed by the
    probabilities of both.

    Args:
        data: measured so far.
        rivals: fits, most probable first; no more than eight count.
        weights: their probabilities.

    Returns:
        None where there are no two rivals, or none of the experiments can be predicted.
    """
    rivals, weights = list(rivals)[:_RIVALS], list(weights)[:_RIVALS]
    if len(rivals) < 2:
        return None
    best: tuple[float, float, Experiment, tuple[str, ...]] | None = None
    for experiment in experiments(data, rivals[0]):
        distances = separations(experiment.pieces, rivals)
        if distances is None:
            continue
        pairs = [(i, j) for i in range(len(rivals)) for j in range(i)]
        total = sum(weights[i] * weights[j] for i, j in pairs)
        square = sum(weights[i] * weights[j] * min(distances[i, j], _ENOUGH) ** 2 for i, j in pairs) / total
        score = sqrt(square / experiment.effort)
        if best is None or score > best[0]:
            apart = {k for i, j in pairs if distances[i, j] >= 1.0 for k in (i, j)}
            names = tuple(str(rivals[k].hypothesis) for k in sorted(apart))
            best = (score, sqrt(square), experiment, names)
    if best is None:
        return None
    _, separation, experiment, names = best
    return NextExperiment(experiment.text, names, separation, experiment.settings)


def another_size(data: Dataset) -> NextExperiment:
    """Where no explanation is at hand: whether it depends on the size of the motion, which such data do not say."""
    forces = sorted({r.amplitude_N for r in data.responses})
    sizes = f"at {forces[0] / 4:.3g} and at {forces[0]:.3g} N" if forces else "at two forces a factor of four apart"
    return NextExperiment(
        f"Record the displacement and the current in time under a multisine force from 1 to 300 Hz {sizes}: a linear"
        " cause shows the same response in both, a deadband, friction or play does not.",
        (),
        0.0,
        {"kind": "record", "input": "multisine", "band_Hz": [1.0, 300.0], "amplitudes": 2},
    )


def separations(pieces: Sequence[Figure], rivals: Sequence[Fit]) -> np.ndarray | None:
    """(R, R) distances between what rivals predict of some evidence, in standard deviations; None where one cannot."""
    predicted = []
    for rival in rivals:
        placement = rival.hypothesis.placement(pieces[0].prototype)
        rows = [piece.linearised(placement, rival.z) for piece in pieces]
        if any(row is None for row in rows):
            return None
        r = np.concatenate([row[0] for row in rows if row is not None])
        j = np.vstack([row[1] for row in rows if row is not None])
        predicted.append((r, j @ np.linalg.cholesky(rival.covariance)))
    found = np.zeros((len(rivals), len(rivals)))
    for (i, (a, free_a)), (k, (b, free_b)) in combinations(enumerate(predicted), 2):
        found[i, k] = found[k, i] = distance(a - b, np.hstack([free_a, free_b]))
    return found


def experiments(data: Dataset, assumed: Fit) -> Iterator[Experiment]:
    """What could be measured next on a rig of which gains or responses are known, with figures of an assumed answer."""
    placement = assumed.hypothesis.placement(data.prototype)

    def taken(gain: MeasuredGain, load: float = 0.0) -> GainEvidence | None:
        piece = GainEvidence(gain, data.prototype, load)
        at = piece.predicted(placement, assumed.z)
        if at is None:
            return None
        law = gain.controller.but(gain_A_per_V=at.gain)
        return replace(piece, measured=replace(gain, controller=law, frequency_Hz=at.frequency / tau))

    def gains(text: str, settings: dict[str, object], some: Sequence[GainEvidence | None]) -> Iterator[Experiment]:
        pieces = tuple(piece for piece in some if piece is not None)
        if len(pieces) == len(some) and pieces:
            yield Experiment(text, {"kind": "critical_gain"} | settings, pieces, float(len(pieces)))

    std = min((g.relative_std for g in data.gains), default=0.03)
    without_frequency = [g for g in data.gains if g.frequency_Hz is None]
    if without_frequency:
        yield from gains(
            f"Repeat the {len(without_frequency)} critical gains and note the frequency of each oscillation to"
            f" {FREQUENCY_STD:.0%}.",
            {"record": "frequency_Hz"},
            [taken(g) for g in without_frequency],
        )
    for law in _laws(data):
        known = {(g.outer_end_mass, g.inner_end_mass) for g in data.gains if _same(g.controller, law)}
        for masses in sorted(_masses(data) - known):
            one = taken(MeasuredGain(law, *masses, std))
            where = f"with {masses[0]:g} kg outside and {masses[1]:g} kg inside under {_words(law)}"
            yield from gains(
                f"Measure the critical gain {where}, and the frequency of the oscillation.",
                {"controller": _without_gain(law), "outer_end_mass_kg": masses[0], "inner_end_mass_kg": masses[1]},
                [one],
            )
        load = float(f"{_LOAD_SHARE * 20e6 * data.prototype.actuator.piston_area_m2:.1g}")
        loaded = MeasuredGain(law, 0.0, 0.0, std)
        yield from gains(
            f"Measure the critical gain under {_words(law)} with a constant load of {load:g} N on the tip, pushing and"
            " pulling: unequal sides of the piston give two gains, anything else one.",
            {"controller": _without_gain(law), "load_N": [load, -load]},
            [taken(loaded, load), taken(loaded, -load)],
        )
        bare = taken(MeasuredGain(law, 0.0, 0.0, std))
        if bare is None:
            continue
        quiet = law.but(gain_A_per_V=float(f"{_OPEN_LOOP_MARGIN * bare.measured.gain:.3g}"))
        flat = FrequencyResponse("next", _LINES, np.ones(len(_LINES), complex), True, 1.0, 0.0, 0.0, quiet)
        response = ResponseEvidence(flat, data.prototype).predicted(placement, assumed.z)
        if response is None:
            continue
        piece = ResponseEvidence(replace(flat, response=response), data.prototype)
        yield Experiment(
            f"Measure the frequency response of the tip to a force, with phase, from 1 to 300 Hz under {_words(law)} at"
            f" {1e3 * quiet.gain_A_per_V:.3g} mA/V (half its critical gain).",
            {"kind": "frequency_response", "controller": _without_gain(law) | {"gain_A_per_V": quiet.gain_A_per_V}},
            (piece,),
            3.0,
        )


def _laws(data: Dataset) -> list[Controller]:
    found: list[Controller] = []
    for law in [g.controller for g in data.gains] + [r.controller for r in data.responses]:
        if not any(_same(law, known) for known in found):
            found.append(law)
    return found


def _masses(data: Dataset) -> set[tuple[float, float]]:
    """Payloads on the rig so far, half of them, and none; 5 kg where there was none."""
    used = [(g.outer_end_mass, g.inner_end_mass) for g in data.gains]
    used += [(r.outer_end_mass, r.inner_end_mass) for r in data.responses]
    outer = max((m for m, _ in used), default=0.0) or 5.0
    inner = max((m for _, m in used), default=0.0) or float(f"{exp(log(outer) - 0.43):.1g}")
    return {(a * outer, b * inner) for a in (0.0, 0.5, 1.0) for b in (0.0, 1.0)}


def _same(a: Controller, b: Controller) -> bool:
    return a.but(gain_A_per_V=1.0) == b.but(gain_A_per_V=1.0)


def _without_gain(law: Controller) -> dict[str, object]:
    return law.model_dump(exclude={"gain_A_per_V"})


def _words(law: Controller) -> str:
    return f"the {law.words()} law"
