"""Laws that are learnt from records: against closed forms, their own elements, and records of a rig that has none."""

from collections.abc import Mapping
from dataclasses import replace
from math import pi

import numpy as np
import pytest
from gap_sets import believed, measured, scenario
from rigs_of_effects import having
from scipy.linalg import eigh
from slow_sensor import SLOW_SENSOR
from test_effects import applied
from test_elements import assert_alike, rig  # noqa: F401

from beamdesign import InputError, Prototype, certify, check, read_dataset
from beamdesign.controllers import Lag
from beamdesign.diagnosis import learning
from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.diagnosis import updated_prototype
from beamdesign.diagnosis.fitting.evidence import evidence_of
from beamdesign.diagnosis.fitting.fit import fit
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, Hypothesis, learnable
from beamdesign.diagnosis.fitting.search import Search
from beamdesign.diagnosis.gap_metrics import held_out
from beamdesign.diagnosis.judgement import causes, judge
from beamdesign.diagnosis.learning import described, learn, within_reach
from beamdesign.diagnosis.passing import Look
from beamdesign.diagnosis.where.locate import kind_of_effect
from beamdesign.loop import loop, member_loop
from beamdesign.plant.assembly import fits
from beamdesign.plant.empirical import curve, laws
from beamdesign.plant.members import family
from beamdesign.polynomial import exact
from beamdesign.proofs.box import certify_box
from beamdesign.proofs.tolerance_box import tolerance_box
from beamdesign.prototype import Tolerance
from beamdesign.validation.truth.case import run_figures, write_case
from beamdesign.validation.truth.drawing import draw_case

PAIR = "stiffness", "mass"
LEARNT = {law.name: law for law in laws()}
PROVED = [name for name, law in LEARNT.items() if law.linear is not None and fits(name, "twin_beam")]
TERMS = {"odd_square": 0.11, "cube": -0.2, "square": 0.07, "one_sided": 0.04}


def some(name: str) -> dict[str, float]:
    """A curve with all of its terms, and the usual parameters of any other law."""
    return TERMS if name.endswith("_curve") else {}


@pytest.mark.parametrize("name", PROVED)
def test_elements_of_a_learnt_law_are_what_it_comes_to(rig: Prototype, name: str):  # noqa: F811
    """What a certificate states of it, polynomial by polynomial in rationals; beside a mount, which moves the base."""
    assert_alike(rig.but(effects={name: some(name)}))
    assert_alike(rig.but(effects={name: some(name), "mount_compliance": {}}))


@pytest.mark.parametrize(
    "names",
    [
        ("empirical_inner_reaction_lag", "empirical_outer_reaction_lag"),
        ("empirical_inner_force_appendage", "empirical_outer_force_appendage"),
        ("empirical_inner_force_appendage", "joint_backlash"),
    ],
    ids="-".join,
)
def test_laws_at_both_beams_and_behind_a_joint_move_by_themselves(rig: Prototype, names: tuple[str, str]):  # noqa: F811
    """What swings on one tip is not what swings on the other, and pushes that tip and not the rod before its joint."""
    assert_alike(rig.but(effects={name: {} for name in names}))


def test_a_beam_that_stiffens_late_is_proved_again(rig: Prototype):  # noqa: F811
    """Its elements have a negative spring: their determinant is the rig's, times a negative number."""
    law = Lag(gain_A_per_V=0.05, pole_Hz=1.75, zero_Hz=26.0)
    late = rig.but(controller=law, effects={"empirical_inner_reaction_lag": {"share": -0.2, "break_Hz": 60.0}})
    found = certify(late, 2.0, 2.5)
    assert found.stable
    assert check(found.text).valid
    box = certify_box(late, tolerance_box(late.but(tolerance=Tolerance(flow_gain=0.02)), 1.0, None, (2.0, 2.1)))
    assert box.stable
    assert check(box.certificate).valid


def test_no_gain_stands_for_what_a_drive_does_to_its_own_speed_feedback(rig: Prototype):  # noqa: F811
    for kind in ("curve", "drift", "lag"):
        name = f"empirical_motor_demand_{kind}"
        with pytest.raises(InputError, match="no linear loop stands for this effect"):
            family(having(rig, name).but(effects={name: {}}))


@pytest.mark.parametrize("name", ["empirical_sensor_curve", "empirical_sensor_drift", "empirical_sensor_play"])
def test_a_gain_of_the_sensor_is_one_of_the_displacement_alone(rig: Prototype, name: str):  # noqa: F811
    """Beside other sensors: a member is the rig whose sensor gives as many volts per metre."""
    found = family(rig.but(effects={name: some(name)})).members
    ends = [member.frozen[name]["factor"] for member in found]
    assert len(set(ends)) == 2
    for member, factor in zip(found, ends, strict=True):
        assert (member.gain.low, member.gain.high) == (1.0, 1.0)
        volts = float(exact(rig.sensor.gain_V_per_m) * exact(factor))
        expected = loop(rig.but(sensor=rig.sensor.but(gain_V_per_m=volts))).at(1.3)
        np.testing.assert_allclose(member_loop(rig, member).at(1.3).poles(), expected.poles(), rtol=1e-9)


def test_what_no_loop_stands_for_is_refused_by_proofs_in_words(rig: Prototype):  # noqa: F811
    for name in LEARNT.keys() - set(PROVED):
        with pytest.raises(InputError) as refused:
            family(rig.but(effects={name: {}}))
        assert f"effects.{name}" in str(refused.value)
    with pytest.raises(InputError, match="takes all of the loop's gain"):
        family(rig.but(effects={"empirical_sensor_curve": {"cube": -1.0, "reach_V": 1.0, "size_V": 1.0}}))


def test_the_slopes_of_a_curve_are_those_of_its_table():
    """Differences of what it adds, over a fine grid of its reach; extremes lie inside, at no end of either side."""
    name = "empirical_outer_reaction_curve"
    given = TERMS | {"reach_m": 2e-3, "size_N": 700.0}
    u = np.linspace(-1, 1, 4001)
    added = [
        applied(name, "outer_reaction_N", 0.0, parameter=given, port={"outer_m": 2e-3 * at, "mount_m": 0.0})[0]
        for at in u
    ]
    slopes = np.diff(added) / np.diff(2e-3 * u)
    span = LEARNT[name].linear.figures["slope_N_per_m"](given, None)  # type: ignore[union-attr, arg-type]
    assert (span.low, span.high) == pytest.approx((slopes.min(), slopes.max()), rel=2e-3)
    table = LEARNT[name].table(given)  # type: ignore[misc]
    np.testing.assert_allclose(np.interp(table["outer_m"], 2e-3 * u, added), table["added_N"], atol=1e-3)


def test_a_sum_of_loops_slides_at_its_heights_and_turns_back_as_dahl_says():
    """d' = v / w (1 - d sgn v) from -1: after a travel s the deflection is 1 - 2 exp(-s / w) (Dahl 1976)."""
    given = {"narrow": 0.2, "wide": 0.1, "reach_m": 1e-3, "size_N": 400.0}
    speed, step, state = 1e-3, 2e-5, {"narrow": -1.0, "wide": -1.0}
    for _ in range(10_000):
        force, rates = applied(
            "empirical_friction_loop", "friction_N", 0.0, parameter=given, state=state,
            port={"sliding_m_per_s": speed, "sliding_m": 0.0},
        )  # fmt: skip
        state = {key: state[key] + step * rates[key] for key in state}
    travel = 10_000 * step * speed
    due = [1 - 2 * np.exp(-travel / (width * 1e-3)) for width in (0.1, 0.5)]
    assert (state["narrow"], state["wide"]) == pytest.approx(due, abs=2e-3)
    assert force == pytest.approx(400.0 * (0.2 * due[0] + 0.1 * due[1]), abs=0.5)


def test_a_sensor_that_sticks_follows_half_the_play_behind_and_stays_at_a_reversal():
    """The play operator on a triangle (Krasnosel'skii and Pokrovskii, Systems with Hysteresis, 1989, section 2)."""
    given = {"half_width": 0.1, "held_share": 0.9, "size_V": 2.0}
    up = np.linspace(0.0, 1.0, 4001)
    down, step = np.linspace(1.0, 0.0, 4001), 1e-3
    state, seen = {"followed": 0.0, "left": 0.0}, []
    for volts in (*up, *down):
        read, rates = applied("empirical_sensor_play", "sensor_V", float(volts), parameter=given, state=state)
        # Quicker than the steps: both settle within one of them.
        state = {key: state[key] + min(step, 1 / 4e3) * rates[key] for key in state}
        seen.append(read)
    behind = np.where(up < 0.2, 0.0, up - 0.2), np.minimum(0.8, down + 0.2)
    np.testing.assert_allclose(seen, 0.1 * np.concatenate([up, down]) + 0.9 * np.concatenate(behind), atol=2e-3)


def test_what_swings_on_a_tip_is_an_absorber():
    """Held at the tip it is an oscillator at its own frequency; far below, a mass that goes along."""
    given = {"mass_kg": 0.4, "frequency_Hz": 30.0, "damping_ratio": 0.05}
    w = 2 * pi * 30.0

    def force(of: float) -> complex:
        """On the tip, per metre of it, at an angular frequency: of the law's own equations, by superposition."""
        s = 1j * of
        rows = []
        for unit in ({"at_m": 1.0}, {"at_m_per_s": 1.0}, {"inner_m": 1.0}, {"inner_m_per_s": 1.0}):
            port = {"inner_m": 0.0, "inner_m_per_s": 0.0} | {k: v for k, v in unit.items() if k.startswith("inner")}
            state = {"at_m": 0.0, "at_m_per_s": 0.0} | {k: v for k, v in unit.items() if k.startswith("at")}
            pull, rates = applied(
                "empirical_inner_force_appendage", "inner_force_N", 0.0, parameter=given, state=state, port=port
            )
            rows.append((pull, rates["at_m_per_s"]))
        (k_at, a), (c_at, b), (k, p), (c, q) = rows
        at = (p + q * s) / (s**2 - a - b * s)
        return complex(-(k + c * s + (k_at + c_at * s) * at))

    tied = w**2 + 2 * 0.05 * w * 1j * w
    for of in (0.01 * w, 0.7 * w, w, 3 * w):
        spring = w**2 + 2 * 0.05 * w * 1j * of
        assert force(of) == pytest.approx(-0.4 * of**2 * spring / (spring - of**2), rel=1e-9)
    assert force(0.01 * w).real == pytest.approx(-0.4 * (0.01 * w) ** 2, rel=2e-4)
    assert abs(force(w)) == pytest.approx(0.4 * w**2 * abs(tied) / abs(tied - w**2), rel=1e-9)


def before_laws(data: Dataset, listed: Hypothesis, there: Mapping[str, float] | None = None) -> Search:
    """Tolerances alone and one listed cause, whose fit begins where figures are as given."""
    evidence, known = evidence_of(data), []
    for hypothesis, figures in ((NOTHING, {}), (listed, there or {})):
        placement = hypothesis.placement(data.prototype)
        start = np.array([u.z(figures.get(u.name, u.nominal)) for u in placement.unknowns])
        known.append(fit(hypothesis, placement, evidence, start))
    null, other = known
    expected, floor = sum(e.expected for e in evidence), sum(e.floor for e in evidence)
    return Search(null, (other,), expected, floor, tuple(e.condition for e in evidence))


def test_a_spring_that_hardens_is_learnt_from_records_of_a_rig_that_has_one(tmp_path, monkeypatch):
    """K (x + h x^3) of another program, which shares no equation: the law's cube over its scales is K h.

    Of the laws at either beam and at the sensor, so that it takes less time.
    """
    near = ("inner_reaction", "outer_reaction", "sensor")
    monkeypatch.setattr(
        learning, "learnable", lambda prototype: [h for h in learnable(prototype) if str(h).endswith(near)]
    )
    case = draw_case(7709, "outside", short=True, names=("beam_hardening",))
    case = replace(case, runs=case.runs[1:4])  # in which it is bent far
    write_case(case, tmp_path)
    data = read_dataset(tmp_path)
    monkeypatch.setattr(learning, "_BESIDE", np.inf)  # so that laws beside a listed cause are learnt as well
    before = before_laws(data, Hypothesis(("parameter:leakage",)))
    judged = judge(before)
    assert judged.unknown > 0.5
    found = learn(Look(data, before, judged), held_out(data.records))
    assert found is not None
    best = found.judged.best
    # Terms that are none are unknowns of no fit, so that any of them can be compared with any other.
    assert all(f.unknowns == f.hypothesis.placement(found.data.prototype).unknowns for f in found.search.fits)
    assert best.hypothesis.causes == ("empirical:inner_reaction",)
    assert found.search.excess(best) < 0.1
    (cause,) = (
        described(c, best, found.data) for c in causes(found.search, found.judged) if c.name in best.hypothesis.causes
    )
    assert "hardens" in cause.like
    prototype = updated_prototype(found.data.prototype, best)
    (name,) = prototype.effects
    table = prototype.effects[name]
    true = run_figures(case, case.runs[0])
    cube = table["cube"] * table["size_N"] / table["reach_m"] ** 3
    assert cube == pytest.approx(true["inner_stiffness"] * true["hardening"], rel=0.1)
    assert family(prototype).members
    assert Prototype.model_validate(prototype.model_dump()) == prototype
    # What a record held out says decides: where none is, nothing is learnt.
    assert learn(Look(data, before, judged), ()) is None
    sure = Look(data, before, replace(judged, unknown=0.0))
    assert learn(sure, held_out(data.records)) is None


@pytest.mark.parametrize(
    ("seed", "kind", "name", "drive", "figure", "law"),
    [
        (4, "outside", "sensor_gain_drift", "lag", "sensor_gain", "sensor"),
        (4, "parameter", "parameter:sensor_gain", "lag", "sensor_gain", ""),
        # A record held out that noise makes most of is predicted as well by the one as by the other, to 0.2 %.
        (41770296300039, "outside", "torque_drift", "ball_screw", "torque_constant", "motor_demand"),
        # Of 1.6 times itself while a record lasts, which is far more than usual, and all of the gap.
        (23717768000017, "outside", "torque_drift", "ball_screw", "torque_constant", "motor_demand"),
    ],
)
def test_a_gain_that_drifts_is_no_wrong_gain(seed, kind, name, drive, figure, law, tmp_path, monkeypatch):
    """However sure a wrong gain is among what is listed: it leaves what the drift explains. A wrong one stays wrong.

    Of the laws at either beam and where the gain is, so that it takes less time.
    """
    near = ("inner_reaction", "outer_reaction", law or "sensor")
    monkeypatch.setattr(
        learning, "learnable", lambda prototype: [h for h in learnable(prototype) if str(h).endswith(near)]
    )
    case = draw_case(seed, kind, short=True, names=(name,), rig=drive, noise="white" if drive == "lag" else "coloured")
    write_case(case, tmp_path)
    data = read_dataset(tmp_path)
    before = before_laws(data, Hypothesis((f"parameter:{figure}",)))
    judged = replace(judge(before), best=before.fits[0], unknown=0.01)
    found = learn(Look(data, before, judged), held_out(data.records))
    if not law:
        assert found is None
        return
    assert found is not None
    assert found.judged.best.hypothesis.names == (f"empirical_{law}_drift",)
    assert 0.5 < found.judged.unknown <= 1
    assert all(0 <= share <= 1 for share in found.judged.of.values())
    true = run_figures(case, case.runs[0])["sensor_drift" if drive == "lag" else name]
    values = found.judged.best.values
    assert np.sign(values[f"empirical_{law}_drift.change_per_s"]) == np.sign(true)


def test_a_cause_that_needs_figures_that_no_rig_has_yields_to_a_law_that_needs_none(monkeypatch):
    """A mass on a spring at the tip: with another outer mass, a second mode at twice the first moves alike, exactly."""
    own = {"mass_kg": 0.3, "frequency_Hz": 70.0, "damping_ratio": 0.05}
    law, mode = Hypothesis(("empirical_outer_force_appendage",)), Hypothesis(("second_beam_mode",))
    plan = scenario(0.6)
    plan = plan.but(record=tuple(plan.record[k] for k in (0, 2, 3)))
    data = measured(believed().but(effects={law.names[0]: own}), plan, believed())
    # A mode that takes its share of the compliance from the first, by the eigenvalues of both masses on their springs.
    k, m = (next(u.nominal for u in NOTHING.unknowns(data.prototype) if u.name == f"outer_{of}") for of in PAIR)
    tie = own["mass_kg"] * (2 * pi * own["frequency_Hz"]) ** 2
    squares, shapes = eigh([[k + tie, -tie], [-tie, tie]], np.diag([m, own["mass_kg"]]))
    soft = shapes[0] ** 2 / squares
    there = {
        "outer_stiffness": 1 / soft[0], "outer_mass": 1 / shapes[0, 0] ** 2,
        "second_beam_mode.frequency_Hz": float(np.sqrt(squares[1])) / (2 * pi),
        "second_beam_mode.compliance_share": soft[1] / soft[0],
    }  # fmt: skip
    before = before_laws(data, mode, there)
    (listed,), judged = before.fits, judge(before)
    assert judged.best is listed
    assert judged.unknown < 0.1
    assert before.excess(listed) < learning.EXPLAINED
    assert listed.strained
    monkeypatch.setattr(learning, "learnable", lambda prototype: [law, Hypothesis(("empirical_sensor_lag",))])
    found = learn(Look(data, before, judged), (1,))
    assert found is not None
    best = found.judged.best
    assert best.hypothesis == law
    assert found.judged.unknown > 0.99
    assert sum(found.judged.of.values()) == pytest.approx(1.0)
    assert not best.strained
    for key, value in own.items():
        assert best.values[f"{law.names[0]}.{key}"] == pytest.approx(value, rel=0.2 if key == "damping_ratio" else 0.03)
    assert "second_beam_mode may stand for something else" in found.words[0]
    # Where what is listed needs nothing that a rig has not, no law is asked for, however well it would do.
    usual = replace(listed, z=np.where([u.kind == "figure" for u in listed.unknowns], 0.0, listed.z))
    monkeypatch.setattr(learning, "far_fetched", lambda found, prototype: "")
    assert learn(Look(data, before, replace(judged, best=usual)), (1,)) is None


def test_what_is_listed_is_no_more_than_likely_where_a_law_alone_is_more_probable(monkeypatch):
    """A mass that swings on the tip was called a mount that gives way, with confidence: each left much of the gap."""
    law, other = Hypothesis(("empirical_outer_force_appendage",)), Hypothesis(("empirical_sensor_lag",))
    own = {"mass_kg": 0.3, "frequency_Hz": 70.0, "damping_ratio": 0.05}
    plan = scenario(0.6)
    plan = plan.but(record=tuple(plan.record[k] for k in (0, 2, 3)))
    data = measured(believed().but(effects={law.names[0]: own}), plan, believed())
    before = before_laws(data, Hypothesis(("mount_compliance",)))
    (listed,) = before.fits
    monkeypatch.setattr(learning, "EXPLAINED", 0.1)
    assert before.excess(listed) > learning.EXPLAINED
    look = Look(data, before, replace(judge(before), best=listed, unknown=0.2))
    monkeypatch.setattr(learning, "_ALIKE", -np.inf)  # so that no law leaves little enough to take its place
    monkeypatch.setattr(learning, "learnable", lambda prototype: [law, other])
    found = learn(look, (1,))
    assert found is not None
    assert found.doubtful
    assert (found.search, found.judged) == (look.search, look.judged)
    (words,) = found.words
    assert "better by a mass of 0.3 kg that swings on the outer beam at 70 Hz" in words
    assert "than by mount_compliance" in words
    monkeypatch.setattr(learning, "learnable", lambda prototype: [other])
    assert learn(look, (1,)) is None


@pytest.mark.parametrize("odd_square", [0.5, 16.0])
def test_a_curve_is_counted_over_no_more_than_the_rig_can_have_moved(odd_square: float):
    """The same force at every speed; and where it was larger than the port's own, counted from where it is as large."""
    name, data = "empirical_friction_curve", read_dataset(SLOW_SENSOR)
    scales = {"reach_m_per_s": 2.0, "size_N": 900.0}
    data = replace(data, prototype=data.prototype.but(effects={name: scales}))
    hypothesis, terms = Hypothesis((name,)), TERMS | {"odd_square": odd_square}
    given = {"oil_stiffness": 1e7} | {f"{name}.{term}": value for term, value in terms.items()}
    moved, begun = within_reach(data, {hypothesis: given})
    now, values = moved.prototype.effects[name], begun[hypothesis]
    found = {term: values[f"{name}.{term}"] for term in terms}
    for speed in (-1.3, -0.2, 0.1, 0.45):
        force = scales["size_N"] * curve(terms, speed / scales["reach_m_per_s"])
        assert now["size_N"] * curve(found, speed / now["reach_m_per_s"]) == pytest.approx(force, rel=1e-12)
    largest = max(abs(curve(found, side)) for side in (-1.0, 1.0))
    assert largest == pytest.approx(1.0, abs=0.05) if odd_square > 1 else begun == {hypothesis: given}


@pytest.mark.parametrize("name", LEARNT)
def test_the_kind_of_every_learnt_law_is_told(name: str):
    """By its equations, on a rig that has its port: one of a screw's drive too."""
    kinds = {"curve": "static", "loop": "hysteretic", "play": "hysteretic", "droop": "static", "drift": "drifting"}
    assert kind_of_effect(name) == kinds.get(name.rpartition("_")[2], "linear")
