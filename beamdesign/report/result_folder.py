"""The folder a design run leaves behind: prototype, certificate, report, specification.

The report is one self-contained HTML page: no requests, both themes, fit for print. With each picture go the points of
its curves and their places in the SVG, so that the page can tell values under the pointer.
"""

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from beamdesign.design.checks import Check
from beamdesign.design.pair import CheckedPair
from beamdesign.files import write_set
from beamdesign.loop import loop
from beamdesign.lumped import LumpedBeam, lumped_beam, notes
from beamdesign.proof.lyapunov import CHANGES_NAME
from beamdesign.prototype import Beam, InStage, Prototype
from beamdesign.records import to_toml
from beamdesign.report.canvas import inline_svg
from beamdesign.report.page import page_template, to_markdown
from beamdesign.report.pictures import Picture, loop_pictures, prototype_picture, trade_picture
from beamdesign.report.quantity import at_least, at_most, decimal, mass_range_text, per_cent, quantity, tube_text
from beamdesign.report.statements import price_words, statements
from beamdesign.report.trade import TradePoint, read_trade
from beamdesign.specification.acceptance import acceptance
from beamdesign.specification.folder import document_of
from beamdesign.specification.specification import specification_of
from beamdesign.study.design_run import CERTIFICATE_NAME, DesignRun

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
        own = {
            "certificate": law.certificate.text,
            "report": report_html(law, names, read_trade(out)),
            "specification": to_markdown(document_of(specification_of(law))),
        }
        texts |= {kind + law.suffix.replace(".", "_"): (names[kind], text) for kind, text in own.items()}
    if result.changes:
        texts["certificate_switching"] = (CHANGES_NAME, result.changes)
    return write_set(out, texts, ("*.stage_*.*", CHANGES_NAME))


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
    return page_template(
        "report.html",
        quantity=quantity,
        decimal=decimal,
        mass_range=mass_range_text,
        at_least=at_least,
        at_most=at_most,
    ).render(
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
        expected=expected_rows(prototype, prototype.guarantee.outer_end_mass_kg),
        statements=statements(run),
        moving_mass_kg=moving_mass_kg,
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


def _inline(picture: Picture) -> Markup:
    # The SVG writer escapes what it is given, so its output is markup.
    caption = Markup("<figcaption>{}</figcaption>").format(picture.caption)
    svg = Markup(inline_svg(picture.figure, picture.name, picture.caption))
    data = readings_json(picture.figure)
    told = Markup('<script type="application/json" class="readings">{}</script>').format(Markup(data)) if data else ""
    return Markup('<figure id="{}">{}{}{}</figure>').format(f"figure-{picture.name}", svg, caption, told)


class LumpedRow(NamedTuple):
    """One figure of the linear model; `source` says what it rests on."""

    name: str
    symbol: str
    value: str
    source: str


def lumped_rows(prototype: Prototype) -> list[LumpedRow]:
    """Every figure of the linear model but controller and end masses."""
    actuator, valve, sensor = prototype.actuator, prototype.servovalve, prototype.sensor
    rows = []
    for name, suffix, record in (("outer", "m", prototype.outer_beam), ("inner", "f", prototype.inner_beam)):
        rows += _beam_rows(name, suffix, record, lumped_beam(record))
    rows += [
        LumpedRow("oil spring", "K_c", quantity(actuator.oil_stiffness_N_per_m, "N/m"), "given"),
        LumpedRow("piston area", "A", quantity(actuator.piston_area_m2, "m2"), "given, mean of both sides"),
        LumpedRow("valve flow gain", "K_q", quantity(valve.flow_gain_m3_per_s_per_A, "m3/s/A"), "given"),
        LumpedRow("leakage", "K_pq", quantity(valve.leakage_m3_per_s_per_Pa, "m3/s/Pa"), "given"),
        LumpedRow("valve natural frequency", "f_n", quantity(valve.natural_frequency_Hz, "Hz"), "given"),
        LumpedRow("valve damping ratio", "ξ", quantity(valve.damping_ratio, "1"), "given"),
        LumpedRow("sensor gain", "F", quantity(sensor.gain_V_per_m, "V/m"), "given"),
    ]
    filtered = quantity(sensor.filter_Hz, "Hz") if sensor.filter_Hz else "none"
    return [*rows, LumpedRow("sensor filter", "", filtered, "given")]


def _beam_rows(name: str, suffix: str, record: Beam, lumped: LumpedBeam) -> list[LumpedRow]:
    def source(measured: float | None, equation: str) -> str:
        if measured is None:
            return f"geometry, {equation}"
        return "measured; it replaces what the geometry gives" if record.has_geometry else "measured"

    return [
        LumpedRow(
            f"{name} tip stiffness",
            f"K_{suffix}",
            quantity(lumped.stiffness, "N/m"),
            source(record.stiffness_N_per_m, "equation (3) on the free length"),
        ),
        LumpedRow(
            f"{name} effective mass",
            f"M_{suffix}",
            quantity(lumped.mass, "kg"),
            source(record.effective_mass_kg, "equation (5)"),
        ),
        LumpedRow(
            f"{name} dashpot",
            f"b_{suffix}",
            quantity(lumped.damping, "N s/m"),
            f"2 ζ √(K M) of the bare beam, ζ = {record.damping_ratio:g}; it stays as end mass is added",
        ),
    ]


_FEWEST_POINTS, _MOST_POINTS = 12, 160
_SVG_DPI = 72


def readings(figure: Figure) -> list[dict[str, Any]]:
    """Curves of a figure that was last drawn by saving it as SVG: each way of drawing lays out a little differently.

    Returns:
        per curve its name in the legend (empty without one), the labels of its axes, and up to 160 points
        `[x in the SVG, y in the SVG, value along x, value along y]` within the frame.
    """
    found = []
    for axes in figure.axes:
        for line in axes.lines:
            if points := _points(axes, line, _SVG_DPI / figure.dpi, figure.bbox.height):
                label = str(line.get_label())
                name = "" if label.startswith("_") else label
                found.append({"name": name, "x": _horizontal(axes), "y": axes.get_ylabel(), "points": points})
    return found


def readings_json(figure: Figure) -> str:
    """The same as JSON that may stand inside a script element; empty where there is no curve."""
    found = readings(figure)
    return json.dumps(found, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c") if found else ""


def _horizontal(axes: Axes) -> str:
    """Label of the horizontal axis, which axes that share it leave to the lowest."""
    own = axes.get_xlabel()
    shared = [other.get_xlabel() for other in axes.get_shared_x_axes().get_siblings(axes)]
    return own or next((label for label in shared if label), "")


def _points(axes: Axes, line: Line2D, scale: float, height: float) -> list[list[float]]:
    if line.get_linestyle() in ("None", "none", " ", "") or len(np.atleast_1d(line.get_xdata())) < _FEWEST_POINTS:
        return []
    values = np.column_stack([np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)])
    with np.errstate(divide="ignore", invalid="ignore"):
        places = line.get_transform().transform(values)
    frame = axes.bbox
    inside = np.isfinite(places).all(axis=1) & np.isfinite(values).all(axis=1)
    inside[inside] = [bool(frame.contains(x, y)) for x, y in places[inside]]
    chosen = np.nonzero(inside)[0]
    if len(chosen) > _MOST_POINTS:
        chosen = chosen[np.unique(np.linspace(0, len(chosen) - 1, _MOST_POINTS).astype(int))]
    return [
        [round(float(scale * x), 1), round(float(scale * (height - y)), 1), float(f"{a:.5g}"), float(f"{b:.5g}")]
        for (x, y), (a, b) in zip(places[chosen], values[chosen], strict=True)
    ]
