"""The plant between two samples, its current held, enclosed for a piece of the outer end masses."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from flint import arb, arb_mat, fmpq, fmpq_mat

from beamdesign.controllers import SENSED
from beamdesign.plant.linearised import SEEN
from beamdesign.plant.members import paper_model
from beamdesign.polynomial import exact
from beamdesign.prototype import Prototype
from beamdesign.rational import nearest


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

    def shares(self, low: fmpq, high: fmpq) -> tuple[fmpq, fmpq]:
        """Middle and half the width of one over the total mass, 1/kg, between two masses."""
        most, least = 1 / (self.bare_mass + low), 1 / (self.bare_mass + high)
        return (most + least) / 2, (most - least) / 2

    def moved(self, low: fmpq, high: fmpq, duration_s: arb, by_force: bool = False) -> arb_mat:
        """exp([[A, B], [0, 0]] T), enclosed for all masses from `low` to `high` and durations T of a ball.

        Its upper rows are Phi and Gamma; `by_force` with the force, held between samples, in place of the current.
        """
        return arb_mat(self._rates(low, high, duration_s, self.force if by_force else self.b)).exp()

    def slope(self, low: fmpq, high: fmpq, duration_s: arb) -> arb_mat:
        """The same, with the current, of its derivative by one over the total mass: exp([[M, M'], [0, M]])."""
        rates, n = self._rates(low, high, duration_s, self.b), self.a.nrows() + 1
        none, by_share = [arb(0)] * n, self._rates(1 - self.bare_mass, 1 - self.bare_mass, duration_s, self.b)
        upper = [row + (by_share[i] if i == self.velocity else none) for i, row in enumerate(rates)]
        whole = arb_mat(upper + [none + row for row in rates]).exp()
        return arb_mat([[whole[i, n + j] for j in range(n)] for i in range(n)])

    def _rates(self, low: fmpq, high: fmpq, duration_s: arb, held: fmpq_mat) -> list[list[arb]]:
        """[[A, B], [0, 0]] T."""
        n, (share, half) = self.a.nrows(), self.shares(low, high)
        scales = [duration_s * (arb(share) + arb(0, arb(half)) if i == self.velocity else 1) for i in range(n)]
        rows = [
            [*(arb(self.a[i, j]) * scale for j in range(n)), arb(held[i, 0]) * scale] for i, scale in enumerate(scales)
        ]
        return [*rows, [arb(0)] * (n + 1)]

    def readings(self, sensed: Sequence[str]) -> fmpq_mat:
        """(k, n) to what a law hears without command: minus the volts as its error, others as they are."""
        n, rows = self.a.nrows(), []
        for name in sensed:
            if name in self.seen:
                sign = -1 if name == SENSED[0] else 1
                rows.append([sign * self.seen[name][0, j] for j in range(n)])
            else:
                rows.append([fmpq(0)] * n)
        return fmpq_mat(len(rows), n, [value for row in rows for value in row])


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
