"""Derivatives of records: against the linear closed form, CVODES, and differences of the very steps."""

from math import pi

import casadi as ca
import numpy as np
import pytest
from rigs_of_effects import having

from beamdesign import Prototype, critical_gain
from beamdesign.bench_prototype import BenchPrototype
from beamdesign.controllers import Lag
from beamdesign.plant.assembly import OUTPUTS, Assembly, Structure, assemble, fits, parameters_of, structure_of
from beamdesign.plant.bench_simulation import bench_parameters, bench_start, bench_structure
from beamdesign.plant.compiled import integrate, integrate_with_sensitivities
from beamdesign.plant.component import SAMPLED, Series
from beamdesign.plant.effects import causes
from beamdesign.plant.equilibrium import equilibrium, equilibrium_sensitivity, scales
from beamdesign.plant.members import paper_model
from beamdesign.records import parse

SMOOTH = ("entrained_air", "mount_compliance", "second_beam_mode", "transport_delay")
LAG = Lag(gain_A_per_V=0.06, pole_Hz=1.75, zero_Hz=26.0)
STEP_S, SUBSTEPS = 5e-4, 8
LOAD_N = 150.0


def prepared(rig: Prototype, effects: tuple[str, ...]) -> tuple[Assembly, np.ndarray]:
    whole = rig.but(controller=LAG, effects={name: {} for name in effects})
    values = parameters_of(whole, 3.0, 4.0)
    if "seal_friction" in effects:
        values["seal_friction.breakaway_ratio"] = 1.5  # at its default of 1 the Stribeck speed has no influence
    return assemble(structure_of(whole)), np.array(list(values.values()))


def driven(samples: int, substeps: int = SUBSTEPS) -> tuple[np.ndarray, np.ndarray]:
    """Times and inputs of a record under a load with waves on it that start gently."""
    t = np.arange(2 * substeps * (samples - 1) + 1) * STEP_S / (2 * substeps)
    load = LOAD_N + 200 * t / (t + 0.02) * (np.sin(2 * pi * 9 * t) + np.sin(2 * pi * 31 * t))
    return np.arange(samples) * STEP_S, np.column_stack([load, 0.02 * np.sin(2 * pi * 5 * t)])


def derivatives(assembly: Assembly, parameters: np.ndarray, free: tuple[str, ...], samples: int, **more):
    """Outputs and derivatives of a record that starts in equilibrium under the load."""
    u = np.array([LOAD_N, 0.0, 0.0])
    times, inputs = driven(samples)
    x = equilibrium(assembly, u, parameters)
    first = equilibrium_sensitivity(assembly, x, u, parameters, free)
    return integrate_with_sensitivities(
        assembly.kinds, times, inputs, x, first, parameters, free, SUBSTEPS, 1.0, **more
    )


def differences(assembly: Assembly, parameters: np.ndarray, name: str, samples: int, step: float) -> np.ndarray:
    """Central differences (M, 6) of records, each from its own equilibrium."""
    k, found = assembly.parameters.index(name), []
    times, inputs = driven(samples)
    for sign in (1, -1):
        p = parameters.copy()
        p[k] *= 1 + sign * step
        x = equilibrium(assembly, np.array([LOAD_N, 0.0, 0.0]), p)
        found.append(integrate(assembly.kinds, times, inputs, x, p, SUBSTEPS, 1.0)[0])
    return (found[0] - found[1]) / (2 * step * parameters[k])


def test_derivative_of_the_linear_loop_is_that_of_its_matrix(paper: Prototype):
    """By the gain, which enters A = A0 + K A1: Runge-Kutta on (x, dx/dK) is the same polynomial of [[A, 0], [A1, A]].

    The matrices are those of the linear plant, assembled without the rig; the start is the loop's rest under the load.
    """
    assembly, parameters = prepared(paper, ())
    plant, b, c = paper_model(paper).matrices(3.0, 4.0)
    pole, ratio, n = 2 * pi * LAG.pole_Hz, LAG.pole_Hz / LAG.zero_Hz, len(plant)
    by_gain = np.zeros((n + 1, n + 1))
    by_gain[:n, :n], by_gain[:n, n] = -ratio * np.outer(b[:, 1], c[1]), (1 - ratio) * b[:, 1]
    a = LAG.gain_A_per_V * by_gain
    a[:n, :n] += plant
    a[n, :n], a[n, n] = -pole * c[1], -pole
    drive = np.append(b[:, 0], 0.0)
    whole = np.block([[a, 0 * a], [by_gain, a]])
    column = np.append(drive, 0 * drive)
    rest = -np.linalg.solve(a, drive * LOAD_N)
    first = np.append(rest, -np.linalg.solve(a, by_gain @ rest))

    samples = 400
    times, inputs = driven(samples)
    inputs[:, 1] = 0.0
    h, z, expected = STEP_S / SUBSTEPS, first, []
    for k in range(samples):
        expected.append(z)
        for half in range(2 * SUBSTEPS * k, 2 * SUBSTEPS * min(k + 1, samples - 1), 2):
            w = inputs[half : half + 3, 0]
            k1 = whole @ z + column * w[0]
            k2 = whole @ (z + h / 2 * k1) + column * w[1]
            k3 = whole @ (z + h / 2 * k2) + column * w[1]
            z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + whole @ (z + h * k3) + column * w[2])
    row = np.append(c[1] / paper.sensor.gain_V_per_m, 0.0)
    tip, by_the_gain = np.array(expected)[:, : n + 1] @ row, np.array(expected)[:, n + 1 :] @ row

    u = np.array([LOAD_N, 0.0, 0.0])
    x = equilibrium(assembly, u, parameters)
    start = equilibrium_sensitivity(assembly, x, u, parameters, ("gain",))
    y, dy = integrate_with_sensitivities(
        assembly.kinds, times, inputs, x, start, parameters, ("gain",), SUBSTEPS, 1.0, outputs=(1,)
    )
    np.testing.assert_allclose(y[:, 1], tip, rtol=0, atol=1e-9 * np.abs(tip).max())
    np.testing.assert_allclose(dy[:, 0, 0], by_the_gain, rtol=0, atol=1e-8 * np.abs(by_the_gain).max())


def test_derivatives_of_a_smooth_rig_are_those_of_cvodes(paper: Prototype):
    """SUNDIALS' own forward sensitivities of the flow under a constant load, at the end of the record."""
    assembly, parameters = prepared(paper, SMOOTH)
    free = ("outer_mass", "oil_stiffness", "entrained_air.air_fraction", "transport_delay.delay_s")
    until, substeps, states = 0.05, 40, len(assembly.states)
    typical = scales(assembly.states)
    start = equilibrium(assembly, np.zeros(3), parameters)
    chosen = [assembly.parameters.index(name) for name in free]

    z, ratio, t = ca.SX.sym("z", states), ca.SX.sym("ratio", len(free)), ca.SX.sym("t")
    p = ca.SX(parameters)
    for k, position in enumerate(chosen):
        p[position] = parameters[position] * ratio[k]
    rate = assembly.function(t, z * typical, [LOAD_N, 0.0, 0.0], p)[0] / typical
    tight = {"abstol": 1e-11, "reltol": 1e-10, "fsens_err_con": True, "max_num_steps": 100_000}
    flow = ca.integrator("flow", "cvodes", {"x": z, "p": ratio, "t": t, "ode": rate}, 0.0, until, tight)
    given = ca.MX.sym("ratio", len(free))
    end = flow(x0=start / typical, p=given)["xf"]
    by_ratio = ca.Function("derivative", [given], [ca.jacobian(end, given)])(np.ones(len(free)))

    times = np.arange(101) * STEP_S
    first = np.zeros((states, len(free)))
    inputs = np.tile([LOAD_N, 0.0], (2 * substeps * 100 + 1, 1))
    _, dy = integrate_with_sensitivities(
        assembly.kinds, times, inputs, start, first, parameters, free, substeps, 1.0, outputs=(2, 3)
    )
    states_of = [assembly.states.index(name) for name in ("pressure_a_Pa", "pressure_b_Pa", "inner_m")]
    a, b, inner = (typical[k] * np.asarray(by_ratio)[k] for k in states_of)
    found = dy[-1] * parameters[chosen]
    np.testing.assert_allclose(found[0], a - b, rtol=1e-5, atol=1e-6 * np.abs(a - b).max())
    np.testing.assert_allclose(found[1], inner, rtol=1e-5, atol=1e-6 * np.abs(inner).max())


@pytest.mark.parametrize(
    "effects",
    [
        (*SMOOTH, "pressure_dependent_flow"),
        ("seal_friction",),
        ("valve_hysteresis", "joint_backlash"),
        ("joint_backlash", "valve_hysteresis_magnetic"),
    ],
)
def test_derivatives_are_those_of_the_steps_themselves(paper: Prototype, effects: tuple[str, ...]):
    """By differences so small that hardly a step changes its side of a kink; 15 = 8+4+2+1 meets all vector widths."""
    assembly, parameters = prepared(paper, effects)
    own = [name for name in assembly.parameters if "." in name and parameters[assembly.parameters.index(name)] != 0]
    linear = ("outer_mass", "outer_stiffness", "inner_damping", "oil_stiffness", "flow_gain", "leakage", "gain", "pole")
    linear += ("inner_stiffness", "valve_damping_ratio", "piston_area", "zero")
    free = (*linear, *own)[:15]
    assert len(free) == 15
    samples = 200
    y, dy = derivatives(assembly, parameters, free, samples)
    times, inputs = driven(samples)
    start = equilibrium(assembly, np.array([LOAD_N, 0.0, 0.0]), parameters)
    plain, _ = integrate(assembly.kinds, times, inputs, start, parameters, SUBSTEPS, 1.0)
    np.testing.assert_allclose(y, plain, rtol=1e-9, atol=1e-11 * np.abs(plain).max())
    for k, name in enumerate(free):
        step = 2e-6
        expected = differences(assembly, parameters, name, samples, step)
        scale = np.abs(expected).max(axis=0)
        rounding = 1e-13 * np.abs(plain).max(axis=0) / (step * parameters[assembly.parameters.index(name)])
        error = np.abs(dy[:, :, k] - expected).max(axis=0)
        assert (scale > 100 * rounding).all(), name
        assert (error < 2e-6 * scale + rounding).all(), (name, error / scale, rounding / scale)


def test_derivatives_of_another_kind_of_rig():
    """A cylinder on a bench, driven off its stop in open loop, against differences from the same start."""
    table = {"bore_m": 0.02, "rod_m": 0.014, "piston_area_m2": 2.4e-4, "stroke_m": 0.15}
    supply = {"supply_pressure_Pa": 6e6, "tank_pressure_Pa": 2e5}
    bench = parse(
        BenchPrototype,
        {"name": "bench", "kind": "actuator_bench", "actuator": table | supply}
        | {"servovalve": {"flow_gain_m3_per_s_per_V": 8e-6}},
        "table",
    ).but(effects={"pressure_dependent_flow": {}, "seal_friction": {}})
    kinds, parameters = bench_structure(bench), np.array(list(bench_parameters(bench).values()))
    names, start = assemble(kinds).parameters, bench_start(bench)
    free = ("stroke", "bulk_modulus", "flow_gain", "moving_mass", "seal_friction.coulomb_N")
    times, substeps = np.arange(120) * 1e-3, 20
    inputs = np.column_stack([np.zeros(2 * substeps * 119 + 1), np.full(2 * substeps * 119 + 1, 2.0)])
    y, dy = integrate_with_sensitivities(
        kinds, times, inputs, start, np.zeros((len(start), len(free))), parameters, free, substeps, np.inf
    )
    assert y[-1, 4] > 1e-3  # it has left the stop
    for k, name in enumerate(free):
        step, found = 1e-6 * parameters[names.index(name)], []
        for sign in (1, -1):
            p = parameters.copy()
            p[names.index(name)] += sign * step
            found.append(integrate(kinds, times, inputs, start, p, substeps, np.inf)[0])
        expected = (found[0] - found[1]) / (2 * step)
        rounding = 1e-12 * np.abs(y).max(axis=0) / step
        error = np.abs(dy[:, :, k] - expected).max(axis=0)
        assert (error <= 1e-5 * np.abs(expected).max(axis=0) + rounding).all(), name


def test_every_effect_has_finite_derivatives_from_rest_on(paper: Prototype):
    """Rest is where laws have their kinks."""
    for name in causes():
        assembly, parameters = prepared(having(paper, name), (name,))
        own = tuple(parameter for parameter in assembly.parameters if parameter.startswith(name + "."))
        x = equilibrium(assembly, np.zeros(3), parameters)
        first = equilibrium_sensitivity(assembly, x, np.zeros(3), parameters, own)
        times, inputs = driven(60)
        _, dy = integrate_with_sensitivities(
            assembly.kinds, times, inputs - [LOAD_N, 0.0], x, first, parameters, own, SUBSTEPS, 1.0
        )
        assert len(dy) == 60
        assert np.isfinite(dy).all(), name


def test_outputs_are_those_asked_for_and_columns_do_not_depend_on_their_neighbours(paper: Prototype):
    assembly, parameters = prepared(paper, ("seal_friction",))
    free = ("outer_mass", "gain", "seal_friction.coulomb_N")
    _, every = derivatives(assembly, parameters, free, 50)
    assert every.shape == (50, len(OUTPUTS), 3)
    _, some = derivatives(assembly, parameters, free[::-1], 50, outputs=(3, 0))
    np.testing.assert_allclose(some, every[:, [3, 0], ::-1], rtol=1e-9, atol=1e-300)
    for k, name in enumerate(free):
        np.testing.assert_allclose(
            derivatives(assembly, parameters, (name,), 50)[1][:, :, 0], every[:, :, k], rtol=1e-6, atol=1e-300
        )


@pytest.mark.parametrize(
    "effects", [(), ("seal_friction",), tuple(sorted(name for name in causes() if fits(name, "twin_beam")))]
)
def test_equilibrium_moves_as_its_derivative_says(paper: Prototype, effects: tuple[str, ...]):
    assembly, parameters = prepared(paper, effects)
    u = np.array([LOAD_N, 0.01, 0.0])
    free = tuple(name for name, value in zip(assembly.parameters, parameters, strict=True) if value != 0)
    x = equilibrium(assembly, u, parameters)
    found = equilibrium_sensitivity(assembly, x, u, parameters, free)
    moved = 0
    for k, name in enumerate(free):
        position, step = assembly.parameters.index(name), 1e-4
        ahead, behind = parameters.copy(), parameters.copy()
        ahead[position] *= 1 + step
        behind[position] *= 1 - step
        change = (equilibrium(assembly, u, ahead) - equilibrium(assembly, u, behind)) / (2 * step)
        given = found[:, k] * parameters[position] / scales(assembly.states)
        change /= scales(assembly.states)
        np.testing.assert_allclose(given, change, rtol=0, atol=1e-6 + 1e-5 * np.abs(change).max(), err_msg=name)
        moved += bool(np.abs(given).max() > 1e-3)
    assert moved > 3


def test_a_diverging_record_ends_with_its_derivatives(paper: Prototype):
    gain = 1.5 * critical_gain(paper.but(controller=LAG)).gain_A_per_V
    rig = paper.but(controller=LAG.but(gain_A_per_V=gain))
    kinds, parameters = structure_of(rig), np.array(list(parameters_of(rig, 0.0, 0.0).values()))
    times, inputs = driven(4000, 5)
    start = equilibrium(assemble(kinds), np.zeros(3), parameters)
    y, dy = integrate_with_sensitivities(
        kinds, times, inputs, start, np.zeros((len(start), 1)), parameters, ("gain",), 5, 0.01, outputs=(4,)
    )
    assert 0 < len(y) == len(dy) < len(times)
    assert np.isfinite(dy).all()
    assert len(y) == len(integrate(kinds, times, inputs, start, parameters, 5, 0.01)[0])


def test_what_does_not_fit_is_refused():
    assembly = assemble(Structure(Series((1,))))
    n, p = len(assembly.states), np.ones(len(assembly.parameters))
    times, inputs = np.arange(2) * 1e-3, np.zeros((3, 2))

    def asked(kinds: Structure, free: tuple[str, ...], columns: int) -> None:
        integrate_with_sensitivities(kinds, times, inputs, np.zeros(n), np.zeros((n, columns)), p, free, 1, 1.0)

    with pytest.raises(ValueError, match=r"no parameter seal_friction\.coulomb_N"):
        asked(assembly.kinds, ("seal_friction.coulomb_N",), 1)
    with pytest.raises(ValueError, match=r"start sensitivity of \(9, 2\), not \(9, 1\)"):
        asked(assembly.kinds, ("gain",), 2)
    with pytest.raises(ValueError, match="continuous controller"):
        asked(Structure(SAMPLED), ("gain",), 1)
