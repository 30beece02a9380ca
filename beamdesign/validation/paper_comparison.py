"""Everything the paper states, recomputed: one result that page, JSON and figures are made from."""

from dataclasses import dataclass
from functools import partial
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any

from beamdesign.files import write_whole
from beamdesign.progress import Progress
from beamdesign.report.canvas import save
from beamdesign.report.page import Document, Picture, document_template, parts_from, to_html
from beamdesign.result import Result, finite, picked
from beamdesign.validation.paper_claims import Bandwidth, Claim, FigureClaim, bandwidths, claims_and_slips
from beamdesign.validation.paper_figures import DRAWINGS, Drawing
from beamdesign.validation.paper_rig import (
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


@dataclass(frozen=True, repr=False)
class Comparison(Result):
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

    @property
    def status(self) -> str:
        """How many numbers agree."""
        return f"{sum(claim.agrees for claim in self.claims)} of {len(self.claims)} numbers agree"

    def rows(self) -> list[tuple[str, object, object, str, str]]:
        """Every number: the paper's, the model's, and why they differ where they do."""
        return [(claim.quantity, claim.paper, claim.model, claim.unit, claim.verdict) for claim in self.claims]

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as `paper` writes them."""
        bandwidth = "case gain_mA_per_V outer_end_mass_kg inner_end_mass_kg paper model"
        claim = "group quantity unit paper model agrees verdict source note"
        fields = {
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
        return finite(fields)


def paper() -> Comparison:
    """Recompute what Zalucky and Hardt (1984) state: critical gains, bandwidths, and every number of their tables."""
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
    by_group = partial(groupby, key=attrgetter("group"))
    template = document_template(Path(__file__).with_name("paper.j2"), n=_number, groupby_in_order=by_group)
    pictures = {one.name: Picture("", one.name, f"Paper: {one.claim} Model: {one.caption}") for one in drawings}
    parts = parts_from(
        template, pictures, comparison=comparison, drawings=drawings, choices=CHOICES, variations=VARIATIONS,
        remedy_gain=_REMEDY_GAIN_MA_PER_V,
    )  # fmt: skip
    return Document("Zalucky and Hardt (1984)", "Paper recomputed", verdict, (), parts, subject="")


def _number(value: float) -> str:
    """Four significant digits, without an exponent where that reads better."""
    return f"{value:.4g}" if value == 0 or 1e-3 <= abs(value) < 1e5 else f"{value:.2e}"
