"""The coarse search and the optimiser's constraints, against brute force, closed forms and exact responses.

Also the starts that the search proposes. Nothing here is a proof; what is proved is tested with the tuner.
"""

from itertools import pairwise
from math import log

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from beamdesign.controllers import KINDS, Lag, Proportional
from beamdesign.controllers.form import form_of
from beamdesign.loop import LoopAtMass, loop
from beamdesign.plant.beams_rig import FIGURES
from beamdesign.plant.members import paper_model
from beamdesign.prototype import Payload, Prototype
from beamdesign.synthesis.loop_limits import loop_slack
from beamdesign.synthesis.loop_samples import samples
from beamdesign.synthesis.refinement import check_points, guarantee, with_peak, with_share
from beamdesign.synthesis.starts import (
    SEARCH_FREQUENCIES_HZ,
    best_gain,
    feasible_gain_ends,
    sampled_bandwidth,
)

FREQUENCIES_HZ = np.geomspace(0.1, 400.0, 40)
LAG = Lag(gain_A_per_V=0.12, pole_Hz=1.3, zero_Hz=38.0)


def with_filter(rig: Prototype, filter_Hz: float | None) -> Prototype:
    return rig.but(sensor=rig.sensor.but(filter_Hz=filter_Hz))


def loaded(rig: Prototype, controller: Lag | Proportional, inner: float, outer: float) -> LoopAtMass:
    return loop(rig.but(controller=controller, payload=Payload(inner_end_mass_kg=inner))).at(outer)


def flat(*values: ca.DM) -> np.ndarray:
    return np.concatenate([np.asarray(value).ravel() for value in values])


# Feasible gains.

per_gains = st.lists(
    st.tuples(st.floats(-3, 3), st.floats(-3, 3)).filter(lambda z: abs(complex(*z)) > 0.01), min_size=1, max_size=8
).map(lambda pairs: np.array([complex(*pair) for pair in pairs]))


@given(per_gains, st.floats(1.05, 5.0))
def test_gain_ends_are_those_of_brute_force(per_gain, peak):
    """Between neighbouring roots of |1 + K l| = 1/Ms the verdict is constant; an end is where yes turns into no."""
    edges = np.unique(
        [
            root.real
            for value in per_gain
            for root in np.roots([abs(value) ** 2, 2 * value.real, 1 - peak**-2])
            if abs(root.imag) < 1e-12 and root.real > 0
        ]
    )
    assume(np.all(np.diff(edges) > 1e-6 * edges[1:]) if len(edges) > 1 else True)

    def allowed(gain: float) -> bool:
        return bool(np.all(np.abs(1 + gain * per_gain) * peak > 1))

    between = [0.0, *edges, 2 * edges[-1] + 1] if len(edges) else [0.0, 1.0]
    verdicts = [allowed((left + right) / 2) for left, right in pairwise(between)]
    expected = [edge for edge, (left, right) in zip(edges, pairwise(verdicts), strict=True) if left and not right]
    np.testing.assert_allclose(feasible_gain_ends(per_gain, peak), expected, rtol=1e-9)


def test_a_loop_on_the_right_allows_every_gain():
    assert len(feasible_gain_ends(np.array([1.0 + 1j, 0.5]), 1.5)) == 0


def test_gain_ends_of_one_real_sample():
    """|1 - K| >= 1/2 forbids the gains from 0.5 to 1.5."""
    np.testing.assert_allclose(feasible_gain_ends(np.array([-1.0 + 0j]), 2.0), [0.5])


def test_overlapping_gaps_have_one_end():
    """Gaps of -1 and -0.5 at Ms = 2 are (0.5, 1.5) and (1, 3): together they end the gains at 0.5 only."""
    np.testing.assert_allclose(feasible_gain_ends(np.array([-0.5 + 0j, -1.0]), 2.0), [0.5])


def test_separate_gaps_leave_gains_between_them():
    np.testing.assert_allclose(feasible_gain_ends(np.array([-0.1 + 0j, -1.0]), 2.0), [0.5, 5.0])


# Sampled bandwidth.


@given(st.floats(0.2, 4.0), st.floats(0.5, 300.0))
def test_bandwidth_of_a_power_law_is_exact(power, crossing):
    """On logarithmic axes a power law is straight, so that interpolation makes no error."""
    frequency = np.geomspace(0.1, 500.0, 57)
    assert sampled_bandwidth(frequency, 1e-8 * (frequency / crossing) ** power, 1e-8) == pytest.approx(crossing)


def test_bandwidth_is_up_to_the_first_crossing():
    frequency = np.array([1.0, 2.0, 4.0, 8.0])
    assert sampled_bandwidth(frequency, np.array([1.0, 4.0, 1.0, 4.0]), 2.0) == pytest.approx(2**0.5)


def test_bandwidth_outside_of_the_grid():
    frequency = np.array([1.0, 2.0, 4.0])
    assert sampled_bandwidth(frequency, np.array([1.0, 1.0, 1.0]), 2.0) == 4.0
    # Too large from the first sample on: as if it grew in proportion to the frequency.
    assert sampled_bandwidth(frequency, np.array([4.0, 8.0, 16.0]), 2.0) == pytest.approx(0.5)


# The plant on the grid.


@pytest.mark.parametrize("filter_Hz", [None, 400.0])
@pytest.mark.parametrize("masses", [(0.0, 0.0), (6.8, 0.0), (0.0, 4.5), (3.7, 1.9), (500.0, 60.0)])
def test_sampled_plant_is_bilinear_in_the_masses_and_exact(paper: Prototype, filter_Hz, masses):
    rig, (outer, inner) = with_filter(paper, filter_Hz), masses
    _, (control,), disturbance, _ = samples(paper_model(rig).polynomials(), FREQUENCIES_HZ, [outer]).at(inner)
    exact = loaded(rig, Proportional(gain_A_per_V=0.01), inner, outer)
    np.testing.assert_allclose(0.01 * control, exact.loop_response(FREQUENCIES_HZ), rtol=1e-8)
    np.testing.assert_allclose(disturbance / (1 + 0.01 * control), exact.compliance_response(FREQUENCIES_HZ), rtol=1e-8)


def test_the_search_grid_is_fine_enough_for_a_mode_with_5_percent_damping():
    steps = SEARCH_FREQUENCIES_HZ[1:] / SEARCH_FREQUENCIES_HZ[:-1]
    assert steps.max() < 1.05


# Best gain.


@pytest.mark.parametrize(
    ("kind", "shape", "inner"),
    [("proportional", (), 0.0), ("lag", (1.75, 26.0), 4.5), ("lag", (1.14, 37.5), 1.9), ("lag", (0.1, 5.0), 0.5)],
)
def test_best_gain_is_that_of_a_sweep(paper: Prototype, kind, shape, inner):
    """No stable gain of a fine sweep that keeps the peak on the grid has more bandwidth; responses from exact loops."""
    masses, frequency = np.array([0.0, 3.4, 6.8]), np.geomspace(0.05, 600.0, 300)
    points = samples(paper_model(paper).polynomials(), frequency, masses)
    best = best_gain(points, form_of(kind), shape, inner, 2.0, 5.71e-8)
    assert best.gain > 0
    unit = [loaded(paper, KINDS[kind].of([1.0, *shape]), inner, float(mass)) for mass in masses]
    returned = np.array([member.loop_response(frequency) for member in unit])
    opened = np.array([member.compliance_response(frequency) for member in unit]) * (1 + returned)

    def judge(gain: float) -> tuple[float, float]:
        sensitivity = np.abs(1 / (1 + gain * returned))
        worst = (np.abs(opened) * sensitivity).max(axis=0)
        return float(sensitivity.max()), sampled_bandwidth(frequency, worst, 5.71e-8)

    peak, bandwidth = judge(best.gain)
    assert peak == pytest.approx(2.0, rel=1e-6)
    assert bandwidth == pytest.approx(best.bandwidth_Hz, rel=1e-6)
    for gain in np.geomspace(1e-4, 10.0, 400):
        peak, swept = judge(float(gain))
        if peak <= 2.0 and swept > bandwidth * (1 + 1e-9):
            rigs = [loaded(paper, KINDS[kind].of([float(gain), *shape]), inner, float(mass)) for mass in masses]
            assert not all(member.stable for member in rigs)


def test_no_gain_is_no_candidate(paper: Prototype):
    """Where no sample lies left of the imaginary axis, no gain is limited and none is proposed."""
    points = samples(paper_model(paper).polynomials(), np.array([1e-4, 2e-4]), [0.0])
    best = best_gain(points, form_of("proportional"), (), 0.0, 2.0, 5.71e-8)
    assert (best.gain, best.bandwidth_Hz) == (0.0, 0.0)


# The optimiser's constraints.


@pytest.mark.parametrize("filter_Hz", [None, 400.0])
@pytest.mark.parametrize("controller", [LAG, Proportional(gain_A_per_V=0.02)], ids=lambda record: record.kind)
def test_slacks_are_those_of_the_exact_loop(paper: Prototype, controller, filter_Hz):
    rig = with_filter(paper, filter_Hz)
    figures = list(paper_model(rig).figures.values())
    form, logarithms = controller.form()
    slacks = [loop_slack(form, filter_Hz is not None, kind) for kind in ("peak_sensitivity", "compliance")]
    for outer, inner in ((0.0, 0.0), (6.8, 0.0), (2.0, 4.5)):
        exact = loaded(rig, controller, inner, outer)
        found = np.array(
            [[float(one([*figures, outer, inner], logarithms, f)) for one in slacks] for f in FREQUENCIES_HZ]
        )
        np.testing.assert_allclose(found[:, 0], -np.log(np.abs(exact.sensitivity_response(FREQUENCIES_HZ))), atol=1e-9)
        np.testing.assert_allclose(found[:, 1], -np.log(np.abs(exact.compliance_response(FREQUENCIES_HZ))), atol=1e-9)


@pytest.mark.parametrize("frequency_Hz", [0.7, 4.9, 41.0, 130.0])
def test_derivatives_of_slacks_are_those_of_finite_differences(paper: Prototype, frequency_Hz):
    """With respect to logarithms of all figures, of the controller's parameters and of the frequency."""
    rig = with_filter(paper, 300.0)
    figures = np.array([*paper_model(rig).figures.values(), 2.0, 1.5])
    point = np.log([*figures, LAG.gain_A_per_V, LAG.pole_Hz, LAG.zero_Hz, frequency_Hz])
    x = ca.SX.sym("x", len(point))
    n = len(FIGURES)
    asked = (ca.exp(x[:n]), x[n : n + 3], ca.exp(x[n + 3]))
    slacks = ca.vertcat(
        *(loop_slack(form_of("lag"), True, kind)(*asked) for kind in ("peak_sensitivity", "compliance"))
    )
    value = ca.Function("value", [x], [slacks])
    analytic = np.asarray(ca.Function("jacobian", [x], [ca.jacobian(slacks, x)])(point))
    step = 1e-5
    numeric = np.column_stack(
        [
            (flat(value(point + step * unit)) - flat(value(point - step * unit))) / (2 * step)
            for unit in np.eye(len(point))
        ]
    )
    np.testing.assert_allclose(analytic, numeric, rtol=1e-5, atol=1e-6)


def test_constraints_at_points_are_slacks_one_by_one(paper: Prototype):
    """Sensitivity points count in Hz, compliance points in shares of the bandwidth."""
    figures = list(paper_model(paper).figures.values())
    points = with_share(check_points(0.0, 6.8, paper.goal, frequencies=4), 0.3, np.array([3.4]))
    logarithms, log_bandwidth = np.log([0.12, 1.3, 38.0]), log(5.0)
    at = (ca.MX(ca.DM(figures)), ca.MX(1.9), ca.MX(ca.DM(logarithms)))
    assert list(points) == ["peak_sensitivity", "compliance"]
    for (kind, listed), unit in zip(points.items(), (1.0, np.exp(log_bandwidth)), strict=True):
        slack = loop_slack(form_of("lag"), False, kind)
        found = guarantee(slack, *at, ca.MX(ca.DM(unit * listed[:, 0])), ca.MX(ca.DM(listed[:, 1])))
        expected = [slack([*figures, mass, 1.9], logarithms, unit * f) for f, mass in listed]
        np.testing.assert_allclose(flat(ca.evalf(found)), flat(*expected), rtol=1e-12)


def test_check_points_cover_both_ends_and_grow(paper: Prototype):
    points = check_points(1.0, 6.8, paper.goal)
    sensitivity, compliance = points["peak_sensitivity"], points["compliance"]
    assert set(sensitivity[:, 1]) == set(compliance[:, 1]) == {1.0, 6.8}
    assert compliance[:, 0].max() == 1.0
    more = with_peak(points, "peak_sensitivity", 42.0, 2.5)
    added = more["peak_sensitivity"][len(sensitivity) :]
    assert len(sensitivity) == len(points["peak_sensitivity"])
    assert np.all(added[:, 1] == 2.5)
    assert added[:, 0].min() < 42.0 < added[:, 0].max()
    assert 42.0 in added[:, 0]
    beyond = with_share(points, 1.2, np.array([2.0, 3.0]))["compliance"][len(compliance) :]
    np.testing.assert_array_equal(beyond, [[1.0, 2.0], [1.0, 3.0]])


def test_a_single_mass_is_checked_once(paper: Prototype):
    points = check_points(3.0, 3.0, paper.goal)["peak_sensitivity"]
    assert len(points) * 2 == len(check_points(0.0, 3.0, paper.goal)["peak_sensitivity"])
