"""A lag with second-order sections."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from beamdesign import quantities as q
from beamdesign.controllers.cascade import Break, Cascade, Factor, Section

__all__ = ["Section", "Structured"]


class Structured(Cascade):
    """C(s) = (1 + s / zero) / (1 + s / pole) times its second-order sections: a lag with up to three of them."""

    checked: ClassVar[bool] = True
    kind: Annotated[Literal["structured"], Field(description="which law, with its own figures")] = "structured"
    gain_A_per_V: Annotated[q.LawGain, Field(description="K_sa, servo-amplifier gain at zero frequency")]
    pole_Hz: Annotated[q.Frequency, Field(description="lower break frequency")]
    zero_Hz: Annotated[q.Frequency, Field(description="upper break frequency")]
    section: Annotated[
        tuple[Section, ...], Field(min_length=1, max_length=3, description="second-order sections behind the lag")
    ]

    @property
    def factors(self) -> tuple[Factor, ...]:
        """Its breaks, then its sections."""
        return Break(self.pole_Hz, self.zero_Hz), *self.section
