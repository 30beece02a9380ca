"""Structured controllers: a lag with second-order sections, from its record to what is proved and simulated of it."""

import hashlib
import re
from math import pi
from pathlib import Path

import control
import numpy as np
import pytest
from scipy.signal import sos2zpk, zpk2tf

from beamdesign.controller import control_model, shape_response, transfer_function
from beamdesign.higher_modes import signals, single_compliance, with_mass
from beamdesign.linear import linear_rig
from beamdesign.loop import loop
from beamdesign.operating_limits import sensor_reach
from beamdesign.proof.certificate import Asked, Certificate, certify
from beamdesign.proof.replay import Malformed, replay
from beamdesign.prototype import Prototype, Section, Structured, read_prototype, write_prototype
from beamdesign.records import InputError
from beamdesign.scenario import Multisine, Sampled, Scenario, ScenarioRecord, inputs_of
from beamdesign.simulate import half_steps, simulate

LAW = Structured(
    gain_A_per_V=0.05,
    pole_Hz=1.0,
    zero_Hz=30.0,
    section=(
        Section(zero_Hz=55.0, zero_damping_ratio=0.2, pole_Hz=70.0, pole_damping_ratio=0.6),
        Section(zero_Hz=230.0, zero_damping_ratio=0.4, pole_Hz=120.0, pole_damping_ratio=0.8),
    ),
)
FREQUENCIES_HZ = np.geomspace(0.01, 2000.0, 1500)
MASSES_KG = (0.0, 6.8)


@pytest.fixture(scope="module")
def rig() -> Prototype:
    """The published rig with its sensor filter, a structured controller and limits of gain and effort."""
    record = read_prototype(Path(__file__).parent.parent / "studies/prototypes/paper_remedy.toml")
    return record.but(
        controller=LAW,
        sensor=record.sensor.but(filter_Hz=400.0, noise_V=0.01),
        goal=record.goal.but(loop_gain=0.25, controller_effort_A_per_V=0.06),
    )


def by_python_control(rig: Prototype, mass: float) -> tuple[control.StateSpace, control.StateSpace]:
    """The plant from (force, current) to (displacement, volts), and the controller, as python-control has them."""
    a, b, c = linear_rig(rig).matrices(mass, rig.payload.inner_end_mass_kg)
    assert rig.controller is not None
    return control.ss(a, b, c, 0), control_model(rig.controller)


def test_the_transfer_function_is_the_product_of_its_sections() -> None:
    """Against python-control and scipy, each section made from its own poles and zeros."""
    s = 2j * pi * FREQUENCIES_HZ
    law = transfer_function(LAW)
    found = np.polyval([float(c) for c in law.numerator.coeffs()[::-1]], s)
    found /= np.polyval([float(c) for c in law.denominator.coeffs()[::-1]], s)
    expected = LAW.gain_A_per_V * control.tf([1 / (2 * pi * 30.0), 1], [1 / (2 * pi * 1.0), 1])
    for part in LAW.section:
        z, p = 2 * pi * part.zero_Hz, 2 * pi * part.pole_Hz
        row = [1 / z**2, 2 * part.zero_damping_ratio / z, 1, 1 / p**2, 2 * part.pole_damping_ratio / p, 1]
        expected = expected * control.tf(*zpk2tf(*sos2zpk([row])))
    np.testing.assert_allclose(found, expected(s), rtol=1e-9)
    np.testing.assert_allclose(LAW.gain_A_per_V * shape_response(LAW, FREQUENCIES_HZ), expected(s), rtol=1e-9)
    np.testing.assert_allclose(control_model(LAW)(s), expected(s), rtol=1e-7)


def test_a_prototype_with_sections_goes_to_toml_and_back(rig: Prototype, tmp_path: Path) -> None:
    write_prototype(rig, tmp_path / "prototype.toml")
    assert read_prototype(tmp_path / "prototype.toml") == rig
    text = (tmp_path / "prototype.toml").read_text()
    (tmp_path / "wrong.toml").write_text(text.replace("pole_damping_ratio = 0.6", "pole_damping_rate = -0.6"))
    with pytest.raises(InputError) as told:
        read_prototype(tmp_path / "wrong.toml")
    reasons = {problem.key: problem.reason for problem in told.value.problems}
    assert reasons["controller.section.pole_damping_ratio"] == "entry 1: missing"
    assert "did you mean pole_damping_ratio?" in reasons["controller.section.pole_damping_rate"]


@pytest.fixture(scope="module")
def proved(rig: Prototype) -> Certificate:
    """A certificate with claims of gain and effort that hold and others that do not."""
    asked = [Asked("loop_gain", 0.25, from_Hz=250.0), Asked("loop_gain", 0.014, from_Hz=250.0)]
    asked += [Asked("controller_effort", 0.06), Asked("controller_effort", 0.026)]
    return certify(rig, *MASSES_KG, asked)


def test_loop_gain_and_effort_are_never_above_what_is_proved(rig: Prototype, proved: Certificate) -> None:
    """Dense grids of python-control's responses come near the proved figures from below, and never pass them."""
    found = proved.guaranteed
    assert found is not None
    assert found.loop_gain is not None
    assert found.controller_effort_A_per_V is not None
    gains, efforts, s = [], [], 2j * pi * np.geomspace(3.0, 300.0, 4000)
    for mass in np.linspace(*MASSES_KG, 35):
        plant, law = by_python_control(rig, float(mass))
        beyond = np.geomspace(250.0, 3000.0, 200)
        gains.append(np.abs(plant(2j * pi * beyond)[1, 1] * law(2j * pi * beyond)).max())
        efforts.append(np.abs(law(s) / (1 + plant(s)[1, 1] * law(s))).max())
    assert found.loop_gain * (1 - 1e-3) < max(gains) <= found.loop_gain
    assert found.controller_effort_A_per_V * (1 - 1e-3) < max(efforts) <= found.controller_effort_A_per_V


def test_a_false_claim_is_refuted_where_it_fails(rig: Prototype, proved: Certificate) -> None:
    assert [claim.holds for claim in proved.claims] == [True, False, True, False]
    for claim in (proved.claims[1], proved.claims[3]):
        assert claim.witness_frequency_Hz is not None
        assert claim.witness_outer_end_mass_kg is not None
        plant, law = by_python_control(rig, claim.witness_outer_end_mass_kg)
        s = 2j * pi * claim.witness_frequency_Hz
        gain = plant(s)[1, 1] * law(s)
        reached = abs(gain) if claim.kind == "loop_gain" else abs(law(s) / (1 + gain))
        assert reached > claim.limit
        assert claim.kind != "loop_gain" or claim.witness_frequency_Hz >= 250.0


def resealed(text: str) -> str:
    """The text with the checksum that belongs to it."""
    bare = re.sub(r'sha256 = "[0-9a-f]+"\n', "", text)
    before, version, after = bare.partition("version = 1\n")
    return before + version + f'sha256 = "{hashlib.sha256(bare.encode()).hexdigest()}"\n' + after


FORGERIES = {
    "a smaller loop gain": ('limit = "0.25"', 'limit = "0.0148"', "not proved: loop_gain 0.0148 from 250 Hz up"),
    "a wider band": ('from_Hz = "250"', 'from_Hz = "150"', "not proved: loop_gain"),
    "a smaller effort": ('limit = "0.06"', 'limit = "0.0263"', "not proved: controller_effort 0.0263 A/V"),
    "a refutation of what holds": (
        'limit = "0.06"\nholds = true',
        'limit = "0.06"\nholds = false',
        "holds after all: controller_effort",
    ),
    "another section": ('pole_damping_ratio = "0.6"', 'pole_damping_ratio = "0.7"', "figures contradict"),
    "another break": ('zero_Hz = "230"', 'zero_Hz = "231"', "figures contradict"),
}


@pytest.mark.parametrize("name", FORGERIES)
def test_the_replay_catches_a_forgery(proved: Certificate, name: str) -> None:
    before, after, told = FORGERIES[name]
    assert before in proved.text
    outcome = replay(resealed(proved.text.replace(before, after)))
    assert not outcome.valid
    assert any(told in reason for reason in outcome.reasons), outcome.reasons


def test_the_replay_proves_what_was_proved(proved: Certificate) -> None:
    outcome = replay(proved.text)
    assert outcome.valid, outcome.reasons
    assert "loop_gain 0.25 from 250 Hz up" in outcome.claims
    assert "refuted: controller_effort 0.026 A/V" in outcome.claims
    with pytest.raises(Malformed, match="not negative"):
        replay(resealed(proved.text.replace('from_Hz = "250"', 'from_Hz = "-250"')))


def test_with_effects_gain_and_effort_are_those_of_every_member(rig: Prototype) -> None:
    """Dead band and delay: the whole gain governs |L|, and either end of it the effort."""
    from beamdesign.proof import replay_members

    worn = rig.but(effects={"transport_delay": {"delay_s": 3e-4}, "unequal_piston_areas": {"asymmetry": 0.1}})
    found = certify(worn, *MASSES_KG, [Asked("loop_gain", 0.25, from_Hz=250.0), Asked("controller_effort", 0.06)])
    assert found.holds, found.reason
    assert found.guaranteed is not None
    # The smaller side moves the piston faster: |L| is larger by its share.
    alone = certify(rig.but(effects={"transport_delay": {"delay_s": 3e-4}}), *MASSES_KG)
    assert alone.guaranteed is not None
    assert found.guaranteed.loop_gain == pytest.approx((alone.guaranteed.loop_gain or 0) / 0.9, rel=0.03)
    outcome = replay_members.replay(found.text)
    assert outcome.valid, outcome.reasons
    forged = found.text.replace(f'limit = "{found.guaranteed.loop_gain:g}"', 'limit = "0.001"')
    assert forged != found.text
    assert not replay_members.replay(resealed(forged)).valid


def test_small_motion_of_the_rig_is_that_of_the_linear_loop(rig: Prototype) -> None:
    """The simulated loop against python-control's response of plant and controller put together there."""
    signals_in = (Multisine(amplitude_N=20.0, low_Hz=2.0, high_Hz=100.0), Multisine(amplitude_V=0.01, high_Hz=80.0))
    row = ScenarioRecord(name="one", input=signals_in)
    plan = Scenario(name="test", duration_s=0.4, record=(row,))
    record = simulate(rig, plan).records[0]
    plant, law = by_python_control(rig, 0.0)
    plant = control.ss(
        plant.A, plant.B, plant.C, plant.D, inputs=["disturbance_N", "current_A"], outputs=["x_m", "volt_V"]
    )
    error = control.summing_junction(["command_V", "-volt_V"], "error_V")
    closed = control.interconnect(
        [plant, law, error], inputs=["disturbance_N", "command_V"], outputs=["x_m", "current_A", "volt_V"]
    )
    fine = half_steps(inputs_of(row, plan), 20)
    grid = np.arange(len(fine)) * plan.sample_s / 40
    expected = control.forced_response(closed, grid, fine.T).outputs[:, ::40]
    for column, values in (("displacement_m", expected[2] / 1180.0), ("current_A", expected[1])):
        np.testing.assert_allclose(record.column(column), values, atol=5e-4 * np.abs(values).max())


def test_limits_take_the_whole_controller(rig: Prototype) -> None:
    """The sampled-mode loop of `limits` is the exact one; noise is amplified as far above all breaks."""
    frequency = np.geomspace(1.0, 300.0, 20)
    outer = with_mass(single_compliance(rig, "outer_beam"), 2.0)
    inner = with_mass(single_compliance(rig, "inner_beam"), rig.payload.inner_end_mass_kg)
    found = LAW.gain_A_per_V * signals(rig, outer, inner, frequency).loop_per_gain
    np.testing.assert_allclose(found, loop(rig).at(2.0).loop_response(frequency), rtol=1e-6)
    fast = 0.05 * (1 / 30) * (70 / 55) ** 2 * (120 / 230) ** 2
    assert sensor_reach(rig).current_noise_A == pytest.approx(0.01 * fast)


def test_what_is_for_a_lag_alone_says_so(rig: Prototype) -> None:
    plan = Scenario(
        name="test",
        duration_s=0.1,
        sampled=Sampled(period_s=1e-3),
        record=(ScenarioRecord(name="one", input=(Multisine(amplitude_N=1.0),)),),
    )
    with pytest.raises(InputError, match="'structured' is not for a sampled loop"):
        simulate(rig, plan)
