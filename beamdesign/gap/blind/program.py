"""Which sources an answer depends on, as a digest: what has not changed need not be done again."""

import ast
import hashlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import numpy as np

import beamdesign

_ROOT = Path(beamdesign.__file__).parent
_FOUND_BY_BEING_THERE = {"beamdesign.rig.effects"}  # packages that import whatever lies in them


@cache
def program_digest(module: str) -> str:
    """SHA-256 of a module and of every module of this program that it imports, directly or not.

    Imports inside functions count as well.

    Args:
        module: dotted name, such as `beamdesign.gap.fitting.search`.
    """
    sha = hashlib.sha256(np.__version__.encode())
    for path in sources(module):
        sha.update(path.relative_to(_ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return sha.hexdigest()


def sources(module: str) -> tuple[Path, ...]:
    """Files of a module and of all that it imports, sorted.

    Raises:
        ValueError: where there is no such module.
    """
    first = _file(module)
    if first is None:
        raise ValueError(f"no module {module}")
    found = {first}
    left = [module]
    while left:
        name = left.pop()
        path = _file(name)
        assert path is not None
        for other in (*_imported(path), *_members(name)):
            file = _file(other)
            if file is not None and file not in found:
                found.add(file)
                left.append(other)
    return tuple(sorted(found))


def _file(module: str) -> Path | None:
    parts = module.split(".")
    if parts[0] != "beamdesign":
        return None
    path = _ROOT.joinpath(*parts[1:])
    for candidate in (path / "__init__.py", path.with_suffix(".py")):
        if candidate.is_file():
            return candidate
    return None


def _imported(path: Path) -> Iterable[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def _members(module: str) -> list[str]:
    if module not in _FOUND_BY_BEING_THERE:
        return []
    file = _file(module)
    assert file is not None
    return [f"{module}.{path.stem}" for path in file.parent.glob("*.py") if path.stem != "__init__"]
