"""Back to the design: every law and the inner end mass tuned and proved anew on the diagnosed prototype."""

from dataclasses import dataclass, replace

from beamdesign.progress import Progress
from beamdesign.proofs.certificate import Certificate
from beamdesign.proofs.contact import EVERY_WALL
from beamdesign.prototype import Prototype
from beamdesign.records import InputError
from beamdesign.synthesis.design_run import certified_laws
from beamdesign.synthesis.stiffness_run import carried_out
from beamdesign.synthesis.stiffness_search import design
from beamdesign.synthesis.tuning import tune_alike


@dataclass(frozen=True)
class Redesign:
    """A new controller for the diagnosed rig.

    Attributes:
        outer_end_mass_kg: range over which everything is proved.
        prototype: diagnosed one with the new controller, inner end mass and guarantee; None where none was found.
        proofs: of each of its laws, with the prototype that has this law alone and its guarantee.
        reason: why there is none, in words.
    """

    outer_end_mass_kg: tuple[float, float]
    prototype: Prototype | None = None
    proofs: tuple[tuple[Certificate, Prototype], ...] = ()
    reason: str = ""


def redesign(
    diagnosed: Prototype, outer_end_mass_kg: tuple[float, float], progress: Progress | None = None
) -> Redesign:
    """Tune a controller of the same kind for the largest guaranteed bandwidth on a diagnosed prototype, and prove it.

    One that gives the end a stiffness is sought for the widest band of that stiffness instead. Of several laws each is
    tuned for its own payloads and stable for all; changes between them are for `certify-switching` to prove.

    Args:
        diagnosed: with its effects, and the controller that it had.
        outer_end_mass_kg: range of payload.
        progress: told the share done and what is being done.
    """
    try:
        if diagnosed.compliance is not None:
            return _of_stiffness(diagnosed, diagnosed.compliance.end_stiffness_N_per_m, outer_end_mass_kg, progress)
        found = tune_alike(diagnosed, outer_end_mass_kg, progress)
    except InputError as error:  # an effect for which no linear loop stands, or so many stages do not fit
        return Redesign(outer_end_mass_kg, reason=str(error).replace("\n", "; "))
    if found.reason:
        return Redesign(outer_end_mass_kg, reason=found.reason)
    if (old := diagnosed.schedule) is not None and (new := found.prototype.schedule) is not None:
        kept = old.but(stage=new.stage, dwell_s=new.dwell_s)
        found = replace(found, prototype=found.prototype.but(controller=kept))
    return Redesign(outer_end_mass_kg, *certified_laws(found))


def _of_stiffness(
    diagnosed: Prototype, end_stiffness: float, masses_kg: tuple[float, float], progress: Progress | None
) -> Redesign:
    """The same on the diagnosed figures alone, stable in the air at least."""
    found = design(diagnosed, end_stiffness, masses_kg, EVERY_WALL, "stable", progress=progress)
    if found.best is None:
        return Redesign(masses_kg, reason=found.reason)
    done = carried_out(diagnosed, found.best, masses_kg, EVERY_WALL)
    return Redesign(masses_kg, done.prototype, ((done.certificate, done.prototype),))
