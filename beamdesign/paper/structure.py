"""The paper's beams and appendix, recomputed: stiffness, effective mass, frequencies, clearance, conversions."""

from math import pi, sqrt
from typing import Literal

from beamdesign import beam
from beamdesign.loop import loop
from beamdesign.paper.claim import Claim
from beamdesign.paper.rig import (
    INNER,
    OUTER,
    PISTON_AREA_M2,
    SMALLER_PISTON_SIDE_M2,
    SUPPLY_PRESSURE_PA,
    paper_prototype,
    proportional,
)

_SHAPES: tuple[Literal["mode", "static"], ...] = ("mode", "static")
LOAD_N = 2000.0
PRESSURE_GAIN_PA_PER_A = 29.6e9


def appendix_claims() -> list[Claim]:
    """The appendix as printed, beside the figures of the prototype that all else is computed with."""
    rig = paper_prototype()
    outer, inner, actuator, valve = rig.outer_beam, rig.inner_beam, rig.actuator, rig.servovalve
    assert outer.stiffness_N_per_m
    assert inner.stiffness_N_per_m
    assert outer.effective_mass_kg
    assert inner.effective_mass_kg
    printed = [
        ("outer stiffness K_m", "N/cm", 4868.0, 1e-2 * outer.stiffness_N_per_m, 1.0),
        ("inner stiffness K_f", "N/cm", 1575.0, 1e-2 * inner.stiffness_N_per_m, 1.0),
        ("beam damping zeta, outer", "", 0.05, outer.damping_ratio, 0.01),
        ("beam damping zeta, inner", "", 0.05, inner.damping_ratio, 0.01),
        ("oil spring K_c", "N/cm", 130_000.0, 1e-2 * actuator.oil_stiffness_N_per_m, 1e4),
        ("outer effective mass M_m", "kg", 3.9, outer.effective_mass_kg, 0.1),
        ("inner effective mass M_f", "kg", 1.6, inner.effective_mass_kg, 0.1),
        ("flow gain K_q", "cm3/s/mA", 11.3, 1e3 * valve.flow_gain_m3_per_s_per_A, 0.1),
        ("leakage K_pq", "1e-7 cm3/s/Pa", 3.8, 1e13 * valve.leakage_m3_per_s_per_Pa, 0.1),
        ("valve frequency f_n", "Hz", 150.0, valve.natural_frequency_Hz, 10.0),
        ("piston area A, average", "cm2", 1.13, 1e4 * actuator.piston_area_m2, 0.01),
        ("sensor gain F", "V/cm", 11.8, 1e-2 * rig.sensor.gain_V_per_m, 0.1),
    ]
    claims = [
        Claim("appendix", quantity, unit, paper, used, "Appendix", digit)
        for quantity, unit, paper, used, digit in printed
    ]
    quotient = 1e13 * valve.flow_gain_m3_per_s_per_A / PRESSURE_GAIN_PA_PER_A
    note = "Flow gain over the printed pressure gain, 29.6 MPa/mA."
    return [*claims, Claim("appendix", "leakage as K_q / K_p", "1e-7 cm3/s/Pa", 3.8, quotient, "Appendix", 0.1, note)]


def beam_claims() -> list[Claim]:
    """Stiffness, effective mass and frequency of both tubes, from their sections."""
    claims = []
    for name, tube, resonance in (("outer", OUTER, 55.0), ("inner", INNER, 50.0)):
        published = tube.stiffness_N_per_m / 100
        long, clamped = (
            float(beam.tip_stiffness(tube.rigidity, length)) / 100 for length in (tube.length_m, tube.free_length_m)
        )
        mass, static = (
            float(beam.effective_mass(tube.mass_per_length, tube.free_length_m, tube.end_mass_kg, shape=shape))
            for shape in _SHAPES
        )
        alone = sqrt(tube.stiffness_N_per_m / tube.effective_mass_kg) / (2 * pi)
        claims += [
            Claim(
                "beams", f"{name} tip stiffness, 3 E I / L^3 on the whole 1.5 m", "N/cm", published, long,
                "Appendix, (3)", 1.0, "Part of the tube is clamped in the base and does not bend.",
            ),
            Claim(
                "beams", f"{name} tip stiffness on a free length of {tube.free_length_m} m", "N/cm", published,
                clamped, "Appendix, (3)", 1.0, "Free length not published: chosen to give the measured stiffness.",
            ),
            Claim(
                "beams", f"{name} effective mass, (5)", "kg", tube.effective_mass_kg, mass, "Appendix, (5)", 0.1,
                f"With {tube.end_mass_kg} kg fixed to the tip, which is not published; (6) would give {static:.2f} kg.",
            ),
            Claim(
                "beams", f"{name} beam's natural frequency", "Hz", resonance, alone, "Effect of a Load Mass, Fig. 11",
                5.0, "sqrt(K / M) / 2 pi of the appendix's figures.",
            ),
        ]  # fmt: skip
    return claims


def load_claim() -> Claim:
    """Whether the cylinder carries the design load."""
    average = SUPPLY_PRESSURE_PA * PISTON_AREA_M2
    return Claim(
        "beams", "load that the smaller side of the piston holds at 20 MPa", "N", LOAD_N,
        SUPPLY_PRESSURE_PA * SMALLER_PISTON_SIDE_M2, "System Design and Modelling", 100.0,
        f"The average of both sides would hold {average:.0f} N. That the smaller side sets the largest load is what the"
        " paper's nonlinear simulations found.",
    )  # fmt: skip


def open_loop_claims() -> list[Claim]:
    """The roots the open loop is said to have."""
    bare = loop(proportional(24.0)).at(0.0)
    pole, zero = (
        min(abs(root) for root in roots if root.imag > 0) / (2 * pi)
        for roots in (bare.open_loop_poles(), bare.open_loop_zeros())
    )
    return [
        Claim("open loop", "poles", "", 7.0, float(len(bare.open_loop_poles())), "System Model", 1.0),
        Claim(
            "open loop", "zeros of x / F_d", "", 5.0, float(len(bare.compliance_zeros())), "System Model", 1.0,
            "The count printed is that of the disturbance response.",
        ),
        Claim(
            "open loop", "zeros from current to displacement", "", 5.0, float(len(bare.open_loop_zeros())),
            "System Model", 1.0,
            "The loop that the controller closes has only the inner beam's pair: driving the feedback gain up, as the"
            " paper finds zeros, leaves two finite roots, not five.",
        ),
        Claim(
            "open loop", "resonance of the loop (pole)", "Hz", 55.0, pole, "Effect of a Load Mass, Fig. 11", 5.0,
            "Not the outer beam alone: stiff oil makes both masses move as one, sqrt((K_m + K_f) / (M_m + M_f)).",
        ),
        Claim(
            "open loop", "antiresonance of the loop (zero)", "Hz", 50.0, zero, "Effect of a Load Mass, Fig. 11", 5.0,
            "The inner beam alone, as the paper says.",
        ),
    ]  # fmt: skip
