"""What an equation may lack, as functions of its own local variables: a wide dictionary for every equation.

The dictionary is no library of effects. It holds what a law can do to a signal: filter it, bend it, cut it, lag behind
it by a loop, lean on a neighbour. Each entry is one column of a regression, so amplitudes are found, not given; what
has a scale of its own (the width of a loop, a break frequency) stands there at several.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

Spectrum = Callable[[np.ndarray], np.ndarray]
Signals = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Term:
    """One thing that an equation may lack.

    Attributes:
        words: for people.
        subsystem: that it speaks for.
        entry: of `probe.ENTRIES`, where it comes in.
        law: of local signals (N,) by name, or of one signal in the frequency domain.
        signals: that it needs.
        kind: `linear`, `static` or `hysteretic`.
    """

    words: str
    subsystem: str
    entry: str
    law: Callable[[Signals], np.ndarray] | None
    signals: tuple[str, ...]
    kind: str
    transfer: Spectrum | None = field(default=None)


def terms(levels: Mapping[str, np.ndarray]) -> tuple[Term, ...]:
    """All terms.

    Args:
        levels: by signal, sizes at which laws of one scale are tried, in its unit.
    """
    return (
        *_sensor(levels),
        *_electronics(levels),
        *_valve(levels),
        *_cylinder(levels),
        *_oil(),
        *_beams(levels),
        *_joints(levels),
    )


def stop(signal: np.ndarray, width: float) -> np.ndarray:
    """Stop operator: follows the signal's changes, within plus and minus `width` (Prandtl's element).

    Args:
        signal: (N,) that begins at its rest.
        width: in its unit.
    """
    from beamdesign.gap.where.stop_operator import run

    return np.asarray(run(np.ascontiguousarray(signal, dtype=float), float(width)))


def _linear(words: str, subsystem: str, entry: str, signal: str, transfer: Spectrum) -> Term:
    return Term(words, subsystem, entry, None, (signal,), "linear", transfer)


def _static(
    words: str, subsystem: str, entry: str, signals: Sequence[str], law: Callable[..., np.ndarray], kind: str = "static"
) -> Term:
    names = tuple(signals)
    return Term(words, subsystem, entry, lambda s: law(*(s[name] for name in names)), names, kind)


def _loops(subsystem: str, entry: str, signal: str, levels: Mapping[str, np.ndarray], words: str) -> list[Term]:
    return [
        _static(
            f"loop in {words} of half width {width:.2g}",
            subsystem,
            entry,
            (signal,),
            lambda v, width=width: stop(v, width),
            "hysteretic",
        )
        for width in levels[signal]
    ]


def _cuts(subsystem: str, entry: str, signal: str, levels: Mapping[str, np.ndarray], words: str) -> list[Term]:
    return [
        _static(
            f"{words} cut at {level:.2g}", subsystem, entry, (signal,), lambda v, level=level: np.clip(v, -level, level)
        )
        for level in levels[signal]
    ]


def _low_pass(hz: float) -> Spectrum:
    return lambda s: np.asarray(1 / (1 + s / (2 * np.pi * hz)) - 1)


def _late(seconds: float) -> Spectrum:
    return lambda s: np.asarray(np.exp(-s * seconds) - 1)


def _resonance(hz: float, order: int) -> Spectrum:
    w = 2 * np.pi * hz
    return lambda s: np.asarray(s**order * w**2 / (s**2 + 0.1 * w * s + w**2))


def _low_passes(subsystem: str, entry: str, signal: str, breaks: Sequence[float], words: str) -> list[Term]:
    return [_linear(f"{words} lags, {hz:.0f} Hz", subsystem, entry, signal, _low_pass(hz)) for hz in breaks]


def _resonances(subsystem: str, entry: str, signal: str, order: int, words: str) -> list[Term]:
    return [
        _linear(f"{words} resonates at {hz:.0f} Hz", subsystem, entry, signal, _resonance(float(hz), order))
        for hz in np.geomspace(25, 600, 14)
    ]


def _sensor(levels: Mapping[str, np.ndarray]) -> list[Term]:
    of = ("sensor", "sensor")
    return [
        *_low_passes(*of, "sensor_V", (30, 60, 120, 250, 500, 1000), "sensor"),
        _static("sensor bends, V|V|", *of, ("sensor_V",), lambda v: v * np.abs(v)),
        _static("sensor bends, V^3", *of, ("sensor_V",), lambda v: v**3),
        _static("sensor bends one way, V^2", *of, ("sensor_V",), lambda v: v**2),
        _static("sensor differs by sign, |V|", *of, ("sensor_V",), np.abs),
        *_loops(*of, "sensor_V", levels, "sensor"),
    ]


def _electronics(levels: Mapping[str, np.ndarray]) -> list[Term]:
    of = ("amplifier", "amplifier")
    delays = [
        _linear(f"signal comes {tau * 1e3:g} ms late", "controller", "sensor", "sensor_V", _late(tau))
        for tau in (0.3e-3, 0.6e-3, 1.2e-3, 2.4e-3, 4.8e-3)
    ]
    return [
        *delays,
        *_cuts(*of, "demanded_A", levels, "current"),
        *_low_passes(*of, "demanded_A", (50, 100, 200, 400, 800), "amplifier"),
        _linear("gain of the amplifier", *of, "demanded_A", np.ones_like),
        _static("amplifier bends, i^3", *of, ("demanded_A",), lambda i: i**3),
        _static("amplifier differs by sign", *of, ("demanded_A",), np.abs),
    ]


def _valve(levels: Mapping[str, np.ndarray]) -> list[Term]:
    of, flow = ("servovalve", "oil continuity"), ("metered_m3_per_s", "load_pressure_Pa")
    droops = [
        _static(
            f"supply droops over {tau:g} s",
            *of,
            ("metered_m3_per_s",),
            lambda q, tau=tau: q * _smoothed(np.abs(q), tau),
        )
        for tau in (0.02, 0.1, 0.5)
    ]
    return [
        *_low_passes("servovalve", "spool", "current_A", (50, 100, 200, 400, 800), "spool"),
        *_loops("servovalve", "spool", "current_A", levels, "spool"),
        *_cuts(*of, "metered_m3_per_s", levels, "flow"),
        _static("flow bends, Q|Q|", *of, flow[:1], lambda q: q * np.abs(q)),
        _static("flow bends, Q^3", *of, flow[:1], lambda q: q**3),
        _static("flow goes with pressure, |Q| p", *of, flow, lambda q, p: np.abs(q) * p),
        _static("flow goes with pressure, Q p^2", *of, flow, lambda q, p: q * p**2),
        _static("flow goes with pressure, Q p", *of, flow, lambda q, p: q * p),
        _static("leakage bends, p|p|", *of, flow[1:], lambda p: p * np.abs(p)),
        _static("leakage bends, p^2", *of, flow[1:], lambda p: p**2),
        *droops,
    ]


def _smoothed(signal: np.ndarray, tau: float) -> np.ndarray:
    """First-order low pass over samples of half a millisecond or whatever they are; scale is found by regression."""
    from scipy.signal import lfilter

    keep = np.exp(-5e-4 / tau)
    return np.asarray(lfilter([1 - keep], [1, -keep], signal))


def _cylinder(levels: Mapping[str, np.ndarray]) -> list[Term]:
    force, oil, speed = ("actuator", "piston force"), ("actuator", "oil continuity"), "stroke_m_per_s"
    slides = [
        _static(
            f"friction turns over within {level:.2g} m/s", *force, (speed,), lambda v, level=level: np.tanh(v / level)
        )
        for level in levels[speed]
    ]
    rubs = [
        _static(
            "friction goes with pressure",
            *force,
            (speed, "load_pressure_Pa"),
            lambda v, p: np.tanh(v / levels[speed][2]) * np.abs(p),
        )
    ]
    return [
        *_loops(*force, "stroke_m", levels, "seal"),
        *slides,
        *rubs,
        _static("friction, speed squared", *force, (speed,), lambda v: v * np.abs(v)),
        _linear("viscous friction", *force, speed, np.ones_like),
        _static("sides differ, |speed|", *oil, (speed,), np.abs),
        _static("sides differ, |flow|", *oil, ("metered_m3_per_s",), np.abs),
        _static("force differs by sign, |p|", *force, ("load_pressure_Pa",), np.abs),
    ]


def _oil() -> list[Term]:
    of, both = ("oil", "oil continuity"), ("load_pressure_Pa", "pressure_rate_Pa_per_s")
    return [
        _linear("oil gives way", *of, both[1], np.ones_like),
        *_low_passes(*of, both[1], (20, 60, 200), "oil"),
        _static("oil gives way with pressure, p' p", *of, both, lambda p, r: p * r),
        _static("oil gives way with pressure, p' |p|", *of, both, lambda p, r: np.abs(p) * r),
        _static("oil gives way with pressure, p' p^2", *of, both, lambda p, r: p**2 * r),
    ]


def _beams(levels: Mapping[str, np.ndarray]) -> list[Term]:
    found = []
    for beam, tip in (("outer", "outer_m"), ("inner", "inner_m")):
        of = ("structure", f"{beam} beam")
        found += [
            *_resonances(*of, tip, 2, f"{beam} beam"),
            _static(f"{beam} beam bends, x^3", *of, (tip,), lambda x: x**3),
            _static(f"{beam} beam bends, x|x|", *of, (tip,), lambda x: x * np.abs(x)),
            _static(f"{beam} beam differs by sign, |x|", *of, (tip,), np.abs),
            *_loops(*of, tip, levels, f"{beam} beam"),
        ]
    return found


def _joints(levels: Mapping[str, np.ndarray]) -> list[Term]:
    return [
        *_resonances("structure", "mount", "mount_force_N", 0, "mount"),
        *_cuts("structure", "joint", "cylinder_force_N", levels, "force in the joint"),
        _linear("joint gives way", "structure", "joint", "cylinder_force_N", np.ones_like),
    ]
