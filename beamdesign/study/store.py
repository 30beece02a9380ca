"""A sweep's folder: one file per finished case, named by its address, and an index of the rows of the last run."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from beamdesign.files import write_whole
from beamdesign.records import InputError

INDEX = "study.json"
_CASES = "cases"


def keep(folder: Path, record: dict[str, Any]) -> None:
    """Write a case's record, whole or not at all."""
    text = json.dumps(record, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    write_whole(folder / _CASES / f"{record['address']}.json", text)


def kept(folder: Path, address: str) -> dict[str, Any] | None:
    """The record kept under an address; None where there is none, or none that can be read."""
    return _read(folder / _CASES / f"{address}.json")


def all_kept(folder: Path) -> list[dict[str, Any]]:
    """Every record of a folder, by address."""
    found = (_read(path) for path in sorted((folder / _CASES).glob("*.json")))
    return [record for record in found if record is not None]


def _read(path: Path) -> dict[str, Any] | None:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) and "status" in found else None


def write_index(folder: Path, name: str, method: str, addresses: Sequence[str], complete: bool) -> None:
    """Write down which cases make up the rows, in their order."""
    fields = {"name": name, "method": method, "complete": complete, "rows": list(addresses)}
    write_whole(folder / INDEX, json.dumps(fields, indent=1) + "\n")


def read_index(folder: Path) -> dict[str, Any]:
    """The index of a folder.

    Raises:
        InputError: where the folder holds no study.
    """
    try:
        found = json.loads((folder / INDEX).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(folder, [("(folder)", f"holds no study: no {INDEX} in it")]) from None
    except (OSError, ValueError) as error:
        raise InputError(folder / INDEX, [("(file)", f"cannot be read: {error}")]) from None
    if not isinstance(found, dict) or not isinstance(found.get("rows"), list):
        raise InputError(folder / INDEX, [("rows", "missing: this is no index of a study")])
    return found


def rows_of(folder: Path) -> list[dict[str, Any]]:
    """Records of the rows of a folder that are finished, in the order of the study.

    Raises:
        InputError: where the folder holds no study.
    """
    found = (kept(folder, address) for address in read_index(folder)["rows"])
    return [record for record in found if record is not None]
