"""Robust tuning: what it holds limits against, what it proves, and what becomes of rigs drawn at random."""

import json
from math import log, pi
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
from delivered import delivered, drawn
from typer.testing import CliRunner

from beamdesign.checker import check
from beamdesign.cli import app
from beamdesign.control_models import state_space
from beamdesign.controllers import Lag
from beamdesign.plant.members import paper_model
from beamdesign.proofs.certifying import certify
from beamdesign.prototype import Prototype, Tolerance, read_prototype, write_prototype
from beamdesign.records import InputError
from beamdesign.synthesis.design_run import claims_of, draw_rigs, least_share, worst_of
from beamdesign.synthesis.loop_limits import Proved
from beamdesign.synthesis.loop_samples import Samples, samples, worst_samples
from beamdesign.synthesis.loop_slacks import slacks
from beamdesign.synthesis.rig_spread import RigSpread, rig_spread
from beamdesign.synthesis.tuning import LawOptions, Tuning, tune, tune_law

LAW = Lag(gain_A_per_V=0.12, pole_Hz=1.2, zero_Hz=30.0)
FORM, _logarithms = LAW.form()
VARIABLES = np.append(_logarithms, 0.5)
"""The same lag, with mass inside."""

SHIPPED = {"structured_robust_no_payload": 16.3, "structured_robust": 11.6}
"""Designs with the bandwidth, Hz, that is proved of all of their worst rigs."""

STUDIES = Path(__file__).parent.parent / "studies"
MASSES_KG = (0.0, 1.0)
SIGMAS = 1.5


@pytest.fixture(scope="module")
def rig() -> Prototype:
    """The published rig with tolerances of some per cent."""
    record = read_prototype(STUDIES / "prototypes/paper_remedy.toml")
    tolerance = Tolerance(
        stiffness=0.02,
        effective_mass=0.02,
        beam_damping_ratio=0.15,
        oil_stiffness=0.1,
        flow_gain=0.05,
        valve_natural_frequency=0.05,
    )
    return record.but(tolerance=tolerance, payload=record.payload.but(inner_end_mass_kg=0.5), controller=LAW)


def sampled(spread: RigSpread) -> Samples:
    """Samples of the rigs of a spread at few points."""
    frequency = np.geomspace(2.0, 300.0, 40)

    def of(members: Any) -> Samples:
        return samples(members[0].rig.polynomials(), frequency, MASSES_KG)

    return worst_samples(spread, spread.members(np.zeros(len(spread.deviations))), of)


def true_slacks(rig: Prototype, points: Samples) -> tuple[np.ndarray, ...]:
    """Slacks of sensitivity and compliance of a rig at the points, by python-control."""
    s, law = 2j * pi * points.frequency_Hz, LAW.control_model()(2j * pi * points.frequency_Hz)
    found = []
    for row, mass in enumerate(MASSES_KG):
        on = points.row == row
        a, b, c = paper_model(rig).matrices(mass, rig.payload.inner_end_mass_kg)
        response = control.ss(a, b, c, 0)(s[on])
        closed = np.log(np.abs(1 + response[1, 1] * law[on]))
        goal = rig.goal
        found.append((closed + log(goal.peak_sensitivity), closed - np.log(np.abs(response[0, 0]))))
        found[-1] = (found[-1][0], found[-1][1] + log(goal.compliance_m_per_N))
    return tuple(np.concatenate(parts) for parts in zip(*found, strict=True))


@pytest.mark.parametrize("shape", ["ball", "box"])
def test_no_rig_within_the_sigmas_is_worse_than_the_worst_that_was_found(rig: Prototype, shape: Any) -> None:
    """Rigs on the edge and inside, their responses by python-control; and the worst ones are as bad as predicted."""
    spread = rig_spread(rig, MASSES_KG[1], 1.0, shape)
    points = sampled(spread)
    found = slacks(points, rig.goal, FORM, VARIABLES)
    nominal = true_slacks(rig, points)
    for z in spread.drawn(40, seed=3, inside=True):
        for worst, true in zip((found.sensitivity, found.compliance), true_slacks(spread.rig(z), points), strict=True):
            assert (true > worst - 0.01).all()
    limits, compliance, _ = points.deviations(FORM, VARIABLES)
    for z, predicted, which in ((limits, found.sensitivity, 0), (compliance, found.compliance, 1)):
        at = int(predicted.argmin())
        true = true_slacks(spread.rig(z[:, at]), points)[which][at]
        assert predicted[at] < nominal[which].min()
        assert abs(true - predicted[at]) < 0.1 * (nominal[which][at] - predicted[at])


def test_without_deviations_the_slacks_are_those_of_the_nominal_rig(rig: Prototype) -> None:
    points = sampled(rig_spread(rig, MASSES_KG[1], 1e-4))
    nominal = samples(paper_model(rig).polynomials(), np.geomspace(2.0, 300.0, 40), MASSES_KG)
    found, expected = (slacks(one, rig.goal, FORM, VARIABLES) for one in (points, nominal))
    for k, name in enumerate(("sensitivity", "compliance")):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=2e-4)
        np.testing.assert_allclose(found.slopes[k], expected.slopes[k], atol=2e-3)


@pytest.fixture(scope="module")
def nominal(rig: Prototype) -> Tuning:
    return tune(rig, MASSES_KG)


@pytest.fixture(scope="module")
def robust(rig: Prototype, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What the command writes of a robust lag, and the folder it writes to."""
    folder = tmp_path_factory.mktemp("robust")
    write_prototype(rig, folder / "rig.toml")
    command = ["tune", str(folder / "rig.toml"), "--outer-end-mass", "0:1", "--robust", str(SIGMAS)]
    done = CliRunner().invoke(app, [*command, "--out", str(folder / "out"), "--json", str(folder / "found.json")])
    assert done.exit_code == 0, done.output
    return json.loads((folder / "found.json").read_text()) | {"folder": folder / "out", "output": done.output}


def claimed(robust: dict[str, Any]) -> tuple[RigSpread, Proved]:
    """The tuned prototype's rigs, and what is claimed of it."""
    built = read_prototype(robust["folder"] / "prototype.toml")
    guaranteed = robust["guaranteed"]
    assert built.controller is not None
    proved = Proved(
        built.controller,
        built.payload.inner_end_mass_kg,
        guaranteed["bandwidth_Hz"],
        guaranteed["peak_sensitivity"],
        np.zeros(0),
    )
    return rig_spread(built.but(guarantee=None), MASSES_KG[1], SIGMAS), proved


def test_every_rig_that_is_named_is_proved_and_its_certificate_is_proved_again(robust: dict[str, Any]) -> None:
    spread, proved = claimed(robust)
    assert len(robust["robust"]["rigs"]) >= 2
    for k, factors in enumerate(robust["robust"]["rigs"], start=1):
        z = np.array([(factors.get(name, 1.0) - 1) / size for name, size in spread.deviations.items()])
        assert SIGMAS * 0.99 < np.linalg.norm(z) < SIGMAS * 1.01
        found = certify(spread.rig(z), *MASSES_KG, claims_of(spread.prototype, proved))
        assert found.holds, found.reason
        text = (robust["folder"] / f"certificate.rig-{k}.toml").read_text()
        assert check(text).valid


def test_all_rigs_drawn_from_within_the_sigmas_keep_the_claim(robust: dict[str, Any]) -> None:
    draws = draw_rigs(*claimed(robust), MASSES_KG, 12, seed=11, inside=True)
    assert (draws.kept, draws.bandwidth_kept, draws.missed) == (12, 12, ())


def test_a_nominal_design_fails_on_its_worst_rigs(rig: Prototype, nominal: Tuning, robust: dict[str, Any]) -> None:
    """It claims more than the robust one, and of rigs within the tolerances hardly one keeps it."""
    assert nominal.best is not None
    assert nominal.best.bandwidth_Hz > 1.05 * robust["guaranteed"]["bandwidth_Hz"]
    spread = rig_spread(nominal.prototype, MASSES_KG[1], SIGMAS)
    refuted = 0
    for factors in robust["robust"]["rigs"]:
        z = np.array([(factors.get(name, 1.0) - 1) / size for name, size in spread.deviations.items()])
        found = certify(spread.rig(z), *MASSES_KG, claims_of(nominal.prototype, nominal.best))
        refuted += not found.holds
    assert refuted == len(robust["robust"]["rigs"])
    draws = draw_rigs(spread, nominal.best, MASSES_KG, 12, inside=True)
    assert draws.kept < 6
    assert len(draws.missed) == 12 - draws.kept


def test_certify_finds_the_worst_rigs_anew_and_decides_each(robust: dict[str, Any], tmp_path: Path) -> None:
    """What was tuned for holds; a little more is refuted, of a rig and not of the nominal one."""
    bandwidth = robust["guaranteed"]["bandwidth_Hz"]
    for share, status in ((1.0, 0), (1.005, 1)):
        claim = ["--bandwidth-Hz", str(share * bandwidth), "--out", str(tmp_path / "proof.toml")]
        command = ["certify", str(robust["folder"] / "prototype.toml"), "--robust", str(SIGMAS), *claim]
        done = CliRunner().invoke(app, [*command, "--json", str(tmp_path / "found.json")])
        assert done.exit_code == status, done.output
        found = json.loads((tmp_path / "found.json").read_text())
        assert found["holds"] is True
        assert found["robust"]["holds"] is (status == 0)
        assert len(list(tmp_path.glob("proof.rig-*.toml"))) == len(found["robust"]["rigs"])


def test_no_sigmas_are_the_nominal_tuning(rig: Prototype, nominal: Tuning, tmp_path: Path) -> None:
    write_prototype(rig, tmp_path / "rig.toml")
    command = ["tune", str(tmp_path / "rig.toml"), "--outer-end-mass", "0:1", "--robust", "0"]
    assert CliRunner().invoke(app, [*command, "--json", str(tmp_path / "found.json")]).exit_code == 0
    found = json.loads((tmp_path / "found.json").read_text())
    assert nominal.best is not None
    assert found["guaranteed"]["bandwidth_Hz"] == nominal.best.bandwidth_Hz
    assert found["controller"] == nominal.best.controller.model_dump()
    assert "robust" not in found


def test_what_is_sampled_is_not_called_proved(robust: dict[str, Any]) -> None:
    text = " ".join(robust["output"].split())
    assert f"proved: these {len(robust['robust']['rigs'])} rigs and the nominal one" in text
    assert "sampled: the worst rigs 1.5 standard deviations off in all were sought on samples" in text


def test_a_share_of_rigs_is_bounded_as_in_closed_form() -> None:
    """Clopper and Pearson: with all kept, the bound is the n-th root of 5 %; with none, it is zero."""
    assert least_share(32, 32) == pytest.approx(0.05 ** (1 / 32), rel=1e-9)
    assert least_share(0, 32) == 0.0


@pytest.mark.parametrize("name", SHIPPED)
def test_the_shipped_design_delivers_what_is_proved_on_nonlinear_rigs(name: str) -> None:
    """Rigs drawn from its tolerances, with saturation, orifices, second mode and noise, one with a delay as well."""
    rig = read_prototype(STUDIES / "prototypes" / f"{name}.toml")
    masses = rig.payload.outer_end_mass_kg
    assert masses is not None
    spread = rig_spread(rig, masses[1], 2.0)
    found = [certify(one, *masses).guaranteed for one in map(spread.rig, worst_of(spread, masses))]
    claim = min(0.0 if one is None else one.bandwidth_Hz for one in found)
    assert claim > SHIPPED[name]
    nonlinear = {"current_saturation": {"limit_A": 0.015}, "pressure_dependent_flow": {}}
    assert rig.sensor.noise_V > 0
    for k, one in enumerate(drawn(rig, spread.deviations, 4, seed=23)):
        late = {"transport_delay": {"delay_s": 0.0003}} if k == 3 else {}
        built = one.but(effects=nonlinear | late | one.effects)
        reached = delivered(built, masses[k % 2], 40.0, seed=k)
        assert reached.stable, reached.reason
        assert reached.bandwidth_Hz > claim


def test_tolerances_that_are_missing_or_reach_zero_are_refused(rig: Prototype) -> None:
    with pytest.raises(InputError, match="no figure has a tolerance"):
        rig_spread(rig.but(tolerance=Tolerance()), MASSES_KG[1], 1.0)
    with pytest.raises(InputError, match=r"10 standard deviations of 0\.15 reach zero"):
        rig_spread(rig, MASSES_KG[1], 10.0)
    with pytest.raises(ValueError, match="sigmas must be positive"):
        rig_spread(rig, MASSES_KG[1], 0.0)
    with pytest.raises(ValueError, match="no tuning of kind"):
        tune(rig, MASSES_KG, "integral")


def test_a_stage_is_tuned_for_its_worst_rigs_and_is_stable_with_all_payloads_in_each(rig: Prototype) -> None:
    """By python-control's eigenvalues, of the rigs that are named and of all payloads."""
    spread, whole_kg = rig_spread(rig.but(controller=None), 4.0, SIGMAS), (0.0, 4.0)
    found = tune_law(rig, MASSES_KG, LawOptions(spread=spread, stable_kg=whole_kg), lambda share, text: None)
    assert found.best is not None
    assert found.worst
    built = rig_spread(found.prototype, 4.0, SIGMAS)
    for member in (found.prototype, *map(built.rig, found.worst)):
        assert all(state_space(member, mass).poles().real.max() < 0 for mass in np.linspace(*whole_kg, 9))
        reached = certify(member, *MASSES_KG).guaranteed
        assert reached is not None
        assert reached.bandwidth_Hz >= found.best.bandwidth_Hz * (1 - 1e-6)
