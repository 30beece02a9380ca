"""The lag controller as a passive network: R1 in series, then R2 and C in series to ground."""

from dataclasses import dataclass
from math import pi

from beamdesign.controllers import Break


@dataclass(frozen=True)
class LagNetwork:
    """Component values that realise C(s) = (1 + s R2 C) / (1 + s (R1 + R2) C) between a low and a high impedance.

    Attributes:
        series_ohm: R1.
        shunt_ohm: R2.
        capacitance_F: C.
    """

    series_ohm: float
    shunt_ohm: float
    capacitance_F: float


def lag_network(lag: Break, capacitance_F: float = 1e-6) -> LagNetwork:
    """Values of the network for a chosen capacitor, not rounded to any series.

    Args:
        lag: its pole below the zero.
        capacitance_F: C.

    Raises:
        ValueError: where the pole does not lie below the zero: that is a lead, which this network cannot give.
    """
    if lag.pole_Hz >= lag.zero_Hz:
        raise ValueError("a passive lag network needs its pole below its zero")
    shunt = 1 / (2 * pi * lag.zero_Hz * capacitance_F)
    return LagNetwork(shunt * (lag.zero_Hz / lag.pole_Hz - 1), shunt, capacitance_F)
