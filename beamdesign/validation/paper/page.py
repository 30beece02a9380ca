"""The comparison as a folder: paper.html, paper.json and the figures."""

from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from beamdesign.files import write_whole
from beamdesign.progress import Progress
from beamdesign.report.canvas import save
from beamdesign.report.page import Block, Document, Items, Paragraph, Part, Picture, Table, to_html
from beamdesign.validation.paper.comparison import CHOICES, REMEDY_GAIN_MA_PER_V, Comparison
from beamdesign.validation.paper.drawings import DRAWINGS, Drawing, drawn
from beamdesign.validation.paper.rig import VARIATIONS


@dataclass(frozen=True)
class Written:
    """What was written.

    Attributes:
        page: the HTML page.
        figures: the PNG and SVG files.
    """

    page: Path
    figures: list[Path]


def write_page(comparison: Comparison, folder: Path, update: Progress = lambda fraction, text: None) -> Written:
    """Draw the figures and write the page.

    Args:
        comparison: what to show.
        folder: an existing folder; files of the same names are replaced.
        update: told the share done (0 to 1) and what is being drawn.
    """
    drawings: list[Drawing] = []
    files: list[Path] = []
    for number, draw in enumerate(DRAWINGS):
        update(number / len(DRAWINGS), draw.__name__.replace("_", " "))
        drawing = drawn(draw)
        files += save(drawing.figure, folder / drawing.name)
        drawings.append(drawing)
    page = folder / "paper.html"
    write_whole(page, to_html(document_of(comparison, drawings)))
    return Written(page, files)


def document_of(comparison: Comparison, drawings: list[Drawing]) -> Document:
    """Every number of the paper beside the model's, its slips, and its figures drawn again."""
    differing = sum(not claim.agrees for claim in comparison.claims)
    verdict = (
        "A. Zalucky and D. E. Hardt, Active Control of Robot Structure Deflections, ASME Journal of Dynamic Systems,"
        " Measurement, and Control 106 (1984) 63–69. Every number of the paper that its appendix allows to be"
        f" recomputed stands here beside the model's: {len(comparison.claims)} numbers, of which {differing} differ by"
        " more than 5 % and more than the rounding of the print. Critical gains, bandwidths and crossings come from"
        " exact polynomials, not from sweeps."
    )
    crossings = " and ".join(
        f"{mass:.3f} kg (crossing at {hertz:.1f} Hz)" for mass, hertz in comparison.remedy_crossings
    )
    remedy = (
        "The paper adds 4.5 kg inside so that 6.8 kg can be carried. At"
        f" {REMEDY_GAIN_MA_PER_V:g} mA/V its own model is stable only between {crossings} of mass on the outer beam:"
        " with no payload it oscillates."
    )
    slips = tuple((slip.where, slip.printed, slip.read_as, slip.check) for slip in comparison.slips)
    drawn_from = (
        "Drawn from the model; where the paper says in words what its figure shows, that is marked. Its root locus,"
        " Bode diagrams and measured points are not published as numbers."
    )
    parts = (
        Part("Two choices the paper leaves open", (Items(CHOICES),)),
        Part("Critical gains", _gains(comparison)),
        Part("The remedy needs its payload", (Paragraph(remedy),)),
        Part("Number by number", _claims(comparison)),
        Part("Slips of the paper", (Table(("where", "printed", "read here as", "recomputed"), slips),)),
        Part("Figures", (Paragraph(drawn_from), *(block for one in drawings for block in _figure(one)))),
    )
    return Document("Zalucky and Hardt (1984)", "Paper recomputed", verdict, (), parts, subject="")


def _number(value: float) -> str:
    """Four significant digits, without an exponent where that reads better."""
    return f"{value:.4g}" if value == 0 or 1e-3 <= abs(value) < 1e5 else f"{value:.2e}"


def _gains(comparison: Comparison) -> tuple[Block, ...]:
    rows = comparison.gains
    whole = tuple(
        (
            row.case.name,
            *map(_number, (row.case.predicted_mA_per_V, row.case.measured_mA_per_V, row.model_mA_per_V)),
            _number(row.model.frequency_Hz),
        )
        for row in rows
    )
    varied = (
        ("as above", *(_number(row.model_mA_per_V) for row in rows)),
        *((words, *(_number(row.varied_mA_per_V[key]) for row in rows)) for key, (words, _) in VARIATIONS.items()),
        ("paper, measured", *(_number(row.case.measured_mA_per_V) for row in rows)),
        (
            "share of the distance to the measurement that filter and smaller side close",
            *(f"{100 * row.explained:.0f} %" for row in rows),
        ),
    )
    heads = ("case", "paper, predicted", "paper, measured", "model", "oscillation, Hz")
    return (
        Table(heads, whole, "Critical gains, mA/V", numbers=(1, 2, 3, 4)),
        Table(
            ("model", *(row.case.name for row in rows)),
            varied,
            "The model's critical gain under other choices, one at a time, mA/V",
            numbers=(1, 2, 3, 4),
        ),
    )


def _claims(comparison: Comparison) -> tuple[Block, ...]:
    tables = []
    for group, found in groupby(comparison.claims, key=lambda claim: claim.group):
        claims = list(found)
        rows = tuple(
            (c.quantity, _number(c.paper), _number(c.model), c.unit, c.verdict, c.source, c.note) for c in claims
        )
        heads = ("quantity", "paper", "model", "unit", "verdict", "where", "note")
        marks = tuple("" if claim.agrees else "differs" for claim in claims)
        tables.append(Table(heads, rows, group[:1].upper() + group[1:], (1, 2), marks=marks))
    return tuple(tables)


def _figure(drawing: Drawing) -> tuple[Block, ...]:
    caption = f"{drawing.title}. Paper: {drawing.claim} Model: {drawing.caption}"
    picture = Picture("", drawing.name, caption)
    if not drawing.checks:
        return (picture,)
    rows = tuple((check.claim, check.paper, check.model, "yes" if check.holds else "no") for check in drawing.checks)
    marks = tuple("" if check.holds else "fails" for check in drawing.checks)
    return picture, Table(("claim", "paper", "model", "holds"), rows, marks=marks)
