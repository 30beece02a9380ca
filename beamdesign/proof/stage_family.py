"""The closed loop with each law of a scheduled controller, in states that all laws share and none resets.

The states that the laws hand over are the current itself and, where there are second-order sections, their outputs and
the rates of those: a law works on the past of its signals, whichever law made it. So nothing jumps at a change of
stage, the current least of all. With e the error volts, u_0 = e, the sections in series before the lag,

    u_k'' = p^2 (u_(k-1) + 2 d u_(k-1)' / z + u_(k-1)'' / z^2 - u_k) - 2 c p u_k',
    i'    = w_p (K u_n - i) + K (w_p / w_z) u_n'.

Sampled, that is the difference equation i_k = b0 e_k + b1 e_(k-1) - a1 i_(k-1), whose memory is e and i.
"""

from collections.abc import Sequence
from math import pi

from flint import fmpq, fmpq_mat

from beamdesign.controllers import Cascade
from beamdesign.linear import LinearModel
from beamdesign.members import paper_model
from beamdesign.polynomial import exact
from beamdesign.proof.mass_family import Families, MassFamily, closed_loop
from beamdesign.prototype import Prototype
from beamdesign.records import InputError

Row = list[fmpq]


def stage_families(prototype: Prototype) -> Families:
    """The matrices A(m) with every law of a prototype's controller; those of several in the same states.

    Raises:
        InputError: where the prototype carries effects, or where one of several laws has sections and no filter before
            them: they would feel accelerations, which the mass sets.
        ValueError: without a controller.
    """
    if prototype.schedule is None:
        return (closed_loop(prototype),)
    plant, inner = paper_model(prototype), exact(prototype.payload.inner_end_mass_kg)
    try:
        return tuple(stage_family(plant, inner, stage.law) for stage in prototype.schedule.stage)
    except ValueError as error:
        raise InputError(prototype.name, [("sensor.filter_Hz", str(error))]) from error


def stage_family(rig: LinearModel, inner_end_mass: fmpq, law: Cascade) -> MassFamily:
    """The matrices A(m) of one law; states of the rig, outputs and rates of its sections, then its current.

    Raises:
        ValueError: for sections without a filter before them.
    """
    free, driven, sensed, velocity, bare_mass = rig.over_outer_mass(inner_end_mass)
    names, n = rig.states, free.nrows()
    lag, sections = law.lag, law.sections
    assert lag is not None
    order = n + 2 * len(sections) + 1
    rows = [[fmpq(0)] * order for _ in range(order)]
    for i in range(n):
        for j in range(n):
            rows[i][j] = free[i, j]
        rows[i][order - 1] = driven[i, 1]

    error = [-sensed[1, j] for j in range(n)] + [fmpq(0)] * (order - n)
    rate = _derivative(error, rows, velocity)
    signal, slope = error, rate
    curvature = _derivative(rate, rows, velocity) if sections else None
    for k, section in enumerate(sections):
        zero, pole = exact(2 * pi * section.zero_Hz), exact(2 * pi * section.pole_Hz)
        zeta, own = exact(section.zero_damping_ratio), exact(section.pole_damping_ratio)
        assert curvature is not None
        out, moving = _unit(order, n + 2 * k), _unit(order, n + 2 * k + 1)
        bent = [
            pole**2 * (s + 2 * zeta * r / zero + c / zero**2 - o) - 2 * own * pole * v
            for s, r, c, o, v in zip(signal, slope, curvature, out, moving, strict=True)
        ]
        rows[n + 2 * k], rows[n + 2 * k + 1] = moving, bent
        signal, slope, curvature = out, moving, bent
    gain, upper, lower = exact(law.gain_A_per_V), exact(2 * pi * lag.zero_Hz), exact(2 * pi * lag.pole_Hz)
    current = _unit(order, order - 1)
    rows[order - 1] = [
        lower * (gain * s - i) + gain * lower / upper * r for s, r, i in zip(signal, slope, current, strict=True)
    ]

    fixed, inertial = _matrix(rows), fmpq_mat(order, order)
    for j in range(order):
        inertial[velocity, j], fixed[velocity, j] = fixed[velocity, j], fmpq(0)
    more = [f"section_{k + 1}_{name}" for k in range(len(sections)) for name in ("V", "V_per_s")]
    return MassFamily(fixed, inertial, bare_mass, velocity, (*names, *more, "current_A"))


def _derivative(signal: Row, rows: Sequence[Row], velocity: int) -> Row:
    """The rate of a linear function of the states."""
    if signal[velocity] != 0:
        raise ValueError(
            "second-order sections need a filter before them (sensor.filter_Hz): without one they feel the"
            " acceleration of the tip, which jumps with the mass"
        )
    return [
        sum((weight * row[j] for weight, row in zip(signal, rows, strict=True) if weight), fmpq(0))
        for j in range(len(signal))
    ]


def _unit(order: int, place: int) -> Row:
    return [fmpq(int(j == place)) for j in range(order)]


def _matrix(rows: Sequence[Row]) -> fmpq_mat:
    return fmpq_mat(len(rows), len(rows), [entry for row in rows for entry in row])
