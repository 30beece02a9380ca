"""The blind check: seals, plan, bounds, scores of hand-made outcomes, baselines, and a check of its own in small.

A check of whole cases takes minutes of processor time. So the one here has cases of few and short records, diagnosed
with few candidates: see `FEW`.
"""

import json
import os
import shutil
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from gap_sets import believed, measured, only, scenario

from beamdesign import InputError
from beamdesign.code_digest import code_digest, folder_digest, sources
from beamdesign.diagnosis.fitting.fit_cache import Task
from beamdesign.diagnosis.fitting.fitters import Fitters
from beamdesign.diagnosis.fitting.hypothesis import NOTHING
from beamdesign.diagnosis.fitting.search import Search
from beamdesign.validation import blindcheck, case_plan, scoring
from beamdesign.validation.baselines import baselines, lasso, lasso_path
from beamdesign.validation.blind_diagnosis import Place, begin_blind, diagnose_blind, program
from beamdesign.validation.blindcheck_result import Scored, confusion, result_text
from beamdesign.validation.bounds import bootstrap, clopper_pearson
from beamdesign.validation.case_plan import (
    RIGS,
    SHARES,
    Planned,
    broken,
    canonical,
    counts,
    draw,
    plan,
    read_seal,
    sealed,
    write_seal,
)
from beamdesign.validation.scoring import Outcome
from beamdesign.validation.truth import drawing
from beamdesign.validation.truth.effects import LISTED, OUTSIDE
from beamdesign.validation.truth.rig_kinds import on

pytestmark = pytest.mark.long

# Bounds


@pytest.mark.parametrize(
    ("count", "of", "low", "high"),
    [
        # W. J. Conover, Practical Nonparametric Statistics, 1971, p. 97: 682 plants of 925; bounds as in the
        # documentation of R's binom.test.
        (682, 925, 0.7076683, 0.7654066),
        # Closed forms at the ends: 1 - (alpha / 2)^(1 / n), the rule that three in n becomes.
        (0, 10, 0.0, 1 - 0.025 ** (1 / 10)),
        (200, 200, 0.025 ** (1 / 200), 1.0),
        (0, 0, 0.0, 1.0),
    ],
)
def test_clopper_pearson_bounds(count, of, low, high):
    assert clopper_pearson(count, of) == pytest.approx((low, high), abs=5e-8)


def test_clopper_pearson_bounds_by_definition():
    """At each bound, what was seen or what is more extreme has a probability of half the rest: summed, not inverted."""
    from math import comb

    low, high = clopper_pearson(7, 23)
    at_least = sum(comb(23, k) * low**k * (1 - low) ** (23 - k) for k in range(7, 24))
    at_most = sum(comb(23, k) * high**k * (1 - high) ** (23 - k) for k in range(8))
    assert (at_least, at_most) == pytest.approx((0.025, 0.025), rel=1e-9)
    with pytest.raises(ValueError, match="5 of 4"):
        clopper_pearson(5, 4)


def test_bootstrap_of_a_mean_agrees_with_the_normal_law():
    values = np.random.default_rng(5).normal(0.3, 0.1, 400)
    low, high = bootstrap(list(values), np.mean)
    half = 1.96 * values.std() / 20
    assert (low, high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.1 * half)


# Plan


def test_a_plan_keeps_its_shares_and_deals_effects_evenly():
    cases = plan(200, 3)
    of = {kind: [c for c in cases if c.kind == kind] for kind in SHARES}
    assert {kind: len(rows) for kind, rows in of.items()} == {
        "null": 40, "single": 78, "parameter": 16, "pair": 24, "outside": 24, "triple": 10, "alone": 8,
    }  # fmt: skip
    dealt = [sum(c.names == (name,) for c in of["single"]) for name in LISTED]
    assert max(dealt) - min(dealt) <= 1
    assert min(dealt) >= 6
    for rig in RIGS:
        assert sum(c.rig == rig for c in of["single"]) == (26 if rig == "lag" else 13)
        own = {name.removeprefix("parameter:") for c in cases if c.rig == rig for name in c.names}
        assert own == set(on(rig, own))
    assert Counter(c.noise for c in of["null"]) == {"white": 24, "coloured": 8, "outliers": 8}
    assert {c.names[0] for c in of["outside"]} == set(OUTSIDE)
    assert len({c.names for c in of["pair"]}) == 24
    assert {len(set(c.names)) for c in of["triple"]} == {3}
    assert {len(c.names) for c in of["alone"]} == {1}
    assert all(c.figures for c in of["alone"])
    assert [sum(c.figures for c in of[kind]) for kind in ("null", "triple", "pair")] == [8, 2, pytest.approx(5, abs=1)]
    assert len({c.seed for c in cases}) == 200
    assert plan(200, 3) == cases
    assert [c.names for c in plan(200, 4)] != [c.names for c in cases]


@pytest.mark.parametrize("total", [1, 2, 5, 12, 37, 201])
def test_counts_add_up(total):
    assert sum(counts(total).values()) == total
    assert all(abs(number - SHARES[kind] * total) < 1 for kind, number in counts(total).items())


# Seal

ANSWERS = {"0000": {"effects": ["sensor_lag"], "gap": 3.25}, "0001": {"effects": ["no_gap"], "gap": 0.0}}
SETS = {"0000": "a" * 64, "0001": "b" * 64}


def test_a_seal_is_that_of_the_content_not_of_its_layout(tmp_path):
    seal = sealed(ANSWERS, SETS, "truth")
    assert canonical({"b": 1.0, "a": "ü"}) == b'{"a":"\\u00fc","b":1.0}'
    # SHA-256 of that canonical form by the system's own tool, not by this program.
    said = subprocess.run(["sha256sum"], input=canonical(ANSWERS["0000"]), capture_output=True, check=True)
    assert seal.answers["0000"] == said.stdout.decode().split()[0]
    turned = {key: dict(reversed(answer.items())) for key, answer in reversed(ANSWERS.items())}
    assert sealed(turned, SETS, "truth") == seal
    write_seal(seal, tmp_path / "sealed.json")
    assert read_seal(tmp_path / "sealed.json") == seal


def test_tampering_is_detected(tmp_path):
    seal = sealed(ANSWERS, SETS)
    assert broken(seal, ANSWERS) == []
    assert broken(seal, ANSWERS | {"0001": {"effects": ["sensor_lag"], "gap": 0.0}}) == ["0001"]
    assert broken(seal, {"0000": ANSWERS["0000"]}) == ["0001"]
    assert broken(seal, ANSWERS | {"0002": {}}) == ["0002"]
    path = tmp_path / "sealed.json"
    write_seal(seal, path)
    fields = json.loads(path.read_text())
    fields["answers"]["0001"] = sealed({"0001": {}}, {}).answers["0001"]
    path.write_text(json.dumps(fields))
    with pytest.raises(ValueError, match="not that of its parts"):
        read_seal(path)
    with pytest.raises(ValueError, match="not JSON compliant"):
        canonical({"gap": float("nan")})


def test_the_digest_of_a_folder_sees_names_and_bytes(tmp_path):
    (tmp_path / "a").write_text("x")
    first = folder_digest(tmp_path)
    (tmp_path / "a").rename(tmp_path / "b")
    second = folder_digest(tmp_path)
    (tmp_path / "b").write_text("y")
    assert len({first, second, folder_digest(tmp_path)}) == 3


def test_the_digest_of_a_program_covers_what_it_imports_and_no_more():
    fits = {path.name for path in sources("beamdesign.diagnosis.fitting.search")}
    assert {"search.py", "fit.py", "seal_friction.py", "prototype.py"} <= fits
    assert not {"judgement.py", "diagnose.py", "drawing.py"} & fits
    assert "judgement.py" in {path.name for path in sources("beamdesign.diagnosis.diagnose")}
    assert code_digest("beamdesign.diagnosis.fitting.search") != code_digest("beamdesign.diagnosis.diagnose")
    with pytest.raises(ValueError, match="no module"):
        sources("beamdesign.nowhere")


def test_whoever_diagnoses_cannot_open_an_answer(tmp_path):
    answers = tmp_path / "answers"
    answers.mkdir()
    (answers / "0000.json").write_text("{}")
    (tmp_path / "other").write_text("free")
    check = blindcheck.begin_check(tmp_path, 1, 0, True)
    with blindcheck._processes(1, begin_blind, (check.telling,)) as pool:
        assert pool.submit(Path.read_text, tmp_path / "other").result() == "free"
        with pytest.raises(PermissionError, match="sealed"):
            pool.submit(Path.read_text, answers / "0000.json").result()
        with pytest.raises(PermissionError, match="sealed"):  # which names the effects of every case
            pool.submit(Path.read_text, check.plan).result()
        (tmp_path / "detour").symlink_to(answers)
        with pytest.raises(PermissionError, match="sealed"):
            pool.submit(Path.read_text, tmp_path / "detour" / "0000.json").result()
        with pytest.raises(ImportError):
            pool.submit(import_module, "beamdesign.validation.truth").result()
    with pytest.raises(RuntimeError, match="knows the truth model"):
        begin_blind(check.telling)  # this process does


def test_a_script_that_knows_the_truth_model_begins_processes_that_do_not(tmp_path):
    """They do not run the script again, which need not guard its work against that either."""
    script = tmp_path / "check.py"
    script.write_text(
        "from pathlib import Path\n"
        "from beamdesign import blindcheck\n"
        "from beamdesign.progress import silent\n"
        "from beamdesign.validation.blind_diagnosis import begin_blind\n"
        "from beamdesign.validation.blindcheck import _done, _processes\n"
        "jobs = {'a': (Path.exists, Path('nowhere')), 'b': (Path.exists, Path())}\n"
        "print(sorted(_done(jobs, _processes(2, begin_blind, ((),)), silent, '')))\n"
    )
    ran = subprocess.run([sys.executable, script], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert ran.stdout == "[('a', False), ('b', True)]\n", ran.stderr


# Scores of outcomes made by hand


def said(key, kind, effects, named, **more):
    """An outcome with a large gap and one cause named with a probability of 0.9."""
    fields = {
        "verdict": named if named in ("no_gap", "unknown") else "effect",
        "chosen": () if named in ("no_gap", "unknown") else (named,),
        "probability": {} if named in ("no_gap", "unknown") else {named: 0.9},
        "subsystem": "sensor",
        "where": "sensor",
    }
    fields |= {"gap_over_floor": 10.0, "each_over_floor": 10.0, "left": 5.0}
    return Outcome(key, kind, effects, named=named, **(fields | more))


HAND = (
    said("0", "null", (), "no_gap", no_gap=0.95, subsystem="", where=""),
    said("1", "null", (), "sensor_lag", no_gap=0.05, subsystem="", where="sensor"),
    said("2", "single", ("sensor_lag",), "sensor_lag", parameter_error=0.04, closed=0.9, interval=(0.85, 0.95),
         closed_truly=0.92, seconds=(60.0, 50.0)),
    said("3", "single", ("transport_delay",), "sensor_lag", verdict="ambiguous", probability={"sensor_lag": 0.6},
         alternatives=("sensor_lag", "transport_delay"), where="sensor", subsystem="controller", closed=0.8,
         interval=(0.78, 0.82), closed_truly=0.5),
    said("4", "single", ("seal_friction",), "no_gap", no_gap=0.8, where="", subsystem="actuator"),
    said("5", "parameter", ("parameter:stiffness",), "parameter:stiffness"),
    said("6", "pair", ("sensor_lag", "seal_friction"), "sensor_lag", chosen=("sensor_lag", "seal_friction")),
    said("7", "pair", ("sensor_lag", "seal_friction"), "sensor_lag", each_over_floor=1.0),
    said("8", "outside", ("coil_lag",), "sensor_lag", subsystem="amplifier"),
    said("9", "outside", ("coil_lag",), "unknown", unknown=0.9, subsystem="amplifier", where="amplifier"),
    said("10", "outside", ("sensor_bracket",), "sensor_lag", verdict="ambiguous", probability={"sensor_lag": 0.6}),
)  # fmt: skip

THREE = ("sensor_lag", "seal_friction", "transport_delay")
MORE = (
    said("11", "triple", THREE, "sensor_lag", chosen=("sensor_lag", "seal_friction")),
    said("12", "triple", THREE, "seal_friction", chosen=("seal_friction", "sensor_lag", "transport_delay")),
    said("13", "triple", THREE, "valve_deadband", where="servovalve"),
    said("14", "alone", ("sensor_lag",), "sensor_lag", verdict="ambiguous", chosen=(), probability={"sensor_lag": 0.5},
         alternatives=("sensor_lag", "transport_delay"), where="", figures=True),
    said("15", "alone", ("sensor_lag",), "valve_deadband", where="servovalve", figures=True),
)  # fmt: skip


def test_scores_of_outcomes_made_by_hand():
    found = {s.name: s for s in scoring.scores(HAND)}
    counted = {name: (s.count, s.of) for name, s in found.items() if s.count is not None}
    assert counted == {
        "gap detected": (8, 9),
        "gap detected, tolerances cannot imitate it": (8, 9),
        "false alarms": (1, 2),
        "single effect named first": (1, 3),
        "single effect in the class": (2, 3),
        "wrong figure named first": (1, 1),
        "exact pair": (1, 2),
        "exact pair, each effect large": (1, 1),
        "one of the pair named first": (2, 2),
        "dominant of three named first": (0, 0),
        "one of the three named first": (0, 0),
        "exactly the three": (0, 0),
        "subsystem right, known causes": (4, 6),
        "subsystem right, outside the library": (2, 3),
        "outside the library, confidently wrong": (1, 3),
        "outside the library, called unknown": (1, 3),
        "outside the library, 80 % closed": (0, 3),
        "true `closed` inside the interval": (1, 2),
        "diagnosis broke off": (0, 11),
        "without records: gap detected": (0, 0),
        "without records: effect in the class": (0, 0),
        "without records: confidently wrong": (0, 0),
        "without records: subsystem right": (0, 0),
    }
    assert found["mean probability on the truth, singles"].value == pytest.approx(0.9 / 3)
    assert found["error of `closed`, median"].value == pytest.approx((0.02 + 0.30) / 2)
    assert found["error of the effect's parameter, median"].value == pytest.approx(0.04)
    assert found["seconds per case, median"].value == 60.0
    assert found["error of the effect's parameter, median"].reached is True
    assert found["gap detected, tolerances cannot imitate it"].reached is False
    assert (found["gap detected"].low, found["gap detected"].high) == clopper_pearson(8, 9)


def test_three_effects_and_cases_without_records_have_rows_of_their_own():
    before, after = ({s.name: s for s in scoring.scores(cases)} for cases in (HAND, (*HAND, *MORE)))
    changed = {name: (s.count, s.of) for name, s in after.items() if s.count is not None and s.of != before[name].of}
    assert changed == {
        "gap detected": (11, 12),
        "gap detected, tolerances cannot imitate it": (11, 12),
        "dominant of three named first": (1, 3),
        "one of the three named first": (2, 3),
        "exactly the three": (1, 3),
        "subsystem right, known causes": (6, 9),
        "diagnosis broke off": (0, 16),
        "without records: gap detected": (2, 2),
        "without records: effect in the class": (1, 2),
        "without records: confidently wrong": (1, 2),
        "without records: subsystem right": (0, 2),
    }
    assert after["dominant of three named first"].reached is False
    assert scoring.calibration((*HAND, *MORE[3:])) == scoring.calibration(HAND)
    assert {"sensor_lag + +", "without records: sensor_lag"} <= confusion(MORE).keys()
    setting = {"records": "", "planned": 16, "seed": 1, "seal": "00"}
    page = Scored((*HAND, *MORE), setting).markdown()
    assert "3 of three effects" in page
    assert "2 single effects without records" in page


def test_what_broke_off_counts_as_missed():
    broke = Outcome("0", "single", ("sensor_lag",), "sensor", 10.0, 10.0, "failed")
    found = {s.name: s for s in scoring.scores((broke,))}
    assert found["gap detected"].count == 0
    assert found["single effect in the class"].count == 0
    assert found["diagnosis broke off"].count == 1
    assert found["false alarms"].reached is None


def test_calibration_by_hand():
    """Two statements of 0.9 of which one is true, and two of 0 that are false: (2 * 0.4 + 2 * 0) / 4."""
    two = (
        said("0", "single", ("sensor_lag",), "sensor_lag"),
        said("1", "single", ("seal_friction",), "sensor_lag"),
    )
    bins, error = scoring.calibration(two)
    # Of each case: its cause, that there is no gap, that it is unknown.
    assert [(b.count, b.true) for b in bins] == [(4, 0.0), (2, 0.5)]
    assert error == pytest.approx((4 * 0.0 + 2 * 0.4) / 6)


def test_stated_probabilities_that_come_true_are_calibrated():
    random = np.random.default_rng(1)
    stated = random.uniform(0, 1, 4000)
    cases = [
        said(str(k), "single", ("sensor_lag",) if random.uniform() < p else ("seal_friction",), "sensor_lag",
             probability={"sensor_lag": float(p)})
        for k, p in enumerate(stated)
    ]  # fmt: skip
    assert scoring.calibration(cases)[1] < 0.02
    wrong = [replace(o, probability={"sensor_lag": 1 - o.probability["sensor_lag"]}) for o in cases]
    assert scoring.calibration(wrong)[1] > 0.1


def test_a_matrix_of_confusion_holds_every_case_once():
    matrix = confusion(HAND)
    assert sum(sum(row.values()) for row in matrix.values()) == len(HAND)
    for label, row in matrix.items():
        assert sum(row.values()) == sum(o.label == label for o in HAND)
    assert matrix["no_gap"] == {"no_gap": 1, "sensor_lag": 1}
    assert matrix["outside: coil_lag"] == {"sensor_lag": 1, "unknown": 1}
    assert next(iter(matrix)) == "no_gap"


def test_small_gaps_are_scored_apart_and_nulls_with_the_large():
    small = replace(HAND[2], gap_over_floor=2.9)
    large, apart = scoring.split((*HAND[:2], small, HAND[3]))
    assert apart == (small,)
    assert large == (*HAND[:2], HAND[3])


def test_baselines_see_the_records_as_the_fits_do():
    """A recorder spoils three samples, which the diagnosis bridges: what is named is what is named without them."""
    lagging = believed().but(effects={"sensor_lag": {"break_Hz": 250.0}})
    data = only(measured(lagging, scenario(0.5)), ["command_large", "disturbance_large"])
    with Fitters(data, 1) as fitters:
        found = Search(fitters.each(Task(NOTHING, {}))[0], (), 1.0)
    spoilt = []
    for record in data.records:
        moved = record.measured["displacement_m"].copy()
        moved[[200, 450, 750]] += 0.9 * np.abs(moved).max()
        spoilt.append(replace(record, measured={**record.measured, "displacement_m": moved}))
    named = baselines(data, found)
    assert named["largest score"]["chosen"] == ["sensor_lag"]
    assert baselines(replace(data, records=tuple(spoilt)), found) == named
    assert baselines(replace(data, records=()), found) == {}


def test_baselines_are_scored_on_what_they_name():
    given = [replace(o, baselines={"largest score": ("sensor_lag",)}) for o in HAND]
    found = {s.name: (s.count, s.of) for s in scoring.baseline_scores("largest score", given)}
    assert found["single effect named first"] == (1, 3)
    assert found["false alarms"] == (2, 2)
    assert found["one of the pair named first"] == (2, 2)
    assert found["subsystem right, known causes"] == (4, 6)


def test_the_page_and_the_fields_say_the_same():
    setting = {"records": "", "planned": 11, "seed": 1, "seal": "00"}
    told = Scored(HAND, setting)
    page, fields = told.markdown(), told.to_dict()
    assert json.loads(result_text(fields)) == json.loads(json.dumps(fields, allow_nan=False))
    assert "| gap detected | 88.9% |" in page
    assert next(s for s in fields["scores"] if s["name"] == "gap detected")["value"] == pytest.approx(8 / 9, abs=1e-4)
    assert len(fields["cases"]) == len(HAND)


# Closed, parameters


def test_closed_against_exact_records():
    times = np.linspace(0, 1, 2000, endpoint=False)
    wave = np.sin(2 * np.pi * 5 * times)
    predicted = {"a/before": 0.5 * wave, "a/tuned": 0.7 * wave, "a/after": 0.9 * wave}
    found = blindcheck.squares({"a": wave}, predicted)
    assert found == pytest.approx({"before": 0.5**2, "tuned": 0.3**2, "after": 0.1**2})
    assert scoring.closed_by(found) == pytest.approx(1 - 0.1**2 / 0.5**2)
    predicted["a/after"] = np.full(2000, np.nan)  # a loop that diverges explains nothing
    assert scoring.closed_by(blindcheck.squares({"a": wave}, predicted)) == pytest.approx(1 - 1 / 0.5**2)
    assert scoring.closed_by({}) is None


def test_a_gap_that_tolerances_imitate_need_not_be_detected():
    missed = replace(HAND[4], kind="single")
    for left, of in ((1.1, 0), (1.3, 1)):
        found = {s.name: s for s in scoring.scores([replace(missed, left=left)])}
        assert found["gap detected, tolerances cannot imitate it"].of == of


def test_parameters_are_compared_only_where_they_mean_the_same():
    answer = {"parameters": {"sensor_lag": {"break_Hz": 200.0, "order": 2.0}}}
    causes = {"sensor_lag": {"parameters": {"break_Hz": {"value": 210.0}}}}
    assert scoring._parameter_error("sensor_lag", answer, causes) is None
    answer["parameters"]["sensor_lag"]["order"] = 1.0
    assert scoring._parameter_error("sensor_lag", answer, causes) == pytest.approx(0.05)
    assert scoring._parameter_error("seal_friction", answer, causes) is None


# Baselines' own algebra


def test_the_lasso_solves_its_conditions():
    """Subgradient conditions (R. Tibshirani, 1996): equal to the penalty where active, not above it elsewhere."""
    random = np.random.default_rng(2)
    a, b = random.normal(size=(40, 12)), random.normal(size=40)
    gram, slope = a.T @ a, a.T @ b
    w = lasso(gram, slope, 3.0)
    left = slope - gram @ w
    active = w != 0
    assert 0 < active.sum() < 12
    assert left[active] == pytest.approx(3.0 * np.sign(w[active]), abs=1e-5)
    assert np.all(np.abs(left[~active]) <= 3.0)
    # On orthogonal columns it is the soft threshold of each by itself.
    assert lasso(np.eye(3), np.array([5.0, -2.0, 0.5]), 1.0) == pytest.approx([4.0, -1.0, 0.0])


def test_the_path_brings_in_the_strongest_first():
    active = list(lasso_path(np.eye(3), np.array([1.0, -4.0, 2.0])))
    assert active[0] == [1]
    assert active[-1] == [0, 1, 2]


# A check in small

FIVE = tuple(
    Planned(number, kind, names, seed, rig)
    for number, (seed, kind, names, rig) in enumerate(
        [
            (30, "null", (), "ball_screw"),
            (33, "single", ("transport_delay",), "arm"),
            (32, "outside", ("coil_lag",), "lag"),
            (34, "parameter", ("parameter:flow_gain",), "lag"),
            (36, "pair", ("transport_delay", "unequal_piston_areas"), "lag"),
        ]
    )
)
"""Every kind of case, both actuators, a payload 0.15 m off the axis of an arm, and every cause that `FEW` can name, one
of them only in a pair."""
FEW = ("transport_delay", "unequal_piston_areas", "parameter:flow_gain")
"""The only candidates of the diagnoses below, one at a time; a real one tries every effect, every figure and pairs."""


@pytest.fixture(scope="module")
def checked(made_once, tmp_path_factory):
    """Five cases, drawn, sealed and diagnosed with few candidates: made once, and copied by who reads them."""
    from beamdesign.diagnosis import diagnose as diagnosing
    from beamdesign.diagnosis import second_look as looking
    from beamdesign.diagnosis import separability
    from beamdesign.diagnosis.fitting import search as searching
    from beamdesign.diagnosis.fitting.hypothesis import singles

    def few(prototype):
        return tuple(each for each in singles(prototype) if str(each) in FEW)

    def make(folder):
        check = blindcheck.begin_check(folder, len(FIVE), 0, True, FIVE)
        seal = blindcheck.draw_and_seal(check, 1)
        assert all(diagnose_blind(check.place(key), now) for key in seal.sets)

    now, folder = program(), tmp_path_factory.mktemp("check") / "five"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(blindcheck, "_processes", _here)
        patch.setattr(case_plan, "draw", _drawn)
        for room in (searching, separability):
            patch.setattr(room, "singles", few)
        patch.setattr(searching, "_two_at_once", lambda fitters, state, progress: list(state.fits))
        patch.setattr(looking, "backlash_impacts", lambda *given: None)  # play is none of the few
        for longer in ("channels_in_time", "what_passed", "learn", "next_experiment"):  # have tests of their own
            patch.setattr(diagnosing, longer, lambda *given: None)
        shutil.copytree(made_once("five_blind_cases", make), folder)
        yield blindcheck.begin_check(folder, len(FIVE), 0, True, FIVE), now


def _drawn(planned, *given):
    """Three short records, with and without payload and by both inputs; five where a figure is too little wrong."""
    with pytest.MonkeyPatch.context() as patch:
        if planned.kind != "parameter":
            patch.setattr(drawing, "_SHORT", (1, 3, 5))
        return draw(planned, *given)


class _Here:
    """Work done in this process: what it takes to compile is paid once for all tests."""

    def submit(self, work, *given):
        from concurrent.futures import Future

        future = Future()
        future.set_result(work(*given))
        return future


def _here(*_):
    from contextlib import nullcontext

    return nullcontext(_Here())


def test_five_cases_from_drawing_to_scores(checked):
    check, _ = checked
    found = blindcheck.open_all(check)
    assert [(o.kind, set(o.effects)) for o in found] == [(c.kind, set(c.names)) for c in FIVE]
    assert [o.key for o in found if o.verdict == "failed"] == []
    matrix = confusion(found)
    assert sum(sum(row.values()) for row in matrix.values()) == 5
    counted = {s.name: (s.count, s.of) for s in scoring.scores(found)}
    assert counted["gap detected"][1] == 4
    assert counted["single effect in the class"] == (1, 1)  # of three candidates, with the truth among them
    for o in found:
        assert set(o.baselines) == {"largest score", "greedy BIC", "sparse regression"}
        assert o.seconds is not None
        if o.verdict != "unknown":
            assert o.closed_truly is not None
            assert o.closed_truly <= 1.0
    # What a right diagnosis closes, measured on noisy records, it closes on the noise-free rig as well.
    told = [abs(o.closed - o.closed_truly) for o in found if o.kind == "single" and o.verdict == "effect"]
    assert np.median(told) < 0.05


def test_a_check_that_is_finished_is_scored_and_written_by_the_public_function(checked, monkeypatch):
    check, _ = checked
    monkeypatch.setattr(case_plan, "plan", lambda count, seed: FIVE)
    found = blindcheck.blindcheck(check.folder, len(FIVE), 0, short=True, workers=1)
    assert (found.yes, len(found.outcomes)) == (True, len(FIVE))
    held = json.loads((check.folder / "result.json").read_text(encoding="utf-8"))
    assert held == json.loads(json.dumps(found.to_dict()))
    assert held["setting"]["seal"] == read_seal(check.seal).whole
    assert [name for name, *_ in found.rows()] == [score["name"] for score in held["scores"]]
    assert (check.folder / "result.md").is_file()
    assert (check.folder / "result.svg").is_file()


def test_what_is_finished_is_not_done_again(checked):
    check, now = checked
    place = check.place("0001")
    before = place.result.stat().st_mtime_ns
    assert diagnose_blind(place, now) is False
    assert place.result.stat().st_mtime_ns == before
    # A judgement that has changed is made anew, on the fits that are there.
    assert diagnose_blind(place, now | {"judged_by": "another"}) is True
    again = json.loads(place.result.read_text())
    assert again["fits_made"] == 0
    assert again["judged_by"] == "another"
    assert again["time"]["cpu_seconds"] > 0
    # Another program fits anew, unless it is told to judge what an earlier one has fitted.
    assert diagnose_blind(place, now | {"fitted_by": "another", "judged_by": "third"}, rejudge=True) is True
    assert json.loads(place.result.read_text())["fitted_by"] == now["fitted_by"]
    assert blindcheck.draw_and_seal(check) == read_seal(check.seal)


def test_a_folder_keeps_to_its_check(checked):
    check, _ = checked
    assert blindcheck.begin_check(check.folder, len(FIVE), 0, True, FIVE) == check
    with pytest.raises(InputError, match="another check"):
        blindcheck.begin_check(check.folder, len(FIVE), 1, True, FIVE)


def test_cases_that_are_finished_can_be_scored_before_the_others(checked):
    check, _ = checked
    place = check.place("0003")
    away = place.result.with_suffix(".away")
    place.result.rename(away)
    try:
        with pytest.raises(InputError, match="0003: not diagnosed"):
            blindcheck.open_all(check)
        opened = [case.key for case in blindcheck.open_all(check, unfinished=True)]
        assert opened == [f"{number:04d}" for number in range(len(FIVE)) if number != 3]
    finally:
        away.rename(place.result)


def test_an_answer_that_was_changed_is_not_scored(checked):
    check, _ = checked
    path = check.answers / "0000.json"
    held = path.read_text()
    path.write_text(held.replace("no_gap", "sensor_lag"))
    try:
        with pytest.raises(InputError, match="0000: the answer is not the one that was sealed"):
            blindcheck.open_all(check)
    finally:
        path.write_text(held)
    assert os.path.exists(check.seal)


def test_a_case_that_breaks_off_names_no_folder_of_who_ran_it(tmp_path: Path) -> None:
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "dataset.toml").write_text("name = 1\n")
    place = Place(tmp_path / "set", tmp_path / "found.json", tmp_path / "predictions.npz", tmp_path / "fits")
    assert diagnose_blind(place, program())
    failed = json.loads(place.result.read_text())["failed"]
    assert failed.startswith("InputError: dataset.toml: ")
    assert str(tmp_path) not in failed
