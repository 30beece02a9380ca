"""The closed loop of the twin-beam rig as an expression in all its figures, and what is claimed of it as another."""

import ast
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import chain
from math import inf, pi

from flint import fmpq, fmpq_mpoly, fmpq_mpoly_ctx

from beamdesign.plant.assembly import pace
from beamdesign.plant.linear import TIP
from beamdesign.plant.members import LinearFamily, family, refuse_unstated
from beamdesign.polynomial import exact, in_variable, nearest
from beamdesign.proofs.bounded_error import erring
from beamdesign.proofs.certificate import Asked
from beamdesign.proofs.multiplier import weighed
from beamdesign.proofs.read_once import Expression, read_once
from beamdesign.proofs.statement import UNKNOWN, Circle, Interval, PolynomialFamily
from beamdesign.prototype import Prototype
from beamdesign.structure.lumped import figures

TRANSPORT = "transport"
FACTOR = "effect_gain"
_GAIN = "controller_gain"


def effect_spans(found: LinearFamily) -> dict[str, Interval]:
    """Spans of those parameters that are frozen figures of effects, and of the factor that they put on the gain."""
    frozen = {name: found.spans[key] for name, key in _frozen(found).items()}
    gain = found.members[0].gain
    spans = {name: (exact(span.low), exact(span.high)) for name, span in frozen.items()}
    return spans if (gain.low, gain.high) == (1.0, 1.0) else spans | {FACTOR: (exact(gain.low), exact(gain.high))}


def performing_spans(found: LinearFamily) -> dict[str, Interval]:
    """The part of these spans over which more than stability is asked; none where nothing else than stability is."""
    spans = {name: found.spans[key].performing for name, key in _frozen(found).items()}
    gain = next((one.performance for one in found.members if one.performance is not None), None)
    if gain is not None and FACTOR in effect_spans(found):
        spans[FACTOR] = gain.low, gain.high
    return {name: (exact(low), exact(high)) for name, (low, high) in spans.items()}


def _frozen(found: LinearFamily) -> dict[str, str]:
    return {key.replace(".", "_"): key for key, span in found.spans.items() if span.low < span.high}


def rig_values(prototype: Prototype, largest_outer_end_mass: float | None = None) -> dict[str, fmpq]:
    """The parameters of a prototype's characteristic polynomial, SI, frequencies in rad/s.

    These are its figures, unless they are zero, both end masses, gain and a lag's breaks, a pure delay, the frozen
    figures of its effects, and the factor that they put on the gain.

    Args:
        prototype: with a controller.
        largest_outer_end_mass: kg, as of `family`, which says what of its effects is spanned.

    Raises:
        ValueError: without a controller.
        InputError: for effects for which no linear loop stands, or more members than are proved.
    """
    controller, found = prototype.own_controller, family(prototype, largest_outer_end_mass)
    refuse_unstated(prototype, found)
    values = {name: exact(value) for name, value in figures(prototype).items() if value != 0}
    values |= {"outer_end_mass": fmpq(0), "inner_end_mass": exact(prototype.payload.inner_end_mass_kg)}
    values |= {"controller_gain": exact(controller.gain_A_per_V), "delay": fmpq(0)}
    at_rest = {name: exact(found.spans[key].rest) for name, key in _frozen(found).items()}
    at_rest |= {FACTOR: exact(found.rest.gain.high)}
    values |= {name: min(max(at_rest[name], low), high) for name, (low, high) in effect_spans(found).items()}
    if (lag := controller.lag) and not controller.lacks("lag"):
        values |= {"controller_zero": exact(2 * pi * lag.zero_Hz), "controller_pole": exact(2 * pi * lag.pole_Hz)}
    return values


def rig_family(
    prototype: Prototype,
    stages: Sequence[Mapping[str, fmpq]] = (),
    varied: Sequence[str] = (),
    claim: Asked | None = None,
    delayed: bool = True,
    varying: Mapping[str, Interval] | None = None,
    numbers: bool = False,
) -> PolynomialFamily:
    """The characteristic polynomial of a prototype's loop over all parameters in `rig_values`.

    Its plant is that of every other proof, the assembly's linear plant as the controller's sensors see it, with its
    parameters as variables; what the expression takes from its shape is found by `read_once`. The delay is between
    controller and valve. Effects that let the gain vary put one factor more on it.

    Args:
        prototype: with its controller.
        stages: that its law of one sensor is the product of, each (1 + n1 s + n2 s^2) / (1 + d1 s + d2 s^2) by those of
            these names that it has, s and s^2; stage_1_n1 and the like become parameters in the place of what the law
            has beside its gain.
        varied: figures of its effects that become parameters, such as sensor_lag.break_Hz, as sensor_lag_break_Hz.
        claim: of a magnitude; what it comes to is a polynomial too, see `claimed`.
        delayed: whether there may be a delay.
        varying: ranges of a box, where it is known: what of the actuator is chosen, such as the lead of a screw, and
            does not vary is a number then, and effects are those under the largest outer end mass.
        numbers: whether every figure of the rig that does not vary is: of several effects p has millions of terms over
            all of them.

    Raises:
        ValueError: without a controller, or for stages of a law that has no static gain to take their sign from.
        InputError: for effects for which no linear loop stands.
    """
    heaviest = nearest(varying["outer_end_mass"][1]) if varying and "outer_end_mass" in varying else None
    values, found = rig_values(prototype, heaviest), family(prototype, heaviest)
    if varying is not None:
        chosen = {row.name for row in prototype.actuator.parameters if numbers or not row.typical}
        fixed = (chosen | {*figures(prototype)} if numbers else chosen) - {*varying}
        values = {name: value for name, value in values.items() if name not in fixed}
    further = {key: key.replace(".", "_") for key in varied}
    values |= {
        name: exact(found.rest.rig.effects[(at := key.partition("."))[0]][at[2]]) for key, name in further.items()
    }
    shaping = {f"stage_{k}_{name}": value for k, one in enumerate(stages, 1) for name, value in one.items()}
    if stages:
        values = {name: value for name, value in values.items() if name not in ("controller_zero", "controller_pole")}
        values |= shaping
    context = fmpq_mpoly_ctx.get(["s", TRANSPORT, UNKNOWN, *values], "lex")
    variable = dict(zip(context.names(), context.gens(), strict=True))
    s, zero = variable["s"], context.constant(0)
    model, law = found.rest.rig, prototype.own_controller.sensed_law()
    named = {name: name for name in model.figures if name in values}
    named |= {key: name for name, key in _frozen(found).items()} | further
    error = None if claim is None else claim.error
    loop_denominator, seen = model.over_parameters(
        law.sensors if error is None else (*law.sensors, TIP), context, named
    )
    if stages:
        sides = {"n": context.constant(1), "d": context.constant(1)}
        for k, one in enumerate(stages, 1):
            for side in sides:
                terms = (variable[f"stage_{k}_{name}"] * s ** int(name[1]) for name in one if name[0] == side)
                sides[side] *= 1 + sum(terms, zero)
        if (still := law.numerators[0](0) * law.denominator(0)) == 0:
            raise ValueError("a law with a zero or a pole at zero frequency is no product of stages of static gain one")
        numerators, denominator = [sides["n"] * (1 if still > 0 else -1)], sides["d"]  # which has no sign, as the gain
    elif "controller_pole" in values:
        start, end = variable["controller_zero"], variable["controller_pole"]
        numerators, denominator = [end * (start + s)], start * (end + s)
    else:
        numerators = [in_variable(one / values["controller_gain"], s) for one in law.numerators]
        denominator = in_variable(law.denominator, s)
    gain = variable["controller_gain"] * variable.get(FACTOR, 1) * (variable[TRANSPORT] if delayed else 1)
    loop_numerator = sum((one * by for one, by in zip(numerators, seen, strict=error is None)), zero)
    p, circles, since, until = loop_denominator * denominator + gain * loop_numerator, {}, fmpq(0), None
    if claim is not None and error is not None:
        figure = {name: variable[name] if name in values else exact(value) for name, value in model.figures.items()}
        of_volts = gain * numerators[0] * seen[0]
        above = erring(error.place, seen[-1] * denominator, of_volts, figure, s) * (s + error.decay + error.corner)
        above *= error.lead[0] + error.lead[1] * (s + error.decay)
        p, circles[UNKNOWN] = p + variable[UNKNOWN] * above, Circle(fmpq(0), 1 / exact(claim.limit))
    elif claim is not None and claim.kind != "gain_margin":
        effort = variable["controller_gain"] * loop_denominator * numerators[0]
        p, circles[UNKNOWN], since, until = claimed(claim, p, gain * loop_numerator, effort)
    form = read_once(p, [name for name in values if name != "delay"], (TRANSPORT, UNKNOWN))
    if (weights := None if claim is None else claim.multiplier) is not None:
        form = weighed(form, weights)
    if error is not None:
        form = _moved(form if error.place == "volts" else _apart(form), error.decay)
    positive = [name for name in values if name not in _frozen(found) and name not in shaping]
    delays = {TRANSPORT: "delay"} if delayed else {}
    of, by = (circles, since, until, pace(model.figures)), () if error else _divisors(form)
    return PolynomialFamily(
        prototype.name, form.p, values, form.leaves, form.bound, delays, form.groups, positive, *of, by
    )


def _divisors(form: Expression) -> tuple[str, ...]:
    """The leaves that are lags of the loop, of the valve or a filter: factors of all without its gain, and no others.

    Their uncertain phase turns all of that, whose parts are large where a resonance makes them cancel.
    """

    def flat(node: ast.expr, operation: type[ast.operator]) -> list[ast.expr]:
        if isinstance(node, ast.BinOp) and isinstance(node.op, operation):
            return flat(node.left, operation) + flat(node.right, operation)
        return [node]

    body = ast.parse(form.p, mode="eval").body
    standing = Counter(node.id for node in ast.walk(body) if isinstance(node, ast.Name))
    own = {name: _names(ast.parse(leaf, mode="eval")) for name, leaf in form.leaves.items()}
    gain = next((name for name, _, members in form.groups if _GAIN in members), _GAIN)
    without = [term for term in flat(body, ast.Add) if not any(gain in own.get(name, ()) for name in _names(term))]
    if len(without) != 1:
        return ()
    factors = [one.id for one in flat(without[0], ast.Mult) if isinstance(one, ast.Name) and one.id in own]
    bound = {*chain(*form.bound)}
    return tuple(n for n in factors if "s" in own[n] and len(own[n]) > 1 and standing[n] == 1 and n not in bound)


def _apart(form: Expression) -> Expression:
    """The expression with what the unknown multiplies in a summand of its own, whose hull then stands for itself.

    Leaves that come to stand in several places are bound.
    """

    def terms(node: ast.expr) -> list[str]:
        match node if UNKNOWN in _names(node) else None:
            case ast.BinOp(left=left, op=ast.Add(), right=right):
                return terms(left) + terms(right)
            case ast.BinOp(left=left, op=ast.Mult(), right=right):
                return [f"{a}*{b}" for a in terms(left) for b in terms(right)]
        return [f"({ast.unparse(node)})"]

    found = terms(ast.parse(form.p, mode="eval").body)
    known = [_names(ast.parse(term, mode="eval")) for term in found]
    free = {name for name, leaf in form.leaves.items() if _names(ast.parse(leaf, mode="eval")) <= {"s"}}
    several = {name for k, names in enumerate(known) for name in names for other in known[:k] if name in other}
    bound = (*form.bound, *((name,) for name in sorted(several - free - {"s", UNKNOWN} - {*chain(*form.bound)})))
    return Expression(" + ".join(found), form.leaves, bound, form.groups)


def _names(node: ast.AST) -> set[str]:
    return {one.id for one in ast.walk(node) if isinstance(one, ast.Name)}


def _moved(form: Expression, decay: fmpq) -> Expression:
    """The expression at s less a decay."""
    at, name, back = re.compile(r"\bs\b"), "moved", f"s - {decay.p}/{decay.q}"
    leaves = {leaf: at.sub(f"({back})", written) for leaf, written in form.leaves.items()}
    return Expression(at.sub(name, form.p), {**leaves, name: back}, form.bound, form.groups)


_UNDER_TURN, _OVER_TURN = fmpq(333, 53), fmpq(710, 113)
"""Somewhat below and above 2 pi, as the checker takes it."""


def claimed(
    claim: Asked, p: fmpq_mpoly, loop_numerator: fmpq_mpoly, effort: fmpq_mpoly
) -> tuple[fmpq_mpoly, Circle, fmpq, fmpq | None]:
    """A magnitude as stability with one more unknown: polynomial, the unknown's circle, from and up to which frequency.

    |a / p| = limit where p + u a vanishes for some u with |u| = 1 / limit. For the compliance a is p's derivative by
    s^2 times the outer end mass: u is a spring of the size 1 / limit on the tip, turned by any angle. For S it is p
    less the loop's numerator N, and p + u (p - N) is in proportion to p - N + g N with g = 1 / (1 + u), which goes
    around a circle as u does, from 1 / (1 + 1 / limit) to 1 / (1 - 1 / limit): a gain that is turned. For |L| it is
    the gain that goes around a circle about zero. For a slope it is the gain too, with u of the size one that becomes
    a part of it (`beamdesign.proofs.multiplier`).

    Raises:
        ValueError: for another kind of claim, or a peak sensitivity of one or less, which no loop keeps.
    """
    limit, names = exact(claim.limit), p.context().names()
    unknown, s = p.context().gen(names.index(UNKNOWN)), p.context().gen(0)
    if claim.kind == "peak_sensitivity" and limit > 1:
        square = limit * limit - 1
        return p + (unknown - 1) * loop_numerator, Circle(limit * limit / square, limit / square), fmpq(0), None
    if claim.kind in ("compliance", "peak_compliance"):
        moved, _ = divmod(p.derivative("outer_end_mass"), s * s)
        bounded = None if claim.bandwidth_Hz == inf else exact(claim.bandwidth_Hz) * _OVER_TURN
        return p + unknown * moved, Circle(fmpq(0), 1 / limit), fmpq(0), bounded
    if claim.kind == "loop_gain":
        since = exact(claim.from_Hz) * _UNDER_TURN
        return p + (unknown - 1) * loop_numerator, Circle(fmpq(0), 1 / limit), since, None
    if claim.kind == "slope":
        return p + (unknown - 1) * loop_numerator, Circle(fmpq(0), fmpq(1)), fmpq(0), None
    if claim.kind == "controller_effort":
        return p + unknown * effort, Circle(fmpq(0), 1 / limit), fmpq(0), None
    raise ValueError(f"not decided over a box: {claim.kind} at most {claim.limit:g}")
