"""What is done for a set that no fit from rest explains: models are made to follow its records.

Two kinds of motion cannot be predicted from rest by any model, however right: that of a joint which hammers in its
play, and that of a loop which oscillates by itself. A hair's difference in a figure or at the beginning makes another
motion of them. Fits that follow the records (see `InjectedRecord`) are not led astray by that, and are believed only
where what they find is one of these two.

For a joint that hammers, all hypotheses are fitted again to records that the model follows, what hammering makes
unpredictable counting as noise for each of them alike. So their misfits compare with one another, and not with those
of the first search. No model can repeat from rest a record of a loop that, as it was taken, oscillates by itself.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.fitting.evidence import InjectedRecord, RecordEvidence, record_evidence, with_output_injection
from beamdesign.diagnosis.fitting.fit import Evidence, Fit, fit, linearised, misfit_at
from beamdesign.diagnosis.fitting.fit_cache import FitCache
from beamdesign.diagnosis.fitting.hypothesis import (
    NOTHING,
    WRONG,
    Hypothesis,
    Placement,
    known_effects,
    singles,
    together,
)
from beamdesign.diagnosis.fitting.replay import PLAY, Replay, law_of_play
from beamdesign.diagnosis.fitting.search import Search, best_of_each, search
from beamdesign.diagnosis.fitting.starts import fit_from_starts, starts
from beamdesign.diagnosis.judgement import judge
from beamdesign.diagnosis.passing import Look
from beamdesign.parameters import RIG_TOLERANCES
from beamdesign.plant.assembly import fits
from beamdesign.progress import Progress, part_of, silent
from beamdesign.prototype import Prototype
from beamdesign.records import InputError

_PLAYS_M = np.geomspace(4e-6, 1e-3, 13)
_STIFFNESSES_N_per_m = (5e7, 2e8)  # a start each: a fit goes from a soft contact to a hard one but slowly
_COUNTED = 0.5
_LOOK, _AGAIN = 5, 8  # iterations of the first fits, and of each round after
_SECANTS = (0.5, 0.25, 0.8, 0.35)  # a round each
_EXPLAINS = 0.5  # of the excess misfit: what play has to explain at a look to be worth the rest
_HOPELESS = 0.7  # the same: what a first look has to leave for there to be no second
_NEAR = 1.5  # times the noise: what needs no further round
_STRIDES = (0.6, 0.2)  # in prior standard deviations
_PAIRS, _NEEDS_MORE = 3, 1.3  # pairs fitted, where play alone leaves more than this times the noise
_HELPED = 0.97  # of the cost of play alone: what a start of a pair has to stay below
_STRAINED = 3.0  # tolerances by which play has to bend a figure for its being wrong as well to be tried


def backlash_impacts(
    data: Dataset, before: Search, progress: Progress = silent, beside: Fit | None = None
) -> Search | None:
    """Fit all hypotheses to records that the model follows.

    Args:
        data: what to explain.
        before: the first search.
        progress: told the share done and what is being fitted.
        beside: other causes that play is looked for beside, as the first search has fitted them.

    Returns:
        None where play explains less than half of what the tolerances, or those other causes, leave.
    """
    evidence = [with_output_injection(piece) for piece in record_evidence(data)]
    rig = data.prototype
    progress(0.0, "play, looked for")
    base = beside or before.null
    null = fit(base.hypothesis, base.hypothesis.placement(rig), evidence, base.z)
    if null.reason:
        return None
    loosened = loose_joint(rig)
    sought = loosened | base.hypothesis
    placement = sought.placement(rig)
    if (z := _looked_for(evidence, sought, rig, null)) is None:
        return None
    progress(0.3, "play")
    z = _brought_down(evidence, sought, placement, z)
    if (seen := _blurred(evidence, placement, z)) is None:
        return None
    expected = sum(e.expected for e in seen)
    loose = fit(sought, placement, seen, z, _LOOK)
    progress(0.5, "single causes again")
    null = fit(NOTHING, NOTHING.placement(rig), seen, before.null.z)
    if loose.reason or null.reason:
        return None
    others = [h for h in singles(rig) if h.causes != loosened.causes]
    found_all = [loose, *(fit_from_starts(h, rig, seen, null.values, most=1) for h in others)]
    if beside is not None:
        for part in map(sought.without, sought.causes):  # from where all have been found
            placement = part.placement(rig)
            z = np.array([u.z(loose.values[u.name]) for u in placement.unknowns])
            found_all.append(fit(part, placement, seen, z, _LOOK))
    elif loose.misfit > _NEEDS_MORE * expected:
        progress(0.7, "play with another cause")
        found_all += _pairs(others, rig, seen, loose)
    progress(1.0, "done")
    # Without a floor: the error of a motion that cannot be predicted says nothing of how large a cause is.
    return Search(null, tuple(best_of_each(found_all)), expected, conditions=tuple(e.condition for e in evidence))


def loose_joint(rig: Prototype) -> Hypothesis:
    """Play by the law that goes with a rig's actuator: in the nut of a screw, else where the rod meets the beam."""
    return together(PLAY + "_nut" if fits(PLAY + "_nut", rig.rig) else PLAY)


def _brought_down(evidence: Sequence[Evidence], sought: Hypothesis, placement: Placement, z: np.ndarray) -> np.ndarray:
    """Unknowns of less cost, in rounds: a fit, then strides; what is unpredictable is measured anew for each.

    Secants of different lengths see different ground, so that one gets out of where another is stuck.
    """
    for secant in _SECANTS:
        if (seen := _blurred(evidence, placement, z, secant)) is None:
            break
        found = fit(sought, placement, seen, z, _AGAIN)
        if found.reason:
            break
        z, cost = _strides(seen, placement, found.z)
        if cost < _NEAR * sum(e.expected for e in seen):
            break
    return z


def refit_backlash_impacts(data: Dataset, best: Fit) -> Fit:
    """A hypothesis with play, fitted again to fewer data from where it was; that very fit where no other is better.

    Args:
        data: what is left of those that the fit was made to.
        best: the fit.
    """
    placement = best.hypothesis.placement(data.prototype)
    seen = _blurred(map(with_output_injection, record_evidence(data)), placement, best.z)
    again = fit(best.hypothesis, placement, seen, best.z, _LOOK) if seen is not None else best
    return best if again.reason else again


def _looked_for(evidence: Sequence[Evidence], sought: Hypothesis, rig: Prototype, null: Fit) -> np.ndarray | None:
    """Unknowns at which play explains most, after a short fit from each of a few contacts; None where not enough."""
    placement, plain = sought.placement(rig), null.hypothesis.placement(rig)
    best: tuple[float, np.ndarray] | None = None
    contacts = _STIFFNESSES_N_per_m if PLAY in sought.names else _STIFFNESSES_N_per_m[:1]  # a screw's is known
    for stiffness in contacts:
        trials = [_at(placement, play, stiffness, null) for play in _PLAYS_M]
        z = min(trials, key=lambda trial: misfit_at(evidence, placement, trial))
        seen = _blurred(evidence, placement, z)
        found = fit(sought, placement, seen, z, _LOOK) if seen is not None else None
        again = _blurred(evidence, placement, found.z) if found is not None and not found.reason else None
        if found is None or again is None:
            continue
        expected = sum(e.expected for e in again)
        gap = misfit_at(again, plain, null.z) - expected
        left = (misfit_at(again, placement, found.z) - expected) / max(gap, 1e-9)
        if best is None or left < best[0]:
            best = left, found.z
        if left > _HOPELESS:
            break
    return best[1] if best is not None and best[0] < 1 - _EXPLAINS else None


def _at(placement: Placement, play: float, stiffness: float, null: Fit) -> np.ndarray:
    """Figures as believed: those that a fit without play has bent stand for what it lacked. Effects as it has them."""
    given = {"play_m": play, "stiffness_N_per_m": stiffness, "counted_share": _COUNTED}
    values = {u.name: u.value(z) for u, z in zip(null.unknowns, null.z, strict=True) if u.kind == "effect"}
    values |= {f"{law_of_play(placement.assembly.kinds.effects)}.{name}": value for name, value in given.items()}
    return np.array([u.z(values[u.name]) if u.name in values else 0.0 for u in placement.unknowns])


def _blurred(
    evidence: Iterable[Evidence], placement: Placement, z: np.ndarray, secant: float = _SECANTS[0]
) -> list[Evidence] | None:
    found = [replace(e, secant=secant).blurred(placement, z) if isinstance(e, InjectedRecord) else e for e in evidence]
    return None if any(e is None for e in found) else [e for e in found if e is not None]


def _strides(evidence: Sequence[Evidence], placement: Placement, z: np.ndarray) -> tuple[np.ndarray, float]:
    """Along one unknown after another as far as it helps; the ground is too rough for a fit alone."""
    cost = misfit_at(evidence, placement, z)
    for stride in _STRIDES:
        for k, unknown in enumerate(placement.unknowns):
            for sign in (1, -1):
                while True:
                    trial = z.copy()
                    trial[k] = np.clip(z[k] + sign * stride, *unknown.bounds)
                    value = misfit_at(evidence, placement, trial) if trial[k] != z[k] else np.inf
                    if value >= cost:
                        break
                    z, cost = trial, value
    return z, cost


def _pairs(others: Sequence[Hypothesis], rig: Prototype, evidence: Sequence[Evidence], loose: Fit) -> list[Fit]:
    """Play with each other effect that helps it most at a look, and with a figure that it had to strain."""
    strained = {WRONG + RIG_TOLERANCES[name] for name, moved in loose.moved.items() if abs(moved) > _STRAINED}
    worst = sorted(range(len(evidence)), key=lambda k: -loose.shares[k].c / max(evidence[k].expected, 1e-9))
    hardest = [evidence[k] for k in worst[: max(1, len(worst) // 3)]]
    loosened = loose.hypothesis
    enough = _HELPED * misfit_at(hardest, loosened.placement(rig), loose.z)
    looks = []
    for other in others:
        if not other.effects and other.names[0] not in strained:
            continue
        placement = (loosened | other).placement(rig)
        if not (begun := starts(placement, loose.values, hardest, (), 1)):
            continue
        # A figure set free begins where it is, and has its worth in what it no longer costs.
        cost = misfit_at(hardest, placement, begun[0], enough) if other.effects else 0.0
        if cost < enough:
            looks.append((cost, other, begun[0]))
    looks.sort(key=lambda look: look[0])
    tried = ((loosened | other, z) for _, other, z in looks[:_PAIRS])
    return [fit(both, both.placement(rig), evidence, z, _LOOK) for both, z in tried]


_AT, _LASTS_S = 0.05, 5e-3  # of the record; long enough for whatever a loop of this kind may oscillate at
_ENDS = 3
_NARROW, _MOST = 0.06, 0.6  # of the frequency, of the power


def grows(piece: RecordEvidence, placement: Placement, z: np.ndarray) -> bool:
    """Whether a motion that a small pulse has set off is larger in the last third of the record than in the first.

    The pulse, as large as the sensor's noise, is added to the command. The motion it makes is the difference of two
    simulations with all that the record drives its rig with, so that laws count as they are where the rig works. A loop
    that diverges grows.

    Args:
        piece: the record.
        placement: the unknowns of a hypothesis.
        z: (K,) their values.
    """
    record, rig = piece.record, piece.job.prototype
    count, first = len(record.times), round(_AT * len(record.times))
    inputs = record.inputs.copy()
    last = first + max(2, round(_LASTS_S / record.step))
    inputs[first:last, 1] += rig.sensor.gain_V_per_m * piece.weight.noise_std[piece.column]
    plain = piece.predicted(placement, z)
    moved = replace(piece, job=Replay(replace(record, inputs=inputs), rig)).predicted(placement, z)
    if plain is None or moved is None:
        return True
    motion = (moved - plain)[:, piece.column]
    return bool(np.std(motion[-count // _ENDS :]) > np.std(motion[: count // _ENDS]))


def rings(piece: RecordEvidence, placement: Placement, z: np.ndarray) -> bool:
    """Whether most of what a model leaves of the displacement is of one frequency.

    So it is where the rig oscillates and the model does not; mains hum looks alike.

    Args:
        piece: the record.
        placement: the unknowns of a hypothesis.
        z: (K,) their values.
    """
    if (residual := piece.residual(placement, z)) is None:
        return True
    power = np.abs(piece.displacement(residual)) ** 2
    frequency = piece.weight.frequencies_Hz
    near = np.abs(frequency / frequency[np.argmax(power)] - 1) < _NARROW
    return bool(power[near].sum() > _MOST * power.sum())


_REPEATED = 1e3  # units of misfit by which a tolerance moves a sample or a line: with impacts it is without bound
_ANEW = "By the {} that the prototype states no model repeats these records from rest: it is looked for anew."
_IMPACTS = (
    "a joint hammers in its play, so that the motion of small records cannot be repeated: fits follow the records, and "
    "prediction errors from rest stay larger than the model is wrong"
)
_OSCILLATES = (
    "the rig's loop oscillates by itself, so that its motion cannot be predicted from rest: fits follow the records, "
    "and errors are those of models that do"
)
_WORTH = 0.7  # of the excess misfit: what the best single cause has to stay below for pairs to be tried
_HELPS = 0.9  # the same: what another effect has to stay below for play to be looked for beside it
_MOST_UNKNOWN = 0.5


def without_impacts(data: Dataset) -> tuple[Dataset, tuple[str, ...]]:
    """The data set, its prototype without a play that it states but by which no record can be repeated from rest.

    Returns:
        the data set, and a word where the play has been left out: it is looked for anew.
    """
    rig = data.prototype
    if not (play := law_of_play(known_effects(rig))):
        return data, ()
    placement = NOTHING.placement(rig)
    rows = linearised(record_evidence(data), placement, np.zeros(len(placement.unknowns)))
    if rows is not None and max(float(np.abs(slopes).max()) for _, slopes in rows) < _REPEATED:
        return data, ()
    left = {name: table for name, table in rig.effects.items() if name != play}
    return replace(data, prototype=rig.but(effects=left)), (_ANEW.format(play),)


def second_look(look: Look, workers: int = 1, progress: Progress = silent) -> Look | None:
    """Look for play in which a joint hammers, then for causes that make the loop oscillate by itself.

    Args:
        look: the first search.
        workers: processes.
        progress: told the share done and what is being fitted.

    Returns:
        a search in which models follow the records; None where neither is found.
    """
    data, before = look.data, look.search
    if (found := _backlash_impacts(data, before, part_of(progress, 0.0, 1 / 3))) is not None:
        return found.after(look)
    best = min((before.null, *before.fits), key=lambda fit: fit.misfit)
    placement = best.hypothesis.placement(data.prototype)
    if not any(rings(piece, placement, best.z) for piece in record_evidence(data)):
        return None
    synchronised = part_of(lambda share, words: progress(share, f"{words}, in step"), 1 / 3, 1.0)
    found = _oscillating(data, workers, synchronised, look.kept)
    return found and found.after(look)


def _backlash_impacts(data: Dataset, before: Search, progress: Progress) -> Look | None:
    """Play alone or with what it needs, then beside the effect, and the two, that explain most without it."""
    others = [f for f in before.fits if not f.reason and f.hypothesis.effects and PLAY not in f.hypothesis.causes]
    first = {len(f.hypothesis.causes): f for f in reversed(others)}
    for beside in (None, *(first[count] for count in (1, 2) if count in first)):
        if beside is not None and before.excess(beside) > _HELPS:
            break
        if (found := backlash_impacts(data, before, progress, beside)) is None:
            continue
        judged = judge(found)
        if judged.unknown <= _MOST_UNKNOWN and PLAY in judged.best.hypothesis.causes:
            return Look(data, found, judged, (_IMPACTS,), follows="hammers")
    return None


def _oscillating(data: Dataset, workers: int, progress: Progress, kept: FitCache | None) -> Look | None:
    try:
        found = search(data, workers, progress, kept, synchronised=True, worth=_WORTH)
    except InputError:  # not even in step is the believed loop stable
        return None
    judged = judge(found)
    if judged.unknown > _MOST_UNKNOWN or not judged.best.hypothesis.causes:
        return None
    placement = judged.best.hypothesis.placement(data.prototype)
    growing = [piece.name for piece in record_evidence(data) if grows(piece, placement, judged.best.z)]
    if not growing:
        return None
    return Look(data, found, judged, (f"{', '.join(growing)}: {_OSCILLATES}",), follows="oscillates")
