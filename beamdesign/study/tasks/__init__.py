"""The tasks that a sweep can put its cases through. Their engines are loaded only by the process that computes."""

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from beamdesign.problem import DesignProblem
from beamdesign.prototype import Prototype
from beamdesign.records import NonNegative, Positive, Record


class NoOptions(Record):
    """A task without options of its own."""


class TuneOptions(Record):
    """Options of `tune`."""

    controller: Literal["lag", "proportional", "structured"] = "lag"
    largest_inner_end_mass_kg: NonNegative = 6.0
    sections: Annotated[int, Field(ge=1, le=3, description="second-order sections of a structured controller")] = 3


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


class AtMassOptions(Record):
    """Options of tasks at one mass on the outer tip."""

    outer_end_mass_kg: NonNegative = 0.0


class SimToRealOptions(Record):
    """Options of `sim_to_real`."""

    effect: Annotated[str, Field(description="of the virtual rig: a name of beamdesign.gap.truth.effects, or none")]
    severity: Annotated[Positive, Field(description="of the effect")] = 1.0
    duration_s: Annotated[Positive, Field(ge=0.5, le=8, description="of each of four records")] = 1.5
    seed: Annotated[int, Field(ge=0, description="of tolerances, effect and signals")] = 0


class ArmOptions(Record):
    """Options of `arm`."""

    force_N: Annotated[
        Positive | None, Field(description="downwards on the payload's centre; else its weight and largest_force_N")
    ] = None


@dataclass(frozen=True)
class Task:
    """A task.

    Attributes:
        module: with `compute(record, options) -> Answer`.
        of: what it works on.
        options: its options.
        summary: in words.
    """

    module: str
    of: Literal["problem", "prototype"]
    options: type[Record]
    summary: str

    @property
    def record(self) -> type[Record]:
        """Type of the base document."""
        return DesignProblem if self.of == "problem" else Prototype


_ROOM = "beamdesign.study.tasks"

TASKS = {
    "run": Task(f"{_ROOM}.run", "problem", NoOptions, "sections, controller and end mass, certified"),
    "size": Task(f"{_ROOM}.size", "problem", NoOptions, "sections of least mass, with checks and shadow prices"),
    "codesign": Task(f"{_ROOM}.codesign", "problem", CodesignOptions, "least moving mass for a bandwidth"),
    "remedy": Task(f"{_ROOM}.remedy", "problem", RemediesOptions, "one of the paper's remedies, optimised and proved"),
    "tune": Task(f"{_ROOM}.tune", "prototype", TuneOptions, "controller and inner end mass, proved"),
    "certify": Task(f"{_ROOM}.certify", "prototype", CertifyOptions, "what is proved over the payload range"),
    "stable_masses": Task(f"{_ROOM}.stable_masses", "prototype", RangeOptions, "exact stable ranges and crossings"),
    "lag_breaks": Task(f"{_ROOM}.lag_breaks", "prototype", NoOptions, "exact stable zero frequencies of the lag"),
    "robust": Task(f"{_ROOM}.robust", "prototype", RangeOptions, "bandwidth and longest stable range, for tolerances"),
    "sim_to_real": Task(
        f"{_ROOM}.sim_to_real", "prototype", SimToRealOptions, "design, virtual rig, diagnosis, redesign"
    ),
    "at_mass": Task(f"{_ROOM}.at_mass", "prototype", AtMassOptions, "margins and figures of the loop at one mass"),
    "arm": Task(f"{_ROOM}.arm", "prototype", ArmOptions, "both planes with torsion: proof, and what error remains"),
    "limits": Task(f"{_ROOM}.limits", "prototype", AtMassOptions, "what actuator and sensor can do at one mass"),
}
