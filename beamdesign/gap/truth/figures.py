"""Every figure of the true rig, as one record that the compiled equations read."""

from collections.abc import Mapping

import numpy as np

MODES = 4
"""Most bending modes of the outer beam that the equations carry."""

FIGURES: dict[str, float] = {
    # masses and springs of the beams, SI
    "inner_stiffness": 157500.0,
    "inner_mass": 1.6,
    "inner_damping": 50.0,
    "outer_end_mass": 0.0,
    "inner_end_mass": 0.0,
    "hardening": 0.0,  # 1/m2: stiffness grows by this times the square of the bending
    "loss_1": 0.0,  # N/m, springs of the relaxing elements that make structural damping
    "loss_2": 0.0,
    "loss_3": 0.0,
    "loss_4": 0.0,
    "slosh_share": 0.0,  # of the payload that is free to move
    "slosh_frequency": 60.0,  # rad/s
    "slosh_damping_ratio": 0.05,
    # mount: turning (counted at the outer tip) and sliding
    "mount_on": 0.0,
    "mount_stiffness": 1e9,
    "mount_mass": 100.0,
    "mount_damping": 0.0,
    "mount_inner_ratio": 1.0,  # length of the inner beam over that of the outer
    "slide_stiffness": 1e12,
    "slide_mass": 300.0,
    "slide_damping": 0.0,
    "sensor_on_mount": 0.0,  # share of the mount's motion that the sensor's reference takes part in
    # joint
    "joint_on": 0.0,
    "play": 0.0,
    "contact": 2e10,  # N/m^1.5
    "contact_loss": 0.2,  # s/m, Hunt and Crossley
    "rod_mass": 0.3,
    # cylinder and oil
    "area_a": 1.13e-4,
    "area_b": 1.13e-4,
    "metering": 0.0,  # 0: the valve meters what goes in; 1: both edges, as orifices without load
    "bulk_modulus": 1.3e9,
    "chamber_length": 0.0226,  # m, volume of each chamber at rest over its area
    "stroke_on": 0.0,  # whether the volumes go with the stroke
    "air_share": 0.0,  # free air at one atmosphere over the volume
    "air_exponent": 1.2,
    "air_saturation": 2e8,  # Pa, all air dissolved above this (Henry)
    "bristle_stiffness": 0.0,  # N/m; 0 takes the seal away
    "bristle_damping": 0.0,  # N s/m
    "coulomb": 0.0,
    "breakaway": 0.0,  # N, at least `coulomb`
    "stribeck_speed": 0.01,
    "stribeck_power": 2.0,
    "viscous": 0.0,
    # servovalve
    "flow_gain": 0.0113,
    "valve_frequency": 942.5,
    "valve_damping_ratio": 0.5,
    "leakage": 3.8e-13,
    "leakage_across": 0.5,  # share of the leakage that crosses the piston
    "supply": 20e6,
    "orifice": 0.0,  # 0: flow of a current whatever the load; 1: orifice law
    "laminar": 2e4,  # Pa, below which orifice flow is laminar
    "overlap": 0.0,  # A
    "overlap_rounding": 0.1,  # over the overlap
    "spool_friction": 0.0,  # A, Bouc-Wen
    "spool_travel": 1e-4,  # A, over which it builds up
    "spool_sharpness": 1.5,
    "magnet_width": 0.0,  # A, widest of the play operators
    "magnet_share": 0.0,  # of the current that goes through them
    "sag_droop": 0.0,  # Pa per m3/s: what the pump loses to flow
    "sag_rate": 0.0,  # 1/s; 0 takes the droop away
    "flow_drift": 0.0,  # relative, from start to end of the record
    # sensor
    "sensor_gain": 1180.0,
    "believed_sensor_gain": 1180.0,
    "filter_rate": 0.0,  # rad/s, the believed filter; 0 is none
    "lag_rate": 0.0,  # rad/s; 0 is none
    "lag_order": 1.0,
    "lag_damping_ratio": 0.8,
    "sensor_drift": 0.0,
    "sensor_cubic": 0.0,  # 1/m2
    "sensor_play": 0.0,  # m
    "bracket_rate": 0.0,  # rad/s, resonance of what holds the sensor; 0 is none
    "bracket_damping_ratio": 0.02,
    "bracket_share": 1.0,
    "dropouts_per_s": 0.0,
    "dropout_s": 0.02,
    # controller and amplifier
    "gain": 0.01,
    "pole": 10.0,
    "zero": 10.0,
    "delay": 0.0,  # s
    "current_limit": 0.0,  # A; 0 is none
    "current_knee": 10.0,
    "coil_rate": 0.0,  # rad/s; 0 is none
    "current_step": 0.0,  # A, of the digital output; 0 is none
    "current_hold": 0.0,  # s, its sampling interval
    "hum": 0.0,  # V
    "hum_rate": 314.159,
    "hum_phase": 0.0,
}
"""Names and values of a rig with nothing but the believed physics; the published rig's figures."""

RECORD = np.dtype([(name, "f8") for name in FIGURES])


def packed(given: Mapping[str, float]) -> np.ndarray:
    """One record of all figures, those not given as in `FIGURES`.

    Raises:
        KeyError: at a name that is not a figure.
    """
    record = np.zeros(1, dtype=RECORD)
    for name, value in FIGURES.items():
        record[name] = value
    for name, value in given.items():
        if name not in FIGURES:
            raise KeyError(name)
        record[name] = value
    return record
