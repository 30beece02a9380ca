"""The most probable figures under a hypothesis, by Gauss and Newton with the model's own derivatives.

Fits are kept on disk as they are made, so that a diagnosis that was interrupted goes on where it stopped.
"""

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from io import BytesIO
from math import erfc, sqrt
from pathlib import Path
from typing import Any, Protocol
from zipfile import BadZipFile

import numpy as np
from scipy.special import chdtrc

from beamdesign.code_digest import code_digest
from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.fitting.hypothesis import Hypothesis, Placement, Unknown
from beamdesign.diagnosis.thresholds import THRESHOLDS
from beamdesign.files import read_bytes, write_whole
from beamdesign.prototype import Prototype
from beamdesign.time_limit import heed

ITERATIONS = 12
_SETTLED = 1e-3  # relative fall of the cost at which a fit has settled
_FURTHEST = 2.0  # in z, per iteration
_HUGE = 1e9
_LEAST_DAMPING, _MOST_DAMPING = 1e-6, 1e4


class Fitted(Protocol):
    """What a fit brings down, in units of misfit."""

    def predicted(self, placement: Placement, z: np.ndarray) -> Any:
        """What the model makes of it; None where it cannot say (its loop diverges)."""
        ...

    def misfit(self, predicted: Any) -> np.ndarray:
        """(M,) measured less predicted, weighed."""
        ...

    def linearised(self, placement: Placement, z: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """The residual, and (M, K) its derivative by z."""
        ...

    def residual(self, placement: Placement, z: np.ndarray) -> np.ndarray | None:
        """(M,) measured less predicted, weighed; None where the model cannot say."""
        found = self.predicted(placement, z)
        return None if found is None else self.misfit(found)

    def error(self, residual: np.ndarray) -> float:
        """Mean square of the displacement's error over that of the displacement; 0 for what is no record of it."""
        return 0.0


class Evidence(Fitted, Protocol):
    """A piece of what was measured: a kind says what its model predicts and how that is weighed."""

    @property
    def name(self) -> str:
        """Of the record or the figure measured."""
        ...

    @property
    def condition(self) -> object:
        """Under which it was measured; pieces of one condition are held out together."""
        ...

    @property
    def expected(self) -> float:
        """Misfit that noise alone leaves."""
        ...

    @property
    def floor(self) -> float:
        """Mean square of the displacement's noise over that of the displacement; 0 for what is no record of it."""
        return 0.0


@dataclass(frozen=True)
class Share:
    """A quadratic in z that stands for one piece of evidence about a fit: c + 2 g'(z - z0) + (z - z0)' A (z - z0).

    Attributes:
        c: misfit at the fit.
        g: (K,) half its slope there.
        a: (K, K) half its curvature.
        error: of the displacement, see `Evidence.error`.
    """

    c: float
    g: np.ndarray = field(repr=False)
    a: np.ndarray = field(repr=False)
    error: float = 0.0


@dataclass(frozen=True)
class Fit:
    """A hypothesis with its most probable figures.

    Attributes:
        hypothesis: fitted.
        unknowns: in the order of z.
        z: (K,) in prior standard deviations.
        cost: misfit of all evidence, and z'z of the priors.
        shares: one per piece of evidence, at z.
        reason: why there is no fit (the model's loop diverges wherever it was tried); empty otherwise.
    """

    hypothesis: Hypothesis
    unknowns: tuple[Unknown, ...] = ()
    z: np.ndarray = field(default_factory=lambda: np.zeros(0))
    cost: float = np.inf
    shares: tuple[Share, ...] = field(default=(), repr=False)
    reason: str = ""

    @property
    def misfit(self) -> float:
        """Of the evidence alone."""
        return float(sum(share.c for share in self.shares)) if not self.reason else np.inf

    @property
    def strain(self) -> float:
        """Of the priors of tolerated figures: what is left for a wrong figure, or an effect, to ease."""
        return sum(z**2 for z in self.moved.values())

    @property
    def error(self) -> float:
        """Mean square errors of the displacement, all records together, each over its own mean square."""
        return float(sum(share.error for share in self.shares)) if not self.reason else np.inf

    @property
    def values(self) -> dict[str, float]:
        """SI value of every unknown by name; none without a fit."""
        return {u.name: u.value(z) for u, z in zip(self.unknowns, self.z, strict=not self.reason)}

    @property
    def moved(self) -> dict[str, float]:
        """Tolerances by which it has moved each tolerated figure, by name; none without a fit."""
        return {u.name: float(z) for u, z in zip(self.unknowns, self.z, strict=not self.reason) if u.kind == "figure"}

    @property
    def strained(self) -> tuple[str, ...]:
        """Tolerated figures moved further than anyone would believe: causes stand for others, or one is missing."""
        moved, most = self.moved, THRESHOLDS.strained
        # All together are where the sum of their squares is as improbable as that of one which is.
        together = chdtrc(len(moved), self.strain) < erfc(most / sqrt(2))
        return tuple(name for name, z in moved.items() if abs(z) > (1.0 if together else most))

    @property
    def covariance(self) -> np.ndarray:
        """(K, K) of z, from the curvature at the fit."""
        values, vectors = np.linalg.eigh(np.eye(len(self.z)) + sum(share.a for share in self.shares))
        # No less than the priors' own curvature, which rounding may lose beside that of a motion hard to repeat.
        return (vectors / np.maximum(values, 1.0)) @ vectors.T

    @property
    def standard_errors(self) -> dict[str, float]:
        """SI, by name."""
        deviation = np.sqrt(np.diag(self.covariance))
        return {u.name: abs(u.slope(z)) * float(s) for u, z, s in zip(self.unknowns, self.z, deviation, strict=True)}


def fit(
    hypothesis: Hypothesis,
    placement: Placement,
    evidence: Sequence[Fitted],
    start: np.ndarray,
    iterations: int = ITERATIONS,
) -> Fit:
    """Minimise misfit plus z'z from a start.

    Args:
        hypothesis: being fitted.
        placement: its unknowns in the equations.
        evidence: what it has to explain.
        start: (K,) z.
        iterations: at most.
    """
    low, high = (np.array(side) for side in zip(*(u.bounds for u in placement.unknowns), strict=True))
    z = np.clip(start, low, high)
    if (shares := _shares(evidence, placement, z)) is None:
        return Fit(hypothesis, placement.unknowns, reason="the model's loop is unstable where the fit begins")
    cost, damping = _cost(shares, z), 1e-3
    for _ in range(iterations):
        curvature = np.eye(len(z)) + sum(s.a for s in shares)
        slope = z + sum(s.g for s in shares)
        before, last = cost, z
        while damping <= _MOST_DAMPING:
            trial = _step(z, slope, curvature, damping, low, high)
            value = misfit_at(evidence, placement, trial, cost)
            if value < cost:
                z, cost = trial, value
                damping = max(damping / 10, _LEAST_DAMPING)
                break
            damping *= 10
        else:
            break
        found = _shares(evidence, placement, z)
        if found is None:  # no further than where the shares are known
            z, cost = last, before
            break
        shares, cost = found, _cost(found, z)
        if before - cost < _SETTLED * before:
            break
    return Fit(hypothesis, placement.unknowns, z, cost, tuple(shares))


def _step(
    z: np.ndarray, slope: np.ndarray, curvature: np.ndarray, damping: float, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """A damped Newton step within bounds: what a bound stops is held there, the rest is solved again."""
    held = ((z <= low) & (slope > 0)) | ((z >= high) & (slope < 0))
    move = np.zeros_like(z)
    for _ in range(len(z)):
        free = ~held
        if not free.any():
            break
        damped = curvature + damping * np.diag(np.diag(curvature))
        move = np.zeros_like(z)
        try:
            move[free] = -np.linalg.solve(damped[np.ix_(free, free)], slope[free])
        except np.linalg.LinAlgError:  # too steep to be solved in floats: no step until it is damped more
            break
        out = free & ((z + move < low - 1e-12) | (z + move > high + 1e-12))
        if not out.any():
            break
        at = np.where(z + move < low, low, high)
        z = np.where(out, at, z)
        held = held | out
    largest = float(np.abs(move).max(initial=0.0))
    return np.clip(z + move * min(1.0, _FURTHEST / max(largest, 1e-12)), low, high)


def linearised(
    evidence: Sequence[Fitted], placement: Placement, z: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]] | None:
    """Residual (M,) and derivative (M, K) of every piece; None where the model cannot say, or is about to diverge."""
    rows = []
    for piece in evidence:
        heed()
        found = piece.linearised(placement, z)
        if found is None or not (np.abs(found[0]).max() < _HUGE and np.abs(found[1]).max() < _HUGE):
            return None
        rows.append(found)
    return rows


def _shares(evidence: Sequence[Fitted], placement: Placement, z: np.ndarray) -> list[Share] | None:
    if (rows := linearised(evidence, placement, z)) is None:
        return None
    return [Share(float(r @ r), j.T @ r, j.T @ j, piece.error(r)) for piece, (r, j) in zip(evidence, rows, strict=True)]


def _cost(shares: Sequence[Share], z: np.ndarray) -> float:
    return float(sum(s.c for s in shares) + z @ z)


def misfit_at(evidence: Sequence[Fitted], placement: Placement, z: np.ndarray, enough: float = np.inf) -> float:
    """Cost at z without a fit, or infinity as soon as it is known to be more than enough."""
    total = float(z @ z)
    for piece in evidence:
        heed()
        r = piece.residual(placement, z)
        if r is None or not np.all(np.isfinite(r)):
            return np.inf
        total += float(r @ r)
        if total >= enough:
            return np.inf
    return total


_KEY = 16  # hexadecimal digits
_FITTED_BY = "beamdesign.diagnosis.fitting.search"


@dataclass(frozen=True)
class Task:
    """One fit to be made; its `repr` tells everything that decides what comes of it.

    Attributes:
        hypothesis: to be fitted.
        known: SI values from a simpler fit.
        hints: SI values of what it lacks, from another.
        on: positions of the pieces of evidence that it is made to, the one that tells most first; empty for all of it.
        quick: whether a few iterations from one start are enough.
    """

    hypothesis: Hypothesis
    known: dict[str, float]
    hints: dict[str, float] = field(default_factory=dict)
    on: tuple[int, ...] = ()
    quick: bool = False


@dataclass(frozen=True)
class FitCache:
    """Fits to one data set by one version of the program, one file each.

    A file's name begins with a digest of data, prototype and program, and goes on with one of the job: what has
    changed is fitted anew. Files hold arrays only, so that nothing in them can be run.

    Attributes:
        folder: of the files.
        prototype: that was believed.
        key: digest of data, prototype and program.
        part: names of the pieces of evidence that fits are made to; empty for all of the data.
    """

    folder: Path
    prototype: Prototype
    key: str
    part: tuple[str, ...] = ()

    def recall(self, job: Task) -> Fit | None:
        """A fit that was made before; what is not there, not whole, or not what was kept for this job is made again."""
        path = self._path(job)
        try:
            with np.load(BytesIO(read_bytes(path)), allow_pickle=False) as archive:
                held = dict(archive)
                if str(held.pop("seal")) != _seal(path.name, held):
                    return None
                parts = zip(held["c"], held["g"], held["a"], held["error"], strict=True)
                shares = tuple(Share(float(c), g, a, float(error)) for c, g, a, error in parts)
                unknowns, reason = job.hypothesis.unknowns(self.prototype), str(held["reason"])
                if not reason and len(held["z"]) != len(unknowns):  # of a law that had other parameters then
                    return None
                return Fit(job.hypothesis, unknowns, held["z"], float(held["cost"]), shares, reason)
        except (OSError, ValueError, KeyError, EOFError, BadZipFile):
            return None

    def keep(self, job: Task, found: Fit) -> None:
        """Write a fit down, whole or not at all.

        Raises:
            OSError: where it cannot be written.
        """
        path, file = self._path(job), BytesIO()
        shares = {name: np.array([getattr(s, name) for s in found.shares]) for name in ("c", "g", "a", "error")}
        arrays = {"reason": np.array(found.reason), "z": np.asarray(found.z), "cost": np.asarray(found.cost)} | shares
        np.savez(file, seal=np.array(_seal(path.name, arrays)), **arrays)  # type: ignore[arg-type]
        write_whole(path, file.getvalue())

    @property
    def count(self) -> int:
        """How many fits are kept."""
        return len(list(self.folder.glob(f"{self.key}-*.npz")))

    def _path(self, job: Task) -> Path:
        return self.folder / f"{self.key}-{hashlib.sha256(repr((job, self.part)).encode()).hexdigest()[:_KEY]}.npz"


def _seal(name: str, arrays: Mapping[str, np.ndarray]) -> str:
    """Digest of a file's own name and arrays: one that was edited, or kept for another job, does not bear it."""
    sha = hashlib.sha256(name.encode())
    for key in sorted(arrays):
        array = np.ascontiguousarray(arrays[key])
        sha.update(f"{key} {array.dtype} {array.shape}".encode() + array.tobytes())
    return sha.hexdigest()


def fit_cache(folder: Path, data: Dataset, fitted_by: str = "") -> FitCache:
    """Fits to a data set that are kept in a folder; those to other data or by other versions are removed from it.

    Args:
        folder: of the fits.
        data: fitted.
        fitted_by: digest of the version; empty for this one.
    """
    seen = digest(data) + (fitted_by or np.__version__ + code_digest(_FITTED_BY))
    found = FitCache(folder, data.prototype, hashlib.sha256(seen.encode()).hexdigest()[:_KEY])
    digits = f"[0-9a-f]{{{_KEY}}}"
    for stale in folder.glob("*-*.npz"):
        if re.fullmatch(rf"{digits}-{digits}\.npz", stale.name) and not stale.name.startswith(found.key):
            stale.unlink()
    return found


def digest(data: Dataset) -> str:
    """SHA-256 of everything in a data set that a fit can see: figures, not files, so that its place does not matter."""
    sha = hashlib.sha256(data.prototype.model_dump_json().encode())

    def see(*values: object) -> None:
        for value in values:
            if isinstance(value, Mapping):
                see(*value.items())
            elif isinstance(value, tuple):
                see(*value)
            else:
                array = isinstance(value, np.ndarray)
                sha.update(np.ascontiguousarray(value).tobytes() if array else f"{value!r},".encode())

    everything: tuple[Any, ...] = (*data.records, *data.responses, *data.gains)
    for taken in everything:
        see(*(getattr(taken, f.name) for f in fields(taken) if f.name != "source"))
    return sha.hexdigest()
