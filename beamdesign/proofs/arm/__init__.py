"""The link as an arm: two compensators across each other, torsion of the outer beam, and what error they leave.

Axes: x along the beam away from the clamp, y sideways, z upwards; everything is seen from the tip, where actuators and
sensors are. The payload's centre stands at `offset_m` from there.

One inner beam with two actuators at right angles is what is modelled, not a pair of inner beams: a square or round tube
has the same second moment about every axis (a rectangle is refused), so that one tube serves both directions at once
with the stiffness and the mass it has in one, where a second tube would need room and moving mass of its own. Both
actuators pull at the beam's axis and are pinned, so that they neither twist the outer beam nor hinder it.

Left out: the tilt of an actuator when the inner tip moves across it, which turns a share d / l of its force (travel
across d, length between pins l) into the other plane, moves the tip there by d^2 / 2l, a disturbance that the other
servo sees, and gives an actuator that pushes with f a stiffness of -f / l across itself, beside that of the oil; shear
deformation and rotary inertia of the beam's length; warping, which such a tube of even wall does not have, and
distortion of the section, which the end module is taken to prevent; the beam's own weight, which turns the end by a
constant; everything nonlinear. In linear loops a steady load changes nothing, so that its direction counts for the
error alone.

The closed loop of one plane of the arm: bending of both beams, and torsion where the payload stands off to the side.

The outer beam's end moves by u in the plane and turns by phi about the axis; in bending it turns by 3 u / 2L, as under
a force on the tip. A payload at [a_x, a_y, a_z] then moves, in the plane, by kappa u + e phi, with
kappa = 1 + 3 a_x / 2L and e = a_y for the plane z, -a_z for the plane y; and along the beam by lambda u, as far as the
turning end takes it, lambda = 3 a / 2L with the offset a in the plane. Its kinetic energy
m (kappa u' + e phi')^2 / 2 + m (lambda u')^2 / 2 is of rank one in (u, phi) unless both e and lambda are there, so that
everything that follows is affine in m.

With the loop without torsion, p0 + m p1, p1 = s^2 q, and torsion t = k + b s + I s^2, the tip's impedance p0 / q gives

    (p0 + m g p1) t + m e^2 s^2 p0,    g = kappa^2 + lambda^2,    e lambda = 0,

and in the same way every other polynomial of the loop. Servos that measure at [s_x, s_y, s_z] from the tip see
kappa_s u + e_s phi instead of u, with kappa_s and e_s as kappa and e; what they return is then
R (kappa_s t + m s^2 e (kappa_s e - kappa e_s)) for R at the tip. What a controller makes of added sensors does not
depend on where the displacement is measured: p0 and q are those of the loop that they close.

A payload with offsets to both sides couples both planes and is in `beamdesign.proofs.arm.both_planes`.
"""

from dataclasses import dataclass
from functools import cached_property

from flint import fmpq_poly

from beamdesign.loop import Loop, loop
from beamdesign.polynomial import Affine
from beamdesign.prototype import Prototype
from beamdesign.records import InputError
from beamdesign.structure.arm import Name, PlaneFigures, arm_of, in_plane, plane_figures

_S2 = fmpq_poly([0, 0, 1])


@dataclass(frozen=True)
class PlaneLoop:
    """The loop of one plane in exact polynomials of s, all affine in the payload m (kg).

    Over `characteristic` stand `loop_denominator` (sensitivity), `loop_numerator` (with its sign changed, the command),
    `tip` and `load`.

    Attributes:
        figures: of the payload in this plane.
        loop_denominator: denominator of the loop transfer function.
        loop_numerator: its numerator.
        effort_numerator: numerator of C S.
        tip: tip displacement per force on the tip, m/N.
        load: displacement of the payload's centre per force on it, m/N.
    """

    figures: PlaneFigures
    loop_denominator: Affine
    loop_numerator: Affine
    effort_numerator: Affine
    tip: Affine
    load: Affine

    @cached_property
    def characteristic(self) -> Affine:
        """Closed-loop characteristic polynomial."""
        return self.loop_denominator + self.loop_numerator


def single_loop(prototype: Prototype, name: Name) -> Loop:
    """The loop of one plane without offset: that of the prototype, for y with the second controller if there is one.

    Raises:
        InputError: for a prototype with effects, without a controller, or with one of several laws.
    """
    wrong = [(f"effects.{key}", "the arm is worked out without effects; remove it") for key in prototype.effects]
    laws = {"controller": prototype.controller, "arm.second_controller": arm_of(prototype).second_controller}
    if prototype.controller is None:
        wrong.append(("controller", "missing; the arm's loops are closed"))
    wrong += [
        (f"{key}.kind", f"{law.kind!r} has {len(law.laws)} laws, and nothing says which of them acts; give one of them")
        for key, law in laws.items()
        if law is not None and law.schedule is not None
    ]
    if wrong:
        raise InputError(prototype.name, wrong)
    return loop(in_plane(prototype, name))


def plane_loop(prototype: Prototype, name: Name) -> PlaneLoop:
    """The loop of one plane with the payload where it is.

    Raises:
        InputError: as `single_loop` and `arm_figures`.
        ValueError: where the payload couples both planes.
    """
    figures = plane_figures(prototype, name)
    if figures.coupled and figures.along != 0:
        raise ValueError("offsets to both sides couple both planes; a plane by itself has no loop")
    return couple(single_loop(prototype, name), figures)


def couple(single: Loop, figures: PlaneFigures) -> PlaneLoop:
    """Put a payload off the axis on a loop's tip."""
    t, e = figures.torsion, figures.lever
    g = figures.travel**2 + figures.along**2  # by which the payload's mass counts at the tip

    def joined(part: Affine) -> Affine:
        """A polynomial that is affine in the impedance on the tip, with the payload's m s^2 g / (1 + m s^2 e^2 / t)."""
        return Affine(part.constant * t, g * part.slope * t + e**2 * _S2 * part.constant)

    assert single.effort_numerator is not None  # the loop of a prototype knows its controller
    fed = (single.loop_numerator - single.added).constant
    cut, seen, seen_roll = single.cut.constant, figures.sensed_travel, figures.sensed_lever
    loop_denominator = joined(single.loop_denominator)
    loop_numerator = Affine(seen * fed * t, _S2 * fed * e * (seen * e - figures.travel * seen_roll)) + joined(
        single.added
    )
    characteristic = loop_denominator + loop_numerator
    # A force on the payload is free of its mass up to the characteristic polynomial: the mass stands beside it.
    load = figures.travel**2 * single.disturbance * t + e**2 * cut
    load += e * (seen * e - figures.travel * seen_roll) * fed - figures.sensed_residual * figures.travel * fed * t
    return PlaneLoop(
        figures,
        loop_denominator,
        loop_numerator,
        joined(single.effort_numerator),
        joined(Affine(single.disturbance)),
        Affine(load + figures.residual * characteristic.constant, figures.residual * characteristic.slope),
    )
