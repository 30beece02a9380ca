"""The rig that a certificate states, as loops in floats that share nothing with any checker.

A loop is a descriptor pencil (A, E) put together node by node: beams, mount and rod as coordinates and velocities,
pressures of chambers, the valve, filters and the controller in companion form (Zalucky and Hardt 1984, equations (7) to
(18)).
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import product
from math import pi, prod
from typing import Any

import numpy as np
from numpy.polynomial import polynomial as P
from scipy.linalg import eig, matrix_balance

FOLLOWS = 1e-9
"""How far a coefficient may be off what the controller's figures give, which are rounded to decimals of floats."""
UNIT_OF_TIME = 1e-2  # s, near the loop's own, so that powers of s have coefficients of like size
FAR = 1e7  # 1/s: faster eigenvalues are infinite ones, but for rounding
SENSORS = ("displacement_m", "inner_displacement_m", "load_pressure_Pa")


def number(text: Any) -> float:
    """A decimal or a quotient, as it has to be written."""
    if not isinstance(text, str) or not re.fullmatch("-?[0-9]+([.][0-9]+|/[0-9]+)?", text):
        raise ValueError(f"not a number: {text!r}")
    return float(Fraction(text))


def numbers(texts: Any) -> list[float]:
    """A list of them."""
    return [number(text) for text in texts]


@dataclass(frozen=True)
class Member:
    """A linear loop that stands for the rig with its effects.

    Attributes:
        e: of e x' = a x + b u without a mass on the tip, u being the disturbance and the current.
        mass: what 1 kg there adds to it.
        a: of the plant, its sensors' volts and pressures.
        b: likewise.
        tip: row of what the tip's displacement is.
        seen: rows of what the controller sees.
        gain: factors over which it is to be stable.
        performing: those over which it is to perform; None where it is not to.
        flow: what a flow behind the spool drives.
        pull: what a force between piston and cylinder drives.
        filtered: whether filters are behind the sensor.
        spool: natural frequency in rad/s, damping ratio, and spring over that of the pilot.
        fed: row of what the drive of a motor adds to the law's current, as if it were the law's; zeros without one.
    """

    e: np.ndarray
    mass: np.ndarray
    a: np.ndarray
    b: np.ndarray
    tip: np.ndarray
    seen: np.ndarray
    law: tuple[list[list[float]], list[float]]
    gain: tuple[float, float]
    performing: tuple[float, float] | None
    flow: np.ndarray
    pull: np.ndarray
    filtered: bool
    spool: tuple[float, float, float]
    fed: np.ndarray

    def at_the_motor(self) -> "Member":
        """The loop cut at what the motor is asked for: what the drive feeds back is one more sensor of the law."""
        if not self.fed.any():
            raise ValueError("no motor")
        (numerators, denominator), opened = self.law, self.a - np.outer(self.b[:, 1], self.fed)
        seen, law = np.vstack([self.seen, -self.fed]), ([*numerators, denominator], denominator)
        return replace(self, a=opened, seen=seen, law=law, gain=(1.0, 1.0))

    def pencil(self, mass: float, gain: float) -> tuple[np.ndarray, np.ndarray]:
        """(A, E) of the closed loop; behind the plant's states those of the controller, then its current."""
        numerators, denominator = self.law
        n, order = len(self.a), max(len(row) for row in (*numerators, denominator)) - 1
        size = n + order + 1
        a, e = np.zeros((size, size)), np.zeros((size, size))
        a[:n, :n], e[:n, :n], a[:n, -1] = self.a, self.e + mass * self.mass, gain * self.b[:, 1]
        # z_j = d_j i + sum_k n_kj y_k + z_(j+1)' with z_0 = 0 is the law, i being the current and -y_k the errors.
        for j in range(order + 1):
            row = n + j
            a[row, -1] = denominator[j] if j < len(denominator) else 0.0
            for numerator, seen in zip(numerators, self.seen, strict=True):
                a[row, :n] += (numerator[j] if j < len(numerator) else 0.0) * seen
            if j:
                a[row, n + j - 1] = -1.0
            if j < order:
                e[row, n + j] = -1.0
        return a, e

    def poles(self, mass: float, gain: float) -> np.ndarray:
        """Of the closed loop, finite ones."""
        a, e = self.pencil(mass, gain)
        e = e / UNIT_OF_TIME
        for _ in range(3):  # rows, columns
            rows = np.maximum(abs(a).max(1), abs(e).max(1))
            a, e = a / rows[:, None], e / rows[:, None]
            columns = np.maximum(abs(a).max(0), abs(e).max(0))
            a, e = a / columns, e / columns
        if np.linalg.cond(e) < 1e12:
            found = np.linalg.eigvals(matrix_balance(np.linalg.solve(e, a))[0])
        else:
            above, below = eig(a, e, right=False, homogeneous_eigvals=True)
            finite = abs(below) * FAR * UNIT_OF_TIME > abs(above)
            found = above[finite] / below[finite]
        return found / UNIT_OF_TIME

    def responses(self, mass: float, gain: float, w: np.ndarray) -> dict[str, np.ndarray]:
        """Magnitudes of what claims bound, at frequencies in rad/s."""
        s = 1j * w[:, None, None]
        plant = s * (self.e + mass * self.mass) - self.a
        scale = abs(plant).max(2, keepdims=True)
        moved = np.linalg.solve(plant / scale, np.broadcast_to(self.b, (len(w), *self.b.shape)) / scale)
        numerators, denominator = self.law
        laws = np.array([P.polyval(1j * w, row) / P.polyval(1j * w, denominator) for row in numerators])
        seen = np.einsum("kj,wju->kwu", self.seen, moved)
        looped = gain * (laws * seen[:, :, 1]).sum(0)
        current = -(laws * seen[:, :, 0]).sum(0) / (1 + looped)  # by a disturbance
        tip = moved[:, :, 0] @ self.tip + gain * current * (moved[:, :, 1] @ self.tip)
        return {
            "compliance": abs(tip),
            "peak_compliance": abs(tip),
            "peak_sensitivity": abs(1 / (1 + looped)),
            "loop_gain": abs(looped),
            "controller_effort": abs(laws[0] / (1 + looped)),
            "looped": looped,
            "own": gain * laws[0] * seen[0, :, 1],
            "law": laws[0],
            "seen": gain * seen[0, :, 1],
        }

    def strayed(self, mass: float, place: str) -> float | None:
        """Integral of the absolute impulse response of the tip to an error at a place, at a gain of one.

        None where it is not known: volts behind which there are filters.
        """
        a, e = self.pencil(mass, 1.0)
        n, drive = len(self.a), np.zeros(len(a))
        if place == "volts":
            if self.filtered:
                return None
            drive[n:] = [self.law[0][0][j] if j < len(self.law[0][0]) else 0.0 for j in range(len(a) - n)]
        else:
            drive[:n] = {"current": self.b[:, 1], "flow": self.flow, "stroke": self.pull, "nut": self.pull}[place]
        poles, weights = self.poles(mass, 1.0), []
        for pole in poles:
            pencil = pole * e - a
            rows = abs(pencil).max(1)
            columns = abs(pencil / rows[:, None]).max(0)
            left, _, right = np.linalg.svd(pencil / rows[:, None] / columns)
            u, v = left[:, -1].conj() / rows, right[-1].conj() / columns
            weights.append((self.tip @ v[:n]) * (u @ drive) / (u @ e @ v))
        slowest = abs(poles.real).min()
        time = np.unique(np.concatenate([np.linspace(0, 0.2, 10001), np.linspace(0.2, 20 / slowest + 0.2, 30001)]))
        response = abs((np.exp(np.multiply.outer(time, poles)) @ np.array(weights)).real)
        return float(np.trapezoid(response, time))


def members(table: Mapping[str, Any]) -> list[Member]:
    """The loops of every combination of the ends of all spans."""
    effects = table.get("effect", [])
    law = table["controller"]["law"]
    laws = [numbers(row) for row in law["numerators"]], numbers(law["denominator"])
    if law["sensors"][0] != SENSORS[0] or len(set(law["sensors"])) != len(law["sensors"]) != len(laws[0]):
        raise ValueError("not as many numerators as sensors")
    spans = {(k, name): span for k, effect in enumerate(effects) for name, span in effect.get("span", {}).items()}
    gains = [_pair(effect.get("gain", ["1", "1"])) for effect in effects]
    performing = [_pair(effect.get("performing_gain", effect.get("gain", ["1", "1"]))) for effect in effects]
    parts = [_pair(span.get("performing", span["ends"])) for span in spans.values()]
    ends = [_pair(span["ends"]) for span in spans.values()]
    for outer, inner in zip((*gains, *ends), (*performing, *parts), strict=True):
        if not outer[0] <= inner[0] <= inner[1] <= outer[1]:
            raise ValueError("to perform is more than it is to be stable for")
    gain, asked = (tuple(prod(pair[end] for pair in pairs) for end in (0, 1)) for pairs in (gains, performing))
    found = []
    for chosen in product(*(sorted(set(pair)) for pair in ends)):
        values: list[dict[str, float]] = [{} for _ in effects]
        for (k, name), value in zip(spans, chosen, strict=True):
            values[k][name] = value
        performs = all(low <= value <= high for value, (low, high) in zip(chosen, parts, strict=True))
        plant = _plant(table["rig"], [(e["elements"], own) for e, own in zip(effects, values, strict=True)])
        seen = np.array([plant["seen"][name] for name in law["sensors"]])
        matrices = (plant[key] for key in ("e", "mass", "a", "b", "tip"))
        errors = (plant[key] for key in ("flow", "pull", "filtered", "pilot", "fed"))
        found.append(Member(*matrices, seen, laws, gain, asked if performs else None, *errors))
    if not any(member.performing for member in found):
        raise ValueError("none is to perform")
    return found


def _pair(texts: Any) -> tuple[float, float]:
    low, high = numbers(texts)
    if low > high:
        raise ValueError("a range is turned")
    return low, high


def _value(text: str, values: Mapping[str, float]) -> float:
    """A sum of numbers and of numbers times spans."""
    terms = [term.partition("*") for term in text.split(" + ")]
    return sum(number(factor) * (values[name] if times else 1.0) for factor, times, name in terms)


def _plant(rig: Mapping[str, Any], effects: Sequence[tuple[Mapping[str, Any], Mapping[str, float]]]) -> dict[str, Any]:
    """Structure, oil, valve and sensors: matrices of first order, as `Member` has them."""
    figure = {name: number(value) for name, value in rig.items() if name != "kind"}
    points: dict[str, dict[str, float]] = {"tip": {"first": 1.0}, "rod": {"inner": 1.0}, "base": {}, "sensed": {}}
    screw = rig["kind"] == "ball_screw"
    points["slide"] = {"nut": 1.0} if screw else {"tip": 1.0, "rod": -1.0}
    network, filters, oil, spool, uneven = [], [], 1.0, 0.0, 0.0
    for elements, own in effects:
        for point, weights in elements.get("points", {}).items():
            for name, weight in weights.items():
                if name in points:
                    raise ValueError("a point is no coordinate")
                points[point][name] = points[point].get(name, 0.0) + _value(weight, own)
        for one in elements.get("impedance", []):
            motion = {name: _value(weight, own) for name, weight in one["motion"].items()}
            network.append((motion, [_value(part, own) for part in one["resists"]]))
        filters += [
            [list(P.polytrim([_value(c, own) for c in one[key]])) for key in ("numerator", "denominator")]
            for one in elements.get("volts", [])
        ]
        oil *= _value(elements.get("oil", "1"), own)
        spool += _value(elements.get("spool", "0"), own)
        uneven += _value(elements.get("asymmetry", "0"), own)
    for which, name in (("outer", "first"), ("inner", "inner")):
        stiffness, damping = (figure[f"{which}_{of}"] for of in ("stiffness_N_per_m", "damping_N_s_per_m"))
        network.append(({name: 1.0, "base": -1.0}, [stiffness, damping]))
        more = figure["inner_end_mass_kg"] if which == "inner" else 0.0
        network.append(({name: 1.0}, [0.0, 0.0, figure[f"{which}_mass_kg"] + more]))
    if screw:
        lead = figure["lead_m_per_rad"]
        turning = figure["rotor_friction_N_m_s_per_rad"] / lead**2, figure["rotor_inertia_kg_m2"] / lead**2
        axial = [figure["screw_stiffness_N_per_m"], figure["screw_damping_N_s_per_m"]]
        network += [({"nut": 1.0, "tip": -1.0, "rod": 1.0}, axial), ({"nut": 1.0}, [0.0, *turning])]
    if "filter_frequency_rad_per_s" in figure:
        rate = figure["filter_frequency_rad_per_s"]
        filters.append([[rate], [rate, 1.0]])
    names = dict.fromkeys(("first", "inner"))
    for weights in (*points.values(), *(motion for motion, _ in network)):
        names |= dict.fromkeys(name for name in weights if name not in points)
    for name, weight in points["tip"].items():
        points["sensed"][name] = points["sensed"].get(name, 0.0) + weight
    n, index = len(names), {name: k for k, name in enumerate(names)}

    def row(weights: Mapping[str, float]) -> np.ndarray:
        """A motion as weights of the coordinates."""
        found = np.zeros(n)
        for name, weight in weights.items():
            if name in points:
                found += weight * row(points[name])
            else:
                found[index[name]] += weight
        return found

    matrices = np.zeros((3, n, n))  # stiffness, damping, mass
    for motion, resists in network:
        moved = row(motion)
        matrices[: len(resists)] += np.multiply.outer(resists, np.outer(moved, moved))
    tip = row({"tip": 1.0})
    stroke = row({"slide": 1.0})
    leak, area = figure.get("leakage_m3_per_s_per_Pa", 0.0), figure.get("piston_area_m2", 1.0)
    # Two chambers only where the mean of their pressures shows: where they leak and their sides differ.
    sides = [] if screw else [1 + uneven, -(1 - uneven)] if uneven and leak else [1.0]
    lags = [len(below) - 1 for _, below in filters]
    first, valve = 2 * n, 2 * n + len(sides)
    size = valve + 2 - screw + sum(lags)
    e, a, b = np.eye(size), np.zeros((size, size)), np.zeros((size, 2))
    e[n : 2 * n, n : 2 * n] = matrices[2]
    a[:n, n : 2 * n], a[n : 2 * n, :n], a[n : 2 * n, n : 2 * n] = np.eye(n), -matrices[0], -matrices[1]
    b[n : 2 * n, 0] = tip
    for k, side in enumerate(sides):
        at, share = first + k, abs(side) / len(sides)
        a[n : 2 * n, at] = area * side * stroke
        e[at, at] = (area * side) ** 2 / (oil * figure["oil_stiffness_N_per_m"] * share)
        a[at, valve], a[at, at], a[at, n : 2 * n] = side, -len(sides) * leak, -area * side * stroke
    fed = np.zeros(size)
    if screw:  # the motor's current
        rate, nut = figure["current_loop_rad_per_s"], n + index["nut"]
        a[valve, valve], a[valve, nut] = -rate, -rate * figure["speed_feedback_A_s_per_rad"] / lead
        a[nut, valve], b[valve, 1] = figure["torque_constant_N_m_per_A"] / lead, rate
        fed[nut] = a[valve, nut] / rate
        pilot = rate, 0.0, 0.0
    else:
        natural = figure["valve_frequency_rad_per_s"]
        a[valve, valve + 1] = 1.0
        a[valve + 1, valve] = -(natural**2) * (1 + spool)
        a[valve + 1, valve + 1] = -2 * figure["valve_damping_ratio"] * natural
        b[valve + 1, 1] = natural**2 * figure["flow_gain_m3_per_s_per_A"]
        pilot = natural, figure["valve_damping_ratio"], spool
    volts = np.zeros(size)
    volts[:n] = figure["sensor_gain_V_per_m"] * row({"sensed": 1.0})
    at = valve + 2 - screw
    for (above, below), order in zip(filters, lags, strict=True):
        if len(above) > order + 1 or below[-1] == 0:
            raise ValueError("a filter that differentiates")
        straight = above[order] / below[order] if len(above) > order else 0.0
        shown = straight * volts
        for k in range(order):  # controllable companion form
            if k < order - 1:
                a[at + k, at + k + 1] = 1.0
            a[at + order - 1, at + k] = -below[k] / below[order]
            shown[at + k] += (above[k] if k < len(above) else 0.0) / below[order] - straight * below[k] / below[order]
        if order:
            a[at + order - 1] += volts
        volts, at = shown, at + order
    seen = {SENSORS[0]: volts, SENSORS[1]: np.zeros(size), SENSORS[2]: np.zeros(size)}
    seen[SENSORS[1]][index["inner"]] = 1.0
    seen[SENSORS[2]][first:valve] = np.sign(sides)
    loaded = np.zeros((size, size))
    loaded[n : 2 * n, n : 2 * n] = np.outer(tip, tip)
    whole = np.zeros(size)
    whole[:n] = tip
    flow, pull = np.zeros(size), np.zeros(size)
    flow[first:valve], pull[n : 2 * n] = sides, stroke
    errors = {"flow": flow, "pull": pull, "filtered": bool(filters), "pilot": pilot, "fed": fed}
    return {"e": e, "mass": loaded, "a": a, "b": b, "tip": whole, "seen": seen} | errors


def law_follows(table: Mapping[str, Any]) -> bool | None:
    """Whether the polynomials are those of the controller's figures."""
    law, kind = table["law"], table["kind"]
    stated = [*map(numbers, law["numerators"]), numbers(law["denominator"])]
    if kind == "observer":
        expected = _realised(table)
    elif kind in ("proportional", "lag", "structured"):
        above, below = [number(table["gain_A_per_V"])], [1.0]
        if kind != "proportional":
            above, below = (P.polymul(p, [1, 1 / (2 * pi * number(table[key]))])
                            for p, key in ((above, "zero_Hz"), (below, "pole_Hz")))  # fmt: skip
        for section in table.get("section", []):
            above, below = (P.polymul(p, _second(section, end)) for p, end in ((above, "zero"), (below, "pole")))
        expected = [above, below]
    else:
        return None
    if len(stated) != len(expected):
        return False
    off = 0.0
    for one, other in zip(stated, expected, strict=True):
        one, other = P.polytrim(one), P.polytrim(other)
        if len(one) != len(other):
            return False
        off = max(off, (abs(one - other) / np.where(other == 0, 1.0, abs(other))).max())
    tight, loose = (1e-7, 1e-5) if kind == "observer" else (1e-12, FOLLOWS)
    return True if off < tight else False if off > loose else None


def _second(section: Mapping[str, Any], end: str) -> list[float]:
    time = 1 / (2 * pi * number(section[f"{end}_Hz"]))
    return [1.0, 2 * number(section[f"{end}_damping_ratio"]) * time, time**2]


def _realised(table: Mapping[str, Any]) -> list[np.ndarray]:
    """Polynomials of c (sI - a)^-1 b + d: det(sI - a + b c) - det(sI - a) is the numerator without d."""
    a, b = (np.array([numbers(row) for row in table[key]]) for key in ("a", "b"))
    c, d = np.array(numbers(table["c"])), np.array(numbers(table["d"]))
    below = np.real(np.poly(a))[::-1]
    above = [np.real(np.poly(a - np.outer(b[:, k], c)))[::-1] - below + d[k] * below for k in range(len(d))]
    return [number(table["gain_A_per_V"]) * row for row in above] + [below]
