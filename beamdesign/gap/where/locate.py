"""Where a gap lies: several witnesses that look in different ways, and a sentence that weighs them.

A gap is told to be linear, static, hysteretic or drifting.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import casadi as ca

from beamdesign.gap.data.dataset import Dataset
from beamdesign.gap.diagnosis import Cause, Where, Witness
from beamdesign.gap.fitting.fit import Fit
from beamdesign.gap.fitting.hypothesis import WRONG
from beamdesign.gap.fitting.search import Search
from beamdesign.gap.where.conditions import Setting, setting
from beamdesign.gap.where.missing import Explanation, explanations, regression
from beamdesign.gap.where.residuals import Residual, residuals
from beamdesign.gap.where.witnesses import (
    Opinion,
    about_controller,
    about_equations,
    about_figures,
    posterior,
    weighed,
)
from beamdesign.rig.assembly import Structure, assemble
from beamdesign.rig.effects import library
from beamdesign.rig.electronics import LAG

_DRIFT = 0.5  # of the residual's power
_BENT = 0.3  # of the residual's power away from the lines of the input
_TOLD = 0.3  # share that a subsystem's laws must explain for their kind to count


def kind_of_effect(name: str) -> str:
    """Kind of a cause of the library: by its memory, and by whether its equations are linear in the states."""
    if name.startswith(WRONG):
        return "linear"
    effect = library().get(name)
    if effect is None:
        return ""
    if effect.memory:
        return "hysteretic"
    assembly = assemble(Structure(LAG, False, (name,)))
    t, x, u, p = (ca.SX.sym(n, *assembly.function.size_in(k)) for k, n in enumerate("txup"))
    rate, y = assembly.function(t, x, u, p)
    slopes = ca.jacobian(ca.vertcat(rate, y), ca.vertcat(x, u))
    bent = any(ca.which_depends(ca.vec(slopes), ca.vertcat(x, u), 1, True))
    return "static" if bent else "linear"


def kind_of_residual(seen: Setting, laws: Sequence[Explanation]) -> str:
    """Kind of a gap whose cause is not known: by its slowness, by the laws that explain most, by its distortion."""
    if seen.slow > _DRIFT:
        return "drifting"
    if laws and laws[0].share > _TOLD and laws[0].kinds:
        return laws[0].kinds[0]
    if seen.distortion == seen.distortion:
        return "static" if seen.distortion > _BENT else "linear"
    return ""


_ALIKE = 0.05  # shares
NO_GAP = Where("", (0.0, 0.0), "", sentence="There is no gap to place.")


def locate(
    data: Dataset,
    search: Search,
    chosen: Fit,
    evidence: Sequence[object],
    causes: Sequence[Cause] = (),
    unknown: float = 0.0,
) -> Where:
    """Find where the gap lies.

    Args:
        data: what came back.
        search: all fits.
        chosen: the fit held responsible; that of the null where there is no gap, or no known cause.
        evidence: pieces of the data set; those that are time records testify.
        causes: of the verdict with their probabilities, the dominant one first; none: worked out from the search.
        unknown: probability that the cause is not in the library.

    Returns:
        without a subsystem where the chosen fit is the null and no unknown cause is probable.
    """
    if not chosen.hypothesis.names and unknown <= 0.5:
        return NO_GAP
    found = () if search.null.reason else residuals(data.prototype, search.null, evidence)
    opinions = [posterior(search, chosen, causes, unknown)]
    laws: tuple[Explanation, ...] = ()
    seen: Setting | None = None
    if found:
        laws, seen = laws_of(found, search.null), setting(found)
        opinions += [about_controller(data.prototype, found), about_equations(laws)]
    opinions.append(about_figures(search.null, search.expected))
    scores = weighed(opinions)
    place = next(iter(scores))
    dominant = causes[0].name if causes else next(iter(chosen.hypothesis.names), "")
    known = dominant and unknown <= 0.5 and opinions[0].favourite == place
    kind = kind_of_effect(dominant) if known else ""
    witnesses = [o.witness for o in opinions]
    band, condition = (0.0, 0.0), ""
    if seen is not None:
        kind = kind or kind_of_residual(seen, laws)
        witnesses.append(_shown(seen))
        band, condition = seen.band_Hz, seen.condition
    sentence = _sentence(place, scores, opinions, band, kind)
    return Where(place, band, condition, kind, tuple(witnesses), sentence)


def laws_of(found: Sequence[Residual], null: Fit) -> tuple[Explanation, ...]:
    """How far each subsystem's own laws explain the residuals, best first.

    Local variables are taken from the model, and again as smoothed by the records: the former miss what a strong cause
    does to them, the latter hold some of what is to be explained. The share is the mean of both; where two are alike,
    the former decides.
    """
    plain, smooth = (
        {e.subsystem: e for e in explanations(regression(found, null, corrected))} for corrected in (False, True)
    )
    merged = []
    for name in plain:
        one, other = plain[name], smooth[name]
        told = one if one.share >= other.share else other
        mean = (max(one.share, 0.0) + max(other.share, 0.0)) / 2
        merged.append(replace(told, share=mean))
    most = max(e.share for e in merged)
    close = [e for e in merged if e.share > most - _ALIKE]
    lead = max(close, key=lambda e: plain[e.subsystem].share)
    return tuple(sorted(merged, key=lambda e: (e is not lead, -e.share)))


def _shown(seen: Setting) -> Witness:
    """Frequency, size, payload, input and direction: what kind of gap it is; it names no subsystem."""
    parts = [f"Most of the misfit is between {seen.band_Hz[0]:g} and {seen.band_Hz[1]:g} Hz"]
    parts.append(f"the relative error is {seen.condition}")
    if seen.distortion == seen.distortion:
        parts.append(f"{seen.distortion:.0%} of it lies away from the lines of the input")
    parts.append(f"it differs by {seen.asymmetry:.0%} between the two directions")
    return Witness("bands and conditions", "", 0.0, "; ".join(parts) + ".", seen.table)


def _sentence(
    place: str, scores: Mapping[str, float], opinions: Sequence[Opinion], band: tuple[float, float], kind: str
) -> str:
    """Who says so, who says otherwise, and by how much."""
    speak = [o for o in opinions if o.favourite]
    agree = [o.name for o in speak if o.favourite == place]
    others: dict[str, list[str]] = {}
    for o in speak:
        if o.favourite != place:
            others.setdefault(o.favourite, []).append(o.name)
    total = sum(scores.values()) or 1.0
    where = f" between {band[0]:g} and {band[1]:g} Hz" if band[1] > 0 else ""
    what = f", {kind}," if kind else ""
    told = f"The gap{what} lies in the {place}{where}: so say {_listed(agree)}"
    if others:
        told += "; " + ", ".join(f"{_listed(names)} would have it in the {sub}" for sub, names in others.items())
    return f"{told}. Weighed, {scores[place] / total:.0%} is for the {place}."


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}" if names else "none alone"
