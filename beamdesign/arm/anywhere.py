"""Stability for a payload whose centre is known to lie within bounds only: all places and all masses at once.

The characteristic polynomial of `beamdesign.arm.both_planes` with the payload's place as parameters. It depends on the
offset a_x along the beam and, by symmetry, on the squares a_y^2 and a_z^2 of those to the sides; with
kappa = 1 + 3 a_x / 2L, c = 3 / 2L and the matrix A of the payload's inertia,

    A_yy = kappa^2 + c^2 a_y^2,    A_zz = kappa^2 + c^2 a_z^2,    A_tt = a_y^2 + a_z^2,
    A_yy A_zz - A_yz^2 = kappa^4 + kappa^2 c^2 A_tt,
    A_yy A_tt - A_yt^2 = kappa^2 a_y^2 + c^2 a_y^2 A_tt,    and the same in z.

Proved by zero exclusion in ball arithmetic. Where a_z is zero throughout, the planes part and each is proved by itself.
"""

from collections.abc import Mapping
from itertools import product

from flint import fmpq, fmpq_poly

from beamdesign.arm.both_planes import BUDGET, MASS, both_planes
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

_Parametric = dict[tuple[int, int, int, int], fmpq_poly]
"""Powers of the parameters to polynomials in s."""

_S2 = fmpq_poly([0, 0, 1])


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
    known = {k: low for k, (low, high) in enumerate(ranges.values()) if low == high}
    stands = "".join(f", {NAMES[k]} {text(value)}" for k, value in known.items())
    found = {}
    for name, whole in _characteristic(prototype, z == (0, 0)).items():
        polynomial = _with(whole, known)
        used = [key for k, key in enumerate(NAMES) if any(powers[k] for powers in polynomial)]
        own = {key: ranges[key] for key in used}
        planes = "both planes" if name == "both" else f"plane {name}"
        family = Family(
            f"{prototype.name}, payload anywhere, {planes}{stands}",
            _written(polynomial),
            {key: (low + high) / 2 for key, (low, high) in own.items()},
        )
        found[name] = certify_box(family, box_of(own), budget, volumes=False)
    return found


def _squared(low: fmpq, high: fmpq) -> tuple[fmpq, fmpq]:
    """Range of the square of what lies in a range."""
    ends = low * low, high * high
    return (fmpq(0) if low <= 0 <= high else min(ends)), max(ends)


def _characteristic(prototype: Prototype, level: bool) -> Mapping[str, _Parametric]:
    model, length = both_planes(prototype), exact(arm_figures(prototype).length)
    t = model.torsion
    (p_y, q_y), (p_z, q_z) = ((loop.characteristic.constant, _S2 * loop.disturbance) for loop in model.loops)
    one = _parameter(0, 0, 0, 0)
    mass, sideways, upwards = _parameter(1, 0, 0, 0), _parameter(0, 0, 1, 0), _parameter(0, 0, 0, 1)
    travel = _sum(one, _times(_parameter(0, 1, 0, 0), fmpq_poly([fmpq(3, 2) / length])))
    travel = _product(travel, travel)
    c = fmpq_poly([fmpq(9, 4) / length**2])
    in_y, in_z = _sum(travel, _times(sideways, c)), _sum(travel, _times(upwards, c))
    if level:
        turned = _sum(_times(travel, q_z * t), _times(sideways, p_z * _S2))
        return {
            "y": _sum(_times(one, p_y), _product(mass, _times(in_y, q_y))),
            "z": _sum(_times(one, p_z * t), _product(mass, turned)),
        }
    twist = _sum(sideways, upwards)
    # The principal minors of order two, as in the docstring on top.
    both = _sum(_product(travel, travel), _times(_product(travel, twist), c))
    y_twist, z_twist = (_sum(_product(travel, side), _times(_product(side, twist), c)) for side in (sideways, upwards))
    first = _sum(_times(in_y, q_y * p_z * t), _times(in_z, p_y * q_z * t), _times(twist, p_y * p_z * _S2))
    second = _sum(_times(both, q_y * q_z * t), _times(y_twist, q_y * p_z * _S2), _times(z_twist, p_y * q_z * _S2))
    squared = _product(mass, mass)
    return {"both": _sum(_times(one, p_y * p_z * t), _product(mass, first), _product(squared, second))}


def _parameter(*powers: int) -> _Parametric:
    m, x, y, z = powers
    return {(m, x, y, z): fmpq_poly([1])}


def _sum(*parts: _Parametric) -> _Parametric:
    total: _Parametric = {}
    for part in parts:
        for powers, polynomial in part.items():
            total[powers] = total.get(powers, fmpq_poly([0])) + polynomial
    return total


def _times(part: _Parametric, polynomial: fmpq_poly) -> _Parametric:
    return {powers: own * polynomial for powers, own in part.items()}


def _product(one: _Parametric, other: _Parametric) -> _Parametric:
    total: _Parametric = {}
    for (a, p), (b, q) in product(one.items(), other.items()):
        powers = (a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3])
        total[powers] = total.get(powers, fmpq_poly([0])) + p * q
    return total


def _with(part: _Parametric, known: Mapping[int, fmpq]) -> _Parametric:
    """With the values of some parameters put in, by their place among `NAMES`."""
    total: _Parametric = {}
    for powers, polynomial in part.items():
        factor = fmpq(1)
        for k, value in known.items():
            factor *= value ** powers[k]
        m, x, y, z = (0 if k in known else power for k, power in enumerate(powers))
        total = _sum(total, {(m, x, y, z): polynomial * factor})
    return total


def _written(part: _Parametric) -> str:
    """As `beamdesign.proof.box_statement` reads it."""
    terms = []
    for powers, polynomial in part.items():
        factors = "".join(f"*{name}**{power}" for name, power in zip(NAMES, powers, strict=True) if power)
        for i, c in enumerate(polynomial.coeffs()):
            if c != 0:
                terms.append(f"({text(c) if c.q == 1 else f'{c.p}/{c.q}'})*s**{i}{factors}")
    return " + ".join(terms)
