"""Texts that a user has chosen, such as names: what is refused when they are read, and how each language spells them.

A character that would mean something to a language, or do something to a terminal, is written as <U+001B>.
"""

import re
from typing import Any

LONGEST = 200
"""Characters of a text in a record; names of files may be longer."""
_ROOM = 20

_UNFIT = r"\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff\ufffe\uffff"
"""Control characters, ends of lines, marks that turn the direction of what follows, and what is no character."""
_MARKDOWN = re.compile(r"[\\`*_{}\[\]<>#|!~&$]|:(?=//)|(?<=[wW]{3})\.")
_BEGINS_BLOCK = re.compile(r"^(\s*)(?:(\d{1,9})(?=[.)](?:\s|$))|(?=[-+=](?![\d.])))")


def fault(text: str, longest: int = LONGEST) -> str:
    """What keeps a text from being one line of at most so many characters, in words; empty where nothing does."""
    if found := re.search(f"[{_UNFIT}]", text):
        return f"must be one line without control characters, holds U+{ord(found[0]):04X} at place {found.start() + 1}"
    return f"must hold at most {longest} characters, holds {len(text)}" if len(text) > longest else ""


def shorter(name: str) -> str:
    """A name cut so that it may stand in a longer one, with up to twenty characters of words beside it."""
    return name[: LONGEST - _ROOM]


def one_line(text: str) -> str:
    """For a terminal, a comment of TOML or the text of XML."""
    return _spelt(f"[{_UNFIT}]", text)


def in_c(text: str) -> str:
    """For a comment of C: ASCII without what ends a comment, continues a line or is part of a trigraph."""
    return _spelt(r"[^ -~]|[*\\?]", text)


def in_dxf(text: str) -> str:
    r"""For a TEXT of DXF, where %%, ^ and \ begin codes."""
    return _spelt(rf"[{_UNFIT}\\^]|%(?=%)", text)


def in_plot(text: str) -> str:
    """For matplotlib: no formula between dollars, and no label that its legend would leave out."""
    text = one_line(text).replace("$", r"\$")
    return f" {text}" if text.startswith("_") else text


def in_markdown(text: str) -> str:
    """For Markdown, where it stands in a line or begins one: nothing in it is a mark."""
    escaped = _MARKDOWN.sub(r"\\\g<0>", one_line(re.sub(r"\s+", " ", text)))
    return _BEGINS_BLOCK.sub(r"\1\2\\", escaped)


def in_csv(cell: Any) -> Any:
    """For a table that a spreadsheet may open: no text is a formula; numbers and lists of them stay as they are."""
    if not isinstance(cell, str) or not cell.startswith(("=", "+", "-", "@")):
        return cell
    try:
        return [float(part) for part in cell.split(";")] and cell
    except ValueError:
        return f"'{cell}"


def _spelt(pattern: str, text: str) -> str:
    return re.sub(pattern, lambda found: f"<U+{ord(found[0]):04X}>", text)
