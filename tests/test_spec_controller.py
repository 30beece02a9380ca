"""The controller as a circuit of preferred values and as a difference equation, both proved as realised."""

from math import pi
from pathlib import Path

import control
import numpy as np
import pytest
import scipy.signal
from flint import fmpq
from hypothesis import given, settings
from hypothesis import strategies as st

from beamdesign.control_models import state_space
from beamdesign.controllers import Lag, Proportional
from beamdesign.proof.replay_any import replay
from beamdesign.prototype import Prototype, read_prototype
from beamdesign.sampled import tustin
from beamdesign.specification.analogue import analogue_controllers, with_tolerance
from beamdesign.specification.difference_equation import DifferenceEquation, difference_equation, sensible_rate_Hz
from beamdesign.specification.lag_amplifier import LagAmplifier, lag_amplifier
from beamdesign.specification.preferred_values import DECADE, neighbours, values_between
from beamdesign.specification.sampled_loop import prove_sampled, sampled_loop

PUBLISHED = Path(__file__).parent.parent / "studies" / "prototypes" / "published_lag.toml"


@pytest.fixture(scope="module")
def rig() -> Prototype:
    """The published rig with a tame lag, stable over a range of payloads."""
    found = read_prototype(PUBLISHED)
    return found.but(
        controller=Lag(gain_A_per_V=0.05, pole_Hz=1.7, zero_Hz=20.0),
        payload=found.payload.but(outer_end_mass_kg=(0.0, 6.8), inner_end_mass_kg=1.9),
    )


def test_series_are_those_of_the_standard() -> None:
    """Some values of IEC 60063:2015, tables 1 and 2."""
    assert DECADE["E6"] == (1.0, 1.5, 2.2, 3.3, 4.7, 6.8)
    assert DECADE["E12"] == (1.0, 1.2, 1.5, 1.8, 2.2, 2.7, 3.3, 3.9, 4.7, 5.6, 6.8, 8.2)
    assert [len(DECADE[name]) for name in ("E6", "E12", "E24", "E96")] == [6, 12, 24, 96]
    assert DECADE["E96"][:6] == (1.0, 1.02, 1.05, 1.07, 1.1, 1.13)
    assert {3.01, 4.99, 6.49, 8.06, 9.76} <= set(DECADE["E96"])


@given(st.floats(1e-9, 1e7))
def test_neighbours_enclose_a_value(value: float) -> None:
    low, high = neighbours("E24", value)
    assert low <= value * (1 + 1e-9)
    assert value <= high * (1 + 1e-9)
    assert high / low < 1.16  # from 1.3 to 1.5, the widest step


def test_values_between_holds_both_ends() -> None:
    assert values_between("E6", 4.7e-8, 1e-6) == pytest.approx(
        [4.7e-8, 6.8e-8, 1e-7, 1.5e-7, 2.2e-7, 3.3e-7, 4.7e-7, 6.8e-7, 1e-6]
    )


def current_by_nodal_analysis(values: LagAmplifier, frequency_Hz: float) -> complex:
    """i/e of the schematic by modified nodal analysis, the amplifiers as nullors.

    Nodes: 1 input, 2 inverting input of U1, 3 its output, 4 between R2 and C; unknowns beside the voltages are the
    currents of the source and of U1's output. The valve current is minus the output over Rs.
    """
    s = 2j * pi * frequency_Hz
    matrix, source = np.zeros((6, 6), complex), np.zeros(6, complex)

    def admittance(a: int, b: int, y: complex) -> None:
        for one, other in ((a, b), (b, a)):
            matrix[one - 1, one - 1] += y
            matrix[one - 1, other - 1] -= y

    admittance(1, 2, 1 / values.input_ohm)
    admittance(2, 3, 1 / values.feedback_ohm)
    if values.shunt_ohm is not None and values.capacitance_F is not None:
        admittance(2, 4, 1 / values.shunt_ohm)
        admittance(4, 3, s * values.capacitance_F)
    else:
        admittance(4, 3, 1.0)
    matrix[0, 4], matrix[4, 0], source[4] = 1, 1, 1  # one volt at node 1
    matrix[2, 5], matrix[5, 1] = 1, 1  # U1 gives what current keeps its input at zero
    return -np.linalg.solve(matrix, source)[2] / values.sense_ohm


@settings(max_examples=25, deadline=None)
@given(
    gain=st.floats(0.02, 1.0),
    pole=st.floats(0.3, 5.0),
    ratio=st.floats(2.0, 60.0),
    series=st.sampled_from(["E24", "E96"]),
)
def test_components_realise_gain_pole_and_zero(gain: float, pole: float, ratio: float, series) -> None:
    asked = Lag(gain_A_per_V=gain, pole_Hz=pole, zero_Hz=ratio * pole)
    values = lag_amplifier(asked, series, "E6")
    for value in (values.input_ohm, values.feedback_ohm, values.sense_ohm, values.shunt_ohm):
        mantissa = float(f"{value:.6e}".split("e")[0])
        assert min(abs(mantissa - step) for step in DECADE[series]) < 1e-6
    realised = values.controller
    for key in ("gain_A_per_V", "pole_Hz", "zero_Hz"):
        assert getattr(realised, key) == pytest.approx(getattr(asked, key), rel=0.06)
    for frequency in (0.1, pole, ratio * pole, 300.0):
        lag = (1 + 1j * frequency / realised.zero_Hz) / (1 + 1j * frequency / realised.pole_Hz)
        assert current_by_nodal_analysis(values, frequency) == pytest.approx(realised.gain_A_per_V * lag, rel=1e-9)


def test_a_proportional_controller_needs_no_capacitor() -> None:
    values = lag_amplifier(Proportional(gain_A_per_V=0.0123), "E96", "E6")
    assert values.capacitance_F is None
    assert current_by_nodal_analysis(values, 50.0) == pytest.approx(0.0123, rel=5e-3)


def test_a_lead_is_refused() -> None:
    with pytest.raises(ValueError, match="its pole lies below its zero"):
        lag_amplifier(Lag(gain_A_per_V=0.1, pole_Hz=20.0, zero_Hz=2.0), "E24", "E6")


@given(st.lists(st.floats(-1, 1), min_size=5, max_size=5))
def test_spans_hold_every_choice_of_components(shares: list[float]) -> None:
    values = LagAmplifier(12e3, 33e3, 10.0, 4.7e3, 1e-6)
    r1, rf, rs, r2, c = (1 + share * tolerance for share, tolerance in zip(shares, [0.05] * 4 + [0.1], strict=True))
    made = LagAmplifier(12e3 * r1, 33e3 * rf, 10.0 * rs, 4.7e3 * r2, 1e-6 * c).controller
    spans = values.spans(0.05, 0.1)
    for name, value in (
        ("controller_gain", made.gain_A_per_V),
        ("controller_pole", 2 * pi * made.pole_Hz),
        ("controller_zero", 2 * pi * made.zero_Hz),
    ):
        low, high = (float(end.p) / float(end.q) for end in spans[name])
        assert low * (1 - 1e-12) <= value <= high * (1 + 1e-12)


def test_the_circuit_is_proved_with_its_tolerances(rig: Prototype, tmp_path: Path) -> None:
    """What is proved is proved again from its text, and holds at components drawn at random, by eigenvalues."""
    found = analogue_controllers(rig, (0.0, 6.8))
    assert {one.amplifier.resistors for one in found} == {"E24", "E96"}
    random = np.random.default_rng(5)
    for one in found:
        assert one.stable
        assert one.peak_sensitivity is not None
        assert max(map(abs, one.errors.values())) < 0.02
        assert {(at.resistors, at.capacitor) for at in one.tolerances} == {
            (r, c) for r in (0.01, 0.05) for c in (0.05, 0.1)
        }
        assert all(at.verdict == "proved" for at in one.tolerances)
        for _ in range(5):
            factors = 1 + random.uniform(-1, 1, 5) * [0.05, 0.05, 0.05, 0.05, 0.1]
            a = one.amplifier
            made = LagAmplifier(
                a.input_ohm * factors[0], a.feedback_ohm * factors[1], a.sense_ohm * factors[2],
                a.shunt_ohm * factors[3], a.capacitance_F * factors[4],
            )  # fmt: skip
            closed = state_space(rig.but(controller=made.controller), random.uniform(0, 6.8))
            assert max(closed.poles().real) < 0
    text = found[0].tolerances[-1].certificate
    (tmp_path / "box.toml").write_text(text)
    assert replay(tmp_path / "box.toml").valid


def test_components_that_make_the_loop_unstable_refute(rig: Prototype) -> None:
    """At 0.98 of the critical gain five per cent are too many."""
    near = rig.but(
        controller=Lag(gain_A_per_V=0.3, pole_Hz=1.75, zero_Hz=26.0), payload=rig.payload.but(inner_end_mass_kg=0.0)
    )
    values = lag_amplifier(near.controller, "E24", "E6")
    found = with_tolerance(near, (0.0, 0.0), values, 0.05, 0.1)
    assert found.verdict == "refuted"
    assert "no mass of the range is stable" in found.reason
    worst = [state_space(near.but(controller=c.controller)).poles().real.max() for c in values.corners(0.05, 0.1)]
    assert max(worst) > 0


def test_the_difference_equation_is_tustins_with_prewarped_breaks() -> None:
    """Against scipy's bilinear transform of the prewarped law, and by its response in closed form."""
    law = Lag(gain_A_per_V=0.2, pole_Hz=1.75, zero_Hz=26.0)
    rate = 500.0
    found = difference_equation(law, rate)
    pole, zero = (2 * rate * np.tan(pi * f / rate) for f in (1.75, 26.0))
    continuous = ([0.2 / zero, 0.2], [1 / pole, 1.0])
    above, below, _ = scipy.signal.cont2discrete(continuous, 1 / rate, method="bilinear")
    assert [found.b0, found.b1] == pytest.approx(above[0], rel=1e-9)
    assert [1.0, found.a1] == pytest.approx(below, rel=1e-9)
    for frequency in (0.0, 1.75, 26.0, 100.0):
        z = np.exp(2j * pi * frequency / rate)
        turned = np.tan(pi * frequency / rate)
        expected = 0.2 * (1 + 1j * turned / np.tan(pi * 26.0 / rate)) / (1 + 1j * turned / np.tan(pi * 1.75 / rate))
        assert (found.b0 + found.b1 / z) / (1 + found.a1 / z) == pytest.approx(expected, rel=1e-6)


def test_as_code_it_steps_as_the_continuous_law() -> None:
    law, rate = Lag(gain_A_per_V=0.2, pole_Hz=1.75, zero_Hz=26.0), 5000.0
    found = difference_equation(law, rate)
    e_before = i_before = 0.0
    current = []
    for _ in range(5000):  # as the specification prints it, after a step of one volt
        i = found.b0 * 1.0 + found.b1 * e_before - found.a1 * i_before
        e_before, i_before = 1.0, i
        current.append(i)
    times = np.arange(5000) / rate
    _, expected = scipy.signal.step(([0.2 / (2 * pi * 26.0), 0.2], [1 / (2 * pi * 1.75), 1.0]), T=times)
    assert np.abs(np.array(current) - expected)[1:].max() < 2e-3 * 0.2


def test_a_law_without_lag_is_a_factor() -> None:
    found = difference_equation(Proportional(gain_A_per_V=0.01), 1000.0)
    assert (found.b0, found.b1, found.a1) == (0.01, 0.0, 0.0)


def test_a_rate_below_twice_the_break_is_refused() -> None:
    with pytest.raises(ValueError, match="not more than twice"):
        difference_equation(Lag(gain_A_per_V=0.2, pole_Hz=1.75, zero_Hz=26.0), 50.0)


@given(st.floats(0.1, 2000), st.floats(0.1, 500))
def test_the_rate_chosen_is_enough(crossover: float, upper: float) -> None:
    rate = sensible_rate_Hz(crossover, upper)
    assert rate >= 40 * crossover
    assert rate >= 10 * upper
    assert rate <= max(1000.0, 2.6 * max(40 * crossover, 10 * upper))


def discrete_poles(rig: Prototype, law: DifferenceEquation, mass: float, delayed: bool) -> np.ndarray:
    """Poles of the sampled loop by python-control: zero-order hold of the plant, feedback of the law."""
    plant = state_space(rig, mass, "plant")["sensor_V", "current_A"]
    held = control.c2d(control.ss(plant.A, plant.B, plant.C, plant.D), law.period_s, "zoh")
    lag = control.tf([law.b0, law.b1], [1, law.a1], law.period_s) if law.a1 else control.tf([law.b0], [1], law.period_s)
    controller = control.ss(lag)
    if delayed:
        controller = controller * control.ss(control.tf([1], [1, 0], law.period_s))
    return control.feedback(held * controller, 1).poles()


@pytest.mark.parametrize("delayed", [False, True])
def test_the_sampled_loop_has_python_controls_poles(rig: Prototype, delayed: bool) -> None:
    law = difference_equation(rig.controller, 1000.0)
    loop = sampled_loop(rig, law, delayed)
    for mass in (fmpq(0), fmpq(5)):
        ours = np.linalg.eigvals(loop.matrix(mass))
        theirs = discrete_poles(rig, law, float(mass.p), delayed)
        for pole in theirs:
            assert np.abs(ours - pole).min() < 1e-5
        assert len(ours) == len(theirs)


def test_the_sampled_loop_is_proved_for_all_payloads(rig: Prototype) -> None:
    law = difference_equation(rig.controller, 2000.0)
    found = prove_sampled(sampled_loop(rig, law, True), 0.0, 6.8)
    assert found.stable
    assert found.pieces > 1
    for mass in np.linspace(0, 6.8, 23):
        assert np.abs(discrete_poles(rig, law, mass, True)).max() < 1


def test_an_enclosure_holds_the_members_of_its_piece(rig: Prototype) -> None:
    loop = sampled_loop(rig, difference_equation(rig.controller, 2000.0), True)
    enclosed = loop.enclosed(fmpq(1), fmpq(3, 2))
    for mass in (fmpq(1), fmpq(5, 4), fmpq(3, 2)):
        one = loop.enclosed(mass, mass)
        n = one.nrows()
        assert all(enclosed[i, j].overlaps(one[i, j]) for i in range(n) for j in range(n))
        assert all(float(enclosed[i, j].rad()) >= 0 for i in range(n) for j in range(n))


def test_a_rate_that_is_too_low_is_told(rig: Prototype) -> None:
    """Found unstable where python-control finds it unstable, at one payload of the range."""
    slow = difference_equation(rig.controller, 100.0)
    found = prove_sampled(sampled_loop(rig, slow, True), 0.0, 6.8)
    worst = max(np.abs(discrete_poles(rig, slow, mass, True)).max() for mass in (0.0, 3.4, 6.8))
    assert worst > 1
    assert found.stable is False
    assert "modulus" in found.reason


def test_the_simulator_runs_the_same_law() -> None:
    """`beamdesign simulate` with `[sampled]` takes the coefficients of the plain rule: at this rate the same to"
    " 1e-4."""
    law = Lag(gain_A_per_V=0.2, pole_Hz=1.75, zero_Hz=26.0)
    found = difference_equation(law, 5000.0)
    assert tuple(c / 0.2 for c in (found.b0, found.b1)) == pytest.approx(tustin(law, 2e-4)[:2], rel=1e-4)
