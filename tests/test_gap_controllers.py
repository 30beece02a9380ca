"""Data sets taken with a structured law, with an added sensor, with several laws: examined, simulated, diagnosed."""

import tomllib
from dataclasses import replace
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from gap_sets import LAG, believed, measured, scenario
from scipy.interpolate import CubicSpline
from scipy.signal import lsim
from typer.testing import CliRunner

from beamdesign import (
    InputError,
    Prototype,
    diagnose,
    read_dataset,
    read_prototype,
    simulate,
    state_space,
    write_prototype,
)
from beamdesign.cli import app
from beamdesign.columns import write_tables
from beamdesign.controllers import Controller, Observer, Proportional, Scheduled, Section, Stage, Structured
from beamdesign.diagnosis import diagnose as diagnosing
from beamdesign.diagnosis import separability
from beamdesign.diagnosis.data.dataset import Dataset, MeasuredGain, TimeRecord
from beamdesign.diagnosis.diagnosis import Diagnosis
from beamdesign.diagnosis.examination.nominal import CHANNELS, commanded_current, controller_fit, nominal_loop
from beamdesign.diagnosis.examination.plausibility import examine
from beamdesign.diagnosis.experiment_menu import menu
from beamdesign.diagnosis.fitting import search as searching
from beamdesign.diagnosis.fitting.evidence import record_evidence
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, Hypothesis
from beamdesign.diagnosis.redesign import designer_terms, loops_of, payload_range, redesign
from beamdesign.prototype import Payload
from beamdesign.report.gap_folder import write_gap_folder
from beamdesign.scenario import Multisine, Scenario, ScenarioRecord
from beamdesign.structure import lumped

SECTION = Section(zero_Hz=45.0, zero_damping_ratio=0.4, pole_Hz=60.0, pole_damping_ratio=0.7)
STRUCTURED = Structured(gain_A_per_V=0.1, pole_Hz=1.75, zero_Hz=26.0, section=(SECTION, SECTION))  # equal poles
POLE, SHARE = 2 * pi * 1.75, 1.75 / 26.0
SENSORS = Observer.of(
    0.1, ("displacement_m", "load_pressure_Pa"), [[-POLE]], [[POLE * (1 - SHARE), 0.0]], [1.0], [SHARE, 1e-9]
)
HEARING = SENSORS.but(b_command=(0.3 * POLE,))
FEW = ("sensor_lag", "transport_delay", "parameter:flow_gain")
PRESSURE = ("current_A", "displacement_m", "load_pressure_Pa")


def taken(rig: Prototype, law: Controller, channels: tuple[str, ...] = PRESSURE) -> Dataset:
    """Three records of a rig with a law; the last is taken with proportional control."""
    plan = scenario(0.6)
    rows = [row.but(controller=law, outer_end_mass_kg=0.0, inner_end_mass_kg=0.0) for row in plan.record[1:4]]
    rows[-1] = rows[-1].but(controller=Proportional(gain_A_per_V=0.01))
    plan = plan.but(record=tuple(rows))
    data = measured(rig, plan, believed().but(controller=law))
    records = simulate(rig, plan).records
    random = np.random.default_rng(0)

    def noise(name: str, count: int) -> np.ndarray:
        """Of the pressure's sensor, which a scenario leaves out."""
        return random.normal(0.0, 3e3 if name == "load_pressure_Pa" else 0.0, count)

    return replace(
        data,
        records=tuple(
            replace(known, measured={name: each.column(name) + noise(name, len(known.times)) for name in channels})
            for known, each in zip(data.records, records, strict=True)
        ),
    )


@pytest.mark.parametrize(
    ("law", "channels"),
    [(STRUCTURED, PRESSURE), (SENSORS, PRESSURE), (LAG, ("displacement_m",))],
    ids=["structured", "observer", "no current"],
)
def test_a_slow_sensor_is_found_whatever_law_was_in_the_loop(
    law: Controller, channels: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    for room in (searching, separability):
        monkeypatch.setattr(room, "singles", lambda prototype: tuple(Hypothesis((name,)) for name in FEW))
    rig = believed().but(effects={"sensor_lag": {"break_Hz": 250.0}})
    found = diagnose(taken(rig, law, channels), 1)
    assert found.verdict == "effect"
    assert found.chosen == ("sensor_lag",)
    assert any("current was not recorded" in words for words in found.warnings) == ("current_A" not in channels)
    assert found.causes[0].parameters["break_Hz"].value == pytest.approx(250.0, rel=0.1)
    assert found.prototype.controller == law
    assert found.gap.after < 0.2 * found.gap.before


def test_a_load_pressure_whose_zero_is_not_that_of_rest_is_named() -> None:
    """As of two absolute gauges at unequal sides; where a law does not hear it the record counts, but not its zero."""
    data = taken(believed(), LAG)
    assert not any(caution.name == "sensor_zero" for caution in examine(data).warnings)
    off = [r.measured | {"load_pressure_Pa": r.measured["load_pressure_Pa"] + 7.3e5} for r in data.records]
    shifted = replace(data, records=tuple(replace(r, measured=m) for r, m in zip(data.records, off, strict=True)))
    named = [caution for caution in examine(shifted).warnings if caution.name == "sensor_zero"]
    assert [caution.record for caution in named] == [record.name for record in data.records]
    assert not any(caution.left_out or caution.limits_confidence for caution in named)
    assert float(named[0].text.split()[3]) == pytest.approx(7.3e5, rel=0.02)
    assert "subtract what its sensor shows there" in named[0].text


def test_figures_that_predict_worse_what_they_have_not_seen_are_not_written(
    monkeypatch: pytest.MonkeyPatch, single_causes: None
) -> None:
    """Friction that no candidate is bends the figures of the fits: the believed ones predict the tip better."""
    for room in (searching, separability):
        monkeypatch.setattr(room, "singles", lambda prototype: tuple(Hypothesis((name,)) for name in FEW[1:]))
    for look in ("channels_in_time", "what_passed", "learn", "second_look", "next_experiment"):
        monkeypatch.setattr(diagnosing, look, lambda *given: None)
    found = diagnose(taken(believed().but(effects={"seal_friction": {"coulomb_N": 30.0}}), STRUCTURED), 1)
    assert (found.verdict, found.chosen) == ("unknown", ())
    assert found.gap.after == found.gap.before < 0.5 * found.gap.tuned
    assert found.gap.closed == 0.0
    assert lumped.figures(found.prototype) == pytest.approx(lumped.figures(believed()), rel=1e-9)


def in_stages() -> Prototype:
    """The rig with a law for light payloads and another for heavy ones."""
    section = SECTION.but(zero_Hz=120.0, pole_Hz=150.0)
    light = Stage(outer_end_mass_kg=(0.0, 4.0), gain_A_per_V=0.05, pole_Hz=1.75, zero_Hz=26.0, section=(section,))
    heavy = light.but(outer_end_mass_kg=(3.0, 6.8), gain_A_per_V=0.03)
    payload = Payload(outer_end_mass_kg=(0.0, 6.8), inner_end_mass_kg=4.4)
    return believed().but(controller=Scheduled(stage=(light, heavy)), payload=payload)


def written(rig: Prototype, folder: Path, masses_kg: tuple[float, ...]) -> Path:
    """A data set of a rig whose payload stays, one record for each, simulated in the stage that is for it."""
    rows = []
    for k, mass in enumerate(masses_kg):
        ((stage, *_),) = rig.stages((mass, mass))
        drive = Multisine(low_Hz=1, high_Hz=200, seed=k, amplitude_V=0.3)
        row = ScenarioRecord(name=f"r{k}", input=(drive,), outer_end_mass_kg=mass, inner_end_mass_kg=4.4)
        plan = scenario(0.7).but(record=(row,))
        write_tables({one.name: (one.columns, one.samples) for one in simulate(stage, plan).records}, folder)
        rows.append({"file": f"r{k}.csv", "outer_end_mass_kg": mass, "inner_end_mass_kg": 4.4})
    write_prototype(rig.but(effects={}), folder / "prototype.toml")
    (folder / "dataset.toml").write_text(tomli_w.dumps({"name": "stages", "record": rows}))
    return folder


def test_each_record_has_the_law_for_its_payload_or_the_one_it_states(tmp_path: Path) -> None:
    rig = in_stages()
    light, heavy = (stage.prototype.controller for stage in rig.stages((0.0, 6.8)))
    data = read_dataset(written(rig, tmp_path, (0.0, 6.8)))
    assert [record.controller for record in data.records] == [light, heavy]
    assert loops_of(data) == [(light, 4.4, (0.0, 4.0)), (heavy, 4.4, (3.0, 6.8))]
    index = tomllib.loads((tmp_path / "dataset.toml").read_text())

    def read(gains: list[dict[str, Any]], **said: Any) -> Dataset:
        rows = [index["record"][0], index["record"][1] | said]
        (tmp_path / "dataset.toml").write_text(tomli_w.dumps({"record": rows, "critical_gain": gains}))
        return read_dataset(tmp_path)

    (gain,) = read([{"outer_end_mass_kg": 6.8, "gain_A_per_V": 0.2}]).gains
    assert heavy is not None
    assert gain.controller == heavy.but(gain_A_per_V=0.2)
    with pytest.raises(InputError) as caught:  # as fit for the light law as for the heavy one
        read([], outer_end_mass_kg=3.5)
    assert [problem.key for problem in caught.value.problems] == ["outer_end_mass_kg"]
    assert read([], outer_end_mass_kg=3.5, controller=heavy.model_dump()).records[1].controller == heavy


@pytest.fixture(scope="module")
def staged(tmp_path_factory: pytest.TempPathFactory) -> tuple[Dataset, Diagnosis]:
    """Records of a slow sensor in two stages, and what is found of them among a few causes."""
    rig = in_stages().but(effects={"sensor_lag": {"break_Hz": 250.0}})
    data = read_dataset(written(rig, tmp_path_factory.mktemp("stages"), (0.0, 0.0, 6.8, 6.8)))
    with pytest.MonkeyPatch.context() as patch:
        for room in (searching, separability):
            patch.setattr(room, "singles", lambda prototype: tuple(Hypothesis((name,)) for name in FEW))
        return data, diagnose(data, 1)


def test_a_slow_sensor_is_found_in_the_records_of_several_stages(staged: tuple[Dataset, Diagnosis]) -> None:
    _, found = staged
    assert found.chosen == ("sensor_lag",)
    assert found.causes[0].parameters["break_Hz"].value == pytest.approx(250.0, rel=0.1)
    assert found.prototype.controller == in_stages().controller
    assert list(found.prototype.effects) == ["sensor_lag"]


def test_no_experiment_takes_a_stage_beyond_its_payloads(staged: tuple[Dataset, Diagnosis]) -> None:
    data, _ = staged
    light, heavy = (stage.prototype.controller for stage in in_stages().stages((0.0, 6.8)))
    rows = [each.scenario.record[0] for each in menu(data)]
    proposed = {(row.controller, row.outer_end_mass_kg) for row in rows}
    assert proposed == {(light, 0.0), (heavy, 6.8), (heavy, 3.4)}  # neither 10.2 kg nor a light law at 3.4 kg


@pytest.mark.usefixtures("no_pictures", "one_start")
def test_every_stage_is_tuned_and_proved_anew(staged: tuple[Dataset, Diagnosis], tmp_path: Path) -> None:
    """With the slow sensor, by the matrices of the rig and by what checks certificates."""
    data, found = staged
    renewed = redesign(found.prototype, payload_range(data))
    loops = designer_terms(data, found.prototype, [stage for _, stage in renewed.proofs])
    assert [loop.outer_end_mass_kg for loop in loops if loop.new] == [(0.0, 3.9), (2.9, 6.8)]
    paths, fields = write_gap_folder(tmp_path, found, data, loops, renewed)
    new = read_prototype(paths["redesigned"])
    assert new.effects == found.prototype.effects
    for stage, promised in zip(new.stages((0.0, 6.8)), fields["redesign"]["guaranteed"], strict=True):
        at = np.geomspace(0.01, promised["bandwidth_Hz"], 50)
        for mass in np.linspace(*stage.outer_end_mass_kg, 5):
            shown = np.abs(state_space(stage.prototype, mass)(2j * pi * at)[0, 0])
            assert shown.max() <= new.goal.compliance_m_per_N * (1 + 1e-6)
        path = paths[f"certificate_stage_{stage.number}"]
        assert CliRunner().invoke(app, ["certify", "--replay", str(path)]).exit_code == 0
    promised = [one["bandwidth_Hz"] for one in fields["redesign"]["guaranteed"]]
    assert [loop.diagnosed.bandwidth_Hz for loop in loops if loop.new] == pytest.approx(promised, rel=1e-3)


@pytest.mark.parametrize("law", [LAG, STRUCTURED, SENSORS, HEARING], ids=["lag", "structured", "sensors", "command"])
def test_the_controllers_equation_is_that_of_scipy(law: Controller) -> None:
    """lsim at 20 times the sampling rate, on splines through the recorded channels; from rest and cut out of it."""
    times = np.arange(1001) * 1e-3
    signals = {
        "command_V": 0.2 * np.sin(2 * pi * 7 * times) ** 3,
        "displacement_m": 1e-5 * np.sin(2 * pi * 11 * times) ** 2,
        "load_pressure_Pa": 3e5 * np.sin(2 * pi * 5 * times) ** 2,
    }
    fine = np.linspace(0, 1, 20001)
    volts, moved, pressure = (CubicSpline(times, signal)(fine) for signal in signals.values())
    model = law.control_model()
    a, b, c, d = (np.asarray(part) for part in (model.A, model.B, model.C, model.D))
    heard = np.column_stack([*(volts - 1180 * moved, -pressure)[: model.ninputs], volts])
    b = np.column_stack([b, law.state_space()[4]])
    _, current, _ = lsim((a, b, c, np.column_stack([d, [[0.0]]])), heard, fine)
    inputs = np.column_stack([0 * times, signals["command_V"]])
    record = TimeRecord("x", times, inputs, {**signals, "current_A": current[::20]}, 0.0, 0.0, law)
    cut = replace(
        record,
        times=times[300:],
        inputs=inputs[300:],
        measured={name: values[300:] for name, values in record.measured.items()},
    )
    for one in (record, cut):
        size = np.abs(one.measured["current_A"]).max()
        assert commanded_current(one, law, 1180.0) == pytest.approx(one.measured["current_A"], abs=1e-3 * size)


def test_an_equation_is_not_held_against_what_was_not_recorded() -> None:
    data = taken(believed(), SENSORS, PRESSURE[:2])
    assert controller_fit(data.records[0], 1180.0) is None
    assert controller_fit(data.records[-1], 1180.0) is not None


@pytest.mark.parametrize("law", [STRUCTURED, SENSORS, HEARING], ids=["structured", "sensors", "command"])
def test_the_believed_loop_is_that_of_python_control(law: Controller) -> None:
    rig = believed().but(controller=law, payload=believed().payload.but(inner_end_mass_kg=1.5))
    closed = state_space(rig, 2.0)
    at = np.geomspace(0.1, 400, 30)
    found = nominal_loop(rig, MeasuredGain(law, 2.0, 1.5, 0.03))
    assert found.stable == bool(np.all(closed.poles().real < 0))
    responses, expected = found.responses(at), np.moveaxis(closed(2j * pi * at), 2, 0)
    for name in {"current_A", "displacement_m", *law.added}:
        k, row = CHANNELS.index(name), closed.output_labels.index(name)
        np.testing.assert_allclose(responses[:, k], expected[:, row], rtol=1e-6)


@pytest.mark.parametrize("law", [STRUCTURED, SENSORS, HEARING], ids=["structured", "sensors", "command"])
def test_every_record_is_simulated_with_its_own_law(law: Controller) -> None:
    """Without noise a record is that of its model, also where the model is made to follow it."""
    from beamdesign.diagnosis.fitting.evidence import with_output_injection

    plan = scenario(0.4)
    rows = tuple(row.but(controller=law) for row in plan.record[1:2]) + plan.record[4:5]
    quiet = Scenario(name="quiet", duration_s=0.4, record=rows)
    data = measured(believed(), quiet)
    placement = NOTHING.placement(data.prototype)
    z = np.zeros(len(placement.unknowns))
    for piece in record_evidence(data):
        for one in (piece, with_output_injection(piece)):
            made = one.predicted(placement, z)
            assert made is not None
            error = np.abs(made - one.measured).max(axis=0) / np.abs(one.measured).max(axis=0)
            assert np.all(error < 2e-3)  # of the steps of the integration, which a fit has longer
