"""Controllers as machines carry them out: sections, words, C, the loop as realised, and what these cost."""

import json
import re
from dataclasses import replace
from fractions import Fraction
from math import atan, degrees, pi, tan
from pathlib import Path

import control
import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from compiled_controller import CompiledController, in_volts_and_amperes
from flint import fmpq, fmpq_poly
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from realisation_trade import sufficient, trade
from realised_loop import run_closed
from typer.testing import CliRunner

from beamdesign import InputError, Prototype, code, read_prototype, simulate, state_space
from beamdesign.build.realisation.c_code import (
    HEADER,
    LAW,
    SELF_TEST,
    Machine,
    c_files,
    compiler,
    shifted,
    to_word,
    vectors,
)
from beamdesign.build.realisation.code import judge, loop_figures, sampled_figures
from beamdesign.build.realisation.law import fixed_point
from beamdesign.build.realisation.loop import prove_any_computing_time, prove_sampled, realised_loop
from beamdesign.build.realisation.realise import (
    Realisation,
    full_scales_of,
    half_steps,
    l1_norms,
    l2_norms,
    law_errors,
    realise,
    rounded_loop,
    rounding_effect,
)
from beamdesign.build.realisation.sections import discretised
from beamdesign.cli import app
from beamdesign.controllers import Lag, Proportional, Section, Structured, TransferFunction
from beamdesign.loop import loop
from beamdesign.polynomial import exact, roots, transfer
from beamdesign.proofs.mass_family import floats
from beamdesign.prototype import Arm, Servovalve
from beamdesign.scenario import Sampled, Scenario, ScenarioRecord, Step

STUDIES = Path(__file__).parent.parent / "studies"
TAME = STUDIES / "prototypes" / "tame_lag.toml"
WORDS = [10, 16, 17, 32, None]


@pytest.fixture(scope="module")
def rig() -> Prototype:
    return read_prototype(TAME)


def pair(frequency_Hz: float, damping_ratio: float) -> fmpq_poly:
    w = exact(2 * pi * frequency_Hz)
    return fmpq_poly([1, 2 * exact(damping_ratio) / w, 1 / w**2])


def one(frequency_Hz: float) -> fmpq_poly:
    return fmpq_poly([1, 1 / exact(2 * pi * frequency_Hz)])


def rich(gain: float = 0.05) -> TransferFunction:
    """A lag with three sections, one of whose numerators and one of whose denominators is overdamped."""
    top = one(20.0) * pair(80, 0.3) * pair(200, 1.5) * pair(130, 0.8)
    bottom = one(1.7) * pair(120, 0.7) * pair(300, 0.4) * pair(150, 1.2)
    return TransferFunction(exact(gain) * top, bottom)


def value(polynomial: fmpq_poly, point: complex) -> complex:
    return sum(float(Fraction(int(c.p), int(c.q))) * point**k for k, c in enumerate(polynomial.coeffs()))


def transfer_of(realisation: Realisation) -> tuple[list[fmpq_poly], fmpq_poly]:
    law = realisation.linear
    return transfer(law.a, law.b, law.c, law.d)


def response(realisation: Realisation, frequency_Hz: float) -> complex:
    (top,), bottom = transfer_of(realisation)
    z = np.exp(2j * pi * frequency_Hz / realisation.rate_Hz)
    return value(top, z) / value(bottom, z)


# Sections


def test_the_rule_is_scipys_of_warped_roots() -> None:
    law, rate = rich(), 3000.0
    found = [roots(p) for p in (law.numerator, law.denominator)]
    zeros, poles = (r * np.tan(np.abs(r) / (2 * rate)) / (np.abs(r) / (2 * rate)) for r in found)
    at, of, gain = scipy.signal.bilinear_zpk(zeros, poles, 0.05 * np.prod(-poles).real / np.prod(-zeros).real, rate)
    made = realise(law, rate, 32)
    assert len(made.sections) == 5  # overdamped ones as two each
    ours = roots(transfer_of(made)[1])
    assert np.sort_complex(ours) == pytest.approx(np.sort_complex(of), abs=1e-7)
    for frequency in (1.0, 60.0, 400.0, 1400.0):
        z = np.exp(2j * pi * frequency / rate)
        assert response(made, frequency) == pytest.approx(gain * np.prod(z - at) / np.prod(z - of), rel=1e-5)


@settings(max_examples=20)
@given(st.floats(0.02, 0.45), st.floats(0.05, 0.95), st.floats(0.02, 0.45), st.floats(0.05, 0.95))
def test_prewarped_every_root_keeps_its_frequency(own: float, zeros: float, other: float, poles: float) -> None:
    """Shares of the rate. At its own frequency a pair is 2 j d, and a first-order root 1 + j, as in continuous time."""
    assume(own != other and zeros != poles)  # equal roots cancel
    rate, delta = 1000.0, np.exp(2j * pi * own) - 1
    (notch,) = discretised(TransferFunction(pair(own * rate, zeros), pair(own * rate, poles)), rate).sections
    top = notch.direct * delta**2 + notch.slope * notch.follow * delta + notch.follow**2
    bottom = delta**2 + notch.damping * notch.follow * delta + notch.follow**2
    assert top / bottom == pytest.approx(zeros / poles, rel=1e-6)
    (lag,) = discretised(TransferFunction(one(other * rate), one(own * rate)), rate).sections
    expected = (1 + 1j * tan(pi * own) / tan(pi * other)) / (1 + 1j)
    assert (lag.direct * delta + lag.follow) / (delta + lag.follow) == pytest.approx(expected, rel=1e-6)


def test_laws_that_cannot_be_coded_are_told() -> None:
    lag = Lag(gain_A_per_V=0.2, pole_Hz=1.75, zero_Hz=26.0)
    for law, words in (
        (TransferFunction(one(3.0), fmpq_poly([1])), "proper"),
        (TransferFunction(fmpq_poly([1]), fmpq_poly([0, 1])), "zero frequency"),
        (TransferFunction(fmpq_poly([1]), fmpq_poly([1, -1])), "not stable"),
    ):
        with pytest.raises(ValueError, match=words):
            discretised(law, 1000.0)
    with pytest.raises(ValueError, match="not more than twice"):
        discretised(lag, 50.0)
    with pytest.raises(ValueError, match="8 to 32"):
        realise(lag, 1000.0, 7)
    with pytest.raises(ValueError, match="too far apart"):
        realise(lag, 1000.0, 8, largest_current_A=1e-6)
    with pytest.raises(ValueError, match="rounding alone fills them"):
        realise(rich(), 2000.0, 8)
    with pytest.raises(ValueError, match="too large for words"):
        realise(lag.but(gain_A_per_V=200.0), 1000.0, 8)


def test_sections_of_fewer_zeros_than_poles() -> None:
    """Zeros at infinity go to z = -1: the response at half the rate vanishes."""
    law = TransferFunction(fmpq_poly([exact(0.1)]), one(3.0) * pair(40, 0.5))
    found = realise(law, 1000.0, 32)
    assert abs(response(found, 500.0)) < 1e-7
    assert response(found, 0.0) == pytest.approx(0.1, rel=1e-9)


# Words


@given(st.floats(1e-7, 60.0), st.integers(8, 32))
def test_a_coefficient_is_rounded_to_its_word(number: float, bits: int) -> None:
    """|error| at most half a unit of the last of bits - 1 significant places, which its shift never exceeds."""
    found = fixed_point(number, bits)
    assert abs(found.integer) < 2 ** (bits - 1)
    assert 0 <= found.places <= 2 * bits - 2
    made = Fraction(int(found.value.p), int(found.value.q))
    assert abs(made - Fraction(number)) <= Fraction(1, 2 ** (found.places + 1))
    if found.places < 2 * bits - 2:
        assert abs(made / Fraction(number) - 1) <= Fraction(1, 2 ** (bits - 1))


@given(st.integers(-(2**62), 2**62), st.integers(0, 61))
def test_places_are_dropped_to_the_nearest(number: int, places: int) -> None:
    found, true = shifted(number, places), Fraction(number, 2**places)
    assert abs(found - true) <= Fraction(1, 2)
    assert shifted(-number, places) == -found


def test_poles_stay_where_the_direct_form_loses_them() -> None:
    """At a high rate a word holds 1 - pole to 2^-15 of itself; the direct form's own coefficient only to 2^-15 of 1.

    The direct form's pole -a1 near one, with 15 binary places, is off by up to 2^-16 of 1: by 3 % of 1 - pole here.
    """
    law = Lag(gain_A_per_V=0.05, pole_Hz=1.7, zero_Hz=20.0)
    found = realise(law, 20000.0, 16)
    assert law_errors(law, found, 20.0).pole <= 2.0**-15
    pole = 1 - found.sections[0].follow
    direct = abs(round(pole * 2**15) / 2**15 - pole) / (1 - pole)
    assert direct > 100 * law_errors(law, found, 20.0).pole


@pytest.mark.parametrize("bits", [12, 16, 24])
def test_a_lag_has_no_dead_band(bits: int) -> None:
    """Its static gain is one: the state becomes the error itself, be that one unit of a word."""
    machine = Machine(realise(Lag(gain_A_per_V=0.05, pole_Hz=1.7, zero_Hz=20.0), 2000.0, bits))
    r = machine.realisation
    for error in (3, -5, 1, 0):
        for _ in range(6000):
            current = machine.step(error)
        assert shifted(machine.states["x1"], bits - 2) == error
        assert current == shifted(r.coefficients["gain"].integer * error, r.current_shifts["gain"])


@pytest.mark.parametrize("bits", [12, 24])
def test_limit_cycles_of_the_law_alone_stay_within_the_bound(bits: int) -> None:
    """Second-order sections may hunt by a few units under a constant error, and on the average do not err."""
    r = realise(rich(), 2000.0, bits)
    machine, linear = Machine(r), r.linear
    bound = (l1_norms(floats(linear.a), floats(linear.f), floats(linear.c), floats(linear.g)) @ half_steps(r))[0]
    for error in (3, -5, 0):
        currents = [machine.step(error) for _ in range(9000)][6000:]
        static = 0.05 * error * 2.0 ** (r.current_places - r.signal_places)
        assert np.abs(np.array(currents) - static).max() * 2.0**-r.current_places <= bound
        assert abs(np.mean(currents) - static) <= 0.5


@pytest.mark.parametrize("bits", [10, 16, 24, 32, None])
def test_rounding_stays_within_its_bound(bits: int | None) -> None:
    """Against the exact law with the same coefficients, for errors within full scale that switch at their worst."""
    r = realise(rich(), 2000.0, bits, largest_current_A=10.0)
    linear, halves = r.linear, half_steps(r)
    a, b, c, d, f, g = (floats(m) for m in (linear.a, linear.b, linear.c, linear.d, linear.f, linear.g))
    bound = float((l1_norms(a, f, c, g) @ halves)[0])
    random = np.random.default_rng(4)
    errors = 10.0 * np.sign(random.standard_normal(3000)) * np.repeat(random.uniform(0, 1, 60), 50)
    ours = np.array(in_volts_and_amperes(r, list(errors)))
    x, exactly = np.zeros(len(a)), np.zeros(len(errors))
    for k, e in enumerate(errors):
        exactly[k] = (c @ x + d[:, 0] * e)[0]
        x = a @ x + b[:, 0] * e
    departure = np.abs(ours - exactly).max()
    assert departure <= bound * (1 + 1e-6)
    assert departure > 1e-3 * bound  # and the bound is one of this size, not of another


def test_within_full_scale_no_word_overflows_and_one_place_more_would() -> None:
    """Errors that switch by the sign of the impulse response of each signal drive it to its peak."""
    r = realise(rich(), 2000.0, 16)
    linear, n = r.linear, len(r.states)
    a, b, rows = floats(linear.a), floats(linear.b)[:, 0], floats(linear.signals)
    most, seen = 2**15 - 1, 0

    class Watching(Machine):
        def signal(self, name: str, value: int) -> int:
            nonlocal seen
            seen = max(seen, abs(value))
            return super().signal(name, value)

    full = int(r.full_scale_V * 2.0**r.signal_places)
    for row in rows:
        ahead, impulse = row[:n], [row[n]]
        for _ in range(1500):
            impulse.append(ahead @ b)
            ahead = ahead @ a
        machine = Watching(r)
        for share in reversed(impulse):
            machine.step(full if share >= 0 else -full)
    assert most / 2 < seen <= most


def test_errors_of_the_law_are_those_that_python_control_sees(rig: Prototype) -> None:
    assert isinstance(rig.controller, Lag)
    r = realise(rig.controller, 2000.0, 10)
    found = law_errors(rig.controller, r, 60.0)
    law = control.ss(*(floats(m) for m in (r.linear.a, r.linear.b, r.linear.c, r.linear.d)), 1 / r.rate_Hz)
    top, bottom = [rig.controller.gain_A_per_V / (2 * pi * 20.0), rig.controller.gain_A_per_V], [1 / (2 * pi * 1.7), 1]
    ratio = control.evalfr(law, np.exp(2j * pi * 60.0 / 2000.0)) / control.evalfr(
        control.tf(top, bottom), 2j * pi * 60.0
    )
    assert found.gain_dB == pytest.approx(20 * np.log10(abs(ratio)), abs=1e-9)
    assert found.lag_deg == pytest.approx(-np.angle(ratio, deg=True), abs=1e-7)
    assert found.static_gain == pytest.approx(float(control.dcgain(law)) / 0.05 - 1, abs=1e-12)
    assert (found.hold_lag_deg, found.computing_lag_deg) == (pytest.approx(5.4), pytest.approx(10.8))


def test_sums_of_impulse_responses_in_closed_form() -> None:
    """Of c a^k b: |c b| / (1 - |a|) and |c b| / sqrt(1 - a^2)."""
    a, b, c, d = np.diag([0.999, -0.5]), np.array([[1.0], [3.0]]), np.diag([2.0, 1.0]), np.array([[4.0], [0.0]])
    assert l1_norms(a, b, c, d)[:, 0] == pytest.approx([2 / 0.001 + 4, 3 / 0.5], rel=1e-5)
    assert l2_norms(a, b, c, d)[:, 0] == pytest.approx([np.sqrt(4 / (1 - 0.999**2) + 16), 3 / np.sqrt(0.75)], rel=1e-9)
    turning = 0.97 * np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    summed = sum(abs(0.97**k * np.cos(0.3 * k)) for k in range(3000))
    found = l1_norms(turning, np.array([[1.0], [0.0]]), np.array([[1.0, 0.0]]), np.zeros((1, 1)))[0, 0]
    assert summed <= found <= summed * (1 + 1e-5)


@pytest.mark.parametrize("bits", [16, None])
def test_anti_windup_leaves_the_limit_sooner(bits: int | None) -> None:
    """After a long error beyond the limit the current turns with the error, not when the lag has unloaded itself."""
    law = Lag(gain_A_per_V=0.05, pole_Hz=1.7, zero_Hz=20.0)
    r = realise(law, 2000.0, bits, largest_current_A=0.02)

    class Winding(Machine):
        def advance(self, state, coefficient, value, held):
            super().advance(state, coefficient, value, False)

    def samples_at_limit(machine) -> int:
        volts = [8.0] * 2000 + [-0.5] * 3000
        words = [to_word(r, v) for v in volts]
        at_limit = [machine.step(w) and machine.limited for w in words]
        return int(np.count_nonzero(np.array(at_limit[2000:]) > 0))

    holding, winding = (samples_at_limit(kind(r)) for kind in (Machine, Winding))
    assert holding == 0
    assert winding > 200


def falling() -> TransferFunction:
    """Minus the law of a lag."""
    law = Lag(gain_A_per_V=0.05, pole_Hz=1.7, zero_Hz=20.0).transfer_function()
    return TransferFunction(-law.numerator, law.denominator)


@pytest.mark.parametrize("bits", [16, None])
def test_a_law_of_negative_gain_is_the_mirror_of_that_of_the_positive(bits: int | None) -> None:
    """At the limit too, where its lag does not move further either."""
    rising = Lag(gain_A_per_V=0.05, pole_Hz=1.7, zero_Hz=20.0)
    one, other = (Machine(realise(law, 2000.0, bits, largest_current_A=0.02)) for law in (rising, falling()))
    volts = [8.0] * 500 + [-0.5] * 500
    words = [to_word(one.realisation, v) for v in volts]
    assert [one.step(w) for w in words] == [-other.step(w) for w in words]


# The loop as realised


def discrete_loop(rig: Prototype, r: Realisation, mass: float, delayed: bool) -> tuple[control.StateSpace, ...]:
    """Plant and controller by python-control: zero-order hold, and the law from its coefficients in floats."""
    plant = state_space(rig, mass, "plant")["sensor_V", "current_A"]
    held = control.c2d(control.ss(plant.A, plant.B, plant.C, plant.D), 1 / r.rate_Hz, "zoh")
    law = control.ss(*(floats(m) for m in (r.linear.a, r.linear.b, r.linear.c, r.linear.d)), 1 / r.rate_Hz)
    if delayed:
        law = law * control.ss([[0.0]], [[1.0]], [[1.0]], [[0.0]], 1 / r.rate_Hz)
    return held, law


@pytest.mark.parametrize("delayed", [False, True])
@pytest.mark.parametrize("sections", [False, True])
def test_the_realised_loop_has_python_controls_poles(rig: Prototype, delayed: bool, sections: bool) -> None:
    r = realise(rich(0.02) if sections else rig.controller, 2000.0, 12)
    ours = realised_loop(rig, r, delayed)
    for mass in (0.0, 6.8):
        theirs = control.feedback(control.series(*reversed(discrete_loop(rig, r, mass, delayed))), 1).poles()
        found = np.linalg.eigvals(ours.matrix(exact(mass)))
        assert len(found) == len(theirs)
        for pole in theirs:
            assert np.abs(found - pole).min() < 1e-5
        disturbed, *_ = rounded_loop(ours, mass)
        assert np.sort_complex(np.linalg.eigvals(disturbed)) == pytest.approx(np.sort_complex(found), abs=1e-9)


def test_margins_against_a_sweep_and_against_scaled_gains(rig: Prototype) -> None:
    r = realise(rig.controller, 2000.0, 12)
    for delayed in (False, True):
        found = sampled_figures(realised_loop(rig, r, delayed), 3.4)
        held, law = discrete_loop(rig, r, 3.4, delayed)
        w = np.geomspace(1, pi * 2000 * 0.999, 20000)
        swept = control.frequency_response(held * law, w).complex.ravel()
        assert np.abs(1 / (1 + swept)).max() == pytest.approx(found.peak_sensitivity, rel=1e-4)
        crossing = np.nonzero(np.diff(np.sign(np.abs(swept) - 1)))[0]
        assert w[crossing[-1]] / (2 * pi) == pytest.approx(found.crossover_Hz, rel=1e-3)
        assert np.abs(np.angle(-swept[crossing], deg=True)).min() == pytest.approx(found.phase_deg, abs=0.1)
        moduli = [
            np.abs(control.feedback(held * law * (found.gain_up * factor), 1).poles()).max()
            for factor in (0.999, 1.001)
        ]
        assert moduli[0] < 1 < moduli[1]


def test_fast_and_long_enough_the_margins_are_the_continuous_ones(rig: Prototype) -> None:
    design = loop_figures(loop(rig).at(2.0))
    found = sampled_figures(realised_loop(rig, realise(rig.controller, 1e6, 32)), 2.0)
    assert found.peak_sensitivity == pytest.approx(design.peak_sensitivity, rel=2e-3)
    assert found.gain_up == pytest.approx(design.gain_up, rel=5e-3)
    assert found.phase_deg == pytest.approx(design.phase_deg, abs=0.1)
    slow = sampled_figures(realised_loop(rig, realise(rig.controller, 20000.0, 32)), 2.0)
    lag = degrees(2 * pi * design.crossover_Hz * 1.5 / 20000)  # half a period of hold and one of computing
    assert design.crossover_Hz == pytest.approx(slow.crossover_Hz, rel=1e-3)
    assert slow.phase_deg <= design.phase_deg
    assert design.phase_deg - slow.phase_deg <= lag * 1.02


def test_the_loop_is_proved_as_realised(rig: Prototype) -> None:
    r = realise(rig.controller, 10000.0, 12)
    found = prove_sampled(realised_loop(rig, r), 0.0, 6.8)
    assert found.stable
    enclosed = realised_loop(rig, r).enclosed(fmpq(1), fmpq(3, 2))
    inner = realised_loop(rig, r).enclosed(fmpq(5, 4), fmpq(5, 4))
    n = inner.nrows()
    assert all(enclosed[i, j].overlaps(inner[i, j]) for i in range(n) for j in range(n))
    for mass in np.linspace(0, 6.8, 9):
        plant, law = discrete_loop(rig, r, mass, True)
        assert np.abs(control.feedback(plant * law, 1).poles()).max() < 1
    slow = judge(rig, realise(rig.controller, 250.0, 16), (0.0, 0.0), 1)
    assert slow.proved is False
    assert slow.masses[0].rounding is None


def test_the_code_of_an_arm_says_where_payload_and_sensor_are_in_its_proof(rig: Prototype) -> None:
    made = realise(rig.controller, 10000.0, 16)
    aside, sighted = Arm(offset_m=(0.0, 0.1, 0.0)), Arm(sensor_m=(0.1, 0.0, 0.0))
    for arm, told in ((None, False), (Arm(), False), (aside, True), (sighted, True)):
        notes = judge(rig.but(arm=arm), made, (0.0, 6.8), 1).notes()
        assert any("on the beam's axis at the tip" in line for line in notes) is told


def test_any_computing_time_against_a_hundredth_of_the_period(rig: Prototype) -> None:
    """The old current for 37 of 100 small steps and the new one for 63, by scipy's matrix exponential."""
    r = realise(rig.controller, 2000.0, 16)
    late = replace(realised_loop(rig, r), computing=(fmpq(37, 100),) * 2)
    ours = np.linalg.eigvals(late.matrix(fmpq(2)))
    plant = state_space(rig, 2.0, "plant")["sensor_V", "current_A"]
    n, m = len(plant.A), len(r.linear.a.tolist())
    small = scipy.linalg.expm(np.block([[plant.A, plant.B], [np.zeros((1, n + 1))]]) / (100 * r.rate_Hz))
    a, b, c, d = (floats(part) for part in (r.linear.a, r.linear.b, r.linear.c, r.linear.d))
    whole = np.zeros((n + 1 + m, n + 1 + m))
    for k in range(n + 1 + m):  # plant, old current, law
        x, old, law = np.split(np.eye(n + 1 + m)[k], [n, n + 1])
        error = -(plant.C @ x)[0]
        new = (c @ law)[0] + d[0, 0] * error
        for step in range(100):
            x = (small @ np.append(x, old[0] if step < 37 else new))[:n]
        whole[:, k] = np.concatenate([x, [new], a @ law + b[:, 0] * error])
    theirs = np.linalg.eigvals(whole)
    assert all(np.abs(ours - value).min() < 1e-6 for value in theirs)


def test_any_computing_time_is_proved_or_told(rig: Prototype) -> None:
    found = prove_any_computing_time(realised_loop(rig, realise(rig.controller, 10000.0, 16)), 2.0, 2.02)
    assert found.stable
    assert found.pieces >= 32
    slow = prove_any_computing_time(realised_loop(rig, realise(rig.controller, 500.0, 16)), 0.0, 0.0)
    assert slow.stable is False  # at once it is stable, one period late it is not
    assert "at a computing time of 0.96875 to 1 periods: a characteristic value of modulus 1." in slow.reason


def test_nothing_is_said_of_a_computing_time_that_changes(rig: Prototype) -> None:
    """At once and one period late this loop is stable, and in turn it grows: by the product of its two matrices."""
    sections = (
        Section(zero_Hz=28.1784, zero_damping_ratio=0.334407, pole_Hz=58.0206, pole_damping_ratio=0.141952),
        Section(zero_Hz=77.571, zero_damping_ratio=0.373773, pole_Hz=301.347, pole_damping_ratio=0.444539),
    )
    other = rig.but(
        outer_beam=rig.outer_beam.but(stiffness_N_per_m=787760.0, effective_mass_kg=5.39971, damping_ratio=0.06),
        inner_beam=rig.inner_beam.but(stiffness_N_per_m=135663.0, effective_mass_kg=0.917309, damping_ratio=0.03),
        actuator=rig.actuator.but(piston_area_m2=9.6661e-05, oil_stiffness_N_per_m=16353100.0),
        servovalve=Servovalve(
            flow_gain_m3_per_s_per_A=0.00971932,
            leakage_m3_per_s_per_Pa=1.99896e-12,
            natural_frequency_Hz=195.909,
            damping_ratio=0.326011,
        ),
        payload=rig.payload.but(inner_end_mass_kg=2.18104),
        controller=Structured(gain_A_per_V=0.00283235, pole_Hz=3.41662, zero_Hz=22.4464, section=sections),
    )
    found = code(other, 900.0, (0.5, 0.5))
    assert found.proved
    whole = realised_loop(other, found.realisation)
    early, late = (
        replace(whole, computing=(share,) * 2).matrix(fmpq(1, 2)) for share in (fmpq(1, 10**9), fmpq(1))
    )  # the old current is a state of both

    def radius(matrix: np.ndarray) -> float:
        return float(np.abs(np.linalg.eigvals(matrix)).max())

    assert max(radius(early), radius(late)) < 0.99
    assert radius(early @ late) > 1.1
    assert "at every sample alike" in "\n".join(found.notes())


# C


def test_the_emulation_gives_the_recorded_currents() -> None:
    """Worked by hand from the equations in the module: f = 1/4, h = 1/2 and gain 1/2 in words of 8 bits."""
    follow, direct = 0.25, 0.5  # pole z = 3/4; zero z = 1 - f / h = 1/2
    rate = 1000.0
    pole, zero = (rate / pi * atan((1 - z) / (1 + z)) for z in (0.75, 0.5))
    r = realise(Lag(gain_A_per_V=0.5, pole_Hz=pole, zero_Hz=zero), rate, 8, full_scale_V=10.0)
    assert r.sections[0].follow == pytest.approx(follow, rel=1e-9)
    assert r.sections[0].direct == pytest.approx(direct, rel=1e-9)
    assert (r.signal_places, r.current_places) == (2, 4)
    machine = Machine(r)
    # e = 40 is 10 V, a current of 1 A is 16: d = e - x, y = x + d / 2, i = 2 y, x += d / 4, halves away from zero
    # x: 0, 10, 17.5, 23, 27.25; as words 0, 10, 18, 23; d: 40, 30, 22, 17; y: 20, 25, 29, 32
    assert [machine.step(e) for e in (40, 40, 40, 40)] == [40, 50, 58, 64]
    assert machine.states["x1"] / 2**6 == pytest.approx(27.25)


def made(folder: Path, r: Realisation) -> CompiledController:
    for name, text in c_files(r, "a rig").items():
        (folder / name).write_text(text)
    return CompiledController(folder, r)


needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler; the emulation is tested all the same")


def hard_words(r: Realisation, count: int = 4000) -> list[float]:
    """Small, large and largest errors, beyond what words hold, and runs at either limit."""
    random = np.random.default_rng(8)
    if r.word_length is None:
        return [float(np.float32(v)) for v in random.choice([1e-4, 1.0, 30.0], count) * random.uniform(-1, 1, count)]
    most = 2 ** (r.word_length - 1) - 1
    noise = (random.choice([3 / most, 0.1, 1.0], count) * random.uniform(-1, 1, count) * most).astype(int)
    noise[500:900], noise[900:1300] = most, -most
    return [int(v) for v in noise]


@needs_compiler
@pytest.mark.parametrize("bits", WORDS)
def test_c_is_the_emulation_to_the_last_bit(bits: int | None, tmp_path: Path) -> None:
    for number, law in enumerate((rich(), Proportional(gain_A_per_V=0.01), falling())):
        r = realise(law, 2000.0, bits, largest_current_A=0.08)
        (folder := tmp_path / f"{number}").mkdir()
        machine, emulated = made(folder, r), Machine(r)
        assert machine.self_test() == 0
        limited = 0
        for error in hard_words(r):
            assert machine.step(error) == emulated.step(error)
            assert machine.limited == emulated.limited
            limited += emulated.limited != 0
        assert machine.states == emulated.states
        assert limited > 100
        for at in (machine, emulated):
            at.reset(7)
        assert machine.step(7) == emulated.step(7)


@needs_compiler
def test_in_floats_what_is_no_number_stays_until_the_reset(tmp_path: Path) -> None:
    """As the header says; of C and its emulation alike."""
    r = realise(rich(), 2000.0, None, largest_current_A=0.08)
    for at in (made(tmp_path, r), Machine(r)):
        assert np.isnan(at.step(np.nan))
        assert np.isnan(at.step(0.0))
        at.reset(0.0)
        assert at.step(0.0) == 0.0


@needs_compiler
def test_the_self_test_finds_a_wrong_bit(tmp_path: Path) -> None:
    r = realise(rich(), 2000.0, 16)
    files = c_files(r, "a rig")
    wrong = files[LAW].replace(
        f"(controller_wide){r.coefficients['follow2'].integer})",
        f"(controller_wide){r.coefficients['follow2'].integer + 40})",
    )
    assert wrong != files[LAW]
    for name, text in (files | {LAW: wrong}).items():
        (tmp_path / name).write_text(text)
    assert 0 < CompiledController(tmp_path, r).self_test() <= len(vectors(r)["currents"])


def test_files_state_their_units_and_cannot_be_broken_by_a_name() -> None:
    r = realise(rich(), 2000.0, 16, largest_current_A=0.08)
    files = c_files(r, "a */ name")
    assert set(files) == {HEADER, LAW, SELF_TEST}
    assert "a <U+002A>/ name" in files[LAW]
    header = files[HEADER]
    assert f"#define CONTROLLER_ERROR_PLACES ({r.signal_places}) /* error in V = word / 2^places */" in header
    for words in (
        "anti-windup",
        "2000 Hz",
        "0.08 A",
        "No memory is allocated",
        "no signal can overflow",
        "__cplusplus",
    ):
        assert words in header
    assert "malloc" not in "".join(files.values())
    assert max(len(line) for text in files.values() for line in text.splitlines()) <= 120


# In the loop, against the simulator


def in_floats_of_64_bits(r: Realisation) -> Realisation:
    """For a loop in V and A; see `ExactLaw`."""
    return replace(r, word_length=None, places=(0,), current_places=0, full_scales=(2.0,), largest_current_A=1.0)


class ExactLaw:
    """The realised law without any rounding or limit, in floats of 64 bits; takes and gives V and A."""

    def __init__(self, r: Realisation):
        m = r.linear
        self.a, self.b, self.c, self.d = (floats(part) for part in (m.a, m.b, m.c, m.d))
        self.names = m.states
        self.reset(0.0)

    def reset(self, error: float) -> None:
        self.x = np.array([float(error) if name[0] == "x" else 0.0 for name in self.names])

    def step(self, error: float) -> float:
        current = float((self.c @ self.x)[0] + self.d[0, 0] * error)
        self.x = self.a @ self.x + self.b[:, 0] * error
        return current


@needs_compiler
@pytest.mark.parametrize("bits", [16, 24, None])
def test_the_compiled_controller_in_the_simulators_loop(bits: int | None, rig: Prototype, tmp_path: Path) -> None:
    """Three loops on the same record: C, the exact law with its coefficients, and the simulator's own sampled law.

    C may depart from the exact law by the bound of rounding. The exact law departs from the simulator's by its three
    coefficients, each good to half a unit: loop and response change by no more than that in all, times the peak
    sensitivity, which is below three.
    """
    mass, period = 2.0, 5e-4
    scenario = Scenario(
        name="push",
        duration_s=2.0,
        sample_s=period,
        sampled=Sampled(period_s=period, delay_periods=1),
        record=(
            ScenarioRecord(
                name="push", outer_end_mass_kg=mass, input=(Step(amplitude_N=500.0, at_s=0.05, rise_s=0.01),)
            ),
        ),
    )
    theirs = simulate(rig, scenario).records[0]
    force, there = theirs.column("disturbance_N"), theirs.column("displacement_m")
    r = realise(rig.controller, 1 / period, bits, full_scale_V=2.0)
    in_c = run_closed(rig, r, made(tmp_path, r), force, mass)
    emulated = run_closed(rig, r, Machine(r), force, mass)
    assert np.array_equal(in_c.displacement_m, emulated.displacement_m)
    assert np.array_equal(in_c.current_A, emulated.current_A)

    in_volts = in_floats_of_64_bits(r)
    unrounded = run_closed(rig, in_volts, ExactLaw(r), force, mass)
    bound = rounding_effect(realised_loop(rig, r), mass, half_steps(r))
    departure = np.abs(in_c.displacement_m - unrounded.displacement_m).max()
    assert departure <= bound.displacement_m
    assert np.abs(in_c.current_A - unrounded.current_A).max() <= bound.current_A

    largest = np.abs(there).max()
    coefficients = 3 * 3 * 2.0 ** -((bits or 24) - 1)
    assert np.abs(unrounded.displacement_m - there).max() <= coefficients * largest
    assert np.abs(in_c.displacement_m - there).max() <= bound.displacement_m + coefficients * largest

    # At rest under a constant force: any limit cycle lies within the bound about the point of rest.
    tail = in_c.displacement_m[-1000:]
    assert np.abs(tail - unrounded.displacement_m[-1]).max() <= bound.displacement_m
    assert np.abs(in_c.error_V).max() < 2.0  # full scale was never left


@needs_compiler
def test_a_structured_controller_is_coded_proved_and_run(rig: Prototype, tmp_path: Path) -> None:
    """A lag with two sections behind a 400 Hz sensor filter: bit by bit the emulation, within its bound of rounding."""
    sections = (
        Section(zero_Hz=110.0, zero_damping_ratio=0.6, pole_Hz=120.0, pole_damping_ratio=0.8),
        Section(zero_Hz=250.0, zero_damping_ratio=0.3, pole_Hz=260.0, pole_damping_ratio=0.4),
    )
    law = Structured(gain_A_per_V=0.04, pole_Hz=1.7, zero_Hz=20.0, section=sections)
    filtered = rig.but(controller=law, sensor=rig.sensor.but(filter_Hz=400.0))
    r = realise(law, 10000.0, 24, full_scale_V=2.0)
    assert [section.order for section in r.sections] == [1, 2, 2]
    found = judge(filtered, r, (2.0, 2.5), 2)
    assert found.proved
    assert found.masses[0].late.peak_sensitivity == pytest.approx(found.masses[0].continuous.peak_sensitivity, rel=0.15)
    force = np.where(np.arange(4000) < 200, 0.0, 300.0)
    in_c = run_closed(filtered, r, made(tmp_path, r), force, 2.0)
    assert np.array_equal(in_c.displacement_m, run_closed(filtered, r, Machine(r), force, 2.0).displacement_m)
    unrounded = run_closed(filtered, in_floats_of_64_bits(r), ExactLaw(r), force, 2.0)
    bound = found.masses[0].rounding
    assert bound is not None
    assert np.abs(in_c.displacement_m - unrounded.displacement_m).max() <= bound.displacement_m
    assert np.abs(in_c.error_V).max() < 2.0
    static = loop(filtered).at(2.0).static_compliance() * 300.0
    assert in_c.displacement_m[-1] == pytest.approx(static, rel=0.1)


# Rate and word length


def test_margin_is_bought_by_rate_and_rounding_by_word_length(rig: Prototype) -> None:
    rows = trade(rig, (0.0, 6.8), (2000.0, 10000.0), (12, 24, None), looked_at=2, prove=False)
    by = {(row.rate_Hz, row.word_length): row for row in rows}
    assert by[10000.0, 24].lost_sensitivity < by[2000.0, 24].lost_sensitivity
    assert by[10000.0, 24].lost_sensitivity > 0
    assert by[2000.0, 24].rounding_m == pytest.approx(by[2000.0, 12].rounding_m * 2.0**-12, rel=0.01)
    assert by[2000.0, 24].expected_rounding_m < by[2000.0, 24].rounding_m
    assert sufficient(rows, 9.0, 1.0) is None  # nothing was proved
    slow = trade(rig, (0.0, 0.0), (35.0,), (16,), prove=False)[0]
    assert "not more than twice" in slow.reason
    assert slow.lost_sensitivity == float("inf")


def test_what_suffices_for_the_shipped_prototype(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, rig: Prototype
) -> None:
    """Ten kilohertz and 24 bits, as the script says; neither five kilohertz nor 16 bits."""
    monkeypatch.syspath_prepend(str(STUDIES))
    import realisation_trade

    monkeypatch.setattr(realisation_trade, "RATES_HZ", (5000.0, 10000.0))
    monkeypatch.setattr(realisation_trade, "WORDS", (16, 24))
    lines = realisation_trade.main(rig, tmp_path / "picture.svg")
    assert "tame_lag: 10000 Hz and 24 bits suffice" in lines[-2]
    assert "word length, bits" in (tmp_path / "picture.svg").read_text()
    assert len(lines) == 1 + 4 + 2


# The command


def run(*arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["code", *arguments])
    if isinstance(done.exception, InputError):
        return 2, str(done.exception)
    return done.exit_code, done.output


def test_the_command_writes_code_that_is_proved(tmp_path: Path) -> None:
    answer = tmp_path / "answer.json"
    options = ["--rate-Hz", "10000", "--word-length", "24", "--outer-end-mass", "0:2", "--json", str(answer)]
    status, said = run(str(TAME), "--out", str(tmp_path / "c"), *options, *(["--compile"] if compiler() else []))
    assert status == 0
    assert "proved: stable for 0 to 2 kg" in said
    assert "at every sample alike, for exactly these figures" in " ".join(said.split())
    assert "to the last bit" in said or not compiler()
    fields = json.loads(answer.read_text())
    assert fields["proved"] is True
    assert fields["word_length"] == 24
    rounding = [mass["rounding"] for mass in fields["masses"]]
    bounds = [
        scale * max(mass[name] for mass in rounding)
        for name, scale in (("displacement_m", 1e6), ("expected_displacement_m", 1e6), ("current_A", 1e3))
    ]
    told = re.search(r"at most (\S+) um at the samples\s+\(expected (\S+) um RMS\) and the\s+current by (\S+) mA", said)
    assert told is not None
    assert all(bound <= float(figure) <= 1.01 * bound for bound, figure in zip(bounds, told.groups(), strict=True))
    assert fields["masses"][0]["late"]["peak_sensitivity"] > fields["masses"][0]["continuous"]["peak_sensitivity"]
    assert {Path(file).name for file in fields["files"]} == {HEADER, LAW, SELF_TEST}
    assert {file.name for file in (tmp_path / "c").iterdir()} == {HEADER, LAW, SELF_TEST}
    header = (tmp_path / "c" / HEADER).read_text()
    assert "Proved stable for 0 to 2 kg" in header
    assert "for exactly these figures" in header


def test_a_loop_that_is_not_stable_as_realised_gets_no_code(tmp_path: Path) -> None:
    options = ["--rate-Hz", "250", "--outer-end-mass", "0:0", "--out", str(tmp_path / "c")]
    status, said = run(str(TAME), *options)
    assert status == 1
    assert "not stable: a characteristic value of modulus" in said
    assert not (tmp_path / "c").exists()


def test_bad_input_is_told_at_once(tmp_path: Path) -> None:
    status, said = run(str(TAME), "--rate-Hz", "-1", "--word-length", "4", "--full-scale-V", "nan")
    assert status == 2
    assert "--rate-Hz: is " in said
    assert "--word-length: must be from 8 to 32 bits, is 4" in said
    assert "--full-scale-V" in said
    assert run(str(TAME), "--rate-Hz", "1000", "--float", "--word-length", "16")[0] == 2
    status, said = run(str(TAME), "--rate-Hz", "30", "--out", str(tmp_path / "c"))
    assert (status, "not more than twice" in said) == (2, True)
    without = tmp_path / "open.toml"
    without.write_text(TAME.read_text().replace("[controller]", "[goal]\n# ").replace('kind = "lag"', ""))
    assert run(str(without), "--rate-Hz", "1000")[0] == 2


def test_effects_leave_the_proof_open_and_the_code_says_so(tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(TAME.read_text() + "\n[effects.sensor_lag]\nbreak_Hz = 400.0\n")
    status, said = run(str(rig), "--rate-Hz", "10000", "--float", "--out", str(tmp_path / "c"))
    assert status == 0
    assert "not looked at" in said
    assert "not proved" in (tmp_path / "c" / HEADER).read_text()


@needs_compiler
@pytest.mark.parametrize("bits", [16, 32, None])
def test_code_with_an_added_sensor_in_the_simulators_loop(bits: int | None, tmp_path: Path) -> None:
    """C with three readings: to the last bit its emulation, and near the simulator's sampled and continuous loops.

    At 2 kHz the compliant law's force filter and servo are slow beside the period: the loops differ by its delay.
    """
    rig = read_prototype(TAME.with_name("compliant.toml"))
    mass, period = 2.0, 5e-4
    row = ScenarioRecord(name="push", outer_end_mass_kg=mass, input=(Step(amplitude_N=500.0, at_s=0.05, rise_s=0.01),))
    plan = Scenario(name="push", duration_s=0.5, sample_s=period, record=(row,))
    late = simulate(rig, plan.but(sampled=Sampled(period_s=period, delay_periods=1))).records[0]
    continuous = simulate(rig, plan).records[0].column("displacement_m")
    scales = full_scales_of(rig, 2.0)
    r = realise(rig.controller, 1 / period, bits, full_scale_V=2.0, full_scales=scales)
    assert [channel.reading for channel in r.channels] == ["displacement_m", "load_pressure_Pa", "command_V"]
    assert max(abs(one.error) for one in r.coefficients.values()) < 2.0 ** -((bits or 24) - 2)
    force, machine = late.column("disturbance_N"), made(tmp_path, r)
    assert machine.self_test() == 0
    in_c = run_closed(rig, r, machine, force, mass)
    emulated = run_closed(rig, r, Machine(r), force, mass)
    assert np.array_equal(in_c.displacement_m, emulated.displacement_m)
    assert np.array_equal(in_c.current_A, emulated.current_A)
    largest, there = np.abs(continuous).max(), late.column("displacement_m")
    assert np.abs(there - continuous).max() < 0.02 * largest
    bound = rounding_effect(realised_loop(rig, r), mass, half_steps(r)).displacement_m
    assert np.abs(in_c.displacement_m - there).max() < bound + 1e-3 * largest


def test_the_realised_loop_of_added_sensors_has_python_controls_poles() -> None:
    """Its plant held, the law's matrices as they are realised, each reading with its sign; and it is proved."""
    rig = read_prototype(TAME.with_name("compliant.toml"))
    r = realise(rig.controller, 2000.0, 24, full_scales=full_scales_of(rig, 10.0))
    plant = state_space(rig, 3.4, "plant")[["sensor_V", "load_pressure_Pa"], "current_A"]
    held = control.c2d(control.ss(plant.A, plant.B, plant.C, plant.D), 1 / r.rate_Hz, "zoh")
    law = control.ss(*(floats(m) for m in (r.linear.a, r.linear.b, r.linear.c, r.linear.d)), 1 / r.rate_Hz)
    readings = control.ss([], [], [], np.array([[-1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]), 1 / r.rate_Hz)
    theirs = control.feedback(law * readings * held, 1, sign=1)
    ours = realised_loop(rig, r, delayed=False)
    found = np.linalg.eigvals(ours.matrix(exact(3.4)))
    assert len(found) == len(theirs.poles())
    for pole in theirs.poles():
        assert np.abs(found - pole).min() < 1e-5
    margins = sampled_figures(ours, 3.4)
    w = np.geomspace(1, pi * 2000 * 0.999, 20000)
    swept = control.frequency_response(-law * readings * held, w).complex.ravel()
    assert np.abs(1 / (1 + swept)).max() == pytest.approx(margins.peak_sensitivity, rel=1e-4)
    assert prove_sampled(realised_loop(rig, r), 3.0, 3.4).stable
