"""Certificates proved again from what they state, by nothing but this package and python-flint.

It imports nothing of the programme that writes certificates, and nothing of that imports it to prove. The loop is built
anew from the parameters, the controller and the elements that a certificate states; polynomials of a mass are settled
by another method than the prover's, boxes and Lyapunov functions by the same method in code of its own.

`python -m beamdesign.checker CERTIFICATE [PROTOTYPE]`: exit status 0 if every statement was proved, 1 if one was not,
2 if the file cannot be read.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any

from flint import ctx

from beamdesign.checker.about import about
from beamdesign.checker.prototype import differences, left_open
from beamdesign.checker.reading import LARGEST_BYTES, Unreadable, comments, read, sealed
from beamdesign.checker.rig import Rig

__all__ = ["KINDS", "VERSION", "Unreadable", "Verdict", "check"]

VERSION = 2
KINDS = {
    "beamdesign.mass_range": "mass_range",
}
"""Kinds of certificates, and the file of this package that proves what each states."""
PRECISION_BITS = 256


@dataclass(frozen=True)
class Verdict:
    """What came of a certificate.

    Attributes:
        kind: of the certificate.
        about: in words, the rig, its ranges, its effects and their sizes, as stated.
        proved: in words with their numbers, the statements that were proved.
        failed: those that were not.
        open: what was not looked at.
    """

    kind: str
    about: tuple[str, ...]
    proved: tuple[str, ...]
    failed: tuple[str, ...]
    open: tuple[str, ...]

    @property
    def valid(self) -> bool:
        """Whether every statement was proved, and there is one."""
        return bool(self.proved) and not self.failed


def check(source: str | Path, prototype: str | Path | Mapping[str, Any] | None = None) -> Verdict:
    """Prove a certificate again, and that it is of a prototype.

    Args:
        source: path of the certificate, or its text.
        prototype: path of a prototype.toml, or its table with every default filled in.

    Raises:
        Unreadable: where either cannot be read, or is beyond the limits.
    """
    data = source.encode() if isinstance(source, str) and "\n" in source else _bytes(Path(source))
    table, text = read(data)
    kind = table.word("kind", *KINDS)
    if (version := table.take("version")) != VERSION:
        remedy = "; make the certificate again" if version == 1 else ""
        raise Unreadable(f"format {str(version)[:20]} is not read here, only format {VERSION}{remedy}")
    room = import_module(f"{__name__}.{KINDS[kind]}")
    try:
        with ctx.workprec(PRECISION_BITS):
            rig = Rig(table)
            told = tuple(about(table, rig))
            results = [sealed(table, text), *rig.statements(), *room.statements(table, rig)]
            unread = (
                ["lines that begin with # are not read, so nothing in them is proved"] if any(comments(text)) else []
            )
            unread += rig.left_open()
            if prototype is not None:
                given = prototype if isinstance(prototype, Mapping) else _toml(Path(prototype))
                others = [f"not of this prototype: {words}" for words in differences(table, rig, given)]
                results += [(False, words) for words in others] or [(True, "it is of this prototype")]
                results += _named(given, data, source)
                unread += left_open(table, rig, given)
            table.done()
    except (ArithmeticError, RecursionError, MemoryError) as error:
        raise Unreadable(f"its figures make no loop: {error}") from error
    return Verdict(
        kind, told, *(tuple(w for p, w in results if p is wanted) for wanted in (True, False)), tuple(unread)
    )


def _bytes(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(LARGEST_BYTES + 1)
    except OSError as error:
        raise Unreadable(f"cannot be read: {error.strerror or error}") from error


def _toml(path: Path) -> Mapping[str, Any]:
    try:
        return tomllib.loads(_bytes(path).decode("utf-8"))
    except (UnicodeDecodeError, ValueError, RecursionError) as error:
        raise Unreadable(f"the prototype is not valid TOML: {str(error)[:200]}") from error


def _named(prototype: Mapping[str, Any], data: bytes, source: str | Path) -> list[tuple[bool, str]]:
    """Whether the guarantee that a prototype states rests on this certificate, where it says so."""
    guarantee = prototype.get("guarantee")
    if not isinstance(guarantee, dict):
        return []
    if guarantee.get("certificate_sha256") == sha256(data).hexdigest():
        return [(True, "the prototype's [guarantee] rests on this very file")]
    if isinstance(source, Path) and guarantee.get("certificate") == source.name:
        return [(False, "the prototype's [guarantee] rests on a file of this name with another content (sha256)")]
    return []
