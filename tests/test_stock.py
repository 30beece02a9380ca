"""Materials and stock sizes: what the data promise."""

from math import sqrt

import pytest
from pydantic import ValidationError

from beamdesign.records import InputError
from beamdesign.structure.materials import material, material_names, unknown_material
from beamdesign.structure.stock import stock_tubes


def test_stock_is_sorted_and_without_repetition():
    tubes = stock_tubes()
    assert list(tubes) == sorted(set(tubes))


def test_stock_tubes_are_tubes_within_what_the_data_state():
    for tube in stock_tubes():
        assert 0 < tube.wall_m < tube.width_m / 2
        assert tube.width_m / tube.wall_m <= 60 * (1 + 1e-12)
        assert tube.width_m * sqrt(2) <= 0.35


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


def test_all_alloys_are_aluminium():
    for name in material_names():
        alloy = material(name)
        assert alloy.density_kg_per_m3 == pytest.approx(2700, rel=0.03)
        assert alloy.youngs_modulus_Pa == pytest.approx(70e9, rel=0.03)


def test_unknown_alloy_is_refused_with_the_known_ones():
    with pytest.raises(InputError) as refused:
        material("6061-T66", "study.toml", "outer_beam.material")
    assert str(refused.value).startswith("study.toml: outer_beam.material: unknown alloy '6061-T66'")
    assert all(name in str(refused.value) for name in material_names())
    assert unknown_material("6061-T6") is None


def test_materials_are_frozen():
    with pytest.raises(ValidationError):
        material("6061-T6").proof_strength_Pa = 1e9
