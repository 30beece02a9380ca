"""What a model of an actuator bench predicts of a data set, from its commands alone, against closed forms."""

from pathlib import Path

import numpy as np
import pytest
from bench_records import MEAN, STROKE, SUPPLY, Truth, write_set

from beamdesign import InputError, predict, read_bench_prototype, read_prototype

VOLTS, FLOW_GAIN = 2.0, 9e-6
TWIN = Path(__file__).parents[1] / "studies/prototypes/tame_lag.toml"


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of one command, by two runs with the pressure of either side."""
    folder = write_set(tmp_path_factory.mktemp("bench") / "set", Truth(), (VOLTS,))
    lines = (folder / "dataset.toml").read_text().splitlines()
    (folder / "dataset.toml").write_text("\n".join(lines[:11]) + "\n")
    return folder


def test_a_linear_valve_moves_the_piston_by_its_flow_over_the_area(bench: Path) -> None:
    """Without friction and load both chambers are at one pressure meanwhile; stops hold the piston at either end."""
    found = predict(bench / "prototype.toml", bench)
    one, other = found.records
    assert [record.name for record in found.records] == ["2V_a_1", "2V_b_1"]
    np.testing.assert_array_equal(one.samples, other.samples)  # of one command
    times, x = (one.column(name) for name in ("t_s", "displacement_m"))
    command = np.loadtxt(bench / "records/2V_a_1.csv", delimiter=",", skiprows=1, usecols=1)
    a, b = (one.column(f"pressure_{side}_Pa") for side in "ab")
    speed = FLOW_GAIN * VOLTS / MEAN
    for sign in (1, -1):
        begun = int(np.argmax(np.sign(command) == sign))
        moving = (times > times[begun] + 0.25 * STROKE / speed) & (times < times[begun] + 0.75 * STROKE / speed)
        assert np.polyfit(times[moving], x[moving], 1)[0] == pytest.approx(sign * speed, rel=2e-3)
        assert abs(np.median((a - b)[moving])) < 1e-2 * SUPPLY
    assert np.ptp(x) == pytest.approx(STROKE, rel=5e-3)


def test_a_model_of_another_kind_of_rig_is_refused(bench: Path) -> None:
    with pytest.raises(InputError, match="is a twin beam, and the data set is of a bench"):
        predict(read_prototype(TWIN), bench)
    with pytest.raises(InputError, match="is a bench, and the data set is of a twin beam"):
        predict(read_bench_prototype(bench / "prototype.toml"), TWIN.parents[1] / "gaps/slow_sensor")


@pytest.mark.parametrize(
    ("before", "after", "reason"),
    [
        ("[[record]]", "[[other]]", "the set holds no time record to predict"),
        ("2V_a_1.csv", "2V_a_7.csv", "record.file"),
        ("records/2V_a_1.csv", "records/bare.csv", "command_V: column missing"),
        ("records/2V_a_1.csv", "records/short.csv", "t_s: too short: 3 samples"),
    ],
)
def test_what_holds_no_commands_is_refused(bench: Path, tmp_path: Path, before: str, after: str, reason: str) -> None:
    (tmp_path / "records").mkdir()
    for file in (bench / "records").iterdir():
        (tmp_path / "records" / file.name).symlink_to(file)
    (tmp_path / "records/bare.csv").write_text("t_s,displacement_m\n0,0\n0.001,0\n0.002,0\n0.003,0\n")
    (tmp_path / "records/short.csv").write_text("t_s,command_V\n0,0\n0.001,0\n0.002,0\n")
    (tmp_path / "dataset.toml").write_text((bench / "dataset.toml").read_text().replace(before, after))
    with pytest.raises(InputError, match=reason):
        predict(bench / "prototype.toml", tmp_path)
