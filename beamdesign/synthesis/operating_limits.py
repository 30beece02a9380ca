"""What the actuator can do and the sensor can see: an envelope of load over frequency, and figures of the sensor.

A sinusoidal force on the outer tip, on top of a constant one, asks the cylinder for force, flow and stroke, and the
amplifier for current, as the linear loop has them. Each limit gives the largest amplitude of that force:

- force: the supply pressure on the smaller side, F_c <= p_S A (H. E. Merritt, Hydraulic Control Systems (1967),
  section 5-4: the stall load);
- valve flow: q <= K_q i_r sqrt(1 - p_L / p_S) at every instant, the load's locus inside the valve's parabola of flow
  over load pressure (Merritt, equation (5-22) and figure 5-5);
- current: i <= i_r, the rated current or the amplifier's limit;
- stroke: half the cylinder's, from its middle; clearance: half the play of one tube in the other;
- supply flow: q <= that of the supply, no accumulator assumed.

Limits whose figures the prototype does not give are left out and named.
"""

from dataclasses import dataclass
from math import inf, tau

import numpy as np

from beamdesign.loop import loop
from beamdesign.plant.effects import library
from beamdesign.plant.higher_modes import signals, single_compliance, with_mass
from beamdesign.prototype import Prototype
from beamdesign.structure import lumped
from beamdesign.structure.shapes import gaps

MARGIN = 1.25
"""On what the linear loop asks of flow, current and stroke, where it is said what to buy."""
_STATIC_HZ = 1e-4
_PHASES = 720
_LOWEST_HZ, _POINTS, _TURN = 0.01, 60, 360


@dataclass(frozen=True)
class Demand:
    """What a sinusoidal force on the outer tip asks for, per newton; complex, (N,) over frequency.

    Attributes:
        frequency_Hz: (N,).
        displacement: of the outer tip, m/N.
        force: of the cylinder, N/N.
        flow: through the valve, m3/s/N.
        current: A/N.
        stroke: of the piston in the cylinder, m/N.
    """

    frequency_Hz: np.ndarray
    displacement: np.ndarray
    force: np.ndarray
    flow: np.ndarray
    current: np.ndarray
    stroke: np.ndarray


@dataclass(frozen=True)
class Needs:
    """What a sinusoidal force of one amplitude on the tip takes, on top of a constant force either way.

    Attributes:
        force_N: of the cylinder.
        flow_m3_per_s: through the valve under load.
        no_load_flow_m3_per_s: that the valve must give without a load at the prototype's supply pressure; infinite
            where the load pressure reaches the supply's.
        current_A: that gives it, the spool's lag included.
        stroke_m: from the middle of the cylinder.
    """

    force_N: float
    flow_m3_per_s: float
    no_load_flow_m3_per_s: float
    current_A: float
    stroke_m: float


@dataclass(frozen=True)
class Envelope:
    """Largest load amplitude over frequency.

    Attributes:
        frequency_Hz: (N,).
        limits_N: by limit, (N,) amplitude of the force on the tip at which it is reached.
        displacement_m: (N,) of the tip at the envelope, by the linear loop.
        supply_power_W: (N,) mean hydraulic power drawn there, p_S times the mean flow.
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


def rated_current(prototype: Prototype) -> float | None:
    """Largest current, A: the valve's rated one or the amplifier's limit, whichever is less; None where neither is."""
    limits = [] if prototype.servovalve.rated_current_A is None else [prototype.servovalve.rated_current_A]
    for name in ("current_saturation", "current_saturation_soft"):
        if (given := prototype.effects.get(name)) is not None:
            parameter = library()[name].parameters[0]
            limits.append(given.get(parameter.name, parameter.default))
    return min(limits, default=None)


def smaller_side(prototype: Prototype) -> float:
    """Area of the smaller side of the piston, m2; the mean area where no `unequal_piston_areas` are given."""
    given = prototype.effects.get("unequal_piston_areas")
    parameter = library()["unequal_piston_areas"].parameters[0]
    asymmetry = 0.0 if given is None else abs(given.get(parameter.name, parameter.default))
    return prototype.actuator.piston_area_m2 * (1 - asymmetry)


def demand(prototype: Prototype, outer_end_mass: float, frequency_Hz: np.ndarray) -> Demand:
    """Response of the linear loop to a force on the tip, in everything the actuator has to give.

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
    # The flow that reaches the cylinder moves it and compresses the oil; the valve's leakage is lost.
    area = figure["piston_area"]
    flow = area * s * (force * (1 / figure["oil_stiffness"]) + stroke) + figure["leakage"] * force / area
    spool = s / figure["valve_frequency"]
    valve = 1 / (1 + 2 * figure["valve_damping_ratio"] * spool + spool**2)
    return Demand(np.asarray(frequency_Hz), x, force, flow, flow / (figure["flow_gain"] * valve), stroke)


def needs(
    prototype: Prototype, masses_kg: tuple[float, float], load_N: float, up_to_Hz: float, constant_N: float = 0.0
) -> Needs:
    """The largest of each over both ends and the middle of a payload range, of each law its own.

    Args:
        prototype: with a controller whose loop is stable at these masses.
        masses_kg: range of outer end mass.
        load_N: amplitude of the force on the tip.
        up_to_Hz: highest frequency of it.
        constant_N: force on the tip beside it, in either direction.
    """
    grid = np.geomspace(_LOWEST_HZ, max(up_to_Hz, 2 * _LOWEST_HZ), _POINTS)
    stall = prototype.supply.pressure_Pa * smaller_side(prototype)
    turn = np.exp(1j * tau * np.arange(_TURN) / _TURN)
    found = []
    for stage in prototype.stages(masses_kg):
        for mass in stage.looked_at_kg:
            asked = demand(stage.prototype, mass, grid)
            still = demand(stage.prototype, mass, np.array([_STATIC_HZ]))
            held = {name: constant_N * abs(float(getattr(still, name)[0].real)) for name in ("force", "flow", "stroke")}
            moved, force = (load_N * np.real(one[:, None] * turn) for one in (asked.flow, asked.force))
            # Orifice flow at a load pressure: q = q_0 sqrt(1 - p_L / p_S); asked the other way round for q_0.
            left = 1 - (np.sign(moved) * force + held["force"]) / stall
            through = np.abs(moved) + held["flow"]
            through = np.where(left > 0, through / np.sqrt(np.maximum(left, 1e-12)), np.inf).max(axis=1)
            per_flow = np.abs(asked.current) / np.maximum(np.abs(asked.flow), 1e-300)
            most = {name: held[name] + load_N * float(np.abs(getattr(asked, name)).max()) for name in held}
            spool = float(through.max()), float((through * per_flow).max())
            found.append((most["force"], most["flow"], *spool, most["stroke"]))
    return Needs(*map(max, zip(*found, strict=True)))


def envelope(
    prototype: Prototype, outer_end_mass: float = 0.0, preload: float = 0.0, frequency_Hz: np.ndarray | None = None
) -> Envelope:
    """Largest amplitude of a sinusoidal force on the tip that every limit of the actuator allows.

    Args:
        prototype: rig with a controller; its `unequal_piston_areas` and `current_saturation` are heeded.
        outer_end_mass: payload, kg.
        preload: constant force on the tip, N.
        frequency_Hz: (N,); 0.1 to 200 Hz by default.
    """
    grid = np.geomspace(0.1, 200.0, 161) if frequency_Hz is None else np.asarray(frequency_Hz, dtype=float)
    if prototype.controller is None or not loop(prototype.but(effects={})).at(outer_end_mass).stable:
        nothing = np.zeros(len(grid))
        why = "no controller" if prototype.controller is None else f"not stable with {outer_end_mass:g} kg"
        return Envelope(grid, {}, nothing, nothing, {}, why)
    asked, still = demand(prototype, outer_end_mass, grid), demand(prototype, outer_end_mass, np.array([_STATIC_HZ]))
    held = {name: preload * float(getattr(still, name)[0].real) for name in ("force", "current", "stroke", "flow")}
    supply, area = prototype.supply.pressure_Pa, smaller_side(prototype)

    limits = {"force": _left(supply * area, held["force"], asked.force)}
    missing: dict[str, str] = {}
    rated = rated_current(prototype)
    if rated is None:
        missing["valve flow"] = missing["current"] = "servovalve.rated_current_A"
    else:
        largest = prototype.servovalve.flow_gain_m3_per_s_per_A * rated
        limits["valve flow"] = _within_parabola(asked, held, largest, supply * area)
        limits["current"] = _left(rated, held["current"], asked.current)
    if (stroke := prototype.actuator.stroke_m) is None:
        missing["stroke"] = "actuator.stroke_m"
    else:
        limits["stroke"] = _left(stroke / 2, held["stroke"], asked.stroke)
    if (play := _clearance(prototype)) is None:
        missing["clearance"] = "width_m and wall_m of both beams"
    else:
        limits["clearance"] = _left(play, held["stroke"], asked.stroke)
    if (flow := prototype.supply.flow_m3_per_s) is None:
        missing["supply flow"] = "supply.flow_m3_per_s"
    else:
        limits["supply flow"] = _left(flow, held["flow"], asked.flow)
    load = np.min(list(limits.values()), axis=0)
    power = supply * (2 / np.pi) * load * np.abs(asked.flow)
    return Envelope(grid, limits, load * np.abs(asked.displacement), power, missing)


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
    rated = rated_current(prototype)
    return SensorReach(
        error, sensor.resolution_m, hidden, sensor.noise_V / sensor.gain_V_per_m, fast * sensor.noise_V,
        None if rated is None else fast * sensor.noise_V / rated,
    )  # fmt: skip


def _left(limit: float, held: float, asked: np.ndarray) -> np.ndarray:
    """Amplitude at which what is asked reaches a limit of which a constant part is used up."""
    return np.asarray(max(limit - abs(held), 0.0) / np.abs(asked))


def _within_parabola(asked: Demand, held: dict[str, float], largest: float, stall: float) -> np.ndarray:
    """Largest F with |q| <= q_max sqrt(1 - sign(q) F_c / stall) at every phase, q and F_c being F times their sines.

    At each phase it is the positive root of q^2 F^2 + q_max^2 (f / stall) F - q_max^2 (1 - held / stall) = 0.
    """
    turn = np.exp(1j * tau * np.arange(_PHASES) / _PHASES)
    flow, force = (np.real(one[:, None] * turn) for one in (asked.flow, asked.force))
    sign = np.sign(flow)
    slope = largest**2 * sign * force / stall
    rest = largest**2 * (1 - sign * held["force"] / stall)
    root = np.sqrt(np.maximum(slope**2 + 4 * flow**2 * rest, 0.0))
    # The stable form of the root, whichever sign the slope has.
    amplitude = 2 * np.maximum(rest, 0.0) / np.maximum(slope + root, 1e-300)
    return np.asarray(amplitude.min(axis=1))


def _clearance(prototype: Prototype) -> float | None:
    """Play per side along the load, m; None where a section is not known."""
    found = gaps(prototype.outer_beam, prototype.inner_beam)
    return None if found is None else found[0]
