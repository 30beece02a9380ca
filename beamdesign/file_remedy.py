"""What to do about a file that cannot be read, or that is of another kind than the one asked for."""

import difflib
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

_RECORDS = {
    "DesignProblem": "study", "Prototype": "prototype", "BenchPrototype": "prototype", "Scenario": "scenario",
    "Index": "data set", "Sweep": "sweep",
}  # fmt: skip

_INSTEAD = {
    ("prototype", "study"): "`beamdesign run {source} --out DIR` makes a prototype of it",
    ("study", "prototype"): "`beamdesign new study` starts a study",
    ("study", "sweep"): "`beamdesign study run` takes it",
    ("sweep", "study"): "`beamdesign run` takes it",
    ("prototype", "scenario"): "it goes with `beamdesign simulate PROTOTYPE --scenario {source}`",
    ("prototype", "certificate"): "`beamdesign certify --replay {source}` proves it again",
    ("scenario", "prototype"): "`beamdesign new scenario` starts a scenario",
}


def unreadable(path: Path, error: OSError) -> str:
    """The system's reason, and what to do."""
    reason = error.strerror or str(error)
    if isinstance(error, FileNotFoundError):
        return f"{reason}; {_similar(path)}"
    if isinstance(error, IsADirectoryError) or path.is_dir():
        inside = sorted(found.name for found in path.glob("*.toml"))
        return f"{reason}; name a file" + (f" in it: {', '.join(inside[:5])}" if inside else "")
    if isinstance(error, PermissionError):
        return f"{reason}; its permissions must let you read it"
    return reason


def _similar(path: Path) -> str:
    folder = path.parent
    if not folder.is_dir():
        return f"there is no folder {folder}"
    if path.is_symlink():
        return "it is a link to what is not there"
    names = [found.name for found in folder.iterdir() if found.suffix == path.suffix and found.name != path.name]
    close = difflib.get_close_matches(path.name, names, n=1, cutoff=0.75)
    if close:
        return f"did you mean {folder / close[0]}?"
    if path.suffix != ".toml":
        return "look for it with ls, or mend the name"
    return f"`beamdesign new{' dataset' if path.name == 'dataset.toml' else ''}` starts one"


def not_toml(raw: bytes, error: tomllib.TOMLDecodeError | UnicodeDecodeError) -> str:
    """The reader's reason, with the line it means and what it may lack."""
    if isinstance(error, UnicodeDecodeError):
        line = raw[: error.start].count(b"\n") + 1
        return f"not valid TOML: {error}, in line {line}; save the file as UTF-8"
    lines = raw.decode().splitlines()
    at = re.search(r"at line (\d+)", str(error))
    number = int(at[1]) if at else len(lines)
    shown = lines[number - 1].strip() if 0 < number <= len(lines) else ""
    told = f"not valid TOML: {error}"
    if not shown:
        return told
    return f"{told}; the line is: {shown[:80]}{_lack(shown)}"


def _lack(line: str) -> str:
    key, equals, value = line.partition("=")
    value = value.split("#")[0].strip()
    if line.startswith("["):
        return "" if line.rstrip().endswith("]") else " (a bracket is missing)"
    if not equals:
        return " (expected KEY = VALUE)"
    if not value:
        return " (the value is missing)"
    if value.count('"') % 2 or value.count("'") % 2:
        return " (a quotation mark is missing)"
    if re.fullmatch(r"[+-]?\d+,\d+", value):
        return " (write decimals with a point)"
    if re.fullmatch(r"[A-Za-z][\w -]*", value) and value not in ("true", "false", "inf", "nan"):
        return f' (text stands in quotes: {key.strip()} = "{value}")'
    return ""


def wrong_kind(table: Mapping[str, Any], record: str, source: str) -> str:
    """In words that a file is of another kind than the record it was to be read as; empty where it is not."""
    wanted = _RECORDS.get(record)
    if wanted is None:
        return ""
    found = kind_of(table)
    if found in ("", wanted):
        return ""
    remedy = _INSTEAD.get((wanted, found))
    told = f"is a {found}, where a {wanted} is expected"
    return told + (f"; {remedy.format(source=source)}" if remedy else "")


def kind_of(table: Mapping[str, Any]) -> str:
    """What kind of file a table is from, by the keys at its top; empty where they do not tell."""
    has = set(table).intersection
    if str(table.get("kind", "")).startswith("beamdesign."):
        return "certificate"
    if has({"load"}) or len(has({"sections", "clearance", "safety"})) > 1:
        return "study"
    if has({"vary"}) or isinstance(table.get("study"), Mapping):
        return "sweep"
    if has({"critical_gain", "frequency_response"}) or (has({"record"}) and has({"rig", "prototype"})):
        return "data set"
    if has({"record"}) and has({"duration_s", "sample_s"}):
        return "scenario"
    return "prototype" if has({"servovalve", "actuator"}) else ""
