"""One plane of an arm over a range of payloads: bending of both beams, and torsion where the payload has a lever on it.

The end of the outer beam moves by u in the plane, turns by 3 u / 2L and twists by phi; a payload at [x, y, z] from it
is a point mass on a rigid lever. Its equilibrium with tip and twist is solved by Cramer's rule at single payloads,
where the prover has closed forms in the payload; stability and inequalities are then settled as over a range of outer
end masses, by other methods than the prover's. Torsional figures follow from [arm] and from the section stated.
"""

from collections.abc import Callable

from flint import arb, fmpq, fmpq_poly

from beamdesign.checker.mass_range import Bound, magnitudes, stability
from beamdesign.checker.prototype import Section, agree
from beamdesign.checker.reading import Statements, Table, Unreadable, judged, short
from beamdesign.checker.rig import Loop, Rig
from beamdesign.checker.roots import ZERO, Family, Polynomials, S, Slack, plus

CLAIMS = ("tip_compliance", "load_compliance", "peak_sensitivity", "loop_gain", "controller_effort")
TORSION_SHARE = fmpq(1, 3)
"""Of a tube's polar inertia that turns with its end, where the twist grows evenly (Rayleigh)."""


def statements(table: Table, rig: Rig) -> Statements:
    """Every statement of the certificate: whether it was proved, and it or its failure in words."""
    masses = table.range("outer_end_mass_kg", least=0)
    if rig.effects:
        raise Unreadable("an arm is proved without effects")
    (loop,) = rig.loops()
    arm = Arm(table, rig)
    for holds, words in arm.statements(rig):
        yield holds, words if holds else f"not so: {words}"
    plane = Plane(loop, arm)
    yield from stability(table.table("stability"), Family(*plane.closed), *masses)
    stable = Family(*plane.closed).is_stable_over(*masses)
    for claim in table.tables("claim"):
        bound, holds = Bound(claim, claim.word("kind", *CLAIMS)), claim.flag("holds")
        slack = Slack(bound.limit, *plane.ratio(bound.kind))
        yield judged(stable and slack.nonnegative(*masses, bound.until, bound.start), bound.words, holds)


class Arm:
    """What [arm] and [plane] state.

    Attributes:
        name: of the plane, the direction in which the tip moves.
        offset: the payload's centre from the tip: along the beam, sideways, upwards, m.
        sensor: where the servos measure, likewise.
        length: of the outer beam, clamp to tip, m.
        stiffness: of the outer beam's tip, N/m.
        travel: of the payload in the plane, per motion of the tip.
        along: of the payload along the beam, likewise.
        lever: of the payload on torsion, m.
        torsion: its stiffness, damping and polar inertia, N m/rad, N m s/rad and kg m2; one where it has no part.
    """

    def __init__(self, table: Table, rig: Rig) -> None:
        stated, arm = table.table("plane"), table.optional("arm")
        self.name = stated.word("name", "y", "z")
        if "plane" in arm:  # of its records, whichever this one is
            arm.word("plane", "y", "z")
        origin = [fmpq(0)] * 3
        points = {key: arm.numbers(key, 3) for key in ("offset_m", "sensor_m", "tool_m") if key in arm}
        self.offset, self.sensor = points.get("offset_m", origin), points.get("sensor_m", origin)
        self.length = stated.at_least("free_length_m", 0, above=True)
        self.stiffness = rig.figures["outer_stiffness_N_per_m"]
        x, y, z = self.offset
        turning = fmpq(3, 2) / self.length  # of the end, per deflection under a force on it
        self.travel, self.along = 1 + turning * x, turning * (y if self.name == "y" else z)
        self.lever = -z if self.name == "y" else y
        if self.along != 0 and self.lever != 0:
            raise Unreadable("a payload that stands off to both sides couples both planes")
        self.torsion = [fmpq(1)]
        if self.lever != 0:
            torsion, keys = stated.table("torsion"), ("stiffness_N_m_per_rad", "polar_inertia_kg_m2")
            spring, inertia = (torsion.at_least(key, 0, above=True) for key in keys)
            self.torsion = [spring, torsion.at_least("damping_N_m_s_per_rad", 0), inertia]
        keys = ("end_polar_inertia_kg_m2", "payload_polar_inertia_kg_m2")
        self._added = sum((arm.at_least(key, 0) for key in keys if key in arm), fmpq(0))
        keys = ("torsional_stiffness_N_m_per_rad", "torsional_damping_ratio")
        self._given, self._ratio = (arm.at_least(key, 0) if key in arm else None for key in keys)
        self._second = arm.table("second_controller").whole_of_it() if "second_controller" in arm else None
        coupled = self.lever != 0 and "section" in stated
        self._section = OuterTube(stated.table("section"), table) if coupled else None

    def statements(self, rig: Rig) -> Statements:
        """How the payload takes part, and that what is stated twice agrees, but for the rounding of floats."""
        words = f"plane {self.name}, {short(self.length)} m long: the payload moves {short(self.travel)} times as far"
        yield True, f"{words} as the tip, and torsion has {'a' if self.lever != 0 else 'no'} part in it"
        if self.name == "y" and self._second is not None and rig.law is not None:
            yield rig.law.figures == self._second, "the controller is the second one, which acts in y"
        if self.lever == 0:
            return
        stiffness, damping, inertia = self.torsion
        section, turning = self._section, arb(self._added)
        if section is not None:
            turning += arb(TORSION_SHARE * section.density * self.length) * section.tube.polar
        words = "polar inertia is that of end module and payload" + ("" if section is None else " and tube")
        yield agree(inertia, turning), f"{words}: {short(inertia)} kg m2"
        words = f"torsional stiffness {short(stiffness)} N m/rad"
        if self._given is not None:
            yield stiffness == self._given, f"{words} is that of [arm]"
        elif section is not None:
            computed = arb(section.shear_modulus / self.length) * section.tube.torsion_constant
            yield agree(stiffness, computed), f"{words} is that of the section"
        else:
            yield False, f"{words} is given by [arm] or a section"
        # The ratio of bending where none is stated: that of the outer beam's own dashpot.
        bending = arb(4 * self.stiffness * rig.figures["outer_mass_kg"]).sqrt()
        ratio = arb(rig.figures["outer_damping_N_s_per_m"]) / bending if self._ratio is None else arb(self._ratio)
        damped = agree(damping, 2 * ratio * (arb(stiffness) * arb(inertia)).sqrt())
        yield damped, f"torsional damping {short(damping)} N m s/rad is that of the damping ratio"


class OuterTube:
    """The outer beam's tube, and what it is of; square or round, as it bends in both planes alike."""

    def __init__(self, table: Table, certificate: Table) -> None:
        shape = table.word("shape", "square", "round") if "shape" in table else "square"
        width, wall = (table.at_least(key, 0, above=True) for key in ("width_m", "wall_m"))
        self.tube = Section(shape, width, wall, table.at_least("corner_radius_m", 0))
        name = table.word("material")
        alloy = Table(certificate.optional("material").whole_of_it().get(name), f"material.{name[:60]}")
        self.shear_modulus = alloy.at_least("shear_modulus_Pa", 0, above=True)
        self.density = alloy.at_least("density_kg_per_m3", 0, above=True)


class Plane:
    """The loop of one plane, each polynomial as (constant, slope) in the payload.

    Attributes:
        closed: characteristic polynomial.
        loop_denominator: denominator of L.
        loop_numerator: numerator of L.
        compliances: numerators over `closed`, by the claim that is about them.
        law: the controller behind the displacement sensor.
    """

    def __init__(self, loop: Loop, arm: Arm) -> None:
        self._travel, self._along, self._lever = arm.travel, arm.along, arm.lever
        self._seen = 1 + 3 * arm.sensor[0] / (2 * arm.length)
        self._seen_roll = -arm.sensor[2] if arm.name == "y" else arm.sensor[1]
        self._twist = fmpq_poly(arm.torsion)
        # The end is held and turns under the moment F x: x^2 L / 4 E I, with E I = K L^3 / 3.
        rest = 3 * arm.offset[0] / (4 * arm.stiffness * arm.length**2)
        self._rest, self._seen_rest = rest * arm.offset[0], rest * arm.sensor[0]
        self._fed, self._pushed, self.law = loop.displacement[0], loop.disturbance, loop.law
        open_, closed = loop.loop_denominator, loop.closed
        # With the displacement cut off, and added sensors not.
        cut = plus(closed, loop.displacement, -1)
        if loop.displacement[1] != 0 or cut[1] != S * S * self._pushed:
            raise Unreadable("the payload does not act on the tip that the force acts on")
        self.closed = _affine(lambda m: self._determinant(*self._tip(cut, m, self._fed), m))
        self.loop_denominator = _affine(lambda m: self._determinant(*self._tip(open_, m, ZERO), m))
        self.loop_numerator = plus(self.closed, self.loop_denominator, -1)
        self.compliances = {
            "tip_compliance": _affine(lambda m: self._pushed * self._twisted(m)),
            "load_compliance": _affine(lambda m: self._load(*self._tip(cut, m, self._fed), m)),
        }

    def _twisted(self, m: fmpq) -> fmpq_poly:
        return self._twist + m * self._lever**2 * S * S

    def _both(self, m: fmpq) -> fmpq_poly:
        """Force on the tip per twist, and moment per motion of the tip."""
        return m * self._travel * self._lever * S * S

    def _tip(self, part: Polynomials, m: fmpq, fed: fmpq_poly) -> Polynomials:
        """The tip's equation times the denominator of its compliance: what tip and twist do in it."""
        constant, per_mass = part  # s^2 and that denominator
        tip = constant + m * (self._travel**2 + self._along**2) * per_mass + self._seen * fed
        return tip, m * self._travel * self._lever * per_mass + self._seen_roll * fed

    def _determinant(self, tip: fmpq_poly, twist: fmpq_poly, m: fmpq) -> fmpq_poly:
        return tip * self._twisted(m) - twist * self._both(m)

    def _load(self, tip: fmpq_poly, twist: fmpq_poly, m: fmpq) -> fmpq_poly:
        """Motion of the payload in the plane under a force there."""
        pushed = self._travel * self._pushed - self._seen_rest * self._fed
        moved = pushed * self._twisted(m) - self._lever * twist
        turned = self._lever * tip - pushed * self._both(m)
        return self._travel * moved + self._lever * turned + self._rest * self._determinant(tip, twist, m)

    def ratio(self, kind: str) -> tuple[Polynomials, Polynomials]:
        """Denominator and numerator of what a claim bounds."""
        if kind in self.compliances:
            return self.closed, self.compliances[kind]
        return magnitudes(kind, self.loop_denominator, self.loop_numerator, ZERO, self.law)


def _affine(value: Callable[[fmpq], fmpq_poly]) -> Polynomials:
    """Constant and slope of what is affine in the payload, which is checked: it is of degree 3 at most."""
    at = [value(fmpq(m)) for m in range(4)]
    if any(at[k] - at[k - 1] != at[1] - at[0] for k in (2, 3)):
        raise Unreadable("the loop is not affine in the payload")
    return at[0], at[1] - at[0]
