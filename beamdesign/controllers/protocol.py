"""The record that every kind of controller derives from, with what may be asked of any, and the registry of kinds.

Also laws with open figures: what a tuner may vary, with responses and their derivatives.
"""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from math import inf, log, pi
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeVar

from beamdesign.code_digest import count_origin
from beamdesign.kinded import Kinded
from beamdesign.plant.actuators import FELT
from beamdesign.quantities import Frequency, range_of
from beamdesign.records import InputError

if TYPE_CHECKING:
    import casadi as ca
    import control
    import numpy as np
    from flint import fmpq_poly

    from beamdesign.plant.component import Law

if TYPE_CHECKING:
    Sensed = Literal["displacement_m", "inner_displacement_m", "load_pressure_Pa", "screw_force_N"]
    SENSORS: tuple[Sensed, ...]
else:
    SENSORS = ("displacement_m", "inner_displacement_m", *FELT)
    Sensed = Literal[SENSORS]
"""What a controller may sense of any rig: outer tip, which every one does, inner tip, what each actuator feels."""
SENSED: tuple[Sensed, ...] = SENSORS[:3]
"""The same of a cylinder: outer tip, inner tip, load pressure."""

ERRORS = {name: "error_V" if name == SENSORS[0] else "_error_".join(name.rsplit("_", 1)) for name in SENSORS}
"""What a controller is given of each thing sensed: what it should be, zero but for the command, less what it is."""

Need = Literal["lag", "lag and sections", "one sensor", "one law"]
"""What a purpose needs: a lag at most, one with second-order sections at most, the displacement alone, one law."""

Laws = tuple[tuple["Controller", tuple[float, float]], ...]
"""Linear laws, each with the payloads (least, most) in kg that it is for."""

ANY_PAYLOAD = (0.0, inf)

StateSpace = tuple["np.ndarray", "np.ndarray", "np.ndarray", "np.ndarray", "np.ndarray"]

Row = tuple[str, str, str]
"""A figure for people: name, value in full, what it means."""


@dataclass(frozen=True)
class TransferFunction:
    """A controller from error voltage (V) to current (A) as a ratio of exact polynomials in s."""

    numerator: "fmpq_poly"
    denominator: "fmpq_poly"


@dataclass(frozen=True)
class SensedLaw:
    """A controller of one or more sensors over one denominator, exact.

    Attributes:
        sensors: what it senses, of `SENSORS`; the first is the displacement.
        numerators: one per sensor: to current (A) from error volts, then from what else is sensed (m, Pa), with its
            sign turned.
        denominator: for an `Observer` det(sI - a), whether or not each of its states shows.
    """

    sensors: tuple[str, ...]
    numerators: tuple["fmpq_poly", ...]
    denominator: "fmpq_poly"


UNIT = 2 * pi * 10.0
"""rad/s: polynomials are in s over this, so that their coefficients are of moderate size."""

Polynomials = tuple[Sequence[Sequence[Any]], Sequence[Any]]
"""Numerators, one per sensor, and the denominator that they share; coefficients ascending in s / `UNIT`."""


@dataclass(frozen=True, eq=False)
class Form:
    """A family of laws with v variables, most of them logarithms, so that a step means as much anywhere.

    Attributes:
        sensors: what its laws sense, p of them.
        lower: (v,) least variables.
        upper: (v,) largest ones.
        polynomials: CasADi symbols of the variables to the law from each sensor to current, A/V, A/m or A/Pa.
        record: variables to the controller's record, its figures rounded to what a person would copy down.
        moves: (v,) how much further than a logarithm a variable may move in a step.
        gain_first: whether the first variable is the logarithm of a factor on the whole law.
        frequencies: (v,) which variables are logarithms of frequencies; none of them where it is not known.
        mass_unit_kg: in which the mass inside counts that is sought with it.
    """

    sensors: tuple[Sensed, ...]
    lower: "np.ndarray"
    upper: "np.ndarray"
    polynomials: Callable[[Sequence[Any]], Polynomials]
    record: "Callable[[np.ndarray], Controller]"
    moves: "np.ndarray"
    gain_first: bool = False
    frequencies: "np.ndarray | bool" = False
    mass_unit_kg: float = 1.0

    @property
    def size(self) -> int:
        """How many variables there are."""
        return len(self.lower)

    @cached_property
    def coefficients(self) -> "ca.Function":
        """Variables to coefficients (p + 1, q): a row for each numerator, then the denominator; and their Jacobian."""
        import casadi as ca

        variables = ca.SX.sym("variables", self.size)
        numerators, denominator = self.polynomials(ca.vertsplit(variables))
        rows = [*numerators, denominator]
        width = max(map(len, rows))
        table = ca.vertcat(*(ca.horzcat(*row, *[0.0] * (width - len(row))) for row in rows))
        return ca.Function("coefficients", [variables], [table, ca.jacobian(ca.vec(table), variables)])

    def responses(self, variables: "np.ndarray", s: "np.ndarray") -> "np.ndarray":
        """(p, n) from each sensor to current, at complex frequencies s (n,), rad/s."""
        import numpy as np

        table = np.asarray(self.coefficients(variables)[0])
        values = table @ np.vander(s / UNIT, table.shape[1], increasing=True).T
        return np.asarray(values[:-1] / values[-1])

    def slopes(self, variables: "np.ndarray", s: "np.ndarray") -> "np.ndarray":
        """(p, n, v) derivatives of the responses by the variables."""
        import numpy as np

        table, jacobian = (np.asarray(part) for part in self.coefficients(variables))
        powers = np.vander(s / UNIT, table.shape[1], increasing=True)
        values = table @ powers.T
        by = powers @ jacobian.reshape((*table.shape, -1), order="F")
        law = values[:-1] / values[-1]
        return np.asarray((by[:-1] - law[:, :, None] * by[-1]) / values[-1][:, None])


@cache
def at_pace(form: Form, pace: float, mass_unit_kg: float = 1.0) -> Form:
    """A form whose laws are for rigs so many times as quick and as heavy: bounds of its frequencies are higher."""
    import numpy as np

    most = np.log([range_of(Frequency).low, range_of(Frequency).high])
    lower, upper = (
        np.where(form.frequencies, np.clip(ends + log(pace), *most), ends) for ends in (form.lower, form.upper)
    )
    return form if pace == mass_unit_kg == 1 else replace(form, lower=lower, upper=upper, mass_unit_kg=mass_unit_kg)


def times(left: Sequence[Any], right: Sequence[Any]) -> list[Any]:
    """Coefficients of the product of two polynomials, ascending."""
    product: list[Any] = [0.0] * (len(left) + len(right) - 1)
    for i, one in enumerate(left):
        for j, two in enumerate(right):
            product[i + j] = product[i + j] + one * two
    return product


KINDS: "dict[str, type[Controller]]" = {}
"""Every registered kind of controller by its name."""


class Controller(Kinded):
    """A linear law from what is sensed to the current of the valve, or several that take turns.

    A kind derives from this in a file of its own, gives `kind` its name as the default, and is made known by
    `register`. A field of this type then takes any registered kind, one of a type between only those that derive from
    that.
    """

    known = KINDS
    if TYPE_CHECKING:

        @property
        def gain_A_per_V(self) -> float:
            """Factor on the whole of a linear law, a field of every kind of those."""

    @property
    def laws(self) -> Laws:
        """Its linear laws with their payloads, which overlap from one to the next: itself for any where it is one."""
        return ((self, ANY_PAYLOAD),)

    def law_for(self, outer_end_mass_kg: float) -> "Controller":
        """The one of its laws that is for a payload.

        Raises:
            ValueError: where none is, or several that differ.
        """
        fit = list(dict.fromkeys(law for law, (low, high) in self.laws if low <= outer_end_mass_kg <= high))
        if len(fit) != 1:
            many = len(fit) or "none"
            raise ValueError(f"{many} of the {len(self.laws)} laws of {self.kind!r} are for {outer_end_mass_kg:g} kg")
        return fit[0]

    @property
    def senses(self) -> tuple[Sensed, ...]:
        """What it hears, the displacement first."""
        return SENSED[:1]

    @property
    def added(self) -> tuple[Sensed, ...]:
        """What it senses beside the displacement."""
        return self.senses[1:]

    @abstractmethod
    def sensed_law(self) -> SensedLaw:
        """The law from everything that it senses to its current, exact."""

    def command_numerator(self) -> "fmpq_poly":
        """Numerator of current over command, A/V, with the denominator of its law, exact."""
        return self.sensed_law().numerators[0]

    def transfer_function(self) -> TransferFunction:
        """K_sa C(s), exact; C(0) = 1 but for an `Observer`.

        Raises:
            InputError: with added sensors, which `sensed_law` is for.
        """
        refuse(self, "one sensor", "one transfer function", "prototype")
        law = self.sensed_law()
        return TransferFunction(law.numerators[0], law.denominator)

    def state_space(self) -> "StateSpace":
        """Matrices from what is given of each thing sensed to its current, read off its `equations`.

        Returns:
            a (n, n), b (n, p), c (n,) and d (p,), and (n,) what command_V does to the states beside its part of the
            error.
        """
        from beamdesign.plant.component import law_inputs, state_space

        a, b, c, d = state_space(self.equations, self.figures())
        columns = law_inputs()
        places = [columns.index("error_V" if name == SENSED[0] else name) for name in self.senses]
        signs = [1.0, *[-1.0] * len(self.added)]
        return a, b[:, places] * signs, c, d[places] * signs, b[:, columns.index("command_V")]

    def sensor_responses(self, frequency_Hz: "np.ndarray") -> "dict[str, np.ndarray]":
        """Current over gain_A_per_V for each thing sensed, with its sign turned: (N,) complex, per V, m or Pa."""
        import numpy as np

        s, (a, b, c, d, _) = 2j * pi * np.asarray(frequency_Hz, dtype=float), self.state_space()
        pencil = s.reshape(-1, 1, 1) * np.eye(len(a)) - a
        inside = np.linalg.solve(pencil, np.broadcast_to(b.astype(complex), (len(pencil), *b.shape)))
        shapes = (np.einsum("i,kip->kp", c, inside) + d) / self.gain_A_per_V
        return {name: shapes[:, k].reshape(s.shape) for k, name in enumerate(self.senses)}

    def gain_at_high_frequency(self) -> float:
        """Size of K_sa C(s) from the displacement sensor far above all breaks, A/V."""
        return abs(float(self.state_space()[3][0]))

    def control_model(self) -> "control.StateSpace":
        """The controller as a python-control state space from `error_V` to `current_A`.

        For each added sensor it has one more input, such as `inner_displacement_error_m`: what that sensor reads with
        its sign turned.
        """
        import control

        a, b, c, d, _ = self.state_space()
        signals: dict[str, Any] = {"inputs": [ERRORS[name] for name in self.senses], "outputs": ["current_A"]}
        return control.ss(a, b, c.reshape(1, -1), d.reshape(1, -1), **signals, name="controller")

    @property
    @abstractmethod
    def equations(self) -> "Law":
        """Its equations in the rig, figures apart."""

    @abstractmethod
    def figures(self) -> dict[str, float]:
        """Figures of its `equations` by name, SI; frequencies in rad/s."""

    def form(self) -> "tuple[Form, np.ndarray] | None":
        """What a tuner varies, and the variables (v,) at which this law stands; None where there is no such form."""
        return None

    @classmethod
    def seeds(cls) -> "tuple[Controller, ...]":
        """Laws that a tuner begins with where none of this kind is given; their gain is lowered as far as is needed."""
        return ()

    grows: ClassVar[bool] = False
    """Whether the seeds are to be grown, as often as is asked for."""

    def grown(self) -> "tuple[Controller, ...]":
        """Laws that do next to the same and have more to tune, to go on with; none where it grows no further."""
        return ()

    @property
    def schedule(self) -> Any:
        """Itself where it has several laws, a `Scheduled` with how one of them is chosen; else None."""
        return None

    @property
    def lag(self) -> Any:
        """The lag that it begins with, a `Break`, where it has one; else None."""
        return None

    @property
    def sections(self) -> tuple[Any, ...]:
        """Its second-order sections, each a `Section`, where it has such."""
        return ()

    @property
    def sought(self) -> dict[str, Any]:
        """What `beamdesign.synthesis.tuning.tune` is asked for another of its kind: kind, and sections or sensors."""
        return {"kind": self.kind}

    def words(self, digits: int = 3) -> str:
        """Its form in a few words, with breaks to so many digits, without its gain."""
        return self.kind

    def summary(self) -> list[tuple[str, str]]:
        """Name and value of each figure in short, as a terminal shows them."""
        return [(name, str(value)) for name, value in self.model_dump().items()]

    @abstractmethod
    def rows(self) -> list[Row]:
        """Each of its figures for people."""

    def lacks(self, need: Need) -> str:
        """Why it cannot serve what has this need, in words that go on from its kind; empty where it can."""
        if need == "one law":
            return ""
        if need == "one sensor":
            return f"hears {', '.join(self.added)} too; keep 'displacement_m' alone" if self.added else ""
        return "is of another form; give a lag"


C = TypeVar("C", bound=Controller)


def register(kind: type[C]) -> type[C]:
    """Make a kind known by the default of its field `kind`, which its class may have as a decorator.

    Raises:
        ValueError: where another kind has that name.
    """
    name = str(kind.model_fields["kind"].default)
    if name in KINDS:
        raise ValueError(f"there is a controller of kind {name!r} already")
    KINDS[name] = kind
    count_origin(KINDS, name)
    return kind


def form_of(kind: str) -> Form:
    """The form of a registered kind's first seed.

    Raises:
        ValueError: for a kind that has none.
    """
    for seed in KINDS[kind].seeds():
        if (sought_from := seed.form()) is not None:
            return sought_from[0]
    raise ValueError(f"a {kind} controller has no form to be tuned in")


def refuse(controller: Controller, need: Need, purpose: str, source: object) -> None:
    """Refuse a controller what it cannot serve, with the reason that its kind states.

    Args:
        controller: any.
        need: of the purpose.
        purpose: in words.
        source: file or argument that it comes from, for the message.

    Raises:
        InputError: where it lacks what is needed.
    """
    if reason := controller.lacks(need):
        key = "controller.sensors" if need == "one sensor" and controller.added else "controller.kind"
        raise InputError(str(source), [(key, f"{controller.kind!r} is not for {purpose}: it {reason}")])
