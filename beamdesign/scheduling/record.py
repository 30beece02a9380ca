"""A controller with one law for each part of the payload's range, and the file of a prototype that carries it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from beamdesign import quantities as q
from beamdesign import records
from beamdesign.controllers import Lag, Section, Structured
from beamdesign.files import write_whole
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem, Record, numbers
from beamdesign.spelling import shorter

KIND = "scheduled"


class Stage(Record):
    """One law of a scheduled controller: a lag, or one with second-order sections, and the payloads that it is for."""

    outer_end_mass_kg: Annotated[
        tuple[q.MassOrNone, q.MassOrNone],
        Field(
            description="payloads [least, most] for which this law's guarantee holds; overlaps with the next stage's"
        ),
    ]
    gain_A_per_V: Annotated[q.LawGain, Field(description="K_sa, servo-amplifier gain at zero frequency")]
    pole_Hz: Annotated[q.Frequency, Field(description="lower break frequency")]
    zero_Hz: Annotated[q.Frequency, Field(description="upper break frequency")]
    section: Annotated[
        tuple[Section, ...], Field(max_length=3, description="second-order sections before the lag; as many in all")
    ] = ()

    @property
    def law(self) -> Lag | Structured:
        """The law by itself."""
        lag = Lag(gain_A_per_V=self.gain_A_per_V, pole_Hz=self.pole_Hz, zero_Hz=self.zero_Hz)
        if not self.section:
            return lag
        return Structured(gain_A_per_V=lag.gain_A_per_V, pole_Hz=lag.pole_Hz, zero_Hz=lag.zero_Hz, section=self.section)

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """The range holds more than one mass."""
        bounds = table.get("outer_end_mass_kg")
        if isinstance(bounds, tuple) and len(bounds) == 2:
            pair = numbers({"least": bounds[0], "most": bounds[1]}, "least", "most")
            if pair and not pair[0] < pair[1]:
                yield Problem("outer_end_mass_kg", f"must be [least, most], least below most; is {list(pair)}")


class Estimator(Record):
    """How the payload is estimated from current and volts, and when an estimate counts; see `scheduling.estimator`."""

    noise_V: Annotated[q.EstimatorNoise, Field(description="RMS of the sensor's noise as the law samples it")] = 0.002
    window_s: Annotated[q.Window, Field(description="length of the records that the models are fitted to")] = 0.08
    update_s: Annotated[q.Update, Field(description="time between estimates")] = 0.01
    forgetting_s: Annotated[
        q.Duration, Field(description="time of useful records after which an old one counts for 1/e")
    ] = 0.3
    model_error: Annotated[
        q.Unexplained,
        Field(description="share of the motion that may stay unexplained in a useful record"),
    ] = 0.1
    largest_std_kg: Annotated[
        q.Mass, Field(description="excitation threshold: estimates less certain than this change nothing")
    ] = 0.15
    band_kg: Annotated[q.Mass, Field(description="error of the estimate that the stages' overlaps leave room for")] = (
        0.4
    )


class Scheduled(Record):
    """Several laws, one for each part of the payload's range, chosen by an estimate of the payload."""

    kind: Annotated[Literal["scheduled"], Field(description="which law, with its own figures")] = "scheduled"
    period_s: Annotated[q.SamplePeriod, Field(description="from sample to sample of the law and the estimator")] = (
        0.5e-3
    )
    dwell_s: Annotated[q.Duration, Field(description="least time between two changes of stage")] = 0.1
    stage: Annotated[
        tuple[Stage, ...], Field(min_length=2, max_length=12, description="from the lightest payloads to the heaviest")
    ]
    estimator: Estimator = Estimator()

    @property
    def outer_end_mass_kg(self) -> tuple[float, float]:
        """The payloads that the stages cover together."""
        return self.stage[0].outer_end_mass_kg[0], self.stage[-1].outer_end_mass_kg[1]

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """Stages ascend and overlap by twice the estimator's band; all have as many sections."""
        stages = table.get("stage")
        ranges = [_field(stage, "outer_end_mass_kg") for stage in stages] if isinstance(stages, tuple) else []
        band = _field(table.get("estimator", Estimator()), "band_kg")
        band = band if isinstance(band, float) else Estimator().band_kg
        if all(isinstance(r, tuple) and len(r) == 2 and numbers({"a": r[0], "b": r[1]}, "a", "b") for r in ranges):
            for k, (one, two) in enumerate(pairwise(ranges), start=1):
                if not (one[0] < two[0] and one[1] < two[1]):
                    yield Problem("stage", f"stage {k + 1} must begin and end above stage {k}")
                elif one[1] - two[0] < 2 * band * (1 - 1e-9):
                    yield Problem(
                        "stage",
                        f"stages {k} and {k + 1} overlap by {one[1] - two[0]:.4g} kg; twice the estimator's band_kg,"
                        f" {2 * band:.4g} kg, is needed",
                    )
        counts = {len(_field(stage, "section") or ()) for stage in stages} if isinstance(stages, tuple) else set()
        if len(counts) > 1:
            yield Problem("stage", "all stages must have the same number of sections")


def _field(record: Any, name: str) -> Any:
    return record.get(name) if isinstance(record, Mapping) else getattr(record, name, None)


class ScheduledController(Record):
    """The controller of a prototype with several laws; its other tables are those of any prototype."""

    controller: Scheduled


@dataclass(frozen=True)
class ScheduledRig:
    """A prototype with a scheduled controller.

    Attributes:
        prototype: everything else of it; its own controller is None.
        schedule: the controller.
    """

    prototype: Prototype
    schedule: Scheduled

    @property
    def stages(self) -> tuple[Prototype, ...]:
        """A prototype for every stage, with its law and its payloads."""
        return tuple(
            self.prototype.but(
                name=f"{shorter(self.prototype.name)}, stage {k}",
                controller=stage.law,
                payload=self.prototype.payload.but(outer_end_mass_kg=stage.outer_end_mass_kg),
                guarantee=None,
            )
            for k, stage in enumerate(self.schedule.stage, start=1)
        )


def is_scheduled(path: str | Path) -> bool:
    """Whether a prototype file carries a scheduled controller.

    Raises:
        InputError: where it cannot be read.
    """
    law = records.read_table(path).get("controller")
    return isinstance(law, dict) and law.get("kind") == KIND


def read_scheduled(path: str | Path) -> ScheduledRig:
    """Read a prototype with a scheduled controller.

    Raises:
        InputError: naming file, key and reason of everything wrong with it.
    """
    table = records.read_table(path)
    problems: list[Problem] = []
    found: ScheduledController | None = None
    rig: Prototype | None = None
    try:
        found = records.parse(ScheduledController, {"controller": table.get("controller", {})}, path)
    except InputError as error:
        problems += error.problems
    try:
        rig = records.parse(Prototype, {key: value for key, value in table.items() if key != "controller"}, path)
    except InputError as error:
        problems += error.problems
    if found is not None and rig is not None:
        asked, covered = rig.payload.outer_end_mass_kg, found.controller.outer_end_mass_kg
        if asked is not None and not covered[0] <= asked[0] <= asked[1] <= covered[1]:
            words = f"[{asked[0]:g}, {asked[1]:g}] is not covered by the stages, {covered[0]:g} to {covered[1]:g} kg"
            problems.append(Problem("payload.outer_end_mass_kg", words))
    if problems or found is None or rig is None:
        raise InputError(path, problems)
    return ScheduledRig(rig, found.controller)


def write_scheduled(rig: ScheduledRig, path: str | Path) -> None:
    """Write a prototype.toml from which `read_scheduled` gives back an equal record."""
    write_whole(path, scheduled_toml(rig))


def scheduled_toml(rig: ScheduledRig) -> str:
    """Its text."""
    head = records.to_toml(rig.prototype.but(controller=None))
    return head + "\n" + records.to_toml(ScheduledController(controller=rig.schedule))


def law_words(stages: Sequence[Stage]) -> list[str]:
    """The law of every stage in a few words."""
    words = []
    for stage in stages:
        sections = f", {len(stage.section)} sections" if stage.section else ""
        words.append(f"{stage.gain_A_per_V:g} A/V, {stage.pole_Hz:g}/{stage.zero_Hz:g} Hz{sections}")
    return words
