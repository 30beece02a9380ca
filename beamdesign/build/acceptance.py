"""The acceptance test: what a rig built to a prototype should measure, and the data set to be filled in.

Expected is nominal by the linear model, with bands within its tolerances. The data set has excitation signals, empty
records, dataset.toml and scenario.toml; what comes back goes to `beamdesign gap diagnose` as it is. Two payloads, two
amplitudes, forces and commands are asked for, because effects show in how these differ; which records no fit sees is
chosen by the diagnosis.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import isfinite, pi, sqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w

from beamdesign.columns import write_tables
from beamdesign.files import write_whole
from beamdesign.loop import CriticalGain, Loop, critical_gain, loop, member_loop
from beamdesign.parameters import RIG_TOLERANCES
from beamdesign.plant.assembly import mass_unit_kg, pace
from beamdesign.plant.linear_reach import SingleModeReach, single_mode_reach
from beamdesign.plant.members import family, own_sag_m
from beamdesign.polynomial import exact
from beamdesign.progress import Progress, silent
from beamdesign.proofs.box import certify_box
from beamdesign.proofs.certifying import stability_over
from beamdesign.proofs.rig_family import rig_values
from beamdesign.proofs.tolerance_box import box_with_effects
from beamdesign.prototype import Prototype, write_prototype
from beamdesign.quantities import stated_range
from beamdesign.records import InputError, to_toml
from beamdesign.result import picked
from beamdesign.scenario import CHANNELS, Input, LoadSteps, Multisine, Scenario, ScenarioRecord, inputs_of
from beamdesign.spelling import shorter
from beamdesign.structure.lumped import CHANGEABLE, figures, lumped_beam, with_figures
from beamdesign.synthesis.operating_limits import envelope, grid_Hz

MEASURED_WITHIN = 0.05
"""Relative error allowed to the measurement of a compliance or a critical gain, beyond the bands."""
FREQUENCIES_HZ = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 150.0)
_MEMBERS = 64
_BACK_OFF = (0.99, 0.97, 0.94, 0.9, 0.85)
_BUDGET = 1500
_EDGE = 0.7
"""A member is drawn with each figure at an end of its tolerance, with this probability, or else between them."""


@dataclass(frozen=True)
class Band:
    """A measured quantity: nominal, and its least and largest value over the members looked at.

    Without tolerances all three are the same.
    """

    nominal: float
    low: float
    high: float

    @property
    def limits(self) -> tuple[float, float]:
        """Pass if measured between these: the band and the error of the measurement."""
        return self.low * (1 - MEASURED_WITHIN), self.high * (1 + MEASURED_WITHIN)


@dataclass(frozen=True)
class AcceptanceAtMass:
    """Expected measurements with one mass on the outer tip.

    Attributes:
        outer_end_mass_kg: the mass.
        bandwidth_Hz: up to where the nominal compliance keeps the goal.
        peak_sensitivity: largest nominal |1 / (1 + L)|.
        static_compliance_m_per_N: nominal |x / F_d| at zero frequency.
        compliance_m_per_N: |x / F_d| by frequency in Hz.
        critical_gain_A_per_V: band; None where raising the gain never sets in oscillation.
        oscillation_Hz: band of its frequency.
        critical_gain_proved_A_per_V: up to this gain every rig within the tolerances is proved stable; None where no
            gain above the specified one was proved, or there are no tolerances.
        modes: what all bending modes of both beams make of the critical gain, without effects; None where the prototype
            gives no geometry, or no gain sets in oscillation.
    """

    outer_end_mass_kg: float
    bandwidth_Hz: float
    peak_sensitivity: float
    static_compliance_m_per_N: float
    compliance_m_per_N: Mapping[float, Band]
    critical_gain_A_per_V: Band | None
    oscillation_Hz: Band | None
    critical_gain_proved_A_per_V: float | None
    modes: SingleModeReach | None

    @property
    def lost_to_modes(self) -> bool:
        """Whether all modes leave less of the critical gain than the measurement of it could miss."""
        return self.modes is not None and self.modes.gain_margin_eaten > MEASURED_WITHIN


class Mode(NamedTuple):
    """Of a beam by itself: undamped frequency, and damping ratio, which falls as mass is added to a fixed dashpot."""

    frequency_Hz: float
    damping_ratio: float


def bare_modes(prototype: Prototype) -> tuple[Mode, Mode]:
    """Of the beams by themselves: outer with its module alone, inner with its added mass too."""
    found = []
    for record, added_kg in ((prototype.outer_beam, 0.0), (prototype.inner_beam, prototype.payload.inner_end_mass_kg)):
        beam = lumped_beam(record)
        natural = sqrt(beam.stiffness / (beam.mass + added_kg))
        found.append(Mode(natural / (2 * pi), beam.damping * natural / (2 * beam.stiffness)))
    return found[0], found[1]


def acceptance(
    prototype: Prototype,
    masses_kg: tuple[float, ...],
    tolerances: Mapping[str, float] | None = None,
    progress: Progress = silent,
) -> tuple[AcceptanceAtMass, ...]:
    """Expected measurements at some outer end masses.

    Bands are the extremes of members drawn from the box of tolerances, most figures at an end: sampled, not proved. Of
    effects they hold the compliances of all linear loops of which performance is proved, beside that at rest. That all
    rigs of the box are stable up to a gain is proved by zero exclusion.

    Args:
        prototype: with a controller.
        masses_kg: outer end masses.
        tolerances: relative, by figure as in `beamdesign.proofs.rig_family.rig_values`; none where it is None.
        progress: told the share done, and with what.
    """
    spread = {name: part for name, part in (tolerances or {}).items() if name in CHANGEABLE and part > 0}
    members = [prototype, *_drawn(prototype, spread)]
    loops = [one for member in members for one in _loops(member)]
    grid, found = pace(figures(prototype)) * np.array(FREQUENCIES_HZ), []
    for at, mass in enumerate(masses_kg):
        progress(at / len(masses_kg), "members within the tolerances")
        table = np.abs([closed.at(mass).compliance_response(grid) for closed in loops])
        onset = [one for one in (_onset(member, mass) for member in members) if one is not None]
        progress((at + 0.7) / len(masses_kg), "gain that all rigs bear")
        gain = _band([one.gain_A_per_V for one in onset]) if len(onset) == len(members) else None
        hertz = None if gain is None else _band([one.frequency_Hz for one in onset])
        proved = _proved_gain(prototype, mass, spread, gain.low) if gain and spread else None
        here, compliance = loops[0].at(mass), {float(f): _band(table[:, k]) for k, f in enumerate(grid)}
        bandwidth = here.bandwidth_Hz(prototype.goal.compliance_m_per_N)
        nominal = bandwidth, here.peak_sensitivity(), abs(here.static_compliance())
        found.append(AcceptanceAtMass(mass, *nominal, compliance, gain, hertz, proved, _all_modes(prototype, mass)))
    return tuple(found)


def _all_modes(prototype: Prototype, mass: float) -> SingleModeReach | None:
    with suppress(InputError, ValueError):  # no geometry, or no gain that sets in oscillation
        return single_mode_reach(prototype, mass)
    return None


def _loops(member: Prototype) -> list[Loop]:
    """That at rest, and of a rig with effects those that are to perform, with the ends of the factors on their gain."""
    found, loops = family(member), [loop(member)]
    for one in found.members if member.effects else ():
        ends = () if one.performance is None else {one.performance.low, one.performance.high}
        loops += [member_loop(member, one).scaled(exact(factor)) for factor in sorted(ends)]
    return loops


def _onset(member: Prototype, mass: float) -> CriticalGain | None:
    """Where raising the gain sets in oscillation; None where no gain does."""
    with suppress(ValueError):
        return critical_gain(member, mass, from_own=True)
    return None


def _band(values: "list[float] | np.ndarray") -> Band:
    return Band(float(values[0]), float(min(values)), float(max(values)))


def _drawn(prototype: Prototype, spread: Mapping[str, float]) -> list[Prototype]:
    """Each figure alone at either end, and members with all figures off."""
    random = np.random.default_rng(1)
    factors = [{name: 1 + side * part} for name, part in spread.items() for side in (-1, 1)]
    for _ in range(_MEMBERS if spread else 0):
        at = np.where(random.random(len(spread)) < _EDGE, random.choice((-1.0, 1.0), len(spread)), 0.0)
        at = np.where(at == 0, random.uniform(-1, 1, len(spread)), at)
        factors.append({name: 1 + float(a) * part for a, (name, part) in zip(at, spread.items(), strict=True)})
    return [with_figures(prototype, one) for one in factors]


def _proved_gain(prototype: Prototype, mass: float, spread: Mapping[str, float], sampled: float) -> float | None:
    """A gain, as near as was proved to the least critical one sampled, up to which all rigs are stable."""
    values, own = rig_values(prototype), prototype.own_controller.gain_A_per_V
    rig = prototype.but(payload=prototype.payload.but(outer_end_mass_kg=(mass, mass)))
    ranges = {
        name: (values[name] * (1 - exact(part)), values[name] * (1 + exact(part)))
        for name, part in spread.items()
        if name != "controller_gain"
    }
    for back_off in _BACK_OFF:
        gain = float(f"{back_off * sampled:.4g}")
        if gain <= own:
            return None
        varied: dict[str, tuple[Any, Any]] = {**ranges, "outer_end_mass": (mass, mass), "controller_gain": (own, gain)}
        box = box_with_effects(rig, varied, {"controller_gain": own})
        if certify_box(rig, box, _BUDGET, volumes=False).stable:
            return gain
    return None


COLUMNS = ("t_s", "disturbance_N", "command_V", "current_A", "displacement_m")
"""Of a record; behind them what else its law senses."""
DURATION_S, SAMPLE_S = 4.0, 0.5e-3
LOW_HZ, HIGH_HZ, _BAND_HZ, _RISE_S = 1.0, 250.0, 100.0, 0.03
"""Of a rig as quick as the published one; of others records are as much shorter or longer."""
_SHARE = 0.3
"""Of the least force that the actuator can carry within the band: well inside what is linear."""
_SMALLER = 4.0
_COMMAND_M = 1.5e-4
_OF_RATED = 0.5
_HEAVIEST_KG, _FURTHEST_KG, _NEAREST_KG = 20.0, 5.0, 0.05
"""Of a second payload beside the only one that is certified, of a rig as heavy as the published one."""


@dataclass(frozen=True)
class AcceptancePlan:
    """What is done to the rig.

    Attributes:
        scenario: records with their excitation, payload and controller, as `beamdesign simulate` takes it.
        force_N: peak of the larger multisine.
        command_V: peak of the command.
        masses_kg: payloads.
        second_mass: how the second payload was chosen, in words; empty where both are ends of the certified range.
    """

    scenario: Scenario
    force_N: float
    command_V: float
    masses_kg: tuple[float, ...]
    second_mass: str


def acceptance_plan(
    prototype: Prototype, masses_kg: tuple[float, float], duration_s: float | None = None
) -> AcceptancePlan:
    """Excitations of the acceptance test.

    Args:
        prototype: with a controller whose loop is stable over the range.
        masses_kg: range of outer end mass that is certified.
        duration_s: of each record; None for 4 s of a rig as quick as the published one, and as suits others.

    Raises:
        InputError: where the inner beam sags so far by itself that no force can be borne.
    """
    masses, words = _payloads(prototype, masses_kg)
    quick = pace(figures(prototype))
    low, high, length = quick * LOW_HZ, quick * HIGH_HZ, duration_s or DURATION_S / quick
    looked_at = ((mass, grid_Hz(prototype, mass, low, quick * _BAND_HZ, 60)) for mass in masses)
    borne = min(float(envelope(prototype, mass, 0.0, grid).load_N.min()) for mass, grid in looked_at)
    if borne == 0:
        sag = f"sags by {1e3 * own_sag_m(prototype):.3g} mm by itself, which leaves no stroke or gap for any force"
        raise InputError(prototype.name, [("inner_beam", f"{sag}; give more of either, or a stiffer beam")])
    force = _two_digits(_SHARE * (borne if isfinite(borne) else prototype.actuator.strength_N(prototype)))
    command = _COMMAND_M * prototype.sensor.gain_V_per_m
    law, inner = prototype.own_controller, prototype.payload.inner_end_mass_kg
    if (rated := prototype.actuator.largest_current_A(prototype)) is not None:
        command = min(command, _OF_RATED * rated / law.gain_A_per_V)
    command, small = _two_digits(command), _two_digits(force / _SMALLER)
    drives = (("force", force, None), ("small_force", small, None), ("command", None, command))
    signals: list[tuple[str, float, Input]] = []
    for k, (load, mass) in enumerate(zip(("light", "heavy"), masses, strict=False)):
        for seed, (name, newtons, volts) in enumerate(drives, 10 * k + 1):
            tones = Multisine(amplitude_N=newtons, amplitude_V=volts, low_Hz=low, high_Hz=high, seed=seed)
            signals.append((f"{load}_{name}", mass, tones))
    steps = LoadSteps(amplitude_N=_two_digits(force / 2), dwell_s=_two_digits(length / 5), rise_s=_RISE_S / quick)
    signals.append(("load_steps", masses[-1], steps))
    rows = tuple(
        ScenarioRecord(name=name, input=(signal,), outer_end_mass_kg=mass, inner_end_mass_kg=inner, controller=law)
        for name, mass, signal in signals
    )
    title = f"acceptance of {shorter(prototype.name)}"
    scenario = Scenario(name=title, duration_s=length, sample_s=SAMPLE_S / quick, start="rest", record=rows)
    return AcceptancePlan(scenario, force, command, masses, words)


def as_specified(prototype: Prototype, specified: Mapping[str, float]) -> Prototype:
    """The prototype as the diagnosis should take it: with standard deviations that it states, or else as specified.

    Of an arm it is in no plane: what is expected is of a payload on the axis.

    What it states of end masses stays either way, and alone says nothing of the rig. A figure anywhere within its
    specified tolerance, no value more likely than another, has a standard deviation of the tolerance over the root of
    three; of the figures that share one key of `[tolerance]` the loosest counts.

    Args:
        prototype: as specified.
        specified: relative tolerances by figure, named as in `beamdesign.proofs.rig_family.rig_values`.
    """
    if prototype.arm is not None:
        prototype = prototype.but(arm=prototype.arm.but(plane=None))
    if any(getattr(prototype.tolerance, key) for key in RIG_TOLERANCES.values()):
        return prototype.but(guarantee=None)
    deviations: dict[str, float] = {}
    for figure, part in specified.items():
        if key := RIG_TOLERANCES.get(figure):
            deviations[key] = max(deviations.get(key, 0.0), _two_digits(part / sqrt(3)))
    return prototype.but(guarantee=None, tolerance=prototype.tolerance.but(**deviations))


def write_data_folder(prototype: Prototype, plan: AcceptancePlan, folder: Path) -> None:
    """Write the folder to fill in; what was measured already is left as it is.

    That is records that hold rows, and where there are such or critical gains the index, which says by which law.

    Args:
        prototype: see `as_specified`.
        plan: what is to be measured.
        folder: made if need be.

    Raises:
        OSError: where something cannot be written.
    """
    write_prototype(prototype, folder / "prototype.toml")
    write_whole(folder / "scenario.toml", to_toml(plan.scenario))
    index = folder / "dataset.toml"
    measured = index.exists() and "\n[[critical_gain]]" in index.read_text("utf-8")  # without the mark of a comment
    for row in plan.scenario.record:
        record = folder / "records" / f"{row.name}.csv"
        signals = np.column_stack([plan.scenario.times, inputs_of(row, plan.scenario)])
        write_tables({row.name: (("t_s", *CHANNELS), signals)}, folder / "excitation")
        if record.exists() and len(record.read_text().splitlines()) > 1:
            measured = True
            continue
        added = () if row.controller is None else row.controller.added
        write_whole(record, ",".join((*COLUMNS, *added)) + "\n")
    if not (measured and index.exists()):
        write_whole(index, dataset_text(prototype, plan))


def dataset_text(prototype: Prototype, plan: AcceptancePlan) -> str:
    """dataset.toml of the records to be taken; critical gains are prepared as comments."""
    law, shown = {"controller": prototype.own_controller.model_dump()}, "outer_end_mass_kg inner_end_mass_kg"
    records = [{"file": f"records/{row.name}.csv"} | picked(row, shown) | law for row in plan.scenario.record]
    table = {"name": plan.scenario.name, "prototype": "prototype.toml", "record": records}
    inner = prototype.payload.inner_end_mass_kg
    gains = "# Where critical gains were measured, take the marks away and put them in:"
    for mass in plan.masses_kg:
        gains += f"\n# [[critical_gain]]\n# outer_end_mass_kg = {mass!r}\n# inner_end_mass_kg = {inner!r}\n"
        gains += "# gain_A_per_V = \n# relative_std = 0.03\n# frequency_Hz = \n"
    return f"{tomli_w.dumps(table)}\n{gains}"


def _payloads(prototype: Prototype, masses_kg: tuple[float, float]) -> tuple[tuple[float, ...], str]:
    """Both ends of the range; where it is one mass, a second one at which the loop is proved stable as well."""
    low, high = masses_kg
    if low < high:
        return (low, high), ""
    unit = mass_unit_kg(figures(prototype))
    furthest = unit * _FURTHEST_KG
    for first, last in stability_over(prototype, 0.0, max(unit * _HEAVIEST_KG, 2 * high)).stable_ranges:
        if first <= low <= last:
            ahead, behind = last - low, low - first
            other = low + min(ahead / 2, furthest) if ahead >= behind else low - min(behind / 2, furthest)
            other = _two_digits(other)
            if first < other < last and abs(other - low) > unit * _NEAREST_KG:
                stable = f"the loop is proved stable from {stated_range((first, last), 4)} kg"
                return tuple(sorted((low, other))), f"{stable}; {other:g} kg lies well inside"
    return (low,), "no second payload at which the loop is stable was found; one payload tells less"


def _two_digits(value: float) -> float:
    return float(f"{value:.2g}")
