"""Mount compliance: the base that clamps both beams gives way to what they press on it.

Motion of the mount is counted at the tips (a clamp that turns by an angle moves both tips by angle times length).
The sensor's reference may stand on the ground or turn with the mount.
"""

from math import pi
from typing import Any

from flint import fmpq

from beamdesign.plant.effects import TWO_PI, Effect, Elements, Exact, Linear, Parameter, Site


def _motion(signal: Any, site: Site) -> Any:
    own = site.parameter
    frequency = 2 * pi * own["frequency_Hz"]
    mass = own["stiffness_N_per_m"] / frequency**2
    restoring = own["stiffness_N_per_m"] * (
        site.state["mount_m"] + 2 * own["damping_ratio"] / frequency * site.state["mount_m_per_s"]
    )
    site.rate["mount_m"] = site.state["mount_m_per_s"]
    site.rate["mount_m_per_s"] = (signal - restoring) / mass
    return signal


def _elements(own: Exact, figure: Exact) -> Elements:
    stiffness, frequency = own["stiffness_N_per_m"], TWO_PI * own["frequency_Hz"]
    resists = stiffness, 2 * own["damping_ratio"] * stiffness / frequency, stiffness / frequency**2
    mount = {"mount": fmpq(1)}
    return Elements(((mount, resists),), {"base": mount, "sensed": {"mount": -own["sensor_share"]}})


EFFECT = Effect(
    name="mount_compliance",
    subsystem="structure",
    laws={
        "mount_m": lambda signal, site: site.state["mount_m"],
        "mount_m_per_s": lambda signal, site: site.state["mount_m_per_s"],
        "mount_force_N": _motion,
        "sensed_m": lambda signal, site: signal - site.parameter["sensor_share"] * site.state["mount_m"],
    },
    parameters=(
        Parameter(
            "stiffness_N_per_m", 5e6, 2e5, 5e8, 0.8, "force at the tips over the motion there, beams rigid", "stiffness"
        ),
        Parameter("frequency_Hz", 100.0, 15.0, 1000.0, 0.5, "of the mount, the beams held to the ground", "frequency"),
        Parameter("damping_ratio", 0.03, 2e-3, 0.5, 0.6, "of the mount alone"),
        Parameter("sensor_share", 0.0, 0.0, 1.0, 0.5, "1 where the sensor's reference turns with the mount, else 0"),
    ),
    states=("mount_m", "mount_m_per_s"),
    source="clamp as a spring and a mass; A. Zalucky and D. E. Hardt (1984), System Design (beams clamped in one base)",
    linear=Linear("as it is", elements=_elements),
)
