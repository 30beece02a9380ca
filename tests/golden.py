"""Golden outputs: the figures that commands give for shipped prototypes, kept in the folder `golden` beside this file.

`python tests/golden.py --write [NAME ...]` makes them anew, all or some: a deliberate step, whose difference is to be
read. Figures are compared, not words: numbers, rationals, yes and no, and words of one piece such as a verdict.
"""

import csv
import hashlib
import json
import re
import sys
import tomllib
from collections.abc import Callable, Iterator
from contextlib import chdir
from dataclasses import dataclass
from fractions import Fraction
from itertools import zip_longest
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

STUDIES = Path(__file__).parents[1] / "studies"
KEPT = Path(__file__).with_name("golden")

AS_LONG = 16
"""Entries that are kept of a longer list of numbers, evenly spread, its last one too."""

EFFECTS = """
[effects.sensor_lag]
[effects.unequal_piston_areas]
[effects.valve_deadband]
[effects.mount_compliance]
"""
SCENARIO = """
name = "short"
duration_s = 0.25
sample_s = 0.0005
[[record]]
name = "push"
outer_end_mass_kg = 2.0
input = [{ kind = "step", amplitude_N = 200.0, at_s = 0.02 }]
[[record]]
name = "command"
outer_end_mass_kg = 6.8
input = [{ kind = "multisine", amplitude_V = 0.05, low_Hz = 4.0, high_Hz = 120.0, seed = 1, fade_s = 0.05 }]
"""
GAINS = """
name = "two gains"
prototype = "prototype.toml"
[[critical_gain]]
controller = { kind = "proportional" }
outer_end_mass_kg = 0.0
inner_end_mass_kg = 0.0
gain_A_per_V = 0.015
relative_std = 0.05
[[critical_gain]]
controller = { kind = "lag", pole_Hz = 1.75, zero_Hz = 26.0 }
outer_end_mass_kg = 6.8
inner_end_mass_kg = 4.4
gain_A_per_V = 0.15
relative_std = 0.05
"""
"""Two of the paper's four critical gains: all four take twice as long."""
SAMPLED = SCENARIO + "\n[sampled]\nperiod_s = 0.0005\ndelay_periods = 1\n"


@dataclass(frozen=True)
class Golden:
    """Commands in a folder of their own, and what of their output is kept.

    Attributes:
        commands: one line each; `{studies}` is the folder of the shipped ones.
        given: files that are there before, by name; a text may be appended to a shipped prototype.
        loose: figures that a search or an optimiser finds, as a pattern of paths; compared to 1 %.
        only: figures that are kept, as such a pattern; all where empty.
        fields: what gives a JSON where the command that does is too long.
    """

    commands: tuple[str, ...]
    given: tuple[tuple[str, str, str], ...] = ()
    loose: str = "(?!)"
    only: str = ""
    fields: Callable[[], dict[str, Any]] | None = None


def _paper() -> dict[str, Any]:
    """What `paper` writes as JSON; the command also draws, which takes ten times as long."""
    import beamdesign

    return beamdesign.paper().to_dict()


def _certified(prototype: str, options: str = "", more: str = "") -> Golden:
    """`certify`, and its certificate checked again; `more` is appended to the prototype."""
    commands = f"certify p.toml {options} --out certificate.toml", "certify p.toml --replay certificate.toml"
    return Golden(commands, (("p.toml", prototype, more),))


def _one(command: str, *given: tuple[str, str, str], loose: str = "(?!)", only: str = "") -> Golden:
    return Golden((command,), given, loose, only)


_DIAGNOSED = r"^0.json:(verdict|chosen|silent|gap|factor|shares|design|effects\[0\]\.(name|subsystem|probability))"
"""Rivals that explain as much may change places, so what is kept is the answer, the gap and the loops."""
_ANY = "prototypes"
_CLAIMS = "--peak-sensitivity 1.9 --bandwidth-Hz 3 --gain-margin 1.2 --decay-rate-per-s 1 --loop-gain 0.05"

GOLDEN: dict[str, Golden] = {
    "certify_remedy": _certified(f"{_ANY}/paper_remedy.toml", "--outer-end-mass 0:20"),
    "certify_lag": _certified(f"{_ANY}/tame_lag.toml", f"{_CLAIMS} --controller-effort-A-per-V 0.06"),
    "certify_structured": _certified(f"{_ANY}/structured.toml"),
    "certify_lqg": _certified(f"{_ANY}/lqg.toml"),
    "certify_hinf": _certified(f"{_ANY}/hinf.toml"),
    "certify_sensors": _certified("sensor_value/6.8_to_6.8_kg_displacement_inner_tip_pressure.toml"),
    "certify_compliant": _certified(f"{_ANY}/compliant.toml"),
    "certify_effects": _certified(f"{_ANY}/tame_lag.toml", "--peak-sensitivity 2.5", EFFECTS),
    "certify_box": Golden(
        (
            "certify-box {studies}/prototypes/tame_lag.toml --sigmas 0.5 --out box.toml",
            "certify --replay box.toml",
            "certify-box {studies}/prototypes/paper_remedy.toml --sigmas 1 --out refuted.toml",
            "certify --replay refuted.toml",
        ),
        loose="fraction|pieces|unstable_point|root|member",
    ),
    "certify_switching": Golden(
        (
            "certify-switching {studies}/prototypes/tame_lag.toml --outer-end-mass 0:5 --rate 1 --out switching.toml",
            "certify --replay switching.toml",
        ),
        loose="proved_up_to|dwell|decay|rate|claim",
    ),
    "certify_stages": Golden(
        (
            "certify-switching {studies}/scheduled/prototype.toml --out stages.toml",
            "certify --replay stages.toml",
        ),
        loose="dwell|decay|claim",
    ),
    # Not the residual of the optimum, which is rounding.
    "size": _one("size {studies}/prototype.toml", loose="free|price|shadow|relax", only=r"^(?!.*kkt_residual)"),
    "tune_lag": _one("tune {studies}/prototypes/paper_remedy.toml --outer-end-mass 0:1 --nominal --out out", loose=""),
    "code": _one("code {studies}/prototypes/tame_lag.toml --rate-Hz 10000 --word-length 24 --out out"),
    "simulate": _one("simulate p.toml --scenario s.toml --no-plots --out out",
                     ("p.toml", f"{_ANY}/tame_lag.toml", EFFECTS), ("s.toml", "", SCENARIO)),
    "simulate_sampled": _one("simulate {studies}/prototypes/tame_lag.toml --scenario s.toml --no-plots --out out",
                             ("s.toml", "", SAMPLED)),
    "simulate_compliant": _one("simulate {studies}/prototypes/compliant.toml --scenario s.toml --no-plots --out out",
                               ("s.toml", "", SCENARIO)),
    "simulate_structured": _one("simulate {studies}/prototypes/structured.toml --scenario s.toml --no-plots --out out",
                                ("s.toml", "", SCENARIO)),
    "simulate_scheduled": _one("simulate {studies}/scheduled/prototype.toml --scenario s.toml --no-plots --out out",
                               ("s.toml", "", SCENARIO)),
    "limits": _one("limits {studies}/prototypes/tame_lag.toml"),
    "spec": _one("spec {studies}/prototypes/tame_lag.toml --outer-end-mass 2:2 --out out",
                 loose="tolerances|stated", only=r"^0.json"),
    "arm": _one("arm {studies}/prototypes/arm.toml --force-N 2000 --out out"),
    "stiffness": Golden(
        (
            "stiffness {studies}/prototypes/compliant.toml --out out",
            "certify {studies}/prototypes/compliant.toml --replay out/certificate.contact.toml",
            "stiffness {studies}/prototypes/tame_lag.toml",
        )
    ),
    "gap_predict": _one("gap predict {studies}/gaps/slow_sensor/prototype.toml {studies}/gaps/slow_sensor --out out"),
    "gap_diagnose": _one("gap diagnose . --out out",
                         ("prototype.toml", "gaps/paper_gains/prototype.toml", ""), ("dataset.toml", "", GAINS),
                         loose="", only=_DIAGNOSED),
    "paper": Golden((), fields=_paper),
}  # fmt: skip


Figures = dict[str, Any]
"""By path: a number, yes or no, None, a word, or a list of numbers; exact rationals as text."""

_SKIPPED = re.compile(r"sha256|seconds|certificates$|\.P\b|version$")
"""Digests, effort, and matrices that a solver found: that these prove what they should is for the checker."""
_EXACT = re.compile(r"\.toml:(rig|controller|effect|loop|polynomials|range|outer_end_mass_kg|low$|high$)|\.c:")
"""Figures that must not move by a digit: those of the rig and its polynomials, and the words of the code."""
_WORD = re.compile(r"[A-Za-z_][\w:+-]*(\.[\w:+-]+)*")
_RATIONAL = re.compile(r"[+-]?\d+(\.\d+)?(e[+-]?\d+)?(/\d+)?", re.IGNORECASE)
_DEFINED = re.compile(r"^#define (\w+) (.*)$", re.MULTILINE)
_NUMBER = re.compile(r"(?<![\w.^])-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?(?!\w)")


def run(name: str, folder: Path) -> dict[str, Any]:
    """Exit statuses and figures of the commands of a golden output, run in an empty folder."""
    from typer.testing import CliRunner

    from beamdesign.cli import app

    asked = GOLDEN[name]
    for file, shipped, text in asked.given:
        (folder / file).write_text(((STUDIES / shipped).read_text() if shipped else "") + text)
    statuses = []
    with chdir(folder):
        for k, line in enumerate(asked.commands):
            words = line.format(studies=STUDIES).split()
            done = CliRunner().invoke(app, [*words, "--json", f"{k}.json"])
            if done.exit_code not in (0, 1) or not isinstance(done.exception, SystemExit | None):
                raise AssertionError(f"{line}: exit status {done.exit_code}, {done.exception}")
            statuses.append(done.exit_code)
        if asked.fields is not None:
            from beamdesign.result import json_text

            Path("fields.json").write_text(json_text(asked.fields()))
        given = {file for file, _, _ in asked.given}
        found: Figures = {}
        for path in sorted(Path().rglob("*")):
            if path.suffix in _READERS and path.name not in given:
                tree = _READERS[path.suffix](path.read_text(encoding="utf-8"))
                found |= {f"{path.as_posix()}:{key}": value for key, value in figures(tree).items()}
    found = {path: value for path, value in found.items() if re.search(asked.only, path)}
    return {"exit_status": statuses, "figures": found}


def figures(tree: dict[str, Any]) -> Figures:
    """What counts of the contents of a file."""
    return {path: value for path, value in _flat(tree, "") if not _SKIPPED.search(path)}


def _csv(text: str) -> dict[str, list[Any]]:
    """Columns by name; cells that are no numbers as they stand."""
    head, *rows = csv.reader(text.splitlines())
    cells = ([float(cell) if _RATIONAL.fullmatch(cell) else cell for cell in row] for row in rows)
    return {name: list(column) for name, column in zip(head, zip_longest(*cells), strict=True)} if rows else {}


def _defined(text: str) -> dict[str, list[float]]:
    """The numbers of every constant of a C text."""
    return {name: [float(number) for number in _NUMBER.findall(value)] for name, value in _DEFINED.findall(text)}


_READERS = {".json": json.loads, ".toml": tomllib.loads, ".csv": _csv, ".c": _defined}


def _flat(tree: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Paths with their figures. Lists of numbers stay whole; long lists are thinned, and state their length."""
    if isinstance(tree, dict):
        if path.endswith("polynomials") or re.search(r"loop\[\d+\]$", path):
            tree = _up_to_a_factor(tree)
        for key, value in tree.items():
            yield from _flat(value, f"{path}.{key}" if path else key)
    elif isinstance(tree, list):
        some = _thinned(len(tree))
        if tree and all(isinstance(entry, int | float) or _is_rational(entry) for entry in tree):
            yield path, [_figure(tree[k]) for k in some]
        else:
            for k in some:
                yield from _flat(tree[k], f"{path}[{k}]")
        if len(some) < len(tree) or not tree:
            yield f"{path}.length", len(tree)
    elif not isinstance(tree, str) or (tree := _figure(tree)) is not None:
        yield path, tree


def _thinned(count: int) -> list[int]:
    """Places that are kept of a list."""
    step = -(-count // AS_LONG) if count > AS_LONG + 4 else 1
    return sorted({*range(0, count, step), count - 1} - {-1})


def _is_rational(value: Any) -> bool:
    return isinstance(value, str) and _RATIONAL.fullmatch(value) is not None


def _figure(value: Any) -> Any:
    """A text as what counts of it: a rational with its value and a digest of what is exact; a word; else None."""
    if not isinstance(value, str):
        return value
    if _is_rational(value):
        exact = str(Fraction(value))
        digest = hashlib.sha256(exact.encode()).hexdigest()[:8]
        return exact if len(exact) <= 24 else f"{float(Fraction(value)):.12g} {digest}"
    return value if _WORD.fullmatch(value) and Path(value).suffix not in {*_READERS, ".html", ".svg", ".png"} else None


def _up_to_a_factor(polynomials: dict[str, Any]) -> dict[str, Any]:
    """Polynomials of one equation, divided by the first coefficient among them that is not zero."""

    def rationals(tree: Any) -> Any:
        return [rationals(entry) for entry in tree] if isinstance(tree, list) else Fraction(tree)

    def first(tree: Any) -> Fraction:
        return (
            next((found for entry in tree if (found := first(entry))), Fraction(0)) if isinstance(tree, list) else tree
        )

    def divided(tree: Any, by: Fraction) -> Any:
        return [divided(entry, by) for entry in tree] if isinstance(tree, list) else str(tree / by)

    exact = {key: rationals(value) for key, value in sorted(polynomials.items())}
    factor = first(list(exact.values())) or Fraction(1)
    return {key: divided(value, factor) for key, value in exact.items()}


def differences(name: str, kept: dict[str, Any], found: dict[str, Any]) -> list[str]:
    """What of a golden output is missing or other than it was, one line each; what is new does not count.

    Numbers that are computed may be off by 1e-6 of themselves, those of a list by 1e-6 of its largest as well, and
    what a search found (`Golden.loose`) by 1 %.
    """
    told = []
    if kept["exit_status"] != found["exit_status"]:
        told.append(f"exit status: {kept['exit_status']} was kept, {found['exit_status']} found")
    loose = re.compile(GOLDEN[name].loose)
    for path, value in kept["figures"].items():
        relative = 0.0 if _EXACT.search(path) else 1e-2 if loose.search(path) else 1e-6
        if path not in found["figures"]:
            told.append(f"{path}: missing, {value} was kept")
        elif not _alike(value, other := found["figures"][path], relative):
            told.append(f"{path}: {value} was kept, {other} found")
    return told


def _alike(kept: Any, found: Any, relative: float) -> bool:
    if isinstance(kept, list):
        if not isinstance(found, list) or len(kept) != len(found):
            return False
        largest = max((abs(value) for value in map(_value, kept) if isinstance(value, int | float)), default=0.0)
        return all(_close(a, b, relative, largest) for a, b in zip(kept, found, strict=True))
    return _close(kept, found, relative, 0.0)


def _value(kept: Any) -> Any:
    """A rational as a float; else what it was."""
    return float(Fraction(kept.split()[0])) if isinstance(kept, str) and _RATIONAL.match(kept) else kept


def _close(kept: Any, found: Any, relative: float, largest: float) -> bool:
    if relative:
        kept, found = _value(kept), _value(found)
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in (kept, found))
    if not (relative and numbers):
        return type(kept) is type(found) and kept == found
    return bool(abs(kept - found) <= relative * max(abs(kept), largest))


def kept(name: str) -> dict[str, Any]:
    """The golden output of a name.

    Raises:
        OSError: where none has been written.
    """
    found: dict[str, Any] = json.loads((KEPT / f"{name}.json").read_text(encoding="utf-8"))
    return found


def _write(names: list[str]) -> None:
    for name in names:
        with TemporaryDirectory() as folder:
            found = run(name, Path(folder))
        lines = [f"{json.dumps(path)}: {json.dumps(value)}" for path, value in found["figures"].items()]
        text = f'{{"exit_status": {found["exit_status"]}, "figures": {{\n' + ",\n".join(lines) + "\n}}\n"
        (KEPT / f"{name}.json").write_text(text, encoding="utf-8")
        print(name, found["exit_status"], len(found["figures"]), "figures")


if __name__ == "__main__":
    if sys.argv[1:2] != ["--write"] or not set(sys.argv[2:]) <= set(GOLDEN):
        sys.exit(f"usage: python tests/golden.py --write [NAME ...]\n{__doc__}\nnames: {', '.join(GOLDEN)}")
    _write(sys.argv[2:] or list(GOLDEN))
