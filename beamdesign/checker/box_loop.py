"""The loop of a rig over a box of its figures, and whether an expression is its polynomial.

The loop is built from the rig, its controller and its effects, with a variable for whatever varies, and compared with
the expression multiplied out: they may differ by a number, and by powers of what is positive.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product
from math import prod
from typing import Any

from flint import fmpq, fmpq_mpoly, fmpq_mpoly_ctx, fmpq_poly

from beamdesign.checker.expressions import MOST_PRODUCTS, UNKNOWN, Expression
from beamdesign.checker.law import SENSED, decimal
from beamdesign.checker.mechanics import Elements, Number, Parts
from beamdesign.checker.reading import Statements, Table, Unreadable, rational, short, span
from beamdesign.checker.rig import MOST_MEMBERS, ONCE, Rig, refuse_size, without_unit
from beamdesign.checker.roots import Pair, is_hurwitz
from beamdesign.checker.work import spend, times

# That the expression is the polynomial of the rig.


DEVIATIONS = {
    f"{beam}_{name}": key
    for beam in ("outer", "inner")
    for name, key in (("stiffness", "stiffness"), ("mass", "effective_mass"), ("damping", "beam_damping_ratio"))
} | {
    "oil_stiffness": "oil_stiffness", "piston_area": "piston_area", "flow_gain": "flow_gain", "leakage": "leakage",
    "valve_frequency": "valve_natural_frequency", "valve_damping_ratio": "valve_damping_ratio",
    "screw_stiffness": "screw_stiffness", "screw_damping": "screw_damping", "lead": "lead",
    "torque_constant": "torque_constant", "rotor_inertia": "rotor_inertia", "rotor_friction": "rotor_friction",
    "speed_feedback": "speed_feedback", "current_loop": "current_loop", "sensor_gain": "sensor_gain",
    "filter_frequency": "sensor_filter", "outer_end_mass": "outer_end_mass", "inner_end_mass": "inner_end_mass",
}  # fmt: skip
"""The entry of [tolerance] for each figure."""
_OF_ANY_LOOP = "controller_gain", "controller_zero", "controller_pole", "effect_gain", "outer_end_mass", "delay"
"""What varies in a box beside the figures of its rig, or would if its law had it."""
_HALVINGS = 40


def of_rig(table: Table, expression: Expression, rig: Rig) -> Statements:
    """That the expression is that of the rig's loop, and what each range is of the rig's own figure."""
    own, made = figures(rig), spans(rig)
    left = ("outer_end_mass", "delay") if expression.delay else ("outer_end_mass",)
    needed = {*left, *made}
    if wrong := sorted(expression.ranges.keys() - own.keys() - needed | needed - expression.ranges.keys()):
        raise Unreadable(f"not figures of this rig, or left out of its box: {', '.join(wrong)[:300]}")
    negative = (name for name in expression.ranges if name in (*left, *own) and expression.ranges[name][0] < 0)
    if expression.delay not in (None, "delay") or any(negative):
        raise Unreadable("figures of a rig, delay and outer end mass must not be negative")
    deviations = deviations_of(table, own)
    for name, ends in expression.ranges.items():
        if name in own and not ends[0] <= own[name] <= ends[1]:
            yield False, f"{name}: the rig's own, {short(own[name])}, is not within {words_of(ends)}"
        elif ends[0] < ends[1] or name in needed:
            share = f"{_share(name, ends, own, deviations)}{_of_effects(name, made)}"
            yield True, f"{'for every' if ends[0] < ends[1] else 'with'} {name} {words_of(ends)}{share}"
    for name, whole in made.items():
        low, high = expression.ranges[name]
        if not low <= whole[0] <= whole[1] <= high:
            words = f"{words_of((low, high))} leaves out some of {span(whole)} that effects make of it"
            yield False, f"{name}: {words}"
    proved = alike(expression, characteristic(expression, rig))
    yield proved, f"the expression is {'' if proved else 'NOT '}the characteristic polynomial of this rig's loop"


def figures(rig: Rig) -> dict[str, fmpq]:
    """What of a rig may vary in a box and has a figure of its own, by name without unit."""
    if rig.law is None:
        raise Unreadable("there is no [controller]")
    found = {without_unit(key): value for key, value in rig.figures.items()}
    found |= {"inner_end_mass": rig.inner_end_mass}
    if "gain_A_per_V" in rig.law.figures:
        found["controller_gain"] = rational(rig.law.figures["gain_A_per_V"], "controller.gain_A_per_V")
    above, below = rig.law.of_displacement
    of_gain = above[0] == found.get("controller_gain", fmpq(0)) * below[0] != 0  # what _parts builds of them
    if len(rig.law.numerators) == 1 and above.degree() == below.degree() == 1 and of_gain:
        found |= {"controller_zero": above[0] / above[1], "controller_pole": below[0] / below[1]}
    return found


def spans(rig: Rig, performing: bool = False) -> dict[str, Pair]:
    """What effects make of each span and of the gain, by name in a box, or where of it more than stability is asked."""
    own = {name: rig.effects[k].spans[key] for name, (k, key) in _places(rig).items()}
    found = {name: one.performing if performing else one.ends for name, one in own.items()}
    return found | ({"effect_gain": rig.gain(performing)} if rig.gain() != ONCE else {})


def _places(rig: Rig) -> dict[str, tuple[int, str]]:
    """Spans of effects by their names in a box: which effect's, and which."""
    found: dict[str, tuple[int, str]] = {}
    taken = {*figures(rig), *_OF_ANY_LOOP}
    for k, effect in enumerate(rig.effects):
        for name, made in effect.spans.items():
            called = f"{effect.name}_{name}"
            if called in taken:
                raise Unreadable(f"{called[:60]} stands for more than one thing in a box")
            taken.add(called)
            found |= {called: (k, name)} if made.ends[0] < made.ends[1] else {}
    return found


def characteristic(
    expression: Expression, rig: Rig, claim: str = "", weights: Sequence[fmpq_poly] = (), place: str = ""
) -> fmpq_mpoly:
    """Of the rig's loop, in s, the delay's exponential and what varies; all else is the rig's own number.

    Of a claim with the unknown: see `CLAIMS`. A slope and a deviation have weights of the opened loop, of the loop and
    of what the unknown adds, a deviation the place of an error as well.
    """
    forward, loop, above = _parts(expression, rig, claim, place)
    if weights:
        s = forward.context().gen(0)
        of_denominator, plain, turned = (_polynomial(one.coeffs(), s) for one in weights)
        return of_denominator * forward + plain * loop + turned * above
    return forward + above if claim in ("peak_sensitivity", "loop_gain") else forward + loop + above


def opens_stable(expression: Expression, rig: Rig, member: Mapping[str, fmpq]) -> bool:
    """Whether one member is stable when its loop is opened, and every member's loop falls off at high frequencies."""
    forward, loop, _ = _parts(expression, rig, "slope")
    denominator = at_member(forward, member)
    return loop.degrees()[0] < forward.degrees()[0] == denominator.degree() and is_hurwitz(denominator)


def at_member(polynomial: fmpq_mpoly, member: Mapping[str, fmpq]) -> fmpq_poly:
    """In s, which is the first variable, at one member; none where something else is left, such as a delay."""
    names = [str(name) for name in polynomial.context().names()]
    found = fmpq_poly([0])
    for powers, c in polynomial.subs({name: member[name] for name in names if name in member}).terms():
        if any(powers[1:]):
            return fmpq_poly([0])
        found += fmpq_poly([0] * int(powers[0]) + [c])
    return found


def _polynomial(coefficients: Sequence[Number], s: fmpq_mpoly) -> fmpq_mpoly:
    return sum((c * s**k for k, c in enumerate(coefficients)), 0 * s)


def _parts(expression: Expression, rig: Rig, claim: str, place: str = "") -> tuple[fmpq_mpoly, fmpq_mpoly, fmpq_mpoly]:
    """The opened loop, what feedback adds to it, and what the unknown adds, nothing where there is none."""
    law, own = rig.law, figures(rig)
    assert law is not None  # there are figures of a loop
    special = [expression.transport] * bool(expression.transport) + [UNKNOWN] * bool(expression.circle)
    varying = (name for name, (low, high) in expression.ranges.items() if low < high)
    context = fmpq_mpoly_ctx.get(["s", *special, *varying], "lex")
    variable = dict(zip(context.names(), context.gens(), strict=True))
    none = context.constant(0)
    unknown = variable.get(UNKNOWN, none)
    value: dict[str, Number] = own | {name: variable.get(name, low) for name, (low, _) in expression.ranges.items()}

    def ring(coefficients: Sequence[Number]) -> fmpq_mpoly:
        return _polynomial(coefficients, variable["s"])

    parts = Parts({key: value[without_unit(key)] for key in rig.figures}, _elements(rig, expression, value), ring)
    refuse_size(parts.elements, law)
    if {"controller_zero", "controller_pole"} & expression.ranges.keys():
        zero, pole, gain = (value[f"controller_{name}"] for name in ("zero", "pole", "gain"))
        numerators = {SENSED[0]: ring([gain * pole * zero, gain * pole])}
        denominator = ring([zero * pole, zero])
    else:
        share = value["controller_gain"] / own["controller_gain"] if "controller_gain" in expression.ranges else fmpq(1)
        numerators = {name: share * ring(one.coeffs()) for name, one in law.numerators.items()}
        denominator = ring(law.denominator.coeffs())
    masses = value["outer_end_mass"], value["inner_end_mass"]
    at = parts.mechanics(masses, list(numerators), claim.endswith("compliance"), bool(place))
    around, back = parts.electronics(numerators, denominator)
    factor = value.get("effect_gain", fmpq(1)) * variable.get(expression.transport, fmpq(1))
    forward = times(at.determinant, around)
    loop = factor * sum((times(by, at.sensed[name]) for name, by in back.items()), none)
    if place:
        own = factor * times(back[SENSED[0]], at.sensed[SENSED[0]])
        known = parts.strayed(at.strayed, around, own, len(numerators) == 1)
        if place not in known:
            raise Unreadable("what such an error does to the tip is not known of this rig")
        above = known[place]
    elif claim in ("", "gain_margin", "peak_sensitivity", "loop_gain", "slope"):
        above = loop
    elif claim == "controller_effort":
        above = times(at.determinant, numerators[SENSED[0]] * (around / denominator))
    else:
        crossed = sum((times(by, at.crossed[name]) for name, by in back.items()), none)
        above = times(at.moved, around) + factor * crossed
    return forward, loop, unknown * above


def _elements(rig: Rig, expression: Expression, value: Mapping[str, Number]) -> Elements:
    """Those of all effects over their spans; what has to be positive is so at all corners, hence between."""
    places = [(name, *place) for name, place in _places(rig).items()]
    fixed = [{name: span.ends[0] for name, span in effect.spans.items()} for effect in rig.effects]
    ends = [sorted({*expression.ranges[name]}) for name, _, _ in places]
    if sum(len(pair) - 1 for pair in ends) > MOST_MEMBERS.bit_length() - 1:
        raise Unreadable("more spans of effects vary than are looked at")

    def at(chosen: Sequence[Any]) -> list[dict[str, Any]]:
        values: list[dict[str, Any]] = [dict(own) for own in fixed]
        for (_, k, name), one in zip(places, chosen, strict=True):
            values[k][name] = one
        return values

    for corner in product(*ends):
        rig.elements(at(corner))
    total = Elements()
    for effect, own in zip(rig.effects, at([value[name] for name, _, _ in places]), strict=True):
        effect.add_to(total, {**value, **own})
    return total


def alike(expression: Expression, loop: fmpq_mpoly) -> bool:
    """Whether the expression is a polynomial, times a number and powers of what is positive."""
    context = loop.context()
    variable = dict(zip(context.names(), context.gens(), strict=True))
    parameter = {name: variable.get(name, low) for name, (low, _) in expression.ranges.items()}
    one = context.constant(1)

    def stands_for(name: str) -> fmpq_mpoly:
        if name in ("s", expression.transport, UNKNOWN):
            return variable[name]
        kind, members = expression.groups.get(name, ("sum", [name]))
        together: Callable[..., fmpq_mpoly] = prod if kind == "product" else sum
        return together((parameter[member] for member in members), start=one * int(kind == "product"))

    whole = expression.over_all()
    names = list(whole.context().names())
    many = [len(expression.groups[n][1]) if expression.groups.get(n, ("",))[0] == "sum" else 1 for n in names]
    count = sum(prod(m ** int(e) for m, e in zip(many, powers, strict=True)) for powers in whole.monoms())
    if count > MOST_PRODUCTS:
        raise Unreadable("the expression has too many terms over the parameters of its groups")
    spend(5 * len(names) * (count + len(loop)))
    # What enters by its reciprocal: p times its highest power.
    turned = {k: whole.degrees()[k] for k, name in enumerate(names) if name in expression.reciprocal}
    terms = {
        tuple(turned[k] - power if k in turned else power for k, power in enumerate(map(int, powers))): c
        for powers, c in whole.terms()
    }
    stated = whole.context().from_dict(terms).compose(*map(stands_for, names), ctx=context)
    if stated == 0 or loop == 0:
        return False
    stated, loop = (_without_powers(p, expression.ranges) for p in (stated, loop))
    ratio = loop.leading_coefficient() / stated.leading_coefficient()
    return bool(stated * ratio == loop)


def _without_powers(polynomial: fmpq_mpoly, ranges: Mapping[str, Pair]) -> fmpq_mpoly:
    """Without the powers of positive parameters that all its terms have."""
    context = polynomial.context()
    for name, variable in zip(context.names(), context.gens(), strict=True):
        if name in ranges and ranges[name][0] > 0:
            k = context.names().index(name)
            polynomial = polynomial / variable ** min(int(powers[k]) for powers in polynomial.monoms())
    return polynomial


# In words.


def words_of(ends: Pair) -> str:
    """A range, or the one figure that it is."""
    return short(ends[0]) if ends[0] == ends[1] else span(ends)


def _share(name: str, ends: Pair, own: Mapping[str, fmpq], deviations: Mapping[str, Sequence[fmpq]]) -> str:
    """A range as parts of the rig's own figure, and in standard deviations where these are stated."""
    if name not in own or own[name] == 0:
        return ""
    low, high = (float(short(100 * (end / own[name] - 1), up, 4)) for end, up in zip(ends, (True, False), strict=True))
    words = f", {low:+.4g} % to {high:+.4g} % of the rig's {short(own[name])}"
    if any(deviations.get(name, ())):
        count = sigmas(ends, own[name], *deviations[name])
        words += f", {count} standard deviation{'' if count == '1' else 's'}"
    return words


def _of_effects(name: str, made: Mapping[str, Pair]) -> str:
    """What the effects themselves allow."""
    maker = "its effects make" if name == "effect_gain" else "the effect makes"
    return f", of {words_of(made[name])} that {maker} of it" if name in made else ""


def deviations_of(table: Table, own: Mapping[str, fmpq]) -> dict[str, list[fmpq]]:
    """Relative standard deviations behind each figure: its own, and for a dashpot those of stiffness and mass."""
    entries = Table(table.optional("tolerance").whole_of_it(), "tolerance")
    stated = {key: entries.at_least(key, 0) for key in entries.keys}
    found = {name: [stated.get(DEVIATIONS[name], fmpq(0))] for name in own if name in DEVIATIONS}
    for name in ("outer_damping", "inner_damping"):
        found[name] += [stated.get(key, fmpq(0)) for key in ("stiffness", "effective_mass")]
    return found


def left_exact(table: Table, rig: Rig) -> Iterator[str]:
    """Figures that the stated tolerances let be off and the box does not, in words."""
    own, box = figures(rig), Table(table.optional("range").whole_of_it(), "range")
    narrow = {name for name in box.keys if box.range(name)[0] == box.range(name)[1]} | own.keys() - {*box.keys}
    if names := [name for name, off in deviations_of(table, own).items() if name in narrow and own[name] and any(off)]:
        yield f"that {', '.join(names)} are as stated: [tolerance] lets them be off, and the box does not"


def sigmas(ends: Pair, figure: fmpq, *deviations: fmpq) -> str:
    """How many standard deviations to either side a range holds, to four digits, rounded down."""
    least, most = fmpq(0), 1 / max(deviations)
    for _ in range(_HALVINGS):
        middle = (least + most) / 2
        least, most = (middle, most) if holds(ends, figure, middle, *deviations) else (least, middle)
    near = short(most, digits=4)  # a whole number is never met by halves
    return near if holds(ends, figure, decimal(float(near)), *deviations) else short(least, up=False, digits=4)


def holds(ends: Pair, figure: fmpq, n: fmpq, *deviations: fmpq) -> bool:
    """Whether a range holds so many standard deviations to either side; none does where they would reach zero.

    Of a dashpot 2 zeta sqrt(K M), with those of zeta, K and M all at once.
    """
    own, *behind = deviations
    if not all(n * one < 1 for one in deviations):
        return False
    squares = [figure**2 * (1 + e * own) ** 2 * prod(1 + e * one for one in behind) for e in (-n, n)]
    return ends[0] ** 2 <= squares[0] and squares[1] <= ends[1] ** 2
