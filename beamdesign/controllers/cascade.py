"""Laws of the displacement alone that are factors of first and second order in series."""

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, reduce
from itertools import chain
from math import pi, prod
from operator import mul
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Protocol, Self

from pydantic import Field

from beamdesign import quantities as q
from beamdesign.controllers.protocol import ERRORS, SENSED, Controller, Need, Row, SensedLaw, TransferFunction
from beamdesign.records import Record
from beamdesign.rig.electronics import Series

if TYPE_CHECKING:
    import control
    import numpy as np

    from beamdesign.controllers.form import Form, Polynomials


Matrices = tuple["np.ndarray", "np.ndarray", "np.ndarray", float]
"""a (n, n), b (n,), c (n,) and d of one input and one output."""


Bounds = tuple[tuple[float, float], ...]
_GAIN = (1e-4, 100.0)
"""A/V, least and largest gain that is tuned for."""

_DIGITS = 6
"""To which figures are rounded that a tuner has found: what a person would copy down."""


class Factor(Protocol):
    """One factor of a cascade, of unit static gain."""

    @property
    def order(self) -> int:
        """1 or 2."""

    def exact(self) -> TransferFunction:
        """Numerator and denominator, with the decimal form of every 2 pi f taken as exact."""

    def through(self, s: "np.ndarray", response: "np.ndarray") -> "np.ndarray":
        """What has this response (N,) at s (rad/s) before it, behind it."""

    def gain_at_high_frequency(self) -> float:
        """Far above its breaks."""

    def matrices(self) -> Matrices:
        """State space of the factor alone."""

    def figures(self) -> tuple[float, ...]:
        """As `beamdesign.rig.electronics.Series` names them; frequencies in rad/s."""

    @property
    def stated(self) -> tuple[float, ...]:
        """The same as its record has them, frequencies in Hz."""

    open_between: ClassVar[Bounds]
    """Least and largest value that a tuner gives each of these."""

    @staticmethod
    def open(figures: Sequence[Any], unit: float) -> tuple[list[Any], list[Any]]:
        """Numerator and denominator, ascending in s / unit (rad/s), of such figures, which may be symbols."""


@dataclass(frozen=True)
class Break:
    """(1 + s / zero) / (1 + s / pole)."""

    pole_Hz: float
    zero_Hz: float
    order = 1

    def exact(self) -> TransferFunction:
        """See `Factor`."""
        from flint import fmpq_poly

        from beamdesign.polynomial import exact

        numerator, denominator = (fmpq_poly([1, 1 / exact(2 * pi * f)]) for f in (self.zero_Hz, self.pole_Hz))
        return TransferFunction(numerator, denominator)

    def through(self, s: "np.ndarray", response: "np.ndarray") -> "np.ndarray":
        """See `Factor`."""
        return response * ((1 + s / (2 * pi * self.zero_Hz)) / (1 + s / (2 * pi * self.pole_Hz)))

    def gain_at_high_frequency(self) -> float:
        """See `Factor`."""
        return self.pole_Hz / self.zero_Hz

    def matrices(self) -> Matrices:
        """See `Factor`."""
        import numpy as np

        pole, ratio = 2 * pi * self.pole_Hz, self.pole_Hz / self.zero_Hz
        return np.array([[-pole]]), np.array([pole]), np.array([1 - ratio]), ratio

    def figures(self) -> tuple[float, ...]:
        """Pole and zero."""
        return 2 * pi * self.pole_Hz, 2 * pi * self.zero_Hz

    @property
    def stated(self) -> tuple[float, ...]:
        """Pole and zero."""
        return self.pole_Hz, self.zero_Hz

    open_between: ClassVar[Bounds] = ((0.005, 50.0), (0.5, 400.0))

    @staticmethod
    def open(figures: Sequence[Any], unit: float) -> tuple[list[Any], list[Any]]:
        """See `Factor`."""
        pole, zero = figures
        return [1.0, unit / (2 * pi * zero)], [1.0, unit / (2 * pi * pole)]


class Section(Record):
    """C_i(s) = (1 + 2 d s / z + s^2 / z^2) / (1 + 2 e s / p + s^2 / p^2), one second-order section of a controller."""

    zero_Hz: Annotated[q.Frequency, Field(description="z, natural frequency of the numerator")]
    zero_damping_ratio: Annotated[q.SectionDamping, Field(description="d, of the numerator; small is a notch")]
    pole_Hz: Annotated[q.Frequency, Field(description="p, natural frequency of the denominator")]
    pole_damping_ratio: Annotated[q.SectionDamping, Field(description="e, of the denominator; small is a resonance")]

    @property
    def order(self) -> int:
        """2."""
        return 2

    def exact(self) -> TransferFunction:
        """See `Factor`."""
        from flint import fmpq_poly

        from beamdesign.polynomial import exact

        zero, pole = exact(2 * pi * self.zero_Hz), exact(2 * pi * self.pole_Hz)
        return TransferFunction(
            fmpq_poly([1, 2 * exact(self.zero_damping_ratio) / zero, 1 / zero**2]),
            fmpq_poly([1, 2 * exact(self.pole_damping_ratio) / pole, 1 / pole**2]),
        )

    def through(self, s: "np.ndarray", response: "np.ndarray") -> "np.ndarray":
        """See `Factor`."""
        zero, pole = s / (2 * pi * self.zero_Hz), s / (2 * pi * self.pole_Hz)
        above = response * (1 + 2 * self.zero_damping_ratio * zero + zero**2)
        return above / (1 + 2 * self.pole_damping_ratio * pole + pole**2)

    def gain_at_high_frequency(self) -> float:
        """See `Factor`."""
        return (self.pole_Hz / self.zero_Hz) ** 2

    def matrices(self) -> Matrices:
        """See `Factor`."""
        import numpy as np

        zero, damping = 2 * pi * self.zero_Hz, self.zero_damping_ratio
        natural, own = 2 * pi * self.pole_Hz, self.pole_damping_ratio
        through = (natural / zero) ** 2
        # Both states of the order of the input. Of the numerator what the direct gain leaves goes to them.
        a = np.array([[0.0, natural], [-natural, -2 * own * natural]])
        c = np.array([1 - through, natural * (2 * damping / zero - 2 * own * through / natural)])
        return a, np.array([0.0, natural]), c, through

    def figures(self) -> tuple[float, ...]:
        """Zero and pole, each with its damping ratio."""
        return 2 * pi * self.zero_Hz, self.zero_damping_ratio, 2 * pi * self.pole_Hz, self.pole_damping_ratio

    @property
    def stated(self) -> tuple[float, ...]:
        """Its fields."""
        return self.zero_Hz, self.zero_damping_ratio, self.pole_Hz, self.pole_damping_ratio

    open_between: ClassVar[Bounds] = ((2.0, 2000.0), (0.05, 5.0), (2.0, 1000.0), (0.1, 5.0))
    """A pole less damped than 0.1 would ring in the controller itself, and move with its parts."""

    @staticmethod
    def open(figures: Sequence[Any], unit: float) -> tuple[list[Any], list[Any]]:
        """See `Factor`."""

        def pair(frequency: Any, damping: Any) -> list[Any]:
            u = unit / (2 * pi * frequency)
            return [1.0, 2 * damping * u, u * u]

        return pair(*figures[:2]), pair(*figures[2:])


class Cascade(Controller):
    """K_sa C(s) on the error voltage alone, C(s) a product of factors of first and second order, C(0) = 1.

    A kind states its factors, in the order of its fields, whose floats are their figures; all else follows.
    """

    gain_A_per_V: Annotated[q.LawGain, Field(description="K_sa, servo-amplifier gain at zero frequency")]

    @property
    @abstractmethod
    def factors(self) -> tuple[Factor, ...]:
        """Of C(s), in the order in which they stand behind each other."""

    @property
    def cascade(self) -> Self:
        """Itself."""
        return self

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
        from beamdesign.report.quantity import decimal, quantity

        means = "K_sa, valve current per error voltage when static"
        rows = [("gain", quantity(self.gain_A_per_V, "A/V", 7), means)]
        breaks = [factor for factor in self.factors if isinstance(factor, Break)]
        for n, one in enumerate(breaks, start=1):
            which = f" {n}" if n > 1 else ""
            rows += [
                (f"pole{which}", quantity(one.pole_Hz, "Hz", 7), "from here up the gain falls"),
                (f"zero{which}", quantity(one.zero_Hz, "Hz", 7), "from here up it stays level again"),
            ]
        if breaks:
            drop = prod(one.gain_at_high_frequency() for one in breaks)
            above = "gain above the zero" + (", before the sections" if self.sections else "")
            share = f"1/{decimal(1 / drop, 3)} of the static gain"
            rows.append((above, quantity(self.gain_A_per_V * drop, "A/V"), share))
        for k, section in enumerate(self.sections, start=1):
            zero, pole = (
                f"{quantity(frequency, 'Hz', 7)}, damping ratio {decimal(damping, 6)}"
                for frequency, damping in (
                    (section.zero_Hz, section.zero_damping_ratio),
                    (section.pole_Hz, section.pole_damping_ratio),
                )
            )
            rows += [(f"zeros of section {k}", zero, "numerator"), (f"poles of section {k}", pole, "denominator")]
        return rows

    def transfer_function(self) -> TransferFunction:
        """K_sa C(s), exact."""
        from flint import fmpq_poly

        from beamdesign.polynomial import exact

        whole = TransferFunction(fmpq_poly([exact(self.gain_A_per_V)]), fmpq_poly([1]))
        return reduce(mul, (factor.exact() for factor in self.factors), whole)

    def sensed_law(self) -> SensedLaw:
        """The same as a law of sensors."""
        law = self.transfer_function()
        return SensedLaw(self.senses, (law.numerator,), law.denominator)

    def sensor_responses(self, frequency_Hz: "np.ndarray") -> "dict[str, np.ndarray]":
        """C(s) at the given frequencies."""
        import numpy as np

        s = 2j * pi * np.asarray(frequency_Hz, dtype=float)
        shape = np.ones_like(s)
        for factor in self.factors:
            shape = factor.through(s, shape)
        return {"displacement_m": np.asarray(shape)}

    def gain_at_high_frequency(self) -> float:
        """K_sa C(s) far above all breaks, A/V."""
        gain = self.gain_A_per_V
        for factor in self.factors:
            gain *= factor.gain_at_high_frequency()
        return gain

    def matrices(self) -> Matrices:
        """State space of C(s), its factors in series, of unit static gain."""
        return in_series(factor.matrices() for factor in self.factors)

    def control_model(self) -> "control.StateSpace":
        """Its factors in series: one polynomial of their product would lose digits."""
        import control
        from flint import fmpq_poly

        from beamdesign.polynomial import exact

        parts = [factor.exact() for factor in self.factors]
        gain = TransferFunction(fmpq_poly([exact(self.gain_A_per_V)]), fmpq_poly([1]))
        first, *others = [gain * parts[0], *parts[1:]] if parts else [gain]
        model = _state_space(first)
        for part in others:
            model = _state_space(part) * model
        signals: dict[str, Any] = {"inputs": [ERRORS["displacement_m"]], "outputs": ["current_A"]}
        return control.ss(model.A, model.B, model.C, model.D, **signals, name="controller")

    def form(self) -> "tuple[Form, np.ndarray]":
        """Logarithms of its gain and of the figures of each factor, as its fields have them."""
        import numpy as np

        figures = [self.gain_A_per_V, *chain.from_iterable(factor.stated for factor in self.factors)]
        return _form(type(self), tuple(map(type, self.factors))), np.log(figures)

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


def in_series(parts: Iterable[Matrices]) -> Matrices:
    """State space of parts behind each other, in their order."""
    import numpy as np

    a, b, c, d = np.zeros((0, 0)), np.zeros(0), np.zeros(0), 1.0
    for a_next, b_next, c_next, d_next in parts:
        n, m = len(b), len(b_next)
        joined = np.zeros((n + m, n + m))
        joined[:n, :n], joined[n:, :n], joined[n:, n:] = a, np.outer(b_next, c), a_next
        a, b = joined, np.concatenate([b, b_next * d])
        c, d = np.concatenate([d_next * c, c_next]), d * d_next
    return a, b, c, d


def _state_space(exact_form: TransferFunction) -> "control.StateSpace":
    import control

    numerator, denominator = (
        [float(c) for c in reversed(p.coeffs())] for p in (exact_form.numerator, exact_form.denominator)
    )
    return control.tf2ss(control.tf(numerator, denominator))


@cache
def _form(kind: type[Cascade], factors: tuple[type[Factor], ...]) -> "Form":
    import casadi as ca
    import numpy as np

    from beamdesign.controllers.form import UNIT, Form, times

    bounds = np.log([_GAIN, *chain.from_iterable(factor.open_between for factor in factors)])

    def polynomials(variables: Sequence[Any]) -> "Polynomials":
        gain, *figures = map(ca.exp, variables)
        numerator, denominator = [gain], [1.0]
        for factor in factors:
            count = len(factor.open_between)
            above, below = factor.open(figures[:count], UNIT)
            numerator, denominator, figures = times(numerator, above), times(denominator, below), figures[count:]
        return [numerator], denominator

    def record(variables: "np.ndarray") -> Cascade:
        return kind.of([float(f"{value:.{_DIGITS}g}") for value in np.exp(variables)])

    return Form(SENSED[:1], bounds[:, 0], bounds[:, 1], polynomials, record, np.ones(len(bounds)))
