"""The linear plant of a prototype: matrices in floats or rationals, and exact transfer polynomials."""

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import casadi as ca
import numpy as np
from flint import fmpq, fmpq_mat, fmpq_poly

from beamdesign.lumped import figures
from beamdesign.polynomial import Affine, exact
from beamdesign.prototype import Prototype
from beamdesign.records import InputError
from beamdesign.rig import twin_beam
from beamdesign.rig.transfer import transfer_polynomials

_OPERATIONS: dict[int, Callable[..., fmpq]] = {
    ca.OP_ADD: operator.add,
    ca.OP_SUB: operator.sub,
    ca.OP_MUL: operator.mul,
    ca.OP_DIV: operator.truediv,
    ca.OP_NEG: operator.neg,
    ca.OP_SQ: lambda value: value * value,
    ca.OP_TWICE: lambda value: value + value,
    ca.OP_INV: lambda value: 1 / value,
}


@cache
def _instructions(function: ca.Function) -> list[tuple[int, list[int], list[int], fmpq | None]]:
    """Operation, sources, targets and constant of each instruction; read once, since CasADi hands them out slowly."""
    return [
        (
            code := function.instruction_id(k),
            function.instruction_input(k),
            function.instruction_output(k),
            exact(function.instruction_constant(k)) if code == ca.OP_CONST else None,
        )
        for k in range(function.n_instructions())
    ]


def evaluate_exactly(function: ca.Function, inputs: Sequence[fmpq]) -> list[list[fmpq]]:
    """Run the instructions of a one-input CasADi SX function in rationals.

    Only rational operations occur in a linearised law: sums, products, quotients, squares and doublings.

    Args:
        function: SX function of one dense vector.
        inputs: that vector's entries.

    Returns:
        one list per output, its entries column by column.

    Raises:
        NotImplementedError: at an operation that is not rational.
    """
    work: list[Any] = [fmpq(0)] * function.sz_w()
    outputs = [[fmpq(0)] * function.nnz_out(i) for i in range(function.n_out())]
    for code, source, target, constant in _instructions(function):
        if code == ca.OP_CONST:
            work[target[0]] = constant
        elif code == ca.OP_INPUT:
            work[target[0]] = inputs[source[1]]
        elif code == ca.OP_OUTPUT:
            outputs[target[0]][target[1]] = work[source[0]]
        elif code in _OPERATIONS:
            work[target[0]] = _OPERATIONS[code](*(work[i] for i in source))
        else:
            raise NotImplementedError(f"CasADi operation {code} is not rational")
    return outputs


@dataclass(frozen=True)
class Plant:
    """The plant over the outer end mass m, in exact rationals of the given figures.

    Attributes:
        denominator: characteristic polynomial in s, affine in m.
        control: numerator from current (A) to sensor voltage (V); free of m.
        disturbance: numerator from tip force (N) to displacement (m); free of m.
    """

    denominator: Affine
    control: fmpq_poly
    disturbance: fmpq_poly


@dataclass(frozen=True)
class LinearRig:
    """The linear plant of one prototype, for any end masses.

    Attributes:
        figures: lumped figures by name, SI (see `beamdesign.rig.twin_beam.FIGURES`).
        filtered: whether the sensor filter adds a state.
    """

    figures: dict[str, float]
    filtered: bool

    @cached_property
    def _descriptor(self) -> twin_beam.Descriptor:
        return twin_beam.descriptor(self.filtered)

    def matrices(self, outer_end_mass: float, inner_end_mass: float) -> tuple[np.ndarray, ...]:
        """A (n, n), B (n, 2), C (2, n) of x' = A x + B u in floats; inputs and outputs as in `twin_beam`."""
        vector = [*self.figures.values(), outer_end_mass, inner_end_mass]
        mass, a, b, c = (np.asarray(m) for m in self._descriptor.function(vector))
        return np.linalg.solve(mass, a), np.linalg.solve(mass, b), c

    def exact_matrices(self, outer_end_mass: fmpq, inner_end_mass: fmpq) -> tuple[fmpq_mat, ...]:
        """E, A, B, C of E x' = A x + B u in rationals, from the same CasADi instructions."""
        vector = [*(exact(value) for value in self.figures.values()), outer_end_mass, inner_end_mass]
        n = len(self._descriptor.states)
        flat = evaluate_exactly(self._descriptor.function, vector)
        shapes = [(n, n), (n, n), (n, len(twin_beam.INPUTS)), (len(twin_beam.OUTPUTS), n)]
        return tuple(
            fmpq_mat(rows, columns, [entries[j * rows + i] for i in range(rows) for j in range(columns)])
            for entries, (rows, columns) in zip(flat, shapes, strict=True)
        )

    def added_rows(self) -> np.ndarray:
        """C (2, n) of what added sensors may read, `twin_beam.ADDED_OUTPUTS`, in floats."""
        return np.asarray(self._descriptor.added([*self.figures.values(), 0.0, 0.0]))

    def exact_added_rows(self) -> fmpq_mat:
        """The same in rationals; no end mass shows in it."""
        vector = [*(exact(value) for value in self.figures.values()), fmpq(0), fmpq(0)]
        n, rows = len(self._descriptor.states), len(twin_beam.ADDED_OUTPUTS)
        flat = evaluate_exactly(self._descriptor.added, vector)[0]
        return fmpq_mat(rows, n, [flat[j * rows + i] for i in range(rows) for j in range(n)])

    def plant(self, inner_end_mass: float = 0.0) -> Plant:
        """Exact transfer polynomials with the given mass (kg) added to the inner beam."""
        inner = exact(inner_end_mass)
        bare, loaded = (self._polynomials(fmpq(m), inner) for m in (0, 1))
        return Plant(Affine(bare[0], loaded[0] - bare[0]), bare[1], bare[2])

    def _polynomials(self, outer: fmpq, inner: fmpq) -> list[fmpq_poly]:
        vector = [*(exact(value) for value in self.figures.values()), outer, inner]
        return [fmpq_poly(c) for c in evaluate_exactly(transfer_polynomials(self.filtered), vector)]


def linear_rig(prototype: Prototype) -> LinearRig:
    """The linear plant of a prototype; see Zalucky and Hardt (1984), equations (7) to (18).

    Raises:
        InputError: where the prototype carries effects, which these equations do not have; `beamdesign.members` does.
    """
    if prototype.effects:
        raise InputError(
            prototype.name,
            [
                (
                    f"effects.{name}",
                    "equations (7) to (18) have no such effect, and this works with them alone; remove it",
                )
                for name in prototype.effects
            ],
        )
    return LinearRig(figures(prototype), prototype.sensor.filter_Hz is not None)
