"""The actuator on a bench against closed forms of hydraulics and a simulation written without the project's code."""

from math import pi, sqrt
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from typer.testing import CliRunner

from beamdesign import (
    InputError,
    Prototype,
    read_bench_prototype,
    read_prototype,
    read_scenario,
    simulate,
    write_prototype,
)
from beamdesign.bench_prototype import BenchPrototype, read_any_prototype
from beamdesign.cli import app
from beamdesign.plant.assembly import assemble
from beamdesign.plant.bench_simulation import bench_parameters, bench_start, bench_structure, replay, simulate_bench
from beamdesign.plant.effects import causes
from beamdesign.plant.equilibrium import linearise
from beamdesign.plant.rigs import BENCH
from beamdesign.records import parse

BORE, ROD, STROKE, SUPPLY, TANK = 0.020, 0.014, 0.15, 6e6, 2e5
CAP, RING = pi / 4 * BORE**2, pi / 4 * (BORE**2 - ROD**2)
MEAN, FLOW_GAIN = (CAP + RING) / 2, 8e-6  # m2, m3/s/V
TABLE = {
    "name": "small cylinder",
    "kind": "actuator_bench",
    "actuator": {
        "bore_m": BORE,
        "rod_m": ROD,
        "piston_area_m2": MEAN,
        "stroke_m": STROKE,
        "supply_pressure_Pa": SUPPLY,
        "tank_pressure_Pa": TANK,
    },
    "servovalve": {"flow_gain_m3_per_s_per_V": FLOW_GAIN},
    "tolerance": {"flow_gain": 0.1},
}
SHARED = {
    "carrier_ripple", "current_saturation", "entrained_air", "pressure_dependent_flow", "seal_friction", "sensor_lag",
    "transport_delay", "unequal_piston_areas", "uneven_leakage", "valve_deadband", "valve_deadband_rounded",
    "valve_hysteresis", "valve_hysteresis_magnetic",
}  # fmt: skip
JOINT: dict[str, dict[str, float]] = {"unequal_piston_areas": {}, "pressure_dependent_flow": {}}


@pytest.fixture
def bench() -> BenchPrototype:
    return parse(BenchPrototype, TABLE, "table")


def run(rig: BenchPrototype, volts: float, seconds: float, **given: float) -> np.ndarray:
    times = np.arange(round(seconds / 1e-3) + 1) * 1e-3
    return replay(rig, times, np.full(len(times), volts), **given)


def steady(rig: BenchPrototype, volts: float) -> tuple[float, float, float]:
    """Speed and both pressures from a third to two thirds of the stroke."""
    y = run(rig, volts, 2.4 / abs(volts), start_m=0.02 if volts > 0 else STROKE - 0.02)
    middle = (y[:, 2] > STROKE / 3) & (y[:, 2] < 2 * STROKE / 3)
    assert middle.sum() > 50
    return float(np.polyfit(y[middle, 0], y[middle, 2], 1)[0]), *y[middle, 3:].mean(axis=0)


def orifice_balance(volts: float, friction: float, line: float, edge_b: float) -> tuple[float, float, float]:
    """Two orifices in series with a piston; Merritt (1967), chapters 3 and 6, Jelali and Kroll (2003), chapter 4."""
    sign = np.sign(volts)
    fills, empties = (CAP, RING) if sign > 0 else (RING, CAP)
    k = FLOW_GAIN * abs(volts) / sqrt(SUPPLY / 2)
    filling = 1 / (k * (1.0 if sign > 0 else edge_b)) ** 2 + line  # pressure per flow squared
    emptying = 1 / k**2 + line
    speed = sqrt((fills * SUPPLY - empties * TANK - friction) / (fills**3 * filling + empties**3 * emptying))
    full = SUPPLY - filling * (fills * speed) ** 2
    empty = TANK + emptying * (empties * speed) ** 2
    return (speed, full, empty) if sign > 0 else (-speed, empty, full)


@pytest.mark.parametrize("volts", [-4.0, 2.0])
def test_with_every_effect_off_speed_is_flow_over_the_mean_area(bench: BenchPrototype, volts: float):
    speed, pressure_a, pressure_b = steady(bench, volts)
    assert speed == pytest.approx(FLOW_GAIN * volts / MEAN, rel=1e-4)
    assert pressure_a == pytest.approx(pressure_b, rel=1e-3)


@pytest.mark.parametrize("volts", [-3.0, 3.0])
def test_a_linear_valve_drives_unequal_sides_by_the_one_that_fills(bench: BenchPrototype, volts: float):
    speed, pressure_a, pressure_b = steady(bench.but(effects={"unequal_piston_areas": {}}), volts)
    assert speed == pytest.approx(FLOW_GAIN * volts / (CAP if volts > 0 else RING), rel=1e-4)
    assert CAP * pressure_a == pytest.approx(RING * pressure_b, rel=1e-3)


@pytest.mark.parametrize(("line", "edge_b"), [(0.0, 1.0), (5e14, 0.85)])
@pytest.mark.parametrize("volts", [-4.0, 4.0])
@pytest.mark.parametrize("coulomb", [0.0, 60.0])
def test_orifices_and_sides_give_speed_and_pressures(
    bench: BenchPrototype, volts: float, coulomb: float, line: float, edge_b: float
):
    rig = bench.but(
        actuator=bench.actuator.but(line_loss_Pa_s2_per_m6=line),
        servovalve=bench.servovalve.but(edge_b_ratio=edge_b),
        effects=JOINT | {"seal_friction": {"coulomb_N": coulomb}},
    )
    found = steady(rig, volts)
    # Friction settles at a bounded rate, and the root goes over to a line near no pressure drop.
    assert found == pytest.approx(orifice_balance(volts, coulomb, line, edge_b), rel=1e-3)


def test_speeds_of_the_two_directions_go_with_the_root_of_the_areas(bench: BenchPrototype):
    rig = bench.but(actuator=bench.actuator.but(tank_pressure_Pa=0.0), effects=JOINT)
    assert -steady(rig, 4.0)[0] / steady(rig, -4.0)[0] == pytest.approx(sqrt(CAP / RING), rel=1e-3)


def test_deadband_null_and_constant_load_shift_what_they_should(bench: BenchPrototype):
    rig = bench.but(servovalve=bench.servovalve.but(null_V=0.3), effects={"valve_deadband": {"half_width_A": 0.5e-3}})
    assert steady(rig, 4.0)[0] == pytest.approx(FLOW_GAIN * (4.0 - 0.3 - 0.5) / MEAN, rel=1e-4)
    assert steady(rig, -4.0)[0] == pytest.approx(FLOW_GAIN * (-4.0 - 0.3 + 0.5) / MEAN, rel=1e-4)
    still = run(rig, 0.7, 0.5, start_m=0.05)
    assert np.abs(still[:, 2] - 0.05).max() < 1e-5
    loaded = bench.but(actuator=bench.actuator.but(constant_load_N=100.0))
    _, pressure_a, pressure_b = steady(loaded, 4.0)
    assert MEAN * (pressure_a - pressure_b) == pytest.approx(100.0, rel=1e-2)


@pytest.mark.parametrize(
    "name", ["sensor_lag", "empirical_sensor_lag", "empirical_sensor_resonance", "empirical_sensor_play"]
)
def test_a_piston_that_stands_is_read_where_it_stands(bench: BenchPrototype, name: str):
    y = run(bench.but(effects={name: {}}), 0.0, 0.1, start_m=0.1)
    assert y[:, 2] == pytest.approx(0.1, abs=1e-9)


def test_leakage_past_the_piston_slows_it(bench: BenchPrototype):
    """A linear valve against a load: v = (Q - G F/A)/A."""
    leakage, load = 2e-12, 300.0
    rig = bench.but(
        actuator=bench.actuator.but(piston_leakage_m3_per_s_per_Pa=leakage, constant_load_N=load),
    )
    assert steady(rig, 4.0)[0] == pytest.approx((FLOW_GAIN * 4.0 - leakage * load / MEAN) / MEAN, rel=1e-3)


def test_the_piston_rests_against_its_stops(bench: BenchPrototype):
    rig = bench.but(effects=JOINT)
    stiffness = rig.actuator.stop_stiffness_N_per_m
    out = run(rig, 4.0, 1.5)[-1]
    assert out[3:] == pytest.approx((SUPPLY, TANK), rel=1e-4)
    assert out[2] - STROKE == pytest.approx((CAP * SUPPLY - RING * TANK) / stiffness, rel=1e-3)
    back = run(rig, -4.0, 2.0, start_m=0.1)[-1]
    assert back[3:] == pytest.approx((TANK, SUPPLY), rel=1e-4)
    assert -back[2] == pytest.approx((RING * SUPPLY - CAP * TANK) / stiffness, rel=1e-3)
    start = bench_start(rig)
    assembly = assemble(bench_structure(rig))
    rate = np.asarray(assembly.function(0.0, start, np.zeros(3), list(bench_parameters(rig).values()))[0]).ravel()
    assert np.abs(rate[:6]) == pytest.approx(np.zeros(6), abs=1e-6)


@pytest.mark.parametrize("place", [0.02, STROKE / 2, STROKE - 0.02])
@pytest.mark.parametrize("effects", [{}, {"unequal_piston_areas": {}}])
def test_natural_frequency_along_the_stroke(bench: BenchPrototype, place: float, effects: dict):
    """Merritt (1967), chapter 6: omega^2 = beta/m (A_a^2/V_a + A_b^2/V_b); at mid-stroke 2 beta A^2/(V m)."""
    rig = bench.but(effects=effects)
    assembly, actuator = assemble(bench_structure(rig)), bench.actuator
    x, parameters = bench_start(rig, place), np.array(list(bench_parameters(rig).values()))
    poles = np.linalg.eigvals(linearise(assembly, x, np.zeros(3), parameters).a)
    area_a, area_b = (CAP, RING) if effects else (MEAN, MEAN)
    volume_a = actuator.dead_volume_m3 + area_a * place
    volume_b = actuator.dead_volume_m3 + area_b * (STROKE - place)
    springs = actuator.oil_bulk_modulus_Pa * (area_a**2 / volume_a + area_b**2 / volume_b)
    assert np.abs(poles - 1j * sqrt(springs / actuator.moving_mass_kg)).min() < 1.0
    if place == STROKE / 2 and not effects:
        assert springs == pytest.approx(2 * actuator.oil_bulk_modulus_Pa * MEAN**2 / volume_a)


def test_a_stroke_is_that_of_an_independent_simulation(bench: BenchPrototype):
    """Own equations, implicit integrator: extension from mid-stroke, with viscous friction, into the stop."""
    viscous, volts = 400.0, 5.0
    rig = bench.but(effects=JOINT | {"seal_friction": {"coulomb_N": 0.0, "viscous_N_s_per_m": viscous}})
    actuator, valve = rig.actuator, rig.servovalve
    natural, damping = 2 * pi * valve.natural_frequency_Hz, valve.damping_ratio
    stop_damping = sqrt(actuator.stop_stiffness_N_per_m * actuator.moving_mass_kg)

    def root(drop: float) -> float:
        return float(np.sign(drop) * sqrt(abs(drop) / (SUPPLY / 2)))

    def rates(t: float, s: np.ndarray) -> list[float]:
        x, v, a, b, q, dq = s
        into_a = q * root(SUPPLY - a if q > 0 else a - TANK)
        out_of_b = q * root(b - TANK if q > 0 else SUPPLY - b)
        deep, short = max(x - STROKE, 0.0), max(-x, 0.0)
        stop = max(actuator.stop_stiffness_N_per_m * short - stop_damping * min(short / 1e-5, 1) * v, 0.0)
        stop -= max(actuator.stop_stiffness_N_per_m * deep + stop_damping * min(deep / 1e-5, 1) * v, 0.0)
        beta = actuator.oil_bulk_modulus_Pa
        return [
            v,
            (CAP * a - RING * b - viscous * v + stop) / actuator.moving_mass_kg,
            beta / (actuator.dead_volume_m3 + CAP * x) * (into_a - CAP * v),
            beta / (actuator.dead_volume_m3 + RING * (STROKE - x)) * (RING * v - out_of_b),
            dq,
            natural**2 * (FLOW_GAIN * volts - q) - 2 * damping * natural * dq,
        ]

    total = SUPPLY + TANK
    start = [0.135, 0.0, total / 2 * 2 * RING / (CAP + RING), total / 2 * 2 * CAP / (CAP + RING), 0.0, 0.0]
    times = np.arange(121) * 1e-3
    found = solve_ivp(
        rates, (0, times[-1]), start, "LSODA", t_eval=times, rtol=1e-6, atol=[1e-8, 1e-5, 10, 10, 1e-10, 1e-7]
    )
    y = replay(rig, times, np.full(len(times), volts), start_m=0.135)
    assert found.y[0][-1] > STROKE > found.y[0][-60]
    assert np.abs(y[:, 2] - found.y[0]).max() < 2e-5
    seen = np.abs(y[:, 3] - found.y[2])  # through a filter of 1 kHz
    assert np.sqrt(np.mean(seen**2)) < 0.01 * SUPPLY


def test_record_is_written_and_read_again(tmp_path: Path, bench: BenchPrototype, paper: Prototype):
    path = tmp_path / "bench.toml"
    write_prototype(bench.but(effects=JOINT), path)
    assert read_any_prototype(path) == bench.but(effects=JOINT)
    with pytest.raises(InputError, match="kind: 'actuator_bench' is not a rig this command can work on"):
        read_prototype(path)
    write_prototype(paper, path)
    assert read_any_prototype(path) == paper
    with pytest.raises(InputError, match="is not a bench"):
        read_bench_prototype(path)
    path.write_text('kind = "windmill"\n')
    with pytest.raises(InputError, match="no rig known here"):
        read_any_prototype(path)


def test_wrong_figures_are_told_together():
    table = TABLE | {
        "actuator": TABLE["actuator"] | {"rod_m": 0.03, "tank_pressure_Pa": 7e6},  # type: ignore[operator]
        "tolerance": {"leakage": 0.1},
    }
    with pytest.raises(InputError) as told:
        parse(BenchPrototype, table, "table")
    assert {problem.key for problem in told.value.problems} == {
        "actuator.rod_m", "actuator.tank_pressure_Pa", "tolerance.leakage"
    }  # fmt: skip
    area = TABLE | {"actuator": TABLE["actuator"] | {"piston_area_m2": CAP}}  # type: ignore[operator]
    with pytest.raises(InputError, match="is not the mean of both sides"):
        parse(BenchPrototype, area, "table")


@pytest.mark.parametrize("name", ["joint_backlash", "mount_compliance", "second_beam_mode"])
def test_effects_of_what_a_bench_lacks_are_refused(bench: BenchPrototype, name: str):
    with pytest.raises(InputError, match=f"effects.{name}: acts on .* which the actuator bench does not have"):
        bench_structure(bench.but(effects={name: {}}))


def test_every_other_effect_acts_on_the_bench_at_the_same_ports(bench: BenchPrototype):
    leaky = bench.but(servovalve=bench.servovalve.but(leakage_m3_per_s_per_Pa=1e-13))

    def rates_and_outputs(effects: dict) -> np.ndarray:
        rig = leaky.but(effects=effects)
        assembly = assemble(bench_structure(rig))
        x = bench_start(rig, 0.05)
        x[[assembly.states.index(n) for n in ("piston_m_per_s", "flow_m3_per_s", "flow_m3_per_s2")]] = 0.05, 2e-5, 1e-3
        x[len(BENCH.states) :] = 0.3
        found = assembly.function(1e-4, x, np.array([0.0, 100.0, 0.0]), list(bench_parameters(rig).values()))
        return np.concatenate([np.asarray(found[0]).ravel()[: len(BENCH.states)], np.asarray(found[1]).ravel()])

    plain = rates_and_outputs({})
    fitting = {name for name, effect in causes().items() if set(effect.laws) <= set(BENCH.ports)}
    assert fitting >= SHARED
    for name in fitting:
        assert np.any(rates_and_outputs({name: {}}) != plain)


SCENARIO = """
name = "out and back"
duration_s = 0.4
sample_s = 0.001
[[record]]
name = "steps"
input = [{ kind = "step", amplitude_V = 4.0 }]
start_m = 0.02
[[record]]
name = "table"
input = [{ kind = "csv", file = "command.csv" }]
"""


def test_command_writes_records(tmp_path: Path, bench: BenchPrototype):
    write_prototype(bench, tmp_path / "bench.toml")
    (tmp_path / "scenario.toml").write_text(SCENARIO)
    times = np.arange(401) * 1e-3
    np.savetxt(
        tmp_path / "command.csv",
        np.column_stack([times, 3 + 0 * times]),
        delimiter=",",
        header="t_s,command_V",
        comments="",
    )
    arguments = ["simulate", str(tmp_path / "bench.toml"), "--scenario", str(tmp_path / "scenario.toml")]
    answer = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "out")], catch_exceptions=False)
    assert answer.exit_code == 0
    with open(tmp_path / "out" / "table.csv") as file:
        assert file.readline().strip() == "t_s,command_V,displacement_m,pressure_a_Pa,pressure_b_Pa"
        y = np.loadtxt(file, delimiter=",")
    assert y[-1, 2] - y[-101, 2] == pytest.approx(0.1 * FLOW_GAIN * 3 / MEAN, rel=1e-3)


@pytest.mark.parametrize(
    ("asked", "key"),
    [
        ("start_m = 0.02", "start_m = 0.3"),
        ("amplitude_V = 4.0", "amplitude_N = 4.0"),
        ("sample_s = 0.001", 'sample_s = 0.001\nsampled = { period_s = 0.002 }'),
        ("start_m = 0.02", "wall = { at_m = 0.1, stiffness_N_per_m = 1e6 }"),
        ("start_m = 0.02", "payload_change = { at_s = 0.1, outer_end_mass_kg = 1.0 }"),
    ],
)  # fmt: skip
def test_what_a_bench_cannot_do_is_told(tmp_path: Path, bench: BenchPrototype, asked: str, key: str):
    (tmp_path / "scenario.toml").write_text(SCENARIO.replace(asked, key).partition('[[record]]\nname = "table"')[0])
    with pytest.raises(InputError):
        simulate_bench(bench, read_scenario(tmp_path / "scenario.toml"))


def test_shipped_bench_goes_out_and_back():
    folder = Path(__file__).parent.parent / "studies" / "bench"
    found = simulate(read_bench_prototype(folder / "cylinder.toml"), read_scenario(folder / "out_and_back.toml"))
    assert found.stable
    assert [name for name, *_ in found.rows()] == ["slow", "fast"]
    for record in found.records:
        assert record.column("displacement_m")[4000] == pytest.approx(0.25, abs=1e-3)
        assert abs(record.column("displacement_m")[-1]) < 1e-3
