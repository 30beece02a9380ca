"""Where cases are computed: in this process, in others, or on a Dask cluster; what dies is tried again."""

import os
import signal
import time
import traceback
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from math import inf
from multiprocessing import current_process, get_context, resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any, cast

from beamdesign.code_digest import code_digest, engines
from beamdesign.progress import end_with_parent, pass_on, remembered
from beamdesign.prototype import Prototype
from beamdesign.records import InputError
from beamdesign.sweep.case import TASKS, Answer, Case, in_words, kept, of_all, parsed

Outcome = tuple[int, dict[str, Any]]
"""Place of a case in what was asked, and its record."""

Workers = Callable[[Sequence[Case]], Iterator[Outcome]]
"""Computes cases in any order and yields each as it is finished."""

TRIES = 3
"""How often a case is begun whose process dies, before that is its result."""

CASE_SECONDS = 3600.0
"""After which a case is given up, if nothing else is said."""

_IMPORTED, _LAST_S = 70, 5.0  # exit status of a process that was to begin others, and how long one may take to end
_UNGUARDED = 'begins processes, which import it: put its work under `if __name__ == "__main__":`'

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def compute(found: Case) -> dict[str, Any]:
    """Put a case through its task, law by law where a controller has several; whatever happens is a result.

    Returns:
        the record that is kept: inputs, status, reason, outputs, details, and how long it took.
    """
    begun = time.perf_counter()
    try:
        if found.problems:
            raise InputError(found.task, found.problems)
        record, options = parsed(found.task, found.document, found.options)
        task = TASKS[found.task]
        module, _, name = task.place.partition(":")
        work = cast("Callable[[Any, Any], Answer]", getattr(import_module(module), name))
        if isinstance(record, Prototype) and record.schedule is not None and "controller" in task.needs:
            range_kg = record.outer_end_mass_kg
            assert range_kg is not None  # laws have their payloads
            if hasattr(options, "outer_end_mass_kg"):  # a task at one mass, the largest where none is asked for
                mass = range_kg[1] if options.outer_end_mass_kg is None else options.outer_end_mass_kg
                range_kg = mass, mass
            each = {one.prototype.name: work(one.prototype, options) for one in record.stages(range_kg)}
            answer = of_all(each, task.governs)
        else:
            answer = work(record, options)
        status = "no" if answer.reason else "done"
    except InputError as error:
        status, answer = "refused", Answer({}, reason=in_words(error.problems))
    except Exception as error:  # a crash is a row of its own: the others go on
        reason = f"{type(error).__name__}: {error}"
        status, answer = "failed", Answer({}, {"traceback": traceback.format_exc()}, reason)
    return kept(found, status, answer, time.perf_counter() - begun)


def here(cases: Sequence[Case]) -> Iterator[Outcome]:
    """Compute in this process, one after another."""
    for place, found in enumerate(cases):
        with remembered():  # a solver may swallow Ctrl-C, and give what it has for a result
            record = compute(found)
            pass_on()
        yield place, record


@contextmanager
def processes(count: int, case_seconds: float = CASE_SECONDS) -> Iterator[Workers]:
    """Compute in so many processes of this machine, which end with this one however it ends.

    Args:
        count: of processes; each is begun when there is a case for it.
        case_seconds: after which a case is given up, and its process ended.

    Raises:
        InputError: for a script that begins its work as soon as it is imported, as by each of these processes.
    """
    if getattr(current_process(), "_inheriting", False):  # importing that script: not to begin processes of its own
        os._exit(_IMPORTED)
    for name in _THREADS:  # one process per core is enough
        os.environ.setdefault(name, "1")
    free: list[_Process] = []
    busy: list[_Process] = []

    def run(cases: Sequence[Case]) -> Iterator[Outcome]:
        waiting = deque(range(len(cases)))
        deaths: Counter[int] = Counter()
        while waiting or busy:
            while waiting and len(busy) < count:
                busy.append(free.pop() if free else _Process())
                busy[-1].begin(waiting[0], cases[waiting.popleft()])
            left = case_seconds - max(process.seconds for process in busy)
            ready = wait([process.pipe for process in busy], None if left == inf else max(0.0, left))
            for process in list(busy):
                place, record, lost = process.place, None, False
                try:
                    if process.pipe in ready:
                        record = process.hear()
                    elif lost := process.seconds > case_seconds:
                        reason = f"not finished after {case_seconds:g} s, the limit of --case-seconds"
                        words = f"{reason}; --again tries it once more"
                        record = kept(cases[place], "failed", Answer({}, reason=words), case_seconds)
                except (EOFError, OSError):
                    if process.imported:
                        raise InputError("study", [("(script)", _UNGUARDED)]) from None
                    lost, deaths[place] = True, deaths[place] + 1
                    if deaths[place] < TRIES:
                        waiting.appendleft(place)
                    else:
                        record = dead(cases[place])
                if lost or record is not None:
                    busy.remove(process)
                    process.end() if lost else free.append(process)
                if record is not None:
                    yield place, record

    try:
        yield run
    finally:
        for process in (*free, *busy):
            process.end()


class _Process:
    """A process that computes one case after another.

    Attributes:
        pipe: to it.
        place: of the case that it is given.
        begun: when it began that, by the monotonic clock; infinite until it has.
    """

    def __init__(self) -> None:
        context = get_context("spawn")
        self.pipe, its_end = context.Pipe()
        self._process = context.Process(target=_serve, args=(its_end,), daemon=True)
        with _deaf():
            self._process.start()
        its_end.close()

    def begin(self, place: int, found: Case) -> None:
        """Give it a case."""
        self.place, self.begun = place, inf
        with suppress(OSError):  # it has died, which shows when it is heard
            self.pipe.send(found)

    @property
    def seconds(self) -> float:
        """For how long it has computed its case."""
        return time.monotonic() - self.begun

    def hear(self) -> dict[str, Any] | None:
        """The record of its case; None where it says that it begins.

        Raises:
            EOFError, OSError: where it has died.
        """
        record: dict[str, Any] | None = self.pipe.recv()
        if record is None:
            self.begun = time.monotonic()
        return record

    @property
    def imported(self) -> bool:
        """Whether it has ended, since what it imported to begin with would have begun processes."""
        self._process.join(_LAST_S)
        return self._process.exitcode == _IMPORTED

    def end(self) -> None:
        """End it at once, whatever it does."""
        self._process.kill()
        self._process.join()
        self.pipe.close()


@contextmanager
def _deaf() -> Iterator[None]:
    """Begin a process that never hears of Ctrl-C, not even before its own code runs; this one hears a little later."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # else the first process begins it, which undoes the mask
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def dead(found: Case) -> dict[str, Any]:
    """The record of a case whose process died each time."""
    return kept(found, "failed", Answer({}, reason=f"the process that computed it died, {TRIES} times"), 0.0)


def _serve(pipe: Connection) -> None:
    """In a process of its own: compute cases, each begun with a word, until the parent ends."""
    end_with_parent()
    while True:
        found: Case = pipe.recv()
        for engine in engines(TASKS[found.task].place):  # loading them is no part of a case's time
            with suppress(Exception):  # as told by `compute`
                import_module(engine)
        pipe.send(None)
        pipe.send(compute(found))


def _compute_there(found: Case) -> dict[str, Any]:
    """In a worker of a cluster: its results count only if it has the code that they are kept under."""
    if code_digest(TASKS[found.task].place) != found.code_sha256:
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
    try:
        from distributed import Client, KilledWorker, as_completed
        from distributed.comm import resolve_address
    except ModuleNotFoundError:
        words = "dask.distributed is not installed: pip install 'beamdesign[cluster]'"
        raise InputError("--scheduler", [(address, words)]) from None
    try:
        resolve_address(address)  # a client of no address waits for itself to close, and ends with a traceback
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
                    yield place, dead(cases[place])
                else:
                    raise InputError("--scheduler", [(address, f"its workers cannot compute this: {error}")])
        finally:
            client.cancel(list(futures))

    try:
        yield run
    finally:
        client.close()
