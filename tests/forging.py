"""Certificates altered on purpose, under a checksum that is right again."""

import hashlib
import tomllib
from typing import Any

import tomli_w


def resealed(table: dict[str, Any]) -> str:
    """The text of a certificate's table with the checksum that belongs to it."""
    body = tomli_w.dumps({key: value for key, value in table.items() if key != "sha256"})
    return f'sha256 = "{hashlib.sha256(body.encode()).hexdigest()}"\n{body}'


def altered(text: str, place: tuple[str | int, ...], value: object) -> str:
    """A certificate with another entry at one place."""
    table: Any = tomllib.loads(text)
    inner = table
    for key in place[:-1]:
        inner = inner[key]
    assert inner[place[-1]] != value
    inner[place[-1]] = value
    return resealed(table)
