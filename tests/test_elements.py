"""The elements of every effect against the derivatives of its laws, which CasADi takes of the whole rig: in rationals.

A certificate states springs, dashpots, masses and filters; what is proved, simulated and tuned comes of the laws. Both
say the same where the loops that follow from them have the same polynomials, coefficient by coefficient, without any
rounding: parameters are taken as the decimals that they are written as.
"""

from itertools import pairwise, product
from random import Random

import pytest
from flint import fmpq, fmpq_mat, fmpq_poly
from rigs_of_effects import having

from beamdesign import Prototype
from beamdesign.checker.reading import Table
from beamdesign.checker.rig import Loop, Rig
from beamdesign.controllers import SENSED, Observer
from beamdesign.plant.assembly import fits
from beamdesign.plant.effects import Effect, causes, library
from beamdesign.plant.linear import LinearModel
from beamdesign.plant.members import family
from beamdesign.polynomial import exact
from beamdesign.proofs.writer import rig_tables
from beamdesign.prototype import Payload, Sensor

OUTER, INNER = (0.0, 1.3), 0.7  # kg; everything is affine in the outer end mass
SHARES = (0.021, 17.0, -3e-9)
"""A static law of all sensors at once, A/V, A/m and A/Pa: of no particular value, so that nothing hides the other."""
STATIC = Observer(gain_A_per_V=1.0, sensors=SENSED, a=(), b=(), c=(), d=SHARES)


@pytest.fixture
def rig(paper: Prototype) -> Prototype:
    """The published rig with a controller of all sensors and 0.7 kg inside."""
    return paper.but(controller=STATIC, payload=Payload(inner_end_mass_kg=INNER, outer_end_mass_kg=(0.0, 5.0)))


def drawn(effect: Effect, seed: int) -> dict[str, float]:
    """Some parameters of an effect, each in the lower half of what makes sense of it, with four digits."""
    random = Random(f"{effect.name} {seed}")
    return {q.name: float(f"{q.low + random.uniform(0.05, 0.5) * (q.high - q.low):.4g}") for q in effect.parameters}


def from_elements(prototype: Prototype) -> list[Loop]:
    """The loops of what a certificate would state of it."""
    return list(Rig(Table(rig_tables(prototype))).loops())


def derived(plant: LinearModel, outer: float) -> tuple[fmpq_poly, fmpq_poly, fmpq_poly]:
    """Monic: of the open loop and of the closed one; and the numerator of the closed loop's compliance.

    That of c adj(sI - a) b is det(sI - a + b c) - det(sI - a).
    """
    mass, a, b, c = plant.exact_matrices(exact(outer), exact(INNER))
    n, a, b = mass.nrows(), mass.solve(a), mass.solve(b)

    def dyad(source: int, row: list[fmpq]) -> fmpq_mat:
        return fmpq_mat(n, n, [b[i, source] * value for i in range(n) for value in row])

    heard = [sum((exact(d) * c[k + 1, j] for k, d in enumerate(SHARES)), fmpq(0)) for j in range(n)]
    closed = a - dyad(1, heard)
    pushed = (closed - dyad(0, [c[0, j] for j in range(n)])).charpoly()
    return a.charpoly(), closed.charpoly(), pushed - closed.charpoly()


def assert_alike(prototype: Prototype) -> None:
    """Every member of the prototype has the same loop by its laws as by its elements."""
    members, loops = family(prototype).members, from_elements(prototype)
    assert len(members) == len(loops)
    for (member, loop), outer in product(zip(members, loops, strict=True), OUTER):
        opened, closed, pushed = derived(member.rig, outer)
        bare, stated = (p[0] + exact(outer) * p[1] for p in (loop.loop_denominator, loop.closed))
        leading = stated[stated.degree()]
        assert bare / bare[bare.degree()] == opened
        assert stated / leading == closed
        assert loop.disturbance / leading == pushed


@pytest.mark.parametrize("name", causes())
def test_elements_are_what_the_laws_come_to(rig: Prototype, name: str):
    """At the usual parameters and at others, at both ends of every span."""
    for own in ({}, drawn(library()[name], 1)):
        assert_alike(having(rig, name).but(effects={name: own}))


@pytest.mark.parametrize("pair", list(pairwise([*causes(), next(iter(causes()))])), ids="-".join)
def test_elements_of_two_effects_add_up(rig: Prototype, pair: tuple[str, str]):
    bearing = having(rig, *pair)
    assert_alike(bearing.but(effects={name: drawn(library()[name], 2) for name in pair if fits(name, bearing.rig)}))


def test_elements_of_many_effects_add_up_behind_a_filter(rig: Prototype):
    """Whatever moves, mount, second mode and rod, with two chambers that differ."""
    names = ("joint_backlash", "mount_compliance", "second_beam_mode", "sensor_lag", "unequal_piston_areas")
    filtered = rig.but(sensor=Sensor(gain_V_per_m=1180.0, filter_Hz=400.0), effects={name: {} for name in names})
    assert_alike(filtered)


def test_unequal_sides_that_do_not_leak_are_one_spring(rig: Prototype):
    """The mean of both pressures then stays where it is: a root at zero, which shows nowhere."""
    tight = rig.but(servovalve=rig.servovalve.but(leakage_m3_per_s_per_Pa=0.0), effects={"unequal_piston_areas": {}})
    ((opened, closed, pushed),) = (derived(member.rig, OUTER[1]) for member in family(tight).members)
    (loop,) = from_elements(tight)
    stated, still = loop.closed[0] + exact(OUTER[1]) * loop.closed[1], fmpq_poly([0, 1])
    assert still * stated / stated[stated.degree()] == closed
    assert still * loop.disturbance / stated[stated.degree()] == pushed
    assert opened(fmpq(0)) == 0


def test_an_element_that_is_off_shows(rig: Prototype):
    """One digit of one parameter, so that the comparison could fail."""
    softer = rig.but(effects={"mount_compliance": {"stiffness_N_per_m": 5_000_000.0}})
    stiffer = rig.but(effects={"mount_compliance": {"stiffness_N_per_m": 5_000_001.0}})
    (loop,), member = from_elements(softer), family(stiffer).members[0]
    stated = loop.closed[0] + exact(OUTER[1]) * loop.closed[1]
    assert stated / stated[stated.degree()] != derived(member.rig, OUTER[1])[1]
