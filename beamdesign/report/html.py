"""A design run as one self-contained HTML page: no requests, both themes, fit for print."""

from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from beamdesign.design.checks import Check
from beamdesign.design.pair import CheckedPair
from beamdesign.loop import loop
from beamdesign.lumped import notes
from beamdesign.report.acceptance import acceptance
from beamdesign.report.foundations import statements
from beamdesign.report.lumped_table import lumped_rows
from beamdesign.report.pictures import Picture, loop_pictures, prototype_picture, trade_picture
from beamdesign.report.price_words import price_words
from beamdesign.report.quantity import at_least, at_most, decimal, mass_range_text, per_cent, quantity, tube_text
from beamdesign.report.readings import readings_json
from beamdesign.report.svg import inline_svg
from beamdesign.report.trade_rows import TradePoint
from beamdesign.study.design_run import DesignRun


def report_html(run: DesignRun, files: dict[str, str], trade: tuple[TradePoint, ...] = ()) -> str:
    """The report of a design run that gave a certified prototype.

    Args:
        run: all of its steps done.
        files: names of the files beside the report, by kind; "certificate" among them.
        trade: proved designs of a front to show this one beside.

    Raises:
        ValueError: where the run has no result; its `reason` says why.
    """
    prototype, certificate = run.prototype, run.certificate
    if prototype is None or certificate is None or prototype.guarantee is None or prototype.controller is None:
        raise ValueError(f"nothing to report: {run.reason or 'the run is not complete'}")
    pictures = [prototype_picture(prototype, run.problem.load.tip_force_N)]
    pictures += loop_pictures(prototype, loop(prototype))
    moving_mass_kg = run.sizing.beam_mass_kg + prototype.payload.inner_end_mass_kg
    if trade:
        pictures.append(trade_picture(trade, prototype.guarantee.bandwidth_Hz, moving_mass_kg))
    expected = acceptance(prototype)
    return (
        _environment()
        .get_template("report.html")
        .render(
            run=run,
            problem=run.problem,
            sizing=run.sizing,
            prototype=prototype,
            guarantee=prototype.guarantee,
            certificate=certificate,
            files=files,
            pictures={picture.name: _inline(picture) for picture in pictures},
            pairs=section_rows(run),
            checks=[check_row(check) for check in sorted(run.sizing.checks, key=lambda check: -check.utilisation)],
            prices=price_words(run.sizing.shadow_prices),
            lumped=lumped_rows(prototype),
            notes=notes(prototype),
            controller=prototype.controller.rows(),
            expected=expected,
            statements=statements(run),
            moving_mass_kg=moving_mass_kg,
        )
    )


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
        rows.append((name + chosen, tube_text(*pair.outer), tube_text(*pair.inner), mass, verdict))
    return rows


def check_row(check: Check) -> tuple[str, str, str, str, bool, float]:
    """Name, value, limit with its sense, utilisation, whether satisfied, and the share of the bar to fill."""
    sense = "at least" if check.at_least else "at most"
    used = check.utilisation
    return (
        check.name,
        quantity(float(check.value), check.unit),
        f"{sense} {quantity(float(check.limit), check.unit)}",
        per_cent(used),
        bool(check.satisfied),
        min(max(used, 0.0), 1.0),
    )


def _inline(picture: Picture) -> Markup:
    # The SVG writer escapes what it is given, so its output is markup.
    caption = Markup("<figcaption>{}</figcaption>").format(picture.caption)
    svg = Markup(inline_svg(picture.figure, picture.name, picture.caption))
    data = readings_json(picture.figure)
    told = Markup('<script type="application/json" class="readings">{}</script>').format(Markup(data)) if data else ""
    return Markup('<figure id="{}">{}{}{}</figure>').format(f"figure-{picture.name}", svg, caption, told)


def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    functions: dict[str, Any] = {"quantity": quantity, "decimal": decimal, "mass_range": mass_range_text}
    functions |= {"at_least": at_least, "at_most": at_most}
    environment.filters.update(functions)
    return environment
