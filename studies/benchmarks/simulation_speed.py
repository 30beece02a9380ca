"""Speed of one simulated record: generated code, CasADi's own virtual machine and scipy's integrator, side by side.

All integrate the same right-hand side under the same band-limited force: the linear rig, and the rig with every effect
of the library at its default. Errors are of the tip's displacement, relative to its largest value, against steps twenty
times shorter. The generated code has the force from its samples only, the others know it at every instant. Run:

    python studies/benchmarks/simulation_speed.py
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from beamdesign.paper.rig import paper_prototype
from beamdesign.prototype import Lag, Prototype
from beamdesign.rig.assembly import OUTPUTS, Assembly, assemble
from beamdesign.rig.compiled import integrate
from beamdesign.rig.effects import library
from beamdesign.rig.equilibrium import equilibrium, scales
from beamdesign.rig.parameters import parameters_of, structure_of
from beamdesign.simulate import half_steps, substeps_for

SAMPLE_S = 5e-4
LINES_HZ = np.arange(3, 60, 4.0)
TIP = OUTPUTS.index("outer_displacement_m")
Run = Callable[[], np.ndarray]


@dataclass(frozen=True)
class Case:
    """One rig with its record."""

    assembly: Assembly
    parameters: np.ndarray
    start: np.ndarray
    times: np.ndarray
    substeps: int


def force(time: np.ndarray | float) -> np.ndarray:
    """Force on the tip, N, faded in."""
    waves = [np.sin(2 * np.pi * f * np.asarray(time) + k * k) for k, f in enumerate(LINES_HZ)]
    return 60.0 * np.sum(waves, axis=0) * np.minimum(np.asarray(time) / 0.1, 1.0) ** 3


def prepared(rig: Prototype, duration_s: float) -> Case:
    assembly = assemble(structure_of(rig))
    parameters = np.array(list(parameters_of(rig, 6.8, 4.4).values()))
    start = equilibrium(assembly, np.zeros(3), parameters)
    times = np.arange(round(duration_s / SAMPLE_S) + 1) * SAMPLE_S
    return Case(assembly, parameters, start, times, substeps_for(assembly, parameters, SAMPLE_S))


def generated(case: Case) -> Run:
    inputs = np.column_stack([force(case.times), 0 * case.times])

    def run() -> np.ndarray:
        fine = half_steps(inputs, case.substeps)
        return integrate(case.assembly.kinds, case.times, fine, case.start, case.parameters, case.substeps, 1.0)[:, TIP]

    return run


def reference(case: Case, finer: int = 20) -> np.ndarray:
    """The record at much shorter steps, with the force itself at each."""
    steps = finer * case.substeps
    fine = np.arange(2 * steps * (len(case.times) - 1) + 1) * SAMPLE_S / (2 * steps)
    inputs = np.column_stack([force(fine), 0 * fine])
    return integrate(case.assembly.kinds, case.times, inputs, case.start, case.parameters, steps, 1.0)[:, TIP]


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

    first = float(case.assembly.function(0, case.start, np.zeros(3), case.parameters)[1][TIP])

    def run() -> np.ndarray:
        tips = np.asarray(whole(case.start, at, loads, constant)[1]).ravel()
        return np.concatenate([[first], tips[case.substeps - 1 :: case.substeps]])

    return run


def scipy_solver(case: Case, rtol: float) -> Run:
    typical = 0.1 * scales(case.assembly)
    function = case.assembly.function

    def rates(t: float, x: np.ndarray) -> np.ndarray:
        return np.asarray(function(t, x, [float(force(t)), 0, 0], case.parameters)[0]).ravel()

    def run() -> np.ndarray:
        found = solve_ivp(
            rates,
            (0, case.times[-1]),
            case.start,
            method="LSODA",
            t_eval=case.times,
            rtol=rtol,
            atol=rtol * typical,
            max_step=SAMPLE_S,
        )
        each = function.map(len(case.times))
        loads = np.vstack([force(case.times), np.zeros((2, len(case.times)))])
        y = np.asarray(
            each(case.times, found.y, loads, np.repeat(case.parameters[:, None], len(case.times), axis=1))[1]
        )
        return np.asarray(y[TIP])

    return run


def main() -> None:
    """Print one table per rig."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--duration-s", type=float, default=4.0, help="length of the record")
    duration = parser.parse_args().duration_s
    linear = paper_prototype().but(controller=Lag(gain_A_per_V=0.06, pole_Hz=1.75, zero_Hz=26.0))
    for name, rig in (("no effects", linear), ("all effects", linear.but(effects={n: {} for n in library()}))):
        case = prepared(rig, duration)
        ways = {
            f"generated code, {SAMPLE_S / case.substeps * 1e3:.2g} ms steps": (generated(case), 5),
            "CasADi virtual machine, same steps": (virtual_machine(case), 2),
            "scipy solve_ivp, LSODA, rtol 1e-5": (scipy_solver(case, 1e-5), 1),
        }
        begin = perf_counter()
        generated(case)()
        compiling = perf_counter() - begin
        expected = reference(case)
        scale = np.abs(expected).max()
        rows = []
        for way, (run, runs) in ways.items():
            seconds = np.inf
            for _ in range(runs):
                begin = perf_counter()
                tip = run()
                seconds = min(seconds, perf_counter() - begin)
            error = np.abs(tip - expected).max() / scale
            rows.append((way, seconds, float(error)))
        print(f"\n{name}: {len(case.start)} states, {duration:g} s; compiled once in {compiling:.1f} s")
        print(f"{'':40s} {'ms':>9s} {'ratio':>7s} {'error':>9s}")
        for way, seconds, error in rows:
            print(f"{way:40s} {1e3 * seconds:9.1f} {seconds / rows[0][1]:7.1f} {error:9.1e}")


if __name__ == "__main__":
    main()
