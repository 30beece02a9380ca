"""Tuning where the sensor turns with the mount, so that the payload shows in what it reads.

The optimiser's plant and constraints against the exact loop, and
what is tuned against the assembled rig's own matrices.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import pi

import numpy as np
import pytest

from beamdesign import Prototype, check, state_space
from beamdesign.controllers import Lag
from beamdesign.controllers.protocol import form_of
from beamdesign.diagnosis.redesign import redesign
from beamdesign.loop import LoopAtMass, loop, rig_loop
from beamdesign.plant.linear import LinearModel
from beamdesign.plant.members import family
from beamdesign.prototype import Goal, Payload
from beamdesign.synthesis.loop_samples import Samples, Slacks, first_miss, sampled_bandwidth, samples, slacks

LAG = Lag(gain_A_per_V=0.1, pole_Hz=1.3, zero_Hz=38.0)
FREQUENCIES_HZ = np.geomspace(0.05, 600.0, 300)
MASSES_KG = np.array([0.0, 2.0, 5.0])
STIFF = {"stiffness_N_per_m": 2e7, "frequency_Hz": 85.0, "damping_ratio": 0.03}


@pytest.fixture
def riding(paper: Prototype) -> Prototype:
    return paper.but(effects={"mount_compliance": STIFF | {"sensor_share": 0.6}})


@pytest.fixture
def member(riding: Prototype) -> LinearModel:
    (only,) = family(riding, 5.0).members
    return only.rig


def loaded(rig: Prototype, law: Lag, inner: float, outer: float) -> LoopAtMass:
    return loop(rig.but(controller=law, payload=Payload(inner_end_mass_kg=inner))).at(outer)


def test_slacks_are_those_of_the_exact_loop(riding: Prototype, member: LinearModel):
    form, goal = form_of("lag"), riding.goal
    for outer, inner in ((0.0, 0.0), (5.0, 0.0), (2.0, 1.5)):
        exact = loaded(riding, LAG, inner, outer)
        points = samples(member.polynomials(), FREQUENCIES_HZ, [outer])
        found = slacks(points, goal, form, np.append(np.log([0.1, 1.3, 38.0]), inner), slopes=False)
        allowed = goal.peak_sensitivity / np.abs(exact.sensitivity_response(FREQUENCIES_HZ))
        np.testing.assert_allclose(found.sensitivity, np.log(allowed), atol=1e-8)
        allowed = goal.compliance_m_per_N / np.abs(exact.compliance_response(FREQUENCIES_HZ))
        np.testing.assert_allclose(found.compliance, np.log(allowed), atol=1e-8)


def left_by_lag(rig: LinearModel, goal: Goal, masses: Sequence[float]) -> tuple[Samples, Slacks]:
    """What the lag leaves of every limit with 1.5 kg inside."""
    points = samples(rig.polynomials(), FREQUENCIES_HZ, masses)
    form, variables = LAG.form()
    return points, slacks(points, goal, form, np.append(variables, 1.5), slopes=False)


def test_a_sampled_loop_has_the_bandwidth_of_the_exact_one(riding: Prototype, member: LinearModel):
    points, left = left_by_lag(member, riding.goal, MASSES_KG)
    exact = [loaded(riding, LAG, 1.5, float(mass)) for mass in MASSES_KG]
    worst = np.max([np.abs(one.compliance_response(FREQUENCIES_HZ)) for one in exact], axis=0)
    expected = first_miss(FREQUENCIES_HZ, np.log(riding.goal.compliance_m_per_N / worst))
    assert sampled_bandwidth(points, left.compliance) == pytest.approx(expected, rel=1e-6)
    peaks = [np.abs(one.sensitivity_response(FREQUENCIES_HZ)).max() for one in exact]
    assert max(peaks) == pytest.approx(riding.goal.peak_sensitivity * np.exp(-left.sensitivity.min()), rel=1e-6)


def test_a_stage_of_a_schedule_has_the_plant_at_its_own_payload(riding: Prototype, member: LinearModel):
    """Of its samples, and of the loop that is proved."""
    stretched = replace(member, stretch=(1.5, 0.5))
    here, there = (left_by_lag(rig, riding.goal, [m])[1] for rig, m in ((member, 2.5), (stretched, 2.0)))
    np.testing.assert_allclose(here.values, there.values, rtol=1e-9, atol=1e-9)
    proved = [rig_loop(rig, 1.5, LAG).at(mass) for rig, mass in ((member, 2.5), (stretched, 2.0))]
    shown = [one.compliance_response(FREQUENCIES_HZ) for one in proved]
    np.testing.assert_allclose(*shown, rtol=1e-9)


@pytest.mark.usefixtures("one_start")
def test_what_is_tuned_keeps_its_promise_by_the_matrices_of_the_rig(riding: Prototype):
    """As a diagnosis hands it on: its fitted share is never nought."""
    made = redesign(riding, (0.0, 3.0))
    assert made.prototype is not None, made.reason
    ((certificate, _),) = made.proofs
    assert check(certificate.text).valid
    guarantee = made.prototype.guarantee
    assert guarantee is not None
    lines = np.concatenate([np.geomspace(0.01, guarantee.bandwidth_Hz, 100), [guarantee.bandwidth_Hz * 1.003]])
    seen = np.max([np.abs(state_space(made.prototype, m)(2j * pi * lines)[0, 0]) for m in (0.0, 1.5, 3.0)], axis=0)
    limit = made.prototype.goal.compliance_m_per_N
    assert seen[:-1].max() <= limit * (1 + 1e-6)
    assert seen[-1] > limit


def test_a_gain_that_varies_as_well_is_a_no_in_words(riding: Prototype):
    """Unequal sides of the piston change the gain with the direction; no proof covers that with such a sensor."""
    both = riding.but(effects={**riding.effects, "unequal_piston_areas": {"asymmetry": 0.1}})
    made = redesign(both, (0.0, 3.0))
    assert made.prototype is None
    assert "effects.unequal_piston_areas: lets the gain vary where the loop is to perform" in made.reason
    assert "remove it" in made.reason
