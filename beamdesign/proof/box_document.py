"""The text of a certificate over a box of parameters; `beamdesign.proof.replay_box` proves it again."""

from collections.abc import Iterator, Mapping, Sequence
from textwrap import wrap
from typing import Any

import tomli_w
from flint import fmpq

from beamdesign.proof.document import sealed
from beamdesign.proof.rational import nearest, text
from beamdesign.proof.replay_box import KIND, VERSION, Statement
from beamdesign.proof.rig_family import Family


def box_document(family: Family, statement: Statement, member: Mapping[str, fmpq], tree: Sequence[str] | None) -> str:
    """Write the certificate.

    Args:
        family: the expression.
        statement: the same over the box.
        member: every parameter of the member that is settled exactly.
        tree: the marks of `replay_box.pieces` that prove the whole box; None where the member refutes it.
    """
    varying = [name for name, (low, high) in statement.parameters.items() if low < high]
    claim = "is stable for every member of" if tree is not None else "is NOT stable throughout"
    above = [
        f"# Certificate: the closed loop {family.name!r} {claim} a box in",
        *(f"# {line}" for line in wrap(", ".join(varying) or "no parameters", 110)),
        *(
            f"#   {name} from {nearest(a):.7g} to {nearest(b):.7g}"
            for name, (a, b) in statement.parameters.items()
            if a < b
        ),
        "#",
        "# To prove it again with python-flint alone: python replay_box.py THIS-FILE",
        "# (beamdesign/proof/replay_box.py).",
        "# Lines that begin with # explain; the others are proved. All numbers are exact: decimals or quotients, as",
        "# text. SI units, frequencies in rad/s. The checksum is of the text without its own line.",
        "",
        f'kind = "{KIND}"',
        f"version = {VERSION}",
        "",
    ]
    return sealed(above, list(_body(family, statement, member, tree)))


def expression_table(family: Family) -> dict[str, Any]:
    """The entries of a certificate that make up its expression, as they are read back."""
    groups = [{"name": name, "kind": kind, "members": [*members]} for name, kind, members in family.groups]
    bound = [[*pack] for pack in family.bound]
    found = {"p": family.p, "bound": bound, "leaf": family.leaves, "delay": family.delays, "group": groups}
    return {key: value for key, value in found.items() if value}


def _body(
    family: Family, statement: Statement, member: Mapping[str, fmpq], tree: Sequence[str] | None
) -> Iterator[str]:
    yield _entry("name", family.name)
    yield f"stable = {'false' if tree is None else 'true'}"
    yield ""
    yield "# The characteristic polynomial: a sum of products of the leaves below, which are polynomials in s."
    yield _entry("p", family.p)
    if family.bound:
        yield "# Leaves that stand in several places; p is affine in each pack."
        yield f"bound = [{', '.join('[' + ', '.join(map(_quoted, pack)) + ']' for pack in family.bound)}]"
    if tree is not None:
        yield "# Cuts and leaves in prefix order: NAME halves a variable, w= cuts the frequency (rad/s), X,Y is the"
        yield "# direction across a separating line, inf means that the leading term dominates."
        yield "tree = ["
        yield from (
            f'  "{line}",' for line in wrap(" ".join(tree), 110, break_long_words=False, break_on_hyphens=False)
        )
        yield "]"
    yield ""
    for title, table in (("leaf", family.leaves), ("delay", family.delays)):
        if table:
            if title == "delay":
                yield "# exp(-s T) by its name in p, and the parameter T."
            yield f"[{title}]"
            yield from (_entry(key, value) for key, value in table.items())
            yield ""
    for name, kind, members in family.groups:
        yield "[[group]]"
        yield _entry("name", name)
        yield _entry("kind", kind)
        yield f"members = [{', '.join(map(_quoted, members))}]"
        yield ""
    yield "[range]"
    yield from (f'{name} = ["{text(low)}", "{text(high)}"]' for name, (low, high) in statement.parameters.items())
    yield ""
    yield f"# The member that {'is' if tree is not None else 'is not'} stable."
    yield "[member]"
    yield from (f'{name} = "{text(member[name])}"' for name in statement.parameters)
    yield ""


def _quoted(value: str) -> str:
    return _entry("value", value).removeprefix("value = ")


def _entry(key: str, value: str) -> str:
    return tomli_w.dumps({key: value}).rstrip("\n")
