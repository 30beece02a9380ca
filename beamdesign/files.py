"""Files and folders of results: read within limits, and written whole or not at all; what to do about a bad one.

Temporary names are unpredictable and opened exclusively, so that no link laid beforehand is followed; what takes the
place of something older is on the disk before it does.
"""

import ctypes
import difflib
import errno
import glob
import os
import re
import secrets
import shutil
import stat
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

try:
    import fcntl
except ImportError:  # Windows: leftovers of killed runs stay where they are
    fcntl = None  # type: ignore[assignment]

MEGABYTE = 10**6
LARGEST_TEXT = 4 * MEGABYTE
"""Bytes of a TOML or JSON file that is read."""
LARGEST_TABLE = 256 * MEGABYTE
"""Bytes of a CSV file that is read."""

_KINDS = {stat.S_IFIFO: "a pipe", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device", stat.S_IFSOCK: "a socket"}
_TRIES = 100
_FRESH, _RENAME_EXCHANGE, _AT_FDCWD = ".fresh", 2, -100


def read_bytes(path: str | Path, at_most: int = LARGEST_TEXT) -> bytes:
    """Read a regular file that is not larger than so many bytes.

    Raises:
        OSError: where it cannot be read, is a folder, a pipe or a device, or is larger; its `strerror` says so.
    """
    with open(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)), "rb") as file:
        found = os.fstat(file.fileno())
        if stat.S_ISDIR(found.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not stat.S_ISREG(found.st_mode):
            raise OSError(errno.EINVAL, f"is {_kind(found.st_mode)}, not a regular file", str(path))
        if found.st_size <= at_most and len(content := file.read(at_most + 1)) <= at_most:
            return content
    size, limit = max(found.st_size, at_most + 1) / MEGABYTE, at_most / MEGABYTE
    reason = f"holds {size:.3g} MB, more than the {limit:g} MB that are read of such a file"
    raise OSError(errno.EFBIG, reason, str(path))


def _kind(mode: int) -> str:
    return _KINDS.get(stat.S_IFMT(mode), "something else")


def refuse_irreplaceable(path: Path) -> None:
    """Refuse what stands where a file is to be written and is none.

    Raises:
        OSError: naming it.
    """
    if path.exists() and not path.is_file():
        what = "a folder" if path.is_dir() else _kind(path.stat().st_mode)
        raise OSError(errno.EINVAL, f"is {what}, not a file that can be replaced", str(path))


def write_whole(path: str | Path, content: str | bytes) -> None:
    """Write a file; the folder is made if need be, and whoever reads the file never sees half of it.

    Text becomes the same bytes on every platform, since certificates are known by their digest.

    Raises:
        OSError: naming the file, where it cannot be written; what stood there before stands there still.
    """
    path = Path(path)
    refuse_irreplaceable(path)
    data = content.encode() if isinstance(content, str) else content
    for tries_left in reversed(range(_TRIES)):
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{path.name[:100]}.{secrets.token_hex(8)}")
        try:
            with open(partial, "xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            os.replace(partial, path)
            return
        except FileNotFoundError:  # the folder has been exchanged for a fresh one meanwhile: into that
            if not tries_left:
                raise
        except OSError as error:
            error.filename, error.filename2 = str(path), None
            raise
        finally:
            partial.unlink(missing_ok=True)


P = TypeVar("P")


def settled(paths: P, fresh: Path, folder: Path) -> P:
    """Paths (one, several, or by name) written in a fresh folder as they are once it has taken its place."""
    found: Any = paths
    if isinstance(paths, Path):
        found = folder / paths.relative_to(fresh)
    elif isinstance(paths, dict):
        found = {name: settled(path, fresh, folder) for name, path in paths.items()}
    elif isinstance(paths, list | tuple):
        found = type(paths)(settled(path, fresh, folder) for path in paths)
    return found


@contextmanager
def fresh_folder(folder: str | Path, retiring: Sequence[str] = ()) -> Iterator[Path]:
    """A fresh folder beside another, which takes its place as a whole when the block ends well.

    What the older one holds is in the fresh one as well; files are to be written with `write_whole`, which leaves the
    older ones as they are. An exception or a kill within the block leaves the older folder as it was, and the next
    call clears what was left. Where folders cannot be exchanged (a mount, the folder one works in, some file
    systems), older files go before the fresh ones take their places one by one: never do both stand side by side.

    Args:
        folder: of the results; made if need be.
        retiring: patterns of files of an older set that do not outlive it.

    Raises:
        OSError: naming what cannot be written.
    """
    final = Path(folder).resolve()
    if final.exists() and not final.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, "is a file, not a folder", str(folder))
    here = Path.cwd()
    worked_in = final == here or final in here.parents
    beside_it = os.access(final.parent, os.W_OK | os.X_OK)
    inside = final.is_dir() and (worked_in or final.is_mount() or not beside_it)  # else it can be exchanged
    beside = final if inside else final.parent
    beside.mkdir(parents=True, exist_ok=True)
    _clear_leftovers(beside, final.name)
    fresh = beside / f".{final.name[:100]}.{secrets.token_hex(8)}{_FRESH}"
    os.mkdir(fresh)
    with _held(fresh):
        try:
            known: set[Path] = _link_tree(final, fresh, retiring) if final.is_dir() else set()
            yield fresh
            for where, _, _ in os.walk(fresh):
                _sync(Path(where))
            if inside or not _take_place(fresh, final, known):
                _move_in(fresh, final, retiring)
            _sync(final)
            _sync(final.parent)
        finally:
            shutil.rmtree(fresh, ignore_errors=True)


def write_set(
    folder: str | Path, files: Mapping[str, tuple[str, str | bytes]], retiring: Sequence[str] = ()
) -> dict[str, Path]:
    """Write files as one set into a folder, as `fresh_folder` does.

    Args:
        folder: made if need be.
        files: name within the folder and content, by kind.
        retiring: see `fresh_folder`.

    Returns:
        The path of each, by kind.
    """
    with fresh_folder(folder, retiring) as fresh:
        for name, content in files.values():
            write_whole(fresh / name, content)
    return {kind: Path(folder) / name for kind, (name, _) in files.items()}


def _take_place(fresh: Path, final: Path, known: set[Path]) -> bool:
    """Let the fresh folder take the place of the final one, if there is one, at once; False where that cannot be.

    Files of the older one that are not among the `known` names came after the fresh one was begun, and move to it.
    """
    if not final.exists():
        try:
            os.rename(fresh, final)
            return True
        except OSError as error:
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                raise
    if not _exchange(fresh, final):
        return False
    for path in _files(fresh):  # `fresh` is the older one now, and another run may have added to it meanwhile
        name = path.relative_to(fresh)
        if name not in known and not name.name.startswith(".") and (final / name).parent.is_dir():
            os.replace(path, final / name)
    return True


def _exchange(one: Path, other: Path) -> bool:
    """Exchange two folders in one step of the file system; False where it knows no such step."""
    rename = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None) if os.name == "posix" else None
    if rename is None:
        return False
    return rename(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE) == 0


def _move_in(fresh: Path, final: Path, retiring: Sequence[str]) -> None:
    """Older files of the set go, then the fresh ones come: a kill between leaves some missing, none beside another."""
    own = [path.relative_to(fresh) for path in _files(fresh)]
    new = [name for name in own if not ((final / name).exists() and os.path.samefile(fresh / name, final / name))]
    gone = [path for pattern in retiring for path in final.glob(pattern) if fresh not in path.parents]
    for path in [*gone, *(final / name for name in new)]:
        path.unlink(missing_ok=True)
    for name in new:
        (final / name).parent.mkdir(parents=True, exist_ok=True)
        os.replace(fresh / name, final / name)


def _files(folder: Path) -> list[Path]:
    return [Path(where) / name for where, _, names in os.walk(folder) for name in names]


def _link_tree(source: Path, target: Path, retiring: Sequence[str]) -> set[Path]:
    """The files of a folder in another one as well, by links where the file system has them; names of all it holds."""
    gone = {path for pattern in retiring for path in source.glob(pattern)}
    known = set()
    for where, folders, names in os.walk(source):
        here = Path(where)
        folders[:] = [name for name in folders if not name.endswith(_FRESH)]
        there = target / here.relative_to(source)
        if there != target:
            os.mkdir(there)
        shutil.copymode(here, there)
        for name in names + [name for name in folders if (here / name).is_symlink()]:
            known.add((here / name).relative_to(source))
            if here / name not in gone:
                _link(here / name, there / name)
    return known


def _link(source: Path, target: Path) -> None:
    try:
        os.link(source, target, follow_symlinks=False)
    except FileNotFoundError:  # another run has just taken it away
        return
    except OSError:
        shutil.copy2(source, target, follow_symlinks=False)


def _sync(folder: Path) -> None:
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    with suppress(OSError):  # a file system without: nothing more can be done
        os.fsync(descriptor)
    os.close(descriptor)


@contextmanager
def _held(folder: Path) -> Iterator[None]:
    """Hold a folder as in use while the block runs, for as long as this process lives.

    Raises:
        OSError: where another one holds it.
    """
    if fcntl is None:
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(descriptor)


def _clear_leftovers(beside: Path, name: str) -> None:
    """Remove what runs left that were killed; what a living one holds stays."""
    for left in beside.glob(f".{glob.escape(name[:100])}.*{_FRESH}"):
        if fcntl is not None and left.is_dir() and not left.is_symlink():
            with suppress(OSError), _held(left):
                shutil.rmtree(left, ignore_errors=True)


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
    ("data set", "prototype"): "`beamdesign gap import FILES --prototype {source} --out DIR` makes one of records",
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


def longer_key(text: str, parts: int) -> str:
    """A dotted key of TOML of more than so many parts, if there is one: for a long one `tomllib` takes hours."""
    part = r"""(?:[\w-]++|"(?:\\.|[^"\\\n])*+"|'[^'\n]*+')"""
    found = re.search(rf"(?<![\w\\-]){part}(?:[ \t]*+\.[ \t]*+{part}){{{parts}}}", text, re.ASCII)
    return "" if found is None else found[0]


def not_toml(raw: bytes, error: tomllib.TOMLDecodeError | UnicodeDecodeError) -> str:
    """The reader's reason, with the line it means and what it may lack."""
    if isinstance(error, UnicodeDecodeError):
        line = raw[: error.start].count(b"\n") + 1
        return f"not valid TOML: {error}, in line {line}; save the file as UTF-8"
    lines = raw.decode().splitlines()
    at = re.search(r"at line (\d+)", str(error))
    number = int(at[1]) if at else len(lines)
    shown = lines[number - 1].strip() if 0 < number <= len(lines) else ""
    fault = f"not valid TOML: {error}"
    return f"{fault}; the line is: {shown[:80]}{_lack(shown)}" if shown else fault


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
    wanted = _RECORDS.get(record, "")
    if (found := kind_of(table) if wanted else "") in ("", wanted):
        return ""
    remedy = _INSTEAD.get((wanted, found))
    fault = f"is a {found}, where a {wanted} is expected"
    return fault + (f"; {remedy.format(source=source)}" if remedy else "")


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
