"""Where a gap lies: what the fits say, what the laws of each equation say, and a sentence that weighs both.

A gap is told to be linear, static, hysteretic or drifting.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from beamdesign.diagnosis.diagnosis import Cause, Indicator, Where, in_words, listed
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.hypothesis import ABSENT, WRONG
from beamdesign.diagnosis.fitting.search import Search
from beamdesign.diagnosis.where.conditions import setting
from beamdesign.diagnosis.where.missing import Explanation, explanations, regression
from beamdesign.diagnosis.where.residuals import Residual, residuals
from beamdesign.plant.assembly import RIGS, Structure, assemble, fits
from beamdesign.plant.component import LAG
from beamdesign.plant.effects import SUBSYSTEMS, library
from beamdesign.time_limit import TimeUp, leave_out, share

Vote = tuple[Mapping[str, float], Indicator]
"""What an indicator holds by subsystem, from 0 to 1 in all, and as a diagnosis records it."""


def vote(name: str, by: Mapping[str, float], text: str, table: Mapping[str, tuple[object, ...]] | None = None) -> Vote:
    """Votes by subsystem; they point nowhere where they say nothing, or the same of several places.

    The strength is the lead over the second place.
    """
    (first, most), (_, second) = (*sorted(by.items(), key=lambda item: -item[1]), ("", 0.0), ("", 0.0))[:2]
    favourite = first if most > max(second, 0.0) else ""
    return by, Indicator(name, favourite, min(1.0, max(0.0, most - second)), text, table or {})


_FITS, _LAWS = "the fits", "the laws of each equation"
_WEIGHTS = {_FITS: 4.0, _LAWS: 1.5}
_FIRST = 1.05  # what the first place counts for more, where two share alike


def about_fits(chosen: Fit, causes: Sequence[Cause], unknown: float) -> Vote:
    """The subsystem of the dominant cause, by its probability.

    Args:
        chosen: held responsible.
        causes: its causes with probabilities, the dominant one first.
        unknown: probability that the cause is not in the library.
    """
    votes = {lead.subsystem: lead.probability * (1.0 if lead.like else 1 - unknown) for lead in causes[:1]}
    named = in_words(", ".join(chosen.hypothesis.causes)) or "no cause of the library"
    text = f"The fits hold {named} responsible; a cause outside the library has a probability of {unknown:.0%}."
    return vote(_FITS, votes, text)


def about_equations(laws: Sequence[Explanation]) -> Vote:
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
    table = {name: tuple(getattr(e, name) for e in laws) for name in ("subsystem", "share")}
    table["terms"] = tuple(", ".join(e.terms) for e in laws)
    return vote(_LAWS, votes, text, table)


_TOLD = 0.3  # share that a subsystem's laws must explain for their kind to count


def kind_of_effect(name: str) -> str:
    """Kind of a cause of the library: by its memory, and by whether its equations are linear in the states."""
    name = name.removeprefix(ABSENT)
    if name.startswith(WRONG):
        return "linear"
    if library()[name].memory:
        return "hysteretic"
    assembly = assemble(Structure(LAG, False, (name,), next(rig for rig in RIGS if fits(name, rig))))
    t, x, u, p = (ca.SX.sym(n, *assembly.function.size_in(k)) for k, n in enumerate("txup"))
    rate, y = assembly.function(t, x, u, p)
    slopes = ca.jacobian(ca.vertcat(rate, y), ca.vertcat(x, u))
    if ca.depends_on(ca.vertcat(rate, y), t):
        return "drifting"
    bent = any(ca.which_depends(ca.vec(slopes), ca.vertcat(x, u), 1, True))
    return "static" if bent else "linear"


_ALIKE = 0.05  # shares
NO_GAP = Where("", (0.0, 0.0), "", sentence="There is no gap to place.")


def locate(
    search: Search,
    chosen: Fit,
    evidence: Sequence[object],
    causes: Sequence[Cause] = (),
    unknown: float = 0.0,
) -> Where:
    """Find where the gap lies.

    Args:
        search: all fits.
        chosen: the fit held responsible; that of the null where there is no gap, or no known cause.
        evidence: pieces of the data set; those that are time records testify.
        causes: of that fit with their probabilities, the dominant one first.
        unknown: probability that the cause is not in the library.

    Returns:
        without a subsystem where the chosen fit is the null and no unknown cause is probable; by the fits alone where
        no time is left for the records to testify.
    """
    if not chosen.hypothesis.names and unknown <= 0.5:
        return NO_GAP
    votes = [about_fits(chosen, causes, unknown)]
    laws: tuple[Explanation, ...] = ()
    seen = Where("", (0.0, 0.0), "")
    try:
        with share(1.0, within_steps=True):
            if found := residuals(search.null, evidence):
                seen = setting(found)
                laws = laws_of(found, search.null)
                votes.append(about_equations(laws))
    except TimeUp:
        leave_out("what the records say of the place")
    shown = [indicator for _, indicator in votes]
    scores = {name: sum(_WEIGHTS[of.name] * by.get(name, 0.0) for by, of in votes) for name in SUBSYSTEMS}
    place = max(scores, key=lambda name: scores[name])
    if scores[place] <= 0:
        return replace(seen, kind="", indicators=tuple(shown), sentence="Nothing says yet where the gap lies.")
    kind = seen.kind
    if kind != "drifting" and laws and laws[0].share > _TOLD and laws[0].kinds:
        kind = laws[0].kinds[0]  # of the laws that explain most
    if causes and (unknown <= 0.5 or causes[0].like) and shown[0].subsystem == place:
        kind = kind_of_effect(chosen.hypothesis.realisation(causes[0].name))
    weight = f"Weighed, {scores[place] / sum(scores.values()):.0%} is for the {place}." if unknown <= 0.5 else _OUTSIDE
    sentence = f"{_sentence(place, shown, seen.band_Hz, kind)}. {weight}"
    return replace(seen, subsystem=place, kind=kind, indicators=(*shown, *seen.indicators), sentence=sentence)


def laws_of(found: Sequence[Residual], null: Fit) -> tuple[Explanation, ...]:
    """How far each subsystem's own laws explain the residuals, best first.

    Local variables are taken from the model, and again as smoothed by the records: the former miss what a strong cause
    does to them, the latter hold some of what is to be explained. The share is the mean of both; where two are alike,
    the former decides.
    """
    plain, smooth = (
        {e.subsystem: e for e in explanations(regression(found, null, corrected))} for corrected in (False, True)
    )
    both = [(plain[name], smooth[name]) for name in plain]
    merged = [replace(max(two, key=lambda e: e.share), share=sum(max(e.share, 0.0) for e in two) / 2) for two in both]
    most = max(e.share for e in merged)
    close = [e for e in merged if e.share > most - _ALIKE]
    lead = max(close, key=lambda e: plain[e.subsystem].share)
    return tuple(sorted(merged, key=lambda e: (e is not lead, -e.share)))


_OUTSIDE = "Of causes outside the library only about half lie where that says (10 of 19 in the blind check)."


def _sentence(place: str, indicators: Sequence[Indicator], band: tuple[float, float], kind: str) -> str:
    """Who says so, and who says otherwise."""
    others: dict[str, list[str]] = {place: []}
    for one in indicators:
        if one.subsystem:
            others.setdefault(one.subsystem, []).append(one.name)
    agree = others.pop(place)
    where = f" between {band[0]:g} and {band[1]:g} Hz" if band[1] > 0 else ""
    what = f", {kind}," if kind else ""
    sentence = f"The gap{what} lies in the {place}{where}: so say {listed(agree) or 'none alone'}"
    if others:
        sentence += "; " + ", ".join(f"{listed(names)} would have it in the {sub}" for sub, names in others.items())
    return sentence
