"""Effects as parameters of the characteristic polynomial in `rig_family`: frozen figures over their whole spans."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import prod

import numpy as np
from flint import fmpq

from beamdesign.members import TWO_PI, LinearFamily, family
from beamdesign.polynomial import exact
from beamdesign.proof.replay_box import Interval
from beamdesign.prototype import Prototype
from beamdesign.rig.effect import Span
from beamdesign.rig.effects import library
from beamdesign.rig.parameters import effect_parameters_of

Names = tuple[str, ...]


@dataclass
class Parameters:
    """What effects add to the characteristic polynomial.

    Attributes:
        values: of further parameters, by name.
        spans: ranges of those that are frozen figures; each stands for every value between its ends.
        leaves: further leaves, or such that take another's place.
        groups: further parameters' groups; those of the loop gain's factors are in `factors`.
        factors: further factors of the loop gain.
        lags: leaves by which the open loop is multiplied.
        seal: whether the leaf `seal` holds the cylinder's friction.
        delay: pure delay, s.
        left_out: effects that are not in the polynomial, and why where there is something to say.
    """

    values: dict[str, fmpq] = field(default_factory=dict)
    spans: dict[str, Interval] = field(default_factory=dict)
    leaves: dict[str, str] = field(default_factory=dict)
    groups: list[tuple[str, str, Names]] = field(default_factory=list)
    factors: Names = ()
    lags: Names = ()
    seal: bool = False
    delay: fmpq = field(default_factory=fmpq)
    left_out: dict[str, str] = field(default_factory=dict)

    def freeze(self, name: str, span: Span) -> None:
        """A parameter that takes every value of a span."""
        self.values[name] = exact(span.rest)
        self.spans[name] = (exact(span.low), exact(span.high))


def effect_parameters(prototype: Prototype, largest_outer_end_mass: float | None = None) -> Parameters:
    """The effects of a prototype in its characteristic polynomial.

    A factor on the gain, the oil spring under air, the springs of friction and of hysteresis become parameters, the
    sensor's lag a lag, and the delay a pure one. Second modes, mounts and joints are left out.

    Args:
        prototype: with or without effects.
        largest_outer_end_mass: see `beamdesign.members.family`.

    Raises:
        InputError: see `beamdesign.members.family`.
    """
    found = Parameters()
    if not prototype.effects:
        return found
    whole = family(prototype, largest_outer_end_mass)
    gains = [name for name in prototype.effects if (linear := library()[name].linear) and linear.gain]
    if gains:
        rest, inside = whole.rest.gain.high, whole.members[0].gain
        found.freeze("effect_gain", Span(inside.low, inside.high, float(np.clip(rest, inside.low, inside.high))))
        found.factors = ("effect_gain",)
    own = effect_parameters_of(prototype)
    for name in own:
        if name in _LAWS:
            _LAWS[name](found, whole, own[name])
        elif name not in gains and name != "uneven_leakage":
            found.left_out[name] = ""
    if "unequal_piston_areas" in prototype.effects:
        found.left_out["unequal_piston_areas"] = "its part in the leakage"
    return found


def _lag(found: Parameters, whole: LinearFamily, own: Mapping[str, float]) -> None:
    found.values["sensor_lag_frequency"] = exact(TWO_PI) * exact(own["break_Hz"])
    found.leaves["lagging"] = "1 + s/sensor_lag_frequency"
    found.lags += ("lagging",)


def _second_order_lag(found: Parameters, whole: LinearFamily, own: Mapping[str, float]) -> None:
    ratio = exact(own["damping_ratio"])
    found.values["second_lag_frequency"] = 2 * ratio * exact(TWO_PI) * exact(own["break_Hz"])
    found.values["second_lag_damping_ratio"] = ratio
    found.leaves["lagging_twice"] = (
        "1 + 2*second_lag_damping_ratio*s/second_lag_frequency + s**2/second_lag_frequency**2"
    )
    found.lags += ("lagging_twice",)


def _delay(found: Parameters, whole: LinearFamily, own: Mapping[str, float]) -> None:
    found.delay = exact(own["delay_s"])


_AIR = ("entrained_air", "entrained_air_with_stroke")


def _air(found: Parameters, whole: LinearFamily, own: Mapping[str, float]) -> None:
    if "oil_stiffness_factor" in found.values:
        return
    # Both laws of air at once make a product, which takes every value between those of the ends.
    spans = [whole.spans[key] for name in _AIR if (key := f"{name}.stiffness_factor") in whole.spans]
    low, high, rest = (prod(getattr(span, end) for span in spans) for end in ("low", "high", "rest"))
    found.freeze("oil_stiffness_factor", Span(low, high, rest))
    found.leaves["oil"] = "s/oil_spring"
    found.groups.append(("oil_spring", "product", ("oil_stiffness", "oil_stiffness_factor")))


def _hysteresis(found: Parameters, whole: LinearFamily, own: Mapping[str, float]) -> None:
    found.freeze("spool_spring", whole.spans["valve_hysteresis.spring"])
    found.leaves["valve"] = "1 + spool_spring + 2*valve_damping_ratio*s/valve_frequency + s**2/valve_frequency**2"


def _friction(found: Parameters, whole: LinearFamily, own: Mapping[str, float]) -> None:
    spring, dashpot = (whole.spans[f"seal_friction.{name}"] for name in ("spring_N_per_m", "dashpot_N_s_per_m"))
    if dashpot.low < 0:
        found.left_out["seal_friction"] = "friction that falls with speed"
        return
    found.freeze("seal_spring", spring)
    found.freeze("seal_dashpot", dashpot)
    found.leaves["seal"] = "seal_spring + seal_dashpot*s"
    found.seal = True


_LAWS: dict[str, Callable[[Parameters, LinearFamily, Mapping[str, float]], None]] = {
    "sensor_lag": _lag,
    "sensor_lag_second_order": _second_order_lag,
    "transport_delay": _delay,
    **dict.fromkeys(_AIR, _air),
    "valve_hysteresis": _hysteresis,
    "seal_friction": _friction,
}
