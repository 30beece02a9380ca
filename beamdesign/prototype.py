"""The prototype: one description of a rig, which every command takes and gives."""

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pydantic import Field, FiniteFloat, SerializeAsAny, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from beamdesign import quantities as q
from beamdesign import records
from beamdesign.arguments import checked_range_kg, takes
from beamdesign.controllers import Cascade, Controller, Scheduled
from beamdesign.files import read_bytes, write_whole
from beamdesign.plant.actuators import Actuator, ActuatorTolerance, WithActuator, deviation
from beamdesign.plant.actuators.servo_cylinder import Servovalve, Supply
from beamdesign.records import FileName, NonNegative, Positive, Problem, Record, numbers
from beamdesign.spelling import shorter
from beamdesign.structure.materials import MATERIAL, Material, MaterialByName, WithMaterials
from beamdesign.structure.section import Tube
from beamdesign.structure.shapes import Shaped, SizedFor, beams_that_do_not_fit

COMPLIANCE_LIMIT_M_PER_N = 5.71e-8
"""The paper's performance goal, -100 dB of inch per pound-force."""


class Beam(Shaped):
    """One cantilever: its geometry, its measured (lumped) figures, or both; where both stand the measured one wins."""

    stiffness_N_per_m: q.Stiffness | None = Field(None, description="tip stiffness K on the free length")
    effective_mass_kg: q.Mass | None = Field(
        None, description="lumped mass at the tip, equation (5), without payload or added end mass"
    )
    damping_ratio: q.StructuralDamping = Field(0.05, description="zeta of the bare beam; b = 2 zeta sqrt(K M)")
    width_m: q.Width | None = Field(
        None, description="outside width of the tube, across the load; diameter of a round one"
    )
    wall_m: q.Wall | None = Field(None, description="wall thickness of the tube")
    depth_m: q.Width | None = Field(None, description="outside size of a rectangular tube along the load")
    corner_radius_m: q.Gap = Field(0.0, description="outside corner radius; 0 is a sharp corner")
    length_m: q.Length | None = Field(None, description="full length of the tube, clamp included")
    free_length_m: q.Length | None = Field(None, description="length from the clamp to the tip")
    material: MaterialByName | None = Field(None, description=MATERIAL)
    end_mass_kg: q.MassOrNone = Field(
        0.0, description="M_end of equation (5): what is always fixed to the tip (actuator module)"
    )

    @property
    def geometry(self) -> tuple[Material, Tube, float] | None:
        """Material, section and free length (m), from which the lumped figures can be computed; None without one."""
        tube, length, alloy = self.tube, self.free_length_m, self.material
        return None if tube is None or length is None or alloy is None else (alloy, tube, length)

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """The tube is possible, and the lumped figures can be had."""
        yield from super().relations(table)
        lumped = ("stiffness_N_per_m", "effective_mass_kg")
        geometry = ("width_m", "wall_m", "free_length_m", "material")
        if any(table.get(k) is None for k in lumped) and any(table.get(k) is None for k in geometry):
            yield Problem("", f"needs {' and '.join(lumped)}, or the geometry: {', '.join(geometry)}")


class Sensor(Record):
    """Displacement sensor with its amplifier, and the low-pass filter that may follow it."""

    gain_V_per_m: q.SensorGain = Field(description="F, sensor and op-amp gain")
    filter_Hz: q.ComponentFrequency | None = Field(None, description="break frequency of a first-order low-pass filter")
    noise_V: q.Noise | None = Field(None, description="RMS of what the sensor gives when nothing moves")
    resolution_m: q.Resolution | None = Field(None, description="least displacement it tells")


class Compliance(Record):
    """What a compliant [controller] stands for: the servo's command moves by the force on the tip over a stiffness."""

    end_stiffness_N_per_m: q.Stiffness = Field(description="static stiffness F / x of the end, as commanded")
    force_filter_Hz: q.ComponentFrequency = Field(
        description="break frequency of the low-pass that the estimated force goes through"
    )
    servo: SerializeAsAny[Cascade] = Field(description="law that holds the tip at a command")


class Payload(Record):
    """Masses at the tips beyond the bare rig."""

    outer_end_mass_kg: tuple[q.MassOrNone, q.MassOrNone] | None = Field(
        None, description="range [least, most] of mass on the outer beam's tip"
    )
    inner_end_mass_kg: q.MassOrNone = Field(0.0, description="mass added to the inner beam's tip")
    largest_force_N: q.ForceOrNone | None = Field(
        None, description="steady force on the tip beside the payload's weight, for effects of the load"
    )

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """The range holds at least one mass."""
        if (pair := numbers(table, "outer_end_mass_kg", each=2)) and pair[0] > pair[1] >= 0:
            yield Problem("outer_end_mass_kg", f"empty mass range: {pair[0]} is above {pair[1]}; write [least, most]")


Point = tuple[q.Position, q.Position, q.Position]
"""Seen from the tip: along the beam and away from it (x), sideways (y), upwards (z)."""


class Arm(Record):
    """The link as an arm: where its load sits, torsion, and the compensator across the first.

    The first compensator acts in z, the second one in y, from one and the same inner beam.
    """

    offset_m: Point = Field(
        (0.0, 0.0, 0.0), description="payload's centre from the tip: along the beam, sideways, upwards"
    )
    tool_m: Point | None = Field(
        None, description="where the error counts, likewise; the payload's centre where absent"
    )
    sensor_m: Point | None = Field(
        None, description="where the servos measure, likewise; the tip, on the axis, where absent"
    )
    end_polar_inertia_kg_m2: q.PolarInertia = Field(
        0.0, description="of the end module about the beam's axis, without the tube"
    )
    payload_polar_inertia_kg_m2: q.PolarInertia = Field(
        0.0, description="of the payload about its own centre line along x, whatever its mass"
    )
    torsional_stiffness_N_m_per_rad: q.TorsionalStiffness | None = Field(
        None, description="of the outer beam from clamp to tip; else from its section and material"
    )
    torsional_damping_ratio: q.StructuralDamping | None = Field(
        None, description="zeta of torsion without payload; else that of the outer beam"
    )
    second_controller: SerializeAsAny[Controller] | None = Field(
        None, description="law of the compensator in y; that of [controller] where absent"
    )
    plane: Literal["y", "z"] | None = Field(
        None,
        description="in which it is simulated and diagnosed, with the law that acts there; none: payload on the axis",
    )


class Tolerance(ActuatorTolerance):
    """One relative standard deviation per figure: what the builder can vouch for."""

    stiffness: q.RelativeStd = deviation("the tip stiffness of either beam")
    effective_mass: q.RelativeStd = deviation("the effective mass of either beam")
    beam_damping_ratio: q.RelativeStd = deviation("the damping ratio of either beam")
    sensor_gain: q.RelativeStd = deviation("the gain of the sensor")
    sensor_filter: q.RelativeStd = deviation("the break frequency of the sensor's filter")
    outer_end_mass: q.RelativeStd = deviation("the outer end mass")
    inner_end_mass: q.RelativeStd = deviation("the inner end mass")


class Goal(Record):
    """What the closed loop is asked to do.

    Source: Zalucky and Hardt (1984), whose goal is -100 dB of inch per pound-force.
    """

    compliance_m_per_N: q.ComplianceLimit = Field(COMPLIANCE_LIMIT_M_PER_N, description="limit of |x / F_d|")
    peak_sensitivity: q.PeakSensitivity = Field(2.0, description="limit of max |1 / (1 + L)|")
    lower_gains: bool = Field(
        True, description="stable at every lower gain too: a valve that saturates or a supply that comes up lowers it"
    )
    comes_to_rest: bool = Field(
        False,
        description="proved to come to rest from every state while the law's current saturates; false: where it can be",
    )
    peak_over_passive: q.PeakOverPassive = Field(
        1.0,
        description="limit of the largest |x / F_d| at any frequency, over the largest with the servo off (it asks"
        " for no current) for the same payloads and, within tolerances, the same rigs; inf: no limit",
    )
    loop_gain: q.LoopGain | None = Field(
        None, description="limit of |L| from loop_gain_from_Hz up, where the model leaves out modes; none: no limit"
    )
    loop_gain_from_Hz: q.Frequency = Field(250.0, description="from where on loop_gain is a limit")
    controller_effort_A_per_V: q.LawGain | None = Field(
        None, description="limit of |C / (1 + L)|, current over volts of noise or command; none: no limit"
    )


class Guarantee(Record):
    """What a certificate proves of this prototype."""

    bandwidth_Hz: NonNegative = Field(description="up to which the compliance is proved to keep to its goal")
    peak_sensitivity: Positive = Field(description="proved bound of max |1 / (1 + L)|")
    outer_end_mass_kg: tuple[q.MassOrNone, q.MassOrNone] = Field(
        description="range [least, most] of mass on the outer tip that it holds for"
    )
    certificate: FileName = Field(description="file of the proof, beside the prototype")
    certificate_sha256: str = Field(description="SHA-256 digest of that file")
    sigmas: NonNegative = Field(
        0.0, description="standard deviations of every figure at once that it holds for; zero: exactly these figures"
    )


class Prototype(WithMaterials, WithActuator):
    """A twin-beam rig in SI: one record that is designed, certified, built, measured and diagnosed."""

    name: str = Field(min_length=1, description="what the rig is called in tables and reports")
    kind: Literal["twin_beam"] = Field(
        "twin_beam", description="kind of rig: two beams with an actuator between their tips"
    )
    outer_beam: Beam
    inner_beam: Beam
    actuator: SerializeAsAny[Actuator]
    servovalve: Servovalve | None = None
    sensor: Sensor
    supply: Supply = Supply()
    controller: SerializeAsAny[Controller] | None = None
    compliance: Compliance | None = None
    payload: Payload = Payload()
    arm: Arm | None = None
    goal: Goal = Goal()
    sized_for: SizedFor | None = None
    tolerance: Tolerance = Tolerance()
    guarantee: Guarantee | None = None
    effects: dict[str, dict[str, FiniteFloat]] = Field(
        default_factory=dict,
        description="effects beyond the linear rig, [effects.NAME] each; see `beamdesign explain NAME`",
    )

    @property
    def own_controller(self) -> Controller:
        """Its controller.

        Raises:
            ValueError: where it has none.
        """
        if self.controller is None:
            raise ValueError("the prototype has no [controller]")
        return self.controller

    @property
    def kept_servo(self) -> Cascade:
        """The law that a compliant controller is made from: that of its own one, or its controller itself.

        Raises:
            InputError: where there is none.
        """
        if self.compliance is not None:
            return self.compliance.servo
        if self.controller is None:
            raise records.InputError(self.name, [("controller", "missing, so that there is none to keep")])
        if not isinstance(self.controller, Cascade):
            words = "cannot be kept without a [compliance] that says what it stands for; give a lag"
            raise records.InputError(self.name, [("controller.kind", f"{self.controller.kind!r} {words}")])
        return self.controller

    @property
    def schedule(self) -> Scheduled | None:
        """Its controller where that has several laws."""
        return None if self.controller is None else self.controller.schedule

    @property
    def outer_end_mass_kg(self) -> tuple[float, float] | None:
        """Its payloads: those stated, else those of a controller with several laws; None where neither says."""
        stated = self.payload.outer_end_mass_kg
        return self.schedule.outer_end_mass_kg if stated is None and self.schedule is not None else stated

    def asked_kg(self, given: object = None) -> tuple[float, float]:
        """Payloads (least, most) that are asked for, or else its own.

        Raises:
            InputError: for what is no pair of plausible masses, and where neither says.
            ValueError: for an empty range.
        """
        return checked_range_kg(self.name, self.outer_end_mass_kg if given is None else given)

    def with_law(self, law: Controller, outer_kg: tuple[float, float] | None, inner_kg: float) -> "Prototype":
        """With another law, payloads (kg) and mass inside (kg) in its payload; without guarantee and `[compliance]`."""
        payload = self.payload.but(outer_end_mass_kg=outer_kg, inner_end_mass_kg=inner_kg)
        return self.but(controller=law, payload=payload, compliance=None, guarantee=None)

    def stages(self, masses_kg: tuple[float, float]) -> "tuple[InStage, ...]":
        """A prototype for each law of its controller, with those of some payloads that it is for.

        Args:
            masses_kg: payloads (least, most).

        Returns:
            every stage that is for some of them; itself with all of them where it has one law.

        Raises:
            InputError: where some payloads are for no law.
        """
        if self.schedule is None:
            return (InStage(self, masses_kg),)
        if reason := self.schedule.uncovered(masses_kg):
            raise records.InputError(self.name, [("payload.outer_end_mass_kg", reason)])
        found = []
        for k, (law, (low, high)) in enumerate(self.schedule.laws, start=1):
            own = max(low, masses_kg[0]), min(high, masses_kg[1])
            if own[0] <= own[1]:
                payload = self.payload.but(outer_end_mass_kg=own)
                name = f"{shorter(self.name)}, stage {k}"
                found.append(InStage(self.but(name=name, controller=law, payload=payload, guarantee=None), own, k))
        return tuple(found)

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """The beams fit each other, and what the materials and the actuator ask."""
        yield from super().relations(table)
        yield from beams_that_do_not_fit(table)

    @model_validator(mode="after")
    def _laws_cover_the_payload(self) -> "Prototype":
        asked = self.payload.outer_end_mass_kg
        if self.schedule is not None and asked is not None and (reason := self.schedule.uncovered(asked)):
            kind = PydanticCustomError("relation", "{reason}", {"reason": reason})
            line = InitErrorDetails(type=kind, loc=("payload", "outer_end_mass_kg"), input=asked)
            raise ValidationError.from_exception_data("Prototype", [line])
        return self


class InStage(NamedTuple):
    """A prototype while one law of its controller acts, which is all there is of a fixed law.

    Attributes:
        prototype: with this law alone.
        outer_end_mass_kg: payloads (least, most) that it is for.
        number: of the stage, from 1; 0 where there is one law.
    """

    prototype: Prototype
    outer_end_mass_kg: tuple[float, float]
    number: int = 0

    @property
    def suffix(self) -> str:
        """What tells its files from those of other stages; empty where there is one law."""
        return f".stage_{self.number}" if self.number else ""

    @property
    def looked_at_kg(self) -> tuple[float, ...]:
        """Payloads that stand for its range where nothing is proved: both ends and the middle."""
        low, high = self.outer_end_mass_kg
        return tuple(sorted({low, (low + high) / 2, high}))


@takes()
def read_prototype(path: str | Path) -> Prototype:
    """Read a prototype.toml.

    Raises:
        InputError: naming file, key and reason of everything wrong with it; also where the certificate that its
            guarantee rests on lies beside it and has another content.
    """
    table = records.read_table(path)
    if table.get("kind", "twin_beam") != "twin_beam" and not str(table["kind"]).startswith("beamdesign."):
        reads = "; beamdesign.read_bench_prototype reads it in Python" if table["kind"] == "actuator_bench" else ""
        reason = f"{table['kind']!r} is not a rig this command can work on; expected 'twin_beam'{reads}"
        raise records.InputError(path, [("kind", reason)])
    record = records.parse(Prototype, table, path)
    if record.guarantee is not None and (reason := _changed(record.guarantee, Path(path).parent)):
        raise records.InputError(path, [("guarantee.certificate_sha256", reason)])
    return record


def _changed(guarantee: Guarantee, folder: Path) -> str:
    """That the certificate of a guarantee has another content than it had, in words; empty where it has not."""
    if Path(guarantee.certificate).name != guarantee.certificate:
        return ""  # a path to elsewhere, which is not followed
    try:
        data = read_bytes(folder / guarantee.certificate)
    except FileNotFoundError:
        return ""  # whoever has the prototype alone can still read it
    except OSError as error:
        return f"{guarantee.certificate} beside it cannot be read: {error.strerror or error}"
    if hashlib.sha256(data).hexdigest() == guarantee.certificate_sha256:
        return ""
    return (
        f"{guarantee.certificate} beside it is not the certificate that was written with it; make both again, or"
        " remove [guarantee]"
    )


@takes("Prototype BenchPrototype")
def write_prototype(prototype: Record, path: str | Path) -> None:
    """Write a prototype.toml, of any kind of rig, from which its reader gives back an equal record."""
    write_whole(Path(path), records.to_toml(prototype))


def prototype_from(table: dict[str, Any], source: str | Path = "prototype") -> Prototype:
    """Validate a prototype given as nested dictionaries."""
    return records.parse(Prototype, table, source)
