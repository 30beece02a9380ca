"""Laws chosen by the payload: estimate, switch, proof of any change between stages, record and commands."""

import json
import tomllib
from dataclasses import replace
from math import inf, sqrt
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from flint import fmpq, fmpq_mat
from honest_certificates import screw
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import cont2discrete
from similar import similar
from typer.testing import CliRunner

from beamdesign import (
    InputError,
    Prototype,
    certify,
    certify_switching,
    check,
    critical_gain,
    read_prototype,
    read_scenario,
    simulate,
    tune,
    write_prototype,
)
from beamdesign.cli import app
from beamdesign.cli.command import of_all
from beamdesign.controllers import Estimator, Scheduled, Section, Stage, Structured
from beamdesign.controllers.scheduled import sampling_period_s
from beamdesign.controllers.scheduling import (
    CANDIDATES,
    FREE,
    NOTHING,
    Estimate,
    PayloadEstimator,
    PlantStep,
    free_responses,
    next_stage,
    plant_step,
)
from beamdesign.diagnosis.data.dataset import TimeRecord
from beamdesign.diagnosis.predict import predict_record
from beamdesign.loop import loop
from beamdesign.plant.linear import LinearModel
from beamdesign.plant.members import paper_model, served
from beamdesign.polynomial import exact
from beamdesign.proofs.courses import stage_change
from beamdesign.proofs.decrease import Sought, changes_of_stage, dwell_suffices, grows_beyond, not_falling
from beamdesign.proofs.lyapunov import Switching, describe, switching
from beamdesign.proofs.mass_family import MassFamily, stage_families, stage_family
from beamdesign.prototype import Arm, Goal, Payload
from beamdesign.sampling import sampled_stage
from beamdesign.scenario import (
    Course,
    PayloadChange,
    Sampled,
    Scenario,
    ScenarioRecord,
    Step,
    WallAhead,
    inputs_of,
)
from beamdesign.simulation import simulate_scheduled
from beamdesign.structure.arm import lever_figures
from beamdesign.structure.lumped import figures
from beamdesign.synthesis import tuning
from beamdesign.synthesis.law_design import Proved
from beamdesign.synthesis.rig_spread import rig_spread
from beamdesign.synthesis.tuning import LawOptions, Tuning, kept_apart, limited, stage_ranges

ROOT = Path(__file__).parents[1]
SHIPPED = ROOT / "studies" / "scheduled" / "prototype.toml"
LOW, HIGH = fmpq(0), exact(6.8)
PERIOD_S = 0.5e-3


@pytest.fixture(scope="module")
def rig() -> Prototype:
    return read_prototype(SHIPPED)


def schedule_of(rig: Prototype) -> Scheduled:
    assert rig.schedule is not None
    return rig.schedule


@pytest.fixture(scope="module")
def proved(rig: Prototype) -> Switching:
    return switching(stage_families(rig), 0.0, 6.8, dwell_s=schedule_of(rig).dwell_s)


def volts_of(prototype: Prototype, mass: float, force: np.ndarray, current: np.ndarray) -> np.ndarray:
    """Sensor volts under a held force and current, by SciPy's discretisation of the plant."""
    a, b, c = paper_model(prototype).matrices(mass, prototype.payload.inner_end_mass_kg)
    scale = np.array([1e-5, 1e-3, 1e-5, 1e-5, 1e-3, 1e-6, 1e-3])
    a, b, c = a * scale / scale[:, None], b / scale[:, None], c * scale
    f, g, h, _, _ = cont2discrete((a, b, c, np.zeros((2, 2))), PERIOD_S)
    state, volts = np.zeros(len(f)), np.empty(len(force))
    for k in range(len(force)):
        volts[k] = (h @ state)[1]
        state = f @ state + g @ np.array([force[k], current[k]])
    return volts


def after_a_step(prototype: Prototype, mass: float) -> tuple[np.ndarray, np.ndarray]:
    """Volts and current from just after a load of 40 N came on."""
    before, after = 20, 160
    force = np.where(np.arange(before + after) < 10, 0.0, 40.0)
    current = 1e-3 * np.random.default_rng(5).standard_normal(len(force)).cumsum()
    return volts_of(prototype, mass, force, current)[before:], current[before:]


# The estimate.


def response(step: PlantStep, current_A: np.ndarray) -> np.ndarray:
    """(N,) volts under a held current (N,), from rest without force."""
    state, volts = np.zeros(len(step.output)), np.empty(len(current_A))
    for k, value in enumerate(current_A):
        volts[k] = step.output @ state
        state = step.transition @ state + step.input * value
    return volts


def unexplained(
    rig: LinearModel,
    outer_end_mass: float,
    inner_end_mass: float,
    volts: np.ndarray,
    current_A: np.ndarray,
    period_s: float,
) -> float:
    """Sum of squares (V^2) of a record that no state and no constant force explains at a payload."""
    step = plant_step(rig, outer_end_mass, inner_end_mass, period_s)
    rest = volts - response(step, current_A)
    free = free_responses(step, len(volts))
    rest = rest - free @ (free.T @ rest)
    return float(rest @ rest)


def fitted_payload(
    rig: LinearModel,
    inner_end_mass: float,
    volts: np.ndarray,
    current_A: np.ndarray,
    period_s: float,
    masses_kg: tuple[float, float],
) -> tuple[float, float]:
    """The most likely payload of one record, not bound to candidates, and its standard deviation, kg.

    Args:
        rig: the plant.
        inner_end_mass: kg.
        volts: (N,) of the sensor, under a force that does not move.
        current_A: (N,) held from sample to sample.
        period_s: between samples.
        masses_kg: where to look.
    """
    from scipy.optimize import minimize_scalar

    def cost(mass: float) -> float:
        return unexplained(rig, mass, inner_end_mass, volts, current_A, period_s)

    grid = np.linspace(*masses_kg, CANDIDATES)
    costs = [cost(mass) for mass in grid]
    k = int(np.clip(np.argmin(costs), 1, CANDIDATES - 2))
    found = minimize_scalar(cost, bounds=(grid[k - 1], grid[k + 1]), method="bounded", options={"xatol": 1e-9})
    width = 0.05 * (grid[1] - grid[0])
    bend = (cost(found.x + width) - 2 * found.fun + cost(found.x - width)) / width**2
    variance = found.fun / max(len(volts) - FREE, 1)
    return float(found.x), sqrt(2 * variance / bend) if bend > 0 else inf


@pytest.mark.parametrize("mass", [0.0, 3.217, 6.8])
def test_without_noise_the_payload_is_found_exactly(rig: Prototype, mass: float) -> None:
    plant, inner = paper_model(rig), rig.payload.inner_end_mass_kg
    volts, current = after_a_step(rig, mass)
    found, _ = fitted_payload(plant, inner, volts, current, PERIOD_S, (-0.5, 7.5))
    assert found == pytest.approx(mass, abs=1e-6)


def test_with_noise_the_estimate_is_unbiased_and_errs_as_it_says(rig: Prototype) -> None:
    plant, inner = paper_model(rig), rig.payload.inner_end_mass_kg
    volts, current = after_a_step(rig, 4.0)
    random = np.random.default_rng(11)
    errors = []
    for _ in range(30):
        heard = volts + 0.002 * random.standard_normal(len(volts))
        found, std = fitted_payload(plant, inner, heard, current, PERIOD_S, (2.0, 6.0))
        errors.append((found - 4.0) / std)
    # Of 30 normal draws the mean lies within 3/sqrt(30), and the root of the mean square within 0.6 and 1.4 of one.
    assert abs(np.mean(errors)) < 3 / np.sqrt(30)
    assert 0.6 < np.sqrt(np.mean(np.square(errors))) < 1.4


def test_a_force_that_stays_tells_the_payload_and_one_that_moves_does_not(rig: Prototype) -> None:
    random = np.random.default_rng(2)
    count = 600
    stays = np.where(np.arange(count) < 100, 0.0, 40.0)
    moves = 40 * np.convolve(random.standard_normal(count), np.full(8, 0.125), mode="same")
    for force, knows in ((stays, True), (moves, False)):
        estimator = PayloadEstimator(rig, schedule_of(rig))
        heard = volts_of(rig, 2.5, force, np.zeros(count)) + 0.002 * random.standard_normal(count)
        for k in range(0, count, 20):
            found = estimator.advance(heard[k : k + 20], np.zeros(20))
        if knows:
            assert found.std_kg < schedule_of(rig).estimator.largest_std_kg
            assert abs(found.outer_end_mass_kg - 2.5) < 4 * found.std_kg
        else:
            assert found == replace(NOTHING)


def test_when_nothing_moves_nothing_is_learnt(rig: Prototype) -> None:
    estimator, random = PayloadEstimator(rig, schedule_of(rig)), np.random.default_rng(3)
    for _ in range(40):
        found = estimator.advance(0.002 * random.standard_normal(20), np.zeros(20))
    assert found.std_kg > schedule_of(rig).estimator.largest_std_kg


def test_the_payload_of_a_beam_that_is_light_beside_it_is_found(rig: Prototype) -> None:
    """Candidates a tenth of the range below none would take more off the tip than is there."""
    light = rig.but(outer_beam=rig.outer_beam.but(effective_mass_kg=0.5))
    times = np.arange(500) * PERIOD_S
    course = Course(20 * (0.5 - 0.5 * np.cos(np.pi * np.clip((times - 0.02) / 0.01, 0, 1))), ((0.0, 3.0),))
    found = simulate_scheduled(light, course, first_stage=1, noise_V=1e-4)
    assert found.stable
    assert found.column("estimate_kg")[-1] == pytest.approx(3.0, abs=schedule_of(light).estimator.band_kg)


# The switch.


def test_a_stage_is_kept_through_the_overlap_and_left_beyond_it(rig: Prototype) -> None:
    def chosen(stage: int, mass: float, std: float = 0.05, since: float = 1.0) -> int:
        return next_stage(schedule_of(rig), stage, Estimate(mass, std), since)

    low, high = schedule_of(rig).stage[1].outer_end_mass_kg[0], schedule_of(rig).stage[0].outer_end_mass_kg[1]
    middle = (low + high) / 2
    assert (chosen(0, middle), chosen(1, middle)) == (0, 1)
    assert (chosen(0, high), chosen(1, low)) == (1, 0)
    assert chosen(0, 6.8) == 2
    assert chosen(2, -1.0) == 0
    assert chosen(0, 6.8, std=0.2) == 0
    assert chosen(0, 6.8, since=0.05) == 0
    # While the estimate errs by no more than the band, the payload is in the range of the stage that is settled on.
    band = schedule_of(rig).estimator.band_kg
    for mass in np.linspace(0, 6.8, 69):
        for error in (-band, 0.0, band):
            for start in range(3):
                least, most = schedule_of(rig).stage[chosen(start, mass + error)].outer_end_mass_kg
                assert least - 1e-9 <= mass <= most + 1e-9


# The proof.


def switched(*matrices: list[float]) -> tuple[MassFamily, ...]:
    """Second-order systems as stages that do not heed the payload."""
    return tuple(
        MassFamily(fmpq_mat(2, 2, [exact(x) for x in m]), fmpq_mat(2, 2), fmpq(1), 1, ("x", "y")) for m in matrices
    )


BRANICKY = ([-1.0, 10.0, -100.0, -1.0], [-1.0, 100.0, -10.0, -1.0])
"""Two stable systems that some switching makes unstable; Branicky (1998), IEEE Trans. Automatic Control 43, 475, and
Liberzon (2003), Switching in Systems and Control, chapter 2, discuss the like."""


def test_two_stable_systems_that_switching_destabilises_are_proved_for_a_long_dwell_alone() -> None:
    asked = Sought(switched(*BRANICKY), fmpq(0), fmpq(1))
    found, _ = stage_change(asked)
    assert found.kind == "dwell"
    assert found.counterexample is not None
    assert found.counterexample.cycles > 0
    one, two = (np.array(m).reshape(2, 2) for m in BRANICKY)
    first, second = found.counterexample.time_s
    assert max(abs(np.linalg.eigvals(expm(two * second) @ expm(one * first)))) > 1
    assert not found.suffices(0.0)
    assert not found.suffices(first)
    dwell = float(found.dwell_s.p) / float(found.dwell_s.q)
    assert dwell > first
    assert found.suffices(dwell)
    for spent in (dwell, 1.3 * dwell, 2.1 * dwell):
        assert max(abs(np.linalg.eigvals(expm(two * spent) @ expm(one * dwell)))) < 1
    # A shorter dwell, or half of the growth, is not what the functions prove.
    changes = changes_of_stage(asked, found.functions)
    assert grows_beyond(changes, found.factor) == ""
    assert grows_beyond(changes, found.factor / 2)
    assert dwell_suffices(found.dwell_s, found.factor, found.decay_per_s)
    assert not dwell_suffices(found.dwell_s / 2, found.factor, found.decay_per_s)
    for faster, falls in ((1, True), (4, False)):
        each = [replace(asked, families=[one], decay=faster * found.decay_per_s) for one in asked.families]
        assert (not any(map(not_falling, each, found.functions))) is falls


def test_a_schedule_waits_as_long_as_is_proved_to_be_enough(rig: Prototype, proved: Switching) -> None:
    assert kept_apart(rig, proved) is rig
    slow = kept_apart(rig, replace(proved, stages=replace(proved.stages, dwell_s=fmpq(2934, 10000))))
    assert schedule_of(slow).dwell_s == 0.3
    structured = read_prototype(SHIPPED.with_name("structured.toml"))
    assert [len(stage.section) for stage in schedule_of(structured).stage] == [3, 3, 3]
    bandwidths = [
        min(loop(stage.prototype).at(mass).bandwidth_Hz() for mass in stage.outer_end_mass_kg)
        for stage in structured.stages((0.0, 6.8))
    ]
    assert bandwidths[0] > 16.7
    assert bandwidths[1] > 17.9
    assert bandwidths[2] > 19.8


def test_a_stage_that_is_unstable_by_itself_refutes_all() -> None:
    found = switching(switched([-1.0, 0.0, 0.0, -2.0], [0.5, 0.0, 0.0, -1.0]), 0.0, 1.0)
    assert (found.stages.status, found.stages.kind) == ("refuted", "none")
    assert not found.stable
    assert "stage 2" in found.reason
    assert describe(found)[0].startswith("REFUTED")


def test_the_shipped_stages_are_stable_whichever_acts_when(rig: Prototype, proved: Switching) -> None:
    assert (proved.stages.status, proved.stages.kind, proved.stages.dwell_s) == ("proved", "any_time", 0)
    assert proved.stable
    # Known to lie between what is proved and what was not: payload matched and from rest, steady and in jumps.
    assert [rate.rate_kg_per_s >= least for rate, least in zip(proved.rates, (38.0, 26.8), strict=True)] == [True, True]
    assert [float(sudden.dwell_s) for sudden in proved.sudden] == pytest.approx([0.8437, 1.03], rel=1e-2)
    # One of the stages by itself does not bear every course of the payload.
    assert proved.any_change.status == "refuted"
    assert proved.any_change.proved_up_to_kg > 3.5
    families = stage_families(rig)
    asked = Sought(families, LOW, HIGH)
    assert not_falling(asked, proved.stages.functions[0]) == ""
    # V falls along every stage in floats too, at payloads the exact check did not name.
    for mass in (0.7, 3.3, 6.1):
        p = sum(np.array(c.table(), dtype=float) * mass**k for k, c in enumerate(proved.stages.functions[0]))
        scale = 1 / np.sqrt(np.diag(p))
        for family in families:
            a = np.array(family.at(exact(mass)).table(), dtype=float)
            fall = -(a.T @ p + p @ a) * np.outer(scale, scale)
            assert np.linalg.eigvalsh(fall).min() > 0
    # One entry off by a thousandth is refused.
    spoilt = fmpq_mat(proved.stages.functions[0][0])
    spoilt[0, 0] *= fmpq(999, 1000)
    assert not_falling(asked, (spoilt, *proved.stages.functions[0][1:]))


@pytest.mark.parametrize("sections", [0, 2])
def test_stages_in_shared_states_have_the_poles_of_their_loops(rig: Prototype, sections: int) -> None:
    prototype = rig.but(sensor=rig.sensor.but(filter_Hz=400.0))
    law = schedule_of(rig).stage[1].law
    if sections:
        some = (
            Section(zero_Hz=20.0, zero_damping_ratio=0.3, pole_Hz=17.0, pole_damping_ratio=0.5),
            Section(zero_Hz=90.0, zero_damping_ratio=0.7, pole_Hz=160.0, pole_damping_ratio=0.9),
        )
        law = Structured(gain_A_per_V=law.gain_A_per_V, pole_Hz=law.pole_Hz, zero_Hz=law.zero_Hz, section=some)
    whole = prototype.but(controller=law)
    family = stage_family(paper_model(prototype), exact(prototype.payload.inner_end_mass_kg), law)
    assert family.characteristic() == stage_families(whole)[0].characteristic()
    assert family.states[-1] == "current_A"


def test_sections_without_a_filter_are_refused(rig: Prototype) -> None:
    section = Section(zero_Hz=20.0, zero_damping_ratio=0.3, pole_Hz=17.0, pole_damping_ratio=0.5)
    law = Structured(gain_A_per_V=0.1, pole_Hz=1.0, zero_Hz=30.0, section=(section,))
    with pytest.raises(ValueError, match="need a filter before them"):
        stage_family(paper_model(rig), fmpq(1), law)


# Tuning.


def test_the_stretched_member_is_the_plant_at_the_ends_of_all_payloads(rig: Prototype) -> None:
    own, stretched = served(rig, 6.8, ((1.8, 5.0), (0.0, 6.8)))
    beyond = 6.8 + 0.03 * 6.8
    for stage_kg, whole_kg in ((1.8, 0.0), (5.0, beyond)):
        here = stretched.rig.plant(1.5).denominator.at(exact(stage_kg))
        there = own.rig.plant(1.5).denominator.at(exact(whole_kg))
        assert np.allclose([float(c) for c in here.coeffs()], [float(c) for c in there.coeffs()], rtol=1e-12)
    assert stretched.performance is None


def test_every_shipped_stage_keeps_its_goal_and_is_stable_for_all_payloads(rig: Prototype) -> None:
    for stage in rig.stages((0.0, 6.8)):
        low, high = stage.outer_end_mass_kg
        closed = loop(stage.prototype)
        assert all(closed.at(mass).stable for mass in np.linspace(0, 6.8, 18))
        assert max(closed.at(mass).peak_sensitivity() for mass in np.linspace(low, high, 5)) <= 2.0
        assert min(closed.at(mass).bandwidth_Hz() for mass in np.linspace(low, high, 5)) > 5.05


@pytest.fixture
def given(rig: Prototype, monkeypatch: pytest.MonkeyPatch) -> list[LawOptions]:
    """What every stage's tuning is asked for; its answer is the shipped law that is for most of its payloads."""
    every: list[LawOptions] = []

    def tuned(prototype: Prototype, masses: tuple[float, float], asked: LawOptions, told: object) -> Tuning:
        every.append(asked)
        law = min(schedule_of(rig).laws, key=lambda one: abs(sum(one[1]) - sum(masses)))[0]
        found = prototype.but(controller=law, payload=rig.payload.but(outer_end_mass_kg=masses))
        reached = certify(found, *masses).guaranteed
        assert reached is not None
        inside = rig.payload.inner_end_mass_kg
        best = Proved(law, inside, reached.bandwidth_Hz, reached.peak_sensitivity, np.zeros(0))
        return Tuning(found, masses, best, (best.bandwidth_Hz,), 1)

    monkeypatch.setattr(tuning, "tune_law", tuned)
    return every


def test_stages_are_tuned_for_the_same_tolerances_and_their_changes_proved(
    rig: Prototype, proved: Switching, given: list[LawOptions], monkeypatch: pytest.MonkeyPatch
) -> None:
    bare = rig.but(controller=None, tolerance=rig.tolerance.but(flow_gain=0.05))
    monkeypatch.setattr(tuning, "switching", lambda families, *masses, **more: proved)  # of the shipped stages
    found = tune(bare, (0.0, 6.8), "scheduled", sigmas=1.0, stages=3)
    assert all(one.stable_kg == (0.0, 6.8) for one in given)
    assert all(
        one.spread is not None and one.spread.deviations == rig_spread(bare, 6.8, 1.0).deviations for one in given
    )
    assert len(given) == len(found.laws) == 3  # one mass inside: nothing more is tried
    assert [stage.prototype.controller for stage in found.stages] == [law for law, _ in schedule_of(rig).laws]
    assert found.switching is not None
    assert found.switching.stages is proved.stages


@pytest.mark.usefixtures("no_pictures")
def test_a_study_is_carried_to_several_laws(rig: Prototype, given: list[LawOptions], tmp_path: Path) -> None:
    study = tomllib.loads((ROOT / "studies/prototype.toml").read_text(encoding="utf-8"))
    study["controller"] = {"kind": "scheduled", "stages": 2}
    study["payload"]["outer_end_mass_kg"] = [0.0, 3.0]
    study["sections"]["choose"] = "fixed"
    (tmp_path / "study.toml").write_text(tomli_w.dumps(study))
    out, told = tmp_path / "out", tmp_path / "run.json"
    asked = ["run", str(tmp_path / "study.toml"), "--nominal", "--out", str(out), "--json", str(told)]
    done = CliRunner().invoke(app, asked)
    assert done.exit_code == 0, done.output
    fields = json.loads(told.read_text())
    designed = read_prototype(out / "prototype.toml")
    assert [stage.outer_end_mass_kg for stage in schedule_of(designed).stage] == [(0.0, 2.0), (1.0, 3.0)]
    for number, one in enumerate(schedule_of(designed).stage, start=1):
        text = out / f"certificate.stage_{number}.toml"
        assert check(text).valid
        assert one.outer_end_mass_kg in [tuple(each["outer_end_mass_kg"]) for each in fields["stages"]]
        assert f"stage {number}" in (out / f"report.stage_{number}.html").read_text()
    assert check(out / "stages.certificate.toml").valid
    least = min(each["bandwidth_Hz"] for each in fields["stages"])
    assert fields["guaranteed"]["bandwidth_Hz"] == least
    assert (out / fields["guaranteed"]["certificate"]) == Path(fields["certificate"])


def test_ranges_overlap() -> None:
    assert stage_ranges((0.0, 6.0), 2, 1.0) == [(0.0, 3.5), (2.5, 6.0)]
    light = [bound for part in stage_ranges((0.0, 0.006), 2, 0.001) for bound in part]  # in whole grams it was 3 and 4
    assert light == pytest.approx([0.0, 0.0035, 0.0025, 0.006])


@pytest.mark.parametrize(("quick", "heavy"), [(1.0, 1.0), (8.0, 8.0**-3), (1 / 64, 512.0), (1e4, 1e-3)])
def test_the_usual_estimator_goes_with_the_rig(quick: float, heavy: float) -> None:
    """As `similar` of the keys' units, as far as an estimator may have such times."""
    usual, given = Estimator.usual(quick, heavy), similar(Estimator(), (heavy, 1.0, 1 / quick))
    assert (usual.band_kg, usual.largest_std_kg) == pytest.approx((given.band_kg, given.largest_std_kg))
    assert usual.window_s == pytest.approx(min(max(given.window_s, 1e-4), 2.0))
    assert usual.update_s == pytest.approx(min(max(given.update_s, 1e-5), 1.0))


# In time.


@pytest.mark.parametrize("name", ["prototype", "structured"])
def test_a_stage_that_stays_is_its_sampled_law(name: str) -> None:
    rig = read_prototype(SHIPPED.with_name(f"{name}.toml"))
    period_s, count = schedule_of(rig).period_s, round(0.2 / schedule_of(rig).period_s) + 1
    course = Course(
        20 * (0.5 - 0.5 * np.cos(np.pi * np.clip((np.arange(count) * period_s - 0.02) / 0.01, 0, 1))), ((0.0, 2.0),)
    )
    found = simulate_scheduled(rig, course, first_stage=1, adaptive=False)
    row = ScenarioRecord(name="a", input=(Step(amplitude_N=20.0, at_s=0.02, rise_s=0.01),), outer_end_mass_kg=2.0)
    plan = Scenario(name="a", duration_s=0.2, sample_s=period_s, record=(row,), sampled=Sampled(period_s=period_s))
    usual = simulate(rig.stages((0.0, 6.8))[1][0], plan).records[0]
    assert found.stable
    assert len(found.samples) == count
    for name in ("displacement_m", "current_A"):
        expected = usual.column(name)
        assert np.abs(found.column(name) - expected).max() < 1e-6 * np.abs(expected).max()


def test_a_stage_behind_a_wide_open_valve_is_its_sampled_law_too(rig: Prototype) -> None:
    """Steps that suit the rig at rest had the tip pass 50 mm, at 200 times the supply pressure."""
    real = rig.but(effects={"pressure_dependent_flow": {}})
    push, joins = Step(amplitude_N=3000.0, at_s=0.01), 30.0
    row = ScenarioRecord(name="a", input=(push,), outer_end_mass_kg=joins)
    plan = Scenario(name="a", duration_s=0.15, sample_s=5e-4, displacement_limit_m=0.05, record=(row,))
    usual = simulate(real.stages((0.0, 6.8))[0][0], plan.but(sampled=Sampled(period_s=5e-4))).records[0]
    course = Course(inputs_of(row, plan)[:, 0], ((0.0, joins),), before_N=0.0)
    found = simulate_scheduled(real, course, adaptive=False, limit_m=0.05)
    assert len(found.samples) == 301
    for name in ("displacement_m", "load_pressure_Pa"):
        expected = usual.column(name)
        assert np.abs(found.column(name) - expected).max() < 0.02 * np.abs(expected).max()


def test_a_stage_goes_on_from_what_the_one_before_gave() -> None:
    """Beside the equations of `beamdesign.proofs.mass_family`, whose states a change of stage leaves as they are."""
    one, other, _ = schedule_of(read_prototype(SHIPPED.with_name("structured.toml"))).stage
    other = other.but(gain_A_per_V=2 * other.gain_A_per_V)
    period_s, turn, changed_s = 1e-5, 2 * np.pi * 30.0, 0.0423

    def rates(t: float, x: np.ndarray, stage: Stage) -> list[float]:
        signal, slope, bent = 1 - np.cos(turn * t), turn * np.sin(turn * t), turn**2 * np.cos(turn * t)
        found = []
        for section, (u, v) in zip(stage.section, x[:-1].reshape(-1, 2), strict=True):
            z, p = 2 * np.pi * section.zero_Hz, 2 * np.pi * section.pole_Hz
            raised = signal + 2 * section.zero_damping_ratio * slope / z + bent / z**2 - u
            bent = p**2 * raised - 2 * section.pole_damping_ratio * p * v
            found += [v, bent]
            signal, slope = u, v
        upper, lower = 2 * np.pi * stage.zero_Hz, 2 * np.pi * stage.pole_Hz
        return [*found, lower * (stage.gain_A_per_V * signal - x[-1]) + stage.gain_A_per_V * lower / upper * slope]

    whole = np.arange(round(0.06 / period_s) + 1) * period_s
    at = round(changed_s / period_s)
    ways = {"method": "DOP853", "rtol": 1e-9, "atol": 1e-12}
    before = solve_ivp(rates, (0, whole[at]), np.zeros(7), args=(one,), t_eval=whole[: at + 1], **ways).y
    after = solve_ivp(rates, (whole[at], whole[-1]), before[:, -1], args=(other,), t_eval=whole[at:], **ways).y
    expected = np.append(before[-1], after[-1, 1:])

    laws, found, passed = [sampled_stage(stage, period_s) for stage in (one, other)], [], np.zeros((2, 5))
    state = np.zeros(laws[0].whole.order)
    for k, t in enumerate(whole):
        if k == at + 1:
            state = laws[1].after(passed)
        state, signals = laws[k > at].step(state, float(1 - np.cos(turn * t)))
        passed = np.vstack([passed[1:], signals])
        found.append(signals[-1])
    assert np.abs(np.array(found) - expected).max() < 5e-3 * np.abs(expected).max()


def test_a_record_starts_at_rest_or_under_its_preload(rig: Prototype) -> None:
    row, began = ScenarioRecord(name="a", preload_N=50.0), {}
    for start in ("rest", "loaded"):
        plan = Scenario(name="a", duration_s=0.02, sample_s=PERIOD_S, start=start, record=(row,))
        began[start] = simulate(rig, plan).records[0].column("displacement_m")[0]
    expected = 50 * loop(rig.stages((0.0, 0.0))[0].prototype).at(0.0).static_compliance()
    assert began["rest"] == 0
    assert began["loaded"] == pytest.approx(expected, rel=1e-6)
    wall = WallAhead(at_m=0.0, stiffness_N_per_m=1e6, damping_N_s_per_m=0.0)
    with pytest.raises(InputError) as caught:
        simulate(rig, Scenario(name="a", duration_s=0.02, sample_s=PERIOD_S, record=(row.but(wall=wall),)))
    assert [problem.key for problem in caught.value.problems] == ["record.a.wall"]


def test_a_payload_that_is_gripped_is_noticed_at_the_next_load_step(rig: Prototype) -> None:
    effects: dict[str, dict[str, float]] = {"current_saturation": {}, "pressure_dependent_flow": {}}
    times = np.arange(1600) * PERIOD_S
    force = np.where(times < 0.1, 0.0, 40.0) - np.where(times < 0.45, 0.0, 40.0)
    course = Course(force, ((0.0, 0.0), (0.4, 6.8)), "from_rest")
    found = simulate_scheduled(rig, course, rig.but(effects=effects), noise_V=0.002)
    assert found.stable
    (at, stage), *rest = found.changes
    assert stage == 3
    assert not rest
    assert 0.45 < at < 0.45 + 0.15
    assert found.column("estimate_kg")[-1] == pytest.approx(6.8, abs=schedule_of(rig).estimator.band_kg)
    still = simulate_scheduled(rig, course, rig.but(effects=effects), adaptive=False, noise_V=0.002)
    assert set(still.column("stage")) == {1.0}


# The record and the commands.


def test_the_record_is_read_back_as_written(rig: Prototype, tmp_path: Path) -> None:
    write_prototype(rig, tmp_path / "again.toml")
    assert read_prototype(tmp_path / "again.toml") == rig


def test_what_is_wrong_with_a_schedule_is_told_at_once(rig: Prototype, tmp_path: Path) -> None:
    path = tmp_path / "wrong.toml"
    write_prototype(rig, path)
    text = path.read_text(encoding="utf-8").replace("4.033", "4.9").replace("6.8,", "9.0,", 1)
    path.write_text(text.replace("stiffness_N_per_m", "stiffness_N_per_mm", 1), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_prototype(path)
    told = str(caught.value)
    assert "stages 2 and 3 overlap by 0.133 kg" in told
    assert "stiffness" in told
    with pytest.raises(ValueError, match="must begin and end above"):
        Scheduled(stage=schedule_of(rig).stage[::-1], estimator=Estimator())


@pytest.mark.parametrize(
    ("figures", "key"),
    [
        ({"update_s": 0.16}, "update_s"),  # more than a window
        ({"window_s": 5e-3, "update_s": 1e-3}, "period_s"),  # of ten samples, which any payload explains
        ({"update_s": 4e-4}, "period_s"),  # without a sample
    ],
)
def test_an_estimator_that_has_too_few_samples_is_refused(rig: Prototype, figures: dict[str, float], key: str) -> None:
    """As it stands in a file, and as it is made."""
    with pytest.raises(ValueError, match=rf"{key}\n.*must be at most"):
        schedule_of(rig).but(estimator=Estimator(**figures))
    table = schedule_of(rig).model_dump() | {"estimator": figures}
    with pytest.raises(ValueError, match=rf"{key}\n.*must be at most"):
        Scheduled(**table)
    enough = Estimator(update_s=4e-4)
    assert sampling_period_s(schedule_of(rig).stage, enough) <= enough.longest_period_s


def test_laws_for_a_rig_with_effects_are_each_certified_between_their_members(
    rig: Prototype, given: list[LawOptions], tmp_path: Path
) -> None:
    """Friction that slides or sticks: what is between is asked of each law over its own payloads."""
    write_prototype(rig.but(controller=None, effects={"seal_friction": {}}), tmp_path / "worn.toml")
    arguments = ["tune", str(tmp_path / "worn.toml"), "--controller", "scheduled", "--stages", "3", "--nominal"]
    done = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert "the prototype has effects" in done.output
    for stage in (1, 2, 3):
        between = tmp_path / "out" / f"certificate.stage_{stage}.between.toml"
        assert check(between).valid
    assert len(given) == 3


def test_structured_stages_are_held_to_what_a_valve_bears_as_one_structured_law_is() -> None:
    """Stages are structured where the prototype's own laws are, by itself or in its stages; lags keep it by form."""
    bare = read_prototype(SHIPPED).but(goal=Goal())
    quick = read_prototype(ROOT / "studies/scheduled/structured.toml").controller
    fixed = read_prototype(ROOT / "studies/prototypes/structured.toml").controller
    held = {"loop_gain": 0.25, "controller_effort_A_per_V": 0.06}
    for kind, own, expected in (
        ("structured", None, held), ("scheduled", quick, held), ("scheduled", fixed, held),
        ("scheduled", bare.controller, {}), ("scheduled", None, {}), ("lag", quick, {}),
    ):  # fmt: skip
        found = limited(bare.but(controller=own), kind).goal
        assert {name: value for name in held if (value := getattr(found, name)) is not None} == expected


def test_the_governing_stage_is_one_of_which_nothing_is_proved() -> None:
    """A stage without a bandwidth comes before one that has some."""
    found = [({"guaranteed": {"bandwidth_Hz": each}}, True) for each in (3.1, None)]
    answer = of_all(read_prototype(SHIPPED), found)
    assert answer["guaranteed"]["bandwidth_Hz"] is None
    assert len(answer["stages"]) == 2


def test_a_record_that_is_too_short_for_the_period_of_a_schedule_is_told(rig: Prototype) -> None:
    slow = rig.but(controller=schedule_of(rig).but(period_s=1e-3))
    with pytest.raises(InputError) as told:
        simulate(slow, Scenario(name="short", duration_s=0.006, record=(ScenarioRecord(name="a"),)))
    assert [problem.key for problem in told.value.problems] == ["duration_s"]


def test_commands_say_what_they_cannot_do(tmp_path: Path) -> None:
    remedy = str(ROOT / "studies/prototypes/paper_remedy.toml")
    for arguments, told in (
        (["tune", remedy, "--controller", "scheduled", "--outer-end-mass", "2:2"], "which needs no stages"),
        (["tune", remedy, "--controller", "scheduled", "--stages", "9"], "leave no room for overlaps"),
    ):
        done = CliRunner().invoke(app, arguments)
        assert isinstance(done.exception, InputError)
        assert told in str(done.exception)


@pytest.mark.parametrize("stages", [0, 1, 13])
def test_so_many_laws_as_no_schedule_has_are_refused_before_any_is_tuned(rig: Prototype, stages: int) -> None:
    with pytest.raises(InputError, match=rf"stages: must be 2 to 12, is {stages}"):
        tune(rig, (0.0, 6.8), "scheduled", stages=stages)


def test_every_law_is_certified_over_its_own_payloads(tmp_path: Path) -> None:
    out, answer = tmp_path / "c.toml", tmp_path / "answer.json"
    arguments = ["certify", str(SHIPPED), "--outer-end-mass", "1:4.5", "--out", str(out), "--json", str(answer)]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    found = json.loads(answer.read_text())
    ranges = [stage["outer_end_mass_kg"] for stage in found["stages"]]
    assert ranges == [[1.0, 2.767], [1.767, 4.5], [4.033, 4.5]]
    bandwidths = [stage["guaranteed"]["bandwidth_Hz"] for stage in found["stages"]]
    assert found["guaranteed"]["bandwidth_Hz"] == min(bandwidths)
    # The loop of each law by itself, in floats, is what is guaranteed.
    for stage, bandwidth in zip(read_prototype(SHIPPED).stages((1.0, 4.5)), bandwidths, strict=True):
        closed = loop(stage.prototype)
        reached = [closed.at(float(mass)).bandwidth_Hz() for mass in np.linspace(*stage.outer_end_mass_kg, 5)]
        assert bandwidth == pytest.approx(min(reached), rel=1e-3)
    second = tmp_path / "c.stage_2.toml"
    assert found["stages"][1]["certificate"] == str(second)
    for prototype, its in ((SHIPPED, True), (SHIPPED.with_name("structured.toml"), False)):
        assert check(second, prototype).valid is its
    beyond = CliRunner().invoke(app, ["certify", str(SHIPPED), "--outer-end-mass", "1:7"])
    assert isinstance(beyond.exception, InputError)
    assert [problem.key for problem in beyond.exception.problems] == ["payload.outer_end_mass_kg"]


def test_a_payload_that_no_law_is_for_is_refused(rig: Prototype, tmp_path: Path) -> None:
    path = tmp_path / "wide.toml"
    write_prototype(rig, path)
    head, payload, rest = path.read_text(encoding="utf-8").partition("[payload]\n")
    path.write_text(head + payload + rest.replace("6.8,", "9.0,", 1), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_prototype(path)
    assert [problem.key for problem in caught.value.problems] == ["payload.outer_end_mass_kg"]


def test_what_one_law_has_is_refused_of_several(rig: Prototype) -> None:
    assert rig.controller is not None
    own = (lambda law: law.gain_A_per_V, lambda law: law.sensed_law(), lambda law: law.equations)
    for ask in (*own, lambda law: critical_gain(rig.but(controller=law), 3.0)):
        with pytest.raises(InputError) as caught:
            ask(rig.controller)
        assert [problem.key for problem in caught.value.problems] == ["controller.kind"]


@pytest.mark.parametrize("sample_s", [PERIOD_S, 0.8e-3])
def test_a_record_is_predicted_as_it_is_simulated(rig: Prototype, sample_s: float) -> None:
    times = np.arange(round(0.2 / sample_s)) * sample_s

    def force(at: np.ndarray) -> np.ndarray:
        return 20 * (0.5 - 0.5 * np.cos(np.pi * np.clip((at - 0.02) / 0.02, 0, 1)))

    inputs = np.column_stack([force(times), 0 * times])
    given = TimeRecord("a", times, inputs, {}, 6.0, rig.payload.inner_end_mass_kg, rig.controller)
    found = predict_record(rig, given, rig.sensor.gain_V_per_m)
    assert found.reason == ""
    own = np.arange(401) * PERIOD_S
    expected = simulate_scheduled(rig, Course(force(own), ((0.0, 6.0),)), first_stage=2)
    assert not expected.changes
    moved = np.interp(times, expected.column("t_s"), expected.column("displacement_m"))
    assert np.abs(found.samples[:, 2] - moved).max() < 0.02 * np.abs(moved).max()


GRIPPING = """
name = "gripping"
duration_s = 0.5
[[record]]
name = "grip"
[record.payload_change]
at_s = 0.1
outer_end_mass_kg = 6.8
[[record.input]]
kind = "step"
amplitude_N = 40.0
at_s = 0.2
"""


@pytest.mark.parametrize("at_s", [0.1, 0.1037])
def test_a_payload_changes_when_it_is_told_to(rig: Prototype, at_s: float) -> None:
    """From rest under no force the tip's first acceleration is force over mass, so that it tells the mass at once."""
    change = PayloadChange(at_s=at_s, outer_end_mass_kg=6.8)
    pushed = Step(amplitude_N=40.0, at_s=at_s + 5e-4, rise_s=1e-3)
    row = ScenarioRecord(name="grip", input=(pushed,), payload_change=change)
    found, heavy = (
        simulate(rig.but(sensor=rig.sensor.but(noise_V=None)), Scenario(name="s", duration_s=0.2, record=(one,)))
        for one in (row, row.but(payload_change=None, outer_end_mass_kg=6.8))
    )
    (record,), (other,) = found.records, heavy.records
    masses = record.column("outer_end_mass_kg")
    assert record.column("t_s")[np.argmax(masses > 0)] == pytest.approx(np.ceil(at_s / 5e-4 - 1e-9) * 5e-4)
    soon = (record.column("t_s") > at_s) & (record.column("t_s") < at_s + 4e-3)
    moved, expected = (one.column("displacement_m")[soon] for one in (record, other))
    np.testing.assert_allclose(moved, expected, atol=0.02 * np.abs(expected).max())
    late = row.but(payload_change=change.but(at_s=0.2))
    with pytest.raises(InputError, match="where the record ends"):
        simulate(rig, Scenario(name="s", duration_s=0.2, record=(late,)))


def kept_of_its_speed(fine: Prototype) -> float:
    """Share of its speed that the tip keeps where 6.8 kg join it from rest."""
    change = PayloadChange(at_s=0.0535, outer_end_mass_kg=6.8, joining="from_rest")
    row = ScenarioRecord(name="grip", input=(Step(amplitude_N=800.0, at_s=0.045, rise_s=0.01),), payload_change=change)
    (record,) = simulate(fine, Scenario(name="s", duration_s=0.06, sample_s=5e-5, record=(row,))).records
    at, x = int(np.argmax(record.column("outer_end_mass_kg") > 0)), record.column("displacement_m")
    slope = np.array([11 / 6, -3, 3 / 2, -1 / 3])  # of a cubic, at its end
    return float(-(slope @ x[at : at + 4]) / (slope @ x[at : at - 4 : -1]))


@pytest.mark.parametrize("offset_m", [(0.0, 0.4, 0.0), (0.2, 0.4, 0.0), (0.2, 0.0, 0.3)])
def test_a_payload_off_the_axis_that_joins_at_rest_takes_its_momentum_where_it_is(
    rig: Prototype, offset_m: tuple[float, float, float]
) -> None:
    """Momentum of tip and roll is kept: with T = m ((k u' + e r')^2 + (l u')^2) / 2 more, and no roll before."""
    arm = Arm(offset_m=offset_m, plane="z", torsional_stiffness_N_m_per_rad=5e4, end_polar_inertia_kg_m2=0.2)
    beam = rig.outer_beam.but(free_length_m=1.0)
    fine = rig.but(controller=schedule_of(rig).but(period_s=5e-5), outer_beam=beam, arm=arm)
    along, sideways, upwards = offset_m
    travel, lever, swings = (
        1 + 1.5 * along,
        sideways,
        1.5 * upwards,
    )  # of a cantilever of 1 m, slope 3 / (2 L) per travel
    momenta = np.array([[travel**2 + swings**2, travel * lever], [travel * lever, lever**2]])
    inertia = lever_figures(fine)["polar_inertia"]
    speeds = np.linalg.solve(
        np.diag([figures(fine)["outer_mass"], inertia]) + 6.8 * momenta, [figures(fine)["outer_mass"], 0]
    )
    assert kept_of_its_speed(fine) == pytest.approx(speeds[0], rel=2e-3)


@pytest.mark.parametrize("frequency_Hz", [70.0, None])
def test_a_payload_that_joins_at_rest_takes_its_momentum_from_every_mode(
    rig: Prototype, frequency_Hz: float | None
) -> None:
    """A blow P at the tip gives mode k the speed P / m_k: the tip keeps 1 / (1 + m (1/m_1 + 1/m_2)) of its speed."""
    mode = {"frequency_Hz": frequency_Hz, "compliance_share": 0.3, "damping_ratio": 0.02}
    fine = rig.but(
        controller=schedule_of(rig).but(period_s=5e-5),
        effects={"second_beam_mode": mode} if frequency_Hz else {},
    )
    given = figures(fine)
    yields = 1 / given["outer_mass"]
    if frequency_Hz:
        yields += 0.3 * (2 * np.pi * frequency_Hz) ** 2 / given["outer_stiffness"]
    assert kept_of_its_speed(fine) == pytest.approx(1 / (1 + 6.8 * yields), rel=1e-3)


def test_simulate_takes_a_schedule_and_no_other_a_payload_that_changes(tmp_path: Path) -> None:
    plan, answer = tmp_path / "plan.toml", tmp_path / "answer.json"
    plan.write_text(GRIPPING, encoding="utf-8")
    common = ["--scenario", str(plan), "--out", str(tmp_path / "out"), "--no-plots", "--json", str(answer)]
    done = CliRunner().invoke(app, ["simulate", str(SHIPPED), *common])
    assert done.exit_code == 0, done.output
    assert "1 -> 3" in done.output
    (record,) = json.loads(answer.read_text())["each"]
    assert [change["stage"] for change in record["changes"]] == [3]
    table = np.genfromtxt(tmp_path / "out" / "grip.csv", delimiter=",", names=True)
    assert set(table["outer_end_mass_kg"]) == {0.0, 6.8}
    lag = str(ROOT / "studies/prototypes/tame_lag.toml")
    light = read_prototype(SHIPPED).stages((0.0, 0.0))[0].prototype.controller
    assert light is not None
    fixed = f'[[record]]\nname = "fixed"\n[record.controller]\n{tomli_w.dumps(light.model_dump(exclude_none=True))}'
    plan.write_text(GRIPPING + fixed, encoding="utf-8")  # one more, in which one law stays
    assert CliRunner().invoke(app, ["simulate", str(SHIPPED), *common]).exit_code == 0
    assert [("changes" in one) for one in json.loads(answer.read_text())["each"]] == [True, False]
    heads = [(tmp_path / "out" / f"{name}.csv").read_text().partition("\n")[0] for name in ("grip", "fixed")]
    assert ["stage" in head for head in heads] == [True, False]
    plan.write_text(GRIPPING, encoding="utf-8")
    refused = CliRunner().invoke(app, ["simulate", lag, *common])
    assert "record.grip.payload_change: is for a scheduled controller" in str(refused.exception)
    plan.write_text(GRIPPING.replace("duration_s", "sample_s = 0.001\nduration_s"), encoding="utf-8")
    refused = CliRunner().invoke(app, ["simulate", str(SHIPPED), *common])
    assert "must be the period of the scheduled controller, 0.0005, is 0.001" in str(refused.exception)


def test_an_estimate_that_the_schedule_does_not_act_on_is_told_as_that(tmp_path: Path) -> None:
    """Under a force that moves all the time 7.48 kg, give or take 0.29, were told of no payload."""
    common = ["--scenario", str(ROOT / "studies/scenarios/gripper_arm.toml"), "--out", str(tmp_path), "--no-plots"]
    done = CliRunner().invoke(app, ["simulate", str(SHIPPED), *common])
    assert done.exit_code == 0, done.output
    (pushed, commanded) = (
        " ".join(done.output.split()).partition(f"{name}: stages 1; ")[2] for name in ("push", "command")
    )
    assert pushed.startswith("of the payload it knows too little to act on (")
    assert commanded.startswith("of the payload it knows 2.03 kg, give or take")
    table = np.genfromtxt(tmp_path / "push.csv", delimiter=",", names=True)
    last = table[-1]
    assert last["estimate_std_kg"] > schedule_of(read_prototype(SHIPPED)).estimator.largest_std_kg
    assert set(table["outer_end_mass_kg"]) == {0.0}
    assert last["estimate_kg"] > 10 * last["estimate_std_kg"]  # of 0 kg


@pytest.mark.parametrize(("name", "period_s"), [("prototype", 0.5e-3), ("structured", 0.2e-3)])
def test_shipped_schedules_are_sampled_as_their_laws_ask(name: str, period_s: float, tmp_path: Path) -> None:
    """A quarter of the highest break's period at most; a scenario that states no period takes theirs."""
    rig, plan = read_prototype(SHIPPED.parent / f"{name}.toml"), tmp_path / "kick.toml"
    assert schedule_of(rig).period_s == sampling_period_s(schedule_of(rig).stage, Estimator()) == period_s
    plan.write_text('name = "kick"\nduration_s = 0.05\n[[record]]\nname = "one"\ninput = []\n', encoding="utf-8")
    (record,) = simulate(rig, read_scenario(plan)).records
    assert record.stable
    assert np.diff(record.column("t_s")) == pytest.approx(period_s)


def test_a_rate_is_left_open_where_the_stage_may_not_change_at_any_time() -> None:
    """Of a screw whose second law has fifteen times the gain of the first."""
    stages = (
        Stage(outer_end_mass_kg=masses, gain_A_per_V=gain, pole_Hz=1.2, zero_Hz=18.0)
        for masses, gain in (((0.0, 2.0), 600.0), ((1.0, 3.0), 9000.0))
    )
    payload = Payload(inner_end_mass_kg=2.0, outer_end_mass_kg=(0.0, 3.0))
    rig = screw().but(controller=Scheduled(stage=tuple(stages), dwell_s=1.0), payload=payload)
    asked, unasked = certify_switching(rig, rate_kg_per_s=1.0), certify_switching(rig)
    assert asked.stages.kind == unasked.stages.kind == "dwell"
    assert (asked.yes, unasked.yes) == (False, True)
    for found, told in ((asked, True), (unasked, False)):
        assert any("|dm/dt| up to 1 kg/s" in line for line in describe(found)) is told
        assert ("|dm/dt| up to 1 kg/s" in found.reason) is told


def test_certify_switching_takes_a_schedule(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A narrow range is quickly proved.
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(
        app, ["certify-switching", str(SHIPPED), "--outer-end-mass", "2:3", "--rate", "3", "--json", "answer.json"]
    )
    assert done.exit_code == 0, done.output
    assert "stable whichever stage acts when" in done.output
    answer = json.loads((tmp_path / "answer.json").read_text())
    assert answer["at_any_time"] is True
    assert all(rate["unlimited"] or rate["rate_kg_per_s"] == 3.0 for rate in answer["bounded_rate"])
    assert check(tmp_path / "prototype.stages.toml", SHIPPED).valid
