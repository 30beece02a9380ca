"""The next experiment: what it promises against closed forms, and whether doing it keeps the promise."""

from dataclasses import replace

import numpy as np
import pytest
from gap_sets import believed, measured, scenario
from scipy.optimize import brentq

from beamdesign.diagnosis.experiment import (
    Experiment,
    _Foreseen,
    _grown,
    _jobs,
    _joined,
    _repeats,
    _shortened,
    _without_retuning,
    distance,
    next_experiment,
    reached,
)
from beamdesign.diagnosis.experiment_menu import information, menu
from beamdesign.diagnosis.fitting.evidence import evidence_of
from beamdesign.diagnosis.fitting.fit import Fit, fit
from beamdesign.diagnosis.fitting.hypothesis import together
from beamdesign.diagnosis.fitting.replay import Replay
from beamdesign.diagnosis.fitting.starts import starts
from beamdesign.records import parse
from beamdesign.scenario import Measurement, Scenario, ScenarioRecord, Sine
from beamdesign.time_limit import left_out, within

TRUTH, RIVAL = "sensor_lag", "transport_delay"


def fitted(name, data, known=None):
    hypothesis = together(name)
    placement = hypothesis.placement(data.prototype)
    evidence = evidence_of(data)
    begun = starts(placement, known or {}, evidence, 1)
    return fit(hypothesis, placement, evidence, begun[0])


@pytest.fixture(scope="module")
def rig():
    return believed().but(effects={TRUTH: {"break_Hz": 120.0}})


@pytest.fixture(scope="module")
def slow(rig):
    """Commands and forces below 20 Hz: they show that something lags, not what."""
    plan = scenario()
    rows = [row.but(input=(row.input[0].but(low_Hz=1.0, high_Hz=20.0),)) for row in (plan.record[1], plan.record[3])]
    return measured(rig, plan.but(record=tuple(rows)))


def test_distance_between_lines_has_its_closed_form():
    """A difference of 3 along a direction that unit prior may move by k leaves 3 / sqrt(1 + k^2)."""
    free = np.array([[2.0], [0.0]])
    assert distance(np.array([3.0, 0.0]), free) == pytest.approx(3 / np.sqrt(5), rel=1e-12)
    assert distance(np.array([0.0, 3.0]), free) == pytest.approx(3.0, rel=1e-12)


@pytest.mark.parametrize(("difference", "free"), [(1e200, 1.0), (1.0, 1e200), (np.nan, 1.0), (1.0, np.inf)])
def test_a_prediction_on_the_way_to_diverge_tells_nothing(difference: float, free: float):
    """As that of a joint which hammers, by a law that none of its records bears out. No warning either."""
    assert distance(np.array([difference, 0.0]), np.array([[free], [0.0]])) == 0.0


def test_doing_what_is_proposed_separates_the_rivals(rig, slow):
    """Carried out on the rig of one rival, the proposed record leaves the other with a misfit near the promise."""
    rivals = [fitted(TRUTH, slow), fitted(RIVAL, slow)]
    before = rivals[1].cost - rivals[0].cost
    proposed = next_experiment(slow, rivals, (0.5, 0.5))
    assert proposed is not None
    assert proposed.separates == (TRUTH, RIVAL)
    assert proposed.separation > np.sqrt(max(before, 0.0)) + 2.0  # more than all that was measured so far
    assert "units of misfit" in proposed.text
    assert 0.8 < proposed.information_bits <= 1.0
    assert list(proposed.series["next"]) == [
        "t_s",
        "disturbance_N",
        "command_V",
        f"displacement_m if {TRUTH}",
        f"displacement_m if {RIVAL}",
    ]
    plan = parse(Scenario, dict(proposed.settings["scenario"]), "next").but(
        measurement=Measurement(seed=9, disturbance_std_N=0.5, current_std_A=2e-5, displacement_std_m=5e-7)
    )
    assert not proposed.settings["added_sensor"]  # this rig records no further channel
    both = replace(slow, records=slow.records + measured(rig, plan).records)
    after = fitted(RIVAL, both, rivals[1].values).cost - fitted(TRUTH, both, rivals[0].values).cost
    assert after - before > 0.5 * proposed.separation**2


def test_a_record_to_take_is_told_with_its_loop_and_what_is_beyond_the_rig(slow):
    """Of the same law and payload with another mass inside a loop need not be stable."""
    light = slow.prototype.but(payload=slow.prototype.payload.but(outer_end_mass_kg=(0.0, 5.0)))
    for one in menu(replace(slow, prototype=light)):
        (row,) = one.scenario.record
        law, outer = row.controller, row.outer_end_mass_kg
        loop = f"lag {law.pole_Hz:.4g}/{law.zero_Hz:.4g} Hz at {1e3 * law.gain_A_per_V:.4g} mA/V"
        assert one.text.endswith(f"{loop}, {row.inner_end_mass_kg:.3g} kg inside")
        assert ("more than the 5 kg that the prototype is stated for" in one.text) is (outer > 5.0)


def test_beyond_what_was_recorded_an_experiment_has_to_tell_more(slow):
    """Of two of the same that tell alike, the one within the largest input so far: there the rig is known."""
    largest = {"amplitude_V": 1, "amplitude_N": 0}
    seen = {key: max(np.abs(r.inputs[:, column]).max() for r in slow.records) for key, column in largest.items()}
    efforts: dict[tuple[object, ...], dict[bool, set[float]]] = {}
    for one in menu(slow):
        (row,) = one.scenario.record
        given = row.input[0].model_dump(exclude_none=True)
        (key,) = (name for name in largest if name in given)
        alike = key, row.controller.model_dump_json(), row.outer_end_mass_kg, row.inner_end_mass_kg
        beyond = given[key] > 1.1 * seen[key]  # a peak has two digits
        efforts.setdefault(alike, {}).setdefault(beyond, set()).add(one.effort)
    for one in efforts.values():
        assert {*one} == {False, True}
        assert max(one[False]) < min(one[True])


def test_no_record_is_proposed_that_asks_for_more_pressure_than_any_so_far(slow):
    """A mode that rings makes more of it than of displacement: a model without a supply finds tens of megapascals."""
    rivals = [fitted(TRUTH, slow), fitted(RIVAL, slow)]
    most, placement = reached(slow, rivals[0]), rivals[0].hypothesis.placement(slow.prototype)
    runs = [Replay(record, slow.prototype) for record in slow.records]
    pressures = [run.simulated(placement, rivals[0].z, ("load_pressure_Pa",)) for run in runs]
    assert most[0] == max(np.abs(pressure).max() for pressure in pressures)
    one = next(one for one in menu(slow) if one.effort > 1.0 and _without_retuning(slow, one, rivals) is not None)
    (job,) = _jobs(slow.prototype, one.scenario)
    own = np.abs(job.simulated(placement, rivals[0].z, ("load_pressure_Pa",))).max()
    bounds = np.full(len(most), np.inf)
    for share, proposed in ((1.01, True), (0.99, False)):
        bounds[0] = share * own
        assert (_without_retuning(slow, one, rivals, bounds) is not None) is proposed


def foreseen(*separations: float) -> list[_Foreseen]:
    """Records by which two rivals differ by so many units each, with nothing to re-tune."""
    row = ScenarioRecord(name="next", input=(Sine(amplitude_V=0.1, frequency_Hz=1.0),))
    found = []
    for k, one in enumerate(separations):
        plan = Scenario(name="next", duration_s=1.0, sample_s=1e-3, record=(row,))
        values = [np.zeros(1), np.array([one])]
        free, beyond = [np.zeros((1, 0))] * 2, [np.zeros((1, 1))] * 2
        experiment = Experiment((f"record {k}",), plan, causes=((TRUTH,), (RIVAL,)))
        found.append(_Foreseen(experiment, values, free, beyond, 1e9))
    return found


def test_records_are_added_until_they_tell_nearly_all():
    """Separations of several records add up as squares; the largest come first."""
    found = _grown(foreseen(1.0, 2.0, 1.5, 0.0), (0.5, 0.5))
    assert found.texts == ("record 1", "record 2", "record 0")
    assert found.between[0, 1] == pytest.approx(np.sqrt(1.0 + 4.0 + 2.25))
    assert [row.name for row in found.scenario.record] == ["next", "next_2", "next_3"]
    assert found.text.startswith("3 records of 1 s: (1) record 1; (2) record 2;")
    assert _grown(foreseen(9.0, 9.0), (0.5, 0.5)).texts == ("record 0",)
    assert len(_grown(foreseen(*[0.8] * 9), (0.5, 0.5)).texts) == 8


def test_a_record_that_settles_what_the_best_leaves_open_is_taken_beside_it():
    """3 along what may be moved by 2 leaves 9 / 5; another record says nothing but where that is, to a tenth."""
    best, other = foreseen(3.0, 0.0)
    told = [np.full((1, 1), 2.0)] * 2, [np.full((1, 1), 20.0)] * 2
    records = [one._replace(free=free) for one, free in zip((best, other), told, strict=True)]
    found = _grown(records, (0.5, 0.5))
    assert {*found.texts[:2]} == {"record 0", "record 1"}
    assert _joined(records).between[0, 1] ** 2 == pytest.approx(9 - 36 / (1 + 4 + 400))


def test_records_are_shortened_without_a_loss():
    """By coordinates in the space that they span; what is on the way to diverge is left as it is."""
    random = np.random.default_rng(0)
    values, free = [*random.standard_normal((2, 500))], [random.standard_normal((500, k)) for k in (3, 4)]
    beyond = [random.standard_normal((2, 500)) for _ in range(2)]
    short = _shortened(values, free, beyond)
    assert len(short[0][0]) == 2 + 7 + 4
    (whole,) = foreseen(1.0)
    at = [whole._replace(values=v, free=f, beyond=b, noise=500.0) for v, f, b in ((values, free, beyond), short)]
    assert _joined(at[:1]).between == pytest.approx(_joined(at[1:]).between, rel=1e-9)
    values[0] = 1e200 * values[0]
    assert _shortened(values, free, beyond) == (values, free, beyond)


@pytest.mark.parametrize(("apart", "unclear"), [(9.0, False), (1.0, True)])
def test_a_cause_beside_one_of_two_that_are_told_apart_leaves_nothing_unclear(slow, monkeypatch, apart, unclear):
    """It may always be nothing, so that no record separates it from the one alone; but it is no rival to speak of."""
    between = np.array([[0.0, apart, 0.0], [apart, 0.0, apart], [0.0, apart, 0.0]])
    rivals = [Fit(together(TRUTH)), Fit(together(RIVAL)), Fit(together(TRUTH, "seal_friction"))]
    causes = tuple(fit.hypothesis.causes for fit in rivals)
    best = replace(foreseen(1.0)[0].experiment, between=between, causes=causes)
    row = best.scenario.record[0].but(
        controller=slow.records[0].controller, outer_end_mass_kg=0.0, inner_end_mass_kg=0.0
    )
    best = replace(best, scenario=best.scenario.but(record=(row,)))
    monkeypatch.setattr("beamdesign.diagnosis.experiment.experiments", lambda *_: [best])
    monkeypatch.setattr("beamdesign.diagnosis.experiment._series", lambda *_: {})
    found = next_experiment(slow, rivals, (0.7, 0.3, 0.0))
    assert ("none of the experiments tried separates them clearly" in found.text) is unclear


def test_figures_are_retuned_to_all_records_at_once():
    """What one record leaves open another one settles: 3 along a direction of each, free by k in both alike."""
    first, second = foreseen(3.0, 0.0)
    free = [np.full((1, 1), 2.0), np.full((1, 1), 2.0)]
    both = _joined([first._replace(free=free), second._replace(free=free)])
    assert both.between[0, 1] == pytest.approx(np.sqrt(9.0 - 36.0 / 9.0))


@pytest.mark.parametrize(("off", "left"), [(0.0, 9.0), (1.0, 4.0 - 1.0), (1.5, 0.0), (200.0, 0.0)])
def test_what_the_right_rival_leaves_separates_it_from_none(off: float, left: float):
    """Motions 3 apart, off by as much more than derivatives say: the right rival leaves off^2, the other (3 - off)^2.

    As much as noise leaves is taken for something unknown with 1 / (1 + 2.5^4), twice that with 1 / (1 + 1.25^4).
    """
    (one,) = foreseen(3.0)
    found = _joined([one._replace(beyond=[np.array([[off], [-off]])] * 2, noise=off**2 or 1.0)])
    known = (1 - 1 / (1 + 1.25**4)) / (1 - 1 / (1 + 2.5**4)) if off else 1.0
    assert found.between[0, 1] ** 2 == pytest.approx(left * known, abs=1e-12)


def test_a_loop_that_rings_on_is_not_predicted_by_figures_that_are_known_by_half(slow):
    """Of hardly any damping a standard deviation leaves none, or twice as much; a hundredth of it hardly matters."""
    rival = fitted(RIVAL, slow)
    one = next(one for one in menu(slow) if one.scenario.record[0].input[0].kind == "load_steps")
    (job,), placement = _jobs(slow.prototype, one.scenario), rival.hypothesis.placement(slow.prototype)
    step = np.array([unknown.name == "flow_gain" for unknown in placement.unknowns], dtype=float)
    edge = brentq(lambda by: 2.0 * job.grows(placement, rival.z + by * step) - 1, 0.0, 40.0, xtol=1e-3)
    ringing = replace(rival, z=rival.z + (edge - 0.02) * step)
    sharp = tuple(replace(share, a=1e4 * (share.a + np.eye(len(step)))) for share in ringing.shares)
    assert _repeats(slow, one, rival)
    assert not _repeats(slow, one, ringing)
    assert _repeats(slow, one, replace(ringing, shares=sharp))


def test_no_record_is_proposed_of_which_rivals_disagree_whether_the_loop_is_stable(slow):
    """Little damping is left or none: what the rest of a rig does to that tells more than which rival it is."""
    steady, rival = fitted(TRUTH, slow), fitted(RIVAL, slow)
    one = next(one for one in menu(slow) if one.scenario.record[0].input[0].kind == "load_steps")
    (job,), placement = _jobs(slow.prototype, one.scenario), rival.hypothesis.placement(slow.prototype)
    k = [unknown.name for unknown in placement.unknowns].index("flow_gain")

    def louder(by: float) -> np.ndarray:
        return rival.z + by * np.eye(len(rival.z))[k]

    edge = brentq(lambda by: 2.0 * job.grows(placement, louder(by)) - 1, 0.0, 40.0, xtol=1e-3)
    growing = replace(rival, z=louder(edge + 0.02))
    moved = [job.simulated(placement, z, ("displacement_m",)) for z in (louder(edge - 0.5), growing.z)]
    late, whole = ([np.abs(y[since:]).max() for y in moved] for since in (-800, 0))
    assert late[0] < 0.05 * whole[0]
    assert late[1] > 0.3 * whole[1]  # simulated: it rings on, where nothing has acted for long
    assert _without_retuning(slow, one, [steady, growing]) is None
    for agreed in ([steady, rival], [growing, growing]):
        assert _without_retuning(slow, one, agreed) is not None


def test_one_rival_alone_needs_no_experiment(slow):
    assert next_experiment(slow, [fitted(TRUTH, slow)], [1.0]) is None


def test_information_is_that_of_its_limits():
    """All of the entropy where rivals are far apart, none where they are one; a bound of two in closed form between."""
    far = np.where(np.eye(3), 0.0, 1e3)
    p = np.array([0.5, 0.3, 0.2])
    assert information(far, p) == pytest.approx(-p @ np.log2(p))
    assert information(np.zeros((3, 3)), p) == pytest.approx(0.0, abs=1e-12)
    near = np.array([[0.0, 2.0], [2.0, 0.0]])
    assert information(near, (1.0, 1.0)) == pytest.approx(1 - np.log2(1 + np.exp(-0.5)))


def test_which_law_of_a_cause_it_is_tells_nothing_of_the_cause():
    """All of the entropy of causes where all laws are far apart, none where laws of one cause are alone told apart."""
    p, causes = (0.5, 0.3, 0.2), ("delay", "lag", "lag")
    far = np.where(np.eye(3), 0.0, 1e3)
    assert information(far, p, causes) == pytest.approx(1.0)
    alike = np.array([[0.0, 0.0, 1e3], [0.0, 0.0, 1e3], [1e3, 1e3, 0.0]])  # the second lag takes the delay's place
    # told: whether it is that law; if not, a delay of 5 to 3, of which 8 in 10 are left
    assert information(alike, p, causes) == pytest.approx(1.0 - 0.8 * entropy(5 / 8))
    assert information(np.where(np.eye(3), 0.0, 1e3) * [[0, 0, 0], [0, 0, 1], [0, 1, 0]], p, causes) == 0.0


def entropy(p: float) -> float:
    """Of two, bits."""
    return float(-p * np.log2(p) - (1 - p) * np.log2(1 - p))


def test_no_bound_is_more_than_the_information_itself():
    """Two unit Gaussians two standard deviations apart, by quadrature: I = h(mixture) - h(unit)."""
    y = np.linspace(-12, 14, 200_001)
    mixture = (np.exp(-(y**2) / 2) + np.exp(-((y - 2) ** 2) / 2)) / np.sqrt(8 * np.pi)
    entropy = -np.trapezoid(mixture * np.log2(mixture), y)
    exact = entropy - 0.5 * np.log2(2 * np.pi * np.e)
    bound = information(np.array([[0.0, 2.0], [2.0, 0.0]]), (0.5, 0.5))
    assert 0.6 * exact < bound < exact


def test_what_the_prototype_itself_does_not_predict_is_not_proposed(slow):
    """Rivals are stable, being fitted; the prototype, with eight times their flow gain, is not: no fit begins there."""
    rivals = [fitted(TRUTH, slow), fitted(RIVAL, slow)]
    assert next_experiment(slow, rivals, (0.5, 0.5)) is not None
    with within(0.0):
        assert next_experiment(slow, rivals, (0.5, 0.5)) is None
        assert left_out() == ("what to measure next",)
    valve = slow.prototype.servovalve
    wild = slow.prototype.but(servovalve=valve.but(flow_gain_m3_per_s_per_A=8 * valve.flow_gain_m3_per_s_per_A))
    moved = []
    for one in rivals:
        placed = one.hypothesis.placement(wild)
        (k,) = [k for k, unknown in enumerate(placed.unknowns) if unknown.name == "flow_gain"]
        z = one.z.copy()
        z[k] = -np.log(8) / placed.unknowns[k].spread
        assert placed.unknowns[k].value(z[k]) == pytest.approx(valve.flow_gain_m3_per_s_per_A, rel=0.01)
        moved.append(replace(one, z=z))
    assert next_experiment(replace(slow, prototype=wild), moved, (0.5, 0.5)) is None
