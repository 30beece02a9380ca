"""The stand-alone replay: it needs nothing of the package, accepts every certificate, and no altered one."""

import hashlib
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from flint import fmpq, fmpq_poly
from hypothesis import given, settings
from hypothesis import strategies as st

from beamdesign.polynomial import roots
from beamdesign.proof import replay as module
from beamdesign.proof.certificate import Asked
from beamdesign.proof.certifying import certify
from beamdesign.proof.replay import Malformed, rational, replay
from beamdesign.prototype import COMPLIANCE_LIMIT_M_PER_N, Prototype

ASKED = (
    Asked("decay_rate", 3.0),
    Asked("gain_margin", 1.05),
    Asked("gain_margin", 1.5),
    Asked("gain_margin", 0.5),
    Asked("peak_sensitivity", 2.0),
    Asked("compliance", COMPLIANCE_LIMIT_M_PER_N, 6.0),
    Asked("compliance", COMPLIANCE_LIMIT_M_PER_N, 7.0),
    Asked("decay_rate", 50.0),
)


@pytest.fixture
def unstable(remedy: Prototype) -> str:
    """Both crossings inside the range."""
    return certify(remedy, 0.0, 20.0, ASKED[:2]).text


@pytest.fixture
def stable(remedy: Prototype) -> str:
    """A stable range, with claims that hold and others that are refuted."""
    return certify(remedy, 3.0, 6.8, ASKED).text


def resealed(text: str) -> str:
    """The text with the checksum that belongs to it, as one who alters it on purpose would leave it."""
    bare = re.sub(r'sha256 = "[0-9a-f]+"\n', "", text)
    seal = f'sha256 = "{hashlib.sha256(bare.encode()).hexdigest()}"\n'
    before, version, after = bare.partition("version = 1\n")
    return before + version + seal + after


def numbers(text: str) -> list[re.Match[str]]:
    """Every figure of a certificate, where it stands."""
    return list(re.finditer(r'"(-?\d+(?:\.\d+)?(?:/\d+)?)"', text))


def changed(text: str, match: re.Match[str], factor: fmpq) -> str:
    value = rational(match[1])
    other = value * factor if value != 0 else factor - 1
    return text[: match.start(1)] + f"{other.p}/{other.q}" + text[match.end(1) :]


def entry(text: str, match: re.Match[str]) -> tuple[str, str]:
    """Table and key that a figure stands under."""
    above = text[: match.start()]
    table = re.findall(r"^\[+([\w.]+)\]+$", above, re.MULTILINE)
    key = re.findall(r"^(\w+) = ", above[: above.rfind("=") + 2], re.MULTILINE)[-1]
    return (table[-1] if table else ""), key


def test_certificates_are_valid(remedy: Prototype, stable: str, unstable: str):
    for text in (stable, unstable, certify(remedy, 5.0, 5.0).text, certify(remedy, 0.0, 1.0, ASKED).text):
        outcome = replay(text)
        assert outcome.reasons == ()
        assert outcome.valid
        assert outcome.claims


@pytest.mark.parametrize("kind", ["lag", "proportional"])
@pytest.mark.parametrize("filter_Hz", [None, 400.0])
def test_every_kind_of_loop_can_be_replayed(remedy: Prototype, kind: str, filter_Hz: float | None):
    controller = remedy.controller.but(gain_A_per_V=0.05) if kind == "lag" else {"kind": kind, "gain_A_per_V": 0.004}
    prototype = remedy.but(controller=controller, sensor=remedy.sensor.but(filter_Hz=filter_Hz))
    found = certify(prototype, 0.0, 6.8)
    assert found.stable
    assert replay(found.text).valid


def test_the_statements_are_repeated_in_words(stable: str, unstable: str):
    said = replay(unstable).claims
    assert "unstable from 0 to 1.968442 kg" in said
    assert "stable from 1.968442 to 17.79211 kg" in said
    assert "crossings in the range: 2, as listed" in said
    assert "stable = False" in said
    said = replay(stable).claims
    assert "stays_stable_to_kg = 17.7921148053" in said
    assert "refuted: peak_sensitivity 2" in said
    assert "decay_rate 3 1/s" in said
    assert "compliance 0.0000000571 m/N up to 6 Hz" in said


def test_any_change_of_the_text_breaks_the_seal(stable: str):
    for altered in (
        stable.replace("# Proved", "# proved", 1),
        stable + "\n",
        stable.replace('name = "paper"', 'name = "x"'),
    ):
        outcome = replay(altered)
        assert not outcome.valid
        assert outcome.reasons == ("the text was altered after it was written (sha256)",)


HARMLESS = {
    ("stability.range", "sample"),  # another mass of the same range settles it as well
    ("claim", "limit"),  # these state something else, which may be true; see below
    ("claim", "bandwidth_Hz"),
    ("claim.witness", "outer_end_mass_kg"),
    ("claim.witness", "squared_frequency"),
    ("claim.witness", "gain_factor"),
    ("stability", "stays_stable_to_kg"),
    ("stability", "stays_stable_from_kg"),
    ("stability.crossing", "frequency_Hz"),  # a wider enclosure is true as well
}


@pytest.mark.parametrize("factor", [fmpq(1001, 1000), fmpq(999, 1000)])
@pytest.mark.parametrize("name", ["stable", "unstable"])
def test_no_altered_figure_is_accepted_even_under_a_new_seal(request, name: str, factor: fmpq):
    text = request.getfixturevalue(name)
    seen = set()
    for match in numbers(text):
        if (where := entry(text, match)) in HARMLESS:
            continue
        seen.add(where)
        altered = resealed(changed(text, match, factor))
        if where[0] == "stability.crossing" and (factor > 1) == (match.string[match.start() - 1] == "["):
            with pytest.raises(Malformed, match="empty enclosure"):  # its ends have changed places
                replay(altered)
            continue
        outcome = replay(altered)
        assert not outcome.valid, f"{where} {match[1]}"
        assert all("sha256" not in reason for reason in outcome.reasons)
    assert len({key for table, key in seen if table == "rig"}) == 15
    assert {table for table, _ in seen} >= {"", "rig", "controller", "polynomials", "stability.range"}


def retold(text: str, old: str, new: str) -> tuple[str, ...]:
    assert text.count(old) >= 1
    return replay(resealed(text.replace(old, new, 1))).reasons


def test_a_bolder_claim_is_not_accepted(stable: str):
    table = tomllib.loads(stable)
    best = {claim["kind"]: claim for claim in table["claim"][len(ASKED) :]}
    peak, bandwidth = best["peak_sensitivity"]["limit"], best["compliance"]["bandwidth_Hz"]
    bolder_peak, bolder_bandwidth = f"{float(peak) * 0.999:.6f}", f"{float(bandwidth) * 1.001:.6f}"
    assert retold(stable, f'limit = "{peak}"', f'limit = "{bolder_peak}"') == (
        f"not proved: peak_sensitivity {bolder_peak}",
    )
    assert retold(stable, f'bandwidth_Hz = "{bandwidth}"', f'bandwidth_Hz = "{bolder_bandwidth}"') == (
        f"not proved: compliance 0.0000000571 m/N up to {bolder_bandwidth} Hz",
    )
    assert retold(stable, 'limit = "3"', 'limit = "30"') == ("not proved: decay_rate 30 1/s",)
    assert retold(stable, 'limit = "1.05"', 'limit = "1.5"') == ("not proved: gain_margin 1.5",)


def test_a_claim_is_not_turned_round(stable: str, unstable: str):
    for claim in stable.split("[[claim]]\n")[1:]:
        holds = "holds = true" in claim
        turned = (
            claim.replace("holds = true", "holds = false") if holds else claim.replace("holds = false", "holds = true")
        )
        assert not replay(resealed(stable.replace(claim, turned))).valid
    assert "`stable` contradicts the ranges" in retold(unstable, "stable = false", "stable = true")


def test_a_witness_must_refute(stable: str):
    witnesses = re.findall(r'\[claim\.witness\]\nouter_end_mass_kg = "([^"]+)"', stable)
    assert len(witnesses) >= 4
    for mass in witnesses:
        old = f'[claim.witness]\nouter_end_mass_kg = "{mass}"'
        reasons = retold(stable, old, '[claim.witness]\nouter_end_mass_kg = "30"')
        assert len(reasons) == 1
        assert "does not refute it" in reasons[0]


def test_what_is_said_beyond_the_range_is_proved_too(stable: str):
    assert retold(stable, 'stays_stable_to_kg = "17.7921148053"', 'stays_stable_to_kg = "17.7922"')
    assert retold(stable, 'stays_stable_to_kg = "17.7921148053"', 'stays_stable_to_kg = "infinite"')
    assert retold(stable, 'stays_stable_from_kg = "1.96844204419"', 'stays_stable_from_kg = "1.968"')
    assert not retold(stable, 'stays_stable_to_kg = "17.7921148053"', 'stays_stable_to_kg = "17.79"')


def test_verdicts_samples_and_crossings_must_be_right(unstable: str):
    ranges = unstable.split("[[stability.range]]\n")
    assert retold(unstable, ranges[2].split("[[")[0], ranges[2].split("[[")[0].replace("true", "false"))
    assert retold(unstable, 'sample = "1"', 'sample = "3"')
    first = unstable[unstable.index("[[stability.crossing]]") :].split("\n\n")[0]
    assert retold(unstable, first, "")  # a crossing left out
    assert retold(unstable, first, first + "\n\n" + first.replace("685829", "685830").replace("131.8", "131.9"))
    frequencies = re.search(r"frequency_Hz = (\[.*\])", unstable)
    assert retold(unstable, frequencies[1], '["131", "131.1"]')


def test_a_hidden_crossing_is_found(unstable: str):
    """One range instead of the first two, with no crossing between: its verdict cannot be proved."""
    table = tomllib.loads(unstable)["stability"]
    first, second = table["range"][:2]
    start = unstable.index("[[stability.range]]")
    end = unstable.index("[[stability.range]]", unstable.index("[[stability.range]]", start + 1) + 1)
    merged = f'[[stability.range]]\nlow = "{first["low"]}"\nhigh = "{second["high"]}"\nsample = "5"\nstable = true\n\n'
    crossing = unstable[unstable.index("[[stability.crossing]]") :].split("\n\n")[0]
    reasons = replay(resealed((unstable[:start] + merged + unstable[end:]).replace(crossing, ""))).reasons
    assert "not proved: stable from 0 to 17.79211 kg" in reasons
    assert any("near 1.968442 kg: not listed" in reason for reason in reasons)


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda text: "no certificate at all\n", "TOML"),
        (lambda text: text.replace("version = 1", "version = 2"), "version"),
        (lambda text: text.replace('kind = "beamdesign.mass_range"', 'kind = "other"'), "kind"),
        (lambda text: text.replace('kind = "twin_beam"', 'kind = "bench"'), "rig.kind"),
        (lambda text: text.replace('kind = "lag"', 'kind = "adaptive"'), "controller.kind"),
        (lambda text: text.replace('kind = "decay_rate"', 'kind = "beauty"'), "claim.kind"),
        (lambda text: text.replace("inner_mass_kg", "inner_mass"), "inner_mass_kg"),
        (lambda text: text.replace('"486800"', '"about 486800"'), "not a number"),
        (lambda text: text.replace('"486800"', "486800"), "wrong kind"),
        (lambda text: text.replace('low = "3"', 'low = "30"', 1), "empty"),
        (lambda text: text.replace("holds = true", 'holds = "yes"', 1), "holds"),
    ],
)
def test_what_cannot_be_read_is_malformed(stable: str, damage, reason: str):
    with pytest.raises(Malformed, match=reason):
        replay(damage(stable))


def test_figures_must_be_possible(stable: str):
    assert "rig.outer_mass_kg is not positive" in retold(stable, 'outer_mass_kg = "3.9"', 'outer_mass_kg = "-3.9"')


@pytest.mark.parametrize(("verdict", "status"), [("valid", 0), ("altered", 1), ("malformed", 2)])
def test_the_file_runs_where_the_package_cannot_be_imported(tmp_path: Path, stable: str, verdict: str, status: int):
    alone = tmp_path / "replay.py"
    alone.write_bytes(Path(module.__file__).read_bytes())
    text = {"valid": stable, "altered": stable.replace('"486800"', '"486801"'), "malformed": "kind = 1\n"}[verdict]
    (tmp_path / "certificate.toml").write_text(text)
    blocked = (
        "import runpy, sys; sys.modules['beamdesign'] = None; sys.argv = sys.argv[1:];"
        "runpy.run_path(sys.argv[0], run_name='__main__')"
    )
    done = subprocess.run(
        [sys.executable, "-I", "-W", "error", "-c", blocked, str(alone), "certificate.toml"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == status, done.stderr
    last = (done.stdout or done.stderr).splitlines()[-1]
    assert last == {"valid": "valid", "altered": "not valid"}.get(verdict, last)
    assert status != 2 or "kind and version" in done.stderr


def test_the_file_itself_imports_only_the_standard_library_and_flint():
    source = Path(module.__file__).read_text()
    imported = {line.split()[1].split(".")[0] for line in source.splitlines() if re.match(r"(import|from) ", line)}
    assert imported - set(sys.stdlib_module_names) == {"flint"}


def test_usage(capsys):
    assert module.main([]) == 2
    assert "usage" in capsys.readouterr().err


# Its own root isolation and Routh test.

quick = settings(max_examples=60, deadline=None)


@quick
@given(st.lists(st.fractions(min_value=-4, max_value=4, max_denominator=6), min_size=1, max_size=6, unique=True))
def test_isolation_by_signs_finds_every_root(points):
    wanted = sorted(fmpq(x.numerator, x.denominator) for x in points)
    polynomial = fmpq_poly([3, 0, 1])
    for x in wanted:
        polynomial *= fmpq_poly([-x, 1])
    inside = [x for x in wanted if -3 < x < 5]
    found = module._isolate(polynomial, fmpq(-3), fmpq(5))
    assert len(found) == len(inside)
    assert all(low < x < high or low == x == high for (low, high), x in zip(found, inside, strict=True))
    assert all(abs(x) < module._bound(polynomial) for x in wanted)
    for interval, x in zip(found, inside, strict=True):
        for _ in range(20):
            interval = module._halve(polynomial, interval)
        assert interval[0] <= x <= interval[1]
        assert interval[1] - interval[0] <= fmpq(8, 2**20)


@quick
@given(st.lists(st.integers(-6, 9), min_size=2, max_size=7), st.booleans())
def test_its_routh_test_agrees_with_numerical_roots(coefficients, positive):
    polynomial = fmpq_poly([abs(c) + 1 for c in coefficients] if positive else coefficients)
    if polynomial.degree() < 1 or abs(largest := roots(polynomial).real.max()) < 1e-9:
        return
    assert module._routh(polynomial) == (largest < 0)


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
def test_its_determinant_is_the_product_of_sums_of_roots(degree: int):
    """Orlando's formula: the last but one Hurwitz determinant is a product over all pairs of roots."""
    points = np.arange(1, degree + 1) * 0.5 - 1.25
    polynomial = fmpq_poly([1])
    for x in points:
        polynomial *= fmpq_poly([-rational(str(x)), 1])
    determinant = module._hurwitz_matrix(polynomial, degree).det()
    sums = np.prod([points[i] + points[k] for i in range(degree) for k in range(i)])
    assert abs(float(determinant.p) / float(determinant.q)) == pytest.approx(abs(sums))
