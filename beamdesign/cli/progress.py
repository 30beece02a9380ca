"""Progress bars for work of more than two seconds, on stderr and only where that is a terminal."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from beamdesign.cli.interruption import pass_on


@contextmanager
def display(description: str) -> Iterator[Callable[[float, str], None]]:
    """Show a bar while the block runs.

    Yields:
        update(fraction, text): the share done, 0 to 1, and a word on what is being done.
    """
    console = Console(stderr=True, no_color="NO_COLOR" in os.environ)
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[note]}"))
    with Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=console, transient=True) as bar:
        task = bar.add_task(description, total=1.0, note="")

        def update(fraction: float, text: str = "") -> None:
            pass_on()
            bar.update(task, completed=fraction, note=text)

        yield update
