"""How far long work has got, on stderr: a bar on a terminal, a line every half minute elsewhere.

Ctrl-C is remembered: where some library swallows it, the next word on progress passes it on.
"""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from beamdesign.cli.output import shown

_came = threading.Event()


@contextmanager
def remembered() -> Iterator[None]:
    """For as long as the block runs, remember that Ctrl-C came; who ignores it or has a way of their own keeps that."""
    if (
        signal.getsignal(signal.SIGINT) is not signal.default_int_handler
        or threading.current_thread() is not threading.main_thread()
    ):
        if signal.getsignal(signal.SIGINT) is not _remember:
            _came.clear()  # what came before is no word on this run
        yield
        return
    _came.clear()
    signal.signal(signal.SIGINT, _remember)
    try:
        yield
    finally:
        _came.clear()
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _remember(number: int, frame: FrameType | None) -> None:
    _came.set()
    raise KeyboardInterrupt


def pass_on() -> None:
    """Say again what was swallowed.

    Raises:
        KeyboardInterrupt: where Ctrl-C has come.
    """
    if _came.is_set():
        raise KeyboardInterrupt


Update = Callable[[float, str], None]
EVERY_S = 30.0
"""From line to line."""


class Work:
    """What is being done, as the lines tell it."""

    def __init__(self, name: str):
        self.begun, self.name, self.share, self.words = time.monotonic(), name, 0.0, ""

    def line(self) -> str:
        """Share done, time taken, an estimate of what is left, and what is being done."""
        taken = time.monotonic() - self.begun
        parts = [f"{100 * self.share:.0f} % done"] if self.share > 0 else []
        parts.append(f"{in_words(taken)} so far")
        if 0.02 < self.share < 1:
            parts.append(f"about {in_words(taken * (1 / self.share - 1))} to go")
        return f"{self.name}: {', '.join(parts)}{f' ({self.words})' if self.words else ''}"


_works: list[Work] = []


def in_words(seconds: float) -> str:
    """A time in the unit in which one would say it."""
    for limit, unit, size in ((100, "s", 1), (6000, "min", 60)):
        if seconds < limit:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds / 3600:.1f} h"


@contextmanager
def lines(name: str, silent: Callable[[], bool] = bool, every_s: float = EVERY_S) -> Iterator[None]:
    """Print a line on the work in progress now and then for as long as the block runs, whatever its engine is at.

    Args:
        name: of the command, where nothing within it says what is being done.
        silent: whether nothing is to be printed after all.
        every_s: from line to line.
    """
    done = threading.Event()

    def tell() -> None:
        while not done.wait(every_s):
            if not silent():
                print(shown(_works[-1].line()), file=sys.stderr, flush=True)

    before = list(_works)
    _works.append(Work(name))
    teller = threading.Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield
    finally:
        done.set()
        teller.join()
        _works[:] = before


@contextmanager
def reported(description: str) -> Iterator[Update]:
    """Let the lines tell of this work while the block runs.

    Yields:
        update(share, words): the share done, 0 to 1, and a word on what is being done.
    """
    work = Work(description)

    def update(share: float, words: str = "") -> None:
        pass_on()
        work.share, work.words = share, words

    _works.append(work)
    try:
        yield update
    finally:
        _works.remove(work)


@contextmanager
def display(description: str) -> Iterator[Update]:
    """Show a bar while the block runs; yields as `reported` does."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    console = Console(stderr=True, no_color="NO_COLOR" in os.environ)
    described, noted = (TextColumn(text, markup=False) for text in ("{task.description}", "{task.fields[note]}"))
    columns = (described, BarColumn(), noted)
    with Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=console, transient=True) as bar:
        task = bar.add_task(shown(description), total=1.0, note="")

        def update(share: float, words: str = "") -> None:
            pass_on()
            bar.update(task, completed=share, note=shown(words))

        yield update
