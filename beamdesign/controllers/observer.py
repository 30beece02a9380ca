"""The record of a controller with several sensors: state feedback with an observer, or any dynamic output feedback.

Its form for a tuner has blocks of two poles each, side by side, which all its sensors share: the law of each sensor is
unit_k (d_k + sum over blocks (p + q u) / (1 + 2 z u + u^2)) with u = s / w: a pair of poles to a block, or two real
ones, all of them stable. Its variables are, block by block, log w (rad/s), log z and p and q of every sensor, then
every d.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import zip_longest
from math import log, pi
from typing import TYPE_CHECKING, Any, Literal, Self

from pydantic import Field

from beamdesign import quantities as q
from beamdesign.controllers.protocol import (
    SENSED,
    SENSORS,
    UNIT,
    Controller,
    Form,
    Need,
    Polynomials,
    Row,
    Sensed,
    SensedLaw,
    times,
)
from beamdesign.plant.component import Matrices
from beamdesign.records import Problem

if TYPE_CHECKING:
    import numpy as np
    from flint import fmpq_poly

LARGEST_ORDER = 12

_OF_UNIT = {"m": 1e-4, "Pa": 1e6, "N": 1e3}
_TYPICAL = {name: _OF_UNIT.get(name.rpartition("_")[2], 1.0) for name in SENSORS} | {SENSORS[0]: 0.1, "command_V": 0.1}
"""Of what a controller is given, of the displacement and the command in V."""

Entries = tuple[q.MatrixEntry, ...]


class Observer(Controller):
    """z' = a z + b e + b_command command_V, current = gain_A_per_V (c z + d e): a linear controller of many sensors.

    e_1 is command_V less the volts of the displacement sensor, behind its filter, as for every other controller. Each
    further e_k is minus what an ideal added sensor reads, in SI: the inner tip's displacement in m or the load
    pressure in Pa, both zero at rest. n is the order, p the number of sensors.
    """

    kind: Literal["observer"] = Field("observer", description="which law, with its own figures")
    gain_A_per_V: q.LawGain = Field(description="factor on the whole law, so that it alone scales the loop")
    sensors: tuple[Sensed, ...] = Field(
        description="what it senses, each once, displacement_m first; they order b and d"
    )
    a: tuple[Entries, ...] = Field(description="n rows of n, 1/s; n up to 12, and [] for a static gain")
    b: tuple[Entries, ...] = Field(description="n rows of one entry per sensor")
    c: Entries = Field(description="n entries")
    d: Entries = Field(description="one entry per sensor")
    b_command: Entries = Field(
        (), description="n entries, what command_V does to z' beside its part of e_1; [] for nothing"
    )

    @property
    def order(self) -> int:
        """How many states it has."""
        return len(self.a)

    @property
    def senses(self) -> tuple[Sensed, ...]:
        """Its sensors."""
        return self.sensors

    @property
    def sought(self) -> dict[str, Any]:
        """The same sensors; by Riccati equations, and from the matrices as they are."""
        return {"kind": "lqg", "sensors": self.sensors}

    def sensed_law(self) -> SensedLaw:
        """The law from everything that it senses to its current, exact."""
        from flint import fmpq_mat

        from beamdesign.polynomial import exact, transfer

        n, count, gain = self.order, len(self.sensors), exact(self.gain_A_per_V)
        a, b = (fmpq_mat(n, m, [exact(x) for row in rows for x in row]) for m, rows in ((n, self.a), (count, self.b)))
        c, d = (fmpq_mat(1, len(row), [exact(value) for value in row]) for row in (self.c, self.d))
        numerators, denominator = transfer(a, b, c, d)
        return SensedLaw(self.sensors, tuple(gain * above for above in numerators), denominator)

    def command_numerator(self) -> "fmpq_poly":
        """Numerator of current over command, A/V, with the denominator of its law, exact."""
        through_error = self.sensed_law().numerators[0]
        if not self.b_command:
            return through_error
        rows = tuple((more, *row[1:]) for row, more in zip(self.b, self.b_command, strict=True))
        return through_error + self.but(b=rows, d=(0.0, *self.d[1:])).sensed_law().numerators[0]

    def summary(self) -> list[tuple[str, str]]:
        """Its sensors, its order and its poles."""
        import numpy as np

        poles = np.linalg.eigvals(np.reshape(self.a, (self.order, self.order))) / (2 * pi)
        words = ", ".join(f"{abs(p):.4g}" for p in sorted(poles, key=abs) if p.imag >= 0)
        return [("sensors", ", ".join(self.sensors)), ("order", str(self.order)), ("poles, Hz", words)]

    def rows(self) -> list[Row]:
        """Its gain, its sensors and its matrices row by row."""
        rows = [
            ("gain", q.quantity(self.gain_A_per_V, "A/V", 7), "factor on the whole law"),
            ("sensors", ", ".join(self.sensors), "e: error volts, then what the others read with its sign turned"),
        ]
        for name, matrix in (("a", self.a), ("b", self.b)):
            for i, row in enumerate(matrix, start=1):
                rows.append((f"{name}, row {i}", _listed(row), "z' = a z + b e, in SI"))
        if self.b_command:
            rows.append(("b_command", _listed(self.b_command), "what command_V adds to z', beside its part of e"))
        if self.c:
            rows.append(("c", _listed(self.c), "current = gain (c z + d e)"))
        return [*rows, ("d", _listed(self.d), "the same")]

    def lacks(self, need: Need) -> str:
        """Why it cannot serve what has this need."""
        return super().lacks(need) if need in ("one sensor", "one law") else "is given by matrices; give a lag"

    def form(self) -> "tuple[Form, np.ndarray] | None":
        """Blocks of two poles; none where its matrices are not stable."""
        import numpy as np

        n, p, gain = self.order, len(self.sensors), self.gain_A_per_V
        b, c = np.reshape(self.b, (n, p)), np.reshape(self.c, (1, n))
        return block_form(self.sensors, np.reshape(self.a, (n, n)), b, gain * c, gain * np.reshape(self.d, (1, p)))

    @property
    def equations(self) -> Matrices:
        """Its equations in the rig: of its sensors, and of its command where that acts beside them."""
        return Matrices(self.order, (*self.sensors, "command_V") if self.b_command else self.sensors)

    def figures(self) -> dict[str, float]:
        """The gain, then its matrices for states that are of the order of one.

        Whoever designs it chooses the units of its states; a simulation wants to know when they stand still. They are
        scaled by powers of two, which round nothing.
        """
        import numpy as np

        sensed, n = self.equations.sensed, self.order
        a, b, c = np.reshape(self.a, (n, n)), np.reshape(self.b, (n, len(self.sensors))), np.array(self.c)
        if self.b_command:
            b = np.column_stack([b, self.b_command])
        if n:
            typical = b * [_TYPICAL[name] for name in sensed]
            off_axis = (1 + 1j) * np.geomspace(1.0, 1e4, 25)  # 1/s, so that no undamped mode is met
            pencils = off_axis[:, None, None] * np.eye(n) - a
            size = np.abs(np.linalg.solve(pencils, np.broadcast_to(typical, (len(pencils), n, len(sensed)))))
            largest = size.max(axis=(0, 2))
            scale = np.exp2(np.round(np.log2(np.where(largest > 0, largest, 1.0))))
            a, b, c = a * scale / scale[:, None], b / scale[:, None], c * scale
        d = (*self.d, 0.0) if self.b_command else self.d
        entries = [float(value) for part in (a, b, c, d) for value in np.ravel(part)]
        return dict(zip(self.equations.parameters, (self.gain_A_per_V, *entries), strict=True))

    @classmethod
    def of(
        cls, gain_A_per_V: float, sensors: Sequence[Sensed], a: Any, b: Any, c: Any, d: Any, b_command: Any = ()
    ) -> Self:
        """The record of matrices in anything that nests like them, such as arrays of (n, n), (n, p), (n,) and (p,)."""
        return cls(
            gain_A_per_V=float(gain_A_per_V),
            sensors=tuple(sensors),
            a=tuple(tuple(float(value) for value in row) for row in a),
            b=tuple(tuple(float(value) for value in row) for row in b),
            c=tuple(float(value) for value in c),
            d=tuple(float(value) for value in d),
            b_command=tuple(float(value) for value in b_command),
        )

    @classmethod
    def behind_lag(cls, law: Controller, break_Hz: float) -> Self:
        """A law that hears the displacement through a first-order lag; what it makes of the command is left out.

        Raises:
            ValueError: for a law that is of the largest order already.
        """
        import numpy as np

        a, b, c, d, _ = law.state_space()
        rate, gain, others = 2 * pi * break_Hz, law.gain_A_per_V, b * (np.arange(b.shape[1]) > 0)
        inputs = np.vstack([rate * np.eye(1, b.shape[1]), others])
        lagged = np.block([[-rate, np.zeros((1, len(a)))], [b[:, :1], a]])
        return cls.of(gain, law.senses, lagged, inputs, [d[0] / gain, *c / gain], [0.0, *d[1:] / gain])

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """The sensors are what can be sensed so, and the matrices fit each other."""
        given = (_entries(table.get(key)) for key in ("sensors", "a", "b", "c", "d", "b_command"))
        sensors, a, b, c, d, commanded = given
        if sensors is not None:
            yield from wrong_sensors(sensors)
        if a is not None:
            if len(a) > LARGEST_ORDER:
                yield Problem("a", f"is of order {len(a)}; at most {LARGEST_ORDER} can be")
            yield from _widths("a", a, len(a), "to be square")
            yield from _counted("b", b, "a row", len(a), "of a")
            yield from _counted("b_command", commanded or None, "an entry", len(a), "of a")
            yield from _counted("c", c, "an entry", len(a), "rows of a")
        if sensors:
            if len(sensors) == 1 and commanded:
                yield Problem("b_command", "has no meaning without an added sensor; leave it out")
            if b is not None:
                yield from _widths("b", b, len(sensors), "one per sensor")
            yield from _counted("d", d, "an entry", len(sensors), "sensors")


def wrong_sensors(sensors: Sequence[str]) -> Iterator[Problem]:
    """What is wrong with a list of sensors."""
    if not sensors or sensors[0] != SENSED[0]:
        yield Problem("sensors", f"must begin with {SENSED[0]!r}, whose volts close the loop")
    for name in dict.fromkeys(name for name in sensors if sensors.count(name) > 1):
        yield Problem("sensors", f"{name!r} stands there more than once")


def _listed(row: Sequence[float]) -> str:
    return ", ".join(f"{value:.12g}" for value in row)


def _entries(value: Any) -> Sequence[Any] | None:
    """What stands in brackets, None for what does not."""
    return value if isinstance(value, list | tuple) else None


def _counted(key: str, entries: Sequence[Any] | None, what: str, count: int, of: str) -> Iterator[Problem]:
    if entries is not None and len(entries) != count:
        yield Problem(key, f"must have {what} for each of the {count} {of}, has {len(entries)}")


def _widths(key: str, matrix: Sequence[Any], width: int, why: str) -> Iterator[Problem]:
    for number, row in enumerate(matrix, start=1):
        entries = _entries(row)
        if entries is not None and len(entries) != width:
            yield Problem(key, f"entry {number}: must hold {width} entries, {why}, holds {len(entries)}")


SLOWEST_HZ, FASTEST_HZ = 0.02, 2000.0
LEAST_DAMPING, MOST_DAMPING = 0.1, 20.0
"""Bounds of the blocks; a pole less damped than 0.1 would ring in the controller itself, and move with its parts."""

DIGITS = 9
"""To which the entries of a record are rounded."""

_FREE, _FURTHER = 1e3, 3.0
"""Bound of what is of order one, and how much further it may move than a logarithm."""


def block_form(
    sensors: tuple[Sensed, ...],
    a: "np.ndarray",
    b: "np.ndarray",
    c: "np.ndarray",
    d: "np.ndarray",
    blocks: int = 0,
    worth: "np.ndarray | None" = None,
    pace: float = 1.0,
) -> "tuple[Form, np.ndarray] | None":
    """The form of a law with distinct poles, and its variables; real poles are paired, the slowest with the next.

    Args:
        sensors: p of them.
        a: (n, n) of its matrices, SI.
        b: (n, p)
        c: (1, n)
        d: (1, p)
        blocks: how many at least; those beyond its poles do nothing yet.
        worth: (p,) factors on the first sensor's gain that do as much through each; needed where one does nothing yet.
        pace: how many times as quick as the published rig what it controls is.

    Returns:
        form and variables; None for a law that is not stable, which has no such form.
    """
    import numpy as np

    poles, vectors = np.linalg.eig(a)
    if len(poles) and not poles.real.max() < 0:
        return None
    residues = (c @ vectors).ravel()[:, None] * np.linalg.solve(vectors, b.astype(complex))
    terms = [(poles[k], residues[k]) for k in np.argsort(np.abs(poles))]
    real = [term for term in terms if abs(term[0].imag) <= 1e-9 * abs(term[0])]
    pairs = [((pole, of), (pole.conjugate(), of.conjugate())) for pole, of in terms if pole.imag > 1e-9 * abs(pole)]
    p = len(sensors)
    if len(real) % 2:  # beside a lone real pole a fast one that does nothing
        real.append((complex(-2 * pi * pace * FASTEST_HZ / 4), np.zeros(p, dtype=complex)))
    pairs += list(zip(real[::2], real[1::2], strict=True))
    units = np.vstack([np.abs(d), np.abs(residues / poles[:, None])]).max(axis=0)
    if worth is not None:
        units = np.maximum(units, units[0] * worth)
    rows = []
    for (first, residue), (second, other) in pairs:
        square = (first * second).real
        w = np.sqrt(square)
        z = -(first + second).real / (2 * w)
        high = (residue + other).real / w
        low = -(residue * second + other * first).real / square
        rows.append(np.concatenate([[log(w / (2 * pi)), log(z)], low / units, high / units]))
    while len(rows) < blocks:
        rows.append(np.concatenate([[log(pace * 10.0 * 3 ** (len(rows) - 1)), log(0.7)], np.zeros(2 * p)]))
    return _form(sensors, units, len(rows)), np.concatenate([*rows, d.ravel() / units])


def _form(sensors: tuple[Sensed, ...], units: "np.ndarray", blocks: int) -> Form:
    import casadi as ca
    import numpy as np

    p = len(sensors)
    width = 2 + 2 * p
    bounds = [(log(SLOWEST_HZ), log(FASTEST_HZ)), (log(LEAST_DAMPING), log(MOST_DAMPING))]
    block = [*bounds, *[(-_FREE, _FREE)] * (2 * p)]
    limits = np.array(block * blocks + [(-_FREE, _FREE)] * p)

    def polynomials(variables: Any) -> Polynomials:
        numerators = [[unit * d] for unit, d in zip(units, variables[blocks * width :], strict=True)]
        denominator: list[Any] = [1.0]
        for first in range(0, blocks * width, width):
            u, damping = UNIT / (2 * pi) / ca.exp(variables[first]), ca.exp(variables[first + 1])
            below = [1.0, 2 * damping * u, u * u]
            for k, unit in enumerate(units):
                low, high = (variables[first + 2 + k + part] for part in (0, p))
                added = times([unit * low, unit * high * u], denominator)
                numerators[k] = [sum(both) for both in zip_longest(times(numerators[k], below), added, fillvalue=0.0)]
            denominator = times(denominator, below)
        return numerators, denominator

    def record(variables: "np.ndarray") -> Observer:
        n = 2 * blocks
        a, b, c = np.zeros((n, n)), np.zeros((n, p)), np.zeros(n)
        for i, row in enumerate(variables[: blocks * width].reshape(blocks, width)):
            w, z = np.exp(row[:2]) * [2 * pi, 1.0]
            at = slice(2 * i, 2 * i + 2)
            a[at, at] = [[0.0, w], [-w, -2 * z * w]]
            low, high = row[2 : 2 + p] * units, row[2 + p :] * units
            b[at] = w * np.array([high, low - 2 * z * high])
            c[2 * i] = 1.0
        gain = float(f"{units[0]:.{DIGITS}g}")
        d = variables[blocks * width :] * units
        return Observer.of(gain, sensors, rounded(a), rounded(b / gain), c, rounded(d / gain))

    moves = np.where(limits[:, 1] == _FREE, _FURTHER, 1.0)
    frequencies = np.arange(len(limits)) % width == 0
    frequencies[blocks * width :] = False
    return Form(sensors, limits[:, 0], limits[:, 1], polynomials, record, moves, frequencies=frequencies)


def rounded(values: "np.ndarray", digits: int = DIGITS) -> "np.ndarray":
    """Values to so many significant digits."""
    import numpy as np

    return np.vectorize(lambda value: float(f"{value:.{digits}g}"), otypes=[float])(values)
