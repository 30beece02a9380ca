"""Everything the paper states, recomputed: one result that the page, the JSON file and the tests read."""

from dataclasses import dataclass

from beamdesign.paper.claim import Claim, Slip
from beamdesign.paper.gains import GainRow, gain_claims, gain_rows, stable_masses
from beamdesign.paper.performance import Bandwidth, bandwidth_claims, bandwidths, lag_claims, static_claims
from beamdesign.paper.rig import INNER_END_MASS_KG, VALVE_DAMPING_RATIO, VARIATIONS
from beamdesign.paper.slips import slips
from beamdesign.paper.structure import appendix_claims, beam_claims, load_claim, open_loop_claims

CHOICES = (
    f"Servovalve damping {VALVE_DAMPING_RATIO}: the paper does not give it. It is the one free constant, and this value"
    " has the predicted critical gains come out.",
    "Beam damping as a fixed dashpot, b = 2 zeta sqrt(K M) of the bare beam: added end mass lowers the damping ratio."
    " The paper does not say; it matters only with mass on the outer beam alone.",
)
"""What the paper leaves open, and how it is settled here."""

REMEDY_GAIN_MA_PER_V = 150.0


@dataclass(frozen=True)
class Comparison:
    """The paper beside the model.

    Attributes:
        gains: the four critical gains, with their sensitivity to every open choice.
        bandwidths: the three bandwidths.
        claims: every published number, those of the two tables included.
        slips: where the paper contradicts itself.
        remedy_crossings: outer end mass (kg) and frequency (Hz) at which the paper's remedy for payload, the lag with
            4.5 kg inside at the measured 150 mA/V, gains or loses stability.
    """

    gains: list[GainRow]
    bandwidths: list[Bandwidth]
    claims: list[Claim]
    slips: list[Slip]
    remedy_crossings: list[tuple[float, float]]

    def fields(self) -> dict[str, object]:
        """The JSON result."""
        return {
            "critical_gains": [row.fields() for row in self.gains],
            "bandwidths_Hz": [row.fields() for row in self.bandwidths],
            "claims": [
                {
                    "group": claim.group,
                    "quantity": claim.quantity,
                    "unit": claim.unit,
                    "paper": claim.paper,
                    "model": claim.model,
                    "agrees": claim.agrees,
                    "verdict": claim.verdict,
                    "source": claim.source,
                    "note": claim.note,
                }
                for claim in self.claims
            ],
            "slips": self.slips,
            "choices": CHOICES,
            "variations": {key: words for key, (words, _) in VARIATIONS.items()},
            "remedy_crossings": [
                {"outer_end_mass_kg": mass, "frequency_Hz": frequency} for mass, frequency in self.remedy_crossings
            ],
        }


def compare() -> Comparison:
    """Recompute everything."""
    gains, widths = gain_rows(), bandwidths()
    claims = [
        *appendix_claims(),
        *beam_claims(),
        load_claim(),
        *open_loop_claims(),
        *gain_claims(gains),
        *bandwidth_claims(widths),
        *lag_claims(),
        *static_claims(),
    ]
    return Comparison(gains, widths, claims, slips(gains), stable_masses(REMEDY_GAIN_MA_PER_V, INNER_END_MASS_KG))
