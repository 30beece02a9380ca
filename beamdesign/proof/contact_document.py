"""The text of a certificate about the tip as a port, which `beamdesign.proof.replay_contact` proves again."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import isinf

from flint import fmpq, fmpq_poly

from beamdesign.polynomial import exact
from beamdesign.proof.bouncing import Bouncing
from beamdesign.proof.contact import Contact, Wall
from beamdesign.proof.document import controller_lines, quoted, remarks, rig_lines, sealed
from beamdesign.proof.passivity import Band, Environment, Passivity
from beamdesign.proof.rational import text
from beamdesign.prototype import Prototype
from beamdesign.tip import Tip

KIND = "beamdesign.contact"
VERSION = 1


@dataclass(frozen=True)
class Statements:
    """What a certificate of contact states of every end mass of a range.

    Attributes:
        masses: least and largest, kg.
        stable: whether every one is stable without a wall.
        passivity: of the tip.
        troublemaker: a passive environment that makes the loop grow with the least mass; None where none was found.
        wall: that the tip may touch.
        contact: whether every one is stable against every wall.
        bouncing: one-sided walls with which every one comes to rest.
        end_stiffness: that the end is to have, N/m.
        share: by which its apparent stiffness may differ, as a share.
        band_Hz: up to which it does not; 0 for none.
    """

    masses: tuple[fmpq, fmpq]
    stable: bool
    passivity: Passivity
    troublemaker: Environment | None
    wall: Wall
    contact: Contact
    bouncing: Bouncing
    end_stiffness: float
    share: float
    band_Hz: float


def document(prototype: Prototype, tip: Tip, stated: Statements, summary: str) -> str:
    """Write the certificate; `summary` is the result in words, put on top as a comment."""
    above = [
        *remarks(summary),
        "#",
        "# To prove it again: beamdesign certify --replay THIS-FILE  (proof/replay_contact.py and replay.py).",
        "# Lines that begin with # explain; the others are proved. All numbers are exact: decimals or quotients, as",
        "# text. Polynomials list the coefficients of s^0, s^1, ... The checksum is of the text without its own line.",
        "",
        f'kind = "{KIND}"',
        f"version = {VERSION}",
        "",
    ]
    below = [
        f"name = {quoted(prototype.name)}",
        f'low = "{text(stated.masses[0])}"',
        f'high = "{text(stated.masses[1])}"',
        "",
        *rig_lines(prototype),
        *controller_lines(prototype),
        *_polynomials(tip),
        "# Every end mass from low to high, kg, and no wall.",
        "[stability]",
        f"stable = {_bool(stated.stable)}",
        "",
        *_passivity(stated),
        *_contact(stated),
        *_bouncing(stated),
        *_stiffness(stated),
    ]
    return sealed(above, below)


def _polynomials(tip: Tip) -> Iterator[str]:
    """Both over one common factor, so that every coefficient is an integer."""
    factor = fmpq(tip.bare.denom()) * (tip.moved * tip.bare.denom()).denom()
    divisor = fmpq(0)
    for value in (tip.bare * factor).coeffs() + (tip.moved * factor).coeffs():
        divisor = fmpq(value.p.gcd(divisor.p))
    yield "# With m, k and b of an end mass, a spring and a dashpot at the tip, the characteristic polynomial is"
    yield "# bare + (m s^2 + b s + k) moved, and F / x = bare / moved + m s^2 + b s + k."
    yield "[polynomials]"
    for name, polynomial in (("bare", tip.bare), ("moved", tip.moved)):
        yield f"{name} = {_list(polynomial * (factor / divisor))}"
    yield ""


def _list(polynomial: fmpq_poly) -> str:
    return "[\n  " + ",\n  ".join(f'"{text(value)}"' for value in polynomial.coeffs()) + ",\n]"


def _passivity(stated: Statements) -> Iterator[str]:
    yield "# The mobility s x / F is positive real; if not, work comes out of the tip within the bands, everywhere"
    yield "# inside the inner ends and nowhere outside the outer ones of all bands. They are w^2 in (rad/s)^2."
    yield "[passivity]"
    yield f"passive = {_bool(stated.passivity.holds)}"
    if not stated.passivity.bands:
        yield "band = []"
    yield ""
    for band in stated.passivity.bands:
        yield "[[passivity.band]]"
        yield f"outer = {_ends(band, 0)}"
        yield f"inner = {_ends(band, 1)}"
        yield f"# from {band.low_Hz:.6g} to {band.high_Hz:.6g} Hz"
        yield ""
    if (found := stated.troublemaker) is not None:
        yield "# Fixed to the tip beside the least end mass, it makes the loop grow."
        yield "[passivity.troublemaker]"
        yield from _environment(found)
        yield ""


def _ends(band: Band, which: int) -> str:
    high = "infinite" if band.high is None else text(band.high[1 - which])
    return f'["{text(band.low[which])}", "{high}"]'


def _contact(stated: Statements) -> Iterator[str]:
    yield "# Every end mass against every wall."
    yield "[contact]"
    yield f"stable = {_bool(stated.contact.holds)}"
    for name, (low, high) in (
        ("stiffness_N_per_m", stated.wall.stiffness),
        ("damping_N_s_per_m", stated.wall.damping),
    ):
        yield f'{name} = ["{text(low)}", "{text(high)}"]'
    yield ""
    if not stated.contact.holds and stated.contact.witness is not None and stated.contact.exact:
        yield "[contact.witness]"
        yield from _environment(stated.contact.witness)
        yield ""


def _bouncing(stated: Statements) -> Iterator[str]:
    yield "# Every end mass comes to rest with any spring before the tip whose slope is from 0 to this stiffness, such"
    yield "# as one that presses on one side only: Popov's criterion with this multiplier. 0 is for none."
    yield "[bouncing]"
    yield f'stiffness_N_per_m = "{text(exact(stated.bouncing.stiffness_N_per_m))}"'
    yield f'multiplier_s = "{text(exact(stated.bouncing.multiplier_s))}"'
    yield ""


def _environment(found: Environment) -> Iterator[str]:
    yield f'mass_kg = "{text(found.mass)}"'
    yield f'stiffness_N_per_m = "{text(found.stiffness)}"'
    yield f'damping_N_s_per_m = "{text(found.damping)}"'


def _stiffness(stated: Statements) -> Iterator[str]:
    yield "# |F / x - end stiffness| is at most the share of it from rest up to a frequency, with every end mass."
    yield "[stiffness]"
    yield f'end_stiffness_N_per_m = "{text(exact(stated.end_stiffness))}"'
    yield f'share = "{text(exact(stated.share))}"'
    yield f'up_to_Hz = "{"infinite" if isinf(stated.band_Hz) else text(exact(stated.band_Hz))}"'
    yield ""


def _bool(value: bool) -> str:
    return "true" if value else "false"
