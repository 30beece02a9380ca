"""Harmonic balance against the exact linear loop, and against the simulation of its own answers."""

from pathlib import Path

import numpy as np
import pytest
from honest_certificates import screw
from impulse_test import Kick, critical_gain_by_kicks, ringing
from lowest_edge import limit_cycles, linear_critical_gain

from beamdesign import Prototype, critical_gain, read_prototype, state_space
from beamdesign.controllers import Lag, Proportional
from beamdesign.loop import loop
from beamdesign.plant.assembly import assemble, parameters_of, structure_of
from beamdesign.plant.compiled import integrate
from beamdesign.plant.equilibrium import equilibrium
from beamdesign.plant.harmonic_balance import FreeRig, NoBalance, forced_motion
from beamdesign.plant.limit_cycles import LimitCycle, cycles_about_own
from beamdesign.plant.linear_reach import reach, with_published_effects
from beamdesign.prototype import Payload

STUDIES = Path(__file__).parents[1] / "studies/prototypes"
POINTS = 64  # samples per period


@pytest.fixture
def rig(paper: Prototype) -> Prototype:
    return paper.but(controller=Proportional(gain_A_per_V=0.02))


def periods(rig: Prototype, cycle: LimitCycle, count: int, scaled: float = 1.0) -> np.ndarray:
    """Half swing of the displacement in each period of a simulation that starts on (or scaled from) the balance."""
    there = rig.but(controller=rig.controller.but(gain_A_per_V=cycle.gain_A_per_V))
    coefficients = cycle.motion.coefficients.copy()
    coefficients[:, 1:] *= scaled
    start = coefficients[:, 0] + coefficients[:, 1::2].sum(axis=1)  # at time zero
    parameters = np.array(list(parameters_of(there, 0.0, 0.0).values()))
    times = np.arange(POINTS * count + 1) / (POINTS * cycle.motion.frequency_Hz)
    still = np.zeros((2 * 4 * POINTS * count + 1, 2))
    signal = integrate(structure_of(there), times, still, start, parameters, 4, 1.0)[0][:, 1]
    turns = [signal[k * POINTS : (k + 1) * POINTS + 1] for k in range((len(signal) - 1) // POINTS)]
    return np.array([np.ptp(turn) / 2 for turn in turns])


@pytest.mark.parametrize(("mass", "inner"), [(0.0, 0.0), (6.8, 4.4)])
def test_without_effects_the_gain_is_the_exact_critical_one_at_any_amplitude(
    paper: Prototype, mass: float, inner: float
):
    lag = paper.but(
        controller=Lag(gain_A_per_V=0.1, pole_Hz=1.75, zero_Hz=26.0), payload=Payload(inner_end_mass_kg=inner)
    )
    exact = critical_gain(lag, mass)
    linear = linear_critical_gain(lag, mass)
    for cycle in limit_cycles(lag, [1e-7, 1e-3], mass, harmonics=3):
        for gain in (linear.gain_A_per_V, cycle.gain_A_per_V):
            assert gain == pytest.approx(exact.gain_A_per_V, rel=1e-7)
        for frequency in (linear.frequency_Hz, cycle.motion.frequency_Hz):
            assert frequency == pytest.approx(exact.frequency_Hz, rel=1e-7)


@pytest.mark.parametrize(
    "effects", [{"pressure_dependent_flow": {}}, {"entrained_air": {}}, {"sensor_lag": {}}, {"mount_compliance": {}}]
)
def test_small_oscillations_begin_at_the_critical_gain_of_the_linearised_rig(rig: Prototype, effects: dict):
    there = rig.but(effects=effects)
    expected = linear_critical_gain(there)
    (cycle,) = limit_cycles(there, [1e-8], harmonics=3)
    assert cycle.gain_A_per_V == pytest.approx(expected.gain_A_per_V, rel=1e-5)
    assert cycle.motion.frequency_Hz == pytest.approx(expected.frequency_Hz, rel=1e-5)


def test_the_sensor_lag_is_the_filter_of_the_prototype(rig: Prototype):
    found = linear_critical_gain(rig.but(effects={"sensor_lag": {"break_Hz": 400.0}}))
    exact = critical_gain(rig.but(sensor=rig.sensor.but(filter_Hz=400.0)))
    assert found.gain_A_per_V == pytest.approx(exact.gain_A_per_V, rel=1e-8)


def test_a_magnet_holds_back_its_share_of_small_oscillations(rig: Prototype):
    """Below all thresholds the valve is a gain of one less the share; so the critical gain is so much larger."""
    there = rig.but(effects={"valve_hysteresis_magnetic": {"held_share": 0.4}})
    plain, expected = linear_critical_gain(there), critical_gain(rig)
    (faint,) = limit_cycles(there, [1e-8], harmonics=3)
    for found in (plain, faint):  # but for what the iron forgets meanwhile, 1e-4/s over the frequency in rad/s
        assert found.gain_A_per_V == pytest.approx(expected.gain_A_per_V / 0.6, rel=1e-6)


CASES = [
    ({"current_saturation": {"limit_A": 0.01}}, [3.9e-4, 4.2e-4]),
    ({"valve_deadband": {"half_width_A": 2e-4}}, [3e-4, 1e-4, 3e-5]),
    ({"valve_hysteresis": {"half_width_A": 1e-4}}, [1e-3, 1e-4, 3e-5]),
    ({"valve_hysteresis_magnetic": {"half_width_A": 1e-4}}, [1e-3, 1e-4, 3e-5]),
    ({"unequal_piston_areas": {"asymmetry": 0.121}}, [1e-5, 1e-3]),
    ({"pressure_dependent_flow": {}}, [3e-5, 3e-4, 1e-3]),
    ({"seal_friction": {"coulomb_N": 60.0}}, [1e-3, 1e-4, 1e-5]),
    ({"entrained_air": {"air_fraction": 0.05}}, [1e-4, 5e-4]),
    ({"pressure_dependent_flow": {}, "unequal_piston_areas": {}, "current_saturation": {}}, [1e-4, 4e-4]),
]


@pytest.mark.parametrize(
    ("effects", "amplitudes"), CASES, ids=lambda given: "+".join(given) if type(given) is dict else ""
)
def test_simulation_stays_on_the_predicted_cycle(rig: Prototype, effects: dict, amplitudes: list[float]):
    """The integrator knows nothing of Fourier series; started on the balance it goes round in the same swing."""
    there = rig.but(effects=effects)
    cycles = limit_cycles(there, amplitudes)
    for cycle, amplitude in zip(cycles, amplitudes, strict=True):
        assert cycle.motion.amplitude_m == pytest.approx(amplitude, rel=1e-6)
        np.testing.assert_allclose(periods(there, cycle, 3) / cycle.motion.swing_m, 1.0, atol=5e-3)


def test_the_slope_of_the_curve_tells_which_cycles_repel(rig: Prototype):
    """Saturation: what is off by 5 % comes back. Deadband: it dies out below and grows above."""
    limited = rig.but(effects={"current_saturation": {"limit_A": 0.01}})
    (stable,) = limit_cycles(limited, [4e-4])
    assert stable.stable
    assert stable.steepness > 0
    for scaled in (0.95, 1.05):
        assert periods(limited, stable, 20, scaled)[-1] == pytest.approx(stable.motion.swing_m, rel=2e-3)
    dead = rig.but(effects={"valve_deadband": {"half_width_A": 2e-4}})
    (unstable,) = limit_cycles(dead, [1e-4])
    assert not unstable.stable
    assert unstable.steepness < 0
    assert periods(dead, unstable, 20, 0.95)[-1] < 0.5 * unstable.motion.swing_m
    assert periods(dead, unstable, 20, 1.05)[-1] > 1.5 * unstable.motion.swing_m


@pytest.mark.parametrize("dead", [False, True])
def test_a_loop_that_is_unstable_at_lower_gains_has_a_curve_on_either_side_of_its_own(dead: bool):
    """Only the lowest of all was followed, at a fortieth of its gain, and Loeb's rule is the other way round below.

    With a dead band the shipped law of three sections goes on by itself: from more and from less it comes to one swing.
    """
    rig = with_published_effects(read_prototype(STUDIES / "structured.toml"))
    rig = rig.but(payload=rig.payload.but(inner_end_mass_kg=0.0), sensor=rig.sensor.but(noise_V=None))
    rig = rig.but(effects={**rig.effects, "valve_deadband": {}} if dead else rig.effects)
    own = rig.controller.gain_A_per_V
    found = cycles_about_own(rig, [1e-4], 0.0)
    below, above = (cycle for _, cycle in found)
    assert 0.3 * own < below.gain_A_per_V < own < above.gain_A_per_V
    assert (below.stable, below.steepness < 0) == (dead, dead)
    if dead:
        for scaled in (0.7, 1.3):
            assert periods(rig, below, 60, scaled)[-1] == pytest.approx(below.motion.swing_m, rel=5e-2)
        return
    for cycle in (below, above):  # small ones begin where a root pair of the linear rig crosses the axis
        rates = [
            state_space(rig.but(controller=rig.controller.but(gain_A_per_V=share * cycle.gain_A_per_V))).poles().real
            for share in (0.95, 1.05)
        ]
        ends = [rate.max() > 0 for rate in rates]
        assert ends == [cycle is below, cycle is above]


def test_an_experiment_settles_on_the_predicted_amplitude_and_frequency(rig: Prototype):
    limited = rig.but(effects={"current_saturation": {"limit_A": 0.01}})
    for cycle in limit_cycles(limited, [3.8e-4, 4.2e-4]):
        settled = ringing(limited, cycle.gain_A_per_V, 0.0, Kick(force_N=50.0))
        assert settled is not None
        assert settled.amplitude == pytest.approx(cycle.motion.swing_m, rel=2e-3)
        assert settled.frequency_Hz == pytest.approx(cycle.motion.frequency_Hz, rel=2e-4)
        assert abs(settled.growth_per_s) < 0.05


@pytest.mark.parametrize(
    ("effects", "force"),
    [
        ({"unequal_piston_areas": {}}, 50.0),
        ({"pressure_dependent_flow": {}}, 20.0),
        ({"pressure_dependent_flow": {}}, 100.0),
        ({"entrained_air": {}}, 50.0),
        ({"seal_friction": {"coulomb_N": 10.0}}, 200.0),
    ],
)
def test_kicks_of_rising_gain_find_the_predicted_gain_at_their_amplitude(rig: Prototype, effects: dict, force: float):
    there = rig.but(effects=effects)
    kick = Kick(force_N=force, settle_s=0.2, watch_s=0.3)
    found = critical_gain_by_kicks(there, 0.0, 0.015, 0.05, kick, 2e-4)
    seen = ringing(there, found.gain_A_per_V, 0.0, kick)
    assert seen is not None
    (cycle,) = limit_cycles(there, [seen.amplitude])
    assert found.gain_A_per_V == pytest.approx(cycle.gain_A_per_V, rel=4e-3)
    assert found.frequency_Hz == pytest.approx(cycle.motion.frequency_Hz, rel=4e-3)


def test_one_harmonic_is_off_where_the_current_is_nearly_square(rig: Prototype):
    """Where describing functions fail: 22 % of the gain at an amplitude that simulation gives to 0.1 %."""
    limited = rig.but(effects={"current_saturation": {"limit_A": 0.01}})
    one, nine = (limit_cycles(limited, [4e-4, 4.3e-4], harmonics=h)[-1] for h in (1, 9))
    assert one.gain_A_per_V / nine.gain_A_per_V == pytest.approx(1.22, abs=0.03)
    assert abs(periods(limited, nine, 2)[1] / nine.motion.swing_m - 1) < 1e-3
    assert abs(periods(limited, one, 2)[1] / one.motion.swing_m - 1) > 0.02


def test_no_balance_is_told(rig: Prototype):
    """A saturated current drives no more than 4/pi of its limit: beyond that amplitude there is no cycle."""
    with pytest.raises(NoBalance, match="no periodic motion"):
        limit_cycles(rig.but(effects={"current_saturation": {"limit_A": 0.01}}), [3e-4, 6e-4], harmonics=1)
    with pytest.raises(ValueError, match="in time"):
        limit_cycles(rig.but(effects={"carrier_ripple": {}}), [1e-4])


@pytest.mark.parametrize("frequency", [0.5, 10.0, 80.0])
def test_forced_motion_of_the_linear_rig_is_its_compliance(rig: Prototype, frequency: float):
    compliance = loop(rig).at(2.0).compliance_response(np.array([frequency]))[0]
    found = forced_motion(rig, 100.0, frequency, 2.0, preload=500.0, harmonics=2)
    assert found.phasor_m / 100.0 == pytest.approx(compliance, rel=1e-8)
    assert found.mean_m == pytest.approx(500.0 * loop(rig).at(2.0).static_compliance(), rel=1e-6)


def test_a_rig_in_which_nothing_leaks_moves_as_one_in_which_next_to_nothing_does(rig: Prototype):
    """The mean pressure of its chambers is then whatever it was, and no part of the motion."""
    found = []
    for leakage in (0.0, 1e-18):
        tight = rig.but(servovalve=rig.servovalve.but(leakage_m3_per_s_per_Pa=leakage))
        compliance = loop(tight).at(2.0).compliance_response(np.array([10.0]))[0]
        for harmonics in (1, 5):
            assert forced_motion(tight, 100.0, 10.0, 2.0, harmonics=harmonics).phasor_m == pytest.approx(
                100.0 * compliance, rel=1e-6
            )
        found.append(reach(with_published_effects(tight), "force", 10.0).limit)
    assert found[0] == pytest.approx(found[1], rel=1e-3)


def test_a_motion_that_nothing_tends_to_is_not_the_forced_one(paper: Prototype):
    """With play a symmetric motion of 400 um balances, and repels; the integrator comes to another one from rest."""
    law = Lag(gain_A_per_V=0.08, pole_Hz=1.75, zero_Hz=26.0)
    rig = paper.but(controller=law, effects={"joint_backlash": {}})
    force, frequency, points = 88.3, 41.2, 4096
    parameters = np.array(list(parameters_of(rig, 0.0, 0.0).values()))
    start = equilibrium(assemble(structure_of(rig)), np.zeros(3), parameters)
    pushed = np.column_stack(
        [force * np.cos(np.pi * np.arange(2 * 40 * points + 1) / points), np.zeros(80 * points + 1)]
    )
    times = np.arange(40 * points + 1) / (points * frequency)
    moved = integrate(structure_of(rig), times, pushed, start, parameters, 1, 1.0)[0][-points:, 1]
    turned = np.exp(-2j * np.pi * np.arange(1, points + 1) / points)
    found = forced_motion(rig, force, frequency)
    assert found.phasor_m == pytest.approx(complex(2 * np.mean(moved * turned)), rel=1e-4)
    assert found.swing_m == pytest.approx(np.ptp(moved) / 2, rel=1e-3)


def test_a_rig_that_oscillates_by_itself_has_no_forced_motion(rig: Prototype):
    """A dead band closes no loop at rest; beyond it this one has 1.6 times the critical gain."""
    hot = rig.but(controller=Proportional(gain_A_per_V=1.6 * critical_gain(rig).gain_A_per_V))
    for effects in ({}, {"valve_deadband": {}}):
        with pytest.raises(NoBalance, match=r"no motion of the period|all bounds"):
            forced_motion(hot.but(effects=effects), 50.0, 10.0)


def test_air_that_makes_the_loop_unstable_is_more_than_the_linear_model_bears(paper: Prototype):
    """Under half the supply air scales the spring of the oil: at the limit the linear loop stops being stable."""
    law = Lag(gain_A_per_V=0.15, pole_Hz=1.75, zero_Hz=26.0)
    remedy = paper.but(controller=law, payload=Payload(inner_end_mass_kg=4.5))

    def stable(air: float) -> bool:
        oil, pressure, atmosphere = 1.4e9, remedy.supply.pressure_Pa / 2 + 101_325.0, 101_325.0
        shrunk = air * (atmosphere / pressure) ** (1 / 1.4)
        softer = (1 - air + shrunk) / (1 - air + shrunk * oil / (1.4 * pressure))
        stiffness = softer * remedy.actuator.oil_stiffness_N_per_m
        return loop(remedy.but(actuator=remedy.actuator.but(oil_stiffness_N_per_m=stiffness))).at(6.8).stable

    found = reach(remedy, "air", 10.0, 6.8)
    assert stable(0.999 * found.limit)
    assert not stable(1.001 * found.limit)
    assert found.departure == np.inf


@pytest.mark.parametrize("share", [1.0, 0.06])
def test_the_reach_of_a_linear_rig_with_a_saturated_drive_is_a_share_of_its_limit(
    share: float, monkeypatch: pytest.MonkeyPatch
):
    """Nothing else being off, forces are to each other as the limits; the corners of the law cost few evaluations."""
    counted, along = [], FreeRig.along
    monkeypatch.setattr(FreeRig, "along", lambda *given: counted.append(1) or along(*given))
    stiff = screw().but(controller=Lag(gain_A_per_V=4313.0, pole_Hz=1.2, zero_Hz=18.0))
    stiff = stiff.but(actuator=stiff.actuator.but(peak_current_A=30.0))
    found = reach(stiff.but(effects={"current_saturation": {"limit_A": 5.0 * share}}), "force", 50.0, 6.8)
    assert found.limit == pytest.approx(15.82 * share, rel=2e-3)
    assert found.departure == pytest.approx(0.1, rel=2e-2)
    assert len(counted) < 2000
