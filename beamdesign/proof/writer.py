"""The text of every certificate: TOML that a person can read and `beamdesign.checker` proves again."""

import hashlib
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import tomli_w
from flint import fmpq

from beamdesign.proof.rig_tables import rig_tables
from beamdesign.prototype import Prototype
from beamdesign.spelling import one_line

VERSION = 2
_NOTES = {
    "rig": "The lumped figures of the model, end masses not included; damping is that of fixed dashpots. SI.",
    "controller": "From error volts to current; numerators and denominator list the coefficients of s^0, s^1, ...",
    "effect": "What stands for an effect: springs, dashpots, masses, filters; numbers may be times a span.",
    "loop": "The closed loop p0 + m p1 over the end mass m, in kg, at every combination of the ends of spans.",
    "stability": "Over the outer end mass. Roots cross the imaginary axis at the crossings and nowhere else.",
}


def certificate(
    kind: str,
    subject: Prototype | str,
    body: Mapping[str, Any],
    summary: str,
    largest_outer_end_mass: float | None = None,
    notes: Mapping[str, str] | None = None,
    varying: Mapping[str, tuple[fmpq, fmpq]] = MappingProxyType({}),
) -> str:
    """Write a certificate.

    Args:
        kind: of `beamdesign.checker.KINDS`.
        subject: the rig that it is about, or the name of what is no rig.
        body: what it states of it: nested tables, with every number as text or a whole number.
        summary: the result in words, put on top as a comment.
        largest_outer_end_mass: kg, as `rig_tables` takes it.
        notes: what to say above a table, by its name.
        varying: figures that are not at their values, as `rig_tables` takes them.
    """
    head = [
        *(f"# {one_line(line)}".rstrip() for line in summary.splitlines()),
        "#",
        "# To prove it again, with python-flint alone: python -m beamdesign.checker THIS-FILE [PROTOTYPE]",
        "# Lines that begin with # explain and prove nothing. All numbers are exact: decimals or quotients, as text.",
        "# The checksum is of the text without its own line.",
        "",
        f'kind = "{kind}"',
        f"version = {VERSION}",
        "",
    ]
    tables: dict[str, Any] = {"name": subject if isinstance(subject, str) else subject.name}
    if not isinstance(subject, str):
        tables |= rig_tables(subject, largest_outer_end_mass, varying)
    tables |= body
    lines = tomli_w.dumps(tables).splitlines(keepends=True)
    words = {**_NOTES, **(notes or {})}
    for name, note in words.items():
        heads = [k for k, line in enumerate(lines) if line.startswith((f"[{name}]", f"[[{name}]]", f"{name} = "))]
        if heads:
            lines[heads[0]] = f"# {note}\n{lines[heads[0]]}"
    above, below = "\n".join(head), "".join(lines)
    return f'{above}sha256 = "{hashlib.sha256((above + below).encode()).hexdigest()}"\n{below}'
