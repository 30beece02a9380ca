"""The nonlinear loop: for each effect of a prototype, what is proved of it while it moves, and on what that rests.

- Static characteristics in the current or behind the spool (saturation, dead band, unequal sides): a multiplier of
  Zames and Falb with a term of Popov's, `beamdesign.proofs.absolute_stability`.
- Gains that change: the circle criterion, `beamdesign.proofs.changing_gain`.
- One of the first in the current and one of the second, or unequal sides, at once: `beamdesign.proofs.two_places`.
- What is linear plus a bounded error (friction, hysteresis, dead band, ripple, quantisation): how far the tip strays,
  `beamdesign.proofs.bounded_error`.
- What is linear is a part of the loop, and of every proof.

Every other effect is listed with why nothing is proved of it.
"""

from collections.abc import Iterator

from beamdesign.plant.effects import library
from beamdesign.proofs.absolute_stability import Members, Row, members, static_rows
from beamdesign.proofs.bounded_error import bounded_rows
from beamdesign.proofs.changing_gain import changing_rows
from beamdesign.proofs.stability import is_stable_over
from beamdesign.proofs.two_places import both_rows
from beamdesign.prototype import Prototype

LINEAR = "linear, a part of the loop"
NONE_KNOWN = "none"
_OPEN = (
    "No theorem here covers it while it moves; what `certify` proves of it is about linear loops that bracket it at"
    " frozen values"
)
_WHY = {
    "joint_backlash": "the joint's damping depends on how far it is pressed, so that the play is no bounded error",
    "joint_backlash_nut": "a flank damps while it touches and never pulls, so that the play is no bounded error",
    "entrained_air": "the oil's stiffness changes with the pressure, which is no gain at one place of the loop",
    "entrained_air_with_stroke": "the oil's stiffness changes with pressure and stroke, which is no gain at one place",
    "carrier_ripple": "its depth and its residual are covered each without the other",
    "pressure_dependent_flow": "with unequal sides the flows of both ports do not act as one gain",
    "unequal_piston_areas": "with orifices the sides act through both pressures, and not as one characteristic",
}


def nonlinear_rows(prototype: Prototype, low_kg: float, high_kg: float) -> tuple[Row, ...]:
    """What is proved of each effect of a prototype, and of the saturation that every rig has, over a range of masses.

    Raises:
        ValueError: without a controller.
        InputError: for effects for which no linear loop stands.
    """
    given = members(prototype, low_kg, high_kg)
    rows = [*static_rows(given), *changing_rows(given), *both_rows(given), *bounded_rows(given), *_linear(given)]
    known = {name for row in rows for name in row.effects}
    for name in sorted(prototype.effects.keys() - known):
        why = f": {_WHY[name]}" if name in _WHY else ""
        rows.append(Row((name,), NONE_KNOWN, False, f"{_OPEN}{why}."))
    return tuple(rows)


def _linear(given: Members) -> Iterator[Row]:
    """One row for all effects that are linear themselves."""
    names = [name for name in sorted(given.prototype.effects) if is_linear(name)]
    if names:
        stable = all(is_stable_over(loop.characteristic, given.low, given.high) for loop in given.loops)
        words = "Linear itself, as it is simulated: every loop here holds it, in every combination."
        yield Row(tuple(names), LINEAR, stable, words if stable else "The linear loop is not stable at every mass.")


def is_linear(name: str) -> bool:
    """Whether an effect is a part of the linear loop, and no more."""
    linear = library()[name].linear
    return linear is not None and linear.laws is None and not linear.figures and linear.gain is None
