"""The folder a design run leaves behind: prototype, certificate, report, specification.

The report is one self-contained HTML page: no requests, both themes, fit for print. With each picture go the points of
its curves and their places in the SVG, so that the page can tell values under the pointer.
"""

from collections.abc import Iterator
from functools import cache
from math import isfinite, log10
from pathlib import Path

from jinja2 import Template
from markupsafe import Markup

from beamdesign.build.acceptance import acceptance
from beamdesign.build.folder import Foundation, Statement, claimed, document_of, proved_statements
from beamdesign.build.specification import specification_of
from beamdesign.files import write_set
from beamdesign.loop import loop
from beamdesign.parameters import rows_of
from beamdesign.proofs.lyapunov import CHANGES_NAME
from beamdesign.prototype import InStage, Prototype
from beamdesign.quantities import decimal, masses_text, per_cent, quantity, rigs_in_words, stated_bandwidth, stated_peak
from beamdesign.records import to_toml
from beamdesign.report.canvas import in_page
from beamdesign.report.charts import TradePoint, read_trade
from beamdesign.report.page import Block, Document, Folded, Table, document_template, parts_from, to_html, to_markdown
from beamdesign.report.pictures import loop_pictures, prototype_picture, trade_picture
from beamdesign.structure.lumped import lumped_beam, notes
from beamdesign.synthesis.checks import REQUIREMENTS, Check
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
        shown.append(trade_picture(trade, guarantee, moving_mass_kg))
    pictures: dict[str, Block] = {one.name: in_page(one.figure, one.name, one.caption, hover=True) for one in shown}
    masses = masses_text(guarantee.outer_end_mass_kg)
    bandwidth, peak = stated_bandwidth(guarantee.bandwidth_Hz), stated_peak(guarantee.peak_sensitivity)
    verdict = Markup(
        "For {}: with every mass of {} on its outer tip the rig is <strong>{}</strong>, gives way"
        " by no more than {} up to"
        " <strong>{}</strong>, and keeps its peak sensitivity at {} or below. With exactly the figures stated it"
        " carries {} with beams of {}."
    ).format(
        rigs_in_words(guarantee.sigmas), masses, "proved stable" if certificate.stable else "not stable",
        quantity(prototype.goal.compliance_m_per_N, "m/N", 15), bandwidth, peak, quantity(load_N, "N"),
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
    own = (lumped_rows, expected_rows, margin_rows, statements, notes)
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
        crossing, up = ("–", "∞", "–"), ("∞", "–")
        if found.crossover_Hz:
            phase = f"{decimal(found.phase_deg)}°", quantity(found.phase_Hz, "Hz")
            crossing = quantity(found.crossover_Hz, "Hz"), *phase
        if isfinite(found.gain_up):
            factor = f"{decimal(found.gain_up)} = {decimal(20 * log10(found.gain_up), 3)} dB"
            up = factor, quantity(found.critical_frequency_Hz, "Hz")
        down = f"{decimal(found.gain_down)} times" if found.gain_down else "none"
        rows.append((quantity(mass, "kg"), *crossing, *up, down))
    return rows


def lumped_rows(prototype: Prototype) -> list[tuple[str, str, str, str]]:
    """Every figure of the linear model but controller and end masses: name, symbol, value, what it rests on."""
    rows = []
    for name, letter, record in (("outer", "m", prototype.outer_beam), ("inner", "f", prototype.inner_beam)):
        found = lumped_beam(record)
        measured = "measured; it replaces what the geometry gives" if record.geometry else "measured"
        stiff = "geometry, equation (3) on the free length" if record.stiffness_N_per_m is None else measured
        heavy = "geometry, equation (5)" if record.effective_mass_kg is None else measured
        damped = f"2 ζ √(K M) of the bare beam, ζ = {record.damping_ratio:g}; it stays as end mass is added"
        rows += [
            (f"{name} tip stiffness", f"K_{letter}", quantity(found.stiffness, "N/m"), stiff),
            (f"{name} effective mass", f"M_{letter}", quantity(found.mass, "kg"), heavy),
            (f"{name} dashpot", f"b_{letter}", quantity(found.damping, "N s/m"), damped),
        ]
    for row in rows_of(type(prototype.actuator)).values():
        if row.words:
            value = row.stated(prototype)
            text = quantity(value, row.shown_unit) if value else "none"
            rows.append((row.words.removeprefix("the "), row.symbol, text, "given"))
    return rows


_BOX = "zero exclusion by branch and bound, each piece in ball arithmetic"
_VERIFIED: Foundation = "verified numerically"


def statements(run: DesignRun) -> Iterator[Statement]:
    """Everything the report of a run claims, the best founded first."""
    best = run.tuning and run.tuning.best
    if run.tuning and best and best.over_box:
        rigs = f"and {rigs_in_words(best.sigmas)}"
        for asked in best.over_box.claims:
            claim = claimed(asked.decided(run.tuning.outer_end_mass_kg, True)).claim
            yield Statement(f"{claim} {rigs}", "proved", _BOX)
    if run.certificate:
        for one in proved_statements(run.certificate, run.problem.goal.compliance_m_per_N):
            yield one._replace(claim=f"{one.claim}, of {rigs_in_words(0.0)}")
    sizing = run.sizing
    claim, passes = f"the chosen sections pass all {len(sizing.checks)} structural checks", sizing.feasible
    yield Statement(claim, _VERIFIED if passes else "refuted", "closed formulas in floating point")
    if run.holding:
        unasked = f"; not asked for want of figures: {', '.join(run.holding.missing)}" if run.holding.missing else ""
        how = f"closed formulas and the linear loop on a grid of frequencies{unasked}"
        held = f"{run.holding.held}, the link level, and the tubes do not touch"
        claim = f"the actuator holds {held}, of {rigs_in_words(0.0)}"
        yield Statement(claim, "refuted" if run.holding.missed else _VERIFIED, how)
        if modes := run.holding.all_modes:
            claim = f"the gain lies below the critical one of all bending modes of both beams, {modes.figures[1]}"
            how = "exact beams on a grid of frequencies; proofs have one mode per beam"
            yield Statement(claim, _VERIFIED if modes.met else "refuted", how)
    if sizing.stock:
        how = f"all {sizing.stock.pairs} pairs were checked"
        yield Statement("no lighter pair of the stock list passes", _VERIFIED, how)
    if free := sizing.free:
        how = f"residual {free.kkt_residual:.1e}, from the gradients and not from the solver"
        yield Statement("the free optimum fulfils the first-order conditions", _VERIFIED, how)
        how = f"{free.starts_agreeing} of {free.starts} local searches ended at the same mass"
        yield Statement("no lighter pair of free sizes exists", "sampled", how)
    how = "roots of polynomials with error bounds at those masses, nothing swept in frequency"
    yield Statement("critical gains, margins and bandwidths at single masses", _VERIFIED, how)
    if run.tuning and best:
        count = len(run.tuning.starts)
        searches = f"the best of {count} local searches" if count > 1 else "a local search"
        how = f"{searches} from a coarse one; that it is the best is not proved"
        yield Statement("no other controller of this kind guarantees more", "sampled", how)
    yield Statement("the curves between the points drawn", "sampled", "grids of frequencies and masses")


NEGLIGIBLE_KG = 1e-6
"""Prices below this are called none."""


def price_words(prices: dict[str, float]) -> list[str]:
    """One sentence per requirement that has a price, the dearest first, and one that names those that have none.

    Args:
        prices: kg per unit, by names such as "tip_force_kg_per_percent".
    """
    asked = {one.price: one for one in REQUIREMENTS.values() if one.price in prices}
    dear = sorted((name for name in asked if abs(prices[name]) > NEGLIGIBLE_KG), key=lambda name: -abs(prices[name]))
    said = []
    for name in dear:  # of changes so small that a slope is a fair account of them
        step, share = ("0.1 mm more", 0.1) if asked[name].share is None else ("1 % more", 1.0)
        effect = f"{'costs' if prices[name] > 0 else 'saves'} {decimal(abs(prices[name]) * share, 3)} kg"
        said.append(f"{step} {asked[name].words} {effect} of beam mass.")
    free = [one.words for name, one in asked.items() if name not in dear]
    if free:
        said.append(f"A little more or less of these changes nothing: {', '.join(free)}.")
    return said
