"""Whether what a certificate over a mass range states is true, by the loops of `rig_of_certificate`.

Grids of masses, gains and frequencies cannot prove a statement, but a point of them can refute it.
"""

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise, product
from math import inf, isinf, pi
from typing import Any

import numpy as np
import truth_of_nonlinear
from numpy.polynomial import polynomial as P
from rig_of_certificate import FOLLOWS, Member, law_follows, members, number, numbers

CLOSE = 1e-6
"""Relative: nearer than this to its limit a figure is too close to call."""
TOP = {
    "kind",
    "version",
    "sha256",
    "name",
    "outer_end_mass_kg",
    "claim",
    "rig",
    "controller",
    "effect",
    "loop",
    "stability",
    "nonlinear",
}
REPEATED = {"payload", "goal", "arm", "compliance", "material"}
"""Tables of the prototype that a certificate repeats."""


def true(table: Mapping[str, Any]) -> bool | None:
    """Whether what a certificate states is true: None where that is too close to call, or not for a grid to tell.

    Raises:
        Exception: of some kind, for a table that is no certificate of a mass range.
    """
    if table["kind"] != "beamdesign.mass_range" or table["version"] != 2 or table.keys() - TOP - REPEATED:
        raise ValueError("of another kind")
    verdicts = list(_verdicts(table))
    return False if False in verdicts else None if None in verdicts else True


def _verdicts(table: Mapping[str, Any]) -> Iterator[bool | None]:
    for name in REPEATED & table.keys():
        _only_numbers(table[name])
    rig, law, payload = table["rig"], table["controller"], table.get("payload", {})
    for name in ("valve", "filter"):
        if f"{name}_frequency_Hz" in rig:
            hertz, radians = (number(rig[f"{name}_frequency_{unit}"]) for unit in ("Hz", "rad_per_s"))
            yield _near(2 * pi * hertz, radians)
    if "inner_end_mass_kg" in payload:
        yield _near(number(payload["inner_end_mass_kg"]), number(rig["inner_end_mass_kg"]))
    yield law_follows(law)
    low, high = numbers(table["outer_end_mass_kg"])
    if not 0 <= low <= high:
        raise ValueError("no masses")
    loops, stated = members(table), table["stability"]
    yield len(table["loop"]) == len(loops)
    for polynomials, loop in zip(table["loop"], loops, strict=True):
        yield from _of_the_loop(polynomials, loop, high)
    alone = len(loops) == 1 and loops[0].gain[0] == loops[0].gain[1]
    masses = np.linspace(low, high, 1 if low == high else 13)
    grid = [(loop, m, g) for loop in loops for m in masses for g in _grid(*loop.gain)]
    stable = _all(_is_stable(*point) for point in grid)
    yield from _listed(loops[0], stated, low, high) if alone else _common(loops, stated, low, high)
    if stated["stable"] is not stable:
        yield False if stated["stable"] and stable is False else None if not alone or stable is None else False
    for claim in table.get("claim", []):
        yield _claimed(claim, loops, (low, high), masses, stable)
    yield from truth_of_nonlinear.verdicts(table.get("nonlinear", []), loops, masses)


def _of_the_loop(stated: Mapping[str, Any], loop: Member, mass: float) -> Iterator[bool | None]:
    """Whether polynomials give the loop's own compliance and gain, at some frequencies."""
    w = 2 * pi * np.array([0.3, 2.0, 9.0, 40.0, 130.0, 300.0])
    found = {name: [Fraction(value) for value in values] for name, values in stated.items()}
    size = max(abs(value) for value in found["p1"])
    at = {name: P.polyval(1j * w, [float(c / size) for c in values] or [0.0]) for name, values in found.items()}
    closed, returned = at["p0"] + mass * at["p1"], at["returned"] + mass * at["returned_slope"]
    own = loop.responses(mass, 1.0, w)
    for one, name in ((at["disturbance"] / closed, "compliance"), (returned / (closed - returned), "loop_gain")):
        off = abs(abs(one) / own[name] - 1).max()
        yield bool(off < 1e-6) or (False if off > 1e-3 else None)


def _only_numbers(value: Any) -> None:
    """But for the kinds and sensors of controllers, and what a goal says yes or no to."""
    for key, item in value.items() if isinstance(value, dict) else enumerate(value):
        if isinstance(item, dict | list) and key != "sensors":
            _only_numbers(item)
        elif key not in ("kind", "sensors", "lower_gains", "comes_to_rest"):
            number(item)


def _near(one: float, other: float) -> bool | None:
    off = abs(one - other)
    return off <= 1e-13 * abs(other) or (False if off > FOLLOWS * abs(other) else None)


def _grid(low: float, high: float, count: int = 3) -> np.ndarray:
    """Factors or masses, both ends among them."""
    return np.linspace(low, high, count if low < high else 1)


def _all(verdicts: Iterator[bool | None]) -> bool | None:
    found = set()
    for verdict in verdicts:
        if verdict is False:
            return False
        found.add(verdict)
    return None if None in found else True


def _is_stable(loop: Member, mass: float, gain: float, decay: float = 0.0) -> bool | None:
    """Whether all poles lie to the left of -decay."""
    poles = loop.poles(mass, gain)
    beyond = (poles.real + decay) / abs(poles)
    return False if beyond.max() > CLOSE else True if beyond.max() < -CLOSE else None


def _listed(loop: Member, stated: Mapping[str, Any], low: float, high: float) -> Iterator[bool | None]:
    """Ranges with a verdict each, crossings between them, and how far it stays stable."""
    gain, edges = loop.gain[0], [low]
    crossings = [(numbers(entry["outer_end_mass_kg"]), entry) for entry in stated.get("crossing", [])]
    tiles = [(number(part["low"]), number(part["high"])) for part in stated["range"]]
    edges = sorted([*tiles, *((a, b) for (a, b), _ in crossings)])
    whole = bool(edges) and edges[0][0] == low and max(b for _, b in edges) == high
    yield whole and all(after[0] <= before[1] for before, after in pairwise(edges))
    for part, (a, b) in zip(stated["range"], tiles, strict=True):
        sample = number(part["sample"])
        yield a <= sample <= b and low <= a <= b <= high
        # Where a crossing is an end, its enclosure is so narrow that the end is too close to call.
        crossed = {end for enclosure, _ in crossings for end in enclosure}
        for mass in (sample, *np.linspace(a, b, 9)[1:-1], *({a, b} - crossed)):
            verdict = _is_stable(loop, mass, gain)
            yield None if verdict is None else verdict is part["stable"]
    for (a, b), entry in crossings:
        yield from _crosses(loop, (a, b), entry)
    for key, end in (("stays_stable_to_kg", high), ("stays_stable_from_kg", low)):
        if key in stated:
            endless = key.endswith("to_kg") and stated[key] == "infinite"
            far = 1e3 * (high + 1) if endless else number(stated[key])
            yield far >= end if key.endswith("to_kg") else 0 <= far <= end
            inner = end + (far - end) * np.array([0.0, 0.02, 0.1, 0.3, 0.6, 0.9, 0.99, 1 - 1e-4])
            yield from (_is_stable(loop, mass, gain) for mass in inner)


def _crosses(loop: Member, masses: tuple[float, float], entry: Mapping[str, Any]) -> Iterator[bool | None]:
    """Whether a pole is on the axis where it is said to be."""
    if entry["squared_frequency"] == "infinite":
        yield None
        return
    square = numbers(entry["squared_frequency"])
    w = np.sqrt(square)
    if "frequency_Hz" in entry:
        hertz = numbers(entry["frequency_Hz"])
        yield bool(2 * pi * hertz[0] <= w[0] * (1 + CLOSE) and w[1] <= 2 * pi * hertz[1] * (1 + CLOSE))
    if masses[1] - masses[0] > 1e-4 * masses[1] or square[1] - square[0] > 1e-4 * square[1]:
        yield None
        return
    off = abs(loop.poles(sum(masses) / 2, loop.gain[0]) - 1j * w.mean()).min() / max(w.mean(), 1.0)
    yield True if off < CLOSE else False if off > 1e-3 else None


def _common(loops: Sequence[Member], stated: Mapping[str, Any], low: float, high: float) -> Iterator[bool | None]:
    """Masses at which all loops are stable at all gains."""
    for part in stated.get("range", []):
        a, b = number(part["low"]), number(part["high"])
        yield low <= a <= b <= high
        for loop, mass in product(loops, np.linspace(a, b, 7)):
            yield from (_is_stable(loop, mass, gain) for gain in _grid(*loop.gain))


def _claimed(
    claim: Mapping[str, Any],
    loops: Sequence[Member],
    ends: tuple[float, float],
    masses: np.ndarray,
    stable: bool | None,
) -> bool | None:
    """One claim: where it is to hold, at every point of the grid; where it is refuted, at its witness alone."""
    kind, limit = claim["kind"], number(claim["limit"])
    if not claim["holds"]:
        return _refuted(claim, loops, ends) if "witness" in claim else None
    if "witness" in claim:
        raise ValueError("a witness to what holds")
    if kind == "decay_rate":
        return _all(_is_stable(loop, m, g, limit) for loop in loops for m in masses for g in _grid(*loop.gain))
    if kind == "gain_margin":
        least, most = min(limit, 1.0), max(limit, 1.0)
        gains = [(loop, _grid(least * loop.gain[0], most * loop.gain[1], 7)) for loop in loops]
        return _all(_is_stable(loop, m, g) for loop, own in gains for g in own for m in masses)
    if not stable:
        return stable
    worst = 0.0
    for loop in loops:
        for mass, gain in product(masses[::4], _grid(*loop.performing, 2) if loop.performing else ()):
            found = loop.responses(mass, gain, _frequencies(claim, loop.poles(mass, gain)))[kind]
            worst = max(worst, found.max())
    return False if worst > limit * (1 + CLOSE) else True if worst < limit * (1 - CLOSE) else None


def _band(claim: Mapping[str, Any]) -> tuple[float, float]:
    """Frequencies in rad/s for which a claim is."""
    if claim["kind"] == "compliance":
        text = claim["bandwidth_Hz"]
        return 0.0, inf if text == "infinite" else 2 * pi * number(text)
    return (2 * pi * number(claim["from_Hz"]) if claim["kind"] == "loop_gain" else 0.0), inf


def _frequencies(claim: Mapping[str, Any], poles: np.ndarray) -> np.ndarray:
    """Over the band of a claim, evenly in its logarithm, and close about each resonance."""
    start, end = _band(claim)
    wide = np.geomspace(1e-3, 1e6, 181)
    close = np.outer(abs(poles), np.linspace(0.9, 1.1, 9)).ravel()
    inside = np.concatenate([wide, close])
    edges = [max(start, 1e-6), *([] if isinf(end) else [end])]
    return np.append(inside[(inside >= start) & (inside <= end)], edges)


def _refuted(claim: Mapping[str, Any], loops: Sequence[Member], ends: tuple[float, float]) -> bool | None:
    """Whether the witness does refute the claim."""
    kind, limit, witness = claim["kind"], number(claim["limit"]), claim["witness"]
    mass, gain = number(witness["outer_end_mass_kg"]), number(witness.get("gain_factor", "1"))
    if not ends[0] <= mass <= ends[1]:
        return False
    if "squared_frequency" in witness:
        w = np.sqrt(number(witness["squared_frequency"]))
        start, end = _band(claim)
        near = [loop for loop in loops if loop.performing and loop.performing[0] <= gain <= loop.performing[1]]
        if not near or not start * (1 - CLOSE) <= w <= end * (1 + CLOSE):
            return False
        worst = max(loop.responses(mass, gain, np.array([w]))[kind][0] for loop in near)
        return True if worst > limit * (1 + CLOSE) else False if worst < limit * (1 - CLOSE) else None
    times = (min(limit, 1.0), max(limit, 1.0)) if kind == "gain_margin" else (1.0, 1.0)
    near = [loop for loop in loops if loop.gain[0] * times[0] <= gain <= loop.gain[1] * times[1]]
    found = [_is_stable(loop, mass, gain, limit if kind == "decay_rate" else 0.0) for loop in near]
    return True if False in found else None if None in found else False
