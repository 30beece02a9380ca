"""Square tubes against closed forms, limits, quadrature and another library."""

from math import pi, sqrt
from operator import attrgetter

import casadi as ca
import numpy as np
import pytest
from finite_elements import meshed
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from beamdesign.structure.section import Tube, clearances, positive_part


@st.composite
def tubes(draw: st.DrawFn, rounded: bool = True) -> tuple[float, float, float]:
    """Width, wall and outside corner radius in m: any wall below half the width, any radius up to half the width."""
    width = draw(st.floats(0.01, 1.0))
    wall = width * draw(st.floats(0.005, 0.49))
    radius = width / 2 * draw(st.floats(0.0, 1.0)) if rounded else 0.0
    return width, wall, radius


def half_chord(y: float, side: float, radius: float) -> float:
    """Half the width of a rounded square at height y from its centre."""
    straight = side / 2 - radius
    if abs(y) <= straight:
        return side / 2
    return straight + sqrt(max(radius**2 - (abs(y) - straight) ** 2, 0.0))


def by_quadrature(side: float, radius: float, power: int) -> float:
    """Integral of y^power over a rounded square."""
    if side <= 0:
        return 0.0
    value, _ = quad(
        lambda y: 4 * half_chord(y, side, radius) * y**power,
        0.0,
        side / 2,
        points=[side / 2 - radius],
        epsrel=1e-12,
        epsabs=0,
        limit=200,
    )
    return float(value)


@given(tubes(rounded=False))
def test_sharp_tube_is_a_square_less_a_square(tube):
    width, wall, _ = tube
    opening = width - 2 * wall
    assert Tube(width, wall).area == pytest.approx(width**2 - opening**2, rel=1e-11)
    assert Tube(width, wall).second_moment == pytest.approx((width**4 - opening**4) / 12, rel=1e-11)


@given(tubes())
def test_rounded_tube_agrees_with_quadrature(tube):
    width, wall, radius = tube
    inner_radius = max(radius - wall, 0.0)
    for power, found in ((0, Tube(*tube).area), (2, Tube(*tube).second_moment)):
        expected = by_quadrature(width, radius, power) - by_quadrature(width - 2 * wall, inner_radius, power)
        assert found == pytest.approx(expected, rel=1e-7)


@given(st.floats(0.01, 1.0), st.floats(0.005, 0.49))
def test_radius_of_half_the_width_gives_a_round_tube(diameter, share):
    wall = share * diameter
    outside, inside = diameter / 2, diameter / 2 - wall
    assert Tube(diameter, wall, diameter / 2).area == pytest.approx(pi * (outside**2 - inside**2), rel=1e-10)
    assert Tube(diameter, wall, diameter / 2).second_moment == pytest.approx(
        pi / 4 * (outside**4 - inside**4), rel=1e-10
    )


@given(tubes(), st.floats(0.1, 10.0))
def test_scaling(tube, factor):
    larger = tuple(factor * size for size in tube)
    assert Tube(*larger).area == pytest.approx(factor**2 * Tube(*tube).area, rel=1e-9)
    assert Tube(*larger).second_moment == pytest.approx(factor**4 * Tube(*tube).second_moment, rel=1e-9)
    assert Tube(*larger).elastic_modulus == pytest.approx(factor**3 * Tube(*tube).elastic_modulus, rel=1e-9)


@given(st.floats(0.01, 1.0))
def test_thin_wall_limit(width):
    wall = 1e-7 * width
    assert Tube(width, wall).area == pytest.approx(4 * width * wall, rel=1e-6)
    assert Tube(width, wall).second_moment == pytest.approx(2 / 3 * width**3 * wall, rel=1e-6)


@given(tubes(rounded=False))
def test_corner_radius_goes_to_sharp_without_a_jump(tube):
    width, wall, _ = tube
    for figure in map(attrgetter, ("area", "second_moment", "elastic_modulus")):
        assert figure(Tube(width, wall, 1e-6 * wall)) == pytest.approx(figure(Tube(width, wall)), rel=1e-9)
        assert figure(Tube(width, wall, 0.0)) == figure(Tube(width, wall))


@given(tubes())
def test_rounding_takes_material_from_the_corners(tube):
    width, wall, radius = tube
    assert Tube(width, wall, radius).area <= Tube(width, wall).area * (1 + 1e-12)
    assert Tube(width, wall, radius).second_moment <= Tube(width, wall).second_moment * (1 + 1e-12)
    assert Tube(width, wall, radius).second_moment > 0


@pytest.mark.parametrize(
    ("width", "wall", "radius"), [(140.0, 2.3, 0.0), (100.0, 3.2, 0.0), (100.0, 4.0, 8.0), (60.0, 5.0, 5.0)]
)
def test_agrees_with_sectionproperties(width, wall, radius):
    arcs = 64
    analysed = meshed(width, width, wall, radius, arcs, width * wall)
    about_x, about_y, product = analysed.get_ic()
    # That library draws a quarter circle as a polygon of 63 chords, which loses a share of (angle)^2 / 6 of its area.
    chords = (pi / 2 / (arcs - 1)) ** 2 / 6 if radius else 0.0
    assert Tube(width, wall, radius).area == pytest.approx(analysed.get_area(), rel=1e-9 + chords)
    assert Tube(width, wall, radius).second_moment == pytest.approx(about_x, rel=1e-9 + chords)
    assert about_y == pytest.approx(about_x, rel=1e-9)
    assert product == pytest.approx(0.0, abs=1e-6 * about_x)
    assert Tube(width, wall, radius).elastic_modulus == pytest.approx(min(analysed.get_z()), rel=1e-9 + chords)


@pytest.mark.parametrize("figure", [attrgetter(name) for name in ("area", "second_moment", "elastic_modulus")])
def test_numbers_arrays_and_symbols_give_the_same(figure):
    width, wall, radius = np.array([0.14, 0.1, 0.06]), np.array([0.0023, 0.0032, 0.005]), np.array([0.0, 0.008, 0.002])
    one_by_one = [figure(Tube(*sizes)) for sizes in zip(width.tolist(), wall.tolist(), radius.tolist(), strict=True)]
    assert figure(Tube(width, wall, radius)).tolist() == pytest.approx(one_by_one, rel=1e-14)

    symbols = ca.SX.sym("width"), ca.SX.sym("wall"), ca.SX.sym("radius")
    compiled = ca.Function("section", list(symbols), [figure(Tube(*symbols))])
    assert [float(compiled(*sizes)) for sizes in zip(width, wall, radius, strict=True)] == pytest.approx(
        one_by_one, rel=1e-14
    )


@given(tubes(rounded=False))
def test_derivative_by_width_is_that_of_the_closed_form(tube):
    width, wall, _ = tube
    symbol = ca.SX.sym("width")
    slope = ca.Function("slope", [symbol], [ca.jacobian(Tube(symbol, wall).second_moment, symbol)])
    assert float(slope(width)) == pytest.approx((width**3 - (width - 2 * wall) ** 3) / 3, rel=1e-9)


def test_mass_and_rigidity():
    # 10 x 10 cm outside with 1 cm walls: 36 cm2 of 2700 kg/m3; (10^4 - 8^4) / 12 = 492 cm4 of 69 GPa.
    assert Tube(0.1, 0.01).mass_per_length(2700.0) == pytest.approx(9.72)
    assert 69e9 * Tube(0.1, 0.01).second_moment == pytest.approx(69e9 * 492e-8)


def test_clearance_is_per_side_and_negative_where_the_tubes_overlap():
    assert clearances(Tube(0.14, 0.0023), Tube(0.1, 0.003))[0] == pytest.approx(0.0177)
    assert clearances(Tube(0.1, 0.002), Tube(0.1, 0.002))[0] == pytest.approx(-0.002)


@given(st.floats(-1e6, 1e6))
def test_positive_part_is_exact(value):
    assert positive_part(value) == max(value, 0.0)


def test_tube_names_its_sizes():
    tube = Tube(0.14, 0.0023)
    assert (tube.width_m, tube.wall_m) == (0.14, 0.0023)
