"""Complex numbers in floats with bounds of their errors, many at once; points whose hull holds arcs and inverses."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from flint import acb, arb

ARC_PARTS = 6
"""Tangents around the arc of exp(-jwT)."""

UNIT, UP, LEAST = 2.0**-53, 1 + 2.0**-48, 1e-290
"""Relative error of one rounding, what outweighs a dozen of them, and what outweighs underflow."""
_NARROW = 1e-12
"""Cosine of the widest angle between points of which a search takes the inverse."""


@dataclass(frozen=True)
class Balls:
    """Complex numbers in floats, each no farther from its middle than its radius, which is rounded up.

    Arrays (F, C1, ..., CN, V): frames, an axis for every pack that is enumerated, of length one where nothing depends
    on it, and V points. Sums and products of floats as bounded by S. M. Rump, BIT 39 (1999) 534; that of complex ones
    errs by less than 4 u |a b| (R. Brent, C. Percival, P. Zimmermann, Math. Comp. 76 (2007) 1469). In a search, where
    nothing bounds the error, there is no radius.
    """

    middle: np.ndarray
    radius: np.ndarray | None = None

    def __add__(self, other: "Balls") -> "Balls":
        """Of every point of either."""
        return self._joined(other, np.add, lambda a, b, r, t: r + t + UNIT * (a + b))

    def __mul__(self, other: "Balls") -> "Balls":
        """Of every point of either."""
        return self._joined(other, np.multiply, lambda a, b, r, t: a * t + (b + t) * r + 4 * UNIT * a * b)

    def _joined(self, other: "Balls", combined: np.ufunc, strayed: Callable[..., np.ndarray]) -> "Balls":
        middle = flat(combined(self.middle[..., :, None], other.middle[..., None, :]))
        if self.radius is None or other.radius is None:
            return Balls(middle)
        a, r = (part[..., :, None] for part in (self.size, self.radius))
        b, t = (part[..., None, :] for part in (other.size, other.radius))
        return Balls(middle, flat(UP * strayed(a, b, r, t) + LEAST))

    def beside(self, other: "Balls") -> "Balls":
        """Sums of points that belong together."""
        middle = self.middle + other.middle
        if self.radius is None or other.radius is None:
            return Balls(middle)
        return Balls(middle, UP * (self.radius + other.radius + UNIT * (self.size + other.size)) + LEAST)

    def ends(self, axis: int) -> "Balls":
        """The least and the largest of points (F, N) along the real (0) or the imaginary (1) axis."""
        along, turn = (self.middle.imag, 1j) if axis else (self.middle.real, 1 + 0j)
        ends = turn * np.stack([along.min(axis=1), along.max(axis=1)], axis=1)
        radius = None if self.radius is None else np.repeat(self.radius.max(axis=1, keepdims=True), 2, axis=1)
        return Balls(ends, radius)

    def arranged(self, anew: Callable[[np.ndarray], np.ndarray]) -> "Balls":
        """The same points with middles and radii in another order or shape, or some of them."""
        return Balls(anew(self.middle), None if self.radius is None else anew(self.radius))

    def shaped(self, shape: Sequence[int]) -> "Balls":
        """The same in another shape."""
        return self.arranged(lambda part: part.reshape(shape))

    def inverted(self) -> "Balls":
        """Points (F, V (V + 1) / 2) whose hull holds 1 / f wherever that of the points a of f does f.

        With f = sum l a, 1 / f = conj(f) / |f|^2 is the mean of (conj(a) + conj(b)) / (2 Re(a conj(b))) over all pairs,
        by the weights l m Re(a conj(b)), where these are positive. Elsewhere the points are nowhere.
        """
        i, j = np.triu_indices(self.middle.shape[1])
        sums, turned = (self.middle[:, i] + self.middle[:, j]).conj() / 2, self.turned
        middle, least = turned.middle.real[:, i, j], turned.least[:, i, j]
        if self.radius is None:
            return Balls(sums / np.maximum(middle, _NARROW * self.size[:, i] * self.size[:, j]))
        apart, size = least > 0, UP * np.abs(sums)
        middle, least = np.where(apart, middle, 1.0), np.where(apart, least, 1.0)
        strayed = (self.radius[:, i] + self.radius[:, j]) / 2 + 8 * UNIT * size + size * (middle - least) / middle
        return Balls(sums / middle, np.where(apart, UP * strayed / least + LEAST, np.inf))

    @property
    def turned(self) -> "Balls":
        """The products (F, V, V) of points (F, V) with the conjugates of all."""
        middle = self.middle[:, :, None] * self.middle[:, None].conj()
        if self.radius is None:
            return Balls(middle)
        a, b, r, t = self.size[:, :, None], self.size[:, None], self.radius[:, :, None], self.radius[:, None]
        return Balls(middle, UP * (a * t + (b + t) * r + 6 * UNIT * a * b) + LEAST)

    @property
    def least(self) -> np.ndarray:
        """Lower bounds of the real parts."""
        return np.asarray(self.middle.real - (0.0 if self.radius is None else UP * self.radius))

    def with_those(self, which: Any, others: Any) -> "Balls":
        """The points (P, 2 V) of some frames and of some others."""
        return self.arranged(lambda part: np.concatenate([part[which], part[others]], axis=1))

    @cached_property
    def size(self) -> np.ndarray:
        """Upper bounds of the sizes of the middles."""
        return np.asarray(UP * np.abs(self.middle))

    @cached_property
    def largest(self) -> np.ndarray:
        """Upper bounds (F, C1, ..., CN) of the size of any of the V points."""
        sizes = np.abs(self.middle) if self.radius is None else UP * (self.size + self.radius)
        return np.asarray(sizes.max(axis=-1))

    @cached_property
    def _blur(self) -> np.ndarray:
        assert self.radius is not None  # in a proof
        return np.asarray(UP * (self.radius + 4 * UNIT * self.size))

    def along(self, x: np.ndarray | int, y: np.ndarray | int, which: Any = ...) -> np.ndarray:
        """Lower bounds (F, C1, ..., CN) of the real part of the points times the conjugate of a direction x + j y.

        Of some frames only where `which` says so, each by the direction of its own then.
        """
        middle = self.middle[which]
        strayed = (np.abs(x) + np.abs(y)) * self._blur[which]
        return np.asarray((x * middle.real + y * middle.imag - UP * strayed - LEAST).min(axis=-1))


def flat(points: np.ndarray) -> np.ndarray:
    """With the last two axes as one."""
    return points.reshape(*points.shape[:-2], points.shape[-2] * points.shape[-1])


def balls(points: Sequence[acb]) -> Balls:
    """Points (V,) as they are."""
    middle = [complex(point) for point in points]
    radius = [float(abs(point - acb(at)).upper()) for point, at in zip(points, middle, strict=True)]
    return Balls(np.array(middle), UP * np.array(radius) + LEAST)


def arc(start: arb, sweep: arb) -> list[acb]:
    """The ends of the arc exp(-j angle) over some angles, and the corners of tangents around it."""
    sweep = sweep if sweep < turn() else turn()
    shrink = (sweep / (2 * ARC_PARTS)).cos()
    corners = [unit(start + sweep * (2 * i + 1) / (2 * ARC_PARTS)) / shrink for i in range(ARC_PARTS)]
    return [unit(start), *corners, unit(start + sweep)]


def turn() -> arb:
    """A full one."""
    return 2 * arb.pi()


def unit(angle: arb) -> acb:
    """exp(-j angle)."""
    return acb(angle.cos(), -angle.sin())
