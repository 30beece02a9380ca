"""Tolerances, worst case, sensitivity and yield: against closed forms, published figures and the proofs."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from beamdesign import InputError, certify, read_prototype
from beamdesign.prototype import prototype_from
from beamdesign.structure.lumped import figures
from beamdesign.sweep.case import governing
from beamdesign.sweep.conclusion import conclude, holds, in_words
from beamdesign.sweep.methods import ADAPTIVE, CUT_SIGMAS, Figure, drawn, from_unit, saltelli, spreading, varied_at
from beamdesign.sweep.sweep_file import Demand, with_value
from beamdesign.sweep.sweep_run import plan, run_sweep
from beamdesign.validation.bounds import clopper_pearson

TAME = Path(__file__).parents[1] / "studies" / "prototypes" / "tame_lag.toml"


@pytest.fixture
def sweep(tmp_path):
    def write(method, cases=8, **tables):
        study = {"task": "robust", "base": str(TAME), "method": method, "cases": cases, "seed": 2}
        path = tmp_path / f"{method}.toml"
        path.write_text(tomli_w.dumps({"name": method, "study": study} | tables), encoding="utf-8")
        return path

    return write


def test_every_figure_with_a_tolerance_spreads_once():
    rig = read_prototype(TAME)
    found = {figure.key: figure for figure in spreading(rig, {})}
    assert len(found) == 13  # six of the beams, five of hydraulics, the valve's damping, the sensor; no end mass
    assert found["outer_beam.stiffness_N_per_m"].value == 486_800.0
    more = {figure.key: figure for figure in spreading(rig, {"outer_end_mass": 0.01, "inner_end_mass": 0.02})}
    assert more["payload.outer_end_mass_kg"].at(2.0) == [0.0, pytest.approx(6.8 * 1.02)]
    assert more["payload.inner_end_mass_kg"].at(-1.0) == pytest.approx(2.5 * 0.98)


def test_spread_figures_are_those_of_the_linear_model():
    """One standard deviation of every figure, put in by its key, shows in the lumped figures."""
    rig = read_prototype(TAME)
    spread = spreading(rig, {})
    table = rig.model_dump(mode="json", exclude_none=True)
    for key, value in varied_at(spread, np.ones(len(spread))).items():
        table = with_value(table, key, value)
    share = {name: value / figures(rig)[name] for name, value in figures(prototype_from(table)).items() if value}
    assert share["outer_stiffness"] == pytest.approx(1.03)
    assert share["inner_mass"] == pytest.approx(1.02)
    assert share["inner_damping"] == pytest.approx(1.2 * (1.03 * 1.02) ** 0.5)
    assert share["valve_frequency"] == pytest.approx(1.05)


@pytest.mark.parametrize(("instead", "words"), [({"stifness": 0.1}, "unknown"), ({"leakage": 0.3}, "reach zero")])
def test_tolerances_that_cannot_be_are_told(instead, words):
    with pytest.raises(InputError, match=words):
        spreading(read_prototype(TAME), instead)


@pytest.mark.parametrize(
    ("method", "spread", "most"),
    [("tolerance", {}, 0.24), ("sensitivity", {"outputs": ["bandwidth_Hz"]}, 0.24),
     ("worst_case", {"output": "bandwidth_Hz", "sigmas": 3.0}, 0.33),
     ("worst_case", {"output": "bandwidth_Hz", "sigmas": 10.0}, 0.099)],
)  # fmt: skip
def test_deviations_that_reach_zero_are_told_with_what_to_write(sweep, method, spread, most):
    """What is to be written is taken, and a twentieth more is not."""

    def refused(damping):
        kept = dict.fromkeys(type(read_prototype(TAME).tolerance).model_fields, 0.01) | {"beam_damping_ratio": damping}
        try:
            plan(sweep(method, 128, spread=spread | {"tolerance": kept}))
        except InputError as error:
            return {problem.key: problem.reason for problem in error.problems}
        return {}

    words = f"write beam_damping_ratio = {most}, or less, under [spread.tolerance] in the sweep file"
    found = refused(0.5)
    assert found.keys() == {"outer_beam.damping_ratio", "inner_beam.damping_ratio"}
    assert all(words in reason for reason in found.values())
    assert refused(most) == {}
    assert refused(1.05 * most)


def test_prototype_without_tolerances_has_nothing_to_spread():
    with pytest.raises(InputError, match="no standard deviation"):
        spreading(read_prototype(TAME.parent / "paper_remedy.toml"), {})


def test_draws_are_normal_and_cut():
    sigmas = drawn([Figure("a", 1.0, 0.1), Figure("b", 1.0, 0.1)], 20_000, 0)
    assert abs(sigmas).max() <= CUT_SIGMAS
    # Of 40 000: mean within 4 and variance within 4 standard errors, and no correlation.
    assert abs(sigmas.mean()) < 4 / 200
    assert abs(sigmas.var() - 1) < 4 * (2 / 40_000) ** 0.5 + 0.002
    assert abs(np.corrcoef(sigmas.T)[0, 1]) < 4 / 20_000**0.5
    assert from_unit(np.array([0.5])) == pytest.approx([0.0])


def test_a_check_that_uses_nothing_of_its_limit_is_not_the_most_used():
    """One whose limit is zero, such as a clearance that is not asked for; None stands for one beyond any share."""
    used = {"none": 0.0, "half": 0.5, "beyond": None}
    checks = [{"name": name, "utilisation": share} for name, share in used.items()]
    found = governing({"details": {"checks": checks}})
    assert [check["name"] for check in found["checks"]] == ["beyond", "half", "none"]
    assert found["binding"] == ["beyond"]


def test_bounds_are_those_of_clopper_and_pearson():
    """Biometrika 26 (1934), 410: of 10 trials none gives 0 to 0.31, 5 gives 0.19 to 0.81 at 95 %."""
    assert clopper_pearson(0, 10, 0.95) == pytest.approx((0.0, 0.31), abs=0.005)
    assert clopper_pearson(5, 10, 0.95) == pytest.approx((0.19, 0.81), abs=0.005)


def test_demands():
    assert holds(Demand(at_least=1.0, at_most=2.0), 1.5)
    assert not holds(Demand(at_least=1.0, at_most=2.0), 2.5)
    assert not holds(Demand(at_least=1.0), None)
    assert holds(Demand(equals=True), True)
    assert not holds(Demand(at_least=0.0), "text")


def test_monte_carlo_tells_yield_with_bounds_and_each_row_is_proved(sweep, tmp_path):
    demands = {"stable": {"equals": True}, "bandwidth_Hz": {"at_least": 3.45}}
    laid = plan(sweep("tolerance", 12, specification=demands))
    found = run_sweep(laid, tmp_path / "out")
    result = conclude(laid, found.records)
    met = result["specification"]
    own = sum(row["outputs"]["bandwidth_Hz"] >= 3.45 for row in found.records)
    assert (met["met"], met["of"]) == (own, 12)
    assert met["bounds"] == list(clopper_pearson(own, 12, 0.95))
    words = " ".join(in_words(result, laid.sweep))
    assert "sampled" in words
    assert "is proved" not in words  # nor are the figures of other tasks, such as `limits`, in a single rig
    row = found.records[3]
    proved = certify(prototype_from(row["document"]), 0.0, 6.8)
    assert proved.guaranteed is not None
    assert row["outputs"]["bandwidth_Hz"] == proved.guaranteed.bandwidth_Hz
    assert len({json.dumps(record["varied"]) for record in found.records}) == 12


@pytest.mark.parametrize(
    ("met", "words"),
    [(10_000, "yield 100 %, 95 % bounds 99.9 to 100 %"), (9_999, "yield 99.9 %, 95 % bounds 99.9 to 100 %"),
     (2_900, "yield 29 %, 95 % bounds 28.1 to 30 %")],
)  # fmt: skip
def test_a_yield_is_told_no_better_than_it_is(sweep, met, words):
    """Of 10 000 that all meet it the lower bound is 0.025^(1/10 000), 99.963 %, which was told as 100 %."""
    bounds = list(clopper_pearson(met, 10_000))
    found = {"met": met, "of": 10_000, "each": {}, "yield": met / 10_000, "bounds": bounds, "confidence": 0.95}
    assert words in in_words({"specification": found}, plan(sweep("tolerance")).sweep)[0]


def test_a_case_without_the_figure_does_not_end_the_search_for_the_worst(sweep):
    """That a good rig has no such figure, such as a mass at which it is unstable, is no answer of no."""
    laid = plan(sweep("worst_case", cases=60, spread={"sigmas": 1.0, "output": "bandwidth_Hz", "worst": "least"}))
    batches = []

    def answers(cases):
        batches.append(len(cases))
        figures = [None, *np.linspace(10.0, 20.0, len(cases) - 1)]
        return [{"status": "done", "outputs": {"bandwidth_Hz": figure}} for figure in figures]

    ADAPTIVE["worst_case"](laid, answers)
    assert len(batches) > 1


def test_worst_case_is_worse_than_every_sample_of_the_box_and_not_called_proved(sweep, tmp_path):
    spread = {"sigmas": 1.0, "output": "bandwidth_Hz", "worst": "least", "rounds": 3}
    laid = plan(sweep("worst_case", spread=spread))
    found = run_sweep(laid, tmp_path / "out")
    worst = conclude(laid, found.records)["worst"]
    spread_figures = spreading(read_prototype(TAME), {})
    for key, value in worst["varied"].items():  # it is a corner
        (figure,) = (figure for figure in spread_figures if figure.key == key)
        assert abs(value / figure.value - 1) == pytest.approx(figure.deviation)
    table = read_prototype(TAME).model_dump(mode="json", exclude_none=True)
    rng = np.random.default_rng(0)
    for _ in range(20):
        sample = table
        for key, value in varied_at(spread_figures, rng.uniform(-1, 1, len(spread_figures))).items():
            sample = with_value(sample, key, value)
        held = certify(prototype_from(sample), 0.0, 6.8).guaranteed
        assert held is not None
        assert held.bandwidth_Hz > worst["value"]
    assert "no proof" in " ".join(in_words({"worst": worst}, laid.sweep))
    assert run_sweep(laid, tmp_path / "out").computed == 0


def test_scheme_of_saltelli_has_its_size():
    assert len(saltelli(13, 70, 0)) == 4 * 15
    assert len(saltelli(3, 1, 0)) == 2 * 5


def test_too_few_cases_for_any_index_are_refused(sweep):
    with pytest.raises(InputError, match="29 are too few: the indices of 13 figures take 30"):
        plan(sweep("sensitivity", 60, spread={"outputs": ["bandwidth_Hz"]}), 29)


def test_without_its_extra_a_sensitivity_is_refused(sweep, monkeypatch):
    monkeypatch.setitem(sys.modules, "SALib.sample", None)
    with pytest.raises(InputError, match=r"study\.method: .*beamdesign\[sensitivity\]"):
        plan(sweep("sensitivity", 60, spread={"outputs": ["bandwidth_Hz"]}), None)


def test_indices_of_an_additive_function_are_its_shares_of_variance(sweep, tmp_path, monkeypatch):
    """y = sum of (k + 1) z_k over standard deviations z: first-order and total index are (k + 1)^2 over their sum."""
    laid = plan(sweep("sensitivity", 13 * 300, spread={"outputs": ["bandwidth_Hz"]}), None)
    spread = spreading(read_prototype(TAME), {})
    weights = np.arange(1, len(spread) + 1)

    def row(one):
        sigmas = [(one.varied[figure.key] / figure.value - 1) / figure.deviation for figure in spread]
        y = float(weights @ sigmas)
        return {"address": one.address, "status": "done", "reason": "", "outputs": {"bandwidth_Hz": y}}

    found = conclude(laid, [row(one) for one in laid.cases])["sensitivity"]
    shares = weights**2 / (weights**2).sum()
    for result, share in zip(found, shares, strict=True):
        assert result["total"] == pytest.approx(share, abs=0.02)
        assert result["first_order"] == pytest.approx(share, abs=0.03 + result["first_order_half_width"])


@pytest.mark.parametrize(("cases", "told"), [(30, False), (480, False), (1920, True)])
def test_half_widths_of_indices_are_told_where_they_hold(sweep, cases, told):
    """Of y = sum of z_k / (k + 1) the indices are known; few samples of a Sobol sequence bound none."""
    laid = plan(sweep("sensitivity", cases, spread={"outputs": ["bandwidth_Hz"]}), None)
    spread = spreading(read_prototype(TAME), {})
    weights = 1 / np.arange(1, len(spread) + 1)
    rows = []
    for one in laid.cases:
        y = sum(w * (one.varied[f.key] / f.value - 1) / f.deviation for w, f in zip(weights, spread, strict=True))
        rows.append({"address": one.address, "status": "done", "reason": "", "outputs": {"bandwidth_Hz": y}})
    result = conclude(laid, rows)
    assert any("1920 cases" in line for line in in_words(result, laid.sweep)) is not told
    for found, share in zip(result["sensitivity"], weights**2 / (weights**2).sum(), strict=True):
        for name in ("first_order", "total"):
            width = found[f"{name}_half_width"]
            assert (width is not None) is told
            assert width is None or abs(found[name] - share) <= width


def test_methods_over_tolerances_refuse_what_they_cannot_use(sweep):
    with pytest.raises(InputError, match=r"spread\.output"):
        plan(sweep("worst_case"))
    with pytest.raises(InputError, match="leave"):
        plan(sweep("tolerance", vary=[{"key": "sensor.gain_V_per_m", "values": [1.0]}]))
