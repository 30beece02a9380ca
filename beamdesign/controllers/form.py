"""Laws with open figures: what a tuner may vary, with responses and their derivatives."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import pi
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import casadi as ca

    from beamdesign.controllers.protocol import Controller, Sensed

UNIT = 2 * pi * 10.0
"""rad/s: polynomials are in s over this, so that their coefficients are of moderate size."""

Polynomials = tuple[Sequence[Sequence[Any]], Sequence[Any]]
"""Numerators, one per sensor, and the denominator that they share; coefficients ascending in s / `UNIT`."""


@dataclass(frozen=True, eq=False)
class Form:
    """A family of laws with v variables, most of them logarithms, so that a step means as much anywhere.

    Attributes:
        sensors: what its laws sense, p of them.
        lower: (v,) least variables.
        upper: (v,) largest ones.
        polynomials: CasADi symbols of the variables to the law from each sensor to current, A/V, A/m or A/Pa.
        record: variables to the controller's record, its figures rounded to what a person would copy down.
        moves: (v,) how much further than a logarithm a variable may move in a step.
    """

    sensors: "tuple[Sensed, ...]"
    lower: np.ndarray
    upper: np.ndarray
    polynomials: Callable[[Sequence[Any]], Polynomials]
    record: "Callable[[np.ndarray], Controller]"
    moves: np.ndarray

    @property
    def size(self) -> int:
        """How many variables there are."""
        return len(self.lower)

    @cached_property
    def coefficients(self) -> "ca.Function":
        """Variables to coefficients (p + 1, q): a row for each numerator, then the denominator; and their Jacobian."""
        import casadi as ca

        variables = ca.SX.sym("variables", self.size)
        numerators, denominator = self.polynomials(ca.vertsplit(variables))
        rows = [*numerators, denominator]
        width = max(map(len, rows))
        table = ca.vertcat(*(ca.horzcat(*row, *[0.0] * (width - len(row))) for row in rows))
        return ca.Function("coefficients", [variables], [table, ca.jacobian(ca.vec(table), variables)])

    def responses(self, variables: np.ndarray, s: np.ndarray) -> np.ndarray:
        """(p, n) from each sensor to current, at complex frequencies s (n,), rad/s."""
        table = np.asarray(self.coefficients(variables)[0])
        values = table @ np.vander(s / UNIT, table.shape[1], increasing=True).T
        return np.asarray(values[:-1] / values[-1])

    def slopes(self, variables: np.ndarray, s: np.ndarray) -> np.ndarray:
        """(p, n, v) derivatives of the responses by the variables."""
        table, jacobian = (np.asarray(part) for part in self.coefficients(variables))
        powers = np.vander(s / UNIT, table.shape[1], increasing=True)
        values = table @ powers.T
        by = powers @ jacobian.reshape((*table.shape, -1), order="F")
        law = values[:-1] / values[-1]
        return np.asarray((by[:-1] - law[:, :, None] * by[-1]) / values[-1][:, None])


def form_of(kind: str) -> Form:
    """The form of a registered kind's first seed.

    Raises:
        ValueError: for a kind that has none.
    """
    from beamdesign.controllers.protocol import KINDS

    for seed in KINDS[kind].seeds():
        if (opened := seed.form()) is not None:
            return opened[0]
    raise ValueError(f"a {kind} controller has no form to be tuned in")


def times(left: Sequence[Any], right: Sequence[Any]) -> list[Any]:
    """Coefficients of the product of two polynomials, ascending."""
    product: list[Any] = [0.0] * (len(left) + len(right) - 1)
    for i, one in enumerate(left):
        for j, two in enumerate(right):
            product[i + j] = product[i + j] + one * two
    return product


def plus(left: Sequence[Any], right: Sequence[Any]) -> list[Any]:
    """Coefficients of the sum of two polynomials, ascending."""
    length = max(len(left), len(right))
    return [sum(one[k] for one in (left, right) if k < len(one)) for k in range(length)]
