"""Where cases are computed: in this process, in several, or on a Dask cluster; what dies is tried again."""

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from types import FrameType
from typing import Any

from beamdesign.study.case import Case, compute, kept
from beamdesign.study.code_digest import code_digest
from beamdesign.study.tasks import TASKS

Outcome = tuple[int, dict[str, Any]]
"""Place of a case in what was asked, and its record."""

Workers = Callable[[Sequence[Case]], Iterator[Outcome]]
"""Computes cases in any order and yields each as it is finished."""

TRIES = 3
"""How often a case is begun whose process dies, before that is its result."""

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def here(cases: Sequence[Case]) -> Iterator[Outcome]:
    """Compute in this process, one after another."""
    for place, found in enumerate(cases):
        with _heeded():
            record = compute(found)
        yield place, record


@contextmanager
def _heeded() -> Iterator[None]:
    """See to it that Ctrl-C ends the block: a solver may swallow it, and give what it has for a result."""
    before = signal.getsignal(signal.SIGINT)
    if before is not signal.default_int_handler or threading.current_thread() is not threading.main_thread():
        yield
        return
    heard = []

    def note(number: int, frame: FrameType | None) -> None:
        heard.append(number)
        signal.default_int_handler(number, frame)

    signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if heard:
        raise KeyboardInterrupt


@contextmanager
def processes(count: int) -> Iterator[Workers]:
    """Compute in so many processes of this machine, which end with this one however it ends."""
    for name in _THREADS:  # one process per core is enough
        os.environ.setdefault(name, "1")
    pools: list[ProcessPoolExecutor] = []

    def pool() -> ProcessPoolExecutor:
        if not pools:
            pools.append(ProcessPoolExecutor(count, get_context("spawn"), _begin))
        return pools[-1]

    def run(cases: Sequence[Case]) -> Iterator[Outcome]:
        waiting = [(place, 1) for place in range(len(cases))]
        alone = False  # after a death, one at a time: so it is known which case kills
        while waiting:
            jobs: dict[Future[dict[str, Any]], tuple[int, int]] = {}
            died: list[tuple[int, int]] = []
            while jobs or (waiting and not died):
                while waiting and not died and len(jobs) < (1 if alone else 2 * count):
                    place, tried = waiting.pop(0)
                    try:
                        jobs[pool().submit(compute, cases[place])] = (place, tried)
                    except BrokenProcessPool:
                        died.append((place, tried - 1))
                for future in wait(jobs, return_when=FIRST_COMPLETED).done:
                    place, tried = jobs.pop(future)
                    try:
                        yield place, future.result()
                    except BrokenProcessPool:
                        died.append((place, tried))
            if died:
                pools.pop().shutdown(wait=False)
                for place, tried in died:
                    if alone and tried >= TRIES:
                        yield place, dead(cases[place], tried)
                    else:  # of those that were under way together, which one killed is not known
                        waiting.insert(0, (place, tried + 1 if alone else 1))
                alone = True

    try:
        yield run
    except BaseException:
        for left in pools:
            _end(left)
        raise
    for left in pools:
        left.shutdown()


def dead(found: Case, tried: int) -> dict[str, Any]:
    """The record of a case whose process died each time."""
    return kept(found, "failed", f"the process that computed it died, {tried} times", {}, {}, 0.0)


def _begin() -> None:
    """In a worker: leave Ctrl-C to the parent, and end when that ends, even by a signal it cannot answer."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    if (parent := parent_process()) is not None:
        parent.join()
        os._exit(1)


def _end(pool: ProcessPoolExecutor) -> None:
    under_way = list((pool._processes or {}).values())
    pool.shutdown(wait=False, cancel_futures=True)
    for process in under_way:
        process.terminate()


def _compute_there(found: Case) -> dict[str, Any]:
    """In a worker of a cluster: its results count only if it has the code that they are kept under."""
    if code_digest(TASKS[found.task].module) != found.code_sha256:
        raise RuntimeError("another version of beamdesign is installed there than here")
    return compute(found)


@contextmanager
def cluster(address: str) -> Iterator[Workers]:
    """Compute on an existing Dask cluster; results come back here and are kept here.

    Args:
        address: of its scheduler, such as tcp://host:8786.

    Raises:
        InputError: where dask.distributed is not installed, or no scheduler answers.
    """
    from beamdesign.records import InputError

    try:
        from distributed import Client, KilledWorker, as_completed
    except ModuleNotFoundError:
        raise InputError(
            "--scheduler", [(address, "dask.distributed is not installed: pip install 'beamdesign[cluster]'")]
        ) from None
    try:
        client = Client(address, timeout="5s", set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError("--scheduler", [(address, f"no scheduler answers there: {error}")]) from None

    def run(cases: Sequence[Case]) -> Iterator[Outcome]:
        futures = {
            client.submit(_compute_there, found, pure=False, key=f"{found.address}-{os.urandom(4).hex()}"): place
            for place, found in enumerate(cases)
        }
        try:
            for future in as_completed(futures, loop=client.loop):
                place = futures[future]
                if future.status == "finished":
                    yield place, future.result()
                elif isinstance(error := future.exception(), KilledWorker):  # tried as often as the cluster is set to
                    yield place, dead(cases[place], TRIES)
                else:
                    raise InputError("--scheduler", [(address, f"its workers cannot compute this: {error}")])
        finally:
            client.cancel(list(futures))

    try:
        yield run
    finally:
        client.close()
