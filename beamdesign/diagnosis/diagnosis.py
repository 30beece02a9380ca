"""What a diagnosis says, whatever the evidence: records that a report prints, the fields of its JSON file, a prototype.

The prototype is the believed one with what a fit has found: figures re-tuned, effects added.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite, nan, sqrt
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar

import numpy as np

from beamdesign.bench_prototype import AnyPrototype
from beamdesign.controllers import Controller
from beamdesign.diagnosis.fitting.fit import Fit
from beamdesign.diagnosis.fitting.hypothesis import ABSENT, SUPPLY, WRONG, Hypothesis, given, left_as_known
from beamdesign.diagnosis.fitting.search import Search
from beamdesign.diagnosis.separability import Separability
from beamdesign.parameters import PARAMETERS
from beamdesign.prototype import Beam, Prototype
from beamdesign.quantities import decimal, quantity
from beamdesign.records import Record
from beamdesign.result import Result, finite, picked
from beamdesign.structure import lumped
from beamdesign.structure.arm import with_torsion

if TYPE_CHECKING:
    from beamdesign.diagnosis.gap_metrics import Errors
    from beamdesign.diagnosis.judgement import Judgement

Verdict = Literal["no_gap", "effect", "ambiguous", "unknown"]


@dataclass(frozen=True)
class Estimate:
    """A figure with its standard error, SI."""

    value: float
    std: float


@dataclass(frozen=True)
class Cause:
    """An effect, or a wrong figure (`parameter:NAME`), with what speaks for it.

    Attributes:
        name: of the effect.
        subsystem: where it sits.
        probability: that it is at work, alone or together with others.
        share: of the gap that it explains, from 0 to 1.
        parameters: of the effect (or the figures set free), by name.
        flags: what makes it suspicious, in words (a parameter at its bound, a figure
            moved by more than two tolerances).
        like: of a law learnt from the data, the physics that is nearest, in words.
        table: of a static one, what it adds over its local variable, with its standard error.
    """

    name: str
    subsystem: str
    probability: float
    share: float
    parameters: Mapping[str, Estimate] = field(default_factory=dict)
    flags: tuple[str, ...] = ()
    like: str = ""
    table: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class RecordGap:
    """Normalised rms errors of one record's displacement.

    Attributes:
        record: its name.
        held_out: whether it is left out of the fits by which errors are measured; those that choose a cause see all.
        before: of the believed prototype.
        tuned: with the tolerated figures fitted.
        after: with the chosen causes as well.
        noise_floor: that of the sensor's noise.
    """

    record: str
    held_out: bool
    before: float
    tuned: float
    after: float
    noise_floor: float


@dataclass(frozen=True)
class BandGap:
    """The same for one band of frequency over all held-out records, each over the whole channel's rms."""

    low_Hz: float
    high_Hz: float
    before: float
    tuned: float
    after: float
    noise_floor: float


@dataclass(frozen=True)
class Gap:
    """How large the gap is and how far it shrinks, on held-out records.

    Attributes:
        before: normalised rms error of the believed prototype, over records the root mean square.
        tuned: with the tolerated figures re-tuned only.
        after: with the chosen causes.
        noise_floor: below which no model can go.
        closed: (before^2 - after^2) / (before^2 - noise_floor^2).
        closed_interval: 90 % interval by block bootstrap; it holds that of the written prototype as well.
        records: one by one, the fitted ones too.
        bands: by frequency.
    """

    before: float
    tuned: float
    after: float
    noise_floor: float
    closed: float
    closed_interval: tuple[float, float]
    records: tuple[RecordGap, ...] = ()
    bands: tuple[BandGap, ...] = ()


@dataclass(frozen=True)
class Indicator:
    """One independent way of looking for the place.

    Attributes:
        name: of the way.
        subsystem: where it points; empty where it cannot say.
        strength: from 0 (says nothing) to 1 (says it beyond doubt).
        text: in words, with the figures.
        table: what a report may draw; rows of plain values by column name.
    """

    name: str
    subsystem: str
    strength: float
    text: str
    table: Mapping[str, tuple[object, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class Where:
    """Where the gap lies.

    Attributes:
        subsystem: one of those of the contract; empty without a gap.
        band_Hz: where in frequency most of it is; (0, 0) where that was not found, for want of time or of records.
        condition: under which conditions it shows, in words.
        kind: `linear`, `static`, `hysteretic`, `drifting` or empty.
        indicators: each on its own.
        sentence: that weighs them.
    """

    subsystem: str
    band_Hz: tuple[float, float]
    condition: str
    kind: str = ""
    indicators: tuple[Indicator, ...] = ()
    sentence: str = ""

    @property
    def place(self) -> str:
        """Subsystem and band in words; empty without a subsystem."""
        low, high = (decimal(value, 3) for value in self.band_Hz)
        return f"{self.subsystem}, {low} to {high} Hz" if self.subsystem and self.band_Hz[1] > 0 else self.subsystem


@dataclass(frozen=True)
class NextExperiment:
    """What to measure next.

    Attributes:
        text: in words, ready to be done.
        separates: names of the causes it tells apart.
        separation: expected misfit between their predictions in units of misfit (square root), at the experiment.
        settings: input, amplitude, band, payload, added sensor: for a scenario file; of several records the first's.
        information_bits: least that it is expected to tell about which of the causes it is; NaN where only the
            separation was worked out.
        series: (N,) of every record to be taken by its name: times, inputs to be played, and the displacement that
            each cause predicts, by the names of their columns.
    """

    text: str
    separates: tuple[str, ...]
    separation: float
    settings: Mapping[str, object] = field(default_factory=dict)
    information_bits: float = nan
    series: Mapping[str, Mapping[str, np.ndarray]] = field(default_factory=dict, repr=False)


@dataclass(frozen=True)
class CauseSet:
    """Causes that were fitted together.

    Attributes:
        names: of the causes; none where only tolerated figures were moved.
        probability: of these and no others.
        share_left: misfit that they leave beyond noise, as a share of what tolerances alone leave; NaN where it was not
            worked out, or where these leave nothing.
    """

    names: tuple[str, ...]
    probability: float
    share_left: float

    def __str__(self) -> str:
        return str(Hypothesis(self.names))


Rig = TypeVar("Rig", bound=AnyPrototype)
_LISTED, _LEAST_PROBABILITY = 12, 1e-6  # sets of causes
_MOST_OF_IT = 0.8  # of the gap


@dataclass(frozen=True, repr=False)
class Diagnosis(Generic[Rig], Result):
    """The answer, from whatever evidence.

    Attributes:
        name: of the data set.
        verdict: `no_gap`, `effect`, `ambiguous` (several causes explain it alike) or `unknown` (none does, or
            tolerances do as far as doubtful data or too short a time tell).
        sentences: the verdict for people.
        causes: best first.
        chosen: names held responsible, the dominant one first.
        probability_unknown: that something outside the library is behind the gap; NaN where only known causes are
            weighed.
        where: it lies.
        gap: before and after.
        classes: causes that these data cannot tell apart, each class with what is common to it.
        next_experiment: where the verdict is not clear.
        prototype: believed one with the fitted figures and the chosen effects.
        warnings: about the data.
        search: all fits, to all of the data.
        separability: what the data could tell before any fit.
        hypotheses: sets of causes, most probable first.
        errors: of the time records as predicted from rest.
        notes: what else has to be said, in words.
        left_out: causes that were not compared for want of time; then the verdict is no surer than ambiguous.
        chance: that a rig without a gap is judged so, see `beamdesign.diagnosis.verdict`; NaN where it is not known.
        judged: probabilities of all sets of causes, law by law.
        measure: what the errors of its gap are, in words.
        findings: what its kind of evidence tells beside, by the names of its JSON file.
        written: the fit that the prototype is written from; of a bench without a cause, that of tolerances alone.
    """

    name: str
    verdict: Verdict
    sentences: str
    causes: tuple[Cause, ...]
    chosen: tuple[str, ...]
    probability_unknown: float
    where: Where
    gap: Gap
    classes: tuple[tuple[str, ...], ...]
    next_experiment: NextExperiment | None
    prototype: Rig
    warnings: tuple[str, ...] = ()
    search: Search | None = field(default=None, repr=False)
    separability: Separability | None = field(default=None, repr=False)
    hypotheses: tuple[CauseSet, ...] = ()
    errors: "tuple[Errors, ...]" = field(default=(), repr=False)
    notes: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    chance: float = nan
    judged: "Judgement | None" = field(default=None, repr=False)
    measure: str = (
        "Prediction errors of the displacement over its rms. Records held out of the fits that measure them count; a"
        " cause is chosen by fits to all."
    )
    findings: Mapping[str, Any] = field(default_factory=dict, repr=False)
    written: Fit | None = field(default=None, repr=False)

    @property
    def status(self) -> str:
        """The verdict."""
        return self.verdict

    @property
    def reserve(self) -> str:
        """Why what is proved of its prototype is no promise of the rig, in words; empty where the gap is explained."""
        from beamdesign.diagnosis.verdict import LEVEL

        tolerances = self.probability_unknown <= 0.5 and not self.chance <= LEVEL  # leave no gap, as far as is known
        if self.verdict != "unknown" or tolerances or self.gap.closed >= _MOST_OF_IT:
            return ""
        left = f"{1 - max(self.gap.closed, 0.0):.0%} of the gap" if self.gap.closed == self.gap.closed else "the gap"
        return f"The prototype that is written leaves {left}: what is proved of it is no promise of the rig."

    def to_dict(self) -> dict[str, Any]:
        """Everything it says as plain fields for programs: names and units of its JSON file.

        `effects` come best first; `gap` holds errors over the rms of the signal, on records held out of the fits that
        measure it (those that choose a cause see all); `next_experiment` is None where the verdict is clear.
        """
        own = "verdict sentences effects=causes chosen probability_unknown where gap classes next_experiment warnings"
        listed = [one for one in self.hypotheses[:_LISTED] if one.probability > _LEAST_PROBABILITY]
        fields = picked(self, own) | {"hypotheses": listed, "data_set": self.name}
        if self.next_experiment is not None:
            asked = "text separates separation information_bits settings"
            fields["next_experiment"] = picked(self.next_experiment, asked)
        fields |= {"complete": not self.left_out, "left_out": self.left_out, "chance_without_gap": self.chance}
        if (separability := self.separability) is not None:
            names = "not_told_apart=classes nearly_alike=close not_visible=invisible"
            fields["before_fitting"] = picked(separability, names)
        fields |= {key: one.to_dict() if isinstance(one, Diagnosis) else one for key, one in self.findings.items()}
        return dict(finite(fields | ({"notes": self.notes} if self.notes else {})))

    def rows(self) -> list[tuple[Any, ...]]:
        """The causes, the most probable first: name, subsystem, probability, share of the gap."""
        rows = ((one.name, one.subsystem, f"{one.probability:.1%}", f"{one.share:.0%}") for one in self.causes)
        other = [(self.not_listed, "", f"{self.probability_unknown:.1%}", "")]
        return [*rows, *(other if isfinite(self.probability_unknown) else ())]

    @property
    def not_listed(self) -> str:
        """What the row of causes that are not listed is called."""
        learnt = any(one.like for one in self.causes)
        return f"none that is known here{', what was learnt included' if learnt else ''}"


def in_words(names: str) -> str:
    """Names of causes as sentences have them."""
    return named(names).replace("empirical:", "a law at the port ").replace("_", " ")


def named(cause: str) -> str:
    """A cause by its name in the library, with words for what is said of a figure or of an effect that is not there."""
    return cause.replace(WRONG, "a wrong ").replace(ABSENT, "the lack of ")


def listed(names: Sequence[str], word: str = "and") -> str:
    """Names in a sentence, with a word before the last of several."""
    return f"{', '.join(names[:-1])} {word} {names[-1]}" if len(names) > 1 else "".join(names)


def controller_text(controller: Controller, inner_end_mass_kg: float) -> str:
    """A controller in one line, with what mass its inner tip has."""
    gain = quantity(controller.gain_A_per_V, "A/V")
    return f"{controller.words(4)} at {gain}, {inner_end_mass_kg:.3g} kg inside"


def no_surer(verdict: Verdict, left_out: Sequence[str]) -> Verdict:
    """A verdict that is no surer than what was compared."""
    weaker: dict[Verdict, Verdict] = {"effect": "ambiguous", "no_gap": "unknown"}
    return weaker.get(verdict, verdict) if left_out else verdict


def updated_prototype(prototype: Prototype, found: Fit) -> Prototype:
    """Put a fit's figures and effects into a prototype.

    A proof that stood for the believed figures does not stand for the new ones, so the guarantee is dropped.
    """
    nominal = lumped.figures(prototype)
    figures = nominal | {u: v for u, v in found.values.items() if "." not in u}
    # The model's dashpot goes with the root of K M of its beam; so does the fitted one.
    for beam in ("outer", "inner"):
        for part in ("stiffness", "mass"):
            figures[f"{beam}_damping"] *= sqrt(figures[f"{beam}_{part}"] / nominal[f"{beam}_{part}"])
    # What scales laws that were tried and not chosen goes.
    effects = {name: dict(prototype.effects[name]) for name in left_as_known(prototype, found.hypothesis)}
    for name in found.hypothesis.effects:
        own = {key.removeprefix(f"{name}."): value for key, value in found.values.items() if key.startswith(f"{name}.")}
        effects[name] = {**given(name, prototype), **own}
    changes: dict[str, Record] = {f"{name}_beam": _beam(prototype, name, figures) for name in ("outer", "inner")}
    tables: dict[str, dict[str, float]] = {}
    for name, row in PARAMETERS.items():  # beside those of the beams, where the prototype states any
        table, key = row.place.split(".")
        if name in figures and "_beam" not in table and row.stated(prototype) is not None:
            tables.setdefault(table, {})[key] = figures[name] / row.factor
    changes |= {table: getattr(prototype, table).but(**new) for table, new in tables.items()}
    if prototype.arm is not None:
        changes["arm"] = with_torsion(prototype, found.values)
    changes["supply"] = prototype.supply.but(pressure_Pa=found.values.get(SUPPLY, prototype.supply.pressure_Pa))
    return prototype.but(**changes, effects=effects, guarantee=None)


def _beam(prototype: Prototype, name: str, figures: Mapping[str, float]) -> Beam:
    stiffness, mass, dashpot = (figures[f"{name}_{part}"] for part in ("stiffness", "mass", "damping"))
    beam, critical = getattr(prototype, f"{name}_beam"), 2 * sqrt(stiffness * mass)
    return Beam.but(beam, stiffness_N_per_m=stiffness, effective_mass_kg=mass, damping_ratio=dashpot / critical)
