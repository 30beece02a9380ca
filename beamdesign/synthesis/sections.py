"""Sections of both beams as variables of a search for a controller: the rig, the checks and the mass they stand for."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from math import exp, inf, log
from typing import Any

import casadi as ca
import numpy as np
from pydantic import ValidationError

from beamdesign.problem import DesignProblem
from beamdesign.proofs.certificate import Kind
from beamdesign.prototype import Prototype
from beamdesign.quantities import stated_bandwidth
from beamdesign.structure.lumped import beam_figures, fixed_dashpot, servo_figures
from beamdesign.synthesis.checks import beam_mass, check_sections
from beamdesign.synthesis.free_search import THICKEST_SHARE, pair_of, size_units, sizing_program, tubes
from beamdesign.synthesis.loop_program import sized_slack

ROUNDED_SLACK = 1e-4
"""Relative slack of every structural check, so that rounded sizes stay on its right side."""

_ROUNDED_MASS = 5e-4
"""By how much rounding the sizes may add to the mass, in units of the problem's."""

MASS_PER_MISSING_BANDWIDTH = 100.0
"""Exact penalty, likewise, per unit of log(bandwidth): far above what bandwidth costs, so that it is met if it can."""


@dataclass(frozen=True)
class Sections:
    """Sections of both beams that may be chosen with a law, as variables behind its own and the mass inside.

    Attributes:
        problem: its load and limits.
        begun: (8,) variables to begin with, see `beamdesign.synthesis.free_search.start_variables`.
        needed_Hz: bandwidth that is to be had with the least moving mass; None for the largest bandwidth.
        largest_mass_kg: of both beams and the mass inside; None for any.
        free: by number which of the four sizes may change; none: these are not checked, whatever they are.
    """

    problem: DesignProblem
    begun: np.ndarray
    needed_Hz: float | None = None
    largest_mass_kg: float | None = None
    free: Sequence[int] = range(4)

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest variables, (8,) each."""
        widest, thinnest = self.problem.sections.largest_width_m, self.problem.sections.least_wall_m
        sizes = [(5 * thinnest, widest), (thinnest, THICKEST_SHARE * widest)] * 2
        scaled = (np.divide(ends, unit) for ends, unit in zip(sizes, size_units(self.problem), strict=True))
        bounds = np.array([*scaled, *[(0, 1)] * 4])
        for fixed in range(len(bounds)) if not self.free else set(range(4)) - set(self.free):
            bounds[fixed] = self.begun[fixed]
        return bounds[:, 0], bounds[:, 1]

    @property
    def start(self) -> np.ndarray:
        """(8,) those that the rig has to begin with."""
        return np.clip(self.begun, *self.bounds)

    def figures(self, chosen: ca.MX) -> ca.MX:
        """The (14,) lumped figures of the linear model, in symbols."""
        sizes = [float(unit) * chosen[i] for i, unit in enumerate(size_units(self.problem))]
        lumped = list[ca.MX]()
        for asked, tube in zip(self.problem.beams, pair_of(self.problem, sizes), strict=True):
            stiffness, mass = beam_figures(asked.material, tube, asked.free_length_m, asked.end_mass_kg)
            lumped += [stiffness, mass, fixed_dashpot(asked.damping_ratio, stiffness, mass)]
        return ca.vertcat(*lumped, *servo_figures(self.problem).values())

    def slack(self, shape: tuple[int, int], kind: Kind) -> ca.Function:
        """Of a limit at one point in terms of these figures, see `sized_slack`."""
        return sized_slack(shape, kind, self.problem.sensor.filter_Hz is not None, self.problem.rig)

    def prototype(self, chosen: np.ndarray, rounded: bool) -> Prototype:
        """The rig, its sizes rounded as they will be written down or not.

        Raises:
            ValueError: where they are the sizes of no tubes, or of an inner one that does not go into the outer one.
        """
        try:
            return self.problem.prototype(*tubes(self.problem, chosen, rounded))
        except ValidationError:
            raise ValueError("these sizes are no pair of tubes") from None

    @property
    def possible(self) -> bool:
        """Whether there is a rig to begin with: within the largest width larger tubes need not go into each other."""
        with suppress(ValueError):
            return bool(self.prototype(self.start, False))
        return False

    @cached_property
    def _parts(self) -> Callable[[Any], Any]:
        """Variables to the constraints of the sizing problem and the mass of both beams, kg."""
        sizing = sizing_program(self.problem)
        both = ca.Function("sizing", [sizing.variables, sizing.asked], [sizing.constraints, sizing.mass])
        return lambda chosen: both(chosen, sizing.figures)

    def structure(self, inner: Any, chosen: Any) -> Any:
        """Slacks that must not be negative with a mass inside (kg), in symbols or numbers."""
        constraints, mass = self._parts(chosen)
        most, unit = self.largest_mass_kg, self.mass_unit_kg
        spare = [] if most is None else [(most - _ROUNDED_MASS * unit - mass - inner) / unit]
        return ca.vertcat(-constraints - ROUNDED_SLACK, *spare) if self.free else ca.DM(0, 1)

    def moving_mass(self, inner: Any, chosen: Any) -> Any:
        """Mass inside and of both beams, kg, in symbols or numbers."""
        return self._parts(chosen)[1] + inner

    def flaw(self, inner: float, chosen: np.ndarray) -> str:
        """Why the rounded sections may not be built with a mass inside (kg); empty where they may."""
        if not self.free:
            return ""
        mass, most = section_mass(self.problem, chosen) + inner, self.largest_mass_kg
        if most is not None and mass > most:
            return f"moves {mass:.6g} kg, more than {most:.6g} kg"
        missed = check_sections(self.problem, *tubes(self.problem, chosen, rounded=True)).failing
        return "the refined sections miss: " + ", ".join(check.name for check in missed) if missed else ""

    @property
    def mass_unit_kg(self) -> float:
        """What masses count in that are made small, kg."""
        return self.problem.mass_unit_kg

    def value(self, inner: float, chosen: np.ndarray, bandwidth_Hz: float) -> float:
        """Worth of sections with a mass inside (kg) and the bandwidth they reach: that, or one over the moving mass."""
        if self.needed_Hz is None:
            return bandwidth_Hz
        missing = max(0.0, log(self.needed_Hz / bandwidth_Hz)) if bandwidth_Hz > 0 else inf
        return 1 / (float(self.moving_mass(inner, chosen)) + MASS_PER_MISSING_BANDWIDTH * self.mass_unit_kg * missing)

    def hopeless(self, inner: float, chosen: np.ndarray, value: float) -> str:
        """Why nothing near a sampled design of a value is worth proving; empty where something may be."""
        if self.needed_Hz is None or value <= 0:
            return ""
        beyond_kg = 1 / value - float(self.moving_mass(inner, chosen))
        missing = beyond_kg / (MASS_PER_MISSING_BANDWIDTH * self.mass_unit_kg)
        if missing < log(2):
            return ""
        return f"reaches {self.needed_Hz * exp(-missing):.3g} Hz on samples, {self.needed_Hz:.4g} Hz are needed"

    def refused(self, inner: float, chosen: np.ndarray, bandwidth_Hz: float) -> str:
        """Why a proved loop is no answer; empty where it is one."""
        if self.needed_Hz is not None and bandwidth_Hz < self.needed_Hz:
            return f"guarantees {stated_bandwidth(bandwidth_Hz)}, {self.needed_Hz:g} Hz are needed"
        return self.flaw(inner, chosen)


def section_mass(problem: DesignProblem, sections: np.ndarray) -> float:
    """Mass of both beams, rounded, kg."""
    return float(beam_mass(problem, *tubes(problem, sections, rounded=True)))
