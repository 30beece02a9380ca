"""Data sets spoiled one way at a time: each must be refused in words, or named, and never pass for sound evidence.

What is right is known because the data come from a simulation and the test itself does the spoiling.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gap_sets import believed, measured, scenario
from recorded_rig import LAG, STRAIGHT, Recorded, recorded
from scipy.signal import lfilter

from beamdesign import InputError, Prototype, read_dataset
from beamdesign.controllers import Lag, Proportional
from beamdesign.diagnosis.data.dataset import MeasuredGain, TimeRecord
from beamdesign.diagnosis.examination.nominal import _knee, commanded_current, controller_fit, nominal_loop
from beamdesign.diagnosis.examination.plausibility import examine, force_channel
from beamdesign.diagnosis.examination.readings import contradictions
from beamdesign.prototype import Tolerance
from beamdesign.structure.lumped import figures

SHARED = Path(__file__).parents[2] / "shared" / "rig"
Spoil = Callable[[Recorded], object]


@pytest.fixture
def sound(paper: Prototype) -> Recorded:
    return recorded(paper)


def scale(column: str, factor: float, *names: str) -> Spoil:
    def spoil(data: Recorded) -> None:
        for name in names or data.columns:
            data.columns[name][column] = data.columns[name][column] * factor

    return spoil


def swap(a: str, b: str, *names: str) -> Spoil:
    def spoil(data: Recorded) -> None:
        for name in names or data.columns:
            columns = data.columns[name]
            columns[a], columns[b] = columns[b], columns[a]

    return spoil


def every_gain(factor: float) -> Spoil:
    def spoil(data: Recorded) -> None:
        for row in data.index["record"]:
            row["controller"] = row["controller"] | {"gain_A_per_V": factor * row["controller"]["gain_A_per_V"]}

    return spoil


def believed_sensor(data: Recorded) -> None:
    data.prototype = data.prototype.but(sensor=data.prototype.sensor.but(gain_V_per_m=1.18))


def grams(data: Recorded) -> None:
    data.entry("payload").update(outer_end_mass_kg=6800.0, inner_end_mass_kg=4400.0)


REFUSED: dict[str, tuple[Spoil, str, str]] = {
    "millimetres": (scale("displacement_m", 1e3), "displacement_m", "values are in mm, by their scale: divide by 1000"),
    "millimetres in one record": (scale("displacement_m", 1e3, "steps"), "displacement_m", "in mm"),
    "micrometres": (scale("displacement_m", 1e6), "displacement_m", "in um"),
    "inches": (scale("displacement_m", 1 / 0.0254), "displacement_m", "in inches"),
    "volts of the sensor": (scale("displacement_m", 1180.0), "displacement_m", "divide by sensor.gain_V_per_m"),
    "milliamperes": (scale("current_A", 1e3), "current_A", "in mA, by their scale: divide by 1000"),
    "millivolts": (scale("command_V", 1e3), "command_V", "in mV"),
    "kilonewtons": (scale("disturbance_N", 1e-3), "disturbance_N", "in kN, by their scale: multiply by 1000"),
    "pounds in one record": (
        scale("disturbance_N", 1 / 4.4482216, "steps"),
        "disturbance_N",
        "values are in lbf, by their scale",
    ),
    "pounds": (scale("disturbance_N", 1 / 4.4482216), "disturbance_N", "in lbf, by their scale: multiply by 4.44822"),
    "milliseconds": (scale("t_s", 1e3), "t_s", "are these milliseconds"),
    "sign of displacement": (scale("displacement_m", -1), "displacement_m", "its sign is the other way round"),
    "sign of current": (scale("current_A", -1), "current_A", "its sign is the other way round"),
    "sign of force": (scale("disturbance_N", -1), "disturbance_N", "its sign is the other way round"),
    "sign of command": (scale("command_V", -1), "command_V", "its sign is the other way round"),
    "swapped outputs": (swap("current_A", "displacement_m"), "current_A", "displacement_m stand in each other's place"),
    "swapped inputs": (swap("disturbance_N", "command_V"), "disturbance_N", "command_V stand in each other's place"),
    "gain in mA/V": (every_gain(1e3), "controller.gain_A_per_V", "the gain is in mA/V"),
    "sensor in V/mm": (believed_sensor, "sensor.gain_V_per_m", "V/mm"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_columns_read_wrongly_are_refused_with_what_they_are(kind: str, sound: Recorded, tmp_path: Path):
    spoil, key, words = REFUSED[kind]
    spoil(sound)
    with pytest.raises(InputError) as caught:
        examine(read_dataset(sound.write(tmp_path)))
    error = caught.value
    assert [problem.key for problem in error.problems] == [key], str(error)
    assert words in error.problems[0].reason
    if kind.endswith("one record"):
        assert error.source == str(tmp_path / "records" / "steps.csv")


def test_further_columns_are_held_against_the_believed_loop(sound: Recorded, tmp_path: Path):
    for name, columns in sound.columns.items():
        columns.update(sound.more[name])
    assert examine(read_dataset(sound.write(tmp_path))).words == ()
    scale("load_pressure_Pa", -1.0)(sound)
    with pytest.raises(InputError, match=r"load_pressure_Pa: .*its sign is the other way round"):
        examine(read_dataset(sound.write(tmp_path)))
    scale("inner_displacement_m", 1e3)(sound)
    scale("load_pressure_Pa", -1e-5)(sound)
    with pytest.raises(InputError) as caught:
        examine(read_dataset(sound.write(tmp_path)))
    said = {problem.key: problem.reason for problem in caught.value.problems}
    assert "values are in bar, by their scale: multiply by 100000" in said["load_pressure_Pa"]
    assert "values are in mm" in said["inner_displacement_m"]


def clip(column: str, share: float, *names: str, side: str = "both") -> Spoil:
    def spoil(data: Recorded) -> None:
        for name in names or data.columns:
            values = data.columns[name][column]
            top = share * np.abs(values).max()
            data.columns[name][column] = np.clip(values, -top if side == "both" else None, top)

    return spoil


def cut(name: str, first: int, last: int) -> Spoil:
    def spoil(data: Recorded) -> None:
        data.columns[name] = {key: values[first:last] for key, values in data.columns[name].items()}
        data.columns[name]["t_s"] = data.columns[name]["t_s"] - data.columns[name]["t_s"][0]

    return spoil


def lose(name: str, column: str) -> Spoil:
    def spoil(data: Recorded) -> None:
        values = data.columns[name][column].copy()
        for first in (400, 700):
            values[first : first + 30] = values[first]
        data.columns[name][column] = values

    return spoil


def blank(data: Recorded) -> None:
    values = data.columns["force"]["displacement_m"].copy()
    peaks = np.argsort(np.abs(values))[-5:]
    values[peaks] = 0.0
    data.columns["force"]["displacement_m"] = values


def quiet(name: str) -> Spoil:
    """Nothing but the noise of the sensors."""

    def spoil(data: Recorded) -> None:
        random = np.random.default_rng(0)
        columns = data.columns[name]
        count = len(columns["t_s"])
        columns["command_V"] = np.zeros(count)
        columns["disturbance_N"] = random.normal(0, 0.5, count)
        columns["displacement_m"] = random.normal(0, 3e-7, count)
        columns["current_A"] = random.normal(0, 5e-5, count)

    return spoil


def constant_inputs(data: Recorded) -> None:
    data.columns["command"]["command_V"] = np.full(1201, 0.1)
    data.columns["command"]["disturbance_N"] = np.zeros(1201)


def high_only(data: Recorded) -> None:
    """A force far above the band, and the motion it makes in a rig that is nothing but its mass."""
    columns = data.columns["force"]
    columns["disturbance_N"] = 600 * np.sin(2 * np.pi * 450 * columns["t_s"])
    moved = -columns["disturbance_N"] / (3.9 * (2 * np.pi * 450) ** 2)
    columns["displacement_m"] = moved
    columns["current_A"] = -0.122 * 1180 * moved * 1.75 / 26


def relabel(name: str, controller: dict[str, object]) -> Spoil:
    return lambda data: data.entry(name).update(controller=dict(controller))


def late(samples: int, *names: str) -> Spoil:
    def spoil(data: Recorded) -> None:
        for name in names or data.columns:
            values = data.columns[name]["current_A"]
            rest = np.full(abs(samples), 0.0)
            moved = [rest, values[:-samples]] if samples > 0 else [values[-samples:], rest]
            data.columns[name]["current_A"] = np.concatenate(moved)

    return spoil


def copied(data: Recorded) -> None:
    data.columns["payload"] = dict(data.columns["force"])


def coarse(data: Recorded) -> None:
    data.columns["force"] = {key: values[::12] for key, values in data.columns["force"].items()}


def heavy(data: Recorded) -> None:
    data.entry("force").update(outer_end_mass_kg=6.8, inner_end_mass_kg=4.4)


def lagging(data: Recorded) -> None:
    """A coil of 60 Hz, exact for a current that goes straight from sample to sample."""
    reach = 2 * np.pi * 60 * 1e-3
    kept = np.exp(-reach)
    mean = (1 - kept) / reach
    for columns in data.columns.values():
        columns["current_A"] = lfilter([1 - mean, mean - kept], [1, -kept], columns["current_A"])


def humming(data: Recorded) -> None:
    for columns in data.columns.values():
        hum = np.sin(2 * np.pi * 50 * columns["t_s"])
        columns["current_A"] = columns["current_A"] + 0.3 * np.std(columns["current_A"]) * hum


def recorder_humming(data: Recorded) -> None:
    columns = data.columns["force"]
    turned = 2 * np.pi * 130 * columns["t_s"]
    hum = 0.16 * np.std(columns["displacement_m"]) * (np.sin(turned) + 0.5 * np.sin(3 * turned))
    columns["displacement_m"] = columns["displacement_m"] + hum


def offset(data: Recorded) -> None:
    data.columns["force"]["current_A"] = data.columns["force"]["current_A"] + 0.01


def dead(data: Recorded) -> None:
    data.columns["force"]["displacement_m"] = np.full(1201, 1e-5)


def other_run(data: Recorded) -> None:
    data.columns["force"]["current_A"] = data.columns["force"]["current_A"][::-1].copy()


def begun_at_its_place(data: Recorded) -> None:
    """Cut where it passes the place at which it rests."""
    about = np.convolve(data.columns["force"]["displacement_m"], np.ones(3), "valid")
    cut("force", 200 + int(np.argmin(np.abs(about[200:600]))), 1201)(data)


def drifting(data: Recorded) -> None:
    moved = data.columns["force"]["displacement_m"]
    data.columns["force"]["displacement_m"] = moved + 0.05 * np.std(moved) * np.linspace(0, 1, len(moved))


def load_cell_hum(data: Recorded) -> None:
    columns = data.columns["command"]
    columns["disturbance_N"] = columns["disturbance_N"] + 40 * np.sin(2 * np.pi * 50 * columns["t_s"])


def put(column: str, name: str, row: int | slice, value: float) -> Spoil:
    def spoil(data: Recorded) -> None:
        values = data.columns[name][column].copy()
        values[row] += value
        data.columns[name][column] = values

    return spoil


def stopped(data: Recorded) -> None:
    """What a recorder had no samples for is zero."""
    columns = data.columns["force"]
    for name in ("disturbance_N", "current_A", "displacement_m"):
        columns[name] = np.concatenate([columns[name][:-200], np.zeros(200)])


NAMED: dict[str, tuple[Spoil, str, str, str, bool, bool]] = {
    # how: caution, record, words, whether the record is left out, whether confidence is limited
    "clipped displacement": (clip("displacement_m", 0.5, "force"), "clipped", "force", "cut off at", True, True),
    "clipped above": (clip("displacement_m", 0.5, "force", side="top"), "clipped", "force", "cut off", True, True),
    "clipped current, one side": (clip("current_A", 0.4, "force", side="top"), "clipped", "force", "range", True, True),
    "saturated current": (clip("current_A", 0.6, "force"), "saturated_current", "force", "saturates at", False, False),
    "lost samples": (lose("force", "displacement_m"), "stuck", "force", "lost by the recorder", True, True),
    "a recorder that stopped": (stopped, "ended", "force", "last 200 samples, from 1.001 s on", True, True),
    "zeros": (blank, "stuck", "force", "exactly zero in mid-motion, in", True, True),
    "dead sensor": (dead, "dead_channel", "force", "displacement_m never changes", True, True),
    "short": (cut("force", 0, 200), "short", "force", "too short: 0.199 s", True, False),
    "a handful": (cut("force", 0, 20), "short", "force", "only 20 samples", True, False),
    "begun in motion": (
        cut("force", 203, 1201),
        "not_at_rest",
        "force",
        "does not start at rest without load",
        False,
        True,
    ),
    "only noise": (quiet("command"), "no_content", "command", "with a noise of", True, False),
    "constant inputs": (constant_inputs, "no_content", "command", "both inputs are constant", True, False),
    "too high": (high_only, "no_content", "force", "inputs' power lies between 0.5 and 300 Hz", True, False),
    "too coarse": (coarse, "coarse_sampling", "force", "sampled too coarsely: 83.33 Hz", True, True),
    "another record's controller": (relabel("force", STRAIGHT), "controller", "force", "record command", True, True),
    "no lag": (relabel("force", STRAIGHT | {"gain_A_per_V": 0.122}), "controller", "force", "1.75/26 Hz", True, True),
    "another controller": (relabel("force", LAG | {"zero_Hz": 13.0}), "controller", "force", "1.75/26 Hz", True, True),
    "a wrong gain": (relabel("steps", STRAIGHT | {"gain_A_per_V": 0.012}), "controller", "steps", "0.80", True, True),
    "a gain a little off": (
        relabel("payload", LAG | {"gain_A_per_V": 0.0835}), "controller", "payload", "0.963 times", True, True,
    ),
    "a gain a little off, which another record has": (
        relabel("force", LAG | {"gain_A_per_V": 0.126}), "controller", "force", "record command", True, True,
    ),
    "a gain wrong everywhere": (every_gain(0.7), "amplifier_gain", "force", "as in all records", False, True),
    "a late current": (late(4, "force"), "amplifier_lag", "force", "late, by 4", False, True),
    "an early current": (late(-4, "force"), "shifted_channels", "force", "ahead of displacement_m", True, True),
    "a slow coil": (lagging, "amplifier_lag", "force", "with a time constant of 2.6", False, True),
    "hum": (humming, "controller_mismatch", "force", "most of that at 50 Hz: hum", False, True),
    "hum that the controller does not hear": (
        recorder_humming, "controller_mismatch", "force", "most of that at 130 and 390 Hz: hum", False, False,
    ),
    "a drift": (drifting, "controller_mismatch", "force", "a channel drifts, or its gain is off", False, True),
    "current of another run": (other_run, "controller", "force", "do the columns belong to one run", True, True),
    "offset": (offset, "offset", "force", "constant 0.01 A", False, True),
    "the same file twice": (copied, "duplicate", "payload", "the same measurement as force", True, True),
    "masses of another record": (heavy, "masses", "force", "does not fit its end masses (6.8 and 4.4 kg)", True, True),
    "grams": (grams, "units", "payload", "is it in grams?", True, True),
    "one far displacement": (
        put("displacement_m", "force", 300, 2.0), "outlier", "force", "displacement_m is 1.999 at 0.3 s", True, True,
    ),
    "one far current": (put("current_A", "force", 300, 50.0), "outlier", "force", "is 50.01 at 0.3 s", True, True),
    "one far command": (put("command_V", "command", 300, 1e5), "outlier", "command", "command_V (1e+05)", True, True),
    "one far force": (put("disturbance_N", "force", 300, 1e6), "force", "force", "9.996e+05 N at 0.3 s", True, True),
    "a constant far force": (put("disturbance_N", "force", slice(None), 1e6), "force", "force", "zero", True, True),
    "begun in motion, at its place of rest": (
        begun_at_its_place, "not_at_rest", "force", "in its first", False, True,
    ),
    "hum of the load cell": (load_cell_hum, "unfelt_force", "command", "of 28.3 N rms would move the tip", False, True),
    "an offset of the load cell": (
        put("disturbance_N", "command", slice(None), 150.0), "unfelt_force", "command", "150 N", False, True,
    ),
    "a force with spoilt samples": (
        put("disturbance_N", "force", slice(300, 1000, 150), 6000.0),
        "unfelt_force", "force", "5 single samples that the rig does not feel, first at 0.3 s", False, True,
    ),
    "a force cut off": (clip("disturbance_N", 0.5, "force"), "clipped", "force", "is cut off", True, True),
    "a force 50 times too large": (scale("disturbance_N", 50, "force"), "force", "force", "units of both", True, True),
    "a current a million times too small": (
        scale("current_A", 1e-6), "amplifier_gain", "force", "1e-06 times what the stated controller", False, True,
    ),
    "no current": (scale("current_A", 1e-320, "force"), "dead_channel", "force", "never changes", True, True),
}  # fmt: skip


@pytest.mark.parametrize("kind", NAMED)
def test_what_is_wrong_with_a_record_is_named(kind: str, sound: Recorded, tmp_path: Path):
    spoil, name, record, words, left_out, limits = NAMED[kind]
    spoil(sound)
    found = examine(read_dataset(sound.write(tmp_path)))
    of_record = [caution for caution in found.warnings if caution.record == record]
    assert [caution.name for caution in of_record] == [name], found.words
    assert words in of_record[0].text
    assert of_record[0].left_out is left_out
    assert (record in [r.name for r in found.data.records]) is not left_out
    assert found.limits_confidence is limits
    assert any(record in line.split(": ")[0].split(", ") for line in found.words)


ALL_OUT: dict[str, tuple[Spoil, str]] = {
    "clipped": (clip("displacement_m", 0.5), "cut off"),
    "silent": (lambda data: [quiet(name)(data) for name in data.columns], "nothing is to be seen"),
    "short": (lambda data: [cut(name, 0, 100)(data) for name in data.columns], "too short"),
}


@pytest.mark.parametrize("kind", ALL_OUT)
def test_a_set_without_a_usable_record_is_refused_with_every_reason(kind: str, sound: Recorded, tmp_path: Path):
    spoil, words = ALL_OUT[kind]
    spoil(sound)
    with pytest.raises(InputError) as caught:
        examine(read_dataset(sound.write(tmp_path)))
    assert [problem.key for problem in caught.value.problems] == list(sound.columns)
    assert all(words in problem.reason for problem in caught.value.problems), str(caught.value)


def test_a_span_that_does_not_count_may_reach_the_end(sound: Recorded, tmp_path: Path):
    stopped(sound)
    sound.entry("force").update(left_out_s=[[1.0, 1.2]])
    assert examine(read_dataset(sound.write(tmp_path))).words == ()


def test_half_the_records_gone_limits_confidence(sound: Recorded, tmp_path: Path):
    for name in ("force", "command"):
        cut(name, 0, 200)(sound)
    found = examine(read_dataset(sound.write(tmp_path)))
    assert [caution.name for caution in found.warnings] == ["short", "short", "few_records"]
    assert found.limits_confidence


@pytest.mark.parametrize("channel", ["displacement_m", "current_A"])
def test_single_samples_that_are_off_are_bridged(channel: str, sound: Recorded, tmp_path: Path):
    """What was put in is taken out again, at least nine tenths of it, and nothing else is touched."""
    clean = examine(read_dataset(sound.write(tmp_path / "clean"))).data.records
    size = {r.name: float(np.std(r.measured[channel])) for r in clean}
    for at, off in ((300, 1.0), (420, -1.3)):
        put(channel, "force", at, off * size["force"])(sound)
    found = examine(read_dataset(sound.write(tmp_path / "spoilt")))
    assert [(w.name, w.record, w.left_out) for w in found.warnings] == [("spoilt", "force", False)]
    assert "2 single samples that are spoilt, first at 0.3 s" in found.words[0]
    assert not found.limits_confidence
    for before, after in zip(clean, found.data.records, strict=True):
        assert np.max(np.abs(before.measured[channel] - after.measured[channel])) < 0.04 * size[before.name]


@pytest.mark.parametrize("channel", ["current_A", "displacement_m"])
def test_the_zero_of_a_channel_that_is_off_is_taken_off(channel: str, sound: Recorded, tmp_path: Path):
    """Told by the controller's equation and by how it begins; a current that saturates on one side alone has none."""
    clean = examine(read_dataset(sound.write(tmp_path / "clean"))).data.records[0]
    size = float(np.std(clean.measured["current_A"]))
    put(channel, clean.name, slice(None), 0.05 * float(np.std(clean.measured[channel])))(sound)
    found = examine(read_dataset(sound.write(tmp_path / "off")))
    ((name, text),) = {(w.name, w.text) for w in found.warnings}
    assert name == "offset"
    assert f"{channel} begins" in text
    for of, before in clean.measured.items():
        assert np.abs(found.data.records[0].measured[of] - before).max() < 2e-3 * np.std(before)
    cut_off = np.clip(clean.measured["current_A"], -0.8 * size, None)
    fit = controller_fit(replace(clean, measured={**clean.measured, "current_A": cut_off}), 1180.0)
    assert fit is not None
    assert np.mean(cut_off) > 0.02 * size
    assert abs(fit.offset_A) < 0.01 * size


def test_one_command_that_the_current_follows_is_no_outlier(sound: Recorded, tmp_path: Path):
    """A pulse one sample long, which a law without a lag makes a current of at once."""
    put("command_V", "steps", 300, 50.0)(sound)
    put("current_A", "steps", 300, 50.0 * STRAIGHT["gain_A_per_V"])(sound)
    found = examine(read_dataset(sound.write(tmp_path)))
    assert [caution for caution in found.warnings if caution.name == "outlier"] == []
    assert "steps" in [record.name for record in found.data.records]


@pytest.mark.parametrize("ratio", [1e-12, 0.3, 1.0, 3.0, 1e6, 1e200])
def test_a_knee_holds_for_any_ratio_of_demand_to_limit(ratio: float):
    found = _knee(np.array([-ratio, ratio]) * 0.01, 0.01, 12.0)
    assert found == pytest.approx([-0.01 / (1 + (1 / ratio) ** 12) ** (1 / 12), found[1]])
    assert found[1] == -found[0]


def test_a_current_that_is_nearly_always_at_its_limit_still_obeys_its_controller(sound: Recorded, tmp_path: Path):
    """Where the states of the lag began is to be read off what is not cut off; off all of it, 3 % are missed."""
    clip("current_A", 0.02, "force")(sound)
    data = read_dataset(sound.write(tmp_path))
    record = next(r for r in data.records if r.name == "force")
    fit = controller_fit(record, data.prototype.sensor.gain_V_per_m)
    assert fit is not None
    assert fit.with_gain > 0.4
    assert fit.limit_A == pytest.approx(np.abs(record.measured["current_A"]).max(), rel=0.01)
    assert fit.with_limit < 0.01


REAL = {
    "sound": {},
    "late sensor": {"sensor_lag": {"break_Hz": 90.0}},
    "delay": {"transport_delay": {"delay_s": 1.5e-3}},
    "areas": {"unequal_piston_areas": {}},
    "friction": {"seal_friction": {}},
    "backlash": {"joint_backlash": {}},
    "saturation": {"current_saturation": {"limit_A": 0.012}},
}


@pytest.mark.parametrize("kind", REAL)
def test_what_a_rig_does_is_not_called_bad_data(kind: str, paper: Prototype, tmp_path: Path):
    found = examine(read_dataset(recorded(paper, REAL[kind]).write(tmp_path)))
    assert len(found.data.records) == 4
    assert not found.limits_confidence
    assert {caution.name for caution in found.warnings} <= {"saturated_current"}
    held = [controller_fit(record, found.data.prototype.sensor.gain_V_per_m) for record in found.data.records]
    assert None not in held
    if kind == "saturation":
        assert any(f.limit_A is not None and abs(f.limit_A - 0.012) < 2e-4 for f in held)


def test_a_force_is_felt_by_a_rig_that_resonates_elsewhere():
    """A sine where the believed beam rings, on one that is 30 % heavier: it moves as far, a quarter period late."""
    light = believed()
    rig = light.but(
        controller=Proportional(gain_A_per_V=0.004),
        outer_beam=light.outer_beam.but(damping_ratio=0.008),
        inner_beam=light.inner_beam.but(damping_ratio=0.008),
    )
    times = 5e-4 * np.arange(2000)
    inputs = np.column_stack([100 * np.sin(2 * np.pi * 54 * times), 0.01 * np.sin(2 * np.pi * 11 * times)])
    none = {name: np.zeros(len(times)) for name in ("current_A", "displacement_m")}
    record = TimeRecord("r", times, inputs, none, 0.0, 0.0, rig.controller)
    heavier = nominal_loop(rig, replace(record, outer_end_mass=0.3 * figures(rig)["outer_mass"]))
    moved = heavier.driven(inputs, record.step)[:, 1].sum(axis=1)
    moved += 1e-3 * np.std(moved) * np.random.default_rng(0).standard_normal(len(moved))
    assert not list(force_channel(replace(record, measured=none | {"displacement_m": moved}), rig))


def test_a_force_that_only_pushes_is_not_cut_off():
    """It rests at exactly zero half of the time."""
    times = 5e-4 * np.arange(2000)
    force = 100 * np.sin(2 * np.pi * 20 * times) + 30 * np.sin(2 * np.pi * 46 * times)
    inputs = np.column_stack([np.maximum(force, 0.0), 0.0 * times])
    record = TimeRecord("r", times, inputs, {"displacement_m": times}, 0.0, 0.0, believed().controller)
    assert not list(force_channel(record, believed()))


@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the recorded sets")
def test_recorded_sets_pass_without_a_word():
    folders = sorted(SHARED.glob("open-*"))
    assert folders
    for folder in folders:
        found = examine(read_dataset(folder))
        assert found.words == ()
        assert len(found.data.records) == 8


def test_the_controller_equation_agrees_with_an_independent_filter():
    """A lag through scipy's bilinear transform at 10 times the sampling rate, on a signal known in closed form."""
    from scipy.signal import bilinear

    from beamdesign.diagnosis.data.dataset import TimeRecord

    fine = np.arange(0, 50_001) * 2e-5
    volts = np.sin(2 * np.pi * 7 * fine) ** 3 * fine
    law = Lag(gain_A_per_V=0.12, pole_Hz=1.75, zero_Hz=26.0)
    b, a = bilinear([0.12 / (2 * np.pi * 26), 0.12], [1 / (2 * np.pi * 1.75), 1], 5e4)
    reference = lfilter(b, a, volts)[::10]
    times = fine[::10]
    measured = {"displacement_m": 0 * times, "current_A": reference}
    record = TimeRecord("x", times, np.column_stack([0 * times, volts[::10]]), measured, 0.0, 0.0, law)
    assert commanded_current(record, law, 1180.0) == pytest.approx(reference, abs=2e-4 * np.abs(reference).max())


def test_the_controller_equation_holds_where_samples_are_few_to_a_period():
    """240 Hz sampled at 2 kHz through a law that passes little else; straight between its samples it has lost 5 %."""
    from scipy.signal import lsim

    from beamdesign.controllers import Observer
    from beamdesign.diagnosis.data.dataset import TimeRecord

    w, fine = 2 * np.pi * 180, np.arange(0, 20_001) * 2e-5
    volts = np.sin(2 * np.pi * 240 * fine) * fine
    law = Observer.of(0.1, ("displacement_m",), [[0.0, w], [-w, -0.6 * w]], [[0.0], [w]], [1.0, 0.0], [0.0])
    reference = 0.1 * lsim(([[0.0, w], [-w, -0.6 * w]], [[0.0], [w]], [[1.0, 0.0]], [[0.0]]), volts, fine)[1][::25]
    times = fine[::25]
    measured = {"displacement_m": 0 * times, "current_A": reference}
    record = TimeRecord("x", times, np.column_stack([0 * times, volts[::25]]), measured, 0.0, 0.0, law)
    assert commanded_current(record, law, 1180.0) == pytest.approx(reference, abs=0.01 * np.abs(reference).max())


def test_a_delayed_and_weakened_current_is_measured(sound: Recorded, tmp_path: Path):
    late(3, "force")(sound)
    scale("current_A", 0.9, "force")(sound)
    record = read_dataset(sound.write(tmp_path)).records[0]
    fit = controller_fit(record, 1180.0)
    assert fit.delay_s == pytest.approx(3e-3, rel=0.02)
    assert fit.with_delay < 0.02 < 0.3 < fit.residual


@pytest.mark.parametrize(("samples", "shifted"), [(-0.01, False), (-0.2, True)])
def test_a_hundredth_of_a_sample_is_no_shift(samples: float, shifted: bool, sound: Recorded, tmp_path: Path):
    """In a record that is mostly noise the residual beside it may come out as none by chance, with any time."""
    data = read_dataset(sound.write(tmp_path))
    hum, current = np.sin(2 * np.pi * 40 * data.records[0].times), data.records[0].measured["current_A"]
    humming = {**data.records[0].measured, "current_A": current + 0.085 * np.std(current) * hum}
    record = replace(data.records[0], measured=humming)  # which no controller explains
    fit = controller_fit(record, 1180.0)
    assert fit is not None
    quiet = {"with_delay": 0.0, "delay_s": samples * record.step, "with_lag": 0.06, "lag_s": 0.0, "with_limit": 0.06}
    noisy = replace(fit, residual=0.06, noise=0.13, doubt=0.052, with_gain=0.06, limit_A=None, **quiet)
    found = contradictions([record], {record.name: noisy}, data.prototype)
    assert [one.name for one in found] == ["shifted_channels" if shifted else "controller_mismatch"]
    assert [one.left_out for one in found] == [shifted]


def test_the_believed_loop_holds_a_static_load_as_statics_says(paper: Prototype):
    """Beam and cylinder together carry the load: Zalucky and Hardt (1984), equations (7) to (14) without rates.

    At rest Q = K_q i = K_pq F_c / A and i = -K F x, the inner beam carries the same force: K_m x = P + F_c.
    """
    loop = nominal_loop(paper, MeasuredGain(Lag(gain_A_per_V=0.02, pole_Hz=1.75, zero_Hz=26.0), 0.0, 0.0, 0.03))
    assert loop.stable
    current, moved, pressure, inner = loop.responses(np.array([1e-6]))[0, :, 0].real
    stiff = 1.13e-2 * 0.02 * 1180 * 1.13e-4 / 3.8e-13
    assert moved == pytest.approx(1 / (486_800 + stiff), rel=1e-6)
    assert current == pytest.approx(-0.02 * 1180 * moved, rel=1e-6)
    assert pressure == pytest.approx(-stiff * moved / 1.13e-4, rel=1e-6)
    assert inner == pytest.approx(stiff * moved / 157_500, rel=1e-6)


@pytest.mark.parametrize("units", [("current_A", "displacement_m"), ("command_V", "displacement_m")])
def test_two_columns_in_other_units(units: tuple[str, str], sound: Recorded, tmp_path: Path):
    for column in units:
        scale(column, 1e3, "command")(sound)
    with pytest.raises(InputError) as caught:
        examine(read_dataset(sound.write(tmp_path)))
    assert caught.value.problems[0].key == ", ".join(units)
    assert caught.value.problems[0].reason.startswith("values are in m")


def test_a_prototype_without_tolerances_gets_typical_ones_and_a_word():
    data = measured(believed(), scenario(0.6))
    bare = replace(data, prototype=data.prototype.but(tolerance=Tolerance()))
    found = examine(bare)
    assert found.data.prototype.tolerance.stiffness > 0
    assert any("no [tolerance] is stated" in words for words in found.words)
    assert not found.limits_confidence
    assert examine(data).data.prototype.tolerance == data.prototype.tolerance


@pytest.mark.parametrize("count", [1201, 8001])
def test_noise_alone_contradicts_no_controller_however_short_the_record(count: int) -> None:
    """White noise of a quarter of the current, whose power so few lines tell no better: three standard deviations."""
    over, times = [], 5e-4 * np.arange(count)
    for seed in range(60):
        random = np.random.default_rng(seed)
        command = np.convolve(random.standard_normal(count), np.ones(40) / 40, "same")
        current = 1e-3 * command + 4e-5 * random.standard_normal(count)
        still = np.zeros(count)
        measured = {"current_A": current, "displacement_m": still}
        law = Proportional(gain_A_per_V=1e-3)
        record = TimeRecord("noisy", times, np.column_stack([still, command]), measured, 0.0, 0.0, law)
        fit = controller_fit(record, 1180.0)
        assert fit is not None
        over.append(fit.residual / fit.doubt)
    assert 0.3 < max(over) < 1.0


@pytest.mark.parametrize("heard", [False, True])
def test_noise_that_rings_in_a_controller_contradicts_it_no_more_than_white_noise(heard: bool) -> None:
    """A law that resonates at 45 Hz, by scipy: recorded noise through it is no other law, and hides no weak amplifier.

    Noise that the controller has not heard is in what the equation makes of the record alone; noise that it has heard
    is in the measured current as well, and tells nothing of what differs.
    """
    from scipy.signal import lsim, resample

    from beamdesign.controllers import Observer

    w, times, random = 2 * np.pi * 45, 5e-4 * np.arange(4001), np.random.default_rng(0)
    a, b, c, d = [[0.0, w], [-w, -0.04 * w]], [[0.0], [w]], [0.3, 0.0], [0.1]
    law = Observer.of(1e-3, ("displacement_m",), a, b, c, d)
    command = np.convolve(random.standard_normal(len(times)), np.ones(200) / 20, "same")
    noise = 1.5e-4 * random.standard_normal(len(times))
    volts = resample(command - heard * 1180.0 * noise, 10 * len(times))
    current = (0.85 if heard else 1.0) * 1e-3 * lsim((a, b, [c], [d]), volts, 5e-5 * np.arange(len(volts)))[1][::10]
    inputs = np.column_stack([0 * times, command])
    record = TimeRecord("rings", times, inputs, {"current_A": current, "displacement_m": noise}, 0.0, 0.0, law)
    fit = controller_fit(record, 1180.0)
    assert fit is not None
    if heard:
        assert fit.residual == pytest.approx(0.15 / 0.85, rel=0.05)
        assert fit.with_gain < 0.25 * fit.residual
        assert fit.gain == pytest.approx(0.85, rel=0.01)
    else:
        assert fit.residual < 0.5 * fit.doubt
        assert fit.gain == pytest.approx(1.0, abs=0.03)
