"""The folder that `beamdesign spec` leaves behind: document, drawing, proofs, data set to fill in."""

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from beamdesign.files import fresh_folder, write_whole
from beamdesign.json_text import json_text
from beamdesign.records import Record, to_toml
from beamdesign.report.quantity import at_least, at_most, quantity
from beamdesign.specification.data_folder import believed, write_data_folder
from beamdesign.specification.document import Document, Paragraph, Part, to_markdown
from beamdesign.specification.drawing import drawing, dxf_text, missing_geometry, svg_text
from beamdesign.specification.html_page import to_html
from beamdesign.specification.specification import Specification
from beamdesign.specification.words_accept import FOLDER, acceptance_part
from beamdesign.specification.words_build import actuator, masses, masses_text, sections, sensor
from beamdesign.specification.words_control import circuit, code, controller, guaranteed, tolerance_part

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
    "tolerances.toml", "equal_tolerances.toml", "delay.toml", "drawing.dxf", "drawing.svg", "components/*.toml"
)  # fmt: skip
"""Of an earlier specification; what was measured for it stays."""
_STANDALONE = 'xmlns="http://www.w3.org/2000/svg"'


def document_of(spec: Specification, svg: str = "") -> Document:
    """The specification as a document; where the loop is not stable it says so, and why."""
    kind = "Specification"
    if spec.reason:
        ranges = ", ".join(f"{low:.6g} to {high:.6g} kg" for low, high in spec.certificate.stable_ranges_kg) or "none"
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
    found = spec.certificate.guaranteed
    assert found is not None
    reached = masses_text(spec.masses_kg)
    verdict = (
        f"With every mass of {reached} on its outer tip the rig is proved stable, gives way by no more than"
        f" {quantity(spec.prototype.goal.compliance_m_per_N, 'm/N')} up to {at_least(found.bandwidth_Hz, 'Hz')}"
        " and keeps its"
        f" peak sensitivity at {at_most(found.peak_sensitivity, '1')} or below, by the linear model with nominal"
        " figures."
    )
    key = (
        ("guaranteed bandwidth (proved)", at_least(found.bandwidth_Hz, "Hz")),
        ("guaranteed peak sensitivity (proved)", at_most(found.peak_sensitivity, "1")),
        ("for outer end masses of", reached),
        ("inner end mass to be added", quantity(spec.prototype.payload.inner_end_mass_kg, "kg")),
    )
    parts = (
        guaranteed(spec), sections(spec, svg), masses(spec), actuator(spec), sensor(spec), controller(spec),
        circuit(spec),
        code(spec), tolerance_part(spec), acceptance_part(spec), _foundations(),
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
    texts["certificate"] = ("certificate.toml", spec.certificate.text)
    if spec.tolerances is not None:
        texts["tolerances"] = ("tolerances.toml", spec.tolerances.certificate)
        texts["equal_tolerances"] = ("equal_tolerances.toml", spec.tolerances.certificate_equal)
    if spec.digital is not None:
        texts["delay"] = ("delay.toml", spec.digital.delay_certificate)
    for one in spec.analogue:
        for at in one.tolerances:
            name = f"{one.circuit.resistors}_{one.circuit.capacitors}_{100 * at.resistors:g}_{100 * at.capacitor:g}"
            texts[f"components_{name}"] = (f"components/{name}.toml", at.certificate)
    texts["prototype"] = ("prototype.toml", to_toml(spec.prototype))
    names = {kind: name for kind, (name, text) in texts.items() if text}
    if spec.plan is not None:
        names["dataset"] = FOLDER
    paths = {kind: out / name for kind, name in names.items()}
    with fresh_folder(out, _RETIRING) as fresh:
        for name, text in texts.values():
            if text:
                write_whole(fresh / name, text)
        write_whole(fresh / JSON_NAME, json_text(json_fields(spec) | {"files": paths}))
        if spec.plan is not None:
            specified = spec.tolerances.specified if spec.tolerances is not None else {}
            write_data_folder(believed(spec.prototype, specified), spec.plan, fresh / FOLDER)
    return paths


def json_fields(spec: Specification) -> dict[str, Any]:
    """The specification for programs: everything but the texts of proofs, in SI, with units in the keys."""
    found = spec.certificate.guaranteed
    return {
        "name": spec.prototype.name,
        "certifiable": not spec.reason,
        "reason": spec.reason,
        "outer_end_mass_kg": list(spec.masses_kg),
        "stable_ranges_kg": [list(pair) for pair in spec.certificate.stable_ranges_kg],
        "guaranteed": None
        if found is None
        else {"bandwidth_Hz": found.bandwidth_Hz, "peak_sensitivity": found.peak_sensitivity, "basis": "proved"},
        "load_N": spec.load_N,
        "sections": _plain(spec.stock),
        "drawing": missing_geometry(spec.prototype) or "drawing.dxf",
        "ratings": _plain(spec.ratings),
        "sensor": _plain(spec.sensor),
        "controller": _plain(spec.prototype.controller),
        "analogue": _plain(spec.analogue),
        "analogue_reason": spec.analogue_reason,
        "digital": _plain(spec.digital),
        "tolerances": _plain(spec.tolerances),
        "tolerances_reason": spec.tolerances_reason,
        "acceptance": _plain(spec.acceptance),
        "test_plan": _plain(spec.plan),
        "basis": BASIS,
    }


_TEXTS = {"certificate", "certificate_equal", "delay_certificate"}


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
