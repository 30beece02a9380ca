"""Exact stable ranges against dense roots, the degenerate cases, and `beamdesign certify` as a user runs it."""

import json
from math import inf

import numpy as np
import pytest
import typer
from flint import fmpq, fmpq_poly
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from beamdesign import InputError, Prototype, certify, check, write_prototype
from beamdesign.checker.roots import Family
from beamdesign.cli.certify import _echo_over_passive
from beamdesign.cli.certify import certify as command
from beamdesign.controllers import Proportional
from beamdesign.loop import loop
from beamdesign.plant.members import paper_model
from beamdesign.polynomial import Affine, exact, is_hurwitz, roots
from beamdesign.proofs.certificate import Asked, describe
from beamdesign.proofs.stability import StabilityMap, is_stable_over, stable_ranges
from beamdesign.prototype import Goal

quick = settings(max_examples=60)


def p(*coefficients: int | fmpq) -> fmpq_poly:
    return fmpq_poly(list(coefficients))


def ranges_of(constant: fmpq_poly, slope: fmpq_poly, low: int | fmpq, high: int | fmpq) -> StabilityMap:
    """The map, after the quick test and the replay's own method have been heard as well."""
    family = Affine(constant, slope)
    found = stable_ranges(family, fmpq(low), fmpq(high))
    assert is_stable_over(family, fmpq(low), fmpq(high)) == found.stable
    assert Family(constant, slope).is_stable_over(fmpq(low), fmpq(high)) == found.stable
    assert bool(found.reason) != found.stable
    return found


# The published loop.


def test_the_remedy_is_unstable_with_no_payload(remedy: Prototype):
    found = stable_ranges(loop(remedy).characteristic, fmpq(0), fmpq(20))
    assert not found.stable
    assert [part.stable for part in found.ranges] == [False, True, False]
    assert found.stable_ranges == [(pytest.approx(1.968442, abs=1e-5), pytest.approx(17.792115, abs=1e-5))]
    assert [crossing.frequency_Hz for crossing in found.crossings] == pytest.approx([131.80, 26.02], abs=0.01)
    assert found.reason == "unstable from 0 to 1.968442 kg, 17.79212 to 20 kg"


def test_ranges_agree_with_dense_poles_of_the_state_space(remedy: Prototype):
    """Poles from the matrices of the linear model, the lag closed around them by hand."""
    lag, rig = remedy.controller, paper_model(remedy)
    found = stable_ranges(loop(remedy).characteristic, fmpq(0), fmpq(20))
    ((least, most),) = found.stable_ranges
    pole, through = 2 * np.pi * lag.pole_Hz, lag.gain_A_per_V * lag.pole_Hz / lag.zero_Hz
    for mass in [*np.linspace(0, 20, 101), least - 1e-4, least + 1e-4, most - 1e-4, most + 1e-4]:
        a, b, c = rig.matrices(mass, 4.5)
        closed = np.block(
            [[a - through * np.outer(b[:, 1], c[1]), b[:, 1:2]], [-pole * (lag.gain_A_per_V - through) * c[1:2], -pole]]
        )
        assert (np.linalg.eigvals(closed).real.max() < 0) == (least <= mass <= most)


def test_neighbouring_crossings_are_named(remedy: Prototype):
    found = stable_ranges(loop(remedy).characteristic, fmpq(3), fmpq(34, 5))
    assert found.stable
    assert found.stable_ranges == [(3.0, 6.8)]
    assert (found.below.value, found.above.value) == pytest.approx((1.968442, 17.792115), abs=1e-5)


def test_ends_at_crossings_are_rounded_inwards(remedy: Prototype):
    family = loop(remedy).characteristic
    ((least, most),) = stable_ranges(family, fmpq(0), fmpq(20)).stable_ranges
    assert is_stable_over(family, *(fmpq(*value.as_integer_ratio()) for value in (least, most)))
    for outside in (np.nextafter(least, 0), np.nextafter(most, 20)):
        assert not is_stable_over(family, *[fmpq(*float(outside).as_integer_ratio())] * 2)


# Traps.


def test_a_root_through_the_origin():
    found = ranges_of(p(-1, 2, 1), p(1), 0, 3)
    assert found.stable_ranges == [(1.0, 3.0)]
    assert [(crossing.rational, crossing.frequency_Hz) for crossing in found.crossings] == [(1, 0.0)]


def test_a_crossing_at_the_very_end_of_the_range_counts():
    found = ranges_of(p(-1, 2, 1), p(1), 1, 3)
    assert not found.stable
    assert [crossing.rational for crossing in found.crossings] == [1]
    assert [part.stable for part in found.ranges] == [True]
    assert "1 kg" in found.reason
    assert ranges_of(p(-1, 2, 1), p(1), 1 + fmpq(1, 10**60), 3).stable


def test_an_oscillation_at_the_very_end_of_the_range_counts():
    """s^3 + s^2 + s + m: on the axis at m = 1 with w = 1, found there though no ball can tell."""
    found = ranges_of(p(0, 1, 1, 1), p(1), fmpq(1, 2), 1)
    assert [(crossing.rational, crossing.frequency_Hz) for crossing in found.crossings] == [
        (1, pytest.approx(1 / (2 * np.pi)))
    ]
    assert found.stable_ranges == [(0.5, 1.0)]
    assert not found.stable
    assert ranges_of(p(0, 1, 1, 1), p(1), fmpq(1, 2), 1 - fmpq(1, 10**60)).stable


def test_a_root_through_infinity():
    """(m - 1) s^2 + s + 1 loses its degree at m = 1; below, one root is positive."""
    found = ranges_of(p(1, 1, -1), p(0, 0, 1), 0, 3)
    assert found.stable_ranges == [(1.0, 3.0)]
    assert [(crossing.rational, crossing.frequency_Hz, crossing.finite) for crossing in found.crossings] == [
        (1, inf, False)
    ]
    assert not ranges_of(p(1, 1, -1), p(0, 0, 1), 1, 1).stable


def test_a_touch_without_crossing():
    """s^3 + m s^2 + m s + 2 m - 1: the last Hurwitz determinant is (m - 1)^2."""
    found = ranges_of(p(-1, 0, 0, 1), p(2, 1, 1), fmpq(3, 5), 3)
    assert not found.stable
    assert [part.stable for part in found.ranges] == [True, True]
    assert found.stable_ranges == [(0.6, 1.0), (1.0, 3.0)]
    assert [crossing.value for crossing in found.crossings] == [1.0]
    assert "axis" in found.reason


def test_a_shared_root_on_the_axis_leaves_no_mass_stable():
    found = ranges_of(p(1, 0, 1) * p(1, 1), p(1, 0, 1), 0, 1)
    assert found.stable_ranges == []
    assert found.reason == "a root lies on the imaginary axis at every mass"


def test_a_family_without_damping_is_never_stable():
    assert ranges_of(p(1, 0, 1), p(1), 0, 1).stable_ranges == []


def test_a_family_that_does_not_depend_on_the_mass():
    assert ranges_of(p(1, 2, 1), p(0), 0, 1).stable
    assert not ranges_of(p(1, -2, 1), p(0), 0, 1).stable


def test_proportional_polynomials_vanish_at_one_mass():
    found = ranges_of(p(1, 2, 1), p(1, 2, 1), -2, 1)
    assert found.stable_ranges == [(-2.0, -1.0), (-1.0, 1.0)]


def test_a_single_mass():
    assert ranges_of(p(-1, 0, 0, 1), p(2, 1, 1), 2, 2).stable_ranges == [(2.0, 2.0)]
    assert ranges_of(p(-1, 0, 0, 1), p(2, 1, 1), 1, 1).stable_ranges == []


def test_two_oscillations_at_the_same_mass():
    """(s^2 + 1)(s^2 + 4)(s + 1) at 1/3 kg: two pairs on the axis at once, whose masses no precision tells apart."""
    both, slope = p(1, 0, 1) * p(4, 0, 1) * p(1, 1), p(5, 3, 7, 2, 1)
    found = ranges_of(both - slope * fmpq(1, 3), slope, 0, fmpq(1, 2))
    assert [crossing.value for crossing in found.crossings] == pytest.approx([1 / 3, 1 / 3], abs=1e-15)
    assert sorted(crossing.frequency_Hz for crossing in found.crossings) == pytest.approx([1 / (2 * np.pi), 1 / np.pi])
    assert len(found.ranges) == 2
    at_end = ranges_of(both - slope * fmpq(1, 3), slope, fmpq(1, 3), 1)
    assert [crossing.rational for crossing in at_end.crossings[:2]] == [fmpq(1, 3)] * 2


def test_a_sliver_of_instability_that_a_grid_steps_over():
    """The touch of (m - 1)^2, lowered by 1e-20: unstable on 2e-10 kg around 1 kg, stable on every grid point."""
    constant, slope = p(-1 + fmpq(1, 10**20), 0, 0, 1), p(2, 1, 1)
    found = ranges_of(constant, slope, fmpq(3, 5), 3)
    assert [part.stable for part in found.ranges] == [True, False, True]
    assert float((found.ranges[1].high - found.ranges[1].low).p) > 0
    assert found.crossings[1].value - found.crossings[0].value == pytest.approx(2e-10, rel=1e-3)
    for mass in np.linspace(0.6, 3, 241) + 0.0001:
        assert is_hurwitz(Affine(constant, slope).at(exact(mass)))
    assert ranges_of(p(-1 - fmpq(1, 10**20), 0, 0, 1), slope, fmpq(3, 5), 3).stable


def test_an_empty_range_is_an_error():
    with pytest.raises(ValueError, match="empty range"):
        stable_ranges(Affine(p(1, 1), p(1)), fmpq(1), fmpq(0))


# Random families.

factors = st.lists(
    st.one_of(st.tuples(st.integers(0, 4)), st.tuples(st.integers(0, 5), st.integers(0, 3))), min_size=1, max_size=4
)


def product(parts: list[tuple[int, ...]]) -> fmpq_poly:
    result = p(1)
    for part in parts:
        result *= p(*part, 1)
    return result


@quick
@given(factors, factors, st.integers(-1, 3), st.integers(0, 3), st.booleans())
def test_verdicts_agree_with_dense_roots(first, second, low, width, pencil):
    one, two = product(first), product(second)
    family = Affine(one - two, two) if pencil else Affine(one, two)
    assume(max(family.constant.degree(), family.slope.degree()) > 0)
    found = ranges_of(family.constant, family.slope, low, low + width)
    degree = max(family.constant.degree(), family.slope.degree())
    for k in range(21):
        mass = low + fmpq(width * k, 20)
        member = family.at(mass)
        if any(abs(crossing.value - float(mass.p) / float(mass.q)) < 1e-6 for crossing in found.crossings):
            continue
        (part,) = [part for part in found.ranges if part.low <= mass <= part.high]
        if member.degree() < degree:
            assert not part.stable
            continue
        # A multiple root is only known to the root of the rounding error; the exact test settles what is left.
        largest = roots(member).real.max()
        assert part.stable == (largest < 0 if abs(largest) > 1e-3 else is_hurwitz(member))


@quick
@given(factors, factors, st.integers(0, 2), st.integers(0, 3))
def test_every_range_is_confirmed_by_the_replay(first, second, low, width):
    constant, slope = product(first) - product(second), product(second)
    assume(max(constant.degree(), slope.degree()) > 0)
    found = ranges_of(constant, slope, low, low + width)
    for part in found.ranges:
        assert Family(constant, slope).verdict(part.low, part.high) is part.stable


# The certificate of a prototype.


def test_a_certificate_says_what_was_found(remedy: Prototype):
    found = certify(remedy, 0.0, 20.0)
    assert not found.stable
    assert not found.holds
    assert found.guaranteed is None
    assert found.stable_ranges_kg == [(pytest.approx(1.968442, abs=1e-5), pytest.approx(17.792115, abs=1e-5))]
    assert [crossing.value for crossing in found.crossings] == pytest.approx([1.968442, 17.792115], abs=1e-5)
    assert "It is stable from 1.96844205 to 17.7921148 kg." in found.text  # from 1.968442044
    assert check(found.text).valid


def test_effects_that_the_linear_model_does_not_have_are_refused(remedy: Prototype):
    with pytest.raises(InputError, match="sensor_lag"):
        certify(remedy.but(effects={"sensor_lag": {"time_s": 1e-4}}), 3.0, 6.8)


def test_refused_claims_give_the_reason(remedy: Prototype):
    found = certify(remedy, 3.0, 6.8, [Asked("peak_sensitivity", 2.0), Asked("compliance", 5.71e-8, 4.0)])
    assert found.stable
    assert not found.holds
    assert [claim.holds for claim in found.claims] == [False, True]
    assert "peak sensitivity" in found.reason
    assert describe(found.claims[1]) == "compliance |x/F_d| at most 5.71e-08 m/N up to 4 Hz"
    assert check(found.text).valid


def test_a_prototype_without_controller_has_no_certificate(paper: Prototype):
    with pytest.raises(ValueError, match="controller"):
        certify(paper, 0.0, 1.0)


# The command.


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Runs the command in an empty folder; gives exit status, output, and the JSON fields (None if none)."""
    monkeypatch.chdir(tmp_path)
    app = typer.Typer()
    app.command()(command)

    def invoke(*arguments):
        target = tmp_path / "result.json"
        done = CliRunner().invoke(app, [*map(str, arguments), "--json", str(target)])
        if isinstance(done.exception, InputError):
            raise done.exception
        assert isinstance(done.exception, SystemExit | None)
        return done.exit_code, done.output, json.loads(target.read_text()) if target.exists() else None

    return invoke


@pytest.fixture
def rig(tmp_path, remedy):
    path = tmp_path / "rig.toml"
    write_prototype(remedy, path)
    return path


def test_command_lists_both_crossings(run, rig, tmp_path):
    status, output, fields = run(rig, "--outer-end-mass", "0:20")
    assert status == 1
    assert fields["stable"] is False
    assert [c["outer_end_mass_kg"] for c in fields["crossings"]] == pytest.approx([1.968442, 17.792115], abs=1e-5)
    assert [c["frequency_Hz"] for c in fields["crossings"]] == pytest.approx([131.8, 26.02], abs=0.01)
    assert np.shape(fields["stable_ranges_kg"]) == (1, 2)
    assert "exact" in fields["method"]
    assert fields["certificate"] == "rig.certificate.toml"
    assert check(tmp_path / "rig.certificate.toml").valid
    assert "NOT stable" in output
    assert "stable from 1.968443 to 17.79211 kg" in output  # from 1.9684420: at 1.968442 kg a pole pair still grows


def test_what_is_proved_is_told_with_all_the_digits_that_were_asked_for(run, rig):
    _, output, _ = run(
        rig, "--outer-end-mass", "3:6.1234567", "--peak-sensitivity", 19.0000004, "--bandwidth-Hz", 5.49999999
    )
    assert "from 3 to 6.1234567 kg" in output  # 6.12346 kg is more
    assert "at most 19.0000004" in output  # 19 is less
    assert "up to 5.49999999 Hz" in output  # 5.5 Hz is more


def test_a_range_ends_before_a_mass_at_which_a_root_lies_on_the_axis(run, tmp_path, remedy):
    """Undamped beams that swing alike with 4 kg, K_m / (M_m + 4) = K_f / M_f: the actuator between them has no part."""
    outer = remedy.outer_beam.but(stiffness_N_per_m=4e5, effective_mass_kg=4.0, damping_ratio=0.0)
    inner = remedy.inner_beam.but(stiffness_N_per_m=1e5, effective_mass_kg=1.5, damping_ratio=0.0)
    law, payload = remedy.controller.but(gain_A_per_V=0.02), remedy.payload.but(inner_end_mass_kg=0.5)
    swinging = remedy.but(outer_beam=outer, inner_beam=inner, controller=law, payload=payload)
    found = certify(swinging, 0.0, 4.0)
    assert [one.rational for one in found.crossings] == [4]
    ((low, high),) = found.stable_ranges_kg
    assert low == 0.0
    assert 4.0 - 1e-12 < high < 4.0
    assert "stable from 0 to 4 kg, not at 4 kg itself" in check(found.text).proved
    write_prototype(swinging, tmp_path / "swinging.toml")
    _, output, _ = run(tmp_path / "swinging.toml", "--outer-end-mass", "0:4")
    assert "stable from 0 to 3.999999 kg" in output
    assert "It is stable from 0 to 3.99999999 kg." in found.text


def test_what_is_guaranteed_is_told_with_all_the_digits_of_the_goal(run, tmp_path, remedy):
    goal = Goal(compliance_m_per_N=5.714159e-8, loop_gain=50.0, loop_gain_from_Hz=250.00049)
    write_prototype(remedy.but(goal=goal), tmp_path / "goal.toml")
    _, output, _ = run(tmp_path / "goal.toml", "--outer-end-mass", "3:6.1234567")
    assert "|x/F_d| at most 5.714159e-08 m/N up to" in output  # 5.714e-8 m/N is less
    assert "from 250.00049 Hz up" in output  # 250 Hz is more
    assert "from 3 to 6.1234567 kg" in (tmp_path / "goal.certificate.toml").read_text().partition("name =")[0]


def test_command_promises_no_compliance_that_even_a_steady_force_exceeds(run, tmp_path, remedy):
    soft = remedy.but(controller=Proportional(gain_A_per_V=1e-4), payload=remedy.payload.but(outer_end_mass_kg=(2, 2)))
    write_prototype(soft, tmp_path / "rig.toml")
    _, output, fields = run(tmp_path / "rig.toml")
    assert fields["guaranteed"]["bandwidth_Hz"] == 0
    assert "no bandwidth: even a steady force moves the tip by more than 5.71e-08 m/N" in output
    assert "up to 0 Hz" not in output


def test_a_share_that_is_beyond_its_goal_is_not_rounded_to_it(capsys: pytest.CaptureFixture[str]):
    _echo_over_passive(3.91e-05, 2.49e-05, 1.5702, Goal(peak_over_passive=1.57))
    assert "1.571 times the 2.49e-05 m/N with the servo off, beyond the goal of 1.57" in capsys.readouterr().out
    # The limit itself where a design keeps it to the last digit, which is a figure of nine.
    _echo_over_passive(2.50014999e-05, 2.50015e-05, 1.0, Goal())
    assert float(capsys.readouterr().out.partition("at most ")[2].split()[0]) >= 2.50014999e-05


def test_command_uses_the_payload_of_the_prototype_and_names_the_next_crossing(run, rig):
    status, output, fields = run(rig)
    assert status == 1
    assert fields["outer_end_mass_kg"] == [0.0, 6.8]
    assert fields["stable_ranges_kg"] == [[pytest.approx(1.968442, abs=1e-5), 6.8]]
    assert len(fields["crossings"]) == 1
    assert fields["next_crossings"]["below"] is None
    assert fields["next_crossings"]["above"]["outer_end_mass_kg"] == pytest.approx(17.792115, abs=1e-5)
    assert "17.79211" in output


def test_command_proves_claims_and_replays_them(run, rig, tmp_path):
    path = tmp_path / "proofs" / "rig.toml"
    claims = ["--bandwidth-Hz", 6, "--peak-sensitivity", 20, "--decay-rate-per-s", 3, "--gain-margin", 1.05]
    status, _, fields = run(rig, "--outer-end-mass", "3:6.8", *claims, "--out", path)
    assert status == 0
    assert fields["holds"] is True
    assert [claim["kind"] for claim in fields["claims"]] == [
        "compliance",
        "peak_sensitivity",
        "decay_rate",
        "gain_margin",
    ]
    assert fields["guaranteed"]["bandwidth_Hz"] > 6
    assert run("--replay", path)[2]["valid"] is True
    assert run("--replay", path, rig)[0] == 0


def test_command_refuses_a_claim_with_its_witness(run, rig):
    status, output, fields = run(rig, "--outer-end-mass", "3:6.8", "--peak-sensitivity", 2)
    assert status == 1
    assert fields["stable"] is True
    assert fields["holds"] is False
    (claim,) = fields["claims"]
    witness = claim["witness"]
    assert 3 <= witness["outer_end_mass_kg"] <= 6.8
    assert "REFUTED" in output


def test_replay_of_an_altered_certificate_exits_1(run, rig, tmp_path):
    run(rig, "--outer-end-mass", "3:6.8")
    path = tmp_path / "rig.certificate.toml"
    path.write_text(path.read_text().replace('"486800"', '"486900"'))
    status, output, fields = run("--replay", path)
    assert status == 1
    assert fields["valid"] is False
    assert "the polynomials are not those of the rig" in output


def test_replay_against_another_prototype_exits_1(run, rig, remedy, tmp_path):
    run(rig, "--outer-end-mass", "3:6.8")
    other = tmp_path / "other.toml"
    write_prototype(remedy.but(controller=remedy.controller.but(gain_A_per_V=0.149)), other)
    status, output, _ = run("--replay", tmp_path / "rig.certificate.toml", other)
    assert status == 1
    assert "not of this prototype: [controller]" in output


@pytest.mark.parametrize(
    ("arguments", "key"),
    [
        (["--outer-end-mass", "3:1"], "3:1"),
        (["--peak-sensitivity", "nan"], "--peak-sensitivity"),
        (["--bandwidth-Hz", "-1"], "--bandwidth-Hz"),
        (["--gain-margin", "inf"], "--gain-margin"),
        (["--out", "."], "."),
    ],
)
def test_bad_input_writes_nothing(run, rig, tmp_path, arguments, key):
    with pytest.raises(InputError) as caught:
        run(rig, *arguments)
    assert caught.value.problems[0].key == key
    assert sorted(path.name for path in tmp_path.iterdir()) == ["rig.toml"]


def test_a_prototype_without_controller_is_told_how_to_get_one(run, paper, tmp_path):
    write_prototype(paper, tmp_path / "bare.toml")
    with pytest.raises(InputError, match=r"bare\.toml: controller: .*beamdesign tune"):
        run(tmp_path / "bare.toml", "--outer-end-mass", "0:1")


def test_what_is_no_certificate_is_bad_input(run, rig, tmp_path):
    for path in (rig, tmp_path / "absent.toml"):
        with pytest.raises(InputError, match="certificate"):
            run("--replay", path)
    with pytest.raises(InputError, match="PROTOTYPE"):
        run()
    with pytest.raises(InputError, match="no meaning with --replay"):
        run("--replay", rig, "--outer-end-mass", "0:1")
