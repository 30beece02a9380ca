"""A case whose answer a blind check has opened: its true rig, drawn once more, and its diagnosis from the kept fits."""

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from beamdesign import InputError, read_dataset
from beamdesign.code_digest import folder_digest
from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.diagnosis import Diagnosis
from beamdesign.validation.case_plan import Planned, broken, read_seal
from beamdesign.validation.truth.case import Case

_ALIKE = 1e-6  # relative; another machine's arithmetic may differ in the last digits, another rig does not


@dataclass(frozen=True)
class OpenedCase:
    """One case of a check.

    Attributes:
        folder: of the check.
        planned: as it was planned.
        short: whether its records are few and short.
        answer: what was in it.
        found: what was written down about it.
    """

    folder: Path
    planned: Planned
    short: bool
    answer: Mapping[str, Any]
    found: Mapping[str, Any]


def opened_keys(folder: Path) -> dict[str, str]:
    """Cases of a check whose answers it has opened, each with the verdict that was written down.

    Raises:
        InputError: where the folder holds no check that has been scored.
    """
    return {row["case"]: row.get("verdict", "") for row in _read(folder / "result.json", "cases")}


def check_of(folder: Path) -> str:
    """The command that made a check.

    Raises:
        InputError: where the folder holds no check that has been scored.
    """
    return str(_read(folder / "result.json", "setting")["command"])


def opened_case(folder: Path, key: str) -> OpenedCase:
    """Take up one case of a check.

    Args:
        folder: of the check.
        key: of the case, such as `0007`.

    Raises:
        InputError: where the check has no such case, has not opened its answer, or where answer or data are not what
            was sealed.
    """
    plan = _read(folder / "plan.json")
    planned = [Planned(**c | {"names": tuple(c["names"])}) for c in plan["cases"]]
    mine = next((one for one in planned if one.key == key), None)
    if mine is None:
        raise InputError(folder / "plan.json", [(key, f"no case of this check, which has {len(planned)}")])
    if key not in opened_keys(folder):
        raise InputError(folder / "result.json", [(key, "its answer is sealed: this case has not been scored")])
    try:
        seal = read_seal(folder / "sealed.json")
    except (OSError, ValueError) as error:
        raise InputError(folder / "sealed.json", [("(seal)", str(error))]) from error
    answer, found = (_read(folder / part / f"{key}.json") for part in ("answers", "found"))
    if key in broken(seal, {key: answer}):
        raise InputError(folder / "answers" / f"{key}.json", [(key, "the answer is not the one that was sealed")])
    if not folder_digest(folder / "sets" / key) == seal.sets[key] == found["set_sha256"]:
        raise InputError(folder / "sets" / key, [(key, "the data are not those that were sealed and diagnosed")])
    return OpenedCase(folder, mine, bool(plan["short"]), answer, found)


def true_rig(opened: OpenedCase) -> Case:
    """Draw the rig of a case once more, from its seed; what was sealed of it has to come out again.

    Raises:
        InputError: where another rig comes out, because the truth model is not that of the check any more.
    """
    from beamdesign.validation.truth.case import answer
    from beamdesign.validation.truth.drawing import draw_case

    planned = opened.planned
    try:
        given = {"short": opened.short, "names": planned.names, "rig": planned.rig, "noise": planned.noise}
        case = draw_case(opened.answer["seed"], planned.kind, **given)
        again = json.loads(json.dumps(answer(case)))
    except ValueError as error:
        again = {"(reason)": str(error)}
    beside = ("displacements_sha256", "figures", "figures_over_errors")  # are no part of the rig
    sealed = {name: value for name, value in opened.answer.items() if name not in beside}
    told = {name: value for name, value in again.items() if name in sealed or name == "(reason)"}  # of later versions
    if differs := unlike(sealed, told):
        words = f"this version of the truth model draws another rig: {differs} differs from what was sealed"
        raise InputError(opened.folder / "answers" / f"{planned.key}.json", [(planned.key, words)])
    return case


def unlike(one: Any, other: Any, name: str = "") -> str:
    """Where two trees of plain values differ by more than rounding; empty where nowhere."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        keys = sorted({*one, *other})
        pairs = [(f"{name}.{key}".lstrip("."), one.get(key), other.get(key)) for key in keys]
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        pairs = [(f"{name}[{k}]", *both) for k, both in enumerate(zip(one, other, strict=True))]
    elif isinstance(one, float) and isinstance(other, float):
        return "" if np.isclose(one, other, rtol=_ALIKE, atol=0.0) else name
    else:
        return "" if one == other else name
    return next((found for where, a, b in pairs if (found := unlike(a, b, where))), "")


def diagnosed(opened: OpenedCase) -> tuple[Dataset, Diagnosis]:
    """Judge a case once more by this program from the fits that the check keeps; nothing in its folder is changed."""
    from beamdesign.diagnosis.diagnose import diagnose
    from beamdesign.diagnosis.fitting.fit_cache import fit_cache

    key = opened.planned.key
    data = read_dataset(opened.folder / "sets" / key)
    with TemporaryDirectory() as name:
        fits = Path(name) / key
        if (opened.folder / "fits" / key).is_dir():
            shutil.copytree(opened.folder / "fits" / key, fits)
        return data, diagnose(data, 1, kept=fit_cache(fits, data, str(opened.found["fitted_by"])))


def _read(path: Path, key: str = "") -> Any:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        return found[key] if key else found
    except FileNotFoundError as error:
        raise InputError(path, [("(file)", "not there: no blind check that has been scored is kept here")]) from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(path, [("(file)", f"not what a blind check writes: {error}")]) from error
