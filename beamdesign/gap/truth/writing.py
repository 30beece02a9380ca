"""A case as a data set of the contract, and its answer."""

from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from beamdesign.files import write_whole
from beamdesign.gap.truth.believed import assembled, believed_figures
from beamdesign.gap.truth.case import Case, Departure, Run, inputs_of, noise_free, run_figures, take
from beamdesign.gap.truth.effects import KINDS, LISTED
from beamdesign.gap.truth.rig import SAMPLE_S, STEP_S, Motion


def recorded(case: Case, run: Run) -> dict[str, np.ndarray]:
    """Columns of one record as the recorder writes them."""
    motion = take(case, run, noisy=True)
    rng = np.random.default_rng([case.seed, run.drive.seed, 3])
    count = len(motion.times)
    inputs = inputs_of(case, run, False, STEP_S, case.duration_s)[:: round(2 * SAMPLE_S / STEP_S)]
    quantum = case.noise.quantum_m
    return {
        "t_s": motion.times,
        "disturbance_N": inputs[:, 0] + rng.normal(0, case.noise.force_N, count),
        "command_V": inputs[:, 1],
        "current_A": motion.current + rng.normal(0, case.noise.current_A, count),
        "displacement_m": quantum * np.round(motion.displacement / quantum),
    }


_FORMATS = ("%.4f", "%.2f", "%.6f", "%.7f", "%.4e")


def _csv(columns: dict[str, np.ndarray], formats: tuple[str, ...]) -> str:
    row = ",".join(formats)
    table = np.column_stack(list(columns.values()))
    return ",".join(columns) + "\n" + "\n".join([row % tuple(line) for line in table.tolist()]) + "\n"


def write_case(case: Case, folder: Path | str) -> None:
    """Write the data set of a case, without its answer.

    Args:
        case: drawn.
        folder: made where it is not there.

    Raises:
        OSError: where it cannot be written.
    """
    folder = Path(folder)
    (folder / "records").mkdir(parents=True, exist_ok=True)
    index: dict[str, Any] = {"name": f"case-{case.seed}", "prototype": "prototype.toml", "record": []}
    for run in case.runs:
        file = f"records/{run.name}.csv"
        write_whole(folder / file, _csv(recorded(case, run), _FORMATS))
        index["record"].append({"file": file} | _setting(run))
    if "frequency_response" in case.extras:
        index["frequency_response"] = _responses(case, folder)
    if "critical_gain" in case.extras:
        from beamdesign.gap.truth.oscillation import measured_gains

        index["critical_gain"] = measured_gains(case)
    write_whole(folder / "prototype.toml", tomli_w.dumps(case.believed))
    write_whole(folder / "dataset.toml", tomli_w.dumps(index))


def _setting(run: Run) -> dict[str, Any]:
    return {
        "outer_end_mass_kg": run.outer_end_mass_kg,
        "inner_end_mass_kg": run.inner_end_mass_kg,
        "controller": run.controller,
    }


def _responses(case: Case, folder: Path) -> list[dict[str, Any]]:
    from beamdesign.gap.truth.response import compliance

    found = []
    for run in case.runs:
        if run.name not in ("04_disturbance_large", "06_payload_disturbance"):
            continue
        file = f"response_{run.name}.csv"
        amplitude, columns = compliance(case, run)
        write_whole(folder / file, _csv(columns, ("%.4f", "%.5e", "%.3f")))
        found.append({"file": file, "amplitude_N": amplitude} | _setting(run))
    return found


def told(case: Case, departure: Departure) -> dict[str, Any]:
    """Parameters of one effect in the units of the contract's effects, and the severity it was drawn with."""
    if departure.figure:
        factor = float(np.exp(departure.severity))
        value = believed_figures(case.believed)[departure.figure] * case.factors[departure.figure]
        return {"figure": departure.figure, "factor": factor, "value": value}
    figures = run_figures(case, case.runs[0])
    record, modes = assembled(figures)
    values = dict(zip(record.dtype.names or (), (float(v) for v in record[0]), strict=True))
    found: dict[str, Any] = KINDS[departure.name].told(values)
    if departure.name == "second_beam_mode":
        rates = np.sqrt(modes[0] / modes[1])
        found |= {
            "frequency_Hz": float(rates[1] / (2 * np.pi)),
            "compliance_share": float(modes[0, 0] / modes[0, 1]),
            "damping_ratio": float(modes[2, 1] / (2 * np.sqrt(modes[0, 1] * modes[1, 1]))),
        }
    return found | {"severity": departure.severity, "figures": departure.changes(case.scales)}


def answer(case: Case) -> dict[str, Any]:
    """What is in a case, as tables of plain values (JSON and TOML alike).

    `effects` and `subsystem` are those of the contract's answer files; `subsystem` is that of the effect with the
    largest gap. `gap_over_floor` compares the rig with and without the effects, tolerances and background the same,
    free of noise.
    """
    floor = case.gaps["floor"]
    return {
        "seed": case.seed,
        "kind": case.kind,
        "effects": list(case.names),
        "subsystem": case.departures[0].subsystem if case.departures else "",
        "subsystems": [d.subsystem for d in case.departures],
        "in_library": all(d.name in LISTED or d.figure != "" for d in case.departures),
        "parameters": {d.name: told(case, d) for d in case.departures},
        "gap_over_floor": case.gap_over_floor,
        "gaps_over_floor": {name: value / floor for name, value in case.gaps.items()},
        "relative_floor": floor,
        "noise_floor_m": case.noise.floor_m,
        "tolerance_factors": dict(case.factors),
        "background": {d.name: d.severity for d in case.background},
        "notes": list(case.notes),
    }


def truth_records(case: Case) -> dict[str, Motion]:
    """The noise-free records to judge a prediction by: the displacement that a noiseless sensor would have shown."""
    return noise_free(case)
