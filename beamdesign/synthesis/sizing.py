"""Sizing: the lightest pair of tubes that carries the load and keeps its clearance, and what that costs.

Of stock tubes every pair is looked at, since checks take arrays. Where no pair of tubes fits, which requirement to
relax: each alone, as little as possible.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from beamdesign.arguments import takes
from beamdesign.problem import BeamProblem, DesignProblem, Load, Sections
from beamdesign.progress import Progress, silent
from beamdesign.prototype import Beam, Payload, Prototype
from beamdesign.records import InputError, Problem
from beamdesign.result import Result, finite, picked
from beamdesign.structure.lumped import lumped_beam, unstated
from beamdesign.structure.section import Tube, as_arrays, clearances, stock_tubes
from beamdesign.structure.shapes import Clearance, Safety, SizedFor, Sizes
from beamdesign.synthesis.checks import (
    REQUIREMENTS,
    CheckedPair,
    Pair,
    Relaxation,
    Requirements,
    beam_mass,
    check_sections,
    checks,
    confirmed,
    eased,
    enough_of,
    relaxable,
    requirements,
)
from beamdesign.synthesis.free_search import FreeOptimum, free_optimum, relax_free


@dataclass(frozen=True)
class StockOptimum:
    """The lightest pair of stock tubes; no pair was left out, so this is the global optimum over the list.

    Attributes:
        pair: the tubes, their mass and its checks.
        pairs: how many pairs there are.
        pairs_feasible: how many of them pass every check.
    """

    pair: CheckedPair
    pairs: int
    pairs_feasible: int


Stock = tuple[Sequence[Tube], Sequence[Tube]]
"""What there is to choose the outer and the inner tube from."""


def stock_of(problem: DesignProblem) -> Stock:
    """Stock tubes of the shapes of both beams."""
    outer, inner = (stock_tubes(one.shape, one.depth_over_width) for one in problem.beams)
    return outer, inner


def _all_pairs(stock: Stock) -> tuple[Tube, Tube, np.ndarray]:
    """Outer tubes by row and inner ones by column, and whether the inner enters the outer."""
    outer, inner = as_arrays(stock[0], (-1, 1)), as_arrays(stock[1], (1, -1))
    return outer, inner, np.logical_and.reduce([gap > 0 for gap in clearances(outer, inner)])


def _of_least(stock: Stock, figures: np.ndarray) -> Pair:
    row, column = np.unravel_index(np.argmin(figures), figures.shape)
    return stock[0][int(row)], stock[1][int(column)]


def passing_pairs(
    problem: DesignProblem, stock: Stock, asked: Requirements | None = None
) -> tuple[np.ndarray, Pair | None]:
    """Which pairs pass every check, and the lightest of them.

    Args:
        problem: what is asked.
        stock: the tubes, n outer and m inner ones.
        asked: other figures than the problem's.

    Returns:
        Boolean array (n, m): row by outer tube, column by inner tube; and the pair, None where none passes.
    """
    outer, inner, fits = _all_pairs(stock)
    found = checks(problem, outer, inner, asked)
    passing = np.logical_and.reduce(np.broadcast_arrays(fits, *(check.satisfied for check in found)))
    mass = np.where(passing, beam_mass(problem, outer, inner), np.inf)
    return passing, _of_least(stock, mass) if passing.any() else None


def nearest_pair(problem: DesignProblem, stock: Stock) -> CheckedPair:
    """The pair whose worst miss, relative to its limit, is least, of those where the inner tube enters the outer one.

    Args:
        problem: what is asked.
        stock: the tubes.
    """
    outer, inner, fits = _all_pairs(stock)
    misses = [-check.slack / np.maximum(np.abs(check.limit), 1e-3) for check in checks(problem, outer, inner)]
    worst = np.where(fits, np.maximum.reduce(np.broadcast_arrays(*misses)), np.inf)
    return check_sections(problem, *_of_least(stock, worst))


def stock_optimum(problem: DesignProblem, stock: Stock | None = None) -> StockOptimum | None:
    """Find the lightest pair of stock tubes that passes every check.

    Args:
        problem: what is asked.
        stock: tubes to choose from; by default the built-in lists of their shapes.

    Returns:
        The optimum, or None where no pair passes.
    """
    stock = stock_of(problem) if stock is None else stock
    if not all(stock):
        return None
    passing, pair = passing_pairs(problem, stock)
    return None if pair is None else StockOptimum(check_sections(problem, *pair), passing.size, int(passing.sum()))


def relax_stock(problem: DesignProblem, stock: Stock) -> tuple[tuple[Relaxation, ...], CheckedPair]:
    """For stock tubes: the requirements that could be eased alone, each by bisection over all pairs.

    More pairs pass as a requirement is eased, so that the bisection finds the least change over the whole list.

    Returns:
        The relaxations, the relatively smallest first; and the pair that misses least.
    """
    asked = requirements(problem)

    def lightest(name: str, figure: float) -> Pair | None:
        return passing_pairs(problem, stock, {**asked, name: figure})[1]

    found = []
    for name in relaxable(asked):
        if lightest(name, REQUIREMENTS[name].easiest) is None:
            continue
        hard, easy = 0.0, 1.0
        for _ in range(40):
            middle = (hard + easy) / 2
            hard, easy = (hard, middle) if lightest(name, eased(asked, name, middle)) else (middle, easy)
        enough = enough_of(asked, name, easy)
        if pair := lightest(name, enough):
            found.append((name, enough, pair))
    return confirmed(problem, found), nearest_pair(problem, stock)


@dataclass(frozen=True, repr=False)
class Sizing(Result, CheckedPair):
    """What sizing found: the chosen pair; where nothing fits, the pair that misses least.

    Attributes:
        choose: how the sections were to be chosen.
        reason: why, in words; where the answer is no, what to relax.
        free: the optimum over free sizes, or None where none was found.
        stock: the optimum over stock sizes, or None where no pair passes.
        given: the pair given in the problem (such as the published one), checked; None where none is given.
        price_of_rounding_kg: mass of the stock optimum less that of the free one; None unless there are both.
        relaxations: where nothing fits, requirements each of which could be eased alone, the smallest change first.
    """

    choose: Literal["free", "stock", "fixed"]
    reason: str
    free: FreeOptimum | None
    stock: StockOptimum | None
    given: CheckedPair | None
    price_of_rounding_kg: float | None
    relaxations: tuple[Relaxation, ...] = ()

    __str__ = Result.__repr__

    @property
    def yes(self) -> bool:
        """Whether there are such sections."""
        return self.feasible

    @property
    def governing(self) -> str:
        """The check that decides the chosen pair."""
        return self.free.governing if self.choose == "free" and self.free else super().governing

    @property
    def chosen(self) -> CheckedPair:
        """The pair alone."""
        return CheckedPair(self.outer, self.inner, self.beam_mass_kg, self.checks)

    @property
    def compared(self) -> dict[str, CheckedPair | None]:
        """The pairs that are told beside each other."""
        free, stock = self.free.pair if self.free else None, self.stock.pair if self.stock else None
        return {"free": free, "stock": stock, "given": self.given}

    def rows(self) -> list[tuple[str, str, str, float, str]]:
        """The pairs that were found: which, both tubes in mm, mass in kg, and what their checks say."""
        rows, names = [], ("free sizes", "stock sizes", "given in the study", "nearest pair")
        for name, pair in zip(names, (*self.compared.values(), None if self.feasible else self.chosen), strict=True):
            if pair:
                failing = "; ".join(check.name for check in pair.failing)
                words = f"fails {failing}" if failing else f"passes, governed by {pair.governing}"
                which = f"{name} (chosen)" if self.feasible and pair == self.chosen else name
                rows.append((which, pair.outer.millimetres, pair.inner.millimetres, pair.beam_mass_kg, words))
        return rows

    def to_dict(self) -> dict[str, Any]:
        """What `beamdesign size` writes of it."""
        pairs = self.compared.items()
        fields = self.chosen.to_dict() | {
            **picked(self, "governing feasible reason choose kkt_residual shadow_prices price_of_rounding_kg"),
            "active": list(self.free.active) if self.free else [],
            "relaxations": [picked(item, "key asked enough") for item in self.relaxations],
            **{name: pair and pair.to_dict() | picked(pair, "feasible governing") for name, pair in pairs},
        }
        return finite(fields)

    @property
    def kkt_residual(self) -> float | None:
        """Residual of the first-order conditions at the free optimum."""
        return self.free.kkt_residual if self.free else None

    @property
    def shadow_prices(self) -> dict[str, float]:
        """Shadow prices at the free optimum; empty where there is none."""
        return self.free.shadow_prices if self.free else {}


@takes("DesignProblem")
def size(problem: DesignProblem, progress: Progress | None = None) -> Sizing:
    """Choose the sections of both beams as the problem says: free, stock, or fixed to those given.

    The free and the stock optimum are found in any case, so that each can be compared with the other and with the given
    pair. The stock optimum is global over the list. The free one is the best of several local searches, of which one
    starts at the stock optimum, so that it is never heavier than that.

    Args:
        problem: what is asked.
        progress: told how far the work has got.
    """
    report = progress or silent
    given = None if problem.given is None else check_sections(problem, *problem.given)
    report(0.0, "stock sizes")
    stock = stock_optimum(problem)
    report(0.1, "free sizes")
    pairs = [(found.outer, found.inner) for found in (stock.pair if stock else None, given) if found]
    free = free_optimum(problem, pairs)
    price = stock.pair.beam_mass_kg - free.pair.beam_mass_kg if stock and free else None

    choose = problem.sections.choose
    relaxations: tuple[Relaxation, ...] = ()
    if choose == "fixed":
        assert given is not None  # else it is no problem
        chosen = given
        reason = f"the given sections pass every check; governed by {given.governing}"
        if not given.feasible:
            relaxations, _ = relax_stock(problem, ((given.outer,), (given.inner,)))
            reason = f"the given sections fail: {given.misses}; {_relax(relaxations)}"
    elif choose == "free" and free:
        chosen = free.pair
        best = f"lightest pair of free sizes, from {free.starts_agreeing} of {free.starts} starts"
        reason = f"{best}; governed by {free.governing}"
    elif choose == "stock" and stock:
        chosen = stock.pair
        best = f"lightest of {stock.pairs} stock pairs ({_in_stock(problem)})"
        reason = f"{best}, of which {stock.pairs_feasible} pass every check; governed by {chosen.governing}"
    else:
        report(0.6, "what to relax")
        relaxations, chosen = relax_stock(problem, stock_of(problem)) if choose == "stock" else relax_free(problem)
        kind = f"stock sizes ({_in_stock(problem)}) passes" if choose == "stock" else "free sizes was found that passes"
        reason = f"no pair of {kind} every check; the nearest, {chosen}, misses: {chosen.misses}"
        if choose == "stock" and free:
            reason += f"; of free sizes {free.pair} would do, at {free.pair.beam_mass_kg:.3g} kg"
        reason = f"{reason}; {_relax(relaxations)}"
        if chosen.feasible:
            reason = "a pair that passes every check, but no least mass was found"
    report(1.0, "done")
    rest = choose, reason, free, stock, given, price, relaxations
    return Sizing(chosen.outer, chosen.inner, chosen.beam_mass_kg, chosen.checks, *rest)


def _relax(relaxations: tuple[Relaxation, ...]) -> str:
    if not relaxations:
        return "relaxing one requirement alone was not found to help"
    return "relax one of: " + "; ".join(str(item) for item in relaxations)


def _in_stock(problem: DesignProblem) -> str:
    """Where the list of stock tubes begins and ends, for the outer beam."""
    outer, _ = stock_of(problem)
    return f"outer tubes of {outer[0].millimetres} to {outer[-1].millimetres} mm"


def problem_of(prototype: Prototype, tip_force_N: float, source: str = "prototype") -> DesignProblem:
    """The design problem that a prototype's sections are to meet, with what it says that they were chosen to keep.

    Where it does not say, with the usual limits of sizes, clearances and safety factors. The sections themselves are
    not in it, for those of a problem have sharp corners.

    Args:
        prototype: its beams must give their geometry, lengths included.
        tip_force_N: the load to check for, which a prototype does not state, N.
        source: file to name in the error.

    Raises:
        InputError: naming every key of geometry that is missing.
    """
    if missing := unstated(prototype, ("width_m", "wall_m", "length_m", "free_length_m", "material")):
        reason = "missing; the checks of sections need it, lumped figures are not enough"
        raise InputError(source, [Problem(key, reason) for key in missing])
    asked = dict(prototype.sized_for or SizedFor())
    sizes, gaps, factors = ({name: asked[name] for name in of.model_fields} for of in (Sizes, Clearance, Safety))
    return DesignProblem(
        load=Load(tip_force_N=tip_force_N),
        sections=Sections(choose="fixed", **sizes),
        clearance=Clearance(**gaps),
        safety=Safety(**factors),
        outer_beam=_asked_of(prototype.outer_beam),
        inner_beam=_asked_of(prototype.inner_beam),
        payload=Payload(outer_end_mass_kg=prototype.payload.outer_end_mass_kg or (0.0, 0.0)),
        **picked(prototype, "name actuator servovalve sensor goal tolerance"),
    )


def _asked_of(beam: Beam) -> BeamProblem:
    same = picked(beam, "length_m free_length_m material shape end_mass_kg damping_ratio")
    ratio = beam.tube.depth_over_width if beam.tube is not None and beam.shape == "rectangle" else None
    return BeamProblem.model_validate(same | {"depth_over_width": ratio})


def check_prototype(prototype: Prototype, tip_force_N: float, source: str = "prototype") -> CheckedPair:
    """Check a prototype's own sections, corner radii included, for what they are to keep: see `problem_of`.

    Where a stiffness is measured the tubes bend as that says.

    Args:
        prototype: its beams must give their geometry.
        tip_force_N: the load to check for, N.
        source: file to name in the error.

    Raises:
        InputError: naming every key of geometry that is missing.
    """
    problem = problem_of(prototype, tip_force_N, source)
    outer, inner = prototype.outer_beam.tube, prototype.inner_beam.tube
    assert outer is not None  # problem_of has refused such a prototype
    assert inner is not None
    measured = lumped_beam(prototype.outer_beam).stiffness, lumped_beam(prototype.inner_beam).stiffness
    return check_sections(problem, outer, inner, measured=measured)
