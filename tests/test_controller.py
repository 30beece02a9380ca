"""Controllers: exact transfer functions against arithmetic on complex numbers and against python-control."""

from fractions import Fraction
from math import pi

import control
import numpy as np
import pytest
from flint import fmpq
from hypothesis import given
from hypothesis import strategies as st

from beamdesign.controllers import Lag, Proportional, Section, Structured
from beamdesign.controllers.protocol import form_of

FREQUENCIES_HZ = np.geomspace(1e-3, 1e3, 60)
breaks = st.floats(1e-3, 1e3)


def response(controller, frequency_Hz: np.ndarray) -> np.ndarray:
    law = controller.transfer_function()
    s = 2j * pi * frequency_Hz
    top, bottom = (np.polyval([float(c) for c in reversed(p.coeffs())], s) for p in (law.numerator, law.denominator))
    return top / bottom


@given(gain=st.floats(1e-4, 1e2), pole=breaks, zero=breaks)
def test_a_lag_is_the_quotient_of_two_breaks(gain, pole, zero):
    expected = gain * (1 + 1j * FREQUENCIES_HZ / zero) / (1 + 1j * FREQUENCIES_HZ / pole)
    found = response(Lag(gain_A_per_V=gain, pole_Hz=pole, zero_Hz=zero), FREQUENCIES_HZ)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_figures_are_taken_exactly():
    """Neither the gain at rest nor the breaks are rounded on the way: a figure is the decimal that is written down."""
    law = Lag(gain_A_per_V=0.1, pole_Hz=1.75, zero_Hz=26.0).transfer_function()
    assert law.numerator(0) / law.denominator(0) == fmpq(1, 10)
    for polynomial, frequency_Hz in ((law.numerator, 26.0), (law.denominator, 1.75)):
        decimal = Fraction(repr(2 * pi * frequency_Hz))
        assert polynomial(-fmpq(decimal.numerator, decimal.denominator)) == 0


def test_a_proportional_controller_has_no_dynamics():
    law = Proportional(gain_A_per_V=0.024).transfer_function()
    assert law.numerator.degree() == law.denominator.degree() == 0
    np.testing.assert_array_equal(response(Proportional(gain_A_per_V=0.024), FREQUENCIES_HZ), 0.024)


@pytest.mark.parametrize("controller", [Proportional(gain_A_per_V=0.02), Lag(gain_A_per_V=0.3, pole_Hz=2, zero_Hz=20)])
def test_python_control_gets_the_same_controller(controller):
    model = controller.control_model()
    assert (model.input_labels, model.output_labels) == (["error_V"], ["current_A"])
    found = control.frequency_response(model, 2 * pi * FREQUENCIES_HZ).frdata.ravel()
    np.testing.assert_allclose(found, response(controller, FREQUENCIES_HZ), rtol=1e-9)


SECTION = Section(zero_Hz=31.0, zero_damping_ratio=0.2, pole_Hz=77.0, pole_damping_ratio=0.6)


@pytest.mark.parametrize(
    "law",
    [
        Proportional(gain_A_per_V=0.123456),
        Lag(gain_A_per_V=0.123456, pole_Hz=1.5, zero_Hz=37.0),
        Structured(gain_A_per_V=0.123456, pole_Hz=1.5, zero_Hz=37.0, section=(SECTION,)),
    ],
    ids=lambda law: law.kind,
)
def test_open_parameters_stand_for_the_record(law):
    """The form that is tuned and the record that is written down are one law, and its slopes are differences."""
    form, variables = law.form()
    s = 2j * pi * FREQUENCIES_HZ
    assert form.record(variables) == law
    np.testing.assert_allclose(form.responses(variables, s)[0], response(law, FREQUENCIES_HZ), rtol=1e-12)
    slopes = form.slopes(variables, s)[0]
    for k, unit in enumerate(np.eye(form.size)):
        up, down = (form.responses(variables + side * 1e-6 * unit, s)[0] for side in (1, -1))
        np.testing.assert_allclose(slopes[:, k], (up - down) / 2e-6, rtol=1e-6, atol=1e-8 * np.abs(up).max())
    assert (form.lower < form.upper).all()


def test_rounded_parameters_are_short_and_near():
    record = form_of("lag").record(np.log([0.1438141592, 1.138087654, 37.54341234]))
    assert record == Lag(gain_A_per_V=0.143814, pole_Hz=1.13809, zero_Hz=37.5434)


@pytest.mark.parametrize(
    "law", [Lag(gain_A_per_V=0.1, pole_Hz=1.75, zero_Hz=26.0), Lag(gain_A_per_V=0.01, pole_Hz=12.3, zero_Hz=0.6)]
)
def test_what_its_breaks_are_said_to_do_is_what_its_response_does(law: Lag):
    meanings = {name: (value, meaning) for name, value, meaning in law.rows()}
    low, high = sorted(("pole", "zero"), key=lambda name: getattr(law, f"{name}_Hz"))
    between, far = np.abs(response(law, np.array([np.sqrt(law.pole_Hz * law.zero_Hz), 1e6])))
    assert ("rises" if between > law.gain_A_per_V else "falls") in meanings[low][1]
    assert "level" in meanings[high][1]
    value, share = meanings[f"gain above the {high}"]
    assert float(value.split()[0]) == pytest.approx(1e3 * far, rel=1e-3)
    ratio = float(share.split()[0].removeprefix("1/"))
    assert (1 / ratio if share.startswith("1/") else ratio) == pytest.approx(far / law.gain_A_per_V, rel=5e-3)
