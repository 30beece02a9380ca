"""Time stamps that jitter and samples that are lost, against sums of sines, whose values are known at any time."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from beamdesign import InputError, import_measured, read_dataset
from beamdesign.cli import app

RIG = Path(__file__).parent.parent / "studies" / "prototypes" / "tame_lag.toml"
COUNT, STEP = 2000, 1e-3
HEAD = "t_s,disturbance_N,command_V,current_A,displacement_m"
SIZES = {"disturbance_N": 100.0, "command_V": 0.2, "current_A": 1e-3, "displacement_m": 1e-4}


def signals(highest_Hz: float) -> dict[str, Callable[[np.ndarray], np.ndarray]]:
    """Twenty sines each, of root mean square sqrt(10) times its size."""
    random = np.random.default_rng(7)

    def of(size: float) -> Callable[[np.ndarray], np.ndarray]:
        frequencies, phases = random.uniform(1.0, highest_Hz, 20), random.uniform(0.0, 2 * np.pi, 20)
        return lambda t: size * np.sin(2 * np.pi * np.outer(t, frequencies) + phases).sum(axis=1)

    return {name: of(size) for name, size in SIZES.items()}


def written(path: Path, taken_s: np.ndarray, stamps_s: np.ndarray, highest_Hz: float, noise: float = 2e-3) -> Path:
    """A file of samples that were taken at some times and stamped with others."""
    random, columns = np.random.default_rng(8), [stamps_s]
    for name, signal in signals(highest_Hz).items():
        columns.append(signal(taken_s) + noise * np.sqrt(10) * SIZES[name] * random.standard_normal(len(taken_s)))
    np.savetxt(path, np.column_stack(columns), "%.12g", ",", header=HEAD, comments="")
    return path


def stamps(jitter: float) -> tuple[np.ndarray, np.ndarray]:
    """(N,) s of an even clock, and with a jitter of so many intervals either way."""
    even = STEP * np.arange(COUNT)
    return even, 1.0 + even + STEP * np.random.default_rng(3).uniform(-jitter, jitter, COUNT)


def off(found: np.ndarray, true: np.ndarray) -> float:
    return float(np.sqrt(np.mean((found - true) ** 2)) / np.std(true))


def test_stamps_with_too_few_digits_are_refused_with_the_interval_to_state(tmp_path: Path) -> None:
    """At 2 kHz every other stamp of whole milliseconds repeats; what is advised is then the record as it was taken."""
    taken = STEP / 2 * np.arange(COUNT)
    path = written(tmp_path / "a.csv", taken, np.floor(taken * 1e3) / 1e3, 60.0, noise=0.0)
    with pytest.raises(InputError, match=r"repeats the time of .* --column 't_s = 0\.0005 \[s\]'"):
        import_measured([path], RIG, tmp_path / "set")
    record = import_measured([path], RIG, tmp_path / "set", ["t_s = 0.0005 [s]"]).dataset.records[0]
    assert record.times == pytest.approx(taken)
    truth = signals(60.0)["displacement_m"](taken)
    assert off(record.measured["displacement_m"], truth) < 1e-6


@pytest.mark.parametrize("jitter", [0.05, 0.15, 0.3])
def test_samples_tell_whether_a_clock_was_even_or_its_stamps_are_true(tmp_path: Path, jitter: float) -> None:
    """Taken the wrong way, stamps that are off by 0.3 intervals make 0.3/sqrt(3) 2 pi f T of a sine: 4 % at 40 Hz."""
    even, stamped = stamps(jitter)
    late = written(tmp_path / "late.csv", even, stamped, 60.0)
    true = written(tmp_path / "true.csv", stamped - 1.0, stamped, 60.0)
    found = import_measured([late, true], RIG, tmp_path / "set")
    for record in found.dataset.records:
        for name, signal in signals(60.0).items():
            values = dict(zip(("disturbance_N", "command_V"), record.inputs.T, strict=True)) | dict(record.measured)
            # The even clock is told from its stamps up to their mean, the true stamps begin with the first of them.
            begins = stamped[0] - 1.0 if record.name == "true" else np.mean(stamped - 1.0 - even)
            assert off(values[name], signal(record.times + begins)) < 4e-3
    by_file = {name: next(one for one in rows if one.channel == "t_s") for name, rows in found.taken.items()}
    assert "at an even clock, which they fit" in by_file["records/late.csv"].words
    assert "at their stamps, which they fit" in by_file["records/true.csv"].words
    assert [f"{path.stem}.csv: " in " ".join(found.dataset.warnings) for path in (late, true)] == [True, True]
    assert read_dataset(tmp_path / "set").warnings == found.dataset.warnings


def test_the_error_that_is_told_is_not_exceeded(tmp_path: Path) -> None:
    """Without noise what is off is the spline alone: 5/384 (2 pi f h)^4 of a sine at most (Hall and Meyer 1976)."""
    _, stamped = stamps(0.25)
    path = written(tmp_path / "a.csv", stamped - 1.0, stamped, 80.0, noise=0.0)
    found = import_measured([path], RIG, tmp_path / "set")
    (rows,) = found.taken.values()
    told = float(next(one.words for one in rows if one.channel == "t_s").rpartition("about ")[2].split()[0])
    (record,) = found.dataset.records
    worst = max(
        off(record.measured[name], signals(80.0)[name](record.times + stamped[0] - 1.0))
        for name in ("current_A", "displacement_m")
    )
    assert 1e-6 < worst < 1.5 * told < 0.015


def test_what_cannot_be_told_is_refused_or_asked(tmp_path: Path) -> None:
    """Five samples a period: a spline may be off by much, and noise hides which reading is right."""
    even, stamped = stamps(0.2)
    true = written(tmp_path / "true.csv", stamped - 1.0, stamped, 200.0)
    with pytest.raises(InputError, match=r"t_s: not uniform: values at even times cannot be told .* take more samples"):
        import_measured([true], RIG, tmp_path / "set")
    noisy = written(tmp_path / "noisy.csv", even, stamped, 60.0, noise=0.1)
    with pytest.raises(InputError, match=r"t_s: stamps lie up to 0\.2 .*--clock even .*--clock stamps"):
        import_measured([noisy], RIG, tmp_path / "set")
    assert not (tmp_path / "set").exists()
    command = ["gap", "import", str(noisy), "--prototype", str(RIG), "--clock", "even", "--out", str(tmp_path / "set")]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    (record,) = read_dataset(tmp_path / "set").records
    raw = np.loadtxt(noisy, delimiter=",", skiprows=1)
    assert record.inputs[:, 0] == pytest.approx(raw[:, 1], rel=1e-8)


def test_lost_rows_are_filled_where_that_is_sure(tmp_path: Path) -> None:
    """Three rows of a slow motion, one after another; the same of a quick one are refused, with where they are."""
    kept = np.delete(np.arange(COUNT), [700, 1200, 1201])
    even, stamped = stamps(0.1)
    slow = written(tmp_path / "slow.csv", even[kept], stamped[kept], 15.0, noise=0.0)
    (record,) = import_measured([slow], RIG, tmp_path / "set").dataset.records
    assert len(record.times) == COUNT
    assert record.measured["displacement_m"][kept] == pytest.approx(
        signals(15.0)["displacement_m"](even[kept]), rel=1e-6
    )
    assert off(record.measured["displacement_m"], signals(15.0)["displacement_m"](even)) < 1e-4
    quick = written(tmp_path / "quick.csv", even[kept], even[kept], 120.0)
    with pytest.raises(
        InputError, match=r"values of lost rows \(3\) cannot be told .* behind 1\.199 s there is none for 0\.003 s"
    ):
        import_measured([quick], RIG, tmp_path / "other")


def test_one_row_that_is_lost_in_the_middle_is_no_jitter(tmp_path: Path) -> None:
    """A line through the stamps passes them all by less than half an interval, as where none is lost."""
    even = STEP * np.arange(COUNT)
    kept = np.delete(np.arange(COUNT), COUNT // 2)
    path = written(tmp_path / "a.csv", even[kept], even[kept], 15.0)
    found = import_measured([path], RIG, tmp_path / "set")
    (rows,) = found.taken.values()
    (words,) = (one.words for one in rows if one.channel == "t_s")
    assert words.startswith("values of lost rows (1) are splines, off by about")
    assert found.dataset.records[0].times == pytest.approx(even, abs=1e-9)


def test_a_force_that_is_white_and_drives_is_no_noise(tmp_path: Path) -> None:
    """Every other value of it is missing, which no spectrum gives back; the tip follows by a lag of first order."""
    random = np.random.default_rng(1)
    force, tip = 100 * random.standard_normal(COUNT), np.zeros(COUNT)
    for k in range(1, COUNT):
        tip[k] = 0.95 * tip[k - 1] + 1e-7 * force[k - 1]
    rows = [f"{k / 1000},{force[k] if k % 2 == 0 else ''},0,0,{tip[k]}" for k in range(COUNT)]
    (tmp_path / "a.csv").write_text("\n".join([HEAD, *rows]))
    with pytest.raises(
        InputError, match=r"disturbance_N: has 1000 values that are not finite.*would be off by 0\.\d+ of it"
    ):
        import_measured([tmp_path / "a.csv"], RIG, tmp_path / "set")


def test_a_data_set_whose_samples_were_taken_unevenly_is_refused(tmp_path: Path) -> None:
    """Its times are within a tenth of an interval, which passed for even ones and made 2 % of its motion."""
    even, stamped = stamps(0.1)
    for name, taken_s in (("late", even), ("true", stamped - 1.0)):
        path = written(tmp_path / f"{name}.csv", even, even, 90.0)
        import_measured([path], RIG, tmp_path / name)
        written(tmp_path / name / "records" / f"{name}.csv", taken_s, stamped, 90.0)
    assert len(read_dataset(tmp_path / "late").records) == 1
    with pytest.raises(InputError, match=r"t_s: not uniform: .*`beamdesign gap import` puts them at even times"):
        read_dataset(tmp_path / "true")
