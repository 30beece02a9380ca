"""An end mass that is not the one stated of a record, against rigs whose masses are known."""

from dataclasses import replace

import numpy as np
import pytest
from gap_sets import believed, measured

from beamdesign.diagnosis.data.dataset import Dataset
from beamdesign.diagnosis.misstated_mass import misstated_mass, with_own_mass

RIG = believed()
TRUE = RIG.but(outer_beam=RIG.outer_beam.but(stiffness_N_per_m=1.02 * RIG.outer_beam.stiffness_N_per_m))


def stating(data: Dataset, name: str, **masses: float) -> Dataset:
    """The data with other end masses stated of one record."""
    return replace(data, records=tuple(replace(r, **masses) if r.name == name else r for r in data.records))


@pytest.fixture(scope="module")
def sound() -> Dataset:
    return measured(TRUE)


@pytest.mark.parametrize(
    ("name", "mass", "stated"),
    [("payload_disturbance", "outer_end_mass", 3.4), ("payload_disturbance", "inner_end_mass", 3.4),
     ("disturbance_large", "outer_end_mass", 1.0)],
)  # fmt: skip
def test_a_mass_that_is_not_the_one_stated_is_found_and_taken(sound: Dataset, name: str, mass: str, stated: float):
    true = next(getattr(record, mass) for record in sound.records if record.name == name)
    data, _, (words,) = with_own_mass(stating(sound, name, **{mass: stated}))
    taken = next(record for record in data.records if record.name == name)
    assert getattr(taken, mass) == pytest.approx(true, abs=0.05)
    assert words.startswith(f"{name}: {mass}_kg is stated as {stated:.3g}")
    others = [record.name for record in sound.records if record.name != name]
    assert [r.name for r, s in zip(data.records, sound.records, strict=True) if r is s] == others


def test_no_mass_is_made_up(sound: Dataset):
    """Of a rig as believed, of one whose sensor lags in all records, and of a force that is off in one."""
    assert misstated_mass(sound) is None
    assert misstated_mass(measured(TRUE.but(effects={"sensor_lag": {"break_Hz": 250.0}}))) is None
    wrong = [
        replace(r, inputs=r.inputs * np.array([1.3, 1.0])) if r.name == "disturbance_large" else r
        for r in sound.records
    ]
    assert misstated_mass(replace(sound, records=tuple(wrong))) is None


def test_two_records_do_not_say_which_is_wrong(sound: Dataset):
    few = replace(sound, records=tuple(r for r in sound.records if r.name.endswith("disturbance") or "large" in r.name))
    few = stating(replace(few, records=few.records[-2:]), "payload_disturbance", outer_end_mass=3.4)
    assert len(few.records) == 2
    assert misstated_mass(few) is None
