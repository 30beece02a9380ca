"""The prototype of an actuator bench: a servovalve and its cylinder between end stops, in open loop."""

from collections.abc import Iterator, Mapping
from math import pi
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, FiniteFloat

from beamdesign import quantities as q
from beamdesign import records
from beamdesign.files import write_whole
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem, Record, numbers

AREA_ROUNDING = 0.05
"""Relative difference between a stated mean area and that of bore and rod which passes as rounding or measurement."""


class BenchActuator(Record):
    """A cylinder with a rod on one side, its load and its end stops."""

    bore_m: Annotated[q.Bore, Field(description="bore of the cylinder")]
    rod_m: Annotated[
        q.RodDiameter,
        Field(description="diameter of the rod, on the side of chamber b"),
    ]
    piston_area_m2: Annotated[q.PistonArea, Field(description="A, average of the two sides")]
    stroke_m: Annotated[q.Stroke, Field(description="from one end stop to the other")]
    supply_pressure_Pa: Annotated[q.SupplyPressure, Field(description="of the supply that draws no flow")]
    tank_pressure_Pa: Annotated[q.TankPressure, Field(description="of the return")] = 0.0
    line_loss_Pa_s2_per_m6: Annotated[
        q.LineLoss, Field(description="pressure lost over flow squared in each of the lines to and from the valve")
    ] = 0.0
    piston_leakage_m3_per_s_per_Pa: Annotated[
        q.Leakage, Field(description="from chamber to chamber past the piston")
    ] = 0.0
    constant_load_N: Annotated[q.SignedForce, Field(description="constant force against extension")] = 0.0
    moving_mass_kg: Annotated[q.Mass, Field(description="piston, rod and what they carry")] = 0.5
    dead_volume_m3: Annotated[
        q.Volume, Field(description="oil of each chamber with the piston against it, lines included")
    ] = 1e-5
    oil_bulk_modulus_Pa: Annotated[q.BulkModulus, Field(description="of the oil with its lines")] = 1.4e9
    stop_stiffness_N_per_m: Annotated[q.Stiffness, Field(description="of either end stop")] = 2e7

    @classmethod
    def relations(cls, table: Mapping[str, Any]) -> Iterator[Problem]:
        """The rod fits in the bore, the stated mean area is that of both, and the tank lies below the supply."""
        if (pair := numbers(table, "rod_m", "bore_m")) and pair[0] >= pair[1] > 0:
            yield Problem("rod_m", f"{pair[0]:g} is not less than the bore, {pair[1]:g}")
        elif (given := numbers(table, "rod_m", "bore_m", "piston_area_m2")) and given[1] > 0:
            mean = pi / 4 * (given[1] * given[1] - given[0] * given[0] / 2)
            if abs(given[2] - mean) > AREA_ROUNDING * mean:
                yield Problem(
                    "piston_area_m2", f"{given[2]:g} is not the mean of both sides, {mean:.4g} by bore and rod"
                )
        if (pair := numbers(table, "tank_pressure_Pa", "supply_pressure_Pa")) and pair[0] >= pair[1] > 0:
            yield Problem("tank_pressure_Pa", f"{pair[0]:g} is not less than the supply, {pair[1]:g}")

    @property
    def asymmetry(self) -> float:
        """(A_a - A_b)/(A_a + A_b) by bore and rod."""
        rod = (self.rod_m / self.bore_m) ** 2
        return rod / (2 - rod)


class BenchServovalve(Record):
    """A servovalve with its amplifier, whose flow is known per volt of command."""

    flow_gain_m3_per_s_per_V: Annotated[
        q.FlowPerVolt, Field(description="no-load flow per command, half the supply pressure across each edge")
    ]
    amplifier_A_per_V: Annotated[
        q.LawGain, Field(description="current per command; sets the scale of effects that are stated in amperes")
    ] = 1e-3
    null_V: Annotated[q.SignedVoltage, Field(description="command at which the valve is shut")] = 0.0
    edge_b_ratio: Annotated[
        q.EdgeRatio,
        Field(description="flow of the edge from the supply to chamber b over that of the other edges"),
    ] = 1.0
    leakage_m3_per_s_per_Pa: Annotated[q.Leakage, Field(description="K_pq, of the closed valve")] = 0.0
    natural_frequency_Hz: Annotated[q.ComponentFrequency, Field(description="f_n of the spool")] = 100.0
    damping_ratio: Annotated[q.SpoolDamping, Field(description="xi of the spool")] = 0.7


class BenchSensors(Record):
    """Filters of the recorded channels, first order; none: nothing between the quantity and its record."""

    displacement_zero_m: Annotated[q.Position, Field(description="reading at the retracted stop")] = 0.0
    displacement_most_m: Annotated[q.Position | None, Field(description="reading beyond which it does not go")] = None
    displacement_filter_Hz: Annotated[q.ComponentFrequency | None, Field(description="break frequency")] = None
    pressure_filter_Hz: Annotated[
        q.ComponentFrequency, Field(description="break frequency, of the gauges at least")
    ] = 1000.0


class BenchTolerance(Record):
    """One relative standard deviation per figure: what the builder can vouch for."""

    flow_gain: Annotated[
        q.RelativeStd, Field(description="relative standard deviation of the flow gain of the valve")
    ] = 0.0
    piston_area: Annotated[q.RelativeStd, Field(description="relative standard deviation of the piston area")] = 0.0
    supply_pressure: Annotated[
        q.RelativeStd, Field(description="relative standard deviation of the supply pressure")
    ] = 0.0


class BenchPrototype(Record):
    """An actuator on a test bench, in SI: what is built, measured and diagnosed without the beams."""

    name: Annotated[str, Field(min_length=1, description="what the bench is called in tables and reports")]
    kind: Annotated[
        Literal["actuator_bench"], Field(description="kind of rig: a servovalve and its cylinder alone, in open loop")
    ]
    actuator: BenchActuator
    servovalve: BenchServovalve
    sensors: BenchSensors = BenchSensors()
    tolerance: BenchTolerance = BenchTolerance()
    effects: dict[str, dict[str, FiniteFloat]] = Field(
        default_factory=dict,
        description="effects beyond the linear rig, [effects.NAME] each; see `beamdesign explain NAME`",
    )


KINDS: dict[str, type[Prototype] | type[BenchPrototype]] = {"twin_beam": Prototype, "actuator_bench": BenchPrototype}
AnyPrototype = Prototype | BenchPrototype


def read_any_prototype(path: str | Path) -> AnyPrototype:
    """Read a prototype.toml of any kind of rig.

    Raises:
        InputError: naming file, key and reason of everything wrong with it.
    """
    table = records.read_table(path)
    kind = table.get("kind", "twin_beam")
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError(path, [("kind", f"{kind!r} is no rig known here; known are {', '.join(KINDS)}")])
    return records.parse(KINDS[kind], table, path)


def read_bench_prototype(path: str | Path) -> BenchPrototype:
    """Read the prototype.toml of an actuator bench.

    Raises:
        InputError: naming file, key and reason of everything wrong with it.
    """
    found = read_any_prototype(path)
    if not isinstance(found, BenchPrototype):
        raise InputError(path, [("kind", f"{found.kind!r} is not a bench; expected 'actuator_bench'")])
    return found


def write_any_prototype(prototype: AnyPrototype, path: str | Path) -> None:
    """Write a prototype.toml from which `read_any_prototype` gives back an equal record."""
    write_whole(Path(path), records.to_toml(prototype))
