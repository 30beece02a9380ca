"""Static characteristics in the current: multipliers found, proved, refused, and the motion that they speak of."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from flint import fmpq, fmpq_poly
from forging import altered, resealed
from honest_certificates import valid
from rigs_of_effects import with_effects
from scipy.integrate import solve_ivp
from typer.testing import CliRunner

from beamdesign import Prototype, certify, check, read_prototype
from beamdesign.cli import app
from beamdesign.controllers import Lag
from beamdesign.loop import Loop, loop
from beamdesign.plant.effects import laws_of
from beamdesign.polynomial import Affine, ratio
from beamdesign.proofs.absolute_stability import METHOD, absolute_stability, search
from beamdesign.proofs.certifying import nonlinear_rows
from beamdesign.proofs.multiplier import Kernel, Multiplier, fits, slack
from beamdesign.proofs.multiplier_search import kernels
from beamdesign.proofs.scope import members

ROOT = Path(__file__).parent.parent
MASSES = fmpq(0), fmpq(34, 5)
MARGIN = fmpq(1, 100)


def shipped(name: str) -> Prototype:
    return read_prototype(ROOT / "studies/prototypes" / f"{name}.toml")


@pytest.fixture(scope="module")
def tame() -> Prototype:
    """The tame lag, 1.7/20 Hz at 50 mA/V."""
    return shipped("tame_lag")


@pytest.fixture(scope="module")
def fast(tame: Prototype) -> Prototype:
    """The lag tuned to 5.0 Hz."""
    return tame.but(controller=Lag(gain_A_per_V=0.1438, pole_Hz=1.138, zero_Hz=37.54))


@pytest.fixture(scope="module")
def written(tame: Prototype) -> str:
    return certify(tame, 0.0, 6.8, nonlinear=True).text


def published() -> Multiplier:
    """1 - 0.88 (400 / (s + 400))^8 + 0.0043 s."""
    return Multiplier(((fmpq(22, 25), Kernel(400, 8)),), fmpq(43, 10000))


def families(rig: Prototype) -> tuple[Affine, Affine]:
    """Numerator and denominator of 1 + L over the mass."""
    return loop(rig).characteristic, loop(rig).loop_denominator


def test_the_published_multiplier_fits_the_tame_lag(tame: Prototype):
    assert fits(published(), *families(tame), *MASSES, MARGIN)
    assert published().admissible
    assert not published().for_odd_only


@pytest.mark.parametrize("popov", ["0", "1/1000", "43/10000", "1/50", "1"])
def test_circle_and_popov_fail_on_the_tame_lag(tame: Prototype, popov: str):
    above, _, below = popov.partition("/")
    slow = fmpq(int(above), int(below or 1))
    assert not fits(Multiplier((), slow), *families(tame), *MASSES, fmpq(0))


def test_the_exact_slack_is_that_of_the_responses(tame: Prototype):
    """Against M (1 + L) in floats, kernels of both sides and signs among the terms."""
    multiplier = Multiplier(
        ((fmpq(1, 2), Kernel(400, 8)), (fmpq(-1, 10), Kernel(40, 3, False)), (fmpq(1, 5), Kernel(400, 2, False))),
        fmpq(43, 10000),
    )
    found = loop(tame)
    for mass, w in ((0.0, 3), (2.0, 60), (6.8, 500)):
        at = np.array([float(w)])
        real = (
            multiplier.response(at) * (1 + ratio(found.loop_numerator, found.loop_denominator, np.array([mass]), at)[0])
        ).real[0]
        x, m = fmpq(w) ** 2, fmpq(round(mass * 10), 10)
        a, b, c = (q(x) for q in slack(multiplier, found.characteristic, found.loop_denominator, MARGIN))
        denominator = found.loop_denominator.at(m)
        parts = [sum(z * (-1) ** (k // 2) * fmpq(w) ** k for k, z in enumerate(denominator.coeffs()) if k % 2 == odd)
                 for odd in (0, 1)]  # fmt: skip
        size = float((parts[0] ** 2 + parts[1] ** 2) * multiplier.below(x))
        assert float((a * m + b) * m + c) / size == pytest.approx(real - float(MARGIN), rel=1e-9)


@pytest.mark.parametrize("name", ["tame", "fast"])
def test_a_multiplier_is_found_and_proved(request: pytest.FixtureRequest, name: str):
    found, _ = absolute_stability([loop(request.getfixturevalue(name))], *MASSES)
    assert found is not None
    multiplier, margin = found
    assert multiplier.admissible
    assert margin > 0
    w = np.geomspace(0.01, 1e5, 20001)
    closed = ratio(*families(request.getfixturevalue(name)), np.linspace(0, 6.8, 31), w)
    assert (multiplier.response(w) * closed).real.min() >= float(margin)


@pytest.mark.parametrize("gain", [1, 40, 300])
def test_a_loop_that_needs_kernels_that_are_not_causal(gain: int):
    """O'Shea's kind of example: gain s^2 / (s^2 + s / w + 1)^2 in units of w, whose phase leads and then lags."""
    resonance = fmpq_poly([1, fmpq(1, 100), fmpq(1, 10_000)])
    nothing = fmpq_poly([0])
    led = Loop(
        Affine(resonance * resonance, nothing), Affine(fmpq_poly([0, 0, fmpq(gain, 10_000)]), nothing), fmpq_poly([1])
    )
    found, _ = absolute_stability([led], fmpq(0), fmpq(1))
    assert found is not None
    assert any(not kernel.causal for _, kernel in found[0].terms)


def test_a_multiplier_for_odd_characteristics_is_proved_again(tame: Prototype, written: str):
    """With negative coefficients, of kernels that are not causal."""
    terms = ((fmpq(-57, 1000), Kernel(25, 4, False)), (fmpq(-66, 1000), Kernel(150, 8, False)))
    odd = Multiplier((*terms, (fmpq(873, 1000), Kernel(400, 8))), fmpq(422, 100_000))
    assert odd.for_odd_only
    assert fits(odd, *families(tame), *MASSES, MARGIN)
    table = tomllib.loads(written)
    table["nonlinear"][0] |= odd.table() | {"margin": "0.01"}
    assert valid(resealed(table))


def test_a_multiplier_of_all_kernels_that_are_sought_is_proved_again(written: str):
    """A proof of nine kernels of order 8 was refused by the check."""
    rest = ((fmpq(1, 10_000), kernel) for kernel in kernels((8,)) if kernel != Kernel(400, 8))
    whole = Multiplier((*published().terms, *rest), published().popov_s)
    table = tomllib.loads(written)
    table["nonlinear"][0] |= whole.table() | {"margin": "0.001"}
    assert valid(resealed(table))


def test_a_conditionally_stable_loop_has_none(tame: Prototype):
    rig = shipped("structured")
    found, reason = absolute_stability([loop(rig)], *MASSES)
    assert found is None
    assert "conditionally stable" in reason
    assert search([loop(rig)], *MASSES) is None
    found, reason = absolute_stability(
        [loop(tame.but(controller=Lag(gain_A_per_V=0.5, pole_Hz=1.7, zero_Hz=20.0)))], *MASSES
    )
    assert found is None
    assert "itself is not stable" in reason


@pytest.mark.parametrize("flow", laws_of("valve_deadband"))
def test_rows_tell_what_is_covered(tame: Prototype, flow: str):
    (row,) = nonlinear_rows(members(tame, 0.0, 6.8))
    assert (row.effects, row.method, row.proved, row.bound_m) == (("current_saturation",), METHOD, True, None)
    rig = tame.but(effects={flow: {}, "current_saturation_soft": {}, "sensor_lag": {}})
    rows = {row.effects: row.proved for row in nonlinear_rows(members(rig, 0.0, 6.8)) if row.method == METHOD}
    both = ("current_saturation_soft", flow)
    assert rows == {both[:1]: True, both[1:]: True, both: False}


def test_the_certificate_is_proved_again(tame: Prototype, written: str):
    assert tomllib.loads(written)["nonlinear"][0]["kind"] == "slope"
    verdict = check(written)
    assert verdict.valid
    assert any("comes to rest" in words for words in verdict.proved)
    plain = certify(tame, 0.0, 6.8)
    assert "nonlinear" not in tomllib.loads(plain.text)
    assert "nonlinear" not in plain.to_dict()


def test_a_loop_with_hardly_any_damping_is_proved_again(tame: Prototype):
    """A stiff seal holds both beams together: the check halved payloads eight times at most, and refused the proof."""
    beams = {name: getattr(tame, name).but(damping_ratio=0.005) for name in ("outer_beam", "inner_beam")}
    stiff = {"seal_friction": {"coulomb_N": 100.0, "presliding_m": 1e-6}}
    found = certify(
        tame.but(**beams, controller=Lag(gain_A_per_V=0.002, pole_Hz=1.7, zero_Hz=20.0), effects=stiff), nonlinear=True
    )
    assert found.nonlinear[0].proved
    assert valid(found.text)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("popov_s", "0.5"),
        ("popov_s", "0"),
        ("popov_s", "-0.0043"),
        ("margin", "3"),
        ("margin", "0"),
        ("term", []),
        ("loops", [1, 1]),
        ("loops", []),
        ("loops", [2]),
        ("kind", "slopes"),
        ("more", "1"),
    ],
)
def test_an_altered_statement_is_refused(written: str, key: str, value: object):
    table = tomllib.loads(written)
    table["nonlinear"][0][key] = value
    assert not valid(resealed(table))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("coefficient", "1"),
        ("coefficient", "0.1"),
        ("coefficient", "-0.84"),
        ("rate_per_s", "4000"),
        ("rate_per_s", "-400"),
        ("order", 1),
        ("order", 0),
        ("causal", False),
    ],
)
def test_an_altered_kernel_is_refused(written: str, key: str, value: object):
    place = ("nonlinear", 0, "term", 0, key)
    assert not valid(altered(written, place, value))


def test_a_statement_of_some_loops_alone_says_so(tame: Prototype):
    """Of a prototype with effects there are several, and each is numbered."""
    text = certify(with_effects(tame, "current_saturation", "entrained_air"), 0.0, 6.8, nonlinear=True).text
    table = tomllib.loads(text)
    loops = table["nonlinear"][0]["loops"]
    assert len(loops) > 1
    assert not any("alone" in line for line in check(text).proved)
    table["nonlinear"][0]["loops"] = loops[1:]
    assert any(f"of loops {loops[1]} of {len(loops)} alone" in line for line in check(resealed(table)).proved)


def test_another_loop_needs_another_multiplier(tame: Prototype, fast: Prototype, written: str):
    """The statement of the tame lag in the certificate of one that it does not fit."""
    table = tomllib.loads(certify(fast, 0.0, 6.8).text) | {"nonlinear": tomllib.loads(written)["nonlinear"]}
    verdict = check(resealed(table))
    assert not verdict.valid
    assert len(verdict.failed) == 1


@pytest.mark.parametrize(("mass", "seed"), [(0.3, 1), (2.9, 2), (6.5, 3)])
def test_the_saturated_loop_comes_to_rest(tame: Prototype, mass: float, seed: int):
    """From a random state that drives the current far beyond its limit, in equations of the loop's transfer alone."""
    at = loop(tame).at(mass)
    below = np.array([float(c) for c in at.loop_denominator.coeffs()])
    above = np.array([float(c) for c in at.loop_numerator.coeffs()])
    n, scale = len(below) - 1, 100.0  # 1/s, so that powers of s have coefficients of like size
    d = below * scale ** np.arange(n + 1)
    d, top = d / d[-1], d[-1]
    a = np.diag(np.ones(n - 1), 1)
    a[-1] = -d[:-1]
    c = np.zeros(n)
    c[: len(above)] = above * scale ** np.arange(len(above)) / top
    limit = 1.0
    start = np.random.default_rng(seed).normal(size=n)
    start *= 300 * limit / abs(c @ start)

    def rate(_: float, x: np.ndarray) -> np.ndarray:
        found = a @ x
        found[-1] += np.clip(-c @ x, -limit, limit)
        return found

    moved = solve_ivp(rate, (0.0, 6.0 * scale), start, method="LSODA", rtol=1e-8, atol=1e-10)
    demanded = abs(c @ moved.y)
    assert demanded[0] > 100 * limit
    assert demanded[moved.t > 5.0 * scale].max() < 1e-3 * limit


@pytest.mark.parametrize(("name", "status"), [("tame_lag", 0), ("structured", 1)])
def test_the_command_says_what_is_proved(tmp_path: Path, name: str, status: int):
    answer, certificate = tmp_path / "answer.json", tmp_path / "proof.toml"
    typed = ["certify", str(ROOT / f"studies/prototypes/{name}.toml"), "--nonlinear", "--out", str(certificate)]
    assert CliRunner().invoke(app, [*typed, "--json", str(answer)]).exit_code == status
    found = json.loads(answer.read_text())
    (row,) = found["nonlinear"]
    assert row.keys() == {"effects", "method", "proved", "covers", "bound_m"}
    assert (row["effects"], row["proved"], row["bound_m"]) == (["current_saturation"], status == 0, None)
    assert found["holds"] is (status == 0)
    assert CliRunner().invoke(app, ["certify", "--replay", str(certificate)]).exit_code == 0
    refused = CliRunner().invoke(app, ["certify", "--replay", str(certificate), "--nonlinear"])
    assert refused.exit_code != 0


@pytest.mark.parametrize(("stiffness", "gain"), [(1e10, 0.05), (1e9, 0.0005)])
def test_a_loop_that_hardly_feeds_back_needs_no_kernel(tame: Prototype, stiffness: float, gain: float) -> None:
    beam = tame.outer_beam.but(stiffness_N_per_m=stiffness)
    rig = tame.but(outer_beam=beam, controller=tame.controller.but(gain_A_per_V=gain))
    found = certify(rig, 0.0, 6.8, nonlinear=True)
    assert [row.proved for row in found.nonlinear] == [True]
    assert check(found.text).valid
