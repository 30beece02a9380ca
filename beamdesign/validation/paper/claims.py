"""Numbers of the paper beside those of the model: every one that its appendix allows to be recomputed.

The paper's beams and its appendix from the tubes; the roots of the open loop; critical gains under every choice it
leaves open; and what it says its loops achieve: bandwidth, gain of the lag, static error.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import floor
from typing import Any, Literal

import numpy as np

from beamdesign.quantity_text import decibels
from beamdesign.structure import beam
from beamdesign.structure.lumped import lumped_beam
from beamdesign.validation.paper.rig import (
    INNER,
    INNER_END_MASS_KG,
    LAG_POLE_HZ,
    LAG_ZERO_HZ,
    OUTER,
    OUTER_END_MASS_KG,
    PISTON_AREA_M2,
    SMALLER_PISTON_SIDE_M2,
    SUPPLY_PRESSURE_PA,
    GainRow,
    at,
    critical_gain_mA_per_V,
    gain_cliff,
    lag,
    lag_advantage_dB,
    pair_Hz,
    paper_prototype,
    proportional,
)

RELATIVE_AGREEMENT = 0.05
"""Most of the paper's numbers were read off plots; within 5 % the model is said to agree."""
CM_PER_100_N = 1e4
"""Static errors are printed in cm under 100 N: that many of them make one m/N."""


@dataclass(frozen=True)
class Claim:
    """A published number, recomputed.

    Attributes:
        group: what it is about.
        quantity: what it is.
        unit: of both numbers, empty for a count or a ratio.
        paper: the published number.
        model: the recomputed one.
        source: section, table or figure of the paper.
        last_digit: worth of one in the last printed digit, in `unit`; half of it is the rounding of the print.
        note: how the model's number came about, and the reason where the two differ.
    """

    group: str
    quantity: str
    unit: str
    paper: float
    model: float
    source: str
    last_digit: float
    note: str = ""

    @property
    def agrees(self) -> bool:
        """Whether model and print differ by no more than 5 % or the print's rounding, whichever is larger."""
        return bool(abs(self.model - self.paper) <= max(RELATIVE_AGREEMENT * abs(self.paper), 0.5 * self.last_digit))

    @property
    def verdict(self) -> str:
        """Agreement, or by how much the model differs, in words."""
        if self.agrees:
            return "agrees"
        if self.paper == 0:
            return f"differs by {self.model:+.3g} {self.unit}".rstrip()
        ratio = self.model / self.paper
        return (
            f"differs by a factor of {ratio:.3g}" if not 0.5 < ratio < 2 else f"differs by {100 * (ratio - 1):+.1f} %"
        )


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


@dataclass(frozen=True)
class Bandwidth:
    """A frequency up to which the -100 dB limit is met.

    Attributes:
        case: loop in words.
        gain_mA_per_V: gain it is computed at.
        outer_end_mass_kg: mass on the outer tip.
        inner_end_mass_kg: mass added to the inner tip.
        paper: printed bandwidth, Hz.
        model: recomputed one, Hz.
        source: section and figure of the paper.
        note: about the gain, and the reason where the two differ.
    """

    case: str
    gain_mA_per_V: float
    outer_end_mass_kg: float
    inner_end_mass_kg: float
    paper: float
    model: float
    source: str
    note: str


def bandwidths() -> list[Bandwidth]:
    """The three bandwidths the paper states."""
    limit = critical_gain_mA_per_V(lag(200.0, INNER_END_MASS_KG), OUTER_END_MASS_KG)
    stable = float(floor(min(limit, 200.0)))
    printed = f"The printed 200 mA/V lies above the model's critical gain with 4.5 kg, {limit:.1f} mA/V. "
    cases = (
        ("proportional", proportional, 24.0, 0.0, 0.0, 4.0, "System Model, Fig. 9", ""),
        ("lag", lag, 300.0, 0.0, 0.0, 10.0, "Compensator Design, Fig. 10", ""),
        (
            "lag, 6.8 kg outer, 4.5 kg inner", lag, stable, OUTER_END_MASS_KG, INNER_END_MASS_KG, 8.0,
            "Effect of a Load Mass, Fig. 14", printed,
        ),
    )  # fmt: skip
    rows = []
    for name, rig, gain, mass, inner, published, source, note in cases:
        edge = critical_gain_mA_per_V(rig(gain, inner), mass) * (1 - 1e-9)
        best = at(rig(edge, inner), mass).bandwidth_Hz()
        note += f"Read off a plot in the paper; at the model's own critical gain it is {best:.1f} Hz."
        found = at(rig(gain, inner), mass).bandwidth_Hz()
        rows.append(Bandwidth(name, gain, mass, inner, published, found, source, note))
    return rows


def claims(gains: list[GainRow], widths: list[Bandwidth]) -> list[Claim]:
    """Every published number, those of the tables of critical gains and of bandwidths included."""
    groups = {
        "appendix": _appendix(),
        "beams": _beams(),
        "open loop": _open_loop(),
        "critical gain": _critical_gains(gains),
        "bandwidth": (
            (f"{r.case} at {r.gain_mA_per_V:g} mA/V", "Hz", r.paper, r.model, r.source, 1.0, r.note) for r in widths
        ),
        "lag against proportional": _lag(),
        "static error": _static_errors(),
    }
    return [Claim(group, *row) for group, rows in groups.items() for row in rows]


_Row = tuple[Any, ...]
"""Of a claim, what stands behind its group."""
_PRESSURE_GAIN_PA_PER_A = 29.6e9
_SHAPES: tuple[Literal["mode", "static"], ...] = ("mode", "static")


def _appendix() -> Iterator[_Row]:
    """The appendix as printed, beside the figures of the prototype that all else is computed with."""
    rig = paper_prototype()
    actuator, valve = rig.actuator, rig.servovalve
    outer, inner = lumped_beam(rig.outer_beam), lumped_beam(rig.inner_beam)
    leakage, quotient = valve.leakage_m3_per_s_per_Pa, valve.flow_gain_m3_per_s_per_A / _PRESSURE_GAIN_PA_PER_A
    divided = "Flow gain over the printed pressure gain, 29.6 MPa/mA."
    for quantity, unit, paper, used, digit, *note in (
        ("outer stiffness K_m", "N/cm", 4868.0, 1e-2 * outer.stiffness, 1.0),
        ("inner stiffness K_f", "N/cm", 1575.0, 1e-2 * inner.stiffness, 1.0),
        ("beam damping zeta, outer", "", 0.05, rig.outer_beam.damping_ratio, 0.01),
        ("beam damping zeta, inner", "", 0.05, rig.inner_beam.damping_ratio, 0.01),
        ("oil spring K_c", "N/cm", 130_000.0, 1e-2 * actuator.oil_stiffness_N_per_m, 1e4),
        ("outer effective mass M_m", "kg", 3.9, outer.mass, 0.1),
        ("inner effective mass M_f", "kg", 1.6, inner.mass, 0.1),
        ("flow gain K_q", "cm3/s/mA", 11.3, 1e3 * valve.flow_gain_m3_per_s_per_A, 0.1),
        ("leakage K_pq", "1e-7 cm3/s/Pa", 3.8, 1e13 * leakage, 0.1),
        ("valve frequency f_n", "Hz", 150.0, valve.natural_frequency_Hz, 10.0),
        ("piston area A, average", "cm2", 1.13, 1e4 * actuator.piston_area_m2, 0.01),
        ("sensor gain F", "V/cm", 11.8, 1e-2 * rig.sensor.gain_V_per_m, 0.1),
        ("leakage as K_q / K_p", "1e-7 cm3/s/Pa", 3.8, 1e13 * quotient, 0.1, divided),
    ):
        yield quantity, unit, paper, used, "Appendix", digit, *note


def _beams() -> Iterator[_Row]:
    """Stiffness, effective mass and frequency of both tubes, from their sections; whether the cylinder carries."""
    for name, tube, resonance in (("outer", OUTER, 55.0), ("inner", INNER, 50.0)):
        published, mass = tube.stiffness_N_per_m / 100, tube.effective_mass_kg
        long, clamped = (
            float(beam.tip_stiffness(tube.rigidity, length)) / 100 for length in (tube.length_m, tube.free_length_m)
        )
        by_mode, static = (
            float(beam.effective_mass(tube.mass_per_length, tube.free_length_m, tube.end_mass_kg, shape=shape))
            for shape in _SHAPES
        )
        yield from (
            (
                f"{name} tip stiffness, 3 E I / L^3 on the whole 1.5 m", "N/cm", published, long, "Appendix, (3)", 1.0,
                "Part of the tube is clamped in the base and does not bend.",
            ),
            (
                f"{name} tip stiffness on a free length of {tube.free_length_m} m", "N/cm", published, clamped,
                "Appendix, (3)", 1.0, "Free length not published: chosen to give the measured stiffness.",
            ),
            (
                f"{name} effective mass, (5)", "kg", mass, by_mode, "Appendix, (5)", 0.1,
                f"With {tube.end_mass_kg} kg fixed to the tip, which is not published; (6) would give {static:.2f} kg.",
            ),
            (
                f"{name} beam's natural frequency", "Hz", resonance, tube.natural_frequency_Hz,
                "Effect of a Load Mass, Fig. 11", 5.0, "sqrt(K / M) / 2 pi of the appendix's figures.",
            ),
        )  # fmt: skip
    yield (
        "load that the smaller side of the piston holds at 20 MPa", "N", 2000.0,
        SUPPLY_PRESSURE_PA * SMALLER_PISTON_SIDE_M2, "System Design and Modelling", 100.0,
        f"The average of both sides would hold {SUPPLY_PRESSURE_PA * PISTON_AREA_M2:.0f} N. That the smaller side sets"
        " the largest load is what the paper's nonlinear simulations found.",
    )  # fmt: skip


def _open_loop() -> Iterator[_Row]:
    """The roots the open loop is said to have."""
    bare = at(proportional(24.0))
    pole, zero = pair_Hz(bare)
    model, load = "System Model", "Effect of a Load Mass, Fig. 11"
    yield from (
        ("poles", "", 7.0, float(len(bare.open_loop_poles())), model, 1.0),
        (
            "zeros of x / F_d", "", 5.0, float(len(bare.compliance_zeros())), model, 1.0,
            "The count printed is that of the disturbance response.",
        ),
        (
            "zeros from current to displacement", "", 5.0, float(len(bare.open_loop_zeros())), model, 1.0,
            "The loop that the controller closes has only the inner beam's pair: driving the feedback gain up, as the"
            " paper finds zeros, leaves two finite roots, not five.",
        ),
        (
            "resonance of the loop (pole)", "Hz", 55.0, pole, load, 5.0,
            "Not the outer beam alone: stiff oil makes both masses move as one, sqrt((K_m + K_f) / (M_m + M_f)).",
        ),
        (
            "antiresonance of the loop (zero)", "Hz", 50.0, zero, load, 5.0,
            "The inner beam alone, as the paper says.",
        ),
    )  # fmt: skip


_REASONS = {
    "lag, 6.8 kg on the outer beam": (
        "Damping decides here: the model has {held_damping_ratio:.1f} mA/V with the damping ratio held and"
        " {beam_damping_0_03:.1f} mA/V with fixed dashpots of 0.03."
    ),
}
_FLOW = " The valve's flow gain at the 20 MPa supply instead of 6.9 MPa would more than close the rest."
_MEASURED_REASONS = {
    "proportional": _FLOW,
    "lag 1.75/26 Hz": _FLOW,
    "lag, 6.8 kg on the outer beam": " The oscillation is at the beams' 35 Hz here, where beam damping decides.",
}


def _critical_gains(rows: list[GainRow]) -> Iterator[_Row]:
    """Predicted critical gains, the measured ones, and what their changes were said to be."""
    for row in rows:
        reason = _REASONS.get(row.case.name, "").format(**row.varied_mA_per_V)
        predicted = row.case.predicted_mA_per_V
        yield f"{row.case.name}: predicted", "mA/V", predicted, row.model_mA_per_V, "Experiments", 1.0, reason
    for row in rows:
        yield (
            f"{row.case.name}: measured (model with filter and smaller side)", "mA/V", row.case.measured_mA_per_V,
            row.varied_mA_per_V["filter_and_smaller_side"], "Experiments", 1.0,
            f"The 400 Hz filter and the smaller side of the piston close {100 * row.explained:.0f} % of the distance"
            f" from {row.model_mA_per_V:.3g} mA/V to the measurement.{_MEASURED_REASONS.get(row.case.name, '')}",
        )  # fmt: skip
    bare, loaded, relieved = (row.model_mA_per_V for row in rows[1:])
    cliff, source = gain_cliff(), "Effect of a Load Mass"
    yield from (
        (
            "loss of critical gain by 6.8 kg outside", "times", 30.0, bare / loaded, source, 1.0,
            "Follows from the gain with 6.8 kg, where beam damping decides.",
        ),
        (
            "immediate loss of gain when pole and zero change places", "%", 75.0, 100 * cliff.reduction, source, 1.0,
            f"The model's gain drops from {cliff.before_mA_per_V:.0f} to {cliff.after_mA_per_V:.0f} mA/V at"
            f" {cliff.outer_end_mass_kg:.3f} kg; the size of the drop depends on beam damping.",
        ),
        (
            "gain regained by 4.5 kg inside", "times", 20.0, relieved / loaded, source, 1.0,
            "From 10 to 200 mA/V in the paper; again the gain with 6.8 kg alone decides.",
        ),
    )  # fmt: skip


_APART = {
    0.1: (22.0, "The ratio of the two gains, 300 / 24, is {:.1f} dB here."),
    1.0: (
        22.0,
        "Printed for all below 2 Hz; the pole at 1.75 Hz acts already and leaves the controllers {:.1f} dB apart.",
    ),
    2.0: (20.0, "The pole at 1.75 Hz is passed: the controllers themselves are {:.1f} dB apart."),
    20.0: (4.0, "The controllers themselves are {:.1f} dB apart, and closing the loop makes less of it."),
    25.0: (
        0.0,
        "The controllers are {:.1f} dB apart. Far above the zero the lag's gain, 300 x 1.75 / 26 = 20.2 mA/V, is the"
        " smaller one, and the lag loop does slightly worse.",
    ),
}
"""By the frequencies (Hz) that the paper names: the printed improvement by the lag in dB, and what it comes from."""


def _lag() -> Iterator[_Row]:
    """Improvement by the lag compensator at the frequencies the paper names."""
    for frequency, (paper, words) in _APART.items():
        gained = float(lag_advantage_dB(np.array([frequency]))[0])
        s = 1j * frequency
        apart = 20 * np.log10(abs(300.0 / 24.0 * (1 + s / LAG_ZERO_HZ) / (1 + s / LAG_POLE_HZ)))
        quantity = f"improvement at {frequency:g} Hz"
        yield quantity, "dB", paper, gained, "Compensator Design, Fig. 10", 1.0, words.format(apart)


def _static_errors() -> Iterator[_Row]:
    """The two printed static errors, and what a static error goes with."""
    slow, fast, halved = (at(rig).static_compliance() for rig in (proportional(24.0), lag(300.0), lag(150.0)))
    yield from (
        (
            "lag, under 100 N", "cm", 0.00085, CM_PER_100_N * fast, "Compensator Design", 1e-5,
            f"The printed figure is {decibels(0.00085 / CM_PER_100_N):.1f} dB, above the limit the same sentence says"
            " is met. A hundredth of it would agree.",
        ),
        (
            "lowest predicted, under 100 N", "cm", 0.00005, CM_PER_100_N * fast, "Experiments", 1e-5,
            f"Printed as 0.0005 mm. Proportional control at 24 mA/V leaves {CM_PER_100_N * slow:.3g} cm.",
        ),
        (
            "ratio of static errors at half the gain", "times", 2.0, halved / fast, "System Model", 0.1,
            "Inversely proportional to the gain, as the paper says, to the leakage's share of the loop gain.",
        ),
    )  # fmt: skip
