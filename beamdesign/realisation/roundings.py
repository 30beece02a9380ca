"""What rounding can do to the loop: bounds that hold for every record, and what is to be expected.

A rounding is an input of the linear loop that never exceeds half a step. However the roundings fall, an output then
departs from that of the same law without rounding by at most the sum of absolute impulse responses times half a step
each. No limit cycle of the rounded loop about a point of rest can be larger. It holds as long as no limit is reached.
"""

from dataclasses import dataclass

import numpy as np

from beamdesign.realisation.loop import RealisedLoop, rounded_loop
from beamdesign.realisation.peaks import l1_norms, l2_norms
from beamdesign.realisation.realise import FLOAT_STEP, Realisation, floats


@dataclass(frozen=True)
class RoundingEffect:
    """Of all roundings together, at one outer end mass, at sample times.

    Attributes:
        displacement_m: largest departure of the tip.
        current_A: of the current.
        error_V: of the error.
        expected_displacement_m: root mean square, were the roundings independent and evenly spread.
        expected_current_A: likewise.
    """

    displacement_m: float
    current_A: float
    error_V: float
    expected_displacement_m: float
    expected_current_A: float


def half_steps(realisation: Realisation) -> np.ndarray:
    """(m,) bound of every rounding of a realised law, V, m, Pa or A, for readings within full scale."""
    law = realisation.linear
    if realisation.word_length is not None:
        finer = {"signal": 0, "state": realisation.state_extra}
        places = [
            realisation.current_places if kind == "current" else realisation.places[k] + finer[kind]
            for _, kind, k in law.roundings
        ]
        return 2.0 ** -np.array(places, dtype=float) / 2
    # Floats round by a share of what they hold, which the roundings add to: v = u (|R_e| full scale + |R_v| v).
    n, m, k = len(law.states), len(law.roundings), len(law.heard)
    rounded = floats(law.rounded)
    inputs = np.hstack([floats(law.b), floats(law.f)])
    norms = l1_norms(floats(law.a), inputs, rounded[:, :n], rounded[:, n:])
    share = FLOAT_STEP / 2
    found = np.linalg.solve(np.eye(m) - share * norms[:, k:], share * norms[:, :k] @ np.array(realisation.full_scales))
    return np.asarray(found)


def rounding_effect(loop: RealisedLoop, mass_kg: float) -> RoundingEffect:
    """The effect of rounding on the loop at one outer end mass.

    Raises:
        ValueError: where the loop is not stable.
    """
    closed, halves = rounded_loop(loop, mass_kg), half_steps(loop.realisation)
    most = l1_norms(closed.a, closed.b[:, 1:], closed.c, closed.d[:, 1:]) @ halves
    spread = l2_norms(closed.a, closed.b[:, 1:] * halves, closed.c, closed.d[:, 1:] * halves)
    expected = np.sqrt((spread**2).sum(axis=1) / 3)  # an even spread over +-h has the variance h^2 / 3
    return RoundingEffect(float(most[0]), float(most[1]), float(most[2]), float(expected[0]), float(expected[1]))
