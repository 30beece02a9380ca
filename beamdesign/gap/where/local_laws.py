"""What an equation may lack, as functions of its own local variables: a wide dictionary for every equation.

The dictionary is no library of effects. It holds what a law can do to a signal: filter it, bend it, cut it, lag behind
it by a loop, lean on a neighbour. Each entry is one column of a regression, so amplitudes are found, not given; what
has a scale of its own (the width of a loop, a break frequency) stands there at several.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

Law = Callable[..., np.ndarray]


@dataclass(frozen=True)
class Term:
    """One thing that an equation may lack.

    Attributes:
        words: for people.
        subsystem: that it speaks for.
        entry: of `probe.ENTRIES`, where it comes in.
        signals: local ones that it needs, by name.
        law: of these signals (N,) in time; where `linear`, the factor on the spectrum of the only one, of s (F,).
        kind: `linear`, `static` or `hysteretic`.
    """

    words: str
    subsystem: str
    entry: str
    signals: tuple[str, ...]
    law: Law
    kind: str = "static"


def terms(levels: Mapping[str, np.ndarray]) -> tuple[Term, ...]:
    """All terms.

    Args:
        levels: by signal, sizes at which laws of one scale are tried, in its unit.
    """
    sensor, late, amplifier = ("sensor", "sensor"), ("controller", "sensor"), ("amplifier", "amplifier")
    volts, asked = ("sensor_V",), ("demanded_A",)
    spool, valve = ("servovalve", "spool"), ("servovalve", "oil continuity")
    current, flow, pressure = ("current_A",), ("metered_m3_per_s",), ("load_pressure_Pa",)
    seal, sides, oil = ("actuator", "piston force"), ("actuator", "oil continuity"), ("oil", "oil continuity")
    speed, rate = ("stroke_m_per_s",), ("pressure_rate_Pa_per_s",)
    mount, joint, force = ("structure", "mount"), ("structure", "joint"), ("cylinder_force_N",)
    middle = levels["stroke_m_per_s"][2]
    return (
        *_each("sensor lags, {:.0f} Hz", sensor, volts, (30, 60, 120, 250, 500, 1000), _low_pass, "linear"),
        Term("sensor bends, V|V|", *sensor, volts, lambda v: v * np.abs(v)),
        Term("sensor bends, V^3", *sensor, volts, lambda v: v**3),
        Term("sensor bends one way, V^2", *sensor, volts, lambda v: v**2),
        Term("sensor differs by sign, |V|", *sensor, volts, np.abs),
        *_loops("sensor", sensor, volts, levels),
        *_each("signal comes {:g} ms late", late, volts, (0.3, 0.6, 1.2, 2.4, 4.8), _late, "linear"),
        *_each("current cut at {:.2g}", amplifier, asked, levels["demanded_A"], _cut),
        *_each("amplifier lags, {:.0f} Hz", amplifier, asked, (50, 100, 200, 400, 800), _low_pass, "linear"),
        Term("gain of the amplifier", *amplifier, asked, np.ones_like, "linear"),
        Term("amplifier bends, i^3", *amplifier, asked, lambda i: i**3),
        Term("amplifier differs by sign", *amplifier, asked, np.abs),
        *_each("spool lags, {:.0f} Hz", spool, current, (50, 100, 200, 400, 800), _low_pass, "linear"),
        *_loops("spool", spool, current, levels),
        *_each("flow cut at {:.2g}", valve, flow, levels["metered_m3_per_s"], _cut),
        Term("flow bends, Q|Q|", *valve, flow, lambda q: q * np.abs(q)),
        Term("flow bends, Q^3", *valve, flow, lambda q: q**3),
        Term("flow goes with pressure, |Q| p", *valve, flow + pressure, lambda q, p: np.abs(q) * p),
        Term("flow goes with pressure, Q p^2", *valve, flow + pressure, lambda q, p: q * p**2),
        Term("flow goes with pressure, Q p", *valve, flow + pressure, lambda q, p: q * p),
        Term("leakage bends, p|p|", *valve, pressure, lambda p: p * np.abs(p)),
        Term("leakage bends, p^2", *valve, pressure, lambda p: p**2),
        *_each("supply droops over {:g} s", valve, flow, (0.02, 0.1, 0.5), _droop),
        *_loops("seal", seal, ("stroke_m",), levels),
        *_each("friction turns over within {:.2g} m/s", seal, speed, levels["stroke_m_per_s"], _slide),
        Term("friction goes with pressure", *seal, speed + pressure, lambda v, p: _slide(middle, v) * np.abs(p)),
        Term("friction, speed squared", *seal, speed, lambda v: v * np.abs(v)),
        Term("viscous friction", *seal, speed, np.ones_like, "linear"),
        Term("sides differ, |speed|", *sides, speed, np.abs),
        Term("sides differ, |flow|", *sides, flow, np.abs),
        Term("force differs by sign, |p|", *seal, pressure, np.abs),
        Term("oil gives way", *oil, rate, np.ones_like, "linear"),
        *_each("oil lags, {:.0f} Hz", oil, rate, (20, 60, 200), _low_pass, "linear"),
        Term("oil gives way with pressure, p' p", *oil, pressure + rate, lambda p, r: p * r),
        Term("oil gives way with pressure, p' |p|", *oil, pressure + rate, lambda p, r: np.abs(p) * r),
        Term("oil gives way with pressure, p' p^2", *oil, pressure + rate, lambda p, r: p**2 * r),
        *_beam("outer", levels),
        *_beam("inner", levels),
        *_resonances("mount", mount, ("mount_force_N",), 0),
        *_each("force in the joint cut at {:.2g}", joint, force, levels["cylinder_force_N"], _cut),
        Term("joint gives way", *joint, force, np.ones_like, "linear"),
    )


def _beam(name: str, levels: Mapping[str, np.ndarray]) -> Iterable[Term]:
    of, tip, beam = ("structure", f"{name} beam"), (f"{name}_m",), f"{name} beam"
    yield from _resonances(beam, of, tip, 2)
    yield Term(f"{beam} bends, x^3", *of, tip, lambda x: x**3)
    yield Term(f"{beam} bends, x|x|", *of, tip, lambda x: x * np.abs(x))
    yield Term(f"{beam} differs by sign, |x|", *of, tip, np.abs)
    yield from _loops(beam, of, tip, levels)


def _each(
    words: str, of: tuple[str, str], signals: tuple[str, ...], scales: Iterable[float], law: Law, kind: str = "static"
) -> list[Term]:
    """One term per scale of a law, which is its first argument."""
    return [Term(words.format(scale), *of, signals, partial(law, scale), kind) for scale in scales]


def _loops(words: str, of: tuple[str, str], signals: tuple[str], levels: Mapping[str, np.ndarray]) -> list[Term]:
    return _each(f"loop in {words} of half width {{:.2g}}", of, signals, levels[signals[0]], stop, "hysteretic")


def _resonances(words: str, of: tuple[str, str], signals: tuple[str], order: int) -> list[Term]:
    law = partial(_resonance, order)
    return _each(f"{words} resonates at {{:.0f}} Hz", of, signals, np.geomspace(25, 600, 14), law, "linear")


def _low_pass(hz: float, s: np.ndarray) -> np.ndarray:

    return np.asarray(1 / (1 + s / (2 * np.pi * hz)) - 1)


def _late(milliseconds: float, s: np.ndarray) -> np.ndarray:
    return np.asarray(np.exp(-s * (milliseconds / 1e3)) - 1)


def _resonance(order: int, hz: float, s: np.ndarray) -> np.ndarray:
    w = 2 * np.pi * hz
    return np.asarray(s**order * w**2 / (s**2 + 0.1 * w * s + w**2))


def _cut(level: float, signal: np.ndarray) -> np.ndarray:
    return np.clip(signal, -level, level)


def _slide(level: float, speed: np.ndarray) -> np.ndarray:
    return np.asarray(np.tanh(speed / level))


def _droop(tau: float, flow: np.ndarray) -> np.ndarray:
    """Flow times its smoothed size, over samples of half a millisecond or whatever; regression finds the scale."""
    from scipy.signal import lfilter

    keep = np.exp(-5e-4 / tau)
    return np.asarray(flow * lfilter([1 - keep], [1, -keep], np.abs(flow)))


def stop(width: float, signal: np.ndarray) -> np.ndarray:
    """Stop operator: follows the signal's changes, within plus and minus `width` (Prandtl's element).

    Args:
        width: in the signal's unit.
        signal: (N,) that begins at its rest.
    """
    return np.asarray(_compiled()(np.ascontiguousarray(signal, dtype=float), float(width)))


def _stop(signal: np.ndarray, width: float) -> np.ndarray:
    """One loop over samples that cannot be vectorised."""
    out = np.empty_like(signal)
    held = 0.0
    before = signal[0]
    for k in range(len(signal)):
        held = min(max(held + signal[k] - before, -width), width)
        before = signal[k]
        out[k] = held
    return out


@cache
def _compiled() -> Callable[[np.ndarray, float], np.ndarray]:
    from numba import njit

    try:
        return njit(cache=True)(_stop)
    except RuntimeError:  # no folder that could be written to; each process then compiles for itself
        return njit(_stop)
