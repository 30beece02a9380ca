"""Files and folders of results: reads within limits, and sets that are whole, be it the older or the fresh one."""

import errno
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from beamdesign import files
from beamdesign.files import fresh_folder, read_bytes, settled, write_set, write_whole

posix = pytest.mark.skipif(os.name != "posix", reason="links, pipes and devices of POSIX")


def written(folder: Path) -> dict[str, str]:
    return {str(path.relative_to(folder)): path.read_text() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_only_regular_files_within_a_size_are_read(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"12345")
    assert read_bytes(path, 5) == b"12345"
    with pytest.raises(OSError, match="MB") as caught:
        read_bytes(path, 4)
    assert caught.value.errno == errno.EFBIG
    with pytest.raises(IsADirectoryError):
        read_bytes(tmp_path)


@posix
def test_a_pipe_or_a_device_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path, kind in ((tmp_path / "pipe", "a pipe"), (Path("/dev/zero"), "a device")):
        with pytest.raises(OSError, match=kind):
            read_bytes(path)
    with pytest.raises(OSError, match="a pipe"):
        write_whole(tmp_path / "pipe", "x")


@posix
def test_a_write_replaces_a_link_and_follows_none(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("safe")
    for name in ("result", "result.part"):
        (tmp_path / name).symlink_to(victim)
    write_whole(tmp_path / "result", "new")
    assert victim.read_text() == "safe"
    assert (tmp_path / "result").read_text() == "new"
    assert not (tmp_path / "result").is_symlink()


def test_a_write_that_fails_names_the_file_and_leaves_what_stood_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "result"
    path.write_text("old")

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space") as caught:
        write_whole(path, "new")
    assert caught.value.filename == str(path)
    assert written(tmp_path) == {"result": "old"}


def test_a_set_takes_the_place_of_an_older_one_and_keeps_what_is_of_no_set(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    write_set(folder, {"a": ("a.toml", "1"), "b": ("parts/b.toml", "1"), "c": ("parts/c.toml", "1")})
    (folder / "mine.txt").write_text("mine")
    paths = write_set(folder, {"a": ("a.toml", "2"), "b": ("parts/b.toml", "2")}, retiring=("parts/*.toml",))
    assert paths == {"a": folder / "a.toml", "b": folder / "parts" / "b.toml"}
    assert written(folder) == {"a.toml": "2", "mine.txt": "mine", "parts/b.toml": "2"}
    assert os.listdir(tmp_path) == ["results"]


def test_a_block_that_fails_leaves_the_older_set(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    write_set(folder, {"a": ("a", "1"), "b": ("b", "1")})

    def fail() -> None:
        with fresh_folder(folder) as fresh:
            write_whole(fresh / "a", "2")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert written(tmp_path) == {"results/a": "1", "results/b": "1"}


@pytest.mark.parametrize("why", ["worked in", "no exchange"])
def test_where_folders_cannot_be_exchanged_nothing_old_stands_beside_something_new(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, why: str
) -> None:
    folder = tmp_path / "results"
    write_set(folder, {"a": ("a", "1"), "b": ("b", "1"), "c": ("sub/c", "1")})
    if why == "worked in":
        monkeypatch.chdir(folder)
    else:
        monkeypatch.setattr(files, "_exchange", lambda one, other: False)
    seen: list[dict[str, str]] = []
    replace = os.replace

    def watched(source: Path, target: Path) -> None:
        replace(source, target)
        if target.parent == folder:
            seen.append({name: text for name, text in written(folder).items() if ".fresh" not in name})

    monkeypatch.setattr(os, "replace", watched)
    write_set(folder, {"a": ("a", "2"), "b": ("b", "2")}, retiring=("sub/*",))
    assert written(folder) == {"a": "2", "b": "2"}
    assert seen
    assert all(set(found.values()) == {"2"} for found in seen)


@posix
def test_what_another_run_adds_meanwhile_is_not_lost(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    write_set(folder, {"a": ("cases/a", "1")})
    with fresh_folder(folder) as fresh:
        write_whole(fresh / "table", "2")
        write_whole(folder / "cases" / "b", "late")
    assert written(folder) == {"cases/a": "1", "cases/b": "late", "table": "2"}


@posix
def test_writes_into_a_folder_that_is_exchanged_again_and_again_all_arrive(tmp_path: Path) -> None:
    folder, stop = tmp_path / "results", threading.Event()
    write_set(folder, {"a": ("cases/0", "0")})

    def exchange() -> None:
        while not stop.is_set():
            write_set(folder, {"t": ("table", "t")})

    other = threading.Thread(target=exchange)
    other.start()
    try:
        for k in range(1, 60):
            write_whole(folder / "cases" / str(k), str(k))
    finally:
        stop.set()
        other.join()
    assert {name: text for name, text in written(folder / "cases").items() if not name.startswith(".")} == {
        str(k): str(k) for k in range(60)
    }


_WRITER = """
import sys
from beamdesign.files import write_set
folder, number = sys.argv[1], int(sys.argv[2])
print("ready", flush=True)
while True:
    number += 1
    write_set(folder, {str(k): (f"part_{k}", str(number)) for k in range(5)})
    if number == 1: print("first", flush=True)
"""


@posix
def test_a_kill_at_any_moment_leaves_one_set_and_the_next_run_clears_up(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    for attempt in range(12):
        command = [sys.executable, "-c", _WRITER, str(folder), str(1000 * attempt)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            if attempt == 0:
                assert process.stdout.readline() == "first\n"
            try:
                process.wait(0.003 + 0.0017 * attempt)
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGKILL)
        found = written(folder)
        assert sorted(found) == [f"part_{k}" for k in range(5)]
        assert len(set(found.values())) == 1, found
    write_set(folder, {"0": ("part_0", "end")})
    assert os.listdir(tmp_path) == ["results"]


def test_paths_of_a_fresh_folder_settle_in_the_final_one() -> None:
    fresh, final = Path("x/.r.1.fresh"), Path("r")
    assert settled(fresh / "a", fresh, final) == final / "a"
    assert settled([fresh / "a"], fresh, final) == [final / "a"]
    assert settled({"k": fresh / "b" / "c"}, fresh, final) == {"k": final / "b" / "c"}
