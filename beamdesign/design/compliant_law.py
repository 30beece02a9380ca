"""The law that gives the end of a link a stiffness: the servo's command moves by the force on the tip over it.

What pushes the tip is what bends the outer beam less what the cylinder holds, F = K_m x - A p_L + (M s^2 + b_m s) x.
The first two terms, measured and behind a low-pass H, are the estimate; beam and end mass keep their inertia, which the
estimate would need to know. With C the servo's own law and F_s its sensor's gain,

    current = K C(s) [command - sensor + (F_s / k_c) H(s) (K_m x - A p_L)].

At rest the servo alone moves by G0 = 1 / (K_m + A (K_q / K_pq) K F_s) per newton and follows a command but for K_m G0
of it, so that x / F = G0 + (1 - K_m G0) / k_c. k_c is chosen to make that 1 / k_d.
"""

from dataclasses import dataclass
from math import inf, pi

import numpy as np

from beamdesign.controllers import Cascade, Observer, Sensed
from beamdesign.lumped import figures
from beamdesign.prototype import Prototype

SENSORS: tuple[Sensed, ...] = ("displacement_m", "load_pressure_Pa")


@dataclass(frozen=True)
class CompliantLaw:
    """What a compliant controller is made of.

    Attributes:
        servo: the law that holds the tip at its command.
        end_stiffness_N_per_m: static stiffness of the end, F / x.
        force_filter_Hz: break of the low-pass that the estimated force goes through.
    """

    servo: Cascade
    end_stiffness_N_per_m: float
    force_filter_Hz: float


def servo_stiffness(prototype: Prototype, servo: Cascade) -> float:
    """Static stiffness of the end under a servo alone, N/m: the most that it can be given; infinite without leakage."""
    given = figures(prototype)
    if given["leakage"] == 0:
        return inf
    pressure_gain = given["flow_gain"] / given["leakage"]
    return given["outer_stiffness"] + given["piston_area"] * pressure_gain * servo.gain_A_per_V * given["sensor_gain"]


def least_gain(prototype: Prototype, end_stiffness: float) -> float:
    """The gain (A/V) at which a servo alone is as stiff as this (N/m); 0 where it need not be any."""
    given = figures(prototype)
    per_gain = given["piston_area"] * given["flow_gain"] * given["sensor_gain"]
    return max(end_stiffness - given["outer_stiffness"], 0.0) * given["leakage"] / per_gain


def commanded_compliance(prototype: Prototype, law: CompliantLaw) -> float:
    """1 / k_c, m/N: by how much the command has to move per newton for the end to have its static stiffness.

    Raises:
        ValueError: where the servo alone is not as stiff as that, or nothing is.
    """
    alone = 1 / servo_stiffness(prototype, law.servo)
    if law.end_stiffness_N_per_m <= 0:
        raise ValueError(f"a stiffness must be greater than 0, is {law.end_stiffness_N_per_m:g} N/m")
    if law.end_stiffness_N_per_m * alone > 1:
        raise ValueError(f"the servo alone holds {1 / alone:.4g} N/m, less than {law.end_stiffness_N_per_m:.4g} N/m")
    return (1 / law.end_stiffness_N_per_m - alone) / (1 - figures(prototype)["outer_stiffness"] * alone)


def controller_of(prototype: Prototype, law: CompliantLaw) -> Observer:
    """The controller of displacement, load pressure and command: states of the servo, then the estimated force in V.

    Raises:
        ValueError: where the servo alone is not as stiff as the end is to be.
    """
    given, servo = figures(prototype), law.servo
    compliance = commanded_compliance(prototype, law)
    cutoff = 2 * pi * law.force_filter_Hz
    a, b, c, d, _ = servo.but(gain_A_per_V=1.0).state_space()
    n = len(b)
    # The sensor's volts are command - e_1, so that K_m x = K_m (command - e_1) / F_s.
    spring = given["outer_stiffness"] * compliance
    pressure = given["sensor_gain"] * given["piston_area"] * compliance
    whole = np.zeros((n + 1, n + 1))
    whole[:n, :n], whole[:n, n], whole[n, n] = a, b[:, 0], -cutoff
    inputs = np.zeros((n + 1, 2))
    inputs[:n, 0] = b[:, 0]
    inputs[n] = -cutoff * spring, cutoff * pressure
    commanded = np.zeros(n + 1)
    commanded[n] = cutoff * spring
    return Observer.of(servo.gain_A_per_V, SENSORS, whole, inputs, [*c, d[0]], [d[0], 0.0], commanded)
