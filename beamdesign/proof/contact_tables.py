"""What a certificate about the tip as a port states, as tables of texts: passivity, contact, walls, a band."""

from dataclasses import dataclass
from typing import Any

from flint import fmpq

from beamdesign.polynomial import exact
from beamdesign.proof.bouncing import Bouncing
from beamdesign.proof.contact import Contact, Wall
from beamdesign.proof.mass_tables import finite
from beamdesign.proof.passivity import Band, Environment, Passivity
from beamdesign.proof.rational import text
from beamdesign.proof.rig_tables import texts

KIND = "beamdesign.contact"
NOTES = {
    "stability": "Every end mass, and no wall.",
    "passivity": "The mobility s x / F is positive real; if not, work comes out of the tip everywhere inside the inner"
    " ends of the bands and nowhere outside the outer ones of all: w^2 in (rad/s)^2.",
    "passivity.troublemaker": "Fixed to the tip beside the least end mass, it makes the loop grow.",
    "contact": "Every end mass against every wall.",
    "bouncing": "Every end mass comes to rest with any spring before the tip whose slope is from 0 to this stiffness,"
    " such as one that presses on one side only: Popov's criterion with this multiplier. 0 is for none.",
    "stiffness": "|F / x - end stiffness| is at most the share of it from rest up to a frequency, with every end mass.",
}

Tables = dict[str, Any]


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


def contact_tables(stated: Statements) -> Tables:
    """The body of the certificate."""
    passivity: Tables = {"passive": stated.passivity.holds}
    if stated.passivity.bands:
        passivity["band"] = [{"outer": _ends(band, 0), "inner": _ends(band, 1)} for band in stated.passivity.bands]
    if stated.troublemaker is not None:
        passivity["troublemaker"] = _environment(stated.troublemaker)
    contact: Tables = {
        "stable": stated.contact.holds,
        "stiffness_N_per_m": texts(stated.wall.stiffness),
        "damping_N_s_per_m": texts(stated.wall.damping),
    }
    if not stated.contact.holds and stated.contact.witness is not None and stated.contact.exact:
        contact["witness"] = _environment(stated.contact.witness)
    bouncing, stiffness = stated.bouncing, text(exact(stated.end_stiffness))
    return {
        "outer_end_mass_kg": texts(stated.masses),
        "stability": {"stable": stated.stable},
        "passivity": passivity,
        "contact": contact,
        "bouncing": {
            "stiffness_N_per_m": text(exact(bouncing.stiffness_N_per_m)),
            "multiplier_s": text(exact(bouncing.multiplier_s)),
        },
        "stiffness": {
            "end_stiffness_N_per_m": stiffness,
            "share": text(exact(stated.share)),
            "bandwidth_Hz": finite(stated.band_Hz),
        },
    }


def _ends(band: Band, which: int) -> list[str]:
    return [text(band.low[which]), "infinite" if band.high is None else text(band.high[1 - which])]


def _environment(found: Environment) -> Tables:
    return {
        "mass_kg": text(found.mass),
        "stiffness_N_per_m": text(found.stiffness),
        "damping_N_s_per_m": text(found.damping),
    }
