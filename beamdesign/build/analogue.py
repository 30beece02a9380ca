"""Analogue controllers of the preferred values that come nearest to a law, proved again as they are realised."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from math import inf, log, prod, sqrt
from typing import Literal

import numpy as np
from flint import fmpq

from beamdesign.build.circuit import Circuit, Kind, Ratio, Series, Stage, neighbours, part_value, values_between
from beamdesign.build.realisation.sections import Factor, apart, factored
from beamdesign.build.tolerances import performance_of_all
from beamdesign.controllers import Controller
from beamdesign.polynomial import nearest
from beamdesign.progress import Progress, silent
from beamdesign.proofs.box import Box, certify_box
from beamdesign.proofs.certifying import stability_over
from beamdesign.proofs.rig_family import rig_family
from beamdesign.proofs.statement import PolynomialFamily
from beamdesign.proofs.tolerance_box import box_with_effects
from beamdesign.prototype import Prototype

SERIES: tuple[tuple[Series, Series], ...] = (("E24", "E6"), ("E96", "E6"), ("E96", "E12"))
RESISTORS, CAPACITORS = (0.01, 0.05), (0.05, 0.1)
_BUDGET = 3000

Verdict = Literal["proved", "refuted", "not proved"]


@dataclass(frozen=True)
class ComponentTolerance:
    """Whether the loop is stable with all components anywhere within their tolerances, for every outer end mass.

    Attributes:
        resistors: relative tolerance of every resistor.
        capacitor: relative tolerance of every capacitor.
        verdict: "proved" for the box of gain and time constants that holds all components; "refuted" by components at
            ends of their tolerances; "not proved" otherwise.
        reason: in words, why it is not proved.
        certificate: text that `beamdesign certify --replay` proves again; empty unless proved.
    """

    resistors: float
    capacitor: float
    verdict: Verdict
    reason: str = ""
    certificate: str = field(default="", repr=False, compare=False)


@dataclass(frozen=True)
class AnalogueController:
    """One realisation.

    Attributes:
        circuit: its components.
        controller: what they realise.
        errors: relative deviation from the controller that was asked for: of `gain_A_per_V`, and the largest of the
            `response` over its gain, about its breaks.
        stable: whether the nominal realisation is proved stable over the range of outer end masses.
        bandwidth_Hz: proved for the nominal realisation; None where not stable.
        peak_sensitivity: proved likewise.
        tolerances: verdicts for usual tolerances of components.
    """

    circuit: Circuit
    controller: Controller
    errors: dict[str, float]
    stable: bool
    bandwidth_Hz: float | None
    peak_sensitivity: float | None
    tolerances: tuple[ComponentTolerance, ...]


def analogue_controllers(
    prototype: Prototype, masses_kg: tuple[float, float], progress: Progress = silent
) -> tuple[AnalogueController, ...]:
    """Realisations in E24 and in E96 resistors, each certified.

    Args:
        prototype: with a controller.
        masses_kg: range of outer end mass.
        progress: told the share done and what is being done.

    Raises:
        ValueError: for a controller that no circuit gives; see `circuit_of`.
    """
    asked = prototype.own_controller
    found: dict[tuple[float, ...], AnalogueController] = {}
    for k, (resistors, capacitors) in enumerate(SERIES):
        progress(k / len(SERIES), f"analogue controller, {resistors}")
        drive, largest = prototype.actuator.drive_gain(), prototype.actuator.largest_current_A(prototype)
        one = circuit_of(asked, resistors, capacitors, drive, largest)
        values = tuple(one.parts.values())
        if values not in found:
            found[values] = _certified(prototype, asked, masses_kg, one)
    return tuple(found.values())


def _certified(
    prototype: Prototype, asked: Controller, masses_kg: tuple[float, float], circuit: Circuit
) -> AnalogueController:
    realised, wanted = circuit.law, asked.transfer_function()
    static = wanted.numerator(0) / wanted.denominator(0)
    errors = {"gain_A_per_V": nearest(circuit.gain_A_per_V / static - 1), "response": deviation(circuit, asked)}
    reached = performance_of_all(prototype.but(controller=realised).stages(masses_kg))
    capacitors = CAPACITORS if circuit.has_capacitors else CAPACITORS[:1]
    verdicts = tuple(with_tolerance(prototype, masses_kg, circuit, r, c) for r in RESISTORS for c in capacitors)
    return AnalogueController(circuit, realised, errors, reached[0] is not None, *reached, verdicts)


def with_tolerance(
    prototype: Prototype, masses_kg: tuple[float, float], circuit: Circuit, resistors: float, capacitor: float
) -> ComponentTolerance:
    """Prove stability for all components within their tolerances and every outer end mass at once, or refute it."""
    found = partial(ComponentTolerance, resistors, capacitor)
    family, box = _spanned(prototype, masses_kg, circuit, resistors, capacitor)
    verdict = certify_box(family, box, _BUDGET, volumes=False)
    if verdict.stable:  # with it every corner
        return found("proved", certificate=verdict.certificate)
    for corner in circuit.corners(resistors, capacitor):
        at_corner = stability_over(prototype.but(controller=corner.law), *masses_kg)
        if not at_corner.stable:
            shown = ", ".join(f"{name} {part_value(name, value)}" for name, value in corner.parts.items())
            return found("refuted", f"with {shown}: {at_corner.reason}")
    return found(
        "not proved",
        "no combination that was looked at of components at the ends of their tolerances is unstable, but the box of"
        " independent gain and time constants that encloses them is not proved",
    )


def _spanned(
    prototype: Prototype, masses_kg: tuple[float, float], circuit: Circuit, resistors: float, capacitor: float
) -> tuple[PolynomialFamily, Box]:
    """The loop over gain and coefficients of every stage, s and s^2, and what these can be within the tolerances.

    With the payloads, and all that effects span.
    """
    ranges: dict[str, tuple[float | fmpq, float | fmpq]] = {"controller_gain": circuit.gain_span(resistors, capacitor)}
    nominal = []
    for k, stage in enumerate(circuit.stages, 1):
        spans = stage.spans(resistors, capacitor)._asdict()
        # One that cancels in the nominal parts, as that of an undamped notch, does not within their tolerances.
        there = [name for name, span in spans.items() if name[1:] in "12" and any(span)]
        nominal.append({name: getattr(stage.exact, name) for name in there})
        ranges |= {f"stage_{k}_{name}": spans[name] for name in there}
    box = box_with_effects(prototype, ranges | {"outer_end_mass": masses_kg})
    return rig_family(prototype.but(controller=circuit.law), nominal, varying=box.ranges), box


_CAPACITORS_F = (4.7e-8, 4.7e-6)
"""Film capacitors: stable ones are not made larger, and smaller ones ask for resistors that leak and hum."""
_SMALL_F = (1e-9, 4.7e-6)
"""For breaks that lie higher, and for biquads."""
_RESISTORS_OHM = (1e3, 2.2e6)
_SENSE_OHM = (4.7, 47.0)
_OUTPUT_V = 10.0
"""The most that an amplifier is asked for: no larger resistance senses the largest current."""
_INPUT_OHM = (4.7e3, 1e6)
_PLAIN_OHM = (2e4, 3e4)
_INVERTER_OHM = (1e4, 3e4)
_BOOSTS, _BOOSTED_OHM = (1.0, 10.0, 100.0), 1e4
"""Of the first stage's gain, by a last one, and the resistor into that."""
_KEPT = 6
_BESIDE = np.geomspace(0.1, 10.0, 21)


def circuit_of(
    controller: Controller,
    resistors: Series,
    capacitors: Series,
    drive_A_per_V: float | None = None,
    largest_current_A: float | None = None,
) -> Circuit:
    """The values of two series that come nearest to a controller of the displacement alone.

    Its poles are shared out to stages of first and second order, each with the zeros nearest to them; a lag is the
    first stage, and else an amplifier alone. The largest relative error of gain and breaks is made least, in a biquad
    that of its response about its breaks. Without a drive a power amplifier with a sense resistor gives the current.

    Raises:
        ValueError: for a controller that no such circuit gives, with the reason.
    """
    if reason := controller.lacks("one sensor"):
        raise ValueError(f"a circuit of such stages has one input, and {controller.kind!r} {reason}")
    gain, factors = factored(controller.transfer_function())
    ratios = [_ratio(*factor) for factor in _joined(factors)]
    first = next((ratio for ratio in ratios if _kind(ratio) == "lag"), Ratio(1.0))
    driven = drive_A_per_V is not None
    share = min(1.0, _OUTPUT_V / _SENSE_OHM[1] / (largest_current_A or 1e-3))
    senses = (1 / drive_A_per_V,) if drive_A_per_V else values_between(resistors, *(share * ohm for ohm in _SENSE_OHM))
    for boost in _BOOSTS:
        if made := _first(abs(gain) / boost, first, resistors, capacitors, senses):
            break
    else:
        reason = f"no parts of a sensible size give this gain of {abs(gain):.4g} A/V and these breaks"
        more = f" before a drive of {drive_A_per_V:g} A/V; actuator.drive_A_per_V is its scale" if driven else ""
        raise ValueError(reason + more)
    head, sense = made
    others = [_stage(ratio, resistors, capacitors) for ratio in ratios if ratio is not first]
    others += [Stage("amplifier", {"R1": _BOOSTED_OHM, "Rf": boost * _BOOSTED_OHM})] if boost > 1 else []
    return Circuit((head, *others), sense, gain < 0, resistors, capacitors, driven)


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


def _first(
    gain: float, ratio: Ratio, resistors: Series, capacitors: Series, senses: Sequence[float]
) -> tuple[Stage, float] | None:
    """The summing stage, a lag or an amplifier alone, and which of the resistances the current is sensed by."""
    best: tuple[float, Stage, float] | None = None
    plain = [(feedback, dict[str, float](), 0.0) for feedback in values_between(resistors, *_PLAIN_OHM)]
    for feedback, more, error in _breaks(ratio.n1, ratio.d1, resistors, capacitors) if ratio.order else plain:
        for sense in senses:
            for given in neighbours(resistors, feedback / (gain * sense)):
                if not _INPUT_OHM[0] <= given <= _INPUT_OHM[1]:
                    continue
                worst = max(error, abs(log(feedback / given / (gain * sense))))
                if best is None or worst < best[0] - 1e-12:
                    kind: Kind = "lag" if more else "amplifier"
                    best = worst, Stage(kind, {"R1": given, "Rf": feedback, **more}), sense
    return None if best is None else best[1:]


def _breaks(
    short_s: float, long_s: float, resistors: Series, capacitors: Series, farads: tuple[float, float] = _CAPACITORS_F
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
