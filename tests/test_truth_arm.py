"""The truth model's arms: a tube in bending and twist with a payload on a lever, and their cases.

Held against closed forms worked out here, and against the exact loop of an arm, with which the truth shares no code.
"""

from math import pi, sqrt

import numpy as np
import pytest
from plane_at_payload import at_tip
from scipy.optimize import brentq
from test_truth import NO_OIL, OFF, PUBLISHED

from beamdesign import read_dataset
from beamdesign.proofs.arm import plane_loop
from beamdesign.prototype import prototype_from
from beamdesign.structure.arm import arm_figures
from beamdesign.validation.truth.beams import tip_slope, twist_modes
from beamdesign.validation.truth.case import Departure, answer, noise_free, relative_gap, write_case
from beamdesign.validation.truth.drawing import draw_case, jacobian
from beamdesign.validation.truth.effects import KINDS, LISTED
from beamdesign.validation.truth.nominal import assembled, rig_figures
from beamdesign.validation.truth.rates import STATES, rates_at
from beamdesign.validation.truth.rig import controller_figures
from beamdesign.validation.truth.rig_kinds import on

ALLOY = {"youngs_modulus_Pa": 69e9, "shear_modulus_Pa": 26e9, "density_kg_per_m3": 2700.0, "proof_strength_Pa": 2.4e8}
TUBE = {"free_length_m": 1.195, "width_m": 0.14, "wall_m": 0.0023, "material": "alloy"}
INERTIA = {"end_polar_inertia_kg_m2": 0.0073, "payload_polar_inertia_kg_m2": 0.0}
TORSION = {"torsional_stiffness_N_m_per_rad": 131000.0, "torsional_damping_ratio": 0.03}
BESIDE, AHEAD, ABOVE = [0.05, 0.2, 0.0], [0.1, 0.0, 0.0], [0.05, 0.0, 0.15]
LAG = {"kind": "lag", "gain_A_per_V": 0.02, "pole_Hz": 1.75, "zero_Hz": 26.0}


def table(offset, sensor=None, **more):
    """The published rig as an arm in z, as its designers believe it."""
    arm = {"plane": "z", "offset_m": offset, **INERTIA, **TORSION, **more}
    arm |= {} if sensor is None else {"sensor_m": sensor}
    return PUBLISHED | {"outer_beam": PUBLISHED["outer_beam"] | TUBE, "arm": arm, "material": {"alloy": ALLOY}}


def rig(offset, sensor=None, payload=6.0, **changes):
    return assembled(rig_figures(table(offset, sensor), {}, {}) | OFF | {"outer_end_mass": payload} | changes)


# --- the beam


@pytest.mark.parametrize("end", [0.0, 0.0073, 0.5])
def test_a_tube_twists_as_its_closed_form(end):
    """G J / L under a steady moment, and b tan b = I / I_end of a clamped rod (Blevins 1979, table 8-19)."""
    stiffness, tube = 131000.0, 0.026
    modes = twist_modes(stiffness, tube, end, 0.03)
    assert (1 / modes[0]).sum() == pytest.approx(1 / stiffness, rel=1e-9)
    root = brentq(lambda b: b * np.sin(b) * end - tube * np.cos(b), 1e-6, 1.6)
    first = root * sqrt(stiffness / tube)
    assert sqrt(modes[0, 0] / modes[1, 0]) == pytest.approx(first, rel=5e-4)
    assert modes[2, 0] == pytest.approx(0.06 * sqrt(modes[0, 0] * modes[1, 0]))


def test_the_end_of_a_cantilever_slopes_as_its_mode():
    """1.3765 of a bare one (Blevins 1979, table 8-1); with ever more at its end, 3/2 as under a force."""
    assert tip_slope(0.0) == pytest.approx(1.87510407 * 0.7340955, rel=1e-5)
    assert tip_slope(1e4) == pytest.approx(1.5, abs=1e-5)
    assert tip_slope(0.0) < tip_slope(1.0) < tip_slope(3.0) < 1.5


# --- the payload


def test_a_payload_without_a_lever_is_that_of_the_other_rigs():
    plain = assembled(rig_figures(PUBLISHED, {}, {}) | OFF | {"outer_end_mass": 6.0})
    for _ in range(3):
        x = np.random.default_rng(4).normal(0, 1e-4, STATES)
        assert np.array_equal(rates_at(x, *rig([0.0, 0.0, 0.0]), 0.1, 30.0), rates_at(x, *plain, 0.1, 30.0))


def test_a_lever_on_a_tip_that_is_held_swings_on_the_tubes_twist():
    """omega^2 = (G J / L) / (I + m e^2), the tube itself without inertia to speak of."""
    light = table(BESIDE) | {"material": {"alloy": ALLOY | {"density_kg_per_m3": 1e-6}}}
    held = {"modes.stiffness": 1e12, "modes.mass": 1e8, "outer_end_mass": 6.0}
    figures = rig_figures(light, {"torsional_damping_ratio": 1e-9}, {}) | OFF | NO_OIL | held
    found = np.linalg.eigvals(jacobian(*assembled(figures)))
    expected = sqrt(131000.0 / (0.0073 + 6.0 * 0.2**2))
    assert np.abs(found.imag - expected).min() < 1e-4 * expected


@pytest.mark.parametrize("offset", [BESIDE, ABOVE])
def test_a_payload_takes_part_in_every_mode_as_its_energy_says(offset):
    """(diag M + m (p p^T + a a^T)) q'' = F of Lagrange's equations, p and a its motion across and along the beam."""
    record, modes = rig(offset, **NO_OIL)
    bends, count = tip_slope((3.9 - 33 / 140 * TUBE_KG + 6.0) / TUBE_KG) / 1.195, modes.shape[1]
    across = np.array([1 + bends * offset[0], *[offset[1]] * (count - 1)])
    along = np.array([-bends * offset[2], *[0.0] * (count - 1)])
    assert (count > 1) == (offset[1] != 0)
    x = np.zeros(STATES)
    q, v = np.random.default_rng(1).normal(0, 1e-3, (2, count))
    x[:count], x[4 : 4 + count] = q, v
    push = np.eye(count)[0] * 30.0 - modes[0] * q - modes[2] * v
    whole = np.diag(modes[1]) + 6.0 * (np.outer(across, across) + np.outer(along, along))
    found = rates_at(x, record, modes, 0.0, 30.0)[4 : 4 + count]
    np.testing.assert_allclose(found, np.linalg.solve(whole, push), rtol=1e-6)


TUBE_KG = 2700.0 * 4 * 0.1377 * 0.0023 * 1.195


@pytest.mark.parametrize(
    ("offset", "sensor"),
    [(BESIDE, None), (AHEAD, None), (ABOVE, None), (BESIDE, [0.04, 0.15, 0.0]), (AHEAD, [0.1, 0.0, 0.0])],
)
def test_its_loop_is_that_of_the_exact_polynomials(offset, sensor):
    """Which let the end slope as under a force: so it does under a heavy payload, and nearly under one of 6 kg."""
    believed = prototype_from(table(offset, sensor) | {"controller": LAG, "payload": {"inner_end_mass_kg": 4.0}})
    loop = plane_loop(believed, "z")
    hertz = np.array([1.0, 10.0, 20.0, 40.0, 70.0])
    s = 2j * pi * hertz
    for payload, most in ((6.0, 5e-3), (400.0, 5e-4)):
        law = controller_figures(LAG) | {"inner_end_mass": 4.0}
        record, modes = rig(offset, sensor, payload, **law)
        a, force = jacobian(record, modes, every=True), rates_at(np.zeros(STATES), record, modes, 0.0, 1.0)
        tip = np.append(modes[3], np.zeros(STATES - modes.shape[1]))
        found = np.array([tip @ np.linalg.solve(at * np.eye(STATES) - a, force) for at in s])
        exact = at_tip(loop, payload)
        told = [np.polyval([float(c) for c in p.coeffs()][::-1], s) for p in (exact.disturbance, exact.characteristic)]
        np.testing.assert_allclose(found, told[0] / told[1], rtol=most)


# --- cases


@pytest.fixture(scope="module")
def beside():
    """Its payload stands 0.24 m beside the plane."""
    return draw_case(8, "null", short=True, rig="arm")


def test_an_arm_is_a_data_set_of_the_contract(beside, tmp_path):
    write_case(beside, tmp_path)
    found = read_dataset(tmp_path)
    assert not found.warnings
    assert found.prototype.arm.plane == "z"
    assert abs(found.prototype.arm.offset_m[1]) > 0.2
    assert answer(beside)["rig"] == "arm"
    figures = arm_figures(found.prototype)
    ours = rig_figures(beside.nominal, {}, {})
    tube, end = ours["arm.tube_inertia"], ours["arm.end_inertia"]
    assert tube / 3 + end == pytest.approx(figures.polar_inertia, rel=1e-2)  # of a wall's middle line, and as it is
    assert figures.torsional_stiffness == ours["arm.torsional_stiffness"]
    twisted = beside.factors["torsional_stiffness"]
    assert 0.003 < abs(twisted - 1) < 4 * beside.nominal["tolerance"]["stiffness"]


@pytest.mark.parametrize("name", ["payload_slosh", "sensor_bracket", "parameter:stiffness"])
def test_what_is_felt_at_the_payload_or_the_sensor_changes_an_arm(beside, name):
    if name.startswith("parameter:"):
        less, more = (Departure(name, size, figure="torsional_stiffness") for size in (0.1, 0.3))
    else:
        low, high = KINDS[name].range
        shape = KINDS[name].shape(np.random.default_rng(5))
        less, more = (Departure(name, size, shape) for size in ((low**3 * high) ** 0.25, sqrt(low * high)))
    before = noise_free(beside, 0.4)
    gaps = [relative_gap(noise_free(beside.only(one), 0.4), before) for one in (less, more)]
    assert 1e-3 < gaps[0] < gaps[1]


def test_a_second_bending_mode_is_none_of_an_arm():
    assert set(on("lag", LISTED)) - set(on("arm", LISTED)) == {"second_beam_mode"}
    with pytest.raises(ValueError, match="no rig of kind arm has second_beam_mode"):
        draw_case(1, "single", names=("second_beam_mode",), rig="arm")


def test_payloads_of_arms_mostly_stand_off_the_axis():
    """In either plane, and never to both sides, which would couple them."""
    drawn = [draw_arm(seed) for seed in range(60)]
    assert {arm["plane"] for arm in drawn} == {"y", "z"}
    assert not any(arm["offset_m"][1] and arm["offset_m"][2] for arm in drawn)
    off = [arm for arm in drawn if any(arm["offset_m"])]
    assert 36 < len(off) < 60
    assert 0 < sum("sensor_m" in arm for arm in off) < len(off) / 2
    levers = [abs(arm["offset_m"][1 if arm["plane"] == "z" else 2]) for arm in drawn]
    assert 24 < sum(lever > 0 for lever in levers) < 48
    assert max(levers) < 0.3


def draw_arm(seed):
    from beamdesign.validation.truth.arm import with_arm
    from beamdesign.validation.truth.nominal import draw_nominal

    rng = np.random.default_rng(seed)
    return with_arm(draw_nominal(rng, "arm"), rng)["arm"]
