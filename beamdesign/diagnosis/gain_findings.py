"""What follows from critical gains: what lies between measured and predicted ones, and which would tell more.

Between them lie one factor, the simplest answer after none, or known causes, each at a stated size: it is told how much
of the distance they carry. Of what could be measured next, it is told what would tell rival explanations apart best.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations
from math import exp, log, sqrt, tau

import numpy as np

from beamdesign.controllers import Controller
from beamdesign.diagnosis.data.dataset import Dataset, FrequencyResponse, MeasuredGain
from beamdesign.diagnosis.data.dataset_index import OFF
from beamdesign.diagnosis.diagnosis import NextExperiment
from beamdesign.diagnosis.experiment import distance
from beamdesign.diagnosis.experiment_menu import information
from beamdesign.diagnosis.fitting.evidence import Figure
from beamdesign.diagnosis.fitting.fit import Fit, linearised
from beamdesign.diagnosis.fitting.gain_evidence import FREQUENCY_STD, GainEvidence
from beamdesign.diagnosis.fitting.linear_evidence import ResponseEvidence
from beamdesign.plant.assembly import fits
from beamdesign.plant.effects import library
from beamdesign.quantities import LawGain, quantity, range_of


@dataclass(frozen=True)
class CommonFactor:
    """The one factor on all predictions that suits measured gains best.

    Attributes:
        factor: measured over predicted.
        std: of the factor, from the errors of the measurements alone.
        before: rms of ln(measured/predicted).
        left: rms that remains with the factor.
        noise: rms of the measurements' own relative errors.
    """

    factor: float
    std: float
    before: float
    left: float
    noise: float

    @property
    def explained(self) -> float:
        """Share of the mean square of ln(measured/predicted) that the factor takes away."""
        return 1 - (self.left / self.before) ** 2 if self.before > 0 else 0.0


def common_factor(measured: Sequence[float], predicted: Sequence[float], relative_std: Sequence[float]) -> CommonFactor:
    """Fit one factor to gains by weighted least squares in their logarithms."""
    ratios, errors = np.log(np.divide(measured, predicted)), np.array(relative_std, dtype=float)
    weights = errors**-2
    mean = float(weights @ ratios / weights.sum())
    factor = exp(mean)
    rms = [float(np.sqrt(np.mean(values**2))) for values in (ratios, ratios - mean, errors)]
    return CommonFactor(factor, factor / sqrt(float(weights.sum())), *rms)


def factor_of(gains: Sequence[GainEvidence]) -> CommonFactor | None:
    """One common factor on the believed gains; None without gains, or where the model oscillates at none."""
    model = [piece.nominal() for piece in gains]
    if not model or None in model:
        return None
    taken = [piece.measured for piece in gains]
    return common_factor([one.gain for one in taken], [at.gain for at in model], [one.relative_std for one in taken])


AREAS = "unequal_piston_areas"
SUSPECTS = ("sensor_lag", AREAS)
"""What Zalucky and Hardt (1984) had in their rig and not in their model: the sensor's filter, the smaller side."""


@dataclass(frozen=True)
class GainShare:
    """What one cause carries of the mean of ln(measured/predicted).

    Attributes:
        name: of the effect, or `common_factor` for what is left to one factor on all gains.
        parameters: the size it is taken at.
        alone: mean change of ln(gain) by it alone.
        share: mean, over all orders in which the causes may be added, of what it adds (L. S. Shapley, Contributions to
            the Theory of Games II (1953) 307); for the factor, what the others leave.
    """

    name: str
    parameters: Mapping[str, float]
    alone: float
    share: float


@dataclass(frozen=True)
class GainShares:
    """Of all causes; their shares add up to the total.

    Attributes:
        total: mean of ln(measured/predicted).
        together: mean change of ln(gain) by all stated causes at once.
        shares: one per cause, the common factor last.
        left: rms of ln(measured/predicted) that is left with all of them, the factor included.
    """

    total: float
    together: float
    shares: tuple[GainShare, ...]
    left: float


def gain_shares(gains: Sequence[GainEvidence]) -> GainShares | None:
    """Share out the distance between measured and predicted gains, all figures of the rig as believed.

    Args:
        gains: measured.

    Returns:
        None without gains, of a rig that cannot have them, or where the model with some of `SUSPECTS` oscillates at no
        gain.
    """
    if not gains or not all(fits(name, gains[0].prototype.rig) for name in SUSPECTS):
        return None
    logs: dict[frozenset[str], np.ndarray] = {}
    for chosen in (some for count in range(len(SUSPECTS) + 1) for some in combinations(SUSPECTS, count)):
        found = [piece.nominal(*chosen) for piece in gains]
        if None in found:
            return None
        logs[frozenset(chosen)] = np.log([at.gain for at in found])
    base, everything = logs[frozenset()], logs[frozenset(SUSPECTS)]
    measured = np.array([log(piece.measured.gain) for piece in gains])
    total, carried = float(np.mean(measured - base)), float(np.mean(everything - base))
    shares = []
    for name in SUSPECTS:
        before = [frozenset(order[: order.index(name)]) for order in permutations(SUSPECTS)]
        steps = [float(np.mean(logs[others | {name}] - logs[others])) for others in before]
        sizes = {q.name: float(q.default) for q in library()[name].parameters}
        shares.append(GainShare(name, sizes, float(np.mean(logs[frozenset({name})] - base)), float(np.mean(steps))))
    shares.append(GainShare("common_factor", {"factor": float(np.exp(total - carried))}, total, total - carried))
    return GainShares(total, carried, tuple(shares), float(np.std(measured - everything)))


_DIFFERS = 0.1  # of a gain, from which the model is said to be another than the designers'


def notes_of(
    silent: Sequence[str], shares: GainShares | None, factor: CommonFactor | None, rig: str
) -> tuple[str, ...]:
    """What else has to be said of a kind of rig."""
    cylinder = fits(AREAS, rig)
    said = [
        "Critical gains are those of the linear loop at small motion beyond deadband, hysteresis, play and dry"
        " friction, and so are responses, but for what a sine of the stated amplitude makes of such laws, play"
        f" excepted{'; of unequal sides the smaller one governs the gain' if cylinder else ''}."
    ]
    if silent:
        said.append(f"Of no consequence here whatever their size, so neither found nor excluded: {', '.join(silent)}.")
    if factor is not None:
        said.append(
            f"One common factor of {factor.factor:.2f} +- {factor.std:.2f} on the model's gains takes away"
            f" {factor.explained:.0%} of the mean square distance ({factor.before:.0%} to {factor.left:.0%})."
            f" {'Flow gain, sensor gain and piston area all act' if cylinder else 'The sensor gain acts'} as such a"
            " factor."
        )
    if shares is not None:
        causes = (one for one in shares.shares if one.name != "common_factor")
        parts = ", ".join(f"{one.name} {one.share:+.2f} (alone {one.alone:+.2f})" for one in causes)
        said.append(
            f"Of the mean ln(measured/model) of {shares.total:+.2f}, the published rig's filter and smaller piston side"
            f" would carry {shares.together:+.2f} together: {parts}, means over the orders of adding them;"
            f" {shares.total - shares.together:+.2f} would be left to a common factor."
        )
    return tuple(said)


def notes_on_predictions(gains: Sequence[GainEvidence], factor: CommonFactor | None, explained: str) -> tuple[str, ...]:
    """What measurement and the designers' own predictions say, and where the believed model is another than theirs."""
    said = []
    if factor is not None:
        said.append(
            f"Against the designers' own predictions one common factor of {factor.factor:.2f} +- {factor.std:.2f} takes"
            f" away {factor.explained:.0%} of the mean square distance ({factor.before:.0%} to {factor.left:.0%})."
        )
    said.append(f"From these predictions, with the model telling the changes only: {explained}")
    for piece in gains:
        foreseen, at = piece.measured.predicted_gain, piece.nominal()
        if foreseen is not None and at is not None and abs(at.gain / foreseen - 1) > _DIFFERS:
            said.append(
                f"{piece.name}: the believed model gives {quantity(at.gain, 'A/V', 3)} where the designers"
                f" predicted {quantity(foreseen, 'A/V', 3)}, so that its gap holds what their models differ in."
            )
    return tuple(said)


_LOAD_SHARE = 0.3  # of what the piston can hold at the supply
_LINES = np.geomspace(1.0, 300.0, 30)
_ENOUGH = 5.0  # a separation beyond which more is no better
_OPEN_LOOP_MARGIN = 0.5
_RIVALS = 8


def next_experiment(data: Dataset, rivals: Sequence[Fit], weights: Sequence[float]) -> NextExperiment | None:
    """The experiment that is expected to tell most about which rival it is, for its effort.

    The separation of two rivals is the distance between what they predict, in standard deviations of the measurement's
    noise and of both predictions together; that of an experiment is its root mean square over pairs, weighed by the
    probabilities of both.

    Args:
        data: measured so far.
        rivals: fits, most probable first; no more than eight count.
        weights: their probabilities.

    Returns:
        None where there are no two rivals, or none of the experiments can be predicted.
    """
    rivals, weights = rivals[:_RIVALS], weights[:_RIVALS]
    menu = experiments(data, rivals[0]) if len(rivals) > 1 else ()
    tried = [(found, asked, e) for asked, pieces, e in menu if (found := separations(pieces, rivals)) is not None]
    if not tried:
        return None
    between, best, _ = max(tried, key=lambda each: information(each[0], weights) / each[2])
    apart = tuple(str(fit.hypothesis) for fit, row in zip(rivals, between, strict=True) if row.max() >= 1.0)
    p = np.array(weights) / sum(weights)
    separation = sqrt(p @ np.minimum(between, _ENOUGH) ** 2 @ p / (1 - p @ p))
    return replace(best, separates=apart, separation=separation, information_bits=information(between, weights))


def another_size(data: Dataset) -> NextExperiment:
    """Where no explanation is at hand: whether it depends on the size of the motion, which such data do not say."""
    forces = sorted({r.amplitude for r in data.responses if r.amplitude is not None and not r.driven_by})
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
        if (rows := linearised(pieces, placement, rival.z)) is None:
            return None
        r, j = (np.concatenate(parts) for parts in zip(*rows, strict=True))
        predicted.append((r, j @ np.linalg.cholesky(rival.covariance)))
    found = np.zeros((len(rivals), len(rivals)))
    for (i, (a, free_a)), (k, (b, free_b)) in combinations(enumerate(predicted), 2):
        found[i, k] = found[k, i] = distance(a - b, np.hstack([free_a, free_b]))
    return found


Menu = Iterator[tuple[NextExperiment, tuple[Figure, ...], float]]
"""Experiments as evidence, each with the effort that its separation is divided by: number of set-ups."""


def experiments(data: Dataset, assumed: Fit) -> Menu:
    """What could be measured next on a rig of which gains or responses are known, with figures of an assumed answer."""
    placement = assumed.hypothesis.placement(data.prototype)

    def taken(gain: MeasuredGain) -> GainEvidence | None:
        piece = GainEvidence(gain, data.prototype)
        at = piece.predicted(placement, assumed.z)
        if at is None or at.gain not in range_of(LawGain):
            return None
        law = gain.controller.but(gain_A_per_V=at.gain)
        return replace(piece, measured=replace(gain, controller=law, frequency_Hz=at.frequency / tau))

    def gains(text: str, settings: dict[str, object], some: Sequence[GainEvidence | None]) -> Menu:
        pieces = tuple(piece for piece in some if piece is not None)
        if len(pieces) == len(some) and pieces:
            yield NextExperiment(text, (), 0.0, {"kind": "critical_gain"} | settings), pieces, float(len(pieces))

    std = min((g.relative_std for g in data.gains), default=0.03)
    if without_frequency := [g for g in data.gains if g.frequency_Hz is None]:
        yield from gains(
            f"Repeat the {len(without_frequency)} critical gains and note the frequency of each oscillation to"
            f" {FREQUENCY_STD:.0%}.",
            {"record": "frequency_Hz"},
            [taken(g) for g in without_frequency],
        )
    for law in _laws(data):
        named, breaks = f"the {law.words()} law", law.model_dump(exclude={"gain_A_per_V"})
        own = [g for g in data.gains if g.controller.but(gain_A_per_V=1.0) == law.but(gain_A_per_V=1.0)]
        known = {(g.outer_end_mass, g.inner_end_mass) for g in own if not g.load_N}
        for masses in sorted(_masses(data) - known):
            where = f"with {masses[0]:g} kg outside and {masses[1]:g} kg inside under {named}"
            text = f"Measure the critical gain {where}, and the frequency of the oscillation."
            at = {"controller": breaks, "outer_end_mass_kg": masses[0], "inner_end_mass_kg": masses[1]}
            yield from gains(text, at, [taken(MeasuredGain(law, *masses, std))])
        if fits(AREAS, data.prototype.rig):
            load = float(f"{_LOAD_SHARE * data.prototype.actuator.strength_N(data.prototype):.1g}")
            both = [MeasuredGain(law, 0.0, 0.0, std, load_N=sign * load) for sign in (1, -1)]
            if not {load, -load} <= {g.load_N for g in own}:
                yield from gains(
                    f"Measure the critical gain under {named} with a constant load of {load:g} N on the tip,"
                    " pushing and pulling: unequal sides of the piston give two gains, anything else one.",
                    {"controller": breaks, "load_N": [load, -load]},
                    [taken(one) for one in both],
                )
        if (bare := taken(MeasuredGain(law, 0.0, 0.0, std))) is None:
            continue
        quiet = law.but(gain_A_per_V=float(f"{_OPEN_LOOP_MARGIN * bare.measured.gain:.3g}"))
        flat = FrequencyResponse("next", _LINES, np.ones(len(_LINES), complex), True, None, 0.0, 0.0, quiet)
        if (response := ResponseEvidence(flat, data.prototype).predicted(placement, assumed.z)) is None:
            continue
        piece = ResponseEvidence(replace(flat, response=response), data.prototype)
        text = (
            f"Measure the frequency response of the tip to a force, with phase, from 1 to 300 Hz under {named} at"
            f" {quantity(quiet.gain_A_per_V, 'A/V', 3)} (half its critical gain)."
        )
        given = {"kind": "frequency_response", "controller": quiet.model_dump()}
        yield NextExperiment(text, (), 0.0, given), (piece,), 3.0


def _laws(data: Dataset) -> list[Controller]:
    found: dict[Controller, Controller] = {}
    for law in [g.controller for g in data.gains] + [r.controller for r in data.responses if r.controller != OFF]:
        found.setdefault(law.but(gain_A_per_V=1.0), law)
    return list(found.values())


def _masses(data: Dataset) -> set[tuple[float, float]]:
    """Payloads on the rig so far, half of them, and none; 5 kg where there was none."""
    used = [(g.outer_end_mass, g.inner_end_mass) for g in data.gains]
    used += [(r.outer_end_mass, r.inner_end_mass) for r in data.responses]
    outer = max((m for m, _ in used), default=0.0) or 5.0
    inner = max((m for _, m in used), default=0.0) or float(f"{exp(log(outer) - 0.43):.1g}")
    return {(a * outer, b * inner) for a in (0.0, 0.5, 1.0) for b in (0.0, 1.0)}
