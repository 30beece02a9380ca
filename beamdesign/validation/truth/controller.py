"""Linear controllers of the true rig, as matrices made from the tables of data sets by its own code.

A law of n states and h inputs is (n + 1, n + h): rows of z' = a z + b e, then that of c z + d e.
"""

from math import pi

import numpy as np
from scipy.linalg import block_diag, solve_continuous_are

from beamdesign.validation.truth.effects import Shape
from beamdesign.validation.truth.nominal import HEARD, Table


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
    heard = out[1:]
    spread = np.diag((noise * sizes[1:] * np.append(1.0, np.full(len(heard) - 1, 5.0))) ** 2)
    y = solve_continuous_are(whole.T, heard.T, shaken, spread)
    k, b = (into.T @ x)[0] / weight**2, y @ heard.T @ np.linalg.inv(spread)
    law = whole - into * k - b @ heard
    return {"a": law.tolist(), "b": b.tolist(), "c": k.tolist(), "d": [0.0] * len(heard)}
