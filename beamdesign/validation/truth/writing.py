"""A case as a data set of the contract, and its answer.

What is measured of it beside records is found as on a rig: the gain at which the loop begins to oscillate by turning
it up, compliance line by line as a frequency analyser would.
"""

from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from beamdesign.files import write_whole
from beamdesign.validation.truth.believed import assembled, believed_figures, controller_figures
from beamdesign.validation.truth.case import Case, Departure, Run, driven, inputs_of, run_figures, step_of, take
from beamdesign.validation.truth.effects import KINDS, LISTED
from beamdesign.validation.truth.rig import SAMPLE_S, STEP_S

LINES = 40
SETTLE_S = 2.0
LISTEN_S = 4.0


def compliance(case: Case, run: Run) -> tuple[float, dict[str, np.ndarray]]:
    """Displacement over force at lines from 1 to 300 Hz, all at once with random phases and equal heights.

    The first `SETTLE_S` are thrown away; the lines lie on the grid of the `LISTEN_S` that follow.

    Returns:
        height of one line (N), and the columns of the file.
    """
    figures = run_figures(case, run)
    step = step_of(figures)
    rng = np.random.default_rng([case.seed, run.drive.seed, 4])
    frequencies = np.unique(np.round(np.geomspace(1.0, 300.0, LINES) * 4)) / 4
    height = float(f"{run.drive.size / np.sqrt(len(frequencies) / 2):.3g}")
    times = np.arange(2 * round((SETTLE_S + LISTEN_S) / step) + 1) * (step / 2)
    inputs = np.zeros((len(times), 3))
    phases = rng.uniform(0, 2 * np.pi, len(frequencies))
    for frequency, phase in zip(frequencies, phases, strict=True):
        inputs[:, 0] += height * np.cos(2 * np.pi * frequency * times + phase)
    motion = driven(figures, inputs)
    count = round(LISTEN_S / SAMPLE_S)
    first = round(SETTLE_S / SAMPLE_S)
    taken = motion.displacement[first : first + count] + rng.normal(0, case.noise.floor_m, count)
    force = inputs[:: round(2 * SAMPLE_S / step), 0][first : first + count]
    lines = np.round(frequencies * LISTEN_S).astype(int)
    ratio = np.fft.rfft(taken)[lines] / np.fft.rfft(force)[lines]
    return height, {
        "frequency_Hz": frequencies,
        "magnitude_m_per_N": np.abs(ratio),
        "phase_deg": np.degrees(np.angle(ratio)),
    }


RELATIVE_STD = 0.03
_WATCHED_S = 1.5


def sustained(case: Case, run: Run, gain_A_per_V: float) -> bool:
    """Whether a short push (5 ms at a tenth of the largest load) is still there, not less, in the last third."""
    figures = run_figures(case, run) | controller_figures(run.controller | {"gain_A_per_V": gain_A_per_V})
    step = step_of(figures)
    times = np.arange(2 * round(_WATCHED_S / step) + 1) * (step / 2)
    inputs = np.zeros((len(times), 3))
    inputs[times < 5e-3, 0] = 0.1 * case.scales.force
    motion = driven(figures, inputs)
    if not motion.bounded:
        return True
    third = len(motion.displacement) // 3
    middle, last = motion.displacement[third : 2 * third], motion.displacement[2 * third :]
    return bool(np.std(last) > max(0.97 * np.std(middle), 2 * case.noise.floor_m))


def critical_gain(case: Case, run: Run) -> float:
    """Least gain (A/V) at which the oscillation is sustained, to 1 %, starting from a fifth of the run's own.

    Raises:
        ValueError: where it oscillates at a fifth already, or at no gain up to 100 times its own.
    """
    own = float(run.controller["gain_A_per_V"])
    low = 0.2 * own
    if sustained(case, run, low):
        raise ValueError(f"{run.name} oscillates at a fifth of its gain")
    high = low
    while not sustained(case, run, high):
        low, high = high, 1.5 * high
        if high > 100 * own:
            raise ValueError(f"{run.name} oscillates at no gain")
    while high > 1.01 * low:
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if sustained(case, run, middle) else (middle, high)
    return float(np.sqrt(low * high))


def measured_gains(case: Case) -> list[dict[str, Any]]:
    """Critical gains of every setting among the runs, with the scatter of reading them, as tables of the contract."""
    rng = np.random.default_rng([case.seed, 5])
    found: list[dict[str, Any]] = []
    seen = set()
    for run in case.runs:
        setting = (run.controller["kind"], run.outer_end_mass_kg)
        if setting in seen:
            continue
        seen.add(setting)
        try:
            gain = critical_gain(case, run)
        except ValueError:
            continue  # on a rig, too, nothing is noted down then
        found.append(
            {
                "controller": {key: value for key, value in run.controller.items() if key != "gain_A_per_V"},
                "outer_end_mass_kg": run.outer_end_mass_kg,
                "inner_end_mass_kg": run.inner_end_mass_kg,
                "gain_A_per_V": float(f"{gain * np.exp(RELATIVE_STD * rng.normal()):.3g}"),
                "relative_std": RELATIVE_STD,
            }
        )
    return found


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
