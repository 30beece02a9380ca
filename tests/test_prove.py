"""Proofs of any loop: against python-control where it is right, closed forms where it is not, roots of random ones."""

import ast
import cmath
import json
import re
import warnings
from importlib import import_module
from itertools import product
from math import inf, log, pi
from pathlib import Path

import control
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import beamdesign
from beamdesign import InputError, check, prove
from beamdesign.docs import pages
from beamdesign.proofs.any_loop import SAFE

OGATA = [1, 2, 4], np.polymul([1, 4, 0], np.polymul([1, 6], [1, 1.4, 1]))
"""K. Ogata, Modern Control Engineering, conditionally stable: 0 < K < 15.6 and 67.5 < K < 163.6."""


def ogata(gain: float) -> control.TransferFunction:
    above, below = OGATA
    return control.tf([gain * c for c in above], below)


LOOPS = {
    "three lags": control.tf([12], [1, 6, 11, 6]),
    "servo": control.tf([10], [1, 6, 5, 0]),
    "conditional": ogata(100.0),
    "unstable plant": control.tf([3], [1, -2]),
    "triple integrator": control.tf([100, 200, 100], [1, 0, 0, 0]),
    "state space": control.ss([[-0.1, 1.0], [-4.0, -0.3]], [[0.0], [1.5]], [[1.0, 0.2]], [[0.1]]),
    "sampled": control.tf([0.1, 0.08], [1, -1.7, 0.72], 0.1),
    "sampled state space": control.ss([[0.9, 0.1], [-0.2, 0.7]], [[0.0], [1.0]], [[1.2, 0.3]], 0, 0.01),
}


def unstable_roots(system: control.TransferFunction, factor: float = 1.0) -> int:
    """Number of closed-loop poles on the wrong side, in floats."""
    above, below = (np.asarray(part[0][0], dtype=float) for part in (system.num, system.den))
    found = np.roots(np.polyadd(below, factor * above))
    return int(np.sum(np.abs(found) >= 1) if system.isdtime(strict=True) else np.sum(found.real >= 0))


def quietly(function, *given, **named):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return function(*given, **named)


def inside(value: float, pair: tuple[float, float], relative: float = 1e-6) -> bool:
    return pair[0] * (1 - relative) <= value <= pair[1] * (1 + relative)


# Where python-control is right.


@pytest.mark.parametrize("name", sorted(set(LOOPS) - {"sampled state space"}))
def test_margins_are_those_of_python_control(name: str):
    system = LOOPS[name]
    proved = prove(system)
    assert proved.stable
    assert (proved.yes, proved.status, proved.reason) == (True, "yes", "")
    gains, phases, _, _, frequencies, _ = quietly(control.stability_margins, system, returnall=True)
    up, down = min(gains[gains > 1], default=inf), max(gains[gains < 1], default=0.0)
    assert up == inf if proved.gain_increase[0] == inf else inside(up, proved.gain_increase)
    assert inside(down, proved.gain_decrease) or (down, proved.gain_decrease) == (0.0, (0.0, 0.0))
    assert inside(min(np.abs(phases)), proved.phase_margin_deg)
    assert len(proved.gain_crossings) == len(frequencies)
    for crossing, frequency in zip(proved.gain_crossings, sorted(frequencies), strict=True):
        assert inside(frequency, crossing.frequency_rad_per_s)
    for pair in (getattr(proved, figure) for figure in SAFE):
        assert pair[0] <= pair[1]
        assert pair[0] in (0.0, inf) or pair[1] / pair[0] < 1 + 1e-12


@pytest.mark.parametrize("name", LOOPS)
def test_peaks_are_reached_on_a_grid_and_not_exceeded(name: str):
    system = LOOPS[name]
    proved = prove(system)
    top = pi / system.dt if system.isdtime(strict=True) else 1e4
    grid = np.unique([*np.geomspace(1e-6 * top, top, 8001), *np.linspace(1e-3 * top, top, 8001)])
    value = quietly(control.frequency_response, system, grid).complex.ravel()
    seen = {
        "peak_sensitivity": np.max(np.abs(1 / (1 + value))),
        "peak_complementary": np.max(np.abs(value / (1 + value))),
        "disk_margin": 2 / np.max(np.abs((1 - value) / (1 + value))),
    }
    for figure, of_grid in seen.items():
        low, high = getattr(proved, figure)
        beyond = of_grid > high * (1 + 1e-9) if SAFE[figure] == "at most" else of_grid < low * (1 - 1e-9)
        assert not beyond
        assert of_grid == pytest.approx(low, rel=1e-4)
    disk = quietly(control.disk_margins, system, grid, skew=0.0)[0]
    assert float(np.asarray(disk).ravel()[0]) == pytest.approx(proved.disk_margin[0], rel=1e-4)


@pytest.mark.parametrize("name", LOOPS)
def test_the_loop_changes_at_its_gain_margins(name: str):
    """Roots in floats just inside and just outside of both bounds."""
    system = LOOPS[name]
    proved, alike = prove(system), quietly(control.ss2tf, system) if isinstance(system, control.StateSpace) else system
    (low, _), (_, high) = proved.gain_decrease, proved.gain_increase
    assert any(start <= 1 <= end for start, end in proved.stable_gains)
    for start, end in proved.stable_gains:
        assert unstable_roots(alike, start * (1 + 1e-6) + 1e-9) == 0
        assert unstable_roots(alike, min(end, 1e3) * (1 - 1e-6)) == 0
    if low > 0:
        assert unstable_roots(alike, low * (1 - 1e-6)) > 0
    if high < inf:
        assert unstable_roots(alike, high * (1 + 1e-6)) > 0


def test_closed_forms():
    """s (s + 1) (s + 5) + 10 k is stable for 10 k < 30; 1 / (s + 1) with k is never not; 3 / (s - 2) from 2 / 3 up."""
    servo = prove(LOOPS["servo"])
    assert servo.gain_increase == (3.0, 3.0)
    assert servo.gain_decrease == (0.0, 0.0)
    (crossing,) = (one for one in servo.phase_crossings)
    assert crossing.frequency_rad_per_s[0] == pytest.approx(5**0.5, rel=1e-12)
    for gain in (1, 2, 4, 5):  # k / (z - 1 / 2) is stable for k < 3 / 2, also where the search ends just there
        assert prove(control.tf([1 / gain], [1, -0.5], 1.0)).stable_gains == ((0.0, 1.5 * gain),)
    lag = prove(control.tf([1], [1, 1]))
    assert (lag.gain_increase, lag.stable_gains) == ((inf, inf), ((0.0, inf),))
    assert lag.peak_complementary == (0.5, 0.5)
    assert inside(180.0, lag.phase_margin_deg, 1e-15)
    assert lag.delay_margin_s == (inf, inf)
    unstable = prove(LOOPS["unstable plant"])
    assert inside(2 / 3, unstable.gain_decrease, 1e-15)
    # |3 / (jw - 2)| = 1 at w^2 = 5, the lag left there atan(w / 2); 1 / (1 + L) = (s - 2) / (s + 1).
    assert inside(np.degrees(np.arctan(5**0.5 / 2)), unstable.phase_margin_deg, 1e-12)
    assert inside(np.arctan(5**0.5 / 2) / 5**0.5, unstable.delay_margin_s, 1e-12)
    assert (unstable.peak_sensitivity, unstable.peak_complementary) == ((2.0, 2.0), (3.0, 3.0))


def test_a_delay_just_below_the_margin_is_harmless_and_one_above_is_not():
    """With exp(-s T) in its Pade form of order 8, whose error here is far below what separates the two."""
    system = LOOPS["servo"]
    (margin, _) = prove(system).delay_margin_s
    for factor, wrong in ((0.999, 0), (1.001, 2)):
        assert unstable_roots(system * control.tf(*control.pade(factor * margin, 8))) == wrong


def test_whole_periods_of_delay():
    """In a sampled loop the roots of z^n D + N, by n."""
    system = LOOPS["sampled"]
    margin, period = prove(system).delay_margin_s[0], system.dt
    safe = [unstable_roots(system * control.tf([1], [1, *[0] * n], period)) == 0 for n in range(12)]
    allowed = [n * period < margin for n in range(12)]
    assert allowed[:2] == [True, True]
    assert not allowed[-1]
    assert safe == allowed
    # |L(-1)| = 1.5 is above one: not even one period may be added, though |L| = 1 nowhere else but near it.
    fast = control.tf([-0.75], [1, 0.5], 1.0)
    assert unstable_roots(fast) == 0
    assert unstable_roots(fast * control.tf([1], [1, 0], 1.0)) > 0
    assert prove(fast).delay_margin_s[0] == 0.0


# Where python-control does not tell.


def test_a_conditionally_stable_loop_has_two_margins():
    """Of three factors `control.margin` gives the one nearest to one, and where the loop is not stable gives it too."""
    proved = prove(ogata(100.0))
    told = quietly(control.margin, ogata(100.0))[0]
    assert told == pytest.approx(proved.gain_decrease[0])
    assert proved.gain_increase[1] == pytest.approx(1.636, abs=1e-3)  # Ogata's 163.6
    assert [f"{100 * low:.1f} to {100 * high:.1f}" for low, high in proved.stable_gains] == [
        "0.0 to 15.6", "67.5 to 163.6",
    ]  # fmt: skip
    between = prove(ogata(30.0))
    assert (between.stable, between.status, between.gain_increase) == (False, "no", None)
    assert unstable_roots(ogata(30.0)) == 2
    assert quietly(control.margin, ogata(30.0))[0] > 0
    assert len(between.stable_gains) == 2


def test_a_resonance_between_the_points_of_a_grid():
    """L = -0.025 (s^2 + 6e-6 s + 1) / (s + 1) / (s^2 + 1e-7 s + 1) is small, and -1.5 / (1 + j) at w = 1."""
    below = np.polymul([1, 1], [1, 1e-7, 1])
    system = control.tf([-0.5, -3e-6, -0.5], below) * 0.05
    at_one = -0.05 * 0.5 * 60 / (1 + 1j)
    proved = prove(system)
    assert proved.peak_sensitivity[1] >= abs(1 / (1 + at_one))
    grid = np.geomspace(1e-3, 1e3, 4000)
    value = control.frequency_response(system, grid).complex.ravel()
    assert np.max(np.abs(1 / (1 + value))) < 1.1 < abs(1 / (1 + at_one))
    disk = float(np.asarray(quietly(control.disk_margins, system, grid, skew=0.0)[0]).ravel()[0])
    assert disk > 1.2 * proved.disk_margin[1]


def test_half_the_sampling_rate_is_a_crossing():
    """There L(-1) = -0.45 / 3.25: the closed loop has a pole at z = -1 at a gain of 65 / 9, which nobody else names."""
    system = control.ss2tf(LOOPS["sampled state space"])
    proved = prove(LOOPS["sampled state space"])
    assert inside(65 / 9, proved.gain_increase, 1e-15)
    assert [unstable_roots(system, factor) for factor in (7.22, 7.23)] == [0, 1]
    assert len(quietly(control.stability_margins, system, returnall=True)[0]) == 0
    assert quietly(control.margin, system)[0] == inf


@pytest.mark.parametrize(("middle", "stable"), [(2.000000000000001, True), (1.999999999999999, False)])
def test_light_damping_is_decided_exactly(middle: float, stable: bool):
    """s^4 + c s^3 + a s^2 + c s + 1 is stable if and only if a > 2 (Routh: c c a > 2 c c), which floats do not see."""
    c = 1e-12
    system = control.tf([0.5], [1, c, middle, c, 0.5])
    assert prove(system).stable is stable
    assert np.max(np.roots([1, c, middle, c, 1]).real) > 0  # for both


def test_a_mode_that_is_hidden_is_looked_at():
    """x2 grows by itself and is not seen: the transfer function of the loop does not tell."""
    hidden = control.ss([[-1.0, 0.0], [0.0, 1e-9]], [[1.0], [1.0]], [[1.0, 0.0]], 0)
    proved = prove(hidden)
    assert not proved.stable
    assert proved.stable_gains == ()
    assert prove(control.tf([1], [1, 1])).stable
    border = prove(control.tf([1, 1], [1, 0, -1], True))
    assert "hides a pole" in border.reason
    assert border.stable_gains == ()


def test_any_delay_harms_a_loop_gain_above_one_at_high_frequency():
    """s + 1 + (2 s + 1) exp(-s T) has roots near (ln 2 + j pi) / T, found here by Newton's method."""
    system = control.tf([2, 1], [1, 1])
    proved = prove(system)
    assert proved.stable
    assert proved.delay_margin_s == (0.0, 0.0)
    delay = 1e-3
    s = complex(log(2), pi) / delay
    for _ in range(50):
        late = cmath.exp(-s * delay)
        s -= (s + 1 + (2 * s + 1) * late) / (1 + (2 - delay * (2 * s + 1)) * late)
    assert abs(s + 1 + (2 * s + 1) * cmath.exp(-s * delay)) < 1e-9 * abs(s)
    assert s.real > 100


def test_poles_at_infinity_and_at_minus_one():
    """1 + L vanishes at infinite frequency; or z + 1 is a factor of D + N."""
    assert "infinite frequency" in prove(control.tf([-1, 0], [1, 2])).reason
    assert "z = -1" in prove(control.tf([2.5, 2], [1, 0.5], 1.0) * control.tf([1], [1, 0], 1.0)).reason
    assert "unit circle" not in prove(control.tf([0.5], [1, 0], 1.0)).reason


# Random loops.


COEFFICIENT = st.floats(-3, 3).map(lambda value: round(value, 3))


@settings(max_examples=150)
@given(
    above=st.lists(COEFFICIENT, min_size=1, max_size=4),
    below=st.lists(COEFFICIENT, min_size=3, max_size=5),
    period=st.sampled_from([0, 0.5]),
)
def test_random_loops_are_proved_stable_where_their_roots_are(above, below, period):
    assume(any(above))  # python-control takes the poles away where the numerator is zero
    below = [1.0, *below]
    system = control.tf(above, below, period)
    closed = np.polyadd(below, above)
    assume(closed[0])  # else a pole is at infinity, of which the roots know nothing
    found = np.roots(closed)
    margins = 1 - np.abs(found) if period else -found.real
    assume(np.min(np.abs(margins)) > 1e-6)
    proved = prove(system)
    assert proved.stable == bool(np.all(margins > 0))
    for low, high in proved.stable_gains:
        middle = low + 1.0 if high == inf else (low + high) / 2
        if (high - low) > 1e-3:
            roots = np.roots(np.polyadd(below, middle * np.array(above)))
            assert np.max(np.abs(roots) - 1 if period else roots.real) < 1e-6
    if proved.stable:
        grid = np.linspace(1e-3, pi / period if period else 50.0, 997)
        value = control.frequency_response(system, grid).complex.ravel()
        assert np.max(np.abs(1 / (1 + value))) <= proved.peak_sensitivity[1] * (1 + 1e-6)
        near = [turn for turn in proved.gain_crossings if turn.frequency_rad_per_s[0] > 0]
        for turn in near:
            if turn.frequency_rad_per_s[1] < inf:
                at = control.evalfr(system, 1j * turn.frequency_rad_per_s[0])
                if period:
                    at = control.evalfr(system, np.exp(1j * period * turn.frequency_rad_per_s[0]))
                assert at * np.exp(-1j * np.radians(turn.phase_deg[0])) == pytest.approx(-1, abs=1e-5)


# What is refused, claimed and shown.


def test_what_is_no_such_loop_is_refused():
    pairs = {
        "more zeros": control.tf([1, 0, 0], [1, 2]),
        "2 inputs and 1 outputs": control.ss([[-1.0]], [[1.0, 2.0]], [[1.0]], [[0.0, 0.0]]),
        "not a finite real number": control.ss([[float("nan")]], [[1.0]], [[1.0]], 0),
        "FrequencyResponseData": control.frd(control.tf([1], [1, 1]), [1.0, 2.0, 3.0]),
        "expected a system of python-control": 5,
    }
    for words, system in pairs.items():
        with pytest.raises(InputError, match=words):
            prove(system)
    with pytest.raises(InputError, match="no such figure"):
        prove(LOOPS["servo"], claims={"bandwidth": 3.0})


def test_claims_are_decided_by_the_bounds():
    kept = prove(LOOPS["servo"], claims={"peak_sensitivity": 3.0, "phase_margin_deg": 25.0, "gain_increase": 3.0})
    assert kept.yes
    assert set(kept.claims.values()) == {True}
    lost = prove(LOOPS["servo"], claims={"peak_sensitivity": 2.0, "gain_increase": 3.0})
    assert (lost.status, lost.claims) == ("no", {"peak_sensitivity": False, "gain_increase": True})
    assert "peak_sensitivity does not keep 2" in lost.reason


def test_a_result_shows_itself():
    proved = prove(LOOPS["servo"])
    assert repr(proved).startswith("<ProvedLoop: yes; gain_increase=3, gain_decrease=0, phase_margin_deg=25.38982")
    assert json.loads(json.dumps(proved.to_dict(), allow_nan=False))["gain_increase"] == [3.0, 3.0]
    assert {name: words for name, _, words, _ in proved.rows()} == SAFE
    assert beamdesign.prove is prove


# Over parameters.


def test_one_parameter_is_decided_exactly():
    """s (s + 1) (s + 5) + k is stable for 0 < k < 30; and the same as coefficients, and sampled."""
    for loop in (([{"k": 1.0}], [1, 6, 5, 0]), ("k", "s*(s + 1)*(s + 5)"), (["k"], [1, "6", {"": 5.0}, 0])):
        proved = prove(loop, {"k": (1.0, 40.0)})
        assert (proved.stable, proved.stable_ranges) == (False, ((1.0, 30.0),))
        assert proved.unstable_member["k"] >= 30
        assert check(proved.certificate).valid
    inside = prove(("k", "s*(s + 1)*(s + 5)"), {"k": (1.0, 10.0)}, claims={"peak_sensitivity": 2.8})
    assert inside.yes
    assert inside.peak_sensitivity == pytest.approx(prove(LOOPS["servo"]).peak_sensitivity[1], rel=2e-4)
    assert inside.peak_sensitivity >= prove(LOOPS["servo"]).peak_sensitivity[0]
    assert check(inside.certificate).valid
    assert prove(("k", "s*(s + 1)*(s + 5)"), {"k": (1.0, 10.0)}, claims={"peak_sensitivity": 2.7}).status == "no"
    # z^2 - 1.7 z + a + 0.2 z: the product of its roots is a, which leaves the unit circle at one.
    sampled = prove(("0.2*z", "z**2 - 1.7*z + a", 0.1), {"a": (0.7, 1.4)})
    assert sampled.stable_ranges == ((0.7, 1.0),)


def test_several_parameters_are_decided_by_pieces():
    """m s^3 + d s^2 + k s + g: Routh, d k > m g; worst at the corner of least d and k, largest m and g."""
    loop, ranges = ("g", "s*(m*s**2 + d*s + k)"), {"m": (0.9, 1.1), "d": (1.0, 1.5), "k": (3.0, 4.0)}
    safe = prove(loop, ranges | {"g": (0.5, 2.7)})
    assert safe.stable is True
    assert check(safe.certificate).valid
    lost = prove(loop, ranges | {"g": (0.5, 2.8)})
    assert (lost.stable, lost.status) == (False, "no")
    member = lost.unstable_member
    assert member["d"] * member["k"] <= member["m"] * member["g"]
    assert check(lost.certificate).valid


def test_a_leaf_that_lies_along_an_axis_has_a_size_for_the_checker_too():
    """At w = 1 the part (s - 1)^2 of this family is -2 j, its real part a ball around zero."""
    loop = (["0.242*a - 0.377", "0.098 - 0.134*b + 0.1*a*b"], [1.0, -0.833, 0.071, 0.043], 0.5)
    proved = prove(loop, {"a": (0.655, 1.393), "b": (0.634, 1.416), "c": (0.644, 1.412)})
    assert proved.yes
    assert check(proved.certificate).valid


def test_a_degree_that_only_seems_lost_refutes_nothing():
    """Written as products of leaves, the leading terms of this one cancel; corners and middles have stable roots."""
    above = ["-0.4 - 0.167*b", "0.077 - 0.858*a", "-0.758 + 0.142*b", "0.197 + 0.545*a", -0.111]
    below = [1.0, 5.63, 11.581, "10.26 - 0.802*b + 0.1*a*b", 3.271]
    ranges = {"a": (0.773, 1.376), "b": (0.548, 1.493)}
    proved = prove((above, below), ranges)
    for a, b in product(*(np.linspace(*ends, 5) for ends in ranges.values())):
        values = [[eval(c, {"a": a, "b": b}) if isinstance(c, str) else c for c in part] for part in (above, below)]
        assert np.max(np.roots(np.add(*values)).real) < 0
    assert proved.stable is True
    assert check(proved.certificate).valid


def test_peak_sensitivity_over_a_box():
    """Proved above what any corner has, and refuted by one of them below it."""
    loop = ("g*(s + 2)", "s*(m*s**2 + d*s + 3)")
    ranges = {"g": (0.1, 0.3), "m": (0.9, 1.1), "d": (1.0, 1.5)}
    corners = [
        prove((f"{g}*(s + 2)", f"s*({m}*s**2 + {d}*s + 3)")).peak_sensitivity[1]
        for g in ranges["g"] for m in ranges["m"] for d in ranges["d"]
    ]  # fmt: skip
    worst = max(corners)
    kept = prove(loop, ranges, claims={"peak_sensitivity": round(1.1 * worst, 3)})
    assert (kept.stable, kept.claims) == (True, {"peak_sensitivity": True})
    lost = prove(loop, ranges, claims={"peak_sensitivity": round(0.98 * worst, 3)})
    assert (lost.stable, lost.status, lost.claims) == (True, "no", {"peak_sensitivity": False})


@pytest.mark.parametrize(("lead", "stable"), [("2.9", True), ("-2.9", False)])
def test_a_coefficient_without_s_that_stands_alone_is_proved_too(lead: str, stable: bool):
    """The pole is -(7.97 + lead k) / (k^2 + 2.65), below zero up to k = 2.748 with -2.9: it ended in a traceback."""
    found = prove(("7.97 + (0.73 + k*k)*s", f"{lead}*k + 1.92*s"), {"k": (1.678, 2.765)})
    assert found.stable is stable
    assert check(found.certificate).valid


def test_parameters_that_are_not_positive_are_proved_too():
    found = prove(
        ("k", "s**2 + 2*s + 1"),
        {
            "k": (-0.5, 3.0),
        },
    )
    assert found.yes
    two = prove(("k", "s**2 + d*s + 1"), {"k": (-0.5, 3.0), "d": (0.1, 1.0)})
    assert two.yes
    assert check(two.certificate).valid
    assert prove(("k", "s**2 + d*s + 1"), {"k": (-0.5, 3.0), "d": (0.0, 1.0)}).stable is False
    # |S| at rest is 1 / (1 + k), two at the least k; the resonance of the least damping has more.
    claims = [prove(("k", "s**2 + d*s + 1"), {"k": (-0.5, 1.0), "d": (1.0, 2.0)}, claims={"peak_sensitivity": limit})
              for limit in (2.1, 1.9)]  # fmt: skip
    assert [claim.claims["peak_sensitivity"] for claim in claims] == [True, False]


def test_what_cannot_be_decided_says_so():
    """Here |S| < 1; but in a claim of 1.2 the unknown is as large as six, and outweighs what leads far up."""
    found = prove(("g*h*(s + 2)", "s + 1"), {"g": (0.2, 0.3), "h": (0.9, 1.0)}, claims={"peak_sensitivity": 1.2})
    assert (found.stable, found.status, found.claims) == (True, "undecided", {"peak_sensitivity": None})
    assert "infinite frequency" in found.reason
    assert found.middle.peak_sensitivity[1] < 1


def test_what_parameters_cannot_be_is_refused():
    loop = ("k", "s + 1")
    for words, given_loop, ranges in (
        ("empty range", loop, {"k": (2.0, 1.0)}),
        ("expected a pair", loop, {"k": 2.0}),
        ("no name", loop, {"k": (1.0, 2.0), "s": (1.0, 2.0)}),
        ("nothing is called 'q'", ("q", "s + 1"), {"k": (1.0, 2.0)}),
        ("only numbers can be divided by", ("1/k", "s + 1"), {"k": (1.0, 2.0)}),
        ("more zeros", ("k*s**2", "s + 1"), {"k": (1.0, 2.0)}),
        ("the denominator is zero", ("k", "0"), {"k": (1.0, 2.0)}),
        ("whose coefficients they stand in", LOOPS["servo"], {"k": (1.0, 2.0)}),
    ):
        with pytest.raises(InputError, match=words):
            prove(given_loop, ranges)
    with pytest.raises(InputError, match="peak_sensitivity alone"):
        prove(loop, {"k": (1.0, 2.0)}, claims={"disk_margin": 1.0})


def test_a_result_over_parameters_shows_itself():
    found = prove(("k", "s*(s + 1)*(s + 5)"), {"k": (1.0, 10.0)})
    assert repr(found).startswith("<ProvedFamily: yes; peak_sensitivity=2.7")
    assert json.dumps(found.to_dict(), allow_nan=False)
    assert found.rows()[0] == ("k", "1 to 10")


def test_the_example_of_the_page_gives_what_it_says():
    """Every line of it that has a comment."""
    (example,) = re.findall(r"^```python\n(.*?)^```", pages()["proofs"], flags=re.MULTILINE | re.DOTALL)
    names: dict[str, object] = {}
    said = 0
    for node in ast.parse(example).body:
        source = ast.get_source_segment(example, node)
        line = example.splitlines()[node.end_lineno - 1]
        if isinstance(node, ast.Expr):
            said += 1
            assert str(eval(source, names)) == line.partition("  # ")[2]
        else:
            exec(source, names)
    assert said > 4


# Somebody else's rig.


def test_the_servohydraulic_benchmark_survives_as_far_as_its_corners_do(monkeypatch):
    """Roots of corners, with the plant put together from its blocks by python-control."""
    monkeypatch.syspath_prepend(Path(beamdesign.__file__).parents[1] / "studies")
    study = import_module("servohydraulic_benchmark")
    s = control.tf("s")

    def poles(gain: float, sigmas: float, signs: tuple[int, ...]) -> np.ndarray:
        figures = zip(study.FIGURES.items(), signs, strict=True)
        k, a3, beta1, beta2 = (middle + sign * sigmas * sd for (_, (middle, sd)), sign in figures)
        dashpot = 2 * study.DAMPING_RATIO * np.sqrt(study.STIFFNESS_N_per_m * study.MASS_kg)
        specimen = 1 / (study.MASS_kg * s**2 + dashpot * s + k)
        actuator = control.feedback(1 / (s + a3) * specimen, study.A2 * s)
        plant = study.A1B0 / (s**2 + beta1 * s + beta2) * actuator
        return control.poles(control.feedback(control.minreal(plant * gain * (1 + 1 / s), 1e-6, verbose=False), 1))

    corners = [*product((-1, 1), repeat=4)]
    near = study.survival(4.8).scaling
    assert near.verdict.stable
    assert check(near.verdict.certificate).valid
    assert 1.3 < near.proved < near.refuted < 1.4
    assert all(poles(4.8, near.proved, signs).real.max() < 0 for signs in corners)
    assert any(poles(4.8, near.refuted, signs).real.max() > 0 for signs in corners)
    slower = study.survival(4.5).scaling
    assert slower.proved > 1.8 * near.proved
    assert all(poles(4.5, slower.proved, signs).real.max() < 0 for signs in corners)
    gain = study.tuned(0.9, 1.0)
    assert study.keeps(gain)
    assert not study.keeps(gain + 0.02)
