"""Records of a rig by generated machine code; see `machine_code` for the equations and `stepper` for the steps."""

from functools import cache

import numpy as np

from beamdesign.rig.assembly import Structure, assemble
from beamdesign.rig.machine_code import Body, MachineCode, machine_code, trace

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
        digital: the sampled controller, see `beamdesign.sampled.SampledLaw`.

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
        digital: as of `beamdesign.rig.stepper`.
        width: entries that `output` gives.
    """
    from beamdesign.rig.stepper import steps

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
