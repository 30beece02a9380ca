"""A controller that works at sample times: held current, quantised volts, whole periods of delay."""

from dataclasses import dataclass

import numpy as np

from beamdesign.controllers import SENSED, Controller
from beamdesign.plant.assembly import OUTPUTS
from beamdesign.plant.stepper import COMMAND, ERROR


@dataclass(frozen=True)
class SampledLaw:
    """z+ = A z + B e, i = C z + D e at every sample: the difference equation that a specification states.

    Attributes:
        matrix: (n + 1, n + k), A and B above C and D.
        sensed: what each of the k readings is: `ERROR`, `COMMAND` or a place among the rig's outputs.
    """

    matrix: np.ndarray
    sensed: tuple[int, ...]

    @property
    def order(self) -> int:
        """N."""
        return len(self.matrix) - 1

    def step(self, state: np.ndarray, readings: np.ndarray) -> tuple[np.ndarray, float]:
        """State (n,) after, and current (A) of, one sample."""
        after = self.matrix @ np.concatenate([state, readings])
        return after[:-1], float(after[-1])

    def readings(self, outputs: np.ndarray) -> np.ndarray:
        """(k,) what it hears of a row of the rig's outputs, without command."""
        known = {ERROR: -outputs[OUTPUTS.index("measured_V")], COMMAND: 0.0}
        return np.array([known[place] if place < 0 else outputs[place] for place in self.sensed])

    def at_rest(self, readings: np.ndarray) -> np.ndarray:
        """State (n,) under constant readings."""
        n = self.order
        return np.asarray(np.linalg.solve(np.eye(n) - self.matrix[:n, :n], self.matrix[:n, n:] @ readings))

    def after(self, readings: np.ndarray, current: float) -> np.ndarray:
        """State (n,) after a sample of these readings that gave this current: of first order at most there is one."""
        n = self.order
        own, through = self.matrix[n, :n], self.matrix[n, n:]
        before = np.linalg.pinv(own.reshape(1, n)) @ np.array([current - through @ readings])
        return self.step(before, readings)[0]

    def packed(
        self, period_steps: int, delay_periods: int, least_volt: float, state: np.ndarray, current: float
    ) -> np.ndarray:
        """As `beamdesign.plant.compiled.integrate` takes it.

        Args:
            period_steps: integration steps per period.
            delay_periods: whole periods between reading a sample and giving its current.
            least_volt: step of the converter that reads the sensor, V; 0 for none.
            state: (n,) at the first sample.
            current: before the record, A.
        """
        head = [period_steps, delay_periods, least_volt, current, self.order, len(self.sensed), *self.sensed]
        return np.concatenate([head, self.matrix.ravel(), state])


def sampled_law(controller: Controller, period_s: float) -> SampledLaw:
    """The difference equation of a controller at a period.

    Raises:
        ValueError: where it has none; see `beamdesign.build.realisation.realise.difference_equation`.
    """
    from beamdesign.build.realisation.realise import difference_equation, floats

    law = difference_equation(controller, 1 / period_s).linear
    places = {SENSED[0]: ERROR, "command_V": COMMAND}
    sensed = tuple(places[name] if name in places else OUTPUTS.index(name) for name in law.sensed)
    return SampledLaw(np.block([[floats(law.a), floats(law.b)], [floats(law.c), floats(law.d)]]), sensed)
