"""Make the data set `slow_sensor`: a rig whose sensor lags behind, measured with the figures of a builder's tolerances.

    python studies/gaps/make_slow_sensor.py studies/gaps/slow_sensor

The rig differs from the believed prototype by a first-order lag of 250 Hz behind its sensor, and by figures within the
stated tolerances. Four records of 2 s, with noise on every channel.
"""

import sys
from pathlib import Path

import numpy as np

from beamdesign import read_prototype, simulate
from beamdesign.controllers import Lag
from beamdesign.scenario import Measurement, Multisine, Scenario, ScenarioRecord, Step

COLUMNS = ("t_s", "disturbance_N", "command_V", "current_A", "displacement_m")
DIGITS = ("%.4f", "%.3f", "%.4g", "%.5g", "%.5g")
LAG = Lag(gain_A_per_V=0.06, pole_Hz=1.75, zero_Hz=26.0)
RECORDS = (
    ScenarioRecord(
        name="command",
        input=(Multisine(amplitude_V=0.2, low_Hz=1.0, high_Hz=250.0, seed=1),),
        inner_end_mass_kg=0.0,
        controller=LAG,
    ),
    ScenarioRecord(
        name="disturbance",
        input=(Multisine(amplitude_N=300.0, low_Hz=1.0, high_Hz=250.0, seed=2),),
        inner_end_mass_kg=0.0,
        controller=LAG,
    ),
    ScenarioRecord(
        name="payload_disturbance",
        input=(Multisine(amplitude_N=300.0, low_Hz=1.0, high_Hz=250.0, seed=3),),
        outer_end_mass_kg=6.8,
        inner_end_mass_kg=4.4,
        controller=LAG,
    ),
    ScenarioRecord(
        name="payload_steps",
        input=(Step(amplitude_N=150.0, at_s=0.2, length_s=0.8), Step(amplitude_V=0.1, at_s=0.5, length_s=0.9)),
        outer_end_mass_kg=6.8,
        inner_end_mass_kg=4.4,
        controller=LAG,
    ),
)


def main(folder: Path) -> None:
    """Simulate the rig, which only this file knows, and write what an experimenter would bring back."""
    believed = read_prototype(folder / "prototype.toml")
    rig = believed.but(
        outer_beam=believed.outer_beam.but(stiffness_N_per_m=1.02 * 486800.0, damping_ratio=0.044),
        actuator=believed.actuator.but(oil_stiffness_N_per_m=0.93 * 1.3e7),
        servovalve=believed.servovalve.but(flow_gain_m3_per_s_per_A=1.04 * 1.13e-2, natural_frequency_Hz=146.0),
        effects={"sensor_lag": {"break_Hz": 250.0}},
    )
    noise = Measurement(seed=7, disturbance_std_N=0.2, current_std_A=2e-6, displacement_std_m=1e-7)
    plan = Scenario(name=folder.name, duration_s=2.0, start="rest", measurement=noise, record=RECORDS)
    (folder / "records").mkdir(parents=True, exist_ok=True)
    entries = [f'name = "{folder.name}"\nprototype = "prototype.toml"\n']
    for row, record in zip(plan.record, simulate(rig, plan).records, strict=True):
        assert record.stable, record.reason
        table = np.column_stack([record.column(name) for name in COLUMNS])
        path = folder / "records" / f"{row.name}.csv"
        np.savetxt(path, table, fmt=list(DIGITS), delimiter=",", header=",".join(COLUMNS), comments="")
        entries.append(
            f'[[record]]\nfile = "records/{row.name}.csv"\nouter_end_mass_kg = {row.outer_end_mass_kg}\n'
            f"inner_end_mass_kg = {row.inner_end_mass_kg}\n"
            f'controller = {{ kind = "lag", gain_A_per_V = {LAG.gain_A_per_V}, pole_Hz = {LAG.pole_Hz},'
            f" zero_Hz = {LAG.zero_Hz} }}\n"
        )
    (folder / "dataset.toml").write_text("\n".join(entries))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
