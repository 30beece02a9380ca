"""The kinds whose factors are at most a lag, which gives a loop its gain at low frequencies, and sections behind it."""

from collections.abc import Sequence
from typing import Any, ClassVar, Literal, Self

from pydantic import Field

from beamdesign import quantities as q
from beamdesign.controllers.cascade import Break, Cascade, Factor, Section
from beamdesign.controllers.protocol import Controller, refuse

MOST_SECTIONS = 3
SECTION_HZ = (8.0, 25.0, 70.0, 200.0)
"""Where a tuner begins with a new section."""

_NEUTRAL, _APART = 0.7, 1.02
"""Damping ratio of a section that does next to nothing, and how far apart its zeros and poles begin."""


class Proportional(Cascade):
    """C(s) = 1."""

    kind: Literal["proportional"] = Field("proportional", description="which law, with its own figures")
    gain_A_per_V: q.LawGain = Field(description="K_sa, servo-amplifier gain")

    @property
    def factors(self) -> tuple[Factor, ...]:
        """None."""
        return ()

    @classmethod
    def seeds(cls) -> tuple[Controller, ...]:
        """See `Controller`."""
        return (cls(gain_A_per_V=3e-3),)


class _Lagged(Cascade):
    """A lag, with what a kind has behind it."""

    pole_Hz: q.Frequency = Field(description="lower break frequency")
    zero_Hz: q.Frequency = Field(description="upper break frequency")

    @property
    def factors(self) -> tuple[Factor, ...]:
        """Its breaks."""
        return (Break(self.pole_Hz, self.zero_Hz),)

    @classmethod
    def seeds(cls) -> tuple[Controller, ...]:
        """The lag that a tuner begins with."""
        return (Lag(gain_A_per_V=3e-3, pole_Hz=1.0, zero_Hz=30.0),)

    def grown(self) -> tuple[Controller, ...]:
        """The law with one more section, which does next to nothing yet, at one frequency or another."""
        if len(self.sections) == MOST_SECTIONS:
            return ()
        own = {name: getattr(self, name) for name in ("gain_A_per_V", "pole_Hz", "zero_Hz")}
        found = []
        for frequency in SECTION_HZ:
            zero, pole = frequency * _APART, frequency / _APART
            more = Section(zero_Hz=zero, zero_damping_ratio=_NEUTRAL, pole_Hz=pole, pole_damping_ratio=_NEUTRAL)
            found.append(Structured(**own, section=(*self.sections, more)))
        return tuple(found)


class Lag(_Lagged):
    """C(s) = (1 + s / zero) / (1 + s / pole)."""

    kind: Literal["lag"] = Field("lag", description="which law, with its own figures")


class Structured(_Lagged):
    """C(s) = (1 + s / zero) / (1 + s / pole) times its second-order sections: a lag with up to three of them."""

    grows: ClassVar[bool] = True
    kind: Literal["structured"] = Field("structured", description="which law, with its own figures")
    section: tuple[Section, ...] = Field(
        min_length=1, max_length=MOST_SECTIONS, description="second-order sections behind the lag"
    )

    @property
    def factors(self) -> tuple[Factor, ...]:
        """Its breaks, then its sections."""
        return *super().factors, *self.section

    @classmethod
    def of(cls, figures: Sequence[float]) -> Self:
        """The record of gain, pole and zero, then the figures of each section."""
        names = list(Section.model_fields)
        rows = [figures[first : first + len(names)] for first in range(3, len(figures), len(names))]
        gain, pole, zero = figures[:3]
        section = tuple(dict(zip(names, row, strict=True)) for row in rows)
        return cls.model_validate({"gain_A_per_V": gain, "pole_Hz": pole, "zero_Hz": zero, "section": section})

    @property
    def sought(self) -> dict[str, Any]:
        """As many sections."""
        return {"kind": self.kind, "sections": len(self.section)}


def as_lag(controller: Controller) -> Lag:
    """A lag as it is, and a proportional law as a lag whose breaks coincide.

    Raises:
        InputError: for any other.
    """
    refuse(controller, "lag", "a lag's place", "controller")
    lag = controller.lag or Break(1.0, 1.0)
    return Lag(gain_A_per_V=controller.gain_A_per_V, pole_Hz=lag.pole_Hz, zero_Hz=lag.zero_Hz)
