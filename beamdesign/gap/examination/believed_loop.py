"""What the believed rig would do, as a linear loop: quick enough to try many readings of a record against it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import pi

import numpy as np

from beamdesign.controllers import Controller
from beamdesign.gap.data.dataset import TimeRecord
from beamdesign.gap.fitting.weighting import faded
from beamdesign.members import paper_model
from beamdesign.prototype import Prototype
from beamdesign.rig.electronics import state_space

CHANNELS = ("current_A", "displacement_m", "load_pressure_Pa", "inner_displacement_m")


@dataclass(frozen=True)
class BelievedLoop:
    """The closed loop x' = A x + B (force, command) of a prototype without effects.

    Attributes:
        a: (n, n).
        b: (n, 2).
        c: (4, n) to `CHANNELS`.
        d: (4, 2).
        poles: (n,) rad/s.
    """

    a: np.ndarray = field(repr=False)
    b: np.ndarray = field(repr=False)
    c: np.ndarray = field(repr=False)
    d: np.ndarray = field(repr=False)
    poles: np.ndarray = field(repr=False)

    @property
    def stable(self) -> bool:
        """Whether every pole is in the left half-plane."""
        return bool(np.all(self.poles.real < 0))

    @property
    def slowest_Hz(self) -> float:
        """Of the modes that swing."""
        swinging = np.abs(self.poles[np.abs(self.poles.imag) > 0.2 * np.abs(self.poles)])
        return float(swinging.min()) / (2 * pi) if len(swinging) else float(np.abs(self.poles).min()) / (2 * pi)

    def responses(self, frequencies_Hz: np.ndarray) -> np.ndarray:
        """(N, 4, 2) from force (N) and command (V) to `CHANNELS`."""
        values, vectors = np.linalg.eig(self.a)
        left, right = self.c @ vectors, np.linalg.solve(vectors, self.b.astype(complex))
        s = 2j * pi * np.asarray(frequencies_Hz)[:, None]
        residues = (left[:, None, :] * right.T[None, :, :]).reshape(8, -1)
        return ((1 / (s - values)) @ residues.T).reshape(-1, 4, 2) + self.d

    def driven(self, inputs: np.ndarray, step_s: float) -> np.ndarray:
        """(N, 4, 2) shares of force and of command in each of `CHANNELS`, from rest.

        Args:
            inputs: (N, 2) force and command, band-limited between samples.
            step_s: sampling interval.
        """
        count = len(inputs)
        padded = 2 * count
        shares = self.responses(np.fft.rfftfreq(padded, step_s))
        spectra = np.fft.rfft(inputs * faded(count)[:, None], padded, axis=0)
        return np.fft.irfft(shares * spectra[:, None, :], padded, axis=0)[:count]


def believed_loop(
    prototype: Prototype, controller: Controller, outer_end_mass: float, inner_end_mass: float
) -> BelievedLoop:
    """Close the loop around a prototype's linear plant, its effects left out.

    Args:
        prototype: believed.
        controller: of the record.
        outer_end_mass: payload, kg.
        inner_end_mass: kg.
    """
    plant = paper_model(prototype.but(effects={}))
    a, b, c = plant.matrices(outer_end_mass, inner_end_mass)
    force, current, volts = b[:, 0], b[:, 1], c[1]
    own, entering, leaving, straight = state_space(controller.equations, controller.figures())
    # What the law hears: error = command - volts, command, inner tip, load pressure.
    heard, commanded = np.vstack([-volts, 0 * volts, c[2], c[3]]), np.array([1.0, 1.0, 0.0, 0.0])
    closed = np.block([[a + np.outer(current, straight @ heard), np.outer(current, leaving)], [entering @ heard, own]])
    driven = np.zeros((len(closed), 2))
    driven[: len(a), 0] = force
    driven[:, 1] = np.concatenate([current * (straight @ commanded), entering @ commanded])
    seen, through = np.zeros((4, len(closed))), np.zeros((4, 2))
    seen[0], through[0, 1] = np.concatenate([straight @ heard, leaving]), straight @ commanded
    seen[1:, : len(a)] = volts / prototype.sensor.gain_V_per_m, c[3], c[2]
    return BelievedLoop(closed, driven, seen, through, np.linalg.eigvals(closed))


def loop_of(record: TimeRecord, prototype: Prototype) -> BelievedLoop:
    """The believed loop of a record."""
    return believed_loop(prototype, record.controller, record.outer_end_mass, record.inner_end_mass)


def expected(record: TimeRecord, prototype: Prototype) -> Mapping[str, np.ndarray] | None:
    """(N, 2) shares of force and command by channel of a record; None where the believed loop is unstable."""
    loop = loop_of(record, prototype)
    if not loop.stable:
        return None
    shares = loop.driven(record.inputs, record.step)
    return {name: shares[:, k] for k, name in enumerate(CHANNELS)}
