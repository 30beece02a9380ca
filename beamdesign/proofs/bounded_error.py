"""What is linear plus a bounded error: how far the tip strays from the linear response, proved for every payload.

Friction that slides, hysteresis, a dead band, a residual ripple and quantisation are each the linear rig with something
added at one place that never exceeds a size, whatever the motion. Added errors move the tip by no more than their sizes
times the integrals of the absolute impulse responses from their places, see `beamdesign.proofs.absolute_impulse`; being
of one linear loop, these add up.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from flint import fmpq, fmpq_mat, fmpq_poly

from beamdesign.loop import member_loop
from beamdesign.plant.assembly import effect_parameters_of
from beamdesign.plant.linear import DISPLACEMENT, LinearModel
from beamdesign.plant.members import VertexModel
from beamdesign.polynomial import exact
from beamdesign.proofs.absolute_impulse import over_masses
from beamdesign.proofs.absolute_stability import Members, Row
from beamdesign.proofs.stability import is_stable_over
from beamdesign.prototype import Prototype
from beamdesign.rational import nearest, shortened, text
from beamdesign.structure.lumped import figures

METHOD = "bounded error: integral of the absolute impulse response with its tail, in ball arithmetic"
RESOLUTION = "sensor_resolution"
"""How the sensor's own `resolution_m` is named, which is no effect."""
_SLACK = fmpq(103, 100)
"""A bound that is stated over the one that was found, so that another method may prove it again."""
_DIGITS = 4
SLIDING = {
    "seal_friction": {"spring_N_per_m": "low", "dashpot_N_s_per_m": "high"},
    "valve_hysteresis": {"spring": "low"},
}
"""Ends of the spans at which an effect's linear member is its linear part: while it slides."""
UNITS = {"current": "A", "flow": "m3/s", "volts": "V", "stroke": "N", "nut": "N"}


@dataclass(frozen=True)
class Error:
    """Something added to the linear rig.

    Attributes:
        effect: that it stands for.
        place: one of `UNITS`: added to the current, to the flow behind the spool, to the sensor's volts, or a force
            between piston and cylinder.
        size: which it never exceeds, SI.
        words: what it is.
    """

    effect: str
    place: str
    size: fmpq
    words: str


FORCES = ("stroke", "nut")
"""Places of errors that are forces: between piston and cylinder, and on the nut of a screw."""


def errors(prototype: Prototype) -> list[Error]:
    """Those effects of a prototype that are linear but for a bounded error, and the sensor's resolution."""
    own, found = effect_parameters_of(prototype), []
    for name, parameters in own.items():
        figure = {key: exact(value) for key, value in parameters.items()}
        if name in ("valve_hysteresis", "valve_hysteresis_magnetic"):
            words = "what it takes off the current is at most its half width"
            found.append(Error(name, "current", figure["half_width_A"], words))
        elif name == "valve_deadband":
            gain = exact(figures(prototype)["flow_gain"])
            words = "what it takes off the flow is at most that of its half width"
            found.append(Error(name, "flow", gain * figure["half_width_A"], words))
        elif name == "seal_friction":
            words = "beside its viscous share it is at most the breakaway force"
            place = "stroke" if "piston_area" in figures(prototype) else "nut"
            found.append(Error(name, place, figure["coulomb_N"] * figure["breakaway_ratio"], words))
        elif name == "carrier_ripple" and figure["depth"] == 0:
            words = "without a depth it is its residual alone"
            found.append(Error(name, "volts", figure["residual_V"], words))
    if (resolution := prototype.sensor.resolution_m) is not None:
        size = exact(resolution) * exact(prototype.sensor.gain_V_per_m)
        found.append(Error(RESOLUTION, "volts", size, "what is read is off by at most one step"))
    return found


def slides(member: VertexModel, members: Sequence[VertexModel]) -> bool:
    """Whether what a member freezes of the effects of `SLIDING` is at the ends named there."""
    for effect, ends in SLIDING.items():
        for figure, end in ends.items():
            values = [other.frozen[effect][figure] for other in members if figure in other.frozen.get(effect, {})]
            if values and member.frozen[effect][figure] != (min(values) if end == "low" else max(values)):
                return False
    return True


def heard(prototype: Prototype) -> tuple[list[Error], list[Row]]:
    """The errors of which a bound may be proved, and rows of those that the controller hears itself."""
    found = errors(prototype)
    if prototype.controller is None or prototype.controller.sensed_law().sensors == DISPLACEMENT:
        return found, []
    why = "No bound is proved: a controller that hears more than the displacement hears the friction as well."
    refused = [Row((one.effect,), METHOD, False, why) for one in found if one.place in FORCES]
    return [one for one in found if one.place not in FORCES], refused


def bounded_rows(given: Members) -> Iterator[Row]:
    """A row for each effect that is linear plus a bounded error, and one for all of them together."""
    found, refused = heard(given.prototype)
    yield from refused
    if not found:
        return
    numbers = [k for k, member in enumerate(given.found.members, start=1) if slides(member, given.found.members)]
    try:
        bounds, pieces = _bounds(given, found, numbers)
    except ArithmeticError as error:
        yield from (Row((one.effect,), METHOD, False, f"No bound is proved: {error}.") for one in found)
        return
    stated = [shortened(one * _SLACK, _DIGITS, up=True) if one > 0 else one for one in bounds]
    listed = [
        {"place": one.place, "size": text(one.size), "bound_m": text(bound)}
        for one, bound in zip(found, stated, strict=True)
    ]
    statement = {"kind": "deviation", "loops": numbers, "pieces": pieces, "error": listed}
    frozen = given.frozen(len(numbers), [one.effect for one in found])
    yield from rows_of(found, stated, f"for every payload that stays{frozen}", METHOD, statement)


def rows_of(
    found: Sequence[Error], bounds: Sequence[fmpq], of: str, method: str, statement: dict[str, Any] | None = None
) -> Iterator[Row]:
    """A row for each error and its bound in m, and one for all of them together; of what it is proved, in words."""
    for k, (one, bound) in enumerate(zip(found, bounds, strict=True)):
        words = (
            f"It is linear plus a bounded error: {one.words}, {nearest(one.size):.4g} {UNITS[one.place]}. So the tip"
            " never strays by more from the response of the linear loop to the same command and load from the same"
            f" state, {of}; bounds of several such effects add up. Not covered is a"
            " current that saturates, or a gain that changes, at the same time."
        )
        yield Row((one.effect,), method, True, words, nearest(bound), statement if k == 0 else None)
    if len(found) > 1:
        names, total = tuple(one.effect for one in found), nearest(sum(bounds, fmpq(0)))
        yield Row(names, method, True, "All of these at once: the sum of their bounds.", total)


def _bounds(given: Members, found: Sequence[Error], numbers: Sequence[int]) -> tuple[list[fmpq], int]:
    """Bounds of the tip's deviation, m, over all loops of some numbers, and the most pieces that one took.

    Raises:
        ArithmeticError: where none is proved, with the reason.
    """
    worst, most = [fmpq(0) for _ in found], 1
    for number in numbers:
        member = given.found.members[number - 1]
        loop = member_loop(given.prototype, member)
        if not is_stable_over(loop.characteristic, given.low, given.high):
            raise ArithmeticError("the linear loop is not stable at every mass")
        known = numerators(given.prototype, member.rig, {one.place for one in found})
        per_unit, pieces = over_masses([known[one.place] for one in found], loop.characteristic, given.low, given.high)
        bounds = [one.size * unit for one, unit in zip(found, per_unit, strict=True)]
        worst, most = [max(pair) for pair in zip(worst, bounds, strict=True)], max(most, pieces)
    return worst, most


def numerators(prototype: Prototype, rig: LinearModel, places: set[str]) -> Mapping[str, fmpq_poly]:
    """By place, what an error there does to the tip, over the characteristic polynomial of the closed loop; free of m.

    Raises:
        ArithmeticError: where it is not known, with the reason.
    """
    law = prototype.own_controller.sensed_law()
    plant = rig.plant(prototype.payload.inner_end_mass_kg, law.sensors)
    if rig.sensor_rides:
        raise ArithmeticError("the sensor rides on the mount, so that it does not see the tip alone")
    found = {"current": plant.displaced * law.denominator}
    own = plant.control[0]
    assert own.slope.is_zero()  # it sees the tip alone
    found["volts"] = own.constant * law.numerators[0] / exact(prototype.sensor.gain_V_per_m)
    figure = {name: exact(value) for name, value in rig.figures.items()}
    if "flow_gain" in figure:
        w, damping, gain = (figure[key] for key in ("valve_frequency", "valve_damping_ratio", "flow_gain"))
        found["flow"] = found["current"] * fmpq_poly([1 / gain, 2 * damping / (w * gain), 1 / (w * w * gain)])
    else:  # a force on the nut instead of the one that the motor's current gives
        per_force = figure["lead"] / figure["torque_constant"]
        found["nut"] = found["current"] * fmpq_poly([per_force, per_force / figure["current_loop"]])
    if "stroke" in places:
        assert law.sensors == DISPLACEMENT  # else more than this moves
        inner = exact(prototype.payload.inner_end_mass_kg)
        found["stroke"] = _stroke(rig, inner, plant.denominator.constant) * law.denominator
    return found


def _stroke(rig: LinearModel, inner_end_mass: fmpq, denominator: fmpq_poly) -> fmpq_poly:
    """Numerator over the plant's denominator from a force between piston and cylinder to the tip, which it draws back.

    c adj(sI - A) b = det(sI - A + b c) - det(sI - A).
    """
    mass, a, _, c = rig.exact_matrices(fmpq(0), inner_end_mass)
    n, push, inverse = mass.nrows(), rig.exact_push, mass.inv()
    pulled = inverse * fmpq_mat(n, 1, [push[i, 0] - push[i, 1] for i in range(n)])
    tip = fmpq_mat(1, n, [c[0, j] for j in range(n)])
    own = inverse * a
    below = own.charpoly()
    above = ((own - pulled * tip).charpoly() - below) * denominator
    if not (above % below).is_zero():
        raise ArithmeticError("the friction drives what the plant does not show")
    return above / below
