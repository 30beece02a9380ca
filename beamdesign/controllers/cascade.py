"""Laws of the displacement alone that are factors of first and second order in series.

Of its kinds the factors are at most a lag, which gives a loop its gain at low frequencies, and sections behind it.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import chain
from math import pi, prod
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

from pydantic import Field

from beamdesign import quantities as q
from beamdesign.controllers.protocol import (
    SENSED,
    UNIT,
    Controller,
    Form,
    Need,
    Polynomials,
    Row,
    SensedLaw,
    TransferFunction,
    refuse,
    times,
)  # fmt: skip
from beamdesign.plant.component import Series
from beamdesign.records import Record

if TYPE_CHECKING:
    import numpy as np

_GAIN = (1e-4, 1e4)
"""A/V, least and largest gain that is tuned for."""

_DIGITS = 6
"""To which figures are rounded that a tuner has found: what a person would copy down."""


class Factor(ABC):
    """One factor of a cascade, of unit static gain.

    A kind has its figures as fields, named as its record has them, with frequencies in Hz.
    """

    order: ClassVar[int]
    """1 or 2."""

    open_between: ClassVar[Mapping[str, tuple[float, float]]]
    """Its figures, in the order of `beamdesign.plant.component.Series`: least and largest that a tuner gives."""

    @staticmethod
    @abstractmethod
    def ratio(figures: Sequence[Any]) -> tuple[list[Any], list[Any]]:
        """Numerator and denominator, ascending in s, of figures that may be symbols: a time 1 / (2 pi f) for each f."""

    @property
    def stated(self) -> tuple[float, ...]:
        """Its figures."""
        return tuple(getattr(self, name) for name in self.open_between)

    def figures(self) -> tuple[float, ...]:
        """The same with frequencies in rad/s."""
        return tuple(self._with_frequencies(lambda value: 2 * pi * value, self.stated))

    @classmethod
    def _with_frequencies(cls, changed: Callable[[Any], Any], figures: Iterable[Any]) -> list[Any]:
        """Its figures, the frequencies among them changed."""
        named = zip(cls.open_between, figures, strict=True)
        return [changed(value) if name.endswith("_Hz") else value for name, value in named]

    @classmethod
    def open(cls, figures: Sequence[Any], unit: float) -> tuple[list[Any], list[Any]]:
        """Numerator and denominator, ascending in s / unit (rad/s), of figures as stated, which may be symbols."""
        return cls.ratio(cls._with_frequencies(lambda value: unit / (2 * pi * value), figures))

    def exact(self) -> TransferFunction:
        """Numerator and denominator, with the decimal form of every 2 pi f taken as exact."""
        from flint import fmpq_poly

        from beamdesign.polynomial import exact

        figures = self._with_frequencies(lambda value: 1 / value, map(exact, self.figures()))
        return TransferFunction(*map(fmpq_poly, self.ratio(figures)))


@dataclass(frozen=True)
class Break(Factor):
    """(1 + s / zero) / (1 + s / pole)."""

    pole_Hz: float
    zero_Hz: float
    order: ClassVar[int] = 1
    open_between: ClassVar[Mapping[str, tuple[float, float]]] = {"pole_Hz": (0.005, 50.0), "zero_Hz": (0.5, 400.0)}

    @staticmethod
    def ratio(figures: Sequence[Any]) -> tuple[list[Any], list[Any]]:
        """See `Factor`."""
        pole, zero = figures
        return [1, zero], [1, pole]


class Section(Record, Factor):
    """C_i(s) = (1 + 2 d s / z + s^2 / z^2) / (1 + 2 e s / p + s^2 / p^2), one second-order section of a controller."""

    zero_Hz: q.Frequency = Field(description="z, natural frequency of the numerator")
    zero_damping_ratio: q.SectionDamping = Field(description="d, of the numerator; small is a notch")
    pole_Hz: q.Frequency = Field(description="p, natural frequency of the denominator")
    pole_damping_ratio: q.SectionDamping = Field(description="e, of the denominator; small is a resonance")
    order: ClassVar[int] = 2
    open_between: ClassVar[Mapping[str, tuple[float, float]]] = {
        "zero_Hz": (2.0, 2000.0),
        "zero_damping_ratio": (0.05, 5.0),
        "pole_Hz": (2.0, 1000.0),
        "pole_damping_ratio": (0.1, 5.0),  # one less damped would ring in the controller, and move with its parts
    }

    @staticmethod
    def ratio(figures: Sequence[Any]) -> tuple[list[Any], list[Any]]:
        """See `Factor`."""
        zero, zero_damping, pole, pole_damping = figures
        return [1, 2 * zero_damping * zero, zero * zero], [1, 2 * pole_damping * pole, pole * pole]


class Cascade(Controller):
    """K_sa C(s) on the error voltage alone, C(s) a product of factors of first and second order, C(0) = 1.

    A kind states its factors, in the order of its fields, whose floats are their figures; all else follows.
    """

    gain_A_per_V: q.LawGain = Field(description="K_sa, servo-amplifier gain at zero frequency")

    @property
    @abstractmethod
    def factors(self) -> tuple[Factor, ...]:
        """Of C(s), in the order in which they stand behind each other."""

    @property
    def lag(self) -> Break | None:
        """Its first factor where that is of first order."""
        first = next(iter(self.factors), None)
        return first if isinstance(first, Break) else None

    def lacks(self, need: Need) -> str:
        """Why it cannot serve what has this need."""
        kept = (self.lag is not None) + (len(self.sections) if need == "lag and sections" else 0)
        others = 0 if need in ("one sensor", "one law") else len(self.factors) - kept
        return f"has factors that it has no place for, {others} of them; give a lag" if others else ""

    @property
    def sections(self) -> tuple[Section, ...]:
        """Its factors of second order."""
        return tuple(factor for factor in self.factors if isinstance(factor, Section))

    def words(self, digits: int = 3) -> str:
        """Its kind, with the breaks of its lag."""
        lag = self.lag
        return f"{self.kind} {lag.pole_Hz:.{digits}g}/{lag.zero_Hz:.{digits}g} Hz" if lag else self.kind

    def summary(self) -> list[tuple[str, str]]:
        """Its figures, those of each section in one row."""
        figures = self.model_dump()
        figures.pop("section", None)
        rows = [(name, str(value)) for name, value in figures.items()]
        for k, section in enumerate(self.sections, start=1):
            zero = f"zero {section.zero_Hz:g} Hz damped {section.zero_damping_ratio:g}"
            pole = f"pole {section.pole_Hz:g} Hz damped {section.pole_damping_ratio:g}"
            rows.append((f"section {k}", f"{zero}, {pole}"))
        return rows

    def rows(self) -> list[Row]:
        """Its gain, then the figures of each factor; between them what a lag makes of the gain."""
        rows = [("gain", q.quantity(self.gain_A_per_V, "A/V", 7), "K_sa, current per error voltage when static")]
        breaks = [factor for factor in self.factors if isinstance(factor, Break)]
        for n, one in enumerate(breaks, start=1):
            which = f" {n}" if n > 1 else ""
            level = "from here up it stays level again"
            falls = ("from here up the gain falls", level)
            at_pole, at_zero = falls if one.pole_Hz <= one.zero_Hz else (level, "from here up the gain rises")
            rows.append((f"pole{which}", q.quantity(one.pole_Hz, "Hz", 7), at_pole))
            rows.append((f"zero{which}", q.quantity(one.zero_Hz, "Hz", 7), at_zero))
        if breaks:
            drop = prod(one.pole_Hz / one.zero_Hz for one in breaks)
            share = f"1/{q.decimal(1 / drop, 3)} of" if drop <= 1 else f"{q.decimal(drop, 3)} times"
            above = f"gain above the {'zero' if drop <= 1 else 'pole'}"
            above += ", before the sections" if self.sections else ""
            rows.append((above, q.quantity(self.gain_A_per_V * drop, "A/V"), f"{share} the static gain"))
        for k, section in enumerate(self.sections, start=1):
            zero, pole = (
                f"{q.quantity(frequency, 'Hz', 7)}, damping ratio {q.decimal(damping, 6)}"
                for frequency, damping in (section.stated[:2], section.stated[2:])
            )
            rows += [(f"zeros of section {k}", zero, "numerator"), (f"poles of section {k}", pole, "denominator")]
        return rows

    def sensed_law(self) -> SensedLaw:
        """K_sa C(s), exact."""
        from flint import fmpq_poly

        from beamdesign.polynomial import exact

        factors = [factor.exact() for factor in self.factors]
        numerator = prod((one.numerator for one in factors), start=fmpq_poly([exact(self.gain_A_per_V)]))
        denominator = prod((one.denominator for one in factors), start=fmpq_poly([1]))
        return SensedLaw(self.senses, (numerator,), denominator)

    def form(self) -> "tuple[Form, np.ndarray] | None":
        """Logarithms of its gain and of the figures of each factor; None where its fields are not these, in order."""
        import numpy as np

        figures = [self.gain_A_per_V, *chain.from_iterable(factor.stated for factor in self.factors)]
        try:
            same = type(self).of(figures) == self
        except ValueError:  # there are more or fewer of them
            same = False
        return (_form(type(self), tuple(map(type, self.factors))), np.log(figures)) if same else None

    @classmethod
    def of(cls, figures: Sequence[float]) -> Self:
        """The record of a gain and figures of its factors, in the order of its fields."""
        names = [name for name in cls.model_fields if name != "kind"]
        return cls.model_validate(dict(zip(names, figures, strict=True)))

    @property
    def equations(self) -> Series:
        """Its equations in the rig, figures apart."""
        return Series(tuple(factor.order for factor in self.factors))

    def figures(self) -> dict[str, float]:
        """The gain, then the figures of each factor."""
        own = (self.gain_A_per_V, *chain.from_iterable(factor.figures() for factor in self.factors))
        return dict(zip(self.equations.parameters, own, strict=True))


@cache
def _form(kind: type[Cascade], factors: tuple[type[Factor], ...]) -> Form:
    import casadi as ca
    import numpy as np

    ranges = [("gain_A_per_V", _GAIN), *chain.from_iterable(factor.open_between.items() for factor in factors)]
    bounds, frequencies = np.log([ends for _, ends in ranges]), np.array([key.endswith("_Hz") for key, _ in ranges])

    def polynomials(variables: Sequence[Any]) -> Polynomials:
        gain, *figures = map(ca.exp, variables)
        numerator, denominator = [gain], [1.0]
        for factor in factors:
            count = len(factor.open_between)
            above, below = factor.open(figures[:count], UNIT)
            numerator, denominator, figures = times(numerator, above), times(denominator, below), figures[count:]
        return [numerator], denominator

    def record(variables: "np.ndarray") -> Cascade:
        return kind.of([float(f"{value:.{_DIGITS}g}") for value in np.exp(variables)])

    return Form(SENSED[:1], bounds[:, 0], bounds[:, 1], polynomials, record, np.ones(len(bounds)), True, frequencies)


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
