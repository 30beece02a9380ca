"""State feedback with an observer: synthesis, reduction, polish, proof, and the limits that no controller passes."""

from dataclasses import replace
from math import pi, sqrt
from pathlib import Path

import numpy as np
import pytest
from convex_limit import convex_limit
from fundamental_limits import bode_bound_Hz, effort_bound_Hz, fundamental_limits, held_force
from loop_effort import effort_response
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from scipy.linalg import solve_continuous_lyapunov
from sensor_value import SensorRow, payload_text, plot_sensor_value
from similar import EIGHTH, similar

from beamdesign import Prototype, certify, read_prototype
from beamdesign.controllers import SENSED, Observer
from beamdesign.controllers.observer import block_form, rounded
from beamdesign.controllers.protocol import Form
from beamdesign.loop import loop, rig_loop
from beamdesign.plant.equilibrium import StateSpace
from beamdesign.plant.members import family
from beamdesign.synthesis.law_task import Effort, Search
from beamdesign.synthesis.loop_samples import LIMITED, form_for, samples, slacks
from beamdesign.synthesis.refinement import LawRefinement
from beamdesign.synthesis.synthesis import (
    GeneralisedPlant,
    Weights,
    hinf,
    least_norm,
    lqg,
    realised,
    residualised,
    scaled_plant,
    sensed_model,
    weighted,
)
from beamdesign.synthesis.weight_search import WeightSearch, search_observer

PROTOTYPES = Path(__file__).parents[1] / "studies" / "prototypes"


@pytest.fixture(scope="module")
def shipped() -> Prototype:
    """The structured controller that is shipped, proved to 16.4 Hz for 0 to 6.8 kg."""
    return read_prototype(PROTOTYPES / "structured.toml")


def law_with(sensors: int) -> tuple[Form, np.ndarray]:
    """Some law of two blocks that steadies nothing in particular, with 1.2 kg inside."""
    random = np.random.default_rng(3)
    pole = 60.0 * np.array([[0.0, 1.0], [-1.0, -1.4]])
    a = np.block([[pole, np.zeros((2, 2))], [np.zeros((2, 2)), 10 * pole]])
    units = np.array([4e-3, 20.0, 1e-9])[:sensors]
    b, c, d = random.normal(size=(4, sensors)) * units * [[60], [60], [600], [600]], np.ones((1, 4)), units[None] / 2
    opened = block_form(SENSED[:sensors], a, b, c, d)
    assert opened is not None
    return opened[0], np.append(opened[1], 1.2)


def test_gains_of_the_regulator_without_margins() -> None:
    """J. C. Doyle, Guaranteed margins for LQG regulators, IEEE Transactions on Automatic Control 23, 1978."""
    weight, noise = 60.0, 30.0
    ones = np.ones((2, 1))
    plant = GeneralisedPlant(
        a=np.array([[1.0, 1.0], [0.0, 1.0]]),
        b1=np.hstack([sqrt(noise) * ones, np.zeros((2, 1))]),
        b2=np.array([[0.0], [1.0]]),
        c1=np.vstack([sqrt(weight) * ones.T, np.zeros((1, 2))]),
        c2=np.array([[1.0, 0.0]]),
        d12=np.array([[0.0], [1.0]]),
        d21=np.array([[0.0, 1.0]]),
    )
    law = lqg(plant)
    np.testing.assert_allclose(-law.c, (2 + sqrt(4 + weight)) * ones.T, rtol=1e-9)
    np.testing.assert_allclose(law.b, (2 + sqrt(4 + noise)) * ones, rtol=1e-9)
    assert closed(plant, law).stable


def closed(plant: GeneralisedPlant, law: StateSpace) -> StateSpace:
    """From w to z with u = law y."""
    a = np.block([[plant.a + plant.b2 @ law.d @ plant.c2, plant.b2 @ law.c], [law.b @ plant.c2, law.a]])
    b = np.vstack([plant.b1 + plant.b2 @ law.d @ plant.d21, law.b @ plant.d21])
    c = np.hstack([plant.c1 + plant.d12 @ law.d @ plant.c2, plant.d12 @ law.c])
    return StateSpace(a, b, c, plant.d12 @ law.d @ plant.d21)


def test_gain_of_a_scalar_regulator() -> None:
    a, b, q, r = 0.7, 2.0, 3.0, 0.4
    plant = replace(scalar(a), b2=np.array([[b]]), c1=np.array([[sqrt(q)], [0.0]]), d12=np.array([[0.0], [sqrt(r)]]))
    assert -lqg(plant).c[0, 0] == pytest.approx((a + sqrt(a**2 + b**2 * q / r)) / b, rel=1e-12)


def scalar(a: float) -> GeneralisedPlant:
    """x' = a x + w1 + u, z = (x, u), y = x + w2."""
    return GeneralisedPlant(
        a=np.array([[a]]),
        b1=np.array([[1.0, 0.0]]),
        b2=np.array([[1.0]]),
        c1=np.array([[1.0], [0.0]]),
        c2=np.array([[1.0]]),
        d12=np.array([[0.0], [1.0]]),
        d21=np.array([[0.0, 1.0]]),
    )


@pytest.mark.parametrize("a", [-1.0, 0.5])
def test_least_norm_of_a_scalar_plant(a: float) -> None:
    """Both Riccati equations of J. C. Doyle, K. Glover, P. Khargonekar and B. Francis (IEEE TAC 34, 1989) are
    2 a X + X^2 (1/g^2 - 1) + 1 = 0 here, and X Y = g^2 at the optimum: g = a + sqrt(a^2 + 2)."""
    optimum = a + sqrt(a**2 + 2)
    loop = closed(scalar(a), hinf(scalar(a)))
    assert least_norm(scalar(a)) == pytest.approx(optimum, rel=1e-5)
    assert loop.stable
    norm = np.linalg.norm(loop.at(1j * np.linspace(0, 30, 6001)), 2, axis=(1, 2)).max()
    assert optimum * (1 - 1e-5) <= norm <= 1.06 * optimum


def test_residualised_controller_is_within_its_bound() -> None:
    random = np.random.default_rng(7)
    a = random.normal(size=(7, 7))
    a -= (np.linalg.eigvals(a).real.max() + 0.2) * np.eye(7)
    whole = StateSpace(a, random.normal(size=(7, 2)), random.normal(size=(1, 7)), np.zeros((1, 2)))
    s = 1j * np.append(0.0, np.geomspace(1e-2, 1e3, 400))
    gramians = (solve_continuous_lyapunov(m, -n @ n.T) for m, n in ((a, whole.b), (a.T, whole.c.T)))
    hankel = np.sort(np.sqrt(np.linalg.eigvals(np.matmul(*gramians)).real))[::-1]
    for order in (5, 3):
        reduced = residualised(whole, order)
        error = np.linalg.norm(whole.at(s) - reduced.at(s), 2, axis=(1, 2))
        bound = 2 * hankel[order:].sum()
        assert len(reduced.a) == order
        assert error[0] < 1e-9
        assert bound / 50 < error.max() <= bound
    balanced = residualised(whole, 7)
    np.testing.assert_allclose(balanced.at(s), whole.at(s), rtol=1e-8, atol=1e-10)


def test_weighted_plant_and_its_controller_in_physical_units(shipped: Prototype) -> None:
    """The regulator in SI steadies the rig itself, built from its own matrices, and the units cancel."""
    rig = family(shipped).rest.rig
    plant = sensed_model(rig, 3.4, 1.8, SENSED)
    scaled = scaled_plant(plant, shipped.goal.compliance_m_per_N)
    weights = Weights(1.0, 0.5, 6.0, 10.0, 1.0, 0.5, 0.5, 1.0)
    general = weighted(scaled, weights)
    law = realised(scaled, weights, lqg(general), 16)
    loop_matrix = np.block(
        [
            [plant.a - plant.b[:, 1:] @ law.d @ plant.c[1:], plant.b[:, 1:] @ law.c],
            [-law.b @ plant.c[1:], law.a],
        ]
    )
    slowest = np.linalg.eigvals(loop_matrix).real.max()
    designed = np.linalg.eigvals(closed(general, lqg(general)).a).real
    assert slowest == pytest.approx(designed.max() / 0.01, rel=1e-5)
    assert slowest < 0


@pytest.mark.parametrize("effects", [{}, {"second_beam_mode": {"frequency_Hz": 327.0}}])
def test_samples_against_the_exact_loop(shipped: Prototype, effects: dict[str, dict[str, float]]) -> None:
    """All limits at sampled points with three sensors, against the exact polynomials that are proved."""
    rig = family(shipped.but(effects=effects), 6.8).rest.rig
    form, variables = law_with(3)
    frequency = np.array([0.7, 6.0, 31.0, 90.0, 260.0])
    points = samples(rig.polynomials(SENSED), frequency, [3.4])
    left = slacks(points, shipped.goal, form, variables, slopes=False)
    exact = rig_loop(rig, 1.2, form.record(variables[:-1])).at(3.4)
    goal = shipped.goal
    expected = {
        "peak_sensitivity": np.log(goal.peak_sensitivity / np.abs(exact.sensitivity_response(frequency))),
        "compliance": np.log(goal.compliance_m_per_N / np.abs(exact.compliance_response(frequency))),
        "controller_effort": np.log((goal.controller_effort_A_per_V or 1) / np.abs(effort_response(exact, frequency))),
    }
    found = dict(zip(LIMITED, left.values, strict=True))
    for kind, values in expected.items():
        np.testing.assert_allclose(found[kind], values, atol=1e-7)
    assert found["loop_gain"][-1] == pytest.approx(
        np.log((goal.loop_gain or 1) / abs(exact.loop_response(frequency)[-1])), abs=1e-7
    )
    assert np.isinf(found["loop_gain"][:-1]).all()


def test_slopes_of_the_samples_against_differences(shipped: Prototype) -> None:
    rig = family(shipped).rest.rig
    points = samples(rig.polynomials(SENSED), np.array([2.0, 40.0, 300.0]), [0.0, 6.8])
    form, variables = law_with(3)
    left = slacks(points, shipped.goal, form, variables)
    step = 1e-6
    for k, unit in enumerate(np.eye(len(variables))):
        up, down = (
            slacks(points, shipped.goal, form, variables + side * step * unit, slopes=False) for side in (1, -1)
        )
        for kind, slope in enumerate(left.slopes):
            finite = np.isfinite(left.values[kind])
            measured = (up.values[kind][finite] - down.values[kind][finite]) / (2 * step)
            np.testing.assert_allclose(slope[finite, k], measured, atol=2e-7, rtol=1e-6)


def test_block_form_keeps_a_controller(shipped: Prototype) -> None:
    """Through the record, then in blocks: the responses of the shipped lag with three sections stay what they are."""
    law = shipped.controller
    assert law is not None
    model = law.control_model()
    opened = block_form(SENSED[:1], model.A, model.B, model.C, model.D, 4)
    assert opened is not None
    form, variables = opened
    record, s = form.record(variables), 2j * pi * np.geomspace(0.1, 1e4, 60)
    np.testing.assert_allclose(form.responses(variables, s)[0], np.squeeze(model(s)), rtol=1e-6)
    np.testing.assert_allclose(np.squeeze(record.control_model()(s)), np.squeeze(model(s)), rtol=1e-6)
    guaranteed = certify(shipped.but(controller=record, guarantee=None), 0.0, 6.8).guaranteed
    assert guaranteed is not None
    assert guaranteed.bandwidth_Hz == pytest.approx(16.4459, abs=2e-4)


def test_a_law_that_is_tuned_further_begins_where_it_stands() -> None:
    """A lone real pole beside a pair, two sensors and a gain; a law that is not stable has no such form."""
    a = np.array([[-30.0, 200.0, 0.0], [-200.0, -30.0, 0.0], [0.0, 1.0, -11.0]])
    b, c, d = np.array([[3.0, 1e-6], [0.5, -2e-6], [0.0, 4e-6]]), np.array([20.0, -7.0, 5.0]), np.array([0.1, 3e-8])
    heard = ("displacement_m", "load_pressure_Pa")
    opened = Observer.of(0.2, heard, a, b, c, d).form()
    assert opened is not None
    s = 2j * pi * np.geomspace(0.1, 1e3, 40)
    expected = [0.2 * (c @ np.linalg.solve(one * np.eye(3) - a, b) + d) for one in s]
    np.testing.assert_allclose(opened[0].responses(opened[1], s).T, expected, rtol=1e-7)
    assert Observer.of(0.2, heard, -a, b, c, d).form() is None


def test_bode_integral_of_the_shipped_loop(shipped: Prototype) -> None:
    """No open loop pole is unstable and L falls off fast enough: the integral of ln |S| vanishes (H. W. Bode, 1945)."""
    grid = np.geomspace(1e-4, 1e6, 40_000)
    for mass in (0.0, 6.8):
        value = np.log(np.abs(loop(shipped).at(mass).sensitivity_response(grid)))
        whole = value[0] * grid[0] + np.trapezoid(value, grid)
        assert abs(whole) < 2e-4 * np.trapezoid(np.abs(value), grid)


def test_no_limit_is_below_what_is_proved(shipped: Prototype) -> None:
    """A proved loop refutes any bound below it; the mass of the inner tip is that of the loop."""
    masses = (0.0, 3.4, 6.8)
    found = fundamental_limits(shipped, masses)
    assert 16.4 < found.bandwidth_Hz < 60
    assert found.noise_m is not None
    assert (np.diff(found.noise_m, axis=1) >= 0).all()
    # The current per newton that the shipped loop takes, against the least that any loop takes.
    frequency = np.array([1.0, 8.0, 16.0])
    for mass in masses:
        closed = loop(shipped).at(mass)
        plant = sensed_model(family(shipped).rest.rig, mass, shipped.payload.inner_end_mass_kg)
        volts = plant.at(2j * pi * frequency)[:, 1, 0]
        taken = np.abs(effort_response(closed, frequency) * volts)
        least = 0.015 / held_force(plant, shipped.goal, 0.015, frequency)
        assert (taken >= least).all()
        assert (taken < 1.1 * least).all()


def test_limits_tighten_with_the_goal(shipped: Prototype) -> None:
    """A larger peak leaves more room, a limit of effort that holds nothing leaves none, none at all leaves any."""
    plant = sensed_model(family(shipped).rest.rig, 0.0, 1.8)
    at = [bode_bound_Hz(plant, shipped.goal.but(peak_sensitivity=peak)) for peak in (1.5, 2.0, 3.0)]
    assert at[0] < at[1] < at[2]
    assert effort_bound_Hz(plant, shipped.goal.but(controller_effort_A_per_V=1e-6)) == 0.0
    assert bode_bound_Hz(plant, shipped.goal.but(controller_effort_A_per_V=None)) == np.inf


def test_convex_limit_stands_between_the_designs_and_bode(shipped: Prototype) -> None:
    """A design that is proved refutes a limit below it, Bode's bound one above; a looser goal is reached further."""
    plant = sensed_model(family(shipped).rest.rig, 0.0, 0.0)
    found = convex_limit(plant, shipped.goal, 25.65, 40.0)
    assert found.functions == 68
    assert 25.65 < found.bandwidth_Hz < bode_bound_Hz(plant, shipped.goal)
    further = 1.05 * found.bandwidth_Hz
    looser = shipped.goal.but(peak_sensitivity=3.0)
    assert convex_limit(plant, shipped.goal, further, 1.01 * further).bandwidth_Hz == 0.0
    assert convex_limit(plant, looser, further, 1.01 * further).bandwidth_Hz > 0
    assert convex_limit(plant, shipped.goal.but(controller_effort_A_per_V=1e-6)).bandwidth_Hz == 0.0


def test_second_mode_is_found_and_costs_gain(shipped: Prototype) -> None:
    mode = shipped.but(effects={"second_beam_mode": {"frequency_Hz": 327.0, "damping_ratio": 0.02}})
    found = fundamental_limits(mode, (0.0, 6.8))
    assert found.mode_Hz is not None
    assert found.mode_gain is not None
    assert all(200 < frequency < 327 for frequency in found.mode_Hz)
    assert found.mode_Hz[0] > found.mode_Hz[1]  # a payload slows it
    assert all(gain > 1 for gain in found.mode_gain)


def test_polish_does_not_lose_what_it_starts_from(shipped: Prototype) -> None:
    """From a lag of a small gain: more bandwidth, within all limits on the samples."""
    plant = family(shipped).rest.rig.polynomials()
    points = samples(plant, np.geomspace(0.1, 1000.0, 120), [0.0])
    a, b, c = np.diag([-20.0, -900.0]), np.array([[20.0], [9.0]]), np.array([[0.02, 0.02]])
    opened = block_form(SENSED[:1], a, b, c, np.zeros((1, 1)))
    assert opened is not None
    form, start = opened[0], np.append(opened[1], 0.0)
    polish = LawRefinement(
        points, shipped.goal, form, (0.0, 6.0), [(plant, 1.0, [0.0], True, np.ones(0))], 1, np.ones((1, 0))
    )
    better, bandwidth = polish(start, rounds=2)
    assert polish.measured(better).violation() < 5e-3
    assert bandwidth >= polish(start, rounds=0)[1]


TINY = Effort(
    steps=12,
    rounds=1,
    starts=1,
    weights=16,
    evaluations=12,
    synthesised=1,
    blocks=2,
    proofs=4,
)


def test_tiny_tune_is_proved(shipped: Prototype) -> None:
    """With the pressure as well, at one payload, from few weights: proved by the same oracle as any record.

    At first its peaks of loop gain stand between the samples, near 540 Hz.
    """
    goal = shipped.goal.but(compliance_m_per_N=3.1e-7)
    task = Search(family(shipped).members, goal, (0.0, 0.0), (0.0, 2.0), (SENSED[0], SENSED[2]), effort=TINY)
    found = search_observer(task, "lqg")
    assert found.proved is not None, found.reason
    tuned = shipped.but(
        controller=found.proved.controller,
        goal=goal,
        payload=shipped.payload.but(inner_end_mass_kg=found.proved.inner_end_mass_kg),
        guarantee=None,
    )
    guaranteed = certify(tuned, 0.0, 0.0).guaranteed
    assert guaranteed is not None
    assert guaranteed.bandwidth_Hz == pytest.approx(found.proved.bandwidth_Hz, rel=1e-6)
    assert guaranteed.peak_sensitivity <= 2.0
    assert guaranteed.loop_gain is not None
    assert guaranteed.loop_gain <= 0.25


def test_weights_mean_as_much_on_a_similar_rig(shipped: Prototype) -> None:
    """By dimensional analysis; they were in units of 100 rad/s and of a kilogram whatever the rig."""
    (mass, _, time), found = EIGHTH, []
    for rig, heavy, slow in ((shipped, 1.0, 1.0), (similar(shipped, EIGHTH), mass, time)):
        sensors = (SENSED[0], SENSED[2])
        search = WeightSearch(
            Search(family(rig).members, rig.goal, (0.0, 0.0), (0.0, 2.0 * heavy), sensors, effort=TINY)
        )
        best = search.improved(search.sampled(8)[0], lqg, 12)
        poles = np.sort_complex(np.linalg.eigvals(best.law.a)) * slow
        found.append([best.cost, best.inner_end_mass / heavy, *poles])
    np.testing.assert_allclose(found[1], found[0], rtol=1e-6)


def test_a_law_of_a_quicker_rig_is_sought_among_quicker_ones(shipped: Prototype) -> None:
    """A block that does nothing yet, and the bounds of all of them, go with the rig's natural frequency."""
    law, quick = (np.array([[-20.0]]), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1))), similar(shipped, EIGHTH)
    poles, least = [], []
    for rig, pace in ((shipped, 1.0), (quick, 8.0)):
        opened = block_form(SENSED[:1], pace * law[0], pace * law[1], *law[2:], blocks=3, pace=pace)
        assert opened is not None
        form = form_for(opened[0], family(rig).rest.rig.figures)
        a, *_ = form.record(opened[1]).state_space()
        poles.append(np.sort_complex(np.linalg.eigvals(a)) / pace)
        least.append(np.exp(form.lower[:2]))
    np.testing.assert_allclose(poles[1], poles[0], rtol=1e-6)
    np.testing.assert_allclose(least[1] / least[0], [8.0, 1.0], rtol=1e-12)


def test_ranges_of_gain_with_added_sensors_are_refused(shipped: Prototype) -> None:
    saturating = shipped.but(effects={"current_saturation": {"limit_A": 0.015}})
    task = Search(family(saturating, 6.8).members, shipped.goal, (0.0, 6.8), (0.0, 2.0), SENSED, effort=TINY)
    found = search_observer(task, "lqg")
    assert found.proved is None
    assert "range of gains" in found.reason


def test_rounding_keeps_nine_digits() -> None:
    np.testing.assert_array_equal(rounded(np.array([pi * 1e3, -1 / 3])), [3141.59265, -0.333333333])


def test_picture_of_what_sensors_buy(shipped: Prototype) -> None:
    """A bar for every set of sensors and payload, as high as what was proved; the bound of each payload beside."""
    rows = [
        SensorRow(sensors, payload, found)
        for payload in ((0.0, 6.8), (6.8, 6.8))
        for sensors, found in ((SENSED[:1], 16.4), (SENSED, 0.0))
    ]
    limits = fundamental_limits(shipped, (0.0, 6.8))
    figure = plot_sensor_value(Figure(), rows, ((47.0, 30.0), (48.0, 31.0)), limits)
    heights = sorted(patch.get_bbox().height for patch in figure.axes[0].patches if isinstance(patch, Rectangle))
    assert heights == pytest.approx([0.0, 0.0, 16.4, 16.4])
    assert [text.get_text() for text in figure.axes[0].get_xticklabels()] == [
        "displacement",
        "displacement\n+ inner tip\n+ pressure",
    ]
    assert payload_text((0.0, 6.8)) == "0 to 6.8 kg"
    assert payload_text((6.8, 6.8)) == "6.8 kg, known"
