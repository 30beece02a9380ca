"""Fits to be made, and those kept on disk: a diagnosis that was interrupted goes on where it stopped."""

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from beamdesign.code_digest import code_digest
from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.fitting.fit import Fit, Share
from beamdesign.diagnosis.fitting.hypothesis import Hypothesis
from beamdesign.files import read_bytes, write_whole
from beamdesign.prototype import Prototype

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
