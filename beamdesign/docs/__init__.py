"""Pages on the parts of the tool, in Markdown: `beamdesign explain TOPIC` prints one."""

from functools import cache
from pathlib import Path

_HERE = Path(__file__).parent


@cache
def topics() -> dict[str, str]:
    """What there is a page on: name and title of each, in alphabetical order."""
    titles = {}
    for path in sorted(_HERE.glob("*.md")):
        with path.open(encoding="utf-8") as text:
            titles[path.stem] = text.readline().lstrip("# ").strip()
    return titles


def page(topic: str) -> str:
    """The text of a page.

    Args:
        topic: one of `topics`.

    Raises:
        KeyError: where there is no such page.
    """
    if topic not in topics():
        raise KeyError(topic)
    return (_HERE / f"{topic}.md").read_text(encoding="utf-8")
