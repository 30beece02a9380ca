"""A named warning about data; and tolerances, with such a warning, for a prototype that states none.

Without tolerances every figure would be vouched for to the last digit.
"""

from dataclasses import dataclass

from beamdesign.parameters import PARAMETERS
from beamdesign.prototype import Prototype, Tolerance


@dataclass(frozen=True)
class Caution:
    """Something about a data set that whoever reads a verdict on it should know.

    Attributes:
        name: short, for programs: `clipped`, `no_content`, `controller`, ...
        record: name of the record, empty for the set as a whole.
        text: in words, with what to do.
        left_out: whether the record was left out.
        limits_confidence: whether a verdict must not be a confident one.
    """

    name: str
    record: str
    text: str
    left_out: bool = False
    limits_confidence: bool = False

    def __str__(self) -> str:
        out = "; the record was left out" if self.left_out else ""
        return f"{self.record}: {self.text}{out}" if self.record else f"{self.text}{out}"


TYPICAL = Tolerance(**{row.tolerance: row.typical for row in PARAMETERS.values()})
"""Standard deviations of figures taken from drawings and data sheets: what an engineer would grant before a look."""


def with_tolerances(prototype: Prototype) -> tuple[Prototype, tuple[Caution, ...]]:
    """The prototype as it is where it states a tolerance of any figure, else with typical ones and a word on it."""
    stated = prototype.tolerance.model_dump()
    if any(value for key, value in stated.items() if not key.endswith("_end_mass")):
        return prototype, ()
    taken = ", ".join(f"{key} {value:.2g}" for key, value in TYPICAL.model_dump().items() if value)
    text = (
        f"the prototype states no [tolerance] for any figure; typical ones are taken ({taken}): better state your own"
    )
    return prototype.but(tolerance=TYPICAL), (Caution("tolerances", "", text),)
