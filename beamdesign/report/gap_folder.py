"""The files that a diagnosis leaves: the amended prototype, the fields for programs, the report, a new design."""

from pathlib import Path
from typing import Any

from beamdesign.bench_prototype import write_any_prototype
from beamdesign.files import write_whole
from beamdesign.gap.data.dataset import Dataset
from beamdesign.gap.designer_terms import LoopTerms
from beamdesign.gap.diagnosis import Diagnosis
from beamdesign.gap.diagnosis_fields import diagnosis_fields, plain
from beamdesign.prototype import write_prototype
from beamdesign.report.gap_report import gap_report_html
from beamdesign.study.design_run import CERTIFICATE_NAME
from beamdesign.study.redesign import Redesign

NAMES = {"prototype": "prototype.toml", "json": "diagnosis.json", "report": "report.html"}
REDESIGNED = {"redesigned": "redesigned/prototype.toml", "certificate": f"redesigned/{CERTIFICATE_NAME}"}


def write_gap_folder(
    folder: Path,
    found: Diagnosis,
    data: Dataset | None = None,
    terms: tuple[LoopTerms, ...] = (),
    renewed: Redesign | None = None,
) -> tuple[dict[str, Path], dict[str, Any]]:
    """Write everything, each file whole or not at all.

    Args:
        folder: made if need be.
        found: the diagnosis.
        data: of a twin beam; None for a bench.
        terms: what its loops promise.
        renewed: a new design, where one was asked for.

    Returns:
        paths by kind, and the fields of the JSON file.
    """
    new = renewed is not None and renewed.prototype is not None and renewed.certificate is not None
    names = NAMES | (REDESIGNED if new else {})
    paths = {kind: folder / name for kind, name in names.items()}
    write_any_prototype(found.prototype, paths["prototype"])
    if renewed is not None and renewed.prototype is not None and renewed.certificate is not None:
        write_prototype(renewed.prototype, paths["redesigned"])
        write_whole(paths["certificate"], renewed.certificate.text)
    fields = diagnosis_fields(found)
    fields |= {"design": _design(terms), "redesign": _redesign(renewed)}
    fields |= {kind: str(path) for kind, path in paths.items() if kind != "json"}
    write_whole(paths["json"], as_json(fields))
    write_whole(paths["report"], gap_report_html(found, names, data, terms, renewed))
    return paths, fields


def as_json(fields: dict[str, Any]) -> str:
    """Fields as text; figures that are not finite become null."""
    import json
    from math import isfinite

    def finite(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: finite(item) for name, item in value.items()}
        if isinstance(value, list):
            return [finite(item) for item in value]
        return None if isinstance(value, float) and not isfinite(value) else value

    return json.dumps(finite(plain(fields)), indent=2, allow_nan=False) + "\n"


def _design(terms: tuple[LoopTerms, ...]) -> list[dict[str, Any]]:
    return [
        {
            "controller": loop.controller.model_dump(),
            "inner_end_mass_kg": loop.inner_end_mass_kg,
            "outer_end_mass_kg": list(loop.outer_end_mass_kg),
            "believed": plain(loop.believed),
            "diagnosed": plain(loop.diagnosed),
        }
        for loop in terms
    ]


def _redesign(renewed: Redesign | None) -> dict[str, Any] | None:
    if renewed is None:
        return None
    prototype = renewed.prototype
    if prototype is None or prototype.controller is None or prototype.guarantee is None:
        return {"controller": None, "reason": renewed.reason}
    return {
        "controller": prototype.controller.model_dump(),
        "inner_end_mass_kg": prototype.payload.inner_end_mass_kg,
        "guaranteed": prototype.guarantee.model_dump(),
    }
