"""The shipped data set of a slow sensor with fewer rows, and its diagnosis among all causes."""

import shutil
from itertools import islice
from pathlib import Path

from typer.testing import CliRunner

from beamdesign.cli import app

ASKED = "--redesign", "--workers", "1", "--minutes", "60"
SLOW_SENSOR = Path(__file__).parents[1] / "studies" / "gaps" / "slow_sensor"


def shortened(target: Path, rows: int = 1201) -> Path:
    """The shipped data set with the first rows of each record."""
    shutil.copytree(SLOW_SENSOR, target)
    for path in (target / "records").iterdir():
        with open(path, encoding="utf-8") as file:
            kept = list(islice(file, rows + 1))
        path.write_text("".join(kept), encoding="utf-8")
    return target


def diagnose(base: Path) -> None:
    """Run the whole command, its redesign by one start: data in `slow_sensor`, results in `out`, `answer.json`.

    The report has captions alone: `test_gap_report.py` and the notebook of one's own link look at pictures.
    """
    from one_start import best_start_alone, captions_alone  # which load what few tests need

    data, answer = shortened(base / "slow_sensor"), base / "answer.json"
    args = ["gap", "diagnose", str(data), "--out", str(base / "out"), *ASKED, "--json", str(answer)]
    with best_start_alone(), captions_alone():
        found = CliRunner().invoke(app, args)
    assert found.exit_code == 0, found.output
    assert "caused by sensor_lag" in found.output
