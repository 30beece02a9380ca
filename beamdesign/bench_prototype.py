"""The prototype of an actuator bench: a servovalve and its cylinder between end stops, in open loop."""

from collections.abc import Iterator, Mapping
from math import pi
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, FiniteFloat

from beamdesign import quantities as q
from beamdesign import records
from beamdesign.arguments import takes
from beamdesign.plant.actuators import deviation
from beamdesign.prototype import Prototype
from beamdesign.records import InputError, Problem, Record, numbers

AREA_ROUNDING = 0.05
"""Relative difference between a stated mean area and that of bore and rod which passes as rounding or measurement."""


class BenchActuator(Record):
    """A cylinder with a rod on one side, its load and its end stops."""

    bore_m: q.Bore = Field(description="bore of the cylinder")
    rod_m: q.RodDiameter = Field(description="diameter of the rod, on the side of chamber b")
    piston_area_m2: q.PistonArea = Field(description="A, average of the two sides")
    stroke_m: q.Stroke = Field(description="from one end stop to the other")
    supply_pressure_Pa: q.SupplyPressure = Field(description="of the supply that draws no flow")
    tank_pressure_Pa: q.TankPressure = Field(0.0, description="of the return")
    line_loss_Pa_s2_per_m6: q.LineLoss = Field(
        0.0, description="pressure lost over flow squared in each of the lines to and from the valve"
    )
    piston_leakage_m3_per_s_per_Pa: q.Leakage = Field(0.0, description="from chamber to chamber past the piston")
    constant_load_N: q.SignedForce = Field(0.0, description="constant force against extension")
    moving_mass_kg: q.Mass = Field(0.5, description="piston, rod and what they carry")
    dead_volume_m3: q.Volume = Field(1e-5, description="oil of each chamber with the piston against it, lines included")
    oil_bulk_modulus_Pa: q.BulkModulus = Field(1.4e9, description="of the oil with its lines")
    stop_stiffness_N_per_m: q.Stiffness = Field(2e7, description="of either end stop")

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

    flow_gain_m3_per_s_per_V: q.FlowPerVolt = Field(
        description="no-load flow per command, half the supply pressure across each edge"
    )
    amplifier_A_per_V: q.LawGain = Field(
        1e-3, description="current per command; sets the scale of effects that are stated in amperes"
    )
    null_V: q.SignedVoltage = Field(0.0, description="command at which the valve is shut")
    edge_b_ratio: q.EdgeRatio = Field(
        1.0, description="flow of the edge from the supply to chamber b over that of the other edges"
    )
    leakage_m3_per_s_per_Pa: q.Leakage = Field(0.0, description="K_pq, of the closed valve")
    natural_frequency_Hz: q.ComponentFrequency = Field(100.0, description="f_n of the spool")
    damping_ratio: q.SpoolDamping = Field(0.7, description="xi of the spool")


class BenchSensors(Record):
    """Filters of the recorded channels, first order; none: nothing between the quantity and its record."""

    displacement_zero_m: q.Position = Field(0.0, description="reading at the retracted stop")
    displacement_most_m: q.Position | None = Field(None, description="reading beyond which it does not go")
    displacement_filter_Hz: q.ComponentFrequency | None = Field(None, description="break frequency")
    pressure_filter_Hz: q.ComponentFrequency = Field(1000.0, description="break frequency, of the gauges at least")


class BenchTolerance(Record):
    """One relative standard deviation per figure: what the builder can vouch for."""

    flow_gain: q.RelativeStd = deviation("the flow gain of the valve")
    piston_area: q.RelativeStd = deviation("the piston area")
    supply_pressure: q.RelativeStd = deviation("the supply pressure")


class BenchPrototype(Record):
    """An actuator on a test bench, in SI: what is built, measured and diagnosed without the beams."""

    name: str = Field(min_length=1, description="what the bench is called in tables and reports")
    kind: Literal["actuator_bench"] = Field(
        description="kind of rig: a servovalve and its cylinder alone, in open loop"
    )
    actuator: BenchActuator
    servovalve: BenchServovalve
    sensors: BenchSensors = BenchSensors()
    tolerance: BenchTolerance = BenchTolerance()
    effects: dict[str, dict[str, FiniteFloat]] = Field(
        default_factory=dict,
        description="effects beyond the linear rig, [effects.NAME] each; see `beamdesign explain NAME`",
    )

    @property
    def rig(self) -> str:
        """Which of `beamdesign.plant.assembly.RIGS` it is."""
        return self.kind


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


@takes()
def read_bench_prototype(path: str | Path) -> BenchPrototype:
    """Read the prototype.toml of an actuator bench.

    Raises:
        InputError: naming file, key and reason of everything wrong with it.
    """
    found = read_any_prototype(path)
    if not isinstance(found, BenchPrototype):
        raise InputError(path, [("kind", f"{found.kind!r} is not a bench; expected 'actuator_bench'")])
    return found
