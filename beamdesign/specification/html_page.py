"""A document as one self-contained HTML page: no requests, both themes, fit for print."""

from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from beamdesign.specification.document import Document

_STYLE = Path(__file__).parent.parent / "report" / "report.css"


def to_html(document: Document) -> str:
    """The page; texts are escaped, pictures stand in it as they are."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["coded"] = _coded
    css = Markup(_STYLE.read_text(encoding="utf-8"))
    return environment.get_template("specification.html").render(document=document, css=css) + "\n"


def _coded(text: str) -> Markup:
    """Escaped text, with what stands between backticks as code."""
    pieces = str(text).split("`")
    return Markup("").join(
        Markup("<code>") + escape(piece) + Markup("</code>") if k % 2 else escape(piece)
        for k, piece in enumerate(pieces)
    )
