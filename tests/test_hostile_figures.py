"""Figures no rig can have, options no design can meet, certificates no prover wrote: refused in words, at once."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from beamdesign import InputError, Prototype, check, critical_gain, quantities, simulate, write_prototype
from beamdesign.bench_prototype import BenchPrototype
from beamdesign.checker import Unreadable
from beamdesign.cli import app
from beamdesign.cli.command import Figure
from beamdesign.plant.bench_simulation import simulate_bench
from beamdesign.plant.equilibrium import MOST_STEPS
from beamdesign.plant.linear_reach import reach
from beamdesign.prototype import Beam, prototype_from
from beamdesign.quantities import Plausible, range_of, unit_of
from beamdesign.records import Record, parse
from beamdesign.scenario import Scenario

STUDIES = Path(__file__).parent.parent / "studies"
LAG = STUDIES / "prototypes" / "published_lag.toml"
LQG = STUDIES / "prototypes" / "lqg.toml"
CYLINDER = STUDIES / "bench" / "cylinder.toml"


def table(path: Path, **changes: Any) -> dict[str, Any]:
    """The table of a file with some figures replaced; two underscores lead into a table."""
    found = tomllib.loads(path.read_text())
    for key, value in changes.items():
        inside, _, name = key.rpartition("__")
        (found.setdefault(inside, {}) if inside else found)[name] = value
    return found


def refused(record: type[Record], found: dict[str, Any]) -> str:
    with pytest.raises(InputError) as error:
        parse(record, found, "rig.toml")
    return str(error.value)


def told(*arguments: str) -> str:
    """What bad arguments are refused with."""
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert isinstance(done.exception, InputError), done.exception
    return str(done.exception)


@pytest.mark.parametrize(
    ("path", "key", "value", "said"),
    [
        (LAG, "controller__pole_Hz", 5e-324, "is 5e-324, outside the plausible range 0.0001 to 100000 Hz"),
        (LAG, "controller__pole_Hz", 1e308, "Hz"),
        (LAG, "sensor__gain_V_per_m", 5e-324, "V/m"),
        (LQG, "outer_beam__damping_ratio", 5e-324, "or 0"),
        (LAG, "actuator__oil_stiffness_N_per_m", 1.3e13, "N/m"),
        (LAG, "actuator__oil_stiffness_N_per_m", 1.3e37, "N/m"),
        (LAG, "outer_beam__effective_mass_kg", 1e308, "kg"),
        (LAG, "outer_beam__free_length_m", 5e-324, "0.001 to 100 m"),
        (LAG, "servovalve__natural_frequency_Hz", 1e-30, "Hz"),
        (LAG, "payload__outer_end_mass_kg", [0.0, 6.8e30], "entry 2: is 6.8e+30"),
        (LAG, "tolerance__stiffness", 1.5, "1e-12 to 1 or 0"),
        (LAG, "supply__pressure_Pa", 20.0, "100000 to 1e+08 Pa"),
        (CYLINDER, "actuator__supply_pressure_Pa", 7.0, "100000 to 1e+08 Pa"),
        (CYLINDER, "actuator__bore_m", 1e308, "m"),
    ],
)
def test_a_figure_that_no_rig_has_is_refused_with_key_value_and_range(
    path: Path, key: str, value: Any, said: str
) -> None:
    record = BenchPrototype if path == CYLINDER else Prototype
    words = refused(record, table(path, **{key: value}))
    assert f"{key.replace('__', '.')}: " in words
    assert said in words
    assert "outside the plausible range" in words


@pytest.mark.parametrize(("amplitude", "level"), [({"amplitude_V": 3e30}, 1.0), ({"amplitude_V": 3.0}, 1e30)])
def test_levels_and_amplitudes_of_a_scenario_are_plausible(amplitude: dict[str, float], level: float) -> None:
    signal = {"kind": "load_steps", "levels": [level, -1.0], **amplitude}
    plan = {"name": "s", "duration_s": 1.0, "record": [{"name": "r", "input": [signal]}]}
    assert "outside the plausible range" in refused(Scenario, plan)


ALL = sorted(
    name for name, value in vars(quantities).items() if hasattr(value, "__metadata__") and name != "FiniteFloat"
)


@settings(max_examples=300)
@given(st.sampled_from(ALL), st.floats(allow_nan=False))
def test_a_quantity_holds_what_lies_in_its_range_and_nothing_else(name: str, value: float) -> None:
    from pydantic import TypeAdapter, ValidationError

    kind = getattr(quantities, name)
    bounds = range_of(kind)
    inside = bounds.low <= value <= bounds.high or (bounds.or_zero and value == 0)
    try:
        assert TypeAdapter(kind).validate_python(value) == value
        taken = True
    except ValidationError:
        taken = False
    assert taken == inside


def test_a_range_is_told_with_the_unit_of_its_key() -> None:
    assert Plausible(1.0, 2.0).refusal(3.0, "leakage_m3_per_s_per_Pa").endswith("1 to 2 m³/s/Pa")
    assert unit_of("decay_rate_per_s") == "1/s"
    assert unit_of("__added_mass_kg") == "kg"


def test_beams_that_move_side_by_side_are_of_like_length() -> None:
    one = table(STUDIES / "prototypes" / "paper_remedy.toml")
    one["inner_beam"] |= {"length_m": 0.1, "free_length_m": 0.1}
    one["outer_beam"] |= {"length_m": 1.5, "free_length_m": 1.365}
    assert "inner_beam.free_length_m" in refused(Prototype, one)
    one["inner_beam"] |= {"length_m": 0.2, "free_length_m": 0.2}
    assert prototype_from(one).inner_beam.free_length_m == 0.2


@pytest.mark.parametrize(
    ("command", "option", "value"),
    [
        ("certify", "--decay-rate-per-s", "1e300"),
        ("certify", "--bandwidth-Hz", "5e-324"),
        ("certify", "--gain-margin", "nan"),
        ("tune", "--sigmas", "1e9"),
        ("certify", "--outer-end-mass", "0:6.8e30"),
        ("certify-box", "--sigmas", "1e300"),
        ("certify-box", "--delay-s", "1e300"),
        ("certify-box", "--seconds", "nan"),
        ("certify-switching", "--rate", "1e300"),
        ("arm", "--force-N", "1e308"),
        ("arm", "--allowed-mm", "1e308"),
        ("arm", "--offset-m", "0,1e308,0"),
        ("limits", "--payload", "1e300"),
        ("limits", "--preload", "1e308"),
        ("spec", "--load-N", "1e308"),
        ("spec", "--noise-share", "5e-324"),
        ("stiffness", "--end-stiffness-N-per-m", "1e300"),
        ("stiffness", "--wall-N-per-m", "0:1e300"),
        ("size", "--tip-force-N", "1e300"),
        ("tune", "--largest-inner-end-mass-kg", "1e300"),
        ("tune", "--loop-gain", "1e300"),
        ("tune", "--peak-sensitivity", "1"),
    ],
)
def test_options_have_plausible_ranges(command: str, option: str, value: str) -> None:
    path = STUDIES / "prototypes" / ("arm.toml" if command == "arm" else "paper_remedy.toml")
    words = told(command, str(path), f"{option}={value}")
    assert option in words
    assert "outside the plausible range" in words


def test_every_option_for_a_figure_has_a_quantity() -> None:
    marks = [
        mark
        for command in app.registered_commands
        for hint in command.callback.__annotations__.values()
        for mark in getattr(hint, "__metadata__", ())
        if isinstance(mark, Figure)
    ]
    assert len(marks) > 20
    assert [mark.quantity for mark in marks if mark.quantity not in ALL] == []


def test_all_that_is_wrong_with_options_is_told_at_once() -> None:
    words = told("code", str(LAG), "--rate-Hz", "1e300", "--full-scale-V", "0", "--word-length", "4")
    assert [line.split(": ")[1] for line in words.splitlines()] == ["--rate-Hz", "--full-scale-V", "--word-length"]


def test_a_record_of_too_many_steps_is_refused_before_it_is_begun(remedy: Prototype) -> None:
    stiff = remedy.but(
        actuator=remedy.actuator.but(oil_stiffness_N_per_m=1e10),
        inner_beam=Beam(stiffness_N_per_m=1e10, effective_mass_kg=1e-6),
        payload=remedy.payload.but(inner_end_mass_kg=0.0),
    )
    plan = {"name": "long", "duration_s": 600.0, "record": [{"name": "r"}]}
    with pytest.raises(InputError, match="integration steps") as error:
        simulate(stiff, parse(Scenario, plan, "plan"))
    assert f"{MOST_STEPS:.3g} are the most" in str(error.value)
    assert "inner_mass 1e-06" in str(error.value)
    plan["record"] = [{"name": "r", "wall": {"at_m": 1e-3, "stiffness_N_per_m": 1e10}}]
    with pytest.raises(InputError, match=r"record\.r\.wall\.stiffness_N_per_m"):
        simulate(remedy, parse(Scenario, plan, "plan"))


def test_so_is_one_of_a_bench() -> None:
    stiff = {"dead_volume_m3": 1e-9, "oil_bulk_modulus_Pa": 1e10, "moving_mass_kg": 1e-6}
    bench = parse(BenchPrototype, table(CYLINDER, **{f"actuator__{key}": value for key, value in stiff.items()}), "b")
    record = {"name": "r", "input": [{"kind": "step", "amplitude_V": 9.0}]}
    plan = {"name": "p", "duration_s": 600.0, "record": [record]}
    with pytest.raises(InputError, match="integration steps"):
        simulate_bench(bench, parse(Scenario, plan, "plan"))


def twins(prototype: Prototype) -> Prototype:
    beam = Beam(stiffness_N_per_m=486_800.0, effective_mass_kg=3.9, damping_ratio=0.0)
    return prototype.but(outer_beam=beam, inner_beam=beam, payload=prototype.payload.but(inner_end_mass_kg=0.0))


def test_a_mode_that_no_gain_moves_is_said_to_be_one(remedy: Prototype, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="uncontrollable"):
        critical_gain(twins(remedy))
    write_prototype(twins(remedy), tmp_path / "twins.toml")
    command = ["code", str(tmp_path / "twins.toml"), "--rate-Hz", "10000", "--out", str(tmp_path / "c")]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 1
    assert "not stable" in done.output
    assert not (tmp_path / "c").exists()


def test_the_linear_response_is_found_however_slow_the_pole(remedy: Prototype) -> None:
    assert remedy.controller is not None
    slow = remedy.but(controller=remedy.controller.but(pole_Hz=1e-4))
    assert np.isfinite(reach(slow, "air", 1.0, 6.8).departure)


# Certificates.


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("certificates")
    one, box = folder / "one.toml", folder / "box.toml"
    CliRunner().invoke(app, ["certify", str(LAG), "--outer-end-mass", "0:0", "--out", str(one)])
    options = ["--sigmas", "0.3", "--outer-end-mass", "0:1", "--out", str(box)]
    CliRunner().invoke(app, ["certify-box", str(STUDIES / "prototypes" / "paper_remedy.toml"), *options])
    return {"one": one.read_text(), "box": box.read_text()}


def with_entry(text: str, key: str, value: str) -> str:
    lines = text.splitlines()
    (at, *_) = [k for k, line in enumerate(lines) if line.startswith(f"{key} = ")]
    lines[at] = f"{key} = {value}"
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("which", "key", "value"),
    [
        ("one", "outer_stiffness_N_per_m", '"0"'),
        ("one", "oil_stiffness_N_per_m", '"0"'),
        ("one", "piston_area_m2", '"0"'),
        ("one", "outer_mass_kg", '"' + 4000 * "9" + '"'),
        ("one", "outer_mass_kg", 5000 * "9"),
        ("one", "denominator", "[]"),
        ("one", "denominator", '["0"]'),
        ("one", "denominator", 5000 * "[" + 5000 * "]"),
        ("one", "denominator", "[" + ",".join(300 * ['"1"']) + "]"),
        ("one", "kind", "[" * 40 + "]" * 40),
        ("box", "flow_gain", '["1"]'),
        ("box", "flow_gain", '"1"'),
        ("box", "p", '"' + 20_000 * "-" + 's"'),
        ("box", "p", '"' + 14_000 * "-" + 's"'),
        ("box", "p", '"' + 7_000 * "(" + "s" + 7_000 * ")" + '"'),
        ("box", "p", '"(a+b+c+d+e+s)**60"'),
        ("box", "p", '"s**99999999"'),
        ("box", "p", '"' + "*".join(12 * ["(1+a+b+c+d+s)"]) + '"'),
    ],
)
def test_a_certificate_beyond_all_limits_is_not_tried(
    certificates: dict[str, str], tmp_path: Path, which: str, key: str, value: str
) -> None:
    path = tmp_path / "certificate.toml"
    path.write_text(with_entry(certificates[which], key, value))
    try:
        valid = check(path).valid
    except Unreadable:
        return
    assert not valid


def test_a_leaf_that_multiplies_out_to_millions_is_refused_by_its_name(
    certificates: dict[str, str], tmp_path: Path
) -> None:
    path = tmp_path / "box.toml"
    found = tomllib.loads(certificates["box"])
    name = next(iter(found["leaf"]))
    found["leaf"][name] = "(a+b+c+d+e+s)**60"
    path.write_text(tomli_w.dumps(found))
    with pytest.raises(Unreadable, match=f"leaf.{name} comes to"):
        check(path)


def test_honest_certificates_are_within_the_limits(certificates: dict[str, str], tmp_path: Path) -> None:
    for name, text in certificates.items():
        (tmp_path / name).write_text(text)
        assert check(tmp_path / name).valid


def test_a_huge_certificate_and_a_pipe_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "huge.toml"
    with open(path, "wb") as file:
        file.truncate(10**9)
    for odd in (path, Path("/dev/zero"), tmp_path):
        with pytest.raises(Unreadable):
            check(odd)
