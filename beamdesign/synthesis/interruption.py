"""Ctrl-C while a solver runs: CasADi would end that run and go on as if nothing had been, so it waits for its end."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


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
