"""The folder a design run leaves behind: prototype, certificate, report, specification.

The report is one self-contained HTML page: no requests, both themes, fit for print. With each picture go the points of
its curves and their places in the SVG, so that the page can tell values under the pointer.
"""

from functools import cache
from math import isfinite, log10
from pathlib import Path

from jinja2 import Template
from markupsafe import Markup

from beamdesign.build.acceptance import acceptance
from beamdesign.build.folder import document_of
from beamdesign.build.specification import specification_of
from beamdesign.files import write_set
from beamdesign.loop import loop
from beamdesign.parameters import rows_of
from beamdesign.proofs.lyapunov import CHANGES_NAME
from beamdesign.prototype import InStage, Prototype
from beamdesign.quantities import (
    decimal,
    mass_range_text,
    per_cent,
    quantity,
    rigs_in_words,
    stated_bandwidth,
    stated_peak,
    tube_text,
)
from beamdesign.records import to_toml
from beamdesign.report.canvas import inline_svg, readings_json
from beamdesign.report.charts import TradePoint, read_trade
from beamdesign.report.page import (
    Block,
    Document,
    Folded,
    Picture,
    Table,
    document_template,
    parts_from,
    to_html,
    to_markdown,
)
from beamdesign.report.pictures import CaptionedFigure, loop_pictures, prototype_picture, trade_picture
from beamdesign.report.statements import price_words, statements
from beamdesign.structure.lumped import lumped_beam, notes
from beamdesign.synthesis.checks import Check, CheckedPair
from beamdesign.synthesis.design_run import CERTIFICATE_NAME, DesignRun, certificate_name
from beamdesign.synthesis.sizing import Sizing

FILES = {
    "prototype": "prototype.toml",
    "certificate": CERTIFICATE_NAME,
    "report": "report.html",
    "specification": "specification.md",
}
"""Names of the files, by kind."""


def write_result_folder(result: DesignRun, out: Path) -> dict[str, Path]:
    """Write what a run gave, all of it or nothing.

    Args:
        result: a run with a certified prototype.
        out: the folder, made if need be; files of an earlier run are replaced, and a front.csv there is shown in the
            report.

    Returns:
        Paths of the four files, by the keys of `FILES`; of several laws those of each but for the prototype,
        with the suffix of its stage in key and name, and the proof of changes between them.

    Raises:
        OSError: where the folder cannot be made or written to; it is then as it was.
        ValueError: where the run has no result; nothing is written then.
    """
    if result.prototype is None or result.certificate is None:
        raise ValueError(f"no result to write: {result.reason}")
    texts = {"prototype": (FILES["prototype"], to_toml(result.prototype))}
    for law in result.laws or (result,):
        assert law.certificate is not None
        names = {kind: name.replace(".", f"{law.suffix}.") for kind, name in FILES.items()}
        names["prototype"] = FILES["prototype"]
        if over_box := _box_of(law):
            names["certificate_box"] = certificate_name(law.suffix, box=True)
        own = {
            **({"certificate_box": over_box} if over_box else {}),
            "certificate": law.certificate.text,
            "report": report_html(law, names, read_trade(out)),
            "specification": to_markdown(document_of(specification_of(law))),
        }
        texts |= {kind + law.suffix.replace(".", "_"): (names[kind], text) for kind, text in own.items()}
    if result.changes:
        texts["certificate_switching"] = (CHANGES_NAME, result.changes)
    return write_set(out, texts, ("*.stage_*.*", CHANGES_NAME, certificate_name(box=True)))


def report_html(run: DesignRun, files: dict[str, str], trade: tuple[TradePoint, ...] = ()) -> str:
    """The report of a design run that gave a certified prototype.

    Args:
        run: all of its steps done.
        files: names of the files beside the report, by kind; "certificate" among them.
        trade: proved designs of a front to show this one beside.

    Raises:
        ValueError: where the run has no result; its `reason` says why.
    """
    prototype, certificate, sizing = run.prototype, run.certificate, run.sizing
    if prototype is None or certificate is None or prototype.guarantee is None or prototype.controller is None:
        raise ValueError(f"nothing to report: {run.reason or 'the run is not complete'}")
    guarantee, added_kg = prototype.guarantee, prototype.payload.inner_end_mass_kg
    load_N, moving_mass_kg = run.problem.load.tip_force_N, sizing.beam_mass_kg + added_kg
    shown = [prototype_picture(prototype, load_N), *loop_pictures(prototype, loop(prototype))]
    if trade:
        shown.append(trade_picture(trade, guarantee.bandwidth_Hz, moving_mass_kg))
    pictures: dict[str, Block] = {picture.name: _inline(picture) for picture in shown}
    masses = mass_range_text(guarantee.outer_end_mass_kg)
    bandwidth, peak = stated_bandwidth(guarantee.bandwidth_Hz), stated_peak(guarantee.peak_sensitivity)
    verdict = Markup(
        "For {}: with every mass from {} on its outer tip the rig is <strong>{}</strong>, gives way"
        " by no more than {} up to"
        " <strong>{}</strong>, and keeps its peak sensitivity at {} or below; it carries {} with beams of {}."
    ).format(
        rigs_in_words(guarantee.sigmas), masses, "proved stable" if certificate.stable else "not stable",
        quantity(prototype.goal.compliance_m_per_N, "m/N"), bandwidth, peak, quantity(load_N, "N"),
        quantity(sizing.beam_mass_kg, "kg"),
    )  # fmt: skip
    key = (
        ("guaranteed bandwidth", bandwidth),
        ("guaranteed peak sensitivity", peak),
        ("for outer end masses of", masses),
        ("of", rigs_in_words(guarantee.sigmas)),
        ("both beams", quantity(sizing.beam_mass_kg, "kg")),
        ("inner end mass", quantity(added_kg, "kg")),
        ("beams and inner end mass", quantity(moving_mass_kg, "kg")),
    )
    blocks = pictures | {
        "checks": _checks(sizing),
        "certificate": Folded("The certificate in full", _box_of(run) or certificate.text),
    }
    proof = files.get("certificate_box", files["certificate"])
    parts = parts_from(
        _template(), blocks, run=run, prototype=prototype, certificate=certificate, sizing=sizing, guarantee=guarantee,
        files=files, proof=proof, has_trade=bool(trade), prices=price_words(sizing.shadow_prices),
    )  # fmt: skip
    beside = tuple(name for kind, name in files.items() if kind != "report")
    return to_html(Document(prototype.name, "Design report", verdict, key, parts, beside=beside))


def _box_of(run: DesignRun) -> str:
    """The certificate over the box of tolerances; empty where there is none."""
    best = None if run.tuning is None else run.tuning.best
    return "" if best is None or best.over_box is None else best.over_box.certificate


@cache
def _template() -> Template:
    own = (section_rows, lumped_rows, expected_rows, margin_rows, statements, notes)
    return document_template(Path(__file__).with_name("design_report.j2"), *own, q=quantity)


def _checks(sizing: Sizing) -> Table:
    """The checks of the chosen pair, the most used first."""
    rows, marks = [], []
    for check in sorted(sizing.checks, key=lambda check: -check.utilisation):
        name, value, limit, used = check_row(check)
        governs = check.name == sizing.governing
        word = Markup('<span class="{}">{}</span>').format("good" if check.satisfied else "bad", used)
        share = 100 * min(max(check.utilisation, 0.0), 1.0)
        bar = Markup('<span class="bar"><i style="width:{:.1f}%"></i></span>').format(share)
        failing = "" if check.satisfied else Markup('<span class="bad">, fails</span>')
        rows.append((f"{name} (governing)" if governs else name, value, limit, word + failing, bar))
        marks.append("governing" if governs else "")
    heads = ("check", "value", "limit", "used", "")
    return Table(heads, tuple(rows), "Checks of the chosen pair", (1, 3), (2,), tuple(marks))


def section_rows(run: DesignRun) -> list[tuple[str, str, str, str, str]]:
    """The chosen pair of tubes beside the other candidates: what, outer, inner, mass, verdict."""
    sizing = run.sizing
    candidates: list[tuple[str, CheckedPair, str]] = []
    if sizing.free:
        candidates.append(("free sizes", sizing.free.pair, sizing.free.governing))
    if sizing.stock:
        candidates.append(("stock sizes", sizing.stock.pair, sizing.stock.pair.governing))
    if sizing.given:
        candidates.append(("given in the study", sizing.given, sizing.given.governing))
    rows = []
    for name, pair, governing in candidates:
        chosen = " (chosen)" if pair == sizing.chosen else ""
        failing = "; ".join(check.name for check in pair.failing)
        verdict = f"fails {failing}" if failing else f"passes, governed by {governing}"
        mass = quantity(pair.beam_mass_kg, "kg")
        rows.append((name + chosen, tube_text(pair.outer), tube_text(pair.inner), mass, verdict))
    return rows


def check_row(check: Check) -> tuple[str, str, str, str]:
    """Name, value, limit with its sense, and utilisation."""
    value, limit = (quantity(float(one), check.unit) for one in (check.value, check.limit))
    sense = "at least" if check.at_least else "at most"
    return check.name, value, f"{sense} {limit}", per_cent(check.utilisation)


def expected_rows(prototype: Prototype, bounds: tuple[float, float]) -> list[tuple[str, ...]]:
    """Mass, bandwidth, peak sensitivity, static compliance, critical gain and its oscillation, at single masses."""
    return [
        (
            quantity(row.outer_end_mass_kg, "kg"),
            quantity(row.bandwidth_Hz, "Hz"),
            decimal(row.peak_sensitivity),
            quantity(row.static_compliance_m_per_N, "m/N"),
            quantity(row.critical_gain_A_per_V.nominal, "A/V") if row.critical_gain_A_per_V else "∞",
            quantity(row.oscillation_Hz.nominal, "Hz") if row.oscillation_Hz else "–",
        )
        for row in acceptance(prototype, InStage(prototype, bounds).looked_at_kg)
    ]


def margin_rows(prototype: Prototype, bounds: tuple[float, float]) -> list[tuple[str, ...]]:
    """Mass, crossover, phase margin, gain margin each with its frequency, and the least factor, at single masses."""
    closed = loop(prototype)
    rows: list[tuple[str, ...]] = []
    for mass in InStage(prototype, bounds).looked_at_kg:
        found = closed.at(mass).margins()
        up = f"{decimal(found.gain_up)} = {decimal(20 * log10(found.gain_up), 3)} dB"
        rows.append(
            (
                quantity(mass, "kg"),
                *((quantity(found.crossover_Hz, "Hz"), f"{decimal(found.phase_deg)}°", quantity(found.phase_Hz, "Hz"))
                if found.crossover_Hz else ("–", "∞", "–")),
                *((up, quantity(found.critical_frequency_Hz, "Hz")) if isfinite(found.gain_up) else ("∞", "–")),
                f"{decimal(found.gain_down)} times" if found.gain_down else "none",
            )
        )  # fmt: skip
    return rows


def _inline(picture: CaptionedFigure) -> Picture:
    """A figure as it stands in the page, with the values that it tells under the pointer."""
    # The SVG writer escapes what it is given, so its output is markup.
    svg = inline_svg(picture.figure, picture.name, picture.caption)
    if data := readings_json(picture.figure):
        svg += f'<script type="application/json" class="readings">{data}</script>'
    return Picture(svg, "", picture.caption, picture.name)


def lumped_rows(prototype: Prototype) -> list[tuple[str, str, str, str]]:
    """Every figure of the linear model but controller and end masses: name, symbol, value, what it rests on."""
    rows = []
    for name, letter, record in (("outer", "m", prototype.outer_beam), ("inner", "f", prototype.inner_beam)):
        found = lumped_beam(record)
        measured = "measured; it replaces what the geometry gives" if record.has_geometry else "measured"
        stiff, heavy = (
            f"geometry, {equation}" if given is None else measured
            for given, equation in (
                (record.stiffness_N_per_m, "equation (3) on the free length"),
                (record.effective_mass_kg, "equation (5)"),
            )
        )
        damped = f"2 ζ √(K M) of the bare beam, ζ = {record.damping_ratio:g}; it stays as end mass is added"
        rows += [
            (f"{name} tip stiffness", f"K_{letter}", quantity(found.stiffness, "N/m"), stiff),
            (f"{name} effective mass", f"M_{letter}", quantity(found.mass, "kg"), heavy),
            (f"{name} dashpot", f"b_{letter}", quantity(found.damping, "N s/m"), damped),
        ]
    return rows + [
        (
            row.words.removeprefix("the "), row.symbol,
            quantity(value, row.shown_unit) if (value := row.stated(prototype)) else "none", "given",
        )
        for row in rows_of(type(prototype.actuator)).values()
        if row.words
    ]  # fmt: skip
