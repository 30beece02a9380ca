"""The assembled rig against the linear plant in exact rationals, power balance and static closed forms."""

from dataclasses import dataclass
from math import pi
from typing import Any

import casadi as ca
import numpy as np
import pytest
from flint import fmpq_mat, fmpq_poly
from scipy.linalg import eigh

from beamdesign import InputError, Prototype
from beamdesign.controllers import Lag, Proportional
from beamdesign.loop import loop
from beamdesign.plant.assembly import INPUTS, OUTPUTS, RIGS, Structure, assemble, fits, parameters_of, structure_of
from beamdesign.plant.component import SAMPLED
from beamdesign.plant.effects import causes
from beamdesign.plant.equilibrium import equilibrium, linearise
from beamdesign.plant.linearised import evaluate_exactly
from beamdesign.plant.members import paper_model
from beamdesign.polynomial import exact

CONTRACT = {
    "sensor_lag", "transport_delay", "unequal_piston_areas", "pressure_dependent_flow", "entrained_air",
    "seal_friction", "valve_deadband", "valve_hysteresis", "current_saturation", "second_beam_mode", "mount_compliance",
    "joint_backlash",
}  # fmt: skip


@pytest.fixture
def lag(paper: Prototype) -> Prototype:
    return paper.but(controller=Lag(gain_A_per_V=0.12, pole_Hz=1.75, zero_Hz=26.0))


def operating_point(rig: Prototype, force: float = 0.0, sampled: bool = False, outer: float = 0.0, inner: float = 0.0):
    assembly = assemble(structure_of(rig, sampled))
    parameters = np.array(list(parameters_of(rig, outer, inner).values()))
    u = np.array([force, 0.0, 0.0])
    return assembly, equilibrium(assembly, u, parameters), u, parameters


def exact_transfers(filtered: bool, values: list[float]) -> tuple[fmpq_poly, fmpq_poly, fmpq_poly]:
    """Denominator, force to displacement and current to sensor volts of the assembly, in rationals."""
    assembly = assemble(Structure(SAMPLED, filtered))
    n = len(assembly.states)
    p, x, u = ca.SX.sym("p", len(assembly.parameters)), ca.SX.sym("x", n), ca.SX.sym("u", len(INPUTS))
    rate, y = assembly.function(0, x, u, p)
    half = p[assembly.parameters.index("supply_pressure")] / 2
    rest = ca.vertcat(*(half if name.endswith("_Pa") else 0 for name in assembly.states))
    jacobians = [ca.jacobian(rate, x), ca.jacobian(rate, u), ca.jacobian(y, x)]
    at_rest = [ca.densify(ca.substitute(m, x, rest)) for m in jacobians]
    entries = evaluate_exactly(ca.Function("linear", [p], at_rest), [exact(v) for v in values])
    a, b, c = (
        fmpq_mat(
            m.shape[0], m.shape[1], [column[j * m.shape[0] + i] for i in range(m.shape[0]) for j in range(m.shape[1])]
        )
        for column, m in zip(entries, at_rest, strict=True)
    )

    def numerator(source: str, output: str) -> fmpq_poly:
        i, k = INPUTS.index(source), OUTPUTS.index(output)
        outer = fmpq_mat(n, n, [b[r, i] * c[k, s] for r in range(n) for s in range(n)])
        return (a - outer).charpoly() - a.charpoly()

    force = numerator("disturbance_N", "outer_displacement_m")
    return a.charpoly(), force, numerator("sampled_current_A", "measured_V")


@pytest.mark.parametrize("filter_Hz", [None, 400.0])
@pytest.mark.parametrize(("outer", "inner"), [(0.0, 0.0), (6.8, 4.5)])
def test_without_effects_it_is_the_papers_plant_exactly(
    lag: Prototype, outer: float, inner: float, filter_Hz: float | None
):
    rig = lag.but(sensor=lag.sensor.but(filter_Hz=filter_Hz))
    values = list(parameters_of(rig, outer, inner).values())
    denominator, force, current = exact_transfers(filter_Hz is not None, values)
    plant = paper_model(rig).plant(inner)
    expected = plant.denominator.at(exact(outer))
    # One state more than the paper: the mean pressure, which cancels from every transfer function.
    assert denominator.degree() == expected.degree() + 1
    assert current * expected == plant.control[0].constant * denominator
    assert force * expected == plant.disturbance * denominator


def test_closed_loop_poles_are_those_of_the_linear_loop_and_the_mean_pressure(lag: Prototype):
    assembly, x, u, parameters = operating_point(lag)
    found = list(np.linalg.eigvals(linearise(assembly, x, u, parameters).a))
    for pole in loop(lag).at(0.0).poles():
        nearest = min(found, key=lambda value: abs(value - pole))
        assert abs(nearest - pole) < 1e-9 * abs(pole)
        found.remove(nearest)
    figures = paper_model(lag).figures
    assert found == [pytest.approx(-figures["leakage"] * figures["oil_stiffness"] / figures["piston_area"] ** 2)]


def test_power_that_enters_is_stored_or_lost(lag: Prototype):
    """At any state: rate of kinetic, elastic and oil energy = power of force and valve - dashpots."""
    assembly, _, _, parameters = operating_point(lag, outer=6.8, inner=4.4)
    p = dict(zip(assembly.parameters, parameters, strict=True))
    random = np.random.default_rng(3)
    scale = np.array([1e-3, 0.1, 1e-3, 0.1, 3e6, 3e6, 1e-4, 1e-1, 0.1])
    for _ in range(5):
        x, u = scale * random.standard_normal(9), np.array([300.0, 0.2, 0.0])
        s, r = (
            dict(zip(assembly.states, np.asarray(v).ravel(), strict=True))
            for v in (x, assembly.function(0, x, u, parameters)[0])
        )
        oil = p["oil_stiffness"] / (2 * p["piston_area"] ** 2)
        stored = (
            (p["outer_mass"] + p["outer_end_mass"]) * s["outer_m_per_s"] * r["outer_m_per_s"]
            + (p["inner_mass"] + p["inner_end_mass"]) * s["inner_m_per_s"] * r["inner_m_per_s"]
            + p["outer_stiffness"] * s["outer_m"] * r["outer_m"]
            + p["inner_stiffness"] * s["inner_m"] * r["inner_m"]
            + (s["pressure_a_Pa"] * r["pressure_a_Pa"] + s["pressure_b_Pa"] * r["pressure_b_Pa"]) / oil
        )
        a, b = s["pressure_a_Pa"], s["pressure_b_Pa"]
        supplied = u[0] * s["outer_m_per_s"] + (a - b) * s["flow_m3_per_s"]
        leaked = 2 * p["leakage"] * (a * (a - 10e6) + b * (b - 10e6))
        lost = p["outer_damping"] * s["outer_m_per_s"] ** 2 + p["inner_damping"] * s["inner_m_per_s"] ** 2
        assert stored == pytest.approx(supplied - leaked - lost, rel=1e-9)


def test_the_library_holds_the_named_effects_well_formed(lag: Prototype):
    assert set(causes()) >= CONTRACT | {"carrier_ripple", "uneven_leakage"}
    for effect in causes().values():
        assert any(set(effect.laws) <= set(rig.ports) for rig in RIGS.values())
        assert all(q.low <= q.default <= q.high and q.spread > 0 for q in effect.parameters)
        assert effect.source
    together = lag.but(effects={name: {} for name in causes() if fits(name, lag.rig)})
    assembly, x, u, parameters = operating_point(together, 300.0)
    assert np.abs(np.asarray(assembly.function(0, x, u, parameters)[0])).max() < 1e-3


def test_wrong_effects_are_told_together(lag: Prototype):
    wrong = lag.but(
        effects={"sensor_lagg": {}, "seal_friction": {"coulomb": 1.0, "coulomb_N": -1.0}, "valve_deadband": {}}
    )
    with pytest.raises(InputError) as told:
        structure_of(wrong)
    assert [problem.key for problem in told.value.problems] == [
        "effects.sensor_lagg", "effects.seal_friction.coulomb", "effects.seal_friction.coulomb_N"
    ]  # fmt: skip
    assert "did you mean sensor_lag?" in str(told.value)


def test_sensor_lag_is_the_prototypes_own_filter(lag: Prototype):
    assembly, x, u, parameters = operating_point(lag.but(effects={"sensor_lag": {"break_Hz": 400.0}}))
    found = np.linalg.eigvals(linearise(assembly, x, u, parameters).a)
    for pole in loop(lag.but(sensor=lag.sensor.but(filter_Hz=400.0))).at(0.0).poles():
        assert np.abs(found - pole).min() < 1e-8 * abs(pole)


def response(rig: Prototype, source: str, output: str, frequency_Hz: float, **masses: float) -> complex:
    assembly, x, u, parameters = operating_point(rig, sampled=True, **masses)
    model = linearise(assembly, x, u, parameters)
    i, k = INPUTS.index(source), OUTPUTS.index(output)
    resolvent = np.linalg.solve(2j * pi * frequency_Hz * np.eye(len(x)) - model.a, model.b[:, i])
    return complex(model.c[k] @ resolvent + model.d[k, i])


def test_transport_delay_turns_the_phase_and_leaves_the_gain(lag: Prototype):
    delay = 1e-3
    delayed = lag.but(effects={"transport_delay": {"delay_s": delay}})
    for frequency in (5.0, 50.0, 150.0):
        ratio = response(delayed, "disturbance_N", "measured_V", frequency)
        ratio /= response(lag, "disturbance_N", "measured_V", frequency)
        angle = 2 * pi * frequency * delay
        assert abs(ratio) == pytest.approx(1, abs=1e-12)
        assert abs(ratio - np.exp(-1j * angle)) < 1.1 * angle**5 / 720 + 1e-12


@pytest.mark.parametrize(
    ("effects", "expected"),
    [
        ({}, 0.0),
        ({"mount_compliance": {"stiffness_N_per_m": 5e6}}, 1000 / 5e6),
        ({"mount_compliance": {"stiffness_N_per_m": 5e6, "sensor_share": 1.0}}, 0.0),
        ({"second_beam_mode": {"compliance_share": 0.03}}, 0.03 * 1000 / 486_800),
        ({"uneven_leakage": {"imbalance": 0.1}}, 0.1 * 20e6 * 1.13e-4 / 486_800),
    ],
)
def test_static_displacement_under_load_with_the_valve_at_null(
    lag: Prototype, effects: dict[str, dict[str, float]], expected: float
):
    """Leakage takes the load off the cylinder: what is left is the outer beam, and what the effect adds."""
    assembly, x, u, parameters = operating_point(lag.but(effects=effects), 1000.0, sampled=True)
    y = np.asarray(assembly.function(0, x, u, parameters)[1]).ravel()
    assert y[OUTPUTS.index("displacement_m")] == pytest.approx(1000 / 486_800 + expected, rel=1e-8)


@pytest.mark.parametrize("end_mass", [0.0, 6.8])
def test_second_mode_and_end_mass_are_one_modal_system(lag: Prototype, end_mass: float):
    own = {"frequency_Hz": 300.0, "compliance_share": 0.05, "damping_ratio": 0.001}
    soft = lag.but(
        actuator=lag.actuator.but(oil_stiffness_N_per_m=1.0),
        outer_beam=lag.outer_beam.but(damping_ratio=0.0),
        effects={"second_beam_mode": own},
    )
    assembly, x, u, parameters = operating_point(soft, sampled=True, outer=end_mass)
    found = np.abs(np.linalg.eigvals(linearise(assembly, x, u, parameters).a))
    stiffness = np.diag([486_800, 486_800 / 0.05])
    mass = np.diag([3.9, 486_800 / 0.05 / (2 * pi * 300) ** 2]) + end_mass
    for squared in eigh(stiffness, mass, eigvals_only=True):
        assert np.abs(found - np.sqrt(squared)).min() < 1e-4 * np.sqrt(squared)


def test_effects_without_magnitude_are_none(lag: Prototype):
    nothing = {
        "unequal_piston_areas": {"asymmetry": 0.0},
        "valve_deadband": {"half_width_A": 0.0},
        "current_saturation": {"limit_A": 0.2},
        "uneven_leakage": {"imbalance": 0.0},
        "carrier_ripple": {"depth": 0.0},
    }
    base, with_them = (operating_point(lag.but(effects=effects), 100.0) for effects in ({}, nothing))
    state = base[1] * 1.3 + 1e-4
    rates = [np.asarray(a.function(0.01, state, u, q)[0]).ravel() for a, _, u, q in (base, with_them)]
    np.testing.assert_allclose(rates[1], rates[0], rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "nearly_none", "within"),
    [
        ("mount_compliance", {"stiffness_N_per_m": 5e8, "frequency_Hz": 1000.0}, 4e-3),
        ("second_beam_mode", {"compliance_share": 1e-4, "frequency_Hz": 1500.0}, 2e-4),
        ("entrained_air", {"air_fraction": 1e-4}, 1e-3),
        ("pressure_dependent_flow", {}, 2e-2),
        ("sensor_lag", {"break_Hz": 2000.0}, 0.06),
    ],
)
def test_small_effects_approach_the_linear_loop(
    lag: Prototype, name: str, nearly_none: dict[str, float], within: float
):
    changed = lag.but(effects={name: nearly_none})
    for frequency in (1.0, 20.0, 100.0):
        expected = response(lag, "disturbance_N", "measured_V", frequency)
        assert abs(response(changed, "disturbance_N", "measured_V", frequency) / expected - 1) < within


def test_proportional_and_lag_at_its_zero_frequency_rest_alike(lag: Prototype):
    straight = lag.but(controller=Proportional(gain_A_per_V=0.12))
    rests = [operating_point(rig, 500.0)[1][0] for rig in (lag, straight)]
    assert rests[0] == pytest.approx(rests[1], rel=1e-9)
    assert rests[0] == pytest.approx(500 * loop(lag).at(0.0).static_compliance(), rel=1e-9)


@pytest.mark.parametrize("force", [-1000.0, 1000.0])
def test_friction_that_has_not_slid_carries_no_load(lag: Prototype, force: float):
    rubbing = lag.but(effects={"seal_friction": {}, "valve_hysteresis": {}})
    assembly, x, u, parameters = operating_point(rubbing, force)
    assert x[assembly.states.index("seal_friction.deflection")] == 0
    np.testing.assert_allclose(x[:8], operating_point(lag, force)[1][:8], rtol=1e-9, atol=1e-15)
    assert np.abs(np.asarray(assembly.function(0, x, u, parameters)[0])).max() < 1e-6


@dataclass(frozen=True)
class Named:
    """A law of nothing, with names of its own."""

    parameters: tuple[str, ...] = ("gain",)
    states: tuple[str, ...] = ()

    def current_and_rates(self, port: Any, figure: Any, state: Any) -> tuple[Any, dict[str, Any]]:
        return 0.0, dict.fromkeys(self.states, 0.0)


@pytest.mark.parametrize("filtered", [True, False])
def test_names_of_a_law_that_the_rig_has_are_refused(filtered: bool) -> None:
    """One called `filtered_V` took the place of the sensor's own filter: nothing moved."""
    assert "own" in assemble(Structure(Named(states=("own",)), filtered)).states
    laws = {"filtered_V": Named(states=("filtered_V",)), "leakage": Named(parameters=("gain", "leakage"))}
    for name, law in laws.items():
        with pytest.raises(InputError, match=name):
            assemble(Structure(law, filtered))
