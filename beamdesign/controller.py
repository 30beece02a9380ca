"""Controllers as exact transfer functions, and as python-control models."""

from dataclasses import dataclass
from math import pi
from typing import TYPE_CHECKING

from flint import fmpq_poly

from beamdesign.polynomial import exact
from beamdesign.prototype import Lag, Proportional

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


def transfer_function(controller: Proportional | Lag) -> TransferFunction:
    """K_sa C(s) of a controller record; C(0) = 1."""
    gain = exact(controller.gain_A_per_V)
    if isinstance(controller, Lag):
        return TransferFunction(gain * _break(controller.zero_Hz), _break(controller.pole_Hz))
    return TransferFunction(fmpq_poly([gain]), fmpq_poly([1]))


def control_model(controller: Proportional | Lag) -> "control.StateSpace":
    """The controller as a python-control state space from `error_V` to `current_A`."""
    import control

    exact_form = transfer_function(controller)
    numerator, denominator = (
        [float(c) for c in reversed(p.coeffs())] for p in (exact_form.numerator, exact_form.denominator)
    )
    model = control.tf2ss(control.tf(numerator, denominator))
    return control.ss(model.A, model.B, model.C, model.D, inputs=["error_V"], outputs=["current_A"], name="controller")
