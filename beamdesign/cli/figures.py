"""The figures of options: each belongs to a quantity, and is refused outside the range in which that is plausible."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any


def refuse_implausible(
    command: str, figures: Mapping[str, tuple[float | None, Any]], problems: Iterable[tuple[str, str]] = ()
) -> None:
    """Refuse the figures of options outside the ranges of their quantities, and what else is wrong, all at once.

    Args:
        command: that was called, or the option where there is one alone.
        figures: value (None where not given) and quantity of `beamdesign.quantities`, by option.
        problems: found otherwise.

    Raises:
        InputError: where there is any problem.
    """
    from beamdesign.quantities import range_of
    from beamdesign.records import InputError

    wrong = [
        (option, range_of(quantity).refusal(f"{value:g}", option.replace("-", "_")))
        for option, (value, quantity) in figures.items()
        if value is not None and value not in range_of(quantity)
    ]
    if wrong := [*wrong, *problems]:
        raise InputError(command, wrong)


def figures_of(
    option: str, text: str, quantity: Any, expected: str, separator: str = ",", count: int | None = None
) -> tuple[float, ...]:
    """The figures of an option that takes several as one word, all of one quantity.

    Args:
        option: its name.
        text: as it was given.
        quantity: of `beamdesign.quantities`.
        expected: what the option takes, in words.
        separator: between figures; those of a range, ":", ascend.
        count: how many; None for any number of them.

    Raises:
        InputError: where they are not as many figures, implausible or, in a range, descending.
    """
    from beamdesign.records import InputError

    try:
        values = tuple(float(part) for part in text.split(separator))
    except ValueError:
        values = ()
    if not values or count not in (None, len(values)):
        raise InputError(option, [(text, f"expected {expected}")])
    for value in values:
        refuse_implausible(option, {option: (value, quantity)})
    if separator == ":" and values[0] > values[-1]:
        raise InputError(option, [(text, f"empty range: {values[0]:g} is above {values[-1]:g}")])
    return values


def mass_range(text: str | None, default: tuple[float, float] | None, source: str | Path) -> tuple[float, float]:
    """The range of outer end masses in kg, from LO:HI or else from the prototype's payload.

    Raises:
        InputError: where neither gives a range of plausible masses.
    """
    from beamdesign.quantities import MassOrNone
    from beamdesign.records import InputError

    if text is None:
        if default is None:
            reason = "missing; give it there or as --outer-end-mass LO:HI"
            raise InputError(source, [("payload.outer_end_mass_kg", reason)])
        return default
    expected = "two masses in kg as LO:HI, such as 0:6.8"
    low, high = figures_of("--outer-end-mass", text, MassOrNone, expected, ":", 2)
    return low, high
