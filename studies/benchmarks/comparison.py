"""One question put to several methods: how much work that takes, what it costs, and the table side by side."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from statistics import median
from textwrap import wrap
from time import perf_counter, process_time
from typing import Any, TypeVar

Result = TypeVar("Result")

_WIDTH = 118
_HEAD = ("", "wall", "CPU", "wall ratio", "CPU ratio")
_CELLS = "{:<56}{:>12}{:>12}{:>13}{:>12}"


@dataclass(frozen=True)
class Effort:
    """Sizes of the grids and numbers of repeats.

    Attributes:
        repeats: of everything that takes milliseconds.
        sweeps: repeats of the margin sweep; what takes seconds is done once.
        sweep: outer end masses of the margin sweep.
        grid: outer end masses of the eigenvalue grid.
        kind: controller kind that is tuned.
        seeds: of the evolutionary search, one run each.
        generations: at most so many of that search.
        candidates: random ones from the tuner's box.
    """

    repeats: int = 15
    sweeps: int = 3
    sweep: int = 200
    grid: int = 2000
    kind: str = "lag"
    seeds: tuple[int, ...] = (0, 1, 2)
    generations: int = 1000
    candidates: int = 1000


QUICK = Effort(repeats=3, sweeps=1, sweep=50, kind="proportional", seeds=(0,), generations=40, candidates=60)
"""Enough to see every row, and what each method misses."""


@dataclass(frozen=True)
class Cost:
    """Medians over repeats of one piece of work.

    Attributes:
        wall_s: elapsed.
        cpu_s: of this process, over all its threads; the fairer one where other work shares the machine.
    """

    wall_s: float
    cpu_s: float

    def __truediv__(self, parts: float) -> "Cost":
        return Cost(self.wall_s / parts, self.cpu_s / parts)

    def __add__(self, other: "Cost") -> "Cost":
        return Cost(self.wall_s + other.wall_s, self.cpu_s + other.cpu_s)


def timed(work: Callable[[], Result], repeats: int, warm: bool = True) -> tuple[Cost, Result]:
    """Do the work `repeats` times, after once in vain where caches are to be warm; median cost and last result."""
    if warm:
        work()
    walls, cpus = [], []
    for _ in range(repeats):
        wall, cpu = perf_counter(), process_time()
        result = work()
        walls.append(perf_counter() - wall)
        cpus.append(process_time() - cpu)
    return Cost(median(walls), median(cpus)), result


@dataclass(frozen=True)
class Method:
    """One way to answer a question.

    Attributes:
        name: what was done.
        cost: of one answer.
        answer: what it says.
        misses: in words, what it gets wrong or leaves open; empty for a proof.
        facts: the figures behind these words.
    """

    name: str
    cost: Cost
    answer: str
    misses: str = ""
    facts: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Comparison:
    """A question and the methods that answered it; ratios are times that of the first, which proves its answer."""

    row: str
    question: str
    methods: tuple[Method, ...]

    def ratios(self, method: Method) -> Cost:
        """How many times as long a method takes as the first one."""
        base = self.methods[0].cost
        return Cost(method.cost.wall_s / base.wall_s, method.cost.cpu_s / base.cpu_s)


def record(comparison: Comparison) -> dict[str, Any]:
    """The same as plain dictionaries, ratios included."""
    methods = [asdict(method) | {"ratio": asdict(comparison.ratios(method))} for method in comparison.methods]
    return {"row": comparison.row, "question": comparison.question, "methods": methods}


def table(comparisons: Sequence[Comparison]) -> str:
    """The table of costs and ratios, then what each method answers and misses."""
    return "\n".join([*_costs(comparisons), "", *_words(comparisons)])


def _costs(comparisons: Sequence[Comparison]) -> Iterator[str]:
    yield _CELLS.format(*_HEAD)
    for comparison in comparisons:
        yield "-" * _WIDTH
        yield f"{comparison.row}: {comparison.question}"
        for method in comparison.methods:
            ratio = comparison.ratios(method)
            times = _duration(method.cost.wall_s), _duration(method.cost.cpu_s)
            yield _CELLS.format(f"  {method.name}", *times, f"{ratio.wall_s:.3g}", f"{ratio.cpu_s:.3g}")
    yield "-" * _WIDTH


def _words(comparisons: Sequence[Comparison]) -> Iterator[str]:
    for comparison in comparisons:
        yield f"{comparison.row}: {comparison.question}"
        for method in comparison.methods:
            yield from _paragraph(f"{method.name}: {method.answer}", "  ")
            if method.misses:
                yield from _paragraph(f"misses: {method.misses}", "      ")
        yield ""


def _paragraph(words: str, indent: str) -> list[str]:
    return wrap(words, _WIDTH, initial_indent=indent, subsequent_indent=indent + "    ")


def _duration(seconds: float) -> str:
    if seconds >= 1:
        return f"{seconds:.3g} s"
    return f"{seconds * 1e3:.3g} ms" if seconds >= 1e-3 else f"{seconds * 1e6:.3g} us"
