"""Whether what a certificate states of nonlinear loops is true, by the loops of `rig_of_certificate` on grids."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from rig_of_certificate import Member, number, numbers

CLOSE = 1e-6
KEYS = {
    "slope": {"kind", "loops", "margin", "popov_s", "term"},
    "sector": {"kind", "loops", "place", "gain", "margin"},
    "both": {"kind", "loops", "place", "gain", "margin", "weight", "popov_s", "term"},
    "deviation": {"kind", "loops", "pieces", "error"},
}
MAY_HAVE = {"slope": {"place"}}
W = np.geomspace(0.01, 1e6, 1201)


def verdicts(stated: Sequence[Mapping[str, Any]], loops: Sequence[Member], masses: np.ndarray) -> Iterator[bool | None]:
    """For each statement whether it is true; None where a grid does not tell.

    Raises:
        Exception: of some kind, for what states nothing.
    """
    for table in stated:
        if table.keys() - MAY_HAVE.get(table["kind"], set()) != KEYS[table["kind"]]:
            raise ValueError("other keys")
        numbered = table["loops"]
        if not numbered or any(type(k) is not int or not 1 <= k <= len(loops) for k in numbered):
            raise ValueError("no loops")
        own = [loops[k - 1] for k in numbered]
        for loop in own:
            for mass in masses[::3]:
                yield from _OF[table["kind"]](table, loop, mass)


def _stable(loop: Member, mass: float, gain: float) -> bool | None:
    poles = loop.poles(mass, gain)
    worst = (poles.real / abs(poles)).max()
    return False if worst > CLOSE else True if worst < -CLOSE else None


def _frequencies(loop: Member, mass: float, gain: float) -> np.ndarray:
    poles = loop.poles(mass, gain)
    return np.unique(np.concatenate([W, np.outer(abs(poles), np.linspace(0.8, 1.2, 21)).ravel()]))


def _above(real: np.ndarray, margin: float) -> bool | None:
    if margin <= 0:
        raise ValueError("no margin")
    return False if real.min() < margin * (1 - CLOSE) else True if real.min() > margin * (1 + CLOSE) else None


def multiplier_at(table: Mapping[str, Any], w: np.ndarray) -> tuple[np.ndarray, float, bool]:
    """Its values, the norm of its kernels, and whether a coefficient is negative."""
    popov = number(table["popov_s"])
    multiplier, norm, odd = 1 + popov * 1j * w, 0.0, False
    for term in table["term"]:
        coefficient, rate, order, causal = (term[key] for key in ("coefficient", "rate_per_s", "order", "causal"))
        if type(order) is not int or type(causal) is not bool or order < 1 or number(rate) <= 0 or len(term) != 4:
            raise ValueError("no kernel")
        multiplier -= number(coefficient) / (1 + (1 if causal else -1) * 1j * w / number(rate)) ** order
        norm, odd = norm + abs(number(coefficient)), odd or number(coefficient) < 0
    if popov < 0:
        raise ValueError("a negative term of Popov's")
    return multiplier, norm, odd


def _slope(table: Mapping[str, Any], loop: Member, mass: float) -> Iterator[bool | None]:
    if (place := table.get("place", "law")) not in ("law", "motor"):
        raise ValueError("no place")
    loop = loop.at_the_motor() if place == "motor" else loop
    gain = loop.gain[1]
    w = _frequencies(loop, mass, gain)
    multiplier, norm, _ = multiplier_at(table, w)
    yield norm < 1
    yield from (_stable(loop, mass, share * gain) for share in (0.0, 0.3, 0.7, 1.0))
    looped = loop.responses(mass, gain, w)["looped"]
    yield _above((multiplier * (1 + looped)).real, number(table["margin"]))


def _both(table: Mapping[str, Any], loop: Member, mass: float) -> Iterator[bool | None]:
    """The least eigenvalue of the matrix of both constraints, less the margin in the first."""
    (least, most), weight, margin = numbers(table["gain"]), number(table["weight"]), number(table["margin"])
    if not 0 < least <= most or weight <= 0 or margin <= 0 or table["place"] not in ("volts", "flow"):
        raise ValueError("no sector")
    w = _frequencies(loop, mass, 1.0)
    multiplier, norm, odd = multiplier_at(table, w)
    yield norm < 1 and not odd
    found = loop.responses(mass, 1.0, w)
    if table["place"] == "volts" and loop.filtered:
        yield None
        return
    if table["place"] == "flow":
        natural, damping, spring = loop.spool
        by = 1 / (1 + spring + 2 * damping * 1j * w / natural - (w / natural) ** 2)
        onto, rest = most * found["looped"] / by, 0.0
    else:
        by, onto, rest = found["seen"], most * found["law"], found["looped"] - found["own"]
    low = (multiplier * (1 + rest + least / most * onto * by)).real - margin
    cross = ((1 - least / most) * multiplier * onto - weight * by.conj()) / 2
    yield bool(low.min() > -CLOSE)
    room = low * weight - abs(cross) ** 2
    size = abs(low * weight) + abs(cross) ** 2
    worst = (room / size).min()
    yield False if worst < -CLOSE else True if worst > CLOSE else None


def _sector(table: Mapping[str, Any], loop: Member, mass: float) -> Iterator[bool | None]:
    least, most = numbers(table["gain"])
    if not 0 <= least <= most or table["place"] not in ("volts", "flow"):
        raise ValueError("no sector")
    w = _frequencies(loop, mass, 1.0)
    found = loop.responses(mass, 1.0, w)
    looped = found["looped"] if table["place"] == "flow" else found["own"] / (1 + found["looped"] - found["own"])
    yield _above(((1 + most * looped) / (1 + least * looped)).real, number(table["margin"]))
    if table["place"] == "flow" or len(loop.seen) == 1:
        yield from (_stable(loop, mass, gain) for gain in np.linspace(least, most, 3))


def _deviation(table: Mapping[str, Any], loop: Member, mass: float) -> Iterator[bool | None]:
    if type(table["pieces"]) is not int or table["pieces"] < 1 or not table["error"]:
        raise ValueError("no pieces")
    yield _stable(loop, mass, 1.0)
    for one in table["error"]:
        size, bound = number(one["size"]), number(one["bound_m"])
        if len(one) != 3 or min(size, bound) < 0:
            raise ValueError("no error")
        response = loop.strayed(mass, one["place"])
        if response is None:
            yield None
            continue
        found = size * response
        yield False if found > bound * (1 + 1e-3) else True if found < bound else None


_OF = {"slope": _slope, "sector": _sector, "both": _both, "deviation": _deviation}
