"""One case of a sweep: its inputs, the task that it is put through, and the address under which its result is kept.

Engines of tasks are loaded only by the process that computes.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, partial
from importlib.metadata import version
from math import inf
from operator import attrgetter
from typing import Any, Literal

from pydantic import Field

from beamdesign import records
from beamdesign.code_digest import code_digest
from beamdesign.problem import DesignProblem, Sought, Tuned
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, NonNegative, Positive, Problem, Record, numbers
from beamdesign.result import finite, picked
from beamdesign.synthesis import POINT, PROVED, REMEDY, SIZED


@dataclass(frozen=True)
class Answer:
    """Outputs of one case.

    Attributes:
        outputs: columns of the table by name, with the unit in the name: numbers, texts, yes or no, or lists of them.
        details: what `study why` tells beyond: checks, shadow prices, certificates' words; plain values and records.
        reason: why the answer is no; empty where it is yes.
    """

    outputs: dict[str, Any]
    details: dict[str, Any] = field(default_factory=dict)
    reason: str = ""


def of_all(answers: Mapping[str, Answer], governs: str = "bandwidth_Hz") -> Answer:
    """The answer of the law that governs, with the outputs of all by their names in the details.

    That is the first whose answer is no, else the one of the least of an output, or of the largest behind a minus. The
    only one stays as it is.
    """
    output, sign = governs.removeprefix("-"), -1.0 if governs[0] == "-" else 1.0
    worst = min(answers.values(), key=lambda one: (not one.reason, sign * (one.outputs.get(output) or 0.0)))
    if len(answers) == 1:
        return worst
    return replace(worst, details=worst.details | {"stages": {name: one.outputs for name, one in answers.items()}})


class NoOptions(Record):
    """A task without options of its own."""


class TuneOptions(Sought):
    """Options of `tune`."""

    controller: Tuned = "lag"


class CertifyOptions(Record):
    """Options of `certify`: claims to decide, beside the figures that are guaranteed."""

    bandwidth_Hz: Positive | None = None
    peak_sensitivity: Positive | None = None


class CodesignOptions(Record):
    """Options of `codesign`."""

    bandwidth_Hz: Positive = Field(description="bandwidth to guarantee")


class RemediesOptions(Record):
    """Options of `remedy`."""

    remedy: int = Field(ge=0, le=4, description="0 for the untouched loop, 1 to 4 in the paper's order")
    added_mass_kg: NonNegative = 4.5


class RangeOptions(Record):
    """Options of tasks that look at masses on the outer tip beyond those of the payload."""

    from_kg: NonNegative = 0.0
    to_kg: Positive = 20.0

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """The range holds more than one mass."""
        ends = numbers(cls.whole(table), "from_kg", "to_kg")
        if ends and ends[0] >= ends[1]:
            yield Problem("from_kg", f"{ends[0]:g} is not below to_kg, {ends[1]:g}")


class AtMassOptions(Record):
    """Options of tasks at one mass on the outer tip."""

    outer_end_mass_kg: NonNegative = 0.0


class LimitsOptions(Record):
    """Options of `limits`."""

    outer_end_mass_kg: NonNegative | None = Field(
        None, description="on the outer tip; the prototype's largest payload by default"
    )


class SimToRealOptions(Record):
    """Options of `sim_to_real`."""

    effect: str = Field(description="of the virtual rig: a name of beamdesign.validation.truth.effects, or none")
    severity: Positive = Field(1.0, description="of the effect")
    duration_s: Positive = Field(1.5, ge=0.5, le=8, description="of each of four records")
    seed: int = Field(0, ge=0, description="of tolerances, effect and signals")


class ArmOptions(Record):
    """Options of `arm`."""

    force_N: Positive | None = Field(
        None, description="downwards on the payload's centre; else its weight and largest_force_N"
    )


Kind = Literal["numbers", "yes or no", "text", "lists"]
"""What a column holds."""

NEEDED = {
    "controller": "missing; write it in the base file or vary it",
    "payload.outer_end_mass_kg": "missing: the range [least, most]",
}
"""What of a prototype only some tasks need, and what to say where it is not there."""


@dataclass(frozen=True)
class Task:
    """A task.

    Attributes:
        name: also of its function in `beamdesign.sweep.answers`, which takes record and options and gives an `Answer`.
        record: type of the base document.
        options: its options.
        columns: every output that it can give, with what it holds; a case may lack some, or hold none there.
        needs: keys of `NEEDED` that it does not do without.
        governs: by which output one of several laws governs, see `of_all`.
    """

    name: str
    record: type[DesignProblem] | type[Prototype]
    options: type[Record]
    columns: Mapping[str, Kind]
    needs: tuple[str, ...] = ()
    governs: str = "bandwidth_Hz"

    @property
    def place(self) -> str:
        """Where its function stands, as `code_digest` takes it."""
        return f"beamdesign.sweep.answers:{self.name}"

    def lacks(self, record: Record) -> Iterator[Problem]:
        """What this task needs and a record has not."""
        for key in self.needs:
            if attrgetter(key)(record) is None:
                yield Problem(key, NEEDED[key])


def _columns(numbers: str, yes_or_no: str = "", text: str = "", lists: str = "") -> dict[str, Kind]:
    """Columns by what they hold; of names as `picked` takes them."""
    kinds: dict[Kind, str] = {"numbers": numbers, "yes or no": yes_or_no, "text": text, "lists": lists}
    return {word.partition("=")[0]: kind for kind, words in kinds.items() for word in words.split()}


_PRICES = """price_tip_force_kg_per_percent price_safety_strength_kg_per_percent
    price_safety_local_buckling_kg_per_percent price_clearance_assembly_kg_per_mm price_clearance_under_load_kg_per_mm
    price_least_wall_kg_per_mm price_largest_width_kg_per_mm price_width_to_wall_at_most_kg_per_percent"""
ERRORS = "twist_rad about_y_rad about_z_rad"
_SIZES = f"{SIZED} free_beam_mass_kg price_of_rounding_kg {_PRICES}"
_LAG = "pole_Hz zero_Hz"
_SECTIONS = " ".join(
    f"section_{k}_{end}_{figure}" for k in (1, 2, 3) for end in ("zero", "pole") for figure in ("Hz", "damping_ratio")
)
_FORCES = " ".join(f"load_at_{f}_Hz_N displacement_at_{f}_Hz_m" for f in (1, 10, 100))
_CROSSINGS = "crossings_kg crossing_frequencies_Hz"
_LAW, _RANGE = "controller", "payload.outer_end_mass_kg"

_ROWS = (
    Task("run", DesignProblem, NoOptions,
        _columns(f"{_SIZES} {PROVED} {_LAG} {_SECTIONS} moving_mass_kg", text="governing certificate_sha256")),
    Task("size", DesignProblem, NoOptions, _columns(_SIZES, text="governing")),
    Task("codesign", DesignProblem, CodesignOptions, _columns(f"{POINT} {PROVED} {_LAG}", text="governing")),
    Task("remedy", DesignProblem, RemediesOptions,
        _columns(REMEDY, text="remedy", lists="gain_A_per_V pole_Hz zero_Hz")),
    Task("tune", Prototype, TuneOptions, _columns(f"{PROVED} {_LAG} {_SECTIONS}", "stable_between"), (_RANGE,)),
    Task("certify", Prototype, CertifyOptions,
        _columns("bandwidth_Hz peak_sensitivity stable_share unstable_below_kg unstable_above_kg",
            "stable stable_between", lists=f"stable_ranges_kg {_CROSSINGS}"), (_LAW, _RANGE)),
    Task("stable_masses", Prototype, RangeOptions,
        _columns("", "stable_between", lists=f"stable_from_kg stable_to_kg {_CROSSINGS}"), (_LAW,)),
    Task("lag_breaks", Prototype, NoOptions,
        _columns("", "own_zero_stable", lists="stable_zero_from_Hz stable_zero_to_Hz"), (_LAW, _RANGE)),
    Task("robust", Prototype, RangeOptions,
        _columns("bandwidth_Hz peak_sensitivity stable_from_kg stable_to_kg stable_width_kg", "stable"),
        (_LAW, _RANGE)),
    Task("sim_to_real", Prototype, SimToRealOptions,
        _columns("believed_bandwidth_Hz believed_design_gain_margin gap_before gap_after gap_closed"
            " redesigned_bandwidth_Hz redesign_gain_margin", "believed_design_runs named_rightly redesign_runs",
            "verdict", "named"), (_RANGE,)),
    Task("at_mass", Prototype, AtMassOptions,
        _columns("critical_gain_A_per_V critical_frequency_Hz bandwidth_Hz peak_sensitivity gain_margin"
            " phase_margin_deg static_compliance_m_per_N", "stable"), (_LAW,)),
    Task("arm", Prototype, ArmOptions,
        _columns("force_N error_alone_m error_m error_by_tip_m error_by_turning_m error_by_twist_m"
            f" {ERRORS} torsion_tip_held_Hz peak_sensitivity tip_bandwidth_Hz load_bandwidth_Hz", "stable"),
        (_LAW, _RANGE), "-error_m"),
    Task("limits", Prototype, LimitsOptions,
        _columns(f"{_FORCES} static_error_m_per_N",
            text="governing_at_1_Hz governing_at_10_Hz governing_at_100_Hz"), (_LAW,), "load_at_1_Hz_N"),
)  # fmt: skip
TASKS = {row.name: row for row in _ROWS}


Status = Literal["done", "no", "refused", "failed"]
"""The answer is yes; it is no, with its reason; the inputs are bad; the program failed."""


@dataclass(frozen=True)
class Case:
    """One case.

    Attributes:
        task: its name.
        document: study or prototype as tables, the varied values put in.
        options: of the task, likewise.
        varied: the varied values by key, for tables and comparisons.
        inputs_sha256: digest of task, document and options as the task reads them, defaults filled in.
        code_sha256: digest of the code that the task reaches.
        problems: with its inputs, as far as they are known without computing; such a case is refused.
    """

    task: str
    document: dict[str, Any]
    options: dict[str, Any]
    varied: dict[str, Any]
    inputs_sha256: str
    code_sha256: str
    problems: tuple[Problem, ...] = ()

    @property
    def address(self) -> str:
        """Name of its result: a digest of inputs and code."""
        return address_of(self.inputs_sha256, self.code_sha256)


def address_of(inputs_sha256: str, code_sha256: str) -> str:
    """Name of the result of inputs and code, by the digests of both."""
    return hashlib.sha256(f"{inputs_sha256} {code_sha256}".encode()).hexdigest()


def case(task: str, document: Mapping[str, Any], options: Mapping[str, Any], varied: Mapping[str, Any]) -> Case:
    """A case; inputs that no record accepts have an address too, since their refusal is a result."""
    document, options = dict(document), dict(options)
    plain, worded = finite, partial(finite, beyond=str)  # JSON has neither nan nor inf, and none is another input
    problems: tuple[Problem, ...] = ()
    try:
        read = [part.model_dump(mode="json") for part in parsed(task, document, options)]
    except InputError as error:
        plain, problems = worded, tuple(error.problems)
        read = [plain(document), plain(options)]
    inputs = hashlib.sha256(json.dumps([task, *read], sort_keys=True, ensure_ascii=False).encode()).hexdigest()
    code = code_digest(TASKS[task].place)
    return Case(task, plain(document), plain(options), worded(varied), inputs, code, problems)


def parsed(task: str, document: Mapping[str, Any], options: Mapping[str, Any]) -> tuple[Record, Record]:
    """The records that a task is given.

    Raises:
        InputError: with everything that is wrong with both, keys of the options under `options`.
    """
    asked, found, problems = TASKS[task], [], []
    for table, record, before in ((document, asked.record, ""), (options, asked.options, "options.")):
        try:
            found.append(records.parse(record, dict(table), task))
        except InputError as error:
            problems += [Problem(before + key, reason) for key, reason in error.problems]
    if not problems:
        problems += asked.lacks(found[0])
    if problems:
        raise InputError(task, problems)
    return found[0], found[1]


def in_words(problems: Iterable[Problem]) -> str:
    """Why a case is refused."""
    return "; ".join(f"{key}: {reason}" for key, reason in problems)


def kept(found: Case, status: str, answer: Answer, seconds: float) -> dict[str, Any]:
    """The record of a case as it is written to its file."""
    given = picked(found, "address inputs_sha256 code_sha256 task varied document options")
    outcome = {"status": status} | picked(answer, "reason outputs details")
    return given | finite(outcome) | {"seconds": round(seconds, 3), "libraries": libraries()}


NEARLY = 0.98
"""Share of its limit from which a check is said to bind."""


def governing(record: Mapping[str, Any]) -> dict[str, Any]:
    """What governs a case, from what its task has kept.

    Returns:
        the `record` as kept; structural `checks`, the most used first; `binding`, names of those that are used to at
        least `NEARLY`; `requirements` that are active at the optimum over free sizes; `shadow_prices`, kg per unit of
        each requirement there; and for a no `relaxations`, requirements of which easing one alone is enough. What a
        task does not keep is empty.
    """
    details = record["details"]
    checks = sorted(
        details.get("checks", []), key=lambda check: -inf if check["utilisation"] is None else -check["utilisation"]
    )
    return {
        "record": record,
        "checks": checks,
        "binding": [one["name"] for one in checks if one["utilisation"] is None or one["utilisation"] >= NEARLY],
        "requirements": details.get("active", []),
        "shadow_prices": details.get("shadow_prices", {}),
        "relaxations": details.get("relaxations", []),
    }


_LIBRARIES = ("casadi", "cvxpy", "numpy", "python-flint", "scipy")


@cache
def libraries() -> dict[str, str]:
    """Versions of the libraries that do the arithmetic; told with each result, not part of its address."""
    return {name: version(name) for name in _LIBRARIES}
