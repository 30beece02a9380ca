"""Stability of the sampled-data loop, proved for every outer end mass of a range.

The plant is continuous, its current held between samples; the difference equation works at sample times, and its
current is put out at once or one whole period later. Between samples x' = A(m) x + B i, so that from sample to sample

    x[k+1] = Phi(m) x[k] + Gamma(m) i,    (Phi, Gamma) = the upper rows of exp([[A, B], [0, 0]] T),

with the controller's state and the current held as further states (K. J. Astrom and B. Wittenmark, Computer-Controlled
Systems, 3rd ed. (1997), section 3.2). Phi and Gamma are enclosed in balls for all masses of a piece of the range; in
coordinates T in which the middle of the piece contracts, I - Z'Z with Z = T^-1 (closed loop) T is positive definite for
every matrix within the balls if Cholesky's pivots in balls are positive: then every member is a contraction. Where this
fails, the piece is halved.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from flint import arb, arb_mat, ctx, fmpq, fmpq_mat

from beamdesign.controllers import SENSED
from beamdesign.plant.linearised import SEEN
from beamdesign.plant.members import paper_model
from beamdesign.polynomial import exact
from beamdesign.prototype import Prototype
from beamdesign.rational import nearest

_BITS = 128
_PIECES, _TRIED = 4000, 50
"""Most pieces of a range, and how many tell whether it would take more: what is proved grows from its lower end."""
_NARROWEST = fmpq(1, 2**20)  # of the range: where such a piece gives no proof, narrower ones do not either


@dataclass(frozen=True)
class SampledVerdict:
    """Stability of the sampled-data loop.

    Attributes:
        stable: True where proved for every mass of the range; False where the loop of one mass has a characteristic
            value on or outside the unit circle, by eigenvalues in floating point; None where neither was found.
        reason: in words, why it is not True; empty where it is.
        pieces: number of pieces of the range that were proved.
        largest_modulus: of the characteristic values at the masses looked at, in floating point.
        looked_at: number of masses at which they were looked at.
    """

    stable: bool | None
    reason: str
    pieces: int
    largest_modulus: float
    looked_at: int


class ClosedOverMass(Protocol):
    """A loop whose matrix from sample to sample is known over the outer end mass."""

    def enclosed(self, low: fmpq, high: fmpq) -> arb_mat:
        """The matrix, enclosed for all masses from `low` to `high`."""

    def matrix(self, mass: fmpq) -> np.ndarray:
        """The matrix at one mass, in floats."""


@dataclass(frozen=True)
class HeldPlant:
    """The plant over the outer end mass, exact; the rows of the outer tip's velocity are divided by the total mass.

    Attributes:
        a: (n, n) of the plant in balanced states; b: (n, 1) from the current.
        seen: (1, n) to the sensor's volts, and to what else may be sensed (m, Pa), by the names of `SENSED`.
        velocity: index of the row that the total mass divides.
        bare_mass: kg.
        force: (n, 1) from the disturbance on the outer tip, N.
        tip: (1, n) to its displacement, m.
    """

    a: fmpq_mat
    b: fmpq_mat
    seen: Mapping[str, fmpq_mat]
    velocity: int
    bare_mass: fmpq
    force: fmpq_mat
    tip: fmpq_mat

    def moved(self, low: fmpq, high: fmpq, rate_Hz: float) -> arb_mat:
        """exp([[A, B], [0, 0]] T), enclosed for all masses from `low` to `high`: its upper rows are Phi and Gamma."""
        return self._exponential(self.b, low, high, arb(1) / arb(exact(rate_Hz)))

    def moved_for(self, low: fmpq, high: fmpq, duration_s: arb) -> arb_mat:
        """The same over a duration, or enclosed for all durations of a ball."""
        return self._exponential(self.b, low, high, duration_s)

    def pushed(self, mass: fmpq, rate_Hz: float) -> arb_mat:
        """The same with the force, held between samples, in place of the current."""
        return self._exponential(self.force, mass, mass, arb(1) / arb(exact(rate_Hz)))

    def readings(self, heard: Sequence[str]) -> fmpq_mat:
        """(k, n) to what a law hears without command: minus the volts as its error, others as they are."""
        n, rows = self.a.nrows(), []
        for name in heard:
            if name in self.seen:
                sign = -1 if name == SENSED[0] else 1
                rows.append([sign * self.seen[name][0, j] for j in range(n)])
            else:
                rows.append([fmpq(0)] * n)
        return fmpq_mat(len(rows), n, [value for row in rows for value in row])

    def _exponential(self, held: fmpq_mat, low: fmpq, high: fmpq, step: arb) -> arb_mat:
        n = self.a.nrows()
        share = (arb(1) / arb(self.bare_mass + low)).union(arb(1) / arb(self.bare_mass + high))
        whole = [[arb(0)] * (n + 1) for _ in range(n + 1)]
        for i in range(n):
            scale = step * share if i == self.velocity else step
            whole[i] = [arb(self.a[i, j]) * scale for j in range(n)] + [arb(held[i, 0]) * scale]
        return arb_mat(whole).exp()


def held_plant(prototype: Prototype) -> HeldPlant:
    """The plant of a prototype, whose inputs are held between samples.

    Raises:
        InputError: for a prototype with effects; its plant is not that of equations (7) to (18).
    """
    inner = exact(prototype.payload.inner_end_mass_kg)
    a, b, c, velocity, mass = paper_model(prototype).over_outer_mass(inner)
    n = a.nrows()
    scales = _balance(a, velocity, mass)
    balanced = fmpq_mat(n, n, [a[i, j] * scales[j] / scales[i] for i in range(n) for j in range(n)])
    current = fmpq_mat(n, 1, [b[i, 1] / scales[i] for i in range(n)])
    seen: dict[str, fmpq_mat] = {
        name: fmpq_mat(1, n, [c[SEEN.index(as_seen), j] * scales[j] for j in range(n)])
        for name, as_seen in zip(SENSED, ("measured_V", *SENSED[1:]), strict=True)
    }
    force = fmpq_mat(n, 1, [b[i, 0] / scales[i] for i in range(n)])
    tip = fmpq_mat(1, n, [c[0, j] * scales[j] for j in range(n)])
    return HeldPlant(balanced, current, seen, velocity, mass, force, tip)


def _balance(a: fmpq_mat, velocity: int, mass: fmpq) -> list[fmpq]:
    """Powers of two by which states are scaled, so that rows and columns are of one size."""
    from scipy.linalg import matrix_balance

    n = a.nrows()
    floats = np.array([[nearest(a[i, j]) for j in range(n)] for i in range(n)])
    floats[velocity] /= nearest(mass)
    scale = matrix_balance(floats, permute=False, separate=True)[1][0]
    return [fmpq(2) ** int(np.rint(np.log2(s))) for s in scale]


def prove_sampled(loop: ClosedOverMass, low_kg: float, high_kg: float) -> SampledVerdict:
    """Prove stability for every outer end mass of a closed range, or say at which mass it does not hold."""
    low, high = exact(low_kg), exact(high_kg)
    largest, proved, seen, reached = 0.0, 0, 0, low
    open_pieces = [(low, high)]
    with ctx.workprec(_BITS):
        for end in dict.fromkeys((low, high)):
            modulus = float(np.abs(np.linalg.eigvals(loop.matrix(end))).max())
            seen += 1
            largest = max(largest, modulus)
        while open_pieces and largest < 1:
            first, last = open_pieces.pop()
            middle = (first + last) / 2
            matrix = loop.matrix(middle)
            values, vectors = np.linalg.eig(matrix)
            largest = max(largest, float(np.abs(values).max()))
            seen += 1
            if _contracts(loop.enclosed(first, last), values, vectors):
                proved, reached = proved + 1, last
            elif last - first <= _NARROWEST * (high - low) or (
                proved >= _TRIED and proved * (high - low) > _PIECES * (reached - low)
            ):
                reason = f"no proof between {nearest(first):.6g} and {nearest(last):.6g} kg"
                return SampledVerdict(None, reason, proved, largest, seen)
            else:
                open_pieces += [(middle, last), (first, middle)]
    if largest >= 1:
        reason = f"a characteristic value of modulus {largest:.6g} (floating point)"
        return SampledVerdict(False, reason, proved, largest, seen)
    return SampledVerdict(True, "", proved, largest, seen)


def _contracts(enclosed: arb_mat, values: np.ndarray, vectors: np.ndarray) -> bool:
    """Whether every matrix of an enclosure contracts in the real modal coordinates of its middle."""
    columns = []
    for k, value in enumerate(values):
        if value.imag > 0:
            columns += [vectors[:, k].real, vectors[:, k].imag]
        elif value.imag == 0:
            columns.append(vectors[:, k].real)
    frame = np.column_stack(columns)
    n = len(frame)
    if frame.shape != (n, n):
        return False
    coordinates = arb_mat([[arb(float(x)) for x in row] for row in frame])
    try:
        there = coordinates.inv() * enclosed * coordinates
    except ZeroDivisionError:
        return False
    return _positive_definite(
        arb_mat([[arb(int(i == j)) for j in range(n)] for i in range(n)]) - there.transpose() * there
    )


def _positive_definite(matrix: arb_mat) -> bool:
    """Cholesky without roots, in balls: positive pivots prove it for every symmetric matrix enclosed."""
    n = matrix.nrows()
    rows = [[matrix[i, j] for j in range(n)] for i in range(n)]
    for k in range(n):
        pivot = rows[k][k]
        if not pivot > 0:
            return False
        for i in range(k + 1, n):
            factor = rows[i][k] / pivot
            for j in range(k + 1, n):
                rows[i][j] = rows[i][j] - factor * rows[k][j]
    return True
