"""The rig that a certificate states, and the loops that follow from it.

Effects stand as elements with numbers: springs, dashpots and masses between named coordinates, factors, filters. Where
an effect lets a number of them vary, or the loop's gain, it states a span; the loops are those of every combination of
the ends of all spans, at every gain.
"""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import prod
from typing import Any

from flint import fmpq, fmpq_poly

from beamdesign.checker.law import SENSED, Law, Schedule, same_frequency
from beamdesign.checker.mechanics import Elements, Number, Parts, add_weights
from beamdesign.checker.reading import HIGHEST_DEGREE, Statements, Table, Unreadable, rational, short
from beamdesign.checker.roots import ZERO, Pair, Polynomials, plus

FIGURES = (
    "outer_stiffness_N_per_m", "outer_mass_kg", "outer_damping_N_s_per_m", "inner_stiffness_N_per_m", "inner_mass_kg",
    "inner_damping_N_s_per_m", "sensor_gain_V_per_m",
)  # fmt: skip
OF_ACTUATOR = {
    "twin_beam": (
        "oil_stiffness_N_per_m", "piston_area_m2", "flow_gain_m3_per_s_per_A", "leakage_m3_per_s_per_Pa",
        "valve_frequency_rad_per_s", "valve_damping_ratio",
    ),
    "ball_screw": (
        "screw_stiffness_N_per_m", "screw_damping_N_s_per_m", "lead_m_per_rad", "torque_constant_N_m_per_A",
        "rotor_inertia_kg_m2", "rotor_friction_N_m_s_per_rad", "speed_feedback_A_s_per_rad", "current_loop_rad_per_s",
    ),
}  # fmt: skip
"""Figures of the actuator, by the kind of rig."""
_UNIT = re.compile(
    r"_(N_m_s_per_rad|N_m_per_A|A_s_per_rad|m_per_rad|kg_m2|N_per_m|N_s_per_m|kg|m2|m3_per_s_per_A|m3_per_s_per_Pa"
    r"|rad_per_s|V_per_m)$",
    re.ASCII,
)
MAY_BE_ZERO = (
    "outer_damping_N_s_per_m", "inner_damping_N_s_per_m", "leakage_m3_per_s_per_Pa", "rotor_friction_N_m_s_per_rad",
    "speed_feedback_A_s_per_rad", "screw_damping_N_s_per_m",
)  # fmt: skip
_FED_BACK = "speed_feedback_A_s_per_rad"
MOST_MEMBERS = 64
"""Combinations of the ends of spans: twice what all effects together come to."""
POINTS = {"tip", "rod", "base", "sensed", "slide"}
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,60}", re.ASCII)
ONCE: Pair = (fmpq(1), fmpq(1))
"""A factor of one."""

PLACES = {"law": "law's current or behind its spool", "motor": "motor's current"}
"""Where a static characteristic may be."""

Values = Mapping[str, Number]
"""Of spans, by name."""


def without_unit(name: str) -> str:
    """A figure's name without its unit."""
    return _UNIT.sub("", name)


class Entry:
    """A number of an element, or a sum of numbers and of numbers times spans of its effect or figures of the rig."""

    def __init__(self, text: Any, place: str, spans: Collection[str]) -> None:
        self._parts: dict[str, fmpq] = {}  # coefficients by the span's name, "" for none
        for part in text.split(" + ") if isinstance(text, str) else (text,):
            number, star, name = part.partition("*") if isinstance(part, str) else (part, "", "")
            if (star and not _NAME.fullmatch(name)) or name in self._parts:
                raise Unreadable(f"{place} is not a number, nor a sum of numbers times spans: {str(text)[:60]!r}")
            self._parts[name] = rational(number, place)
        if unknown := sorted(self._parts.keys() - {"", *spans}):
            raise Unreadable(f"{place}: no span {', '.join(unknown)}")

    def at(self, values: Values) -> Number:
        """Its value at some values of the spans."""
        return sum((c * values[name] if name else c for name, c in self._parts.items()), fmpq(0))


@dataclass(frozen=True)
class Span:
    """What a number of an effect takes, and where in it more than stability is asked."""

    ends: Pair
    performing: Pair


class Effect:
    """An effect as it stands in a proof.

    Attributes:
        name: what it is called.
        parameters: as they are stated.
        gain: factors on the loop's gain, for stability.
        performing: those of them at which more is asked.
        spans: by name.
    """

    def __init__(self, table: Table, figures: Collection[str]) -> None:
        self._figures = figures  # of the rig, without units, which impedances and filters may be times
        self.name = table.word("name")
        given = table.table("parameters")
        self.parameters = {key: given.number(key) for key in given.keys}
        self.gain = table.range("gain", least=0) if "gain" in table else ONCE
        self.performing = _within(table, "performing_gain", self.gain)
        spans = table.optional("span")
        self.spans = {}
        for name in spans.keys:
            ends = (span := spans.table(name)).range("ends")
            self.spans[name] = Span(ends, _within(span, "performing", ends))
        made = table.table("elements")
        scalars = {key: self._entry(made, key) for key in ("oil", "spool", "asymmetry") if key in made}
        points = made.optional("points")
        weights = {at: self._weights(points.table(at)) for at in points.keys}
        if unknown := sorted(weights.keys() - POINTS):
            raise Unreadable(f"{made.place}.points: not known: {', '.join(unknown)}")
        if any(moved.keys() & POINTS for moved in weights.values()):
            raise Unreadable(f"{made.place}.points: what is added to a point is a motion of coordinates")
        impedances = [
            (self._weights(one.table("motion")), self._list(one, "resists")) for one in made.tables("impedance")
        ]
        if any(len(resists) > 3 for _, resists in impedances):
            raise Unreadable(f"{made.place}.impedance: resists is a spring, a dashpot and a mass")
        volts = [(self._list(one, "numerator"), self._list(one, "denominator")) for one in made.tables("volts")]
        self._elements = {**scalars, "points": weights, "impedances": impedances, "volts": volts}

    def _entry(self, table: Table, key: str) -> Entry:
        return Entry(table.take(key), table.place_of(key), self.spans)

    def _list(self, table: Table, key: str) -> list[Entry]:
        return [Entry(text, table.place_of(key), {*self.spans, *self._figures}) for text in table.entries(key)]

    def _weights(self, table: Table) -> dict[str, Entry]:
        if wrong := [name for name in table.keys if name.startswith("oil") or not _NAME.fullmatch(name)]:
            raise Unreadable(f"{table.place}: not a coordinate: {', '.join(wrong)[:100]}")
        return {name: self._entry(table, name) for name in table.keys}

    def add_to(self, total: Elements, values: Values) -> None:
        """Add its elements, at some values of its spans, which may be variables."""

        def at(part: Any) -> Any:
            if isinstance(part, dict):
                return {name: at(inner) for name, inner in part.items()}
            return [at(inner) for inner in part] if isinstance(part, list | tuple) else part.at(values)

        found = at(self._elements)
        total.impedances += found["impedances"]
        total.volts += found["volts"]
        for point, weights in found["points"].items():
            add_weights(total.points[point], weights)
        total.oil *= found.get("oil", fmpq(1))
        total.spool += found.get("spool", fmpq(0))
        total.asymmetry += found.get("asymmetry", fmpq(0))


def _within(table: Table, key: str, ends: Pair) -> Pair:
    """A range within another, which it is where nothing is stated."""
    found = table.range(key) if key in table else ends
    if not ends[0] <= found[0] <= found[1] <= ends[1]:
        raise Unreadable(f"{table.place_of(key)} is not within what it is a part of")
    return found


@dataclass(frozen=True)
class Loop:
    """A loop over the mass m and a factor g on its gain: denominator + g numerator, each (constant, slope) in the mass.

    Attributes:
        name: where its spans stand, in words; empty where there are none.
        loop_denominator: denominator of L, times that of the controller.
        loop_numerator: numerator of L.
        unfed: `loop_denominator` where the drive of a screw feeds no speed back either; None without a screw.
        disturbance: numerator of the closed loop's compliance.
        displacement: the part of `loop_numerator` that comes from the displacement sensor.
        law: the controller behind it, numerator and denominator.
        gain: factors over which it is to be stable.
        performing: factors over which it is to perform, None where it is not to.
        strayed: what errors in the "current" (A), the "flow" (m3/s), the "volts" and the force of the "stroke" (N) do
            to the tip (m), over the characteristic polynomial at a factor of one; without those that are not known.
        spool: from the flow behind the spool to that which the current asks for.
        filters: between the sensor's volts and the controller, numerator and denominator.
    """

    name: str
    loop_denominator: Polynomials
    loop_numerator: Polynomials
    unfed: Polynomials | None
    disturbance: fmpq_poly
    crossed: fmpq_poly
    displacement: Polynomials
    law: Polynomials
    gain: Pair
    performing: Pair | None
    strayed: Mapping[str, fmpq_poly]
    spool: fmpq_poly
    filters: Polynomials

    def at(self, gain: fmpq) -> Polynomials:
        """The characteristic polynomial at one factor."""
        return plus(self.loop_denominator, self.loop_numerator, gain)

    @property
    def closed(self) -> Polynomials:
        """The same at a factor of one."""
        return self.at(fmpq(1))

    def cut(self, place: str) -> tuple[Polynomials, Polynomials]:
        """Denominator of L cut at the current of "law" or "motor", and p: at the law's largest factor, or at one."""
        if place == "law":
            return self.loop_denominator, self.at(self.gain[1])
        if self.unfed is None:
            raise Unreadable("a rig without a screw has no motor")
        return self.unfed, self.closed


class Rig:
    """What a certificate states of the rig that it is about.

    Attributes:
        figures: lumped, SI, by name with unit.
        kind: by its actuator.
        inner_end_mass: kg.
        law: its controller; None where it states several stages, or none.
        schedule: several stages that take turns; None where it states one law, or none.
        effects: in their order.
    """

    def __init__(self, table: Table) -> None:
        rig = table.table("rig")
        self.kind = rig.word("kind", *OF_ACTUATOR)
        filtered = "filter_frequency_rad_per_s" in rig
        names = (*FIGURES, *OF_ACTUATOR[self.kind], *(("filter_frequency_rad_per_s",) if filtered else ()))
        self.figures = {name: rig.at_least(name, 0, above=name not in MAY_BE_ZERO) for name in names}
        self.inner_end_mass = rig.at_least("inner_end_mass_kg", 0)
        asked = table.optional("payload").whole_of_it().get("inner_end_mass_kg")
        if asked is not None and rational(asked, "payload.inner_end_mass_kg") != self.inner_end_mass:
            raise Unreadable("rig.inner_end_mass_kg and payload.inner_end_mass_kg are not one mass")
        for name in names:  # stated in turns as well
            shown, radians = name.replace("_rad_per_s", "_Hz").replace("_per_rad", ""), self.figures[name]
            if name.endswith("_rad_per_s") or name == "lead_m_per_rad":
                turns = rig.number(shown) if name.endswith("_rad_per_s") else 1 / rig.at_least(shown, 0, above=True)
                if not same_frequency(turns, radians if name.endswith("_rad_per_s") else 1 / radians):
                    raise Unreadable(f"rig.{shown} and rig.{name} are not the same")
        controller = table.table("controller") if "controller" in table else None
        scheduled = controller is not None and "stage" in controller
        self.schedule = Schedule(controller) if controller is not None and scheduled else None
        self.law = Law(controller) if controller is not None and not scheduled else None
        own = {*map(without_unit, names)}
        self.effects = [Effect(one, own) for one in table.tables("effect")]
        if len({effect.name for effect in self.effects}) < len(self.effects):
            raise Unreadable("an effect stands there twice")

    def statements(self) -> Statements:
        """That what it states twice agrees."""
        if self.law is not None and self.law.follows is not None:
            good = self.law.follows
            yield good, f"the controller's polynomials {'follow' if good else 'do not follow'} from its figures"
        if self.schedule is not None:
            good = self.schedule.follows
            yield good, f"the stages' figures in rad/s {'are' if good else 'are not'} those in Hz"

    def left_open(self, of_effects: bool = True) -> Iterator[str]:
        """What of it is not decided by what it states, in words; of its effects only where that is asked."""
        if self.law is not None and self.law.follows is None:
            yield f"that the controller's polynomials follow from its figures: kind {self.law.kind!r} is not known here"
        if (names := ", ".join(effect.name for effect in self.effects)) and of_effects:
            yield f"that what is called {names} comes to the elements stated, which are what is proved"

    def loops(self) -> Iterator[Loop]:
        """The loop of every combination of the ends of all spans."""
        places = [(k, name, span) for k, effect in enumerate(self.effects) for name, span in effect.spans.items()]
        if any(not {*span.performing} <= {*span.ends} for _, _, span in places):
            raise Unreadable("what is to perform must be ends of a span: nothing between them is looked at")
        ends = [sorted(set(span.ends)) for _, _, span in places]
        if (count := prod(map(len, ends))) > MOST_MEMBERS:
            raise Unreadable(f"the spans of effects have {count} combinations, more than {MOST_MEMBERS}")
        for chosen in product(*ends):
            values: list[dict[str, fmpq]] = [{} for _ in self.effects]
            named, performs = [], True
            for (k, name, span), value in zip(places, chosen, strict=True):
                values[k][name] = value
                named.append(f"{self.effects[k].name}.{name} = {short(value)}")
                performs = performs and span.performing[0] <= value <= span.performing[1]
            yield self._loop(", ".join(named), self.elements(values), performs)

    def elements(self, values: Sequence[Values]) -> Elements:
        """Those of all effects, at numbers for the spans of each.

        Raises:
            Unreadable: where they are of no rig.
        """
        total = Elements()
        figures = {without_unit(name): value for name, value in self.figures.items()}
        for effect, own in zip(self.effects, values, strict=True):
            effect.add_to(total, {**figures, **own})
            sound = total.oil > 0 and total.spool >= 0 and -1 < total.asymmetry < 1
            filters = [(fmpq_poly(list(above)), fmpq_poly(list(below))) for above, below in total.volts]
            if not sound or any(below == 0 or above.degree() > below.degree() for above, below in filters):
                raise Unreadable(f"effect {effect.name}: its elements are of no rig")
        return total

    def gain(self, performing: bool = False) -> Pair:
        """Factors that all effects put on the gain, or those of them at which more than stability is asked."""
        each = [effect.performing if performing else effect.gain for effect in self.effects]
        low, high = (prod(ends, start=fmpq(1)) for ends in zip(*each, strict=True)) if each else ONCE
        return low, high

    def _loop(self, name: str, elements: Elements, performs: bool) -> Loop:
        """The polynomials of one combination."""
        law = self.law
        if law is None:
            raise Unreadable("[controller] is not one law")
        refuse_size(elements, law)
        parts, signals = Parts(self.figures, elements, fmpq_poly), list(law.numerators)
        bare, loaded = (
            parts.mechanics((mass, self.inner_end_mass), signals, erring=mass == 0) for mass in (fmpq(0), fmpq(1))
        )
        around, back = parts.electronics(law.numerators, law.denominator)
        fed, heavier = (sum((by * at.sensed[name] for name, by in back.items()), ZERO) for at in (bare, loaded))
        own = tuple(back[SENSED[0]] * at.sensed[SENSED[0]] for at in (bare, loaded))
        inside = sum((by * bare.crossed[name] for name, by in back.items()), ZERO)
        return Loop(
            name,
            (bare.determinant * around, (loaded.determinant - bare.determinant) * around),
            (fed, heavier - fed),
            self._unfed(elements, around),
            bare.moved * around + inside,
            inside,
            (own[0], own[1] - own[0]),
            law.of_displacement,
            self.gain(),
            self.gain(performing=True) if performs else None,
            parts.strayed(bare.strayed, around, own[0], len(law.numerators) == 1),
            parts.drive()[1] / Parts(self.figures, Elements(), fmpq_poly).drive()[1][0],
            parts.filters(),
        )

    def _unfed(self, elements: Elements, around: fmpq_poly) -> Polynomials | None:
        if _FED_BACK not in self.figures:
            return None
        still = Parts({**self.figures, _FED_BACK: fmpq(0)}, elements, fmpq_poly)
        bare, loaded = (
            still.mechanics((fmpq(mass), self.inner_end_mass), (), disturbed=False).determinant for mass in (0, 1)
        )
        return bare * around, (loaded - bare) * around


def refuse_size(elements: Elements, law: Law) -> None:
    """Refuse a loop of a high degree before anything is multiplied out."""
    moving = {name for motion, _ in elements.impedances for name in motion}
    moving |= {name for weights in elements.points.values() for name in weights}
    lags = max(one.degree() for one in (*law.numerators.values(), law.denominator))
    lags += sum(max(len(above), len(below)) - 1 for above, below in elements.volts)
    if (degree := 2 * len(moving - POINTS) + lags) > HIGHEST_DEGREE:
        raise Unreadable(f"what is beside the rig's own parts has degree {degree}, more than {HIGHEST_DEGREE}")
