"""What a finished sweep comes to: its table, yield of a specification, worst and best case, sensitivities; and why."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from beamdesign.columns import csv_text
from beamdesign.files import write_whole
from beamdesign.records import InputError
from beamdesign.sweep.methods import NO_RESULT, Plan, cost, figures_of
from beamdesign.sweep.sweep_file import Demand, Sweep

Row = Mapping[str, Any]
_SHOWN = 12  # letters of an address that people are shown


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
    """How many rows meet the specification. Rows without a result do not; yields only come from random samples."""
    from beamdesign.validation.bounds import clopper_pearson

    demands = sweep.specification
    each = {name: [holds(demand, row["outputs"].get(name)) for row in records] for name, demand in demands.items()}
    passed = sum(map(all, zip(*each.values(), strict=True)))
    found: dict[str, Any] = {"met": passed, "of": len(records), "each": {name: sum(one) for name, one in each.items()}}
    if sweep.study.method == "tolerance":
        low, high = clopper_pearson(passed, len(records), sweep.spread.confidence)
        found |= {"yield": passed / len(records), "bounds": [low, high], "confidence": sweep.spread.confidence}
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


def _extreme(records: Sequence[Row], output: str, largest: bool) -> dict[str, Any] | None:
    found = [(cost(row, output, largest), number) for number, row in enumerate(records)]
    least, number = min(found, default=(NO_RESULT, 0))
    if least == NO_RESULT:
        return None
    row = records[number]
    return {"case": number, "output": output, "value": row["outputs"][output], "varied": row["varied"]}


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
    output's variance; figures of the payload range and of the beams spread as `beamdesign.sweep.methods` says.
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


NEARLY = 0.98
"""Share of its limit from which a check is said to bind."""


def governing(record: Row) -> dict[str, Any]:
    """What governs a case, from what its task has kept.

    Returns:
        the `record` as kept; structural `checks`, the most used first; `binding`, names of those that are used to at
        least `NEARLY`; `requirements` that are active at the optimum over free sizes; `shadow_prices`, kg per unit of
        each requirement there; and for a no `relaxations`, requirements of which easing one alone is enough. What a
        task does not keep is empty.
    """
    details = record["details"]
    checks = sorted(details.get("checks", []), key=lambda check: -(check["utilisation"] or float("inf")))
    return {
        "record": record,
        "checks": checks,
        "binding": [one["name"] for one in checks if one["utilisation"] is None or one["utilisation"] >= NEARLY],
        "requirements": details.get("active", []),
        "shadow_prices": details.get("shadow_prices", {}),
        "relaxations": details.get("relaxations", []),
    }


def rows(records: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Flat rows: number and address, the varied keys, status, outputs, reason; every row has every column."""
    varied = list(dict.fromkeys(key for record in records for key in record["varied"]))
    outputs = list(dict.fromkeys(key for record in records for key in record["outputs"]))
    found = []
    for number, record in enumerate(records):
        row: dict[str, Any] = {"case": number, "address": record["address"][:_SHOWN]}
        row |= {key: cell(record["varied"].get(key)) for key in varied}
        row["status"] = record["status"]
        # An output may bear the name of a varied key, such as a breadth that was asked for.
        row |= {key: cell(record["outputs"].get(key)) for key in outputs if key not in row}
        row["reason"] = record["reason"]
        found.append(row)
    return found


def cell(value: Any) -> Any:
    """A value as a cell: lists and tables become text."""
    if isinstance(value, list):
        return "; ".join(f"{item:.10g}" if isinstance(item, float) else str(item) for item in value)
    if isinstance(value, dict):
        return ", ".join(f"{key} = {item}" for key, item in value.items())
    return value


def write_columns(folder: Path, table: Sequence[dict[str, Any]], name: str) -> list[Path]:
    """Write flat rows as NAME.csv and NAME.parquet; a cell that a row lacks is empty."""
    import pyarrow as pa
    from pyarrow import parquet

    paths = [folder / f"{name}.csv", folder / f"{name}.parquet"]
    write_whole(paths[0], csv_text(table, "\n") if table else "case\n")
    columns = dict.fromkeys(column for row in table for column in row)
    arrays = {column: _column([row.get(column) for row in table]) for column in columns}
    content = pa.BufferOutputStream()
    parquet.write_table(pa.table(arrays), content)
    write_whole(paths[1], content.getvalue().to_pybytes())
    return paths


def _column(values: list[Any]) -> Any:
    """One type per column: whole numbers beside others become floats, and anything beside text becomes text."""
    import pyarrow as pa

    kinds = {type(value) for value in values if value is not None}
    if kinds == {int, float}:
        values = [None if value is None else float(value) for value in values]
    elif len(kinds) > 1:
        values = [None if value is None else str(value) for value in values]
    return pa.array(values)


def chosen(columns: Sequence[str], asked: str) -> list[str]:
    """Columns that are asked for, by their names or parts of them, in the order of asking.

    Raises:
        InputError: for a name that no column has.
    """
    found: list[str] = []
    problems = []
    for part in (text.strip() for text in asked.split(",")):
        named = [part] if part in columns else [column for column in columns if part and part in column]
        if not named:
            problems.append((part, f"no such column; there are {', '.join(columns)}"))
        found += [column for column in named if column not in found]
    if problems:
        raise InputError("--columns", problems)
    return found


def worth_showing(table: Sequence[dict[str, Any]]) -> list[str]:
    """Columns for a terminal: number, what varies, outputs that differ; not the address, no constants."""
    names = [name for name in table[0] if name not in ("case", "address")]
    if len(table) == 1:
        names = [name for name in names if table[0][name] not in (None, "")]
    else:
        names = [name for name in names if len({str(row[name]) for row in table}) > 1]
    return ["case", *sorted(names, key=lambda name: name == "reason")]  # which stands last


def ordered(table: Sequence[dict[str, Any]], sort: str | None) -> list[dict[str, Any]]:
    """Rows sorted by a column, those without a value last; -NAME turns the order round.

    Raises:
        InputError: for a column that is not there.
    """
    if sort is None:
        return list(table)
    (name,) = chosen(list(table[0]), sort.removeprefix("-"))[:1]
    having = [row for row in table if row[name] is not None]
    numeric = all(isinstance(row[name], int | float) for row in having)
    having.sort(key=lambda row: row[name] if numeric else str(row[name]), reverse=sort.startswith("-"))
    return [*having, *(row for row in table if row[name] is None)]
