"""Hostile inputs: shipped ones mutated by a seed, the command that is given them, and what is a fault of its answer.

A mutant is one command of `COMMANDS` in a folder of its own, with one thing wrong: a figure, a key, a text, the
structure or the bytes of a file, what kind of file it is, a column of a table, a stored result, or a word of the
command line. Everything follows from the seed. An answer is a fault if it takes too long, is none of the exit
statuses 0, 1 and 2, shows a traceback or control characters, ran what a name said, wrote outside of its folder, wrote
anything although it refused, refused without naming a source, or came from an edited result.
"""

import hashlib
import json
import multiprocessing
import os
import pkgutil
import random
import re
import resource
import shlex
import shutil
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
"""Of the commands: they are those of this project, wherever they work."""
SECONDS = 20.0
"""Most that an answer may take, unless its command says otherwise."""
MEMORY_BYTES = 4 * 2**30
LARGEST_FILE_BYTES = 2**30
"""That a command may write."""
ENOUGH = 1000
"""Status of a command that had examined its inputs and gone on to its work, and was ended there."""

_RIG, _TAME, _SET = "studies/prototypes/paper_remedy.toml", "studies/prototypes/tame_lag.toml", "studies/gaps"
MADE = {
    "made/mass_range.toml": "certify studies/prototypes/structured.toml --out made/mass_range.toml --bandwidth-Hz 3",
    "made/members.toml": "certify made/sticky.toml --out made/members.toml",
    "made/box.toml": f"certify-box {_TAME} --sigmas 0.5 --only flow_gain --out made/box.toml",
    "made/switching.toml": f"certify-switching {_TAME} --outer-end-mass 3:3.4 --out made/switching.toml",
    "made/stages.toml": "certify-switching studies/scheduled/prototype.toml --out made/stages.toml",
    "made/contact": "stiffness studies/prototypes/compliant.toml --out made/contact",
    "made/plane": "arm studies/prototypes/arm.toml --out made/plane",
    "made/store": "study run made/sweep.toml --cases 4 --out made/store",
    "made/other": "study run studies/sweeps/materials.toml --cases 2 --out made/other",
}
"""Files and folders that are not shipped, by the commands that make them."""


@dataclass(frozen=True)
class Command:
    """A command line; the files that it names are copied into the mutant's folder, and those that stand beside."""

    line: str
    beside: str = ""
    quick: bool = True
    share: float = 1.0
    enough: str = ""
    """A pattern of files: once there is one, the inputs have been taken."""
    seconds: float = SECONDS

    @property
    def files(self) -> list[str]:
        """Shipped and made ones."""
        words = [*self.line.split(), *self.beside.split()]
        return [word for word in words if word.startswith(("studies/", "made/"))]


_PROOF = "--out out/proof.toml"
COMMANDS = [
    Command("size studies/prototype.toml", share=2),
    Command("size studies/prototypes/structured.toml"),
    Command("size studies/codesign.toml"),
    Command(f"certify {_RIG} --outer-end-mass 0:6.8 {_PROOF}", share=3),
    Command(f"certify studies/prototypes/structured.toml --bandwidth-Hz 3 --peak-sensitivity 2 {_PROOF}", share=2),
    Command(f"certify {_TAME} --decay-rate-per-s 0.1 --gain-margin 1.2 --loop-gain 9 {_PROOF}", share=2),
    Command(f"certify studies/prototypes/lqg.toml {_PROOF}"),
    Command(f"certify studies/prototypes/published_lag.toml --outer-end-mass 0:2 {_PROOF}"),
    Command(f"certify made/sticky.toml {_PROOF}"),
    Command("certify --replay made/mass_range.toml", share=2),
    Command(f"certify {_RIG} --replay made/mass_range.toml"),
    Command("certify --replay made/box.toml", share=2),
    Command("certify --replay made/switching.toml", share=2),
    Command("certify --replay made/stages.toml", quick=False),
    Command("certify --replay made/members.toml"),
    Command("certify --replay made/contact/certificate.contact.toml"),
    Command("certify --replay made/plane/certificate_y.toml", quick=False),
    Command(f"certify-box {_TAME} --sigmas 0.5 --only flow_gain --delay-s 1e-4 --budget 300 {_PROOF}"),
    Command(f"certify-switching {_TAME} --rate 0.1 {_PROOF}"),
    Command(f"certify-switching studies/scheduled/prototype.toml {_PROOF}", quick=False),
    Command("arm studies/prototypes/arm.toml --offset-m 0.1,0.1,0 --out out", quick=False),
    Command("stiffness studies/prototypes/compliant.toml --rigs 2 --wall-N-per-m 0:1e9"),
    Command(f"code {_TAME} --rate-Hz 10000 --out out"),
    Command(f"code {_TAME} --rate-Hz 10000 --float --compile --out out", quick=False, share=2),
    Command("explain gain_A_per_V"),
    Command("explain --reference"),
    Command(f"simulate {_RIG} --scenario studies/scenarios/kick.toml --no-plots --out out", share=2),
    Command("simulate studies/bench/cylinder.toml --scenario studies/bench/out_and_back.toml --no-plots --out out"),
    Command(f"simulate {_RIG} --scenario studies/scenarios/wall.toml --out out", quick=False),
    Command(f"simulate {_RIG} --scenario studies/scenarios/commands.toml --no-plots --out out", quick=False),
    Command(f"limits {_RIG} --payload 6.8 --preload 10 --out out", quick=False),
    Command("study run made/sweep.toml --cases 4 --out made/store", _RIG, share=3),
    Command("study run studies/sweeps/lag_breaks.toml --cases 4 --out made/other", _RIG, quick=False),
    Command("study run studies/sweeps/end_masses.toml --cases 2 --out made/store", _RIG, quick=False, share=2),
    Command("study run studies/sweeps/link_length.toml --cases 1 --out made/store", "studies/prototype.toml", False),
    Command("study status studies/sweeps/lag_breaks.toml --cases 4 --out made/store", _RIG),
    Command("study status studies/sweeps/tolerance.toml --out made/store", _TAME),
    Command("study status studies/sweeps/largest_bandwidth.toml --out made/store", _RIG),
    Command("study show made/store --columns stable --sort case --first 2"),
    Command("study why ./made/store/1", beside="made/store"),
    Command("study diff made/store made/other"),
    Command(f"gap predict {_TAME} {_SET}/slow_sensor --out out", quick=False, share=2),
    Command(f"gap diagnose {_SET}/slow_sensor --workers 1 --out out", share=4, enough="*/fits/*"),
    Command(f"gap diagnose {_SET}/paper_gains --workers 1 --out out", quick=False, seconds=120, share=0.5),
    Command("new study --out out/fresh.toml"),
    Command("run studies/prototype.toml --out out", quick=False, seconds=120, share=0.5),
    Command(f"spec {_TAME} --out out", quick=False, seconds=120, share=0.5),
]


@dataclass
class Mutant:
    """One command with one thing wrong, in its folder."""

    seed: int
    command: Command
    words: list[str]
    folder: Path
    kind: str = "as shipped"
    label: str = ""
    encoding: str = "utf-8"
    """Of the terminal."""
    named: list[str] = field(default_factory=list)
    """What a refusal may name as its source."""
    believed: dict[str, str] = field(default_factory=dict)
    """Digests of the files that the command has to give, should it give any."""

    @property
    def work(self) -> Path:
        """The folder that the command works in; two more stand around it."""
        return self.folder / "around" / "work"

    def __str__(self) -> str:
        words = " ".join(shlex.quote(word[:60]) if word.isprintable() else ascii(word) for word in self.words)
        return f"{self.seed}: {words} [{self.kind}] {self.label}"


# What is written instead of something.
FIGURES = (
    "0", "-1", "1e30", "5e-324", "1e308", "nan", "inf", "-inf", "1e-30", "9" * 5000, '"text"', "[1.0, 2.0]", "[]", "{}",
    "true", '""', "2e-308", "1e400", "[[[[1.0]]]]",
)  # fmt: skip
MARK = "HOSTILE_MARK"
CODE = rf"""*\
/
#ifndef RAN
#define RAN
#include <stdlib.h>
static int ran; __attribute__((constructor)) static void run(void) {{ ran = system("touch ${MARK}"); }}
#endif
/\
*"""
"""A name that ends the comment it stands in, although `*/` is broken up: C joins lines first."""
TEXTS = (
    "", " ", "a\nb", 'a"b', "a\\", "*/ x /*", CODE, f"`touch ${MARK}`", "$HOME",
    "../../../escape", "/proc/nowhere/x", "\x1b[31mred", "\x07\x08", "\x00", "a" * 100_000, "Träger", "橋梁", "nan",
    "\u202eesrever", "\x85\u2028", "{{ 7 * 7 }}", "<script>alert(1)</script>", "%s%n", "a/b", "-rf", ".", "1e308",
    "(s + leakage + gain + oil)**60", "-" * 20_000 + "1", "1/0", "9" * 4000,
)  # fmt: skip
WORDS = (
    "", "nan", "inf", "-1", "0", "1e308", "5e-324", "a", "1:0", "0:1e30", "5e-324:1", "1:2:3", "nan:nan", ":", ",,",
    "../..", "x" * 5000, "\x1b[31m", "-", "--", "9" * 5000, "1000000", "nothing.toml", "studies", "out/table.csv/x",
    "/proc/nowhere",
)  # fmt: skip
_FIGURE = re.compile(r"(?<![\w.])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?(?![\w.-])")
_TEXT = re.compile(r'"(?:[^"\n\\]|\\.)*"')
_KEY = re.compile(r'^[ \t]*"?([A-Za-z_][\w.]*)"?[ \t]*[=:].*\n', re.MULTILINE)
_TABLE = re.compile(r"^\[+[^\]\n]+\]+[ \t]*\n", re.MULTILINE)
_COMMENT = re.compile(r"#[^\"\n]*$", re.MULTILINE)
_SEAL = re.compile(r'^sha256 = "[0-9a-f]{64}"\n', re.MULTILINE)

Change = tuple[str, str | bytes]
"""A label, and the file's new content."""


def _put(text: str, found: re.Match[str], new: str) -> str:
    return text[: found.start()] + new + text[found.end() :]


def _line(text: str, found: re.Match[str]) -> str:
    """The line of a place, short."""
    start, end = text.rfind("\n", 0, found.start()) + 1, text.find("\n", found.start())
    return text[start : end if end >= 0 else None].strip()[:60]


def figure(dice: random.Random, text: str) -> Change:
    """Another figure, or something else in a figure's place, or two figures in each other's."""
    places = list(_FIGURE.finditer(text))
    place = dice.choice(places)
    if dice.random() < 0.1:
        one, other = sorted(dice.choices(places, k=2), key=lambda found: found.start())
        swapped = text if one == other else _put(_put(text, other, one[0]), one, other[0])
        return f"{_line(text, one)} <-> {_line(text, other)}", swapped
    scaled = [f"{float(place[0]) * factor:.6g}" for factor in (1e3, 1e-3, -1.0, 1e6)]
    new = dice.choice([*FIGURES, *scaled])
    return f"{_line(text, place)}: {place[0][:20]} -> {new[:20]}", _put(text, place, new)


def key(dice: random.Random, text: str) -> Change:
    """A line or the head of a table dropped, doubled or misspelt."""
    place = dice.choice([*_KEY.finditer(text), *_TABLE.finditer(text)])
    how = dice.choice(("dropped", "doubled", "renamed", "dropped"))
    new = {"dropped": "", "doubled": place[0] * 2, "renamed": re.sub(r"(\w)(\W)", r"\1x\2", place[0], count=1)}[how]
    return f"{_line(text, place)}: {how}", _put(text, place, new)


def quoted(dice: random.Random, text: str) -> Change:
    """Another text."""
    place, new = dice.choice(list(_TEXT.finditer(text))), dice.choice(TEXTS)
    return f"{_line(text, place)}: {new[:20]!r}", _put(text, place, json.dumps(new, ensure_ascii=False))


def structure(dice: random.Random, text: str) -> Change:
    """Deep or large values, in front or for a figure."""
    values = {
        "array 5,000 deep": "[" * 5000 + "]" * 5000,
        "table 5,000 deep": "{a=" * 5000 + "1" + "}" * 5000,
        "20 MB array": f"[{'1,' * 10**7}1]",
        "20 MB text": f'"{"a" * 2 * 10**7}"',
        "100,000 numbers": f"[{'1.5,' * 10**5}1.5]",
    }
    fronts = {
        "dotted key of 5,000 parts": ".".join("a" * 5000) + " = 1\n",
        "dotted table of 5,000 parts": f"[{'.'.join('a' * 5000)}]\n",
        "10,000 tables": "".join(f"[t{k}]\n" for k in range(10_000)),
        **{name: f"surplus = {value}\n" for name, value in values.items()},
    }
    if dice.random() < 0.5:
        name = dice.choice(list(fronts))
        return f"{name} in front", fronts[name] + text
    name, place = dice.choice(list(values)), dice.choice(list(_FIGURE.finditer(text)))
    return f"{_line(text, place)}: {name}", _put(text, place, values[name])


def raw(dice: random.Random, text: str) -> Change:
    """Other bytes."""
    data = text.encode()
    flipped, where = bytearray(data), dice.randrange(len(data) + 1)
    for _ in range(dice.randint(1, 5)):
        flipped[dice.randrange(len(data))] ^= 1 << dice.randrange(8)
    ways: dict[str, bytes] = {
        "byte-order mark": b"\xef\xbb\xbf" + data,
        "Latin-1": b"# Tr\xe4ger\n" + data,
        "UTF-16": text.encode("utf-16"),
        f"NUL at {where}": data[:where] + b"\0" + data[where:],
        f"cut at {where}": data[:where],
        "bits flipped": bytes(flipped),
        "empty": b"",
        "CRLF": data.replace(b"\n", b"\r\n"),
        "CR": data.replace(b"\n", b"\r"),
        "binary": dice.randbytes(2000),
    }
    name = dice.choice(list(ways))
    return name, ways[name]


def column(dice: random.Random, text: str) -> Change:
    """A table with another cell, column, order or notation."""
    every = [line.split(",") for line in text.splitlines()]
    head, *rows = every
    i, j, where = dice.randrange(1, len(every)), dice.randrange(len(head)), dice.randrange(len(text))
    cell = dice.choice(("", "nan", "inf", "text", "1e308", "-1e308", "5e-324", "9" * 5000, '"', "1e400", " "))
    before, row, after = every[:i], every[i], every[i + 1 :]

    def of(k: int, change: Callable[[str], str]) -> list[list[str]]:
        return [head, *([*row[:k], change(row[k]), *row[k + 1 :]] for row in rows)]

    ways: dict[str, Callable[[], list[list[str]]]] = {
        f"row {i} {cell[:20]!r}": lambda: [*before, [*row[:j], cell, *row[j + 1 :]], *after],
        f"every row {cell[:20]!r}": lambda: of(j, lambda _: cell),
        "times 1000": lambda: of(j, lambda value: f"{float(value) * 1000:.9g}"),
        "times in ms": lambda: of(0, lambda value: f"{float(value) * 1000:.9g}"),
        "times doubled": lambda: of(0, lambda value: f"{float(value) * 2:.9g}"),
        "dropped": lambda: [[*row[:j], *row[j + 1 :]] for row in every],
        "doubled": lambda: [[*row, row[j]] for row in every],
        "renamed": lambda: [[*head[:j], head[j] + dice.choice("x \x1b"), *head[j + 1 :]], *rows],
        "shuffled": lambda: [head, *dice.sample(rows, len(rows))],
        "reversed": lambda: [head, *rows[::-1]],
        "one row": lambda: every[:2],
        "no row": lambda: [head],
        "no head": lambda: rows,
        "short row": lambda: [*before, row[:-1], *after],
        "semicolons": lambda: [[";".join(row)] for row in every],
        "decimal commas": lambda: [[";".join(row).replace(".", ",")] for row in every],
        "cut": lambda: [[text[:where]]],
    }
    name = dice.choices(list(ways), [5, 2, *[1] * (len(ways) - 2)])[0]
    return f"{head[j]} {name}", "".join(",".join(row) + "\n" for row in ways[name]())


def stored(dice: random.Random, text: str) -> Change:
    """A stored result of another content."""
    if dice.random() < 0.3:
        new = dice.choice(('{"status":"done"}', "{}", "[]", "null", "1", '"text"', "[" * 5000, '{"rows": 1}'))
        return new[:20], new
    record = json.loads(text)
    name = dice.choice(list(record))
    value = dice.choice(("weird", "done", "0" * 64, 1, None, [], {}, 1e308, "\x1b[31m", [[1]], True))
    return f"{name}: {value!r}", json.dumps({**record, name: value}, indent=1)


TOML: dict[Callable[[random.Random, str], Change], int] = {figure: 6, key: 2, quoted: 3, structure: 2, raw: 2}
CHANGES = {
    ".toml": TOML,
    ".csv": {column: 8, raw: 2},
    ".json": {stored: 6, figure: 2, quoted: 2, key: 1, raw: 2},
}
"""Ways to change a file by its kind, with their shares."""


def another_kind(dice: random.Random, path: Path) -> str:
    """Something else in a file's place."""
    kinds: dict[str, Callable[[], None]] = {
        "missing": lambda: None,
        "folder": path.mkdir,
        "pipe": lambda: os.mkfifo(path),
        "/dev/zero": lambda: path.symlink_to("/dev/zero"),
        "link to nothing": lambda: path.symlink_to("nothing"),
        "link to itself": lambda: path.symlink_to(path.name),
        "10 GB": lambda: os.close(os.open(path, os.O_CREAT)) or os.truncate(path, 10**10),
        "unreadable": lambda: path.touch(0),
    }
    path.unlink()
    name = dice.choice(list(kinds))
    kinds[name]()
    return name


def stock_in(folder: Path) -> Path:
    """The folder that holds what `make` lays out."""
    return Mutant(0, COMMANDS[0], [], folder).work


def make(folder: Path, commands: Sequence[Command] = COMMANDS, forked: bool = False) -> Path:
    """Lay out all that commands are given, shipped or made; the folder that holds it."""
    stock = stock_in(folder)
    shutil.copytree(ROOT / "studies", stock / "studies", ignore=shutil.ignore_patterns("*.svg", "*.py", "__pycache__"))
    tame = (stock / _TAME).read_text(encoding="utf-8")
    (stock / "made").mkdir()
    (stock / "made/sticky.toml").write_text(f"{tame}\n[effects.seal_friction]\ncoulomb_N = 20.0\n", encoding="utf-8")
    sweep = (stock / "studies/sweeps/lag_breaks.toml").read_text(encoding="utf-8").partition("[[picture]]")[0]
    (stock / "made/sweep.toml").write_text(sweep.replace("../prototypes", "../studies/prototypes"), encoding="utf-8")
    wanted = [name for command in commands for name in command.files]
    for made, line in MADE.items():
        if any(name.startswith(made) for name in wanted):
            ask(Mutant(0, Command(line, seconds=600), line.split(), folder), forked)
    return stock


def command_of(seed: int) -> Command:
    """The command whose inputs the mutant of a seed changes."""
    return random.Random(seed).choices(COMMANDS, [one.share for one in COMMANDS])[0]


def mutant(seed: int, folder: Path, stock: Path) -> Mutant:
    """The mutant of a seed, laid out in a fresh folder.

    Args:
        seed: decides everything.
        folder: to be made.
        stock: where `make` has put what is not shipped.
    """
    dice = random.Random(f"mutant {seed}")
    made = laid_out(command_of(seed), folder, stock, seed)
    if dice.random() < 0.06:
        made.encoding = dice.choice(("ascii", "latin-1"))
    inputs = [path for name in made.command.files for path in _files(made.work / name)]
    if not inputs or dice.random() < 0.12:
        _other_word(dice, made)
        return made
    if made.words[0] == "study" and dice.random() < 0.5:  # what is stored, else the sweep
        inputs = [path for path in inputs if path.suffix == ".json"] or inputs
    path = dice.choice([path for path in inputs if path.suffix in CHANGES and path.name != "table.csv"])
    made.label = str(path.relative_to(made.work))
    made.named.append(path.name)
    if path.suffix == ".json" and made.command.line.startswith("study run made/sweep.toml"):
        made.believed["made/store/table.csv"] = _digest(stock / "made/store/table.csv")
    if path.suffix == ".json" and dice.random() < 0.2:
        other = dice.choice([*_files(stock / "made/store"), *_files(stock / "made/other")])
        made.kind, made.label = "foreign", f"{made.label}: {other.relative_to(stock)}"
        shutil.copyfile(other, path)
    elif dice.random() < 0.08:
        made.kind = "kind of file"
        made.label += f": {another_kind(dice, path)}"
    else:
        ways = CHANGES[path.suffix]
        way = dice.choices(list(ways), list(ways.values()))[0]
        text = path.read_text(encoding="utf-8")
        text = _COMMENT.sub("", text) if path.suffix == ".toml" else text
        try:
            label, content = way(dice, text)
        except IndexError:  # nothing of that kind in it
            way, (label, content) = raw, raw(dice, text)
        if isinstance(content, str):
            content = (_sealed(content) if dice.random() < 0.8 else content).encode()
        path.write_bytes(content)
        made.kind = way.__name__
        made.label += f": {label}"
    return made


def laid_out(command: Command, folder: Path, stock: Path, seed: int = -1) -> Mutant:
    """A command with its inputs as they are shipped, and something older in `out`."""
    made = Mutant(seed, command, command.line.split(), folder)
    for name in command.files:
        source, target = stock / name, made.work / name
        if target.exists():
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        (shutil.copytree if source.is_dir() else shutil.copyfile)(source, target)
    made.named += [Path(name).name for name in command.files]
    (made.work / "out").mkdir(parents=True)
    for name in ("prototype.toml", "certificate.toml", "controller.c", "table.csv", "notes.txt"):
        (made.work / "out" / name).write_text("older\n")
    return made


def _other_word(dice: random.Random, made: Mutant) -> None:
    first = 2 if made.words[0] in ("study", "gap") else 1
    place, word = dice.randrange(first, len(made.words) + 1), dice.choice(WORDS)
    made.kind = "command line"
    made.label = f"word {place}: {word[:20]!r}"
    made.words[place : place + 1] = [word]
    made.named += ["Usage:", "(file)", *(word or "." for word in made.words[first:])]
    made.named += ["''"] if "" in made.words else []


def _sealed(text: str) -> str:
    """A certificate with the checksum of what it says now."""
    found = _SEAL.search(text)
    if found is None:
        return text
    digest = hashlib.sha256(_put(text, found, "").encode()).hexdigest()
    return _put(text, found, f'sha256 = "{digest}"\n')


def _files(path: Path) -> list[Path]:
    return sorted(found for found in path.rglob("*") if found.is_file()) if path.is_dir() else [path]


def _digest(path: Path) -> str:
    mode = path.lstat().st_mode
    if not stat.S_ISREG(mode) or not os.access(path, os.R_OK):
        return oct(mode)
    size = path.stat().st_size
    return f"{size} bytes" if size > 10**8 else hashlib.sha256(path.read_bytes()).hexdigest()


def tree(folder: Path) -> dict[str, str]:
    """Digests of all that a folder holds, by path."""
    return {
        str((Path(where) / name).relative_to(folder)): _digest(Path(where) / name)
        for where, folders, names in os.walk(folder)
        for name in [*folders, *names]
    }


@dataclass(frozen=True)
class Answer:
    """What a command did: its exit status (negative of a signal; None if it did not end), and what it said."""

    status: int | None
    seconds: float
    out: str
    err: str


def ask(made: Mutant, forked: bool = False) -> Answer:
    """Run a mutant's command within limits of time and memory: in a process of its own, or in a quick fork."""
    scratch = made.folder.with_name(made.folder.name + ".tmp")
    scratch.mkdir()
    said = scratch / "out", scratch / "err"
    variables = {"TMPDIR": str(scratch), "PYTHONIOENCODING": made.encoding, MARK: str(made.folder / "ran")}
    begun = time.monotonic()
    if forked:
        fork = begun_in_a_fork(made.words, made.work, said, variables)
        pid, poll = fork.pid or 0, lambda: fork.exitcode
    else:
        with said[0].open("wb") as out, said[1].open("wb") as err:
            process = subprocess.Popen(
                [sys.executable, "-m", "beamdesign", *made.words], cwd=made.work, stdin=subprocess.DEVNULL, stdout=out,
                stderr=err, start_new_session=True, env={**ENVIRONMENT, **variables},
            )  # fmt: skip
        pid, poll = process.pid, process.poll
    for what, most in ((resource.RLIMIT_AS, MEMORY_BYTES), (resource.RLIMIT_FSIZE, LARGEST_FILE_BYTES)):
        try:
            resource.prlimit(pid, what, (most, most))
        except ProcessLookupError:  # ended already
            break
    enough, seconds = False, 0.0
    while poll() is None and not enough and seconds < made.command.seconds:
        time.sleep(0.005)
        enough = any(made.work.glob(made.command.enough or "-"))
        if not said[0].exists():  # the server of forks is still being loaded
            begun = time.monotonic()
        seconds = time.monotonic() - begun - _waited(pid)
    status = poll()
    with suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)  # with the processes that it started
    while poll() is None:
        time.sleep(0.005)
    out_text, err_text = (path.read_text(encoding="utf-8", errors="replace") if path.exists() else "" for path in said)
    shutil.rmtree(scratch, ignore_errors=True)
    return Answer(ENOUGH if enough and status is None else status, seconds, out_text, err_text)


def _waited(pid: int) -> float:
    """Seconds that a process was ready to run and had no processor: a busy machine is no fault of the program."""
    try:
        return int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) * 1e-9
    except (OSError, IndexError):
        return 0.0


LIBRARIES = (
    "casadi", "control", "cvxpy", "flint", "matplotlib.pyplot", "numba", "pyarrow.parquet", "scipy.optimize",
    "scipy.signal",
)  # fmt: skip
"""That the program loads where it needs them."""


@cache
def _server() -> multiprocessing.context.ForkServerContext:
    """Whose forks begin with the program loaded."""
    context = multiprocessing.get_context("forkserver")
    modules = pkgutil.walk_packages([str(ROOT / "beamdesign")], "beamdesign.")
    loaded = [module.name for module in modules if "__main__" not in module.name]
    context.set_forkserver_preload([*loaded, *LIBRARIES])
    return context


def begun_in_a_fork(
    words: Sequence[str], work: Path, said: tuple[Path, Path], variables: dict[str, str]
) -> multiprocessing.process.BaseProcess:
    """A command of the program, begun in a group of its own without loading the program once more.

    Args:
        words: of the command line.
        work: folder that it works in.
        said: files for its output and its errors.
        variables: of its environment, beside those of this process.
    """
    fork = _server().Process(target=_act, args=(words, work, said, variables))
    fork.start()
    assert fork.pid
    return fork


def _act(given: Sequence[str], work: Path, said: tuple[Path, Path], variables: dict[str, str]) -> None:
    """Be the program, in a fork."""
    os.setsid()
    os.chdir(work)
    os.environ.update(variables)
    for number, path in enumerate(said, start=1):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND), number)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    sys.stdout.reconfigure(encoding=variables["PYTHONIOENCODING"], errors="strict")
    sys.stderr.reconfigure(encoding=variables["PYTHONIOENCODING"])
    sys.argv = ["beamdesign", *given]
    from beamdesign.cli import main

    main()


_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")


def _shown(name: str) -> str:
    """A name as a terminal is shown it: control characters by their numbers."""
    return _CONTROL.sub(lambda found: f"<U+{ord(found[0]):04X}>", name)


def faults(made: Mutant, answer: Answer, before: dict[str, str]) -> list[str]:
    """What is wrong with an answer, given what the mutant's folder held `before`."""
    found = []
    if answer.status is None:
        found.append(f"no answer within {made.command.seconds:g} s")
    elif answer.status not in (0, 1, 2, ENOUGH):
        found.append(f"signal {-answer.status}" if answer.status < 0 else f"exit status {answer.status}")
    if "Traceback (most recent call last)" in answer.out + answer.err:
        found.append("traceback")
    if _CONTROL.search(answer.out + answer.err):
        found.append("control characters")
    after = tree(made.folder)
    changed = sorted(name for name in {*before, *after} if before.get(name) != after.get(name))
    if "ran" in changed:
        found.append("ran code of its input")
    # A folder that was asked for is its own as well, wherever it is.
    asked = [os.path.normpath(f"around/work/{word}").removeprefix(".") for word in made.words if ".." in word]
    if any(not name.startswith(("around/work", *asked)) for name in changed if name != "ran"):
        found.append(f"wrote outside of its folder: {changed[0]}")
    if answer.status == 2:
        if changed:
            found.append(f"refused, and wrote {', '.join(Path(name).name for name in changed[:3])}")
        if not any(name in answer.err or _shown(name) in answer.err for name in made.named):
            found.append("refused without a source")
    if answer.status == 0:
        wrong = [name for name, digest in made.believed.items() if after.get(f"around/work/{name}") != digest]
        found += [f"believed an edited result: {name} differs" for name in wrong]
    return found
