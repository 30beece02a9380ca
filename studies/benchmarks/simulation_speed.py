"""Speed of one simulated record and of its derivatives: generated code, CasADi's own virtual machine, and scipy.

All integrate the same right-hand side under the same band-limited force: the linear rig, and the rig with every effect
of the library at its default. Errors are of the tip's displacement, relative to its largest value, against scipy's
LSODA at a relative tolerance of 1e-9. The generated code has the force from its samples only, the others know it at
every instant. Derivatives are by ten parameters; their errors (of the worst parameter: largest, and root mean square,
relative to the same of the derivative) are against the generated code at twenty times shorter steps, and finite
differences start each run from its own equilibrium. With kinks in the laws the derivative of fixed steps approaches
that of the motion in first order of the step only, and tangent and differences of the same steps are off alike. Run:

    python studies/benchmarks/simulation_speed.py
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from beamdesign import Prototype
from beamdesign.controllers import Lag
from beamdesign.plant.assembly import OUTPUTS, Assembly, assemble, fits, parameters_of, structure_of
from beamdesign.plant.compiled import compiled, half_steps, integrate, integrate_with_sensitivities
from beamdesign.plant.effects import library
from beamdesign.plant.equilibrium import equilibrium, equilibrium_sensitivity, scales, substeps_for
from beamdesign.validation.paper_rig import paper_prototype

SAMPLE_S = 5e-4
LINES_HZ = np.arange(3, 60, 4.0)
TIP = OUTPUTS.index("outer_displacement_m")
REST = np.zeros(3)
FIGURES = ("outer_mass", "outer_damping", "inner_stiffness", "oil_stiffness", "flow_gain")
MORE_FIGURES = ("outer_stiffness", "inner_mass", "leakage", "valve_frequency", "gain")
MORE_OF_EFFECTS = (
    "seal_friction.coulomb_N",
    "joint_backlash.play_m",
    "valve_deadband.half_width_A",
    "entrained_air.air_fraction",
    "mount_compliance.stiffness_N_per_m",
)
Run = Callable[[], np.ndarray]


@dataclass(frozen=True)
class Case:
    """One rig with its record."""

    name: str
    assembly: Assembly
    parameters: np.ndarray
    start: np.ndarray
    times: np.ndarray
    substeps: int
    free: tuple[str, ...]

    def but(self, parameters: np.ndarray) -> "Case":
        """The same with other parameters, from their own equilibrium."""
        start = equilibrium(self.assembly, REST, parameters)
        return Case(self.name, self.assembly, parameters, start, self.times, self.substeps, self.free)


@dataclass(frozen=True)
class Row:
    """One line of a table: a way, its time, its ratio to the first of its table, its errors."""

    case: str
    table: str
    way: str
    seconds: float
    ratio: float
    error: float
    rms: float


def force(time: np.ndarray | float) -> np.ndarray:
    """Force on the tip, N, faded in."""
    angles = 2 * np.pi * np.multiply.outer(np.asarray(time), LINES_HZ) + np.arange(len(LINES_HZ)) ** 2
    return 60.0 * np.sin(angles).sum(axis=-1) * np.minimum(np.asarray(time) / 0.1, 1.0) ** 3


def prepared(name: str, rig: Prototype, free: tuple[str, ...], duration_s: float) -> Case:
    assembly = assemble(structure_of(rig))
    parameters = np.array(list(parameters_of(rig, 6.8, 4.4).values()))
    start = equilibrium(assembly, REST, parameters)
    times = np.arange(round(duration_s / SAMPLE_S) + 1) * SAMPLE_S
    return Case(name, assembly, parameters, start, times, substeps_for(assembly, parameters, times), free)


def cases(duration_s: float) -> tuple[Case, ...]:
    """The linear rig and the one with all effects, each by its usual law."""
    linear = paper_prototype().but(controller=Lag(gain_A_per_V=0.06, pole_Hz=1.75, zero_Hz=26.0))
    usual = (name for name, effect in library().items() if not effect.realises and fits(name, linear.rig))
    every = linear.but(effects={name: {} for name in usual})
    return (
        prepared("no effects", linear, FIGURES + MORE_FIGURES, duration_s),
        prepared("all effects", every, FIGURES + MORE_OF_EFFECTS, duration_s),
    )


def generated(case: Case) -> Run:
    inputs = np.column_stack([force(case.times), 0 * case.times])

    def run() -> np.ndarray:
        fine = half_steps(inputs, case.substeps)
        kinds = case.assembly.kinds
        return integrate(kinds, case.times, fine, case.start, case.parameters, case.substeps, 1.0)[0][:, TIP]

    return run


def virtual_machine(case: Case) -> Run:
    """The same Runge-Kutta steps as one CasADi function, mapped over all steps of the record."""
    h = SAMPLE_S / case.substeps
    x, t, load = ca.SX.sym("x", len(case.start)), ca.SX.sym("t"), ca.SX.sym("load", 3)
    p = ca.SX.sym("p", len(case.parameters))

    def law(time: ca.SX, state: ca.SX, force_N: ca.SX) -> ca.SX:
        return case.assembly.function(time, state, ca.vertcat(force_N, 0, 0), p)[0]

    k1 = law(t, x, load[0])
    k2 = law(t + h / 2, x + h / 2 * k1, load[1])
    k3 = law(t + h / 2, x + h / 2 * k2, load[1])
    k4 = law(t + h, x + h * k3, load[2])
    after = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    tip = case.assembly.function(t + h, after, ca.vertcat(load[2], 0, 0), p)[1][TIP]
    count = (len(case.times) - 1) * case.substeps
    whole = ca.Function("step", [x, t, load, p], [after, tip]).mapaccum("record", count)
    at = np.arange(count) * h
    loads = np.vstack([force(at), force(at + h / 2), force(at + h)])
    constant = np.repeat(case.parameters[:, None], count, axis=1)

    first = float(case.assembly.function(0, case.start, REST, case.parameters)[1][TIP])

    def run() -> np.ndarray:
        tips = np.asarray(whole(case.start, at, loads, constant)[1]).ravel()
        return np.concatenate([[first], tips[case.substeps - 1 :: case.substeps]])

    return run


def scipy_solver(case: Case, method: str, rtol: float) -> Run:
    """`solve_ivp` on the right-hand side evaluated by CasADi in place, which costs less than scipy's own share."""
    typical = 0.1 * scales(case.assembly.states)
    function = case.assembly.function
    rate, given = np.zeros(len(case.start)), [np.zeros(1), np.zeros(len(case.start)), REST.copy(), case.parameters]
    buffer, evaluate = function.buffer()
    for k, array in enumerate(given):
        buffer.set_arg(k, array.data)
    buffer.set_res(0, rate.data)

    def rates(t: float, x: np.ndarray, held: object = buffer) -> np.ndarray:  # CasADi does not hold its buffer
        given[0][0], given[1][:], given[2][0] = t, x, force(t)
        evaluate()
        return rate.copy()

    def run() -> np.ndarray:
        found = solve_ivp(
            rates,
            (0, case.times[-1]),
            case.start,
            method=method,
            t_eval=case.times,
            rtol=rtol,
            atol=rtol * typical,
            max_step=5e-3,
        )
        each = function.map(len(case.times))
        loads = np.vstack([force(case.times), np.zeros((2, len(case.times)))])
        y = np.asarray(
            each(case.times, found.y, loads, np.repeat(case.parameters[:, None], len(case.times), axis=1))[1]
        )
        return np.asarray(y[TIP])

    return run


def tangent(case: Case, finer: int = 1) -> Run:
    """Derivatives (M, P) of the tip's displacement along the generated code's steps."""
    free, steps = case.free, finer * case.substeps
    inputs = np.column_stack([force(case.times), 0 * case.times])
    if finer > 1:  # the force itself at each step
        fine = np.arange(2 * steps * (len(case.times) - 1) + 1) * SAMPLE_S / (2 * steps)
        inputs = np.column_stack([force(fine), 0 * fine])

    def run() -> np.ndarray:
        first = equilibrium_sensitivity(case.assembly, case.start, REST, case.parameters, free)
        given = inputs if finer > 1 else half_steps(inputs, steps)
        kinds, p = case.assembly.kinds, case.parameters
        found = integrate_with_sensitivities(
            kinds, case.times, given, case.start, first, p, free, steps, 1.0, outputs=(TIP,)
        )
        return found[1][:, 0, :]

    return run


def differences(case: Case, way: Callable[[Case], Run], step: float) -> Run:
    """Derivatives (M, P) by central differences, two records per parameter."""

    def run() -> np.ndarray:
        columns = []
        for name in case.free:
            change = np.zeros(len(case.parameters))
            k = case.assembly.parameters.index(name)
            change[k] = step * case.parameters[k]
            ahead, behind = (way(case.but(case.parameters + sign * change))() for sign in (1, -1))
            columns.append((ahead - behind) / (2 * change[k]))
        return np.column_stack(columns)

    return run


def timed(run: Run, runs: int) -> tuple[float, np.ndarray]:
    """Shortest time of some runs, s, and what they give."""
    seconds = np.inf
    for _ in range(runs):
        begin = perf_counter()
        found = run()
        seconds = min(seconds, perf_counter() - begin)
    return seconds, found


def table(case: Case, name: str, ways: dict[str, tuple[Run, int]], expected: np.ndarray) -> list[Row]:
    """Time all ways and measure their errors, of each column by itself; print and give the rows."""
    rows: list[Row] = []
    scale, typical = np.abs(expected).max(axis=0), np.sqrt((expected**2).mean(axis=0))
    print(f"\n{case.name}, {name}\n{'':50s} {'ms':>9s} {'ratio':>7s} {'error':>9s} {'rms':>9s}", flush=True)
    for way, (run, runs) in ways.items():
        seconds, found = timed(run, runs)
        error = float((np.abs(found - expected).max(axis=0) / scale).max())
        rms = float((np.sqrt(((found - expected) ** 2).mean(axis=0)) / typical).max())
        rows.append(Row(case.name, name, way, seconds, seconds / (rows[0].seconds if rows else seconds), error, rms))
        print(f"{way:50s} {1e3 * seconds:9.1f} {rows[-1].ratio:7.1f} {error:9.1e} {rms:9.1e}", flush=True)
    return rows


def main(argv: Sequence[str] | None = None) -> list[Row]:
    """Print the tables and give their rows."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--duration-s", type=float, default=4.0, help="length of the record")
    duration = parser.parse_args(argv).duration_s
    begin = perf_counter()
    import beamdesign.plant.compiled  # noqa: F401

    print(f"numba loaded in {perf_counter() - begin:.2f} s; records of {duration:g} s at {SAMPLE_S * 1e3:g} ms")
    rows: list[Row] = []
    for case in cases(duration):
        kinds = case.assembly.kinds
        plain, _ = timed(lambda kinds=kinds: compiled.__wrapped__(kinds).constants, 3)
        whole, _ = timed(
            lambda kinds=kinds, free=case.free: compiled.__wrapped__(kinds, free, (TIP,)).constants,
            3,
        )
        first, _ = timed(generated(case), 1)
        size = f"{len(case.start)} states, {len(case.parameters)} parameters"
        ready = f"ready in {1e3 * plain:.0f} ms, with derivatives in {1e3 * whole:.0f} ms"
        print(f"\n{case.name}: {size}; equations {ready}; first record after {first:.2f} s", flush=True)
        step_ms = SAMPLE_S / case.substeps * 1e3
        ways = {
            f"generated code, {step_ms:.2g} ms steps": (generated(case), 5),
            "CasADi virtual machine, same steps": (virtual_machine(case), 2),
            "scipy solve_ivp, LSODA, rtol 1e-5": (scipy_solver(case, "LSODA", 1e-5), 1),
            "scipy solve_ivp, RK45, rtol 1e-4": (scipy_solver(case, "RK45", 1e-4), 1),
        }
        rows += table(case, "record", ways, scipy_solver(case, "LSODA", 1e-9)())
        ways = {
            "tangent of the generated code": (tangent(case), 5),
            "central differences of 1e-5, generated code": (differences(case, generated, 1e-5), 1),
            "central differences of 1e-3, solve_ivp, rtol 1e-6": (
                differences(case, lambda at: scipy_solver(at, "LSODA", 1e-6), 1e-3),
                1,
            ),
        }
        rows += table(case, "derivatives by ten parameters", ways, tangent(case, finer=20)())
    return rows


if __name__ == "__main__":
    main()
