"""How far the linear model holds: in amplitude with its effects, and in frequency with one mode per beam.

Zalucky and Hardt (1984) conclude from simulations that the linear model predicts the amplitude "as long as loads stay
moderate, and the oil is kept air free". Here the nonlinear response is the harmonic balance of the assembled rig, and
the three words are given figures: the load, the force or the air in the oil at which it is off by a share.

For the modes each beam is the uniform cantilever of Euler and Bernoulli with a point mass at its tip, by modal
superposition, every mode at the damping ratio of the beam. It is made to agree with the prototype's lumped figures: its
rigidity gives the stiffness K = 3 E I / L^3, and its end mass the effective mass by equation (5) of Zalucky and Hardt
(1984). Payload and added masses are joined to the tip by its dynamic stiffness. What the loop then sees is worked out
in the frequency domain from the paper's equations (7) to (16).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import cos, exp, inf, sin, tau
from typing import Literal

import casadi as ca
import numpy as np

from beamdesign.loop import critical_gain
from beamdesign.plant.assembly import Structure, assemble, fits
from beamdesign.plant.component import PROPORTIONAL
from beamdesign.plant.effects import laws_of
from beamdesign.plant.harmonic_balance import DISPLACEMENT, FreeRig, forced_motion
from beamdesign.prototype import Beam, Prototype
from beamdesign.records import InputError
from beamdesign.structure import lumped
from beamdesign.structure.lumped import MODE_MASS_FRACTION, natural_frequencies

Varied = Literal["load", "force", "air"]
PUBLISHED_EFFECTS = ("pressure_dependent_flow", "unequal_piston_areas")
"""What the paper's nonlinear simulations had beside air in the oil."""
_GRID = 16
_BELOW = 4.0 ** -np.arange(1, 7)  # shares of the first point that are tried where the model is off there
_SMALL_N = 1.0
SHARE = 0.1
"""Of the amplitude, by which the linear model may be off."""
_FAR = 1.0  # departure of which the search takes all that is more, infinite too
_HARMONICS = 5


@dataclass(frozen=True)
class Reach:
    """Where the linear model stops.

    Attributes:
        limit: of what is varied, up to which the amplitude is off by no more than `SHARE`; the largest asked where
            `departure` is less; zero where it is off by more at all that was tried.
        departure: of the amplitude just beyond, relative to the linear model's; infinite where the rig comes to no
            steady motion there, as where it oscillates by itself.
    """

    limit: float
    departure: float


def departure(
    prototype: Prototype,
    force: float,
    frequency: float,
    outer_end_mass: float = 0.0,
    preload: float = 0.0,
    linear: float | None = None,
) -> float:
    """Relative error of the linear model: amplitude with all effects over that with the linear ones, less one.

    Args:
        prototype: rig with its effects and a controller.
        force: amplitude on the outer tip, N.
        frequency: Hz.
        outer_end_mass: payload, kg.
        preload: constant force, N.
        linear: amplitude of the linear model per newton, where that is known already.

    Returns:
        Infinite where the rig has no periodic response, as beyond what its actuator can hold.
    """
    linear = _linear(prototype, frequency, outer_end_mass) if linear is None else linear
    try:
        motion = forced_motion(prototype, force, frequency, outer_end_mass, preload, _HARMONICS)
    except ValueError:
        return inf
    return motion.amplitude_m / (linear * force) - 1


def _linear(prototype: Prototype, frequency: float, outer_end_mass: float) -> float:
    rig = FreeRig(linear_part(prototype), outer_end_mass)
    model = rig.linear(rig.gain)
    return float(abs(model.at(np.array([2j * np.pi * frequency]))[0, DISPLACEMENT, 0]))


def linear_part(prototype: Prototype) -> Prototype:
    """The rig with those of its effects alone whose laws are linear, such as a sensor's lag."""
    linear = {name: table for name, table in prototype.effects.items() if _is_linear(name, prototype.rig)}
    return prototype if linear == prototype.effects else prototype.but(effects=linear)


@cache
def _is_linear(effect: str, rig: str) -> bool:
    function = assemble(Structure(PROPORTIONAL, effects=(effect,), rig=rig)).function
    t, x, u, p = function.sx_in()
    return not any(ca.which_depends(ca.vertcat(*function(t, x, u, p)), ca.vertcat(x, u), 2))


def with_published_effects(prototype: Prototype) -> Prototype:
    """The rig with the paper's nonlinear factors but air, beside the effects it has, on its axis as `loop` has it."""
    return prototype.but(
        arm=None, effects={name: {} for name in PUBLISHED_EFFECTS if fits(name, prototype.rig)} | prototype.effects
    )


def reach(prototype: Prototype, varied: Varied, frequency: float, outer_end_mass: float = 0.0) -> Reach:
    """The load, force or air fraction up to which the linear model's amplitude is off by no more than `SHARE`.

    The quantity is raised on a grid until that is passed, and the passage is narrowed by bisection: a passage that
    goes back between two points of the grid is not seen. Where a load or force passes it at the first point already, a
    part of that is sought at which it does not.

    Args:
        prototype: rig with a controller and its effects; air is raised in the law that it has of it, else in the first.
        varied: what is raised: `load`, constant, N, either way, under a small vibration; `force`, amplitude, N, about
            no load; or `air`, volume share of free air, under a small vibration.
        frequency: of the vibration, Hz.
        outer_end_mass: payload, kg.
    """
    stall = prototype.actuator.strength_N(prototype)
    linear = _linear(prototype, frequency, outer_end_mass)

    def off(there: Prototype, force: float, load: float = 0.0) -> float:
        return departure(there, force, frequency, outer_end_mass, load, linear)

    law = next((name for name in laws_of("entrained_air") if name in prototype.effects), "entrained_air")

    def airy(fraction: float) -> Prototype:
        own = prototype.effects.get(law, {}) | {"air_fraction": fraction}
        return prototype.but(effects=prototype.effects | {law: own})

    ways: dict[Varied, tuple[float, float, Callable[[float], float]]] = {
        "load": (1e-2, 1.0, lambda at: max((off(prototype, _SMALL_N, way * at * stall) for way in (1, -1)), key=abs)),
        "force": (1e-3, 1.0, lambda at: off(prototype, at * stall)),
        "air": (1e-4, 0.3, lambda at: off(airy(at), _SMALL_N)),
    }
    low, high, departed = ways[varied]
    at = cache(departed)
    scale = 1.0 if varied == "air" else stall
    grid = np.linspace(low, high, _GRID) if varied == "load" else np.geomspace(low, high, _GRID)
    before = None
    for value in map(float, grid):
        found = at(value)
        if abs(found) > SHARE:
            if before is None and varied != "air":  # of which no law takes less than the first
                before = next((value * less for less in map(float, _BELOW) if abs(at(value * less)) <= SHARE), None)
            if before is None:
                return Reach(0.0, found)
            limit, beyond = _narrowed(at, before, value)
            return Reach(limit * scale, beyond)
        before = value
    return Reach(high * scale, found)


def _narrowed(at: Callable[[float], float], low: float, high: float) -> tuple[float, float]:
    """The largest that is not off, and how far off the model is just beyond it; it is off at `high`, not at `low`.

    By the method of Chandrupatla (1997), which halves the span where the departure jumps.
    """
    from scipy.optimize.elementwise import find_root

    def beyond(value: np.ndarray) -> np.ndarray:
        return np.vectorize(lambda one: min(abs(at(float(one))), _FAR) - SHARE)(value)

    ends = find_root(beyond, (low, high), tolerances={"xatol": 0.0, "xrtol": 5e-4}).bracket
    return float(min(ends)), at(float(max(ends)))


MODES = 12
_HIGHEST_HZ = 3000.0
TOLERANCE = 0.1
"""Relative, of magnitudes of compliance."""

Compliance = Callable[[np.ndarray], np.ndarray]
"""From frequencies in Hz to the complex tip compliance of a beam, m/N."""


@dataclass(frozen=True)
class SingleModeReach:
    """How far one mode per beam is enough.

    Attributes:
        outer_modes_Hz: first natural frequencies of the outer beam with its payload, the loop open.
        inner_modes_Hz: those of the inner beam.
        outer_Hz: up to which the outer beam's tip compliance is right within the tolerance.
        inner_Hz: the inner beam's.
        closed_loop_Hz: up to which the closed loop's compliance |x / F_d| is; zero where the loop is not stable.
        critical_gain_A_per_V: with one mode per beam.
        critical_gain_all_A_per_V: with all of them.
        critical_frequency_Hz: of the oscillation there.
    """

    outer_modes_Hz: tuple[float, ...]
    inner_modes_Hz: tuple[float, ...]
    outer_Hz: float
    inner_Hz: float
    closed_loop_Hz: float
    critical_gain_A_per_V: float
    critical_gain_all_A_per_V: float
    critical_frequency_Hz: float

    @property
    def gain_margin_eaten(self) -> float:
        """Share of the critical gain that the higher modes take; negative where they add to it."""
        return 1 - self.critical_gain_all_A_per_V / self.critical_gain_A_per_V


def exact_compliance(record: Beam, name: str) -> Compliance:
    """Tip compliance of a beam with all its modes, without payload: the sum of `MODES`, and a static rest.

    The shapes are those of R. D. Blevins, Formulas for Natural Frequency and Mode Shape (1979), table 8-1, with the
    wave numbers of the loaded tip; the mass each mode moves includes that at the tip.

    Raises:
        InputError: where the prototype gives no geometry, or a tube heavier than its effective mass allows.
    """
    from scipy.integrate import simpson

    rigidity, per_length, length, end_mass = _cantilever(record, name)
    frequencies = np.array(natural_frequencies(rigidity, per_length, length, end_mass, MODES))
    shares = []
    for frequency in frequencies:
        wave = ((tau * frequency) ** 2 * per_length / rigidity) ** 0.25 * length
        x = np.linspace(0.0, 1.0, 4001)
        y = _shape(wave, x)
        moved = per_length * length * float(simpson(y**2, x=x)) + end_mass * y[-1] ** 2
        shares.append(y[-1] ** 2 / (moved * (tau * frequency) ** 2))
    rest = length**3 / (3 * rigidity) - sum(shares)

    def compliance(frequency_Hz: np.ndarray) -> np.ndarray:
        ratio = np.asarray(frequency_Hz, dtype=float)[..., None] / frequencies
        return np.asarray((np.array(shares) / (1 - ratio**2 + 2j * record.damping_ratio * ratio)).sum(axis=-1) + rest)

    return compliance


def single_compliance(prototype: Prototype, name: str) -> Compliance:
    """Tip compliance 1 / (K + b s + M s^2) of the linear model, without payload."""
    one = lumped.lumped_beam(getattr(prototype, name), name)

    def compliance(frequency_Hz: np.ndarray) -> np.ndarray:
        s = 1j * tau * np.asarray(frequency_Hz, dtype=float)
        return np.asarray(1 / (one.stiffness + one.damping * s + one.mass * s**2))

    return compliance


def with_mass(compliance: Compliance, mass: float) -> Compliance:
    """Tip compliance of a beam with a point mass (kg) joined to its tip."""

    def joined(frequency_Hz: np.ndarray) -> np.ndarray:
        omega = tau * np.asarray(frequency_Hz, dtype=float)
        return np.asarray(1 / (1 / compliance(frequency_Hz) - mass * omega**2))

    return joined


@dataclass(frozen=True)
class Signals:
    """Responses of the open rig at frequencies, complex.

    Attributes:
        loop_per_gain: loop transfer function L over the amplifier gain, V/A.
        compliance: of the outer tip with no valve current, m/N.
        crossed_per_gain: what added sensors feed back of a held tip, over the amplifier gain, m/N; zero without them.
    """

    loop_per_gain: np.ndarray
    compliance: np.ndarray
    crossed_per_gain: np.ndarray

    def closed(self, gain: float) -> np.ndarray:
        """Compliance of the outer tip with the loop closed at an amplifier gain, m/N."""
        return np.asarray((self.compliance + gain * self.crossed_per_gain) / (1 + gain * self.loop_per_gain))


def signals(prototype: Prototype, outer: Compliance, inner: Compliance, frequency_Hz: np.ndarray) -> Signals:
    """Equations (7) to (16) with any compliance of the two beams, loaded as they are to be, and any actuator.

    The force of the actuator follows from Z F_c = T i - c_o F_d with Z = c_a + c_o + c_i, c_a being its compliance
    and T its travel per current, and the tip is at c_o (F_c + F_d). The inner tip is at -c_i F_c, the load pressure is
    F_c / A, the force of a screw F_c.
    """
    figure, actuator = lumped.figures(prototype), prototype.actuator
    s = 1j * tau * np.asarray(frequency_Hz, dtype=float)
    c_o, c_i = outer(frequency_Hz), inner(frequency_Hz)
    z = actuator.compliance(figure, s) + c_o + c_i
    force = actuator.travel(figure, s) / z  # per current
    sensed = figure["sensor_gain"] * c_o * force
    if prototype.sensor.filter_Hz is not None:
        sensed = sensed / (1 + s / figure["filter_frequency"])
    law = prototype.own_controller.sensor_responses(frequency_Hz)
    felt = law.get(actuator.feels[0], 0.0) / figure.get("piston_area", 1.0)
    per_force = felt - law.get("inner_displacement_m", 0.0) * c_i
    back = sensed * law["displacement_m"] + per_force * force
    return Signals(back, c_o * (1 - c_o / z), np.asarray(per_force * c_o * force))


def single_mode_reach(prototype: Prototype, outer_end_mass: float = 0.0) -> SingleModeReach:
    """Up to what frequency and gain one mode per beam stands for all of them, compliances within `TOLERANCE`.

    Args:
        prototype: with the geometry of both beams and a controller.
        outer_end_mass: payload, kg; the inner end mass is the prototype's.

    Raises:
        InputError: where the geometry is missing.
        ValueError: without a controller, or where no gain makes the loop oscillate.
    """
    grid = np.unique(np.concatenate([np.geomspace(0.1, 10.0, 200), np.geomspace(10.0, _HIGHEST_HZ, 40_000)]))
    masses = {"outer_beam": outer_end_mass, "inner_beam": prototype.payload.inner_end_mass_kg}
    beams = {name: _cantilever(getattr(prototype, name), name) for name in masses}
    one = {name: with_mass(single_compliance(prototype, name), mass) for name, mass in masses.items()}
    all_modes = {
        name: with_mass(exact_compliance(getattr(prototype, name), name), mass) for name, mass in masses.items()
    }
    reached = [_agrees_up_to(one[name](grid), all_modes[name](grid), grid) for name in masses]

    low, full = (signals(prototype, kind["outer_beam"], kind["inner_beam"], grid) for kind in (one, all_modes))
    gain = prototype.own_controller.gain_A_per_V
    limit = critical_gain(prototype.but(effects={}), outer_end_mass, from_own=True).gain_A_per_V
    limit_all, at = _critical_gain(full.loop_per_gain, grid, gain)
    near, exact = (part.closed(gain) for part in (low, full))
    closed_Hz = _agrees_up_to(near, exact, grid) if gain < min(limit, limit_all) else 0.0
    modes = [
        tuple(natural_frequencies(rigidity, per_length, length, end_mass + masses[name], 3))
        for name, (rigidity, per_length, length, end_mass) in beams.items()
    ]
    return SingleModeReach(modes[0], modes[1], reached[0], reached[1], closed_Hz, limit, limit_all, at)


def _cantilever(record: Beam, name: str) -> tuple[float, float, float, float]:
    """Rigidity E I (N m2), mass per length (kg/m), free length (m) and end mass (kg)."""
    if record.geometry is None:
        raise InputError(name, [("(geometry)", "width_m, wall_m, free_length_m and material are needed for its modes")])
    one, (alloy, tube, length) = lumped.lumped_beam(record, name), record.geometry
    per_length = float(tube.mass_per_length(alloy.density_kg_per_m3))
    end_mass = one.mass - MODE_MASS_FRACTION * per_length * length
    if end_mass < 0:
        raise InputError(name, [("effective_mass_kg", f"{one.mass:g} is less than the tube alone has")])
    return one.stiffness * length**3 / 3, per_length, length, end_mass


def _shape(wave: float, x: np.ndarray) -> np.ndarray:
    """Clamped at 0, without moment at 1; scaled so that no hyperbolic function overflows."""
    # y = cosh z - cos z - r (sinh z - sin z) with r = (cosh k + cos k) / (sinh k + sin k), k the wave number times L.
    e = exp(-wave)
    below = (1 - e * e) / 2 + e * sin(wave)
    ratio = ((1 + e * e) / 2 + e * cos(wave)) / below
    excess = e * (e + cos(wave) - sin(wave)) / below  # r - 1, without the difference
    z = wave * x
    return np.asarray(np.exp(-z) * (1 + ratio) / 2 - np.exp(z) * excess / 2 - np.cos(z) + ratio * np.sin(z))


def _agrees_up_to(one: np.ndarray, other: np.ndarray, grid: np.ndarray) -> float:
    off = np.nonzero(np.abs(np.abs(one) / np.abs(other) - 1) > TOLERANCE)[0]
    if not len(off):
        return inf
    return float(grid[off[0] - 1]) if off[0] else 0.0


def _critical_gain(loop_per_gain: np.ndarray, grid: np.ndarray, own: float) -> tuple[float, float]:
    """Gain at which L = -1 somewhere, raised as in `critical_gain`, and the frequency, for a stable open loop."""
    real, imaginary = loop_per_gain.real, loop_per_gain.imag
    at = np.nonzero((imaginary[:-1] * imaginary[1:] <= 0) & (real[:-1] < 0))[0]
    if not len(at):
        raise ValueError("no gain makes this loop oscillate")
    share = imaginary[at] / (imaginary[at] - imaginary[at + 1])
    depth = real[at] + share * (real[at + 1] - real[at])
    gains = np.divide(-1.0, depth, out=np.full(len(at), inf), where=depth < 0)
    # Nyquist: at its own gain it is stable where crossings beyond -1 cancel, those upwards and those downwards.
    least = own if np.sign(imaginary[at + 1] - imaginary[at])[gains < own].sum() == 0 else 0.0
    larger = np.where(gains > least, gains, inf)
    if not np.any(larger < inf):
        raise ValueError("no larger gain makes this loop oscillate")
    first = int(np.argmin(larger))
    frequency = grid[at] + share * (grid[at + 1] - grid[at])
    return float(gains[first]), float(frequency[first])
