"""Laws of single effects in plain numbers, against closed forms."""

from math import exp, pi, sqrt

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

from beamdesign.plant.effects import Site, library

SUPPLY = 20e6


def applied(name: str, at: str, signal: float, /, **given: dict[str, float]) -> tuple[float, dict[str, float]]:
    """Signal and rates of an effect's law at one port, its parameters at their defaults unless given."""
    effect = library()[name]
    parameter = {q.name: q.default for q in effect.parameters} | given.get("parameter", {})
    rate: dict[str, float] = {}
    site = Site(
        given.get("port", {}),
        given.get("figure", {}),
        parameter,
        given.get("state", {}),
        rate,
        given.get("time", {}).get("t", 0.0),
    )
    value = float(effect.laws[at](signal, site))
    return value, {key: float(entry) for key, entry in rate.items()}


def test_saturation_clips_and_deadband_takes_off_its_width():
    limited = [applied("current_saturation", "current_A", i, parameter={"limit_A": 0.01})[0] for i in (-1, 0.004, 1)]
    assert limited == [-0.01, 0.004, 0.01]
    width, figure = {"half_width_A": 1e-3}, {"flow_gain": 0.01}
    metered = [
        applied("valve_deadband", "metered_m3_per_s", q, parameter=width, figure=figure)[0]
        for q in (-3e-5, -1e-5, 0.0, 9e-6, 3e-5)
    ]
    assert metered == pytest.approx([-2e-5, 0.0, 0.0, 0.0, 2e-5])


@pytest.mark.parametrize("sharpness", [2.0, 8.0, 30.0])
def test_a_soft_saturation_gives_half_power_of_two_at_its_limit(sharpness: float):
    """Closed form at the knee: u = limit gives limit 2^(-1/n); far from it all, or the limit."""
    given = {"limit_A": 0.01, "sharpness": sharpness}
    small, knee, large = (
        applied("current_saturation_soft", "current_A", i, parameter=given)[0] for i in (-1e-5, 0.01, 10.0)
    )
    assert small == pytest.approx(-1e-5, rel=1e-5)
    assert knee == pytest.approx(0.01 * 2 ** (-1 / sharpness), rel=1e-6)
    assert large == pytest.approx(0.01, rel=1e-5)
    assert applied("current_saturation_soft", "current_A", 0.0, parameter=given)[0] == 0.0


def test_a_lag_of_second_order_is_that_low_pass():
    """Rates at a state against the transfer function, 1 / (1 + T s + (T / 2 zeta)^2 s^2) with T = 1 / (2 pi f)."""
    given, s = {"break_Hz": 300.0, "damping_ratio": 0.7}, 2j * pi * 170.0
    delay = 1 / (2 * pi * 300.0)
    expected = 1 / (1 + delay * s + (delay / 1.4 * s) ** 2)
    real, imaginary = (
        applied(
            "sensor_lag_second_order",
            "sensor_V",
            u,
            parameter=given,
            state={"lagged_V": y, "slope_V_per_s": v},
        )
        for u, y, v in (
            (1.0, expected.real, (s * expected).real),
            (0.0, expected.imag, (s * expected).imag),
        )
    )
    assert real[0] == expected.real
    found = complex(real[1]["slope_V_per_s"], imaginary[1]["slope_V_per_s"])
    assert found == pytest.approx(s**2 * expected, rel=1e-12)
    assert complex(real[1]["lagged_V"], imaginary[1]["lagged_V"]) == pytest.approx(s * expected, rel=1e-12)


@pytest.mark.parametrize("load_share", [-0.6, 0.0, 0.6])
@pytest.mark.parametrize("flow", [-1e-4, 1e-4])
def test_orifices_give_the_root_law_of_the_load_pressure(flow: float, load_share: float):
    """Merritt's critical-centre valve: Q = K i sqrt(1 - sign(i) p_L / p_S), alike in both ports."""
    port = {"supply_pressure_Pa": SUPPLY, "tank_pressure_Pa": 0.0}
    port |= {f"opening_{side}_m3_per_s": flow for side in "ab"}
    port |= {"pressure_a_Pa": SUPPLY / 2 * (1 + load_share), "pressure_b_Pa": SUPPLY / 2 * (1 - load_share)}
    expected = flow * sqrt(1 - np.sign(flow) * load_share)
    for side in "ab":
        found, _ = applied("pressure_dependent_flow", f"orifice_{side}_m3_per_s", flow, port=port)
        assert found == pytest.approx(expected, rel=1e-4)


def test_unloaded_speeds_of_a_cylinder_with_rod_go_with_the_root_of_its_areas():
    """With orifices and no load, extending over retracting speed is sqrt(A_a / A_b) (the two orifice equations)."""
    area_a, area_b = 1.3e-4, 0.9e-4

    def speed(flow: float) -> float:
        def unbalanced(unknown: np.ndarray) -> list[float]:
            port = {
                "supply_pressure_Pa": SUPPLY,
                "tank_pressure_Pa": 0.0,
                "opening_a_m3_per_s": flow,
                "opening_b_m3_per_s": flow,
                "pressure_a_Pa": unknown[0] * SUPPLY,
                "pressure_b_Pa": unknown[1] * SUPPLY,
            }
            into_a, out_of_b = (
                applied("pressure_dependent_flow", f"orifice_{side}_m3_per_s", flow, port=port)[0] for side in "ab"
            )
            force = area_a * unknown[0] - area_b * unknown[1]
            return [
                force / 1e-4,
                into_a / 1e-4 - area_a * unknown[2] / 1e-4,
                out_of_b / 1e-4 - area_b * unknown[2] / 1e-4,
            ]

        return float(fsolve(unbalanced, [0.4, 0.5, np.sign(flow)], xtol=1e-12)[2])

    assert -speed(1e-4) / speed(-1e-4) == pytest.approx(sqrt(area_a / area_b), rel=1e-4)


@pytest.mark.parametrize("pressure", [0.0, 1e6, 10e6, 20e6])
@pytest.mark.parametrize("air", [1e-3, 0.05, 0.2])
def test_air_softens_the_oil_as_the_volumes_say(pressure: float, air: float):
    """Bulk modulus as -V dp/dV of a mixture, differentiated numerically; the oil's own shrinking is left out."""
    absolute, modulus = pressure + 101_325.0, 1.4e9

    def volume(p: float) -> float:
        return (1 - air) * (1 - (p - absolute) / modulus) + air * (101_325.0 / p) ** (1 / 1.4)

    step = 1e-4 * absolute
    expected = -volume(absolute) * 2 * step / (volume(absolute + step) - volume(absolute - step)) / modulus
    found, _ = applied(
        "entrained_air", "bulk_ratio_a", 1.0, parameter={"air_fraction": air}, port={"pressure_a_Pa": pressure}
    )
    assert found == pytest.approx(expected, rel=1e-5)
    assert found < 1


def friction(deflection: float, speed: float, **parameter: float) -> tuple[float, float]:
    value, rate = applied(
        "seal_friction",
        "friction_N",
        0.0,
        parameter=parameter,
        state={"deflection": deflection},
        port={"sliding_m_per_s": speed},
    )
    return value, rate["deflection"]


def test_friction_slides_at_coulombs_force_and_slips_as_dahl_says():
    figures = {"coulomb_N": 50.0, "presliding_m": 1e-5}
    assert friction(1.0, 0.02, **figures) == pytest.approx((50.0, 0.0))
    assert friction(-1.0, -0.02, **figures) == pytest.approx((-50.0, 0.0))
    speed = 1e-4  # far below the speed at which settling is bounded
    moved = solve_ivp(lambda t, z: [friction(z[0], speed, **figures)[1]], (0, 0.3), [0.0], rtol=1e-9, atol=1e-12)
    assert moved.y[0, -1] == pytest.approx(1 - exp(-0.3 * speed / 1e-5), rel=1e-5)


def test_friction_follows_stribeck_and_viscous_terms():
    speed = 0.004
    force, _ = friction(
        1.0, speed, coulomb_N=50.0, breakaway_ratio=1.5, stribeck_m_per_s=0.005, viscous_N_s_per_m=100.0
    )
    assert force == pytest.approx(50 * (1 + 0.5 * exp(-((speed / 0.005) ** 2))) + 100 * speed)


def test_hysteresis_loop_has_the_stated_width():
    """Slow sinusoidal current: at zero current the spool is off by the half width, one way or the other."""
    half, gain, frequency, damping = 1e-4, 0.0113, 2 * pi * 150, 0.5

    def rates(t: float, s: np.ndarray) -> list[float]:
        current, rate = applied(
            "valve_hysteresis",
            "spool_A",
            2e-3 * np.sin(2 * pi * t),
            parameter={"half_width_A": half},
            figure={"flow_gain": gain},
            state={"friction": s[2]},
            port={"flow_m3_per_s2": s[1]},
        )
        return [s[1], frequency**2 * (gain * current - s[0]) - 2 * damping * frequency * s[1], rate["friction"]]

    found = solve_ivp(rates, (0, 1.5), [0, 0, 0], rtol=1e-6, atol=[1e-10, 1e-7, 1e-6], t_eval=[1.0, 1.5], max_step=5e-3)
    lag = 2 * damping / frequency * 2e-3 * 2 * pi  # what the spool's own dynamics hold back at this rate of current
    assert found.y[0] / gain == pytest.approx([-half - lag, half + lag], rel=1e-2)


@pytest.mark.parametrize(
    ("sharpness", "steepness", "turned", "expected"),
    [
        (1.0, 1.0, 0.0, lambda x: 1 - np.exp(-x)),  # Dahl's law
        (2.0, 0.7, 0.0, np.tanh),  # from rest z' = 1 - z^2, whatever it does on its return
        (2.0, 0.5, 0.9, lambda x: 0.9 - x),  # a return no steeper than from rest is straight
        (1.0, 1.0, 0.9, lambda x: 1.9 * np.exp(-x) - 1),
        (1.0, 0.75, 0.9, lambda x: 2.9 * np.exp(-x / 2) - 2),
    ],
)
def test_spool_friction_is_the_closed_form_of_bouc_and_wen(sharpness, steepness, turned, expected):
    """z over the spool's way x, in travels, from rest and, where it has been `turned` about, up to where z is none."""
    given = {"half_width_A": 1e-4, "travel": 1.0, "sharpness": sharpness, "steepness": steepness}
    side = -1.0 if turned else 1.0

    def rate(x: float, z: np.ndarray) -> list[float]:
        _, found = applied(
            "valve_hysteresis",
            "spool_A",
            0.0,
            parameter=given,
            figure={"flow_gain": 0.01},
            state={"friction": z[0]},
            port={"flow_m3_per_s2": side * 1e-6},  # one travel per second
        )
        return [found["friction"]]

    way = np.linspace(0.0, 0.6 if turned else 2.0, 7)
    found = solve_ivp(rate, (0, way[-1]), [turned], t_eval=way, rtol=1e-9, atol=1e-9).y[0]
    assert found == pytest.approx(expected(way), abs=1e-3)


@pytest.mark.parametrize("sharpness", [1.0, 1.7, 3.0])
@pytest.mark.parametrize("steepness", [0.5, 0.8, 1.0])
def test_spool_friction_stays_within_what_proofs_say_of_it(sharpness: float, steepness: float):
    """Slopes over the spool's way from 0 to 2, and none outward once it is full: it never exceeds its half width."""
    given = {"half_width_A": 1e-4, "travel": 1.0, "sharpness": sharpness, "steepness": steepness}
    for friction in np.linspace(-1.0, 1.0, 41):
        state, port = {"friction": friction}, {"flow_m3_per_s2": 1e-6}  # one travel per second
        _, rate = applied(
            "valve_hysteresis", "spool_A", 0.0, parameter=given, figure={"flow_gain": 0.01}, state=state, port=port
        )
        assert -1e-12 <= rate["friction"] <= 2.0
        if friction == 1.0:
            assert rate["friction"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("ratio", [0.05, 0.2, 0.5])
def test_rounded_edges_open_gradually(ratio: float):
    """At null a slope of 1 - 1/sqrt(1 + r^2); at an edge half the clearance; far beyond it, all but the overlap."""
    overlap = 0.01 * 1e-3

    def metered(flow: float) -> float:
        given = {"half_width_A": 1e-3, "clearance_ratio": ratio}
        return applied("valve_deadband_rounded", "metered_m3_per_s", flow, parameter=given, figure={"flow_gain": 0.01})[
            0
        ]

    assert metered(1e-9) / 1e-9 == pytest.approx(1 - 1 / sqrt(1 + ratio**2), rel=1e-4)
    behind = (2 - sqrt(4 + ratio**2)) / 2  # what the other edge still opens, two overlaps away
    assert metered(overlap) == pytest.approx((ratio / 2 + behind) * overlap, rel=1e-9)
    assert metered(100 * overlap) == pytest.approx(99 * overlap, rel=1e-3)
    assert metered(-0.7 * overlap) == -metered(0.7 * overlap)


def test_backlash_is_free_within_its_play_and_a_spring_beyond():
    figures = {"play_m": 1e-4, "stiffness_N_per_m": 5e7, "rod_mass_kg": 0.3}
    for apart, expected in ((0.0, 0.0), (4.9e-5, 0.0), (6e-5, 500.0), (-6e-5, -500.0)):
        force, rate = applied(
            "joint_backlash",
            "inner_force_N",
            -40.0,
            parameter=figures,
            state={"rod_m": apart, "rod_m_per_s": 0.0},
            port={"inner_m": 0.0, "inner_m_per_s": 0.0, "inner_reaction_N": 25.0, "actuator_force_N": 40.0},
            figure={"inner_mass": 1.6, "inner_end_mass": 0.4},
        )
        assert force == pytest.approx(expected, abs=1e-6)
        assert rate["rod_m_per_s"] == pytest.approx((-40.0 - expected) / 0.3)
    parting, _ = applied(
        "joint_backlash",
        "inner_force_N",
        0.0,
        parameter=figures,
        state={"rod_m": 5.1e-5, "rod_m_per_s": -1.0},
        port={"inner_m": 0.0, "inner_m_per_s": 0.0, "inner_reaction_N": 25.0, "actuator_force_N": 0.0},
        figure={"inner_mass": 1.6, "inner_end_mass": 0.4},
    )
    assert parting == 0.0  # a joint that parts does not pull


@pytest.mark.parametrize("counted", [0.0, 0.5, 1.0])
def test_a_rod_that_was_weighed_with_the_inner_beam_is_not_counted_twice(counted: float):
    # Newton for the tip alone: what is left of its mass, times its acceleration, is the joint's force less the beam's.
    force, rate = applied(
        "joint_backlash",
        "inner_force_N",
        -40.0,
        parameter={"play_m": 1e-4, "stiffness_N_per_m": 5e7, "rod_mass_kg": 0.3, "counted_share": counted},
        state={"rod_m": 6e-5, "rod_m_per_s": 0.0},
        port={"inner_m": 0.0, "inner_m_per_s": 0.0, "inner_reaction_N": 25.0, "actuator_force_N": 40.0},
        figure={"inner_mass": 1.6, "inner_end_mass": 0.4},
    )
    acceleration = (force - 25.0) / 2.0  # as the rig works it out
    assert (2.0 - 0.3 * counted) * acceleration == pytest.approx(500.0 - 25.0)
    assert rate["rod_m_per_s"] == pytest.approx((-40.0 - 500.0) / 0.3)


def test_ripple_rides_on_the_signal():
    parameter = {"frequency_Hz": 500.0, "depth": 0.1, "residual_V": 0.01}
    value, _ = applied("carrier_ripple", "sensor_V", 2.0, parameter=parameter, time={"t": 0.5e-3})
    assert value == pytest.approx(2.0 * 1.1 + 0.01)


@pytest.mark.parametrize("flow", [-1e-4, 1e-4])
def test_the_piston_moves_by_the_area_of_the_side_that_fills(flow: float):
    bore, mean = pi * 0.0127**2 / 4, 1.13e-4
    asymmetry = (bore - mean) / mean
    side = bore if flow > 0 else 2 * mean - bore
    for port, area in (("linear_a_m3_per_s", bore), ("linear_b_m3_per_s", 2 * mean - bore)):
        found, _ = applied("unequal_piston_areas", port, flow, parameter={"asymmetry": asymmetry})
        assert found / area == pytest.approx(flow / side)


@pytest.mark.parametrize("asymmetry", [-0.2, 0.2])
def test_about_null_the_smaller_side_counts(asymmetry: float):
    """The paper's finding, and what a linearisation at rest has to see."""
    parameter = {"asymmetry": asymmetry}
    areas = [applied("unequal_piston_areas", f"area_{side}_m2", 1.0, parameter=parameter)[0] for side in "ab"]
    assert areas == pytest.approx([1 + asymmetry, 1 - asymmetry])
    flow = ca.SX.sym("flow")
    site = Site({}, {}, parameter, {}, {}, 0.0)
    for side, area in zip("ab", areas, strict=True):
        passed = library()["unequal_piston_areas"].laws[f"linear_{side}_m3_per_s"](flow, site)
        slope = ca.Function("slope", [flow], [ca.jacobian(passed, flow)])
        assert float(slope(0.0)) / area == pytest.approx(1 / min(areas))
