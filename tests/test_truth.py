"""The truth model of the blind check, judged by closed forms and by the linear model it must not share code with."""

import subprocess
import sys
from dataclasses import replace
from functools import cache
from math import pi, sqrt

import numpy as np
import pytest

from beamdesign import read_dataset
from beamdesign.validation.truth import drawing, laws
from beamdesign.validation.truth.beams import cantilever_modes, outer_modes
from beamdesign.validation.truth.case import Drive, answer, inputs_of, noise_free, run_figures, take, write_case
from beamdesign.validation.truth.drawing import draw_case, linear_critical_gain
from beamdesign.validation.truth.effects import KINDS, LISTED, OUTSIDE, Scales
from beamdesign.validation.truth.nominal import assembled, nominal_figures, packed, rig_figures
from beamdesign.validation.truth.rates import STATES
from beamdesign.validation.truth.rig import SAMPLE_S, STEP_S, controller_figures, march
from beamdesign.validation.truth.rig_kinds import on


@pytest.fixture(autouse=True)
def three_records(monkeypatch):
    """Cases of three short records in place of five: a load of lines, steps of load, and one with a payload."""
    monkeypatch.setattr(drawing, "_SHORT", (3, 4, 5))


PUBLISHED = {
    "name": "published",
    "outer_beam": {"stiffness_N_per_m": 486800.0, "effective_mass_kg": 3.9, "damping_ratio": 0.05},
    "inner_beam": {"stiffness_N_per_m": 157500.0, "effective_mass_kg": 1.6, "damping_ratio": 0.05},
    "actuator": {"piston_area_m2": 1.13e-4, "oil_stiffness_N_per_m": 1.3e7},
    "servovalve": {
        "flow_gain_m3_per_s_per_A": 0.0113,
        "leakage_m3_per_s_per_Pa": 3.8e-13,
        "natural_frequency_Hz": 150.0,
        "damping_ratio": 0.5,
    },
    "sensor": {"gain_V_per_m": 1180.0},
    "tolerance": {},
}
OFF = {"gain": 0.0}
PROPORTIONAL = {"gain": 0.00965}
NO_OIL = {"area_a": 1e-12, "area_b": 1e-12, "leakage": 0.0}


def rig(**changes):
    """Record and modes of the published rig with some figures changed."""
    return assembled(rig_figures(PUBLISHED, {}, {}) | OFF | changes)


def drive(duration_s, force=None, command=None, step_s=STEP_S):
    """Inputs at every half step, from functions of time."""
    times = np.arange(2 * round(duration_s / step_s) + 1) * (step_s / 2)
    inputs = np.zeros((len(times), 3))
    if force is not None:
        inputs[:, 0] = force(times)
    if command is not None:
        inputs[:, 1] = command(times)
    return inputs


def constant(value):
    return lambda times: np.full_like(times, value)


def test_it_shares_nothing_with_the_diagnosis():
    loaded = subprocess.run(
        [sys.executable, "-c", "import sys, beamdesign.validation.truth.drawing; print('\\n'.join(sys.modules))"],
        capture_output=True, text=True, check=True,
    ).stdout.split()  # fmt: skip
    shared = [name for name in loaded if name.startswith(("beamdesign.plant", "beamdesign.simulation", "casadi"))]
    assert shared == []
    assert "beamdesign.validation.truth.rig" in loaded


# --- physics against closed forms


def test_a_held_force_bends_only_the_outer_beam_once_the_oil_has_leaked():
    # Without a controller the leakage lets the cylinder creep until no force is left in it: x = F / K_m.
    record, modes = rig(leakage=3.8e-11, inner_damping=2e3)
    held = march(record, modes, drive(1.5, constant(100.0)))
    assert held.outer[-1] == pytest.approx(100.0 / 486800, rel=1e-4)
    assert held.inner[-1] == pytest.approx(0.0, abs=1e-8)


def test_a_held_force_before_the_oil_leaks_meets_both_beams_and_the_oil():
    # No leakage: the inner beam behind the oil, in parallel with the outer one.
    record, modes = rig(leakage=0.0, inner_damping=2e3)
    modes = modes.copy()
    modes[2, 0] = 4e3
    held = march(record, modes, drive(1.0, constant(100.0)))
    behind = 1 / (1 / 157500 + 1 / 1.3e7)
    assert held.outer[-1] == pytest.approx(100.0 / (486800 + behind), rel=1e-4)


def test_the_bare_beam_rings_down_at_its_damped_frequency():
    record, modes = rig(**NO_OIL)
    start = np.zeros(STATES)
    start[0] = 1e-3
    free = march(record, modes, drive(0.5), start=start)
    zeta, rate = 0.05, sqrt(486800 / 3.9)
    t, x = free.times, free.outer
    damped = rate * sqrt(1 - zeta**2)
    expected = 1e-3 * np.exp(-zeta * rate * t) * (np.cos(damped * t) + zeta * rate / damped * np.sin(damped * t))
    np.testing.assert_allclose(x, expected, atol=2e-6)


def test_payload_lowers_every_mode_as_the_beam_with_a_heavier_tip():
    # The modal beam with an end mass against finite elements that carry it at the tip (Rayleigh's coupling is exact
    # where all modes are kept; four of them are close).
    length, elements = 1.0, 16
    _, stiffness, mass = cantilever_modes(np.ones(elements), np.ones(elements), length, {}, 4)
    loaded, *_ = cantilever_modes(np.ones(elements), np.ones(elements), length, {elements: 0.5}, 2)
    coupled = np.diag(mass) + 0.5
    rates = np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(coupled, np.diag(stiffness))).real))
    assert rates[0] == pytest.approx(loaded[0], rel=2e-3)
    assert rates[1] == pytest.approx(loaded[1], rel=2e-2)


def test_cantilever_frequencies():
    # R. D. Blevins, Formulas for Natural Frequency and Mode Shape (1979), table 8-1, clamped-free.
    found, *_ = cantilever_modes(np.full(24, 50.0), np.full(24, 2.0), 1.3, {}, 3)
    constants = np.array([1.87510407, 4.69409113, 7.85475744])
    np.testing.assert_allclose(found, constants**2 * sqrt(50.0 / 2.0) / 1.3**2, rtol=2e-5)
    # Statically the modes add up to the tip's flexibility, L^3 / 3 EI, of which the first has 12 / 1.8751^4.
    _, many, _ = cantilever_modes(np.full(24, 50.0), np.full(24, 2.0), 1.3, {}, 48)
    assert (1 / many).sum() == pytest.approx(1.3**3 / 150, rel=1e-7)
    assert many[0] * 1.3**3 / 150 == pytest.approx(constants[0] ** 4 / 12, rel=1e-5)


def test_the_first_mode_keeps_the_figures_of_the_beam():
    modes = outer_modes(486800.0, 3.9, 137.8, 3.0, 0.2, 0.1, 0.01, 4)
    np.testing.assert_allclose(modes[:, 0], [486800.0, 3.9, 137.8], rtol=1e-9)
    rates = np.sqrt(modes[0] / modes[1])
    assert np.all(np.diff(rates) > 0)
    assert np.all(rates < 2 * pi * 2500)


def test_orifice_flow_goes_with_the_root_of_the_drop():
    assert laws.orifice(4e6, 1e2) / laws.orifice(1e6, 1e2) == pytest.approx(2.0, rel=1e-4)
    assert laws.orifice(-3e6, 1e4) == -laws.orifice(3e6, 1e4)
    assert laws.orifice(1.0, 1e4) == pytest.approx(1 / 100, rel=1e-3)  # laminar


def test_speed_under_load_is_that_of_an_orifice_valve():
    # H. E. Merritt, Hydraulic Control Systems (1967), equation (5-11): v = v0 sqrt(1 - P_L / P_S), here while a held
    # current bends light, soft beams ever further. The sensor is as good as cut off.
    supply, current = 4e6, 1e-3
    record, _ = rig(orifice=1.0, supply=supply, laminar=1.0, leakage=0.0, gain=current, sensor_gain=1e-9,
                    inner_mass=0.05, inner_damping=0.0, inner_stiffness=3e4)  # fmt: skip
    moved = march(record, np.array([[3e4], [0.05], [0.0]]), drive(0.6, command=constant(1.0)))
    speed = np.gradient(moved.outer - moved.inner, moved.times)
    for share in (0.3, 0.5, 0.7):
        at = int(np.argmax(moved.load_pressure > share * supply))
        assert at > 100
        free = 0.0113 * current / 1.13e-4
        assert speed[at] == pytest.approx(free * sqrt(1 - moved.load_pressure[at] / supply), rel=0.01)


def test_bulk_modulus_of_oil_with_air():
    # E. B. Wylie and V. L. Streeter, Fluid Transients: volumes of oil and gas share one pressure. Differentiated here.
    bulk, air, exponent = 1.4e9, 0.05, 1.3

    def volume(absolute):
        gas = air * (laws.ATMOSPHERE / absolute) ** (1 / exponent)
        return (1 - air) * (1 - (absolute - 2e6) / bulk) + gas

    h = 1e2
    slope = (volume(2e6 + h) - volume(2e6 - h)) / (2 * h)
    found = laws.aerated(2e6 - laws.ATMOSPHERE, bulk, air, exponent, 1e30)
    assert found == pytest.approx(-volume(2e6) / slope, rel=1e-3)
    assert laws.aerated(5e6, bulk, 0.0, exponent, 1e9) == bulk
    assert laws.aerated(5e6, bulk, air, exponent, 4e6) == bulk  # all dissolved


def test_seal_at_steady_speed_is_on_its_stribeck_curve():
    # C. Canudas de Wit et al., IEEE Trans. Automatic Control 40 (1995) 419, equation (4): at steady speed the bristles
    # carry g(v). A very heavy outer tip slides past an inner one that is held.
    seal = {
        "coulomb": 50.0,
        "breakaway": 70.0,
        "stribeck_speed": 0.01,
        "bristle_stiffness": 5e6,
        "bristle_damping": 200.0,
        "viscous": 300.0,
    }
    for speed in (0.002, 0.01, 0.05):
        record, _ = rig(**NO_OIL, inner_stiffness=1e8, inner_damping=1e5, inner_mass=10.0, **seal)
        start = np.zeros(STATES)
        start[4] = speed
        dragged = march(record, np.array([[0.0], [1e6], [0.0]]), drive(0.15), start=start)
        expected = 50 + 20 * np.exp(-((speed / 0.01) ** 2)) + 300 * speed
        assert 1e8 * dragged.inner[-1] == pytest.approx(expected, rel=2e-3)


def test_rounded_overlap_is_a_dead_band_with_soft_edges():
    assert laws.overlapped(5.0, 1.0, 0.1) == pytest.approx(4.0, abs=1e-9)
    assert laws.overlapped(-5.0, 1.0, 0.1) == pytest.approx(-4.0, abs=1e-9)
    assert abs(laws.overlapped(0.5, 1.0, 0.1)) < 1e-3
    assert 0 < laws.overlapped(1.0, 1.0, 0.1) < 0.1


def test_knee_keeps_to_its_limit_and_small_currents_as_they_are():
    assert laws.knee(1e-4, 1e-2, 10.0) == pytest.approx(1e-4, rel=1e-9)
    assert 0.98e-2 < laws.knee(0.1, 1e-2, 10.0) < 1e-2


def test_joint_presses_as_hertz_and_never_pulls():
    assert laws.contact(3e-6, 0.0, 2e-6, 1e10, 0.0) == pytest.approx(1e10 * (2e-6) ** 1.5)
    assert laws.contact(0.5e-6, 1.0, 2e-6, 1e10, 1.0) == 0.0
    assert laws.contact(3e-6, -10.0, 2e-6, 1e10, 1.0) == 0.0


def test_play_operator_has_a_loop_of_its_width():
    held, up, down = 0.0, [], []
    for given in np.r_[np.linspace(0, 1, 50), np.linspace(1, 0, 50)]:
        held = laws.played(given, held, 0.1)
        (up if len(up) < 50 else down).append(held)
    assert up[-1] - 1.0 == pytest.approx(-0.1)
    assert down[25] - np.linspace(1, 0, 50)[25] == pytest.approx(0.1)


# --- sensor, controller


def test_dead_time_is_exact():
    late = rig(gain=1e-9, delay=1.3e-3)
    now = rig(gain=1e-9)
    push = drive(0.2, lambda t: 100 * np.sin(2 * pi * 30 * t) * np.minimum(1, t / 0.1))
    prompt, delayed = march(*now, push), march(*late, push)
    # 1.3 ms are 26 steps, no sample: cubic through the samples.
    from scipy.interpolate import CubicSpline

    expected = CubicSpline(prompt.times, prompt.outer)(np.maximum(prompt.times - 1.3e-3, 0))
    np.testing.assert_allclose(delayed.displacement[10:], expected[10:], atol=2e-9)
    with pytest.raises(ValueError, match="shorter than the step"):
        march(*rig(delay=1e-5), push)


@pytest.mark.parametrize(("order", "zeta"), [(1.0, 0.8), (2.0, 0.7)])
def test_sensor_lag_answers_a_step_as_its_closed_form(order, zeta):
    rate = 2 * pi * 50
    record, _ = rig(lag_rate=rate, lag_order=order, lag_damping_ratio=zeta, **NO_OIL)
    stiff = np.array([[1e7], [0.05], [1e3]])  # follows the force at once, against 50 Hz
    stepped = march(record, stiff, drive(0.05, constant(1e4)))
    t = stepped.times
    if order == 1.0:
        expected = 1 - np.exp(-rate * t)
    else:
        damped = rate * sqrt(1 - zeta**2)
        expected = 1 - np.exp(-zeta * rate * t) * (np.cos(damped * t) + zeta * rate / damped * np.sin(damped * t))
    np.testing.assert_allclose(stepped.displacement[1:], 1e-3 * expected[1:], atol=4e-5)


# --- against the linear model


def test_with_all_effects_off_it_is_the_linear_rig():
    import control

    from beamdesign.prototype import prototype_from
    from beamdesign.public import state_space

    table = PUBLISHED | {
        "controller": {"kind": "lag", "gain_A_per_V": 0.08, "pole_Hz": 1.75, "zero_Hz": 26.0},
        "payload": {"inner_end_mass_kg": 4.4},
    }
    law = controller_figures(table["controller"])
    record, modes = rig(**law, outer_end_mass=6.8, inner_end_mass=4.4)
    loop = state_space(prototype_from(table), 6.8)

    def wave(t):
        return sum(np.sin(2 * pi * f * t + f) for f in (1.0, 7.0, 23.0, 40.0, 110.0)) * np.minimum(1, t / 0.1)

    ours = march(record, modes, drive(2.0, lambda t: 30 * wave(t), lambda t: 0.02 * wave(1.01 * t)))
    fine = np.arange(8001) * 250e-6
    inputs = np.vstack([30 * wave(fine), 0.02 * wave(1.01 * fine)])
    theirs = control.forced_response(loop, T=fine, U=inputs, X0=0)
    for name, found in (("displacement_m", ours.displacement), ("current_A", ours.current)):
        expected = np.asarray(theirs.outputs)[loop.output_labels.index(name), ::2]
        assert np.sqrt(np.mean((found - expected) ** 2)) < 0.005 * np.std(expected)


def test_critical_gain_of_the_published_rig():
    # The exact crossing of the linear loop (beamdesign.loop), within the bisection.
    from beamdesign.loop import critical_gain
    from beamdesign.prototype import prototype_from

    table = PUBLISHED | {"controller": {"kind": "proportional", "gain_A_per_V": 1.0}}
    assert linear_critical_gain(*rig()) == pytest.approx(critical_gain(prototype_from(table)).gain_A_per_V, rel=2e-4)


def test_it_converges_with_the_step():
    smooth = {"orifice": 1.0, "air_share": 0.02, "overlap": 1e-4, "stroke_on": 1.0, **PROPORTIONAL}
    found = []
    for step in (50e-6, 25e-6, 12.5e-6):
        wave = drive(0.3, lambda t: 300 * np.sin(2 * pi * 25 * t) * np.minimum(1, t / 0.1), step_s=step)
        found.append(march(*rig(**smooth), wave, step_s=step).displacement)
    coarse, fine = (np.std(found[k] - found[2]) for k in (0, 1))
    assert coarse < 1e-4 * np.std(found[2])
    assert fine < 0.4 * coarse


# --- effects and cases


@pytest.mark.parametrize("name", [*LISTED, *OUTSIDE])
def test_every_effect_changes_the_rig_and_more_of_it_changes_more(name):
    from beamdesign.validation.truth.case import Departure, relative_gap

    case = lively_case("lag" if on("lag", [name]) else "ball_screw")
    shape = KINDS[name].shape(np.random.default_rng(5))
    low, high = KINDS[name].range
    before = undisturbed(case.rig)
    middle = sqrt(low * high)
    gaps = [
        relative_gap(noise_free(case.only(Departure(name, severity, shape)), 0.75), before)
        for severity in (sqrt(low * middle), middle)
    ]
    assert 0 < gaps[0] < gaps[1] or name in ("sensor_dropout", "coarse_output", "second_beam_mode")
    assert max(gaps) > 1e-4


@cache
def null_case(rig):
    return draw_case(3, "null", short=True, rig=rig)


@cache
def lively_case(rig):
    """The same with those two of its records in which most moves within their first part."""
    case = null_case(rig)
    return replace(case, runs=case.runs[::2])


@cache
def undisturbed(rig):
    """The first part of these records, in which there is no effect to be found."""
    return noise_free(lively_case(rig), 0.75)


def test_another_seed_draws_another_rig(monkeypatch):
    null = null_case("lag").nominal
    monkeypatch.setattr(drawing, "_with_background", lambda case, rng: case)
    monkeypatch.setattr(drawing, "_with_effects", lambda case, *given: case)
    assert draw_case(3, "null", short=True).nominal == null != draw_case(4, "null", short=True).nominal


def test_cases_come_again_by_their_seed(tmp_path):
    again = draw_case(3, "null", short=True)
    null = null_case("lag")
    assert again == null
    assert again.factors == null.factors
    write_case(null, tmp_path / "a")
    write_case(again, tmp_path / "b")
    for path in sorted((tmp_path / "a").rglob("*.*")):
        other = tmp_path / "b" / path.relative_to(tmp_path / "a")
        assert path.read_bytes() == other.read_bytes()


def test_a_case_is_a_data_set_of_the_contract_without_its_answer(tmp_path, monkeypatch):
    monkeypatch.setattr("beamdesign.validation.truth.drawing.GAPS", (8.0, 8.0))
    case = draw_case(5, "single", short=True, names=("transport_delay",))
    write_case(case, tmp_path)
    found = read_dataset(tmp_path)
    assert [record.name for record in found.records] == [run.name for run in case.runs]
    assert found.warnings == ()
    assert not list(tmp_path.glob("answer*"))
    assert "delay" not in (tmp_path / "dataset.toml").read_text() + (tmp_path / "prototype.toml").read_text()
    told = answer(case)
    assert told["effects"] == ["transport_delay"]
    assert told["subsystem"] == "controller"
    assert told["gap_over_floor"] == pytest.approx(8.0, rel=0.5)
    assert 1e-4 <= told["parameters"]["transport_delay"]["delay_s"] <= 5e-3
    # What the recorder adds is noise of the stated size, but for what the loop makes of it.
    run = case.runs[1]
    clean, noisy = take(case, run), found.records[1].measured["displacement_m"]
    assert np.std(noisy - clean.displacement) < 4 * case.noise.floor_m + 0.4e-6


def test_a_wave_that_is_given_is_smooth_between_its_samples():
    """A sine of 400 Hz, given every half millisecond, against its closed form; straight lines take 12.5 % of it."""
    case = null_case("lag")
    times = SAMPLE_S * np.arange(round(case.duration_s / SAMPLE_S))
    drive = Drive("disturbance_N", "given", 0.0, 0.0, 1, tuple(np.sin(800 * pi * times)))
    inputs = inputs_of(case, replace(case.runs[0], drive=drive), False, STEP_S, case.duration_s)[:, 0]
    fine = STEP_S / 2 * np.arange(len(inputs))
    assert np.abs(inputs - np.sin(800 * pi * fine))[100:-100].max() < 0.02


def test_a_wrong_figure_is_wrong_by_more_than_its_tolerance():
    case = draw_case(6, "parameter", short=True, names=("parameter:flow_gain",))
    told = answer(case)["parameters"]["parameter:flow_gain"]
    assert abs(np.log(told["factor"])) >= 3.5 * case.nominal["tolerance"]["flow_gain"] - 1e-12
    nominal = nominal_figures(case.nominal)["flow_gain"]
    assert told["value"] / nominal == pytest.approx(case.factors["flow_gain"])
    assert run_figures(case, case.runs[0])["flow_gain"] == pytest.approx(told["value"])


def test_what_was_said_of_a_pair_is_what_it_does():
    from beamdesign.validation.truth.case import relative_gap

    case = draw_case(8, "pair", short=True, names=("sensor_lag", "seal_friction"))
    bare = noise_free(case.only())
    assert relative_gap(noise_free(case), bare) == pytest.approx(case.gaps["all"])
    first = case.departures[0]
    assert relative_gap(noise_free(case.only(first)), bare) == pytest.approx(case.gaps[first.name])
    assert case.gaps[case.departures[0].name] >= case.gaps[case.departures[1].name]


def test_unknown_names_are_refused():
    with pytest.raises(ValueError, match="no effect 'gremlins'"):
        draw_case(1, "single", names=("gremlins",))
    with pytest.raises(ValueError, match="kind is one of"):
        draw_case(1, "quadruple")
    with pytest.raises(KeyError):
        packed({"gremlins": 1.0})


def test_larger_side_drives_faster_through_orifices_and_slower_where_the_inflow_is_metered():
    scales = Scales({"area_a": 1.13e-4, "area_b": 1.13e-4}, 900.0, 7e-3)
    for metering, expected in ((0.0, 0.88 / 1.12), (1.0, sqrt(1.12 / 0.88))):
        changed = KINDS["unequal_piston_areas"].figures(scales, {"side": 1.0, "metering": metering}, 1.0)
        ways = []
        for sign in (1.0, -1.0):
            record, _ = rig(
                **changed, gain=1e-5, sensor_gain=1e-9, leakage=0.0, inner_stiffness=1.0, inner_damping=10.0
            )
            soft = np.array([[1.0], [3.9], [10.0]])
            moved = march(record, soft, drive(0.3, command=lambda t, s=sign: s * np.ones_like(t)))
            stroke = moved.outer - moved.inner
            ways.append(abs(stroke[400] - stroke[200]))
        assert ways[0] / ways[1] == pytest.approx(expected, rel=1e-3)


def test_the_same_case_without_background_is_another_rig():
    null = null_case("lag")
    assert replace(null, background=()).runs == null.runs
    assert any(KINDS[d.name] for d in null.background)


@pytest.mark.parametrize("seed", [3, 7])
def test_a_cylinder_is_not_loaded_beyond_the_stall_of_its_supply(seed):
    """Beyond stall, supply pressure times piston area, no cylinder holds a load, and a chamber would run empty."""
    case = draw_case(seed, "single", short=True, names=("entrained_air",))
    for run in case.runs:
        figures = run_figures(case, run)
        assert figures["supply"] > 900 * case.nominal["outer_beam"]["stiffness_N_per_m"] / 486800 / figures["area_a"]
        assert np.abs(take(case, run).load_pressure).max() < figures["supply"]


@pytest.mark.parametrize(("magnet", "other"), [(0.0, 0.6), (0.9, 0.0)])
def test_a_trace_of_the_other_hysteresis_hides_none(magnet, other):
    """A rig's background may hold a thousandth of the same effect as the other realisation has it."""
    scales = Scales({"modes.stiffness": 5e5}, force=1000.0, current=7.5e-3)
    kind = KINDS["valve_hysteresis"]
    shape = {"travel": 1.0, "sharpness": 1.0}
    values = {"magnet_share": 0.0, "magnet_width": 0.0, "spool_friction": 0.0}
    values |= kind.figures(scales, shape | {"magnet": other}, 1e-3) | kind.figures(
        scales, shape | {"magnet": magnet}, 1
    )
    assert kind.stated(values)["half_width_A"] == pytest.approx(1.001 * 7.5e-3 / 75)
