"""The electromechanical actuator: against closed forms, limit cases and equations written down once more."""

from math import pi, sqrt

import numpy as np
import pytest
from flint import fmpq
from honest_certificates import screw

from beamdesign import InputError, Prototype, certify, checker, simulate, state_space, stiffness, tune
from beamdesign.checker.reading import Table
from beamdesign.checker.rig import Rig
from beamdesign.checker.stages import StateSpace as Stated
from beamdesign.controllers import Lag
from beamdesign.loop import close_loop
from beamdesign.parameters import typical_of
from beamdesign.plant.actuators.servo_cylinder import Servovalve, Supply
from beamdesign.plant.assembly import assemble, fits, parameters_of, structure_of
from beamdesign.plant.effects import causes
from beamdesign.plant.linear_reach import signals, single_compliance, with_mass
from beamdesign.plant.members import family
from beamdesign.proofs.bounded_error import numerators
from beamdesign.proofs.box import certify_box
from beamdesign.proofs.box_claims import claim_over_box
from beamdesign.proofs.certificate import Asked
from beamdesign.proofs.contact import Wall
from beamdesign.proofs.lyapunov import stages_certificate, switching
from beamdesign.proofs.mass_family import stage_families
from beamdesign.proofs.tolerance_box import tolerance_box
from beamdesign.proofs.writer import prototype_table, rig_tables
from beamdesign.prototype import Compliance, Goal, prototype_from
from beamdesign.records import to_toml
from beamdesign.scenario import Sampled, Scenario, ScenarioRecord, Sine, Step
from beamdesign.structure.lumped import figures
from beamdesign.synthesis.end_stiffness import controller_of, judge, sensed, servo_stiffness
from beamdesign.synthesis.operating_limits import demand, envelope, needs
from beamdesign.synthesis.stiffness_search import carried_out
from beamdesign.synthesis.tuning import limited
from beamdesign.time_limit import within
from beamdesign.validation.truth import laws

FELT = "screw_force_N"
W = 2 * pi * np.array([0.05, 0.7, 3.0, 12.0, 33.0, 90.0, 400.0, 2000.0])


@pytest.fixture
def rig() -> Prototype:
    """The published beams with a motor and a screw of 20 mm lead."""
    return screw()


def matrices(rig: Prototype, mass: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B and C from force and current to the tip: Newton's and Kirchhoff's laws, written down by hand.

    States are tip, nut, inner tip, their speeds and the motor's current; the nut's place is in space, not relative.
    """
    f, a = figures(rig), rig.actuator
    h, n = a.lead_m / (2 * pi), rig.payload.inner_end_mass_kg
    heavy = f["outer_mass"] + mass, f["inner_mass"] + n
    rows = np.zeros((7, 7))
    rows[:3, 3:6] = np.eye(3)
    spring = np.array([1.0, -1.0, -1.0])  # tip less nut's travel less inner tip
    outer, inner = np.array([1.0, 0, 0]), np.array([0, 0, 1.0])
    for held, of, at in (
        (-f["outer_stiffness"], f["outer_damping"], outer),
        (-f["inner_stiffness"], f["inner_damping"], inner),
    ):
        rows[3:6, :3] += held * np.outer(at, at)
        rows[3:6, 3:6] -= of * np.outer(at, at)
    axial = np.outer(spring, spring)
    rows[3:6, :3] -= a.screw_stiffness_N_per_m * axial
    rows[3:6, 3:6] -= a.screw_damping_N_s_per_m * axial
    rows[4, 4] -= a.rotor_friction_N_m_s_per_rad / h**2
    rows[4, 6] = a.torque_constant_N_m_per_A / h
    rows[3:6] /= np.array([heavy[0], a.rotor_inertia_kg_m2 / h**2, heavy[1]])[:, None]
    rate = 2 * pi * a.current_loop_Hz
    rows[6, 6], rows[6, 4] = -rate, -rate * a.speed_feedback_A_s_per_rad / h
    into = np.zeros((7, 2))
    into[3, 0], into[6, 1] = 1 / heavy[0], rate
    return rows, into, np.eye(7)[0]


@pytest.mark.parametrize("mass", [0.0, 6.8])
def test_the_linear_plant_is_that_of_equations_written_by_hand(rig: Prototype, mass: float) -> None:
    a, b, c = matrices(rig, mass)
    own = family(rig).rest.rig.matrices(mass, rig.payload.inner_end_mass_kg)
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(own[0])), np.sort_complex(np.linalg.eigvals(a)), rtol=1e-8
    )
    for w in W:
        ours, theirs = (z @ np.linalg.solve(1j * w * np.eye(7) - x, y) for x, y, z in (own, (a, b, c[None])))
        np.testing.assert_allclose(ours[0], theirs[0], rtol=1e-7)


@pytest.mark.parametrize("mass", [0.0, 6.8])
def test_compliance_and_travel_of_the_actuator_alone_give_the_same_loop(rig: Prototype, mass: float) -> None:
    a, b, c = matrices(rig, mass)
    outer = with_mass(single_compliance(rig, "outer_beam"), mass)
    inner = with_mass(single_compliance(rig, "inner_beam"), rig.payload.inner_end_mass_kg)
    found = signals(rig, outer, inner, W / (2 * pi))
    assert rig.controller is not None
    law = rig.controller.sensor_responses(W / (2 * pi))["displacement_m"]
    for k, w in enumerate(W):
        push, drive = c @ np.linalg.solve(1j * w * np.eye(7) - a, b)
        assert found.compliance[k] == pytest.approx(push, rel=1e-7)
        assert found.loop_per_gain[k] == pytest.approx(drive * law[k] * rig.sensor.gain_V_per_m, rel=1e-7)


def test_without_inertia_it_is_a_hydraulic_rig_in_other_units(rig: Prototype, paper: Prototype) -> None:
    """Bond graphs: lead for area, speed for flow, torque for pressure (Karnopp, Margolis, Rosenberg, System Dynamics).

    A = 1/h, K_q = K_t / (K_t k_w + b) and K_pq = 1 / (K_t k_w + b), where the rotor has next to no inertia and neither
    the current loop nor the valve a lag.
    """
    a = rig.actuator.but(rotor_inertia_kg_m2=1e-9, current_loop_Hz=1e5, screw_damping_N_s_per_m=0.0)
    h, slow = a.lead_m / (2 * pi), a.torque_constant_N_m_per_A * a.speed_feedback_A_s_per_rad
    slow += a.rotor_friction_N_m_s_per_rad
    f = {
        "oil_stiffness": a.screw_stiffness_N_per_m, "piston_area": 1 / h, "leakage": 1 / slow,
        "flow_gain": a.torque_constant_N_m_per_A / slow, "valve_frequency": 1e7, "valve_damping_ratio": 0.5,
    }  # fmt: skip
    s, own = 1j * W[:-1], figures(rig.but(actuator=a))
    np.testing.assert_allclose(a.compliance(own, s), paper.actuator.compliance(f, s), rtol=2e-3)
    np.testing.assert_allclose(a.travel(own, s), paper.actuator.travel(f, s), rtol=2e-2)


def test_what_a_held_load_takes_is_statics(rig: Prototype) -> None:
    """Current F h / K_t, stroke F / K_inner; a slow sine turns the rotor at w F / (K_inner h)."""
    taken = needs(rig, (0.0, 0.0), 1e-6, 0.05, 1500.0)
    h, inner = 0.02 / (2 * pi), figures(rig)["inner_stiffness"]
    assert taken["peak_current_A"] == pytest.approx(1500.0 * h / 1.2, rel=5e-3)
    assert rig.actuator.holding(rig, 1500.0)[1] == pytest.approx(1500.0 * h / 1.2)
    assert taken["stroke_m"] == pytest.approx(1500.0 / inner, rel=5e-3)
    moving = needs(rig, (0.0, 0.0), 1000.0, 0.05)
    assert moving["speed_rad_per_s"] == pytest.approx(2 * pi * 0.05 * 1000.0 / inner / h, rel=1e-2)
    assert moving["effective_current_A"] == pytest.approx(moving["peak_current_A"] / sqrt(2))
    assert taken["drive_command_V"] == pytest.approx(taken["peak_current_A"] / rig.actuator.drive_gain(), rel=5e-3)


@pytest.mark.parametrize(("frequency", "mass"), [(4.0, 0.0), (15.0, 6.8)])
def test_demands_are_those_of_a_simulated_record(rig: Prototype, frequency: float, mass: float) -> None:
    sine = Sine(amplitude_N=100.0, frequency_Hz=frequency, fade_s=0.2)
    row = ScenarioRecord(name="sine", input=(sine,), outer_end_mass_kg=mass, inner_end_mass_kg=2.0)
    plan = Scenario(name="sine", duration_s=1.0 + 4 / frequency, sample_s=1e-4, record=(row,))
    (record,) = simulate(rig, plan).records
    asked = demand(rig, mass, np.array([frequency]))
    last = slice(-round(2 / frequency / 1e-4), None)
    for name, expected in (
        ("displacement_m", asked["displacement"]),
        ("current_A", asked["current"]),
        ("screw_force_N", asked["force"]),
    ):
        assert np.ptp(record.column(name)[last]) / 2 == pytest.approx(100.0 * abs(expected[0]), rel=3e-3)


def test_each_rating_limits_the_load(rig: Prototype) -> None:
    rated = rig.actuator.but(
        peak_current_A=12.0, continuous_current_A=4.0, largest_speed_rad_per_s=300.0, stroke_m=0.04
    )
    limits = envelope(rig.but(actuator=rated), frequency_Hz=np.array([0.5])).limits_N
    h, inner = 0.02 / (2 * pi), figures(rig)["inner_stiffness"]
    assert limits["peak current"][0] == pytest.approx(12.0 * 1.2 / h, rel=2e-2)
    assert limits["continuous current"][0] == pytest.approx(sqrt(2) * 4.0 * 1.2 / h, rel=2e-2)
    weight = 9.80665 * (figures(rig)["inner_mass"] + rig.payload.inner_end_mass_kg)  # which takes of the stroke
    assert limits["stroke"][0] == pytest.approx(0.02 * inner - weight, rel=5e-3)
    assert limits["rotor speed"][0] == pytest.approx(300.0 * h * inner / pi, rel=1e-2)


def test_the_dynamic_load_rating_is_no_limit_of_the_force(rig: Prototype) -> None:
    """8 kN under 2 kN: 4^3 = 64 million turns by ISO 3408-5; a force above the rating only shortens that."""
    rated = rig.actuator.but(dynamic_load_N=8e3)
    taken = "peak_current_A", "effective_current_A", "speed_rad_per_s", "shaft_power_W", "drive_command_V"
    need = dict.fromkeys(taken, 1.0)
    rows = {row.name: row for row in rated.rows(rig, need | {"force_N": 2e3}, 2e3)}
    force, rating = rows["largest axial force on the screw"], rows["dynamic load rating of the screw C_a"]
    assert (force.needed, force.stated, force.basis) == (2e3, None, "computed")
    assert (rating.needed, rating.basis) == (8e3, "given")
    assert rows["turns at that force that nine screws of ten last"].needed == pytest.approx(64e6)


def test_every_drawn_rig_of_a_box_keeps_what_is_proved_of_it(rig: Prototype) -> None:
    """40 rigs of the box of typical tolerances, half of them corners, by the equations written by hand."""
    rig = rig.but(tolerance=typical_of(type(rig.actuator)))
    box = tolerance_box(rig, 1.0, outer_end_mass=(0.0, 4.0))
    asked = Asked("peak_sensitivity", 2.0), Asked("compliance", 1.2e-7, 2.0), Asked("gain_margin", 0.0)
    claims = [claim_over_box(rig, box, one) for one in asked]
    assert all(claim.holds for claim in claims), [claim.reason for claim in claims]
    text = certify_box(rig, box, volumes=False).write(claims)
    assert checker.check(text, prototype_table(rig)).valid
    random = np.random.default_rng(7)
    law, w = rig.controller, 2 * pi * np.geomspace(0.05, 3000.0, 4000)
    assert isinstance(law, Lag)
    c_of = law.gain_A_per_V * (1 + 1j * w / (2 * pi * law.zero_Hz)) / (1 + 1j * w / (2 * pi * law.pole_Hz))
    for k in range(40):
        share = random.integers(0, 2, 20) * 2.0 - 1 if k % 2 else random.uniform(-1, 1, 20)
        drawn = iter(share.tolist())
        a = rig.actuator
        beams = {
            name: beam.but(
                stiffness_N_per_m=figures(rig)[f"{name[:5]}_stiffness"] * (1 + 0.03 * next(drawn)),
                effective_mass_kg=figures(rig)[f"{name[:5]}_mass"] * (1 + 0.02 * next(drawn)),
                damping_ratio=beam.damping_ratio * (1 + 0.3 * next(drawn)),
            )
            for name, beam in (("outer_beam", rig.outer_beam), ("inner_beam", rig.inner_beam))
        }
        other = a.but(
            screw_stiffness_N_per_m=a.screw_stiffness_N_per_m * (1 + 0.15 * next(drawn)),
            screw_damping_N_s_per_m=a.screw_damping_N_s_per_m * (1 + 0.3 * next(drawn)),
            torque_constant_N_m_per_A=a.torque_constant_N_m_per_A * (1 + 0.05 * next(drawn)),
            rotor_inertia_kg_m2=a.rotor_inertia_kg_m2 * (1 + 0.05 * next(drawn)),
            rotor_friction_N_m_s_per_rad=a.rotor_friction_N_m_s_per_rad * (1 + 0.3 * next(drawn)),
            current_loop_Hz=a.current_loop_Hz * (1 + 0.1 * next(drawn)),
        )
        there = rig.but(**beams, actuator=other, guarantee=None)
        mass = 4.0 * random.random()
        rows, into, out = matrices(there, mass)
        response = np.linalg.solve(
            1j * w[:, None, None] * np.eye(7) - rows, np.broadcast_to(into, (len(w), 7, 2)).astype(complex)
        )
        push, drive = (out @ response[:, :, j].T for j in (0, 1))
        loop = drive * c_of * rig.sensor.gain_V_per_m * (1 + 0.005 * next(drawn))
        assert abs(1 / (1 + loop)).max() < 2.0
        assert abs(push / (1 + loop))[w < 2 * pi * 2.0].max() < 1.2e-7


def test_another_lead_or_actuator_is_another_rig(rig: Prototype) -> None:
    from honest_certificates import certified

    honest = certified(rig, (0.0, 2.0), ("peak_sensitivity", 2.5))
    others = (
        rig.but(actuator=rig.actuator.but(lead_m=0.0201)),
        rig.but(actuator=rig.actuator.but(screw_damping_N_s_per_m=601.0)),
        rig.but(actuator=rig.actuator.but(speed_feedback_A_s_per_rad=0.51)),
    )
    assert checker.check(honest.text, prototype_table(rig)).valid
    for other in others:
        assert not checker.check(honest.text, prototype_table(other)).valid


def test_the_checkers_state_space_has_the_poles_of_the_closed_loop(rig: Prototype) -> None:
    """Of both programs' ways to x' = A(m) x; a payload that changes is proved with it."""
    tables = rig_tables(rig)
    stated = Rig(Table(tables, ""))
    assert stated.law is not None
    found = Stated(stated, stated.law).matrix(fmpq(3))
    ours = np.array([[float(found[i, j]) for j in range(found.ncols())] for i in range(found.nrows())])
    expected = np.sort_complex(state_space(rig, 3.0).poles())
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(ours)), expected, rtol=1e-6)
    text = stages_certificate(rig, switching(stage_families(rig), 2.0, 2.5), "")
    assert checker.check(text, prototype_table(rig)).valid


def test_friction_on_the_nut_strays_by_no_more_than_its_impulse_response(rig: Prototype) -> None:
    """The integral of |h| by scipy's step through time; the polynomial that the bound rests on is that response."""
    model = family(rig).rest.rig
    above = numerators(rig, model, {"nut"})["nut"]
    a, b, c = matrices(rig, 0.0)
    h = rig.actuator.lead_m / (2 * pi)
    nut = np.zeros((7, 1))
    nut[4] = h**2 / rig.actuator.rotor_inertia_kg_m2
    law = rig.controller
    assert isinstance(law, Lag)
    for w in W[1:5]:
        inside = np.linalg.solve(1j * w * np.eye(7) - a, np.hstack([b, nut]))
        c_of = law.gain_A_per_V * (1 + 1j * w / (2 * pi * law.zero_Hz)) / (1 + 1j * w / (2 * pi * law.pole_Hz))
        expected = (c @ inside[:, 2]) / (1 + (c @ inside[:, 1]) * c_of * rig.sensor.gain_V_per_m)
        plant, of_law = model.plant(2.0), law.transfer_function()
        s = complex(0, w)

        def at(poly, s=s):
            return sum(float(one) * s**k for k, one in enumerate(poly.coeffs()))

        closed = at(plant.denominator.constant) * at(of_law.denominator) + at(plant.control[0].constant) * at(
            of_law.numerator
        )
        assert abs(at(above) / closed) == pytest.approx(abs(expected), rel=1e-6)


def test_what_is_proved_of_a_saturated_current_is_not_of_the_motors_own(rig: Prototype) -> None:
    """At a lower gain of law and speed feedback together, which a limit of the motor comes to, the loop is unstable."""
    a, b, c = matrices(rig, 0.0)
    feedback = np.outer(b[:, 1], a[6] / b[6, 1])
    feedback[:, 6] = 0.0  # of the speed alone, not the current's own decay
    law = rig.own_controller.control_model()
    fed = -rig.sensor.gain_V_per_m * np.outer(b[:, 1] * law.D[0, 0], c)

    def growth(of_law: float, of_feedback: float) -> float:
        held = a - (1 - of_feedback) * feedback
        over = -rig.sensor.gain_V_per_m * law.B @ c[None]
        whole = np.block([[held + of_law * fed, of_law * b[:, 1:] @ law.C], [over, law.A]])
        return float(np.linalg.eigvals(whole).real.max())

    assert all(growth(share, 1.0) < 0 for share in np.geomspace(1e-3, 1, 50))
    assert growth(0.05, 0.05) > 0
    (row,) = certify(rig, 0.0, 6.8, nonlinear=True).nonlinear
    assert row.proved
    assert "nothing is proved of the motor's own current" in row.covers


def test_a_motor_that_rubs_sticks(rig: Prototype) -> None:
    """Under a small sine the nut of a screw with dry friction stays behind, as a spring of presliding."""
    sine = Sine(amplitude_N=3.0, frequency_Hz=1.0, fade_s=0.2)
    row = ScenarioRecord(name="sine", input=(sine,), inner_end_mass_kg=2.0)
    plan = Scenario(name="sine", duration_s=3.0, sample_s=5e-4, record=(row,))
    free, rubbing = (
        simulate(rig.but(effects=effects), plan).records[0].column("displacement_m")
        for effects in ({}, {"seal_friction": {"coulomb_N": 400.0}})
    )
    assert np.ptp(rubbing[-2000:]) > 3 * np.ptp(free[-2000:])


@pytest.mark.parametrize("closing", [0.0, 0.02, -0.02])
def test_a_worn_nut_presses_with_one_flank_or_none(rig: Prototype, closing: float) -> None:
    """Spring and dashpot beyond half the play, never a pull; by the closed form, and by the truth model's own."""
    play, actuator = 50e-6, rig.actuator
    worn = rig.but(effects={"joint_backlash_nut": {"play_m": play}})
    assembly = assemble(structure_of(worn))
    parameters = np.array(list(parameters_of(worn, 0.0, 0.0).values()))
    x = np.zeros(len(assembly.states))
    x[assembly.states.index("travel_m_per_s")] = closing
    for stretch in np.linspace(-4 * play, 4 * play, 41) + 1e-9:
        x[assembly.states.index("travel_m")] = stretch
        outputs = np.ravel(assembly.function(0, x, np.zeros(3), parameters)[1].full())
        found = float(outputs[assembly.outputs.index(FELT)])
        depth, side = abs(stretch) - play / 2, np.sign(stretch)
        bearing = actuator.screw_stiffness_N_per_m * depth + actuator.screw_damping_N_s_per_m * side * closing
        assert found == pytest.approx(side * max(0.0, bearing) if depth > 0 else 0.0, abs=1e-6)
        stiffness, damping = actuator.screw_stiffness_N_per_m, actuator.screw_damping_N_s_per_m
        assert found == pytest.approx(laws.flanks(stretch, closing, play, stiffness, damping), abs=1e-6)


def test_effects_of_oil_and_valve_are_refused(rig: Prototype) -> None:
    own = {name for name in causes() if fits(name, rig.rig)}
    assert {
        "sensor_lag",
        "transport_delay",
        "joint_backlash",
        "seal_friction",
        "current_saturation",
        "mount_compliance",
    } <= own
    assert not own & {
        "entrained_air",
        "valve_deadband",
        "unequal_piston_areas",
        "pressure_dependent_flow",
        "uneven_leakage",
    }
    with pytest.raises(
        InputError, match=r"effects\.valve_deadband: acts on what a rig with a ball_screw does not have"
    ):
        family(rig.but(effects={"valve_deadband": {}}))


def test_tables_are_those_of_the_actuator(rig: Prototype) -> None:
    table = rig.model_dump(exclude_none=True)
    assert "supply" not in table
    assert "oil_stiffness" not in table["tolerance"]
    assert prototype_from(table) == rig
    valve = Servovalve(flow_gain_m3_per_s_per_A=0.01, leakage_m3_per_s_per_Pa=1e-13, natural_frequency_Hz=100.0)
    for wrong, words in (
        ({"servovalve": valve.model_dump(exclude_none=True)}, "servovalve: a ball_screw has none"),
        ({"supply": Supply(pressure_Pa=1e7).model_dump(exclude_none=True)}, "supply: a ball_screw has none"),
        ({"actuator": {"kind": "piezo"}}, "actuator: kind must be one of"),
        ({"actuator": table["actuator"] | {"lead_mm": 20.0}}, r"actuator\.lead_mm"),
    ):
        with pytest.raises(InputError, match=words):
            prototype_from(table | wrong)
    assert 'kind = "ball_screw"' in to_toml(rig)


def test_a_law_hears_what_there_is_to_feel(rig: Prototype, paper: Prototype) -> None:
    with pytest.raises(InputError, match="load_pressure_Pa, which a rig with a ball_screw does not have"):
        tune(rig, (0.0, 2.0), "lqg", sensors=("displacement_m", "load_pressure_Pa"))
    with pytest.raises(InputError, match="it has load_pressure_Pa"):
        tune(paper, (0.0, 2.0), "lqg", sensors=("displacement_m", "screw_force_N"))


def test_laws_of_high_order_are_not_held_to_the_current_of_a_valve(rig: Prototype, paper: Prototype) -> None:
    """The least that the rig's own lag asks of the motor, at high frequency, is far above what a valve bears."""
    assert isinstance(rig.controller, Lag)
    least = rig.controller.gain_A_per_V * min(1.0, rig.controller.pole_Hz / rig.controller.zero_Hz)
    assert least > 10 * 0.06
    for kind in ("structured", "lqg", "hinf"):
        assert limited(rig.but(goal=Goal()), kind).goal.loop_gain == 0.25
        assert limited(rig.but(goal=Goal()), kind).goal.controller_effort_A_per_V is None
        assert limited(paper.but(goal=Goal()), kind).goal.controller_effort_A_per_V == 0.06
    stated = rig.but(goal=rig.goal.but(controller_effort_A_per_V=9.0))
    assert limited(stated, "structured").goal.controller_effort_A_per_V == 9.0


@pytest.fixture
def compliant(rig: Prototype) -> Compliance:
    """The rig's own lag, the end twice as stiff as its outer beam."""
    assert isinstance(rig.controller, Lag)
    stiffness = 2 * figures(rig)["outer_stiffness"]
    return Compliance(end_stiffness_N_per_m=stiffness, force_filter_Hz=10.0, servo=rig.controller)


@pytest.mark.parametrize("mass", [0.0, 6.8])
def test_an_end_with_a_screw_yields_as_its_parts_say(rig: Prototype, compliant: Compliance, mass: float) -> None:
    """Against the matrices written by hand, closed at each frequency with what the law is by its formula.

    At rest the nut stands still under K_t / h per ampere, so that the servo alone is K_m + (K_t / h) K F_s.
    """
    f, a, servo = figures(rig), rig.actuator, compliant.servo
    h, volts = a.lead_m / (2 * pi), rig.sensor.gain_V_per_m
    alone = f["outer_stiffness"] + a.torque_constant_N_m_per_A / h * servo.gain_A_per_V * volts
    assert servo_stiffness(rig, servo) == pytest.approx(alone, rel=1e-12)
    closed_end = close_loop(sensed(rig), controller_of(rig, compliant)).at(mass)
    assert closed_end.static_stiffness() == pytest.approx(compliant.end_stiffness_N_per_m, rel=1e-12)

    rows, into, at_tip = matrices(rig, mass)
    stretch = np.array([-1.0, 1.0, 1.0])  # nut's travel and inner tip less tip
    force = np.concatenate([a.screw_stiffness_N_per_m * stretch, a.screw_damping_N_s_per_m * stretch, [0.0]])
    moved = (1 / compliant.end_stiffness_N_per_m - 1 / alone) / (1 - f["outer_stiffness"] / alone)
    for w in W:
        law = servo.gain_A_per_V * (1 + 1j * w / (2 * pi * servo.zero_Hz)) / (1 + 1j * w / (2 * pi * servo.pole_Hz))
        seen = volts / (1 + 1j * w / f["filter_frequency"]) if f["filter_frequency"] else volts
        behind = moved * volts / (1 + 1j * w / (2 * pi * compliant.force_filter_Hz))
        heard = -seen * at_tip + behind * (f["outer_stiffness"] * seen / volts * at_tip - force)
        closed = 1j * w * np.eye(7) - rows - np.outer(into[:, 1], law * heard)
        yields = np.linalg.solve(closed, into[:, 0])[0]
        assert closed_end.stiffness_response(np.array([w / (2 * pi)]))[0] == pytest.approx(1 / yields, rel=1e-7)


def test_an_end_with_a_screw_is_proved_and_simulated(rig: Prototype, compliant: Compliance) -> None:
    """The checker, which builds the force of the screw itself, proves loop and contact again; at rest x = F / k."""
    found = judge(rig, compliant, (0.0, 6.8), Wall((fmpq(0), fmpq(10**9))))
    made = carried_out(rig, found)
    assert found.stable
    assert made.prototype.controller.senses == ("displacement_m", "screw_force_N")
    for text in (made.certificate.text, made.contact):
        outcome = checker.check(text, prototype_table(made.prototype))
        assert outcome.valid, outcome.failed
    softer = f"{0.9 * rig.actuator.screw_stiffness_N_per_m:.10g}"
    assert not checker.check(made.contact.replace("80000000", softer, 1), prototype_table(made.prototype)).valid
    push = ScenarioRecord(name="push", outer_end_mass_kg=2.0, input=(Step(amplitude_N=20.0, at_s=0.01),))
    for sampled in (None, Sampled(period_s=1e-3)):
        scenario = Scenario(name="rest", duration_s=1.0, sample_s=1e-3, record=(push,), sampled=sampled)
        (record,) = simulate(made.prototype, scenario).records
        at_rest, force = (record.column(name)[-200:].mean() for name in ("displacement_m", "screw_force_N"))
        assert at_rest == pytest.approx(20.0 / compliant.end_stiffness_N_per_m, rel=2e-3)
        assert force == pytest.approx(figures(rig)["outer_stiffness"] * at_rest - 20.0, rel=2e-3)


def test_a_gain_for_an_end_stiffness_is_sought_within_what_a_law_may_have(rig: Prototype) -> None:
    """With a sensor of 20 V/m three powers of ten above the least gain are beyond 10 kA/V."""
    slow = rig.but(sensor=rig.sensor.but(gain_V_per_m=20.0))
    with within(0.03):
        found = stiffness(slow, 3e5, (0.0, 1.0), contact="none", rigs=0)
    assert found.tried
    servo = found.prototype.compliance.servo if found.prototype else None
    assert servo is None or servo.gain_A_per_V <= 1e4
