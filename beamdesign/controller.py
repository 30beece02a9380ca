"""Controllers as exact transfer functions, as frequency responses and as python-control models."""

from dataclasses import dataclass
from math import pi
from typing import TYPE_CHECKING

import numpy as np
from flint import fmpq_poly

from beamdesign.polynomial import exact
from beamdesign.prototype import Controller, Lag, Proportional, Structured
from beamdesign.records import InputError

if TYPE_CHECKING:
    import control


@dataclass(frozen=True)
class TransferFunction:
    """A controller from error voltage (V) to current (A) as a ratio of exact polynomials in s."""

    numerator: fmpq_poly
    denominator: fmpq_poly


def _break(frequency_Hz: float) -> fmpq_poly:
    """1 + s / (2 pi f), with the decimal form of 2 pi f taken as exact."""
    return fmpq_poly([1, 1 / exact(2 * pi * frequency_Hz)])


def _pair(frequency_Hz: float, damping_ratio: float) -> fmpq_poly:
    """1 + 2 d s / (2 pi f) + (s / (2 pi f))^2 likewise."""
    natural = exact(2 * pi * frequency_Hz)
    return fmpq_poly([1, 2 * exact(damping_ratio) / natural, 1 / natural**2])


def transfer_function(controller: Controller) -> TransferFunction:
    """K_sa C(s) of a controller record; C(0) = 1."""
    gain = exact(controller.gain_A_per_V)
    if isinstance(controller, Proportional):
        return TransferFunction(fmpq_poly([gain]), fmpq_poly([1]))
    numerator, denominator = gain * _break(controller.zero_Hz), _break(controller.pole_Hz)
    for section in controller.section if isinstance(controller, Structured) else ():
        numerator *= _pair(section.zero_Hz, section.zero_damping_ratio)
        denominator *= _pair(section.pole_Hz, section.pole_damping_ratio)
    return TransferFunction(numerator, denominator)


def shape_response(controller: Controller, frequency_Hz: np.ndarray) -> np.ndarray:
    """C(s) of unit static gain at the given frequencies (N,), complex."""
    s = 2j * pi * np.asarray(frequency_Hz, dtype=float)
    if isinstance(controller, Proportional):
        return np.ones_like(s)
    tau = 2 * pi
    shape = (1 + s / (tau * controller.zero_Hz)) / (1 + s / (tau * controller.pole_Hz))
    for section in controller.section if isinstance(controller, Structured) else ():
        zero, pole = s / (tau * section.zero_Hz), s / (tau * section.pole_Hz)
        shape = shape * (1 + 2 * section.zero_damping_ratio * zero + zero**2)
        shape = shape / (1 + 2 * section.pole_damping_ratio * pole + pole**2)
    return np.asarray(shape)


def gain_at_high_frequency(controller: Controller) -> float:
    """K_sa C(s) far above all breaks, A/V."""
    gain = controller.gain_A_per_V
    if not isinstance(controller, Proportional):
        gain *= controller.pole_Hz / controller.zero_Hz
    for section in controller.section if isinstance(controller, Structured) else ():
        gain *= (section.pole_Hz / section.zero_Hz) ** 2
    return gain


def without_sections(controller: Controller, source: object, what: str) -> Proportional | Lag:
    """The controller where it is one without second-order sections.

    Args:
        controller: any.
        source: file or argument that it comes from, for the message.
        what: cannot be done with sections, in words.

    Raises:
        InputError: where it has sections.
    """
    if isinstance(controller, Structured):
        raise InputError(str(source), [("controller.kind", f"'structured' is not for {what}; give a lag")])
    return controller


def control_model(controller: Controller) -> "control.StateSpace":
    """The controller as a python-control state space from `error_V` to `current_A`.

    Sections stand in series: one polynomial of their product would lose digits.
    """
    import control

    if isinstance(controller, Structured):
        lag = Lag(gain_A_per_V=controller.gain_A_per_V, pole_Hz=controller.pole_Hz, zero_Hz=controller.zero_Hz)
        parts = [transfer_function(lag)]
        parts += [
            TransferFunction(_pair(s.zero_Hz, s.zero_damping_ratio), _pair(s.pole_Hz, s.pole_damping_ratio))
            for s in controller.section
        ]
    else:
        parts = [transfer_function(controller)]
    model = _state_space(parts[0])
    for part in parts[1:]:
        model = _state_space(part) * model
    return control.ss(model.A, model.B, model.C, model.D, inputs=["error_V"], outputs=["current_A"], name="controller")


def _state_space(exact_form: TransferFunction) -> "control.StateSpace":
    import control

    numerator, denominator = (
        [float(c) for c in reversed(p.coeffs())] for p in (exact_form.numerator, exact_form.denominator)
    )
    return control.tf2ss(control.tf(numerator, denominator))
