"""The rig that a certificate states, in floats: impedances of its parts, its poles, and what follows from what.

By Zalucky and Hardt (1984), equations (7) to (18), with numpy alone and without effects. Grids can refute what is
stated of a range, and not prove it; what is nearer to its limit than rounding is too close to call.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from math import pi
from typing import Any

import numpy as np
from numpy.polynomial import polynomial as P

Verdict = bool | None
Table = Mapping[str, Any]
CLOSE = 1e-6
"""Relative: nearer than this to its limit a figure is too close to call."""
SENSORS = ("displacement_m", "inner_displacement_m", "load_pressure_Pa")
POINTS = 13
"""Masses of a range."""


def number(text: Any) -> float:
    """A decimal or a quotient, as it has to be written."""
    if not isinstance(text, str) or not re.fullmatch("-?[0-9]+([.][0-9]+|/[0-9]+)?", text):
        raise ValueError(f"not a number: {text!r}")
    return float(Fraction(text))


def numbers(texts: Any) -> list[float]:
    """A list of them."""
    return [number(text) for text in texts]


def pair(texts: Any) -> tuple[float, float]:
    """A range, none below zero."""
    low, high = numbers(texts)
    if not 0 <= low <= high:
        raise ValueError("no range")
    return low, high


def together(verdicts: Iterable[Verdict]) -> Verdict:
    """All of them: false if one is, else too close to call if one is."""
    found = set(verdicts)
    return False if False in found else None if None in found else True


def near(one: float, other: float, tight: float = 1e-12, loose: float = 1e-9) -> Verdict:
    """Whether figures are one but for rounding."""
    off = abs(one - other)
    return True if off <= tight * abs(other) else False if off > loose * abs(other) else None


def below(value: float, limit: float) -> Verdict:
    """Whether a figure is below its limit."""
    return True if value < limit * (1 - CLOSE) else False if value > limit * (1 + CLOSE) else None


def agrees(stated: bool, found: Verdict) -> Verdict:
    """Whether a flag is what was found."""
    return None if found is None else stated is found


def grid(low: float, high: float, count: int = POINTS) -> np.ndarray:
    """Both ends and what is between."""
    return np.linspace(low, high, count if low < high else 1)


def repeats(table: Table) -> Iterator[Verdict]:
    """That what is stated twice of the rig and its controller is one."""
    rig, law = table["rig"], table["controller"]
    for name in ("valve", "filter"):
        if f"{name}_frequency_Hz" in rig:
            hertz, radians = (number(rig[f"{name}_frequency_{unit}"]) for unit in ("Hz", "rad_per_s"))
            yield near(2 * pi * hertz, radians)
    if "inner_end_mass_kg" in table.get("payload", {}):
        yield near(number(table["payload"]["inner_end_mass_kg"]), number(rig["inner_end_mass_kg"]))
    stated, expected = [*map(numbers, law["law"]["numerators"]), numbers(law["law"]["denominator"])], _expected(law)
    if expected is None:
        yield None
        return
    trimmed = [[P.polytrim(np.asarray(one, dtype=float)) for one in each] for each in (stated, expected)]
    if [len(one) for one in trimmed[0]] != [len(one) for one in trimmed[1]]:
        yield False
        return
    off = max((abs(a - b) / np.where(b == 0, 1, abs(b))).max() for a, b in zip(*trimmed, strict=True))
    tight, loose = (1e-7, 1e-5) if law["kind"] == "observer" else (1e-12, 1e-9)
    yield True if off < tight else False if off > loose else None


def _expected(law: Table) -> list[Any] | None:
    """Numerators and denominator by the controller's own figures; None for kinds that have others."""
    if law["kind"] not in ("proportional", "lag", "structured", "observer"):
        return None
    gain = number(law["gain_A_per_V"])
    if law["kind"] == "observer":
        a = np.array([numbers(row) for row in law["a"]]).reshape(len(law["a"]), -1)
        b, c, d = np.array([numbers(row) for row in law["b"]]), np.array(numbers(law["c"])), numbers(law["d"])
        if not len(a):
            return [[gain * each] for each in d] + [[1.0]]
        poles = np.real(np.poly(a))[::-1]
        # det(sI - a + b c) - det(sI - a) is the numerator of c (sI - a)^-1 b.
        above = [np.real(np.poly(a - np.outer(b[:, k], c)))[::-1] - poles + d[k] * poles for k in range(len(d))]
        return [gain * row for row in above] + [poles]
    ends: dict[str, Any] = {"zero": [gain], "pole": [1.0]}
    for name, found in ends.items():
        if law["kind"] != "proportional":
            found = P.polymul(found, [1, 1 / (2 * pi * number(law[f"{name}_Hz"]))])
        for section in law.get("section", []):
            time = 1 / (2 * pi * number(section[f"{name}_Hz"]))
            found = P.polymul(found, [1, 2 * number(section[f"{name}_damping_ratio"]) * time, time**2])
        ends[name] = found
    return [ends["zero"], ends["pole"]]


@dataclass(frozen=True)
class Servo:
    """What the cylinder does at a frequency: its force on the tip is -displaced y - moved u.

    Attributes:
        displaced: force per what the sensor sees, y.
        moved: force per motion of the tip, u.
        alone: the same without current.
        around, added: of L = (around y + added) / (1 / alone + u), where a force on the tip moves it by u without
            cylinder, and makes the sensor see y.
        law: of the displacement, A/V.
    """

    displaced: np.ndarray
    moved: np.ndarray
    alone: np.ndarray
    around: np.ndarray
    added: np.ndarray
    law: np.ndarray


class StatedRig:
    """Figures and controller of a certificate without effects."""

    def __init__(self, table: Table) -> None:
        if table.get("effect") or table["rig"]["kind"] != "twin_beam" or table["version"] != 2:
            raise ValueError("not of this format")
        self.figure = {key: number(value) for key, value in table["rig"].items() if key != "kind"}
        may_be_zero = ("outer_damping_N_s_per_m", "inner_damping_N_s_per_m", "leakage_m3_per_s_per_Pa")
        least = min(value for key, value in self.figure.items() if key not in (*may_be_zero, "inner_end_mass_kg"))
        if least <= 0 or min(self.figure.values()) < 0:
            raise ValueError("no rig")
        law = table["controller"]["law"]
        self.sensors = law["sensors"]
        self.numerators = dict(zip(self.sensors, map(numbers, law["numerators"]), strict=True))
        self.denominator = P.polytrim(numbers(law["denominator"]))
        if self.sensors[0] != SENSORS[0] or not set(self.sensors) <= set(SENSORS):
            raise ValueError("sensors")

    def beam(self, s: np.ndarray) -> np.ndarray:
        """Impedance of the outer beam's first mode."""
        figure = self.figure
        mass, damping = figure["outer_mass_kg"], figure["outer_damping_N_s_per_m"]
        return mass * s**2 + damping * s + figure["outer_stiffness_N_per_m"]

    def servo(self, s: np.ndarray) -> Servo:
        """The cylinder at complex frequencies, by hand from the paper's equations."""
        figure = self.figure
        area, natural = figure["piston_area_m2"], figure["valve_frequency_rad_per_s"]
        inner = (figure["inner_mass_kg"] + figure["inner_end_mass_kg"]) * s**2 + figure["inner_stiffness_N_per_m"]
        inner = inner + figure["inner_damping_N_s_per_m"] * s
        valve = figure["flow_gain_m3_per_s_per_A"] / (
            (s / natural) ** 2 + 2 * figure["valve_damping_ratio"] * s / natural + 1
        )
        seen = figure["sensor_gain_V_per_m"] * np.ones_like(s)
        if "filter_frequency_rad_per_s" in figure:
            seen = seen / (1 + s / figure["filter_frequency_rad_per_s"])
        under = P.polyval(s, self.denominator)
        laws = {name: P.polyval(s, above) / under for name, above in self.numerators.items()}
        # Both over s: f (1 / K_c + 1 / Z_i + K_pq / A^2 s) = Q / A s - u, and the inner tip moves by -f / Z_i.
        held = s * (1 / figure["oil_stiffness_N_per_m"] + 1 / inner) + figure["leakage_m3_per_s_per_Pa"] / area**2
        drive = valve / area
        added = laws.get(SENSORS[2], 0 * s) / area - laws.get(SENSORS[1], 0 * s) / inner
        around = drive * laws[SENSORS[0]] * seen
        behind = held + drive * added
        return Servo(around / behind, s / behind, s / held, around / s, drive * added / s, laws[SENSORS[0]])

    def poles(self, matrices: tuple[np.ndarray, np.ndarray, np.ndarray], seen: Sequence[float]) -> np.ndarray:
        """Of the closed loop with a structure of n coordinates, the tip first.

        Args:
            matrices: (n, n) stiffness, damping and mass, without the servo's.
            seen: (n,) what the sensor sees of them.
        """
        figure, n = self.figure, len(seen)
        filtered, order = "filter_frequency_rad_per_s" in figure, len(self.denominator) - 1
        v, c, q, z = 2 * n, 2 * n + 2, 2 * n + 3, 2 * n + 5 + filtered
        a = np.zeros((z + order, z + order))
        stiffness, damping, mass = matrices
        a[:n, n : 2 * n] = np.eye(n)
        oil, area = figure["oil_stiffness_N_per_m"], figure["piston_area_m2"]
        force = np.zeros(len(a))
        force[[c, 0]] = oil, -oil
        a[n : 2 * n, :n], a[n : 2 * n, n : 2 * n] = -stiffness, -damping
        a[n] += force
        a[n : 2 * n] = np.linalg.solve(mass, a[n : 2 * n])
        a[v, v + 1] = 1.0
        a[v + 1] -= force
        a[v + 1, v] -= figure["inner_stiffness_N_per_m"]
        a[v + 1, v + 1] -= figure["inner_damping_N_s_per_m"]
        a[v + 1] /= figure["inner_mass_kg"] + figure["inner_end_mass_kg"]
        a[c, [v + 1, q]] = 1.0, 1 / area
        a[c] -= figure["leakage_m3_per_s_per_Pa"] / area**2 * force
        natural = figure["valve_frequency_rad_per_s"]
        a[q, q + 1] = 1.0
        a[q + 1, [q, q + 1]] = -(natural**2), -2 * figure["valve_damping_ratio"] * natural
        volts = np.zeros(len(a))
        volts[:n] = figure["sensor_gain_V_per_m"] * np.asarray(seen)
        if filtered:
            a[z - 1] = figure["filter_frequency_rad_per_s"] * volts
            a[z - 1, z - 1] = -figure["filter_frequency_rad_per_s"]
            volts = np.eye(len(a))[z - 1]
        read = {SENSORS[0]: volts, SENSORS[1]: np.eye(len(a))[v], SENSORS[2]: force / area}
        current = self._realised(a, z, [read[name] for name in self.sensors])
        a[q + 1] += natural**2 * figure["flow_gain_m3_per_s_per_A"] * current
        return np.linalg.eigvals(a)

    def _realised(self, a: np.ndarray, z: int, read: Sequence[np.ndarray]) -> np.ndarray:
        """The law's states, in companion form in a time of their own, written to A; the current as a row."""
        order = len(self.denominator) - 1
        rate = abs(self.denominator[0] / self.denominator[-1]) ** (1 / order) if order else 1.0
        own = self.denominator * rate ** np.arange(order + 1)
        current = np.zeros(len(a))
        for name, row in zip(self.sensors, read, strict=True):
            above = np.zeros(order + 1)
            given = P.polytrim(self.numerators[name])
            above[: len(given)] = given * rate ** np.arange(len(given))  # raises for a law that is not proper
            straight = above[-1] / own[-1]
            current -= straight * row
            a[z:] -= rate * np.outer((above - straight * own)[:-1] / own[-1], row)
        if order:
            a[z:, -1] -= rate * own[:-1] / own[-1]
            a[np.arange(z + 1, z + order), np.arange(z, z + order - 1)] += rate
            current[-1] += 1.0
        return current


def stable(poles: np.ndarray) -> Verdict:
    """Whether all lie in the open left half plane."""
    beyond = (poles.real / abs(poles)).max()
    return False if beyond > CLOSE else True if beyond < -CLOSE else None


Poles = Callable[[float], np.ndarray]
"""Of the closed loop with a mass, kg."""


def listed(poles: Poles, stated: Table, low: float, high: float) -> Iterator[Verdict]:
    """Ranges with a verdict each, crossings between them, and how far it stays stable."""
    crossings = [(pair(entry["outer_end_mass_kg"]), entry) for entry in stated.get("crossing", [])]
    tiles = [pair([part["low"], part["high"]]) for part in stated["range"]]
    edges = sorted([*tiles, *(masses for masses, _ in crossings)])
    yield edges[0][0] == low and max(edges)[1] == high and all(b[0] <= a[1] for a, b in pairwise(edges))
    for part, (least, most) in zip(stated["range"], tiles, strict=True):
        yield least <= number(part["sample"]) <= most
        # An end at a crossing is too close to call.
        ends = [end for end in (least, most) if end in (low, high)]
        for mass in (number(part["sample"]), *np.linspace(least, most, 9)[1:-1], *ends):
            yield agrees(part["stable"], stable(poles(mass)))
    for (least, most), entry in crossings:
        if entry["squared_frequency"] == "infinite" or most - least > 1e-4 * most:
            yield None
            continue
        w = np.sqrt(pair(entry["squared_frequency"]))
        hertz = pair(entry["frequency_Hz"])
        yield bool(2 * pi * hertz[0] <= w[0] * (1 + CLOSE) and w[1] <= 2 * pi * hertz[1] * (1 + CLOSE))
        off = abs(poles((least + most) / 2) - 1j * w.mean()).min() / max(w.mean(), 1.0)
        yield True if off < CLOSE and w[1] - w[0] < CLOSE * w[1] else False if off > 1e-3 else None
    yield agrees(stated["stable"], together(agrees(True, stable(poles(mass))) for mass in grid(low, high)))
    for key, end in (("stays_stable_to_kg", high), ("stays_stable_from_kg", low)):
        if key in stated:
            far = 1e3 * (high + 1) if stated[key] == "infinite" else number(stated[key])
            yield far >= end if key.endswith("to_kg") else 0 <= far <= end
            for share in (0.0, 0.02, 0.1, 0.3, 0.6, 0.9, 0.99, 1 - 1e-4):
                yield stable(poles(end + (far - end) * share))


def frequencies(poles: np.ndarray, start: float, end: float) -> np.ndarray:
    """w in rad/s from `start` to `end`, evenly in the logarithm, and close about each resonance."""
    found = np.concatenate([np.geomspace(1e-3, 1e6, 181), np.outer(abs(poles), np.linspace(0.9, 1.1, 9)).ravel()])
    inside = found[(found >= start) & (found <= end)]
    return np.append(inside, [max(start, 1e-6), *([max(end, 1e-6)] if np.isfinite(end) else [])])
