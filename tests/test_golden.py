"""Commands give the figures that they gave: see `golden.py`, which also writes them anew."""

from pathlib import Path
from typing import Any

import golden
import pytest

pytestmark = pytest.mark.long


@pytest.mark.parametrize("name", golden.GOLDEN)
def test_figures_of_a_command_are_those_kept(name: str, tmp_path: Path) -> None:
    assert golden.differences(name, golden.kept(name), golden.run(name, tmp_path)) == []


@pytest.mark.parametrize(
    ("path", "kept", "near", "far"),
    [
        ("0.json:guaranteed.bandwidth_Hz", 3.5, 3.5000001, 3.50001),
        ("0.json:stable", True, True, 1),
        ("0.json:verdict", "ambiguous", "ambiguous", "effect"),
        ("0.json:witness", None, None, 0.0),
        ("certificate.toml:low", "34/5", "34/5", "34000000001/5000000000"),
        ("certificate.toml:stability.edge", "3/2", "1.5000001 0f0f0f0f", "1.50001"),
        ("out/push.csv:displacement_m", [1.0, 1e-9], [1.0, 2e-9], [1.0, 2e-6]),
        ("out/controller.c:FOLLOW1", [4585184.0], [4585184.0], [4585185.0]),
        ("switching.toml:claim[0].rate_kg_per_s", "2", "2.01", "2.05"),  # found by a search
    ],
)
def test_a_figure_may_move_within_its_tolerance(path: str, kept: Any, near: Any, far: Any) -> None:
    def told(**figures: Any) -> list[str]:
        outputs = [{"exit_status": [0], "figures": one} for one in ({path: kept}, figures)]
        return golden.differences("certify_switching", *outputs)

    assert told(**{path: near}, new=1.0) == []
    assert len(told(**{path: far})) == 1
    assert len(told()) == 1


def test_polynomials_of_one_equation_count_up_to_a_common_factor() -> None:
    figures = [
        dict(golden.figures({"polynomials": {"p0": [f"{2 * k}", f"{3 * k}"], "p1": [f"{k}/7"]}})) for k in (1, 5)
    ]
    assert figures[0] == figures[1] == {"polynomials.p0": ["1", "3/2"], "polynomials.p1": ["1/14"]}
    assert figures[0] != golden.figures({"polynomials": {"p0": ["2", "3"], "p1": ["1/8"]}})
