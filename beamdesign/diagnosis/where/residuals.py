"""Records against the tuned nominal model, and the local variables of its equations behind each.

The linear rig stands in its loop with an unknown signal let in at any port: a missing law is an unknown signal at the
port where it should act.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property, partial
from math import inf
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from beamdesign.diagnosis.fitting.evidence import RecordEvidence
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, Placement
from beamdesign.diagnosis.fitting.replay import Replay
from beamdesign.diagnosis.fitting.weighting import padded
from beamdesign.plant.assembly import RIGS, Structure, join
from beamdesign.plant.component import Signals
from beamdesign.plant.effects import SUBSYSTEMS, Effect, Parameter, Site, library
from beamdesign.plant.equilibrium import StateSpace, equilibrium
from beamdesign.time_limit import heed


@dataclass(frozen=True)
class Entry:
    """A way in for an unknown signal.

    Attributes:
        own: largest variable of the equation behind it, in the unit of what may be missing there.
        ports: where the signal is added: port, and how often it is differentiated first.
    """

    own: str
    ports: tuple[tuple[str, int], ...]


ENTRIES = {
    "amplifier": Entry("current_A", (("current_A", 0),)),
    "spool": Entry("current_A", (("spool_A", 0),)),
    "drive": Entry("motor_demand_A", (("motor_demand_A", 0),)),
    "oil continuity": Entry("metered_m3_per_s", (("linear_a_m3_per_s", 0), ("linear_b_m3_per_s", 0))),
    "piston force": Entry("actuator_force_N", (("friction_N", 0),)),
    "outer beam": Entry("outer_reaction_N", (("outer_reaction_N", 0),)),
    "inner beam": Entry("inner_reaction_N", (("inner_reaction_N", 0),)),
    "mount": Entry("outer_m", (("mount_m", 0), ("mount_m_per_s", 1))),
    "joint": Entry("outer_m", (("rod_m_per_s", 1),)),
    "sensor": Entry("sensor_V", (("sensor_V", 0),)),
}
"""Equations of rigs and where what they lack comes in."""


class Places(NamedTuple):
    """Where to look at a rig, and to add something to it.

    Attributes:
        entries: those of `ENTRIES` that it has.
        probed: ports that these are at.
        signals: local variables: signals of ports, and what is recorded of them.
    """

    entries: Mapping[str, Entry]
    probed: tuple[str, ...]
    signals: tuple[str, ...]


@cache
def places(rig: str) -> Places:
    """Those of one of `beamdesign.plant.assembly.RIGS` with two beams."""
    ports = RIGS[rig].ports
    own = {name: entry for name, entry in ENTRIES.items() if all(port in ports for port, _ in entry.ports)}
    local = [name for name in ports if not name.startswith(("area_", "bulk_", "chamber_", "supply_", "tank_"))]
    probed = dict.fromkeys(port for entry in own.values() for port, _ in entry.ports)
    return Places(own, tuple(probed), (*local, "displacement_m", "inner_m", "outer_m"))


@dataclass(frozen=True)
class Probe:
    """Linear responses of one rig in its loop, on the grid of a record padded to about twice its length.

    Attributes:
        count: samples of a record.
        laplace: (F,) s on the imaginary axis.
        response: (F, S, 2 + W) from disturbance, command and the signals at probed ports to the rig's signals.
        at: places of the rig.
    """

    count: int
    laplace: np.ndarray = field(repr=False)
    response: np.ndarray = field(repr=False)
    at: Places = field(repr=False)

    def rows(self, signals: Sequence[str]) -> list[int]:
        """Places of signals in the response."""
        return [self.at.signals.index(name) for name in signals]

    def entry(self, name: str, signals: Sequence[str]) -> np.ndarray:
        """(F, len(signals)) from an unknown signal at an entry."""
        rows, s = self.rows(signals), self.laplace
        total = np.zeros((len(s), len(rows)), dtype=complex)
        for port, order in self.at.entries[name].ports:
            total += self.response[:, rows, 2 + self.at.probed.index(port)] * (s**order)[:, None]
        return total

    def spectrum(self, signals: np.ndarray) -> np.ndarray:
        """Spectra of (N, ...) signals padded with zeros to twice their length or more."""
        return np.fft.rfft(signals, padded(2 * self.count), axis=0)

    def signal(self, spectra: np.ndarray) -> np.ndarray:
        """(N, ...) from spectra, the padding cut off."""
        return np.fft.irfft(spectra, padded(2 * self.count), axis=0)[: self.count]


def probe(job: Replay, placement: Placement, z: np.ndarray) -> Probe:
    """Linearise the rig of a record at rest, with the unknowns at z.

    Args:
        job: the record.
        placement: of a hypothesis without effects.
        z: of its unknowns.

    Raises:
        ValueError: where the rig has no equilibrium.
    """
    placed, parameters = job.placed(placement), job.parameters(placement, z)
    x = equilibrium(placed.assembly, np.zeros(3), parameters)
    at = places(placed.assembly.kinds.rig)
    loop = StateSpace(*map(np.asarray, _linear(placed.assembly.kinds)(x, np.zeros(2 + len(at.probed)), parameters)))
    count = len(job.record.times)
    s = 2j * np.pi * np.fft.rfftfreq(padded(2 * count), job.record.step)
    s[0] = 1e-3 * s[1]  # at rest itself a memory, or the mean pressure of a valve without leakage, may be anything
    return Probe(count, s, loop.at(s), at)


@cache
def _linear(kinds: Structure) -> ca.Function:
    """States, inputs (disturbance, command, probed ports) and parameters to A, B, C, D."""
    at, recorded = places(kinds.rig), RIGS[kinds.rig].outputs
    let_in = {name: partial(_with_unknown, name) for name in at.probed}
    sizes = tuple(Parameter(name, 0.0, -inf, inf, 1.0, "what is missing") for name in at.probed)
    unknown = Effect("unknown", SUBSYSTEMS[0], let_in, sizes, "Sets the rig's equations free.")
    seen = {name: recorded.get(name) or partial(_signal, name) for name in at.signals}
    assembly = join(kinds, (*(library()[name] for name in kinds.effects), unknown), seen)
    x, p = ca.SX.sym("x", len(assembly.states)), ca.SX.sym("p", len(assembly.parameters) - len(at.probed))
    u = ca.SX.sym("u", 2 + len(at.probed))
    found = assembly.function(0.0, x, ca.vertcat(u[:2], 0.0), ca.vertcat(p, u[2:]))
    matrices = [ca.densify(ca.jacobian(value, of)) for value in found for of in (x, u)]
    return ca.Function("linear", [x, u, p], matrices)


def _with_unknown(name: str, signal: Any, site: Site) -> Any:
    return signal + site.parameter[name]


def _signal(name: str, port: Signals, figure: Signals, state: Signals) -> Any:
    return port[name]


_DOUBT = 0.3
_LEAST_NOISE = 1e-6  # of what a channel holds
_HALF_BAND = 2 ** (1 / 4)


@dataclass(frozen=True)
class Residual:
    """One record against the tuned nominal model.

    Attributes:
        evidence: the record.
        probe: its linear rig.
        channels: recorded ones, as signals of the probe.
        left: (N, C) measured less predicted.
        slopes: (N, C, K) of the prediction by the tolerated figures.
    """

    evidence: RecordEvidence
    probe: Probe
    channels: tuple[str, ...]
    left: np.ndarray = field(repr=False)
    slopes: np.ndarray = field(repr=False)

    def smoothed(self) -> dict[str, np.ndarray]:
        """(N,) local variables, most probable after the record: every equation may lack something, alike for its size.

        The unknown signals of all entries are independent, each with the spectrum of its equation's own variable times
        `_DOUBT` squared; the channels carry their noise. So no equation is favoured, and what one lacks does not
        explain itself through variables that were made from it.
        """
        weight, probed, nominal = self.evidence.weight, self.probe, self._driven
        spectra = probed.spectrum(self.left * weight.fade[:, None])
        rms = np.sqrt(np.mean(self.evidence.measured**2, axis=0))
        noise = np.maximum(weight.noise_std, _LEAST_NOISE * rms + 1e-30) ** 2 * len(self.left)
        gain = np.zeros((len(nominal), len(probed.at.signals), len(self.channels)), dtype=complex)
        spread = np.zeros((len(nominal), len(self.channels), len(self.channels)), dtype=complex)
        spread[:, range(len(noise)), range(len(noise))] = noise
        for name, entry in probed.at.entries.items():
            power = _DOUBT**2 * banded(np.abs(nominal[:, probed.rows([entry.own])[0]]) ** 2)
            through = probed.entry(name, probed.at.signals)
            seen = through[:, probed.rows(self.channels)]
            weighed = power[:, None] * seen.conj()
            gain += through[:, :, None] * weighed[:, None, :]
            spread += seen[:, :, None] * weighed[:, None, :]
        moved = np.einsum("fsc,fc->fs", gain, np.linalg.solve(spread, spectra[:, :, None])[:, :, 0])
        return self._signals(nominal + moved)

    @cached_property
    def nominal(self) -> dict[str, np.ndarray]:
        """(N,) local variables of the nominal model."""
        return self._signals(self._driven)

    @cached_property
    def _driven(self) -> np.ndarray:
        """(F, S) spectra of all signals under the inputs of the record."""
        spectra = self.probe.spectrum(self.evidence.record.inputs)
        return np.asarray(np.einsum("fsi,fi->fs", self.probe.response[:, :, :2], spectra))

    def _signals(self, spectra: np.ndarray) -> dict[str, np.ndarray]:
        probed = self.probe
        found = dict(zip(probed.at.signals, probed.signal(spectra).T, strict=True))
        if "load_pressure_Pa" in found:
            pressure = spectra[:, probed.rows(["load_pressure_Pa"])[0]]
            found["pressure_rate_Pa_per_s"] = probed.signal(pressure * probed.laplace)
        found["stroke_m"] = found["outer_m"] - found["inner_m"]
        return found


def banded(power: np.ndarray) -> np.ndarray:
    """Mean power about each line, over half an octave."""
    lines = np.arange(len(power))
    low = np.floor(lines / _HALF_BAND).astype(int)
    high = np.minimum(np.ceil(lines * _HALF_BAND).astype(int) + 1, len(power))
    total = np.concatenate([[0.0], np.cumsum(power)])
    return np.asarray((total[high] - total[low]) / (high - low))


def residuals(null: Fit, evidence: Sequence[object]) -> tuple[Residual, ...]:
    """Every record against the model with tuned tolerances."""
    found = []
    probes: dict[object, Probe] = {}
    for piece in evidence:
        if not isinstance(piece, RecordEvidence):
            continue
        heed()
        placement = NOTHING.placement(piece.job.prototype)
        if (made := piece.job.simulated_with_slopes(placement, null.z, piece.weight.channels)) is None:
            continue
        predicted, slopes = made
        channels = tuple("inner_m" if c == "inner_displacement_m" else c for c in piece.weight.channels)
        taken = piece.record
        key = (taken.masses, taken.controller, len(taken.times), taken.step)
        if key not in probes:
            probes[key] = probe(piece.job, placement, null.z)
        found.append(Residual(piece, probes[key], channels, piece.measured - predicted, slopes))
    return tuple(found)
