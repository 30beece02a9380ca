"""Starts of air in the oil from an oil spring that a simpler fit has softened.

Without air, nothing but the spring can give way as much as the records say, however far it is from its tolerance. That
is how soft the oil is about rest; which air and supply make it so is one equation for two unknowns. Draws of both at
once hardly meet it, and a fit that begins with another resonance than that of the records ends at it.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy.optimize import brentq

from beamdesign.gap.fitting.unknowns import HEED_SUPPLY, SUPPLY, Unknown
from beamdesign.rig.effects.entrained_air import POLYTROPIC, bulk_ratio

SPRING = "oil_stiffness"
_SUPPLIES = (-2.2, -1.8, -1.4, -1.0, -0.6, 0.0)  # in prior standard deviations
_MOST = 0.9  # of the largest air fraction
_HARDLY = 0.97  # of the stiffness believed: nothing that needs air


def softened(
    unknowns: Sequence[Unknown], base: np.ndarray, new: Sequence[int], known: Mapping[str, float]
) -> Iterator[np.ndarray]:
    """Starts with the spring as believed and as much air as softens it, about rest, to what is known of it.

    Args:
        unknowns: of the hypothesis.
        base: (K,) z of all that is not air.
        new: positions of unknowns of which nothing is known yet.
        known: SI values of a simpler fit.

    Yields:
        (K,) z for each of several supplies; none without new air, or where the spring is not softer than believed.
    """
    at = {u.name: k for k, u in enumerate(unknowns)}
    spring = unknowns[at[SPRING]] if SPRING in at else None
    names = [name for name in HEED_SUPPLY if at.get(f"{name}.air_fraction") in new]
    if spring is None or spring.kind != "figure" or SPRING not in known or len(names) != 1 or at[SUPPLY] not in new:
        return
    target = known[SPRING] / spring.nominal
    if not target < _HARDLY:
        return
    own = {q: unknowns[k] for q in ("air_fraction", "oil_bulk_modulus_Pa") for k in (at[f"{names[0]}.{q}"],)}
    exponent = at.get(f"{names[0]}.polytropic_exponent")
    given = POLYTROPIC if exponent is None else unknowns[exponent].nominal
    air, modulus = own["air_fraction"], own["oil_bulk_modulus_Pa"].nominal
    for step in _SUPPLIES:
        pressure = unknowns[at[SUPPLY]].value(step) / 2

        def beyond(fraction: float, pressure: float = pressure) -> float:
            return float(bulk_ratio(pressure, fraction, modulus, given)) - target

        most = _MOST * air.high
        if beyond(air.low) <= 0:
            continue
        fraction = most if beyond(most) >= 0 else float(brentq(beyond, air.low, most, xtol=1e-6))
        z = base.copy()
        # What air cannot do under this pressure, the spring has to.
        z[at[SPRING]] = spring.z(known[SPRING] / (beyond(fraction) + target))
        z[at[SUPPLY]], z[at[f"{names[0]}.air_fraction"]] = step, air.z(fraction)
        yield z
