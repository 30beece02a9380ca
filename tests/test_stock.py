"""Materials and stock sizes: what the data promise."""

from math import hypot
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from beamdesign import DesignProblem, InputError, certify, check, read_prototype, write_prototype
from beamdesign.controllers import Lag
from beamdesign.records import parse, read_table
from beamdesign.structure.lumped import lumped_beam
from beamdesign.structure.materials import BEAMS, Material, material, material_names
from beamdesign.structure.section import SHAPES, Tube, stock_tubes

STUDY = Path(__file__).parent.parent / "studies" / "prototype.toml"


def test_stock_is_sorted_and_without_repetition():
    for shape in SHAPES:
        sizes = [(tube.width_m, tube.wall_m, tube.depth_m) for tube in stock_tubes(shape)]
        assert [size[:2] for size in sizes] == sorted(size[:2] for size in sizes)
        assert len(sizes) == len(set(sizes))


def test_stock_tubes_are_tubes_within_what_the_data_state():
    for tube in (tube for shape in SHAPES for tube in stock_tubes(shape)):
        assert 0 < tube.wall_m < min(tube.width_m, tube.depth_m) / 2
        assert max(tube.width_m, tube.depth_m) / tube.wall_m <= 60 * (1 + 1e-12)
        assert hypot(tube.width_m, tube.depth_m) <= 0.35


def test_every_width_comes_in_several_walls():
    widths = {tube.width_m for tube in stock_tubes()}
    assert {0.1, 0.12, 0.15} <= widths
    assert all(sum(tube.width_m == width for tube in stock_tubes()) >= 4 for width in widths)


@pytest.mark.parametrize(
    ("name", "proof_strength_MPa", "buckling_class"),
    # EN 1999-1-1:2007 + A1:2009, Table 3.2b.
    [("6061-T6", 240, "A"), ("6063-T6", 160, "A"), ("6063-T66", 200, "A"), ("5083-H112", 110, "B")],
)
def test_alloys_have_the_strength_of_the_standard(name, proof_strength_MPa, buckling_class):
    alloy = material(name)
    assert alloy.name == name
    assert alloy.proof_strength_Pa == proof_strength_MPa * 1e6
    assert alloy.buckling_class == buckling_class


def test_alloys_with_a_class_are_aluminium():
    for alloy in filter(lambda one: one.buckling_class, map(material, material_names())):
        assert alloy.density_kg_per_m3 == pytest.approx(2700, rel=0.03)
        assert alloy.youngs_modulus_Pa == pytest.approx(70e9, rel=0.03)


PLY = {"along": 181e9, "across": 10.3e9, "ratio": 0.28, "shear": 7.17e9}
"""T300/5208: S. W. Tsai and H. T. Hahn, Introduction to Composite Materials, 1980."""
LAYUPS = {"CFRP-0-60-45-40": {0: 0.6, 45: 0.2, -45: 0.2}, "CFRP-quasi-isotropic": dict.fromkeys((0, 45, -45, 90), 0.25)}


@pytest.mark.parametrize("name", LAYUPS)
def test_laminates_have_the_moduli_of_their_plies(name):
    """By classical lamination theory; the quasi-isotropic one has 69.7 and 26.9 GPa in the book."""
    minor = PLY["ratio"] * PLY["across"] / PLY["along"]
    both = np.array([PLY["along"], PLY["across"]]) / (1 - PLY["ratio"] * minor)
    q = np.array([[both[0], PLY["ratio"] * both[1], 0], [PLY["ratio"] * both[1], both[1], 0], [0, 0, PLY["shear"]]])
    whole = np.zeros((3, 3))
    for degrees, share in LAYUPS[name].items():
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        strains = np.array([[c * c, s * s, c * s], [s * s, c * c, -c * s], [-2 * c * s, 2 * c * s, c * c - s * s]])
        whole += share * strains.T @ q @ strains
    compliance, one = np.linalg.inv(whole), material(name)
    assert one.youngs_modulus_Pa == pytest.approx(1 / compliance[0, 0], rel=2e-3)
    assert one.shear_modulus_Pa == pytest.approx(1 / compliance[2, 2], rel=2e-3)
    assert one.proof_strength_Pa == pytest.approx(0.004 * one.youngs_modulus_Pa, rel=3e-3)
    plate = 2 * np.pi**2 / 12 * (np.sqrt(whole[0, 0] * whole[1, 1]) + whole[0, 1] + 2 * whole[2, 2])
    first, second = one.buckling_constants
    assert first == pytest.approx(np.sqrt(plate / 250e6), rel=2e-3)
    assert second == pytest.approx(0.22 * first**2, rel=2e-3)


@pytest.mark.parametrize(
    ("along", "across", "shear", "ratio"), [(181.0, 10.3, 7.17, 0.28), (38.0, 9.0, 3.5, 0.28), (42.0, 12.0, 4.0, 0.3)]
)
def test_walls_with_fibres_along_the_tube_do_not_buckle_before_they_are_said_to(along, across, shear, ratio):
    """Plies of S. W. Tsai and H. T. Hahn, 1980, and of pultruded glass: a long plate, by the moduli of its plane."""
    one = Material(
        name="own", youngs_modulus_Pa=along * 1e9, shear_modulus_Pa=shear * 1e9, density_kg_per_m3=1900.0,
        proof_strength_Pa=240e6,
    )  # fmt: skip
    rigid = 1 - ratio**2 * across / along
    plate = np.sqrt(along * across) / rigid + ratio * across / rigid + 2 * shear
    assert one.buckling_constants[0] <= np.sqrt(2 * np.pi**2 / 12 * plate * 1e9 / 250e6)
    uniform = Material(**{**one.model_dump(), "name": "own", "shear_modulus_Pa": along * 1e9 / 2.6})
    first, second = uniform.buckling_constants
    assert first == pytest.approx(np.sqrt(4 * np.pi**2 * along * 1e9 / (12 * 0.91) / 250e6))
    assert second == pytest.approx(0.22 * first**2)


def test_steels_are_those_of_the_standards():
    for name, strength in (("S235JRH", 235e6), ("S355J2H", 355e6), ("S460MH", 460e6)):
        steel = material(name)
        assert (steel.youngs_modulus_Pa, steel.density_kg_per_m3, steel.proof_strength_Pa) == (210e9, 7850, strength)


def test_unknown_material_is_refused_with_the_known_ones():
    with pytest.raises(InputError) as refused:
        material("6061-T66")
    assert str(refused.value).startswith("material: material: unknown material '6061-T66'")
    assert all(name in str(refused.value) for name in material_names())


OWN = {"youngs_modulus_Pa": 200e9, "density_kg_per_m3": 7900.0, "proof_strength_Pa": 500e6, "source": "tested"}


def test_the_strength_of_an_own_material_is_of_no_standard_that_it_does_not_name():
    """The class of buckling of an alloy is of EN 1999-1-1; its strength is what its builder states."""
    own = Material(name="6060 T66", buckling_class="A", **{key: OWN[key] for key in OWN if key != "source"})
    assert own.strength_source == "as given"
    assert Material(name="6060 T66", buckling_class="A", **OWN).strength_source == "tested"
    assert material("6060-T66").strength_source.startswith("EN 1999-1-1")


def of_own(**figures):
    """The shipped study with both beams of a material of its own."""
    table = read_table(STUDY)
    for beam in BEAMS:
        table[beam]["material"] = "mine"
    return table | {"material": {"mine": OWN | figures}}


@pytest.mark.parametrize(
    ("figures", "key", "words"),
    [
        # C1 / x - C2 / x^2 is largest at x = 2 C2 / C1, where it is C1^2 / (4 C2): here 0.5, and just 1
        ({"local_buckling": [10.0, 50.0], "buckling_class": "A"}, "material.mine.local_buckling", "C1^2 / 4, 25"),
        ({"local_buckling": [10.0, 25.0]}, "", ""),
        ({"name": "yours"}, "material.mine.name", "leave it out"),
    ],
)
def test_an_own_material_that_cannot_be_is_refused_by_its_key(figures, key, words):
    if not key:
        assert parse(DesignProblem, of_own(**figures), "study.toml").outer_beam.material.buckling_constants == (10, 25)
        return
    with pytest.raises(InputError) as refused:
        parse(DesignProblem, of_own(**figures), "study.toml")
    assert [problem.key for problem in refused.value.problems] == [key]
    assert words in str(refused.value)


@pytest.mark.parametrize("modulus", [200e9, 2e8])  # of steel, and of polyethylene
def test_own_materials_go_from_the_study_into_the_prototype_and_back(tmp_path, modulus):
    problem = parse(DesignProblem, of_own(youngs_modulus_Pa=modulus), "study.toml")
    assert problem.outer_beam.material.shear_modulus_Pa == pytest.approx(modulus / 2.6)
    rig = problem.prototype(Tube(0.14, 0.004), Tube(0.1, 0.003))
    write_prototype(rig, tmp_path / "rig.toml")
    again = read_prototype(tmp_path / "rig.toml")
    assert again == rig
    assert read_table(tmp_path / "rig.toml")["outer_beam"]["material"] == "mine"
    # K = 3 E I / L^3 with I of a sharp square tube.
    second_moment = (0.14**4 - 0.132**4) / 12
    assert lumped_beam(again.outer_beam).stiffness == pytest.approx(3 * modulus * second_moment / 1.195**3)


def test_an_own_material_is_checked_with_the_certificate(tmp_path):
    """The checker takes its figures from the prototype's own file, and tells when they are others."""
    rig = parse(DesignProblem, of_own(), "study.toml").prototype(Tube(0.14, 0.004), Tube(0.1, 0.003))
    rig = rig.but(controller=Lag(gain_A_per_V=1e-4, pole_Hz=20.0, zero_Hz=1.7))
    path, certificate = tmp_path / "rig.toml", tmp_path / "certificate.toml"
    certificate.write_text(certify(rig, 0.0, 2.0).text)
    write_prototype(rig, path)
    told = check(certificate, path)
    assert told.valid
    assert not any("mine" in words for words in told.open)
    path.write_text(path.read_text().replace("proof_strength_Pa = 500000000.0", "proof_strength_Pa = 400000000.0"))
    assert check(certificate, path).valid
    path.write_text(path.read_text().replace("density_kg_per_m3 = 7900.0", "density_kg_per_m3 = 7800.0"))
    assert not check(certificate, path).valid


@pytest.mark.parametrize(
    ("figures", "key", "words"),
    [
        ({"density_kg_per_m3": 7.9}, "material.mine.density_kg_per_m3", "7.9"),
        ({"youngs_modulus_Pa": 70}, "material.mine.youngs_modulus_Pa", "plausible range"),
        ({"youngs_modulus_GPa": 200.0}, "material.mine.youngs_modulus_GPa", "youngs_modulus_Pa"),
    ],
)
def test_what_is_wrong_with_an_own_material_is_told_where_it_stands(figures, key, words):
    with pytest.raises(InputError) as refused:
        parse(DesignProblem, of_own(**figures), "study.toml")
    ((place, reason),) = refused.value.problems
    assert place == key
    assert words in reason


def test_an_own_material_cannot_take_the_name_of_a_known_one():
    with pytest.raises(InputError, match="give yours another name"):
        parse(DesignProblem, read_table(STUDY) | {"material": {"6061-T6": OWN}}, "study.toml")


def test_materials_are_frozen():
    with pytest.raises(ValidationError):
        material("6061-T6").proof_strength_Pa = 1e9
