"""What the shell offers to complete a word with; where nothing is offered it falls back on its own file names."""

from collections.abc import Iterator
from pathlib import Path

_DEPTH = 3
_MOST = 400
"""Entries of folders looked at, so that the shell never waits."""


def toml_files(incomplete: str) -> list[str]:
    """TOML files whose path begins as typed, those a few folders down included."""
    return sorted(str(path) for path in _below(incomplete) if path.suffix == ".toml")


def data_sets(incomplete: str) -> list[str]:
    """Folders with a dataset.toml whose path begins as typed."""
    return sorted(str(path.parent) for path in _below(incomplete) if path.name == "dataset.toml")


def templates(incomplete: str) -> list[tuple[str, str]]:
    """Names of templates, each with what it is for."""
    from beamdesign.templates import TEMPLATES

    return [(name, each.purpose) for name, each in TEMPLATES.items() if name.startswith(incomplete)]


def words(incomplete: str) -> list[str]:
    """Keys, tables, effects and topics that can be explained."""
    from beamdesign.report.reference import keys, words

    known = sorted({key.path for key in keys()}) if "." in incomplete else words()
    return [word for word in known if word.startswith(incomplete)]


def _below(incomplete: str) -> Iterator[Path]:
    typed = Path(incomplete)
    start = typed if incomplete.endswith(("/", "\\")) or not incomplete else typed.parent
    folders, looked = [(start, 0)], 0
    while folders and looked < _MOST:
        folder, depth = folders.pop(0)
        try:
            entries = sorted(folder.iterdir())
        except OSError:
            continue
        for path in entries:
            looked += 1
            if path.name.startswith(".") or not str(path).startswith(incomplete):
                continue
            if path.is_dir() and depth < _DEPTH:
                folders.append((path, depth + 1))
            elif path.is_file():
                yield path
