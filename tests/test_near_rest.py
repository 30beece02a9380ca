"""For what a verdict holds: claims that small motion does not keep are no yes, and one figure is one figure."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from beamdesign import Prototype, certify, read_prototype, write_prototype
from beamdesign.cli import app
from beamdesign.loop import loop
from beamdesign.plant.effects import causes, library
from beamdesign.proofs.certificate import Asked
from beamdesign.proofs.scope import bracketing, holds_for, near_rest, uncovered
from beamdesign.quantities import at_most, decimal, rigs_in_words, stated_bandwidth, stated_peak, stated_range

TAME = read_prototype(Path(__file__).parents[1] / "studies" / "prototypes" / "tame_lag.toml")
COMPLIANCE = Asked("compliance", 5.71e-8, 2.0)
PEAK = Asked("peak_sensitivity", 2.5)


def rig(*effects: str) -> Prototype:
    return TAME.but(effects={name: {} for name in effects}, guarantee=None)


def called(folder: Path, prototype: Prototype, *options: str) -> tuple[int, dict[str, Any], str]:
    write_prototype(prototype, folder / "p.toml")
    words = ["certify", str(folder / "p.toml"), *options, "--out", str(folder / "c.toml")]
    done = CliRunner().invoke(app, [*words, "--json", str(folder / "a.json")])
    return done.exit_code, json.loads((folder / "a.json").read_text()), done.output


@pytest.mark.parametrize(
    ("effect", "options", "status"),
    [
        ("valve_deadband", ["--peak-sensitivity", "2.5"], 0),
        ("valve_deadband", ["--bandwidth-Hz", "2"], 1),
        ("valve_deadband", ["--bandwidth-Hz", "2", "--linear"], 0),
        ("joint_backlash", [], 1),
        ("joint_backlash", ["--linear"], 0),
        ("sensor_lag", ["--bandwidth-Hz", "2"], 0),
        ("current_saturation", ["--bandwidth-Hz", "2"], 0),
    ],
)
def test_what_small_motion_does_not_keep_is_no_yes(
    effect: str, options: list[str], status: int, tmp_path: Path
) -> None:
    code, fields, said = called(tmp_path, rig(effect), *options)
    assert code == status
    assert fields["stable"] is fields["holds"] is True  # of the linear members
    assert bool(fields["reason"]) == (status == 1)
    assert [one["effect"] for one in fields["near_rest"]] == ([effect] if library()[effect].linear.near_rest else [])
    headline = said.splitlines()[0]
    assert "exactly these figures" in headline
    assert ("linear members only" in headline) == bracketing(rig(effect))


@pytest.mark.parametrize("effect", ["seal_friction", "valve_hysteresis", "valve_deadband_rounded"])
def test_the_loop_that_is_drawn_keeps_what_is_proved_of_a_rig_that_does_not_at_rest(effect: str) -> None:
    own = rig(effect)
    proved = certify(own, 0.0, 6.8).guaranteed
    assert proved is not None
    for mass in (0.0, 6.8):
        assert loop(own).at(mass).bandwidth_Hz(own.goal.compliance_m_per_N) < proved.bandwidth_Hz
        assert loop(own, performing=True).at(mass).bandwidth_Hz(own.goal.compliance_m_per_N) >= proved.bandwidth_Hz


def test_a_loop_that_is_not_stable_is_refuted_whatever_is_asked_of(tmp_path: Path) -> None:
    wild = rig("valve_deadband").but(controller=TAME.controller.but(gain_A_per_V=10.0))  # type: ignore[union-attr]
    code, fields, _ = called(tmp_path, wild, "--linear")
    assert (code, fields["stable"]) == (1, False)


def test_every_law_without_an_answer_to_small_motion_says_so() -> None:
    """A dead band answers nothing, friction and hysteresis hold, play lets go; smooth laws are their own slopes."""
    said = {name: effect.linear.near_rest for name, effect in causes().items() if effect.linear}
    assert {name for name, claim in said.items() if claim == "stability"} == {"joint_backlash", "joint_backlash_nut"}
    assert {name for name, claim in said.items() if claim == "compliance"} == {
        "seal_friction", "valve_deadband", "valve_deadband_rounded", "valve_hysteresis", "valve_hysteresis_magnetic",
    }  # fmt: skip
    assert all(library()[name].linear.laws is not None for name, claim in said.items() if claim)  # type: ignore[union-attr]


@pytest.mark.parametrize("loops", [{"narrow": 0.0}, {"wide": 0.0}, {"narrow": 0.0, "wide": 0.0}], ids=str)
def test_friction_of_either_loop_holds_small_motion(loops: dict[str, float]) -> None:
    left = near_rest(rig().but(effects={"empirical_friction_loop": loops}))
    assert [one.claim for one in left] == ["compliance"] * (len(loops) == 1)


def test_only_what_is_asked_for_stands_in_the_way_of_a_yes() -> None:
    both = rig("joint_backlash", "valve_deadband")
    assert [one.effect for one in near_rest(both)] == ["joint_backlash", "valve_deadband"]
    assert not near_rest(
        rig().but(effects={"joint_backlash": {"play_m": 0.0}, "valve_deadband": {"half_width_A": 0.0}})
    )
    assert not uncovered(rig("valve_deadband"), (), [PEAK])
    assert uncovered(rig("valve_deadband"), (), [PEAK, COMPLIANCE])
    assert uncovered(rig("joint_backlash"), (), [])
    assert holds_for(rig()) == f"for {rigs_in_words(0.0)}"
    assert " 1.9999996 " in rigs_in_words(1.9999996)  # and not two, of which nothing is proved


@pytest.mark.parametrize(
    ("effect", "claims", "moving", "yes"),
    [
        ("valve_deadband", [PEAK], False, True),
        ("valve_deadband", [COMPLIANCE], False, False),
        ("valve_deadband", [COMPLIANCE], True, True),  # by how far the tip strays
        ("joint_backlash", [], False, False),
    ],
)
def test_the_answer_of_the_function_is_that_of_the_command(
    effect: str, claims: list[Asked], moving: bool, yes: bool
) -> None:
    found = certify(rig(effect), 0.0, 1.0, claims, moving)
    assert found.holds  # of the linear members
    assert (found.yes, found.status) == (yes, "yes" if yes else "no")
    assert ("not proved of small motion" in found.reason) is not yes


def test_a_design_up_to_its_goal_is_not_told_to_be_beyond_it(tmp_path: Path) -> None:
    """A least limit is found to 1e-4 and rounded up: the goal between it and the true peak is what is stated."""
    found = certify(TAME, 0.0, 6.8).guaranteed
    assert found is not None
    limits = [found.peak_sensitivity * (1 - share) for share in (1e-5, 2e-5, 4e-5)]
    goal = next(one for one in limits if certify(TAME, 0.0, 6.8, [Asked("peak_sensitivity", one)]).holds)
    asked = TAME.but(goal=TAME.goal.but(peak_sensitivity=goal), guarantee=None)
    stated = certify(asked, 0.0, 6.8).guaranteed
    assert stated is not None
    assert stated.peak_sensitivity == goal
    code, fields, said = called(tmp_path, asked)
    assert (code, fields["guaranteed"]["peak_sensitivity"]) == (0, goal)
    assert "beyond" not in said
    missed = TAME.but(goal=TAME.goal.but(peak_sensitivity=found.peak_sensitivity / 1.01), guarantee=None)
    refused = certify(missed, 0.0, 6.8).guaranteed
    assert refused is not None
    assert refused.peak_sensitivity == found.peak_sensitivity


def test_print_of_what_is_guaranteed_is_that_figure(tmp_path: Path) -> None:
    _, fields, said = called(tmp_path, rig())
    figures = {float(text) for text in re.findall(r"\d+\.\d+", said)}
    assert {fields["guaranteed"]["bandwidth_Hz"], fields["guaranteed"]["peak_sensitivity"]} <= figures
    assert float(stated_peak(2.0001)) == 2.0001
    assert float(stated_peak(2.00000001)) > 2.0
    assert float(stated_bandwidth(4.79999999).split()[0]) < 4.8
    # Print of small figures rounds to the safe side as well.
    assert float(decimal(1.00001e-7, 3, "ROUND_CEILING")) > 1.00001e-7 > float(decimal(1.00001e-7, 3, "ROUND_FLOOR"))
    assert float(at_most(2.0001, "1")) > 2.0


@pytest.mark.parametrize(
    ("low", "high"), [(1.968442123, 17.79211499), (0.99949, 1.00051), (0.0, 6.8), (1.00001, 1.00002)]
)
def test_a_range_of_which_all_is_proved_is_told_no_wider(low: float, high: float) -> None:
    first, last = map(float, stated_range((low, high), 4).split(" to "))
    assert low <= first <= last <= high
