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
"""
