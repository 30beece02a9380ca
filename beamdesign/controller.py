"""Controllers as exact transfer functions, as frequency responses and as python-control models."""

from dataclasses import dataclass
from math import pi
from typing import TYPE_CHECKING

import numpy as np
from flint import fmpq_mat, fmpq_poly

from beamdesign.observer import Observer
from beamdesign.polynomial import exact
from beamdesign.prototype import Controller, Lag, Proportional, Structured
from beamdesign.records import InputError

if TYPE_CHECKING:
    import control

ERRORS = {
    "displacement_m": "error_V",
    "inner_displacement_m": "inner_displacement_error_m",
    "load_pressure_Pa": "load_pressure_error_Pa",
}
"""What a controller is given of each thing sensed: what it should be, zero but for the command, less what it is."""


@dataclass(frozen=True)
class TransferFunction:
    """A controller from error voltage (V) to current (A) as a ratio of exact polynomials in s."""

    numerator: fmpq_poly
    denominator: fmpq_poly


@dataclass(frozen=True)
class SensedLaw:
    """A controller of one or more sensors over one denominator, exact.

    Attributes:
        sensors: what it senses, see `beamdesign.observer.SENSED`; the first is the displacement.
        numerators: one per sensor: to current (A) from error volts, then from what else is sensed (m, Pa), with its
            sign turned.
        denominator: for an `Observer` det(sI - a), whether or not each of its states shows.
    """

    sensors: tuple[str, ...]
    numerators: tuple[fmpq_poly, ...]
    denominator: fmpq_poly


def _break(frequency_Hz: float) -> fmpq_poly:
    """1 + s / (2 pi f), with the decimal form of 2 pi f taken as exact."""
    return fmpq_poly([1, 1 / exact(2 * pi * frequency_Hz)])


def _pair(frequency_Hz: float, damping_ratio: float) -> fmpq_poly:
    """1 + 2 d s / (2 pi f) + (s / (2 pi f))^2 likewise."""
    natural = exact(2 * pi * frequency_Hz)
    return fmpq_poly([1, 2 * exact(damping_ratio) / natural, 1 / natural**2])


def sensed_law(controller: Controller) -> SensedLaw:
    """The law of any controller, from everything that it senses to its current."""
    if not isinstance(controller, Observer):
        law = transfer_function(controller)
        return SensedLaw(("displacement_m",), (law.numerator,), law.denominator)
    n, gain = controller.order, exact(controller.gain_A_per_V)
    a = fmpq_mat(n, n, [exact(value) for row in controller.a for value in row])
    c = [exact(value) for value in controller.c]
    denominator = a.charpoly() if n else fmpq_poly([1])

    def numerator(sensor: int) -> fmpq_poly:
        through = exact(controller.d[sensor]) * denominator
        if n:  # det(sI - a + b c) = det(sI - a) + c adj(sI - a) b
            b = [exact(row[sensor]) for row in controller.b]
            through += (a - fmpq_mat(n, n, [value * weight for value in b for weight in c])).charpoly() - denominator
        return gain * through

    return SensedLaw(controller.sensors, tuple(numerator(k) for k in range(len(controller.sensors))), denominator)


def transfer_function(controller: Controller) -> TransferFunction:
    """K_sa C(s) of a controller record; C(0) = 1 but for an `Observer`.

    Raises:
        InputError: for an `Observer` with added sensors, which `sensed_law` is for.
    """
    gain = exact(controller.gain_A_per_V)
    if isinstance(controller, Observer):
        law = sensed_law(without_added_sensors(controller, "prototype", "one transfer function"))
        return TransferFunction(law.numerators[0], law.denominator)
    if isinstance(controller, Proportional):
        return TransferFunction(fmpq_poly([gain]), fmpq_poly([1]))
    numerator, denominator = gain * _break(controller.zero_Hz), _break(controller.pole_Hz)
    for section in controller.section if isinstance(controller, Structured) else ():
        numerator *= _pair(section.zero_Hz, section.zero_damping_ratio)
        denominator *= _pair(section.pole_Hz, section.pole_damping_ratio)
    return TransferFunction(numerator, denominator)


def sensor_responses(controller: Controller, frequency_Hz: np.ndarray) -> dict[str, np.ndarray]:
    """Current over gain_A_per_V for each thing sensed, with its sign turned: (N,) complex, per V, m or Pa."""
    if not isinstance(controller, Observer):
        return {"displacement_m": shape_response(controller, frequency_Hz)}
    s, n = 2j * pi * np.asarray(frequency_Hz, dtype=float), controller.order
    b, d = np.reshape(controller.b, (n, len(controller.sensors))), np.array(controller.d)
    pencil = s.reshape(-1, 1, 1) * np.eye(n) - np.reshape(controller.a, (n, n))
    inside = np.linalg.solve(pencil, np.broadcast_to(b.astype(complex), (len(pencil), *b.shape)))
    shapes = np.einsum("i,kip->kp", np.array(controller.c), inside) + d
    return {name: shapes[:, k].reshape(s.shape) for k, name in enumerate(controller.sensors)}


def shape_response(controller: Controller, frequency_Hz: np.ndarray) -> np.ndarray:
    """C(s) of unit static gain at the given frequencies (N,), complex.

    Of an `Observer` the response to the displacement sensor's error, over gain_A_per_V, whatever its static gain.
    """
    if isinstance(controller, Observer):
        return sensor_responses(controller, frequency_Hz)["displacement_m"]
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
    """K_sa C(s) far above all breaks, A/V; of an `Observer` the size of its direct gain on the displacement sensor."""
    gain = controller.gain_A_per_V
    if isinstance(controller, Observer):
        return gain * abs(controller.d[0])
    if not isinstance(controller, Proportional):
        gain *= controller.pole_Hz / controller.zero_Hz
    for section in controller.section if isinstance(controller, Structured) else ():
        gain *= (section.pole_Hz / section.zero_Hz) ** 2
    return gain


def without_sections(controller: Controller, source: object, what: str) -> Proportional | Lag:
    """The controller where it is proportional or a lag, without second-order sections or matrices.

    Args:
        controller: any.
        source: file or argument that it comes from, for the message.
        what: cannot be done with another, in words.

    Raises:
        InputError: where it is another.
    """
    if isinstance(controller, Structured | Observer):
        raise InputError(str(source), [("controller.kind", f"{controller.kind!r} is not for {what}; give a lag")])
    return controller


def without_added_sensors(controller: Controller, source: object, what: str) -> Controller:
    """The controller where it hears the displacement alone; arguments as of `without_sections`.

    Raises:
        InputError: where it is an `Observer` with more sensors.
    """
    if isinstance(controller, Observer) and controller.added:
        reason = f"{', '.join(controller.added)}: added sensors are not for {what}; keep 'displacement_m' alone"
        raise InputError(str(source), [("controller.sensors", reason)])
    return controller


def control_model(controller: Controller) -> "control.StateSpace":
    """The controller as a python-control state space from `error_V` to `current_A`.

    Sections stand in series: one polynomial of their product would lose digits. An `Observer` keeps its matrices and
    has one more input for each added sensor, `inner_displacement_error_m` or `load_pressure_error_Pa`: what that
    sensor reads with its sign turned.
    """
    import control

    if isinstance(controller, Observer):
        n, p, gain = controller.order, len(controller.sensors), controller.gain_A_per_V
        return control.ss(
            np.reshape(controller.a, (n, n)), np.reshape(controller.b, (n, p)),
            gain * np.reshape(controller.c, (1, n)), gain * np.reshape(controller.d, (1, p)),
            inputs=[ERRORS[name] for name in controller.sensors], outputs=["current_A"], name="controller",
        )  # fmt: skip
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
