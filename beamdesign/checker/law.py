"""The controller that a certificate states: its figures, its polynomials, and whether these follow from those.

One of several stages has no polynomials: it is built of its figures, with each frequency in rad/s as a rational.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from flint import arb, arb_poly, fmpq, fmpq_mat, fmpq_poly

from beamdesign.checker.reading import HIGHEST_DEGREE, Table, Unreadable, rational
from beamdesign.checker.roots import Pair
from beamdesign.checker.work import of_determinant, spend

SENSED = ("displacement_m", "inner_displacement_m", "load_pressure_Pa", "screw_force_N")
FLOAT_ROUNDING = fmpq(1, 10**14)
"""How far a figure in rad/s may be from 2 pi times the one in Hz: both are decimals of floats."""
SCHEDULED: dict[str, Any] = {
    "period_s": 0.0005,
    "dwell_s": 0.1,
    "estimator": {
        "noise_V": 0.002,
        "window_s": 0.08,
        "update_s": 0.01,
        "forgetting_s": 0.3,
        "model_error": 0.1,
        "largest_std_kg": 0.15,
        "band_kg": 0.4,
    },
}
"""What a prototype's controller of several stages says where it says nothing, beside its stages."""


Row = list[fmpq]
VELOCITY = 1
"""Place of the state that is the velocity of the outer tip, in whose row alone the mass is."""


class Law:
    """A controller of one or more sensors over one denominator.

    Attributes:
        kind: what it is called.
        figures: as they are stated, for comparison with a prototype's.
        numerators: by what they sense, the displacement first.
        denominator: of all.
        follows: whether they follow from the figures; None for a kind that is not known here.
    """

    def __init__(self, table: Table) -> None:
        law = table.table("law")
        sensors = law.words("sensors")
        numerators = [fmpq_poly(row) for row in law.rows("numerators")]
        self.denominator = law.polynomial("denominator")
        if sensors[:1] != [SENSED[0]] or not set(sensors) <= set(SENSED) or len(set(sensors)) != len(sensors):
            raise Unreadable(f"{law.place}.sensors must be some of {', '.join(SENSED)}, the first one first")
        if len(numerators) != len(sensors) or self.denominator == 0:
            raise Unreadable(f"{law.place} needs a numerator for each sensor, and a denominator")
        self.numerators = dict(zip(sensors, numerators, strict=True))
        self.kind = table.word("kind")
        self.figures = {key: table.take(key) for key in table.keys if key != "law"}
        self.follows: bool | None = None
        if self.kind in _FOLLOWS:
            figures = Table({"b_command": []} | self.figures, table.place)
            figures.word("kind"), figures.numbers("b_command")
            self.follows = _FOLLOWS[self.kind](self, figures)
            figures.done()

    @property
    def order(self) -> int:
        """Number of its states."""
        return self.denominator.degree()

    @property
    def of_displacement(self) -> tuple[fmpq_poly, fmpq_poly]:
        """From the volts of the displacement sensor to the current."""
        return self.numerators[SENSED[0]], self.denominator

    def close(self, rows: Sequence[Row], first: int, sensed: Mapping[str, Row]) -> Row:
        """(12): the current I = C(s) (-sensed), as a row over the states; C in observer form, from place `first` on."""
        if any(one.degree() > self.order for one in self.numerators.values()):
            raise Unreadable("the controller differentiates: its numerator is of higher degree than its denominator")
        if strange := [name for name in self.numerators if name not in sensed]:
            raise Unreadable(f"this rig does not show {', '.join(strange)}")
        n, k, lead = len(rows), self.order, self.denominator[self.order]
        current = [fmpq(int(k > 0 and j == n - 1)) for j in range(n)]
        for i in range(k):
            rows[first + i][n - 1] = -self.denominator[i] / lead
            if i:
                rows[first + i][first + i - 1] += 1
        for name, numerator in self.numerators.items():
            through = numerator[k] / lead
            for j, weight in enumerate(sensed[name]):
                current[j] -= through * weight
                for i in range(k):
                    rows[first + i][j] -= (numerator[i] - through * self.denominator[i]) / lead * weight
        return current


@dataclass(frozen=True)
class Stage:
    """A law of several that take turns: second-order sections, then a lag.

    Attributes:
        masses: outer end masses that it is for, kg.
        gain: A/V.
        zero: upper break of the lag, rad/s.
        pole: lower break.
        sections: zero, its damping ratio, pole, its damping ratio, of each.
    """

    masses: Pair
    gain: fmpq
    zero: fmpq
    pole: fmpq
    sections: tuple[tuple[fmpq, ...], ...]

    @property
    def order(self) -> int:
        """Number of its states."""
        return 2 * len(self.sections) + 1

    def close(self, rows: Sequence[Row], first: int, sensed: Mapping[str, Row]) -> Row:
        """Sections, then w_p (K u - i) + K (w_p / w_z) u' = i'; the current i, which is the last state."""
        n = len(rows)
        signal = [-weight for weight in sensed[SENSED[0]]]
        slope = _rate(rows, signal)
        bend = _rate(rows, slope) if self.sections else slope
        for k, (zero, above, pole, own) in enumerate(self.sections):
            here, rate = first + 2 * k, first + 2 * k + 1
            rows[here][rate] = fmpq(1)
            for j in range(n):
                rows[rate][j] = pole * pole * (signal[j] + 2 * above / zero * slope[j] + bend[j] / (zero * zero))
            rows[rate][here] -= pole * pole
            rows[rate][rate] -= 2 * own * pole
            bend = list(rows[rate])
            signal, slope = _unit(n, here), _unit(n, rate)
        for j in range(n):
            rows[n - 1][j] = self.pole * self.gain * (signal[j] + slope[j] / self.zero)
        rows[n - 1][n - 1] -= self.pole
        return _unit(n, n - 1)


def _unit(n: int, place: int) -> Row:
    return [fmpq(int(j == place)) for j in range(n)]


def _rate(rows: Sequence[Row], signal: Row) -> Row:
    """The rate of a linear function of the states, which must not depend on the velocity of the tip."""
    if signal[VELOCITY] != 0:
        raise Unreadable("a stage feels the acceleration of the tip: sections need a filter before them")
    n = len(signal)
    return [sum((signal[i] * rows[i][j] for i in range(n) if signal[i] != 0), fmpq(0)) for j in range(n)]


class Schedule:
    """Several laws that take turns.

    Attributes:
        figures: as they are stated, without those in rad/s.
        dwell: least time between changes of stage, s.
        stages: in their order.
        follows: whether each figure in rad/s is that in Hz.
    """

    def __init__(self, table: Table) -> None:
        self.dwell, self.follows = table.at_least("dwell_s", 0), True
        self.stages = [self._stage(one) for one in table.tables("stage")]
        if not self.stages or len({stage.order for stage in self.stages}) > 1:
            raise Unreadable(f"{table.place} needs stages that have as many sections as each other")
        table.word("kind", "scheduled"), table.number("period_s")
        estimator = table.table("estimator")
        for key in SCHEDULED["estimator"]:
            estimator.number(key)
        self.figures: dict[str, Any] = _in_hertz({key: table.take(key) for key in ("kind", "stage", *SCHEDULED)})

    def _stage(self, table: Table) -> Stage:
        sections = tuple((*self._pair(one, "zero"), *self._pair(one, "pole")) for one in table.tables("section"))
        masses, gain = table.range("outer_end_mass_kg", least=0), table.at_least("gain_A_per_V", 0, above=True)
        return Stage(masses, gain, self._radians(table, "zero"), self._radians(table, "pole"), sections)

    def _pair(self, section: Table, end: str) -> tuple[fmpq, fmpq]:
        return self._radians(section, end), section.at_least(f"{end}_damping_ratio", 0, above=True)

    def _radians(self, table: Table, name: str) -> fmpq:
        radians = table.at_least(f"{name}_rad_per_s", 0, above=True)
        self.follows &= same_frequency(table.number(f"{name}_Hz"), radians)
        return radians


def _in_hertz(value: Any) -> Any:
    """Nested figures without those in rad/s."""
    if isinstance(value, dict):
        return {key: _in_hertz(item) for key, item in value.items() if not key.endswith("_rad_per_s")}
    return [_in_hertz(item) for item in value] if isinstance(value, list) else value


def same_frequency(hertz: fmpq, radians: fmpq) -> bool:
    """Whether two figures are one frequency but for the rounding of floats."""
    return radians > 0 and bool(abs(2 * arb.pi() * arb(hertz) / arb(radians) - 1) < arb(FLOAT_ROUNDING))


def _cascade(law: Law, table: Table) -> bool:
    """Whether the polynomials are those of gain, lag and sections, but for the rounding of 2 pi f.

    All factors have positive coefficients only, so that each coefficient of their product is a sum of positive terms
    and is off by no more, relatively, than as many roundings as a term has factors 1 / (2 pi f): one per power of s.
    """

    def factor(hertz: fmpq, damping: fmpq | None = None) -> arb_poly:
        time = 1 / (2 * arb.pi() * arb(hertz))
        return arb_poly([1, time] if damping is None else [1, 2 * arb(damping) * time, time * time])

    gain = table.number("gain_A_per_V")
    above, below = arb_poly([arb(gain)]), arb_poly([1])
    if law.kind != "proportional":
        steps = [([table.number("zero_Hz")], [table.number("pole_Hz")])]
        for one in table.tables("section"):
            zero, pole = ([one.number(f"{end}_{of}") for of in ("Hz", "damping_ratio")] for end in ("zero", "pole"))
            steps.append((zero, pole))
        if min(gain, *(figure for step in steps for end in step for figure in end)) <= 0:
            return False
        for zero, pole in steps:
            above, below = above * factor(*zero), below * factor(*pole)
    return len(law.numerators) == 1 and all(
        stated.degree() == expected.degree()
        and stated[0] == start
        and all(
            bool(abs(arb(stated[k]) / expected[k] - 1) < 2 * k * FLOAT_ROUNDING) for k in range(1, stated.degree() + 1)
        )
        for stated, expected, start in zip(law.of_displacement, (above, below), (gain, fmpq(1)), strict=True)
    )


def _observer(law: Law, table: Table) -> bool:
    """Whether the polynomials are those of the matrices: c adj(sI - a) b = det(sI - a + b c) - det(sI - a)."""
    gain, sensors = table.number("gain_A_per_V"), table.words("sensors")
    a, b, c, d = table.rows("a"), table.rows("b"), table.numbers("c"), table.numbers("d")
    n, p = len(a), len(sensors)
    fits = len(b) == len(c) == n and len(d) == p and all(len(row) == n for row in a) and all(len(row) == p for row in b)
    if n > HIGHEST_DEGREE:
        raise Unreadable(f"{table.place}: {n} states are more than {HIGHEST_DEGREE}")
    if not fits or sensors != list(law.numerators):
        raise Unreadable(f"{table.place}: the matrices do not fit each other or the sensors")
    motion, shown = fmpq_mat(n, n, [value for row in a for value in row]), fmpq_mat(1, n, c)
    spend((1 + 2 * p) * of_determinant(motion))
    below = motion.charpoly()
    columns = (fmpq_mat(n, 1, [row[j] for row in b]) for j in range(p))
    above = [(motion - column * shown).charpoly() - below for column in columns]
    expected = [gain * (one + through * below) for one, through in zip(above, d, strict=True)]
    return expected == list(law.numerators.values()) and below == law.denominator


_FOLLOWS = {"proportional": _cascade, "lag": _cascade, "structured": _cascade, "observer": _observer}


def same(stated: Any, given: Any) -> bool:
    """Whether an entry of a certificate says what one of a prototype says, numbers by their value as floats."""
    if isinstance(given, dict):
        alike = isinstance(stated, dict) and stated.keys() == given.keys()
        return alike and all(same(stated[key], value) for key, value in given.items())
    if isinstance(given, list):
        alike = isinstance(stated, list) and len(stated) == len(given)
        return alike and all(same(one, other) for one, other in zip(stated, given, strict=True))
    if isinstance(given, float | int) and not isinstance(given, bool):
        return rational(stated) == decimal(given)
    return bool(stated == given)


def decimal(value: float) -> fmpq:
    """The shortest decimal that a float is read back from, exactly."""
    digits, _, exponent = repr(float(value)).partition("e")
    return rational(digits) * fmpq(10) ** int(exponent or 0)
