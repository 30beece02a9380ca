"""Several laws, one for each part of the payload's range, chosen by an estimate of the payload."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from math import inf, pi
from typing import Any, ClassVar, Literal, NoReturn, Self

from pydantic import Field

from beamdesign import quantities as q
from beamdesign.controllers.cascade import Lag, Section, Structured
from beamdesign.controllers.protocol import Controller, Laws, Need, Row, refuse
from beamdesign.records import Problem, Record, numbers, stated

STAGES = 2, 12
"""Fewest and most laws of a scheduled controller."""


FREE = 10
"""Figures that a free response takes in an estimate of the payload: at most so many degrees of freedom of a window."""


class Stage(Record):
    """One law of a scheduled controller: a lag, or one with second-order sections, and the payloads that it is for."""

    outer_end_mass_kg: tuple[q.MassOrNone, q.MassOrNone] = Field(
        description="payloads [least, most] for which this law's guarantee holds; overlaps with the next stage's"
    )
    gain_A_per_V: q.LawGain = Field(description="K_sa, servo-amplifier gain at zero frequency")
    pole_Hz: q.Frequency = Field(description="lower break frequency")
    zero_Hz: q.Frequency = Field(description="upper break frequency")
    section: tuple[Section, ...] = Field(
        (), max_length=3, description="second-order sections before the lag; as many in all"
    )

    @property
    def law(self) -> Lag | Structured:
        """The law by itself."""
        own = {name: getattr(self, name) for name in ("gain_A_per_V", "pole_Hz", "zero_Hz")}
        return Structured(**own, section=self.section) if self.section else Lag(**own)

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """The range holds more than one mass."""
        if (pair := numbers(table, "outer_end_mass_kg", each=2)) and not pair[0] < pair[1]:
            yield Problem("outer_end_mass_kg", f"must be [least, most], least below most; is {list(pair)}")


class Estimator(Record):
    """How the payload is estimated from current and volts, and when an estimate counts: `controllers.scheduling`."""

    noise_V: q.EstimatorNoise = Field(0.002, description="RMS of the sensor's noise as the law samples it")
    window_s: q.Window = Field(0.08, description="length of the records that the models are fitted to")
    update_s: q.Update = Field(0.01, description="time between estimates")
    forgetting_s: q.Duration = Field(0.3, description="time of useful records after which an old one counts for 1/e")
    model_error: q.Unexplained = Field(
        0.1, description="share of the motion that may stay unexplained in a useful record"
    )
    largest_std_kg: q.Mass = Field(
        0.15, description="excitation threshold: estimates less certain than this change nothing"
    )
    band_kg: q.Mass = Field(0.4, description="error of the estimate that the stages' overlaps leave room for")

    @property
    def longest_period_s(self) -> float:
        """Longest time between samples with which it tells anything."""
        return longest_period_s(self.update_s, self.window_s)

    @classmethod
    def usual(cls, quick: float, heavy: float) -> Self:
        """That of a rig so many times as quick and as heavy as the published one."""
        pairs = ((q.Window, "window_s"), (q.Update, "update_s"), (q.Duration, "forgetting_s"))
        ranges = {name: q.range_of(quantity) for quantity, name in pairs}
        times = {name: min(max(_USUAL[name] / quick, of.low), of.high) for name, of in ranges.items()}
        return cls(**times, **{name: _USUAL[name] * heavy for name in ("largest_std_kg", "band_kg")})

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """What is new since the last estimate is a part of a window."""
        found = numbers({**_USUAL, **table}, "update_s", "window_s")
        if found and found[0] > found[1]:
            yield Problem("update_s", f"must be at most window_s, {found[1]:g} s; is {found[0]:g}")


def longest_period_s(update_s: float, window_s: float) -> float:
    """Longest time between samples with which a payload is estimated.

    An update has a sample at least, and a window more than a free response explains by itself.
    """
    return min(update_s, window_s / (FREE + 1))


_PERIODS_S = (5e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5)
"""Of sampling, the first of them being the usual one."""


def sampling_period_s(stages: Sequence[Stage], estimator: Estimator) -> float:
    """The longest usual period of at most a quarter of that of the highest break of any law, enough for an estimate."""
    from beamdesign.polynomial import roots  # records are read without it

    laws = [stage.law.sensed_law() for stage in stages]
    breaks = [abs(root) for law in laws for part in (law.denominator, *law.numerators) for root in roots(part)]
    longest = min(pi / 2 / max(breaks), estimator.longest_period_s)
    return next((period for period in _PERIODS_S if period <= longest), _PERIODS_S[-1])


_USUAL = {name: field.default for name, field in Estimator.model_fields.items()}


class Scheduled(Controller):
    """Several laws, one for each part of the payload's range, chosen by an estimate of the payload.

    What a linear law can be asked for is asked of its `laws`, one at a time; it refuses that itself.
    """

    kind: Literal["scheduled"] = Field("scheduled", description="which law, with its own figures")
    period_s: q.SamplePeriod = Field(0.5e-3, description="from sample to sample of the law and the estimator")
    dwell_s: q.Duration = Field(0.1, description="least time between two changes of stage")
    stage: tuple[Stage, ...] = Field(
        min_length=STAGES[0], max_length=STAGES[1], description="from the lightest payloads to the heaviest"
    )
    estimator: Estimator = Estimator()

    @property
    def laws(self) -> Laws:
        """The law of every stage with its payloads."""
        return tuple((stage.law, stage.outer_end_mass_kg) for stage in self.stage)

    @property
    def outer_end_mass_kg(self) -> tuple[float, float]:
        """The payloads that its stages cover together."""
        return self.stage[0].outer_end_mass_kg[0], self.stage[-1].outer_end_mass_kg[1]

    def uncovered(self, masses_kg: tuple[float, float]) -> str:
        """That its laws are not for all of some payloads, in words; empty where they are."""
        low, high = self.outer_end_mass_kg
        if low <= masses_kg[0] and masses_kg[1] <= high:
            return ""
        return f"[{masses_kg[0]:g}, {masses_kg[1]:g}] is not covered by the stages, {low:g} to {high:g} kg"

    @property
    def kept_kg(self) -> tuple[tuple[float, float], ...]:
        """Between which estimates of the payload each stage acts on; the ends of the whole range are open."""
        band, last = self.estimator.band_kg, len(self.stage) - 1
        return tuple(
            (-inf if k == 0 else low + band, inf if k == last else high - band)
            for k, (_, (low, high)) in enumerate(self.laws)
        )

    @property
    def schedule(self) -> Self:
        """Itself."""
        return self

    @property
    def sought(self) -> dict[str, Any]:
        """As many laws, and the same estimator."""
        return {"kind": self.kind, "stages": len(self.stage), "estimator": self.estimator}

    def lacks(self, need: Need) -> str:
        """That it is no law by itself."""
        words = "each for a part of the payloads; make one of them the [controller]; `beamdesign spec` takes each"
        return f"holds {len(self.stage)} laws, {words}"

    def _refused(self, *given: Any) -> NoReturn:
        refuse(self, "one sensor", "what takes one law", "prototype")
        raise AssertionError("never here")

    gain_A_per_V: ClassVar[Any] = property(_refused)
    equations: ClassVar[Any] = property(_refused)
    sensed_law: ClassVar[Any] = _refused
    figures: ClassVar[Any] = _refused

    def words(self, digits: int = 3) -> str:
        """Its kind and how many laws it has."""
        return f"{self.kind}, {len(self.stage)} laws"

    def rows(self) -> list[Row]:
        """The figures of every stage, one after the other."""
        return [
            (f"{name}, {low:g} to {high:g} kg", value, meaning)
            for law, (low, high) in self.laws
            for name, value, meaning in law.rows()
        ]

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """Stages ascend and overlap by twice the estimator's band; all have as many sections; samples are enough."""
        stages, given = table.get("stage"), table.get("estimator", {})
        stages = stages if isinstance(stages, tuple) else ()
        own = {name: usual if (one := stated(given, name)) is None else one for name, usual in _USUAL.items()}
        period = {"period_s": table.get("period_s", cls.model_fields["period_s"].default)}
        found = numbers(own | period, "period_s", "update_s", "window_s")
        if found and found[0] > (most := longest_period_s(*found[1:])) * (1 + 1e-9):
            reason = f"an estimate takes a sample between updates and more than {FREE} of them in a window"
            yield Problem("period_s", f"must be at most {most:.4g} s, since {reason}; is {found[0]:g}")
        ranges = [stated(stage, "outer_end_mass_kg") for stage in stages]
        band = own["band_kg"] if isinstance(own["band_kg"], float) else Estimator().band_kg
        if all(numbers({"range": each}, "range", each=2) for each in ranges):
            for k, (one, two) in enumerate(pairwise(ranges), start=1):
                if not (one[0] < two[0] and one[1] < two[1]):
                    yield Problem("stage", f"stage {k + 1} must begin and end above stage {k}")
                elif one[1] - two[0] < 2 * band * (1 - 1e-9):
                    needed = f"twice the estimator's band_kg, {2 * band:.4g} kg, is needed"
                    yield Problem("stage", f"stages {k} and {k + 1} overlap by {one[1] - two[0]:.4g} kg; {needed}")
        sections = (stated(stage, "section") or () for stage in stages)
        if len({len(own) for own in sections if isinstance(own, tuple)}) > 1:
            yield Problem("stage", "all stages must have the same number of sections")
