"""Errors that are bounded and gains that change: bounds against responses in floats, and against the moving rig."""

import re
import tomllib
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from contradictions import MOTIONS, motions, outcome
from flint import fmpq, fmpq_poly
from forging import altered, resealed
from honest_certificates import screw, valid
from rig_of_certificate import members as stated_members

from beamdesign import Prototype, certify, check, read_prototype, simulate, state_space
from beamdesign.controllers import Lag, Observer
from beamdesign.loop import rig_loop
from beamdesign.parameters import TYPICAL
from beamdesign.plant.effects import Effect, laws_of, library, register
from beamdesign.plant.members import family
from beamdesign.polynomial import Affine, exact, nearest
from beamdesign.proofs import bounded_error, changing_gain, scope
from beamdesign.proofs.absolute_integrals import absolute_integrals, over_masses
from beamdesign.proofs.certificate import Row
from beamdesign.proofs.certifying import nonlinear_rows
from beamdesign.proofs.scope import members
from beamdesign.prototype import Payload
from beamdesign.scenario import Multisine, Scenario, ScenarioRecord
from beamdesign.structure.lumped import figures

ROOT = Path(__file__).parent.parent
HALVES = fmpq(1, 2), fmpq(3, 2)


@pytest.fixture(scope="module")
def tame() -> Prototype:
    """The tame lag, 1.7/20 Hz at 50 mA/V."""
    return read_prototype(ROOT / "studies/prototypes/tame_lag.toml")


@pytest.fixture(scope="module")
def worn(tame: Prototype) -> Prototype:
    """With friction, hysteresis, a dead band and a residual ripple."""
    ripple = {"depth": 0.0, "residual_V": 0.01}
    return tame.but(
        effects={"seal_friction": {}, "valve_hysteresis": {}, "valve_deadband": {}, "carrier_ripple": ripple}
    )


@pytest.fixture(scope="module")
def written(worn: Prototype) -> str:
    return certify(worn, 2.0, 3.0, nonlinear=True).text


def test_integrals_of_known_responses():
    """exp(-t); exp(-t) sin(2 t), whose integral is 2/5 coth(pi/4) in absolute value; a pass straight through."""
    one, two = fmpq_poly([1]), fmpq_poly([2])
    (first,) = absolute_integrals([one], fmpq_poly([1, 1]))
    assert 1 <= nearest(first) < 1.006
    (swinging,) = absolute_integrals([two], fmpq_poly([5, 2, 1]))
    exact = 2 / 5 / np.tanh(np.pi / 4)
    assert exact <= nearest(swinging) < 1.006 * exact
    (through,) = absolute_integrals([fmpq_poly([2, 1])], fmpq_poly([1, 1]))
    assert 2 <= nearest(through) < 2.006


def test_what_is_not_stable_or_not_simple_has_no_bound():
    for below in (fmpq_poly([-1, 1]), fmpq_poly([1, 0, 1]), fmpq_poly([1, 2, 1])):
        with pytest.raises(ArithmeticError):
            absolute_integrals([fmpq_poly([1])], below)


def test_a_bound_over_masses_holds_between_its_pieces():
    """Of 1 / (m s^2 + s + 9) against the integral in closed form, coth(pi a / (2 b)) / 9 for poles -a +- j b."""
    closed = Affine(fmpq_poly([9, 1]), fmpq_poly([0, 0, 1]))
    (bound,), pieces = over_masses([fmpq_poly([1])], closed, *HALVES)
    assert pieces > 1
    integrals = []
    for mass in np.linspace(0.5, 1.5, 41):
        a, b = 1 / (2 * mass), np.sqrt(9 / mass - 1 / (4 * mass**2))
        integrals.append(1 / np.tanh(np.pi * a / (2 * b)) / 9)
    assert max(integrals) <= nearest(bound) < 1.2 * max(integrals)


def test_every_place_is_where_the_stated_rig_has_it(worn: Prototype, written: str):
    """Against the loops of a certificate that share nothing with the prover."""
    table = tomllib.loads(written)
    (stated,) = [one for one in table["nonlinear"] if one["kind"] == "deviation"]
    (number,) = stated["loops"]
    given = members(worn, 2.0, 3.0)
    rig = given.found.members[number - 1].rig
    found = bounded_error.numerators(worn, rig, set(bounded_error.UNITS))
    assert worn.controller is not None
    closed = rig_loop(rig, worn.payload.inner_end_mass_kg, worn.controller).characteristic.at(fmpq(2))
    for place, numerator in found.items():
        (own,) = absolute_integrals([numerator], closed)
        other = stated_members(table)[number - 1].strayed(2.0, place)
        assert other is not None
        assert other < nearest(own) < 1.01 * other, place


def test_bounds_are_stated_for_each_and_for_all(worn: Prototype):
    rows = [row for row in nonlinear_rows(members(worn, 2.0, 3.0)) if row.method == bounded_error.METHOD]
    *each, together = rows
    assert {row.effects[0] for row in each} == set(worn.effects)
    assert all(row.proved and row.bound_m is not None and 1e-6 < row.bound_m < 1e-3 for row in each)
    assert together.bound_m is not None
    total = sum(Fraction(str(row.bound_m)) for row in each)
    assert total <= Fraction(f"{together.bound_m:.4g}") < total * Fraction(1001, 1000)  # as it is told


def test_the_resolution_of_the_sensor_is_an_error(tame: Prototype):
    rig = tame.but(sensor=tame.sensor.but(resolution_m=1e-6))
    (row,) = [row for row in nonlinear_rows(members(rig, 2.0, 3.0)) if row.method == bounded_error.METHOD]
    assert row.effects == (bounded_error.RESOLUTION,)
    assert row.bound_m is not None
    assert 1e-6 < row.bound_m < 5e-6


def test_the_certificate_is_proved_again(written: str):
    verdict = check(written)
    assert verdict.valid
    assert any("strays" in words for words in verdict.proved)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("bound_m", "0.000001"),
        ("size", "1"),
        ("place", "nowhere"),
        ("size", "-1"),
        ("bound_m", "x"),
    ],
)
def test_an_altered_error_is_refused(written: str, key: str, value: str):
    table = tomllib.loads(written)
    (k,) = [k for k, one in enumerate(table["nonlinear"]) if one["kind"] == "deviation"]
    places = [one["place"] for one in table["nonlinear"][k]["error"]]
    assert not valid(altered(written, ("nonlinear", k, "error", places.index("flow"), key), value))


@pytest.mark.parametrize(
    ("key", "value"), [("pieces", 1), ("pieces", 0), ("error", []), ("loops", [99]), ("loops", [])]
)
def test_an_altered_statement_of_errors_is_refused(written: str, key: str, value: object):
    table = tomllib.loads(written)
    next(one for one in table["nonlinear"] if one["kind"] == "deviation")[key] = value
    assert not valid(resealed(table))


def test_a_gain_that_changes_is_proved_up_to_some_depth(tame: Prototype):
    """And told no wider: 0.9875 was told of a depth of 0.0124567, which is below its lower end."""
    for depth in (0.0124567, 0.2):
        rows = nonlinear_rows(members(tame.but(effects={"carrier_ripple": {"depth": depth}}), 0.0, 6.8))
        (row,) = (row for row in rows if row.method == changing_gain.METHOD)
        least, most = map(float, re.findall(r"between (\S+) and (\S+) times its own", row.covers)[0])
        assert row.proved
        assert 1 - depth <= least <= most <= 1 + depth
    loop = members(tame, 0.0, 6.8).loops[0]
    wide = changing_gain.margin_of(loop, "flow", fmpq(0), fmpq(1), fmpq(0), fmpq(34, 5))
    assert wide is None  # the circle criterion over the whole sector fails by far


def _slow(name: str) -> Effect:
    """A lag of the volts like that of a sensor, of a name of its own, by which its place beside others goes."""
    return replace(library()["sensor_lag"], name=name)


def test_no_bound_is_proved_behind_an_effect_that_acts_ahead_of_the_error(tame: Prototype):
    """At one place effects act by their names: 10 mV behind a lag of 30 Hz move the tip 51.7 um; 48.2 were proved."""
    rig = tame.but(controller=tame.own_controller.but(gain_A_per_V=0.02), guarantee=None)

    def ripple(beside: str) -> Row:
        effects = {beside: {"break_Hz": 30.0}, "carrier_ripple": {"depth": 0.0, "residual_V": 0.01}}
        (row,) = bounded_error.bounded_rows(members(rig.but(effects=effects), 2.0, 2.05))
        return row

    for name in ("amplifier_lag", "measuring_lag"):
        register(_slow(name))
    deep = {"amplifier_lag": {"break_Hz": 300.0}, "carrier_ripple": {"depth": 0.01}}
    try:
        ahead, behind = ripple("amplifier_lag"), ripple("measuring_lag")
        given = members(rig.but(effects=deep), 2.0, 2.05)
        (change,) = changing_gain.changing(given)
        assert changing_gain.pair(given, given.found.members[0], change) is None
    finally:
        for name in ("amplifier_lag", "measuring_lag"):
            del library()[name]
    assert (ahead.proved, ahead.bound_m) == (False, None)
    assert behind.proved
    assert behind.bound_m == ripple("sensor_lag").bound_m


@pytest.fixture(scope="module")
def rippling(tame: Prototype) -> str:
    """A certificate of a gain that changes, which is valid."""
    text = certify(tame.but(effects={"carrier_ripple": {}}), 0.0, 6.8, nonlinear=True).text
    assert valid(resealed(tomllib.loads(text)))
    return text


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("gain", ["0.02", "1.02"]),
        ("gain", ["0.98", "3"]),
        ("gain", ["1.02", "0.98"]),
        ("margin", "0.9999"),
        ("margin", "0"),
        ("place", "stroke"),
    ],
)
def test_an_altered_sector_is_refused(rippling: str, key: str, value: object):
    table = tomllib.loads(rippling)
    sector = next(one for one in table["nonlinear"] if one["kind"] == "sector")
    sector[key] = value
    assert not valid(resealed(table))


def test_a_ripple_of_one_sensor_beside_another_is_none_of_the_whole_loop():
    """Stable with both 20 % up or down; with the displacement's alone 20 % up, a pole lies in the right half plane."""
    rig = read_prototype(ROOT / "studies/prototypes/tame_lag.toml")
    pole, zero, gain = 2 * np.pi * 1.75, 2 * np.pi * 26.0, 0.25
    law = Observer(
        gain_A_per_V=1.0, sensors=("displacement_m", "load_pressure_Pa"), a=((-pole,),),
        b=((gain * pole * (1 - pole / zero), 0.0),), c=(1.0,), d=(gain * pole / zero, 1.6e-10),
    )  # fmt: skip
    rig = rig.but(controller=law, payload=Payload(inner_end_mass_kg=4.5, outer_end_mass_kg=(6.5, 6.8)))
    louder = rig.but(sensor=rig.sensor.but(gain_V_per_m=1.2 * rig.sensor.gain_V_per_m))
    for mass in (6.5, 6.8):
        assert np.linalg.eigvals(state_space(rig, mass).A).real.max() < 0
        assert np.linalg.eigvals(state_space(louder, mass).A).real.max() > 1.0
    found = certify(rig.but(effects={"carrier_ripple": {"depth": 0.2}}), nonlinear=True)
    assert not found.stable
    assert not found.holds
    held = certify(rig.but(effects={"carrier_ripple": {"depth": 0.01}}), nonlinear=True)
    assert held.stable
    assert [row.proved for row in held.nonlinear if row.effects == ("carrier_ripple",)] == [False]
    assert check(held.text).valid


def test_a_ripple_beside_a_friction_that_is_heard_proves_nothing_by_itself():
    """Where the controller hears the friction there is no error left that a ripple would make larger."""
    rig = read_prototype(ROOT / "studies/prototypes/compliant.toml")
    rows = nonlinear_rows(members(rig.but(effects={"seal_friction": {}, "carrier_ripple": {}}), 0.0, 1.0))
    assert [(row.effects, row.proved) for row in rows if row.method == bounded_error.METHOD] == [
        (("seal_friction",), False)
    ]


@pytest.mark.parametrize("effect", ["joint_backlash", "mount_compliance", "second_beam_mode", "uneven_leakage"])
def test_friction_that_slides_draws_at_the_rod(tame: Prototype, effect: str):
    """As the oil does: with a load pressure p of Q p = q - A v - (A / K) A p', p + F / A in its place makes q of F."""
    rig = tame.but(effects={effect: {}, "seal_friction": {}})
    figure = {name: exact(value) for name, value in figures(rig).items()}
    area, oil, leakage = (figure[name] for name in ("piston_area", "oil_stiffness", "leakage"))
    found = family(rig).members
    sliding = [member for member in found if bounded_error.slides(member, found)]
    assert len(sliding) == (2 if effect == "joint_backlash" else 1)
    for member in sliding:
        known = bounded_error.numerators(rig, member.rig, {"stroke"})
        worth = known["flow"] * fmpq_poly([leakage / area, area / oil])
        assert known["stroke"] == worth


def test_what_no_theorem_covers_is_listed(tame: Prototype):
    effects: dict[str, dict[str, float]] = {"entrained_air": {}, "joint_backlash": {}, "sensor_lag": {}}
    rows = {row.effects: row for row in nonlinear_rows(members(tame.but(effects=effects), 0.0, 6.8))}
    assert rows["sensor_lag",].method == scope.LINEAR
    assert rows["sensor_lag",].proved
    for name in ("entrained_air", "joint_backlash"):
        assert rows[name,].method == scope.NONE_KNOWN
        assert not rows[name,].proved
    assert not certify(tame.but(effects={"entrained_air": {}}), 2.0, 3.0, nonlinear=True).holds


RIPPLING = {"depth": 0.1, "residual_V": 0.05, "frequency_Hz": 90.0}


def test_errors_while_a_gain_ripples_are_those_over_what_it_leaves_of_1_m(tame: Prototype):
    """That share by the peak-to-peak gain of the same loop in floats; and the moving rig strays by less."""
    rig = tame.but(effects={"carrier_ripple": RIPPLING, "valve_hysteresis": {}})
    found = certify(rig, 2.0, 3.0, nonlinear=True)
    rows = [row for row in found.nonlinear if row.method == bounded_error.METHOD]
    *each, together = rows
    assert [row.effects for row in rows] == [("carrier_ripple",), ("valve_hysteresis",), tuple(rig.effects)]
    table = tomllib.loads(found.text)
    (stated,) = [one for one in table["nonlinear"] if one["kind"] == "deviation"]
    own = stated_members(table)[stated["loops"][0] - 1]
    share = max(0.1 * rig.sensor.gain_V_per_m * own.strayed(mass, "volts") for mass in (2.0, 2.5, 3.0))
    bound = sum(row.bound_m or 0.0 for row in each)
    assert together.bound_m is not None
    assert bound / (1 - share) < together.bound_m < 1.05 * bound / (1 - share)
    assert check(found.text).valid

    signals = (
        Multisine(amplitude_N=300.0, low_Hz=1.0, high_Hz=60.0, seed=1),
        Multisine(amplitude_V=0.3, low_Hz=1.0, high_Hz=40.0, seed=2),
    )
    quiet = rig.but(effects={"carrier_ripple": RIPPLING | {"residual_V": 0.0}})
    rippling, moved = (motions(some, signals, 1.5, 2.5)[0] for some in (quiet, rig))
    assert 0.1 * together.bound_m < abs(moved - rippling).max() <= together.bound_m


def test_a_ripple_that_makes_more_than_a_metre_of_one_has_no_bound_with_errors(tame: Prototype):
    rig = tame.but(effects={"carrier_ripple": RIPPLING | {"depth": 0.5}})
    rows = [row for row in nonlinear_rows(members(rig, 2.0, 3.0)) if row.method == bounded_error.METHOD]
    assert [(row.proved, row.bound_m is None) for row in rows] == [(True, False), (False, True)]
    assert "over 1 - " in rows[1].covers


def test_friction_is_refused_where_pressures_are_heard():
    rig = read_prototype(ROOT / "studies/prototypes/compliant.toml").but(effects={"seal_friction": {}})
    rows = [row for row in nonlinear_rows(members(rig, 2.0, 3.0)) if row.method == bounded_error.METHOD]
    assert [row.proved for row in rows] == [False]
    assert rows[0].bound_m is None


def test_a_screw_that_rings_fast_and_long_leaves_its_certificate_valid():
    """Without damping of its own it rings at 940 Hz: summed up at every payload, nobody would prove that again."""
    rig = screw().but(effects={"seal_friction": {}})
    rig = rig.but(actuator=rig.actuator.but(screw_damping_N_s_per_m=0.0))
    certificate = certify(rig, 3.0, 3.4, nonlinear=True)
    (friction,) = (row for row in certificate.nonlinear if row.effects == ("seal_friction",))
    assert not friction.proved
    assert "narrower range" in friction.covers
    assert certificate.stable
    assert check(certificate.text).valid


def test_an_unstable_loop_has_no_bound(worn: Prototype):
    rig = worn.but(controller=Lag(gain_A_per_V=0.5, pole_Hz=1.7, zero_Hz=20.0))
    rows = [row for row in nonlinear_rows(members(rig, 2.0, 3.0)) if row.method == bounded_error.METHOD]
    assert rows
    assert not any(row.proved for row in rows)


@pytest.mark.parametrize("name", laws_of("seal_friction", "valve_hysteresis", "valve_deadband"))
def test_the_moving_rig_strays_by_less(tame: Prototype, name: str):
    """Simulated with an effect and without, under a force and a command of many frequencies."""
    signals = (
        Multisine(amplitude_N=300.0, low_Hz=1.0, high_Hz=60.0, seed=1),
        Multisine(amplitude_V=0.3, low_Hz=1.0, high_Hz=40.0, seed=2),
    )
    row = ScenarioRecord(name="push", outer_end_mass_kg=2.5, input=signals)
    scenario = Scenario(name="push", duration_s=1.0, start="rest", record=(row,))
    rig = tame.but(effects={name: {}})
    linear, moving = (simulate(one, scenario).records[0].column("displacement_m") for one in (tame, rig))
    strayed = abs(moving - linear).max()
    (bound,) = [row.bound_m for row in nonlinear_rows(members(rig, 2.0, 3.0)) if row.method == bounded_error.METHOD]
    assert bound is not None
    assert 0.02 * bound < strayed <= bound


@pytest.mark.parametrize("number", range(6))
def test_drawn_rigs_contradict_nothing(tame: Prototype, number: int):
    """Figures, payload, effects and motions of a rig drawn by its number; the study draws thousands."""
    found = outcome(tame.but(tolerance=TYPICAL), number)
    assert found["proved"] == 1
    assert found["came to rest"] + found["within the bound"] == MOTIONS


def test_a_sensor_that_rides_has_no_bound(tame: Prototype):
    rig = tame.but(effects={"mount_compliance": {"sensor_share": 1.0}, "valve_hysteresis": {}})
    rows = [row for row in nonlinear_rows(members(rig, 2.0, 3.0)) if row.method == bounded_error.METHOD]
    assert [row.proved for row in rows] == [False]
    assert check(certify(rig, 2.0, 3.0, nonlinear=True).text).valid
