"""Critical gains and frequency responses as evidence: against exact loops, closed forms and made-up rigs."""

import re
from collections.abc import Sequence
from dataclasses import replace
from math import log, pi, tau
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from gap_sets import TOLERANCE, measured, scenario
from honest_certificates import screw
from lowest_edge import limit_cycles

from beamdesign import InputError, Prototype, critical_gain, diagnose, read_dataset, write_prototype
from beamdesign.controllers import Controller, Lag, Proportional, Structured
from beamdesign.controllers.cascade import Section
from beamdesign.diagnosis import diagnose as diagnosing
from beamdesign.diagnosis import gain_diagnosis
from beamdesign.diagnosis.data.dataset import Dataset, FrequencyResponse, MeasuredGain, TimeRecord
from beamdesign.diagnosis.diagnosis import Diagnosis
from beamdesign.diagnosis.fitting import replay, search
from beamdesign.diagnosis.fitting.evidence import evidence_of, figures_of, record_evidence
from beamdesign.diagnosis.fitting.fit import fit
from beamdesign.diagnosis.fitting.gain_evidence import FREQUENCY_STD, GainEvidence, phase_crossings
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, Hypothesis, Placement, together
from beamdesign.diagnosis.fitting.linear_evidence import ResponseEvidence, scatter
from beamdesign.diagnosis.fitting.replay import DISPLACEMENT, SweptSine
from beamdesign.diagnosis.fitting.starts import starts
from beamdesign.diagnosis.fitting.weighting import SHARE
from beamdesign.diagnosis.gain_diagnosis import explain_gains
from beamdesign.diagnosis.gain_findings import another_size, common_factor, experiments, gain_shares, separations
from beamdesign.diagnosis.judgement import Judgement
from beamdesign.diagnosis.judgement import evidence as marginal_likelihood
from beamdesign.loop import loop
from beamdesign.plant.actuators.servo_cylinder import ServoCylinder
from beamdesign.plant.harmonic_balance import forced_motion
from beamdesign.prototype import Beam, Payload, Servovalve

pytestmark = pytest.mark.long

PROPORTIONAL = Proportional(gain_A_per_V=0.01)
LAG = Lag(gain_A_per_V=0.1, pole_Hz=1.75, zero_Hz=26.0)
SETTINGS: tuple[tuple[Controller, float, float], ...] = (
    (PROPORTIONAL, 0.0, 0.0),
    (LAG, 0.0, 0.0),
    (LAG, 6.8, 0.0),
    (LAG, 6.8, 4.4),
)
LINES = np.geomspace(1.0, 300.0, 40)
SHARED = Path(__file__).parents[2] / "shared" / "rig" / "open-2-sensor-lag"


@pytest.fixture
def believed(paper: Prototype) -> Prototype:
    return paper.but(tolerance=TOLERANCE)


def exact(prototype: Prototype, setting: tuple[Controller, float, float]) -> tuple[float, float]:
    """Critical gain (A/V) and frequency (Hz) by the exact polynomials of `beamdesign.loop`."""
    law, outer, inner = setting
    found = critical_gain(prototype.but(controller=law, payload=Payload(inner_end_mass_kg=inner)), outer)
    return found.gain_A_per_V, found.frequency_Hz


def taken(prototype: Prototype, setting: tuple[Controller, float, float], **more: float) -> GainEvidence:
    law, outer, inner = setting
    return GainEvidence(MeasuredGain(law, outer, inner, 0.02, **more), prototype)


def filtered(prototype: Prototype, frequency_Hz: float) -> Prototype:
    return prototype.but(sensor=prototype.sensor.but(filter_Hz=frequency_Hz))


def test_crossings_of_a_third_order_lag_and_of_a_conditionally_stable_loop():
    """s^3 + 2 xi s^2 + s + K by Routh: K = 2 xi at w = 1; s^3 + K (s + 1)^2: K = 1/2 at w = 1."""
    xi = 0.3
    valve = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, -2 * xi]])
    unit = np.array([0.0, 0.0, 1.0])
    (found,) = phase_crossings(valve, unit, np.array([-1.0, 0.0, 0.0]))
    assert found == pytest.approx((2 * xi, 1.0), rel=1e-12)
    triple = np.diag([1.0, 1.0], 1)
    (found,) = phase_crossings(triple, unit, np.array([-1.0, -2.0, -1.0]))
    assert found == pytest.approx((0.5, 1.0), rel=1e-12)


@pytest.mark.parametrize("setting", SETTINGS)
@pytest.mark.parametrize("filter_Hz", [None, 400.0])
def test_without_effects_the_gain_is_that_of_the_exact_loop(believed: Prototype, setting, filter_Hz: float | None):
    rig = believed.but(sensor=believed.sensor.but(filter_Hz=filter_Hz))
    placement = NOTHING.placement(rig)
    found = taken(rig, setting).predicted(placement, np.zeros(len(placement.unknowns)))
    assert (found.gain, found.frequency / tau) == pytest.approx(exact(rig, setting), rel=1e-9)


def test_a_valve_that_drives_a_free_tip_has_the_closed_form(believed: Prototype):
    """Stiff oil, a beam that holds the rod and one that holds nothing: K = 2 xi omega_n A / (K_q F) by Routh."""
    rig = believed.but(
        outer_beam=Beam(stiffness_N_per_m=1.0, effective_mass_kg=1e-6, damping_ratio=0.05),
        inner_beam=Beam(stiffness_N_per_m=1e10, effective_mass_kg=1.0, damping_ratio=0.05),
        actuator=ServoCylinder(piston_area_m2=1.13e-4, oil_stiffness_N_per_m=1e10),
        servovalve=Servovalve(
            flow_gain_m3_per_s_per_A=1.13e-2, leakage_m3_per_s_per_Pa=0.0, natural_frequency_Hz=150.0, damping_ratio=0.4
        ),
    )
    placement = NOTHING.placement(rig)
    found = taken(rig, SETTINGS[0]).predicted(placement, np.zeros(len(placement.unknowns)))
    assert found.gain == pytest.approx(2 * 0.4 * tau * 150 * 1.13e-4 / (1.13e-2 * 1180), rel=1e-6)
    assert found.frequency == pytest.approx(tau * 150, rel=1e-6)


@pytest.mark.parametrize("setting", SETTINGS)
def test_the_lag_of_the_sensor_is_the_filter_of_the_exact_loop(believed: Prototype, setting):
    placement = together("sensor_lag").placement(believed)
    found = taken(believed, setting).predicted(placement, np.zeros(len(placement.unknowns)))
    assert (found.gain, found.frequency / tau) == pytest.approx(exact(filtered(believed, 400.0), setting), rel=1e-9)


@pytest.mark.parametrize("asymmetry", [0.121, -0.121])
def test_of_unequal_sides_the_smaller_one_governs(believed: Prototype, asymmetry: float):
    """The speed per flow is that of the smaller side at worst, as if the flow gain were so much higher."""
    placement = together("unequal_piston_areas").placement(believed)
    z = np.array([u.z(asymmetry) if u.name.startswith("unequal") else 0.0 for u in placement.unknowns])
    valve = believed.servovalve
    faster = believed.but(servovalve=valve.but(flow_gain_m3_per_s_per_A=valve.flow_gain_m3_per_s_per_A / 0.879))
    for setting in SETTINGS:
        found = taken(believed, setting).predicted(placement, z)
        assert found.gain == pytest.approx(exact(faster, setting)[0], rel=2e-3)  # sides are unequal in the oil, too


@pytest.mark.parametrize(
    ("effect", "amplitude_m"), [("valve_deadband", 2e-3), ("seal_friction", 5e-3), ("joint_backlash", 5e-3)]
)
def test_large_oscillations_leave_deadband_friction_and_play_behind(
    believed: Prototype, effect: str, amplitude_m: float
):
    """The gain at which the nonlinear loop oscillates that far, by harmonic balance, is the one taken for the onset."""
    law = PROPORTIONAL
    sizes = {"joint_backlash": {"play_m": 5e-6}, "seal_friction": {"coulomb_N": 20.0}}.get(effect, {})
    placement = together(effect).placement(believed)
    z = np.array([u.z(sizes[key]) if (key := u.name.split(".")[-1]) in sizes else 0.0 for u in placement.unknowns])
    onset = taken(believed, (law, 0.0, 0.0)).predicted(placement, z)
    rig = believed.but(controller=law, effects={effect: sizes})
    (cycle,) = limit_cycles(rig, [amplitude_m], harmonics=3)
    assert cycle.gain_A_per_V == pytest.approx(onset.gain, rel=0.02)


@pytest.mark.parametrize(
    "names",
    [
        (),
        ("sensor_lag", "unequal_piston_areas"),
        ("second_beam_mode", "uneven_leakage"),
        ("mount_compliance", "joint_backlash"),
        ("entrained_air", "transport_delay"),
        ("seal_friction", "parameter:flow_gain"),
    ],
)
def test_derivatives_are_those_of_the_prediction(believed: Prototype, names: tuple[str, ...]):
    placement = together(*names).placement(believed)
    z = 0.1 * np.cos(np.arange(len(placement.unknowns)))
    quiet = PROPORTIONAL.but(gain_A_per_V=0.005)
    flat = FrequencyResponse("flat", LINES, np.full(40, 1e-6 + 0j), True, 1.0, 0.0, 0.0, quiet)
    made = (lambda: taken(believed, SETTINGS[3], frequency_Hz=100.0), lambda: ResponseEvidence(flat, believed))
    for make in made:
        piece = make()
        residual, slopes = piece.linearised(placement, z)
        assert residual == pytest.approx(piece.residual(placement, z), abs=1e-12)
        for k in range(len(z)):
            step = 2e-4 * np.eye(len(z))[k]
            ends = [piece.residual(placement, z + side * step) for side in (1, -1, 2, -2)]
            slope = (8 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / (12 * 2e-4)
            assert slopes[:, k] == pytest.approx(slope, rel=1e-5, abs=1e-5 * np.abs(slopes).max())
        elsewhere = piece.residual(placement, z + 0.5)  # whatever it was asked before
        assert make().residual(placement, z + 0.5) == pytest.approx(elsewhere, rel=1e-9)


def test_a_factor_on_the_loop_gain_is_worth_its_own_size(believed: Prototype):
    """K goes with 1/F: the residual, in units of 2 %, moves by the tolerance over 2 % per standard deviation."""
    placement = NOTHING.placement(believed)
    _, slopes = taken(believed, SETTINGS[1]).linearised(placement, np.zeros(len(placement.unknowns)))
    names = [u.name for u in placement.unknowns]
    assert slopes[0, names.index("sensor_gain")] == pytest.approx(0.005 / 0.02, rel=1e-6)
    assert slopes[0, names.index("flow_gain")] == pytest.approx(0.05 / 0.02, rel=1e-6)


def test_units_of_a_gain_and_of_its_frequency(believed: Prototype):
    gain, frequency = exact(believed, SETTINGS[0])
    placement = NOTHING.placement(believed)
    nominal = np.zeros(len(placement.unknowns))
    law = PROPORTIONAL.but(gain_A_per_V=1.04 * gain)
    piece = taken(believed, (law, 0.0, 0.0), frequency_Hz=0.97 * frequency)
    assert piece.residual(placement, nominal) == pytest.approx([log(1.04) / 0.02, log(0.97) / FREQUENCY_STD], rel=1e-6)
    assert piece.expected == 2
    assert taken(believed, (law, 0.0, 0.0)).residual(placement, nominal) == pytest.approx([log(1.04) / 0.02], rel=1e-6)


def test_a_gain_below_that_of_a_rig_that_a_push_makes_oscillate_says_little():
    """A motor at its limit has lost its drive's damping too: a twelfth of the linear loop's gain made a set unknown.

    Above the gain of the linear loop, without the limit, and where nothing but such gains is known, it says all it did.
    """
    rig = screw()
    many = rig.sensor.but(gain_V_per_m=50 * rig.sensor.gain_V_per_m)  # else no such gain is plausible
    rig = rig.but(sensor=many, tolerance=TOLERANCE)
    limited, free = together("motor_current_limit").placement(rig), NOTHING.placement(rig)
    law = Lag(gain_A_per_V=1.0, pole_Hz=1.2, zero_Hz=18.0)
    at = taken(rig, (law, 0.0, 0.0)).nominal()

    def left(share: float, placement: Placement, rough: float) -> list[float]:
        given = MeasuredGain(law.but(gain_A_per_V=share * at.gain), 0.0, 0.0, 0.02, frequency_Hz=at.frequency / tau)
        piece, z = GainEvidence(given, rig, rough=rough), np.zeros(len(placement.unknowns))
        found = piece.residual(placement, z)
        assert found is not None
        linear = piece.linearised(placement, z)
        assert linear is not None
        assert linear[0] == pytest.approx(found)
        return list(found)

    usual = np.hypot(0.02, 0.1)
    assert left(1 / 12, limited, 0.1) == pytest.approx([log(1 / 12), 0.0], abs=1e-6)
    assert left(12.0, limited, 0.1) == pytest.approx([log(12) / usual, 0.0], abs=1e-6)
    assert left(1 / 12, free, 0.1) == pytest.approx([log(1 / 12) / usual, 0.0], abs=1e-6)
    assert left(1 / 12, limited, 0.0) == pytest.approx([log(1 / 12) / 0.02, 0.0], abs=1e-6)


def test_a_loop_without_gain_makes_no_prediction(believed: Prototype):
    """A valve that passes nothing closes no loop."""
    placement = NOTHING.placement(believed)
    z = np.zeros(len(placement.unknowns))
    z[[u.name for u in placement.unknowns].index("flow_gain")] = -1e5
    piece = taken(believed, SETTINGS[0])
    assert piece.predicted(placement, z) is None
    assert piece.residual(placement, z) is None
    assert piece.linearised(placement, z) is None


def response(
    prototype: Prototype, break_Hz: float, setting: tuple[Controller, float, float], noise: float = 0.0, seed: int = 0
) -> FrequencyResponse:
    """What a sensor with a filter shows of the exact loop's compliance."""
    law, outer, inner = setting
    rig = filtered(prototype, break_Hz).but(controller=law, payload=Payload(inner_end_mass_kg=inner))
    seen = loop(rig).at(outer).compliance_response(LINES) / (1 + 1j * LINES / break_Hz)
    rng = np.random.default_rng(seed)
    spread = np.exp(noise * (rng.normal(size=len(LINES)) + 1j * rng.normal(size=len(LINES))))
    return FrequencyResponse(f"response-{seed}", LINES, seen * spread, True, None, outer, inner, law)


@pytest.mark.parametrize("setting", [SETTINGS[0], (LAG, 6.8, 4.4)])
def test_responses_are_those_of_the_exact_loop(believed: Prototype, setting):
    exactly = response(believed, 400.0, setting)
    piece = ResponseEvidence(exactly, believed)
    placement = together("sensor_lag").placement(believed)
    nominal = np.zeros(len(placement.unknowns))
    assert np.abs(piece.predicted(placement, nominal) / exactly.response - 1).max() < 1e-9
    assert np.abs(piece.residual(placement, nominal)).max() < 1e-6
    amount = ResponseEvidence(replace(exactly, response=np.abs(exactly.response), has_phase=False), believed)
    assert np.abs(amount.residual(placement, nominal)).max() < 1e-6
    assert len(amount.residual(placement, nominal)) == len(LINES)


def under_command(prototype: Prototype, break_Hz: float, setting: tuple[Controller, float, float]) -> FrequencyResponse:
    """What the sensor shows of a command: L / (1 + L) over its gain, L with the filter in it."""
    law, outer, inner = setting
    rig = filtered(prototype, break_Hz).but(controller=law, payload=Payload(inner_end_mass_kg=inner))
    found = loop(rig).at(outer).loop_response(LINES)
    seen = found / (1 + found) / prototype.sensor.gain_V_per_m
    return FrequencyResponse("command", LINES, seen, True, None, outer, inner, law, driven_by=1)


@pytest.mark.parametrize("setting", [SETTINGS[0], (LAG, 6.8, 4.4)])
def test_responses_to_a_command_are_those_of_the_exact_loop(believed: Prototype, setting):
    piece = ResponseEvidence(under_command(believed, 400.0, setting), believed)
    placement = together("sensor_lag").placement(believed)
    assert np.abs(piece.residual(placement, np.zeros(len(placement.unknowns)))).max() < 1e-6


def test_a_slow_sensor_is_found_in_responses_to_a_command(believed: Prototype, monkeypatch: pytest.MonkeyPatch):
    few = tuple(Hypothesis((name,)) for name in ("sensor_lag", "transport_delay", "parameter:flow_gain"))
    monkeypatch.setattr(search, "singles", lambda prototype: few)
    data = Dataset(
        "commanded", Path(), believed, (), tuple(under_command(believed, 150.0, each) for each in SETTINGS[:2]), ()
    )
    found = diagnose(data, 1)
    assert (found.verdict, found.chosen) == ("effect", ("sensor_lag",))


HALF_A, FORCE_N = 5e-5, 100.0
SINES = np.geomspace(3.0, 40.0, 8)  # slower ones depend on where in the band they began


def balanced(paper: Prototype, force: float) -> FrequencyResponse:
    """Sines of a rig with a deadband, by harmonic balance: nothing is simulated in it."""
    law = LAG.but(gain_A_per_V=0.05)
    rig = paper.but(controller=law, effects={"valve_deadband": {"half_width_A": HALF_A}})
    seen = np.array([forced_motion(rig, force, float(hertz)).phasor_m / force for hertz in SINES])
    return FrequencyResponse(f"{force:g} N", SINES, seen, True, force, 0.0, 0.0, law)


@pytest.fixture
def swept(paper: Prototype) -> ResponseEvidence:
    return ResponseEvidence(balanced(paper, FORCE_N), paper.but(tolerance=TOLERANCE), swept=40)


def with_deadband(piece: ResponseEvidence, half_A: float) -> tuple[Placement, np.ndarray]:
    placement = together("valve_deadband").placement(piece.prototype)
    z = np.zeros(len(placement.unknowns))
    z[-1] = placement.unknowns[-1].z(half_A)
    return placement, z


def test_sines_that_meet_a_deadband_are_those_of_harmonic_balance(swept: ResponseEvidence):
    placement, z = with_deadband(swept, HALF_A)
    assert np.abs(swept.predicted(placement, z) / swept.measured.response - 1).max() < 0.005
    linear = replace(swept, swept=0).predicted(placement, z)
    assert np.abs(np.log(np.abs(linear / swept.measured.response))).max() > 0.3  # by the loop with the valve open


@pytest.mark.parametrize(("driven_by", "amplitude"), [(0, FORCE_N), (1, 0.3)])
def test_sines_far_beyond_a_deadband_are_those_of_the_linear_loop(swept: ResponseEvidence, driven_by, amplitude):
    piece = replace(swept, measured=replace(swept.measured, driven_by=driven_by, amplitude=amplitude))
    placement, z = with_deadband(piece, HALF_A / 1000)
    linear = replace(piece, swept=0).predicted(placement, z)
    assert np.abs(piece.predicted(placement, z) / linear - 1).max() < 0.005


@pytest.mark.parametrize(("amplitude", "most_off"), [(1.0, 2e-3), (FORCE_N, 0.05)])
def test_sines_beside_a_resonance_of_little_damping_have_settled(
    paper: Prototype, monkeypatch: pytest.MonkeyPatch, amplitude: float, most_off: float
):
    """Of little amplitude they are those of the linear loop; of more, those that twelve times as long settle.

    Half a per cent below its critical gain a loop rings for seconds: from rest they would be off by three quarters.
    """
    rig, oscillating = paper.but(tolerance=TOLERANCE), critical_gain(paper.but(controller=LAG), 6.8)
    law = LAG.but(gain_A_per_V=0.995 * oscillating.gain_A_per_V)
    hertz = oscillating.frequency_Hz * np.array([0.9, 0.97, 1.1])
    taken = FrequencyResponse("ringing", hertz, np.ones(3, complex), True, amplitude, 6.8, 0.0, law)
    name, given = ("entrained_air", 0.1) if amplitude == 1.0 else ("valve_hysteresis", 0.0)
    placement = together(name).placement(rig)
    z = np.full(len(placement.unknowns), given) * [u.kind == "effect" for u in placement.unknowns]
    found = ResponseEvidence(taken, rig, swept=40).predicted(placement, z)
    if amplitude > 1.0:
        monkeypatch.setattr(replay, "_SETTLES_S", 6.0)
    settled = ResponseEvidence(taken, rig, swept=0 if amplitude == 1.0 else 40).predicted(placement, z)
    assert np.abs(found / settled - 1).max() < most_off


def test_many_lines_and_lines_out_of_reach_take_no_more_sines(swept: ResponseEvidence):
    placement, z = with_deadband(swept, HALF_A)
    more = np.unique([1e-3, *SINES, *np.geomspace(3.0, 40.0, 300), 1e6])
    dense = replace(swept.measured, frequencies_Hz=more, response=np.ones(len(more), complex))
    found = replace(swept, measured=dense).predicted(placement, z)
    assert len(SweptSine(dense, swept.prototype, 40).lines) <= 40
    at = np.searchsorted(more, SINES)
    assert np.abs(found[at] / swept.measured.response - 1).max() < 0.01
    assert np.all(np.isfinite(found))


@pytest.mark.parametrize("beside", [False, True])
def test_a_response_whose_force_is_not_stated_is_one_of_small_motion(swept: ResponseEvidence, beside: bool):
    """Alone and beside a record, the latter at fewer lines, which these few sines are."""
    times = np.arange(100) / 1000
    still = TimeRecord("still", times, np.zeros((100, 2)), {DISPLACEMENT: np.zeros(100)}, 0.0, 0.0, LAG)
    for force, simulated in ((FORCE_N, True), (None, False)):
        taken = replace(swept.measured, amplitude=force)
        (piece,) = figures_of(Dataset("sines", Path(), swept.prototype, (still,) * beside, (taken,), ()))
        assert isinstance(piece, ResponseEvidence)
        assert piece.swept == (0 if force is None else 12 if beside else 40)
        placement, z = with_deadband(swept, HALF_A)
        off = piece.predicted(placement, z) / replace(swept, swept=0).predicted(placement, z)
        assert (np.abs(np.log(np.abs(off))).max() > 0.3) == simulated


def test_slopes_of_simulated_sines_are_those_of_differences(swept: ResponseEvidence):
    placement, z = with_deadband(swept, 0.8 * HALF_A)
    _, slopes = swept.linearised(placement, z)
    for k, step in ((0, 1e-3), (len(z) - 1, 1e-3)):
        ends = [swept.residual(placement, z + side * step * np.eye(len(z))[k]) for side in (1, -1)]
        assert slopes[:, k] == pytest.approx(
            (ends[0] - ends[1]) / (2 * step), rel=0.05, abs=0.01 * np.ptp(slopes[:, k])
        )


def test_a_deadband_is_found_in_sines(swept: ResponseEvidence):
    rig, found = swept.prototype, {}
    for cause in (NOTHING, together("valve_deadband")):
        placement = cause.placement(rig)
        found[cause.names] = fit(cause, placement, [swept], np.zeros(len(placement.unknowns)))
    alone, some = found.values()
    assert some.cost < 0.05 * alone.cost
    assert some.values["valve_deadband.half_width_A"] == pytest.approx(HALF_A, rel=0.1)


def test_an_unstable_loop_has_no_response(believed: Prototype):
    piece = ResponseEvidence(response(believed, 400.0, SETTINGS[0]), believed)
    placement = NOTHING.placement(believed)
    loud = replace(piece, measured=replace(piece.measured, controller=PROPORTIONAL.but(gain_A_per_V=0.03)))
    assert loud.residual(placement, np.zeros(len(placement.unknowns))) is None


def test_noise_of_a_response_is_read_off_its_lines_and_leaves_the_misfit_that_is_expected(believed: Prototype):
    placement = together("sensor_lag").placement(believed)
    nominal = np.zeros(len(placement.unknowns))
    found, misfits = [], []
    for seed in range(12):
        noisy = response(believed, 400.0, SETTINGS[1], 0.03, seed)
        found.append(float(np.median(scatter(noisy))))
        piece = ResponseEvidence(noisy, believed)
        misfits.append(float(np.sum(piece.residual(placement, nominal) ** 2)) / piece.expected)
    assert np.mean(found) == pytest.approx(0.03, rel=0.3)
    assert np.mean(misfits) == pytest.approx(1.0, abs=0.35)
    few = scatter(replace(noisy, frequencies_Hz=LINES[:4], response=noisy.response[:4]))
    assert np.all(few == SHARE)  # which do not tell


def rig_with_lag(believed: Prototype, break_Hz: float, seed: int, responses: Sequence[float] = ()) -> Dataset:
    """Four gains, 2 % noise, and responses with 1 % noise at shares of the critical gains, of a rig with a filter."""
    rng, true = np.random.default_rng(seed), filtered(believed, break_Hz)
    gains, curves = [], []
    for law, outer, inner in SETTINGS:
        gain = exact(true, (law, outer, inner))[0] * np.exp(0.02 * rng.normal())
        gains.append(MeasuredGain(law.but(gain_A_per_V=gain), outer, inner, 0.02))
    for k, share in enumerate(responses):
        law, outer, inner = SETTINGS[(0, 1, 3)[k % 3]]
        quiet = law.but(gain_A_per_V=share * gains[(0, 1, 3)[k % 3]].gain)
        curves.append(response(believed, break_Hz, (quiet, outer, inner), 0.01, seed + k))
    return Dataset("made up", Path(), believed, (), tuple(curves), tuple(gains))


GAIN = "parameter:flow_gain"
SUSPECTS = ("sensor_lag", "transport_delay", "unequal_piston_areas", GAIN)
"""What shows in small motion."""


def explained(data: Dataset, among: tuple[str, ...] = SUSPECTS) -> Diagnosis[Prototype]:
    """By these causes alone, which is quick."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search, "singles", lambda prototype: tuple(Hypothesis((name,)) for name in among))
        return explain_gains(data)


def test_a_deadband_is_diagnosed_from_sines_alone(believed: Prototype):
    """Figures say where it sits, but not of what kind its law is."""
    taken = tuple(balanced(believed, share * FORCE_N) for share in (1.0, 2.0))
    found = explained(Dataset("sines", Path(), believed, (), taken, ()), ("sensor_lag", "valve_deadband", GAIN))
    assert (found.verdict, found.chosen) == ("effect", ("valve_deadband",))
    assert (found.where.subsystem, found.where.kind) == ("servovalve", "")
    assert "valve_deadband" not in found.findings["silent"]
    assert found.gap.after < 0.2 * found.gap.before


@pytest.fixture(scope="module")
def found_lag() -> Diagnosis[Prototype]:
    from beamdesign.validation.paper_rig import paper_prototype

    believed = paper_prototype().but(tolerance=TOLERANCE)
    among = ("sensor_lag", "transport_delay", "valve_deadband", GAIN)
    return explained(rig_with_lag(believed, 400.0, 1, (0.4, 0.4, 0.4, 0.7, 0.2)), among)


def test_a_lag_is_found_from_gains_and_responses(found_lag: Diagnosis[Prototype]):
    assert found_lag.verdict == "effect"
    assert found_lag.chosen == ("sensor_lag",)
    assert (found_lag.where.subsystem, found_lag.where.kind) == ("sensor", "linear")
    assert found_lag.causes[0].name == "sensor_lag"
    assert found_lag.causes[0].probability > 0.95
    estimate = found_lag.causes[0].parameters["break_Hz"]
    assert abs(estimate.value - 400.0) < 3 * estimate.std < 60.0
    assert found_lag.gap.after < 0.04 < 0.1 < found_lag.gap.before
    assert found_lag.gap.closed > 0.9
    assert found_lag.prototype.effects["sensor_lag"]["break_Hz"] == pytest.approx(estimate.value)
    assert "valve_deadband" in found_lag.findings["silent"]  # the force of the responses is not stated
    assert found_lag.next_experiment is None


def test_a_sensor_that_lags_by_a_law_of_second_order_has_no_delay_beside_it(believed: Prototype):
    """The loop is closed by hand through 1 / (1 + T s + (T s / 2 zeta)^2), a Butterworth filter."""
    rng, taken = np.random.default_rng(0), []
    s = 2j * pi * LINES
    for law, outer, inner in (SETTINGS[1], SETTINGS[3]):
        at = loop(believed.but(controller=law, payload=Payload(inner_end_mass_kg=inner))).at(outer)
        late = 1 / (2 * pi * 150.0)
        sensor = 1 / (1 + late * s + (late * s) ** 2 / 2)
        open_loop = at.loop_response(LINES)
        seen = at.compliance_response(LINES) * (1 + open_loop) / (1 + open_loop * sensor) * sensor
        seen *= np.exp(0.01 * (rng.normal(size=len(LINES)) + 1j * rng.normal(size=len(LINES))))
        taken.append(FrequencyResponse(f"response-{inner}", LINES, seen, True, None, outer, inner, law))
    found = explained(Dataset("second order", Path(), believed, (), tuple(taken), ()))
    assert (found.verdict, found.chosen) == ("effect", ("sensor_lag",))
    assert found.prototype.effects["sensor_lag_second_order"]["break_Hz"] == pytest.approx(150.0, rel=0.03)


@pytest.mark.parametrize(("alone", "verdict"), [(0.06, "ambiguous"), (0.01, "effect")])
def test_a_cause_beside_another_is_not_sure_where_that_alone_is_not_told_apart(
    believed: Prototype, monkeypatch: pytest.MonkeyPatch, alone: float, verdict: str
):
    both, lag = together("sensor_lag", "parameter:flow_gain"), together("sensor_lag")
    data = rig_with_lag(believed.but(servovalve=believed.servovalve.but(flow_gain_m3_per_s_per_A=0.014)), 400.0, 1)
    monkeypatch.setattr(search, "singles", lambda prototype: (lag, together("parameter:flow_gain"), both))

    def judged(found: search.Search, few: bool) -> Judgement:
        best = next(f for f in found.fits if f.hypothesis == both)
        return Judgement({both: 0.98 - alone, lag: alone, NOTHING: 0.02}, 0.0, best)

    monkeypatch.setattr(gain_diagnosis, "judge", judged)
    monkeypatch.setattr(gain_diagnosis, "with_outside", lambda judged, evidence, found: judged)
    found = explain_gains(data)
    assert found.verdict == verdict
    assert set(found.chosen) == ({"sensor_lag"} if verdict == "ambiguous" else set(both.names))
    # What all rivals hold has a place, whatever lies beside it in some of them.
    assert found.where.subsystem == ("sensor" if verdict == "ambiguous" else "")


@pytest.mark.parametrize(("records", "verdict"), [(0, "effect"), (2, "ambiguous")])
def test_figures_beside_records_that_are_no_good_bear_no_sure_answer(
    records: int, verdict: str, believed: Prototype, monkeypatch: pytest.MonkeyPatch
):
    """All records are too short to be used: so the warnings say, and what is left is told with as much doubt."""
    monkeypatch.setattr(search, "singles", lambda rig: (together("sensor_lag"), together(GAIN)))
    monkeypatch.setattr(gain_diagnosis.gain_findings, "next_experiment", lambda *given: None)
    data = rig_with_lag(believed, 400.0, 1, (0.4,))
    short = np.zeros((20, 2)), {"displacement_m": np.arange(20.0), "current_A": np.arange(20.0)}
    taken = tuple(TimeRecord(f"r{k}", 1e-3 * np.arange(20), *short, 0.0, 0.0, LAG) for k in range(records))
    found = diagnose(replace(data, records=taken), 1)
    assert (found.verdict, found.chosen) == (verdict, ("sensor_lag",))
    assert any("what remains cannot bear a confident answer" in words for words in found.warnings) is bool(records)
    by = "The gap is most probably caused by" if records else "The gap is caused by"
    assert found.sentences.startswith(f"{by} sensor_lag (")
    assert "cannot tell apart" not in found.sentences


SECTION = Section(zero_Hz=30.0, zero_damping_ratio=0.5, pole_Hz=30.0, pole_damping_ratio=0.6)
WITH_SECTION = Structured(gain_A_per_V=0.05, pole_Hz=1.7, zero_Hz=20.0, section=(SECTION,))


SIDES = re.compile("piston|unequal|[Ff]low gain")


@pytest.mark.parametrize("driven", ["by a valve with sections in its law", "by a motor and a screw"])
def test_figures_of_any_rig_and_law_are_explained(paper: Prototype, driven: str):
    """Gains 0.3 times those of the model, and a second payload, so that conditions are compared."""
    rig = paper.but(controller=WITH_SECTION) if "valve" in driven else screw()
    law, true = rig.own_controller, rig.but(tolerance=TOLERANCE)
    settings = [(law, outer, rig.payload.inner_end_mass_kg) for outer in (0.0, 3.0)]
    gains = [MeasuredGain(law.but(gain_A_per_V=0.3 * exact(true, s)[0]), *s[1:], 0.02) for s in settings]
    found = explained(Dataset("any", Path(), true, gains=tuple(gains)), ("sensor_lag", "parameter:sensor_gain"))
    assert found.verdict in ("effect", "ambiguous")
    assert "parameter:sensor_gain" in {cause.name for cause in found.causes}
    assert found.findings["factor"].factor == pytest.approx(0.3, rel=0.03)
    assert (found.findings["shares"] is None) == ("screw" in driven)
    assert found.search is not None
    menu = experiments(Dataset("any", Path(), true, gains=tuple(gains)), found.search.null)
    of_a_cylinder = [text for text in (*found.notes, *(asked.text for asked, _, _ in menu)) if SIDES.search(text)]
    assert bool(of_a_cylinder) == ("valve" in driven)


def test_gains_under_a_load_are_read_as_they_are_proposed(believed: Prototype, tmp_path: Path):
    """Pushed and pulled alike but for unequal sides; what has been measured is proposed no more."""
    law, bare = {"kind": "lag", "pole_Hz": 1.75, "zero_Hz": 26.0}, Dataset("bare", Path(), believed)
    one = MeasuredGain(LAG.but(gain_A_per_V=0.2), 0.0, 0.0, 0.03)
    null = fit(NOTHING, NOTHING.placement(believed), [], np.zeros(len(NOTHING.placement(believed).unknowns)))

    def proposed(data: Dataset) -> list[dict[str, object]]:
        return [asked.settings for asked, _, _ in experiments(data, null) if "load_N" in asked.settings]

    (settings,) = proposed(replace(bare, gains=(one,)))
    rows = [{"controller": settings["controller"], "gain_A_per_V": 0.2, "load_N": load} for load in settings["load_N"]]
    (tmp_path / "dataset.toml").write_text(tomli_w.dumps({"critical_gain": rows}))
    write_prototype(believed, tmp_path / "prototype.toml")
    data = read_dataset(tmp_path)
    assert not data.warnings
    assert not proposed(data)
    pieces = [piece for piece in figures_of(data) if isinstance(piece, GainEvidence)]
    assert [piece.measured.load_N for piece in pieces] == settings["load_N"]
    assert len({piece.name for piece in pieces}) == 2
    pushed, pulled = (piece.nominal().gain for piece in pieces)
    assert pushed == pytest.approx(pulled, rel=1e-6)
    pushed, pulled = (piece.nominal("unequal_piston_areas").gain for piece in pieces)
    assert max(pushed, pulled) > 1.1 * min(pushed, pulled)
    assert law.items() <= settings["controller"].items()


def test_gains_alone_do_not_tell_one_factor_on_the_loop_from_another(paper: Prototype):
    """A loop gain 30 % off may be the valve's or the sensor's: critical gains are the same to the last digit."""
    sound = rig_with_lag(paper.but(tolerance=TOLERANCE), 1e5, 2)
    weaker = tuple(replace(g, controller=g.controller.but(gain_A_per_V=1.6 * g.gain)) for g in sound.gains)
    factors = ("parameter:flow_gain", "parameter:sensor_gain")
    found = explained(replace(sound, gains=weaker), ("sensor_lag", *factors))
    assert found.verdict == "ambiguous"
    (rivals,) = found.classes
    assert set(rivals) == set(factors)
    assert found.chosen == ()
    assert found.findings["factor"].factor == pytest.approx(1.6, rel=0.03)
    assert found.next_experiment is not None
    assert found.next_experiment.separation > 1
    assert set(found.next_experiment.separates) == set(factors)
    assert found.next_experiment.settings["kind"] == "frequency_response"  # further gains could not
    total = found.probability_unknown + sum(p for _, p in found.findings["ranked"])
    assert 0.9 < total <= 1 + 1e-9


def test_a_sound_rig_has_no_gap(believed: Prototype):
    found = explained(rig_with_lag(believed, 1e5, 3))
    assert found.verdict == "no_gap"
    assert found.chosen == ()
    assert found.where.subsystem == ""


def test_gains_that_nothing_explains_are_said_to_be_unknown(believed: Prototype):
    sound = rig_with_lag(believed, 1e5, 3)
    factors = (3.0, 0.25, 3.5, 0.3)
    odd = tuple(
        replace(g, controller=g.controller.but(gain_A_per_V=f * g.gain))
        for g, f in zip(sound.gains, factors, strict=True)
    )
    found = explained(replace(sound, gains=odd))
    assert found.verdict == "unknown"
    assert found.probability_unknown > 0.9
    assert found.chosen == ()
    assert "linear" in found.next_experiment.text


def test_a_response_that_no_linear_cause_explains_is_said_to_be_unknown(believed: Prototype):
    """Ripples of 20 % in the response, as of a resonance that nothing in the library has, do not pass as some cause."""
    sound = rig_with_lag(believed, 1e5, 4, (0.4, 0.4))
    rippled = tuple(
        replace(curve, response=curve.response * np.exp(0.2 * np.sin(6 * np.log(LINES)))) for curve in sound.responses
    )
    found = explained(replace(sound, responses=rippled))
    assert found.verdict == "unknown"
    assert found.chosen == ()
    assert "a factor of four" in found.next_experiment.text
    known = tuple(replace(curve, amplitude=20.0) for curve in rippled)
    assert "at 5 and at 20 N" in another_size(replace(sound, responses=known)).text


def test_nothing_to_explain_is_refused(believed: Prototype):
    with pytest.raises(InputError, match=r"critical_gain: missing"):
        explain_gains(Dataset("empty", Path(), believed))


def test_a_response_where_every_believed_model_oscillates_is_refused(believed: Prototype):
    loud = replace(response(believed, 400.0, SETTINGS[0]), controller=PROPORTIONAL.but(gain_A_per_V=0.1))
    with pytest.raises(InputError, match=r"frequency_response: .* where a response was taken"):
        explain_gains(Dataset("loud", Path(), believed, (), (loud,)))


def test_laplace_agrees_with_quadrature(believed: Prototype):
    """Marginal likelihood of a lag from four gains: over its break on a grid, over the tolerances in closed form.

    For a break held fixed the logarithms of gains are near linear in the figures, so that they are Gaussian with
    covariance J J' + 1 (C. E. Rasmussen and C. K. I. Williams, Gaussian Processes for Machine Learning (2006), ch. 2).
    """
    pieces = [GainEvidence(g, believed) for g in rig_with_lag(believed, 250.0, 5).gains]
    hypothesis = together("sensor_lag")
    placement = hypothesis.placement(believed)
    (begin,) = starts(placement, {}, pieces, most=1)
    best = fit(hypothesis, placement, pieces, begin)
    break_at = [u.name for u in placement.unknowns].index("sensor_lag.break_Hz")
    others = [k for k in range(len(placement.unknowns)) if k != break_at]
    grid = np.linspace(-4, 4, 81)
    logs = []
    for value in grid:
        z = best.z.copy()
        z[break_at] = value
        rows = [piece.linearised(placement, z) for piece in pieces]
        r, j = np.concatenate([a for a, _ in rows]), np.vstack([b for _, b in rows])[:, others]
        mean = r - j @ z[others]  # at the centre of the prior of the figures
        covariance = np.eye(4) + j @ j.T
        logs.append(-0.5 * (mean @ np.linalg.solve(covariance, mean) + np.linalg.slogdet(covariance)[1] + value**2))
    whole = np.log(np.sum(np.exp(logs)) * (grid[1] - grid[0]) / np.sqrt(2 * pi))
    assert marginal_likelihood(best, 1.0) == pytest.approx(whole, abs=0.3)


def test_one_common_factor_by_hand():
    found = common_factor([2.0, 8.0], [1.0, 2.0], [0.1, 0.1])
    assert found.factor == pytest.approx(8**0.5)
    assert found.std == pytest.approx(8**0.5 * 0.1 / 2**0.5)
    assert found.left == pytest.approx(log(2) / 2)
    assert found.explained == pytest.approx(1 - (log(2) / 2) ** 2 / ((log(2) ** 2 + log(4) ** 2) / 2))
    # A gain measured ten times better counts a hundred times as much.
    assert common_factor([2.0, 8.0], [1.0, 2.0], [0.01, 0.1]).factor == pytest.approx(2 ** (1 + 1 / 101))


def test_shares_are_the_means_over_both_orders_and_add_up(believed: Prototype):
    data = rig_with_lag(believed, 250.0, 5)
    found = gain_shares([GainEvidence(g, believed) for g in data.gains])
    assert sum(s.share for s in found.shares) == pytest.approx(found.total, abs=1e-12)
    model = np.array([exact(believed, s)[0] for s in SETTINGS])
    lagged = np.array([exact(filtered(believed, 400.0), s)[0] for s in SETTINGS])
    measured = np.array([g.gain for g in data.gains])
    assert found.total == pytest.approx(np.mean(np.log(measured / model)), abs=1e-9)
    assert found.shares[0].alone == pytest.approx(np.mean(np.log(lagged / model)), abs=1e-9)
    (lag, sides, _) = found.shares
    both_orders = [lag.alone, found.together - sides.alone]
    assert lag.share == pytest.approx(np.mean(both_orders), abs=1e-12)


def test_rivals_that_predict_the_same_are_not_separated(believed: Prototype):
    data = rig_with_lag(believed, 150.0, 2)
    pieces = [GainEvidence(g, believed) for g in data.gains]

    def fitted(name: str) -> object:
        hypothesis = Hypothesis((name,))
        placement = hypothesis.placement(believed)
        return fit(hypothesis, placement, pieces, starts(placement, {}, pieces, 1)[0])

    flow, sensor, delay = (fitted(n) for n in ("parameter:flow_gain", "parameter:sensor_gain", "transport_delay"))
    heard = [taken(believed, s, frequency_Hz=exact(believed, s)[1]) for s in SETTINGS]
    found = separations(heard, [flow, sensor, delay])
    assert found[0, 1] < 0.1
    assert found[0, 2] > 10 * found[0, 1]


@pytest.mark.skipif(not SHARED.is_dir(), reason="the open data sets are not here")
def test_with_gains_beside_a_record_the_lag_stays_first():
    data = read_dataset(SHARED)
    data = replace(data, records=data.records[:1])
    pieces = evidence_of(data)
    assert len(pieces) == 5
    assert pieces[1].units == pytest.approx([(0.03**2 + 0.1**2) ** 0.5])  # a linear loop beside a record
    assert pieces[1].expected == pytest.approx(0.03**2 / (0.03**2 + 0.1**2))

    def likelihood(name: str, some: Sequence[object]) -> float:
        hypothesis = Hypothesis((name,)) if name else NOTHING
        placement = hypothesis.placement(data.prototype)
        (begin,) = starts(placement, {}, some, most=1)
        return marginal_likelihood(fit(hypothesis, placement, some, begin), 1.0)

    names = ("sensor_lag", "", "transport_delay")
    alone = {name: likelihood(name, record_evidence(data)) for name in names}
    with_gains = {name: likelihood(name, pieces) for name in names}
    assert max(alone, key=alone.__getitem__) == "sensor_lag"
    assert max(with_gains, key=with_gains.__getitem__) == "sensor_lag"


@pytest.mark.parametrize(("share", "error", "verdict"), [(1.0, 0.03, "effect"), (0.05, 3.0, "ambiguous")])
def test_a_gain_far_from_the_believed_one_is_doubted_unless_the_cause_explains_it(
    share: float, error: float, verdict: str, believed: Prototype, monkeypatch: pytest.MonkeyPatch, single_causes: None
):
    """A sensor of 20 Hz: the lag oscillates at a fifteenth of the gain that is believed, as the exact loop has it.

    A gain far from that too is within its error, and no misfit: only that it is so far makes it doubtful.
    """
    monkeypatch.setattr(search, "singles", lambda rig: (Hypothesis(("sensor_lag",)), Hypothesis(("seal_friction",))))
    for look in ("channels_in_time", "what_passed", "learn", "second_look", "next_experiment"):
        monkeypatch.setattr(diagnosing, look, lambda *given: None)
    nominal = believed.but(controller=LAG)
    slow = critical_gain(filtered(nominal, 20.0)).gain_A_per_V
    assert slow < 0.07 * critical_gain(nominal).gain_A_per_V
    plan = scenario(0.5)
    rows = [row.but(controller=PROPORTIONAL) for row in plan.record if row.name.startswith("command")]
    rig = nominal.but(effects={"sensor_lag": {"break_Hz": 20.0}})
    data = measured(rig, plan.but(record=tuple(rows)), nominal)
    found = diagnose(replace(data, gains=(MeasuredGain(LAG.but(gain_A_per_V=share * slow), 0.0, 0.0, error),)), 1)
    assert (found.verdict, found.chosen) == (verdict, ("sensor_lag",))
    assert any("times what is believed: check it and its masses" in words for words in found.warnings)
