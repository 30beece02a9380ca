"""Sizing: the lightest pair of square tubes that carries the load and keeps its clearance, and what that costs."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from beamdesign.design.checks import Check
from beamdesign.design.free_search import FreeOptimum, free_optimum
from beamdesign.design.pair import CheckedPair, check_sections
from beamdesign.design.relaxation import Relaxation, relax_free, relax_stock
from beamdesign.design.stock_search import StockOptimum, stock_optimum
from beamdesign.problem import BeamProblem, DesignProblem, Load, Sections
from beamdesign.prototype import Beam, Payload, Prototype
from beamdesign.records import InputError, Problem
from beamdesign.section import SquareTube
from beamdesign.stock import stock_tubes

Progress = Callable[[float, str], object]
"""Called with the share of the work done, 0 to 1, and a word on what is being done."""

_GEOMETRY = ("width_m", "wall_m", "length_m", "free_length_m", "material")


@dataclass(frozen=True)
class Sizing:
    """What sizing found.

    Attributes:
        choose: how the sections were to be chosen.
        feasible: whether the chosen sections exist and pass every check.
        reason: why, in words; where the answer is no, what to relax.
        chosen: the chosen pair; where nothing fits, the pair that misses least.
        governing: the check that decides the chosen pair.
        free: the optimum over free sizes, or None where none was found.
        stock: the optimum over stock sizes, or None where no pair passes.
        given: the pair given in the problem (such as the published one), checked; None where none is given.
        price_of_rounding_kg: mass of the stock optimum less that of the free one; None unless there are both.
        relaxations: where nothing fits, requirements each of which could be eased alone, the smallest change first.
    """

    choose: Literal["free", "stock", "fixed"]
    feasible: bool
    reason: str
    chosen: CheckedPair
    governing: str
    free: FreeOptimum | None
    stock: StockOptimum | None
    given: CheckedPair | None
    price_of_rounding_kg: float | None
    relaxations: tuple[Relaxation, ...] = ()

    @property
    def outer(self) -> SquareTube:
        """Outer tube of the chosen pair."""
        return self.chosen.outer

    @property
    def inner(self) -> SquareTube:
        """Inner tube of the chosen pair."""
        return self.chosen.inner

    @property
    def beam_mass_kg(self) -> float:
        """Mass of the chosen pair over its full lengths."""
        return self.chosen.beam_mass_kg

    @property
    def checks(self) -> tuple[Check, ...]:
        """Checks of the chosen pair."""
        return self.chosen.checks

    @property
    def kkt_residual(self) -> float | None:
        """Residual of the first-order conditions at the free optimum."""
        return self.free.kkt_residual if self.free else None

    @property
    def shadow_prices(self) -> dict[str, float]:
        """Shadow prices at the free optimum; empty where there is none."""
        return self.free.shadow_prices if self.free else {}


def size(problem: DesignProblem, progress: Progress | None = None) -> Sizing:
    """Choose the sections of both beams as the problem says: free, stock, or fixed to those given.

    The free and the stock optimum are found in any case, so that each can be compared with the other and with the given
    pair. The stock optimum is global over the list. The free one is the best of several local searches, of which one
    starts at the stock optimum, so that it is never heavier than that.

    Args:
        problem: what is asked.
        progress: told how far the work has got.

    Raises:
        InputError: where a material is unknown.
    """
    tell = progress or (lambda share, text: None)
    given = None if problem.given is None else check_sections(problem, *problem.given)
    tell(0.0, "stock sizes")
    stock = stock_optimum(problem)
    tell(0.1, "free sizes")
    pairs = [(found.outer, found.inner) for found in (stock.pair if stock else None, given) if found]
    free = free_optimum(problem, pairs)
    price = stock.pair.beam_mass_kg - free.pair.beam_mass_kg if stock and free else None

    choose = problem.sections.choose
    relaxations: tuple[Relaxation, ...] = ()
    if choose == "fixed":
        if given is None:
            raise ValueError("sections.choose is 'fixed' but no sections are given")
        chosen, governing = given, given.governing
        if not given.feasible:
            relaxations, _ = relax_stock(problem, (given.outer, given.inner))
        reason = _of_given(given, relaxations)
    elif choose == "free" and free:
        chosen, governing = free.pair, free.governing
        reason = f"lightest pair of free sizes, from {free.starts_agreeing} of {free.starts} starts; {_by(governing)}"
    elif choose == "stock" and stock:
        chosen, governing = stock.pair, stock.pair.governing
        reason = (
            f"lightest of {stock.pairs} stock pairs, of which {stock.pairs_feasible} pass every check; {_by(governing)}"
        )
    else:
        tell(0.6, "what to relax")
        relaxations, chosen = relax_stock(problem, stock_tubes()) if choose == "stock" else relax_free(problem)
        governing = chosen.governing
        reason = _nothing_fits(choose, free, chosen, relaxations)
        if chosen.feasible:
            reason = "a pair that passes every check, but no least mass was found"
    tell(1.0, "done")
    return Sizing(choose, chosen.feasible, reason, chosen, governing, free, stock, given, price, relaxations)


def _by(governing: str) -> str:
    return f"governed by {governing}"


def _of_given(given: CheckedPair, relaxations: tuple[Relaxation, ...]) -> str:
    if given.feasible:
        return f"the given sections pass every check; {_by(given.governing)}"
    return f"the given sections fail: {_misses(given)}; {_relax(relaxations)}"


def _relax(relaxations: tuple[Relaxation, ...]) -> str:
    if not relaxations:
        return "relaxing one requirement alone was not found to help"
    return "relax one of: " + "; ".join(str(item) for item in relaxations)


def _misses(pair: CheckedPair) -> str:
    return "; ".join(_miss(check) for check in pair.failing)


def _miss(check: Check) -> str:
    value, limit, unit = check.shown
    side = "least" if check.at_least else "most"
    return f"{check.name} is {value:.4g} {unit}".rstrip() + f", needs at {side} {limit:.4g} {unit}".rstrip()


def _nothing_fits(
    choose: str, free: FreeOptimum | None, nearest: CheckedPair, relaxations: tuple[Relaxation, ...]
) -> str:
    kind = "stock" if choose == "stock" else "free"
    text = f"no pair of {kind} sizes passes every check; the nearest, {_pair(nearest)}, misses: {_misses(nearest)}"
    if kind == "free":
        text = text.replace("no pair of free sizes passes", "no pair of free sizes was found that passes")
    elif free:
        text += f"; of free sizes {_pair(free.pair)} would do, at {free.pair.beam_mass_kg:.3g} kg"
    return f"{text}; {_relax(relaxations)}"


def _pair(pair: CheckedPair) -> str:
    return " and ".join(f"{1e3 * tube.width_m:.4g} x {1e3 * tube.wall_m:.3g} mm" for tube in (pair.outer, pair.inner))


def problem_of(prototype: Prototype, tip_force_N: float, source: str = "prototype") -> DesignProblem:
    """The design problem whose fixed sections are a prototype's, with the default clearances and safety factors.

    Args:
        prototype: its beams must give their geometry, lengths included.
        tip_force_N: the load to check for, which a prototype does not state, N.
        source: file to name in the error.

    Raises:
        InputError: naming every key of geometry that is missing.
    """
    beams = {"outer_beam": prototype.outer_beam, "inner_beam": prototype.inner_beam}
    missing = [
        Problem(f"{name}.{key}", "missing; the checks of sections need it, lumped figures are not enough")
        for name, beam in beams.items()
        for key in _GEOMETRY
        if getattr(beam, key) is None
    ]
    if missing:
        raise InputError(source, missing)
    return DesignProblem(
        name=prototype.name,
        load=Load(tip_force_N=tip_force_N),
        sections=Sections(choose="fixed"),
        outer_beam=_asked_of(prototype.outer_beam),
        inner_beam=_asked_of(prototype.inner_beam),
        actuator=prototype.actuator,
        servovalve=prototype.servovalve,
        sensor=prototype.sensor,
        payload=prototype.payload if prototype.payload.outer_end_mass_kg else Payload(outer_end_mass_kg=(0.0, 0.0)),
        goal=prototype.goal,
        tolerance=prototype.tolerance,
    )


def _asked_of(beam: Beam) -> BeamProblem:
    return BeamProblem.model_validate({key: getattr(beam, key) for key in (*_GEOMETRY, "end_mass_kg", "damping_ratio")})


def check_prototype(prototype: Prototype, tip_force_N: float, source: str = "prototype") -> CheckedPair:
    """Check a prototype's own sections, corner radii included, with default clearances and safety factors.

    Args:
        prototype: its beams must give their geometry.
        tip_force_N: the load to check for, N.
        source: file to name in the error.

    Raises:
        InputError: naming every key of geometry that is missing.
    """
    problem = problem_of(prototype, tip_force_N, source)
    assert problem.given is not None  # problem_of has refused such a prototype
    radii = (prototype.outer_beam.corner_radius_m, prototype.inner_beam.corner_radius_m)
    return check_sections(problem, *problem.given, radii)
