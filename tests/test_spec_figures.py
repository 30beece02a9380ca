"""Ratings, sensor, tolerances and acceptance bands of a specification, each against something that is not our code."""

import re
from math import pi, sqrt
from pathlib import Path

import control
import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

from beamdesign import Prototype, certify, check, read_problem, read_prototype, spec, state_space
from beamdesign.build import ratings as room
from beamdesign.build import tolerances as tolerancing
from beamdesign.build.acceptance import Band, acceptance, bare_modes
from beamdesign.build.folder import claimed, limits
from beamdesign.build.ratings import MARGIN, lagging, noise_bandwidth_Hz, ratings, sensor_need, stock_choices
from beamdesign.build.specification import reference_load
from beamdesign.build.tolerances import SAFETY, Tolerances, tolerances
from beamdesign.controllers import Lag, Observer, Scheduled, Stage
from beamdesign.loop import loop
from beamdesign.proofs.certificate import Asked
from beamdesign.prototype import Guarantee
from beamdesign.structure.lumped import CHANGEABLE, weighing_mass, with_figures
from beamdesign.structure.section import Tube
from beamdesign.synthesis.holding import working
from beamdesign.synthesis.operating_limits import needs

STUDIES = Path(__file__).parent.parent / "studies"
PUBLISHED = STUDIES / "prototypes" / "published_lag.toml"
MASSES = (0.0, 6.8)


@pytest.fixture(scope="module")
def rig() -> Prototype:
    """The published rig with a tame lag, stable over a range of payloads."""
    found = read_prototype(PUBLISHED)
    return found.but(
        controller=Lag(gain_A_per_V=0.05, pole_Hz=1.7, zero_Hz=20.0),
        payload=found.payload.but(outer_end_mass_kg=MASSES, inner_end_mass_kg=1.9),
    )


@pytest.fixture(scope="module")
def kept(rig: Prototype) -> Tolerances:
    return tolerances(rig, MASSES)


def damped(rig: Prototype, mass: float) -> bool:
    """Whether the loop is stable, by python-control's eigenvalues."""
    return max(state_space(rig, mass).poles().real) < 0


@pytest.mark.parametrize(("heaviest_kg", "load_N"), [(0.004, 0.0392), (0.012, 0.118), (0.7, 6.86), (6.8, 66.7)])
def test_a_light_payload_has_a_weight(heaviest_kg: float, load_N: float, rig: Prototype) -> None:
    light = rig.but(payload=rig.payload.but(largest_force_N=None))
    assert reference_load(light, (0.0, heaviest_kg), None) == (load_N, "weight of the largest payload")


@pytest.mark.parametrize("holds", [True, False])
@pytest.mark.parametrize(
    ("asked", "unit", "largest"),
    [
        (Asked("peak_compliance", 4.3281e-6), 1e-9, True),
        (Asked("compliance", 5.71234567e-8, 3.14159265), 1e-9, True),
        (Asked("controller_effort", 0.0123412345), 1e-3, True),
        (Asked("peak_sensitivity", 1.912344444), 1.0, True),
        (Asked("loop_gain", 0.2512344444, from_Hz=250.0), 1.0, True),
        (Asked("decay_rate", 3.123456789), 1.0, False),
    ],
)
def test_a_claim_says_no_more_than_was_decided(asked: Asked, unit: float, largest: bool, holds: bool) -> None:
    """A bound that holds is told no smaller than it is, one that is refuted no larger."""
    words = claimed(asked.decided(MASSES, holds)).claim
    told = unit * float(re.search(r"(?:at most |exp\(-)([0-9.]+)", words)[1])
    assert told == pytest.approx(asked.limit, rel=1e-6)
    assert told >= asked.limit * (1 - 1e-12) if largest is holds else told <= asked.limit * (1 + 1e-12)


def test_ratings_of_a_slow_load_are_statics(rig: Prototype) -> None:
    """Held slowly, the inner beam takes all of the load but K_o x of the outer one, 0.25 % at this gain.

    Stroke F/K and what the inner beam sags by itself, pressure F/A, F being load and weight; flow A w F (1/K + 1/K_c)
    of half the load, leakage K_pq F/A.
    """
    need = ratings(rig, (0.0, 0.0), 1000.0, 0.05)
    area, stiffness, oil, gravity = 1.13e-4, 157500.0, 1.3e7, 9.80665
    assert need.weight_N == pytest.approx(gravity * weighing_mass(rig.outer_beam))
    force, inside = 1000.0 + need.weight_N, gravity * (weighing_mass(rig.inner_beam) + 1.9)
    assert need.needed["rest_pressure_Pa"] == pytest.approx(force / area)
    assert need.needed["cylinder_force_N"] == pytest.approx(force, rel=4e-3)
    assert need.needed["load_pressure_Pa"] == pytest.approx(force / area, rel=4e-3)
    assert need.needed["supply_pressure_Pa"] == pytest.approx(1.5 * force / area, rel=4e-3)
    assert need.needed["rest_stroke_m"] == pytest.approx((force + inside) / stiffness)
    assert need.needed["stroke_m"] == pytest.approx(2 * MARGIN * (force + inside) / stiffness, rel=4e-3)
    moved = area * 2 * pi * 0.05 * 500.0 * (1 / stiffness + 1 / oil)
    held, leaked = (3.8e-13 * newton / area for newton in (500.0 + need.weight_N, 500.0))
    assert need.needed["flow_m3_per_s"] == pytest.approx(held + sqrt(moved**2 + leaked**2), rel=1e-2)
    assert "stroke_m" not in need.stated
    uneven = ratings(rig.but(effects={"unequal_piston_areas": {"asymmetry": 0.1}}), (0.0, 0.0), 1000.0, 0.05)
    assert uneven.needed["rest_pressure_Pa"] == pytest.approx(force / (0.9 * area))


def test_the_envelope_of_a_specification_is_what_the_weight_leaves(rig: Prototype) -> None:
    """Held slowly, load and weight together are the force that the piston can hold, whatever the payload."""
    for mass in (0.0, 6.8):
        need = ratings(rig, (0.0, mass), 500.0, 3.0)
        assert need.envelope.governing[0] == "force"
        assert need.envelope.load_N[0] + need.weight_N == pytest.approx(rig.actuator.strength_N(rig), rel=4e-3)


def test_the_sag_of_the_inner_beam_takes_of_the_stroke_that_is_left(rig: Prototype) -> None:
    """Held slowly, load and weight bend the inner beam by the rest of half a stroke of 5 mm, by hand."""
    gravity, stiffness = 9.80665, 157500.0
    short = rig.but(actuator=rig.actuator.but(stroke_m=0.005))
    need = ratings(short, (0.0, 0.0), 100.0, 3.0)
    sag = gravity * (weighing_mass(rig.inner_beam) + 1.9) / stiffness
    assert need.envelope.governing[0] == "stroke"
    assert need.envelope.load_N[0] == pytest.approx((0.0025 - sag) * stiffness - need.weight_N, rel=6e-3)


def test_a_specification_rates_what_the_design_run_asked() -> None:
    """One load and one weight, up to one bandwidth: the figures of `run` and of `spec` are the same but for margins."""
    problem = read_problem(STUDIES / "ball_screw.toml")
    rig = read_prototype(PUBLISHED).but(
        actuator=problem.actuator, servovalve=None, controller=Lag(gain_A_per_V=800.0, pole_Hz=1.2, zero_Hz=18.0)
    )
    held, rated = working(problem, rig, MASSES, 3.0), ratings(rig, MASSES, problem.load.tip_force_N, 3.0)
    asked = {limit.name: limit.needed for limit in held.limits}
    assert rated.weight_N == held.weight_N
    assert rated.needed["rest_current_A"] == pytest.approx(asked["continuous current at rest"])
    assert rated.needed["peak_current_A"] == pytest.approx(MARGIN * asked["peak current"])
    assert rated.needed["continuous_current_A"] == pytest.approx(MARGIN * asked["continuous current"])
    assert rated.needed["largest_speed_rad_per_s"] == pytest.approx(MARGIN * asked["rotor speed"])
    assert rated.needed["stroke_m"] == pytest.approx(MARGIN * asked["stroke"])


def test_ratings_grow_with_the_load(rig: Prototype) -> None:
    small, large = (ratings(rig, MASSES, load, 5.0) for load in (100.0, 1000.0))
    weight = needs(rig, MASSES, 0.0, 5.0, small.weight_N)
    flow, no_load = (
        [one.needed[name] - weight[name] for one in (small, large)]
        for name in ("flow_m3_per_s", "no_load_flow_m3_per_s")
    )
    assert flow[1] == pytest.approx(10 * flow[0])
    assert no_load[1] > 10 * no_load[0]  # through an orifice under load pressure more than in proportion
    assert np.isinf(
        ratings(rig, (0.0, 0.0), 3000.0, 5.0).needed["no_load_flow_m3_per_s"]
    )  # 3 kN are more than 20 MPa hold


def test_the_noise_bandwidth_is_the_h2_norm(rig: Prototype) -> None:
    """Integral of |T|^2 df from 0 is half the squared H2 norm: C X C' with A X + X A' + B B' = 0."""
    for mass in MASSES:
        closed = state_space(rig, mass)["displacement_m", "command_V"]
        a, b, c = closed.A, closed.B, closed.C * 1180.0
        expected = 0.5 * (c @ solve_continuous_lyapunov(a, -b @ b.T) @ c.T).item()
        assert noise_bandwidth_Hz(rig, mass) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("felt", [0.0, 2e-10])
def test_noise_of_the_displacement_sensor_goes_its_own_way_through_a_law_that_hears_more(
    rig: Prototype, felt: float
) -> None:
    """The same with a part of the load pressure in the current, A/Pa, which quietens the loop."""
    pole, zero = -2 * pi * 1.7, -2 * pi * 20.0
    law = Observer.of(
        0.05, ("displacement_m", "load_pressure_Pa"),
        [[pole]], [[-pole * (1 - pole / zero), 0.0]], [1.0], [pole / zero, felt / 0.05],
    )  # fmt: skip
    both = rig.but(controller=law)
    closed = state_space(both, 1.0)["displacement_m", "command_V"]
    a, b, c = closed.A, closed.B, closed.C * 1180.0
    expected = 0.5 * (c @ solve_continuous_lyapunov(a, -b @ b.T) @ c.T).item()
    assert damped(both, 1.0)
    assert noise_bandwidth_Hz(both, 1.0) == pytest.approx(expected, rel=1e-3)


def test_a_schedule_of_one_law_asks_of_sensor_and_actuator_what_that_law_does(rig: Prototype) -> None:
    stages = tuple(
        Stage(outer_end_mass_kg=masses, gain_A_per_V=0.05, pole_Hz=1.7, zero_Hz=20.0)
        for masses in ((0.0, 3.9), (2.9, 6.8))
    )
    scheduled = rig.but(controller=Scheduled(stage=stages))
    one, other = (sensor_need(each, MASSES, 100.0, 0.1) for each in (rig, scheduled))
    assert (other.stable_from_Hz, other.performs_from_Hz) == (one.stable_from_Hz, one.performs_from_Hz)
    assert other.bandwidth_Hz == one.bandwidth_Hz
    assert other.noise_density_m_per_rtHz == pytest.approx(one.noise_density_m_per_rtHz)  # its worst payload is an end
    less, more = (ratings(each, MASSES, 100.0, 4.0) for each in (rig, scheduled))
    assert more.needed["cylinder_force_N"] == pytest.approx(less.needed["cylinder_force_N"])
    assert more.needed["supply_flow_m3_per_s"] == pytest.approx(less.needed["supply_flow_m3_per_s"])


def test_the_sensor_may_be_as_slow_as_is_said(rig: Prototype) -> None:
    need = sensor_need(rig, MASSES, 100.0, 0.1)
    assert need.stable_from_Hz is not None
    assert need.performs_from_Hz is not None
    assert need.performs_from_Hz > need.stable_from_Hz
    masses = np.linspace(*MASSES, 18)
    for faster in (1.0, 1.5, 10.0):
        assert all(damped(lagging(rig, faster * need.stable_from_Hz), mass) for mass in masses)
    assert not all(damped(lagging(rig, 0.95 * need.stable_from_Hz), mass) for mass in masses)
    for told in (need.stable_from_Hz, need.performs_from_Hz):  # four digits, so that what is proved is what is told
        assert told == float(f"{told:.4g}")
    slow = lagging(rig, need.performs_from_Hz)
    grid = 2 * pi * np.geomspace(0.1, 500, 3000)
    for mass in (0.0, 3.4, 6.8):
        opened = state_space(slow, mass, "open")["sensor_V", "command_V"](1j * grid)
        assert np.abs(1 / (1 + opened)).max() <= need.peak_sensitivity * (1 + 1e-9)
    assert need.resolution_m == pytest.approx(0.1 * 5.71e-8 * 100.0)
    assert need.noise_density_m_per_rtHz * sqrt(need.noise_bandwidth_Hz) == pytest.approx(need.resolution_m)


@pytest.mark.parametrize("filter_Hz", [None, 400.0])
@pytest.mark.parametrize("effects", [{}, {"sensor_lag": {"break_Hz": 150.0}}])
@pytest.mark.parametrize("law", ["tame_lag", "structured", "lqg"])
def test_a_lag_is_asked_for_beside_filter_and_lag_that_are_there(
    law: str, effects: dict[str, dict[str, float]], filter_Hz: float | None
) -> None:
    own = read_prototype(STUDIES / "prototypes" / f"{law}.toml")
    sensor = own.sensor.but(filter_Hz=filter_Hz or own.sensor.filter_Hz)
    own, hertz = own.but(sensor=sensor, effects=effects, guarantee=None), np.geomspace(1.0, 1e3, 7)
    before, after = loop(own).at(3.0), loop(lagging(own, 300.0)).at(3.0)
    through = before.loop_response(hertz) / (1 + 1j * hertz / 300.0)
    assert after.loop_response(hertz) == pytest.approx(through)
    open_compliance = before.compliance_response(hertz) * (1 + before.loop_response(hertz))
    assert after.compliance_response(hertz) == pytest.approx(open_compliance / (1 + through))


def test_the_sensor_that_performs_is_no_slower_than_it_is_stable_from_on(
    rig: Prototype, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between a slow sensor that does and one from which on all do, some may not."""
    monkeypatch.setattr(room, "_proved_above", lambda prototype, masses, break_Hz: break_Hz > 5000.0)
    need = sensor_need(rig, (0.0, 0.0), 100.0, 0.1)
    assert need.stable_from_Hz is not None
    assert need.performs_from_Hz is not None
    assert need.performs_from_Hz >= need.stable_from_Hz > 5000.0


def test_every_break_of_the_sensor_is_proved_of_every_loop_that_stands_for_an_effect(rig: Prototype) -> None:
    law = Lag(gain_A_per_V=0.116, pole_Hz=1.75, zero_Hz=26.0)
    wholly = rig.but(controller=law, payload=rig.payload.but(inner_end_mass_kg=2.5))
    softly = wholly.but(effects={"joint_backlash": {}})
    assert not certify(softly, *MASSES).stable
    assert room._proved_above(wholly, MASSES, 5000.0)
    assert not room._proved_above(softly, MASSES, 5000.0)


def test_a_filtered_sensor_gets_its_lag_beside_the_filter(rig: Prototype) -> None:
    filtered = rig.but(sensor=rig.sensor.but(filter_Hz=800.0))
    both = lagging(filtered, 300.0)
    assert (both.sensor.filter_Hz, both.effects["sensor_lag"]) == (800.0, {"break_Hz": 300.0})
    for frequency in (1.0, 100.0, 400.0):
        with_lag, without = (
            control.evalfr(state_space(one, 1.0, "open")["sensor_V", "command_V"], 2j * pi * frequency)
            for one in (both, filtered)
        )
        assert with_lag == pytest.approx(without / (1 + 1j * frequency / 300.0), rel=1e-6)
    need = sensor_need(filtered, (3.4, 3.4), 100.0, 0.1)
    assert need.stable_from_Hz is not None
    assert damped(lagging(filtered, need.stable_from_Hz), 3.4)
    assert need.stable_from_Hz < need.fastest_Hz == 2000.0  # what the library's effect goes up to


def test_each_figure_alone_is_stable_to_what_is_proved(rig: Prototype, kept: Tolerances) -> None:
    assert [row.alone for row in kept.figures] == sorted(row.alone for row in kept.figures)
    for row in kept.figures:
        for side in (-1, 1):
            changed = with_figures(rig, {row.name: 1 + side * row.alone})
            assert all(damped(changed, mass) for mass in (0.0, 1.7, 3.4, 6.8)), row.name
        if row.alone_refuted is not None:
            assert row.alone_refuted == pytest.approx(row.alone, rel=0.05)
            ends = [with_figures(rig, {row.name: 1 + side * row.alone_refuted}) for side in (-1, 1)]
            assert not all(damped(end, mass) for end in ends for mass in np.linspace(*MASSES, 35)), row.name


def test_boxes_hold_at_their_corners(rig: Prototype, kept: Tolerances, tmp_path: Path) -> None:
    random = np.random.default_rng(8)
    names = [row.name for row in kept.figures]
    assert set(names) <= set(CHANGEABLE)
    for sizes in ([kept.equal] * len(names), [row.shared for row in kept.figures]):
        for _ in range(40):
            signs = random.choice((-1, 1), len(names))
            factors = {name: 1 + sign * size for name, sign, size in zip(names, signs, sizes, strict=True)}
            assert damped(with_figures(rig, factors), random.uniform(*MASSES))
    for row in kept.figures:
        assert row.shared / SAFETY * 0.9 <= row.specified <= row.shared / SAFETY
    for text in (*kept.certificates, *kept.certificates_equal):
        (tmp_path / "box.toml").write_text(text)
        assert check(tmp_path / "box.toml").valid


def test_performance_at_the_ends_of_a_tolerance(rig: Prototype, kept: Tolerances) -> None:
    row = next(row for row in kept.figures if row.name == "inner_stiffness")
    grid = 2 * pi * np.geomspace(0.05, 500, 3000)
    for side in (-1, 1):
        changed = with_figures(rig, {row.name: 1 + side * row.specified})
        for mass in (0.0, 3.4, 6.8):
            opened = state_space(changed, mass, "open")["sensor_V", "command_V"](1j * grid)
            assert np.abs(1 / (1 + opened)).max() <= row.peak_sensitivity * (1 + 1e-9)
            assert loop(changed).at(mass).bandwidth_Hz() >= row.bandwidth_Hz * (1 - 1e-6)


def test_a_changed_figure_is_the_only_one_that_changes(rig: Prototype) -> None:
    from beamdesign.structure.lumped import figures

    before, after = figures(rig), figures(with_figures(rig, {"outer_stiffness": 1.1, "oil_stiffness": 0.9}))
    changed = {name for name in before if after[name] != pytest.approx(before[name], rel=1e-8)}
    assert changed == {"outer_stiffness", "oil_stiffness"}
    assert after["outer_stiffness"] == pytest.approx(1.1 * 486800.0)
    with pytest.raises(KeyError, match="weight"):
        with_figures(rig, {"weight": 1.0})


def test_bands_hold_what_rigs_within_the_tolerances_do(rig: Prototype, kept: Tolerances) -> None:
    """Compliance by python-control; at a critical gain a pole on the axis; below the proved one none outside."""
    (found,) = acceptance(rig, (3.4,), kept.specified)
    closed = state_space(rig, 3.4)["displacement_m", "disturbance_N"]
    for frequency, band in found.compliance_m_per_N.items():
        assert band.nominal == pytest.approx(abs(control.evalfr(closed, 2j * pi * frequency)), rel=1e-5)
        assert band.low < band.nominal < band.high
        assert band.limits[0] < band.low
        assert band.limits[1] > band.high
    gain, own = found.critical_gain_A_per_V, rig.controller
    assert gain is not None
    at_edge = state_space(rig.but(controller=own.but(gain_A_per_V=gain.nominal)), 3.4).poles()
    assert abs(max(at_edge.real)) < 1e-3 * abs(at_edge[np.argmax(at_edge.real)])
    assert found.critical_gain_proved_A_per_V is not None
    assert own.gain_A_per_V < found.critical_gain_proved_A_per_V < gain.low
    random, names = np.random.default_rng(4), list(kept.specified)
    for _ in range(30):
        factors = {name: 1 + random.choice((-1, 1)) * kept.specified[name] for name in names}
        factors["controller_gain"] = found.critical_gain_proved_A_per_V / own.gain_A_per_V
        assert damped(with_figures(rig, factors), 3.4)


def test_limits_of_a_rig_with_friction_hold_its_compliance_while_it_slides(rig: Prototype) -> None:
    """Then it is, between its stops, the rig without friction, by python-control; at rest the seal is a spring."""
    (found,) = acceptance(rig.but(effects={"seal_friction": {}}), (3.4,))
    closed = state_space(rig, 3.4)["displacement_m", "disturbance_N"]
    for frequency, band in found.compliance_m_per_N.items():
        sliding = abs(control.evalfr(closed, 2j * pi * frequency))
        assert band.limits[0] < sliding < band.limits[1]
    slow = found.compliance_m_per_N[1.0]
    assert slow.nominal > 5 * slow.low
    assert slow.high == slow.nominal


@pytest.mark.long
def test_effects_heed_the_weight_of_the_payloads_that_are_asked_for(
    rig: Prototype, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The prototype states none, and a guarantee that does not cover those asked for is not specified."""
    monkeypatch.setattr(tolerancing, "toleranced_figures", lambda prototype: ("flow_gain",))  # in less time
    guarantee = Guarantee(
        bandwidth_Hz=1.0, peak_sensitivity=2.0, outer_end_mass_kg=(0.0, 1.0), certificate="a.toml",
        certificate_sha256="0" * 64, sigmas=2.0,
    )  # fmt: skip
    stated = rig.but(payload=rig.payload.but(outer_end_mass_kg=None), effects={"pressure_dependent_flow": {}})
    found = spec(stated.but(guarantee=guarantee), (0.0, 6.8), rate_Hz=5000.0)
    digital = found.laws[0].digital
    assert digital is not None
    assert check(digital.delay_certificate).valid
    assert found.prototype.payload.outer_end_mass_kg == (0.0, 6.8)
    assert found.prototype.guarantee is None


def test_a_beam_that_is_tapped_rings_as_its_mass_on_spring_and_dashpot() -> None:
    """By the roots of M s^2 + b s + K, the dashpot staying as mass is added to the inner tip."""
    rig = read_prototype(PUBLISHED)
    loaded = rig.but(payload=rig.payload.but(inner_end_mass_kg=2.5))
    published = ((486800.0, 3.9, 0.0), (157500.0, 1.6, 2.5))
    for mode, (stiffness, mass, added_kg) in zip(bare_modes(loaded), published, strict=True):
        dashpot = 2 * 0.05 * np.sqrt(stiffness * mass)
        root = np.roots([mass + added_kg, dashpot, stiffness])[0]
        assert mode.frequency_Hz == pytest.approx(abs(root) / (2 * np.pi))
        assert mode.damping_ratio == pytest.approx(-root.real / abs(root))


def test_limits_stand_in_the_unit_of_what_is_expected() -> None:
    """Gains of 1 A/V and more are read in A/V, smaller ones in mA/V."""
    assert limits(Band(0.98, 0.975, 0.99), "A/V") == "980 mA/V (926 to 1040)"
    assert limits(Band(1.02, 1.0, 1.03), "A/V") == "1.02 A/V (0.95 to 1.08)"
    # Where no tolerance is specified, those of the measurement.
    assert limits(Band(1.02, 1.02, 1.02), "A/V") == "1.02 A/V (0.969 to 1.07)"


def test_a_stock_tube_changes_stiffness_as_its_second_moment(rig: Prototype) -> None:
    choices = stock_choices(rig, MASSES)
    assert choices is not None
    outer = choices[0]
    assert outer.stock == Tube(0.14, 0.0025)
    assert not outer.same
    # I of a square tube by hand, E of 6061-T6 69 GPa: 3 E I / L^3.
    second_moment = (0.14**4 - 0.135**4) / 12
    assert outer.stiffness_N_per_m == pytest.approx((486800.0, 3 * 69e9 * second_moment / 1.195**3), rel=1e-6)
    assert outer.gap_m == pytest.approx((0.0177, 0.0175))
    assert outer.stable
    lumped = rig.but(outer_beam=rig.outer_beam.but(width_m=None, wall_m=None))
    assert stock_choices(lumped, MASSES) is None
