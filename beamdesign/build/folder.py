"""The folder that `beamdesign spec` leaves behind: document, drawing, proofs, data set to fill in.

The words of the document stand in the template `specification.j2`.
"""

import hashlib
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN
from functools import cache, partial
from math import inf
from pathlib import Path
from typing import Any, Literal, NamedTuple

from jinja2 import Template

from beamdesign.build.acceptance import MEASURED_WITHIN, Band, as_specified, bare_modes, write_data_folder
from beamdesign.build.analogue import AnalogueController
from beamdesign.build.circuit import Circuit, part_value
from beamdesign.build.drawing import drawing, dxf_text, missing_geometry, svg_text
from beamdesign.build.ratings import KEPT, held_loads
from beamdesign.build.specification import LawSpecification, Specification
from beamdesign.build.tolerances import LARGEST, SAFETY, why_no_box
from beamdesign.files import fresh_folder, write_whole
from beamdesign.plant.linear_reach import linear_part
from beamdesign.polynomial import nearest
from beamdesign.proofs.certificate import Asked, Certificate, Claim, Guaranteed, as_claims, implies
from beamdesign.proofs.lyapunov import CHANGES_NAME, describe, stages_certificate
from beamdesign.proofs.scope import holds_for
from beamdesign.quantities import (
    at_least,
    at_most,
    compliance_kept,
    decimal,
    masses_text,
    quantity,
    read_in,
    rigs_in_words,
    stated_bandwidth,
    stated_peak,
    stated_range,
    tube_text,
)
from beamdesign.records import to_toml
from beamdesign.report.page import (
    Block,
    Document,
    Paragraph,
    Part,
    Picture,
    document_template,
    parts_from,
    to_html,
    to_markdown,
)
from beamdesign.result import finite, json_text, picked
from beamdesign.structure.arm import left_aside
from beamdesign.structure.lumped import lumped_beam, notes

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
_DIGITS = 7
"""Of the figures of a claim, as of a bandwidth that is guaranteed."""
JSON_NAME = "specification.json"
_RETIRING = (
    "certificate*.toml", "*tolerances*.toml", "delay*.toml", CHANGES_NAME, "drawing.dxf", "drawing.svg",
    "components/*.toml",
)  # fmt: skip
"""Of an earlier specification; what was measured for it stays."""


def document_of(spec: Specification, svg: str = "") -> Document:
    """The specification as a document; where the loop is not stable it says so, and why."""
    kind = "Specification"
    if spec.reason:
        ranges = ", ".join(f"{stated_range(ends)} kg" for ends in _stable_ranges_kg(spec)) or "none"
        found = (("stable ranges within what was asked", ranges), ("foundation", "proved"))
        verdict = f"Nothing is specified: {spec.reason}."
        again = Paragraph(
            "Tune the controller and the inner end mass for the range (`beamdesign tune`), or ask for a range that is"
            " stable with `--outer-end-mass`, then specify again."
        )
        return Document(spec.prototype.name, kind, verdict, found, (Part("What to do", (again,)),))
    reached, masses_kg = spec.guaranteed, masses_text(spec.masses_kg)
    assert reached is not None
    open_between = "; ".join(filter(None, (law.certificate.open_between for law in spec.laws)))
    verdict = (
        f"{holds_for(spec.prototype).capitalize()}: with every mass of {masses_kg} on its outer tip the rig is proved"
        f" stable, {compliance_kept(spec.prototype.goal.compliance_m_per_N, reached.bandwidth_Hz)} and"
        f" keeps its peak sensitivity at {stated_peak(reached.peak_sensitivity)} or below, by the linear model"
        f"{', while the law acts that is for that mass' if spec.prototype.schedule else ''}."
        f"{f' Not proved: {open_between}.' if open_between else ''}"
    )
    stated, wider = spec.prototype.guarantee, []
    if stated is not None and stated.sigmas:
        figures = f"{stated_bandwidth(stated.bandwidth_Hz)}, peak sensitivity {stated_peak(stated.peak_sensitivity)}"
        wider = [(f"stated of {rigs_in_words(stated.sigmas)}", f"{figures}, by {stated.certificate}")]
    key = (
        ("guaranteed bandwidth (proved)", stated_bandwidth(reached.bandwidth_Hz)),
        ("guaranteed peak sensitivity (proved)", stated_peak(reached.peak_sensitivity)),
        ("for outer end masses of", masses_kg),
        *wider,
        ("inner end mass to be added", quantity(spec.prototype.payload.inner_end_mass_kg, "kg")),
        ("load across the tip", quantity(spec.load_N, "N")),
    )

    return Document(spec.prototype.name, kind, verdict, key, parts_of(spec, svg))


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
        texts["drawing_svg"] = ("drawing.svg", svg.replace("var(--ink, #000)", "#000000"))
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
            folders[f"dataset{number}"] = (f"acceptance{end}", law)
    if spec.switching is not None:
        summary = "\n".join((f"{spec.prototype.name}: changes between its laws", *describe(spec.switching)))
        texts["certificate_switching"] = (CHANGES_NAME, stages_certificate(spec.prototype, spec.switching, summary))
    texts["prototype"] = ("prototype.toml", to_toml(spec.prototype))
    texts = {kind: named for kind, named in texts.items() if named[1]}
    paths = {kind: out / name for kind, (name, _) in (*texts.items(), *folders.items())}
    with fresh_folder(out, _RETIRING) as fresh:
        for name, text in texts.values():
            write_whole(fresh / name, text)
        write_whole(fresh / JSON_NAME, json_text(json_fields(spec) | {"files": paths}))
        for name, law in folders.values():
            specified = spec.tolerances.specified if spec.tolerances is not None else {}
            assert law.plan is not None
            write_data_folder(as_specified(law.stage.prototype, specified), law.plan, fresh / name)
    return paths


def json_fields(spec: Specification) -> dict[str, Any]:
    """The specification for programs: everything but the texts of proofs, in SI, with units in the keys.

    What there is of every law stands once for all: that of the law of the least bandwidth, or of the first that is not
    stable. Of several laws that of each stands under `stages`.
    """
    stages = [_of_law(law) for law in spec.laws]
    governs = min(stages, key=lambda one: 0.0 if one["guaranteed"] is None else one["guaranteed"]["bandwidth_Hz"])
    sections = None if spec.stock is None else [finite(one) | {"stock": one.stock.sizes} for one in spec.stock]
    fields = {
        "name": spec.prototype.name,
        "certifiable": not spec.reason,
        "reason": spec.reason,
        **governs,
        "outer_end_mass_kg": spec.masses_kg,
        "stable_ranges_kg": _stable_ranges_kg(spec),
        "guaranteed": _reached(spec.guaranteed),
        "load_N": spec.load_N,
        "sections": sections,
        "drawing": spec.reason or missing_geometry(spec.prototype) or "drawing.dxf",
        "ratings": spec.ratings and spec.ratings.to_dict(),
        **picked(spec, "sensor controller=prototype.controller tolerances tolerances_reason"),
        "basis": BASIS,
        **({} if spec.switching is None else {"switching": spec.switching.to_dict()}),
        **({} if spec.prototype.schedule is None else {"stages": stages}),
    }
    return finite(fields)


def _of_law(law: LawSpecification) -> dict[str, Any]:
    ranges = picked(law, "outer_end_mass_kg=stage.outer_end_mass_kg stable_ranges_kg=certificate.stable_ranges_kg")
    built = "controller=stage.prototype.controller analogue analogue_reason digital acceptance test_plan=plan"
    return ranges | {"guaranteed": _reached(law.certificate.guaranteed)} | picked(law, built)


def _reached(found: Guaranteed | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return picked(found, "bandwidth_Hz peak_sensitivity") | {"basis": "proved", "rigs": "nominal"}


def _stable_ranges_kg(spec: Specification) -> list[tuple[float, float]]:
    return [pair for law in spec.laws for pair in law.certificate.stable_ranges_kg]


def optional(value: float | None, unit: str, rounding: str = ROUND_HALF_EVEN) -> str:
    """A quantity, or a dash where there is none; what is proved is to be rounded to the safe side."""
    return "–" if value is None else quantity(value, unit, rounding=rounding)


def parts_of(spec: Specification, svg: str) -> tuple[Part, ...]:
    """The parts of the document of a specification whose loop is stable; the drawing is left out where it is empty."""

    def files(stem: str) -> str:
        return " and ".join(f"`{stem}{law.stage.suffix}.toml`" for law in spec.laws)

    caption = "Lengthwise section and cross-section; the same drawing is in `drawing.dxf`, in mm"
    drawn: dict[str, Block] = {"drawing": Picture(svg, "drawing.svg", caption)} if svg else {}
    return parts_from(_template(), drawn, spec=spec, files=files)


@cache
def _template() -> Template:
    own = (
        optional, tube_text, nearest, repr, zip, describe, holds_for, missing_geometry, lumped_beam, notes, held_loads,
        why_no_box, bare_modes, circuit_name, schematics, part_names, part_value, limits, nominal, component_reasons,
        stated_bandwidth, linear_part, left_aside,
    )  # fmt: skip
    figures = {
        "inf": inf, "kept": KEPT, "largest": LARGEST, "safety": SAFETY, "measured_within": MEASURED_WITHIN,
        "changes_name": CHANGES_NAME,
    }  # fmt: skip
    return document_template(
        Path(__file__).with_name("specification.j2"),
        *own,
        **figures,
        q=quantity,
        d=decimal,
        floor=partial(optional, rounding=ROUND_FLOOR),
        ceiling=partial(optional, rounding=ROUND_CEILING),
        masses=masses_text,
        sha256=lambda text: hashlib.sha256(text.encode()).hexdigest(),
        answer={True: "proved", False: "refuted", None: "undecided"},
        stage=lambda law: f", stage {law.stage.number}" if law.stage.number else "",
        guaranteed=lambda law: proved_statements(law.certificate, law.stage.prototype.goal.compliance_m_per_N),
        materials=lambda rig: list(
            {beam.material.name: beam.material for beam in (rig.outer_beam, rig.inner_beam)}.values()
        ),
    )


def circuit_name(one: AnalogueController) -> str:
    """The series that its parts are of."""
    capacitors = f", C of {one.circuit.capacitors}" if one.circuit.has_capacitors else ""
    return f"R of {one.circuit.resistors}{capacitors}"


def schematics(found: tuple[AnalogueController, ...]) -> list[tuple[str, Circuit]]:
    """A circuit of each schematic that there is, with the names of those that have it; no names where all have one."""
    alike: dict[object, list[AnalogueController]] = {}
    for one in found:
        layout = [(stage.kind, stage.turned) for stage in one.circuit.stages]
        alike.setdefault((*layout, one.circuit.inverted), []).append(one)
    several = len(alike) > 1
    return [("; ".join(map(circuit_name, those)) if several else "", those[0].circuit) for those in alike.values()]


def part_names(found: tuple[AnalogueController, ...]) -> list[str]:
    """Of all parts, stage by stage, what stands in no stage last."""
    names = {name for one in found for name in one.circuit.parts}
    return sorted(names, key=lambda n: (not n[0].isdigit(), n.partition(".")[0], n))


def limits(band: Band | None, unit: str, without: str = "–") -> str:
    """What is expected of a measurement, and in brackets the limits between which it passes, in the same unit."""
    if band is None:
        return without
    shown, factor = read_in(band.nominal, unit)
    nominal, low, high = (decimal(factor * value, 3) for value in (band.nominal, *band.limits))
    return f"{nominal} {shown} ({low} to {high})"


def nominal(band: Band | None, unit: str, without: str = "–") -> str:
    """What is expected of a measurement that has no limits."""
    return without if band is None else quantity(band.nominal, unit)


def component_reasons(found: tuple[AnalogueController, ...]) -> list[str]:
    """Why components within their tolerances are not proved, each reason once."""
    reasons = (
        f"{circuit_name(one)}, {100 * at.resistors:g} % / {100 * at.capacitor:g} %: {at.verdict}, {at.reason}."
        for one in found
        for at in one.tolerances
        if at.reason
    )
    return list(dict.fromkeys(reasons))


Foundation = Literal["proved", "refuted", "verified numerically", "sampled"]


class Statement(NamedTuple):
    """One claim in words, how well it is founded, and by what."""

    claim: str
    foundation: Foundation
    how: str


def proved_statements(certificate: Certificate, compliance_m_per_N: float) -> list[Statement]:
    """Stability, the guaranteed figures and the further claims of a certificate.

    Args:
        certificate: of a range of outer end masses.
        compliance_m_per_N: the limit that its guaranteed bandwidth refers to.
    """
    masses = certificate.outer_end_mass_kg
    stability = Statement(
        f"stable for every outer end mass of {masses_text(masses)}",
        "proved" if certificate.stable else "refuted",
        "roots of one polynomial isolated in rational arithmetic, one exact Routh test per range",
    )
    claims = list(certificate.claims)
    if best := certificate.guaranteed:
        reached = [
            Asked("compliance", compliance_m_per_N, best.bandwidth_Hz),
            Asked("peak_sensitivity", best.peak_sensitivity),
            Asked("peak_compliance", best.peak_compliance_m_per_N),
        ]
        further = as_claims(reached, masses)
        claims += [claim for claim in further if not any(implies(asked, claim) for asked in certificate.claims)]
    return [stability, *(claimed(claim) for claim in claims)]


def claimed(claim: Claim) -> Statement:
    """A claim of a certificate, decided; its figures are rounded so that what is said of them follows from it."""
    masses = masses_text(claim.outer_end_mass_kg)
    up, down = (at_most, at_least) if claim.holds else (at_least, at_most)

    def most(unit: str = "1") -> str:
        return up(claim.limit, unit, _DIGITS)

    match claim.kind:
        case "compliance":
            words = f"|x/F_d| at most {most('m/N')} at every frequency up to {down(claim.bandwidth_Hz, 'Hz', _DIGITS)}"
        case "peak_compliance":
            words = f"|x/F_d| at most {most('m/N')} at every frequency"
        case "peak_sensitivity":
            words = f"|1/(1+L)| at most {most()} at every frequency"
        case "loop_gain":
            words = f"|L| at most {most()} from {up(claim.from_Hz, 'Hz', _DIGITS)} up"
        case "controller_effort":
            words = f"|C/(1+L)| at most {most('A/V')} at every frequency"
        case "decay_rate":
            words = f"every motion dies out at least as fast as exp(-{down(claim.limit, '1', _DIGITS)} t / s)"
        case "slope":
            where = "without command and load" if claim.for_odd_only else "under any constant command and load"
            words = f"comes to rest from every state while the law's current saturates, {where}"
        case "gain_margin" if claim.limit == 0:
            words = "stable at every lower gain too"
        case "gain_margin":
            nearer = down if claim.limit > 1 else up
            words = f"stable with the gain times every factor from 1 to {nearer(claim.limit, '1', _DIGITS)}"
    how = "polynomial inequality in mass and frequency decided by exact root isolation"
    if not claim.holds:
        how = claim.reason
    return Statement(f"{words}, for every outer end mass of {masses}", "proved" if claim.holds else "refuted", how)
