"""Back to the design: controller and inner end mass tuned and proved anew on the diagnosed prototype."""

from collections.abc import Callable
from dataclasses import dataclass

from beamdesign.design.tuning import tune_alike
from beamdesign.proof.certificate import Certificate
from beamdesign.prototype import Prototype
from beamdesign.records import InputError
from beamdesign.study.design_run import certified


@dataclass(frozen=True)
class Redesign:
    """A new controller for the diagnosed rig.

    Attributes:
        outer_end_mass_kg: range over which everything is proved.
        prototype: diagnosed one with the new controller, inner end mass and guarantee; None where none was found.
        certificate: its proof.
        reason: why there is none, in words.
    """

    outer_end_mass_kg: tuple[float, float]
    prototype: Prototype | None = None
    certificate: Certificate | None = None
    reason: str = ""


def redesign(
    diagnosed: Prototype, outer_end_mass_kg: tuple[float, float], progress: Callable[[float, str], None] | None = None
) -> Redesign:
    """Tune a controller of the same kind for the largest guaranteed bandwidth on a diagnosed prototype, and prove it.

    Args:
        diagnosed: with its effects, and the controller that it had.
        outer_end_mass_kg: range of payload.
        progress: told the share done and what is being done.
    """
    try:
        found = tune_alike(diagnosed, outer_end_mass_kg, progress)
        if found.best is None:
            return Redesign(outer_end_mass_kg, reason=found.reason)
        certificate, prototype = certified(found.prototype, found.best, outer_end_mass_kg)
    except InputError as error:  # an effect for which no linear loop stands
        return Redesign(outer_end_mass_kg, reason=str(error).replace("\n", "; "))
    return Redesign(outer_end_mass_kg, prototype, certificate)
