"""Where fits begin: the figures of a simpler fit, with the new effect as strong as suits the records best.

Air in the oil begins with an oil spring that a simpler fit has softened. Without air, nothing but the spring can give
way as much as the records say, however far it is from its tolerance. That is how soft the oil is about rest; which air
and supply make it so is one equation for two unknowns. Draws of both at once hardly meet it, and a fit that begins
with another resonance than that of the records ends at it.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import reduce
from itertools import product
from types import MappingProxyType

import numpy as np
from scipy.optimize import brentq
from scipy.stats import qmc

from beamdesign.diagnosis.fitting.evidence import RecordEvidence
from beamdesign.diagnosis.fitting.fit import ITERATIONS, Evidence, Fit, fit, residuals_at
from beamdesign.diagnosis.fitting.hypothesis import AIR, NOTHING, SUPPLY, Hypothesis, Placement, Unknown
from beamdesign.plant.assembly import widened
from beamdesign.plant.effects import laws_of
from beamdesign.plant.effects.entrained_air import POLYTROPIC, bulk_ratio
from beamdesign.prototype import Prototype

SPRING = "oil_stiffness"
_SUPPLIES = (-2.2, -1.8, -1.4, -1.0, -0.6, 0.0)  # in prior standard deviations
_MOST = 0.9  # of the largest air fraction
_HARDLY = 0.97  # of the stiffness believed: nothing that needs air


def softened(
    unknowns: Sequence[Unknown], base: np.ndarray, new: Sequence[int], known: Mapping[str, float]
) -> Iterator[np.ndarray]:
    """Starts with the spring as believed and as much air as softens it, about rest, to what is known of it.

    Args:
        unknowns: of the hypothesis.
        base: (K,) z of all that is not air.
        new: positions of unknowns of which nothing is known yet.
        known: SI values of a simpler fit.

    Yields:
        (K,) z for each of several supplies; none without new air, or where the spring is not softer than believed.
    """
    at = {u.name: k for k, u in enumerate(unknowns)}
    spring = unknowns[at[SPRING]] if SPRING in at else None
    names = [name for name in laws_of(AIR) if at.get(f"{name}.air_fraction") in new]
    if spring is None or spring.kind != "figure" or SPRING not in known or len(names) != 1 or at[SUPPLY] not in new:
        return
    target = known[SPRING] / spring.nominal
    if not target < _HARDLY:
        return
    own = {q: unknowns[k] for q in ("air_fraction", "oil_bulk_modulus_Pa") for k in (at[f"{names[0]}.{q}"],)}
    exponent = at.get(f"{names[0]}.polytropic_exponent")
    given = POLYTROPIC if exponent is None else unknowns[exponent].nominal
    air, modulus = own["air_fraction"], own["oil_bulk_modulus_Pa"].nominal
    for step in _SUPPLIES:
        pressure = unknowns[at[SUPPLY]].value(step) / 2

        def beyond(fraction: float, pressure: float = pressure) -> float:
            return float(bulk_ratio(pressure, fraction, modulus, given)) - target

        most = _MOST * air.high
        if beyond(air.low) <= 0:
            continue
        fraction = most if beyond(most) >= 0 else float(brentq(beyond, air.low, most, xtol=1e-6))
        z = base.copy()
        # What air cannot do under this pressure, the spring has to.
        z[at[SPRING]] = spring.z(known[SPRING] / (beyond(fraction) + target))
        z[at[SUPPLY]], z[at[f"{names[0]}.air_fraction"]] = step, air.z(fraction)
        yield z


_DRAWS, _FEW, _WIDTH = 16, 8, 2.2  # of several new unknowns, or for a single start; in prior standard deviations
_ONE_DRAWS, _ONE_WIDTH = 20, 2.5  # of one alone, which a fit follows but slowly past the kinks of its law
_PEAKS, _APART = 4, 1.2  # resonances that are looked for, and the least ratio of two of them
_STRENGTHS = (-1.0, 1.0, 3.0, 5.0)  # in prior standard deviations of what a resonance's frequency comes with
_SIFTED = 3  # of the starts of a look, by the piece of evidence that a simpler fit leaves most of
_SIZES = (0.1, 0.3, 1.0, 4.0, 15.0)  # the last ones where the linear model moves much further than the rig
_WEAK = 0.1  # of the default
_NEARLY_KNOWN = 0.2  # spread of the logarithm


def starts(
    placement: Placement,
    known: Mapping[str, float],
    evidence: Sequence[Evidence],
    peaks: Sequence[float] = (),
    most: int = 2,
    hints: Mapping[str, float] = MappingProxyType({}),
    sifted: bool = False,
) -> list[np.ndarray]:
    """The most promising starts, best first.

    Args:
        placement: the unknowns of the hypothesis.
        known: SI values of unknowns that simpler fits have found.
        evidence: by which starts are compared; no fit is made.
        peaks: frequencies (Hz) at which an effect with a resonance may have it.
        most: how many at most; where air is new, one more that keeps the oil as soft.
        hints: SI values that another fit has found, of the new unknowns or of all; more starts that may do.
        sifted: whether the first piece of evidence tells which few of them are compared by all of it.

    A simpler fit has bent the tolerated figures to stand for what it lacked; where that is there, they need not be. So
    where there is room for two starts, one of them begins with these figures as believed.

    Returns:
        (K,) z each; none where the model's loop is unstable at all of them.
    """
    unknowns = placement.unknowns
    low, high = (np.array(side) for side in zip(*(u.bounds for u in unknowns), strict=True))
    bent = np.array([_at(u, known) for u in unknowns])
    straight = np.where([u.kind == "figure" for u in unknowns], 0.0, bent)
    new = [k for k, u in enumerate(unknowns) if u.name not in known]
    families = []
    for base in (bent, straight):
        trials = _trials(unknowns, base, new, hints, _DRAWS if most > 1 else _FEW)
        trials += _resonant(unknowns, base, new, peaks)
        inside: Iterable[np.ndarray] = (np.clip(trial, low, high) for trial in trials)
        if sifted:
            inside = [z for _, z in _best(placement, evidence[:1], inside, _SIFTED)]
        families.append(_best(placement, evidence, inside, most))
    firsts = sorted((family[0] for family in families if family), key=lambda pair: pair[0])
    others = sorted((pair for family in families for pair in family[1:]), key=lambda pair: pair[0])
    found = [z for _, z in [*firsts, *others][:most]]
    # What is drawn may leave less than what keeps the oil as soft as known, and yet lie on the far side of a resonance.
    return [*found, *(z for _, z in _best(placement, evidence, softened(unknowns, bent, new, known), 1))]


def fit_from_starts(
    hypothesis: Hypothesis,
    prototype: Prototype,
    evidence: Sequence[Evidence],
    known: Mapping[str, float],
    peaks: Sequence[float] = (),
    most: int = 2,
    hints: Mapping[str, float] = MappingProxyType({}),
    iterations: int = ITERATIONS,
    sifted: bool = False,
) -> Fit:
    """The best of fits from the most promising `starts`."""
    placement = hypothesis.placement(prototype)
    if not (begun := starts(placement, known, evidence, peaks, most, hints, sifted)):
        reason = "the model's loop is unstable wherever a fit was begun"
        return Fit(hypothesis, placement.unknowns, reason=reason)
    return min((fit(hypothesis, placement, evidence, z, iterations) for z in begun), key=lambda f: f.cost)


def _best(
    placement: Placement, evidence: Sequence[Evidence], trials: Iterable[np.ndarray], most: int
) -> list[tuple[float, np.ndarray]]:
    """Of some trials, those that leave least misfit, with it; best first."""
    best: list[tuple[float, np.ndarray]] = []
    order = list(evidence)
    for z in trials:
        enough = best[-1][0] if len(best) == most else np.inf
        if (found := residuals_at(order, placement, z, enough)) is None:
            continue
        left = [float(r @ r) for r in found]
        best = sorted([*best, (float(z @ z) + sum(left), z)], key=lambda pair: pair[0])[:most]
        # What shows most first, so that a start which is worse is soon seen to be.
        order = [piece for _, piece in sorted(zip(left, order, strict=True), key=lambda pair: -pair[0])]
    return best


def _at(unknown: Unknown, known: Mapping[str, float]) -> float:
    return unknown.z(known[unknown.name]) if unknown.name in known else 0.0


def _trials(
    unknowns: Sequence[Unknown], base: np.ndarray, new: Sequence[int], hints: Mapping[str, float], draws: int
) -> list[np.ndarray]:
    """The base, all as hinted, the new unknowns as hinted or drawn, and each new effect nearly absent."""
    trials = [base]
    if hints:
        known = [k for k, u in enumerate(unknowns) if u.name in hints]
        trials.append(_moved(base, known, [unknowns[k].z(hints[unknowns[k].name]) for k in known]))
    if not new:
        return trials
    if hints:
        trials.append(_moved(base, new, [_at(unknowns[k], hints) for k in new]))
    # Draws are few: what is known within a fifth begins at its default, and leaves them to what may be anything.
    new = [k for k in new if unknowns[k].linear or unknowns[k].spread > _NEARLY_KNOWN] or new
    linear = [k for k in new if unknowns[k].linear]
    trials.append(_moved(base, linear, [unknowns[k].z(_WEAK * unknowns[k].nominal) for k in linear]))
    # One term of a curve that is learnt, of either sign: a strong one is found by no descent that begins without it.
    terms = [k for k in new if unknowns[k].nominal == 0 and unknowns[k].low == -unknowns[k].high]
    trials += [_moved(base, [k], [unknowns[k].z(size)]) for k in terms for size in (*_SIZES, *(-s for s in _SIZES))]
    if len(new) == 1:
        rows = _ONE_WIDTH * np.linspace(-1, 1, _ONE_DRAWS)[:, None]
    else:
        rows = _WIDTH * (2 * qmc.Sobol(len(new), scramble=True, seed=0).random(draws) - 1)
    return [*trials, *(_moved(base, new, row) for row in rows)]


def _moved(base: np.ndarray, at: Sequence[int], to: Sequence[float] | np.ndarray) -> np.ndarray:
    z = base.copy()
    z[list(at)] = to
    return z


def resonances(
    evidence: Sequence[Evidence], prototype: Prototype, known: Mapping[str, float], hypothesis: Hypothesis = NOTHING
) -> tuple[float, ...]:
    """Frequencies (Hz) at which the records stand out most from what a simpler fit explains.

    A narrow resonance is found by no descent that begins beside it, and shows in the residual at once. Beside another
    cause it shows only in what that one leaves.

    Args:
        evidence: of which records count.
        prototype: nominal.
        known: SI values that the simpler fit has found.
        hypothesis: of what is to be fitted; those of its effects count that are known whole.
    """
    effects = (Hypothesis((name,)) for name in hypothesis.effects)
    explained = [one for one in effects if all(u.name in known for u in one.unknowns(prototype))]
    placement = reduce(Hypothesis.__or__, explained, NOTHING).placement(prototype)
    z = np.array([_at(u, known) for u in placement.unknowns])
    edges, powers = np.geomspace(*widened(prototype, _LEAST_HZ, _MOST_HZ), _BANDS + 1), []
    for piece in evidence:
        if isinstance(piece, RecordEvidence) and (residual := piece.residual(placement, z)) is not None:
            lines = residual.reshape(2, -1, len(piece.weight.channels))
            power = np.sum(lines**2, axis=(0, 2))
            powers.append(np.histogram(piece.weight.frequencies_Hz, edges, weights=power)[0])
    if not powers:
        return ()
    total, middle = sum(powers), np.sqrt(edges[1:] * edges[:-1])
    found: list[float] = []
    for k in np.argsort(-total):
        if all(max(middle[k] / f, f / middle[k]) > _APART for f in found):
            found.append(float(middle[k]))
        if len(found) == _PEAKS:
            break
    return tuple(found)


_LEAST_HZ, _MOST_HZ, _BANDS = 10.0, 400.0, 180  # of the published rig


def _resonant(
    unknowns: Sequence[Unknown], base: np.ndarray, new: Sequence[int], peaks: Sequence[float]
) -> list[np.ndarray]:
    """Every peak with every strength, and with figures from 0 to 1 at either end."""
    if not (at := [k for k in new if unknowns[k].name.endswith(".frequency_Hz")]):
        return []
    strength, *others = (k for k in new if k not in at)
    switches = [k for k in (strength, *others) if (unknowns[k].low, unknowns[k].high) == (0.0, 1.0)]
    return [
        _moved(
            base,
            [*at, strength, *switches],
            [*(unknowns[k].z(peak) for k in at), size, *(unknowns[k].z(end) for k in switches)],
        )
        for peak, size, end in product(peaks, _STRENGTHS, (0.0, 1.0) if switches else (0.0,))
    ]
