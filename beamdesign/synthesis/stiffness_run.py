"""A compliant design carried to a prototype and its two certificates: of the loop, and of the tip as a port.

And what its controller does on rigs drawn from the tolerances of the prototype: decided rig by rig, sampled.
"""

from dataclasses import dataclass

from beamdesign.loop import close_loop, tip
from beamdesign.polynomial import exact
from beamdesign.proofs.certificate import Asked, Certificate, goal_claims
from beamdesign.proofs.certifying import certify
from beamdesign.proofs.contact import KIND, NOTES, Statements, Wall, contact_tables
from beamdesign.proofs.writer import certificate as written
from beamdesign.prototype import Compliance, Prototype
from beamdesign.synthesis.design_run import stating
from beamdesign.synthesis.end_stiffness import SHARE, EndStiffness, Need, controller_of, in_contact, sensed
from beamdesign.synthesis.rig_spread import rig_spread

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
    rig = prototype.but(
        controller=controller_of(prototype, law),
        compliance=Compliance(
            end_stiffness_N_per_m=law.end_stiffness_N_per_m, force_filter_Hz=law.force_filter_Hz, servo=law.servo
        ),
        guarantee=None,
    )
    asked = (Asked("peak_sensitivity", found.peak_sensitivity), *goal_claims(prototype.goal))
    certificate = certify(rig, *masses_kg, asked)
    bandwidth = 0.0 if certificate.guaranteed is None else certificate.guaranteed.bandwidth_Hz
    made = stating(rig, certificate, masses_kg, bandwidth, found.peak_sensitivity)
    return CompliantPrototype(made, certificate, contact_text(rig, found, masses_kg, wall))


def contact_text(prototype: Prototype, found: EndStiffness, masses_kg: tuple[float, float], wall: Wall) -> str:
    """The certificate of the tip of a prototype with its controller."""
    stated = Statements(
        (exact(masses_kg[0]), exact(masses_kg[1])),
        found.stable,
        found.passivity,
        found.troublemaker,
        wall,
        found.contact,
        found.bouncing,
        found.end_stiffness_N_per_m,
        SHARE,
        found.band_Hz,
    )
    summary = "\n".join(
        [
            f"Contact of {prototype.name!r} with every outer end mass from {masses_kg[0]:g} to {masses_kg[1]:g} kg.",
            *in_words(found, wall),
        ]
    )
    return written(KIND, prototype, contact_tables(stated), summary, notes=NOTES)


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
    if (other := found.troublemaker) is not None:
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
    touched = found.bouncing
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


def drawn_rigs(
    prototype: Prototype, masses_kg: tuple[float, float], wall: Wall, count: int, seed: int = 1
) -> tuple[DrawnRig, ...]:
    """Look at rigs whose figures are off by normal deviations, cut off at four.

    Args:
        prototype: with its compliant controller; none are drawn where it states no tolerances.
        masses_kg: range of mass on the outer tip.
        wall: that the tip may lean on.
        count: how many.
        seed: of the draw.
    """
    law = prototype.controller
    assert law is not None
    if not any(prototype.tolerance.model_dump().values()):
        return ()
    spread = rig_spread(prototype, masses_kg[1], 1.0)
    masses = (exact(masses_kg[0]), exact(masses_kg[1]))
    ports = [tip(close_loop(sensed(spread.rig(z)), law)) for z in spread.drawn(count, seed)]
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
