"""`gap diagnose` and `gap predict`: files, fields, exit statuses, interruption."""

import json
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import active_children
from pathlib import Path

import numpy as np
import pytest
import typer
from slow_sensor import SLOW_SENSOR, shortened
from typer.testing import CliRunner

import beamdesign.diagnosis.fitting.fitters as fitters
import beamdesign.diagnosis.fitting.search as searching
from beamdesign import InputError, Prototype, predict, read_dataset, read_prototype, write_prototype
from beamdesign.cli import app
from beamdesign.cli.command import resumed
from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.examination.plausibility import examine
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.fit_cache import digest, fit_cache
from beamdesign.diagnosis.fitting.fitters import Fitters
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, Hypothesis
from beamdesign.progress import end_at_once, remembered, undisguised
from beamdesign.prototype import Tolerance

PUT_IN_HZ = 250.0
"""As `studies/gaps/make_slow_sensor.py` says."""


def columns(path: Path) -> dict[str, np.ndarray]:
    table = np.genfromtxt(path, delimiter=",", names=True)
    return {name: table[name] for name in table.dtype.names}


@pytest.fixture(scope="module")
def diagnosed(diagnosed_slow_sensor: Path) -> tuple[Path, Path, dict]:
    """Data set, result folder and JSON fields of one whole run."""
    base = diagnosed_slow_sensor
    return base / "slow_sensor", base / "out", json.loads((base / "answer.json").read_text())


def test_the_lag_that_was_put_in_is_found(diagnosed: tuple[Path, Path, dict]) -> None:
    _, _, answer = diagnosed
    assert answer["verdict"] == "effect"
    assert answer["chosen"] == ["sensor_lag"]
    first = answer["effects"][0]
    assert first["name"] == "sensor_lag"
    assert first["probability"] > 0.9
    at = first["parameters"]["break_Hz"]
    assert at["value"] == pytest.approx(PUT_IN_HZ, rel=0.1)
    assert abs(at["value"] - PUT_IN_HZ) < 4 * at["std"]


def test_fields_are_those_of_the_contract(diagnosed: tuple[Path, Path, dict]) -> None:
    _, out, answer = diagnosed
    assert answer["where"]["subsystem"] == "sensor"
    low, high = answer["where"]["band_Hz"]
    assert 0 <= low < high
    assert isinstance(answer["where"]["condition"], str)
    gap = answer["gap"]
    assert gap["noise_floor"] < gap["after"] < min(gap["before"], gap["tuned"])
    assert gap["closed_interval"][0] <= gap["closed"] <= gap["closed_interval"][1] <= 1
    explainable = gap["before"] ** 2 - gap["noise_floor"] ** 2
    assert gap["closed"] == pytest.approx((gap["before"] ** 2 - gap["after"] ** 2) / explainable)
    assert answer["next_experiment"] is None
    assert [each["probability"] for each in answer["effects"]] == sorted(
        (each["probability"] for each in answer["effects"]), reverse=True
    )
    assert Path(answer["prototype"]) == out / "prototype.toml"
    beside = json.loads((out / "diagnosis.json").read_text())
    assert beside == answer


def test_the_prototype_written_carries_the_effect_and_goes_through_the_other_commands(
    diagnosed: tuple[Path, Path, dict], tmp_path: Path
) -> None:
    _, out, answer = diagnosed
    written = read_prototype(out / "prototype.toml")
    assert written.effects["sensor_lag"]["break_Hz"] == answer["effects"][0]["parameters"]["break_Hz"]["value"]
    ran = CliRunner().invoke(
        app, ["certify", str(out / "prototype.toml"), "--outer-end-mass", "0:6.8", "--out", str(tmp_path / "c.toml")]
    )
    assert ran.exit_code == 0, ran.output
    assert "sensor_lag" in (tmp_path / "c.toml").read_text()


def test_a_lag_costs_what_the_design_promised_and_the_new_controller_gives_it_back(
    diagnosed: tuple[Path, Path, dict],
) -> None:
    _, out, answer = diagnosed
    old, new = answer["design"][0], answer["design"][-1]
    # A lag inside the loop takes phase at every frequency, so the critical gain must fall.
    for before, after in zip(old["believed"]["critical"], old["diagnosed"]["critical"], strict=True):
        assert after["gain_A_per_V"] < before["gain_A_per_V"]
        assert after["frequency_Hz"] < before["frequency_Hz"]
    assert old["diagnosed"]["peak_sensitivity"] > 2.5
    assert new["diagnosed"]["peak_sensitivity"] < 2.01
    redesigned = read_prototype(answer["redesigned"])
    assert redesigned.effects == read_prototype(out / "prototype.toml").effects
    assert redesigned.controller is not None
    assert redesigned.controller.model_dump() == answer["redesign"]["controller"]
    assert CliRunner().invoke(app, ["certify", "--replay", answer["certificate"]]).exit_code == 0


def test_what_is_predicted_by_it_is_off_by_as_much_as_it_said(
    diagnosed: tuple[Path, Path, dict], tmp_path: Path
) -> None:
    """Errors by the CSV files that `gap predict` writes, against those that the diagnosis states.

    It states those of fits without the record held out; the written prototype is fitted to all, and so no worse.
    """
    data, out, answer = diagnosed
    ran = CliRunner().invoke(
        app, ["gap", "predict", str(out / "prototype.toml"), str(data), "--out", str(tmp_path / "predicted")]
    )
    assert ran.exit_code == 0, ran.output
    for record in answer["gap"]["records"]:
        measured = columns(data / "records" / f"{record['record']}.csv")
        predicted = columns(tmp_path / "predicted" / f"{record['record']}.csv")
        np.testing.assert_allclose(predicted["t_s"], measured["t_s"], atol=1e-9)
        error = measured["displacement_m"] - predicted["displacement_m"]
        found = np.sqrt(np.mean(error**2)) / np.std(measured["displacement_m"])
        assert 0.8 * record["after"] < found < 1.05 * record["after"]


def test_a_second_run_takes_the_fits_of_the_first(
    diagnosed: tuple[Path, Path, dict], monkeypatch: pytest.MonkeyPatch, no_pictures: None, tmp_path: Path
) -> None:
    data, out, answer = diagnosed
    shutil.copytree(out / "fits", tmp_path / "again" / "fits")

    def refuse(*_: object) -> None:
        raise AssertionError("made anew")

    monkeypatch.setattr(fitters, "fitted", refuse)
    args = ["gap", "diagnose", str(data), "--out", str(tmp_path / "again"), "--workers", "1"]
    ran = CliRunner().invoke(app, args)
    assert ran.exit_code == 0, ran.output
    again = json.loads((tmp_path / "again" / "diagnosis.json").read_text())
    assert again["effects"] == answer["effects"]
    assert again["gap"] == answer["gap"]


@pytest.fixture
def small(tmp_path: Path) -> Dataset:
    return read_dataset(shortened(tmp_path / "slow_sensor", 401))


@pytest.mark.parametrize("explains", [True, False])
def test_what_does_not_explain_a_quarter_is_fitted_to_the_whole_only_where_nothing_does(
    explains: bool, small: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    others = (Hypothesis(("valve_deadband",)), Hypothesis(("parameter:leakage",)))
    lag = (Hypothesis(("sensor_lag",)),) if explains else ()
    monkeypatch.setattr(searching, "singles", lambda prototype: (*others, *lag))
    found = searching.search(small, 1, worth=0.0)
    assert {f.hypothesis for f in found.fits} == set(lag or others)
    assert found.explained is explains
    assert all(len(f.shares) == len(found.null.shares) for f in found.fits)


def test_an_interrupted_search_goes_on_where_it_stopped(
    small: Dataset, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    few = (Hypothesis(("sensor_lag",)), Hypothesis(("valve_deadband",)), Hypothesis(("parameter:leakage",)))
    monkeypatch.setattr(searching, "singles", lambda prototype: few)
    monkeypatch.setattr(searching, "_DONE", 1.0)  # no pairs
    made: list[Hypothesis] = []
    genuine = fitters.fitted

    def counted(task, *rest):
        if len(made) == stop:
            raise KeyboardInterrupt
        made.append(task.hypothesis)
        return genuine(task, *rest)

    monkeypatch.setattr(fitters, "fitted", counted)
    kept = fit_cache(tmp_path / "fits", small)
    stop = 2
    with pytest.raises(KeyboardInterrupt):
        searching.search(small, 1, kept=kept)
    assert kept.count == 2
    stop = 100
    resumed = searching.search(small, 1, kept=kept)
    looks = ["sensor_lag", "valve_deadband", "parameter:leakage"]
    assert [str(h) for h in made] == ["tolerances only", *looks, "sensor_lag"]
    made.clear()
    whole = searching.search(small, 1)
    assert len(made) == 5
    for one, other in zip((resumed.null, *resumed.fits), (whole.null, *whole.fits), strict=True):
        assert one.hypothesis == other.hypothesis
        assert one.cost == other.cost
        np.testing.assert_array_equal(one.z, other.z)
        np.testing.assert_array_equal(one.covariance, other.covariance)


def test_fits_to_other_data_are_not_taken_and_go(small: Dataset, tmp_path: Path) -> None:
    kept = fit_cache(tmp_path / "fits", small)
    task = searching.Task(Hypothesis(("sensor_lag",)), {})
    kept.keep(task, Fit(task.hypothesis, task.hypothesis.unknowns(small.prototype), reason="none"))
    assert kept.recall(task) is not None
    assert kept.recall(replace(task, known={"flow_gain": 1.0})) is None
    record = small.records[0]
    moved = replace(small, records=(replace(record, outer_end_mass=record.outer_end_mass + 1), *small.records[1:]))
    assert digest(moved) != digest(small)
    assert fit_cache(tmp_path / "fits", moved).recall(task) is None
    assert kept.count == 0


def test_fits_are_taken_with_the_unknowns_of_the_prototype_that_was_fitted(tmp_path: Path) -> None:
    """Where it states no tolerance the examination takes usual ones, which what is kept goes by."""
    data = read_dataset(shortened(tmp_path / "slow_sensor", 801))
    bare = replace(data, prototype=data.prototype.but(tolerance=Tolerance()))
    kept, task = fit_cache(tmp_path / "fits", bare), searching.Task(NOTHING, {})
    examined = examine(bare).data
    assert len(NOTHING.unknowns(bare.prototype)) == 0
    found = []
    for _ in range(2):
        with Fitters(examined, 1, kept) as fitted:
            found += fitted([task])
    assert kept.count == 1
    assert found[1].values == found[0].values
    assert len(found[1].values) == len(NOTHING.unknowns(examined.prototype)) > 0


def test_a_fit_with_other_unknowns_is_made_again(small: Dataset, tmp_path: Path) -> None:
    """As one of a program whose law had fewer parameters, where its fits are taken up by name."""
    kept = fit_cache(tmp_path / "fits", small)
    task = searching.Task(Hypothesis(("sensor_lag",)), {})
    unknowns = task.hypothesis.unknowns(small.prototype)
    for z, taken in ((np.zeros(len(unknowns)), True), (np.zeros(len(unknowns) - 1), False)):
        kept.keep(task, Fit(task.hypothesis, unknowns, z))
        assert (kept.recall(task) is not None) is taken


def test_a_file_cut_short_is_made_again(small: Dataset, tmp_path: Path) -> None:
    kept = fit_cache(tmp_path / "fits", small)
    task = searching.Task(Hypothesis(("sensor_lag",)), {})
    kept.keep(task, Fit(task.hypothesis, reason="none"))
    (path,) = (tmp_path / "fits").iterdir()
    path.write_bytes(path.read_bytes()[:100])
    assert kept.recall(task) is None


def test_interrupted_from_the_keyboard_it_says_how_to_go_on(tmp_path: Path) -> None:
    data = shortened(tmp_path / "slow_sensor", 801)
    out = tmp_path / "out"
    # A shell that runs this in the background has its children ignore the keyboard; the command must not.
    heed = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    command = [sys.executable, "-c", f"{heed}; from beamdesign.cli import main; main()"]
    command += ["gap", "diagnose", str(data), "--out", str(out), "--workers", "2"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        while process.poll() is None and not list(out.glob("fits/*.npz")):
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate()
    assert process.returncode == 130, said
    assert "the same command goes on from there" in said
    assert "Traceback" not in said
    assert not (out / "diagnosis.json").exists()
    assert list(out.glob("fits/*.npz"))
    assert not list(out.glob("fits/*.part"))


def disguised() -> None:
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt as error:
        raise SystemError("a result with an exception set") from error


@pytest.fixture
def keyboard() -> Iterator[None]:
    """Heeded, as where a shell does not run the tests in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_an_interruption_that_a_conversion_has_disguised_is_one(
    keyboard: None, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of Ctrl-C amid a conversion by compiled code Python makes a SystemError; others are what they are."""
    with remembered():
        with pytest.raises(typer.Exit) as ended, resumed(lambda: "; go on"):
            disguised()
        assert ended.value.exit_code == 130
    assert capsys.readouterr().err == "interrupted; go on\n"
    with pytest.raises(SystemError), remembered(), undisguised():
        raise SystemError("another")


def test_processes_ended_at_once_leave_nothing_that_watches_them() -> None:
    """What watched them could write to a closed pipe while Python ends (python/cpython, `_python_exit`)."""
    before, others = set(threading.enumerate()), active_children()
    pool = ProcessPoolExecutor(2)
    waiting = [pool.submit(time.sleep, 600) for _ in range(5)]
    end_at_once(pool, others)
    assert set(threading.enumerate()) == before
    assert active_children() == others
    assert all(each.done() for each in waiting)


def test_without_out_the_folder_is_named_after_the_data_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, no_pictures: None
) -> None:
    """Seen on a set that is quick to diagnose."""
    gains = SLOW_SENSOR.parent / "paper_gains"
    monkeypatch.chdir(tmp_path)
    few = (Hypothesis(("parameter:flow_gain",)),)
    monkeypatch.setattr("beamdesign.diagnosis.fitting.search.singles", lambda prototype: few)
    ran = CliRunner().invoke(app, ["gap", "diagnose", str(gains), "--workers", "1"])
    assert ran.exit_code == 0, ran.output
    names = {path.name for path in (tmp_path / "paper_gains.diagnosis").iterdir()}
    assert names == {"prototype.toml", "diagnosis.json", "report.html", "fits"}


def named(folder: Path, prototype: str) -> None:
    """Have a data set name the file of its prototype so."""
    index = folder / "dataset.toml"
    lines = [line for line in index.read_text().splitlines() if not line.startswith("prototype")]
    index.write_text("\n".join([f'prototype = "{prototype}"', *lines]))


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda folder: (folder / "dataset.toml").unlink(), "dataset.toml"),
        (lambda folder: (folder / "records" / "command.csv").unlink(), "no file records/command.csv"),
        (lambda folder: (folder / "prototype.toml").write_text("name = 1\n"), "prototype.toml"),
        (lambda folder: named(folder, ""), "prototype: no regular file ''"),
        (lambda folder: named(folder, "a\\u0000b"), "prototype"),
    ],
)
def test_bad_input_is_refused(spoil, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = shortened(tmp_path / "slow_sensor", 101)
    spoil(data)
    monkeypatch.chdir(data)
    for words in (["diagnose", "."], ["predict", str(SLOW_SENSOR / "prototype.toml"), "."]):
        found = CliRunner().invoke(app, ["gap", *words, "--out", str(tmp_path / "out")])
        assert isinstance(found.exception, InputError)
        assert said in str(found.exception)
    assert not (tmp_path / "out").exists()


def halved(prototype: Prototype) -> Prototype:
    return prototype.but(sensor=prototype.sensor.but(gain_V_per_m=prototype.sensor.gain_V_per_m / 2))


def test_displacements_are_stated_by_the_gain_that_was_believed(tmp_path: Path) -> None:
    """Half the sensor's gain and twice the controller's make the same loop for a force, so half the stated motion."""
    data = shortened(tmp_path / "one", 401)
    twice = shortened(tmp_path / "two", 401)
    index = twice / "dataset.toml"
    index.write_text(index.read_text().replace("gain_A_per_V = 0.06", "gain_A_per_V = 0.12"))
    write_prototype(halved(read_prototype(SLOW_SENSOR / "prototype.toml")), tmp_path / "half.toml")
    plain = {p.name: p for p in predict(SLOW_SENSOR / "prototype.toml", data).records}
    other = {p.name: p for p in predict(tmp_path / "half.toml", twice).records}
    for name in ("disturbance", "payload_disturbance"):
        one, two = plain[name].samples, other[name].samples
        np.testing.assert_allclose(two[:, 1], one[:, 1], rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(two[:, 2], one[:, 2] / 2, rtol=1e-6, atol=1e-14)


def test_only_inputs_are_read(tmp_path: Path) -> None:
    whole = shortened(tmp_path / "whole", 401)
    bare = shortened(tmp_path / "bare", 401)
    for k, path in enumerate(sorted((bare / "records").iterdir())):
        rows = [line.split(",") for line in path.read_text().splitlines()]
        spoilt = ([row[0], *row[2:3], row[1]] for row in rows)  # measured columns away, inputs in another order
        if k % 2:
            spoilt = ([*row[:3], *(row[3:] if j == 0 else ["nan", ""])] for j, row in enumerate(rows))
        path.write_text("\n".join(",".join(row) for row in spoilt) + "\n")
    prototype = SLOW_SENSOR / "prototype.toml"
    for one, other in zip(predict(prototype, whole).records, predict(prototype, bare).records, strict=True):
        np.testing.assert_array_equal(one.samples, other.samples)


def test_an_input_that_is_not_finite_is_refused(tmp_path: Path) -> None:
    data = shortened(tmp_path / "slow_sensor", 101)
    path = data / "records" / "command.csv"
    lines = path.read_text().splitlines()
    lines[50] = ",".join([*lines[50].split(",")[:2], "nan", *lines[50].split(",")[3:]])
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match="command_V: 1 value is not finite, the first in row 51"):
        predict(SLOW_SENSOR / "prototype.toml", data)


def test_a_loop_that_diverges_ends_its_record_and_the_answer_is_no(tmp_path: Path) -> None:
    data = shortened(tmp_path / "slow_sensor", 801)
    index = data / "dataset.toml"
    # Far beyond the critical gain: 307 mA/V without payload, 202 with it.
    index.write_text(index.read_text().replace("gain_A_per_V = 0.06", "gain_A_per_V = 2.0"))
    args = ["gap", "predict", str(SLOW_SENSOR / "prototype.toml"), str(data), "--out", str(tmp_path / "out")]
    ran = CliRunner().invoke(app, [*args, "--json", str(tmp_path / "answer.json")])
    assert ran.exit_code == 1
    answer = json.loads((tmp_path / "answer.json").read_text())
    assert answer["complete"] is False
    assert "diverges" in answer["reasons"]["command"]
    predicted = columns(tmp_path / "out" / "command.csv")
    assert len(predicted["t_s"]) < 801
    assert np.all(np.isfinite(predicted["displacement_m"]))
    assert np.abs(predicted["displacement_m"]).max() < 0.5
