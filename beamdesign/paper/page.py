"""The comparison as a folder: paper.html, paper.json and the figures."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from beamdesign.files import write_whole
from beamdesign.paper.comparison import CHOICES, REMEDY_GAIN_MA_PER_V, Comparison
from beamdesign.paper.drawings import DRAWINGS, Drawing, drawn
from beamdesign.paper.rig import VARIATIONS
from beamdesign.report.canvas import save


@dataclass(frozen=True)
class Written:
    """What was written.

    Attributes:
        page: the HTML page.
        figures: the PNG and SVG files.
    """

    page: Path
    figures: list[Path]


def _number(value: float) -> str:
    """Four significant digits, without an exponent where that reads better."""
    return f"{value:.4g}" if value == 0 or 1e-3 <= abs(value) < 1e5 else f"{value:.2e}"


def write_page(
    comparison: Comparison, folder: Path, update: Callable[[float, str], None] = lambda fraction, text: None
) -> Written:
    """Draw the figures and write the page.

    Args:
        comparison: what to show.
        folder: an existing folder; files of the same names are replaced.
        update: told the share done (0 to 1) and what is being drawn.
    """
    from beamdesign.report.page_template import page_template

    drawings: list[Drawing] = []
    files: list[Path] = []
    for number, draw in enumerate(DRAWINGS):
        update(number / len(DRAWINGS), draw.__name__.replace("_", " "))
        drawing = drawn(draw)
        files += save(drawing.figure, folder / drawing.name)
        drawings.append(drawing)
    page = folder / "paper.html"
    text = page_template(__file__, "page.html", number=_number).render(
        comparison=comparison,
        groups=[(name, list(claims)) for name, claims in groupby(comparison.claims, key=lambda claim: claim.group)],
        choices=CHOICES,
        variations=[(key, words) for key, (words, _) in VARIATIONS.items()],
        remedy_gain=REMEDY_GAIN_MA_PER_V,
        drawings=drawings,
        disagreements=sum(not claim.agrees for claim in comparison.claims),
    )
    write_whole(page, text)
    return Written(page, files)
