"""What the paper says about each of its figures 8 to 16, beside what the model says, and whether it holds.

A number holds as a `Claim` agrees: within 5 % or the rounding of the print. What is said in words holds where the model
does the same.

The paper's measured points are lost. Where it measured, from 0 to 10 Hz under 50 to 500 N peak to peak, the response of
the nonlinear rig (orifices, unequal piston sides, the sensor's filter) stands in for them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import sqrt

import numpy as np

from beamdesign.loop import LoopAtMass, critical_gain
from beamdesign.plant.harmonic_balance import forced_motion
from beamdesign.plant.linear_reach import with_published_effects
from beamdesign.prototype import COMPLIANCE_LIMIT_M_PER_N, Prototype
from beamdesign.validation.paper.claims import (
    Claim,
    at,
    gain_cliff,
    lag_advantage_dB,
    stable_masses,
    static_errors_cm_per_100N,
)
from beamdesign.validation.paper.rig import (
    INNER_END_MASS_KG,
    OUTER_END_MASS_KG,
    filtered,
    filtered_smaller_side,
    lag,
    proportional,
)

FORCES_PEAK_TO_PEAK_N = (50.0, 500.0)
TESTED_HZ = (0.5, 1.0, 2.0, 4.0, 7.0, 10.0)


@dataclass(frozen=True)
class MeasuredCase:
    """A case of Figures 15 and 16.

    Attributes:
        rig: with the 400 Hz filter, at the measured largest gain; the gain of the tests is not printed.
        outer_end_mass_kg: payload.
        measured_mA_per_V: the gain at which it began to oscillate.
    """

    rig: Prototype
    outer_end_mass_kg: float
    measured_mA_per_V: float

    def predicted_mA_per_V(self) -> float:
        """Critical gain with the filter and the smaller side of the piston."""
        return 1e3 * critical_gain(filtered_smaller_side(self.rig), self.outer_end_mass_kg).gain_A_per_V


MEASURED = {
    15: MeasuredCase(filtered(lag(200.0)), 0.0, 200.0),
    16: MeasuredCase(filtered(lag(150.0, INNER_END_MASS_KG)), OUTER_END_MASS_KG, 150.0),
}


@cache
def nonlinear_compliance(figure: int, force_peak_to_peak: float) -> np.ndarray:
    """|x / F_d| in m/N at `TESTED_HZ` on the nonlinear rig, first harmonic, under a force of so many N peak to peak."""
    case = MEASURED[figure]
    rig, force = with_published_effects(case.rig), force_peak_to_peak / 2
    found = [forced_motion(rig, force, f, case.outer_end_mass_kg, harmonics=3).amplitude_m for f in TESTED_HZ]
    return np.array(found) / force


RESOLUTION_M = 5e-6
"""Of the paper's displacement measurement, section Experiments."""


@dataclass(frozen=True)
class FigureClaim:
    """One thing the paper says about a figure.

    Attributes:
        figure: its number.
        claim: what it is about.
        paper: what is printed, in our words.
        model: what the model says.
        holds: whether the two agree.
    """

    figure: int
    claim: str
    paper: str
    model: str
    holds: bool


def _number(figure: int, claim: str, paper: float, model: float, unit: str, digit: float = 1.0) -> FigureClaim:
    agrees = Claim("", claim, unit, paper, model, "", digit).agrees
    return FigureClaim(figure, claim, f"{paper:g} {unit}".strip(), f"{model:.3g} {unit}".strip(), agrees)


def _words(figure: int, claim: str, paper: str, model: str, holds: bool) -> FigureClaim:
    return FigureClaim(figure, claim, paper, model, bool(holds))


def pair_Hz(loop: LoopAtMass) -> tuple[float, float]:
    """Frequencies of the slowest complex pole and zero of the open loop, Hz."""
    pole, zero = (
        min(abs(root) for root in roots if root.imag > 0) / (2 * np.pi)
        for roots in (loop.open_loop_poles(), loop.open_loop_zeros())
    )
    return float(pole), float(zero)


def _spike_deg(loop: LoopAtMass) -> float:
    """By how much the phase between pole and zero departs from what it is well outside them, degrees."""
    pole, zero = pair_Hz(loop)
    low, high = min(pole, zero), max(pole, zero)
    frequencies = np.geomspace(low / 2, high * 1.6, 2000)
    phase = np.degrees(np.unwrap(np.angle(loop.loop_response(frequencies))))
    inside = np.interp(sqrt(low * high), frequencies, phase)
    return float(inside - (phase[0] + phase[-1]) / 2)


def root_locus() -> list[FigureClaim]:
    """Figure 8."""
    limit = critical_gain(proportional(24.0))
    poles = np.sort(np.abs(at(proportional(24.0)).poles()))
    return [
        _number(8, "largest stable gain", 24.0, 1e3 * limit.gain_A_per_V, "mA/V"),
        _number(8, "number of roots", 7.0, float(len(poles)), ""),
        _words(
            8, "two roots are very fast and omitted", "two",
            f"{poles[-1]:.0f} rad/s, {poles[-1] / poles[-3]:.1f} times the next", poles[-2] > 2 * poles[-3],
        ),
    ]  # fmt: skip


def proportional_compliance() -> list[FigureClaim]:
    """Figure 9."""
    loop = at(proportional(24.0))
    slow, following = np.sort(np.abs(loop.open_loop_poles()))[:2]
    still = loop.static_compliance()
    return [
        _number(9, "goal met below", 4.0, loop.bandwidth_Hz(), "Hz"),
        _words(
            9, "static displacement small but definite", "levels off",
            f"{still:.2g} m/N, {20 * np.log10(still / COMPLIANCE_LIMIT_M_PER_N):.0f} dB from the goal",
            0 < still < COMPLIANCE_LIMIT_M_PER_N,
        ),
        _words(
            9, "caused by an open-loop pole near the origin", "not zero", f"-{slow:.2g} rad/s, next {following:.0f}",
            0 < slow < 0.05 * following,
        ),
    ]  # fmt: skip


def lag_compliance() -> list[FigureClaim]:
    """Figure 10."""
    claims = [_number(10, "goal met below", 10.0, at(lag(300.0)).bandwidth_Hz(), "Hz")]
    for frequency, printed in ((0.5, 22.0), (2.0, 20.0), (20.0, 4.0)):
        gained = float(lag_advantage_dB(np.array([frequency]))[0])
        claims.append(_number(10, f"better than proportional at {frequency:g} Hz", printed, gained, "dB"))
    above = float(lag_advantage_dB(np.geomspace(25.0, 100.0, 200)).max())
    claims.append(_words(10, "no better above 25 Hz", "none", f"{above:.2g} dB at most up to 100 Hz", above < 0.5))
    claims.append(_number(10, "static error under 100 N", 8.5e-4, static_errors_cm_per_100N()[1], "cm", 1e-5))
    return claims


def lag_open_loop() -> list[FigureClaim]:
    """Figure 11."""
    loop = at(lag(300.0))
    pole, zero = pair_Hz(loop)
    spike = _spike_deg(loop)
    return [
        _number(11, "zero", 50.0, zero, "Hz", 5.0),
        _number(11, "pole", 55.0, pole, "Hz", 5.0),
        _words(11, "phase spike between them", "positive", f"{spike:+.0f} degrees", spike > 0),
    ]


def loaded_open_loop() -> list[FigureClaim]:
    """Figure 12."""
    loop, cliff = at(lag(300.0), OUTER_END_MASS_KG), gain_cliff()
    pole, zero = pair_Hz(loop)
    spike = _spike_deg(loop)
    limit = critical_gain(lag(300.0), OUTER_END_MASS_KG)
    onset_kg, onset_Hz = stable_masses(300.0, 0.0)[0]
    return [
        _words(12, "pole and zero change places", "pole below", f"pole {pole:.0f}, zero {zero:.0f} Hz", pole < zero),
        _words(12, "phase spike", "negative", f"{spike:+.0f} degrees", spike < 0),
        _words(
            12, "unstable at 300 mA/V with 6.8 kg", "unstable", f"lost from {onset_kg:.2f} kg, at {onset_Hz:.0f} Hz",
            not loop.stable,
        ),
        _words(
            12, "the oscillation moves to the outer beam's frequency", f"pole, {pole:.0f} Hz",
            f"{limit.frequency_Hz:.1f} Hz", abs(limit.frequency_Hz / pole - 1) < 0.05,
        ),
        _number(12, "immediate loss of gain", 75.0, 100 * cliff.reduction, "%"),
    ]  # fmt: skip


def loaded_compliance() -> list[FigureClaim]:
    """Figure 13."""
    bare, loaded = (1e3 * critical_gain(lag(300.0), mass).gain_A_per_V for mass in (0.0, OUTER_END_MASS_KG))
    return [
        _number(13, "largest gain with 6.8 kg", 10.0, loaded, "mA/V"),
        _number(13, "lower than without the mass", 30.0, bare / loaded, "times"),
    ]


def relieved_compliance() -> list[FigureClaim]:
    """Figure 14."""
    rig = lag(200.0, INNER_END_MASS_KG)
    limit = 1e3 * critical_gain(rig, OUTER_END_MASS_KG).gain_A_per_V
    loaded = 1e3 * critical_gain(lag(10.0), OUTER_END_MASS_KG).gain_A_per_V
    loop = at(lag(float(np.floor(min(limit, 200.0))), INNER_END_MASS_KG), OUTER_END_MASS_KG)
    return [
        _number(14, "largest gain with 4.5 kg inside", 200.0, limit, "mA/V"),
        _number(14, "gain regained", 20.0, limit / loaded, "times"),
        _number(14, "goal met up to", 8.0, loop.bandwidth_Hz(), "Hz"),
    ]


def _measured(figure: int) -> list[FigureClaim]:
    """Figures 15 and 16: the points are lost, so the tests' range is worked out with the nonlinear rig."""
    case = MEASURED[figure]
    loop = at(case.rig, case.outer_end_mass_kg)
    frequencies = np.array(TESTED_HZ)
    linear = loop.compliance_response(frequencies)
    lead = np.degrees(np.angle(linear))
    off = np.array([nonlinear_compliance(figure, force) / np.abs(linear) - 1 for force in FORCES_PEAK_TO_PEAK_N])
    low, middle = (
        np.abs(loop.compliance_response(np.geomspace(*ends, 200))).max() for ends in ((0.1, 10.0), (10.0, 100.0))
    )
    fast = float(np.abs(loop.compliance_response(np.array([1000.0])))[0])
    hidden = abs(linear[TESTED_HZ.index(2.0)]) * FORCES_PEAK_TO_PEAK_N[1]
    claims = [
        _words(
            figure, "tests of 50 to 500 N p-p, 0 to 10 Hz, agree with the linear model", "well",
            f"nonlinear rig within {100 * np.abs(off).max():.0f} %", np.abs(off).max() < 0.1,
        ),
        _words(
            figure, "displacement leads force", "lead",
            f"{lead.min():.0f} to {lead.max():.0f} degrees, {TESTED_HZ[0]:g} to {TESTED_HZ[-1]:g} Hz", lead.min() > 0,
        ),
        _words(
            figure, "rejection better at 0 to 10 Hz than at 10 to 100 Hz", "considerably",
            f"worst {low:.2g} against {middle:.2g} m/N", low < middle / 2,
        ),
        _words(figure, "bending minimal at high frequency", "minimal", f"{fast:.2g} m/N at 1000 Hz", fast < low),
        _number(
            figure, "largest gain, measured", case.measured_mA_per_V, case.predicted_mA_per_V(), "mA/V",
        ),
    ]  # fmt: skip
    if figure == 15:
        claims += [
            _words(
                15, "below 2 Hz the motion is lost in noise", f"resolution {1e6 * RESOLUTION_M:g} um",
                f"{1e6 * hidden:.2g} um p-p under 500 N p-p at 2 Hz", hidden < RESOLUTION_M,
            ),
            _number(15, "predicted static error under 100 N", 0.5, 1e8 * loop.static_compliance(), "um", 0.1),
        ]  # fmt: skip
    return claims


_CHECKS: dict[int, Callable[[], list[FigureClaim]]] = {
    8: root_locus,
    9: proportional_compliance,
    10: lag_compliance,
    11: lag_open_loop,
    12: loaded_open_loop,
    13: loaded_compliance,
    14: relieved_compliance,
    15: lambda: _measured(15),
    16: lambda: _measured(16),
}
NUMBERS = tuple(_CHECKS)
"""Numbers of the paper's figures that are drawn again."""


@cache
def figure_claims(number: int) -> tuple[FigureClaim, ...]:
    """Everything the paper says about one of its figures, checked.

    Raises:
        KeyError: for a figure that is not drawn here.
    """
    return tuple(_CHECKS[number]())
