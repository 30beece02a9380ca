"""The rig under a hypothesis as one linear loop, where a measurement says no more; frequency responses as evidence.

A critical gain and a response at lines are figures of motions that are small for the oil and the beams, and large
beside a deadband, a hysteresis, a joint's play or the force of dry friction: an oscillation that is sustained, or a
force that is swept, has left these behind. So the linear loop here is the one with the valve open, the friction sliding
(its viscous share stays), the joint bearing on one side of its play, and amplifier and motor within their limits.
It says nothing about motions so small that the loop sticks, nor about an oscillation that a saturation has caught; see
`beamdesign.plant.harmonic_balance` for those.

Where the two directions of the valve differ (unequal sides), there is one such loop per direction.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from beamdesign.diagnosis.data.dataset import FrequencyResponse
from beamdesign.diagnosis.fitting.fit import Evidence
from beamdesign.diagnosis.fitting.hypothesis import Placement, cause, together
from beamdesign.diagnosis.fitting.replay import SweptSine, bearing, depends_on_size, law_of_play
from beamdesign.diagnosis.fitting.weighting import INDEPENDENT, SHARE
from beamdesign.plant.assembly import OUTPUTS, Assembly, assemble, parameters_of
from beamdesign.plant.equilibrium import StateSpace, equilibrium, equilibrium_sensitivity, linearise, scales
from beamdesign.prototype import Prototype

LEFT_BEHIND = ("current_saturation", "motor_current_limit", "valve_deadband", "valve_hysteresis")
"""Causes that have no part in the linear loop, by whatever law."""
_OPEN_M3_PER_S = 1e-12
_STEP = 1e-4  # in prior standard deviations, of central differences


@dataclass(frozen=True)
class LinearModel:
    """The linear loop of one setting of the rig, for any unknowns of one placement.

    Attributes:
        placement: of the unknowns in the whole equations.
        base: (P,) parameters of the believed rig in the placement's order.
        assembly: the equations without what is left behind.
        load: constant force on the outer tip, N.
    """

    placement: Placement
    base: np.ndarray = field(repr=False)
    assembly: Assembly
    load: float = 0.0

    @cached_property
    def _rows(self) -> list[int]:
        """Of the parameters of `assembly` in the placement's order."""
        index = {name: k for k, name in enumerate(self.placement.assembly.parameters)}
        return [index[name] for name in self.assembly.parameters]

    @cached_property
    def weight(self) -> np.ndarray:
        """(n,) typical magnitude of each state."""
        return scales(self.assembly.states)

    def parameters(self, z: np.ndarray, gain: float | None = None) -> np.ndarray:
        """Parameters of `assembly` at z, with another controller gain (A/V) where one is given."""
        p = self._own(self.placement.parameters(self.base, z))
        if gain is not None:
            p[self.assembly.parameters.index("gain")] = gain
        return p

    def _own(self, p: np.ndarray) -> np.ndarray:
        """Parameters of `assembly`, from those in the placement's order; likewise of several side by side."""
        p, names = p[self._rows], self.assembly.parameters
        if "seal_friction.coulomb_N" in names:
            p[names.index("seal_friction.coulomb_N")] = 0.0
        return np.asarray(p)

    def points(self, p: np.ndarray) -> list[np.ndarray]:
        """Where the rig works: (n,) states, once per direction of the valve where these differ.

        Args:
            p: parameters of `assembly`.

        Raises:
            ValueError: where it has no equilibrium.
        """
        effects, states = self.assembly.kinds.effects, self.assembly.states
        x = equilibrium(self.assembly, np.array([self.load, 0.0, 0.0]), p)
        if law_of_play(effects):
            x = bearing(self.assembly, x, p)
        if "unequal_piston_areas" not in effects or abs(x[flow := states.index("flow_m3_per_s")]) > _OPEN_M3_PER_S:
            return [x]
        both = [x.copy(), x.copy()]
        both[0][flow], both[1][flow] = _OPEN_M3_PER_S, -_OPEN_M3_PER_S
        return both

    def at(self, p: np.ndarray, x: np.ndarray) -> StateSpace:
        """The linear loop at a point; at several at once, (P, K) and (n, K), its matrices stand side by side."""
        inputs = np.zeros((3, *x.shape[1:]))
        inputs[0] = self.load
        return linearise(self.assembly, x, inputs, p)

    def rates_at_gains(self, p: np.ndarray, x: np.ndarray, gains: Sequence[float]) -> list[np.ndarray]:
        """(n, n) matrices A of the linear loop at a point for several controller gains (A/V)."""
        count = len(gains)
        columns = np.repeat(p[:, None], count, axis=1)
        columns[self.assembly.parameters.index("gain")] = gains
        return np.split(self.at(columns, np.repeat(x[:, None], count, axis=1)).a, count, axis=1)

    def turning(self, parameters: np.ndarray, given: int, hertz: np.ndarray) -> np.ndarray:
        """Steady motions of the states per unit of a sine of an input, complex (F, M, n) at F frequencies.

        Args:
            parameters: (P, M) in the placement's order, side by side and all next to the first.
            given: which input.
            hertz: (F,) frequencies.

        Raises:
            ValueError: where there is no equilibrium.
        """
        own = self._own(parameters)
        x = self.points(own[:, 0])[0]
        states, count = len(x), own.shape[1]
        loops = self.at(own, np.repeat(x[:, None], count, axis=1))
        a = loops.a.reshape(states, count, states).transpose(1, 0, 2)
        b = loops.b.reshape(states, count, -1)[:, :, given].T
        rates = 2j * np.pi * hertz[:, None, None, None]
        return np.asarray(np.linalg.solve(rates * np.eye(states) - a, b[..., None] + 0j * rates)[..., 0])

    def slopes(self, z: np.ndarray, x: np.ndarray, gain: float | None = None) -> list[StateSpace]:
        """Derivatives of the linear loop by every unknown, the point moving along, by central differences."""
        here, names = self.parameters(z, gain), self.assembly.parameters
        by_z = self.placement.slopes(self.placement.parameters(self.base, z))[self._rows]
        by_z[[names.index(still) for still in ("gain", "seal_friction.coulomb_N") if still in names]] = 0.0
        free, loaded = np.nonzero(by_z.any(axis=1))[0], np.array([self.load, 0.0, 0.0])
        moved = equilibrium_sensitivity(self.assembly, x, loaded, here, [names[k] for k in free]) @ by_z[free]
        sides = np.array([1.0, -1.0])[:, None, None] * _STEP
        # All at once: one column per unknown and side.
        columns = np.concatenate(list(here[:, None] + sides * by_z), axis=1)
        points = np.concatenate(list(x[:, None] + sides * moved), axis=1)
        ends = self.at(columns, points)
        count = len(z)

        def differences(matrices: np.ndarray) -> np.ndarray:
            stacked = matrices.reshape(len(matrices), 2 * count, -1).transpose(1, 0, 2)
            return np.asarray((stacked[:count] - stacked[count:]) / (2 * _STEP))

        parts = [differences(getattr(ends, key)) for key in ("a", "b", "c", "d")]
        return [StateSpace(*(part[k] for part in parts)) for k in range(count)]


@dataclass(frozen=True)
class LinearEvidence(Evidence):
    """What is measured of a loop and predicted by its linear model.

    Attributes:
        measured: the figure or figures, with controller and end masses.
        prototype: that was believed.
    """

    measured: Any
    prototype: Prototype
    _models: dict[object, LinearModel] = field(default_factory=dict, repr=False, compare=False, kw_only=True)

    def nominal(self, *effects: str) -> Any:
        """What the model makes of it with every figure as believed, and effects at their usual sizes; None: nothing."""
        placement = together(*effects).placement(self.prototype)
        return self.predicted(placement, np.zeros(len(placement.unknowns)))

    def model(self, placement: Placement) -> LinearModel:
        """The linear loop of this setting."""
        key = (placement.assembly.kinds, placement.unknowns)
        if key not in self._models:
            taken, placement = self.measured, placement.under(self.measured.controller.equations)
            kinds = placement.assembly.kinds
            tables = {name: self.prototype.effects.get(name, {}) for name in kinds.effects}
            rig = self.prototype.but(controller=taken.controller, effects=tables)
            base = np.array(list(parameters_of(rig, taken.outer_end_mass, taken.inner_end_mass).values()))
            kept = tuple(name for name in kinds.effects if cause(name) not in LEFT_BEHIND)
            self._models[key] = LinearModel(placement, base, assemble(replace(kinds, effects=kept)), taken.load_N)
        return self._models[key]


_SEEN = OUTPUTS.index("displacement_m")
_STABLE = 1e-6  # rad/s
_NEIGHBOURS = 4
_LARGEST_NOISE, _UNTOLD, _DIGITS = 0.5, SHARE, 1e-4
_QUARTER, _MEDIAN = 0.3186, 0.6745  # quantiles of the size of a standard normal deviate


@dataclass(frozen=True)
class ResponseEvidence(LinearEvidence):
    """A frequency response in units of misfit.

    A line's residual is the logarithm of measured over predicted: that of the magnitude and, where the phase was
    measured, the phase difference in radians. Its unit is 2 % (`weighting.SHARE`) and the scatter of the lines about
    their neighbours together, and a response as a whole counts as no more than `weighting.INDEPENDENT` units.

    The response is that of the linear loop of `LinearModel`, to the displacement that the controller sees; where the
    two directions of the valve differ a sine meets both alike, so the mean of both loops stands for them. The sine's
    amplitude has no part in that. Where `swept`, what depends on it is simulated instead, see `SweptSine`.

    Attributes:
        share: relative error of a model that counts as one unit.
        swept: lines at which laws that are not linear meet the sine at its amplitude, which then is stated; 0: none.
    """

    measured: FrequencyResponse
    share: float = SHARE
    swept: int = 0

    @cached_property
    def _sines(self) -> SweptSine:
        return SweptSine(self.measured, self.prototype, self.swept)

    def _simulated(self, placement: Placement) -> bool:
        kinds = placement.under(self.measured.controller.equations).assembly.kinds
        return bool(self.swept and len(self._sines.lines)) and depends_on_size(kinds)

    @cached_property
    def _noise(self) -> np.ndarray:
        """(M,) of every row of the residual."""
        return np.tile(scatter(self.measured), 2 if self.measured.has_phase else 1)

    @cached_property
    def units(self) -> np.ndarray:
        """(M,) relative error that is one unit, of every row of the residual."""
        return np.sqrt(self.share**2 + self._noise**2) / min(1.0, float(np.sqrt(INDEPENDENT / len(self._noise))))

    @property
    def expected(self) -> float:
        """Misfit that noise alone leaves."""
        return float(np.sum((self._noise / self.units) ** 2))

    @property
    def name(self) -> str:
        """Of the response."""
        return self.measured.name

    @property
    def condition(self) -> object:
        """Under which it was taken: masses, controller, input, amplitude."""
        taken = self.measured
        masses = taken.outer_end_mass, taken.inner_end_mass
        return ("response", *masses, taken.controller, taken.driven_by, taken.amplitude)

    def predicted(self, placement: Placement, z: np.ndarray) -> np.ndarray | None:
        """(N,) complex response of the model, in the unit of the measured one; None where its loop is unstable."""
        found = self._response(placement, z, sloped=False)
        return None if found is None else found[0]

    def linearised(self, placement: Placement, z: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """The residual and its derivative by z."""
        found = self._response(placement, z)
        return None if found is None else (self.misfit(found[0]), -self._weighed(found[1]))

    def _response(
        self, placement: Placement, z: np.ndarray, sloped: bool = True
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Response (N,) and the derivatives of its logarithm by z (N, K), or (N, 0) without slopes.

        Where sines are simulated, it is the linear loop's times what they differ from it by, which is smooth over
        frequency; by themselves where the linear loop is unstable, as one whose valve opens is not at rest.
        """
        linear = self._linear(placement, z, sloped)
        if not self._simulated(placement):
            return linear
        model = None if linear is None else self.model(placement)
        sines, at, between = self._sines.response(placement, z, model, sloped), self._sines.lines, self._sines.between
        if sines is None:
            return None
        if linear is None:
            linear = np.ones(len(between), complex), np.zeros((len(between), sines[1].shape[1]))
        off = sines[0] / linear[0][at]
        everywhere = between @ off
        more = between @ (off[:, None] * (sines[1] - linear[1][at])) / everywhere[:, None]
        return linear[0] * everywhere, linear[1] + more

    def _linear(self, placement: Placement, z: np.ndarray, sloped: bool) -> tuple[np.ndarray, np.ndarray] | None:
        """See `_response`, of the linear loop: by its states per unit of input at every line, and their adjoints."""
        model, given = self.model(placement), self.measured.driven_by
        p = model.parameters(z)
        try:
            points = model.points(p)
            loop = _mean([model.at(p, x) for x in points])
        except ValueError:
            return None
        weight = model.weight
        if np.linalg.eigvals(loop.a / weight[:, None] * weight[None, :]).real.max() > _STABLE:
            return None
        rates = 2j * np.pi * self.measured.frequencies_Hz
        resolvent = rates[:, None, None] * np.eye(len(loop.a)) - loop.a
        right = np.linalg.solve(resolvent, np.tile(loop.b[:, given, None], (len(rates), 1, 1)))[..., 0]
        response = right @ loop.c[_SEEN] + loop.d[_SEEN, given]
        if not sloped:
            return response, np.zeros((len(rates), 0))
        seen = np.tile(loop.c[_SEEN, :, None], (len(rates), 1, 1))
        left = np.linalg.solve(resolvent.transpose(0, 2, 1), seen)[..., 0]
        slopes = [model.slopes(z, x) for x in points]
        columns = []
        for k in range(len(z)):
            by = _mean([side[k] for side in slopes])
            moved = np.einsum("ni,ij,nj->n", left, by.a, right) + left @ by.b[:, given]
            columns.append((moved + right @ by.c[_SEEN] + by.d[_SEEN, given]) / response)
        return response, np.array(columns).reshape(len(z), len(response)).T

    def misfit(self, predicted: np.ndarray) -> np.ndarray:
        """(N,) or, with phase, (2 N,) measured less predicted, weighed."""
        ratio = self.measured.response / (predicted if self.measured.has_phase else np.abs(predicted))
        return self._weighed(np.log(ratio.astype(complex))[:, None])[:, 0]

    def _weighed(self, relative: np.ndarray) -> np.ndarray:
        """Complex (N, K) relative changes as rows of units: magnitudes, then phases where they were measured."""
        rows = np.concatenate([relative.real, relative.imag]) if self.measured.has_phase else relative.real
        return rows / self.units[:, None]


def scatter(measured: FrequencyResponse) -> np.ndarray:
    """(N,) relative noise of each line: how far magnitudes stand off the straight line between their neighbours'.

    The median over the lines around, so that a single odd line does not count. A resonance bends over more lines than
    these, so it is no more than either a noise that is everywhere the same share, read off the quarter of the lines
    that stand off least, or one that is everywhere the same displacement, read off the highest fifth. Of fewer than
    five lines, which do not tell, it is `_UNTOLD`; it is never less than `_DIGITS`.
    """
    size, place = np.abs(measured.response), np.log(measured.frequencies_Hz)
    magnitude, count = np.log(size), len(place)
    if count < 5:
        return np.full(count, _UNTOLD)
    share = (place[1:-1] - place[:-2]) / (place[2:] - place[:-2])
    off = magnitude[1:-1] - (1 - share) * magnitude[:-2] - share * magnitude[2:]
    single = np.abs(off) / np.sqrt(1 + share**2 + (1 - share) ** 2)
    around = [float(np.median(single[max(0, k - 1 - _NEIGHBOURS) : k + _NEIGHBOURS])) for k in range(count)]
    relative = float(np.quantile(single, 0.25)) / _QUARTER
    last = max(1, count // 5)
    absolute = float(np.median((single * size[1:-1])[-last:])) / _MEDIAN / size
    found = np.minimum(np.minimum(np.array(around) / _MEDIAN, np.maximum(relative, absolute)), _LARGEST_NOISE)
    return np.maximum(found, _DIGITS)


def _mean(loops: list[StateSpace]) -> StateSpace:
    return StateSpace(*(sum(getattr(loop, key) for loop in loops) / len(loops) for key in ("a", "b", "c", "d")))
