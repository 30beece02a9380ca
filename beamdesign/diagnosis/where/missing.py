"""What each equation lacks, and how much of it is a law of the equation's own local variables.

With one independent output the unknown signal of any one equation can explain the residual; what tells equations apart
is whether that signal is a simple function of the equation's own variables, the same in every record. So terms of local
variables go through the linear rig to the channels, are weighed as the residual is, and are chosen one by one per
subsystem beside the tolerated figures; conditions held out of the regression say how much they explain.

The dictionary of terms is no library of effects. It holds what a law can do to a signal: filter it, bend it, cut it,
lag behind it by a loop, lean on a neighbour. Each entry is one column of a regression, so amplitudes are found, not
given; what has a scale of its own (the width of a loop, a break frequency) stands there at several.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.hypothesis import WRONG, subsystem
from beamdesign.diagnosis.judgement import pieces_of
from beamdesign.diagnosis.where.residuals import Places, Residual
from beamdesign.parameters import RIG_TOLERANCES
from beamdesign.plant.assembly import pace
from beamdesign.plant.compiled import as_machine_code
from beamdesign.structure.lumped import figures
from beamdesign.time_limit import heed

Law = Callable[..., np.ndarray]
Levels = Callable[[str], np.ndarray]


@dataclass(frozen=True)
class Term:
    """One thing that an equation may lack.

    Attributes:
        words: for people.
        subsystem: that it speaks for.
        entry: of `probe.ENTRIES`, where it comes in.
        signals: local ones that it needs, by name.
        law: of these signals (N,) in time; where `linear`, the factor on the spectrum of the only one, of s (F,).
        kind: `linear`, `static` or `hysteretic`.
    """

    words: str
    subsystem: str
    entry: str
    signals: tuple[str, ...]
    law: Law
    kind: str = "static"


def terms(levels: Levels, at: Places, pace: float, step: float) -> tuple[Term, ...]:
    """All terms that a rig has.

    Args:
        levels: of a signal by its name, the sizes at which laws of one scale are tried, in its unit.
        at: where there may be terms, and the signals that there are.
        pace: how many times as quick as the published rig it is, see `beamdesign.plant.assembly.pace`: so many times
            as high are the frequencies that are tried, and so many times as short the times.
        step: sampling interval of the signals, s.
    """
    known = {*at.signals, "pressure_rate_Pa_per_s", "stroke_m"}
    if "load_pressure_Pa" not in at.signals:
        known -= {"pressure_rate_Pa_per_s"}
    return tuple(one for one in _terms(levels, pace, step) if one.entry in at.entries and known.issuperset(one.signals))


def _terms(levels: Levels, pace: float, step: float) -> tuple[Term, ...]:
    def hertz(*published: float) -> list[float]:
        return [pace * frequency for frequency in published]

    def times(*published: float) -> list[float]:
        return [time / pace for time in published]

    sensor, late, amplifier = ("sensor", "sensor"), ("controller", "sensor"), ("amplifier", "amplifier")
    volts, asked = ("sensor_V",), ("demanded_A",)
    spool, valve = ("servovalve", "spool"), ("servovalve", "oil continuity")
    current, flow, pressure = ("current_A",), ("metered_m3_per_s",), ("load_pressure_Pa",)
    seal, sides, oil = ("actuator", "piston force"), ("actuator", "oil continuity"), ("oil", "oil continuity")
    speed, rate = ("stroke_m_per_s",), ("pressure_rate_Pa_per_s",)
    drive, turned = ("amplifier", "drive"), ("motor_demand_A",)
    mount, joint, force = ("structure", "mount"), ("structure", "joint"), ("actuator_force_N",)
    middle = levels("stroke_m_per_s")[2]
    return (
        *_each("sensor lags, {:.0f} Hz", sensor, volts, hertz(30, 60, 120, 250, 500, 1000), _low_pass, "linear"),
        Term("sensor bends, V|V|", *sensor, volts, lambda v: v * np.abs(v)),
        Term("sensor bends, V^3", *sensor, volts, lambda v: v**3),
        Term("sensor bends one way, V^2", *sensor, volts, lambda v: v**2),
        Term("sensor differs by sign, |V|", *sensor, volts, np.abs),
        *_loops("sensor", sensor, volts, levels),
        *_each("signal comes {:g} ms late", late, volts, times(0.3, 0.6, 1.2, 2.4, 4.8), _late, "linear"),
        *_each("current cut at {:.2g}", amplifier, asked, levels("demanded_A"), _cut),
        *_each("amplifier lags, {:.0f} Hz", amplifier, asked, hertz(50, 100, 200, 400, 800), _low_pass, "linear"),
        Term("gain of the amplifier", *amplifier, asked, np.ones_like, "linear"),
        Term("amplifier bends, i^3", *amplifier, asked, lambda i: i**3),
        Term("amplifier differs by sign", *amplifier, asked, np.abs),
        *_each("spool lags, {:.0f} Hz", spool, current, hertz(50, 100, 200, 400, 800), _low_pass, "linear"),
        *_loops("spool", spool, current, levels),
        *_each("motor's current cut at {:.2g}", drive, turned, levels("motor_demand_A"), _cut),
        *_each("drive lags, {:.0f} Hz", drive, turned, hertz(50, 100, 200, 400, 800), _low_pass, "linear"),
        *_each("flow cut at {:.2g}", valve, flow, levels("metered_m3_per_s"), _cut),
        Term("flow bends, Q|Q|", *valve, flow, lambda q: q * np.abs(q)),
        Term("flow bends, Q^3", *valve, flow, lambda q: q**3),
        Term("flow goes with pressure, |Q| p", *valve, flow + pressure, lambda q, p: np.abs(q) * p),
        Term("flow goes with pressure, Q p^2", *valve, flow + pressure, lambda q, p: q * p**2),
        Term("flow goes with pressure, Q p", *valve, flow + pressure, lambda q, p: q * p),
        Term("leakage bends, p|p|", *valve, pressure, lambda p: p * np.abs(p)),
        Term("leakage bends, p^2", *valve, pressure, lambda p: p**2),
        *_each("supply droops over {:g} s", valve, flow, times(0.02, 0.1, 0.5), partial(_droop, step)),
        *_loops("seal", seal, ("stroke_m",), levels),
        *_each("friction turns over within {:.2g} m/s", seal, speed, levels("stroke_m_per_s"), _slide),
        Term("friction goes with pressure", *seal, speed + pressure, lambda v, p: _slide(middle, v) * np.abs(p)),
        Term("friction, speed squared", *seal, speed, lambda v: v * np.abs(v)),
        Term("viscous friction", *seal, speed, np.ones_like, "linear"),
        Term("sides differ, |speed|", *sides, speed, np.abs),
        Term("sides differ, |flow|", *sides, flow, np.abs),
        Term("force differs by sign, |p|", *seal, pressure, np.abs),
        Term("oil gives way", *oil, rate, np.ones_like, "linear"),
        *_each("oil lags, {:.0f} Hz", oil, rate, hertz(20, 60, 200), _low_pass, "linear"),
        Term("oil gives way with pressure, p' p", *oil, pressure + rate, lambda p, r: p * r),
        Term("oil gives way with pressure, p' |p|", *oil, pressure + rate, lambda p, r: np.abs(p) * r),
        Term("oil gives way with pressure, p' p^2", *oil, pressure + rate, lambda p, r: p**2 * r),
        *_beam("outer", levels, pace),
        *_beam("inner", levels, pace),
        *_resonances("mount", mount, ("mount_force_N",), 0, pace),
        *_each("force in the joint cut at {:.2g}", joint, force, levels("actuator_force_N"), _cut),
        Term("joint gives way", *joint, force, np.ones_like, "linear"),
    )


def _beam(name: str, levels: Levels, pace: float) -> Iterable[Term]:
    of, tip, beam = ("structure", f"{name} beam"), (f"{name}_m",), f"{name} beam"
    yield from _resonances(beam, of, tip, 2, pace)
    yield Term(f"{beam} bends, x^3", *of, tip, lambda x: x**3)
    yield Term(f"{beam} bends, x|x|", *of, tip, lambda x: x * np.abs(x))
    yield Term(f"{beam} differs by sign, |x|", *of, tip, np.abs)
    yield from _loops(beam, of, tip, levels)


def _each(
    words: str, of: tuple[str, str], signals: tuple[str, ...], scales: Iterable[float], law: Law, kind: str = "static"
) -> list[Term]:
    """One term per scale of a law, which is its first argument."""
    return [Term(words.format(scale), *of, signals, partial(law, scale), kind) for scale in scales]


def _loops(words: str, of: tuple[str, str], signals: tuple[str], levels: Levels) -> list[Term]:
    return _each(f"loop in {words} of half width {{:.2g}}", of, signals, levels(signals[0]), stop, "hysteretic")


def _resonances(words: str, of: tuple[str, str], signals: tuple[str], order: int, pace: float) -> list[Term]:
    law = partial(_resonance, order)
    return _each(f"{words} resonates at {{:.0f}} Hz", of, signals, pace * np.geomspace(25, 600, 14), law, "linear")


def _low_pass(hz: float, s: np.ndarray) -> np.ndarray:
    return np.asarray(1 / (1 + s / (2 * np.pi * hz)) - 1)


def _late(milliseconds: float, s: np.ndarray) -> np.ndarray:
    return np.asarray(np.exp(-s * (milliseconds / 1e3)) - 1)


def _resonance(order: int, hz: float, s: np.ndarray) -> np.ndarray:
    w = 2 * np.pi * hz
    return np.asarray(s**order * w**2 / (s**2 + 0.1 * w * s + w**2))


def _cut(level: float, signal: np.ndarray) -> np.ndarray:
    return np.clip(signal, -level, level)


def _slide(level: float, speed: np.ndarray) -> np.ndarray:
    return np.asarray(np.tanh(speed / level))


def _droop(step: float, tau: float, flow: np.ndarray) -> np.ndarray:
    """Flow times its size as smoothed over `tau`; regression finds the scale."""
    from scipy.signal import lfilter

    keep = np.exp(-step / tau)
    return np.asarray(flow * lfilter([1 - keep], [1, -keep], np.abs(flow)))


def stop(width: float, signal: np.ndarray) -> np.ndarray:
    """Stop operator: follows the signal's changes, within plus and minus `width` (Prandtl's element).

    Args:
        width: in the signal's unit.
        signal: (N,) that begins at its rest.
    """
    return np.asarray(_stop(np.ascontiguousarray(signal, dtype=float), float(width)))


@as_machine_code
def _stop(signal: np.ndarray, width: float) -> np.ndarray:
    """One loop over samples that cannot be vectorised."""
    out = np.empty_like(signal)
    held = 0.0
    before = signal[0]
    for k in range(len(signal)):
        held = min(max(held + signal[k] - before, -width), width)
        before = signal[k]
        out[k] = held
    return out


_LEVELS, _NONE = 6, np.zeros(1)
_RIDGE = 1e-6  # of a column's own size


@dataclass(frozen=True)
class Explanation:
    """How far one subsystem's own laws explain the residual.

    Attributes:
        subsystem: whose.
        share: of the excess misfit in held-out conditions, from 0 (or below) to 1.
        terms: chosen, in words.
        kinds: of each.
    """

    subsystem: str
    share: float
    terms: tuple[str, ...]
    kinds: tuple[str, ...]


def levels(found: Sequence[Residual], name: str) -> np.ndarray:
    """Sizes of a local signal, from below what the quietest record reaches to what the largest does."""
    sizes = [float(np.sqrt(np.mean(item.nominal.get(name, _NONE) ** 2))) for item in found]
    return np.geomspace(0.3 * min(sizes) + 1e-15, 2.0 * max(sizes) + 1e-14, _LEVELS)


@dataclass(frozen=True)
class Regression:
    """Normal equations of a residual in all terms, one set per record.

    Attributes:
        gram: (R, P, P) of all columns: tolerated figures, then terms.
        right: (R, P).
        left: (R,) misfit of each residual.
        expected: misfit that noise leaves.
        tolerated: how many columns are those of tolerated figures.
        start: (K,) z of the tolerated figures about which the residual was taken.
        groups: records of each condition.
        terms: of the further columns: words, subsystem, kind.
    """

    gram: np.ndarray = field(repr=False)
    right: np.ndarray = field(repr=False)
    left: np.ndarray
    expected: float
    tolerated: int
    start: np.ndarray
    groups: list[list[int]]
    terms: tuple[tuple[str, str, str], ...]

    @cached_property
    def _whole(self) -> tuple[np.ndarray, np.ndarray]:
        """Sums over all records."""
        return self.gram.sum(0), self.right.sum(0)

    def held_out(self, columns: Sequence[int]) -> float:
        """Misfit of each condition as predicted from all others with the tolerated figures and these terms."""
        total = 0.0
        for out in self.groups:
            gram, right = self.gram[out].sum(0), self.right[out].sum(0)
            theta = self._solved(self._whole[0] - gram, self._whole[1] - right, columns)
            total += self._misfit(gram, right, self.left[out], theta, columns)
        return total

    def fitted(self, columns: Sequence[int]) -> float:
        """Misfit of all records and of the prior, fitted to all."""
        theta = self._solved(*self._whole, columns)
        prior = np.sum((self.start + theta[: self.tolerated]) ** 2) - np.sum(self.start**2)
        return self._misfit(*self._whole, self.left, theta, columns) + float(prior)

    def _chosen(self, columns: Sequence[int]) -> np.ndarray:
        return np.array([*range(self.tolerated), *columns])

    def _solved(self, gram: np.ndarray, right: np.ndarray, columns: Sequence[int]) -> np.ndarray:
        at, k = self._chosen(columns), self.tolerated
        a, b = gram[np.ix_(at, at)].copy(), right[at].copy()
        a += np.diag(np.where(np.arange(len(at)) < k, 1.0, _RIDGE * self._whole[0][at, at] + 1e-12))
        b[:k] -= self.start
        return np.asarray(np.linalg.solve(a, b))

    def _misfit(
        self, gram: np.ndarray, right: np.ndarray, left: np.ndarray, theta: np.ndarray, columns: Sequence[int]
    ) -> float:
        at = self._chosen(columns)
        return float(left.sum() - 2 * theta @ right[at] + theta @ gram[np.ix_(at, at)] @ theta)


def regression(found: Sequence[Residual], null: Fit, corrected: bool = False) -> Regression:
    """Set up the normal equations.

    Args:
        found: residuals about a fit of the tolerated figures.
        null: that fit.
        corrected: whether local variables are smoothed by the record, or those of the nominal model.
    """
    quick = pace(figures(found[0].evidence.job.prototype))
    grams, rights, lefts, expected = [], [], [], 0.0
    for item in found:
        heed()
        given = partial(levels, found), item.probe.at, quick, item.evidence.record.step
        dictionary = sorted(terms(*given), key=lambda term: term.entry)
        used = sorted({term.entry for term in dictionary})
        parts = [-item.evidence.weight(-item.slopes)]
        signals = item.smoothed() if corrected else item.nominal
        parts += [_columns(item, entry, [t for t in dictionary if t.entry == entry], signals) for entry in used]
        matrix = np.hstack(parts)
        left = item.evidence.weight(item.left)
        grams.append(matrix.T @ matrix)
        rights.append(matrix.T @ left)
        lefts.append(float(left @ left))
        expected += item.evidence.expected
    gram, right, tolerated = np.array(grams), np.array(rights), len(null.z)
    scale = np.sqrt(np.einsum("rpp->p", gram)) + 1e-300
    scale[:tolerated] = 1.0
    # A figure of the rig that is wrong by more than its tolerance is the same column without its prior.
    names = [WRONG + RIG_TOLERANCES[u.name] for u in null.unknowns]
    wrong = [(name, subsystem(name), "linear") for name in names]
    own = [(t.words, t.subsystem, t.kind) for t in dictionary]
    again = np.concatenate([np.arange(gram.shape[1]), np.arange(tolerated)])
    gram = (gram / scale / scale[:, None])[:, again][:, :, again]
    right = (right / scale)[:, again]
    start = np.asarray(null.z, dtype=float)
    groups = pieces_of([item.evidence.condition for item in found])
    return Regression(gram, right, np.array(lefts), expected, tolerated, start, groups, (*own, *wrong))


def _columns(item: Residual, entry: str, chosen: Sequence[Term], signals: Mapping[str, np.ndarray]) -> np.ndarray:
    """(M, len(chosen)) what terms at one entry do to the weighed channels."""
    probed = item.probe
    own = {name: probed.spectrum(signals[name]) for name in {t.signals[0] for t in chosen if t.kind == "linear"}}
    waves = []
    for term in chosen:
        if term.kind == "linear":
            waves.append(own[term.signals[0]] * term.law(probed.laplace))
        else:
            waves.append(probed.spectrum(term.law(*(signals[name] for name in term.signals))))
    through = probed.entry(entry, item.channels)
    spectra = through[:, :, None] * np.array(waves).T[:, None, :]
    return item.evidence.weight(probed.signal(spectra))


_MOST, _LEAST_GAIN = 4, 0.01  # terms; of the share, for one term more


def explanations(found: Regression) -> tuple[Explanation, ...]:
    """Every subsystem's explanation, best first: terms taken one by one while held-out conditions gain by them."""
    nothing = found.held_out(())
    gap = max(nothing - found.expected, 1e-9)
    results = []
    for name in dict.fromkeys(term[1] for term in found.terms):
        own = [found.tolerated + k for k, term in enumerate(found.terms) if term[1] == name]
        chosen: list[int] = []
        reached = 0.0
        for _ in range(_MOST):
            rest = (k for k in own if k not in chosen)
            best = min(rest, key=lambda k: found.fitted([*chosen, k]), default=None)
            if best is None:
                break
            share = (nothing - found.held_out([*chosen, best])) / gap
            if share < reached + _LEAST_GAIN:
                break
            chosen.append(best)
            reached = share
        picked = [found.terms[k - found.tolerated] for k in chosen]
        results.append(Explanation(name, reached, tuple(p[0] for p in picked), tuple(p[2] for p in picked)))
    return tuple(sorted(results, key=lambda e: -e.share))
