"""Rectangular and round tubes: against published tables, other libraries and limit cases; carried the whole way."""

import tomllib
from contextlib import suppress
from dataclasses import replace
from math import cos, pi, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from finite_elements import meshed
from forging import sealed_text
from hypothesis import given
from hypothesis import strategies as st
from one_start import best_start_alone
from shapely import Polygon, affinity

from beamdesign import DesignProblem, InputError, Prototype, check, read_prototype, run_design, size, write_prototype
from beamdesign.build.drawing import drawing, dxf_text
from beamdesign.build.ratings import stock_choices
from beamdesign.checker import Unreadable
from beamdesign.proofs.arm.remaining import InnerTravel
from beamdesign.proofs.arm.result import certify_plane
from beamdesign.proofs.writer import prototype_table
from beamdesign.prototype import Arm, Beam, prototype_from
from beamdesign.quantities import tube_text
from beamdesign.records import parse, read_table, to_toml
from beamdesign.structure.arm import arm_figures
from beamdesign.structure.lumped import beam_of_equal_mass
from beamdesign.structure.materials import material
from beamdesign.structure.section import RectangularTube, RoundTube, Tube, clearances, stock_tubes
from beamdesign.synthesis.sizing import check_prototype

STUDY = Path(__file__).parents[1] / "studies" / "prototype.toml"


def rectangle(width: float, depth: float, wall: float, radius: float = 0.0) -> RectangularTube:
    """By its outside sizes."""
    return RectangularTube(width, wall, radius, depth_over_width=depth / width)


# Sections.

RHS = [
    (40, 20, 2, 2.14, 4.05, 2.02, 1.34, 3.45), (50, 30, 3, 4.21, 12.83, 5.13, 5.70, 13.53),
    (50, 30, 4, 5.35, 15.25, 6.10, 6.69, 16.53), (60, 40, 2, 3.74, 18.41, 6.14, 9.83, 20.70),
    (60, 40, 3, 5.41, 25.38, 8.46, 13.44, 29.28),
]  # fmt: skip
"""EN 10219-2:2006, rectangular: h, b, t in mm; A, I_x, W_x, I_y and I_t in cm; outside corner radius twice the wall.
As tabled at http://www.b2bmetal.eu/en/pages/index/index/id/94/."""


@pytest.mark.parametrize(("depth", "width", "wall", "area", "about_x", "modulus", "about_y", "torsion"), RHS)
def test_published_rectangles(depth, width, wall, area, about_x, modulus, about_y, torsion):
    tube = rectangle(width / 10, depth / 10, wall / 10, 2 * wall / 10)
    found = (tube.area, tube.second_moment, tube.elastic_modulus, tube.turned.second_moment, tube.torsion_constant)
    assert found == pytest.approx((area, about_x, modulus, about_y, torsion), abs=0.0051)


def test_published_round_tube():
    """CHS 114.3 x 5 of EN 10219-2: A 17.2 cm2, I 256.9 cm4, W 45.0 cm3, I_t 513.8 cm4."""
    tube = RoundTube(11.43, 0.5)
    assert [round(figure, 1) for figure in (tube.area, tube.second_moment, tube.elastic_modulus)] == [17.2, 256.9, 45.0]
    assert round(tube.torsion_constant, 1) == 513.8


@pytest.mark.parametrize(("width", "depth", "wall", "radius"), [(60, 100, 4, 8), (100, 60, 4, 0), (50, 100, 3, 5)])
def test_rectangles_agree_with_sectionproperties(width, depth, wall, radius):
    analysed = meshed(width, depth, wall, radius, 32, wall**2 / 2)
    analysed.calculate_warping_properties()
    about_x, about_y, _ = analysed.get_ic()
    tube = rectangle(width, depth, wall, radius)
    assert tube.area == pytest.approx(analysed.get_area(), rel=1e-3)
    assert (tube.second_moment, tube.turned.second_moment) == pytest.approx((about_x, about_y), rel=1e-3)
    assert tube.polar_moment == pytest.approx(about_x + about_y, rel=1e-3)
    assert tube.torsion_constant == pytest.approx(analysed.get_j(), rel=0.005 if radius else 0.03)


@given(st.floats(0.02, 0.5), st.floats(0.01, 0.45), st.floats(0.0, 0.5))
def test_a_rectangle_of_equal_sides_is_the_square(width, share, rounding):
    square = Tube(width, share * width, rounding * width)
    same = RectangularTube(square.width_m, square.wall_m, square.corner_radius_m)
    for figure in ("area", "second_moment", "elastic_modulus", "torsion_constant", "polar_moment"):
        assert getattr(same, figure) == getattr(square, figure)
    constants = material("6061-T6").buckling_constants
    assert same.bending_resistance(240e6, constants) == square.bending_resistance(240e6, constants)


@given(st.floats(0.02, 0.5), st.floats(0.001, 0.45))
def test_a_round_tube_is_a_square_with_round_corners_and_twists_exactly(diameter, share):
    ring, square = RoundTube(diameter, share * diameter), Tube(diameter, share * diameter, diameter / 2)
    inside = diameter - 2 * ring.wall_m
    closed = pi / 4 * (diameter**2 - inside**2), pi / 64 * (diameter**4 - inside**4)
    for tube in (ring, square):
        assert (tube.area, tube.second_moment) == pytest.approx(closed, rel=1e-9)
    assert ring.torsion_constant == pytest.approx(ring.polar_moment)
    # Bredt's thin ring 2 pi r^3 t of the middle radius r, off by (t / 2r)^2.
    middle = (diameter - ring.wall_m) / 2
    thin = 2 * pi * middle**3 * ring.wall_m
    assert ring.torsion_constant == pytest.approx(thin * (1 + (ring.wall_m / (2 * middle)) ** 2), rel=1e-9)


def fibre_modulus(tube: Tube, flange_factor: float, web_factor: float, fibres: int = 40_000) -> float:
    """W_eff of a sharp rectangle by summing fibres in the steps of EN 1999-1-1, 6.2.5.2."""
    wall, half = tube.wall_m, tube.depth_m / 2
    edges = np.linspace(-half, half, fibres + 1)
    height, thin = (edges[1:] + edges[:-1]) / 2, 2 * half / fibres

    def between(low: float, high: float) -> np.ndarray:
        return np.clip(np.minimum(edges[1:], high) - np.maximum(edges[:-1], low), 0.0, None) / thin

    flat, middle = tube.width_m - 2 * wall, half - wall / 2
    breadth = 2 * wall + flat * between(-half, -half + wall)
    breadth += flat * between(middle - flange_factor * wall / 2, middle + flange_factor * wall / 2)
    axis = np.sum(breadth * height) / np.sum(breadth)
    breadth -= 2 * wall * (1 - web_factor) * between(axis, half - wall)
    axis = np.sum(breadth * height) / np.sum(breadth)
    return float(np.sum(breadth * thin * (height - axis) ** 2) / (half - axis))


@pytest.mark.parametrize("factors", [(0.5, 0.9), (0.8, 1.0), (1.0, 0.6)])
@pytest.mark.parametrize("tube", [rectangle(60.0, 120.0, 2.0), rectangle(120.0, 60.0, 2.0)])
def test_effective_rectangles_agree_with_fibres(tube, factors):
    assert tube.effective_modulus(*factors) == pytest.approx(fibre_modulus(tube, *factors), rel=1e-5)


def test_walls_of_a_rectangle_are_as_slender_as_their_own_sides():
    # 60 x 120 x 2 mm at 250 MPa: flange 56 / 2, webs 0.40 x 116 / 2.
    assert rectangle(0.06, 0.12, 0.002).relative_slenderness(250e6) == pytest.approx((28.0, 23.2))


@pytest.mark.parametrize(
    ("name", "limit"),
    [
        # EN 1999-1-1, Table 6.2: beta / epsilon at most 22 (class A) and 18 (B), beta = 3 sqrt((D - t) / t).
        ("6061-T6", 1 + (22 / 3) ** 2 * 250 / 240),
        ("5083-H112", 1 + (18 / 3) ** 2 * 250 / 110),
        # EN 1993-1-1, Table 5.2, class 3: 90 x 235 / f_y.
        ("S235JRH", 90.0),
        ("S355J2H", 90 * 235 / 355),
    ],
)
def test_class_3_limits_of_round_tubes(name, limit):
    assert material(name).largest_diameter_to_wall == pytest.approx(limit, rel=1e-9)


def test_a_round_laminate_stays_far_below_the_stress_at_which_it_would_buckle():
    """By the classical 0.605 E t / R with the modulus that C1 stands for, below E along the tube: twelve times."""
    laminate = material("CFRP-0-60-45-40")
    limit = laminate.largest_diameter_to_wall
    plate = laminate.buckling_constants[0] ** 2 * 250e6 * 12 * (1 - 0.3**2) / (4 * pi**2)
    assert plate < laminate.youngs_modulus_Pa
    assert 1.21 * plate / limit / laminate.proof_strength_Pa == pytest.approx(12.0, rel=0.01)


# Fit.


def outline(tube: Tube, inside: bool, chords: int = 5_000) -> Polygon:
    """What a tube fills, or its opening; inside corners sharp, a circle by chords."""
    less = tube.wall_m if inside else 0.0
    if tube.shape == "round":
        angles = np.linspace(0, 2 * pi, chords + 1)
        return Polygon([((tube.width_m / 2 - less) * cos(a), (tube.width_m / 2 - less) * sin(a)) for a in angles])
    half, high = tube.width_m / 2 - less, tube.depth_m / 2 - less
    box = Polygon([(half, high), (-half, high), (-half, -high), (half, -high)])
    radius = tube.corner_radius_m
    return box if inside or not radius else box.buffer(-radius).buffer(radius, quad_segs=500)


PAIRS = [
    (Tube(0.14, 0.003), Tube(0.1, 0.003)), (RoundTube(0.14, 0.003), RoundTube(0.1, 0.003)),
    (Tube(0.14, 0.003), RoundTube(0.1, 0.003)), (RoundTube(0.2, 0.004), Tube(0.1, 0.003, 0.006)),
    (RoundTube(0.2, 0.004), rectangle(0.06, 0.12, 0.003)), (rectangle(0.1, 0.15, 0.003), rectangle(0.05, 0.1, 0.003)),
    (rectangle(0.1, 0.16, 0.003), RoundTube(0.07, 0.003)), (rectangle(0.12, 0.1, 0.003), Tube(0.06, 0.002)),
]  # fmt: skip


@pytest.mark.parametrize(("outer", "inner"), PAIRS)
def test_gaps_are_those_of_the_outlines(outer: Tube, inner: Tube):
    opening, filled = outline(outer, inside=True), outline(inner, inside=False)
    gaps = clearances(outer, inner)
    assert min(gaps) == pytest.approx(opening.exterior.distance(filled), abs=1e-7)
    # After a motion by d along the load there is at least what was there less d, or what is across.
    for moved in (0.3 * gaps[0], 0.9 * gaps[0]):
        left = opening.exterior.distance(affinity.translate(filled, yoff=moved))
        assert left >= min([gaps[0] - moved, *gaps[1:]]) - 1e-7
    touching = affinity.translate(filled, yoff=1.001 * max(gaps[0], opening.bounds[3] - inner.depth_m / 2))
    assert not opening.contains(touching)


def test_travel_in_a_round_tube_counts_in_any_direction():
    assert not InnerTravel((0.008, 0.008), 0.01).touches
    assert InnerTravel((0.008, 0.008), 0.01, round=True).touches


# Records.


def beam(**changes: Any) -> dict[str, Any]:
    return {"width_m": 0.1, "wall_m": 0.003, "free_length_m": 1.2, "material": "6061-T6"} | changes


@pytest.mark.parametrize(
    ("changes", "key", "words"),
    [
        ({"shape": "rectangle"}, "depth_m", "missing"),
        ({"depth_m": 0.1}, "depth_m", "only a rectangle"),
        ({"shape": "round", "depth_m": 0.1}, "depth_m", "only a rectangle"),
        ({"shape": "round", "corner_radius_m": 0.01}, "corner_radius_m", "no corners"),
        ({"shape": "rectangle", "depth_m": 0.005}, "wall_m", "half the depth"),
        ({"shape": "rectangle", "depth_m": 0.04, "corner_radius_m": 0.03}, "corner_radius_m", "half the depth"),
        ({"shape": "rectangle", "width_m": 0.01, "wall_m": 0.002, "depth_m": 0.2}, "depth_m", "20 times the width"),
        ({"shape": "circle"}, "shape", "must be 'square', 'rectangle' or 'round'"),
        ({"shape": {"of": "round"}}, "shape", "must be 'square', 'rectangle' or 'round'"),
    ],
)
def test_impossible_shapes_are_refused_by_key(changes, key, words):
    with pytest.raises(InputError) as refused:
        parse(Beam, beam(**changes), "beam")
    assert [problem.key for problem in refused.value.problems] == [key]
    assert words in str(refused.value)


def test_a_square_is_what_is_meant_where_nothing_is_said():
    square = parse(Beam, beam(), "beam")
    assert square.shape == "square"
    assert square == parse(Beam, beam(shape="square"), "beam")
    assert "shape" not in to_toml(square)
    for said in (beam(shape="round"), beam(shape="rectangle", depth_m=0.15, corner_radius_m=0.006)):
        read = parse(Beam, said, "beam")
        assert parse(Beam, tomllib.loads(to_toml(read)), "beam") == read
    assert tube_text(RoundTube(0.1143, 0.005)) == "Ø 114.3 × 5 mm"
    assert tube_text(rectangle(0.06, 0.1, 0.004)) == "60 × 100 × 4 mm"


SHAPES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "round": (
        {"shape": "round", "width_m": 0.1683, "wall_m": 0.003},
        {"shape": "round", "width_m": 0.1143, "wall_m": 0.0025},
    ),
    "rectangle": (
        {"shape": "rectangle", "depth_over_width": 1.5, "width_m": 0.1, "wall_m": 0.003},
        {"shape": "rectangle", "depth_over_width": 2.0, "width_m": 0.05, "wall_m": 0.004},
    ),
    "mixed": (
        {"shape": "round", "width_m": 0.1937, "wall_m": 0.005},
        {"shape": "rectangle", "depth_over_width": 2.0, "width_m": 0.05, "wall_m": 0.004},
    ),
}  # fmt: skip


def study(shape: str, choose: str, sized: bool = True) -> DesignProblem:
    """The shipped study with tubes of a shape, and their sizes where they are to be kept."""
    table = read_table(STUDY)
    table["sections"]["choose"] = choose
    for name, given_sizes in zip(("outer_beam", "inner_beam"), SHAPES[shape], strict=True):
        same = {key: value for key, value in table[name].items() if key not in ("width_m", "wall_m")}
        sizes = {key: value for key, value in given_sizes.items() if sized or key not in ("width_m", "wall_m")}
        table[name] = same | sizes
    return parse(DesignProblem, table, "study.toml")


def test_ratios_without_stock_and_tubes_that_do_not_go_in_are_refused():
    table = study("rectangle", "free").model_dump(exclude_none=True)
    table["outer_beam"]["depth_over_width"] = 1.37
    assert parse(DesignProblem, table, "study.toml").sections.choose == "free"
    table["sections"]["choose"] = "stock"
    with pytest.raises(InputError, match=r"no rectangular stock tube has 1\.37"):
        parse(DesignProblem, table, "study.toml")
    table = study("mixed", "fixed").model_dump(exclude_none=True)
    table["inner_beam"]["width_m"] = 0.085  # 170 mm deep: fits by its sides and not by its corners
    with pytest.raises(InputError, match=r"gap per side would be -0\.00318"):
        parse(DesignProblem, table, "study.toml")


# The whole way.


@pytest.mark.parametrize("shape", SHAPES)
def test_every_stock_pair_is_looked_at(shape: str):
    """By a plain loop with figures from the textbook: strength and gap of the chosen pair, and none lighter passes."""
    problem = study(shape, "stock", sized=False)
    found = size(problem)
    assert found.feasible
    assert found.stock is not None
    lists = [stock_tubes(one.shape, one.depth_over_width) for one in problem.beams]
    assert found.stock.pairs == len(lists[0]) * len(lists[1])
    assert found.free is not None
    assert found.free.pair.beam_mass_kg <= found.beam_mass_kg
    assert found.free.kkt_residual < 1e-8
    lighter = [
        (outer, inner) for outer in lists[0] for inner in lists[1] if mass(outer, inner) < found.beam_mass_kg - 1e-9
    ]
    assert all(not passes(outer, inner) for outer, inner in lighter)
    assert passes(found.outer, found.inner)


def filled(tube: Tube) -> float:
    """Area of the cross-section: outside less inside."""
    width, depth, wall = tube.width_m, tube.depth_m, tube.wall_m
    if tube.shape == "round":
        return pi / 4 * (width**2 - (width - 2 * wall) ** 2)
    return width * depth - (width - 2 * wall) * (depth - 2 * wall)


def mass(outer: Tube, inner: Tube) -> float:
    """Of 1.5 m of each."""
    return 1.5 * 2700 * (filled(outer) + filled(inner))


def passes(outer: Tube, inner: Tube) -> bool:
    """Whether a pair meets the requirements of the shipped study, each worked out by itself."""
    for tube, length in ((outer, 1.195), (inner, 1.365)):
        moment, modulus = 2000 * length, inertia(tube) / (tube.depth_m / 2)
        if tube.wall_m < 0.002 or max(tube.width_m, tube.depth_m) > 0.2 or moment / modulus > 120e6:
            return False
        if tube.shape == "round" and 3 * ((tube.width_m - tube.wall_m) / tube.wall_m * 240 / 250) ** 0.5 > 22:
            return False
        if tube.shape != "round":
            flats = tube.width_m - 2 * tube.wall_m, 0.4 * (tube.depth_m - 2 * tube.wall_m)
            slender = [flat / tube.wall_m * (240 / 250) ** 0.5 for flat in flats]
            factors = [1.0 if x <= 22 else 32 / x - 220 / x**2 for x in slender]
            modulus = fibre_modulus(tube, factors[0], factors[1], 4000)
        if 1.5 * moment > modulus * 240e6 / 1.1:
            return False
    opening, inside = outline(outer, True, 720), outline(inner, False, 720)
    if not opening.contains(inside) or opening.exterior.distance(inside) < 0.005 - 1e-6:
        return False
    bends = max(2000 * 1.365**3 / (3 * 69e9 * inertia(inner)), 2000 * 1.195**3 / (3 * 69e9 * inertia(outer)))
    play = (outer.depth_m - inner.depth_m) / 2 - outer.wall_m
    if outer.shape == "round":
        play = opening.exterior.distance(inside)  # a motion takes its own length of that at most
    return bool(play - bends >= 0.003 - 1e-6)


def inertia(tube: Tube) -> float:
    """b h^3 / 12 or pi d^4 / 64, outside less inside."""
    width, depth, wall = tube.width_m, tube.depth_m, tube.wall_m
    if tube.shape == "round":
        return pi / 64 * (width**4 - (width - 2 * wall) ** 4)
    return (width * depth**3 - (width - 2 * wall) * (depth - 2 * wall) ** 3) / 12


@pytest.fixture(scope="module", params=["round", "rectangle"])
def design(request: pytest.FixtureRequest) -> tuple[Prototype, str]:
    """A design with fixed sections, proved for exactly its figures, and its certificate."""
    with best_start_alone():
        done = run_design(study(request.param, "fixed"), sigmas=0.0)
    assert done.prototype is not None, done.reason
    assert done.certificate is not None
    return done.prototype, done.certificate.text


def test_a_certificate_is_of_the_shape_that_it_was_made_for(design: tuple[Prototype, str], tmp_path: Path):
    prototype, text = design
    table = prototype_table(prototype)
    assert check(text, table).valid
    write_prototype(prototype, tmp_path / "prototype.toml")
    assert read_prototype(tmp_path / "prototype.toml") == prototype
    outer = table["outer_beam"]
    plain = {key: value for key, value in outer.items() if key not in ("shape", "depth_m")}
    for other in (
        plain,
        plain | {"shape": "round" if outer["shape"] == "rectangle" else "rectangle", "depth_m": outer["width_m"]},
        outer
        | ({"width_m": outer["depth_m"], "depth_m": outer["width_m"]} if "depth_m" in outer else {"wall_m": 0.004}),
        outer | {"shape": "hexagon"},
    ):
        with suppress(Unreadable):
            assert not check(text, {**table, "outer_beam": other}).valid


def test_drawing_and_specification_have_the_shape(design: tuple[Prototype, str]):
    prototype, _ = design
    document = drawing(prototype)
    assert dxf_text(document)
    space = document.modelspace()
    measured = sorted(round(one.get_measurement(), 4) for one in space.query("DIMENSION"))
    outer, inner = prototype.outer_beam.tube, prototype.inner_beam.tube
    assert outer is not None
    assert inner is not None
    for tube in (outer, inner):
        for size_m in (*tube.sides.values(), tube.wall_m):
            assert round(1e3 * size_m, 4) in measured
    circles = sorted(round(circle.dxf.radius, 3) for circle in space.query("CIRCLE"))
    assert circles == ([54.65, 57.15, 81.15, 84.15] if outer.shape == "round" else [])
    choices = stock_choices(prototype, (0.0, 6.8))
    assert choices is not None
    assert all(one.same for one in choices)
    assert check_prototype(prototype, 2000.0).feasible


def test_the_passive_beam_of_equal_mass_keeps_the_shape(design: tuple[Prototype, str]):
    prototype, _ = design
    outer, inner = prototype.outer_beam, prototype.inner_beam
    equal = beam_of_equal_mass(outer, inner)
    assert equal is not None
    assert outer.tube is not None
    assert inner.tube is not None
    weighs = [
        length * filled(tube)
        for tube, length in (
            (replace(outer.tube, wall_m=equal.wall_m), 1.195),
            (outer.tube, 1.195),
            (inner.tube, 1.365),
        )
    ]
    assert weighs[0] == pytest.approx(weighs[1] + weighs[2], rel=1e-6)
    made = replace(outer.tube, wall_m=equal.wall_m)
    assert equal.stiffness == pytest.approx(3 * 69e9 * inertia(made) / 1.195**3)


# The arm.


def as_arm(prototype: Prototype) -> Prototype:
    return prototype.but(arm=Arm(offset_m=(0.0, 0.1, 0.0), end_polar_inertia_kg_m2=0.01), guarantee=None)


def test_an_arm_is_round_and_not_a_rectangle(design: tuple[Prototype, str]):
    prototype, _ = design
    rig, tube = as_arm(prototype), prototype.outer_beam.tube
    assert tube is not None
    if tube.shape == "rectangle":
        with pytest.raises(InputError, match="take a square or a round one"):
            arm_figures(rig)
        return
    outside, inside = tube.width_m / 2, tube.width_m / 2 - tube.wall_m
    polar = pi / 2 * (outside**4 - inside**4)
    figures = arm_figures(rig)
    assert figures.torsional_stiffness == pytest.approx(27e9 * polar / 1.195)
    assert figures.polar_inertia == pytest.approx(0.01 + 2700 * polar * 1.195 / 3)
    text = certify_plane(rig, "z", 0.0, 6.8).text
    assert check(text, prototype_table(rig)).valid
    honest = tomllib.loads(text)
    assert honest["plane"]["section"]["shape"] == "round"
    for forged in ("square", None):
        section = {key: value for key, value in honest["plane"]["section"].items() if key != "shape"}
        section |= {"shape": forged} if forged else {}
        table = {**honest, "plane": {**honest["plane"], "section": section}}
        assert not check(sealed_text(tomli_w.dumps(table))).valid
    square = rig.but(outer_beam=rig.outer_beam.but(shape="square"))
    assert not check(text, prototype_table(square)).valid


def test_free_rectangles_keep_their_limits_in_the_file_of_their_prototype():
    """The lightest tubes are at their limits, which the depth that the file states keeps as their ratio does."""
    problem = study("rectangle", "free", sized=False)
    found = size(problem)
    rig = prototype_from(tomllib.loads(to_toml(problem.prototype(found.outer, found.inner))))
    assert check_prototype(rig, problem.load.tip_force_N).failing == ()


def test_a_prototype_in_a_file_says_its_shape():
    """The stiffness that the geometry gives, by 3 pi E (D^4 - d^4) / 64 L^3."""
    problem = study("round", "fixed")
    assert problem.given is not None
    rig = prototype_from(tomllib.loads(to_toml(problem.prototype(*problem.given))))
    from beamdesign.structure.lumped import lumped_beam

    expected = 3 * 69e9 * pi / 64 * (0.1683**4 - 0.1623**4) / 1.195**3
    assert lumped_beam(rig.outer_beam).stiffness == pytest.approx(expected)
