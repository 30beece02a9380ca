"""The law that gives the end of a link a stiffness: the servo's command moves by the force on the tip over it.

What pushes the tip is what bends the outer beam less what the actuator holds, F = K_m x - F_c + (M s^2 + b_m s) x, with
F_c = A p_L of a cylinder, and a load cell's on the nut of a screw. The first two terms, measured and behind a low-pass
H, are the estimate; beam and end mass keep their inertia, which the estimate would need to know. With C the servo's own
law and F_s its sensor's gain,

    current = K C(s) [command - sensor + (F_s / k_c) H(s) (K_m x - F_c)].

At rest the servo alone moves by G0 = 1 / (K_m + g K F_s) per newton, a current holding g = A K_q / K_pq, or K_t / h of
a screw, and follows a command but for K_m G0 of it, so that x / F = G0 + (1 - K_m G0) / k_c. k_c is chosen to make
that 1 / k_d.

What is proved of a link whose end has a commanded stiffness is tracking, passivity, contact, and what can be had.
"""

from dataclasses import dataclass
from math import inf, pi
from typing import Any, Literal

import numpy as np
from flint import fmpq

from beamdesign.controllers import SENSORS, Cascade, Observer, Sensed
from beamdesign.loop import Loop, close_loop
from beamdesign.plant.linear import Plant
from beamdesign.plant.members import paper_model
from beamdesign.polynomial import Affine, exact, nearest, text
from beamdesign.proofs.contact import (
    Band,
    Contact,
    Environment,
    Passivity,
    UnilateralContact,
    Wall,
    active_bands,
    destabilising_environment,
    guaranteed_command_band,
    guaranteed_stiffness_band,
    passivity,
    prove_contact,
    stiffest_wall,
    unilateral_contact,
)
from beamdesign.proofs.performance import least_of
from beamdesign.proofs.stability import StabilityMap, is_stable_over, stable_ranges
from beamdesign.proofs.writer import certificate, maybe_infinite, stated, texts
from beamdesign.prototype import Compliance, Prototype
from beamdesign.quantities import mass_range_text, rigs_in_words
from beamdesign.result import Result, finite, picked
from beamdesign.structure.lumped import figures


def sensors(prototype: Prototype) -> tuple[Sensed, ...]:
    """What such a law hears: the displacement, and what the actuator feels."""
    return tuple(name for name in SENSORS if name in (SENSORS[0], prototype.actuator.feels[0]))


def servo_stiffness(prototype: Prototype, servo: Cascade) -> float:
    """Static stiffness of the end under a servo alone, N/m: the most that it can be given; infinite without leakage."""
    given = figures(prototype)
    held = prototype.actuator.held_N_per_A(given)
    return given["outer_stiffness"] + held * servo.gain_A_per_V * given["sensor_gain"]


def least_gain(prototype: Prototype, end_stiffness: float) -> float:
    """The gain (A/V) at which a servo alone is as stiff as this (N/m); 0 where it need not be any."""
    given = figures(prototype)
    per_gain = prototype.actuator.held_N_per_A(given) * given["sensor_gain"]
    return max(end_stiffness - given["outer_stiffness"], 0.0) / per_gain


def commanded_compliance(prototype: Prototype, law: Compliance) -> float:
    """1 / k_c, m/N: by how much the command has to move per newton for the end to have its static stiffness.

    Raises:
        ValueError: where the servo alone is not as stiff as that.
    """
    alone = 1 / servo_stiffness(prototype, law.servo)
    if law.end_stiffness_N_per_m * alone > 1:
        raise ValueError(f"the servo alone holds {1 / alone:.4g} N/m, less than {law.end_stiffness_N_per_m:.4g} N/m")
    return (1 / law.end_stiffness_N_per_m - alone) / (1 - figures(prototype)["outer_stiffness"] * alone)


def controller_of(prototype: Prototype, law: Compliance) -> Observer:
    """The controller of displacement, force felt and command: states of the servo, then the estimated force in V.

    Raises:
        ValueError: where the servo alone is not as stiff as the end is to be.
    """
    given, servo = figures(prototype), law.servo
    compliance = commanded_compliance(prototype, law)
    cutoff = 2 * pi * law.force_filter_Hz
    a, b, c, d, _ = servo.but(gain_A_per_V=1.0).state_space()
    n = len(b)
    # The sensor's volts are command - e_1, so that K_m x = K_m (command - e_1) / F_s.
    spring = given["outer_stiffness"] * compliance
    force = given["sensor_gain"] * given.get("piston_area", 1.0) * compliance  # per what is felt of it
    whole = np.zeros((n + 1, n + 1))
    whole[:n, :n], whole[:n, n], whole[n, n] = a, b[:, 0], -cutoff
    inputs = np.zeros((n + 1, 2))
    inputs[:n, 0] = b[:, 0]
    inputs[n] = -cutoff * spring, cutoff * force
    commanded = np.zeros(n + 1)
    commanded[n] = cutoff * spring
    return Observer.of(servo.gain_A_per_V, sensors(prototype), whole, inputs, [*c, d[0]], [d[0], 0.0], commanded)


Need = Literal["passive", "wall", "stable"]
NEEDS: dict[Need, str] = {
    "passive": "passive at the tip",
    "wall": "stable against every wall",
    "stable": "stable for every end mass",
}
"""What contact has to be, in words, the most first; the walls are those of the range, and the last is in the air."""

SHARE = 0.1
"""How far the apparent stiffness may be from the one commanded, as a share of it, within its band."""

SOFTEST_N_PER_M = 1.0
"""Stiffness below which nothing is looked at."""


_STATED = """end_stiffness_N_per_m static_stiffness_N_per_m=static_N_per_m servo_stiffness_N_per_m=servo_N_per_m
    stiffness_band_Hz=band_Hz command_bandwidth_Hz=command_Hz command_at_rest peak_sensitivity stable
    passive=passivity.holds wall_stable=contact.holds stiffest_wall_N_per_m
    one_sided_wall_N_per_m=unilateral_contact.stiffness_N_per_m"""
_HELD = "mass_kg=mass stiffness_N_per_m=stiffness damping_N_s_per_m=damping"


@dataclass(frozen=True, repr=False)
class EndStiffness(Result):
    """What is proved of a law for every end mass of a range.

    Attributes:
        outer_end_mass_kg: that range.
        wall: the walls asked about.
        law: what the controller stands for; None where it is judged as it is.
        end_stiffness_N_per_m: that is commanded; of a controller that commands none, its own static one.
        stable: whether every end mass is stable without a wall.
        static_N_per_m: F / x at rest, from the exact polynomials.
        servo_N_per_m: static stiffness of the servo alone, the most that can be commanded.
        band_Hz: up to which the apparent stiffness is within `SHARE` of the commanded one; 0 where not even at rest.
        command_at_rest: share of its command that the free end moves by at rest.
        command_Hz: up to which the free end follows its command with 0.7071 of it or more; 0 where not stable.
        peak_sensitivity: bound of max |1 / (1 + L)|, L broken at the current; infinite where not stable.
        passivity: of the tip.
        destabilising_environment: a passive environment that makes a loop grow which is stable, but not passive.
        contact: with the walls asked about.
        stiffest_wall_N_per_m: up to which every wall of the range is stable with every end mass.
        unilateral_contact: one-sided springs that it may touch and leave, of no dashpot.
    """

    outer_end_mass_kg: tuple[float, float]
    wall: Wall
    law: Compliance | None
    end_stiffness_N_per_m: float
    stable: bool
    static_N_per_m: float
    servo_N_per_m: float
    band_Hz: float
    command_at_rest: float
    command_Hz: float
    peak_sensitivity: float
    passivity: Passivity
    destabilising_environment: Environment | None
    contact: Contact
    stiffest_wall_N_per_m: float
    unilateral_contact: UnilateralContact

    def meets(self, need: Need) -> bool:
        """Whether contact is proved to be as asked."""
        return self.stable and {"passive": self.passivity.holds, "wall": self.contact.holds, "stable": True}[need]

    @property
    def met(self) -> Need | None:
        """The most that contact is proved to be; None where the free end is not stable."""
        return next((need for need in NEEDS if self.meets(need)), None)

    @property
    def reason(self) -> str:
        """Why the free end is not stable; empty where it is."""
        return "" if self.stable else "the end is not stable without a wall"

    def to_dict(self) -> dict[str, Any]:
        """What a JSON file holds of it."""
        destabilising, witness = self.destabilising_environment, self.contact.witness
        return finite({
            "servo": None if self.law is None else self.law.servo.model_dump(),
            "force_filter_Hz": None if self.law is None else self.law.force_filter_Hz,
            **picked(self, _STATED),
            "active_bands": [picked(band, "low_Hz high_Hz sample_Hz") for band in self.passivity.bands],
            "destabilised_by": destabilising and picked(destabilising, _HELD),
            "wall_N_per_m": self.wall.stiffness,
            "wall_witness": witness and picked(witness, _HELD),
            "met": self.met,
        })  # fmt: skip


def sensed(prototype: Prototype) -> Plant:
    """The plant of a prototype as a compliant law senses it.

    Raises:
        InputError: for a prototype with effects.
    """
    return paper_model(prototype).plant(prototype.payload.inner_end_mass_kg, sensors(prototype))


def in_contact(closed: Loop, masses: tuple[fmpq, fmpq], wall: Wall, need: Need) -> bool:
    """Whether contact is proved to be as asked of the tip of a closed loop with every end mass (kg)."""
    if not is_stable_over(closed.characteristic, *masses):
        return False
    if need == "passive":
        return not active_bands(closed)
    return need != "wall" or prove_contact(closed, masses, wall).holds


def judge(prototype: Prototype, law: Compliance | None, masses_kg: tuple[float, float], wall: Wall) -> EndStiffness:
    """Prove what can be said of the end of a prototype over a range of outer end masses (kg), against a range of walls.

    Args:
        prototype: the rig.
        law: whose controller it has; None for the prototype's own as it is, whatever that is.
        masses_kg: range of mass on the outer tip.
        wall: range of walls.

    Raises:
        ValueError: where the servo alone is not as stiff as the end is to be; without a controller, or where the servo
            integrates, so that no force moves the end at rest.
        InputError: for a prototype with effects.
    """
    controller = prototype.own_controller if law is None else controller_of(prototype, law)
    plant = paper_model(prototype).plant(prototype.payload.inner_end_mass_kg, controller.sensed_law().sensors)
    closed, low, high = close_loop(plant, controller), exact(masses_kg[0]), exact(masses_kg[1])
    static = closed.at(0.0).static_stiffness()
    if static == inf:
        raise ValueError("no force moves the end at rest: its law integrates, or a valve without leakage")
    stable = is_stable_over(closed.characteristic, low, high)
    passive = passivity(closed, low, high)
    contact = prove_contact(closed, (low, high), wall)
    commanded = plant.displaced * controller.command_numerator() * exact(prototype.sensor.gain_V_per_m)
    stiffness = static if law is None else law.end_stiffness_N_per_m
    given = law or prototype.compliance
    alone = static if given is None else servo_stiffness(prototype, given.servo)
    return EndStiffness(
        masses_kg,
        wall,
        law,
        stiffness,
        stable,
        static,
        alone,
        guaranteed_stiffness_band(closed, exact(stiffness), exact(SHARE), low, high) if stable else 0.0,
        nearest(commanded(fmpq(0)) / closed.characteristic.constant(fmpq(0))),
        guaranteed_command_band(closed, commanded, low, high) if stable else 0.0,
        least_of("peak_sensitivity", closed, (low, high), goal=prototype.goal.peak_sensitivity) if stable else inf,
        passive,
        destabilising_environment(closed, passive.bands, low) if stable else None,
        contact,
        nearest(wall.stiffness[1]) if contact.holds else stiffest_wall(closed, (low, high), wall),
        unilateral_contact(closed, (low, high), wall.stiffness[1]),
    )


def stable_compliances(prototype: Prototype, servo: Cascade, force_filter_Hz: float, mass_kg: float) -> StabilityMap:
    """All ranges of 1 / k_c (m/N), from none to `SOFTEST_N_PER_M`, that are stable or not at one outer end mass.

    The characteristic polynomial is affine in 1 / k_c, so that all crossings are exact.

    Raises:
        InputError: for a prototype with effects.
    """
    family = over_compliance(prototype, servo, force_filter_Hz, exact(mass_kg))
    return stable_ranges(family, fmpq(0), exact(1 / SOFTEST_N_PER_M))


def over_compliance(prototype: Prototype, servo: Cascade, force_filter_Hz: float, mass: fmpq) -> Affine:
    """The characteristic polynomial at one outer end mass (kg), affine in 1 / k_c."""
    stiffness = min(max(servo_stiffness(prototype, servo) / 2, SOFTEST_N_PER_M), 1e6)
    law = Compliance(end_stiffness_N_per_m=stiffness, force_filter_Hz=force_filter_Hz, servo=servo)
    plant, controller = sensed(prototype), controller_of(prototype, law)
    deaf = controller.but(b=(*controller.b[:-1], (0.0,) * len(controller.sensors)))  # it hears of no force
    with_force, without = (close_loop(plant, one).against(mass) for one in (controller, deaf))
    return Affine(without, (with_force - without) / exact(commanded_compliance(prototype, law)))


def softest_N_per_m(
    prototype: Prototype, servo: Cascade, force_filter_Hz: float, masses_kg: tuple[float, float]
) -> float:
    """Static stiffness from which up to the servo's own every one is stable, at either end of the payload.

    Between the ends of the payload nothing is proved. Infinite where the servo alone is not stable.
    """
    outer, found = paper_model(prototype).figures["outer_stiffness"], 0.0
    alone = 1 / servo_stiffness(prototype, servo)
    for mass in masses_kg:
        first = stable_compliances(prototype, servo, force_filter_Hz, mass).ranges[0]
        if not first.stable or first.opens_at is not None:
            return inf
        found = max(found, 1 / (alone + (1 - outer * alone) * nearest(first.high)))
    return found


# What the certificate of the tip states, as tables of texts: passivity, contact, walls, a band.

CONTACT_NAME = "certificate.contact.toml"
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


def contact_text(prototype: Prototype, found: EndStiffness) -> str:
    """The certificate of the tip of a prototype with its controller."""
    asked = f"every outer end mass from {mass_range_text(found.outer_end_mass_kg)}"
    title = f"Contact of {prototype.name!r} with {asked}, for {rigs_in_words(0.0)}."
    body = {"outer_end_mass_kg": stated(found.outer_end_mass_kg)} | _tables(found)
    return certificate(KIND, prototype, body, "\n".join([title, *in_words(found)]), notes=NOTES)


def _tables(found: EndStiffness) -> Tables:
    passivity: Tables = {"passive": found.passivity.holds}
    if found.passivity.bands:
        passivity["band"] = [{"outer": _ends(band, 0), "inner": _ends(band, 1)} for band in found.passivity.bands]
    if found.destabilising_environment is not None:
        passivity["troublemaker"] = _environment(found.destabilising_environment)
    contact: Tables = {
        "stable": found.contact.holds,
        "stiffness_N_per_m": texts(found.wall.stiffness),
        "damping_N_s_per_m": texts(found.wall.damping),
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
    return {key: text(value) for key, value in picked(found, _HELD).items()}


def in_words(found: EndStiffness) -> list[str]:
    """What is proved of the tip, a line each."""
    wall = found.wall
    least, most = (float(value) for value in wall.stiffness)
    damped = ""
    if wall.damping[1] > 0:
        damped = f" with {float(wall.damping[0]):.15g} to {float(wall.damping[1]):.15g} N s/m"
    walls = f"walls from {least:.15g} to {most:.15g} N/m{damped}"
    lines = ["Proved: stable without a wall." if found.stable else "Refuted: stable without a wall."]
    if found.passivity.holds:
        lines.append("Proved: passive at the tip, so that no passive surroundings make it grow.")
    else:
        lines.append(f"Refuted: passive at the tip; {found.passivity.reason}.")
    if (other := found.destabilising_environment) is not None:
        lines.append(
            f"Proved: unstable with {float(other.mass):.15g} kg, held by {float(other.stiffness):.15g} N/m and"
            f" {float(other.damping):.15g} N s/m, fixed to the tip."
        )
    if found.contact.holds:
        lines.append(f"Proved: stable against {walls}.")
    else:
        reach = found.stiffest_wall_N_per_m
        lines.append(f"Refuted: stable against {walls}; {found.contact.reason}.")
        some = f"walls from {least:.15g}" if least > 0 else "walls up"
        lines.append(
            f"Proved: stable against {some} to {reach:.15g} N/m{damped}." if reach > 0 else "No wall is proved stable."
        )
    touched, up_to = found.unilateral_contact, found.unilateral_contact.stiffness_N_per_m
    if up_to > 0:
        lines.append(f"Proved: comes to rest at any one-sided spring up to {up_to:.15g} N/m, touching and letting go.")
    if not touched.whole or (wall.damping[1] > 0 and not found.passivity.holds):
        springs = "any walls" if up_to == 0 else "walls that damp" + " or are stiffer" * (not touched.whole)
        lines.append(f"Undecided: touching and letting go of {springs}; `beamdesign simulate` shows what they do.")
    return lines
