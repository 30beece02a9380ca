"""Forgeries that change what loop is proved rather than a figure of it, and rigs of a box that no member stood for."""

import tomllib
from fractions import Fraction

import pytest
from flint import fmpq
from forging import resealed, spelled
from honest_certificates import honest

from beamdesign import Prototype, certify, check
from beamdesign.checker import Unreadable
from beamdesign.checker.reading import read
from beamdesign.checker.rig import Rig
from beamdesign.checker.roots import Family
from beamdesign.controllers import Lag
from beamdesign.plant.members import family
from beamdesign.polynomial import exact, nearest
from beamdesign.proofs.tolerance_box import tolerance_box
from beamdesign.proofs.writer import prototype_table
from beamdesign.prototype import Arm, Tolerance

MASSES = (0.0, 6.8)


def tame() -> Prototype:
    return honest("beamdesign.box", "stable").prototype.but(effects={})


def refused(text: str, given: object = None) -> bool:
    try:
        return not check(text, given).valid  # type: ignore[arg-type]
    except Unreadable:
        return True


def is_stable(text: str) -> list[bool]:
    """Of every loop that a certificate states, without a payload."""
    table, _ = read(text.encode())
    return [Family(*one.closed).is_stable(fmpq(0)) for one in Rig(table).loops()]


def test_a_law_of_order_one_that_is_no_lag_is_not_proved_as_one():
    """An observer of a hundred times the static gain that `gain_A_per_V` names: its loop is not stable."""
    table = tomllib.loads(honest("beamdesign.box", "stable").text)
    pole, zero = (Fraction(table["range"][f"controller_{name}"][0]) for name in ("pole", "zero"))
    gain, static = Fraction("0.05"), Fraction(100)
    d = static * pole / zero
    cb = static * pole - d * pole
    law = {
        "sensors": ["displacement_m"],
        "numerators": [[spelled(gain * (cb + d * pole)), spelled(gain * d)]],
        "denominator": [spelled(pole), "1"],
    }
    table["controller"] = {
        "kind": "observer", "gain_A_per_V": "0.05", "sensors": ["displacement_m"], "a": [[spelled(-pole)]],
        "b": [[spelled(cb)]], "c": ["1"], "d": [spelled(d)], "law": law,
    }  # fmt: skip
    assert not any(is_stable(resealed(table)))
    assert refused(resealed(table))


def test_two_spans_of_one_name_do_not_pass_for_one():
    """Of effects `x` and `x_y`: the one that destabilises would stay where it does no harm."""
    table = tomllib.loads(honest("beamdesign.box", "stable").text)

    def effect(name: str, span: str, most: str, elements: dict[str, object]) -> dict[str, object]:
        return {"name": name, "parameters": {}, "span": {span: {"ends": ["0", most]}}, "elements": elements}

    pull = {"impedance": [{"motion": {"first": "1"}, "resists": ["-1*y_z"]}]}
    table["effect"] = [effect("x", "y_z", "1000000000", pull), effect("x_y", "z", "1", {})]
    table["range"]["x_y_z"], table["member"]["x_y_z"] = ["0", "1"], "0"
    assert not all(is_stable(resealed(table)))
    assert refused(resealed(table))


def test_a_plane_turns_no_controller_where_a_certificate_has_none():
    own = tame()
    arm = Arm(offset_m=(0.05, 0.0, 0.0), end_polar_inertia_kg_m2=0.0073, second_controller=own.own_controller)
    wild = own.but(controller=Lag(gain_A_per_V=5.0, pole_Hz=1.7, zero_Hz=20.0), arm=arm)
    given = prototype_table(wild, 6.8)
    table = tomllib.loads(certify(own.but(arm=arm), *MASSES).text)
    assert refused(resealed(table), given)
    for plane in ({"name": "y", "free_length_m": "1.195"}, {}, {"name": "y"}):
        assert refused(resealed(table | {"plane": plane}), given)


def test_a_range_hides_no_payload_that_is_not_covered():
    table = tomllib.loads(certify(tame(), 0.0, 1.0).text)
    given = prototype_table(tame(), 1.0)
    assert any("payloads" in line for line in check(resealed(table), given).open)
    assert refused(resealed(table | {"range": {"outer_end_mass": ["0", "100"]}}), given)


def test_names_bring_no_lines_along():
    table = tomllib.loads(honest("beamdesign.mass_range", "effects").text)
    name = "x\nproved: stable from 0 to 1000 kg\nvalid\n#"
    table["effect"].append({"name": name, "parameters": {}, "elements": {}})
    assert all("\n" not in line for line in check(resealed(table)).lines())


def test_what_performs_is_an_end_of_its_span():
    table = tomllib.loads(honest("beamdesign.mass_range", "effects").text)
    span = table["effect"][0]["span"]["spring_N_per_m"]
    span["performing"] = ["0", str(int(Fraction(span["ends"][1])))]
    assert span["performing"][1] != span["ends"][1]
    assert refused(resealed(table))


def test_spans_of_a_box_are_those_of_every_rig_in_it():
    """Orifices take more of the pressure of a smaller piston; the load is the payload's with its own tolerance."""
    effects = {"pressure_dependent_flow": {"supply_pressure_Pa": 6e6}}
    rig = tame().but(tolerance=Tolerance(piston_area=0.1, outer_end_mass=0.1), effects=effects)
    low, high = tolerance_box(rig, 2.0, None, MASSES).ranges["effect_gain"]
    for share in (0.8, 1.0, 1.2):
        area = round(share * rig.actuator.piston_area_m2, 12)
        gain = family(rig.but(actuator=rig.actuator.but(piston_area_m2=area)), 1.2 * 6.8).members[0].gain
        assert nearest(low) <= gain.low <= gain.high <= nearest(high)


@pytest.mark.parametrize("factor", [0.58, 2.8])
def test_a_scaled_box_is_that_of_as_many_standard_deviations(factor: float):
    """Dashpots, 2 zeta sqrt(K M), are not linear in the deviations that scale them."""
    rig = tame().but(tolerance=Tolerance(stiffness=0.05, effective_mass=0.05, beam_damping_ratio=0.2))
    scaled = tolerance_box(rig, 1.0, None, MASSES).scaled(exact(factor))
    asked = tolerance_box(rig, factor, None, MASSES)
    for name in ("outer_damping", "inner_damping", "outer_stiffness"):
        ends = zip(scaled.ranges[name], asked.ranges[name], strict=True)
        assert all(nearest(a) == pytest.approx(nearest(b), rel=1e-9) for a, b in ends)
