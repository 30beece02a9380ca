"""How long an answer may take: a limit over whatever is done within it, however deep, and what that left out.

Long work that comes in steps asks `over` before each of them, ends with the best that it has, and says by `leave_out`
what was not done, so that the answer can tell. Without a limit nothing is ever over. Limits within limits never last
longer than the outer one.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from math import inf
from time import monotonic
from typing import TypeVar

T = TypeVar("T")

MINUTES = 2.0
"""The most that a command takes for an answer where nothing else is asked; functions take as long as they need."""


class TimeUp(Exception):
    """The time is up in the midst of a step that has nothing to show."""


@dataclass
class TimeLimit:
    """A limit.

    Attributes:
        ends: when, by the clock, s.
        clock: that tells the time, s.
        left_out: what was not done for want of time, in words.
        within_steps: whether steps are to be broken off, rather than brought to their end.
    """

    ends: float = inf
    clock: Callable[[], float] = monotonic
    left_out: list[str] = field(default_factory=list)
    within_steps: bool = False


_limit: ContextVar[TimeLimit] = ContextVar("time_limit", default=TimeLimit())  # noqa: B039 nothing is left out of it


@contextmanager
def within(minutes: float | None, clock: Callable[[], float] | None = None) -> Iterator[TimeLimit]:
    """Limit the time of a block, and keep what it leaves out; None: to what is left anyway."""
    outer = _limit.get()
    clock = clock or outer.clock
    with _limited(TimeLimit(inf if minutes is None else clock() + 60 * minutes, clock)) as limit:
        try:
            yield limit
        finally:
            if outer.ends < inf:
                outer.left_out += [words for words in limit.left_out if words not in outer.left_out]


@contextmanager
def share(of: float, within_steps: bool = False) -> Iterator[TimeLimit]:
    """Limit a block to a share of the time that is left.

    Args:
        of: the share, 0 to 1.
        within_steps: whether `heed` breaks off a step.
    """
    outer = _limit.get()
    with _limited(TimeLimit(outer.clock() + of * left(), outer.clock, outer.left_out, within_steps)) as limit:
        yield limit


@contextmanager
def _limited(limit: TimeLimit) -> Iterator[TimeLimit]:
    limit.ends = min(limit.ends, _limit.get().ends)
    token = _limit.set(limit)
    try:
        yield limit
    finally:
        _limit.reset(token)


def forget() -> None:
    """Know no limit from here on: in a process that was begun within one, and is broken off by who began it."""
    _limit.set(TimeLimit())


def left() -> float:
    """Time that is left, s; infinite without a limit."""
    limit = _limit.get()
    return max(0.0, limit.ends - limit.clock()) if limit.ends < inf else inf


def is_limited() -> bool:
    """Whether there is a limit."""
    return _limit.get().ends < inf


def over() -> bool:
    """Whether no time is left."""
    return left() <= 0


def leave_out(*words: str) -> None:
    """Say what is not done for want of time."""
    found = _limit.get().left_out
    found += [one for one in dict.fromkeys(words) if one not in found]


def while_time(items: Iterable[T], words: Callable[[T], str] = str, least: int = 0) -> Iterator[T]:
    """Items one after another as long as there is time; the others are left out.

    Args:
        items: to be worked on.
        words: what is left out with one of them.
        least: how many are worked on whatever the time.
    """
    given = list(items)
    for k, item in enumerate(given):
        if k >= least and over():
            leave_out(*map(words, given[k:]))
            return
        yield item


def left_out() -> tuple[str, ...]:
    """What was not done so far for want of time."""
    return tuple(_limit.get().left_out)


def heed() -> None:
    """Break off a step where no time is left for it.

    Raises:
        TimeUp: where it is up and steps are to be broken off.
    """
    if _limit.get().within_steps and over():
        raise TimeUp


def left_for_steps() -> float:
    """Time, s, after which steps are to be broken off; infinite where they are not."""
    return left() if _limit.get().within_steps else inf
