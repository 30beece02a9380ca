"""Every linear member of a prototype over end masses and factors on the gain; what all have in common, in words."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from flint import fmpq

from beamdesign.crossing import Crossing
from beamdesign.loop import rig_loop
from beamdesign.members import LinearFamily, Member, family
from beamdesign.polynomial import exact
from beamdesign.proof.rational import nearest, simple_between
from beamdesign.proof.rectangle import (
    Rectangle,
    scaled,
)
from beamdesign.proof.stability import Range, StabilityMap, in_words, stable_ranges
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem
from beamdesign.rig.effects import library

_STEPS, _HALVINGS = 64, 24
"""Where a gain between its ends is unstable, a range of masses gives way by this share of itself at a time; how often
the last of these steps is halved."""


@dataclass(frozen=True)
class Proved:
    """A member with the rectangle over which it is to be stable, and that over which it is to perform, if it is."""

    member: Member
    stable: Rectangle
    performing: Rectangle | None


def rectangles(prototype: Prototype, found: LinearFamily, low: fmpq, high: fmpq) -> list[Proved]:
    """Each member's loop over masses and factors on the gain."""
    controller = prototype.controller
    if controller is None:
        raise ValueError("the prototype has no [controller]")
    found_loops = []
    for member in found.members:
        loop = rig_loop(member.rig, prototype.payload.inner_end_mass_kg, controller)
        stable = Rectangle(loop, low, high, exact(member.gain.low), exact(member.gain.high))
        inside = member.performance
        if inside is not None and inside.low < inside.high and not loop.gain_and_mass_apart:
            raise InputError(prototype.name, gain_and_mass(prototype, nearest(high)))
        performing = None if inside is None else replace(stable, least=exact(inside.low), most=exact(inside.high))
        found_loops.append(Proved(member, stable, performing))
    return found_loops


def gain_and_mass(prototype: Prototype, high_kg: float) -> list[Problem]:
    """What to change where mass and gain multiply each other: sides do not decide what is claimed of magnitudes."""
    reason = (
        "lets the gain vary where the loop is to perform, which is not proved where the end mass shows in what is fed"
        " back, as it does with added sensors or one that rides on the mount; remove it"
    )
    varying = []
    for name, table in prototype.effects.items():
        alone = family(prototype.but(effects={name: table}), high_kg).members
        spans = [member.performance for member in alone if member.performance is not None]
        varying += [name] if any(span.low < span.high for span in spans) else []
    return [Problem(f"effects.{name}", reason) for name in varying]


def common_ranges(parts: Sequence[Rectangle], low: fmpq, high: fmpq) -> StabilityMap:
    """The masses at which all rectangles are stable for all of their gains.

    Ends are crossings of some member at one end of its gains. Where a gain between the ends is not stable at a mass at
    which both ends are, the range gives way: what is left is proved, but need not be all.
    """
    maps = [
        stable_ranges(scaled(part.loop, factor).characteristic, low, high)
        for part in parts
        for factor in sorted({part.least, part.most})
    ]
    if len(maps) == 1:
        return maps[0]
    common = [part for part in maps[0].ranges if part.stable]
    for other in maps[1:]:
        common = [piece for one in common for two in other.ranges if two.stable and (piece := _both(one, two))]
    common = [piece for one in common if (piece := _given_way(parts, one))]
    filled: list[Range] = []
    reached: fmpq = low
    for piece in common:
        if reached < piece.low:
            filled.append(_unstable(reached, piece.low))
        filled.append(piece)
        reached = piece.high
    if reached < high or not common:
        filled.append(_unstable(reached, high))
    crossings = _listed(crossing for found in maps for crossing in found.crossings)
    below = _listed(found.below for found in maps if found.below is not None)
    above = _listed(found.above for found in maps if found.above is not None)
    reason = in_words(filled, crossings).replace("unstable from", "not every loop is stable from")
    if not common:
        reason = "no range of masses was found over which every loop is stable"
    return StabilityMap(
        low, high, crossings, tuple(filled), below[-1] if below else None, above[0] if above else None, reason
    )


def _listed(crossings: Iterable[Crossing]) -> tuple[Crossing, ...]:
    return tuple(sorted(crossings, key=lambda crossing: crossing.value))


def _unstable(low: fmpq, high: fmpq) -> Range:
    return Range(low, high, None, None, low, False)


def _both(one: Range, two: Range) -> Range | None:
    """Masses in two stable ranges."""
    first, last = max((one, two), key=lambda part: part.low), min((one, two), key=lambda part: part.high)
    if first.low > last.high or (first.low == last.high and (first.opens_at or last.closes_at)):
        return None
    sample = first.low if first.low == last.high else simple_between(first.low, last.high)
    return Range(first.low, last.high, first.opens_at, last.closes_at, sample, True)


def _given_way(parts: Sequence[Rectangle], piece: Range) -> Range | None:
    """The range less what is needed for every gain between the ends to be stable, too; None where nothing is left."""
    step = (piece.high - piece.low) / _STEPS

    def stands(mass: fmpq) -> bool:
        return all(side.stable for part in parts for side in replace(part, low=mass, high=mass).sides())

    if step == 0:
        return piece if stands(piece.low) else None

    def first(start: fmpq, step: fmpq) -> fmpq:
        """The mass nearest to the start that was found to stand, in steps and then by halving the last."""
        if stands(start):
            return start
        failed, found = start, start + step
        while piece.low <= found <= piece.high and not stands(found):
            failed, found = found, found + step
        for _ in range(_HALVINGS):
            middle = (found + failed) / 2
            failed, found = (failed, middle) if stands(middle) else (middle, found)
        return found

    low, high = first(piece.low, step), first(piece.high, -step)
    if low > high or any(replace(part, low=low, high=high).inside() is not None for part in parts):
        return None
    opens, closes = (piece.opens_at if low == piece.low else None), (piece.closes_at if high == piece.high else None)
    sample = low if low == high else simple_between(low, high)
    return Range(low, high, opens, closes, sample, True)


def scope(prototype: Prototype, found: LinearFamily) -> str:
    """What the proof is about, in one sentence."""
    members = "one linear loop stands" if len(found.members) == 1 else f"{len(found.members)} linear loops stand"
    effects = f"{members} for the effects {', '.join(sorted(prototype.effects))}"
    return f"{effects}, at frozen values" if bracketing(prototype) else effects


def covered(prototype: Prototype, found: LinearFamily) -> list[str]:
    """Per effect what the proof covers and what it leaves out, in words; then the gains and the load."""
    lines = []
    for name in sorted(prototype.effects):
        linear = library()[name].linear
        assert linear is not None  # the family exists
        out = f"; not covered: {linear.leaves_out}" if linear.leaves_out else ""
        lines.append(f"{name}: {linear.covers}{out}.")
    gain = found.members[0].gain
    inside = next(member.performance for member in found.members if member.performance is not None)
    if gain.low != gain.high:
        lines.append(f"Stability is about every constant factor on the gain from {gain.low:.6g} to {gain.high:.6g}.")
        if inside != gain:
            to = "" if inside.low == inside.high else f" to {inside.high:.6g}"
            lines.append(f"Compliance and peak sensitivity are about factors of {inside.low:.6g}{to}.")
    lines += [
        f"{name}: {' and '.join(f'{end:.6g}' for end in sorted({span.low, span.high}))}."
        for name, span in found.spans.items()
    ]
    if any(span.low < span.high for span in found.spans.values()):
        lines.append(
            "This proof is about the ends of these figures; `beamdesign certify-box` proves what lies between."
        )
    if found.depends_on_load:
        lines.append(f"These hold for a steady load of up to {found.load_N:.6g} N.")
    lines.append(NOT_COVERED if bracketing(prototype) else ALL_LINEAR)
    return lines


NOT_COVERED = (
    "Proved are linear loops that bracket the effects at frozen values, not the nonlinear loop: limit cycles, and what"
    " changes while it moves, are not covered."
)
ALL_LINEAR = "These effects are linear: what is proved is the loop that `beamdesign simulate` runs."


def bracketing(prototype: Prototype) -> bool:
    """Whether an effect is not linear itself, so that its linear loops only bracket it."""
    members = [library()[name].linear for name in prototype.effects]
    return any(member is None or member.laws is not None for member in members)
