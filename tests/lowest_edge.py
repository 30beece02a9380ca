"""The lowest gain at which a rig begins to oscillate, and the limit cycles whose curve begins there."""

from collections.abc import Sequence

from beamdesign import Prototype
from beamdesign.loop import CriticalGain
from beamdesign.plant.harmonic_balance import HARMONICS
from beamdesign.plant.limit_cycles import LimitCycle, StabilityEdge, edges
from beamdesign.plant.limit_cycles import limit_cycles as along


def lowest_edge(prototype: Prototype, outer_end_mass: float = 0.0, preload: float = 0.0) -> StabilityEdge:
    """Of a rig linearised where it rests under a preload in N."""
    return next(edge for edge in edges(prototype, outer_end_mass, preload) if edge.begins)


def linear_critical_gain(prototype: Prototype, outer_end_mass: float = 0.0, preload: float = 0.0) -> CriticalGain:
    return lowest_edge(prototype, outer_end_mass, preload).critical


def limit_cycles(
    prototype: Prototype, amplitudes: Sequence[float], outer_end_mass: float = 0.0, harmonics: int = HARMONICS
) -> tuple[LimitCycle, ...]:
    """From the lowest edge, of the rig without effects where these close no loop at rest."""
    rigs = (prototype, prototype.but(effects={}))
    begin = next(edge for rig in rigs for edge in edges(rig, outer_end_mass) if edge.begins)
    return tuple(along(prototype, begin, amplitudes, outer_end_mass, harmonics))
