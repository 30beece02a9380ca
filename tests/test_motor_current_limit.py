"""A limit of the motor's own current, against equations of motion written down once more and solved by scipy."""

import tomllib
from math import inf, pi
from pathlib import Path

import numpy as np
import pytest
from forging import altered, resealed
from gap_sets import measured
from honest_certificates import screw
from scipy.integrate import odeint

from beamdesign import InputError, Prototype, certify, checker, read_prototype, simulate
from beamdesign.checker.reading import Unreadable
from beamdesign.controllers import Lag
from beamdesign.diagnosis.fitting.evidence import record_evidence
from beamdesign.diagnosis.fitting.hypothesis import singles, together
from beamdesign.diagnosis.fitting.starts import fit_from_starts
from beamdesign.loop import drive_loop
from beamdesign.parameters import typical_of
from beamdesign.plant.assembly import effect_parameters_of
from beamdesign.plant.linearised import linear_assembly
from beamdesign.plant.members import family
from beamdesign.proofs.absolute_stability import absolute_stability, static_rows
from beamdesign.proofs.certificate import Row
from beamdesign.proofs.scope import members
from beamdesign.proofs.writer import prototype_table
from beamdesign.scenario import Measurement, Multisine, Scenario, ScenarioRecord, Sine
from beamdesign.structure.lumped import figures
from beamdesign.synthesis.operating_limits import envelope, needs

NAME = "motor_current_limit"
TIP, NUT, INNER, SPEEDS, MOTOR, SLOW = 0, 1, 2, slice(3, 6), 6, 7


@pytest.fixture
def hasty() -> Prototype:
    """A lag of 800 A/V that rests after 1 kN for 50 ms, and after 4 kN swings at its motor's 30 A for good."""
    return screw().but(effects={NAME: {}})


@pytest.fixture
def tame() -> Prototype:
    """A rig with a cylinder."""
    return read_prototype(Path(__file__).parents[1] / "studies/prototypes/tame_lag.toml")


@pytest.fixture
def calm(hasty: Prototype) -> Prototype:
    """The same with four times the speed feedback."""
    return hasty.but(actuator=hasty.actuator.but(speed_feedback_A_s_per_rad=2.0))


def moved(rig, mass, limit, force, start, seconds, points=200):
    """Newton's second law of tip, nut and inner tip, and the motor's current; (points, 8, N) from states (8, N).

    States are the places of tip, nut and inner tip in space (m), their speeds, the motor's current and what the lag has
    of the error (V); force (N) is a function of time.
    """
    f, a, law = figures(rig), rig.actuator, rig.controller
    h, volts, slow, fast = a.lead_m / (2 * pi), rig.sensor.gain_V_per_m, 2 * pi * law.pole_Hz, 2 * pi * law.zero_Hz
    outer, inner = f["outer_mass"] + mass, f["inner_mass"] + rig.payload.inner_end_mass_kg

    def rates(x, demand, push):
        tip_speed, nut_speed, inner_speed = x[SPEEDS]
        stretch, rate = x[NUT] + x[INNER] - x[TIP], nut_speed + inner_speed - tip_speed
        axial = a.screw_stiffness_N_per_m * stretch + a.screw_damping_N_s_per_m * rate
        torque = a.torque_constant_N_m_per_A * x[MOTOR] - a.rotor_friction_N_m_s_per_rad * nut_speed / h - h * axial
        outer_beam = f["outer_stiffness"] * x[TIP] + f["outer_damping"] * tip_speed
        inner_beam = f["inner_stiffness"] * x[INNER] + f["inner_damping"] * inner_speed
        return np.array([
            tip_speed, nut_speed, inner_speed,
            (axial + push - outer_beam) / outer, h * torque / a.rotor_inertia_kg_m2, (-axial - inner_beam) / inner,
            2 * pi * a.current_loop_Hz * (demand - x[MOTOR]), slow * (-volts * x[TIP] - x[SLOW]),
        ])  # fmt: skip

    def asked(x):
        by_law = law.gain_A_per_V * (x[SLOW] + slow / fast * (-volts * x[TIP] - x[SLOW]))
        return by_law - a.speed_feedback_A_s_per_rad * x[NUT + 3] / h

    # They are linear but for the limit: columns are what they make of each state, of a demand and of a push alone.
    unit, none = np.eye(8), np.zeros(8)
    own, by_demand, by_push, demands = rates(unit, 0.0, 0.0), rates(none, 1.0, 0.0), rates(none, 0.0, 1.0), asked(unit)

    def limited(t, x):
        return own @ x + by_demand * min(max(demands @ x, -limit), limit) + by_push * force(t)

    at, hmax = np.linspace(0.0, seconds, points), seconds / points
    found = [odeint(limited, one, at, tfirst=True, rtol=1e-7, atol=1e-9, hmax=hmax, mxstep=50_000) for one in start.T]
    return np.stack(found, axis=2)


def rows_of(rig: Prototype) -> dict[tuple[str, ...], Row]:
    """What `certify --nonlinear` says over the payloads, by effects."""
    return {row.effects: row for row in certify(rig, 0.0, 6.8, nonlinear=True).nonlinear}


def test_a_simulated_record_is_that_of_the_equations_of_motion(hasty: Prototype) -> None:
    """A sine of 3 kN that asks for more than 6 A most of the time, and would move the tip otherwise without a limit."""
    rig = hasty.but(effects={NAME: {"limit_A": 6.0}}, sensor=hasty.sensor.but(filter_Hz=None))
    sine = Sine(amplitude_N=3000.0, frequency_Hz=3.0, fade_s=0.0)
    row = ScenarioRecord(name="sine", outer_end_mass_kg=2.0, inner_end_mass_kg=2.0, input=(sine,))
    (record,) = simulate(rig, Scenario(name="sine", duration_s=0.5, sample_s=1e-3, record=(row,))).records
    seen, count = record.column("displacement_m"), len(record.samples)

    def driven(limit):
        wave = lambda t: 3000.0 * np.sin(2 * pi * 3.0 * t)  # noqa: E731
        return moved(rig, 2.0, limit, wave, np.zeros((8, 1)), 1e-3 * (count - 1), count)[:, TIP, 0]

    limited, free = driven(6.0), driven(inf)
    np.testing.assert_allclose(seen, limited, atol=1e-3 * abs(limited).max())
    assert abs(limited - free).max() > 0.3 * abs(limited).max()


@pytest.mark.parametrize(("mass", "load"), [(0.0, 0.0), (6.8, 2000.0)])
def test_what_is_proved_to_come_to_rest_does(calm: Prototype, mass: float, load: float) -> None:
    """From states far beyond the limit, to where K_m x and the motor's K_t i / h hold the load together."""
    size = np.array([0.05, 0.05, 0.05, 5.0, 5.0, 5.0, 30.0, 60.0])[:, None]
    start = size * np.random.default_rng(3).choice([-1.0, -0.4, 0.4, 1.0], (8, 4))
    tip = moved(calm, mass, 10.0, lambda t: load, start, 2.0)[:, TIP]
    assert np.ptp(tip[:20], axis=0).min() > 0.01
    servo = calm.actuator.torque_constant_N_m_per_A * 2 * pi / calm.actuator.lead_m
    servo *= calm.own_controller.gain_A_per_V * calm.sensor.gain_V_per_m
    np.testing.assert_allclose(tip[-20:], load / (figures(calm)["outer_stiffness"] + servo), atol=1e-6)


def test_what_is_not_proved_swings_for_good(hasty: Prototype) -> None:
    """It is stable at a tenth of the gain of law and feedback together and at no less, by the equations as matrices."""
    row = rows_of(hasty)[(NAME,)]
    assert not row.proved
    assert "unstable at a gain below 0.1003 times its own with an outer end mass of 0 kg" in row.covers
    assert "law and speed feedback together" in row.covers
    law, a = hasty.controller, hasty.actuator
    assert isinstance(law, Lag)

    def growth(share: float) -> float:
        less = hasty.but(
            controller=law.but(gain_A_per_V=share * law.gain_A_per_V),
            actuator=a.but(speed_feedback_A_s_per_rad=share * a.speed_feedback_A_s_per_rad),
        )
        unit = moved(less, 0.0, inf, lambda t: 0.0, np.eye(8), 1e-3, 2)[-1]  # exp(A t)
        return float(abs(np.linalg.eigvals(unit)).max())

    assert growth(0.0990) > 1 > growth(0.1016)
    swings = [
        np.ptp(moved(hasty, 0.0, 30.0, lambda t, push=push: push * (t < 0.05), np.zeros((8, 1)), 2.5)[-40:, TIP])
        for push in (1e3, 4e3)
    ]
    assert swings[0] < 1e-5
    assert swings[1] == pytest.approx(0.26, abs=0.01)


def test_nothing_is_said_to_be_left_aside_that_is_proved(calm: Prototype, hasty: Prototype) -> None:
    """Of the law's current alone the sentence stands where its motor's limit is not proved, or not asked for."""
    law, left = ("current_saturation",), "nothing is proved of the motor's own current"
    proved = rows_of(calm)
    assert all(row.proved for row in proved.values())
    assert left not in proved[law].covers
    for rig in (hasty, calm.but(effects={})):
        row = rows_of(rig)[law]
        assert row.proved
        assert left in row.covers
    both = rows_of(calm.but(effects={NAME: {}, "current_saturation": {}}))[(*law, NAME)]
    assert not both.proved
    assert "Both places at once are not covered" in both.covers


def test_the_check_proves_it_again_and_no_more(calm: Prototype, tame: Prototype) -> None:
    """The multiplier of the motor fits neither the law's current nor a drive that feeds back less."""
    text = certify(calm, 0.0, 6.8, nonlinear=True).text
    outcome = checker.check(text, prototype_table(calm))
    assert outcome.valid, outcome.failed
    assert any("comes to rest" in line and "motor's current" in line for line in outcome.proved)
    tables = tomllib.loads(text)
    (place,) = (k for k, one in enumerate(tables["nonlinear"]) if one.get("place") == "motor")
    del tables["nonlinear"][place]["place"]
    assert not checker.check(resealed(tables)).valid
    other = altered(text, ("rig", "speed_feedback_A_s_per_rad"), "0.5")
    assert "its motor's current" in "".join(checker.check(other).failed)
    hydraulic = tomllib.loads(certify(tame, 0.0, 6.8, nonlinear=True).text)
    hydraulic["nonlinear"][0]["place"] = "motor"
    with pytest.raises(Unreadable, match="a rig without a screw has no motor"):
        checker.check(resealed(hydraulic))


def test_beside_friction_each_loop_has_a_multiplier_of_its_own(calm: Prototype) -> None:
    """One slides and one sticks; a certificate of both is among those that are forged."""
    given = members(calm.but(effects={NAME: {}, "seal_friction": {}}), 0.0, 6.8)
    loops = [drive_loop(given.prototype, member) for member in given.found.members]
    together, _ = absolute_stability(loops, given.low, given.high)
    assert together is None
    rows = [row for row in static_rows(given) if row.effects == (NAME,)]
    assert [row.proved for row in rows] == [True, True]
    assert [row.statement["loops"] for row in rows if row.statement] == [[1], [2]]
    assert "for every payload that stays with seal_friction.spring_N_per_m = 0" in rows[0].covers


def test_the_linear_loop_is_as_it_is_without(calm: Prototype) -> None:
    (member,), (bare,) = family(calm).members, family(calm.but(effects={})).members
    assert member == bare
    with_it, without = (linear_assembly(False, names, "ball_screw") for names in ((NAME,), ()))
    assert with_it.states == without.states


def test_it_is_a_cause_for_a_rig_with_a_screw_alone(calm: Prototype, tame: Prototype) -> None:
    assert NAME in {name for one in singles(calm.but(effects={})) for name in one.names}
    assert NAME not in {name for one in singles(tame) for name in one.names}
    with pytest.raises(InputError, match=rf"effects\.{NAME}: acts on what a rig with a servo_cylinder does not have"):
        family(tame.but(effects={NAME: {}}))


def test_the_motors_peak_is_its_limit_where_nothing_else_is_said(calm: Prototype) -> None:
    """And a stated limit is what there is of a peak current: K_t L / h at low frequencies."""
    rated = calm.but(actuator=calm.actuator.but(peak_current_A=12.0))
    assert effect_parameters_of(rated)[NAME] == {"limit_A": 12.0}
    assert effect_parameters_of(calm)[NAME] == {"limit_A": 30.0}
    limited = rated.but(effects={NAME: {"limit_A": 7.0}})
    for rig, most in ((rated, 12.0), (limited, 7.0)):
        at = envelope(rig, frequency_Hz=np.array([0.5])).limits_N["peak current"][0]
        assert at == pytest.approx(most * 1.2 * 2 * pi / 0.02, rel=2e-2)
        rows = rig.actuator.rows(rig, needs(rig, (0.0, 0.0), 1e-6, 0.05, 1500.0), 1500.0)
        (row,) = (row for row in rows if row.key == "peak_current_A")
        assert row.stated == most
        assert rig.actuator.largest_current_A(rig) == 12.0  # of the law


def test_the_limit_is_found_from_a_record(calm: Prototype) -> None:
    """A motor of 8 A whose drive gives 3 A; no limit of the law's current makes up for that."""
    rig = calm.but(
        effects={}, actuator=calm.actuator.but(peak_current_A=8.0), tolerance=typical_of(type(calm.actuator))
    )
    law, sines = rig.own_controller, Multisine(amplitude_N=1000.0, low_Hz=3.0, high_Hz=200.0, seed=4)
    row = ScenarioRecord(name="push", inner_end_mass_kg=2.0, input=(sines,), controller=law)
    noise = Measurement(seed=3, displacement_std_m=5e-7)
    plan = Scenario(name="push", duration_s=0.4, sample_s=1e-3, measurement=noise, record=(row,))
    pieces = record_evidence(measured(rig.but(effects={NAME: {"limit_A": 3.0}}), plan, rig))
    found, other = (fit_from_starts(together(name), rig, pieces, {}) for name in (NAME, "current_saturation"))
    assert found.values[f"{NAME}.limit_A"] == pytest.approx(3.0, rel=0.01)
    assert found.misfit < 1.5 * sum(piece.expected for piece in pieces) < 0.1 * other.misfit


@pytest.mark.parametrize("eased", ["a quarter of the gain", "ten times the friction"])
def test_less_gain_or_more_friction_makes_up_for_the_feedback_that_is_lost(hasty: Prototype, eased: str) -> None:
    law, a = hasty.own_controller, hasty.actuator
    rig = hasty.but(controller=law.but(gain_A_per_V=law.gain_A_per_V / 4))
    if "friction" in eased:
        rig = hasty.but(actuator=a.but(rotor_friction_N_m_s_per_rad=10 * a.rotor_friction_N_m_s_per_rad))
    assert rows_of(rig)[(NAME,)].proved
