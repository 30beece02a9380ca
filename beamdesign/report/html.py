"""A design run as one self-contained HTML page: no requests, both themes, fit for print."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from beamdesign.design.checks import Check
from beamdesign.design.pair import CheckedPair
from beamdesign.loop import loop
from beamdesign.lumped import notes
from beamdesign.observer import Observer
from beamdesign.prototype import Controller, Proportional, Structured
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
            controller=controller_rows(prototype.controller),
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


def controller_rows(controller: Controller) -> list[tuple[str, str, str]]:
    """Each figure of a controller: name, value in full, what it means."""
    if isinstance(controller, Observer):
        return _matrix_rows(controller)
    rows = [("gain", quantity(controller.gain_A_per_V, "A/V", 7), "K_sa, valve current per error voltage when static")]
    if not isinstance(controller, Proportional):
        above = "gain above the zero" + (", before the sections" if isinstance(controller, Structured) else "")
        drop = controller.pole_Hz / controller.zero_Hz
        rows += [
            ("pole", quantity(controller.pole_Hz, "Hz", 7), "from here up the gain falls"),
            ("zero", quantity(controller.zero_Hz, "Hz", 7), "from here up it stays level again"),
            (
                above,
                quantity(controller.gain_A_per_V * drop, "A/V"),
                f"1/{decimal(1 / drop, 3)} of the static gain",
            ),
        ]
    for k, section in enumerate(controller.section if isinstance(controller, Structured) else (), start=1):
        zero, pole = (
            f"{quantity(frequency, 'Hz', 7)}, damping ratio {decimal(damping, 6)}"
            for frequency, damping in (
                (section.zero_Hz, section.zero_damping_ratio),
                (section.pole_Hz, section.pole_damping_ratio),
            )
        )
        rows += [(f"zeros of section {k}", zero, "numerator"), (f"poles of section {k}", pole, "denominator")]
    return rows


def _matrix_rows(controller: Observer) -> list[tuple[str, str, str]]:
    rows = [
        ("gain", quantity(controller.gain_A_per_V, "A/V", 7), "factor on the whole law"),
        ("sensors", ", ".join(controller.sensors), "e: error volts, then what the others read with its sign turned"),
    ]
    for name, matrix in (("a", controller.a), ("b", controller.b)):
        for i, row in enumerate(matrix, start=1):
            rows.append((f"{name}, row {i}", _listed(row), "z' = a z + b e, in SI"))
    if controller.c:
        rows.append(("c", _listed(controller.c), "current = gain (c z + d e)"))
    return [*rows, ("d", _listed(controller.d), "the same")]


def _listed(row: Sequence[float]) -> str:
    return ", ".join(f"{value:.12g}" for value in row)


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
