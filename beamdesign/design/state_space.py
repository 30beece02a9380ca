"""Linear models as matrices, and the plant that a controller is synthesised for."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class StateSpace:
    """x' = a x + b u, y = c x + d u."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray

    @property
    def stable(self) -> bool:
        """Whether all poles lie in the open left half plane."""
        return bool((np.linalg.eigvals(self.a).real < 0).all())

    def responses(self, s: np.ndarray) -> np.ndarray:
        """(n, outputs, inputs) at the complex frequencies s (n,)."""
        inside = np.linalg.solve(s[:, None, None] * np.eye(len(self.a)) - self.a, self.b[None].astype(complex))
        return np.asarray(self.c @ inside + self.d)

    def behind(self, first: "StateSpace") -> "StateSpace":
        """In series: what comes out of the first goes into this."""
        zero = np.zeros((len(first.a), len(self.a)))
        return StateSpace(
            np.block([[first.a, zero], [self.b @ first.c, self.a]]),
            np.vstack([first.b, self.b @ first.d]),
            np.hstack([self.d @ first.c, self.c]),
            self.d @ first.d,
        )


@dataclass(frozen=True)
class GeneralisedPlant:
    """x' = a x + b1 w + b2 u, z = c1 x + d11 w + d12 u, y = c2 x + d21 w; nothing of u comes straight into y.

    w disturbs, z is to be small, y is measured and u acts.
    """

    a: np.ndarray
    b1: np.ndarray
    b2: np.ndarray
    c1: np.ndarray
    c2: np.ndarray
    d11: np.ndarray
    d12: np.ndarray
    d21: np.ndarray

    def closed(self, law: StateSpace) -> StateSpace:
        """From w to z with u = law y."""
        a = np.block([[self.a + self.b2 @ law.d @ self.c2, self.b2 @ law.c], [law.b @ self.c2, law.a]])
        b = np.vstack([self.b1 + self.b2 @ law.d @ self.d21, law.b @ self.d21])
        c = np.hstack([self.c1 + self.d12 @ law.d @ self.c2, self.d12 @ law.c])
        return StateSpace(a, b, c, self.d11 + self.d12 @ law.d @ self.d21)
