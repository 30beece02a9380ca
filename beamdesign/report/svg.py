"""A matplotlib figure as SVG inside an HTML page: valid XML, identifiers of its own, greys that follow the theme."""

import re
from io import StringIO
from xml.sax.saxutils import quoteattr

import matplotlib
from matplotlib.figure import Figure

from beamdesign.spelling import one_line

_GREY = re.compile(r"#([0-9a-fA-F]{2})\1\1\b")


def inline_svg(figure: Figure, name: str, description: str) -> str:
    """Give the `<svg>` element of a figure.

    Greys become shares of the CSS variables `--ink` and `--paper` (black is ink, white is paper), so that the page
    decides what is dark; colours stay. Text stays text.

    Args:
        figure: to be shown; nothing about it changes.
        name: put before each identifier, so that figures on one page do not refer to each other's parts.
        description: read out instead of the picture.
    """
    buffer = StringIO()
    with matplotlib.rc_context({"svg.hashsalt": name, "svg.fonttype": "none"}):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', text)
    text = re.sub(r'href="#([^"]+)"', rf'href="#{name}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", text)
    text = _GREY.sub(_themed, text)
    # Sizes come from the page; the view box keeps the proportions.
    head, rest = text.split(">", 1)
    width = re.search(r'width="([0-9.]+)pt"', head)
    head = re.sub(r' (width|height)="[^"]*"', "", head)
    style = f' style="max-width:{float(width[1]) * 4 / 3:.0f}px"' if width else ""
    return f'{head} role="img" aria-label={quoteattr(one_line(description))}{style}>{rest.strip()}'


def _themed(match: re.Match[str]) -> str:
    ink = 1 - int(match[1], 16) / 255
    if ink == 1:
        return "var(--ink)"
    if ink == 0:
        return "var(--paper)"
    return f"color-mix(in srgb, var(--ink) {100 * ink:.0f}%, var(--paper))"
