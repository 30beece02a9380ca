"""What is linear plus a bounded error: how far the tip strays from the linear response, proved for every payload.

Friction that slides, hysteresis, a dead band, a residual ripple and quantisation are each the linear rig with something
added at one place that never exceeds a size, whatever the motion. Added errors move the tip by no more than their sizes
times the integrals of the absolute impulse responses from their places; being of one linear loop, these add up.

Where the sensor's gain ripples as well, by no more than a depth d, errors of a sum of bounds B move the tip from what
the rippling loop does by some y. That y ripples too is one more error in the volts, of d K_s |y|, whose own bound is r
|y|: so |y| <= B + r |y|, and where r is below one, no more than B / (1 - r) (small gain, section 4.3 there).

What enters a stable linear loop as an error e with |e| <= E moves its output by no more than E times the integral of
the absolute impulse response from there to the output, at any time and however e varies (M. A. Dahleh and I. J.
Diaz-Bobillo, Control of Uncertain Systems, 1995, section 2.2). `beamdesign.proofs.absolute_integrals` bounds these.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from flint import fmpq, fmpq_mat, fmpq_poly

from beamdesign.loop import member_loop
from beamdesign.plant.assembly import effect_parameters_of
from beamdesign.plant.effects import laws_of, library
from beamdesign.plant.linear import DISPLACEMENT, LinearModel
from beamdesign.plant.members import VertexModel, linear_of
from beamdesign.polynomial import exact, nearest, shortened, text, transfer
from beamdesign.proofs.absolute_integrals import Cells, over_masses
from beamdesign.proofs.certificate import Row
from beamdesign.proofs.read_once import NotCovered
from beamdesign.proofs.scope import Members
from beamdesign.proofs.stability import is_stable_over
from beamdesign.prototype import Prototype
from beamdesign.structure.lumped import figures

METHOD = "bounded error: integral of the absolute impulse response with its tail, in ball arithmetic"
RESOLUTION = "sensor_resolution"
"""How the sensor's own `resolution_m` is named, which is no effect."""
RIPPLE = "carrier_ripple"
_SLACK = fmpq(103, 100)
"""A bound that is stated over the one that was found, so that another method may prove it again."""
_DIGITS = 4
SLIDING = {
    "seal_friction": {"spring_N_per_m": "low", "dashpot_N_s_per_m": "high"},
    "valve_hysteresis": {"spring": "low"},
}
"""Ends of the spans at which an effect's linear member is its linear part: while it slides."""
_AHEAD = {"volts": ("sensed_m",), "flow": ("demanded_A", "current_A", "spool_A"), "stroke": ()}
"""By place, ports behind which an error arises and before which it is counted, so that no law may act there; of others
those that are ahead of the spool or the drive."""
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
        gain: figure of the rig that its size grows with, if any.
        per_m: whether its size is that for every metre that the tip has strayed.
    """

    effect: str
    place: str
    size: fmpq
    words: str
    gain: str = ""
    per_m: bool = False


FORCES = ("stroke", "nut")
"""Places of errors that are forces: between piston and cylinder, and on the nut of a screw."""


def errors(prototype: Prototype) -> list[Error]:
    """Those effects of a prototype that are linear but for a bounded error, and the sensor's resolution."""
    own, found = effect_parameters_of(prototype), []
    for name, parameters in own.items():
        figure = {key: exact(value) for key, value in parameters.items()}
        if name in laws_of("valve_hysteresis"):
            words = "what it takes off the current is at most its half width"
            found.append(Error(name, "current", figure["half_width_A"], words))
        elif name in laws_of("valve_deadband"):
            gain = exact(figures(prototype)["flow_gain"])
            words = "what it takes off the flow is at most that of its half width"
            found.append(Error(name, "flow", gain * figure["half_width_A"], words, "flow_gain"))
        elif name == "seal_friction":
            words = "beside its viscous share it is at most the breakaway force"
            place = "stroke" if "piston_area" in figures(prototype) else "nut"
            found.append(Error(name, place, figure["coulomb_N"] * figure["breakaway_ratio"], words))
        elif name == RIPPLE and (figure["residual_V"] > 0 or figure["depth"] == 0):
            found.append(Error(name, "volts", figure["residual_V"], "but for its depth it is its residual"))
    gain, depth = exact(prototype.sensor.gain_V_per_m), exact(own.get(RIPPLE, {}).get("depth", 0.0))
    if (resolution := prototype.sensor.resolution_m) is not None:
        size = exact(resolution) * gain * (1 + depth)
        found.append(Error(RESOLUTION, "volts", size, "what is read is off by at most one step", "sensor_gain"))
    if found and depth > 0:
        found.append(Error(RIPPLE, "volts", depth * gain, "", "sensor_gain", per_m=True))
    return found


def slides(member: VertexModel, members: Sequence[VertexModel]) -> bool:
    """Whether what a member freezes of the effects of `SLIDING` is at the ends named there."""
    for effect, ends in SLIDING.items():
        for figure, end in ends.items():
            values = [other.frozen[effect][figure] for other in members if figure in other.frozen.get(effect, {})]
            if values and member.frozen[effect][figure] != (min(values) if end == "low" else max(values)):
                return False
    return True


def acts_ahead(prototype: Prototype, effect: str, place: str) -> str:
    """An effect that acts between a place and where another effect arises that is counted there; empty without one.

    At one port effects act in the order of their names; forces add up. None of the library acts there; a mount that the
    sensor rides on and a spool that sticks are refused and frozen elsewhere.
    """
    known = library()
    own = known[effect].laws if effect in known else {}
    for name in sorted(prototype.effects.keys() - {"mount_compliance", *SLIDING}):
        linear = linear_of(prototype, name)
        laws = known[name].laws if linear is None or linear.laws is None else linear.laws
        ahead = laws.keys() & {*_AHEAD.get(place, ("demanded_A", "current_A", "motor_demand_A"))}
        if ahead or (place not in FORCES and name < effect and laws.keys() & own.keys()):
            return name
    return ""


def errors_in_loop(prototype: Prototype) -> tuple[list[Error], list[Row]]:
    """The errors of which a bound may be proved, and rows of those that the controller or an effect hears itself."""
    found, refused = [], []
    for one in errors(prototype):
        if not (name := acts_ahead(prototype, one.effect, one.place)):
            found.append(one)
        elif not one.per_m:
            why = f"No bound is proved: {name} acts ahead of it, behind which what it does is not known."
            refused.append(Row((one.effect,), METHOD, False, why))
    if prototype.controller is None or prototype.controller.sensed_law().sensors == DISPLACEMENT:
        return found, refused
    why = "No bound is proved: a controller that hears more than the displacement hears the friction as well."
    refused += [Row((one.effect,), METHOD, False, why) for one in found if one.place in FORCES]
    deep = {one.effect for one in found if one.per_m}  # which is frozen beside what else is heard
    return [one for one in found if one.place not in FORCES and one.effect not in deep], refused


def bounded_rows(given: Members) -> Iterator[Row]:
    """A row for each effect that is linear plus a bounded error, and one for all of them together."""
    found, refused = errors_in_loop(given.prototype)
    yield from refused
    if not found:
        return
    numbers = [k for k, member in enumerate(given.found.members, start=1) if slides(member, given.found.members)]
    try:
        most, pieces = _bounds(given, found, numbers)
    except ArithmeticError as why:
        yield from (Row((one.effect,), METHOD, False, f"No bound is proved: {why}.") for one in found if not one.per_m)
        return
    stated = [shortened(one * _SLACK, _DIGITS, up=True) for one in most]
    listed = [
        {"place": one.place, "size": text(one.size), "bound_m": text(bound)}
        for one, bound in zip(found, stated, strict=True)
    ]
    statement = {"kind": "deviation", "loops": numbers, "pieces": pieces, "error": listed}
    frozen = given.frozen(len(numbers), [one.effect for one in found])
    yield from rows_of(found, stated, f"for every payload that stays{frozen}", METHOD, statement)


def rows_of(
    found: Sequence[Error], most: Sequence[fmpq], of: str, method: str, statement: dict[str, Any] | None = None
) -> Iterator[Row]:
    """A row for each error and its bound in m, and one for all of them together; of what it is proved, in words."""
    own = list(zip(found, most, strict=True))
    share = own.pop()[1] if own and own[-1][0].per_m else fmpq(0)
    for k, (one, bound) in enumerate(own):
        words = (
            f"It is linear plus a bounded error: {one.words}, {nearest(one.size):.4g} {UNITS[one.place]}. So the tip"
            " never strays by more from the response of the linear loop to the same command and load from the same"
            f" state, {of}; bounds of several such effects add up. Not covered is a"
            " current that saturates, or a gain that changes, at the same time."
        )
        yield Row((one.effect,), method, True, words, nearest(bound), statement if k == 0 else None)
    if share or len(own) > 1:
        names, total = tuple(dict.fromkeys(one.effect for one in found)), sum((bound for _, bound in own), fmpq(0))
        words = "All of these at once: the sum of their bounds"
        words += f" over 1 - {nearest(share):.4g}, from the response of the loop whose gain ripples" if share else ""
        most_of_all = nearest(shortened(total / (1 - share), _DIGITS, up=True)) if share < 1 else None
        yield Row(names, method, share < 1, f"{words}.", most_of_all)


def _bounds(given: Members, found: Sequence[Error], numbers: Sequence[int]) -> tuple[list[fmpq], int]:
    """Bounds of the tip's deviation, m, over all loops of some numbers, and the most pieces that one took.

    Raises:
        ArithmeticError: where none is proved, with the reason.
    """
    worst, most, cells = [fmpq(0) for _ in found], 1, Cells()
    for number in numbers:
        member = given.found.members[number - 1]
        loop = member_loop(given.prototype, member)
        if not is_stable_over(loop.characteristic, given.low, given.high):
            raise ArithmeticError("the linear loop is not stable at every mass")
        known = numerators(given.prototype, member.rig, {one.place for one in found})
        above = [known[one.place] for one in found]
        per_unit, pieces = over_masses(above, loop.characteristic, given.low, given.high, cells)
        own = [one.size * unit for one, unit in zip(found, per_unit, strict=True)]
        worst, most = [max(pair) for pair in zip(worst, own, strict=True)], max(most, pieces)
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
    own, figure = plant.control[0], {name: exact(value) for name, value in rig.figures.items()}
    assert own.slope.is_zero()  # it sees the tip alone
    given = plant.displaced * law.denominator, own.constant * law.numerators[0], figure, fmpq_poly([0, 1])
    known = ("current", "volts", "flow" if "flow_gain" in figure else "nut")
    found: dict[str, fmpq_poly] = {place: erring(place, *given) for place in known}
    if "stroke" in places:
        assert law.sensors == DISPLACEMENT  # else more than this moves
        inner = exact(prototype.payload.inner_end_mass_kg)
        found["stroke"] = _stroke(rig, inner, plant.denominator.constant) * law.denominator
    return found


def erring(place: str, current: Any, volts: Any, figure: Mapping[str, Any], s: Any) -> Any:
    """What an error at a place does to the tip, over the characteristic polynomial.

    A force between piston and cylinder is the flow that leaks past and that the oil gives, see `Weighed`.

    Args:
        place: one of `UNITS`.
        current: what an error in the current does.
        volts: the loop's numerator from the displacement.
        figure: of the rig, as numbers or variables.
        s: the variable, of polynomials in it alone or in parameters too.

    Raises:
        NotCovered: for another place, or a rig in which it is not that.
    """
    above, below = current, 1 + 0 * s
    if place == "volts":
        above, below = volts, below * figure["sensor_gain"]
    elif place == "nut":
        above *= figure["lead"] * (figure["current_loop"] + s)
        below *= figure["torque_constant"] * figure["current_loop"]
    elif place != "current":
        w = figure["valve_frequency"]
        above *= s * s + 2 * figure["valve_damping_ratio"] * w * s + w * w
        below *= figure["flow_gain"] * w * w
    found, rest = divmod(above, below)
    if rest != 0:
        raise NotCovered(f"what an error in the {place} does is no polynomial")
    return found


def _stroke(rig: LinearModel, inner_end_mass: fmpq, denominator: fmpq_poly) -> fmpq_poly:
    """Numerator over the plant's denominator from a force between piston and cylinder to the tip, which it draws back.

    A spring of friction shows what it acts on.
    """
    mass, a, _, c = rig.exact_matrices(fmpq(0), inner_end_mass)
    friction, n, place = rig.effects["seal_friction"], mass.nrows(), rig.states.index("displacement_m")
    tables = ({**rig.effects, "seal_friction": {**friction, "spring_N_per_m": spring}} for spring in (0.0, 1.0))
    free, held = (replace(rig, effects=table).exact_matrices(fmpq(0), inner_end_mass)[1] for table in tables)
    pulled = mass.inv() * fmpq_mat(n, 1, [free[i, place] - held[i, place] for i in range(n)])
    own, tip = mass.inv() * a, fmpq_mat(1, n, [c[0, j] for j in range(n)])
    (above,), below = transfer(own, pulled, tip, fmpq_mat(1, 1))
    if not (above * denominator % below).is_zero():
        raise ArithmeticError("the friction drives what the plant does not show")
    return above * denominator / below
