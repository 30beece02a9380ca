"""Generated machine code against CasADi's own evaluation, and its steps against the matrix form of Runge-Kutta."""

import ctypes
from math import pi

import casadi as ca
import numpy as np
import pytest
from rigs_of_effects import having

from beamdesign import Prototype, critical_gain
from beamdesign.controllers import Lag
from beamdesign.plant.assembly import INPUTS, Structure, assemble, fits, parameters_of, structure_of
from beamdesign.plant.compiled import compiled, integrate
from beamdesign.plant.component import LAG, PROPORTIONAL
from beamdesign.plant.effects import causes
from beamdesign.plant.equilibrium import scales
from beamdesign.plant.machine_code import Body, MachineCode, machine_code, trace
from beamdesign.plant.members import paper_model

EFFECTS = tuple(sorted(name for name in causes() if fits(name, "twin_beam")))
GAIN_A_PER_V = 0.06


def lag(gain_A_per_V: float = GAIN_A_PER_V) -> Lag:
    return Lag(gain_A_per_V=gain_A_per_V, pole_Hz=1.75, zero_Hz=26.0)


def figures(rig: Prototype, outer_kg: float = 3.0, inner_kg: float = 4.0) -> np.ndarray:
    return np.array(list(parameters_of(rig, outer_kg, inner_kg).values()))


def called(code: MachineCode, name: str, t: float, x, u, parameters, entries: int) -> np.ndarray:
    """One of a code's functions at a point."""
    pointer = ctypes.c_void_p
    function = ctypes.CFUNCTYPE(None, ctypes.c_double, pointer, pointer, pointer, pointer)(code.address[name])
    given = [np.ascontiguousarray(array, dtype=float) for array in (x, u)] + [code.prepared(parameters)]
    out = np.zeros(entries)
    function(t, *(array.ctypes.data for array in given), out.ctypes.data)
    return out


@pytest.mark.parametrize("effects", [(), *((name,) for name in sorted(causes())), EFFECTS])
def test_generated_code_gives_what_casadi_evaluates(paper: Prototype, effects: tuple[str, ...]):
    rig = having(paper, *effects).but(controller=lag(), effects={name: {} for name in effects})
    assembly = assemble(structure_of(rig))
    random = np.random.default_rng(len(effects))
    middle = np.array([1e7 if name.startswith("pressure_") else 0.0 for name in assembly.states])
    pairs: list[list[np.ndarray]] = [[], []]
    for _ in range(40):
        x = middle + 3 * scales(assembly.states) * random.standard_normal(len(middle))
        u = np.array([300.0, 0.1, 0.0]) * random.standard_normal(len(INPUTS))
        p = figures(rig) * random.uniform(0.7, 1.3, len(assembly.parameters))
        t = random.uniform(0.0, 3.0)
        expected = [np.asarray(value).ravel() for value in assembly.function(t, x, u, p)]
        code = compiled(assembly.kinds)
        for pair, name, value in zip(pairs, ("law", "output"), expected, strict=True):
            pair.append(np.vstack([called(code, name, t, x, u, p, len(value)), value]))
    for pair in pairs:
        found, expected = np.stack(pair, axis=1)
        assert np.isfinite(expected).all()
        assert (np.abs(found - expected).max(axis=0) <= 1e-12 * np.abs(expected).max(axis=0)).all()


def test_every_operation_gives_what_casadi_evaluates():
    t, x, u, p = ca.SX.sym("t"), ca.SX.sym("x", 2), ca.SX.sym("u", 3), ca.SX.sym("p", 2)
    a, b = x[0], x[1]
    of_one = [ca.sqrt, ca.exp, ca.log, ca.sin, ca.cos, ca.tan, ca.asin, ca.acos, ca.atan, ca.sinh, ca.cosh, ca.tanh]
    of_one += [ca.fabs, ca.floor, ca.ceil, ca.sign, ca.log1p, ca.expm1, ca.logic_not]
    of_one += [lambda v: -v, lambda v: v * v, lambda v: v + v, lambda v: 1 / v, lambda v: v**2.5, lambda v: v**3]
    of_two = [ca.fmin, ca.fmax, ca.atan2, ca.hypot, ca.copysign, ca.power, ca.logic_and, ca.logic_or]
    of_two += [lambda v, w: v + w, lambda v, w: v - w, lambda v, w: v * w, lambda v, w: v / w]
    of_two += [lambda v, w: v < w, lambda v, w: v <= w, lambda v, w: v == w, lambda v, w: v != w]
    of_two += [lambda v, w: ca.if_else(v < w, v * v, ca.sin(w)), lambda v, w: ca.if_else(v, w, 3.0)]
    # Of states, of parameters, and of both, so that the split between record and step is met as well.
    rows = [law(v) for law in of_one for v in (a, p[0])]
    rows += [law(v, w) for law in of_two for v, w in ((a, b), (p[0], p[1]), (a, p[1]), (p[0], b))]
    rows += [t + u[2], ca.SX(0.1), ca.SX(0), a]
    function = ca.Function("all", [t, x, u, p], [ca.vertcat(*rows)])
    traced = trace(function)

    def write(body: Body) -> None:
        for entry, value in enumerate(traced.outputs[0]):
            body.store(body.read(value), "out", entry)

    code = machine_code(traced.values, {"law": write})
    points = [(0.3, 0.7), (0.7, 0.3), (0.5, 0.5), (0.0, 0.4), (0.4, 0.0), (-0.4, 0.6), (1.7, -0.2)]
    for states, of_parameters in zip(points, reversed(points), strict=True):
        found = called(code, "law", 0.2, states, [1.0, 2.0, 3.0], of_parameters, len(rows))
        expected = np.asarray(function(0.2, states, [1, 2, 3], of_parameters)).ravel()
        np.testing.assert_allclose(found, expected, rtol=1e-14, atol=0)


def test_an_operation_that_is_not_known_is_named():
    t, x, u, p = (ca.SX.sym(name) for name in "txup")
    with pytest.raises(NotImplementedError, match=f"operation {ca.OP_ERF}"):
        trace(ca.Function("odd", [t, x, u, p], [ca.erf(x)]))


def closed_loop(rig: Prototype, gain_A_per_V: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, column of the force and row of the displacement of the loop with its lag, by the linear plant's matrices."""
    a, b, c = paper_model(rig).matrices(3.0, 4.0)
    law = lag()
    pole, ratio, n = 2 * pi * law.pole_Hz, law.pole_Hz / law.zero_Hz, len(a)
    full = np.zeros((n + 1, n + 1))
    full[:n, :n] = a - gain_A_per_V * ratio * np.outer(b[:, 1], c[1])
    full[:n, n] = gain_A_per_V * (1 - ratio) * b[:, 1]
    full[n, :n], full[n, n] = -pole * c[1], -pole
    return full, np.append(b[:, 0], 0.0), np.append(c[1] / rig.sensor.gain_V_per_m, 0.0)


def test_steps_are_those_of_runge_and_kutta_on_the_linear_loop(paper: Prototype):
    """On x' = A x + b w, w constant, one step is x + (hA + (hA)^2/2 + (hA)^3/6 + (hA)^4/24) (x + A^-1 b w) exactly."""
    rig = paper.but(controller=lag())
    a, b, c = closed_loop(rig, GAIN_A_PER_V)
    substeps, times, load = 5, np.arange(200) * 5e-4, 80.0
    z = 1e-4 * a
    grown = np.eye(len(a)) + z @ (np.eye(len(a)) + z / 2 @ (np.eye(len(a)) + z / 3 @ (np.eye(len(a)) + z / 4)))
    still = -np.linalg.solve(a, b * load)
    over, expected = np.linalg.matrix_power(grown, substeps), []
    x = np.zeros(len(a))
    for _ in times:
        expected.append(c @ x)
        x = still + over @ (x - still)
    kinds = structure_of(rig)
    start = np.array([1e7 if name.startswith("pressure_") else 0.0 for name in assemble(kinds).states])
    inputs = np.tile([load, 0.0], (2 * substeps * (len(times) - 1) + 1, 1))
    y, _ = integrate(kinds, times, inputs, start, figures(rig), substeps, 1.0)
    np.testing.assert_allclose(y[:, 1], expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("bound", [0.01, np.inf])
def test_a_diverging_record_ends_where_it_leaves_the_bound_or_the_numbers(paper: Prototype, bound: float):
    gain = 1.5 * critical_gain(paper.but(controller=lag())).gain_A_per_V
    rig = paper.but(controller=lag(gain))
    kinds, times = structure_of(rig), np.arange(60001) * 5e-3
    inputs = np.tile([50.0, 0.0], (2 * 10 * 60000 + 1, 1))
    start = np.zeros(len(assemble(kinds).states))
    y, _ = integrate(kinds, times, inputs, start, figures(rig), 10, bound)
    assert 0 < len(y) < len(times)
    assert np.isfinite(y).all()
    assert np.abs(y[:, 4]).max() <= bound


def test_a_record_that_begins_without_numbers_is_empty(paper: Prototype):
    rig = paper.but(controller=lag())
    kinds = structure_of(rig)
    start = np.full(len(assemble(kinds).states), np.nan)
    assert integrate(kinds, np.arange(3) * 1e-3, np.zeros((5, 2)), start, figures(rig), 1, 1.0)[0].shape == (0, 6)
    with pytest.raises(ValueError, match="4 input points do not fit 3 samples of 1 steps"):
        integrate(kinds, np.arange(3) * 1e-3, np.zeros((4, 2)), start, figures(rig), 1, 1.0)


def test_a_record_ends_with_any_state_that_is_no_number(paper: Prototype):
    """How fast the flow of the valve changes shows in no output before the next sample."""
    rig = paper.but(controller=lag())
    kinds = structure_of(rig)
    start = np.zeros(len(assemble(kinds).states))
    start[assemble(kinds).states.index("flow_m3_per_s2")] = np.inf
    assert len(integrate(kinds, np.arange(3) * 1e-3, np.zeros((5, 2)), start, figures(rig), 1, 1.0)[0]) == 0


def test_code_of_one_structure_serves_all_figures():
    assert compiled(Structure(LAG)) is compiled(Structure(LAG))
    assert compiled(Structure(LAG)) is not compiled(Structure(PROPORTIONAL))
