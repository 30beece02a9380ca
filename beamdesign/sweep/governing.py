"""Why a case came out as it did: what governs it, what binds, and what a little more of each requirement costs."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from beamdesign.records import InputError
from beamdesign.sweep import store

NEARLY = 0.98
"""Share of its limit from which a check is said to bind."""


@dataclass(frozen=True)
class Governing:
    """What governs one case.

    Attributes:
        record: as kept.
        checks: structural checks, the most used first; empty where the task has none.
        binding: names of those that are used to at least `NEARLY`.
        requirements: that are active at the optimum over free sizes.
        shadow_prices: kg per unit of each requirement, at that optimum.
        relaxations: for a no, requirements of which easing one alone is enough.
    """

    record: dict[str, Any]
    checks: tuple[Mapping[str, Any], ...]
    binding: tuple[str, ...]
    requirements: tuple[str, ...]
    shadow_prices: dict[str, float]
    relaxations: tuple[Mapping[str, Any], ...]


def case_of(address: str) -> dict[str, Any]:
    """The record of a case named DIR/NUMBER, DIR/START-OF-ADDRESS, or by its file.

    Raises:
        InputError: where there is no such case, or its result does not hold.
    """
    path = Path(address)
    if path.suffix == ".json" and path.is_file():
        record = store.kept(path.parent.parent, path.stem)
        if record is None:
            raise InputError(address, [("(file)", "is no result of a case")])
        return record
    folder, name = path.parent, path.name
    try:
        rows = store.read_index(folder)["rows"]
    except InputError as error:
        raise InputError(address, [(f"{error.source}: {key}", reason) for key, reason in error.problems]) from None
    if name.isdigit() and int(name) < len(rows):
        record = store.kept(folder, rows[int(name)])
        if record is None:
            raise InputError(address, [(name, "this case is not finished; run the study on")])
        return record
    found = [one for one in store.addresses(folder) if one.startswith(name)]
    record = store.kept(folder, found[0]) if len(found) == 1 else None
    if record is None:
        some = "several cases begin so; give more digits" if found else f"no such case; rows are 0 to {len(rows) - 1}"
        raise InputError(address, [(name, some)])
    return record


def governing(record: dict[str, Any]) -> Governing:
    """What governs a case, from what its task has kept."""
    details = record["details"]
    checks = sorted(details.get("checks", []), key=lambda check: -(check["utilisation"] or float("inf")))
    return Governing(
        record,
        tuple(checks),
        tuple(check["name"] for check in checks if check["utilisation"] is None or check["utilisation"] >= NEARLY),
        tuple(details.get("active", [])),
        dict(details.get("shadow_prices", {})),
        tuple(details.get("relaxations", [])),
    )
