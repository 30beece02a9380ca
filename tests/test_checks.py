"""Structural checks: by hand, on numbers, arrays and symbols, and of a prototype's own sections."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from beamdesign import DesignProblem, InputError, Prototype, read_problem
from beamdesign.build.ratings import held_loads
from beamdesign.prototype import Beam
from beamdesign.structure.section import Tube
from beamdesign.synthesis.checks import Check, check_sections, checks
from beamdesign.synthesis.sizing import check_prototype, problem_of

STUDY = Path(__file__).parents[1] / "studies" / "prototype.toml"
PUBLISHED = Tube(0.140, 0.0023), Tube(0.100, 0.0032)


@pytest.fixture(scope="module")
def problem() -> DesignProblem:
    return read_problem(STUDY)


def test_checks_cover_what_is_asked(problem):
    stocky = problem.but(sections=problem.sections.but(width_to_wall_at_most=61.0))
    names = [check.name for check in checks(stocky, *PUBLISHED)]
    for needed in (
        "outer strength, servo off",
        "inner strength, servo on",
        "outer local buckling, servo off",
        "inner local buckling, servo on",
        "clearance at assembly",
        "clearance under load, servo on",
        "clearance under load, servo off",
        "outer least wall",
        "inner least wall",
        "outer largest width",
        "outer width to wall",
        "inner width to wall",
    ):
        assert names.count(needed) == 1


def test_checks_by_hand(problem):
    found = {check.name: check for check in checks(problem, Tube(0.15, 0.0025), Tube(0.09, 0.0025))}
    outer_modulus = (0.15**4 - 0.145**4) / 12 / 0.075
    inner_moment = (0.09**4 - 0.085**4) / 12
    assert found["outer strength, servo off"].value == pytest.approx(2000 * 1.195 / outer_modulus)
    assert found["inner strength, servo on"].value == pytest.approx(2000 * 1.365 / (inner_moment / 0.045))
    assert found["inner strength, servo on"].limit == pytest.approx(240e6 / 2)
    deflection = 2000 * 1.365**3 / (3 * 69e9 * inner_moment)
    assert found["clearance at assembly"].value == pytest.approx(0.0275)
    assert found["clearance under load, servo on"].value == pytest.approx(0.0275 - deflection)


def test_checks_on_arrays_and_symbols(problem):
    outer = np.array([[0.14, 0.0023], [0.15, 0.0025]]).T
    inner = np.array([[0.1, 0.0032], [0.09, 0.0025]]).T
    symbols = [ca.SX.sym(name) for name in ("ow", "ot", "iw", "it")]
    symbolic = [
        ca.Function("check", symbols, [c.value, c.limit])
        for c in checks(problem, Tube(*symbols[:2]), Tube(*symbols[2:]))
    ]
    both = checks(problem, Tube(*outer), Tube(*inner))
    for place in range(2):
        sizes = [*outer[:, place].tolist(), *inner[:, place].tolist()]
        for alone, array, function in zip(
            checks(problem, Tube(*sizes[:2]), Tube(*sizes[2:])), both, symbolic, strict=True
        ):
            assert np.broadcast_to(array.value, 2)[place] == pytest.approx(alone.value, rel=1e-13)
            assert np.broadcast_to(array.limit, 2)[place] == pytest.approx(alone.limit, rel=1e-13)
            value, limit = (float(figure) for figure in function(*sizes))
            assert value == pytest.approx(alone.value, rel=1e-13)
            assert limit == pytest.approx(alone.limit, rel=1e-13)


@pytest.mark.parametrize(
    ("check", "satisfied", "utilisation"),
    [
        (Check("", 50.0, 100.0, "Pa"), True, 0.5),
        (Check("", 150.0, 100.0, "Pa"), False, 1.5),
        (Check("", 0.004, 0.002, "m", at_least=True), True, 0.5),
        (Check("", 0.001, 0.002, "m", at_least=True), False, 2.0),
        (Check("", -0.001, 0.002, "m", at_least=True), False, float("inf")),
        (Check("", 0.001, 0.0, "m", at_least=True), True, 0.0),
        (Check("", 0.0, 0.0, "m", at_least=True), True, 1.0),
        (Check("", (0.11 - 0.004 - 0.096) / 2, 0.005, "m", at_least=True), True, 1.0),
    ],
)
def test_verdict_of_one_check(check, satisfied, utilisation):
    assert bool(check.satisfied) is satisfied
    assert check.utilisation == pytest.approx(utilisation)


def test_wall_beyond_the_strength_data_fails(problem):
    pair = check_sections(problem, Tube(0.2, 0.021), Tube(0.1, 0.005))
    assert "outer wall within strength data" in [check.name for check in pair.failing]


def prototype_of(problem: DesignProblem) -> Prototype:
    return problem.prototype(*PUBLISHED)


def test_prototype_is_checked_with_its_own_sections(problem):
    assert check_prototype(prototype_of(problem), 2000.0) == check_sections(problem, *PUBLISHED)
    twice = check_prototype(prototype_of(problem), 4000.0)
    assert [check.name for check in twice.failing] == [
        "clearance under load, servo on",
        "inner strength, servo on",
        "inner local buckling, servo on",
    ]


def test_prototype_is_checked_with_its_corner_radii(problem):
    sharp = prototype_of(problem)
    rounded = sharp.but(inner_beam=sharp.inner_beam.but(corner_radius_m=0.008))
    pair = check_prototype(rounded, 2000.0)
    assert pair.beam_mass_kg < check_prototype(sharp, 2000.0).beam_mass_kg
    stress, reference = (
        next(check.value for check in one.checks if check.name == "inner strength, servo on")
        for one in (pair, check_prototype(sharp, 2000.0))
    )
    assert stress > reference


def test_a_prototype_bends_by_its_measured_stiffness_as_its_specification_says(problem):
    """An inner tube of two thirds of its computed stiffness touches the outer one: 17.7 mm less 2000 N over that."""
    sharp = prototype_of(problem)
    rig = sharp.but(inner_beam=sharp.inner_beam.but(stiffness_N_per_m=105e3, effective_mass_kg=1.6))
    pair = check_prototype(rig, 2000.0)
    on, off = (check for check in pair.checks if "under load" in check.name)
    assert on.value == pytest.approx(0.0177 - 2000 / 105e3)
    assert not on.satisfied
    assert [on.value, off.value] == [held.gap_left_m for held in held_loads(rig, 2000.0)]


def test_a_rounded_tube_in_a_round_one_is_checked_though_a_sharp_one_would_not_go_in(problem):
    """Between them is the round one's radius less that to the corner: half the flat times root two, and the radius."""
    rig = prototype_of(problem)
    rounded = rig.inner_beam.but(width_m=0.068, wall_m=0.003, corner_radius_m=0.012)
    around = rig.outer_beam.but(shape="round", width_m=0.1, wall_m=0.003)
    pair = check_prototype(rig.but(outer_beam=around, inner_beam=rounded), 100.0)
    (gap,) = (check.value for check in pair.checks if check.name == "clearance at assembly")
    assert gap == pytest.approx(0.047 - ((0.034 - 0.012) * 2**0.5 + 0.012))


def test_prototype_without_geometry_names_every_missing_key(problem):
    lumped = prototype_of(problem).but(
        outer_beam=Beam(stiffness_N_per_m=486_800.0, effective_mass_kg=3.9, material="6061-T6", width_m=0.14)
    )
    with pytest.raises(InputError) as refused:
        problem_of(lumped, 2000.0, "rig.toml")
    assert refused.value.source == "rig.toml"
    assert {key for key, _ in refused.value.problems} == {
        "outer_beam.wall_m",
        "outer_beam.length_m",
        "outer_beam.free_length_m",
    }


def test_unknown_material_is_refused_with_the_study(tmp_path):
    text = STUDY.read_text(encoding="utf-8")
    study = tmp_path / "study.toml"
    study.write_text(text.replace("6061-T6", "unobtainium"), encoding="utf-8")
    with pytest.raises(InputError) as refused:
        read_problem(study)
    assert {key for key, _ in refused.value.problems} == {"outer_beam.material", "inner_beam.material"}
