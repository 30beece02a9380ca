"""Cost of a diagnosis: one linearised record by the model's own derivatives, and by differences of scipy's integrator.

A diagnosis spends its time on residuals of records and their derivatives by all unknowns of a hypothesis. Both ways
linearise the same record about the same figures; errors are of the displacement, against LSODA at a tight tolerance.
Then a whole diagnosis is timed. Run:

    python studies/benchmarks/diagnosis_cost.py
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import casadi as ca
import numpy as np
from comparison import timed
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from beamdesign import diagnose, read_dataset
from beamdesign.diagnosis.fitting.evidence import RecordEvidence, record_evidence
from beamdesign.diagnosis.fitting.hypothesis import Hypothesis, Placement
from beamdesign.diagnosis.fitting.replay import at_rest
from beamdesign.plant.assembly import OUTPUTS

SET = Path(__file__).parent.parent / "gaps" / "slow_sensor"
TOLERANCE, TIGHT = 1e-5, 1e-9
STEP = 1e-3  # in z, for differences


def integrated(piece: RecordEvidence, placement: Placement, z: np.ndarray, tolerance: float, end: int) -> np.ndarray:
    """The first `end` samples of a record by LSODA on the same equations, (end, C)."""
    parameters, placement = piece.job.parameters(placement, z), piece.job.placed(placement)
    function = placement.assembly.function
    drive = CubicSpline(piece.record.times, np.column_stack([piece.record.inputs, 0 * piece.record.times]))
    t, x, u, p = (ca.SX.sym(name, *function.size_in(k)) for k, name in enumerate("txup"))
    rate, output = function(t, x, u, p)
    rates, outputs = ca.Function("rate", [t, x, u, p], [rate]), ca.Function("output", [t, x, u, p], [output])
    start, scale = at_rest(placement, parameters), 1e-6
    found = solve_ivp(
        lambda now, state: np.asarray(rates(now, state, drive(now), parameters)).ravel(),
        (piece.record.times[0], piece.record.times[end - 1]),
        start,
        "LSODA",
        piece.record.times[:end],
        rtol=tolerance,
        atol=tolerance * scale * np.maximum(1.0, np.abs(start) / scale),
    )
    rows = [
        np.asarray(outputs(now, state, drive(now), parameters)).ravel()
        for now, state in zip(found.t, found.y.T, strict=True)
    ]
    return np.array(rows)[:, [OUTPUTS.index(name) for name in piece.weight.channels]]


def main(given: Sequence[str] | None = None) -> tuple[float, tuple[float, float]]:
    """Print the table; give the ratio of times, and the errors of steps and integrator."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--samples", type=int, default=1000, help="of the record that scipy integrates")
    arguments.add_argument("--no-diagnosis", action="store_true", help="leave the whole diagnosis out")
    chosen = arguments.parse_args(given)
    data = read_dataset(SET)
    piece = record_evidence(data)[0]
    hypothesis = Hypothesis(("sensor_lag",))
    placement = hypothesis.placement(data.prototype)
    z = np.zeros(len(placement.unknowns))
    tangent = timed(lambda: piece.linearised(placement, z), 10)[0].wall_s
    end = min(chosen.samples, len(piece.record.times))
    cost, single = timed(lambda: integrated(piece, placement, z, TOLERANCE, end), 1, warm=False)
    differences = cost.wall_s * len(piece.record.times) / end * (1 + len(z))
    tight = integrated(piece, placement, z, TIGHT, end)
    steps = piece.predicted(placement, z)
    assert steps is not None
    ours, theirs = (float(np.abs(y - tight)[:, 1].max() / np.abs(tight[:, 1]).max()) for y in (steps[:end], single))
    print(f"one record of {piece.record.times[-1]:.3g} s, {len(z)} unknowns, residual and all derivatives")
    print(f"  generated code and its tangent   {tangent * 1e3:9.1f} ms   error {ours:.1e}")
    print(f"  solve_ivp, forward differences   {differences * 1e3:9.0f} ms   error {theirs:.1e} (from {end} samples)")
    print(f"  ratio {differences / tangent:.0f}")
    if not chosen.no_diagnosis:
        whole, found = timed(lambda: diagnose(data, 2), 1, warm=False)
        said = f"{whole.wall_s:.1f} s, {found.verdict} {found.chosen}"
        print(f"whole diagnosis, {len(data.records)} records, 2 processes: {said}")
    return differences / tangent, (ours, theirs)


if __name__ == "__main__":
    main()
