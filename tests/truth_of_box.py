"""Whether what a certificate over a box states is true: a model in floats that shares nothing with prover and checker.

Expressions are evaluated over many members at once, as arrays of coefficients; poles are eigenvalues of companion
matrices and, with a delay, the phase of p(jw) is followed (Mikhailov). The loop gain of the rig is solved for from the
impedances at complex frequencies, and has to be that of the expression.
"""

import math
import re
from fractions import Fraction
from typing import Any

import numpy as np
from truth_of_nonlinear import multiplier_at

CLOSE = 1e-6
_NUMBER = re.compile(r"-?[0-9]+(\.[0-9]+)?|-?[0-9]+/[0-9]*[1-9][0-9]*")
_MEMBERS, _LATE_MEMBERS, _STEPS = 150, 12, 6000


def true(table: dict[str, Any]) -> bool | None:
    """Whether everything that a certificate over a box states is true; None where it is too close to call."""
    ranges = {name: (number(low), number(high)) for name, (low, high) in table["range"].items()}
    member = {name: number(value) for name, value in table["member"].items()}
    if any(low > high for low, high in ranges.values()):
        raise ValueError("an empty range")
    if member.keys() != ranges.keys() or not all(low <= member[n] <= high for n, (low, high) in ranges.items()):
        return False
    rng = np.random.default_rng(0)
    shares = {name: np.concatenate([rng.integers(0, 2, _MEMBERS), rng.random(_MEMBERS)]) for name in ranges}
    points = {n: low + (high - low) * shares[n] for n, (low, high) in ranges.items()}
    at_member = {name: np.array([value]) for name, value in member.items()}
    verdicts = [of_rig(table, ranges, points)] if table["kind"] == "beamdesign.box" else [True]
    if verdicts[0] is not False:
        degree = len(coefficients(table, points)[0])
        verdicts.append(as_stated(stable(table, at_member, degree), table["stable"]))
        if table["stable"]:
            verdicts += [
                stable(table, points, degree),
                *(claimed(table, claim, ranges, points, shares) for claim in table.get("claim", [])),
            ]
    return False if False in verdicts else None if None in verdicts else True


def number(text: str) -> float:
    """A decimal or a quotient."""
    if not isinstance(text, str) or not _NUMBER.fullmatch(text):
        raise ValueError(f"not a number: {text!r}")
    return float(Fraction(text))


def as_stated(found: bool | None, stated: bool) -> bool | None:
    """Whether a verdict is what is stated."""
    return None if found is None else found is stated


class Poly:
    """Polynomials in s of many members: coefficients (degree + 1, members)."""

    def __init__(self, values: np.ndarray) -> None:
        self.values = values

    def __add__(self, other: "Poly | np.ndarray | int") -> "Poly":
        a, b = self.values, _poly(other).values
        total = np.zeros((max(len(a), len(b)), max(a.shape[1], b.shape[1])))
        total[: len(a)] += a
        total[: len(b)] += b
        return Poly(total)

    def __mul__(self, other: "Poly | np.ndarray | int") -> "Poly":
        a, b = self.values, _poly(other).values
        total = np.zeros((len(a) + len(b) - 1, max(a.shape[1], b.shape[1])))
        for k, row in enumerate(b):
            total[k : k + len(a)] += a * row
        return Poly(total)

    def __sub__(self, other: "Poly | np.ndarray | int") -> "Poly":
        return self + _poly(other) * -1

    def __rsub__(self, other: "Poly | np.ndarray | int") -> "Poly":
        return self * -1 + other

    def __neg__(self) -> "Poly":
        return self * -1

    def __truediv__(self, other: "Poly | np.ndarray | int") -> "Poly":
        below = _poly(other)
        if len(below.values) > 1:
            raise ValueError("divided by s")
        return Poly(self.values / below.values)

    def __rtruediv__(self, other: "Poly | np.ndarray | int") -> "Poly":
        return _poly(other) / self

    def __pow__(self, power: int) -> "Poly":
        total = _poly(1)
        for _ in range(power):
            total = total * self
        return total

    __radd__, __rmul__ = __add__, __mul__


def _poly(value: "Poly | np.ndarray | float") -> Poly:
    return value if isinstance(value, Poly) else Poly(np.atleast_2d(np.asarray(value, dtype=float)))


def coefficients(table: dict[str, Any], points: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Of the plain and of the late part of p, each (degree + 1, members)."""
    names = _grouped(table, {name: _poly(values) for name, values in points.items()})
    s = Poly(np.array([[0.0], [1.0]]))
    if "leaf" in table:
        own = {key: _poly(_value(text, names | {"s": s})) for key, text in table["leaf"].items()} | {"s": s}
    else:
        own = names | {"s": s}
    late = dict.fromkeys(table.get("delay", {}), 0)
    plain = _poly(_value(table["p"], own | late)) + 0 * s
    whole = _poly(_value(table["p"], own | dict.fromkeys(late, 1))) + 0 * s
    many = len(next(iter(points.values()))) if points else 1
    parts = (plain, whole - plain) if late else (plain, 0 * plain)
    return tuple(np.broadcast_to(part.values, (len(part.values), many)) for part in parts)


def _grouped(table: dict[str, Any], names: dict[str, Any]) -> dict[str, Any]:
    """Variables by name: parameters, and in the place of those of a group their sum or product."""
    for group in table.get("group", []):
        members = [names.pop(one) for one in group["members"]]
        total = members[0]
        for one in members[1:]:
            total = total + one if group["kind"] == "sum" else total * one
        names[group["name"]] = total
    return names


def _value(text: str, names: dict[str, Any]) -> Any:
    return eval(text.strip(), {"__builtins__": {}}, names)


def delay(table: dict[str, Any], points: dict[str, np.ndarray]) -> np.ndarray:
    """Of each member, s."""
    many = len(next(iter(points.values()))) if points else 1
    names = _grouped(table, dict(points))
    found = [names[name] for name in table.get("delay", {}).values()]
    return found[0] if found else np.zeros(many)


def stable(table: dict[str, Any], points: dict[str, np.ndarray], terms: int) -> bool | None:
    """Whether all members are stable, with as many coefficients as there are; None where that is too close to call."""
    plain, late = coefficients(table, points)
    waits = delay(table, points)
    without = waits == 0
    verdicts = []
    whole = plain + np.pad(late, ((0, len(plain) - len(late)), (0, 0)))
    if without.any() or not late.any():
        verdicts.append(_all_left(whole[:, without] if late.any() else whole))
    if late.any() and not without.all():
        verdicts.append(_by_phase(plain[:, ~without], late[:, ~without], waits[~without]))
    return False if False in verdicts else None if None in verdicts else True


def _all_left(whole: np.ndarray) -> bool | None:
    while len(whole) > 1 and not whole[-1].any():
        whole = whole[:-1]
    lead, n = whole[-1], len(whole) - 1
    # Scaled so that the geometric mean of the roots is one, as far as it goes.
    with np.errstate(all="ignore"):
        unit = np.abs(whole[0] / lead) ** (1 / max(n, 1))
    unit = np.where(np.isfinite(unit) & (unit > 0), unit, 1.0)
    scaled = whole * unit ** np.arange(n + 1)[:, None]
    size = np.abs(scaled).max(axis=0)
    if np.any(np.abs(scaled[-1]) < CLOSE * 1e-6 * size):
        return None if not np.any(lead == 0) else False
    companion = np.zeros((whole.shape[1], n, n))
    companion[:, np.arange(1, n), np.arange(n - 1)] = 1.0
    companion[:, :, -1] = (-scaled[:-1] / scaled[-1]).T
    roots = np.linalg.eigvals(companion)
    worst = (roots.real / np.maximum(np.abs(roots), 1e-12)).max()
    return None if abs(worst) < CLOSE else bool(worst < 0)


def _by_phase(plain: np.ndarray, late: np.ndarray, waits: np.ndarray) -> bool | None:
    """Stable members turn by pi / 2 times their degree, from no frequency to where the leading term is all."""
    verdicts = []
    for k in range(min(_LATE_MEMBERS, len(waits))):
        n = len(plain) - 1
        sizes = np.abs(plain[:, k]) + np.pad(np.abs(late[:, k]), (0, n + 1 - len(late)))
        reach = 1e4 * max((sizes[i] / sizes[n]) ** (1 / (n - i)) for i in range(n))
        w = np.concatenate([[0.0], np.geomspace(1e-9 * reach, reach, _STEPS)])
        s = 1j * w
        p = np.polyval(plain[::-1, k], s) + np.polyval(late[::-1, k], s) * np.exp(-s * waits[k])
        turns = np.angle(p[1:] / p[:-1])
        missing = n / 2 - turns.sum() / math.pi
        sure = np.abs(turns).max() < 2.0 and abs(missing - round(missing)) < 0.05
        verdicts.append(round(missing) == 0 if sure else None)
    return False if False in verdicts else None if None in verdicts else True


def claimed(
    table: dict[str, Any],
    claim: dict[str, Any],
    ranges: dict[str, tuple[float, float]],
    points: dict[str, np.ndarray],
    shares: dict[str, np.ndarray],
) -> bool | None:
    """Whether a claim is so of every member: of the payloads that it states, else those of the box."""
    own = {name: (number(low), number(high)) for name, (low, high) in claim.get("range", {}).items()}
    strayed = claim["kind"] == "deviation"
    asked = {name: pair for name, pair in own.items() if strayed or name == "outer_end_mass"}
    if any(not ranges[name][0] <= low <= high <= ranges[name][1] for name, (low, high) in asked.items()):
        return False
    if claim["kind"] == "gain_margin":
        least, (low, high) = number(claim["limit"]), ranges["controller_gain"]
        if not 0 <= least <= 1:
            return False
        asked["controller_gain"] = (least * low, high)
        if {name for name in own if own[name] != ranges[name]} - {*asked}:
            return False
    at = points | {name: low + (high - low) * shares[name] for name, (low, high) in asked.items()}
    if claim["kind"] == "gain_margin":
        return stable(table, at, len(coefficients(table, points)[0]))
    return strays(table, claim, at) if strayed else keeps(table, claim, at)


def strays(table: dict[str, Any], claim: dict[str, Any], points: dict[str, np.ndarray]) -> bool | None:
    """Whether the absolute impulse responses of some members, by a fast Fourier transform, are within a bound.

    Of errors in the current or in the volts without filters; of others it says nothing.
    """
    own, size, bound = figures(table), number(claim["size"]), number(claim["limit"])
    if claim["place"] not in ("current", "volts") or "filter_frequency" in own or size < 0:
        return None
    w, worst = np.arange(3000) * 1.5, 0.0
    for k in range(_STRAYED_MEMBERS):
        at = own | {name: float(values[k]) for name, values in points.items()}
        gain, _, law = _loop(table, at, 1j * np.append(1e-3, w[1:]))
        response = gain / (1 + gain) / at["sensor_gain"]
        if claim["place"] == "current":
            response = response / law
        worst = max(worst, abs(np.fft.irfft(response)).sum())  # what is added up and the step in time cancel
    return False if bound < 0.97 * size * worst else True if bound > 1.03 * size * worst else None


def keeps(table: dict[str, Any], claim: dict[str, Any], points: dict[str, np.ndarray]) -> bool | None:
    """Whether what is claimed of every member is so of some, by the rig's impedances; None where it is close."""
    limit, kind = number(claim["limit"]), claim["kind"]
    most = number(claim["bandwidth_Hz"]) if kind == "compliance" and "bandwidth_Hz" in claim else 1e4
    if not limit > 0 or not most > 0:
        raise ValueError("a limit or a bandwidth that is not positive")
    since = number(claim["from_Hz"]) if kind == "loop_gain" else 0.0
    own = figures(table)
    if kind == "slope":
        return rests(table, claim, [own | {n: float(v[k]) for n, v in points.items()} for k in range(_CLAIMED_MEMBERS)])
    worst = 0.0
    for k in range(_CLAIMED_MEMBERS):
        at = own | {name: float(values[k]) for name, values in points.items()}
        w = 2 * math.pi * np.append(np.geomspace(max(since, 0.05), most, _CLAIMED_FREQUENCIES)[:-1], most)
        gain, moved, law = _loop(table, at, 1j * w)
        size = {
            "peak_sensitivity": 1 / (1 + gain),
            "compliance": moved,
            "peak_compliance": moved,
            "loop_gain": gain,
            "controller_effort": law / (1 + gain),
        }
        worst = max(worst, float(abs(size[kind]).max()))
    return None if abs(worst / limit - 1) < CLOSE else worst < limit


def rests(table: dict[str, Any], claim: dict[str, Any], members: list[dict[str, float]]) -> bool | None:
    """Whether Zames and Falb's multiplier that is stated fits some members, at many frequencies."""
    w = 2 * math.pi * np.geomspace(0.01, 1e5, 400)
    multiplier, norm, _ = multiplier_at(claim, w)
    if number(claim["limit"]) != 1 or norm >= 1 or claim["popov_s"] != "0":
        return False
    least = 1.0
    for at in members:
        z = multiplier * (1 + _loop(table, at, 1j * w)[0])
        least = min(least, float((z.real / abs(z)).min()))
    return None if abs(least) < 1e-4 else least > 0


# The rig.

_CLAIMED_MEMBERS, _CLAIMED_FREQUENCIES, _STRAYED_MEMBERS = 12, 40, 3
_FIGURES = {
    "outer_stiffness": "N_per_m", "outer_mass": "kg", "outer_damping": "N_s_per_m", "inner_stiffness": "N_per_m",
    "inner_mass": "kg", "inner_damping": "N_s_per_m", "oil_stiffness": "N_per_m", "piston_area": "m2",
    "screw_stiffness": "N_per_m", "screw_damping": "N_s_per_m", "lead": "m_per_rad", "torque_constant": "N_m_per_A",
    "rotor_inertia": "kg_m2", "rotor_friction": "N_m_s_per_rad", "speed_feedback": "A_s_per_rad",
    "current_loop": "rad_per_s", "flow_gain": "m3_per_s_per_A", "leakage": "m3_per_s_per_Pa",
    "valve_frequency": "rad_per_s",
    "valve_damping_ratio": "", "sensor_gain": "V_per_m", "filter_frequency": "rad_per_s", "inner_end_mass": "kg",
}  # fmt: skip


def figures(table: dict[str, Any]) -> dict[str, float]:
    """The rig's own, by the names of ranges."""
    rig, law = table["rig"], table["controller"]["law"]
    own = {n: number(rig[key]) for n, unit in _FIGURES.items() if (key := f"{n}_{unit}".rstrip("_")) in rig}
    own["controller_gain"] = number(table["controller"]["gain_A_per_V"])
    above, below = ([number(c) for c in row] for row in (law["numerators"][0], law["denominator"]))
    if len(above) == len(below) == 2:
        own |= {"controller_zero": above[0] / above[1], "controller_pole": below[0] / below[1]}
    return own


def of_rig(table: dict[str, Any], ranges: dict[str, tuple[float, float]], points: dict[str, np.ndarray]) -> bool | None:
    """Whether the box is about the rig that is stated, and its expression that rig's loop."""
    rig, own = table["rig"], figures(table)
    for name in (name for name in ("valve_frequency", "filter_frequency", "current_loop") if name in own):
        if abs(2 * math.pi * number(rig[f"{name}_Hz"]) / own[name] - 1) > CLOSE:
            return False
    if any(not low * (1 - 1e-12) <= own[n] <= high * (1 + 1e-12) for n, (low, high) in ranges.items() if n in own):
        return False
    for k in (0, -1):
        at = own | {name: float(values[k]) for name, values in points.items()}
        plain, late = (part[:, 0] for part in coefficients(table, {n: v[[k]] for n, v in points.items()}))
        s = own.get("valve_frequency", 1000.0) * np.exp(1j * np.linspace(0.1, 3.0, 12)) * np.geomspace(0.05, 3.0, 12)
        gain, _, _ = _loop(table, at, s)
        if "controller_zero" not in own or "controller_zero" not in ranges:
            gain = gain * at["controller_gain"] / own["controller_gain"]
        stated = np.polyval(late[::-1], s) / np.polyval(plain[::-1], s)
        off = (np.abs(stated - gain) / np.maximum(np.maximum(np.abs(stated), np.abs(gain)), 1e-200)).max()
        if not off < CLOSE:
            return False if off > 10 * CLOSE or not np.isfinite(off) else None
    return True


def _loop(table: dict[str, Any], at: dict[str, float], s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Loop gain without the delay, closed-loop compliance of the tip, and controller at complex s (N,): impedances."""
    law = table["controller"]["law"]
    numerators = {
        name: np.polyval([number(c) for c in row[::-1]], s)
        for name, row in zip(law["sensors"], law["numerators"], strict=True)
    }
    below = np.polyval([number(c) for c in law["denominator"][::-1]], s)
    if "controller_zero" in table["range"]:
        zero, pole = at["controller_zero"], at["controller_pole"]
        numerators = {"displacement_m": at["controller_gain"] * (1 + s / zero)}
        below = 1 + s / pole
    moves, oil, spool, uneven, filtered = [], 1.0, 0.0, 0.0, np.ones_like(s)
    points: dict[str, dict[str, float]] = {"tip": {"first": 1.0}, "rod": {"inner": 1.0}, "base": {}, "sensed": {}}
    for effect in table.get("effect", []):
        stated = {name: number(one["ends"][0]) for name, one in effect.get("span", {}).items()}
        spans = at | {name: at.get(f"{effect['name']}_{name}", value) for name, value in stated.items()}
        made = effect["elements"]

        def entry(text: str, spans: dict[str, float] = spans) -> float:
            parts = (part.partition("*") for part in text.split(" + "))
            return sum(number(c) * (spans[name] if name else 1.0) for c, _, name in parts)

        oil *= entry(made.get("oil", "1"))
        spool += entry(made.get("spool", "0"))
        uneven += entry(made.get("asymmetry", "0"))
        for point, weights in made.get("points", {}).items():
            for name, weight in weights.items():
                points[point][name] = points[point].get(name, 0.0) + entry(weight)
        for one in made.get("impedance", []):
            resists = sum(entry(c) * s**k for k, c in enumerate(one["resists"]))
            moves.append(({name: entry(weight) for name, weight in one["motion"].items()}, resists))
        for one in made.get("volts", []):
            top, bottom = (sum(entry(c) * s**k for k, c in enumerate(one[e])) for e in ("numerator", "denominator"))
            filtered = filtered * top / bottom
    sensed = dict(points["tip"])
    for name, weight in points.pop("sensed").items():
        sensed[name] = sensed.get(name, 0.0) + weight

    if "lead" in at:
        points["slide"] = {"nut": 1.0}
    else:
        points["slide"] = dict(points["tip"])
        for name, weight in points["rod"].items():
            points["slide"][name] = points["slide"].get(name, 0.0) - weight

    def spread(motion: dict[str, float]) -> dict[str, float]:
        total: dict[str, float] = {}
        for name, weight in motion.items():
            for coordinate, share in points.get(name, {name: 1.0}).items():
                total[coordinate] = total.get(coordinate, 0.0) + weight * share
        return total

    outer = at["outer_stiffness"] + at["outer_damping"] * s
    inner = at["inner_stiffness"] + at["inner_damping"] * s
    moves += [
        ({"first": 1.0, "base": -1.0}, outer),
        ({"inner": 1.0, "base": -1.0}, inner),
        ({"first": 1.0}, at["outer_mass"] * s * s),
        ({"inner": 1.0}, (at["inner_mass"] + at["inner_end_mass"]) * s * s),
        ({"tip": 1.0}, at["outer_end_mass"] * s * s),
    ]
    if "lead" in at:
        lag = at["current_loop"] / (at["current_loop"] + s)
        held = at["torque_constant"] * at["speed_feedback"] * lag
        turning = (at["rotor_inertia"] * s + at["rotor_friction"] + held) * s / at["lead"] ** 2
        axial = at["screw_stiffness"] + at["screw_damping"] * s
        moves += [({"nut": 1.0, "tip": -1.0, "rod": 1.0}, axial), ({"nut": 1.0}, turning)]
    moved = [(spread(motion), resists) for motion, resists in moves]
    names = list(dict.fromkeys(["first", "inner", *(name for motion, _ in moved for name in motion)]))
    stiffness = np.zeros((len(s), len(names), len(names)), dtype=complex)
    for motion, resists in moved:
        arm = np.array([motion.get(name, 0.0) for name in names])
        stiffness += np.multiply.outer(resists * np.ones_like(s), np.outer(arm, arm))
    stroke = spread({"tip": 1.0, "rod": -1.0})
    arm = np.array([stroke.get(name, 0.0) for name in names])
    # Chambers of areas A (1 +- a): flow q (1 +- ...) is unit on either; their pressures push apart along the stroke.
    sides = [1 + uneven, 1 - uneven] if uneven != 0 and at["leakage"] != 0 else [1.0]
    sides = [] if "lead" in at else sides
    area, count = at.get("piston_area", 1.0), len(sides)
    force = np.zeros((len(s), len(names)), dtype=complex)
    give = []
    for side in sides:
        compliance = count * at["leakage"] / (area * side) ** 2 + s * count / (oil * at["oil_stiffness"] * side)
        stiffness += np.multiply.outer(s / compliance, np.outer(arm, arm))
        force += np.outer(1 / compliance, arm / area)
        give.append((side, compliance))
    tip = np.array([spread({"tip": 1.0}).get(name, 0.0) for name in names])
    if "lead" in at:
        drive, force = at["torque_constant"] * lag / at["lead"], force + [name == "nut" for name in names]
    else:
        valve = at["valve_frequency"]
        spool_lag = valve**2 * (1 + spool) + 2 * at["valve_damping_ratio"] * valve * s + s * s
        drive = at["flow_gain"] * valve**2 / spool_lag
    if "filter_frequency" in at:
        filtered = filtered * at["filter_frequency"] / (s + at["filter_frequency"])
    volts = {"displacement_m": at["sensor_gain"] * filtered}

    def back(x: np.ndarray, flow: float) -> np.ndarray:
        """What comes back to the valve of a motion under a unit of flow, or under none."""
        pushed = sum((flow / area - s * (x @ arm)) / compliance / (area * side) for side, compliance in give)
        sees = {
            "displacement_m": sum(weight * x[:, names.index(name)] for name, weight in sensed.items()),
            "inner_displacement_m": x[:, names.index("inner")],
            "load_pressure_Pa": pushed,
        }
        read = sum(top / below * volts.get(name, 1.0) * sees[name] for name, top in numerators.items())
        return np.asarray(at.get("effect_gain", 1.0) * drive * read)

    by_flow, by_force = np.moveaxis(np.linalg.solve(stiffness, np.stack([force, force * 0 + tip], axis=-1)), -1, 0)
    gain = back(by_flow, 1.0)
    return gain, by_force @ tip - by_flow @ tip * back(by_force, 0.0) / (1 + gain), numerators["displacement_m"] / below
