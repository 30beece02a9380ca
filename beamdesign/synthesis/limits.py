"""How far a prototype, and the linear model of it, can be trusted at one payload."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from beamdesign.json_text import finite, picked
from beamdesign.plant.assembly import fits
from beamdesign.plant.harmonic_balance import limit_cycles
from beamdesign.plant.linear_reach import SingleModeReach, Varied, reach, single_mode_reach, with_published_effects
from beamdesign.progress import Progress, silent
from beamdesign.prototype import Prototype
from beamdesign.records import InputError
from beamdesign.result import Result
from beamdesign.synthesis.operating_limits import Envelope, SensorReach, envelope, sensor_reach

SHOWN_HZ = (0.1, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
LINEAR_HZ = (1.0, 10.0, 50.0)
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
        linear_amplitude: per quantity varied and frequency, up to where the linear model's amplitude holds.
        limit_cycles: by amplitude, the gains at which the nonlinear loop oscillates by itself.
    """

    prototype: Prototype
    outer_end_mass_kg: float
    preload_N: float
    envelope: Envelope
    sensor: SensorReach | None = None
    modes: SingleModeReach | str = ""
    linear_amplitude: tuple[dict[str, Any], ...] = ()
    limit_cycles: tuple[dict[str, Any], ...] = ()

    @property
    def reason(self) -> str:
        """Why there are none; empty where there are."""
        return self.envelope.reason

    def to_dict(self) -> dict[str, Any]:
        """What `beamdesign limits` writes of them."""
        fields = picked(self, "outer_end_mass_kg preload_N") | {"stable": self.yes}
        if self.reason:
            return finite(fields | {"reason": self.reason})
        shown = "frequency_Hz load_N governing limits_N displacement_m supply_power_W missing"
        modes = self.modes
        fields |= {
            "actuator": picked(self.envelope, shown),
            "sensor": self.sensor,
            "modes": {"reason": modes}
            if isinstance(modes, str)
            else picked(modes, " ".join((*type(modes).__dataclass_fields__, "gain_margin_eaten"))),
            "linear_amplitude": [
                {name: value for name, value in row.items() if name != "words"} for row in self.linear_amplitude
            ],
            "limit_cycles": self.limit_cycles,
        }
        return finite(fields)

    def rows(self) -> list[tuple[Any, ...]]:
        """Over frequency in Hz: largest force, N; what governs it; how far the tip moves, um; supply power, W."""
        found = self.envelope
        if found.reason:
            return []
        near = [int(np.argmin(np.abs(np.log(found.frequency_Hz / shown)))) for shown in SHOWN_HZ]
        columns = found.frequency_Hz, found.load_N, found.governing, 1e6 * found.displacement_m, found.supply_power_W
        return [tuple(of[k] if isinstance(of[k], str) else float(of[k]) for of in columns) for k in near]

    def mode_rows(self) -> list[tuple[str, float]]:
        """How far one bending mode per beam reaches."""
        found = self.modes
        if isinstance(found, str):
            return []
        return [
            ("outer beam's tip compliance within 10 % up to, Hz", found.outer_Hz),
            ("inner beam's", found.inner_Hz),
            ("closed-loop compliance within 10 % up to, Hz", found.closed_loop_Hz),
            ("second mode, outer beam, Hz", found.outer_modes_Hz[1]),
            ("second mode, inner beam, Hz", found.inner_modes_Hz[1]),
            ("critical gain with one mode per beam, mA/V", 1e3 * found.critical_gain_A_per_V),
            ("with all modes, mA/V", 1e3 * found.critical_gain_all_A_per_V),
            ("of the critical gain taken by them, %", 100 * found.gain_margin_eaten),
        ]

    def linear_rows(self) -> list[tuple[str, float, float | str, float]]:
        """What is varied, at what frequency in Hz, up to where, and how far off the model is there in per cent."""
        return [
            (
                row["words"],
                row["frequency_Hz"],
                row["limit"] if row["reached"] else f"more than {row['limit']:.4g}",
                100 * row["departure"],
            )
            for row in self.linear_amplitude
        ]

    def cycle_rows(self) -> list[tuple[float, float, float, str]]:
        """Amplitude in um, gain in mA/V, frequency in Hz, and whether the oscillation settles there."""
        return [
            (1e6 * row["amplitude_m"], 1e3 * row["gain_A_per_V"], row["frequency_Hz"], "yes" if row["stable"] else "no")
            for row in self.limit_cycles
        ]


def limits(
    prototype: Prototype,
    outer_end_mass_kg: float | None = None,
    preload_N: float = 0.0,
    progress: Progress = silent,
) -> Limits:
    """Work out the limits of a prototype and of its linear model.

    Args:
        prototype: with a controller of one law.
        outer_end_mass_kg: mass on the outer tip; else the largest payload.
        preload_N: constant force on the outer tip.
        progress: called with the share done and what is being done.

    Raises:
        InputError: for effects that cannot be, or without a controller.
    """
    mass = outer_end_mass_kg if outer_end_mass_kg is not None else (prototype.outer_end_mass_kg or (0.0, 0.0))[1]
    found = envelope(prototype, mass, preload_N)
    if found.reason:
        return Limits(prototype, mass, preload_N, found)
    try:
        modes: SingleModeReach | str = single_mode_reach(prototype, mass)
    except (InputError, ValueError) as error:
        modes = str(error)
    linear, cycles = _linear(prototype, mass, progress), _cycles(prototype, mass)
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
    rows = []
    for number, (words, varied, there) in enumerate(asked):
        progress(number / len(asked), words)
        for frequency in LINEAR_HZ:
            found = reach(there, varied, frequency, mass)
            of = {"words": words, "varied": varied, "effects": sorted(there.effects), "frequency_Hz": frequency}
            rows.append(of | picked(found, "limit departure") | {"reached": abs(found.departure) > 0.095})
    return tuple(rows)


def _cycles(rig: Prototype, mass: float) -> tuple[dict[str, Any], ...]:
    real, rows = with_published_effects(rig), []
    for amplitude in AMPLITUDES_M:
        try:
            (cycle,) = limit_cycles(real, [amplitude], mass)
        except ValueError:  # there is none of that amplitude, or harmonic balance does not cover an effect
            continue
        stated = picked(cycle, "gain_A_per_V frequency_Hz=motion.frequency_Hz stable")
        rows.append({"amplitude_m": amplitude} | stated)
    return tuple(rows)
