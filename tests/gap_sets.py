"""Small data sets for the tests of the diagnosis: simulated records of a rig that differs from the prototype."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from beamdesign import Prototype, simulate
from beamdesign.controllers import Lag, Proportional
from beamdesign.diagnosis.data.dataset import Dataset, TimeRecord
from beamdesign.prototype import Tolerance
from beamdesign.scenario import LoadSteps, Measurement, Multisine, Scenario, ScenarioRecord
from beamdesign.validation.paper_rig import paper_prototype

TOLERANCE = Tolerance(
    stiffness=0.03,
    effective_mass=0.02,
    beam_damping_ratio=0.2,
    oil_stiffness=0.1,
    piston_area=0.005,
    flow_gain=0.05,
    leakage=0.2,
    valve_natural_frequency=0.05,
    valve_damping_ratio=0.1,
    sensor_gain=0.005,
)
LAG = Lag(gain_A_per_V=0.1, pole_Hz=1.75, zero_Hz=26.0)


def believed() -> Prototype:
    """The published rig with what its builder vouches for."""
    return paper_prototype().but(tolerance=TOLERANCE, controller=LAG)


def scenario(duration_s: float = 1.0) -> Scenario:
    """Six records: both inputs, two sizes, two payloads."""

    def lines(
        name: str, low: float, high: float, seed: int, payload: float = 0.0, **amplitude: float
    ) -> ScenarioRecord:
        drive = Multisine(low_Hz=low, high_Hz=high, seed=seed, **amplitude)
        inner = 4.4 if payload else 0.0
        controller = LAG.but(gain_A_per_V=0.08) if payload else LAG
        return ScenarioRecord(
            name=name, input=(drive,), outer_end_mass_kg=payload, inner_end_mass_kg=inner, controller=controller
        )

    steps = LoadSteps(amplitude_N=900.0, levels=(0.5, 1.0, 0.0, -1.0), dwell_s=duration_s / 6)
    return Scenario(
        name="test",
        duration_s=duration_s,
        measurement=Measurement(seed=3, disturbance_std_N=0.5, current_std_A=2e-5, displacement_std_m=5e-7),
        record=(
            lines("command_small", 1, 250, 1, amplitude_V=0.06),
            lines("command_large", 1, 250, 2, amplitude_V=0.8),
            lines("disturbance_small", 3, 200, 3, amplitude_N=100.0),
            lines("disturbance_large", 3, 200, 4, amplitude_N=1000.0),
            ScenarioRecord(name="load_steps", input=(steps,), controller=Proportional(gain_A_per_V=0.0096)),
            lines("payload_disturbance", 3, 150, 5, 6.8, amplitude_N=400.0),
        ),
    )


def measured(rig: Prototype, plan: Scenario | None = None, prototype: Prototype | None = None) -> Dataset:
    """What a rig gives back, with the prototype that is believed."""
    plan = plan or scenario()
    prototype = prototype or believed()
    records = []
    for row, taken in zip(plan.record, simulate(rig, plan).records, strict=True):
        assert taken.stable, taken.reason
        records.append(
            TimeRecord(
                row.name,
                taken.column("t_s"),
                np.column_stack([taken.column("disturbance_N"), taken.column("command_V")]),
                {name: taken.column(name) for name in ("current_A", "displacement_m")},
                row.outer_end_mass_kg,
                row.inner_end_mass_kg or 0.0,
                row.controller or LAG,
            )
        )
    return Dataset("test", Path(), prototype, tuple(records))


def only(data: Dataset, names: Sequence[str]) -> Dataset:
    """Some of the records."""
    return replace(data, records=tuple(r for r in data.records if r.name in names))
