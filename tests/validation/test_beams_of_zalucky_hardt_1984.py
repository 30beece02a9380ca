"""The published pair of beams.

A. Zalucky and D. E. Hardt, "Active Control of Robot Structure Deflections", Journal of Dynamic Systems, Measurement,
and Control 106 (1984): section "System Design and Modelling" and appendix.

The free lengths and the modulus are not printed there. E = 69 GPa with 1.195 m and 1.365 m (the beams are clamped in
the base over the rest of their 1.5 m) reproduces both measured stiffnesses; the end masses are what the printed
effective masses leave in equation (5).
"""

from pathlib import Path

import pytest

from beamdesign import DesignProblem, read_problem
from beamdesign.structure.lumped import effective_mass, first_frequency, tip_stiffness
from beamdesign.structure.materials import material
from beamdesign.structure.section import Tube, clearances
from beamdesign.synthesis.checks import beam_mass, check_sections

OUTER, INNER = Tube(0.140, 0.0023), Tube(0.100, 0.0032)
ALLOY = material("6061-T6")


@pytest.fixture
def problem() -> DesignProblem:
    return read_problem(Path(__file__).parents[2] / "studies" / "prototype.toml")


@pytest.mark.parametrize(("tube", "free_length", "measured_N_per_cm"), [(OUTER, 1.195, 4868.0), (INNER, 1.365, 1575.0)])
def test_measured_stiffness(tube, free_length, measured_N_per_cm):
    rigidity = ALLOY.youngs_modulus_Pa * tube.second_moment
    assert tip_stiffness(rigidity, free_length) == pytest.approx(100 * measured_N_per_cm, rel=0.003)


def test_full_length_would_give_only_half_of_the_measured_stiffness():
    rigidity = ALLOY.youngs_modulus_Pa * OUTER.second_moment
    assert tip_stiffness(rigidity, 1.5) / 486_800 == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize(
    ("tube", "free_length", "end_mass", "printed_kg"), [(OUTER, 1.195, 2.93, 3.9), (INNER, 1.365, 0.52, 1.6)]
)
def test_printed_effective_mass(tube, free_length, end_mass, printed_kg):
    per_length = tube.mass_per_length(ALLOY.density_kg_per_m3)
    assert round(effective_mass(per_length, free_length, end_mass), 1) == printed_kg


def test_the_two_beams_vibrate_at_close_frequencies():
    def frequency(tube, free_length, end_mass):
        rigidity = ALLOY.youngs_modulus_Pa * tube.second_moment
        return first_frequency(rigidity, tube.mass_per_length(ALLOY.density_kg_per_m3), free_length, end_mass)

    # sqrt(K / M) / (2 pi) of the printed stiffnesses and effective masses.
    assert frequency(OUTER, 1.195, 2.93) == pytest.approx(56.2, rel=0.002)
    assert frequency(INNER, 1.365, 0.52) == pytest.approx(49.9, rel=0.002)


def test_the_published_pair_passes_every_check_with_a_slender_outer_wall(problem):
    pair = check_sections(problem, OUTER, INNER)
    assert pair.feasible
    checks = {check.name: check for check in pair.checks}
    # 2000 N bends the inner beam by 12.7 mm, of 17.7 mm.
    assert clearances(OUTER, INNER)[0] == pytest.approx(0.0177)
    assert checks["clearance under load, servo on"].value == pytest.approx(0.0177 - 2000 / 157_500, abs=3e-5)
    assert pair.beam_mass_kg == pytest.approx(2700 * 1.5 * (0.14**2 - 0.1354**2 + 0.1**2 - 0.0936**2), rel=1e-12)
    assert beam_mass(problem, OUTER, INNER) == pair.beam_mass_kg
