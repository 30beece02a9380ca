"""Critical gains as evidence, from one generalised eigenvalue problem each instead of a sweep.

With the loop opened at the controller's gain, x' = A x + K b (c x), a pole lies at jw for the gain K = 1 / G(jw) where
G(s) = c (s - A)^-1 b is real there. G is real where G(s) = G(-s): the zeros on the axis of a system of twice the order
(A. Emami-Naeini and P. Van Dooren, Automatica 18 (1982) 415, zeros as generalised eigenvalues). Each is then brought to
rounding by Newton's method on Im G(jw).
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from math import log, sqrt, tau

import numpy as np
from scipy.linalg import eigvals

from beamdesign.diagnosis.data.dataset import MeasuredGain
from beamdesign.diagnosis.fitting.hypothesis import Placement
from beamdesign.diagnosis.fitting.linear_evidence import LinearEvidence, LinearModel
from beamdesign.plant.effects import library

_TIME = 1e3  # rad/s: typical of the loop, so that figures are about one
_SLOWEST, _FASTEST = 1e-3, 1e3  # in that unit; slower is drift, faster no rig
_NEAR_AXIS = 1e-2
_SETTLED, _MOST_STEPS = 1e-12, 12
_UNSTABLE = 1e-9
_ABOVE = 1.001  # of a critical gain


@dataclass(frozen=True)
class Onset:
    """Where a loop that is stable below begins to oscillate, with what its derivative needs.

    Attributes:
        gain: A/V.
        frequency: rad/s.
        point: (n,) states at which the loop was linearised.
        right: (n,) what the states do in that oscillation, over their typical magnitudes.
        left: (n,) left eigenvector.
        by_gain: derivative of the pole by the gain, complex.
        swings: whether the rig may oscillate for good at a lower gain, once it is pushed.
    """

    gain: float
    frequency: float
    point: np.ndarray = field(repr=False)
    right: np.ndarray = field(repr=False)
    left: np.ndarray = field(repr=False)
    by_gain: complex
    swings: bool = False


def onset(model: LinearModel, z: np.ndarray, raised_from: float = 0.0) -> Onset | None:
    """The least gain at which the loop of a model begins to oscillate, over the directions of its valve.

    The equilibrium is that at the believed gain; it depends on the gain only where the valve leaks unevenly, and there
    by the shift of the tip alone.

    Args:
        model: of one setting of the rig.
        z: unknowns.
        raised_from: gain (A/V) to begin with where the loop is stable there; else with none.

    Returns:
        None where the loop has no equilibrium, or no gain takes it from stable to oscillating.
    """
    p = model.parameters(z)
    try:
        points = model.points(p)
    except ValueError:
        return None
    found = [at for x in points if (at := _onset_at(model, p, x, raised_from)) is not None]
    return min(found, key=lambda at: at.gain, default=None)


def onset_slopes(model: LinearModel, z: np.ndarray, at: Onset) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives (K,) of ln gain and of ln frequency by z, by the implicit function theorem at the axis."""
    weight = model.weight
    moved = [at.left @ _scaled(slope.a, weight) @ at.right for slope in model.slopes(z, at.point, at.gain)]
    pole = np.array(moved, dtype=complex) / (at.left @ at.right)
    by_gain = at.by_gain
    gain = -pole.real / by_gain.real
    frequency = (pole + by_gain * gain).imag
    return gain / at.gain, frequency * _TIME / at.frequency


def _onset_at(model: LinearModel, p: np.ndarray, x: np.ndarray, raised_from: float) -> Onset | None:
    weight, at = model.weight, model.assembly.parameters.index("gain")
    unit = float(p[at])
    once, twice = (_scaled(a, weight) for a in model.rates_at_gains(p, x, (unit, 2 * unit)))
    feedback = (twice - once) / unit
    open_loop = once - unit * feedback
    if not np.any(feedback):
        return None
    row, column = np.unravel_index(int(np.argmax(np.abs(feedback))), feedback.shape)
    b, c = feedback[:, column] / feedback[row, column], feedback[row]
    least = before = raised_from if raised_from and _is_stable(open_loop + raised_from * feedback) else 0.0
    for gain, w in phase_crossings(open_loop, b, c):
        if gain <= least:
            continue
        middle = sqrt(before * gain) if before else 0.5 * gain
        if _is_stable(open_loop + middle * feedback) and not _is_stable(open_loop + _ABOVE * gain * feedback):
            resolvent = 1j * w * np.eye(len(open_loop)) - open_loop
            right, left = np.linalg.solve(resolvent, b), np.linalg.solve(resolvent.T, c)
            by_gain = complex((left @ b) * (c @ right) / (left @ right))
            return Onset(gain, w * _TIME, x, right, left, by_gain)
        before = gain
    return None


def phase_crossings(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> Iterator[tuple[float, float]]:
    """All positive gains K at which a + K b c has a pole jw on the axis, w > 0, with w; ascending by gain.

    Args:
        a: (n, n), with states and time in units that make its entries of order one.
        b: (n,).
        c: (n,).
    """
    n = len(a)
    # G(s) - G(-s): the system and its mirror image, side by side
    pencil = np.zeros((2 * n + 1, 2 * n + 1))
    pencil[:n, :n], pencil[n : 2 * n, n : 2 * n] = a, -a
    # sizes of b and c do not move the zeros
    pencil[:n, -1] = pencil[n : 2 * n, -1] = b / np.linalg.norm(b)
    pencil[-1, :n] = pencil[-1, n : 2 * n] = c / np.linalg.norm(c)
    numerator, denominator = eigvals(pencil, np.diag([1.0] * (2 * n) + [0.0]), homogeneous_eigvals=True)
    finite = np.abs(denominator) * _FASTEST > np.abs(numerator)
    zeros = numerator[finite] / denominator[finite]
    near = zeros[(zeros.imag > _SLOWEST) & (np.abs(zeros.real) < _NEAR_AXIS * np.abs(zeros.imag))].imag
    if not len(near):
        return
    resolvents = 1j * near[:, None, None] * np.eye(n) - a
    response = np.linalg.solve(resolvents, np.tile(b[:, None], (len(near), 1, 1)))[..., 0] @ c
    seen: list[float] = []
    for k in np.argsort(-response.real):  # the gain at which it crosses is 1 / Re G
        crossing = _refined(a, b, c, float(near[k])) if response[k].real > 0 else None
        if crossing is not None and all(abs(crossing[1] / w - 1) > 1e-9 for w in seen):
            seen.append(crossing[1])
            yield crossing


def _refined(a: np.ndarray, b: np.ndarray, c: np.ndarray, w: float) -> tuple[float, float] | None:
    """Newton's method on Im G(jw); None where it does not settle nearby on a positive gain."""
    start, eye = w, np.eye(len(a))
    for _ in range(_MOST_STEPS):
        resolvent = 1j * w * eye - a
        right = np.linalg.solve(resolvent, b)
        value = complex(c @ right)
        slope = complex(-1j * (c @ np.linalg.solve(resolvent, right)))
        if slope.imag == 0 or not np.isfinite(value):
            return None
        step = value.imag / slope.imag
        w -= step
        if not abs(w - start) < 0.1 * start:
            return None
        if abs(step) < _SETTLED * w:
            return (1 / value.real, w) if value.real > 0 else None
    return None


def _is_stable(a: np.ndarray) -> bool:
    """Whether no pole lies to the right; those at the origin (friction's memory) are let pass."""
    return bool(np.linalg.eigvals(a).real.max() < _UNSTABLE)


def _scaled(a: np.ndarray, weight: np.ndarray) -> np.ndarray:
    return np.asarray(a / weight[:, None] * weight[None, :] / _TIME)


FREQUENCY_STD = 0.02
"""Relative, of the frequency that was noted with a critical gain."""
_SWUNG = 1.0
"""Relative error of a linear loop below whose critical gain a push makes the rig oscillate: a factor of three."""


@dataclass(frozen=True)
class GainEvidence(LinearEvidence):
    """A critical gain in units of misfit: the logarithm of measured over predicted, over its relative error.

    Where the frequency of the oscillation was noted, it is a second such figure. Beside records, a gain below that of a
    rig which a push makes oscillate there says little of its linear loop.

    Attributes:
        rough: relative error of the linear loop itself, beside that of the measurement.
    """

    measured: MeasuredGain
    rough: float = 0.0
    _last: dict[object, Onset | None] = field(default_factory=dict, repr=False, compare=False)

    @property
    def name(self) -> str:
        """In words."""
        taken = self.measured
        load = f", {taken.load_N:g} N on the tip" if taken.load_N else ""
        masses = f"{taken.outer_end_mass:g} kg outer, {taken.inner_end_mass:g} kg inner"
        return f"critical gain, {taken.controller.words()}, {masses}{load}"

    @property
    def condition(self) -> object:
        """Under which it was measured: masses, breaks of the controller, load."""
        taken = self.measured
        law = taken.controller.but(gain_A_per_V=1.0)
        return ("critical gain", taken.outer_end_mass, taken.inner_end_mass, law, taken.load_N)

    @property
    def expected(self) -> float:
        """Misfit that noise alone leaves: one per figure."""
        stds = np.array([self.measured.relative_std, FREQUENCY_STD][: len(self.units)])
        return float(np.sum((stds / self.units) ** 2))

    @property
    def units(self) -> np.ndarray:
        """(M,) relative error that is one unit, of every row of the residual."""
        stds = np.hypot([self.measured.relative_std, FREQUENCY_STD], self.rough)
        return np.asarray(stds[: 1 if self.measured.frequency_Hz is None else 2])

    def predicted(self, placement: Placement, z: np.ndarray) -> Onset | None:
        """Gain and frequency of the model; None where it oscillates at no gain."""
        # A fit asks for the derivatives where it has just asked for the figures.
        key = (placement.assembly.kinds, placement.unknowns, z.tobytes())
        if key not in self._last:
            self._last.clear()
            found = onset(self.model(placement), z, self.measured.raised_from)
            laws = (library()[name].linear for name in placement.assembly.kinds.effects)
            swings = any(law is not None and law.swings for law in laws)
            self._last[key] = found and replace(found, swings=swings)
        return self._last[key]

    def linearised(self, placement: Placement, z: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """The residual and its derivative by z."""
        if (at := self.predicted(placement, z)) is None:
            return None
        gain, frequency = onset_slopes(self.model(placement), z, at)
        rows = np.array([-gain, -frequency][: len(self.units)])
        return self.misfit(at), rows / self._units_of(at)[:, None]

    def misfit(self, at: Onset) -> np.ndarray:
        """(1,) or (2,) measured less predicted."""
        taken = self.measured
        figures = [log(taken.gain / at.gain)]
        if taken.frequency_Hz is not None:
            figures.append(log(tau * taken.frequency_Hz / at.frequency))
        return np.array(figures) / self._units_of(at)

    def swung(self, at: Onset) -> bool:
        """Whether the oscillation may be one that a push began, below the gain of the model's linear loop."""
        return at.swings and self.rough > 0 and self.measured.gain < at.gain

    def _units_of(self, at: Onset) -> np.ndarray:
        return np.maximum(self.units, _SWUNG) if self.swung(at) else self.units
