"""Play in a joint, from records of a rig that is simulated here by other means, and that no model can repeat."""

from dataclasses import replace
from functools import cache
from math import copysign, pi, sqrt
from pathlib import Path

import numpy as np
import pytest
from gap_sets import LAG, believed, measured, only, scenario
from honest_certificates import screw
from scipy.integrate import odeint
from test_truth import drive

from beamdesign.diagnosis import second_look
from beamdesign.diagnosis.data.dataset import Dataset, MeasuredGain, TimeRecord
from beamdesign.diagnosis.fitting.evidence import evidence_of, record_evidence, spread, with_output_injection
from beamdesign.diagnosis.fitting.fit import Fit, fit
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, Hypothesis, together
from beamdesign.diagnosis.fitting.search import Search
from beamdesign.diagnosis.fitting.weighting import INDEPENDENT, blurred, weighting
from beamdesign.diagnosis.judgement import judge
from beamdesign.diagnosis.second_look import backlash_impacts, loose_joint, refit_backlash_impacts
from beamdesign.progress import silent
from beamdesign.validation.truth.nominal import assembled, rig_figures
from beamdesign.validation.truth.rig import controller_figures, march

pytestmark = pytest.mark.long

LOOSE = loose_joint(believed())
PLAY_M, ROD_kg, WORN_M = 60e-6, 0.2, 30e-6
NOISE_M = 3e-7
SLOW_Hz = 80.0
SLOWED = together("sensor_lag")


def _hand_written(
    command: np.ndarray, force: np.ndarray, times: np.ndarray, noise: np.ndarray, slow_s: float = 0.0
) -> tuple[np.ndarray, ...]:
    """Current and displacement of the published rig with a loose joint, equations (7) to (16) written out.

    The joint's faces press with a force of the power 1.3 of their indentation, and lose by it (Hunt and Crossley): not
    the law of the library. The rod was weighed with the inner beam. The sensor may be slow, with a time constant.
    """
    rig = believed()
    k_m, m_m = rig.outer_beam.stiffness_N_per_m, rig.outer_beam.effective_mass_kg
    k_f, m_f = rig.inner_beam.stiffness_N_per_m, rig.inner_beam.effective_mass_kg - ROD_kg
    b_m = 2 * rig.outer_beam.damping_ratio * sqrt(k_m * m_m)
    b_f = 2 * rig.inner_beam.damping_ratio * sqrt(k_f * (m_f + ROD_kg))
    k_c, area = rig.actuator.oil_stiffness_N_per_m, rig.actuator.piston_area_m2
    valve = rig.servovalve
    w_n, gain, leak = 2 * pi * valve.natural_frequency_Hz, valve.flow_gain_m3_per_s_per_A, valve.leakage_m3_per_s_per_Pa
    volts = rig.sensor.gain_V_per_m
    pole, zero = 2 * pi * LAG.pole_Hz, 2 * pi * LAG.zero_Hz
    step = float(times[1])
    volts_at, hiss_at, newtons_at = command.tolist(), noise.tolist(), force.tolist()  # quicker to read than arrays

    def between(t: float, of: list[float]) -> float:
        k = min(int(t / step), len(of) - 2)
        return of[k] + (of[k + 1] - of[k]) * (t / step - k)

    def current(t: float, x: list[float]) -> tuple[float, float]:
        seen = x[10] if slow_s > 0 else x[0]
        error = between(t, volts_at) - volts * (seen + between(t, hiss_at))
        return LAG.gain_A_per_V * (x[9] + (error - x[9]) * pole / zero), error

    def rates(t: float, states: np.ndarray) -> list[float]:
        tip, tip_v, inner, inner_v, rod, rod_v, push, flow, flow_v, slow, seen = x = states.tolist()
        amps, error = current(t, x)
        apart, closing = rod - inner, rod_v - inner_v
        depth, side = abs(apart) - PLAY_M / 2, copysign(1.0, apart)
        pressed = (
            side * max(0.0, 1.2e8 * 1e-6 * (depth / 1e-6) ** 1.3 * (1 + 3.0 * side * closing)) if depth > 0 else 0.0
        )
        return [
            tip_v,
            (between(t, newtons_at) + push - k_m * tip - b_m * tip_v) / m_m,
            inner_v,
            (pressed - k_f * inner - b_f * inner_v) / m_f,
            rod_v,
            (-push - pressed) / ROD_kg,
            k_c * ((flow - leak * push / area) / area - tip_v + rod_v),
            flow_v,
            w_n**2 * (gain * amps - flow) - 2 * valve.damping_ratio * w_n * flow_v,
            pole * (error - slow),
            (tip - seen) / slow_s if slow_s > 0 else 0.0,
        ]

    found = odeint(rates, np.zeros(11), times, rtol=1e-6, atol=1e-12, hmax=2e-4, tfirst=True)
    amps = np.array([current(t, x)[0] for t, x in zip(times.tolist(), found.tolist(), strict=True)])
    return amps, found[:, 10 if slow_s > 0 else 0] + noise


@cache
def loose_set(slow_s: float = 0.0) -> Dataset:
    """Three records of 0.6 s."""
    times = np.arange(1200) * 5e-4
    rng = np.random.default_rng(5)
    records = []
    for name, volts, newtons in (("small", 0.03, 0.0), ("large", 0.3, 0.0), ("pushed", 0.0, 300.0)):
        lines = np.unique(np.round(np.geomspace(2, 200, 30)))
        wave = sum(
            np.sin(2 * pi * f * times + p) for f, p in zip(lines, rng.uniform(0, 2 * pi, len(lines)), strict=True)
        )
        wave = wave / np.std(wave) * np.clip(times / 0.1, 0, 1)
        noise = rng.normal(0, NOISE_M, len(times))
        amps, seen = _hand_written(volts * wave, newtons * wave, times, noise, slow_s)
        inputs = np.column_stack([newtons * wave, volts * wave])
        measured = {"current_A": amps + rng.normal(0, 1e-5, len(times)), "displacement_m": seen}
        records.append(TimeRecord(name, times, inputs, measured, 0.0, 0.0, LAG))
    return Dataset("loose", Path("loose"), believed(), tuple(records))


def before(data: Dataset) -> Search:
    evidence, placement = evidence_of(data), NOTHING.placement(data.prototype)
    null = fit(NOTHING, placement, evidence, np.zeros(len(placement.unknowns)), 4)
    return Search(null, (), sum(e.expected for e in evidence), conditions=tuple(e.condition for e in evidence))


RIVALS = ("sensor_lag", "valve_deadband", "seal_friction", "mount_compliance", "parameter:flow_gain")
"""What bends, slows or delays like a joint that is loose, and a wrong figure."""


@cache
def found_again() -> Search | None:
    """Among its rivals; what is in step for other causes of the library has its own tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(second_look, "singles", lambda prototype: (LOOSE, *map(together, RIVALS)))
        return backlash_impacts(loose_set(), before(loose_set()))


def test_play_is_found_where_the_motion_cannot_be_repeated():
    found = found_again()
    assert found is not None
    judged = judge(found)
    assert judged.cause("joint_backlash") > 0.7
    assert judged.unknown < 0.3
    loose = found.best_of(("joint_backlash",))
    assert loose.values["joint_backlash.play_m"] == pytest.approx(PLAY_M, rel=0.15)
    assert loose.values["joint_backlash.rod_mass_kg"] == pytest.approx(ROD_kg, rel=0.3)
    assert found.excess(loose) < 0.15


def test_what_a_linear_loop_says_of_a_joint_that_hammers_does_not_count(monkeypatch):
    """A gain at which it oscillates in its play, a tenth of what its linear loop bears, stands beside the records."""
    monkeypatch.setattr(second_look, "singles", lambda prototype: (LOOSE, Hypothesis(("parameter:flow_gain",))))
    rattles = MeasuredGain(LAG.but(gain_A_per_V=0.1 * LAG.gain_A_per_V), 0.0, 0.0, 0.05, 30.0)
    data = replace(loose_set(), gains=(rattles,))
    found = backlash_impacts(data, before(loose_set()))
    assert found is not None
    assert found.conditions == tuple(record.condition for record in data.records)
    best = judge(found).best
    assert best.hypothesis == LOOSE
    assert best.values["joint_backlash.play_m"] == pytest.approx(PLAY_M, rel=0.15)


def test_play_is_found_beside_another_effect(monkeypatch):
    """A slow sensor and play at once; either alone leaves three times the misfit of both."""
    few = (LOOSE, SLOWED, Hypothesis(("parameter:flow_gain",)))
    monkeypatch.setattr(second_look, "singles", lambda prototype: few)
    data = loose_set(1 / (2 * pi * SLOW_Hz))
    first = before(data)
    placement = SLOWED.placement(data.prototype)
    slowed = fit(SLOWED, placement, evidence_of(data), np.zeros(len(placement.unknowns)), 6)
    found = backlash_impacts(data, first, beside=slowed)
    assert found is not None
    best = judge(found).best
    assert best.hypothesis == LOOSE | SLOWED
    assert best.values["joint_backlash.play_m"] == pytest.approx(PLAY_M, rel=0.15)
    assert best.values["sensor_lag.break_Hz"] == pytest.approx(SLOW_Hz, rel=0.1)
    assert found.best_of(("joint_backlash",)).misfit > 3 * best.misfit
    assert found.best_of(("sensor_lag",)).misfit > 3 * best.misfit


def test_play_is_looked_for_beside_one_effect_and_beside_two(monkeypatch):
    """Beside those that explain most without play, in the order of how many they are, as long as one of them helps."""
    whole = before(loose_set())
    asked = []
    monkeypatch.setattr(second_look, "backlash_impacts", lambda data, search, progress, beside: asked.append(beside))

    def leaving(share: float, *names: str) -> Fit:
        c = whole.expected + share * (whole.null.misfit - whole.expected)
        return Fit(together(*names), cost=c, shares=(replace(whole.null.shares[0], c=c),))

    fits = (
        leaving(0.2, "joint_backlash", "sensor_lag"),
        leaving(0.3, "parameter:flow_gain"),
        pair := leaving(0.4, "sensor_lag", "transport_delay"),
        leaving(0.5, "sensor_lag", "second_beam_mode"),
        single := leaving(0.6, "second_beam_mode"),
    )
    second_look._backlash_impacts(loose_set(), replace(whole, fits=fits), silent)
    assert asked == [None, single, pair]
    asked.clear()
    second_look._backlash_impacts(loose_set(), replace(whole, fits=(leaving(0.95, "sensor_lag"), pair)), silent)
    assert asked == [None]


def test_play_of_a_nut_is_found_where_the_rig_is_the_truth_models(monkeypatch):
    """A screw with lost motion, by equations that share nothing with the library's; the nut's law has no mass."""
    with_screw = screw()
    rig = believed().but(actuator=with_screw.actuator, servovalve=None, controller=with_screw.controller)
    figure = rig_figures(rig.model_dump(exclude_none=True), {}, {}) | controller_figures(rig.controller.model_dump())
    rng, records = np.random.default_rng(7), []
    for name, volts, newtons in (("small", 0.05, 0.0), ("large", 0.4, 0.0), ("pushed", 0.0, 1500.0)):
        lines = np.unique(np.round(np.geomspace(2, 150, 25)))
        phases = rng.uniform(0, 2 * pi, len(lines))

        def wave(t, lines=lines, phases=phases):
            return np.sin(2 * pi * np.outer(t, lines) + phases).sum(axis=1) * np.clip(t / 0.1, 0, 1) / 3.5

        inputs = drive(0.8, lambda t, w=wave, n=newtons: n * w(t), lambda t, w=wave, v=volts: v * w(t))
        record, modes = assembled(figure | {"inner_end_mass": 2.0, "lost_motion": WORN_M})
        found = march(record, modes, inputs)
        stride = round((len(inputs) - 1) / (len(found.times) - 1))
        measured = {
            "current_A": found.current + rng.normal(0, 1e-4, len(found.times)),
            "displacement_m": found.displacement + rng.normal(0, NOISE_M, len(found.times)),
        }
        records.append(TimeRecord(name, found.times, inputs[::stride, :2], measured, 0.0, 2.0, rig.controller))
    data = Dataset("worn nut", Path("worn"), rig, tuple(records))
    few = (*(together(name) for name in ("joint_backlash", "seal_friction")), Hypothesis(("parameter:flow_gain",)))
    monkeypatch.setattr(second_look, "singles", lambda prototype: few)
    found = backlash_impacts(data, before(data))
    assert found is not None
    judged = judge(found)
    assert judged.cause("joint_backlash") > 0.7
    worn = found.best_of(("joint_backlash",))
    assert worn.hypothesis.effects == ("joint_backlash_nut",)
    assert worn.values["joint_backlash_nut.play_m"] == pytest.approx(WORN_M, rel=0.05)


def test_a_fit_without_a_record_stays_where_the_whole_one_was():
    found = found_again()
    assert found is not None
    loose = found.best_of(("joint_backlash",))
    data = loose_set()
    again = refit_backlash_impacts(replace(data, records=data.records[1:]), loose)
    assert len(again.shares) == 2
    assert again.values["joint_backlash.play_m"] == pytest.approx(PLAY_M, rel=0.2)


def test_a_lag_is_not_taken_for_play():
    rig = believed().but(effects={"sensor_lag": {"break_Hz": 150.0}})
    data = only(measured(rig, scenario(0.5)), ("command_small", "command_large", "disturbance_large"))
    assert backlash_impacts(data, before(data)) is None


def test_a_model_that_follows_itself_makes_the_motion_it_makes_alone():
    data = loose_set()
    placement = NOTHING.placement(data.prototype)
    z = np.zeros(len(placement.unknowns))
    piece = record_evidence(data)[1]
    alone = piece.predicted(placement, z)
    own = replace(data.records[1], measured={"current_A": alone[:, 0], "displacement_m": alone[:, 1]})
    made = with_output_injection(record_evidence(replace(data, records=(own,)))[0]).predicted(placement, z)
    assert made is not None
    assert np.abs(made - alone).max(axis=0) == pytest.approx(0, abs=2e-3 * np.abs(alone).max())
    error = np.sqrt(np.mean((made - alone) ** 2, axis=0)) / np.std(alone, axis=0)
    assert np.all(error < 2e-3)  # of interpolation between samples


def test_only_play_makes_a_record_unpredictable():
    piece = with_output_injection(record_evidence(loose_set())[0])
    size = np.abs(piece.taken.weight.lines(piece.taken.measured)) ** 2
    shares = []
    for hypothesis, given in ((NOTHING, {}), (LOOSE, {"play_m": PLAY_M, "rod_mass_kg": ROD_kg, "counted_share": 1.0})):
        placement = hypothesis.placement(believed())
        values = {f"joint_backlash.{name}": value for name, value in given.items()}
        z = np.array([u.z(values[u.name]) if u.name in values else 0.0 for u in placement.unknowns])
        power = spread(piece, placement, z)
        assert power is not None
        shares.append(float(power[:, 1].sum() / size[:, 1].sum()))
    assert shares[1] > 10 * shares[0]


def test_what_cannot_be_predicted_counts_as_noise():
    record = loose_set().records[0]
    plain = weighting(record, ("current_A", "displacement_m"))
    signal = np.column_stack([np.zeros(len(record.times)), np.random.default_rng(1).normal(0, 1e-4, len(record.times))])
    power = np.tile([0.0, 1e-8 * np.sum(plain.fade**2)], (len(plain.frequencies_Hz), 1))
    blind = blurred(plain, power)
    # All of the displacement being noise, it leaves what `INDEPENDENT` unpredictable units leave.
    assert float(np.sum(blind(signal) ** 2)) == pytest.approx(INDEPENDENT, rel=0.1)
    assert float(np.sum(plain(signal) ** 2)) > 10 * INDEPENDENT
    assert blurred(plain, 0 * power).expected == pytest.approx(plain.expected)
