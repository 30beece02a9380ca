"""The folder that `beamdesign spec` leaves behind: document, drawing, proofs, data set to fill in."""

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from beamdesign.files import fresh_folder, write_whole
from beamdesign.json_text import json_text
from beamdesign.proof.certificate import Guaranteed
from beamdesign.proof.lyapunov import CHANGES_NAME, describe, switching_fields
from beamdesign.proof.stage_tables import stages_certificate
from beamdesign.records import Record, to_toml
from beamdesign.report.quantity import at_least, at_most, quantity
from beamdesign.specification.data_folder import believed, write_data_folder
from beamdesign.specification.document import Document, Paragraph, Part, to_markdown
from beamdesign.specification.drawing import drawing, dxf_text, missing_geometry, svg_text
from beamdesign.specification.html_page import to_html
from beamdesign.specification.specification import LawSpecification, Specification
from beamdesign.specification.words_accept import FOLDER, acceptance_part
from beamdesign.specification.words_build import actuator, masses, masses_text, sections, sensor
from beamdesign.specification.words_control import (
    changes,
    circuit,
    code,
    controller,
    guaranteed,
    tolerance_part,
)

BASIS = {
    "guaranteed": "proved",
    "sections": "given and computed; loops with stock tubes proved",
    "ratings": "computed",
    "sensor": "bandwidths proved; resolution and noise computed",
    "analogue": "proved, by each verdict",
    "digital": "proved, by each verdict",
    "tolerances": "proved",
    "acceptance": "nominal computed, bands sampled, critical_gain_proved_A_per_V proved",
}
"""How the figures of each table are founded."""
JSON_NAME = "specification.json"
_RETIRING = (
    "certificate*.toml", "*tolerances*.toml", "delay*.toml", CHANGES_NAME, "drawing.dxf", "drawing.svg",
    "components/*.toml",
)  # fmt: skip
"""Of an earlier specification; what was measured for it stays."""
_STANDALONE = 'xmlns="http://www.w3.org/2000/svg"'


def document_of(spec: Specification, svg: str = "") -> Document:
    """The specification as a document; where the loop is not stable it says so, and why."""
    kind = "Specification"
    if spec.reason:
        ranges = ", ".join(f"{low:.6g} to {high:.6g} kg" for low, high in _stable_ranges_kg(spec)) or "none"
        return Document(
            spec.prototype.name,
            kind,
            f"Nothing is specified: {spec.reason}.",
            (("stable ranges within what was asked", ranges), ("foundation", "proved")),
            (
                Part(
                    "What to do",
                    (
                        Paragraph(
                            "Tune the controller and the inner end mass for the range (`beamdesign tune`), or ask"
                            " for a range"
                            " that is stable with `--outer-end-mass`, then specify again."
                        ),
                    ),
                ),
            ),
        )
    found = spec.guaranteed
    assert found is not None
    reached = masses_text(spec.masses_kg)
    verdict = (
        f"With every mass of {reached} on its outer tip the rig is proved stable, gives way by no more than"
        f" {quantity(spec.prototype.goal.compliance_m_per_N, 'm/N')} up to {at_least(found.bandwidth_Hz, 'Hz')}"
        " and keeps its"
        f" peak sensitivity at {at_most(found.peak_sensitivity, '1')} or below, by the linear model with nominal"
        f" figures{', while the law acts that is for that mass' if spec.switching else ''}."
    )
    key = (
        ("guaranteed bandwidth (proved)", at_least(found.bandwidth_Hz, "Hz")),
        ("guaranteed peak sensitivity (proved)", at_most(found.peak_sensitivity, "1")),
        ("for outer end masses of", reached),
        ("inner end mass to be added", quantity(spec.prototype.payload.inner_end_mass_kg, "kg")),
    )

    def of_laws(*words: Callable[[LawSpecification], Part]) -> list[Part]:
        made = [(law.stage.number, word(law)) for law in spec.laws for word in words]
        return [replace(part, title=f"{part.title}, stage {number}") if number else part for number, part in made]

    parts = (
        *of_laws(guaranteed), *([changes(spec)] if spec.switching else []), sections(spec, svg), masses(spec),
        actuator(spec), sensor(spec), *of_laws(controller, circuit, code), tolerance_part(spec),
        *of_laws(acceptance_part), _foundations(),
    )  # fmt: skip
    return Document(spec.prototype.name, kind, verdict, key, parts)


def _foundations() -> Part:
    text = (
        "Proved: decided in exact rational or in ball arithmetic. Refuted: an example was found that does not"
        " hold. Computed:"
        " closed formulas and frequency responses of the linear model in floating point. Sampled: the extremes of"
        " examples"
        " that were drawn. Given: stands in the prototype. All of it is about the linear model; how far a rig"
        " follows it is"
        " for the acceptance test to say."
    )
    return Part("How each figure is founded", (Paragraph(text),))


def write_specification(spec: Specification, out: Path) -> dict[str, Path]:
    """Write everything as one set; records of the data set that hold measurements already stay as they are.

    Returns:
        path by kind: `prototype`, `certificate`, `markdown`, `html`, and where the loop is stable also `drawing_dxf`
        and `drawing_svg` (with geometry), `tolerances`, `dataset` and others.

    Raises:
        OSError: where a file cannot be written.
    """
    texts: dict[str, tuple[str, str]] = {}
    svg = ""
    if not spec.reason and not missing_geometry(spec.prototype):
        drawn = drawing(spec.prototype)
        svg = svg_text(drawn, "dimensioned drawing of the rig")
        texts["drawing_dxf"] = ("drawing.dxf", dxf_text(drawn))
        alone = svg.replace("var(--ink, #000)", "#000000")
        texts["drawing_svg"] = (
            "drawing.svg",
            alone if _STANDALONE in alone else alone.replace("<svg", f"<svg {_STANDALONE}", 1),
        )
    document = document_of(spec, svg)
    texts["markdown"] = ("specification.md", to_markdown(document))
    texts["html"] = ("specification.html", to_html(document))
    folders: dict[str, tuple[str, LawSpecification]] = {}
    for k, law in enumerate(spec.laws):
        end, number = law.stage.suffix, law.stage.suffix.replace(".", "_")
        own = {"certificate": law.certificate.text}
        if spec.tolerances is not None:
            own["tolerances"] = spec.tolerances.certificates[k]
            own["equal_tolerances"] = spec.tolerances.certificates_equal[k]
        if law.digital is not None:
            own["delay"] = law.digital.delay_certificate
        texts |= {f"{kind}{number}": (f"{kind}{end}.toml", text) for kind, text in own.items()}
        for one in law.analogue:
            for at in one.tolerances:
                name = f"{one.circuit.resistors}_{one.circuit.capacitors}_{100 * at.resistors:g}_{100 * at.capacitor:g}"
                texts[f"components_{name}{number}"] = (f"components/{name}{end}.toml", at.certificate)
        if law.plan is not None:
            folders[f"dataset{number}"] = (f"{FOLDER}{end}", law)
    if spec.switching is not None:
        summary = "\n".join((f"{spec.prototype.name}: changes between its laws", *describe(spec.switching)))
        texts["certificate_switching"] = (CHANGES_NAME, stages_certificate(spec.prototype, spec.switching, summary))
    texts["prototype"] = ("prototype.toml", to_toml(spec.prototype))
    names = {kind: name for kind, (name, text) in texts.items() if text}
    names |= {kind: name for kind, (name, _) in folders.items()}
    paths = {kind: out / name for kind, name in names.items()}
    with fresh_folder(out, _RETIRING) as fresh:
        for name, text in texts.values():
            if text:
                write_whole(fresh / name, text)
        write_whole(fresh / JSON_NAME, json_text(json_fields(spec) | {"files": paths}))
        for name, law in folders.values():
            specified = spec.tolerances.specified if spec.tolerances is not None else {}
            assert law.plan is not None
            write_data_folder(believed(law.stage.prototype, specified), law.plan, fresh / name)
    return paths


def json_fields(spec: Specification) -> dict[str, Any]:
    """The specification for programs: everything but the texts of proofs, in SI, with units in the keys.

    What there is of every law stands once for all: that of the law of the least bandwidth, or of the first that is not
    stable. Of several laws that of each stands under `stages`.
    """
    stages = [_of_law(law) for law in spec.laws]
    governs = min(stages, key=lambda one: 0.0 if one["guaranteed"] is None else one["guaranteed"]["bandwidth_Hz"])
    return {
        "name": spec.prototype.name,
        "certifiable": not spec.reason,
        "reason": spec.reason,
        **governs,
        "outer_end_mass_kg": list(spec.masses_kg),
        "stable_ranges_kg": [list(pair) for pair in _stable_ranges_kg(spec)],
        "guaranteed": _reached(spec.guaranteed),
        "load_N": spec.load_N,
        "sections": _plain(spec.stock),
        "drawing": missing_geometry(spec.prototype) or "drawing.dxf",
        "ratings": _plain(spec.ratings),
        "sensor": _plain(spec.sensor),
        "controller": _plain(spec.prototype.controller),
        "tolerances": _plain(spec.tolerances),
        "tolerances_reason": spec.tolerances_reason,
        "basis": BASIS,
        **({} if spec.switching is None else {"switching": switching_fields(spec.switching)}),
        **({} if spec.prototype.schedule is None else {"stages": stages}),
    }


def _of_law(law: LawSpecification) -> dict[str, Any]:
    return {
        "outer_end_mass_kg": list(law.stage.outer_end_mass_kg),
        "stable_ranges_kg": [list(pair) for pair in law.certificate.stable_ranges_kg],
        "guaranteed": _reached(law.certificate.guaranteed),
        "controller": _plain(law.stage.prototype.controller),
        "analogue": _plain(law.analogue),
        "analogue_reason": law.analogue_reason,
        "digital": _plain(law.digital),
        "acceptance": _plain(law.acceptance),
        "test_plan": _plain(law.plan),
    }


def _reached(found: Guaranteed | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {"bandwidth_Hz": found.bandwidth_Hz, "peak_sensitivity": found.peak_sensitivity, "basis": "proved"}


def _stable_ranges_kg(spec: Specification) -> list[tuple[float, float]]:
    return [pair for law in spec.laws for pair in law.certificate.stable_ranges_kg]


_TEXTS = {"certificate", "certificates", "certificates_equal", "delay_certificate"}


def _plain(value: Any) -> Any:
    """Records and dataclasses as tables, without the texts of proofs; what JSON cannot hold is left to its writer."""
    if isinstance(value, Record):
        return value.model_dump(exclude_none=True)
    if hasattr(value, "_asdict"):
        return _plain(value._asdict())
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value) if f.name not in _TEXTS}
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value
