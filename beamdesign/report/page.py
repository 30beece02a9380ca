"""Pages: all from one base template and style sheet; and documents, which Markdown and HTML are both made from.

A page is self-contained: no requests, both themes, fit for print.

The words of a document stand in a template, which is filled in and read block by block, with an empty line between two:
`## ` begins a part, `- ` an item of a list (lines that go on are indented), `│` a row of a table whose cells it parts,
the first of them its heads, with a caption after `= ` above; four blanks begin a line of code, `@ ` the name of a block
that comes with the template. All else is a paragraph. A head that begins with `>` is that of a column of numbers, one
with `_` of a column that is not broken; what stands before a row is its mark.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined, Template
from markupsafe import Markup, escape

from beamdesign.spelling import in_markdown, one_line

_BAR_IN_CELL = r"\|"  # even in code a bare one would end the cell
_CELL = "│"


def page_template(name: str, *functions: Callable[..., Any], **filters: Callable[..., Any]) -> Template:
    """A template of a page in this folder: as `text_template`, but texts are escaped.

    Args:
        name: of the template's file.
        functions: that the template calls by their own names.
        filters: by the name that the template calls them; `coded` is always there.
    """
    return text_template(Path(__file__).with_name(name), *functions, autoescape=True, coded=_coded, **filters)


def text_template(
    path: Path,
    *functions: Callable[..., Any],
    autoescape: bool = False,
    finalize: Callable[[Any], Any] | None = None,
    **names: Any,
) -> Template:
    """A template: what is missing is an error, blocks leave no blank lines, the last end of line is left out.

    Args:
        path: of the template's file.
        functions: that the template calls by their own names.
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
    names |= {function.__name__: function for function in functions}
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


@dataclass(frozen=True)
class Document:
    """A title, a kind, the answer in a few words, the key figures, and the sections."""

    title: str
    kind: str
    verdict: str
    key: tuple[tuple[str, str], ...]
    parts: tuple[Part, ...]
    subject: str = " of a twin-beam link"
    """What a page says behind the kind, above the title."""
    beside: tuple[str, ...] = ()
    """Files that a page links to at its foot."""

    @property
    def anchored(self) -> dict[str, Part]:
        """The sections by their names in links; of titles that would share one, later ones have a number behind it."""
        found: dict[str, Part] = {}
        for part in self.parts:
            name = re.sub(r"[^a-z0-9]+", "-", part.title.lower()).strip("-")
            names = (name, *(f"{name}-{count}" for count in range(2, len(self.parts) + 2)))
            found[next(one for one in names if one not in found)] = part
        return found

    @property
    def described(self) -> bool:
        """Whether a page tells values under the pointer."""
        return any(isinstance(block, Picture) and block.name for part in self.parts for block in part.blocks)


class _Row(str):
    """A row of a table, whose bars part its cells."""


def _in_line(value: Any) -> str:
    return value if isinstance(value, _Row) else one_line(str(value)).replace(_CELL, "|")


def _row_of(cells: Sequence[Any], mark: str = "") -> _Row:
    return _Row(mark + "".join(f"{_CELL} {_in_line(cell)} " for cell in cells))


def document_template(path: Path, *functions: Callable[..., Any], **names: Any) -> Template:
    """A template of the parts of a document, for `parts_from`: values stay on one line, and none is a mark.

    `row` makes a row of a table of some cells, with its mark where it has one.
    """
    return text_template(path, *functions, finalize=_in_line, row=_row_of, **names)


def parts_from(template: Template, given: Mapping[str, Block], **values: Any) -> tuple[Part, ...]:
    """The parts that a template of a document makes; a block that it names and that is not given is left out."""
    found: list[tuple[str, list[Block]]] = []
    for filled, lines in groupby(template.render(**values).splitlines(), key=lambda line: bool(line.strip())):
        if not filled:
            continue
        first, *more = block = list(lines)
        if first.startswith("## "):
            found.append((first[3:], []))
        elif not first.startswith("@ "):
            found[-1][1].append(_read(first, more, block))
        elif first[2:] in given:
            found[-1][1].append(given[first[2:]])
    return tuple(Part(title, tuple(blocks)) for title, blocks in found)


def _read(first: str, more: list[str], lines: list[str]) -> Block:
    """The block that some lines are."""
    match first[0]:
        case "=":
            return _read_table(more, first[2:])
        case "│":
            return _read_table(lines)
        case "-":
            items = re.split(r"\n- ", "\n".join(lines).removeprefix("- "))
            return Items(tuple(_joined(item.split("\n")) for item in items))
        case " ":
            return Code("\n".join(line[4:] for line in lines))
        case _:
            return Paragraph(_joined(lines))


def _read_table(rows: list[str], caption: str = "") -> Table:
    (_, *heads), *cells = ([cell.strip() for cell in row.split(_CELL)] for row in rows)
    numbers, whole = (tuple(k for k, head in enumerate(heads) if head.startswith(sign)) for sign in (">", "_"))
    marks = tuple(mark for mark, *_ in cells)
    names = tuple(head.removeprefix(">").removeprefix("_").strip() for head in heads)
    return Table(names, tuple(tuple(row[1:]) for row in cells), caption, numbers, whole, marks if any(marks) else ())


def _joined(lines: list[str]) -> str:
    return " ".join(line.strip() for line in lines)


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
    pieces = enumerate(str(text).split("`"))
    return Markup("").join(Markup("<code>%s</code>") % piece if k % 2 else escape(piece) for k, piece in pieces)
