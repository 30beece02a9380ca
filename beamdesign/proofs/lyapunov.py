"""What is proved of a loop whose payload, or stage, changes in motion: at any rate, at a bounded rate, in sudden steps.

A law that stays is the case of one stage.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import inf, isinf
from typing import Any

from flint import fmpq, fmpq_mat

from beamdesign.polynomial import exact, nearest, text
from beamdesign.progress import Progress, silent
from beamdesign.proofs.courses import DEGREES, any_change, bounded_rate, stage_change, sudden_change
from beamdesign.proofs.decrease import ZERO, Joining, Sought
from beamdesign.proofs.lmi import Course, Status
from beamdesign.proofs.mass_family import Families, Frozen, frozen
from beamdesign.proofs.writer import Tables, certificate, stated, texts
from beamdesign.prototype import Prototype
from beamdesign.quantities import mass_range_text, rigs_in_words
from beamdesign.result import Result, finite, picked

CHANGES_NAME = "stages.certificate.toml"
"""File of the proof of changes between the laws of a controller, beside its prototype."""

JOININGS: tuple[Joining, ...] = ("matched", "from_rest")


@dataclass(frozen=True, repr=False)
class Switching(Result):
    """Everything that was proved, or not, about a mass m(t) that moves within a range, and a stage that changes.

    Each claim is about one kind of course of m(t); a course that mixes them, such as sudden changes between ramps, is
    covered by `any_change` alone, and only where payload is matched in velocity. All but `stages` hold whichever stage
    acts when.

    Attributes:
        outer_end_mass_kg: the range.
        frozen: every mass and stage that stays, exactly.
        stages: changes of stage at any mass that stays; of a law of one stage, which never changes, with no function.
        any_change: however fast, payload matched in velocity.
        rates: bounded |dm/dt|, one for each way of joining; none where the stage may not change at any time.
        sudden: sudden changes with time between them, likewise.
        wanted_kg_per_s: the rate that was asked for, None where the largest was searched for.
        dwell_s: least time between changes of stage that is kept.
        families: the loop it is about, with each stage.
    """

    outer_end_mass_kg: tuple[float, float]
    frozen: Frozen
    stages: Course
    any_change: Course
    rates: tuple[Course, ...]
    sudden: tuple[Course, ...]
    wanted_kg_per_s: float | None
    dwell_s: float
    families: Families

    @property
    def stable(self) -> bool:
        """Whether changes of stage are proved and a rate for both ways of joining: the one asked for, or else any.

        Where the stage changes, no rate has to be proved unless one was asked for.
        """
        rates = bool(self.rates) and all(rate.status == "proved" for rate in self.rates)
        optional = len(self.families) > 1 and self.wanted_kg_per_s is None
        return self.stages.suffices(self.dwell_s) and (rates or optional)

    @property
    def reason(self) -> str:
        """Why the answer is no, or not at any time, in words; empty where it is yes."""
        joined = (f"payload {r.joining.replace('_', ' ')}: {r.reason}" for r in self.rates if r.reason)
        return "; ".join(reason for reason in [self.stages.reason, self.rate_left_open, *joined] if reason)

    @property
    def rate_left_open(self) -> str:
        """Why nothing is said of a rate that was asked for, in words; empty where something is."""
        if self.wanted_kg_per_s is None or self.rates:
            return ""
        rate = f"|dm/dt| up to {self.wanted_kg_per_s:g} kg/s"
        return f"{rate}: a payload that changes is looked at only where the stage may change at any time"

    @property
    def yes(self) -> bool:
        """As `stable`."""
        return self.stable

    def to_dict(self) -> dict[str, Any]:
        """What is proved while payload and stage change, for a JSON file."""
        cycle = self.any_change.counterexample
        turns = "outer_end_mass_kg time_s growth_per_cycle=factor proved"
        rates = "joining status reason rate_kg_per_s not_proved_at_kg_per_s=refused_kg_per_s"
        return finite({
            **picked(self, "stable reason outer_end_mass_kg rate_kg_per_s=wanted_kg_per_s"),
            "stable_while_the_mass_stays": self.frozen.stable,
            "at_any_time": self.stages.kind == "any_time",
            "stage_change": picked(self.stages, "status reason dwell_s"),
            "any_change": {
                **picked(self.any_change, "status reason joining proved_up_to_kg"),
                "counterexample": cycle and {"stages": [k + 1 for k in cycle.stages], **picked(cycle, turns)},
            },
            "bounded_rate": [picked(one, rates) | {"unlimited": one.rate_kg_per_s == inf} for one in self.rates],
            "sudden_change": [picked(one, "joining status reason dwell_s decay_per_s") for one in self.sudden],
        })  # fmt: skip


def switching(
    families: Families,
    low_kg: float,
    high_kg: float,
    wanted_kg_per_s: float | None = None,
    dwell_s: float = 0.0,
    update: Progress = silent,
) -> Switching:
    """Prove what can be proved of a closed loop while its outer end mass changes between two masses, and its stage.

    Args:
        families: the loop with each stage, in the same states; see `stage_families`.
        low_kg: least mass.
        high_kg: largest mass, above `low_kg`.
        wanted_kg_per_s: a rate |dm/dt| to prove; the largest is searched for where it is left out.
        dwell_s: least time between changes of stage that is kept.
        update: told of progress.

    Raises:
        ValueError: for a range that does not hold two masses, or a rate that is not positive.
    """
    if not low_kg < high_kg:
        raise ValueError(f"the mass cannot change between {low_kg:g} and {high_kg:g} kg")
    if wanted_kg_per_s is not None and not 0 < wanted_kg_per_s < inf:
        raise ValueError(f"the rate must be positive and finite, is {wanted_kg_per_s}")
    low, high = exact(low_kg), exact(high_kg)
    sought, stays = Sought(families, low, high), frozen(families, low, high)

    def result(stages: Course, common: Course, rates: Sequence[Course], sudden: Sequence[Course]) -> Switching:
        found = (stays, stages, common, tuple(rates), tuple(sudden))
        return Switching((low_kg, high_kg), *found, wanted_kg_per_s, dwell_s, families)

    if not stays.stable:  # a mass that stays is a course of m(t) too: no claim about all courses holds
        refuted = Course("refuted", f"not stable even for a mass that stays: {stays.reason}")
        stages = refuted if len(families) > 1 else replace(refuted, reason="")
        each = [replace(refuted, joining=joining) for joining in JOININGS]
        return result(stages, refuted, each, each)
    if len(families) > 1:
        update(0.05, "changes of stage")
    stages, coordinates = stage_change(sought)
    if stages.kind != "any_time":
        cycle = stages.counterexample
        status: Status = "refuted" if cycle is not None and cycle.proved else "undecided"
        return result(stages, Course(status, stages.reason, counterexample=cycle), [], [])
    update(0.15, "any change")
    common, onward = any_change(sought)
    if len(families) == 1 or common.status == "proved":
        coordinates = onward
    degrees = [d for d in DEGREES if d >= len(stages.coefficients) - 1]
    wanted = None if wanted_kg_per_s is None else exact(wanted_kg_per_s)
    rates, sudden = [], []
    for share, joining in zip((0.3, 0.65), JOININGS, strict=True):
        if joining == "matched" and common.status == "proved":
            rates.append(Course("proved", "", joining, common.functions, rate_kg_per_s=inf))
            sudden.append(Course("proved", "", joining, common.functions, dwell_s=ZERO, factor=fmpq(1)))
            continue

        def part(fraction: float, text: str = "", share: float = share) -> None:
            update(share + 0.3 * fraction, text)

        joined = replace(sought, joining=joining)
        rates.append(bounded_rate(joined, coordinates, wanted, update=part, degrees=degrees))
        update(share + 0.3, f"sudden changes, mass {joining.replace('_', ' ')}")
        sudden.append(sudden_change(joined, coordinates))
    return result(stages, common, rates, sudden)


def describe(found: Switching) -> list[str]:
    """The result in words, one line for each statement."""
    asked, several = mass_range_text(found.outer_end_mass_kg), len(found.families) > 1
    if not found.frozen.stable:
        return [f"REFUTED: not every mass from {asked} is stable even if it stays: {found.frozen.reason}"]
    lines = [f"proved: stable for every mass from {asked} that stays"]
    if several:
        lines = [f"{lines[0]}, with every stage that stays", *_of_stages(found.stages, found.dwell_s)]
    lines += _of_payload(found)
    time = ", each law in continuous time" if several else ""
    return [*lines, f"all of it about the linear loop of {rigs_in_words(0.0)}{time}"]


def _of_stages(stages: Course, dwell_s: float) -> list[str]:
    """Changes of stage in words."""
    if stages.kind == "any_time":
        return ["proved: stable whichever stage acts when, at every payload that stays; what follows holds likewise"]
    if stages.dwell_s is None:
        return [f"{_head(stages.status)}: changes of stage: {stages.reason}"]
    kept = "kept by the schedule" if stages.suffices(dwell_s) else f"NOT kept by its dwell_s of {dwell_s:g}"
    return [
        f"proved: stable for changes of stage at least {nearest(stages.dwell_s):.4g} s apart on average, at every"
        f" payload that stays, which is {kept}",
        f"not at any time: {stages.reason}",
    ]


def _of_payload(found: Switching) -> list[str]:
    """Changes of the payload in words; where the stage may not change at any time, that a rate is left open."""
    if found.stages.kind != "any_time":
        return [] if found.wanted_kg_per_s is None else [f"UNDECIDED: {found.rate_left_open}"]
    common, wanted = found.any_change, found.wanted_kg_per_s
    matched = "however fast the mass changes, payload joining and leaving with the tip's velocity"
    lines = [_line(common, f"stable {matched}", matched)]
    if common.status != "proved" and common.proved_up_to_kg is not None:
        part = found.outer_end_mass_kg[0], common.proved_up_to_kg
        lines.append(f"proved: the same from {mass_range_text(part)}")
    for rate in found.rates:
        if rate.rate_kg_per_s != inf:
            asked = "any rate" if wanted is None else f"|dm/dt| up to {wanted:g} kg/s"
            reached = f"stable for |dm/dt| up to {rate.rate_kg_per_s or 0:.15g} kg/s"
            lines.append(_line(rate, *(f"{words}, {_WORDS[rate.joining]}" for words in (reached, asked))))
    for sudden in found.sudden:
        if sudden.dwell_s != 0:
            dwell = nearest(sudden.dwell_s or ZERO)
            words = f"stable for sudden changes at least {dwell:.4g} s apart on average"
            lines.append(_line(sudden, *(f"{one}, {_WORDS[sudden.joining]}" for one in (words, "sudden changes"))))
    return lines


def _line(course: Course, proved: str, asked: str) -> str:
    """What is proved, or what was asked and why it is not."""
    return f"proved: {proved}" if course.status == "proved" else f"{_head(course.status)}: {asked}: {course.reason}"


_WORDS = {
    "matched": "payload joining with the tip's velocity",
    "from_rest": "payload joining at rest or with any part of the tip's velocity",
}


def _head(status: Status) -> str:
    return {"unverified": "UNVERIFIED, so not known to be stable"}.get(status, status.upper())


# The certificate, as tables of texts.


KIND = "beamdesign.stages"
_DWELL = "dwell_s factor decay_per_s"


def stages_certificate(prototype: Prototype, found: Switching, summary: str) -> str:
    """Write the certificate: claims with their Lyapunov functions, and counterexamples, all in exact decimals.

    Args:
        prototype: that it is about, with one law or several that act in turn.
        found: what was proved and refuted of it.
        summary: the result in words, put on top as a comment.
    """
    shared = "which all stages share and none resets" if len(found.families) > 1 else "of which only the velocity jumps"
    notes = {
        "claim": "V = x' P(m) x falls. P lists the matrix coefficients of m^0, m^1, ... by the rows of their lower\n"
        f"# triangles, for the state ({', '.join(found.families[0].states)}),\n# {shared}.",
        "counterexample": "An unstable loop that stays; or two in turn, for which |trace M^cycles| exceeds the order of"
        " M, the\n# transition matrix of one cycle.",
    }
    body = {"claim": list(_claims(found)), "counterexample": list(_counterexamples(found))}
    body = {key: entries for key, entries in body.items() if entries}
    masses = {"outer_end_mass_kg": stated(found.outer_end_mass_kg)}
    return certificate(KIND, prototype, masses | body, summary, notes=notes)


def _claims(found: Switching) -> Iterator[Tables]:
    low, high = map(exact, found.outer_end_mass_kg)
    stages, common = found.stages, found.any_change
    if stages.kind == "any_time" and stages.functions:
        yield _claim("stage_change", low, high) | _function(stages.coefficients)
    if stages.kind == "dwell":
        claim = _claim("stage_dwell", low, high, **picked(stages, _DWELL))
        yield claim | {"stage": [_function(p) for p in stages.functions]}
    if common.proved_up_to_kg is not None:
        yield _claim("any_change", low, exact(common.proved_up_to_kg)) | _function(common.coefficients)
    for rate in found.rates:
        if rate.status == "proved" and rate.rate_kg_per_s is not None and not isinf(rate.rate_kg_per_s):
            claim = _claim("payload_rate", low, high, rate_kg_per_s=exact(rate.rate_kg_per_s))
            yield claim | {"joining": rate.joining} | _function(rate.coefficients)
    for sudden in found.sudden:
        if sudden.kind == "dwell":
            claim = _claim("payload_jumps", low, high, **picked(sudden, _DWELL))
            yield claim | {"joining": sudden.joining} | _function(sudden.coefficients)


def _claim(kind: str, low: fmpq, high: fmpq, **figures: fmpq) -> Tables:
    named = {name: text(value) for name, value in figures.items()}
    return {"kind": kind, "outer_end_mass_kg": texts((low, high))} | named


def _function(coefficients: Sequence[fmpq_mat]) -> Tables:
    """Matrices by the rows of their lower triangles."""
    return {"P": [[texts([p[i, j] for j in range(i + 1)]) for i in range(p.nrows())] for p in coefficients]}


def _counterexamples(found: Switching) -> Iterator[Tables]:
    if found.frozen.unstable_at is not None:
        yield {"kind": "frozen", "stage": found.frozen.stage + 1, "outer_end_mass_kg": text(found.frozen.unstable_at)}
    cycle = found.any_change.counterexample
    if cycle is not None and cycle.proved:
        yield {
            "kind": "cycle",
            "stages": [k + 1 for k in cycle.stages],
            "outer_end_mass_kg": stated(cycle.outer_end_mass_kg),
            "time_s": stated(cycle.time_s),
            "cycles": cycle.cycles,
        }
