"""The text of every certificate: TOML that a person can read and `beamdesign.checker` proves again.

It states the rig that it is about as tables of texts: parameters, controller, effects, payload, goal, arm.
"""

import hashlib
from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import inf, isinf, pi
from types import MappingProxyType
from typing import Any

import tomli_w
from flint import fmpq, fmpq_mpoly_ctx
from flint.utils.flint_exceptions import DomainError

from beamdesign.parameters import PARAMETERS, rows_of
from beamdesign.plant.assembly import effect_parameters_of
from beamdesign.plant.effects import Elements, Span
from beamdesign.plant.members import family, linear_of
from beamdesign.polynomial import Crossing, bounds, exact, shortened, simple_between, text
from beamdesign.proofs.quadratic import frequency_of
from beamdesign.proofs.stability import StabilityMap
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Record
from beamdesign.spelling import one_line
from beamdesign.structure.lumped import figures

# The rig.


Tables = dict[str, Any]
_WHOLE = ("payload", "goal", "arm", "compliance")
"""Tables of a prototype that a certificate repeats."""


def rig_tables(
    prototype: Prototype,
    largest_outer_end_mass: float | None = None,
    varying: Mapping[str, tuple[fmpq, fmpq]] = MappingProxyType({}),
) -> Tables:
    """Tables from which a checker builds the loop, numbers as exact decimals in quotes.

    Args:
        prototype: with a controller of one law, or of several stages that take turns, or with none.
        largest_outer_end_mass: kg, whose weight is the load where an effect depends on it; else that of the payload.
        varying: ranges of figures of which the elements of effects are to be stated as functions, not at their values.

    Raises:
        InputError: for effects for which no linear loop stands, or whose elements are not affine in what varies.
    """
    tables: Tables = {"rig": _rig(prototype)}
    if prototype.controller is not None:
        tables["controller"] = controller_table(prototype)
    if prototype.effects:
        tables["effect"] = effect_tables(prototype, largest_outer_end_mass, varying)
    for name in _WHOLE:
        if (record := getattr(prototype, name)) is not None:
            tables[name] = stated(plain(record))
    return tables | ({"material": alloys} if (alloys := _alloys(prototype)) else {})


def plain(record: Record) -> Tables:
    """A record as a parsed table would be, every default filled in and what is absent left out."""
    return record.model_dump(mode="json", exclude_none=True)


def prototype_table(
    prototype: Prototype,
    largest_outer_end_mass: float | None = None,
    varying: Mapping[str, tuple[fmpq, fmpq]] = MappingProxyType({}),
) -> Tables:
    """A prototype as the checker compares it: every default filled in, and with what it stands on.

    That is, as a certificate states them, what stands for its effects, and the figures of its beams' alloys. The other
    arguments are those of `rig_tables`.
    """
    found = plain(prototype) | {"effects": effect_parameters_of(prototype), "material": _alloys(prototype)}
    return found | {"effect": effect_tables(prototype, largest_outer_end_mass, varying)}


def stated(value: Any) -> Any:
    """Numbers of a nested table as exact texts."""
    if isinstance(value, Mapping):
        return {key: stated(item) for key, item in value.items() if item != inf}  # which limits nothing
    if isinstance(value, list | tuple):
        return [stated(item) for item in value]
    return text(exact(value)) if isinstance(value, float | int) and not isinstance(value, bool) else value


def texts(values: Sequence[fmpq]) -> list[str]:
    """Rationals, or the coefficients of s^0, s^1, ... of a polynomial, as texts."""
    return [text(value) for value in values]


def maybe_infinite(value: float) -> str:
    """A number as text, or that it is infinite."""
    return "infinite" if isinf(value) else text(exact(value))


def _rig(prototype: Prototype) -> Tables:
    """The lumped figures, end masses not included; damping is that of fixed dashpots."""
    filtered = prototype.sensor.filter_Hz
    lumped = {name: value for name, value in figures(prototype).items() if filtered or name != "filter_frequency"}
    table = {"kind": prototype.rig} | {PARAMETERS[name].key: text(exact(value)) for name, value in lumped.items()}
    for row in rows_of(type(prototype.actuator)).values():
        if row.factor != 1.0 and row.name in lumped:  # as the prototype has it, too
            table[row.shown_key] = text(exact(row.stated(prototype)))
    return table | {"inner_end_mass_kg": text(exact(prototype.payload.inner_end_mass_kg))}


def controller_table(prototype: Prototype) -> Tables:
    """The controller's own figures, and its law: a numerator for each sensor and their denominator.

    Of one with several stages the figures of each, and every break in rad/s as well, instead of polynomials.
    """
    controller = prototype.own_controller
    if controller.schedule is not None:
        table = plain(controller)
        return stated(table | {"stage": [_with_radians(stage) for stage in table["stage"]]})
    law = controller.sensed_law()
    polynomials = {
        "sensors": list(law.sensors),
        "numerators": [texts(one.coeffs()) for one in law.numerators],
        "denominator": texts(law.denominator.coeffs()),
    }
    return stated(plain(controller)) | {"law": polynomials}


def _with_radians(table: Tables) -> Tables:
    """A stage, or a section of one, with the floats of 2 pi f of its frequencies."""
    found = {key: [_with_radians(one) for one in value] if key == "section" else value for key, value in table.items()}
    hertz = {key: value for key, value in table.items() if key.endswith("_Hz")}
    return found | {key.replace("_Hz", "_rad_per_s"): 2 * pi * value for key, value in hertz.items()}


def _alloys(prototype: Prototype) -> Tables:
    """Moduli and density of what the beams are of where figures follow from their geometry; of an arm, torsion's do."""
    found, outer = {}, prototype.outer_beam
    beams = [b for b in (outer, prototype.inner_beam) if b.stiffness_N_per_m is None or b.effective_mass_kg is None]
    for beam in beams + [outer] * (prototype.arm is not None and outer.geometry is not None):
        alloy = beam.material
        assert alloy is not None  # else its figures would be stated
        keys = ("youngs_modulus_Pa", "shear_modulus_Pa", "density_kg_per_m3")
        found[alloy.name] = stated({key: getattr(alloy, key) for key in keys})
    return found


# Effects.


def effect_tables(
    prototype: Prototype, largest_outer_end_mass: float | None, varying: Mapping[str, tuple[fmpq, fmpq]]
) -> list[Tables]:
    """Each effect with its parameters, its spans, its factors on the gain, and its elements, affine in its spans."""
    tables, found = [], family(prototype, largest_outer_end_mass, varying)
    for name, own in effect_parameters_of(prototype).items():
        spans = {key.partition(".")[2]: span for key, span in found.spans.items() if key.partition(".")[0] == name}
        table: Tables = {"name": name, "parameters": stated(own)}
        if (gain := found.gains.get(name)) is not None:
            table |= {"gain": stated((gain.low, gain.high)), "performing_gain": stated(gain.performing)}
        if spans:
            table["span"] = {
                key: {"ends": stated((span.low, span.high)), "performing": stated(span.performing)}
                for key, span in spans.items()
            }
        tables.append(table | {"elements": _elements(prototype, name, own, spans, varying)})
    return tables


def _elements(
    prototype: Prototype,
    name: str,
    own: Mapping[str, float],
    spans: Mapping[str, Span],
    varying: Mapping[str, tuple[fmpq, fmpq]],
) -> Tables:
    """Elements of an effect whose numbers are sums of numbers and of numbers times spans or figures.

    They are taken with a variable for each of these that varies, so that it is seen whether they are affine.
    """
    linear = linear_of(prototype, name)
    assert linear is not None  # it has members
    figure = {key: exact(value) for key, value in figures(prototype).items()}
    ends = {key: (exact(span.low), exact(span.high)) for key, span in spans.items()}
    ends |= {key: pair for key, pair in varying.items() if key in figure}
    free = [key for key, (low, high) in ends.items() if low < high]
    context = fmpq_mpoly_ctx.get(free, "lex")
    values: dict[str, Any] = {key: low for key, (low, _) in ends.items()} | dict(zip(free, context.gens(), strict=True))

    def refused(why: str) -> InputError:
        words = f"its elements are {why}, so that no certificate states them"
        return InputError(prototype.name, [(f"effects.{name}", words)])

    def written(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: written(one) for key, one in value.items()}
        if isinstance(value, list):
            return [written(one) for one in value]
        terms = (context.constant(0) + value).to_dict()
        if any(sum(powers) > 1 for powers in terms):
            raise refused("not affine in what it lets vary")
        constant = terms.pop((0,) * len(free), fmpq(0))
        slopes = {key: c for powers, c in terms.items() for key, power in zip(free, powers, strict=True) if power}
        parts = [f"{text(slopes[key])}*{key}" for key in free if key in slopes]
        return " + ".join([text(constant)] * (constant != 0 or not parts) + parts)

    try:
        own_values = {key: exact(value) for key, value in own.items()} | values
        elements = linear.elements(own_values, figure | values) if linear.elements else Elements()
    except (DomainError, TypeError) as error:
        raise refused(f"no sums and products of rationals and of what it lets vary ({error})") from error
    return written(_nested(elements))


def _nested(elements: Elements) -> Tables:
    """Elements as tables and lists of rationals, what says nothing left out."""
    found: Tables = {
        "oil": elements.oil,
        "spool": elements.spool,
        "asymmetry": elements.asymmetry,
        "points": {point: dict(weights) for point, weights in elements.points.items()},
        "impedance": [{"motion": dict(motion), "resists": list(resists)} for motion, resists in elements.impedances],
        "volts": [{"numerator": list(above), "denominator": list(below)} for above, below in elements.volts],
    }
    return {key: value for key, value in found.items() if value != {} and value != []}


# Stability over the outer end mass: stable ranges, and crossings between them.


STABILITY_DIGITS = 12
"""Of decimals near a crossing."""


def stability_table(stability: StabilityMap) -> Tables:
    """Ranges, each settled at its sample, and the crossings between them, as decimal enclosures."""
    groups, enclosures = stability.groups, _mass_enclosures(stability)
    starts = {id(group[0]): pair for group, pair in zip(groups, enclosures, strict=True)}
    ranges = []
    for part in stability.ranges:
        low = starts[id(part.opens_at)][1] if part.opens_at else part.low
        high = starts[id(part.closes_at)][0] if part.closes_at else part.high
        ranges.append({"low": text(low), "high": text(high), "sample": text(part.sample), "stable": part.stable})
    crossings = []
    for group, pair in zip(groups, enclosures, strict=True):
        for crossing in group:
            entry: Tables = {"outer_end_mass_kg": texts(pair), "squared_frequency": "infinite"}
            if crossing.finite:
                square = _decimals(*bounds(crossing.squared_frequency), STABILITY_DIGITS)
                hertz = _decimals(frequency_of(square[0])[0], frequency_of(square[1])[1], STABILITY_DIGITS)
                entry |= {"squared_frequency": texts(square), "frequency_Hz": texts(hertz)}
            crossings.append(entry)
    reach = _beyond(stability) if stability.stable else {}
    return {"stable": stability.stable, **reach, "range": ranges, "crossing": crossings}


def _beyond(stability: StabilityMap) -> Tables:
    """How far a stable range reaches past what was asked, up to the next crossing or down to no mass at all."""
    above, below, found = stability.above, stability.below, {}
    if above is None:
        found["stays_stable_to_kg"] = "infinite"
    else:
        most = _enclosure(above)[0] if above.rational is None else simple_between(stability.high, above.rational)
        if most > stability.high:
            found["stays_stable_to_kg"] = text(most)
    if stability.low > 0:
        least = fmpq(0)
        if below is not None and below.rational is not None and below.rational >= 0:
            least = simple_between(below.rational, stability.low)
        elif below is not None:
            least = max(least, _enclosure(below)[1])
        if least < stability.low:
            found["stays_stable_from_kg"] = text(least)
    return found


def _mass_enclosures(stability: StabilityMap) -> list[tuple[fmpq, fmpq]]:
    """Short decimals around each group of crossings, with as many digits as keep them and the samples apart."""
    digits = STABILITY_DIGITS
    samples = [part.sample for part in stability.ranges]
    while True:
        found = []
        for group in stability.groups:
            pairs = [_enclosure(crossing, digits) for crossing in group]
            found.append((min(pair[0] for pair in pairs), max(pair[1] for pair in pairs)))
        apart = all(before[1] < after[0] for before, after in pairwise(found))
        clear = all(not low <= sample <= high for sample in samples for low, high in found)
        inside = all(stability.low <= low and high <= stability.high for low, high in found)
        if (apart and clear and inside) or digits > 1000:
            return found
        digits *= 2


def _enclosure(crossing: Crossing, digits: int = STABILITY_DIGITS) -> tuple[fmpq, fmpq]:
    if crossing.rational is not None:
        return crossing.rational, crossing.rational
    return _decimals(*bounds(crossing.parameter), digits)


def _decimals(low: fmpq, high: fmpq, digits: int) -> tuple[fmpq, fmpq]:
    """Decimals of so many digits around a narrow interval; what is a decimal itself as it is."""
    if low == high and "/" not in text(low):
        return low, high
    return shortened(low, digits), shortened(high, digits, up=True)


# The text.


VERSION = 2
_NOTES = {
    "rig": "The lumped figures of the model, end masses not included; damping is that of fixed dashpots. SI.",
    "controller": "From error volts to current; numerators and denominator list the coefficients of s^0, s^1, ...",
    "effect": "What stands for an effect: springs, dashpots, masses, filters; numbers may be times a span.",
    "loop": "The closed loop p0 + m p1 over the end mass m, in kg, at every combination of the ends of spans.",
    "stability": "Over the outer end mass. Roots cross the imaginary axis at the crossings and nowhere else.",
}


def certificate(
    kind: str,
    subject: Prototype | str,
    body: Mapping[str, Any],
    summary: str,
    largest_outer_end_mass: float | None = None,
    notes: Mapping[str, str] | None = None,
    varying: Mapping[str, tuple[fmpq, fmpq]] = MappingProxyType({}),
) -> str:
    """Write a certificate.

    Args:
        kind: of `beamdesign.checker.KINDS`.
        subject: the rig that it is about, or the name of what is no rig.
        body: what it states of it: nested tables, with every number as text or a whole number.
        summary: the result in words, put on top as a comment.
        largest_outer_end_mass: kg, as `rig_tables` takes it.
        notes: what to say above a table, by its name.
        varying: figures that are not at their values, as `rig_tables` takes them.
    """
    head = [
        *(f"# {one_line(line)}".rstrip() for line in summary.splitlines()),
        "#",
        "# To prove it again, with python-flint alone: python -m beamdesign.checker THIS-FILE [PROTOTYPE]",
        "# Lines that begin with # explain and prove nothing. All numbers are exact: decimals or quotients, as text.",
        "# The checksum is of the text without its own line.",
        "",
        f'kind = "{kind}"',
        f"version = {VERSION}",
        "",
    ]
    tables: dict[str, Any] = {"name": subject if isinstance(subject, str) else subject.name}
    if not isinstance(subject, str):
        tables |= rig_tables(subject, largest_outer_end_mass, varying)
    tables |= body
    lines = tomli_w.dumps(tables).splitlines(keepends=True)
    words = {**_NOTES, **(notes or {})}
    for name, note in words.items():
        heads = [k for k, line in enumerate(lines) if line.startswith((f"[{name}]", f"[[{name}]]", f"{name} = "))]
        if heads:
            lines[heads[0]] = f"# {note}\n{lines[heads[0]]}"
    above, below = "\n".join(head), "".join(lines)
    return f'{above}sha256 = "{hashlib.sha256((above + below).encode()).hexdigest()}"\n{below}'
