"""Proved performance against dense grids over mass and frequency, worked from the matrices of the linear model."""

from math import inf, pi, sqrt

import numpy as np
import pytest
from flint import fmpq, fmpq_poly
from hypothesis import given, settings
from hypothesis import strategies as st

from beamdesign import Prototype
from beamdesign.checker.roots import Slack
from beamdesign.controllers import Lag, Proportional
from beamdesign.loop import Loop, loop
from beamdesign.plant.linear import LinearModel
from beamdesign.plant.members import paper_model
from beamdesign.polynomial import Affine, exact, nearest
from beamdesign.proofs.certificate import Asked, Claim, Kind
from beamdesign.proofs.performance import bandwidth as proved_bandwidth
from beamdesign.proofs.performance import least_limit, prove
from beamdesign.proofs.quadratic import first_negative, frequency_of, squared_frequency
from beamdesign.proofs.rectangle import Rectangle, shifted
from beamdesign.prototype import COMPLIANCE_LIMIT_M_PER_N

quick = settings(max_examples=80)
MASSES = (0.0, 6.8)
FREQUENCIES_HZ = np.geomspace(0.01, 2000, 3000)


def over(closed: Loop, low: float, high: float) -> Rectangle:
    return Rectangle(closed, exact(low), exact(high))


def prove_of(kind: Kind, closed: Loop, limit: float, low: float, high: float, bandwidth_Hz: float = inf) -> Claim:
    return prove(over(closed, low, high), Asked(kind, limit, bandwidth_Hz))


class Case:
    """A prototype with its exact loop, and its responses in floats from state-space matrices."""

    def __init__(self, prototype: Prototype):
        assert prototype.controller is not None
        self.prototype, self.controller = prototype, prototype.controller
        self.rig: LinearModel = paper_model(prototype)
        self.loop: Loop = loop(prototype)

    def controller_response(self, f: np.ndarray) -> np.ndarray:
        if isinstance(self.controller, Lag):
            return (
                self.controller.gain_A_per_V
                * (1 + 1j * f / self.controller.zero_Hz)
                / (1 + 1j * f / self.controller.pole_Hz)
            )
        return np.full(len(f), self.controller.gain_A_per_V, dtype=complex)

    def plant(self, mass: float, f: np.ndarray) -> np.ndarray:
        a, b, c = self.rig.matrices(mass, self.prototype.payload.inner_end_mass_kg)
        return c @ np.linalg.solve(
            2j * pi * f[:, None, None] * np.eye(len(a)) - a, np.broadcast_to(b, (len(f), *b.shape))
        )

    def sensitivity(self, mass: float, f: np.ndarray) -> np.ndarray:
        return np.abs(1 / (1 + self.plant(mass, f)[:, 1, 1] * self.controller_response(f)))

    def compliance(self, mass: float, f: np.ndarray) -> np.ndarray:
        g, k = self.plant(mass, f), self.controller_response(f)
        return np.abs(g[:, 0, 0] - g[:, 0, 1] * k * g[:, 1, 0] / (1 + g[:, 1, 1] * k))

    def poles(self, mass: float, factor: float = 1.0) -> np.ndarray:
        a, b, c = self.rig.matrices(mass, self.prototype.payload.inner_end_mass_kg)
        gain = self.controller.gain_A_per_V * factor
        if not isinstance(self.controller, Lag):
            return np.linalg.eigvals(a - gain * np.outer(b[:, 1], c[1]))
        pole, through = 2 * pi * self.controller.pole_Hz, gain * self.controller.pole_Hz / self.controller.zero_Hz
        return np.linalg.eigvals(
            np.block([[a - through * np.outer(b[:, 1], c[1]), b[:, 1:2]], [-pole * (gain - through) * c[1:2], -pole]])
        )


@pytest.fixture(params=["lag", "filtered", "proportional"])
def case(request, paper: Prototype, remedy: Prototype) -> Case:
    match request.param:
        case "lag":
            return Case(remedy.but(controller=remedy.controller.but(gain_A_per_V=0.08)))
        case "filtered":
            return Case(
                remedy.but(
                    controller=remedy.controller.but(gain_A_per_V=0.05), sensor=remedy.sensor.but(filter_Hz=400.0)
                )
            )
    return Case(remedy.but(controller=Proportional(gain_A_per_V=0.004)))


def test_peak_sensitivity_is_never_exceeded_and_hardly_better(case: Case):
    limit = least_limit([over(case.loop, *MASSES)], "peak_sensitivity")
    seen = max(case.sensitivity(mass, FREQUENCIES_HZ).max() for mass in np.linspace(*MASSES, 35))
    assert seen <= limit <= 1.001 * seen
    assert prove_of("peak_sensitivity", case.loop, limit, *MASSES).holds
    claim = prove_of("peak_sensitivity", case.loop, 0.999 * limit, *MASSES)
    assert not claim.holds
    there = case.sensitivity(claim.witness_outer_end_mass_kg, np.array([claim.witness.frequency_Hz]))
    assert there[0] > 0.999 * limit
    assert MASSES[0] <= claim.witness_outer_end_mass_kg <= MASSES[1]
    assert "exceeds the limit" in claim.reason


def test_compliance_is_never_exceeded_below_the_bandwidth(case: Case):
    limit = 4 * COMPLIANCE_LIMIT_M_PER_N
    bandwidth = proved_bandwidth([over(case.loop, *MASSES)], limit)
    assert bandwidth > 0.5
    inside = np.linspace(0, bandwidth, 400)
    assert max(case.compliance(mass, inside).max() for mass in np.linspace(*MASSES, 35)) <= limit * (1 + 1e-9)
    assert prove_of("compliance", case.loop, limit, *MASSES, bandwidth_Hz=bandwidth).holds
    claim = prove_of("compliance", case.loop, limit, *MASSES, bandwidth_Hz=1.001 * bandwidth)
    assert not claim.holds
    there = case.compliance(claim.witness_outer_end_mass_kg, np.array([claim.witness.frequency_Hz]))
    assert there[0] > limit
    assert bandwidth <= claim.witness.frequency_Hz <= 1.001 * bandwidth
    assert bandwidth == pytest.approx(
        min(case.loop.at(float(mass)).bandwidth_Hz(limit) for mass in np.linspace(*MASSES, 35)), rel=1e-3
    )


def test_every_pole_decays_as_fast_as_proved(case: Case):
    slowest = min(-case.poles(mass).real.max() for mass in np.linspace(*MASSES, 69))
    assert prove_of("decay_rate", case.loop, 0.99 * slowest, *MASSES).holds
    rate = slowest
    claim = prove_of("decay_rate", case.loop, 1.001 * rate, *MASSES)
    assert not claim.holds
    rightmost = max(case.poles(claim.witness_outer_end_mass_kg), key=lambda pole: pole.real)
    assert -rightmost.real < 1.001 * rate
    assert abs(rightmost.imag) / (2 * pi) == pytest.approx(claim.witness.frequency_Hz, rel=1e-6, abs=1e-9)
    assert "decays no faster" in claim.reason


def test_no_gain_up_to_the_margin_makes_it_unstable(case: Case):
    factor = 0.999 * min(case.loop.at(float(mass)).margins().gain_up for mass in np.linspace(*MASSES, 35))
    assert factor > 1
    for mass in np.linspace(*MASSES, 18):
        assert all(case.poles(mass, k).real.max() < 0 for k in np.linspace(1, factor, 10))
    assert prove_of("gain_margin", case.loop, factor, *MASSES).holds
    claim = prove_of("gain_margin", case.loop, 1.002 * factor, *MASSES)
    assert not claim.holds
    assert case.poles(claim.witness_outer_end_mass_kg, float(claim.witness.gain_factor)).real.max() > 0
    assert 1 <= float(claim.witness.gain_factor) <= 1.002 * factor
    assert "times the gain" in claim.reason


def test_a_gain_margin_may_point_down(case: Case):
    """The plant without its controller is damped: no lower gain harms."""
    assert prove_of("gain_margin", case.loop, 0.01, *MASSES).holds


def test_a_single_mass_gives_the_figures_of_the_loop_there(case: Case):
    at = case.loop.at(3.4)
    alone = [over(case.loop, 3.4, 3.4)]
    assert least_limit(alone, "peak_sensitivity") == pytest.approx(at.peak_sensitivity(), rel=2e-4)
    for share in (1 - 2e-4, 1 + 2e-4):
        factor, rate = share * at.margins().gain_up, share * -at.poles().real.max()
        assert prove_of("gain_margin", case.loop, factor, 3.4, 3.4).holds == (share < 1)
        assert prove_of("decay_rate", case.loop, rate, 3.4, 3.4).holds == (share < 1)
    limit = 4 * COMPLIANCE_LIMIT_M_PER_N
    assert proved_bandwidth(alone, limit) == pytest.approx(at.bandwidth_Hz(limit), rel=1e-6)


def test_nothing_is_granted_to_a_range_that_is_not_stable(remedy: Prototype):
    closed = loop(remedy)
    claims = [
        prove_of("peak_sensitivity", closed, 2.0, *MASSES),
        prove_of("compliance", closed, COMPLIANCE_LIMIT_M_PER_N, *MASSES, bandwidth_Hz=1e-6),
        prove_of("decay_rate", closed, 1e-6, *MASSES),
        prove_of("gain_margin", closed, 1.0001, *MASSES),
    ]
    for claim in claims:
        assert not claim.holds
        assert claim.reason
        assert Case(remedy).poles(claim.witness_outer_end_mass_kg).real.max() > 0
        assert claim.witness.frequency_Hz == pytest.approx(132, abs=5)
    assert not over(closed, *MASSES).stable


def test_a_static_compliance_above_the_limit_gives_no_bandwidth(remedy: Prototype):
    closed = loop(remedy)
    static = closed.at(5.0).static_compliance()
    assert proved_bandwidth([over(closed, 5.0, 6.0)], 0.99 * static) == 0
    assert not prove_of("compliance", closed, 0.99 * static, 5.0, 6.0, bandwidth_Hz=1e-3).holds
    assert proved_bandwidth([over(closed, 5.0, 6.0)], 1.01 * static) > 0


def test_a_limit_above_every_resonance_is_met_at_all_frequencies(remedy: Prototype):
    closed = loop(remedy)
    assert proved_bandwidth([over(closed, 5.0, 6.0)], 1.0) == inf
    assert prove_of("compliance", closed, 1.0, 5.0, 6.0, bandwidth_Hz=inf).holds
    assert not prove_of("compliance", closed, COMPLIANCE_LIMIT_M_PER_N, 5.0, 6.0, bandwidth_Hz=inf).holds


def test_a_peak_sensitivity_of_one_is_refuted_at_high_frequency(remedy: Prototype):
    claim = prove_of("peak_sensitivity", loop(remedy), 1.0, 5.0, 6.0)
    assert not claim.holds


def test_a_loop_that_no_gain_upsets_has_any_margin():
    """1 / (s + 1 + m): first order, stable at every gain."""
    closed = Loop(Affine(fmpq_poly([1, 1]), fmpq_poly([1])), Affine(fmpq_poly([1]), fmpq_poly([0])), fmpq_poly([1]))
    assert prove_of("gain_margin", closed, 1e6, 0.0, 1.0).holds
    assert prove_of("decay_rate", closed, 2.0 * (1 - 2e-4), 0.0, 1.0).holds
    assert not prove_of("decay_rate", closed, 2.0 * (1 + 2e-4), 0.0, 1.0).holds


@pytest.mark.parametrize("limit", [0.0, -1.0])
def test_limits_must_be_positive(remedy: Prototype, limit: float):
    with pytest.raises(ValueError, match="positive"):
        prove_of("peak_sensitivity", loop(remedy), limit, *MASSES)
    with pytest.raises(ValueError, match="empty range"):
        prove_of("decay_rate", loop(remedy), 1.0, 2.0, 1.0)


def test_a_violation_that_neither_end_of_the_range_shows(remedy: Prototype):
    """Where the frequency rises past its first violation, only masses inside the range are at fault there."""
    case = Case(remedy.but(controller=remedy.controller.but(gain_A_per_V=0.08)))
    claim = prove_of("peak_sensitivity", case.loop, 2.0, *MASSES)
    frequency = np.array([claim.witness.frequency_Hz])
    assert MASSES[0] < claim.witness_outer_end_mass_kg < MASSES[1]
    assert case.sensitivity(claim.witness_outer_end_mass_kg, frequency)[0] > 2
    assert all(case.sensitivity(mass, frequency)[0] < 2 for mass in MASSES)


# The polynomials of the claims.


@quick
@given(st.floats(1e-3, 1e4))
def test_frequencies_are_rounded_to_the_safe_side(frequency):
    below, above = squared_frequency(exact(frequency))
    assert below <= above
    assert nearest(above) == pytest.approx((2 * pi * frequency) ** 2, rel=1e-14)
    assert frequency_of(above)[0] <= exact(frequency) * (1 + fmpq(1, 10**30))
    assert squared_frequency(frequency_of(above)[0])[1] <= above * (1 + fmpq(1, 10**30))
    assert frequency_of(fmpq(0)) == (0, 0)


def test_shifting_moves_every_root():
    family = shifted(Affine(fmpq_poly([6, 5, 1]), fmpq_poly([1])), fmpq(1, 2))
    assert family.at(fmpq(0)) == fmpq_poly([fmpq(15, 4), 4, 1])  # roots -2 and -3 to -1.5 and -2.5
    assert family.slope == fmpq_poly([1])


# The inequality itself.


def q(*coefficients: int) -> fmpq_poly:
    return fmpq_poly(list(coefficients))


ZERO, ONE = fmpq(0), fmpq(1)


def test_a_dip_between_all_grid_points_is_found():
    """(m - 1/3)^2 + (x - 2/7)^2 - 1e-12: negative in a disc of a millionth, with both ends of the range positive."""
    a, b = q(1), q(-1) * fmpq(2, 3)
    c = fmpq_poly([fmpq(1, 9) + fmpq(4, 49) - fmpq(1, 10**12), -fmpq(4, 7), 1])
    found = first_negative((a, b, c), ZERO, ONE, ZERO, ONE)
    assert found is not None
    mass, x, _ = found
    assert (a(x) * mass + b(x)) * mass + c(x) < 0
    assert found.proved_to < x
    assert first_negative((a, b, c), ZERO, ONE, ZERO, found.proved_to) is None
    assert first_negative((a, b, c + fmpq(2, 10**12)), ZERO, ONE, ZERO, ONE) is None


def test_a_touch_is_no_violation():
    """(m - x)^2 and (m - 1/3)^2 + (x - 1/2)^2 reach zero but not below."""
    assert first_negative((q(1), q(0, -2), q(0, 0, 1)), ZERO, ONE) is None
    c = fmpq_poly([fmpq(1, 9) + fmpq(1, 4), -1, 1])
    assert first_negative((q(1), -q(1) * fmpq(2, 3), c), ZERO, ONE) is None


def test_a_root_that_stays_on_an_end_of_the_range():
    """m (1 - m) is zero at both ends for every x; m (m - 1) as well, but below zero between."""
    assert first_negative((q(-1), q(1), q(0)), ZERO, ONE) is None
    found = first_negative((q(1), q(-1), q(0)), ZERO, ONE)
    assert found.mass == fmpq(1, 2)
    # m (m x - m + 1 ... ) with a slope at the end that changes sign: m (x - 1 + m) fails only for x < 1.
    found = first_negative((q(1), q(-1, 1), q(0)), ZERO, ONE)
    assert found is not None
    assert first_negative((q(1), q(-1, 1), q(0)), ZERO, ONE, ONE) is None


def test_a_root_next_to_a_double_one_at_the_end_is_not_taken_for_it():
    beside = 1 + fmpq(1, 10**25)
    found = first_negative((q(0), q(0), q(-1, 1) ** 2 * q(-beside, 1)), ZERO, ZERO, ONE)
    assert found is not None
    assert ONE < found.x < beside


def test_a_curvature_that_vanishes_sends_no_root_through_the_range():
    """x m^2 + (x - 2) m + 3: at x = 0 a root comes in from infinity."""
    assert first_negative((q(0, 1), q(-2, 1), q(3)), ZERO, ONE, ZERO, fmpq(4)) is None


def test_a_single_mass_and_a_single_frequency():
    assert first_negative((q(1), q(0), q(0, -1)), fmpq(2), fmpq(2), ZERO, fmpq(4)) is None
    assert first_negative((q(1), q(0), q(0, -1)), fmpq(2), fmpq(2), ZERO, fmpq(5)) is not None
    assert first_negative((q(1), q(0), q(0, -1)), ONE, fmpq(2), ONE, ONE) is None
    assert first_negative((q(1), q(0), q(0, -1)), ZERO, fmpq(2), ONE, ONE) is not None


small = st.lists(st.integers(-3, 3), min_size=1, max_size=4).map(fmpq_poly)


@quick
@given(small, small, small, st.integers(-1, 1), st.integers(0, 2), st.sampled_from([None, 1, 3]), st.booleans())
def test_verdicts_agree_with_the_replay_and_with_samples(a, b, c, low, width, until, square):
    if square:  # often nonnegative, and then with touches
        a, b, c = a * a, 2 * a * b, b * b + (c if c.degree() == 0 else 0)
    ends, x_high = (fmpq(low), fmpq(low + width)), None if until is None else fmpq(until)
    found = first_negative((a, b, c), *ends, ZERO, x_high)

    def value(mass: fmpq, x: fmpq) -> fmpq:
        return (a(x) * mass + b(x)) * mass + c(x)

    independent = Slack.__new__(Slack)
    independent.coefficients = (a, b, c)
    assert independent.nonnegative(*ends, x_high) == (found is None)
    if found is None:
        masses = [ends[0] + fmpq(width * k, 7) for k in range(8)]
        assert all(value(mass, fmpq(k, 5) * (until or 9)) >= 0 for mass in masses for k in range(6))
    else:
        mass, x, _ = found
        assert value(mass, x) < 0
        assert ends[0] <= mass <= ends[1]
        assert x >= 0
        assert x_high is None or x <= x_high
        assert sqrt(nearest(found.proved_to)) <= sqrt(nearest(x))
