"""Everything the paper states, recomputed: one result that page, JSON and figures are made from."""

from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from beamdesign.files import write_whole
from beamdesign.json_text import picked
from beamdesign.progress import Progress
from beamdesign.report.canvas import save
from beamdesign.report.page import Block, Document, Items, Paragraph, Part, Picture, Table, to_html
from beamdesign.validation.paper.claims import Bandwidth, Claim, FigureClaim, bandwidths, claims_and_slips
from beamdesign.validation.paper.figures import DRAWINGS, Drawing
from beamdesign.validation.paper.rig import (
    INNER_END_MASS_KG,
    VALVE_DAMPING_RATIO,
    VARIATIONS,
    GainRow,
    gain_rows,
    stable_masses,
)

CHOICES = (
    f"Servovalve damping {VALVE_DAMPING_RATIO}: the paper does not give it. It is the one free constant, and this value"
    " has the predicted critical gains come out.",
    "Beam damping as a fixed dashpot, b = 2 zeta sqrt(K M) of the bare beam: added end mass lowers the damping ratio."
    " The paper does not say; it matters only with mass on the outer beam alone.",
)
"""What the paper leaves open, and how it is settled here."""

_REMEDY_GAIN_MA_PER_V = 150.0


@dataclass(frozen=True)
class Comparison:
    """The paper beside the model.

    Attributes:
        gains: the four critical gains, with their sensitivity to every open choice.
        bandwidths: the three bandwidths.
        claims: every published number, those of the two tables included.
        slips: where the paper contradicts itself, see `claims_and_slips`.
        remedy_crossings: outer end mass (kg) and frequency (Hz) at which the paper's remedy for payload, the lag with
            4.5 kg inside at the measured 150 mA/V, gains or loses stability.
    """

    gains: list[GainRow]
    bandwidths: list[Bandwidth]
    claims: list[Claim]
    slips: list[dict[str, str]]
    remedy_crossings: list[tuple[float, float]]

    def fields(self) -> dict[str, object]:
        """The JSON result."""
        bandwidth = "case gain_mA_per_V outer_end_mass_kg inner_end_mass_kg paper model"
        claim = "group quantity unit paper model agrees verdict source note"
        return {
            "critical_gains": [row.fields() for row in self.gains],
            "bandwidths_Hz": [picked(row, bandwidth) for row in self.bandwidths],
            "claims": [picked(row, claim) for row in self.claims],
            "slips": self.slips,
            "choices": CHOICES,
            "variations": {key: words for key, (words, _) in VARIATIONS.items()},
            "remedy_crossings": [
                {"outer_end_mass_kg": mass, "frequency_Hz": frequency} for mass, frequency in self.remedy_crossings
            ],
        }


def compare() -> Comparison:
    """Recompute everything."""
    gains, widths = gain_rows(), bandwidths()
    crossings = stable_masses(_REMEDY_GAIN_MA_PER_V, INNER_END_MASS_KG)
    return Comparison(gains, widths, *claims_and_slips(gains, widths), crossings)


def write_page(comparison: Comparison, folder: Path, progress: Progress) -> tuple[Path, list[Path], list[FigureClaim]]:
    """Draw the figures and write the page.

    Args:
        comparison: what to show.
        folder: an existing folder; files of the same names are replaced.
        progress: told the share done and what is being drawn.

    Returns:
        the page, the PNG and SVG files of its figures, and what the paper says about these.
    """
    drawings: list[Drawing] = []
    files: list[Path] = []
    for number, draw in enumerate(DRAWINGS):
        progress(number / len(DRAWINGS), draw.__name__.replace("_", " "))
        drawings.append(draw())
        files += save(drawings[-1].figure, folder / drawings[-1].name)
    page = folder / "paper.html"
    write_whole(page, to_html(document_of(comparison, drawings)))
    return page, files, [check for drawing in drawings for check in drawing.checks]


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
        f"The paper adds 4.5 kg inside so that 6.8 kg can be carried. At {_REMEDY_GAIN_MA_PER_V:g} mA/V its own model"
        f" is stable only between {crossings} of mass on the outer beam: with no payload it oscillates."
    )
    slips = tuple(tuple(slip.values()) for slip in comparison.slips)
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
    caption = f"Paper: {drawing.claim} Model: {drawing.caption}"
    picture = Picture("", drawing.name, caption)
    if not drawing.checks:
        return (picture,)
    rows = tuple((check.claim, check.paper, check.model, "yes" if check.holds else "no") for check in drawing.checks)
    marks = tuple("" if check.holds else "fails" for check in drawing.checks)
    return picture, Table(("claim", "paper", "model", "holds"), rows, marks=marks)
