"""The tasks that a sweep can put its cases through. Their engines are loaded only by the process that computes."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field

from beamdesign.json_text import picked
from beamdesign.problem import DesignProblem, Sought, Tuned
from beamdesign.prototype import Prototype
from beamdesign.records import NonNegative, Positive, Problem, Record, numbers

if TYPE_CHECKING:
    from beamdesign.synthesis.refinement import Proved


@dataclass(frozen=True)
class Answer:
    """Outputs of one case.

    Attributes:
        outputs: columns of the table by name, with the unit in the name: numbers, texts, yes or no, or lists of them.
        details: what `study why` tells beyond: checks, shadow prices, certificates' words; plain values.
        reason: why the answer is no; empty where it is yes.
    """

    outputs: dict[str, Any]
    details: dict[str, Any] = field(default_factory=dict)
    reason: str = ""


def of_all(answers: Mapping[str, Answer]) -> Answer:
    """The answer of the law that governs, with the outputs of all by their names in the details.

    That is the first whose answer is no, else the one of the least bandwidth. The only one stays as it is.
    """
    worst = min(answers.values(), key=lambda one: (not one.reason, one.outputs.get("bandwidth_Hz") or 0.0))
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

    bandwidth_Hz: Annotated[Positive, Field(description="bandwidth to guarantee")]


class RemediesOptions(Record):
    """Options of `remedy`."""

    remedy: Annotated[int, Field(ge=0, le=4, description="0 for the untouched loop, 1 to 4 in the paper's order")]
    added_mass_kg: NonNegative = 4.5


class RangeOptions(Record):
    """Options of tasks that look at masses on the outer tip beyond those of the payload."""

    from_kg: NonNegative = 0.0
    to_kg: Positive = 20.0

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """The range holds more than one mass."""
        defaults = {name: field.default for name, field in cls.model_fields.items()}
        ends = numbers(defaults | dict(table), "from_kg", "to_kg")
        if ends and ends[0] >= ends[1]:
            yield Problem("from_kg", f"{ends[0]:g} is not below to_kg, {ends[1]:g}")


class AtMassOptions(Record):
    """Options of tasks at one mass on the outer tip."""

    outer_end_mass_kg: NonNegative = 0.0


class SimToRealOptions(Record):
    """Options of `sim_to_real`."""

    effect: Annotated[
        str, Field(description="of the virtual rig: a name of beamdesign.validation.truth.effects, or none")
    ]
    severity: Annotated[Positive, Field(description="of the effect")] = 1.0
    duration_s: Annotated[Positive, Field(ge=0.5, le=8, description="of each of four records")] = 1.5
    seed: Annotated[int, Field(ge=0, description="of tolerances, effect and signals")] = 0


class ArmOptions(Record):
    """Options of `arm`."""

    force_N: Annotated[
        Positive | None, Field(description="downwards on the payload's centre; else its weight and largest_force_N")
    ] = None


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
        function: of this package, as MODULE:NAME; it takes record and options and gives an `Answer`.
        options: its options.
        summary: in words.
        columns: every output that it can give, with what it holds; a case may lack some, or hold none there.
        needs: keys of `NEEDED` that it does not do without.
    """

    function: str
    options: type[Record]
    summary: str
    columns: Mapping[str, Kind]
    needs: tuple[str, ...] = ()

    @property
    def place(self) -> str:
        """Where its function stands, as `code_digest` takes it."""
        return f"{__name__}.{self.function}"

    @property
    def record(self) -> type[DesignProblem] | type[Prototype]:
        """Type of the base document."""
        return DesignProblem if self.function.startswith("of_problems:") else Prototype

    def lacks(self, record: Record) -> Iterator[Problem]:
        """What this task needs and a record has not."""
        for key in self.needs:
            if attrgetter(key)(record) is None:
                yield Problem(key, NEEDED[key])


def payload_range(record: DesignProblem | Prototype) -> tuple[float, float]:
    """The range of outer end mass that a record states, kg."""
    masses = record.payload.outer_end_mass_kg
    assert masses is not None  # a problem is validated to have it, and what a task needs is there before it computes
    return masses


def _columns(numbers: str, yes_or_no: str = "", text: str = "", lists: str = "") -> dict[str, Kind]:
    """Columns by what they hold; of names as `picked` takes them."""
    kinds: dict[Kind, str] = {"numbers": numbers, "yes or no": yes_or_no, "text": text, "lists": lists}
    return {word.partition("=")[0]: kind for kind, words in kinds.items() for word in words.split()}


_PRICES = """price_tip_force_kg_per_percent price_safety_strength_kg_per_percent
    price_safety_local_buckling_kg_per_percent price_clearance_assembly_kg_per_mm price_clearance_under_load_kg_per_mm
    price_least_wall_kg_per_mm price_largest_width_kg_per_mm price_width_to_wall_at_most_kg_per_percent"""
TUBES = "outer_width_m=outer.width_m outer_wall_m=outer.wall_m inner_width_m=inner.width_m inner_wall_m=inner.wall_m"
SIZED = f"beam_mass_kg {TUBES}"
POINT = f"moving_mass_kg beam_mass_kg {TUBES}"
REMEDY = f"bandwidth_Hz peak_sensitivity added_mass_kg inner_end_mass_kg {TUBES}"
PROVED = "bandwidth_Hz peak_sensitivity inner_end_mass_kg gain_A_per_V=controller.gain_A_per_V"
ERRORS = "twist_rad about_y_rad about_z_rad"
"""Columns, each with where it stands in the record that a task's engine gives (see `json_text.picked`)."""
_SIZES = f"{SIZED} free_beam_mass_kg price_of_rounding_kg {_PRICES}"
_LAG = "pole_Hz zero_Hz"
_SECTIONS = " ".join(
    f"section_{k}_{end}_{figure}" for k in (1, 2, 3) for end in ("zero", "pole") for figure in ("Hz", "damping_ratio")
)
_FORCES = " ".join(f"load_at_{f}_Hz_N displacement_at_{f}_Hz_m" for f in (1, 10, 100))
_CROSSINGS = "crossings_kg crossing_frequencies_Hz"
_LAW, _RANGE = "controller", "payload.outer_end_mass_kg"

TASKS = {
    "run": Task("of_problems:run", NoOptions, "sections, controller and end mass, certified",
        _columns(f"{_SIZES} {PROVED} {_LAG} {_SECTIONS} moving_mass_kg", text="governing certificate_sha256")),
    "size": Task("of_problems:size", NoOptions, "sections of least mass, with checks and shadow prices",
        _columns(_SIZES, text="governing")),
    "codesign": Task("of_problems:codesign", CodesignOptions, "least moving mass for a bandwidth",
        _columns(f"{POINT} {PROVED} {_LAG}", text="governing")),
    "remedy": Task("of_problems:remedy", RemediesOptions, "one of the paper's remedies, optimised and proved",
        _columns(REMEDY, text="remedy", lists="gain_A_per_V pole_Hz zero_Hz")),
    "tune": Task("of_prototypes:tune", TuneOptions, "controller and inner end mass, proved",
        _columns(f"{PROVED} {_LAG} {_SECTIONS}"), (_RANGE,)),
    "certify": Task("of_prototypes:certify", CertifyOptions, "what is proved over the payload range",
        _columns("bandwidth_Hz peak_sensitivity stable_share unstable_below_kg unstable_above_kg", "stable",
            lists=f"stable_ranges_kg {_CROSSINGS}"), (_LAW, _RANGE)),
    "stable_masses": Task("of_prototypes:stable_masses", RangeOptions, "exact stable ranges and crossings",
        _columns("", lists=f"stable_from_kg stable_to_kg {_CROSSINGS}"), (_LAW,)),
    "lag_breaks": Task("of_prototypes:lag_breaks", NoOptions, "exact stable zero frequencies of the lag",
        _columns("", "own_zero_stable", lists="stable_zero_from_Hz stable_zero_to_Hz"), (_LAW, _RANGE)),
    "robust": Task("of_prototypes:robust", RangeOptions, "bandwidth and longest stable range, for tolerances",
        _columns("bandwidth_Hz peak_sensitivity stable_from_kg stable_to_kg stable_width_kg", "stable"),
        (_LAW, _RANGE)),
    "sim_to_real": Task("sim_to_real:sim_to_real", SimToRealOptions, "design, virtual rig, diagnosis, redesign",
        _columns("believed_bandwidth_Hz believed_design_gain_margin gap_before gap_after gap_closed"
            " redesigned_bandwidth_Hz redesign_gain_margin", "believed_design_runs named_rightly redesign_runs",
            "verdict", "named"), (_RANGE,)),
    "at_mass": Task("of_prototypes:at_mass", AtMassOptions, "margins and figures of the loop at one mass",
        _columns("critical_gain_A_per_V critical_frequency_Hz bandwidth_Hz peak_sensitivity gain_margin"
            " phase_margin_deg static_compliance_m_per_N", "stable"), (_LAW,)),
    "arm": Task("of_prototypes:arm", ArmOptions, "both planes with torsion: proof, and what error remains",
        _columns("force_N error_alone_m error_m error_by_tip_m error_by_turning_m error_by_twist_m"
            f" {ERRORS} torsion_tip_held_Hz peak_sensitivity tip_bandwidth_Hz load_bandwidth_Hz",
            "stable"), (_LAW, _RANGE)),
    "limits": Task("of_prototypes:limits", AtMassOptions, "what actuator and sensor can do at one mass",
        _columns(f"{_FORCES} static_error_m_per_N",
            text="governing_at_1_Hz governing_at_10_Hz governing_at_100_Hz"), (_LAW,)),
}  # fmt: skip


def proved_outputs(best: "Proved") -> dict[str, Any]:
    """Columns of a proved loop."""
    law = best.controller
    breaks = {} if law.lag is None else picked(law.lag, "pole_Hz zero_Hz")
    for k, section in enumerate(law.sections, start=1):
        breaks |= {f"section_{k}_{name}": value for name, value in section.model_dump().items()}
    return picked(best, PROVED) | breaks
