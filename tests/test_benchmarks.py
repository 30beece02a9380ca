"""The table of the benchmarks: every row is there, and what it says that grids miss is so. No time is asserted."""

import json
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import side_by_side
from grids import stable_stretches
from side_by_side import lightly_damped, narrowed, unstable_width

from beamdesign import Prototype, read_prototype, state_space
from beamdesign.loop import loop
from beamdesign.polynomial import exact, is_hurwitz

ROOT = Path(__file__).parent.parent

REMEDY = read_prototype(ROOT / "studies" / "prototypes" / "paper_remedy.toml")
LIMIT = REMEDY.goal.peak_sensitivity


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Rows by name, from one quick run, with the printed table."""
    path = tmp_path_factory.mktemp("benchmarks") / "table.json"
    with redirect_stdout(StringIO()) as printed:
        side_by_side.main(["--quick", "--json", str(path)])
    rows = {row["row"]: row["methods"] for row in json.loads(path.read_text(encoding="utf-8"))}
    return {"printed": printed.getvalue(), **rows}


def facts(methods: list[dict[str, Any]], name: str) -> dict[str, float]:
    (found,) = [method["facts"] for method in methods if name in method["name"]]
    return found


def growth(prototype: Prototype, mass_kg: float) -> float:
    """Largest real part of any closed-loop pole, from the package's own state space."""
    return float(state_space(prototype, mass_kg).poles().real.max())


def test_every_row_stands_in_the_table_with_its_ratios(run: dict[str, Any]) -> None:
    assert {"printed", *side_by_side.ROWS} == set(run)
    assert len(run["printed"].splitlines()[0].split()) == 6  # wall, CPU, and the ratio of each
    for row in side_by_side.ROWS:
        first = run[row][0]
        assert first["name"].startswith("proof")
        assert first["misses"] == ""
        assert first["ratio"] == {"wall_s": 1.0, "cpu_s": 1.0}
        for method in run[row]:
            assert method["name"] in run["printed"]
            assert method["ratio"]["wall_s"] == pytest.approx(method["cost"]["wall_s"] / first["cost"]["wall_s"])
        for method in run[row][1:]:
            assert method["misses"] or method["name"].startswith("  ")


def test_margins_read_the_remedy_wrongly_although_each_is_right(run: dict[str, Any]) -> None:
    sweep, grid = facts(run["ranges"], "python-control"), facts(run["ranges"], "numpy")
    assert "stable 1.968442 to 17.79211 kg" in run["ranges"][0]["answer"]
    assert sweep["margin_disagreement"] < 1e-7
    assert sweep["read_stable_but_unstable"] > 0
    assert sweep["read_unstable_but_stable"] > 0
    assert growth(REMEDY, 19.0) > 0
    assert growth(REMEDY, 17.0) < 0
    assert grid["read_stable_but_unstable"] == grid["read_unstable_but_stable"] == 0
    assert 0 < grid["crossing_error_kg"] <= 20 / 1999


def test_grids_do_not_see_a_gram(run: dict[str, Any]) -> None:
    for name in ("python-control", "numpy"):
        found = facts(run["window"], name)
        assert (found["crossings"], found["edges"]) == (2, 0)
        assert found["read_stable_but_unstable"] == found["read_unstable_but_stable"] == 0
    thin = narrowed(REMEDY, side_by_side.WINDOW_KG)
    assert unstable_width(thin) == pytest.approx(side_by_side.WINDOW_KG, rel=1e-2)  # the gain has 12 digits
    family = loop(thin).characteristic
    assert [is_hurwitz(family.at(exact(mass))) for mass in (4.242, 4.243, 4.244)] == [True, False, True]
    assert growth(thin, 4.243) > 0
    assert facts(run["window"], "proof")["growth"] == pytest.approx(growth(thin, 4.243), rel=0.1)


def test_sampled_figures_lie_within_the_proved_ones(run: dict[str, Any]) -> None:
    for row in ("performance", "peak"):
        proved = facts(run[row], "proof")
        assert facts(run[row], "python-control")["peak_sensitivity"] <= proved["peak_sensitivity"]
        assert facts(run[row], "responses")["peak_sensitivity"] <= proved["peak_sensitivity"]
        assert facts(run[row], "responses")["bandwidth_Hz"] == pytest.approx(proved["bandwidth_Hz"], rel=1e-3)


def test_a_frequency_grid_underestimates_a_sharp_peak(run: dict[str, Any]) -> None:
    proved, seen = (facts(run["peak"], name)["peak_sensitivity"] for name in ("proof", "responses"))
    assert seen < 0.97 * proved
    gain = 0.9 * narrowed(REMEDY, side_by_side.WINDOW_KG).controller.gain_A_per_V
    closed = loop(lightly_damped(REMEDY, float(f"{gain:.6g}")))
    exact_peaks = [closed.at(float(mass)).peak_sensitivity() for mass in np.linspace(4.0, 4.5, 11)]
    assert max(exact_peaks) <= proved <= 1.0005 * max(exact_peaks)


def test_the_tuner_is_never_worse_than_what_the_search_is_worth(run: dict[str, Any]) -> None:
    tuned, searched = facts(run["tuner"], "tune"), facts(run["tuner"], "differential_evolution")
    assert tuned["peak_sensitivity"] <= LIMIT
    assert tuned["proved_bandwidth_Hz"] >= searched["proved_bandwidth_Hz"]
    assert searched["sampled_peak_sensitivity"] < 1.001 * LIMIT < searched["peak_sensitivity"]
    assert searched["keeps_limit"] == 0


@pytest.mark.parametrize("row", ["candidates", "neighbours"])
def test_eigenvalues_of_random_candidates_agree_with_the_proofs(run: dict[str, Any], row: str) -> None:
    assert 0 < facts(run[row], "proof")["stable"] <= facts(run[row], "proof")["candidates"]
    assert facts(run[row], "numpy")["judged_otherwise"] == 0


@pytest.mark.parametrize("arguments", [["nonsense"], ["--repeats", "0"]])
def test_bad_arguments_are_refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        side_by_side.main(arguments)
    assert stopped.value.code == 2
    assert arguments[0].strip("-") in capsys.readouterr().err


@pytest.mark.parametrize(
    ("stable", "stretches"),
    [
        ([True, True, True, True], [(0.0, 3.0)]),
        ([False, True, True, False], [(0.5, 2.5)]),
        ([True, False, False, True], [(0.0, 0.5), (2.5, 3.0)]),
        ([False, False, False, False], []),
    ],
)
def test_stretches_of_a_grid(stable: list[bool], stretches: list[tuple[float, float]]) -> None:
    assert stable_stretches(np.arange(4.0), np.array(stable)) == stretches
