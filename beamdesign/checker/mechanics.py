"""The equations of a rig: impedances of its parts and of what effects add, and, without effects, x' = A(m) x.

Impedances are solved by Cramer's rule, over numbers or over parameters. A figure is a rational, or a polynomial in the
parameters that vary; what is made of figures is then a polynomial in s alone, or in s and these parameters. Nothing is
divided by a figure, so that one piece of code serves both.

The closed loop as x' = A(m) x is from equations (7) to (16) of Zalucky and Hardt (1984). Lyapunov functions are of
states, so these are the prover's; that one builds its matrices by differentiating the assembled rig, this writes down
the equations.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from flint import fmpq, fmpq_mat

from beamdesign.checker.law import SENSED, Law, Stage
from beamdesign.checker.reading import Unreadable

if TYPE_CHECKING:
    from beamdesign.checker.rig import Rig

# Impedances.


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
        points: what is added to the motion of "tip", "rod" and "base", and "sensed" to what the sensor sees of the tip.
        oil: factor on the stiffness of the oil.
        spool: spring on the spool, relative to the pilot's.
        asymmetry: of the piston's sides.
        volts: numerators and denominators of what filters the sensor's volts, coefficients of s^0, s^1, ...
    """

    def __init__(self) -> None:
        self.impedances: list[tuple[Weights, Sequence[Number]]] = []
        self.points: dict[str, dict[str, Number]] = {"tip": {}, "rod": {}, "base": {}, "sensed": {}}
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
        sensed: what a flow does to what is sensed, by its name; of the displacement per volt of the sensor, in m.
        crossed: of each of them, what a force and a flow together do: determinants with both columns replaced.
        strayed: what a flow, and a force between piston and cylinder, do to the tip itself, by "flow" and "stroke".
    """

    determinant: Polynomial
    moved: Polynomial
    sensed: dict[str, Polynomial]
    crossed: dict[str, Polynomial]
    strayed: dict[str, Polynomial]


def mechanics(
    figure: Mapping[str, Number],
    elements: Elements,
    end_masses: tuple[Number, Number],
    sensed: Sequence[str],
    ring: Ring,
    disturbed: bool = True,
    erring: bool = False,
) -> Mechanics:
    """Beams and oil, and what effects are made of, with masses on the outer and the inner tip.

    The unknowns are the outer beam's first mode, the inner tip, the pressure of the oil, or of each chamber, and what
    the elements name beside; each has one equation, which for a chamber is that of its flow times its side and spring.

    Args:
        figure: lumped figures, by name with unit.
        elements: of all effects.
        end_masses: outer and inner, kg.
        sensed: names of what is sensed.
        ring: of the polynomials.
        disturbed: whether to work out what a force on the tip does.
        erring: whether to work out what errors within the servo do.
    """
    none, one = ring([]), fmpq(1)
    leak, area = figure["leakage_m3_per_s_per_Pa"], figure["piston_area_m2"]
    # Both chambers show only where their sides differ and leak; else they act as one.
    uneven = elements.asymmetry if leak != 0 else fmpq(0)
    chambers = {"oil_a": 1 + uneven, "oil_b": 1 - uneven} if uneven != 0 else {"oil": one}
    points: dict[str, dict[str, Number]] = {"tip": {"first": one}, "rod": {"inner": one}, "base": {}}
    for point, weights in points.items():
        add_weights(weights, elements.points[point])
    points["sensed"] = dict(points["tip"])
    add_weights(points["sensed"], elements.points["sensed"])

    def motion(weights: Weights) -> dict[str, Number]:
        """In coordinates alone."""
        total: dict[str, Number] = {}
        for name, weight in weights.items():
            for coordinate, share in points.get(name, {name: one}).items():
                total[coordinate] = total.get(coordinate, fmpq(0)) + weight * share
        return total

    def parts() -> Iterator[tuple[dict[str, Number], Polynomial]]:
        """What moves, and the impedance against it."""
        for side, own in (("outer", "first"), ("inner", "inner")):
            bending = [figure[f"{side}_stiffness_N_per_m"], figure[f"{side}_damping_N_s_per_m"]]
            yield motion({own: one, "base": -one}), ring(bending)
        yield {"first": one}, ring([0, 0, figure["outer_mass_kg"]])
        yield {"inner": one}, ring([0, 0, figure["inner_mass_kg"] + end_masses[1]])
        yield points["tip"], ring([0, 0, end_masses[0]])
        yield from ((motion(moved), ring(resists)) for moved, resists in elements.impedances)

    network = list(parts())
    names = list(dict.fromkeys(["first", "inner", *chambers, *(name for moved, _ in network for name in moved)]))
    if len(names) > MOST_COORDINATES:
        raise Unreadable(f"the elements of effects have more than {MOST_COORDINATES} coordinates")
    rows: dict[str, dict[str, Polynomial]] = {name: {} for name in names}

    def add(row: str, column: str, value: Polynomial) -> None:
        rows[row][column] = rows[row].get(column, none) + value

    for moved_by, impedance in network:
        for row, share in moved_by.items():
            for column, weight in moved_by.items():
                add(row, column, share * weight * impedance)
    stroke, tip = motion({"tip": one, "rod": -one}), points["tip"]
    count = len(chambers)
    spring = elements.oil * figure["oil_stiffness_N_per_m"] / count
    flow = [fmpq(0)] * len(names)
    for name, side in chambers.items():  # each pushes on the cylinder, towards its own end
        for row, weight in stroke.items():
            add(row, name, ring([-weight * area * side]))
            add(name, row, ring([0, weight * area * side * spring]))
        add(name, name, ring([count * leak * spring, area * area * side]))
        flow[names.index(name)] = side * spring
    matrix = [[rows[row].get(column, none) for column in names] for row in names]

    def replaced(columns: Mapping[str, Sequence[Number]]) -> Polynomial:
        """The determinant with the columns of some unknowns replaced by what drives each equation."""
        return determinant(
            [
                [ring([columns[name][k]]) if name in columns else row[j] for j, name in enumerate(names)]
                for k, row in enumerate(matrix)
            ],
            ring,
        )

    def moved(by: Sequence[Number], seen: Weights) -> Polynomial:
        """Numerator of a sum of coordinates over the forces that drive each equation."""
        return sum((weight * replaced({name: by}) for name, weight in seen.items() if name in names), none)

    def crossed(seen: Weights) -> Polynomial:
        """The tip by a force and a sum of coordinates by a flow, in one determinant."""
        total = none
        for first, share in tip.items():
            for name, weight in seen.items():
                if name in names and name != first:
                    total += share * weight * replaced({first: force, name: flow})
        return total

    force = [tip.get(name, fmpq(0)) for name in names]
    read = {
        "displacement_m": points["sensed"],
        "inner_displacement_m": {"inner": one},
        "load_pressure_Pa": dict.fromkeys(chambers, one),
    }
    seen = {name: read[name] for name in sensed}
    pulled = [stroke.get(name, fmpq(0)) for name in names]
    return Mechanics(
        determinant(matrix, ring),
        moved(force, tip) if disturbed else none,
        {name: moved(flow, where) for name, where in seen.items()},
        {name: crossed(where) for name, where in seen.items()} if disturbed else {},
        {"flow": moved(flow, tip), "stroke": moved(pulled, tip)} if erring else {},
    )


def determinant(matrix: Sequence[Sequence[Polynomial]], ring: Ring) -> Polynomial:
    """Determinant of a matrix of polynomials, by elimination without fractions (Bareiss, 1968)."""
    rows, before, sign = [list(row) for row in matrix], ring([1]), 1
    for k in range(len(rows) - 1):
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


# The closed loop as x' = A(m) x.


MOST_STATES = 32
MOST_BITS = 2_048
"""Of the numerators and of the common denominator of a matrix."""
VELOCITY = 1
"""Place of the state that is the velocity of the outer tip, in whose row alone the mass is."""
_PLANT = ("x", "v", "c", "y", "u", "q", "r")
"""Tip, its velocity, cylinder, inner tip, its velocity, flow, its rate."""

Row = list[fmpq]


class StateSpace:
    """The closed loop with one law.

    The states are X_m, X_m', X_c, X_f, X_f', Q_0, Q_0', the filtered volts where there is a filter, and those of the
    law: of one that stays in observer form; of a stage those that all stages share and none resets, output and rate of
    each second-order section and the current.

    Attributes:
        bare_mass: M_m, kg.
        order: number of states.
    """

    def __init__(self, rig: "Rig", law: Law | Stage) -> None:
        if rig.effects:
            raise Unreadable("the equations of a changing payload have no effects")
        self.bare_mass = rig.figures["outer_mass_kg"]
        if isinstance(law, Law) and any(one.degree() > law.order for one in law.numerators.values()):
            raise Unreadable("the controller differentiates: its numerator is of higher degree than its denominator")
        first = len(_PLANT) + ("filter_frequency_rad_per_s" in rig.figures)
        self.order = first + law.order
        if self.order > MOST_STATES:
            raise Unreadable(f"the loop has {self.order} states, more than {MOST_STATES}")
        self._rows = [[fmpq(0)] * self.order for _ in range(self.order)]
        sensed = self._plant(rig)
        into = self._rows[_PLANT.index("r")]
        drive = rig.figures["valve_frequency_rad_per_s"] ** 2 * rig.figures["flow_gain_m3_per_s_per_A"]
        close = _close if isinstance(law, Law) else _close_stage
        for j, weight in enumerate(close(self._rows, first, sensed, law)):  # type: ignore[arg-type]
            into[j] += drive * weight
        bounded(self.matrix(fmpq(0)))

    def matrix(self, mass: fmpq) -> fmpq_mat:
        """A(m), (order, order)."""
        total = self.bare_mass + mass
        rows = ([entry / total for entry in row] if k == VELOCITY else row for k, row in enumerate(self._rows))
        return fmpq_mat(self.order, self.order, [entry for row in rows for entry in row])

    def _plant(self, rig: "Rig") -> dict[str, Row]:
        """Fill in the rows of the rig; what is sensed, as rows over the states."""
        f, rows = rig.figures, self._rows
        x, v, c, y, u, q, r = range(len(_PLANT))
        area, oil, w = f["piston_area_m2"], f["oil_stiffness_N_per_m"], f["valve_frequency_rad_per_s"]
        rows[x][v] = fmpq(1)
        # (7), (9), (11): (M_m + m) X_m'' = K_c (X_c - X_m) - K_m X_m - b_m X_m', which `matrix` divides by the mass
        rows[v][c] = oil
        rows[v][x], rows[v][v] = -oil - f["outer_stiffness_N_per_m"], -f["outer_damping_N_s_per_m"]
        # (14) to (16): X_c' = X_f' + (Q_0 - K_pq K_c (X_c - X_m) / A) / A
        leak = f["leakage_m3_per_s_per_Pa"] * oil / (area * area)
        rows[c][u], rows[c][q], rows[c][c], rows[c][x] = fmpq(1), 1 / area, -leak, leak
        # (8), (10): (M_f + n) X_f'' = -K_c (X_c - X_m) - K_f X_f - b_f X_f'
        inner = f["inner_mass_kg"] + rig.inner_end_mass
        rows[y][u] = fmpq(1)
        rows[u][c], rows[u][x] = -oil / inner, oil / inner
        rows[u][y], rows[u][u] = -f["inner_stiffness_N_per_m"] / inner, -f["inner_damping_N_s_per_m"] / inner
        # (13): Q_0'' = w^2 (K_q I - Q_0) - 2 xi w Q_0'
        rows[q][r] = fmpq(1)
        rows[r][q], rows[r][r] = -w * w, -2 * f["valve_damping_ratio"] * w
        gain, filtered = f["sensor_gain_V_per_m"], f.get("filter_frequency_rad_per_s")
        volts = {x: gain}
        if filtered is not None:
            rows[len(_PLANT)][x], rows[len(_PLANT)][len(_PLANT)] = filtered * gain, -filtered
            volts = {len(_PLANT): fmpq(1)}
        seen: list[Mapping[int, fmpq]] = [volts, {y: fmpq(1)}, {c: oil / area, x: -oil / area}]
        return {
            name: [weights.get(j, fmpq(0)) for j in range(self.order)]
            for name, weights in zip(SENSED, seen, strict=True)
        }


def bounded(matrix: fmpq_mat) -> fmpq_mat:
    """A matrix whose numbers are not too long to work with.

    Raises:
        Unreadable: for another.
    """
    above, below = matrix.numer_denom()
    longest = max([int(below), *(abs(int(entry)) for entry in above.entries())])
    if longest.bit_length() > MOST_BITS:
        raise Unreadable(f"the numbers of a matrix have more than {MOST_BITS} bits over their common denominator")
    return matrix


def _close(rows: Sequence[Row], first: int, sensed: Mapping[str, Row], law: Law) -> Row:
    """(12): the current I = C(s) (-sensed), as a row over the states; C in observer form, from place `first` on."""
    n, k, lead = len(rows), law.order, law.denominator[law.order]
    current = [fmpq(int(k > 0 and j == n - 1)) for j in range(n)]
    for i in range(k):
        rows[first + i][n - 1] = -law.denominator[i] / lead
        if i:
            rows[first + i][first + i - 1] += 1
    for name, numerator in law.numerators.items():
        through = numerator[k] / lead
        for j, weight in enumerate(sensed[name]):
            current[j] -= through * weight
            for i in range(k):
                rows[first + i][j] -= (numerator[i] - through * law.denominator[i]) / lead * weight
    return current


def _close_stage(rows: Sequence[Row], first: int, sensed: Mapping[str, Row], stage: Stage) -> Row:
    """Sections, then w_p (K u - i) + K (w_p / w_z) u' = i'; the current i, which is the last state."""
    n = len(rows)
    signal = [-weight for weight in sensed[SENSED[0]]]
    slope = _rate(rows, signal)
    bend = _rate(rows, slope) if stage.sections else slope
    for k, (zero, above, pole, own) in enumerate(stage.sections):
        here, rate = first + 2 * k, first + 2 * k + 1
        rows[here][rate] = fmpq(1)
        for j in range(n):
            rows[rate][j] = pole * pole * (signal[j] + 2 * above / zero * slope[j] + bend[j] / (zero * zero))
        rows[rate][here] -= pole * pole
        rows[rate][rate] -= 2 * own * pole
        bend = list(rows[rate])
        signal, slope = _unit(n, here), _unit(n, rate)
    for j in range(n):
        rows[n - 1][j] = stage.pole * stage.gain * (signal[j] + slope[j] / stage.zero)
    rows[n - 1][n - 1] -= stage.pole
    return _unit(n, n - 1)


def _unit(n: int, place: int) -> Row:
    return [fmpq(int(j == place)) for j in range(n)]


def _rate(rows: Sequence[Row], signal: Row) -> Row:
    """The rate of a linear function of the states, which must not depend on the velocity of the tip."""
    if signal[VELOCITY] != 0:
        raise Unreadable("a stage feels the acceleration of the tip: sections need a filter before them")
    n = len(signal)
    return [sum((signal[i] * rows[i][j] for i in range(n) if signal[i] != 0), fmpq(0)) for j in range(n)]
