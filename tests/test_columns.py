"""CSV files of numbers, wherever they are read: what cannot be is refused with file, column and row."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded_rig import Recorded, recorded

from beamdesign import InputError, Prototype, columns, predict, read_bench_set, read_dataset, read_scenario
from beamdesign.columns import LARGEST, read_columns, uniform_times
from beamdesign.diagnosis.predict import read_inputs
from beamdesign.report.charts import TradePoint, read_trade
from beamdesign.scenario import inputs_from_csv

TIMES = np.arange(100) * 1e-3
SHARED_BENCH = Path(__file__).parents[2] / "shared" / "real" / "servo-cylinder"


def table(names: str, rows: list[list[str]]) -> str:
    return names + "\n" + "".join(",".join(row) + "\n" for row in rows)


def inputs_text() -> str:
    return table("t_s,disturbance_N,command_V", [[repr(t), repr(3 * t), "0.5"] for t in TIMES.tolist()])


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda t: t.replace("command_V", "disturbance_N", 1), "disturbance_N: stands twice in row 1"),
        (lambda t: t.replace(",", ";"), "separated by semicolons"),
        (lambda t: t.replace(",0.5\n", ",0,5\n").replace("0.0,0.0", "0,0,0,0", 1), "row 2 has 6 cells, the header 3"),
        (lambda t: t.replace(",0.5\n", ",half\n", 1), "command_V: row 2 is not a number: 'half'"),
        (lambda t: t.replace(",0.5\n", ",nan\n", 1), "command_V: 1 value is not finite, the first in row 2"),
        (lambda t: t.replace("\n0.05,", "\n0.0503,", 1), "t_s: not uniform: row 52"),
        (lambda t: t.replace(",0.5\n", ",1e308\n", 1), "command_V: row 2 is 1e+308"),
        (lambda t: t.replace("t_s", "t_ms"), "needs t_s"),
        (lambda t: "\n".join(t.split("\n")[:50]), "sample times of the scenario"),
    ],
    ids=["twice", "semicolons", "decimals", "word", "nan", "times", "beyond", "no times", "short"],
)
def test_a_scenario_s_file_is_read_as_a_data_set_s_is(spoil, words: str, tmp_path: Path):
    file = tmp_path / "in.csv"
    file.write_text("\ufeff" + inputs_text())
    read = inputs_from_csv(file, TIMES)
    assert np.array_equal(read, np.column_stack([3 * TIMES, np.full(100, 0.5)]))
    file.write_text(spoil(inputs_text()))
    with pytest.raises(InputError) as caught:
        inputs_from_csv(file, TIMES)
    assert words in str(caught.value)
    (tmp_path / "s.toml").write_text(
        'name = "s"\nduration_s = 0.099\nsample_s = 1e-3\n[[record]]\nname = "a"\n'
        'input = [{ kind = "csv", file = "in.csv" }]\n'
    )
    with pytest.raises(InputError) as caught:
        read_scenario(tmp_path / "s.toml")
    assert [problem.key for problem in caught.value.problems] == ["record.0.input.0.file"]
    assert words in caught.value.problems[0].reason


def test_only_regular_files_of_some_size_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "large.csv").write_text(inputs_text())
    monkeypatch.setattr(columns, "LARGEST_TABLE", 1000)
    wrong = {
        tmp_path / "pipe.csv": "a pipe", Path("/dev/zero"): "a device", tmp_path: "directory",
        tmp_path / "large.csv": "MB", tmp_path / "none.csv": "No such file", tmp_path / "\0": "null",
    }  # fmt: skip
    for path, words in wrong.items():
        for read in (read_columns, lambda path: inputs_from_csv(path, TIMES)):
            with pytest.raises(InputError, match=words) as caught:
                read(path)
            assert caught.value.problems[0].key == "(file)"


@pytest.mark.parametrize("file", ["/dev/zero", "pipe.csv", "..", "", "x" * 300])
def test_a_data_set_of_a_device_or_a_pipe_is_refused(file: str, paper: Prototype, tmp_path: Path):
    sound = recorded(paper)
    os.mkfifo(tmp_path / "pipe.csv")
    sound.entry("steps")["file"] = file
    folder = sound.write(tmp_path)
    for read in (read_dataset, read_inputs):
        with pytest.raises(InputError, match=r"record.file: entry 3: no (regular )?file"):
            read(folder)


@given(
    column=st.sampled_from(
        ["displacement_m", "current_A", "disturbance_N", "command_V", "load_pressure_Pa", "pressure_a_Pa", "t_s",
         "frequency_Hz", "magnitude_m_per_N", "phase_deg", "displacement_filtered_m"]
    ),
    row=st.integers(0, 19), sign=st.sampled_from([1, -1]), share=st.floats(1e-300, 1e290),
)  # fmt: skip
def test_what_no_rig_has_is_refused_by_the_unit_of_its_column(
    column: str, row: int, sign: int, share: float, tmp_path_factory: pytest.TempPathFactory
):
    largest, finer = LARGEST["m_per_N" if column.endswith("m_per_N") else column.rsplit("_", 1)[1]]
    value = sign * share * largest * finer
    file = tmp_path_factory.mktemp("a") / "a.csv"
    cells = [["0.001", "0.001"] for _ in range(20)]
    cells[row][1] = repr(value)
    file.write_text(table(f"other_m,{column}", cells))
    if share <= 1:
        assert read_columns(file)[column][row] == value
        return
    with pytest.raises(InputError) as caught:
        read_columns(file)
    [(key, reason)] = caught.value.problems
    assert key == column
    assert reason.startswith(f"row {row + 2} is {value:g}:")
    assert f"to {largest:g}" in reason


@pytest.mark.parametrize(
    ("cell", "value"),
    [("1", 1.0), ("-0.5", -0.5), ("1e-3", 1e-3), (" 2 ", 2.0), ("\t3", 3.0)]
    + [(cell, None) for cell in ("nan", "inf", "", "x", "1_0", "0x1p3", '"1"', "1;2", "1,2", "\ufeff1", "1e999")],
)
def test_a_cell_is_a_finite_number_or_refused_by_its_row(cell: str, value: float | None, tmp_path: Path):
    file = tmp_path / "a.csv"
    file.write_text(table("a,b", [["0", "1"], ["5", cell]]))
    if value is not None:
        assert read_columns(file)["b"].tolist() == [1.0, value]
        return
    with pytest.raises(InputError, match="row 3"):
        read_columns(file)


def test_columns_that_do_not_count_may_hold_anything(tmp_path: Path):
    (tmp_path / "a.csv").write_text("t_s,note,command_V\n0,hm,1\n1,,2\n")
    read = read_columns(tmp_path / "a.csv", only=("t_s", "command_V", "disturbance_N"))
    assert {name: values.tolist() for name, values in read.items()} == {"t_s": [0, 1], "command_V": [1, 2]}
    assert read_columns(tmp_path / "a.csv", only=("disturbance_N",)) == {}


@pytest.mark.parametrize(
    ("factor", "words"),
    [(1e3, "milliseconds"), (1e6, "microseconds"), (1 / 86_400, "days"), (1e9, "plausible"), (40.0, "plausible")],
)
def test_times_in_another_unit_are_named(factor: float, words: str, tmp_path: Path):
    times = np.arange(200) * 1e-3
    uniform_times(tmp_path, times)
    with pytest.raises(InputError, match=words) as caught:
        uniform_times(tmp_path, factor * times)
    assert caught.value.problems[0].key == "t_s"


@pytest.fixture
def sound(paper: Prototype) -> Recorded:
    return recorded(paper)


def test_a_prediction_of_times_in_milliseconds_is_refused_and_a_long_one_too(
    sound: Recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    said: list[tuple[float, str]] = []
    folder = sound.write(tmp_path)
    found = predict(tmp_path / "prototype.toml", folder, lambda share, text: said.append((share, text))).records
    assert [record.name for record in found] == list(sound.columns)
    assert [share for share, _ in said] == [0, 0.25, 0.5, 0.75]
    assert said[1][1] == "command, 1.2 s"
    monkeypatch.setattr("beamdesign.plant.equilibrium.MOST_STEPS", 10_000)
    with pytest.raises(InputError, match="integration steps"):
        predict(tmp_path / "prototype.toml", folder)
    sound.columns["steps"]["t_s"] = 1e3 * sound.columns["steps"]["t_s"]
    with pytest.raises(InputError, match="milliseconds") as caught:
        predict(tmp_path / "prototype.toml", sound.write(tmp_path))
    assert caught.value.source.endswith("steps.csv")


def test_a_force_that_a_prediction_takes_for_noise_is_told(sound: Recorded, tmp_path: Path):
    command = sound.columns["command"]
    command["disturbance_N"] = 3.0 * np.random.default_rng(1).standard_normal(len(command["t_s"]))
    folder = sound.write(tmp_path)
    found = predict(folder / "prototype.toml", folder)
    assert found.noise_N == {"command": pytest.approx(3.0, rel=0.1)}
    told = {name: words for name, *_, words in found.rows()}
    assert told["command"] == f"complete; {found.noise_N['command']:.3g} N rms taken for noise of the load cell"
    assert all(words == "complete" for name, words in told.items() if name != "command")


def test_records_that_would_be_told_apart_by_nothing_are_refused(sound: Recorded, tmp_path: Path):
    folder = sound.write(tmp_path)
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "steps.csv").write_text((folder / "records" / "steps.csv").read_text())
    sound.entry("command")["file"] = "./records/force.csv"
    sound.index["record"].append(sound.entry("steps") | {"file": "more/steps.csv"})
    with pytest.raises(InputError) as caught:
        read_dataset(sound.write(tmp_path))
    reasons = [problem.reason for problem in caught.value.problems]
    assert [problem.key for problem in caught.value.problems] == ["record.file"] * 2
    assert reasons[0].startswith("entry 2: ./records/force.csv is the same file as entry 1")
    assert reasons[1].startswith("entry 5: more/steps.csv is called like records/steps.csv of entry 3")


def test_ten_thousand_files_that_are_not_there_are_refused_in_a_few_lines(sound: Recorded, tmp_path: Path):
    sound.index["record"] = [{"file": f"records/{k}.csv"} for k in range(10_000)]
    with pytest.raises(InputError) as caught:
        read_dataset(sound.write(tmp_path))
    assert len(caught.value.problems) == 21
    assert "10000" not in caught.value.problems[0].reason
    assert "9980 entries from 21 on" in caught.value.problems[-1].reason


FRONT = "proved,outer_end_mass_high_kg,bandwidth_Hz,moving_mass_kg\nTrue,1,20,3\nFalse,,,\n"


@pytest.mark.parametrize(
    "text",
    ["", "\0", FRONT + "True,1\n", FRONT + "True,1,inf,2\n", FRONT + 'True,"' + "x" * 200_000, FRONT + "True,1,a,2\n"],
    ids=["empty", "zero byte", "row ends early", "infinite", "long cell", "word"],
)
def test_trade_curves_that_cannot_be_read_are_none(text: str, tmp_path: Path):
    (tmp_path / "front.csv").write_text(FRONT)
    assert read_trade(tmp_path) == (TradePoint(1, 20, 3),)
    (tmp_path / "front.csv").write_text(text)
    assert read_trade(tmp_path) == ()


def test_trade_curves_are_not_read_from_a_pipe(tmp_path: Path):
    os.mkfifo(tmp_path / "front.csv")
    assert read_trade(tmp_path) == ()


@pytest.mark.skipif(not SHARED_BENCH.is_dir(), reason="needs the measured set")
def test_a_measured_set_is_read_as_ever():
    found = read_bench_set(SHARED_BENCH)
    assert len(found.runs) == 12
    assert len(found.warnings) == 12
    assert all("displacement_m is clipped at 0.199976" in words for words in found.warnings)
