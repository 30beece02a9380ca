"""Data sets as users have them, which once ended in a traceback, in a wrong word or in a file that was lost."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from gap_sets import LAG, believed, measured, scenario
from slow_sensor import shortened
from typer.testing import CliRunner

from beamdesign import InputError, Prototype, diagnose, import_measured, predict, read_dataset
from beamdesign.cli import app
from beamdesign.columns import write_tables
from beamdesign.controllers import Observer, Proportional
from beamdesign.diagnosis.data.dataset import Dataset, FrequencyResponse, MeasuredGain
from beamdesign.diagnosis.examination.plausibility import examine
from beamdesign.diagnosis.fitting.fit_cache import fit_cache
from beamdesign.diagnosis.fitting.gain_evidence import GainEvidence
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, tolerated
from beamdesign.diagnosis.fitting.linear_evidence import ResponseEvidence
from beamdesign.diagnosis.fitting.replay import Replay
from beamdesign.diagnosis.where.residuals import probe
from beamdesign.prototype import Tolerance

RIG = Path(__file__).parents[1] / "studies" / "prototypes" / "tame_lag.toml"


@pytest.fixture(scope="module")
def short() -> Dataset:
    plan = scenario(0.5)
    return measured(believed(), plan.but(record=plan.record[:2]))


def without_leakage(rig: Prototype) -> Prototype:
    return rig.but(servovalve=rig.servovalve.but(leakage_m3_per_s_per_Pa=0.0))


@pytest.mark.parametrize("effect", ["", "seal_friction", "valve_hysteresis", "joint_backlash"])
def test_what_is_free_at_rest_is_no_reason_to_fail(short: Dataset, effect: str):
    """Without leakage the mean pressure of the chambers may be anything there, and so may a memory."""
    rig = short.prototype.but(effects={effect: {}}) if effect else without_leakage(short.prototype)
    job, placement = Replay(short.records[0], rig), NOTHING.placement(rig)
    found = probe(job, placement, np.zeros(len(placement.unknowns)))
    assert all(np.all(np.isfinite(part)) for part in vars(found).values() if isinstance(part, np.ndarray))


def test_nothing_that_is_read_is_written_over(tmp_path: Path):
    data = shortened(tmp_path / "slow_sensor", 401)
    before = {path: path.read_bytes() for path in sorted(data.rglob("*")) if path.is_file()}
    asked = (
        ["gap", "diagnose", str(data), "--out", str(data)],
        ["gap", "predict", str(data / "prototype.toml"), str(data), "--out", str(data / "records")],
    )
    for arguments in asked:
        done = CliRunner().invoke(app, arguments)
        assert isinstance(done.exception, InputError)
        assert "which is read; name another folder" in str(done.exception)
    assert {path: path.read_bytes() for path in sorted(data.rglob("*")) if path.is_file()} == before


def test_what_is_imported_is_not_written_over(tmp_path: Path):
    file = tmp_path / "records" / "run.csv"
    file.parent.mkdir()
    file.write_text("t_s,current_A,displacement_m\n" + "".join(f"{k / 1000},{k % 7},{k % 5}\n" for k in range(50)))
    before = file.read_bytes()
    with pytest.raises(InputError, match="already, which is not written over"):
        import_measured([file], RIG, tmp_path)
    assert file.read_bytes() == before


def test_an_input_that_a_column_may_hold_is_asked_for(tmp_path: Path):
    """By its unit; that there is none can be said."""
    rows = "".join(f"{k / 1000},{k % 3},{k % 7},{k % 5}\n" for k in range(50))
    (tmp_path / "run.csv").write_text("t [s],Piezo [N],current [A],displacement [m]\n" + rows)
    with pytest.raises(InputError, match=r"may be 'Piezo', by its unit.*--column 'disturbance_N = 0'"):
        import_measured([tmp_path / "run.csv"], RIG, tmp_path / "set")
    found = import_measured([tmp_path / "run.csv"], RIG, tmp_path / "set", ["disturbance_N = 0"])
    assert not found.dataset.records[0].inputs.any()


@pytest.mark.parametrize("content", [b"", b"MATLAB 5.0 MAT-file", b"\x00" * 300])
def test_a_damaged_matlab_file_is_refused(tmp_path: Path, content: bytes):
    (tmp_path / "run.mat").write_bytes(content)
    with pytest.raises(InputError, match="is no MATLAB file that can be read"):
        import_measured([tmp_path / "run.mat"], RIG, tmp_path / "set")


def test_times_since_1970_keep_their_milliseconds(tmp_path: Path):
    times = 1.7e9 + np.arange(4) * 1e-3
    (path,) = write_tables({"one": (("t_s", "x_m"), np.column_stack([times, times]))}, tmp_path)
    assert np.diff(np.loadtxt(path, delimiter=",", skiprows=1)[:, 0]) == pytest.approx(1e-3, rel=1e-3)


def test_a_drift_begins_with_the_record(short: Dataset):
    rig = short.prototype.but(effects={"empirical_sensor_drift": {"rate": 0.02}})
    placement = NOTHING.placement(rig)
    late = replace(short.records[0], times=short.records[0].times + 1e5)
    moved = [
        Replay(record, rig).simulated(placement, np.zeros(len(placement.unknowns)), ("displacement_m",))
        for record in (short.records[0], late)
    ]
    assert moved[0] is not None
    np.testing.assert_allclose(moved[1], moved[0], rtol=1e-6, atol=1e-12)


def test_what_is_spoilt_where_a_record_does_not_count_is_not_held_against_it(short: Dataset):
    """An amplifier that was off, a sensor that was touched: five per cent of a record, stated by the user.

    A displacement that is not known leaves open what a controller with memory makes after it.
    """
    record = short.records[1]
    begin, end = record.times[200], record.times[250]
    for channel, value in (("displacement_m", 0.01), ("current_A", 0.5), ("current_A", 0.0)):
        spoilt = {**record.measured, channel: record.measured[channel].copy()}
        spoilt[channel][205:245] = value
        stated = replace(record, measured=spoilt, left_out=((float(begin), float(end)),))
        found = examine(replace(short, records=(short.records[0], stated)))
        assert len(found.data.records) == 2
        assert channel == "displacement_m" or not found.limits_confidence, found.words


def test_more_than_half_of_a_record_is_not_left_out(tmp_path: Path):
    data = shortened(tmp_path / "slow_sensor", 401)
    text = (data / "dataset.toml").read_text()
    (data / "dataset.toml").write_text(text.replace("[[record]]\n", "[[record]]\nleft_out_s = [[0.0, 0.15]]\n", 1))
    with pytest.raises(InputError, match=r"dataset.toml: record.left_out_s: .*leaves out more than half"):
        read_dataset(data)


def test_few_lines_and_a_copied_gain_are_diagnosed():
    """Three lines tell no scatter; a gain pasted from the model is off by nothing at all."""
    rig = believed()
    taken = FrequencyResponse("r", np.array([2.0, 5.0, 10.0]), np.ones(3, complex), True, None, 0.0, 0.0, LAG)
    nominal = ResponseEvidence(taken, rig).nominal()
    assert nominal is not None
    curve = Dataset("lines", Path(), rig, responses=(replace(taken, response=nominal),))
    assert diagnose(curve, 1, minutes=0.0).verdict in ("no_gap", "unknown", "ambiguous")
    gain = MeasuredGain(Proportional(gain_A_per_V=0.01), 0.0, 0.0, 0.03)
    onset = GainEvidence(gain, rig).nominal()
    assert onset is not None
    copied = replace(gain, controller=gain.controller.but(gain_A_per_V=onset.gain))
    assert diagnose(Dataset("gain", Path(), rig, gains=(copied,)), 1, minutes=0.0).verdict != "effect"


def test_tolerances_of_what_a_rig_has_not_are_none(short: Dataset):
    bare = replace(short, prototype=short.prototype.but(tolerance=Tolerance(sensor_filter=0.1)))
    found = examine(bare)
    assert tolerated(found.data.prototype)
    assert "typical ones are taken" in found.words[0]


def test_a_law_that_hears_what_another_actuator_feels_is_refused(tmp_path: Path):
    data = shortened(tmp_path / "slow_sensor", 401)
    sensors = ("displacement_m", "screw_force_N")
    law = Observer(gain_A_per_V=0.1, sensors=sensors, a=(), b=(), c=(), d=(1.0, 1e-9))
    table = {"record": [{"file": "records/command.csv", "controller": law.model_dump(mode="json")}]}
    (data / "dataset.toml").write_text(tomli_w.dumps(table))
    for ask in (lambda: read_dataset(data), lambda: predict(data / "prototype.toml", data)):
        with pytest.raises(InputError, match="screw_force_N, which a rig with a servo_cylinder does not have"):
            ask()


def test_a_further_sensor_that_is_not_connected_is_left_aside(tmp_path: Path):
    data = shortened(tmp_path / "slow_sensor", 401)
    for path in (data / "records").glob("*.csv"):
        head, *rows = path.read_text().splitlines()
        dead = path.stem == "command"
        lines = (f"{row},{0.0 if dead else k % 7}" for k, row in enumerate(rows))
        path.write_text("\n".join([f"{head},inner_displacement_m", *lines]))
    read = read_dataset(data)
    assert [w for w in read.warnings if "left aside" in w] == [
        "command.csv: inner_displacement_m never changes (is the sensor connected?) and was left aside"
    ]
    held = {record.name: "inner_displacement_m" in record.measured for record in read.records}
    assert held == {name: name != "command" for name in held}


def test_files_of_the_user_stay_beside_kept_fits(tmp_path: Path):
    mine, stale = tmp_path / "fits" / "my-spectra.npz", tmp_path / "fits" / f"{'0' * 16}-{'1' * 16}.npz"
    mine.parent.mkdir()
    for file in (mine, stale):
        file.write_bytes(b"")
    fit_cache(tmp_path / "fits", Dataset("any", tmp_path, believed()))
    assert mine.exists()
    assert not stale.exists()
