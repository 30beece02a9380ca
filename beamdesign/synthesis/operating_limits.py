"""What the actuator can do and the sensor can see: an envelope of load over frequency, and figures of the sensor.

A sinusoidal force on the outer tip, on top of a constant one, asks the actuator for force and stroke and whatever gives
these, and the amplifier for current, as the linear loop has them. Each limit gives the largest amplitude of that force:
those of the actuator (`Actuator.limits`), half its stroke, from the middle, and half the play of one tube in the other.

Limits whose figures the prototype does not give are left out and named.
"""

from dataclasses import dataclass
from math import inf, tau

import numpy as np

from beamdesign.loop import loop
from beamdesign.plant.actuators import Demand, Limit
from beamdesign.plant.linear_reach import signals, single_compliance, with_mass
from beamdesign.prototype import Prototype
from beamdesign.structure import lumped
from beamdesign.structure.shapes import gaps

_STATIC_HZ = 1e-4
_LOWEST_HZ, _POINTS = 0.01, 60


@dataclass(frozen=True)
class Envelope:
    """Largest load amplitude over frequency.

    Attributes:
        frequency_Hz: (N,).
        limits_N: by limit, (N,) amplitude of the force on the tip at which it is reached.
        displacement_m: (N,) of the tip at the envelope, by the linear loop.
        supply_power_W: (N,) mean power drawn there.
        missing: what the prototype does not give, by the limit that is left out.
        reason: why there is no envelope; empty where there is one.
    """

    frequency_Hz: np.ndarray
    limits_N: dict[str, np.ndarray]
    displacement_m: np.ndarray
    supply_power_W: np.ndarray
    missing: dict[str, str]
    reason: str = ""

    @property
    def load_N(self) -> np.ndarray:
        """(N,) the least of all limits."""
        return np.asarray(np.min(list(self.limits_N.values()), axis=0))

    @property
    def governing(self) -> tuple[str, ...]:
        """Name of the limit that is least, at each frequency."""
        names = list(self.limits_N)
        return tuple(names[k] for k in np.argmin(list(self.limits_N.values()), axis=0))


@dataclass(frozen=True)
class SensorReach:
    """What the sensor's noise and resolution leave of the loop's precision.

    Attributes:
        static_error_m_per_N: of the loop.
        resolution_m: least displacement that is told; None where the prototype does not say.
        hidden_N: largest constant force whose static error is below the resolution.
        noise_m: RMS displacement that the noise stands for, and that the loop follows at low frequency.
        current_noise_A: RMS current that noise beyond the loop's frequencies drives, at the controller's gain there.
        rated_share: of that in the rated current.
    """

    static_error_m_per_N: float
    resolution_m: float | None = None
    hidden_N: float | None = None
    noise_m: float | None = None
    current_noise_A: float | None = None
    rated_share: float | None = None


def demand(prototype: Prototype, outer_end_mass: float, frequency_Hz: np.ndarray) -> Demand:
    """Response of the linear loop to a force on the tip, in everything the actuator has to give.

    Its travel is what stroke and force ask: c_a being its compliance and T its travel per current, i = (x + c_a F) / T.

    Args:
        prototype: rig with a controller.
        outer_end_mass: payload, kg.
        frequency_Hz: (N,).
    """
    figure = lumped.figures(prototype)
    s = 1j * tau * np.asarray(frequency_Hz, dtype=float)
    outer = with_mass(single_compliance(prototype, "outer_beam"), outer_end_mass)
    inner = with_mass(single_compliance(prototype, "inner_beam"), prototype.payload.inner_end_mass_kg)
    rig = signals(prototype, outer, inner, frequency_Hz)
    assert prototype.controller is not None
    x = rig.closed(prototype.controller.gain_A_per_V)
    force = x / outer(frequency_Hz) - 1  # the tip is at c_o (F_c + F_d)
    stroke = x + inner(frequency_Hz) * force
    actuator = prototype.actuator
    current = (stroke + actuator.compliance(figure, s) * force) / actuator.travel(figure, s)
    return Demand(np.asarray(frequency_Hz), x, force, stroke, current, actuator.signals(figure, s, force, stroke))


def _held(prototype: Prototype, outer_end_mass: float, force_N: float) -> dict[str, float]:
    """What a constant force on the tip takes of all that is demanded."""
    still = demand(prototype, outer_end_mass, np.array([_STATIC_HZ]))
    names = ("force", "current", "stroke", *still.more)
    return {name: force_N * float(still.of(name)[0].real) for name in names}


def needs(
    prototype: Prototype, masses_kg: tuple[float, float], load_N: float, up_to_Hz: float, constant_N: float = 0.0
) -> dict[str, float]:
    """The largest of each over both ends and the middle of a payload range, of each law its own.

    Args:
        prototype: with a controller whose loop is stable at these masses.
        masses_kg: range of outer end mass.
        load_N: amplitude of the force on the tip.
        up_to_Hz: highest frequency of it.
        constant_N: force on the tip beside it, in either direction.

    Returns:
        force_N of the actuator, stroke_m from its middle, and what it takes beside these (`Actuator.takes`).
    """
    grid = np.geomspace(_LOWEST_HZ, max(up_to_Hz, 2 * _LOWEST_HZ), _POINTS)
    found: dict[str, float] = {}
    for stage in prototype.stages(masses_kg):
        for mass in stage.looked_at_kg:
            asked, held = demand(stage.prototype, mass, grid), _held(stage.prototype, mass, constant_N)
            taken = {
                key: abs(held[name]) + load_N * float(np.abs(asked.of(name)).max())
                for key, name in (("force_N", "force"), ("stroke_m", "stroke"))
            } | stage.prototype.actuator.takes(stage.prototype, asked, load_N, held)
            found = {key: max(value, found.get(key, 0.0)) for key, value in taken.items()}
    return found


def envelope(
    prototype: Prototype, outer_end_mass: float = 0.0, preload: float = 0.0, frequency_Hz: np.ndarray | None = None
) -> Envelope:
    """Largest amplitude of a sinusoidal force on the tip that every limit of the actuator allows.

    Args:
        prototype: rig with a controller; its actuator heeds some of its effects.
        outer_end_mass: payload, kg.
        preload: constant force on the tip, N.
        frequency_Hz: (N,); 0.1 to 200 Hz by default.
    """
    grid = np.geomspace(0.1, 200.0, 161) if frequency_Hz is None else np.asarray(frequency_Hz, dtype=float)
    nothing = np.zeros(len(grid))
    if prototype.controller is None or not loop(prototype.but(effects={})).at(outer_end_mass).stable:
        why = "no controller" if prototype.controller is None else f"not stable with {outer_end_mass:g} kg"
        return Envelope(grid, {}, nothing, nothing, {}, why)
    asked, held = demand(prototype, outer_end_mass, grid), _held(prototype, outer_end_mass, preload)
    actuator = prototype.actuator
    half = None if actuator.stroke_m is None else actuator.stroke_m / 2
    play = gaps(prototype.outer_beam, prototype.inner_beam)  # per side, that along the load first
    every = (
        *actuator.limits(prototype),
        Limit("stroke", "stroke", half, "actuator.stroke_m"),
        Limit("clearance", "stroke", play[0] if play else None, "width_m and wall_m of both beams"),
    )
    missing = {limit.name: limit.place for limit in every if limit.most is None}
    limits = {limit.name: limit.amplitude(asked, held) for limit in every if limit.most is not None}
    if not limits:
        return Envelope(grid, {}, nothing, nothing, missing, "the prototype states no limit of its actuator")
    load = np.min(list(limits.values()), axis=0)
    return Envelope(grid, limits, load * np.abs(asked.displacement), actuator.power_W(prototype, asked, load), missing)


def sensor_reach(prototype: Prototype, outer_end_mass: float = 0.0) -> SensorReach:
    """Static error of the loop beside the sensor's resolution, and what its noise does.

    Raises:
        ValueError: without a controller.
    """
    error = abs(loop(prototype.but(effects={})).at(outer_end_mass).static_compliance())
    sensor, law = prototype.sensor, prototype.controller
    assert law is not None
    hidden = None if sensor.resolution_m is None else (sensor.resolution_m / error if error > 0 else inf)
    if sensor.noise_V is None:
        return SensorReach(error, sensor.resolution_m, hidden)
    fast = law.gain_at_high_frequency()
    rated = prototype.actuator.largest_current_A(prototype)
    return SensorReach(
        error, sensor.resolution_m, hidden, sensor.noise_V / sensor.gain_V_per_m, fast * sensor.noise_V,
        None if rated is None else fast * sensor.noise_V / rated,
    )  # fmt: skip
