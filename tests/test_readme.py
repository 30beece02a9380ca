"""What README and pages tell a reader to type exists, and the figures they quote are what the tool computes."""

import ast
import re
import shlex
from decimal import ROUND_FLOOR, Decimal
from pathlib import Path
from typing import Any

import click
import pytest
import typer.main

import beamdesign
from beamdesign import certify, check, docs, read_prototype
from beamdesign.cli import app
from beamdesign.controllers import KINDS, Lag
from beamdesign.plant.effects import library, register
from beamdesign.proofs.certificate import Asked
from beamdesign.prototype import COMPLIANCE_LIMIT_M_PER_N

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "beamdesign" / "docs"
PAGES = {path.name: path.read_text(encoding="utf-8") for path in [ROOT / "README.md", *DOCS.glob("*.md")]}
README = PAGES["README.md"]
WRITTEN = {
    "prototype.toml", "certificate.toml", "dataset.toml", "study.toml", "link.toml",
}  # fmt: skip
"""Files that commands write or a reader has, wherever they stand."""
REMEDY = ROOT / "studies" / "prototypes" / "paper_remedy.toml"


def shell_blocks(text: str) -> list[str]:
    return re.findall(r"^```(?:sh|bash|shell|console)\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)


def python_blocks(text: str) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)


def typed_commands(text: str) -> list[str]:
    blocks = [line for block in shell_blocks(text) for line in block.splitlines() if line.startswith("beamdesign ")]
    return blocks + re.findall(r"`(beamdesign [^`]+)`", text)


def anchors(text: str) -> set[str]:
    headings = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def commands() -> dict[str, click.Command]:
    found: dict[str, click.Command] = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    return found


def test_the_first_two_blocks_run_the_main_job_and_the_tests() -> None:
    first, second, *_ = shell_blocks(README)
    assert "pip install ." in first
    assert "beamdesign run studies/prototype.toml --out" in first
    assert ".[test]" in second
    assert "python -m pytest" in second


@pytest.mark.parametrize(
    ("page", "typed"),
    sorted({(page, line) for page, text in PAGES.items() for line in typed_commands(text)}),
)
def test_every_command_and_option_exists(page: str, typed: str) -> None:
    name, *words = shlex.split(typed)[1:]
    known = commands()
    assert name in known
    if hasattr(known[name], "commands"):
        known, (name, *words) = known[name].commands, words
        assert name in known
    options = {option for parameter in known[name].params for option in parameter.opts}
    assert {word.partition("=")[0] for word in words if word.startswith("--")} <= options


def test_every_command_stands_in_the_readme() -> None:
    rows = [shlex.split(line)[1] for line in re.findall(r"^\| `(beamdesign [^`]+)`", README, flags=re.MULTILINE)]
    assert set(rows) == set(commands())


@pytest.mark.parametrize("page", sorted(PAGES))
def test_every_file_it_names_exists(page: str) -> None:
    text = PAGES[page]
    named = set(re.findall(r"(?<![\w/])(?:studies|tests|beamdesign)/[\w/]+\.(?:\w+)", text))
    named |= {f"studies/prototypes/{name}" for name in re.findall(r"`(\w+\.toml)`", text) if name not in WRITTEN}
    if page == "README.md":
        named.add("LICENSE")
        assert len(named) >= 4
    assert [name for name in sorted(named) if not (ROOT / name).is_file()] == []


@pytest.mark.parametrize("page", sorted(PAGES))
def test_every_link_leads_somewhere(page: str) -> None:
    here = ROOT if page == "README.md" else DOCS
    links = re.findall(r"\]\(([^)\s]+)\)", PAGES[page])
    for link in links:
        file, _, anchor = link.partition("#")
        target = here / file if file else here / page
        assert target.is_file(), link
        assert not anchor or anchor in anchors(target.read_text(encoding="utf-8")), link
    if page == "README.md":
        assert {f"beamdesign/docs/{topic}.md" for topic in docs.topics()} <= set(links)


@pytest.mark.parametrize("page", sorted(set(PAGES) - {"reference.md"}))
@pytest.mark.parametrize("figure", ["bandwidth", "peak sensitivity"])
def test_a_figure_is_defined_where_it_is_named_first(page: str, figure: str) -> None:
    used = re.search(rf"(\*?)\b{figure}\b(\*?)", " ".join(PAGES[page].split()), re.IGNORECASE)
    assert used is not None or page != "README.md"
    assert used is None or used.groups() == ("*", "*")


def test_every_page_begins_with_its_title() -> None:
    assert set(docs.topics()) == {name.removesuffix(".md") for name in PAGES} - {"README"}
    for topic, title in docs.topics().items():
        assert docs.pages()[topic].startswith(f"# {title}\n\n")
    with pytest.raises(KeyError):
        docs.pages()["../../README"]


def test_the_python_example_uses_public_names() -> None:
    (example,) = python_blocks(README)
    imported = [
        alias.name for node in ast.walk(ast.parse(example)) if isinstance(node, ast.ImportFrom) for alias in node.names
    ]
    section = README.split("## From Python")[1].split("\n## ")[0]
    named = re.findall(r"`(\w+)`", section.split("```")[2])
    assert {"certify_box", "predict"} <= set(named)
    for name in imported + named:
        assert getattr(beamdesign, name) is not None


def test_what_is_added_by_the_examples_is_used_by_a_proof() -> None:
    effect, controller = python_blocks(PAGES["adding.md"])
    effects, kinds = set(library()), set(KINDS)
    try:
        held: dict[str, Any] = {}
        exec(compile(effect, "adding.md", "exec", dont_inherit=True), held)
        register(held["EFFECT"])
        exec(compile(controller, "adding.md", "exec", dont_inherit=True), {"__name__": "adding"})
        (added,), (kind,) = set(library()) - effects, set(KINDS) - kinds
        rig = read_prototype(REMEDY)
        breaks = {"pole_Hz": 1.75, "zero_Hz": 26.0, "far_pole_Hz": 2000.0, "far_zero_Hz": 8000.0}
        law = {"kind": kind, "gain_A_per_V": 0.03, **breaks}
        found = certify(rig.but(effects={added: {}}, controller=law, guarantee=None), 2.0, 2.2)
        assert found.stable
        assert check(found.text).valid
    finally:
        for name in set(library()) - effects:
            del library()[name]
        for name in set(KINDS) - kinds:
            del KINDS[name]


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
    stated = re.search(r"\| tuned lag, of exactly these[^|]*\| ([\d.]+) kg \| proved \| 2 \| ([\d.]+) Hz \|", README)
    assert stated is not None
    rig = read_prototype(REMEDY)
    inner = 2.017972
    loop = rig.but(
        controller=Lag(gain_A_per_V=0.127318, pole_Hz=1.26014, zero_Hz=37.5755),
        payload=rig.payload.but(inner_end_mass_kg=inner),
    )
    proved = certify(loop, 0.0, 6.8, [Asked("peak_sensitivity", 2.0)])
    assert proved.holds
    assert proved.guaranteed is not None
    assert proved.guaranteed.peak_over_passive <= 1
    proved_Hz = Decimal(proved.guaranteed.bandwidth_Hz).quantize(Decimal("0.1"), ROUND_FLOOR)
    assert stated.groups() == (f"{inner:.1f}", str(proved_Hz))
