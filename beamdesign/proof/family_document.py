"""The text of a certificate over the linear members of a prototype, which `beamdesign.proof.replay_members` reads."""

import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from flint import fmpq

from beamdesign.members import LinearFamily, Member, member_elements
from beamdesign.polynomial import exact
from beamdesign.proof.document import (
    claim_lines,
    controller_lines,
    polynomial_lines,
    quoted,
    remarks,
    rig_lines,
    sealed,
)
from beamdesign.proof.performance import Claim
from beamdesign.proof.rational import shortened, simple_between, text
from beamdesign.proof.rectangle import Rectangle
from beamdesign.proof.stability import Range, StabilityMap
from beamdesign.prototype import Prototype
from beamdesign.rig.effect import Elements, Weights
from beamdesign.rig.parameters import effect_parameters_of

KIND = "beamdesign.members"
VERSION = 1

_DIGITS = 12


@dataclass(frozen=True)
class Proved:
    """A member with the rectangle over which it is to be stable, and that over which it is to perform, if it is."""

    member: Member
    stable: Rectangle
    performing: Rectangle | None


def document(
    prototype: Prototype,
    found: LinearFamily,
    proved: Sequence[Proved],
    stability: StabilityMap,
    claims: Sequence[Claim],
    summary: str,
) -> str:
    """Write the certificate.

    Args:
        prototype: whose figures it states.
        found: its family.
        proved: the members' loops.
        stability: what all of them have in common.
        claims: statements about all of them, held or refuted.
        summary: the result in words, put on top as a comment.
    """
    above = [
        *remarks(summary),
        "#",
        "# To prove it again: beamdesign certify --replay THIS-FILE  (proof/replay_members.py and replay.py).",
        "# Lines that begin with # explain; the others are proved. All numbers are exact: decimals or quotients, as",
        "# text. Polynomials list the coefficients of s^0, s^1, ... The checksum is of the text without its own line.",
        "",
        f'kind = "{KIND}"',
        f"version = {VERSION}",
        "",
    ]
    below = [
        f"name = {quoted(prototype.name)}",
        'parameter = "outer_end_mass_kg"',
        f'low = "{text(stability.low)}"',
        f'high = "{text(stability.high)}"',
        "",
        *rig_lines(prototype),
        *controller_lines(prototype),
        *effect_lines(prototype),
        *(line for part in proved for line in _member(part)),
        *_stability(stability),
        *(line for claim in claims for line in claim_lines(claim)),
    ]
    return sealed(above, below)


def effect_lines(prototype: Prototype) -> Iterator[str]:
    """The tables of the effects' parameters; none without effects."""
    if not prototype.effects:
        return
    yield "# Parameters of the effects."
    yield "[effects]"
    for name, table in effect_parameters_of(prototype).items():
        yield ""
        yield f"[effects.{name}]"
        for key, value in table.items():
            yield f'{key} = "{text(exact(value))}"'
    yield ""


def _member(part: Proved) -> Iterator[str]:
    """A member: its frozen figures, the factors on its gain, and its polynomials at a factor of one."""
    yield "[[member]]"
    for key, rectangle in (("gain", part.stable), ("performance_gain", part.performing)):
        if rectangle is not None:
            yield f'{key} = ["{text(rectangle.least)}", "{text(rectangle.most)}"]'
    yield ""
    for name, table in part.member.frozen.items():
        yield f"[member.frozen.{name}]"
        for key, value in table.items():
            yield f'{key} = "{text(exact(value))}"'
        yield ""
    yield from _elements(member_elements(part.member))
    yield from polynomial_lines(part.stable.loop, "member.polynomials")


def stated_member(member: Member) -> dict[str, Any]:
    """What the table of a member states of it beside its polynomials: its gains, and what effects add to the rig."""
    elements = tomllib.loads("\n".join(_elements(member_elements(member))))["member"]["elements"]
    asked = {"gain": member.gain, "performance_gain": member.performance}
    gains = {key: [text(exact(span.low)), text(exact(span.high))] for key, span in asked.items() if span is not None}
    return gains | {"elements": elements}


def _elements(found: Elements) -> Iterator[str]:
    """What effects add to the parts of the rig: springs, dashpots and masses, points, factors, filters."""

    def weights(table: Weights) -> str:
        return f"{{ {', '.join(f'{name} = {quoted(_exactly(value))}' for name, value in table.items())} }}"

    def coefficients(values: Sequence[fmpq]) -> str:
        return f"[{', '.join(quoted(_exactly(value)) for value in values)}]"

    yield "# What the effects are here beside the rig's own parts, as `beamdesign.rig.effect.Elements` explains."
    yield "[member.elements]"
    for key in ("oil", "spool", "asymmetry"):
        yield f"{key} = {quoted(_exactly(getattr(found, key)))}"
    yield ""
    if found.points:
        yield "[member.elements.points]"
        yield from (f"{point} = {weights(table)}" for point, table in found.points.items())
        yield ""
    for motion, resists in found.impedances:
        yield "[[member.elements.impedance]]"
        yield f"motion = {weights(motion)}"
        yield f"resists = {coefficients(resists)}"
        yield ""
    for numerator, denominator in found.volts:
        yield "[[member.elements.volts]]"
        yield f"numerator = {coefficients(numerator)}"
        yield f"denominator = {coefficients(denominator)}"
        yield ""


def _exactly(value: fmpq) -> str:
    return str(value.p) if value.q == 1 else f"{value.p}/{value.q}"


def _stability(stability: StabilityMap) -> Iterator[str]:
    yield "# Masses at which every member is stable at every factor on its gain."
    yield "[stability]"
    yield f"stable = {'true' if stability.stable else 'false'}"
    stable = [part for part in stability.ranges if part.stable]
    if not stable:
        yield "range = []"
    yield ""
    for part in stable:
        low, high = _closed(part)
        yield "[[stability.range]]"
        yield f'low = "{text(low)}"'
        yield f'high = "{text(high)}"'
        yield ""


def _closed(part: Range) -> tuple[fmpq, fmpq]:
    """A closed range of short decimals inside a range that is open where it ends at a crossing."""
    low, high = part.low, part.high
    if part.opens_at is not None:
        low = shortened(low, _DIGITS, up=True)
        low = low if part.low < low < part.sample else simple_between(part.low, part.sample)
    if part.closes_at is not None:
        high = shortened(high, _DIGITS)
        high = high if part.sample < high < part.high else simple_between(part.sample, part.high)
    return low, high
