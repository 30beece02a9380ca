"""What a public function gives shows itself: a short text, a table for a notebook, plain values for a file."""

import copy
import json
import pickle
import re
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from flint import arb, fmpq, fmpq_mat, fmpq_mpoly_ctx, fmpq_poly, fmpz, fmpz_poly

import beamdesign
from beamdesign.result import Result

ROOT = Path(__file__).parent.parent


@dataclass(frozen=True, repr=False)
class Weighed(Result):
    mass_kg: float
    parts: dict[str, float]
    reason: str = ""


def test_a_yes_is_short_and_a_no_tells_why():
    found = Weighed(2.0, {"tube_kg": 1.23456789, "rest_kg": float("inf")})
    assert (found.yes, found.status) == (True, "yes")
    assert repr(found) == "<Weighed: yes; mass_kg=2, parts.tube_kg=1.234568>"
    refused = Weighed(2.0, {}, "too <heavy>")
    assert not refused.yes
    assert "too <heavy>" in repr(refused)
    assert "too &lt;heavy&gt;" in refused._repr_html_()


def test_a_guaranteed_bandwidth_is_shown_as_it_is_proved():
    """To four digits it read 3.491 Hz, more than is proved."""
    found = beamdesign.certify(beamdesign.read_prototype(ROOT / "studies" / "prototypes" / "tame_lag.toml"))
    assert found.guaranteed is not None
    for text in (repr(found), found._repr_html_()):
        (hertz,) = re.findall(r"guaranteed\.bandwidth_Hz(?:=|</td><td>)([\d.]+)", text)
        assert float(hertz) == found.guaranteed.bandwidth_Hz


def test_rows_and_page_and_file_hold_the_same_figures():
    found = Weighed(2.0, {"tube_kg": 1.23456, "rest_kg": float("inf")})
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["parts"] == {"tube_kg": 1.23456, "rest_kg": None}
    assert found.rows() == [("mass_kg", 2.0), ("parts.tube_kg", 1.23456)]
    assert "<td>parts.tube_kg</td><td>1.23456</td>" in found._repr_html_()


@dataclass(frozen=True, repr=False)
class Found(Result):
    prototype: dict[str, float]
    bandwidth_Hz: float

    def rows(self) -> list[tuple[Any, float]]:
        return [*super().rows(), (0.9779327685, 2.0)]


def test_what_was_found_stands_before_its_rig_and_no_name_is_a_figure_of_ten_digits():
    assert repr(Found({"mass_kg": 3.0}, 4.0)) == "<Found: yes; bandwidth_Hz=4, prototype.mass_kg=3, 0.9779328=2>"


def test_equal_figures_have_one_hash_and_figures_that_are_not_finite_differ():
    for one, other in ((Weighed(2, {}), Weighed(2.0, {})), (Weighed(0.0, {}), Weighed(-0.0, {}))):
        assert one == other
        assert hash(one) == hash(other)
    endless = [Weighed(figure, {}) for figure in (float("inf"), -float("inf"), float("nan"), None)]  # type: ignore[arg-type]
    assert len({*endless, Weighed(float("inf"), {}), Weighed(float("nan"), {})}) == len(endless)


@dataclass(frozen=True, repr=False)
class Made(Result):
    mass_kg: float
    series: tuple[float, ...] = field(default=(1.0,), repr=False)
    write: Any = field(default=print, repr=False, compare=False)


def test_what_makes_a_record_is_none_of_its_values():
    assert Made(2.0).to_dict() == {"mass_kg": 2.0, "series": [1.0]}


@cache
def rig(name: str) -> beamdesign.Prototype:
    return beamdesign.read_prototype(ROOT / "studies" / "prototypes" / f"{name}.toml")


RESULTS = {
    "critical_gain": lambda: beamdesign.critical_gain(rig("tame_lag"), 2.0),
    "certify": lambda: beamdesign.certify(rig("tame_lag")),
    "certify_not_stable": lambda: beamdesign.certify(rig("paper_remedy")),
    "certify_box": lambda: beamdesign.certify_box(rig("tame_lag"), (2.0, 3.0), 2.0, ["sensor_gain", "outer_damping"]),
    "certify_switching": lambda: beamdesign.certify_switching(rig("tame_lag"), (2.0, 3.0), 0.5),
    "arm": lambda: beamdesign.arm(rig("arm")),
    "code": lambda: beamdesign.code(rig("tame_lag"), 2e4),
    "stiffness": lambda: beamdesign.stiffness(rig("compliant")),
    "size": lambda: beamdesign.size(beamdesign.read_problem(ROOT / "studies" / "prototype.toml")),
    "prove": lambda: beamdesign.prove(("k", "s**2 + s + 1"), {"k": (1, 2)}),
    "simulate": lambda: beamdesign.simulate(
        rig("paper_remedy"), beamdesign.read_scenario(ROOT / "studies" / "scenarios" / "kick.toml")
    ),
}


@pytest.mark.usefixtures("few_climbs")
@pytest.mark.parametrize("name", RESULTS)
def test_a_result_is_plain_in_a_file_and_whole_in_a_copy_and_in_another_process(name: str):
    """A result comes back from a process only pickled, and an exact number has to be that number there."""
    found = RESULTS[name]()
    values = found.to_dict()
    assert json.loads(json.dumps(values, allow_nan=False))
    assert found.rows()
    assert " at 0x" not in json.dumps(values)
    for again in (pickle.loads(pickle.dumps(found)), copy.deepcopy(found)):
        assert (again.status, again.rows(), again.to_dict()) == (found.status, found.rows(), values)
        assert getattr(again, "text", "") == getattr(found, "text", "")


def test_exact_numbers_are_the_same_in_a_copy():
    x, y = fmpq_mpoly_ctx.get(["x", "y"], "degrevlex").gens()
    third = fmpq(1, 3)
    exact = [fmpz(7), third, fmpz_poly([1, 2]), fmpq_poly([third, 2]), fmpq_mat(1, 2, [third, 2]), third * x * y + 2]
    for number in exact:
        assert pickle.loads(pickle.dumps(number)) == copy.deepcopy(number) == number
    for ball in (arb("3.9"), arb(third), arb(0), arb("1 +/- 0.25"), arb("1e-400")):
        again = pickle.loads(pickle.dumps(ball))
        assert again.mid().fmpq() == ball.mid().fmpq()
        assert ball.rad().fmpq() <= again.rad().fmpq() <= ball.rad().fmpq() * (1 + fmpq(1, 2**29))
    assert not pickle.loads(pickle.dumps(arb("inf"))).is_finite()


def test_a_loop_that_diverges_is_a_no_as_of_the_command():
    found = RESULTS["simulate"]()
    assert (found.stable, found.yes, found.status) == (False, False, "no")
    assert found.reason.startswith("without_payload: the outer tip passed 0.02 m")
    assert [row[1] for row in found.rows()] == ["yes", "no"]


@pytest.mark.parametrize(("contact", "yes"), [("none", True), ("passive", False)])
def test_a_controller_judged_as_it_is_answers_as_the_command(contact: str, yes: bool):
    """Which exits with 1 where contact is not what it has to be."""
    found = beamdesign.stiffness(rig("tame_lag"), contact=contact)
    assert (found.yes, bool(found.reason)) == (yes, not yes)
    assert not beamdesign.stiffness(rig("paper_remedy"), contact="none").yes
