"""The hydraulic cylinder with its servovalve: equations (11) to (16) of Zalucky and Hardt (1984).

The paper's leakage K_pq and oil spring K_c belong to the load pressure; here each chamber has its half of them, so that
for equal chambers the difference of their pressures obeys the paper's equations (11), (13) and (14), and the mean
pressure is a state which nothing drives and nothing sees.
"""

from collections.abc import Mapping
from math import inf, pi
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from beamdesign import quantities as q
from beamdesign.plant.actuators import Actuator, Change, Demand, Held, Limit, Rating, Row, of_effect, turn
from beamdesign.plant.component import Component, Parameter, Signals, either
from beamdesign.records import Record

if TYPE_CHECKING:
    import numpy as np

    from beamdesign.plant.actuators import WithActuator


def spool_acceleration(frequency: Any, damping_ratio: Any, gain: Any, current: Any, flow: Any, rate: Any) -> Any:
    """Second derivative of the valve flow Q_0, equation (13) of Zalucky and Hardt (1984)."""
    return frequency**2 * (gain * current - flow) - 2 * damping_ratio * frequency * rate


def port_leakage(leakage: Any, pressure: Any, supply: Any) -> Any:
    """Flow that leaves a chamber through the closed valve, m3/s: none at half the supply pressure."""
    return 2 * leakage * (pressure - supply / 2)


def _leakage(side: str, port: Signals, figure: Signals, state: Signals) -> Any:
    return port_leakage(figure["leakage"], state[f"pressure_{side}_Pa"], port["supply_pressure_Pa"])


def _spool(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
    frequency, damping, gain = (figure[name] for name in ("valve_frequency", "valve_damping_ratio", "flow_gain"))
    flow, rate = state["flow_m3_per_s"], state["flow_m3_per_s2"]
    bent = spool_acceleration(frequency, damping, gain, port["spool_A"], flow, rate)
    return {"flow_m3_per_s": rate, "flow_m3_per_s2": bent}


def _chambers(port: Signals, figure: Signals, state: Signals) -> dict[str, Any]:
    into_a = port["orifice_a_m3_per_s"] - port["leakage_a_m3_per_s"] - port["area_a_m2"] * port["stroke_m_per_s"]
    into_b = port["area_b_m2"] * port["stroke_m_per_s"] - port["orifice_b_m3_per_s"] - port["leakage_b_m3_per_s"]
    return {
        "pressure_a_Pa": port["chamber_a_Pa_per_m3"] * into_a,
        "pressure_b_Pa": port["chamber_b_Pa_per_m3"] * into_b,
    }


def _mid_stroke(side: str, port: Signals, figure: Signals, state: Signals) -> Any:
    """Pressure gained per volume forced into one chamber at mid-stroke, Pa/m3.

    The volume there goes with the area, so that both chambers in parallel are the oil spring K_c whatever their areas.
    The ratio is of the bulk modulus to that of air-free oil, over the volume's own to that at mid-stroke.
    """
    ratio = port[f"bulk_ratio_{side}"] / port[f"volume_ratio_{side}"]
    return ratio * figure["oil_stiffness"] / (2 * figure["piston_area"] * port[f"area_{side}_m2"])


def _pressure_force(port: Signals, figure: Signals, state: Signals) -> Any:
    """Force of the oil on the outer beam (and its opposite on the rod), N."""
    return port["area_a_m2"] * state["pressure_a_Pa"] - port["area_b_m2"] * state["pressure_b_Pa"]


def _load_pressure(port: Signals, figure: Signals, state: Signals) -> Any:
    """Difference of both pressures, Pa; whoever adjusts the null so that the rig rests takes the sensors' zero there.

    With unequal sides that is where they balance at half the supply, p_a A_a = p_b A_b with p_a + p_b = p_S.
    """
    uneven = (port["area_a_m2"] - port["area_b_m2"]) / (port["area_a_m2"] + port["area_b_m2"])
    zero = port["null_adjusted"] * port["supply_pressure_Pa"] * uneven
    return state["pressure_a_Pa"] - state["pressure_b_Pa"] + zero


def _metered(side: str, port: Signals, figure: Signals, state: Signals) -> Any:
    return port["metered_m3_per_s"]


AREAS = Component(either("area_{}_m2", lambda side, port, figure, state: figure["piston_area"]))
"""The two sides of the piston."""

VOLUMES = Component(either("volume_ratio_{}", lambda side, port, figure, state: 1.0))
"""Volume of either chamber over that at mid-stroke, which the linear rig has at every stroke."""

FEED = Component.of(
    supply_pressure_Pa=lambda port, figure, state: figure["supply_pressure"],
    tank_pressure_Pa=lambda port, figure, state: 0.0,
    # 1 where somebody has adjusted the null so that the rig rests without load
    null_adjusted=lambda port, figure, state: 1.0,
)
"""What the valve is fed from, and whether it is balanced there."""

VALVE = Component.of(
    _spool,
    spool_A=lambda port, figure, state: port["current_A"],
    # what the opening would pass with half the supply pressure across each edge
    metered_m3_per_s=lambda port, figure, state: state["flow_m3_per_s"],
    # the same for the edges that are then open at either port
    **either("opening_{}_m3_per_s", _metered),
    # what a valve lets through either port that heeds no pressure
    **either("linear_{}_m3_per_s", _metered),
    # into chamber a, out of chamber b
    **either("orifice_{}_m3_per_s", lambda side, port, figure, state: port[f"linear_{side}_m3_per_s"]),
    **either("leakage_{}_m3_per_s", _leakage),
)
"""From current to the flows through both ports."""

CYLINDER = Component.of(
    _chambers,
    **either("bulk_ratio_{}", lambda side, port, figure, state: 1.0),
    **either("chamber_{}_Pa_per_m3", _mid_stroke),
    pressure_force_N=_pressure_force,
    sliding_m=lambda port, figure, state: port["stroke_m"],
    sliding_m_per_s=lambda port, figure, state: port["stroke_m_per_s"],
    friction_N=lambda port, figure, state: 0.0,
    actuator_force_N=lambda port, figure, state: port["pressure_force_N"] - port["friction_N"],
)
"""From flows and the speed of the stroke to the force between piston and cylinder."""


MEAN = "mean_pressure_Pa"
"""Of both chambers: where they are alike, nothing drives it and nothing shows it."""

PRESSURE_SHARE = 2 / 3
"""Of the supply pressure that the load should use at most: there a valve gives the most power (H. E. Merritt, Hydraulic
Control Systems (1967), section 7-3)."""


class Servovalve(Record):
    """Second-order servovalve with leakage.

    Source: Zalucky and Hardt (1984), equations (13) and (14).
    """

    flow_gain_m3_per_s_per_A: q.FlowPerCurrent = Field(description="K_q, no-load flow gain")
    leakage_m3_per_s_per_Pa: q.Leakage = Field(description="K_pq = K_q / K_p")
    natural_frequency_Hz: q.ComponentFrequency = Field(description="f_n of the spool")
    damping_ratio: q.SpoolDamping = Field(
        0.5, description="xi; the paper does not give it, 0.5 reproduces its critical gains"
    )
    rated_current_A: q.Current | None = Field(None, description="current at which it is fully open")


class Supply(Record):
    """The hydraulic supply. It has no part in the linear model."""

    pressure_Pa: q.SupplyPressure = Field(20e6, description="p_S, above the tank")
    flow_m3_per_s: q.FlowRate | None = Field(None, description="largest that it keeps up its pressure at")


class ServoCylinder(Actuator):
    """The hydraulic cylinder between the beam tips."""

    kind: Literal["servo_cylinder"] = Field("servo_cylinder", description="what joins the tips")
    piston_area_m2: q.PistonArea = Field(description="A, average of the two sides")
    oil_stiffness_N_per_m: q.Stiffness = Field(description="K_c, oil spring between piston and outer beam")

    parameters = (
        Parameter.of("actuator", "oil_stiffness", "K_c", "N/m", 0.15, "the oil spring", "oil"),
        Parameter.of("actuator", "piston_area", "A", "m2", 0.005, "the piston area"),
        Parameter.of("servovalve", "flow_gain", "K_q", "m3/s/A", 0.05, "the flow gain of the valve"),
        Parameter.of("servovalve", "leakage", "K_pq", "m3/s/Pa", 0.3, "the leakage of the valve"),
        Parameter(
            "valve_frequency", "ω_n", "rad/s", "servovalve.natural_frequency_Hz", "valve_natural_frequency",
            "servovalve", 0.05, "the valve's natural frequency",
        ),
        Parameter(
            "valve_damping_ratio", "ξ", "1", "servovalve.damping_ratio", "valve_damping_ratio", "servovalve", 0.15,
            "the valve's damping ratio",
        ),
    )  # fmt: skip
    tables = ("servovalve", "supply")
    felt_by, components = (AREAS, FEED), (VALVE, VOLUMES, CYLINDER)
    states = ("pressure_a_Pa", "pressure_b_Pa", "flow_m3_per_s", "flow_m3_per_s2")
    feels = "load_pressure_Pa", _load_pressure
    linear_states = ("cylinder_m", "flow_m3_per_s", "flow_rate_m3_per_s2")
    unseen = MEAN
    ratings = (
        Rating("rated current", "current_A", "servovalve.rated_current_A", "A", q.Current, "current_saturation"),
        Rating("supply flow", "flow_m3_per_s", "supply.flow_m3_per_s", "m3/s", q.FlowRate),
    )
    title = "Cylinder, valve and supply"
    usual_strength_N = 2260.0  # of the published rig: 20 MPa on 1.13 cm2

    @classmethod
    def to_linear(cls, state: Signals, figure: Signals, tip: Any) -> dict[str, Any]:
        """Instead of two pressures the end of the oil spring, X_c = X_m + A (p_a - p_b) / K_c, and their mean."""
        spring = figure["oil_stiffness"] / figure["piston_area"]
        a, b = state["pressure_a_Pa"], state["pressure_b_Pa"]
        flow = {"flow_m3_per_s": state["flow_m3_per_s"], "flow_rate_m3_per_s2": state["flow_m3_per_s2"]}
        return {"cylinder_m": tip + (a - b) / spring, MEAN: (a + b) / 2} | flow

    @classmethod
    def from_linear(cls, linear: Signals, figure: Signals, tip: Any) -> dict[str, Any]:
        """See `Actuator`."""
        half = figure["oil_stiffness"] / figure["piston_area"] * (linear["cylinder_m"] - tip) / 2
        flow = {"flow_m3_per_s": linear["flow_m3_per_s"], "flow_m3_per_s2": linear["flow_rate_m3_per_s2"]}
        return {"pressure_a_Pa": linear[MEAN] + half, "pressure_b_Pa": linear[MEAN] - half} | flow

    @classmethod
    def compliance(cls, figure: Signals, s: Any) -> Any:
        """1 / K_c + K_pq / (A^2 s): the oil spring, and what leaks through the closed valve."""
        return 1 / figure["oil_stiffness"] + figure["leakage"] / (figure["piston_area"] ** 2 * s)

    @classmethod
    def held_N_per_A(cls, figure: Signals) -> float:
        """A K_q / K_pq: all flow leaks; without leakage the pressure grows."""
        leakage = figure["leakage"]
        return float(figure["piston_area"] * (figure["flow_gain"] / leakage)) if leakage else inf

    @classmethod
    def travel(cls, figure: Signals, s: Any) -> Any:
        """K_q V(s) / (A s), V being the spool's second-order lag."""
        spool = s / figure["valve_frequency"]
        lag = 1 + 2 * figure["valve_damping_ratio"] * spool + spool**2
        return figure["flow_gain"] / (figure["piston_area"] * s * lag)

    def signals(self, figure: Signals, s: Any, force: Any, stroke: Any) -> dict[str, Any]:
        """The flow through the valve, m3/s: it moves the piston and compresses the oil, or leaks."""
        area = figure["piston_area"]
        return {"flow": area * s * (force / figure["oil_stiffness"] + stroke) + figure["leakage"] * force / area}

    def smaller_side(self, prototype: "WithActuator") -> float:
        """Area of the smaller side of the piston, m2; the mean area where no `unequal_piston_areas` are given."""
        return self.piston_area_m2 * (1 - abs(of_effect(prototype, "unequal_piston_areas") or 0.0))

    def strength_N(self, prototype: "WithActuator") -> float:
        """The supply's pressure on the mean area of the piston."""
        return prototype.supply.pressure_Pa * self.piston_area_m2

    def limits(self, prototype: "WithActuator") -> tuple[Limit, ...]:
        """Stall force, flow at the load's pressure, current, and flow of the supply, no accumulator assumed.

        Force: F <= p_S A (H. E. Merritt, Hydraulic Control Systems (1967), section 5-4: the stall load). Valve flow:
        q <= K_q i_r sqrt(1 - p_L / p_S) at every instant, the load's locus inside the valve's parabola of flow over
        load pressure (Merritt, equation (5-22) and figure 5-5).
        """
        rated, key = self.largest_current_A(prototype), "servovalve.rated_current_A"
        stall = prototype.supply.pressure_Pa * self.smaller_side(prototype)
        largest = None if rated is None else valve_of(prototype).flow_gain_m3_per_s_per_A * rated
        parabola = Limit(
            "valve flow", "flow", largest, key, reached=lambda asked, held, q: _within_parabola(asked, held, q, stall)
        )
        return (
            Limit("force", "force", stall, "supply.pressure_Pa"),
            parabola,
            Limit("current", "current", rated, key),
            Limit("supply flow", "flow", prototype.supply.flow_m3_per_s, "supply.flow_m3_per_s"),
        )

    def takes(self, prototype: "WithActuator", asked: Demand, load_N: float, held: Held) -> dict[str, float]:
        """Flow under load; without a load that which gives it by the root law, and the current for that.

        The root law is q = q_0 sqrt(1 - p_L / p_S), asked the other way round for q_0; infinite where the load pressure
        reaches the supply's. The current has the spool's lag in it.
        """
        import numpy as np

        stall = prototype.supply.pressure_Pa * self.smaller_side(prototype)
        flow = asked["flow"]
        moved, force = (load_N * np.real(one[:, None] * turn()) for one in (flow, asked["force"]))
        left = 1 - (np.sign(moved) * force + abs(held["force"])) / stall
        through = np.abs(moved) + abs(held["flow"])
        through = np.where(left > 0, through / np.sqrt(np.maximum(left, 1e-12)), np.inf).max(axis=1)
        per_flow = np.abs(asked["current"]) / np.maximum(np.abs(flow), 1e-300)
        return {
            "flow_m3_per_s": abs(held["flow"]) + load_N * float(np.abs(flow).max()),
            "no_load_flow_m3_per_s": float(through.max()),
            "current_A": float((through * per_flow).max()),
        }

    def power_W(self, prototype: "WithActuator", asked: Demand, load_N: "np.ndarray") -> "np.ndarray":
        """Supply pressure times the mean flow."""
        import numpy as np

        return np.asarray(prototype.supply.pressure_Pa * (2 / pi) * load_N * np.abs(asked["flow"]))

    def holding(self, prototype: "WithActuator", force_N: float) -> tuple[str, float, float | None, str, str]:
        """Pressure on the smaller side of the piston."""
        needed = force_N / self.smaller_side(prototype)
        return "supply pressure", needed, prototype.supply.pressure_Pa, "Pa", "supply.pressure_Pa"

    def stronger(self, prototype: "WithActuator", force_N: float) -> tuple[Change, ...]:
        """A larger piston, or more pressure."""
        _, needed, supply, *_ = self.holding(prototype, force_N)
        assert supply is not None  # every supply has a pressure
        area = self.piston_area_m2 * needed / supply
        return ("actuator.piston_area_m2", area, True), ("supply.pressure_Pa", needed, True)

    def rows(self, prototype: "WithActuator", need: Mapping[str, float], load_N: float) -> tuple[Row, ...]:
        """See `Actuator`."""
        area, valve, supply = self.piston_area_m2, valve_of(prototype), prototype.supply
        side = self.smaller_side(prototype)
        pressure, flow, unloaded = need["force_N"] / side, need["flow_m3_per_s"], need["no_load_flow_m3_per_s"]
        to_buy = Row.to_buy
        return (
            Row("piston area, mean of both sides", area, None, "m2"),
            Row("bore, as a full circle", (4 * area / pi) ** 0.5, None, "m"),
            Row(
                "load pressure that holds load and weight at rest, F/A", load_N / side, supply.pressure_Pa, "Pa",
                "rest_pressure_Pa",
            ),
            Row("oil spring K_c", self.oil_stiffness_N_per_m, None, "N/m"),
            Row("largest cylinder force", need["force_N"], None, "N", "cylinder_force_N"),
            Row("load pressure at that force", pressure, None, "Pa", "load_pressure_Pa"),
            Row(
                "supply pressure of which the load takes 2/3", pressure / PRESSURE_SHARE, supply.pressure_Pa, "Pa",
                "supply_pressure_Pa",
            ),
            Row("flow through the valve under load", flow, None, "m3/s", "flow_m3_per_s"),
            to_buy("no-load flow of the valve at the given supply", unloaded, None, "m3/s", "no_load_flow_m3_per_s"),
            to_buy("rated current of the valve", need["current_A"], valve.rated_current_A, "A", "rated_current_A"),
            to_buy("flow of the supply", flow, supply.flow_m3_per_s, "m3/s", "supply_flow_m3_per_s"),
            Row("valve flow gain K_q", valve.flow_gain_m3_per_s_per_A, None, "m3/s/A"),
            Row("valve natural frequency", valve.natural_frequency_Hz, None, "Hz"),
            Row("valve damping ratio", valve.damping_ratio, None, "1"),
            Row("leakage K_pq", valve.leakage_m3_per_s_per_Pa, None, "m3/s/Pa"),
        )  # fmt: skip


def valve_of(prototype: "WithActuator") -> Servovalve:
    """The valve of a hydraulic rig."""
    assert prototype.servovalve is not None  # a record is validated to have one with this actuator
    return prototype.servovalve


def _within_parabola(asked: Demand, held: Held, largest: float, stall: float) -> "np.ndarray":
    """Largest F with |q| F + |q_h| <= q_max sqrt(1 - sign(q) (f F + F_h) / stall) at every phase.

    q and f are flow and force at the phase per newton, q_h and F_h what is held; at each phase it is the positive root
    of q^2 F^2 + (2 |q| |q_h| + sign(q) q_max^2 f / stall) F + q_h^2 - q_max^2 (1 - sign(q) F_h / stall) = 0.
    """
    import numpy as np

    flow, force = (np.real(one[:, None] * turn(720)) for one in (asked["flow"], asked["force"]))
    sign = np.sign(flow)
    leaked = abs(held["flow"])
    slope = largest**2 * sign * force / stall + 2 * np.abs(flow) * leaked
    rest = largest**2 * (1 - sign * held["force"] / stall) - leaked**2
    root = np.sqrt(np.maximum(slope**2 + 4 * flow**2 * rest, 0.0))
    # The stable form of the root, whichever sign the slope has.
    amplitude = 2 * np.maximum(rest, 0.0) / np.maximum(slope + root, 1e-300)
    return np.asarray(amplitude.min(axis=1))


KIND = ServoCylinder
