"""Analogue controllers of preferred values, proved again as they are realised."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from flint import fmpq

from beamdesign.controllers import Controller
from beamdesign.polynomial import exact
from beamdesign.proof.box import box_of, certify_box
from beamdesign.proof.certifying import certify
from beamdesign.prototype import Prototype
from beamdesign.specification.lag_amplifier import LagAmplifier, lag_amplifier
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
        capacitor: relative tolerance of the capacitor.
        verdict: "proved" for the box of gain, pole and zero that holds all components; "refuted" by components at ends
            of their tolerances; "not proved" otherwise.
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
        amplifier: its components.
        controller: what they realise.
        errors: relative deviation of gain, pole and zero from the controller that was asked for.
        stable: whether the nominal realisation is proved stable over the range of outer end masses.
        bandwidth_Hz: proved for the nominal realisation; None where not stable.
        peak_sensitivity: proved likewise.
        tolerances: verdicts for usual tolerances of components.
    """

    amplifier: LagAmplifier
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
        ValueError: for a controller that the circuit cannot give; see `lag_amplifier`.
    """
    asked = prototype.controller
    if asked is None:
        raise ValueError("the prototype has no [controller]")
    if reason := asked.lacks("lag"):
        raise ValueError(f"the circuit is that of a lag, and {asked.kind!r} {reason}")
    found: dict[tuple[float | None, ...], AnalogueController] = {}
    for resistors, capacitors in SERIES:
        told(f"analogue controller, {resistors}")
        one = lag_amplifier(asked, resistors, capacitors)
        values = (one.input_ohm, one.feedback_ohm, one.sense_ohm, one.shunt_ohm, one.capacitance_F)
        if values not in found:
            found[values] = _certified(prototype, asked, masses_kg, one)
    return tuple(found.values())


def _certified(
    prototype: Prototype, asked: Controller, masses_kg: tuple[float, float], amplifier: LagAmplifier
) -> AnalogueController:
    realised = amplifier.controller
    wanted, given = asked.model_dump(), realised.model_dump()
    errors = {key: given[key] / wanted[key] - 1 for key in wanted if key != "kind"}
    certificate = certify(prototype.but(controller=realised), *masses_kg)
    reached = certificate.guaranteed
    capacitors = CAPACITORS if realised.lag else CAPACITORS[:1]
    verdicts = tuple(with_tolerance(prototype, masses_kg, amplifier, r, c) for r in RESISTORS for c in capacitors)
    return AnalogueController(
        amplifier,
        realised,
        errors,
        certificate.stable,
        None if reached is None else reached.bandwidth_Hz,
        None if reached is None else reached.peak_sensitivity,
        verdicts,
    )


def with_tolerance(
    prototype: Prototype, masses_kg: tuple[float, float], amplifier: LagAmplifier, resistors: float, capacitor: float
) -> ComponentTolerance:
    """Prove stability for all components within their tolerances and every outer end mass at once, or refute it."""
    realised = prototype.but(controller=amplifier.controller)
    ranges: dict[str, tuple[float | fmpq, float | fmpq]] = {
        **amplifier.spans(resistors, capacitor),
        "outer_end_mass": (exact(masses_kg[0]), exact(masses_kg[1])),
    }
    verdict = certify_box(realised, box_of(ranges), _BUDGET, volumes=False)
    if verdict.stable:
        return ComponentTolerance(resistors, capacitor, "proved", "", verdict.certificate)
    for corner in amplifier.corners(resistors, capacitor):
        at_corner = certify(prototype.but(controller=corner.controller), *masses_kg)
        if not at_corner.stable:
            values = (corner.input_ohm, corner.feedback_ohm, corner.sense_ohm, corner.shunt_ohm, corner.capacitance_F)
            shown = ", ".join(f"{v:.4g}" for v in values if v is not None)
            reason = f"with R1, Rf, Rs, R2, C of {shown} (SI): {at_corner.reason}"
            return ComponentTolerance(resistors, capacitor, "refuted", reason, "")
    reason = (
        "no combination of components at the ends of their tolerances is unstable, but the box of independent"
        " gain, pole"
        " and zero that encloses them is not proved"
    )
    return ComponentTolerance(resistors, capacitor, "not proved", reason, "")
