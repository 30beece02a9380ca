"""Re-prove a certificate over a changing payload from its own figures, with python-flint and the standard library.

Nothing here is shared with the programme that wrote the certificate:

- A(m) of x' = A(m) x is written down anew from equations (7) to (16) of Zalucky and Hardt (1984), for the state
  x = (X_m, X_m', X_c, X_f, X_f', Q_0, Q_0', filtered sensor voltage if any, controller in companion form);
- definiteness is settled by elimination in rationals (the pivots of L D L' are all positive);
- a matrix polynomial in m is positive definite on an interval if it is so at the lower end and its determinant, an
  ordinary polynomial, vanishes nowhere on the interval: by Descartes' rule of signs, halving where it does not settle.

What a claim says, with W = M_m + m, D picking out the velocity v of the tip, V = x' P(m) x:

- any_change: A(m)' P + P A(m) < 0 at both ends, so in between, A being affine in 1 / W. Then the loop is stable however
  fast m changes, v being continuous (payload joins and leaves with the tip's velocity).
- bounded_rate: A' P + P A + r dP/dm < 0 for r = rate and r = -rate; joining "from_rest" also with
  - (r / W) (D P + P D), r = rate, so that payload may be at rest, or at any part of the tip's velocity, when it joins.
- sudden_change: A' P + P A + 2 decay P < 0 while m stays, J' P(m2) J < factor P(m1) at a jump, where J keeps v, or if
  "from_rest" any share of it down to (M_m + low) / (M_m + high); and log(factor) < 2 decay dwell.
- counterexamples: "frozen", a mass at which A(m) is not Hurwitz; "cycle", a product M of two matrix exponentials with
  |trace M^k| above the order of M for one k, so with a spectral radius above one.

Run as `python replay_lyapunov.py CERTIFICATE`; exit status 0 if it holds, 1 if it does not, 2 if it cannot be read.
"""

import hashlib
import sys
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import comb
from pathlib import Path
from typing import Any

from flint import arb, arb_mat, ctx, fmpq, fmpq_mat, fmpq_poly

KIND = "beamdesign.switching"
VERSION = 1
FLOAT_ROUNDING = fmpq(1, 10**14)
"""How far a figure in rad/s may be from 2 pi times the one in Hz: both are decimals of floats."""
MOST_CYCLES = 100_000
DEEPEST = 60

Result = tuple[bool, str]
"""Whether a statement was proved, and the statement or its failure in words."""


class Malformed(ValueError):
    """The text is not a certificate that this file can read."""


@dataclass(frozen=True)
class Replay:
    """Outcome of a replay.

    Attributes:
        valid: whether every statement of the certificate was proved again, and there is one.
        reasons: in words, every statement that was not.
        claims: in words, every statement that was.
    """

    valid: bool
    reasons: tuple[str, ...]
    claims: tuple[str, ...]


def replay(source: str | Path) -> Replay:
    """Prove a certificate again.

    Args:
        source: path of the certificate, or its text.

    Raises:
        Malformed: where it cannot be read as a certificate.
    """
    return proved_again(source, KIND, VERSION, _statements)


def proved_again(
    source: str | Path, kind: str, version: int, statements: Callable[[dict[str, Any]], Iterator[Result]]
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
    try:
        text = source if isinstance(source, str) and "\n" in source else Path(source).read_text(encoding="utf-8")
        table = tomllib.loads(text)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise Malformed(f"cannot be read: {error}") from error
    if table.get("kind") != kind or table.get("version") != version:
        raise Malformed(f"kind and version must be {kind!r} and {version}")
    try:
        with ctx.workprec(512):
            results = [_untouched(table, text), *statements(table)]
    except Malformed:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, ZeroDivisionError) as error:
        raise Malformed(f"an entry is missing or of the wrong kind: {error!r}") from error
    reasons = tuple(words for proved, words in results if not proved)
    return Replay(not reasons, reasons, tuple(words for proved, words in results if proved))


def _untouched(table: dict[str, Any], text: str) -> Result:
    checksum = f'sha256 = "{table["sha256"]}"\n'
    intact = hashlib.sha256(text.replace(checksum, "", 1).encode()).hexdigest() == table["sha256"]
    return intact, "the text is as it was written" if intact else "the text was altered after it was written (sha256)"


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


def _statements(table: dict[str, Any]) -> Iterator[Result]:
    low, high = rational(table["low"]), rational(table["high"])
    if not 0 <= low < high:
        raise Malformed("the range of masses is empty or negative")
    loop = Loop(table)
    yield from loop.figures_agree()
    claims, against = table.get("claim", []), table.get("counterexample", [])
    yield bool(claims or against), "something is claimed" if claims or against else "nothing is claimed"
    for claim in claims:
        least, most = rational(claim["low"]), rational(claim["high"])
        if not low <= least < most <= high:
            raise Malformed("the range of a claim is not within that of the certificate")
        kind, words = claim["kind"], f"{_short(least)} to {_short(most)} kg"
        if kind not in CLAIMS:
            raise Malformed(f"claim.kind {kind!r} is not known here")
        yield CLAIMS[kind](loop, claim, least, most, words)
    for example in against:
        if example["kind"] not in COUNTEREXAMPLES:
            raise Malformed(f"counterexample.kind {example['kind']!r} is not known here")
        yield COUNTEREXAMPLES[example["kind"]](loop, example, low, high)


def _short(value: fmpq) -> str:
    return f"{int(value.p) / int(value.q):.7g}"


# The closed loop, from its figures.


class Loop:
    """The closed loop of a certificate.

    Attributes:
        bare_mass: M_m, kg.
        order: number of states.
    """

    def __init__(self, table: dict[str, Any]):
        self.rig, self.controller = table["rig"], table["controller"]
        if self.rig["kind"] != "twin_beam":
            raise Malformed(f"rig.kind {self.rig['kind']!r} is not known here")
        self.figure = {name: rational(value) for name, value in self.rig.items() if name != "kind"}
        self.numerator = [rational(value) for value in self.controller["numerator"]]
        self.denominator = [rational(value) for value in self.controller["denominator"]]
        while len(self.denominator) > 1 and self.denominator[-1] == 0:
            self.denominator.pop()
        if self.denominator[-1] == 0 or len(self.numerator) > len(self.denominator):
            raise Malformed("the controller is not proper")
        self.filtered = "filter_frequency_rad_per_s" in self.figure
        self.bare_mass = self.figure["outer_mass_kg"]
        self.order = 7 + int(self.filtered) + len(self.denominator) - 1

    def matrix(self, m: fmpq) -> fmpq_mat:
        """A(m), row by row."""
        f, n = self.figure, self.order
        rows = [[fmpq(0)] * n for _ in range(n)]
        x, v, c, y, u, q, r = range(7)
        area, oil, w = f["piston_area_m2"], f["oil_stiffness_N_per_m"], f["valve_frequency_rad_per_s"]
        rows[x][v] = fmpq(1)
        # (7), (9), (11): (M_m + m) X_m'' = K_c (X_c - X_m) - K_m X_m - b_m X_m'
        outer = f["outer_mass_kg"] + m
        rows[v][c] = oil / outer
        rows[v][x] = -(oil + f["outer_stiffness_N_per_m"]) / outer
        rows[v][v] = -f["outer_damping_N_s_per_m"] / outer
        # (14) to (16): X_c' = X_f' + (Q_0 - K_pq K_c (X_c - X_m) / A) / A
        leak = f["leakage_m3_per_s_per_Pa"] * oil / (area * area)
        rows[c][u], rows[c][q], rows[c][c], rows[c][x] = fmpq(1), 1 / area, -leak, leak
        rows[y][u] = fmpq(1)
        # (8), (10): (M_f + n) X_f'' = -K_c (X_c - X_m) - K_f X_f - b_f X_f'
        inner = f["inner_mass_kg"] + f["inner_end_mass_kg"]
        rows[u][c], rows[u][x] = -oil / inner, oil / inner
        rows[u][y], rows[u][u] = -f["inner_stiffness_N_per_m"] / inner, -f["inner_damping_N_s_per_m"] / inner
        # (13): Q_0'' = w^2 (K_q I - Q_0) - 2 xi w Q_0'
        rows[q][r] = fmpq(1)
        rows[r][q], rows[r][r] = -w * w, -2 * f["valve_damping_ratio"] * w
        # The sensor F X_m, then its filter if there is one.
        sensed, gain = x, f["sensor_gain_V_per_m"]
        if self.filtered:
            break_frequency = f["filter_frequency_rad_per_s"]
            rows[7][x], rows[7][7] = break_frequency * gain, -break_frequency
            sensed, gain = 7, fmpq(1)
        self._close(rows, r, w * w * f["flow_gain_m3_per_s_per_A"], sensed, gain)
        return fmpq_mat(n, n, [entry for row in rows for entry in row])

    def _close(self, rows: list[list[fmpq]], into: int, drive: fmpq, sensed: int, gain: fmpq) -> None:
        """(12): I = C(s) (-sensed), C in companion form, driving row `into`."""
        order = len(self.denominator) - 1
        first, lead = self.order - order, self.denominator[-1]
        numerator = self.numerator + [fmpq(0)] * (order + 1 - len(self.numerator))
        direct = numerator[order] / lead
        rows[into][sensed] -= drive * direct * gain
        for j in range(order):
            rows[into][first + j] = drive * (numerator[j] - direct * self.denominator[j]) / lead
            rows[first + order - 1][first + j] = -self.denominator[j] / lead
        for j in range(order - 1):
            rows[first + j][first + j + 1] = fmpq(1)
        if order:
            rows[first + order - 1][sensed] -= gain

    def figures_agree(self) -> Iterator[Result]:
        """Figures that stand in two units agree, and the controller's polynomials are those of its kind."""
        may_be_zero = ("outer_damping", "inner_damping", "leakage", "inner_end_mass")
        for name, value in self.figure.items():
            if value < 0 or (value == 0 and not name.startswith(may_be_zero)):
                yield False, f"rig.{name} is not positive"
        pairs = [
            (self.figure[f"{name}_Hz"], self.figure[f"{name}_rad_per_s"])
            for name in ("valve_frequency", "filter_frequency")
            if f"{name}_rad_per_s" in self.figure
        ]
        fits = True
        if self.controller["kind"] in ("proportional", "lag"):
            gain, top, bottom = rational(self.controller["gain_A_per_V"]), self.numerator, self.denominator
            size = 1 if self.controller["kind"] == "proportional" else 2
            fits = len(top) == len(bottom) == size and top[0] == gain * bottom[0]
            if fits and size == 2:
                pairs.append((rational(self.controller["zero_Hz"]), top[0] / top[1]))
                pairs.append((rational(self.controller["pole_Hz"]), bottom[0] / bottom[1]))
        elif self.controller["kind"] != "transfer_function":
            raise Malformed(f"controller.kind {self.controller['kind']!r} is not known here")
        agree = fits and all(
            radians > 0 and abs(2 * arb.pi() * arb(hertz) / arb(radians) - 1) < arb(FLOAT_ROUNDING)
            for hertz, radians in pairs
        )
        yield bool(agree), "figures given twice agree" if agree else "the controller's or the rig's figures contradict"


# Definiteness.


def pivots_positive(matrix: fmpq_mat) -> bool:
    """Whether a symmetric matrix is positive definite: all pivots of its elimination are positive."""
    rows = matrix.tolist()
    n = len(rows)
    for k in range(n):
        if rows[k][k] <= 0:
            return False
        for i in range(k + 1, n):
            share = rows[i][k] / rows[k][k]
            for j in range(k, n):
                rows[i][j] -= share * rows[k][j]
    return True


def positive_between(value: Callable[[fmpq], fmpq_mat], degree: int, low: fmpq, high: fmpq) -> bool:
    """Whether a symmetric matrix polynomial of a given degree in m is positive definite on [low, high]."""
    if not pivots_positive(value(low)):
        return False
    # The determinant, by Newton's interpolation at as many points as its degree asks for.
    count = degree * value(low).nrows() + 1
    points = [low + (high - low) * fmpq(k, count) for k in range(count)]
    slopes = [value(point).det() for point in points]
    for level in range(1, count):
        for k in range(count - 1, level - 1, -1):
            slopes[k] = (slopes[k] - slopes[k - 1]) / (points[k] - points[k - level])
    determinant = fmpq_poly([slopes[-1]])
    for k in range(count - 2, -1, -1):
        determinant = determinant * fmpq_poly([-points[k], 1]) + slopes[k]
    return _no_root(determinant, low, high, DEEPEST)


def _no_root(polynomial: fmpq_poly, low: fmpq, high: fmpq, deepest: int) -> bool:
    """Whether a polynomial has no root in [low, high]: Bernstein coefficients of one sign, or so on both halves."""
    n = max(polynomial.degree(), 0)
    shifted = polynomial(fmpq_poly([low, high - low]))
    terms = [sum((shifted[j] * fmpq(comb(i, j), comb(n, j)) for j in range(i + 1)), fmpq(0)) for i in range(n + 1)]
    if terms[0] == 0 or terms[-1] == 0 or (terms[0] > 0) != (terms[-1] > 0):
        return False
    if all(term > 0 for term in terms) or all(term < 0 for term in terms):
        return True
    middle = (low + high) / 2
    return deepest > 0 and all(_no_root(polynomial, a, b, deepest - 1) for a, b in ((low, middle), (middle, high)))


# The claims.


class Function:
    """V = x' P(m) x from the lower triangles of its coefficients."""

    def __init__(self, loop: Loop, triangles: Sequence[Sequence[Sequence[str]]]):
        n = loop.order
        if not triangles or any([len(row) for row in rows] != list(range(1, n + 1)) for rows in triangles):
            raise Malformed(f"P must be lower triangles of order {n}")
        self.coefficients = [
            fmpq_mat(n, n, [rational(rows[max(i, j)][min(i, j)]) for i in range(n) for j in range(n)])
            for rows in triangles
        ]
        self.degree = len(self.coefficients) - 1

    def at(self, m: fmpq) -> fmpq_mat:
        """P(m)."""
        return sum((p * m**k for k, p in enumerate(self.coefficients)), self.coefficients[0] * 0)

    def slope(self, m: fmpq) -> fmpq_mat:
        """dP/dm."""
        terms = (p * (k * m ** (k - 1)) for k, p in enumerate(self.coefficients) if k)
        return sum(terms, self.coefficients[0] * 0)


def _fall(loop: Loop, p: fmpq_mat, m: fmpq) -> fmpq_mat:
    a = loop.matrix(m)
    return -(a.transpose() * p + p * a)


def _velocity(loop: Loop, p: fmpq_mat) -> fmpq_mat:
    """D P + P D with D picking out the second state, the velocity of the tip."""
    pick = fmpq_mat(loop.order, loop.order)
    pick[1, 1] = fmpq(1)
    return pick * p + p * pick


def _any_change(loop: Loop, claim: dict[str, Any], low: fmpq, high: fmpq, words: str) -> Result:
    function = Function(loop, claim["P"])
    p = function.coefficients[0]
    proved = (
        function.degree == 0 and pivots_positive(p) and all(pivots_positive(_fall(loop, p, m)) for m in (low, high))
    )
    return proved, f"{'stable' if proved else 'not proved stable'} under any matched change of mass, {words}"


def _joining(claim: dict[str, Any]) -> bool:
    """Whether payload may be at rest when it joins."""
    if claim["joining"] not in ("matched", "from_rest"):
        raise Malformed(f"joining {claim['joining']!r} is not known here")
    return bool(claim["joining"] == "from_rest")


def _bounded_rate(loop: Loop, claim: dict[str, Any], low: fmpq, high: fmpq, words: str) -> Result:
    function, rate = Function(loop, claim["P"]), rational(claim["rate_kg_per_s"])
    cases = [(rate, 0), (-rate, 0)] + ([(rate, 1)] if _joining(claim) else [])

    def fall(signed: fmpq, resting: int) -> Callable[[fmpq], fmpq_mat]:
        def value(m: fmpq) -> fmpq_mat:
            p, total = function.at(m), loop.bare_mass + m
            decline = (_fall(loop, p, m) - function.slope(m) * signed) * total
            return decline + _velocity(loop, p) * signed if resting else decline

        return value

    proved = (
        rate > 0
        and positive_between(function.at, function.degree, low, high)
        and all(positive_between(fall(*case), function.degree + 1, low, high) for case in cases)
    )
    how = f"|dm/dt| up to {_short(rate)} kg/s, payload {claim['joining'].replace('_', ' ')}"
    return proved, f"{'stable' if proved else 'not proved stable'} for {how}, {words}"


def _sudden_change(loop: Loop, claim: dict[str, Any], low: fmpq, high: fmpq, words: str) -> Result:
    function = Function(loop, claim["P"])
    dwell, factor, decay = (rational(claim[name]) for name in ("dwell_s", "factor", "decay_per_s"))

    def fall(m: fmpq) -> fmpq_mat:
        p = function.at(m)
        return (_fall(loop, p, m) - p * (2 * decay)) * (loop.bare_mass + m)

    least = (loop.bare_mass + low) / (loop.bare_mass + high)
    shares = (fmpq(1), least) if _joining(claim) else (fmpq(1),)
    proved = (
        function.degree <= 1  # affine in m: the extremes of both masses and of the share of v suffice
        and decay > 0
        and positive_between(function.at, function.degree, low, high)
        and positive_between(fall, function.degree + 1, low, high)
        and all(
            pivots_positive(function.at(before) * factor - _after(loop, function.at(after), share))
            for before in (low, high)
            for after in (low, high)
            for share in shares
        )
        and bool(arb(factor).log() < arb(2 * decay * dwell))
    )
    how = f"sudden changes every {_short(dwell)} s on average, payload {claim['joining'].replace('_', ' ')}"
    return proved, f"{'stable' if proved else 'not proved stable'} for {how}, {words}"


def _after(loop: Loop, p: fmpq_mat, share: fmpq) -> fmpq_mat:
    """J' P J, J multiplying the velocity by `share`."""
    n = loop.order
    scale = [share if i == 1 else fmpq(1) for i in range(n)]
    return fmpq_mat(n, n, [p[i, j] * scale[i] * scale[j] for i in range(n) for j in range(n)])


CLAIMS: dict[str, Callable[[Loop, dict[str, Any], fmpq, fmpq, str], Result]] = {
    "any_change": _any_change,
    "bounded_rate": _bounded_rate,
    "sudden_change": _sudden_change,
}


# The counterexamples.


def _frozen(loop: Loop, example: dict[str, Any], low: fmpq, high: fmpq) -> Result:
    mass = rational(example["outer_end_mass_kg"])
    proved = low <= mass <= high and not _hurwitz(loop.matrix(mass).charpoly())
    return proved, f"{'unstable' if proved else 'not unstable'} at {_short(mass)} kg that stays"


def _hurwitz(polynomial: fmpq_poly) -> bool:
    """Routh's table: whether all roots lie in the open left half plane."""
    falling = list(reversed(polynomial.coeffs()))
    upper, lower = falling[0::2], falling[1::2]
    while lower:
        if upper[0] * lower[0] <= 0:
            return False
        padded = lower + [fmpq(0)] * (len(upper) - len(lower))
        row = [u - upper[0] / lower[0] * w for u, w in zip(upper[1:], padded[1:], strict=True)]
        upper, lower = lower, row
    return True


def _cycle(loop: Loop, example: dict[str, Any], low: fmpq, high: fmpq) -> Result:
    masses, times = ([rational(value) for value in example[name]] for name in ("outer_end_mass_kg", "time_s"))
    cycles = int(example["cycles"])
    if not (len(masses) == len(times) == 2 and 1 <= cycles <= MOST_CYCLES):
        raise Malformed("a cycle has two masses, two times and a number of repetitions")
    proved = low <= min(masses) and max(masses) <= high and min(times) > 0
    if proved:
        first, second = (arb_mat(loop.matrix(m) * t).exp() for m, t in zip(masses, times, strict=True))
        proved = bool(abs(_power(second * first, cycles).trace()) > loop.order)
    words = f"{' and '.join(_short(m) for m in masses)} kg, {' and '.join(_short(t) for t in times)} s, in turn"
    return proved, f"{'the motion grows' if proved else 'growth is not proved'} for {words}"


def _power(matrix: arb_mat, exponent: int) -> arb_mat:
    """By squaring, which keeps the balls small."""
    if exponent == 1:
        return matrix
    half = _power(matrix, exponent // 2)
    return half * half * matrix if exponent % 2 else half * half


COUNTEREXAMPLES: dict[str, Callable[[Loop, dict[str, Any], fmpq, fmpq], Result]] = {"frozen": _frozen, "cycle": _cycle}


def told(prove: Callable[[Path], Replay], how: str, arguments: Sequence[str]) -> int:
    """Replay the certificate named on the command line, and say what was proved; the exit status.

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
    print("valid" if outcome.valid else "NOT valid")
    return 0 if outcome.valid else 1


def main(arguments: Sequence[str]) -> int:
    """Replay the certificate named on the command line; the exit status."""
    return told(replay, "python replay_lyapunov.py", arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
