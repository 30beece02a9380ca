"""The sampled-data loop of a controller as realised: hold, word by word, and one period for computing."""

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from flint import arb, arb_mat, ctx, fmpq, fmpq_mat

from beamdesign.polynomial import exact
from beamdesign.prototype import Prototype
from beamdesign.realisation.linear_forms import LinearLaw
from beamdesign.realisation.realise import Realisation, floats
from beamdesign.specification.sampled_loop import HeldPlant, held_plant

_BITS = 128


class Sampled(Protocol):
    """A law at a rate."""

    @property
    def rate_Hz(self) -> float:
        """Sampling rate."""

    @property
    def linear(self) -> LinearLaw:
        """With the coefficients that it has."""


L = TypeVar("L", bound=Sampled)


@dataclass(frozen=True)
class RealisedLoop(Generic[L]):
    """The loop over the outer end mass, without command; roundings and limits left out, which are bounded elsewhere.

    States are those of the plant, the current being put out where it is late, and those of the law.

    Attributes:
        plant: between samples.
        realisation: the controller.
        delayed: whether the current is put out one period after its sample.
    """

    plant: HeldPlant
    realisation: L
    delayed: bool

    def parts(self) -> tuple[list[list[arb]], list[list[arb]], list[arb], list[arb]]:
        """Of the law's states after a sample what that of the plant's and their own adds; of its current likewise."""
        law = self.realisation.linear
        given = self.plant.readings(law.heard)

        def balls(matrix: fmpq_mat) -> list[list[arb]]:
            return [[arb(matrix[i, j]) for j in range(matrix.ncols())] for i in range(matrix.nrows())]

        return balls(law.b * given), balls(law.a), balls(law.d * given)[0], balls(law.c)[0]

    def enclosed(self, low: fmpq, high: fmpq) -> arb_mat:
        """The closed loop's matrix from sample to sample, enclosed for all masses from `low` to `high`."""
        n = self.plant.a.nrows()
        moved = self.plant.moved(low, high, self.realisation.rate_Hz)
        phi = [[moved[i, j] for j in range(n)] for i in range(n)]
        gamma = [moved[i, n] for i in range(n)]
        seen, kept, now, own = self.parts()
        m = len(own)
        current, memory = [*now, *own], [[*seen[i], *kept[i]] for i in range(m)]
        if not self.delayed:
            rows = [
                [phi[i][j] + gamma[i] * current[j] for j in range(n)] + [gamma[i] * value for value in own]
                for i in range(n)
            ]
            return arb_mat([*rows, *memory])
        rows = [[*phi[i], gamma[i], *[arb(0)] * m] for i in range(n)]
        later = [[*row[:n], arb(0), *row[n:]] for row in (current, *memory)]
        return arb_mat([*rows, *later])

    def matrix(self, mass: fmpq) -> np.ndarray:
        """The same at one mass, in floats."""
        return middle(self.enclosed(mass, mass))


@dataclass(frozen=True)
class RoundedLoop:
    """The loop at one mass with everything that enters it, in floats: x+ = A x + B u, y = C x + D u.

    Attributes:
        a, b, c, d: inputs u are the force on the tip (N, held) and the roundings of the law; outputs y the displacement
            of the tip (m), the current (A) computed at the sample, and the error (V).
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray


def realised_loop(prototype: Prototype, realisation: L, delayed: bool = True) -> RealisedLoop[L]:
    """The loop of a prototype's plant and a realised controller.

    Raises:
        InputError: for a prototype with effects; its plant is not that of equations (7) to (18).
    """
    return RealisedLoop(held_plant(prototype), realisation, delayed)


def rounded_loop(loop: RealisedLoop[Realisation], mass_kg: float) -> RoundedLoop:
    """The loop at one outer end mass with its roundings as inputs."""
    mass, law, plant = exact(mass_kg), loop.realisation.linear, loop.plant
    with ctx.workprec(_BITS):
        a = loop.matrix(mass)
        pushed = middle(plant.pushed(mass, loop.realisation.rate_Hz))
        moved = middle(plant.moved(mass, mass, loop.realisation.rate_Hz))
    n, m, late = plant.a.nrows(), len(law.states), int(loop.delayed)
    inputs = 1 + len(law.roundings)
    tip, seen = floats(plant.tip), floats(plant.readings(law.heard))
    b = np.zeros((n + late + m, inputs))
    b[:n, 0] = pushed[:n, n]
    given = floats(law.g)
    if late:
        b[n, 1:] = given
    else:
        b[:n, 1:] = moved[:n, n : n + 1] @ given
    b[n + late :, 1:] = floats(law.f)
    c, d = np.zeros((3, n + late + m)), np.zeros((3, inputs))
    c[0, :n], c[2, :n] = tip[0], seen[0]
    c[1, :n], c[1, n + late :] = (floats(law.d) @ seen)[0], floats(law.c)[0]
    d[1, 1:] = given
    return RoundedLoop(a, b, c, d)


def middle(balls: arb_mat) -> np.ndarray:
    """Midpoints in floats."""
    return np.array([[float(balls[i, j].mid()) for j in range(balls.ncols())] for i in range(balls.nrows())])
