"""A kind of actuator of a file of this test's own: what it feels of its load is heard by a law of that name.

Kinds are found while the package is loaded, so that this is a process of its own.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

KIND = '''
from typing import Literal

from pydantic import Field

from beamdesign.plant.actuators.ball_screw import BallScrew


class Spindle(BallScrew):
    """A ball screw whose load cell has another name."""

    kind: Literal["spindle"] = Field("spindle", description="what joins the tips")
    feels = "spindle_force_N", lambda port, figure, state: port["actuator_force_N"]


KIND = Spindle
'''

PROGRAM = """
import importlib.util
import json
import sys
from pathlib import Path

import numpy as np

spec = importlib.util.find_spec("beamdesign.plant.actuators")
spec.submodule_search_locations.append(sys.argv[1])
sys.modules[spec.name] = module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)

from honest_certificates import screw

from beamdesign import certify, import_measured, simulate, write_prototype
from beamdesign.build.realisation.realise import realise, full_scales_of
from beamdesign.controllers import SENSORS, Observer
from beamdesign.scenario import Scenario, ScenarioRecord, Step

told = {"sensors": SENSORS}
for kind, felt in (("ball_screw", "screw_force_N"), ("spindle", "spindle_force_N")):
    rig = screw()
    actuator = module.KINDS[kind](**rig.actuator.but(kind="ball_screw").model_dump(exclude={"kind"}))
    law = Observer(
        gain_A_per_V=5.0, sensors=("displacement_m", felt),
        a=((-10.0,),), b=((10.0, 0.0),), c=(1.0,), d=(0.1, 1e-6), b_command=(),
    )
    rig = rig.but(actuator=actuator, controller=law, guarantee=None)
    plan = Scenario(
        name="push", duration_s=0.02,
        record=(ScenarioRecord(name="push", input=(Step(amplitude_N=50.0, at_s=0.002),)),),
    )
    coded = realise(law, 2e4, full_scales=full_scales_of(rig, 10.0))
    told[kind] = {
        "guaranteed": certify(rig, 0.0, 1.0).guaranteed.peak_sensitivity,
        "felt_N": float(simulate(rig, plan).records[0].column(felt)[-1]),
        "moved_m": float(simulate(rig, plan).records[0].column("displacement_m")[-1]),
        "full_scales": coded.full_scales,
    }
columns = ("t_s", "current_A", "displacement_m", "spindle_force_N")
record = simulate(rig, plan).records[0]
table = np.column_stack([record.column(name) for name in columns])
folder = Path(sys.argv[1])
np.savetxt(folder / "push.csv", table, delimiter=",", header=",".join(columns), comments="")
write_prototype(rig, folder / "prototype.toml")
(taken,) = import_measured(folder / "push.csv", folder / "prototype.toml", folder / "set").taken.values()
told["taken"] = {one.channel: one.name for one in taken}
print(json.dumps(told))
"""


def ran(folder: Path, kind: str) -> subprocess.CompletedProcess[str]:
    (folder / "spindle.py").write_text(kind)
    paths = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    return subprocess.run(
        [sys.executable, "-c", PROGRAM, str(folder)],
        capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": paths},
    )  # fmt: skip


def test_a_parameter_of_the_name_of_anothers_is_refused(tmp_path: Path) -> None:
    """It took the place of that one: the leakage of a hydraulic rig spread no more."""
    own = 'parameters = (*BallScrew.parameters, Parameter.of("actuator", "leakage", "K", "m3/s/Pa", 0.1, "its own"))'
    head = "from beamdesign.plant.component import Parameter\n"
    done = ran(tmp_path, head + KIND.replace("    feels =", f"    {own}\n    feels ="))
    assert done.returncode == 1
    assert "spindle: its parameter leakage" in done.stderr


def test_what_another_actuator_feels_is_heard(tmp_path: Path) -> None:
    """It is a ball screw but for names, and so are its proof, its motion and its code."""
    done = ran(tmp_path, KIND)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["sensors"][2:] == ["load_pressure_Pa", "screw_force_N", "spindle_force_N"]
    assert told["ball_screw"] == told["spindle"]
    assert told["spindle"]["felt_N"] != 0
    assert told["taken"]["spindle_force_N"] == "spindle_force_N"
    assert not told["taken"]["disturbance_N"]
