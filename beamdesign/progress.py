"""What long work says while it lasts; and Ctrl-C, which is remembered where some library swallows it.

While a solver runs, CasADi would end that run and go on as if nothing had been, so it waits for its end.
"""

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, parent_process
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import Any

from beamdesign.time_limit import forget

Progress = Callable[[float, str], None]
"""Called with the share of the work that is done, 0 to 1, and what is being done."""


def silent(share: float, text: str) -> None:
    """Progress that nobody asked for."""


def part_of(whole: Progress, low: float, high: float) -> Progress:
    """Progress of a part of some work, from one share of the whole to another."""
    return lambda share, text: whole(low + (high - low) * share, text)


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
        with undisguised():
            yield
    finally:
        _came.clear()
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _remember(number: int, frame: FrameType | None) -> None:
    _came.set()
    raise KeyboardInterrupt


@contextmanager
def undisguised() -> Iterator[None]:
    """Make Ctrl-C again of what Python makes of it where it comes while compiled code converts a matrix."""
    try:
        yield
    except SystemError as error:
        if _came.is_set():
            raise KeyboardInterrupt from error
        raise


def pass_on() -> None:
    """Say again what was swallowed.

    Raises:
        KeyboardInterrupt: where Ctrl-C has come.
    """
    if _came.is_set():
        raise KeyboardInterrupt


@contextmanager
def interruption_waits() -> Iterator[None]:
    """Hold back Ctrl-C until the block is through, and pass it on then to whoever heeded it before."""
    heeded = signal.getsignal(signal.SIGINT)
    if not callable(heeded) or threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[tuple[int, Any]] = []
    signal.signal(signal.SIGINT, lambda number, frame: came.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, heeded)
    if came:
        heeded(*came[0])


def help_another() -> None:
    """Make this process one that works for another: an interruption and the time that is left are for that one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    forget()


_PR_SET_PDEATHSIG = 1


def end_with_parent() -> None:
    """Make this process one that works for the one that began it, and ends when that does, however it ends."""

    def follow(parent: Any) -> None:
        parent.join()
        os._exit(1)

    help_another()
    threading.Thread(target=follow, args=(parent_process(),), daemon=True).start()
    if sys.platform == "linux":  # the thread waits for a solver that lets nothing else run
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def end_at_once(pool: ProcessPoolExecutor, others: Collection[BaseProcess]) -> None:
    """End the processes of a pool without waiting for what they are at; `others` are those that began before it.

    What watches them is waited for: the end of Python would meet it while it closes its pipes.
    """
    for child in active_children():
        if child not in others:
            child.terminate()
    pool.shutdown(cancel_futures=True)
