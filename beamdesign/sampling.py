"""Laws that work at sample times: difference equations, alone and in series, and their states from their past."""

from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np

from beamdesign.controllers import SENSED, Break, Controller, Stage, TransferFunction
from beamdesign.plant.actuators import KINDS
from beamdesign.plant.assembly import OUTPUTS
from beamdesign.plant.equilibrium import StateSpace
from beamdesign.polynomial import exact

ERROR, COMMAND = -1, -2
"""Readings of a sampled controller that are not among the outputs: the command less the volts, and the command."""


@dataclass(frozen=True)
class SampledLaw:
    """z+ = A z + B e, i = C z + D e at every sample: the difference equation that a specification states.

    Attributes:
        system: A (n, n), B (n, k), C (1, n) and D (1, k).
        sensed: what each of the k readings is: `ERROR`, `COMMAND` or a place among the rig's outputs.
    """

    system: StateSpace
    sensed: tuple[int, ...]

    @property
    def order(self) -> int:
        """How many states it has."""
        return len(self.system.a)

    def step(self, state: np.ndarray, readings: np.ndarray) -> tuple[np.ndarray, float]:
        """State (n,) after, and current (A) of, one sample."""
        own = self.system
        return own.a @ state + own.b @ readings, float((own.c @ state + own.d @ readings)[0])

    def readings(self, outputs: np.ndarray) -> np.ndarray:
        """(k,) what it hears of a row of the rig's outputs, without command."""
        known = {ERROR: -outputs[OUTPUTS.index("measured_V")], COMMAND: 0.0}
        return np.array([known[place] if place < 0 else outputs[place] for place in self.sensed])

    def at_rest(self, readings: np.ndarray) -> np.ndarray:
        """State (n,) under constant readings."""
        return np.asarray(np.linalg.solve(np.eye(self.order) - self.system.a, self.system.b @ readings))

    def after(self, readings: np.ndarray, currents: np.ndarray) -> np.ndarray:
        """State (n,) after samples of which the last n readings (n or more, k) gave the last n currents (n or more,).

        Where several states would have given them, it is after the smallest.
        """
        n, seen, unexplained = self.order, list[np.ndarray](), list[float]()
        forced, shows = np.zeros(n), self.system.c[0]
        for k in range(-n, 0):
            forced, current = self.step(forced, readings[k])
            seen.append(shows)
            unexplained.append(currents[k] - current)
            shows = shows @ self.system.a
        before = np.linalg.pinv(np.reshape(seen, (n, n))) @ np.array(unexplained)
        return np.asarray(np.linalg.matrix_power(self.system.a, n) @ before + forced)

    def before(self, other: "SampledLaw") -> "SampledLaw":
        """In series with another that has one reading: what this one gives. This one's states come first."""
        return SampledLaw(other.system.behind(self.system), self.sensed)

    def packed(
        self, period_steps: int, delay_periods: int, least_volt: float, state: np.ndarray, current: float
    ) -> np.ndarray:
        """As `integrate` takes it.

        Args:
            period_steps: integration steps per period.
            delay_periods: whole periods between reading a sample and giving its current.
            least_volt: step of the converter that reads the sensor, V; 0 for none.
            state: (n,) at the first sample.
            current: before the record, A.
        """
        head = [period_steps, delay_periods, least_volt, current, self.order, len(self.sensed), *self.sensed]
        matrix = np.block([[self.system.a, self.system.b], [self.system.c, self.system.d]])
        return np.concatenate([head, matrix.ravel(), state])


@dataclass(frozen=True)
class SampledCascade:
    """Sampled laws in series: the first reads the error, each other one what the one before it gives.

    Attributes:
        laws: f of them, each of second order at most.
    """

    laws: tuple[SampledLaw, ...]

    @cached_property
    def whole(self) -> SampledLaw:
        """All of them as one, their states in their order."""
        return reduce(SampledLaw.before, self.laws)

    def step(self, state: np.ndarray, error: float) -> tuple[np.ndarray, np.ndarray]:
        """State after one sample, and (f + 1,) what passes from law to law in it: the error first, the current last."""
        ends = np.cumsum([law.order for law in self.laws])[:-1]
        states, signals = [], [error]
        for law, own in zip(self.laws, np.split(state, ends), strict=True):
            after, given = law.step(own, np.array(signals[-1:]))
            states.append(after)
            signals.append(given)
        return np.concatenate(states), np.array(signals)

    def after(self, signals: np.ndarray) -> np.ndarray:
        """State after two samples in which these signals (2, f + 1), as `step` gives them, passed from law to law."""
        return np.concatenate([law.after(signals[:, k : k + 1], signals[:, k + 1]) for k, law in enumerate(self.laws)])


def sampled_law(controller: Controller | TransferFunction, period_s: float) -> SampledLaw:
    """The difference equation of a controller at a period.

    Raises:
        ValueError: where it has none; see `beamdesign.build.realisation.law.difference_equation`.
    """
    from beamdesign.build.realisation.law import difference_equation
    from beamdesign.proofs.mass_family import floats

    law = difference_equation(controller, 1 / period_s).linear
    places = {SENSED[0]: ERROR, "command_V": COMMAND}
    places |= {kind.feels[0]: OUTPUTS.index("load_pressure_Pa") for kind in KINDS.values()}
    sensed = tuple(places[name] if name in places else OUTPUTS.index(name) for name in law.sensed)
    return SampledLaw(StateSpace(*map(floats, (law.a, law.b, law.c, law.d))), sensed)


def sampled_stage(stage: Stage, period_s: float) -> SampledCascade:
    """The same of a stage, its sections before its lag: what passes between them is what one stage hands to the next.

    Raises:
        ValueError: as of `sampled_law`.
    """
    sampled_law(stage.law, period_s)  # which says of the whole law why a period is too long
    breaks = Break(stage.pole_Hz, stage.zero_Hz).exact()
    lag = TransferFunction(breaks.numerator * exact(stage.gain_A_per_V), breaks.denominator)
    parts = [*(section.exact() for section in stage.section), lag]
    return SampledCascade(tuple(sampled_law(part, period_s) for part in parts))
