"""An electromechanical actuator: a motor with a current loop and speed feedback turns a ball screw.

The motor sits on one beam, the nut pushes the other. With h the travel per radian, v the speed at which rotor and
screw would move the nut, i the motor's current and F the axial force,

    i'     = w_c (i_law - k_w v / h - i)             current loop; the drive takes off a current for the rotor's speed
    J v'   = h (K_t i - h (F + friction)) - b v      rotor, coupling and screw
    F      = K_s d + c_s d', d = travel - stroke     screw, nut and bearings as one spring with a dashpot
    travel' = v

Speed feedback makes a source of speed that gives way to force of what would be a free rotor, as a leaking valve is one;
the rotor's inertia, J / h^2 at the nut, is what a servovalve does not have. What the torque's reaction does to the
beams' torsion is left out.

Sources: W. Leonhard, Control of Electrical Drives, 3rd ed. (2001), for current loop and speed feedback; K. K. Varanasi
and S. A. Nayfeh, J. Dyn. Sys., Meas., Control 126 (2004) 388, for the screw as a spring behind the rotor's inertia.
"""

from collections.abc import Mapping
from math import pi, sqrt
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from beamdesign import quantities as q
from beamdesign.plant.actuators import MARGIN, Actuator, Change, Demand, Held, Limit, Rating, Row, turn
from beamdesign.plant.component import Component, Parameter, Signals

if TYPE_CHECKING:
    import numpy as np

    from beamdesign.plant.actuators import WithActuator


def _motion(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
    lead, force = figure["lead"], port["actuator_force_N"] + port["friction_N"]
    torque = figure["torque_constant"] * state["motor_A"] - lead * force
    slowing = figure["rotor_friction"] * state["travel_m_per_s"]
    return {
        "travel_m": state["travel_m_per_s"],
        "travel_m_per_s": (lead * torque - slowing) / figure["rotor_inertia"],
        "motor_A": figure["current_loop"] * (port["motor_demand_A"] - state["motor_A"]),
    }


FORCE = Component.of(
    stretch_m=lambda port, figure, state: state["travel_m"] - port["stroke_m"],
    stretch_m_per_s=lambda port, figure, state: state["travel_m_per_s"] - port["stroke_m_per_s"],
    thread_N=lambda port, figure, state: (
        figure["screw_stiffness"] * port["stretch_m"] + figure["screw_damping"] * port["stretch_m_per_s"]
    ),
    actuator_force_N=lambda port, figure, state: port["thread_N"],
)
"""What stretches the screw, where a load cell on the nut would feel it."""

SCREW = Component.of(
    _motion,
    motor_demand_A=lambda port, figure, state: (
        port["current_A"] - figure["speed_feedback"] * state["travel_m_per_s"] / figure["lead"]
    ),
    sliding_m=lambda port, figure, state: state["travel_m"],
    sliding_m_per_s=lambda port, figure, state: state["travel_m_per_s"],
    friction_N=lambda port, figure, state: 0.0,
)
"""From the law's current to the travel of the nut."""


_COMMAND_V = 10.0
"""The largest command that drives take, as they are built."""


class BallScrew(Actuator):
    """A motor with current loop and speed feedback that turns a ball screw between the beam tips."""

    kind: Literal["ball_screw"] = Field("ball_screw", description="what joins the tips")
    lead_m: q.Lead = Field(description="travel of the nut per turn")
    screw_stiffness_N_per_m: q.Stiffness = Field(description="K_s, axial: screw, nut and bearings in series")
    screw_damping_N_s_per_m: q.Damping = Field(0.0, description="c_s, of the same, beside K_s")
    torque_constant_N_m_per_A: q.TorqueConstant = Field(description="K_t, torque of the motor per current")
    rotor_inertia_kg_m2: q.RotorInertia = Field(description="J of rotor, coupling and screw about their axis")
    rotor_friction_N_m_s_per_rad: q.RotorFriction = Field(0.0, description="b, viscous, of rotor, screw and bearings")
    speed_feedback_A_s_per_rad: q.SpeedFeedback = Field(
        description="k_w, current that the drive takes off the law's per speed of the rotor"
    )
    current_loop_Hz: q.ComponentFrequency = Field(description="break frequency of the current loop, first order")
    peak_current_A: q.MotorCurrent | None = Field(None, description="largest current of drive and motor")
    continuous_current_A: q.MotorCurrent | None = Field(None, description="RMS current that the motor bears for good")
    drive_A_per_V: q.DriveGain | None = Field(
        None, description="current that the drive gives per volt of its command; else its peak current at 10 V"
    )
    largest_speed_rad_per_s: q.RotorSpeed | None = Field(None, description="of the rotor, under load")
    dynamic_load_N: q.Force | None = Field(None, description="C_a of the screw: 10^6 turns with 90 % reliability")

    parameters = tuple(
        Parameter.of("actuator", *row)
        for row in (
            ("screw_stiffness", "K_s", "N/m", 0.15, "the axial stiffness of the screw"),
            ("screw_damping", "c_s", "N s/m", 0.3, "the axial damping of the screw"),
            ("lead", "h", "m/rad", 0.0, "the lead of the screw"),
            ("torque_constant", "K_t", "N m/A", 0.05, "the torque constant of the motor"),
            ("rotor_inertia", "J", "kg m2", 0.05, "the inertia of rotor and screw"),
            ("rotor_friction", "b", "N m s/rad", 0.3, "the viscous friction of rotor and screw"),
            ("speed_feedback", "k_w", "A s/rad", 0.0, "the speed feedback of the drive", "amplifier"),
            ("current_loop", "w_c", "rad/s", 0.1, "the break frequency of the current loop", "amplifier"),
        )
    )
    felt_by, components = (FORCE,), (SCREW,)
    states = ("travel_m", "travel_m_per_s", "motor_A")
    feels = "screw_force_N", lambda port, figure, state: port["actuator_force_N"]
    linear_states = states
    law_alone = (
        " That is what the law asks for: nothing is proved of the motor's own current, at whose limit the drive's speed"
        " feedback is lost too, so that a loop that comes to rest here may oscillate for good there; what is proved of"
        " that `certify --nonlinear` says of a prototype with [effects.motor_current_limit]."
    )
    fed_back = ("speed_feedback",)
    ratings = (
        Rating("peak current", "peak_current_A", "actuator.peak_current_A", "A", q.MotorCurrent, "motor_current_limit"),
        Rating("continuous current", "effective_current_A", "actuator.continuous_current_A", "A", q.MotorCurrent),
        Rating("rotor speed", "speed_rad_per_s", "actuator.largest_speed_rad_per_s", "rad/s", q.RotorSpeed),
    )
    title = "Motor, drive and screw"

    @classmethod
    def _resistance(cls, figure: Signals, s: Any) -> tuple[Any, Any]:
        """Force against a speed of the nut, N s/m, and the lag of the current loop."""
        lag, lead = 1 / (1 + s / figure["current_loop"]), figure["lead"]
        feedback = figure["torque_constant"] * figure["speed_feedback"] * lag
        return (figure["rotor_inertia"] * s + figure["rotor_friction"] + feedback) / lead**2, lag

    @classmethod
    def compliance(cls, figure: Signals, s: Any) -> Any:
        """1 / (K_s + c_s s) + 1 / (s R(s)), R being what rotor, friction and feedback resist at the nut, N s/m."""
        return cls._give(figure, s) + 1 / (s * cls._resistance(figure, s)[0])

    @classmethod
    def _give(cls, figure: Signals, s: Any) -> Any:
        """What a force compresses the screw by, m/N."""
        return 1 / (figure["screw_stiffness"] + figure["screw_damping"] * s)

    @classmethod
    def held_N_per_A(cls, figure: Signals) -> float:
        """K_t / h: the rotor stands still, and nothing is fed back."""
        return float(figure["torque_constant"] / figure["lead"])

    @classmethod
    def travel(cls, figure: Signals, s: Any) -> Any:
        """K_t G(s) / (h s R(s)), G being the lag of the current loop."""
        resistance, lag = cls._resistance(figure, s)
        return figure["torque_constant"] * lag / (figure["lead"] * s * resistance)

    def signals(self, figure: Signals, s: Any, force: Any, stroke: Any) -> dict[str, Any]:
        """Speed of the rotor, rad/s, and the motor's current, A, that moves it against force and friction."""
        lead = figure["lead"]
        speed = s * (stroke + force * self._give(figure, s)) / lead
        torque = (figure["rotor_inertia"] * s + figure["rotor_friction"]) * speed + lead * force
        return {"speed": speed, "motor_current": torque / figure["torque_constant"]}

    def strength_N(self, prototype: "WithActuator") -> float:
        """What the largest current gives at a nut that stands still."""
        current = self.peak_current_A or self.continuous_current_A
        return current * self.torque_constant_N_m_per_A * 2 * pi / self.lead_m if current else self.usual_strength_N

    def drive_gain(self) -> float:
        """As stated, or the largest current that is stated at 10 V, as drives are scaled; 1 A/V where none is."""
        return self.drive_A_per_V or (self.peak_current_A or self.continuous_current_A or 10.0) / _COMMAND_V

    def usual_limits_A(self) -> dict[str, float]:
        """What the largest command asks for, and the peak current where it is stated."""
        peak = {"motor_current_limit": self.peak_current_A} if self.peak_current_A else {}
        return {"current_saturation": _COMMAND_V * self.drive_gain(), **peak}

    def limits(self, prototype: "WithActuator") -> tuple[Limit, ...]:
        """Largest current and what the motor bears for good, and the rotor's speed."""
        of = ("motor_current", False), ("motor_current", True), ("speed", False)
        return tuple(
            Limit(one.name, name, self.stated(prototype, one), one.place, effective)
            for one, (name, effective) in zip(self.ratings, of, strict=True)
        )

    def takes(self, prototype: "WithActuator", asked: Demand, load_N: float, held: Held) -> dict[str, float]:
        """Current at its peak and in the mean square, speed, power of the shaft at its peak, and the drive's command.

        The command is the law's current, of which the drive takes its feedback of the speed.
        """
        import numpy as np

        current, speed = (load_N * np.abs(asked[name]) for name in ("motor_current", "speed"))
        still = abs(held["motor_current"])
        turning, turned = (load_N * np.real(asked[name][:, None] * turn()) for name in ("motor_current", "speed"))
        power = self.torque_constant_N_m_per_A * (still + np.abs(turning)) * np.abs(turned)
        return {
            "peak_current_A": still + float(current.max()),
            "effective_current_A": sqrt(still**2 + float(current.max()) ** 2 / 2),
            "speed_rad_per_s": float(speed.max()),
            "shaft_power_W": float(power.max()),
            "drive_command_V": (still + load_N * float(np.abs(asked["current"]).max())) / self.drive_gain(),
        }

    def power_W(self, prototype: "WithActuator", asked: Demand, load_N: "np.ndarray") -> "np.ndarray":
        """Of the shaft, losses in the windings apart."""
        import numpy as np

        current, speed = (np.real(asked[name][:, None] * turn()) for name in ("motor_current", "speed"))
        given = np.maximum(current * speed, 0.0).mean(axis=1)
        return np.asarray(self.torque_constant_N_m_per_A * given * load_N**2)

    def holding(self, prototype: "WithActuator", force_N: float) -> tuple[str, float, float | None, str, str]:
        """Current of the motor that stands still."""
        needed = force_N * self.lead_m / (2 * pi) / self.torque_constant_N_m_per_A
        return "continuous current at rest", needed, self.continuous_current_A, "A", "actuator.continuous_current_A"

    def stronger(self, prototype: "WithActuator", force_N: float) -> tuple[Change, ...]:
        """More current, or more torque from it."""
        _, needed, most, *_ = self.holding(prototype, force_N)
        share = needed / (most or needed)
        torque = share * self.torque_constant_N_m_per_A
        return (("actuator.continuous_current_A", needed, True), ("actuator.torque_constant_N_m_per_A", torque, True))

    def rows(self, prototype: "WithActuator", need: Mapping[str, float], load_N: float) -> tuple[Row, ...]:
        """See `Actuator`. The life of the screw is (C_a / F)^3 million turns, ISO 3408-5:2006, F its largest force."""
        torque, force, still = self.torque_constant_N_m_per_A, need["force_N"], self.holding(prototype, load_N)[1]
        at_nut, to_buy = self.rotor_inertia_kg_m2 / (self.lead_m / (2 * pi)) ** 2, Row.to_buy
        peak, effective, command = (need[name] for name in ("peak_current_A", "effective_current_A", "drive_command_V"))
        rows = (
            Row("lead of the screw", self.lead_m, None, "m"),
            Row("axial stiffness of screw, nut and bearings K_s", self.screw_stiffness_N_per_m, None, "N/m"),
            Row("axial damping of these c_s", self.screw_damping_N_s_per_m, None, "N s/m"),
            Row("torque constant K_t", torque, None, "N m/A"),
            Row("inertia of rotor, coupling and screw J", self.rotor_inertia_kg_m2, None, "kg m2"),
            Row("inertia at the nut, J / h²", at_nut, None, "kg", "inertia_at_the_nut_kg"),
            Row("speed feedback k_w", self.speed_feedback_A_s_per_rad, None, "A s/rad"),
            Row("break of the current loop", self.current_loop_Hz, None, "Hz"),
            Row(
                "motor current that holds load and weight at rest", still, self.continuous_current_A, "A",
                "rest_current_A",
            ),
            to_buy("peak current", peak, self.stated(prototype, self.ratings[0]), "A", "peak_current_A"),
            to_buy("continuous current (RMS)", effective, self.continuous_current_A, "A", "continuous_current_A"),
            Row("current of the drive per volt of its command", self.drive_gain(), None, "A/V"),
            to_buy(
                "command of the drive, its feedback of the speed included", command, _COMMAND_V, "V", "drive_command_V"
            ),
            Row(f"peak torque, × {MARGIN:g}", MARGIN * torque * peak, None, "N m", "peak_torque_N_m"),
            to_buy(
                "speed of the rotor", need["speed_rad_per_s"], self.largest_speed_rad_per_s, "rad/s",
                "largest_speed_rad_per_s",
            ),
            to_buy("peak power of the shaft", need["shaft_power_W"], None, "W", "shaft_power_W"),
            Row("largest axial force on the screw", force, None, "N", "axial_force_N"),
        )  # fmt: skip
        if self.dynamic_load_N is None or not force:
            return rows
        life = 1e6 * (self.dynamic_load_N / force) ** 3
        rated = Row("dynamic load rating of the screw C_a", self.dynamic_load_N, None, "N")
        return (*rows, rated, Row("turns at that force that nine screws of ten last", life, None, "1", "life_turns"))


KIND = BallScrew
