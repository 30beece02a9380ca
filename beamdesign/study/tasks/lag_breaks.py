"""Task `lag_breaks`: the exact zero frequencies with which a lag is stable for every payload, at its pole and gain."""

from typing import Any

from beamdesign.proof.stable_zeros import stable_zeros
from beamdesign.prototype import Prototype
from beamdesign.records import InputError
from beamdesign.study.answer import Answer
from beamdesign.study.tasks.certify import payload_range


def compute(prototype: Prototype, options: Any) -> Answer:
    """Stable intervals of the zero over the payload range; the prototype's own zero only tells whether it is inside."""
    law = prototype.controller
    if law is None or law.lacks("lag") or (lag := law.lag) is None:
        raise InputError(prototype.name, [("controller", "must be a lag")])
    masses = payload_range(prototype)
    found = stable_zeros(prototype, lag.pole_Hz, law.gain_A_per_V, masses)
    own = any(part.low_Hz <= lag.zero_Hz <= part.high_Hz for part in found)
    outputs = {
        "stable_zero_from_Hz": [part.low_Hz for part in found],
        "stable_zero_to_Hz": [part.high_Hz for part in found],
        "own_zero_stable": own,
    }
    low, high = masses
    return Answer(outputs, reason="" if found else f"no zero is stable for every mass from {low:g} to {high:g} kg")
