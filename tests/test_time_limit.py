"""Answers in time: clocks are made here, so that nothing depends on how fast a computer is."""

import json
import re
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import count
from multiprocessing import active_children, get_context
from pathlib import Path
from time import sleep

import pytest
from gap_sets import believed, measured, only, scenario
from typer.testing import CliRunner

from beamdesign import (
    InputError,
    Prototype,
    certify,
    certify_box,
    check,
    codesign,
    diagnose,
    front,
    read_problem,
    read_prototype,
    remedies,
    run_design,
    stiffness,
    tune,
)
from beamdesign.cli import app
from beamdesign.controllers import Lag
from beamdesign.diagnosis import separability
from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.diagnose import _beside
from beamdesign.diagnosis.fitting import fitters
from beamdesign.diagnosis.fitting import search as searching
from beamdesign.diagnosis.fitting.fit_cache import Task, fit_cache
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, Hypothesis, singles
from beamdesign.diagnosis.fitting.search import Search
from beamdesign.progress import silent
from beamdesign.proofs.certificate import Asked
from beamdesign.synthesis import law_search
from beamdesign.synthesis.codesign import sized_search
from beamdesign.synthesis.free_search import sizes_of, start_variables
from beamdesign.synthesis.law_search import Found
from beamdesign.synthesis.law_starts import from_seeds
from beamdesign.synthesis.loop_samples import Design
from beamdesign.synthesis.sections import Sections
from beamdesign.time_limit import TimeUp, heed, is_limited, leave_out, left, over, share, while_time, within

STUDIES = Path(__file__).parents[1] / "studies"


def ticking(step: float = 60.0) -> Callable[[], float]:
    """A clock that is asked: each time it has gone on by so many seconds."""
    times = count()
    return lambda: step * next(times)


def test_work_goes_on_as_long_as_there_is_time_and_says_what_it_left():
    now = [0.0]
    with within(1.0, lambda: now[0]) as limit:
        done = []
        for item in while_time("abcd"):
            done.append(item)
            now[0] += 25.0
        assert done == ["a", "b", "c"]  # begun at 0, 25 and 50 s
        assert over()
        assert list(while_time("xy", least=1)) == ["x"]
    assert limit.left_out == ["d", "y"]
    assert not is_limited()
    assert list(while_time("abcd")) == [*"abcd"]


def test_a_limit_within_another_is_never_later_and_a_share_is_of_what_is_left():
    now = [0.0]
    with within(1.0, lambda: now[0]) as outer:
        now[0] = 20.0
        with share(0.5):
            assert left() == 20.0
            with within(5.0) as inner:
                assert left() == 20.0
                leave_out("a")
                leave_out("a", "b")
            assert inner.left_out == ["a", "b"]
        with within(0.25):
            assert left() == 15.0
        assert left() == 40.0
    assert outer.left_out == ["a", "b"]


def test_only_who_may_be_broken_off_is():
    with within(0.0):
        heed()
        with share(1.0, within_steps=True), pytest.raises(TimeUp):
            heed()
    with share(0.1, within_steps=True):  # of no limit there is no share that ends
        heed()


FEW = (
    "sensor_lag", "transport_delay", "mount_compliance", "valve_deadband", "parameter:flow_gain",
    "parameter:sensor_gain",
)  # fmt: skip


@pytest.fixture(scope="module")
def slow() -> Dataset:
    """Two short records of a rig whose sensor lags."""
    rig = believed().but(effects={"sensor_lag": {"break_Hz": 120.0}})
    return only(measured(rig, scenario(0.4)), ("command_small", "disturbance_small"))


def test_processes_that_were_begun_within_a_look_outlive_its_time(slow: Dataset):
    """They are forked where the first fits are asked for, with whatever limit holds there."""
    begin = {"initializer": fitters._begin, "initargs": (slow, False)}
    with within(0.0), share(1.0, within_steps=True), ProcessPoolExecutor(1, get_context("fork"), **begin) as pool:
        found = pool.submit(fitters._fitted_here, Task(NOTHING, {})).result()
        with pytest.raises(TimeUp):
            heed()
    assert found.hypothesis == NOTHING
    assert not found.reason


def test_what_is_begun_beside_is_waited_for_as_long_as_there_is_time():
    """In processes of their own, which end with the block; with one worker it is done where it is asked for."""
    for workers in (1, 2):
        with within(1.0), _beside(workers) as begun:
            assert begun(pow, 2, 10)() == 1024
    before = active_children()
    with within(1e-3, lambda: 0.0), _beside(2) as begun:
        endless = begun(sleep, 1e6)
        with pytest.raises(TimeUp):
            endless()
        assert active_children() != before
    assert active_children() == before
    with within(0.0), _beside(1) as begun, pytest.raises(TimeUp):
        begun(pow, 2, 10)()


def test_a_diagnosis_without_time_is_sure_of_nothing(slow: Dataset):
    found = diagnose(slow, workers=1, minutes=0.0)
    assert found.verdict == "unknown"
    assert found.search is not None
    assert found.search.fits == ()
    assert {"sensor_lag", "entrained_air"} <= set(found.left_out)
    assert found.to_dict()["complete"] is False
    assert "Not everything was compared" in found.sentences
    assert "is known here" not in found.sentences


def test_a_diagnosis_that_is_called_again_goes_on_and_comes_to_the_same(
    slow: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """The verdict is no surer than what was compared, though the right cause is there long before the others.

    Of few causes, so that it takes less time; and of less time by as much.
    """
    for room in (searching, separability):
        monkeypatch.setattr(room, "singles", lambda prototype: tuple(h for h in singles(prototype) if str(h) in FEW))
    kept, verdicts, compared = fit_cache(tmp_path, slow), [], [0]
    for _ in range(60):
        with within(1.0, ticking(1 / 12)):
            found = diagnose(slow, workers=1, kept=kept)
        assert found.search is not None
        verdicts.append((found.verdict, found.chosen))
        compared.append(len(found.search.fits))
        assert found.to_dict()["complete"] is not found.left_out
        if not found.left_out:
            break
    assert compared[:-1] == sorted(compared[:-1])  # the last one knows by its looks what need not be fitted
    assert ("ambiguous", ("sensor_lag",)) in verdicts
    whole = diagnose(slow, workers=1)
    assert (whole.verdict, whole.chosen) == ("effect", ("sensor_lag",)) == verdicts[-1]
    assert all(verdict in ("ambiguous", "unknown") for verdict, _ in verdicts[:-1])
    assert whole.search is not None
    assert found.search.fits[0].cost == whole.search.fits[0].cost

    now = [0.0]  # time that is up when all is left but where the gap lies

    def told(_: float, doing: str) -> None:
        now[0] += 100.0 * (doing == "where the gap lies")

    with within(1.0, lambda: now[0]):
        placed = diagnose(slow, workers=1, progress=told, kept=kept)
    assert (placed.verdict, placed.chosen) == ("effect", ("sensor_lag",))
    assert placed.left_out == ("what the records say of the place",)
    assert placed.where.subsystem == "sensor"
    assert len(placed.where.indicators) < len(whole.where.indicators)


def test_what_was_not_looked_at_is_made_up_for_and_no_longer_left_out(slow: Dataset):
    """Of looks at a part those that explain it are fitted to all; what there is no time for again is left out."""
    lag, wide, air = (Hypothesis((name,)) for name in ("sensor_lag", "parameter:flow_gain", "entrained_air"))
    with within(1.0, lambda: 0.0) as limit, fitters.Fitters(slow, 1) as fitting:
        (null,) = fitting([Task(NOTHING, {})])
        (alone,) = fitting([Task(wide, null.values)])
        state = Search(null, (alone,), sum(piece.expected for piece in fitting.evidence))
        fitting.late = [Task(lag, null.values, on=(0,), quick=True), Task(air, null.values)]
        found = searching._made_up_for(fitting, state)
    assert found.fits[0].hypothesis == lag
    assert [len(fit.shares) for fit in found.fits] == [2, 2, 2]
    assert limit.left_out == []
    with within(0.0) as limit, share(1.0, within_steps=True), fitters.Fitters(slow, 1) as fitting:
        fitting.late = [Task(lag, null.values, on=(0,), quick=True), Task(air, null.values)]
        assert searching._made_up_for(fitting, state).fits == (alone,)
    assert limit.left_out == ["sensor_lag", "entrained_air"]


def test_a_stiffness_without_time_is_not_said_not_to_be_had(remedy: Prototype):
    with within(0.0) as limit:
        found = stiffness(remedy, 1e6, (0.0, 2.0), rigs=0)
    assert (found.best, found.tried) == (None, 0)
    assert limit.left_out == ["further laws"]


def test_every_remedy_has_its_share_of_the_time():
    """Without time each is begun with, and what is not proved says so."""
    problem = read_problem(STUDIES / "codesign.toml").but(controller={"kind": "lag"})
    with within(0.0) as limit:
        found = remedies(problem, (0.0, 2.0), 4.5, sigmas=0.0)
    assert len(found) == 5
    assert all(one.reason or one.proved for one in found)
    assert all(one.yes is bool(one.proved) for one in found)
    assert [one.to_dict()["remedy"] for one in found] == [one.name for one in found]
    assert limit.left_out


def test_designs_that_are_worth_nothing_are_none_that_was_left_out():
    """Of two loops that no start brought within the limits a design of 0 Hz was left out."""
    problem = read_problem(STUDIES / "prototype.toml")
    given = start_variables(problem, sizes_of(problem.given))
    task = sized_search(problem, Sections(problem, given, largest_mass_kg=20.0, free=[]), (0.0, 6.8), 0.0, 0.0)
    designs = 2 * [replace(from_seeds(task, Lag.seeds())[0], value=0.0)]
    with within(0.0) as limit:
        found = law_search._best_proved(task, designs, silent, Found(None, (), 0, "none"), 1)
    assert limit.left_out == []
    assert (found.proved, found.reason) == (None, "none")


def test_refining_leaves_time_for_the_proof_of_what_it_refined(monkeypatch: pytest.MonkeyPatch):
    """A law of many figures is refined as long as there is time, and what is not proved then is no answer."""
    problem = read_problem(STUDIES / "prototype.toml")
    given = start_variables(problem, sizes_of(problem.given))
    task = sized_search(problem, Sections(problem, given, largest_mass_kg=20.0, free=[]), (0.0, 6.8), 0.0, 0.0)
    seconds = list[float]()

    def refined(_: object, design: Design, *asked: object, **more: object) -> Design:
        while not over():
            pass
        return design

    def proved(*_: object) -> Found:
        seconds.append(left())
        return Found(None, (), 1, "refuted")

    monkeypatch.setattr(law_search.Search, "refined", refined)
    monkeypatch.setattr(law_search, "_proved", proved)
    design = replace(from_seeds(task, Lag.seeds())[0], value=1.0)
    with within(2.0, ticking(1.0)):
        law_search._best_proved(task, [design], silent, Found(None, (), 0, "none"))
    assert seconds[0] > 30


@pytest.fixture(scope="module")
def remedy() -> Prototype:
    rig = believed()
    return rig.but(payload=rig.payload.but(outer_end_mass_kg=(0.0, 2.0)))


@pytest.mark.usefixtures("one_start")
def test_a_limit_that_is_not_come_to_changes_nothing(remedy: Prototype):
    plain = tune(remedy, (0.0, 2.0), "proportional", sigmas=0.0)
    limited = tune(remedy, (0.0, 2.0), "proportional", sigmas=0.0, minutes=1e4)
    assert limited.left_out == ()
    assert plain.best is not None
    assert limited.best is not None
    assert limited.best.controller == plain.best.controller
    assert limited.best.bandwidth_Hz == plain.best.bandwidth_Hz


def test_without_time_there_is_no_law_and_that_is_the_reason(remedy: Prototype):
    for kind in ("lag", "structured", "lqg", "scheduled"):
        found = tune(remedy, (0.0, 6.8), kind, sigmas=0.0, minutes=0.0)
        assert not found.yes
        assert "in the time given" in found.reason, kind
        assert found.left_out


@pytest.mark.usefixtures("one_start")
def test_of_a_search_that_left_something_out_nothing_else_is_to_be_asked(remedy: Prototype):
    """Its share of the time is over before the whole of it is, and a narrower range is not what it wants."""
    hopeless = remedy.but(goal=remedy.goal.but(compliance_m_per_N=1e-12))
    whole = tune(hopeless, (0.0, 2.0), "proportional", sigmas=0.0)
    cut = tune(hopeless, (0.0, 2.0), "proportional", sigmas=0.0, progress=lambda *_: leave_out("some starts"))
    assert "a narrower range" in whole.reason
    assert "more time may find one" in cut.reason
    assert cut.left_out == ("some starts",)


@pytest.mark.usefixtures("one_start")
def test_what_is_proved_when_the_time_is_up_is_the_answer(remedy: Prototype):
    """A structured law takes minutes with all its sections; its lag alone is there first, and holds by itself."""
    now, proved = [0.0], []

    def report(share_done: float, text: str) -> None:
        if text.startswith("proving"):
            proved.append(text)
        elif proved:
            now[0] = 100.0  # as larger laws are sought

    with within(1.0, lambda: now[0]):
        found = tune(remedy, (0.0, 2.0), "structured", progress=report, sigmas=0.0)
    assert "laws of 2 sections and more" in found.left_out
    assert found.best is not None
    assert found.best.controller.sections == ()
    goal = remedy.goal
    asked = (
        Asked("peak_sensitivity", goal.peak_sensitivity),
        Asked("compliance", goal.compliance_m_per_N, found.best.bandwidth_Hz),
    )
    certificate = certify(found.prototype, 0.0, 2.0, asked)
    assert certificate.holds
    assert check(certificate.text).valid


def test_a_study_without_time_is_refused_with_what_was_left(tmp_path: Path):
    problem = read_problem(STUDIES / "prototype.toml")
    assert problem.payload.outer_end_mass_kg is not None
    for found in (
        run_design(problem, sigmas=0.0, minutes=0.0),
        codesign(problem, problem.payload.outer_end_mass_kg, 3.0, sigmas=0.0, minutes=0.0),
    ):
        assert found.reason
        assert found.left_out
    found = front(problem, (3.0, 4.0), [(0.0, 6.8)], sigmas=0.0, minutes=0.0)
    assert found.proved == ()
    assert found.designs[1].reason == "no time was left for it"
    assert "4 Hz over 0 to 6.8 kg" in found.left_out


@pytest.mark.usefixtures("no_pictures")
def test_figures_without_records_take_their_time_too(tmp_path: Path):
    args = [
        "gap",
        "diagnose",
        str(STUDIES / "gaps" / "paper_gains"),
        "--minutes",
        "0",
        "--out",
        str(tmp_path / "found"),
    ]
    said = CliRunner().invoke(app, args).stderr
    least, most = re.match(r"expected time: (\d+) s to (\d+) s;", said).groups()
    assert 0 < int(least) < int(most)


def test_command_says_how_long_it_takes_and_what_it_left(tmp_path: Path):
    args = ["tune", str(STUDIES / "prototypes" / "paper_remedy.toml"), "--nominal", "--minutes", "0", "--json", "-"]
    ran = CliRunner().invoke(app, args)
    assert ran.exit_code == 1
    answer = json.loads(ran.stdout)
    assert answer["complete"] is False
    assert answer["left_out"]
    assert "in the time given" in answer["reason"]
    said = CliRunner().invoke(app, args[:-2])
    assert said.stderr.startswith("expected time: ")
    assert "--minutes" in said.stderr
    assert "left out: " in said.stdout
    refused = CliRunner().invoke(app, [*args[:-4], "--minutes", "nan"])
    assert isinstance(refused.exception, InputError)


@pytest.mark.parametrize(
    ("up", "proved", "left_out"),
    [
        (1, [], ("stability of the whole box",)),
        (2, [], ("gain margin", "compliance", "peak compliance", "peak sensitivity", "some figures alone")),
        (3, ["gain_margin", "compliance", "peak_compliance", "peak_sensitivity"], ("some figures alone",)),
    ],
)
def test_a_box_has_one_limit_for_all_its_searches_and_keeps_what_they_proved(
    up: int, proved: list[str], left_out: tuple[str, ...]
):
    """The time is up as a step of the whole is begun with, and what was proved before it is checked."""
    rig, now, steps = read_prototype(STUDIES / "prototypes" / "tame_lag.toml"), [0.0], count(1)

    def report(share_done: float, text: str) -> None:
        if next(steps) == up:
            now[0] = 100.0

    with within(None, lambda: now[0]):
        given = {"sigmas": 1.0, "only": ["outer_stiffness", "flow_gain"], "each": True}
        found = certify_box(rig, (0.0, 2.0), seconds=60.0, progress=report, **given)
    assert [claim.asked.kind for claim in found.claims] == proved
    assert found.left_out == left_out
    assert found.to_dict()["complete"] is False
    assert (check(found.text).valid if found.text else found.stable is None) is True
