"""The true rig's right-hand side, where figures switch its laws on."""

from math import sin, sqrt, tanh

import numpy as np
from numba import njit

from beamdesign.validation.truth.beams import ALONG, AT_TIP, PAYLOAD, WATCHED
from beamdesign.validation.truth.laws import aerated, contact, flanks, knee, orifice, overlapped, played, stribeck
from beamdesign.validation.truth.nominal import LAW_ORDER, MODES

PLAYS = 5

# Places in the state.
_Q, _QD = 0, MODES  # modes of the outer beam, each counted at the tip
_XI, _VI, _XR, _VR = 8, 9, 10, 11  # inner tip, rod
_PA, _PB = 12, 13  # chamber pressures beyond those at rest
_S, _SD = 14, 15  # spool, A, and its rate
_Z = 16  # bristles
_L1, _L2, _F = 17, 18, 19  # sensor lag, believed filter
_N = 20  # travel of a screw's nut
_T, _TD, _Y, _YD = 21, 22, 23, 24  # mount
_W = 25  # spool friction
_I = 26  # coil current
_PS = 27  # supply beyond that at rest
_M, _MD = 28, 29  # free part of the payload
_E = 30  # four relaxing elements
_B, _BD = 34, 35  # sensor bracket
_A, _AD = 36, 37  # what swings on a tip
_ND, _J = 38, 39  # speed of the nut, current of its motor
_C = 40  # controller
STATES = _C + LAW_ORDER
TIP, INNER, PRESSURE_A, PRESSURE_B, BRISTLE, SPOOL_FRICTION, SUPPLY, NUT = _Q, _XI, _PA, _PB, _Z, _W, _PS, _N
TIP_SPEED, INNER_SPEED, NUT_SPEED = _QD, _VI, _ND
_RELAX = (6.0, 60.0, 600.0, 6000.0)


@njit(cache=True, error_model="numpy")
def moved(x, first, modes, place):  # type: ignore[no-untyped-def]
    """Motion of a place on the outer beam's end, a row of `modes`, by states from `first` on."""
    whole = 0.0
    for k in range(modes.shape[1]):
        whole += modes[place, k] * x[first + k]
    return whole


@njit(cache=True, error_model="numpy")
def sensor_volts(x, f, modes, time_share):  # type: ignore[no-untyped-def]
    """What the sensor makes of the place that it watches before lag and filter, V."""
    there = moved(x, _Q, modes, WATCHED)
    seen = there - f.sensor_on_mount * (x[_T] + x[_Y])
    if f.bracket_rate > 0.0:
        seen = seen + f.bracket_share * (x[_B] - there)
    seen = seen * (1.0 + f.sensor_square * seen + f.sensor_cubic * seen * seen)
    return f.sensor_gain * (1.0 + f.sensor_drift * time_share) * seen


@njit(cache=True, error_model="numpy")
def measured_volts(x, f, modes, time_share):  # type: ignore[no-untyped-def]
    """Sensor signal after lag and filter, V."""
    if f.filter_rate > 0.0:
        return x[_F]
    if f.lag_rate > 0.0:
        return x[_L1]
    return sensor_volts(x, f, modes, time_share)


@njit(cache=True, error_model="numpy")
def error_volts(f, fed_back, command, time):  # type: ignore[no-untyped-def]
    """Error that the controller hears, V."""
    error = command - fed_back
    if f.hum > 0.0:
        error += f.hum * sin(f.hum_rate * time + f.hum_phase)
    return error


@njit(cache=True, error_model="numpy")
def law_row(row, x, f, error, command):  # type: ignore[no-untyped-def]
    """One row of the controller's matrices times its states and what it hears."""
    weighed = f.law[row, LAW_ORDER] * error + f.law[row, LAW_ORDER + 3] * command
    weighed -= f.law[row, LAW_ORDER + 1] * x[_XI] + f.law[row, LAW_ORDER + 2] * (x[_PA] - x[_PB])
    for k in range(int(f.law_order)):
        weighed += f.law[row, k] * x[_C + k]
    return weighed


@njit(cache=True, error_model="numpy")
def commanded_current(x, f, fed_back, command, time):  # type: ignore[no-untyped-def]
    """Current the controller asks for, A."""
    return f.gain * law_row(LAW_ORDER, x, f, error_volts(f, fed_back, command, time), command)


@njit(cache=True, error_model="numpy")
def oil_push(x, d, f, plays, current, stroke, speed, share):  # type: ignore[no-untyped-def]
    """Servovalve and cylinder: rates of their states into `d`; gives the force that drives the tips apart, N."""
    # servovalve
    drive = current
    if f.magnet_share > 0.0:
        lagging = 0.0
        for k in range(PLAYS):
            lagging += played(current, plays[k], f.magnet_width * (k + 1) / PLAYS)
        drive = (1.0 - f.magnet_share) * current + f.magnet_share * lagging / PLAYS
    if f.spool_friction > 0.0:
        z = min(max(x[_W], -1.0), 1.0)
        drive -= f.spool_friction * z
        pace = x[_SD] / f.spool_travel
        d[_W] = pace - abs(z) ** f.spool_sharpness * (0.5 * abs(pace) * (1.0 if z > 0 else -1.0) + 0.5 * pace)
    d[_S] = x[_SD]
    d[_SD] = f.valve_frequency**2 * (drive - x[_S]) - 2.0 * f.valve_damping_ratio * f.valve_frequency * x[_SD]
    opening = x[_S]
    if f.overlap > 0.0:
        opening = overlapped(opening, f.overlap, f.overlap_rounding)
    flow = f.flow_gain * opening * (1.0 + f.flow_drift * share)
    supply = f.supply
    if f.sag_rate > 0.0:
        supply = max(f.supply + x[_PS], 0.02 * f.supply)
        d[_PS] = f.sag_rate * (-x[_PS] - f.sag_droop * abs(flow))
        flow *= sqrt(supply / f.supply)

    # oil
    mean = 0.5 * (f.area_a + f.area_b)
    rest_a = f.supply * f.area_b / (2.0 * mean)
    rest_b = f.supply - rest_a
    pressure_a, pressure_b = rest_a + x[_PA], rest_b + x[_PB]
    if f.metering > 0.5:
        way = sqrt((f.area_a if flow > 0.0 else f.area_b) / mean)
        into_a, from_b = flow * way * f.area_a / mean, flow * way * f.area_b / mean
    elif flow > 0.0:
        into_a, from_b = flow, flow * f.area_b / f.area_a
    else:
        into_a, from_b = flow * f.area_a / f.area_b, flow
    if f.orifice > 0.0:
        scale = flow / orifice(0.5 * f.supply, f.laminar)
        if flow > 0.0:
            free_a = scale * orifice(supply - pressure_a, f.laminar)
            free_b = scale * orifice(pressure_b, f.laminar)
        else:
            free_a = scale * orifice(pressure_a, f.laminar)
            free_b = scale * orifice(supply - pressure_b, f.laminar)
        into_a += f.orifice * (free_a - into_a)
        from_b += f.orifice * (free_b - from_b)
    leakage = f.leakage * (1.0 + 10.0 * f.warming * share)
    across = leakage * f.leakage_across * (x[_PA] - x[_PB])
    across += f.leakage * f.leakage_growth * abs(x[_PA] - x[_PB]) * (x[_PA] - x[_PB])
    at_edges = 2.0 * leakage * (1.0 - f.leakage_across)
    into_a -= across + at_edges * x[_PA]
    from_b -= across - at_edges * x[_PB]

    bulk_a = bulk_b = f.bulk_modulus * (1.0 - f.warming * share)
    if f.air_share > 0.0:
        bulk_a = aerated(pressure_a, f.bulk_modulus, f.air_share, f.air_exponent, f.air_saturation)
        bulk_b = aerated(pressure_b, f.bulk_modulus, f.air_share, f.air_exponent, f.air_saturation)
    moved = f.stroke_on * min(max(stroke, -0.9 * f.chamber_length), 0.9 * f.chamber_length)
    d[_PA] = bulk_a * (into_a - f.area_a * speed) / (f.area_a * (f.chamber_length + moved))
    d[_PB] = bulk_b * (f.area_b * speed - from_b) / (f.area_b * (f.chamber_length - moved))
    # No tension in real oil. Where there is air, the cavity is the air's own, so soft that the pressure hardly falls,
    # and it has to be filled again; cut off, its volume would be forgotten.
    if f.orifice > 0.5 and f.air_share == 0.0:
        if pressure_a < -0.9e5 and d[_PA] < 0.0:
            d[_PA] = 0.0
        if pressure_b < -0.9e5 and d[_PB] < 0.0:
            d[_PB] = 0.0
    return f.area_a * x[_PA] - f.area_b * x[_PB]


@njit(cache=True, error_model="numpy")
def rubbing(x, d, f, speed, squeeze):  # type: ignore[no-untyped-def]
    """Friction against a sliding speed, N; `squeeze` is what presses the faces: load pressure, or a screw's force."""
    rub = f.drag * abs(speed) * speed
    if f.bristle_stiffness > 0.0:
        limit = stribeck(speed, f.coulomb, f.breakaway, f.stribeck_speed, f.stribeck_power)
        largest = f.breakaway / f.bristle_stiffness
        z = min(max(x[_Z], -largest), largest)
        d[_Z] = speed - f.bristle_stiffness * abs(speed) * z / limit
        fade = 1.0 / (1.0 + (speed / f.stribeck_speed) ** 2)
        rub += f.bristle_stiffness * z + f.bristle_damping * fade * d[_Z] + f.viscous * speed
    if f.squeezed > 0.0:
        rub += f.squeezed * abs(squeeze) * tanh(speed / f.squeezed_speed)
    return rub


@njit(cache=True, error_model="numpy")
def screw_push(x, d, f, current, stroke, speed, share):  # type: ignore[no-untyped-def]
    """Motor and screw: rates of their states into `d`; gives the force that drives the tips apart, N.

    The shaft's balance of torques is over the angle, travel / lead. The nut rubs on the screw, before its spring.
    """
    rotation = x[_ND] / f.lead
    asked = current - f.speed_feedback * rotation
    if f.motor_limit > 0.0:
        asked = knee(asked, f.motor_limit, f.motor_knee)
    d[_J] = f.current_loop * (asked - x[_J])
    torque = f.torque_constant * (1.0 + f.torque_drift * share) * x[_J]
    if f.torque_ripple > 0.0:
        torque *= 1.0 + f.torque_ripple * sin(f.ripple_per_turn * x[_N] / f.lead)
    push = flanks(x[_N] - stroke, x[_ND] - speed, f.lost_motion, f.screw_stiffness, f.screw_damping)
    torque -= f.lead * (push + rubbing(x, d, f, x[_ND], push)) + f.rotor_friction * rotation
    d[_N], d[_ND] = x[_ND], f.lead * torque / f.rotor_inertia
    return push


@njit(cache=True, error_model="numpy")
def rates_into(x, d, f, modes, held, plays, fed_back, command, force, time, share):  # type: ignore[no-untyped-def]
    """Time derivative of the state into `d`; gives the current, A.

    `held` is the current of a digital output (not a number for an analogue one), `modes` has the rows of
    `beams.at_end`.
    """
    count = modes.shape[1]
    tip, tip_speed = moved(x, _Q, modes, AT_TIP), moved(x, _QD, modes, AT_TIP)

    # controller and amplifier
    demand = held if held == held else commanded_current(x, f, fed_back, command, time)
    error = error_volts(f, fed_back, command, time)
    for k in range(int(f.law_order)):
        d[_C + k] = law_row(k, x, f, error, command)
    current = knee(demand, f.current_limit, f.current_knee) if f.current_limit > 0.0 else demand
    if f.coil_rate > 0.0:
        d[_I] = f.coil_rate * (current - x[_I])
        current = x[_I]

    # actuator
    rod, rod_speed = (x[_XR], x[_VR]) if f.joint_on > 0.0 else (x[_XI], x[_VI])
    stroke, speed = tip - rod, tip_speed - rod_speed
    if f.lead > 0.0:
        push = screw_push(x, d, f, current, stroke, speed, share)
    else:
        push = oil_push(x, d, f, plays, current, stroke, speed, share)
        push -= rubbing(x, d, f, speed, x[_PA] - x[_PB])

    # joint
    on_inner = push
    if f.joint_on > 0.0:
        on_inner = -contact(rod - x[_XI], rod_speed - x[_VI], f.play, f.contact, f.contact_loss)
        d[_XR] = x[_VR]
        d[_VR] = (on_inner - push) / f.rod_mass

    # beams and mount
    outer_base, inner_base, outer_base_speed, inner_base_speed = 0.0, 0.0, 0.0, 0.0
    if f.mount_on > 0.0:
        outer_base, outer_base_speed = x[_T] + x[_Y], x[_TD] + x[_YD]
        inner_base = f.mount_inner_ratio * x[_T] + x[_Y]
        inner_base_speed = f.mount_inner_ratio * x[_TD] + x[_YD]
    bent, bent_speed = x[_Q] - outer_base, x[_QD] - outer_base_speed
    first = modes[0, 0] * bent * (1.0 + f.hardening * bent * bent) + modes[2, 0] * bent_speed
    if f.loss_1 > 0.0:
        for k in range(4):
            spring = f.loss_1 if k == 0 else (f.loss_2 if k == 1 else (f.loss_3 if k == 2 else f.loss_4))
            first += spring * (bent - x[_E + k])
            d[_E + k] = _RELAX[k] * (bent - x[_E + k])
    inner_bent = x[_XI] - inner_base
    inner = f.inner_stiffness * inner_bent * (1.0 + f.hardening * inner_bent * inner_bent)
    inner += f.inner_damping * (x[_VI] - inner_base_speed)
    if f.mount_on > 0.0:
        d[_T], d[_Y] = x[_TD], x[_YD]
        turning = first + f.mount_inner_ratio * inner - f.mount_stiffness * x[_T] - f.mount_damping * x[_TD]
        d[_TD] = turning / f.mount_mass
        d[_YD] = (first + inner - f.slide_stiffness * x[_Y] - f.slide_damping * x[_YD]) / f.slide_mass
    pull = force + push - f.cable * max(0.0, tip)
    if f.appendage_mass > 0.0:
        at, at_speed = (x[_XI], x[_VI]) if f.appendage_inner > 0.5 else (tip, tip_speed)
        d[_A] = x[_AD]
        d[_AD] = f.appendage_rate**2 * (at - x[_A])
        d[_AD] += 2.0 * f.appendage_damping_ratio * f.appendage_rate * (at_speed - x[_AD])
        if f.appendage_inner > 0.5:
            inner += f.appendage_mass * d[_AD]
        else:
            pull -= f.appendage_mass * d[_AD]
    d[_XI] = x[_VI]
    d[_VI] = (-on_inner - inner) / (f.inner_mass + f.inner_end_mass)

    # The payload moves in the plane and, where the end turns it, along the beam; what holds it acts back on all modes.
    carried, on_payload = f.outer_end_mass, 0.0
    if f.slosh_share > 0.0 and carried > 0.0:
        loose = f.slosh_share * carried
        tether = f.slosh_frequency**2 * (x[_M] - moved(x, _Q, modes, PAYLOAD))
        tether += 2.0 * f.slosh_damping_ratio * f.slosh_frequency * (x[_MD] - moved(x, _QD, modes, PAYLOAD))
        d[_M], d[_MD] = x[_MD], -tether
        on_payload = loose * tether
        carried -= loose
    across, along, mobility, turned, both = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(count):
        reaction = first if k == 0 else modes[0, k] * x[_Q + k] + modes[2, k] * x[_QD + k]
        driving = modes[AT_TIP, k] * pull + modes[PAYLOAD, k] * on_payload
        d[_QD + k] = (driving - reaction) / modes[1, k]
        d[_Q + k] = x[_QD + k]
        across += modes[PAYLOAD, k] * d[_QD + k]
        along += modes[ALONG, k] * d[_QD + k]
        mobility += modes[PAYLOAD, k] ** 2 / modes[1, k]
        turned += modes[ALONG, k] ** 2 / modes[1, k]
        both += modes[PAYLOAD, k] * modes[ALONG, k] / modes[1, k]
    one, other = 1.0 + carried * mobility, 1.0 + carried * turned
    whole = one * other - (carried * both) ** 2
    inertia = carried * (across * other - carried * both * along) / whole
    drawn = carried * (along * one - carried * both * across) / whole
    for k in range(count):
        d[_QD + k] -= (modes[PAYLOAD, k] * inertia + modes[ALONG, k] * drawn) / modes[1, k]

    # sensor
    if f.bracket_rate > 0.0:
        d[_B] = x[_BD]
        there, there_speed = moved(x, _Q, modes, WATCHED), moved(x, _QD, modes, WATCHED)
        d[_BD] = f.bracket_rate**2 * (there - x[_B])
        d[_BD] += 2.0 * f.bracket_damping_ratio * f.bracket_rate * (there_speed - x[_BD])
    volts = plays[PLAYS] if f.sensor_play > 0.0 else sensor_volts(x, f, modes, share)
    if f.lag_rate > 0.0:
        if f.lag_order > 1.5:
            d[_L1] = x[_L2]
            d[_L2] = f.lag_rate**2 * (volts - x[_L1]) - 2.0 * f.lag_damping_ratio * f.lag_rate * x[_L2]
        else:
            d[_L1] = f.lag_rate * (volts - x[_L1])
    if f.filter_rate > 0.0:
        d[_F] = f.filter_rate * ((x[_L1] if f.lag_rate > 0.0 else volts) - x[_F])
    return current


@njit(cache=True, error_model="numpy")
def rates_at(x, figures, modes, command=0.0, force=0.0):  # type: ignore[no-untyped-def]
    """(52,) time derivative of a state without dead time; nothing drives the rig but command (V) and force (N)."""
    f = figures[0]
    d, plays = np.zeros(STATES), np.zeros(PLAYS + 1)
    rates_into(x, d, f, modes, np.nan, plays, measured_volts(x, f, modes, 0.0), command, force, 0.0, 0.0)
    return d
