"""A compliant design carried to a prototype and its two certificates: of the loop, and of the tip as a port.

And what its controller does on rigs drawn from the tolerances of the prototype: decided rig by rig, sampled.
"""

from dataclasses import dataclass
from typing import Any

from beamdesign.json_text import picked
from beamdesign.loop import close_loop, tip
from beamdesign.polynomial import exact
from beamdesign.proofs.certificate import Asked, Certificate, goal_claims
from beamdesign.proofs.certifying import certify
from beamdesign.proofs.contact import Band, Environment, Wall
from beamdesign.proofs.writer import certificate, maybe_infinite, stated, texts
from beamdesign.prototype import Prototype
from beamdesign.rational import text
from beamdesign.synthesis.design_run import stating
from beamdesign.synthesis.end_stiffness import SHARE, EndStiffness, Need, controller_of, in_contact
from beamdesign.synthesis.stiffness_search import plants_drawn

CONTACT_NAME = "certificate.contact.toml"


@dataclass(frozen=True)
class CompliantPrototype:
    """What a compliant design comes to.

    Attributes:
        prototype: with its controller, what that stands for, and its guarantee.
        certificate: of the loop over the payload.
        contact: text of the certificate of the tip.
    """

    prototype: Prototype
    certificate: Certificate
    contact: str


def carried_out(
    prototype: Prototype, found: EndStiffness, masses_kg: tuple[float, float], wall: Wall
) -> CompliantPrototype:
    """Write the controller of a law into its prototype, and the proofs.

    Raises:
        ValueError: for a controller that was judged as it is.
    """
    law = found.law
    if law is None:
        raise ValueError("a controller that was judged as it is has no law to be carried out")
    rig = prototype.but(controller=controller_of(prototype, law), compliance=law, guarantee=None)
    asked = (Asked("peak_sensitivity", found.peak_sensitivity), *goal_claims(prototype.goal))
    proof = certify(rig, *masses_kg, asked)
    bandwidth = 0.0 if proof.guaranteed is None else proof.guaranteed.bandwidth_Hz
    made = stating(rig, proof.text, masses_kg, bandwidth, found.peak_sensitivity)
    return CompliantPrototype(made, proof, contact_text(rig, found, masses_kg, wall))


# What the certificate of the tip states, as tables of texts: passivity, contact, walls, a band.


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


def contact_text(prototype: Prototype, found: EndStiffness, masses_kg: tuple[float, float], wall: Wall) -> str:
    """The certificate of the tip of a prototype with its controller."""
    title = f"Contact of {prototype.name!r} with every outer end mass from {masses_kg[0]:g} to {masses_kg[1]:g} kg."
    body = {"outer_end_mass_kg": stated(masses_kg)} | _tables(found, wall)
    return certificate(KIND, prototype, body, "\n".join([title, *in_words(found, wall)]), notes=NOTES)


def _tables(found: EndStiffness, wall: Wall) -> Tables:
    passivity: Tables = {"passive": found.passivity.holds}
    if found.passivity.bands:
        passivity["band"] = [{"outer": _ends(band, 0), "inner": _ends(band, 1)} for band in found.passivity.bands]
    if found.destabilising_environment is not None:
        passivity["troublemaker"] = _environment(found.destabilising_environment)
    contact: Tables = {
        "stable": found.contact.holds,
        "stiffness_N_per_m": texts(wall.stiffness),
        "damping_N_s_per_m": texts(wall.damping),
    }
    if not found.contact.holds and found.contact.witness is not None and found.contact.exact:
        contact["witness"] = _environment(found.contact.witness)
    return {
        "stability": {"stable": found.stable},
        "passivity": passivity,
        "contact": contact,
        "bouncing": stated(picked(found.unilateral_contact, "stiffness_N_per_m multiplier_s")),
        "stiffness": {
            "end_stiffness_N_per_m": text(exact(found.end_stiffness_N_per_m)),
            "share": text(exact(SHARE)),
            "bandwidth_Hz": maybe_infinite(found.band_Hz),
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


# In words.


def in_words(found: EndStiffness, wall: Wall) -> list[str]:
    """What is proved of the tip, a line each."""
    least, most = (float(value) for value in wall.stiffness)
    walls = f"walls from {least:g} to {most:g} N/m"
    if wall.damping[1] > 0:
        walls += f" with {float(wall.damping[0]):g} to {float(wall.damping[1]):g} N s/m"
    lines = ["Proved: stable without a wall." if found.stable else "Refuted: stable without a wall."]
    if found.passivity.holds:
        lines.append("Proved: passive at the tip, so that no passive surroundings make it grow.")
    else:
        lines.append(f"Refuted: passive at the tip; {found.passivity.reason}.")
    if (other := found.destabilising_environment) is not None:
        lines.append(
            f"Proved: unstable with {float(other.mass):.4g} kg, held by {float(other.stiffness):.4g} N/m and"
            f" {float(other.damping):.4g} N s/m, fixed to the tip."
        )
    if found.contact.holds:
        lines.append(f"Proved: stable against {walls}.")
    else:
        reach = found.stiffest_wall_N_per_m
        lines.append(f"Refuted: stable against {walls}; {found.contact.reason}.")
        lines.append(f"Proved: stable against walls up to {reach:g} N/m." if reach > 0 else "No wall is proved stable.")
    touched = found.unilateral_contact
    if touched.stiffness_N_per_m > 0:
        lines.append(
            f"Proved: comes to rest at any one-sided wall up to {touched.stiffness_N_per_m:g} N/m, touching and"
            " letting go."
        )
    if not touched.whole:
        stiffer = "stiffer" if touched.stiffness_N_per_m > 0 else "any"
        lines.append(
            f"Undecided: touching and letting go of {stiffer} walls; `beamdesign simulate` shows what they do."
        )
    return lines


@dataclass(frozen=True)
class DrawnRig:
    """One rig with the controller of the prototype.

    Attributes:
        static_N_per_m: static stiffness of its end; not positive for one that cannot stay where it is.
        stable: whether it is with every end mass of the range.
        passive: whether it is stable and its tip is passive.
        wall: whether it is stable against every wall with every end mass.
    """

    static_N_per_m: float
    stable: bool
    passive: bool
    wall: bool


def drawn_rigs(prototype: Prototype, masses_kg: tuple[float, float], wall: Wall, count: int) -> tuple[DrawnRig, ...]:
    """Look at rigs whose figures are off by normal deviations, cut off at four.

    Args:
        prototype: with its compliant controller; none are drawn where it states no tolerances.
        masses_kg: range of mass on the outer tip.
        wall: that the tip may lean on.
        count: how many.
    """
    law, masses = prototype.controller, (exact(masses_kg[0]), exact(masses_kg[1]))
    assert law is not None
    ports = [tip(close_loop(plant, law)) for plant in plants_drawn(prototype, masses_kg[1], count, seed=1)]
    needs: tuple[Need, ...] = ("stable", "passive", "wall")
    return tuple(
        DrawnRig(port.static_stiffness(), *(in_contact(port, masses, wall, need) for need in needs)) for port in ports
    )


def drawn_in_words(rigs: tuple[DrawnRig, ...]) -> str:
    """How many of them are what, for a person."""
    least, most = min(rig.static_N_per_m for rig in rigs), max(rig.static_N_per_m for rig in rigs)
    counts = ", ".join(
        f"{sum(getattr(rig, name) for rig in rigs)} {words}"
        for name, words in (("stable", "stable"), ("passive", "passive"), ("wall", "stable against every wall"))
    )
    return (
        f"Sampled: of {len(rigs)} rigs drawn from the tolerances {counts};"
        f" static stiffness {least:.4g} to {most:.4g} N/m."
    )
