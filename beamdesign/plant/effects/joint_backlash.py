"""Joint backlash: the rod has play where it meets the inner beam.

The rod is a mass between the oil and the joint; the joint bears on either side of its play like a damped spring.
"""

from typing import Any

import casadi as ca
from flint import fmpq

from beamdesign.plant.effects import Effect, Elements, Exact, Figures, Law, Linear, Parameter, Site, Span, limited


def _force(signal: Any, site: Site) -> Any:
    own, apart = site.parameter, site.state["rod_m"] - site.port["inner_m"]
    pressed = apart - limited(apart, own["play_m"] / 2)
    closing = site.state["rod_m_per_s"] - site.port["inner_m_per_s"]
    # Damping grows with the indentation and then stays, and a joint never pulls.
    full = ca.fmin(ca.fabs(pressed) / _INDENTATION_M, 1.0)
    force = own["stiffness_N_per_m"] * pressed + own["damping_N_s_per_m"] * full * closing
    force = ca.if_else(pressed > 0, ca.fmax(force, 0.0), ca.fmin(force, 0.0))
    return _carried(signal, force, site)


def _carried(signal: Any, force: Any, site: Site) -> Any:
    """Move the rod between the actuator's force and the joint's; gives what moves the inner tip.

    What else pushes that tip does not push the rod. Whoever weighed the inner beam with the rod on it has counted the
    rod's mass already. That share of it is taken off the inner mass again, by the force that gives a lighter tip its
    acceleration.
    """
    own, figure, driving = site.parameter, site.figure, -site.port["actuator_force_N"]
    site.rate["rod_m"] = site.state["rod_m_per_s"]
    site.rate["rod_m_per_s"] = (driving - force) / own["rod_mass_kg"]
    force += signal - driving
    mass, reaction = figure["inner_mass"] + figure["inner_end_mass"], site.port["inner_reaction_N"]
    counted = own["counted_share"] * own["rod_mass_kg"]
    return force + (force - reaction) * counted / (mass - counted)


def _impossible(own: Figures, figure: Figures) -> str:
    counted, mass = own["counted_share"] * own["rod_mass_kg"], figure["inner_mass"]
    words = f"counts {counted:g} kg of the rod in the inner beam's effective mass, which is {mass:g} kg in all"
    return f"{words}: counted_share times rod_mass_kg must be less" if counted >= mass else ""


_INDENTATION_M = 1e-6

_LEAST_SHARE = 0.1


def _bearing(signal: Any, site: Site) -> Any:
    """The force of a joint that has no play and bears with a share of its stiffness and damping."""
    own = site.parameter
    apart, closing = site.state["rod_m"] - site.port["inner_m"], site.state["rod_m_per_s"] - site.port["inner_m_per_s"]
    return _carried(
        signal, own["share"] * (own["stiffness_N_per_m"] * apart + own["damping_N_s_per_m"] * closing), site
    )


def _elements(own: Exact, figure: Exact) -> Elements:
    joint = tuple(own["share"] * own[key] for key in ("stiffness_N_per_m", "damping_N_s_per_m"))
    counted = own["counted_share"] * own["rod_mass_kg"]
    one, none = fmpq(1), fmpq(0)
    return Elements(
        impedances=(
            ({"joint": one, "inner": -one}, joint),
            ({"joint": one}, (none, none, own["rod_mass_kg"])),
            ({"inner": one}, (none, none, -counted)),
        ),
        points={"rod": {"joint": one, "inner": -one}},
    )


_ROD: dict[str, Law] = {
    "rod_m": lambda signal, site: site.state["rod_m"],
    "rod_m_per_s": lambda signal, site: site.state["rod_m_per_s"],
}

EFFECT = Effect(
    name="joint_backlash",
    subsystem="structure",
    laws={**_ROD, "inner_force_N": _force},
    parameters=(
        Parameter("play_m", 50e-6, 0.0, 2e-3, 50e-6, "free travel from one side of the joint to the other"),
        Parameter("stiffness_N_per_m", 5e7, 1e7, 4e8, 0.7, "of the joint once it bears", "stiffness"),
        Parameter("damping_N_s_per_m", 1e3, 0.0, 1e4, 0.6e3, "of the joint once it bears", "stiffness"),
        Parameter("rod_mass_kg", 0.3, 0.1, 1.0, 0.3, "piston and rod", "mass"),
        Parameter("counted_share", 0.0, 0.0, 1.0, 0.7, "of the rod's mass that the inner beam's effective mass holds"),
    ),
    states=tuple(_ROD),
    source="K. H. Hunt and F. R. E. Crossley, J. Appl. Mech. 42 (1975) 440, contact whose damping needs indentation",
    linear=Linear(
        "a joint that bears, with its whole stiffness and damping down to a tenth of them",
        "the joint within its play, and limit cycles",
        laws={**_ROD, "inner_force_N": _bearing},
        states=tuple(_ROD),
        figures={"share": lambda own, at: Span(_LEAST_SHARE, 1.0, 1.0)},
        elements=_elements,
        near_rest="stability",
    ),
    impossible=_impossible,
)


def _flanks(signal: Any, site: Site) -> Any:
    """The force of a screw on a nut that has play: a flank presses, and only where it touches."""
    stretch = site.port["stretch_m"]
    pressed = stretch - limited(stretch, site.parameter["play_m"] / 2)
    force = signal - site.figure["screw_stiffness"] * (stretch - pressed)
    return ca.if_else(pressed > 0, ca.fmax(force, 0.0), ca.if_else(pressed < 0, ca.fmin(force, 0.0), 0.0))


NUT = Effect(
    name="joint_backlash_nut",
    meaning="""Backlash of a ball screw's nut: lost motion between screw and nut, which adds no mass of its own.

        Within its play nothing holds the nut; on either side a flank bears with the stiffness and damping of the screw,
        and never pulls. A nut with preload has none until wear has taken it up.""",
    subsystem="structure",
    laws={"thread_N": _flanks},
    parameters=(Parameter("play_m", 50e-6, 0.0, 2e-3, 50e-6, "free travel of the nut from flank to flank"),),
    source="M. Nordin and P.-O. Gutman, Automatica 38 (2002) 1633, section 2: a shaft with play as a dead zone",
    linear=Linear(
        "a nut that bears, with the whole stiffness and damping of its screw down to a tenth of them",
        "the nut within its play, and limit cycles",
        laws={"thread_N": lambda signal, site: signal * site.parameter["share"]},
        figures={"share": lambda own, at: Span(_LEAST_SHARE, 1.0, 1.0)},
        elements=lambda own, figure: Elements(oil=own["share"]),
        near_rest="stability",
    ),
    realises="joint_backlash",
)
