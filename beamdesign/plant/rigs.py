"""The rigs as assemblies of components: the twin beam with a controller in the loop, and its actuator on a bench.

The first is that of Zalucky and Hardt (1984).
"""

from functools import partial
from typing import Any

import casadi as ca

from beamdesign.parameters import rows_of
from beamdesign.plant.actuators import KINDS, Actuator
from beamdesign.plant.actuators.servo_cylinder import AREAS, CYLINDER, FEED, VALVE, port_leakage
from beamdesign.plant.component import CONTROLLER, SENSOR, SIGN, Component, PortLaw, Rig, Signals, either, low_pass_rate
from beamdesign.structure.arm import LEVER_FIGURES


def beam_force(stiffness: Any, damping: Any, position: Any, velocity: Any) -> Any:
    """Force of a beam against its tip, equations (9) and (10) of Zalucky and Hardt (1984), with the fixed dashpot."""
    return stiffness * position + damping * velocity


def _reaction(beam: str, port: Signals, figure: Signals, state: Signals) -> Any:
    """Force of a beam against its tip, N; bending is what the tip moves beyond its mount."""
    bent, rate = state[f"{beam}_m"] - port["mount_m"], state[f"{beam}_m_per_s"] - port["mount_m_per_s"]
    return beam_force(figure[f"{beam}_stiffness"], figure[f"{beam}_damping"], bent, rate)


TWIST = ("twist_rad", "twist_rad_per_s")
"""States of an outer beam whose end rolls with a payload off its axis."""


def _off_axis(port: Signals, figure: Signals, state: Signals) -> tuple[Any, Any]:
    """Accelerations of the tip, m/s2, and of its roll, rad/s2, with a payload off the axis.

    The payload moves by kappa u + e phi in the plane and by lambda u along the beam (`beamdesign.proofs.arm`); what
    holds it in the plane, f = m (kappa u'' + e phi''), is taken off the tip kappa times and off torsion e times.
    """
    travel, along, lever, *_, stiffness, damping, inertia = (figure[name] for name in LEVER_FIGURES)
    mass, (twist, rate) = figure["outer_end_mass"], (state[name] for name in TWIST)
    driving, twisting = port["outer_force_N"] - port["outer_reaction_N"], stiffness * twist + damping * rate
    moved = figure["outer_mass"] + mass * along**2
    held = mass * (travel * driving / moved - lever * twisting / inertia)
    held /= 1 + mass * (travel**2 / moved + lever**2 / inertia)
    return (driving - travel * held) / moved, -(twisting + lever * held) / inertia


def _sensed(port: Signals, figure: Signals, state: Signals) -> Any:
    """What the sensor sees of the outer beam's end, m."""
    if "sensed_lever" not in figure:
        return port["outer_tip_m"]
    return figure["sensed_travel"] * port["outer_tip_m"] + figure["sensed_lever"] * state["twist_rad"]


def _end_mass(port: Signals, figure: Signals, state: Signals) -> Any:
    """Force that an end mass takes off the tip to be accelerated with the beam's own mass, N."""
    driving = port["outer_force_N"] - port["outer_reaction_N"]
    if "payload_lever" in figure:
        return driving - figure["outer_mass"] * _off_axis(port, figure, state)[0]
    return driving * figure["outer_end_mass"] / (figure["outer_mass"] + figure["outer_end_mass"])


WALL_FIGURES = ("wall_at", "wall_stiffness", "wall_damping", "wall_rounding")
"""Of a wall before the outer tip: m, N/m, N s/m, m."""


def _wall(port: Signals, figure: Signals, state: Signals) -> Any:
    """Force of a wall against the tip, N: a spring and a dashpot on one side, smooth over a rounding.

    With d the way into the wall and e the rounding, the spring is pressed by (d + sqrt(d^2 + e^2)) / 2, a function of
    place alone: it gives back what it took. The dashpot acts in the share of the spring's slope, and takes only.
    """
    if "wall_at" not in figure:
        return 0.0
    at, stiffness, damping, rounding = (figure[name] for name in WALL_FIGURES)
    inward = port["outer_tip_m"] - at
    distance = ca.sqrt(inward**2 + rounding**2)
    share = (1 + inward / distance) / 2
    return stiffness * (inward + distance) / 2 + damping * share * port["outer_tip_m_per_s"]


def _motion(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
    driving = port["outer_force_N"] - port["outer_reaction_N"] - port["outer_end_mass_N"]
    inner_mass = figure["inner_mass"] + figure["inner_end_mass"]
    rolling = (state[TWIST[1]], _off_axis(port, figure, state)[1]) if "payload_lever" in figure else ()
    return dict(zip(TWIST, rolling, strict=False)) | {
        "outer_m": state["outer_m_per_s"],
        "outer_m_per_s": driving / figure["outer_mass"],
        "inner_m": state["inner_m_per_s"],
        "inner_m_per_s": (port["inner_force_N"] - port["inner_reaction_N"]) / inner_mass,
    }


BEAMS = Component.of(
    outer_tip_m=lambda port, figure, state: state["outer_m"],
    outer_tip_m_per_s=lambda port, figure, state: state["outer_m_per_s"],
    mount_m=lambda port, figure, state: 0.0,
    mount_m_per_s=lambda port, figure, state: 0.0,
    outer_reaction_N=partial(_reaction, "outer"),
    inner_reaction_N=partial(_reaction, "inner"),
    mount_force_N=lambda port, figure, state: port["outer_reaction_N"] + port["inner_reaction_N"],
    sensed_m=_sensed,
    rod_m=lambda port, figure, state: state["inner_m"],
    stroke_m=lambda port, figure, state: port["outer_tip_m"] - port["rod_m"],
    rod_m_per_s=lambda port, figure, state: state["inner_m_per_s"],
    stroke_m_per_s=lambda port, figure, state: port["outer_tip_m_per_s"] - port["rod_m_per_s"],
)
"""Where the tips and their mount are, and what the beams hold against that."""

TIPS = Component.of(
    _motion,
    inner_force_N=lambda port, figure, state: -port["actuator_force_N"],
    wall_N=_wall,
    outer_force_N=lambda port, figure, state: port["actuator_force_N"] + port["disturbance_N"] - port["wall_N"],
    outer_end_mass_N=_end_mass,
)
"""Forces that move the tips."""


MORE_FIGURES = ("supply_pressure", "believed_sensor_gain", "gain", "pole", "zero")
"""Figures beside those of the linear plant: Pa, V/m, A/V, rad/s, rad/s."""

_BEAM_STATES = ("outer_m", "outer_m_per_s", "inner_m", "inner_m_per_s")


_COMMANDED: dict[str, PortLaw] = {
    "current_A": lambda port, figure, state: port["current_A"],
    # the controller's input over the believed sensor gain
    "displacement_m": lambda port, figure, state: port["measured_V"] / figure["believed_sensor_gain"],
}
_MEASURED: dict[str, PortLaw] = {"measured_V": lambda port, figure, state: port["measured_V"]}
"""What is recorded of every rig, before and behind what is of its own."""


def twin_beam(actuator: type[Actuator]) -> Rig:
    """Two beams with an actuator between their tips, and a law that goes by the outer tip's displacement."""
    felt, feel = actuator.feels
    own: dict[str, PortLaw] = {
        felt: lambda port, figure, state: port[felt],
        "inner_displacement_m": lambda port, figure, state: state["inner_m"],
        "outer_displacement_m": lambda port, figure, state: port["outer_tip_m"],  # of the tip itself
    }
    return Rig(
        (BEAMS, SENSOR, *actuator.felt_by, Component({felt: feel}), CONTROLLER, *actuator.components, TIPS),
        _BEAM_STATES + actuator.states,
        (*rows_of(actuator), *MORE_FIGURES),
        _COMMANDED | own | _MEASURED,
        actuator,
    )


RIGS = {"twin_beam" if name == Actuator.where_none_is_stated else name: twin_beam(a) for name, a in KINDS.items()}
"""By the `rig` of their prototypes: its kind, or its actuator where that is not that of Zalucky and Hardt (1984)."""

OUTPUTS = tuple(RIGS["twin_beam"].outputs)


def figures_of(rig: str) -> tuple[str, ...]:
    """Those of the linear plant of a twin beam, end masses last; the frequency of a filter counts only with one."""
    return RIGS[rig].figures[: -len(MORE_FIGURES)]


FIGURES = figures_of("twin_beam")


_BENCH_STATES = (
    "piston_m", "piston_m_per_s", "pressure_a_Pa", "pressure_b_Pa", "flow_m3_per_s", "flow_m3_per_s2",
    "sag_Pa", "back_Pa", "seen_a_Pa", "seen_b_Pa",
)  # fmt: skip
BENCH_STATED = {
    "piston_area": "actuator.piston_area_m2",
    "stroke": "actuator.stroke_m",
    "moving_mass": "actuator.moving_mass_kg",
    "dead_volume": "actuator.dead_volume_m3",
    "bulk_modulus": "actuator.oil_bulk_modulus_Pa",
    "stop_stiffness": "actuator.stop_stiffness_N_per_m",
    "constant_load": "actuator.constant_load_N",
    "supply_pressure": "actuator.supply_pressure_Pa",
    "tank_pressure": "actuator.tank_pressure_Pa",
    "line_loss": "actuator.line_loss_Pa_s2_per_m6",
    "piston_leakage": "actuator.piston_leakage_m3_per_s_per_Pa",
    "edge_b": "servovalve.edge_b_ratio",
    "leakage": "servovalve.leakage_m3_per_s_per_Pa",
    "valve_damping_ratio": "servovalve.damping_ratio",
    "gain": "servovalve.amplifier_A_per_V",
    "null": "servovalve.null_V",
    "sensor_zero": "sensors.displacement_zero_m",
}
"""Figures of the bench's equations by what its prototype has for them."""
_BENCH_FIGURES = (
    *BENCH_STATED,
    "stop_damping",  # N s/m
    "flow_gain",  # m3/s/A
    "valve_frequency",  # rad/s
    "sensor_gain",  # V/m
    "believed_sensor_gain",  # V/m
    "filter_frequency",  # rad/s, only with the filter
    "pressure_filter_frequency",  # rad/s
)
LINE_S = 5e-3  # how soon the pressure lost in a line comes and goes
_INDENTATION_M = 1e-5  # over which the damping of a stop comes on
_STALL = 0.02  # of the supply: a linear valve gives way to a chamber that comes this near to supply or tank


def _stop(port: Signals, figure: Signals, state: Signals) -> Any:
    """Force of the end stops on the piston, N: springs with damping that grows with indentation, which never pull."""
    stiffness, damping = figure["stop_stiffness"], figure["stop_damping"]
    position, speed = state["piston_m"], state["piston_m_per_s"]

    def pressed(depth: Any, closing: Any) -> Any:
        inside = ca.fmax(depth, 0.0)
        return ca.fmax(stiffness * inside + damping * ca.fmin(inside / _INDENTATION_M, 1.0) * closing, 0.0)

    return pressed(-position, -speed) - pressed(position - figure["stroke"], speed)


def _linear_port(side: str, port: Signals, figure: Signals, state: Signals) -> Any:
    """Flow through a port of a linear valve, which ends where no pressure is left to drive it."""
    flow, pressure = SIGN[side] * port[f"linear_{side}_m3_per_s"], state[f"pressure_{side}_Pa"]
    supply, tank = port["supply_pressure_Pa"], port["tank_pressure_Pa"]
    drop = ca.if_else(flow > 0, supply - pressure, pressure - tank)
    return SIGN[side] * (flow * ca.fmin(ca.fmax(drop / (_STALL * (supply - tank)), 0.0), 1.0))


def _leakage(side: str, port: Signals, figure: Signals, state: Signals) -> Any:
    own, facing = (state[f"pressure_{name}_Pa"] for name in ("ab" if side == "a" else "ba"))
    middle = port["supply_pressure_Pa"] + port["tank_pressure_Pa"]
    return port_leakage(figure["leakage"], own, middle) + figure["piston_leakage"] * (own - facing)


def _chamber(side: str, port: Signals, figure: Signals, state: Signals) -> Any:
    """Pressure gained per volume forced into a chamber, beta/V."""
    filled = state["piston_m"] if side == "a" else figure["stroke"] - state["piston_m"]
    volume = figure["dead_volume"] + port[f"area_{side}_m2"] * ca.fmax(filled, 0.0)
    return port[f"bulk_ratio_{side}"] * figure["bulk_modulus"] / volume


def _bench_motion(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
    force = port["actuator_force_N"] + port["stop_N"] + port["disturbance_N"] - figure["constant_load"]
    a, b = port["orifice_a_m3_per_s"], port["orifice_b_m3_per_s"]
    drawn, given = ca.fmax(a, 0.0) + ca.fmax(-b, 0.0), ca.fmax(-a, 0.0) + ca.fmax(b, 0.0)
    seen = figure["pressure_filter_frequency"]
    return {
        "piston_m": state["piston_m_per_s"],
        "piston_m_per_s": force / figure["moving_mass"],
        "sag_Pa": (figure["line_loss"] * drawn**2 - state["sag_Pa"]) / LINE_S,
        "back_Pa": (figure["line_loss"] * given**2 - state["back_Pa"]) / LINE_S,
        "seen_a_Pa": low_pass_rate(seen, state["pressure_a_Pa"], state["seen_a_Pa"]),
        "seen_b_Pa": low_pass_rate(seen, state["pressure_b_Pa"], state["seen_b_Pa"]),
    }


_BENCH_OUTPUTS: dict[str, PortLaw] = {
    **either("pressure_{}_Pa", lambda side, port, figure, state: state[f"seen_{side}_Pa"]),
    "piston_m": lambda port, figure, state: state["piston_m"],
}

RIGS["actuator_bench"] = BENCH = Rig(
    (
        Component.of(
            stroke_m=lambda port, figure, state: state["piston_m"],
            stroke_m_per_s=lambda port, figure, state: state["piston_m_per_s"],
            sensed_m=lambda port, figure, state: state["piston_m"] + figure["sensor_zero"],
        ),
        SENSOR,
        Component.of(  # an amplifier that gives a current for every command, whatever is measured
            demanded_A=lambda port, figure, state: figure["gain"] * (port["command_V"] - figure["null"]),
            current_A=lambda port, figure, state: port["demanded_A"],
        ),
        AREAS,
        FEED.but(
            supply_pressure_Pa=lambda port, figure, state: figure["supply_pressure"] - state["sag_Pa"],
            tank_pressure_Pa=lambda port, figure, state: figure["tank_pressure"] + state["back_Pa"],
            null_adjusted=lambda port, figure, state: 0.0,
        ),
        VALVE.but(
            opening_b_m3_per_s=lambda port, figure, state: (
                port["metered_m3_per_s"] * ca.if_else(port["metered_m3_per_s"] < 0, figure["edge_b"], 1.0)
            ),
            **either("orifice_{}_m3_per_s", _linear_port),
            **either("leakage_{}_m3_per_s", _leakage),
        ),
        CYLINDER.but(**either("chamber_{}_Pa_per_m3", _chamber)),
        Component({"stop_N": _stop}, _bench_motion),
    ),
    _BENCH_STATES,
    _BENCH_FIGURES,
    _COMMANDED | _BENCH_OUTPUTS | _MEASURED,
)
"""Servovalve and cylinder between end stops, in open loop.

Positions count from the retracted stop; chamber a is the cap's, and a positive command extends. What the twin beam
lumps at mid-stroke is worked out here from the volumes, which the stroke changes many times over.
"""
