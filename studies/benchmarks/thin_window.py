"""A rig with an unstable range of end masses thinner than any grid, built from the published one.

With 1 % structural damping, a 25 Hz sensor filter, 5.4 kg inside and a lag of 1/30 Hz the published rig has an unstable
range of outer end masses between two stable ones, which shrinks to nothing as the gain falls (a tangency). The gain at
which a given width is left is found by bisection on exact crossings; no grid could find it.
"""

from beamdesign import Prototype
from beamdesign.controllers import Lag
from beamdesign.loop import loop
from beamdesign.polynomial import exact
from beamdesign.proofs.stability import stable_ranges
from beamdesign.prototype import Payload

HIGH_KG = 20.0
_WIDE, _NONE = 0.015, 0.012  # A/V: gains with a wide unstable range, and with none


def lightly_damped(paper_remedy: Prototype, gain_A_per_V: float) -> Prototype:
    """The published rig with less damping and a slower sensor, and a lag with the given gain."""
    return paper_remedy.but(
        name="lightly_damped",
        outer_beam=paper_remedy.outer_beam.but(damping_ratio=0.01),
        inner_beam=paper_remedy.inner_beam.but(damping_ratio=0.01),
        sensor=paper_remedy.sensor.but(filter_Hz=25.0),
        controller=Lag(gain_A_per_V=gain_A_per_V, pole_Hz=1.0, zero_Hz=30.0),
        payload=Payload(inner_end_mass_kg=5.4),
    )


def unstable_width(prototype: Prototype) -> float:
    """Distance in kg between the two stable ranges; 0 where all masses are stable."""
    found = stable_ranges(loop(prototype).characteristic, exact(0.0), exact(HIGH_KG))
    if found.stable:
        return 0.0
    (_, closes), (opens, _) = found.stable_ranges
    return opens - closes


def narrowed(paper_remedy: Prototype, width_kg: float) -> Prototype:
    """The rig above with the gain, to 12 digits, whose unstable range is nearest to a given width."""
    none, wide = _NONE, _WIDE
    while (middle := float(f"{(none + wide) / 2:.12g}")) not in (none, wide):
        if unstable_width(lightly_damped(paper_remedy, middle)) < width_kg:
            none = middle
        else:
            wide = middle
    return lightly_damped(paper_remedy, wide)
