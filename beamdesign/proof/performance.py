"""Performance that holds for every outer end mass of a range, proved in rational arithmetic.

Six claims: compliance up to a bandwidth, peak sensitivity, loop gain above a frequency, controller effort, decay rate,
gain margin. The first four are inequalities quadratic in the mass (see `quadratic_nonnegative`), the other two are
stability of related families. Each presupposes
that the loop is stable over the range, which is proved first. For each there is the inverse question as well: the best
figure that can be proved, rounded to the safe side.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import inf, pi, sqrt
from typing import Literal

from flint import fmpq, fmpq_poly

from beamdesign.loop import Loop
from beamdesign.polynomial import Affine, exact, roots
from beamdesign.proof import estimates
from beamdesign.proof.bilinear import Inside, axis_inside
from beamdesign.proof.quadratic import Verdict, quadratic_nonnegative
from beamdesign.proof.rational import bounds, nearest, shortened
from beamdesign.proof.stability import StabilityMap, is_stable_over, stable_ranges
from beamdesign.proof.statements import (
    Coefficients,
    compliance_slack,
    effort_slack,
    frequency_below,
    gain_edges,
    loop_gain_slack,
    sensitivity_slack,
    shifted,
    squared_frequency_above,
    squared_frequency_below,
)

Kind = Literal[
    "compliance", "tip_compliance", "load_compliance",
    "peak_sensitivity", "loop_gain", "controller_effort", "decay_rate", "gain_margin",
]  # fmt: skip
"""Of an arm the compliances are two, of the tip and of the payload's centre."""

INEQUALITIES: tuple[Kind, ...] = ("compliance", "peak_sensitivity", "loop_gain", "controller_effort")
"""Claims about magnitudes, as opposed to those about poles."""

LARGEST_GAIN_MARGIN = 1e6
"""Where even this factor is harmless, it is what `guaranteed_gain_margin` gives."""

_RELATIVE_STEP = 5e-5
_LEAST_LIMIT = 1e-12
"""Of what is zero, such as the loop gain of a controller that feeds nothing back."""

_ZERO = fmpq(0)


@dataclass(frozen=True)
class Witness:
    """Where a claim fails.

    Attributes:
        mass: outer end mass, kg.
        squared_frequency: (rad/s)^2 at which an inequality fails; None for a loop that is not stable.
        gain_factor: factor on the gain, for a gain margin.
        frequency_Hz: frequency at the failure: of the inequality, or of the slowest or growing oscillation.
        exact: whether these rationals themselves refute the claim; False where only a root on the axis at an
            irrational figure does, which they then approximate.
    """

    mass: fmpq
    squared_frequency: fmpq | None
    gain_factor: fmpq | None
    frequency_Hz: float
    exact: bool = True


@dataclass(frozen=True)
class Claim:
    """One statement about every outer end mass of a range, decided exactly.

    Attributes:
        kind: what is claimed.
        limit: its figure: m/N, a plain number, A/V, 1/s or a factor.
        outer_end_mass_kg: the range.
        holds: whether it is proved; if not, it is refuted.
        bandwidth_Hz: for a compliance, the frequency up to which it is claimed; infinite for all frequencies.
        reason: in words, why it does not hold; empty where it does.
        witness: what refutes it; None where it holds.
        from_Hz: for a loop gain, the frequency from which on it is claimed; zero for all frequencies.
    """

    kind: Kind
    limit: float
    outer_end_mass_kg: tuple[float, float]
    holds: bool
    bandwidth_Hz: float | None = None
    reason: str = ""
    witness: Witness | None = None
    from_Hz: float | None = None

    @property
    def witness_outer_end_mass_kg(self) -> float | None:
        """A mass that refutes the claim, as a float."""
        return None if self.witness is None else nearest(self.witness.mass)

    @property
    def witness_frequency_Hz(self) -> float | None:
        """The frequency that goes with that mass."""
        return None if self.witness is None else self.witness.frequency_Hz

    @property
    def witness_gain_factor(self) -> float | None:
        """The factor on the gain that goes with it, for a gain margin."""
        factor = None if self.witness is None else self.witness.gain_factor
        return None if factor is None else nearest(factor)


def _rational(value: float | fmpq) -> fmpq:
    return value if isinstance(value, fmpq) else exact(value)


def _rationals(low: float | fmpq, high: float | fmpq) -> tuple[fmpq, fmpq]:
    ends = _rational(low), _rational(high)
    if ends[0] > ends[1]:
        raise ValueError(f"empty range: {ends[0]} is above {ends[1]}")
    return ends


def _positive(limit: float | fmpq) -> fmpq:
    rational = _rational(limit)
    if rational <= 0:
        raise ValueError(f"a limit must be positive, is {limit}")
    return rational


def _refused(kind: Kind, limit: fmpq, masses: tuple[fmpq, fmpq], family: Affine) -> Claim:
    """A claim that fails because a family it needs is not stable over the range, with a mass that shows it."""
    found = stable_ranges(family, *masses)
    mass, settled = _unstable_at(found)
    return Claim(
        kind,
        nearest(limit),
        (nearest(masses[0]), nearest(masses[1])),
        False,
        reason=f"the loop is not stable for all of these masses: {found.reason}",
        witness=Witness(mass, None, None, abs(_rightmost(family.at(mass)).imag) / (2 * pi), settled),
    )


def _unstable_at(found: StabilityMap) -> tuple[fmpq, bool]:
    """A parameter that is not stable, and whether it is so itself or only next to one that is not rational."""
    settled = [part.sample for part in found.ranges if not part.stable]
    settled += [crossing.rational for crossing in found.crossings if crossing.rational is not None]
    if settled:
        return settled[0], True
    least, most = bounds(found.crossings[0].parameter)
    return (least + most) / 2, False


def _rightmost(polynomial: fmpq_poly) -> complex:
    """The root with the largest real part."""
    return complex(max(roots(polynomial), key=lambda root: root.real))


def _inequality(
    kind: Kind, limit: fmpq, masses: tuple[fmpq, fmpq], verdict: Verdict, words: str, bandwidth_Hz: float | None = None
) -> Claim:
    ends = nearest(masses[0]), nearest(masses[1])
    if verdict.witness is None:
        return Claim(kind, nearest(limit), ends, True, bandwidth_Hz)
    mass, square = verdict.witness
    frequency = sqrt(nearest(square)) / (2 * pi)
    reason = f"{words} at {frequency:.6g} Hz with an outer end mass of {nearest(mass):.6g} kg"
    return Claim(kind, nearest(limit), ends, False, bandwidth_Hz, reason, Witness(mass, square, None, frequency))


def prove_compliance(
    loop: Loop, limit_m_per_N: float | fmpq, bandwidth_Hz: float | fmpq, low: float | fmpq, high: float | fmpq
) -> Claim:
    """Whether |x / F_d| is at most the limit at every frequency up to the bandwidth, for every mass in [low, high].

    An infinite bandwidth asks for every frequency.
    """
    limit, masses = _positive(limit_m_per_N), _rationals(low, high)
    bandwidth = None if bandwidth_Hz == inf else _positive(bandwidth_Hz)
    up_to = inf if bandwidth is None else nearest(bandwidth)
    if not is_stable_over(loop.characteristic, *masses):
        return replace(_refused("compliance", limit, masses, loop.characteristic), bandwidth_Hz=up_to)
    x_high = None if bandwidth is None else squared_frequency_above(bandwidth)
    verdict = quadratic_nonnegative(*compliance_slack(loop, limit), *masses, fmpq(0), x_high)
    return _inequality("compliance", limit, masses, verdict, "|x/F_d| exceeds the limit", up_to)


def prove_peak_sensitivity(loop: Loop, limit: float | fmpq, low: float | fmpq, high: float | fmpq) -> Claim:
    """Whether |1 / (1 + L)| is at most the limit at every frequency, for every mass in [low, high]."""
    bound, masses = _positive(limit), _rationals(low, high)
    if not is_stable_over(loop.characteristic, *masses):
        return _refused("peak_sensitivity", bound, masses, loop.characteristic)
    verdict = quadratic_nonnegative(*sensitivity_slack(loop, bound), *masses, fmpq(0), None)
    return _inequality("peak_sensitivity", bound, masses, verdict, "|1/(1+L)| exceeds the limit")


def prove_loop_gain(
    loop: Loop, limit: float | fmpq, from_Hz: float | fmpq, low: float | fmpq, high: float | fmpq
) -> Claim:
    """Whether |L| is at most the limit at every frequency from `from_Hz` up, for every mass in [low, high].

    A loop whose gain stays small there is not unsettled by whatever the model leaves out above, as long as that turns
    its phase as it likes but raises its gain by no more than 1 / limit.
    """
    bound, masses = _positive(limit), _rationals(low, high)
    start = _rational(from_Hz)
    if start < 0:
        raise ValueError(f"a frequency must not be negative, is {from_Hz}")
    words = "|L| exceeds the limit"
    claim = _settled("loop_gain", loop, bound, masses, loop_gain_slack(loop, bound), words, start)
    return replace(claim, from_Hz=nearest(start))


def prove_controller_effort(loop: Loop, limit_A_per_V: float | fmpq, low: float | fmpq, high: float | fmpq) -> Claim:
    """Whether |C S|, current over volts at the controller's input, is at most the limit at every frequency and mass.

    Raises:
        ValueError: for a loop whose controller is not known apart from its plant.
    """
    bound, masses = _positive(limit_A_per_V), _rationals(low, high)
    return _settled("controller_effort", loop, bound, masses, effort_slack(loop, bound), "|C S| exceeds the limit")


def _settled(
    kind: Kind,
    loop: Loop,
    limit: fmpq,
    masses: tuple[fmpq, fmpq],
    slack: Coefficients,
    words: str,
    from_Hz: fmpq = _ZERO,
) -> Claim:
    """An inequality from a frequency up, where the loop is stable."""
    if not is_stable_over(loop.characteristic, *masses):
        return _refused(kind, limit, masses, loop.characteristic)
    verdict = quadratic_nonnegative(*slack, *masses, squared_frequency_below(from_Hz), None)
    return _inequality(kind, limit, masses, verdict, words)


def prove_decay_rate(loop: Loop, rate_per_s: float | fmpq, low: float | fmpq, high: float | fmpq) -> Claim:
    """Whether every closed-loop pole has a real part below -rate, for every mass in [low, high]."""
    rate, masses = _positive(rate_per_s), _rationals(low, high)
    family = shifted(loop.characteristic, rate)
    if is_stable_over(family, *masses):
        return Claim("decay_rate", nearest(rate), (nearest(masses[0]), nearest(masses[1])), True)
    claim = _refused("decay_rate", rate, masses, family)
    words = (
        f"a pole decays no faster than {nearest(rate):.6g} 1/s with an outer end mass of"
        f" {claim.witness_outer_end_mass_kg:.6g} kg (at {claim.witness_frequency_Hz:.6g} Hz)"
    )
    return replace(claim, reason=words)


def prove_gain_margin(loop: Loop, factor: float | fmpq, low: float | fmpq, high: float | fmpq) -> Claim:
    """Whether the loop stays stable with its gain times every number between 1 and `factor`, for every mass."""
    limit, masses = _positive(factor), _rationals(low, high)
    ends = nearest(masses[0]), nearest(masses[1])
    for edge in gain_edges(loop, limit, *masses):
        if is_stable_over(edge.family, edge.low, edge.high):
            continue
        there, settled = _unstable_at(stable_ranges(edge.family, edge.low, edge.high))
        mass = there if edge.mass is None else edge.mass
        gain = there if edge.factor is None else edge.factor
        frequency = abs(_rightmost(edge.family.at(there)).imag) / (2 * pi)
        words = f"unstable at {nearest(gain):.6g} times the gain with an outer end mass of {nearest(mass):.6g} kg"
        return Claim(
            "gain_margin",
            nearest(limit),
            ends,
            False,
            reason=words,
            witness=Witness(mass, None, gain, frequency, settled),
        )
    if (found := _inside(loop, limit, *masses)) is not None:
        words = f"unstable at {found.factor:.6g} times the gain with an outer end mass of {found.mass:.6g} kg"
        if not found.decided:
            return Claim("gain_margin", nearest(limit), ends, False, reason="not decided between the ends")
        witness = Witness(exact(found.mass), None, exact(found.factor), found.frequency_Hz, exact=False)
        return Claim("gain_margin", nearest(limit), ends, False, reason=words, witness=witness)
    return Claim("gain_margin", nearest(limit), ends, True)


def _inside(loop: Loop, factor: fmpq, low: fmpq, high: fmpq) -> Inside | None:
    """A root on the axis between masses and factors whose rectangle has stable sides."""
    factors = min(factor, fmpq(1)), max(factor, fmpq(1))
    return axis_inside(loop.opened, loop.returned, (low, high), factors)


def guaranteed_bandwidth(loop: Loop, limit_m_per_N: float | fmpq, low: float | fmpq, high: float | fmpq) -> float:
    """The largest bandwidth (Hz) that `prove_compliance` grants, rounded down; 0 if none, infinite if every one.

    It comes from the cell in which the inequality first fails; everything up to there is proved by the same cells.
    """
    limit, masses = _positive(limit_m_per_N), _rationals(low, high)
    return bandwidth_where_stable(loop, limit, *masses) if is_stable_over(loop.characteristic, *masses) else 0.0


def bandwidth_where_stable(loop: Loop, limit_m_per_N: fmpq, low: fmpq, high: fmpq) -> float:
    """The same for a range that is proved to be stable already."""
    return kept_up_to_Hz(compliance_slack(loop, limit_m_per_N), low, high)


def kept_up_to_Hz(slack: Coefficients, low: fmpq, high: fmpq) -> float:
    """Up to which frequency a quadratic in the mass is proved not to be negative, rounded down; infinite for all."""
    verdict = quadratic_nonnegative(*slack, low, high, fmpq(0), None)
    if verdict.holds_to is None:
        return inf
    reached = frequency_below(verdict.holds_to)
    if reached <= 0:
        return 0.0
    bandwidth = shortened(reached, 7)
    if squared_frequency_above(bandwidth) > verdict.holds_to:  # only where rounding ate nothing
        bandwidth = shortened(reached * (1 - fmpq(1, 10**7)), 7)
    return nearest(bandwidth)


def least_proved(start: float, proves: Callable[[fmpq], bool], largest: float) -> float:
    """The least figure from `start` up that is proved, to 1e-4 and rounded up to 5 digits; infinite above `largest`."""
    lower, step = max(start, _LEAST_LIMIT), _RELATIVE_STEP
    while not proves(upper := shortened(exact(lower * (1 + step)), 5, up=True)):
        if (lower := nearest(upper)) > largest:
            return inf
        step *= 8
    while nearest(upper) > lower * (1 + 2 * _RELATIVE_STEP):
        middle = shortened(exact(sqrt(lower * nearest(upper))), 5, up=True)
        if middle >= upper:
            break
        if proves(middle):
            upper = middle
        else:
            lower = nearest(middle)
    return nearest(upper)


def _most_proved(start: float, proves: Callable[[fmpq], bool], least: float) -> float:
    """The largest figure from `start` down that is proved, to 1e-4 and rounded down; 0 below `least`."""
    upper, step = start, _RELATIVE_STEP
    while not proves(lower := shortened(exact(upper / (1 + step)), 5)):
        if (upper := nearest(lower)) < least:
            return 0.0
        step *= 8
    while upper > nearest(lower) * (1 + 2 * _RELATIVE_STEP):
        middle = shortened(exact(sqrt(upper * nearest(lower))), 5)
        if middle <= lower:
            break
        if proves(middle):
            lower = middle
        else:
            upper = nearest(middle)
    return nearest(lower)


def guaranteed_peak_sensitivity(loop: Loop, low: float | fmpq, high: float | fmpq) -> float:
    """The least peak sensitivity that is proved, to 1e-4 and rounded up; infinite where the range is not stable."""
    masses = _rationals(low, high)
    return peak_sensitivity_where_stable(loop, *masses) if is_stable_over(loop.characteristic, *masses) else inf


def peak_sensitivity_where_stable(loop: Loop, low: fmpq, high: fmpq, start: float | None = None) -> float:
    """The same for a range that is proved to be stable already, from a guess if one is given."""

    def proves(limit: fmpq) -> bool:
        return quadratic_nonnegative(*sensitivity_slack(loop, limit), low, high, fmpq(0), None).holds

    return least_proved(estimates.peak_sensitivity(loop, low, high) if start is None else start, proves, 1e12)


def loop_gain_where_stable(loop: Loop, from_Hz: float, low: fmpq, high: fmpq) -> float:
    """The least limit of |L| from a frequency up that is proved, rounded up; for a range proved to be stable."""
    start = squared_frequency_below(exact(from_Hz))

    def proves(limit: fmpq) -> bool:
        return quadratic_nonnegative(*loop_gain_slack(loop, limit), low, high, start, None).holds

    return least_proved(estimates.loop_gain(loop, from_Hz, low, high), proves, 1e12)


def effort_where_stable(loop: Loop, low: fmpq, high: fmpq) -> float:
    """The least limit of |C S| (A/V) that is proved, rounded up; for a range proved to be stable."""

    def proves(limit: fmpq) -> bool:
        return quadratic_nonnegative(*effort_slack(loop, limit), low, high, _ZERO, None).holds

    return least_proved(estimates.controller_effort(loop, low, high), proves, 1e12)


def guaranteed_decay_rate(loop: Loop, low: float | fmpq, high: float | fmpq) -> float:
    """The largest decay rate (1/s) that is proved, to 1e-4 and rounded down; 0 where the range is not stable."""
    masses = _rationals(low, high)
    if not is_stable_over(loop.characteristic, *masses):
        return 0.0
    start = estimates.decay_rate(loop, *masses)
    return _most_proved(start, lambda rate: is_stable_over(shifted(loop.characteristic, rate), *masses), 1e-9)


def guaranteed_gain_margin(loop: Loop, low: float | fmpq, high: float | fmpq) -> float:
    """The largest factor on the gain that is proved harmless, to 1e-4 and rounded down; 0 for an unstable range."""
    masses = _rationals(low, high)
    if not is_stable_over(loop.characteristic, *masses):
        return 0.0

    def proves(factor: fmpq) -> bool:
        edges = gain_edges(loop, factor, *masses)
        sides = all(is_stable_over(edge.family, edge.low, edge.high) for edge in edges)
        return sides and _inside(loop, factor, *masses) is None

    start = min(estimates.gain_margin(loop, *masses), LARGEST_GAIN_MARGIN)
    if start == LARGEST_GAIN_MARGIN and proves(exact(start)):
        return start
    return max(_most_proved(start, proves, 1.0), 1.0)
