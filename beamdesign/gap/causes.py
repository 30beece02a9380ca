"""Causes of a gap, ranked, with what each explains and what makes it suspicious."""

from math import inf

from beamdesign.gap.diagnosis import Cause, Estimate
from beamdesign.gap.fitting.fit import Fit
from beamdesign.gap.fitting.hypothesis import NOTHING, WRONG, Hypothesis, subsystem
from beamdesign.gap.fitting.search import Search
from beamdesign.gap.judgement import Judgement
from beamdesign.parameters import RIG_TOLERANCES

LEAST_PROBABILITY = 0.01
SUSPICIOUS = 2.0
"""Tolerances by which a figure may be off before it is told."""


def causes(found: Search, judged: Judgement) -> tuple[Cause, ...]:
    """All causes that are not out of the question, most probable first; of the best fit in the order of their shares.

    The parameters of a cause are those of the most probable fit that holds it.
    """
    fits = {f.hypothesis: f for f in (found.null, *found.fits) if not f.reason}
    names = {name for h in judged.of for name in h.causes}
    listed = []
    for name in names:
        probability = judged.cause(name)
        if probability < LEAST_PROBABILITY and name not in judged.best.hypothesis.causes:
            continue
        holder = fits[max((h for h in judged.of if name in h.causes), key=lambda h: judged.of[h])]
        share = share_of(name, holder, found, fits)
        listed.append(
            Cause(name, subsystem(name), probability, share, parameters(name, holder), tuple(flags(name, holder)))
        )
    responsible = judged.best.hypothesis.causes
    return tuple(
        sorted(
            listed, key=lambda c: (c.name not in responsible, -c.share if c.name in responsible else 0, -c.probability)
        )
    )


def share_of(name: str, holder: Fit, found: Search, fits: dict[Hypothesis, Fit]) -> float:
    """Part of the explainable misfit that goes with a cause: what comes back when it alone is taken away."""
    rest = holder.hypothesis.without(name)
    without = fits.get(rest) if rest != NOTHING else found.null
    left = found.excess(without) if without is not None else inf
    return float(min(1.0, max(0.0, min(left, 1.0) - found.excess(holder))))


def parameters(name: str, holder: Fit) -> dict[str, Estimate]:
    """Of an effect, or the figures of a wrong one; SI."""
    errors = holder.standard_errors
    if name.startswith(WRONG):
        keys = [figure for figure, key in RIG_TOLERANCES.items() if key == name.removeprefix(WRONG)]
        return {key: Estimate(holder.values[key], errors[key]) for key in keys if key in holder.values}
    prefix = holder.hypothesis.realisation(name) + "."
    return {
        key.removeprefix(prefix): Estimate(value, errors[key])
        for key, value in holder.values.items()
        if key.startswith(prefix)
    }


def flags(name: str, holder: Fit) -> list[str]:
    """Parameters at a bound, and tolerated figures that had to move far to make it fit."""
    said = []
    prefix = holder.hypothesis.realisation(name) + "."
    for unknown, z in zip(holder.unknowns, holder.z, strict=True):
        low, high = unknown.bounds
        if unknown.kind == "effect" and unknown.name.startswith(prefix):
            # A parameter that may be none, and is, is no bound reached.
            at_low = z <= low + 1e-6 and not (unknown.linear and unknown.low == 0.0)
            if at_low or z >= high - 1e-6:
                said.append(f"{unknown.name} is at its bound, {unknown.value(z):.4g}")
        if unknown.kind == "figure" and abs(z) > SUSPICIOUS:
            said.append(f"{unknown.name} had to move by {z:+.1f} tolerances")
    return said


def classes(judged: Judgement) -> tuple[tuple[str, ...], ...]:
    """Sets of names, any of which may be the answer: what differs between hypotheses with 95 % of the probability."""
    ranked = sorted(judged.of.items(), key=lambda item: -item[1])
    total, kept = 0.0, []
    for hypothesis, probability in ranked:
        kept.append(hypothesis)
        total += probability / max(1e-12, 1 - judged.unknown)
        if total > 0.95:
            break
    common = set.intersection(*(set(h.causes) for h in kept))
    rivals = sorted({str(Hypothesis(tuple(n for n in h.causes if n not in common))) for h in kept})
    return (tuple(rivals),) if len(rivals) > 1 else ()
