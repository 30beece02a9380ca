"""Certificates over all linear members of a prototype with effects: dense grids, replay, and the nonlinear rig."""

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flint import fmpq, fmpq_mpoly_ctx
from forging import altered, resealed
from rigs_of_effects import with_effects
from typer.testing import CliRunner

from beamdesign import Prototype, certify, check, critical_gain, simulate, specify, tune, write_prototype
from beamdesign.build.folder import write_specification
from beamdesign.checker import Unreadable
from beamdesign.cli import app
from beamdesign.controllers import Lag, Observer
from beamdesign.diagnosis.redesign import redesign, terms
from beamdesign.loop import close_loop, loop, rig_loop
from beamdesign.plant.effects import causes, library
from beamdesign.plant.members import family
from beamdesign.polynomial import exact
from beamdesign.proofs.box import certify_box
from beamdesign.proofs.box_member import member as member_of
from beamdesign.proofs.certificate import Asked
from beamdesign.proofs.performance import bandwidth, least_limit
from beamdesign.proofs.rectangle import Rectangle
from beamdesign.proofs.rig_family import rig_family
from beamdesign.proofs.tolerance_box import between, tolerance_box
from beamdesign.proofs.value_set import control_points
from beamdesign.proofs.writer import prototype_table
from beamdesign.prototype import Payload, Tolerance
from beamdesign.scenario import Scenario, ScenarioRecord, Step
from beamdesign.sweep import answers, case
from beamdesign.synthesis.operating_limits import envelope

CLAIMS = (
    Asked("peak_sensitivity", 3.0),
    Asked("compliance", 5.71e-8, 1.0),
    Asked("gain_margin", 1.1),
    Asked("decay_rate", 0.1),
)


TWO_SENSORS = Observer(
    gain_A_per_V=0.05,
    sensors=("displacement_m", "load_pressure_Pa"),
    a=((-10.0,),),
    b=((9.0, 1e-8),),
    c=(1.0,),
    d=(0.1, 1e-9),
)


@pytest.fixture
def tame(paper: Prototype) -> Prototype:
    return paper.but(
        controller=Lag(gain_A_per_V=0.05, pole_Hz=1.75, zero_Hz=26.0),
        payload=Payload(inner_end_mass_kg=2.0, outer_end_mass_kg=(0.0, 6.8)),
    )


@pytest.mark.parametrize("name", sorted(causes()))
def test_every_effect_is_certified_and_proved_again_from_the_text(tame: Prototype, name: str):
    """The replay rebuilds each member from impedances of its parts and shares no code with the proof."""
    found = certify(with_effects(tame, name), 0.0, 6.8, CLAIMS)
    again = check(found.text)
    assert found.stable
    assert again.valid, again.failed
    assert f"# {name}: {library()[name].linear.covers}" in found.text
    assert found.scope[0].startswith(name)
    linear = {"mount_compliance", "second_beam_mode", "transport_delay", "uneven_leakage"}
    linear |= {"sensor_lag", "sensor_lag_second_order"}
    assert ("not the nonlinear loop" in found.scope[-1]) == (name not in linear)


def test_a_larger_load_widens_what_goes_with_it(tame: Prototype):
    """At 904 N the load pressure is two fifths of the supply; the root of what is left is the gain."""
    loaded = with_effects(tame, "pressure_dependent_flow")
    loaded = loaded.but(payload=loaded.payload.but(largest_force_N=0.4 * 20e6 * 1.13e-4))
    found = certify(loaded, 0.0, 0.0)
    assert "factor on the gain from 0.774597 to 1.18321" in found.text
    assert "steady load of up to 904 N" in found.text
    assert (
        found.guaranteed.bandwidth_Hz
        < certify(with_effects(tame, "pressure_dependent_flow"), 0.0, 0.0).guaranteed.bandwidth_Hz
    )
    assert check(found.text).valid


def test_effects_in_company_are_proved_again(tame: Prototype):
    names = ("joint_backlash", "mount_compliance", "second_beam_mode", "unequal_piston_areas")
    found = certify(with_effects(tame, *names), 0.0, 0.0)
    again = check(found.text)
    assert found.stable
    assert again.valid, again.failed
    assert found.text.count("[[loop]]") == 2


@pytest.mark.parametrize("names", [("joint_backlash", "mount_compliance"), ("entrained_air", "valve_hysteresis")])
def test_with_numbers_for_what_does_not_vary_every_member_is_the_same(tame: Prototype, names: tuple[str, ...]):
    """Exactly, to a factor: at both ends and between them."""
    rig = with_effects(tame, *names)
    box = tolerance_box(rig, 0.0, None, (0.0, 6.8))
    whole, few = (rig_family(rig, varying=box.ranges, numbers=numbers) for numbers in (False, True))
    assert set(box.ranges) <= set(few.values) < set(whole.values)
    assert "outer_stiffness" not in few.values
    for share in (fmpq(0), fmpq(1, 3), fmpq(1)):
        at = {name: low + share * (high - low) for name, (low, high) in box.ranges.items()}
        full, short = (member_of(one.over(box.ranges), {**one.values, **at}).plain for one in (whole, few))
        assert full * short.leading_coefficient() == short * full.leading_coefficient()
        assert full.degree() > 4


def test_numbers_over_parameters_do_not_grow_with_effects(tame: Prototype):
    """A common factor of some 180,000 binary digits made of one proof gigabytes."""
    plant = family(with_effects(tame, "mount_compliance", "second_beam_mode", "unequal_piston_areas"), 6.8).rest.rig
    context = fmpq_mpoly_ctx.get(["s", "outer_end_mass", "inner_end_mass", *plant.figures], "lex")
    below, above = plant.over_parameters(("displacement_m",), context, {name: name for name in plant.figures})
    numbers = [c for polynomial in (below, *above) for c in polynomial.coeffs()]
    assert len(numbers) > 2000
    assert max(max(int(c.p).bit_length(), int(c.q).bit_length()) for c in numbers) < 1000


def test_the_compliance_of_a_rig_on_a_mount_can_be_proved_within_tolerances(tame: Prototype):
    """Oil and leakage are bound together where both stand beside the unknown; with all bound, hulls had 10^6 points."""
    rig = with_effects(tame, "mount_compliance")
    box = tolerance_box(rig.but(tolerance=Tolerance(**dict.fromkeys(Tolerance.model_fields, 0.01))), 1.0)
    asked = Asked("compliance", 5.71e-8, 1.0)
    statement = rig_family(rig, claim=asked, delayed=False, varying=box.ranges).over(box.ranges)
    assert len(statement.varying) > 12
    assert control_points(statement) < 50_000


def test_an_unstable_range_has_its_stable_part_in_common(remedy: Prototype):
    """Gains of the two sides times the controller's, on the rig without effects: the stable masses of both.

    Without leakage the sides differ in nothing else.
    """
    remedy = remedy.but(servovalve=remedy.servovalve.but(leakage_m3_per_s_per_Pa=0.0))
    found = certify(with_effects(remedy, "unequal_piston_areas"), 0.0, 20.0, [Asked("peak_sensitivity", 9.0)])
    ends = []
    for factor in (1 / 1.121, 1 / 0.879):
        gain = remedy.controller.gain_A_per_V * factor
        ends.append(certify(remedy.but(controller=remedy.controller.but(gain_A_per_V=gain)), 0.0, 20.0))
    low = max(end.stable_ranges_kg[0][0] for end in ends)
    high = min(end.stable_ranges_kg[0][1] for end in ends)
    assert found.stable_ranges_kg == [pytest.approx((low, high), rel=1e-12)]
    assert not found.stable
    assert found.guaranteed is None
    assert not found.claims[0].holds
    assert len(found.crossings) == sum(len(end.crossings) for end in ends)
    assert check(found.text).valid


def test_a_gain_between_stable_ends_is_looked_at(paper: Prototype):
    """With a dead band the gain may be anything: what is stable without and with the loop is not so in between."""
    low_inner = paper.but(
        controller=Lag(gain_A_per_V=0.2, pole_Hz=1.75, zero_Hz=26.0), payload=Payload(inner_end_mass_kg=4.5)
    )
    found = certify(with_effects(low_inner, "valve_deadband"), 0.0, 20.0)
    member = family(with_effects(low_inner, "valve_deadband"), 20.0).members[0]
    loop = close_loop(member.rig.plant(4.5), low_inner.controller)
    ends = certify(low_inner, 0.0, 20.0).stable_ranges_kg
    assert [low for low, _ in found.stable_ranges_kg] == [low for low, _ in ends]
    assert found.stable_ranges_kg[0][1] < ends[0][1] - 1.0
    at_one_mass = certify(with_effects(low_inner, "valve_deadband"), 18.0, 18.0)
    assert certify(low_inner, 18.0, 18.0).stable
    assert not at_one_mass.stable
    assert check(at_one_mass.text).valid
    assert "not every loop is stable from 0 to 6.888689 kg" in found.stability.reason
    for low, high in found.stable_ranges_kg:
        for mass in np.linspace(low, high, 9)[1:-1]:
            for factor in np.linspace(0.0, 1.0, 21):
                polynomial = loop.loop_denominator.at(exact(mass)) + exact(factor) * loop.loop_numerator.constant
                roots = np.roots([float(c) for c in reversed(polynomial.coeffs())])
                assert roots.real.max() < 1e-9 * abs(roots).max()
    assert check(found.text).valid


def test_figures_of_a_rectangle_are_those_of_a_dense_grid_inside(tame: Prototype):
    """Neither inside nor on the sides is anything worse than what the sides prove, and something comes close."""
    (member,) = family(with_effects(tame, "unequal_piston_areas", "sensor_lag")).members
    loop = close_loop(member.rig.plant(2.0), tame.controller)
    rectangle = Rectangle(loop, fmpq(0), fmpq(34, 5), fmpq(1, 2), fmpq(2))
    assert rectangle.unstable_side() is None
    peak, reached = least_limit([rectangle], "peak_sensitivity"), bandwidth([rectangle], 5.71e-8)
    frequencies = np.geomspace(0.1, 300.0, 1500)
    s = 2j * np.pi * frequencies

    def value(polynomial) -> np.ndarray:
        return np.polyval([float(c) for c in reversed(polynomial.coeffs())], s)

    constant, slope = value(loop.loop_denominator.constant), value(loop.loop_denominator.slope)
    returned, disturbance = value(loop.loop_numerator.constant), value(loop.disturbance)
    masses, factors = np.linspace(0.0, 6.8, 41)[:, None, None], np.geomspace(0.5, 2.0, 31)[:, None]
    opened = constant + masses * slope
    closed = opened + factors * returned
    sensitivity, compliance = np.abs(opened / closed), np.abs(disturbance / closed)
    assert 0.995 * peak < sensitivity.max() <= peak
    over = frequencies[(compliance > 5.71e-8).any(axis=(0, 1))].min()
    assert 0.99 * over < reached <= over


ALTERED = {
    "an element": (("effect", 0, "elements", "volts", 0, "numerator", 0), "2513.28", "the polynomials are not"),
    "a side of the piston": (("effect", 1, "elements", "asymmetry"), "0.122", "the polynomials are not"),
    "a refutation of what holds": (("claim", 0, "holds"), False, "holds after all"),
    "a lower peak": (("claim", 0, "limit"), "1.1", "not proved"),
    "that it is not stable": (("stability", "stable"), False, "contradicts"),
}


@pytest.mark.parametrize("name", ALTERED)
def test_an_altered_certificate_is_found_out(tame: Prototype, name: str):
    place, value, told = ALTERED[name]
    text = certify(with_effects(tame, "unequal_piston_areas", "sensor_lag"), 0.0, 6.8, CLAIMS).text
    found = check(altered(text, place, value))
    assert any(told in words for words in found.failed), found.failed


def test_what_effects_it_is_of_is_compared_with_its_prototype(tame: Prototype, tmp_path: Path):
    """The proof is about the elements; by which effects they come about, only a prototype tells."""
    rig, slower = (tame.but(effects={"sensor_lag": {"break_Hz": value}}) for value in (400.0, 300.0))
    text = certify(rig, 0.0, 6.8, CLAIMS).text
    # A slower lag, proved, under the name of the prototype's own.
    forged = altered(certify(slower, 0.0, 6.8, CLAIMS).text, ("effect", 0, "parameters", "break_Hz"), "400")
    for given in (text, forged):
        alone = check(given)
        assert alone.valid
        assert any("sensor_lag" in words for words in alone.open)
    assert check(text, prototype_table(rig)).valid
    assert check(forged, prototype_table(rig)).failed == (
        "not of this prototype: the elements stated are not those that stand for its effects",
    )
    assert not check(text, prototype_table(slower)).valid
    write_prototype(rig, tmp_path / "p.toml")
    (tmp_path / "c.toml").write_text(text)
    for asked, open_ones in (([], 2), ([str(tmp_path / "p.toml")], 1)):
        told = tmp_path / "told.json"
        arguments = ["certify", *asked, "--replay", str(tmp_path / "c.toml"), "--json", str(told)]
        assert CliRunner().invoke(app, arguments).exit_code == 0
        found = json.loads(told.read_text())
        assert found["valid"]
        assert len(found["not_checked"]) == open_ones  # one is of the comments


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("effect", 0, "gain"), ["-1", "1"]),
        (("effect", 0, "performing_gain"), ["0.9", "1.3"]),
        (("effect", 0, "elements", "asymmetry"), "1"),
        (("effect", 0, "elements", "oil"), "-1"),
        (("effect", 0, "span"), {"share": {"ends": ["1", "0"]}}),
        (("effect", 0, "elements", "spool"), "2*share"),
    ],
)
def test_what_is_no_rig_is_refused(tame: Prototype, place: tuple[str | int, ...], value: object):
    text = certify(with_effects(tame, "unequal_piston_areas"), 0.0, 6.8).text
    table = tomllib.loads(text)
    table["effect"][0]["span"] = {}
    with pytest.raises(Unreadable):
        check(altered(resealed(table), place, value))


@pytest.mark.parametrize("names", [("unequal_piston_areas", "sensor_lag"), ("second_beam_mode",), ("seal_friction",)])
@pytest.mark.usefixtures("one_start")
def test_a_tuned_loop_is_proved_and_survives_on_the_nonlinear_rig(paper: Prototype, names: tuple[str, ...]):
    """Steps of force and command in the time domain, at both ends of the payload and between."""
    found = tune(with_effects(paper, *names), (0.0, 6.8), sigmas=0.0)
    assert found.best is not None
    proof = certify(found.prototype, 0.0, 6.8)
    assert proof.stable
    assert proof.guaranteed.bandwidth_Hz >= found.best.bandwidth_Hz > 3.0
    assert proof.guaranteed.peak_sensitivity <= 2.0001
    assert check(proof.text).valid
    rows = tuple(
        ScenarioRecord(name=f"at_{mass:g}", input=(Step(amplitude_N=300.0, at_s=0.05),), outer_end_mass_kg=mass)
        for mass in (0.0, 2.0, 6.8)
    )
    ran = simulate(found.prototype, Scenario(name="steps", duration_s=1.5, record=rows))
    assert ran.stable
    for record in ran.records:
        late = record.column("displacement_m")[-200:]
        assert np.ptp(late) < 0.05 * np.ptp(record.column("displacement_m"))


def test_commands_take_prototypes_with_effects(tame: Prototype, tmp_path: Path):
    rig, out = tmp_path / "p.toml", tmp_path / "out"
    write_prototype(with_effects(tame, "sensor_lag", "unequal_piston_areas"), rig)
    runner = CliRunner()
    told = ["tune", str(rig), "--controller", "proportional", "--outer-end-mass", "0:1", "--peak-sensitivity", "3"]
    told += ["--nominal"]
    done = runner.invoke(app, [*told, "--out", str(out), "--json", str(tmp_path / "t.json")])
    assert done.exit_code == 0, done.output
    assert "unequal_piston_areas: flow gain from that of the larger side" in done.output
    assert "not the nonlinear loop" in json.loads((tmp_path / "t.json").read_text())["guaranteed"]["scope"][-1]
    paths = [str(out / "prototype.toml"), str(tmp_path / "c.toml")]
    done = runner.invoke(app, ["certify", paths[0], "--out", paths[1], "--json", str(tmp_path / "c.json")])
    assert done.exit_code == 0, done.output
    assert json.loads((tmp_path / "c.json").read_text())["stable"]
    assert runner.invoke(app, ["certify", paths[0], "--replay", paths[1]]).exit_code == 0
    write_prototype(tame, rig)
    other = runner.invoke(app, ["certify", str(rig), "--replay", paths[1]])
    assert other.exit_code == 1
    assert "not of this prototype" in other.output


@pytest.mark.parametrize("sensors", [False, True])
@pytest.mark.parametrize("name", causes())
def test_the_box_is_about_the_members_loops(tame: Prototype, name: str, sensors: bool):
    """The expression over all parameters, at the ends of the spans, is the member with the parameters' numbers."""
    rig = with_effects(tame.but(controller=TWO_SENSORS) if sensors else tame, name)
    whole = rig_family(rig)
    for member in family(rig).members:
        frozen = {
            f"{effect}_{key}": exact(value) for effect, table in member.frozen.items() for key, value in table.items()
        }
        point = whole.values | {key: value for key, value in frozen.items() if key in whole.values}
        point |= {"outer_end_mass": fmpq(3)} | ({"effect_gain": fmpq(1)} if "effect_gain" in point else {})
        found = member_of(whole.over({}), point)
        expected = rig_loop(member.rig, 2.0, rig.controller).at(3.0).characteristic
        found = found.plain + found.late
        assert found * (expected[0] / found[0]) == expected


def test_between_the_members_a_box_proves_or_refutes(tame: Prototype):
    rig = with_effects(tame, "entrained_air", "seal_friction", "valve_hysteresis", "unequal_piston_areas")
    verdict = between(rig, 0.0, 6.8)
    assert verdict.stable
    assert set(verdict.box.names) == {
        "outer_end_mass",
        "effect_gain",
        "entrained_air_stiffness_factor",
        "seal_friction_spring_N_per_m",
        "valve_hysteresis_spring",
    }
    assert check(verdict.certificate, prototype_table(rig)).valid
    inside = certify(rig, 0.0, 6.8).between
    assert inside is not None
    assert "stable at every value between" in inside.of_frozen
    wild = rig.but(controller=rig.controller.but(gain_A_per_V=0.4))
    refuted = between(wild, 0.0, 6.8)
    assert refuted.stable is False
    assert "not stable" in refuted.reason
    assert between(with_effects(tame, "sensor_lag"), 0.0, 6.8) is None
    assert certify(with_effects(tame, "sensor_lag"), 0.0, 6.8).between is None
    for effects in ({"joint_backlash": {}}, {"mount_compliance": {}, "seal_friction": {}}):
        found = between(tame.but(effects=effects), 6.0, 6.8)
        assert found is not None
        assert found.stable is not False


def test_more_at_once_than_a_hull_can_hold_is_not_covered(tame: Prototype, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("beamdesign.proofs.branch._MOST_POINTS", 1)
    found = certify_box(tame, tolerance_box(tame, 0.0))
    assert found.stable is None
    assert found.reason.startswith("not covered")
    assert found.certificate == ""


def test_a_delay_that_is_asked_for_is_beside_that_of_the_effect(tame: Prototype):
    """The effect's is its approximant, as it is simulated and in every other proof; the other is a pure one."""
    late = tame.but(effects={"transport_delay": {"delay_s": 5e-4}})
    box = tolerance_box(late, 0.0, None, (0.0, 6.8), delay_s=(0.0, 1e-4))
    assert dict(box.ranges)["delay"] == (0, fmpq(1, 10000))
    assert certify_box(late, box).stable


def test_certify_says_no_where_a_value_between_the_ends_is_refuted(tame: Prototype, tmp_path: Path):
    """An inner beam that a cable holds: stable free of it and with all of it, and not in between."""
    rig = held_by_a_cable(tame, 10480.0)
    found = certify(rig, 2.07, 2.07)
    assert (found.holds, found.yes, found.status) == (True, False, "no")
    assert "between the ends" in found.reason
    assert certify(rig, (2.07, 2.07), linear=True).yes
    specified = specify(rig, (2.07, 2.07))
    assert specified.guaranteed is None
    assert "between the ends" in specified.reason
    assert "between the ends" in terms(rig).open_between
    write_prototype(rig, tmp_path / "p.toml")
    words = ["certify", str(tmp_path / "p.toml"), "--outer-end-mass", "2.07:2.07", "--json", str(tmp_path / "c.json")]
    words += ["--out", str(tmp_path / "c.toml")]
    assert CliRunner().invoke(app, words).exit_code == 1
    fields = json.loads((tmp_path / "c.json").read_text())
    assert fields["stable_between"] is False
    assert "between the ends" in fields["reason"]
    assert CliRunner().invoke(app, [*words, "--linear"]).exit_code == 0


def held_by_a_cable(tame: Prototype, size_N: float) -> Prototype:
    """Stable free of it and with all of it, and not in between."""
    return tame.but(
        controller=Lag(gain_A_per_V=0.028, pole_Hz=1.52, zero_Hz=50.7),
        payload=tame.payload.but(inner_end_mass_kg=4.02, outer_end_mass_kg=(2.07, 2.07)),
        effects={"empirical_inner_reaction_loop": {"size_N": size_N}},
    )


@pytest.mark.usefixtures("one_start")
def test_a_law_tuned_for_members_alone_is_no_answer_where_a_value_between_is_refuted(tame: Prototype):
    rig = held_by_a_cable(tame, 20000.0)
    found = tune(rig, (2.07, 2.07), sigmas=0.0)
    assert found.best is not None
    assert (found.yes, certify(found.prototype, (2.07, 2.07)).yes) == (False, False)
    assert "between the ends" in found.open_between
    renewed = redesign(rig, (2.07, 2.07))
    assert renewed.prototype is None
    assert "between the ends" in renewed.reason


def test_a_sweep_says_no_of_stable_masses_where_a_value_between_is_refuted(tame: Prototype):
    found = answers.stable_masses(held_by_a_cable(tame, 10480.0), case.RangeOptions(from_kg=2.0, to_kg=2.2))
    assert found.outputs["stable_between"] is False
    assert "between the ends" in found.reason


def test_the_critical_gain_is_no_more_than_that_at_rest(tame: Prototype):
    """Of an inner beam that a cable holds the loop at rest is none of the members."""
    rig = held_by_a_cable(tame, 20000.0)
    least = critical_gain(rig, 2.07).gain_A_per_V
    at = [
        loop(rig.but(controller=rig.own_controller.but(gain_A_per_V=least * by))).at(2.07).stable
        for by in (0.999, 1.001)
    ]
    assert at == [True, False]


@pytest.mark.parametrize(
    "asked", [envelope, lambda rig, kg: answers.limits(rig, case.LimitsOptions(outer_end_mass_kg=kg))]
)
def test_a_loop_that_an_effect_makes_unstable_has_no_limits(tame: Prototype, asked: Callable[..., Any]):
    """Of a gain just below the critical one, with sides of the piston that are unequal; laws that are not linear."""
    gain = critical_gain(tame, 0.0).gain_A_per_V
    near = tame.but(controller=tame.own_controller.but(gain_A_per_V=0.97 * gain))
    assert "not stable" not in asked(near, 0.0).reason
    assert "not stable" in asked(near.but(effects={"unequal_piston_areas": {"asymmetry": 0.3}}), 0.0).reason


def test_certify_writes_what_holds_between_beside(tame: Prototype, tmp_path: Path):
    write_prototype(with_effects(tame, "entrained_air"), tmp_path / "p.toml")
    runner = CliRunner()
    told = ["certify", str(tmp_path / "p.toml"), "--out", str(tmp_path / "c.toml"), "--json", str(tmp_path / "c.json")]
    done = runner.invoke(app, told)
    assert done.exit_code == 0, done.output
    assert json.loads((tmp_path / "c.json").read_text())["stable_between"] is True
    for name in ("c.toml", "c.between.toml"):
        assert runner.invoke(app, ["certify", "--replay", str(tmp_path / name)]).exit_code == 0


def test_certify_says_no_where_what_lies_between_is_undecided(
    tame: Prototype, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """As `certify-box` does: status 0 says that all of it is proved."""
    monkeypatch.setattr("beamdesign.proofs.tolerance_box.BUDGET", 1)
    write_prototype(with_effects(tame, "entrained_air"), tmp_path / "p.toml")
    told = ["certify", str(tmp_path / "p.toml"), "--out", str(tmp_path / "c.toml"), "--json", str(tmp_path / "c.json")]
    assert CliRunner().invoke(app, told).exit_code == 1
    fields = json.loads((tmp_path / "c.json").read_text())
    assert (fields["stable"], fields["stable_between"]) == (True, None)
    assert "undecided" in fields["reason"]
    assert CliRunner().invoke(app, [*told, "--linear"]).exit_code == 0
    specified = specify(with_effects(tame, "entrained_air"), (0.0, 6.8))
    assert specified.guaranteed is not None
    (words,) = (value for figure, value, _ in specified.rows() if figure == "not proved")
    assert "undecided" in words
    paths = write_specification(specified, tmp_path / "spec")
    assert f"Of all effects together: {words}" in " ".join(paths["markdown"].read_text().split())
