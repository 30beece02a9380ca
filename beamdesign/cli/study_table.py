"""Tables with long column names: no name is cut; in a terminal as many columns as its width holds."""

import shutil
import sys
from collections.abc import Sequence
from typing import Any

from beamdesign.cli.output import say

_GAP = "  "


def say_wide(title: str, columns: Sequence[str], rows: Sequence[Sequence[Any]], every: bool = False) -> list[str]:
    """Print a table, floats with six significant digits.

    Args:
        title: above it.
        columns: headings.
        rows: cells.
        every: print every column, however wide the terminal; so it is where the output is no terminal.

    Returns:
        the columns that were left out.
    """
    cells = [[_text(value) for value in row] for row in rows]
    widths = [max(len(name), *(len(row[k]) for row in cells), 0) for k, name in enumerate(columns)]
    shown = list(range(len(columns)))
    if not every and sys.stdout.isatty():
        room = shutil.get_terminal_size().columns
        while len(shown) > 2 and sum(widths[k] + len(_GAP) for k in shown) > room:
            shown.pop()
    lines = [[columns[k] for k in shown], ["-" * widths[k] for k in shown], *([row[k] for k in shown] for row in cells)]
    say(title + "\n")
    for line in lines:
        say(_GAP.join(cell.ljust(widths[k]) for cell, k in zip(line, shown, strict=True)).rstrip())
    say("")
    return [columns[k] for k in range(len(columns)) if k not in shown]


def _text(value: Any) -> str:
    return "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
