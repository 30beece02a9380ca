"""Reading a data set: what was written comes back, and what is wrong is said with file, key, row and reason."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recorded_rig import Recorded, as_csv, recorded

from beamdesign import InputError, Prototype, critical_gain, predict, read_dataset
from beamdesign.columns import read_columns, uniform_times
from beamdesign.controllers import Lag
from beamdesign.diagnosis.data.dataset_index import OFF, kind_of
from beamdesign.diagnosis.examination.plausibility import check_responses, examine

HEADER = "t_s,disturbance_N,command_V,current_A,displacement_m"


@pytest.fixture
def sound(paper: Prototype) -> Recorded:
    return recorded(paper)


def refusal(folder: Path) -> InputError:
    with pytest.raises(InputError) as caught:
        read_dataset(folder)
    return caught.value


def test_everything_written_comes_back(sound: Recorded, tmp_path: Path):
    sound.index["critical_gain"] = [{"gain_A_per_V": 0.021, "outer_end_mass_kg": 6.8, "frequency_Hz": 30}]
    sound.index["frequency_response"] = [{"file": "r.csv", "controller": sound.entry("steps")["controller"]}]
    sound.files["r.csv"] = "frequency_Hz,magnitude_m_per_N,phase_deg\n1,2e-6,-90\n2,1e-6,180\n"
    data = read_dataset(sound.write(tmp_path))
    assert [record.name for record in data.records] == list(sound.columns)
    for record in data.records:
        written = sound.columns[record.name]
        assert np.array_equal(record.inputs[:, 0], written["disturbance_N"])
        assert np.array_equal(record.inputs[:, 1], written["command_V"])
        assert np.array_equal(record.measured["current_A"], written["current_A"])
        assert np.array_equal(record.measured["displacement_m"], written["displacement_m"])
        assert record.times == pytest.approx(written["t_s"], abs=1e-12)
        assert record.source == str(tmp_path / "records" / f"{record.name}.csv")
    payload = data.records[3]
    assert (payload.outer_end_mass, payload.inner_end_mass) == (6.8, 4.4)
    assert payload.controller == Lag(gain_A_per_V=0.0804, pole_Hz=1.75, zero_Hz=26.0)
    assert data.gains[0].gain == 0.021
    assert data.gains[0].controller.kind == "proportional"
    assert data.responses[0].response == pytest.approx([-2e-6j, -1e-6])
    assert data.warnings == ()
    assert kind_of(tmp_path) == "twin_beam"
    assert read_dataset(tmp_path / "dataset.toml").name == data.name
    counts = f"{len(sound.columns)} time records, 1 frequency response, 1 critical gain"
    assert repr(data) == f"<Dataset: {counts}>"
    assert data._repr_html_().count("<tr>") == len(data.rows()) == len(sound.columns) + 2
    rows = dict(row[:2] for row in data.rows())
    assert (rows["r"], rows["critical gain"]) == ("2 frequencies, magnitude_m_per_N", "21 mA/V")
    assert data == read_dataset(tmp_path)


def force_text(sound: Recorded) -> str:
    return as_csv(sound.columns["force"])


def in_row(row: int, change: Callable[[list[str]], list[str]]) -> Callable[[str], str]:
    def spoil(text: str) -> str:
        lines = text.splitlines()
        lines[row - 1] = ",".join(change(lines[row - 1].split(",")))
        return "\n".join(lines) + "\n"

    return spoil


def without(row: int) -> Callable[[str], str]:
    return lambda text: "".join(line for k, line in enumerate(text.splitlines(True), start=1) if k != row)


SPOILED_CSV: dict[str, tuple[Callable[[str], str], str, str]] = {
    "empty": (lambda t: "", "(file)", "is empty"),
    "header only": (lambda t: HEADER + "\n", "(file)", "holds no rows below the column names"),
    "no header": (lambda t: t.split("\n", 1)[1], "(file)", "row 1 holds numbers: the column names are missing"),
    "semicolons": (lambda t: t.replace(",", ";"), "(file)", "columns are separated by semicolons"),
    "tabs": (lambda t: t.replace(",", "\t"), "(file)", "columns are separated by tabs: use commas"),
    "semicolons below": (lambda t: t.replace(",", ";").replace(";", ",", 4), "(file)", "row 2 has 1 cell"),
    "decimal commas": (
        lambda t: HEADER + "\n0,000,1,5,0,0,0,0,0,0\n", "(file)", "row 2 has 10 cells, the header 5: are decimals",
    ),
    "trailing comma": (in_row(7, lambda c: [*c, ""]), "(file)", "row 7 has 6 cells, the header 5: it ends with"),
    "trailing comma above": (in_row(1, lambda c: [*c, ""]), "(file)", "column 6 has no name in row 1: it ends with"),
    "column twice": (in_row(1, lambda c: [*c[:4], "current_A"]), "current_A", "stands twice in row 1"),
    "lost cell": (in_row(9, lambda c: c[:4]), "(file)", "row 9 has 4 cells, the header 5"),
    "empty cell": (in_row(9, lambda c: [*c[:4], ""]), "displacement_m", "row 9 is not a number: empty"),
    "word": (in_row(9, lambda c: [*c[:3], "over", c[4]]), "current_A", "row 9 is not a number: 'over'"),
    "unit in cell": (in_row(9, lambda c: [*c[:4], "0.1 mm"]), "displacement_m", "row 9 is not a number: '0.1 mm'"),
    "nan": (in_row(9, lambda c: [*c[:3], "nan", c[4]]), "current_A", "1 value is not finite, the first in row 9"),
    "infinite": (in_row(9, lambda c: [c[0], "-inf", *c[2:]]), "disturbance_N", "1 value is not finite"),
    "comment": (lambda t: t + "# end of run\n", "(file)", "row 1203 has 1 cell, the header 5"),
    "column missing": (in_row(1, lambda c: [*c[:3], "coil", c[4]]), "current_A", "column missing; the file has t_s,"),
    "column in mm": (
        in_row(1, lambda c: [*c[:4], "displacement_mm"]),
        "displacement_m", "column missing; the file has displacement_mm: give it in m, as displacement_m",
    ),
    "sample missing": (without(500), "t_s", "not uniform: 1 sample is missing before row 500 (0.499 s)"),
    "time repeats": (in_row(500, lambda c: ["0.497", *c[1:]]), "t_s", "row 500 repeats the time of row 499"),
    "time goes back": (in_row(500, lambda c: ["0.1", *c[1:]]), "t_s", "does not rise: row 500 goes back"),
    "time is off": (in_row(500, lambda c: ["0.4984", *c[1:]]), "t_s", "row 500 is 0.4 samples off its place"),
    "one row": (lambda t: "".join(t.splitlines(True)[:2]), "t_s", "too short: 1 samples"),
}  # fmt: skip


@pytest.mark.parametrize("kind", SPOILED_CSV)
def test_a_spoiled_file_is_refused_with_row_and_reason(kind: str, sound: Recorded, tmp_path: Path):
    spoil, key, words = SPOILED_CSV[kind]
    folder = sound.write(tmp_path)
    file = folder / "records" / "force.csv"
    file.write_text(spoil(force_text(sound)))
    error = refusal(folder)
    assert error.source == str(file)
    assert [problem.key for problem in error.problems] == [key]
    assert words in error.problems[0].reason


def test_a_record_without_current_is_read_where_that_is_said(sound: Recorded, tmp_path: Path):
    del sound.columns["force"]["current_A"]
    with pytest.raises(InputError, match="current_recorded = false"):
        read_dataset(sound.write(tmp_path))
    for name in ("force", "command"):  # of the latter it is there, and not to count
        sound.entry(name)["current_recorded"] = False
    data = read_dataset(sound.write(tmp_path))
    assert [list(one.measured) for one in data.records[:2]] == [["displacement_m"]] * 2
    assert data.warnings == ("command.csv: current_A is not to count (current_recorded = false) and was left aside",)
    examined = examine(data)
    assert [one.record for one in examined.warnings if one.name == "no_current"] == ["force", "command"]
    sound.columns["force"]["displacement_m"] = np.array(sound.columns["force"]["displacement_m"])
    sound.columns["force"]["displacement_m"][500] += 1e-3  # mended as where there is a current
    assert "spoilt" in [one.name for one in examine(read_dataset(sound.write(tmp_path))).warnings]
    assert len(examined.data.records) == len(data.records)
    assert not examined.limits_confidence


def test_a_record_taken_with_the_servo_off_needs_neither_law_nor_current(sound: Recorded, tmp_path: Path):
    sound.prototype = sound.prototype.but(controller=None)
    for name, columns in sound.columns.items():
        columns["current_A"] = np.zeros_like(columns["t_s"])
        sound.entry(name)["servo_off"] = True
    with pytest.raises(InputError, match="stands beside a controller"):
        read_dataset(sound.write(tmp_path))
    for name in sound.columns:
        sound.entry(name).pop("controller", None)
    data = read_dataset(sound.write(tmp_path))
    assert {one.controller for one in data.records} == {OFF}
    assert data.warnings == ("command.csv: command_V moves nothing (servo_off = true) and was left aside",)
    assert data.records[1].excitation == "none"
    assert {one.name for one in examine(data).warnings} <= {"tolerances"}
    assert len(predict(sound.prototype, tmp_path).records) == len(data.records)


@pytest.mark.parametrize("spans", [[[0.0, 1.2]], [[0.3, 0.2]], [[5.0, 6.0]]])
def test_spans_that_are_none_are_told_before_what_stands_in_them(
    spans: list[list[float]], sound: Recorded, tmp_path: Path
):
    sound.entry("force")["left_out_s"] = spans
    sound.columns["force"]["displacement_m"] = np.full(1201, np.nan)
    assert [one.key for one in refusal(sound.write(tmp_path)).problems] == ["record.left_out_s"]


def test_without_times_a_file_with_spans_is_refused_by_its_column(sound: Recorded, tmp_path: Path):
    sound.entry("force")["left_out_s"] = [[0.1, 0.11]]
    sound.columns["force"]["time_s"] = sound.columns["force"].pop("t_s")
    assert [one.key for one in refusal(sound.write(tmp_path)).problems] == ["t_s"]


def test_an_empty_first_cell_may_stand_where_nothing_counts(sound: Recorded, tmp_path: Path):
    sound.entry("force")["left_out_s"] = [[0.1, 0.11]]
    columns = sound.columns["force"]
    sound.columns["force"] = {"displacement_m": columns.pop("displacement_m"), **columns}
    folder = sound.write(tmp_path)
    file = folder / "records" / "force.csv"
    file.write_text(in_row(108, lambda cells: ["", *cells[1:]])(file.read_text()) + "\n\n")
    assert np.isfinite(read_dataset(folder).records[0].measured["displacement_m"]).all()


@pytest.mark.parametrize("lost", ["", " ", "nan", "-inf", "1e300"])
def test_what_does_not_count_may_be_lost(lost: str, sound: Recorded, tmp_path: Path):
    sound.entry("force")["left_out_s"] = [[0.1, 0.11]]  # of samples every millisecond from row 2 on
    folder = sound.write(tmp_path)

    def spoil(row: int, column: str) -> None:
        change = in_row(
            row, lambda cells: [lost if name == column else c for name, c in zip(names, cells, strict=True)]
        )
        (folder / "records" / "force.csv").write_text(change(force_text(sound)))

    names = HEADER.split(",")
    for column in ("current_A", "displacement_m"):
        spoil(108, column)
        assert np.isfinite(read_dataset(folder).records[0].measured[column]).all()
    for row, column in ((108, "disturbance_N"), (108, "t_s"), (120, "displacement_m")):
        spoil(row, column)
        with pytest.raises(InputError, match=f"row {row}"):
            read_dataset(folder)


@pytest.mark.parametrize(
    "spell",
    [
        lambda text: "\ufeff" + text,
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace(",", " , "),
        lambda text: text.replace("displacement_m", '"displacement_m"'),
        lambda text: text + "\n\n",
        lambda text: text.rstrip("\n"),
    ],
    ids=["byte order mark", "line ends", "blanks", "quotes", "empty lines", "no last line end"],
)
def test_what_spreadsheets_do_to_a_file_is_understood(spell: Callable[[str], str], sound: Recorded, tmp_path: Path):
    file = tmp_path / "a.csv"
    file.write_bytes(spell(force_text(sound)).encode())
    columns = read_columns(file)
    assert list(columns) == HEADER.split(",")
    for name, values in sound.columns["force"].items():
        assert np.array_equal(columns[name], values)


def test_a_file_that_is_no_text_is_refused(tmp_path: Path):
    file = tmp_path / "a.csv"
    file.write_bytes(b"\x93NUMPY\x01\x00")
    with pytest.raises(InputError, match="is not text in UTF-8"):
        read_columns(file)
    file.write_bytes(HEADER.encode() + b"\n" + b"\0" * 40)
    with pytest.raises(InputError, match="it holds zero bytes"):
        read_columns(file)
    with pytest.raises(InputError, match="Is a directory"):
        read_columns(tmp_path)


def test_times_with_few_digits_are_uniform(tmp_path: Path):
    uniform_times(tmp_path, np.round(np.arange(4000) / 3000, 4))
    with pytest.raises(InputError, match="not uniform"):
        uniform_times(tmp_path, np.cumsum(1e-3 * (1 + 0.4 * np.sin(np.arange(4000)))))


Change = Callable[[Recorded], object]
SPOILED_INDEX: dict[str, tuple[Change, str, str]] = {
    "file name": (
        lambda d: d.entry("force").update(file="records/forze.csv"),
        "record.file", "entry 1: no file records/forze.csv; did you mean records/force.csv?",
    ),
    "folder name": (
        lambda d: d.entry("steps").update(file="record/steps.csv"),
        "record.file", "entry 3: no file record/steps.csv: there is no folder record",
    ),
    "prototype": (lambda d: d.index.update(prototype="rig.toml"), "prototype", "no file rig.toml"),
    "no controller": (
        lambda d: d.entry("steps").pop("controller"),
        "record.controller", "missing for records/steps.csv, and the prototype has none",
    ),
    "kind of controller": (
        lambda d: d.entry("steps")["controller"].update(kind="pid"), "record.controller", "kind must be one of",
    ),
    "figure of controller": (
        lambda d: d.entry("force")["controller"].pop("pole_Hz"), "record.controller.pole_Hz", "entry 1: missing",
    ),
    "negative mass": (
        lambda d: d.entry("force").update(outer_end_mass_kg=-1.0), "record.outer_end_mass_kg", "plausible range",
    ),
    "mass in words": (
        lambda d: d.entry("force").update(outer_end_mass_kg="none"), "record.outer_end_mass_kg", "must be a number",
    ),
    "unit of mass": (
        lambda d: d.entry("force").update(outer_end_mass_g=500.0), "record.outer_end_mass_g", "wrong unit g: give",
    ),
    "single table": (
        lambda d: d.index.update(record=d.index["record"][0]), "record", "write [[record]] with double brackets",
    ),
    "key of table": (lambda d: d.index.update(records=d.index.pop("record")), "records", "did you mean record?"),
    "nothing": (lambda d: d.index.update(record=[]), "record", "the set holds no record, no frequency_response"),
    "rig": (lambda d: d.index.update(rig="crane"), "rig", "'crane' is not a rig this reader knows"),
    "critical gain": (
        lambda d: d.index.update(critical_gain=[{"gain_mA_per_V": 21}]), "critical_gain.gain_mA_per_V", "gain_A_per_V",
    ),
    "spread in per cent": (
        lambda d: d.index.update(critical_gain=[{"gain_A_per_V": 0.02, "relative_std": 3}]),
        "critical_gain.relative_std", "outside the plausible range",
    ),
    "amplitude": (
        lambda d: d.index.update(frequency_response=[{"file": "records/force.csv", "amplitude_N": 0}]),
        "frequency_response.amplitude_N", "outside the plausible range",
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", SPOILED_INDEX)
def test_mistakes_in_the_index_are_refused_in_words(kind: str, sound: Recorded, tmp_path: Path):
    change, key, words = SPOILED_INDEX[kind]
    change(sound)
    error = refusal(sound.write(tmp_path))
    assert error.source == str(tmp_path / "dataset.toml")
    found = [problem for problem in error.problems if problem.key == key]
    assert found, str(error)
    assert words in found[0].reason, str(error)


def test_every_missing_file_is_named_at_once(sound: Recorded, tmp_path: Path):
    for row in sound.index["record"][:3]:
        row["file"] = row["file"].replace("csv", "txt")
    assert len(refusal(sound.write(tmp_path)).problems) == 3


def test_an_index_that_is_not_there_or_not_toml(tmp_path: Path):
    assert "No such file" in str(refusal(tmp_path))
    (tmp_path / "dataset.toml").write_text("name = small\n")
    assert "not valid TOML" in str(refusal(tmp_path))


def test_what_is_not_known_is_left_aside_with_a_warning(sound: Recorded, tmp_path: Path):
    sound.index["operator_note"] = "windy"
    sound.entry("force")["temperature_degC"] = 21.0
    sound.columns["steps"]["room_degC"] = np.full(1201, 21.0)
    warnings = read_dataset(sound.write(tmp_path)).warnings
    assert len(warnings) == 3
    assert all("left aside" in warning for warning in warnings)
    assert [name for name in ("operator_note", "temperature_degC", "room_degC") if name in "".join(warnings)] == [
        "operator_note", "temperature_degC", "room_degC",
    ]  # fmt: skip


@pytest.fixture
def responding(sound: Recorded, tmp_path: Path) -> Callable[..., Path]:
    """Writes a data set that is one frequency response of the believed rig, by transfer polynomials of its loop."""
    from beamdesign.loop import loop

    law = Lag(gain_A_per_V=0.122, pole_Hz=1.75, zero_Hz=26.0)
    frequencies = np.geomspace(1, 120, 40)
    at = loop(sound.prototype.but(controller=law)).at(0.0)
    response = np.asarray(at.compliance_response(frequencies))

    def write(magnitude: Callable[[np.ndarray], np.ndarray], phase: Callable[[np.ndarray], np.ndarray]) -> Path:
        table = np.column_stack([frequencies, magnitude(np.abs(response)), phase(np.angle(response, deg=True))])
        rows = "\n".join(",".join(map(repr, row)) for row in table.tolist())
        sound.index = {"frequency_response": [{"file": "r.csv", "controller": law.model_dump()}]}
        sound.columns = {}
        sound.files["r.csv"] = f"frequency_Hz,magnitude_m_per_N,phase_deg\n{rows}\n"
        return sound.write(tmp_path)

    return write


def same(values: np.ndarray) -> np.ndarray:
    return values


def test_a_response_to_a_command_has_a_column_of_its_own(sound: Recorded, responding: Callable[..., Path]):
    def with_column(name: str, **entry: object) -> Path:
        sound.files["r.csv"] = sound.files["r.csv"].replace("magnitude_m_per_N", name)
        sound.index["frequency_response"][0] |= entry
        return sound.write(folder)

    folder = responding(same, same)
    (taken,) = read_dataset(with_column("magnitude_m_per_V", amplitude_V=0.2)).responses
    assert (taken.driven_by, taken.amplitude) == (1, 0.2)
    assert "is stated for a file of magnitude_m_per_V" in str(
        refusal(with_column("magnitude_m_per_V", amplitude_N=9.0))
    )
    both = sound.files["r.csv"].replace("phase_deg", "magnitude_m_per_N")
    single, sound.files["r.csv"] = sound.files["r.csv"], both
    assert "stands beside magnitude_m_per_V" in str(refusal(sound.write(folder)))
    sound.files["r.csv"] = single
    entry = sound.index["frequency_response"][0]
    del entry["controller"], entry["amplitude_N"]
    assert "with the servo off a command moves nothing" in str(
        refusal(with_column("magnitude_m_per_V", servo_off=True))
    )


@pytest.mark.parametrize(
    ("magnitude", "phase", "key", "words"),
    [
        (lambda m: 20 * np.log10(m), same, "magnitude_m_per_N", "give the ratio in m/N, not decibels"),
        (lambda m: 1e3 * m, same, "magnitude_m_per_N", "values are in mm/N"),
        (lambda m: 1e6 * m, same, "magnitude_m_per_N", "values are in um/N"),
        (lambda m: 175.1268 * m, same, "magnitude_m_per_N", "values are in in/lbf"),
        (same, np.deg2rad, "phase_deg", "values are in radians"),
        (same, np.negative, "phase_deg", "its sign is the other way round"),
        (lambda m: np.where(np.arange(40) == 5, 0.0, m), same, "magnitude_m_per_N", "must be positive, is 0 in row 7"),
    ],
    ids=["decibels", "mm", "um", "inches per pound", "radians", "sign of phase", "zero"],
)
def test_frequency_responses_in_other_units_are_refused(magnitude, phase, key, words, responding, tmp_path):
    with pytest.raises(InputError) as caught:
        examine(read_dataset(responding(magnitude, phase)))
    assert caught.value.source == str(tmp_path / "r.csv")
    assert [problem.key for problem in caught.value.problems] == [key]
    assert words in caught.value.problems[0].reason


def test_a_frequency_response_of_a_rig_within_its_gap_passes(responding):
    data = read_dataset(responding(lambda m: 1.4 * m, lambda p: p - 15))
    assert examine(data).words == ()


def test_frequencies_in_radians_per_second_are_refused(responding, tmp_path):
    folder = responding(same, same)
    rows = (folder / "r.csv").read_text().splitlines()
    spoiled = [rows[0]]
    for row in rows[1:]:
        frequency, rest = row.split(",", 1)
        spoiled.append(f"{2 * np.pi * float(frequency)},{rest}")
    (folder / "r.csv").write_text("\n".join(spoiled))
    data = read_dataset(folder)
    with pytest.raises(InputError, match="values are in rad/s"):
        check_responses(data.responses, data.prototype)


def test_end_masses_in_grams_are_refused_of_responses_and_gains_too(sound: Recorded, responding, tmp_path: Path):
    """As of a record: by the gain that a loop with tons on its tip bears, the gain would have been in other units."""
    sound.index["critical_gain"] = [{"gain_A_per_V": 0.02, "outer_end_mass_kg": 6800.0}]
    with pytest.raises(InputError, match=r"critical_gain: entry 1: an end mass of 6800 kg .* \(is it in grams\?\)"):
        examine(read_dataset(sound.write(tmp_path / "gains")))
    data = read_dataset(responding(same, same))
    heavy = replace(data.responses[0], inner_end_mass=4400.0)
    with pytest.raises(InputError, match=r"an end mass of 4400 kg .* \(is it in grams\?\)"):
        check_responses([heavy], data.prototype)


def test_critical_gains_in_milliamperes_are_refused_and_far_ones_named(sound: Recorded, tmp_path: Path):
    law = {"kind": "lag", "pole_Hz": 1.75, "zero_Hz": 26.0}
    believed = critical_gain(sound.prototype.but(controller=Lag(gain_A_per_V=1.0, pole_Hz=1.75, zero_Hz=26.0)), 0.0)

    def given(factor: float) -> Path:
        sound.index["critical_gain"] = [{"controller": law, "gain_A_per_V": factor * believed.gain_A_per_V}]
        return sound.write(tmp_path)

    assert examine(read_dataset(given(0.6))).words == ()
    far = examine(read_dataset(given(30.0)))
    assert [caution.name for caution in far.warnings] == ["critical_gain"]
    assert not far.limits_confidence  # whether a rig is that far off, its diagnosis tells
    with pytest.raises(InputError, match="is it in mA/V"):
        examine(read_dataset(given(650.0)))
