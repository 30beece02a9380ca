"""Which code a result rests on: a digest of the source files that a function or a module can reach by imports.

Only those files count, so that a change of the command line or of a report leaves results valid. Data files beside the
modules (alloys, stock sizes) count too, and files of a user's own that make something known. And digests of folders.
"""

import ast
import hashlib
import traceback
from collections.abc import Mapping
from functools import cache
from linecache import getlines
from pathlib import Path
from typing import Any

_PACKAGE = "beamdesign"
_ROOT = Path(__file__).parent
_BLOCKS = ("body", "orelse", "finalbody", "handlers", "cases")
"""Where statements hold others."""

_OWN: list[tuple[Mapping[str, Any], str, str]] = []
"""Of what a program of a user's own has made known: the registry, its name there, and the program's file."""


def count_origin(registry: Mapping[str, Any], name: str) -> None:
    """Have digests count the file that called the caller of this, for as long as the name is in the registry."""
    file = traceback.extract_stack(limit=3)[0].filename
    if not Path(file).is_relative_to(_ROOT):
        _OWN.append((registry, name, file))


def code_digest(place: str) -> str:
    """SHA-256 over the package's source files that a function reaches, in the order of their names.

    Behind them come files outside of the package that have registered what is known, such as an effect.

    Args:
        place: see `sources`.

    Raises:
        ValueError: where there is no such module.
    """
    return _digest(place, tuple(sorted({"".join(getlines(file)) for known, name, file in _OWN if name in known})))


@cache
def _digest(place: str, own: tuple[str, ...]) -> str:
    digest = hashlib.sha256()
    files = sources(place)
    data = sorted({path for folder in {file.parent for file in files} for path in folder.glob("*.toml")})
    for path in (*files, *data):
        digest.update(path.relative_to(_ROOT).as_posix().encode() + b"\0")
        digest.update(path.read_bytes() + b"\0")
    for text in own:
        digest.update(text.encode() + b"\0")
    return digest.hexdigest()


def sources(place: str) -> list[Path]:
    """Source files that a module or a function reaches by imports inside the package, its own included, sorted.

    Imports inside functions count, but for a function not those of others in its own file. The package's own `__init__`
    only passes names on and is left out.

    Args:
        place: MODULE, or MODULE:FUNCTION, inside the package.

    Raises:
        ValueError: where there is no such module.
    """
    module, _, function = place.partition(":")
    if _file_of(module) is None:
        raise ValueError(f"no module {module}")
    found: set[Path] = set()
    waiting = [module, *(engines(place) if function else [])]
    while waiting:
        name = waiting.pop()
        path = _file_of(name)
        if path is None or path in found or path == _ROOT / "__init__.py":
            continue
        found.add(path)
        waiting += _imported_by(path) if name != module or not function else []
        while "." in (name := name.rpartition(".")[0]):  # a package's __init__ runs before its modules
            waiting.append(name)
    return sorted(found)


def engines(place: str) -> list[str]:
    """Modules that a function needs: what its file imports for all, and what itself does."""
    module, _, function = place.partition(":")
    path = _file_of(module)
    assert path is not None
    body = ast.parse(path.read_bytes()).body
    own = [node for node in body if isinstance(node, ast.FunctionDef) and node.name == function]
    top = [node for node in body if isinstance(node, ast.Import | ast.ImportFrom)]
    return [name for name in _imported(path, ast.Module([*top, *own], [])) if _file_of(name) is not None]


@cache
def _imported_by(path: Path) -> list[str]:
    return _imported(path, ast.parse(path.read_bytes()))


def _file_of(name: str) -> Path | None:
    """The file of a module of this package; None for a name inside a module and for other packages."""
    head, *steps = name.split(".")
    if head != _PACKAGE:
        return None
    path = _ROOT.joinpath(*steps)
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()), None)


def _imported(path: Path, tree: ast.Module) -> list[str]:
    """Names that a tree of a file's statements imports when it runs, for types alone not among them."""
    names, waiting = list[str](), list[Any](tree.body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"):
            # of what a statement holds its statements alone: an expression imports nothing
            waiting += [inner for part in _BLOCKS for inner in getattr(node, part, ())]
    if "importlib" in names:  # modules named at run time, such as the effects: any of those beside it
        folder = ".".join((_PACKAGE, *path.parent.relative_to(_ROOT).parts))
        names += [f"{folder}.{other.stem}" for other in path.parent.glob("*.py")]
    return names


def folder_digest(folder: Path) -> str:
    """SHA-256 of the names and the bytes of all files in a folder."""
    sha = hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        sha.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return sha.hexdigest()
