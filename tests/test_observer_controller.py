"""Controllers of several sensors: from their record to what is proved, replayed and simulated of them."""

import tomllib
from math import inf, pi
from pathlib import Path

import control
import numpy as np
import pytest
from flint import fmpq, fmpq_poly
from forging import altered
from loop_effort import effort_response
from plane_at_payload import at_tip
from truth_of_arm_plane import Plane
from typer.testing import CliRunner

from beamdesign import (
    InputError,
    Prototype,
    certify,
    check,
    critical_gain,
    read_prototype,
    simulate,
    state_space,
    write_prototype,
)
from beamdesign.build.realisation.realise import realise
from beamdesign.checker import Unreadable
from beamdesign.checker.roots import stable_on_rectangle
from beamdesign.cli import app
from beamdesign.controllers import SENSED, Lag, Observer
from beamdesign.loop import Loop, loop
from beamdesign.plant.linear_reach import signals, single_compliance, with_mass
from beamdesign.plant.members import family, paper_model
from beamdesign.polynomial import Affine, exact
from beamdesign.proofs.arm import plane_loop
from beamdesign.proofs.arm.result import certify_plane
from beamdesign.proofs.box import certify_box
from beamdesign.proofs.certificate import Asked, Certificate
from beamdesign.proofs.performance import prove
from beamdesign.proofs.rectangle import Rectangle
from beamdesign.proofs.stability import is_stable_over
from beamdesign.proofs.tolerance_box import tolerance_box
from beamdesign.proofs.writer import prototype_table
from beamdesign.prototype import Arm, Goal
from beamdesign.scenario import Sampled, Scenario, ScenarioRecord, Step
from beamdesign.structure.lumped import figures
from beamdesign.synthesis.law_design import LoopSet

MASSES_KG = (0.0, 6.8)
FREQUENCIES_HZ = np.geomspace(0.1, 600.0, 300)
SLOW, FAST = 2 * pi * 1.75, 2 * pi * 3.0  # rad/s
LAW = Observer(
    gain_A_per_V=0.1,
    sensors=SENSED,
    a=((-SLOW, 0.05), (0.0, -FAST)),
    b=((SLOW, 2.0, 1e-9), (0.0, 30.0, 1e-6)),
    c=(1.0, -1e-3 * FAST),
    d=(0.07, 1.0, 1e-9),
)
"""A lag, and what the pressure varies by beyond 3 Hz against the resonances (dynamic pressure feedback)."""


@pytest.fixture(scope="module")
def bare() -> Prototype:
    """The published remedy without effects."""
    path = Path(__file__).parent.parent / "studies/prototypes/paper_remedy.toml"
    return read_prototype(path).but(effects={}, payload={"outer_end_mass_kg": MASSES_KG, "inner_end_mass_kg": 4.5})


@pytest.fixture(scope="module")
def rig(bare: Prototype) -> Prototype:
    """The same with all three sensors fed back, and its sensor filter."""
    return bare.but(controller=LAW, sensor=bare.sensor.but(filter_Hz=400.0))


def as_observer(lag: Lag) -> Observer:
    """A lag by its matrices: z is the error through its pole."""
    pole, share = 2 * pi * lag.pole_Hz, lag.pole_Hz / lag.zero_Hz
    return Observer.of(lag.gain_A_per_V, ["displacement_m"], [[-pole]], [[pole * (1 - share)]], [1.0], [share])


def closed_by_hand(prototype: Prototype, mass: float) -> tuple[np.ndarray, ...]:
    """A, B and C of the closed loop from force and command to displacement and current.

    The plant's matrices are the linear rig's own, which other tests hold against the paper; what the added sensors
    read, and the feedback, are written here.
    """
    law = prototype.controller
    assert isinstance(law, Observer)
    a, b, c = paper_model(prototype).matrices(mass, prototype.payload.inner_end_mass_kg)
    figure, n, k = figures(prototype), len(a), law.order
    inner, pressure = np.zeros(n), np.zeros(n)
    inner[3] = 1.0  # of linearised.STATES
    pressure[[2, 0]] = np.array([1, -1]) * figure["oil_stiffness"] / figure["piston_area"]
    sensed = np.array([{"displacement_m": c[1], SENSED[1]: inner, SENSED[2]: pressure}[s] for s in law.sensors])
    la, lb = np.reshape(law.a, (k, k)), np.reshape(law.b, (k, len(sensed)))
    lc, ld = law.gain_A_per_V * np.array([law.c]), law.gain_A_per_V * np.array([law.d])
    closed = np.block([[a - b[:, 1:] @ ld @ sensed, b[:, 1:] @ lc.reshape(1, k)], [-lb @ sensed, la]])
    drive = np.block([[b[:, :1], b[:, 1:] @ ld[:, :1]], [np.zeros((k, 1)), lb[:, :1]]])
    return closed, drive, np.vstack([np.append(c[0], np.zeros(k)), np.hstack([-ld @ sensed, lc.reshape(1, k)])[0]])


def response(matrices: tuple[np.ndarray, ...]) -> np.ndarray:
    """(f, outputs, inputs) at `FREQUENCIES_HZ`, direct terms left out."""
    a, b, c = matrices
    pencil = 2j * pi * FREQUENCIES_HZ[:, None, None] * np.eye(len(a)) - a
    return np.asarray(c @ np.linalg.solve(pencil, np.broadcast_to(b.astype(complex), (len(pencil), *b.shape))))


def test_a_lag_written_in_matrices_is_that_lag(bare: Prototype) -> None:
    """The same characteristic polynomial up to a factor, and the same proved figures."""
    lag = Lag(gain_A_per_V=0.08, pole_Hz=1.75, zero_Hz=26.0)
    one, other = bare.but(controller=lag), bare.but(controller=as_observer(lag))
    first, second = loop(one), loop(other)
    for mass in (exact(0.0), exact(3.3)):
        p, q = first.characteristic.at(mass), second.characteristic.at(mass)
        factor = q[q.degree()] / p[p.degree()]
        # The figures in rad/s are decimals of floats, so that the two agree to their rounding.
        assert all(abs(float(q[k] / (factor * p[k]) - 1)) < 1e-14 for k in range(p.degree() + 1))
    asked = [Asked("decay_rate", 1.0), Asked("controller_effort", 0.2), Asked("gain_margin", 1.4)]
    found, expected = (certify(prototype, *MASSES_KG, asked) for prototype in (other, one))
    assert found.stable
    assert found.guaranteed == expected.guaranteed
    assert [claim.holds for claim in found.claims] == [claim.holds for claim in expected.claims]
    assert check(found.text).valid
    assert critical_gain(other).gain_A_per_V == pytest.approx(critical_gain(one).gain_A_per_V, rel=1e-12)
    np.testing.assert_allclose(
        as_observer(lag).sensor_responses(FREQUENCIES_HZ)["displacement_m"],
        lag.sensor_responses(FREQUENCIES_HZ)["displacement_m"],
        rtol=1e-12,
    )
    assert as_observer(lag).gain_at_high_frequency() == pytest.approx(lag.gain_at_high_frequency())


@pytest.mark.parametrize("sensors", [SENSED, SENSED[::2], ("displacement_m", *SENSED[:0:-1])])
@pytest.mark.parametrize("mass", [0.0, 2.37, 6.8])
def test_the_loop_is_that_of_its_matrices(rig: Prototype, sensors: tuple, mass: float) -> None:
    """Poles, compliance, effort and sensitivity, at masses other than the two the polynomials are made from."""
    columns = [SENSED.index(name) for name in sensors]
    law = LAW.but(
        sensors=sensors, b=tuple(tuple(row[k] for k in columns) for row in LAW.b), d=tuple(LAW.d[k] for k in columns)
    )
    prototype = rig.but(controller=law)
    here, matrices = loop(prototype).at(mass), closed_by_hand(prototype, mass)
    poles = np.sort_complex(np.linalg.eigvals(matrices[0]))
    np.testing.assert_allclose(np.sort_complex(here.poles()), poles, rtol=0, atol=1e-8 * np.abs(poles).max())
    seen = response(matrices)
    np.testing.assert_allclose(here.compliance_response(FREQUENCIES_HZ), seen[:, 0, 0], rtol=1e-8)
    through = law.gain_A_per_V * law.d[0]
    np.testing.assert_allclose(effort_response(here, FREQUENCIES_HZ), seen[:, 1, 1] + through, rtol=1e-8)
    a, b, c = paper_model(prototype).matrices(mass, 4.5)
    plant = control.ss(a, b[:, 1:], c[[k + 1 for k in columns]], 0)
    s = 2j * pi * FREQUENCIES_HZ
    around = np.einsum("pkf,kpf->f", plant(s), law.control_model()(s))
    np.testing.assert_allclose(here.loop_response(FREQUENCIES_HZ), around, rtol=1e-8)
    np.testing.assert_allclose(here.sensitivity_response(FREQUENCIES_HZ), 1 / (1 + around), rtol=1e-8)


def test_what_is_fed_back_of_added_sensors_depends_on_the_mass(rig: Prototype) -> None:
    found = loop(rig)
    assert not found.gain_and_mass_apart
    assert loop(rig.but(controller=LAW.but(sensors=SENSED[:1], b=((SLOW,), (0.0,)), d=(0.07,)))).gain_and_mass_apart
    # A mass on the tip is a force -m s^2 x there: the slope of the characteristic is s^2 times the compliance's top.
    assert found.characteristic.slope == found.disturbance * exact(1.0) * type(found.disturbance)([0, 0, 1])
    plant = paper_model(rig).plant(4.5, SENSED)
    plain = paper_model(rig).plant(4.5)
    assert (plant.denominator, plant.control[0], plant.disturbance) == (
        plain.denominator,
        plain.control[0],
        plain.disturbance,
    )
    assert plant.control[0].slope.is_zero()
    assert plant.crossed[0].is_zero()


def test_responses_of_the_law_are_those_of_its_polynomials() -> None:
    s = 2j * pi * FREQUENCIES_HZ
    law, found = LAW.sensed_law(), LAW.sensor_responses(FREQUENCIES_HZ)

    def value(polynomial) -> np.ndarray:
        return np.polyval([float(c) for c in polynomial.coeffs()[::-1]], s)

    for name, numerator in zip(law.sensors, law.numerators, strict=True):
        np.testing.assert_allclose(LAW.gain_A_per_V * found[name], value(numerator) / value(law.denominator), rtol=1e-9)
    with pytest.raises(InputError, match="'observer' is not for one transfer function"):
        LAW.transfer_function()


@pytest.fixture(scope="module")
def proved(rig: Prototype) -> Certificate:
    asked = [Asked("decay_rate", 1.0), Asked("loop_gain", 0.75, from_Hz=200.0), Asked("controller_effort", 0.072)]
    return certify(rig, *MASSES_KG, [*asked, Asked("peak_sensitivity", 2.0), Asked("compliance", 5.71e-8, 40.0)])


def test_proved_figures_are_those_of_a_dense_grid(rig: Prototype, proved: Certificate) -> None:
    found = proved.guaranteed
    assert proved.stable
    assert found is not None
    peaks, bandwidths = zip(
        *(
            (here.peak_sensitivity(), here.bandwidth_Hz(rig.goal.compliance_m_per_N))
            for here in (loop(rig).at(float(mass)) for mass in np.linspace(*MASSES_KG, 18))
        ),
        strict=True,
    )
    assert found.peak_sensitivity * (1 - 1e-3) < max(peaks) <= found.peak_sensitivity
    assert found.bandwidth_Hz <= min(bandwidths) < found.bandwidth_Hz * (1 + 1e-3)
    assert [claim.holds for claim in proved.claims] == [True, True, True, False, False]


def test_the_certificate_is_proved_again_from_its_matrices(proved: Certificate) -> None:
    assert check(proved.text).valid


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("controller", "d", 1), "1.01"),
        (("controller", "b", 0, 0), "11.9"),
        (("controller", "a", 0, 0), "-0.06"),
        (("controller", "sensors", 0), "load_pressure_Pa"),
        (("controller", "gain_A_per_V"), "0.11"),
        (("controller", "law", "denominator", 0), "3"),
        (("loop", 0, "returned_slope", 0), "1"),
        (("rig", "piston_area_m2"), "0.000114"),
    ],
)
def test_a_tampered_certificate_is_not(proved: Certificate, place: tuple[str | int, ...], value: str) -> None:
    """Whoever alters an entry and puts the checksum right is found out by the polynomials."""
    try:
        found = check(altered(proved.text, place, value))
    except Unreadable:
        assert place[-2:] == ("sensors", 0)
    else:
        assert any("polynomials" in words for words in found.failed)


@pytest.mark.parametrize(
    "effects",
    [
        {"second_beam_mode": {}},
        {"second_beam_mode": {}, "sensor_lag": {}, "mount_compliance": {}, "transport_delay": {}},
        {"joint_backlash": {}, "seal_friction": {}, "entrained_air": {}},
    ],
)
def test_with_linear_effects(bare: Prototype, effects: dict) -> None:
    """Members against the matrices of the assembled rig, and their certificate against its replay."""
    prototype = bare.but(controller=LAW, effects=effects)
    found = certify(prototype, 1.0, 3.0, [Asked("loop_gain", 5.0, from_Hz=300.0), Asked("decay_rate", 0.1)])
    assert check(found.text).valid
    rest = family(prototype).rest
    for mass in (0.0, 4.7):
        a, b, c = rest.rig.matrices(mass, 4.5)
        sensed = c[1:]
        n, k = len(a), LAW.order
        drive = b[:, 1:] * LAW.gain_A_per_V
        closed = np.block(
            [
                [a - drive @ np.array([LAW.d]) @ sensed, drive @ np.array([LAW.c])],
                [-np.array(LAW.b) @ sensed, np.array(LAW.a)],
            ]
        )
        seen = response((closed, np.vstack([b[:, :1], np.zeros((k, 1))]), np.hstack([c[:1], np.zeros((1, k))])))
        np.testing.assert_allclose(
            loop(prototype).at(mass).compliance_response(FREQUENCIES_HZ), seen[:, 0, 0], rtol=1e-6
        )
        poles = loop(prototype).at(mass).poles()
        for pole in np.linalg.eigvals(closed):  # among them the chambers' mean pressure, which nothing drives
            near = np.abs(poles - pole).min()
            assert near < 1e-5 * abs(pole) or abs(pole.imag) == 0, pole
        assert len(poles) in (n + k - 1, n + k)


def test_gains_that_vary_are_proved_stable_and_refused_where_they_are_to_perform(bare: Prototype) -> None:
    """A saturation is to perform at its whole gain; unequal sides of the piston at any between two."""
    found = certify(bare.but(controller=LAW, effects={"current_saturation": {}, "second_beam_mode": {}}), 1.0, 3.0)
    assert found.stable
    assert check(found.text).valid
    prototype = bare.but(controller=LAW, effects={"current_saturation": {}, "unequal_piston_areas": {}})
    with pytest.raises(InputError) as told:
        certify(prototype, *MASSES_KG)
    (problem,) = told.value.problems
    assert problem.key == "effects.unequal_piston_areas"
    assert "remove it" in problem.reason


def test_a_sensor_that_rides_on_the_mount_is_proved_with(bare: Prototype) -> None:
    """What it reads depends on the end mass, as what added sensors read does; against the assembled rig's matrices."""
    lag = Lag(gain_A_per_V=0.05, pole_Hz=1.75, zero_Hz=26.0)
    prototype = bare.but(controller=lag, effects={"mount_compliance": {"sensor_share": 0.7}})
    assert not loop(prototype).gain_and_mass_apart
    found = certify(prototype, *MASSES_KG)
    assert found.guaranteed is not None
    assert check(found.text).valid
    model = state_space(prototype, 2.4)
    seen = model(2j * pi * FREQUENCIES_HZ)[0, 0]
    np.testing.assert_allclose(loop(prototype).at(2.4).compliance_response(FREQUENCIES_HZ), seen, rtol=1e-6)


def test_an_island_of_instability_inside_stable_sides_is_found() -> None:
    """s^3 + (1 + m + g)(s^2 + s) + 4 (m + g) + 2 m g - 1 + e is stable where (m - 1)^2 + (g - 1)^2 > e (Routh)."""
    poly, ends = fmpq_poly, (fmpq(1, 2), fmpq(3, 2))
    side = poly([4, 1, 1])
    for e, island in ((fmpq(1, 25), True), (fmpq(-1, 25), False), (fmpq(-1, 10**6), False)):
        denominator, numerator = Affine(poly([e - 1, 1, 1, 1]), side), Affine(side, poly([2]))
        within = Rectangle(Loop(denominator, numerator, poly([1])), *ends, *ends)
        found = within.inside()
        families = [denominator + numerator * end for end in ends]
        families += [Affine(denominator.at(end), numerator.at(end)) for end in ends]
        assert all(is_stable_over(family, *ends) for family in families)
        assert (found is not None) is island
        assert LoopSet([within], [within], inf).unstable(Goal(lower_gains=False)) is island
        pairs = ((one.constant, one.slope) for one in (denominator, numerator))
        assert stable_on_rectangle(*pairs, ends, ends) is not island
        if found is not None:
            assert found.decided
            assert (found.mass - 1) ** 2 + (found.factor - 1) ** 2 < float(e)
            assert (2 * pi * found.frequency_Hz) ** 2 == pytest.approx(1 + found.mass + found.factor, rel=1e-2)


def test_a_loop_of_half_its_gain_is_that_of_half_the_gain(bare: Prototype, rig: Prototype) -> None:
    """The compliance, too: with added sensors a part of its numerator goes through the feedback."""
    half, scaled = loop(rig.but(controller=rig.controller.but(gain_A_per_V=LAW.gain_A_per_V / 2))), loop(rig)
    scaled = scaled.scaled(fmpq(1, 2))
    for name in ("loop_denominator", "loop_numerator", "disturbance", "added", "crossed"):
        assert getattr(scaled, name) == getattr(half, name), name
    assert scaled.characteristic.slope == fmpq_poly([0, 0, 1]) * half.disturbance
    assert not scaled.crossed.is_zero()


def test_gain_margin_where_mass_and_gain_multiply(rig: Prototype, proved: Certificate) -> None:
    """The least critical gain over dense masses lies between a factor that is proved and one that is refuted."""
    least = min(critical_gain(rig, float(mass)).gain_A_per_V for mass in np.linspace(*MASSES_KG, 18))
    factor = least / LAW.gain_A_per_V
    over = Rectangle(loop(rig), *map(exact, MASSES_KG))
    for share in (1 - 1e-3, 1 + 1e-3):
        assert prove(over, Asked("gain_margin", share * factor)).holds == (share < 1)
    asked = [Asked("gain_margin", round(factor * share, 4)) for share in (0.995, 1.005)] + [Asked("gain_margin", 0.5)]
    found = certify(rig, *MASSES_KG, asked)
    assert [claim.holds for claim in found.claims] == [True, False, True]
    assert check(found.text).valid


def test_a_static_gain_needs_no_states(bare: Prototype) -> None:
    law = Observer.of(0.01, SENSED, [], [], [], [1.0, 100.0, 1e-8])
    prototype = bare.but(controller=law)
    poles = np.sort_complex(np.linalg.eigvals(closed_by_hand(prototype, 2.0)[0]))
    np.testing.assert_allclose(np.sort_complex(loop(prototype).at(2.0).poles()), poles, atol=1e-8 * np.abs(poles).max())
    found = certify(prototype, *MASSES_KG)
    assert check(found.text).valid
    assert law.control_model().nstates == 0
    assert law.sensor_responses(FREQUENCIES_HZ)["displacement_m"][0] == 1.0


@pytest.mark.parametrize("effects", [{}, {"second_beam_mode": {}}])
def test_a_small_step_in_simulation_is_that_of_the_linear_loop(rig: Prototype, effects: dict) -> None:
    """The assembled rig beside python-control's response of the matrices, for two slow lines of force."""
    prototype = rig.but(effects=effects)
    push = Step(amplitude_N=10.0, at_s=0.02, rise_s=0.02, length_s=1.0)
    row = ScenarioRecord(name="push", input=(push,), outer_end_mass_kg=3.0)
    record = simulate(prototype, Scenario(name="s", duration_s=0.25, sample_s=2e-4, record=(row,))).records[0]
    assert record.stable
    model = state_space(prototype, 3.0)
    time, force = record.column("t_s"), record.column("disturbance_N")
    found = control.forced_response(model, time, np.vstack([force, 0 * time])).outputs
    for name in ("displacement_m", "current_A", "inner_displacement_m", "load_pressure_Pa"):
        expected = found[model.output_labels.index(name if name != "displacement_m" else "sensor_V")]
        expected = expected / rig.sensor.gain_V_per_m if name == "displacement_m" else expected
        np.testing.assert_allclose(record.column(name), expected, atol=2e-4 * np.abs(expected).max())


def test_states_of_any_size_start_and_stand_still(rig: Prototype) -> None:
    """A change of the states' units changes no record."""
    scale = np.array([1e-7, 1e6])
    other = Observer.of(
        LAW.gain_A_per_V, SENSED, np.array(LAW.a) * scale / scale[:, None], np.array(LAW.b) / scale[:, None],
        np.array(LAW.c) * scale, LAW.d,
    )  # fmt: skip
    row = ScenarioRecord(name="load", outer_end_mass_kg=1.0, preload_N=50.0)
    plan = Scenario(name="s", duration_s=0.05, record=(row,), start="loaded")
    one, two = (simulate(rig.but(controller=law), plan).records[0].samples for law in (LAW, other))
    np.testing.assert_allclose(one, two, rtol=1e-8, atol=1e-15)
    assert np.ptp(one[:, 4]) < 1e-9 * np.abs(one[:, 4]).max()


@pytest.mark.parametrize("effects", [{}, {"pressure_dependent_flow": {"supply_pressure_Pa": 15e6}}])
def test_a_rig_whose_sides_are_unequal_rests_at_the_zero_of_every_sensor(rig: Prototype, effects: dict) -> None:
    """Its pressures do not: p_a A_a = p_b A_b with p_a + p_b = p_S is p_b - p_a = (A_a - A_b) / (A_a + A_b) p_S.

    A law that heard that difference would hold the tip aside for good.
    """
    uneven = rig.but(effects={"unequal_piston_areas": {"asymmetry": 0.121}, **effects})
    row = ScenarioRecord(name="idle", outer_end_mass_kg=1.0)
    plan = Scenario(name="s", duration_s=0.05, record=(row,))
    record = simulate(uneven, plan).records[0]
    for name, size in (("displacement_m", 1e-6), ("current_A", 1e-6), ("load_pressure_Pa", 1e2)):
        assert np.abs(record.column(name)).max() < 1e-6 * size


def test_limits_of_the_actuator_see_every_sensor(rig: Prototype) -> None:
    """Impedances solved by hand against the polynomials."""
    outer = with_mass(single_compliance(rig, "outer_beam"), 2.0)
    inner = with_mass(single_compliance(rig, "inner_beam"), rig.payload.inner_end_mass_kg)
    found, here = signals(rig, outer, inner, FREQUENCIES_HZ), loop(rig).at(2.0)
    gain = LAW.gain_A_per_V
    np.testing.assert_allclose(gain * found.loop_per_gain, here.loop_response(FREQUENCIES_HZ), rtol=1e-8)
    np.testing.assert_allclose(found.closed(gain), here.compliance_response(FREQUENCIES_HZ), rtol=1e-8)


def test_models_name_what_is_sensed(rig: Prototype) -> None:
    law, plant = LAW.control_model(), state_space(rig, 1.0, "plant")
    assert law.input_labels == ["error_V", "inner_displacement_error_m", "load_pressure_error_Pa"]
    assert plant.output_labels == ["displacement_m", "sensor_V", "inner_displacement_m", "load_pressure_Pa"]
    assert state_space(rig, 1.0, "open").output_labels[3:] == ["inner_displacement_m", "load_pressure_Pa"]
    closed = state_space(rig, 1.0)
    expected = np.sort_complex(loop(rig).at(1.0).poles())
    np.testing.assert_allclose(np.sort_complex(closed.poles()), expected, atol=1e-7 * np.abs(expected).max())


def test_the_record_goes_to_toml_and_back(rig: Prototype, tmp_path: Path) -> None:
    write_prototype(rig, tmp_path / "prototype.toml")
    assert read_prototype(tmp_path / "prototype.toml") == rig


def test_all_that_is_wrong_with_a_record_is_told_at_once(rig: Prototype, tmp_path: Path) -> None:
    write_prototype(rig, tmp_path / "prototype.toml")
    text = (tmp_path / "prototype.toml").read_text()
    start = text.index("sensors = ")
    wrong = """sensors = ["load_pressure_Pa", "displacement_m", "displacement_m"]
a = [[1.0, 2.0], [3.0]]
b = [[1.0, 2.0, inf]]
c = [1.0]
d = [1.0]
"""
    (tmp_path / "wrong.toml").write_text(text[:start] + wrong + text[text.index("\n[payload]") :])
    with pytest.raises(InputError) as told:
        read_prototype(tmp_path / "wrong.toml")
    reasons = {f"{problem.key}: {problem.reason}" for problem in told.value.problems}
    assert reasons == {
        "controller.sensors: must begin with 'displacement_m', whose volts close the loop",
        "controller.sensors: 'displacement_m' stands there more than once",
        "controller.a: entry 2: must hold 2 entries, to be square, holds 1",
        "controller.b: must have a row for each of the 2 of a, has 1",
        "controller.b: entry 1: entry 3: must be a finite number, is inf",
        "controller.c: must have an entry for each of the 2 rows of a, has 1",
        "controller.d: must have an entry for each of the 3 sensors, has 1",
    }
    with pytest.raises(ValueError, match="is of order 13; at most 12 can be"):
        Observer.of(1.0, ["displacement_m"], np.eye(13), np.ones((13, 1)), np.ones(13), [0.0])


def test_a_sampled_loop_is_the_continuous_one_as_the_period_shrinks(rig: Prototype) -> None:
    """A held current is late by half a period: the difference falls with it."""
    row = ScenarioRecord(name="push", outer_end_mass_kg=3.0, input=(Step(amplitude_N=50.0, at_s=0.005, rise_s=0.005),))
    plan = Scenario(name="s", duration_s=0.1, record=(row,), sample_s=2e-4)
    continuous = simulate(rig, plan).records[0].column("displacement_m")
    away = []
    for period in (4e-4, 2e-4):
        moved = simulate(rig, plan.but(sampled=Sampled(period_s=period))).records[0].column("displacement_m")
        away.append(np.abs(moved - continuous).max() / np.abs(continuous).max())
    assert away[1] < 0.05
    assert away[1] == pytest.approx(away[0] / 2, rel=0.25)


@pytest.mark.parametrize("d", [(0.0, 1e-9), (0.0, 0.0)])
def test_what_feeds_nothing_back_is_proved_as_that(bare: Prototype, d: tuple[float, float]) -> None:
    """Without the displacement no effort; without anything no loop gain and a sensitivity of one."""
    law = Observer.of(0.01, SENSED[::2], [], [], [], d)
    goal = bare.goal.but(loop_gain=0.25, controller_effort_A_per_V=0.06)
    found = certify(bare.but(controller=law, goal=goal), *MASSES_KG)
    assert found.guaranteed is not None
    assert found.guaranteed.controller_effort_A_per_V == pytest.approx(0.0, abs=1e-11)
    assert (found.guaranteed.peak_sensitivity < 1.0002) is (d[1] == 0.0)
    assert check(found.text).valid


def test_the_displacement_alone_goes_to_boxes_and_to_code(bare: Prototype) -> None:
    """A controller without added sensors is a transfer function: the same as the lag's."""
    lag = Lag(gain_A_per_V=0.08, pole_Hz=1.75, zero_Hz=26.0)
    prototype = bare.but(controller=as_observer(lag), tolerance=bare.tolerance.but(stiffness=0.02))
    verdict = certify_box(prototype, tolerance_box(prototype, 1.0, None, MASSES_KG), volumes=False)
    assert verdict.stable
    assert check(verdict.certificate, prototype_table(prototype)).valid
    one, other = (realise(law, 5000.0, 32, 10.0, 0.04) for law in (lag, as_observer(lag)))
    for found, expected in zip(other.sections, one.sections, strict=True):
        assert (found.follow, found.direct) == pytest.approx((expected.follow, expected.direct), rel=1e-6)


def test_an_arm_takes_it(rig: Prototype) -> None:
    """All three sensors: the loop itself without offset, and with one the model in floats of the arm."""
    tube = {"width_m": 0.140, "wall_m": 0.0023, "free_length_m": 1.475, "material": "6061-T6"}
    link = rig.but(outer_beam=rig.outer_beam.but(**tube), arm=Arm(end_polar_inertia_kg_m2=0.01))
    plane, own = at_tip(plane_loop(link, "z"), 2.5), loop(link).at(2.5)
    assert (plane.characteristic, plane.loop_denominator, plane.loop_numerator) == (
        own.characteristic,
        own.loop_denominator,
        own.loop_numerator,
    )
    assert (plane.disturbance, plane.effort_numerator) == (own.disturbance, own.effort_numerator)
    off = link.but(arm=Arm(end_polar_inertia_kg_m2=0.01, offset_m=(0.05, 0.1, 0.0), sensor_m=(0.0, 0.05, 0.0)))
    found = certify_plane(off, "z", 0.0, 3.0)
    model, plane = Plane(tomllib.loads(found.text)), at_tip(plane_loop(off, "z"), 2.5)
    frequency = np.array([0.5, 8.0, 40.0, 150.0])
    poles = model.poles(2.5)
    assert max(np.abs(poles / pole - 1).min() for pole in plane.poles()) < 1e-6
    for kind, response in (
        ("tip_compliance", plane.compliance_response(frequency)),
        ("loop_gain", plane.loop_response(frequency)),
        ("controller_effort", effort_response(plane, frequency)),
    ):
        expected = model.magnitudes(kind, 2.5, 2 * np.pi * frequency)
        np.testing.assert_allclose(np.abs(response), expected, rtol=1e-8)
    assert check(found.text, prototype_table(off)).valid


def test_a_report_lists_every_entry() -> None:
    rows = {name: value for name, value, _ in LAW.rows()}
    assert rows["sensors"] == "displacement_m, inner_displacement_m, load_pressure_Pa"
    assert [float(value) for value in rows["b, row 2"].split(", ")] == [0.0, 30.0, 1e-6]
    assert [float(value) for value in rows["d"].split(", ")] == list(LAW.d)
    assert "b_command" not in rows
    commanded = LAW.but(b_command=tuple(float(k) for k in range(LAW.order)))
    rows = {name: value for name, value, _ in commanded.rows()}
    assert [float(value) for value in rows["b_command"].split(", ")] == list(commanded.b_command)


def test_the_command_writes_a_certificate_that_replays(rig: Prototype, tmp_path: Path) -> None:
    path, out = tmp_path / "prototype.toml", tmp_path / "proof.toml"
    write_prototype(rig, path)
    done = CliRunner().invoke(app, ["certify", str(path), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert "stable for every outer end mass" in done.output
    again = CliRunner().invoke(app, ["certify", str(path), "--replay", str(out)])
    assert again.exit_code == 0, again.output
