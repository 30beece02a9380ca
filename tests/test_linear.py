"""The linear plant against equations (7) to (18) assembled by hand, closed forms, limits and conservation."""

from math import pi, sqrt

import casadi as ca
import numpy as np
import pytest
from flint import fmpq, fmpq_mat, fmpq_poly
from hypothesis import given, settings
from hypothesis import strategies as st
from paper_descriptor import descriptor, leakage_flow, oil_force
from scipy.linalg import eigh

from beamdesign import InputError, Prototype
from beamdesign.controllers import SENSED
from beamdesign.plant.actuators.servo_cylinder import spool_acceleration
from beamdesign.plant.linear import LinearModel, Plant
from beamdesign.plant.linearised import evaluate_exactly
from beamdesign.plant.members import paper_model
from beamdesign.plant.rigs import FIGURES, beam_force
from beamdesign.polynomial import exact
from beamdesign.prototype import Payload

MASSES = [(0.0, 0.0), (6.8, 4.5)]


def by_hand(f: dict[str, float], outer: float, inner: float) -> tuple[np.ndarray, np.ndarray]:
    """A and B with the paper's states Y1 to Y7, solved for the rates with pencil and paper."""
    mass_m, mass_f = f["outer_mass"] + outer, f["inner_mass"] + inner
    oil, area, valve = f["oil_stiffness"], f["piston_area"], f["valve_frequency"]
    leak = f["leakage"] * oil / area**2
    a = np.zeros((7, 7))
    a[0, 1] = 1
    a[1, [0, 1, 2]] = np.array([-f["outer_stiffness"] - oil, -f["outer_damping"], oil]) / mass_m
    a[2, [0, 2, 4, 5]] = leak, -leak, 1, 1 / area
    a[3, 4] = 1
    a[4, [0, 2, 3, 4]] = np.array([oil, -oil, -f["inner_stiffness"], -f["inner_damping"]]) / mass_f
    a[5, 6] = 1
    a[6, [5, 6]] = -(valve**2), -2 * f["valve_damping_ratio"] * valve
    b = np.zeros((7, 2))
    b[1, 0] = 1 / mass_m
    b[6, 1] = f["flow_gain"] * valve**2
    return a, b


@pytest.mark.parametrize(("outer", "inner"), MASSES)
def test_matrices_are_those_assembled_by_hand(paper: Prototype, outer: float, inner: float):
    rig = paper_model(paper)
    a, b, c = rig.matrices(outer, inner)
    expected_a, expected_b = by_hand(rig.figures, outer, inner)
    np.testing.assert_allclose(a, expected_a, rtol=1e-13)
    np.testing.assert_allclose(b, expected_b, rtol=1e-13)
    np.testing.assert_array_equal(c[:2], [[1, 0, 0, 0, 0, 0, 0], [1180, 0, 0, 0, 0, 0, 0]])


@pytest.mark.parametrize("filter_Hz", [None, 400.0])
@pytest.mark.parametrize(("outer", "inner"), MASSES)
def test_exact_matrices_are_the_float_ones(paper: Prototype, outer: float, inner: float, filter_Hz: float | None):
    rig = paper_model(paper.but(sensor=paper.sensor.but(filter_Hz=filter_Hz)))
    mass, a, b, c = rig.exact_matrices(exact(outer), exact(inner))
    for found, expected in zip((mass.solve(a), mass.solve(b), c), rig.matrices(outer, inner), strict=True):
        np.testing.assert_allclose(np.array(found.tolist(), dtype=float), expected, rtol=1e-14)


def test_rates_match_finite_differences_of_the_components(paper: Prototype):
    """Each column of A is the change of the rates when one state moves, by the components called on numbers."""
    f = paper_model(paper).figures

    def rates(x: np.ndarray, current: float) -> np.ndarray:
        force = oil_force(f["oil_stiffness"], x[2], x[0])
        outer = beam_force(f["outer_stiffness"], f["outer_damping"], x[0], x[1])
        inner = beam_force(f["inner_stiffness"], f["inner_damping"], x[3], x[4])
        flow = x[5] - leakage_flow(f["leakage"], force, f["piston_area"])
        spool = spool_acceleration(f["valve_frequency"], f["valve_damping_ratio"], f["flow_gain"], current, x[5], x[6])
        return np.array([
            x[1], (force - outer) / f["outer_mass"], flow / f["piston_area"] + x[4],
            x[4], (-force - inner) / f["inner_mass"], x[6], spool,
        ])  # fmt: skip

    a, b, _ = paper_model(paper).matrices(0.0, 0.0)
    origin, step = np.zeros(7), 1e-3
    for j, column in enumerate(a.T):
        nudge = step * np.eye(7)[j]
        np.testing.assert_allclose((rates(nudge, 0) - rates(-nudge, 0)) / (2 * step), column, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose((rates(origin, step) - rates(origin, -step)) / (2 * step), b[:, 1], rtol=1e-9)


def test_end_masses_enter_the_mass_matrix_alone_and_with_rank_one(paper: Prototype):
    rig = paper_model(paper)
    bare, outer, inner = (rig.exact_matrices(fmpq(m), fmpq(n)) for m, n in ((0, 0), (3, 0), (0, 3)))
    for loaded in (outer, inner):
        assert (loaded[0] - bare[0]).rank() == 1
        assert all(loaded[i] == bare[i] for i in (1, 2, 3))


@pytest.mark.parametrize("filter_Hz", [None, 400.0])
def test_denominator_is_the_determinant_of_the_pencil(paper: Prototype, filter_Hz: float | None):
    rig = paper_model(paper.but(sensor=paper.sensor.but(filter_Hz=filter_Hz)))
    outer, inner = fmpq(34, 5), fmpq(9, 2)
    mass, a, b, c = rig.exact_matrices(outer, inner)
    plant = rig.plant(4.5)
    determinant = mass.solve(a).charpoly() * mass.det()
    factor = plant.denominator.at(outer)[0] / determinant[0]
    assert plant.denominator.at(outer) == factor * determinant
    # Cramer's rule by another road: det(X + b c) - det(X) = c adj(X) b, for X = sE - A.
    for column, row, numerator in ((0, 0, plant.disturbance), (1, 1, plant.control[0].constant)):
        source = fmpq_mat(b.nrows(), 1, [b[i, column] for i in range(b.nrows())])
        sight = fmpq_mat(1, b.nrows(), [c[row, i] for i in range(b.nrows())])
        assert factor * (mass.solve(a - source * sight).charpoly() * mass.det() - determinant) == numerator


FIGURE = st.floats(0.01, 100.0, allow_nan=False)


@given(st.lists(FIGURE, min_size=16, max_size=16), st.booleans())
@settings(max_examples=25)
def test_plant_is_the_closed_form(values: list[float], filtered: bool):
    """Eliminating by hand: two beams in series with oil, leakage and valve, as polynomials of s."""
    names = [name for name in FIGURES if not name.endswith("end_mass")]
    f = dict(zip(names, values, strict=False))
    outer, inner = values[-2:]
    plant = LinearModel(f, filtered, {}).plant(inner)
    e = {name: exact(value) for name, value in f.items()}
    s = fmpq_poly([0, 1])
    d_m = fmpq_poly([e["outer_stiffness"], e["outer_damping"], e["outer_mass"] + exact(outer)])
    d_f = fmpq_poly([e["inner_stiffness"], e["inner_damping"], e["inner_mass"] + exact(inner)])
    h = fmpq_poly([e["leakage"] / e["piston_area"] ** 2, 1 / e["oil_stiffness"]])
    w = e["valve_frequency"]
    valve = fmpq_poly([w * w, 2 * e["valve_damping_ratio"] * w, 1])
    lag, cut = (s + e["filter_frequency"], e["filter_frequency"]) if filtered else (fmpq_poly([1]), fmpq(1))
    scale = 1 / e["outer_stiffness"] / (h * d_f * valve * lag)[0]
    assert plant.denominator.at(exact(outer)) == scale * (h * d_m * d_f + s * (d_m + d_f)) * valve * lag
    assert plant.disturbance == scale * (h * d_f + s) * valve * lag
    assert plant.control[0].constant == scale * e["sensor_gain"] * e["flow_gain"] * w * w * cut / e["piston_area"] * d_f


@given(st.lists(FIGURE, min_size=len(FIGURES), max_size=len(FIGURES)), st.booleans())
@settings(max_examples=25)
def test_the_assembly_is_the_papers_descriptor_system(values: list[float], filtered: bool):
    """Matrices of the assembled rig in the paper's states, and its polynomials for all sensors, in rationals."""
    figure, given = dict(zip(FIGURES, values, strict=True)), [exact(value) for value in values]
    model, outer, inner = LinearModel(figure, filtered, {}), given[-2], given[-1]
    n = len(model.states)
    of_paper = descriptor(filtered)
    mass, a, b, c = (
        fmpq_mat(rows, len(flat) // rows, [flat[j * rows + i] for i in range(rows) for j in range(len(flat) // rows)])
        for rows, flat in zip((n, n, n, 4), evaluate_exactly(of_paper, given), strict=True)
    )
    own_mass, own_a, own_b, own_c = model.exact_matrices(outer, inner)
    assert (own_mass.solve(own_a), own_mass.solve(own_b), own_c) == (mass.solve(a), mass.solve(b), c)

    plant, a, b = model.plant(values[-1], SENSED), mass.solve(a), mass.solve(b)
    bare = a.charpoly()
    factor = plant.denominator.at(outer)[n] / bare[n]

    def numerator(source: int, output: int) -> fmpq_poly:
        dyad = fmpq_mat(n, n, [b[i, source] * c[output, j] for i in range(n) for j in range(n)])
        return factor * ((a - dyad).charpoly() - bare)

    tip, by_current = numerator(0, 0), numerator(1, 0)
    assert plant.denominator.at(outer) == factor * bare
    assert (plant.disturbance, plant.displaced) == (tip, by_current)
    for k, output in enumerate((1, 2, 3)):
        assert plant.control[k].at(outer) == numerator(1, output)
        second = tip * numerator(1, output) - by_current * numerator(0, output)
        assert plant.crossed[k] * factor * bare == second


def test_plant_is_affine_in_the_inner_mass_and_its_numerators_are_free_of_the_outer_one(paper: Prototype):
    rig = paper_model(paper)
    first, second, third = (rig.plant(n) for n in (0.0, 1.0, 2.0))
    for part in ("constant", "slope"):
        values = [getattr(plant.denominator, part) for plant in (first, second, third)]
        assert values[2] - values[1] == values[1] - values[0]
    assert first.control != second.control
    scale = None
    for outer in (fmpq(0), fmpq(5)):
        mass, a, b, c = rig.exact_matrices(outer, fmpq(0))
        source, sight = fmpq_mat(7, 1, [b[i, 0] for i in range(7)]), fmpq_mat(1, 7, [c[0, i] for i in range(7)])
        pencil, moved = mass.solve(a).charpoly(), mass.solve(a - source * sight).charpoly()
        found = (moved - pencil) * mass.det()
        scale = scale or first.disturbance[0] / found[0]
        assert scale * found == first.disturbance


def respond(plant: Plant, numerator: fmpq_poly, frequency_Hz: float, outer: float = 0.0) -> complex:
    s = 2j * pi * frequency_Hz
    top, bottom = (
        sum(float(c) * s**i for i, c in enumerate(p.coeffs())) for p in (numerator, plant.denominator.at(exact(outer)))
    )
    return top / bottom


def test_leaking_cylinder_leaves_the_outer_beam_alone_at_rest(paper: Prototype):
    plant = paper_model(paper).plant()
    assert float(plant.disturbance(0) / plant.denominator.constant(0)) == pytest.approx(1 / 486_800.0, rel=1e-12)


def test_tight_cylinder_joins_both_beams_by_the_oil_at_rest(paper: Prototype):
    tight = paper.but(servovalve=paper.servovalve.but(leakage_m3_per_s_per_Pa=0.0))
    plant = paper_model(tight).plant()
    in_series = 1 / (1 / 157_500.0 + 1 / 1.3e7)
    assert abs(respond(plant, plant.disturbance, 1e-6)) == pytest.approx(1 / (486_800.0 + in_series), rel=1e-6)


@pytest.mark.parametrize("outer", [0.0, 6.8])
def test_far_above_all_resonances_only_the_outer_mass_is_left(paper: Prototype, outer: float):
    plant = paper_model(paper).plant()
    expected = -1 / ((3.9 + outer) * (2 * pi * 1e6) ** 2)
    assert respond(plant, plant.disturbance, 1e6, outer) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(("outer", "inner"), MASSES)
def test_undamped_modes_are_those_of_two_masses_and_three_springs(paper: Prototype, outer: float, inner: float):
    """With neither dashpot, leakage nor flow the rig conserves energy; the oil is a spring between the tips."""
    free = paper.but(
        outer_beam=paper.outer_beam.but(damping_ratio=0.0),
        inner_beam=paper.inner_beam.but(damping_ratio=0.0),
        servovalve=paper.servovalve.but(leakage_m3_per_s_per_Pa=0.0),
    )
    stiffness = np.array([[486_800 + 1.3e7, -1.3e7], [-1.3e7, 157_500 + 1.3e7]])
    expected = np.sqrt(eigh(stiffness, np.diag([3.9 + outer, 1.6 + inner]), eigvals_only=True))
    a, _, _ = paper_model(free).matrices(outer, inner)
    structure = np.linalg.eigvals(a[:5, :5])
    assert np.abs(structure.real).max() < 1e-6
    np.testing.assert_allclose(np.sort(structure.imag)[-2:], expected, rtol=1e-9)


def test_with_stiff_oil_both_masses_move_together(paper: Prototype):
    stiff = paper.but(actuator=paper.actuator.but(oil_stiffness_N_per_m=1e10))
    a, _, _ = paper_model(stiff).matrices(0.0, 0.0)
    roots = np.linalg.eigvals(a[:5, :5])
    lowest = min(abs(root) for root in roots if root.imag > 1.0)
    assert lowest == pytest.approx(sqrt((486_800 + 157_500) / (3.9 + 1.6)), rel=1e-3)


@pytest.mark.parametrize("outer", [0.0, 6.8])
def test_the_tip_gives_back_no_more_power_than_it_takes(paper: Prototype, outer: float):
    """Without current the rig is passive: the mean power j w x F_d* is never negative."""
    plant = paper_model(paper).plant()
    for frequency in np.geomspace(1e-3, 1e4, 400):
        assert (2j * pi * frequency * respond(plant, plant.disturbance, frequency, outer)).real >= 0


def test_filter_multiplies_what_the_sensor_gives_and_nothing_else(paper: Prototype):
    bare = paper_model(paper).plant()
    filtered = paper_model(paper.but(sensor=paper.sensor.but(filter_Hz=400.0))).plant()
    for frequency in (1.0, 50.0, 400.0):
        low_pass = 1 / (1 + 1j * frequency / 400.0)
        expected = low_pass * respond(bare, bare.control[0].constant, frequency)
        assert respond(filtered, filtered.control[0].constant, frequency) == pytest.approx(expected, rel=1e-10)
        expected = respond(bare, bare.disturbance, frequency)
        assert respond(filtered, filtered.disturbance, frequency) == pytest.approx(expected, rel=1e-10)


def test_inner_end_mass_of_the_payload_is_not_in_the_figures(paper: Prototype):
    loaded = paper.but(payload=Payload(inner_end_mass_kg=4.5))
    assert paper_model(loaded).figures == paper_model(paper).figures


def test_an_irrational_instruction_is_refused():
    x = ca.SX.sym("x")
    with pytest.raises(NotImplementedError, match="not rational"):
        evaluate_exactly(ca.Function("f", [x], [ca.sin(x)]), [fmpq(1)])


def test_effects_are_refused_rather_than_ignored(paper):
    with pytest.raises(InputError, match=r"effects\.sensor_lag"):
        paper_model(paper.but(effects={"sensor_lag": {"time_constant_s": 1e-3}}))
