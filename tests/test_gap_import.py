"""Data as people have them: CSV dialects, MATLAB and universal files become the same data set as our own CSV."""

from datetime import datetime, timedelta
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from pyuff import UFF, prepare_58
from scipy.io import savemat
from typer.testing import CliRunner

from beamdesign import InputError, import_measured, read_dataset, read_prototype
from beamdesign.cli import app
from beamdesign.diagnosis.data.dataset import TimeRecord
from beamdesign.diagnosis.data.importing import Imported
from beamdesign.diagnosis.data.measured_files import UNITS

RIG = Path(__file__).parent.parent / "studies" / "prototypes" / "tame_lag.toml"
TIMES = np.arange(400) / 1000


@pytest.fixture
def motion() -> dict[str, np.ndarray]:
    """A record of the channels in SI."""
    return {
        "t_s": TIMES,
        "disturbance_N": 100 * np.sin(30 * TIMES),
        "command_V": 0.2 * np.cos(9 * TIMES),
        "current_A": 1e-3 * np.sin(40 * TIMES),
        "displacement_m": 1e-4 * np.sin(50 * TIMES),
    }


def taken(path: Path, *columns: str, **more: object) -> TimeRecord:
    return imported(path, *columns, **more).dataset.records[0]


def imported(path: Path, *columns: str, **more: object) -> Imported:
    return import_measured([path], RIG, path.parent / "set", columns, **more)


def same(record: TimeRecord, motion: dict[str, np.ndarray]) -> None:
    assert record.times == pytest.approx(motion["t_s"], abs=1e-9)
    assert record.inputs[:, 0] == pytest.approx(motion["disturbance_N"], rel=1e-6, abs=1e-6)
    assert record.inputs[:, 1] == pytest.approx(motion["command_V"], rel=1e-6, abs=1e-9)
    assert record.measured["current_A"] == pytest.approx(motion["current_A"], rel=1e-6, abs=1e-9)
    assert record.measured["displacement_m"] == pytest.approx(motion["displacement_m"], rel=1e-6, abs=1e-12)


def test_a_spreadsheet_with_decimal_commas_and_a_row_of_units(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    """Times from 12 s on in ms, forces in kN, currents in mA, lengths in µm, in Latin letters."""
    factors = {"Zeit": 1e3, "Kraft": 1e-3, "Sollwert": 1.0, "Strom": 1e3, "Weg": 1e6}
    lines = ["Messung 7;;;;", ";".join(factors), "ms;kN;V;mA;µm"]
    values = np.column_stack(list(motion.values())) + np.array([12, 0, 0, 0, 0])
    lines += [";".join(f"{x:.12g}" for x in row * list(factors.values())).replace(".", ",") for row in values]
    (tmp_path / "lauf 1.csv").write_bytes("\n".join(lines).encode("latin-1"))
    found = imported(tmp_path / "lauf 1.csv", outer_end_masses_kg=np.float32(2.5))
    same(found.dataset.records[0], motion)
    assert found.dataset.records[0].outer_end_mass == 2.5
    (rows,) = found.taken.values()
    assert {one.channel: one.name for one in rows} == dict(zip(motion, factors, strict=True))


def test_units_in_the_names_signs_and_volts_of_the_sensor(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    """The displacement as the sensor's millivolts over 1180 V/m; a valve wired the other way round; no command."""
    names = "Time (s),Load Cell [lbf],i_valve (mA),LVDT [mV],temperature [C]"
    table = np.column_stack([
        TIMES,
        motion["disturbance_N"] / UNITS["N"]["lbf"],
        -1e3 * motion["current_A"],
        1e3 * 1180 * motion["displacement_m"],
        20 + TIMES,
    ])  # fmt: skip
    np.savetxt(tmp_path / "a.csv", table, "%.12g", ",", header=names, comments="")
    same(taken(tmp_path / "a.csv", "current_A = -i_valve [mA]"), motion | {"command_V": 0 * TIMES})


def test_a_current_that_nobody_recorded(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    del motion["current_A"]
    path = tmp_path / "a.csv"
    np.savetxt(path, np.stack(list(motion.values()), 1), "%.12g", ",", header=",".join(motion), comments="")
    with pytest.raises(InputError, match="say that there is none, --column 'current_A = 0'"):
        taken(path)
    assert list(taken(path, "current_A = 0").measured) == ["displacement_m"]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])  # the last as spreadsheets write "Unicode text"
def test_units_in_the_words_of_names(tmp_path: Path, motion: dict[str, np.ndarray], encoding: str) -> None:
    """A direction in such words is a part of the name."""
    names = {"Zeit in ms": 1e3, "Kraft in z": 1.0, "Sollwert in V": 1.0, "Strom in mA": 1e3, "Weg in µm": 1e6}
    rows = np.column_stack(list(motion.values())) * list(names.values())
    text = "\n".join([";".join(names), *(";".join(f"{x:.12g}" for x in row) for row in rows)])
    (tmp_path / "a.csv").write_text(text, encoding=encoding)
    found = imported(tmp_path / "a.csv")
    same(found.dataset.records[0], motion)
    (rows_taken,) = found.taken.values()
    assert {one.name for one in rows_taken} == {"Zeit", "Kraft in z", "Sollwert", "Strom", "Weg"}


@pytest.mark.parametrize(
    "head",
    [
        "Temps [s];Force [N];Consigne [V];Courant [A];Déplacement [m]",
        "Tiempo (s);Fuerza (N);Consigna (V);Corriente (A);Desplazamiento (m)",
        "Tempo [s];Forza [N];Comando [V];Corrente [A];Spostamento [m]",
        "Time (seconds);Force (newtons);Command (volts);Current (amps);Displacement (inches)",
    ],
)
def test_names_of_other_languages_and_units_in_words(tmp_path: Path, motion: dict[str, np.ndarray], head: str) -> None:
    rows = np.column_stack(list(motion.values())) / (1.0, 1.0, 1.0, 1.0, 0.0254 if "inches" in head else 1.0)
    text = "\n".join([head, *(";".join(f"{x:.12g}" for x in row) for row in rows)])
    (tmp_path / "a.csv").write_bytes(text.replace(".", ",").encode("latin-1"))
    same(taken(tmp_path / "a.csv"), motion)


def test_units_that_names_end_in(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    names = {"t_ms": 1e3, "force_kN": 1e-3, "command_mV": 1e3, "current_mA": 1e3, "x_um": 1e6}
    rows = np.column_stack(list(motion.values())) * list(names.values())
    np.savetxt(tmp_path / "a.csv", rows, "%.12g", ",", header=",".join(names), comments="")
    found = imported(tmp_path / "a.csv")
    same(found.dataset.records[0], motion)
    (rows_taken,) = found.taken.values()
    assert [one.unit for one in rows_taken] == ["ms", "kN", "mV", "mA", "um"]
    assert not any(one.words for one in rows_taken)


@pytest.mark.parametrize(("name", "unit", "per_m"), [("lvdt_mV", "mV", 1e3 * 1180), ("lvdt_A", "m", 1.0)])
def test_a_name_ends_in_a_unit_of_its_channel_alone(
    tmp_path: Path, motion: dict[str, np.ndarray], name: str, unit: str, per_m: float
) -> None:
    """Millivolts of the sensor of 1180 V/m, and a sensor called A."""
    motion["displacement_m"] *= per_m
    header = ",".join((*list(motion)[:-1], name))
    np.savetxt(tmp_path / "a.csv", np.stack(list(motion.values()), 1), "%.12g", ",", header=header, comments="")
    found = imported(tmp_path / "a.csv")
    motion["displacement_m"] /= per_m
    same(found.dataset.records[0], motion)
    (rows_taken,) = found.taken.values()
    assert [one.unit for one in rows_taken if one.name == name] == [unit]


SCHEDULED = RIG.parent.parent / "scheduled" / "prototype.toml"


def test_the_stage_that_acted_is_stated_where_two_may_have(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    """2.2 kg are for the first law and for the second, 0.5 kg for the first alone."""
    files = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for file in files:
        np.savetxt(file, np.column_stack(list(motion.values())), "%.12g", ",", header=",".join(motion), comments="")
    both = partial(import_measured, files, SCHEDULED, tmp_path / "set", outer_end_masses_kg=[0.5, 2.2])
    for stages, words in (
        ((), r"--stage: of .*b\.csv: 2 of the 3 laws of 'scheduled' are for 2\.2 kg; give the number"),
        ((4,), "--stage: there is no 4; stages are 1 to 3"),
        ((1, 2, 3), "--stage: give one for all, or one for each of 2 files; there are 3"),
    ):
        with pytest.raises(InputError, match=words):
            both(stages=stages)
    with pytest.raises(InputError, match=r"--stage: .* has no scheduled controller"):
        import_measured(files, RIG, tmp_path / "set", stages=[1])
    laws = read_prototype(SCHEDULED).schedule.laws
    assert [one.controller for one in both(stages=[1, 2]).dataset.records] == [laws[0][0], laws[1][0]]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"rest_s": 0.399}, r"a\.csv: --rest-s: is 0\.399 s"),
        ({"rest_s": np.inf}, r"a\.csv: --rest-s: is inf s"),
        ({"rest_s": np.nan}, r"a\.csv: --rest-s: is nan s"),
        ({"rest_s": -1.0}, r"a\.csv: --rest-s: is -1 s"),
        ({"outer_end_masses_kg": [-1.0]}, r"^gap import: --outer-end-mass: is -1\.0, .* kg$"),
        ({"inner_end_mass_kg": np.nan}, r"^gap import: --inner-end-mass: is nan, .* kg$"),
        (
            {"columns": ["current_A = current_A", "current_A = -current_A"]},
            "^gap import: --column: 'current_A' is named twice",
        ),
    ],
)
def test_what_is_said_wrongly_of_a_file_is_refused(
    tmp_path: Path, motion: dict[str, np.ndarray], more: dict[str, object], words: str
) -> None:
    """A rest that outlasts the record would take motion off; a refusal names an option, and no folder of its own."""
    values = np.column_stack(list(motion.values()))
    np.savetxt(tmp_path / "a.csv", values, "%.12g", ",", header=",".join(motion), comments="")
    with pytest.raises(InputError, match=words):
        import_measured([tmp_path / "a.csv"], RIG, tmp_path / "set", **more)
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


def test_what_it_rests_at_is_taken_off(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    still = {name: np.where(TIMES < 0.1, 0.0, values) + 3.0 * (name != "t_s") for name, values in motion.items()}
    still["t_s"] = TIMES
    np.savetxt(
        tmp_path / "a.csv", np.column_stack(list(still.values())), "%.12g", ",", header=",".join(still), comments=""
    )
    record = taken(tmp_path / "a.csv", rest_s=0.1)
    assert abs(record.measured["displacement_m"][:100]).max() < 1e-9
    assert record.inputs[-1, 0] == pytest.approx(motion["disturbance_N"][-1])


def test_matlab_structures(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    fields = dict(zip(("time", "force", "ref", "current", "tip"), motion.values(), strict=True))
    savemat(tmp_path / "run.mat", {"log": fields, "comment": "text", "fs": 1000.0})
    same(taken(tmp_path / "run.mat", "t_s = log.time"), motion)


def test_a_matlab_matrix_and_an_interval_that_is_stated(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    """Columns of a matrix are counted as MATLAB counts them, and there may be none with times."""
    savemat(tmp_path / "run.mat", {"log": np.column_stack(list(motion.values())[1:])})
    columns = [f"{channel} = log({k})" for k, channel in enumerate(motion)][1:]
    with pytest.raises(InputError, match=r"or state the interval.*log\(1\), log\(2\), log\(3\), log\(4\)"):
        imported(tmp_path / "run.mat", *columns)
    same(taken(tmp_path / "run.mat", "t_s = 1 [ms]", *columns), motion)


def test_a_channel_of_another_length_is_not_left_out(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    """A command with half as many samples was taken for none."""
    savemat(tmp_path / "run.mat", motion | {"command_V": motion["command_V"][::2]})
    with pytest.raises(InputError, match="command_V: 'command_V' has 200 values, where the others have 400"):
        imported(tmp_path / "run.mat")


def test_a_head_with_a_comment_that_has_no_column(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    """As LabVIEW writes measurement files, behind a head of its own."""
    lines = ["Channels\t4\t\t\t", "***End_of_Header***\t\t\t\t", "X_Value\tForce\tCommand\tCurrent\tTip\tComment"]
    lines += ["\t".join(f"{x:.12g}" for x in row) for row in np.column_stack(list(motion.values()))]
    (tmp_path / "a.lvm").write_text("\n".join(lines))
    same(taken(tmp_path / "a.lvm"), motion)


def test_universal_files_of_time_and_of_frequency(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    """An accelerance in g-free units over N is a compliance times -w^2 (D. J. Ewins, Modal Testing, 2000)."""
    path = tmp_path / "run.uff"
    units = {"disturbance_N": "N", "command_V": "V", "current_A": "A", "displacement_m": "m"}
    place = {"binary": 0, "rsp_node": 1, "rsp_dir": 3, "ref_node": 1, "ref_dir": 3, "abscissa_spacing": 1}
    sets = [
        prepare_58(
            **place | {"func_type": 1, "id1": name, "data": motion[name], "x": TIMES, "num_pts": len(TIMES)},
            **{"abscissa_min": 0.0, "abscissa_inc": 1e-3, "ordinate_axis_units_lab": unit, "ord_data_type": 4},
            orddenom_spec_data_type=0,
        )
        for name, unit in units.items()
    ]
    hertz = np.linspace(1.0, 100.0, 100)
    s = 2j * np.pi * hertz
    compliance = 1 / (4e5 + 20 * s + 8 * s**2)
    accelerance = {"func_type": 4, "id1": "accelerance", "data": s**2 * compliance, "x": hertz, "num_pts": 100}
    kinds = {"ord_data_type": 6, "ordinate_spec_data_type": 12, "orddenom_spec_data_type": 13}
    labels = {"ordinate_axis_units_lab": "m/s^2", "orddenom_axis_units_lab": "N"}
    sets.append(prepare_58(**place | accelerance | kinds | labels, abscissa_min=1.0, abscissa_inc=1.0))
    writer = UFF(str(path))
    for k, one in enumerate(sets):
        writer.write_sets(one, "overwrite" if k == 0 else "add")
    found = imported(path).dataset
    assert found.records[0].measured["displacement_m"] == pytest.approx(motion["displacement_m"], abs=1e-9)
    (response,) = found.responses
    assert abs(response.response) == pytest.approx(abs(compliance), rel=1e-3)


HERTZ = np.linspace(1.0, 100.0, 50)
S = 2j * np.pi * HERTZ
COMPLIANCE = 1 / (4e5 + 200 * S + 8 * S**2)
"""m/N, of 8 kg on a spring of 400 kN/m and a dashpot: 2.5 um/N at rest."""


def decibels(values: np.ndarray) -> np.ndarray:
    return 20 * np.log10(abs(values))


@pytest.mark.parametrize(
    ("head", "columns"),
    [
        ("frequency_Hz,magnitude_m_per_N,phase_rad", (HERTZ, abs(COMPLIANCE), np.angle(COMPLIANCE))),
        ("Freq_Hz,Mag_dB,Phase_deg", (HERTZ, decibels(COMPLIANCE), np.angle(COMPLIANCE, deg=True))),
        (
            "Frequency [Hz],Magnitude [dB re 1 um/N],Phase [rad]",
            (HERTZ, decibels(1e6 * COMPLIANCE), np.angle(COMPLIANCE)),
        ),
        ("Frequency [Hz],Magnitude [mm/kN]", ()),
        (
            "Frequency [rad/s],Real [g/N],Imag [g/N]",
            (abs(S), (S**2 * COMPLIANCE).real / 9.80665, (S**2 * COMPLIANCE).imag / 9.80665),
        ),
        (
            "Frequency [kHz],Mobility [mm/s/N],Phase [deg],Coherence",
            (HERTZ / 1e3, 1e3 * abs(S * COMPLIANCE), np.angle(S * COMPLIANCE, deg=True), 0.9 + 0 * HERTZ),
        ),
        (
            "Frequency [Hz],abs coherence,Mobility [(m/s)/N],Phase [deg]",
            (HERTZ, 0.9 + 0 * HERTZ, abs(S * COMPLIANCE), np.angle(S * COMPLIANCE, deg=True)),
        ),
        ("Frequency,Inertance,Phase", (HERTZ, abs(S**2 * COMPLIANCE), np.angle(S**2 * COMPLIANCE, deg=True))),
        (
            "Frequency [Hz],Magnitude inner [m/N],Phase inner [deg],Magnitude tip [m/N],Phase tip [deg]",
            (HERTZ, 1 + HERTZ, 9 * HERTZ, abs(COMPLIANCE), np.angle(COMPLIANCE, deg=True)),
        ),
        (
            "Frequency [Hz],Compliance [in/lbf],Phase [deg]",
            (HERTZ, abs(COMPLIANCE) / 0.0254 * 4.4482216152605, np.angle(COMPLIANCE, deg=True)),
        ),
    ],
)
def test_frequency_responses_in_columns(tmp_path: Path, head: str, columns: tuple[np.ndarray, ...]) -> None:
    """Whatever they are written in, and from high to low: an accelerance is -w^2 times a compliance (Ewins 2000)."""
    rows = np.column_stack(columns or (HERTZ, 1e6 * abs(COMPLIANCE)))[::-1]
    np.savetxt(tmp_path / "a.csv", rows, "%.12g", ",", header=head, comments="")
    (found,) = imported(tmp_path / "a.csv").dataset.responses
    assert found.frequencies_Hz == pytest.approx(HERTZ)
    assert found.has_phase == bool(columns)
    assert found.response == pytest.approx(COMPLIANCE if columns else abs(COMPLIANCE), rel=1e-6)


@pytest.mark.parametrize(
    ("head", "words"),
    [
        ("Frequency [Hz],Magnitude,Phase [deg]", "negative values of 'Magnitude': state its unit where these are deci"),
        ("Frequency [Hz],Force [N],Phase [deg]", "neither a magnitude nor a real and an imaginary part"),
        ("Frequency [Hz],Magnitude [dB re 1 furlong/N],Phase [deg]", "'furlong/N' is no motion over a force"),
        ("Frequency [Hz],Magnitude [dB],Phase [turns]", "phases in 'turns'; known are deg and rad"),
        (
            "Frequency [Hz],Mag A [m/N],Mag B [m/N]",
            "its magnitude may be 'Mag A' or 'Mag B': leave the response of the ou",
        ),
        ("Frequency [1/min],Magnitude [dB],Phase [deg]", "frequencies in '1/min'; known are Hz"),
    ],
)
def test_a_response_that_cannot_be_told_is_refused(tmp_path: Path, head: str, words: str) -> None:
    rows = np.column_stack([HERTZ, decibels(COMPLIANCE), np.angle(COMPLIANCE, deg=True)])
    np.savetxt(tmp_path / "a.csv", rows, "%.12g", ",", header=head, comments="")
    with pytest.raises(InputError, match=words):
        imported(tmp_path / "a.csv")


def test_no_column_of_a_response_is_left_out_in_silence(tmp_path: Path) -> None:
    """A phase in radians counted for none."""
    rows = np.column_stack([HERTZ, abs(COMPLIANCE), np.angle(COMPLIANCE), 0 * HERTZ])
    head = "frequency_Hz,magnitude_m_per_N,phase_deg,coherence"
    np.savetxt(tmp_path / "a.csv", rows, "%.12g", ",", header=head.replace(",c", "_,c"), comments="")
    imported(tmp_path / "a.csv")
    written = tmp_path / "set" / "records" / "a_magnitude.csv"
    np.savetxt(written, rows, "%.12g", ",", header=head, comments="")
    (warning,) = read_dataset(tmp_path / "set").warnings
    assert "column coherence is not known here" in warning
    np.savetxt(written, rows, "%.12g", ",", header=head.replace("deg", "rad"), comments="")
    with pytest.raises(InputError, match="phase_deg: column missing; the file has phase_rad: give it in deg"):
        read_dataset(tmp_path / "set")


@pytest.mark.parametrize(("axis", "per_s", "hertz"), [("ms", 1e3, "kHz"), ("", 1.0, "rad/s"), ("sec", 1.0, "Hz")])
def test_axes_of_universal_files_are_in_the_units_they_state(
    tmp_path: Path, motion: dict[str, np.ndarray], axis: str, per_s: float, hertz: str
) -> None:
    """50 kHz in ms are steps of 0.02, which as seconds would pass for 50 Hz."""
    units = {"disturbance_N": "N", "command_V": "V", "current_A": "A", "displacement_m": "m"}
    place = {
        "binary": 0,
        "rsp_node": 1,
        "rsp_dir": 3,
        "ref_node": 1,
        "ref_dir": 3,
        "abscissa_spacing": 1,
        "num_pts": 400,
    }
    times, lines = TIMES / 50, np.linspace(1.0, 400.0, 400)
    writer = UFF(str(tmp_path / "run.uff"))
    for k, (name, unit) in enumerate(units.items()):
        values = {"data": motion[name], "x": per_s * times, "abscissa_min": 0.0, "abscissa_inc": per_s * times[1]}
        labels = {"ordinate_axis_units_lab": unit, "abscissa_axis_units_lab": axis}
        one = prepare_58(**place, **values, **labels, func_type=1, id1=name, ord_data_type=4, orddenom_spec_data_type=0)
        writer.write_sets(one, "overwrite" if k == 0 else "add")
    own = {"kHz": 1e-3, "rad/s": 2 * np.pi, "Hz": 1.0}[hertz] * lines
    values = {"data": 1e-6 / (1 + 1j * lines), "x": own, "abscissa_min": own[0], "abscissa_inc": own[1] - own[0]}
    kinds = {"ord_data_type": 6, "ordinate_spec_data_type": 8, "orddenom_spec_data_type": 13}
    labels = {"ordinate_axis_units_lab": "m", "orddenom_axis_units_lab": "N", "abscissa_axis_units_lab": hertz}
    writer.write_sets(prepare_58(**place, **values, **kinds, **labels, func_type=4, id1="h"), "add")
    found = imported(tmp_path / "run.uff").dataset
    assert found.records[0].times == pytest.approx(times, abs=1e-9)
    assert found.responses[0].frequencies_Hz == pytest.approx(lines, rel=1e-4)


def test_a_motion_over_a_motion_is_no_compliance(tmp_path: Path) -> None:
    """A transmissibility, whose denominator is an acceleration (data type 12), without labels of units."""
    place = {"binary": 0, "rsp_node": 1, "rsp_dir": 3, "ref_node": 1, "ref_dir": 3, "abscissa_spacing": 1}
    kinds = {"ord_data_type": 6, "ordinate_spec_data_type": 12, "orddenom_spec_data_type": 12}
    values = {"data": np.ones(50, complex), "x": np.linspace(1.0, 50.0, 50), "num_pts": 50}
    one = prepare_58(**place | kinds | values, func_type=4, id1="over", abscissa_min=1.0, abscissa_inc=1.0)
    UFF(str(tmp_path / "run.uff")).write_sets(one, "overwrite")
    with pytest.raises(InputError, match="no frequency response of a motion to a force"):
        imported(tmp_path / "run.uff")


def table(path: Path, head: str, columns: list[np.ndarray], end: str = "") -> Path:
    """A file of columns under a head, with something at the end of every row."""
    rows = (",".join(f"{x:.12g}" for x in row) + end for row in np.column_stack(columns))
    path.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    return path


HEAD = "time [s],force [N],cmd [V],current [A],tip [m]"


@pytest.mark.parametrize("head", [HEAD, HEAD + ","])
def test_rows_that_end_with_a_separator(tmp_path: Path, motion: dict[str, np.ndarray], head: str) -> None:
    same(taken(table(tmp_path / "a.csv", head, list(motion.values()), end=",")), motion)


def test_a_channel_that_was_sampled_half_as_often(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    """Cells at the end of a row are empty, and no separator; of 50 rad/s at 500 Hz a spline misses 5/384 0.1^4."""
    path = table(tmp_path / "a.csv", HEAD, list(motion.values()))
    head, *rows = path.read_text(encoding="utf-8").splitlines()
    rows[1::2] = [f"{row.rpartition(',')[0]}," for row in rows[1::2]]
    path.write_text("\n".join([head, *rows]), encoding="utf-8")
    found = imported(path)
    (record,) = found.dataset.records
    assert len(record.times) == 399  # the last row is behind the last displacement
    inside = slice(5, -5)  # where the spline's ends, whose slopes nobody knows, play no part any more
    found_m = record.measured["displacement_m"][inside]
    assert found_m == pytest.approx(motion["displacement_m"][:399][inside], abs=1e-4 * 5 / 384 * 0.1**4 + 1e-13)
    assert any("missing values of displacement_m are splines" in words for words in found.dataset.warnings)


def test_of_columns_of_one_name_that_in_the_unit_stated_is_meant(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    *others, tip = motion.values()
    head = HEAD.replace("tip [m]", "tip [mm],tip [V]")
    path = table(tmp_path / "a.csv", head, [*others, 1e3 * tip, 50.0 * tip])
    same(taken(path, "displacement_m = tip [mm]"), motion)
    with pytest.raises(InputError, match="there are 2 columns 'tip': name one with its own unit"):
        import_measured([path], RIG, tmp_path / "other", ["displacement_m = tip"])


def test_a_channel_has_another_name_in_another_file(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    """Of several that are named that counts which a file has, with its own unit and sign; none and two are refused."""
    time, force, _, current, tip = motion.values()
    first = table(tmp_path / "a.csv", "t,AI0,AI1,AI2", [time, force, 1e3 * current, 1e3 * tip])
    second = table(tmp_path / "b.csv", "t,ch1,ch2,AI2b", [time, 1e6 * tip, -current, 1e-3 * force])
    ways = "disturbance_N = AI0", "current_A = AI1 [mA]", "displacement_m = AI2 [mm]"
    ways += "displacement_m = ch1 [um]", "current_A = -ch2", "disturbance_N = AI2b [kN]"
    found = import_measured([first, second], RIG, tmp_path / "set", ways)
    for record in found.dataset.records:
        same(record, motion | {"command_V": 0 * TIMES})
    with pytest.raises(InputError, match=r"b\.csv: displacement_m: there is no column 'AI2'; the file has t, ch1"):
        import_measured([first, second], RIG, tmp_path / "other", ways[:3])
    with pytest.raises(InputError, match=r"a\.csv: disturbance_N: there are 2 columns 'AI0' or 'AI1'"):
        import_measured([first], RIG, tmp_path / "other", ["disturbance_N = AI0", "disturbance_N = AI1", *ways[1:3]])
    without = "disturbance_N = AI0", "disturbance_N = 0", *ways[1:5]
    assert np.ptp(import_measured([second], RIG, tmp_path / "third", without).dataset.records[0].inputs[:, 0]) == 0


@pytest.mark.parametrize("name", ["Screw force", "spindle_force", "Spindelkraft"])
def test_the_force_of_a_screw_is_no_disturbance(tmp_path: Path, motion: dict[str, np.ndarray], name: str) -> None:
    found = imported(table(tmp_path / "a.csv", HEAD.replace("force", name), list(motion.values())))
    (rows,) = found.taken.values()
    assert {one.channel: one.name for one in rows if one.channel.endswith("_N")} == {
        "screw_force_N": name,
        "disturbance_N": "",
    }


def test_of_two_chambers_neither_need_be_the_load_pressure(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    """What is not recorded is said not to be; what has to be there cannot be said away."""
    both = motion | {"pressure A [bar]": 50 + TIMES, "pressure B [bar]": 50 - TIMES}
    table = np.column_stack(list(both.values()))
    np.savetxt(tmp_path / "a.csv", table, "%.12g", ",", header=",".join(both), comments="")
    with pytest.raises(InputError, match=r"load_pressure_Pa: may be .* --column 'load_pressure_Pa = 0'"):
        imported(tmp_path / "a.csv")
    with pytest.raises(InputError, match="displacement_m: there is no column '0'"):
        imported(tmp_path / "a.csv", "displacement_m = 0", "load_pressure_Pa = 0")
    record = taken(tmp_path / "a.csv", "load_pressure_Pa = 0")
    same(record, motion)
    assert "load_pressure_Pa" not in record.measured


def test_what_is_refused_names_the_file_that_was_given(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    motion["displacement_m"][7] = np.inf
    path = table(tmp_path / "a.csv", "a line before\n" + HEAD, list(motion.values()))
    with pytest.raises(
        InputError, match=r"a\.csv: displacement_m: 'tip' has 1 values that are not finite: .* number 8 of"
    ):
        imported(path)
    motion["displacement_m"][7] = 0.0
    motion["t_s"] = np.roll(motion["t_s"], 1)
    with pytest.raises(InputError) as refused:
        imported(table(tmp_path / "a.csv", HEAD, list(motion.values())))
    assert refused.value.source == f"{tmp_path / 'a.csv'}, as records/a.csv"


def test_what_cannot_be_told_is_asked_with_what_there_is(tmp_path: Path) -> None:
    head = "t,force A [N],force B [N],signal [V]\n"
    (tmp_path / "a.csv").write_text(head + "\n".join(f"{0.001 * k},1,2,3" for k in range(10)))
    with pytest.raises(InputError) as refused:
        imported(tmp_path / "a.csv")
    told = {problem.key: problem.reason for problem in refused.value.problems}
    assert "'force A' or 'force B'" in told["disturbance_N"]
    assert set(told) == {"disturbance_N", "command_V", "current_A", "displacement_m"}
    assert "may be 'signal', by its unit" in told["command_V"]
    assert "signal [V]" in told["current_A"]
    assert "what another recorder wrote goes into it first" in told["displacement_m"]
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize("name", ["u", "u_V", "U"])
def test_a_command_called_u_is_one(tmp_path: Path, motion: dict[str, np.ndarray], name: str) -> None:
    same(taken(table(tmp_path / "a.csv", f"t,F,{name},i,x", [*motion.values()])), motion)


@pytest.mark.parametrize(
    ("head", "words"),
    [
        (
            "t_s,Load cell [mV],command_V,current_A,displacement_m",
            "disturbance_N: may be 'Load cell', by its name, .* 'mV'",
        ),
        (
            "t_s,disturbance_N,Setpoint [mm],current_A,displacement_m",
            "command_V: may be 'Setpoint', by its name, .* 'mm'",
        ),
        ("t_s,shaker_N,command_V,current_A,displacement_m", "disturbance_N: may be 'shaker_N', by its unit"),
    ],
)
def test_an_input_that_may_be_there_is_not_taken_as_zero(
    tmp_path: Path, motion: dict[str, np.ndarray], head: str, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        taken(table(tmp_path / "a.csv", head, [*motion.values()]))


def test_columns_that_are_not_taken_are_told(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    columns = [*motion.values(), 20 + TIMES, 0 * TIMES]
    found = imported(table(tmp_path / "a.csv", f"{','.join(motion)},Temp [°C],status", columns))
    assert found.rows()[-1] == ("a.csv", "", "Temp [°C], status", "not taken")


def test_matlab_numbers_without_an_imaginary_part_are_numbers(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    savemat(tmp_path / "a.mat", {"a": motion | {"disturbance_N": motion["disturbance_N"] + 0j}})
    same(taken(tmp_path / "a.mat"), motion)


def test_a_row_that_was_lost_keeps_its_place(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    """Where the interval is stated, rows of nothing but commas and rows that are commented out are splines."""
    rows = [",".join(f"{x:.12g}" for x in row) for row in zip(*list(motion.values())[1:], strict=True)]
    rows[100], rows[200] = ",,,", "# 9000,0,0,0"
    (tmp_path / "a.csv").write_text("\n".join([",".join(list(motion)[1:]), *rows, ",,,", "# the end"]) + "\n")
    found = taken(tmp_path / "a.csv", "t_s = 0.001 [s]")
    assert len(found.times) == len(TIMES)
    for name in ("current_A", "displacement_m"):
        assert found.measured[name] == pytest.approx(motion[name], abs=1e-3 * np.ptp(motion[name]))


def test_a_row_that_is_commented_out_is_lost_where_there_are_times(
    tmp_path: Path, motion: dict[str, np.ndarray]
) -> None:
    rows = [",".join(f"{x:.12g}" for x in row) for row in zip(*motion.values(), strict=True)]
    rows[200] = f"# {TIMES[200]},9000,0,0,0"
    (tmp_path / "a.csv").write_text("\n".join([",".join(motion), *rows]) + "\n")
    found = taken(tmp_path / "a.csv")
    assert found.inputs[:, 0] == pytest.approx(motion["disturbance_N"], abs=0.2)


def test_a_value_that_a_recorder_repeats_is_one_value(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    """A force at a quarter of the rate, held between; the command of a sampled controller is held itself."""
    motion["disturbance_N"] = 100 * np.cos(2 * np.pi * 5 * TIMES)
    held = motion | {name: np.repeat(motion[name][::4], 4) for name in ("disturbance_N", "command_V")}
    found = imported(table(tmp_path / "a.csv", ",".join(motion), [*held.values()]))
    (record,), last = found.dataset.records, len(TIMES) - 3
    assert record.inputs[:, 0] == pytest.approx(motion["disturbance_N"][:last], abs=0.02)
    assert record.inputs[:, 1] == pytest.approx(held["command_V"][:last], abs=1e-9)
    assert "repeat the last, 3 of 4" in {row[1]: row[3] for row in found.rows()}["disturbance_N"]
    steps = motion | {"disturbance_N": 50.0 * np.sign(np.sin(2 * np.pi * TIMES / 0.016 + 0.1))}  # a load that steps
    same(
        import_measured(
            [table(tmp_path / "b.csv", ",".join(motion), [*steps.values()])], RIG, tmp_path / "b"
        ).dataset.records[0],
        steps,
    )


@pytest.mark.parametrize("comma", ["1,234", "999,5"])
def test_numbers_with_points_and_with_commas_are_refused(
    tmp_path: Path, motion: dict[str, np.ndarray], comma: str
) -> None:
    rows = [";".join(f"{x:.12g}" for x in row) for row in zip(*motion.values(), strict=True)]
    rows[9] = f"{TIMES[9]};{comma};0.1;0.1;0.1"
    (tmp_path / "a.csv").write_text("\n".join([";".join(motion), *rows]))
    with pytest.raises(InputError, match="a decimal point and numbers with a comma"):
        taken(tmp_path / "a.csv")


def test_a_name_with_a_comma_of_its_own_shifts_no_unit(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    head = "t [s],force [N],cmd [V],current [A],displacement, tip [mm]"
    columns = [*list(motion.values())[:4], 1e3 * motion["displacement_m"]]
    with pytest.raises(InputError, match="has 6 cells right above its numbers, whose rows have 5"):
        taken(table(tmp_path / "a.csv", head, columns))
    quoted = head.replace("displacement, tip [mm]", '"displacement, tip [mm]"')
    same(taken(table(tmp_path / "a.csv", quoted, columns)), motion)


@pytest.mark.parametrize(
    "above",
    ["Test 12,,,,\nt_s,F_N,cmd_V,i_A,x_m", "Time,Force,Command,Current,Displacement\nseconds,Newtons,Volts,amps,m"],
)
def test_names_and_units_are_told_apart(tmp_path: Path, motion: dict[str, np.ndarray], above: str) -> None:
    """A title that a spreadsheet fills up with commas is no row of names, and units may be words."""
    same(taken(table(tmp_path / "a.csv", above, [*motion.values()])), motion)


def test_a_channel_that_begins_later_cuts_the_record(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    rows = [[f"{x:.12g}" for x in row] for row in zip(*motion.values(), strict=True)]
    for row in rows[:10]:
        row[4] = ""
    (tmp_path / "a.csv").write_text("\n".join([",".join(motion), *(",".join(row) for row in rows)]))
    cut = {name: values[10:] for name, values in motion.items()} | {"t_s": TIMES[: len(TIMES) - 10]}
    same(taken(tmp_path / "a.csv"), cut)


def test_a_file_is_not_imported_twice(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    path = table(tmp_path / "a.csv", ",".join(motion), [*motion.values()])
    with pytest.raises(InputError, match=r"a\.csv stands there more than once"):
        import_measured([path, tmp_path / "." / "a.csv"], RIG, tmp_path / "set")


def test_names_that_follow_one_another_stay_apart(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    """As `*.csv` gives them: the name made for a second `run` would be that of the first file."""
    rows = [",".join(motion), *(",".join(f"{x:.9g}" for x in row) for row in np.column_stack(list(motion.values())))]
    files = [
        tmp_path / one / f"{name}.csv" for one, name in (("a", "run_2"), ("a", "run"), ("b", "run"), ("a", "run1"))
    ]
    for file in files:
        file.parent.mkdir(exist_ok=True)
        file.write_text("\n".join(rows), encoding="utf-8")
    found = import_measured(files, RIG, tmp_path / "set")
    assert [one.name for one in found.dataset.records] == ["run_2", "run", "run_3", "run1"]


def test_numbers_as_fortran_writes_them(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    rows = np.column_stack(list(motion.values()))
    for mark in "dD":
        text = "\n".join([",".join(motion), *(",".join(f"{x:.12e}".replace("e", mark) for x in row) for row in rows)])
        (tmp_path / f"{mark}.csv").write_text(text, encoding="utf-8")
        same(import_measured([tmp_path / f"{mark}.csv"], RIG, tmp_path / f"set {mark}").dataset.records[0], motion)


def test_nothing_is_written_over_and_nothing_half_is_left(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    values = np.column_stack(list(motion.values()))
    np.savetxt(tmp_path / "a.csv", values, "%.12g", ",", header=",".join(motion), comments="")
    imported(tmp_path / "a.csv")
    before = (tmp_path / "set" / "dataset.toml").read_text()
    with pytest.raises(InputError, match="holds a data set already"):
        imported(tmp_path / "a.csv")
    assert (tmp_path / "set" / "dataset.toml").read_text() == before
    values[7, 0] = values[6, 0]  # a time that repeats, which only the reader of data sets refuses
    np.savetxt(tmp_path / "b.csv", values, "%.12g", ",", header=",".join(motion), comments="")
    with pytest.raises(InputError, match="does not rise") as refused:
        import_measured([tmp_path / "b.csv"], RIG, tmp_path / "other")
    assert refused.value.source == f"{tmp_path / 'b.csv'}, as records/b.csv"
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize("given", [{}, {"fmt": "%9.6e"}, {"fmt": "%+17.9f", "comments": "  "}])
@pytest.mark.parametrize("decimal", ".,")
def test_columns_that_blanks_part(tmp_path: Path, motion: dict[str, np.ndarray], given: dict, decimal: str) -> None:
    """As numpy.savetxt writes them when nothing else is asked; and in columns of one width, blanks in their names."""
    table, names = np.column_stack(list(motion.values())), " ".join(motion)
    if "comments" in given:
        names, table = "Time [s]  Force [N]  Command [V]  Current [mA]  Tip [um]", table * (1.0, 1.0, 1.0, 1e3, 1e6)
    np.savetxt(tmp_path / "a.txt", table, header=names, **given)
    text = (tmp_path / "a.txt").read_text()
    (tmp_path / "a.txt").write_text(text.replace(".", decimal))
    same(taken(tmp_path / "a.txt"), motion)


@pytest.mark.parametrize(
    ("begin", "form"),
    [
        ("2026-02-28T23:59:59.9", "%Y-%m-%dT%H:%M:%S.%fZ"),
        ("2026-02-28T23:59:59.9", "%Y-%m-%d %H:%M:%S,%f"),
        ("2026-02-28T13:05:00.0", "%H:%M:%S.%f"),
        ("2026-02-28T23:59:59.9", "%H:%M:%S.%f"),  # over midnight
        ("2026-02-28T23:59:59.9", "%Y-%m-%d;%H:%M:%S.%f"),
        ("2026-02-28T23:59:59.9", "%d.%m.%Y %H:%M:%S,%f"),  # the last day of a month
        ("2026-02-28T23:59:59.9", "%d.%m.%y;%H:%M:%S,%f"),
        ("2026-12-31T23:59:59.9", "%m/%d/%Y  %H:%M:%S.%f"),
        ("2026-12-31T11:59:59.9", "%m/%d/%Y %I:%M:%S.%f %p"),  # over noon
        ("2026-12-31T12:59:59.9", "%I:%M:%S.%f%p"),
        ("2026-12-31T09:59:59.9", "%Y/%m/%d %-H:%M:%S.%f"),
    ],
)
def test_times_of_day(tmp_path: Path, motion: dict[str, np.ndarray], begin: str, form: str) -> None:
    """A stamp of ISO 8601, or as loggers write it, counts in seconds from the first; a date beside it is no channel."""
    stamps = [(datetime.fromisoformat(begin) + timedelta(seconds=t)).strftime(form) for t in TIMES.tolist()]
    rows = np.column_stack(list(motion.values())[1:]).tolist()
    head = ";".join(["Date"] * form.count(";") + ["Time [hh:mm:ss]", *list(motion)[1:]])
    lines = [";".join([stamp, *map(repr, row)]) for stamp, row in zip(stamps, rows, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join([head, *lines]))
    same(taken(tmp_path / "a.csv"), motion)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.csv", b"t_s;x\n1;2\n3;four\n5;6\n7;8\n9;1\n", "row 2 of its numbers has a cell that is no number.*'four'"),
        ("a.csv", b"t_s;x\n1;2\n3;4\n5;1,234.5\n7;8\n", "row 3 .*such as 1234.5 or 1.2345e3: '1,234.5'"),
        ("a.csv", b"t_s;x\n1;2\n3\n5;6\n7;8\n", "row 2 of its numbers has 1 cells of 2"),
        ("a.csv", b"t_s;x\n1;2\n;4\n5;6\n7;8\n", "'t_s' has 1 values that are not finite"),
        ("a.csv", b"t_s;x\n01:02:03;2\n01:02:61;1\n01:02:05;6\n", "a time of day or a date that there is not"),
        ("a.csv", b"t_s;x\n01:02:03;2\n4;1\n01:02:05;6\n", "row 2 of its numbers has a cell that is no number"),
        ("a.csv", b"hello\n", "no rows of numbers.*; its last line is 'hello'"),
        ("a.csv", b"t_s;x\n30.2.2026 1:02:63;2\n30.2.2026 1:02:04;1\n30.2.2026 1:02:05;6\n", "a time of day or a date"),
        ("a.csv", b"\n", "no rows of numbers"),
        ("a.mat", b"MATLAB 7.3 MAT-file" + bytes(600), "MATLAB"),
        ("a.uff", b"nothing\n", "no time record and no frequency response"),
    ],
)
def test_files_that_hold_nothing_say_so(tmp_path: Path, name: str, content: bytes, words: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=words):
        imported(tmp_path / name)


def test_the_command_tells_what_it_took(tmp_path: Path, motion: dict[str, np.ndarray]) -> None:
    names = "time [s],force [N],cmd [V],current [A],tip [mm]"
    values = np.column_stack([*list(motion.values())[:-1], 1e3 * motion["displacement_m"]])
    np.savetxt(tmp_path / "push.csv", values, "%.12g", ",", header=names, comments="")
    command = ["gap", "import", str(tmp_path / "push.csv"), "--prototype", str(RIG), "--out", str(tmp_path / "rig1")]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    assert "tip [mm] x 0.001" in done.output
    assert "taken as 0 kg in every file" in done.output
    assert (tmp_path / "rig1" / "records" / "push.csv").is_file()
