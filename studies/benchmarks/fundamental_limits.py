"""Bounds that no controller passes, in the linear model: Bode's integral, the actuator's power, and what noise moves.

Bode's integral (H. W. Bode, Network Analysis and Feedback Amplifier Design, 1945; J. S. Freudenberg and D. P. Looze,
Right half plane poles and zeros and design tradeoffs in feedback systems, IEEE Transactions on Automatic Control 30,
1985; M. M. Seron, J. H. Braslavsky and G. C. Goodwin, Fundamental Limitations in Filtering and Control, 1997, theorem
3.1.4; G. Stein, Respect the unstable, IEEE Control Systems Magazine 23, 2003): where L falls off with at least two more
poles than zeros and the closed loop is stable, the integral of ln |S| over all frequencies is pi times the sum of the
real parts of the unstable poles of L, so that it is never negative.

With the displacement as the only thing sensed, x / F_d = g S, where g is the open loop's compliance: S has to be small
wherever g is above the goal. Everywhere else it is bounded by the peak sensitivity, by the limit of |L| where there is
one, and by |S| <= 1 + |P| |C S|, where the limit of |C S| bounds it. What S may gain under these bounds must make up
for what it has to lose. With added sensors S at the current is another one, and this bound says nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, pi

import numpy as np

from beamdesign import Prototype
from beamdesign.plant.members import family
from beamdesign.prototype import Goal
from beamdesign.synthesis.synthesis import StateSpace, sensed_model

_LOWEST_HZ, _HIGHEST_HZ, _POINTS = 1e-3, 1e6, 12000

NOISE_BAND_HZ = 1000.0
"""Up to which a sensor's noise is taken to be white: its stated RMS is what is seen in this band."""

PHASE_AT_HZ = 100.0
"""Where the phase that a mode costs is given: about where a fast loop crosses over."""


@dataclass(frozen=True)
class Limits:
    """What no controller passes, for one inner end mass and m payloads.

    Attributes:
        outer_end_mass_kg: (m) the payloads.
        bode_Hz: (m) no displacement feedback within the goal's limits keeps its compliance beyond; infinite where the
            limits leave room for any.
        effort_Hz: (m) up to where |C S| within its limit can hold the goal at all; displacement feedback.
        frequency_Hz: (f,) at which the following are given.
        force_N: (m, f) largest amplitude of a force that the rated current holds to the goal, whatever is sensed;
            infinite where the beams do it alone. None without a rated current.
        stall_N: steady force at which the supply's whole pressure is on one side.
        noise_m: (m, f) least RMS up to that frequency of the tip's motion from the sensor's noise, in a loop of
            displacement feedback that keeps the goal there. None where the noise is not stated.
        mode_Hz: (m) frequency of the second mode; None, as the next two, without it.
        mode_phase_deg: (m) what it adds to the phase of the plant at `PHASE_AT_HZ`; negative is lag.
        mode_gain: (m) largest factor by which it raises the plant from the frequency up from which |L| is limited.
    """

    outer_end_mass_kg: tuple[float, ...]
    bode_Hz: tuple[float, ...]
    effort_Hz: tuple[float, ...]
    frequency_Hz: np.ndarray
    force_N: np.ndarray | None
    stall_N: float
    noise_m: np.ndarray | None
    mode_Hz: tuple[float, ...] | None
    mode_phase_deg: tuple[float, ...] | None
    mode_gain: tuple[float, ...] | None

    @property
    def bandwidth_Hz(self) -> float:
        """Bound for displacement feedback that serves all of the payloads."""
        return min(*self.bode_Hz, *self.effort_Hz)


def fundamental_limits(
    prototype: Prototype, outer_end_masses: Sequence[float], inner_end_mass: float | None = None
) -> Limits:
    """The bounds of a prototype's rig within its goal; its controller has no part in them.

    Args:
        prototype: with or without effects; of those the member at rest is taken.
        outer_end_masses: payloads, kg.
        inner_end_mass: kg; that of the prototype where None.
    """
    inner = prototype.payload.inner_end_mass_kg if inner_end_mass is None else inner_end_mass
    rig, goal, heaviest = family(prototype, max(outer_end_masses)).rest.rig, prototype.goal, max(outer_end_masses)
    plants = [sensed_model(rig, mass, inner) for mass in outer_end_masses]
    shown = np.geomspace(0.5, 200.0, 400)
    rated, noise = prototype.servovalve.rated_current_A, prototype.sensor.noise_V
    where = phase = gain = None
    if "second_beam_mode" in prototype.effects:
        others = {name: table for name, table in prototype.effects.items() if name != "second_beam_mode"}
        without = family(prototype.but(effects=others), heaviest).rest.rig
        cost = [
            mode_cost(plant, sensed_model(without, mass, inner), goal.loop_gain_from_Hz)
            for plant, mass in zip(plants, outer_end_masses, strict=True)
        ]
        where, phase, gain = (tuple(part) for part in zip(*cost, strict=True))
    return Limits(
        outer_end_mass_kg=tuple(outer_end_masses),
        bode_Hz=tuple(bode_bound_Hz(plant, goal) for plant in plants),
        effort_Hz=tuple(effort_bound_Hz(plant, goal) for plant in plants),
        frequency_Hz=shown,
        force_N=None if rated is None else np.array([held_force(plant, goal, rated, shown) for plant in plants]),
        stall_N=prototype.actuator.piston_area_m2 * prototype.supply.pressure_Pa,
        noise_m=None if noise is None else np.array([least_noise(plant, goal, noise, shown) for plant in plants]),
        mode_Hz=where,
        mode_phase_deg=phase,
        mode_gain=gain,
    )


def allowed_sensitivity(plant: StateSpace, goal: Goal, frequency_Hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Most that |S| may be at frequencies within the bandwidth, and beyond it; displacement feedback."""
    response = plant.at(2j * np.pi * frequency_Hz)
    beyond = np.full(len(frequency_Hz), goal.peak_sensitivity)
    if goal.controller_effort_A_per_V is not None:
        beyond = np.minimum(beyond, 1 + goal.controller_effort_A_per_V * np.abs(response[:, 1, 1]))
    if goal.loop_gain is not None and goal.loop_gain < 1:
        limited = frequency_Hz >= goal.loop_gain_from_Hz
        beyond = np.where(limited, np.minimum(beyond, 1 / (1 - goal.loop_gain)), beyond)
    return np.minimum(beyond, goal.compliance_m_per_N / np.abs(response[:, 0, 0])), beyond


def bode_bound_Hz(plant: StateSpace, goal: Goal) -> float:
    """Largest bandwidth that Bode's integral leaves open, for any controller that is proper and a stable plant.

    What is allowed of ln |S| is integrated by trapezoids on a fine grid: each bandwidth has one sum, which falls with
    it, and where it is negative there is no such loop. Above the grid, where P falls off with its fifth power at least,
    nothing is left to gain. Without a limit of |C S| nothing bounds it there, and neither is the bandwidth.
    """
    if goal.controller_effort_A_per_V is None:
        return inf
    grid = np.geomspace(_LOWEST_HZ, _HIGHEST_HZ, _POINTS)
    within, beyond = (np.log(part) for part in allowed_sensitivity(plant, goal, grid))
    widths = np.diff(grid)
    # Below the grid everything is as at its lowest frequency.
    up_to = within[0] * grid[0] + np.append(0.0, np.cumsum((within[1:] + within[:-1]) / 2 * widths))
    above = np.append(np.cumsum(((beyond[1:] + beyond[:-1]) / 2 * widths)[::-1])[::-1], 0.0)
    return _first_below_zero(grid, up_to + above)


def effort_bound_Hz(plant: StateSpace, goal: Goal) -> float:
    """Up to where the goal can be held with |C S| within its limit: |C S| = |1 - S| / |P| >= (1 - |S|) / |P|."""
    if goal.controller_effort_A_per_V is None:
        return inf
    grid = np.geomspace(_LOWEST_HZ, _HIGHEST_HZ, _POINTS)
    response = plant.at(2j * np.pi * grid)
    least = (1 - goal.compliance_m_per_N / np.abs(response[:, 0, 0])) / np.abs(response[:, 1, 1])
    return _first_below_zero(grid, goal.controller_effort_A_per_V - least)


def _first_below_zero(grid: np.ndarray, value: np.ndarray) -> float:
    """Where on a grid a value first falls below zero, interpolated; infinite where it never does."""
    below = np.nonzero(value < 0)[0]
    if not len(below):
        return inf
    k = int(below[0])
    if k == 0:
        return 0.0
    return float(grid[k - 1] + value[k - 1] / (value[k - 1] - value[k]) * (grid[k] - grid[k - 1]))


def held_force(plant: StateSpace, goal: Goal, current_A: float, frequency_Hz: np.ndarray) -> np.ndarray:
    """Largest amplitude (N) of a force at each frequency that a current holds to the goal, (f,).

    From x = g F + h i, whatever makes the current: |i| >= (|g| - goal) |F| / |h|.
    """
    response = plant.at(2j * np.pi * frequency_Hz)[:, 0]
    short = np.abs(response[:, 0]) - goal.compliance_m_per_N
    with np.errstate(divide="ignore"):
        return np.where(short > 0, current_A * np.abs(response[:, 1]) / np.maximum(short, 0.0), inf)


def least_noise(plant: StateSpace, goal: Goal, noise_V: float, frequency_Hz: np.ndarray) -> np.ndarray:
    """Least RMS (m) up to each frequency of the tip's motion from noise that is white up to `NOISE_BAND_HZ`, (f,).

    The tip follows the noise by T = 1 - S over the sensor's own response, and |T| >= 1 - |S| where the goal is kept.
    """
    grid = np.unique(np.concatenate([np.geomspace(_LOWEST_HZ, frequency_Hz.max(), 4000), frequency_Hz]))
    response = plant.at(2j * np.pi * grid)
    follows = np.maximum(1 - goal.compliance_m_per_N / np.abs(response[:, 0, 0]), 0.0)
    follows *= np.abs(response[:, 0, 1] / response[:, 1, 1])
    power = np.append(0.0, np.cumsum((follows[1:] ** 2 + follows[:-1] ** 2) / 2 * np.diff(grid)))
    return noise_V * np.sqrt(np.interp(frequency_Hz, grid, power) / NOISE_BAND_HZ)


def mode_cost(plant: StateSpace, without: StateSpace, from_Hz: float) -> tuple[float, float, float]:
    """Frequency (Hz) of the second mode, phase (degrees) that it adds at `PHASE_AT_HZ`, largest gain it adds above."""
    from scipy.optimize import linear_sum_assignment

    poles, others = np.linalg.eigvals(plant.a), np.linalg.eigvals(without.a)
    _, matched = linear_sum_assignment(np.abs(others[:, None] - poles))
    own = poles[np.setdiff1d(np.arange(len(poles)), matched)]
    grid = np.append(PHASE_AT_HZ, np.geomspace(from_Hz, 10 * from_Hz, 2000))
    ratio = plant.at(2j * np.pi * grid)[:, 1, 1] / without.at(2j * np.pi * grid)[:, 1, 1]
    return float(np.abs(own).max() / (2 * pi)), float(np.degrees(np.angle(ratio[0]))), float(np.abs(ratio[1:]).max())
