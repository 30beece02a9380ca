"""The published rig and loops that many tests start from, and results that are made once for several files."""

import gc
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from fcntl import LOCK_EX, flock
from functools import cache
from math import inf
from pathlib import Path

import pytest
import slow_sensor
from hypothesis import settings
from typer import testing

from beamdesign import Prototype, time_limit
from beamdesign.controllers import Lag
from beamdesign.plant.actuators.servo_cylinder import ServoCylinder
from beamdesign.prototype import Beam, Payload, Sensor, Servovalve
from beamdesign.sweep import workers

gc.set_threshold(50_000, 20, 20)  # proofs hold many small numbers and no circles: to look for these took 3 % of all
settings.register_profile("as long as it takes", deadline=None)
settings.load_profile("as long as it takes")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Adds `--thorough`: all mutants and forgeries, of which a part is tried otherwise."""
    parser.addoption("--thorough", action="store_true", help="try all mutants of inputs and all forged certificates")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long files first, so that no process is left alone with one at the end."""
    items.sort(key=lambda item: item.get_closest_marker("long") is None)


@pytest.fixture(scope="session")
def tried(request: pytest.FixtureRequest) -> Callable[[int], int]:
    """How many of so many mutants or forgeries to try."""
    return lambda count: count if request.config.getoption("--thorough") else -(-count // 10)


@pytest.fixture(scope="session", autouse=True)
def no_time_limit() -> Iterator[None]:
    """Commands take as long as they need where a test does not limit them: what they find is of no computer's speed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time_limit, "MINUTES", inf)
        yield


@pytest.fixture(scope="session", autouse=True)
def commands_once() -> Iterator[None]:
    """The program's commands are made from their functions once for all that are run, as they are in a process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(testing, "_get_command", cache(testing._get_command))
        yield


@pytest.fixture
def computed_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sweeps are computed in this process: one of their own would first load the program again."""
    monkeypatch.setattr(workers, "processes", lambda count, case_seconds: nullcontext(workers.here))


@pytest.fixture
def one_start() -> Iterator[None]:
    """Searches for a law and for sections go on with their best start alone."""
    from one_start import best_start_alone

    with best_start_alone():
        yield


@pytest.fixture
def least_effort() -> Iterator[None]:
    """Searches for a law, of which only what comes of them is looked at, take the least that leads to one."""
    from one_start import least_effort

    with least_effort():
        yield


@pytest.fixture
def few_climbs() -> Iterator[None]:
    """The worst member of a box is sought less far."""
    from one_start import short_climbs

    with short_climbs():
        yield


@pytest.fixture
def single_causes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Records are searched for one cause at a time: pairs, which take half of the time, have tests of their own."""
    from beamdesign.diagnosis.fitting import search

    monkeypatch.setattr(search, "_two_at_once", lambda fitters, state, progress: list(state.fits))


@pytest.fixture
def no_pictures() -> Iterator[None]:
    """Reports have captions alone, where nobody looks at the pictures."""
    from one_start import captions_alone

    with captions_alone():
        yield


@pytest.fixture
def paper() -> Prototype:
    """The appendix of Zalucky and Hardt (1984) in SI, without a controller; valve damping 0.5 as the README states."""
    return Prototype(
        name="paper",
        outer_beam=Beam(stiffness_N_per_m=486_800.0, effective_mass_kg=3.9, damping_ratio=0.05),
        inner_beam=Beam(stiffness_N_per_m=157_500.0, effective_mass_kg=1.6, damping_ratio=0.05),
        actuator=ServoCylinder(piston_area_m2=1.13e-4, oil_stiffness_N_per_m=1.3e7),
        servovalve=Servovalve(
            flow_gain_m3_per_s_per_A=1.13e-2,
            leakage_m3_per_s_per_Pa=3.8e-13,
            natural_frequency_Hz=150.0,
            damping_ratio=0.5,
        ),
        sensor=Sensor(gain_V_per_m=1180.0),
    )


@pytest.fixture
def remedy(paper: Prototype) -> Prototype:
    """The paper's remedy for payload: lag 1.75/26 Hz with 4.5 kg inside, at 150 mA/V."""
    return paper.but(
        controller=Lag(gain_A_per_V=0.15, pole_Hz=1.75, zero_Hz=26.0),
        payload=Payload(inner_end_mass_kg=4.5, outer_end_mass_kg=(0.0, 6.8)),
    )


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Callable[[Path], None]], Path]:
    """Gives a folder by its name; the first process of the run that asks for it makes it, others wait and read it."""
    own = tmp_path_factory.getbasetemp()
    shared = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own

    def folder(name: str, make: Callable[[Path], None]) -> Path:
        target, done = shared / name, shared / f"{name}.done"
        with open(shared / f"{name}.lock", "w") as lock:
            flock(lock, LOCK_EX)
            if not done.exists():
                shutil.rmtree(target, ignore_errors=True)  # of a process that has failed
                target.mkdir()
                make(target)
                done.touch()
        return target

    return folder


@pytest.fixture(scope="session")
def diagnosed_slow_sensor(made_once: Callable[[str, Callable[[Path], None]], Path]) -> Path:
    """What `slow_sensor.diagnose` makes; only to be read."""
    return made_once("diagnosed_slow_sensor", slow_sensor.diagnose)
