"""Second bending mode of the outer beam, in parallel with the first at the tip.

The tip moves by the sum of both modes, the forces and the end mass at the tip act on both.
"""

from math import pi, sqrt
from typing import Any

from flint import fmpq

from beamdesign.plant.effects import TWO_PI, Effect, Elements, Exact, Figures, Linear, Parameter, Site


def _end_mass(signal: Any, site: Site) -> Any:
    """Share the end mass between the modes: their accelerations add up to that of the tip."""
    figure, own, port = site.figure, site.parameter, site.port
    frequency = 2 * pi * own["frequency_Hz"]
    stiffness = figure["outer_stiffness"] / own["compliance_share"]
    mass = stiffness / frequency**2
    reaction = stiffness * site.state["mode_m"]
    reaction += 2 * own["damping_ratio"] * stiffness / frequency * site.state["mode_m_per_s"]
    first = (port["outer_force_N"] - port["outer_reaction_N"]) / figure["outer_mass"]
    second = (port["outer_force_N"] - reaction) / mass
    carried = figure["outer_end_mass"] * (first + second)
    carried /= 1 + figure["outer_end_mass"] * (1 / figure["outer_mass"] + 1 / mass)
    site.rate["mode_m"] = site.state["mode_m_per_s"]
    site.rate["mode_m_per_s"] = second - carried / mass
    return carried


def _elements(own: Exact, figure: Exact) -> Elements:
    stiffness, frequency = figure["outer_stiffness"] / own["compliance_share"], TWO_PI * own["frequency_Hz"]
    resists = stiffness, 2 * own["damping_ratio"] * stiffness / frequency, stiffness / frequency**2
    second = {"second": fmpq(1)}
    return Elements(((second, resists),), {"tip": second})


_LEAST_RATIO = 2.5
"""Of the frequencies of a beam's second and first bending mode: a uniform one has 6.27 (Blevins), one whose depth
tapers to a tenth 3.2, and one that is twenty times as soft from 0.56 to 0.75 of its length 2.9."""
_LEAST_PART = 1.5
"""Of the second mode's static compliance over the first one's, times the fourth power of that ratio: 39 of a uniform
beam and 9.7 of one that is next to massless beside its tip. Of 20,000 beams, drawn with tapers, soft places, lumps and
heavy tips, 1 % have less; what swings at 4 times the frequency of a beam twenty times as heavy has 1.0."""


def _unlike(own: Figures, figure: Figures) -> str:
    ratio = 2 * pi * own["frequency_Hz"] / sqrt(figure["outer_stiffness"] / figure["outer_mass"])
    words = f"at {ratio:.2g} times the frequency of the outer beam's first mode no second bending mode of a beam lies"
    if ratio >= _LEAST_RATIO:
        words += f" with {own['compliance_share']:.2g} of that one's compliance or less"
    part = own["compliance_share"] * ratio**4
    return f"{words}, but what swings on its tip may" if ratio < _LEAST_RATIO or part < _LEAST_PART else ""


EFFECT = Effect(
    name="second_beam_mode",
    subsystem="structure",
    laws={
        "outer_tip_m": lambda signal, site: signal + site.state["mode_m"],
        "outer_tip_m_per_s": lambda signal, site: signal + site.state["mode_m_per_s"],
        "outer_end_mass_N": _end_mass,
    },
    parameters=(
        Parameter("frequency_Hz", 300.0, 70.0, 1500.0, 0.4, "of the mode without payload", "frequency"),
        Parameter("compliance_share", 0.02, 1e-4, 0.3, 0.8, "static compliance of the mode at the tip over 1/K_m"),
        Parameter("damping_ratio", 0.02, 1e-3, 0.2, 0.6, "of the mode alone"),
    ),
    states=("mode_m", "mode_m_per_s"),
    source="modal superposition; R. D. Blevins, Formulas for Natural Frequency and Mode Shape",
    linear=Linear("as it is", elements=_elements),
    unlike=_unlike,
)
