"""What a finished sweep comes to: yield of a specification, worst case, best case, sensitivities."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from beamdesign.study.methods import NO_RESULT, cost, figures_of
from beamdesign.study.sampling import Plan
from beamdesign.study.sweep_file import Demand, Sweep

Row = Mapping[str, Any]


def conclude(laid: Plan, records: Sequence[Row]) -> dict[str, Any]:
    """What the rows of a sweep come to, by what its method is for; plain values."""
    sweep = laid.sweep
    found: dict[str, Any] = {}
    if sweep.specification and records:
        found["specification"] = met(sweep, records)
    if sweep.study.method == "optimise" and sweep.optimise is not None:
        found["best"] = _extreme(records, sweep.optimise.output, sweep.optimise.goal == "maximise")
    if sweep.study.method == "worst_case" and sweep.spread.output is not None:
        found["worst"] = _worst(sweep, records)
    if sweep.study.method == "sensitivity":
        found["sensitivity"] = sensitivity(laid, records)
    return found


def met(sweep: Sweep, records: Sequence[Row]) -> dict[str, Any]:
    """How many rows meet the specification. Rows without a result do not; yields only come from random samples.

    The bounds of a yield are those of Clopper and Pearson, Biometrika 26 (1934) 404-413.
    """
    demands = sweep.specification
    passed = [all(holds(demand, row["outputs"].get(name)) for name, demand in demands.items()) for row in records]
    each = {name: sum(holds(demand, row["outputs"].get(name)) for row in records) for name, demand in demands.items()}
    found: dict[str, Any] = {"met": sum(passed), "of": len(records), "each": each}
    if sweep.study.method == "tolerance":
        low, high = clopper_pearson(sum(passed), len(records), sweep.spread.confidence)
        found |= {"yield": sum(passed) / len(records), "bounds": [low, high], "confidence": sweep.spread.confidence}
    return found


def holds(demand: Demand, value: Any) -> bool:
    """Whether an output meets a demand; one that is missing does not."""
    if value is None:
        return False
    if demand.equals is not None:
        return bool(value == demand.equals)
    if isinstance(value, str | list):
        return False
    return (demand.at_least is None or value >= demand.at_least) and (demand.at_most is None or value <= demand.at_most)


def clopper_pearson(successes: int, trials: int, confidence: float) -> tuple[float, float]:
    """Exact two-sided bounds of a binomial share."""
    from scipy.stats import binomtest

    bounds = binomtest(successes, trials).proportion_ci(confidence_level=confidence, method="exact")
    return float(bounds.low), float(bounds.high)


def _extreme(records: Sequence[Row], output: str, largest: bool) -> dict[str, Any] | None:
    found = [(cost(row, output, largest), number) for number, row in enumerate(records)]
    least, number = min(found, default=(NO_RESULT, 0))
    if least == NO_RESULT:
        return None
    return {"case": number, "output": output, "value": records[number]["outputs"][output]} | {
        "varied": records[number]["varied"]
    }


def _worst(sweep: Sweep, records: Sequence[Row]) -> dict[str, Any] | None:
    """The worst row that the search met: one whose answer is no, or else the extreme value."""
    refusing = [number for number, row in enumerate(records) if row["status"] == "no"]
    output = sweep.spread.output or ""
    if refusing:
        row = records[refusing[0]]
        value = row["outputs"].get(output)
        return {"case": refusing[0], "output": output, "value": value, "reason": row["reason"], "varied": row["varied"]}
    return _extreme(records, output, sweep.spread.worst == "largest")


def sensitivity(laid: Plan, records: Sequence[Row]) -> list[dict[str, Any]]:
    """Sobol indices of outputs over the spreading figures, first-order and total, with half-widths of 95 %.

    Saltelli et al., Computer Physics Communications 181 (2010) 259-270, as SALib has it. An index is the share of an
    output's variance; figures of the payload range and of the beams spread as `beamdesign.study.methods` says.
    """
    from SALib.analyze import sobol

    outputs, figures = laid.sweep.spread.outputs, figures_of(laid.sweep, laid.base, laid.path)
    names = [figure.key for figure in figures]
    problem = {"num_vars": len(names), "names": names, "bounds": [[0, 1]] * len(names)}
    by_address = {row["address"]: row for row in records}
    rows = [by_address[one.address] for one in laid.cases]  # as drawn: a sample that comes twice is one row
    found: list[dict[str, Any]] = []
    for output in outputs:
        values = [row["outputs"].get(output) for row in rows]
        series = np.array(values, dtype=float)
        note = "does not vary" if np.ptp(series) == 0 else ""
        if missing := int(np.isnan(series).sum()):
            note = f"{missing} of {len(values)} cases have no number there"
        if note:
            found += [{"output": output, "figure": name, "note": note} for name in names]
            continue
        indices = sobol.analyze(problem, series, calc_second_order=False, seed=laid.sweep.study.seed)
        for k, name in enumerate(names):
            row = {column: float(indices[source][k]) for column, source in _INDICES.items()}
            found.append({"output": output, "figure": name, **row, "note": ""})
    return found


_INDICES = {"first_order": "S1", "first_order_half_width": "S1_conf", "total": "ST", "total_half_width": "ST_conf"}
"""Columns of the table of sensitivities, by SALib's names."""


def in_words(found: Mapping[str, Any], sweep: Sweep) -> list[str]:
    """The conclusions as sentences."""
    said = []
    if (asked := found.get("specification")) is not None:
        line = f"specification met by {asked['met']} of {asked['of']} cases"
        if "yield" in asked:
            low, high = asked["bounds"]
            line += (
                f": yield {100 * asked['yield']:.3g} %, {100 * asked['confidence']:g} % bounds {100 * low:.3g} to"
                f" {100 * high:.3g} % (sampled; the loop of each sample is proved)"
            )
        said.append(line)
        parts = [f"{name} by {count}" for name, count in asked["each"].items()]
        if len(parts) > 1:
            said.append(f"  of its demands: {', '.join(parts)}")
    notes = {row["output"]: row["note"] for row in found.get("sensitivity", ()) if row["note"]}
    said += [f"no sensitivity of {output}: {note}" for output, note in notes.items()]
    if "best" in found:
        best = found["best"]
        said.append(
            "no case is done, so there is no best one"
            if best is None
            else f"best {best['output']} found: {best['value']:.6g}, case {best['case']} (a search, no proof of a best)"
        )
    if "worst" in found:
        worst, reach = found["worst"], sweep.spread.sigmas
        if worst is None:
            said.append("no case has a result, so there is no worst one")
        elif worst.get("reason"):
            said.append(f"worst case within {reach:g} standard deviations: case {worst['case']}, {worst['reason']}")
        else:
            said.append(
                f"worst {worst['output']} found within {reach:g} standard deviations: {worst['value']:.6g},"
                f" case {worst['case']} (a search over corners, no proof; `beamdesign certify-box` proves stability)"
            )
    return said


def write_sensitivity(folder: Path, found: Mapping[str, Any]) -> list[Path]:
    """Write the table of sensitivities, where there is one."""
    if "sensitivity" not in found:
        return []
    from beamdesign.study.table import write_columns

    names = list(dict.fromkeys(name for row in found["sensitivity"] for name in row))
    return write_columns(
        folder, [{name: row.get(name) for name in names} for row in found["sensitivity"]], "sensitivity"
    )
