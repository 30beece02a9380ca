"""The published rig over its tolerances, payload and delay: expression, hulls, box, and the command that proves it."""

import json
import re
from functools import partial
from math import pi, sqrt
from pathlib import Path

import numpy as np
import pytest
from flint import ctx, fmpq, fmpq_poly
from gap_sets import TOLERANCE
from typer.testing import CliRunner

from beamdesign import InputError, Prototype, check, write_prototype
from beamdesign.checker.__main__ import main as prove_again
from beamdesign.cli import app
from beamdesign.controllers import Lag, Proportional
from beamdesign.loop import loop
from beamdesign.plant.members import STANDARD_GRAVITY
from beamdesign.polynomial import exact, is_hurwitz, nearest, squared_magnitude
from beamdesign.polynomial import roots as roots_of
from beamdesign.proofs.box import box_of, certify_box
from beamdesign.proofs.box_member import Quasipolynomial, member
from beamdesign.proofs.frames import Between, Cell, Frames
from beamdesign.proofs.rig_family import rig_family
from beamdesign.proofs.tolerance_box import _bracket, largest_scaling, tolerance_box
from beamdesign.proofs.writer import prototype_table
from beamdesign.prototype import Payload, Sensor, Tolerance


@pytest.fixture
def rig(paper: Prototype) -> Prototype:
    """The published rig with a lag at a gain that leaves room, its payload and the builder's tolerances."""
    return paper.but(
        controller=Lag(gain_A_per_V=0.05, pole_Hz=1.7, zero_Hz=20.0),
        payload=Payload(inner_end_mass_kg=4.5, outer_end_mass_kg=(0.0, 6.8)),
        tolerance=TOLERANCE,
    )


@pytest.mark.parametrize("filter_Hz", [None, 400.0])
@pytest.mark.parametrize(
    "controller", [Proportional(gain_A_per_V=0.02), Lag(gain_A_per_V=0.1, pole_Hz=1.7, zero_Hz=20.0)]
)
def test_expression_is_the_rigs_characteristic_polynomial(paper, controller, filter_Hz):
    rng = np.random.default_rng(3)
    for _ in range(4):
        by = rng.uniform(0.5, 2.0, 12)
        changed = paper.but(
            outer_beam=paper.outer_beam.but(stiffness_N_per_m=4.9e5 * by[0], effective_mass_kg=3.9 * by[1]),
            inner_beam=paper.inner_beam.but(stiffness_N_per_m=1.6e5 * by[2], damping_ratio=0.05 * by[3]),
            actuator=paper.actuator.but(piston_area_m2=1e-4 * by[4], oil_stiffness_N_per_m=1e7 * by[5]),
            servovalve=paper.servovalve.but(
                flow_gain_m3_per_s_per_A=1e-2 * by[6],
                leakage_m3_per_s_per_Pa=4e-13 * by[7],
                natural_frequency_Hz=150 * by[8],
                damping_ratio=0.5 * by[9],
            ),
            sensor=Sensor(gain_V_per_m=1000 * by[10], filter_Hz=filter_Hz),
            payload=Payload(inner_end_mass_kg=4.5 * by[11]),
            controller=controller,
        )
        mass = exact(round(6.8 * by[11], 3))
        ours = rig_family(changed)
        one = member(ours.over({}), {**ours.values, "outer_end_mass": mass})
        theirs = loop(changed).characteristic.at(mass)
        assert one.plain + one.late == theirs * ((one.plain + one.late)(1) / theirs(1))


def test_hulls_hold_the_members(rig):
    """At both ends of an interval every member lies on the far side of each line, in between but for the stray.

    What is looked at of it is p over the lags of valve and law; this rig has no filter.
    """
    box = tolerance_box(rig, 3.0, delay_s=(0.0, 5e-4))
    statement = rig_family(rig).over(box.ranges)
    assert len(statement.divisors) == 2
    rng = np.random.default_rng(5)
    quarters = dict(zip(statement.varying, rng.integers(0, 4, len(statement.varying)).tolist(), strict=True))
    corner = {name: (fmpq(i, 4), fmpq(i + 1, 4)) for name, i in quarters.items()}
    cell, none = Cell(statement, corner), fmpq_poly([0])
    with ctx.workprec(96):
        for w1, w2 in ((fmpq(300), fmpq(310)), (fmpq(2000), fmpq(2300))):
            frames, both = Frames(statement, [(cell, w1), (cell, w2)]), np.array([0, 1])
            bend = frames.bend(Between(both[:1], both[1:], np.array([float((w2 - w1).p) ** 2 / 8]))).item()
            for _ in range(20):
                point = {}
                for name, (low, high) in cell.values.items():
                    value = low + (high - low) * fmpq(int(rng.integers(0, 9)), 8)
                    point[name] = 1 / value if name in statement.reciprocal else value
                plain, whole = (
                    statement.value(partial(statement.leaf_at, point=point), none + late, none + late)
                    for late in (0, 1)
                )
                one = Quasipolynomial(plain, whole - plain, point["delay"])
                direction = tuple(int(x) for x in rng.integers(-100, 100, 2))
                size = np.hypot(*direction)
                least = frames.least(both, np.array([direction, direction]).T).tolist()
                for w, allowed in (
                    (w1, least[0]),
                    (w2, least[1]),
                    ((w1 + w2) / 2, min(least) - size * bend * float((w2 - w1).p) ** 2 / 8),
                ):
                    s = 1j * float(w.p) / float(w.q)
                    p = sum(float(c.p) / float(c.q) * s**i for i, c in enumerate(one.plain.coeffs()))
                    late = sum(float(c.p) / float(c.q) * s**i for i, c in enumerate(one.late.coeffs()))
                    p += late * np.exp(-s * float(one.delay.p) / float(one.delay.q))
                    for leaf in statement.divisors:
                        p /= np.polyval([nearest(c) for c in statement.leaf_at(leaf, point).coeffs()[::-1]], s)
                    along = (p * complex(direction[0], -direction[1])).real
                    assert along >= allowed - 1e-9 * size * abs(p)


def test_all_figures_and_the_payload_at_once(rig):
    verdict = certify_box(rig, tolerance_box(rig, 3.0, delay_s=(0.0, 2e-5)))
    assert verdict.stable is True
    assert len(verdict.box.names) == 15
    assert verdict.volumes == (1, 0, 0)
    assert verdict.reason == ""


def test_largest_scaling_of_the_rigs_tolerances(rig):
    found = largest_scaling(rig, tolerance_box(rig, 1.0))
    assert 3.0 < found.proved < found.refuted < 3.3
    assert found.refuted < 1.03 * found.proved
    assert found.verdict.box.ranges["outer_end_mass"] == (0, exact(6.8))  # asked for, not a tolerance
    point = found.unstable_point
    one = member(rig_family(rig).over({}), point)
    assert not is_hurwitz(one.plain + one.late)


def test_effects_span_what_they_do_of_the_rigs_of_a_scaled_box(rig):
    """A smaller piston has more of the supply taken by a load, and more flow with it: up to all, where none is left."""
    loaded = rig.but(
        effects={"pressure_dependent_flow": {"supply_pressure_Pa": 1.4e7}},
        tolerance=Tolerance(piston_area=0.05),
        controller=rig.controller.but(gain_A_per_V=0.08),
        payload=Payload(inner_end_mass_kg=2.5, outer_end_mass_kg=(0.0, 1.0), largest_force_N=1000.0),
    )
    found = largest_scaling(loaded, tolerance_box(loaded, 1.0))
    assert found.verdict.stable
    assert 1.5 < found.proved < found.limit < 10
    assert found.verdict.box.ranges == tolerance_box(loaded, found.proved).ranges
    area = found.verdict.box.ranges["piston_area"][0]
    share = (1000 + STANDARD_GRAVITY) / (float(area) * 1.4e7)
    assert float(found.verdict.box.ranges["effect_gain"][1]) == pytest.approx(sqrt(1 + share))


def test_a_box_spans_what_effects_do_under_the_payload_that_is_asked_for(rig):
    """Orifices span a gain under a load alone, which a rig without a payload of its own has none of."""
    bare = rig.but(payload=Payload(inner_end_mass_kg=4.5), effects={"pressure_dependent_flow": {}})
    box, loaded = (tolerance_box(one, 1.0, ["flow_gain"], (0.0, 6.8)) for one in (bare, rig.but(effects=bare.effects)))
    assert box.ranges == loaded.ranges
    low, high = box.ranges["effect_gain"]
    assert low < 1 < high
    found = certify_box(bare, box)
    assert found.stable
    assert check(found.certificate).valid


def test_tolerance_box(rig):
    box = tolerance_box(rig, 2.0, names=["flow_gain", "valve_frequency"], delay_s=(0.0, 1e-4))
    assert box.names == ("flow_gain", "valve_frequency", "outer_end_mass", "delay")
    assert box.ranges["flow_gain"] == (exact(1.13e-2) * fmpq(9, 10), exact(1.13e-2) * fmpq(11, 10))
    assert box.rigid == {"outer_end_mass", "delay"}
    half = box.scaled(fmpq(1, 2))
    assert half.ranges["flow_gain"] == (exact(1.13e-2) * fmpq(19, 20), exact(1.13e-2) * fmpq(21, 20))
    assert half.ranges["outer_end_mass"] == box.ranges["outer_end_mass"]
    heavier = rig.but(tolerance=TOLERANCE.but(outer_end_mass=0.1))
    assert tolerance_box(heavier, 1.0).ranges["outer_end_mass"] == (0, exact(6.8) * fmpq(11, 10))
    assert "controller_gain" in tolerance_box(rig, spread={"controller_gain": 0.01}).names


def test_dashpots_span_what_ratio_stiffness_and_mass_give(rig):
    low, high = (float(end.p) / float(end.q) for end in tolerance_box(rig, 3.0).ranges["outer_damping"])
    stiffness, mass, ratio = 486_800.0, 3.9, 0.05
    ends = [2 * ratio * (1 + s * 0.6) * sqrt(stiffness * (1 + s * 0.09) * mass * (1 + s * 0.06)) for s in (-1, 1)]
    assert low <= ends[0]
    assert high >= ends[1]
    assert (low, high) == pytest.approx(tuple(ends), rel=1e-6)


def test_refused_boxes(rig, paper):
    with pytest.raises(InputError, match="reach zero"):
        tolerance_box(rig, 6.0)
    doubtful = rig.but(tolerance=rig.tolerance.but(outer_end_mass=0.5))
    with pytest.raises(InputError, match=r"outer_end_mass.*reach zero"):
        tolerance_box(doubtful, 2.0, outer_end_mass=(1.0, 2.0))
    assert tolerance_box(doubtful, 2.0, outer_end_mass=(0.0, 2.0)).ranges["outer_end_mass"] == (0, 4)
    with pytest.raises(InputError, match="no such figure"):
        tolerance_box(rig, names=["stiffness"])
    with pytest.raises(InputError, match="no tolerance"):
        tolerance_box(rig, names=["controller_gain"])
    with pytest.raises(ValueError, match="controller"):
        tolerance_box(paper)
    with pytest.raises(ValueError, match="no parameter"):
        certify_box(rig, box_of({"friction": (0.0, 1.0)}))
    with pytest.raises(ValueError, match="not a range"):
        certify_box(rig, box_of({"outer_end_mass": (-1.0, 1.0)}))
    with pytest.raises(ValueError, match="empty range"):
        box_of({"q": (1.0, 0.0)})
    with pytest.raises(ValueError, match="outside"):
        box_of({"q": (0.0, 1.0)}, {"q": 2.0})


def test_random_members_of_a_proved_box_are_stable(rig):
    box = tolerance_box(rig, 2.0)
    assert certify_box(rig, box).stable is True
    statement, rng = rig_family(rig).over(box.ranges), np.random.default_rng(1)
    for _ in range(200):
        point = dict(rig_family(rig).values)
        for name, (low, high) in box.ranges.items():
            point[name] = low + (high - low) * fmpq(int(rng.integers(0, 5)), 4)
        one = member(statement, point)
        assert is_hurwitz(one.plain + one.late)


def test_budget_runs_out_honestly(rig):
    verdict = certify_box(rig, tolerance_box(rig, 2.0), budget=20)
    assert verdict.stable is None
    assert verdict.looked_at == 20
    assert verdict.certificate == ""
    assert "20 pieces" in verdict.reason


def test_rig_with_delay_agrees_with_its_loop_response(rig):
    """Where |L| = 1 the delay that turns L to -1 is (pi + arg L) / w; the margin is the least of them."""
    fixed = rig.but(payload=Payload(inner_end_mass_kg=4.5))
    bare = loop(fixed).at(0.0)
    crossovers = [
        sqrt(root.real)
        for root in roots_of(squared_magnitude(bare.loop_numerator) - squared_magnitude(bare.loop_denominator))
        if root.real > 0 and abs(root.imag) < 1e-9 * abs(root)
    ]
    phases = np.angle(bare.loop_response(np.array(crossovers) / (2 * pi)))
    limit = min((pi + phase) % (2 * pi) / w for phase, w in zip(phases, crossovers, strict=True))
    proved = certify_box(fixed, box_of({"delay": (0.0, float(0.99 * limit))}))
    assert proved.stable is True
    assert check(proved.certificate, prototype_table(fixed)).valid
    assert certify_box(fixed, box_of({"delay": (0.0, float(1.01 * limit))}), volumes=False).stable is False


@pytest.mark.usefixtures("few_climbs")
def test_command(rig, tmp_path: Path):
    path, out, table = tmp_path / "rig.toml", tmp_path / "proof" / "box.toml", tmp_path / "result.json"
    write_prototype(rig, path)
    run = CliRunner().invoke
    few = ["--only", "valve_frequency", "--only", "oil_stiffness"]
    done = run(app, ["certify-box", str(path), "--sigmas", "1", *few, "--out", str(out), "--json", str(table)])
    assert done.exit_code == 0, done.output
    result = json.loads(table.read_text())
    assert result["stable"] is True
    assert result["box"]["valve_frequency_Hz"] == pytest.approx([142.5, 157.5])
    assert result["certificate"] == str(out)
    assert prove_again([str(out), str(path)]) == 0
    altered = re.sub(r'(outer_end_mass = \[\s*"0",\s*)"6.8"', r'\1"99"', out.read_text())
    assert altered != out.read_text()
    out.write_text(altered)
    assert prove_again([str(out)]) == 1

    refuted = ["--only", "flow_gain", "--outer-end-mass", "0:40", "--out", str(out), "--json", str(table)]
    done = run(app, ["certify-box", str(path), *refuted])
    assert done.exit_code == 1
    result = json.loads(table.read_text())
    assert result["stable"] is False
    assert 6.8 < result["unstable_point"]["outer_end_mass_kg"] <= 40
    assert result["stable_fraction"] + result["unstable_fraction"] + result["undecided_fraction"] == pytest.approx(1)
    assert prove_again([str(out), str(path)]) == 0


@pytest.mark.usefixtures("few_climbs")
def test_a_box_and_how_far_it_is_proved_are_told_rounded_inwards(rig, tmp_path: Path):
    path = tmp_path / "rig.toml"
    write_prototype(rig.but(tolerance=Tolerance()), path)
    asked = ["certify-box", str(path), "--outer-end-mass", "3.00004:6.79956", "--out", str(tmp_path / "c.toml")]
    done = CliRunner().invoke(app, asked)
    assert done.exit_code == 0, done.output
    assert re.search(r"outer_end_mass_kg\W+3\.00004\W+6\.79956\W", done.output)  # not from 3 to 6.8 kg
    reason = _bracket(fmpq(259376, 100000), fmpq(26001, 10000), fmpq(265018, 100000), fmpq(10))
    assert reason == "proved up to 2.593, undecided at 2.601, refuted at 2.651"


@pytest.mark.usefixtures("few_climbs")
def test_where_nothing_scales_nothing_is_said_to_be_proved_up_to_a_factor(rig, tmp_path: Path):
    """Payload and delay are rigid: a box of these alone is itself at every factor."""
    path, table = tmp_path / "rig.toml", tmp_path / "result.json"
    write_prototype(rig.but(tolerance=Tolerance(outer_end_mass=0.01)), path)
    asked = ["certify-box", str(path), "--scaling", "--each", "--out", str(tmp_path / "c.toml"), "--json", str(table)]
    done = CliRunner().invoke(app, [*asked, "--delay-s", "1e-5"])
    assert done.exit_code == 0, done.output
    assert "nothing scales" in done.output
    assert "proved up to" not in done.output
    found = json.loads(table.read_text())
    assert set(found["box"]) == {"outer_end_mass_kg", "delay_s"}
    assert (found["stable"], found["largest_scaling"], found["scaling_of_each"]) == (True, None, [])


@pytest.mark.parametrize(
    ("arguments", "key"),
    [
        (["--sigmas", "-1"], "--sigmas"),
        (["--sigmas", "6"], "reach zero"),
        (["--only", "colour"], "colour"),
        (["--outer-end-mass", "3:1"], "3:1"),
        (["--delay-s", "nan"], "--delay-s"),
    ],
)
def test_command_refuses_bad_input(rig, tmp_path: Path, arguments, key):
    path = tmp_path / "rig.toml"
    write_prototype(rig, path)
    result = CliRunner().invoke(app, ["certify-box", str(path), *arguments])
    assert isinstance(result.exception, InputError)
    assert key in str(result.exception)


def test_command_needs_a_controller(paper, tmp_path: Path):
    path = tmp_path / "bare.toml"
    write_prototype(paper, path)
    result = CliRunner().invoke(app, ["certify-box", str(path)])
    assert isinstance(result.exception, InputError)
    assert "controller" in str(result.exception)
