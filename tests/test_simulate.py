"""Simulated records against the exact linear model, other integrators, and the exact critical gain."""

import csv
import json
from functools import partial
from math import pi
from pathlib import Path

import numpy as np
import pytest
from impulse_test import critical_gain_by_kicks
from scipy.integrate import solve_ivp
from scipy.signal import lsim
from typer.testing import CliRunner

from beamdesign import InputError, Prototype, critical_gain, read_prototype, read_scenario, simulate, write_prototype
from beamdesign.cli import app
from beamdesign.controllers import Lag
from beamdesign.diagnosis.data.dataset import TimeRecord
from beamdesign.diagnosis.predict import predict_record
from beamdesign.loop import loop
from beamdesign.plant.assembly import assemble, fits, parameters_of, structure_of
from beamdesign.plant.compiled import half_steps, integrate, measured_half_steps, refined
from beamdesign.plant.effects import causes
from beamdesign.plant.equilibrium import MOST_STEPS, equilibrium
from beamdesign.plant.members import paper_model
from beamdesign.records import parse
from beamdesign.scenario import Multisine, Sampled, Scenario, ScenarioRecord, Step, inputs_of
from beamdesign.simulation import COLUMNS, oscillation

ROOT = Path(__file__).parent.parent


@pytest.fixture
def lag(paper: Prototype) -> Prototype:
    return paper.but(controller=Lag(gain_A_per_V=0.12, pole_Hz=1.75, zero_Hz=26.0))


def scenario(*signals, duration_s: float = 0.5, preload_N: float = 0.0, **changes) -> Scenario:
    row = ScenarioRecord(name="one", input=signals, preload_N=preload_N)
    return Scenario(name="test", duration_s=duration_s, record=(row,), **changes)


def test_record_is_that_of_the_exact_linear_loop(lag: Prototype):
    """The same inputs through matrices assembled from the linear plant, stepped by scipy's matrix exponential."""
    plan = scenario(
        Multisine(amplitude_N=100.0, low_Hz=2.0, high_Hz=150.0), Multisine(amplitude_V=0.05, high_Hz=50.0, seed=3)
    )
    record = simulate(lag, plan).records[0]
    a, b, c = paper_model(lag).matrices(0.0, 0.0)
    law = lag.controller
    pole, ratio = 2 * pi * law.pole_Hz, law.pole_Hz / law.zero_Hz
    # i = K (slow + (e - slow) pole/zero), slow' = pole (e - slow), e = command - F x
    full = np.zeros((8, 8))
    full[:7, :7] = a - law.gain_A_per_V * ratio * np.outer(b[:, 1], c[1])
    full[:7, 7] = law.gain_A_per_V * (1 - ratio) * b[:, 1]
    full[7, :7], full[7, 7] = -pole * c[1], -pole
    drive = np.zeros((8, 2))
    drive[:7, 0], drive[:7, 1], drive[7, 1] = b[:, 0], law.gain_A_per_V * ratio * b[:, 1], pole
    times, substeps = plan.times, 20
    fine = half_steps(inputs_of(plan.record[0], plan), substeps)
    grid = np.arange(len(fine)) * plan.sample_s / (2 * substeps)
    _, _, x = lsim((full, drive, np.eye(8), np.zeros((8, 2))), fine, grid)
    x = x[:: 2 * substeps]
    assert len(x) == len(times) == len(record.samples)
    scale = np.abs(x).max(axis=0)
    # Limited by lsim, which takes inputs as straight between its points.
    np.testing.assert_allclose(record.column("displacement_m"), x[:, 0], atol=2e-5 * scale[0])
    np.testing.assert_allclose(record.column("inner_displacement_m"), x[:, 3], atol=2e-5 * scale[3])
    pressure = 1.3e7 * (x[:, 2] - x[:, 0]) / 1.13e-4
    np.testing.assert_allclose(record.column("load_pressure_Pa"), pressure, atol=5e-5 * np.abs(pressure).max())
    assert record.stable


def test_all_effects_together_agree_with_another_integrator(lag: Prototype):
    every = {name: {} for name in causes() if fits(name, lag.rig)}
    rig = lag.but(controller=lag.controller.but(gain_A_per_V=0.06), effects=every)
    kinds = structure_of(rig)
    assembly = assemble(kinds)
    parameters = np.array(list(parameters_of(rig, 3.0, 4.0).values()))
    start = equilibrium(assembly, np.zeros(3), parameters)
    times = np.arange(161) * 5e-4

    def force(t):
        return 400 * np.sin(2 * pi * 20 * t)

    errors = []
    tight = solve_ivp(
        lambda t, x: np.asarray(assembly.function(t, x, [force(t), 0, 0], parameters)[0]).ravel(),
        (0, times[-1]),
        start,
        method="LSODA",
        t_eval=times,
        rtol=1e-8,
        atol=1e-10 * np.maximum(np.abs(start), 1e-4),
        max_step=5e-4,
    )
    expected = tight.y[0] + tight.y[assembly.states.index("second_beam_mode.mode_m")]
    for substeps in (10, 20):
        fine = np.arange(2 * substeps * 160 + 1) * 5e-4 / (2 * substeps)
        y, _ = integrate(kinds, times, np.column_stack([force(fine), 0 * fine]), start, parameters, substeps, 1.0)
        errors.append(np.abs(y[:, 4] - expected).max() / np.abs(expected).max())
    assert errors[0] < 2e-3
    assert errors[1] < errors[0]


def test_inputs_are_interpolated_by_cubics():
    t = np.arange(9) * 0.1
    fine = np.arange(2 * 3 * 8 + 1) * 0.1 / 6
    cubic = partial(np.polyval, [1.0, -2.0, 0.3, 5.0])
    np.testing.assert_allclose(half_steps(cubic(t)[:, None], 3)[:, 0], cubic(fine), atol=1e-12)


def test_measured_inputs_that_are_sampled_coarsely_are_taken_as_band_limited():
    """Lines of 7 and 190 Hz at 500 Hz, in closed form; cubics lose more than a tenth of the latter."""
    t, fine = np.arange(501) * 2e-3, np.arange(4 * 500 + 1) * 5e-4

    def wave(times: np.ndarray) -> np.ndarray:
        return (np.sin(2 * pi * 7 * times) + np.sin(2 * pi * 190 * times + 0.3))[:, None]

    middle = slice(200, -200)
    np.testing.assert_allclose(measured_half_steps(wave(t), 2e-3, 2)[middle], wave(fine)[middle], atol=0.02)
    assert np.abs(half_steps(wave(t), 2) - wave(fine))[middle].max() > 0.1
    np.testing.assert_allclose(measured_half_steps(wave(t), 2e-3, 2)[::4], wave(t), atol=1e-12)
    np.testing.assert_array_equal(measured_half_steps(wave(t), 5e-4, 3), half_steps(wave(t), 3))


@pytest.mark.parametrize("high_Hz", [80.0, 995.0])
def test_a_multisine_is_its_sum_of_cosines(high_Hz: float):
    """Written out line by line, up to half the sample rate."""
    signal = Multisine(amplitude_N=30.0, low_Hz=5.0, high_Hz=high_Hz, seed=4, fade_s=0.0)
    plan = scenario(signal, duration_s=0.2)
    lines = np.arange(1, round(high_Hz / 5.0) + 1) * 5.0
    phases = np.random.default_rng(4).uniform(0, 2 * pi, len(lines))
    wave = np.cos(2 * pi * np.outer(plan.times, lines) + phases).sum(axis=1)
    found = inputs_of(plan.record[0], plan)[:, 0]
    np.testing.assert_allclose(found, 30.0 * wave / np.abs(wave).max(), rtol=0, atol=1e-10)


def test_a_diverging_loop_says_when_and_at_what_frequency(lag: Prototype):
    critical = critical_gain(lag)
    hot = lag.but(controller=lag.controller.but(gain_A_per_V=1.1 * critical.gain_A_per_V))
    record = simulate(hot, scenario(Step(amplitude_N=50.0, at_s=0.02), duration_s=3.0)).records[0]
    growing = max(loop(hot).at(0.0).poles(), key=lambda pole: pole.real)
    assert not record.stable
    assert record.diverged_at_s == pytest.approx(record.column("t_s")[-1] + 0.5e-3)
    assert record.oscillation.frequency_Hz == pytest.approx(abs(growing.imag) / (2 * pi), rel=1e-3)
    assert record.oscillation.growth_per_s == pytest.approx(growing.real, rel=1e-2)
    assert np.all(np.isfinite(record.samples))
    assert np.abs(record.column("displacement_m")).max() <= 0.02


@pytest.mark.parametrize("mass", [0.0, 3.0, 20.0])
def test_a_record_too_short_for_turns_tells_growth_all_the_same(lag: Prototype, mass: float):
    """After the push there are fewer than six turns; those of the unstable loops grow at least fivefold."""
    row = ScenarioRecord(
        name="one", outer_end_mass_kg=mass, input=(Step(amplitude_N=20.0, at_s=0.001, rise_s=0.001, length_s=0.002),)
    )
    record = simulate(lag, Scenario(name="test", duration_s=0.1, record=(row,))).records[0]
    closed = loop(lag).at(mass)
    assert closed.stable == (mass == 0.0)
    assert closed.stable or np.exp(0.095 * closed.poles().real.max()) > 5
    assert record.stable == closed.stable
    assert closed.stable or ("ever further" in record.reason) == (record.oscillation is None)


def test_saturation_turns_divergence_into_a_sustained_oscillation(lag: Prototype):
    critical = critical_gain(lag)
    hot = lag.but(
        controller=lag.controller.but(gain_A_per_V=1.2 * critical.gain_A_per_V),
        effects={"current_saturation": {"limit_A": 2e-3}},
    )
    plan = scenario(Step(amplitude_N=50.0, at_s=0.02, length_s=0.01), duration_s=2.0)
    record = simulate(hot, plan).records[0]
    assert not record.stable
    assert record.diverged_at_s is None
    assert np.abs(record.column("current_A")).max() == 2e-3
    assert record.oscillation.growth_per_s == pytest.approx(0.0, abs=0.1)
    assert record.oscillation.frequency_Hz == pytest.approx(critical.frequency_Hz, rel=0.02)
    assert "does not die out" in record.reason or "grows" in record.reason


def test_gain_raised_in_simulation_ends_at_the_exact_critical_gain(lag: Prototype):
    exact = critical_gain(lag)
    found = critical_gain_by_kicks(lag, 0.0, 0.8 * exact.gain_A_per_V, 1.3 * exact.gain_A_per_V)
    assert found.gain_A_per_V == pytest.approx(exact.gain_A_per_V, rel=1e-3)
    assert found.frequency_Hz == pytest.approx(exact.frequency_Hz, rel=1e-3)


def test_a_sampled_controller_is_the_continuous_one_late_by_half_its_period(lag: Prototype):
    step, period = Step(amplitude_N=100.0, at_s=0.02), 4e-4
    late = lag.but(effects={"transport_delay": {"delay_s": period / 2}})
    plan = scenario(step, sample_s=1e-4, sampled=Sampled(period_s=period))
    sampled, continuous, delayed = (
        simulate(rig, given).records[0].column("inner_displacement_m")
        for rig, given in ((lag, plan), (lag, scenario(step, sample_s=1e-4)), (late, scenario(step, sample_s=1e-4)))
    )
    scale = np.abs(continuous).max()
    assert np.abs(sampled - continuous).max() > 0.02 * scale
    assert np.abs(sampled - delayed).max() < 0.1 * np.abs(sampled - continuous).max()


def test_whole_periods_of_delay_bring_the_critical_gain_down(lag: Prototype):
    plan = scenario(Step(amplitude_N=100.0, at_s=0.02), duration_s=1.0, sampled=Sampled(period_s=5e-4, delay_periods=6))
    assert not simulate(lag, plan).stable  # 3 ms at 80 Hz turn the phase by 86 degrees
    assert simulate(lag, plan.but(sampled=Sampled(period_s=5e-4))).stable


def test_a_valve_that_is_wide_open_is_stepped_as_finely_as_it_takes(lag: Prototype):
    """An unstable loop whose orifices saturate, beside equations of the test's own by an implicit method of scipy.

    The stiffest motion is that of a chamber at the supply pressure behind an open edge: 10^4 times faster than any at
    rest. With the steps that those ask for the loop seemed to stay within 19 mm, at 14 times the supply pressure.
    """
    rig = lag.but(effects={"pressure_dependent_flow": {}})
    row = ScenarioRecord(name="one", outer_end_mass_kg=6.8, input=(Step(amplitude_N=100.0, at_s=0.01),))
    record = simulate(rig, Scenario(name="test", duration_s=0.3, record=(row,), displacement_limit_m=0.05)).records[0]
    (outer, inner), valve, law = (rig.outer_beam, rig.inner_beam), rig.servovalve, rig.controller
    area, supply, natural = rig.actuator.piston_area_m2, rig.supply.pressure_Pa, 2 * pi * valve.natural_frequency_Hz
    spring, leakage = rig.actuator.oil_stiffness_N_per_m / (2 * area**2), valve.leakage_m3_per_s_per_Pa

    def held(beam, x, v):
        stiffness, mass = beam.stiffness_N_per_m, beam.effective_mass_kg
        return stiffness * x + 2 * beam.damping_ratio * (stiffness * mass) ** 0.5 * v

    def orifice(drop):
        share = drop / supply
        return share / (share**2 + 1e-6) ** 0.25 / (0.5 / 0.250001**0.25)

    def rates(t, state):
        x, v, x_i, v_i, a, b, q, q_rate, slow = state
        push = 50 * (1 - np.cos(pi * np.clip((t - 0.01) / 0.002, 0, 1))) + area * (a - b)
        error = -rig.sensor.gain_V_per_m * x
        current = law.gain_A_per_V * (slow + (error - slow) * law.pole_Hz / law.zero_Hz)
        into, out = (orifice(supply - a), orifice(b)) if q > 0 else (orifice(a), orifice(supply - b))
        return [
            v, (push - held(outer, x, v)) / (outer.effective_mass_kg + 6.8),
            v_i, (-area * (a - b) - held(inner, x_i, v_i)) / (inner.effective_mass_kg + rig.payload.inner_end_mass_kg),
            spring * (q * into - 2 * leakage * (a - supply / 2) - area * (v - v_i)),
            spring * (area * (v - v_i) - q * out - 2 * leakage * (b - supply / 2)),
            q_rate,
            natural**2 * (valve.flow_gain_m3_per_s_per_A * current - q) - 2 * valve.damping_ratio * natural * q_rate,
            2 * pi * law.pole_Hz * (error - slow),
        ]  # fmt: skip

    start = [0, 0, 0, 0, supply / 2, supply / 2, 0, 0, 0]
    size = np.array([1e-4, 1e-2, 1e-4, 1e-2, 1e6, 1e6, 1e-5, 1e-2, 1e-2])
    truth = solve_ivp(
        rates, (0, 0.27), start, "Radau", np.arange(541) * 5e-4, rtol=1e-6, atol=1e-7 * size, max_step=1e-3
    )
    assert record.diverged_at_s == pytest.approx(truth.t[np.argmax(np.abs(truth.y[0]) > 0.05)])
    until = int(record.certain_until_s / 5e-4)
    for name, expected in (("displacement_m", truth.y[0]), ("load_pressure_Pa", truth.y[4] - truth.y[5])):
        peak = np.abs(expected[: len(record.samples)]).max()
        np.testing.assert_allclose(record.column(name)[:until], expected[:until], atol=0.01 * peak)
    assert "one of many" in record.uncertain
    inputs = inputs_of(row, Scenario(name="test", duration_s=0.3, record=(row,)))
    given = TimeRecord("one", np.arange(601) * 5e-4, inputs, {}, 6.8, rig.payload.inner_end_mass_kg, law)
    predicted = predict_record(rig, given, rig.sensor.gain_V_per_m)
    assert predicted.certain_until_s == record.certain_until_s
    one, other = (each.column("displacement_m")[:until] for each in (predicted, record))
    np.testing.assert_allclose(one, other, atol=1e-6)


def test_a_record_too_long_to_be_stepped_finer_is_not_said_to_be_uncertain() -> None:
    still, same = refined(lambda factor: np.zeros((5, 1)), np.asarray, ("displacement_m",), MOST_STEPS)
    assert same == len(still)


@pytest.mark.parametrize("force", [100.0, -3000.0])
def test_a_rig_of_a_hundredth_of_all_forces_moves_alike(lag: Prototype, force: float):
    """Similarity: with masses, stiffnesses, areas and flows scaled by one factor, displacements and pressures stay."""

    def scaled(factor: float) -> np.ndarray:
        beams = {
            name: getattr(lag, name).but(stiffness_N_per_m=factor * stiffness, effective_mass_kg=factor * mass)
            for name, stiffness, mass in (("outer_beam", 486800.0, 3.9), ("inner_beam", 157500.0, 1.6))
        }
        rig = lag.but(
            effects={"pressure_dependent_flow": {}},
            actuator=lag.actuator.but(piston_area_m2=factor * 1.13e-4, oil_stiffness_N_per_m=factor * 1.3e7),
            servovalve=lag.servovalve.but(
                flow_gain_m3_per_s_per_A=factor * 1.13e-2, leakage_m3_per_s_per_Pa=factor * 3.8e-13
            ),
            **beams,
        )
        return simulate(rig, scenario(Step(amplitude_N=factor * force), duration_s=0.2)).records[0].samples

    whole, small = (one[:, 3:] / np.abs(one[:, 3:]).max(axis=0) for one in (scaled(1.0), scaled(0.01)))
    np.testing.assert_allclose(small, whole, atol=1e-2)


@pytest.mark.parametrize("start", ["rest", "loaded"])
def test_a_preload_that_bends_the_rig_beyond_the_limit_is_told(lag: Prototype, start: str):
    plan = scenario(preload_N=1500.0, start=start, displacement_limit_m=1e-6)
    if start == "rest":
        assert simulate(lag, plan).records[0].diverged_at_s is not None
        return
    with pytest.raises(InputError, match="beyond the displacement limit, 1e-06 m") as caught:
        simulate(lag, plan)
    assert caught.value.problems[0].key == "record.one"


def test_records_start_at_rest_under_their_preload(lag: Prototype):
    rig = lag.but(effects={"pressure_dependent_flow": {}, "unequal_piston_areas": {}})
    still, stepped = (simulate(rig, scenario(preload_N=800.0, start=start)).records[0] for start in ("loaded", "rest"))
    for name in COLUMNS[3:]:
        assert np.ptp(still.column(name)) <= 1e-6 * np.abs(stepped.column(name)).max()
    assert stepped.column("displacement_m")[-1] == pytest.approx(still.column("displacement_m")[0], rel=0.02)


@pytest.mark.parametrize("limit_A", [3e-4, 1e-3])
@pytest.mark.parametrize("mass", [0.0, 3.0, 20.0])
def test_a_rig_whose_current_saturates_rests_where_the_linear_one_does(lag: Prototype, limit_A: float, mass: float):
    """Statics in closed form, whatever the mass and whether the loop is stable: x (K_m + A K_q K F / K_pq) = F_d."""
    rig = lag.but(effects={"current_saturation": {"limit_A": limit_A}})
    plan = parse(Scenario, {
        "name": "test", "duration_s": 0.05,
        "record": [{"name": "one", "outer_end_mass_kg": mass, "preload_N": 220.0}],
    }, "test")  # fmt: skip
    valve, law = rig.servovalve, rig.controller.gain_A_per_V * rig.sensor.gain_V_per_m
    held = rig.actuator.piston_area_m2 * valve.flow_gain_m3_per_s_per_A / valve.leakage_m3_per_s_per_Pa
    x = 220.0 / (rig.outer_beam.stiffness_N_per_m + held * law)
    record = simulate(rig, plan).records[0]
    assert law * x < limit_A
    assert record.column("displacement_m")[0] == pytest.approx(x, rel=1e-9)
    assert record.column("current_A")[0] == pytest.approx(-law * x, rel=1e-9)


def test_noise_comes_with_its_seed(lag: Prototype):
    given = {"displacement_std_m": 1e-6, "displacement_step_m": 5e-7}
    first, again, other = (
        simulate(lag, scenario(measurement=parse_measurement(given | {"seed": seed})))
        .records[0]
        .column("displacement_m")
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert np.any(first != other)
    np.testing.assert_allclose(first / 5e-7, np.round(first / 5e-7), atol=1e-9)
    assert np.std(first) == pytest.approx(1e-6, rel=0.1)


def parse_measurement(table):
    from beamdesign.scenario import Measurement

    return parse(Measurement, table, "test")


def test_oscillation_of_a_known_signal():
    t = np.arange(2000) * 5e-4
    found = oscillation(t, 3e-4 * np.exp(1.5 * t) * np.sin(2 * pi * 87.3 * t))
    assert found.frequency_Hz == pytest.approx(87.3, rel=1e-3)
    assert found.growth_per_s == pytest.approx(1.5, rel=0.02)
    assert oscillation(t, t) is None


def test_scenario_problems_are_told_together(tmp_path: Path):
    path = tmp_path / "s.toml"
    path.write_text(
        """
        name = "s"
        duration_s = 1.0
        sampled = { period_s = 7.5e-4 }
        [[record]]
        name = "a"
        input = [{ kind = "step", amplitude_N = 1.0, amplitude_V = 1.0 }, { kind = "sine", amplitude_mm = 1.0 }]
        [[record]]
        name = "a"
        outer_end_mass_kg = -1.0
        """
    )
    with pytest.raises(InputError) as told:
        read_scenario(path)
    reasons = dict(told.value.problems)
    assert {"sampled.period_s", "record.name", "record.input", "record.outer_end_mass_kg"} <= set(reasons)
    assert reasons["record.outer_end_mass_kg"].startswith("entry 2: ")
    assert "record" not in reasons


def test_where_a_piston_starts_is_for_a_bench(lag: Prototype):
    row = ScenarioRecord(name="a", start_m=0.01)
    with pytest.raises(InputError) as told:
        simulate(lag, Scenario(name="s", duration_s=0.1, record=(row,)))
    assert [problem.key for problem in told.value.problems] == ["record.a.start_m"]


def test_a_band_between_two_lines_of_a_record_is_told(tmp_path: Path):
    """Lines are multiples of 1/duration: without one the record would be of a rig that nothing drives."""
    path, text = (
        tmp_path / "s.toml",
        """
        name = "s"
        duration_s = 0.4
        [[record]]
        name = "a"
        [[record]]
        name = "b"
        input = [{ kind = "multisine", amplitude_N = 5.0, low_Hz = 3.0, high_Hz = 4.5 }]
        """,
    )
    path.write_text(text)
    with pytest.raises(InputError) as told:
        read_scenario(path)
    (problem,) = told.value.problems
    assert problem.key.startswith("record")
    assert "2.5 Hz" in problem.reason
    path.write_text(text.replace("4.5", "5.0"))
    plan = read_scenario(path)
    assert np.abs(inputs_of(plan.record[1], plan)).max() == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("signal", "told"),
    [
        ('kind = "sine", frequency_Hz = 1990.0', "for a lower frequency: frequency_Hz must be less than 1000 Hz"),
        ('kind = "multisine", high_Hz = 1500.0', "high_Hz must be less than 1000 Hz, or sample_s less than 0.000333"),
        ('kind = "step", at_s = 5.0', "begins after the last"),
        ('kind = "step", at_s = 0.10001, rise_s = 1e-5, length_s = 3e-4', "is over between two samples"),
        ('kind = "step", rise_s = 0.01, length_s = 3e-4', "must be at least rise_s, 0.01, is 0.0003"),
        ('kind = "load_steps", rise_s = 0.1, dwell_s = 0.05', "must be at least rise_s, 0.1, is 0.05"),
    ],
)  # fmt: skip
def test_a_signal_that_its_samples_do_not_show_is_refused(signal: str, told: str, tmp_path: Path):
    """At 2 kHz a sine at 1990 Hz has the samples of one at 10 Hz, which moved the tip 10^4 times as far."""
    path = tmp_path / "s.toml"
    row = f'[[record]]\nname = "a"\ninput = [{{ amplitude_N = 5.0, {signal} }}]\n'
    path.write_text(f'name = "s"\nduration_s = 0.4\n{row}')
    with pytest.raises(InputError) as caught:
        read_scenario(path)
    (problem,) = caught.value.problems
    assert problem.key.startswith("record")
    assert told in problem.reason


def test_csv_inputs_are_checked_and_replayed(tmp_path: Path, lag: Prototype):
    plan = scenario(Step(amplitude_N=100.0))
    first = simulate(lag, plan).records[0]
    np.savetxt(
        tmp_path / "in.csv", first.samples[:, :3], delimiter=",", header="t_s,disturbance_N,command_V", comments=""
    )
    text = 'name = "s"\nduration_s = 0.5\n[[record]]\nname = "a"\ninput = [{ kind = "csv", file = "in.csv" }]\n'
    (tmp_path / "s.toml").write_text(text)
    again = simulate(lag, read_scenario(tmp_path / "s.toml")).records[0]
    np.testing.assert_allclose(again.samples, first.samples, rtol=1e-9, atol=1e-15)
    (tmp_path / "s.toml").write_text(text.replace("0.5", "0.7"))
    with pytest.raises(InputError, match=r"record\.0\.input\.0\.file"):
        read_scenario(tmp_path / "s.toml")


def test_no_record_takes_the_place_of_an_input_that_is_read(tmp_path: Path):
    """A record is named by the scenario as its input may be, and both may stand in one folder."""
    held = "t_s,disturbance_N\n" + "".join(f"{0.005 * k:.3f},{10 * (k > 4)}\n" for k in range(21))
    (tmp_path / "push.csv").write_text(held)
    entry = '[[record]]\nname = "push"\ninput = [{ kind = "csv", file = "push.csv" }]\n'
    (tmp_path / "s.toml").write_text(f'name = "s"\nduration_s = 0.1\nsample_s = 0.005\n{entry}')
    rig = str(ROOT / "studies/prototypes/tame_lag.toml")
    arguments = ["simulate", rig, "--scenario", str(tmp_path / "s.toml"), "--no-plots", "--out"]
    ran = CliRunner().invoke(app, [*arguments, str(tmp_path)])
    assert isinstance(ran.exception, InputError)
    assert "would be written over push.csv, which is read" in str(ran.exception)
    assert (tmp_path / "push.csv").read_text() == held
    assert CliRunner().invoke(app, [*arguments, str(tmp_path / "out")]).exit_code == 0


def test_command_writes_records_and_answers_with_its_status(tmp_path: Path):
    arguments = ["simulate", str(ROOT / "studies/prototypes/paper_remedy.toml"), "--out", str(tmp_path / "out")]
    arguments += ["--scenario", str(ROOT / "studies/scenarios/kick.toml"), "--json", str(tmp_path / "a.json")]
    arguments += ["--no-plots"]
    ran = CliRunner().invoke(app, arguments)
    assert ran.exit_code == 1
    answer = json.loads((tmp_path / "a.json").read_text())
    assert answer["stable"] is False
    assert [each["stable"] for each in answer["each"]] == [True, False]
    remedy = loop(read_prototype(ROOT / "studies/prototypes/paper_remedy.toml")).at(0.0)
    growing = max(remedy.poles(), key=lambda pole: pole.real)
    assert answer["each"][1]["oscillation_Hz"] == pytest.approx(abs(growing.imag) / (2 * pi), rel=2e-3)
    for path in answer["records"]:
        with open(path, newline="") as file:
            rows = list(csv.DictReader(file))
        assert tuple(rows[0]) == COLUMNS
        assert np.all(np.isfinite([[float(value) for value in row.values()] for row in rows]))


def test_command_names_what_is_wrong_with_an_effect(tmp_path: Path, lag: Prototype):
    write_prototype(lag.but(effects={"seal_friction": {"coulomb_N": 1e6}}), tmp_path / "p.toml")
    arguments = ["simulate", str(tmp_path / "p.toml"), "--scenario", str(ROOT / "studies/scenarios/kick.toml")]
    ran = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "out")])
    assert isinstance(ran.exception, InputError)
    assert (
        str(ran.exception)
        == f"{tmp_path / 'p.toml'}: effects.seal_friction.coulomb_N: must be from 0 to 1000, is 1e+06"
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("path", sorted((ROOT / "studies" / "scenarios").glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_scenarios_are_read(path: Path):
    plan = read_scenario(path)
    for row in plan.record:
        assert np.abs(inputs_of(row, plan)).max() > 0
