"""The closed loop of a prototype over its outer end mass: poles, gains, compliance, margins, sensitivity, bandwidth.

Its outer tip is a port for forces: F / x = p / n, whatever is fixed to it or touches it. An end mass m, a spring k and
a dashpot b between the tip and the ground add (m s^2 + b s + k) x to the force, so that the characteristic polynomial
is p0 + (m s^2 + b s + k) n: affine in all three together, and n is free of them.
"""

from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import atan2, degrees, inf, pi, sqrt

import numpy as np
from flint import fmpq, fmpq_poly

from beamdesign import polynomial
from beamdesign.arguments import checked_mass_kg, takes
from beamdesign.controllers import Controller
from beamdesign.plant.linear import LinearModel, Plant
from beamdesign.plant.members import VertexModel, family
from beamdesign.polynomial import Affine, Crossing, exact, is_hurwitz, real_roots, roots, squared_magnitude
from beamdesign.prototype import COMPLIANCE_LIMIT_M_PER_N, Prototype
from beamdesign.result import Result

_NONE = fmpq(0)


@dataclass(frozen=True)
class Loop:
    """The loop in exact polynomials of s; everything is affine in the outer end mass m (kg) or free of it.

    L is the transfer function around the loop broken at the current, all that is fed back being one current, however
    many sensors there are. S = 1 / (1 + L) = loop_denominator / characteristic, x / F_d = disturbance / characteristic.
    With the displacement alone fed back, L is also that of the loop broken at its sensor.

    Attributes:
        loop_denominator: denominator of L, the plant's times the controller's.
        loop_numerator: numerator of L; free of m where the displacement alone is fed back.
        disturbance: numerator of the closed-loop compliance x / F_d, free of m.
        effort_numerator: numerator of C S, current over noise of the displacement sensor and, but for the sign and a
            law's own `b_command`, over command volts; C is what the controller makes of that sensor. Of the same
            denominator as S; None where it is not known.
        added: the part of `loop_numerator` that comes from added sensors, all but the displacement's; zero without any.
        crossed: the part of `disturbance` that goes through the feedback, as it does with added sensors.
    """

    loop_denominator: Affine
    loop_numerator: Affine
    disturbance: fmpq_poly
    effort_numerator: Affine | None = None
    added: Affine = field(default_factory=lambda: Affine(fmpq_poly([0])))
    crossed: fmpq_poly = field(default_factory=lambda: fmpq_poly([0]))

    @cached_property
    def characteristic(self) -> Affine:
        """Closed-loop characteristic polynomial p0 + m p1."""
        return self.loop_denominator + self.loop_numerator

    @cached_property
    def cut(self) -> Affine:
        """The same with the displacement sensor cut off, and the added ones not."""
        return self.loop_denominator + self.added

    @property
    def gain_and_mass_apart(self) -> bool:
        """Whether a factor on the gain and the mass do not multiply each other: `loop_numerator` is free of m.

        As m acts by a force on the tip, so is `disturbance` of the gain then.
        """
        return self.loop_numerator.slope.is_zero() and self.crossed.is_zero()

    def scaled(self, factor: fmpq) -> "Loop":
        """The loop with its gain times a factor, on the valve or its flow and not on the controller."""
        return replace(
            self,
            loop_numerator=self.loop_numerator * factor,
            disturbance=self.disturbance + self.crossed * (factor - 1),
            added=self.added * factor,
            crossed=self.crossed * factor,
        )

    def against(self, mass: fmpq = _NONE, stiffness: fmpq = _NONE, damping: fmpq = _NONE) -> fmpq_poly:
        """The characteristic polynomial with an end mass (kg) against a spring (N/m) and a dashpot (N s/m)."""
        return self.characteristic.at(mass) + fmpq_poly([stiffness, damping]) * self.disturbance

    def at(self, outer_end_mass: float) -> "LoopAtMass":
        """The loop at one outer end mass, kg."""
        mass = exact(outer_end_mass)
        effort = None if self.effort_numerator is None else self.effort_numerator.at(mass)
        return LoopAtMass(self.loop_denominator.at(mass), self.loop_numerator.at(mass), self.disturbance, effort)


def close_loop(plant: Plant, controller: Controller) -> Loop:
    """Close the loop of a plant with a controller, equation (12).

    Raises:
        ValueError: for a plant with other sensors than the controller's.
    """
    law = controller.sensed_law()
    if law.sensors != plant.sensors:
        raise ValueError(f"the plant has the sensors {plant.sensors}, the controller {law.sensors}")
    own, *others = (control * above for control, above in zip(plant.control, law.numerators, strict=True))
    through = (part * above for part, above in zip(plant.crossed, law.numerators, strict=True))
    crossed = sum(through, fmpq_poly([0]))
    return Loop(
        loop_denominator=plant.denominator * law.denominator,
        loop_numerator=sum(others, own),
        disturbance=plant.disturbance * law.denominator + crossed,
        effort_numerator=plant.denominator * law.numerators[0],
        added=sum(others, own * fmpq(0)),
        crossed=crossed,
    )


def rig_loop(rig: LinearModel, inner_end_mass: float, controller: Controller) -> Loop:
    """Close the loop of a rig, with the given mass (kg) added to its inner beam, with any controller."""
    return close_loop(rig.plant(inner_end_mass, controller.sensed_law().sensors), controller)


def loop(prototype: Prototype, performing: bool = False) -> Loop:
    """The closed loop of a prototype with its controller and inner end mass; with effects, that of its member at rest.

    Args:
        prototype: with a controller.
        performing: of the first member, that at rest before the others, of which bandwidth and peak sensitivity are
            claimed: of friction, while it slides.

    Raises:
        ValueError: where the prototype has no controller.
        InputError: where no linear loop stands for one of its effects.
    """
    found = family(prototype)
    claimed = (one for one in (found.rest, *found.members) if one.performance is not None or not performing)
    return at_most(prototype, next(claimed, found.rest))


def at_most(prototype: Prototype, member: VertexModel) -> Loop:
    """The loop of a member at the largest of its gains.

    Raises:
        ValueError: where the prototype has no controller.
    """
    return member_loop(prototype, member).scaled(exact(member.gain.high))


def member_loop(prototype: Prototype, member: VertexModel) -> Loop:
    """The loop of a linear member of a prototype, with no factor on its gain.

    Raises:
        ValueError: where the prototype has no controller.
    """
    return rig_loop(member.rig, prototype.payload.inner_end_mass_kg, prototype.own_controller)


def drive_loop(prototype: Prototype, member: VertexModel) -> Loop:
    """The same loop cut at what the drive is asked for: what that feeds back by itself is opened with the law.

    Raises:
        ValueError: where the prototype has no controller.
    """
    closed, unfed = member_loop(prototype, member), dict.fromkeys(prototype.actuator.fed_back, 0.0)
    cut = replace(member, rig=replace(member.rig, figures={**member.rig.figures, **unfed}))
    denominator = member_loop(prototype, cut).loop_denominator
    numerator = closed.characteristic + denominator * fmpq(-1)
    return replace(closed, loop_denominator=denominator, loop_numerator=numerator)


@dataclass(frozen=True)
class Margins:
    """Classical margins; infinite where the locus has no such crossing.

    Attributes:
        gain_up: factor on the gain at which the loop becomes unstable.
        gain_down: factor below one at which it becomes unstable, 0 where lowering the gain is harmless.
        phase_deg: least phase margin over all gain crossovers.
        phase_Hz: frequency of that crossover, 0 where there is none.
        critical_frequency_Hz: frequency of the oscillation at `gain_up`.
        crossover_Hz: highest frequency with |L| = 1, 0 where there is none.
    """

    gain_up: float
    gain_down: float
    phase_deg: float
    phase_Hz: float
    critical_frequency_Hz: float
    crossover_Hz: float


_ABOUT = np.linspace(-2.0, 2.0, 17)  # half-widths of a resonance at which it is looked at: its peak within 1 %


@dataclass(frozen=True)
class LoopAtMass:
    """The loop at one outer end mass, exact; see `Loop` for the polynomials."""

    loop_denominator: fmpq_poly
    loop_numerator: fmpq_poly
    disturbance: fmpq_poly
    effort_numerator: fmpq_poly | None = None

    @cached_property
    def characteristic(self) -> fmpq_poly:
        """Closed-loop characteristic polynomial."""
        return self.loop_denominator + self.loop_numerator

    @property
    def stable(self) -> bool:
        """Whether all closed-loop poles lie in the open left half plane (exact Routh test)."""
        return is_hurwitz(self.characteristic)

    def poles(self) -> np.ndarray:
        """Closed-loop poles, rad/s."""
        return roots(self.characteristic)

    def open_loop_poles(self) -> np.ndarray:
        """Poles of L, rad/s."""
        return roots(self.loop_denominator)

    def open_loop_zeros(self) -> np.ndarray:
        """Zeros of L, rad/s."""
        return roots(self.loop_numerator)

    def compliance_zeros(self) -> np.ndarray:
        """Zeros of x / F_d, rad/s."""
        return roots(self.disturbance)

    def gain_crossings(self) -> list[Crossing]:
        """Factors on the gain at which a closed-loop root lies on the axis, ascending.

        Raises:
            ValueError: where a root lies there at every gain.
        """
        try:
            return polynomial.crossings(Affine(self.loop_denominator, self.loop_numerator))
        except ArithmeticError as error:
            reason = "this loop has an undamped mode on the imaginary axis that no gain can move (uncontrollable)"
            raise ValueError(reason) from error

    def loop_response(self, frequency_Hz: np.ndarray) -> np.ndarray:
        """L at the given frequencies, complex."""
        return _ratio(self.loop_numerator, self.loop_denominator, frequency_Hz)

    def compliance_response(self, frequency_Hz: np.ndarray) -> np.ndarray:
        """Closed-loop x / F_d in m/N at the given frequencies, complex."""
        return _ratio(self.disturbance, self.characteristic, frequency_Hz)

    def sensitivity_response(self, frequency_Hz: np.ndarray) -> np.ndarray:
        """S = 1 / (1 + L) at the given frequencies, complex."""
        return _ratio(self.loop_denominator, self.characteristic, frequency_Hz)

    def grid_Hz(self, low_Hz: float, high_Hz: float, points: int, about: np.ndarray = _ABOUT) -> np.ndarray:
        """So many frequencies at equal ratios, ends included, and some about each resonance, however sharp it is.

        These lie so many of its half-widths from it.
        """
        poles = self.poles() / (2 * pi)
        near = (np.abs(poles.imag)[:, None] + np.abs(poles.real)[:, None] * about).ravel()
        inside = near[(low_Hz < near) & (near < high_Hz)]
        return np.unique(np.concatenate([np.geomspace(low_Hz, high_Hz, points), inside]))

    def static_compliance(self) -> float:
        """Closed-loop x / F_d at zero frequency, m/N."""
        return float(self.disturbance(0) / self.characteristic(0))

    def static_stiffness(self) -> float:
        """F / x at zero frequency, N/m; infinite for a servo that integrates."""
        return inf if self.disturbance[0] == 0 else float(self.characteristic[0] / self.disturbance[0])

    def stiffness_response(self, frequency_Hz: np.ndarray) -> np.ndarray:
        """F / x in N/m at the given frequencies, complex, the end mass included."""
        return _ratio(self.characteristic, self.disturbance, frequency_Hz)

    def peak_sensitivity(self) -> float:
        """Largest |S| over all frequencies, of which nothing is swept; infinite for an unstable loop."""
        return float(polynomial.peak(self.loop_denominator, self.characteristic).mid()) if self.stable else inf

    def bandwidth_Hz(self, limit_m_per_N: float = COMPLIANCE_LIMIT_M_PER_N) -> float:
        """Highest frequency up to which |x / F_d| is at or below the limit at every lower frequency.

        It is the first positive real root of odd multiplicity of limit^2 |p|^2 - |n|^2; zero where the loop is unstable
        or the static compliance exceeds the limit already.
        """
        if not self.stable:
            return 0.0
        squared_limit = exact(limit_m_per_N) ** 2
        slack = squared_limit * squared_magnitude(self.characteristic) - squared_magnitude(self.disturbance)
        # The sign just above zero frequency: that of the lowest coefficient that does not vanish.
        if next((c for c in slack.coeffs() if c != 0), fmpq(0)) < 0:
            return 0.0
        changes = [] if slack.is_zero() else [root for root, count in real_roots(slack) if root > 0 and count % 2]
        return sqrt(float(changes[0].mid())) / (2 * pi) if changes else inf

    def crossovers_Hz(self) -> list[float]:
        """Frequencies at which |L| = 1, ascending."""
        difference = squared_magnitude(self.loop_numerator) - squared_magnitude(self.loop_denominator)
        return [sqrt(float(root.mid())) / (2 * pi) for root, _ in real_roots(difference) if root > 0]

    def margins(self) -> Margins:
        """Gain and phase margins from exact crossings, not from a sweep.

        Raises:
            ValueError: where a root lies on the axis at every gain.
        """
        gains = self.gain_crossings()
        above = [c for c in gains if c.value > 1]
        below = [c for c in gains if 0 < c.value < 1]
        crossovers = self.crossovers_Hz()
        phases = [abs(degrees(atan2(value.imag, value.real))) for value in -self.loop_response(np.array(crossovers))]
        phase_deg, phase_Hz = min(zip(phases, crossovers, strict=True), default=(inf, 0.0))
        return Margins(
            gain_up=above[0].value if above else inf,
            gain_down=below[-1].value if below else 0.0,
            phase_deg=phase_deg,
            phase_Hz=phase_Hz,
            critical_frequency_Hz=above[0].frequency_Hz if above else 0.0,
            crossover_Hz=max(crossovers, default=0.0),
        )


@dataclass(frozen=True)
class CriticalGain(Result):
    """The gain at which a loop begins to oscillate as its gain is raised."""

    gain_A_per_V: float
    frequency_Hz: float


@takes("Prototype")
def critical_gain(prototype: Prototype, outer_end_mass: float = 0.0, from_own: bool = False) -> CriticalGain:
    """Critical gain of a prototype at one outer end mass (kg): exact, not swept.

    The controller's breaks are kept, its gain is raised: from none; or, where asked for, from its own if the loop is
    stable there, which it need not be at every lower one. With effects it is the least of all linear members and of
    the loop at rest, where that oscillates at any gain.

    Raises:
        InputError: for a mass that is not plausible, or a controller of several laws.
        ValueError: without a controller, or where the loop oscillates at no gain, at every one or at every low one.
    """
    mass = checked_mass_kg(prototype.name, outer_end_mass)
    own = prototype.own_controller.gain_A_per_V
    unit = prototype.but(controller=prototype.own_controller.but(gain_A_per_V=1.0))
    linear, least = family(prototype, mass), own if from_own else 0.0
    found = [_critical_gain(at_most(unit, member).at(mass), least) for member in linear.members]
    with suppress(ValueError):
        found.append(_critical_gain(at_most(unit, linear.rest).at(mass), least))
    return min(found, key=lambda critical: critical.gain_A_per_V)


def _critical_gain(unit: LoopAtMass, own: float) -> CriticalGain:
    """Critical gain, raised from its own, of a loop whose controller has a gain of one."""

    def stable(gain: float) -> bool:
        return is_hurwitz(unit.loop_denominator + unit.loop_numerator * exact(gain))

    least = own if own and stable(own) else 0.0
    above = [crossing for crossing in unit.gain_crossings() if crossing.value > least]
    if not above:
        raise ValueError("no larger gain makes this loop oscillate")
    if not least and not stable(above[0].value / 2):
        raise ValueError("the loop is unstable at every gain below its first crossing")
    return CriticalGain(above[0].value, above[0].frequency_Hz)


def _ratio(numerator: fmpq_poly, denominator: fmpq_poly, frequency_Hz: np.ndarray) -> np.ndarray:
    s = 2j * pi * np.asarray(frequency_Hz, dtype=float)
    return np.asarray(polynomial.at_points(numerator, s) / polynomial.at_points(denominator, s))
