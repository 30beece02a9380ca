"""One plane of an arm, its payload off the axis: simulated, and diagnosed from records."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from gap_sets import TOLERANCE, measured, scenario
from lowest_edge import limit_cycles
from plane_at_payload import at_tip

from beamdesign import (
    InputError,
    Prototype,
    certify,
    check,
    critical_gain,
    diagnose,
    read_dataset,
    read_prototype,
    simulate,
)
from beamdesign.controllers import Proportional
from beamdesign.diagnosis import separability
from beamdesign.diagnosis.data.dataset import Dataset, MeasuredGain
from beamdesign.diagnosis.diagnosis import updated_prototype
from beamdesign.diagnosis.examination.nominal import nominal_loop
from beamdesign.diagnosis.examination.plausibility import check_gains, examine
from beamdesign.diagnosis.fitting import search as searching
from beamdesign.diagnosis.fitting.evidence import record_evidence
from beamdesign.diagnosis.fitting.fit import Fit, Share
from beamdesign.diagnosis.fitting.fit_cache import Task
from beamdesign.diagnosis.fitting.fitters import Fitters
from beamdesign.diagnosis.fitting.gain_evidence import GainEvidence
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, Hypothesis, Placement, singles
from beamdesign.diagnosis.predict import read_inputs
from beamdesign.diagnosis.redesign import redesign
from beamdesign.plant.assembly import assemble, parameters_of, structure_of
from beamdesign.plant.effects import library
from beamdesign.plant.equilibrium import equilibrium, linearise
from beamdesign.plant.linear_reach import with_published_effects
from beamdesign.proofs.arm import plane_loop
from beamdesign.proofs.arm.result import certify_plane
from beamdesign.proofs.writer import prototype_table
from beamdesign.prototype import prototype_from
from beamdesign.records import to_toml
from beamdesign.scenario import Scenario
from beamdesign.structure.arm import PLANES, arm_figures
from beamdesign.validation import baselines

ARM = Path(__file__).parents[1] / "studies" / "prototypes" / "arm.toml"
BESIDE, ABOVE, AT_PAYLOAD = (0.05, 0.1, 0.0), (0.05, 0.0, 0.12), (0.05, 0.1, 0.0)
FEW = ("sensor_lag", "seal_friction", "parameter:sensor_gain")


def arm(plane: str | None = "z", **more: object) -> Prototype:
    """The shipped arm in one of its planes, with tolerances and a gain that a slow sensor leaves stable."""
    found = read_prototype(ARM)
    assert found.arm is not None
    law = found.own_controller.but(gain_A_per_V=0.04)
    return found.but(tolerance=TOLERANCE, controller=law, arm=found.arm.but(plane=plane, **more))


def records(rig: Prototype, believed: Prototype) -> Dataset:
    """What a rig gives back under two payloads."""
    plan = scenario(0.6)
    rows = [row for row in plan.record if row.name not in ("load_steps", "command_small")]
    masses = (4.0, 6.8, 4.0, 6.8)
    taken = (
        row.but(controller=rig.controller, outer_end_mass_kg=mass, inner_end_mass_kg=2.5)
        for row, mass in zip(rows, masses, strict=True)
    )
    return measured(rig, plan.but(record=tuple(taken)), believed)


@pytest.mark.parametrize("mass", [0.5, 6.8])
@pytest.mark.parametrize(
    ("plane", "offset", "sensor"),
    [("z", BESIDE, None), ("y", BESIDE, None), ("y", ABOVE, (0.0, 0.0, 0.05)), ("z", BESIDE, AT_PAYLOAD)],
)
def test_its_equations_are_those_of_the_exact_loop(
    plane: str, offset: tuple[float, ...], sensor: tuple[float, ...] | None, mass: float
) -> None:
    """Linear compliance of the tip against the loop in exact polynomials, which `test_arm` holds against elements."""
    rig = arm(plane, offset_m=offset, sensor_m=sensor)
    exact = at_tip(plane_loop(rig, rig.arm.plane), mass)  # type: ignore[union-attr, arg-type]
    assembly = assemble(structure_of(rig))
    parameters = np.array(list(parameters_of(rig, mass, rig.payload.inner_end_mass_kg).values()))
    found = linearise(assembly, equilibrium(assembly, np.zeros(3), parameters), np.zeros(3), parameters)
    tip = assembly.outputs.index("outer_displacement_m")
    for hertz in (1.0, 20.0, 60.0, 150.0):
        s = 2j * np.pi * hertz
        moved = found.c[tip] @ np.linalg.solve(s * np.eye(len(found.a)) - found.a, found.b[:, 0])
        force, loop = (
            sum(float(c) * s**k for k, c in enumerate(p.coeffs())) for p in (exact.disturbance, exact.characteristic)
        )
        assert moved == pytest.approx(force / loop, rel=1e-9)


def test_a_payload_off_the_axis_is_no_gap_where_it_is_known_and_one_where_it_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for room in (searching, separability):
        monkeypatch.setattr(room, "singles", lambda prototype: tuple(Hypothesis((name,)) for name in FEW))
    found = diagnose(records(arm(), arm()), 1)
    assert found.verdict == "no_gap"
    assert found.gap.before < 3 * found.gap.noise_floor
    slow = diagnose(records(arm().but(effects={"sensor_lag": {"break_Hz": 200.0}}), arm()), 1)
    assert (slow.verdict, slow.chosen) == ("effect", ("sensor_lag",))
    assert slow.causes[0].parameters["break_Hz"].value == pytest.approx(200.0, rel=0.02)
    assert "beamdesign arm" in redesign(slow.prototype, (0.0, 6.8)).reason
    on_axis = records(arm(), arm(None))
    with Fitters(on_axis, 1) as fitters:
        (null,) = fitters.each(Task(NOTHING, {}))
    assert null.error > 0.02**2 * len(on_axis.records)


def test_a_prototype_is_written_with_the_torsion_that_it_was_fitted_with() -> None:
    """Its dashpot goes with the root of its stiffness; a beam's fitted damping ratio is that of its bending."""
    rig = arm(offset_m=(0.05, 0.3, 0.0))
    placement = NOTHING.placement(rig)
    z = np.linspace(-1.5, 1.5, len(placement.unknowns))
    of_torsion = [u.name for u in placement.unknowns if "torsional" in u.name]
    assert of_torsion == ["torsional_stiffness", "torsional_damping"]
    ahead = arm(offset_m=(0.3, 0.0, 0.0))  # which twists nothing
    assert not [u.name for u in NOTHING.placement(ahead).unknowns if "torsional" in u.name]
    written = updated_prototype(rig, Fit(NOTHING, placement.unknowns, z, 0.0, (Share(0.0, z, np.eye(len(z))),)))
    of_fit = dict(zip(placement.assembly.parameters, figures_at(placement, rig, z), strict=True))
    of_file = parameters_of(prototype_from(tomllib.loads(to_toml(written))), 3.0, 2.0)
    assert of_file.pop("believed_sensor_gain") != of_fit.pop("believed_sensor_gain")  # which a set states
    assert of_file == pytest.approx(of_fit, rel=1e-9)


def test_torsion_is_no_better_known_than_bending(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tube that is 5 % stiffer in torsion and damped by half as much more is no gap, and its figures are found."""
    for room in (searching, separability):
        monkeypatch.setattr(room, "singles", lambda prototype: tuple(Hypothesis((name,)) for name in FEW))
    believed = arm(offset_m=(0.05, 0.25, 0.0))
    stiffness, ratio = 1.05 * arm_figures(believed).torsional_stiffness, 1.5 * believed.outer_beam.damping_ratio
    torsion = {"torsional_stiffness_N_m_per_rad": stiffness, "torsional_damping_ratio": ratio}
    rig = arm(offset_m=believed.arm.offset_m, **torsion)  # type: ignore[union-attr]
    found = diagnose(records(rig, believed), 1)
    assert found.verdict == "no_gap"
    assert found.gap.before > 3 * found.gap.noise_floor
    assert found.prototype.arm is not None
    assert found.prototype.arm.torsional_stiffness_N_m_per_rad == pytest.approx(stiffness, rel=2e-3)
    assert found.prototype.arm.torsional_damping_ratio == pytest.approx(ratio, rel=0.05)


def figures_at(placement: Placement, rig: Prototype, z: np.ndarray) -> list[float]:
    """Parameters of a rig with 3 kg outside and 2 kg inside, with the unknowns of a placement at z."""
    return placement.parameters(np.array(list(parameters_of(rig, 3.0, 2.0).values())), z).tolist()


def test_records_are_examined_by_the_loop_of_their_plane() -> None:
    """Its compliance against the loop in exact polynomials, which a payload far along the beam makes another."""
    rig = arm(offset_m=(0.3, 0.0, 0.0)).but(controller=Proportional(gain_A_per_V=4e-4))
    plan = scenario(0.5)
    rows = [row for row in plan.record if row.name.startswith("disturbance")]
    placed = zip(rows, (2.0, 3.8), strict=True)
    taken = (row.but(controller=rig.controller, outer_end_mass_kg=m, inner_end_mass_kg=2.5) for row, m in placed)
    data = measured(rig, plan.but(record=tuple(taken)), rig)
    assert not examine(data).words
    at = np.geomspace(1.0, 150.0, 20)
    own = rig.but(payload=rig.payload.but(inner_end_mass_kg=2.5))
    exact = at_tip(plane_loop(own, "z"), 3.8).compliance_response(at)
    np.testing.assert_allclose(nominal_loop(rig, data.records[1]).responses(at)[:, 1, 0], exact, rtol=1e-8)


def test_a_critical_gain_is_held_against_the_loop_of_its_plane() -> None:
    """That of the loop in exact polynomials, which on the axis is fourteen times as large."""
    law = Proportional(gain_A_per_V=1.0)
    rig = arm(offset_m=(0.3, 0.0, 0.0)).but(controller=law)
    unit = at_tip(plane_loop(rig.but(payload=rig.payload.but(inner_end_mass_kg=2.5)), "z"), 6.8)
    gain = next(one.value for one in unit.gain_crossings() if one.value > 0)
    found = MeasuredGain(law.but(gain_A_per_V=gain), 6.8, 2.5, 0.03)
    assert not check_gains([found], rig, Path())
    assert GainEvidence(found, rig).nominal().gain == pytest.approx(gain, rel=1e-6)


def test_what_is_worked_out_for_the_axis_is_not_looked_for_off_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither by the diagnosis nor by what it is compared with in a blind check."""
    monkeypatch.setattr(baselines, "causes", lambda: {name: library()[name] for name in ("second_beam_mode", FEW[0])})
    for rig, modes in ((arm(), 0), (arm(None), 1)):
        placement = NOTHING.placement(rig)
        z = np.zeros(len(placement.unknowns))
        null = Fit(NOTHING, placement.unknowns, z, 0.0, (Share(0.0, z, np.eye(len(z))),))
        (piece,) = record_evidence(replace(records(rig, rig), records=records(rig, rig).records[:1]))
        assert baselines.dictionary(rig, [piece], null).names.count("second_beam_mode") == modes
    assert Hypothesis(("second_beam_mode",)) in singles(arm(None))
    assert Hypothesis(("second_beam_mode",)) not in singles(arm())
    plan = Scenario(name="short", duration_s=0.01, record=scenario().record[:1])
    with pytest.raises(InputError, match="payload on the axis"):
        simulate(arm().but(effects={"second_beam_mode": {}}), plan)


def test_the_second_controller_acts_in_its_plane() -> None:
    weak = Proportional(gain_A_per_V=1e-4)
    rows = tuple(row.but(controller=None) for row in scenario().record[3:4])
    plan = Scenario(name="short", duration_s=0.3, record=rows)
    z, y = (simulate(arm(plane, second_controller=weak), plan).records[0].column("current_A") for plane in "zy")
    assert np.abs(y).max() < 0.05 * np.abs(z).max()


def test_limits_of_a_rig_are_of_its_loop_on_the_axis_throughout() -> None:
    """Its critical gain is, and so are what harmonic balance finds: limit cycles, and how far that loop is linear."""
    beside = with_published_effects(arm("z"))
    straight = with_published_effects(arm("z").but(arm=None))
    (cycle,), (expected,) = (limit_cycles(rig, [1e-6], 6.8) for rig in (beside, straight))
    assert cycle.gain_A_per_V == pytest.approx(expected.gain_A_per_V, rel=1e-9)
    assert cycle.gain_A_per_V == pytest.approx(critical_gain(arm("z"), 6.8).gain_A_per_V, rel=0.05)


def test_a_data_set_says_in_which_plane_it_was_taken(tmp_path: Path) -> None:
    gain = [{"gain_A_per_V": 0.1}]
    (tmp_path / "dataset.toml").write_text(tomli_w.dumps({"critical_gain": gain}))

    def read(prototype: Prototype) -> Dataset:
        (tmp_path / "prototype.toml").write_text(to_toml(prototype))
        return read_dataset(tmp_path)

    assert not read(arm()).warnings
    assert "plane" in read(arm(None)).warnings[0]
    weak = Proportional(gain_A_per_V=1e-4)
    turned = read(arm("y", second_controller=weak))
    assert turned.prototype.controller == weak
    assert turned.as_stated(turned.prototype) == arm("y", second_controller=weak)
    with pytest.raises(InputError, match="couple both planes"):
        read(arm(offset_m=(0.0, 0.1, 0.1)))


def test_inputs_to_predict_by_are_those_of_a_loop_in_its_plane(tmp_path: Path) -> None:
    weak = Proportional(gain_A_per_V=1e-4)
    (tmp_path / "prototype.toml").write_text(to_toml(arm("y", second_controller=weak)))
    (tmp_path / "one.csv").write_text("t_s,disturbance_N,command_V\n" + "".join(f"{k / 1000},0,0\n" for k in range(9)))
    (tmp_path / "dataset.toml").write_text(tomli_w.dumps({"record": [{"file": "one.csv"}]}))
    ((taken,), _) = read_inputs(tmp_path)
    assert taken.controller == weak


def test_certificates_of_a_prototype_that_states_its_plane_are_checked() -> None:
    """Of the link on its axis, and of either plane."""
    rig = arm(tool_m=None)
    for found in (certify(rig, 0.0, 6.8), *(certify_plane(rig, name, 0.0, 6.8) for name in PLANES)):
        outcome = check(found.text, prototype_table(rig))
        assert outcome.valid
