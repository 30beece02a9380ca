"""A document of sections that Markdown and HTML pages are both made from, so that they say the same."""

import re
from dataclasses import dataclass
from typing import NamedTuple


class Paragraph(NamedTuple):
    """Running text; what stands between backticks is code."""

    text: str


class Items(NamedTuple):
    """A list of sentences; backticks as in a paragraph."""

    texts: tuple[str, ...]


class Code(NamedTuple):
    """Lines as they are, in a fixed pitch."""

    text: str


class Table(NamedTuple):
    """Cells of text; backticks as in a paragraph."""

    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""


class Picture(NamedTuple):
    """An SVG element, the file that holds the same beside the document, and what it shows."""

    svg: str
    file: str
    caption: str


Block = Paragraph | Items | Code | Table | Picture


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


def to_markdown(document: Document) -> str:
    """The document as Markdown; pictures are linked as files."""
    lines = [f"# {document.kind}: {_escaped(document.title)}", "", _marked(document.verdict), ""]
    if document.key:
        lines += _table(Table(("", "value"), document.key))
    for part in document.parts:
        lines += [f"## {_escaped(part.title)}", ""]
        for block in part.blocks:
            lines += _block(block)
    return "\n".join(lines).strip() + "\n"


def _block(block: Block) -> list[str]:
    match block:
        case Paragraph(text):
            return [_marked(text), ""]
        case Items(texts):
            return [*(f"- {_marked(text)}" for text in texts), ""]
        case Code(text):
            return [*(f"    {line}" for line in text.splitlines()), ""]
        case Table():
            return _table(block)
        case Picture(_, file, caption):
            return [f"![{_escaped(caption)}]({file})", ""]


def _table(table: Table) -> list[str]:
    lines = [] if not table.caption else [f"{_marked(table.caption)}:", ""]
    lines += [f"| {' | '.join(_marked(head) for head in table.heads)} |", "|" + "---|" * len(table.heads)]
    return [*lines, *(f"| {' | '.join(_marked(cell) for cell in row)} |" for row in table.rows), ""]


def _marked(text: str) -> str:
    """Text on one line, its marks escaped but for code between backticks."""
    pieces = " ".join(text.split()).split("`")
    return "".join(f"`{piece}`" if k % 2 else _escaped(piece) for k, piece in enumerate(pieces))


def _escaped(text: str) -> str:
    return re.sub(r"([\\`*_{}\[\]<>#|!~&])", r"\\\1", text)
