"""A saturated current while a gain changes elsewhere: proved, proved again, refused, and the motion it speaks of."""

import tomllib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from flint import fmpq
from forging import altered
from honest_certificates import valid
from scipy.integrate import solve_ivp

from beamdesign import Prototype, certify, check, read_prototype, simulate
from beamdesign.controllers import Lag
from beamdesign.plant.effects import library
from beamdesign.polynomial import ratio
from beamdesign.proofs.certificate import Certificate
from beamdesign.proofs.changing_gain import BOTH, Changing, Pair, both_rows, pair, search
from beamdesign.proofs.multiplier import Kernel, Multiplier
from beamdesign.proofs.scope import members
from beamdesign.scenario import Scenario, ScenarioRecord, Step

ROOT = Path(__file__).parent.parent
MASSES = fmpq(0), fmpq(34, 5)
EFFECTS: dict[str, dict[str, dict[str, float]]] = {
    "sides": {"unequal_piston_areas": {}},
    "ripple": {"carrier_ripple": {"depth": 0.05}},
    "orifices": {"pressure_dependent_flow": {}},
}


@pytest.fixture(scope="module")
def tame() -> Prototype:
    """The tame lag, 1.7/20 Hz at 50 mA/V."""
    return read_prototype(ROOT / "studies/prototypes/tame_lag.toml")


@pytest.fixture(scope="module")
def proved(tame: Prototype) -> Callable[[str], Certificate]:
    """What is proved of the rig with some of the effects, once of each."""
    return cache(lambda name: certify(tame.but(effects=EFFECTS[name]), 0.0, 6.8, nonlinear=True))


@pytest.fixture(scope="module")
def written(proved: Callable[[str], Certificate]) -> str:
    return proved("sides").text


def changing_pair(rig: Prototype, place: str, least: fmpq, most: fmpq) -> Pair:
    given = members(rig, 0.0, 6.8)
    found = pair(given, given.found.members[0], Changing("any", place, least, most, ""))
    assert found is not None
    return found


@pytest.mark.parametrize("name", EFFECTS)
def test_both_at_once_are_proved(proved: Callable[[str], Certificate], name: str):
    found = proved(name)
    (row,) = [row for row in found.nonlinear if row.effects == ("current_saturation", *EFFECTS[name])]
    assert row.proved
    verdict = check(found.text)
    assert verdict.valid
    # The weight of 6.8 kg, to whose pressure the gain of orifices between these factors belongs.
    assert ("within that of 66.6852 N" in row.covers) is (name == "orifices")


def test_a_ripple_acts_before_filters(tame: Prototype):
    """Of what the sensor gives and the controller hears, the parts on either side of the gain are those of the loop."""
    rig = tame.but(sensor=tame.sensor.but(filter_Hz=400.0), effects={"sensor_lag": {}})
    found = changing_pair(rig, "volts", fmpq(1), fmpq(1))
    w = np.geomspace(0.1, 1e4, 50)
    closed, _, by = found.responses(np.array([2.0]), w)
    onto = ratio(*found.onto, np.array([2.0]), w)
    assert np.allclose(1 + onto * by, closed, rtol=1e-9)
    law = tame.controller
    assert law is not None
    gain, pole, zero = (law.figures()[key] for key in ("gain", "pole", "zero"))
    lag = gain * (1 + 1j * w / zero) / (1 + 1j * w / pole)
    filters = onto[0] / lag
    break_Hz = library()["sensor_lag"].parameters[0].default
    expected = 1 / ((1 + 1j * w / (2 * np.pi * 400)) * (1 + 1j * w / (2 * np.pi * break_Hz)))
    assert np.allclose(filters, expected, rtol=1e-6)
    ripple = rig.but(effects={"sensor_lag": {}, "carrier_ripple": {}})
    assert [row.proved for row in both_rows(members(ripple, 0.0, 6.8))] == [True]
    assert check(certify(ripple, 0.0, 6.8, nonlinear=True).text).valid


def test_the_lag_of_5_Hz_has_one_too(tame: Prototype):
    rig = tame.but(controller=Lag(gain_A_per_V=0.1438, pole_Hz=1.138, zero_Hz=37.54), effects=EFFECTS["sides"])
    assert [row.proved for row in both_rows(members(rig, 0.0, 6.8))] == [True]


@pytest.mark.parametrize("place", ["volts", "flow"])
def test_the_exact_slack_is_that_of_the_matrix(tame: Prototype, place: str):
    """Against floats, with kernels of both sides."""
    found = changing_pair(tame, place, fmpq(9, 10), fmpq(6, 5))
    multiplier = Multiplier(((fmpq(1, 2), Kernel(400, 3)), (fmpq(1, 5), Kernel(40, 2, False))), fmpq(1, 1000))
    weight, margin = fmpq(3, 2) if place == "flow" else fmpq(1, 10**6), fmpq(1, 100)
    for mass, w in ((0, 3), (2, 60), (6, 500)):
        at = np.array([float(w)])
        closed, onto, by = (part[0, 0] for part in found.responses(np.array([float(mass)]), at))
        m, size = multiplier.response(at)[0], float(weight)
        room = 4 * size * ((m * closed).real - float(margin)) - abs(m * onto - size * by.conjugate()) ** 2
        x = fmpq(w) ** 2
        a, b, c = (q(x) for q in found.slack(multiplier, weight, margin))
        d = found.denominator.at(fmpq(mass))
        parts = [sum(z * (-1) ** (k // 2) * fmpq(w) ** k for k, z in enumerate(d.coeffs()) if k % 2 == odd)
                 for odd in (0, 1)]  # fmt: skip
        below = float((parts[0] ** 2 + parts[1] ** 2) * multiplier.below(x) ** 2)
        assert float((a * mass + b) * mass + c) / below == pytest.approx(room, rel=1e-8)


def test_two_whole_sectors_have_none(tame: Prototype):
    """A dead band and a saturation at once may each take all of the gain: no weight is enough."""
    assert search([changing_pair(tame, "flow", fmpq(1, 1000), fmpq(1))], *MASSES) is None


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("gain", ["0.1", "1.137656"]),
        ("gain", ["0", "1.137656"]),
        ("gain", ["0.89", "3"]),
        ("weight", "100"),
        ("weight", "0"),
        ("weight", "-1"),
        ("margin", "0.9"),
        ("margin", "0"),
        ("popov_s", "-0.001"),
        ("popov_s", "0.5"),
        ("place", "volts"),
        ("place", "stroke"),
        ("loops", [2]),
        ("term", []),
    ],
)
def test_an_altered_statement_is_refused(written: str, key: str, value: object):
    (k,) = [k for k, one in enumerate(tomllib.loads(written)["nonlinear"]) if one["kind"] == "both"]
    assert not valid(altered(written, ("nonlinear", k, key), value))


def test_rows_say_what_is_not_covered(tame: Prototype):
    rig = tame.but(effects=EFFECTS["sides"] | {"valve_deadband": {}, "current_saturation": {}})
    assert not [row for row in both_rows(members(rig, 0.0, 6.8)) if row.method == BOTH]
    rows = certify(rig, 2.0, 3.0, nonlinear=True).nonlinear
    assert {row.effects for row in rows if not row.proved} == {
        ("current_saturation", "unequal_piston_areas", "valve_deadband")
    }


def test_a_ripple_drives_a_loop_whose_valve_rests_off_its_null(tame: Prototype):
    """Without command and load the tip swings for good, by equations (7) to (16) of Zalucky and Hardt (1984).

    The leakage nulls at a current, so that the tip rests off zero, where the ripple of the gain is one of the volts.
    """
    depth, frequency_Hz, imbalance, mass = 0.05, 50.0, 0.9, 2.0
    flow = imbalance * 20e6 * 3.8e-13  # of the leakage into one chamber and out of the other
    dashpots = (2 * 0.05 * np.sqrt(k * m) for k, m in ((486_800.0, 3.9), (157_500.0, 1.6)))
    outer, inner, w, pole, zero = *dashpots, *(2 * np.pi * f for f in (150.0, 1.7, 20.0))

    def rate(t: float, state: np.ndarray) -> list[float]:
        x, v, c, y, u, q, r, held = state
        force = 1.3e7 * (c - x)
        volts = -1180.0 * x * (1 + depth * np.sin(2 * np.pi * frequency_Hz * t))
        current = 0.05 * (pole / zero * volts + held)
        fed = q + flow - 3.8e-13 * force / 1.13e-4
        return [
            v, (force - 486_800.0 * x - outer * v) / (3.9 + mass), u + fed / 1.13e-4,
            u, (-force - 157_500.0 * y - inner * u) / (1.6 + 2.5), r, w * w * (1.13e-2 * current - q) - w * r,
            pole * ((1 - pole / zero) * volts - held),
        ]  # fmt: skip

    last = np.linspace(2.9, 3.0, 500)
    moved = solve_ivp(rate, (0.0, 3.0), np.zeros(8), method="LSODA", t_eval=last, rtol=1e-8, atol=1e-14).y[0]
    assert moved.mean() == pytest.approx(flow / (1.13e-2 * 0.05 * 1180.0), rel=0.05)
    assert np.ptp(moved) > 1e-3 * moved.mean()
    ripple = {"carrier_ripple": {"depth": depth, "frequency_Hz": frequency_Hz}}
    rig = tame.but(effects=ripple | {"uneven_leakage": {"imbalance": imbalance}})
    (row,) = both_rows(members(rig, mass, mass))
    assert row.effects == ("current_saturation", "carrier_ripple")
    assert not row.proved
    assert row.statement is None


@pytest.mark.parametrize("mass", [0.5, 6.5])
def test_the_rig_comes_to_rest(tame: Prototype, mass: float):
    """Pushed so far that the current saturates, with sides that are unequal, and let go."""
    limit = 0.5e-3
    rig = tame.but(effects={"unequal_piston_areas": {}, "current_saturation": {"limit_A": limit}})
    push = Step(amplitude_N=600.0, at_s=0.05, length_s=0.3)
    row = ScenarioRecord(name="push", outer_end_mass_kg=mass, input=(push,))
    found = simulate(rig, Scenario(name="push", duration_s=4.0, start="rest", record=(row,))).records[0]
    current, moved = found.column("current_A"), found.column("displacement_m")
    assert abs(current).max() == pytest.approx(limit, rel=1e-6)
    assert found.stable
    assert abs(moved[-200:]).max() < 1e-3 * abs(moved).max()
