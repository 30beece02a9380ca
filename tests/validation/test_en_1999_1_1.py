"""Local buckling of thin walls.

EN 1999-1-1:2007, Eurocode 9: Design of aluminium structures, Part 1-1: General structural rules; clauses 6.1.4 and
6.1.5 with Tables 6.2 and 6.3 (internal parts, without welds), and 6.2.5. The numbers are worked by hand from its
formulas; the effective section is also summed fibre by fibre.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beamdesign.structure.section import (
    LOCAL_BUCKLING_CONSTANTS,
    Tube,
    buckling_curve,
    elastic_buckling_constants,
    local_buckling_factor,
)

FIBRES = 20_000
CLASS_3_LIMITS = {"A": 22.0, "B": 18.0}
"""beta / epsilon up to which an internal part is of class 3 or better: Table 6.2, without welds."""


def fibre_modulus(width: float, wall: float, flange_factor: float, web_factor: float) -> float:
    """W_eff of a sharp square tube by summing horizontal fibres, in the steps of the standard.

    Neutral axis with the thinned flange first; thinned webs from there up to the flange; neutral axis again.
    """
    half = width / 2
    edges = np.linspace(-half, half, FIBRES + 1)
    height, depth = (edges[1:] + edges[:-1]) / 2, width / FIBRES

    def share(low: float, high: float) -> np.ndarray:
        """How much of each fibre lies between two heights."""
        return np.clip(np.minimum(edges[1:], high) - np.maximum(edges[:-1], low), 0.0, None) / depth

    flat, middle = half - wall, half - wall / 2
    breadth = 2 * wall + 2 * flat * share(-half, -flat)
    # The flange is thinned about its mid-plane; its two corners stay.
    breadth += 2 * flat * share(middle - flange_factor * wall / 2, middle + flange_factor * wall / 2)
    axis = np.sum(breadth * height) / np.sum(breadth)
    breadth -= 2 * wall * (1 - web_factor) * share(axis, flat)
    axis = np.sum(breadth * height) / np.sum(breadth)
    return float(np.sum(breadth * depth * (height - axis) ** 2) / (half - axis))


def test_constants_of_the_table():
    assert LOCAL_BUCKLING_CONSTANTS == {"A": (32, 220), "B": (29, 198)}


@pytest.mark.parametrize("buckling_class", ["A", "B"])
def test_factor_is_one_up_to_the_class_3_limit_and_continuous_there(buckling_class):
    limit = CLASS_3_LIMITS[buckling_class]
    assert buckling_curve(limit, LOCAL_BUCKLING_CONSTANTS[buckling_class]) == pytest.approx(1.0, abs=1e-12)
    for slenderness in (0.1, 5.0, limit / 2, 0.99 * limit):
        assert local_buckling_factor(slenderness, LOCAL_BUCKLING_CONSTANTS[buckling_class]) == 1.0
    assert 0.99 < local_buckling_factor(1.01 * limit, LOCAL_BUCKLING_CONSTANTS[buckling_class]) < 1.0


def test_factor_by_hand():
    # 32 / 44 - 220 / 44^2 and 29 / 36 - 198 / 36^2.
    assert local_buckling_factor(44.0, LOCAL_BUCKLING_CONSTANTS["A"]) == pytest.approx(0.613636, abs=1e-6)
    assert local_buckling_factor(36.0, LOCAL_BUCKLING_CONSTANTS["B"]) == pytest.approx(0.652778, abs=1e-6)


@given(st.floats(0.5, 300.0), st.sampled_from(["A", "B"]))
def test_factor_is_the_kinked_formula(slenderness, buckling_class):
    first, second = LOCAL_BUCKLING_CONSTANTS[buckling_class]
    formula = first / slenderness - second / slenderness**2
    expected = 1.0 if slenderness <= CLASS_3_LIMITS[buckling_class] else formula
    assert local_buckling_factor(slenderness, LOCAL_BUCKLING_CONSTANTS[buckling_class]) == pytest.approx(
        expected, rel=1e-12
    )


def test_published_outer_tube_by_hand():
    # 140 x 2.3 mm, f_o = 240 MPa: epsilon = sqrt(250/240) = 1.020621, b = 135.4 mm, b/t = 58.8696.
    flange, web = Tube(0.140, 0.0023).relative_slenderness(240e6)
    assert flange == pytest.approx(57.6802, abs=1e-3)
    assert web == pytest.approx(0.40 * 57.6802, abs=1e-3)
    assert min(flange, web) > CLASS_3_LIMITS["A"]
    # rho = 32/57.6802 - 220/57.6802^2 in the flange, 32/23.0721 - 220/23.0721^2 in the webs.
    assert local_buckling_factor(flange, LOCAL_BUCKLING_CONSTANTS["A"]) == pytest.approx(0.48866, abs=1e-5)
    assert local_buckling_factor(web, LOCAL_BUCKLING_CONSTANTS["A"]) == pytest.approx(0.97367, abs=1e-5)
    # Gross A = 1266.84 mm2, I = 4.004604e6 mm4 about mid-depth. The flange loses 0.511342 x 2.3 x 135.4 = 159.242 mm2
    # at 68.85 mm, so that the axis drops by 159.242 x 68.85 / 1107.598 = 9.8987 mm. The webs lose 0.026326 x 2.3 mm
    # each over 67.7 + 9.8987 = 77.5987 mm, both together 9.3973 mm2 at 28.9006 mm. Axis: (159.242 x 68.85 + 9.3973 x
    # 28.9006) / 1098.201 = 10.2307 mm down. About mid-depth: 4.004604e6 - 159.242 x 68.85^2 - 135.4 x 2.3^3 x
    # (1 - 0.488658^3) / 12 - 9.3973 x (28.9006^2 + 77.5987^2 / 12) = 3.237059e6 mm4; less 1098.201 x 10.2307^2:
    # 3.122112e6 mm4; over 70 + 10.2307 mm: 38914.2 mm3; times 240 / 1.1 MPa: 8.49036 kN m.
    assert Tube(0.140, 0.0023).bending_resistance(240e6, LOCAL_BUCKLING_CONSTANTS["A"]) == pytest.approx(
        8490.36, rel=1e-5
    )


def test_stocky_tube_keeps_its_elastic_resistance():
    # 60 x 4 mm, f_o = 160 MPa: b/t = 13, epsilon = 1.25, beta/epsilon = 10.4, class 1.
    assert Tube(0.06, 0.004).relative_slenderness(160e6)[0] == pytest.approx(10.4, rel=1e-12)
    modulus = (0.06**4 - 0.052**4) / 12 / 0.03
    assert Tube(0.06, 0.004).bending_resistance(160e6, LOCAL_BUCKLING_CONSTANTS["A"]) == pytest.approx(
        modulus * 160e6 / 1.1, rel=1e-12
    )


@pytest.mark.parametrize(
    ("width", "wall", "flange_factor", "web_factor"),
    [(140.0, 2.3, 0.4887, 0.9737), (100.0, 3.2, 0.8487, 1.0), (80.0, 1.0, 0.35, 0.7), (50.0, 5.0, 0.6, 0.5)],
)
def test_effective_modulus_agrees_with_fibres(width, wall, flange_factor, web_factor):
    expected = fibre_modulus(width, wall, flange_factor, web_factor)
    assert Tube(width, wall).effective_modulus(flange_factor, web_factor) == pytest.approx(expected, rel=1e-6)


@given(
    st.floats(0.02, 0.4),
    st.floats(0.008, 0.2),
    st.floats(0.1, 0.98),
    st.floats(0.1, 0.98),
    st.booleans(),
)
def test_effective_modulus_grows_with_each_factor(width, share, flange_factor, web_factor, flange):
    wall = share * width
    larger = (flange_factor + 0.02, web_factor) if flange else (flange_factor, web_factor + 0.02)
    assert Tube(width, wall).effective_modulus(*larger) > Tube(width, wall).effective_modulus(flange_factor, web_factor)


@given(st.floats(0.02, 0.4), st.floats(0.008, 0.2), st.floats(0.0, 0.5))
def test_whole_walls_give_the_gross_modulus(width, share, radius_share):
    wall, radius = share * width, radius_share * width
    found = Tube(width, wall, radius).effective_modulus(1.0, 1.0)
    assert found == pytest.approx(Tube(width, wall, radius).elastic_modulus, rel=1e-9)


def test_rounded_corners_shorten_the_flat_part():
    sharp, _ = Tube(0.1, 0.002).relative_slenderness(240e6)
    rounded, _ = Tube(0.1, 0.002, 0.006).relative_slenderness(240e6)
    inside_rounded, _ = Tube(0.1, 0.002, 0.001).relative_slenderness(240e6)
    assert rounded / sharp == pytest.approx(88 / 96)
    assert inside_rounded == sharp


def test_plates_of_other_moduli_buckle_by_winters_curve_as_aluminium_does():
    """Row A of Table 6.3 is the curve of a plate of 70 GPa; of steel EN 1993-1-5, 4.4, has b / t over 56.8 epsilon."""
    first, second = elastic_buckling_constants(70e9, 0.3)
    assert (first, second) == pytest.approx(LOCAL_BUCKLING_CONSTANTS["A"], rel=0.02)
    # lambda = (b / t) / (28.4 epsilon sqrt(4)), epsilon = sqrt(235 / f_y); at 355 MPa and b / t = 60.
    of_steel = elastic_buckling_constants(210e9, 0.3)
    slenderness = 60 / (2 * 28.4 * (235 / 355) ** 0.5)
    ours, _ = Tube(0.062, 0.001).relative_slenderness(355e6)
    assert local_buckling_factor(ours, of_steel) == pytest.approx((slenderness - 0.22) / slenderness**2, rel=3e-3)
    # Of webs in bending EN 1993 has k = 23.9 and 0.055 (3 + psi) = 0.11: ours are taken for weaker.
    for ratio in (60, 100, 200):
        _, ours = Tube(ratio + 2.0, 1.0).relative_slenderness(355e6)
        web = ratio / (28.4 * 23.9**0.5 * (235 / 355) ** 0.5)
        assert local_buckling_factor(ours, of_steel) <= min(1.0, (web - 0.11) / web**2) + 1e-3
