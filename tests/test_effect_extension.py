"""An effect of this file's own goes the whole way: simulation, proof, check, box, explanation and diagnosis."""

import json
import runpy
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flint import fmpq
from short_scenario import SCENARIO
from typer.testing import CliRunner

from beamdesign import InputError, Prototype, certify, certify_box, check, read_prototype, write_prototype
from beamdesign.cli import app
from beamdesign.code_digest import code_digest
from beamdesign.diagnosis.fitting.hypothesis import cause, singles
from beamdesign.docs import effects
from beamdesign.loop import loop
from beamdesign.plant.effects import Effect, Elements, Linear, Parameter, Site, library, register
from beamdesign.plant.members import family
from beamdesign.prototype import Payload
from beamdesign.structure.lumped import figures

SHIPPED = Path(__file__).parents[1] / "studies/prototypes/tame_lag.toml"
NAME = "inner_absorber"
MASS_KG, STIFFNESS, DAMPING = 0.2, 8e4, 12.0


def _pull(signal: Any, site: Site) -> Any:
    own, state = site.parameter, site.state
    apart, opening = state["absorber_m"] - site.port["inner_m"], state["absorber_m_per_s"] - site.port["inner_m_per_s"]
    force = own["stiffness_N_per_m"] * apart + own["damping_N_s_per_m"] * opening
    site.rate["absorber_m"] = state["absorber_m_per_s"]
    site.rate["absorber_m_per_s"] = -force / own["mass_kg"]
    return signal + force


def _elements(own: Mapping[str, fmpq], figure: Mapping[str, fmpq]) -> Elements:
    spring = own["stiffness_N_per_m"], own["damping_N_s_per_m"]
    one, none = fmpq(1), fmpq(0)
    return Elements(
        (({"absorber": one, "inner": -one}, spring), ({"absorber": one}, (none, none, own["mass_kg"]))),
    )


ABSORBER = Effect(
    name=NAME,
    subsystem="structure",
    laws={"inner_force_N": _pull},
    parameters=(
        Parameter("mass_kg", MASS_KG, 0.01, 2.0, 0.5, "of the absorber"),
        Parameter("stiffness_N_per_m", STIFFNESS, 1e3, 1e7, 0.5, "of its spring"),
        Parameter("damping_N_s_per_m", DAMPING, 0.0, 1e3, 5.0, "of its dashpot"),
    ),
    states=("absorber_m", "absorber_m_per_s"),
    source="J. P. Den Hartog, Mechanical Vibrations, 4th ed. (1956), section 3.2",
    linear=Linear("as it is", elements=_elements),
)


@pytest.fixture(autouse=True)
def known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The effect is there within these tests alone."""
    monkeypatch.chdir(tmp_path)
    register(ABSORBER)
    effects.cache_clear()
    yield
    del library()[NAME]
    effects.cache_clear()


@pytest.fixture
def rig() -> Prototype:
    """A rig whose inner beam carries an absorber, over a narrow payload."""
    shipped = read_prototype(SHIPPED)
    payload = Payload(inner_end_mass_kg=shipped.payload.inner_end_mass_kg, outer_end_mass_kg=(2.0, 2.2))
    return shipped.but(effects={NAME: {}}, guarantee=None, payload=payload)


def call(line: str) -> dict[str, Any]:
    """The JSON of a command that ends well."""
    done = CliRunner().invoke(app, [*line.split(), "--json", "told.json"])
    assert done.exit_code == 0, done.output or repr(done.exception)
    told: dict[str, Any] = json.loads(Path("told.json").read_text())
    return told


def test_a_name_is_given_once() -> None:
    with pytest.raises(ValueError, match=NAME):
        register(ABSORBER)


def test_its_linear_member_is_den_hartogs(rig: Prototype) -> None:
    """Without current the inner beam's impedance is K + b s + M s^2 + m s^2 (k + c s) / (k + c s + m s^2)."""
    own, s = figures(rig), 2j * np.pi * np.array([3.0, 40.0, 100.0, 250.0])
    spring = STIFFNESS + DAMPING * s
    heavy = own["inner_mass"] + rig.payload.inner_end_mass_kg
    inner = own["inner_stiffness"] + own["inner_damping"] * s + heavy * s**2
    inner += MASS_KG * s**2 * spring / (spring + MASS_KG * s**2)
    outer = own["outer_stiffness"] + own["outer_damping"] * s + (own["outer_mass"] + 2.0) * s**2
    oil = 1 / (1 / own["oil_stiffness"] + own["leakage"] / (own["piston_area"] ** 2 * s))
    expected = 1 / (outer + 1 / (1 / oil + 1 / inner))
    passive = rig.but(controller=rig.controller.but(gain_A_per_V=1e-9)) if rig.controller else rig
    np.testing.assert_allclose(loop(passive).at(2.0).compliance_response(s.imag / (2 * np.pi)), expected, rtol=1e-6)


def test_its_certificate_is_refused_with_other_elements(rig: Prototype) -> None:
    text = certify(rig, 2.0, 2.2).text
    assert check(text).valid
    linear = ABSORBER.linear
    assert linear is not None
    stiffer = replace(linear, elements=lambda own, figure: _elements({**own, "mass_kg": 2 * own["mass_kg"]}, figure))
    library()[NAME] = replace(ABSORBER, linear=stiffer)
    wrong = check(certify(rig, 2.0, 2.2).text)
    assert not wrong.valid
    assert any("polynomials" in reason for reason in wrong.failed)


@pytest.mark.parametrize("prove", [certify, certify_box], ids=lambda one: one.__name__)
def test_nothing_is_proved_of_one_without_elements(rig: Prototype, prove: Callable[..., Any]) -> None:
    """It was certified as stable, in a certificate that its check refuses."""
    assert ABSORBER.linear is not None
    library()[NAME] = replace(ABSORBER, linear=replace(ABSORBER.linear, elements=None))
    with pytest.raises(InputError) as refused:
        prove(rig, (2.0, 2.2))
    assert [problem.key for problem in refused.value.problems] == [f"effects.{NAME}"]
    assert len(family(rig).members) == 1  # which simulation and diagnosis take


def test_elements_that_are_no_rationals_are_refused_as_that(rig: Prototype) -> None:
    """A float among them was told as elements that are not affine."""
    assert ABSORBER.linear is not None
    floats = replace(ABSORBER.linear, elements=lambda own, figure: _elements({**own, "mass_kg": 0.2 * fmpq(1)}, figure))
    library()[NAME] = replace(ABSORBER, linear=floats)
    with pytest.raises(InputError, match="float"):
        certify(rig, 2.0, 2.2)


def test_kept_results_rest_on_the_file_that_registers_it() -> None:
    """Results of sweeps and fits of another law were taken for those of this one."""
    shipped = code_digest(place := "beamdesign.sweep.answers:certify")
    digests = {shipped}
    for factor in (1, 2):
        lines = (
            "from beamdesign.plant.effects import Effect, register",
            f"laws = {{'inner_force_N': lambda signal, site: {factor} * signal}}",
            "register(Effect('own', 'structure', laws, (), 'none'))",
        )
        Path(f"own_{factor}.py").write_text("\n".join(lines))
        runpy.run_path(f"own_{factor}.py")
        digests.add(code_digest(place))
        del library()["own"]
    assert len(digests) == 3
    assert code_digest(place) == shipped


@pytest.mark.usefixtures("few_climbs")
def test_commands_take_it(rig: Prototype) -> None:
    write_prototype(rig, Path("p.toml"))
    Path("s.toml").write_text(SCENARIO)
    assert call("certify p.toml --out c.toml")["stable"]
    assert call("certify p.toml --replay c.toml")["valid"]
    assert call("certify-box p.toml --sigmas 0.01 --only flow_gain --out b.toml")["stable"]
    assert call("certify p.toml --replay b.toml")["valid"]
    assert call("simulate p.toml --scenario s.toml --no-plots --out out")["records"]
    (told,) = call(f"explain {NAME}")["effects"]
    assert told["name"] == NAME


def test_it_is_among_what_a_diagnosis_tries(rig: Prototype) -> None:
    bare = rig.but(effects={})
    assert cause(NAME) in {known for hypothesis in singles(bare) for known in hypothesis.causes}
    assert len(family(rig).members) == 1
