"""The published rig and loops that many tests start from."""

import pytest

from beamdesign.controllers import Lag
from beamdesign.prototype import Actuator, Beam, Payload, Prototype, Sensor, Servovalve


@pytest.fixture
def paper() -> Prototype:
    """The appendix of Zalucky and Hardt (1984) in SI, without a controller; valve damping 0.5 as the README states."""
    return Prototype(
        name="paper",
        outer_beam=Beam(stiffness_N_per_m=486_800.0, effective_mass_kg=3.9, damping_ratio=0.05),
        inner_beam=Beam(stiffness_N_per_m=157_500.0, effective_mass_kg=1.6, damping_ratio=0.05),
        actuator=Actuator(piston_area_m2=1.13e-4, oil_stiffness_N_per_m=1.3e7),
        servovalve=Servovalve(
            flow_gain_m3_per_s_per_A=1.13e-2,
            leakage_m3_per_s_per_Pa=3.8e-13,
            natural_frequency_Hz=150.0,
            damping_ratio=0.5,
        ),
        sensor=Sensor(gain_V_per_m=1180.0),
    )


@pytest.fixture
def remedy(paper: Prototype) -> Prototype:
    """The paper's remedy for payload: lag 1.75/26 Hz with 4.5 kg inside, at 150 mA/V."""
    return paper.but(
        controller=Lag(gain_A_per_V=0.15, pole_Hz=1.75, zero_Hz=26.0),
        payload=Payload(inner_end_mass_kg=4.5, outer_end_mass_kg=(0.0, 6.8)),
    )
