"""Certificates over a box of parameters: proved again on their own, bound to their rig, and refused once altered."""

import hashlib
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from functools import partial
from math import pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from flint import ctx, fmpq, fmpq_poly
from forging import mutations, resealed
from truth_of_box import true

from beamdesign import Prototype, check, read_prototype
from beamdesign.checker import Unreadable
from beamdesign.checker.box_loop import holds, sigmas
from beamdesign.checker.roots import unstable_roots
from beamdesign.polynomial import exact
from beamdesign.polynomial import roots as roots_of
from beamdesign.proofs.box import box_certificate, box_of, certify_box
from beamdesign.proofs.box_claims import claim_over_box
from beamdesign.proofs.branch import Search
from beamdesign.proofs.certificate import Asked
from beamdesign.proofs.rig_family import rig_family
from beamdesign.proofs.statement import PolynomialFamily
from beamdesign.proofs.tolerance_box import tolerance_box
from beamdesign.proofs.writer import prototype_table
from beamdesign.proofs.zero_exclusion import held, pieces
from beamdesign.prototype import Payload, Tolerance

CUBIC = PolynomialFamily("cubic", "s**3 + 2*s**2 + s + q", {"q": fmpq(1, 2)})


@pytest.fixture(scope="module")
def certificate() -> str:
    """Of a family with every kind of part: reciprocals, packs, groups and a delay."""
    values = {"m": 1.0, "n": 0.0, "b": 0.6, "k": 4.0, "g": 2.0, "f": 1.0, "area": 2.0, "T": 0.0}
    parts = PolynomialFamily(
        "parts",
        "(spring*per_area_2 + inertia)*lag + gain*per_area*late",
        {name: exact(value) for name, value in values.items()},
        {
            "spring": "k",
            "inertia": "mass*s**2 + b*s",
            "lag": "1 + s/20",
            "gain": "loop_gain",
            "per_area": "1/area",
            "per_area_2": "1/area**2",
        },
        (("per_area", "per_area_2"),),
        {"late": "T"},
        (("mass", "sum", ("m", "n")), ("loop_gain", "product", ("g", "f"))),
    )
    box = box_of(
        {"n": (0, 1), "b": (1.5, 1.7), "k": (3.5, 4.5), "f": (0.2, 0.3), "area": (1.9, 2.1), "T": (0, 0.1)},
        {"n": 0, "T": 0},
    )
    verdict = certify_box(parts, box)
    assert verdict.stable is True
    return verdict.certificate


TOLERANCE = Tolerance(stiffness=0.03, effective_mass=0.02, beam_damping_ratio=0.2, oil_stiffness=0.1, flow_gain=0.05)
EFFECTS = {
    "friction": {"seal_friction": {}, "unequal_piston_areas": {"asymmetry": 0.1}},
    "air": {"entrained_air": {}, "sensor_lag": {}, "mount_compliance": {}},
    "hysteresis": {"valve_hysteresis": {}, "second_beam_mode": {}},
}


@pytest.fixture(scope="module")
def rig() -> Prototype:
    shipped = read_prototype(Path(__file__).parents[1] / "studies" / "prototypes" / "tame_lag.toml")
    payload = Payload(inner_end_mass_kg=2.5, outer_end_mass_kg=(0.0, 6.8))
    return shipped.but(tolerance=TOLERANCE, payload=payload, effects={})


@pytest.fixture(scope="module")
def bound(rig: Prototype) -> str:
    """Of a rig."""
    verdict = certify_box(rig, tolerance_box(rig, 1.0, delay_s=(0.0, 2e-5)))
    assert verdict.stable is True
    return verdict.certificate


def rewritten(text: str, *path: str | int, to: Any = None, old: str = "", new: str = "") -> str:
    """The text with another entry, sealed as one who alters it on purpose would leave it; `to` None takes it away."""
    table = tomllib.loads(text)
    at = table
    for key in path[:-1]:
        at = at[key]
    if old:
        value = at[path[-1]]
        joined = "|".join(value) if isinstance(value, list) else value
        assert old in joined
        replaced = joined.replace(old, new, 1)
        at[path[-1]] = replaced.split("|") if isinstance(value, list) else replaced
    elif to is None:
        del at[path[-1]]
    else:
        at[path[-1]] = to
    del table["sha256"]
    bare = tomli_w.dumps(table)
    return f'sha256 = "{hashlib.sha256(bare.encode()).hexdigest()}"\n{bare}'


def refused(text: str) -> bool:
    """Whether a text is not accepted: not valid, or not even a certificate."""
    try:
        return not check(text).valid
    except Unreadable:
        return True


def test_the_checker_stands_alone(bound: str, tmp_path: Path) -> None:
    """Nothing of the programme but the checker itself, and no numpy, is imported."""
    path = tmp_path / "box.toml"
    path.write_text(bound, encoding="utf-8")
    code = (
        "import runpy, sys; sys.modules['numpy'] = None; sys.argv = ['checker', 'box.toml']\n"
        "try: runpy.run_module('beamdesign.checker', run_name='__main__')\n"
        "except SystemExit as end:\n"
        "    own = [n for n in sys.modules if n.startswith('beamdesign.') and not n.startswith('beamdesign.checker')]\n"
        "    print(own); sys.exit(end.code)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("valid\n[]\n")


def test_altered_text_is_refused(certificate: str) -> None:
    assert check(rewritten(certificate, "name", to="another")).valid
    assert not check(certificate.replace('"parts"', '"party"')).valid


@pytest.mark.parametrize(
    ("path", "to"),
    [
        (("range", "k"), ["3.5", "400"]),
        (("range", "T"), ["0", "20"]),
        (("member", "b"), "9"),
        (("range", "b"), ["-0.1", "1.7"]),
        (("leaf", "inertia"), "mass*s**2 - b*s"),
        (("leaf", "lag"), "1 + s"),
        (("leaf", "gain"), "20*loop_gain"),
        (("group", 0, "kind"), "product"),
        (("stable",), False),
    ],
)
def test_altered_statements_are_not_valid(certificate: str, path: tuple[str | int, ...], to: Any) -> None:
    text = rewritten(certificate, *path, to=to)
    text = rewritten(text, "tree") if path == ("stable",) else text
    assert not check(text).valid


@pytest.mark.parametrize(
    ("path", "old", "new"),
    [
        (("tree",), "inf", "?"),
        (("tree",), "inf", ""),
        (("tree",), "inf", "inf inf"),
        (("tree",), "inf", "1000,0"),
        (("tree",), "w=", "k w="),
        (("tree",), "w=", "w=-1 w="),
        (("tree",), "w=", "w= "),
        (("leaf", "inertia"), "mass", "__import__(0) + mass"),
        (("leaf", "inertia"), "mass", "u + mass"),
        (("leaf", "inertia"), "mass", "True*mass"),
        (("leaf", "inertia"), "mass", "mass/s"),
        (("leaf", "spring"), "k", "k**99"),
        (("leaf", "spring"), "k", "k*" + "(1 + k)*" * 59 + "(2 + b)**50"),
        (("leaf", "spring"), "k", "k" + " + 9**60**60" + "**60" * 9),
        (("leaf", "spring"), "k", "k + " * 26000 + "k"),
        (("leaf", "spring"), "k", "(" * 300 + "k" + ")" * 300),
        (("p",), "gain*", "spring*spring*spring*gain*"),
        (("p",), "per_area*late", "per_area*per_area*late"),
        (("p",), "*late", "*late*late"),
        (("p",), "gain*per_area", "s*s*s*gain*per_area"),
        (("range", "area"), "1.9", "0"),
        (("range", "area"), "1.9", "1_9"),
        (("group", 0, "members"), "m|n", "m|g"),
        (("group", 0, "name"), "mass", "loop_gain"),
        (("delay", "late"), "T", "area"),
    ],
)
def test_altered_trees_and_expressions_are_refused(
    certificate: str, path: tuple[str | int, ...], old: str, new: str
) -> None:
    assert refused(rewritten(certificate, *path, old=old, new=new))


@pytest.mark.parametrize("path", [("leaf",), ("group",), ("delay",), ("range",), ("member",), ("tree",)])
def test_every_table_is_needed(certificate: str, path: tuple[str, ...]) -> None:
    assert refused(rewritten(certificate, *path))
    assert refused(rewritten(certificate, "more", to=["x"]))


def test_packs_are_enumerated_together(certificate: str) -> None:
    packed = rewritten(certificate, "bound", to=[["per_area", "per_area_2", "spring"]])
    assert refused(packed)  # spring and per_area_2 multiply each other, so that p is not affine in them together


def test_every_line_of_the_tree_counts(certificate: str) -> None:
    """A line turned about no longer separates, wherever it stands."""
    lines = re.findall(r"(?<=[ \"])-?\d+,-?\d+(?=[ \"])", certificate)
    assert len(lines) > 3
    for line in dict.fromkeys(lines):
        x, y = map(int, line.split(","))
        assert refused(rewritten(certificate, "tree", old=line, new=f"{-x},{-y}"))


def test_what_p_is_divided_by_is_stated_and_checked() -> None:
    """Lines across the quotient are none across p, nor across another one; what is no factor divides nothing."""
    leaves = {"lag": "1 + s/v", "beam": "s**2 + c*s + K", "push": "k"}
    lagging = PolynomialFamily("lag", "lag*beam + push", dict.fromkeys("vcKk", fmpq(1)), leaves, divisors=("lag",))
    ranges = {"v": (0.7, 1.4), "c": (0.02, 0.06), "K": (0.9, 1.1), "k": (0, 0.035)}
    text = certify_box(lagging, box_of(ranges)).certificate
    assert check(text).valid
    for divisors in (None, ["beam"], ["lag", "lag"], ["push"], ["s"], ["nothing"], [], "lag"):
        assert refused(rewritten(text, "divisors", to=divisors))
    assert refused(rewritten(text, "p", to="lag*beam + lag*push"))
    # A lag that may vanish on the axis divides nothing, whatever the lines say.
    assert refused(rewritten(text, "leaf", "lag", to="1 + s**2/v"))


def test_refutation_is_proved_again_too() -> None:
    verdict = certify_box(CUBIC, box_of({"q": (1, 3)}, {"q": 1}))
    assert verdict.stable is False
    assert check(verdict.certificate).valid
    assert not check(rewritten(verdict.certificate, "member", "q", to="1")).valid
    assert not check(rewritten(verdict.certificate, "member", "q", to="4")).valid


def test_claims_of_a_box_that_is_not_stable_are_not_proved(rig: Prototype) -> None:
    """They hold of no member that is not stable, so that a file which states them is not valid."""
    box = tolerance_box(rig, 1.0)
    claim = claim_over_box(rig, box, Asked("peak_sensitivity", 4.0))
    claimed = tomllib.loads(certify_box(rig, box).write([claim]))
    fast = rig.but(controller=rig.own_controller.but(gain_A_per_V=1.0))
    verdict = certify_box(fast, tolerance_box(fast, 1.0))
    assert verdict.stable is False
    assert check(verdict.certificate).valid
    forged = tomllib.loads(verdict.certificate) | {"claim": claimed["claim"]}
    found = check(resealed(forged))
    assert not found.valid
    assert any("of a box that is not stable" in line for line in found.failed)


def test_a_degree_that_only_seems_lost_refutes_nothing() -> None:
    """s**4 - s**4 has no root at infinity to lose."""
    verdict = certify_box(CUBIC, box_of({"q": (1, 3)}, {"q": 1}))
    text = rewritten(verdict.certificate, "p", old="s**3", new="s**4 - s**4 + s**3")
    assert check(text).valid
    assert not check(rewritten(text, "member", "q", to="1")).valid


def test_search_marks_what_is_open() -> None:
    statement = CUBIC.over({"q": (fmpq(1), fmpq(3))})
    search = Search(statement)
    search.run(60)
    assert "?" in search.tree
    undecided = [piece for piece in pieces(statement, search.tree) if piece.direction == "?"]
    assert undecided
    assert not any(held(undecided))
    crossing = fmpq(1, 2)  # q = 2 is in the middle of the range, its root pair at w = 1
    assert any(
        piece.cell.shares["q"][0] <= crossing <= piece.cell.shares["q"][1] and piece.w1 <= 1 <= piece.w2
        for piece in undecided
        if piece.w2 is not None
    )


# Members with a delay.


def test_number_of_unstable_roots_with_a_delay() -> None:
    """s (s + 1) + sqrt(2) exp(-sT) meets the axis at w = 1 alone: two roots more at T = pi / 4 and every 2 pi after."""
    with ctx.workprec(128):
        for delay in (0.0, 0.1, 0.7, 0.8, 5.0, 7.0, 7.1, 13.3, 13.4):
            crossed = sum(pi / 4 + 2 * pi * i < delay for i in range(5))
            found = unstable_roots(fmpq_poly([0, 1, 1]), fmpq_poly([exact(sqrt(2))]), exact(delay))
            assert found == 2 * crossed


def test_number_of_unstable_roots_follows_those_of_pade() -> None:
    """exp(-sT) as (1 - sT / 2N)^N over (1 + sT / 2N)^N, far from the axis."""
    rng, told = np.random.default_rng(4), 0
    with ctx.workprec(128):
        for _ in range(40):
            plain = fmpq_poly([*map(int, rng.integers(-9, 10, 3)), 1])
            late, delay = fmpq_poly(list(map(int, rng.integers(-9, 10, 2)))), exact(round(float(rng.uniform(0, 2)), 2))
            half = fmpq_poly([0, delay / 60])
            found = roots_of(plain * (1 + half) ** 30 + late * (1 - half) ** 30)
            near = [root for root in found if abs(root) < 30]
            if all(abs(root.real) > 0.05 for root in [*near, *roots_of(plain + late)]):
                told += 1
                assert unstable_roots(plain, late, delay) == sum(root.real > 0 for root in near)
    assert told > 20


def test_roots_on_the_axis_are_not_counted() -> None:
    with ctx.workprec(128):
        assert unstable_roots(fmpq_poly([1, 0, 1]), fmpq_poly([]), fmpq(0)) is None
        # s + exp(-sT) has its first pair at +-j where T = pi / 2, which no rational is.
        assert unstable_roots(fmpq_poly([0, 1]), fmpq_poly([1]), exact(pi / 2)) in (0, 2)


# The rig.


def test_it_is_of_its_prototype(rig: Prototype, bound: str) -> None:
    assert check(bound, prototype_table(rig)).valid
    others = (
        rig.but(tolerance=TOLERANCE.but(stiffness=0.04)),
        rig.but(outer_beam=rig.outer_beam.but(stiffness_N_per_m=486_801.0)),
        rig.but(controller=rig.controller.but(zero_Hz=20.1)),
        rig.but(effects={"sensor_lag": {}}),
    )
    for other in others:
        assert not check(bound, prototype_table(other)).valid


def test_an_expression_is_of_no_prototype(rig: Prototype, certificate: str) -> None:
    verdict = check(certificate, prototype_table(rig))
    assert not verdict.valid
    assert len(verdict.failed) == 1


@pytest.mark.parametrize("effects", EFFECTS.values(), ids=EFFECTS)
def test_effects_in_the_box(rig: Prototype, effects: dict[str, dict[str, float]]) -> None:
    """Refuted or proved, the expression is that of the rig's loop with its effects, and of no other."""
    loaded = rig.but(effects=effects, controller=rig.controller.but(gain_A_per_V=0.4))
    verdict = certify_box(loaded, tolerance_box(loaded, 0.2, ["flow_gain", "outer_stiffness"]), volumes=False)
    assert verdict.stable is False
    assert check(verdict.certificate, partial(prototype_table, loaded)).valid
    assert true(tomllib.loads(verdict.certificate)) is True
    for place, key in ((("rig", "outer_mass_kg"), "4"), (("rig", "oil_stiffness_N_per_m"), "13000001")):
        assert refused(rewritten(verdict.certificate, *place, to=key))
    for one, effect in enumerate(tomllib.loads(verdict.certificate)["effect"]):
        for key, value in effect["elements"].items():
            if isinstance(value, str):
                assert refused(rewritten(verdict.certificate, "effect", one, "elements", key, to=f"{value} + 0.01"))


def test_a_box_that_leaves_out_some_of_what_effects_make_of_a_figure_is_not_valid(rig: Prototype) -> None:
    """Half of a span, whichever holds the member that the text is about: the other half is of the rig as well."""
    loaded = rig.but(effects=EFFECTS["friction"], controller=rig.controller.but(gain_A_per_V=0.4))
    verdict = certify_box(loaded, tolerance_box(loaded, 0.2, ["flow_gain"]), volumes=False)
    table, looked_at = tomllib.loads(verdict.certificate), 0
    for key, ends in table["range"].items():
        low, high = map(Fraction, ends)
        if low < high and key not in ("flow_gain", "outer_end_mass"):
            middle, at, looked_at = (low + high) / 2, Fraction(table["member"][key]), looked_at + 1
            half = [str(end) for end in ((low, middle) if at <= middle else (middle, high))]
            failed = check(rewritten(verdict.certificate, "range", key, to=half)).failed
            assert any("leaves out some of" in words for words in failed), key
    assert looked_at > 0


def test_lag_and_gain_may_vary(rig: Prototype) -> None:
    box = tolerance_box(rig, 1.0, ["controller_zero"], spread={"controller_zero": 0.05, "controller_gain": 0.02})
    verdict = certify_box(rig, box)
    assert verdict.stable is True
    assert check(verdict.certificate, prototype_table(rig)).valid
    assert refused(rewritten(verdict.certificate, "controller", "gain_A_per_V", to="0.051"))


@pytest.mark.parametrize(
    ("path", "to"),
    [
        (("range", "outer_stiffness"), ["486801", "500000"]),
        (("range", "inner_end_mass"), ["2", "2"]),
        (("range", "controller_gain"), ["0.04", "0.04"]),
        (("range", "delay"), ["0", "0.01"]),
        (("range", "delay"), ["-0.001", "0"]),
        (("range", "outer_end_mass"), ["-1", "6.8"]),
        (("range", "outer_end_mass"), ["0", "680"]),
        (("range", "colour"), ["0", "1"]),
        (("rig", "flow_gain_m3_per_s_per_A"), "0.0124"),
        (("rig", "leakage_m3_per_s_per_Pa"), "0"),
        (("rig", "outer_damping_N_s_per_m"), "100"),
        (("rig", "inner_end_mass_kg"), "2"),
        (("rig", "valve_frequency_Hz"), "151"),
        (("controller", "law", "numerators"), [["0.05", "0.0004"]]),
        (("kind",), "beamdesign.expression_box"),
    ],
)
def test_a_box_of_another_rig_is_refused(bound: str, path: tuple[str, ...], to: Any) -> None:
    assert refused(rewritten(bound, *path, to=to))


def test_figures_of_a_rig_that_are_negative_are_refused(rig: Prototype) -> None:
    """Of a rig that leaks backwards all are stable; but what a force is worth as a flow is bounded for others alone."""
    ranges = {"leakage": (fmpq(-1, 10**14), fmpq(4, 10**13)), "outer_end_mass": (fmpq(0), fmpq(2))}
    family = replace(rig_family(rig, varying=ranges), positive=())
    search = Search(statement := family.over(ranges))
    search.run(4000)
    with ctx.workprec(96):
        assert all(held(list(pieces(statement, search.tree))))
    with pytest.raises(Unreadable, match=r"figures of a rig.*must not be negative"):
        check(box_certificate(rig, family, statement, family.values, search.tree))


def test_another_expression_is_not_of_this_rig(bound: str) -> None:
    """All of them are of a stable loop, but not of this one."""
    leaves = tomllib.loads(bound)["leaf"]
    for name, leaf in leaves.items():
        assert refused(rewritten(bound, "leaf", name, to=f"{leaf} + 1/1000000000*{leaf.split(' + ')[0]}*s"))


def test_sigmas_of_a_range() -> None:
    """A dashpot goes with zeta sqrt(K M): all three deviations at once."""
    for n in (0.5, 1.0, 2.5):
        ends = [100 * (1 + e * 0.2) * sqrt((1 + e * 0.03) * (1 + e * 0.02)) for e in (-n, n)]
        pair = (exact(ends[0]), exact(ends[1]))
        found = sigmas(pair, fmpq(100), exact(0.2), exact(0.03), exact(0.02))
        assert float(found) == pytest.approx(n, rel=1e-3)
        assert float(found) <= n
    assert sigmas((fmpq(97), fmpq(102)), fmpq(100), exact(0.01)) == "2"
    assert not holds((fmpq(20), fmpq(220)), fmpq(100), fmpq(2), exact(0.6))  # which are from less than nothing up
    assert sigmas((fmpq(97), fmpq(102) - fmpq(1, 10**6)), fmpq(100), exact(0.01)) == "1.999"


def test_verdict_states_ranges_with_their_figures(bound: str) -> None:
    said = "\n".join(check(bound).proved)
    assert re.search(r"outer_stiffness 472196 to 501404, -3 % to \+3 % of .* 486800, 1 standard", said)
    assert re.search(r"outer_end_mass 0 to 6\.8$", said, re.MULTILINE)
    assert re.search(r"delay 0 to 2e-05$", said, re.MULTILINE)


# The model that says which forgeries are false.


def test_truth_of_box(bound: str, certificate: str) -> None:
    refuted = certify_box(CUBIC, box_of({"q": (1, 3)}, {"q": 1})).certificate
    for honest in (bound, certificate, refuted):
        assert true(tomllib.loads(honest)) is True
    for text in (
        rewritten(bound, "range", "delay", to=["0", "0.01"]),
        rewritten(bound, "range", "outer_end_mass", to=["0", "680"]),
        rewritten(bound, "rig", "leakage_m3_per_s_per_Pa", to="0.0000000000004"),
        rewritten(bound, "rig", "inner_damping_N_s_per_m", to="30"),
        rewritten(bound, "rig", "valve_frequency_Hz", to="151"),
        rewritten(bound, "rig", "inner_end_mass_kg", to="2"),
        rewritten(bound, "controller", "law", "denominator", to=["1", "0.08"]),
        rewritten(bound, "stable", to=False),
        rewritten(certificate, "leaf", "lag", to="1 - s/20"),
        rewritten(certificate, "member", "b", to="9"),
        rewritten(certificate, "leaf", "gain", to="60*loop_gain"),
        rewritten(refuted, "member", "q", to="1"),
        rewritten(refuted, "stable", to=True),
    ):
        assert true(tomllib.loads(text)) is False
        assert refused(text)


def test_nothing_false_is_valid_of_an_expression(certificate: str, tried: Callable[[int], int]) -> None:
    """Whatever is altered of a certificate that is about no rig; see tests/test_forging.py for those that are."""
    kept, count = 0, tried(500)
    for words, forged in mutations(tomllib.loads(certificate), seed=1984, count=count):
        try:
            valid = check(resealed(forged)).valid
        except Unreadable:
            continue
        kept += valid
        assert not valid or true(forged) is not False, words
    assert 0 < kept < count / 2
