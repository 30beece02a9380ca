"""The closed loop of a rig without effects as x' = A(m) x.

It is from equations (7) to (16) of Zalucky and Hardt (1984). Lyapunov functions are of states, so these are the
prover's; that one builds its matrices by differentiating the assembled rig, this writes down the equations.
"""

from collections.abc import Mapping, Sequence

from flint import fmpq, fmpq_mat

from beamdesign.checker.law import SENSED, Law, Stage
from beamdesign.checker.reading import Unreadable
from beamdesign.checker.rig import Rig

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

    The states are X_m, X_m', X_c, X_f, X_f', Q_0, Q_0' or, with a screw, the nut's travel, its speed and the motor's
    current in the places of X_c, Q_0 and Q_0', the filtered volts where there is a filter, and those of the
    law: of one that stays in observer form; of a stage those that all stages share and none resets, output and rate of
    each second-order section and the current.

    Attributes:
        bare_mass: M_m, kg.
        order: number of states.
    """

    def __init__(self, rig: Rig, law: Law | Stage) -> None:
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
        if rig.kind == "ball_screw":
            drive = rig.figures["current_loop_rad_per_s"]
        else:
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

    def _plant(self, rig: Rig) -> dict[str, Row]:
        """Fill in the rows of the rig; what is sensed, as rows over the states."""
        f, rows = rig.figures, self._rows
        x, v, c, y, u, q, _ = range(len(_PLANT))
        rows[x][v] = rows[y][u] = fmpq(1)
        screw = rig.kind == "ball_screw"
        spring = f["screw_stiffness_N_per_m"] if screw else f["oil_stiffness_N_per_m"]
        # The actuator's force is K_c (X_c - X_m), or K_s d + c_s d' with d = X_n - (X_m - X_f), X_n the nut's travel.
        force = {c: spring, x: -spring}
        if screw:
            damping = f["screw_damping_N_s_per_m"]
            force |= {y: spring, q: damping, v: -damping, u: damping}
        # (7), (9): (M_m + m) X_m'' = F - K_m X_m - b_m X_m', which `matrix` divides by the mass
        rows[v][x], rows[v][v] = -f["outer_stiffness_N_per_m"], -f["outer_damping_N_s_per_m"]
        # (8), (10): (M_f + n) X_f'' = -F - K_f X_f - b_f X_f'
        inner = f["inner_mass_kg"] + rig.inner_end_mass
        rows[u][y], rows[u][u] = -f["inner_stiffness_N_per_m"] / inner, -f["inner_damping_N_s_per_m"] / inner
        for j, weight in force.items():
            rows[v][j] += weight
            rows[u][j] -= weight / inner
        (self._screw if screw else self._cylinder)(f, force)
        gain, filtered = f["sensor_gain_V_per_m"], f.get("filter_frequency_rad_per_s")
        volts = {x: gain}
        if filtered is not None:
            rows[len(_PLANT)][x], rows[len(_PLANT)][len(_PLANT)] = filtered * gain, -filtered
            volts = {len(_PLANT): fmpq(1)}
        per_area = 1 if screw else 1 / f["piston_area_m2"]
        felt = {j: per_area * weight for j, weight in force.items()}
        seen: dict[str, Mapping[int, fmpq]] = {SENSED[0]: volts, SENSED[1]: {y: fmpq(1)}, SENSED[2 + screw]: felt}
        return {name: [weights.get(j, fmpq(0)) for j in range(self.order)] for name, weights in seen.items()}

    def _screw(self, f: Mapping[str, fmpq], force: Mapping[int, fmpq]) -> None:
        """Rows of the nut's travel, of its speed and of the motor's current."""
        _, _, c, _, _, q, r = range(len(_PLANT))
        rows, lead, torque = self._rows, f["lead_m_per_rad"], f["torque_constant_N_m_per_A"]
        # J X_n'' = h (K_t i - h F) - b X_n'
        rows[c][q], rows[q][r] = fmpq(1), lead * torque / f["rotor_inertia_kg_m2"]
        rows[q][q] = -f["rotor_friction_N_m_s_per_rad"] / f["rotor_inertia_kg_m2"]
        for j, weight in force.items():
            rows[q][j] -= lead * lead * weight / f["rotor_inertia_kg_m2"]
        # i' = w_c (I - k_w X_n' / h - i)
        rows[r][r] = -f["current_loop_rad_per_s"]
        rows[r][q] = -f["current_loop_rad_per_s"] * f["speed_feedback_A_s_per_rad"] / lead

    def _cylinder(self, f: Mapping[str, fmpq], force: Mapping[int, fmpq]) -> None:
        """Rows of the cylinder's end and of the valve's flow."""
        _, _, c, _, u, q, r = range(len(_PLANT))
        rows, area, w = self._rows, f["piston_area_m2"], f["valve_frequency_rad_per_s"]
        # (14) to (16): X_c' = X_f' + (Q_0 - K_pq K_c (X_c - X_m) / A) / A
        rows[c][u], rows[c][q] = fmpq(1), 1 / area
        for j, weight in force.items():
            rows[c][j] -= f["leakage_m3_per_s_per_Pa"] * weight / (area * area)
        # (13): Q_0'' = w^2 (K_q I - Q_0) - 2 xi w Q_0'
        rows[q][r] = fmpq(1)
        rows[r][q], rows[r][r] = -w * w, -2 * f["valve_damping_ratio"] * w


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
