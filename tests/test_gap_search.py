"""The search over causes: which pairs and threes are tried, by which laws and from where."""

from dataclasses import replace

import numpy as np
import pytest
from gap_sets import believed, measured, scenario

from beamdesign.diagnosis.fitting import search as searching
from beamdesign.diagnosis.fitting.fit import Fit, Share
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, Hypothesis, together
from beamdesign.diagnosis.fitting.search import search
from beamdesign.diagnosis.judgement import judge


def test_pairs_are_tried_with_the_other_laws_of_their_effects():
    """Beside another cause the law may be right that fits worse alone."""
    pair = together("sensor_lag", "current_saturation")
    unknowns = pair.unknowns(believed())
    alone = Hypothesis(("sensor_lag_second_order",))
    tasks = searching._other_laws([Fit(pair, unknowns, np.zeros(len(unknowns)))], {alone: {"a": 1.0}}, "twin_beam")
    hints = {task.hypothesis: task.hints for task in tasks}
    later, soft = (
        together("sensor_lag_second_order", "current_saturation"),
        together("sensor_lag", "current_saturation_soft"),
    )
    assert set(hints) == {later, soft}
    assert (hints[later]["a"], hints[soft].get("a")) == (1.0, None)  # as the law was found alone
    limit = next(u.nominal for u in unknowns if u.name == "current_saturation.limit_A")
    assert hints[soft]["current_saturation_soft.limit_A"] == limit  # and what both laws have, as in the pair
    assert all(task.known["current_saturation.limit_A"] > 0 for task in tasks)


def test_another_law_begins_where_the_usual_one_was_found():
    """What both have in common has one name; of singles whose usual law is not there, nothing is known."""
    hard, soft = Hypothesis(("current_saturation",)), Hypothesis(("current_saturation_soft",))
    later, rough = Hypothesis(("sensor_lag_second_order",)), Hypothesis(("valve_deadband",))
    found = [
        Fit(h, unknowns, np.zeros(len(unknowns)))
        for h in (hard, soft, later, rough)
        for unknowns in (h.unknowns(believed()),)
    ]
    (task,) = searching._as_by_the_usual_law(found, found, found[0])
    assert task.hypothesis == soft
    assert task.hints["current_saturation_soft.limit_A"] == found[0].values["current_saturation.limit_A"]
    assert task.hints["outer_stiffness"] == found[0].values["outer_stiffness"]


def test_rivals_of_a_pairs_causes_take_their_places():
    """A delay explains nearly as much as a lag, friction far less: the delay alone is tried in the lag's place."""
    rig = believed()
    mode, lag, delay, rubs = map(together, ("second_beam_mode", "sensor_lag", "transport_delay", "seal_friction"))
    costs = {mode: 9e3, lag: 5e3, delay: 6e3, rubs: 4e4}
    singles = (Fit(h, h.unknowns(rig), np.zeros(len(h.unknowns(rig))), cost) for h, cost in costs.items())
    state = searching.Search(Fit(NOTHING), tuple(singles), 300.0)
    unknowns = (mode | lag).unknowns(rig)
    tasks = searching._rivals(Fit(mode | lag, unknowns, np.zeros(len(unknowns)), 2e3), state)
    assert {task.hypothesis for task in tasks} == {mode | delay, lag | delay}
    assert searching._rivals(Fit(mode | lag, reason="no fit"), state) == []


def test_three_causes_at_once_are_found_where_two_leave_much(monkeypatch):
    """Each as it was put in; pairs of them leave a per cent of the gap and more."""
    put_in = {
        "sensor_lag": {"break_Hz": 120.0},
        "seal_friction": {"coulomb_N": 60.0},
        "unequal_piston_areas": {"asymmetry": 0.15},
    }
    monkeypatch.setattr(searching, "singles", lambda rig: tuple(map(together, put_in)))
    data = measured(believed().but(effects=put_in), scenario(0.6))
    found = search(replace(data, records=data.records[:4]))
    judged = judge(found)
    assert judged.best.hypothesis.causes == tuple(sorted(put_in))
    assert judged.of_causes[tuple(sorted(put_in))] > 0.9
    assert judged.unknown < 0.05
    for name, table in put_in.items():
        ((key, value),) = table.items()
        assert judged.best.values[f"{name}.{key}"] == pytest.approx(value, rel=0.1)
    two = [found.excess(f) for f in found.fits if len(f.hypothesis.causes) == 2]
    assert min(two) > 0.01 > 5 * found.excess(judged.best)


def test_a_third_cause_is_tried_beside_rivals_of_the_best_two_and_by_other_laws():
    """A lag bent by two causes beats the delay that is there, which leaves nothing with a magnet's hysteresis."""
    limit, lag, delay, rubs, magnet = map(
        together,
        ("current_saturation", "sensor_lag", "transport_delay", "valve_hysteresis", "valve_hysteresis_magnetic"),
    )
    left = {
        NOTHING: 2.2e5,
        limit: 1.0e5,
        lag: 1.2e5,
        delay: 1.3e5,
        rubs: 1.5e5,
        limit | lag: 2.4e3,
        limit | delay: 3.2e3,
    }
    left |= {limit | delay | rubs: 1.5e3, limit | delay | magnet: 310.0, limit | lag | magnet: 900.0}
    data = measured(believed(), scenario(0.1))

    def canned(hypothesis: Hypothesis) -> Fit:
        unknowns = hypothesis.unknowns(data.prototype)
        share = Share(left.get(hypothesis, 5e4), np.zeros(len(unknowns)), np.eye(len(unknowns)))
        return Fit(hypothesis, unknowns, np.zeros(len(unknowns)), share.c, (share,))

    class Canned:
        def __init__(self) -> None:
            self.data = data

        def __call__(self, tasks, progress=None):
            return [canned(task.hypothesis) for task in tasks]

    fits = tuple(canned(h) for h in (limit | lag, limit | delay, limit, lag, delay, rubs))
    state = searching.Search(canned(NOTHING), fits, 300.0)
    found = searching._three_at_once(Canned(), state, lambda share, words: None)
    assert found[0].hypothesis == limit | delay | magnet
    assert limit | lag | magnet in {f.hypothesis for f in found}  # the lag in the delay's place, by the same law


@pytest.mark.parametrize("paired", [False, True])
def test_a_third_cause_begins_as_it_was_found_beside_one_of_the_two(paired: bool):
    """Alone a mount is bent to explain what a limit does; beside the limit it has been found as it is."""
    limit, lag, delay, mount = map(
        together, ("current_saturation", "sensor_lag", "transport_delay", "mount_compliance")
    )
    data, asked = measured(believed(), scenario(0.1)), []
    left = {limit | lag: 2.4e3, limit | delay: 9e3, limit | mount: 2e4}

    def canned(hypothesis: Hypothesis, strength: float = 0.0) -> Fit:
        unknowns = hypothesis.unknowns(data.prototype)
        share = Share(left.get(hypothesis, 5e4), np.zeros(len(unknowns)), np.eye(len(unknowns)))
        return Fit(hypothesis, unknowns, np.full(len(unknowns), strength), share.c, (share,))

    class Canned:
        def __init__(self) -> None:
            self.data = data

        def __call__(self, tasks, progress=None):
            asked.extend(given := list(tasks))
            return [canned(task.hypothesis) for task in given]

    beside = [canned(limit | delay, 0.3), *[canned(limit | mount, 0.5)] * paired]
    fits = (canned(limit | lag, 0.1), *beside, *(canned(h, 2.0) for h in (limit, lag, delay, mount)))
    searching._three_at_once(Canned(), searching.Search(canned(NOTHING), fits, 300.0), lambda share, words: None)
    looks = {task.hypothesis: task for task in asked if task.quick}
    for third, strength in ((delay, 0.3), (mount, 0.5 if paired else 2.0)):
        task = looks[limit | lag | third]
        begun = canned(third, strength).values
        assert {name: task.hints[name] for name in begun if "." in name} == {n: v for n, v in begun.items() if "." in n}
        assert task.known == fits[0].values


def test_a_third_cause_is_not_tried_where_two_explain_the_gap(monkeypatch):
    names = ("sensor_lag", "seal_friction", "unequal_piston_areas")
    monkeypatch.setattr(searching, "singles", lambda rig: tuple(map(together, names)))
    put_in = {"sensor_lag": {"break_Hz": 120.0}, "seal_friction": {"coulomb_N": 60.0}}
    data = measured(believed().but(effects=put_in), scenario(0.6))
    found = search(replace(data, records=data.records[:3]))
    assert max(len(f.hypothesis.causes) for f in found.fits) == 2
    assert judge(found).best.hypothesis.names == ("seal_friction", "sensor_lag")


@pytest.mark.parametrize("oil", [0.0, -6.0])
def test_a_third_cause_is_tried_where_two_explain_the_gap_with_a_figure_strained(oil: float):
    """Air in the oil that two causes lack: the oil's spring stands for it, tolerances away from what it is."""
    limit, mode, air = map(together, ("current_saturation", "second_beam_mode", "entrained_air"))
    data, left = measured(believed(), scenario(0.1)), {limit | mode: 305.0, limit | mode | air: 302.0, NOTHING: 9e3}

    def canned(hypothesis: Hypothesis) -> Fit:
        unknowns = hypothesis.unknowns(data.prototype)
        z = np.array([oil * (u.name == "oil_stiffness") for u in unknowns]) * (hypothesis == limit | mode)
        share = Share(left.get(hypothesis, 5e3), np.zeros(len(unknowns)), np.eye(len(unknowns)))
        return Fit(hypothesis, unknowns, z, share.c + float(z @ z), (share,))

    class Canned:
        def __init__(self) -> None:
            self.data = data

        def __call__(self, tasks, progress=None):
            return [canned(task.hypothesis) for task in tasks]

    state = searching.Search(canned(NOTHING), tuple(map(canned, (limit | mode, limit, mode, air))), 300.0)
    assert state.explained is (oil == 0.0)
    found = searching._three_at_once(Canned(), state, lambda share, words: None)
    assert (limit | mode | air in {f.hypothesis for f in found}) is (oil != 0.0)
    if oil:
        assert found[0].hypothesis == limit | mode | air
        assert not found[0].strained
