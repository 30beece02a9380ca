"""The closed loop of the twin-beam rig as an expression in all its figures."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi

from flint import fmpq, fmpq_poly

from beamdesign.lumped import figures
from beamdesign.polynomial import exact
from beamdesign.proof.effect_parameters import effect_parameters
from beamdesign.proof.rational import text
from beamdesign.proof.replay_box import Interval, Statement
from beamdesign.prototype import Prototype


@dataclass(frozen=True)
class Family:
    """A characteristic polynomial over parameters; the texts are those of `replay_box.Statement`.

    Attributes:
        name: what it is of.
        p: the polynomial over leaves, or at once in s and the parameters where there are no leaves.
        values: each parameter's value where no box says otherwise.
        leaves: polynomials in s and in parameters or their reciprocals, by name.
        bound: leaves that stand in several places, in packs that are enumerated together.
        delays: names that stand for exp(-s T), with the parameter T of each.
        groups: (name, "sum" or "product", members) of parameters that enter by one variable only.
        positive: whether its parameters cannot be negative.
    """

    name: str
    p: str
    values: Mapping[str, fmpq]
    leaves: Mapping[str, str] | None = None
    bound: tuple[tuple[str, ...], ...] = ()
    delays: Mapping[str, str] | None = None
    groups: tuple[tuple[str, str, tuple[str, ...]], ...] = ()
    positive: bool = False

    def over(self, ranges: Mapping[str, Interval]) -> Statement:
        """The family over a box; parameters that are not named keep their values.

        Raises:
            ValueError: for an unknown parameter, or a range that the expression does not allow.
        """
        if unknown := sorted(set(ranges) - set(self.values)):
            raise ValueError(f"no parameter {', '.join(unknown)}; there are {', '.join(self.values)}")
        for name, (low, high) in ranges.items():
            if low > high or (self.positive and low < 0):
                raise ValueError(f"{name}: not a range: {text(low)} to {text(high)}")
        full = {name: ranges.get(name, (value, value)) for name, value in self.values.items()}
        return Statement(self.p, full, self.leaves, self.bound, self.delays, self.groups)


def rig_family(prototype: Prototype) -> Family:
    """The characteristic polynomial of a prototype's loop over all its figures, both end masses and a pure delay.

    With D = K + b s + M s^2 of either beam, h = s / K_c + K_pq / A^2, and valve, filter and controller as ratios V, W,
    C_n / C_d of unit static gain,

        p = (D_m (h D_f + s) + s D_f) V W C_d + (F K_q K_sa / A) D_f C_n exp(-sT),

    which is the characteristic polynomial of equations (7) to (18) divided by K_c omega_n^2 (and the filter's break).
    Effective and end masses enter by their sums, the three gains by their product. D_f and 1 / A stand in several
    places and are bound. The dashpots b are parameters of their own. Frequencies are in rad/s. Effects add what
    `effect_parameters` says; with a seal of impedance Z between piston and cylinder, s + h Z stands for s.

    Raises:
        ValueError: without a controller.
        InputError: for effects for which no linear loop stands.
    """
    controller = prototype.controller
    if controller is None:
        raise ValueError("the prototype has no [controller]")
    values = {name: exact(value) for name, value in figures(prototype).items()}
    values |= {"outer_end_mass": fmpq(0), "inner_end_mass": exact(prototype.payload.inner_end_mass_kg)}
    added = effect_parameters(prototype)
    values |= {"controller_gain": exact(controller.gain_A_per_V), "delay": added.delay, **added.values}
    leaves = {
        "outer": "outer_stiffness + outer_damping*s + outer_total_mass*s**2",
        "inner": "inner_stiffness + inner_damping*s + inner_total_mass*s**2",
        "oil": "s/oil_stiffness",
        "leak": "leakage",
        "per_area": "1/piston_area",
        "per_square_area": "1/piston_area**2",
        "gain": "loop_gain",
        "valve": "1 + 2*valve_damping_ratio*s/valve_frequency + s**2/valve_frequency**2",
    }
    if (lag := controller.lag) and not controller.lacks("lag"):
        values |= {
            "controller_zero": exact(2 * pi * lag.zero_Hz),
            "controller_pole": exact(2 * pi * lag.pole_Hz),
        }
        leaves |= {"numerator": "1 + s/controller_zero", "denominator": "1 + s/controller_pole"}
    else:
        law = controller.transfer_function()
        leaves |= {"numerator": _written(law.numerator / values["controller_gain"])}
        leaves |= {"denominator": _written(law.denominator)}
    lags = "valve*denominator"
    if prototype.sensor.filter_Hz is None:
        del values["filter_frequency"]
    else:
        leaves["filter"] = "1 + s/filter_frequency"
        lags += "*filter"
    lags = "*".join([lags, *added.lags])
    yielding, stroke = "(oil + leak*per_square_area)", "s"
    if added.seal:
        stroke = f"(s + {yielding}*seal)"
    return Family(
        prototype.name,
        f"(outer*({yielding}*inner + {stroke}) + {stroke}*inner)*{lags} + gain*per_area*inner*numerator*transport",
        values,
        leaves | added.leaves,
        (("inner",), ("per_area", "per_square_area")),
        {"transport": "delay"},
        (
            ("outer_total_mass", "sum", ("outer_mass", "outer_end_mass")),
            ("inner_total_mass", "sum", ("inner_mass", "inner_end_mass")),
            ("loop_gain", "product", ("sensor_gain", "flow_gain", "controller_gain", *added.factors)),
            *added.groups,
        ),
        positive=True,
    )


def _written(polynomial: fmpq_poly) -> str:
    return " + ".join(f"({text(c) if c.q == 1 else f'{c.p}/{c.q}'})*s**{i}" for i, c in enumerate(polynomial.coeffs()))
