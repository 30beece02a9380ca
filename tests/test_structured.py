"""Structured controllers: a lag with second-order sections, from its record to what is proved and simulated of it."""

import json
import tomllib
from math import pi
from pathlib import Path

import control
import numpy as np
import pytest
from delivered_bandwidth import MEASURED_WITHIN, delivered, drawn
from forging import altered
from limit_trades import LIMITS, Trade, plot_limit_trades
from loop_effort import effort_response
from matplotlib.figure import Figure
from one_start import least_effort
from scipy.signal import sos2zpk, zpk2tf
from typer.testing import CliRunner

from beamdesign import InputError, Prototype, certify, check, read_prototype, simulate, tune, write_prototype
from beamdesign.checker import Unreadable
from beamdesign.cli import app
from beamdesign.controllers import Section, Structured
from beamdesign.loop import loop
from beamdesign.plant.compiled import half_steps
from beamdesign.plant.linear_reach import signals, single_compliance, with_mass
from beamdesign.plant.members import paper_model
from beamdesign.proofs.certificate import Asked, Certificate, goal_claims
from beamdesign.scenario import Multisine, Scenario, ScenarioRecord, inputs_of
from beamdesign.synthesis.design_run import certified
from beamdesign.synthesis.loop_samples import samples, slacks
from beamdesign.synthesis.operating_limits import sensor_reach
from beamdesign.synthesis.tuning import Tuning

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
    a, b, c = paper_model(rig).matrices(mass, rig.payload.inner_end_mass_kg)
    assert rig.controller is not None
    return control.ss(a, b, c[:2], 0), rig.controller.control_model()


def test_the_transfer_function_is_the_product_of_its_sections() -> None:
    """Against python-control and scipy, each section made from its own poles and zeros."""
    s = 2j * pi * FREQUENCIES_HZ
    law = LAW.transfer_function()
    found = np.polyval([float(c) for c in law.numerator.coeffs()[::-1]], s)
    found /= np.polyval([float(c) for c in law.denominator.coeffs()[::-1]], s)
    expected = LAW.gain_A_per_V * control.tf([1 / (2 * pi * 30.0), 1], [1 / (2 * pi * 1.0), 1])
    for part in LAW.section:
        z, p = 2 * pi * part.zero_Hz, 2 * pi * part.pole_Hz
        row = [1 / z**2, 2 * part.zero_damping_ratio / z, 1, 1 / p**2, 2 * part.pole_damping_ratio / p, 1]
        expected = expected * control.tf(*zpk2tf(*sos2zpk([row])))
    np.testing.assert_allclose(found, expected(s), rtol=1e-9)
    np.testing.assert_allclose(
        LAW.gain_A_per_V * LAW.sensor_responses(FREQUENCIES_HZ)["displacement_m"], expected(s), rtol=1e-9
    )
    np.testing.assert_allclose(LAW.control_model()(s), expected(s), rtol=1e-7)


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
    """Dense grids of responses, by python-control's matrices, come near the proved figures and never pass them."""
    found = proved.guaranteed
    assert found is not None
    assert found.loop_gain is not None
    assert found.controller_effort_A_per_V is not None
    s, beyond = 2j * pi * np.geomspace(3.0, 300.0, 4000), 2j * pi * np.geomspace(250.0, 3000.0, 200)
    gains, efforts, law = [], [], by_python_control(rig, 0.0)[1]
    of_law, of_law_beyond = law(s), law(beyond)

    def volts(plant: control.StateSpace, s: np.ndarray) -> np.ndarray:
        """Per ampere, at all frequencies at once; python-control takes one after another."""
        states = np.linalg.solve(s[:, None, None] * np.eye(len(plant.A)) - plant.A, plant.B[:, 1:])
        return (plant.C[1:] @ states)[:, 0, 0]

    for mass in np.linspace(*MASSES_KG, 35):
        plant, _ = by_python_control(rig, float(mass))
        gains.append(np.abs(volts(plant, beyond) * of_law_beyond).max())
        efforts.append(np.abs(of_law / (1 + volts(plant, s) * of_law)).max())
    assert found.loop_gain * (1 - 1e-3) < max(gains) <= found.loop_gain
    assert found.controller_effort_A_per_V * (1 - 1e-3) < max(efforts) <= found.controller_effort_A_per_V


def test_a_false_claim_is_refuted_where_it_fails(rig: Prototype, proved: Certificate) -> None:
    assert [claim.holds for claim in proved.claims] == [True, False, True, False]
    for claim in (proved.claims[1], proved.claims[3]):
        assert claim.witness is not None
        assert claim.witness_outer_end_mass_kg is not None
        plant, law = by_python_control(rig, claim.witness_outer_end_mass_kg)
        s = 2j * pi * claim.witness.frequency_Hz
        gain = plant(s)[1, 1] * law(s)
        reached = abs(gain) if claim.kind == "loop_gain" else abs(law(s) / (1 + gain))
        assert reached > claim.limit
        assert claim.kind != "loop_gain" or claim.witness.frequency_Hz >= 250.0


FORGERIES = {
    "a smaller loop gain": (("claim", 0, "limit"), "0.0148", "not proved: loop gain at most 0.0148 from 250 Hz up"),
    "a wider band": (("claim", 0, "from_Hz"), "30", "not proved: loop gain at most 0.25 from 30 Hz up"),
    "a smaller effort": (("claim", 2, "limit"), "0.0263", "not proved: controller effort at most 0.0263 A/V"),
    "a refutation of what holds": (("claim", 2, "holds"), False, "holds after all: controller effort at most 0.06 A/V"),
    "another section": (("controller", "section", 0, "pole_damping_ratio"), "0.7", "follow from its figures"),
    "another break": (("controller", "zero_Hz"), "231", "follow from its figures"),
}


@pytest.mark.parametrize("name", FORGERIES)
def test_a_forgery_is_found_out(proved: Certificate, name: str) -> None:
    place, value, told = FORGERIES[name]
    outcome = check(altered(proved.text, place, value))
    assert any(told in words for words in outcome.failed), outcome.failed


def test_the_replay_proves_what_was_proved(proved: Certificate) -> None:
    outcome = check(proved.text)
    assert outcome.valid, outcome.failed
    assert "loop gain at most 0.25 from 250 Hz up" in outcome.proved
    assert "refuted: controller effort at most 0.026 A/V" in outcome.proved
    with pytest.raises(Unreadable, match="at least 0"):
        check(altered(proved.text, ("claim", 0, "from_Hz"), "-250"))


def test_with_effects_gain_and_effort_are_those_of_every_member(rig: Prototype) -> None:
    """Dead band and delay: the whole gain governs |L|, and either end of it the effort."""

    worn = rig.but(effects={"transport_delay": {"delay_s": 3e-4}, "unequal_piston_areas": {"asymmetry": 0.1}})
    found = certify(worn, *MASSES_KG, [Asked("loop_gain", 0.25, from_Hz=250.0), Asked("controller_effort", 0.06)])
    assert found.holds, found.reason
    assert found.guaranteed is not None
    # The smaller side moves the piston faster: |L| is larger by its share.
    alone = certify(rig.but(effects={"transport_delay": {"delay_s": 3e-4}}), *MASSES_KG)
    assert alone.guaranteed is not None
    assert found.guaranteed.loop_gain == pytest.approx((alone.guaranteed.loop_gain or 0) / 0.9, rel=0.03)
    outcome = check(found.text)
    assert outcome.valid, outcome.failed
    kinds = [claim["kind"] for claim in tomllib.loads(found.text)["claim"]]
    assert not check(altered(found.text, ("claim", kinds.index("loop_gain"), "limit"), "0.001")).valid


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


def test_slopes_of_the_sampled_slacks_are_those_of_finite_differences(rig: Prototype) -> None:
    points = samples(paper_model(rig).polynomials(), np.geomspace(1.0, 600.0, 40), [0.0, 6.8])
    form, variables = LAW.form()
    at = np.append(variables, 4.5)
    found = slacks(points, rig.goal, form, at)
    for k in range(len(at)):
        step = np.zeros(len(at))
        step[k] = 1e-6
        up, down = (slacks(points, rig.goal, form, at + side * step, slopes=False) for side in (1, -1))
        for part in range(4):
            limited = np.isfinite(found.values[part])
            expected = (up.values[part][limited] - down.values[part][limited]) / 2e-6
            np.testing.assert_allclose(
                found.slopes[part][limited, k], expected, atol=2e-6 * np.abs(expected).max() + 1e-9
            )


def test_sampled_slacks_are_those_of_the_exact_loop(rig: Prototype) -> None:
    frequency = np.geomspace(1.0, 600.0, 40)
    form, variables = LAW.form()
    points = samples(paper_model(rig).polynomials(), frequency, [2.0])
    found = slacks(points, rig.goal, form, np.append(variables, 4.5), slopes=False)
    exact = loop(rig).at(2.0)
    np.testing.assert_allclose(found.sensitivity, np.log(2 / np.abs(exact.sensitivity_response(frequency))), atol=1e-8)
    np.testing.assert_allclose(found.values[3], np.log(0.06 / np.abs(effort_response(exact, frequency))), atol=1e-8)
    compliance = np.log(5.71e-8 / np.abs(exact.compliance_response(frequency)))
    np.testing.assert_allclose(found.compliance, compliance, atol=1e-8)
    assert found.settled is exact.stable


@pytest.fixture(scope="module")
def tuned(rig: Prototype) -> Tuning:
    """One section, without payload: enough to be twice as fast as a lag."""
    with least_effort():
        return tune(rig, (0.0, 0.0), "structured", 0.0, sections=1, sigmas=0.0)


@pytest.mark.usefixtures("least_effort")
def test_a_section_nearly_doubles_the_bandwidth_of_the_lag(rig: Prototype, tuned: Tuning) -> None:
    """The lag alone reaches 5.6 Hz with this filter."""
    lag = tune(rig, (0.0, 0.0), "lag", 0.0, sigmas=0.0)
    assert lag.best is not None
    assert tuned.best is not None
    assert tuned.best.bandwidth_Hz > 1.9 * lag.best.bandwidth_Hz
    certificate, prototype = certified(tuned.prototype, tuned.best, (0.0, 0.0))
    assert certificate.holds, certificate.reason
    assert {claim.kind for claim in certificate.claims} >= {"loop_gain", "controller_effort"}
    assert check(certificate.text).valid
    closed = loop(prototype).at(0.0)
    assert closed.bandwidth_Hz() == pytest.approx(tuned.best.bandwidth_Hz, rel=1e-6)
    assert closed.peak_sensitivity() <= 2.0


@pytest.mark.usefixtures("least_effort")
def test_limits_of_the_goal_cost_bandwidth(rig: Prototype, tuned: Tuning) -> None:
    """A current that is ten times less allows less, and a lag keeps the goal's limits too."""
    tighter = rig.but(goal=rig.goal.but(controller_effort_A_per_V=0.006))
    found = tune(tighter, (0.0, 0.0), "lag", 0.0, sigmas=0.0)
    assert found.best is not None
    reached = loop(found.prototype).at(0.0)
    frequency = np.geomspace(0.1, 3000.0, 3000)
    effort = np.abs(effort_response(reached, frequency)).max()
    assert 0.99 * 0.006 < effort <= 0.006
    assert tuned.best is not None
    assert found.best.bandwidth_Hz < 0.5 * tuned.best.bandwidth_Hz


def test_what_a_good_rig_delivers_is_what_its_linear_loop_promises(tuned: Tuning) -> None:
    """With no effects the measured bandwidth is that of the response at the measured limit."""
    assert tuned.best is not None
    closed = loop(tuned.prototype).at(0.0)
    found = delivered(tuned.prototype, 0.0, 30.0)
    assert found.stable
    expected = closed.bandwidth_Hz((1 + MEASURED_WITHIN) * tuned.prototype.goal.compliance_m_per_N)
    assert found.bandwidth_Hz == pytest.approx(expected, abs=1.0)
    # Too little current: the same rig cannot follow the same force.
    weak = tuned.prototype.but(effects={"current_saturation": {"limit_A": 2e-4}})
    assert delivered(weak, 0.0, 300.0).bandwidth_Hz < 0.5 * found.bandwidth_Hz


@pytest.mark.usefixtures("least_effort")
def test_the_command_tunes_within_limits_and_says_which(rig: Prototype, tmp_path: Path) -> None:
    bare = rig.but(goal=type(rig.goal)(), controller=None)
    write_prototype(bare, tmp_path / "bare.toml")
    told = ["tune", str(tmp_path / "bare.toml"), "--controller", "structured", "--sections", "1", "--nominal"]
    told += ["--outer-end-mass", "0:0", "--largest-inner-end-mass-kg", "0", "--controller-effort-A-per-V", "inf"]
    done = CliRunner().invoke(app, [*told, "--out", str(tmp_path), "--json", str(tmp_path / "answer.json")])
    assert done.exit_code == 0, done.exception
    found = read_prototype(tmp_path / "prototype.toml")
    assert isinstance(found.controller, Structured)
    assert (found.goal.loop_gain, found.goal.controller_effort_A_per_V) == (0.25, None)
    answer = json.loads((tmp_path / "answer.json").read_text())
    assert answer["guaranteed"]["loop_gain"] == 0.25
    assert answer["controller"]["section"][0]["pole_Hz"] == found.controller.section[0].pole_Hz
    assert check((tmp_path / "certificate.toml").read_text()).valid


def test_trades_are_drawn_with_the_value_as_it_is(rig: Prototype) -> None:
    """Every limit can be changed alone, and stands in the picture; what was not proved is marked."""
    for limit in LIMITS:
        own = limit.own(rig)
        assert own is not None
        assert limit.own(limit.at(rig, 1.5 * own)) == pytest.approx(1.5 * own)
        assert limit.at(rig, own) == rig
    trades = [Trade(limit, (100.0, 200.0, 400.0), (None, 4.0, 6.0)) for limit in LIMITS]
    figure = plot_limit_trades(Figure(), trades, rig, "title")
    assert [axes.get_xlabel() for axes in figure.axes] == [limit.name for limit in LIMITS]
    for axes, limit in zip(figure.axes, LIMITS, strict=True):
        curve, cross, line = axes.lines
        assert curve.get_ydata().tolist() == [4.0, 6.0]
        assert cross.get_marker() == "x"
        assert list(line.get_xdata()) == [limit.own(rig)] * 2


def test_drawn_rigs_differ_by_what_was_asked(rig: Prototype) -> None:
    rigs = drawn(rig, {"flow_gain": 0.05, "oil_stiffness": 0.1}, 200)
    gains = np.array([one.servovalve.flow_gain_m3_per_s_per_A for one in rigs]) / 1.13e-2
    assert gains.std() == pytest.approx(0.05, rel=0.2)
    assert np.abs(gains - 1).max() <= 0.1 + 1e-9
    assert all(one.controller == rig.controller and one.outer_beam == rig.outer_beam for one in rigs)
    assert drawn(rig, {"flow_gain": 0.05}, 3) == drawn(rig, {"flow_gain": 0.05}, 3)


def test_the_shipped_designs_are_what_they_are_said_to_be() -> None:
    """Proved within the limits of the one's goal; faster, and far beyond those limits, the other."""
    folder = Path(__file__).parent.parent / "studies/prototypes"
    limited, free = (read_prototype(folder / f"structured_{name}.toml") for name in ("no_payload", "unlimited"))
    for design, bandwidth in ((limited, 25.0), (read_prototype(folder / "structured.toml"), 16.0)):
        masses = design.payload.outer_end_mass_kg
        assert masses is not None
        found = certify(design, *masses, goal_claims(design.goal))
        assert found.holds, found.reason
        assert found.guaranteed is not None
        assert found.guaranteed.bandwidth_Hz > bandwidth
        assert found.guaranteed.peak_sensitivity <= 2.0
        assert check(found.text).valid
    wild = certify(free, 0.0, 0.0, goal_claims(limited.goal))
    assert wild.guaranteed is not None
    assert wild.guaranteed.bandwidth_Hz > 37.0
    assert [claim.holds for claim in wild.claims] == [False, False]
