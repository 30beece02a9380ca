"""The form of a law given by matrices: blocks of two poles each, side by side, which all its sensors share.

The law of each sensor is unit_k (d_k + sum over blocks (p + q u) / (1 + 2 z u + u^2)) with u = s / w: a pair of poles
to a block, or two real ones, all of them stable. The variables are, block by block, log w (rad/s), log z and p and q of
every sensor, then every d.
"""

from math import log, pi
from typing import Any

import numpy as np

from beamdesign.controllers.form import UNIT, Form, Polynomials, plus, times
from beamdesign.controllers.observer import Observer
from beamdesign.controllers.protocol import Sensed

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
