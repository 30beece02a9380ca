"""The acceptance test as a data set to be filled in: excitation signals, empty records, dataset.toml, scenario.toml.

What comes back goes to `beamdesign gap diagnose` as it is. Two payloads, two amplitudes, forces and commands are asked
for, because effects show in how these differ; which records no fit sees is chosen by the diagnosis.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from pathlib import Path

import numpy as np
import tomli_w

from beamdesign.files import write_whole
from beamdesign.operating_limits import envelope, rated_current
from beamdesign.parameters import RIG_TOLERANCES
from beamdesign.proof.certifying import certify
from beamdesign.prototype import Prototype, write_prototype
from beamdesign.records import to_toml
from beamdesign.scenario import CHANNELS, Input, LoadSteps, Multisine, Scenario, ScenarioRecord, inputs_of
from beamdesign.spelling import shorter

COLUMNS = ("t_s", "disturbance_N", "command_V", "current_A", "displacement_m")
"""Of a record; behind them what else its law senses."""
DURATION_S, SAMPLE_S = 4.0, 0.5e-3
LOW_HZ, HIGH_HZ = 1.0, 250.0
_SHARE = 0.3
"""Of the least force that the actuator can carry within the band: well inside what is linear."""
_SMALLER = 4.0
_COMMAND_M = 1.5e-4
_OF_RATED = 0.5
_HEAVIEST_KG, _FURTHEST_KG = 20.0, 5.0


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
    prototype: Prototype, masses_kg: tuple[float, float], duration_s: float = DURATION_S
) -> AcceptancePlan:
    """Excitations of the acceptance test.

    Args:
        prototype: with a controller whose loop is stable over the range.
        masses_kg: range of outer end mass that is certified.
        duration_s: of each record.
    """
    masses, words = _payloads(prototype, masses_kg)
    force = _two_digits(_SHARE * min(_least_load(prototype, mass) for mass in masses))
    command = _COMMAND_M * prototype.sensor.gain_V_per_m
    controller = prototype.controller
    assert controller is not None
    if (rated := rated_current(prototype)) is not None:
        command = min(command, _OF_RATED * rated / controller.gain_A_per_V)
    command, small = _two_digits(command), _two_digits(force / _SMALLER)
    rows: list[ScenarioRecord] = []

    def add(name: str, mass: float, signal: Input) -> None:
        rows.append(
            ScenarioRecord(
                name=name,
                input=(signal,),
                outer_end_mass_kg=mass,
                inner_end_mass_kg=prototype.payload.inner_end_mass_kg,
                controller=controller,
            )
        )

    for k, mass in enumerate(masses):
        load = "light" if k == 0 else "heavy"
        add(f"{load}_force", mass, Multisine(amplitude_N=force, low_Hz=LOW_HZ, high_Hz=HIGH_HZ, seed=10 * k + 1))
        add(f"{load}_small_force", mass, Multisine(amplitude_N=small, low_Hz=LOW_HZ, high_Hz=HIGH_HZ, seed=10 * k + 2))
        add(f"{load}_command", mass, Multisine(amplitude_V=command, low_Hz=LOW_HZ, high_Hz=HIGH_HZ, seed=10 * k + 3))
    dwell = _two_digits(duration_s / 5)
    add("load_steps", masses[-1], LoadSteps(amplitude_N=_two_digits(force / 2), dwell_s=dwell, rise_s=0.03))
    scenario = Scenario(
        name=f"acceptance of {shorter(prototype.name)}",
        duration_s=duration_s,
        sample_s=SAMPLE_S,
        start="rest",
        record=tuple(rows),
    )
    return AcceptancePlan(scenario, force, command, masses, words)


def believed(prototype: Prototype, specified: Mapping[str, float]) -> Prototype:
    """The prototype as the diagnosis should take it: with standard deviations that it states, or else as specified.

    A figure anywhere within its specified tolerance, no value more likely than another, has a standard deviation of the
    tolerance over the root of three; of the figures that share one key of `[tolerance]` the loosest counts.

    Args:
        prototype: as specified.
        specified: relative tolerances by figure, named as in `beamdesign.proof.rig_family.rig_values`.
    """
    if any(prototype.tolerance.model_dump().values()):
        return prototype.but(guarantee=None)
    deviations: dict[str, float] = {}
    for figure, part in specified.items():
        if key := RIG_TOLERANCES.get(figure):
            deviations[key] = max(deviations.get(key, 0.0), _two_digits(part / sqrt(3)))
    return prototype.but(guarantee=None, tolerance=prototype.tolerance.but(**deviations))


def write_data_folder(prototype: Prototype, plan: AcceptancePlan, folder: Path) -> list[Path]:
    """Write the folder to fill in; records that already hold rows are left as they are.

    Args:
        prototype: see `believed`.
        plan: what is to be measured.
        folder: made if need be.

    Returns:
        every file of the folder's layout.

    Raises:
        OSError: where something cannot be written.
    """
    paths = [folder / "prototype.toml", folder / "scenario.toml", folder / "dataset.toml"]
    folder.mkdir(parents=True, exist_ok=True)
    write_prototype(prototype, paths[0])
    write_whole(paths[1], to_toml(plan.scenario))
    write_whole(paths[2], dataset_text(prototype, plan))
    for row in plan.scenario.record:
        signal, record = (folder / kind / f"{row.name}.csv" for kind in ("excitation", "records"))
        table = np.column_stack([plan.scenario.times, inputs_of(row, plan.scenario)])
        lines = [",".join(("t_s", *CHANNELS)), *(f"{t:.4f},{force:.5g},{volts:.5g}" for t, force, volts in table)]
        write_whole(signal, "\n".join(lines) + "\n")
        if not (record.exists() and len(record.read_text().splitlines()) > 1):
            added = () if row.controller is None else row.controller.added
            write_whole(record, ",".join((*COLUMNS, *added)) + "\n")
        paths += [signal, record]
    return paths


def dataset_text(prototype: Prototype, plan: AcceptancePlan) -> str:
    """dataset.toml of the records to be taken; critical gains are prepared as comments."""
    controller = prototype.controller
    assert controller is not None
    table = {
        "name": plan.scenario.name,
        "prototype": "prototype.toml",
        "record": [
            {
                "file": f"records/{row.name}.csv",
                "outer_end_mass_kg": row.outer_end_mass_kg,
                "inner_end_mass_kg": row.inner_end_mass_kg,
                "controller": controller.model_dump(),
            }
            for row in plan.scenario.record
        ],
    }
    gains = [
        "# Where critical gains were measured, take the marks away and put them in:",
        *(
            f"# [[critical_gain]]\n# outer_end_mass_kg = {mass!r}\n"
            f"# inner_end_mass_kg = {prototype.payload.inner_end_mass_kg!r}\n"
            "# gain_A_per_V = \n# relative_std = 0.03\n# frequency_Hz = \n"
            for mass in plan.masses_kg
        ),
    ]
    return tomli_w.dumps(table) + "\n" + "\n".join(gains)


def _payloads(prototype: Prototype, masses_kg: tuple[float, float]) -> tuple[tuple[float, ...], str]:
    """Both ends of the range; where it is one mass, a second one at which the loop is proved stable as well."""
    low, high = masses_kg
    if low < high:
        return (low, high), ""
    for first, last in certify(prototype, 0.0, max(_HEAVIEST_KG, 2 * high)).stable_ranges_kg:
        if first <= low <= last:
            ahead, behind = last - low, low - first
            other = low + min(ahead / 2, _FURTHEST_KG) if ahead >= behind else low - min(behind / 2, _FURTHEST_KG)
            other = _two_digits(other)
            if first < other < last and abs(other - low) > 0.05:
                words = f"the loop is proved stable from {first:.4g} to {last:.4g} kg; {other:g} kg lies well inside"
                return tuple(sorted((low, other))), words
    return (low,), "no second payload at which the loop is stable was found; one payload tells less"


def _least_load(prototype: Prototype, mass: float) -> float:
    return float(envelope(prototype, mass, 0.0, np.geomspace(LOW_HZ, 100.0, 60)).load_N.min())


def _two_digits(value: float) -> float:
    return float(f"{value:.2g}")
