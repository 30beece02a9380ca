"""Linear models handed out as `control.StateSpace` with named signals, to go on with in python-control."""

from typing import TYPE_CHECKING, Literal

import numpy as np

from beamdesign.plant.linearised import SEEN
from beamdesign.plant.members import family
from beamdesign.prototype import Prototype

if TYPE_CHECKING:
    import control

OUTPUTS = ("displacement_m", "sensor_V", "current_A")
"""Outputs of the open and the closed loop; the plant has the first two. What added sensors read follows."""


def state_space(
    prototype: Prototype, outer_end_mass_kg: float = 0.0, loop: Literal["closed", "open", "plant"] = "closed"
) -> "control.StateSpace":
    """The linear rig at one outer end mass, equations (7) to (18), in SI.

    - "plant": `disturbance_N` and `current_A` to `displacement_m` and `sensor_V`.
    - "open": the controller before the plant, the sensor not fed back: `disturbance_N` and `command_V` to
      `displacement_m`, `sensor_V` and `current_A`. The loop transfer function L is `sensor_V` over `command_V` where
      nothing but the sensor is to be fed back.
    - "closed": the same signals with the sensor subtracted from the command, equation (12).

    Where the controller has added sensors, what they read are further outputs of all three, and are fed back in the
    third: `inner_displacement_m`, `load_pressure_Pa`.

    States are named as in `beamdesign.plant.linearised.STATES`, then `filtered_V` where the sensor has a filter, then
    `EFFECT_STATE` and `mean_pressure_Pa` where there are such, then `controller_1` and so on for a controller with
    dynamics. A prototype with effects is taken linear at rest.

    Args:
        prototype: its inner end mass is that of `payload.inner_end_mass_kg`.
        outer_end_mass_kg: mass on the outer tip.
        loop: which of the three.

    Raises:
        ValueError: for a loop where the prototype has no controller, or a name that is none of the three.
    """
    import control

    if loop not in ("closed", "open", "plant"):
        raise ValueError(f"loop is 'closed', 'open' or 'plant', not {loop!r}")
    member = family(prototype, outer_end_mass_kg).rest
    a, b, c = member.rig.matrices(outer_end_mass_kg, prototype.payload.inner_end_mass_kg)
    b = b * [1.0, member.gain.high]
    added = prototype.controller.added if prototype.controller is not None else ()
    c = c[[0, 1, *(SEEN.index(name) for name in added)]]
    states = [name.replace(".", "_") for name in member.rig.states]
    if loop == "plant":
        return control.ss(
            a, b, c, np.zeros((len(c), 2)), states=states, inputs=["disturbance_N", "current_A"],
            outputs=[*OUTPUTS[:2], *added], name="plant",
        )  # fmt: skip
    if prototype.controller is None:
        raise ValueError("the prototype has no [controller]")
    law = prototype.controller.control_model()
    n, k = len(states), law.nstates
    # The error, in volts, is the command less what is fed back of the sensor; the added sensors have no command.
    fed_back = c[1:] if loop == "closed" else np.zeros((1 + len(added), n))
    disturbance, current, commanded = b[:, :1], b[:, 1:], slice(0, 1)
    dynamics = np.block([[a - current @ law.D @ fed_back, current @ law.C], [-law.B @ fed_back, law.A]])
    inputs = np.block([[disturbance, current @ law.D[:, commanded]], [np.zeros((k, 1)), law.B[:, commanded]]])
    inputs[n:, 1] += prototype.controller.state_space()[4]
    shown = np.hstack([c, np.zeros((len(c), k))])
    outputs = np.vstack([shown[:2], np.hstack([-law.D @ fed_back, law.C]), shown[2:]])
    through = np.zeros((len(outputs), 2))
    through[2, 1:] = law.D[:, commanded]
    return control.ss(
        dynamics, inputs, outputs, through,
        states=[*states, *(f"controller_{i + 1}" for i in range(k))], inputs=["disturbance_N", "command_V"],
        outputs=[*OUTPUTS, *added], name=f"{loop}_loop",
    )  # fmt: skip
