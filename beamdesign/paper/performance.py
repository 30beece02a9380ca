"""What the paper says its loops achieve, recomputed: bandwidth, gain of the lag, static error, phase lead."""

from dataclasses import dataclass

import numpy as np

from beamdesign.loop import LoopAtMass, critical_gain, loop
from beamdesign.paper.claim import Claim
from beamdesign.paper.rig import INNER_END_MASS_KG, LAG_POLE_HZ, LAG_ZERO_HZ, OUTER_END_MASS_KG, lag, proportional
from beamdesign.prototype import Prototype
from beamdesign.report.compliance_scale import decibels

CM_PER_100_N = 1e4
"""Static errors are printed in cm under 100 N: that many of them make one m/N."""


def at(prototype: Prototype, outer_end_mass_kg: float = 0.0) -> LoopAtMass:
    """The closed loop of a prototype at one outer end mass."""
    return loop(prototype).at(outer_end_mass_kg)


@dataclass(frozen=True)
class Bandwidth:
    """A frequency up to which the -100 dB limit is met.

    Attributes:
        case: loop in words.
        gain_mA_per_V: gain it is computed at.
        outer_end_mass_kg: mass on the outer tip.
        inner_end_mass_kg: mass added to the inner tip.
        paper_Hz: printed bandwidth.
        model_Hz: recomputed one.
        note: about the gain, and the reason where the two differ.
    """

    case: str
    gain_mA_per_V: float
    outer_end_mass_kg: float
    inner_end_mass_kg: float
    paper_Hz: float
    model_Hz: float
    note: str

    def fields(self) -> dict[str, object]:
        """The row as it stands in the JSON result."""
        return {
            "case": self.case,
            "gain_mA_per_V": self.gain_mA_per_V,
            "outer_end_mass_kg": self.outer_end_mass_kg,
            "inner_end_mass_kg": self.inner_end_mass_kg,
            "paper": self.paper_Hz,
            "model": self.model_Hz,
        }


def bandwidths() -> list[Bandwidth]:
    """The three bandwidths the paper states."""
    limit = 1e3 * critical_gain(lag(200.0, INNER_END_MASS_KG), OUTER_END_MASS_KG).gain_A_per_V
    stable = float(np.floor(min(limit, 200.0)))
    read_off = "Read off a plot in the paper; at the model's own critical gain it is {:.1f} Hz."
    cases = [
        ("proportional", proportional(24.0), 24.0, 0.0, 4.0, read_off),
        ("lag", lag(300.0), 300.0, 0.0, 10.0, read_off),
        (
            "lag, 6.8 kg outer, 4.5 kg inner", lag(stable, INNER_END_MASS_KG), stable, OUTER_END_MASS_KG, 8.0,
            f"The printed 200 mA/V lies above the model's critical gain with 4.5 kg, {limit:.1f} mA/V. " + read_off,
        ),
    ]  # fmt: skip
    rows = []
    for name, rig, gain, mass, published, note in cases:
        assert rig.controller is not None
        edge = critical_gain(rig, mass).gain_A_per_V * (1 - 1e-9)
        best = at(rig.but(controller=rig.controller.but(gain_A_per_V=edge)), mass).bandwidth_Hz()
        inner = rig.payload.inner_end_mass_kg
        rows.append(Bandwidth(name, gain, mass, inner, published, at(rig, mass).bandwidth_Hz(), note.format(best)))
    return rows


def bandwidth_claims(rows: list[Bandwidth]) -> list[Claim]:
    """The bandwidths as claims."""
    sources = ("System Model, Fig. 9", "Compensator Design, Fig. 10", "Effect of a Load Mass, Fig. 14")
    return [
        Claim("bandwidth", f"{r.case} at {r.gain_mA_per_V:g} mA/V", "Hz", r.paper_Hz, r.model_Hz, source, 1.0, r.note)
        for r, source in zip(rows, sources, strict=True)
    ]


def lag_advantage_dB(frequency_Hz: np.ndarray) -> np.ndarray:
    """By how many dB lag at 300 mA/V lowers the compliance against proportional control at 24 mA/V."""
    before, after = (at(rig).compliance_response(frequency_Hz) for rig in (proportional(24.0), lag(300.0)))
    return decibels(before) - decibels(after)


def controller_ratio_dB(frequency_Hz: np.ndarray) -> np.ndarray:
    """Magnitude of the lag controller at 300 mA/V relative to a gain of 24 mA/V."""
    s = 1j * np.asarray(frequency_Hz)
    return 20 * np.log10(np.abs(300.0 / 24.0 * (1 + s / LAG_ZERO_HZ) / (1 + s / LAG_POLE_HZ)))


def lag_claims() -> list[Claim]:
    """Improvement by the lag compensator at the frequencies the paper names."""
    frequencies = np.array([0.1, 1.0, 2.0, 20.0, 25.0])
    printed = [22.0, 22.0, 20.0, 4.0, 0.0]
    notes = [
        "The ratio of the two gains, 300 / 24, is {:.1f} dB here.",
        "Printed for all below 2 Hz; the pole at 1.75 Hz acts already and leaves the controllers {:.1f} dB apart.",
        "The pole at 1.75 Hz is passed: the controllers themselves are {:.1f} dB apart.",
        "The controllers themselves are {:.1f} dB apart, and closing the loop makes less of it.",
        "The controllers are {:.1f} dB apart. Far above the zero the lag's gain, 300 x 1.75 / 26 = 20.2 mA/V, is the"
        " smaller one, and the lag loop does slightly worse.",
    ]
    rows = zip(
        frequencies, printed, lag_advantage_dB(frequencies), controller_ratio_dB(frequencies), notes, strict=True
    )
    return [
        Claim(
            "lag against proportional", f"improvement at {frequency:g} Hz", "dB", paper, float(model),
            "Compensator Design, Fig. 10", 1.0, note.format(ratio),
        )
        for frequency, paper, model, ratio, note in rows
    ]  # fmt: skip


def static_errors_cm_per_100N() -> tuple[float, float]:
    """Static deflection under 100 N in cm: proportional at 24 mA/V, lag at 300 mA/V."""
    return (
        CM_PER_100_N * at(proportional(24.0)).static_compliance(),
        CM_PER_100_N * at(lag(300.0)).static_compliance(),
    )


def static_claims() -> list[Claim]:
    """The two printed static errors, and what a static error goes with."""
    slow, fast = static_errors_cm_per_100N()
    halved = at(lag(150.0)).static_compliance() / at(lag(300.0)).static_compliance()
    return [
        Claim(
            "static error", "lag, under 100 N", "cm", 0.00085, fast, "Compensator Design", 1e-5,
            f"The printed figure is {decibels(0.00085 / CM_PER_100_N):.1f} dB, above the limit the same sentence says"
            " is met. A hundredth of it would agree.",
        ),
        Claim(
            "static error", "lowest predicted, under 100 N", "cm", 0.00005, fast, "Experiments", 1e-5,
            f"Printed as 0.0005 mm. Proportional control at 24 mA/V leaves {slow:.3g} cm.",
        ),
        Claim(
            "static error", "ratio of static errors at half the gain", "times", 2.0, halved, "System Model", 0.1,
            "Inversely proportional to the gain, as the paper says, to the leakage's share of the loop gain.",
        ),
    ]  # fmt: skip


def phase_lead_deg(frequency_Hz: np.ndarray) -> np.ndarray:
    """Phase of x / F_d of the lag loop at its measured critical gain, degrees; positive is lead."""
    return np.degrees(np.angle(at(lag(200.0)).compliance_response(frequency_Hz)))
