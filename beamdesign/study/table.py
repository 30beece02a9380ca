"""The table of a sweep: one row per case in a stable order, as Parquet and CSV."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from beamdesign.files import write_whole
from beamdesign.records import InputError
from beamdesign.spelling import in_csv
from beamdesign.study.case import short

TABLE = "table"


def rows(records: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Flat rows: number and address, the varied keys, status, outputs, reason; every row has every column."""
    varied = list(dict.fromkeys(key for record in records for key in record["varied"]))
    outputs = list(dict.fromkeys(key for record in records for key in record["outputs"]))
    found = []
    for number, record in enumerate(records):
        row: dict[str, Any] = {"case": number, "address": short(record["address"])}
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


def write_tables(folder: Path, records: Sequence[dict[str, Any]], name: str = TABLE) -> list[Path]:
    """Write NAME.csv and NAME.parquet of the records of cases into a folder."""
    return write_columns(folder, rows(records), name)


def write_columns(folder: Path, table: Sequence[dict[str, Any]], name: str) -> list[Path]:
    """Write flat rows, which all have the same columns, as NAME.csv and NAME.parquet."""
    paths = [folder / f"{name}.csv", folder / f"{name}.parquet"]
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(table[0]) if table else ["case"], lineterminator="\n")
    writer.writeheader()
    writer.writerows({key: in_csv(value) for key, value in row.items()} for row in table)
    write_whole(paths[0], text.getvalue())
    _write_parquet(paths[1], table)
    return paths


def _write_parquet(path: Path, table: Sequence[dict[str, Any]]) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    columns = list(table[0]) if table else []
    arrays = {name: _column([row[name] for row in table]) for name in columns}
    content = pa.BufferOutputStream()
    parquet.write_table(pa.table(arrays), content)
    write_whole(path, content.getvalue().to_pybytes())


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
    differs = [
        name for name in table[0] if name not in ("case", "address") and len({str(row[name]) for row in table}) > 1
    ]
    if len(table) == 1:
        differs = [name for name in table[0] if name not in ("case", "address") and table[0][name] not in (None, "")]
    reason = [name for name in differs if name == "reason"]
    return ["case", *[name for name in differs if name != "reason"], *reason]


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
