"""Tolerances for a prototype that states none: without them every figure would be vouched for to the last digit."""

from beamdesign.gap.examination.caution import Caution
from beamdesign.parameters import PARAMETERS
from beamdesign.prototype import Prototype, Tolerance

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
