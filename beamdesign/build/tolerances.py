"""Tolerances that keep the proof of stability: each figure alone, and all of them at once."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from decimal import ROUND_FLOOR
from typing import NamedTuple

from beamdesign.plant.members import family
from beamdesign.progress import Progress, silent
from beamdesign.proofs.certifying import common_ranges, rectangles
from beamdesign.proofs.performance import bandwidth, least_limit
from beamdesign.proofs.rig_family import effect_spans, rig_family, rig_values
from beamdesign.proofs.scope import members
from beamdesign.proofs.tolerance_box import Scaling, largest_scaling, tolerance_box
from beamdesign.prototype import InStage, Prototype
from beamdesign.quantities import decimal
from beamdesign.records import InputError
from beamdesign.structure.lumped import CHANGEABLE, with_figures

LARGEST = 0.5
"""Largest relative tolerance that is asked about."""

SAFETY = 2.0
"""The specified tolerances are what is proved for all at once, divided by this: a box up to the very edge of stability
holds rigs that hardly damp anything."""

_UNIT = 0.01
_WITHIN, _COARSE = 0.02, 0.05
_BUDGET = 400
_SIGMAS = 10.0


@dataclass(frozen=True)
class FigureTolerance:
    """Relative tolerances of one figure, to either side.

    Attributes:
        name: as in `beamdesign.proofs.rig_family.rig_values`.
        alone: proved, with all other figures nominal.
        alone_refuted: at which a member was proved unstable; None where none was found up to `LARGEST`.
        shared: proved for all figures at once, in the proportions of `alone`.
        specified: `shared` less the safety: what the workshop is asked to keep.
        bandwidth_Hz: least proved with this figure alone at either end of `specified`; None where it has no such key.
        peak_sensitivity: largest proved likewise.
    """

    name: str
    alone: float
    alone_refuted: float | None
    shared: float
    specified: float
    bandwidth_Hz: float | None
    peak_sensitivity: float | None


@dataclass(frozen=True)
class Tolerances:
    """All of them.

    Attributes:
        figures: tightest first.
        equal: relative tolerance proved for all figures at once, the same for each.
        equal_refuted: at which a member is unstable; None where none was found.
        stated_sigmas: the prototype's own standard deviations, all at once, are proved up to this many; None where it
            states none.
        certificates: of the box of shared tolerances or a wider one, for each law, which `beamdesign certify --replay`
            proves again; empty texts where nothing was proved.
        certificates_equal: of the box of equal tolerances, likewise.
    """

    figures: tuple[FigureTolerance, ...]
    equal: float
    equal_refuted: float | None
    stated_sigmas: float | None
    certificates: tuple[str, ...] = field(repr=False, compare=False)
    certificates_equal: tuple[str, ...] = field(repr=False, compare=False)

    @property
    def specified(self) -> dict[str, float]:
        """Specified tolerances by figure."""
        return {figure.name: figure.specified for figure in self.figures}


def why_no_box(prototype: Prototype) -> str:
    """Why nothing can be proved of a prototype's loop over a box of its figures; empty where something can."""
    try:
        rig_family(prototype)
    except InputError as error:
        return "; ".join(problem[1] for problem in error.problems)
    return ""


Performance = tuple[float | None, float | None]
"""Bandwidth, Hz, and peak sensitivity that are proved; none where a loop is not stable."""


def performance_of_all(stages: Iterable[InStage]) -> Performance:
    """The worst with each law over its own payloads: of what `certify` proves these figures alone."""
    found = []
    for stage in stages:
        proved = rectangles(members(stage.prototype, *stage.outer_end_mass_kg))
        if not common_ranges(proved).stable:
            return None, None
        goal, performing = stage.prototype.goal, [part.performing for part in proved if part.performing is not None]
        peak = least_limit(performing, "peak_sensitivity", goal=goal.peak_sensitivity)
        found.append((bandwidth(performing, goal.compliance_m_per_N), peak))
    return min(hertz for hertz, _ in found), max(peak for _, peak in found)


def toleranced_figures(prototype: Prototype) -> tuple[str, ...]:
    """Figures of the loop that can have a tolerance: positive ones that no effect spans already."""
    spans = effect_spans(family(prototype))
    return tuple(
        name
        for name, value in rig_values(prototype).items()
        if value > 0 and name not in ("delay", "outer_end_mass") and name not in spans
    )


def tolerances(prototype: Prototype, masses_kg: tuple[float, float], progress: Progress = silent) -> Tolerances:
    """Prove tolerances of a prototype whose nominal loop is proved stable for every outer end mass of a range.

    With several laws the tolerances are those that the loop bears with each of them, over the payloads that it is for.

    Args:
        prototype: with a controller.
        masses_kg: range of outer end mass, all of which is in every box, or of several laws' boxes together.
        progress: told the share done, and with what.
    """
    stages = prototype.stages(masses_kg)
    names = toleranced_figures(stages[0].prototype)

    def scale(spread: Mapping[str, float] | None, most: float, within: float = _WITHIN) -> _Borne:
        found: list[Scaling] = []
        for law, masses, _ in stages:
            box = tolerance_box(law, 1.0, None if spread is None else tuple(spread), masses, spread=spread)
            found.append(largest_scaling(law, box, within, _BUDGET, most, numbers=True))
            most = found[-1].proved or most  # no more counts than what the law before it bears
        return _Borne(tuple(found))

    alone: dict[str, _Borne] = {}
    for k, name in enumerate(names):
        progress(0.5 * k / len(names), f"tolerance of {name.replace('_', ' ')}")
        alone[name] = scale({name: _UNIT}, LARGEST / _UNIT)
    progress(0.5, "all tolerances at once")
    bearing = min(found.refuted or LARGEST / _UNIT for found in alone.values())
    equal = scale(dict.fromkeys(names, _UNIT), bearing)  # no more than the weakest bears alone
    weights = {name: max(found.proved, 1e-3) * _UNIT for name, found in alone.items()}
    shared = scale(weights, 1.0, _COARSE)
    stated = None
    if any(prototype.tolerance.model_dump().values()):
        own = tolerance_box(stages[0].prototype, 1.0, None, masses_kg)
        if set(own.names) - own.rigid:
            stated = scale(None, _SIGMAS).proved
    rows = []
    for k, name in enumerate(names):
        progress(0.7 + 0.3 * k / len(names), "performance at the ends of the tolerances")
        share = shared.proved * weights[name]
        specified = float(decimal(share / SAFETY, 2, ROUND_FLOOR)) if share > 0 else 0.0  # as a workshop can be given
        ends: Performance = (None, None)
        if name in CHANGEABLE:
            both = [{name: 1 + side * specified} for side in (-1, 1)]
            off = (one._replace(prototype=with_figures(one.prototype, by)) for one in stages for by in both)
            ends = performance_of_all(off)
        rows.append(FigureTolerance(name, *alone[name].times(_UNIT), share, specified, *ends))
    figures = tuple(sorted(rows, key=lambda row: row.alone))
    return Tolerances(figures, *equal.times(_UNIT), stated, shared.certificates, equal.certificates)


class _Borne(NamedTuple):
    """How far a box can be drawn out with each of the laws; the weakest counts."""

    each: tuple[Scaling, ...]

    @property
    def proved(self) -> float:
        return min(one.proved for one in self.each)

    @property
    def refuted(self) -> float | None:
        return min((one.refuted for one in self.each if one.refuted is not None), default=None)

    def times(self, unit: float) -> tuple[float, float | None]:
        """What is proved and what is refuted of a box of tolerances of this size."""
        return self.proved * unit, None if self.refuted is None else self.refuted * unit

    @property
    def certificates(self) -> tuple[str, ...]:
        return tuple(one.verdict.certificate if one.verdict else "" for one in self.each)
