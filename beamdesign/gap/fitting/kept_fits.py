"""Fits that are kept on disk as they are made, so that a diagnosis that was interrupted goes on where it stopped."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Protocol
from zipfile import BadZipFile

import numpy as np

import beamdesign
from beamdesign.files import read_bytes, write_whole
from beamdesign.gap.data.dataset import Dataset
from beamdesign.gap.fitting.fit import Fit, Share
from beamdesign.gap.fitting.hypothesis import Hypothesis
from beamdesign.prototype import Prototype

_KEY = 16  # hexadecimal digits
_SOURCES = ("*.py", "gap/fitting/*.py", "gap/data/*.py", "rig/*.py", "rig/effects/*.py")


class Job(Protocol):
    """A fit to be made; its `repr` tells everything that decides what comes of it."""

    @property
    def hypothesis(self) -> Hypothesis:
        """To be fitted."""
        ...


@dataclass(frozen=True)
class KeptFits:
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

    def recall(self, job: Job) -> Fit | None:
        """A fit that was made before; what is not there, not whole, or not what was kept for this job is made again."""
        path = self._path(job)
        try:
            with np.load(BytesIO(read_bytes(path)), allow_pickle=False) as opened:
                held = dict(opened)
                if str(held.pop("seal")) != _seal(path.name, held):
                    return None
                unknowns = job.hypothesis.unknowns(self.prototype)
                if str(held["reason"]):
                    return Fit(job.hypothesis, unknowns, reason=str(held["reason"]))
                shares = zip(held["c"], held["g"], held["a"], held["error"], strict=True)
                found = tuple(Share(float(c), g, a, float(error)) for c, g, a, error in shares)
                return Fit(job.hypothesis, unknowns, held["z"], float(held["cost"]), found)
        except (OSError, ValueError, KeyError, EOFError, BadZipFile):
            return None

    def keep(self, job: Job, found: Fit) -> None:
        """Write a fit down, whole or not at all.

        Raises:
            OSError: where it cannot be written.
        """
        path, file = self._path(job), BytesIO()
        arrays = {
            "reason": np.array(found.reason),
            "z": np.asarray(found.z),
            "cost": np.asarray(found.cost),
            **{name: np.array([getattr(s, name) for s in found.shares]) for name in ("c", "g", "a", "error")},
        }
        np.savez(file, seal=np.array(_seal(path.name, arrays)), **arrays)  # type: ignore[arg-type]
        write_whole(path, file.getvalue())

    @property
    def count(self) -> int:
        """How many fits are kept."""
        return len(list(self.folder.glob(f"{self.key}-*.npz")))

    def _path(self, job: Job) -> Path:
        return self.folder / f"{self.key}-{hashlib.sha256(repr((job, self.part)).encode()).hexdigest()[:_KEY]}.npz"


def _seal(name: str, arrays: Mapping[str, np.ndarray]) -> str:
    """Digest of a file's own name and arrays: one that was edited, or kept for another job, does not bear it."""
    sha = hashlib.sha256(name.encode())
    for key in sorted(arrays):
        array = np.ascontiguousarray(arrays[key])
        sha.update(f"{key} {array.dtype} {array.shape}".encode() + array.tobytes())
    return sha.hexdigest()


def kept_fits(folder: Path, data: Dataset) -> KeptFits:
    """Fits to a data set that are kept in a folder; those to other data or by other versions are removed from it."""
    found = KeptFits(folder, data.prototype, hashlib.sha256((digest(data) + _program()).encode()).hexdigest()[:_KEY])
    for stale in folder.glob("*-*.npz"):
        if not stale.name.startswith(found.key):
            stale.unlink()
    return found


def digest(data: Dataset) -> str:
    """SHA-256 of everything in a data set that a fit can see: figures, not files, so that its place does not matter."""
    sha = hashlib.sha256(data.prototype.model_dump_json().encode())

    def words(*values: object) -> None:
        sha.update(repr(values).encode())

    for record in data.records:
        words(record.name, record.outer_end_mass, record.inner_end_mass, record.controller, *record.measured)
        for array in (record.times, record.inputs, *record.measured.values()):
            sha.update(np.ascontiguousarray(array).tobytes())
    for taken in data.responses:
        words(taken.name, taken.has_phase, taken.amplitude_N, taken.outer_end_mass, taken.inner_end_mass)
        words(taken.controller)
        for array in (taken.frequencies_Hz, taken.response):
            sha.update(np.ascontiguousarray(array).tobytes())
    words(data.gains)
    return sha.hexdigest()


@cache
def _program() -> str:
    """SHA-256 of the sources that a fit depends on."""
    root = Path(beamdesign.__file__).parent
    sha = hashlib.sha256(np.__version__.encode())
    for pattern in _SOURCES:
        for path in sorted(root.glob(pattern)):
            sha.update(path.name.encode() + b"\0" + path.read_bytes())
    return sha.hexdigest()
