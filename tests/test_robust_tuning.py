"""Tuning for a whole box of rigs: what is proved of all of them, and what independent numerics find of its corners."""

import json
import tomllib
from dataclasses import dataclass
from itertools import product
from math import pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from delivered_bandwidth import delivered, drawn
from forging import resealed
from one_start import best_start_alone, least_effort
from rig_of_certificate import members as members_of
from typer.testing import CliRunner

from beamdesign import (
    InputError,
    Prototype,
    certify,
    check,
    read_problem,
    read_prototype,
    run_design,
    tune,
    write_prototype,
)
from beamdesign.build.result_folder import statements
from beamdesign.cli import app
from beamdesign.controllers import Lag
from beamdesign.parameters import TYPICAL, stated_or_typical
from beamdesign.plant.actuators import KINDS
from beamdesign.polynomial import nearest
from beamdesign.proofs.box_claims import claim_over_box, worst_over_box
from beamdesign.proofs.certificate import Asked
from beamdesign.proofs.tolerance_box import tolerance_box
from beamdesign.prototype import Tolerance
from beamdesign.quantities import rigs_in_words
from beamdesign.synthesis import design_run, tuning
from beamdesign.synthesis.law_design import forbidden_shares
from beamdesign.synthesis.rig_spread import rig_spread
from beamdesign.synthesis.tuning import LawOptions, Tuning, tune_law

pytestmark = pytest.mark.long

PAPER = Path(__file__).parent.parent / "studies" / "prototypes" / "paper_remedy.toml"
STUDY = PAPER.parents[1] / "prototype.toml"
MASSES_KG = (0.0, 1.0)
SIGMAS = 2.0
LOWER_GAINS = np.geomspace(0.003, 0.97, 10)
SEEN_HZ = np.concatenate([np.geomspace(0.05, 15.0, 60), np.geomspace(15.0, 60.0, 160), np.geomspace(60.0, 1000.0, 60)])


@pytest.fixture(scope="module")
def rig() -> Prototype:
    """The published rig with tolerances of some per cent, that of the mass inside too; its loop gain is limited."""
    record = read_prototype(PAPER)
    tolerance = Tolerance(
        stiffness=0.02,
        effective_mass=0.02,
        beam_damping_ratio=0.15,
        oil_stiffness=0.1,
        flow_gain=0.05,
        valve_natural_frequency=0.05,
        inner_end_mass=0.05,
    )
    return record.but(tolerance=tolerance, goal=record.goal.but(loop_gain=0.25), controller=None)


@pytest.fixture(scope="module")
def nominal(rig: Prototype) -> Tuning:
    with best_start_alone():
        return tune(rig, MASSES_KG, sigmas=0.0)


@pytest.fixture(scope="module")
def robust(rig: Prototype, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What the command writes of a lag, and the folder it writes to."""
    folder = tmp_path_factory.mktemp("robust")
    write_prototype(rig, folder / "rig.toml")
    command = ["tune", str(folder / "rig.toml"), "--outer-end-mass", "0:1", "--out", str(folder / "out")]
    with least_effort():
        done = CliRunner().invoke(app, [*command, "--json", str(folder / "found.json")])
    assert done.exit_code == 0, done.output
    return json.loads((folder / "found.json").read_text()) | {"folder": folder / "out", "output": done.output}


# What independent numerics find of the members: equations (7) to (18) of Zalucky and Hardt (1984), many rigs at once.


@dataclass(frozen=True)
class Seen:
    """What dense numerics say of many rigs, each an array over them.

    Attributes:
        slowest: largest real part of a pole over masses, and gains where they are lowered.
        peak: largest |S|.
        compliance: largest |x / F_d| up to a bandwidth.
    """

    slowest: np.ndarray
    peak: np.ndarray
    compliance: np.ndarray


FIGURES = (
    "outer K",
    "outer M",
    "outer b",
    "inner K",
    "inner M",
    "inner b",
    "oil",
    "flow gain",
    "valve frequency",
    "end mass",
)


def members(rig: Prototype, shares: np.ndarray) -> np.ndarray:
    """(rigs, 10) figures at shares (rigs, 10) of their ranges; a dashpot's range is that of 2 zeta sqrt(K M)."""
    off, valve = rig.tolerance, rig.servovalve

    def ends(value: float, deviation: float) -> tuple[float, float]:
        return value * (1 - SIGMAS * deviation), value * (1 + SIGMAS * deviation)

    rows = []
    for beam in (rig.outer_beam, rig.inner_beam):
        assert beam.stiffness_N_per_m is not None
        assert beam.effective_mass_kg is not None
        stiffness = ends(beam.stiffness_N_per_m, off.stiffness)
        mass = ends(beam.effective_mass_kg, off.effective_mass)
        ratio = ends(beam.damping_ratio, off.beam_damping_ratio)
        dashpot = [2 * z * sqrt(k * m) for z, k, m in zip(ratio, stiffness, mass, strict=True)]
        rows += [stiffness, mass, tuple(dashpot)]
    rows.append(ends(rig.actuator.oil_stiffness_N_per_m, off.oil_stiffness))
    rows.append(ends(valve.flow_gain_m3_per_s_per_A, off.flow_gain))
    rows.append(ends(2 * pi * valve.natural_frequency_Hz, off.valve_natural_frequency))
    rows.append(ends(rig.payload.inner_end_mass_kg, off.inner_end_mass))
    low, high = np.array(rows).T
    return np.asarray(low + (high - low) * shares)


def matrices(rig: Prototype, figures: np.ndarray, added_kg: float, gain: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """A (rigs, 8, 8) and B (rigs, 8, 2) of the closed loop, its gain times a factor; inputs are force and command."""
    stiffness, mass, damping, inner_stiffness, inner_mass, inner_damping, oil, flow, w, end_mass = figures.T
    law, valve, area = rig.controller, rig.servovalve, rig.actuator.piston_area_m2
    assert isinstance(law, Lag)
    x, v, c, z, u, q, r, h = range(8)  # tip, its speed, cylinder, rod, its speed, flow, its rate, controller
    a, b = np.zeros((len(w), 8, 8)), np.zeros((len(w), 8, 2))
    total, moved = mass + added_kg, inner_mass + end_mass
    a[:, x, v] = a[:, z, u] = a[:, q, r] = a[:, c, u] = 1.0
    a[:, v, x], a[:, v, v], a[:, v, c] = -(stiffness + oil) / total, -damping / total, oil / total
    b[:, v, 0] = 1 / total
    a[:, u, x], a[:, u, c] = oil / moved, -oil / moved
    a[:, u, z], a[:, u, u] = -inner_stiffness / moved, -inner_damping / moved
    leak = valve.leakage_m3_per_s_per_Pa * oil / area**2
    a[:, c, q], a[:, c, c], a[:, c, x] = 1 / area, -leak, leak
    pole, ratio = 2 * pi * law.pole_Hz, law.pole_Hz / law.zero_Hz
    a[:, h, x], a[:, h, h], b[:, h, 1] = -pole * rig.sensor.gain_V_per_m, -pole, pole
    drive = w**2 * flow * law.gain_A_per_V * gain
    a[:, r, q], a[:, r, r] = -(w**2), -2 * valve.damping_ratio * w
    a[:, r, x] = -drive * ratio * rig.sensor.gain_V_per_m
    a[:, r, h], b[:, r, 1] = drive * (1 - ratio), drive * ratio
    return a, b


def seen(rig: Prototype, figures: np.ndarray, masses: np.ndarray, bandwidth_Hz: float) -> Seen:
    """Poles, sensitivity and compliance of rigs with a law; the first two of all masses as well."""
    frequency = np.append(SEEN_HZ, bandwidth_Hz)
    count = len(figures)
    slowest, peak, compliance = np.full(count, -np.inf), np.zeros(count), np.zeros(count)
    for mass in masses:
        a, b = matrices(rig, figures, float(mass))
        slowest = np.maximum(slowest, np.linalg.eigvals(a).real.max(axis=1))
        for one in frequency:
            motion = np.linalg.solve(2j * pi * one * np.eye(8) - a, b)[:, 0]
            peak = np.maximum(peak, np.abs(1.0 - rig.sensor.gain_V_per_m * motion[:, 1]))
            if one <= bandwidth_Hz:
                compliance = np.maximum(compliance, np.abs(motion[:, 0]))
    return Seen(slowest, peak, compliance)


def corners_and_others(rig: Prototype, corners: int = 200, others: int = 100) -> np.ndarray:
    """Corners of the box and rigs within it, drawn at random."""
    random = np.random.default_rng(1984)
    every = np.array(list(product((0.0, 1.0), repeat=len(FIGURES))))
    chosen = every[random.choice(len(every), corners, replace=False)]
    return members(rig, np.vstack([chosen, random.random((others, len(FIGURES)))]))


def test_every_rig_that_is_looked_at_keeps_what_is_guaranteed(robust: dict[str, Any]) -> None:
    built = read_prototype(robust["folder"] / "prototype.toml")
    guaranteed, rigs = robust["guaranteed"], corners_and_others(built)
    masses = np.linspace(*MASSES_KG, 5)
    found = seen(built, rigs, masses, guaranteed["bandwidth_Hz"])
    assert built.payload.inner_end_mass_kg > 0  # a tenth to either side
    assert found.slowest.max() < 0
    assert found.peak.max() <= guaranteed["peak_sensitivity"] <= built.goal.peak_sensitivity
    assert found.compliance.max() <= built.goal.compliance_m_per_N
    for mass in masses:
        for gain in LOWER_GAINS:
            a, _ = matrices(built, rigs, float(mass), float(gain))
            assert np.linalg.eigvals(a).real.max() < 0


def test_a_nominal_design_fails_on_some_corner(rig: Prototype, nominal: Tuning, robust: dict[str, Any]) -> None:
    """It promises more than the robust one does of all rigs, and keeps that of the nominal one alone."""
    assert nominal.best is not None
    assert nominal.best.over_box is None
    assert nominal.best.guaranteed(nominal.prototype, MASSES_KG)["rigs"] == "nominal"
    assert nominal.best.bandwidth_Hz > 1.2 * robust["guaranteed"]["bandwidth_Hz"]
    masses, bandwidth = np.linspace(*MASSES_KG, 5), nominal.best.bandwidth_Hz
    middle = seen(nominal.prototype, _stated(nominal.prototype), masses, bandwidth)
    assert middle.peak.max() <= 2.0
    assert middle.compliance.max() <= rig.goal.compliance_m_per_N
    corners = seen(nominal.prototype, corners_and_others(nominal.prototype), masses, bandwidth)
    assert corners.peak.max() > 2.5
    assert corners.compliance.max() > 1.05 * rig.goal.compliance_m_per_N


def _stated(rig: Prototype) -> np.ndarray:
    """(1, 10) exactly the figures of a rig."""
    return members(rig.but(tolerance=Tolerance()), np.full((1, len(FIGURES)), 0.5))


# What the command says and writes.


def test_what_is_guaranteed_is_told_with_the_rigs_it_is_of(robust: dict[str, Any]) -> None:
    guaranteed = robust["guaranteed"]
    assert guaranteed["rigs"] == {"sigmas": 2, "shape": "box"}
    assert guaranteed["lower_gains"] is True
    assert guaranteed["peak_sensitivity"] <= 2.0
    assert guaranteed["nominal"]["bandwidth_Hz"] > guaranteed["bandwidth_Hz"]
    assert guaranteed["nominal"]["peak_sensitivity"] < guaranteed["peak_sensitivity"]
    margins = [row["margin"] for row in guaranteed["tightest"]]
    assert margins == sorted(margins)
    assert {"outer_damping", "oil_stiffness"} <= {row["parameter"] for row in guaranteed["tightest"]}
    stated = read_prototype(robust["folder"] / "prototype.toml").guarantee
    assert stated is not None
    assert (stated.sigmas, stated.certificate) == (2.0, "certificate.box.toml")
    assert (stated.bandwidth_Hz, stated.peak_sensitivity) == (
        guaranteed["bandwidth_Hz"],
        guaranteed["peak_sensitivity"],
    )


def test_the_checker_proves_the_whole_box_again_and_that_it_is_the_prototypes(robust: dict[str, Any]) -> None:
    text = (robust["folder"] / "certificate.box.toml").read_text()
    verdict = check(text)
    assert verdict.valid
    for kind in ("stable for every member", "stable with the gain times every number from 0 to 1", "peak sensitivity",
                 "compliance", "loop gain |L| below 0.25"):  # fmt: skip
        assert any(kind in line and "every member of the box" in line for line in verdict.proved), kind
    replay = ["certify", "--replay", str(robust["folder"] / "certificate.box.toml")]
    own, other = robust["folder"] / "prototype.toml", robust["folder"].parent / "other.toml"
    assert CliRunner().invoke(app, [*replay, str(own)]).exit_code == 0
    built = read_prototype(own)
    assert built.controller is not None
    write_prototype(built.but(controller=built.controller.but(zero_Hz=31.0), guarantee=None), other)
    assert CliRunner().invoke(app, [*replay, str(other)]).exit_code == 1
    assert check(robust["folder"] / "certificate.toml").valid


def test_a_claim_over_less_of_the_box_is_refused(robust: dict[str, Any]) -> None:
    """Ranges of its own are the gains of a gain margin, no less of them, and payloads of the box: of nothing else."""
    text = (robust["folder"] / "certificate.box.toml").read_text()
    table = tomllib.loads(text)
    kinds = [claim["kind"] for claim in table["claim"]]
    others = {"gain_margin", "peak_sensitivity", "peak_compliance", "compliance", "loop_gain"}
    assert others <= set(kinds) <= {*others, "slope"}  # which is left out where its proof takes too long
    margin, loop_gain = kinds.index("gain_margin"), kinds.index("loop_gain")
    assert (table["claim"][margin]["limit"], table["claim"][loop_gain]["limit"]) == ("0", "0.25")
    low, high = table["claim"][margin]["range"]["controller_gain"]
    assert (low, high) == ("0", table["range"]["controller_gain"][1])
    of_oil = table["range"]["oil_stiffness"]
    narrower = {"oil_stiffness": [of_oil[0], table["member"]["oil_stiffness"]]}
    forgeries: list[tuple[int, dict[str, list[str]]]] = [
        (margin, {"controller_gain": ["0.05", high]}),
        (margin, {"controller_gain": [high, high]}),
        (margin, {"controller_gain": [low, high], **narrower}),
        (margin, {"controller_gain": [low, high], "outer_end_mass": ["0", "2"]}),
        (loop_gain, narrower),
        (kinds.index("peak_sensitivity"), narrower),
    ]
    for k, ranges in forgeries:
        forged = tomllib.loads(text)
        forged["claim"] = [
            forged["claim"][k] | {"range": ranges}
        ]  # what is claimed beside it is proved again elsewhere
        (failed,) = check(resealed(forged)).failed
        assert "over ranges of its own that are not those of what is claimed" in failed
    without = tomllib.loads(text)
    without["claim"] = [without["claim"][margin]]
    assert check(resealed(without)).valid
    del without["claim"][0]["range"]
    assert not check(resealed(without)).valid


def test_rigs_with_what_the_linear_design_leaves_out_deliver_what_is_guaranteed(robust: dict[str, Any]) -> None:
    """Rigs drawn from the tolerances, whose current saturates and whose flow depends on pressure."""
    built = read_prototype(robust["folder"] / "prototype.toml")
    deviations = rig_spread(built, MASSES_KG[1]).deviations
    nonlinear: dict[str, Any] = {"current_saturation": {"limit_A": 0.015}, "pressure_dependent_flow": {}}
    for k, one in enumerate(drawn(built, deviations, 3, seed=23)):
        reached = delivered(one.but(effects=nonlinear), MASSES_KG[k % 2], 40.0, seed=k)
        assert reached.stable, reached.reason
        assert reached.bandwidth_Hz > robust["guaranteed"]["bandwidth_Hz"]


@pytest.mark.usefixtures("one_start")
def test_nominal_is_asked_for_by_word_or_by_no_sigmas(rig: Prototype, nominal: Tuning, tmp_path: Path) -> None:
    write_prototype(rig, tmp_path / "rig.toml")
    command = ["tune", str(tmp_path / "rig.toml"), "--outer-end-mass", "0:1", "--nominal", "--out", str(tmp_path / "o")]
    assert CliRunner().invoke(app, [*command, "--json", str(tmp_path / "found.json")]).exit_code == 0
    found = json.loads((tmp_path / "found.json").read_text())
    assert nominal.best is not None
    assert found["guaranteed"]["rigs"] == "nominal"
    assert found["guaranteed"]["bandwidth_Hz"] == nominal.best.bandwidth_Hz
    assert found["controller"] == nominal.best.controller.model_dump()
    assert {path.name for path in (tmp_path / "o").iterdir()} == {"prototype.toml", "certificate.toml"}


# What it is for, and what cannot be.


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[LawOptions]:
    """What every law is sought with; nothing is found."""
    every: list[LawOptions] = []

    def nothing(prototype: Prototype, masses: tuple[float, float], asked: LawOptions, told: object) -> Tuning:
        every.append(asked)
        return Tuning(prototype, masses, reason="nothing")

    monkeypatch.setattr(tuning, "tune_law", nothing)
    monkeypatch.setattr(design_run, "carried", lambda *given: ())  # nor is a change tried that may lead to something
    return every


def test_without_tolerances_typical_ones_are_taken_and_said(asked: list[LawOptions], tmp_path: Path) -> None:
    table = tomllib.loads(PAPER.read_text())
    assert "tolerance" not in table
    (tmp_path / "rig.toml").write_text(tomli_w.dumps(table))
    done = CliRunner().invoke(app, ["tune", str(tmp_path / "rig.toml")])
    assert done.exit_code == 1
    words = " ".join(done.output.split())
    assert "no [tolerance] is stated for any figure; typical ones are taken" in words
    assert f"flow_gain {TYPICAL.flow_gain:.2g}" in words
    (one,) = asked
    assert one.spread is not None
    assert one.spread.sigmas == 2.0
    assert one.spread.deviations["flow_gain"] == TYPICAL.flow_gain
    assert one.spread.prototype.tolerance == TYPICAL


@pytest.mark.parametrize(("options", "counts"), [([], True), (["--sigmas", "0"], False), (["--nominal"], False)])
def test_typical_tolerances_are_told_only_where_they_count(
    options: list[str], counts: bool, asked: list[LawOptions], tmp_path: Path
) -> None:
    table = tomllib.loads(STUDY.read_text())
    table.pop("tolerance", None)
    (tmp_path / "study.toml").write_text(tomli_w.dumps(table))
    run = ["run", str(tmp_path / "study.toml"), "--out", str(tmp_path / "out"), *options]
    done = CliRunner().invoke(app, run)
    assert done.exit_code == 1, done.output
    assert ("typical ones are taken" in " ".join(done.output.split())) == counts
    assert all((one.spread is not None) == counts for one in asked)


def test_a_mass_inside_that_a_study_states_is_told_to_be_found(asked: list[LawOptions], tmp_path: Path) -> None:
    table = tomllib.loads(STUDY.read_text())
    table["payload"]["inner_end_mass_kg"] = 3.5
    (tmp_path / "study.toml").write_text(tomli_w.dumps(table))
    done = CliRunner().invoke(app, ["run", str(tmp_path / "study.toml"), "--out", str(tmp_path / "out")])
    assert done.exit_code == 1, done.output
    assert "payload.inner_end_mass_kg = 3.5 is not taken" in " ".join(done.output.split())
    assert all(one.inner_kg == (0.0, 6.0) for one in asked)


def test_tolerances_of_another_actuator_are_told() -> None:
    """As where a screw was put in the place of a cylinder, but its tolerances were not."""
    left = Tolerance(stiffness=0.03, oil_stiffness=0.15, lead=0.001)
    kept, words = stated_or_typical(left, KINDS["ball_screw"])
    assert kept == left
    assert "states oil_stiffness of another actuator" in words
    assert "its own figures: screw_stiffness, screw_damping, torque_constant" in words
    assert stated_or_typical(left.but(oil_stiffness=0.0), KINDS["ball_screw"])[1] == ""


def test_typical_tolerances_leave_those_of_end_masses_as_they_are_stated() -> None:
    """What is gripped may be 5 % off what is said; the range of payloads is wider by as much."""
    taken, words = stated_or_typical(Tolerance(outer_end_mass=0.05), KINDS["servo_cylinder"])
    assert taken == TYPICAL.but(outer_end_mass=0.05)
    assert "typical ones are taken" in words
    assert "outer_end_mass" not in words


def test_stated_tolerances_are_taken_as_they_are(asked: list[LawOptions], rig: Prototype) -> None:
    found = tune(rig.but(tolerance=Tolerance(oil_stiffness=0.1)), MASSES_KG, sigmas=1.5)
    assert found.caution == ""
    (one,) = asked
    assert one.spread is not None
    assert (dict(one.spread.deviations), one.spread.sigmas) == ({"oil_stiffness": 0.1}, 1.5)


def test_tolerances_that_are_missing_or_reach_zero_are_refused(rig: Prototype) -> None:
    with pytest.raises(InputError, match="no figure of the rig has one: state some"):
        rig_spread(rig.but(tolerance=Tolerance()), MASSES_KG[1])
    with pytest.raises(InputError, match=r"10 standard deviations of 0\.15 reach zero"):
        tune(rig, MASSES_KG, sigmas=10.0)
    with pytest.raises(ValueError, match="no tuning of kind"):
        tune(rig, MASSES_KG, "integral")


def test_a_stage_performs_over_its_own_payloads_and_is_stable_with_all(rig: Prototype) -> None:
    """In every rig: by eigenvalues of rigs at the corners, and by the checker."""
    whole_kg = (0.0, 2.0)
    spread = rig_spread(rig, whole_kg[1], SIGMAS)
    with least_effort():
        found = tune_law(rig, MASSES_KG, LawOptions(spread=spread, stable_kg=whole_kg), lambda share, text: None)
    assert found.best is not None
    assert found.best.over_box is not None
    built, reached = found.prototype, found.best
    rigs = corners_and_others(built, 100, 50)
    own = seen(built, rigs, np.linspace(*MASSES_KG, 3), reached.bandwidth_Hz)
    assert own.peak.max() <= reached.peak_sensitivity
    assert own.compliance.max() <= built.goal.compliance_m_per_N
    for mass in np.linspace(*whole_kg, 9):
        assert np.linalg.eigvals(matrices(built, rigs, float(mass))[0]).real.max() < 0
    assert found.best.over_box.certificate
    verdict = check(found.best.over_box.certificate)
    assert verdict.valid, verdict.failed
    assert any(line.startswith("stable for every member of the box") for line in verdict.proved)
    about = [line for line in verdict.proved if "for every member of the box with outer_end_mass 0 to 1:" in line]
    kinds = [claim.kind for claim in found.best.over_box.claims]
    assert len(about) == len(kinds) >= 5  # with `slope` where that is proved in its time
    assert {"gain_margin", "peak_sensitivity", "compliance"} <= set(kinds)


def test_rigs_of_the_search_carry_as_much_as_those_that_are_proved() -> None:
    """A heavier payload than was asked for, within its tolerance, changes the gain of an effect of the load."""
    record = read_prototype(PAPER).but(effects={"pressure_dependent_flow": {}}, tolerance=Tolerance(outer_end_mass=0.1))
    rig = record.but(tolerance=record.tolerance.but(flow_gain=0.05))
    box = tolerance_box(rig, SIGMAS, None, MASSES_KG)
    (member,) = rig_spread(rig, MASSES_KG[1], SIGMAS).members(np.zeros(1))
    assert (member.gain.low, member.gain.high) == pytest.approx(
        [float(nearest(end)) for end in box.ranges["effect_gain"]]
    )


# The search for the worst rigs.


def test_the_worst_rig_is_found_at_a_resonance_as_sharp_as_it_is_far_from_the_others() -> None:
    """A climb over all frequencies at once ends at a rig that keeps the limit."""
    law = Lag(gain_A_per_V=0.0589148, pole_Hz=1.06545, zero_Hz=22.0743)
    record = read_prototype(PAPER)
    inside = record.payload.but(inner_end_mass_kg=2.469207)
    rig = record.but(tolerance=TYPICAL, controller=law, payload=inside)
    box = tolerance_box(rig, 2.0, None, (0.0, 6.8))
    worst = worst_over_box(rig, box, Asked("peak_sensitivity", 2.0))[0]
    assert worst.ratio > 1.5
    assert worst.frequency_Hz == pytest.approx(33.9, abs=0.5)
    refuted = claim_over_box(rig, box, Asked("peak_sensitivity", 2.0))
    assert refuted.holds is False
    assert refuted.frequency_Hz == pytest.approx(worst.frequency_Hz, rel=1e-3)


@pytest.mark.usefixtures("least_effort")
def test_the_shipped_study_is_designed_for_every_rig_within_its_tolerances() -> None:
    found = run_design(read_problem(PAPER.parent.parent / "prototype.toml"))
    assert found.prototype is not None, found.reason
    stated, proved = found.prototype.guarantee, found.proved[0]
    assert stated is not None
    assert stated.sigmas == SIGMAS
    assert stated.peak_sensitivity <= 2.0
    assert 2.3 < stated.bandwidth_Hz < proved["nominal"]["bandwidth_Hz"]
    assert proved["lower_gains"] is True
    assert proved["comes_to_rest"] is True
    assert all(row.proved for row in found.certificate.nonlinear)
    assert [one["margin"] for one in proved["tightest"]] == sorted(one["margin"] for one in proved["tightest"])
    page = [one for one in statements(found) if one.claim.endswith(rigs_in_words(SIGMAS))]
    assert len(page) == len(found.tuning.best.over_box.claims)
    assert {one.foundation for one in page} == {"proved"}


def test_a_design_for_one_payload_is_proved_with_that_payload(rig: Prototype) -> None:
    """With 3 kg on the tip, not without any: the compliance of the worst rig at 3 kg bounds the bandwidth."""
    few = Tolerance(stiffness=0.02, oil_stiffness=0.1, flow_gain=0.05)
    with least_effort():
        found = tune(rig.but(goal=rig.goal.but(comes_to_rest=True), tolerance=few), (3.0, 3.0)).best
    assert found is not None
    box = tomllib.loads(found.over_box.certificate)
    assert box["range"]["outer_end_mass"] == ["3", "3"]
    assert box["member"]["outer_end_mass"] == "3"
    verdict = check(found.over_box.certificate)
    assert verdict.valid
    assert any("comes to rest about every equilibrium" in line for line in verdict.proved)
    assert found.bandwidth_Hz < found.nominal[0]


@pytest.mark.parametrize("mass", [0.0, 6.8])
def test_forbidden_shares_of_the_gain_are_those_of_an_independent_model(mass: float) -> None:
    """`structured` oscillates at 2 to 66 % of its gain without payload, at 1.8 to 50 % with 6.8 kg."""
    law = read_prototype(PAPER.parent / "structured.toml")
    (member,) = members_of(tomllib.loads(certify(law, 0.0, 6.8).text))
    ((low, high),) = forbidden_shares(law, (mass, mass))
    for end, inward in ((low, 1.03), (high, 1 / 1.03)):
        assert member.poles(mass, end * inward).real.max() > 0 > member.poles(mass, end / inward).real.max()


def test_a_lag_that_is_stable_at_lower_gains_forbids_none() -> None:
    assert forbidden_shares(read_prototype(PAPER.parent / "tame_lag.toml"), (0.0, 6.8)) == []
