"""The table of the rig's parameters: every row has its place, its tolerance and its value in the model."""

from math import pi

import pytest

from beamdesign import Prototype
from beamdesign.parameters import PARAMETERS, rows_of
from beamdesign.plant.actuators import KINDS
from beamdesign.plant.component import with_unit
from beamdesign.plant.effects import SUBSYSTEMS
from beamdesign.prototype import Tolerance
from beamdesign.structure.lumped import figures

ROWS = [(kind, row) for kind in KINDS.values() for row in rows_of(kind).values()]


@pytest.mark.parametrize(("actuator", "row"), ROWS, ids=lambda part: getattr(part, "name", ""))
def test_a_parameter_has_a_place_a_tolerance_and_a_subsystem(actuator, row, paper: Prototype) -> None:
    table, key = row.place.split(".")
    assert key in (actuator if table == "actuator" else type(getattr(paper, table))).model_fields
    assert row.tolerance in Tolerance.model_fields
    assert row.subsystem in SUBSYSTEMS
    assert key.endswith(("_Hz", "ratio", with_unit("", row.unit), with_unit("", row.shown_unit)))


def test_the_model_has_what_the_prototype_states(paper: Prototype) -> None:
    filtered = paper.but(sensor=paper.sensor.but(filter_Hz=400.0))
    model = figures(filtered)
    assert list(model) == [name for name in rows_of(type(paper.actuator)) if not name.endswith("_end_mass")]
    assert model["filter_frequency"] == pytest.approx(800 * pi)
    for name, row in rows_of(type(paper.actuator)).items():
        if not name.endswith(("_damping", "_end_mass")):
            assert model[name] == pytest.approx(row.factor * row.stated(filtered))


def test_every_tolerance_is_that_of_some_parameter() -> None:
    assert {row.tolerance for row in PARAMETERS.values()} == set(Tolerance.model_fields)


def test_units_are_suffixes() -> None:
    assert with_unit("outer_damping", "N s/m") == "outer_damping_N_s_per_m"
    assert with_unit("flow_gain", "m3/s/A") == "flow_gain_m3_per_s_per_A"
    assert with_unit("valve_damping_ratio", "1") == "valve_damping_ratio"
