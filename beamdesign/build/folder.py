"""The folder that `beamdesign spec` leaves behind: document, drawing, proofs, data set to fill in."""

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from beamdesign.build.acceptance import (
    MEASURED_WITHIN,
    AcceptanceAtMass,
    Band,
    bare_frequencies_Hz,
    believed,
    write_data_folder,
)
from beamdesign.build.drawing import drawing, dxf_text, missing_geometry, svg_text
from beamdesign.build.specification import LawSpecification, Specification
from beamdesign.build.words_build import actuator, masses, masses_text, optional, sections, sensor
from beamdesign.build.words_control import (
    changes,
    circuit,
    code,
    controller,
    guaranteed,
    tolerance_part,
)
from beamdesign.files import fresh_folder, write_whole
from beamdesign.json_text import json_text
from beamdesign.proofs.certificate import Guaranteed
from beamdesign.proofs.lyapunov import CHANGES_NAME, describe, stages_certificate, switching_fields
from beamdesign.quantity_text import at_least, at_most, decimal, quantity
from beamdesign.records import Record, to_toml
from beamdesign.report.page import Block, Code, Document, Items, Paragraph, Part, Table, to_html, to_markdown
from beamdesign.scenario import LoadSteps, Multisine, ScenarioRecord

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
                            "Tune the controller and the inner end mass for the range (`beamdesign tune`), or ask for a"
                            " range that is stable with `--outer-end-mass`, then specify again."
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
        f" {quantity(spec.prototype.goal.compliance_m_per_N, 'm/N')} up to {at_least(found.bandwidth_Hz, 'Hz')} and"
        f" keeps its peak sensitivity at {at_most(found.peak_sensitivity, '1')} or below, by the linear model with"
        f" nominal figures{', while the law acts that is for that mass' if spec.switching else ''}."
    )
    key = (
        ("guaranteed bandwidth (proved)", at_least(found.bandwidth_Hz, "Hz")),
        ("guaranteed peak sensitivity (proved)", at_most(found.peak_sensitivity, "1")),
        ("for outer end masses of", reached),
        ("inner end mass to be added", quantity(spec.prototype.payload.inner_end_mass_kg, "kg")),
        ("load across the tip", quantity(spec.load_N, "N")),
    )

    def of_laws(*words: Callable[[LawSpecification], Part]) -> list[Part]:
        made = [(law.stage.number, word(law)) for law in spec.laws for word in words]
        return [replace(part, title=f"{part.title}, stage {number}") if number else part for number, part in made]

    realised = spec.laws[0].digital is not None
    parts = (
        *of_laws(guaranteed), *([changes(spec)] if spec.switching else []), sections(spec, svg), masses(spec),
        actuator(spec), sensor(spec), *of_laws(controller), *(of_laws(circuit, code) if realised else [_further()]),
        *([tolerance_part(spec)] if realised else []), *of_laws(acceptance_part), _foundations(),
    )  # fmt: skip
    return Document(spec.prototype.name, kind, verdict, key, parts)


def _further() -> Part:
    text = (
        "`beamdesign spec prototype.toml` gives a circuit of preferred values and the difference equation, both proved"
        " as they are realised; what the sensor must be; tolerances; a drawing; and an acceptance test with limits."
    )
    return Part("Realisation", (Paragraph(text),))


def _foundations() -> Part:
    text = (
        "Proved: decided in exact rational or in ball arithmetic. Refuted: an example was found that does not hold."
        " Computed: closed formulas and frequency responses of the linear model in floating point. Sampled: the"
        " extremes of examples that were drawn. Given: stands in the prototype. All of it is about the linear model;"
        " how far a rig follows it is for the acceptance test to say."
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
            folders[f"dataset{number}"] = (f"{ACCEPTANCE_FOLDER}{end}", law)
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


ACCEPTANCE_FOLDER = "acceptance"


def acceptance_part(spec: LawSpecification) -> Part:
    """What to measure: expected values with limits, and where the law is realised excitations and the data set."""
    rig, controller = spec.stage.prototype, spec.stage.prototype.controller
    assert controller is not None
    bare, ratios = bare_frequencies_Hz(rig), (rig.outer_beam.damping_ratio, rig.inner_beam.damping_ratio)
    steps = [
        f"Before the loop is closed, tap each beam alone: outer {quantity(bare[0], 'Hz')} (module on, no payload),"
        f" inner {quantity(bare[1], 'Hz')} (its end mass on), damping ratios {decimal(ratios[0])} and"
        f" {decimal(ratios[1])}; computed.",
        f"With the controller at {quantity(controller.gain_A_per_V, 'A/V')} measure the compliance.",
        "Then raise the gain, all else as specified, until an oscillation keeps up by itself; stop there.",
    ]
    limits: tuple[str, ...] = (
        "Nothing here has an allowance for tolerances: what is expected is nominal, by the linear model (computed).",
    )
    excited: tuple[Block, ...] = ()
    filled: tuple[Block, ...] = ()
    if spec.plan is not None:
        plan, scenario = spec.plan, spec.plan.scenario
        folder = f"{ACCEPTANCE_FOLDER}{spec.stage.suffix}"
        steps[1] = (
            f"Take the records below with the controller at {quantity(controller.gain_A_per_V, 'A/V')}, each from rest,"
            f" sampled every {1e3 * scenario.sample_s:g} ms for {scenario.duration_s:g} s. Forces and volts are in"
            f" `{folder}/excitation`, peaks as in the table."
        )
        heads = ("record", "payload", "excitation", "peak", "band")
        excited = (Table(heads, tuple(_excitation(row) for row in scenario.record), "Excitations"),)
        if plan.second_mass:
            words = f"The range is one mass; for the records a second one was chosen: {plan.second_mass}."
            excited = (*excited, Paragraph(words))
        limits = (
            f"Limits are the extremes over rigs drawn from the box of specified tolerances, and"
            f" {100 * MEASURED_WITHIN:g} % for the measurement itself. They are sampled: a rig within the tolerances"
            " could lie a little outside.",
            "No oscillation up to the gain that is called proved: a rig that oscillates below it has a figure outside"
            " its specified tolerance, or something that the model does not have.",
            "Pass: every compliance and every critical gain within its limits. Fail otherwise; then diagnose.",
        )
        filled = _to_fill_in(folder)
    published = (
        "The linear model has no friction, dead band, saturation or air. The published rig of this kind began to"
        " oscillate at 62 to 75 % of the gains its linear model had predicted."
    )
    blocks = (Items(tuple(steps)), *excited, *_expected(spec.acceptance), Items((*limits, published)), *filled)
    return Part("Acceptance test", blocks)


def _expected(rows: tuple[AcceptanceAtMass, ...]) -> tuple[Table, Table]:
    """Compliances over frequency, and critical gains with what holds at the specified one; payload by payload."""
    between = "nominal (computed), and where in brackets pass if between (sampled)"
    compliance = Table(
        ("frequency", *(f"with {quantity(row.outer_end_mass_kg, 'kg')}" for row in rows)),
        (
            ("static", *(quantity(row.static_compliance_m_per_N, "m/N") for row in rows)),
            *(
                (quantity(f, "Hz"), *(_limits(row.compliance_m_per_N[f], "m/N") for row in rows))
                for f in rows[0].compliance_m_per_N
            ),
        ),
        f"Compliance |x/F_d| at the specified gain: {between}",
    )
    gains = Table(
        (
            "payload", "critical gain", "frequency of the oscillation", "no oscillation up to (proved)",
            "bandwidth at the specified gain", "peak sensitivity at it",
        ),
        tuple(
            (
                quantity(row.outer_end_mass_kg, "kg"),
                _limits(row.critical_gain_A_per_V, "A/V", "none: no gain sets in oscillation"),
                _limits(row.oscillation_Hz, "Hz"),
                optional(row.critical_gain_proved_A_per_V, "A/V"),
                quantity(row.bandwidth_Hz, "Hz"),
                decimal(row.peak_sensitivity),
            )
            for row in rows
        ),
        f"Critical gain: {between}; bandwidth and peak sensitivity are nominal",
    )  # fmt: skip
    return compliance, gains


def _limits(band: Band | None, unit: str, none: str = "–") -> str:
    """The nominal value, with limits where the band has a width."""
    if band is None:
        return none
    if band.low == band.high:
        return quantity(band.nominal, unit)
    low, high = (quantity(value, unit, 3).split()[0] for value in band.limits)
    return f"{quantity(band.nominal, unit, 3)} ({low} to {high})"


def _to_fill_in(folder: str) -> tuple[Block, ...]:
    """How to use the data set that waits for the measurements."""
    return (
        Paragraph(
            f"The folder `{folder}` is a data set to fill in: one CSV file per record in `{folder}/records`, whose"
            " column names stand there already (`displacement_m` is the sensor's volts over its believed gain, measured"
            " from rest). Critical gains go into its `dataset.toml`, where lines for them are prepared. Its"
            " `prototype.toml` states as standard deviations what the prototype does, or else the specified tolerances"
            " over √3. Then"
        ),
        Code(f"beamdesign gap diagnose {folder}"),
        Paragraph(
            "says where the rig differs from this specification, and why. To rehearse it with a simulated rig first:"
        ),
        Code(
            f"beamdesign simulate {folder}/prototype.toml --scenario {folder}/scenario.toml --out rehearsal\n"
            "# then copy the CSV files of rehearsal into the records of a copy of the folder"
        ),
    )


def _excitation(row: ScenarioRecord) -> tuple[str, ...]:
    (signal,) = row.input
    peak = f"{signal.amplitude_N:g} N" if getattr(signal, "amplitude_N", None) else f"{signal.amplitude_V:g} V"  # type: ignore[union-attr]
    where = "force on the outer tip" if getattr(signal, "amplitude_N", None) else "command"
    match signal:
        case Multisine():
            words, band = "many sines at once", f"{signal.low_Hz:g} to {signal.high_Hz:g} Hz"
        case LoadSteps():
            words, band = f"steps both ways, {signal.dwell_s:g} s each", f"rise in {1e3 * signal.rise_s:g} ms"
        case _:
            words, band = signal.kind, ""
    return row.name, quantity(row.outer_end_mass_kg, "kg"), f"{where}: {words}", peak, band
