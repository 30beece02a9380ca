"""The study file: what a design problem may ask for, and what is refused."""

import copy
import tomllib
from math import nan
from pathlib import Path
from typing import Any

import pytest

from beamdesign import DesignProblem, InputError, read_problem
from beamdesign.parameters import TYPICAL
from beamdesign.prototype import Tolerance
from beamdesign.records import parse, to_toml
from beamdesign.structure.lumped import figures
from beamdesign.structure.section import Tube

STUDIES = sorted((Path(__file__).parent.parent / "studies").glob("*.toml"))
STUDY = next(path for path in STUDIES if path.name == "prototype.toml")
TABLE: dict[str, Any] = tomllib.loads(STUDY.read_text(encoding="utf-8"))


def changed(**changes: Any) -> dict[str, Any]:
    """The published study with values set under dotted keys (two underscores for the dot), or taken away by None."""
    table: dict[str, Any] = copy.deepcopy(TABLE)
    for key, value in changes.items():
        *way, last = key.split("__")
        inner = table
        for step in way:
            inner = inner.setdefault(step, {})
        if value is None:
            del inner[last]
        else:
            inner[last] = value
    return table


def refused(table: dict[str, Any]) -> list[tuple[str, str]]:
    with pytest.raises(InputError) as caught:
        parse(DesignProblem, table, "study.toml")
    assert caught.value.source == "study.toml"
    return [tuple(problem) for problem in caught.value.problems]


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.name)
def test_every_study_is_read_and_written_without_loss(tmp_path, path):
    problem = read_problem(path)
    (tmp_path / "again.toml").write_text(to_toml(problem), encoding="utf-8")
    assert read_problem(tmp_path / "again.toml") == problem


def test_the_published_study_asks_what_the_paper_does():
    problem = read_problem(STUDY)
    assert problem.load.tip_force_N == 2000.0
    assert problem.payload.outer_end_mass_kg == (0.0, 6.8)
    # -100 dB of inch per pound-force.
    assert problem.goal.compliance_m_per_N == pytest.approx(1e-5 * 0.0254 / 4.4482216152605, rel=1e-3)
    assert problem.goal.peak_sensitivity == 2.0


def test_the_prototype_of_a_study_has_its_sections_and_hydraulics():
    """The published tubes give the stiffnesses that were measured, to 0.3 %; nothing else is changed on the way."""
    problem = read_problem(STUDY)
    prototype = problem.prototype(Tube(0.140, 0.0023), Tube(0.100, 0.0032))
    lumped = figures(prototype)
    assert lumped["outer_stiffness"] == pytest.approx(486_800.0, rel=3e-3)
    assert lumped["inner_stiffness"] == pytest.approx(157_500.0, rel=3e-3)
    assert prototype.controller is None
    assert (prototype.goal, prototype.tolerance) == (problem.goal, problem.tolerance)
    assert problem.but(tolerance=Tolerance()).prototype(Tube(0.140, 0.0023), Tube(0.100, 0.0032)).tolerance == TYPICAL
    assert prototype.payload == problem.payload.but(largest_force_N=2000.0)
    other = problem.but(payload=problem.payload.but(largest_force_N=500.0))
    assert other.prototype(Tube(0.140, 0.0023), Tube(0.100, 0.0032)).payload.largest_force_N == 500.0
    assert (prototype.actuator, prototype.servovalve, prototype.sensor) == (
        problem.actuator,
        problem.servovalve,
        problem.sensor,
    )


@pytest.mark.parametrize(
    ("changes", "named", "reason"),
    [
        ({"load__tip_force_kN": 2.0}, "load.tip_force_kN", "wrong unit kN: give tip_force_N, in N"),
        (
            {"load__tip_force_N": -2000.0},
            "load.tip_force_N",
            "is -2000.0, outside the plausible range 1e-06 to 1e+07 N",
        ),
        ({"load": None}, "load", "missing"),
        ({"loads": {}}, "loads", "unknown key; did you mean load?"),
        ({"sections__choose": "cheapest"}, "sections.choose", "must be 'free', 'stock' or 'fixed', is 'cheapest'"),
        ({"sections__least_wall_mm": 2.0}, "sections.least_wall_mm", "wrong unit mm: give least_wall_m, in m"),
        (
            {"sections__least_wall_m": 0.1},
            "sections.least_wall_m",
            "0.1 is not less than half of largest_width_m, 0.1",
        ),
        ({"outer_beam__wall_m": 0.08}, "outer_beam.wall_m", "0.08 is not less than half the width, 0.07"),
        (
            {"inner_beam__width_m": 0.1354},
            "inner_beam.width_m",
            "0.1354 does not fit inside the outer beam, whose opening is 0.1354",
        ),
        ({"inner_beam__wall_m": None}, "inner_beam", "width_m and wall_m go together: give both or neither"),
        ({"outer_beam__free_length_m": 1.7}, "outer_beam.free_length_m", "1.7 exceeds length_m, 1.5"),
        ({"outer_beam__free_length_m": None}, "outer_beam.free_length_m", "missing"),
        ({"safety__strength": 0.9}, "safety.strength", "is 0.9, outside the plausible range 1 to 1000"),
        ({"clearance__assembly_m": nan}, "clearance.assembly_m", "must be a finite number, is nan"),
        (
            {"payload__outer_end_mass_kg": [6.8, 0]},
            "payload.outer_end_mass_kg",
            "empty mass range: 6.8 is above 0.0; write [least, most]",
        ),
        (
            {"payload__outer_end_mass_kg": None},
            "payload.outer_end_mass_kg",
            "missing: the range [least, most] of mass on the outer tip",
        ),
        ({"payload": None}, "payload", "missing"),
        (
            {"controller__kind": "pid"},
            "controller.kind",
            "must be 'lag', 'proportional', 'structured', 'lqg', 'hinf' or 'scheduled', is 'pid'",
        ),
        (
            {"controller__gain_A_per_V": 0.1},
            "controller.gain_A_per_V",
            "unknown key; known here are largest_inner_end_mass_kg, sections, stages, added_sensors, kind",
        ),
        (
            {"controller__sections": 2},
            "controller.sections",
            "is for kind = 'structured', and the kind is 'lag'; leave it out or change the kind",
        ),
        (
            {"controller__kind": "lqg", "controller__stages": 4},
            "controller.stages",
            "is for kind = 'scheduled', and the kind is 'lqg'; leave it out or change the kind",
        ),
        ({"goal__peak_sensitivity": 1}, "goal.peak_sensitivity", "is 1, outside the plausible range 1.00001 to 1000"),
        ({"actuator__oil_stiffness_N_per_m": False}, "actuator.oil_stiffness_N_per_m", "must be a number, is False"),
        ({"name": ""}, "name", "must not be empty"),
    ],
)
def test_one_thing_wrong_is_named_by_key_and_reason(changes, named, reason):
    assert refused(changed(**changes)) == [(named, reason)]


def test_fixed_sections_must_be_given():
    table = changed(
        sections__choose="fixed",
        outer_beam__width_m=None,
        outer_beam__wall_m=None,
        inner_beam__width_m=None,
        inner_beam__wall_m=None,
    )
    reason = "sections.choose is 'fixed', so width_m and wall_m are needed"
    assert refused(table) == [("outer_beam", reason), ("inner_beam", reason)]
    assert parse(DesignProblem, table | {"sections": {"choose": "free"}}, "study.toml").sections.choose == "free"


def test_all_errors_come_at_once():
    table = changed(
        load__tip_force_N=0,
        inner_beam__width_m=0.15,
        outer_beam__material="wood",
        payload__outer_end_mass_kg=[1.0],
        goal__bandwidth_Hz=5.0,
    )
    assert {key for key, _ in refused(table)} == {
        "load.tip_force_N",
        "inner_beam.width_m",
        "outer_beam.material",
        "payload.outer_end_mass_kg",
        "goal.bandwidth_Hz",
    }


def test_a_prototype_is_no_study():
    """A prototype given where a study is wanted is told by its kind, not by a list of tables it lacks."""
    path = STUDY.parent / "prototypes" / "paper_remedy.toml"
    with pytest.raises(InputError) as caught:
        read_problem(path)
    ((key, reason),) = caught.value.problems
    assert key == "(whole file)"
    assert reason.startswith("is a prototype, where a study is expected")
