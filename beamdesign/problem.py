"""The design problem of a study file: what is asked for, before any section or controller is chosen."""

from collections.abc import Iterator, Mapping
from math import log2
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, SerializeAsAny

from beamdesign import quantities as q
from beamdesign import records
from beamdesign.arguments import checked_range_kg, takes
from beamdesign.controllers import SENSORS, Sensed
from beamdesign.parameters import stated_or_typical
from beamdesign.plant.actuators import Actuator, WithActuator
from beamdesign.prototype import Beam, Goal, Payload, Prototype, Sensor, Servovalve, Supply, Tolerance
from beamdesign.records import Problem, Record, numbers, stated
from beamdesign.structure.materials import BEAMS, MATERIAL, MaterialByName, WithMaterials
from beamdesign.structure.section import Tube, stock_tubes
from beamdesign.structure.shapes import Clearance, Safety, Shaped, SizedFor, Sizes, beams_that_do_not_fit, tube_of


class Load(Record):
    """What the link has to carry."""

    tip_force_N: q.Force = Field(description="transverse force at the tip, beside the weight of payload and link")
    least_bandwidth_Hz: q.Bandwidth = Field(
        0.1, description="up to which it is to be held still; a load step is made good in a few seconds at 0.1 Hz"
    )


class BeamProblem(Shaped):
    """A beam whose section is still open; a given section is the fixed choice, or the one to compare with."""

    length_m: q.Length = Field(description="full length of the tube, clamp included")
    free_length_m: q.Length = Field(description="length from the clamp to the tip")
    material: MaterialByName = Field(description=MATERIAL)
    end_mass_kg: q.MassOrNone = Field(0.0, description="M_end of equation (5), always fixed to the tip")
    damping_ratio: q.StructuralDamping = Field(0.05, description="zeta of the bare beam")
    depth_over_width: q.DepthOverWidth | None = Field(
        None, description="of a rectangular tube: outside size along the load over that across it"
    )
    width_m: q.Width | None = Field(None, description="outside width of a given section")
    wall_m: q.Wall | None = Field(None, description="wall of a given section")

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """A given section is whole and possible; the free length lies within the length."""
        yield from super().relations(table)
        if (table.get("width_m") is None) != (table.get("wall_m") is None):
            yield Problem("", "width_m and wall_m go together: give both or neither")

    def sized(self, width: Any, wall: Any) -> Tube:
        """A tube of its shape, of a width and a wall in m; numbers, arrays or symbols."""
        tube = tube_of(dict(self) | {"width_m": 1.0, "wall_m": 0.01})
        assert tube is not None  # the record knows its shape
        return tube.at(width, wall)


class Sections(Sizes):
    """How the tubes are chosen, and what limits them."""

    choose: Literal["free", "stock", "fixed"] = Field(
        "stock", description="free sizes, stock sizes, or the sections given"
    )


_PUBLISHED_M, _PUBLISHED_KG_PER_M3 = 1.195, 2700.0
"""Free length and density of the outer beam of Zalucky and Hardt (1984)."""

Tuned = Literal["lag", "proportional", "structured", "lqg", "hinf", "scheduled"]
"""Kinds of controller that are tuned; of lqg and hinf an observer comes out, of scheduled a lag for each stage."""


if TYPE_CHECKING:
    Added = Literal["inner_displacement_m", "load_pressure_Pa", "screw_force_N"]
else:
    Added = Literal[SENSORS[1:]]


class Sought(Record):
    """What the tuner may use, whatever it is called where the kind of controller stands."""

    largest_inner_end_mass_kg: q.MassOrNone | None = Field(
        None,
        description="most mass the tuner may add inside; left out: 6 kg of a rig as heavy as the published one with"
        " payloads up to 6.8 kg, of a heavier or lighter one in proportion, to a power of two",
    )
    sections: int = Field(3, ge=1, le=3, description="second-order sections of a structured controller")
    stages: int = Field(3, ge=2, le=12, description="laws of a scheduled controller")
    added_sensors: tuple[Added, ...] = Field((), description="what lqg and hinf read beside the displacement")

    @property
    def sought(self) -> dict[str, Any]:
        """What `beamdesign.synthesis.tuning.tune` is asked for, beside rig, payloads and kind."""
        names = ("largest_inner_end_mass_kg", "sections", "stages")
        return {name: getattr(self, name) for name in names} | {"sensors": self.sensors}

    @property
    def sensors(self) -> tuple[Sensed, ...]:
        """All that it reads, in the order of a record."""
        return tuple(name for name in SENSORS if name == SENSORS[0] or name in self.added_sensors)

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """Only what is synthesised reads more than the displacement."""
        kind = table.get("kind", table.get("controller", "lag"))
        if kind == "compliance":
            yield Problem(
                "kind", "an end stiffness is given to a prototype that stands: `beamdesign stiffness` does so"
            )
        if table.get("added_sensors") and kind not in ("lqg", "hinf"):
            yield Problem("added_sensors", f"a {kind} controller reads the displacement alone; ask for lqg or hinf")


class ControllerKind(Sought):
    """Which controller the tuner is to find."""

    kind: Tuned = Field("lag", description="law that the tuner works with")

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """Nothing is asked for that the kind does not heed."""
        yield from super().relations(table)
        kind = table.get("kind", "lag")
        for name, of in (("sections", "structured"), ("stages", "scheduled")):
            if kind != of and table.get(name, usual := cls.model_fields[name].default) != usual:
                yield Problem(name, f"is for kind = {of!r}, and the kind is {kind!r}; leave it out or change the kind")


class DesignProblem(WithMaterials, WithActuator):
    """A study file: load, beams to size, hydraulics, and the guarantees asked for."""

    name: str = Field(min_length=1, description="what the design is called in tables and reports")
    load: Load
    sections: Sections = Sections()
    outer_beam: BeamProblem
    inner_beam: BeamProblem
    clearance: Clearance = Clearance()
    safety: Safety = Safety()
    actuator: SerializeAsAny[Actuator]
    servovalve: Servovalve | None = None
    sensor: Sensor
    controller: ControllerKind = ControllerKind()
    supply: Supply = Supply()
    payload: Payload
    goal: Goal = Goal()
    tolerance: Tolerance = Tolerance()

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """Given sections fit, fixed ones are given, an actuator has its tables, and there is a payload range."""
        yield from super().relations(table)
        yield from beams_that_do_not_fit(table)
        choose, payload = stated(table, "sections.choose", "stock"), table.get("payload")
        for name in BEAMS:
            ratio = numbers(table, f"{name}.depth_over_width")
            if ratio and choose == "stock" and not stock_tubes("rectangle", ratio[0]):
                known = ", ".join(sorted({f"{tube.depth_over_width:.4g}" for tube in stock_tubes("rectangle")}))
                words = f"no rectangular stock tube has {ratio[0]:g}, but {known}; or sections.choose = 'free'"
                yield Problem(f"{name}.depth_over_width", words)
        if choose == "fixed":
            for name in BEAMS:
                beam = table.get(name)
                if isinstance(beam, Mapping) and (beam.get("width_m") is None or beam.get("wall_m") is None):
                    yield Problem(name, "sections.choose is 'fixed', so width_m and wall_m are needed")
        if isinstance(payload, Mapping) and payload.get("outer_end_mass_kg") is None:
            yield Problem("payload.outer_end_mass_kg", "missing: the range [least, most] of mass on the outer tip")

    @property
    def beams(self) -> tuple[BeamProblem, BeamProblem]:
        """The outer and the inner one."""
        return self.outer_beam, self.inner_beam

    @property
    def given(self) -> tuple[Tube, Tube] | None:
        """The sections of the outer and the inner beam, m; None unless both are given."""
        outer, inner = self.outer_beam.tube, self.inner_beam.tube
        return None if outer is None or inner is None else (outer, inner)

    @property
    def length_unit_m(self) -> float:
        """How many times as long as that of the published link its outer beam is, to a power of two."""
        return float(2.0 ** round(log2(self.outer_beam.free_length_m / _PUBLISHED_M)))

    @property
    def mass_unit_kg(self) -> float:
        """How many times as heavy as that its beams are, likewise, if they are of its proportions."""
        denser = self.outer_beam.material.density_kg_per_m3 / _PUBLISHED_KG_PER_M3
        return float(2.0 ** round(log2(denser * (self.outer_beam.free_length_m / _PUBLISHED_M) ** 3)))

    def asked_kg(self, given: object = None) -> tuple[float, float]:
        """The payloads (least, most) given, or else its own.

        Raises:
            InputError: for what is no pair of plausible masses.
            ValueError: for an empty range.
        """
        return checked_range_kg(self.name, self.payload.outer_end_mass_kg if given is None else given)

    def prototype(self, outer: Tube, inner: Tube) -> Prototype:
        """The prototype with the given sections and no controller yet.

        Its tolerances are the study's, typical ones where that states none.

        Its largest force is the load that it is designed for, where the payload states no other; and it says what else
        its sections were chosen to keep.
        """
        force = self.load.tip_force_N if self.payload.largest_force_N is None else self.payload.largest_force_N
        sizes = self.sections.model_dump(exclude={"choose"}) | dict(self.clearance) | dict(self.safety)
        same = ("name", "actuator", "servovalve", "sensor", "supply", "goal")
        return Prototype(
            **{name: getattr(self, name) for name in same},
            outer_beam=_with_section(self.outer_beam, outer),
            inner_beam=_with_section(self.inner_beam, inner),
            payload=self.payload.but(largest_force_N=force),
            sized_for=SizedFor(**sizes),
            tolerance=stated_or_typical(self.tolerance, type(self.actuator))[0],
        )


def _with_section(asked: BeamProblem, tube: Tube) -> Beam:
    same = {key: value for key, value in dict(asked).items() if key in Beam.model_fields}
    return Beam.model_validate(same | {"shape": tube.shape} | tube.sizes)


@takes()
def read_problem(path: str | Path) -> DesignProblem:
    """Read a study file.

    Raises:
        InputError: naming file, key and reason of everything wrong with it.
    """
    return records.read(DesignProblem, path)
