"""Current saturation: the servo-amplifier gives no more than its limit."""

from typing import Any

import casadi as ca

from beamdesign.plant.effect import Effect, Linear, Parameter, Site, Span


def _law(signal: Any, site: Site) -> Any:
    limit = site.parameter["limit_A"]
    return ca.fmin(ca.fmax(signal, -limit), limit)


LIMIT = Parameter("limit_A", 10e-3, 0.2e-3, 0.2, 0.7, "largest current; rated currents are 8 to 40 mA")
LINEAR = Linear(
    "gain from none to the whole, the sector in which a saturation lies; performance below the limit",
    "limit cycles and recovery from large signals",
    laws={},
    gain=lambda own, at: Span(0.0, 1.0, 1.0, (1.0, 1.0)),
)

EFFECT = Effect(
    name="current_saturation",
    subsystem="amplifier",
    laws={"current_A": _law},
    parameters=(LIMIT,),
    states=(),
    source="limit of a servo-amplifier; Zalucky and Hardt (1984) filtered the sensor to keep it from saturating",
    linear=LINEAR,
)
