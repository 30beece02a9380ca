"""The equations of a rig: impedances of its parts and of what effects add.

Impedances are solved by bordered determinants, over numbers or over parameters. A figure is a rational, or a polynomial
in the parameters that vary; what is made of figures is then a polynomial in s alone, or in s and these parameters.
Nothing is divided by a figure, so that one piece of code serves both.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from flint import fmpq

from beamdesign.checker.law import SENSED
from beamdesign.checker.work import Unreadable, of_products, spend, times

MOST_COORDINATES = 24
MOST_TERMS = 20_000
"""Of a polynomial in s and parameters."""

Number = Any
"""A rational, or a polynomial in parameters."""
Polynomial = Any
"""In s, or in s and parameters."""
Ring = Callable[[Sequence[Number]], Polynomial]
"""Makes a polynomial of the coefficients of s^0, s^1, ..., such as fmpq_poly."""
Weights = Mapping[str, Number]
"""A motion: weights of coordinates and points."""


class Elements:
    """What effects add to the parts of the rig.

    Attributes:
        impedances: motions, and what resists them: spring, dashpot and mass, N/m, N s/m, kg.
        points: what is added to the motion of "tip", "rod" and "base", and "sensed" to what the sensor sees of the tip;
            "slide", what rubs in the actuator, is the stroke, or the nut of a screw.
        oil: factor on the stiffness of the oil, or on stiffness and damping of a screw.
        spool: spring on the spool, relative to the pilot's.
        asymmetry: of the piston's sides.
        volts: numerators and denominators of what filters the sensor's volts, coefficients of s^0, s^1, ...
    """

    def __init__(self) -> None:
        self.impedances: list[tuple[Weights, Sequence[Number]]] = []
        self.points: dict[str, dict[str, Number]] = {"tip": {}, "rod": {}, "base": {}, "sensed": {}, "slide": {}}
        self.oil: Number = fmpq(1)
        self.spool: Number = fmpq(0)
        self.asymmetry: Number = fmpq(0)
        self.volts: list[tuple[Sequence[Number], Sequence[Number]]] = []


def add_weights(weights: dict[str, Number], more: Weights) -> None:
    """Add a motion to another."""
    for name, weight in more.items():
        weights[name] = weights.get(name, fmpq(0)) + weight


@dataclass(frozen=True)
class Mechanics:
    """Beams, mount, rod and oil: the determinant, and numerators over it.

    Attributes:
        determinant: of its equations.
        moved: what a force on the tip does to the tip, m/N.
        sensed: what the drive does to what is sensed, by its name; of the displacement per volt of the sensor, in m.
        crossed: of each of them, what a force and the drive together do: determinants with both columns replaced.
        strayed: what the drive, and a force between piston and cylinder or on the nut of a screw, do to the tip itself,
            by "drive" and "stroke" or "nut".
    """

    determinant: Polynomial
    moved: Polynomial
    sensed: dict[str, Polynomial]
    crossed: dict[str, Polynomial]
    strayed: dict[str, Polynomial]


@dataclass(frozen=True)
class Parts:
    """The parts of a rig and what effects add to them, of which its equations are made.

    Attributes:
        figure: lumped figures, by name with unit.
        elements: of all effects.
        ring: of the polynomials.
    """

    figure: Mapping[str, Number]
    elements: Elements
    ring: Ring

    def mechanics(
        self, end_masses: tuple[Number, Number], sensed: Sequence[str], disturbed: bool = True, erring: bool = False
    ) -> Mechanics:
        """Beams and oil, and what effects are made of, with masses on the outer and the inner tip.

        The unknowns are the outer beam's first mode, the inner tip, the pressure of the oil, or of each chamber, or the
        nut of a screw, and what the elements name beside; each has one equation, which for a chamber is that of its
        flow times its side and spring. That of a nut is of the forces there, times h^2 and s + w_c: with them goes the
        speed feedback K_t k_w w_c s, and the drive is h K_t w_c times the law's current.

        Args:
            end_masses: outer and inner, kg.
            sensed: names of what is sensed.
            disturbed: whether to work out what a force on the tip does.
            erring: whether to work out what errors within the servo do.
        """
        figure, elements, ring = self.figure, self.elements, self.ring
        none, one, screw = ring([]), fmpq(1), "lead_m_per_rad" in figure
        chambers: dict[str, Number] = {}
        if not screw:
            leak, area = figure["leakage_m3_per_s_per_Pa"], figure["piston_area_m2"]
            # Both chambers show only where their sides differ and leak; else they act as one.
            uneven = elements.asymmetry if leak != 0 else fmpq(0)
            chambers = {"oil_a": 1 + uneven, "oil_b": 1 - uneven} if uneven != 0 else {"oil": one}
        elif elements.spool != 0 or elements.asymmetry != 0:
            raise Unreadable("a screw has neither spool nor piston")
        elif "nut" in elements.points["tip"]:  # whose equation is not that of a force alone
            raise Unreadable("the tip does not ride on the nut of a screw")
        points: dict[str, dict[str, Number]] = {"tip": {"first": one}, "rod": {"inner": one}, "base": {}}
        for point, weights in points.items():
            add_weights(weights, elements.points[point])

        def motion(weights: Weights) -> dict[str, Number]:
            """In coordinates alone."""
            total: dict[str, Number] = {}
            for name, weight in weights.items():
                add_weights(total, {own: weight * share for own, share in points.get(name, {name: one}).items()})
            return total

        tip, stroke = points["tip"], motion({"tip": one, "rod": -one})
        points |= {"sensed": dict(tip), "slide": {"nut": one} if screw else dict(stroke)}
        for point in ("sensed", "slide"):
            add_weights(points[point], elements.points[point])

        def parts() -> Iterator[tuple[dict[str, Number], Polynomial]]:
            """What moves, and the impedance against it."""
            for side, own in (("outer", "first"), ("inner", "inner")):
                bending = [figure[f"{side}_stiffness_N_per_m"], figure[f"{side}_damping_N_s_per_m"]]
                yield motion({own: one, "base": -one}), ring(bending)
            yield {"first": one}, ring([0, 0, figure["outer_mass_kg"]])
            yield {"inner": one}, ring([0, 0, figure["inner_mass_kg"] + end_masses[1]])
            yield tip, ring([0, 0, end_masses[0]])
            if screw:
                yield stretch, resists
            yield from ((motion(moved), ring(resists)) for moved, resists in elements.impedances)

        stretch = motion({"nut": one, "tip": -one, "rod": one})
        thread = [figure[key] for key in ("screw_stiffness_N_per_m", "screw_damping_N_s_per_m")] if screw else []
        resists = ring([elements.oil * value for value in thread])
        network = list(parts())
        own = ["first", "inner", *chambers, *(["nut"] if screw else [])]
        names = list(dict.fromkeys([*own, *(name for moved, _ in network for name in moved)]))
        if len(names) > MOST_COORDINATES:
            raise Unreadable(f"the elements of effects have more than {MOST_COORDINATES} coordinates")
        if loose := ", ".join(sorted({name for weights in points.values() for name in weights} - {*names})):
            raise Unreadable(f"the elements of effects resist no motion of {loose[:100]}, on which a point rides")
        rows: dict[str, dict[str, Polynomial]] = {name: {} for name in names}

        def add(row: str, column: str, value: Polynomial) -> None:
            rows[row][column] = rows[row].get(column, none) + value

        for moved_by, impedance in network:
            for row, share in moved_by.items():
                spend(5 * len(moved_by))
                for column, weight in moved_by.items():
                    add(row, column, share * weight * impedance)
        flow: dict[str, Number] = {}
        if screw:
            weight, lag = figure["lead_m_per_rad"] ** 2, ring([figure["current_loop_rad_per_s"], 1])
            rows["nut"] = {column: weight * lag * value for column, value in rows["nut"].items()}
            feedback = figure["torque_constant_N_m_per_A"] * figure["speed_feedback_A_s_per_rad"]
            add("nut", "nut", lag * ring([0, figure["rotor_friction_N_m_s_per_rad"], figure["rotor_inertia_kg_m2"]]))
            add("nut", "nut", ring([0, feedback * figure["current_loop_rad_per_s"]]))
            flow["nut"] = one
        else:
            spring = elements.oil * figure["oil_stiffness_N_per_m"] / len(chambers)
        for name, side in chambers.items():  # each pushes on the cylinder, towards its own end
            for row, weight in stroke.items():
                add(row, name, ring([-weight * area * side]))
                add(name, row, ring([0, weight * area * side * spring]))
            add(name, name, ring([len(chambers) * leak * spring, area * area * side]))
            flow[name] = side * spring
        matrix = [[rows[row].get(column, none) for column in names] for row in names]

        def through(*ways: tuple[Weights, Weights]) -> Polynomial:
            """The determinant with a border for each way from what drives the equations to a sum of coordinates.

            Over that of `matrix` it is what the sum does when so driven; of two ways, the determinant of their four
            ratios.
            """
            above = [[*[none] * len(ways), *(none + seen.get(name, fmpq(0)) for name in names)] for _, seen in ways]
            beside = [[*(none + by.get(name, fmpq(0)) for by, _ in ways), *matrix[k]] for k, name in enumerate(names)]
            return (-1) ** len(ways) * determinant(above + beside, ring)

        stretched = {name: weight * resists for name, weight in stretch.items()}
        read = {
            "displacement_m": points["sensed"],
            "inner_displacement_m": {"inner": one},
            **({"screw_force_N": stretched} if screw else {"load_pressure_Pa": dict.fromkeys(chambers, one)}),
        }
        if strange := [name for name in sensed if name not in read]:
            raise Unreadable(f"this rig does not show {', '.join(strange)}")
        seen = {name: read[name] for name in sensed}
        strayed: dict[str, Polynomial] = {}
        if erring:
            strayed["drive"] = through((flow, tip))
            strayed |= {"nut": weight * lag * strayed["drive"]} if screw else {"stroke": through((stroke, tip))}
        return Mechanics(
            determinant(matrix, ring),
            through((tip, tip)) if disturbed else none,
            {name: through((flow, where)) for name, where in seen.items()},
            {name: through((tip, tip), (flow, where)) for name, where in seen.items()} if disturbed else {},
            strayed,
        )

    def drive(self) -> tuple[Number, Polynomial]:
        """From the law's current to what drives the mechanics: numerator and denominator.

        That is a flow behind the spool, or, with a screw, the current times the loop's break, K_t and h.
        """
        if "lead_m_per_rad" in self.figure:
            per_ampere = self.figure["torque_constant_N_m_per_A"] * self.figure["lead_m_per_rad"]
            return per_ampere * self.figure["current_loop_rad_per_s"], self.ring([1])
        valve = self.figure["valve_frequency_rad_per_s"]
        spool = self.ring([valve**2 * (1 + self.elements.spool), 2 * self.figure["valve_damping_ratio"] * valve, 1])
        return self.figure["flow_gain_m3_per_s_per_A"] * valve**2, spool

    def filters(self) -> tuple[Polynomial, Polynomial]:
        """What is between the sensor's volts and the controller: numerator and denominator."""
        above = below = self.ring([1])
        if (lag := self.figure.get("filter_frequency_rad_per_s")) is not None:
            above, below = self.ring([lag]), self.ring([lag, 1])
        for over, under in self.elements.volts:
            above, below = times(above, self.ring(over)), times(below, self.ring(under))
        return above, below

    def electronics(
        self, numerators: Mapping[str, Polynomial], denominator: Polynomial
    ) -> tuple[Polynomial, dict[str, Polynomial]]:
        """Controller, filters and valve from what is sensed to the drive: denominator, and a numerator for each sensor.

        Args:
            numerators: of the controller, by what they sense.
            denominator: of the controller.
        """
        gain, spool = self.drive()
        above, lags = self.filters()
        forward = gain * self.figure["sensor_gain_V_per_m"] * times(numerators[SENSED[0]], above)
        # What added sensors read passes none of the lags of the displacement's volts.
        back = {name: gain * times(numerators[name], lags) for name in SENSED[1:] if name in numerators}
        return times(spool * denominator, lags), {SENSED[0]: forward} | back

    def strayed(
        self, moved: Mapping[str, Polynomial], around: Polynomial, own: Polynomial, alone: bool
    ) -> dict[str, Polynomial]:
        """What errors do to the tip where the sensor sees that alone; of friction, where it sees nothing else.

        Args:
            moved: see `Mechanics.strayed`.
            around: denominator of `electronics`.
            own: the loop's numerator from the displacement.
            alone: whether nothing but the displacement is fed back.
        """
        if any(weight != 0 for weight in self.elements.points["sensed"].values()):
            return {}
        gain, spool = self.drive()
        found = {"current": gain * moved["drive"] * (around / spool), "volts": own / self.figure["sensor_gain_V_per_m"]}
        if "flow_gain_m3_per_s_per_A" in self.figure:
            found["flow"] = moved["drive"] * around
        return found | {name: moved[name] * around for name in ("stroke", "nut") if alone and name in moved}


def determinant(matrix: Sequence[Sequence[Polynomial]], ring: Ring) -> Polynomial:
    """Determinant of a matrix of polynomials, by elimination without fractions (Bareiss, 1968)."""
    rows, before, sign = [list(row) for row in matrix], ring([1]), 1
    for k in range(len(rows) - 1):
        spend(of_products(rows[k][k:], [entry for row in rows[k + 1 :] for entry in row[k:]]) / (len(rows) - k))
        pivot = next((i for i in range(k, len(rows)) if rows[i][k] != 0), None)
        if pivot is None:
            return ring([])
        if pivot != k:
            rows[k], rows[pivot], sign = rows[pivot], rows[k], -sign
        for i in range(k + 1, len(rows)):
            for j in range(k + 1, len(rows)):
                rows[i][j] = (rows[k][k] * rows[i][j] - rows[i][k] * rows[k][j]) / before
                if len(rows[i][j]) > MOST_TERMS:
                    raise Unreadable(f"the mechanics come to a polynomial of more than {MOST_TERMS} terms")
        before = rows[k][k]
    return sign * rows[-1][-1]
