"""Compliance on demand: stiffness, passivity, contact and commands against closed forms, matrices and records."""

import json
import re
import tomllib
from copy import deepcopy
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from as_quick import as_quick
from flint import fmpq
from forging import sealed_text
from honest_certificates import screw
from similar import similar
from stated_rig import StatedRig
from truth_of_contact import Port, true
from typer.testing import CliRunner

from beamdesign import InputError, Prototype, certify, check, read_prototype, simulate, state_space, write_prototype
from beamdesign import stiffness as give
from beamdesign.checker import Unreadable
from beamdesign.cli import app
from beamdesign.controllers import Cascade, Lag, Observer, Structured
from beamdesign.loop import Loop, close_loop, loop
from beamdesign.polynomial import Affine, exact, is_hurwitz, roots
from beamdesign.proofs.contact import Wall, absorbed, popov_slack, prove_contact
from beamdesign.proofs.stability import stable_ranges
from beamdesign.proofs.writer import prototype_table, rig_tables
from beamdesign.prototype import Compliance
from beamdesign.scenario import Scenario, ScenarioRecord, Sine, Step, WallAhead
from beamdesign.simulation import SimulatedRecord
from beamdesign.structure.lumped import figures
from beamdesign.synthesis import stiffness_search
from beamdesign.synthesis.end_stiffness import (
    EndStiffness,
    commanded_compliance,
    contact_text,
    controller_of,
    in_words,
    judge,
    least_gain,
    over_compliance,
    sensed,
    servo_stiffness,
    softest_N_per_m,
    stable_compliances,
)
from beamdesign.synthesis.rig_spread import rig_spread
from beamdesign.synthesis.stiffness_search import SEED_OF_RIGS, carried_out, drawn_rigs

PROTOTYPES = Path(__file__).parent.parent / "studies/prototypes"
MASSES_KG = (0.0, 6.8)
MASSES = (fmpq(0), exact(6.8))
WALL = Wall((fmpq(0), fmpq(10**9)))


def compliant(servo: Cascade, end_stiffness: float, force_filter_Hz: float) -> Compliance:
    """The record of a law that gives the end a stiffness."""
    return Compliance(end_stiffness_N_per_m=end_stiffness, force_filter_Hz=force_filter_Hz, servo=servo)


SOFT = compliant(Lag(gain_A_per_V=0.0036, pole_Hz=3.966, zero_Hz=226.9), 3e5, 366.2)
"""Passive at the tip."""
FIRM = compliant(Lag(gain_A_per_V=0.001109, pole_Hz=13.14, zero_Hz=3.996), 1e6, 12.83)
"""Stable against every wall, not passive."""


@pytest.fixture(scope="module")
def rig() -> Prototype:
    """The published rig with a tame lag at 50 mA/V and 2.5 kg inside."""
    return read_prototype(PROTOTYPES / "tame_lag.toml")


@pytest.fixture(scope="module")
def brisk(rig: Prototype) -> Compliance:
    """The lag as it is, told to be as stiff as twice its outer beam: stable in the air alone."""
    assert isinstance(rig.controller, Lag)
    return compliant(rig.controller, 1e6, 30.0)


@pytest.fixture(scope="module")
def judged(rig: Prototype, brisk: Compliance) -> dict[str, EndStiffness]:
    """What is proved of all three."""
    return {name: judge(rig, law, MASSES_KG, WALL) for name, law in (("soft", SOFT), ("firm", FIRM), ("brisk", brisk))}


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search that takes a second."""
    for name, count in {"_ROUNDS": 1, "_STARTS": 100, "_STEPS": 60, "_REFINING_STEPS": 1}.items():
        monkeypatch.setattr(stiffness_search, name, count)


def port_of(rig: Prototype, law: Compliance) -> Loop:
    return close_loop(sensed(rig), controller_of(rig, law))


def apparent(rig: Prototype, law: Compliance, mass: float, frequency_Hz: np.ndarray) -> np.ndarray:
    """F / x by the impedances of the parts, complex: eliminated by hand, with no polynomial."""
    figure, s = figures(rig), 2j * np.pi * frequency_Hz
    area, gain = figure["piston_area"], figure["sensor_gain"]
    inner = (figure["inner_mass"] + rig.payload.inner_end_mass_kg) * s**2 + figure["inner_damping"] * s
    inner += figure["inner_stiffness"]
    natural = figure["valve_frequency"]
    valve = figure["flow_gain"] / ((s / natural) ** 2 + 2 * figure["valve_damping_ratio"] * s / natural + 1)
    exact_law = law.servo.transfer_function()
    servo = np.polyval([float(c) for c in reversed(exact_law.numerator.coeffs())], s)
    servo = servo / np.polyval([float(c) for c in reversed(exact_law.denominator.coeffs())], s)
    seen = gain / (1 + s / figure["filter_frequency"]) if figure["filter_frequency"] else gain
    force = gain * commanded_compliance(rig, law) / (1 + s / (2 * np.pi * law.force_filter_Hz))
    # F_c (1 / K_c + 1 / Z_f + K_pq / (A^2 s)) = Q / (A s) - x, Q = V C [force (K_m x seen / gain - F_c) - seen x]
    held = 1 / figure["oil_stiffness"] + 1 / inner + figure["leakage"] / (area**2 * s)
    flow = valve * servo / (area * s)
    cylinder = (flow * seen * (force * figure["outer_stiffness"] / gain - 1) - 1) / (held + flow * force)
    outer = (figure["outer_mass"] + mass) * s**2 + figure["outer_damping"] * s + figure["outer_stiffness"]
    return np.asarray(outer - cylinder)


@pytest.mark.parametrize("name", ["tame_lag", "structured"])
@pytest.mark.parametrize("stiffness", [2e3, 4.868e5, 2e6])
def test_the_end_is_as_stiff_at_rest_as_it_is_told_to_be(name: str, stiffness: float) -> None:
    """Closed form, and the balance of forces at rest: F = K_m x - F_c, F_c = A (K_q / K_pq) current."""
    rig = read_prototype(PROTOTYPES / f"{name}.toml")
    assert rig.controller is not None
    law = compliant(rig.controller, stiffness, 20.0)  # type: ignore[arg-type]
    assert port_of(rig, law).at(0.0).static_stiffness() == pytest.approx(stiffness, rel=1e-12)
    figure, compliance = figures(rig), commanded_compliance(rig, law)
    drive = figure["piston_area"] * figure["flow_gain"] / figure["leakage"] * rig.controller.gain_A_per_V
    drive *= figure["sensor_gain"]
    beam = figure["outer_stiffness"]
    # F_c = drive (compliance (K_m x - F_c) - x)
    balance = np.array([[beam, -1.0], [drive * (1 - compliance * beam), 1 + drive * compliance]])
    x, _ = np.linalg.solve(balance, [1.0, 0.0])
    assert 1 / x == pytest.approx(stiffness, rel=1e-9)
    assert servo_stiffness(rig, law.servo) == pytest.approx(beam + drive, rel=1e-12)
    assert servo_stiffness(
        rig, law.servo.but(gain_A_per_V=least_gain(rig, 5 * beam))
    ) == pytest.approx(5 * beam, rel=1e-9)  # fmt: skip


def test_no_end_is_stiffer_than_its_servo(rig: Prototype, brisk: Compliance) -> None:
    most = servo_stiffness(rig, brisk.servo)
    alone = compliant(brisk.servo, most, 30.0)
    assert commanded_compliance(rig, alone) == pytest.approx(0.0, abs=1e-18)
    with pytest.raises(ValueError, match="the servo alone holds"):
        controller_of(rig, compliant(brisk.servo, most * 1.01, 30.0))


@pytest.mark.parametrize("mass", MASSES_KG)
def test_the_exact_loop_is_that_of_the_impedances(rig: Prototype, brisk: Compliance, mass: float) -> None:
    frequencies = np.geomspace(0.01, 800, 60)
    filtered = read_prototype(PROTOTYPES / "structured.toml")
    assert isinstance(filtered.controller, Structured)
    for prototype, law in (
        (rig, SOFT),
        (rig, FIRM),
        (rig, brisk),
        (filtered, compliant(filtered.controller, 4e5, 9.0)),
    ):
        seen = port_of(prototype, law).at(mass).stiffness_response(frequencies)
        assert np.abs(seen / apparent(prototype, law, mass, frequencies) - 1).max() < 1e-9


def closed(rig: Prototype, law: Compliance, mass: float) -> tuple[np.ndarray, np.ndarray, int, int]:
    """The same with a compliant law."""
    return parts_of(rig.but(controller=controller_of(rig, law)), mass)


def parts_of(prototype: Prototype, mass: float) -> tuple[np.ndarray, np.ndarray, int, int]:
    """A and the column of the tip force of the closed loop from the models in floats; places of x and of its rate."""
    system = state_space(prototype, mass, loop="closed")
    names = list(system.state_labels)
    x, rate = names.index("displacement_m"), names.index("velocity_m_per_s")
    return np.array(system.A), np.asarray(system.B)[:, 0], x, rate


def growth(rig: Prototype, law: Compliance, mass: float, stiffness: float = 0.0, damping: float = 0.0) -> float:
    """Largest real part of the poles with a spring and a dashpot at the tip."""
    a, force, x, rate = closed(rig, law, mass)
    held = a.copy()
    held[:, x] -= stiffness * force
    held[:, rate] -= damping * force
    return float(np.linalg.eigvals(held).real.max())


def test_a_passive_tip_is_stable_with_whatever_passive_is_fixed_to_it(
    rig: Prototype, judged: dict[str, EndStiffness]
) -> None:
    """Random masses, springs and dashpots, and a second mass behind a spring: poles in floats."""
    assert judged["soft"].passivity.holds
    assert judged["soft"].meets("passive")
    random = np.random.default_rng(1)
    for _ in range(60):
        mass, stiffness, damping = 10 ** random.uniform([-2, 2, -1], [3, 9, 4])
        assert growth(rig, SOFT, mass, stiffness, damping) < 0
    for _ in range(40):
        carried, far, link, grip = 10 ** random.uniform([-1, -1, 3, -1], [2, 3, 8, 3])
        a, force, x, rate = closed(rig, SOFT, carried)
        n = len(a)
        whole = np.zeros((n + 2, n + 2))
        whole[:n, :n], whole[n, n + 1] = a, 1.0
        between = np.zeros(n + 2)  # what the link pulls the tip by
        between[[n, n + 1, x, rate]] = link, grip, -link, -grip
        whole[:n] += np.outer(force, between)
        whole[n + 1] -= between / far
        assert np.linalg.eigvals(whole).real.max() < 0


@pytest.mark.parametrize("name", ["firm", "brisk"])
def test_a_tip_that_is_not_passive_comes_with_surroundings_that_make_it_grow(
    rig: Prototype, judged: dict[str, EndStiffness], name: str
) -> None:
    found = judged[name]
    other = found.destabilising_environment
    assert not found.passivity.holds
    assert found.stable
    assert other is not None
    figures_of = [float(value) for value in (other.mass, other.stiffness, other.damping)]
    assert min(figures_of) > 0
    assert growth(rig, found.law, *figures_of) > 1e-6
    assert growth(rig, found.law, 0.0) < 0
    assert "work comes out of the tip" in found.passivity.reason
    (told,) = (line for line in in_words(found) if "fixed to the tip" in line)
    assert [float(number) for number in re.findall(r"([\d.e+-]+) (?:kg|N/m|N s/m)", told)] == figures_of


@pytest.mark.parametrize("mass", [0.0, 2.5, 40.0])
def test_work_comes_out_in_the_same_bands_with_every_end_mass(
    rig: Prototype, judged: dict[str, EndStiffness], mass: float
) -> None:
    """Re(s x / F) by the impedances is negative inside the bands alone; masses and springs have no part in it."""
    frequencies = np.geomspace(0.02, 2000, 4000)
    for found in judged.values():
        mobility = (2j * np.pi * frequencies / apparent(rig, found.law, mass, frequencies)).real
        inside = np.zeros(len(frequencies), dtype=bool)
        near = np.zeros(len(frequencies), dtype=bool)
        for band in found.passivity.bands:
            inside |= (frequencies > band.low_Hz) & (frequencies < band.high_Hz)
            for end in (band.low_Hz, band.high_Hz):
                near |= np.abs(frequencies / max(end, 1e-9) - 1) < 1e-3
        assert np.array_equal((mobility < 0)[~near], inside[~near])
    port = port_of(rig, SOFT)
    added = port.against(exact(mass), fmpq(12345)) - port.against()
    heavier = replace(port, loop_denominator=port.loop_denominator + Affine(added, 0 * added))
    assert heavier.against() == port.against(exact(mass), fmpq(12345))
    assert absorbed(heavier) == absorbed(port)


def test_an_endlessly_stiff_wall_is_a_tip_that_is_held(rig: Prototype) -> None:
    """Poles go to the zeros of the compliance, and one pair to +-j sqrt(K / M) with -b / 2 M as its real part."""
    port, figure, wall = port_of(rig, SOFT), figures(rig), 1e16
    found = roots(port.against(stiffness=exact(wall)))
    fast = np.abs(found) > 1e6
    assert fast.sum() == 2
    mass = figure["outer_mass"]
    assert np.abs(found[fast].imag) == pytest.approx([np.sqrt(wall / mass)] * 2, rel=1e-9)
    assert found[fast].real == pytest.approx([-figure["outer_damping"] / (2 * mass)] * 2, rel=1e-4)
    a, _, x, rate = closed(rig, SOFT, 3.0)
    kept = [k for k in range(len(a)) if k not in (x, rate)]
    held = np.sort_complex(np.linalg.eigvals(a[np.ix_(kept, kept)]))  # the loop with x = 0
    assert np.abs(np.sort_complex(found[~fast]) / held - 1).max() < 1e-5
    assert np.abs(np.sort_complex(roots(port.disturbance)) / held - 1).max() < 1e-5


def test_walls_are_stable_where_they_are_proved_to_be(
    rig: Prototype, brisk: Compliance, judged: dict[str, EndStiffness]
) -> None:
    random = np.random.default_rng(2)
    for name in ("soft", "firm"):
        assert judged[name].contact.holds
        assert judged[name].stiffest_wall_N_per_m == 1e9
        for _ in range(40):
            assert growth(rig, judged[name].law, random.uniform(*MASSES_KG), 10 ** random.uniform(0, 9)) < 0
    contact, reach = judged["brisk"].contact, judged["brisk"].stiffest_wall_N_per_m
    assert not contact.holds
    assert contact.witness is not None
    assert "against a wall of" in contact.reason
    assert growth(rig, brisk, float(contact.witness.mass), float(contact.witness.stiffness)) > 0
    masses = np.linspace(*MASSES_KG, 30)
    assert max(growth(rig, brisk, mass, reach) for mass in masses) < 0
    assert max(growth(rig, brisk, mass, reach * 1.002) for mass in masses) > 0
    port = port_of(rig, brisk)
    at_one = stable_ranges(Affine(port.against(), port.disturbance), *WALL.stiffness)
    for crossing in at_one.crossings:
        assert growth(rig, brisk, 0.0, crossing.value) == pytest.approx(0.0, abs=1e-4)


def test_a_dashpot_in_the_wall_is_a_third_side_of_the_box(rig: Prototype, brisk: Compliance) -> None:
    port = port_of(rig, brisk)
    damped = Wall(WALL.stiffness, (fmpq(3000), fmpq(20000)))
    found = prove_contact(port, MASSES, damped)
    seen = [
        growth(rig, brisk, mass, stiffness, damping)
        for mass in (0.0, 3.4, 6.8)
        for stiffness in np.geomspace(1e4, 1e9, 12)
        for damping in (3000.0, 8000.0, 20000.0)
    ]
    assert found.holds == (max(seen) < 0)
    with pytest.raises(ValueError, match="zero or more"):
        prove_contact(port, MASSES, Wall((fmpq(-1), fmpq(1))))


def test_walls_up_to_a_stiffness_are_those_that_are_proved(rig: Prototype, brisk: Compliance) -> None:
    """With their dashpots, and no softer than was asked: without a dashpot one of 5 MN/m is not stable."""
    asked = Wall((fmpq(10**5), fmpq(10**9)), (fmpq(1000), fmpq(1000)))
    found = judge(rig, brisk, MASSES_KG, asked)
    reach = found.stiffest_wall_N_per_m
    assert growth(rig, brisk, 0.0, 5e6) > 0 > growth(rig, brisk, 0.0, 5e6, 1000.0)
    assert reach > 5e6
    told = f"Proved: stable against walls from 100000 to {reach:.15g} N/m with 1000 to 1000 N s/m."
    assert told in in_words(found)


def test_popovs_criterion_is_what_is_proved_of_one_sided_walls(rig: Prototype, judged: dict[str, EndStiffness]) -> None:
    """1 / k + Re[(1 + j w q) x / F] by the impedances, on a grid, and against the exact quadratic in the mass."""
    frequencies = np.geomspace(0.01, 3000, 3000)
    w = 2 * np.pi * frequencies
    assert judged["soft"].unilateral_contact.whole
    for found in judged.values():
        wall, q = found.unilateral_contact.stiffness_N_per_m, found.unilateral_contact.multiplier_s
        assert wall > 0
        for mass in (0.0, 1.7, 6.8):
            popov = 1 / wall + ((1 + 1j * w * q) / apparent(rig, found.law, mass, frequencies)).real
            assert popov.min() > 0
    port = port_of(rig, FIRM)
    a, b, c = popov_slack(port, exact(1e7), exact(0.01))
    x, mass = fmpq(20000), exact(3.3)
    p = complex(*_at(port.against(mass), float(x)))
    n = complex(*_at(port.disturbance, float(x)))
    expected = abs(p) ** 2 / 1e7 + ((1 + 0.01j * float(x) ** 0.5) * n * p.conjugate()).real
    assert float(a(x) * mass**2 + b(x) * mass + c(x)) == pytest.approx(expected, rel=1e-9)


def test_what_is_proved_of_one_sided_springs_is_said_of_no_dashpot(rig: Prototype) -> None:
    """A tip pressed on a wall of 0.1 MN/m, far below those proved, grows with 30 kN s/m in it: poles in floats."""
    found = judge(rig, None, MASSES_KG, Wall((fmpq(0), fmpq(10**6)), (fmpq(0), fmpq(30_000))))
    assert (found.unilateral_contact.stiffness_N_per_m, found.unilateral_contact.whole) == (1e6, True)
    a, force, x, rate = parts_of(rig, MASSES_KG[1])
    a[:, x] -= 1e5 * force
    assert np.linalg.eigvals(a).real.max() < 0
    a[:, rate] -= 3e4 * force
    assert np.linalg.eigvals(a).real.max() > 0
    said = " ".join(in_words(found))
    assert "comes to rest at any one-sided spring up to 1000000 N/m" in said
    assert "Undecided: touching and letting go of walls that damp;" in said


def test_a_slower_rig_may_touch_walls_as_stiff_in_proportion(rig: Prototype) -> None:
    """By similarity; the time q of the criterion, which is so much longer, was at most 100 s."""
    scales = (1.0, 1.0, 2.0**8)
    slow, soft, walls = similar(rig, scales), similar(SOFT, scales), Wall((fmpq(0), fmpq(10**9) / 2**16))
    found = judge(slow, soft, MASSES_KG, walls)
    touched, w = found.unilateral_contact, np.geomspace(0.06, 2e4, 3000) / 2**8
    assert touched.whole
    for mass in (0.0, 1.7, 6.8):
        compliance = 1 / apparent(slow, found.law, mass, w / (2 * np.pi))
        popov = 1 / touched.stiffness_N_per_m + ((1 + 1j * w * touched.multiplier_s) * compliance).real
        assert popov.min() > 0


def _at(polynomial, square: float) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    value = np.polyval([float(c) for c in reversed(polynomial.coeffs())], 1j * np.sqrt(square))
    return float(value.real), float(value.imag)


def test_bands_are_where_the_stiffness_and_the_command_are_kept(
    rig: Prototype, judged: dict[str, EndStiffness]
) -> None:
    for found in judged.values():
        frequencies = np.linspace(found.band_Hz / 500, found.band_Hz, 500)
        masses = np.linspace(*MASSES_KG, 5)
        error = [np.abs(apparent(rig, found.law, m, frequencies) / found.end_stiffness_N_per_m - 1) for m in masses]
        assert np.max(error) < 0.1 + 1e-9
        assert np.max(error, axis=0)[-1] == pytest.approx(0.1, abs=1e-5)
        reached = np.array([0.0, found.command_Hz])
        followed = []
        for mass in masses:
            prototype = rig.but(controller=controller_of(rig, found.law))
            system = state_space(prototype, mass, loop="closed")
            to_tip = system["displacement_m", "command_V"]
            followed.append(np.abs(to_tip(2j * np.pi * reached)) * rig.sensor.gain_V_per_m)
        assert np.min(followed, axis=0)[1] == pytest.approx(0.70711, rel=2e-4)
        assert followed[0][0] == pytest.approx(found.command_at_rest, rel=1e-9)


def test_stiffnesses_that_can_be_had_end_where_a_root_crosses(rig: Prototype, brisk: Compliance) -> None:
    least = softest_N_per_m(rig, brisk.servo, 30.0, MASSES_KG)
    assert 1e5 < least < 1e6
    for factor, stable in ((1.01, True), (0.99, False)):
        law = compliant(brisk.servo, least * factor, 30.0)
        assert (max(growth(rig, law, mass) for mass in MASSES_KG) < 0) is stable
    family = over_compliance(rig, brisk.servo, 30.0, fmpq(0))
    law = compliant(brisk.servo, 7e5, 30.0)
    directly = port_of(rig, law).against()
    other = family.at(exact(commanded_compliance(rig, law)))
    assert np.allclose(np.sort_complex(roots(other)), np.sort_complex(roots(directly)), rtol=1e-7)
    for part in stable_compliances(rig, brisk.servo, 30.0, 0.0).ranges:
        assert is_hurwitz(family.at(part.sample)) is part.stable


@pytest.mark.parametrize("name", ["soft", "firm", "brisk"])
def test_the_certificate_of_contact_is_proved_again(rig: Prototype, judged: dict[str, EndStiffness], name: str) -> None:
    made = carried_out(rig, judged[name])
    text = made.contact
    outcome = check(text, prototype_table(made.prototype))
    assert outcome.valid, outcome.failed
    assert len(outcome.proved) >= 8
    assert not check(text, prototype_table(rig)).valid
    assert refused(text.replace("2.5", "2.6", 1))
    passive, stands = ("true", "false") if name == "soft" else ("false", "true")
    false = [
        (f"passive = {passive}", f"passive = {stands}"),
        (r'bandwidth_Hz = "([0-9.]+)"', r'bandwidth_Hz = "9\1"'),
        (r"\[rig\]", '[rig]\nouter_width_m = "0.14"'),
        (r"\[bouncing\]", '[bouncing]\nholds = "true"'),
        (r"\[bouncing\]\nstiffness_N_per_m = \"[0-9]+", r'[bouncing]\nstiffness_N_per_m = "300000000000000'),
    ]
    if name == "brisk":
        false += [(r'inner = \[\n    "([0-9])', r'inner = ["1000\1'), ("stable = false", "stable = true")]
    for before, after in false[: 4 if name == "soft" else None]:
        altered, count = re.subn(before, after, text, count=1)
        assert count == 1
        assert refused(sealed_text(altered)), before


def test_the_model_of_the_truth_is_the_tip(rig: Prototype) -> None:
    """F / x by hand and poles of the models in floats."""
    frequencies = np.geomspace(0.01, 800, 60)
    filtered = read_prototype(PROTOTYPES / "structured.toml")
    assert isinstance(filtered.controller, Structured)
    for prototype, law in ((rig, FIRM), (filtered, compliant(filtered.controller, 4e5, 9.0))):
        made = prototype.but(controller=controller_of(prototype, law))
        model = Port(StatedRig({"version": 2, **rig_tables(made)}))
        expected = apparent(prototype, law, 2.0, frequencies)
        assert np.abs(model.impedance(2 * np.pi * frequencies, 2.0) / expected - 1).max() < 1e-9
        expected = np.linalg.eigvals(closed(prototype, law, 2.0)[0])
        found = model.poles(0.0, 0.0, 2.0)
        assert max(np.abs(expected / pole - 1).min() for pole in found) < 1e-5


MUTATIONS = (
    (("outer_end_mass_kg",), ["0", "80"]),
    (("rig", "sensor_gain_V_per_m"), "20000"),
    (("controller", "gain_A_per_V"), "0.06"),
    (("stability", "stable"), False),
    (("passivity", "passive"), True),
    (("passivity", "band", 0, "outer"), ["0", "36000"]),
    (("passivity", "band", 0, "inner"), ["0", "37000"]),
    (("passivity", "band"), []),
    (("passivity", "troublemaker", "mass_kg"), "0"),
    (("passivity", "troublemaker", "damping_N_s_per_m"), "2000"),
    (("contact", "stable"), False),
    (("bouncing", "stiffness_N_per_m"), "3000000"),
    (("bouncing", "multiplier_s"), "0"),
    (("stiffness", "end_stiffness_N_per_m"), "100000000"),
    (("stiffness", "share"), "0.05"),
    (("stiffness", "bandwidth_Hz"), "infinite"),
)


def test_truth_of_contact(rig: Prototype) -> None:
    """What is honest is not false, and true with room to spare; what is false in floats is never valid."""
    text = contact_text(rig, judge(rig, None, MASSES_KG, WALL))
    honest = tomllib.loads(text)
    assert true(honest) is not False
    roomy = deepcopy(honest)
    roomy["stiffness"]["share"] = "0.11"
    roomy["bouncing"]["stiffness_N_per_m"] = "1200000"
    assert true(roomy) is True
    assert check(sealed_text(tomli_w.dumps(roomy))).valid
    for place, value in MUTATIONS:
        forged = inner = deepcopy(honest)
        for key in place[:-1]:
            inner = inner[key]
        inner[place[-1]] = value
        assert true(forged) is False, place
        assert refused(sealed_text(tomli_w.dumps(forged))), place


def test_an_end_that_moves_against_a_force_at_rest_is_proved_again(rig: Prototype) -> None:
    """Inner displacement fed back makes a stable end of negative stiffness; its certificate was called unreadable."""
    sensors = ("displacement_m", "inner_displacement_m")
    law = Observer(gain_A_per_V=1e-3, sensors=sensors, a=((-16.0,),), b=((16.0, 1600.0),), c=(1.0,), d=(0.0, 0.0))
    turned = rig.but(controller=law, guarantee=None)
    found = judge(turned, None, MASSES_KG, Wall((fmpq(0), fmpq(10**6))))
    for mass in (0.0, 3.4, 6.8):
        closed = state_space(turned, outer_end_mass_kg=mass)
        compliance = closed["displacement_m", "disturbance_N"].dcgain()
        assert closed.poles().real.max() < 0
        assert compliance < 0
        assert compliance == pytest.approx(1 / found.static_N_per_m, rel=1e-6)
    text = contact_text(turned, found)
    verdict = check(text)
    assert verdict.valid, verdict.failed
    assert true(tomllib.loads(text)) is not False


def test_a_loop_that_is_not_stable_has_no_stiffness_up_to_any_frequency(rig: Prototype) -> None:
    """|F / x| is near a stiffness there as well, and its certificate claimed a band that its check called proved."""
    assert isinstance(rig.controller, Lag)
    wild = rig.but(controller=rig.controller.but(gain_A_per_V=0.4), guarantee=None)
    found = judge(wild, None, MASSES_KG, WALL)
    port = Port(StatedRig({"version": 2, **rig_tables(wild)}))
    near = port.impedance(2 * np.pi * np.linspace(0.001, 0.03, 50)) / found.static_N_per_m
    assert np.abs(near - 1).max() < 0.1
    assert state_space(wild, outer_end_mass_kg=0.0).poles().real.max() > 0
    assert (found.stable, found.band_Hz) == (False, 0.0)
    text = contact_text(wild, found)
    assert check(text).valid
    table = tomllib.loads(text)
    table["stiffness"]["bandwidth_Hz"] = "0.03"
    assert true(table) is False
    assert refused(sealed_text(tomli_w.dumps(table)))


def test_bands_in_which_work_comes_out_are_told_no_narrower_than_they_are(
    judged: dict[str, EndStiffness], rig: Prototype
) -> None:
    """Outside of what is told nothing comes out: its ends are on the safe side of those stated, to seven digits."""
    text = carried_out(rig, judged["brisk"]).contact
    bands = tomllib.loads(text)["passivity"]["band"]
    words = [words for words in check(text).proved if "work comes out of the tip" in words]
    *inside, around = ([Fraction(end) for end in re.findall(r"[0-9.]+", one)[1:-1]] for one in words)
    for (low, high), band in zip(inside, bands, strict=True):
        assert Fraction(band["inner"][0]) <= low <= high <= Fraction(band["inner"][1])
    for low, high, band in zip(around[0::2], around[1::2], bands, strict=True):
        assert low <= Fraction(band["outer"][0]) <= Fraction(band["outer"][1]) <= high


def refused(text: str) -> bool:
    """Whether a certificate is not proved again, or is none at all."""
    try:
        return not check(text).valid
    except Unreadable:
        return True


def moved(record: SimulatedRecord, wall: WallAhead | None = None) -> np.ndarray:
    """Work done on the tip so far by the force on it and the wall, J."""
    x, force = record.column("displacement_m"), record.column("disturbance_N")
    if wall is not None:
        inward = x - wall.at_m
        force = force - wall.stiffness_N_per_m * (inward + np.sqrt(inward**2 + wall.rounding_m**2)) / 2
    return np.concatenate([[0.0], np.cumsum((force[1:] + force[:-1]) / 2 * np.diff(x))])


def test_the_nonlinear_rig_yields_as_it_is_told_to(rig: Prototype) -> None:
    """A slow ramp of force; orifices and a curved oil spring leave the static figure within two per cent."""
    rough = rig.but(effects={"pressure_dependent_flow": {}, "entrained_air": {}})
    ramp = Step(amplitude_N=200.0, at_s=0.05, rise_s=2.0)
    given = Scenario(
        name="ramp",
        duration_s=3.0,
        sample_s=1e-3,
        record=tuple(
            ScenarioRecord(
                name=name, input=(ramp,), outer_end_mass_kg=mass, controller=controller_of(rig, law)
            )
            for name, law, mass in (("soft", SOFT, 0.0), ("loaded", SOFT, 6.8), ("firm", FIRM, 3.0))
        ),
    )  # fmt: skip
    for record, stiffness in zip(simulate(rough, given).records, (3e5, 3e5, 1e6), strict=True):
        assert record.stable
        x, force = record.column("displacement_m"), record.column("disturbance_N")
        assert force[-1] / x[-1] == pytest.approx(stiffness, rel=0.02)
        rising = force > 60.0
        assert np.abs(force[rising] / x[rising] / stiffness - 1).max() < 0.1


def test_a_passive_end_gives_off_no_work_while_it_bounces(rig: Prototype) -> None:
    wall = WallAhead(at_m=2e-4, stiffness_N_per_m=1e7)
    push = Step(amplitude_N=300.0, at_s=0.02, rise_s=0.002, length_s=0.3)
    given = Scenario(
        name="bounce",
        duration_s=1.0,
        sample_s=1e-4,
        record=tuple(
            ScenarioRecord(name=f"m{mass:g}", input=(push,), outer_end_mass_kg=mass, wall=wall) for mass in MASSES_KG
        ),
    )
    for record in simulate(rig.but(controller=controller_of(rig, SOFT)), given).records:
        x = record.column("displacement_m")
        touching = x > wall.at_m
        assert np.count_nonzero(np.diff(touching.astype(int))) >= 2  # it touches and lets go
        work = moved(record, wall)
        assert work.min() > -1e-4 * work.max()
        assert record.stable
        assert np.ptp(x[-1000:]) < 0.02 * np.ptp(x)


def test_work_comes_out_of_an_active_end_at_the_frequency_named(
    rig: Prototype, judged: dict[str, EndStiffness]
) -> None:
    band = judged["firm"].passivity.bands[-1]
    sine = Sine(amplitude_N=20.0, frequency_Hz=band.sample_Hz, fade_s=0.3)
    given = Scenario(
        name="shaken",
        duration_s=2.0,
        sample_s=5e-4,
        record=tuple(
            ScenarioRecord(name=name, input=(sine,), controller=controller_of(rig, law))
            for name, law in (("active", FIRM), ("passive", SOFT))
        ),
    )
    active, passive = (moved(record) for record in simulate(rig, given).records)
    assert active[-1] < active[2000] < 0  # the last second, when all is steady
    assert passive[-1] > passive[2000] > 0


def test_a_wall_ahead_is_a_spring_on_one_side(rig: Prototype) -> None:
    """At rest: nothing before the wall, both stiffnesses beyond it."""
    given = Scenario(
        name="rest",
        duration_s=0.02,
        record=tuple(
            ScenarioRecord(
                name=f"n{k}", preload_N=force, wall=WallAhead(at_m=5e-4, stiffness_N_per_m=2e6), controller=None
            )
            for k, force in enumerate((120.0, 600.0))
        ),
    )  # fmt: skip
    near, far = simulate(rig.but(controller=controller_of(rig, SOFT)), given).records
    assert near.column("displacement_m")[-1] == pytest.approx(120.0 / 3e5, rel=1e-5)
    assert far.column("displacement_m")[-1] == pytest.approx((600.0 + 2e6 * 5e-4) / (3e5 + 2e6), rel=1e-6)


def test_the_structured_servo_comes_to_rest_at_the_walls_that_are_proved_and_not_at_stiffer_ones() -> None:
    """Proved to 0.26 MN/m, leaning as well as striking; at 1 MN/m, which refutes it, the simulated tip runs away."""
    rig = read_prototype(PROTOTYPES / "structured.toml")
    found = judge(rig, None, MASSES_KG, WALL)
    assert 2e5 < found.unilateral_contact.stiffness_N_per_m <= found.stiffest_wall_N_per_m < 1e6
    nudge, strike = Step(amplitude_N=20.0, at_s=0.05, length_s=0.02), Step(amplitude_N=150.0, at_s=0.05, length_s=0.5)
    given = Scenario(
        name="walls",
        duration_s=1.5,
        record=tuple(
            ScenarioRecord(
                name=f"{name}{wall:.0f}",
                preload_N=preload,
                input=(signal,),
                wall=WallAhead(at_m=at, stiffness_N_per_m=wall),
            )
            for wall in (2e5, 1e6)
            for name, preload, signal, at in (("lean", 300.0, nudge, -1e-3), ("strike", 0.0, strike, 2e-6))
        ),
    )
    assert [record.stable for record in simulate(rig, given).records] == [True, True, False, False]


def test_the_command_designs_proves_and_writes(tmp_path: Path) -> None:
    out, answer = tmp_path / "out", tmp_path / "answer.json"
    source = str(PROTOTYPES / "tame_lag.toml")
    command = ["stiffness", source, "--end-stiffness-N-per-m", "1e6", "--contact", "none", "--keep-controller"]
    command += ["--rigs", "0"]
    done = CliRunner().invoke(app, [*command, "--out", str(out), "--json", str(answer)])
    assert done.exit_code == 0, done.output
    assert "static stiffness of the end" in done.output
    assert "Refuted: passive at the tip" in done.output
    said = json.loads(answer.read_text())
    assert said["met"] == "stable"
    assert said["static_stiffness_N_per_m"] == pytest.approx(1e6, rel=1e-9)
    assert not said["passive"]
    assert said["destabilised_by"]["mass_kg"] > 0
    made = read_prototype(out / "prototype.toml")
    assert made.compliance is not None
    assert made.compliance.end_stiffness_N_per_m == 1e6
    assert made.controller == controller_of(made, made.compliance)
    for name in ("certificate.toml", "certificate.contact.toml"):
        again = check(out / name, out / "prototype.toml")
        assert again.valid, again.failed


def test_a_prototype_says_what_its_own_law_stands_for_and_for_which_payloads(rig: Prototype) -> None:
    """Another law stands for no stiffness; and one that does is written with the payloads that it is proved for."""
    assert isinstance(rig.controller, Lag)
    given = give(rig.but(payload=rig.payload.but(outer_end_mass_kg=None)), 1e6, (0.0, 2.0), contact="none",
                 keep_controller=True, rigs=0)  # fmt: skip
    soft = given.prototype
    assert soft is not None
    assert soft.guarantee is not None
    assert soft.payload.outer_end_mass_kg == soft.guarantee.outer_end_mass_kg == (0.0, 2.0)
    assert soft.payload.inner_end_mass_kg == rig.payload.inner_end_mass_kg
    faster = rig.controller.but(gain_A_per_V=0.06)
    again = soft.with_law(faster, (0.0, 2.0), 2.5)
    assert again.compliance is None
    assert again.kept_servo == faster


def test_a_servo_is_judged_as_it_is(rig: Prototype, tmp_path: Path) -> None:
    """Stiff by lagging: it gives off work at low frequency, where nothing but a load of many kilograms moves it."""
    answer, source = tmp_path / "answer.json", str(PROTOTYPES / "tame_lag.toml")
    command = ["stiffness", source, "--out", str(tmp_path), "--json", str(answer)]
    done = CliRunner().invoke(app, [*command, "--contact", "passive"])
    assert done.exit_code == 1, done.output
    assert "Refuted: passive at the tip; work comes out of the tip below 30.53 Hz" in done.output
    said = json.loads(answer.read_text())
    assert said["reason"] == "the end is not passive at the tip"
    assert said["reason"] in done.output
    assert said["static_stiffness_N_per_m"] == pytest.approx(servo_stiffness(rig, rig.controller), rel=1e-9)  # type: ignore[arg-type]
    other = said["destabilised_by"]
    carried = rig.but(payload=rig.payload.but(outer_end_mass_kg=None))
    a, force, x, rate = parts_of(carried, other["mass_kg"])
    a[:, x] -= other["stiffness_N_per_m"] * force
    a[:, rate] -= other["damping_N_s_per_m"] * force
    assert np.linalg.eigvals(a).real.max() > 0
    assert check(tmp_path / "certificate.contact.toml", PROTOTYPES / "tame_lag.toml").valid
    missing = CliRunner().invoke(app, ["stiffness", source, "--keep-controller"])
    assert "is for --end-stiffness-N-per-m" in str(missing.exception)


def test_a_law_that_integrates_is_told_as_that_beside_a_valve_that_leaks(rig: Prototype) -> None:
    sums = Observer(gain_A_per_V=3e-3, sensors=("displacement_m",), a=((0.0,),), b=((50.0,),), c=(1.0,), d=(1.0,))
    with pytest.raises(ValueError, match="its law integrates"):
        judge(rig.but(controller=sums), None, (0.0, 6.8), Wall((fmpq(0), fmpq(10**9))))


@pytest.mark.usefixtures("short")
def test_the_search_finds_a_passive_law(rig: Prototype, tmp_path: Path) -> None:
    answer, source = tmp_path / "answer.json", tmp_path / "rig.toml"
    write_prototype(rig.but(tolerance={}), source)
    command = ["tune", str(source), "--controller", "compliance", "--end-stiffness-N-per-m", "2e5"]
    done = CliRunner().invoke(app, [*command, "--json", str(answer)])
    assert done.exit_code == 0, done.output
    said = json.loads(answer.read_text())
    assert said["passive"]
    assert said["wall_stable"]
    assert said["stiffness_band_Hz"] > 1.0
    assert said["one_sided_wall_N_per_m"] == 1e9
    assert said["peak_sensitivity"] <= 2.0
    assert said["drawn"] == []


@pytest.mark.usefixtures("short")
def test_a_rig_ten_times_as_quick_is_given_ten_times_the_band(rig: Prototype) -> None:
    bands = [
        give(as_quick(rig.but(tolerance={}), pace), 3e5 * pace**2, MASSES_KG).best.band_Hz / pace  # type: ignore[union-attr]
        for pace in (1.0, 10.0)
    ]
    assert bands[1] == pytest.approx(bands[0], rel=0.05)


def test_a_law_that_suits_drawn_rigs_gives_up_band_for_it(rig: Prototype) -> None:
    """The force filter alone is chosen; tolerances of nothing at all ask for nothing more."""
    assert isinstance(SOFT.servo, Lag)
    kept = partial(give, contact="passive", keep_controller=True)
    rig = rig.but(controller=SOFT.servo)
    free, suited = (kept(rig, 3e5, MASSES_KG, rigs=count).best for count in (0, 6))
    assert free is not None
    assert suited is None or suited.band_Hz <= free.band_Hz * 1.02
    exactly = rig.but(tolerance={"flow_gain": 1e-9})
    same = kept(exactly, 3e5, MASSES_KG, rigs=2).best
    assert same is not None
    assert same.band_Hz == pytest.approx(free.band_Hz, rel=1e-3)


def test_a_law_for_drawn_rigs_is_stable_on_each_of_them(rig: Prototype) -> None:
    """By python-control's eigenvalues; the law was chosen for rigs that are half as far off again."""
    spread = rig_spread(rig, MASSES_KG[1], 1.0)
    servo = rig.but(controller=SOFT.servo)
    found = give(servo, 3e5, MASSES_KG, contact="none", keep_controller=True, rigs=6).best
    assert found is not None
    assert found.law is not None
    for z in spread.drawn(6, SEED_OF_RIGS):
        member = spread.rig(1.5 * z).but(controller=controller_of(rig, found.law))
        assert all(state_space(member, mass).poles().real.max() < 0 for mass in np.linspace(*MASSES_KG, 5))


def test_an_end_softer_than_its_beam_is_known_is_refused_with_the_reason(rig: Prototype) -> None:
    servo = rig.but(controller=SOFT.servo)
    found = give(servo, 1e4, MASSES_KG, contact="passive", keep_controller=True, rigs=10)
    assert found.best is None
    assert "rigs drawn from its tolerances; the outer beam is known to 1.46e+04 N/m" in found.reason


def test_drawn_rigs_are_as_stiff_as_a_wrong_beam_lets_them(rig: Prototype) -> None:
    """The estimate takes the outer beam for nominal: what it is stiffer, the end is, with a servo that is stiff."""
    beam = figures(rig)["outer_stiffness"]
    law = compliant(SOFT.servo.but(gain_A_per_V=5.0), 3e5, 366.2)
    off = rig.but(controller=controller_of(rig, law))
    stiffer = off.but(outer_beam=off.outer_beam.but(stiffness_N_per_m=1.03 * beam))
    assert loop(stiffer).at(0.0).static_stiffness() == pytest.approx(3e5 + 0.03 * beam, rel=1e-3)
    seen = drawn_rigs(rig.but(controller=controller_of(rig, SOFT)), MASSES_KG, WALL, 8)
    assert len(seen) == 8
    assert all(one.stable >= one.wall >= one.passive for one in seen)
    assert 1.5e5 < min(one.static_N_per_m for one in seen) < 3e5 < max(one.static_N_per_m for one in seen)
    # Nor are any drawn where the outer end mass alone varies, a range of its own, or a filter that there is not.
    for tolerance in ({}, {"outer_end_mass": 0.02}, {"sensor_filter": 0.1}):
        exact_rig = rig.but(controller=controller_of(rig, SOFT), tolerance=tolerance)
        assert drawn_rigs(exact_rig, MASSES_KG, WALL, 8) == ()


COMPLIANCE = ("--controller", "compliance", "--end-stiffness-N-per-m", "1e5")


def test_what_cannot_be_is_said_with_its_reason(tmp_path: Path) -> None:
    source = str(PROTOTYPES / "tame_lag.toml")
    stiff = ["stiffness", source, "--end-stiffness-N-per-m", "1e9", "--keep-controller"]
    done = CliRunner().invoke(app, stiff)
    assert done.exit_code == 1
    assert "the servo alone holds" in done.output
    for more, words in (
        (["--controller", "compliance"], "needs --end-stiffness-N-per-m"),
        (["--end-stiffness-N-per-m", "1e5"], "is for --controller compliance"),
        ([*COMPLIANCE, "--nominal"], "--nominal: is not heeded with --controller compliance"),
        ([*COMPLIANCE, "--comes-to-rest", "--sigmas", "3"], "--comes-to-rest: is not heeded"),
        ([*COMPLIANCE, "--no-lower-gains"], "--lower-gains: is not heeded"),
        ([*COMPLIANCE, "--sections", "2"], "--sections: is for --controller structured"),
        (["--stages", "4"], "--stages: is for --controller scheduled; a lag one is one law"),
    ):
        assert words in str(CliRunner().invoke(app, ["tune", source, *more]).exception)
    wrong = CliRunner().invoke(
        app,
        ["stiffness", source, "--end-stiffness-N-per-m", "-1", "--contact", "soft", "--wall-N-per-m", "9:1"],
    )
    assert isinstance(wrong.exception, InputError)
    for words in ("--end-stiffness-N-per-m: is -1", "must be one of passive, wall, none"):
        assert words in str(wrong.exception)


def test_the_shipped_compliant_rig_is_what_its_compliance_says() -> None:
    rig = read_prototype(PROTOTYPES / "compliant.toml")
    assert rig.compliance is not None
    assert rig.controller == controller_of(rig, rig.compliance)
    assert judge(rig, rig.compliance, MASSES_KG, WALL).meets("passive")
    # Judged as it is, its servo alone was told to be as soft as the end: it holds K_m + A K_q / K_pq K F_s.
    as_it_is = judge(rig, None, (0.0, 0.0), WALL)
    assert as_it_is.static_N_per_m == pytest.approx(3e5)
    assert as_it_is.servo_N_per_m == pytest.approx(486800.0 + 1.13e-4 * 1.13e-2 / 3.8e-13 * 0.00295 * 1180.0)


@pytest.mark.usefixtures("short")
def test_a_screw_is_given_an_end_stiffness_too() -> None:
    """Its gains are hundreds of amperes per volt."""
    found = give(screw(), 3e5, (0.0, 2.0), contact="none", rigs=0)
    assert found.prototype is not None
    assert found.prototype.compliance is not None
    assert found.prototype.compliance.servo.gain_A_per_V > 3.0
    assert check(found.contact).valid


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize(
    ("part", "figures"),
    [("goal", {"compliance_m_per_N": 1.0}), ("tolerance", {"leakage": 0.4999, "beam_damping_ratio": 0.4999})],
)
def test_wide_goals_and_wide_tolerances_make_no_figure_that_no_rig_has(part: str, figures: dict[str, float]) -> None:
    """A compliance that is kept at every frequency, and rigs so far off that nothing would be left of a figure."""
    rig = read_prototype(PROTOTYPES / "tame_lag.toml").but(guarantee=None)
    rig = rig.but(**{part: getattr(rig, part).but(**figures)})
    found = give(rig, 3e5, (0.0, 2.0), contact="none", rigs=20)
    if part == "goal":
        assert found.prototype is not None
        assert found.prototype.guarantee is not None
        assert found.prototype.guarantee.bandwidth_Hz == 1e5
    drawn = rig_spread(rig, 2.0, 1.0).drawn(500, 1, 1.5) if part == "tolerance" else []
    assert all(rig_spread(rig, 2.0, 1.0).rig(z).outer_beam.damping_ratio > 0 for z in drawn)


def test_a_peak_sensitivity_that_is_the_goal_is_told_as_certify_tells_it() -> None:
    stage = read_prototype(PROTOTYPES.parent / "scheduled" / "prototype.toml").stages((0.0, 6.8))[2]
    found = judge(stage.prototype, None, stage.outer_end_mass_kg, Wall((fmpq(0), fmpq(0))))
    proved = certify(stage.prototype, *stage.outer_end_mass_kg).guaranteed
    assert proved is not None
    assert found.peak_sensitivity == proved.peak_sensitivity == stage.prototype.goal.peak_sensitivity


def test_no_wall_is_none_to_come_to_rest_at(rig: Prototype, tmp_path: Path) -> None:
    found = judge(rig, None, MASSES_KG, Wall((fmpq(0), fmpq(0)))).unilateral_contact
    assert (found.stiffness_N_per_m, found.whole) == (0.0, False)
    write_prototype(rig, tmp_path / "rig.toml")
    refused = CliRunner().invoke(app, ["stiffness", str(tmp_path / "rig.toml"), "--wall-N-per-m", "0:0"])
    assert "--wall-N-per-m: 0:0: is no wall; give a stiffest one" in str(refused.exception)


def test_a_tolerance_that_leads_out_of_what_is_plausible_is_refused_in_words() -> None:
    rig = read_prototype(PROTOTYPES / "tame_lag.toml").but(guarantee=None)
    rig = rig.but(sensor=rig.sensor.but(filter_Hz=1e5), tolerance=rig.tolerance.but(sensor_filter=1e-4))
    with pytest.raises(InputError, match=r"tolerance: sensor.filter_Hz: 1000\d\d of a rig that is off"):
        give(rig, 3e5, (0.0, 2.0), contact="none", rigs=20)
