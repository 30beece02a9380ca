"""The simulator's rig with any controller that works sample by sample: the compiled C, or its emulation."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from beamdesign import Prototype
from beamdesign.build.realisation.c_code import to_word
from beamdesign.build.realisation.realise import Realisation
from beamdesign.plant.assembly import OUTPUTS, assemble, parameters_of, structure_of
from beamdesign.plant.compiled import compiled, half_steps
from beamdesign.plant.equilibrium import equilibrium, substeps_for

_ENDLESS_M = 1e3


class Machine(Protocol):
    """What is called once per sample: with words in fixed point, otherwise with V, m and Pa, for A."""

    def reset(self, *readings):  # type: ignore[no-untyped-def]
        """At rest under constant readings."""

    def step(self, *readings):  # type: ignore[no-untyped-def]
        """The current of one sample."""


@dataclass(frozen=True)
class ClosedRecord:
    """A record at the controller's sample times.

    Attributes:
        times: (N,) s.
        displacement_m: (N,) of the outer tip.
        error_V: (N,) as the sensor gives it, before it becomes a word.
        current_A: (N,) computed from that sample.
    """

    times: np.ndarray
    displacement_m: np.ndarray
    error_V: np.ndarray
    current_A: np.ndarray


def run_closed(
    prototype: Prototype,
    realisation: Realisation,
    machine: Machine,
    force_N: np.ndarray,
    outer_end_mass_kg: float = 0.0,
    delayed: bool = True,
) -> ClosedRecord:
    """Simulate the nonlinear rig, effects included, with a controller called at every sample.

    Args:
        prototype: rig and its effects; of its controller only the equilibrium is used.
        realisation: words and rate of the controller.
        machine: the controller.
        force_N: (N,) on the outer tip at sample times, N at least 4, with cubics between them.
        outer_end_mass_kg: payload.
        delayed: whether a current is put out one period after its sample.

    Raises:
        InputError: as `beamdesign.simulation.simulate`.
        ValueError: where there is no equilibrium, or the rig leaves the numbers.
    """
    from beamdesign.plant.compiled import steps

    kinds = structure_of(prototype, sampled=True)
    assembly, continuous = assemble(kinds), assemble(structure_of(prototype))
    inner = prototype.payload.inner_end_mass_kg
    parameters = np.array(list(parameters_of(prototype, outer_end_mass_kg, inner).values()))
    still = np.zeros(3)
    rest = equilibrium(continuous, still, parameters)
    channels = realisation.channels

    def readings(outputs: np.ndarray) -> list[float]:
        """What the law hears of a row of outputs, without command."""
        sensed = []
        for channel in channels:
            name = "measured_V" if channel.name == "error" else channel.reading
            value = float(outputs[OUTPUTS.index(name)]) if name in OUTPUTS else 0.0
            sensed.append(-value if channel.name == "error" else value)
        return sensed

    sensed = readings(np.asarray(continuous.function(0.0, rest, still, parameters)[1]).ravel())
    x = np.array([rest[continuous.states.index(name)] for name in assembly.states], dtype=float)

    count, period = len(force_N), 1 / realisation.rate_Hz
    substeps = substeps_for(continuous, parameters, np.arange(count) * period)
    inputs = half_steps(np.column_stack([force_N, np.zeros(count)]), substeps)
    code, width = compiled(kinds), len(assembly.outputs)
    prepared, y = code.prepared(parameters), np.zeros((2, width))
    fixed = realisation.word_length is not None
    unit = 2.0**-realisation.current_places if fixed else 1.0

    def given(values: list[float]) -> list[float]:
        return [to_word(realisation, value, k) for k, value in enumerate(values)] if fixed else values

    machine.reset(*given(sensed))
    held = sum(channel.gain * value for channel, value in zip(channels, sensed, strict=True))
    found = np.zeros((3, count))
    for k in range(count):
        current = float(machine.step(*given(sensed))) * unit
        found[1:, k] = sensed[0], current
        out = held if delayed else current
        held = current
        last = k + 1 == count
        window = inputs[2 * substeps * k : 2 * substeps * (k + 1) + 1] if not last else inputs[-2 * substeps - 1 :]
        # Between two samples the current is constant: a law that is asked once and answers one period late.
        constant = np.array([4.0 * substeps, 1.0, 0.0, out, 0.0, 0.0])
        times = np.array([k, k + 1]) * period
        kept = steps(
            code.address["law"], code.address["output"], times, np.ascontiguousarray(window), x, len(x), prepared,
            substeps, _ENDLESS_M, constant, y,
        )  # fmt: skip
        if kept < 2:
            raise ValueError(f"the rig left the numbers at {times[0]:.4g} s")
        found[0, k] = y[0, OUTPUTS.index("outer_displacement_m")]
        sensed = readings(y[1])
    return ClosedRecord(np.arange(count) * period, *found)
