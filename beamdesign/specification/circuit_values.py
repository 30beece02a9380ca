"""Preferred values of the parts of a circuit that come nearest to a controller."""

from collections.abc import Iterator
from math import inf, log, prod, sqrt

import numpy as np

from beamdesign.controllers import Controller
from beamdesign.realisation.sections import Factor, apart, factored
from beamdesign.specification.circuit import Circuit, Kind, Ratio, Stage
from beamdesign.specification.preferred_values import Series, neighbours, values_between

_CAPACITORS_F = (4.7e-8, 4.7e-6)
"""Film capacitors: stable ones are not made larger, and smaller ones ask for resistors that leak and hum."""
_SMALL_F = (1e-9, 4.7e-6)
"""For breaks that lie higher, and for biquads."""
_RESISTORS_OHM = (1e3, 2.2e6)
_SENSE_OHM = (4.7, 47.0)
_INPUT_OHM = (4.7e3, 1e6)
_PLAIN_OHM = (2e4, 3e4)
_INVERTER_OHM = (1e4, 3e4)
_KEPT = 6
_BESIDE = np.geomspace(0.1, 10.0, 21)


def circuit_of(controller: Controller, resistors: Series, capacitors: Series) -> Circuit:
    """The values of two series that come nearest to a controller of the displacement alone.

    Its poles are shared out to stages of first and second order, each with the zeros nearest to them; a lag is the
    first stage, and else an amplifier alone. The largest relative error of gain and breaks is made least, in a biquad
    that of its response about its breaks.

    Raises:
        ValueError: for a controller that no such circuit gives, with the reason.
    """
    if reason := controller.lacks("one sensor"):
        raise ValueError(f"a circuit of such stages has one input, and {controller.kind!r} {reason}")
    gain, factors = factored(controller.transfer_function())
    ratios = [_ratio(*factor) for factor in _joined(factors)]
    first = next((ratio for ratio in ratios if _kind(ratio) == "lag"), Ratio(1.0))
    head, sense = _first(abs(gain), first, resistors, capacitors)
    others = [_stage(ratio, resistors, capacitors) for ratio in ratios if ratio is not first]
    return Circuit((head, *others), sense, gain < 0, resistors, capacitors)


def deviation(realised: Circuit, controller: Controller) -> float:
    """Largest relative deviation of a circuit's response from a controller's, both of unit static gain, sampled."""
    _, factors = factored(controller.transfer_function())
    asked = [_ratio(*factor) for factor in factors]
    s = _about([root for factor in factors for group in factor for root in group])
    made = [stage.of(stage.parts)._replace(gain=1.0) for stage in realised.stages]
    return float(np.abs(prod(r.at(s) for r in made) / prod(r.at(s) for r in asked) - 1).max())


def _about(roots: list[complex]) -> np.ndarray:
    """Points of the imaginary axis about roots, rad/s."""
    return 1j * np.unique(np.concatenate([abs(root) * _BESIDE for root in roots] or [np.ones(1)]))


def _joined(factors: list[Factor]) -> list[Factor]:
    """Factors of one pole whose zero lies on the right, which one amplifier cannot give, joined with another's."""
    left = list(factors)
    for one in factors:
        if len(one[0]) == 1 and any(zero.real > 0 for zero in one[1]) and one in left:
            left.remove(one)
            others = [other for other in left if len(other[0]) == 1]
            if not others:
                raise ValueError("its one real pole has a zero on the right of the imaginary axis, beyond such stages")
            other = min(others, key=lambda other: apart(one[0], other[0]))
            left[left.index(other)] = (one[0] + other[0], one[1] + other[1])
    return left


def _ratio(poles: list[complex], zeros: list[complex]) -> Ratio:
    """The factor of unit static gain with these roots."""

    def coefficients(roots: list[complex]) -> tuple[float, float]:
        return float(-sum(1 / r for r in roots).real), float((1 / prod(roots)).real) if len(roots) == 2 else 0.0

    return Ratio(1.0, *(coefficients(zeros) if zeros else (0.0, 0.0)), *coefficients(poles))


def _kind(ratio: Ratio) -> Kind:
    return "biquad" if ratio.order == 2 else "lag" if ratio.n1 < ratio.d1 else "lead"


def _first(gain: float, ratio: Ratio, resistors: Series, capacitors: Series) -> tuple[Stage, float]:
    """The summing stage, a lag or an amplifier alone, and the sense resistor."""
    best: tuple[float, Stage, float] | None = None
    for feedback, more, error in _feedbacks(ratio, resistors, capacitors):
        for sense in values_between(resistors, *_SENSE_OHM):
            for given in neighbours(resistors, feedback / (gain * sense)):
                if not _INPUT_OHM[0] <= given <= _INPUT_OHM[1]:
                    continue
                worst = max(error, abs(log(feedback / given / (gain * sense))))
                if best is None or worst < best[0] - 1e-12:
                    kind: Kind = "lag" if more else "amplifier"
                    best = worst, Stage(kind, {"R1": given, "Rf": feedback, **more}), sense
    if best is None:
        raise ValueError("no parts of a sensible size give this gain and these breaks")
    return best[1:]


def _feedbacks(ratio: Ratio, resistors: Series, capacitors: Series) -> Iterator[tuple[float, dict[str, float], float]]:
    """Rf, the parts parallel to it, and the larger relative error of pole and zero."""
    if ratio.order == 0:
        yield from ((feedback, {}, 0.0) for feedback in values_between(resistors, *_PLAIN_OHM))
    else:
        yield from _breaks(ratio.n1, ratio.d1, resistors, capacitors)


def _breaks(
    short_s: float,
    long_s: float,
    resistors: Series,
    capacitors: Series,
    farads: tuple[float, float] = _CAPACITORS_F,
) -> list[tuple[float, dict[str, float], float]]:
    """The best of R with R2 and C so that R2 C and (R + R2) C are these times, and the larger relative error."""
    low, high = _RESISTORS_OHM
    found: list[tuple[float, dict[str, float], float]] = []
    for farad in values_between(capacitors, *farads):
        for shunt in neighbours(resistors, short_s / farad) if short_s else (0.0,):
            total = long_s / farad
            if total <= shunt:
                continue
            for ohm in neighbours(resistors, total - shunt):
                if ohm > high or (shunt and shunt < low) or (not shunt and ohm < low):
                    continue
                error = abs(log(total / (shunt + ohm)))
                if shunt:
                    error = max(error, abs(log(short_s / (farad * shunt))))
                found.append((ohm, {"R2": shunt, "C": farad} if shunt else {"C": farad}, error))
    if not found and farads != _SMALL_F:
        return _breaks(short_s, long_s, resistors, capacitors, _SMALL_F)
    return sorted(found, key=lambda one: one[2])[:12]


def _stage(ratio: Ratio, resistors: Series, capacitors: Series) -> Stage:
    """A further stage, of a static gain of one."""
    kind = _kind(ratio)
    if kind == "biquad":
        return _biquad(ratio, resistors, capacitors)
    short_s, long_s = sorted((ratio.n1, ratio.d1))
    found = _breaks(short_s, long_s, resistors, capacitors)
    if not found:
        raise ValueError(_too_far(ratio))
    ohm, more, _ = found[0]
    return Stage(kind, {"R1": ohm, "Rf": ohm, **more})


def _biquad(ratio: Ratio, resistors: Series, capacitors: Series) -> Stage:
    """R7 = R8, R2 = R5 and C1 = C2: first those that place the poles, then with the best of them those of the zeros."""
    zeros = list(np.roots([ratio.n2, ratio.n1, 1.0])) if ratio.n1 or ratio.n2 else []
    s = _about([*np.roots([ratio.d2, ratio.d1, 1.0]), *zeros])
    asked, best = ratio.at(s), None
    low, high = _RESISTORS_OHM

    def near(ohm: float) -> tuple[float, ...]:
        return tuple(value for value in neighbours(resistors, ohm) if low <= value <= high)

    placed = []
    for farad in values_between(capacitors, *_SMALL_F):
        about = sqrt(ratio.d2) / farad
        for own in values_between(resistors, max(low, about / 2), min(high, about * 2)) if about > low / 2 else ():
            for loop in near(ratio.d2 / (own * farad**2)):
                for damping in near(own * loop * farad / ratio.d1):
                    error = max(
                        abs(log(own * loop * farad**2 / ratio.d2)), abs(log(own * loop * farad / damping / ratio.d1))
                    )
                    placed.append((error, farad, own, loop, damping))
    for _, farad, own, loop, damping in sorted(placed)[:_KEPT]:
        common, sign = own * loop * farad, 1 if ratio.n2 >= 0 else -1
        for equal in values_between(resistors, *_INVERTER_OHM):
            for direct in near(common * equal * farad / abs(ratio.n2)) if ratio.n2 else (inf,):
                rest = sign * equal / (damping * direct) - ratio.n1 / common  # what R4 has to carry, 1 / ohm
                for cross in (*(near(1 / abs(rest)) if abs(rest) * high > 1 else ()), inf):
                    parts = {"R1": damping, "R2": own, "R3": loop, "R4": cross, "R5": own, "R6": direct}
                    parts |= {"R7": equal, "R8": equal, "C1": farad, "C2": farad}
                    turned = tuple(n for n, turn in (("R4", rest < 0), ("R6", sign < 0)) if turn and parts[n] < inf)
                    parts |= {"Ri": _INVERTER_OHM[0], "Rb": _INVERTER_OHM[0]} if turned else {}
                    stage = Stage("biquad", {n: value for n, value in parts.items() if value < inf}, turned)
                    worst = float(np.abs(stage.of(stage.parts).at(s) / asked - 1).max())
                    if best is None or worst < best[0] - 1e-12:
                        best = worst, stage
    if best is None:
        raise ValueError(_too_far(ratio))
    return best[1]


def _too_far(ratio: Ratio) -> str:
    natural = (ratio.d2**-0.5 if ratio.d2 else 1 / ratio.d1) / (2 * np.pi)
    return f"no parts of a sensible size give the stage with its poles about {natural:.4g} Hz"
