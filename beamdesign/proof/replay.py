"""Re-prove a certificate over one mass from its own figures: this file, python-flint and the standard library suffice.

Nothing here is shared with the programme that wrote the certificate, neither code nor method:

- the polynomials are rebuilt from the listed figures by the closed form of the twin-beam loop;
- stability is settled in the mass: the real roots of the last but one Hurwitz determinant are isolated by Descartes'
  rule of signs, and between two of them one member is put to the Routh test;
- inequalities are settled by cutting the frequency axis at every sign change of everything that decides them.

Run as `python replay.py CERTIFICATE`; exit status 0 if it holds, 1 if it does not, 2 if it cannot be read.
"""

import hashlib
import sys
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from flint import arb, arb_poly, ctx, fmpq, fmpq_mat, fmpq_poly, fmpz, fmpz_poly

KIND = "beamdesign.mass_range"
VERSION = 1
FLOAT_ROUNDING = fmpq(1, 10**14)
"""How far a figure in rad/s may be from 2 pi times the one in Hz: both are decimals of floats."""

S = fmpq_poly([0, 1])
NONE = fmpq(0)
Pair = tuple[fmpq, fmpq]
Polynomials = tuple[fmpq_poly, fmpq_poly]


class Malformed(ValueError):
    """The text is not a certificate that this file can read."""


@dataclass(frozen=True)
class Replay:
    """Outcome of a replay.

    Attributes:
        valid: whether every statement of the certificate was proved again.
        reasons: in words, every statement that was not.
        claims: in words, every statement that was checked or proved.
    """

    valid: bool
    reasons: tuple[str, ...]
    claims: tuple[str, ...]


Statements = Iterator[tuple[bool, str]]
"""Of a certificate: whether each was proved, and it or its failure in words."""


def replay(source: str | Path) -> Replay:
    """Prove a certificate again.

    Args:
        source: path of the certificate, or its text.

    Raises:
        Malformed: where it cannot be read as a certificate.
    """
    return proved_again(source, KIND, VERSION, _statements)


def proved_again(
    source: str | Path, kind: str, version: int, statements: Callable[[dict[str, Any]], Statements]
) -> Replay:
    """Prove the statements of a certificate of some kind again, and that its text is as it was written.

    Args:
        source: path of the certificate, or its text.
        kind: that it has to state.
        version: likewise.
        statements: proves all that a certificate's table states.

    Raises:
        Malformed: where it cannot be read as a certificate.
    """
    text = _text(source)
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise Malformed(f"not valid TOML: {error}") from error
    if table.get("kind") != kind or table.get("version") != version:
        raise Malformed(f"kind and version must be {kind!r} and {version}")
    try:
        with ctx.workprec(256):
            results = [_untouched(table, text), *statements(table)]
    except (KeyError, TypeError, AttributeError, IndexError) as error:
        raise Malformed(f"an entry is missing or of the wrong kind: {error}") from error
    reasons = tuple(words for proved, words in results if not proved)
    return Replay(not reasons, reasons, tuple(words for proved, words in results if proved))


def _untouched(table: dict[str, Any], text: str) -> tuple[bool, str]:
    checksum = f'sha256 = "{table["sha256"]}"\n'
    intact = hashlib.sha256(text.replace(checksum, "", 1).encode()).hexdigest() == table["sha256"]
    return intact, "the text is as it was written" if intact else "the text was altered after it was written (sha256)"


def _text(source: str | Path) -> str:
    if isinstance(source, str) and "\n" in source:
        return source
    try:
        return Path(source).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise Malformed(f"cannot be read: {error}") from error


def rational(text: str) -> fmpq:
    """A decimal or a quotient p/q, exactly."""
    try:
        if "/" in text:
            above, below = text.split("/")
            return fmpq(int(above), int(below))
        whole, _, decimals = text.partition(".")
        return fmpq(int(whole + decimals), 10 ** len(decimals))
    except (ValueError, ZeroDivisionError) as error:
        raise Malformed(f"not a number: {text!r}") from error


def _polynomial(coefficients: Sequence[str]) -> fmpq_poly:
    return fmpq_poly([rational(value) for value in coefficients])


def stated_polynomials(table: dict[str, Any]) -> dict[str, fmpq_poly]:
    """The polynomials of a loop; what is returned has a part in the mass where added sensors feed it back."""
    names = ("p0", "p1", "returned", "disturbance")
    return {name: _polynomial(table[name]) for name in names} | {
        "returned_slope": _polynomial(table.get("returned_slope", []))
    }


def _statements(table: dict[str, Any]) -> Statements:
    """Every statement of the certificate: whether it was proved, and it or its failure in words."""
    low, high = rational(table["low"]), rational(table["high"])
    if low > high:
        raise Malformed("the range of masses is empty")
    stated = stated_polynomials(table["polynomials"])
    yield from _figures(table)
    same = _proportional(_rebuilt(table), stated)
    yield same, "the polynomials follow from the figures" if same else "the polynomials do not follow from the figures"
    if not same:
        return  # what follows would be about some other loop
    yield from _stability(table["stability"], stated["p0"], stated["p1"], low, high)
    law = tuple(_polynomial(table["controller"][name]) for name in ("numerator", "denominator"))
    for claim in table.get("claim", []):
        yield _claim(claim, stated, law, low, high)


# The figures, and the polynomials they give.


def _figures(table: dict[str, Any]) -> Iterator[tuple[bool, str]]:
    """Figures that are given in two units agree, and the controller's polynomials are those of its kind."""
    rig, controller = table["rig"], table["controller"]
    if rig["kind"] != "twin_beam":
        raise Malformed(f"rig.kind {rig['kind']!r} is not known here")
    for name, value in rig.items():
        if name != "kind" and (rational(value) < 0 or (rational(value) == 0 and name not in MAY_BE_ZERO)):
            yield False, f"rig.{name} is not positive"
    numerator, denominator = _polynomial(controller["numerator"]), _polynomial(controller["denominator"])
    match controller["kind"]:
        case "proportional":
            breaks, gain = [], rational(controller["gain_A_per_V"])
            fits = denominator == fmpq_poly([1]) and numerator == fmpq_poly([gain])
        case "lag":
            gain = rational(controller["gain_A_per_V"])
            fits = numerator[0] == gain and denominator[0] == 1 and max(numerator.degree(), denominator.degree()) == 1
            fits = fits and numerator[1] > 0 and denominator[1] > 0
            breaks = [("zero_Hz", gain / numerator[1]), ("pole_Hz", 1 / denominator[1])] if fits else []
        case "structured":
            breaks, fits = [], _sections_agree(controller, numerator, denominator)
        case "transfer_function":
            breaks, fits = [], True
        case "observer":
            numerators, expected = law_of(controller)
            breaks, fits = [], numerator == numerators[SENSED[0]] and denominator == expected
        case other:
            raise Malformed(f"controller.kind {other!r} is not known here")
    agree = all(_same_frequency(rational(controller[name]), value) for name, value in breaks)
    for name in ("valve_frequency", "filter_frequency"):
        if f"{name}_rad_per_s" in rig:
            given = rational(rig[f"{name}_Hz"]), rational(rig[f"{name}_rad_per_s"])
            agree = agree and _same_frequency(*given)
    good = fits and agree
    yield good, "figures in Hz and in rad/s agree" if good else "the controller's or the rig's figures contradict"


MAY_BE_ZERO = ("outer_damping_N_s_per_m", "inner_damping_N_s_per_m", "leakage_m3_per_s_per_Pa", "inner_end_mass_kg")


def _sections_agree(controller: dict[str, Any], numerator: fmpq_poly, denominator: fmpq_poly) -> bool:
    """Whether the polynomials are those of the listed lag and sections, but for the rounding of 2 pi f.

    All factors have positive coefficients only, so that each coefficient of their product is a sum of positive terms
    and is off by no more, relatively, than as many roundings as a term has factors 1 / (2 pi f): one per power of s.
    """

    def factor(hertz: str, damping: str | None = None) -> arb_poly:
        time = 1 / (2 * arb.pi() * arb(rational(hertz)))
        return arb_poly([1, time] if damping is None else [1, 2 * arb(rational(damping)) * time, time * time])

    listed = [rational(value) for table in controller["section"] for value in table.values()]
    listed += [rational(controller[name]) for name in ("gain_A_per_V", "zero_Hz", "pole_Hz")]
    if not all(value > 0 for value in listed):
        return False
    above, below = (
        factor(controller["zero_Hz"]) * arb(rational(controller["gain_A_per_V"])),
        factor(controller["pole_Hz"]),
    )
    for table in controller["section"]:
        above *= factor(table["zero_Hz"], table["zero_damping_ratio"])
        below *= factor(table["pole_Hz"], table["pole_damping_ratio"])
    return all(
        stated.degree() == expected.degree()
        and stated[0] == start
        and all(
            bool(abs(arb(stated[k]) / expected[k] - 1) < 2 * k * FLOAT_ROUNDING) for k in range(1, stated.degree() + 1)
        )
        for stated, expected, start in (
            (numerator, above, rational(controller["gain_A_per_V"])),
            (denominator, below, fmpq(1)),
        )
    )


SENSED = ("displacement_m", "inner_displacement_m", "load_pressure_Pa")


def law_of(controller: dict[str, Any]) -> tuple[dict[str, fmpq_poly], fmpq_poly]:
    """The controller: numerators by what they sense, and their denominator.

    Of matrices they are made by the recursion of Le Verrier and Faddeev: adj(sI - a) = sum M_k s^(n-k) with M_1 = I,
    M_(k+1) = a M_k + q_k I, q_k = -trace(a M_k) / k, and det(sI - a) = s^n + sum q_k s^(n-k).
    """
    if controller["kind"] != "observer":
        return {SENSED[0]: _polynomial(controller["numerator"])}, _polynomial(controller["denominator"])
    gain, sensors = rational(controller["gain_A_per_V"]), controller["sensors"]
    a, b = ([[rational(value) for value in row] for row in controller[name]] for name in ("a", "b"))
    c, d = ([rational(value) for value in controller[name]] for name in ("c", "d"))
    n, p = len(a), len(sensors)
    fits = len(b) == len(c) == n and len(d) == p and all(len(row) == n for row in a) and all(len(row) == p for row in b)
    if not fits or not set(sensors) <= set(SENSED) or len(set(sensors)) != p or sensors[:1] != [SENSED[0]]:
        raise Malformed("the controller's matrices do not fit each other or its sensors")
    above, below = [fmpq_poly([0])] * p, S**n
    if n:
        motion, driven = (fmpq_mat(n, len(m[0]), [value for row in m for value in row]) for m in (a, b))
        shown, one = fmpq_mat(1, n, c), fmpq_mat(n, n, [fmpq(int(i == j)) for i in range(n) for j in range(n)])
        term = one
        for k in range(1, n + 1):
            through, product = shown * term * driven, motion * term
            above = [above[j] + through[0, j] * S ** (n - k) for j in range(p)]
            trace = -sum((product[i, i] for i in range(n)), fmpq(0)) / k
            below += trace * S ** (n - k)
            term = product + trace * one
    return {name: gain * (above[j] + d[j] * below) for j, name in enumerate(sensors)}, below


def _same_frequency(hertz: fmpq, radians: fmpq) -> bool:
    ratio = 2 * arb.pi() * arb(hertz) / arb(radians)
    return bool(abs(ratio - 1) < arb(FLOAT_ROUNDING))


def _rebuilt(table: dict[str, Any]) -> dict[str, fmpq_poly]:
    """The loop from its figures; equations (7) to (18) of Zalucky and Hardt (1984), eliminated by hand.

    With the impedance of each beam, D = M s^2 + b s + K, the oil's h = s / K_c + K_pq / A^2 and the valve's
    V = s^2 + 2 xi w s + w^2: the open loop is (h D_m D_f + s (D_m + D_f)) V, the current acts on the outer tip by
    D_f K_q w^2 / A, and a tip force by (h D_f + s) V. On the inner tip the current acts by -D_m K_q w^2 / A, on the
    load pressure by D_m D_f K_q w^2 / A^2. The closed loop is that of an impedance in series with the oil's: with
    C_i and C_p from inner displacement and load pressure, h D_f + s becomes h D_f + s + (C_p D_f / A - C_i) K_q w^2
    / (A V). An end mass m adds m s^2 to D_m.
    """
    figure = {name: rational(value) for name, value in table["rig"].items() if name != "kind"}
    numerators, denominator = law_of(table["controller"])
    numerator, of_inner, of_pressure = (numerators.get(name, fmpq_poly([0])) for name in SENSED)
    area, valve = figure["piston_area_m2"], figure["valve_frequency_rad_per_s"]

    def impedance(beam: str, mass: fmpq) -> fmpq_poly:
        return fmpq_poly([figure[f"{beam}_stiffness_N_per_m"], figure[f"{beam}_damping_N_s_per_m"], mass])

    outer = impedance("outer", figure["outer_mass_kg"])
    inner = impedance("inner", figure["inner_mass_kg"] + figure["inner_end_mass_kg"])
    oil = fmpq_poly([figure["leakage_m3_per_s_per_Pa"] / area**2, 1 / figure["oil_stiffness_N_per_m"]])
    spool = fmpq_poly([valve**2, 2 * figure["valve_damping_ratio"] * valve, 1])
    lag, passed = fmpq_poly([1]), fmpq(1)
    if "filter_frequency_rad_per_s" in figure:
        passed = figure["filter_frequency_rad_per_s"]
        lag = fmpq_poly([passed, 1])
    around = spool * denominator * lag
    drive = figure["flow_gain_m3_per_s_per_A"] * valve**2 / area
    inside = drive * (inner * of_pressure / area - of_inner) * lag  # what a motion of the outer tip is met with
    returned = drive * figure["sensor_gain_V_per_m"] * passed * inner * numerator + outer * inside
    disturbance = (oil * inner + S) * around + inside
    opened = (oil * outer * inner + S * (outer + inner)) * around
    return {
        "p0": opened + returned,
        "p1": S * S * disturbance,
        "returned": returned,
        "disturbance": disturbance,
        "returned_slope": S * S * inside,
    }


def _proportional(rebuilt: dict[str, fmpq_poly], stated: dict[str, fmpq_poly]) -> bool:
    """Whether all polynomials agree but for one common positive factor."""
    degree = rebuilt["p1"].degree()
    factor = stated["p1"][degree] / rebuilt["p1"][degree]
    return factor > 0 and all(rebuilt[name] * factor == stated[name] for name in stated)


# Real roots by Descartes' rule of signs and bisection (Vincent, Collins and Akritas).


def _sign_changes(polynomial: fmpq_poly, low: fmpq, high: fmpq) -> int:
    """An upper bound on the number of roots in the open interval, which is exact where it is 0 or 1."""
    moved = polynomial(fmpq_poly([low, high - low])).numer().coeffs()  # onto (0, 1), then onto the positive numbers
    moved += [fmpz(0)] * (polynomial.degree() + 1 - len(moved))
    signs = [value > 0 for value in fmpz_poly(moved[::-1])(fmpz_poly([1, 1])).coeffs() if value != 0]
    return sum(before != after for before, after in pairwise(signs))


def _isolate(polynomial: fmpq_poly, low: fmpq, high: fmpq) -> list[Pair]:
    """Disjoint open intervals, each with one root in (low, high) of a polynomial without multiple roots, ascending.

    A root met exactly is an interval without length.
    """
    changes = _sign_changes(polynomial, low, high)
    if changes < 2:
        return [(low, high)] * changes
    middle = (low + high) / 2
    exact = [(middle, middle)] if polynomial(middle) == 0 else []
    return [*_isolate(polynomial, low, middle), *exact, *_isolate(polynomial, middle, high)]


def _halve(polynomial: fmpq_poly, interval: Pair) -> Pair:
    """A shorter interval around the same root."""
    low, high = interval
    middle = (low + high) / 2
    value = polynomial(middle)
    if low == high or value == 0:
        return middle, middle
    start = polynomial(low)
    below = start * value < 0 if start != 0 else _sign_changes(polynomial, low, middle) > 0
    return (low, middle) if below else (middle, high)


def _bound(polynomial: fmpq_poly) -> fmpq:
    """A power of two above every root (Fujiwara's bound, rounded up)."""
    coefficients = [int(value) for value in polynomial.numer().coeffs()]
    lead = abs(coefficients[-1]).bit_length() - 1
    exponents = [
        -((lead - abs(value).bit_length()) // k) for k, value in enumerate(coefficients[-2::-1], start=1) if value
    ]
    return fmpq(2) ** (max(exponents, default=0) + 2)


def _square_free(polynomial: fmpq_poly) -> fmpq_poly:
    return polynomial / polynomial.gcd(polynomial.derivative())


def _pieces(polynomials: Sequence[fmpq_poly], low: fmpq, high: fmpq) -> tuple[list[fmpq], int]:
    """A rational in every open interval into which the polynomials' roots cut (low, high), and how many roots that is.

    Zero polynomials cut nothing.
    """
    basis: list[fmpq_poly] = []
    for polynomial in polynomials:
        if polynomial.degree() < 1:
            continue
        rest = _square_free(polynomial)
        for other in basis:
            rest = rest / rest.gcd(other)
        for end in (low, high):  # a root at an end cuts nothing
            if rest(end) == 0:
                rest = rest / (S - end)
        if rest.degree() > 0:
            basis.append(rest)
    roots = sorted((interval, i) for i, factor in enumerate(basis) for interval in _isolate(factor, low, high))
    while True:
        clash = {k for i, (one, two) in enumerate(pairwise(roots)) if not one[0][1] < two[0][0] for k in (i, i + 1)}
        if roots and not roots[0][0][0] > low:
            clash.add(0)
        if roots and not roots[-1][0][1] < high:
            clash.add(len(roots) - 1)
        if not clash:
            break
        roots = sorted((_halve(basis[i], found) if k in clash else found, i) for k, (found, i) in enumerate(roots))
    edges = [low, *(end for interval, _ in roots for end in interval), high]
    return [(edges[i] + edges[i + 1]) / 2 for i in range(0, len(edges), 2)], len(roots)


# Stability over the mass.


def _hurwitz_matrix(polynomial: fmpq_poly, degree: int) -> fmpq_mat:
    size = max(degree - 1, 0)
    entries = [
        polynomial[k] if 0 <= (k := degree - 1 - 2 * column + row) <= degree else fmpq(0)
        for row in range(size)
        for column in range(size)
    ]
    return fmpq_mat(size, size, entries)


def _routh(polynomial: fmpq_poly) -> bool:
    """Whether all roots lie in the open left half plane: the quotients of Euclid's algorithm on the two parts."""
    coefficients = polynomial.coeffs()
    degree = polynomial.degree()
    if degree < 0:
        return False

    def part(parity: int) -> fmpq_poly:
        return fmpq_poly([c if (degree - i) % 2 == parity else 0 for i, c in enumerate(coefficients)])

    upper, lower = part(0), part(1)
    for left in range(degree, 0, -1):
        if lower.degree() != left - 1 or lower[left - 1] * upper[left] <= 0:
            return False
        upper, lower = lower, upper - fmpq_poly([0, upper[left] / lower[left - 1]]) * lower
    return True


class Family:
    """p0 + m p1 with the polynomials in m that vanish wherever stability can change."""

    def __init__(self, p0: fmpq_poly, p1: fmpq_poly):
        self.p0, self.p1 = p0, p1
        self.degree = max(p0.degree(), p1.degree())
        # Orlando: the last but one determinant vanishes where two roots add up to zero. It is a polynomial in m of
        # at most this degree, and found by interpolation.
        points = [fmpq(k) for k in range(max(self.degree, 1))]
        values = [_hurwitz_matrix(self.at(m), self.degree).det() for m in points]
        determinant, basis = fmpq_poly([0]), fmpq_poly([1])
        for point, value in zip(points, values, strict=True):
            determinant += basis * ((value - determinant(point)) / basis(point))
            basis *= S - point
        self.critical = [determinant, *(fmpq_poly([p0[k], p1[k]]) for k in (0, self.degree))]

    def at(self, mass: fmpq) -> fmpq_poly:
        """The member at one mass."""
        return self.p0 + self.p1 * mass

    def is_critical(self, mass: fmpq) -> bool:
        """Whether a root lies on the axis or at infinity, or two of them are symmetric about the origin."""
        return any(polynomial(mass) == 0 for polynomial in self.critical)

    def is_stable(self, mass: fmpq) -> bool:
        """Whether one member has all its roots, and in the open left half plane."""
        return self.at(mass).degree() == self.degree and _routh(self.at(mass))

    def verdict(self, low: fmpq, high: fmpq) -> bool | None:
        """Whether all masses strictly between are stable (True), none is (False), or some are (None)."""
        if low == high:
            return self.is_stable(low)
        samples, cuts = _pieces(self.critical, low, high)
        stable = [self.is_stable(mass) for mass in samples]
        if not any(stable):
            return False  # at the cuts themselves roots lie on the axis, at infinity, or on both sides of it
        return True if all(stable) and cuts == 0 and not any(q.is_zero() for q in self.critical) else None

    def is_stable_over(self, low: fmpq, high: fmpq) -> bool:
        """Whether all masses of a closed range are stable."""
        return self.is_stable(low) and self.is_stable(high) and self.verdict(low, high) is True


def _parts(polynomial: fmpq_poly) -> Polynomials:
    """Even and odd part on the axis, p(jw) = even(w^2) + j w odd(w^2)."""
    turned = [value * (1, 1, -1, -1)[i % 4] for i, value in enumerate(polynomial.coeffs())]
    return fmpq_poly(turned[0::2]), fmpq_poly(turned[1::2])


def _stability(
    table: dict[str, Any], p0: fmpq_poly, p1: fmpq_poly, low: fmpq, high: fmpq
) -> Iterator[tuple[bool, str]]:
    """The ranges tile what was asked, each with its verdict; the crossings are where they are said to be, and all."""
    family = Family(p0, p1)
    parts = [(rational(p["low"]), rational(p["high"]), rational(p["sample"]), p["stable"]) for p in table["range"]]
    listed = [Listed(entry) for entry in table["crossing"]]
    exact = {entry.mass[0] for entry in listed if entry.mass[0] == entry.mass[1]}
    tiles = sorted({*((a, b, 0) for a, b, *_ in parts if a < b), *((*entry.mass, 1) for entry in listed)})
    whole = [(a, b) for a, b, _, _ in parts] == [(low, high)] if not listed else _tile(tiles, low, high)
    yield whole, "the ranges and crossings make up the range" if whole else "the ranges leave out some masses"
    for a, b, sample, stable in parts:
        span = f"{_short(a)} to {_short(b)} kg"
        inside = a <= sample <= b and family.is_stable(sample) == stable
        ends = all(family.is_stable(end) == stable for end in (a, b) if end not in exact)
        proved = inside and ends and family.verdict(a, b) is stable
        words = f"{'stable' if stable else 'unstable'} from {span}"
        yield proved, words if proved else f"not proved: {words}"
    yield from _crossings(family, listed, low, high)
    right = table["stable"] is (not listed and all(stable for *_, stable in parts))
    yield right, f"stable = {table['stable']}" if right else "`stable` contradicts the ranges"
    for key in ("stays_stable_from_kg", "stays_stable_to_kg"):
        if key in table:
            far = _reach(family, table[key], high)
            a, b = (high, far) if key == "stays_stable_to_kg" else (far, low)
            proved = a <= b and family.is_stable_over(a, b)
            yield proved, f"{'' if proved else 'not proved: '}{key} = {table[key]}"


def _reach(family: Family, stated: str, least: fmpq) -> fmpq:
    """The mass stated, or for `infinite` one from `least` up above which nothing critical remains."""
    if stated != "infinite":
        return rational(stated)
    return max([least, *(_bound(polynomial) for polynomial in family.critical if polynomial.degree() > 0)])


def _tile(tiles: Sequence[tuple[fmpq, fmpq, int]], low: fmpq, high: fmpq) -> bool:
    """Whether intervals follow each other without a gap from low to high; crossings may share an enclosure."""
    if not tiles or tiles[0][0] != low or tiles[-1][1] != high:
        return False
    return all(before[1] == after[0] for before, after in pairwise(tiles))


class Listed:
    """A crossing of the certificate: enclosures of its mass and of its squared frequency (None at infinity)."""

    def __init__(self, entry: dict[str, Any]):
        self.mass = _enclosure(entry["outer_end_mass_kg"])
        self.infinite = entry["squared_frequency"] == "infinite"
        self.square = (fmpq(0), fmpq(0)) if self.infinite else _enclosure(entry["squared_frequency"])
        hertz = _enclosure(entry["frequency_Hz"]) if "frequency_Hz" in entry else None
        radians = [2 * arb.pi() * arb(value) for value in hertz or ()]
        self.agrees = hertz is None or bool(
            radians[0] * radians[0] <= arb(self.square[0]) and arb(self.square[1]) <= radians[1] * radians[1]
        )


def _enclosure(pair: Sequence[str]) -> Pair:
    least, most = (rational(value) for value in pair)
    if least > most:
        raise Malformed(f"empty enclosure {pair}")
    return least, most


def _crossings(family: Family, listed: Sequence[Listed], low: fmpq, high: fmpq) -> Iterator[tuple[bool, str]]:
    """Every root on the axis for a mass of the range is listed, and every one listed is there."""
    shared = family.p0.gcd(family.p1)
    if _on_axis(shared, (fmpq(0), _bound(shared))) or shared(0) == 0:
        yield not listed, "a root lies on the axis for every mass, so that none crosses"
        return
    left = list(listed)

    def take(mass: Pair, square: Pair, infinite: bool = False) -> bool:
        for entry in left:
            within = entry.mass[0] <= mass[0] and mass[1] <= entry.mass[1]
            there = entry.square[0] <= square[0] and square[1] <= entry.square[1]
            if within and there and entry.infinite == infinite and entry.agrees:
                left.remove(entry)
                return True
        return False

    zero = (fmpq(0), fmpq(0))
    for power, infinite in ((0, False), (family.degree, True)):
        if family.p1[power] != 0:
            mass = -family.p0[power] / family.p1[power]
            if low <= mass <= high and not take((mass, mass), zero, infinite):
                yield (
                    False,
                    f"a root passes through {'infinity' if infinite else 'zero'} at {_short(mass)} kg: not listed",
                )
    for words in _axis_crossings(family, take, [entry.mass for entry in listed], low, high):
        yield False, words
    if left:
        masses = ", ".join(_short(entry.mass[0]) for entry in left)
        yield False, f"no root crosses where it is said to, with an end mass of {masses} kg"
    else:
        yield True, f"crossings in the range: {len(listed)}, as listed"


def _axis_crossings(
    family: Family, take: Callable[[Pair, Pair], bool], listed: Sequence[Pair], low: fmpq, high: fmpq
) -> Iterator[str]:
    """What is wrong with the crossings at frequencies above zero.

    Eliminating the mass from both parts leaves an equation in x = w^2; at each of its roots the mass follows.
    """
    (even0, odd0), (even1, odd1) = _parts(family.p0), _parts(family.p1)
    equation, endless = even0 * odd1 - odd0 * even1, even1.gcd(odd1)
    if equation.is_zero():
        return
    while (common := equation.gcd(endless)).degree() > 0:
        equation = equation / common
    if equation.degree() < 1:
        return
    equation = _square_free(equation)
    ends = {end for pair in (*listed, (low, high)) for end in pair}
    for found in _isolate(equation, fmpq(0), _bound(equation)):
        interval = found
        for round_ in range(2000):
            interval = _halve(equation, interval)
            mass = _mass(even0, odd0, even1, odd1, interval)
            if mass is None:
                continue
            if mass[1] < low or mass[0] > high or take(mass, interval):
                break
            known = [end for end in ends if mass[0] <= end <= mass[1]] if round_ % 50 == 49 else []
            hit = [end for end in known if _on_axis(family.at(end), interval)]
            if hit and take((hit[0], hit[0]), interval):
                break
            edges = (*listed, (low, low), (high, high))
            if hit or not any(pair[0] <= mass[1] and mass[0] <= pair[1] for pair in edges):
                for _ in range(40):
                    interval = _halve(equation, interval)
                mass = _mass(even0, odd0, even1, odd1, interval) or mass
                yield f"a root crosses the axis near {_short(mass[0])} kg: not listed, or not at the frequency listed"
                break
        else:
            yield f"a crossing near {_short(interval[0])} (rad/s)^2 could not be placed"


def _mass(even0: fmpq_poly, odd0: fmpq_poly, even1: fmpq_poly, odd1: fmpq_poly, interval: Pair) -> Pair | None:
    """Bounds of the mass that belongs to a root in the interval; None where it is too wide to tell."""
    middle, radius = (interval[0] + interval[1]) / 2, (interval[1] - interval[0]) / 2
    x = arb(middle) + arb(0, arb(radius).upper())
    for constant, slope in ((even0, even1), (odd0, odd1)):
        below = arb_poly(slope)(x)
        if not below.contains(0):
            return _ends(-arb_poly(constant)(x) / below)
    return None


def _ends(ball: arb) -> Pair:
    def dyadic(point: arb) -> fmpq:
        mantissa, exponent = point.man_exp()
        return fmpq(mantissa) * fmpq(2) ** int(exponent)

    return dyadic(ball.mid()) - dyadic(ball.rad()), dyadic(ball.mid()) + dyadic(ball.rad())


def _on_axis(polynomial: fmpq_poly, interval: Pair) -> bool:
    """Whether the polynomial has a root at jw for a w^2 in the interval, open or of no length."""
    even, odd = _parts(polynomial)
    common = even.gcd(odd)
    if interval[0] == interval[1]:
        return common(interval[0]) == 0
    return common.degree() > 0 and bool(_isolate(_square_free(common), *interval))


# Performance.


INEQUALITIES = ("compliance", "peak_sensitivity", "loop_gain", "controller_effort")


def _claim(
    claim: dict[str, Any], stated: dict[str, fmpq_poly], law: Sequence[fmpq_poly], low: fmpq, high: fmpq
) -> tuple[bool, str]:
    """One claim: it holds if it says so, and fails (at its witness) if it says so."""
    kind, limit, holds = claim["kind"], rational(claim["limit"]), claim["holds"]
    p0, p1, returned = stated["p0"], stated["p1"], (stated["returned"], stated["returned_slope"])
    opened = (p0 - returned[0], p1 - returned[1])
    words = f"{kind} {claim['limit']}"
    if not isinstance(holds, bool) or limit <= 0:
        raise Malformed("a claim needs holds = true or false, and a positive limit")
    stable = Family(p0, p1).is_stable_over(low, high)
    witness = claim.get("witness")
    true_at_witness = True
    if kind in INEQUALITIES:
        more, start, until = band(claim)
        words += more
        bottom, top = magnitudes(kind, opened, returned, stated["disturbance"], law)
        slack = Slack(limit, bottom, top)
        truth = stable and slack.nonnegative(low, high, until, start)
        if witness and "squared_frequency" in witness:
            mass, square = rational(witness["outer_end_mass_kg"]), rational(witness["squared_frequency"])
            beyond = square < start or (until is not None and square > until)
            true_at_witness = not low <= mass <= high or square < 0 or beyond or slack.at(mass, square) >= 0
            witness = None
    elif kind == "decay_rate":
        words += " 1/s"
        shift = S - limit
        family = Family(p0(shift), p1(shift))
        truth = family.is_stable_over(low, high)
    elif kind == "gain_margin":
        least, most = sorted((fmpq(1), limit))
        truth = stable_on_rectangle(opened, returned, (low, high), (least, most))
        if witness:
            factor = rational(witness["gain_factor"])
            family = Family(opened[0] + factor * returned[0], opened[1] + factor * returned[1])
            if not least <= factor <= most:
                return False, f"the witness against {words} is outside the range"
    else:
        raise Malformed(f"claim.kind {kind!r} is not known here")
    if witness:  # against stability, of the family that the claim is about
        mass = rational(witness["outer_end_mass_kg"])
        if kind in INEQUALITIES:
            family = Family(p0, p1)
        true_at_witness = not low <= mass <= high or family.is_stable(mass)
    if "witness" in claim and (holds or true_at_witness):
        return False, f"the witness against {words} does not refute it"
    if truth is not holds:
        return False, f"{'not proved' if holds else 'holds after all'}: {words}"
    return True, words if holds else f"refuted: {words}"


def stable_on_rectangle(opened: Polynomials, returned: Polynomials, masses: Pair, gains: Pair) -> bool:
    """Whether opened + g returned is stable for every mass and every factor g, both polynomials affine in the mass.

    On a polytope of polynomials of constant degree the edges decide (Bartlett, Hollot and Huang, 1988). Where mass and
    factor multiply each other it is none, and what is inside is looked at as well.
    """
    over_mass = [Family(opened[0] + g * returned[0], opened[1] + g * returned[1]) for g in {*gains}]
    over_gain = [Family(opened[0] + m * opened[1], returned[0] + m * returned[1]) for m in {*masses}]
    sides = all(side.is_stable_over(*masses) for side in over_mass)
    sides = sides and (gains[0] == gains[1] or all(side.is_stable_over(*gains) for side in over_gain))
    flat = masses[0] == masses[1] or gains[0] == gains[1] or returned[1] == 0
    return sides and (flat or _clear_inside(opened, returned, masses, gains))


def _clear_inside(opened: Polynomials, returned: Polynomials, masses: Pair, gains: Pair) -> bool:
    """Whether no point inside a rectangle with stable sides has a root on the axis.

    If some had, one would have the least w^2 of all, since they keep away from the sides and from w = 0. There the two
    equations for g, E = e + e' g = 0 and O = o + o' g = 0 with coefficients affine in m, would be solved by m in
    e o' - o e' = 0 twice at once, else a slightly smaller w^2 would be, too. So w^2 is a root of the discriminant of
    that quadratic in m. Each of these is followed until its m, or the g that goes with it, is seen to be outside.
    """
    (e, o), (e_m, o_m), (e_g, o_g), (e_mg, o_mg) = (_parts(p) for p in (*opened, *returned))
    square, straight, constant = (
        e_m * o_mg - o_m * e_mg,
        e_m * o_g + e * o_mg - o_m * e_g - o * e_mg,
        e * o_g - o * e_g,
    )
    discriminant = straight * straight - 4 * square * constant
    if discriminant == 0:
        return False
    discriminant = _square_free(discriminant)

    def outside(x: arb) -> bool:
        two, one, none = (arb_poly(p)(x) for p in (square, straight, constant))
        if two.contains(0) and one.contains(0):
            return False
        mass = -one / (2 * two) if not two.contains(0) else -2 * none / one
        if _apart(mass, masses):
            return True
        for constants in ((e, e_m, e_g, e_mg), (o, o_m, o_g, o_mg)):
            free, by_mass, by_gain, by_both = (arb_poly(p)(x) for p in constants)
            below = by_gain + by_both * mass
            if not below.contains(0) and _apart(-(free + by_mass * mass) / below, gains):
                return True
        return False

    for found in _isolate(discriminant, fmpq(0), _bound(discriminant)):
        interval = found
        for _ in range(400):
            middle, radius = (interval[0] + interval[1]) / 2, (interval[1] - interval[0]) / 2
            if outside(arb(middle) + arb(0, arb(radius).upper())):
                break
            interval = _halve(discriminant, interval)
        else:
            return False
    return True


def _apart(ball: arb, ends: Pair) -> bool:
    return bool(ball < arb(ends[0])) or bool(ball > arb(ends[1]))


def band(claim: dict[str, Any]) -> tuple[str, fmpq, fmpq | None]:
    """Of a claim about a magnitude: unit and frequencies in words, and the least and largest w^2 (None: no end)."""

    def square(hertz: str) -> Pair:
        return _ends((2 * arb.pi() * arb(rational(hertz))) ** 2)

    if claim["kind"] == "compliance":
        until = None if claim["bandwidth_Hz"] == "infinite" else square(claim["bandwidth_Hz"])[1]
        return f" m/N up to {claim['bandwidth_Hz']} Hz", fmpq(0), until
    if claim["kind"] == "loop_gain":
        if rational(claim["from_Hz"]) < 0:
            raise Malformed("a loop gain is claimed from a frequency that is not negative")
        return f" from {claim['from_Hz']} Hz up", max(square(claim["from_Hz"])[0], fmpq(0)), None
    return " A/V" if claim["kind"] == "controller_effort" else "", fmpq(0), None


def magnitudes(
    kind: str, opened: Polynomials, returned: Polynomials, disturbance: fmpq_poly, law: Sequence[fmpq_poly]
) -> tuple[Polynomials, Polynomials]:
    """Denominator and numerator of what a claim bounds, each over the mass; `law` is the controller.

    With p = opened + returned: x / F_d = disturbance / p, S = opened / p, L = returned / opened, and C S is
    (opened / law denominator) (law numerator) / p, the controller's denominator being a factor of `opened`; C is from
    the displacement sensor's volts to the current.
    """
    closed, none = (opened[0] + returned[0], opened[1] + returned[1]), fmpq_poly([0])
    match kind:
        case "compliance":
            return closed, (disturbance, none)
        case "peak_sensitivity":
            return closed, opened
        case "loop_gain":
            return opened, returned
    if any(divmod(part, law[1])[1] != 0 for part in opened):
        raise Malformed("the controller's poles are not those of the open loop")
    above, below = law
    return closed, (opened[0] / below * above, opened[1] / below * above)


class Slack:
    """limit^2 |denominator|^2 - |numerator|^2 at jw; both polynomials are affine in the mass."""

    def __init__(self, limit: fmpq, denominator: Polynomials, numerator: Polynomials):
        (d0, d1), (n0, n1) = denominator, numerator
        square = limit * limit
        self.coefficients = tuple(
            square * _inner(*below) - _inner(*above)
            for below, above in (((d1, d1), (n1, n1)), ((2 * d0, d1), (2 * n0, n1)), ((d0, d0), (n0, n0)))
        )

    def at(self, mass: fmpq, square: fmpq) -> fmpq:
        """Its value at one mass and one w^2."""
        a, b, c = (polynomial(square) for polynomial in self.coefficients)
        return (a * mass + b) * mass + c

    def nonnegative(self, low: fmpq, high: fmpq, until: fmpq | None, start: fmpq = NONE) -> bool:
        """Whether it is nowhere negative for masses in [low, high] and start <= w^2 <= until (None: no end).

        Its least value over the mass lies at an end, or at the vertex: the signs of the curvature, of the slope at
        both ends, of the values there and of the discriminant decide. One point settles each interval between the
        roots of all these.
        """
        a, b, c = self.coefficients
        deciding = [a, 2 * a * low + b, 2 * a * high + b]
        deciding += [a * m**2 + b * m + c for m in (low, high)]
        deciding.append(b * b - 4 * a * c)
        if until is None:
            until = max([2 * start + 1, *(_bound(q) for q in deciding if q.degree() > 0)])
        points, _ = _pieces(deciding, start, until)
        return all(self._nonnegative_at(x, low, high) for x in points)

    def _nonnegative_at(self, x: fmpq, low: fmpq, high: fmpq) -> bool:
        a, b, _ = (polynomial(x) for polynomial in self.coefficients)
        masses = [low, high]
        if a > 0 and low < -b / (2 * a) < high:
            masses.append(-b / (2 * a))
        return all(self.at(mass, x) >= 0 for mass in masses)


def _inner(left: fmpq_poly, right: fmpq_poly) -> fmpq_poly:
    """Real part of left(jw) conj(right(jw)) as a polynomial in w^2."""
    (even_left, odd_left), (even_right, odd_right) = _parts(left), _parts(right)
    return even_left * even_right + S * odd_left * odd_right


def _short(value: fmpq) -> str:
    return f"{int(value.p) / int(value.q):.7g}"


def told(prove: Callable[[Path], Replay], how: str, arguments: Sequence[str]) -> int:
    """Replay one certificate, and say what was proved and what was not; the exit status.

    Args:
        prove: replays the certificate at a path.
        how: it is run, for the word on its use.
        arguments: of the command line, the path alone.
    """
    if len(arguments) != 1:
        print(f"usage: {how} CERTIFICATE", file=sys.stderr)
        return 2
    try:
        outcome = prove(Path(arguments[0]))
    except Malformed as error:
        print(f"{arguments[0]}: {error}", file=sys.stderr)
        return 2
    for words in outcome.claims:
        print(f"checked: {words}")
    for words in outcome.reasons:
        print(f"FAILED: {words}")
    print("valid" if outcome.valid else "not valid")
    return 0 if outcome.valid else 1


def main(arguments: Sequence[str]) -> int:
    """Replay the certificate named on the command line; the exit status."""
    return told(replay, "python replay.py", arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
