"""What a certificate over a box of parameters states, as tables of texts: expression, ranges, member, tree."""

from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import Any

from flint import fmpq

from beamdesign.proof.box_statement import Statement
from beamdesign.proof.rational import nearest, text
from beamdesign.proof.rig_family import Family
from beamdesign.proof.rig_tables import plain, stated, texts
from beamdesign.proof.writer import certificate
from beamdesign.prototype import Prototype

KIND, OF_NO_RIG = "beamdesign.box", "beamdesign.expression_box"
_NOTES = {
    "p": "The characteristic polynomial: a sum of products of the leaves below, which are polynomials in s.",
    "bound": "Leaves that stand in several places; p is affine in each pack.",
    "tree": "Cuts and leaves in prefix order: NAME halves a variable, w= cuts the frequency (rad/s), X,Y is the\n"
    "# direction across a separating line, inf means that the leading term dominates.",
    "delay": "exp(-s T) by its name in p, and the parameter T.",
    "range": "SI, frequencies in rad/s.",
    "member": "The member that is settled by itself.",
    "tolerance": "Relative standard deviations, as the prototype has them.",
}


def box_certificate(
    subject: Prototype | Family,
    family: Family,
    statement: Statement,
    member: Mapping[str, fmpq],
    tree: Sequence[str] | None,
) -> str:
    """Write the certificate.

    Args:
        subject: what it is about, a rig or an expression alone.
        family: the expression.
        statement: the same over the box.
        member: every parameter of the member that is settled exactly.
        tree: the marks of `zero_exclusion.pieces` that prove the whole box; None where the member refutes it.

    Raises:
        InputError: as `rig_tables`.
    """
    body: dict[str, Any] = {"stable": tree is not None, "p": family.p}
    body |= {"bound": [[*pack] for pack in family.bound]} if family.bound else {}
    if tree is not None:
        body["tree"] = wrap(" ".join(tree), 110, break_long_words=False, break_on_hyphens=False)
    groups = [{"name": name, "kind": kind, "members": [*members]} for name, kind, members in family.groups]
    found = {"leaf": family.leaves, "delay": family.delays, "group": groups}
    body |= {key: value for key, value in found.items() if value}
    body["range"] = {name: texts(ends) for name, ends in statement.parameters.items()}
    body["member"] = {name: text(member[name]) for name in statement.parameters}
    varying = {name: ends for name, ends in statement.parameters.items() if ends[0] < ends[1]}
    summary = [
        f"Certificate: the closed loop {family.name!r}"
        f" {'is stable for every member of' if tree is not None else 'is NOT stable throughout'} a box of",
        *(f"  {name} from {nearest(a):.7g} to {nearest(b):.7g}" for name, (a, b) in varying.items()),
    ]
    if isinstance(subject, Family):
        return certificate(OF_NO_RIG, subject.name, body, "\n".join(summary), notes=_NOTES)
    if deviations := {key: value for key, value in plain(subject.tolerance).items() if value}:
        body["tolerance"] = stated(deviations)
    heaviest = nearest(statement.parameters["outer_end_mass"][1])
    return certificate(KIND, subject, body, "\n".join(summary), heaviest, _NOTES, varying)
