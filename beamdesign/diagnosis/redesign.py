"""A gap in the designer's terms, and back to the design.

Critical gain, bandwidth and proved payload range are told as believed and as diagnosed; and every law and the inner end
mass are tuned and proved anew on the diagnosed prototype.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from beamdesign.controllers import Controller
from beamdesign.diagnosis.data.dataset import Dataset, FrequencyResponse, MeasuredGain, TimeRecord
from beamdesign.diagnosis.data.dataset_index import OFF
from beamdesign.loop import critical_gain
from beamdesign.progress import Progress, silent
from beamdesign.proofs.certificate import Certificate
from beamdesign.proofs.certifying import certify
from beamdesign.proofs.scope import holds_for
from beamdesign.prototype import Prototype
from beamdesign.records import InputError
from beamdesign.structure.arm import off_axis
from beamdesign.synthesis.design_run import certified_laws
from beamdesign.synthesis.stiffness_search import stiffness
from beamdesign.synthesis.tuning import tune_alike
from beamdesign.time_limit import within

MOST_LOOPS = 4
_OFF_AXIS = (
    "its payload stands off the axis: `beamdesign arm` proves the loops of both planes, for the law that is stated"
)


@dataclass(frozen=True)
class CriticalPoint:
    """Where a loop oscillates at one outer end mass; exact for the linear model.

    Attributes:
        outer_end_mass_kg: at this mass.
        gain_A_per_V: the least gain that makes it oscillate.
        frequency_Hz: of the oscillation.
    """

    outer_end_mass_kg: float
    gain_A_per_V: float
    frequency_Hz: float


@dataclass(frozen=True)
class Terms:
    """What one prototype promises with one controller; proved in exact arithmetic, of its linear loops.

    Attributes:
        stable_ranges_kg: outer end masses, within the range asked for.
        stable: whether that is the whole range.
        bandwidth_Hz: guaranteed over the whole range; None where it is not stable.
        peak_sensitivity: likewise.
        critical: at both ends of the range; fewer where a loop oscillates at no gain.
        scope: what of each effect is covered, in words.
        holds_for: of which rigs and which motion all of it is, in words; empty where there are no figures.
        reason: why there are no figures, in words; empty otherwise.
        open_between: why the loop is not proved stable between the ends of what effects freeze; empty where it is.
    """

    stable_ranges_kg: tuple[tuple[float, float], ...] = ()
    stable: bool = False
    bandwidth_Hz: float | None = None
    peak_sensitivity: float | None = None
    critical: tuple[CriticalPoint, ...] = ()
    scope: tuple[str, ...] = ()
    reason: str = ""
    holds_for: str = ""
    open_between: str = ""


@dataclass(frozen=True)
class LoopTerms:
    """One law and inner end mass, by the believed and by the diagnosed prototype.

    Attributes:
        controller: of the loop, one law.
        inner_end_mass_kg: kg.
        outer_end_mass_kg: range over which everything is proved.
        nominal: before.
        diagnosed: after.
        new: whether it was tuned on what was diagnosed.
    """

    controller: Controller
    inner_end_mass_kg: float
    outer_end_mass_kg: tuple[float, float]
    nominal: Terms
    diagnosed: Terms
    new: bool = False


def designer_terms(data: Dataset, diagnosed: Prototype, new: Sequence[Prototype] = ()) -> tuple[LoopTerms, ...]:
    """Compare the loops of a data set, those of its prototype first, and then new ones.

    Args:
        data: with the prototype that was believed.
        diagnosed: that prototype with the fitted figures and the causes found.
        new: tuned on that, each with one law and its guarantee.
    """
    own = 0 if data.prototype.controller is None else len(data.prototype.controller.laws)

    def compared(law: Controller, inner: float, masses: tuple[float, float], tuned: bool = False) -> LoopTerms:
        nominal, found = (terms(rig.with_law(law, masses, inner)) for rig in (data.prototype, diagnosed))
        return LoopTerms(law, inner, masses, nominal, found, tuned)

    found = [compared(*each) for each in loops_of(data)[: max(MOST_LOOPS, own)]]
    for one in new:
        if one.controller is not None and one.guarantee is not None:
            masses = one.guarantee.outer_end_mass_kg
            found.append(compared(one.controller, one.payload.inner_end_mass_kg, masses, tuned=True))
    return tuple(found)


def payload_range(data: Dataset) -> tuple[float, float]:
    """Of the prototype; else from none to the largest outer end mass of the data, or to the beam's own mass."""
    if (stated := data.prototype.outer_end_mass_kg) is not None:
        return stated
    taken: list[TimeRecord | FrequencyResponse | MeasuredGain] = [*data.records, *data.responses, *data.gains]
    largest = max((each.outer_end_mass for each in taken), default=0.0)
    return 0.0, largest or (data.prototype.outer_beam.effective_mass_kg or 1.0)


def loops_of(data: Dataset) -> list[tuple[Controller, float, tuple[float, float]]]:
    """Laws with their inner end masses and payloads: the prototype's own, then those of the records, most used first.

    What else was recorded is for all payloads.
    """
    masses, uses = payload_range(data), Counter[tuple[Controller, float]]()
    own = {s.prototype.controller: s.outer_end_mass_kg for s in data.prototype.stages(masses)}
    for law in own:
        if law is not None:
            uses[law, data.prototype.payload.inner_end_mass_kg] = 10**6
    recorded: list[TimeRecord | FrequencyResponse] = [*data.records, *data.responses]
    uses.update((one.controller, one.inner_end_mass) for one in recorded if one.controller != OFF)
    if not uses:
        uses.update(dict.fromkeys(((gain.controller, gain.inner_end_mass) for gain in data.gains), 1))
    return [(law, inner, own.get(law, masses)) for law, inner in sorted(uses, key=lambda key: -uses[key])]


def terms(prototype: Prototype) -> Terms:
    """Prove what a prototype with controller and payload range promises."""
    assert prototype.payload.outer_end_mass_kg is not None
    masses = prototype.payload.outer_end_mass_kg
    if off_axis(prototype):
        return Terms(reason=_OFF_AXIS)
    try:
        certificate = certify(prototype, *masses)
    except (InputError, ValueError, ArithmeticError) as error:
        return Terms(reason=str(error).replace("\n", "; "))
    critical = []
    for mass in dict.fromkeys(masses):
        try:
            at = critical_gain(prototype, mass, from_own=True)
        except (InputError, ValueError):
            continue
        critical.append(CriticalPoint(mass, at.gain_A_per_V, at.frequency_Hz))
    kept, ranges = certificate.guaranteed, tuple(certificate.stable_ranges_kg)
    bandwidth_Hz, peak = (kept.bandwidth_Hz, kept.peak_sensitivity) if kept else (None, None)
    given = ranges, certificate.stable, bandwidth_Hz, peak, tuple(critical), certificate.scope
    return Terms(*given, holds_for=holds_for(prototype), open_between=certificate.open_between)


@dataclass(frozen=True)
class Redesign:
    """A new controller for the diagnosed rig.

    Attributes:
        outer_end_mass_kg: range over which everything is proved.
        prototype: diagnosed one with the new controller, inner end mass and guarantee; None where none was found.
        proofs: of each of its laws, with the prototype that has this law alone and its guarantee.
        reason: why there is none, in words.
        left_out: what was not tried for want of time, in words.
    """

    outer_end_mass_kg: tuple[float, float]
    prototype: Prototype | None = None
    proofs: tuple[tuple[Certificate, Prototype], ...] = ()
    reason: str = ""
    left_out: tuple[str, ...] = ()


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
    with within(None) as limit:
        found = _redesigned(diagnosed, outer_end_mass_kg, progress)
    return replace(found, left_out=tuple(limit.left_out))


def _redesigned(diagnosed: Prototype, outer_end_mass_kg: tuple[float, float], progress: Progress | None) -> Redesign:
    if off_axis(diagnosed):
        return Redesign(outer_end_mass_kg, reason=_OFF_AXIS)
    try:
        if (asked := diagnosed.compliance) is not None:  # sought on the diagnosed figures alone
            given = diagnosed, asked.end_stiffness_N_per_m, outer_end_mass_kg
            soft = stiffness(*given, contact="none", rigs=0, progress=progress or silent)  # stable in the air at least
            if soft.prototype is None or soft.certificate is None:
                return Redesign(outer_end_mass_kg, reason=soft.reason)
            return Redesign(outer_end_mass_kg, soft.prototype, ((soft.certificate, soft.prototype),))
        found = tune_alike(diagnosed, outer_end_mass_kg, progress)
    except InputError as error:  # an effect for which no linear loop stands, or so many stages do not fit
        return Redesign(outer_end_mass_kg, reason=str(error).replace("\n", "; "))
    if found.reason:
        return Redesign(outer_end_mass_kg, reason=found.reason)
    if any(one.between and one.between.stable is False for one in found.each):
        return Redesign(outer_end_mass_kg, reason=found.open_between)
    if (old := diagnosed.schedule) is not None and (new := found.prototype.schedule) is not None:
        kept = old.but(stage=new.stage, dwell_s=new.dwell_s)
        found = replace(found, prototype=found.prototype.but(controller=kept))
    return Redesign(outer_end_mass_kg, *certified_laws(found))
