"""The file that a certificate goes to: one of another prototype that stands there is put aside, not lost."""

import hashlib
import tomllib
from pathlib import Path
from typing import Any

from beamdesign.cli.output import default_file, say
from beamdesign.files import read_bytes, write_whole
from beamdesign.records import InputError

_TELLING = ("name", "rig", "controller", "effects", "arm")
"""Keys of a certificate that tell whose it is."""


def certificate_file(out: Path | None, default: str) -> Path:
    """Where a certificate is to go, asked before the work for it.

    Raises:
        InputError: where something stands there that is no certificate, or where no file can be written.
    """
    path = default_file(default) if out is None else out
    if path.exists():
        _stated(path, _standing(path))
    return path


def write_certificate(path: Path, text: str) -> None:
    """Write a certificate; one of another prototype that stands there gets a name with its digest, which is said.

    Raises:
        InputError: where something stands there that is no certificate.
    """
    if path.exists() and (standing := _standing(path)) != text.encode():
        older, new = _stated(path, standing), tomllib.loads(text)
        if any(older.get(key) != new.get(key) for key in _TELLING):
            aside = path.with_suffix(f".{hashlib.sha256(standing).hexdigest()[:8]}{path.suffix}")
            write_whole(aside, standing)
            say(f"the certificate of {older.get('name', 'another prototype')} that stood there is now {aside}")
    write_whole(path, text)


def _standing(path: Path) -> bytes:
    try:
        return read_bytes(path, _LARGEST)
    except OSError as error:
        raise InputError(path, [("(file)", f"{error.strerror}; name another file with --out")]) from error


_LARGEST = 10**9  # bytes: whatever stands there is looked at


def _stated(path: Path, standing: bytes) -> dict[str, Any]:
    try:
        table = tomllib.loads(standing.decode())
    except (ValueError, RecursionError):
        table = {}
    if not str(table.get("kind", "")).startswith("beamdesign."):
        raise InputError(path, [("(file)", "exists and is no certificate; name another file with --out")])
    return table
