"""The closed loop as a family of exact matrices over the outer end mass, x' = A(m) x: of one law, or of each stage.

The stages of a law act on states that all of them share and none resets. Those that they hand over are the current
itself and, where there are second-order sections, their outputs and the rates of those: a law works on the past of its
signals, whichever law made it. So nothing jumps at a change of stage, the current least of all. With e the error volts,
u_0 = e, the sections in series before the lag,

    u_k'' = p^2 (u_(k-1) + 2 d u_(k-1)' / z + u_(k-1)'' / z^2 - u_k) - 2 c p u_k',
    i'    = w_p (K u_n - i) + K (w_p / w_z) u_n'.

Sampled, that is the difference equation i_k = b0 e_k + b1 e_(k-1) - a1 i_(k-1), whose memory is e and i.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import pi

import numpy as np
from flint import arb_mat, ctx, fmpq, fmpq_mat, fmpq_poly

from beamdesign.controllers import Cascade, SensedLaw
from beamdesign.plant.linear import SEEN_AS, LinearModel
from beamdesign.plant.members import paper_model
from beamdesign.polynomial import Affine, exact, nearest
from beamdesign.proofs.stability import stable_ranges
from beamdesign.prototype import Prototype
from beamdesign.records import InputError


@dataclass(frozen=True)
class MassFamily:
    """A(m) = fixed + inertial / (bare_mass + m), exact.

    The family is affine in mu = 1 / (bare_mass + m), which runs monotonically with m: a condition that is convex in A
    and free of m otherwise holds on a range of m where it holds at its two ends.

    Attributes:
        fixed: (n, n), free of m.
        inertial: (n, n), what the total mass divides: the forces on the outer tip, in the row of its velocity.
        bare_mass: M_m, kg.
        velocity: index of the state that is the velocity of the mass, which jumps where payload of another velocity
            is taken on.
        states: names of the states.
    """

    fixed: fmpq_mat
    inertial: fmpq_mat
    bare_mass: fmpq
    velocity: int
    states: tuple[str, ...]

    @property
    def order(self) -> int:
        """Number n of states."""
        return self.fixed.nrows()

    @property
    def pick(self) -> fmpq_mat:
        """E e', (n, n), which picks out the velocity."""
        found = fmpq_mat(self.order, self.order)
        found[self.velocity, self.velocity] = fmpq(1)
        return found

    def at(self, outer_end_mass: fmpq) -> fmpq_mat:
        """A(m), (n, n)."""
        return self.fixed + self.inertial * (1 / (self.bare_mass + outer_end_mass))

    def characteristic(self) -> Affine:
        """(bare_mass + m) det(sI - A(m)), affine in m since m enters one row of A.

        Raises:
            ValueError: where it is not affine in m.
        """

        def value(mass: int) -> fmpq_poly:
            return self.at(fmpq(mass)).charpoly() * (self.bare_mass + mass)

        constant = value(0)
        slope = value(1) - constant
        if value(2) != constant + 2 * slope:
            raise ValueError("the characteristic polynomial of this family is not affine in the mass")
        return Affine(constant, slope)


Families = Sequence[MassFamily]
"""The closed loop with each of its stages, in the same states; one law that stays is the case of one stage."""


def close_with(rig: LinearModel, inner_end_mass: fmpq, law: SensedLaw) -> MassFamily:
    """Close the loop of a rig with a controller of any order and any number of sensors.

    The controller is realised in observer form, which has as many states as its denominator has roots: with a(s) of
    leading coefficient one, b_j the numerator's remainder for sensor j, d_j its quotient and e_j the error,

        z_i' = z_(i-1) - a_i z_(k-1) + sum_j b_ji e_j,    current = z_(k-1) + sum_j d_j e_j.

    These states follow the rig's.

    Raises:
        ValueError: where the controller's numerator is of higher degree than its denominator.
    """
    a, b, c, velocity, bare_mass = rig.over_outer_mass(inner_end_mass)
    n, k = a.nrows(), law.denominator.degree()
    if any(numerator.degree() > k for numerator in law.numerators):
        raise ValueError("the controller differentiates: its numerator is of higher degree than its denominator")
    lead = law.denominator[k]
    through = [numerator[k] / lead for numerator in law.numerators]
    rests = [(one - law.denominator * share) / lead for one, share in zip(law.numerators, through, strict=True)]
    errors = fmpq_mat([[-c[SEEN_AS[sensor], j] for j in range(n)] for sensor in law.sensors])
    straight, *fed = (fmpq_mat([through, *([rest[i] for rest in rests] for i in range(k))]) * errors).tolist()
    last = _unit(k, k - 1)
    rows = [[a[i, j] + b[i, 1] * straight[j] for j in range(n)] + [b[i, 1] * one for one in last] for i in range(n)]
    for i in range(k):
        own = [one - law.denominator[i] / lead * end for one, end in zip(_unit(k, i - 1), last, strict=True)]
        rows.append(fed[i] + own)
    return _family(fmpq_mat(rows), velocity, bare_mass, (*rig.states, *(f"controller_{i + 1}" for i in range(k))))


def _family(matrix: fmpq_mat, velocity: int, bare_mass: fmpq, states: tuple[str, ...]) -> MassFamily:
    """Of a matrix in which the forces on the outer tip stand undivided, in the row of its velocity."""
    inertial = fmpq_mat(matrix.nrows(), matrix.nrows())
    for j in range(matrix.nrows()):
        inertial[velocity, j], matrix[velocity, j] = matrix[velocity, j], fmpq(0)
    return MassFamily(matrix, inertial, bare_mass, velocity, states)


def stage_families(prototype: Prototype) -> Families:
    """The matrices A(m), equations (7) to (16), with every law of a controller; those of several in the same states.

    Raises:
        InputError: where the prototype carries effects, or where one of several laws has sections and no filter before
            them: they would feel accelerations, which the mass sets.
        ValueError: without a controller.
    """
    schedule, inner = prototype.schedule, exact(prototype.payload.inner_end_mass_kg)
    if schedule is None:
        law = prototype.own_controller.sensed_law()
        return (close_with(paper_model(prototype), inner, law),)
    plant = paper_model(prototype)
    try:
        return tuple(stage_family(plant, inner, stage.law) for stage in schedule.stage)
    except ValueError as error:
        raise InputError(prototype.name, [("sensor.filter_Hz", str(error))]) from error


def stage_family(rig: LinearModel, inner_end_mass: fmpq, law: Cascade) -> MassFamily:
    """The matrices A(m) of one law; states of the rig, outputs and rates of its sections, then its current.

    Raises:
        ValueError: for sections without a filter before them.
    """
    free, driven, sensed, velocity, bare_mass = rig.over_outer_mass(inner_end_mass)
    n, lag, sections = free.nrows(), law.lag, law.sections
    assert lag is not None
    order = n + 2 * len(sections) + 1
    none = [fmpq(0)] * (order - n)
    rows = [fmpq_mat([[*row, *none[1:], driven[i, 1]]]) for i, row in enumerate(free.tolist())]
    rows += [fmpq_mat(1, order)] * (order - n)
    state = [fmpq_mat([_unit(order, place)]) for place in range(order)]
    signal = fmpq_mat([[-sensed[1, j] for j in range(n)] + none])
    slope = _derivative(signal, rows, velocity)
    curvature = _derivative(slope, rows, velocity) if sections else slope  # which only sections look at
    for k, section in enumerate(sections):
        zero, pole = exact(2 * pi * section.zero_Hz), exact(2 * pi * section.pole_Hz)
        zeta, own = exact(section.zero_damping_ratio), exact(section.pole_damping_ratio)
        out, moving = state[n + 2 * k : n + 2 * k + 2]
        wanted = signal + slope * (2 * zeta / zero) + curvature * (1 / zero**2)
        bent = (wanted - out) * pole**2 - moving * (2 * own * pole)
        rows[n + 2 * k], rows[n + 2 * k + 1] = moving, bent
        signal, slope, curvature = out, moving, bent
    gain, upper, lower = exact(law.gain_A_per_V), exact(2 * pi * lag.zero_Hz), exact(2 * pi * lag.pole_Hz)
    rows[-1] = (signal * gain - state[-1]) * lower + slope * (gain * lower / upper)
    more = [f"section_{k + 1}_{name}" for k in range(len(sections)) for name in ("V", "V_per_s")]
    return _family(_stacked(rows), velocity, bare_mass, (*rig.states, *more, "current_A"))


def _derivative(signal: fmpq_mat, rows: Sequence[fmpq_mat], velocity: int) -> fmpq_mat:
    """The rate of a linear function of the states."""
    if signal[0, velocity] != 0:
        raise ValueError(
            "second-order sections need a filter before them (sensor.filter_Hz): without one they feel the"
            " acceleration of the tip, which jumps with the mass"
        )
    return signal * _stacked(rows)


def _stacked(rows: Sequence[fmpq_mat]) -> fmpq_mat:
    return fmpq_mat([row.entries() for row in rows])


def _unit(order: int, place: int) -> list[fmpq]:
    return [fmpq(int(j == place)) for j in range(order)]


def floats(matrix: fmpq_mat) -> np.ndarray:
    """The nearest floats of a rational matrix."""
    return np.array([*map(nearest, matrix.entries())]).reshape(matrix.nrows(), matrix.ncols())


def rationals(matrix: np.ndarray) -> fmpq_mat:
    """The symmetric part of a float matrix, rounded to floats and taken as their shortest decimals, exactly."""
    symmetric = (matrix + matrix.T) / 2
    return fmpq_mat([[*map(exact, row)] for row in symmetric])


def at(family: MassFamily, mass: fmpq) -> np.ndarray:
    """A(m) in floats."""
    return floats(family.at(mass))


def modal_coordinates(a: np.ndarray) -> np.ndarray:
    """(n, n) map T from the state to modal coordinates, in which a stable A has the identity as a Lyapunov function.

    T A T^-1 has a block of 1 or 2 for each pole: entries are of the order of the poles, whatever the units of the
    state. Where the modes are too nearly parallel, a Lyapunov function in balanced units takes their place, or for an
    unstable A those units alone.
    """
    from scipy.linalg import cdf2rdf, matrix_balance, solve_continuous_lyapunov

    balanced, scales = matrix_balance(a, permute=False, separate=True)
    scale = np.diag(1 / scales[0])
    poles, vectors = np.linalg.eig(balanced)
    _, modes = cdf2rdf(poles, vectors)
    if np.linalg.cond(modes) < 1e8:
        return np.linalg.inv(modes) @ scale
    if poles.real.max() >= 0:
        return scale
    function = solve_continuous_lyapunov(balanced.T, -np.eye(len(a)) * np.abs(poles).max())
    return np.linalg.cholesky((function + function.T) / 2).T @ scale


# What is not stable: a mass that stays, and two masses or stages in turn under which the motion grows.


@dataclass(frozen=True)
class Frozen:
    """Whether every mass that stays is stable with every stage that stays, exactly.

    Attributes:
        stable: for the whole range.
        reason: what is wrong, in words; empty where it is stable.
        unstable_at: a mass at which an exact Routh test fails, kg; None where there is none (or only single masses,
            at which a root lies on the axis).
        stage: with which it fails, numbered from 0.
    """

    stable: bool
    reason: str
    unstable_at: fmpq | None
    stage: int = 0


def frozen(families: Families, low: fmpq, high: fmpq) -> Frozen:
    """Decide the stability of all masses and stages that stay.

    Raises:
        ValueError: for a family whose characteristic polynomial is not affine in the mass.
    """
    for k, family in enumerate(families):
        found = stable_ranges(family.characteristic(), low, high)
        if found.reason:
            unstable = next((part.sample for part in found.ranges if not part.stable), None)
            stage = f"stage {k + 1}: " if len(families) > 1 else ""
            return Frozen(False, stage + found.reason, unstable, k)
    return Frozen(True, "", None)


PRECISION_BITS = 384
DOUBLINGS = 13
"""Of the number of cycles, until a proof of growth is given up; a factor of 1.001 per cycle needs about 11."""
Corner = tuple[int, fmpq]
"""A stage, numbered from 0, and an outer end mass, kg."""


@dataclass(frozen=True)
class Cycle:
    """Sudden changes between two stages, or between two masses, matched, under which the loop's motion grows.

    Attributes:
        stages: the stage at each, numbered from 0.
        outer_end_mass_kg: the mass at each.
        time_s: time spent at each.
        factor: growth per cycle, the spectral radius over one cycle, in floats.
        cycles: repetitions after which growth is proved; 0 where it was only computed in floats.
    """

    stages: tuple[int, int]
    outer_end_mass_kg: tuple[float, float]
    time_s: tuple[float, float]
    factor: float
    cycles: int

    @property
    def proved(self) -> bool:
        """Whether ball arithmetic confirms the growth."""
        return self.cycles > 0


def proved_growth(first: fmpq_mat, second: fmpq_mat, time_first: fmpq, time_second: fmpq) -> int:
    """The number of cycles after which growth is proved, or 0.

    With M = exp(A2 t2) exp(A1 t1), enclosed by balls, |trace M^k| > n for one k proves that the spectral radius of M
    exceeds one, since |trace M^k| is at most n times its k-th power.
    """
    order = first.nrows()
    with ctx.workprec(PRECISION_BITS):
        power = arb_mat(second * time_second).exp() * arb_mat(first * time_first).exp()
        before = power
        for doubling in range(DOUBLINGS + 1):
            # Between powers of two lies a second chance for a complex pair, whose trace may be small at one of them.
            for k, candidate in ((2**doubling, power), (3 * 2**doubling // 2, power * before if doubling else power)):
                if abs(candidate.trace()) > order:
                    return k
            before, power = power, power * power
    return 0


def growing_cycle(families: Families, turns: Iterable[tuple[Corner, Corner]]) -> Cycle | None:
    """The cycle under which the motion grows fastest; finding none proves nothing.

    Args:
        families: the closed loop with each stage.
        turns: pairs of corners to go between.
    """
    best: Cycle | None = None
    for (i, first), (j, second) in turns:
        found = growing_times(at(families[i], first), at(families[j], second))
        if found is None or (best is not None and found[2] <= best.factor):
            continue
        *times, factor = found
        cycles = proved_growth(families[i].at(first), families[j].at(second), *map(exact, times))
        best = Cycle((i, j), (nearest(first), nearest(second)), (times[0], times[1]), factor, cycles)
    return best


def growing_times(first: np.ndarray, second: np.ndarray) -> tuple[float, float, float] | None:
    """Times (s) at two matrices in turn under which the motion grows, and the growth per cycle, in floats.

    Times are tried on a logarithmic grid from a fraction of the fastest pole's period to the slowest's, and the best
    pair is refined; so finding none proves nothing.
    """
    from scipy.linalg import expm
    from scipy.optimize import minimize

    t = modal_coordinates(first)
    inverse = np.linalg.inv(t)
    ends = [t @ a @ inverse for a in (first, second)]
    speeds = np.abs(np.concatenate([np.linalg.eigvals(a) for a in ends]))
    times = np.geomspace(0.2 / speeds.max(), 2 * np.pi / max(speeds.min(), speeds.max() * 1e-4), 48)
    steps = [expm(np.multiply.outer(times, a)) for a in ends]
    products = steps[1][:, None] @ steps[0][None, :]  # [time at high, time at low]
    radii = np.abs(np.linalg.eigvals(products)).max(axis=-1)
    # Growth per second, not per cycle, would favour the shortest times, whose factor is too near one to prove.
    j, i = np.unravel_index(int(radii.argmax()), radii.shape)

    def decline(logs: np.ndarray) -> float:
        at_low, at_high = np.clip(np.exp(logs), times[0], times[-1])
        return -float(np.abs(np.linalg.eigvals(expm(ends[1] * at_high) @ expm(ends[0] * at_low))).max())

    best = minimize(decline, np.log([times[i], times[j]]), method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-4})
    if best.fun >= -1.0:
        return None
    at_low, at_high = (float(f"{value:.6g}") for value in np.clip(np.exp(best.x), times[0], times[-1]))
    return at_low, at_high, -float(best.fun)
