"""What the README tells a reader to type exists, and the figures it quotes are what the tool computes."""

import ast
import re
import shlex
from pathlib import Path

import pytest
import typer.main

import beamdesign
from beamdesign.cli import app
from beamdesign.controllers import Lag
from beamdesign.proof.certificate import Asked
from beamdesign.proof.certifying import certify
from beamdesign.prototype import COMPLIANCE_LIMIT_M_PER_N, read_prototype

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
SHELL_BLOCKS = re.findall(r"^```(?:sh|bash|shell|console)\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)
REMEDY = ROOT / "studies" / "prototypes" / "paper_remedy.toml"


def typed_commands() -> list[str]:
    blocks = [line for block in SHELL_BLOCKS for line in block.splitlines() if line.startswith("beamdesign ")]
    return blocks + re.findall(r"`(beamdesign [^`]+)`", README)


def test_the_first_two_blocks_run_the_main_job_and_the_tests() -> None:
    assert "pip install ." in SHELL_BLOCKS[0]
    assert "beamdesign run studies/prototype.toml --out" in SHELL_BLOCKS[0]
    assert ".[test]" in SHELL_BLOCKS[1]
    assert "python -m pytest" in SHELL_BLOCKS[1]


@pytest.mark.parametrize("typed", sorted({line for line in typed_commands() if "/" not in line.split()[1]}))
def test_every_command_and_option_exists(typed: str) -> None:
    name, *words = shlex.split(typed)[1:]
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    assert name in commands
    if hasattr(commands[name], "commands"):
        commands, (name, *words) = commands[name].commands, words
        assert name in commands
    options = {option for parameter in commands[name].params for option in parameter.opts}
    assert {word.partition("=")[0] for word in words if word.startswith("--")} <= options


def test_every_file_it_names_exists() -> None:
    named = set(re.findall(r"studies/[\w/]+\.\w+", README)) | {"LICENSE"}
    assert len(named) >= 4
    assert [name for name in named if not (ROOT / name).is_file()] == []


def test_the_python_example_uses_public_names() -> None:
    (example,) = re.findall(r"^```python\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)
    imported = [
        alias.name for node in ast.walk(ast.parse(example)) if isinstance(node, ast.ImportFrom) for alias in node.names
    ]
    also = re.search(r"Also there: (.*?)\. Records", README, flags=re.DOTALL)
    assert also is not None
    for name in imported + re.findall(r"`(\w+)`", also[1]):
        assert getattr(beamdesign, name) is not None


def test_the_finding_is_what_certify_says() -> None:
    certificate = certify(read_prototype(REMEDY), 0.0, 20.0)
    lower, upper = certificate.crossings
    assert f"below {lower.value:.3f} kg" in README.replace("\n", " ")
    assert f"oscillates at {lower.frequency_Hz:.0f} Hz" in README
    assert f"to {upper.value:.2f} kg" in README


def test_the_papers_breaks_reach_no_more_than_stated() -> None:
    remedy = read_prototype(REMEDY)
    assert isinstance(remedy.controller, Lag)
    gain = float(re.search(r"largest gain \((\d+) mA/V\)", README)[1])
    asked = [Asked("peak_sensitivity", 2.0), Asked("compliance", COMPLIANCE_LIMIT_M_PER_N, 3.75)]
    held = {}
    for milliamps in (gain, gain + 1):
        candidate = remedy.but(controller=remedy.controller.but(gain_A_per_V=1e-3 * milliamps))
        held[milliamps] = certify(candidate, 0.0, 6.8, asked)
    assert held[gain].holds
    assert held[gain].guaranteed is not None
    assert "| 3.8 Hz |" in README
    assert held[gain].guaranteed.bandwidth_Hz == pytest.approx(3.8, abs=0.05)
    assert [claim.holds for claim in held[gain + 1].claims] == [False, True]


def test_there_is_a_proved_loop_with_the_stated_figures_of_the_tuned_one() -> None:
    stated = re.search(r"\| tuned lag \| ([\d.]+) kg \| proved \| 2 \| ([\d.]+) Hz \|", README)
    assert stated is not None
    rig = read_prototype(REMEDY)
    inner = 1.886
    loop = rig.but(
        controller=Lag(gain_A_per_V=0.128, pole_Hz=1.283, zero_Hz=38.0),
        payload=rig.payload.but(inner_end_mass_kg=inner),
    )
    proved = certify(loop, 0.0, 6.8, [Asked("peak_sensitivity", 2.0)])
    assert proved.holds
    assert proved.guaranteed is not None
    assert stated.groups() == (f"{inner:.1f}", f"{proved.guaranteed.bandwidth_Hz:.1f}")
