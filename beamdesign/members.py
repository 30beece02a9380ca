"""The linear members of a prototype: one loop without effects, a set that brackets them with effects."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from math import pi
from typing import Any

import numpy as np
from flint import fmpq, fmpq_mat, fmpq_poly

from beamdesign.linear import LinearRig, Plant, evaluate_exactly
from beamdesign.lumped import figures
from beamdesign.polynomial import Affine, exact
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem
from beamdesign.rig.effect import Operation, Span
from beamdesign.rig.effects import library, problems
from beamdesign.rig.hydraulics import SUPPLY_PRESSURE_PA
from beamdesign.rig.linearised import SEEN, LinearAssembly, linear_assembly
from beamdesign.rig.parameters import effect_parameters_of
from beamdesign.rig.twin_beam import ADDED_OUTPUTS

STANDARD_GRAVITY = 9.80665
"""m/s2; the load that a prototype is taken to carry is the weight of its largest outer end mass and the payload's
force."""

_CHAMBERS = ("pressure_a_Pa", "pressure_b_Pa")


@dataclass(frozen=True)
class BilinearPlant:
    """A plant over the outer (m) and the inner (n) end mass, exact.

    Attributes:
        denominator: [i][j] multiplies m^i n^j.
        control: [j] multiplies n^j; from current (A) to measured voltage (V).
        disturbance: likewise; from tip force (N) to displacement (m).
        riding: where the sensor rides on the mount, two pairs, else none. The first adds to `control`, [j] multiplying
            m n^j. The second, [j] multiplying n^j, is what the force shows by way of the controller: (disturbance
            control - displaced force) / denominator, see `beamdesign.sensed_plant.SensedPlant.crossed`.
    """

    denominator: tuple[tuple[fmpq_poly, fmpq_poly], tuple[fmpq_poly, fmpq_poly]]
    control: tuple[fmpq_poly, fmpq_poly]
    disturbance: tuple[fmpq_poly, fmpq_poly]
    riding: tuple[tuple[fmpq_poly, fmpq_poly], tuple[fmpq_poly, fmpq_poly]] | None = None


@dataclass(frozen=True)
class MemberRig:
    """The linear plant of one member of a prototype with effects, for any end masses.

    Attributes:
        figures: lumped figures by name, SI (see `beamdesign.rig.twin_beam.FIGURES`).
        filtered: whether the sensor filter adds a state.
        effects: parameters and frozen figures of each effect that adds to the equations.
    """

    figures: dict[str, float]
    filtered: bool
    effects: Mapping[str, Mapping[str, float]]

    @cached_property
    def assembly(self) -> LinearAssembly:
        """The equations, from the assembled rig by differentiation."""
        return linear_assembly(self.filtered, tuple(sorted(self.effects)))

    @property
    def sensor_rides(self) -> bool:
        """Whether the sensor's reference moves with the mount, so that the outer end mass shows in what it reads."""
        return self.effects.get("mount_compliance", {}).get("sensor_share", 0.0) != 0

    def _values(self, outer: Any, inner: Any) -> list[Any]:
        """Parameters of the assembly; those of the controller and the supply have no part in the linear plant."""
        given: dict[str, Any] = self.figures | {
            "outer_end_mass": outer,
            "inner_end_mass": inner,
        }
        rest = {
            "supply_pressure": SUPPLY_PRESSURE_PA,
            "believed_sensor_gain": 1.0,
            "gain": 1.0,
            "pole": 1.0,
            "zero": 1.0,
        }
        own = {f"{name}.{key}": value for name, table in self.effects.items() for key, value in table.items()}
        everything = given | rest | own
        return [everything[name] for name in self.assembly.parameters]

    def matrices(self, outer_end_mass: float, inner_end_mass: float) -> tuple[np.ndarray, ...]:
        """A (n, n), B (n, 2), C (2, n) of x' = A x + B u in floats; inputs and outputs as in `twin_beam`."""
        a, b, c = (np.asarray(m) for m in self.assembly.function(self._values(outer_end_mass, inner_end_mass))[:3])
        return a, b, c[:2]

    def added_rows(self) -> np.ndarray:
        """C (2, n) of what added sensors may read, `twin_beam.ADDED_OUTPUTS`, in floats."""
        c = np.asarray(self.assembly.function(self._values(0.0, 0.0))[2])
        return c[[SEEN.index(name) for name in ADDED_OUTPUTS]]

    def exact_matrices(self, outer_end_mass: fmpq, inner_end_mass: fmpq) -> tuple[fmpq_mat, ...]:
        """A, B, C (4, n) and D in rationals, from the same CasADi instructions."""
        values = [
            value if isinstance(value, fmpq) else exact(value) for value in self._values(outer_end_mass, inner_end_mass)
        ]
        n = len(self.assembly.states)
        shapes = [(n, n), (n, 2), (len(SEEN), n), (len(SEEN), 2)]
        flat = evaluate_exactly(self.assembly.function, values)
        return tuple(
            fmpq_mat(rows, columns, [entries[j * rows + i] for i in range(rows) for j in range(columns)])
            for entries, (rows, columns) in zip(flat, shapes, strict=True)
        )

    def transfers(self, outer: fmpq, inner: fmpq, wanted: Sequence[tuple[int, int]]) -> list[fmpq_poly]:
        """Denominator and the wanted numerators at one pair of end masses, to a common factor that is free of both.

        Args:
            outer: mass on the outer tip, kg.
            inner: mass on the inner tip, kg.
            wanted: source (0 force, 1 current) and place in `beamdesign.rig.linearised.SEEN` of each numerator.
        """
        a, b, c, d = self.exact_matrices(outer, inner)
        n = a.nrows()
        denominator = a.charpoly()

        def numerator(source: int, output: int) -> fmpq_poly:
            # det(sI - A + b c) = det(sI - A) + c adj(sI - A) b.
            dyad = fmpq_mat(n, n, [b[i, source] * c[output, j] for i in range(n) for j in range(n)])
            return (a - dyad).charpoly() - denominator + d[output, source] * denominator

        polynomials = [denominator, *(numerator(*pair) for pair in wanted)]
        # The chambers' mean pressure neither is driven nor shows: its root is in all of them, and leaves them.
        rows = [self.assembly.states.index(name) for name in _CHAMBERS]
        mean = fmpq_poly([-(a[rows[0], rows[0]] + a[rows[1], rows[0]]), 1])
        if all(divmod(polynomial, mean)[1].is_zero() for polynomial in polynomials):
            polynomials = [polynomial / mean for polynomial in polynomials]
        # End masses act through accelerations: the lowest coefficient is free of them.
        lowest = next(value for value in polynomials[0].coeffs() if value != 0)
        return [polynomial / lowest for polynomial in polynomials]

    @cached_property
    def bilinear(self) -> BilinearPlant:
        """The plant over both end masses; each enters with rank one, which a fifth pair of masses confirms.

        Raises:
            ArithmeticError: where it does not, or where a numerator that should not depends on the outer end mass.
        """
        wanted = ((1, 1), (0, 0))  # current to measured voltage, force to displacement
        if self.sensor_rides:
            return self._riding(wanted)
        at = {(m, n): self.transfers(fmpq(m), fmpq(n), wanted) for m, n in ((0, 0), (1, 0), (0, 1), (1, 1), (2, 3))}
        bare, outer, inner, both = (at[masses] for masses in ((0, 0), (1, 0), (0, 1), (1, 1)))
        slope = inner[0] - bare[0]
        denominator = ((bare[0], slope), (outer[0] - bare[0], both[0] - outer[0] - slope))
        control, disturbance = ((bare[i], inner[i] - bare[i]) for i in (1, 2))
        plant = BilinearPlant(denominator, control, disturbance)
        (d00, d01), (d10, d11) = denominator
        expected = (
            d00 + 3 * d01 + 2 * (d10 + 3 * d11),
            control[0] + 3 * control[1],
            disturbance[0] + 3 * disturbance[1],
        )
        free = all(at[(1, n)][i] == at[(0, n)][i] for n in (0, 1) for i in (1, 2))
        if tuple(at[(2, 3)]) != expected or not free:
            raise ArithmeticError("an end mass enters this rig with more than rank one")
        return plant

    def _riding(self, wanted: tuple[tuple[int, int], ...]) -> BilinearPlant:
        """The same where the outer end mass shows in what the sensor reads."""
        pairs = (*wanted, (1, 0), (0, 1))
        at = {}
        for m, n in ((0, 0), (1, 0), (0, 1), (1, 1), (2, 3)):
            denominator, control, disturbance, displaced, force = self.transfers(fmpq(m), fmpq(n), pairs)
            crossed, rest = divmod(disturbance * control - displaced * force, denominator)
            if not rest.is_zero():
                raise ArithmeticError("a second minor is no multiple of the determinant")
            at[m, n] = (denominator, control, disturbance, crossed)
        bare, outer, inner, both = (at[masses] for masses in ((0, 0), (1, 0), (0, 1), (1, 1)))
        # [i][j] multiplies m^i n^j.
        found = [((z, n - z), (m - z, mn - m - n + z)) for z, m, n, mn in zip(bare, outer, inner, both, strict=True)]
        expected = tuple(c[0][0] + 3 * c[0][1] + 2 * (c[1][0] + 3 * c[1][1]) for c in found)
        if at[2, 3] != expected or not all(p.is_zero() for k in (2, 3) for p in found[k][1]):
            raise ArithmeticError("an end mass enters this rig with more than rank one")
        return BilinearPlant(found[0], found[1][0], found[2][0], (found[1][1], found[3][0]))

    def plant(self, inner_end_mass: float = 0.0) -> Plant:
        """Exact transfer polynomials with the given mass (kg) added to the inner beam.

        Raises:
            ArithmeticError: where the sensor rides on the mount; see `beamdesign.sensed_plant` for such rigs.
        """
        if self.sensor_rides:
            raise ArithmeticError("the outer end mass shows in what a sensor on the mount reads")
        inner, found = exact(inner_end_mass), self.bilinear
        constant, slope = (row[0] + inner * row[1] for row in found.denominator)
        control, disturbance = (pair[0] + inner * pair[1] for pair in (found.control, found.disturbance))
        return Plant(Affine(constant, slope), control, disturbance)


def bilinear_plant(rig: "LinearRig | MemberRig") -> BilinearPlant:
    """The plant of a rig over both end masses, exact, for controllers that are tuned by samples of it.

    Raises:
        InputError: where the sensor rides on the mount, for which there are no such samples.
    """
    if isinstance(rig, MemberRig):
        if rig.sensor_rides:
            why = "a sensor that turns with the mount is tuned for with a controller of few parameters only, as a lag"
            raise InputError("prototype", [("effects.mount_compliance.sensor_share", why)])
        return rig.bilinear
    bare, added = rig.plant(0.0), rig.plant(1.0)
    (d00, d10), (s0, s1) = ((p.denominator.constant, p.denominator.slope) for p in (bare, added))
    return BilinearPlant(
        ((d00, s0 - d00), (d10, s1 - d10)),
        (bare.control, added.control - bare.control),
        (bare.disturbance, added.disturbance - bare.disturbance),
    )


@dataclass(frozen=True)
class Interval:
    """Closed interval of factors on the loop gain."""

    low: float
    high: float


ONE = Interval(1.0, 1.0)


@dataclass(frozen=True)
class Member:
    """One linear rig that stands for a prototype, with factors on its loop gain.

    Attributes:
        rig: its plant.
        gain: factors over which it is to be stable.
        performance: factors over which it is to perform, None where it only has to be stable.
        frozen: figures of its effects that are frozen at one end of their span, by effect.
    """

    rig: LinearRig | MemberRig
    gain: Interval = ONE
    performance: Interval | None = ONE
    frozen: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Its frozen figures in words; empty for the only member."""
        return ", ".join(
            f"{effect}.{key} = {value:.6g}" for effect, t in self.frozen.items() for key, value in t.items()
        )


@dataclass(frozen=True)
class Family:
    """All linear members of a prototype.

    Attributes:
        members: at all ends of the spans of its effects.
        rest: the loop with everything at rest; its gain interval is a single factor.
        spans: of the frozen figures, by EFFECT.FIGURE.
        load_N: largest steady force for which the spans are.
        depends_on_load: whether the spans would differ for another.
    """

    members: tuple[Member, ...]
    rest: Member
    spans: Mapping[str, Span]
    load_N: float
    depends_on_load: bool = False

    @property
    def single(self) -> bool:
        """Whether there are no effects, so that one loop is all there is."""
        return isinstance(self.rest.rig, LinearRig)


def family(prototype: Prototype, largest_outer_end_mass: float | None = None) -> Family:
    """The linear members of a prototype.

    Args:
        prototype: with or without effects.
        largest_outer_end_mass: kg, whose weight is the load where an effect depends on it; else that of the payload.

    Raises:
        InputError: where an effect or a figure of it is unknown or out of bounds, or no linear loop can stand for it.
    """
    lumped, filtered = figures(prototype), prototype.sensor.filter_Hz is not None
    if not prototype.effects:
        member = Member(LinearRig(lumped, filtered))
        return Family((member,), member, {}, 0.0)
    if wrong := list(problems(prototype.effects)):
        raise InputError(prototype.name, wrong)
    if largest_outer_end_mass is None:
        largest_outer_end_mass = (prototype.payload.outer_end_mass_kg or (0.0, 0.0))[1]
    load = largest_outer_end_mass * STANDARD_GRAVITY + (prototype.payload.largest_force_N or 0.0)
    own = effect_parameters_of(prototype)
    supply = own.get("pressure_dependent_flow", {}).get("supply_pressure_Pa", prototype.supply.pressure_Pa)
    operation = Operation(lumped, load, supply)
    spans: dict[str, dict[str, Span]] = {}
    gains: list[Span] = []
    for name, parameters in own.items():
        linear = library()[name].linear
        if linear is None:
            wrong.append(Problem(f"effects.{name}", "no linear loop stands for this effect, so that nothing is proved"))
            continue
        try:
            spans[name] = {key: span(parameters, operation) for key, span in linear.figures.items()}
            gains += [linear.gain(parameters, operation)] if linear.gain else []
        except ValueError as error:
            wrong.append(Problem(f"effects.{name}", str(error)))
    if wrong:
        raise InputError(prototype.name, wrong)
    kept = [name for name in own if library()[name].linear.laws != {}]  # type: ignore[union-attr]

    def rig(frozen: Mapping[str, Mapping[str, float]]) -> MemberRig:
        return MemberRig(lumped, filtered, {name: own[name] | dict(frozen.get(name, {})) for name in kept})

    whole = Interval(_times(span.low for span in gains), _times(span.high for span in gains))
    inside = [span.performing for span in gains]
    performing = Interval(_times(low for low, _ in inside), _times(high for _, high in inside))
    places = [(name, key, span) for name, table in spans.items() for key, span in table.items()]
    members = []
    for ends in product(*(sorted({span.low, span.high}) for _, _, span in places)):
        frozen: dict[str, dict[str, float]] = {}
        for (name, key, _), value in zip(places, ends, strict=True):
            frozen.setdefault(name, {})[key] = value
        performs = all(
            span.performing[0] <= value <= span.performing[1] for (_, _, span), value in zip(places, ends, strict=True)
        )
        members.append(Member(rig(frozen), whole, performing if performs else None, frozen))
    at_rest = {name: {key: span.rest for key, span in table.items()} for name, table in spans.items()}
    factor = _times(span.rest for span in gains)
    rest = Member(rig(at_rest), Interval(factor, factor), Interval(factor, factor), at_rest)
    named = {f"{name}.{key}": span for name, key, span in places}
    return Family(tuple(members), rest, named, load, any(library()[name].linear_with_load for name in own))


def _times(values: Any) -> float:
    return float(np.prod(list(values)))


TWO_PI = 2 * pi
"""As it stands in the laws of the effects; a proof takes its decimal form as exact."""
