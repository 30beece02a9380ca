"""Certificates of changing payloads and stages: proved again, compared with their prototype, and not after a change."""

import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from flint import fmpq, fmpq_mat
from forging import sealed_text
from truth_of_stages import true

from beamdesign import Prototype, certify, check, read_prototype
from beamdesign.checker import Unreadable, Verdict
from beamdesign.checker.prototype import differences
from beamdesign.checker.reading import Table
from beamdesign.checker.rig import Rig
from beamdesign.checker.stages import StateSpace, positive, positive_between
from beamdesign.controllers import Lag, Observer, Proportional, Section
from beamdesign.polynomial import exact
from beamdesign.proofs import lmi
from beamdesign.proofs.courses import any_change, stage_change
from beamdesign.proofs.decrease import Sought
from beamdesign.proofs.lmi import Answer, Course
from beamdesign.proofs.lyapunov import Switching, stages_certificate, switching
from beamdesign.proofs.mass_family import Cycle, Families, Frozen, floats, frozen, stage_families
from beamdesign.proofs.writer import prototype_table, rig_tables
from beamdesign.prototype import Payload, Sensor

STUDIES = Path(__file__).parents[1] / "studies"
OBSERVER = Observer(
    gain_A_per_V=0.05,
    sensors=("displacement_m", "inner_displacement_m", "load_pressure_Pa"),
    a=((-10.0, 1.0), (0.0, -40.0)),
    b=((9.0, -20.0, 0.0), (1.0, 0.0, 1e-7)),
    c=(1.0, 0.5),
    d=(0.085, 3.0, 1e-9),
)
SECTIONS = (
    Section(zero_Hz=20.0, zero_damping_ratio=0.3, pole_Hz=17.0, pole_damping_ratio=0.5),
    Section(zero_Hz=90.0, zero_damping_ratio=0.7, pole_Hz=160.0, pole_damping_ratio=0.9),
)


def rig(**parts: Any) -> Prototype:
    """The published rig with other parts; a lag that is stable at every mass, and not under every change of it."""
    payload = Payload(inner_end_mass_kg=2.0, outer_end_mass_kg=(0.0, 6.8))
    law = Lag(gain_A_per_V=0.05, pole_Hz=1.75, zero_Hz=26.0)
    return read_prototype(STUDIES / "prototypes/tame_lag.toml").but(**{"controller": law, "payload": payload} | parts)


def scheduled(name: str = "prototype") -> Prototype:
    """A shipped rig whose law has stages."""
    return read_prototype(STUDIES / f"scheduled/{name}.toml")


def found_at(prototype: Prototype, low: float, high: float, rate: float | None = None) -> Switching:
    return switching(stage_families(prototype), low, high, rate)


def dwelling(prototype: Prototype) -> Switching:
    """Changes of stage that are kept apart, as where no common function is found."""

    def nothing(*asked: object) -> Answer:
        return Answer("none", "none")

    families = stage_families(prototype)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lmi, "solve", nothing)
        stages, _ = stage_change(Sought(families, fmpq(2), fmpq(3)))
    assert stages.kind == "dwell"
    return _with(families, (2.0, 3.0), stages=stages)


def _with(families: Families, masses: tuple[float, float], **parts: Any) -> Switching:
    low, high = map(exact, masses)
    common, _ = any_change(Sought(families, low, high))
    parts = {"stages": stage_change(Sought(families[:1], low, high))[0], "any_change": common} | parts
    stays = frozen(families, low, high)
    return Switching(masses, stays, rates=(), sudden=(), wanted_kg_per_s=None, dwell_s=0.0, families=families, **parts)


CASES: dict[str, tuple[Callable[[], Prototype], Callable[[Prototype], Switching], int]] = {
    "loose": (rig, lambda p: found_at(p, 0.0, 6.8, 900.0), 6),
    "stages": (scheduled, lambda p: found_at(p, 2.0, 3.0, 3.0), 4),
    "dwelling": (scheduled, dwelling, 2),
    "sensors": (lambda: rig(controller=OBSERVER), lambda p: found_at(p, 2.0, 2.2, 0.01), 3),
    "filtered": (
        lambda: rig(controller=Proportional(gain_A_per_V=0.008), sensor=Sensor(gain_V_per_m=1180.0, filter_Hz=400.0)),
        lambda p: _with(stage_families(p), (0.0, 1.0)),
        1,
    ),
    "high order": (
        lambda: read_prototype(STUDIES / "prototypes/structured.toml"),
        lambda p: _with(stage_families(p), (3.0, 3.1)),
        1,
    ),
    "unstable": (
        lambda: rig(
            payload=Payload(inner_end_mass_kg=4.5), controller=Lag(gain_A_per_V=0.15, pole_Hz=1.75, zero_Hz=26.0)
        ),
        lambda p: found_at(p, 0.0, 6.8),
        1,
    ),
}
"""Prototypes, what is found of them, and how many claims and counterexamples that makes."""


@cache
def made(name: str) -> tuple[str, dict[str, Any]]:
    """A certificate, and the table of its prototype."""
    given, prove, _ = CASES[name]
    prototype = given()
    return stages_certificate(prototype, prove(prototype), name), prototype_table(prototype)


@pytest.mark.parametrize("name", CASES)
def test_what_was_proved_is_proved_again_and_true(name: str) -> None:
    text, prototype = made(name)
    verdict = check(text, prototype)
    assert verdict.valid, verdict.failed
    table = tomllib.loads(text)
    stated = sum(len(table.get(key, [])) for key in ("claim", "counterexample"))
    assert stated == CASES[name][2]
    assert len(verdict.proved) == 4 + stated  # intact, the law, something claimed, of this prototype
    assert true(table) is True
    assert check(sealed_text(text)).valid


def test_every_kind_of_claim_is_among_them() -> None:
    tables = [tomllib.loads(made(name)[0]) for name in ("loose", "stages", "dwelling", "unstable")]
    kinds = {one["kind"] for table in tables for key in ("claim", "counterexample") for one in table.get(key, [])}
    assert kinds == {
        "any_change", "payload_rate", "payload_jumps", "stage_change", "stage_dwell", "cycle", "frozen"
    }  # fmt: skip


# Forged.

FORGED: dict[str, tuple[str, str, str]] = {
    "rate": ("loose", 'rate_kg_per_s = "900"', 'rate_kg_per_s = "900000"'),
    "range of any change": (
        "loose",
        '(kind = "any_change"\nouter_end_mass_kg = \\[\n    "0",\n    )"[^"]*"',
        '\\1"6.8"',
    ),
    "dwell": ("loose", 'dwell_s = "0.0', 'dwell_s = "0.00'),
    "decay": ("loose", 'decay_per_s = "', 'decay_per_s = "9'),
    "factor": ("loose", '\nfactor = "[^"]*"', '\nfactor = "1.0001"'),
    "mass": ("loose", 'outer_mass_kg = "3.9"', 'outer_mass_kg = "0.9"'),
    "law": ("loose", '"0.05",', '"0.06",'),
    "gain": ("loose", 'gain_A_per_V = "0.05"', 'gain_A_per_V = "0.07"'),
    "frequency": ("loose", 'valve_frequency_Hz = "150"', 'valve_frequency_Hz = "250"'),
    "sign of P": ("loose", 'P = \\[\n( *\\[\n)( *\\[\n)? *"', 'P = [\n[\n[\n"-'),
    "cycle": ("loose", 'time_s = \\[\n    "0.00', 'time_s = [\n    "0.0000'),
    "joining": ("loose", '(rate_kg_per_s = "900"\njoining = )"matched"', '\\1"from_rest"'),
    "gain of a stage": ("stages", 'gain_A_per_V = "0.14266"', 'gain_A_per_V = "0.9"'),
    "break of a stage": ("stages", 'zero_Hz = "37.9003"', 'zero_Hz = "47.9003"'),
    "growth at a change of stage": ("dwelling", 'factor = "[^"]*"', 'factor = "1.0001"'),
    "time between changes of stage": ("dwelling", 'dwell_s = "0.(?!1")', 'dwell_s = "0.0000'),
    "matrix of a law": ("sensors", '"-40"', '"-41"'),
    "sensor of a law": ("sensors", 'load_pressure_Pa"', 'inner_displacement_m"'),
    "mass that stays": ("unstable", '(kind = "frozen", stage = 1, outer_end_mass_kg = )"[^"]*"', '\\1"6"'),
}


@pytest.mark.parametrize("what", FORGED)
def test_a_forged_certificate_is_not_valid_and_not_true(what: str) -> None:
    name, before, after = FORGED[what]
    text = made(name)[0]
    changed = re.sub(before, after, text, count=1)
    assert changed != text
    with_old_seal = outcome(changed)
    assert with_old_seal is None or not with_old_seal.valid
    forged = outcome(sealed_text(changed))
    assert forged is None or (forged.failed and not any("sha256" in words for words in forged.failed))
    try:
        assert true(tomllib.loads(changed)) is False
    except (LookupError, ValueError):
        assert forged is None  # neither takes it for a certificate


def outcome(text: str) -> Verdict | None:
    try:
        return check(text)
    except Unreadable:
        return None


def test_a_certificate_that_claims_nothing_is_not_valid() -> None:
    table = tomllib.loads(made("filtered")[0])
    del table["claim"]
    verdict = outcome(sealed_text(tomli_w.dumps(table)))
    assert verdict is not None
    assert verdict.failed == ("nothing is claimed",)


@pytest.mark.parametrize(
    ("name", "before", "after"),
    [
        ("loose", "\ncycles = [0-9]+", "\ncycles = 100001"),
        ("loose", "\ncycles = [0-9]+", "\ncycles = true"),
        ("loose", 'time_s = \\[\n    "0.00', 'time_s = [\n    "99999999999999.00'),
        ("loose", 'outer_mass_kg = "3.9"', f'outer_mass_kg = "3.{"9" * 2900}"'),
        ("loose", "stages = \\[\n    1,", "stages = [\n    2,"),
        ("loose", 'kind = "any_change"', 'kind = "any_change"\nreason = "because"'),
        ("loose", 'kind = "any_change"', 'kind = "bounded_rate"'),
        ("stages", "section = \\[\\]", 'section = []\nup_to_kg = "1"'),
        ("stages", 'period_s = "', 'reason = "because"\nperiod_s = "'),
        ("stages", 'band_kg = "', 'reason = "because"\nband_kg = "'),
        ("stages", 'zero_rad_per_s = "', 'zero_rad_per_s = " '),
        ("dwelling", 'dwell_s = "0.1"', 'dwell_s = "1e-1"'),
        ("unstable", "stage = 1", "stage = 2"),
    ],
)
def test_what_is_not_of_the_format_is_unreadable(name: str, before: str, after: str) -> None:
    changed, count = re.subn(before, after, made(name)[0], count=1)
    assert count == 1
    with pytest.raises(Unreadable):
        check(sealed_text(changed))


def test_a_claim_is_of_payloads_that_the_certificate_is_about() -> None:
    """Of a law that is stable far beyond them: it would hold, but of a rig that nobody has compared there."""
    table = tomllib.loads(made("filtered")[0])
    assert table["outer_end_mass_kg"] == table["claim"][0]["outer_end_mass_kg"] == ["0", "1"]
    for ends in (["0", "1.001"], ["1", "1"], ["0.5", "0.4"]):
        table["claim"][0]["outer_end_mass_kg"] = ends
        with pytest.raises(Unreadable, match="outer_end_mass_kg"):
            check(sealed_text(tomli_w.dumps(table)))


# The prototype.


def test_all_stages_are_those_of_the_prototype() -> None:
    text, table = made("stages")
    certificate, stage = Table(tomllib.loads(text)), table["controller"]["stage"]
    stated = Rig(certificate)

    def differs(**changed: Any) -> list[str]:
        return list(differences(certificate, stated, table | changed))

    assert differs() == []
    for changed in (
        {"stage": stage[:2]},
        {"stage": stage[::-1]},
        {"stage": [stage[0] | {"gain_A_per_V": 0.15}, *stage[1:]]},
        {"stage": [stage[0] | {"outer_end_mass_kg": [0.0, 2.8]}, *stage[1:]]},
        {"stage": [stage[0] | {"section": [{}]}, *stage[1:]]},
        {"dwell_s": 0.2},
        {"period_s": 0.001},
        {"estimator": {"band_kg": 0.5}},
    ):
        assert len(differs(controller=table["controller"] | changed)) == 1, changed
    # What a prototype leaves out has the value of its format; of these the shipped one has none but those.
    assert differs(controller={key: table["controller"][key] for key in ("kind", "stage")}) == []
    assert len(differs(payload=table["payload"] | {"outer_end_mass_kg": [0.0, 7.0]})) == 1


def test_a_single_law_is_of_a_prototype_that_has_it_for_these_payloads() -> None:
    prototype = scheduled()

    def differs(payload: tuple[float, float], number: int = 1) -> list[str]:
        alone = prototype.stages((0.0, 6.8))[number].prototype
        tables = rig_tables(alone.but(payload=alone.payload.but(outer_end_mass_kg=payload)))
        table = Table(tables)
        return list(differences(table, Rig(table), prototype_table(prototype)))

    assert differs((1.767, 5.033)) == differs((2.0, 3.0)) == []
    assert len(differs((1.767, 5.1))) == len(differs((2.0, 3.0), 0)) == 1


def test_what_a_certificate_of_one_law_leaves_of_several_is_said() -> None:
    """The other laws, and the payloads of all of them, also where the prototype states these by its stages alone."""
    prototype = scheduled()
    first = certify(prototype.stages((0.0, 2.0))[0].prototype, 0.0, 2.0).text
    whole = prototype_table(prototype)
    untold = whole | {"payload": {key: v for key, v in whole["payload"].items() if key != "outer_end_mass_kg"}}
    within = whole | {"payload": whole["payload"] | {"outer_end_mass_kg": [0.0, 2.0]}}
    lower = certify(prototype.stages((0.0, 2.0))[0].prototype, 1.0, 2.0).text
    for text, table, beyond in (
        (first, whole, True),
        (first, untold, True),
        (lower, whole, True),
        (first, within, False),
    ):
        said = "\n".join(check(text, table).open)
        assert "the other laws of the prototype, which has 3" in said
        assert ("the prototype's payloads, 0 to 6.8 kg, are not all within" in said) is beyond


def test_a_dwell_that_the_schedule_does_not_keep_is_said() -> None:
    def told(dwell_s: str) -> str:
        text = re.sub('\ndwell_s = "0.1"', f'\ndwell_s = "{dwell_s}"', made("dwelling")[0], count=1)
        (words,) = (words for words in check(sealed_text(text)).proved if "changes of stage" in words)
        return words

    assert "NOT" in told("0.000001")
    assert "NOT" not in told("9")


# Matrices.


@pytest.mark.parametrize("filter_Hz", [None, 400.0])
@pytest.mark.parametrize(
    "law", [Proportional(gain_A_per_V=0.01), Lag(gain_A_per_V=0.1, pole_Hz=1.7, zero_Hz=26.0), OBSERVER]
)
def test_the_matrix_has_the_poles_of_the_impedances_and_is_the_provers(law: Any, filter_Hz: float | None) -> None:
    prototype = rig(controller=law, sensor=Sensor(gain_V_per_m=1180.0, filter_Hz=filter_Hz))
    stated = Rig(Table(rig_tables(prototype)))
    (impedances,), (family,) = stated.loops(), stage_families(prototype)
    assert stated.law is not None
    space = StateSpace(stated, stated.law)
    for mass in (fmpq(0), fmpq(1, 3), fmpq(7)):
        whole = impedances.closed[0] + mass * impedances.closed[1]
        assert space.matrix(mass).charpoly() == whole / whole[whole.degree()]
        assert space.matrix(mass) == family.at(mass)


@pytest.mark.parametrize("name", ["prototype", "structured"])
def test_stages_have_the_poles_of_each_law_by_itself_and_are_the_provers(name: str) -> None:
    prototype = scheduled(name)
    stated = Rig(Table(rig_tables(prototype)))
    assert stated.schedule is not None
    assert stated.schedule.follows
    for family, stage, single in zip(
        stage_families(prototype), stated.schedule.stages, prototype.stages((0.0, 6.8)), strict=True
    ):
        (impedances,) = Rig(Table(rig_tables(single.prototype))).loops()
        whole = impedances.closed[0] + fmpq(3) * impedances.closed[1]
        matrix = StateSpace(stated, stage).matrix(fmpq(3))
        assert matrix.charpoly() == whole / whole[whole.degree()]
        assert matrix == family.at(fmpq(3))


def test_sections_without_a_filter_are_refused() -> None:
    prototype = scheduled("structured")
    tables = rig_tables(prototype)
    del tables["rig"]["filter_frequency_rad_per_s"], tables["rig"]["filter_frequency_Hz"]
    stated = Rig(Table(tables))
    assert stated.schedule is not None
    with pytest.raises(Unreadable, match="acceleration"):
        StateSpace(stated, stated.schedule.stages[0])


@pytest.mark.parametrize(
    "law",
    [
        {"numerators": [["1"]], "denominator": ["1"] * 40},  # of too many states
        {"numerators": [["1", "1"]], "denominator": ["1"]},  # differentiates
        {"numerators": [["1"]], "denominator": ["1", "1/1" + "0" * 900]},  # of numbers that take long
    ],
)
def test_laws_that_are_not_worked_with_are_refused(law: dict[str, Any]) -> None:
    tables = rig_tables(rig()) | {"controller": {"kind": "another", "law": {"sensors": ["displacement_m"]} | law}}
    stated = Rig(Table(tables))
    assert stated.law is not None
    with pytest.raises(Unreadable):
        StateSpace(stated, stated.law)


@pytest.mark.parametrize("time_s", [1e-3, 1.0])
def test_a_cycle_of_laws_with_sections_is_proved_again_however_long_it_is(time_s: float) -> None:
    """Behind a filter their matrices have entries of 1e10: a cycle that was proved was refused as too long.

    Where nothing changes the motion grows over a cycle by exp(2 sigma t), sigma being that of the unstable pole.
    """
    shipped = scheduled("structured")
    assert shipped.schedule is not None
    first, *others = shipped.schedule.stage
    louder = first.but(gain_A_per_V=4 * first.gain_A_per_V)
    prototype = shipped.but(controller=shipped.schedule.but(stage=(louder, *others)))
    families, count = stage_families(prototype), 4096
    sigma = float(np.linalg.eigvals(floats(families[0].at(fmpq(0)))).real.max())
    growth = np.exp(2 * sigma * time_s)
    assert growth > 1.001  # so that 4096 cycles show it
    cycle = Cycle((0, 0), (0.0, 0.0), (time_s, time_s), growth, count)
    courses = Course("undecided"), Course("refuted", counterexample=cycle)
    found = Switching((0.0, 6.8), Frozen(True, "", None), *courses, (), (), None, 0.0, families)
    verdict = check(stages_certificate(prototype, found, ""), prototype_table(prototype))
    assert verdict.valid, verdict.failed
    assert any("grows" in words for words in verdict.proved)


# Definiteness.


def test_definiteness_of_textbook_matrices() -> None:
    hilbert = fmpq_mat(8, 8, [fmpq(1, i + j + 1) for i in range(8) for j in range(8)])
    assert positive(hilbert)  # though its least eigenvalue is 1e-10 (Todd, 1961)
    one = fmpq_mat(8, 8, [int(i == j) for i in range(8) for j in range(8)])
    assert not positive(hilbert - one * fmpq(1, 10**9))
    assert not positive(fmpq_mat([[1, 1], [1, 1]]))
    assert not positive(fmpq_mat([[0, 1], [1, 0]]))


@pytest.mark.parametrize(("floor", "holds"), [(fmpq(1, 10**12), True), (fmpq(0), False), (fmpq(-1, 10**12), False)])
def test_definiteness_between_two_masses(floor: fmpq, holds: bool) -> None:
    # One eigenvalue dips to `floor` in the middle; or two at once, so that the determinant keeps its sign.
    def at(mass: fmpq) -> fmpq_mat:
        dip = (mass - fmpq(1, 3)) ** 2 + floor
        return fmpq_mat([[dip, 0, 0], [0, 1 + mass, 0], [0, 0, 2]])

    def twice(mass: fmpq) -> fmpq_mat:
        dip = (mass - fmpq(1, 3)) ** 2 + floor
        return fmpq_mat([[dip + 1, 1, 0], [1, dip + 1, 0], [0, 0, dip]])

    assert positive_between(at, 2, fmpq(0), fmpq(1)) is holds
    assert positive_between(twice, 2, fmpq(0), fmpq(1)) is holds


# The program.


def test_it_runs_with_flint_alone(tmp_path: Path) -> None:
    path = tmp_path / "certificate.toml"
    text = made("filtered")[0]
    blocked = (
        "import runpy, sys\n"
        "class Blocked:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name.partition('.')[0] in ('numpy', 'scipy', 'casadi', 'cvxpy', 'control', 'pydantic', 'typer'):\n"
        "            raise ImportError(name)\n"
        "sys.meta_path.insert(0, Blocked())\n"
        "runpy.run_module('beamdesign.checker', run_name='__main__', alter_sys=True)\n"
    )
    for changed, status in ((text, 0), (text.replace('"0"', '"0.0"', 1), 1), (text[:-40], 2)):
        path.write_text(changed, encoding="utf-8")
        done = subprocess.run([sys.executable, "-c", blocked, str(path)], capture_output=True, text=True, check=False)
        assert done.returncode == status, done.stderr
