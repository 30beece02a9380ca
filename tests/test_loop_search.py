"""The coarse search and the optimiser's constraints, against brute force, closed forms and exact responses.

Nothing here is a proof; what is proved is tested with the tuner.
"""

from dataclasses import replace
from itertools import count
from math import inf

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from standing_sections import standing

from beamdesign import Prototype
from beamdesign.controllers import KINDS, Lag, Proportional
from beamdesign.controllers.protocol import form_of
from beamdesign.loop import LoopAtMass, loop
from beamdesign.plant.members import family, paper_model
from beamdesign.plant.rigs import FIGURES
from beamdesign.prototype import Payload, Tolerance
from beamdesign.synthesis.law_search import search
from beamdesign.synthesis.law_task import Effort, Search
from beamdesign.synthesis.loop_program import Block, sized_slack
from beamdesign.synthesis.loop_samples import Design, first_miss, samples, slacks_of
from beamdesign.synthesis.rig_spread import Cut, rig_spread
from beamdesign.synthesis.sampled_frequencies import FINE_HZ
from beamdesign.time_limit import within

FREQUENCIES_HZ = np.geomspace(0.1, 400.0, 40)
LAG = Lag(gain_A_per_V=0.12, pole_Hz=1.3, zero_Hz=38.0)


def with_filter(rig: Prototype, filter_Hz: float | None) -> Prototype:
    return rig.but(sensor=rig.sensor.but(filter_Hz=filter_Hz))


def loaded(rig: Prototype, controller: Lag | Proportional, inner: float, outer: float) -> LoopAtMass:
    return loop(rig.but(controller=controller, payload=Payload(inner_end_mass_kg=inner))).at(outer)


def flat(*values: ca.DM) -> np.ndarray:
    return np.concatenate([np.asarray(value).ravel() for value in values])


# Sampled bandwidth.


@given(st.floats(0.2, 4.0), st.floats(0.5, 300.0))
def test_bandwidth_of_a_power_law_is_exact(power, crossing):
    """On logarithmic axes a power law is straight, so that interpolation makes no error."""
    frequency = np.geomspace(0.1, 500.0, 57)
    assert first_miss(frequency, -power * np.log(frequency / crossing)) == pytest.approx(crossing)


def test_bandwidth_is_up_to_the_first_crossing():
    frequency = np.array([1.0, 2.0, 4.0, 8.0])
    assert first_miss(frequency, np.log(2.0 / np.array([1.0, 4.0, 1.0, 4.0]))) == pytest.approx(2**0.5)


def test_bandwidth_outside_of_the_grid():
    frequency = np.array([1.0, 2.0, 4.0])
    assert first_miss(frequency, np.ones(3)) == inf
    assert first_miss(frequency, -np.ones(3)) == 0.0


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
    resonances = FINE_HZ[(FINE_HZ >= 1.0) & (FINE_HZ <= 600.0)]
    assert (resonances[1:] / resonances[:-1]).max() < 1.05


@pytest.mark.parametrize(("gain", "at_full", "at_lower"), [(5.0, True, True), (1e3, False, False), (1e7, True, False)])
def test_a_loop_that_lower_gains_lose_is_settled_where_these_do_not_count(paper: Prototype, gain, at_full, at_lower):
    """L = k (s + 1)^2 / (100 s + 1)^3 is stable below a gain of 8 and far above, by the roots of 1 + L."""
    closed = np.polyadd(np.poly1d([100.0, 1.0]) ** 3, gain * np.poly1d([1.0, 1.0]) ** 2)
    assert (np.roots(closed).real < 0).all() == at_full
    points = samples(paper_model(paper).polynomials(), np.geomspace(1e-4, 1e3, 600), [0.0])
    s = 1j * points.frequency_Hz / 10.0
    law = gain * (s + 1) ** 2 / (100 * s + 1) ** 3 / points.at(0.0)[1]
    for lower, expected in ((False, at_full), (True, at_lower)):
        assert slacks_of(points, paper.goal.but(lower_gains=lower), law, 0.0).settled == expected


# The best gain.


@pytest.mark.parametrize(
    ("kind", "shape", "inner"),
    [("proportional", (), 4.5), ("lag", (1.75, 26.0), 4.5), ("lag", (1.14, 37.5), 1.9), ("lag", (0.1, 5.0), 0.5)],
)
def test_best_gain_is_that_of_a_sweep(paper: Prototype, kind, shape, inner):
    """No stable gain of a fine sweep that keeps the peak on the grid has more bandwidth; responses from exact loops."""
    masses, frequency = np.array([0.0, 3.4, 6.8]), np.geomspace(0.05, 600.0, 300)
    form, breaks = form_of(kind), np.log(shape)
    gain_alone = replace(form, lower=np.append(form.lower[0], breaks), upper=np.append(form.upper[0], breaks))
    members, goal = family(paper).members, paper.goal.but(peak_over_passive=inf)
    alone = Effort(starts=1, candidates=1)
    task = Search(members, goal, (0.0, 6.8), (inner, inner), effort=alone, sections=standing(paper))
    seeds = [Design(gain_alone, np.array([*np.log([gain, *shape]), inner])) for gain in np.geomspace(3e-3, 0.3, 7)]
    best = search(task, [seed for seed in seeds if task.settled(seed)]).proved
    assert best is not None
    unit = [loaded(paper, KINDS[kind].of([1.0, *shape]), inner, float(mass)) for mass in masses]
    returned = np.array([member.loop_response(frequency) for member in unit])
    opened = np.array([member.compliance_response(frequency) for member in unit]) * (1 + returned)

    def judge(gain: float) -> tuple[float, float]:
        sensitivity = np.abs(1 / (1 + gain * returned))
        worst = (np.abs(opened) * sensitivity).max(axis=0)
        return float(sensitivity.max()), first_miss(frequency, np.log(5.71e-8 / worst))

    peak, bandwidth = judge(best.controller.gain_A_per_V)
    assert peak <= 2.0
    assert bandwidth == pytest.approx(best.bandwidth_Hz, rel=5e-3)
    for gain in np.geomspace(1e-4, 10.0, 400):
        peak, swept = judge(float(gain))
        if peak <= 2.0 and swept > bandwidth * (1 + 5e-3):
            rigs = [loaded(paper, KINDS[kind].of([float(gain), *shape]), inner, float(mass)) for mass in masses]
            assert not all(member.stable for member in rigs)


# The optimiser's constraints.

KINDS_OF_LIMIT = ("peak_sensitivity", "compliance")


@pytest.mark.parametrize("filter_Hz", [None, 400.0])
@pytest.mark.parametrize("controller", [LAG, Proportional(gain_A_per_V=0.02)], ids=lambda record: record.kind)
def test_slacks_are_those_of_the_exact_loop(paper: Prototype, controller, filter_Hz):
    rig = with_filter(paper, filter_Hz)
    figures = list(paper_model(rig).figures.values())
    form, logarithms = controller.form()
    table = form.coefficients(logarithms)[0]
    slacks = [sized_slack(table.shape, kind, filter_Hz is not None, "twin_beam") for kind in KINDS_OF_LIMIT]
    for outer, inner in ((0.0, 0.0), (6.8, 0.0), (2.0, 4.5)):
        exact = loaded(rig, controller, inner, outer)
        found = np.array(
            [[float(one(ca.vec(table), inner, figures, outer, f)) for one in slacks] for f in FREQUENCIES_HZ]
        )
        np.testing.assert_allclose(found[:, 0], -np.log(np.abs(exact.sensitivity_response(FREQUENCIES_HZ))), atol=1e-9)
        np.testing.assert_allclose(found[:, 1], -np.log(np.abs(exact.compliance_response(FREQUENCIES_HZ))), atol=1e-9)


@pytest.mark.parametrize("frequency_Hz", [0.7, 4.9, 41.0, 130.0])
def test_derivatives_of_slacks_are_those_of_finite_differences(paper: Prototype, frequency_Hz):
    """With respect to logarithms of all figures, of the controller's parameters and of the frequency."""
    rig = with_filter(paper, 300.0)
    figures = np.array([*paper_model(rig).figures.values(), 2.0, 1.5])
    point = np.log([*figures, LAG.gain_A_per_V, LAG.pole_Hz, LAG.zero_Hz, frequency_Hz])
    x = ca.MX.sym("x", len(point))
    n = len(FIGURES)
    lumped, outer, inner = ca.vertsplit(ca.exp(x[:n]), [0, n - 2, n - 1, n])
    table, _ = form_of("lag").coefficients(x[n : n + 3])
    asked = (ca.vec(table), inner, lumped, outer, ca.exp(x[n + 3]))
    slacks = ca.vertcat(*(sized_slack(table.shape, kind, True, "twin_beam")(*asked) for kind in KINDS_OF_LIMIT))
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


def test_sections_that_are_as_they_were_lead_to_the_same_loop(paper: Prototype):
    """The program with a plant in symbols of its figures, and the one with sampled responses, have one optimum."""
    members = family(paper).members
    plain = Search(members, paper.goal, (0.0, 6.8), (0.0, 6.0))
    sized = replace(plain, sections=standing(paper))
    start = [*np.log([0.03, 1.3, 30.0]), 1.5]
    found = [task.refinement(form_of("lag"))(np.array(start)) for task in (plain, sized)]
    assert found[0][1] == pytest.approx(found[1][1], rel=2e-3)
    assert found[0][1] > 4.9  # the README's 4.9 Hz
    np.testing.assert_allclose(found[0][0], found[1][0], atol=0.1)


def test_a_program_ends_between_two_iterations_once_the_time_is_up(paper: Prototype):
    """By a clock that goes on by a minute each time it is asked; of many members a program takes many minutes."""
    refinement = Search(family(paper).members, paper.goal, (0.0, 6.8), (0.0, 6.0)).refinement(form_of("lag"))
    start = np.array([*np.log([0.03, 1.3, 30.0]), 1.5])
    minutes = count()
    with within(5.0, lambda: 60.0 * next(minutes)) as limit:
        found, _ = refinement(start)
    ended = refinement._program[0].stats()
    assert ended["return_status"] == "User_Requested_Stop"
    assert ended["iter_count"] < 5
    assert limit.left_out == ["rounds of refinement"]
    assert refinement.measured(found) is not None


def test_a_rig_whose_mass_inside_is_off_is_sampled_and_refined_with_that_mass(paper: Prototype):
    """Samples, and points of the program in symbols, against the exact loop of a rig with that mass."""
    rig = paper.but(tolerance=Tolerance(inner_end_mass=0.2, flow_gain=0.1))
    spread = rig_spread(rig, 6.8, 2.0)
    assert spread.deviations == {"flow_gain": 0.1, "inner_end_mass": 0.2}
    own = {"flow_gain": 1.1, "inner_end_mass": 1.4}
    task = Search(family(rig).members, rig.goal, (0.0, 6.8), (0.0, 6.0), spread=spread).with_cuts(
        [Cut(tuple(spread.off(own)), 3.0, 20.0)]
    )
    points = task.points
    at = points.row == points.row.max()
    _, control, disturbance, _ = (part[..., at] for part in points.at(2.0))
    valve = rig.servovalve
    assert valve is not None
    faster = rig.but(servovalve=valve.but(flow_gain_m3_per_s_per_A=1.1 * valve.flow_gain_m3_per_s_per_A))
    exact = loaded(faster, Proportional(gain_A_per_V=1.0), 1.4 * 2.0, 3.0)
    frequency = points.frequency_Hz[at]
    np.testing.assert_allclose(control[0], exact.loop_response(frequency), rtol=1e-8)
    opened = exact.compliance_response(frequency) * (1 + exact.loop_response(frequency))
    np.testing.assert_allclose(disturbance, opened, rtol=1e-8)

    form, logarithms = Proportional(gain_A_per_V=1.0).form()
    table, figures = form.coefficients(logarithms)[0], list(paper_model(rig).figures.values())
    sized = replace(task, sections=standing(rig)).refinement(form)
    factors = sized.factors[-1]
    given = ca.DM(np.array([np.full(5, 20.0), np.full(5, 3.0), *np.repeat(factors[:, None], 5, 1)]))
    block = Block(sized_slack(table.shape, "peak_sensitivity", False, "twin_beam"), given, ca.MX(0))
    shared = ca.vertcat(ca.vec(table), 2.0, figures, 0.0)
    value, *_ = block.functions(shared.shape[0], table.numel(), [0])
    expected = -np.log(np.abs(exact.sensitivity_response(np.array([20.0]))[0]))
    np.testing.assert_allclose(flat(value(shared, given)), expected, atol=1e-9)
