"""Joint backlash: the rod has play where it meets the inner beam.

The rod is a mass between the oil and the joint; the joint bears on either side of its play like a damped spring.
"""

from typing import Any

import casadi as ca

from beamdesign.rig.effect import Effect, Linear, Parameter, Site, Span


def _force(signal: Any, site: Site) -> Any:
    own, half = site.parameter, site.parameter["play_m"] / 2
    apart = site.state["rod_m"] - site.port["inner_m"]
    pressed = apart - ca.fmin(ca.fmax(apart, -half), half)
    closing = site.state["rod_m_per_s"] - site.port["inner_m_per_s"]
    # Damping grows with the indentation and then stays, and a joint never pulls.
    full = ca.fmin(ca.fabs(pressed) / _INDENTATION_M, 1.0)
    force = own["stiffness_N_per_m"] * pressed + own["damping_N_s_per_m"] * full * closing
    force = ca.if_else(pressed > 0, ca.fmax(force, 0.0), ca.fmin(force, 0.0))
    site.rate["rod_m"] = site.state["rod_m_per_s"]
    site.rate["rod_m_per_s"] = (signal - force) / own["rod_mass_kg"]
    return force


_INDENTATION_M = 1e-6

_LEAST_SHARE = 0.1


def _bearing(signal: Any, site: Site) -> Any:
    """The force of a joint that has no play and bears with a share of its stiffness and damping."""
    own = site.parameter
    apart, closing = site.state["rod_m"] - site.port["inner_m"], site.state["rod_m_per_s"] - site.port["inner_m_per_s"]
    force = own["share"] * (own["stiffness_N_per_m"] * apart + own["damping_N_s_per_m"] * closing)
    site.rate["rod_m"] = site.state["rod_m_per_s"]
    site.rate["rod_m_per_s"] = (signal - force) / own["rod_mass_kg"]
    return force


EFFECT = Effect(
    name="joint_backlash",
    subsystem="structure",
    laws={
        "rod_m": lambda signal, site: site.state["rod_m"],
        "rod_m_per_s": lambda signal, site: site.state["rod_m_per_s"],
        "inner_force_N": _force,
    },
    parameters=(
        Parameter("play_m", 50e-6, 0.0, 2e-3, 50e-6, "free travel from one side of the joint to the other"),
        Parameter("stiffness_N_per_m", 5e7, 1e7, 2e8, 0.4, "of the joint once it bears"),
        Parameter("damping_N_s_per_m", 1e3, 0.0, 1e4, 0.6e3, "of the joint once it bears"),
        Parameter("rod_mass_kg", 0.3, 0.1, 1.0, 0.3, "piston and rod"),
    ),
    states=("rod_m", "rod_m_per_s"),
    source="K. H. Hunt and F. R. E. Crossley, J. Appl. Mech. 42 (1975) 440, contact whose damping needs indentation",
    linear=Linear(
        "a joint that bears, with its whole stiffness and damping down to a tenth of them",
        "the joint within its play, and limit cycles",
        laws={
            "rod_m": lambda signal, site: site.state["rod_m"],
            "rod_m_per_s": lambda signal, site: site.state["rod_m_per_s"],
            "inner_force_N": _bearing,
        },
        states=("rod_m", "rod_m_per_s"),
        figures={"share": lambda own, at: Span(_LEAST_SHARE, 1.0, 1.0)},
    ),
)
