"""Where the paper contradicts itself, each slip with the figures that decide it."""

from math import pi, sqrt

from beamdesign import beam
from beamdesign.loop import loop
from beamdesign.paper.claim import Slip
from beamdesign.paper.gains import GainRow, inner_mass_gains, stable_masses
from beamdesign.paper.performance import CM_PER_100_N, static_errors_cm_per_100N
from beamdesign.paper.rig import FLOW_GAIN_PRESSURE_PA, INNER, OUTER, SUPPLY_PRESSURE_PA, proportional
from beamdesign.prototype import COMPLIANCE_LIMIT_M_PER_N
from beamdesign.report.compliance_scale import decibels, from_decibels

STANDARD_GRAVITY = 9.80665


def slips(rows: list[GainRow]) -> list[Slip]:
    """All of them, recomputed where they can be; `rows` are the critical gains."""
    return [*_formula_slips(rows[0].model_mA_per_V), *_scale_slips(), *_model_slips(rows)]


def _formula_slips(proportional_gain_mA_per_V: float) -> list[Slip]:
    frequency = beam.first_frequency(OUTER.rigidity, OUTER.mass_per_length, OUTER.free_length_m, OUTER.end_mass_kg)
    spring = sqrt(OUTER.stiffness_N_per_m / OUTER.effective_mass_kg) / (2 * pi)
    sag = OUTER.effective_mass_kg * STANDARD_GRAVITY / OUTER.stiffness_N_per_m
    wrong = OUTER.effective_mass_kg / (STANDARD_GRAVITY * sag)
    right = OUTER.effective_mass_kg * STANDARD_GRAVITY / sag
    return [
        Slip(
            "equation (2)", "a minus sign before the first natural frequency", "no sign",
            f"The outer tube has {frequency:.1f} Hz by (2) without it and {spring:.1f} Hz by (4).",
        ),
        Slip(
            "equation (3)", "stiffness as mass over (gravity times sag)", "mass times gravity over sag",
            f"A sag of {1e6 * sag:.1f} um under the outer beam's mass gives {wrong:.0f} as printed and"
            f" {right:.0f} N/m as read.",
        ),
        Slip(
            "equation (11)", "the oil stiffness K_c on the left", "the cylinder force F_c",
            "(7), (8) and (14) use F_c and nothing else defines it; a stiffness cannot equal a stiffness times a"
            " displacement.",
        ),
        Slip(
            "equation (12)", "a feedback gain K_fx that the appendix does not list", "the sensor's gain F, 11.8 V/cm",
            f"With F the proportional loop oscillates at {proportional_gain_mA_per_V:.1f} mA/V, printed 24.",
        ),
    ]  # fmt: skip


def _scale_slips() -> list[Slip]:
    gloss = 0.001 / CM_PER_100_N
    goal = float(from_decibels(-100.0))
    slow, fast = static_errors_cm_per_100N()
    return [
        Slip(
            "System Model, the -100 dB goal", "-100 dB explained as 0.001 cm under 100 N",
            f"{COMPLIANCE_LIMIT_M_PER_N:.3g} m/N = 0.0057 cm/kN, as in the abstract",
            f"-100 dB of inch per pound-force is {goal:.4g} m/N; the explanation is {gloss:.3g} m/N or"
            f" {decibels(gloss):.1f} dB, {gloss / goal:.2f} times looser.",
        ),
        Slip(
            "Compensator Design and Experiments", "static errors of 0.00085 cm and of 0.0005 mm under 100 N",
            "neither",
            f"They differ {0.00085 / 0.00005:.0f}-fold. The appendix's figures give {fast:.2g} cm at 300 mA/V and"
            f" {slow:.3g} cm at 24 mA/V; 0.00085 cm would be {decibels(0.00085 / CM_PER_100_N):.1f} dB, which does not"
            " meet the goal.",
        ),
    ]  # fmt: skip


def _model_slips(rows: list[GainRow]) -> list[Slip]:
    light, heavy = inner_mass_gains()
    bare = loop(proportional(24.0)).at(0.0)
    payload = rows[2]
    factor = sqrt(SUPPLY_PRESSURE_PA / FLOW_GAIN_PRESSURE_PA)
    (onset_kg, onset_Hz), *_ = stable_masses(300.0, 0.0)
    swap = _reversal_mass()
    return [
        Slip(
            "Effect of a Load Mass, Experiments", "4.5 kg inside in two places, 4.4 kg in one",
            "4.4 kg for the measured gain, 4.5 kg for Figures 14 and 16",
            f"The critical gain is {light:.1f} mA/V with 4.4 kg and {heavy:.1f} mA/V with 4.5 kg: the printed 200 lies"
            " between them.",
        ),
        Slip(
            "System Model, structural damping", "one damping ratio, not what it means once end mass is added",
            "a fixed dashpot, b = 2 zeta sqrt(K M) of the bare beam",
            f"With 6.8 kg outside the critical gain is {payload.model_mA_per_V:.1f} mA/V with the fixed dashpot and"
            f" {payload.varied_mA_per_V['held_damping_ratio']:.1f} mA/V with the ratio held; the paper has 10.",
        ),
        Slip(
            "System Model, poles and zeros", "seven poles and five zeros, zeros found by raising the feedback gain",
            "five zeros of x / F_d, two of the loop",
            f"x / F_d has {len(bare.compliance_zeros())} zeros whatever the gain; from current to displacement there"
            f" are {len(bare.open_loop_zeros())}, and only these are where closed-loop roots end at high gain.",
        ),
        Slip(
            "Effect of a Load Mass", "the open-loop resonance called the outer beam's own frequency",
            "that of both masses on both springs",
            f"They change places with the inner beam's zero at {swap:.2f} kg; at 300 mA/V the loop is lost from"
            f" {onset_kg:.2f} kg, at {onset_Hz:.1f} Hz.",
        ),
        Slip(
            "Appendix, flow gain", "K_q at 6.9 MPa while the supply is 20 MPa", "as printed",
            f"Flow through an orifice rises as sqrt(pressure), here {factor:.2f} times; with that the"
            " critical gains are "
            + ", ".join(f"{row.varied_mA_per_V['supply_flow_gain']:.3g}" for row in rows)
            + " mA/V, measured "
            + ", ".join(f"{row.case.measured_mA_per_V:g}" for row in rows)
            + ".",
        ),
        Slip(
            "System Model, 400 Hz filter", "said not to affect the dynamics significantly", "left out, as in the paper",
            f"It costs {100 * (1 - rows[0].varied_mA_per_V['with_filter'] / rows[0].model_mA_per_V):.0f} % of the"
            " critical gain of the proportional loop.",
        ),
    ]  # fmt: skip


def _reversal_mass() -> float:
    """Outer end mass at which both masses on both springs have the inner beam's own frequency, kg (oil rigid)."""
    return OUTER.stiffness_N_per_m * INNER.effective_mass_kg / INNER.stiffness_N_per_m - OUTER.effective_mass_kg
