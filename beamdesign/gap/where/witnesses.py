"""Witnesses to the place of a gap, each with its own way of looking, and how their opinions are weighed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from beamdesign.gap.diagnosis import Cause, Witness
from beamdesign.gap.examination.controller_equation import controller_fit
from beamdesign.gap.fitting.fit import Fit
from beamdesign.gap.fitting.hypothesis import WRONG, subsystem
from beamdesign.gap.fitting.search import Search
from beamdesign.gap.where.missing import Explanation
from beamdesign.gap.where.residuals import Residual
from beamdesign.parameters import RIG_TOLERANCES
from beamdesign.prototype import Prototype
from beamdesign.rig.effect import SUBSYSTEMS


@dataclass(frozen=True)
class Opinion:
    """What one witness holds.

    Attributes:
        name: of the witness.
        votes: by subsystem, from 0 to 1 in all.
        weight: of this kind of witness against the others.
        text: in words.
        table: for a report.
    """

    name: str
    votes: Mapping[str, float]
    weight: float
    text: str
    table: Mapping[str, tuple[object, ...]] = field(default_factory=dict)

    @property
    def favourite(self) -> str:
        """Where it points; empty where it says nothing, or the same of several places."""
        ranked = sorted(self.votes, key=lambda name: -self.votes[name])
        if not ranked or self.votes[ranked[0]] <= 0:
            return ""
        tied = len(ranked) > 1 and self.votes[ranked[0]] == self.votes[ranked[1]]
        return "" if tied else ranked[0]

    @property
    def witness(self) -> Witness:
        """As a diagnosis records it; its strength is its lead over the second place."""
        ranked = sorted(self.votes.values(), reverse=True)
        lead = ranked[0] - (ranked[1] if len(ranked) > 1 else 0.0) if ranked else 0.0
        return Witness(self.name, self.favourite, min(1.0, max(0.0, lead)), self.text, self.table)


def weighed(opinions: Sequence[Opinion]) -> dict[str, float]:
    """Sum of all votes times weights, by subsystem, largest first."""
    total = {name: sum(o.weight * o.votes.get(name, 0.0) for o in opinions) for name in SUBSYSTEMS}
    return dict(sorted(total.items(), key=lambda item: -item[1]))


_POSTERIOR, _CONTROLLER, _LAWS, _FIGURES = 4.0, 2.0, 1.5, 0.8
_SEEN = 0.03  # residual of the controller's equation that is worth a word
_STRAINED = 3.0  # tolerances
_FIRST = 1.05  # what the first place counts for more, where two share alike
_TUNED_AWAY = 4.0  # times the misfit of noise: what tolerances leave beyond it, they do not explain


def posterior(search: Search, chosen: Fit, causes: Sequence[Cause], unknown: float) -> Opinion:
    """Subsystems of the causes found, by their probability; of several at once the dominant one counts.

    Args:
        search: all fits.
        chosen: held responsible.
        causes: with probabilities, dominant first; none: from `search`.
        unknown: probability that the cause is not in the library.
    """
    votes: dict[str, float] = {}
    if causes:
        inside = [c for c in causes if c.name in chosen.hypothesis.causes] or list(causes[:1])
        lead = inside[0]
        votes[lead.subsystem] = lead.probability
        for c in causes:
            if c not in inside:
                votes[c.subsystem] = votes.get(c.subsystem, 0.0) + c.probability * (1 - lead.probability)
    else:
        names = _by_share(search, chosen)
        if names:
            votes[subsystem(names[0])] = 1.0
    total = max(sum(votes.values()), 1.0)
    votes = {name: value / total * (1 - unknown) for name, value in votes.items()}
    named = ", ".join(chosen.hypothesis.causes) or "no cause of the library"
    text = f"The fits hold {named} responsible; a cause outside the library has a probability of {unknown:.0%}."
    return Opinion("the fits", votes, _POSTERIOR, text)


def _by_share(search: Search, chosen: Fit) -> list[str]:
    """Names of a fit, first the one without which most of the gap comes back."""
    alone = {f.hypothesis.names: search.excess(f) for f in search.fits if not f.reason}

    def without(name: str) -> float:
        rest = tuple(n for n in chosen.hypothesis.names if n != name)
        return alone.get(rest, 1.0)

    return sorted(chosen.hypothesis.names, key=lambda name: -without(name))


def about_controller(prototype: Prototype, found: Sequence[Residual]) -> Opinion:
    """Measured current against K C(s) (command - F x): the one equation that the channels can check alone."""
    held = [controller_fit(item.evidence.record, prototype.sensor.gain_V_per_m) for item in found]
    fits = [fit for fit in held if fit is not None]
    if not fits:
        text = "No record holds all that its controller hears, so that its equation says nothing."
        return Opinion("the controller's equation", {}, _CONTROLLER, text, {})
    # What is left of a quiet record, once its noise is taken out, is known no better than about half that noise.
    worst = max(fits, key=lambda f: f.residual if f.residual > f.noise else 0.0)
    table: dict[str, tuple[object, ...]] = {
        "record": tuple(f.record for f in fits),
        "residual": tuple(f.residual for f in fits),
        "gain": tuple(f.gain for f in fits),
        "delay_s": tuple(f.delay_s for f in fits),
        "limit_A": tuple(f.limit_A for f in fits),
    }
    if worst.residual < max(_SEEN, worst.noise):
        text = "Every record obeys its controller's equation."
        return Opinion("the controller's equation", {}, _CONTROLLER, text, table)
    if worst.limit_A is not None:
        place, why = "amplifier", f"the current saturates at {worst.limit_A * 1e3:.3g} mA"
    elif worst.with_delay < 0.5 * worst.with_gain:
        place, why = "controller", f"the current comes {worst.delay_s * 1e3:.2g} ms late"
    elif worst.with_gain < 0.5 * worst.residual:
        place, why = "amplifier", f"the current is {worst.gain:.3g} times what the controller asks for"
    else:
        place, why = "controller", "no gain, delay or limit explains it"
    strength = float(np.clip(worst.residual / 0.1, 0.0, 1.0))
    text = f"Record {worst.record} misses its controller's equation by {worst.residual:.1%} of the current: {why}."
    return Opinion("the controller's equation", {place: strength}, _CONTROLLER, text, table)


def about_equations(laws: Sequence[Explanation]) -> Opinion:
    """Which subsystem's own laws, of its own local variables, explain the residual in conditions held out."""
    shares = {e.subsystem: float(np.clip(e.share, 0.0, 1.0)) for e in laws}
    cubes = {name: share**3 for name, share in shares.items()}
    lead = laws[0]
    cubes[lead.subsystem] = _FIRST * max(cubes.values())
    total = sum(cubes.values())
    best = max(shares.values(), default=0.0)
    votes = {name: best * value / total for name, value in cubes.items()} if total > 0 else {}
    text = (
        f"Laws of the {lead.subsystem} explain {lead.share:.0%} of the gap in held-out conditions"
        + (f" ({', '.join(lead.terms)})" if lead.terms else "")
        + "; next "
        + ", ".join(f"{e.subsystem} {max(e.share, 0.0):.0%}" for e in laws[1:3])
        + "."
    )
    table: dict[str, tuple[object, ...]] = {
        "subsystem": tuple(e.subsystem for e in laws),
        "share": tuple(e.share for e in laws),
        "terms": tuple(", ".join(e.terms) for e in laws),
    }
    return Opinion("the laws of each equation", votes, _LAWS, text, table)


def about_figures(null: Fit, expected: float) -> Opinion:
    """Which tolerated figure had to move furthest when only tolerances were fitted.

    It counts where tolerances alone explain most: then a figure that moved too far did the work.

    Args:
        null: that fit.
        expected: misfit that noise alone leaves.
    """
    if null.reason or not len(null.z):
        return Opinion("the tolerated figures", {}, _FIGURES, "No tolerated figure could be fitted.")
    moved = {u.name: float(z) for u, z in zip(null.unknowns, null.z, strict=True)}
    furthest = max(moved, key=lambda name: abs(moved[name]))
    text = f"Fitted alone, {furthest} moves furthest: {moved[furthest]:+.1f} tolerances."
    table: dict[str, tuple[object, ...]] = {"figure": tuple(moved), "tolerances": tuple(moved.values())}
    if abs(moved[furthest]) < _STRAINED:
        return Opinion("the tolerated figures", {}, _FIGURES, text, table)
    place = subsystem(WRONG + RIG_TOLERANCES[furthest])
    strength = float(np.clip((abs(moved[furthest]) - _STRAINED) / _STRAINED, 0.0, 1.0))
    strength *= float(np.clip((_TUNED_AWAY - null.misfit / expected) / (_TUNED_AWAY - 1), 0.0, 1.0))
    return Opinion("the tolerated figures", {place: strength}, _FIGURES, text, table)
