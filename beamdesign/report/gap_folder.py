"""The files that a diagnosis leaves: the amended prototype, the fields for programs, the report, a new design."""

from pathlib import Path
from typing import Any

from beamdesign.files import write_set
from beamdesign.gap.data.dataset import Dataset
from beamdesign.gap.designer_terms import LoopTerms
from beamdesign.gap.diagnosis import Diagnosis
from beamdesign.gap.diagnosis_fields import diagnosis_fields
from beamdesign.json_text import json_text, plain
from beamdesign.records import to_toml
from beamdesign.report.gap_report import gap_report_html
from beamdesign.study.redesign import Redesign

NAMES = {"prototype": "prototype.toml", "json": "diagnosis.json", "report": "report.html"}
REDESIGNED = "redesigned/prototype.toml"


def write_gap_folder(
    folder: Path,
    found: Diagnosis,
    data: Dataset | None = None,
    terms: tuple[LoopTerms, ...] = (),
    renewed: Redesign | None = None,
) -> tuple[dict[str, Path], dict[str, Any]]:
    """Write everything as one set; what an earlier diagnosis left in these files goes.

    Args:
        folder: made if need be.
        found: the diagnosis.
        data: of a twin beam; None for a bench.
        terms: what its loops promise.
        renewed: a new design, where one was asked for.

    Returns:
        paths by kind, and the fields of the JSON file.
    """
    names, texts = dict(NAMES), {"prototype": to_toml(found.prototype)}
    if renewed is not None and renewed.prototype is not None:
        names["redesigned"], texts["redesigned"] = REDESIGNED, to_toml(renewed.prototype)
        for k, (certificate, stage) in enumerate(renewed.proofs, start=1):
            assert stage.guarantee is not None  # what was proved
            kind = "certificate" if len(renewed.proofs) == 1 else f"certificate_stage_{k}"
            names[kind], texts[kind] = f"redesigned/{stage.guarantee.certificate}", certificate.text
    fields = diagnosis_fields(found)
    fields |= {"design": _design(terms), "redesign": _redesign(renewed)}
    fields |= {kind: str(folder / name) for kind, name in names.items() if kind != "json"}
    texts |= {"json": json_text(fields), "report": gap_report_html(found, names, data, terms, renewed)}
    files = {kind: (name, texts[kind]) for kind, name in names.items()}
    paths = write_set(folder, files, (REDESIGNED, "redesigned/*certificate.toml"))
    return paths, fields


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
    if prototype is None or prototype.controller is None:
        return {"controller": None, "reason": renewed.reason}
    guaranteed = [stage.guarantee.model_dump() for _, stage in renewed.proofs if stage.guarantee is not None]
    return {
        "controller": prototype.controller.model_dump(),
        "inner_end_mass_kg": prototype.payload.inner_end_mass_kg,
        "guaranteed": guaranteed if prototype.schedule is not None else guaranteed[0],
    }
