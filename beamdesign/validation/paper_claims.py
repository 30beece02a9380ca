"""Numbers of the paper beside those of the model: every one that its appendix allows to be recomputed.

What is printed, and the words about it, stand in `paper.toml`; here is what is recomputed: the paper's beams and its
appendix from the tubes; the roots of the open loop; critical gains under every choice it leaves open; and what it says
its loops achieve: bandwidth, gain of the lag, static error. Where the paper contradicts itself, each slip stands with
the figures that decide it.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from math import floor, sqrt, tau
from pathlib import Path
from typing import Any

import numpy as np

from beamdesign.prototype import COMPLIANCE_LIMIT_M_PER_N, Beam
from beamdesign.quantities import decibels, from_decibels
from beamdesign.result import picked
from beamdesign.structure import lumped
from beamdesign.structure.lumped import lumped_beam
from beamdesign.validation.paper_rig import (
    FLOW_GAIN_PRESSURE_PA,
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
    stable_masses,
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
        return f"differs by {f'{100 * (ratio - 1):+.1f} %' if 0.5 < ratio < 2 else f'a factor of {ratio:.3g}'}"


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
        largest: at the model's own critical gain, Hz.
    """

    case: str
    gain_mA_per_V: float
    outer_end_mass_kg: float
    inner_end_mass_kg: float
    paper: float
    model: float
    largest: float


def bandwidths() -> list[Bandwidth]:
    """The three bandwidths the paper states."""
    limit = critical_gain_mA_per_V(lag(200.0, INNER_END_MASS_KG), OUTER_END_MASS_KG)
    masses = OUTER_END_MASS_KG, INNER_END_MASS_KG
    rows = []
    for name, rig, gain, (mass, inner), printed in (
        ("proportional", proportional, 24.0, (0.0, 0.0), 4.0),
        ("lag", lag, 300.0, (0.0, 0.0), 10.0),
        ("lag, 6.8 kg outer, 4.5 kg inner", lag, float(floor(min(limit, 200.0))), masses, 8.0),
    ):
        edge = critical_gain_mA_per_V(rig(gain, inner), mass) * (1 - 1e-9)
        found, largest = (at(rig(each, inner), mass).bandwidth_Hz() for each in (gain, edge))
        rows.append(Bandwidth(name, gain, mass, inner, printed, found, largest))
    return rows


@cache
def paper_words() -> dict[str, Any]:
    """What `paper.toml` holds."""
    return tomllib.loads(Path(__file__).with_name("paper.toml").read_text("utf-8"))


def claims_and_slips(gains: list[GainRow], widths: list[Bandwidth]) -> tuple[list[Claim], list[dict[str, str]]]:
    """Every published number, those of the tables of critical gains and of bandwidths included; and all slips.

    A slip is a place where the paper contradicts itself, its own data or its drawings: `where`, what is `printed` there
    in our words, what it is `read_as` here, and the figures that decide it, recomputed, `check`.
    """
    stated, known = paper_words(), figures(gains, widths)
    claims = []
    for group, rows in stated["claims"].items():
        for quantity, unit, paper, model, source, digit, note in rows:
            words, printed = quantity.format(**known), known[paper] if isinstance(paper, str) else paper
            claims.append(Claim(group, words, unit, printed, known[model], source, digit, note.format(**known)))
    return claims, [{key: words.format(**known) for key, words in slip.items()} for slip in stated["slips"]]


def figures(gains: list[GainRow], widths: list[Bandwidth]) -> Mapping[str, Any]:
    """All that is recomputed, by the names of `paper.toml`; of critical gains and bandwidths with their places."""
    return (
        _of_the_appendix()
        | {f"outer_{key}": value for key, value in _of_tube(OUTER).items()}
        | {f"inner_{key}": value for key, value in _of_tube(INNER).items()}
        | _of_loops()
        | _of_gains(gains)
        | {f"{name}_{k}": value for k, row in enumerate(widths, 1) for name, value in picked(row, _WIDTH).items()}
        | {"relieved_gain": widths[2].gain_mA_per_V}
    )


_GAIN = "case=case.name predicted=case.predicted_mA_per_V measured=case.measured_mA_per_V gain=model_mA_per_V"
_WIDTH = "bandwidth=model printed_bandwidth=paper largest_bandwidth=largest"
"""Names of what is recomputed, each with where it stands in its row; that row's place follows the name."""
_PRESSURE_GAIN_PA_PER_A = 29.6e9
_STANDARD_GRAVITY = 9.80665


def _of_the_appendix() -> dict[str, float]:
    """The prototype that all else is computed with, in the units of the appendix; what the cylinder carries."""
    rig = paper_prototype()
    figure = lumped.figures(rig)
    outer, inner = lumped_beam(rig.outer_beam), lumped_beam(rig.inner_beam)
    sag = outer.mass * _STANDARD_GRAVITY / outer.stiffness
    return {
        "outer_N_per_cm": 1e-2 * outer.stiffness,
        "inner_N_per_cm": 1e-2 * inner.stiffness,
        "outer_zeta": rig.outer_beam.damping_ratio,
        "inner_zeta": rig.inner_beam.damping_ratio,
        "oil_N_per_cm": 1e-2 * figure["oil_stiffness"],
        "outer_kg": outer.mass,
        "inner_kg": inner.mass,
        "flow_gain": 1e3 * figure["flow_gain"],
        "leakage": 1e13 * figure["leakage"],
        "leakage_of_gains": 1e13 * (figure["flow_gain"] / _PRESSURE_GAIN_PA_PER_A),
        "valve_Hz": figure["valve_frequency"] / tau,
        "area_cm2": 1e4 * figure["piston_area"],
        "sensor_V_per_cm": 1e-2 * rig.sensor.gain_V_per_m,
        "smaller_side_N": SUPPLY_PRESSURE_PA * SMALLER_PISTON_SIDE_M2,
        "average_N": SUPPLY_PRESSURE_PA * PISTON_AREA_M2,
        "supply_factor": sqrt(SUPPLY_PRESSURE_PA / FLOW_GAIN_PRESSURE_PA),
        "sag_um": 1e6 * sag,
        "sag_wrong": outer.mass / (_STANDARD_GRAVITY * sag),
        "sag_right": outer.mass * _STANDARD_GRAVITY / sag,
        # Both masses on both springs have the inner beam's own frequency there, the oil rigid.
        "swap_kg": outer.stiffness * inner.mass / inner.stiffness - outer.mass,
    }


def _of_tube(own: Beam) -> dict[str, float]:
    """Stiffness, effective mass and frequencies of a tube, from its section; `Hz` from what was measured."""
    tube, alloy, length_m, free_m, measured = own.tube, own.material, own.length_m, own.free_length_m, lumped_beam(own)
    assert tube is not None and alloy is not None and length_m is not None and free_m is not None  # noqa: PT018
    rigidity = alloy.youngs_modulus_Pa * float(tube.second_moment)
    loaded = (float(tube.mass_per_length(alloy.density_kg_per_m3)), free_m, own.end_mass_kg)
    return {
        "long": float(lumped.tip_stiffness(rigidity, length_m)) / 100,
        "clamped": float(lumped.tip_stiffness(rigidity, free_m)) / 100,
        "mode_kg": float(lumped.effective_mass(*loaded, shape="mode")),
        "static_kg": float(lumped.effective_mass(*loaded, shape="static")),
        "free_m": free_m,
        "end_kg": own.end_mass_kg,
        "Hz": sqrt(measured.stiffness / measured.mass) / tau,
        "first_Hz": float(lumped.first_frequency(rigidity, *loaded)),
    }


def _of_loops() -> dict[str, float]:
    """Roots of the open loop, static errors, what the lag gains, where the gain falls, and levels in words."""
    bare, cliff = at(proportional(24.0)), gain_cliff()
    pole, zero = pair_Hz(bare)
    slow, fast, halved = (at(rig).static_compliance() for rig in (proportional(24.0), lag(300.0), lag(150.0)))
    light, heavy = (critical_gain_mA_per_V(lag(200.0, kg), OUTER_END_MASS_KG) for kg in (4.4, INNER_END_MASS_KG))
    (onset_kg, onset_Hz), *_ = stable_masses(300.0, 0.0)
    gloss, goal = 0.001 / CM_PER_100_N, float(from_decibels(-100.0))
    found = {
        "poles": float(len(bare.open_loop_poles())),
        "load_zeros": float(len(bare.compliance_zeros())),
        "loop_zeros": float(len(bare.open_loop_zeros())),
        "pole_Hz": pole,
        "zero_Hz": zero,
        "cliff": 100 * cliff.reduction,
        "cliff_before": cliff.before_mA_per_V,
        "cliff_after": cliff.after_mA_per_V,
        "cliff_kg": cliff.outer_end_mass_kg,
        "static_cm": CM_PER_100_N * fast,
        "slow_cm": CM_PER_100_N * slow,
        "halved": halved / fast,
        "printed_dB": decibels(0.00085 / CM_PER_100_N),
        "limit": COMPLIANCE_LIMIT_M_PER_N,
        "goal": goal,
        "gloss": gloss,
        "gloss_dB": decibels(gloss),
        "looser": gloss / goal,
        "light": light,
        "heavy": heavy,
        "onset_kg": onset_kg,
        "onset_Hz": onset_Hz,
    }
    for frequency in (0.1, 1.0, 2.0, 20.0, 25.0):
        s, name = 1j * frequency, f"{frequency:g}".replace(".", "_")
        apart = 300.0 / 24.0 * (1 + s / LAG_ZERO_HZ) / (1 + s / LAG_POLE_HZ)
        found[f"better_{name}"] = float(lag_advantage_dB(np.array([frequency]))[0])
        found[f"apart_{name}"] = 20 * np.log10(abs(apart))
    return found


def _of_gains(rows: list[GainRow]) -> dict[str, Any]:
    """Critical gains, with their cases, and what end masses make of them."""
    found: dict[str, Any] = {}
    for k, row in enumerate(rows, 1):
        each = picked(row, _GAIN) | {"closed": 100 * row.explained} | row.varied_mA_per_V
        found |= {f"{name}_{k}": value for name, value in each.items()}
    bare, loaded, relieved = (row.model_mA_per_V for row in rows[1:])
    left = rows[0].varied_mA_per_V["with_filter"] / rows[0].model_mA_per_V
    return found | {"gain_lost": bare / loaded, "gain_regained": relieved / loaded, "filter_costs": 100 * (1 - left)}
