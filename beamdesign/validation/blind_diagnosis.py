"""Diagnosing one case of a blind check, in a process that has no way to its answer."""

import json
import os
import sys
import time
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from traceback import extract_tb
from typing import Any

import numpy as np

from beamdesign.code_digest import code_digest, folder_digest
from beamdesign.diagnosis.data.dataset import Dataset, read_dataset
from beamdesign.diagnosis.diagnose import diagnose
from beamdesign.diagnosis.diagnosis import Diagnosis, updated_prototype
from beamdesign.diagnosis.fitting.fit_cache import fit_cache
from beamdesign.diagnosis.fitting.search import search
from beamdesign.diagnosis.predict import predict_record, read_inputs
from beamdesign.files import write_whole
from beamdesign.progress import end_with_parent
from beamdesign.prototype import prototype_from
from beamdesign.records import to_toml
from beamdesign.validation.baselines import baselines

TRUTH = "beamdesign.validation.truth"
_MADE_BY = {
    "fitted_by": "beamdesign.diagnosis.fitting.search",
    "judged_by": "beamdesign.diagnosis.diagnose",
    "compared_by": "beamdesign.validation.baselines",
}
"""What fits, a diagnosis (fits included) and the baselines come from; keys of what is written down."""


def program() -> dict[str, str]:
    """Digests of the sources that decide what comes out, as they are now."""
    return {key: code_digest(module) for key, module in _MADE_BY.items()}


@dataclass(frozen=True)
class Place:
    """Folders and files of one case.

    Attributes:
        folder: of the data set.
        result: file for what is found.
        predictions: file for predicted displacements.
        fits: folder for fits.
    """

    folder: Path
    result: Path
    predictions: Path
    fits: Path


def begin_blind(sealed: Sequence[str]) -> None:
    """Make this process one that diagnoses: the truth model cannot be imported, nor what tells an answer opened.

    It ends with the process that began it.

    Args:
        sealed: files, and folders with all that is in them.

    Raises:
        RuntimeError: where the truth model has been imported already.
    """
    if any(name == TRUTH or name.startswith(TRUTH + ".") for name in sys.modules):
        raise RuntimeError("a process that knows the truth model diagnoses no blind case")
    sys.modules[TRUTH] = None  # type: ignore[assignment]
    forbidden = tuple(os.path.realpath(one) + os.sep for one in sealed)

    def guard(event: str, given: tuple[Any, ...]) -> None:
        named = event == "open" and isinstance(given[0], str | os.PathLike)
        if named and f"{os.path.realpath(given[0])}{os.sep}".startswith(forbidden):
            raise PermissionError(f"{given[0]}: sealed")

    sys.addaudithook(guard)
    end_with_parent()


def diagnose_blind(place: Place, now: Mapping[str, str], rejudge: bool = False) -> bool:
    """Diagnose a case from its folder alone and write down what is found, unless that has been done by this program.

    Where the diagnosis breaks off, the error is written down instead; the next call tries again.

    Args:
        place: where its files are.
        now: digests of this program, see `program`.
        rejudge: whether fits of an earlier program count.

    Returns:
        whether anything had to be done.
    """
    before = _read(place.result)
    set_digest = folder_digest(place.folder)
    fields: dict[str, Any] = {"set_sha256": set_digest} | {key: now[key] for key in ("judged_by", "compared_by")}
    if all(before.get(key) == value for key, value in fields.items()) and "failed" not in before:
        return False
    before = before if before.get("set_sha256") == set_digest else {}
    fields["fitted_by"] = str(before.get("fitted_by", now["fitted_by"])) if rejudge else now["fitted_by"]
    try:
        found = _diagnosed(place, now, before, fields["fitted_by"])
    except Exception as error:
        words = str(error).replace(f"{place.folder}{os.sep}", "")  # a result names no folder of whoever ran the check
        found = {"failed": f"{type(error).__name__}: {words}", "failed_at": _where(error)}
    write_whole(place.result, json.dumps(fields | found) + "\n")
    return True


def _where(error: Exception) -> str:
    """Module and line at which a diagnosis broke off, the last one of this program."""
    frames = [f for f in extract_tb(error.__traceback__) if "beamdesign" in f.filename]
    return f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""


def _read(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _diagnosed(place: Place, now: Mapping[str, str], before: dict[str, Any], fitted_by: str) -> dict[str, Any]:
    data = read_dataset(place.folder)
    kept = fit_cache(place.fits, data, fitted_by)
    recalled = kept.count
    begun = time.perf_counter(), time.process_time()
    found = diagnose(data, 1, kept=kept)
    seconds = time.perf_counter() - begun[0], time.process_time() - begun[1]
    made = kept.count - recalled
    # A diagnosis that found some of its fits made has no time of its own: that of the run which made them stays.
    times = {"seconds": seconds[0], "cpu_seconds": seconds[1]} if recalled == 0 else before.get("time")
    same = before.get("compared_by") == now["compared_by"] and before.get("fitted_by") == fitted_by
    if (compared := before.get("baselines") if same else None) is None:
        compared = baselines(data, found.search.listed if found.search else search(data, 1, kept=kept))
    _write_predictions(place, data, found)
    added = None if fitted_by == now["fitted_by"] else now["fitted_by"] if made else before.get("added_by")
    said = found.to_dict()
    return {"fits_made": made, "added_by": added, "time": times, "baselines": compared, "diagnosis": said}


def _write_predictions(place: Place, data: Dataset, found: Diagnosis) -> None:
    """Displacements of held-out records by the believed, the re-tuned and the diagnosed prototype from the inputs."""
    out = {record.record for record in found.gap.records if record.held_out} or {r.name for r in data.records}
    given, gain = read_inputs(place.folder) if data.records else ((), 1.0)
    predicted: dict[str, np.ndarray] = {}
    written = prototype_from(tomllib.loads(to_toml(found.prototype)))  # as whoever reads its file finds it
    tuned = updated_prototype(data.prototype, found.search.null) if found.search else data.prototype
    for word, rig in (("before", data.prototype), ("tuned", tuned), ("after", written)):
        for record in given:
            if record.name in out:
                moved = predict_record(rig, record, gain).column("displacement_m")
                whole = np.full(len(record.times), np.nan)
                whole[: len(moved)] = moved
                predicted[f"{record.name}/{word}"] = whole.astype(np.float32)
    file = BytesIO()
    np.savez_compressed(file, **predicted)  # type: ignore[arg-type]
    write_whole(place.predictions, file.getvalue())
