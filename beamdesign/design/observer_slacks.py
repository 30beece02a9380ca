"""What a controller with several sensors leaves of every limit at sampled points, with derivatives by its figures.

Its transfer functions share their poles: K_k(s) = unit_k (d_k + sum over blocks (p + q u) / (1 + 2 z u + u^2)) with
u = s / w. Two poles to a block, a pair or two real ones; all of them stable. The variables are, block by block, log w
(rad/s), log z and p and q of every sensor, then every d, then the inner end mass in kg.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import log, pi

import numpy as np

from beamdesign.design.sampled_loops import Slacks
from beamdesign.design.sensed_samples import SensedSamples
from beamdesign.design.state_space import StateSpace
from beamdesign.prototype import Goal

SLOWEST_HZ, FASTEST_HZ = 0.02, 2000.0
LEAST_DAMPING, MOST_DAMPING = 0.1, 20.0
"""Bounds of the blocks; a pole less damped than 0.1 would ring in the controller itself, and move with its parts."""


@dataclass(frozen=True)
class BlockLaw:
    """The form of such a controller.

    Attributes:
        blocks: how many pairs of poles.
        units: (p,) of the transfer functions, A/V, A/m and A/Pa: what makes the other figures of order one.
    """

    blocks: int
    units: np.ndarray

    @property
    def sensors(self) -> int:
        """How many it reads."""
        return len(self.units)

    @property
    def size(self) -> int:
        """Number of the variables, with the inner end mass."""
        return self.blocks * (2 + 2 * self.sensors) + self.sensors + 1

    def bounds(self, largest_inner: float) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest variables, (v,) each."""
        free = [(-1e3, 1e3)]
        block = [(log(2 * pi * SLOWEST_HZ), log(2 * pi * FASTEST_HZ)), (log(LEAST_DAMPING), log(MOST_DAMPING))]
        rows = np.array((block + free * 2 * self.sensors) * self.blocks + free * self.sensors + [(0.0, largest_inner)])
        return rows[:, 0], rows[:, 1]

    def model(self, variables: np.ndarray) -> StateSpace:
        """Matrices a (2 k, 2 k) block diagonal, b (2 k, p), c (1, 2 k) and d (1, p) of the controller, SI."""
        k, p = self.blocks, self.sensors
        a, b, c = np.zeros((2 * k, 2 * k)), np.zeros((2 * k, p)), np.zeros((1, 2 * k))
        for i, block in enumerate(variables[: k * (2 + 2 * p)].reshape(k, -1)):
            w, z = np.exp(block[:2])
            at = slice(2 * i, 2 * i + 2)
            a[at, at] = [[0.0, w], [-w, -2 * z * w]]
            low, high = block[2 : 2 + p] * self.units, block[2 + p :] * self.units
            b[at] = w * np.array([high, low - 2 * z * high])
            c[0, 2 * i] = 1.0
        return StateSpace(a, b, c, (variables[k * (2 + 2 * p) : -1] * self.units)[None])


def block_law(
    whole: StateSpace, blocks: int, inner_end_mass: float, worth: np.ndarray | None = None
) -> tuple[BlockLaw, np.ndarray]:
    """Form and variables of a controller with distinct stable poles; real ones are paired, the slowest with the next.

    Args:
        whole: the controller, one output and of order 2 blocks at most; what is missing does nothing yet.
        blocks: how many.
        inner_end_mass: kg.
        worth: (p,) factors on the first sensor's gain that do as much through each; needed where one does nothing yet.
    """
    a, b, c, d = whole.a, whole.b, whole.c, whole.d
    poles, vectors = np.linalg.eig(a)
    residues = (c @ vectors).ravel()[:, None] * np.linalg.solve(vectors, b.astype(complex))
    order = np.argsort(np.abs(poles))
    real = [k for k in order if abs(poles[k].imag) <= 1e-9 * abs(poles[k])]
    pairs = [(k, None) for k in order if poles[k].imag > 1e-9 * abs(poles[k])]
    if len(real) % 2:
        real.append(-1)
    pairs += list(zip(real[::2], real[1::2], strict=True))
    p = b.shape[1]
    units = np.maximum(np.abs(d).ravel(), np.abs(residues / poles[:, None]).max(axis=0))
    if worth is not None:
        units = np.maximum(units, units[0] * worth)
    law = BlockLaw(blocks, units)
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
    return law, np.concatenate([*rows, d.ravel() / units, [inner_end_mass]])


def law_responses(
    law: BlockLaw, variables: np.ndarray, s: np.ndarray, slopes: bool = True
) -> tuple[np.ndarray, Sequence[tuple[np.ndarray, np.ndarray]]]:
    """Transfer functions (p, n) and their derivatives: for each variable but the last the sensors, and by how much.

    Args:
        law: the form.
        variables: (v,).
        s: (n,) complex frequencies.
        slopes: whether to work out derivatives: for each variable the sensors it acts on and (that many, n).
    """
    k, p = law.blocks, law.sensors
    value = np.repeat((variables[k * (2 + 2 * p) : -1] * law.units)[:, None].astype(complex), len(s), axis=1)
    everyone = np.arange(p)
    found: list[tuple[np.ndarray, np.ndarray]] = []
    for block in variables[: k * (2 + 2 * p)].reshape(k, -1):
        u, damping = s / np.exp(block[0]), np.exp(block[1])
        low, high = (block[2 : 2 + p] * law.units)[:, None], (block[2 + p :] * law.units)[:, None]
        below = 1 + 2 * damping * u + u * u
        above = low + high * u
        value += above / below
        if slopes:
            found.append((everyone, -u * (high * below - above * (2 * damping + 2 * u)) / below**2))
            found.append((everyone, -above * 2 * damping * u / below**2))
            found += [(np.array([j]), (law.units[j] / below)[None]) for j in range(p)]
            found += [(np.array([j]), (law.units[j] * u / below)[None]) for j in range(p)]
    if slopes:
        found += [(np.array([j]), np.full((1, len(s)), law.units[j], dtype=complex)) for j in range(p)]
    return value, found


def observer_slacks(
    points: SensedSamples, goal: Goal, law: BlockLaw, variables: np.ndarray, slopes: bool = True
) -> Slacks:
    """What a controller leaves of every limit at every point; the effort is that of the displacement sensor's volts.

    Args:
        points: of the loops.
        goal: its limits; those that are None are kept by an infinite slack.
        law: form of the controller.
        variables: (v,).
        slopes: whether to work out derivatives.
    """
    own, of_own = law_responses(law, variables, 2j * pi * points.frequency_Hz, slopes)
    return slacks_of(points, goal, own, float(variables[-1]), of_own)


def slacks_of(
    points: SensedSamples,
    goal: Goal,
    own: np.ndarray,
    inner: float,
    of_own: Sequence[tuple[np.ndarray, np.ndarray]] = (),
) -> Slacks:
    """The same of a controller whose responses are known.

    Args:
        points: of the loops.
        goal: its limits.
        own: (p, n) the controller's transfer functions at the points.
        inner: mass inside, kg.
        of_own: their derivatives by all variables but the mass, see `law_responses`; none for no slopes.
    """
    plant = 1 + inner * points.denominator
    control = (points.control[:, 0] + inner * points.control[:, 1]) / plant
    minor = (points.minor[:, 0] + inner * points.minor[:, 1]) / plant
    moved = (points.disturbance[0] + inner * points.disturbance[1]) / plant + (own * minor).sum(axis=0)
    loop = (own * control).sum(axis=0)
    closed = np.log(np.abs(1 + loop))
    performs = points.looser == 1.0
    from_there = performs & (points.frequency_Hz >= goal.loop_gain_from_Hz)
    nothing = np.full(len(loop), np.inf)
    with np.errstate(divide="ignore"):
        found = (
            closed + log(goal.peak_sensitivity) + np.log(points.looser),
            np.where(performs, closed - np.log(np.abs(moved)) + log(goal.compliance_m_per_N), np.inf),
            nothing
            if goal.loop_gain is None
            else np.where(from_there, log(goal.loop_gain) - np.log(np.abs(loop)), np.inf),
            nothing
            if goal.controller_effort_A_per_V is None
            else np.where(performs, closed - np.log(np.abs(own[0])) + log(goal.controller_effort_A_per_V), np.inf),
        )
    steps = np.diff(np.angle(1 + loop))
    steps = (steps + pi) % (2 * pi) - pi
    same = np.diff(points.row) == 0
    settled = bool((np.abs(np.bincount(points.row[1:][same], weights=steps[same])) < pi).all())
    if not of_own:
        return Slacks(*found, (), settled)
    count = len(of_own) + 1
    of_loop, of_moved, of_first = (np.zeros((len(loop), count), dtype=complex) for _ in range(3))
    for column, (which, by) in enumerate(of_own):
        of_loop[:, column] = (by * control[which]).sum(axis=0)
        of_moved[:, column] = (by * minor[which]).sum(axis=0)
        if which[0] == 0:
            of_first[:, column] = by[0]
    shrinks = points.denominator / plant
    of_loop[:, -1] = (own * (points.control[:, 1] / plant)).sum(axis=0) - loop * shrinks
    of_moved[:, -1] = (points.disturbance[1] + (own * points.minor[:, 1]).sum(axis=0)) / plant - moved * shrinks
    of_closed = (of_loop / (1 + loop)[:, None]).real
    parts = (
        of_closed,
        of_closed - (of_moved / moved[:, None]).real,
        -(of_loop / loop[:, None]).real,
        of_closed - (of_first / own[0][:, None]).real,
    )
    return Slacks(*found, parts, settled)
