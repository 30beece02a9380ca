"""How the package is laid out: rooms import from rooms below them only, and files keep to a size that one can read."""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import beamdesign

ROOT = Path(beamdesign.__file__).parent
STAIRS = (
    "structure", "plant", "controllers", "proofs", "synthesis", "diagnosis", "report", "build", "validation", "sweep",
    "cli",
)  # fmt: skip
"""Rooms from the lowest up; modules at the top of the package are open to all of them."""
ALONE = ("checker", "docs", "templates")
LONGEST = 400


def imported(path: Path) -> Iterator[str]:
    """Modules and names that a file imports anywhere but for types alone."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    typing = [node for node in ast.walk(tree) if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
    left_out = {inside for node in typing for inside in ast.walk(node)}
    for node in set(ast.walk(tree)) - left_out:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@cache
def rooms_of(path: Path) -> set[str]:
    names = (name.split(".") for name in imported(path))
    return {steps[1] for steps in names if steps[0] == "beamdesign" and len(steps) > 1} & {*STAIRS, *ALONE}


def test_every_room_has_its_step():
    assert {path.name for path in ROOT.iterdir() if (path / "__init__.py").is_file()} == {*STAIRS, *ALONE}


@pytest.mark.parametrize("room", STAIRS)
def test_a_room_imports_from_below_only(room: str):
    above = set(STAIRS[STAIRS.index(room) + 1 :])
    files = [*(ROOT / room).rglob("*.py")]
    assert files
    assert {path.name: found for path in files if (found := rooms_of(path) & above)} == {}


def test_nobody_but_the_command_line_imports_the_checker():
    inside = ROOT / "checker"
    users = [path for path in ROOT.rglob("*.py") if inside not in path.parents and "checker" in rooms_of(path)]
    assert {path.parent.name for path in users} == {"cli"}


def test_files_can_be_read_in_one_go():
    lines = {path.relative_to(ROOT).as_posix(): path.read_text().count("\n") for path in ROOT.rglob("*.py")}
    assert {name: count for name, count in lines.items() if count > LONGEST} == {}
