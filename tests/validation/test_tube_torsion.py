"""Torsion constant of tubes against published tables, a finite-element library, and the round tube."""

from math import pi

import numpy as np
import pytest

from beamdesign.structure.materials import material, material_names
from beamdesign.structure.section import Tube

PUBLISHED = [
    (40, 2, 11.3), (40, 3, 15.8), (40, 4, 19.4), (50, 2, 22.6), (50, 3, 32.1), (50, 4, 40.4), (50, 5, 47.5),
    (60, 3, 57.1), (60, 4, 72.6), (60, 5, 86.4), (70, 3, 92.4), (70, 5, 142.0),
]  # fmt: skip
"""Width and wall in mm, torsional inertia constant in cm4 of cold-formed square hollow sections, outside corner radius
twice the wall: EN 10219-2, as tabled in the Steel Designers' Manual, 6th edition (2003), page 1190."""


@pytest.mark.parametrize(("width", "wall", "constant"), PUBLISHED)
def test_published_sections(width: float, wall: float, constant: float):
    found = 1e8 * Tube(width / 1e3, wall / 1e3, 2 * wall / 1e3).torsion_constant
    assert found == pytest.approx(constant, abs=0.5 * 10.0 ** (np.floor(np.log10(constant)) - 2) * 1.001)


@pytest.mark.parametrize(
    ("width", "wall", "radius", "within"),
    [
        (0.140, 0.0023, 0.0, 0.01),
        (0.100, 0.0032, 0.0064, 0.003),
        (0.100, 0.010, 0.020, 0.003),
        (0.100, 0.010, 0.0, 0.045),
    ],
)
def test_exact_solution_by_finite_elements(width: float, wall: float, radius: float, within: float):
    """Prandtl's problem solved by sectionproperties; sharp inside corners make a real tube a little stiffer."""
    from sectionproperties.analysis import Section
    from sectionproperties.pre.library import rectangular_hollow_section

    side, t, r = (1e3 * size for size in (width, wall, radius))
    shape = rectangular_hollow_section(d=side, b=side, t=t, r_out=r, n_r=12)
    shape.create_mesh(mesh_sizes=[t**2 / 3])
    section = Section(shape)
    section.calculate_geometric_properties()
    section.calculate_warping_properties()
    exact = 1e-12 * section.get_j()
    assert Tube(width, wall, radius).torsion_constant == pytest.approx(exact, rel=within)
    if radius == 0:
        assert Tube(width, wall, radius).torsion_constant < exact
    # It does not warp to speak of: J against the warping constant over the length of the published beam.
    decay = 1e3 * 1.195 * np.sqrt(section.get_j() / (2.6 * section.get_gamma()))
    assert decay > 100  # lengths over which a hindered end would fade, in one beam


@pytest.mark.parametrize("share", [0.01, 0.05, 0.1])
def test_a_radius_of_half_the_width_gives_a_round_tube(share: float):
    """Exactly, J is the polar second moment; Bredt's thin wall is off by the square of wall over radius."""
    width, wall = 0.1, 0.1 * share
    outside, inside = width / 2, width / 2 - wall
    exact = pi / 2 * (outside**4 - inside**4)
    assert 2 * Tube(width, wall, width / 2).second_moment == pytest.approx(exact)
    assert Tube(width, wall, width / 2).torsion_constant == pytest.approx(exact, rel=(wall / (outside + inside)) ** 2)


def test_a_tube_twists_as_an_open_strip_does_not():
    """Slit along its length the same tube has p t^3 / 3 alone: Bredt's term is the closed one's."""
    width, wall = 0.14, 0.0023
    slit = Tube(width, wall).area * wall**2 / 3
    assert Tube(width, wall).torsion_constant - slit == pytest.approx((width - wall) ** 3 * wall)
    assert Tube(width, wall).torsion_constant > 1000 * slit


def test_shear_modulus_of_the_design_code():
    """EN 1999-1-1, 3.2.5: 27 GPa; isotropic with the Young's modulus here at a Poisson ratio near the code's 0.3."""
    for alloy in filter(lambda one: one.buckling_class, map(material, material_names())):
        assert alloy.shear_modulus_Pa == 27e9
        assert 0.27 < alloy.youngs_modulus_Pa / (2 * alloy.shear_modulus_Pa) - 1 < 0.34
