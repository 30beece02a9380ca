"""A loop over a rectangle of outer end masses and factors on its gain, decided on the rectangle's four sides.

The characteristic polynomial o(m) + g r is affine in the mass m and in the factor g, and they do not multiply each
other: it is stable on the whole rectangle if it is on the sides (edge theorem of Bartlett, Hollot and Huang, 1988).
With added sensors r depends on the mass; `beamdesign.proof.bilinear` then looks inside.

The sides decide performance as well. At one frequency the map from (m, g) to o(m) + g r, the reciprocal of the
compliance but for a factor, is affine to the complex plane: where it is one to one, the interior of the rectangle goes
to the interior of its image, and where it is not, the sides have the whole image. Either way the least magnitude, if it
is not zero, stands on a side. The map to 1/S = 1 + g r / o(m) is in polar coordinates about 1 a product of a function
of m alone with g, and the argument is a function of m alone, monotonic or constant: the same two cases. 1/(C S) is 1/S
over a number, and |L| grows with g, so that it is largest on a side.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, isinf

from flint import fmpq, fmpq_poly

from beamdesign.loop import Loop, LoopAtMass
from beamdesign.polynomial import Affine, exact
from beamdesign.proof.bilinear import Inside, axis_inside
from beamdesign.proof.certificate import Asked
from beamdesign.proof.performance import (
    Claim,
    bandwidth_where_stable,
    effort_where_stable,
    loop_gain_where_stable,
    peak_sensitivity_where_stable,
    prove_compliance,
    prove_controller_effort,
    prove_decay_rate,
    prove_gain_margin,
    prove_loop_gain,
    prove_peak_sensitivity,
)
from beamdesign.proof.rational import nearest
from beamdesign.proof.stability import is_stable_over
from beamdesign.proof.statements import shifted

_ZERO = fmpq_poly([0])
_ONE = fmpq(1)


@dataclass(frozen=True)
class GainLoop:
    """A loop at one outer end mass over a factor on its gain, with the attributes of `beamdesign.loop.Loop`.

    Attributes:
        opened: denominator of L, free of the factor.
        slope: numerator of L at a factor of one.
        disturbance: numerator of the closed-loop compliance.
        demanded: numerator of C S, free of the factor, which is one on the valve or its flow and not on the controller.
    """

    opened: Affine
    slope: fmpq_poly
    disturbance: fmpq_poly
    demanded: Affine | None = None

    @property
    def returned(self) -> Affine:
        """Numerator of L at no gain."""
        return Affine(_ZERO, _ZERO)

    @property
    def characteristic(self) -> Affine:
        """Characteristic polynomial, affine in the factor."""
        return Affine(self.opened.constant, self.slope)

    def at(self, factor: float) -> LoopAtMass:
        """The loop at one factor."""
        return LoopAtMass(self.opened.constant, self.slope * exact(factor), self.disturbance)


@dataclass(frozen=True)
class Side:
    """One side of the rectangle.

    Attributes:
        loop: over what varies along the side.
        low: its least value.
        high: its largest value.
        mass: where the factor varies, the outer end mass.
        factor: where the mass varies, the factor.
    """

    loop: Loop | GainLoop
    low: fmpq
    high: fmpq
    mass: fmpq | None = None
    factor: fmpq | None = None

    @property
    def stable(self) -> bool:
        """Whether every loop of the side is stable."""
        return is_stable_over(self.loop.characteristic, self.low, self.high)


@dataclass(frozen=True)
class Rectangle:
    """A loop over outer end masses and factors on its gain.

    Attributes:
        loop: at a factor of one.
        low: least outer end mass, kg.
        high: largest.
        least: least factor.
        most: largest.
    """

    loop: Loop
    low: fmpq
    high: fmpq
    least: fmpq = _ONE
    most: fmpq = _ONE

    def sides(self) -> list[Side]:
        """The sides, those of varying mass first; one alone where the factor does not vary."""
        over_mass = [
            Side(scaled(self.loop, factor), self.low, self.high, factor=factor)
            for factor in sorted({self.least, self.most})
        ]
        if self.least == self.most:
            return over_mass
        return over_mass + [
            Side(
                GainLoop(
                    Affine(self.loop.opened.at(mass), _ZERO),
                    self.loop.returned.at(mass),
                    self.loop.disturbance,
                    None if self.loop.demanded is None else Affine(self.loop.demanded.at(mass), _ZERO),
                ),
                self.least,
                self.most,
                mass=mass,
            )
            for mass in sorted({self.low, self.high})
        ]

    def widened(self, factor: fmpq) -> "Rectangle":
        """The rectangle with its gain also times every number between one and the given one."""
        return replace(self, least=self.least * min(factor, fmpq(1)), most=self.most * max(factor, fmpq(1)))

    def unstable_side(self) -> Side | None:
        """A side that is not stable throughout, None where all are."""
        return next((side for side in self.sides() if not side.stable), None)

    def inside(self, rate: fmpq | None = None) -> Inside | None:
        """A point inside with a root on the axis, or to the right of -rate, where the sides have none; None if none."""
        opened, returned = self.loop.opened, self.loop.returned
        if rate is not None:
            opened, returned = shifted(opened, rate), shifted(returned, rate)
        return axis_inside(opened, returned, (self.low, self.high), (self.least, self.most))

    @property
    def stable(self) -> bool:
        """Whether it is stable throughout, inside as on its sides."""
        return self.unstable_side() is None and self.inside() is None

    def deciding_sides(self) -> list[Side]:
        """The sides, which decide what is claimed of magnitudes.

        Raises:
            ValueError: for a range of factors on a loop in which they and the mass multiply each other.
        """
        if self.least != self.most and not self.loop.gain_and_mass_apart:
            raise ValueError("mass and gain multiply each other in this loop, so that the sides do not decide")
        return self.sides()


def scaled(loop: Loop, factor: fmpq) -> Loop:
    """A loop with its gain times a factor."""
    return loop if factor == 1 else replace(loop, returned=loop.returned * factor)


def bandwidth(rectangles: Sequence[Rectangle], limit_m_per_N: float) -> float:
    """The largest bandwidth (Hz) that is proved on rectangles that are stable; 0 if none, infinite if every one."""
    limit = exact(limit_m_per_N)
    return min(
        bandwidth_where_stable(side.loop, limit, side.low, side.high)  # type: ignore[arg-type]
        for rectangle in rectangles
        for side in rectangle.deciding_sides()
    )


def peak_sensitivity(rectangles: Sequence[Rectangle]) -> float:
    """The least peak sensitivity that is proved on rectangles that are stable; infinite where none is."""
    worst = 0.0
    for side in (side for rectangle in rectangles for side in rectangle.deciding_sides()):
        # Mostly one side governs, and one proof settles each of the others.
        if worst == 0.0 or not prove_peak(side, worst).holds:
            worst = max(worst, _peak(side))
            if isinf(worst):
                return inf
    return worst


def largest_loop_gain(rectangles: Sequence[Rectangle], from_Hz: float) -> float:
    """The least limit of |L| from a frequency up that is proved on rectangles that are stable: at their most gain."""
    return max(loop_gain_where_stable(scaled(one.loop, one.most), from_Hz, one.low, one.high) for one in rectangles)


def largest_effort(rectangles: Sequence[Rectangle]) -> float:
    """The least limit of |C S|, A/V, that is proved on rectangles that are stable."""
    return max(
        effort_where_stable(side.loop, side.low, side.high)  # type: ignore[arg-type]
        for rectangle in rectangles
        for side in rectangle.deciding_sides()
    )


def prove_peak(side: Side, limit: float) -> Claim:
    """Prove or refute a limit of the sensitivity on one side."""
    return prove_peak_sensitivity(side.loop, limit, side.low, side.high)  # type: ignore[arg-type]


def _peak(side: Side) -> float:
    start = None
    if isinstance(side.loop, GainLoop):
        factors = [nearest(side.low + (side.high - side.low) * share / 4) for share in range(5)]
        start = max(side.loop.at(factor).peak_sensitivity() for factor in factors)
    return peak_sensitivity_where_stable(side.loop, side.low, side.high, start)  # type: ignore[arg-type]


def prove(rectangle: Rectangle, asked: Asked) -> Claim:
    """Prove or refute a claim on a rectangle."""
    masses = (nearest(rectangle.low), nearest(rectangle.high))
    held = Claim(
        asked.kind,
        asked.limit,
        masses,
        True,
        asked.bandwidth_Hz if asked.kind == "compliance" else None,
        from_Hz=asked.from_Hz if asked.kind == "loop_gain" else None,
    )
    if asked.kind == "gain_margin" and rectangle.least == rectangle.most:
        return prove_gain_margin(scaled(rectangle.loop, rectangle.least), asked.limit, rectangle.low, rectangle.high)
    if asked.kind == "gain_margin":
        wide = rectangle.widened(exact(asked.limit))
        side = wide.unstable_side()
        if side is None and wide.inside() is None:
            return held
        where = " between the ends" if side is None else _where(side)
        return replace(held, holds=False, reason=f"unstable with the gain times some number up to this{where}")
    for side in rectangle.sides() if asked.kind == "decay_rate" else rectangle.deciding_sides():
        match asked.kind:
            case "compliance":
                claim = prove_compliance(side.loop, asked.limit, asked.bandwidth_Hz, side.low, side.high)  # type: ignore[arg-type]
            case "peak_sensitivity":
                claim = prove_peak(side, asked.limit)
            case "controller_effort":
                claim = prove_controller_effort(side.loop, asked.limit, side.low, side.high)  # type: ignore[arg-type]
            case "loop_gain":
                if side.factor is None:
                    continue
                claim = prove_loop_gain(side.loop, asked.limit, asked.from_Hz, side.low, side.high)  # type: ignore[arg-type]
            case "decay_rate":
                claim = prove_decay_rate(side.loop, asked.limit, side.low, side.high)  # type: ignore[arg-type]
        if not claim.holds:
            return replace(at_mass(side, claim), outer_end_mass_kg=masses, reason=_reason(side, claim))
    if asked.kind == "decay_rate" and rectangle.inside(exact(asked.limit)) is not None:
        return replace(held, holds=False, reason="a pole decays no faster between the ends of masses and gains")
    return held


def at_mass(side: Side, claim: Claim) -> Claim:
    """A refuted claim about a side whose witness states mass and factor, whichever of them varies."""
    witness = claim.witness
    if witness is None:
        return claim
    if side.mass is not None:
        return replace(claim, witness=replace(witness, mass=side.mass, gain_factor=witness.mass))
    return claim if side.factor == 1 else replace(claim, witness=replace(witness, gain_factor=side.factor))


def _reason(side: Side, claim: Claim) -> str:
    if side.mass is None:
        return claim.reason + _where(side)
    there = claim.witness_outer_end_mass_kg  # of the side, where it is the factor
    frequency = "" if claim.witness_frequency_Hz in (None, inf) else f" at {claim.witness_frequency_Hz:.6g} Hz"
    return f"fails{frequency} with {there:.6g} times the gain{_where(side)}"


def _where(side: Side) -> str:
    if side.mass is not None:
        return f" and an outer end mass of {nearest(side.mass):.6g} kg"
    return "" if side.factor == 1 or side.factor is None else f" and {nearest(side.factor):.6g} times the gain"
