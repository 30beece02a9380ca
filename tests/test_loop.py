"""Figures of the loop against python-control, eigenvalues, dense sweeps and closed forms of textbook loops."""

from math import atan, degrees, inf, pi, sqrt

import control
import numpy as np
import pytest
from flint import fmpq, fmpq_poly
from hypothesis import given, settings
from hypothesis import strategies as st

from beamdesign import Prototype, critical_gain, state_space
from beamdesign.controllers import Lag, Proportional, Section, Structured
from beamdesign.diagnosis.data.dataset import MeasuredGain
from beamdesign.diagnosis.fitting.gain_evidence import GainEvidence
from beamdesign.diagnosis.fitting.hypothesis import NOTHING
from beamdesign.loop import LoopAtMass, loop
from beamdesign.prototype import Payload


@pytest.fixture(params=["remedy", "lag", "proportional", "filter", "loaded at low gain"])
def case(request: pytest.FixtureRequest, paper: Prototype, remedy: Prototype) -> tuple[Prototype, float]:
    """A stable loop and its outer end mass."""
    lag = paper.but(controller=Lag(gain_A_per_V=0.2, pole_Hz=1.75, zero_Hz=26.0))
    return {
        "remedy": (remedy, 6.8),
        "lag": (lag, 0.0),
        "proportional": (paper.but(controller=Proportional(gain_A_per_V=0.02)), 0.0),
        "filter": (lag.but(sensor=lag.sensor.but(filter_Hz=400.0)), 0.5),
        "loaded at low gain": (paper.but(controller=Lag(gain_A_per_V=0.01, pole_Hz=1.75, zero_Hz=26.0)), 6.8),
    }[request.param]


def opened(case: tuple[Prototype, float]) -> control.StateSpace:
    return state_space(*case, loop="open")["sensor_V", "command_V"]


def test_poles_and_zeros_are_those_of_the_matrices(case: tuple[Prototype, float]):
    at = loop(case[0]).at(case[1])
    assert at.stable
    np.testing.assert_allclose(at.poles(), np.sort_complex(state_space(*case).poles()), rtol=1e-9)
    np.testing.assert_allclose(at.open_loop_poles(), np.sort_complex(opened(case).poles()), rtol=1e-9)
    # Finite zeros of the Rosenbrock pencil; spurious ones lie far out.
    compliance = state_space(*case)["displacement_m", "disturbance_N"]
    for system, zeros in ((opened(case), at.open_loop_zeros()), (compliance, at.compliance_zeros())):
        found = system.zeros()
        for zero in zeros:
            assert np.abs(found - zero).min() < 1e-5 * abs(zero)


def test_margins_are_those_of_python_control(case: tuple[Prototype, float]):
    margins, at = loop(case[0]).at(case[1]).margins(), loop(case[0]).at(case[1])
    gains, phases, distances, w_gain, w_phase, _ = control.stability_margins(opened(case), returnall=True)
    smallest = np.argmin(np.where(gains > 1, gains, inf))
    assert margins.gain_up == pytest.approx(gains[smallest], rel=1e-9)
    assert margins.critical_frequency_Hz == pytest.approx(w_gain[smallest] / (2 * pi), rel=1e-9)
    assert margins.gain_down == max(gains[gains < 1], default=0.0)
    assert margins.phase_deg == pytest.approx(min(min(p, 360 - p) for p in phases), rel=1e-8)
    tightest = w_phase[np.argmin(np.minimum(phases, 360 - phases))]
    assert margins.phase_Hz == pytest.approx(tightest / (2 * pi), rel=1e-9)
    assert margins.crossover_Hz == pytest.approx(max(w_phase) / (2 * pi), rel=1e-9)
    assert at.peak_sensitivity() == pytest.approx(1 / min(distances), rel=1e-6)


def test_peak_sensitivity_is_above_every_sweep_and_reached(case: tuple[Prototype, float]):
    at = loop(case[0]).at(case[1])
    swept = np.abs(at.sensitivity_response(np.geomspace(1e-3, 1e4, 200_000))).max()
    assert swept <= at.peak_sensitivity() * (1 + 1e-12)
    assert swept == pytest.approx(at.peak_sensitivity(), rel=1e-5)


def test_compliance_keeps_the_limit_up_to_the_bandwidth_and_breaks_it_beyond(case: tuple[Prototype, float]):
    at = loop(case[0]).at(case[1])
    limit, bandwidth = 5.71e-8, at.bandwidth_Hz()
    compliance = state_space(*case)["displacement_m", "disturbance_N"]
    below = compliance(2j * pi * bandwidth * np.linspace(1e-6, 1, 2001))
    assert np.abs(below[:-1]).max() < limit
    assert abs(below[-1]) == pytest.approx(limit, rel=1e-9)
    assert abs(compliance(2j * pi * bandwidth * 1.0001)) > limit


def test_critical_gain_is_where_eigenvalues_reach_the_axis(case: tuple[Prototype, float]):
    rig, mass = case
    assert rig.controller is not None
    critical = critical_gain(rig, mass)

    def roots(gain: float) -> np.ndarray:
        return state_space(rig.but(controller=rig.controller.but(gain_A_per_V=gain)), mass).poles()  # type: ignore[union-attr]

    at_limit = roots(critical.gain_A_per_V)
    rightmost = at_limit[np.argmax(at_limit.real)]
    assert abs(rightmost.real) < 1e-7
    assert abs(rightmost.imag) / (2 * pi) == pytest.approx(critical.frequency_Hz, rel=1e-9)
    assert (
        roots(critical.gain_A_per_V * (1 - 1e-6)).real.max() < 0 < roots(critical.gain_A_per_V * (1 + 1e-6)).real.max()
    )
    for fraction in (0.01, 0.1, 0.5, 0.9):
        assert roots(critical.gain_A_per_V * fraction).real.max() < 0


def test_critical_gain_does_not_depend_on_the_gain_set(remedy: Prototype):
    assert remedy.controller is not None
    louder = remedy.but(controller=remedy.controller.but(gain_A_per_V=7.0))
    assert critical_gain(louder, 6.8) == critical_gain(remedy, 6.8)
    margins = loop(remedy).at(6.8).margins()
    assert 0.15 * margins.gain_up == pytest.approx(critical_gain(remedy, 6.8).gain_A_per_V, rel=1e-12)


def test_the_gain_of_a_loop_that_is_stable_at_no_low_gain_is_raised_from_its_own(paper: Prototype):
    """Its matrices' eigenvalues: unstable at a tenth, stable from the law's own gain up to the critical one."""
    section = Section(zero_Hz=13.5, zero_damping_ratio=0.18, pole_Hz=9.8, pole_damping_ratio=0.1)
    law = Structured(gain_A_per_V=0.068, pole_Hz=7.8, zero_Hz=38.0, section=(section,))
    critical = critical_gain(paper.but(controller=law), from_own=True)

    def growth(gain: float) -> float:
        return float(state_space(paper.but(controller=law.but(gain_A_per_V=gain)), 0.0).poles().real.max())

    assert growth(0.1 * law.gain_A_per_V) > 0
    assert all(growth(gain) < 0 for gain in np.linspace(law.gain_A_per_V, critical.gain_A_per_V * (1 - 1e-6), 20))
    assert growth(critical.gain_A_per_V * (1 + 1e-6)) > 0
    placement = NOTHING.placement(paper)
    measured = MeasuredGain(law, 0.0, 0.0, 0.03, raised_from=law.gain_A_per_V)
    onset = GainEvidence(measured, paper).predicted(placement, np.zeros(len(placement.unknowns)))
    assert onset is not None
    assert (onset.gain, onset.frequency / (2 * pi)) == pytest.approx((critical.gain_A_per_V, critical.frequency_Hz))


@given(
    mass=st.floats(0.0, 20.0), inner=st.floats(0.0, 6.0), gain=st.floats(1e-3, 0.6), pole=st.floats(0.2, 5.0),
    zero=st.floats(5.0, 100.0),
)  # fmt: skip
@settings(max_examples=60)
def test_stability_agrees_with_eigenvalues(mass: float, inner: float, gain: float, pole: float, zero: float):
    rig = PAPER.but(
        controller=Lag(gain_A_per_V=gain, pole_Hz=pole, zero_Hz=zero), payload=Payload(inner_end_mass_kg=inner)
    )
    at, rightmost = loop(rig).at(mass), state_space(rig, mass).poles().real.max()
    if abs(rightmost) > 1e-6:  # nearer to the axis eigenvalues in floats cannot tell
        assert at.stable == (rightmost < 0)
    if at.stable:
        assert at.peak_sensitivity() >= 1
        assert at.bandwidth_Hz() >= 0
    else:
        assert at.peak_sensitivity() == inf
        assert at.bandwidth_Hz() == 0


def test_an_unstable_loop_has_neither_bandwidth_nor_finite_sensitivity(remedy: Prototype):
    bare = loop(remedy).at(0.0)
    assert not bare.stable
    assert (bare.bandwidth_Hz(), bare.peak_sensitivity()) == (0.0, inf)


def test_static_compliance_is_that_of_springs_and_loop_gain(paper: Prototype):
    """At rest the leaking cylinder pushes with A / K_pq times the flow: K = K_m + A F K_sa K_q / K_pq."""
    for gain in (0.001, 0.024):
        stiffness = 486_800.0 + 1.13e-4 * 1180.0 * gain * 1.13e-2 / 3.8e-13
        at = loop(paper.but(controller=Proportional(gain_A_per_V=gain))).at(0.0)
        assert at.static_compliance() == pytest.approx(1 / stiffness, rel=1e-12)


def test_no_controller_no_loop(paper: Prototype):
    for call in (loop, critical_gain):
        with pytest.raises(ValueError, match="no \\[controller\\]"):
            call(paper)


# Loops of which textbooks know the figures. The disturbance enters nowhere unless said.


def textbook(
    opened: list[int | fmpq], returned: list[int | fmpq], disturbance: list[int | fmpq] | None = None
) -> LoopAtMass:
    return LoopAtMass(fmpq_poly(opened), fmpq_poly(returned), fmpq_poly(disturbance or [1]))


def test_third_order_loop_oscillates_at_the_gain_routh_gives():
    """L = k / (s (s + 1) (s + 2)): limit at k = 6 and w = sqrt 2, by Routh's table."""
    margins = textbook([0, 2, 3, 1], [1]).margins()
    assert margins.gain_up == pytest.approx(6.0, rel=1e-12)
    assert 2 * pi * margins.critical_frequency_Hz == pytest.approx(sqrt(2), rel=1e-12)


def test_conditionally_stable_loop_has_a_gain_margin_downwards():
    """L = k (s + 1)^2 / s^3 is stable for k > 1/2 alone."""
    above, below = textbook([0, 0, 0, 1], [1, 2, 1]), textbook([0, 0, 0, 4], [1, 2, 1])
    assert above.stable
    assert not below.stable
    assert above.margins().gain_down == pytest.approx(0.5, rel=1e-12)
    assert above.margins().gain_up == inf


@pytest.mark.parametrize("damping", [fmpq(1, 10), fmpq(1, 2), fmpq(9, 10)])
def test_second_order_loop(damping: fmpq):
    """L = 1 / (s (s + 2 zeta)): phase margin in closed form, no gain margin; |S| from its stationary point."""
    zeta = float(damping)
    at = textbook([0, 2 * damping, 1], [1])
    expected = degrees(atan(2 * zeta / sqrt(sqrt(1 + 4 * zeta**4) - 2 * zeta**2)))
    assert at.margins().phase_deg == pytest.approx(expected, rel=1e-9)
    assert at.margins().gain_up == inf
    x = np.linspace(0, 20, 400_001)
    swept = np.sqrt((x**2 + 4 * zeta**2 * x) / ((1 - x) ** 2 + 4 * zeta**2 * x)).max()
    assert at.peak_sensitivity() == pytest.approx(swept, rel=1e-8)


def test_integrator_has_the_least_sensitivity_a_loop_can_have():
    at = textbook([0, 1], [1])
    assert at.peak_sensitivity() == 1.0
    assert at.margins().phase_deg == pytest.approx(90.0)


def test_constant_loop_is_as_sensitive_at_all_frequencies_as_at_rest():
    """L = 1 / 2 of equal degree: S = 2 / 3 throughout, so infinity adds no peak of 1."""
    at = textbook([2, 2], [1, 1])
    assert at.peak_sensitivity() == pytest.approx(2 / 3)


def test_sensitivity_may_peak_at_infinity():
    """L = -s / (2 s + 2): S = (2 s + 2) / (s + 2) rises from 1 to 2."""
    assert textbook([2, 2], [0, -1]).peak_sensitivity() == 2.0


def test_bandwidth_at_its_limits():
    """x / F = c / (s^2 + 1.2 s + 1) has its peak c / 0.96 at w^2 = 0.28."""

    def with_peak(numerator: fmpq) -> LoopAtMass:
        return textbook([0, fmpq(6, 5), 1], [1], [numerator])

    touching = with_peak(fmpq(24, 25))
    assert touching.bandwidth_Hz(1.0) == inf, "a curve that touches the limit keeps it"
    assert touching.bandwidth_Hz(0.999) < sqrt(0.28) / (2 * pi)
    assert touching.bandwidth_Hz(0.95) == 0.0, "beyond the limit at rest already"
    # At rest exactly on the limit, and above it from there on.
    assert with_peak(fmpq(1)).bandwidth_Hz(1.0) == 0.0


def test_roots_are_given_as_often_as_they_occur():
    at = textbook([0, 0, 0, 1], [1, 3, 3])
    np.testing.assert_allclose(at.poles(), [-1, -1, -1])
    np.testing.assert_allclose(at.open_loop_poles(), [0, 0, 0])


PAPER = Prototype.model_validate(
    {
        "name": "paper",
        "outer_beam": {"stiffness_N_per_m": 486_800.0, "effective_mass_kg": 3.9},
        "inner_beam": {"stiffness_N_per_m": 157_500.0, "effective_mass_kg": 1.6},
        "actuator": {"piston_area_m2": 1.13e-4, "oil_stiffness_N_per_m": 1.3e7},
        "servovalve": {
            "flow_gain_m3_per_s_per_A": 1.13e-2,
            "leakage_m3_per_s_per_Pa": 3.8e-13,
            "natural_frequency_Hz": 150.0,
        },
        "sensor": {"gain_V_per_m": 1180.0},
    }
)
"""The fixture `paper`, for the property test, which cannot take a fixture."""
