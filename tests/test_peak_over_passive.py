"""The largest compliance against that with the servo off: closed forms, an independent model of rigs, forgeries."""

import tomllib
from math import inf, pi, sqrt
from pathlib import Path

import numpy as np
import pytest
from flint import fmpq
from forging import put, resealed, times
from one_start import least_effort
from test_robust_tuning import FIGURES, corners_and_others, matrices, members

from beamdesign import Prototype, certify, certify_box, check, read_prototype, tune
from beamdesign.controllers import Lag
from beamdesign.loop import loop
from beamdesign.plant.members import family
from beamdesign.polynomial import nearest
from beamdesign.proofs.box_claims import claim_over_box
from beamdesign.proofs.certificate import Asked, peak_claim
from beamdesign.proofs.performance import Peak, servo_off_of
from beamdesign.proofs.tolerance_box import servo_off_over_box, tolerance_box
from beamdesign.proofs.writer import prototype_table
from beamdesign.prototype import Goal, Tolerance
from beamdesign.report.figures import passive_curves
from beamdesign.structure.lumped import beam_of_equal_mass
from beamdesign.structure.materials import material

STUDIES = Path(__file__).parent.parent / "studies" / "prototypes"
MASSES_KG = (0.0, 1.0)
SIGMAS = 2.0


@pytest.fixture(scope="module")
def rig() -> Prototype:
    """The published rig; what varies in it is what `matrices` has of it."""
    record = read_prototype(STUDIES / "paper_remedy.toml")
    off = Tolerance(
        stiffness=0.02, effective_mass=0.02, beam_damping_ratio=0.15, oil_stiffness=0.1, flow_gain=0.05,
        valve_natural_frequency=0.05,
    )  # fmt: skip
    return record.but(tolerance=off, payload=record.payload.but(outer_end_mass_kg=MASSES_KG))


def servo_off(rig: Prototype, masses_kg: tuple[float, float]) -> Peak:
    return servo_off_of(family(rig, masses_kg[1]).members, rig.payload.inner_end_mass_kg, masses_kg)


def softest(rig: Prototype, figures: np.ndarray, gain: float, masses: np.ndarray) -> np.ndarray:
    """Largest |x / F_d| of rigs (rigs, 10) by equations (7) to (18), on a grid close enough for 2e-3."""
    s = 2j * pi * np.concatenate([np.geomspace(0.05, 15.0, 15), np.geomspace(15.0, 250.0, 700)])
    worst = np.zeros(len(figures))
    for mass in masses:
        a, b = matrices(rig, figures, float(mass), gain)
        poles, shapes = np.linalg.eig(a)
        residues = shapes[:, 0] * np.linalg.solve(shapes, b[:, :, :1])[:, :, 0]
        response = (residues[:, None] / (s[:, None] - poles[:, None])).sum(axis=2)
        worst = np.maximum(worst, np.abs(response).max(axis=1))
    return worst


def test_without_leakage_the_oil_is_a_spring_between_the_beams(rig: Prototype) -> None:
    """Two masses on springs, joined by a third: x / F = 1 / (D + k - k^2 / (d + k)), D and d those of each alone."""
    shut = rig.but(servovalve=rig.servovalve.but(leakage_m3_per_s_per_Pa=0.0))
    outer, inner, oil = rig.outer_beam, rig.inner_beam, rig.actuator.oil_stiffness_N_per_m
    w = 2 * pi * np.linspace(0.1, 120.0, 1_200_000)
    largest = 0.0
    for mass in (0.0, 0.37, 1.0):
        alone = []
        for beam, added in ((outer, mass), (inner, rig.payload.inner_end_mass_kg)):
            assert beam.stiffness_N_per_m is not None
            assert beam.effective_mass_kg is not None
            damping = 2 * beam.damping_ratio * sqrt(beam.stiffness_N_per_m * beam.effective_mass_kg)
            alone.append(beam.stiffness_N_per_m - (beam.effective_mass_kg + added) * w**2 + 1j * damping * w)
        largest = max(largest, float(np.abs(1 / (alone[0] + oil - oil**2 / (alone[1] + oil))).max()))
    found = servo_off(shut, MASSES_KG)
    assert found.compliance_m_per_N == pytest.approx(largest, rel=1e-5)
    assert found.compliance_m_per_N < largest * (1 + 1e-9)


def test_it_is_the_compliance_over_the_sensitivity_whatever_the_law() -> None:
    for name in ("structured", "tame_lag"):
        one = read_prototype(STUDIES / f"{name}.toml")
        closed = loop(one)
        frequencies = np.geomspace(20.0, 60.0, 40_000)
        largest = max(
            np.abs(at.compliance_response(frequencies) / at.sensitivity_response(frequencies)).max()
            for at in map(closed.at, np.linspace(0.0, 6.8, 9))
        )
        assert servo_off(one, (0.0, 6.8)).compliance_m_per_N == pytest.approx(float(largest), rel=1e-5)


def test_the_worst_rig_of_a_box_is_one_of_its_rigs_and_none_that_is_drawn_is_worse(rig: Prototype) -> None:
    found, worst = servo_off_over_box(rig, tolerance_box(rig, SIGMAS, None, MASSES_KG))
    drawn = softest(rig, corners_and_others(rig, 60, 30), 0.0, np.linspace(*MASSES_KG, 3))
    assert drawn.max() <= found * 1.002
    names = ("outer_stiffness", "outer_mass", "outer_damping", "inner_stiffness", "inner_mass", "inner_damping",
             "oil_stiffness", "flow_gain", "valve_frequency")  # fmt: skip
    one = np.array([[*(nearest(worst.parameters[name]) for name in names), rig.payload.inner_end_mass_kg]])
    itself = softest(rig, one, 0.0, np.array([nearest(worst.parameters["outer_end_mass"])]))
    assert itself[0] == pytest.approx(found, rel=2e-3)
    assert found > 1.2 * servo_off(rig, MASSES_KG).compliance_m_per_N


# What is claimed of it, and forged.


def test_a_certificate_states_it_and_a_bolder_one_is_refused() -> None:
    one = read_prototype(STUDIES / "structured.toml").but(guarantee=None)
    found = certify(one, 0.0, 6.8)
    assert found.guaranteed is not None
    assert 1.6 < found.guaranteed.peak_over_passive < 1.63
    assert check(found.text, lambda *of: prototype_table(one, *of)).valid
    table = tomllib.loads(found.text)
    (place,) = [k for k, claim in enumerate(table["claim"]) if claim["kind"] == "peak_compliance"]
    put(table, ("claim", place, "limit"), times(table["claim"][place]["limit"], "0.999"))
    verdict = check(resealed(table))
    assert not verdict.valid
    assert any("peak compliance" in line for line in verdict.failed)
    passive = Asked("peak_compliance", found.guaranteed.servo_off_m_per_N)
    (refuted,) = certify(one, 0.0, 6.8, [passive]).claims
    assert not refuted.holds
    assert refuted.witness is not None
    at = loop(one).at(refuted.witness_outer_end_mass_kg or 0.0)
    assert abs(at.compliance_response(np.array([refuted.witness.frequency_Hz]))[0]) > passive.limit


def test_a_goal_without_the_limit_is_certified_and_compared() -> None:
    one = read_prototype(STUDIES / "tame_lag.toml").but(guarantee=None, goal=Goal(peak_over_passive=inf))
    text = certify(one, 0.0, 6.8).text
    assert peak_claim(one.goal, 2e-5) == ()
    assert "peak_over_passive" not in tomllib.loads(text)["goal"]
    assert check(text, lambda *of: prototype_table(one, *of)).valid
    limited = one.but(goal=Goal(peak_over_passive=0.7))
    other = certify(limited, 0.0, 6.8).text
    assert check(other, lambda *of: prototype_table(limited, *of)).valid
    assert not check(other, lambda *of: prototype_table(one, *of)).valid


def test_over_a_box_it_is_proved_where_it_holds_and_refuted_where_it_does_not(rig: Prototype) -> None:
    rig = rig.but(controller=Lag(gain_A_per_V=0.0442783, pole_Hz=1.21112, zero_Hz=21.457))
    box = tolerance_box(rig, SIGMAS, None, MASSES_KG)
    seen = softest(rig, corners_and_others(rig, 60, 30), 1.0, np.linspace(*MASSES_KG, 3)).max()
    held = claim_over_box(rig, box, Asked("peak_compliance", float(1.3 * seen)))
    assert held.holds
    missed = claim_over_box(rig, box, Asked("peak_compliance", float(0.9 * seen)))
    assert missed.holds is False
    assert missed.witness is not None
    assert missed.witness["outer_end_mass"] <= fmpq(1)


# The tuner.


@pytest.mark.usefixtures("one_start")
def test_a_goal_that_binds_is_kept_by_the_rig_itself(rig: Prototype) -> None:
    free = tune(rig.but(goal=Goal(peak_over_passive=inf), controller=None), MASSES_KG, sigmas=0.0).best
    assert free is not None
    share = 0.6 * _closed(rig, free.controller, free.inner_end_mass_kg) / _idle(rig, free.inner_end_mass_kg)
    limited = tune(rig.but(goal=Goal(peak_over_passive=share), controller=None), MASSES_KG, sigmas=0.0).best
    assert limited is not None
    assert limited.bandwidth_Hz < 0.99 * free.bandwidth_Hz
    idle = _idle(rig, limited.inner_end_mass_kg)
    closed = _closed(rig, limited.controller, limited.inner_end_mass_kg)
    assert 0.97 * share * idle < closed <= share * idle * 1.0005
    assert limited.peak_over_passive <= share


def _stated(rig: Prototype) -> np.ndarray:
    return members(rig.but(tolerance=Tolerance()), np.full((1, len(FIGURES)), 0.5))


def _closed(rig: Prototype, law: object, inner_kg: float) -> float:
    built = rig.but(controller=law, payload=rig.payload.but(inner_end_mass_kg=inner_kg))
    return float(softest(built, _stated(built), 1.0, np.linspace(*MASSES_KG, 5))[0])


def _idle(rig: Prototype, inner_kg: float) -> float:
    built = rig.but(payload=rig.payload.but(inner_end_mass_kg=inner_kg))
    return float(softest(built, _stated(built), 0.0, np.linspace(*MASSES_KG, 5))[0])


def test_over_a_box_worst_is_compared_with_worst(rig: Prototype) -> None:
    """No rig that is drawn from the box is softer than the share asked of the softest with the servo off."""
    share = 0.2
    goal = Goal(peak_over_passive=share)
    rig = rig.but(tolerance=Tolerance(stiffness=0.02, beam_damping_ratio=0.15, flow_gain=0.05))
    with least_effort():
        best = tune(rig.but(goal=goal, controller=None), MASSES_KG, sigmas=SIGMAS).best
    assert best is not None
    assert best.over_box is not None
    built = rig.but(controller=best.controller, payload=rig.payload.but(inner_end_mass_kg=best.inner_end_mass_kg))
    figures, masses = corners_and_others(built, 60, 30), np.linspace(*MASSES_KG, 3)
    limit = share * softest(built, figures, 0.0, masses).max()
    assert softest(built, figures, 1.0, masses).max() <= best.peak_compliance_m_per_N <= limit * 1.02
    verdict = check(best.over_box.certificate)
    assert verdict.valid
    assert any("at every frequency" in line and "every member" in line for line in verdict.proved)
    table = tomllib.loads(best.over_box.certificate)
    (place,) = [k for k, claim in enumerate(table["claim"]) if claim["kind"] == "peak_compliance"]
    table["claim"] = [table["claim"][place]]  # what is claimed beside it is proved above
    put(table, ("claim", 0, "limit"), times(table["claim"][0]["limit"], "1/2"))
    (failed,) = check(resealed(table)).failed
    assert failed.startswith("compliance")
    assert "at every frequency" in failed


# The passive beam of equal mass.


def test_the_passive_beam_weighs_as_much_as_both_and_is_a_cantilever() -> None:
    """4 t (w - t) rho L is the mass of a sharp tube, and 3 E I / L^3 its stiffness, I = (w^4 - (w - 2 t)^4) / 12."""
    one = read_prototype(STUDIES / "tame_lag.toml")
    outer = one.outer_beam.but(width_m=0.14, wall_m=0.0023, corner_radius_m=0.0, free_length_m=1.2, material="6061-T6")
    inner = outer.but(width_m=0.09, wall_m=0.003)
    found = beam_of_equal_mass(outer, inner)
    assert found is not None
    area = 4 * (0.0023 * (0.14 - 0.0023) + 0.003 * (0.09 - 0.003))
    wall = (0.14 - sqrt(0.14**2 - area)) / 2
    moment = (0.14**4 - (0.14 - 2 * wall) ** 4) / 12
    assert (found.wall_m, found.solid) == (pytest.approx(wall, rel=1e-9), False)
    alloy = material("6061-T6")
    assert found.stiffness == pytest.approx(3 * alloy.youngs_modulus_Pa * moment / 1.2**3, rel=1e-9)
    solid = beam_of_equal_mass(outer.but(wall_m=0.06), inner.but(wall_m=0.04))
    assert solid is not None
    assert solid.solid
    assert solid.stiffness == pytest.approx(3 * alloy.youngs_modulus_Pa * 0.14**4 / 12 / 1.2**3, rel=1e-9)


def test_what_is_drawn_beside_a_loop_is_at_rest_one_over_its_stiffness() -> None:
    one = read_prototype(STUDIES / "structured.toml")
    curves = passive_curves(one, 6.8)
    equal = beam_of_equal_mass(one.outer_beam, one.inner_beam)
    assert equal is not None
    resting = {name: abs(curve.compliance_response(np.array([1e-3]))[0]) for name, curve in curves.items()}
    assert resting["passive beam of equal mass"] == pytest.approx(1 / equal.stiffness, rel=1e-6)
    resonance = sqrt(equal.stiffness / (equal.mass + 6.8)) / (2 * pi)
    assert abs(curves["passive beam of equal mass"].compliance_response(np.array([resonance]))[0]) == pytest.approx(
        1 / (equal.damping * 2 * pi * resonance), rel=1e-6
    )
    grid = np.geomspace(10.0, 100.0, 50_000)
    assert np.abs(curves["servo off"].compliance_response(grid)).max() == pytest.approx(
        servo_off(one, (6.8, 6.8)).compliance_m_per_N, rel=1e-4
    )
    bare = one.but(outer_beam=one.outer_beam.but(width_m=None, wall_m=None))
    assert set(passive_curves(bare, 6.8)) == {"servo off"}


def test_a_rig_that_nothing_damps_has_no_largest_compliance_with_the_servo_off() -> None:
    """Then a loop that damps it is within every multiple of that."""
    one = read_prototype(STUDIES / "tame_lag.toml").but(guarantee=None)
    assert one.servovalve is not None
    undamped = one.but(
        outer_beam=one.outer_beam.but(damping_ratio=0.0),
        inner_beam=one.inner_beam.but(damping_ratio=0.0),
        servovalve=one.servovalve.but(leakage_m3_per_s_per_Pa=0.0),
    )
    alone = certify(undamped, 0.0, 6.8).guaranteed
    assert alone is not None
    assert (alone.servo_off_m_per_N, alone.peak_over_passive) == (inf, 0.0)
    found = certify_box(undamped, (0.0, 6.8), sigmas=0.0)
    assert found.guaranteed["peak_over_passive"] == 0.0
    assert found.to_dict()["guaranteed"]["servo_off_m_per_N"] is None
    assert check(found.text).valid
