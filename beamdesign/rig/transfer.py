"""Transfer polynomials of a descriptor system in CasADi: one derivation for floats, rationals and optimisers."""

from functools import cache

import casadi as ca

from beamdesign.rig.twin_beam import FIGURES, descriptor

Polynomial = list[ca.SX]
"""Coefficients in s, ascending."""


def _times(left: Polynomial, right: Polynomial) -> Polynomial:
    product = [ca.SX(0)] * (len(left) + len(right) - 1)
    for i, a in enumerate(left):
        for j, b in enumerate(right):
            product[i + j] = product[i + j] + a * b
    return product


def _plus(left: Polynomial, right: Polynomial) -> Polynomial:
    longer, shorter = (left, right) if len(left) >= len(right) else (right, left)
    return [a + shorter[i] if i < len(shorter) else a for i, a in enumerate(longer)]


def _trimmed(polynomial: Polynomial) -> Polynomial:
    """Without leading coefficients that are structurally zero."""
    while polynomial and polynomial[-1].is_zero():
        polynomial = polynomial[:-1]
    return polynomial


def determinant(matrix: list[list[Polynomial]]) -> Polynomial:
    """Determinant of a sparse matrix of polynomials by expansion along its rows, shared minors computed once.

    No division and, for a sparse matrix, no cancellation of equal terms: coefficients keep their relative accuracy.
    """

    @cache
    def minor(row: int, columns: tuple[int, ...]) -> tuple[ca.SX, ...]:
        if row == len(matrix):
            return (ca.SX(1),)
        total: Polynomial = []
        for position, column in enumerate(columns):
            entry = matrix[row][column]
            if not entry:
                continue
            rest = list(minor(row + 1, columns[:position] + columns[position + 1 :]))
            if not rest:
                continue
            term = _times(entry, rest)
            total = _plus(total, [-t for t in term] if position % 2 else term)
        return tuple(_trimmed(total))

    return list(minor(0, tuple(range(len(matrix)))))


@cache
def transfer_polynomials(filtered: bool) -> ca.Function:
    """Figures of `twin_beam.FIGURES` to the coefficients in s, ascending, of three polynomials.

    `denominator`, det(sE - A); `control`, from current (A) to sensor voltage (V); and `disturbance`, from tip force (N)
    to displacement (m). Numerators by Cramer's rule, each output being a multiple of one state.
    """
    rig = descriptor(filtered)
    figures = ca.SX.sym("figures", len(FIGURES))
    mass, a, b, c = rig.function(figures)
    n = len(rig.states)

    def entry(row: int, column: int) -> Polynomial:
        return _trimmed([-a[row, column], mass[row, column]])

    pencil = [[entry(row, column) for column in range(n)] for row in range(n)]

    def numerator(source: int, output: int) -> Polynomial:
        state = next(j for j in range(n) if not c[output, j].is_zero())
        replaced = [[_trimmed([b[i, source]]) if j == state else pencil[i][j] for j in range(n)] for i in range(n)]
        return [c[output, state] * coefficient for coefficient in determinant(replaced)]

    polynomials = [determinant(pencil), numerator(1, 1), numerator(0, 0)]
    return ca.Function(
        "transfer_polynomials",
        [figures],
        [ca.vertcat(*p) for p in polynomials],
        ["figures"],
        ["denominator", "control", "disturbance"],
    )
