"""Records and figures that a caller of a function gives, checked as those of a file are."""

from collections.abc import Callable, Iterable
from functools import wraps
from inspect import signature
from numbers import Real
from typing import Any, ParamSpec, TypeVar

from beamdesign.quantities import MassOrNone, range_of
from beamdesign.records import InputError

MASS = "payload.outer_end_mass_kg"
"""What a message calls a mass on the outer tip."""

READERS = {
    "Prototype": "read_prototype",
    "DesignProblem": "read_problem",
    "Dataset": "read_dataset",
    "Scenario": "read_scenario",
}
"""Public function that reads a record, by the name of the record's class."""

Given = ParamSpec("Given")
Found = TypeVar("Found")


def takes(*kinds: str) -> Callable[[Callable[Given, Found]], Callable[Given, Found]]:
    """Have a function refuse first arguments of other kinds, such as a path for a record, and say what reads one.

    Args:
        kinds: of each of its first arguments the name of a class, or of several with blanks between them.
    """

    def refusing(function: Callable[Given, Found]) -> Callable[Given, Found]:
        expected = dict(zip(signature(function).parameters, kinds, strict=False))

        @wraps(function)
        def called(*args: Given.args, **named: Given.kwargs) -> Found:
            given = dict(zip(expected, args, strict=False)) | {key: named[key] for key in expected if key in named}
            if wrong := [(key, why) for key, one in given.items() if (why := _of_another_kind(one, expected[key]))]:
                raise InputError(function.__name__, wrong)
            return function(*args, **named)

        return called

    return refusing


def _of_another_kind(given: object, kinds: str) -> str:
    """That something is of none of some kinds, in words; empty where it is of one."""
    if {one.__name__ for one in type(given).__mro__} & {*kinds.split()}:
        return ""
    first = kinds.split()[0]
    reads = f"; beamdesign.{READERS[first]} reads one from its file" if first in READERS else ""
    return f"expected a {first}, is of type {type(given).__name__}{reads}"


def why_implausible(quantity: Any, value: float, key: str) -> str:
    """Why a figure is refused, in words; empty where it lies in the range of its quantity.

    Args:
        quantity: of `beamdesign.quantities`.
        value: the figure.
        key: what the message calls it, ending with its unit.
    """
    plausible = range_of(quantity)
    return "" if value in plausible else plausible.refusal(f"{value:g}", key)


def checked(name: str, key: str, quantity: Any, *given: object) -> tuple[float, ...]:
    """Figures of one quantity as floats.

    Args:
        name: of the rig or the study, for the message.
        key: what the message calls them, ending with their unit.
        quantity: of `beamdesign.quantities`.
        given: numbers of Python or of numpy.

    Raises:
        InputError: for what is no number, or not plausible.
    """
    found, wrong = list[float](), list[str]()
    for figure in given:
        if not isinstance(figure, Real):
            wrong.append(f"expected a number, is {figure!r}")
        elif reason := why_implausible(quantity, float(figure), key.rpartition(".")[2]):
            wrong.append(reason)
        else:
            found.append(float(figure))
    if wrong:
        raise InputError(name, [(key, reason) for reason in dict.fromkeys(wrong)])
    return tuple(found)


def checked_range_kg(name: str, given: object) -> tuple[float, float]:
    """Masses (least, most) on the outer tip.

    Args:
        name: of the rig or the study, for the message.
        given: two numbers in kg, as a tuple, a list or an array; None where nobody says.

    Raises:
        InputError: for what is no pair of plausible masses, and for None.
        ValueError: for an empty range.
    """
    if given is None:
        raise InputError(name, [(MASS, "missing; give it there or as an argument")])
    number = getattr(given, "ndim", 1) == 0  # numpy has arrays of no dimension, which are none to go through
    pair = tuple(given) if isinstance(given, Iterable) and not number else ()
    if len(pair) != 2:
        raise InputError(name, [(MASS, "expected a pair of masses in kg")])
    low, high = checked(name, MASS, MassOrNone, *pair)
    if low > high:
        raise ValueError(f"empty range: {low:g} is above {high:g}")
    return low, high


def checked_mass_kg(name: str, given: object) -> float:
    """One mass on the outer tip, kg.

    Raises:
        InputError: for what is no plausible mass.
    """
    return checked(name, MASS, MassOrNone, given)[0]
