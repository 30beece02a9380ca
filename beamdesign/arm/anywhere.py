"""Stability for a payload whose centre is known to lie within bounds only: all places and all masses at once.

The characteristic polynomial of `beamdesign.arm.both_planes` with the payload's place as parameters. It depends on the
offset a_x along the beam and, by symmetry, on the squares a_y^2 and a_z^2 of those to the sides; with
kappa = 1 + 3 a_x / 2L, c = 3 / 2L and the matrix A of the payload's inertia,

    A_yy = kappa^2 + c^2 a_y^2,    A_zz = kappa^2 + c^2 a_z^2,    A_tt = a_y^2 + a_z^2,
    A_yy A_zz - A_yz^2 = kappa^4 + kappa^2 c^2 A_tt,
    A_yy A_tt - A_yt^2 = kappa^2 a_y^2 + c^2 a_y^2 A_tt,    and the same in z.

Proved by zero exclusion in ball arithmetic. Where a_z is zero throughout, the planes part and each is proved by itself.
"""

from flint import fmpq, fmpq_mpoly, fmpq_mpoly_ctx

from beamdesign.arm.both_planes import BUDGET, MASS, both_planes, in_s, written
from beamdesign.arm.figures import arm_figures, arm_of, sensor_of
from beamdesign.arm.remaining import Vector
from beamdesign.polynomial import exact
from beamdesign.proof.box import BoxVerdict, box_of, certify_box
from beamdesign.proof.rational import text
from beamdesign.proof.rig_family import Family
from beamdesign.prototype import Prototype
from beamdesign.records import InputError

NAMES = (MASS, "along_m", "sideways_squared_m2", "upwards_squared_m2")
"""Parameters: payload (kg), a_x, a_y^2 and a_z^2."""


def prove_anywhere(
    prototype: Prototype, masses: tuple[float, float], within: Vector, budget: int = BUDGET
) -> dict[str, BoxVerdict]:
    """Prove or refute stability for every payload of a range and every place of its centre.

    Args:
        prototype: with the nominal place in its [arm].
        masses: range of payloads, kg.
        within: how far the centre may be from there along x, y and z, either way, m.
        budget: most pieces to look at.

    Returns:
        One verdict for both planes ("both"), or one each ("y", "z") where the centre stays at z = 0. It may be None.

    Raises:
        InputError: as `beamdesign.arm.both_planes.both_planes`, and for servos that measure elsewhere than at the tip.
        ValueError: for a negative bound.
    """
    if any(sensor_of(prototype)):
        reason = "a payload anywhere is proved for servos that measure at the tip; remove it"
        raise InputError(prototype.name, [("arm.sensor_m", reason)])
    if min(within) < 0:
        raise ValueError(f"a distance must not be negative, is {min(within):g}")
    centre = [exact(value) for value in arm_of(prototype).offset_m]
    reach = [exact(value) for value in within]
    x, y, z = ((middle - far, middle + far) for middle, far in zip(centre, reach, strict=True))
    ranges = {MASS: (exact(masses[0]), exact(masses[1])), NAMES[1]: x, NAMES[2]: _squared(*y), NAMES[3]: _squared(*z)}
    known = {name: low for name, (low, high) in ranges.items() if low == high}
    stands = "".join(f", {name} {text(value)}" for name, value in known.items())
    found = {}
    for name, whole in _characteristic(prototype, z == (0, 0)).items():
        polynomial = whole.subs(known)
        own = {key: ranges[key] for key, degree in zip(NAMES, polynomial.degrees()[1:], strict=True) if degree}
        planes = "both planes" if name == "both" else f"plane {name}"
        family = Family(
            f"{prototype.name}, payload anywhere, {planes}{stands}",
            written(polynomial),
            {key: (low + high) / 2 for key, (low, high) in own.items()},
        )
        found[name] = certify_box(family, box_of(own), budget, volumes=False)
    return found


def _squared(low: fmpq, high: fmpq) -> tuple[fmpq, fmpq]:
    """Range of the square of what lies in a range."""
    ends = low * low, high * high
    return (fmpq(0) if low <= 0 <= high else min(ends)), max(ends)


def _characteristic(prototype: Prototype, level: bool) -> dict[str, fmpq_mpoly]:
    """In s and the parameters, of both planes or, for a payload at z = 0, of each."""
    model, length = both_planes(prototype), exact(arm_figures(prototype).length)
    context = fmpq_mpoly_ctx.get(["s", *NAMES], "lex")
    s, mass, along, sideways, upwards = context.gens()
    t = in_s(model.torsion, s)
    (p_y, q_y), (p_z, q_z) = (
        (in_s(loop.characteristic.constant, s), s**2 * in_s(loop.disturbance, s)) for loop in model.loops
    )
    travel = (1 + along * (fmpq(3, 2) / length)) ** 2
    c = fmpq(9, 4) / length**2
    in_y, in_z = travel + c * sideways, travel + c * upwards
    if level:
        turned = travel * q_z * t + sideways * p_z * s**2
        return {"y": p_y + mass * in_y * q_y, "z": p_z * t + mass * turned}
    twist = sideways + upwards
    # The principal minors of order two, as in the docstring on top.
    both = travel**2 + c * travel * twist
    y_twist, z_twist = (travel * side + c * side * twist for side in (sideways, upwards))
    first = in_y * q_y * p_z * t + in_z * p_y * q_z * t + twist * p_y * p_z * s**2
    second = both * q_y * q_z * t + y_twist * q_y * p_z * s**2 + z_twist * p_y * q_z * s**2
    return {"both": p_y * p_z * t + mass * first + mass**2 * second}
