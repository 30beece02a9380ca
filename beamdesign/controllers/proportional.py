"""Proportional control."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from beamdesign import quantities as q
from beamdesign.controllers.cascade import Cascade, Factor


class Proportional(Cascade):
    """C(s) = 1."""

    checked: ClassVar[bool] = True
    kind: Annotated[Literal["proportional"], Field(description="which law, with its own figures")] = "proportional"
    gain_A_per_V: Annotated[q.LawGain, Field(description="K_sa, servo-amplifier gain")]

    @property
    def factors(self) -> tuple[Factor, ...]:
        """None."""
        return ()

    @classmethod
    def seeds(cls) -> tuple["Proportional", ...]:
        """See `Controller`."""
        return (cls(gain_A_per_V=3e-3),)
