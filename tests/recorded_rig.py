"""A small data set of a simulated rig, as columns that a test may spoil before they are written."""

from copy import deepcopy
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from beamdesign import Prototype, simulate, write_prototype
from beamdesign.prototype import Tolerance
from beamdesign.scenario import LoadSteps, Measurement, Multisine, Scenario, ScenarioRecord
from beamdesign.simulation import COLUMNS

LAG = {"kind": "lag", "gain_A_per_V": 0.122, "pole_Hz": 1.75, "zero_Hz": 26.0}
SLOW_LAG = {"kind": "lag", "gain_A_per_V": 0.0804, "pole_Hz": 1.75, "zero_Hz": 26.0}
STRAIGHT = {"kind": "proportional", "gain_A_per_V": 0.00965}
_FORCE = Multisine(amplitude_N=600.0, low_Hz=1.0, high_Hz=120.0, seed=3)
_COMMAND = Multisine(amplitude_V=0.6, low_Hz=1.0, high_Hz=120.0, seed=4)
_STEPS = LoadSteps(amplitude_N=400.0, levels=(1.0, -0.5, 0.0), dwell_s=0.35)


@dataclass
class Recorded:
    """A data set before it is written.

    Attributes:
        index: dataset.toml.
        columns: by name of the record.
        more: columns that are not written unless a test adds them, by name of the record.
        files: other files by name, as text.
    """

    prototype: Prototype
    index: dict[str, Any]
    columns: dict[str, dict[str, np.ndarray]]
    more: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)
    files: dict[str, str] = field(default_factory=dict)

    def entry(self, name: str) -> dict[str, Any]:
        """Table of a record in dataset.toml."""
        return next(row for row in self.index["record"] if name in row["file"])

    def write(self, folder: Path) -> Path:
        """Write it and give its folder."""
        (folder / "records").mkdir(parents=True, exist_ok=True)
        write_prototype(self.prototype, folder / "prototype.toml")
        (folder / "dataset.toml").write_text(tomli_w.dumps(self.index))
        for name, columns in self.columns.items():
            (folder / "records" / f"{name}.csv").write_text(as_csv(columns))
        for name, text in self.files.items():
            (folder / name).write_text(text)
        return folder


def as_csv(columns: dict[str, np.ndarray]) -> str:
    """Columns as the text of a CSV file, with every digit."""
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    return "\n".join([",".join(columns), *(",".join(map(repr, row)) for row in rows)]) + "\n"


@cache
def _simulated(text: str) -> Recorded:
    prototype = Prototype.model_validate_json(text)  # prototypes do not hash
    rows = {
        "force": ((_FORCE,), 0.0, 0.0, LAG),
        "command": ((_COMMAND,), 0.0, 0.0, LAG),
        "steps": ((_STEPS,), 0.0, 0.0, STRAIGHT),
        "payload": ((_FORCE,), 6.8, 4.4, SLOW_LAG),
    }
    scenario = Scenario(
        name="small",
        duration_s=1.2,
        sample_s=1e-3,
        measurement=Measurement(
            seed=1, disturbance_std_N=0.5, current_std_A=2e-5, displacement_std_m=3e-7, displacement_step_m=1e-7
        ),
        record=tuple(
            ScenarioRecord(
                name=name, input=given, outer_end_mass_kg=outer, inner_end_mass_kg=inner, controller=controller
            )
            for name, (given, outer, inner, controller) in rows.items()
        ),
    )
    taken = simulate(prototype, scenario)
    assert all(record.diverged_at_s is None for record in taken.records)
    index = {
        "name": "small",
        "record": [
            {
                "file": f"records/{name}.csv",
                "outer_end_mass_kg": outer,
                "inner_end_mass_kg": inner,
                "controller": dict(controller),
            }
            for name, (_, outer, inner, controller) in rows.items()
        ],
    }
    columns = {record.name: {name: record.column(name) for name in COLUMNS[:5]} for record in taken.records}
    more = {record.name: {name: record.column(name) for name in COLUMNS[5:]} for record in taken.records}
    return Recorded(prototype, index, columns, more)


def recorded(prototype: Prototype, effects: dict[str, dict[str, float]] | None = None) -> Recorded:
    """Four records of a rig: force, command, load steps and force with payload.

    Args:
        prototype: believed; effects are in the rig only.
        effects: of the rig.
    """
    believed = prototype.but(tolerance=Tolerance(flow_gain=0.05, stiffness=0.03))
    taken = _simulated(believed.but(effects=effects or {}).model_dump_json())
    return Recorded(believed, deepcopy(taken.index), {n: dict(c) for n, c in taken.columns.items()}, taken.more)
