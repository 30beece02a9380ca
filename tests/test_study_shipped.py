"""Every sweep that is shipped, at small size: its rows, its picture, and what its subject is known to give."""

import json
import tomllib
from functools import partial
from pathlib import Path

import pytest
from pyarrow import parquet
from typer.testing import CliRunner

from beamdesign import certify, read_prototype
from beamdesign.cli.study import study
from beamdesign.diagnosis.fitting import search as searching
from beamdesign.diagnosis.fitting.hypothesis import Hypothesis
from beamdesign.sweep.case import TASKS, case
from beamdesign.sweep.sweep_file import read_sweep
from beamdesign.sweep.workers import compute
from beamdesign.synthesis import tuning
from beamdesign.synthesis.checks import REQUIREMENTS

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[1] / "studies"
SWEEPS = {path.stem: path for path in sorted((ROOT / "sweeps").glob("*.toml"))}


KINDS = {"numbers": (float, int), "yes or no": bool, "text": str, "lists": list}


def assert_declared(record):
    """Its task declares every output of a case, with what it holds."""
    columns = TASKS[record["task"]].columns
    for name, value in record["outputs"].items():
        assert name in columns
        assert value is None or isinstance(value, KINDS[columns[name]])
        assert isinstance(value, bool) == (value is not None and columns[name] == "yes or no")


@pytest.fixture
def rows(tmp_path, computed_here):
    """Runs a shipped sweep with no more cases than so many, and gives its rows and folder."""

    def run(name, cases, status=0):
        target = tmp_path / "fields.json"
        done = CliRunner().invoke(
            study,
            ["run", str(SWEEPS[name]), "--out", str(tmp_path / "out"), "--cases", str(cases), "--json", str(target)],
        )
        assert done.exit_code == status, (done.output, done.exception)
        fields = json.loads(target.read_text(encoding="utf-8"))
        assert not set(fields["counts"]) & {"failed", "refused"}
        assert all(Path(file).stat().st_size for file in fields["files"])
        pictures = [Path(file).name for file in fields["files"] if file.endswith(".svg")]
        for file in (tmp_path / "out" / "cases").iterdir():
            assert_declared(json.loads(file.read_text(encoding="utf-8")))
        assert len(pictures) == len(read_sweep(SWEEPS[name]).picture) + (name == "sensitivity")
        return parquet.read_table(tmp_path / "out" / "table.parquet").to_pylist(), fields

    return run


def test_each_is_run_here():
    here = Path(__file__).read_text(encoding="utf-8")
    assert len(SWEEPS) >= 8
    assert [name for name in SWEEPS if f'rows("{name}"' not in here] == []


@pytest.mark.parametrize(
    ("task", "options"),
    [("tune", {"controller": "structured", "sections": 1, "largest_inner_end_mass_kg": 0.0}),
     ("tune", {"controller": "proportional"}),
     ("at_mass", {"outer_end_mass_kg": 2.0}), ("limits", {"outer_end_mass_kg": 2.0}), ("certify", {})],
)  # fmt: skip
@pytest.mark.usefixtures("least_effort")
def test_tasks_that_no_shipped_sweep_uses_declare_their_outputs_too(task, options):
    table = tomllib.loads((ROOT / "prototypes" / "tame_lag.toml").read_text(encoding="utf-8"))
    if options.get("controller") == "structured":  # one payload and one figure that is off: a fraction of the work
        table["payload"] |= {"outer_end_mass_kg": [2.2, 2.2]}
        table["tolerance"] = {"flow_gain": 0.05}
    record = compute(case(task, table, options, {}))
    assert record["status"] in ("done", "no"), record["reason"]
    assert_declared(record)


def test_prices_are_declared():
    labels = {f"price_{one.price}" for one in REQUIREMENTS.values()}
    assert {name for name in TASKS["size"].columns if name.startswith("price_")} == labels | {"price_of_rounding_kg"}


@pytest.mark.usefixtures("one_start")
def test_paper_prototype(rows):
    (row,), _ = rows("paper_prototype", 1)
    assert row["load.tip_force_N"] == 2000.0
    assert row["bandwidth_Hz"] > 0
    assert row["moving_mass_kg"] == pytest.approx(row["beam_mass_kg"] + row["inner_end_mass_kg"])


@pytest.mark.usefixtures("least_effort")
def test_trade_curves(rows):
    (row,), _ = rows("trade_curves", 1)
    assert row["options.bandwidth_Hz"] == 4.0
    assert row["bandwidth_Hz"] >= 4.0
    assert row["moving_mass_kg"] < 14.6  # what the published tubes with 4.5 kg inside move


def test_lag_breaks(rows):
    found, _ = rows("lag_breaks", 9)
    for row in found:
        low = float(row["stable_zero_from_Hz"].split("; ")[0]) if row["stable_zero_from_Hz"] else None
        assert (row["status"] == "done") == (low is not None)
        assert low is None or low > row["controller.pole_Hz"]  # it is lag that the loop needs
    assert {row["status"] for row in found} == {"done", "no"}


def test_end_masses(rows):
    found, _ = rows("end_masses", 5)
    none, *_, most = found
    assert none["payload.inner_end_mass_kg"] == 0.0
    assert float(none["stable_to_kg"]) < 2.0
    remedy = read_prototype(ROOT / "prototypes" / "paper_remedy.toml")
    rig = remedy.but(payload=remedy.payload.but(inner_end_mass_kg=most["payload.inner_end_mass_kg"]))
    proved = certify(rig, 0.0, 30.0)
    assert float(most["stable_from_kg"]) == pytest.approx(proved.stable_ranges_kg[0][0])
    assert [float(part) for part in most["crossing_frequencies_Hz"].split("; ")] == pytest.approx(
        [crossing.frequency_Hz for crossing in proved.crossings]
    )


def test_remedies(rows):
    (row,), _ = rows("remedies", 1)
    # The paper's breaks without a remedy: a peak sensitivity of 2 with every payload leaves hardly any gain.
    assert row["peak_sensitivity"] <= 2
    assert row["bandwidth_Hz"] == pytest.approx(0.817, rel=0.01)
    assert float(row["gain_A_per_V"]) < 0.01


def test_materials(rows):
    found, _ = rows("materials", 3)
    strengths = {"6005A-T6": 200, "6063-T6": 160, "5083-H112": 110}  # MPa, EN 1999-1-1, Table 3.2b
    assert {row["outer_beam.material"] for row in found} == set(strengths)
    masses = [row["free_beam_mass_kg"] for row in sorted(found, key=lambda row: strengths[row["outer_beam.material"]])]
    assert masses == sorted(masses, reverse=True)  # of alloys as stiff and heavy, the stronger makes the lighter


def test_link_length(rows):
    found, _ = rows("link_length", 3)
    assert [row["outer_beam.length_m"] for row in found] == [0.5, 1.75, 3.0]
    masses = [row["beam_mass_kg"] for row in found]
    # A longer beam of the same section already weighs in proportion, and it needs a heavier section.
    assert masses[1] / masses[0] > 1.75 / 0.5
    assert masses[2] / masses[1] > 3.0 / 1.75


def test_tolerance(rows):
    found, fields = rows("tolerance", 20)
    assert len(found) == 20
    low, high = fields["conclusion"]["specification"]["bounds"]
    assert low < fields["conclusion"]["specification"]["yield"] <= high


def test_worst_case(rows):
    found, fields = rows("worst_case", 15)
    nominal = found[0]["bandwidth_Hz"]
    assert fields["conclusion"]["worst"]["value"] < nominal


def test_sensitivity(rows):
    _, fields = rows("sensitivity", 30)
    assert {row["output"] for row in fields["conclusion"]["sensitivity"]} == {"bandwidth_Hz", "stable_to_kg"}


def test_largest_bandwidth(rows):
    found, fields = rows("largest_bandwidth", 24)
    best = fields["conclusion"]["best"]
    if best is not None:
        assert found[best["case"]]["peak_sensitivity"] <= 2.0


@pytest.mark.usefixtures("one_start")
def test_sim_to_real(rows, monkeypatch):
    """Designed for exactly the figures stated, and of few causes to choose from.

    `test_robust_tuning.py` has a study designed within its tolerances, `slow_sensor.py` a rig diagnosed among all.
    """
    monkeypatch.setattr(tuning, "tune", partial(tuning.tune, sigmas=0.0))
    few = [Hypothesis((name,)) for name in ("sensor_lag", "transport_delay", "mount_compliance", "parameter:flow_gain")]
    monkeypatch.setattr(searching, "singles", lambda rig: tuple(few))
    (row,), _ = rows("sim_to_real", 1)
    assert row["options.effect"] == "sensor_lag"
    assert (row["verdict"], row["named"]) == ("effect", "sensor_lag")
    assert row["gap_after"] < row["gap_before"]
    assert row["redesign_runs"] is True
    assert row["redesign_gain_margin"] > 1


def test_arm_offset(rows):
    """Twist grows with the square of the offset, T L / G J times the lever, and the servos leave all of it."""
    found, _ = rows("arm_offset", 3)
    first, middle, last = found
    assert [row["arm.offset_m[1]"] for row in found] == pytest.approx([0.0, 0.15, 0.3])
    assert first["error_by_twist_m"] == 0.0
    assert last["error_by_twist_m"] == pytest.approx(4 * middle["error_by_twist_m"])
    assert last["twist_rad"] * 0.3 == pytest.approx(-last["error_by_twist_m"])
    assert all(row["stable"] and row["tip_bandwidth_Hz"] > 3.4 for row in found)
