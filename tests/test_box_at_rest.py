"""Absolute stability over a box of tolerances: against drawn members in python-control, and the exact prover of masses.

What is asked of a multiplier is that Re[M (1 + L)] is positive at every frequency (G. Zames and P. L. Falb, SIAM J.
Control 6 (1968) 89), which is evaluated here from state-space matrices with M written out.
"""

import json
import tomllib
from math import pi
from pathlib import Path

import numpy as np
import pytest
from flint import fmpq
from forging import resealed
from one_start import best_start_alone
from test_box_claims import member, slowest
from typer.testing import CliRunner

from beamdesign import InputError, Prototype, check, read_prototype, state_space, tune
from beamdesign.checker import Unreadable
from beamdesign.cli import app
from beamdesign.polynomial import nearest, ratio
from beamdesign.proofs.absolute_stability import box_rows, slope_over_box
from beamdesign.proofs.box import certify_box
from beamdesign.proofs.box_claims import BoxClaim, claim_over_box, worst_over_box
from beamdesign.proofs.certificate import Asked
from beamdesign.proofs.multiplier import Kernel, Multiplier, fits
from beamdesign.proofs.rig_family import rig_values
from beamdesign.proofs.scope import members
from beamdesign.proofs.tolerance_box import tolerance_box
from beamdesign.structure.lumped import CHANGEABLE, with_figures
from beamdesign.synthesis import law_design

PROTOTYPES = Path(__file__).parents[1] / "studies" / "prototypes"
MASSES = (0.0, 6.8)
SEEN_rad_per_s = np.union1d(np.geomspace(0.01, 1e5, 150), np.geomspace(20.0, 1500.0, 350))
TWO = ["outer_stiffness", "flow_gain"]


@pytest.fixture(scope="module")
def rig() -> Prototype:
    """The published rig with a tame lag."""
    return read_prototype(PROTOTYPES / "tame_lag.toml").but(guarantee=None)


@pytest.fixture(scope="module")
def proved(rig: Prototype):
    """All figures two standard deviations off, with every payload."""
    box = tolerance_box(rig, 2.0, None, MASSES)
    return box, *slope_over_box(rig, box)


@pytest.fixture(scope="module")
def small(rig: Prototype):
    """Two figures off, and a certificate."""
    box = tolerance_box(rig, 1.0, TWO, MASSES)
    claim, _ = slope_over_box(rig, box)
    assert claim is not None
    return box, claim, certify_box(rig, box, volumes=False).write((claim,))


def one_plus_loop(rig: Prototype, mass: float, delay_s: float = 0.0) -> np.ndarray:
    """1 + L of one rig with a lag at frequencies, by python-control."""
    plant, s, lag = state_space(rig, mass, "plant"), 1j * SEEN_rad_per_s, rig.controller
    law = lag.gain_A_per_V * (1 + s / (2 * pi * lag.zero_Hz)) / (1 + s / (2 * pi * lag.pole_Hz))
    return 1 + law * np.exp(-s * delay_s) * plant(s)[1, 1]


def least_cosine(multiplier: Multiplier, closed: np.ndarray) -> float:
    """Least Re z / |z| of z = M (1 + L), M term by term as it is defined."""
    s, m = 1j * SEEN_rad_per_s, np.ones(len(SEEN_rad_per_s), dtype=complex)
    for c, kernel in multiplier.terms:
        m -= nearest(c) / (1 + (1 if kernel.causal else -1) * s / kernel.rate) ** kernel.order
    return float(((m * closed).real / abs(m * closed)).min())


def test_no_drawn_member_is_missed_by_the_multiplier(rig: Prototype, proved):
    box, claim, reason = proved
    assert isinstance(claim, BoxClaim), reason
    assert claim.holds is True
    multiplier = claim.asked.multiplier
    assert sum(abs(c) for c, _ in multiplier.terms) < 1
    assert min(c for c, _ in multiplier.terms) > 0  # so for every characteristic, odd or not
    generator, least = np.random.default_rng(1968), 1.0
    for k in range(24):
        shares = generator.integers(0, 2, len(box.ranges)) if k % 2 else generator.random(len(box.ranges))
        one = member(rig, box, shares)
        assert slowest(*one, 0.0) < 0
        least = min(least, least_cosine(multiplier, one_plus_loop(*one)))
    assert 0 < least < 0.3


def test_the_worst_member_is_as_bad_in_python_control(rig: Prototype, proved):
    box, claim, _ = proved
    worst = worst_over_box(rig, box, claim.asked)[0]
    assert 0.9 < worst.ratio < 1
    own = {name: nearest(value) for name, value in rig_values(rig).items()}
    factors = {n: nearest(v) / own[n] for n, v in worst.parameters.items() if n in CHANGEABLE and own.get(n)}
    closed = one_plus_loop(with_figures(rig, factors), nearest(worst.parameters["outer_end_mass"]))
    assert least_cosine(claim.asked.multiplier, closed) == pytest.approx(1 - worst.ratio, abs=2e-3)


def test_the_uncertain_phase_of_a_slow_valve_costs_no_pieces_of_a_multiplier_either(rig: Prototype):
    """Its lag turned all of the beams' resonances: 445 pieces were looked at, now 281; a slow link was undecided."""
    law = rig.controller.but(gain_A_per_V=0.003, pole_Hz=0.1, zero_Hz=1.0)
    slow = rig.but(servovalve=rig.servovalve.but(natural_frequency_Hz=20.0), controller=law)
    box = tolerance_box(slow, 2.0, None, MASSES)
    claim, reason = slope_over_box(slow, box, 350)
    assert claim is not None, reason
    generator = np.random.default_rng(12)
    for _ in range(6):
        one = member(slow, box, generator.random(len(box.ranges)))
        assert least_cosine(claim.asked.multiplier, one_plus_loop(*one)) > 0
    assert check(certify_box(slow, box, volumes=False).write((claim,))).valid


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_without_width_the_exact_prover_of_masses_says_the_same(rig: Prototype, share: float):
    """Half of the kernels is too little, for both; they share nothing but the plant."""
    box = tolerance_box(rig, 0.0, None, MASSES)
    claim, _ = slope_over_box(rig, box)
    assert claim is not None
    terms = [(c * fmpq(*share.as_integer_ratio()), kernel) for c, kernel in claim.asked.multiplier.terms]
    one = Multiplier(tuple(terms), fmpq(0))
    found, given = claim_over_box(rig, box, Asked("slope", 1.0, multiplier=one)), members(rig, *MASSES)
    assert found.holds is (share == 1.0)
    nominal = given.loops[0].characteristic, given.loops[0].loop_denominator
    assert fits(one, *nominal, given.low, given.high, fmpq(0)) is found.holds


def test_a_multiplier_that_the_theorem_does_not_know_proves_nothing(rig: Prototype):
    box = tolerance_box(rig, 0.0, None, MASSES)
    wild = Multiplier(((fmpq(1, 2), Kernel(150, 2)), (fmpq(1, 2), Kernel(100, 1))), fmpq(0))  # a norm of one
    assert claim_over_box(rig, box, Asked("slope", 1.0, multiplier=wild)).holds is not True


def test_any_delay_of_a_range_counts(rig: Prototype):
    box = tolerance_box(rig, 1.0, TWO, MASSES, delay_s=(0.0, 2e-4))
    claim, reason = slope_over_box(rig, box)
    assert claim is not None, reason
    assert check(certify_box(rig, box, volumes=False).write((claim,))).valid
    for mass in (0.0, 3.4, 6.8):
        closed = [one_plus_loop(rig, mass, delay) for delay in (0.0, 1e-4, 2e-4)]
        assert min(least_cosine(claim.asked.multiplier, one) for one in closed) > 0


def test_a_conditionally_stable_loop_is_refused_with_its_gain():
    rig = read_prototype(PROTOTYPES / "structured.toml").but(guarantee=None)
    claim, reason = slope_over_box(rig, tolerance_box(rig, 0.0, None, MASSES))
    assert claim is None
    share = float(reason.split("not stable at ")[1].split()[0])
    assert 0 < share < 1
    family = members(rig, *MASSES).loops[0].scaled(fmpq(round(1e6 * share), 10**6)).characteristic
    each = [family.at(fmpq(mass, 10)).coeffs()[::-1] for mass in (0, 34, 68)]
    poles = [np.roots([nearest(c) for c in coefficients]) for coefficients in each]
    assert max(one.real.max() for one in poles) > 0


def test_the_checker_proves_it_again_and_nothing_that_is_altered(small):
    _, _, text = small
    verdict = check(text)
    assert verdict.valid
    assert any("comes to rest about every equilibrium" in line for line in verdict.proved)
    for key, value in (("popov_s", "1/100"), ("limit", "2"), ("limit", "1/2"), ("kind", "peak_sensitivity")):
        forged = tomllib.loads(text)
        forged["claim"][0][key] = value
        with pytest.raises(Unreadable):
            check(resealed(forged))
    for key, value in (("coefficient", "1/10"), ("rate_per_s", "151"), ("order", 3), ("causal", False)):
        forged = tomllib.loads(text)
        forged["claim"][0]["term"][0][key] = value
        assert not check(resealed(forged)).valid, (key, value)
    forged = tomllib.loads(text)
    forged["claim"][0]["term"][0]["coefficient"] = "1"
    with pytest.raises(Unreadable, match="norm"):
        check(resealed(forged))


def test_neither_a_narrower_box_nor_a_lower_gain_is_taken_for_all(small):
    _, _, text = small
    for name in ("flow_gain", "outer_stiffness", "controller_gain"):
        forged = tomllib.loads(text)
        low, _ = forged["range"][name]
        forged["claim"][0]["range"] = {name: [low, low]} if name != "controller_gain" else {name: ["1/50", "1/50"]}
        assert not check(resealed(forged)).valid, name


def test_a_negative_kernel_is_for_odd_characteristics_and_says_so(rig: Prototype):
    box = tolerance_box(rig, 0.0, None, MASSES)
    odd = Multiplier(((fmpq(-3, 100), Kernel(10, 1, causal=False)), (fmpq(95, 100), Kernel(100, 1))), fmpq(0))
    claim = claim_over_box(rig, box, Asked("slope", 1.0, multiplier=odd))
    assert claim.holds
    verdict = check(certify_box(rig, box, volumes=False).write((claim,)))
    assert verdict.valid
    assert any("about zero current with an odd static" in line for line in verdict.proved)
    uneven = rig.but(effects={"unequal_piston_areas": {}})
    assert not any(row.proved for row in box_rows(uneven, claim, ""))
    assert box_rows(rig, claim, "")[0].proved


@pytest.mark.parametrize("name", ["pressure_dependent_flow", "unequal_piston_areas", "valve_deadband"])
def test_of_gains_that_effects_let_vary_the_largest_counts(rig: Prototype, name: str):
    rig = rig.but(effects={name: {}})
    box = tolerance_box(rig, 1.0, TWO, MASSES)
    claim, reason = slope_over_box(rig, box)
    assert claim is not None, reason
    if "effect_gain" in box.ranges:
        assert claim.own["effect_gain"] == (box.ranges["effect_gain"][1],) * 2
    text = certify_box(rig, box, volumes=False).write((claim,))
    assert check(text).valid
    if "effect_gain" in box.ranges:
        forged = tomllib.loads(text)
        forged["claim"][0]["range"]["effect_gain"] = [forged["range"]["effect_gain"][0]] * 2
        assert not check(resealed(forged)).valid
    moving = {one: row.proved for row in box_rows(rig, claim, "") for one in row.effects}
    assert moving["current_saturation"]
    assert moving[name] is (name != "pressure_dependent_flow")


def test_what_is_to_come_to_rest_is_to_be_stable_at_lower_gains(rig: Prototype):
    with pytest.raises(InputError, match="lower_gains"):
        tune(rig.but(goal=rig.goal.but(comes_to_rest=True, lower_gains=False)), MASSES)


def test_where_it_is_not_proved_loops_keep_farther_from_the_critical_point(rig: Prototype, monkeypatch):
    """Peaks at lower gains, from |1 + k L| on a grid, fall from one try to the next; in the end it is refused."""
    peaks = []

    def never(loops, low, high):
        k = np.linspace(0.01, 1.0, 100)
        each = ratio(loops[0].loop_numerator, loops[0].loop_denominator, np.linspace(*MASSES, 15), SEEN_rad_per_s)
        peaks.append(max(float(1 / abs(1 + share * each).min()) for share in k))
        return None, "No multiplier was looked for."

    monkeypatch.setattr(law_design, "absolute_stability", never)
    goal = rig.goal.but(comes_to_rest=True, peak_sensitivity=6.0)
    with best_start_alone():
        found = tune(rig.but(goal=goal), MASSES, sigmas=0.0)
    assert found.best is None
    assert (
        "comes to rest while the law's current saturates is not proved: No multiplier was looked for." in found.reason
    )
    assert len(peaks) > 1
    for peak, limit in zip(peaks[1:], (4.0, 2.0, 1.4), strict=False):
        assert peak < 1.02 * limit
    assert peaks[0] > 1.02 * 4.0


@pytest.mark.usefixtures("few_climbs")
@pytest.mark.parametrize(
    ("name", "options", "status"), [("tame_lag", ["--only", "flow_gain"], 0), ("structured", [], 1)]
)
def test_the_command_says_it_and_answers_no_where_it_is_not_so(tmp_path, monkeypatch, name, options, status):
    monkeypatch.chdir(tmp_path)
    file, target = PROTOTYPES / f"{name}.toml", tmp_path / "box.json"
    sigmas = "1" if options else "0"
    asked = ["certify-box", str(file), "--sigmas", sigmas, "--nonlinear", "--out", "b.toml", "--json", str(target)]
    done = CliRunner().invoke(app, [*asked, *options])
    assert done.exit_code == status
    fields = json.loads(target.read_text())
    assert fields["stable"] is True
    (row,) = fields["nonlinear"]
    assert (row["effects"], row["proved"]) == (["current_saturation"], status == 0)
    assert check((tmp_path / "b.toml").read_text()).valid
    kinds = [one["kind"] for one in tomllib.loads((tmp_path / "b.toml").read_text()).get("claim", [])]
    assert ("slope" in kinds) == (status == 0)
