"""Records and figures that a caller of a function gives, checked as those of a file are."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import wraps
from inspect import signature
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin

from beamdesign.quantities import MassOrNone, range_of
from beamdesign.records import InputError

MASS = "payload.outer_end_mass_kg"
"""What a message calls a mass on the outer tip."""

READERS = {
    "Prototype": "read_prototype",
    "DesignProblem": "read_problem",
    "BenchPrototype": "read_bench_prototype",
    "Dataset": "read_dataset",
    "BenchSet": "read_bench_set",
    "Scenario": "read_scenario",
}
"""Public function that reads a record, by the name of the record's class."""

_SHOWN = 60

Given = ParamSpec("Given")
Found = TypeVar("Found")


class WrongArgument(InputError, ValueError):
    """An argument that is not what it is expected to be, or a range whose end is below its beginning."""


def takes(*kinds: str) -> Callable[[Callable[Given, Found]], Callable[Given, Found]]:
    """Have a function refuse arguments of other kinds, such as a path for a record, and say what reads one.

    Args:
        kinds: of each of its first arguments the name of a class, or of several with blanks between them; the others
            are to be as they are annotated, as far as that can be judged.
    """

    def refusing(function: Callable[Given, Found]) -> Callable[Given, Found]:
        parameters = signature(function).parameters
        expected = dict(zip(parameters, kinds, strict=False))

        def why(key: str, given: object) -> str:
            if key in expected:
                return _of_another_kind(given, expected[key])
            # What is wrong with masses on the outer tip is told with the range that they may lie in, see below.
            judged = key in parameters and not key.startswith(("outer_end_mass", "ranges_kg"))
            return _unlike(parameters[key].annotation, given) if judged else ""

        @wraps(function)
        def called(*args: Given.args, **named: Given.kwargs) -> Found:
            given = {**dict(zip(parameters, args, strict=False)), **named}
            if wrong := [(key, reason) for key, one in given.items() if (reason := why(key, one))]:
                raise WrongArgument(function.__name__, wrong)
            return function(*map(_plain, args), **{key: _plain(one) for key, one in named.items()})

        return called

    return refusing


def _plain(given: Any) -> Any:
    """A number of numpy as that of Python, which exact arithmetic asks for; anything else as it is."""
    return given.item() if getattr(given, "ndim", None) == 0 and hasattr(given, "item") else given


def _unlike(annotation: Any, given: object) -> str:
    """That something is not as it is annotated, in words; empty where it is, or where that is judged elsewhere."""
    kinds = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)
    words = [named for kind in kinds if (named := _unmet(kind, given))]
    shown = repr(given)
    shown = shown if len(shown) <= _SHOWN else f"of type {type(given).__name__}"
    return "" if len(words) < len(kinds) else f"expected {' or '.join(words)}, is {shown}"


def _unmet(kind: Any, given: Any) -> str:
    """What one kind is called that something is not of; empty where it is, or where that is judged elsewhere."""
    origin, of = get_origin(kind) or kind, get_args(kind)
    many = isinstance(given, Iterable) and not isinstance(given, str | bytes) and getattr(given, "ndim", 1) > 0
    name, met = {
        NoneType: ("None", given is None),
        bool: ("True or False", isinstance(given, bool) or type(given).__name__ == "bool"),  # numpy's, too
        int: ("a whole number", isinstance(given, Integral) and not isinstance(given, bool)),
        float: ("a number", isinstance(given, Real) and not isinstance(given, bool)),
        str: ("a text", isinstance(given, str)),
        Path: ("a path", isinstance(given, str | PathLike)),
        Literal: (" or ".join(map(repr, of)), isinstance(given, str) and given in of),
        Mapping: ("a mapping", isinstance(given, Mapping)),
        Callable: ("a function", callable(given)),
    }.get(origin, ("", True))
    if origin is tuple and of and Ellipsis not in of:
        each = [*given] if many else []
        name, met = f"{len(of)} numbers", len(each) == len(of) and all(isinstance(one, Real) for one in each)
    elif origin in (Sequence, Collection):
        name, met = "a list", many
        if many and of and not isinstance(given, Mapping):
            name = next((f"a list, of each {why}" for one in given if (why := _unlike(of[0], one))), "")
            met = not name
    elif isinstance(kind, type) and kind.__module__.startswith(__package__):
        article = "an" if kind.__name__[0] in "AEIO" else "a"
        name, met = f"{article} {kind.__name__}", isinstance(given, kind)
    return "" if met else name


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
        WrongArgument: for an empty range.
    """
    if given is None:
        raise InputError(name, [(MASS, "missing; give it there or as an argument")])
    number = getattr(given, "ndim", 1) == 0  # numpy has arrays of no dimension, which are none to go through
    pair = tuple(given) if isinstance(given, Iterable) and not number else ()
    if len(pair) != 2:
        raise InputError(name, [(MASS, "expected a pair of masses in kg")])
    low, high = checked(name, MASS, MassOrNone, *pair)
    if low > high:
        raise WrongArgument(name, [(MASS, f"empty range: {low:g} is above {high:g}; give the least mass first")])
    return low, high


def checked_mass_kg(name: str, given: object) -> float:
    """One mass on the outer tip, kg.

    Raises:
        InputError: for what is no plausible mass.
    """
    return checked(name, MASS, MassOrNone, given)[0]
