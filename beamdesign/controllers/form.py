"""Laws with open figures: what a tuner may vary, with responses and their derivatives.

The form of a law given by matrices has blocks of two poles each, side by side, which all its sensors share: the law of
each sensor is unit_k (d_k + sum over blocks (p + q u) / (1 + 2 z u + u^2)) with u = s / w: a pair of poles to a block,
or two real ones, all of them stable. Its variables are, block by block, log w (rad/s), log z and p and q of every
sensor, then every d.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import log, pi
from typing import TYPE_CHECKING, Any

import numpy as np

from beamdesign.controllers.observer import Observer
from beamdesign.controllers.protocol import KINDS, Controller, Sensed

if TYPE_CHECKING:
    import casadi as ca

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
        gain_first: whether the first variable is the logarithm of a factor on the whole law.
    """

    sensors: tuple[Sensed, ...]
    lower: np.ndarray
    upper: np.ndarray
    polynomials: Callable[[Sequence[Any]], Polynomials]
    record: Callable[[np.ndarray], Controller]
    moves: np.ndarray
    gain_first: bool = False

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
    for seed in KINDS[kind].seeds():
        if (sought_from := seed.form()) is not None:
            return sought_from[0]
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


SLOWEST_HZ, FASTEST_HZ = 0.02, 2000.0
LEAST_DAMPING, MOST_DAMPING = 0.1, 20.0
"""Bounds of the blocks; a pole less damped than 0.1 would ring in the controller itself, and move with its parts."""

DIGITS = 9
"""To which the entries of a record are rounded."""

_FREE, _FURTHER = 1e3, 3.0
"""Bound of what is of order one, and how much further it may move than a logarithm."""


def block_form(
    sensors: tuple[Sensed, ...],
    a: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
    d: np.ndarray,
    blocks: int = 0,
    worth: np.ndarray | None = None,
) -> tuple[Form, np.ndarray] | None:
    """The form of a law with distinct poles, and its variables; real poles are paired, the slowest with the next.

    Args:
        sensors: p of them.
        a: (n, n) of its matrices, SI.
        b: (n, p)
        c: (1, n)
        d: (1, p)
        blocks: how many at least; those beyond its poles do nothing yet.
        worth: (p,) factors on the first sensor's gain that do as much through each; needed where one does nothing yet.

    Returns:
        form and variables; None for a law that is not stable, which has no such form.
    """
    poles, vectors = np.linalg.eig(a)
    if len(poles) and not poles.real.max() < 0:
        return None
    residues = (c @ vectors).ravel()[:, None] * np.linalg.solve(vectors, b.astype(complex))
    order = np.argsort(np.abs(poles))
    real = [k for k in order if abs(poles[k].imag) <= 1e-9 * abs(poles[k])]
    pairs = [(k, None) for k in order if poles[k].imag > 1e-9 * abs(poles[k])]
    if len(real) % 2:
        real.append(-1)
    pairs += list(zip(real[::2], real[1::2], strict=True))
    p = len(sensors)
    units = np.vstack([np.abs(d), np.abs(residues / poles[:, None])]).max(axis=0)
    if worth is not None:
        units = np.maximum(units, units[0] * worth)
    rows = []
    for one, two in pairs:
        first, residue = poles[one], residues[one]
        if two is None:
            second, other = first.conjugate(), residue.conjugate()
        elif two == -1:  # a lone real pole: a fast one beside it that does nothing
            second, other = complex(-2 * pi * FASTEST_HZ / 4), np.zeros(p, dtype=complex)
        else:
            second, other = poles[two], residues[two]
        square = (first * second).real
        w = np.sqrt(square)
        z = -(first + second).real / (2 * w)
        high = (residue + other).real / w
        low = -(residue * second + other * first).real / square
        rows.append(np.concatenate([[log(w), log(z)], low / units, high / units]))
    while len(rows) < blocks:
        rows.append(np.concatenate([[log(2 * pi * 10.0 * 3 ** (len(rows) - 1)), log(0.7)], np.zeros(2 * p)]))
    return _form(sensors, units, len(rows)), np.concatenate([*rows, d.ravel() / units])


def _form(sensors: tuple[Sensed, ...], units: np.ndarray, blocks: int) -> Form:
    import casadi as ca

    p = len(sensors)
    width = 2 + 2 * p
    bounds = [(log(2 * pi * SLOWEST_HZ), log(2 * pi * FASTEST_HZ)), (log(LEAST_DAMPING), log(MOST_DAMPING))]
    block = [*bounds, *[(-_FREE, _FREE)] * (2 * p)]
    limits = np.array(block * blocks + [(-_FREE, _FREE)] * p)

    def polynomials(variables: Any) -> Polynomials:
        numerators = [[unit * d] for unit, d in zip(units, variables[blocks * width :], strict=True)]
        denominator: list[Any] = [1.0]
        for first in range(0, blocks * width, width):
            u, damping = UNIT / ca.exp(variables[first]), ca.exp(variables[first + 1])
            below = [1.0, 2 * damping * u, u * u]
            for k, unit in enumerate(units):
                low, high = (variables[first + 2 + k + part] for part in (0, p))
                added = times([unit * low, unit * high * u], denominator)
                numerators[k] = plus(times(numerators[k], below), added)
            denominator = times(denominator, below)
        return numerators, denominator

    def record(variables: np.ndarray) -> Observer:
        n = 2 * blocks
        a, b, c = np.zeros((n, n)), np.zeros((n, p)), np.zeros(n)
        for i, row in enumerate(variables[: blocks * width].reshape(blocks, width)):
            w, z = np.exp(row[:2])
            at = slice(2 * i, 2 * i + 2)
            a[at, at] = [[0.0, w], [-w, -2 * z * w]]
            low, high = row[2 : 2 + p] * units, row[2 + p :] * units
            b[at] = w * np.array([high, low - 2 * z * high])
            c[2 * i] = 1.0
        gain = float(f"{units[0]:.{DIGITS}g}")
        d = variables[blocks * width :] * units
        return Observer.of(gain, sensors, rounded(a), rounded(b / gain), c, rounded(d / gain))

    moves = np.where(limits[:, 1] == _FREE, _FURTHER, 1.0)
    return Form(sensors, limits[:, 0], limits[:, 1], polynomials, record, moves)


def rounded(values: np.ndarray, digits: int = DIGITS) -> np.ndarray:
    """Values to so many significant digits."""
    return np.vectorize(lambda value: float(f"{value:.{digits}g}"), otypes=[float])(values)
