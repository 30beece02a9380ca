"""Innovations of a Kalman filter on the nominal rig, and the equation whose own noise explains them best.

One equation at a time is given a random input of unknown intensity (first-order noise up to `_BAND_HZ`); the filter
that knows of it leaves innovations whose likelihood is compared with those of the model without any. B. D. O. Anderson
and J. B. Moore, Optimal Filtering (1979), chapters 4 and 10.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from beamdesign.gap.fitting.hypothesis import NOTHING
from beamdesign.gap.where.probe import ENTRIES, SIGNALS, entry_columns, state_space
from beamdesign.gap.where.residuals import OWN, Residual, banded
from beamdesign.prototype import Prototype

_BAND_HZ = 100.0
_INTENSITIES = np.geomspace(0.01, 1.0, 4)
"""Rms of the random input over that of the equation's own variable in the largest record."""

Matrices = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Filter:
    """A steady-state Kalman filter of one output in discrete time, x+ = A x, y = C x + v.

    Attributes:
        a: (n, n).
        c: (n,).
        gain: (n,) of the filter, applied before the step in time.
        variance: of the innovations.
    """

    a: np.ndarray = field(repr=False)
    c: np.ndarray = field(repr=False)
    gain: np.ndarray = field(repr=False)
    variance: float

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        """(N,) innovations of a measured less predicted output (N,) that begins at rest."""
        from scipy.signal import sosfilt

        return np.asarray(sosfilt(self._sections, residual))

    @cached_property
    def _sections(self) -> np.ndarray:
        """Innovations over residual, det(z - A) / det(z - A + A K C), both monic and of one degree."""
        from scipy.signal import zpk2sos

        zeros = np.linalg.eigvals(self.a)
        poles = np.linalg.eigvals(self.a - np.outer(self.a @ self.gain, self.c))
        return np.asarray(zpk2sos(zeros, poles, 1.0))


class Unsolved(ArithmeticError):
    """There is no filter: its Riccati equation was not solved."""


def kalman(a: np.ndarray, noise: np.ndarray, c: np.ndarray, variance: float) -> Filter:
    """Steady-state filter of x+ = A x + w, y = c x + v.

    Args:
        a: (n, n), stable.
        noise: (n, n) covariance of w.
        c: (n,).
        variance: of v.

    Raises:
        Unsolved: where the Riccati equation is too ill-conditioned to be solved.
    """
    from scipy.linalg import solve_discrete_are

    try:
        p = solve_discrete_are(a.T, c[:, None], noise, np.array([[variance]]))
    except (ValueError, np.linalg.LinAlgError) as error:
        raise Unsolved(str(error)) from error
    s = float(c @ p @ c + variance)
    return Filter(a, c, p @ c / s, s)


def sampled(a: np.ndarray, b: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """exp(A step) and the covariance that white noise of unit intensity through b (n,) has after one step.

    C. F. Van Loan, IEEE Trans. Automatic Control 23 (1978) 395.
    """
    from scipy.linalg import expm

    n = len(a)
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n], block[:n, n:], block[n:, n:] = -a, np.outer(b, b), a.T
    found = expm(block * step)
    moved = found[n:, n:].T
    noise = moved @ found[:n, n:]
    return moved, (noise + noise.T) / 2


@dataclass(frozen=True)
class Likelihood:
    """What random inputs explain.

    Attributes:
        ratio: by entry, the logarithm of the likelihood over that without random input, all records.
        records: by entry, the same of each record.
        whiteness: by entry, the largest autocorrelation of the innovations within 20 samples, mean over records.
    """

    ratio: Mapping[str, float]
    records: Mapping[str, tuple[float, ...]]
    whiteness: Mapping[str, float]


def likelihood(prototype: Prototype, z: np.ndarray, found: Sequence[Residual]) -> Likelihood:
    """Filter the displacement residual of every record, one entry and one intensity after another.

    Args:
        prototype: that was believed.
        z: of the tolerated figures.
        found: residuals about them.
    """
    placement = NOTHING.placement(prototype)
    local = [item.nominal() for item in found]
    sizes = {e: max(float(np.std(signals[OWN[e]])) for signals in local) for e in ENTRIES}
    filters: dict[object, tuple[Filter, ...]] = {}
    records: dict[str, list[float]] = {name: [] for name in ENTRIES}
    white: dict[str, list[float]] = {name: [] for name in ENTRIES}
    for item in found:
        record = item.evidence.record
        column = item.channels.index("displacement_m")
        noise = float(item.noise[column])
        # One set of filters for all records of a condition: the unit of noise is rounded to a power of two, and the
        # output counted in it, for the sake of the Riccati equation.
        unit = 2.0 ** round(np.log2(noise))
        residual = item.left[:, column] / unit
        base = _log(residual, (noise / unit) ** 2)
        job = item.evidence.job
        placed, parameters = job.placed(placement), job.parameters(placement, z)
        for name in ENTRIES:
            key = (placed.assembly.kinds, parameters.tobytes(), record.step, unit, name)
            if key not in filters:
                filters[key] = _filters(state_space(placed, parameters), name, sizes[name], unit, record.step)
            best, correlation = base, _correlation(residual)
            for one in filters[key]:
                innovations = one(residual)
                value = _log(innovations, one.variance)
                if value > best:
                    best, correlation = value, _correlation(innovations)
            records[name].append(best - base)
            white[name].append(correlation)
    return Likelihood(
        {name: float(sum(values)) for name, values in records.items()},
        {name: tuple(values) for name, values in records.items()},
        {name: float(np.mean(values)) for name, values in white.items()},
    )


def _filters(
    space: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray], name: str, size: float, unit: float, step: float
) -> tuple[Filter, ...]:
    """One filter per intensity; an intensity whose filter cannot be had is passed over, as if it explained nothing."""
    a, b, c = driven(space, name)
    moved, noise = sampled(a, b * size * np.sqrt(2 / (2 * np.pi * _BAND_HZ)), step)
    found = []
    for intensity in _INTENSITIES:
        with suppress(Unsolved):
            found.append(kalman(moved, noise * intensity**2, c / unit, 1.0))
    return tuple(found)


def driven(space: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray], entry: str) -> Matrices:
    """A, b and c of the rig with first-order noise of the given entry as one more state, seen at the displacement.

    White noise of unit intensity through b; the noise state has a variance of `_BAND_HZ` pi.
    """
    a, b, c, d = space
    row, n, rate = SIGNALS.index("displacement_m"), len(a), 2 * np.pi * _BAND_HZ
    whole, into, seen = np.zeros((n + 1, n + 1)), np.zeros(n + 1), np.append(c[row], 0.0)
    whole[:n, :n], whole[n, n], into[n] = a, -rate, rate
    for column, factor, order in entry_columns(entry):
        if order == 0:
            whole[:n, n] += factor * b[:, column]
            seen[n] += factor * d[row, column]
        else:  # its derivative: rate (white - state)
            whole[:n, n] -= factor * rate * b[:, column]
            into[:n] += factor * rate * b[:, column]
    return whole, into, seen


def _log(innovations: np.ndarray, variance: float) -> float:
    return float(-0.5 * np.sum(np.log(2 * np.pi * variance) + innovations**2 / variance))


def _correlation(signal: np.ndarray) -> float:
    centred = signal - signal.mean()
    power = float(centred @ centred) or 1.0
    return max(abs(float(centred[k:] @ centred[:-k])) / power for k in range(1, 21))


_SHARES = np.geomspace(1e-3, 3.0, 16)


def multiplicative(found: Sequence[Residual]) -> Mapping[str, float]:
    """By entry, log-likelihood over none of a random input with the spectrum of the equation's own variable.

    A relative error of an equation that is random from line to line; one size for all records. Whittle's likelihood of
    the displacement's spectrum; P. Whittle, Arkiv for Matematik 2 (1953) 423.
    """
    table: dict[str, float] = {}
    for name in ENTRIES:
        total = np.zeros(len(_SHARES) + 1)
        for item in found:
            weight, probed = item.evidence.weight, item.probe
            column = item.channels.index("displacement_m")
            power = np.abs(probed.spectrum(item.left[:, column] * weight.fade)) ** 2
            own = np.abs(probed.driven(item.evidence.record.inputs, (OWN[name],))[:, 0]) ** 2
            through = np.abs(probed.entry(name, ("displacement_m",))[:, 0]) ** 2
            noise = float(item.noise[column]) ** 2 * len(item.left)
            lines = np.arange(len(power)) % 2 == 0  # those of the record without padding
            hz = np.abs(probed.laplace) / (2 * np.pi)
            lines &= (hz > weight.frequencies_Hz[0]) & (hz < weight.frequencies_Hz[-1])
            for k, share in enumerate((0.0, *_SHARES)):
                spread = noise + share**2 * (banded(own) * through)[lines]
                total[k] -= float(np.sum(np.log(spread) + power[lines] / spread))
        table[name] = float(total.max() - total[0])
    return table
