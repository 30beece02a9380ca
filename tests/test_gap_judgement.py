"""From fits to a verdict, on fits made by hand, and the classic false answer: a missing resonance fitted as a delay."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from gap_sets import believed, measured, only
from null_scores import main as null_scores_main
from scipy.linalg import eigh
from scipy.optimize import brentq
from scipy.stats import chi2, norm

from beamdesign.diagnosis import judgement
from beamdesign.diagnosis.diagnosis import Where
from beamdesign.diagnosis.fitting.evidence import record_evidence
from beamdesign.diagnosis.fitting.fit import Fit, Share, fit
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, Hypothesis, together, unlike
from beamdesign.diagnosis.fitting.search import Search
from beamdesign.diagnosis.fitting.starts import fit_from_starts, resonances, starts
from beamdesign.diagnosis.judgement import (
    Judgement,
    cause_sets,
    causes,
    deviations,
    evidence,
    flags,
    held_out_score,
    judge,
)
from beamdesign.diagnosis.thresholds import THRESHOLDS
from beamdesign.diagnosis.verdict import (
    LEVEL,
    chance,
    classes,
    decided,
    far_fetched,
    leaves_much,
    null_scores,
    sentences,
    verdict_of,
)
from beamdesign.validation.truth.beams import outer_modes

EXPECTED = 300.0
LAG, AREAS = "sensor_lag", "unequal_piston_areas"


def made(names: tuple[str, ...], misfit: float, curvature: float = 100.0, **z: float) -> Fit:
    """A fit with one piece of evidence, equally well determined in every unknown."""
    hypothesis = Hypothesis(tuple(sorted(names)))
    unknowns = hypothesis.unknowns(believed())
    values = np.array([z.get(u.name.replace(".", "_"), 0.0) for u in unknowns])
    share = Share(misfit, np.zeros(len(values)), curvature * np.eye(len(values)))
    return Fit(hypothesis, unknowns, values, misfit + float(values @ values), (share,))


def found(*fits: Fit) -> Search:
    null, *others = fits
    return Search(null, tuple(sorted(others, key=lambda f: f.cost)), EXPECTED)


def test_marginal_likelihood_of_a_linear_model():
    """ln N(r; 0, I + H H') = -(r'r - r'H (I + H'H)^-1 H'r)/2 - ln det(I + H'H)/2 + const; C. M. Bishop, Pattern
    Recognition and Machine Learning (2006), equation (3.86) with unit noise and unit prior."""
    random = np.random.default_rng(0)
    h, r = random.standard_normal((30, 13)), random.standard_normal(30)
    z = np.linalg.solve(np.eye(13) + h.T @ h, h.T @ r)
    left = r - h @ z
    one = Fit(NOTHING, NOTHING.unknowns(believed()), z, 0.0, (Share(float(left @ left), -h.T @ left, h.T @ h),))
    covariance = np.eye(30) + h @ h.T
    expected = -0.5 * (r @ np.linalg.solve(covariance, r) + np.linalg.slogdet(covariance)[1])
    assert evidence(one, 1.0) == pytest.approx(expected, rel=1e-10)


def test_deviations_are_those_of_refits_without_each_condition():
    """Ridge regression on rows in four groups that do not agree, by numpy: overdispersion and Tukey's jackknife."""
    random = np.random.default_rng(1)
    unknowns = NOTHING.unknowns(believed())
    count = len(unknowns)
    rows = [(random.standard_normal((20, count)), random.standard_normal(20) + 3 * k) for k in range(4)]

    def solved(parts):
        h, r = np.vstack([part[0] for part in parts]), np.concatenate([part[1] for part in parts])
        return np.linalg.solve(np.eye(count) + h.T @ h, h.T @ r)

    z = solved(rows)
    shares = [Share(float((r - h @ z) @ (r - h @ z)), -h.T @ (r - h @ z), h.T @ h) for h, r in rows]
    one = Fit(NOTHING, unknowns, z, 0.0, tuple(shares))
    without = np.array([solved([*rows[:k], *rows[k + 1 :]]) for k in range(4)])
    own = np.diag(np.linalg.inv(np.eye(count) + sum(h.T @ h for h, _ in rows))) * one.misfit / 80
    jackknife = 3 / 4 * np.sum((without - without.mean(axis=0)) ** 2, axis=0)
    slopes = [abs(u.slope(v)) for u, v in zip(unknowns, z, strict=True)]
    errors = deviations(one, Search(one, (), 80.0, conditions=(0, 1, 2, 3)))
    assert list(errors.values()) == pytest.approx(list(slopes * np.sqrt(own + jackknife)), rel=1e-8)


def test_a_rig_whose_records_no_null_resembles_is_not_without_a_gap():
    judged = judge(found(made((), 1.1 * EXPECTED)))
    assert verdict_of(judged) == "no_gap"
    assert verdict_of(judged, rare=LEVEL) == "unknown"
    assert verdict_of(judged, rare=0.5) == "no_gap"
    lost = judge(found(made((), 20 * EXPECTED), made((LAG,), 15 * EXPECTED)))
    assert (verdict_of(lost), verdict_of(lost, rare=LEVEL)) == ("unknown", "unknown")


def test_a_gap_that_is_too_rare_for_none_is_of_the_most_probable_cause():
    null, wrong = made((), 1.1 * EXPECTED, flow_gain=3.1), made(("parameter:flow_gain",), 1.1 * EXPECTED, flow_gain=1.0)
    search = found(null, made((LAG,), 1.1 * EXPECTED, flow_gain=3.1), wrong)
    judged = judge(search)
    assert judged.best is null
    assert decided(judged, search, 0.5).best is null
    assert decided(judged, search, np.nan) is judged
    assert decided(judged, search, LEVEL).best is wrong
    assert verdict_of(decided(judged, search, LEVEL), rare=LEVEL) == "ambiguous"


def test_of_nulls_no_more_than_the_level_are_beyond_it():
    """Conformal p-values of exchangeable scores are at most a with a probability of at most a, whatever their law."""
    random = np.random.default_rng(2)
    for law in (random.standard_cauchy, random.standard_normal, lambda n: random.integers(0, 3, n).astype(float)):
        p = [chance(drawn[0], drawn[1:]) for drawn in (law(50) for _ in range(4000))]
        assert min(p) > 0
        for level in (0.02, 0.1, 0.5):
            assert np.mean(np.array(p) <= level) <= level + 3 * np.sqrt(level * (1 - level) / 4000)
    assert chance(0.0, [0.5] * 49) == pytest.approx(1 / 50)
    assert len(null_scores()) >= 1 / LEVEL  # so that the level can be reached at all
    assert list(null_scores()) == sorted(null_scores())
    assert 0 < null_scores()[0] < null_scores()[-1] < 1


def test_scores_that_are_there_are_not_drawn_again(tmp_path, capsys):
    (tmp_path / "short.jsonl").write_text("[7, 0.81]\n[6, 0.9]\n[5, 0.85]\n")
    given = [str(tmp_path), "--rigs", "3", "--seed", "5", "--workers", "1"]
    assert null_scores_main(given) == 0
    written = tomllib.loads((tmp_path / "nulls.toml").read_text())
    assert written == {"first_seed": 5, "no_gap": [0.81, 0.85, 0.9]}
    capsys.readouterr()
    assert null_scores_main([*given, "--check"]) == 0
    assert "0 of 3 rigs" in capsys.readouterr().out


def test_a_fit_at_the_noise_is_no_gap():
    judged = judge(found(made((), 1.1 * EXPECTED), made((LAG,), 1.05 * EXPECTED), made((AREAS,), 1.09 * EXPECTED)))
    assert judged.best.hypothesis.names == ()
    assert verdict_of(judged) == "no_gap"
    assert judged.unknown < 0.1


def test_one_cause_that_explains_all():
    judged = judge(found(made((), 20 * EXPECTED), made((LAG,), 1.1 * EXPECTED), made((AREAS,), 12 * EXPECTED)))
    assert judged.best.hypothesis.names == (LAG,)
    assert verdict_of(judged) == "effect"
    assert verdict_of(judged, doubtful=True) == "ambiguous"


def test_a_cause_that_may_as_well_be_something_unknown_is_no_sure_one():
    lag = made((LAG,), 1.1 * EXPECTED)
    for unknown, verdict in ((0.1, "effect"), (0.35, "ambiguous"), (0.6, "unknown")):
        judged = Judgement({lag.hypothesis: 0.98 * (1 - unknown), NOTHING: 0.02 * (1 - unknown)}, unknown, lag)
        assert verdict_of(judged) == verdict
    told = sentences(
        "ambiguous",
        causes(found(made((), 20 * EXPECTED), lag), judged),
        (LAG,),
        "",
        Where("", (0.0, 0.0), ""),
        unknown=0.35,
        none=0.013,
    )
    assert "it may as well be tolerances alone (1%) or something that is not known here (35%)" in told


def test_where_tolerances_leave_nothing_no_cause_has_a_share_of_the_gap():
    search = found(made((), 0.95 * EXPECTED), made((LAG,), 0.9 * EXPECTED))
    judged = judge(search)
    assert [cause.share for cause in causes(search, judged)] in ([], [0.0])
    assert all(one.share_left != one.share_left for one in cause_sets(search, judged))
    much = found(made((), 20 * EXPECTED), made((LAG,), 1.1 * EXPECTED))
    assert causes(much, judge(much))[0].share > 0.9


@pytest.mark.parametrize(("unknown", "words"), [(0.1, "bear no answer"), (0.9, "Nothing that is known here")])
def test_data_that_bear_no_answer_are_not_said_to_hold_an_unknown_cause(unknown: float, words: str):
    null = made((), 1.1 * EXPECTED)
    judged = Judgement({NOTHING: 1 - unknown}, unknown, null)
    assert verdict_of(judged, doubtful=True) == "unknown"
    given = causes(found(null), judged), (), "", Where("", (0.0, 0.0), "")
    assert words in sentences("unknown", *given, unknown=unknown)
    hurried = sentences("unknown", *given, complete=False, unknown=unknown)  # which is not the data's fault
    assert ("What was compared leaves no gap" if unknown < 0.5 else "Nothing that was compared explains") in hurried


@pytest.mark.parametrize(("better", "best"), [(0.05, LAG), (0.8, LAG), (1.2, "transport_delay")])
def test_conditions_held_out_outweigh_what_is_less_probable_by_less(
    monkeypatch: pytest.MonkeyPatch, better: float, best: str
):
    """Probabilities multiply: a factor of e is made up for by conditions that are e to the 1.2 more probable."""
    lag, delay = made((LAG,), 1.1 * EXPECTED), made(("transport_delay",), 1.1 * EXPECTED)
    search = found(made((), 20 * EXPECTED), lag, delay)
    scores = {lag.hypothesis: 0.0, delay.hypothesis: better}
    monkeypatch.setattr(judgement, "odds", lambda hypothesis: -3.0 - (hypothesis == delay.hypothesis))
    monkeypatch.setattr(judgement, "held_out_score", lambda fit, *of: scores[fit.hypothesis])
    judged = judge(search)
    assert judged.of[lag.hypothesis] / judged.of[delay.hypothesis] == pytest.approx(np.e)
    assert judged.best.hypothesis.names == (best,)


@pytest.mark.parametrize(
    ("of_lag", "words"), [(0.27, "predicts best what was held out"), (0.6, "most probably caused")]
)
def test_what_held_out_conditions_choose_is_not_called_most_probable_where_it_is_not(of_lag: float, words: str):
    lag, areas = made((LAG,), 1.1 * EXPECTED), made((AREAS,), 1.1 * EXPECTED)
    judged = Judgement({lag.hypothesis: of_lag, areas.hypothesis: 0.97 - of_lag, NOTHING: 0.03}, 0.0, lag)
    listed = causes(found(made((), 20 * EXPECTED), lag, areas), judged)
    told = sentences("ambiguous", listed, (LAG,), "", Where("", (0.0, 0.0), ""))
    assert words in told
    assert f"it may as well be {AREAS.replace('_', ' ')} ({0.97 - of_lag:.0%})" in told.replace("_", " ")


def test_two_causes_that_explain_it_alike_are_ambiguous_and_a_class():
    search = found(made((), 20 * EXPECTED), made((LAG,), 1.1 * EXPECTED), made(("transport_delay",), 1.1 * EXPECTED))
    judged = judge(search)
    assert verdict_of(judged) == "ambiguous"
    assert classes(judged) == ((LAG, "transport_delay"),)
    assert {c.name for c in causes(search, judged)} == {LAG, "transport_delay"}


def test_a_second_cause_needs_a_share_of_its_own():
    """Every rig has a little of everything: what explains a hundredth of the gap is not named beside the rest."""
    alone, other = made((LAG,), 1.9 * EXPECTED), made((AREAS,), 90 * EXPECTED)
    minor = judge(found(made((), 100 * EXPECTED), alone, other, made((LAG, AREAS), 1.1 * EXPECTED)))
    assert minor.best.hypothesis.names == (LAG,)
    alone = made((LAG,), 40 * EXPECTED)
    major = judge(found(made((), 100 * EXPECTED), alone, other, made((LAG, AREAS), 1.1 * EXPECTED)))
    assert major.best.hypothesis.names == (LAG, AREAS)


@pytest.mark.parametrize(("left", "names"), [(1.2, (LAG, AREAS)), (7.0, (LAG,))])
def test_what_explains_all_but_noise_of_the_displacement_is_named_however_large_the_gap(left: float, names):
    """A hundredth of the gap, twenty times the noise; where six of these are left, it may be another realisation."""
    floor = 1e-4
    fits = {(): (100, 2000), (LAG,): (1.9, 20), (AREAS,): (90, 1800), (LAG, AREAS): (1.1, left)}

    def one(causes: tuple[str, ...], misfit: float, error: float) -> Fit:
        fit = made(causes, misfit * EXPECTED)
        return replace(fit, shares=tuple(replace(share, error=error * floor) for share in fit.shares))

    judged = judge(replace(found(*(one(c, *of) for c, of in fits.items())), floor=floor))
    assert judged.best.hypothesis.names == names


def test_what_leaves_a_plainly_wrong_figure_strained_explains_something_else():
    """Of little misfit, one cause takes a part and leaves the figure where no rig has it, the other eases it."""
    null, wrong = made((), 1.2 * EXPECTED, flow_gain=4.8), made(("parameter:flow_gain",), 1.2 * EXPECTED, flow_gain=1.0)
    strained, eased = made((AREAS,), 1.05 * EXPECTED, flow_gain=4.8), made((AREAS,), 1.05 * EXPECTED)
    assert judge(found(null, wrong, strained)).best.hypothesis.names == wrong.hypothesis.names
    assert judge(found(null, wrong, eased)).best.hypothesis.names == (AREAS,)


def test_beside_another_cause_too_a_figure_no_rig_has_so_far_off_is_eased():
    lag, both = made((LAG,), 1.1 * EXPECTED, oil_stiffness=-8.0), made((LAG, "entrained_air"), 1.05 * EXPECTED)
    null = made((), 30 * EXPECTED, oil_stiffness=-8.0)
    judged = judge(found(null, lag, made(("entrained_air",), 29 * EXPECTED), both))
    assert judged.best.hypothesis == both.hypothesis
    alone, freed = made((LAG,), EXPECTED, oil_stiffness=-8.0), made((LAG, "parameter:oil_stiffness"), EXPECTED)
    assert judge(found(null, alone, freed)).best.hypothesis == lag.hypothesis  # it says no more than that it is off
    within = replace(lag, z=lag.z * 3.5 / 8.0, cost=lag.cost - 8.0**2 + 3.5**2)  # as a rig may be
    judged = judge(found(null, within, made(("entrained_air",), 29 * EXPECTED), both))
    assert judged.best.hypothesis == lag.hypothesis


def test_what_nothing_explains_is_unknown():
    judged = judge(found(made((), 20 * EXPECTED), made((LAG,), 15 * EXPECTED), made((AREAS,), 19 * EXPECTED)))
    assert judged.unknown > 0.9
    assert verdict_of(judged) == "unknown"
    assert sum(judged.of.values()) + judged.unknown == pytest.approx(1.0)


def test_a_plainly_wrong_figure_is_told_by_its_tolerance():
    """The records are explained with the flow gain six tolerances off: it is wrong, not unlucky."""
    off = made((), 1.1 * EXPECTED, flow_gain=6.0)
    assert judge(found(off, made(("parameter:flow_gain",), 1.1 * EXPECTED, flow_gain=0.6))).best.hypothesis.names == (
        "parameter:flow_gain",
    )
    near = made((), 1.1 * EXPECTED, flow_gain=2.0)
    assert judge(found(near, made(("parameter:flow_gain",), 1.1 * EXPECTED, flow_gain=0.2))).best.hypothesis.names == ()


def test_what_explains_as_much_as_a_plainly_wrong_figure_is_not_slight():
    """An effect of a quarter of the noise alone is one of a rig's many small ones, but where else a figure is wrong."""
    null, air = made((), 1.3 * EXPECTED), made(("entrained_air",), 1.05 * EXPECTED)
    assert judge(found(null, air)).best.hypothesis.names == ()
    oil = made(("parameter:oil_stiffness",), 1.1 * EXPECTED)
    assert judge(found(null, oil)).best.hypothesis.names == oil.hypothesis.names
    assert judge(found(null, oil, air)).best.hypothesis.names == air.hypothesis.names
    alike = judge(found(null, oil, made((AREAS,), 1.105 * EXPECTED)))
    assert 0.02 < alike.cause(AREAS) < 0.2  # one more unknown costs it a factor of ten, and nothing else does
    worse = made(("entrained_air",), 1.2 * EXPECTED)
    assert judge(found(null, oil, worse)).cause("entrained_air") < 1e-3


@pytest.mark.parametrize("own", [1.0, 3.0])
def test_an_effect_that_eases_what_a_wrong_figure_does_is_weighed_by_its_evidence(own: float):
    """How far its own parameters are from the usual is in its evidence, and not in what it leaves of the figures."""
    null, wrong = made((), 1.05 * EXPECTED, flow_gain=6.0), made(("parameter:flow_gain",), 1.05 * EXPECTED, flow_gain=1)
    effect = made((AREAS,), 1.05 * EXPECTED - 4.0, **{f"{AREAS}_asymmetry": own})
    assert (wrong.strain, effect.strain) == (0.0, 0.0)
    search = found(null, wrong, effect)
    judged = judge(search)
    odds_of = evidence(effect, search.spread) - evidence(wrong, search.spread)
    assert judged.cause(AREAS) / judged.cause("parameter:flow_gain") == pytest.approx(np.exp(odds_of), rel=0.02)


def test_strained_figures_leave_doubt():
    lag = made((LAG,), 1.1 * EXPECTED, sensor_gain=THRESHOLDS.strained + 1)
    search = found(made((), 20 * EXPECTED), lag)
    judged = judge(search)
    assert judged.best.strained == ("sensor_gain",)
    assert verdict_of(judged) == "ambiguous"
    assert causes(search, judged)[0].flags == ("sensor_gain had to move by +5.0 tolerances",)


@pytest.mark.parametrize(("of_the_limit", "verdict"), [(0.98, "effect"), (1.02, "ambiguous")])
def test_figures_that_are_all_a_little_strained_leave_doubt(of_the_limit: float, verdict: str):
    """By SciPy: squares of as many normal numbers add up to as much no more often than one is four deviations off."""
    figures = [u.name for u in NOTHING.unknowns(believed())]
    limit = np.sqrt(chi2.isf(2 * norm.sf(THRESHOLDS.strained), len(figures)) / len(figures))
    assert 1.5 < limit < 2.0
    each = of_the_limit * float(limit)
    judged = judge(found(made((), 20 * EXPECTED), made((LAG,), 1.1 * EXPECTED, **dict.fromkeys(figures, each))))
    assert judged.best.hypothesis.names == (LAG,)
    assert judged.best.strained == (tuple(figures) if of_the_limit > 1 else ())
    assert verdict_of(judged) == verdict
    told = far_fetched(judged.best, believed())
    assert bool(told) is (of_the_limit > 1)
    assert ("sensor_lag may stand for something else" in told) is bool(told)


@pytest.mark.parametrize(
    ("names", "of_noise", "left", "told"),
    [
        ((LAG,), 2.0, 1.7, "sensor_lag leaves 70% of what tolerances leave beyond noise"),
        ((LAG,), 2.0, 1.4, ""),
        ((LAG,), 1.2, 1.15, ""),  # hardly a gap: what is left of it is chance
        (("parameter:flow_gain",), 2.0, 1.7, ""),  # is told by how far off its tolerance it is
    ],
)
def test_an_effect_that_leaves_most_of_a_gap_is_no_sure_one(names, of_noise: float, left: float, told: str):
    one = made(names, left * EXPECTED)
    search = found(made((), of_noise * EXPECTED), one)
    assert search.excess(one) == pytest.approx((left - 1) / (of_noise - 1))
    assert leaves_much(one, search) == told


@pytest.mark.parametrize(
    ("share", "ratio"),
    [(share, ratio) for share in (0.02, 0.1, 0.3) for ratio in (0.5, 1.0, 1.5)]
    + [(0.05, 3.0), (0.05, 4.0), (0.02, 6.0)],
)
def test_what_swings_on_a_tip_is_no_second_bending_mode(share: float, ratio: float):
    """Two masses on springs, by their eigenvalues: a beam's upper mode lies farther up, or takes more part at the tip.

    That of a light mass far above the beam's first mode moves the tip less than any bending mode there would.
    """
    own, rig = ratio**2, believed()
    squares, shapes = eigh([[1 + share * own, -share * own], [-share * own, share * own]], np.diag([1.0, share]))
    given = {u.name: u.nominal for u in NOTHING.unknowns(rig)}
    first_Hz = np.sqrt(given["outer_stiffness"] / given["outer_mass"]) / (2 * np.pi)
    at_tip = shapes[0] ** 2 / squares
    values = {
        "outer_stiffness": given["outer_stiffness"] / at_tip[0],
        "outer_mass": given["outer_mass"] / shapes[0, 0] ** 2,
        "second_beam_mode.frequency_Hz": float(first_Hz * np.sqrt(squares[1])),
        "second_beam_mode.compliance_share": float(at_tip[1] / at_tip[0]),
    }
    mode = together("second_beam_mode")
    (words,) = unlike(mode, values, rig)
    assert f"at {np.sqrt(squares[1] / squares[0]):.2g} times the frequency" in words
    assert unlike(mode, values, rig.but(effects={"second_beam_mode": {}})) == ()  # its builder called it so


@pytest.mark.parametrize("on_tip", [0.0, 0.3, 30.0])
@pytest.mark.parametrize("off", [0.9, 1.0, 1.1])
def test_a_second_bending_mode_is_one_whatever_is_fixed_to_the_tip(on_tip: float, off: float):
    """A uniform cantilever with a mass on its tip, by its stiffness there: zeros are modes, slopes there their masses.

    R. E. D. Bishop and D. C. Johnson, The Mechanics of Vibration, 1960, chapter 7; frequency and share a tenth off.
    """

    def stiffness(beta: float) -> float:
        c, s = np.cos(beta), np.sin(beta)
        bare = beta**3 * (1 / np.cosh(beta) + c) / (s - c * np.tanh(beta))
        return bare - on_tip * beta**4

    grid = np.linspace(0.1, 5.0, 5001)
    signs = np.array([stiffness(beta) for beta in grid]) > 0
    beta = np.array([brentq(stiffness, *grid[k : k + 2]) for k in np.flatnonzero(signs[:-1] & ~signs[1:])])
    mass = [-(stiffness(b + 1e-5) - stiffness(b - 1e-5)) / 2e-5 / (4 * b**3) for b in beta]
    (first, second), compliance = beta**2, 1 / (mass * beta**4)
    if not on_tip:
        assert [first, second] == pytest.approx([3.516, 22.034], rel=1e-4)
    rig = believed()
    given = {u.name: u.nominal for u in NOTHING.unknowns(rig)}
    first_Hz = np.sqrt(given["outer_stiffness"] / given["outer_mass"]) / (2 * np.pi)
    values = given | {
        "second_beam_mode.frequency_Hz": off * first_Hz * second / first,
        "second_beam_mode.compliance_share": off * compliance[1] / compliance[0],
    }
    assert unlike(together("second_beam_mode"), values, rig) == ()


@pytest.mark.parametrize("softness", [0.0, 0.3, 1.0, 5.0, 25.0])
@pytest.mark.parametrize("tip_share", [0.0, 0.15, 2.0])
def test_no_second_mode_of_a_beam_is_taken_for_something_else(softness: float, tip_share: float):
    """Of tubes with a joint, by finite elements of their own: a uniform one has 6.27 times the frequency (Blevins)."""
    rig = believed()
    given = {u.name: u.nominal for u in NOTHING.unknowns(rig)}
    for joint_mass in (0.0, 0.3):
        bar = (softness, joint_mass, tip_share)
        modes = outer_modes(given["outer_stiffness"], given["outer_mass"], given["outer_damping"], *bar, count=2)
        hertz = np.sqrt(modes[0] / modes[1]) / (2 * np.pi)
        if not any(bar):
            assert hertz[1] / hertz[0] == pytest.approx((4.69409 / 1.87510) ** 2, rel=1e-4)
        own = {"frequency_Hz": hertz[1], "compliance_share": modes[0, 0] / modes[0, 1]}
        values = given | {f"second_beam_mode.{name}": float(value) for name, value in own.items()}
        assert unlike(together("second_beam_mode"), values, rig) == ()


def test_friction_without_an_excess_at_breakaway_is_at_no_bound():
    """A ratio of 1 is none, as the library's usual figures have it; a spring as soft as the library goes is a bound."""
    lowest = {u.name: u.bounds[0] for u in together("seal_friction", "mount_compliance").unknowns(believed())}
    even = made(("seal_friction",), 310.0, seal_friction_breakaway_ratio=lowest["seal_friction.breakaway_ratio"])
    assert flags("seal_friction", even) == []
    stiffness = lowest["mount_compliance.stiffness_N_per_m"]
    soft = made(("mount_compliance",), 310.0, mount_compliance_stiffness_N_per_m=stiffness)
    assert flags("mount_compliance", soft) == ["mount_compliance.stiffness_N_per_m is at its bound, 2e+05"]


def test_a_failed_fit_is_no_rival():
    failed = Fit(Hypothesis((AREAS,)), Hypothesis((AREAS,)).unknowns(believed()), reason="unstable")
    judged = judge(found(made((), 20 * EXPECTED), made((LAG,), 1.1 * EXPECTED), failed))
    assert Hypothesis((AREAS,)) not in judged.of


def test_a_missing_resonance_is_not_called_a_delay():
    """A second mode below the loop's reach turns the phase as a delay does; told by the band it does so in."""
    mode = {"frequency_Hz": 190.0, "compliance_share": 0.03, "damping_ratio": 0.02}
    data = measured(believed().but(effects={"second_beam_mode": mode}))
    data = only(data, ("command_large", "disturbance_small", "disturbance_large", "payload_disturbance"))
    pieces = record_evidence(data)

    def fitted(*names: str) -> Fit:
        hypothesis = Hypothesis(names)
        placement = hypothesis.placement(data.prototype)
        known = null.values if names else {}
        peaks = resonances(pieces, data.prototype, known) if names else ()
        begun = starts(placement, known, pieces, peaks)
        return min((fit(hypothesis, placement, pieces, z) for z in begun), key=lambda f: f.cost)

    null = fitted()
    others = [fitted("transport_delay"), fitted("sensor_lag"), fitted("second_beam_mode")]
    expected = sum(piece.expected for piece in pieces)
    search = Search(null, tuple(sorted(others, key=lambda f: f.cost)), expected)
    judged = judge(search)
    assert judged.best.hypothesis.names == ("second_beam_mode",)
    values = search.fits[0].values
    assert values["second_beam_mode.frequency_Hz"] == pytest.approx(190.0, rel=0.02)
    blind = replace(search, fits=tuple(f for f in search.fits if "second_beam_mode" not in f.hypothesis.names))
    assert verdict_of(judge(blind)) in ("unknown", "ambiguous")


def test_a_resonance_beside_a_limit_shows_in_what_the_limit_leaves():
    """A mount of 55 Hz: against tolerances alone the records stand out where a current that saturates makes them."""
    mount = {"frequency_Hz": 55.0, "stiffness_N_per_m": 1e8, "damping_ratio": 0.02}
    data = measured(believed().but(effects={"mount_compliance": mount, "current_saturation": {"limit_A": 0.006}}))
    data = only(data, ("command_large", "disturbance_small", "disturbance_large", "payload_disturbance"))
    pieces, rig = record_evidence(data), data.prototype
    null = fit_from_starts(NOTHING, rig, pieces, {})
    limited = fit_from_starts(together("current_saturation"), rig, pieces, null.values)
    both = together("current_saturation", "mount_compliance")
    peaks = resonances(pieces, rig, limited.values, both)
    assert min(abs(peak / 55.0 - 1) for peak in peaks) < 0.05
    found = fit_from_starts(both, rig, pieces, limited.values, peaks)
    assert found.values["mount_compliance.frequency_Hz"] == pytest.approx(55.0, rel=0.01)
    assert found.misfit < 1.2 * sum(piece.expected for piece in pieces) < 0.1 * limited.misfit


def test_curvatures_that_swamp_the_priors_break_nothing():
    """Rank one, far above the priors' ones: det(I + s vv') = 1 + s v'v (matrix determinant lemma)."""
    unknowns = NOTHING.unknowns(believed())
    steep = np.zeros((len(unknowns), len(unknowns)))
    steep[:2, :2] = 1e24
    z = np.zeros(len(unknowns))
    one = Fit(NOTHING, unknowns, z, 0.0, (Share(10.0, z, steep),))
    assert evidence(one, 1.0) == pytest.approx(-0.5 * (10.0 + np.log(1 + 2e24)), rel=1e-9)
    assert np.all(np.isfinite(one.covariance))
    assert np.isfinite(held_out_score(one, (0,), 1.0))
