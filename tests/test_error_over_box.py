"""How far bounded errors move the tip of every rig of a box: against exponentials, the exact prover and moving rigs."""

import tomllib
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from math import hypot, sqrt

import numpy as np
import pytest
from contradictions import motions
from flint import fmpq, fmpq_poly
from forging import altered
from honest_certificates import coarsely, erring, honest, valid

from beamdesign import Prototype, check
from beamdesign.loop import rig_loop
from beamdesign.plant.members import STANDARD_GRAVITY, family
from beamdesign.polynomial import exact, nearest
from beamdesign.proofs import bounded_error, changing_gain, error_over_box
from beamdesign.proofs.box import Box, certify_box
from beamdesign.proofs.box_claims import BoxClaim, claim_over_box
from beamdesign.proofs.box_member import with_number
from beamdesign.proofs.certificate import Asked, Row, Weighed
from beamdesign.proofs.error_over_box import errors_over_box
from beamdesign.proofs.rig_family import rig_family
from beamdesign.proofs.scope import members
from beamdesign.proofs.tolerance_box import tolerance_box
from beamdesign.prototype import Tolerance
from beamdesign.scenario import Multisine
from beamdesign.structure.lumped import figures, with_figures

CLAIM = ("claim", 0)


@pytest.fixture
def coarse() -> Iterator[None]:
    """Where a bound need not be near what it bounds."""
    with coarsely():
        yield


@pytest.fixture(scope="module")
def with_hysteresis() -> tuple[Prototype, Box, list[BoxClaim], list[Row]]:
    """How far a valve's hysteresis moves the rigs of a box."""
    return erring({"valve_hysteresis": {}})


@pytest.mark.parametrize("rate", [1.0, 40.0])
def test_the_bound_of_one_exponential_is_its_integral(rate: float):
    """Of exp(-a t) at half its rate; bands are cut finely, each with the largest value of (j w + c) / (j w + a / 2)."""
    edges = [0.0, *(rate * np.geomspace(0.01, 300.0, 600))]
    limits = [hypot(one, edges[-1]) / hypot(one, rate / 2) for one in edges]
    given = [[fmpq(*float(one).as_integer_ratio()) for one in some] for some in (edges, limits)]
    bound = error_over_box._per_unit(fmpq(rate.as_integer_ratio()[0], 2 * rate.as_integer_ratio()[1]), *given)
    assert 1 <= rate * nearest(bound) < 1.02


@pytest.mark.parametrize("place", ["current", "flow", "volts", "stroke"])
def test_every_place_is_where_the_exact_prover_has_it(place: str):
    """Which takes it from matrices, and of friction from a determinant."""
    rig, box, _, _ = erring({})
    members = family(rig.but(effects={"seal_friction": {}} if place == "stroke" else {}), 2.0).members
    own = next(one.rig for one in members if bounded_error.slides(one, members))
    closed = rig_loop(own, rig.payload.inner_end_mass_kg, rig.controller).characteristic.at(fmpq(1))
    known = bounded_error.numerators(rig, own, {place})[place]
    decay, figure = fmpq(41, 10), {name: (exact(value),) * 2 for name, value in figures(rig).items()}
    if place == "stroke":
        decay, lead = fmpq(0), error_over_box.leading(figure, fmpq(0))
    else:
        lead = fmpq(1), fmpq(0)
    asked = Asked("deviation", 1.0, error=Weighed(place, fmpq(1), decay, fmpq(300), lead))
    found = rig_family(rig, claim=asked, delayed=False, varying=box.ranges)
    point = {**found.values, **box.nominal, "outer_end_mass": fmpq(1)}
    without, with_it = (with_number(found.over(box.ranges), point, fmpq(unknown)) for unknown in (0, 1))
    back = fmpq_poly([decay, 1])
    assert (with_it - without)(back) * closed == known * fmpq_poly([decay + 300, 1]) * without(back)


@pytest.mark.parametrize("decay", [0.0, 20.0, 900.0])
def test_a_force_is_worth_no_more_flow_than_its_lead_says(decay: float):
    """At the corners of three figures, and up to a frequency at which either part is the larger one."""
    ends = {"leakage": (2e-13, 5e-13), "piston_area": (1.1e-4, 1.2e-4), "oil_stiffness": (1e7, 1.5e7)}
    r, t = map(nearest, error_over_box.leading({n: (exact(a), exact(b)) for n, (a, b) in ends.items()}, exact(decay)))
    w = np.geomspace(1.0, 1e4, 50)
    sizes = [abs(q / a + a * (1j * w - decay) / k) for q, a, k in product(*ends.values())]
    assert (np.max(sizes, axis=0) <= abs(r + t * 1j * w) * (1 + 1e-12)).all()
    assert (np.max(sizes, axis=0) >= 0.6 * abs(r + t * 1j * w)).all()


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize("effects", [{"entrained_air": {}}, {"unequal_piston_areas": {}}])
def test_of_other_oil_and_sides_a_force_is_not_worth_that_flow(effects: dict[str, dict[str, float]]):
    """So nothing is proved of friction beside them, and what is proved of a hysteresis can be proved again."""
    rig = erring({})[0].but(effects={**effects, "seal_friction": {}, "valve_hysteresis": {}})
    box = tolerance_box(rig, 0.0, None, (1.0, 1.2))
    claims, rows = errors_over_box(rig, box)
    assert {row.effects: row.proved for row in rows} == {("seal_friction",): False, ("valve_hysteresis",): True}
    assert "not worth a flow" in rows[0].covers
    assert valid(certify_box(rig, box, volumes=False).write(claims))


def test_of_a_sensor_that_rides_on_the_mount_nothing_is_proved():
    """As of exact figures: it is the tip's own motion that is bounded."""
    rig = erring({})[0].but(effects={"mount_compliance": {"sensor_share": 1.0}})
    rig = rig.but(sensor=rig.sensor.but(resolution_m=1e-6))
    claims, rows = errors_over_box(rig, tolerance_box(rig, 0.0, None, (1.0, 1.2)))
    exactly = [*bounded_error.bounded_rows(members(rig, 1.0, 1.2))]
    assert claims == []
    assert [row.proved for row in rows] == [row.proved for row in exactly] == [False]
    assert all("rides on the mount" in row.covers for row in (*rows, *exactly))


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize("share", [fmpq(1), fmpq(99, 100)])
def test_a_lead_that_is_too_small_is_refused(monkeypatch: pytest.MonkeyPatch, share: fmpq):
    """All else being proved with it."""
    true = error_over_box.leading
    monkeypatch.setattr(error_over_box, "leading", lambda *given: tuple(share * one for one in true(*given)))
    rig, box, claims, _ = erring({"seal_friction": {}})
    assert [claim.holds for claim in claims] == [True]
    assert valid(certify_box(rig, box, volumes=False).write(claims)) is (share == 1)


@pytest.mark.usefixtures("coarse")
def test_what_is_behind_a_dead_band_may_have_more_gain():
    """A dead band of the spool hides more flow of a member with a larger flow gain; its claims are of the largest."""
    rig, box, claims, _ = erring({"valve_deadband": {"half_width_A": 1e-4}})
    largest = nearest(box.ranges["flow_gain"][1])
    assert largest > 1.04 * figures(rig)["flow_gain"]
    assert [nearest(claim.asked.error.size) for claim in claims] == pytest.approx([1e-4 * largest] * len(claims))


@pytest.mark.usefixtures("coarse")
def test_while_a_gain_ripples_errors_of_a_box_are_of_its_largest_gain():
    ripple = {"carrier_ripple": {"depth": 0.1, "residual_V": 0.01}}
    rig = erring({})[0].but(tolerance=Tolerance(sensor_gain=0.02), effects=ripple)
    box = tolerance_box(rig, 1.0, ["sensor_gain"], (0.0, 2.0))
    claims, rows = errors_over_box(rig, box)
    gain = nearest(box.ranges["sensor_gain"][1])
    assert gain > 1.001 * rig.sensor.gain_V_per_m
    by_size = sorted(claims, key=lambda claim: claim.asked.limit)  # the largest of each is kept
    sizes = {nearest(claim.asked.error.size): claim.asked.limit for claim in by_size}
    assert sorted(sizes) == pytest.approx([0.01, 0.1 * gain])
    residual, share = (
        max(c.asked.limit for c in claims if nearest(c.asked.error.size) == one) for one in sorted(sizes)
    )
    assert [row.bound_m for row in rows] == pytest.approx([residual, residual / (1 - share)], rel=1e-3)
    assert valid(certify_box(rig, box, volumes=False).write(claims))


@pytest.mark.usefixtures("coarse")
def test_a_bound_says_at_which_gain_it_is_where_orifices_raise_that():
    """Of a sine in the current, by the series of impedances that the paper's equations are: at the gain that orifices
    reach against 1500 N a member of the box is moved by several times the bound, which is of the gain without them.
    """
    rig, (mass, size) = erring({})[0], (2.0, 1e-4)
    effects = {"pressure_dependent_flow": {}, "valve_hysteresis": {"half_width_A": size}}
    payload = rig.payload.but(outer_end_mass_kg=(mass, mass), largest_force_N=1500.0)
    rig = rig.but(effects=effects, payload=payload, controller=rig.controller.but(gain_A_per_V=0.12))
    box = tolerance_box(rig, 0.0, None, (mass, mass))
    assert certify_box(rig, box, volumes=False).stable
    (row,) = errors_over_box(rig, box)[1]
    assert row.covers.count("at the gain without pressure_dependent_flow") == 1
    f, s = figures(rig), 2j * np.pi * np.geomspace(1.0, 400.0, 3000)
    outer, inner = (
        f[f"{beam}_stiffness"] + f[f"{beam}_damping"] * s + (f[f"{beam}_mass"] + more) * s**2
        for beam, more in (("outer", mass), ("inner", rig.payload.inner_end_mass_kg))
    )
    gives = s * (1 / outer + 1 / inner + 1 / f["oil_stiffness"]) + f["leakage"] / f["piston_area"] ** 2
    valve = f["flow_gain"] / (
        1 + 2 * f["valve_damping_ratio"] * s / f["valve_frequency"] + (s / f["valve_frequency"]) ** 2
    )
    moved, law = valve / f["piston_area"] / gives / outer, rig.controller
    fed = (
        f["sensor_gain"] * law.gain_A_per_V * (1 + s / (2 * np.pi * law.zero_Hz)) / (1 + s / (2 * np.pi * law.pole_Hz))
    )
    highest = sqrt(1 + (1500 + STANDARD_GRAVITY * mass) / f["piston_area"] / rig.supply.pressure_Pa)
    assert nearest(box.ranges["effect_gain"][1]) == pytest.approx(highest)
    by_sine = [size * abs(gain * moved / (1 + gain * moved * fed)).max() for gain in (1.0, highest)]
    assert by_sine[0] < row.bound_m < by_sine[1] / 3


def test_without_width_it_is_above_the_integral_and_not_far():
    """Of the exact prover over masses, which adds up absolute impulse responses."""
    rig = erring({})[0].but(effects={"valve_hysteresis": {}})
    _, rows = errors_over_box(rig, tolerance_box(rig, 0.0, None, (1.0, 1.4)))
    (exactly,) = [row for row in bounded_error.bounded_rows(members(rig, 1.0, 1.4)) if row.bound_m is not None]
    assert [row.proved for row in rows] == [True]
    assert exactly.bound_m / 1.1 < rows[0].bound_m < 2.5 * exactly.bound_m


@pytest.mark.parametrize("shares", [(-1, -1), (1, 1), (1, -1)])
def test_drawn_rigs_stray_by_less(
    shares: tuple[int, int], with_hysteresis: tuple[Prototype, Box, list[BoxClaim], list[Row]]
):
    rig, _, claims, rows = with_hysteresis
    (bound,) = [row.bound_m for row in rows]
    assert bound == max(claim.asked.limit for claim in claims)
    one = with_figures(rig, {"outer_stiffness": 1 + 0.03 * shares[0], "flow_gain": 1 + 0.05 * shares[1]})
    signals = (
        Multisine(amplitude_N=300.0, low_Hz=1.0, high_Hz=60.0, seed=1),
        Multisine(amplitude_V=0.3, low_Hz=1.0, high_Hz=40.0, seed=2),
    )
    plain, moved = (motions(some, signals, 1.5, 1.0)[0] for some in (one.but(effects={}), one))
    assert 0.02 * bound < abs(moved - plain).max() <= bound


def test_the_check_says_of_what_it_is():
    made = honest("beamdesign.box", "erring")
    words = [words for words in check(made.text).proved if "an error of at most" in words]
    assert len(words) == len(made.table["claim"])
    assert all("valve_hysteresis_spring 0" in one and "A in the current" in one for one in words)


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("limit",), "0.00000001"),
        (("size",), "0.01"),
        (("decay_per_s",), "300"),
        (("decay_per_s",), "0"),
        (("corner_rad_per_s",), "10"),
        (("place",), "volts"),
        (("place",), "nut"),
        (("band", 0, "limit"), "0.0001"),
        (("band", 2, "until_rad_per_s"), "0.1"),
        (("band",), []),
    ],
)
def test_what_is_altered_is_refused(place: tuple[str | int, ...], value: object):
    assert not valid(altered(honest("beamdesign.box", "erring").text, (*CLAIM, *place), value))


def test_the_last_band_has_no_end():
    text = honest("beamdesign.box", "erring").text
    bands = tomllib.loads(text)["claim"][0]["band"]
    assert not valid(altered(text, (*CLAIM, "band"), bands[:-1]))


def test_a_depth_is_no_error_of_its_own_where_no_bound_is_proved():
    """Of the hysteresis none is: over a box with a delay, and of a loop that is not stable."""
    rig, _, _, _ = erring({})
    rig = rig.but(effects={"valve_hysteresis": {}, "carrier_ripple": {"depth": 0.02}})
    _, over_box = errors_over_box(rig, tolerance_box(rig, 0.0, None, (0.0, 1.0), delay_s=(0.0, 1e-4)))
    law = rig.own_controller
    unstable = rig.but(controller=law.but(gain_A_per_V=30 * law.gain_A_per_V))
    for rows in (over_box, [*bounded_error.bounded_rows(members(unstable, 0.0, 1.0))]):
        assert [(row.effects, row.proved) for row in rows] == [(("valve_hysteresis",), False)]


def test_a_delay_is_not_covered():
    rig = erring({})[0].but(effects={"valve_hysteresis": {}})
    claims, rows = errors_over_box(rig, tolerance_box(rig, 0.0, None, (0.0, 1.0), delay_s=(0.0, 1e-4)))
    assert not claims
    assert [row.proved for row in rows] == [False]
    assert "a delay" in rows[0].covers


@pytest.mark.parametrize("peak", [1.0, 1.3, 2.0, 7.0])
def test_on_the_circle_that_a_peak_sensitivity_keeps_free_the_criterion_just_holds(peak: float):
    """Re[(1 + b L) conj(1 + a L)] is zero on |1 + L| = 1 / m, positive outside; over b, where that is infinite."""
    low, high = changing_gain.covered(exact(peak))
    turn = np.exp(2j * np.pi * np.linspace(0.0, 1.0, 33))
    for outside in (1.0, 1.01, 3.0):
        loops = -1 + outside / peak * turn
        over = loops if high is None else 1 / nearest(high) + loops
        real = (over * np.conj(1 + nearest(low) * loops)).real
        assert abs(real).max() < 1e-12 if outside == 1.0 else real.min() > 0
    assert (high is None) is (peak == 1.0)
    assert nearest(low) == pytest.approx(0.5 if peak == 1.0 else peak / (peak + 1))


@pytest.mark.parametrize("peak", [1.0, 3.0])
def test_a_peak_sensitivity_of_one_covers_every_gain_from_one_half_up(peak: float):
    """No loop that falls off twice as fast as frequency grows has it (Bode), so that the claim is made by hand."""
    rig = erring({})[0].but(effects={"carrier_ripple": {"depth": 0.5, "residual_V": 0.0}})
    box = tolerance_box(rig, 0.0, None, (0.0, 2.0))
    claim = claim_over_box(rig, box, Asked("peak_sensitivity", 2.2))
    one = replace(claim, asked=Asked("peak_sensitivity", peak), holds=True)
    (row,) = changing_gain.changing_over_box(members(rig, 0.0, 2.0), box, [one])
    assert row.proved is (peak == 1.0)
    assert f"between 0.5 and {'any number' if peak == 1.0 else '1'} times its own" in row.covers


@pytest.mark.parametrize("peak", [2.2, 15.0])
def test_a_peak_sensitivity_is_a_gain_that_may_change(peak: float):
    """The exact prover of masses has the circle criterion for what is inside."""
    rig = erring({})[0].but(effects={"carrier_ripple": {"depth": 0.1, "residual_V": 0.0}})
    box, given = tolerance_box(rig, 0.0, None, (0.0, 2.0)), members(rig, 0.0, 2.0)
    claim = claim_over_box(rig, box, Asked("peak_sensitivity", peak))
    assert claim.holds
    (row,) = changing_gain.changing_over_box(given, box, [claim])
    assert row.proved is (peak == 2.2)
    if row.proved:
        ends = exact(0.9), exact(1.1)
        assert changing_gain.margin_of(given.loops[0], "volts", *ends, given.low, given.high) is not None
    (none,) = changing_gain.changing_over_box(given, box, [])
    assert not none.proved


def test_a_gain_that_changes_does_so_as_of_any_rig_of_the_box():
    """Orifices pass on what the load leaves of the supply, and the smallest piston takes most of it."""
    rig = erring({})[0].but(
        effects={"pressure_dependent_flow": {"supply_pressure_Pa": 1.4e7}}, tolerance=Tolerance(piston_area=0.1)
    )
    rig = rig.but(payload=rig.payload.but(largest_force_N=200.0))
    box = tolerance_box(rig, 1.0, ["piston_area"], (0.0, 2.0))
    claim = replace(claim_over_box(rig, box, Asked("peak_sensitivity", 1.3)), holds=True)
    (row,) = changing_gain.changing_over_box(members(rig, 0.0, 2.0), box, [claim])
    share = (200 + 2 * STANDARD_GRAVITY) / (0.9 * rig.actuator.piston_area_m2 * 1.4e7)
    assert f"between {sqrt(1 - share):.4g} and {sqrt(1 + share):.4g}" in row.covers


def test_an_error_of_no_size_moves_nothing_and_needs_no_proof():
    """A resolution and a friction of zero are figures that a prototype may state."""
    rig, box, _, _ = erring({})
    none = {"seal_friction": {"coulomb_N": 0.0}, "valve_deadband": {"half_width_A": 0.0}}
    rig = rig.but(effects=none, sensor=rig.sensor.but(resolution_m=0.0))
    claims, rows = errors_over_box(rig, box)
    assert claims == []
    assert [row.proved for row in rows] == [True] * 4
    assert {row.bound_m for row in rows} == {0.0}
