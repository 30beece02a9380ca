"""Air in chambers whose volumes follow the stroke: against volumes of oil and gas, and a model that shares no code."""

import casadi as ca
import numpy as np
import pytest
from flint import fmpq
from gap_sets import believed

from beamdesign import Prototype, certify, check
from beamdesign.diagnosis.fitting.hypothesis import NOTHING, Hypothesis, together
from beamdesign.diagnosis.fitting.starts import softened, starts
from beamdesign.loop import close_loop
from beamdesign.plant.assembly import assemble, parameters_of, structure_of
from beamdesign.plant.effects import Operation, library
from beamdesign.plant.effects.entrained_air import bulk_ratio, chamber_length
from beamdesign.plant.members import family
from beamdesign.polynomial import exact
from beamdesign.proofs.box_member import member as box_member
from beamdesign.proofs.rig_family import rig_family
from beamdesign.structure.lumped import figures
from beamdesign.validation.truth.nominal import assembled, rig_figures
from beamdesign.validation.truth.rates import INNER, PRESSURE_A, PRESSURE_B, TIP, rates_at

NAME = "entrained_air_with_stroke"
ATMOSPHERE = 101_325.0


def rates(rig: Prototype, state: dict[str, float]) -> dict[str, float]:
    """Time derivatives of the states, without inputs."""
    assembly = assemble(structure_of(rig))
    x = np.array([state.get(name, 0.0) for name in assembly.states])
    found = assembly.function(0.0, x, np.zeros(3), list(parameters_of(rig, 0.0, 0.0).values()))[0]
    return dict(zip(assembly.states, np.asarray(ca.DM(found)).ravel().tolist(), strict=True))


def airy(supply: float = 10e6, **own: float) -> Prototype:
    rig = believed()
    return rig.but(effects={NAME: own}, supply=rig.supply.but(pressure_Pa=supply))


@pytest.mark.parametrize("exponent", [1.0, 1.2, 1.4])
def test_the_exponent_is_that_of_the_gas(exponent: float):
    """Wylie and Streeter, Fluid Transients: -V dp/dV of oil and a gas with p V^n constant, differentiated here."""
    absolute, modulus, air = 4e6, 1.4e9, 0.1

    def volume(p: float) -> float:
        return (1 - air) * (1 - (p - absolute) / modulus) + air * (ATMOSPHERE / p) ** (1 / exponent)

    slope = (volume(absolute + 100) - volume(absolute - 100)) / 200
    found = bulk_ratio(absolute - ATMOSPHERE, air, modulus, exponent)
    assert float(found) == pytest.approx(-volume(absolute) / slope / modulus, rel=1e-6)


def test_a_chamber_full_of_isothermal_gas_has_the_stiffness_of_its_pressure():
    """Boyle: the bulk modulus of a gas at one temperature is its pressure. Hardly compressible oil leaves the gas."""
    assert float(bulk_ratio(0.0, 0.3, 1e15, 1.0)) * 1e15 * 0.3 == pytest.approx(ATMOSPHERE, rel=1e-6)


def test_without_air_both_chambers_are_two_columns_of_oil():
    """Merritt, chapter 6: beta A^2/V on either side, with the volumes that the stroke leaves; nothing else changes."""
    rig, modulus, stroke, speed = airy(oil_bulk_modulus_Pa=1.4e9, air_fraction=1e-4), 1.4e9, 4e-3, 0.01
    area, spring = rig.actuator.piston_area_m2, rig.actuator.oil_stiffness_N_per_m
    middle = 2 * modulus * area**2 / spring  # m3, which with this oil makes the spring
    at = {"outer_m": stroke, "outer_m_per_s": speed, "pressure_a_Pa": 5e6, "pressure_b_Pa": 5e6}
    found = rates(rig, at)
    assert found["pressure_a_Pa"] == pytest.approx(-modulus * area * speed / (middle + area * stroke), rel=2e-3)
    assert found["pressure_b_Pa"] == pytest.approx(modulus * area * speed / (middle - area * stroke), rel=2e-3)
    linear = rates(rig.but(effects={}), at)
    for name in ("outer_m_per_s", "inner_m_per_s", "flow_m3_per_s2"):
        assert found[name] == pytest.approx(linear[name], rel=1e-12)


def test_no_stroke_empties_a_chamber():
    far = rates(airy(), {"outer_m": 1.0, "outer_m_per_s": 0.01, "pressure_a_Pa": 5e6, "pressure_b_Pa": 5e6})
    assert 0 < far["pressure_b_Pa"] < np.inf
    assert far["pressure_a_Pa"] < 0


def test_pressures_change_as_in_a_model_that_shares_no_code():
    """The truth model of the blind check (`beamdesign.validation.truth`), nothing dissolved, at states of all kinds."""
    supply, modulus, air, exponent, share = 10e6, 1.2e9, 0.1, 1.15, 0.4
    ours = airy(
        supply,
        air_fraction=air,
        oil_bulk_modulus_Pa=modulus,
        polytropic_exponent=exponent,
        leakage_between_share=share,
    )
    habits = {"bulk_modulus": modulus, "supply": supply, "leakage_across": share, "stroke_on": 1.0}
    table = ours.but(effects={}, controller=None).model_dump(exclude_none=True)
    aired = {"air_share": air, "air_exponent": exponent, "air_saturation": 1e30}
    record, modes = assembled(rig_figures(table, {}, habits) | aired | {"gain": 0.0})
    rng = np.random.default_rng(5)
    for _ in range(20):
        tip, inner = rng.uniform(-4e-3, 4e-3, 2)
        a, b = rng.uniform(0.5e6, 9.5e6, 2)
        theirs = np.zeros(36)
        theirs[[TIP, INNER, PRESSURE_A, PRESSURE_B]] = tip, inner, a - supply / 2, b - supply / 2
        theirs[4], theirs[9] = 0.03, -0.02  # speeds of the tips
        expected = rates_at(theirs, record, modes)
        found = rates(
            ours,
            {
                "outer_m": tip, "outer_m_per_s": 0.03, "inner_m": inner, "inner_m_per_s": -0.02,
                "pressure_a_Pa": a, "pressure_b_Pa": b,
            },
        )  # fmt: skip
        assert found["pressure_a_Pa"] == pytest.approx(expected[PRESSURE_A], rel=1e-9)
        assert found["pressure_b_Pa"] == pytest.approx(expected[PRESSURE_B], rel=1e-9)


def test_the_span_holds_every_parallel_stiffness_under_the_load():
    """Both chambers' springs added up here, at every stroke and division of a load between the beams."""
    rig, load, supply = believed(), 400.0, 10e6
    lumped = figures(rig)
    own = {q.name: q.default for q in library()[NAME].parameters}
    span = library()[NAME].linear.figures["stiffness_factor"](own, Operation(lumped, load, supply))
    length = chamber_length(own["oil_bulk_modulus_Pa"], lumped)
    assert length == pytest.approx(2 * 1.4e9 * rig.actuator.piston_area_m2 / rig.actuator.oil_stiffness_N_per_m)
    seen = []
    for held in np.linspace(-load, load, 21):  # by the cylinder, and so by the inner beam
        for whole in (-load, load):
            stroke = (whole - held) / lumped["outer_stiffness"] - held / lumped["inner_stiffness"]
            if abs(whole - held) > load:
                continue
            ratios = [
                float(bulk_ratio(supply / 2 + side * held / lumped["piston_area"] / 2, 0.05, 1.4e9, 1.2))
                for side in (1, -1)
            ]
            seen.append(ratios[0] / (1 + stroke / length) / 2 + ratios[1] / (1 - stroke / length) / 2)
    assert len(seen) > 20
    assert span.low <= min(seen)
    assert max(seen) <= span.high
    assert span.low < span.rest < span.high
    unloaded = library()[NAME].linear.figures["stiffness_factor"](own, Operation(lumped, 0.0, supply))
    assert unloaded.high == 1.0
    assert unloaded.low == unloaded.rest


def test_both_laws_of_air_at_once_are_proved_again():
    """Their factors multiply in the members, in the replay from impedances and in the box between the members."""
    rig = believed()
    rig = rig.but(
        effects={"entrained_air": {"air_fraction": 0.01}, NAME: {"air_fraction": 0.01}},
        controller=rig.controller.but(gain_A_per_V=0.04),
    )
    assert check(certify(rig, 0.0, 6.8).text).valid
    statement = rig_family(rig).over({})
    member = family(rig).members[0]
    factors = {f"{name}_stiffness_factor": exact(own["stiffness_factor"]) for name, own in member.frozen.items()}
    point = rig_family(rig).values | factors | {"outer_end_mass": fmpq(3)}
    box = box_member(statement, point)
    expected = close_loop(member.rig.plant(0.0), rig.controller).at(3.0).characteristic
    found = box.plain + box.late
    assert len(member.frozen) == 2
    assert found * (expected[0] / found[0]) == expected


def test_it_is_a_law_of_entrained_air():
    assert together(NAME, "entrained_air").causes == ("entrained_air",)
    names = [u.name for u in Hypothesis((NAME,)).unknowns(believed())]
    assert "supply_pressure" in names


def test_fits_of_air_begin_where_the_oil_is_as_soft_as_it_has_been_found():
    rig = believed()
    nominal = rig.actuator.oil_stiffness_N_per_m
    for name, exponent in (("entrained_air", 1.4), (NAME, 1.2)):
        unknowns = Hypothesis((name,)).unknowns(rig)
        at = {u.name: k for k, u in enumerate(unknowns)}
        known = {u.name: u.nominal for u in NOTHING.unknowns(rig)} | {"oil_stiffness": 0.3 * nominal}
        new = [k for k, u in enumerate(unknowns) if u.name not in known]
        found = list(softened(unknowns, np.full(len(unknowns), 0.5), new, known))
        assert len(found) > 3
        for z in found:
            supply, air, spring = (
                unknowns[at[key]].value(z[at[key]])
                for key in ("supply_pressure", f"{name}.air_fraction", "oil_stiffness")
            )
            assert spring * float(bulk_ratio(supply / 2, air, 1.4e9, exponent)) == pytest.approx(
                0.3 * nominal, rel=1e-4
            )
            assert z[at["outer_mass"]] == 0.5
        stiff = known | {"oil_stiffness": nominal}
        assert not list(softened(unknowns, np.zeros(len(unknowns)), new, stiff))
        assert not list(softened(unknowns, np.zeros(len(unknowns)), [], known))
    wrong = Hypothesis(("entrained_air", "parameter:oil_stiffness")).unknowns(rig)
    assert not list(softened(wrong, np.zeros(len(wrong)), range(len(wrong)), known))


class Indifferent:
    """Evidence that any start suits."""

    def residual(self, placement: object, z: np.ndarray) -> np.ndarray:
        return np.zeros(1)


def test_the_start_that_keeps_the_oil_soft_is_one_more():
    """However little misfit others leave, and in a quick look as well; without air there are no more than asked."""
    rig = believed()
    known = {u.name: u.nominal for u in NOTHING.unknowns(rig)}
    known["oil_stiffness"] *= 0.3
    placement = Hypothesis((NAME,)).placement(rig)
    found = starts(placement, known, [Indifferent()])
    assert len(found) == 3
    spring = [u.name for u in placement.unknowns].index("oil_stiffness")
    assert placement.unknowns[spring].value(found[-1][spring]) > 0.7 * rig.actuator.oil_stiffness_N_per_m
    assert len(starts(placement, known, [Indifferent()], most=1)) == 2
    assert len(starts(Hypothesis(("sensor_lag",)).placement(rig), known, [Indifferent()])) == 2
