"""Forgeries that change what loop is proved rather than a figure of it, and rigs of a box that no member stood for."""

import tomllib
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import pytest
from flint import fmpq
from forging import resealed, spelled, times
from honest_certificates import Honest, honest

from beamdesign import Prototype, certify, check
from beamdesign.checker import Unreadable, box_loop
from beamdesign.checker.reading import read
from beamdesign.checker.rig import Rig, Span
from beamdesign.checker.roots import Family
from beamdesign.controllers import Lag, Scheduled, Stage
from beamdesign.plant.members import family
from beamdesign.polynomial import exact, nearest
from beamdesign.proofs.box import certify_box
from beamdesign.proofs.box_claims import claim_over_box
from beamdesign.proofs.certificate import Asked
from beamdesign.proofs.tolerance_box import tolerance_box
from beamdesign.proofs.writer import prototype_table
from beamdesign.prototype import Arm, Tolerance
from beamdesign.synthesis.design_run import stating

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


def with_another_law(table: dict[str, Any]) -> None:
    """An observer of a hundred times the static gain that `gain_A_per_V` names: its loop is not stable."""
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


def test_a_law_of_order_one_that_is_no_lag_is_not_proved_as_one():
    table = tomllib.loads(honest("beamdesign.box", "stable").text)
    with_another_law(table)
    assert refused(resealed(table))


def test_spans_of_effects_are_no_figures_of_a_law():
    """An effect called `controller` whose spans would stand for the breaks of a lag, which the law is not."""
    table = tomllib.loads(honest("beamdesign.box", "stable").text)
    with_another_law(table)
    spans = {}
    for name in ("zero", "pole"):
        figure = table["range"][f"controller_{name}"][0]
        ends = [figure, times(figure, "1.000000000001")]
        spans[name], table["range"][f"controller_{name}"] = {"ends": ends}, ends
    table["effect"] = [{"name": "controller", "parameters": {}, "span": spans, "elements": {}}]
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


@pytest.mark.parametrize("figure", ["screw_stiffness", "filter_frequency"])
@pytest.mark.parametrize("made", [("beamdesign.mass_range", "effects"), ("beamdesign.box", "stable")])
def test_what_resists_is_times_no_figure_that_the_rig_does_not_have(made: tuple[str, str], figure: str):
    table = tomllib.loads(honest(*made).text)
    spring = {"impedance": [{"motion": {"first": "1"}, "resists": [f"1*{figure}"]}]}
    table.setdefault("effect", []).append({"name": "x", "parameters": {}, "elements": spring})
    with pytest.raises(Unreadable, match=figure):
        check(resealed(table))


@pytest.mark.parametrize("point", ["rod", "sensed", "slide"])
@pytest.mark.parametrize("made", [("beamdesign.mass_range", "stable"), ("beamdesign.box", "stable")])
def test_no_point_rides_on_what_nothing_resists(made: tuple[str, str], point: str):
    """Such a coordinate has no equation."""
    table = tomllib.loads(honest(*made).text)
    table["effect"] = [{"name": "x", "parameters": {}, "elements": {"points": {point: {"q": "1"}}}}]
    with pytest.raises(Unreadable, match="no motion of q"):
        check(resealed(table))


def test_a_box_has_no_gain_of_effects_that_it_does_not_state():
    """Eight times the gain, which is not stable, beside a factor of an eighth that nothing puts on it."""
    made = honest("beamdesign.box", "stable")
    table = made.table
    law, gain = table["controller"]["law"], times(table["controller"]["gain_A_per_V"], 8)
    law["numerators"] = [[times(c, 8) for c in row] for row in law["numerators"]]
    table["controller"]["gain_A_per_V"], table["member"]["controller_gain"] = gain, gain
    table["range"] |= {"controller_gain": [gain, gain], "effect_gain": ["1/8", "1/8"]}
    table["member"]["effect_gain"] = "1/8"
    (group,) = (one for one in table["group"] if "controller_gain" in one["members"])
    group["members"].append("effect_gain")
    assert not any(is_stable(resealed(table)))
    assert refused(resealed(table))


def guaranteeing(prototype: Prototype, text: str, masses: tuple[float, float], sigmas: float) -> dict[str, object]:
    """The table of a prototype that states a guarantee which rests on a certificate."""
    peak = float(next(Fraction(one["limit"]) for one in tomllib.loads(text)["claim"] if "sensitivity" in one["kind"]))
    return prototype_table(stating(prototype, text, masses, 0.0, peak, sigmas=sigmas), masses[1])


def test_a_box_without_deviations_is_of_no_standard_deviation():
    """Of exactly the figures, and beside them an empty [tolerance]."""
    made: Honest = honest("beamdesign.box", "performing")
    assert check(made.text, guaranteeing(made.prototype, made.text, (0.0, 2.0), 1.0)).valid
    box = tolerance_box(made.prototype, 0.0, None, (0.0, 2.0))
    claim = claim_over_box(made.prototype, box, Asked("peak_sensitivity", 2.5))
    table = tomllib.loads(certify_box(made.prototype, box, volumes=False).write([claim])) | {"tolerance": {}}
    assert refused(resealed(table), guaranteeing(made.prototype, resealed(table), (0.0, 2.0), 1.0))
    assert check(resealed(table), guaranteeing(made.prototype, resealed(table), (0.0, 2.0), 0.0)).valid


def test_tolerances_that_no_box_spans_are_told_not_to_be_looked_at():
    """A box of one figure stood beside a [tolerance] of several; one without that table, beside a prototype's."""
    made: Honest = honest("beamdesign.box", "stable")
    given = prototype_table(made.prototype, 2.0)
    assert not any("tolerance" in words for words in check(made.text, given).open)
    box = tolerance_box(made.prototype, 1.0, ["flow_gain"], (0.0, 2.0))
    text = certify_box(made.prototype, box, volumes=False).certificate
    (told,) = [words for words in check(text, given).open if "tolerance" in words]
    assert "that outer_stiffness, outer_damping, inner_stiffness, inner_damping are as stated" in told
    bare = {key: value for key, value in tomllib.loads(text).items() if key != "tolerance"}
    for forged in (bare, bare | {"tolerance": {}}):
        (told,) = [words for words in check(resealed(forged), given).open if "tolerance" in words]
        assert "prototype's [tolerance]" in told


def test_one_law_proves_nothing_of_several():
    """Of two laws the second is not stable."""
    lag = {"pole_Hz": 1.7, "zero_Hz": 20.0}
    stages = (
        Stage(outer_end_mass_kg=(0, 6), gain_A_per_V=0.05, **lag),
        Stage(outer_end_mass_kg=(5, 6.8), gain_A_per_V=0.5, **lag),
    )
    rig = tame().but(controller=Scheduled(stage=stages))
    first, second = rig.stages(MASSES)
    text = certify(first.prototype, *MASSES, [Asked("peak_sensitivity", 2.0)]).text
    assert not certify(second.prototype, *second.outer_end_mass_kg).stable
    assert check(text, prototype_table(rig, 6.8)).valid
    assert refused(text, guaranteeing(rig, text, MASSES, 0.0))


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


@pytest.mark.parametrize("fixed", [0, 1])
def test_spans_that_share_a_name_in_a_box_are_refused_though_one_of_them_does_not_vary(
    fixed: int, monkeypatch: pytest.MonkeyPatch
):
    """A span `b_c` of the effect `a` and one `c` of `a_b` are both called a_b_c."""
    monkeypatch.setattr(box_loop, "figures", lambda rig: {})
    ends = [Span((fmpq(1), fmpq(2 - (k == fixed))), (fmpq(1), fmpq(1))) for k in range(2)]
    named = [SimpleNamespace(name="a", spans={"b_c": ends[0]}), SimpleNamespace(name="a_b", spans={"c": ends[1]})]
    with pytest.raises(Unreadable, match="a_b_c stands for more than one thing"):
        box_loop.spans(SimpleNamespace(effects=named))
