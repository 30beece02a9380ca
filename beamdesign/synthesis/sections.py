"""Sections of both beams as variables of a search for a controller: the rig, the checks and the mass they stand for."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import exp, inf, log
from typing import Any

import casadi as ca
import numpy as np
from pydantic import ValidationError

from beamdesign.problem import DesignProblem
from beamdesign.prototype import Prototype
from beamdesign.quantities import stated_bandwidth
from beamdesign.structure.lumped import beam_figures, fixed_dashpot, servo_figures
from beamdesign.structure.section import Tube
from beamdesign.synthesis.checks import beam_mass, check_sections
from beamdesign.synthesis.free_search import SIZE_UNITS, THICKEST_SHARE, pair_of, sizing_program, tubes

ROUNDED_SLACK = 1e-4
"""Relative slack of every structural check, so that rounded sizes stay on its right side."""

_ROUNDED_MASS_KG = 5e-4
"""By how much rounding the sizes may add to the mass."""

_ROUND = 7  # decimals of a size in m

MASS_PER_MISSING_BANDWIDTH = 100.0
"""Exact penalty, kg per unit of log(bandwidth): far above what bandwidth costs, so that it is met where it can be."""


@dataclass(frozen=True)
class Sections:
    """Sections of both beams that may be chosen with a law, as w variables behind the law's and the mass inside.

    Attributes:
        start: (w,) those that the rig has to begin with.
        lower: (w,) least ones.
        upper: (w,) largest ones.
        figures: variables to the (14,) lumped figures of the linear model, in symbols.
        filtered: whether the sensor has a filter.
        rig: of two beams, one of `beamdesign.plant.assembly.RIGS`.
        prototype: variables, and whether sizes are rounded as they will be written down, to the rig they stand for;
            a ValueError where they are the sizes of no tubes, or of an inner one that does not go into the outer one.
        structure: mass inside (kg) and variables to slacks that must not be negative, in symbols or numbers.
        moving_mass: mass inside (kg) and variables to that and the mass of both beams, in symbols or numbers.
        flaw: mass inside (kg) and variables to the reason why the rounded sections may not be built, empty where they
            may.
        needed_Hz: bandwidth that is to be had with the least moving mass; None for the largest bandwidth.
    """

    start: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    figures: Callable[[ca.MX], ca.MX]
    filtered: bool
    rig: str
    prototype: Callable[[np.ndarray, bool], Prototype]
    structure: Callable[[Any, Any], Any]
    moving_mass: Callable[[Any, Any], Any]
    flaw: Callable[[float, np.ndarray], str]
    needed_Hz: float | None = None

    def value(self, inner: float, chosen: np.ndarray, bandwidth_Hz: float) -> float:
        """Worth of sections with a mass inside (kg) and the bandwidth they reach: that, or one over the moving mass."""
        if self.needed_Hz is None:
            return bandwidth_Hz
        missing = max(0.0, log(self.needed_Hz / bandwidth_Hz)) if bandwidth_Hz > 0 else inf
        return 1 / (float(self.moving_mass(inner, chosen)) + MASS_PER_MISSING_BANDWIDTH * missing)

    def hopeless(self, inner: float, chosen: np.ndarray, value: float) -> str:
        """Why nothing near a sampled design of a value is worth proving; empty where something may be."""
        if self.needed_Hz is None or value <= 0:
            return ""
        missing = (1 / value - float(self.moving_mass(inner, chosen))) / MASS_PER_MISSING_BANDWIDTH
        if missing < log(2):
            return ""
        return f"reaches {self.needed_Hz * exp(-missing):.3g} Hz on samples, {self.needed_Hz:.4g} Hz are needed"

    def refused(self, inner: float, chosen: np.ndarray, bandwidth_Hz: float) -> str:
        """Why a proved loop is no answer; empty where it is one."""
        if self.needed_Hz is not None and bandwidth_Hz < self.needed_Hz:
            return f"guarantees {stated_bandwidth(bandwidth_Hz)}, {self.needed_Hz:g} Hz are needed"
        return self.flaw(inner, chosen)


def rounded_tubes(problem: DesignProblem, section_variables: np.ndarray) -> tuple[Tube, Tube]:
    """Rounded tubes, as they will be written down."""
    return pair_of(problem, [round(float(size), _ROUND) for size in section_variables[:4] * SIZE_UNITS])


def _symbolic_figures(problem: DesignProblem) -> Callable[[ca.MX], ca.MX]:
    """Section variables to the lumped figures of the linear model."""
    hydraulics = servo_figures(problem)

    def figures(sections: ca.MX) -> ca.MX:
        sizes = [float(unit) * sections[i] for i, unit in enumerate(SIZE_UNITS)]
        lumped: list[ca.MX] = []
        for asked, tube in zip(problem.beams, pair_of(problem, sizes), strict=True):
            stiffness, mass = beam_figures(asked.material, tube, asked.free_length_m, asked.end_mass_kg)
            lumped += [stiffness, mass, fixed_dashpot(asked.damping_ratio, stiffness, mass)]
        return ca.vertcat(*lumped, *hydraulics.values())

    return figures


def _prototype(problem: DesignProblem, pair: tuple[Tube, Tube]) -> Prototype:
    """The rig with these tubes; a ValueError where the record of it refuses them."""
    try:
        return problem.prototype(*pair)
    except ValidationError:
        raise ValueError("these sizes are no pair of tubes") from None


def section_mass(problem: DesignProblem, sections: np.ndarray) -> float:
    """Mass of both beams, kg."""
    return float(beam_mass(problem, *rounded_tubes(problem, sections)))


def free_sections(
    problem: DesignProblem,
    start: np.ndarray,
    needed_Hz: float | None = None,
    largest_mass_kg: float | None = None,
    free: Sequence[int] = range(4),
) -> Sections:
    """The sections of a problem as something to be chosen with a controller.

    Args:
        problem: its load and limits.
        start: (8,) variables to begin with, see `beamdesign.synthesis.free_search.start_variables`.
        needed_Hz: bandwidth to be had with the least moving mass; None for the largest bandwidth.
        largest_mass_kg: of both beams and the mass inside; None for any.
        free: by number which of the four sizes may change; none: these are not checked, whatever they are.
    """
    sizing = sizing_program(problem)
    parts = ca.Function("sizing", [sizing.variables, sizing.asked], [sizing.constraints, sizing.mass])
    widest, thinnest = problem.sections.largest_width_m, problem.sections.least_wall_m
    sizes = [(5 * thinnest, widest), (thinnest, THICKEST_SHARE * widest)] * 2
    bounds = np.array([*(np.divide(ends, unit) for ends, unit in zip(sizes, SIZE_UNITS, strict=True)), *[(0, 1)] * 4])
    for fixed in range(len(bounds)) if not free else set(range(4)) - set(free):
        bounds[fixed] = start[fixed]

    def structure(inner: Any, chosen: Any) -> Any:
        constraints, mass = parts(chosen, sizing.figures)
        spare = [] if largest_mass_kg is None else [largest_mass_kg - _ROUNDED_MASS_KG - mass - inner]
        return ca.vertcat(-constraints - ROUNDED_SLACK, *spare) if free else ca.DM(0, 1)

    def flaw(inner: float, chosen: np.ndarray) -> str:
        if not free:
            return ""
        mass = section_mass(problem, chosen) + inner
        if largest_mass_kg is not None and mass > largest_mass_kg:
            return f"moves {mass:.6g} kg, more than {largest_mass_kg:.6g} kg"
        missed = check_sections(problem, *rounded_tubes(problem, chosen)).failing
        return "the refined sections miss: " + ", ".join(check.name for check in missed) if missed else ""

    return Sections(
        start=np.clip(start, bounds[:, 0], bounds[:, 1]),
        lower=bounds[:, 0],
        upper=bounds[:, 1],
        figures=_symbolic_figures(problem),
        filtered=problem.sensor.filter_Hz is not None,
        rig=problem.rig,
        prototype=lambda chosen, rounded: _prototype(problem, (rounded_tubes if rounded else tubes)(problem, chosen)),
        structure=structure,
        moving_mass=lambda inner, chosen: parts(chosen, sizing.figures)[1] + inner,
        flaw=flaw,
        needed_Hz=needed_Hz,
    )
