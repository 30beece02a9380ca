"""The figures of the linear model as rows of a table: what each is, its symbol, its value, where it comes from."""

from typing import NamedTuple

from beamdesign.lumped import LumpedBeam, lumped_beam
from beamdesign.prototype import Beam, Prototype
from beamdesign.report.quantity import quantity


class Row(NamedTuple):
    """One figure; `source` says what it rests on."""

    name: str
    symbol: str
    value: str
    source: str


def lumped_rows(prototype: Prototype) -> list[Row]:
    """Every figure of the linear model but controller and end masses."""
    actuator, valve, sensor = prototype.actuator, prototype.servovalve, prototype.sensor
    rows = []
    for name, suffix, record in (("outer", "m", prototype.outer_beam), ("inner", "f", prototype.inner_beam)):
        rows += _beam_rows(name, suffix, record, lumped_beam(record))
    rows += [
        Row("oil spring", "K_c", quantity(actuator.oil_stiffness_N_per_m, "N/m"), "given"),
        Row("piston area", "A", quantity(actuator.piston_area_m2, "m2"), "given, mean of both sides"),
        Row("valve flow gain", "K_q", quantity(valve.flow_gain_m3_per_s_per_A, "m3/s/A"), "given"),
        Row("leakage", "K_pq", quantity(valve.leakage_m3_per_s_per_Pa, "m3/s/Pa"), "given"),
        Row("valve natural frequency", "f_n", quantity(valve.natural_frequency_Hz, "Hz"), "given"),
        Row("valve damping ratio", "ξ", quantity(valve.damping_ratio, "1"), "given"),
        Row("sensor gain", "F", quantity(sensor.gain_V_per_m, "V/m"), "given"),
    ]
    filtered = quantity(sensor.filter_Hz, "Hz") if sensor.filter_Hz else "none"
    return [*rows, Row("sensor filter", "", filtered, "given")]


def _beam_rows(name: str, suffix: str, record: Beam, lumped: LumpedBeam) -> list[Row]:
    def source(measured: float | None, equation: str) -> str:
        if measured is None:
            return f"geometry, {equation}"
        return "measured; it replaces what the geometry gives" if record.has_geometry else "measured"

    return [
        Row(
            f"{name} tip stiffness",
            f"K_{suffix}",
            quantity(lumped.stiffness, "N/m"),
            source(record.stiffness_N_per_m, "equation (3) on the free length"),
        ),
        Row(
            f"{name} effective mass",
            f"M_{suffix}",
            quantity(lumped.mass, "kg"),
            source(record.effective_mass_kg, "equation (5)"),
        ),
        Row(
            f"{name} dashpot",
            f"b_{suffix}",
            quantity(lumped.damping, "N s/m"),
            f"2 ζ √(K M) of the bare beam, ζ = {record.damping_ratio:g}; it stays as end mass is added",
        ),
    ]
