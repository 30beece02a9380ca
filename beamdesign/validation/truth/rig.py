"""The true rig in its loop: the laws of its controllers, its march through a record, and what recording adds.

Kutta's third-order rule at a fixed step. Its region of stability holds the imaginary axis up to 1.73 and the real one
to -2.51: at 50 us that is 5.5 kHz and 5e4 1/s, against 0.6 kHz of beams on their oil, 3 kHz of the joint's contact and
the same rate of a seal that slides at 0.25 m/s; memories (bristle, spool friction) are held in their bounds besides.
Dead time is a line of past samples; play and quantised steps are advanced once a step, not inside one.

A controller is linear, and a matrix made from the table of a data set by code of its own: a law of n states and h
inputs is (n + 1, n + h), rows of z' = a z + b e, then that of c z + d e.
"""

from dataclasses import dataclass
from math import pi

import numpy as np
from numba import njit
from scipy.linalg import block_diag, solve_continuous_are
from scipy.signal import lfilter

from beamdesign.validation.truth.beams import AT_TIP, at_end
from beamdesign.validation.truth.effects import Shape
from beamdesign.validation.truth.laws import flanks, played
from beamdesign.validation.truth.nominal import HEARD, MODES, Table
from beamdesign.validation.truth.rates import (
    BRISTLE,
    INNER,
    INNER_SPEED,
    NUT,
    NUT_SPEED,
    PLAYS,
    PRESSURE_A,
    PRESSURE_B,
    SPOOL_FRICTION,
    STATES,
    TIP,
    TIP_SPEED,
    commanded_current,
    measured_volts,
    moved,
    rates_into,
    sensor_volts,
)  # fmt: skip

STEP_S = 50e-6
SAMPLE_S = 500e-6


def lag(pole: float, zero: float) -> np.ndarray:
    """(2, 2) law (1 + s / zero) / (1 + s / pole), breaks in rad/s; its state is the slow part of what goes in."""
    return np.array([[-pole, pole], [1 - pole / zero, pole / zero]])


def section(zero: float, zero_damping: float, pole: float, pole_damping: float) -> np.ndarray:
    """(3, 3) law (1 + 2 d s / z + s^2 / z^2) / (1 + 2 e s / p + s^2 / p^2), frequencies in rad/s.

    Its states are what goes in behind the denominator, and the rate of that over p.
    """
    r = pole / zero
    through = [1 - r * r, 2 * r * (zero_damping - r * pole_damping), r * r]
    return np.array([[0.0, pole, 0.0], [-pole, -2 * pole_damping * pole, pole], through])


def behind(first: np.ndarray, then: np.ndarray) -> np.ndarray:
    """Two laws of one input each, the second fed by the first."""
    n, m = len(first) - 1, len(then) - 1
    whole = np.zeros((n + m + 1, n + m + 1))
    whole[:n, :n], whole[:n, -1] = first[:n, :n], first[:n, n]
    whole[n:, n:-1] = then[:, :m]
    whole[n:, :n] += np.outer(then[:, m], first[n, :n])
    whole[n:, -1] += then[:, m] * first[n, n]
    return whole


def controller_figures(controller: Table) -> Shape:
    """Gain and law of a controller's table: a cascade of a lag and sections, either of which may lack, or matrices.

    Raises:
        ValueError: for a table that is neither.
    """
    gain = {"gain": controller["gain_A_per_V"]}
    if controller["kind"] == "observer":
        a, b, c, d = (np.array(controller[key], dtype=float) for key in "abcd")
        n = len(a)
        law = np.zeros((n + 1, n + len(HEARD)))
        places = [n + HEARD.index(name) for name in controller["sensors"]]
        law[:n, :n], law[n, :n] = a.reshape(n, n), c
        law[:n, places], law[n, places] = b.reshape(n, len(places)), d
        if controller.get("b_command"):
            law[:n, n + HEARD.index("command_V")] = controller["b_command"]
        return gain | {"law": law}
    if controller["kind"] not in ("proportional", "lag", "structured"):
        raise ValueError(f"the truth has no law of kind {controller['kind']!r}")
    law = np.ones((1, 1))
    if "pole_Hz" in controller:
        law = lag(2 * pi * controller["pole_Hz"], 2 * pi * controller["zero_Hz"])
    for row in controller.get("section", ()):
        zero, pole = 2 * pi * row["zero_Hz"], 2 * pi * row["pole_Hz"]
        law = behind(law, section(zero, row["zero_damping_ratio"], pole, row["pole_damping_ratio"]))
    return gain | {"law": law}


def observer(
    a: np.ndarray, force: np.ndarray, current: np.ndarray, seen: np.ndarray, hertz: float, effort: float, noise: float
) -> Table:
    """Matrices of an observer law of unit gain: the regulator of least variance, which hears minus what is seen.

    It weighs the tip under a force that is white noise behind a low-pass against the current, with noise on every
    sensor, of all but the first five times as much. Both are told in what one newton does at 10 Hz: to the tip and to
    each sensor; and to the current, what holds the tip still against it.

    Args:
        a: (n, n) of the rig without a law.
        force: (n,) what a newton does to the states' rates.
        current: (n,) what an ampere does.
        seen: (1 + p, n) the tip in m, then what each sensor gives.
        hertz: break of the force's low-pass.
        effort: weight of the current.
        noise: of each sensor.

    Raises:
        numpy.linalg.LinAlgError: where a Riccati equation has no solution.
    """
    n, corner = len(a), 2 * pi * hertz
    at = seen @ np.linalg.solve(20j * pi * np.eye(n) - a, np.column_stack([force, current]))
    sizes = np.abs(at[:, 0])
    whole = block_diag(a, -corner)
    whole[:n, n] = force
    into, out = np.append(current, 0.0)[:, None], np.column_stack([seen, np.zeros(len(seen))])
    shaken = np.diag(np.append(np.zeros(n), corner))
    shaken[:n, :n] = 0.01 * np.outer(force, force)
    weight = effort * sizes[0] * abs(at[0, 1] / at[0, 0])
    x = solve_continuous_are(whole, into, np.outer(out[0], out[0]), np.array([[weight**2]]))
    sensed = out[1:]
    spread = np.diag((noise * sizes[1:] * np.append(1.0, np.full(len(sensed) - 1, 5.0))) ** 2)
    y = solve_continuous_are(whole.T, sensed.T, shaken, spread)
    k, b = (into.T @ x)[0] / weight**2, y @ sensed.T @ np.linalg.inv(spread)
    law = whole - into * k - b @ sensed
    return {"a": law.tolist(), "b": b.tolist(), "c": k.tolist(), "d": [0.0] * len(sensed)}


@njit(cache=True, error_model="numpy")
def _fed_back(x, f, modes, share, plays, line, newest, behind, noise):  # type: ignore[no-untyped-def]
    """Volts that reach the controller: through the dead time where there is one, with the noise of now.

    Args:
        x: state.
        f: figures.
        modes: of the outer beam's end.
        share: of the record that is over.
        plays: play operators; the last is the sensor's.
        line: measured volts at every step so far.
        newest: index of the last.
        behind: by how many steps the moment asked for lies after it, less the dead time in steps.
        noise: V.
    """
    if f.delay > 0.0:
        place = newest + behind
        if place <= 0.0:
            return noise
        low = min(int(place), newest - 1)
        return line[low] + (place - low) * (line[low + 1] - line[low]) + noise
    if f.sensor_play > 0.0 and f.lag_rate == 0.0 and f.filter_rate == 0.0:
        return plays[PLAYS] + noise
    return measured_volts(x, f, modes, share) + noise


@njit(cache=True, error_model="numpy")
def _march(figures, modes, inputs, lost, step, stride, start):  # type: ignore[no-untyped-def]
    """March through a record.

    Args:
        figures: (1,) record.
        modes: (7, n) of the outer beam's end, see `beams.at_end`.
        inputs: (2 N + 1, 3) force, command, noise in volts, every half step.
        lost: (N + 1,) whether the sensor has dropped out.
        step: s.
        stride: steps from one sample to the next.
        start: (52,) state.

    Returns:
        (samples, 5): current, volts seen by the controller, load pressure, inner tip, outer tip; and whether all is
        finite and within bounds.
    """
    f = figures[0]
    steps = lost.shape[0] - 1
    out = np.zeros((steps // stride + 1, 6))
    x, trial = start.copy(), np.zeros(STATES)
    k1, k2, k3 = np.zeros(STATES), np.zeros(STATES), np.zeros(STATES)
    line = np.zeros(steps + 2)
    plays = np.zeros(PLAYS + 1)
    held, late = np.nan, f.delay / step
    hold = max(1, int(f.current_hold / step + 0.5))
    stuck = 0.0
    whole = steps * step
    for n in range(steps + 1):
        time = n * step
        share = time / whole
        if f.sensor_play > 0.0:
            plays[PLAYS] = played(sensor_volts(x, f, modes, share), plays[PLAYS], f.sensor_play * f.sensor_gain)
        straight = f.sensor_play > 0.0 and f.lag_rate == 0.0 and f.filter_rate == 0.0
        line[n] = plays[PLAYS] if straight else measured_volts(x, f, modes, share)
        fed = stuck if lost[n] else _fed_back(x, f, modes, share, plays, line, n, -late, inputs[2 * n, 2])
        stuck = fed
        if f.current_step > 0.0 and n % hold == 0:
            wanted = commanded_current(x, f, fed, inputs[2 * n, 1], time)
            held = f.current_step * np.floor(wanted / f.current_step + 0.5)
        current = rates_into(x, k1, f, modes, held, plays, fed, inputs[2 * n, 1], inputs[2 * n, 0], time, share)
        if n % stride == 0:
            row = n // stride
            out[row, 0] = current
            out[row, 1] = fed
            out[row, 2] = x[PRESSURE_A] - x[PRESSURE_B]
            out[row, 3] = x[INNER]
            out[row, 4] = moved(x, TIP, modes, AT_TIP)
            if f.lead > 0.0:
                apart = x[NUT] + x[INNER] - out[row, 4]
                closing = x[NUT_SPEED] + x[INNER_SPEED] - moved(x, TIP_SPEED, modes, AT_TIP)
                out[row, 5] = flanks(apart, closing, f.lost_motion, f.screw_stiffness, f.screw_damping)
            if not abs(x[TIP]) < 0.05:
                return out, False
        if n == steps:
            break
        if f.magnet_share > 0.0:
            for k in range(PLAYS):
                plays[k] = played(current, plays[k], f.magnet_width * (k + 1) / PLAYS)
        for stage in (1, 2):
            for i in range(STATES):
                trial[i] = x[i] + (0.5 * step * k1[i] if stage == 1 else step * (2.0 * k2[i] - k1[i]))
            at, then = 2 * n + stage, time + 0.5 * stage * step
            behind = 0.5 * stage - late
            fed = stuck if lost[n] else _fed_back(trial, f, modes, share, plays, line, n, behind, inputs[at, 2])
            rates = k2 if stage == 1 else k3
            rates_into(trial, rates, f, modes, held, plays, fed, inputs[at, 1], inputs[at, 0], then, then / whole)
        for i in range(STATES):
            x[i] += step / 6.0 * (k1[i] + 4.0 * k2[i] + k3[i])
        if f.bristle_stiffness > 0.0:
            largest = f.breakaway / f.bristle_stiffness
            x[BRISTLE] = min(max(x[BRISTLE], -largest), largest)
        if f.spool_friction > 0.0:
            x[SPOOL_FRICTION] = min(max(x[SPOOL_FRICTION], -1.0), 1.0)
    return out, True


@dataclass(frozen=True)
class Motion:
    """What a record would hold without noise of recording.

    Attributes:
        times: (N,) s.
        current: (N,) A.
        displacement: (N,) m, volts that the controller saw over the believed sensor gain.
        load_pressure: (N,) Pa, of a cylinder.
        inner: (N,) m, inner tip.
        outer: (N,) m, outer tip itself.
        screw_force: (N,) N, of a screw, positive where it drives the tips apart.
        bounded: whether it stayed within 50 mm; what follows a departure is zero.
    """

    times: np.ndarray
    current: np.ndarray
    displacement: np.ndarray
    load_pressure: np.ndarray
    inner: np.ndarray
    outer: np.ndarray
    screw_force: np.ndarray
    bounded: bool

    @property
    def duration(self) -> float:
        """From the first sample to one interval after the last, s."""
        return float(self.times[-1] + self.times[1])


def march(
    figures: np.ndarray,
    modes: np.ndarray,
    inputs: np.ndarray,
    lost: np.ndarray | None = None,
    step_s: float = STEP_S,
    start: np.ndarray | None = None,
) -> Motion:
    """March the rig from rest through one record.

    Args:
        figures: one record, see `believed.packed`.
        modes: (7, n) of the outer beam's end, n up to 4, see `beams.at_end`; (3, n) where all is on its axis.
        inputs: (2 N + 1, 3) force (N), command (V) and sensor noise (V) at every half step.
        lost: (N + 1,) whether the sensor has dropped out at each step.
        step_s: step.
        start: (52,) state to start from.

    Raises:
        ValueError: where the dead time is above zero and shorter than a step, or there are too many modes.
    """
    steps = (inputs.shape[0] - 1) // 2
    if 0 < figures["delay"][0] < step_s:
        raise ValueError(f"a dead time of {figures['delay'][0]:g} s is shorter than the step")
    if not 1 <= modes.shape[1] <= MODES:
        raise ValueError(f"{modes.shape[1]} modes, at most {MODES}")
    state = np.zeros(STATES) if start is None else np.asarray(start, dtype=float)
    given = np.zeros(steps + 1, dtype=np.bool_) if lost is None else lost
    ends = np.ascontiguousarray(modes if len(modes) > AT_TIP else at_end(modes))
    out, bounded = _march(figures, ends, np.ascontiguousarray(inputs), given, step_s, round(SAMPLE_S / step_s), state)
    current, fed_back, pressure, inner, outer, force = out.T
    times, displacement = np.arange(len(out)) * SAMPLE_S, fed_back / figures["believed_sensor_gain"][0]
    return Motion(times, current, displacement, pressure, inner, outer, force, bounded)


@dataclass(frozen=True)
class Noise:
    """What recording adds, one standard deviation each.

    Attributes:
        displacement_m: of the sensor, inside the loop.
        quantum_m: step of the recorder.
        force_N: of the force sensor.
        current_A: of the current's.
        drift_m: of the sensor's zero over a record, inside the loop.
        coloured: share of the sensor's power that has passed a first-order low-pass.
        break_Hz: of that.
        outliers: mean number of samples in a record that the recorder spoils, each of one channel.
        pressure_Pa: of the recorder, where the load pressure is recorded.
    """

    displacement_m: float
    quantum_m: float
    force_N: float
    current_A: float
    drift_m: float
    coloured: float = 0.0
    break_Hz: float = 100.0
    outliers: float = 0.0
    pressure_Pa: float = 2e3

    def of_sensor(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """(count,) at every sample, m."""
        white = rng.normal(0, self.displacement_m, count)
        if not self.coloured:
            return white
        memory = float(np.exp(-2 * np.pi * self.break_Hz * SAMPLE_S))
        drawn = rng.normal(0, self.displacement_m, count)
        drawn[1:] *= np.sqrt(1 - memory**2)  # the first is as large as all that follow
        slow = lfilter([1.0], [1.0, -memory], drawn)
        return np.asarray(np.sqrt(1 - self.coloured) * white + np.sqrt(self.coloured) * slow)

    @property
    def floor_m(self) -> float:
        """RMS of what no model can predict of the displacement."""
        return float(np.sqrt(self.displacement_m**2 + self.quantum_m**2 / 12))
