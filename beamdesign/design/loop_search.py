"""Coarse search for good loops: on a grid of frequencies and masses, for each controller shape the best gain.

Everything here is sampled and only proposes; what is proposed is refined and proved elsewhere.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np
from flint import fmpq_poly

from beamdesign.design.controller_forms import ControllerForm
from beamdesign.linear import BilinearPlant
from beamdesign.proof.rational import nearest


@dataclass(frozen=True)
class GridPlant:
    """Plant responses on a frequency grid, bilinear in the outer (m) and the inner (n) end mass.

    Attributes:
        frequency_Hz: (f,) grid.
        denominator: (2, 2, f), entry [i, j] multiplying m^i n^j.
        control: (2, f), entry [j] multiplying n^j; current to sensor voltage.
        disturbance: (2, f), likewise; force to displacement.
        riding: (2, 2, f) where the sensor rides on the mount, what of that reading goes with m, then what the
            force shows by way of the controller; else none.
    """

    frequency_Hz: np.ndarray
    denominator: np.ndarray
    control: np.ndarray
    disturbance: np.ndarray
    riding: np.ndarray | None = None


SEARCH_FREQUENCIES_HZ = np.geomspace(0.05, 600.0, 300)
"""Grid of the coarse search: 3 % steps, finer than the half-width of a mode with 5 % damping."""


@dataclass(frozen=True)
class Candidate:
    """A sampled guess: guaranteed bandwidth on the grid, gain in A/V, the shape's parameters, inner end mass in kg."""

    bandwidth_Hz: float
    gain: float
    shape: tuple[float, ...]
    inner_end_mass: float


def grid_plant(plant: BilinearPlant, frequency_Hz: np.ndarray, factor: float = 1.0) -> GridPlant:
    """Evaluate a plant with the tip's displacement sensed on a grid, in floats, with its gain times a factor."""
    s = 2j * pi * frequency_Hz

    def at(polynomial: fmpq_poly) -> np.ndarray:
        return np.polyval([nearest(c) for c in reversed(polynomial.coeffs())], s)

    denominator = np.array([[at(polynomial) for polynomial in row] for row in plant.denominator])
    disturbance = np.array([at(p) for p in plant.disturbance])
    control = factor * np.array([at(p) for p in plant.control[0][0]])
    if not plant.mass_shows:
        return GridPlant(frequency_Hz, denominator, control, disturbance)
    riding = factor * np.array([[at(p) for p in pair] for pair in (plant.control[0][1], plant.crossed[0])])
    return GridPlant(frequency_Hz, denominator, control, disturbance, riding)


def feasible_gain_ends(loop_per_gain: np.ndarray, peak_sensitivity: float) -> np.ndarray:
    """Upper ends of the intervals of gain K on which |1 / (1 + K l)| stays within the limit at every sample l.

    Each sample forbids one interval of K, the roots of |1 + K l|^2 = 1 / Ms^2; a lightly damped resonance forbids low
    gains as well, so that the allowed set need not begin at zero.
    """
    real, square = loop_per_gain.real.ravel(), (np.abs(loop_per_gain) ** 2).ravel()
    discriminant = real**2 - square * (1 - peak_sensitivity**-2)
    forbids = (real < 0) & (discriminant > 0)
    if not forbids.any():
        return np.array([])
    root, middle, scale = np.sqrt(discriminant[forbids]), -real[forbids], square[forbids]
    starts, ends = (middle - root) / scale, (middle + root) / scale
    order = np.argsort(starts)
    starts, reach = starts[order], np.maximum.accumulate(ends[order])
    return np.concatenate([starts[:1], starts[1:][starts[1:] > reach[:-1] * (1 + 1e-9)]])


def sampled_bandwidth(frequency_Hz: np.ndarray, worst_compliance: np.ndarray, limit: float) -> float:
    """First frequency at which the compliance passes the limit, interpolated between samples on logarithmic axes."""
    over = np.nonzero(worst_compliance > limit)[0]
    if not len(over):
        return float(frequency_Hz[-1])
    i = int(over[0])
    if i == 0:
        return float(frequency_Hz[0] * limit / worst_compliance[0])
    share = np.log(limit / worst_compliance[i - 1]) / np.log(worst_compliance[i] / worst_compliance[i - 1])
    return float(frequency_Hz[i - 1] * (frequency_Hz[i] / frequency_Hz[i - 1]) ** share)


def best_gain(
    grid: GridPlant | Sequence[GridPlant],
    form: ControllerForm,
    shape: Sequence[float],
    inner_end_mass: float,
    outer_end_masses: np.ndarray,
    peak_sensitivity: float,
    compliance: float,
    only_stable: bool = False,
) -> Candidate:
    """Best gain of one controller shape and inner end mass on the grid; bandwidth 0 where none is allowed.

    Args:
        grid: plant responses, or those of all plants that are to do with this controller, on one grid of frequencies.
        form: kind of controller.
        shape: its parameters after the gain.
        inner_end_mass: kg.
        outer_end_masses: (m,) samples of the range, kg.
        peak_sensitivity: limit of max |S|.
        compliance: limit of |x / F_d|, m/N.
        only_stable: leave out gains at which 1 + L winds about the origin on the grid. With much phase beyond the grid,
            loops that are far from stable have small sensitivities on it.
    """
    grids = [grid] if isinstance(grid, GridPlant) else grid
    frequency = grids[0].frequency_Hz
    s = 2j * pi * frequency
    numerator, denominator = (np.polyval(p[::-1], s) for p in form.polynomials(shape))
    responses, stiffnesses, crossings = [], [], []
    for one in grids:
        rows = one.denominator[:, 0] + inner_end_mass * one.denominator[:, 1]
        plant = rows[0] + outer_end_masses[:, None] * rows[1]
        control = one.control[0] + inner_end_mass * one.control[1]
        disturbance = one.disturbance[0] + inner_end_mass * one.disturbance[1]
        crossed = np.zeros_like(plant)
        if one.riding is not None:
            slope, second = one.riding[:, 0] + inner_end_mass * one.riding[:, 1]
            control = control + outer_end_masses[:, None] * slope
            crossed += second * (numerator / denominator) / disturbance
        responses.append(control * (numerator / denominator) / plant)
        stiffnesses.append(np.abs(plant) / np.abs(disturbance))  # |F_d / x| of the open loop
        crossings.append(crossed)  # by what share of it a unit of gain changes what the force does
    per_gain, stiffness = np.concatenate(responses), np.concatenate(stiffnesses)
    per_gain_crossed = np.concatenate(crossings) if any(one.riding is not None for one in grids) else None
    best = Candidate(0.0, 0.0, tuple(shape), inner_end_mass)
    for gain in feasible_gain_ends(per_gain, peak_sensitivity):
        if only_stable and (np.abs(np.unwrap(np.angle(1 + gain * per_gain), axis=1)[:, -1]) > pi).any():
            continue
        closed = stiffness * np.abs(1 + gain * per_gain)
        if per_gain_crossed is not None:
            closed /= np.abs(1 + gain * per_gain_crossed)
        worst = 1 / closed.min(axis=0)
        bandwidth = sampled_bandwidth(frequency, worst, compliance)
        if bandwidth > best.bandwidth_Hz:
            best = Candidate(bandwidth, float(gain), tuple(shape), inner_end_mass)
    return best
