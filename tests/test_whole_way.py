"""Links of one's own go the whole way: from the edited template to a proof, code, records, a diagnosis and a redesign.

Small: exactly the figures stated, records of half a second. What is proved is proved again by the stand-alone checker
in a process of its own; what is diagnosed was put in.
"""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from one_start import best_start_alone
from typer.testing import CliRunner

from beamdesign import read_prototype, state_space
from beamdesign.build import analogue, tolerances
from beamdesign.cli import app
from beamdesign.diagnosis.fitting import search as searching
from beamdesign.diagnosis.fitting.hypothesis import singles
from beamdesign.structure.lumped import CHANGEABLE, with_figures

pytestmark = pytest.mark.long

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "beamdesign" / "docs" / "own_link.md").read_text(encoding="utf-8")
SCREW = """[actuator]
kind = "ball_screw"
lead_m = 0.005
screw_stiffness_N_per_m = 8e7
screw_damping_N_s_per_m = 300.0
torque_constant_N_m_per_A = 0.3
rotor_inertia_kg_m2 = 3e-5
speed_feedback_A_s_per_rad = 0.1
current_loop_Hz = 1000.0

"""
RECORDS = """name = "records"
duration_s = 0.5
measurement = {{ seed = 1, current_std_A = {current_std_A}, displacement_std_m = 2e-7 }}

[[record]]
name = "push"
outer_end_mass_kg = 0.0
input = [{{ kind = "multisine", amplitude_N = 10.0, low_Hz = 2.0, high_Hz = 200.0, seed = 1 }}]

[[record]]
name = "command"
outer_end_mass_kg = {largest_kg}
input = [{{ kind = "multisine", amplitude_V = 0.5, low_Hz = 2.0, high_Hz = 200.0, seed = 2 }}]
"""


def typed(*words: object, exit_code: int = 0) -> str:
    """What a command prints; a warning of numpy or scipy is an error here (pyproject.toml)."""
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    assert done.exit_code == exit_code, done.output
    return done.output


def answer(*words: object, exit_code: int = 0, folder: Path) -> dict[str, Any]:
    """What a command says as JSON."""
    typed(*words, "--json", folder / "answer.json", exit_code=exit_code)
    found: dict[str, Any] = json.loads((folder / "answer.json").read_text())
    return found


def checked(prototype: Path) -> None:
    """The certificate beside a prototype is valid by the stand-alone checker."""
    command = [sys.executable, "-m", "beamdesign.checker", str(prototype.with_name("certificate.toml")), str(prototype)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=os.environ)
    assert done.returncode == 0, done.stdout + done.stderr


def study(folder: Path, screw: bool = False, shape: str = "square", **figures: object) -> Path:
    """The template as a user edits it: figures by their keys, the same of both tubes, or (outer, inner)."""
    file = folder / "link.toml"
    typed("new", "study", "--out", file)
    text = file.read_text()
    if screw:
        text = re.sub(r"^\[actuator\].*?(?=^\[sensor\])", SCREW, text.partition("[tolerance]")[0], flags=re.M | re.S)
    for key, value in figures.items():
        values = value if isinstance(value, tuple) else (value, value)
        given = iter(value if isinstance(value, str) else repr(value) for value in values)
        text, count = re.subn(
            rf"^{key} = [^#\n]*", lambda _, key=key, given=given: f"{key} = {next(given)} ", text, flags=re.M
        )
        assert count in (1, 2), key
    more = "\ndepth_over_width = 1.5" if shape == "rectangle" else ""
    file.write_text(re.sub(r"^(material = .*)$", rf'\1\nshape = "{shape}"{more}', text, flags=re.M))
    return file


def of_length(free_m: float, **more: object) -> dict[str, object]:
    return {"length_m": 1.2 * free_m, "free_length_m": (free_m, 1.1 * free_m), **more}


ALUMINIUM = of_length(
    0.4, material='"6082-T6"', tip_force_N=100.0, end_mass_kg=(0.8, 0.1), outer_end_mass_kg="[0.0, 0.5]", shape="round"
)
STEEL = of_length(
    0.8, material='"S235JRH"', tip_force_N=500.0, end_mass_kg=(2.0, 0.3), outer_end_mass_kg="[0.0, 3.0]",
    shape="round", screw=True,
)  # fmt: skip


def specified(prototype: Path, out: Path, at_rest: tuple[str, float]) -> dict[str, Any]:
    """What there is to build, of the bandwidth that is proved already, and a rating that is statics.

    Rigs with every figure at an end of what is specified for it are stable by python-control, with any payload.
    """
    typed("spec", prototype, "--out", out)
    found: dict[str, Any] = json.loads((out / "specification.json").read_text())
    rig = read_prototype(prototype)
    assert rig.guarantee is not None
    assert found["guaranteed"]["bandwidth_Hz"] == pytest.approx(rig.guarantee.bandwidth_Hz)
    still_N = found["load_N"] + found["ratings"]["weight_N"]
    assert found["ratings"][at_rest[0]] == pytest.approx(at_rest[1] * still_N, rel=1e-6)
    assert found["digital"]["one_period_late"]["stable"]
    assert (out / "drawing.dxf").stat().st_size > 0
    figures = {row["name"]: row["specified"] for row in found["tolerances"]["figures"] if row["name"] in CHANGEABLE}
    assert len(figures) > 10
    assert min(figures.values()) > 0.002
    random, (low, high) = np.random.default_rng(5), rig.guarantee.outer_end_mass_kg
    for _ in range(10):
        ends = {name: 1 + float(random.choice((-1.0, 1.0))) * part for name, part in figures.items()}
        other = with_figures(rig, ends)
        assert all(state_space(other, float(mass)).poles().real.max() < 0 for mass in np.linspace(low, high, 5))
    return found


def of_screw(prototype: Path) -> tuple[str, float]:
    """The rating at rest of a motor: the torque that balances a newton, as a current."""
    screw = read_prototype(prototype).actuator
    return "rest_current_A", screw.lead_m / (2 * np.pi) / screw.torque_constant_N_m_per_A


def assert_lag(found: dict[str, Any], prototype: Path, put_in_Hz: float) -> None:
    """The lag that was put in, and a redesign that keeps the goal with it, proved."""
    assert (found["verdict"], found["chosen"]) == ("effect", ["sensor_lag"])
    at = found["effects"][0]["parameters"]["break_Hz"]
    assert abs(at["value"] - put_in_Hz) < 4 * at["std"] < 0.2 * put_in_Hz
    goal = read_prototype(prototype).goal.peak_sensitivity
    as_built = found["design"][0]["diagnosed"]["peak_sensitivity"]
    assert as_built is None or as_built > goal  # None: the loop that was built is not stable for every payload
    assert 0 < found["redesign"]["guaranteed"]["peak_sensitivity"] <= goal
    checked(Path(found["redesigned"]))


def built_and_diagnosed(prototype: Path, folder: Path, lag_Hz: float, current_std_A: float) -> None:
    """A rig with a slow sensor, simulated in the place of a built one, records; it is found what was put in."""
    guarantee = read_prototype(prototype).guarantee
    assert guarantee is not None
    largest_kg = guarantee.outer_end_mass_kg[1]
    rig, scenario = folder / "rig.toml", folder / "records.toml"
    rig.write_text(prototype.read_text() + f"\n[effects.sensor_lag]\nbreak_Hz = {lag_Hz}\n")
    scenario.write_text(RECORDS.format(current_std_A=current_std_A, largest_kg=largest_kg))
    typed("simulate", rig, "--scenario", scenario, "--out", folder / "recorded", "--no-plots")
    files = [folder / "recorded" / f"{name}.csv" for name in ("push", "command")]
    said = typed(
        "gap", "import", *files, "--prototype", prototype, "--outer-end-mass", 0, "--outer-end-mass", largest_kg,
        "--out", folder / "set",
    )  # fmt: skip
    assert "no unit stated" not in said
    words = ("gap", "diagnose", folder / "set", "--out", folder / "found", "--workers", 1, "--redesign")
    assert_lag(answer(*words, folder=folder), prototype, lag_Hz)


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few causes and parts to choose from, and tolerances not sought to the last per cent.

    `slow_sensor.py` has all causes, `test_spec_command.py` all parts, `golden` tolerances to the last per cent.
    """
    monkeypatch.setattr(tolerances, "_WITHIN", 0.2)
    monkeypatch.setattr(tolerances, "_COARSE", 0.2)
    monkeypatch.setattr(analogue, "SERIES", (("E96", "E6"),))
    monkeypatch.setattr(analogue, "RESISTORS", (0.01,))
    causes = ("sensor_lag", "transport_delay", "parameter:flow_gain", "parameter:torque_constant")
    monkeypatch.setattr(searching, "singles", lambda rig: tuple(h for h in singles(rig) if str(h) in causes))


@pytest.mark.usefixtures("few", "no_pictures", "one_start")
def test_an_aluminium_link_with_a_cylinder(tmp_path: Path) -> None:
    link, prototype = study(tmp_path, **ALUMINIUM), tmp_path / "out/prototype.toml"
    found = answer("run", link, "--out", tmp_path / "out", "--nominal", folder=tmp_path)
    assert found["guaranteed"]["bandwidth_Hz"] > 1.0
    assert found["guaranteed"]["peak_sensitivity"] <= 2.0
    checked(prototype)
    area = read_prototype(prototype).actuator.piston_area_m2
    said = specified(prototype, tmp_path / "specification", ("rest_pressure_Pa", 1 / area))
    assert {one["verdict"] for made in said["analogue"] for one in made["tolerances"]} == {"proved"}
    assert "proved: stable for 0 to 0.5 kg" in typed("code", prototype, "--rate-Hz", 5000, "--out", tmp_path / "code")
    built_and_diagnosed(prototype, tmp_path, 100.0, 1e-5)


@pytest.mark.usefixtures("no_pictures", "one_start")
def test_a_steel_link_with_a_screw(tmp_path: Path) -> None:
    """Its loop contracts little from sample to sample; python-control has its poles within the unit circle.

    From there on the arm of the page below, which has a screw as well, is specified, recorded and diagnosed.
    """
    prototype = tmp_path / "out/prototype.toml"
    found = answer("run", study(tmp_path, **STEEL), "--out", prototype.parent, "--nominal", folder=tmp_path)
    assert found["guaranteed"]["bandwidth_Hz"] > 1.0
    checked(prototype)
    said = typed("code", prototype, "--rate-Hz", 10000, "--out", tmp_path / "code")
    assert "proved: stable for 0 to 3 kg, the current held, put out at once or one period late" in said
    rig = read_prototype(prototype)
    for mass in np.linspace(0.0, 3.0, 13):
        assert state_space(rig, float(mass)).poles().real.max() < 0
    slow = answer("code", prototype, "--rate-Hz", 500, "--out", tmp_path / "slow", exit_code=1, folder=tmp_path)
    assert "not stable" in slow["reason"]


REFUSED = {
    "carbon, rectangular, cylinder": (
        of_length(2.5, material='"CFRP-0-60-45-40"', tip_force_N=2000.0, shape="rectangle"),
        'sections.choose = "free"',
    ),
    "aluminium, square, screw": (
        of_length(2.5, material='"6061-T6"', tip_force_N=5000.0, screw=True),
        'sections.choose = "free"',
    ),
    "steel, square, cylinder": (  # a structured law is long to tune: its changes are told and not tried
        of_length(2.5, material='"S355J2H"', tip_force_N=5000.0, kind='"structured"'),
        "actuator.piston_area_m2 = ",
    ),
}


CORNERS = {
    f"{name}, {actuator}, 3 m, 5 kN": (
        of_length(2.5, material=f'"{material}"', tip_force_N=5000.0, shape=shape, screw=actuator == "screw"),
        "load.tip_force_N = ",
    )
    for name, material, shape in (("aluminium", "6082-T6", "square"), ("carbon", "CFRP-0-60-45-40", "round"))
    for actuator in ("cylinder", "screw")
}
REFUSED |= CORNERS


@pytest.mark.parametrize("name", REFUSED)
def test_a_refusal_names_what_to_change(name: str, tmp_path: Path) -> None:
    figures, change = REFUSED[name]
    link = study(tmp_path, **figures)
    found = answer("run", link, "--out", tmp_path / "out", "--nominal", exit_code=1, folder=tmp_path)
    assert found["reason"]
    assert any(change in one for one in found["change"]), found["change"]
    assert not (tmp_path / "out" / "prototype.toml").exists()


@pytest.mark.parametrize(
    ("actuator", "figures"),
    [
        ("cylinder", of_length(2.5, material='"CFRP-0-60-45-40"', tip_force_N=100.0, end_mass_kg=(2.1, 0.12),
                               under_load_m=0.01, outer_end_mass_kg="[0.0, 0.4]", shape="round")),
        ("screw", of_length(2.5, material='"S355J2H"', tip_force_N=5000.0, end_mass_kg=(7.0, 1.1),
                            under_load_m=0.014, outer_end_mass_kg="[0.0, 20.0]", screw=True)),
    ],
    ids=["carbon, cylinder, 3 m, 100 N", "steel, screw, 3 m, 5 kN"],
)  # fmt: skip
@pytest.mark.usefixtures("no_pictures", "one_start")
def test_a_corner_is_proved(actuator: str, figures: dict[str, Any], tmp_path: Path) -> None:
    """Stiffer at its tip than with the servo off as far as its bandwidth reaches, by python-control and statics."""
    prototype = tmp_path / "out/prototype.toml"
    found = answer("run", study(tmp_path, **figures), "--out", prototype.parent, "--nominal", folder=tmp_path)
    checked(prototype)
    rig, bandwidth = read_prototype(prototype), found["guaranteed"]["bandwidth_Hz"]
    assert rig.actuator.kind == {"cylinder": "servo_cylinder", "screw": "ball_screw"}[actuator]
    assert bandwidth > 0.5
    for mass in rig.payload.outer_end_mass_kg:
        within = state_space(rig, float(mass))["displacement_m", "disturbance_N"]
        given = np.abs(within(2j * np.pi * np.geomspace(0.01, 0.999 * bandwidth, 50)))
        assert given.max() <= rig.goal.compliance_m_per_N * (1 + 1e-6)


@pytest.mark.usefixtures("few", "no_pictures")
def test_the_commands_of_the_page_lead_to_what_it_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The gripper arm of `own_link`, of carbon tubes, in order; of exactly its figures, records of half a second.

    Reports of this arm have their pictures where `test_notebooks.py` designs and diagnoses it.
    """
    monkeypatch.chdir(tmp_path)
    (tmp_path / "studies").symlink_to(ROOT / "studies")
    short = tmp_path / "short.toml"
    named = "studies/scenarios/gripper_arm.toml"
    short.write_text((ROOT / named).read_text().replace("duration_s = 2.0", "duration_s = 0.5"))
    prototype, done = tmp_path / "results/gripper_arm/prototype.toml", []
    for line in "".join(re.findall(r"^```sh\n(.*?)^```", PAGE, flags=re.M | re.S)).splitlines():
        if not line.startswith("beamdesign "):
            subprocess.run(line, shell=True, check=True)
            continue
        words = shlex.split(line.replace(named, str(short)))[1:]
        done.append(words[0])
        if words[0] == "run":
            found = answer(*words, "--nominal", folder=tmp_path)
            assert re.search(r"`--nominal` proves (\d+) Hz", PAGE)[1] == f"{found['guaranteed']['bandwidth_Hz']:.0f}"
            checked(prototype)
        elif words[:2] == ["gap", "diagnose"]:
            with best_start_alone():
                assert_lag(answer(*words, "--workers", 1, folder=tmp_path), prototype, 150.0)
        elif words[0] == "spec":
            said = specified(Path(words[1]), Path(words[3]), of_screw(prototype))
            assert said["analogue"][0]["stable"]
        else:
            typed(*words)
    assert done == ["run", "spec", "code", "simulate", "gap", "gap"]
