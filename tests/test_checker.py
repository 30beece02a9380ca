"""The checker by itself: it needs nothing of the rest, accepts every certificate, and reads strictly."""

import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from hashlib import sha256
from io import BytesIO, TextIOWrapper
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flint import fmpq, fmpq_poly
from forging import resealed
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic_core import PydanticUndefined

import beamdesign
from beamdesign import Prototype, certify, certify_box, check, checker, read_prototype, write_prototype
from beamdesign.checker import KEYS, Unreadable
from beamdesign.checker.__main__ import main
from beamdesign.checker.law import SCHEDULED
from beamdesign.checker.prototype import DEFAULTS, GUARANTEED, KNOWN
from beamdesign.checker.reading import rational, short, span
from beamdesign.checker.roots import _hurwitz_matrix, bound, halve, is_hurwitz, isolate
from beamdesign.controllers.scheduled import Estimator, Scheduled
from beamdesign.plant.actuators.ball_screw import BallScrew
from beamdesign.polynomial import roots
from beamdesign.proofs.certificate import Asked
from beamdesign.proofs.writer import prototype_table
from beamdesign.prototype import (
    COMPLIANCE_LIMIT_M_PER_N,
    Arm,
    Beam,
    Compliance,
    Goal,
    Guarantee,
    Payload,
    Servovalve,
    Tolerance,
)
from beamdesign.synthesis.design_run import stating

TAME = Path(__file__).parents[1] / "studies" / "prototypes" / "tame_lag.toml"
ASKED = (
    Asked("decay_rate", 3.0),
    Asked("gain_margin", 1.05),
    Asked("gain_margin", 1.5),
    Asked("gain_margin", 0.5),
    Asked("peak_sensitivity", 2.0),
    Asked("compliance", COMPLIANCE_LIMIT_M_PER_N, 6.0),
    Asked("compliance", COMPLIANCE_LIMIT_M_PER_N, 7.0),
    Asked("decay_rate", 50.0),
)


@pytest.fixture
def unstable(remedy: Prototype) -> str:
    """Both crossings inside the range."""
    return certify(remedy, 0.0, 20.0, ASKED[:2]).text


@pytest.fixture
def stable(remedy: Prototype) -> str:
    """A stable range, with claims that hold and others that are refuted."""
    return certify(remedy, 3.0, 6.8, ASKED).text


def test_certificates_are_valid(remedy: Prototype, stable: str, unstable: str) -> None:
    for text in (stable, unstable, certify(remedy, 5.0, 5.0).text, certify(remedy, 0.0, 1.0, ASKED).text):
        outcome = check(text)
        assert outcome.failed == ()
        assert outcome.valid


@pytest.mark.parametrize("kind", ["lag", "proportional"])
@pytest.mark.parametrize("filter_Hz", [None, 400.0])
def test_every_kind_of_loop_is_built_anew(remedy: Prototype, kind: str, filter_Hz: float | None) -> None:
    controller = remedy.controller.but(gain_A_per_V=0.05) if kind == "lag" else {"kind": kind, "gain_A_per_V": 0.004}
    prototype = remedy.but(controller=controller, sensor=remedy.sensor.but(filter_Hz=filter_Hz))
    found = certify(prototype, 0.0, 6.8)
    assert found.stable
    assert check(found.text).valid


def test_every_statement_is_repeated_with_its_number(stable: str, unstable: str) -> None:
    said = check(unstable).proved
    assert "unstable from 0 to 1.968442 kg" in said
    assert "stable from 1.968443 to 17.79211 kg" in said
    assert "stable: no" in said
    said = check(stable).proved
    assert "stays stable up to 17.79211 kg" in said
    assert "refuted: peak sensitivity at most 2" in said
    assert "every pole decays faster than 3 1/s" in said
    assert "compliance at most 5.71e-08 m/N up to 6 Hz" in said


def test_the_rig_is_named_with_its_figures(remedy: Prototype) -> None:
    rig = remedy.but(effects={"valve_deadband": {"half_width_A": 0.0003}, "transport_delay": {"delay_s": 0.0002}})
    told = "\n".join(check(certify(rig, 3.0, 5.0).text).about)
    for figure in ("outer_stiffness_N_per_m 486800", "half_width_A 0.0003", "delay_s 0.0002", "gain times 0 to 1"):
        assert figure in told


def test_any_change_of_the_text_breaks_the_seal(stable: str) -> None:
    for altered in (
        stable.replace("# Proved", "# proved", 1),
        stable + "\n",
        stable.replace('name = "paper"', 'name = "x"'),
    ):
        assert check(altered).failed == ("the text was altered after it was written (sha256)",)


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda text: "no certificate at all\n", "not a certificate"),
        (lambda text: text.replace('\nname = "', '\nname = "' + "x" * 20_000), "must be a text of at most 20000"),
        (lambda text: text.replace("version = 2", "version = 1"), "make the certificate again"),
        (lambda text: text.replace("version = 2", "version = 3"), "format 3"),
        (lambda text: text.replace('kind = "beamdesign.mass_range"', 'kind = "other"'), "kind 'other'"),
        (lambda text: text.replace('kind = "twin_beam"', 'kind = "bench"'), "rig.kind"),
        (lambda text: text.replace('kind = "decay_rate"', 'kind = "beauty"'), "claim.*kind"),
        (lambda text: text.replace("inner_mass_kg", "inner_mass"), "inner_mass_kg is missing"),
        (lambda text: text.replace('"486800"', '"about 486800"'), "decimal"),
        (lambda text: text.replace('"486800"', '"486800.0 "'), "decimal"),
        (lambda text: text.replace('"486800"', '"486_800"'), "decimal"),
        (lambda text: text.replace('"486800"', '"\u0664\u0668\u0666"'), "decimal"),
        (lambda text: text.replace('"486800"', "486800"), "decimal"),
        (lambda text: text.replace('"486800"', '"' + "9" * 4000 + '"'), "decimal"),
        (lambda text: text.replace('"3.9"', '"-3.9"'), "above 0"),
        (lambda text: text.replace("[rig]", "[rig]\nbandwidth_Hz = 30.0"), "not known.*rig.bandwidth_Hz"),
        (lambda text: text.replace("[rig]", "[[claims]]\nholds = true\n[rig]"), "not known.*claims"),
        (lambda text: text.replace("holds = true", 'holds = "yes"', 1), "true or false"),
        (lambda text: text + "x = " + "[" * 100 + "]" * 100, "nested"),
        (lambda text: text + "x = " + "[" * 100_000, "not a certificate|nested"),
    ],
)
def test_what_cannot_be_read_is_refused(stable: str, damage: Callable[[str], str], reason: str) -> None:
    with pytest.raises(Unreadable, match=reason):
        check(damage(stable))


@pytest.mark.parametrize("name", ["x" * 5000, "nowhere.toml"])
def test_a_file_that_cannot_be_read_is_said_to_be_none(name: str) -> None:
    with pytest.raises(Unreadable, match="cannot be read"):
        check(name)


def test_what_is_no_prototype_is_said_to_be_none(stable: str, tmp_path: Path) -> None:
    """A scenario, say, or a file that is not there."""
    path = tmp_path / "scenario.toml"
    for content, words in (
        (None, "^the prototype: cannot be read"),
        (b"x = ", "^the prototype: Invalid value"),
        (b'\xef\xbb\xbfname = "steps"\n', "states neither figures nor a material of its outer_beam"),
    ):
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(Unreadable, match=words):
            check(stable, path)


def test_letters_that_a_terminal_does_not_have_are_printed_as_codes(
    stable: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It ended in a traceback, with the exit status of what is not proved."""
    path, shown = tmp_path / "certificate.toml", BytesIO()
    path.write_text(resealed(tomllib.loads(stable) | {"name": "Prüfstand 臂"}), "utf-8")
    with TextIOWrapper(shown, "ascii") as out:
        monkeypatch.setattr(sys, "stdout", out)
        assert main([str(path)]) == 0
        out.flush()
        assert b"Pr\\xfcfstand \\u81c2" in shown.getvalue()


def test_a_controller_of_an_unknown_kind_is_said_to_be_one_whatever_is_given(stable: str, remedy: Prototype) -> None:
    """Its polynomials are then only stated; that a prototype is given with what its effects come to changes nothing."""
    table = tomllib.loads(stable)
    table["controller"]["kind"] = "homemade"
    for beside in (None, prototype_table(remedy, 6.8)):
        found = check(resealed(table), beside)
        assert any("'homemade' is not known here" in line for line in found.open)


def test_a_certificate_is_of_its_own_prototype_and_of_no_other(remedy: Prototype, tmp_path: Path) -> None:
    rig = remedy.but(effects={"sensor_lag": {"break_Hz": 900.0}})
    path = tmp_path / "p.toml"
    write_prototype(rig, path)
    text = certify(rig, 3.0, 5.0).text
    assert check(text, path).valid
    assert check(text, prototype_table(rig, 5.0)).valid
    path.write_text("\ufeff" + path.read_text(encoding="utf-8"), encoding="utf-8")  # as some editors save it
    assert check(text, path).valid
    others = [
        rig.but(payload=remedy.payload.but(outer_end_mass_kg=(0.0, 9.0))),
        rig.but(payload=remedy.payload.but(inner_end_mass_kg=1.0)),
        rig.but(goal=remedy.goal.but(peak_sensitivity=3.0)),
        rig.but(arm={"offset_m": (0.0, 0.9, 0.0)}),
        rig.but(effects={}),
        rig.but(effects={"sensor_lag": {"break_Hz": 901.0}}),
        rig.but(controller=remedy.controller.but(pole_Hz=2.0)),
        rig.but(outer_beam=remedy.outer_beam.but(damping_ratio=0.04)),
        rig.but(servovalve=remedy.servovalve.but(natural_frequency_Hz=151.0)),
        rig.but(sensor=remedy.sensor.but(filter_Hz=300.0)),
    ]
    for other in others:
        write_prototype(other, path)
        for found in (check(text, path), check(text, prototype_table(other, 5.0))):
            assert not found.valid
            assert all(words.startswith("not of this prototype") for words in found.failed)


def test_figures_from_a_section_are_worked_out_anew(remedy: Prototype, tmp_path: Path) -> None:
    """Rounded corners too; Zalucky and Hardt (1984), equations (3) and (5)."""
    geometry = {"width_m": 0.14, "wall_m": 0.0023, "corner_radius_m": 0.006, "length_m": 1.5, "free_length_m": 1.195}
    beam = geometry | {"material": "6061-T6", "end_mass_kg": 2.93}
    rig = remedy.but(outer_beam=beam)
    path = tmp_path / "p.toml"
    write_prototype(rig, path)
    text = certify(rig, 3.0, 3.1).text
    assert tomllib.loads(text)["material"] == {
        "6061-T6": {"youngs_modulus_Pa": "69000000000", "shear_modulus_Pa": "27000000000", "density_kg_per_m3": "2700"}
    }
    assert check(text, path).valid
    write_prototype(rig.but(outer_beam=beam | {"wall_m": 0.0023001}), path)
    assert len(check(text, path).failed) == 3  # stiffness, mass and damping of the outer beam


def test_a_guarantee_rests_on_its_own_file(remedy: Prototype, tmp_path: Path) -> None:
    path, text = tmp_path / "c.toml", certify(remedy, 3.0, 5.0).text
    path.write_text(text)
    table = prototype_table(remedy) | {"guarantee": {"certificate": "c.toml", "certificate_sha256": "0" * 64}}
    assert len(check(path, table).failed) == 1
    assert len(check(str(path), table).failed) == 1
    assert check(path, table | {"guarantee": {"certificate": "other.toml", "certificate_sha256": "0" * 64}}).valid


def test_a_guarantee_states_no_more_than_its_file_proves(remedy: Prototype) -> None:
    found = certify(remedy, 3.0, 5.0)
    sure = found.guaranteed
    assert sure is not None

    def failed(**stated: Any) -> tuple[str, ...]:
        own = stating(remedy, found.text, (3.0, 5.0), sure.bandwidth_Hz, sure.peak_sensitivity).guarantee
        return check(found.text, prototype_table(remedy) | {"guarantee": own.model_dump(mode="json") | stated}).failed

    assert failed() == ()
    assert failed(outer_end_mass_kg=[3.5, 4.5], bandwidth_Hz=0.9 * sure.bandwidth_Hz, peak_sensitivity=99.0) == ()
    for stated, words in (
        ({"bandwidth_Hz": 1.001 * sure.bandwidth_Hz}, "a bandwidth beyond"),
        ({"peak_sensitivity": 0.999 * sure.peak_sensitivity}, "a peak sensitivity below"),
        ({"peak_sensitivity": 0.0}, "a peak sensitivity below"),
        ({"outer_end_mass_kg": [2.999, 5.0]}, "payloads beyond"),
        ({"sigmas": 0.1}, "standard deviations, of which the certificate is not"),
    ):
        assert [words in line for line in failed(**stated)] == [True], stated


def test_what_no_prototype_has_is_no_part_of_the_rig_that_was_proved(remedy: Prototype, tmp_path: Path) -> None:
    """Misspelt effects and promises of another kind were passed over, and the prototype called that of the file."""
    found = certify(remedy, 3.0, 5.0)
    sure = found.guaranteed
    assert sure is not None
    path = tmp_path / "prototype.toml"
    write_prototype(stating(remedy, found.text, (3.0, 5.0), sure.bandwidth_Hz, sure.peak_sensitivity), path)
    whole = path.read_text()
    assert check(found.text, path).valid
    for before, after, words in (
        ("[guarantee]", "[guarantee]\ngain_margin = 9.0", "[guarantee] states 'gain_margin'"),
        ("[guarantee]", "[efects.joint_backlash]\n[guarantee]", "not of this prototype: 'efects' is not known"),
        ('kind = "twin_beam"', 'kind = "actuator_bench"', "a rig of another kind, 'actuator_bench'"),
    ):
        path.write_text(whole.replace(before, after))
        (failed,) = check(found.text, path).failed
        assert words in failed


@pytest.mark.parametrize("stated", [{}, {"peak_sensitivity": 0.0, "bandwidth_Hz": 0.0}])
def test_no_guarantee_rests_on_a_certificate_that_says_that_the_loop_is_not_stable(
    remedy: Prototype, unstable: str, stated: dict[str, float]
) -> None:
    guarantee = {"outer_end_mass_kg": [0.0, 20.0], "certificate_sha256": sha256(unstable.encode()).hexdigest()}
    assert check(unstable, prototype_table(remedy)).valid
    assert not check(unstable, prototype_table(remedy) | {"guarantee": guarantee | stated}).valid


@pytest.mark.usefixtures("few_climbs")
def test_a_guarantee_of_a_box_states_no_more_standard_deviations_than_it_has() -> None:
    few = Tolerance(stiffness=0.03, beam_damping_ratio=0.2, flow_gain=0.05)
    own = read_prototype(TAME).but(guarantee=None, tolerance=few)
    found = certify_box(own, (2.0, 2.2), sigmas=1.0)
    sure = found.guaranteed

    def failed(sigmas: float, masses: tuple[float, float] = (2.0, 2.2)) -> tuple[str, ...]:
        stated = stating(own, found.text, masses, sure["bandwidth_Hz"], sure["peak_sensitivity"], sigmas=sigmas)
        return check(found.text, prototype_table(own) | {"guarantee": stated.guarantee.model_dump(mode="json")}).failed

    assert failed(1.0) == ()
    *narrower, beyond = failed(1.001, (2.0, 2.3))
    assert len(narrower) == len({*found.box.names} - {"outer_end_mass"}) == 5
    assert beyond == "the prototype's [guarantee] states payloads beyond those of the certificate"


def test_words_of_what_is_proved_are_rounded_to_the_safe_side() -> None:
    limit, third = fmpq(20000001, 10000000), fmpq(1, 3)
    assert (short(limit, up=True), short(limit, up=False), short(limit)) == ("2.000001", "2", "2")
    assert (short(third, up=True), short(-third, up=True), short(fmpq(34, 5), up=True)) == (
        "0.3333334",
        "-0.3333333",
        "6.8",
    )
    assert span((third, 2 * third)) == "0.3333334 to 0.6666666"
    narrow = [float(end) for end in span((limit, limit + fmpq(1, 10**9))).split(" to ")]
    assert narrow == pytest.approx([2.0000001, 2.000000101], rel=1e-15)


def test_limits_of_what_is_refuted_are_rounded_the_other_way(remedy: Prototype) -> None:
    """What is refuted up to 50.00000004 is not refuted at 50: more digits would be wrong the other way."""
    asked = [Asked("decay_rate", 3.00000004), Asked("decay_rate", 50.00000004)]
    said = check(certify(remedy, 3.0, 5.0, asked).text).proved
    assert "every pole decays faster than 3 1/s" in said
    assert "refuted: every pole decays faster than 50.00001 1/s" in said


@pytest.mark.parametrize("given", [None, 3.0, b"kind", ["a.toml"]])
def test_what_is_neither_a_path_nor_a_text_is_unreadable(given) -> None:
    with pytest.raises(Unreadable, match="a certificate is given by its path or text, not by what is of type"):
        check(given)
    if given is not None:
        with pytest.raises(Unreadable, match="a prototype is given by its path or table"):
            check("a.toml", given)


def test_a_path_with_a_nul_is_unreadable() -> None:
    with pytest.raises(Unreadable, match="NUL"):
        check(Path("a\0b.toml"))


def test_a_file_does_not_say_what_its_effects_come_to(remedy: Prototype, tmp_path: Path) -> None:
    """Only a caller who has worked out the elements may say so; a file that does is told what was not looked at."""
    rig = remedy.but(effects={"sensor_lag": {"break_Hz": 900.0}})
    path, text = tmp_path / "p.toml", certify(rig, 3.0, 5.0).text
    write_prototype(rig, path)
    left = check(text, path).open
    path.write_text(path.read_text() + "\n[[effect]]\nname = 'none'\n\n[material.none]\n")
    assert check(text, path).open == left != ()


def test_it_knows_the_keys_and_defaults_of_a_prototype() -> None:
    """The checker states them a second time, being alone: what a new field forgets here would go unchecked."""
    records = {
        "beam": Beam,
        "servovalve": Servovalve,
        "payload": Payload,
        "goal": Goal,
        "arm": Arm,
        "actuator": BallScrew,
    }
    for name, defaults in DEFAULTS.items():
        fields = records[name].model_fields
        for key, value in defaults.items():
            assert np.array_equal(fields[key].get_default(call_default_factory=True), value), (name, key)
        told = {key for key, field in fields.items() if field.default not in (None, PydanticUndefined)}
        assert told <= {*defaults, "outer_end_mass_kg", "kind"}, name
    stated = {"payload": Payload, "goal": Goal, "arm": Arm, "compliance": Compliance, "tolerance": Tolerance}
    assert {name: set(keys) for name, keys in KEYS.items()} == {n: set(r.model_fields) for n, r in stated.items()}
    assert {*Prototype.model_fields, "effect"} == {*KNOWN}
    assert {*Guarantee.model_fields} == {*GUARANTEED}
    scheduled = Scheduled.model_fields
    assert {key: scheduled[key].default for key in SCHEDULED if key != "estimator"} == {
        key: value for key, value in SCHEDULED.items() if key != "estimator"
    }
    assert Estimator().model_dump() == SCHEDULED["estimator"]


ALONE = """
import importlib.abc, runpy, sys
class Closed(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        top, _, inner = name.partition(".")
        inside = top == "beamdesign" and inner.split(".")[0] in ("", "checker", "__main__")
        if not inside and top not in sys.stdlib_module_names and top not in ("flint",):
            raise ImportError(name)
sys.meta_path.insert(0, Closed())
sys.argv = sys.argv[1:]
runpy.run_module("beamdesign.checker", run_name="__main__", alter_sys=True)
"""


@pytest.mark.parametrize(("verdict", "status"), [("valid", 0), ("altered", 1), ("malformed", 2)])
def test_it_runs_where_nothing_else_can_be_imported(tmp_path: Path, stable: str, verdict: str, status: int) -> None:
    text = {"valid": stable, "altered": stable.replace('"486800"', '"486801"'), "malformed": "kind = 1\n"}[verdict]
    (tmp_path / "certificate.toml").write_text(text)
    command = [sys.executable, "-W", "error", "-c", ALONE, "beamdesign.checker", "certificate.toml"]
    home = str(Path(beamdesign.__file__).parents[1])
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, check=False, env={"PYTHONPATH": home, "PATH": ""}
    )
    assert done.returncode == status, done.stderr


def test_nothing_that_proves_imports_it_and_it_imports_nothing_that_proves() -> None:
    home = Path(checker.__file__).parent
    for path in home.glob("*.py"):
        imported = set(re.findall(r"^(?:from|import) ([\w.]+)", path.read_text(), re.MULTILINE))
        outside = {name for name in imported if name.split(".")[0] not in sys.stdlib_module_names}
        assert all(name.startswith(("beamdesign.checker", "flint")) for name in outside), path.name
    others = [path for kind in ("*.py", "*.pyi") for path in home.parent.rglob(kind) if home not in path.parents]
    imports = re.compile(r"^\s*(from|import) beamdesign\.checker", re.MULTILINE)
    using = {path.relative_to(home.parent).as_posix() for path in others if imports.search(path.read_text())}
    assert using == {"__init__.pyi", "cli/certify.py"}


# Its own root isolation and Routh test.

quick = settings(max_examples=60)


@quick
@given(st.lists(st.fractions(min_value=-4, max_value=4, max_denominator=6), min_size=1, max_size=6, unique=True))
def test_isolation_by_signs_finds_every_root(points):
    wanted = sorted(fmpq(x.numerator, x.denominator) for x in points)
    polynomial = fmpq_poly([3, 0, 1])
    for x in wanted:
        polynomial *= fmpq_poly([-x, 1])
    inside = [x for x in wanted if -3 < x < 5]
    found = isolate(polynomial, fmpq(-3), fmpq(5))
    assert len(found) == len(inside)
    assert all(low < x < high or low == x == high for (low, high), x in zip(found, inside, strict=True))
    assert all(abs(x) < bound(polynomial) for x in wanted)
    for interval, x in zip(found, inside, strict=True):
        for _ in range(20):
            interval = halve(polynomial, interval)
        assert interval[0] <= x <= interval[1]
        assert interval[1] - interval[0] <= fmpq(8, 2**20)


@quick
@given(st.lists(st.integers(-6, 9), min_size=2, max_size=7), st.booleans())
def test_its_routh_test_agrees_with_numerical_roots(coefficients, positive):
    polynomial = fmpq_poly([abs(c) + 1 for c in coefficients] if positive else coefficients)
    if polynomial.degree() < 1 or abs(largest := roots(polynomial).real.max()) < 1e-9:
        return
    assert is_hurwitz(polynomial) == (largest < 0)


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
def test_its_determinant_is_the_product_of_sums_of_roots(degree: int):
    """Orlando's formula: the last but one Hurwitz determinant is a product over all pairs of roots."""
    points = np.arange(1, degree + 1) * 0.5 - 1.25
    polynomial = fmpq_poly([1])
    for x in points:
        polynomial *= fmpq_poly([-rational(str(x)), 1])
    determinant = _hurwitz_matrix(polynomial, degree).det()
    sums = np.prod([points[i] + points[k] for i in range(degree) for k in range(i)])
    assert abs(float(determinant.p) / float(determinant.q)) == pytest.approx(abs(sums))
