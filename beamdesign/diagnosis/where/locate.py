"""Where a gap lies: what the fits say, what the laws of each equation say, and a sentence that weighs both.

A gap is told to be linear, static, hysteretic or drifting; and under which conditions, at which frequencies and in
which direction it shows.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations, pairwise
from math import isnan

import casadi as ca
import numpy as np

from beamdesign.diagnosis.diagnosis import Cause, Indicator, Where, in_words, listed
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.hypothesis import ABSENT, WRONG
from beamdesign.diagnosis.fitting.search import Search
from beamdesign.diagnosis.where.missing import Explanation, explanations, regression
from beamdesign.diagnosis.where.residuals import Residual, residuals
from beamdesign.plant.assembly import RIGS, Structure, assemble, fits, widened
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
    by = f" ({', '.join(lead.terms)})" if lead.terms else ""
    rest = ", ".join(f"{e.subsystem} {max(e.share, 0.0):.0%}" for e in laws[1:3])
    text = f"Laws of the {lead.subsystem} explain {lead.share:.0%} of the gap in held-out conditions{by}; next {rest}."
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
    return "static" if any(ca.which_depends(ca.vec(slopes), ca.vertcat(x, u), 1, True)) else "linear"


_ALIKE = 0.05  # shares
NO_GAP = Where("", (0.0, 0.0), "", sentence="Tolerances leave no gap to place.")


def locate(
    search: Search, chosen: Fit, evidence: Sequence[object], causes: Sequence[Cause] = (), unknown: float = 0.0
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
    by_signals = (explanations(regression(found, null, corrected)) for corrected in (False, True))
    plain, smooth = ({e.subsystem: e for e in laws} for laws in by_signals)
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


_BANDS_HZ = (0.2, 2.0, 5.0, 10.0, 20.0, 35.0, 60.0, 100.0, 200.0, 400.0)
_MOST = 0.7  # of the misfit: what the band that is named holds
_EXCITED = 0.03  # of the strongest line
_FEWEST = 5
_DENSE = 0.7
_SLOW_HZ = 1.0
_TWICE = 2.0
_LITTLE = 0.1  # of the power
_DRIFT = 0.5  # of the residual's power
_BENT = 0.3  # of the residual's power away from the lines of the input


def lines_of(
    drive: np.ndarray, response: np.ndarray, residual: np.ndarray, noise_std: float
) -> tuple[float, float] | None:
    """Tell linear errors from distortion by the lines of a periodic input.

    R. Pintelon and J. Schoukens, System Identification: A Frequency Domain Approach (2012), chapter 4.

    Args:
        drive: (N,) input over whole periods.
        response: (N,) to it.
        residual: (N,) of the response.
        noise_std: white, of the response.

    Returns:
        levels of the residual relative to the response: at lines that the input holds, where linear and odd errors are,
        and at lines of its grid that it does not hold, which only what is not linear reaches (noise is taken out). None
        where the input has no lines: its spectrum is dense, or it does not repeat.
    """
    count = len(drive)
    power = np.abs(np.fft.rfft(drive)) ** 2
    held = np.nonzero(power > _EXCITED * power[1:].max())[0] if power[1:].max() > 0 else np.arange(0)
    held = held[held > 0]
    if len(held) < _FEWEST or len(held) > _DENSE * (held[-1] - held[0] + 1):
        return None
    inside = np.arange(held[0], min(3 * held[-1], count // 2))
    # A transform without a window leaks from a line to its neighbours where the record is no whole period.
    beside = (-1, 0, 1) if np.diff(held).min() > 2 else (0,)
    free = np.setdiff1d(inside, np.concatenate([held + k for k in beside]))
    left, whole = np.abs(np.fft.rfft(residual)) ** 2, float(np.sum(np.abs(np.fft.rfft(response)[held]) ** 2))
    noise = noise_std**2 * count

    def level(at: np.ndarray) -> float:
        return float(np.sqrt(max(np.sum(left[at] - noise), 0.0) / whole)) if len(at) else np.nan

    return level(held), level(free)


def setting(found: Sequence[Residual]) -> Where:
    """Look at the residuals of all records by frequency, size, payload, input and direction.

    Returns:
        band, condition and kind, the place open; and what tells them, with a map of the weighted misfit by record,
        condition and band. A gap drifts of which most is slower than 1 Hz and than any input; else it is static or
        linear by how much of it lies away from the lines of the input, where any record has lines.
    """
    low, high = widened(found[0].evidence.job.prototype, _BANDS_HZ[0], _BANDS_HZ[-1])
    edges = np.array([low, *np.array(_BANDS_HZ[1:]) * high / _BANDS_HZ[-1]])
    units, noise = (np.array(parts) for parts in zip(*(_by_band(item, edges) for item in found), strict=True))
    band = _narrowest(np.maximum(units - noise, 0.0).sum(0), edges)
    relative = [_relative(item) for item in found]
    distortions, asymmetries, slow = [], [], []
    for item in found:
        record, weight, column = item.evidence.record, item.evidence.weight, item.evidence.column
        drive = record.inputs[:, 1 if driven_by(item) == "command" else 0]
        shaped = item.left[:, column] * weight.fade
        measured = record.measured["displacement_m"]
        seen = lines_of(drive, measured, shaped, float(weight.noise_std[column]))
        if seen is not None and sum(seen) > 0:
            distortions.append(seen[1] ** 2 / (seen[1] ** 2 + seen[0] ** 2))
        parts = [shaped[measured * sign > 0] for sign in (1, -1)]
        sides = [float(np.sqrt(np.sum(part**2) / max(len(part), 1))) for part in parts]
        asymmetries.append(abs(sides[0] - sides[1]) / max(sum(sides) / 2, 1e-300))
        slow.append(_slow(drive, shaped, record.step))
    names = tuple(f"{low:g}-{high:g} Hz" for low, high in pairwise(edges))
    taken, conditions = tuple(item.evidence.name for item in found), tuple(map(words_of, found))
    table: dict[str, tuple[object, ...]] = {"record": taken, "condition": conditions, "relative_error": tuple(relative)}
    table |= {name: tuple(float(v) for v in units[:, k]) for k, name in enumerate(names)}
    sizes = ((distortions, np.nan), (asymmetries, 0.0), (slow, 0.0))
    distortion, asymmetry, slowness = (float(np.median(some)) if some else none for some, none in sizes)
    condition = _condition(found, relative)
    text = f"Most of the misfit is between {band[0]:g} and {band[1]:g} Hz; the relative error is {condition}; "
    text += "" if isnan(distortion) else f"{distortion:.0%} of it lies away from the lines of the input; "
    text += f"it differs by {asymmetry:.0%} between the two directions. "
    text += "Figures by record and band are the misfit as fits weigh it, a sum of squares, noise included."
    indicator = Indicator("bands and conditions", "", 0.0, text, table)
    bent = "" if isnan(distortion) else "static" if distortion > _BENT else "linear"
    return Where("", band, condition, "drifting" if slowness > _DRIFT else bent, (indicator,))


def words_of(item: Residual) -> str:
    """A record's condition in words."""
    record = item.evidence.record
    mass = f"{record.outer_end_mass:g} kg payload" if record.outer_end_mass > 0 else "no payload"
    by = driven_by(item)
    column, unit = (1, "V") if by == "command" else (0, "N")
    return f"{by}, {float(np.std(record.inputs[:, column])):.3g} {unit} rms, {mass}"


def driven_by(item: Residual) -> str:
    """Which input makes the displacement: `command` or `disturbance` where the other makes less than a tenth of it.

    Of the linear model's response; a force sensor's noise so drives nothing.
    """
    spectrum = item.probe.spectrum(item.evidence.record.inputs)
    through = item.probe.response[:, item.probe.rows(["displacement_m"])[0], :2]
    force, command = (float(np.sum(np.abs(through[:, k] * spectrum[:, k]) ** 2)) for k in (0, 1))
    if max(force, command) <= 0:
        return "none"
    if force < _LITTLE * command:
        return "command"
    return "disturbance" if command < _LITTLE * force else "both"


def _by_band(item: Residual, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Misfit of the displacement per band, and what noise alone leaves of it."""
    weight, column = item.evidence.weight, item.evidence.column
    lines = weight(item.left).reshape(2, -1, len(item.channels))[:, :, column]
    noise = (weight.scale[column] * weight.noise_std[column]) ** 2 * len(item.left)
    powers = np.sum(lines**2, axis=0), noise
    misfit, expected = (np.histogram(weight.frequencies_Hz, edges, weights=power)[0] for power in powers)
    return misfit, expected


def _relative(item: Residual) -> float:
    """Rms error of the displacement over its rms, noise taken out."""
    column, noise = item.evidence.column, item.evidence.weight.noise_std
    left = float(np.mean(item.left[:, column] ** 2)) - float(noise[column]) ** 2
    power = float(np.var(item.evidence.record.measured["displacement_m"]))
    return float(np.sqrt(max(left, 0.0) / power)) if power > 0 else 0.0


def _narrowest(totals: np.ndarray, edges: np.ndarray) -> tuple[float, float]:
    """Fewest neighbouring bands (in octaves) that hold most of the misfit."""
    whole = float(totals.sum())
    if whole <= 0:
        return float(edges[0]), float(edges[-1])
    enough = ((i, j) for i, j in combinations(range(len(edges)), 2) if totals[i:j].sum() >= _MOST * whole)
    _, i, j = min((np.log2(edges[j] / edges[i]), i, j) for i, j in enough)
    return float(edges[i]), float(edges[j])


def _condition(found: Sequence[Residual], relative: Sequence[float]) -> str:
    """What makes the relative error of records at least twice as large, all else alike as far as can be."""
    records, driven = [item.evidence.record for item in found], [driven_by(item) for item in found]
    loaded = [k for k, r in enumerate(records) if r.outer_end_mass > 0]
    bare = [k for k in range(len(records)) if k not in loaded]
    commanded, forced = ([k for k in bare if driven[k] == by] for by in ("command", "disturbance"))
    large, small = list[int](), list[int]()
    for group, column in ((commanded, 1), (forced, 0)):
        sizes = {k: float(np.std(records[k].inputs[:, column])) for k in group}
        if sizes and max(sizes.values()) > _TWICE * min(sizes.values()):
            large.append(max(sizes, key=lambda k: sizes[k]))
            small.append(min(sizes, key=lambda k: sizes[k]))
    said = []
    for name, opposite, *groups in (
        ("with payload", "without payload", loaded, bare),
        ("under command", "under disturbance", commanded, forced),
        ("at large amplitude", "at small amplitude", large, small),
    ):
        if not all(groups):
            continue
        one, other = (float(np.sqrt(np.mean([relative[k] ** 2 for k in group]))) for group in groups)
        ratio = one / max(other, 1e-9)
        if ratio >= _TWICE:
            said.append(f"{name} ({ratio:.1f} times)")
        elif ratio <= 1 / _TWICE:
            said.append(f"{opposite} ({1 / max(ratio, 1e-3):.1f} times)")
    return "most " + ", ".join(said) if said else "alike under all conditions measured"


def _slow(drive: np.ndarray, residual: np.ndarray, step: float) -> float:
    """Share of the residual's power that is slower than both 1 Hz and anything that drives the rig."""
    hz = np.fft.rfftfreq(len(drive), step)
    power, driven = np.abs(np.fft.rfft(residual)) ** 2, np.abs(np.fft.rfft(drive)) ** 2
    at = (hz < _SLOW_HZ) & (driven < 1e-3 * driven.max())
    return float(power[at].sum() / max(power.sum(), 1e-300))
