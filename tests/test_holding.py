"""What a design must hold: closed forms of pressure, flow and weight, what is refused, and whether changes are true."""

import json
import re
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import replace
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from finished_run import STUDY, finished_run
from typer.testing import CliRunner

from beamdesign import DesignProblem, Prototype, codesign, read_problem, run_design
from beamdesign.build.result_folder import statements
from beamdesign.cli import app
from beamdesign.controllers import Lag
from beamdesign.loop import loop
from beamdesign.plant.linear_reach import single_mode_reach
from beamdesign.records import parse, to_toml
from beamdesign.structure.lumped import lumped_beam, weighing_mass
from beamdesign.synthesis import codesign as sized
from beamdesign.synthesis import holding
from beamdesign.synthesis.changes import Change, changed
from beamdesign.synthesis.holding import Demanded, Holding, standing, working
from beamdesign.synthesis.law_design import Proved
from beamdesign.synthesis.law_search import Found
from beamdesign.synthesis.law_task import Search
from beamdesign.synthesis.loop_samples import Design
from beamdesign.synthesis.operating_limits import needs, needs_to_carry

pytestmark = pytest.mark.long

G = 9.80665
PAYLOAD = (0.0, 6.8)


def study(**changes: Any) -> DesignProblem:
    """The published study with values set under dotted keys, two underscores for the dot."""
    table = tomllib.loads(STUDY.read_text(encoding="utf-8"))
    for key, value in changes.items():
        name, entry = key.split("__")
        table.setdefault(name, {})[entry] = value
    return parse(DesignProblem, table, "study.toml")


LOADED = {"load__tip_force_N": 4000.0}
HEAVY = {"load__tip_force_N": 12000.0}
LADEN = {
    "load__tip_force_N": 800.0,
    "payload__outer_end_mass_kg": [0.0, 200.0],
    "clearance__under_load_m": 0.05,
}
STATED = {
    "servovalve": {"rated_current_A": 0.05},
    "supply": {"flow_m3_per_s": 2e-4},
    "actuator": {"stroke_m": 0.06},
}


def stated(**tables: dict[str, float]) -> tuple[DesignProblem, Prototype]:
    """A finished design and its problem with more figures stated, none of which is in the loop."""
    run = finished_run()
    assert run.prototype is not None
    changed = {name: getattr(run.prototype, name).but(**table) for name, table in tables.items()}
    return run.problem.but(**changed), run.prototype.but(**changed)


def of(held: Holding, name: str) -> Demanded:
    (found,) = (limit for limit in held.limits if limit.name == name)
    return found


def test_a_tube_weighs_three_eighths_at_its_tip() -> None:
    """A uniform beam held straight at its tip rests on it with 3 w L / 8: its sag w L^4 / 8 over the spring 3 / L^3."""
    _, rig = stated()
    record = rig.outer_beam
    assert record.width_m is not None
    assert record.wall_m is not None
    assert record.free_length_m is not None
    along = np.linspace(0.0, record.free_length_m, 20001)
    per_length = (record.width_m**2 - (record.width_m - 2 * record.wall_m) ** 2) * 2700.0
    # Work of the weight on the way of a unit force at the tip, over the way of the tip itself.
    shape = along**2 * (3 * along[-1] - along) / (2 * along[-1] ** 3)
    at_tip = float(np.trapezoid(per_length * shape, along)) + record.end_mass_kg
    assert weighing_mass(record) == pytest.approx(at_tip, rel=1e-6)
    bare = record.but(width_m=None, wall_m=None, stiffness_N_per_m=1e6, effective_mass_kg=4.0)
    assert weighing_mass(bare) == 4.0


def test_what_is_held_is_so_of_the_figures_stated_whatever_rigs_the_loop_is_proved_of() -> None:
    problem, rig = stated()
    held = standing(problem, rig, PAYLOAD)
    assert dict(held.rows())["holds, link level"] == f"{held.held}, of exactly these figures"


def test_pressure_is_load_and_weight_over_the_piston() -> None:
    problem, rig = stated()
    held = standing(problem, rig, PAYLOAD)
    weight = G * (6.8 + weighing_mass(rig.outer_beam))
    assert held.weight_N == pytest.approx(weight)
    assert of(held, "supply pressure").needed == pytest.approx((2000.0 + weight) / 1.13e-4)
    assert not held.reason
    assert not held.ways
    # At the very limit it holds; a newton more it does not.
    most = 20e6 * 1.13e-4 - weight
    for load, met in ((most * (1 - 1e-12), True), (most + 1.0, False)):
        asked = standing(problem.but(load=problem.load.but(tip_force_N=load)), rig, PAYLOAD)
        assert (of(asked, "supply pressure").met, not asked.reason) == (met, met)
    # Of a piston with unequal sides the smaller one counts.
    uneven = standing(problem, rig.but(effects={"unequal_piston_areas": {"asymmetry": 0.2}}), PAYLOAD)
    assert of(uneven, "supply pressure").needed == pytest.approx((2000.0 + weight) / (0.8 * 1.13e-4))


def test_flow_goes_with_the_root_of_the_pressure_that_is_left() -> None:
    """Of a small load beside a constant one: q = q_0 sqrt(1 - p_L / p_S); without one the two flows are the same."""
    _, rig = stated()
    free, loaded = (needs(rig, (2.0, 2.0), 1e-3, 3.0, constant) for constant in (0.0, 1500.0))
    assert free["no_load_flow_m3_per_s"] == pytest.approx(free["flow_m3_per_s"], rel=1e-5)
    held = loaded["force_N"] / 1.13e-4 / rig.supply.pressure_Pa
    assert loaded["no_load_flow_m3_per_s"] == pytest.approx(loaded["flow_m3_per_s"] / sqrt(1 - held), rel=1e-4)
    still = needs(rig, (2.0, 2.0), 1e-9, 3.0, 1500.0)
    inner = lumped_beam(rig.inner_beam).stiffness
    assert still["force_N"] == pytest.approx(1500.0, rel=1e-2)
    assert still["stroke_m"] == pytest.approx(1500.0 / inner, rel=2e-2)
    assert needs(rig, (2.0, 2.0), 800.0, 3.0, 1500.0)["current_A"] == np.inf  # beyond the stall load there is no flow


def test_the_tubes_do_not_touch_under_load_and_weight() -> None:
    """Statics: the inner beam gives way by load and all weight over its stiffness; the tubes are concentric before."""
    problem, rig = stated()
    outer, inner = rig.outer_beam, rig.inner_beam
    assert outer.width_m is not None
    assert outer.wall_m is not None
    assert inner.width_m is not None
    gap = (outer.width_m - 2 * outer.wall_m - inner.width_m) / 2
    weight = G * (6.8 + weighing_mass(outer) + weighing_mass(inner) + rig.payload.inner_end_mass_kg)
    closing = gap * lumped_beam(inner).stiffness - weight
    for share, met in ((1 - 1e-9, True), (1 + 1e-9, False)):
        asked = problem.but(load=problem.load.but(tip_force_N=share * closing))
        still = of(standing(asked, rig, PAYLOAD), "gap between the tubes")
        assert (still.available, still.met) == (pytest.approx(gap), met)
        assert [change.key for way in still.ways for change in way] == ["clearance.under_load_m"] * (not met)
    # Up to the bandwidth the inner tip moves by nearly the same: the outer one is not held quite still.
    for share, met in ((0.96, True), (1.04, False)):
        asked = problem.but(load=problem.load.but(tip_force_N=share * closing))
        moved = of(working(asked, rig, PAYLOAD, 0.2), "gap between the tubes")
        assert moved.needed == pytest.approx((share * closing + weight) / lumped_beam(inner).stiffness, rel=2e-2)
        assert moved.met is met


@pytest.mark.usefixtures("one_start")
def test_a_payload_that_closes_the_gap_is_refused_and_more_gap_is_enough() -> None:
    """The sections of a study leave the gap that it asks for under its load; the weight beside it takes more."""
    problem = study(load__tip_force_N=800.0, payload__outer_end_mass_kg=[0.0, 30.0])
    found = run_design(problem, sigmas=0.0)
    assert found.holding is not None
    assert [limit.name for limit in found.holding.missed] == ["gap between the tubes"]
    (touching,) = (one for one in statements(found) if "the tubes do not touch" in one.claim)
    assert touching.foundation == "refuted"
    ways = [way for way in found.ways if any(change.key == "clearance.under_load_m" for change in way)]
    assert ways
    assert all(run_design(changed(problem, way), sigmas=0.0).prototype is not None for way in found.ways)


def test_what_is_not_stated_is_not_asked_but_named() -> None:
    held = working(*stated(), PAYLOAD, 4.0)
    assert set(held.missing.values()) == {"servovalve.rated_current_A", "actuator.stroke_m", "supply.flow_m3_per_s"}
    assert not working(*stated(**STATED), PAYLOAD, 4.0).missing


@pytest.mark.parametrize(
    ("table", "key", "little"),
    [("servovalve", "rated_current_A", 1e-3), ("supply", "flow_m3_per_s", 1e-6), ("actuator", "stroke_m", 0.02)],
)
def test_too_little_of_the_hydraulics_is_refused_and_what_is_asked_for_is_enough(
    table: str, key: str, little: float
) -> None:
    assert not working(*stated(**STATED), PAYLOAD, 4.0).reason
    held = working(*stated(**STATED | {table: STATED[table] | {key: little}}), PAYLOAD, 4.0)
    (missed,) = held.missed
    assert missed.available == little
    ((change,),) = held.ways
    assert change.key == f"{table}.{key}"
    enough = STATED | {table: STATED[table] | {key: change.value}}
    assert not working(*stated(**enough), PAYLOAD, 4.0).reason


@pytest.mark.parametrize("share", [1.0, 10.0])
def test_what_is_missed_standing_and_working_has_changes_that_are_enough_for_both(share: float) -> None:
    """At a load beyond the supply's no current is enough: more pressure or area alone is, and each is told once.

    Less load is told where it leaves enough of the rated current, and only there.
    """
    problem, rig = stated(**STATED)
    least = of(working(problem, rig, PAYLOAD, 3.0), "rated current").needed
    problem, rig = stated(**STATED | {"servovalve": {"rated_current_A": share * least}})
    problem = problem.but(load=problem.load.but(tip_force_N=2150.0))
    held = working(problem, rig, PAYLOAD, 3.0)
    assert {limit.name for limit in held.missed} == {"supply pressure", "supply pressure while the load moves"}
    moving = of(held, "supply pressure while the load moves")  # of no current told, as none is enough
    assert moving.needed > of(held, "supply pressure").needed > moving.available
    told = {change.key: change for (change,) in held.ways}
    assert len(told) == len(held.ways)
    assert {"actuator.piston_area_m2", "supply.pressure_Pa"} <= told.keys()
    pressure = told["supply.pressure_Pa"].value
    strong = working(problem, rig.but(supply=rig.supply.but(pressure_Pa=pressure)), PAYLOAD, 3.0)
    assert of(strong, "rated current").needed < np.inf
    # With 2090 N beside its weight the supply's pressure is just enough, and the current needed more than with 2000 N.
    assert ("load.tip_force_N" in told) == (share > 1.0)
    if share > 1.0:
        assert not working(changed(problem, (told["load.tip_force_N"],)), rig, PAYLOAD, 3.0).missed


def test_the_inner_tube_bears_what_travels_up_to_the_bandwidth() -> None:
    """A tip load K x bends the clamp by K x L: up to f_o W_el, or the design resistance of EN 1999-1-1, 6.2.5.1(2)."""
    problem, rig = stated()
    tube, beam = finished_run().sizing.inner, problem.inner_beam
    stiffness = 3 * beam.material.youngs_modulus_Pa * tube.second_moment / beam.free_length_m**3
    strength = beam.material.proof_strength_Pa
    moments = strength * tube.elastic_modulus, tube.bending_resistance(strength, beam.material.buckling_constants)
    bears = of(working(problem, rig, PAYLOAD, 3.0), "travel that the inner tube bears")
    assert bears.available == pytest.approx(min(moments) / (stiffness * beam.free_length_m), rel=1e-9)
    assert bears.needed == needs_to_carry(rig, PAYLOAD, problem.load.tip_force_N, 3.0)["stroke_m"]
    assert bears.met
    soft = beam.material.but(proof_strength_Pa=0.9 * bears.needed / bears.available * strength)
    weak = working(problem, rig.but(inner_beam=rig.inner_beam.but(material=soft)), PAYLOAD, 3.0)
    (missed,) = weak.missed
    assert missed.name == bears.name
    ((way,),) = (missed.ways,)
    assert {change.key for change in way} == {"safety.strength", "safety.local_buckling"}


def test_a_gain_beyond_the_critical_one_of_all_bending_modes_is_a_caution(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of three payloads the least counts; proofs have one mode per beam."""
    problem, rig = stated()
    gain, least = rig.own_controller.gain_A_per_V, lambda at: at.critical_gain_all_A_per_V
    modes = of(working(problem, rig, PAYLOAD, 3.0), "critical gain with all bending modes")
    reached = [single_mode_reach(rig, kg) for kg in (0.0, 3.4, 6.8)]
    assert (modes.needed, modes.available) == (gain, min(map(least, reached)))
    assert modes.met
    assert not working(problem, rig, PAYLOAD, 3.0).caution
    early = replace(reached[0], critical_gain_all_A_per_V=0.5 * gain, critical_frequency_Hz=200.0)
    monkeypatch.setattr(holding, "single_mode_reach", lambda *given: early)
    held = working(problem, rig, PAYLOAD, 3.0)
    assert not held.missed
    assert "critical gain with all bending modes instead of" in held.caution
    ((loop_gain, from_Hz),) = of(held, modes.name).ways
    assert str(loop_gain) in held.caution
    assert from_Hz == ("goal.loop_gain_from_Hz", 160.0, False, 0.0)
    assert loop_gain.value <= 0.5 * abs(loop(rig).at(0.0).loop_response(np.array([160.0]))[0])


def test_a_bandwidth_that_is_of_no_use_is_no_design() -> None:
    problem, rig = stated()
    held = working(problem, rig, PAYLOAD, 0.05)
    (missed,) = held.missed
    assert (missed.needed, missed.available) == (0.1, 0.05)
    softer, slower = held.ways
    assert (softer[0].key, slower[0].key) == ("goal.compliance_m_per_N", "load.least_bandwidth_Hz")
    assert not working(changed(problem, slower), rig, PAYLOAD, 0.05).reason


@pytest.mark.parametrize("changes", [LOADED, LADEN], ids=["loaded", "laden"])
@pytest.mark.usefixtures("one_start")
def test_what_cannot_be_held_is_not_certified_and_each_change_is_true(
    changes: dict[str, Any], tmp_path: Path, tried: Callable[[int], int]
) -> None:
    problem = study(**changes)
    (tmp_path / "study.toml").write_text(to_toml(problem), encoding="utf-8")
    words = ["run", str(tmp_path / "study.toml"), "--nominal", "--out", str(tmp_path / "out")]
    words += ["--json", str(tmp_path / "a.json")]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 1
    assert not (tmp_path / "out").exists()
    fields = json.loads((tmp_path / "a.json").read_text())
    assert fields["prototype"] is None
    assert fields["reason"] in done.output.replace("\n", " ")
    pressure = next(limit for limit in fields["holding"]["limits"] if limit["name"] == "supply pressure")
    held = fields["holding"]["load_N"] + fields["holding"]["weight_N"]
    assert (pressure["met"], pressure["needed"], pressure["available"]) == (False, pytest.approx(held / 1.13e-4), 20e6)
    assert fields["change"]
    for words in fields["change"][: tried(len(fields["change"]))]:
        written = (f"{key} = {value}" for key, value in re.findall(r"\((\S+) = ([^)]+)\)", words))
        pairs = [(*tomllib.loads(line.replace(".", "__", 1)).items(),) for line in written]
        given = {key.replace("__", "."): value for ((key, value),) in pairs}
        assert all(value[0] == problem.asked_kg()[0] for value in given.values() if isinstance(value, list))
        way = tuple(Change(key, np.ravel(value)[-1].item()) for key, value in given.items())
        assert way
        assert run_design(changed(problem, way), sigmas=0.0).prototype is not None


def test_codesign_asks_the_same_of_what_it_finds(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if its search had found what it starts from."""

    def at_once(task: Search, starts: Sequence[Design], report: object) -> Found:
        law = Lag(gain_A_per_V=0.03, pole_Hz=1.75, zero_Hz=26.0)
        return Found(Proved(law, 1.0, 3.0, 2.0, starts[0].variables), (3.0,), 1)

    monkeypatch.setattr(sized, "search", at_once)
    problem = read_problem(STUDY.with_name("codesign.toml"))
    for force_N, missed in ((2000.0, []), (2300.0, ["supply pressure"])):
        found = codesign(problem.but(load=problem.load.but(tip_force_N=force_N)), PAYLOAD, 3.0, sigmas=0.0)
        assert found.holding is not None
        assert [limit.name for limit in found.holding.missed] == missed
        assert (found.point is None) == bool(found.change) == bool(found.reason) == bool(missed)


def test_a_change_that_no_study_may_state_is_not_proposed() -> None:
    """A supply of more than 100 MPa is refused where it is read; sections that cannot be had are no answer."""
    _, rig = stated()
    heavy = standing(study(**HEAVY), rig, PAYLOAD)
    keys = {"load.tip_force_N", "actuator.piston_area_m2", "clearance.under_load_m"}
    assert {change.key for way in heavy.ways for change in way} == keys
    laden = standing(study(**LADEN), rig, (0.0, 5000.0))
    assert {change.key for way in laden.ways for change in way} == {"payload.outer_end_mass_kg"}


def test_print_never_makes_equal_what_is_not() -> None:
    limit = Demanded("supply pressure", 20e6 * (1 + 1e-9), 20e6, "Pa")
    assert not limit.met
    needed, available = limit.words.split(" of supply pressure instead of ")
    assert float(needed.split()[0]) > float(available.split()[0])
    assert Demanded("supply pressure", 20e6, 20e6, "Pa").met
