"""A measured record, or the sines of a response, simulated with any figures and effects, and what noise does there."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache, cached_property, lru_cache
from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from beamdesign.diagnosis.data.dataset import FrequencyResponse, TimeRecord
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, Placement, cause
from beamdesign.plant.assembly import Assembly, Structure, assemble, parameters_of, widened
from beamdesign.plant.compiled import integrate, integrate_with_sensitivities, measured_half_steps
from beamdesign.plant.equilibrium import StateSpace, equilibrium, equilibrium_sensitivity, linearise
from beamdesign.prototype import Prototype

if TYPE_CHECKING:
    from beamdesign.diagnosis.fitting.linear_evidence import LinearModel

FURTHEST_M = 0.5
"""Displacement of the outer tip at which a loop has diverged."""
_RADIANS = 1.2  # of the fastest pole, per integration step: Runge-Kutta of fourth order is stable to 2.7
_LONGEST_S = 0.25e-3

Begun = tuple[np.ndarray, np.ndarray]
"""How a motion begins beyond rest: states (n,), and their derivatives (n, P) by the parameters that unknowns move."""


@dataclass(frozen=True)
class Replay:
    """One record, ready to be simulated with any figures and any effects.

    Attributes:
        record: measured.
        prototype: that was believed.
    """

    record: TimeRecord
    prototype: Prototype
    _inputs: dict[int, np.ndarray] = field(default_factory=dict, repr=False, compare=False)
    _nominal: dict[tuple[str, ...], np.ndarray] = field(default_factory=dict, repr=False, compare=False)
    _substeps: dict[object, int] = field(default_factory=dict, repr=False, compare=False)

    def placed(self, placement: Placement) -> Placement:
        """The unknowns of a hypothesis in the equations with the law of this record."""
        return placement.under(self.record.controller.equations)

    def parameters(self, placement: Placement, z: np.ndarray) -> np.ndarray:
        """(P,) parameters with the unknowns at z, in the order of the assembly of `placed`."""
        effects = placement.assembly.kinds.effects
        if effects not in self._nominal:
            tables = {name: self.prototype.effects.get(name, {}) for name in effects}
            rig = self.prototype.but(controller=self.record.controller, effects=tables)
            self._nominal[effects] = np.array(list(parameters_of(rig, *self.record.masses).values()))
        return self.placed(placement).parameters(self._nominal[effects], z)

    def simulated(self, placement: Placement, z: np.ndarray, channels: tuple[str, ...]) -> np.ndarray | None:
        """(N, C) channels of the record with the unknowns at z; None where the simulated loop diverges."""
        found = self.simulated_with_slopes(placement, z, channels, sloped=False)
        return None if found is None else found[0]

    def noise_power(self, channels: tuple[str, ...], frequencies_Hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Power that channels read of noise at the displacement's sensor, which the loop feeds back, and of force.

        By the linear loop of the believed rig at rest; without a loop where it has no equilibrium.

        Returns:
            (F, C) each: of a sine of 1 m at the sensor, no more than `_LOUDEST` squared, as a believed loop may be next
            to unstable; and of 1 N that is recorded beside the force, of which the believed loop, but not the rig, is
            driven.
        """
        placed, parameters = self._believed()
        read = np.array([[complex(name == DISPLACEMENT) for name in channels]] * len(frequencies_Hz))
        try:
            loop = linearise(placed.assembly, at_rest(placed, parameters), np.zeros(3), parameters)
        except ValueError:
            return np.abs(read) ** 2, np.zeros(read.shape)
        rows = [placed.assembly.outputs.index(name) for name in channels]
        driven = StateSpace(loop.a, loop.b[:, :2], loop.c[rows], loop.d[rows, :2])
        parts = np.array_split(2j * np.pi * frequencies_Hz, len(frequencies_Hz) // _AT_ONCE + 1)
        forced, commanded = np.moveaxis(np.concatenate([driven.at(part) for part in parts]), 2, 0)
        # noise at the sensor is a command with the other sign
        found = read - self.prototype.sensor.gain_V_per_m * commanded
        loud = np.minimum(1.0, _LOUDEST / np.abs(found[:, channels.index(DISPLACEMENT)]))
        return np.abs(found * loud[:, None]) ** 2, np.abs(forced) ** 2

    def grows(self, placement: Placement, z: np.ndarray) -> bool:
        """Whether a motion about rest grows e-fold within the record, by the linear loop; also where nothing rests."""
        parameters, placed = self.parameters(placement, z), self.placed(placement)
        try:
            loop = linearise(placed.assembly, at_rest(placed, parameters), np.zeros(3), parameters)
        except ValueError:
            return True
        return float(loop.poles.real.max()) * float(self.record.since_start[-1]) > 1

    def simulated_with_slopes(
        self,
        placement: Placement,
        z: np.ndarray,
        channels: tuple[str, ...],
        sloped: bool = True,
        begun: Begun | None = None,
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Channels (N, C) and their derivatives by z (N, C, K); None where the simulated loop diverges or is too stiff.

        Without slopes there are no derivatives, and it takes a fraction of the time. It starts at rest, or as begun.
        """
        # Steps are counted anew only for another structure, or where the unknowns have gone a long way.
        key = (placement.assembly.kinds, placement.unknowns, tuple(np.round(z).astype(int)))
        parameters, placement = self.parameters(placement, z), self.placed(placement)
        assembly, times = placement.assembly, self.record.since_start
        columns = [assembly.outputs.index(name) for name in channels]
        try:
            rest = at_rest(placement, parameters)
        except ValueError:
            return None
        if key not in self._substeps:
            self._substeps[key] = self._enough(placement, parameters, rest)
        if not (substeps := self._substeps[key]):
            return None
        inputs = self._driven(substeps)
        start = rest if begun is None else rest + begun[0]
        if not sloped:
            y, _ = integrate(assembly.kinds, times, inputs, start, parameters, substeps, FURTHEST_M)
            return (y[:, columns], np.zeros(0)) if len(y) == len(times) else None
        names = tuple(assembly.parameters[k] for k in placement.moved)
        moved = _rest_moved(assembly.kinds, parameters.tobytes(), rest.tobytes(), names)
        moved = moved if begun is None else moved + begun[1]
        y, dy = integrate_with_sensitivities(
            assembly.kinds, times, inputs, start, moved, parameters, names, substeps, FURTHEST_M, columns
        )
        if len(y) < len(times) or not np.all(np.isfinite(dy)):
            return None
        slopes = placement.slopes(parameters)[list(placement.moved)]
        return y[:, columns], (dy.reshape(-1, len(names)) @ slopes).reshape(*dy.shape[:2], -1)

    def _believed(self) -> tuple[Placement, np.ndarray]:
        """What was believed: its unknowns in the equations with the law of this record, and its parameters."""
        placement = NOTHING.placement(self.prototype)
        return self.placed(placement), self.parameters(placement, np.zeros(len(placement.unknowns)))

    def _believed_steps(self) -> int:
        """Integration steps per sample of what was believed."""
        if (found := self._substeps.get(NOTHING)) is None:
            placed, figures = self._believed()
            at = self.record.step, placed.assembly.kinds, figures.tobytes(), at_rest(placed, figures).tobytes()
            found = self._substeps[NOTHING] = _steps(*at)
        return found

    def _driven(self, substeps: int) -> np.ndarray:
        """(2 substeps (N - 1) + 1, m) the record's inputs at every half step."""
        if substeps not in self._inputs:
            if substeps * len(self.record.times) > _LARGE:  # one at a time: a stiff law may want thousands of steps
                self._inputs.clear()
            self._inputs[substeps] = measured_half_steps(self.record.inputs, self.record.step, substeps)
        return self._inputs[substeps]

    def _enough(self, placement: Placement, parameters: np.ndarray, rest: np.ndarray) -> int:
        """Integration steps per sample, as at rest; of a law that is steep elsewhere, until more change little.

        0 for a model `_STIFFER` than the believed one, where a figure goes on and on that records do not resist.
        """
        count = _steps(self.record.step, placement.assembly.kinds, parameters.tobytes(), rest.tobytes())
        if count > _STIFFER * self._believed_steps():
            return 0
        assembly, times = placement.assembly, self.record.since_start
        effects = assembly.kinds.effects
        if not set(effects) & _STEEP or law_of_play(effects):
            return count
        before = np.zeros(0)
        for steps in (count * 2**k for k in range(_DOUBLINGS + 1)):
            y, _ = integrate(assembly.kinds, times, self._driven(steps), rest, parameters, steps, FURTHEST_M)
            moved = y[:, assembly.outputs.index(DISPLACEMENT)]
            if 0 < len(before) == len(moved) and np.linalg.norm(moved - before) <= _ALIKE * np.linalg.norm(moved):
                return steps // 2
            before = moved if len(moved) == len(times) else np.zeros(0)
        return steps if len(before) else count


_STIFFER = 32  # times as many steps: poles of kilohertz where those of a rig are of tens of hertz
_LARGE = 1 << 17  # steps of a record, 4 MB of inputs
_STEEP = {"pressure_dependent_flow"}
"""Effects whose flow changes ever faster with the pressure where that nears the supply's or the tank's."""
_DOUBLINGS, _ALIKE = 3, 1e-3


def at_rest(placement: Placement, parameters: np.ndarray) -> np.ndarray:
    """Equilibrium without load, which masses have no part in: found once for all records of one law.

    Raises:
        ValueError: where there is none.
    """
    names, bare = placement.assembly.parameters, parameters.copy()
    bare[[names.index("outer_end_mass"), names.index("inner_end_mass")]] = 0.0
    return _at_rest(placement.assembly.kinds, bare.tobytes())


@lru_cache(64)
def _at_rest(kinds: Structure, parameters: bytes) -> np.ndarray:
    return equilibrium(assemble(kinds), np.zeros(3), np.frombuffer(parameters))


@lru_cache(64)
def _rest_moved(kinds: Structure, parameters: bytes, rest: bytes, names: tuple[str, ...]) -> np.ndarray:
    """How the equilibrium moves by parameters: once for all records of one law and one payload."""
    at = np.frombuffer(rest)
    return equilibrium_sensitivity(assemble(kinds), at, np.zeros(3), np.frombuffer(parameters), names)


@lru_cache(64)
def _steps(sample_s: float, kinds: Structure, figures: bytes, at: bytes) -> int:
    """Integration steps per sample: enough for the fastest pole at rest, and with a joint that has play bearing.

    What happens within the short while that a joint bears need be stable, not exact; more so where a record is followed
    than from rest, where it cannot be repeated anyway.
    """
    assembly, parameters, rest = assemble(kinds), np.frombuffer(figures), np.frombuffer(at)
    points = [(rest, 1.0)]
    if law_of_play(kinds.effects):
        touching = bearing(assembly, rest, parameters)
        points.append((touching, _BRIEFLY if kinds.own_share == 1.0 else _FOLLOWING))
    try:
        loops = ((linearise(assembly, x, np.zeros(3), parameters), share) for x, share in points)
        fastest = max(float(np.abs(loop.poles).max()) * share for loop, share in loops)
    except np.linalg.LinAlgError:
        fastest = 1e4
    return max(1, ceil(sample_s / min(_LONGEST_S, _RADIANS / fastest) - 1e-9))


PLAY = "joint_backlash"


def law_of_play(effects: Iterable[str]) -> str:
    """Of effects, the law by which a joint or a nut has play; empty where none is."""
    return next((name for name in effects if cause(name) == PLAY), "")


def bearing(assembly: Assembly, x: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """A point at rest, with a joint or a nut that has play just pressed to one side of it."""
    law, moved, place = law_of_play(assembly.kinds.effects), x.copy(), assembly.states.index
    pressed = parameters[assembly.parameters.index(f"{law}.play_m")] / 2 + _BEARING_M
    if law == PLAY:
        moved[place(f"{law}.rod_m")] = x[place("inner_m")] + pressed
    else:
        moved[place("travel_m")] = x[place("outer_m")] - x[place("inner_m")] + pressed
    return moved


_BEARING_M, _BRIEFLY, _FOLLOWING = 2e-6, 0.45, 0.75  # shares: how much the poles of a joint that bears count


DISPLACEMENT = "displacement_m"
_LOUDEST = 10.0
_AT_ONCE = 4096  # frequencies: a long record has a million, each with a matrix of its own


_SWEPT_HZ = 1.0, 400.0  # of the published rig
_SETTLES_S, _SETTLES_PERIODS, _LISTENS_S = 0.5, 4, 0.05
_STEP = 1e-4  # in prior standard deviations, of central differences
_SAMPLE_S, _LEAST_SAMPLES = 0.5e-3, 16  # of a period


@cache
def depends_on_size(kinds: Structure) -> bool:
    """Whether a rig's response to a sine depends on the size of the sine, and can be told by simulating it.

    A joint with play is left out: rod and beam hammer on each other, and no two motions have that in common.
    """
    if law_of_play(kinds.effects):
        return False
    return any(assemble(kinds).function.which_depends("x", ["rate", "y"], 2))


@dataclass(frozen=True)
class SweptSine:
    """A frequency response as it is measured: one sine after the other, simulated until it repeats itself.

    What a deadband, a hysteresis, friction or a limit makes of a sine depends on its size, and no linear loop says it.
    The nonlinear rig does, and its derivatives with it; of the motion the first harmonic is taken, as an analyser does
    (A. Gelb and W. E. Vander Velde, Multiple-Input Describing Functions and Nonlinear System Design, 1968, section
    2.2).

    Attributes:
        measured: the response, with the amplitude of its input.
        prototype: that was believed.
        most: lines that are simulated.
    """

    measured: FrequencyResponse
    prototype: Prototype
    most: int

    @cached_property
    def lines(self) -> np.ndarray:
        """(S,) positions of the lines that are simulated: no more than `most`, even over ln f.

        They lie from 1 to 400 Hz of a rig as quick as the published one.
        """
        hertz = self.measured.frequencies_Hz
        low, high = widened(self.prototype, *_SWEPT_HZ)
        inside = np.flatnonzero((hertz >= low) & (hertz <= high))
        if len(inside) <= self.most:
            return inside
        evenly = np.geomspace(hertz[inside[0]], hertz[inside[-1]], self.most)
        return inside[np.unique(np.searchsorted(hertz[inside], evenly * (1 - 1e-9)))]

    @cached_property
    def between(self) -> np.ndarray:
        """(N, S) what gives figures of all lines from those of the simulated ones: straight over ln f, level beyond."""
        octaves = np.log(self.measured.frequencies_Hz)
        return np.column_stack([np.interp(octaves, octaves[self.lines], one) for one in np.eye(len(self.lines))])

    @cached_property
    def _sines(self) -> list[tuple[Replay, np.ndarray]]:
        """Of every such line its sine, and what takes the displacement's first harmonic, over the input, from it."""
        return [self._sine(float(hertz)) for hertz in self.measured.frequencies_Hz[self.lines]]

    def _sine(self, hertz: float) -> tuple[Replay, np.ndarray]:
        taken = self.measured
        assert taken.amplitude is not None
        each = max(_LEAST_SAMPLES, ceil(1 / (hertz * _SAMPLE_S)))
        settles, listens = max(_SETTLES_PERIODS, ceil(_SETTLES_S * hertz)), ceil(_LISTENS_S * hertz)
        times = np.arange((settles + listens) * each + 1) / (each * hertz)
        turns = 2 * np.pi * hertz * times
        inputs = np.zeros((len(times), 2))
        inputs[:, taken.driven_by] = taken.amplitude * np.sin(turns)
        listened = np.zeros(len(times), complex)
        window = slice(settles * each, -1)
        listened[window] = 2j * np.exp(-1j * turns[window]) / (listens * each * taken.amplitude)
        still = {DISPLACEMENT: np.zeros(len(times))}
        masses = taken.outer_end_mass, taken.inner_end_mass
        return Replay(TimeRecord(taken.name, times, inputs, still, *masses, taken.controller), self.prototype), listened

    def response(
        self, placement: Placement, z: np.ndarray, linear: "LinearModel | None", sloped: bool = True
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Response (S,) and the derivatives of its logarithm by z (S, K); None where the simulated loop diverges.

        Each sine begins as the linear loop would go on for ever, so that what has to settle is what the laws that are
        not linear change: beside a resonance of little damping a motion from rest takes seconds to.

        Args:
            placement: of the unknowns.
            z: their values.
            linear: the loop; None where it is not stable, and sines begin at rest.
            sloped: without slopes there are no derivatives, and it takes a fraction of the time.
        """
        found = np.zeros(len(self.lines), complex)
        slopes = np.zeros((len(self.lines), len(z) if sloped else 0), complex)
        begun = [None] * len(self.lines) if linear is None else self._begun(placement, z, linear, sloped)
        for k, (job, listened) in enumerate(self._sines):
            moved = job.simulated_with_slopes(placement, z, (DISPLACEMENT,), sloped, begun[k])
            if moved is None:
                return None
            found[k] = listened @ moved[0][:, 0]
            if sloped:
                slopes[k] = listened @ moved[1][:, 0] / found[k]
        return found, slopes

    def _begun(self, placement: Placement, z: np.ndarray, linear: "LinearModel", sloped: bool) -> list[Begun | None]:
        """Of every sine how it begins."""
        job, _ = self._sines[0]
        p, placed = job.parameters(placement, z), job.placed(placement)
        moved = list(placed.moved) if sloped else []
        step = _STEP * np.abs(placed.slopes(p)[moved]).max(axis=1, initial=0.0)
        nudged = np.zeros((len(p), len(moved)))
        nudged[moved, range(len(moved))] = step
        beside = np.column_stack([p, p[:, None] + nudged, p[:, None] - nudged])
        hertz = self.measured.frequencies_Hz[self.lines]
        states = np.zeros((len(hertz), beside.shape[1], len(placed.assembly.states)))
        places = [placed.assembly.states.index(name) for name in linear.assembly.states]
        states[:, :, places] = self.measured.amplitude * linear.turning(beside, self.measured.driven_by, hertz).imag
        by = (states[:, 1 : len(moved) + 1] - states[:, len(moved) + 1 :]) / (2 * step[:, None])
        return list(zip(states[:, 0], by.transpose(0, 2, 1), strict=True))
