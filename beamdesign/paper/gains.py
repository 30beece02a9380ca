"""The paper's critical gains, measured and predicted, beside the model's under every choice it leaves open."""

from dataclasses import dataclass

from beamdesign.crossing import crossings
from beamdesign.loop import CriticalGain, critical_gain, loop
from beamdesign.paper.claim import Claim
from beamdesign.paper.rig import CASES, INNER_END_MASS_KG, OUTER_END_MASS_KG, VARIATIONS, Case, lag

GROUP = "critical gain"


@dataclass(frozen=True)
class GainRow:
    """One case of the comparison.

    Attributes:
        case: the published case.
        model: the model's critical gain with the two stated choices.
        varied_mA_per_V: critical gain under each of `VARIATIONS`, one at a time, by key.
    """

    case: Case
    model: CriticalGain
    varied_mA_per_V: dict[str, float]

    @property
    def model_mA_per_V(self) -> float:
        """The model's critical gain."""
        return 1e3 * self.model.gain_A_per_V

    @property
    def explained(self) -> float:
        """Share of the distance from model to measurement that the filter and the smaller piston side close."""
        closed = self.model_mA_per_V - self.varied_mA_per_V["filter_and_smaller_side"]
        return closed / (self.model_mA_per_V - self.case.measured_mA_per_V)

    def fields(self) -> dict[str, object]:
        """The row as it stands in the JSON result."""
        return {
            "case": self.case.name,
            "predicted_paper_mA_per_V": self.case.predicted_mA_per_V,
            "measured_mA_per_V": self.case.measured_mA_per_V,
            "model_mA_per_V": self.model_mA_per_V,
            "oscillation_Hz": self.model.frequency_Hz,
            **{f"model_{key}_mA_per_V": value for key, value in self.varied_mA_per_V.items()},
            "gap_explained_by_filter_and_smaller_side": self.explained,
        }


def gain_row(case: Case) -> GainRow:
    """Recompute one case, exactly, with the stated choices and with each variation of them."""
    varied = {
        key: 1e3 * critical_gain(change(case.prototype, case.outer_end_mass_kg), case.outer_end_mass_kg).gain_A_per_V
        for key, (_, change) in VARIATIONS.items()
    }
    return GainRow(case, critical_gain(case.prototype, case.outer_end_mass_kg), varied)


def gain_rows() -> list[GainRow]:
    """All four cases."""
    return [gain_row(case) for case in CASES]


@dataclass(frozen=True)
class Cliff:
    """The outer end mass at which the critical gain drops at once, and the gains on its two sides."""

    outer_end_mass_kg: float
    before_mA_per_V: float
    after_mA_per_V: float

    @property
    def reduction(self) -> float:
        """Relative loss of gain."""
        return 1 - self.after_mA_per_V / self.before_mA_per_V


def gain_cliff(tolerance_kg: float = 1e-6) -> Cliff:
    """Where the lag loop's oscillation jumps from the valve's frequency to the beams', by bisection of the mass.

    There a new pair of gain crossings appears below the old one, so the critical gain is discontinuous in the mass.
    """
    rig = lag(300.0)
    low, high = 0.0, OUTER_END_MASS_KG
    between = (critical_gain(rig, low).frequency_Hz + critical_gain(rig, high).frequency_Hz) / 2
    while high - low > tolerance_kg:
        middle = (low + high) / 2
        low, high = (middle, high) if critical_gain(rig, middle).frequency_Hz > between else (low, middle)
    return Cliff(high, *(1e3 * critical_gain(rig, mass).gain_A_per_V for mass in (low, high)))


def stable_masses(gain_mA_per_V: float, inner_end_mass_kg: float) -> list[tuple[float, float]]:
    """Outer end mass (kg) and frequency (Hz) of every crossing of the axis, m >= 0, for the lag loop at a gain."""
    family = loop(lag(gain_mA_per_V, inner_end_mass_kg)).characteristic
    return [(c.value, c.frequency_Hz) for c in crossings(family) if c.value >= 0]


_REASONS = {
    "lag, 6.8 kg on the outer beam": (
        "Damping decides here: the model has {held_damping_ratio:.1f} mA/V with the damping ratio held and"
        " {beam_damping_0_03:.1f} mA/V with fixed dashpots of 0.03."
    ),
}


_MEASURED_REASONS = {
    "proportional": " The valve's flow gain at the 20 MPa supply instead of 6.9 MPa would more than close the rest.",
    "lag 1.75/26 Hz": " The valve's flow gain at the 20 MPa supply instead of 6.9 MPa would more than close the rest.",
    "lag, 6.8 kg on the outer beam": " The oscillation is at the beams' 35 Hz here, where beam damping decides.",
}


def gain_claims(rows: list[GainRow]) -> list[Claim]:
    """Predicted critical gains, what their changes were said to be, and the measured ones."""
    claims = [
        Claim(
            GROUP, f"{row.case.name}: predicted", "mA/V", row.case.predicted_mA_per_V, row.model_mA_per_V,
            "Experiments", 1.0, _REASONS.get(row.case.name, "").format(**row.varied_mA_per_V),
        )
        for row in rows
    ]  # fmt: skip
    claims += [
        Claim(
            GROUP, f"{row.case.name}: measured (model with filter and smaller side)", "mA/V",
            row.case.measured_mA_per_V, row.varied_mA_per_V["filter_and_smaller_side"], "Experiments", 1.0,
            f"The 400 Hz filter and the smaller side of the piston close {100 * row.explained:.0f} % of the distance"
            f" from {row.model_mA_per_V:.3g} mA/V to the measurement.{_MEASURED_REASONS.get(row.case.name, '')}",
        )
        for row in rows
    ]  # fmt: skip
    bare, loaded, relieved = (row.model_mA_per_V for row in rows[1:])
    cliff = gain_cliff()
    claims += [
        Claim(
            GROUP, "loss of critical gain by 6.8 kg outside", "times", 30.0, bare / loaded, "Effect of a Load Mass",
            1.0, "Follows from the gain with 6.8 kg, where beam damping decides.",
        ),
        Claim(
            GROUP, "immediate loss of gain when pole and zero change places", "%", 75.0, 100 * cliff.reduction,
            "Effect of a Load Mass", 1.0,
            f"The model's gain drops from {cliff.before_mA_per_V:.0f} to {cliff.after_mA_per_V:.0f} mA/V at"
            f" {cliff.outer_end_mass_kg:.3f} kg; the size of the drop depends on beam damping.",
        ),
        Claim(
            GROUP, "gain regained by 4.5 kg inside", "times", 20.0, relieved / loaded, "Effect of a Load Mass", 1.0,
            "From 10 to 200 mA/V in the paper; again the gain with 6.8 kg alone decides.",
        ),
    ]  # fmt: skip
    return claims


def inner_mass_gains() -> tuple[float, float]:
    """Critical gains in mA/V with 6.8 kg outside and 4.4 or 4.5 kg inside."""
    gains = [critical_gain(lag(200.0, inner), OUTER_END_MASS_KG).gain_A_per_V for inner in (4.4, INNER_END_MASS_KG)]
    return 1e3 * gains[0], 1e3 * gains[1]
