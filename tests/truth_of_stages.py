"""Whether what a certificate of changing payloads and stages states is true: a model in floats on grids of masses.

Its matrices are those of the block diagram of Zalucky and Hardt (1984); Lyapunov functions are tried at a few masses,
cycles by the spectral radius, all with a bound on the rounding: what lies within it is too close to call.
"""

from collections.abc import Iterator
from fractions import Fraction
from math import log, pi
from typing import Any

import numpy as np

Verdict = bool | None
GRID = 9
"""Masses of a range at which it is looked."""
CLOSE = 1e-6
"""Relative difference that is too small to call."""
SENSED = ("displacement_m", "inner_displacement_m", "load_pressure_Pa")
AT = np.geomspace(1e-2, 1e6, 41)
"""Real s, rad/s, at which stable polynomials cancel nothing."""


def true(table: dict[str, Any]) -> Verdict:
    """Whether every statement of a certificate is true; None where one is too close to call and none is false.

    Raises:
        ArithmeticError, LookupError, TypeError, ValueError: for a table that is not of the format.
    """
    with np.errstate(all="ignore"):
        found = list(statements(table))
    return False if any(one is False for one in found) else None if any(one is None for one in found) else True


def statements(table: dict[str, Any]) -> Iterator[Verdict]:
    """Each statement in turn."""
    low, high = pair(table["outer_end_mass_kg"])
    rig = {key: number(value) for key, value in table["rig"].items() if key != "kind"}
    if "effect" in table or not 0 <= low < high or min(rig.values()) < 0:
        raise ValueError("not a rig, or not a range")
    yield from (turns(rig, name) for name in ("valve_frequency", "filter_frequency") if f"{name}_Hz" in rig)
    controller = table["controller"]
    laws = controller.get("stage") or [controller]
    if "stage" in controller:
        for part in [*laws, *(section for stage in laws for section in stage.get("section", []))]:
            figures = {key: number(value) for key, value in part.items() if key.startswith(("pole", "zero"))}
            yield from (turns(figures, name) for name in ("pole", "zero"))
        loops = [Loop(rig, *staged(rig, stage)) for stage in laws]
    else:
        yield follows(controller)
        loops = [Loop(rig, *observed(rig, controller["law"]))]
    claims, against = table.get("claim", []), table.get("counterexample", [])
    yield bool(claims or against)
    for claim in claims:
        least, most = pair(claim["outer_end_mass_kg"])
        if not low <= least < most <= high:
            raise ValueError("the range of a claim")
        yield CLAIMS[claim["kind"]](loops, claim, np.linspace(least, most, GRID))
    for example in against:
        yield grows(loops, example, (low, high))


def number(text: str) -> float:
    return float(Fraction(text))


def pair(texts: list[str]) -> tuple[float, float]:
    low, high = map(number, texts)
    return low, high


def close(one: Any, two: Any, within: float = CLOSE) -> Verdict:
    """Whether numbers are one but for rounding; None where they are nearly."""
    difference = float(np.max(np.abs(np.asarray(one) / np.asarray(two) - 1)))
    return True if difference < within * 1e-3 else False if difference > within else None


def positive(value: float, rounding: float) -> Verdict:
    """The sign of what is known but for a rounding."""
    return True if value > rounding else False if value < -rounding else None


def turns(figures: dict[str, float], name: str) -> Verdict:
    return close(2 * pi * figures[f"{name}_Hz"], figures[f"{name}_rad_per_s"], 1e-11)


def polynomial(coefficients: list[str], s: np.ndarray) -> np.ndarray:
    return np.polynomial.polynomial.polyval(s, [number(c) for c in coefficients])


def follows(controller: dict[str, Any]) -> Verdict:
    """Whether the polynomials are those of the figures, at real frequencies."""
    if controller["kind"] not in ("proportional", "lag", "structured", "observer"):
        return True  # of another kind nothing is stated
    law, gain = controller["law"], number(controller["gain_A_per_V"])
    below = polynomial(law["denominator"], AT)
    if controller.get("sensors", [SENSED[0]]) != law["sensors"]:
        raise ValueError("other sensors")
    if controller["kind"] == "observer":
        a, b = (np.array([[number(x) for x in row] for row in controller[key]]) for key in "ab")
        c, d = (np.array([number(x) for x in controller[key]]) for key in "cd")
        inside = [c @ np.linalg.solve(s * np.eye(len(a)) - a, b) + d if len(a) else d for s in AT]
        ratios = [polynomial(numerator, AT) / below for numerator in law["numerators"]]
        scale = np.abs(np.array(inside)).max(axis=0)
        expected = (gain * np.array(inside) / scale).T
        size = np.linalg.norm(expected - np.array(ratios) / scale[:, None], axis=1) / np.linalg.norm(expected, axis=1)
        poles = [np.linalg.det(s * np.eye(len(a)) - a) if len(a) else 1.0 for s in AT]
        return both(positive(CLOSE - float(np.max(size)), 0), close(poles, below))
    above, under = np.full(AT.shape, gain), np.ones(AT.shape)
    if controller["kind"] != "proportional":
        figures = {key: number(controller[key]) for key in ("zero_Hz", "pole_Hz")}
        above, under = (
            above * (1 + AT / (2 * pi * figures["zero_Hz"])),
            under * (1 + AT / (2 * pi * figures["pole_Hz"])),
        )
        for section in controller.get("section", []):
            zero, damped, pole, own = (
                number(section[f"{end}_{of}"]) for end in ("zero", "pole") for of in ("Hz", "damping_ratio")
            )
            up, down = AT / (2 * pi * zero), AT / (2 * pi * pole)
            above, under = above * (1 + 2 * damped * up + up**2), under * (1 + 2 * own * down + down**2)
    return both(close(polynomial(law["numerators"][0], AT), above), close(below, under))


def both(*verdicts: Verdict) -> Verdict:
    return False if False in verdicts else None if None in verdicts else True


# The loop: states tip, its velocity, cylinder, inner tip, its velocity, flow, its rate, filter, law.


class Loop:
    """dx/dt = A(m) x of the rig with a law z' = a z + b x, current = c z + d x."""

    def __init__(self, rig: dict[str, float], a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> None:
        self.bare, free = rig["outer_mass_kg"], plant(rig)
        n, k = len(free), len(a)
        self.fixed = np.block([[free, np.zeros((n, k))], [b, a]])
        drive = rig["valve_frequency_rad_per_s"] ** 2 * rig["flow_gain_m3_per_s_per_A"]
        self.fixed[6] += drive * np.concatenate([d, c])

    def at(self, mass: float) -> np.ndarray:
        a = self.fixed.copy()
        a[1] /= self.bare + mass
        return a


def plant(rig: dict[str, float]) -> np.ndarray:
    """The rig alone; the forces on the outer tip are not divided by its mass."""
    filtered = rig.get("filter_frequency_rad_per_s")
    a = np.zeros((8 if filtered is not None else 7,) * 2)
    oil, area, w = rig["oil_stiffness_N_per_m"], rig["piston_area_m2"], rig["valve_frequency_rad_per_s"]
    squeeze = np.zeros(len(a))
    squeeze[[2, 0]] = oil, -oil  # the force of the oil on the tip
    a[0, 1] = a[3, 4] = a[5, 6] = a[2, 4] = 1
    a[1] = squeeze
    a[1, [0, 1]] -= rig["outer_stiffness_N_per_m"], rig["outer_damping_N_s_per_m"]
    a[2] -= rig["leakage_m3_per_s_per_Pa"] / area**2 * squeeze
    a[2, 5] = 1 / area
    a[4] = -squeeze
    a[4, [3, 4]] -= rig["inner_stiffness_N_per_m"], rig["inner_damping_N_s_per_m"]
    a[4] /= rig["inner_mass_kg"] + rig["inner_end_mass_kg"]
    a[6, [5, 6]] = -w * w, -2 * rig["valve_damping_ratio"] * w
    if filtered is not None:
        a[7, [0, 7]] = filtered * rig["sensor_gain_V_per_m"], -filtered
    return a


def seen(rig: dict[str, float]) -> np.ndarray:
    """What each sensor reads of the states of the rig, as rows."""
    rows = np.zeros((3, len(plant(rig))))
    if "filter_frequency_rad_per_s" in rig:
        rows[0, 7] = 1
    else:
        rows[0, 0] = rig["sensor_gain_V_per_m"]
    rows[1, 3] = 1
    rows[2, [2, 0]] = np.array([1, -1]) * rig["oil_stiffness_N_per_m"] / rig["piston_area_m2"]
    return rows


def observed(rig: dict[str, float], law: dict[str, Any]) -> tuple[np.ndarray, ...]:
    """A law in observer form, its remainders taken in rationals."""
    below = [Fraction(c) for c in law["denominator"]]
    while below[-1] == 0:
        below.pop()
    k = len(below) - 1
    a = np.diag(np.ones(max(k - 1, 0)), -1)[:k, :k]
    if k:
        a[:, -1] = [-float(c / below[-1]) for c in below[:-1]]
    d, b = np.zeros(len(plant(rig))), np.zeros((k, len(plant(rig))))
    for sensor, texts in zip(law["sensors"], law["numerators"], strict=True):
        above = [Fraction(c) for c in texts] + [Fraction(0)] * (k + 1 - len(texts))
        if any(above[k + 1 :]):
            raise ValueError("the law differentiates")
        row, through = seen(rig)[SENSED.index(sensor)], above[k] / below[-1]
        d -= float(through) * row
        b -= np.outer([float((above[i] - through * below[i]) / below[-1]) for i in range(k)], row)
    return a, b, np.eye(k)[-1] if k else np.zeros(0), d


def staged(rig: dict[str, float], stage: dict[str, Any]) -> tuple[np.ndarray, ...]:
    """A stage: output and rate of each section, then the current, all of them driven by derivatives of the volts."""
    free, sections = plant(rig), stage.get("section", [])
    n, k = len(free), 2 * len(sections) + 1
    whole = np.vstack([np.hstack([free, np.zeros((n, k))]), np.zeros((k, n + k))])
    signal = np.concatenate([-seen(rig)[0], np.zeros(k)])
    slope = signal @ whole
    bend = slope @ whole
    if sections and slope[1] != 0:
        raise ValueError("sections that feel the acceleration of the tip")
    for j, section in enumerate(sections):
        zero, pole = (number(section[f"{end}_rad_per_s"]) for end in ("zero", "pole"))
        damped, own = (number(section[f"{end}_damping_ratio"]) for end in ("zero", "pole"))
        out, rate = np.eye(n + k)[n + 2 * j], np.eye(n + k)[n + 2 * j + 1]
        whole[n + 2 * j] = rate
        whole[n + 2 * j + 1] = (
            pole**2 * (signal + 2 * damped / zero * slope + bend / zero**2 - out) - 2 * own * pole * rate
        )
        signal, slope, bend = out, rate, whole[n + 2 * j + 1].copy()
    zero, pole, gain = (number(stage[key]) for key in ("zero_rad_per_s", "pole_rad_per_s", "gain_A_per_V"))
    current = np.eye(n + k)[-1]
    whole[-1] = pole * (gain * (signal + slope / zero) - current)
    return whole[n:, n:], whole[n:, :n], np.eye(k)[-1], np.zeros(n)


# The claims.


class Function:
    """V = x' P(m) x."""

    def __init__(self, entries: list[list[list[str]]], order: int) -> None:
        self.coefficients = [np.zeros((order, order)) for _ in entries]
        for matrix, rows in zip(self.coefficients, entries, strict=True):
            if [len(row) for row in rows] != list(range(1, order + 1)):
                raise ValueError("not a lower triangle")
            for i, row in enumerate(rows):
                matrix[i, : i + 1] = matrix[: i + 1, i] = [number(x) for x in row]

    def at(self, mass: float) -> np.ndarray:
        return sum(c * mass**k for k, c in enumerate(self.coefficients)) + 0 * self.coefficients[0]

    def slope(self, mass: float) -> np.ndarray:
        return sum(k * c * mass ** (k - 1) for k, c in enumerate(self.coefficients) if k) + 0 * self.coefficients[0]

    def positive(self, masses: np.ndarray) -> Verdict:
        return both(*(definite(self.at(m), abs(self.at(m))) for m in masses))

    def falls(
        self, loop: Loop, masses: np.ndarray, decay: float = 0.0, rate: float = 0.0, resting: bool = False
    ) -> Verdict:
        def at(mass: float) -> Verdict:
            a, p, slope = loop.at(mass), self.at(mass), self.slope(mass)
            keep = np.zeros(len(p))
            keep[1] = resting * rate / (loop.bare + mass)
            rise = a.T @ p + p @ a + 2 * decay * p + rate * slope - keep[:, None] * p - p * keep
            size = abs(a.T) @ abs(p) + abs(p) @ abs(a) + 2 * decay * abs(p) + abs(rate * slope)
            return definite(-rise, size, np.diag(p))

        return both(*(at(mass) for mass in masses))


def definite(matrix: np.ndarray, size: np.ndarray, scale: np.ndarray | None = None) -> Verdict:
    """Whether a matrix is positive definite whose entries are sums of terms of some size, each rounded."""
    diagonal = np.diag(matrix) if scale is None else scale
    if np.min(diagonal) <= 0:
        return False if scale is None else None  # of P, which is looked at by itself
    by = 1 / np.sqrt(np.outer(diagonal, diagonal))
    rounding = 1e-14 * float(np.linalg.norm(size * by))
    return positive(float(np.linalg.eigvalsh(matrix * by)[0]), rounding)


def stage_change(loops: list[Loop], claim: dict[str, Any], masses: np.ndarray) -> Verdict:
    function = Function(claim["P"], len(loops[0].fixed))
    return both(function.positive(masses), *(function.falls(loop, masses) for loop in loops))


def any_change(loops: list[Loop], claim: dict[str, Any], masses: np.ndarray) -> Verdict:
    return False if len(claim["P"]) != 1 else stage_change(loops, claim, masses)


def payload_rate(loops: list[Loop], claim: dict[str, Any], masses: np.ndarray) -> Verdict:
    function, rate = Function(claim["P"], len(loops[0].fixed)), number(claim["rate_kg_per_s"])
    cases = [(rate, False), (-rate, False)] + [(rate, True)] * rests(claim)
    found = [function.falls(loop, masses, 0.0, *case) for loop in loops for case in cases]
    return both(rate > 0, function.positive(masses), *found)


def payload_jumps(loops: list[Loop], claim: dict[str, Any], masses: np.ndarray) -> Verdict:
    function, factor = Function(claim["P"], len(loops[0].fixed)), number(claim["factor"])
    least = (loops[0].bare + masses[0]) / (loops[0].bare + masses[-1]) if rests(claim) else 1.0
    found = [enough(claim), function.positive(masses)]
    found += [function.falls(loop, masses, number(claim["decay_per_s"])) for loop in loops]
    for before in masses:
        for after in masses:
            for share in (1.0, least):
                by = np.where(np.arange(len(loops[0].fixed)) == 1, share, 1.0)
                one, two = factor * function.at(before), function.at(after) * np.outer(by, by)
                found.append(definite(one - two, abs(one) + abs(two), np.diag(function.at(before))))
    return both(*found)


def stage_dwell(loops: list[Loop], claim: dict[str, Any], masses: np.ndarray) -> Verdict:
    functions = [Function(one["P"], len(loops[0].fixed)) for one in claim["stage"]]
    factor, decay = number(claim["factor"]), number(claim["decay_per_s"])
    found = [enough(claim)]
    for k, (one, loop) in enumerate(zip(functions, loops, strict=True)):
        found += [one.positive(masses), one.falls(loop, masses, decay)]
        for mass in masses:
            for two in functions[:k] + functions[k + 1 :]:
                before, after = factor * one.at(mass), two.at(mass)
                found.append(definite(before - after, abs(before) + abs(after), np.diag(one.at(mass))))
    return both(*found)


def rests(claim: dict[str, Any]) -> bool:
    return {"matched": False, "from_rest": True}[claim["joining"]]


def enough(claim: dict[str, Any]) -> Verdict:
    """Whether V shrinks by more between changes than it grows at one."""
    dwell, factor, decay = (number(claim[key]) for key in ("dwell_s", "factor", "decay_per_s"))
    if min(dwell, factor, decay) <= 0:
        raise ValueError("not positive")
    return positive(2 * decay * dwell - log(factor), 1e-12 * (1 + abs(log(factor))))


CLAIMS = {one.__name__: one for one in (stage_change, any_change, payload_rate, payload_jumps, stage_dwell)}


# The counterexamples.


def grows(loops: list[Loop], example: dict[str, Any], masses: tuple[float, float]) -> Verdict:
    if example["kind"] == "frozen":
        corners, times = [(example["stage"], number(example["outer_end_mass_kg"]))], []
    elif example["kind"] == "cycle":
        corners = list(zip(example["stages"], map(number, example["outer_end_mass_kg"]), strict=True))
        times = [number(t) for t in example["time_s"]]
        if not (len(times) == len(corners) == 2 and min(times) > 0 and example["cycles"] > 0):
            raise ValueError("not a cycle")
    else:
        raise ValueError("not a counterexample")
    if not all(1 <= stage <= len(loops) for stage, _ in corners):
        raise ValueError("no such stage")
    if not all(masses[0] <= mass <= masses[1] for _, mass in corners):
        return False
    matrices = [loops[stage - 1].at(mass) for stage, mass in corners]
    if not times:
        poles = np.linalg.eigvals(matrices[0])
        worst = poles[np.argmax(poles.real / abs(poles))]
        return positive(worst.real / abs(worst), CLOSE)
    first, second = (exponential(a * t) for a, t in zip(matrices, times, strict=True))
    radius = float(np.max(np.abs(np.linalg.eigvals(second @ first))))
    return positive(radius - 1, CLOSE)


def exponential(matrix: np.ndarray) -> np.ndarray:
    """Of a matrix with a full set of eigenvectors, whose states have sizes far apart."""
    values, vectors = np.linalg.eig(matrix)
    return np.asarray((vectors * np.exp(values)) @ np.linalg.inv(vectors)).real
