"""Refusals of the checker, one after another: a certificate that comes to one is not valid, and is told why.

Each is one that was written for an honest rig, or by hand, with one thing altered and sealed again.
"""

import re
import tomllib
from collections.abc import Mapping
from copy import deepcopy
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from flint import arb, ctx, fmpq, fmpq_poly
from forging import Place, Table, inner, put, resealed, times
from honest_certificates import honest, screw

from beamdesign import Prototype, check
from beamdesign.checker import Unreadable, mechanics, nonlinear
from beamdesign.checker.reading import Table as Reading
from beamdesign.checker.rig import Loop, Rig
from beamdesign.checker.roots import ONE, ZERO, S, stable_on_rectangle, unstable_roots
from beamdesign.controllers import Observer
from beamdesign.proofs.box import certify_box
from beamdesign.proofs.tolerance_box import tolerance_box
from beamdesign.proofs.writer import rig_tables

GONE = object()
Changes = Mapping[Place, Any]
EXPRESSION: Table = {
    "kind": "beamdesign.expression_box",
    "version": 2,
    "name": "s + a",
    "range": {"a": ["1", "2"]},
    "member": {"a": "1"},
    "stable": True,
    "p": "s + a",
    "tree": ["w=4 1,0 inf"],
}
"""Stable: up to 4 rad/s its real part is at least one, and from there on s is the larger term."""


def told(table: Table, given: Any = None) -> str:
    """Why a certificate is not valid."""
    try:
        verdict = check(resealed(table), given)
    except Unreadable as error:
        return str(error)
    assert not verdict.valid
    return "\n".join(verdict.failed)


def stated(rig: Rig) -> list[Table]:
    """The polynomials of every loop."""
    names = ("p0", "p1", "returned", "returned_slope", "disturbance")
    found = ((*loop.closed, *loop.loop_numerator, loop.disturbance) for loop in rig.loops())
    return [{name: written(one) for name, one in zip(names, each, strict=True)} for each in found]


def written(polynomial: fmpq_poly) -> list[str]:
    return [f"{c.p}/{c.q}" for c in polynomial.coeffs()]


def in_s(polynomial: fmpq_poly) -> str:
    """As the text of a leaf."""
    return " + ".join(f"{c.p}/{c.q}*s**{k}" for k, c in enumerate(polynomial.coeffs()))


def made_of(**elements: Any) -> Table:
    """An effect by its elements."""
    return {"name": "x", "parameters": {}, "elements": elements}


def with_changes(table: Table, changes: Changes) -> Table:
    for place, value in changes.items():
        if value is GONE:
            del inner(table, place[:-1])[place[-1]]
        else:
            put(table, place, value)
    return table


def base(name: str) -> Table:
    """A certificate that is valid; of a mass range without claims."""
    match name:
        case "expression":
            return deepcopy(EXPRESSION)
        case "screw":
            return undamped_screw()
        case "mass" | "sensors":
            made = honest("beamdesign.mass_range", "stable" if name == "mass" else name)
            return made.table | {"claim": []}
        case "arm":
            return honest("beamdesign.arm_plane", "twisted").table | {"claim": []}
        case "contact":
            return honest("beamdesign.contact", "walls").table
        case "stages":
            return falling_apart()
    return honest("beamdesign.box", "stable").table


def undamped_screw() -> Table:
    """Beams, screw and rotor without damping, and a law that does nothing: not stable, and no root ever crosses."""
    table = rig_tables(screw())
    for key in table["rig"]:
        if "damping" in key or "friction" in key or "speed_feedback" in key:
            table["rig"][key] = "0"
    table["controller"] = {
        "kind": "none",
        "law": {"sensors": ["displacement_m"], "numerators": [["0"]], "denominator": ["1"]},
    }
    masses = {"low": "1", "high": "2", "sample": "1", "stable": False}
    return over_masses(table, "1", "2", {"stable": False, "range": [masses]})


def falling_apart() -> Table:
    """Payloads of a rig that is not stable with one of them."""
    table = rig_tables(honest("beamdesign.box", "unstable").prototype)
    frozen = {"kind": "frozen", "stage": 1, "outer_end_mass_kg": "0"}
    own = {"kind": "beamdesign.stages", "version": 2, "name": "x", "outer_end_mass_kg": ["0", "1"]}
    return table | own | {"counterexample": [frozen]}


def over_masses(table: Table, low: str, high: str, stability: Table) -> Table:
    """A certificate over a mass range of what is stated of a rig."""
    own = {"kind": "beamdesign.mass_range", "version": 2, "name": "x", "outer_end_mass_kg": [low, high]}
    return table | own | {"stability": stability, "loop": stated(Rig(Reading(table)))}


@pytest.mark.parametrize("name", ["expression", "screw", "stages"])
def test_what_is_written_by_hand_is_valid(name: str):
    assert check(resealed(base(name))).valid


DEVIATION = {"kind": "deviation", "loops": [1], "pieces": 1}
KERNELS = [{"coefficient": "1/100", "rate_per_s": str(k), "order": 16, "causal": True} for k in range(1, 14)]
CHANGE = {"kind": "any_change", "outer_end_mass_kg": ["0", "1"], "P": []}
CYCLE = {"kind": "cycle", "stages": [1, 1], "outer_end_mass_kg": ["0", "1"], "time_s": ["1", "1"], "cycles": 1}
BAND = {"outer": ["1", "9"], "inner": ["2", "8"]}
NO_CROSSING = {"outer_end_mass_kg": ["3/2", "3/2"], "squared_frequency": ["4", "4"]}
LAG = {"gain_A_per_V": 0.15, "pole_Hz": 1.75, "zero_Hz": 26.0}
HALVES = [{"low": low, "high": high, "sample": low, "stable": False} for low, high in (("1", "3/2"), ("3/2", "2"))]


def effects(**elements: Any) -> Changes:
    return {("effect",): [made_of(**elements)]}


def nonlinear_of(**more: Any) -> Changes:
    return {("nonlinear",): [{**DEVIATION, **more}]}


REFUSED: list[tuple[str, Changes, str]] = [
    # of the rig and its effects
    ("mass", effects(points={"elbow": {"q": "1"}}), "not known: elbow"),
    ("mass", effects(impedance=[{"motion": {"first": "1"}, "resists": ["1", "1", "1", "1"]}]), "a spring, a dashpot"),
    ("mass", effects(impedance=[{"motion": {"oil": "1"}, "resists": ["1"]}]), "not a coordinate: oil"),
    ("mass", effects(points={"tip": {"a-b": "1"}}), "not a coordinate: a-b"),
    (
        "mass",
        effects(impedance=[{"motion": {f"q{k}": "1" for k in range(25)}, "resists": ["1"]}]),
        "more than 24 coordinates",
    ),
    ("mass", {("controller",): GONE}, r"\[controller\] is not one law"),
    ("screw", effects(spool="1"), "neither spool nor piston"),
    ("screw", effects(asymmetry="1/10"), "neither spool nor piston"),
    ("screw", effects(points={"tip": {"nut": "1"}}), "does not ride on the nut"),
    ("mass", {("controller", "law", "numerators"): []}, "a numerator for each sensor"),
    ("mass", {("controller", "law", "denominator"): ["0"]}, "a numerator for each sensor"),
    (
        "mass",
        {
            ("controller", "law", "sensors"): ["displacement_m", "screw_force_N"],
            ("controller", "law", "numerators"): [["1"], ["1"]],
        },
        "does not show screw_force_N",
    ),
    # over a mass range
    ("mass", {("stability", "range", 0, "low"): "100"}, "is empty"),
    (
        "mass",
        effects(impedance=[{"motion": {"first": "1"}, "resists": ["0", "0", "-8"]}]),
        "a root passes through infinity at 4.* kg: not listed",
    ),
    (
        "screw",
        {("stability", "range"): HALVES, ("stability", "crossing"): [NO_CROSSING]},
        "no root crosses where it is said to",
    ),
    (
        "sensors",
        {
            ("effect",): [made_of() | {"gain": ["99/100", "1"]}],
            ("claim",): [{"kind": "peak_sensitivity", "limit": "10", "holds": True}],
        },
        "mass and gain multiply each other",
    ),
    # of nonlinear loops
    ("mass", {("nonlinear",): [{}] * 17}, "more than 16 things"),
    ("mass", nonlinear_of(kind="slope", margin="1/100", popov_s="0", term=KERNELS), "higher order together than 192"),
    ("mass", nonlinear_of(error=[{"place": "nut", "size": "1", "bound_m": "1"}]), "not known of this rig"),
    # of a plane of an arm
    ("arm", effects(), "an arm is proved without effects"),
    ("arm", {("arm", "offset_m", 2): "1/10"}, "stands off to both sides"),
    ("arm", {("plane", "section"): GONE}, r"torsional stiffness .* is given by \[arm\] or a section"),
    ("arm", {("plane", "section", "wall_m"): "1/5"}, "does not fit into the sides of a tube"),
    # of contact
    ("contact", effects(), "the tip is proved without effects"),
    ("contact", {("passivity", "band"): [BAND, BAND]}, "do not follow each other"),
    ("contact", {("passivity", "band"): [BAND | {"inner": ["2"]}]}, "must be two ends"),
    ("contact", {("stiffness", "end_stiffness_N_per_m"): "0"}, "must not be 0"),
    # of payloads that change
    ("stages", effects(), "have no effects"),
    ("stages", {("controller",): GONE}, r"no \[controller\], or no mass that changes"),
    ("stages", {("outer_end_mass_kg",): ["1/2", "1/2"]}, r"no \[controller\], or no mass that changes"),
    ("stages", {("claim",): [{}] * 33}, "more than 32 claims"),
    ("stages", {("claim",): [CHANGE | {"outer_end_mass_kg": ["0", "100"]}]}, "not within that of the certificate"),
    ("stages", {("claim",): [CHANGE]}, "degree 0 to 4"),
    (
        "stages",
        {("claim",): [{"kind": "stage_dwell", "outer_end_mass_kg": ["0", "1"], "stage": []}]},
        "a P for each stage",
    ),
    ("stages", {("counterexample",): [CYCLE | {"time_s": ["-1", "1"]}]}, "two times above zero"),
    ("stages", {("counterexample",): [CYCLE | {"stages": [1]}]}, "two stages, two masses"),
    (
        "stages",
        {("counterexample",): [CYCLE | {"outer_end_mass_kg": ["0", "100"]}]},
        "growth is not proved",
    ),
    (
        "stages",
        {
            ("controller", "law", "sensors"): ["displacement_m", "screw_force_N"],
            ("controller", "law", "numerators"): [["1"], ["1"]],
        },
        "does not show screw_force_N",
    ),
    (
        "stages",
        {("controller",): {"kind": "scheduled", "dwell_s": "1", "stage": []}},
        "as many sections as each other",
    ),
    # over a box
    ("box", {("controller",): GONE}, r"there is no \[controller\]"),
    # of expressions
    ("expression", {("range", "s"): ["1", "2"], ("member", "s"): "1"}, "more than one thing: s"),
    ("expression", {("leaf",): {"b": "s + a"}, ("delay",): {"b": "a"}, ("p",): "b"}, "more than one thing: b"),
    ("expression", {("delay",): {"a": "a"}}, "more than one thing: a"),
    ("expression", {("leaf",): {"b": "s**31 + a"}, ("p",): "b*b"}, "a higher degree in s than 60"),
    (
        "expression",
        {("range", "a"): ["-1", "2"], ("group",): [{"name": "b", "kind": "product", "members": ["a"]}]},
        "a factor may be negative",
    ),
    ("expression", {("range", "a-b"): ["1", "2"]}, "not a name"),
    (
        "expression",
        {("leaf",): {f"b{k}": "(1 + a)**8" for k in range(6)}, ("p",): "*".join(f"b{k}" for k in range(6))},
        "more than 100000 terms",
    ),
    (
        "expression",
        {
            ("range",): {name: ["1", "2"] for name in "abcdef"},
            ("member",): dict.fromkeys("abcdef", "1"),
            ("p",): f"s*a + {'*'.join(f'{name}**9' for name in 'abcdef')}",
        },
        "more than 200000",
    ),
    (
        "expression",
        {("leaf",): {"b": "s + 1", "c": "s"}, ("p",): "b + c*late", ("delay",): {"late": "a"}},
        "not proved: the member is stable",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("name", "changes", "words"), REFUSED, ids=[f"{n}-{w}" for n, _, w in REFUSED])
def test_it_is_refused(name: str, changes: Changes, words: str):
    assert re.search(words, told(with_changes(base(name), changes)))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({("controller",): {"stage": [LAG | {"outer_end_mass_kg": 3.0}]}}, r"must be \[least, most\]"),
        ({("controller", "stage"): "all"}, "must be a list of tables"),
        ({("actuator", "kind"): "magnet"}, "not known here: 'magnet'"),
        (
            {("outer_beam", "stiffness_N_per_m"): GONE, ("outer_beam", "material"): "unobtainium"},
            r"states no \[material.unobtainium\]",
        ),
        ({("sensor",): 3.0}, "sensor of the prototype must be a table"),
        ({("sensor", "gain_V_per_m"): "1180"}, "must be a number"),
        ({("sensor", "gain_V_per_m"): True}, "must be a number"),
        ({("sensor", "gain_V_per_m"): 1e301}, "must be a number"),
    ],
)
def test_a_prototype_that_is_none_is_refused(changes: Changes, words: str):
    made = honest("beamdesign.mass_range", "stable")
    assert re.search(words, told(base("mass"), with_changes(deepcopy(dict(made.given)), changes)))


def test_no_root_crosses_where_one_stays_on_the_axis():
    """A law with a pole and a zero at zero, each written out: everything but the crossing is as it is said."""
    table = base("mass")
    law = table["controller"]["law"]
    law["numerators"], law["denominator"] = [["0", *law["numerators"][0]]], ["0", *law["denominator"]]
    table["controller"]["kind"] = "homemade"
    table["loop"] = stated(Rig(Reading(table)))
    parts = [{"low": a, "high": b, "sample": b, "stable": False} for a, b in (("3", "4"), ("4", "34/5"))]
    parts[0]["sample"] = "3"
    crossing = {"outer_end_mass_kg": ["4", "4"], "squared_frequency": ["1", "1"]}
    table["stability"] = {"stable": False, "range": parts, "crossing": [crossing]}
    assert told(table) == "a root lies on the axis for every mass, so that none crosses"
    table["stability"] = {"stable": False, "range": [{"low": "3", "high": "34/5", "sample": "4", "stable": False}]}
    assert check(resealed(table)).valid


def test_a_claim_holds_at_the_gains_between_two_as_well():
    """Against equations (7) to (16) of Zalucky and Hardt (1984) at one frequency.

    The tip is stiffer at three tenths of the gain, and at all of it, than between.
    """
    rig = honest("beamdesign.box", "stable").prototype
    table = rig_tables(rig) | {"effect": [made_of() | {"gain": ["3/10", "1"]}]}
    f = {key: float(Fraction(value)) for key, value in table["rig"].items() if key != "kind"}
    law, s, area = rig.controller, 43.8j * np.pi, f["piston_area_m2"]
    masses = f["outer_mass_kg"] + 6.8, f["inner_mass_kg"] + f["inner_end_mass_kg"]
    outer, inner_tip = (
        mass * s**2 + f[f"{side}_damping_N_s_per_m"] * s + f[f"{side}_stiffness_N_per_m"]
        for side, mass in zip(("outer", "inner"), masses, strict=True)
    )
    fast = s / f["valve_frequency_rad_per_s"]
    current = -law.gain_A_per_V * (1 + s / (2 * np.pi * law.zero_Hz)) / (1 + s / (2 * np.pi * law.pole_Hz))
    flow = f["flow_gain_m3_per_s_per_A"] / (fast**2 + 2 * f["valve_damping_ratio"] * fast + 1)
    fed = flow * current * f["sensor_gain_V_per_m"] / area
    gives_way = s / f["oil_stiffness_N_per_m"] + f["leakage_m3_per_s_per_Pa"] / area**2

    def compliance(share: float) -> float:
        """Of tip, inner tip and the cylinder's force, under a force on the tip."""
        equations = np.array([[outer, 0, -1], [0, inner_tip, 1], [s - share * fed, -s, gives_way]])
        return abs(np.linalg.solve(equations, np.array([1, 0, 0]))[0])

    assert max(compliance(0.3), compliance(1.0)) < 3.45e-6 < 3.8e-6 < compliance(0.64) < 3.9e-6
    table = over_masses(table, "3", "34/5", {"stable": True})
    claim = {"kind": "compliance", "limit": "0.000004", "bandwidth_Hz": "21.9", "holds": True}
    assert check(resealed(table | {"claim": [claim]})).valid
    reason = told(table | {"claim": [claim | {"limit": "0.0000037"}]})
    assert reason == "not proved: compliance at most 3.7e-06 m/N up to 21.9 Hz"


def test_poles_that_coincide_bound_no_error():
    """Of a law with two poles that two zeros cancel; of one the bound holds."""
    for power, refused in ((1, False), (2, True)):
        table = base("mass")
        law, own = table["controller"]["law"], fmpq_poly([50, 1]) ** power
        law["numerators"] = [written(own * polynomial(law["numerators"][0]))]
        law["denominator"] = written(own * polynomial(law["denominator"]))
        table["controller"]["kind"] = "homemade"
        table["loop"] = stated(Rig(Reading(table)))
        table["nonlinear"] = [{**DEVIATION, "pieces": 8, "error": [{"place": "current", "size": "0", "bound_m": "1"}]}]
        assert ("poles that coincide" in told(table)) if refused else check(resealed(table)).valid


def polynomial(texts: list[str]) -> fmpq_poly:
    return fmpq_poly([fmpq(*Fraction(one).as_integer_ratio()) for one in texts])


# Integrals of impulse responses.


def test_responses_that_nearly_cancel_are_summed_in_finer_steps():
    """Of 1 / ((s + 1) (s + 1001/1000)), which is positive, so that its integral is the value at s = 0."""
    (found,) = nonlinear.integrals(
        [ONE], (fmpq_poly([1, 1]) * fmpq_poly([fmpq(1001, 1000), 1]), ZERO), (fmpq(0),) * 2, 1
    )
    assert fmpq(1000, 1001) <= found <= fmpq(1020, 1001)


@pytest.mark.parametrize(
    ("above", "below", "words"),
    [
        (S**2, S + 1, "differentiated"),
        (ONE, S + 10**14, "too fast"),
        (ONE, S**2 + S / 1000 + 1, "too slow"),
        (ONE, S - 1, "not stable"),
    ],
)
def test_no_integral_is_bounded_of_other_responses(
    monkeypatch: pytest.MonkeyPatch, above: fmpq_poly, below: fmpq_poly, words: str
):
    monkeypatch.setattr(nonlinear, "MOST_STEPS", 1000)
    with pytest.raises(Unreadable, match=words):
        nonlinear.integrals([above], (below, ZERO), (fmpq(0), fmpq(0)), 1)


# Roots.


def test_a_delay_that_never_matters_moves_no_root():
    """x' = -x(t) - x(t - T) is stable for every T: |j w + 1| exceeds one at every frequency but zero."""
    assert unstable_roots(S + 1, ONE, fmpq(1000)) == 0


def test_a_root_that_is_not_told_from_one_on_the_axis_is_not_stable():
    """x' = -x(t - T) is stable for T below pi/2, here to a hundred digits."""
    with ctx.workprec(400):
        critical = (arb.pi() / 2).mid().fmpq()
    text = f"{critical.p}/{critical.q}"
    table = base("expression") | {"range": {"a": [text, text]}, "member": {"a": text}}
    reason = told(table | {"leaf": {"b": "s"}, "p": "b + late", "delay": {"late": "a"}})
    assert "not proved: the member is stable" in reason
    assert unstable_roots(S, ONE, fmpq(3, 2)) == 0
    assert unstable_roots(S, ONE, fmpq(8, 5)) == 2
    assert unstable_roots(S, ONE, critical) is None


@pytest.mark.parametrize(("divisor", "clear"), [("a", True), ("a - 3/2", False)])
def test_nothing_is_divided_by_what_may_vanish(divisor: str, clear: bool):
    """Of s + 1 over a divisor, and one: it has no bound where that may be zero."""
    table = base("expression") | {"leaf": {"b": "1", "c": divisor, "d": "s + 1"}, "p": "b*c + d", "divisors": ["c"]}
    table["member"] = {"a": "2"}
    assert check(resealed(table)).valid if clear else "piece 1, 0 to 4 rad/s, is not seen" in told(table)


def test_corners_alone_do_not_decide_over_masses_and_gains():
    """Between s^3 + 10 s^2 + 10 s + 99 and s^3 + s^2 + s + 9/10, both stable, half of the way is not.

    On a rectangle between them, whose other corners are s^3 + 10 s^2 + 10 s + 9/10, all are: the product of the two
    middle coefficients, (10 - 9 m g)^2, exceeds the last one, 9/10 + 981/10 (1 - m) (1 - g).
    """
    start, end, side = (fmpq_poly([c, b, b, 1]) for b, c in ((10, 99), (1, fmpq(9, 10)), (10, fmpq(9, 10))))
    families = (start, side - start), (side - start, end + start - 2 * side)
    unit = fmpq(0), fmpq(1)
    assert stable_on_rectangle(*families, unit, unit)
    with pytest.raises(ArithmeticError, match="not decided"):
        stable_on_rectangle(*families, unit, unit, halvings=0)


# Boxes, and claims about them that are written by hand.


def with_p(table: Table, p: str, **more: Any) -> Table:
    """A box or a claim with another expression."""
    for key in ("leaf", "bound", "divisors", "group"):
        table.pop(key, None)
    return table | {"p": p} | more


def test_of_zero_nothing_is_stable():
    reason = told(with_p(base("box"), "0"))
    assert "NOT the characteristic polynomial" in reason
    assert "not proved: the member is stable" in reason


def test_sums_of_groups_have_a_limit():
    table = base("box")
    group = [{"name": "a", "kind": "sum", "members": [name for name in table["range"] if name != "delay"]}]
    assert "too many terms over the parameters of its groups" in told(with_p(table, "s + a**12", group=group))


def test_a_box_leaves_out_no_gain_that_effects_make():
    """Half of the gain, of which nothing was proved."""
    table = base("box")
    table["range"]["effect_gain"], table["member"]["effect_gain"] = ["1", "1"], "1"
    table["effect"] = [made_of() | {"gain": ["1/2", "1"]}]
    assert told(table) == "effect_gain: 1 leaves out some of 0.5 to 1 that effects make of it"


def test_spans_of_a_box_have_a_limit():
    table, names = base("box"), [f"a{k}" for k in range(7)]
    table["effect"] = [made_of() | {"span": {name: {"ends": ["0", "1"]} for name in names}}]
    for name in names:
        table["range"][f"x_{name}"], table["member"][f"x_{name}"] = ["0", "1"], "0"
    assert "more spans of effects vary" in told(table)


def test_polynomials_of_the_mechanics_have_a_limit(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(mechanics, "MOST_TERMS", 20)
    assert "more than 20 terms" in told(base("box"))


@pytest.fixture(scope="module")
def fixed() -> tuple[str, Loop]:
    """A box of exactly the figures of a rig and one payload, and its loop."""
    return fixed_box(honest("beamdesign.box", "stable").prototype)


def fixed_box(rig: Prototype) -> tuple[str, Loop]:
    text = certify_box(rig, tolerance_box(rig, 0.0, None, (1.0, 1.0)), volumes=False).certificate
    (loop,) = Rig(Reading(tomllib.loads(text))).loops()
    return text, loop


def at_payload(pair: tuple[fmpq_poly, fmpq_poly]) -> fmpq_poly:
    """Of one kilogram."""
    return pair[0] + pair[1]


def error(loop: Loop, decay: int, place: str = "current", lead: fmpq_poly = ONE) -> Table:
    """What is stated of an error, for the loop's own polynomial at s less the decay."""
    shifted = S - decay
    force = (S + 10) * lead * loop.strayed[place](shifted)
    claim = {
        "kind": "deviation",
        "size": "1",
        "limit": "1/1000000",
        "decay_per_s": str(decay),
        "corner_rad_per_s": "10",
    }
    leaves = {"d": in_s(at_payload(loop.closed)(shifted)), "n": in_s(force)}
    return claim | {"place": place, "p": "d + n*unknown", "leaf": leaves, "band": [{"limit": "1", "tree": ["inf"]}]}


LARGE = {"limit": "1000", "band": [{"limit": "1000", "tree": ["w=1 1,0 inf"]}]}


@pytest.mark.parametrize(
    ("decay", "change", "words"),
    [
        (1, {}, "its limits come to more"),
        (1, LARGE, "piece 2, 1 to infinity rad/s, is not seen to be clear"),
        (1000, LARGE, "the member decays more slowly than"),
        (1, {"range": {"outer_end_mass": ["0", "3"]}}, "that are not within the box"),
        (1, {"range": {"bogus": ["0", "1"]}}, "that the box does not have: bogus"),
        (1, {"delay": {"late": "outer_end_mass"}}, "of a loop with a delay"),
    ],
)
def test_an_error_is_of_a_loop_that_decays_as_fast(fixed: tuple[str, Loop], decay: int, change: Table, words: str):
    text, loop = fixed
    assert words in told(tomllib.loads(text) | {"claim": [error(loop, decay) | change]})


def test_a_compliance_is_no_smaller_than_that_at_rest(fixed: tuple[str, Loop]):
    text, loop = fixed
    leaves = {"d": in_s(at_payload(loop.closed)), "n": in_s(loop.disturbance)}
    claim = {"kind": "compliance", "limit": "1/100000000000000", "bandwidth_Hz": "1"}
    reason = told(tomllib.loads(text) | {"claim": [claim | {"p": "d + n*unknown", "leaf": leaves, "tree": ["inf"]}]})
    assert "not without motion at the member" in reason


@pytest.mark.parametrize(("oil", "words"), [("1", "its limits come to more"), ("9/10", "not that of a rig's loop")])
def test_a_force_on_the_stroke_is_no_flow_where_an_effect_softens_the_oil(
    fixed: tuple[str, Loop], oil: str, words: str
):
    """The flow that it is worth is of the oil's own stiffness."""
    table = tomllib.loads(fixed[0]) | {"effect": [made_of(oil=oil)]}
    (loop,) = Rig(Reading(table)).loops()
    claim = error(loop, 1, "flow", S + 2) | {"place": "stroke", "lead": ["2", "1"]}
    assert words in told(table | {"claim": [claim]})


def test_no_loop_comes_to_rest_that_is_not_stable_when_opened():
    """A characteristic of no slope at all opens it: a law with an unstable pole holds the rig only while it acts."""
    law = Observer(gain_A_per_V=0.004, sensors=("displacement_m",), a=((0.1,),), b=((1.1,),), c=(1.0,), d=(1.0,))
    for controller, words in ((None, "is not seen to be clear"), (law, "the member is not stable when opened")):
        rig = honest("beamdesign.box", "stable").prototype
        text, loop = fixed_box(rig if controller is None else rig.but(controller=controller))
        assert check(text).valid
        opened, back = map(at_payload, (loop.loop_denominator, loop.loop_numerator))
        leaves = {"d": in_s(2 * opened + back), "n": in_s(back)}
        claim = {"kind": "slope", "limit": "1", "popov_s": "0", "p": "d + n*unknown", "leaf": leaves}
        reason = told(tomllib.loads(text) | {"claim": [claim | {"tree": ["w=1 1,0 inf"]}]})
        assert words in reason


def test_a_gain_margin_is_of_a_stable_member():
    """Beside an expression of the box that says nothing of its rig."""
    unstable = honest("beamdesign.box", "unstable")
    text, loop = fixed_box(unstable.prototype)
    table = with_p(tomllib.loads(text), "1", tree=["w=1 1,0 inf"], stable=True)
    gain = table["controller"]["gain_A_per_V"]
    opened, back = map(at_payload, (loop.loop_denominator, loop.loop_numerator))
    leaves = {"d": in_s(opened), "n": in_s(back / fmpq(*Fraction(gain).as_integer_ratio())), "k": "controller_gain"}
    claim = {"kind": "gain_margin", "limit": "1/2", "range": {"controller_gain": [times(gain, "1/2"), gain]}}
    reason = told(table | {"claim": [claim | {"p": "d + n*k", "leaf": leaves, "tree": ["inf"]}]})
    assert "the member is not seen to be stable" in reason
