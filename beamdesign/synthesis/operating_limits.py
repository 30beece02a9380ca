"""What actuator, sensor and linear model bear: how far a prototype can be trusted at one payload.

A sinusoidal force on the outer tip, on top of a constant one, asks the actuator for force and stroke and whatever gives
these, and the amplifier for current, as the linear loop has them. Each limit gives the largest amplitude of that force:
those of the actuator (`Actuator.limits`), half its stroke, from the middle, half the play of one tube in the other, and
what bends the inner tube until it yields.

Limits whose figures the prototype does not give are left out and named.
"""

from dataclasses import dataclass
from math import inf, tau
from typing import Any

import numpy as np

from beamdesign.arguments import checked, checked_mass_kg, takes
from beamdesign.loop import loop
from beamdesign.plant.actuators import Demand, Limit
from beamdesign.plant.assembly import fits, pace
from beamdesign.plant.limit_cycles import cycles_about_own
from beamdesign.plant.linear_reach import (
    SingleModeReach,
    Varied,
    linear_part,
    reach,
    signals,
    single_compliance,
    single_mode_reach,
    with_mass,
    with_published_effects,
)
from beamdesign.plant.members import bearable_travel_m, own_sag_m, weight_N
from beamdesign.progress import Progress, silent
from beamdesign.proofs.certifying import stability_over
from beamdesign.prototype import Prototype
from beamdesign.quantities import SignedForce, read_in
from beamdesign.records import InputError
from beamdesign.result import Result, finite, picked
from beamdesign.structure import lumped
from beamdesign.structure.shapes import gaps

_STATIC_HZ, _LOWEST_HZ, _POINTS = 1e-4, 0.01, 60


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
        stable: whether the loop is, without which nothing has limits.
    """

    frequency_Hz: np.ndarray
    limits_N: dict[str, np.ndarray]
    displacement_m: np.ndarray
    supply_power_W: np.ndarray
    missing: dict[str, str]
    reason: str = ""
    stable: bool = True

    @property
    def load_N(self) -> np.ndarray:
        """(N,) the least of all limits; infinite without any."""
        return np.min([np.full(len(self.frequency_Hz), inf), *self.limits_N.values()], axis=0)

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
    figure, actuator = lumped.figures(prototype), prototype.actuator
    s = 1j * tau * np.asarray(frequency_Hz, dtype=float)
    outer = with_mass(single_compliance(prototype, "outer_beam"), outer_end_mass)
    inner = with_mass(single_compliance(prototype, "inner_beam"), prototype.payload.inner_end_mass_kg)
    rig = signals(prototype, outer, inner, frequency_Hz)
    x = rig.closed(prototype.own_controller.gain_A_per_V)
    force = x / outer(frequency_Hz) - 1  # the tip is at c_o (F_c + F_d)
    stroke = x + inner(frequency_Hz) * force
    current = (stroke + actuator.compliance(figure, s) * force) / actuator.travel(figure, s)
    found = {"displacement": x, "force": force, "stroke": stroke, "current": current}
    return found | actuator.signals(figure, s, force, stroke)


def grid_Hz(prototype: Prototype, outer_end_mass: float, low_Hz: float, high_Hz: float, points: int) -> np.ndarray:
    """Frequencies for `demand`, which is without effects; see `LoopAtMass.grid_Hz`."""
    return loop(prototype.but(effects={})).at(outer_end_mass).grid_Hz(low_Hz, high_Hz, points)


def _held(prototype: Prototype, outer_end_mass: float, force_N: float) -> dict[str, float]:
    """What a constant force on the tip takes of all that is demanded."""
    still = demand(prototype, outer_end_mass, np.array([_STATIC_HZ]))
    return {name: force_N * float(one[0].real) for name, one in still.items()}


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
    found: dict[str, float] = {}
    for stage in prototype.stages(masses_kg):
        for mass in stage.looked_at_kg:
            grid = grid_Hz(stage.prototype, mass, _LOWEST_HZ, max(up_to_Hz, 2 * _LOWEST_HZ), _POINTS)
            asked, held = demand(stage.prototype, mass, grid), _held(stage.prototype, mass, constant_N)
            taken = {
                key: abs(held[name]) + load_N * float(np.abs(asked[name]).max())
                for key, name in (("force_N", "force"), ("stroke_m", "stroke"))
            } | stage.prototype.actuator.takes(stage.prototype, asked, load_N, held)
            found = {key: max(value, found.get(key, 0.0)) for key, value in taken.items()}
    return found


def needs_to_carry(
    prototype: Prototype, masses_kg: tuple[float, float], load_N: float, up_to_Hz: float
) -> dict[str, float]:
    """What a load takes that is put on and taken off up to a frequency, beside the weight of payload and link.

    Half of such a load is constant, half of it alternates. The stroke is that of the inner beam under its own weight
    too. Arguments and figures are those of `needs`.
    """
    need = needs(prototype, masses_kg, load_N / 2, up_to_Hz, weight_N(prototype, masses_kg[1]) + load_N / 2)
    return need | {"stroke_m": need["stroke_m"] + own_sag_m(prototype)}


def envelope(
    prototype: Prototype, outer_end_mass: float = 0.0, preload: float = 0.0, frequency_Hz: np.ndarray | None = None
) -> Envelope:
    """Largest amplitude of a sinusoidal force on the tip that every limit of the actuator allows.

    Of stroke, clearance and strength is left what the inner beam does not sag by itself, as of a link that lies level.

    Args:
        prototype: rig with a controller; its actuator heeds some of its effects.
        outer_end_mass: payload, kg.
        preload: constant force on the tip, N.
        frequency_Hz: (N,); by default 0.1 to 200 Hz, times `pace`, with every resonance between.
    """
    grid = np.asarray([] if frequency_Hz is None else frequency_Hz, dtype=float)
    kg, controller = outer_end_mass, prototype.controller
    if controller is None or not stability_over(prototype, kg, kg, as_far=True).stable:
        why = "no controller" if controller is None else f"not stable with {kg:g} kg"
        return Envelope(grid, {}, 0 * grid, 0 * grid, {}, why, stable=False)
    if frequency_Hz is None:
        shown = pace(lumped.figures(prototype)) * SHOWN_HZ
        grid = grid_Hz(prototype, outer_end_mass, shown[0], 2 * shown[-1], 161)
    asked, held = demand(prototype, outer_end_mass, grid), _held(prototype, outer_end_mass, preload)
    held["stroke"] = abs(held["stroke"]) + own_sag_m(prototype)
    actuator = prototype.actuator
    half = None if actuator.stroke_m is None else actuator.stroke_m / 2
    play = gaps(prototype.outer_beam, prototype.inner_beam)  # per side, that along the load first
    every = (
        *actuator.limits(prototype),
        Limit("stroke", "stroke", half, "actuator.stroke_m"),
        Limit("clearance", "stroke", play[0] if play else None, "width_m and wall_m of both beams"),
        Limit("inner tube's strength", "stroke", bearable_travel_m(prototype), "width_m and wall_m of the inner beam"),
    )
    missing = {limit.name: limit.place for limit in every if limit.most is None}
    limits = {limit.name: limit.amplitude(asked, held) for limit in every if limit.most is not None}
    if not limits:
        return Envelope(grid, {}, 0 * grid, 0 * grid, missing, "the prototype states no limit of its actuator")
    load = np.min(list(limits.values()), axis=0)
    moved = load * np.abs(asked["displacement"])
    return Envelope(grid, limits, moved, actuator.power_W(prototype, asked, load), missing)


def sensor_reach(prototype: Prototype, outer_end_mass: float = 0.0) -> SensorReach:
    """Static error of the loop beside the sensor's resolution, and what its noise does.

    Raises:
        ValueError: without a controller.
    """
    error = abs(loop(linear_part(prototype)).at(outer_end_mass).static_compliance())
    sensor = prototype.sensor
    hidden = None if sensor.resolution_m is None else (sensor.resolution_m / error if error > 0 else inf)
    if sensor.noise_V is None:
        return SensorReach(error, sensor.resolution_m, hidden)
    fast = prototype.own_controller.gain_at_high_frequency()
    rated = prototype.actuator.largest_current_A(prototype)
    return SensorReach(
        error, sensor.resolution_m, hidden, sensor.noise_V / sensor.gain_V_per_m, fast * sensor.noise_V,
        None if rated is None else fast * sensor.noise_V / rated,
    )  # fmt: skip


SHOWN_HZ = np.array([0.1, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0])  # of a rig as quick as the published one
LINEAR_HZ = (1.0, 10.0, 50.0)  # likewise
AMPLITUDES_M = (1e-6, 1e-5, 1e-4, 3e-4, 1e-3)


@dataclass(frozen=True, repr=False)
class Limits(Result):
    """What actuator, sensor and linear model bear; of a loop that is not stable nothing but why.

    Attributes:
        prototype: with one law.
        outer_end_mass_kg: at which all is worked out.
        preload_N: constant force on the outer tip under the actuator's envelope.
        envelope: largest load of the actuator over frequency.
        sensor: what it hides.
        modes: reach of one bending mode per beam; why it is not looked at, in words, where it cannot be.
        linear_amplitude: per quantity varied and frequency, up to where the linear model's amplitude holds; likewise.
        limit_cycles: by amplitude, gains at which the nonlinear loop oscillates by itself: on the curve below its own,
            where it is not stable at every lower one, then on that above.
    """

    prototype: Prototype
    outer_end_mass_kg: float
    preload_N: float
    envelope: Envelope
    sensor: SensorReach | None = None
    modes: SingleModeReach | str = ""
    linear_amplitude: tuple[dict[str, Any], ...] | str = ()
    limit_cycles: tuple[dict[str, Any], ...] = ()

    @property
    def left_aside(self) -> tuple[str, ...]:
        """Linear effects that the loop is judged with, but envelope and modes are worked out without."""
        return tuple(linear_part(self.prototype).effects)

    @property
    def reason(self) -> str:
        """Why there are none; empty where there are."""
        return "" if self.envelope.stable else self.envelope.reason

    def to_dict(self) -> dict[str, Any]:
        """What `beamdesign limits` writes of them."""
        fields = picked(self, "outer_end_mass_kg preload_N") | {"stable": self.yes}
        if self.reason:
            return finite(fields | {"reason": self.reason})
        shown = "frequency_Hz load_N governing limits_N displacement_m supply_power_W missing"
        bears, modes, reach = self.envelope, self.modes, self.linear_amplitude
        rows = [] if isinstance(reach, str) else [{k: row[k] for k in row if k != "words"} for row in reach]
        fields |= {
            "actuator": {"reason": bears.reason, "missing": bears.missing} if bears.reason else picked(bears, shown),
            "left_aside": self.left_aside,
            "sensor": self.sensor,
            "modes": {"reason": modes} if isinstance(modes, str) else vars(modes) | picked(modes, "gain_margin_eaten"),
            "linear_amplitude": {"reason": reach} if isinstance(reach, str) else rows,
            "limit_cycles": self.limit_cycles,
        }
        return finite(fields)

    def rows(self) -> list[tuple[Any, ...]]:
        """Over frequency in Hz: largest force, N; what governs it; how far the tip moves, um; mean power, W."""
        found = self.envelope
        if found.reason:
            return []
        shown = pace(lumped.figures(self.prototype)) * SHOWN_HZ
        near = [int(np.argmin(np.abs(np.log(found.frequency_Hz / one)))) for one in shown]
        columns = found.frequency_Hz, found.load_N, found.governing, 1e6 * found.displacement_m, found.supply_power_W
        return [tuple(of[k] if isinstance(of[k], str) else float(of[k]) for of in columns) for k in near]

    def mode_rows(self) -> list[tuple[str, float]]:
        """How far one bending mode per beam reaches."""
        found = self.modes
        if isinstance(found, str):
            return []
        gain = self.prototype.own_controller.gain_A_per_V
        (unit, factor), oscillates = read_in(gain, "A/V"), gain >= found.critical_gain_all_A_per_V
        return [
            ("outer beam's tip compliance within 10 % up to, Hz", found.outer_Hz),
            ("inner beam's", found.inner_Hz),
            ("closed-loop compliance within 10 % up to, Hz", found.closed_loop_Hz),
            ("second mode, outer beam, Hz", found.outer_modes_Hz[1]),
            ("second mode, inner beam, Hz", found.inner_modes_Hz[1]),
            (f"critical gain with one mode per beam, {unit}", factor * found.critical_gain_A_per_V),
            (f"with all modes, {unit}", factor * found.critical_gain_all_A_per_V),
            ("of the critical gain taken by them, %", 100 * found.gain_margin_eaten),
            (f"its own gain{', at which it oscillates by them' * oscillates}, {unit}", factor * gain),
        ]

    def linear_rows(self) -> list[tuple[str, float, float | str, float]]:
        """What is varied, at what frequency in Hz, up to where, and how far off the model is there in per cent."""
        rows = []
        for row in () if isinstance(self.linear_amplitude, str) else self.linear_amplitude:
            limit = row["limit"] if row["reached"] else f"more than {row['limit']:.4g}"
            rows.append((row["words"], row["frequency_Hz"], limit, 100 * row["departure"]))
        return rows

    def cycle_rows(self) -> list[tuple[float, float, float, str]]:
        """Amplitude in um, gain in the unit of the prototype's, frequency in Hz, and whether it settles there."""
        factor = read_in(self.prototype.own_controller.gain_A_per_V, "A/V")[1]
        return [
            (1e6 * at["amplitude_m"], factor * at["gain_A_per_V"], at["frequency_Hz"], "yes" if at["stable"] else "no")
            for at in self.limit_cycles
        ]


@takes("Prototype")
def limits(
    prototype: Prototype, outer_end_mass_kg: float | None = None, preload_N: float = 0.0, progress: Progress = silent
) -> Limits:
    """Work out the limits of a prototype and of its linear model.

    Args:
        prototype: with a controller of one law.
        outer_end_mass_kg: mass on the outer tip; else the largest payload.
        preload_N: constant force on the outer tip.
        progress: called with the share done and what is being done.

    Raises:
        InputError: for effects that cannot be, for figures that are not plausible, or without a controller.
    """
    most = (prototype.outer_end_mass_kg or (0.0, 0.0))[1]
    mass = checked_mass_kg(prototype.name, most if outer_end_mass_kg is None else outer_end_mass_kg)
    checked(prototype.name, "preload_N", SignedForce, preload_N)
    found = envelope(prototype, mass, preload_N)
    if not found.stable:
        return Limits(prototype, mass, preload_N, found)
    try:
        modes: SingleModeReach | str = single_mode_reach(prototype, mass)
    except (InputError, ValueError) as error:
        modes = str(error)
    try:
        linear: tuple[dict[str, Any], ...] | str = _linear(prototype, mass, progress)
    except ValueError as error:
        linear = str(error)
    cycles = _cycles(prototype, mass)
    return Limits(prototype, mass, preload_N, found, sensor_reach(prototype, mass), modes, linear, cycles)


def _linear(rig: Prototype, mass: float, progress: Progress) -> tuple[dict[str, Any], ...]:
    real = with_published_effects(rig)
    equal = real.but(effects={name: given for name, given in real.effects.items() if name != "unequal_piston_areas"})
    asked: list[tuple[str, Varied, Prototype]] = [
        ("constant load, N", "load", real),
        ("constant load, equal piston sides, N", "load", equal),
        ("force amplitude, N", "force", real),
        ("air, volume share", "air", real),
    ]
    asked = asked if fits("entrained_air", rig.rig) else [row for row in asked if row[1] == "force"]
    rows, quick = [], pace(lumped.figures(rig))
    for number, (words, varied, there) in enumerate(asked):
        progress(number / len(asked), words)
        for frequency in (quick * one for one in LINEAR_HZ):
            found = reach(there, varied, frequency, mass)
            of = {"words": words, "varied": varied, "effects": sorted(there.effects), "frequency_Hz": frequency}
            rows.append(of | picked(found, "limit departure") | {"reached": abs(found.departure) > 0.095})
    return tuple(rows)


def _cycles(rig: Prototype, mass: float) -> tuple[dict[str, Any], ...]:
    real = with_published_effects(rig)
    if real.effects == linear_part(real).effects:  # a linear loop has none
        return ()
    shown = "gain_A_per_V frequency_Hz=motion.frequency_Hz stable"
    found = cycles_about_own(real, AMPLITUDES_M, mass)
    return tuple({"amplitude_m": amplitude} | picked(cycle, shown) for amplitude, cycle in found)
