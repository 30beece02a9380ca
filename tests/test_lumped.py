"""Lumped figures: measured where they stand, from the geometry otherwise; the dashpot of the bare beam."""

from math import pi, sqrt

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beamdesign import Prototype
from beamdesign.plant.rigs import FIGURES
from beamdesign.prototype import Beam
from beamdesign.structure.lumped import figures, fixed_dashpot, lumped_beam, notes
from beamdesign.structure.materials import Material
from beamdesign.structure.section import RoundTube

TUBE = {"width_m": 0.14, "wall_m": 0.0023, "free_length_m": 1.195, "material": "6061-T6"}


def test_a_tube_by_hand():
    """K = 3 E I / L^3 with I = (W^4 - w^4) / 12; 33/140 of the tube's own mass moves with a light tip."""
    lumped = lumped_beam(Beam(**TUBE, end_mass_kg=2.93, damping_ratio=0.05))
    second_moment = (0.14**4 - (0.14 - 2 * 0.0023) ** 4) / 12
    tube_mass = 2700.0 * (0.14**2 - (0.14 - 2 * 0.0023) ** 2) * 1.195
    assert lumped.stiffness == pytest.approx(3 * 69e9 * second_moment / 1.195**3, rel=1e-12)
    assert lumped.mass == pytest.approx(2.93 + 33 / 140 * tube_mass, rel=0.01)
    assert lumped.damping == pytest.approx(2 * 0.05 * sqrt(lumped.stiffness * lumped.mass), rel=1e-12)
    assert lumped.notes == ()


def test_measured_figures_win_one_by_one_and_say_so():
    computed = lumped_beam(Beam(**TUBE))
    measured = lumped_beam(Beam(**TUBE, stiffness_N_per_m=4e5), "outer_beam")
    assert (measured.stiffness, measured.mass) == (4e5, computed.mass)
    (note,) = measured.notes
    assert note.startswith("outer_beam: measured stiffness 400000 N/m used, geometry gives 48")
    both = lumped_beam(Beam(**TUBE, stiffness_N_per_m=4e5, effective_mass_kg=3.0))
    assert (both.stiffness, both.mass, len(both.notes)) == (4e5, 3.0, 2)


def test_measured_figures_alone_have_nothing_to_win_over(paper):
    assert notes(paper) == ()
    assert lumped_beam(paper.outer_beam).stiffness == 486_800.0


@pytest.mark.parametrize("depth", [0.07, 0.14, 0.21])
def test_a_laminate_that_shears_is_told(paper, depth):
    """Shear coefficients of thin tubes: G. R. Cowper, J. Appl. Mech. 33 (1966) 335, at a Poisson's ratio of zero."""
    ratio = 0.14 / depth  # width over depth, m and n of the paper
    coefficient = (
        10 * (1 + 3 * ratio) ** 2
        / (12 + 72 * ratio + 150 * ratio**2 + 90 * ratio**3 + 30 * ratio**3 * (1 + ratio))
    )  # fmt: skip
    own = Material(name="pultruded", youngs_modulus_Pa=38e9, shear_modulus_Pa=3.5e9, density_kg_per_m3=1900.0,
                   proof_strength_Pa=240e6)  # fmt: skip
    beam = Beam(**TUBE | {"wall_m": 1e-4, "material": own, "shape": "rectangle", "depth_m": depth})
    _, tube, length = beam.geometry
    bent = length**3 / (3 * 38e9 * tube.second_moment)
    sheared = length / (3.5e9 * coefficient * tube.area)
    (note,) = notes(paper.but(outer_beam=beam))
    assert f"makes it {100 * sheared / (bent + sheared):.2g} % softer" in note
    assert notes(paper.but(outer_beam=Beam(**TUBE))) == ()
    assert RoundTube(0.1, 1e-5).shear_area == pytest.approx(RoundTube(0.1, 1e-5).area / 2)  # likewise


@given(ratio=st.floats(0, 0.99), stiffness=st.floats(1, 1e9), mass=st.floats(1e-3, 1e3), added=st.floats(0, 1e3))
def test_the_dashpot_stays_when_mass_is_added(ratio, stiffness, mass, added):
    """The logarithmic decrement of the loaded beam shrinks as the root of its mass ratio."""
    dashpot = fixed_dashpot(ratio, stiffness, mass)
    loaded_ratio = dashpot / (2 * sqrt(stiffness * (mass + added)))
    assert loaded_ratio == pytest.approx(ratio * sqrt(mass / (mass + added)), rel=1e-9, abs=1e-15)


def test_figures_come_in_the_order_of_the_model(paper: Prototype):
    lumped = figures(paper)
    assert tuple(lumped) == FIGURES[:-2]
    assert lumped["valve_frequency"] == pytest.approx(2 * pi * 150.0)
    assert lumped["filter_frequency"] == 0.0
    filtered = figures(paper.but(sensor=paper.sensor.but(filter_Hz=400.0)))
    assert filtered["filter_frequency"] == pytest.approx(2 * pi * 400.0)
    assert {k: v for k, v in filtered.items() if k != "filter_frequency"} == {
        k: v for k, v in lumped.items() if k != "filter_frequency"
    }
