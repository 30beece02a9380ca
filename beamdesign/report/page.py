"""Pages: all from one base template and style sheet; and documents, which Markdown and HTML are both made from.

A page is self-contained: no requests, both themes, fit for print.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined, Template
from markupsafe import Markup, escape

from beamdesign.spelling import in_markdown, one_line

_BAR_IN_CELL = r"\|"  # even in code a bare one would end the cell


def page_template(name: str, **filters: Callable[..., Any]) -> Template:
    """A template of a page in this folder: as `text_template`, but texts are escaped.

    Args:
        name: of the template's file.
        filters: by the name that the template calls them; `coded` is always there.
    """
    return text_template(Path(__file__).with_name(name), autoescape=True, coded=_coded, **filters)


def text_template(
    path: Path, autoescape: bool = False, finalize: Callable[[Any], Any] | None = None, **names: Any
) -> Template:
    """A template: what is missing is an error, blocks leave no blank lines, the last end of line is left out.

    Args:
        path: of the template's file.
        autoescape: whether texts are escaped.
        finalize: what is done to every value before it is written.
        names: of the template, as values and as filters.
    """
    environment = Environment(
        loader=FileSystemLoader(path.parent),
        autoescape=autoescape,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=finalize,
    )
    environment.globals |= names
    environment.filters |= names
    return environment.get_template(path.name)


class Paragraph(NamedTuple):
    """Running text; what stands between backticks is code."""

    text: str


class Items(NamedTuple):
    """A list of sentences; backticks as in a paragraph."""

    texts: tuple[str, ...]


class Code(NamedTuple):
    """Lines as they are, in a fixed pitch."""

    text: str


class Folded(NamedTuple):
    """Lines as they are, which a page shows when asked to."""

    summary: str
    text: str


class Table(NamedTuple):
    """Cells of text; backticks as in a paragraph.

    On a page columns of `numbers` are set to the right and those of `whole` not broken, and rows have their marks.
    """

    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    numbers: tuple[int, ...] = ()
    whole: tuple[int, ...] = ()
    marks: tuple[str, ...] = ()


class Picture(NamedTuple):
    """An SVG element, the file that holds the same beside the document, and what it shows.

    Without an element a page shows the file, whose name is then without suffix: FILE.png, which links to FILE.svg.
    """

    svg: str
    file: str
    caption: str
    name: str = ""
    """Of the picture in links; one with a name tells its values under the pointer."""


Block = Paragraph | Items | Code | Folded | Table | Picture


@dataclass(frozen=True)
class Part:
    """A section: its title and what stands in it."""

    title: str
    blocks: tuple[Block, ...]

    @property
    def anchor(self) -> str:
        """Name of the section in links."""
        return re.sub(r"[^a-z0-9]+", "-", self.title.lower()).strip("-")


@dataclass(frozen=True)
class Document:
    """A title, a kind, the answer in a few words, the key figures, and the sections."""

    title: str
    kind: str
    verdict: str
    key: tuple[tuple[str, str], ...]
    parts: tuple[Part, ...]
    subject: str = " of a twin-beam link"
    beside: tuple[str, ...] = ()
    """Files that a page links to at its foot."""

    @property
    def about(self) -> str:
        """What a page calls it above its title."""
        return f"{self.kind}{self.subject}"

    @property
    def described(self) -> bool:
        """Whether a page tells values under the pointer."""
        return any(isinstance(block, Picture) and block.name for part in self.parts for block in part.blocks)


def to_markdown(document: Document) -> str:
    """The document as Markdown; pictures are linked as files."""
    lines = [f"# {document.kind}: {in_markdown(document.title)}", "", _marked(document.verdict), ""]
    if document.key:
        lines += _table(Table(("", "value"), document.key))
    for part in document.parts:
        lines += [f"## {in_markdown(part.title)}", ""]
        for block in part.blocks:
            lines += _block(block)
    return "\n".join(lines).strip() + "\n"


def _block(block: Block) -> list[str]:
    match block:
        case Paragraph(text):
            return [_marked(text), ""]
        case Items(texts):
            return [*(f"- {_marked(text)}" for text in texts), ""]
        case Code(text) | Folded(_, text):
            return [*(f"    {line}" for line in text.splitlines()), ""]
        case Table():
            return _table(block)
        case Picture(_, file, caption, _):
            return [f"![{in_markdown(caption)}]({file})", ""]


def _table(table: Table) -> list[str]:
    lines = [] if not table.caption else [f"{_marked(table.caption)}:", ""]
    lines += [_row(table.heads), "|" + "---|" * len(table.heads)]
    return [*lines, *(_row(row) for row in table.rows), ""]


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(_marked(cell, bar=_BAR_IN_CELL) for cell in cells)} |"


def _marked(text: str, bar: str = "|") -> str:
    """Text on one line, its marks escaped but for code between backticks, in which bars are written as given."""
    pieces = re.split(r"`([^`]+)`", " ".join(text.split()))
    return "".join(
        f"`{one_line(piece).replace('|', bar)}`" if k % 2 else in_markdown(piece) for k, piece in enumerate(pieces)
    )


def to_html(document: Document) -> str:
    """The page; texts are escaped, pictures stand in it as they are."""
    return page_template("page.html").render(document=document) + "\n"


def _coded(text: str) -> Markup:
    """Escaped text, with what stands between backticks as code; markup stays as it is."""
    if isinstance(text, Markup):
        return text
    pieces = str(text).split("`")
    return Markup("").join(
        Markup("<code>") + escape(piece) + Markup("</code>") if k % 2 else escape(piece)
        for k, piece in enumerate(pieces)
    )
