"""The sampled-data loop of a controller as realised, proved stable for every outer end mass of a range.

The plant is continuous, its current held between samples; the law works at sample times, word by word, and its current
is put out at once, one whole period later, or after a computing time, at every sample alike: times that change may make
a loop grow that is stable at each of them. Between samples x' = A(m) x + B i, so that from sample to sample

    x[k+1] = Phi(m) x[k] + Gamma(m) i,    (Phi, Gamma) = the upper rows of exp([[A, B], [0, 0]] T),

with the controller's state and the current held as further states (K. J. Astrom and B. Wittenmark, Computer-Controlled
Systems, 3rd ed. (1997), section 3.2). With a computing time tau the old current is held for tau and the new one for the
rest of the period,

    x[k+1] = Phi x[k] + (Gamma(T) - Gamma(T - tau)) i[k-1] + Gamma(T - tau) i[k].

A is affine in s, one over the total mass. Over a piece of the masses and for all tau of an interval, the closed loop is
Z(s) = Z(s0) + (s - s0) E with E a matrix within the balls that enclose Z'(s), s0 being the middle of the piece in s: it
lies between Z(s0) - w E and Z(s0) + w E, w being half the width. Norms are convex, so the whole piece contracts where
these two do, in any coordinates T: I - Z'Z with Z = T^-1 (either) T is positive definite for every matrix within the
balls if Cholesky's pivots in balls are positive. T is modal at s0, its columns scaled by Perron's vectors so that w E
moves the least of the contraction (J. Stoer and C. Witzgall, Numer. Math. 4 (1962) 158). Where this fails, the piece is
halved; intervals of the computing time are, where the proof over the masses is not found.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from flint import arb, arb_mat, ctx, fmpq, fmpq_mat

from beamdesign.build.realisation.law import DifferenceEquation, LinearLaw
from beamdesign.controllers import SENSED, SENSORS
from beamdesign.plant.linear import SEEN_AS
from beamdesign.plant.members import paper_model
from beamdesign.polynomial import exact, nearest
from beamdesign.progress import Progress, silent
from beamdesign.proofs.mass_family import floats
from beamdesign.prototype import Prototype

if TYPE_CHECKING:
    from beamdesign.build.realisation.realise import Realisation

LOOP_BITS = 128
_PIECES, _TRIED = 4000, 50
"""Most pieces of a range, and how many tell whether it would take more: what is proved grows from its lower end."""
_NARROWEST = fmpq(1, 2**20)  # of the range: where such a piece gives no proof, narrower ones do not either
_FIRST = 32
"""Intervals to begin with: where they are too wide, finding that out costs as much as ten that are not."""
_LEAST = fmpq(1, 512)


@dataclass(frozen=True)
class HeldPlant:
    """The plant over the outer end mass, exact; the rows of the outer tip's velocity are divided by the total mass.

    Attributes:
        a: (n, n) of the plant in balanced states; b: (n, 1) from the current.
        seen: (1, n) to the sensor's volts, and to what else may be sensed (m, Pa, N), by the names of `SENSORS`.
        velocity: index of the row that the total mass divides.
        bare_mass: kg.
        tip: (1, n) to its displacement, m.
    """

    a: fmpq_mat
    b: fmpq_mat
    seen: dict[str, fmpq_mat]
    velocity: int
    bare_mass: fmpq
    tip: fmpq_mat
    _known: dict[tuple[str, fmpq, fmpq, float, int], arb_mat] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def shares(self, low: fmpq, high: fmpq) -> tuple[fmpq, fmpq]:
        """Middle and half the width of one over the total mass, 1/kg, between two masses."""
        most, least = 1 / (self.bare_mass + low), 1 / (self.bare_mass + high)
        return (most + least) / 2, (most - least) / 2

    def moved(self, low: fmpq, high: fmpq, duration_s: arb) -> arb_mat:
        """exp([[A, B], [0, 0]] T), enclosed for all masses from `low` to `high` and durations T of a ball.

        Its upper rows are Phi and Gamma.
        """
        return arb_mat(self._rates(low, high, duration_s)).exp()

    def slope(self, low: fmpq, high: fmpq, duration_s: arb) -> arb_mat:
        """The same of its derivative by one over the total mass: exp([[M, M'], [0, M]])."""
        rates, n = self._rates(low, high, duration_s), self.a.nrows() + 1
        none, by_share = [arb(0)] * n, self._rates(1 - self.bare_mass, 1 - self.bare_mass, duration_s)
        upper = [row + (by_share[i] if i == self.velocity else none) for i, row in enumerate(rates)]
        whole = arb_mat(upper + [none + row for row in rates]).exp()
        return arb_mat([[whole[i, n + j] for j in range(n)] for i in range(n)])

    def _rates(self, low: fmpq, high: fmpq, duration_s: arb) -> list[list[arb]]:
        """[[A, B], [0, 0]] T."""
        n, (share, half) = self.a.nrows(), self.shares(low, high)
        scales = [duration_s * (arb(share) + arb(0, arb(half)) if i == self.velocity else 1) for i in range(n)]
        rows = [
            [*(arb(self.a[i, j]) * scale for j in range(n)), arb(self.b[i, 0]) * scale]
            for i, scale in enumerate(scales)
        ]
        return [*rows, [arb(0)] * (n + 1)]

    def readings(self, sensed: Sequence[str]) -> fmpq_mat:
        """(k, n) to what a law hears without command: minus the volts as its error, others as they are."""
        n = self.a.nrows()
        own = self.seen | {SENSED[0]: -self.seen[SENSED[0]]}
        rows = [own.get(name, fmpq_mat(1, n)) for name in sensed]
        return fmpq_mat(len(rows), n, [value for row in rows for value in row.entries()])


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
        name: fmpq_mat(1, n, [c[SEEN_AS[name], j] * scales[j] for j in range(n)]) for name in SENSORS
    }
    tip = fmpq_mat(1, n, [c[0, j] * scales[j] for j in range(n)])
    return HeldPlant(balanced, current, seen, velocity, mass, tip)


def _balance(a: fmpq_mat, velocity: int, mass: fmpq) -> list[fmpq]:
    """Powers of two by which states are scaled, so that rows and columns are of one size."""
    from scipy.linalg import matrix_balance

    rates = floats(a)
    rates[velocity] /= nearest(mass)
    scale = matrix_balance(rates, permute=False, separate=True)[1][0]
    return [fmpq(2) ** int(np.rint(np.log2(s))) for s in scale]


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


@dataclass(frozen=True)
class RealisedLoop:
    """The loop over the outer end mass, without command; roundings and limits left out, which are bounded elsewhere.

    States are those of the plant, the current being put out where it is late, and those of the law.

    Attributes:
        plant: between samples.
        law: of the controller, with the coefficients that it has.
        rate_Hz: sampling rate.
        computing: ends of the interval of computing times, as shares of the period: 0 where the current is put out at
            its sample, 1 where it is one period later.
    """

    plant: HeldPlant
    law: LinearLaw
    rate_Hz: float
    computing: tuple[fmpq, fmpq]

    @property
    def delayed(self) -> bool:
        """Whether the current before is out for a part of the period."""
        return self.computing[1] > 0

    @property
    def period_s(self) -> arb:
        """Between two samples."""
        return arb(1) / arb(exact(self.rate_Hz))

    def parts(self) -> tuple[list[list[arb]], list[list[arb]], list[arb], list[arb]]:
        """Of the law's states after a sample what that of the plant's and their own adds; of its current likewise."""
        law, given = self.law, self.plant.readings(self.law.sensed)
        seen, kept, now, own = (arb_mat(part).tolist() for part in (law.b * given, law.a, law.d * given, law.c))
        return seen, kept, now[0], own[0]

    def closed(self, moved: arb_mat, fresh: arb_mat | None) -> arb_mat:
        """The closed loop's matrix from sample to sample.

        Args:
            moved: of the plant's states and a current held for a period.
            fresh: likewise for the part of a period in which the new current is out, the old one being out before; None
                where that is the whole of it, so that the old current is no state.
        """
        seen, kept, now, own = self.parts()
        n, held = len(now), [] if fresh is None else [arb(0)]
        current, memory = [*now, *held, *own], [[*one, *held, *other] for one, other in zip(seen, kept, strict=True)]
        rows = []
        for i in range(n):
            new = moved[i, n] if fresh is None else fresh[i, n]
            old = [] if fresh is None else [moved[i, n] - new]
            before = [*(moved[i, j] for j in range(n)), *old, *[arb(0)] * len(own)]
            rows.append([value + new * added for value, added in zip(before, current, strict=True)])
        return arb_mat([*rows, *([current] if held else []), *memory])

    def enclosed(self, low: fmpq, high: fmpq) -> arb_mat:
        """The same, enclosed for all masses from `low` to `high` and all computing times."""
        return self._enclosed(self.plant.moved, low, high)

    def changed(self, low: fmpq, high: fmpq) -> arb_mat:
        """Likewise what half the piece changes at most: half its width in one over the total mass times the slope."""
        whole, n = self._enclosed(self.plant.slope, low, high), self.plant.a.nrows()
        half = arb(self.plant.shares(low, high)[1])
        rows = range(whole.nrows())  # of the law and of the current being put out, none depends on the mass
        return arb_mat([[whole[i, j] * half if i < n else arb(0) for j in rows] for i in rows])

    def _enclosed(self, moved: Callable[[fmpq, fmpq, arb], arb_mat], low: fmpq, high: fmpq) -> arb_mat:
        if not self.delayed:
            return self.closed(moved(low, high, self.period_s), None)
        first, last = self.computing
        rest = self.period_s * arb(1 - first).union(arb(1 - last))
        known, key = self.plant._known, (moved.__name__, low, high, self.rate_Hz, ctx.prec)
        if key not in known:  # over a whole period it is the same at every computing time
            known[key] = moved(low, high, self.period_s)
        return self.closed(known[key], moved(low, high, rest))

    def matrix(self, mass: fmpq) -> np.ndarray:
        """The same at one mass in the middle of the interval, in floats."""
        return middle(self.enclosed(mass, mass))


def realised_loop(
    prototype: Prototype, realisation: "Realisation | DifferenceEquation", delayed: bool = True
) -> RealisedLoop:
    """The loop of a prototype's plant and a realised controller.

    Args:
        prototype: whose plant it is.
        realisation: the controller.
        delayed: whether the current is put out one period after its sample.

    Raises:
        InputError: for a prototype with effects; its plant is not that of equations (7) to (18).
    """
    return RealisedLoop(held_plant(prototype), realisation.linear, realisation.rate_Hz, (fmpq(delayed),) * 2)


def prove_sampled(loop: RealisedLoop, low_kg: float, high_kg: float) -> SampledVerdict:
    """Prove stability for every outer end mass of a closed range, or say at which mass it does not hold."""
    low, high = exact(low_kg), exact(high_kg)
    proved, reached, open_pieces = 0, low, [(low, high)]
    with ctx.workprec(LOOP_BITS):
        ends = [float(np.abs(np.linalg.eigvals(loop.matrix(end))).max()) for end in dict.fromkeys((low, high))]
        largest, seen = max(ends), len(ends)
        while open_pieces and largest < 1:
            first, last = open_pieces.pop()
            centre = 1 / loop.plant.shares(first, last)[0] - loop.plant.bare_mass
            enclosed = loop.enclosed(centre, centre)
            values, vectors = np.linalg.eig(middle(enclosed))
            largest = max(largest, float(np.abs(values).max()))
            seen += 1
            if largest >= 1:
                break
            if _contracts(enclosed, loop.changed(first, last), values, vectors):
                proved, reached = proved + 1, last
            elif last - first <= _NARROWEST * (high - low) or (
                proved >= _TRIED and proved * (high - low) > _PIECES * (reached - low)
            ):
                reason = f"no proof between {nearest(first):.6g} and {nearest(last):.6g} kg"
                return SampledVerdict(None, reason, proved, largest, seen)
            else:
                open_pieces += [(centre, last), (first, centre)]
    if largest >= 1:
        reason = f"a characteristic value of modulus {largest:.6g} (floating point)"
        return SampledVerdict(False, reason, proved, largest, seen)
    return SampledVerdict(True, "", proved, largest, seen)


def _contracts(middle_of: arb_mat, changed: arb_mat, values: np.ndarray, vectors: np.ndarray) -> bool:
    """Whether a matrix contracts, whatever share of -1 to 1 of a change is added, in one frame of coordinates.

    Args:
        middle_of: the matrix, in balls.
        changed: what is added, enclosed.
        values: eigenvalues of the matrix in floats, of modulus below 1.
        vectors: its eigenvectors.
    """
    n, away = len(vectors), np.abs(np.linalg.pinv(vectors) @ middle(changed) @ vectors)
    slack = np.sqrt(1 - np.abs(values) ** 2)
    away = away / np.outer(slack, slack)
    away = np.maximum(away / (away.max() or 1.0), 1e-9)
    right, left = (np.abs(v[:, np.argmax(e.real)]) for e, v in map(np.linalg.eig, (away, away.T)))
    vectors = vectors * np.sqrt(right / left)
    columns = [part for k in np.flatnonzero(values.imag >= 0) for part in _parts(vectors[:, k], values[k].imag > 0)]
    if len(columns) != n:
        return False
    frame = arb_mat([[arb(float(x)) for x in row] for row in np.column_stack(columns)])
    one = arb_mat([[arb(int(i == j)) for j in range(n)] for i in range(n)])
    try:
        inverse = frame.inv()
    except ZeroDivisionError:
        return False
    ends = [inverse * (middle_of + sign * changed) * frame for sign in (1, -1)]
    return all(_positive_definite(one - end.transpose() * end) for end in ends)


def _parts(vector: np.ndarray, is_complex: bool) -> list[np.ndarray]:
    return [vector.real, vector.imag] if is_complex else [vector.real]


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


def prove_any_computing_time(
    loop: RealisedLoop, low_kg: float, high_kg: float, progress: Progress = silent
) -> SampledVerdict:
    """Prove stability for every outer end mass of a closed range and every computing time up to one period.

    It stays open where two characteristic values meet on the way, in whose modal coordinates nothing contracts.

    Args:
        loop: of the realised controller; its own computing time plays no part.
        low_kg: least mass.
        high_kg: largest mass.
        progress: told the share done, and what is looked at.
    """
    open_intervals = [(fmpq(k, _FIRST), fmpq(k + 1, _FIRST)) for k in range(_FIRST)]  # the latest first
    pieces, largest, seen = 0, 0.0, 0
    while open_intervals:
        first, last = open_intervals.pop()
        progress(1 - nearest(last), f"computing time of {nearest(last):.3g} periods")
        found = prove_sampled(replace(loop, computing=(first, last)), low_kg, high_kg)
        pieces, largest, seen = pieces + found.pieces, max(largest, found.largest_modulus), seen + found.looked_at
        if found.stable:
            continue
        where = f"at a computing time of {nearest(first):.6g} to {nearest(last):.6g} periods: {found.reason}"
        if found.stable is False or last - first <= _LEAST:
            return SampledVerdict(found.stable, where, pieces, largest, seen)
        open_intervals += [(first, (first + last) / 2), ((first + last) / 2, last)]
    return SampledVerdict(True, "", pieces, largest, seen)


def middle(balls: arb_mat) -> np.ndarray:
    """Midpoints in floats."""
    return np.array(balls.mid().tolist(), dtype=float)
