"""The rig under a hypothesis as one linear loop, where a measurement says no more than that.

A critical gain and a response at lines are figures of motions that are small for the oil and the beams, and large
beside a deadband, a hysteresis, a joint's play or the force of dry friction: an oscillation that is sustained, or a
force that is swept, has left these behind. So the linear loop here is the one with the valve open, the friction sliding
(its viscous share stays), the joint bearing on one side of its play, and the amplifier within its limit. It says
nothing about motions so small that the loop sticks, nor about an oscillation that a saturation has caught; see
`beamdesign.harmonic_balance` for those.

Where the two directions of the valve differ (unequal sides), there is one such loop per direction.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from beamdesign.gap.data.dataset import FrequencyResponse, MeasuredGain
from beamdesign.gap.fitting.fit import Evidence
from beamdesign.gap.fitting.unknowns import Placement
from beamdesign.prototype import Prototype
from beamdesign.rig.assembly import Assembly, Structure, assemble
from beamdesign.rig.equilibrium import Linearisation, equilibrium, linearise, scales
from beamdesign.rig.parameters import parameters_of
from beamdesign.rig.sensitivity import equilibrium_sensitivity

LEFT_BEHIND = ("current_saturation", "valve_deadband", "valve_hysteresis", "valve_hysteresis_magnetic")
"""Effects that have no part in the linear loop."""
_BEARING_M = 1e-5
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
    _rest: list[np.ndarray] = field(default_factory=list, repr=False, compare=False)

    @cached_property
    def _rows(self) -> list[int]:
        """Of the parameters of `assembly` in the placement's order."""
        index = {name: k for k, name in enumerate(self.placement.assembly.parameters)}
        return [index[name] for name in self.assembly.parameters]

    @cached_property
    def weight(self) -> np.ndarray:
        """(n,) typical magnitude of each state."""
        return scales(self.assembly)

    def parameters(self, z: np.ndarray, gain: float | None = None) -> np.ndarray:
        """Parameters of `assembly` at z, with another controller gain (A/V) where one is given."""
        p = self.placement.parameters(self.base, z)[self._rows]
        own = self.assembly.parameters
        if "seal_friction.coulomb_N" in own:
            p[own.index("seal_friction.coulomb_N")] = 0.0
        if gain is not None:
            p[own.index("gain")] = gain
        return np.asarray(p)

    def points(self, p: np.ndarray) -> list[np.ndarray]:
        """Where the rig works: (n,) states, once per direction of the valve where these differ.

        Args:
            p: parameters of `assembly`.

        Raises:
            ValueError: where it has no equilibrium.
        """
        effects, states = self.assembly.kinds.effects, self.assembly.states
        if not MOVING & set(effects) and self.load == 0:
            if not self._rest:
                self._rest.append(equilibrium(self.assembly, np.zeros(3), p))
            return list(self._rest)
        x = equilibrium(self.assembly, np.array([self.load, 0.0, 0.0]), p)
        if "joint_backlash" in effects:
            play = p[self.assembly.parameters.index("joint_backlash.play_m")]
            x[states.index("joint_backlash.rod_m")] = x[states.index("inner_m")] + play / 2 + _BEARING_M
        flow = states.index("flow_m3_per_s")
        if "unequal_piston_areas" not in effects or abs(x[flow]) > _OPEN_M3_PER_S:
            return [x]
        both = [x.copy(), x.copy()]
        both[0][flow], both[1][flow] = _OPEN_M3_PER_S, -_OPEN_M3_PER_S
        return both

    def at(self, p: np.ndarray, x: np.ndarray) -> Linearisation:
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

    def slopes(self, z: np.ndarray, x: np.ndarray, gain: float | None = None) -> list[Linearisation]:
        """Derivatives of the linear loop by every unknown, the point moving along, by central differences."""
        names, here = self.assembly.parameters, self.parameters(z, gain)
        by_z = self.placement.slopes(self.placement.parameters(self.base, z), z)[self._rows]
        for still in ("gain", "seal_friction.coulomb_N"):
            if still in names:
                by_z[names.index(still)] = 0.0
        moved = self._moved(x, here, by_z)
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
        return [Linearisation(*(part[k] for part in parts)) for k in range(count)]

    def _moved(self, x: np.ndarray, p: np.ndarray, by_z: np.ndarray) -> np.ndarray:
        """(n, K) derivative of the point; it rests at zero whatever z is where no law depends on where."""
        moved = np.zeros((len(x), by_z.shape[1]))
        if not MOVING & set(self.assembly.kinds.effects) and self.load == 0:
            return moved
        free = np.nonzero(by_z.any(axis=1))[0]
        names = [self.assembly.parameters[k] for k in free]
        u = np.array([self.load, 0.0, 0.0])
        return equilibrium_sensitivity(self.assembly, x, u, p, names) @ by_z[free]


MOVING = {"unequal_piston_areas", "uneven_leakage", "pressure_dependent_flow", "joint_backlash"}
"""Effects whose parameters move the equilibrium, or whose laws depend on where it is."""


def linear_model(
    placement: Placement, prototype: Prototype, taken: MeasuredGain | FrequencyResponse, load: float = 0.0
) -> LinearModel:
    """The linear loop of a setting.

    Args:
        placement: unknowns of a hypothesis.
        prototype: that was believed.
        taken: in that setting: its controller and end masses count.
        load: constant force on the outer tip, N.
    """
    placement = placement.under(taken.controller.equations)
    kinds = placement.assembly.kinds
    rig = prototype.but(controller=taken.controller, effects={name: {} for name in kinds.effects})
    base = np.array(list(parameters_of(rig, taken.outer_end_mass, taken.inner_end_mass).values()))
    kept = tuple(name for name in kinds.effects if name not in LEFT_BEHIND)
    return LinearModel(placement, base, assemble(Structure(kinds.controller, kinds.filtered, kept, kinds.rig)), load)


@dataclass(frozen=True)
class LinearEvidence(Evidence):
    """What is measured of a loop and predicted by its linear model.

    Attributes:
        measured: the figure or figures, with controller and end masses.
        prototype: that was believed.
        load: constant force on the outer tip under which it was measured, N.
    """

    measured: Any
    prototype: Prototype
    load: float = 0.0
    _models: dict[object, LinearModel] = field(default_factory=dict, repr=False, compare=False, kw_only=True)

    def model(self, placement: Placement) -> LinearModel:
        """The linear loop of this setting."""
        key = (placement.assembly.kinds, placement.unknowns)
        if key not in self._models:
            self._models[key] = linear_model(placement, self.prototype, self.measured, self.load)
        return self._models[key]
