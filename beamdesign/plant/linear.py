"""The linear plant of a prototype: matrices in floats or rationals, and exact polynomials over both end masses."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from typing import Any

import numpy as np
from flint import fmpq, fmpq_mat, fmpq_mpoly, fmpq_mpoly_ctx, fmpq_poly

from beamdesign.plant.actuators import KINDS
from beamdesign.plant.linearised import SEEN, LinearAssembly, evaluate_exactly, linear_assembly, transfer_polynomials
from beamdesign.plant.rigs import MORE_FIGURES
from beamdesign.polynomial import Affine, Quotient, exact

DISPLACEMENT = ("displacement_m",)
TIP = SEEN[0]
SEEN_AS = {"displacement_m": SEEN.index("measured_V"), TIP: 0} | {name: SEEN.index(name) for name in SEEN[2:]}
SEEN_AS |= {kind.feels[0]: SEEN.index("load_pressure_Pa") for kind in KINDS.values()}
"""By what is sensed, the place in `SEEN` of what the controller is given of it; and of the tip itself."""

PairOver = tuple[fmpq_poly, fmpq_poly]
"""Affine in one mass: [j] multiplies n^j."""

Parametric = tuple[fmpq_mpoly, list[fmpq_mpoly]]
"""Denominator, and numerators from current to what is sensed, in s, both end masses and parameters."""


@dataclass(frozen=True)
class Plant:
    """A plant over the outer end mass m (kg), in exact rationals of the given figures.

    One actuator drives it and one force disturbs it, so that with the law u = -sum_k C_k y_k the tip's compliance is
    (disturbance + sum_k C_k crossed_k) / (denominator + sum_k C_k control_k).

    Attributes:
        sensors: what is sensed, see `beamdesign.controllers.SENSORS`.
        denominator: characteristic polynomial in s, affine in m.
        control: one per sensor: numerator from current (A) to volts, to m or to Pa, affine in m.
        displaced: numerator from current (A) to the tip's displacement (m), free of m.
        disturbance: numerator from tip force (N) to the tip's displacement (m), free of m.
        crossed: one per sensor: (disturbance control - displaced force) / denominator, free of m, where force is the
            numerator from tip force (N) to that sensor; zero for the tip's displacement.
    """

    sensors: tuple[str, ...]
    denominator: Affine
    control: tuple[Affine, ...]
    displaced: fmpq_poly
    disturbance: fmpq_poly
    crossed: tuple[fmpq_poly, ...]


@dataclass(frozen=True)
class BilinearPlant:
    """The same over the outer (m) and the inner (n) end mass.

    Attributes:
        sensors: what is sensed.
        denominator: [i][j] multiplies m^i n^j.
        control: one per sensor, likewise.
        displaced: [j] multiplies n^j.
        disturbance: likewise.
        crossed: one per sensor, likewise.
    """

    sensors: tuple[str, ...]
    denominator: tuple[PairOver, PairOver]
    control: tuple[tuple[PairOver, PairOver], ...]
    displaced: PairOver
    disturbance: PairOver
    crossed: tuple[PairOver, ...]

    def at(self, inner_end_mass: float) -> Plant:
        """The plant with a mass (kg) added to the inner beam."""
        inner = exact(inner_end_mass)

        def free(pair: PairOver) -> fmpq_poly:
            return pair[0] + inner * pair[1]

        denominator, *control = (Affine(*map(free, one)) for one in (self.denominator, *self.control))
        moved = free(self.displaced), free(self.disturbance), tuple(map(free, self.crossed))
        return Plant(self.sensors, denominator, tuple(control), *moved)


@dataclass(frozen=True)
class LinearModel:
    """The linear plant of a prototype, or of one member of its family, for any end masses.

    Attributes:
        figures: lumped figures by name, SI (see `beamdesign.parameters.PARAMETERS`).
        filtered: whether the sensor filter adds a state.
        effects: parameters and frozen figures of each effect that adds to the equations.
        stretch: kg and a factor: the model at the outer end mass m has the polynomials of its figures at
            kg + factor m. Its matrices are not stretched.
        weighing: factor on the inner end mass in its polynomials, and not in its matrices.
        rig: of two beams, one of `beamdesign.plant.assembly.RIGS`.
    """

    figures: Mapping[str, float]
    filtered: bool
    effects: Mapping[str, Mapping[str, float]]
    stretch: tuple[float, float] = (0.0, 1.0)
    weighing: float = 1.0
    rig: str = "twin_beam"
    _known: dict[tuple[str, ...], BilinearPlant] = field(default_factory=dict, init=False, repr=False, compare=False)

    @cached_property
    def assembly(self) -> LinearAssembly:
        """The equations, from the assembled rig by differentiation."""
        return linear_assembly(self.filtered, tuple(sorted(self.effects)), self.rig)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the n states."""
        return self.assembly.states

    @property
    def sensor_rides(self) -> bool:
        """Whether the sensor's reference moves with the mount, so that the outer end mass shows in what it reads."""
        return self.effects.get("mount_compliance", {}).get("sensor_share", 0.0) != 0

    @cached_property
    def _values(self) -> list[float]:
        """Parameters of the assembly; those of the controller and the supply have no part in the linear plant."""
        known: dict[str, Any] = dict(self.figures) | UNUSED
        known |= {f"{name}.{key}": value for name, table in self.effects.items() for key, value in table.items()}
        return [known[name] for name in self.assembly.parameters]

    @cached_property
    def _exact(self) -> list[fmpq]:
        return [exact(value) for value in self._values]

    @cached_property
    def _floats(self) -> list[np.ndarray]:
        return [np.asarray(matrix.full()) for matrix in self.assembly.function(self._values)]

    def matrices(self, outer_end_mass: float, inner_end_mass: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A (n, n), B (n, 2), C (4, n) of x' = A x + B u, y = C x in floats.

        Inputs and outputs are those of `beamdesign.plant.linearised`.
        """
        push, velocity, a, b, c, _ = self._floats
        mass = np.eye(len(a)) + push * [outer_end_mass, inner_end_mass] @ velocity
        return np.linalg.solve(mass, a), np.linalg.solve(mass, b), c

    @cached_property
    def _exact_parts(self) -> list[fmpq_mat]:
        """P, V, A, B, C and D of the assembly in rationals."""
        function, found = self.assembly.function, []
        for k, entries in enumerate(evaluate_exactly(function, self._exact)):
            matrix = fmpq_mat(*function.size_out(k))
            for i, j, entry in zip(*function.sparsity_out(k).get_triplet(), entries, strict=True):
                matrix[i, j] = entry
            found.append(matrix)
        return found

    def exact_matrices(self, outer_end_mass: fmpq, inner_end_mass: fmpq) -> tuple[fmpq_mat, ...]:
        """E, A, B, C of E x' = A x + B u, y = C x in rationals, from the same CasADi instructions."""
        push, velocity, a, b, c, _ = self._exact_parts
        mass = push * fmpq_mat([[outer_end_mass, fmpq(0)], [fmpq(0), inner_end_mass]]) * velocity
        for i in range(mass.nrows()):
            mass[i, i] += 1
        return mass, a, b, c

    def over_outer_mass(self, inner_end_mass: fmpq) -> tuple[fmpq_mat, fmpq_mat, fmpq_mat, int, fmpq]:
        """A, B, C in rationals with the forces on the outer tip in the row of its velocity; its place, and its mass.

        The outer end mass m (kg) divides that row, as M_m + m, and has no other part.

        Raises:
            ValueError: where it has one.
        """
        place = self.states.index("velocity_m_per_s")
        mass, a, b, c = self.exact_matrices(fmpq(0), inner_end_mass)
        share = self.exact_matrices(fmpq(1), inner_end_mass)[0] - mass
        n, own = mass.nrows(), share[place, place]
        alone = all(mass[i, place] == mass[place, i] == 0 for i in range(n) if i != place)
        if not alone or any(share[i, j] != 0 for i in range(n) for j in range(n) if (i, j) != (place, place)):
            raise ValueError("the outer end mass must enter the mass matrix in the velocity's own entry alone")
        a, b = mass.inv() * a, mass.inv() * b
        for matrix in (a, b):
            for j in range(matrix.ncols()):
                matrix[place, j] /= own
        return a, b, c, place, 1 / own

    def polynomials(self, sensors: Sequence[str] = DISPLACEMENT) -> BilinearPlant:
        """The plant over both end masses as these sensors see it, to a common factor that is free of the masses."""
        if (sensors := tuple(sensors)) not in self._known:
            self._known[sensors] = self._derived(sensors)
        return self._known[sensors]

    def plant(self, inner_end_mass: float = 0.0, sensors: Sequence[str] = DISPLACEMENT) -> Plant:
        """Exact transfer polynomials with the given mass (kg) added to the inner beam."""
        return self.polynomials(sensors).at(inner_end_mass)

    def over_parameters(self, sensors: Sequence[str], context: fmpq_mpoly_ctx, named: Mapping[str, str]) -> Parametric:
        """Denominator, and numerators from current (A) to what is sensed, over both end masses and any parameters.

        They are those of `polynomials` to a common factor that is free of s and of the masses.

        Args:
            sensors: what is sensed.
            context: of the polynomials, with the variables "s", "outer_end_mass" and "inner_end_mass".
            named: which parameters of the assembly are variables, and by what names; the others are numbers.
        """
        variable = dict(zip(context.names(), context.gens(), strict=True))
        one = context.constant(1)
        values: list[Any] = [
            Quotient(variable[named[name]], one) if name in named else value
            for name, value in zip(self.assembly.parameters, self._exact, strict=True)
        ]
        wanted = ((), *(((1, SEEN_AS[name]),) for name in sensors))
        found = evaluate_exactly(transfer_polynomials(self.assembly, wanted), values)
        rows = [
            [entry if isinstance(entry, Quotient) else Quotient(one * entry, one) for entry in row] for row in found
        ]
        shared = one
        for entry in (entry.denominator for row in rows for entry in row):
            shared *= divmod(entry, entry.gcd(shared))[0]
        masses = [one, variable["inner_end_mass"], variable["outer_end_mass"]]
        masses.append(masses[1] * masses[2])
        parts = [0 * one for _ in wanted]
        for k, row in enumerate(rows):
            for power, term in enumerate(row):
                above = term.numerator * divmod(shared, term.denominator)[0]
                parts[k // 4] += masses[k % 4] * variable["s"] ** power * above
        common = reduce(lambda a, b: a.gcd(b), parts)
        if common.degrees()[0] == 0 or "mean_pressure_Pa" in self.states:  # which these may neither drive nor show
            parts = [divmod(part, common)[0] for part in parts]
        return parts[0], parts[1:]

    def _derived(self, sensors: tuple[str, ...]) -> BilinearPlant:
        seen = [SEEN_AS[name] for name in sensors]
        # What the tip's displacement shows of a force, feedback of it cannot change.
        minor = [name for name in sensors if name not in DISPLACEMENT or self.sensor_rides]
        wanted = ((), ((0, 0),), ((1, 0),), *(((1, k),) for k in seen), *(((0, 0), (1, SEEN_AS[k])) for k in minor))
        minors = evaluate_exactly(transfer_polynomials(self.assembly, wanted), self._exact)
        parts = self._without_mean([fmpq_poly(one) for one in minors])
        # End masses act through accelerations: the lowest coefficient is free of them.
        lowest = next(value for value in parts[0].coeffs() if value != 0)
        parts = [part / lowest for part in parts]
        (offset, factor), weight = map(exact, self.stretch), exact(self.weighing)
        found = [  # over m and n, of payloads and inner end masses that are so stretched and weighed
            ((one + offset * m, weight * (n + offset * both)), (factor * m, weight * factor * both))
            for one, n, m, both in zip(*(parts[k::4] for k in range(4)), strict=True)
        ]
        denominator, disturbance, displaced, *rest = found
        crossed = dict(zip(minor, rest[len(seen) :], strict=True))
        free = [disturbance, displaced, *(crossed.get(name, _NOTHING) for name in sensors)]
        if any(not part.is_zero() for one in free for part in one[1]):
            raise ArithmeticError("a numerator that is to be free of the outer end mass is not")
        return BilinearPlant(
            sensors, denominator, tuple(rest[: len(seen)]), free[1][0], free[0][0], tuple(one[0] for one in free[2:])
        )

    def _without_mean(self, parts: list[fmpq_poly]) -> list[fmpq_poly]:
        """Without the root of the chambers' mean pressure, where these figures neither drive nor show it."""
        if "mean_pressure_Pa" not in self.states:
            return parts
        k, (_, a, _, _) = self.states.index("mean_pressure_Pa"), self.exact_matrices(fmpq(0), fmpq(0))
        root = fmpq_poly([-a[k, k], 1])
        return [part / root for part in parts] if all((part % root).is_zero() for part in parts) else parts


UNUSED = dict.fromkeys(("outer_end_mass", "inner_end_mass", *MORE_FIGURES), 1.0)
"""Parameters of the assembly on which the linear plant does not depend."""

_NOTHING = ((fmpq_poly([]), fmpq_poly([])),) * 2
