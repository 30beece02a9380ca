"""All hypotheses about a gap, fitted: nulls first, every single cause, then pairs, then three causes at once."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import product

import numpy as np

from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.fitting.evidence import unpredicted
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.fit_cache import FitCache, Task
from beamdesign.diagnosis.fitting.fitters import RESONANT, Fitters
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, Hypothesis, cause, pairs, singles
from beamdesign.plant.assembly import fits
from beamdesign.plant.effects import causes, library
from beamdesign.progress import Progress, silent
from beamdesign.records import InputError
from beamdesign.time_limit import share

_BEST_SINGLES = ((0.03, 1), (0.15, 2), (np.inf, 4))
"""How many singles to pair, by the share of the excess misfit that the best of them leaves."""
_BEST_OF_FEW = 5  # the same of figures alone, or of what explains little
_BEST_PAIRS, _LEADING = 6, 3  # pairs fitted in full: the best at a look, and those among the best singles
_SMALL = 1.3  # times the misfit of noise alone: what tolerances leave below it is not worth a pair
_LARGE = 4.0  # times: what is worth every pair
_EXPLAINED = 0.5  # of the excess misfit: where no single cause reaches it, every pair of effects is tried
_TAKEN_APART = 2  # of the best pairs
_NEARLY = 1.3  # times the cost of a single cause: what explains nearly as much alone
_ABOUT = 2.0  # times the cost of the best pair: those beside which a third cause is tried
_PARTLY, _MUCH_LESS = 0.5, 0.4  # of the excess misfit: of pairs, for a third cause to be tried; of what the pair leaves
_BEST_TRIPLES = 3  # fitted in full
_HALF = 0.5  # of the evidence, that which the best single cause explains least, tells which pairs are worth fitting
_QUARTER = 0.25  # of the records, those which tolerances explain least, tell which single causes are
_HOPELESS = 0.5  # of the excess misfit of the part looked at: what leaves more of it explains no gap
_SEEKING, _LOOKING = 0.7, 0.3  # of the time that is left, for all fits and for a look at single causes before them
_LOOKING_AGAIN, _LOOKING_AT_PAIRS = 0.3, 0.6  # the same, at those of little hope, and at pairs before the best of them
_CLOSED, _COMPARING = 0.15, 0.6  # of the excess misfit that the best leaves; of the time left, for what was left out
_DONE, _QUIET = 0.004, 1.15  # of the excess misfit, times the noise: a cause that leaves no more needs no second one


@dataclass(frozen=True)
class Search:
    """All fits.

    Attributes:
        null: tolerances only.
        fits: all others, best first.
        expected: misfit that noise alone would leave.
        floor: `Fit.error` that noise alone would leave.
        conditions: of each piece of evidence, in the order of `Fit.shares`; none where they do not matter.
    """

    null: Fit
    fits: tuple[Fit, ...]
    expected: float
    floor: float = 0.0
    conditions: tuple[object, ...] = field(default=(), repr=False)

    def best_of(self, causes: tuple[str, ...]) -> Fit:
        """The best fit of some causes, whatever laws they follow.

        Raises:
            StopIteration: where there is none.
        """
        return next(fit for fit in (self.null, *self.fits) if fit.hypothesis.causes == causes)

    @property
    def listed(self) -> "Search":
        """The same without laws that were learnt, whose unknowns go by scales of their own."""
        known = causes()
        return replace(self, fits=tuple(f for f in self.fits if all(name in known for name in f.hypothesis.effects)))

    @property
    def spread(self) -> float:
        """How much larger the least misfit is than that of noise; 1 where it is no larger."""
        return max(1.0, min(f.misfit for f in (self.null, *self.fits)) / self.expected)

    @property
    def silent(self) -> tuple[str, ...]:
        """Effects that leave no trace in what was measured, whatever their size."""
        alone = (f for f in self.fits if f.hypothesis.effects == f.hypothesis.names and len(f.hypothesis.names) == 1)
        own = ((f, [u.kind == "effect" for u in f.unknowns]) for f in alone if not f.reason)
        return tuple(sorted(str(f.hypothesis) for f, at in own if not any(np.any(s.a[:, at]) for s in f.shares)))

    @property
    def explained(self) -> bool:
        """Whether the best fit beyond tolerances leaves no more than noise does, and has strained no figure for it."""
        best = self.fits[0] if self.fits else self.null
        done = self.excess(best) < _DONE and best.misfit < _QUIET * self.expected
        return bool(self.fits) and done and not best.strained

    def excess(self, found: Fit) -> float:
        """Misfit that a fit leaves beyond noise, as a share of what tolerances alone leave."""
        return (found.misfit - self.expected) / max(self.null.misfit - self.expected, 1e-12)


def search(
    data: Dataset,
    workers: int = 1,
    progress: Progress = silent,
    kept: FitCache | None = None,
    synchronised: bool = False,
    worth: float = np.inf,
    null: Fit | None = None,
) -> Search:
    """Fit all hypotheses to a data set.

    Args:
        data: what to explain.
        workers: processes.
        progress: told the share done and what is being fitted.
        kept: fits of an earlier run, where those of this one are kept as well.
        synchronised: whether models follow the records, see `InjectedRecord`, instead of predicting them from rest.
        worth: share of the excess misfit that the best single cause has to stay below for pairs to be tried.
        null: tolerances alone, where they are fitted already.

    Raises:
        TimeUp: where steps are to be broken off, and not even tolerances alone are fitted in time.
        InputError: naming what the believed prototype does not predict: records and responses with which its own loop
            is unstable, critical gains where it oscillates at none.
    """
    with Fitters(data, workers, kept, synchronised) as fitters:
        progress(0.0, "tolerances")
        null = null or fitters.each(Task(NOTHING, {}))[0]
        if null.reason:
            raise InputError(data.folder, unpredicted(data, fitters.evidence))
        with share(_SEEKING, within_steps=True):
            found = _searched(fitters, null, progress, worth)
        if fitters.late and found.fits and found.excess(found.fits[0]) < _CLOSED:  # so that no law has to be learnt
            with share(_COMPARING, within_steps=True):
                found = _made_up_for(fitters, found)
        progress(1.0, "done")
        return found


def _searched(fitters: Fitters, null: Fit, progress: Progress, worth: float) -> Search:
    """The search beyond tolerances alone; what is not fitted in time is left out."""
    alone, pieces, few = list(singles(fitters.data.prototype)), fitters.evidence, not fitters.data.records
    expected, floor = sum(e.expected for e in pieces), sum(e.floor for e in pieces)
    state = Search(null, (), expected, floor, tuple(e.condition for e in pieces))
    gap, large = (null.misfit > many * expected for many in (_SMALL, _LARGE))
    looks: dict[Hypothesis, tuple[float, Fit]] = {}
    if few:  # further laws of an effect are tried where its usual one explains most
        alone = [h for h in alone if h.names == h.causes]
    elif gap:  # what explains most of a part is compared first
        looks = _looked_at(fitters, null, alone, progress)
        alone.sort(key=lambda h: looks[h][0] if h in looks else np.inf)
    # What a wrong figure gains tells beside a small gap which effects are slight.
    hopeless = [h for h in alone if (large or h.effects) and h in looks and looks[h][0] > _HOPELESS]

    def counted(fitted: int) -> None:
        progress(0.05 + 0.5 * min(1.0, (len(state.fits) + fitted) / len(alone)), "single causes")

    found = fitters((Task(h, null.values) for h in alone if h not in hopeless), counted)
    state = replace(state, fits=tuple(_sorted(found)))
    if not few and gap and not state.explained:
        found += fitters(_as_by_the_usual_law([f for f in found if state.excess(f) < _HOPELESS], found, null))
        state = replace(state, fits=tuple(best_of_each(found)))
    if hopeless and not state.explained:  # they may still be parts of pairs
        # A narrow resonance that a look at one record has missed stands out of all of them.
        again = (Task(h, null.values) for h in hopeless if RESONANT & {*h.effects})
        looked = (Task(h, looks[h][1].values, null.values, quick=True) for h in hopeless)
        with share(_LOOKING_AGAIN, within_steps=True):
            quick = best_of_each(fitters([*again, *looked], counted))
        best = fitters(Task(f.hypothesis, null.values, f.values) for f in _sorted(quick)[:_BEST_OF_FEW])
        state = replace(state, fits=tuple(best_of_each([*found, *quick, *best])))
    if few:
        if fitters.data.responses:  # critical gains tell no two laws of one effect apart
            found += fitters(_other_laws(state.fits[:_BEST_OF_FEW], {}, fitters.data.prototype.rig))
            state = replace(state, fits=tuple(best_of_each(found)))
        return replace(state, fits=tuple(_with_pairs(fitters, state, progress)))
    if state.fits and gap and not state.explained and state.excess(state.fits[0]) < worth:
        state = replace(state, fits=tuple(_two_at_once(fitters, state, progress)))
        state = replace(state, fits=tuple(_three_at_once(fitters, state, progress)))
    return state


def _made_up_for(fitters: Fitters, state: Search) -> Search:
    """The search with what there was no time for before; in full where a look at a part of the evidence is worth it."""
    late, fitters.late = fitters.late, []
    single = next(f for f in state.fits if len(f.hypothesis.causes) == 1)
    on = {task.hypothesis: task.on for task in late if task.on}
    made = _sorted(fitters(late))
    worth = [f for f in made if f.hypothesis in on and _left(f, single, on[f.hypothesis], fitters) < _HOPELESS]
    full = fitters(Task(f.hypothesis, single.values, f.values) for f in worth[:_BEST_PAIRS])
    whole = [f for f in made if f.hypothesis not in on]
    return replace(state, fits=tuple(best_of_each([*state.fits, *whole, *full])))


def _looked_at(
    fitters: Fitters, null: Fit, alone: Sequence[Hypothesis], progress: Progress
) -> dict[Hypothesis, tuple[float, Fit]]:
    """What single causes leave of the quarter of the records that tolerances explain least, when fitted to it alone.

    Fitted to everything they leave no less of this quarter, but for what strain of the figures buys.

    Returns:
        share of the excess misfit, and the fit; nothing of causes that were not looked at in time.
    """
    part = hardest(null, _QUARTER, len(fitters.data.records))
    progress(0.02, "a look at single causes")
    with share(_LOOKING, within_steps=True):
        looks = fitters.finished([Task(h, null.values, on=part) for h in alone])
    return {look.hypothesis: (_left(look, null, part, fitters), look) for look in looks}


def _left(look: Fit, of: Fit, part: Sequence[int], fitters: Fitters) -> float:
    """Excess misfit of a part of the evidence that a look at it leaves, as a share of what a whole fit leaves there."""
    noise = sum(fitters.evidence[k].expected for k in part)
    return (look.misfit - noise) / max(sum(of.shares[k].c for k in part) - noise, 1e-12)


def _two_at_once(fitters: Fitters, state: Search, progress: Progress) -> list[Fit]:
    """Single causes and pairs of them: those worth it at a look, the best of these in full."""
    values = {f.hypothesis: f.values for f in reversed(state.fits) if not f.reason}
    tried, on = _promising(state), hardest(state.fits[0])
    tasks = [Task(h, *_halves(h, values), on, quick=True) for h in tried]
    with share(_LOOKING_AT_PAIRS, within_steps=True):  # so that the best of those looked at are fitted in any case
        quick = fitters(tasks, lambda k: progress(0.55 + 0.3 * k / len(tasks), "pairs"))
    leading = set(pairs(tuple(f.hypothesis for f in state.fits[:_LEADING])))
    ranked = [f for f in _sorted(quick) if not f.reason]
    best = [f for k, f in enumerate(ranked) if k < _BEST_PAIRS or f.hypothesis in leading]
    final: list[Fit] = []
    for hopeless in (False, True):  # what explains little of it at a look is no rival of a pair that explains all
        wave = [f for f in best if (_left(f, state.fits[0], on, fitters) > _HOPELESS) is hopeless]
        if not replace(state, fits=tuple(_sorted(final))).explained:
            final += fitters(Task(f.hypothesis, _halves(f.hypothesis, values)[0], f.values) for f in wave)
    final += fitters(_other_laws(_sorted(final)[:_TAKEN_APART], values, fitters.data.prototype.rig))
    leading_pair = _sorted(final)[:1]  # none where the time was up before
    if leading_pair and leading_pair[0].misfit > _QUIET * state.expected:
        final += fitters(_rivals(leading_pair[0], state))
    # The causes of pairs alone, from where the pair has found them: a fit may have stopped short of that.
    paired = [one for one in final[:_TAKEN_APART] if not one.reason]
    parts = [Task(Hypothesis((name,)), one.values) for one in paired for name in one.hypothesis.names]
    return best_of_each([*state.fits, *fitters(parts), *final])


def _three_at_once(fitters: Fitters, state: Search, progress: Progress) -> list[Fit]:
    """The same with one more effect beside the best pairs, where these explain a good part of the gap but not all.

    Only what leaves much less than the pair counts: whatever the library does not hold, three laws imitate better than
    two. Where the pair had to strain figures for what it lacks, what these cost is counted with it.
    """
    alone = {f.hypothesis.causes: f for f in reversed(state.fits) if len(f.hypothesis.causes) == 1 and not f.reason}
    best_two = _by_best_laws(f for f in state.fits if len(f.hypothesis.causes) == 2 and not f.reason)
    near = [f for f in best_two if f.cost < _ABOUT * best_two[0].cost and state.excess(f) < _PARTLY][:_TAKEN_APART]
    strained = bool(near) and bool(near[0].strained)
    if not near or (not strained and (near[0].misfit < _QUIET * state.expected or state.excess(near[0]) < _DONE)):
        return list(state.fits)
    tasks = dict[Hypothesis, Task]()
    for pair, one in product(reversed(near), alone.values()):
        if one.hypothesis.effects and not {*one.hypothesis.causes} & {*pair.hypothesis.causes}:
            triple, beside = pair.hypothesis | one.hypothesis, _beside(pair, one, best_two)
            tasks[triple] = Task(triple, pair.values, beside, hardest(pair), quick=True)
    looks = fitters(tasks.values(), lambda k: progress(0.85 + 0.1 * k / len(tasks), "three causes at once"))
    ranked = [f for f in _sorted(looks) if not f.reason][:_BEST_TRIPLES]
    final = fitters(Task(f.hypothesis, tasks[f.hypothesis].known, f.values) for f in ranked)
    if (best := _sorted(final)[:1]) and best[0].misfit > _QUIET * state.expected:
        values = {f.hypothesis: f.values for f in state.fits if not f.reason}
        final += fitters(_other_laws(best, values, fitters.data.prototype.rig))
    for one in _sorted(final)[:1]:  # what stands in the other two's place: a delay for a lag
        others = (pair for pair in near if not {*pair.hypothesis.causes} <= {*one.hypothesis.causes})
        rest = reduce(Hypothesis.without, {c for f in near for c in f.hypothesis.causes}, one.hypothesis)
        final += fitters(Task(f.hypothesis | rest, one.values, f.values) for f in others if rest.names)
    left = {f.hypothesis: (f.cost if strained else f.misfit) - state.expected for f in (near[0], *final)}
    most = _MUCH_LESS * left[near[0].hypothesis]
    much = [f for f in _sorted(final) if not f.reason and left[f.hypothesis] < most]
    parts = [Task(f.hypothesis.without(name), f.values) for f in much[:1] for name in f.hypothesis.causes]
    return best_of_each([*state.fits, *fitters(parts), *much])


def _beside(pair: Fit, one: Fit, of: Sequence[Fit]) -> dict[str, float]:
    """What a third cause is found to be beside one of a pair, if a fit of that is there; else alone, for all of it."""
    causes, names = {*pair.hypothesis.causes}, {*one.hypothesis.names}
    return next((f.values for f in of if names < {*f.hypothesis.names} and causes & {*f.hypothesis.causes}), one.values)


def hardest(one: Fit, part: float = _HALF, first: int | None = None) -> tuple[int, ...]:
    """The part of all, or of the `first` pieces, that a fit leaves most of: tells which larger hypotheses are worth it.

    Returns:
        positions of the pieces of evidence, that which it leaves most of first.
    """
    worst = sorted(range(len(one.shares))[:first], key=lambda k: -one.shares[k].c)
    return tuple(worst[: max(1, round(part * len(worst)))])


def _with_pairs(fitters: Fitters, state: Search, progress: Progress) -> list[Fit]:
    """Single causes, and all pairs of an effect with one of the best of these, for figures without a record.

    Pairs are tried though a single cause may suffice: with few figures they decide how sure it can be. Most are left
    where a few iterations have brought them.
    """
    seen = (f for f in state.fits if not f.reason and f.hypothesis.causes[0] not in state.silent)
    values = {f.hypothesis: f.values for f in _by_best_laws(seen)}
    best = {name for h in list(values)[:_BEST_OF_FEW] for name in h.names}
    tried = [pair for pair in pairs(tuple(values)) if pair.effects and best & {*pair.names}]
    halves = [(pair, *_halves(pair, values)) for pair in tried]
    tasks = [Task(pair, state.null.values | worse | better, quick=True) for pair, worse, better in halves]
    quick = fitters(tasks, lambda k: progress(0.55 + 0.35 * k / len(tasks), "pairs"))
    settled = fitters(Task(f.hypothesis, f.values) for f in _sorted(quick)[:_BEST_PAIRS] if not f.reason)
    return best_of_each([*state.fits, *quick, *settled])


def _promising(state: Search) -> tuple[Hypothesis, ...]:
    """Pairs worth trying: the less the best single cause leaves, the fewer; where none explains half, all.

    One of a pair is an effect: two wrong figures at once are rarer than anything they would imitate. Of several laws
    for an effect, the one that fits better alone is tried.
    """
    left = state.excess(state.fits[0])
    count = next(n for bound, n in _BEST_SINGLES if left <= bound)
    first = _by_best_laws(state.fits)  # so that what is most promising is looked at before the time is up
    alone = [one.hypothesis for one in first]
    best = [one.hypothesis for one in first if not one.reason][:count]
    tried = dict.fromkeys(best[0] | other for other in alone if other.causes != best[0].causes)
    tried |= dict.fromkeys(one | other for one in best[1:] for other in alone if other.effects)
    if left > 1 - _EXPLAINED and state.null.misfit > _LARGE * state.expected:
        tried |= dict.fromkeys(pairs(tuple(h for h in alone if h.effects)))
    return tuple(pair for pair in tried if pair.effects and len(pair.causes) == 2)


def _by_best_laws(of: Iterable[Fit]) -> list[Fit]:
    """Of fits, the best first, the first of every set of causes."""
    return _sorted(reversed({f.hypothesis.causes: f for f in reversed([*of])}.values()))


def _other_laws(of: Sequence[Fit], values: Mapping[Hypothesis, dict[str, float]], rig: str) -> list[Task]:
    """Fits with another law for one of their effects: alone, without another cause, the wrong law may fit better.

    Args:
        of: these fits.
        values: found by singles.
        rig: that the laws have to fit.
    """
    tasks: dict[Hypothesis, Task] = {}
    for one in of:
        for name in one.hypothesis.effects if not one.reason else ():
            for law in library():
                if law != name and cause(law) == cause(name) and fits(law, rig):
                    pair = one.hypothesis.without(cause(name)) | Hypothesis((law,))
                    hints = values.get(Hypothesis((law,)), {}) | _by_law(one.values, name, law)
                    tasks.setdefault(pair, Task(pair, one.values, hints))
    return list(tasks.values())


def _as_by_the_usual_law(usual: Sequence[Fit], found: Sequence[Fit], null: Fit) -> Iterator[Task]:
    """Fits of further laws for an effect that begin where its usual law has been found, for what both have."""
    of = {f.hypothesis.names: f.values for f in usual if not f.reason}
    for hypothesis in (f.hypothesis for f in found if f.hypothesis.effects):
        if hypothesis.causes != hypothesis.names and (values := of.get(hypothesis.causes)):
            yield Task(hypothesis, null.values, _by_law(values, hypothesis.causes[0], hypothesis.names[0]))


def _by_law(values: Mapping[str, float], law: str, other: str) -> dict[str, float]:
    """Values by the names that they have where another law takes the place of one."""
    return {f"{other}{name.removeprefix(law)}" if name.startswith(f"{law}.") else name: v for name, v in values.items()}


def _rivals(one: Fit, state: Search) -> list[Task]:
    """A pair with another cause in the place of either that explains nearly as much alone: a delay for a lag.

    At a look the wrong one of the two may help the other cause to its place sooner.

    Args:
        one: fit of the pair.
        state: with all singles.
    """
    alone = {f.hypothesis.causes: f for f in reversed(state.fits) if not f.reason and len(f.hypothesis.causes) == 1}
    tasks: dict[Hypothesis, Task] = {}
    for name in () if one.reason else one.hypothesis.causes:
        most = _NEARLY * alone[(name,)].cost if (name,) in alone else 0.0
        for (other,), found in alone.items():
            if other not in one.hypothesis.causes and found.hypothesis.effects and found.cost < most:
                pair = one.hypothesis.without(name) | found.hypothesis
                tasks.setdefault(pair, Task(pair, one.values, found.values))
    return list(tasks.values())


def best_of_each(fits: Iterable[Fit]) -> list[Fit]:
    """Of all fits, the best one of every hypothesis; best first."""
    return _sorted(reversed({f.hypothesis: f for f in reversed(_sorted(fits))}.values()))


def _halves(of: Hypothesis, values: Mapping[Hypothesis, dict[str, float]]) -> tuple[dict[str, float], dict[str, float]]:
    """What the better single of a pair has found, for all of it, and what the other one has.

    Args:
        of: the pair.
        values: found by singles, best last.
    """
    parts = [found for alone, found in values.items() if set(alone.names) <= set(of.names)]
    return (parts[-1] if parts else {}), (parts[0] if len(parts) > 1 else {})


def _sorted(fits: Iterable[Fit]) -> list[Fit]:
    return sorted(fits, key=lambda f: f.cost)
