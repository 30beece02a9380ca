"""Analogue controllers of preferred values, proved again as they are realised."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from flint import fmpq

from beamdesign.controllers import Controller
from beamdesign.polynomial import exact
from beamdesign.proof.box import box_of, certify_box
from beamdesign.proof.certifying import certify
from beamdesign.proof.rational import nearest
from beamdesign.proof.rig_family import Family, rig_family
from beamdesign.prototype import Prototype
from beamdesign.specification.circuit import Circuit
from beamdesign.specification.circuit_values import circuit_of, deviation
from beamdesign.specification.preferred_values import Series

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
    reason: str
    certificate: str


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
    prototype: Prototype, masses_kg: tuple[float, float], told: Callable[[str], None] = lambda text: None
) -> tuple[AnalogueController, ...]:
    """Realisations in E24 and in E96 resistors, each certified.

    Args:
        prototype: with a controller.
        masses_kg: range of outer end mass.
        told: what is being done.

    Raises:
        ValueError: for a controller that no circuit gives; see `circuit_of`.
    """
    asked = prototype.controller
    if asked is None:
        raise ValueError("the prototype has no [controller]")
    found: dict[tuple[float, ...], AnalogueController] = {}
    for resistors, capacitors in SERIES:
        told(f"analogue controller, {resistors}")
        one = circuit_of(asked, resistors, capacitors)
        values = tuple(one.parts.values())
        if values not in found:
            found[values] = _certified(prototype, asked, masses_kg, one)
    return tuple(found.values())


def _certified(
    prototype: Prototype, asked: Controller, masses_kg: tuple[float, float], circuit: Circuit
) -> AnalogueController:
    realised, wanted = circuit.law, asked.transfer_function()
    static = wanted.numerator(0) / wanted.denominator(0)
    errors = {
        "gain_A_per_V": nearest(circuit.gain_A_per_V / static - 1),
        "response": deviation(circuit, asked),
    }
    certificate = certify(prototype.but(controller=realised), *masses_kg)
    reached = certificate.guaranteed
    capacitors = CAPACITORS if circuit.has_capacitors else CAPACITORS[:1]
    verdicts = tuple(with_tolerance(prototype, masses_kg, circuit, r, c) for r in RESISTORS for c in capacitors)
    return AnalogueController(
        circuit,
        realised,
        errors,
        certificate.stable,
        None if reached is None else reached.bandwidth_Hz,
        None if reached is None else reached.peak_sensitivity,
        verdicts,
    )


def with_tolerance(
    prototype: Prototype, masses_kg: tuple[float, float], circuit: Circuit, resistors: float, capacitor: float
) -> ComponentTolerance:
    """Prove stability for all components within their tolerances and every outer end mass at once, or refute it."""

    def found(verdict: Verdict, reason: str = "", certificate: str = "") -> ComponentTolerance:
        return ComponentTolerance(resistors, capacitor, verdict, reason, certificate)

    for corner in circuit.corners(resistors, capacitor):
        at_corner = certify(prototype.but(controller=corner.law), *masses_kg)
        if not at_corner.stable:
            shown = ", ".join(f"{name} {value:.4g}" for name, value in corner.parts.items())
            return found("refuted", f"with {shown} (SI): {at_corner.reason}")
    family, ranges = _spanned(prototype, circuit, resistors, capacitor)
    box = box_of(ranges | {"outer_end_mass": (exact(masses_kg[0]), exact(masses_kg[1]))})
    verdict = certify_box(family, box, _BUDGET, volumes=False)
    if verdict.stable:
        return found("proved", certificate=verdict.certificate)
    return found(
        "not proved",
        "no combination that was looked at of components at the ends of their tolerances is unstable, but the box of"
        " independent gain and time constants that encloses them is not proved",
    )


def _spanned(
    prototype: Prototype, circuit: Circuit, resistors: float, capacitor: float
) -> tuple[Family, dict[str, tuple[float | fmpq, float | fmpq]]]:
    """The loop over gain and coefficients of every stage, s and s^2, and what these can be within the tolerances."""
    ranges: dict[str, tuple[float | fmpq, float | fmpq]] = {"controller_gain": circuit.gain_span(resistors, capacitor)}
    nominal = []
    for k, stage in enumerate(circuit.stages, 1):
        nominal.append({name: value for name, value in stage.exact._asdict().items() if name[1:] in "12" and value})
        spans = stage.spans(resistors, capacitor)._asdict()
        ranges |= {f"stage_{k}_{name}": spans[name] for name in nominal[-1]}
    return rig_family(prototype.but(controller=circuit.law), nominal), ranges
