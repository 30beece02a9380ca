"""The loop of one plane of an arm at one payload, as tests look at it."""

from beamdesign.loop import LoopAtMass
from beamdesign.polynomial import exact
from beamdesign.proofs.arm import PlaneLoop


def at_tip(plane: PlaneLoop, payload: float) -> LoopAtMass:
    """The loop at one payload (kg), its compliance being that of the tip."""
    families = plane.loop_denominator, plane.loop_numerator, plane.tip, plane.effort_numerator
    return LoopAtMass(*(one.at(exact(payload)) for one in families))
