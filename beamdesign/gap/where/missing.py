"""What each equation lacks: the unknown input that explains the residual, and how much of it is a local law.

With one independent output the unknown signal of any one equation can explain the residual; what tells equations apart
is whether that signal is a simple function of the equation's own variables, the same in every record. So terms of local
variables go through the linear rig to the channels, are weighed as the residual is, and are chosen one by one per
subsystem beside the tolerated figures; conditions held out of the regression say how much they explain.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from beamdesign.gap.fitting.fit import Fit
from beamdesign.gap.fitting.hypothesis import WRONG, subsystem
from beamdesign.gap.where.local_laws import Term, terms
from beamdesign.gap.where.residuals import Residual
from beamdesign.parameters import RIG_TOLERANCES

_LOOPED = (
    "sensor_V",
    "current_A",
    "demanded_A",
    "metered_m3_per_s",
    "stroke_m",
    "stroke_m_per_s",
    "outer_m",
    "inner_m",
    "cylinder_force_N",
)
_LEVELS = 6
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


def levels(found: Sequence[Residual]) -> dict[str, np.ndarray]:
    """Sizes of local signals, from below what the quietest record reaches to what the largest does."""
    signals = [item.nominal() for item in found]
    rms = {name: [float(np.sqrt(np.mean(s[name] ** 2))) for s in signals] for name in _LOOPED}
    return {
        name: np.geomspace(0.3 * min(sizes) + 1e-15, 2.0 * max(sizes) + 1e-14, _LEVELS) for name, sizes in rms.items()
    }


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
    groups: tuple[tuple[int, ...], ...]
    terms: tuple[tuple[str, str, str], ...]

    @cached_property
    def _whole(self) -> tuple[np.ndarray, np.ndarray]:
        """Sums over all records."""
        return self.gram.sum(0), self.right.sum(0)

    def held_out(self, columns: Sequence[int]) -> float:
        """Misfit of each condition as predicted from all others with the tolerated figures and these terms."""
        total = 0.0
        for group in self.groups:
            out = list(group)
            theta = self._solved(self._whole[0] - self.gram[out].sum(0), self._rest(out), columns)
            total += self._misfit(out, theta, columns)
        return total

    def fitted(self, columns: Sequence[int]) -> float:
        """Misfit of all records and of the prior, fitted to all."""
        theta = self._solved(self._whole[0], self._whole[1], columns)
        k = self.tolerated
        return self._misfit(list(range(len(self.left))), theta, columns) + float(
            np.sum((self.start + theta[:k]) ** 2) - np.sum(self.start**2)
        )

    def _rest(self, out: list[int]) -> np.ndarray:
        return np.asarray(self._whole[1] - self.right[out].sum(0))

    def _chosen(self, columns: Sequence[int]) -> np.ndarray:
        return np.array([*range(self.tolerated), *columns])

    def _solved(self, gram: np.ndarray, right: np.ndarray, columns: Sequence[int]) -> np.ndarray:
        at, k = self._chosen(columns), self.tolerated
        a, b = gram[np.ix_(at, at)].copy(), right[at].copy()
        a[np.arange(len(at)), np.arange(len(at))] += np.where(
            np.arange(len(at)) < k, 1.0, _RIDGE * self._whole[0][at, at] + 1e-12
        )
        b[:k] -= self.start
        return np.asarray(np.linalg.solve(a, b))

    def _misfit(self, records: list[int], theta: np.ndarray, columns: Sequence[int]) -> float:
        at = self._chosen(columns)
        whole = len(records) == len(self.left)
        gram, right = self._whole if whole else (self.gram[records].sum(0), self.right[records].sum(0))
        a, b = gram[np.ix_(at, at)], right[at]
        return float(self.left[records].sum() - 2 * theta @ b + theta @ a @ theta)


def regression(found: Sequence[Residual], null: Fit, corrected: bool = False) -> Regression:
    """Set up the normal equations.

    Args:
        found: residuals about a fit of the tolerated figures.
        null: that fit.
        corrected: whether local variables are smoothed by the record, or those of the nominal model.
    """
    dictionary = terms(levels(found))
    order = sorted(range(len(dictionary)), key=lambda k: dictionary[k].entry)
    dictionary = tuple(dictionary[k] for k in order)
    used = sorted({term.entry for term in dictionary})
    grams, rights, lefts, expected = [], [], [], 0.0
    for item in found:
        parts = [-item.evidence.weight(-item.slopes)]
        signals = item.smoothed() if corrected else item.nominal()
        parts += [_columns(item, entry, [t for t in dictionary if t.entry == entry], signals) for entry in used]
        matrix = np.hstack(parts)
        left = item.evidence.weight(item.left)
        grams.append(matrix.T @ matrix)
        rights.append(matrix.T @ left)
        lefts.append(float(left @ left))
        expected += item.evidence.expected
    groups: dict[object, list[int]] = {}
    for k, item in enumerate(found):
        groups.setdefault(item.evidence.condition, []).append(k)
    gram, right, tolerated = np.array(grams), np.array(rights), len(null.z)
    scale = np.sqrt(np.einsum("rpp->p", gram)) + 1e-300
    scale[:tolerated] = 1.0
    # A figure of the rig that is wrong by more than its tolerance is the same column without its prior.
    figures = [WRONG + RIG_TOLERANCES[u.name] for u in null.unknowns]
    wrong = [(name, subsystem(name), "linear") for name in figures]
    own = [(t.words, t.subsystem, t.kind) for t in dictionary]
    again = np.concatenate([np.arange(gram.shape[1]), np.arange(tolerated)])
    gram = (gram / scale / scale[:, None])[:, again][:, :, again]
    right = (right / scale)[:, again]
    start = np.asarray(null.z, dtype=float)
    indices = tuple(tuple(g) for g in groups.values())
    return Regression(gram, right, np.array(lefts), expected, tolerated, start, indices, (*own, *wrong))


def _columns(item: Residual, entry: str, chosen: Sequence[Term], signals: Mapping[str, np.ndarray]) -> np.ndarray:
    """(M, len(chosen)) what terms at one entry do to the weighed channels."""
    probed = item.probe
    waves = []
    for term in chosen:
        if term.kind == "linear":
            waves.append(probed.spectrum(signals[term.signals[0]]) * term.law(probed.laplace))
        else:
            waves.append(probed.spectrum(term.law(*(signals[name] for name in term.signals))))
    through = probed.entry(entry, item.channels)
    spectra = through[:, :, None] * np.array(waves).T[:, None, :]
    return item.evidence.weight(probed.signal(spectra))


def explanations(found: Regression, most: int = 4, least_gain: float = 0.01) -> tuple[Explanation, ...]:
    """Every subsystem's explanation, best first: terms taken one by one while held-out conditions gain by them.

    Args:
        found: the normal equations.
        most: terms.
        least_gain: of the share, for one term more.
    """
    nothing = found.held_out(())
    gap = max(nothing - found.expected, 1e-9)
    results = []
    for name in dict.fromkeys(term[1] for term in found.terms):
        own = [found.tolerated + k for k, term in enumerate(found.terms) if term[1] == name]
        chosen: list[int] = []
        reached = 0.0
        for _ in range(most):
            rest = (k for k in own if k not in chosen)
            best = min(rest, key=lambda k: found.fitted([*chosen, k]), default=None)
            if best is None:
                break
            share = (nothing - found.held_out([*chosen, best])) / gap
            if share < reached + least_gain:
                break
            chosen.append(best)
            reached = share
        picked = [found.terms[k - found.tolerated] for k in chosen]
        results.append(Explanation(name, reached, tuple(p[0] for p in picked), tuple(p[2] for p in picked)))
    return tuple(sorted(results, key=lambda e: -e.share))
