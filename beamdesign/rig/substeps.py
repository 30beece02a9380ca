"""How many integration steps a record of a rig takes; what would fill the machine is refused before it is begun."""

from collections.abc import Iterable
from math import ceil, log

import numpy as np

from beamdesign.records import InputError
from beamdesign.rig.assembly import Assembly
from beamdesign.rig.equilibrium import linearise

LONGEST_STEP_S = 1e-4
MOST_STEPS = 20_000_000
"""Of one record: half a minute, and about a gigabyte of inputs."""
_NUDGE = 1 + 1e-6  # on each figure, to find those that the fastest pole comes from

Place = tuple[np.ndarray, np.ndarray]
"""States and inputs about which a rig is linearised."""


def substeps_at(
    assembly: Assembly, places: Iterable[Place], parameters: np.ndarray, times: np.ndarray, steps_per_radian: float
) -> int:
    """Steps per sample: at most 0.1 ms each, and so many per radian of the fastest pole at any of the places.

    Args:
        assembly: the rig.
        places: where its poles are looked at.
        parameters: in the assembly's order.
        times: (N,) s, at least two, equally spaced but for their jitter.
        steps_per_radian: of the fastest pole.

    Raises:
        InputError: where the record would take more than `MOST_STEPS`, naming the figures that make it so stiff.
    """
    fastest, stiffest = 1.0, None
    for place in places:
        if (rate := _fastest_pole(assembly, place, parameters)) > fastest:
            fastest, stiffest = rate, place
    sample_s = (times[-1] - times[0]) / (len(times) - 1)
    needed = sample_s / min(LONGEST_STEP_S, 1 / (steps_per_radian * fastest)) - 1e-9
    if stiffest is not None:
        reason = _why(assembly, stiffest, parameters) if needed * len(times) > MOST_STEPS else ""
        refuse_too_many(needed * len(times), "(figures)", reason)
    return max(1, ceil(needed))


def refuse_too_many(steps: float, key: str, reason: str) -> None:
    """Refuse a record of too many steps.

    Raises:
        InputError: naming the key and the reason why so many are needed.
    """
    if not steps <= MOST_STEPS:
        words = f"{reason}, so that a record takes {steps:.3g} integration steps; {MOST_STEPS:.3g} are the most"
        raise InputError("simulation", [(key, words)])


def _fastest_pole(assembly: Assembly, place: Place, parameters: np.ndarray) -> float:
    """Modulus of the fastest pole, rad/s; infinite where the equations leave the numbers."""
    a = linearise(assembly, *place, parameters).a
    return float(np.abs(np.linalg.eigvals(a)).max()) if np.isfinite(a).all() else np.inf


def _why(assembly: Assembly, place: Place, parameters: np.ndarray) -> str:
    """The three figures that move the fastest pole most."""
    fastest, moved = _fastest_pole(assembly, place, parameters), []
    for k, (name, value) in enumerate(zip(assembly.parameters, parameters, strict=True)):
        nudged = parameters.copy()
        nudged[k] *= _NUDGE
        moved.append((abs(log(_fastest_pole(assembly, place, nudged) / fastest)), f"{name} {value:g}"))
    words = ", ".join(words for _, words in sorted(moved, reverse=True)[:3])
    return f"the fastest motion is of {fastest / (2 * np.pi):.3g} Hz, above all by {words} in SI"
