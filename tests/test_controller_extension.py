"""A kind of controller of this file's own goes through the commands without an edit elsewhere.

Tuning has no form for it.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from typer.testing import CliRunner

from beamdesign import (
    InputError,
    Prototype,
    certify,
    check,
    read_prototype,
    read_scenario,
    simulate,
    state_space,
    tune,
    write_prototype,
)
from beamdesign.build.analogue import circuit_of
from beamdesign.build.specification import digital_controller
from beamdesign.cli import app
from beamdesign.controllers import KINDS, Break, Cascade, Lag, Section, register
from beamdesign.controllers.cascade import Factor
from beamdesign.docs import keys
from beamdesign.loop import loop
from beamdesign.records import to_toml
from beamdesign.scenario import Sampled, ScenarioRecord
from beamdesign.synthesis.tuning import tunable

SHIPPED = Path(__file__).parent.parent / "studies" / "prototypes" / "paper_remedy.toml"
SCENARIO = SHIPPED.parent.parent / "scenarios" / "kick.toml"
MASSES_KG = (0.0, 6.8)


class DoubleLag(Cascade):
    """C(s) = (1 + s / zero) / (1 + s / pole) (1 + s / far_zero) / (1 + s / far_pole)."""

    kind: Literal["double_lag"] = "double_lag"
    pole_Hz: float
    zero_Hz: float
    far_pole_Hz: float
    far_zero_Hz: float

    @property
    def factors(self) -> tuple[Factor, ...]:
        return Break(self.pole_Hz, self.zero_Hz), Break(self.far_pole_Hz, self.far_zero_Hz)

    @classmethod
    def seeds(cls) -> tuple["DoubleLag", ...]:
        return (cls(gain_A_per_V=3e-3, pole_Hz=1.0, zero_Hz=30.0, far_pole_Hz=20.0, far_zero_Hz=25.0),)


@pytest.fixture(autouse=True)
def known() -> Iterator[None]:
    """The kind is there within these tests alone."""
    register(DoubleLag)
    keys.cache_clear()
    yield
    del KINDS["double_lag"]
    keys.cache_clear()


@pytest.fixture
def rig() -> Prototype:
    shipped = read_prototype(SHIPPED)
    law = shipped.controller
    assert isinstance(law, Lag)
    double = DoubleLag(
        gain_A_per_V=law.gain_A_per_V / 4,
        pole_Hz=law.pole_Hz,
        zero_Hz=law.zero_Hz,
        far_pole_Hz=2000.0,
        far_zero_Hz=8000.0,
    )
    return shipped.but(controller=double, guarantee=None)


@pytest.fixture
def path(rig: Prototype, tmp_path: Path) -> Path:
    write_prototype(rig, tmp_path / "prototype.toml")
    return tmp_path / "prototype.toml"


def test_its_file_is_read_back_equal_and_its_keys_are_known(rig: Prototype, path: Path) -> None:
    assert read_prototype(path) == rig
    assert 'kind = "double_lag"' in to_toml(rig)
    assert "controller.far_pole_Hz" in {key.path for key in keys()}


@pytest.mark.parametrize(
    ("change", "key", "words"),
    [
        (("far_pole_Hz", "far_pole_kHz"), "controller.far_pole_kHz", "far_pole_Hz"),
        (('"double_lag"', '"double_leg"'), "controller", "did you mean 'double_lag'"),
        (("far_pole_Hz = 2000.0", ""), "controller.far_pole_Hz", "missing"),
    ],
)
def test_messages_name_its_keys(path: Path, change: tuple[str, str], key: str, words: str) -> None:
    path.write_text(path.read_text().replace(*change))
    with pytest.raises(InputError) as caught:
        read_prototype(path)
    assert words in dict(caught.value.problems)[key]


def test_a_name_is_given_once() -> None:
    with pytest.raises(ValueError, match="double_lag"):
        register(DoubleLag)


def test_all_its_forms_are_one_law(rig: Prototype) -> None:
    law = rig.controller
    assert law is not None
    frequency = np.geomspace(0.1, 5e3, 40)
    s = 2j * np.pi * frequency
    model, exact = law.control_model(), law.transfer_function()
    values = [np.polyval([float(c) for c in reversed(p.coeffs())], s) for p in (exact.numerator, exact.denominator)]
    expected = law.gain_A_per_V * law.sensor_responses(frequency)["displacement_m"]
    np.testing.assert_allclose(values[0] / values[1], expected, rtol=1e-9)
    np.testing.assert_allclose(np.squeeze(model(s)), expected, rtol=1e-9)


def test_its_loop_is_certified_and_the_certificate_checks(rig: Prototype, tmp_path: Path) -> None:
    found = certify(rig, *MASSES_KG)
    assert found.stable
    assert found.guaranteed is not None
    (tmp_path / "certificate.toml").write_text(found.text)
    assert check(tmp_path / "certificate.toml").valid
    assert loop(rig).at(0.0).stable


def test_the_assembled_rig_moves_as_the_linear_loop(rig: Prototype) -> None:
    from beamdesign.plant.assembly import assemble, parameters_of, structure_of
    from beamdesign.plant.equilibrium import equilibrium, linearise

    assembly, p = assemble(structure_of(rig)), np.array(list(parameters_of(rig, 3.4, 0.0).values()))
    assert len(p) == len(assembly.parameters)
    still = equilibrium(assembly, np.zeros(3), p)
    poles = np.linalg.eigvals(linearise(assembly, still, np.zeros(3), p).a)
    bare = rig.but(payload=rig.payload.but(inner_end_mass_kg=0.0))
    for pole in state_space(bare, 3.4).poles():
        assert np.abs(poles - pole).min() < 1e-6 * abs(pole) + 1e-6


@pytest.mark.parametrize(
    "command",
    [
        ["certify", "--outer-end-mass", "0:6.8"],
        ["certify-box"],
        ["simulate", "--scenario", str(SCENARIO), "--no-plots"],
        ["code", "--rate-Hz", "50000"],
    ],
    ids=lambda command: command[0],
)
def test_commands_take_it(path: Path, tmp_path: Path, command: list[str]) -> None:
    out = ["--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, [command[0], str(path), *command[1:], *out, "--json", str(tmp_path / "told.json")])
    assert done.exception is None or isinstance(done.exception, SystemExit), done.output
    assert done.exit_code == 0, done.output
    assert json.loads((tmp_path / "told.json").read_text())


def test_it_is_specified_as_a_circuit_and_as_a_difference_equation(rig: Prototype) -> None:
    """Two lags in series: two stages and two sections, and the loop with either is proved."""
    circuit = circuit_of(rig.controller, "E96", "E12")
    assert [stage.kind for stage in circuit.stages] == ["lag", "lag"]
    assert certify(rig.but(controller=circuit.law), *MASSES_KG).stable
    found = digital_controller(rig, MASSES_KG, MASSES_KG, 50000.0)
    assert [section.order for section in found.equation.asked.sections] == [1, 1]
    assert found.one_period_late is not None
    assert found.one_period_late.stable


def test_its_sampled_loop_is_simulated(rig: Prototype) -> None:
    plan = read_scenario(SCENARIO).but(sampled=Sampled(period_s=5e-5), sample_s=5e-5, duration_s=0.1)
    sampled, continuous = (simulate(rig, each).records[0] for each in (plan, plan.but(sampled=None)))
    moved = continuous.column("displacement_m")
    assert np.abs(sampled.column("displacement_m") - moved).max() < 0.01 * np.abs(moved).max()


class Notched(Cascade):
    """A lag and a notch, whose zeros and poles share a field."""

    kind: Literal["notched"] = "notched"
    pole_Hz: float
    zero_Hz: float
    notch_Hz: float
    depth: float
    width: float

    @property
    def factors(self) -> tuple[Factor, ...]:
        ends = {"zero_Hz": self.notch_Hz, "pole_Hz": self.notch_Hz}
        notch = Section(**ends, zero_damping_ratio=self.depth, pole_damping_ratio=self.width)
        return Break(self.pole_Hz, self.zero_Hz), notch

    @classmethod
    def seeds(cls) -> tuple["Notched", ...]:
        return (cls(gain_A_per_V=3e-3, pole_Hz=1.0, zero_Hz=30.0, notch_Hz=100.0, depth=0.3, width=0.7),)


class ZeroFirst(Cascade):
    """A lag whose fields stand in another order than the figures of its factor."""

    kind: Literal["zero_first"] = "zero_first"
    zero_Hz: float
    pole_Hz: float

    @property
    def factors(self) -> tuple[Factor, ...]:
        return (Break(self.pole_Hz, self.zero_Hz),)

    @classmethod
    def seeds(cls) -> tuple["ZeroFirst", ...]:
        return (cls(gain_A_per_V=3e-3, pole_Hz=1.0, zero_Hz=30.0),)


@pytest.mark.parametrize("kind", [Notched, ZeroFirst])
def test_a_cascade_of_other_fields_than_its_figures_is_not_tuned_as_another_law(
    kind: type[Notched | ZeroFirst], rig: Prototype, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = str(kind.model_fields["kind"].default)
    monkeypatch.setitem(KINDS, name, kind)
    (seed,) = kind.seeds()
    assert seed.form() is None
    assert name not in tunable()
    with pytest.raises(InputError, match="has no form that is tuned"):
        tune(rig.but(controller=seed), MASSES_KG, kind=name, sigmas=0.0)


def test_a_scenario_keeps_its_figures(rig: Prototype) -> None:
    row = ScenarioRecord(name="push", controller=rig.controller)
    assert ScenarioRecord.model_validate(row.model_dump()) == row


@pytest.mark.usefixtures("one_start")
def test_it_is_tuned_and_does_no_worse_than_the_lag_that_it_holds(path: Path, tmp_path: Path) -> None:
    """With its far breaks together it is a lag, which reaches 5.0 Hz on this rig."""
    asked = ["--controller", "double_lag", "--outer-end-mass", "0:6.8", "--nominal", "--out", str(tmp_path / "t")]
    done = CliRunner().invoke(app, ["tune", str(path), *asked, "--json", str(tmp_path / "tuned.json")])
    assert done.exit_code == 0, done.output
    told = json.loads((tmp_path / "tuned.json").read_text())
    assert told["controller"]["kind"] == "double_lag"
    assert told["guaranteed"]["bandwidth_Hz"] > 5.0
    built = read_prototype(tmp_path / "t" / "prototype.toml")
    found = certify(built, *MASSES_KG)
    assert found.guaranteed is not None
    assert found.guaranteed.bandwidth_Hz == pytest.approx(told["guaranteed"]["bandwidth_Hz"], rel=1e-6)
