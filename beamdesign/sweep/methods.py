"""What a sweep is about to compute, and the methods: grids, samples, tolerances, worst case, sensitivity, optimisation.

What spreads are the keys of a prototype's file for which its [tolerance] has a standard deviation.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import ceil, floor, log2
from pathlib import Path
from typing import Any

import numpy as np

from beamdesign import records
from beamdesign.parameters import PARAMETERS, refuse_none_left
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem
from beamdesign.structure.lumped import lumped_beam
from beamdesign.sweep.case import Case, case
from beamdesign.sweep.sweep_file import SAMPLED, Optimise, Sweep, Vary, with_value

_OPTIONS = "options"


@dataclass(frozen=True)
class Plan:
    """A sweep read from its file, with its base document.

    Attributes:
        path: of the sweep file.
        sweep: what it says.
        base: tables of the base document.
        cases: the cases that are known beforehand; of an adaptive method none.
        budget: how many there are at most.
        limit: as asked, None for all.
    """

    path: Path
    sweep: Sweep
    base: dict[str, Any]
    cases: tuple[Case, ...]
    budget: int
    limit: int | None = None


def points(sweep: Sweep, cases: int | None = None) -> list[dict[str, Any]]:
    """Varied values by key, one table per case, in a stable order.

    Args:
        sweep: with method grid, latin_hypercube or sobol.
        cases: take no more than so many: spread evenly over a grid, or as many samples.
    """
    if sweep.study.method in SAMPLED:
        return [varied_in(sweep, row) for row in _unit(sweep, cases or sweep.study.cases)]
    axes = (
        [scaled(vary, k / (vary.count - 1), sweep.is_whole(vary.key)) for k in range(vary.count)]
        if vary.values is None
        else [at(vary, value, number) for number, value in enumerate(vary.values)]
        for vary in sweep.vary
    )
    found = [merged(parts) for parts in product(*axes)]
    if cases is None or cases >= len(found):
        return found
    chosen = np.unique(np.round(np.linspace(0, len(found) - 1, cases)).astype(int))
    return [found[k] for k in chosen]


def merged(parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Several tables of varied values as one."""
    return {key: value for part in parts for key, value in part.items()}


def at(vary: Vary, value: Any, number: int | None = None) -> dict[str, Any]:
    """Values of a varied key and of those that go along; `number` is that of a listed value."""
    found = {vary.key: value}
    for key, other in vary.along.items():
        if other.times is not None:
            found[key] = _rounded(float(value) * other.times)
        elif other.values is not None:
            found[key] = other.values[number or 0]
    return found


def _rounded(value: float) -> float:
    """Without the digits that no tape measures: they are noise of binary arithmetic."""
    return float(f"{value:.12g}")


def scaled(vary: Vary, share: float, whole: bool = False) -> dict[str, Any]:
    """Values at a share, 0 to 1, of an axis: between its ends, or one of its listed values.

    Where its key takes whole numbers it is one of those.
    """
    if vary.values is not None:
        number = min(int(share * len(vary.values)), len(vary.values) - 1)
        return at(vary, vary.values[number], number)
    assert vary.low is not None
    assert vary.high is not None
    high = vary.high + 1 if whole else vary.high  # the last whole number has as large a share as the others
    if vary.spacing == "logarithmic":
        value = vary.low * (high / vary.low) ** share
    else:
        value = vary.low + share * (high - vary.low)
    return at(vary, min(floor(value), floor(vary.high)) if whole else _rounded(value))


def _unit(sweep: Sweep, cases: int) -> np.ndarray:
    """(cases, axes) samples between 0 and 1."""
    from scipy.stats import qmc

    dimensions, seed = len(sweep.vary), sweep.study.seed
    if sweep.study.method == "sobol":  # balanced only as a power of two: the rest of the last one is left out
        drawn = qmc.Sobol(dimensions, scramble=True, rng=seed).random_base2(max(0, ceil(log2(cases))))
        return np.asarray(drawn)[:cases]
    return np.asarray(qmc.LatinHypercube(dimensions, rng=seed).random(cases))


def case_at(sweep: Sweep, base: Mapping[str, Any], varied: Mapping[str, Any]) -> Case:
    """The case of a sweep with the given varied values put into its base document and options.

    Raises:
        ValueError: where a value cannot be put in.
    """
    document: dict[str, Any] = dict(base) | {_OPTIONS: dict(sweep.options)}
    for key, value in varied.items():
        document = with_value(document, key, value)
    options = document.pop(_OPTIONS)
    return case(sweep.study.task, document, options, varied)


CUT_SIGMAS = 4.0
"""Draws are of a normal distribution cut off here; 6 in 100 000 would lie beyond."""


@dataclass(frozen=True)
class Figure:
    """One figure that spreads.

    Attributes:
        key: where it stands in a prototype file.
        value: nominal; a pair for the payload range, whose ends spread together.
        deviation: relative standard deviation.
    """

    key: str
    value: float | tuple[float, float]
    deviation: float

    def at(self, sigmas: float) -> Any:
        """Its value so many standard deviations off."""
        factor = 1 + sigmas * self.deviation
        if isinstance(self.value, tuple):
            return [_rounded(part * factor) for part in self.value]
        return _rounded(self.value * factor)


def spreading(prototype: Prototype, instead: Mapping[str, float], sigmas: float = CUT_SIGMAS) -> tuple[Figure, ...]:
    """The figures of a prototype that have a tolerance, each beam's own.

    Lumped figures of beams that come from a geometry are spread as if measured: a measured figure wins.

    Args:
        prototype: the nominal one.
        instead: relative standard deviations by name of [tolerance] that replace its own.
        sigmas: largest number of deviations that will be asked for.

    Raises:
        InputError: where no figure has a tolerance, a name is unknown, or a figure would reach zero.
    """
    names = type(prototype.tolerance).model_fields
    if unknown := [name for name in instead if name not in names]:
        reason = f"unknown; there are {', '.join(names)}"
        raise InputError(prototype.name, [(f"spread.tolerance.{name}", reason) for name in unknown])
    deviation = dict(prototype.tolerance) | dict(instead)
    found: list[Figure] = []
    lumped = {name: lumped_beam(getattr(prototype, name)) for name in ("outer_beam", "inner_beam")}
    for row in PARAMETERS.values():
        beam = lumped.get(row.place.split(".")[0])
        measured = {} if beam is None else {"stiffness": beam.stiffness, "effective_mass": beam.mass}
        if (value := measured.get(row.tolerance, row.stated(prototype))) is not None:
            found.append(Figure(row.place, value, deviation[row.tolerance]))
    found = [figure for figure in found if figure.deviation > 0 and figure.value not in (0.0, (0.0, 0.0))]
    if not found:
        raise InputError(prototype.name, [Problem("tolerance", "states no standard deviation, so nothing spreads")])
    write = "write {} = {{}}, or less, under [spread.tolerance] in the sweep file"
    remedies = {row.place: write.format(row.tolerance) for row in PARAMETERS.values()}
    refuse_none_left({figure.key: figure.deviation for figure in found}, sigmas, prototype.name, remedies)
    return tuple(found)


def varied_at(figures: Sequence[Figure], sigmas: np.ndarray) -> dict[str, Any]:
    """Values by key, each figure so many standard deviations off; (n,)."""
    return {figure.key: figure.at(float(z)) for figure, z in zip(figures, sigmas, strict=True)}


def drawn(figures: Sequence[Figure], count: int, seed: int) -> np.ndarray:
    """(count, n) independent draws in standard deviations, for shares of which binomial bounds hold."""
    return from_unit(np.random.default_rng(seed).random((count, len(figures))))


def from_unit(unit: np.ndarray) -> np.ndarray:
    """Standard deviations of the cut normal distribution from shares between 0 and 1."""
    from scipy.stats import truncnorm

    return np.asarray(truncnorm.ppf(unit, -CUT_SIGMAS, CUT_SIGMAS))


Evaluate = Callable[[Sequence[Case]], list[dict[str, Any]]]

_DIFFERENCE = 0.05
"""Step of a difference quotient, in standard deviations."""


def figures_of(sweep: Sweep, base: Mapping[str, Any], path: Path) -> tuple[Figure, ...]:
    """The figures that a sweep over tolerances spreads.

    Raises:
        InputError: where the base is no prototype or states no tolerance.
    """
    source = path.parent / sweep.study.base
    prototype = records.parse(Prototype, dict(base), source)
    worst = sweep.study.method == "worst_case"
    try:
        return spreading(prototype, sweep.spread.tolerance, *((sweep.spread.sigmas,) if worst else ()))
    except InputError as error:
        raise InputError(source, error.problems) from None


def laid_out(sweep: Sweep, base: Mapping[str, Any], path: Path, limit: int | None) -> tuple[tuple[Case, ...], int]:
    """Cases that are known beforehand, and how many there will be at most.

    Raises:
        InputError: where a value cannot be put in, the base has nothing that spreads, or SALib is not installed and
            is needed.
    """
    asked = sweep.optimise if sweep.study.method == "optimise" else None
    if asked is not None or sweep.study.method in ("grid", *SAMPLED):
        # Of an optimiser one case, for a value that cannot be put in there can be nowhere.
        known = points(sweep, limit) if asked is None else [varied_in(sweep, [0.0] * len(sweep.vary))]
        try:
            every = {one.address: one for values in known for one in [case_at(sweep, base, values)]}
        except ValueError as error:
            raise InputError(path, [Problem("vary", str(error))]) from None
        if asked is None:
            return tuple(every.values()), len(every)
        most = _generations(asked, limit) * asked.population
        return (), most if limit is None else min(most, limit)
    figures = figures_of(sweep, base, path)
    if sweep.study.method == "worst_case":
        return (), limit or (1 + len(figures)) * sweep.spread.rounds
    most = limit or sweep.study.cases
    if sweep.study.method == "tolerance":
        sigmas = drawn(figures, most, sweep.study.seed)
    else:
        if most < (least := 2 * (len(figures) + 2)):
            words = f"{most} are too few: the indices of {len(figures)} figures take {least} at least"
            raise InputError(path, [Problem("study.cases", words)])
        try:
            sigmas = saltelli(len(figures), most, sweep.study.seed)
        except ModuleNotFoundError:
            words = "SALib is not installed: pip install 'beamdesign[sensitivity]'"
            raise InputError(path, [("study.method", words)]) from None
    cases = tuple(case_at(sweep, base, varied_at(figures, row)) for row in sigmas)
    return cases, len(cases)


def saltelli(dimensions: int, cases: int, seed: int) -> np.ndarray:
    """(k, dimensions) samples in standard deviations from which SALib works out Sobol indices; k at most `cases`.

    Saltelli's scheme takes N (D + 2) samples for first-order and total indices, N a power of two of at least 2.
    """
    from SALib.sample import sobol

    power = max(1, floor(log2(max(2, cases // (dimensions + 2)))))
    problem = {"num_vars": dimensions, "names": [str(k) for k in range(dimensions)], "bounds": [[0, 1]] * dimensions}
    return from_unit(np.clip(sobol.sample(problem, 2**power, calc_second_order=False, seed=seed), 1e-9, 1 - 1e-9))


def _generations(asked: Optimise, limit: int | None) -> int:
    most = asked.generations + 1  # the first is the initial population
    return most if limit is None else max(1, min(most, limit // asked.population))


def _optimise(laid: Plan, evaluate: Evaluate) -> None:
    """Differential evolution (Storn and Price, 1997), one generation at a time so that workers share it."""
    from scipy.optimize import differential_evolution
    from scipy.stats import qmc

    sweep, asked = laid.sweep, laid.sweep.optimise
    assert asked is not None

    def costs(unit: np.ndarray) -> np.ndarray:
        rows = evaluate([case_at(sweep, laid.base, varied_in(sweep, row)) for row in unit])
        return np.array([cost(row, asked.output, asked.goal == "maximise") for row in rows])

    dimensions, generations = len(sweep.vary), _generations(asked, laid.limit)
    start = qmc.LatinHypercube(dimensions, rng=sweep.study.seed).random(asked.population)
    if generations == 1:
        costs(start[: laid.budget])
        return
    differential_evolution(
        lambda columns: costs(np.atleast_2d(columns.T)),
        [(0.0, 1.0)] * dimensions,
        init=start,
        maxiter=generations - 1,
        rng=sweep.study.seed,
        vectorized=True,
        updating="deferred",
        polish=False,
        tol=1e-6,
    )


def varied_in(sweep: Sweep, shares: Sequence[float]) -> dict[str, Any]:
    """Varied values at shares, 0 to 1, of the axes of a sweep."""
    pairs = zip(sweep.vary, shares, strict=True)
    return merged([scaled(vary, float(share), sweep.is_whole(vary.key)) for vary, share in pairs])


NO_RESULT = 1e30
"""Cost of a case without a result: finite, so that means over a population stay numbers."""


def cost(row: Mapping[str, Any], output: str, largest: bool) -> float:
    """What an optimiser minimises: the output of a case that is done, turned round where the largest is sought."""
    value = row["outputs"].get(output)
    if row["status"] != "done" or value is None:
        return NO_RESULT
    return -float(value) if largest else float(value)


def _worst_case(laid: Plan, evaluate: Evaluate) -> None:
    """Search the corners of the tolerance box for the worst value: along difference quotients, then corner by corner.

    An answer of no, such as a loop that is not stable, is the worst there can be and ends the search.
    """
    sweep, most = laid.sweep, laid.budget
    figures = figures_of(sweep, laid.base, laid.path)
    output, reach = sweep.spread.output or "", sweep.spread.sigmas
    spent = 0

    def badness(points: np.ndarray) -> np.ndarray:
        nonlocal spent
        points = points[: max(0, most - spent)]
        spent += len(points)
        rows = evaluate([case_at(sweep, laid.base, varied_at(figures, point)) for point in points])
        # The worst is where the answer is no; a case that failed, or has no such figure, tells nothing.
        noted = [row["status"] == "no" or row["outputs"].get(output) is not None for row in rows]
        costs = [cost(row, output, sweep.spread.worst == "least") for row in rows]
        return np.where(noted, costs, -NO_RESULT)

    count = len(figures)
    point, worst, best = np.zeros(count), np.zeros(count), -np.inf
    for _ in range(sweep.spread.rounds):
        steps = np.where(point > 0, -_DIFFERENCE, _DIFFERENCE)
        found = badness(np.vstack([point, point + np.diag(steps)]))
        if len(found) and found[0] > best:
            worst, best = point, found[0]
        if len(found) < count + 1 or found.max() >= NO_RESULT:
            return
        corner = np.where((found[1:] - found[0]) / steps >= 0, reach, -reach)
        if np.array_equal(corner, point) or found[0] < best:
            break
        point = corner
    while spent < most:  # the slopes at a corner may mislead: try its neighbours
        flipped = np.tile(worst, (count, 1))
        flipped[np.arange(count), np.arange(count)] *= -1
        found = badness(flipped)
        if not len(found) or found.max() >= NO_RESULT or found.max() <= best:
            return
        worst, best = flipped[int(found.argmax())], found.max()


ADAPTIVE = {"optimise": _optimise, "worst_case": _worst_case}
"""Methods whose cases follow from the results of earlier ones: deterministic, so that they resume from the store."""


def reached(laid: Plan, known: Mapping[str, dict[str, Any]]) -> tuple[list[str], bool]:
    """Follow an adaptive method as far as results lead: the addresses of those it asks for, and whether that is all.

    Args:
        laid: the sweep as planned.
        known: records by address.
    """
    met: dict[str, None] = {}

    def evaluate(cases: Sequence[Case]) -> list[dict[str, Any]]:
        met.update(dict.fromkeys(one.address for one in cases if one.address in known))
        return [known[one.address] for one in cases]

    try:
        ADAPTIVE[laid.sweep.study.method](laid, evaluate)
    except KeyError:  # of a case that has no result yet
        return list(met), False
    return list(met), True
