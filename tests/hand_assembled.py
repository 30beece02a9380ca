"""Equations (7) to (18) of Zalucky and Hardt (1984) assembled by hand in numpy, to judge what the package has proved.

Nothing here is shared with the package but the records: lumped figures, matrices and responses are made anew.
"""

from dataclasses import dataclass
from math import pi, sqrt

import numpy as np

from beamdesign import Prototype
from beamdesign.controllers import Lag
from beamdesign.prototype import Beam

YOUNG_PA, DENSITY_KG_PER_M3 = 69e9, 2700.0
"""Of the alloy in the published study."""


def lumped(beam: Beam) -> tuple[float, float, float]:
    """Stiffness, effective mass (5) and dashpot; from a sharp-cornered tube where there are no measured figures."""
    stiffness, mass = beam.stiffness_N_per_m, beam.effective_mass_kg
    if stiffness is None or mass is None:
        assert beam.width_m is not None
        assert beam.wall_m is not None
        assert beam.free_length_m is not None
        opening = beam.width_m - 2 * beam.wall_m
        stiffness = 3 * YOUNG_PA * (beam.width_m**4 - opening**4) / 12 / beam.free_length_m**3
        tube = DENSITY_KG_PER_M3 * (beam.width_m**2 - opening**2) * beam.free_length_m
        mass = beam.end_mass_kg + 0.236 * tube
    return stiffness, mass, 2 * beam.damping_ratio * sqrt(stiffness * mass)


@dataclass(frozen=True)
class Judged:
    """What dense numerics say of a loop.

    Attributes:
        slowest: largest real part of a closed-loop pole over the masses, rad/s.
        peak: largest |S| on the grid.
        compliance: (f,) largest |x / F_d| over the masses, m/N.
    """

    slowest: float
    peak: float
    compliance: np.ndarray


def judge(prototype: Prototype, masses: np.ndarray, frequency_Hz: np.ndarray) -> Judged:
    """Poles, sensitivity and compliance of a prototype's loop on a grid of outer end masses and frequencies."""
    stiffness, mass, damping = lumped(prototype.outer_beam)
    inner_stiffness, inner_mass, inner_damping = lumped(prototype.inner_beam)
    inner_mass += prototype.payload.inner_end_mass_kg
    oil, area = prototype.actuator.oil_stiffness_N_per_m, prototype.actuator.piston_area_m2
    valve, sensor, law = prototype.servovalve, prototype.sensor, prototype.controller
    assert law is not None
    w = 2 * pi * valve.natural_frequency_Hz
    slow, ratio = (2 * pi * law.pole_Hz, law.pole_Hz / law.zero_Hz) if isinstance(law, Lag) else (1.0, 1.0)
    filter_rate = 2 * pi * sensor.filter_Hz if sensor.filter_Hz else 0.0

    n = 9  # x, v, cylinder, z, u, flow, flow's rate, filtered volts, controller
    x, v, c, z, u, q, r, f, h = range(n)
    slowest, peak = -np.inf, 0.0
    compliance = np.zeros(len(frequency_Hz))
    for added in masses:
        a, b = np.zeros((n, n)), np.zeros((n, 2))  # inputs: disturbance in N, command in V
        a[x, v] = a[z, u] = a[q, r] = 1.0
        total = mass + added
        a[v, [x, v, c]] = -(stiffness + oil) / total, -damping / total, oil / total
        b[v, 0] = 1 / total
        a[u, [x, c, z, u]] = np.array([oil, -oil, -inner_stiffness, -inner_damping]) / inner_mass
        leak = valve.leakage_m3_per_s_per_Pa * oil / area**2
        a[c, [u, q, c, x]] = 1.0, 1 / area, -leak, leak
        # Error volts as rows over states and inputs.
        error, error_input = np.zeros(n), np.array([0.0, 1.0])
        error[f if filter_rate else x] = -1.0 if filter_rate else -sensor.gain_V_per_m
        a[f, f], a[f, x] = (-filter_rate, filter_rate * sensor.gain_V_per_m) if filter_rate else (-1.0, 0.0)
        a[h] += slow * error
        a[h, h] -= slow
        b[h] = slow * error_input
        drive = w**2 * valve.flow_gain_m3_per_s_per_A * law.gain_A_per_V
        a[r, [q, r]] = -(w**2), -2 * valve.damping_ratio * w
        a[r] += drive * ratio * error
        a[r, h] += drive * (1 - ratio)
        b[r] = drive * ratio * error_input
        slowest = max(slowest, float(np.linalg.eigvals(a).real.max()))
        pencil = 2j * pi * frequency_Hz[:, None, None] * np.eye(n) - a
        motion = np.linalg.solve(pencil, np.broadcast_to(b, (len(frequency_Hz), n, 2)))
        compliance = np.maximum(compliance, np.abs(motion[:, x, 0]))
        peak = max(peak, float(np.abs(1.0 + motion[:, :, 1] @ error).max()))
    return Judged(slowest, peak, compliance)
