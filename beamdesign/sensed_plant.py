"""The linear plant as a controller with added sensors has it, over the outer end mass, exact.

One actuator drives it and one force disturbs it, so that every closed-loop transfer function follows from the
numerators N of the open one and its denominator D. With the law u = -sum_k C_k y_k, the tip's compliance is

    x / F = (N_xF + sum_k C_k M_k) / (D + sum_k C_k N_ku),    M_k = (N_xF N_ku - N_xu N_kF) / D.

M_k is a polynomial: a second minor of adj(sI - A) is the determinant times the complementary minor (Jacobi; R. A. Horn
and C. R. Johnson, Matrix Analysis, 2nd ed. 2013, section 0.8.4). The outer end mass m adds m s^2 x to the force on the
tip. So D = D_0 + m s^2 N_xF, N_ku = N_ku0 + m s^2 M_k, and all other numerators are free of m.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from flint import fmpq, fmpq_mat, fmpq_poly

from beamdesign.linear import LinearRig
from beamdesign.members import MemberRig
from beamdesign.polynomial import Affine, exact
from beamdesign.rig import twin_beam
from beamdesign.rig.linearised import SEEN

_OUTPUTS = {"displacement_m": "measured_V"} | {name: name for name in twin_beam.ADDED_OUTPUTS}
"""By what is sensed, the name in `SEEN` of what the controller is given of it."""


@dataclass(frozen=True)
class SensedPlant:
    """A plant of several sensors over the outer end mass m (kg), in exact rationals of the given figures.

    Attributes:
        sensors: what is sensed, see `beamdesign.observer.SENSED`.
        denominator: characteristic polynomial in s, affine in m.
        control: one per sensor: numerator from current (A) to volts, to m or to Pa, affine in m.
        force: one per sensor: numerator from tip force (N) to the same, free of m.
        displaced: numerator from current (A) to the tip's displacement (m), free of m.
        disturbance: numerator from tip force (N) to the tip's displacement (m), free of m.
        crossed: one per sensor: (disturbance control - displaced force) / denominator, free of m.
    """

    sensors: tuple[str, ...]
    denominator: Affine
    control: tuple[Affine, ...]
    force: tuple[fmpq_poly, ...]
    displaced: fmpq_poly
    disturbance: fmpq_poly
    crossed: tuple[fmpq_poly, ...]


def sensed_plant(rig: LinearRig | MemberRig, sensors: Sequence[str], inner_end_mass: float = 0.0) -> SensedPlant:
    """The plant of a rig with the given mass (kg) added to the inner beam, as these sensors see it.

    Raises:
        ArithmeticError: where the outer end mass enters the rig with more than rank one.
    """
    inner = exact(inner_end_mass)
    bare, loaded, twice = (_transfers(rig, sensors, fmpq(mass), inner) for mass in (0, 1, 2))
    families = [Affine(one, other - one) for one, other in zip(bare, loaded, strict=True)]
    if any(family.at(fmpq(2)) != seen for family, seen in zip(families, twice, strict=True)):
        raise ArithmeticError("the outer end mass enters this rig with more than rank one")
    denominator, disturbance, displaced = families[0], _free(families[1]), _free(families[2])
    control = tuple(families[3::2])
    force = tuple(_free(family) for family in families[4::2])
    crossed = tuple(
        _quotient(control * disturbance + Affine(-displaced * force, fmpq_poly([0])), denominator)
        for control, force in zip(control, force, strict=True)
    )
    return SensedPlant(tuple(sensors), denominator, control, force, displaced, disturbance, crossed)


def _free(family: Affine) -> fmpq_poly:
    if not family.slope.is_zero():
        raise ArithmeticError("a numerator that is to be free of the outer end mass is not")
    return family.constant


def _quotient(above: Affine, below: Affine) -> fmpq_poly:
    """The polynomial, free of the mass, by which one family is a multiple of another."""
    found, rest = divmod(above.constant, below.constant)
    if not rest.is_zero() or found * below.slope != above.slope:
        raise ArithmeticError("a second minor is no multiple of the determinant")
    return found


def _transfers(rig: LinearRig | MemberRig, sensors: Sequence[str], outer: fmpq, inner: fmpq) -> list[fmpq_poly]:
    """Denominator, numerators to the tip's displacement from force and current, and to each sensor from both.

    All to a common factor that is free of the masses.
    """
    if isinstance(rig, MemberRig):
        to_sensors = [(source, SEEN.index(_OUTPUTS[name])) for name in sensors for source in (1, 0)]
        return rig.transfers(outer, inner, [(0, 0), (1, 0), *to_sensors])
    mass, a, b, c = rig.exact_matrices(outer, inner)
    added = rig.exact_added_rows()
    n, factor = a.nrows(), mass.det()
    inverse = mass.inv()
    a, b = inverse * a, inverse * b
    bare = a.charpoly()
    rows = {"tip": [c[0, j] for j in range(n)], "displacement_m": [c[1, j] for j in range(n)]}
    rows |= {name: [added[i, j] for j in range(n)] for i, name in enumerate(twin_beam.ADDED_OUTPUTS)}

    def numerator(source: int, output: str) -> fmpq_poly:
        # det(sI - A + b c) = det(sI - A) + c adj(sI - A) b.
        dyad = fmpq_mat(n, n, [b[i, source] * value for i in range(n) for value in rows[output]])
        return factor * ((a - dyad).charpoly() - bare)

    wanted = [(0, "tip"), (1, "tip"), *((source, name) for name in sensors for source in (1, 0))]
    return [factor * bare, *(numerator(*pair) for pair in wanted)]
