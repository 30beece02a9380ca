"""The assembly's plant with linear laws, x' = A x + B u, y = C x + D u, as functions of its parameters alone."""

from dataclasses import dataclass, replace
from functools import cache

import casadi as ca

from beamdesign.rig.assembly import INPUTS, OUTPUTS, Assembly, Structure, join
from beamdesign.rig.effect import Effect, Parameter
from beamdesign.rig.effects import library

SOURCES = ("disturbance_N", "sampled_current_A")
SEEN = ("outer_displacement_m", "measured_V", "inner_displacement_m", "load_pressure_Pa")
"""What the tip does, what the controller hears of it, and what added sensors may read."""


@dataclass(frozen=True)
class LinearAssembly:
    """The linear plant of an assembly.

    Attributes:
        function: its parameters (one vector) to A (n, n), B (n, 2), C (4, n) and D (4, 2), from disturbance and current
            to what is in `SEEN`.
        states: names of the n states.
        parameters: names of the parameters.
    """

    function: ca.Function
    states: tuple[str, ...]
    parameters: tuple[str, ...]


def linear_effect(effect: Effect) -> Effect | None:
    """An effect with its linear laws, which see the figures of its spans as further parameters.

    None where nothing of it is left: where it is but a factor on the gain.

    Raises:
        ValueError: where the effect has no linear member.
    """
    if effect.linear is None:
        raise ValueError(f"{effect.name} has no linear member")
    if effect.linear.laws is None:
        return effect
    if not effect.linear.laws:
        return None
    figures = tuple(Parameter(name, 0.0, 0.0, 0.0, 0.0, "of a linear member") for name in effect.linear.figures)
    return replace(
        effect,
        laws=effect.linear.laws,
        states=effect.linear.states,
        parameters=effect.parameters + figures,
        memory=(),
        linear=None,
    )


@cache
def linear_assembly(filtered: bool, names: tuple[str, ...]) -> LinearAssembly:
    """The plant with the linear members of the named effects, derived from the assembly by differentiation.

    Args:
        filtered: whether the prototype's own low-pass filter follows the sensor.
        names: effects, sorted.

    Raises:
        ValueError: where an effect has no linear member, or one whose laws are not linear after all.
    """
    members = [member for name in names if (member := linear_effect(library()[name])) is not None]
    joined = join(Structure("sampled", filtered, tuple(member.name for member in members)), members)
    t, x, u, p = (ca.SX.sym(name, *joined.function.size_in(k)) for k, name in enumerate(("t", "x", "u", "p")))
    rate, y = joined.function(t, x, u, p)
    inputs, outputs = [INPUTS.index(name) for name in SOURCES], [OUTPUTS.index(name) for name in SEEN]
    matrices = [
        ca.jacobian(rate, x),
        ca.jacobian(rate, u)[:, inputs],
        ca.jacobian(y, x)[outputs, :],
        ca.jacobian(y, u)[outputs, inputs],
    ]
    if any(ca.depends_on(matrix, ca.vertcat(t, x, u)) for matrix in matrices):
        raise ValueError(f"the linear members of {', '.join(names)} are not linear: {_guilty(joined)}")
    function = ca.Function("linear", [p], [ca.densify(matrix) for matrix in matrices], ["p"], ["A", "B", "C", "D"])
    return LinearAssembly(function, joined.states, joined.parameters)


def _guilty(joined: Assembly) -> str:
    return "their Jacobians depend on where they are taken, in the states " + ", ".join(joined.states)
