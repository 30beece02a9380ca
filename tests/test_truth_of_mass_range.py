"""The model of what a certificate over a mass range states, against closed forms, what is honest and what is false."""

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import truth_of_mass_range
from forging import put, resealed
from honest_certificates import EACH, Honest, honest, valid
from rig_of_certificate import members
from scipy import signal


@pytest.fixture
def stable() -> Honest:
    """Of the paper's remedy from 3 to 6.8 kg."""
    return honest("beamdesign.mass_range", "stable")


def test_the_model_is_the_loop_of_the_papers_equations():
    """Equations (7) to (18) put together by hand as transfer functions, with one mass on either tip."""
    made = honest("beamdesign.mass_range", "stable")
    rig = {key: float(Fraction(text)) for key, text in made.table["rig"].items() if key != "kind"}
    (loop,), mass = members(made.table), 5.0
    outer = [rig["outer_mass_kg"] + mass, rig["outer_damping_N_s_per_m"], rig["outer_stiffness_N_per_m"]]
    inner = [rig["inner_mass_kg"] + 4.5, rig["inner_damping_N_s_per_m"], rig["inner_stiffness_N_per_m"]]
    area, oil = rig["piston_area_m2"], rig["oil_stiffness_N_per_m"]
    # outer x = F_d + F, inner y = -F, A s (x - y) = Q - leak F / A - (A / K_c) s F.
    soft = np.array([area / oil, rig["leakage_m3_per_s_per_Pa"] / area])
    both = np.polymul(outer, inner)
    plant = np.polyadd(np.polymul(soft, both), np.polymul([area, 0.0], np.polyadd(outer, inner)))
    valve = np.polymul([1.0, 942.4777960769379, 942.4777960769379**2], [1 / (2 * np.pi * 1.75), 1.0])
    drive = 0.15 * 1180.0 * 942.4777960769379**2 * 1.13e-2 * np.array([1 / (2 * np.pi * 26.0), 1.0])
    opened, returned = np.polymul(plant, valve), np.polymul(drive, inner)
    closed = np.polyadd(opened, returned)
    poles, expected = (sorted(found, key=lambda pole: pole.imag) for found in (loop.poles(mass, 1.0), np.roots(closed)))
    np.testing.assert_allclose(poles, expected, rtol=1e-7)
    moved = np.polymul(np.polyadd(np.polymul(soft, inner), [area, 0.0]), valve)
    w = np.geomspace(1.0, 1e4, 50)
    found = loop.responses(mass, 1.0, w)
    for name, above, below in (
        ("compliance", moved, closed),
        ("peak_sensitivity", opened, closed),
        ("loop_gain", returned, opened),
    ):
        np.testing.assert_allclose(found[name], abs(signal.freqs(above, below, w)[1]), rtol=1e-7)


@pytest.mark.parametrize(("kind", "name"), [place for place in EACH if place[0] == "beamdesign.mass_range"])
def test_the_model_calls_what_was_asked_true(kind: str, name: str):
    """What was worked out as the best that can be claimed is too close to call, and left out."""
    made = honest(kind, name)
    table = made.table
    claims = [claim for claim in table.get("claim", []) if claim["kind"] not in ("compliance", "peak_sensitivity")]
    assert truth_of_mass_range.true(table | {"claim": claims}) is True


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("claim", 0, "limit"), "20"),
        (("claim", 1, "limit"), "5"),
        (("claim", 2, "limit"), "1.5"),
        (("claim", 3, "bandwidth_Hz"), "8"),
        (("claim", 3, "limit"), "0.00000005"),
        (("rig", "valve_frequency_rad_per_s"), "900"),
        (("rig", "inner_end_mass_kg"), "0"),
        (("rig", "sensor_gain_V_per_m"), "2400"),
        (("rig", "outer_mass_kg"), "30"),
        (("controller", "pole_Hz"), "1.7500001"),
        (("controller", "law", "denominator", 0), "1.1"),
        (("outer_end_mass_kg",), ["0", "6.8"]),
        (("stability", "stable"), False),
        (("stability", "range", 0, "stable"), False),
        (("stability", "range", 0, "low"), "4"),
        (("stability", "stays_stable_to_kg"), "17.8"),
        (("stability", "stays_stable_from_kg"), "1.9"),
        (("claim", 0), {"kind": "decay_rate", "limit": "3", "holds": False, "witness": {"outer_end_mass_kg": "4"}}),
    ],
)
def test_the_model_finds_what_is_false(stable: Honest, place: tuple[Any, ...], value: Any):
    table = stable.table
    put(table, place, value)
    assert truth_of_mass_range.true(table) is False
    assert not valid(resealed(table))


@pytest.mark.parametrize(
    ("name", "place", "value"),
    [
        ("unstable", ("stability", "stable"), True),
        ("unstable", ("stability", "range", 1, "stable"), False),
        ("unstable", ("stability", "range", 2, "stable"), True),
        ("unstable", ("stability", "range", 1, "high"), "17.9"),
        ("unstable", ("stability", "range", 0, "sample"), "3"),
        ("unstable", ("stability", "crossing", 0, "squared_frequency"), ["680000", "680001"]),
        ("unstable", ("stability", "crossing", 1, "frequency_Hz"), ["27", "27.1"]),
        ("unstable", ("stability", "crossing"), []),
        ("effects", ("effect", 2, "gain"), ["0.2", "4"]),
        ("effects", ("effect", 1, "elements", "volts", 0, "denominator"), ["2513.2741228718344", "40"]),
        ("effects", ("effect", 0, "elements", "impedance", 0, "resists"), ["0", "-50000"]),
        ("effects", ("effect", 0, "span", "spring_N_per_m", "performing"), ["0", "11999999.999999998"]),
        ("sections", ("controller", "section", 0, "pole_Hz"), "35.0001"),
        ("sections", ("controller", "gain_A_per_V"), "0.07"),
        ("sensors", ("controller", "a", 0, 0), "-11"),
        ("sensors", ("controller", "law", "numerators", 1, 0), "1"),
    ],
)
def test_the_model_finds_what_is_false_elsewhere(name: str, place: tuple[Any, ...], value: Any):
    table = honest("beamdesign.mass_range", name).table
    put(table, place, value)
    assert truth_of_mass_range.true(table) is False
    assert not valid(resealed(table))
