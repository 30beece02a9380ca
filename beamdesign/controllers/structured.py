"""A lag with second-order sections."""

from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field

from beamdesign import quantities as q
from beamdesign.controllers.cascade import Break, Cascade, Factor, Section
from beamdesign.controllers.lag import Lag

__all__ = ["Section", "Structured"]

MOST_SECTIONS = 3
SECTION_HZ = (8.0, 25.0, 70.0, 200.0)
"""Where a tuner begins with a new section."""

_NEUTRAL, _APART = 0.7, 1.02
"""Damping ratio of a section that does next to nothing, and how far apart its zeros and poles begin."""


class Structured(Cascade):
    """C(s) = (1 + s / zero) / (1 + s / pole) times its second-order sections: a lag with up to three of them."""

    checked: ClassVar[bool] = True
    grows: ClassVar[bool] = True
    kind: Annotated[Literal["structured"], Field(description="which law, with its own figures")] = "structured"
    pole_Hz: Annotated[q.Frequency, Field(description="lower break frequency")]
    zero_Hz: Annotated[q.Frequency, Field(description="upper break frequency")]
    section: Annotated[
        tuple[Section, ...],
        Field(min_length=1, max_length=MOST_SECTIONS, description="second-order sections behind the lag"),
    ]

    @property
    def factors(self) -> tuple[Factor, ...]:
        """Its breaks, then its sections."""
        return Break(self.pole_Hz, self.zero_Hz), *self.section

    @classmethod
    def of(cls, figures: Sequence[float]) -> Self:
        """The record of gain, pole and zero, then the figures of each section."""
        names = list(Section.model_fields)
        rows = [figures[first : first + len(names)] for first in range(3, len(figures), len(names))]
        gain, pole, zero = figures[:3]
        section = tuple(dict(zip(names, row, strict=True)) for row in rows)
        return cls.model_validate({"gain_A_per_V": gain, "pole_Hz": pole, "zero_Hz": zero, "section": section})

    @classmethod
    def seeds(cls) -> tuple[Lag, ...]:
        """The lags that it grows from."""
        return Lag.seeds()

    def grown(self) -> "tuple[Structured, ...]":
        """See `grown`."""
        return grown(self)

    @property
    def sought(self) -> dict[str, Any]:
        """As many sections."""
        return {"kind": self.kind, "sections": len(self.section)}


def grown(law: Cascade) -> tuple[Structured, ...]:
    """A lag or structured law with one more section, which does next to nothing yet, at one frequency or another."""
    lag = law.lag
    if lag is None or len(law.sections) == MOST_SECTIONS:
        return ()
    found = []
    for frequency in SECTION_HZ:
        zero, pole = frequency * _APART, frequency / _APART
        more = Section(zero_Hz=zero, zero_damping_ratio=_NEUTRAL, pole_Hz=pole, pole_damping_ratio=_NEUTRAL)
        figures = {"gain_A_per_V": law.gain_A_per_V, "pole_Hz": lag.pole_Hz, "zero_Hz": lag.zero_Hz}
        found.append(Structured.model_validate(figures | {"section": (*law.sections, more)}))
    return tuple(found)
