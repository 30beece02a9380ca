"""The prototype: TOML in and out without loss, and every refusal that a user may meet."""

import copy
import hashlib
import tomllib
from math import inf, nan
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from beamdesign import InputError, Prototype, read_prototype, write_prototype
from beamdesign import quantities as q
from beamdesign.controllers import Lag, Proportional
from beamdesign.plant.actuators.servo_cylinder import ServoCylinder
from beamdesign.prototype import Beam, Goal, Guarantee, Payload, Sensor, Servovalve, Tolerance, prototype_from
from beamdesign.records import to_toml
from beamdesign.structure.materials import material_names

ROOT = Path(__file__).parent.parent
SHIPPED = sorted((ROOT / "studies" / "prototypes").glob("*.toml"))
BESIDE = sorted((ROOT.parent / "shared" / "rig").glob("*/prototype.toml"))
"""Rigs that may lie beside the project; where none do, there is nothing to read."""


def figures(quantity: Any) -> st.SearchStrategy[float]:
    """All that is plausible of a quantity."""
    bounds = q.range_of(quantity)
    inside = st.floats(bounds.low, bounds.high)
    return inside | st.just(0.0) if bounds.or_zero else inside


texts = st.text(st.characters(exclude_categories=["C", "Zl", "Zp"]), min_size=1, max_size=60)
lags = st.builds(Lag, gain_A_per_V=figures(q.LawGain), pole_Hz=figures(q.Frequency), zero_Hz=figures(q.Frequency))
masses = st.tuples(figures(q.MassOrNone), figures(q.MassOrNone)).map(lambda ends: tuple(sorted(ends)))


@st.composite
def beams(draw: st.DrawFn, width: float | None = None) -> Beam:
    """Lumped figures, a geometry, or both."""
    which = draw(st.sampled_from(["lumped", "geometry", "both"]))
    fields: dict[str, Any] = {"damping_ratio": draw(figures(q.StructuralDamping))}
    if which != "geometry":
        fields |= {"stiffness_N_per_m": draw(figures(q.Stiffness)), "effective_mass_kg": draw(figures(q.Mass))}
    if which != "lumped":
        width = width or draw(st.floats(0.01, 2.0))
        wall = width * draw(st.floats(max(0.01, 1.001e-5 / width), 0.49))  # no thinner than is plausible
        length = draw(st.floats(1.0, 3.0))
        fields |= {
            "width_m": width,
            "wall_m": wall,
            "corner_radius_m": draw(st.sampled_from([0.0, min(wall * 1.01, width / 2)])),
            "free_length_m": length * draw(st.floats(0.4, 1.0)),
            "length_m": length,
            "material": draw(st.sampled_from(material_names())),
            "end_mass_kg": draw(figures(q.MassOrNone)),
        }
    return Beam(**fields)


@st.composite
def prototypes(draw: st.DrawFn) -> Prototype:
    outer = draw(beams())
    opening = None if outer.width_m is None or outer.wall_m is None else outer.width_m - 2 * outer.wall_m
    return Prototype(
        name=draw(texts),
        outer_beam=outer,
        inner_beam=draw(beams(None if opening is None else opening * 0.9)),
        actuator=draw(
            st.builds(ServoCylinder, piston_area_m2=figures(q.PistonArea), oil_stiffness_N_per_m=figures(q.Stiffness))
        ),
        servovalve=draw(
            st.builds(
                Servovalve,
                flow_gain_m3_per_s_per_A=figures(q.FlowPerCurrent),
                leakage_m3_per_s_per_Pa=figures(q.Leakage),
                natural_frequency_Hz=figures(q.ComponentFrequency),
                damping_ratio=figures(q.SpoolDamping),
            )
        ),
        sensor=draw(
            st.builds(Sensor, gain_V_per_m=figures(q.SensorGain), filter_Hz=st.none() | figures(q.ComponentFrequency))
        ),
        controller=draw(st.none() | lags | st.builds(Proportional, gain_A_per_V=figures(q.LawGain))),
        payload=draw(st.builds(Payload, outer_end_mass_kg=st.none() | masses, inner_end_mass_kg=figures(q.MassOrNone))),
        goal=draw(
            st.builds(Goal, compliance_m_per_N=figures(q.ComplianceLimit), peak_sensitivity=figures(q.PeakSensitivity))
        ),
        tolerance=draw(st.builds(Tolerance, stiffness=figures(q.RelativeStd), inner_end_mass=figures(q.RelativeStd))),
        guarantee=draw(
            st.none()
            | st.builds(
                Guarantee,
                bandwidth_Hz=figures(q.Frequency),
                peak_sensitivity=figures(q.PeakSensitivity),
                outer_end_mass_kg=masses,
                certificate=texts,
                certificate_sha256=texts,
            )
        ),
        effects=draw(st.dictionaries(texts, st.dictionaries(texts, st.floats(-1e9, 1e9), max_size=2), max_size=2)),
    )


@given(prototypes())
def test_toml_and_back_loses_nothing(tmp_path_factory, prototype):
    path = tmp_path_factory.mktemp("prototypes") / "prototype.toml"
    write_prototype(prototype, path)
    assert read_prototype(path) == prototype


@pytest.mark.parametrize("path", [*SHIPPED, *BESIDE], ids=lambda path: f"{path.parent.name}/{path.name}")
def test_a_file_read_and_written_says_the_same(tmp_path, path):
    """All figures of the file come through, and a second round changes not a byte."""
    prototype = read_prototype(path)
    write_prototype(prototype, tmp_path / "once.toml")
    again = read_prototype(tmp_path / "once.toml")
    assert again == prototype
    write_prototype(again, tmp_path / "twice.toml")
    assert (tmp_path / "twice.toml").read_bytes() == (tmp_path / "once.toml").read_bytes()
    assert contains(tomllib.loads((tmp_path / "once.toml").read_text()), tomllib.loads(path.read_text()))


def contains(whole: Any, part: Any) -> bool:
    """Whether a nested table holds all of another's entries."""
    if isinstance(part, dict):
        return all(key in whole and contains(whole[key], value) for key, value in part.items())
    return whole == part


def test_the_shipped_prototype_is_the_published_rig(paper):
    """The lumped figures of the file against those of the fixture, which come from the appendix."""
    (shipped,) = [read_prototype(path) for path in SHIPPED if path.stem == "paper_remedy"]
    assert (shipped.actuator, shipped.servovalve, shipped.sensor) == (paper.actuator, paper.servovalve, paper.sensor)
    for name in ("outer_beam", "inner_beam"):
        ours, theirs = getattr(shipped, name), getattr(paper, name)
        assert ours.stiffness_N_per_m == theirs.stiffness_N_per_m
        assert ours.effective_mass_kg == theirs.effective_mass_kg
    assert shipped.controller == Lag(gain_A_per_V=0.15, pole_Hz=1.75, zero_Hz=26.0)


def test_prototypes_are_frozen_through_and_through(paper):
    for change in (
        lambda: setattr(paper, "name", "other"),
        lambda: setattr(paper.outer_beam, "width_m", 0.1),
        lambda: setattr(paper.payload, "inner_end_mass_kg", 1.0),
    ):
        with pytest.raises(ValidationError, match="frozen"):
            change()


TABLE: dict[str, Any] = {
    "name": "rig",
    "outer_beam": {"width_m": 0.14, "wall_m": 0.0023, "free_length_m": 1.195, "length_m": 1.5, "material": "6061-T6"},
    "inner_beam": {"width_m": 0.1, "wall_m": 0.0032, "free_length_m": 1.365, "length_m": 1.5, "material": "6061-T6"},
    "actuator": {"piston_area_m2": 1.13e-4, "oil_stiffness_N_per_m": 1.3e7},
    "servovalve": {
        "flow_gain_m3_per_s_per_A": 1.13e-2,
        "leakage_m3_per_s_per_Pa": 3.8e-13,
        "natural_frequency_Hz": 150.0,
    },
    "sensor": {"gain_V_per_m": 1180.0},
}


def changed(key: str, value: Any) -> dict[str, Any]:
    """The table above with one value set, or taken away where it is None."""
    table: dict[str, Any] = copy.deepcopy(TABLE)
    *way, last = key.split(".")
    inner = table
    for step in way:
        inner = inner.setdefault(step, {})
    if value is None:
        del inner[last]
    else:
        inner[last] = value
    return table


def refused(table: dict[str, Any]) -> list[tuple[str, str]]:
    with pytest.raises(InputError) as caught:
        prototype_from(table, "rig.toml")
    assert caught.value.source == "rig.toml"
    return [tuple(problem) for problem in caught.value.problems]


def test_the_table_itself_is_sound():
    assert prototype_from(TABLE).outer_beam.geometry is not None


GEOMETRY = "width_m, wall_m, free_length_m, material"


@pytest.mark.parametrize(
    ("key", "value", "named", "reason"),
    [
        # Unknown keys and wrong units, with what was meant.
        ("outer_beam.withd_m", 0.14, "outer_beam.withd_m", "unknown key; did you mean width_m?"),
        ("outer_beam.wall_mm", 2.3, "outer_beam.wall_mm", "wrong unit mm: give wall_m, in m"),
        (
            "outer_beam.stiffness_N_per_cm",
            4868.0,
            "outer_beam.stiffness_N_per_cm",
            "wrong unit N_per_cm: give stiffness_N_per_m, in N/m",
        ),
        (
            "servovalve.flow_gain_cm3_per_s_per_mA",
            11.3,
            "servovalve.flow_gain_cm3_per_s_per_mA",
            "wrong unit cm3_per_s_per_mA: give flow_gain_m3_per_s_per_A, in m3/s/A",
        ),
        ("sensor.gain_V_per_cm", 11.8, "sensor.gain_V_per_cm", "wrong unit V_per_cm: give gain_V_per_m, in V/m"),
        ("sensors", {}, "sensors", "unknown key; did you mean sensor?"),
        # Figures in an everyday unit under an SI key are far outside of what a rig can have.
        (
            "actuator.piston_area_m2",
            1.13,
            "actuator.piston_area_m2",
            "is 1.13, outside the plausible range 1e-07 to 1 m²",
        ),
        (
            "servovalve.flow_gain_m3_per_s_per_A",
            11.3,
            "servovalve.flow_gain_m3_per_s_per_A",
            "is 11.3, outside the plausible range 1e-06 to 5 m³/s/A",
        ),
        (
            "servovalve.leakage_m3_per_s_per_Pa",
            3.8e-7,
            "servovalve.leakage_m3_per_s_per_Pa",
            "is 3.8e-07, outside the plausible range 1e-18 to 1e-08 or 0 m³/s/Pa",
        ),
        ("outer_beam.width_m", 140.0, "outer_beam.width_m", "is 140.0, outside the plausible range 0.0001 to 2 m"),
        # Figures that no rig can have.
        ("outer_beam.wall_m", -0.0023, "outer_beam.wall_m", "is -0.0023, outside the plausible range 1e-05 to 1 m"),
        ("sensor.gain_V_per_m", nan, "sensor.gain_V_per_m", "must be a finite number, is nan"),
        ("sensor.filter_Hz", inf, "sensor.filter_Hz", "must be a finite number, is inf"),
        (
            "outer_beam.damping_ratio",
            1.0,
            "outer_beam.damping_ratio",
            "is 1.0, outside the plausible range 1e-06 to 0.99 or 0",
        ),
        (
            "outer_beam.end_mass_kg",
            -1.0,
            "outer_beam.end_mass_kg",
            "is -1.0, outside the plausible range 0 to 100000 kg",
        ),
        ("goal.peak_sensitivity", 1.0, "goal.peak_sensitivity", "is 1.0, outside the plausible range 1.00001 to 1000"),
        (
            "payload.outer_end_mass_kg",
            [6.8, 0.0],
            "payload.outer_end_mass_kg",
            "empty mass range: 6.8 is above 0.0; write [least, most]",
        ),
        ("payload.outer_end_mass_kg", [0.0], "payload.outer_end_mass_kg", "entry 2: missing"),
        # Geometry that cannot be built.
        ("outer_beam.wall_m", 0.07, "outer_beam.wall_m", "0.07 is not less than half the width, 0.07"),
        (
            "inner_beam.width_m",
            0.138,
            "inner_beam.width_m",
            "0.138 does not fit inside the outer beam, whose opening is 0.1354",
        ),
        ("outer_beam.free_length_m", 1.6, "outer_beam.free_length_m", "1.6 exceeds length_m, 1.5"),
        (
            "outer_beam.corner_radius_m",
            0.001,
            "outer_beam.corner_radius_m",
            "outside radius 0.001 is less than the wall, 0.0023",
        ),
        (
            "inner_beam.corner_radius_m",
            0.06,
            "inner_beam.corner_radius_m",
            "outside radius 0.06 exceeds half the width, 0.05",
        ),
        # Wrong types.
        ("outer_beam.wall_m", True, "outer_beam.wall_m", "must be a number, is True"),
        ("outer_beam.wall_m", "2.3 mm", "outer_beam.wall_m", "must be a number, is '2.3 mm'"),
        ("outer_beam", "140 x 2.3", "outer_beam", "must be a table, is '140 x 2.3'"),
        ("name", 5, "name", "must be text in quotes, is 5"),
        ("outer_beam.material", 6061, "outer_beam.material", "must be the name of a material in quotes, is 6061"),
        ("effects.sensor_lag", 0.1, "effects.sensor_lag", "must be a table, is 0.1"),
        ("effects.sensor_lag.time_s", "1", "effects.sensor_lag.time_s", "must be a number, is '1'"),
        # What is missing.
        ("sensor", None, "sensor", "missing"),
        ("servovalve.natural_frequency_Hz", None, "servovalve.natural_frequency_Hz", "missing"),
        (
            "outer_beam.free_length_m",
            None,
            "outer_beam",
            f"needs stiffness_N_per_m and effective_mass_kg, or the geometry: {GEOMETRY}",
        ),
        ("controller", {"gain_A_per_V": 0.1}, "controller", "missing kind"),
        ("controller", {"kind": "lag", "gain_A_per_V": 0.1, "pole_Hz": 1.0}, "controller.zero_Hz", "missing"),
        (
            "controller",
            {"kind": "pid", "gain_A_per_V": 0.1},
            "controller",
            "kind must be one of 'proportional', 'lag', 'structured', 'observer', 'scheduled', is 'pid'",
        ),
        (
            "controller",
            {"kind": "proportional", "gain_mA_per_V": 15.0, "gain_A_per_V": 0.015},
            "controller.gain_mA_per_V",
            "wrong unit mA_per_V: give gain_A_per_V, in A/V",
        ),
    ],
)
def test_one_thing_wrong_is_named_by_key_and_reason(key, value, named, reason):
    assert refused(changed(key, value)) == [(named, reason)]


def test_an_unknown_alloy_comes_with_the_known_ones():
    ((key, reason),) = refused(changed("outer_beam.material", "wood"))
    assert key == "outer_beam.material"
    assert all(name in reason for name in ("'wood'", *material_names()))


def test_all_errors_come_at_once():
    table = changed("outer_beam.wall_m", 0.08)
    table["inner_beam"] |= {"width_m": -0.1, "colour": "red"}
    table["payload"] = {"outer_end_mass_kg": [3.0, 1.0]}
    del table["sensor"]
    assert {key for key, _ in refused(table)} == {
        "outer_beam.wall_m",
        "inner_beam.width_m",
        "inner_beam.colour",
        "payload.outer_end_mass_kg",
        "sensor",
    }


def test_a_file_names_itself_and_nothing_is_written(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(to_toml(prototype_from(TABLE)).replace("wall_m = 0.0023", "wall_m = 0.08"), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_prototype(path)
    assert str(caught.value).startswith(f"{path}: outer_beam.wall_m: 0.08 is not less than half the width")
    assert list(tmp_path.iterdir()) == [path]


def test_another_kind_of_rig_is_told_apart_from_a_broken_prototype(tmp_path):
    path = tmp_path / "bench.toml"
    path.write_text('kind = "actuator_bench"\nname = "bench"\n', encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_prototype(path)
    (problem,) = caught.value.problems
    assert problem.key == "kind"
    assert "'actuator_bench' is not a rig this command can work on" in problem.reason


def test_a_write_that_fails_leaves_the_file_as_it_was(tmp_path, paper, monkeypatch):
    path = tmp_path / "rig.toml"
    write_prototype(paper, path)
    before = path.read_bytes()

    def full(source: Any, target: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(OSError, match="No space left"):
        write_prototype(paper.but(name="other"), path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_whole_numbers_are_figures_too():
    table = changed("sensor.gain_V_per_m", 1180)
    table["payload"] = {"outer_end_mass_kg": [0, 7]}
    prototype = prototype_from(table)
    assert isinstance(prototype.sensor.gain_V_per_m, float)
    assert prototype.payload.outer_end_mass_kg == (0.0, 7.0)


@pytest.mark.parametrize(("content", "problems"), [(None, 0), (b"proof", 0), (b"another", 1)])
def test_the_certificate_of_a_guarantee_has_the_content_it_had(
    paper: Prototype, tmp_path: Path, content: bytes | None, problems: int
) -> None:
    guarantee = {
        "bandwidth_Hz": 4.0,
        "peak_sensitivity": 2.0,
        "outer_end_mass_kg": (0.0, 1.0),
        "certificate": "certificate.toml",
        "certificate_sha256": hashlib.sha256(b"proof").hexdigest(),
    }
    write_prototype(paper.but(guarantee=guarantee), tmp_path / "prototype.toml")
    if content is not None:
        (tmp_path / "certificate.toml").write_bytes(content)
    found = []
    try:
        read_prototype(tmp_path / "prototype.toml")
    except InputError as error:
        found = [problem.key for problem in error.problems]
    assert found == ["guarantee.certificate_sha256"] * problems
