"""Where a rig stands still, with exact derivatives of that; its linearisation there, and the steps that it asks for.

What would fill the machine with steps is refused before it is begun.
"""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from math import ceil, inf, log
from operator import itemgetter
from typing import Any

import casadi as ca
import numpy as np

from beamdesign.plant.assembly import Assembly, Structure, assemble
from beamdesign.plant.effects import library
from beamdesign.records import InputError


@dataclass(frozen=True)
class StateSpace:
    """x' = a x + b u, y = c x + d u."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray

    @cached_property
    def poles(self) -> np.ndarray:
        """(n,) rad/s."""
        return np.asarray(np.linalg.eigvals(self.a))

    @property
    def stable(self) -> bool:
        """Whether all poles lie in the open left half plane."""
        return bool((self.poles.real < 0).all())

    def at(self, s: np.ndarray) -> np.ndarray:
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


@cache
def _derivatives(kinds: Structure) -> ca.Function:
    assembly = assemble(kinds)
    t, x, u, p = assembly.function.sx_in()
    rate, y = assembly.function(t, x, u, p)
    matrices = [ca.densify(ca.jacobian(value, of)) for value in (rate, y) for of in (x, u)]
    lean: Any = ca.cse([ca.densify(rate), *matrices])
    return ca.Function("derivatives", [t, x, u, p], lean)


@cache
def _stiffness(kinds: Structure) -> ca.Function:
    """The rates and their Jacobian by the states alone."""
    return _derivatives(kinds).slice("stiffness", [0, 1, 2, 3], [0, 1])


class _InPlace:
    """A function whose matrices are dense, evaluated without converting anything on the way.

    Converting takes many times as long as evaluating.

    Attributes:
        given: arguments, which may be written into.
        found: results, column by column as CasADi has them, in place of which the next ones are put.
        evaluate: works them out.
    """

    def __init__(self, function: ca.Function, *given: np.ndarray):
        self.given = [np.array(value, dtype=float, order="F") for value in given]
        self.found = [np.zeros(function.size_out(k), order="F") for k in range(function.n_out())]
        buffer: Any
        buffer, self.evaluate = function.buffer()
        for k, array in enumerate(self.given):
            buffer.set_arg(k, array.T.data)
        for k, array in enumerate(self.found):
            buffer.set_res(k, array.T.data)
        self._buffer = buffer  # CasADi does not hold on to it


def linearise(assembly: Assembly, x: np.ndarray, u: np.ndarray, parameters: np.ndarray) -> StateSpace:
    """A rig about an operating point, names as in the assembly, by algorithmic differentiation at time 0.

    Args:
        assembly: the rig.
        x: (n,) states; (n, K) for K points, whose matrices then stand side by side.
        u: (3,) inputs, or (3, K).
        parameters: in the assembly's order, (P,) or (P, K).
    """
    function, still = _derivatives(assembly.kinds), np.zeros(1)
    if x.ndim > 1:
        function, still = function.map(x.shape[1]), np.zeros((1, x.shape[1]))
    return StateSpace(*_evaluated(function, still, x, u, parameters)[1:])


def _evaluated(function: ca.Function, *given: np.ndarray) -> list[np.ndarray]:
    """All outputs of a function whose matrices are dense, see `_InPlace`, row by row."""
    there = _InPlace(function, *given)
    there.evaluate()
    return [np.ascontiguousarray(array) for array in there.found]


def equilibrium(assembly: Assembly, u: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """States (n,) at which nothing moves under constant inputs.

    Backward Euler steps of growing length, so that play ends where a slow load would have left it. Friction that has no
    direction yet (the `memory` of effects) is held at zero. Where the steps go astray, as between the two ends of a law
    that saturates or away from a rest that is not stable, the inputs come on in shares.

    Raises:
        ValueError: where none is found.
    """
    figure = dict(zip(assembly.parameters, parameters, strict=True))
    middle = supply_Pa(figure) / 2
    x = np.array([middle if name in ("pressure_a_Pa", "pressure_b_Pa") else 0.0 for name in assembly.states])
    done, share = 0.0, 1.0
    while done < 1.0:
        part = min(1.0, done + share)
        try:
            x, done, share = _settled(assembly, x, part * u, parameters), part, 2 * share
        except ValueError:
            share /= 4
            if share < _LEAST_SHARE:
                raise
    return x


def _settled(assembly: Assembly, x: np.ndarray, u: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """Where the states go from x under constant inputs.

    Raises:
        ValueError: where they do not settle.
    """
    here = _InPlace(_stiffness(assembly.kinds), np.zeros(1), x, u, parameters)
    rate, jacobian = here.found[0][:, 0], here.found[1]
    weight = scales(assembly.states)
    free = not_held(assembly)
    among, ratio = np.ix_(free, free), weight[None, :] / weight[:, None]
    eye, step = np.eye(len(x)), 1e-3
    for _ in range(_MOST_STEPS):
        here.given[1][:] = x
        here.evaluate()
        change = np.zeros(len(x))
        change[free] = np.linalg.solve((eye / step - jacobian * ratio)[among], rate[free] / weight[free])
        x = x + weight * change
        if not rate[free].any() or (step > _LONG and np.abs(change).max() <= 1e-10):
            return x
        # A long step that hardly moves anything is Newton's; a large change means a law has been left behind.
        step = min(2 * step, 1e9) if np.abs(change).max() < 100.0 else max(step / 2, 1e-5)
    raise ValueError("the rig has no equilibrium under these inputs")


_LONG, _MOST_STEPS, _LEAST_SHARE = 1e3, 400, 1e-3  # s; steps; of the inputs


def not_held(assembly: Assembly) -> np.ndarray:
    """Places of the states that an equilibrium moves: all but the `memory` of effects."""
    held = {f"{name}.{state}" for name in assembly.kinds.effects for state in library()[name].memory}
    return np.array([k for k, name in enumerate(assembly.states) if name not in held])


def scales(names: Sequence[str]) -> np.ndarray:
    """Typical magnitudes of states and signals, by what their names end in."""
    return np.array([next((size for end, size in _SIZES.items() if name.endswith(end)), 1.0) for name in names])


_SIZES = {
    "_Pa": 1e6, "_m3_per_s": 1e-5, "_m3_per_s2": 1e-2, "_m": 1e-4, "_m_per_s": 1e-2, "_rad": 1e-3, "_rad_per_s": 0.1,
}  # fmt: skip


LONGEST_STEP_S = 1e-4
MOST_STEPS = 20_000_000
"""Of one record: half a minute, and about a gigabyte of inputs."""
_NUDGE = 1 + 1e-6  # on each figure, to find those that the fastest pole comes from

Place = tuple[np.ndarray, np.ndarray]
"""States and inputs about which a rig is linearised."""


def substeps_at(
    assembly: Assembly, places: Iterable[Place], parameters: np.ndarray, times: np.ndarray, steps_per_radian: float
) -> int:
    """Steps per sample: at most 0.1 ms each, and so many per radian of the fastest pole at any of the places.

    Args:
        assembly: the rig.
        places: where its poles are looked at.
        parameters: in the assembly's order.
        times: (N,) s, at least two, equally spaced but for their jitter.
        steps_per_radian: of the fastest pole.

    Raises:
        InputError: where the record would take more than `MOST_STEPS`, naming the figures that make it so stiff.
    """
    rates = [(1.0, None), *((_fastest_pole(assembly, place, parameters), place) for place in places)]
    fastest, stiffest = max(rates, key=itemgetter(0))
    sample_s = (times[-1] - times[0]) / (len(times) - 1)
    needed = sample_s / min(LONGEST_STEP_S, 1 / (steps_per_radian * fastest)) - 1e-9
    if stiffest is not None:
        reason = _why(assembly, stiffest, parameters) if needed * len(times) > MOST_STEPS else ""
        refuse_too_many(needed * len(times), "(figures)", reason)
    return max(1, ceil(needed))


def refuse_too_many(steps: float, key: str, reason: str) -> None:
    """Refuse a record of too many steps.

    Raises:
        InputError: naming the key and the reason why so many are needed.
    """
    if not steps <= MOST_STEPS:
        words = f"{reason}, so that a record takes {steps:.3g} integration steps; {MOST_STEPS:.3g} are the most"
        raise InputError("simulation", [(key, words)])


def _fastest_pole(assembly: Assembly, place: Place, parameters: np.ndarray) -> float:
    """Modulus of the fastest pole, rad/s; infinite where the equations leave the numbers."""
    found = linearise(assembly, *place, parameters)
    return float(np.abs(found.poles).max()) if np.isfinite(found.a).all() else np.inf


def _why(assembly: Assembly, place: Place, parameters: np.ndarray) -> str:
    """The three figures that move the fastest pole most."""
    fastest, moved = _fastest_pole(assembly, place, parameters), []
    for k, (name, value) in enumerate(zip(assembly.parameters, parameters, strict=True)):
        nudged = parameters.copy()
        nudged[k] *= _NUDGE
        moved.append((abs(log(_fastest_pole(assembly, place, nudged) / fastest)), f"{name} {value:g}"))
    words = ", ".join(words for _, words in sorted(moved, reverse=True)[:3])
    return f"the fastest motion is of {fastest / (2 * np.pi):.3g} Hz, above all by {words} in SI"


def equilibrium_sensitivity(
    assembly: Assembly, x: np.ndarray, u: np.ndarray, parameters: np.ndarray, free: Sequence[str]
) -> np.ndarray:
    """Derivatives (n, P) of an equilibrium by the implicit function theorem.

    States that `equilibrium` holds (the `memory` of effects) do not move. Where the remaining equations do not
    determine the equilibrium (as within play), it is the smallest change, in typical magnitudes, that satisfies them.

    Args:
        assembly: the rig.
        x: (n,) states that `equilibrium` found.
        u: (3,) inputs.
        parameters: in the assembly's order.
        free: names of the P parameters to differentiate by.

    Raises:
        ValueError: at an unknown parameter.
    """
    names = tuple(free)
    of_states, of_parameters = _evaluated(_rest(assembly.kinds, names), np.zeros(1), x, u, parameters)
    moving = not_held(assembly)
    weight = scales(assembly.states)[moving]
    scaled = of_states[np.ix_(moving, moving)] / weight[:, None] * weight[None, :]
    change = np.zeros((len(x), len(names)))
    right = -of_parameters[moving] / weight[:, None]
    determined = np.linalg.cond(scaled) < 1e14
    found = np.linalg.solve(scaled, right) if determined else np.linalg.lstsq(scaled, right, rcond=1e-13)[0]
    change[moving] = weight[:, None] * found
    return change


@cache
def _rest(kinds: Structure, free: tuple[str, ...]) -> ca.Function:
    assembly = assemble(kinds)
    t, x, u, p = assembly.function.sx_in()
    rate, _ = assembly.function(t, x, u, p)
    matrices = [ca.densify(ca.jacobian(rate, x)), ca.densify(ca.jacobian(rate, p)[:, places_of(assembly, free)])]
    return ca.Function("rest", [t, x, u, p], matrices)


def places_of(assembly: Assembly, free: tuple[str, ...]) -> list[int]:
    """Where among the parameters of an assembly the free ones are."""
    unknown = [name for name in free if name not in assembly.parameters]
    if unknown:
        raise ValueError(f"no parameter {', '.join(unknown)} in this structure")
    return [assembly.parameters.index(name) for name in free]


_STEPS_PER_RADIAN = 1.0
_TEST_LOAD_N = 1000.0


def substeps_for(assembly: Assembly, parameters: np.ndarray, times: np.ndarray) -> int:
    """Integration steps per sample of a record: one per radian of the fastest pole at rest and under load.

    The load is one that the actuator holds: of a cylinder no more than half its stall load, near which orifices pass
    what a stiffer rig would be needed for.

    Raises:
        InputError: where the record would take more than `MOST_STEPS`.
    """
    places = _at_rest_and_loaded(assembly.kinds, tuple(parameters))
    return substeps_at(assembly, places, parameters, times, _STEPS_PER_RADIAN)


@lru_cache(64)  # the same rig is moved by many forces
def _at_rest_and_loaded(kinds: Structure, values: tuple[float, ...]) -> tuple[Place, ...]:
    """Where a rig of some parameters stands without a load and under one that the actuator holds, either way."""
    assembly, parameters, places = assemble(kinds), np.array(values), []
    figure = dict(zip(assembly.parameters, values, strict=True))
    smaller = figure.get("piston_area", inf) * (1 - abs(figure.get("unequal_piston_areas.asymmetry", 0.0)))
    held = min(_TEST_LOAD_N, smaller * supply_Pa(figure) / 2)
    for load in (0.0, held, -held):
        u = np.array([load, 0.0, 0.0])
        with suppress(ValueError):
            places.append((equilibrium(assembly, u, parameters), u))
    return tuple(places)


def supply_Pa(figure: Mapping[str, float]) -> float:
    """Supply pressure of a rig, Pa: that of its orifices where these have one of their own."""
    return figure.get("pressure_dependent_flow.supply_pressure_Pa", figure["supply_pressure"])
