"""Records of a rig by generated machine code; see `machine_code` for the equations and `stepper` for the steps.

How many steps a record takes is found here too; what would fill the machine is refused before it is begun.
"""

from collections.abc import Iterable
from functools import cache
from math import ceil, log

import numpy as np

from beamdesign.plant.assembly import Assembly, Structure, assemble
from beamdesign.plant.equilibrium import linearise
from beamdesign.plant.machine_code import Body, MachineCode, machine_code, trace
from beamdesign.records import InputError

NOT_SAMPLED = np.zeros(6)


@cache
def compiled(kinds: Structure) -> MachineCode:
    """Machine code of a structure's equations: functions `law` (rates of the states) and `output`."""
    traced = trace(assemble(kinds).function)

    def stored(which: int, body: Body) -> None:
        for entry, value in enumerate(traced.outputs[which]):
            body.store(body.read(value), "out", entry)

    return machine_code(traced.values, {"law": lambda body: stored(0, body), "output": lambda body: stored(1, body)})


def integrate(
    kinds: Structure,
    times: np.ndarray,
    inputs: np.ndarray,
    start: np.ndarray,
    parameters: np.ndarray,
    substeps: int,
    bound: float,
    digital: np.ndarray = NOT_SAMPLED,
) -> np.ndarray:
    """Outputs of a rig over a record by fixed-step Runge-Kutta of fourth order.

    Args:
        kinds: structure of the rig.
        times: (N,) equally spaced, s.
        inputs: (2 substeps (N - 1) + 1, 2) disturbance (N) and command (V) at every half step.
        start: (n,) states at the first time.
        parameters: in the order of the assembly.
        substeps: steps per sample interval.
        bound: of the fifth output, the displacement of the outer tip (m), at which the record ends.
        digital: the sampled controller, see `beamdesign.simulation.SampledLaw`.

    Returns:
        (M, 6) outputs as in `Assembly.outputs`; M < N where the rig passed the bound, or left the numbers, after M
        samples.
    """
    return integrate_on(kinds, times, inputs, start, parameters, substeps, bound, digital)[0]


def integrate_on(
    kinds: Structure,
    times: np.ndarray,
    inputs: np.ndarray,
    start: np.ndarray,
    parameters: np.ndarray,
    substeps: int,
    bound: float,
    digital: np.ndarray = NOT_SAMPLED,
) -> tuple[np.ndarray, np.ndarray]:
    """As `integrate`, with the states (n,) at the last sample that was kept, to go on from."""
    code, width = compiled(kinds), len(assemble(kinds).outputs)
    return stepped(code, times, inputs, start, len(start), parameters, substeps, bound, digital, width)


def stepped(
    code: MachineCode,
    times: np.ndarray,
    inputs: np.ndarray,
    start: np.ndarray,
    checked: int,
    parameters: np.ndarray,
    substeps: int,
    bound: float,
    digital: np.ndarray,
    width: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Rows (M, width) of a code's `output` along the record that its `law` makes, and the states at the last of them.

    Args:
        code: functions `law` and `output`, the fifth of whose entries is held against `bound`.
        times: (N,) s.
        inputs: (2 substeps (N - 1) + 1, 2).
        start: (n,) whatever the law takes as states.
        checked: how many of them, from the first, must stay finite.
        parameters: of the code's `prepare`.
        substeps: steps per sample interval.
        bound: m.
        digital: as of `beamdesign.plant.stepper`.
        width: entries that `output` gives.
    """
    from beamdesign.plant.stepper import steps

    if len(inputs) != 2 * substeps * (len(times) - 1) + 1:
        raise ValueError(f"{len(inputs)} input points do not fit {len(times)} samples of {substeps} steps")
    y, state = np.zeros((len(times), width)), np.array(start, dtype=float)
    kept = steps(
        code.address["law"],
        code.address["output"],
        np.ascontiguousarray(times, dtype=float),
        np.ascontiguousarray(inputs, dtype=float),
        state,
        int(checked),
        code.prepared(parameters),
        int(substeps),
        float(bound),
        np.ascontiguousarray(digital, dtype=float),
        y,
    )
    return y[:kept], state


LONGEST_STEP_S = 1e-4
MOST_STEPS = 20_000_000
"""Of one record: half a minute, and about a gigabyte of inputs."""
_NUDGE = 1 + 1e-6  # on each figure, to find those that the fastest pole comes from

Place = tuple[np.ndarray, np.ndarray]
"""States and inputs about which a rig is linearised."""


def substeps_at(
    assembly: Assembly, places: Iterable[Place], parameters: np.ndarray, times: np.ndarray, steps_per_radian: float
) -> int:
    """Steps per sample: at most 0.1 ms each, and so many per radian of the fastest pole at any of the places.

    Args:
        assembly: the rig.
        places: where its poles are looked at.
        parameters: in the assembly's order.
        times: (N,) s, at least two, equally spaced but for their jitter.
        steps_per_radian: of the fastest pole.

    Raises:
        InputError: where the record would take more than `MOST_STEPS`, naming the figures that make it so stiff.
    """
    fastest, stiffest = 1.0, None
    for place in places:
        if (rate := _fastest_pole(assembly, place, parameters)) > fastest:
            fastest, stiffest = rate, place
    sample_s = (times[-1] - times[0]) / (len(times) - 1)
    needed = sample_s / min(LONGEST_STEP_S, 1 / (steps_per_radian * fastest)) - 1e-9
    if stiffest is not None:
        reason = _why(assembly, stiffest, parameters) if needed * len(times) > MOST_STEPS else ""
        refuse_too_many(needed * len(times), "(figures)", reason)
    return max(1, ceil(needed))


def refuse_too_many(steps: float, key: str, reason: str) -> None:
    """Refuse a record of too many steps.

    Raises:
        InputError: naming the key and the reason why so many are needed.
    """
    if not steps <= MOST_STEPS:
        words = f"{reason}, so that a record takes {steps:.3g} integration steps; {MOST_STEPS:.3g} are the most"
        raise InputError("simulation", [(key, words)])


def _fastest_pole(assembly: Assembly, place: Place, parameters: np.ndarray) -> float:
    """Modulus of the fastest pole, rad/s; infinite where the equations leave the numbers."""
    a = linearise(assembly, *place, parameters).a
    return float(np.abs(np.linalg.eigvals(a)).max()) if np.isfinite(a).all() else np.inf


def _why(assembly: Assembly, place: Place, parameters: np.ndarray) -> str:
    """The three figures that move the fastest pole most."""
    fastest, moved = _fastest_pole(assembly, place, parameters), []
    for k, (name, value) in enumerate(zip(assembly.parameters, parameters, strict=True)):
        nudged = parameters.copy()
        nudged[k] *= _NUDGE
        moved.append((abs(log(_fastest_pole(assembly, place, nudged) / fastest)), f"{name} {value:g}"))
    words = ", ".join(words for _, words in sorted(moved, reverse=True)[:3])
    return f"the fastest motion is of {fastest / (2 * np.pi):.3g} Hz, above all by {words} in SI"
