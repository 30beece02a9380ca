"""Runs that are killed, interrupted, or lose a worker: what is finished stays, a second run computes the rest."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import nullcontext
from multiprocessing import active_children
from pathlib import Path

import pytest
import tomli_w
from typer.testing import CliRunner

from beamdesign import InputError
from beamdesign.cli.study import study
from beamdesign.sweep import workers
from beamdesign.sweep.case import Case
from beamdesign.sweep.conclusion import draw
from beamdesign.sweep.sweep_run import plan, run_sweep

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[1]
FORCES = [500.0 + 100.0 * k for k in range(6)]


@pytest.fixture
def sweep(tmp_path):
    """Six problems to size, a fraction of a second each."""
    study = {"task": "size", "base": str(ROOT / "studies" / "prototype.toml")}
    path = tmp_path / "sweep.toml"
    path.write_text(
        tomli_w.dumps({"name": "sweep", "study": study, "vary": [{"key": "load.tip_force_N", "values": FORCES}]}),
        encoding="utf-8",
    )
    return path


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    """Table of the sweep as one undisturbed run gives it."""
    folder = tmp_path_factory.mktemp("expected")
    study = {"task": "size", "base": str(ROOT / "studies" / "prototype.toml")}
    path = folder / "sweep.toml"
    path.write_text(
        tomli_w.dumps({"name": "sweep", "study": study, "vary": [{"key": "load.tip_force_N", "values": FORCES}]}),
        encoding="utf-8",
    )
    run_sweep(plan(path), folder / "out")
    return (folder / "out" / "table.csv").read_text(encoding="utf-8")


def command(*arguments):
    """The program with its arguments, as a list."""
    code = "from beamdesign.cli import main; main()"
    return [sys.executable, "-c", code, "study", *map(str, arguments)]


def begun(path, folder, *options):
    """A run in its own process group, stopped as soon as two cases are kept."""
    process = subprocess.Popen(
        command("run", path, "--out", folder, *options), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    while len(list((folder / "cases").glob("*.json"))) < 2:
        assert process.poll() is None, process.communicate()
        time.sleep(0.005)
    return process


def alive(group):
    """Whether any process of a group runs; one that is dead and not yet waited for does not."""
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, its_group = status.read_text(encoding="utf-8").rpartition(")")[2].split()[:3]
        except OSError:
            continue
        if int(its_group) == group and state != "Z":
            return True
    return False


def ends(group, within_s=20.0):
    """Whether the processes of a group end by themselves: workers end with the run, whatever ended it."""
    until = time.monotonic() + within_s
    while alive(group) and time.monotonic() < until:
        time.sleep(0.05)
    return not alive(group)


def fields_of(path, folder, *options):
    """What a whole run reports, by the same command in this process, which computes what is left as well."""
    words = ["run", path, "--out", folder, *options, "--json", folder / "fields.json"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(workers, "processes", lambda *_: nullcontext(workers.here))
        done = CliRunner().invoke(study, [str(word) for word in words])
    assert done.exit_code == 0, done.output
    return json.loads((folder / "fields.json").read_text(encoding="utf-8"))


def test_killed_run_goes_on_without_loss(sweep, tmp_path, expected):
    folder, options = tmp_path / "out", ("--workers", 2)
    process = begun(sweep, folder, *options)
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    assert ends(process.pid)
    kept = len(list((folder / "cases").glob("*.json")))
    assert 2 <= kept < len(FORCES)
    fields = fields_of(sweep, folder, *options)
    assert fields["computed"] == len(FORCES) - kept
    assert (folder / "table.csv").read_text(encoding="utf-8") == expected


def test_interrupted_run_says_how_to_go_on_and_does(sweep, tmp_path, expected):
    folder, options = tmp_path / "out", ("--workers", 2)
    process = begun(sweep, folder, *options)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal sends it: to the workers too
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    # A line every half minute tells how far a slow machine has got.
    (last,) = (line for line in said.splitlines() if not line.startswith("sweep: "))
    assert "the same command goes on" in last
    assert ends(process.pid)
    rows = (folder / "table.csv").read_text(encoding="utf-8").splitlines()[1:]
    assert 2 <= len(rows) < len(FORCES)
    assert f"{len(rows)} of {len(FORCES)} cases are kept" in said
    assert fields_of(sweep, folder, *options)["computed"] == len(FORCES) - len(rows)
    assert (folder / "table.csv").read_text(encoding="utf-8") == expected


def test_half_written_result_is_computed_again(sweep, tmp_path, expected):
    folder = tmp_path / "out"
    run_sweep(plan(sweep), folder)
    broken = next((folder / "cases").glob("*.json"))
    broken.write_text(broken.read_text(encoding="utf-8")[:100], encoding="utf-8")
    again = run_sweep(plan(sweep), folder)
    assert again.computed == 1
    assert (folder / "table.csv").read_text(encoding="utf-8") == expected


def test_worker_that_dies_is_replaced_and_its_cases_are_tried_again(sweep, tmp_path, expected):
    killed = []

    def told(share, words):
        if share > 0 and not killed:
            killed.append(active_children()[0].pid)
            os.kill(killed[0], signal.SIGKILL)

    with workers.processes(2) as compute:
        found = run_sweep(plan(sweep), tmp_path / "out", compute, told)
    assert killed
    assert found.counts == {"done": len(FORCES)}
    assert (tmp_path / "out" / "table.csv").read_text(encoding="utf-8") == expected


class Deadly:
    """Ends the process that reads it."""

    def __reduce__(self):
        return os._exit, (1,)


def test_case_that_kills_its_worker_is_a_failed_row_and_the_others_are_computed(sweep):
    cases = list(plan(sweep, 3).cases)
    cases.insert(1, Case("size", {"name": Deadly()}, {}, {}, "inputs", "code"))
    with workers.processes(2) as compute:
        found = dict(compute(cases))
    assert found[1]["status"] == "failed"
    assert f"died, {workers.TRIES} times" in found[1]["reason"]
    assert [found[k]["status"] for k in (0, 2, 3)] == ["done"] * 3


def test_cluster_computes_the_same_with_a_worker_killed_on_the_way(sweep, tmp_path, expected):
    from distributed import LocalCluster

    killed = []
    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
    ) as there:

        def told(share, words):
            if share > 0 and not killed:
                killed.append(next(iter(there.workers.values())).pid)
                os.kill(killed[0], signal.SIGKILL)

        with workers.cluster(there.scheduler_address) as compute:
            found = run_sweep(plan(sweep), tmp_path / "out", compute, told)
    assert killed
    assert found.counts == {"done": len(FORCES)}
    assert (tmp_path / "out" / "table.csv").read_text(encoding="utf-8") == expected


def test_scheduler_that_does_not_answer_is_bad_input(monkeypatch):
    import distributed

    client = distributed.Client
    monkeypatch.setattr(distributed, "Client", lambda address, timeout, **given: client(address, timeout=0.2, **given))
    with pytest.raises(InputError, match="no scheduler answers"), workers.cluster("tcp://127.0.0.1:1"):
        pass


@pytest.mark.parametrize(("address", "words"), [("127.0.0.1", "missing port"), ("http://127.0.0.1:8786", "scheme")])
def test_no_client_is_made_of_what_is_no_address(monkeypatch, address, words):
    import distributed

    monkeypatch.setattr(distributed, "Client", None)
    with pytest.raises(InputError, match=words), workers.cluster(address):
        pass


class Endless:
    """Where its words are asked for, it leaves a mark, and never again runs a line of Python."""

    def __init__(self, mark):
        self.mark = mark

    def __repr__(self):
        Path(self.mark).touch()
        return str(re.fullmatch("(a+)+b", "a" * 60))


def endless(folder):
    """A case that is refused as soon as the words are found."""
    return Case("at_mass", {"name": Endless(str(folder / "mark"))}, {}, {}, "inputs", "code")


@pytest.mark.parametrize("count", [1, 2])
def test_case_that_takes_too_long_is_a_failed_row_and_the_others_are_computed(tmp_path, count):
    cases = [Case("at_mass", {"name": k}, {}, {}, "inputs", "code") for k in range(4)]  # refused at once
    cases[1] = endless(tmp_path)
    with workers.processes(count, 2.0) as compute:
        found = dict(compute(cases))
        assert [found[k]["status"] for k in range(4)] == ["refused", "failed", "refused", "refused"]
        assert "2 s, the limit of --case-seconds" in found[1]["reason"]
        assert found[1]["seconds"] == 2.0
        assert dict(compute(cases[:1]))[0]["status"] == "refused"
    assert active_children() == []


def test_worker_in_which_no_python_runs_ends_with_its_parent(tmp_path):
    code = (
        f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); from pathlib import Path\n"
        "from test_study_workers import endless; from beamdesign.sweep import workers\n"
        f"with workers.processes(1) as compute: list(compute([endless(Path({str(tmp_path)!r}))]))"
    )
    process = subprocess.Popen([sys.executable, "-c", code], start_new_session=True)
    while not (tmp_path / "mark").exists():
        assert process.poll() is None
        time.sleep(0.02)
    process.kill()
    process.wait()
    assert ends(process.pid)


def test_a_script_that_every_process_would_begin_anew_is_told_what_it_lacks(sweep, tmp_path):
    """Each process imports the script, which begins the sweep again; every case was a failed row, after three tries."""
    script = tmp_path / "script.py"
    call = f"beamdesign.study({str(sweep)!r}, {str(tmp_path / 'out')!r}, cases=1)"
    script.write_text(f"import beamdesign\nprint('imported')\n{call}\n", encoding="utf-8")
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=300)
    assert done.returncode == 1
    assert (
        "InputError: study: (script): begins processes, which import it: put its work under `if __name" in done.stderr
    )
    assert done.stderr.count("Traceback") == 1
    assert not list(tmp_path.glob("out/cases/*.json"))


def test_nothing_to_compute_begins_no_process(sweep, tmp_path):
    folder = tmp_path / "out"
    run_sweep(plan(sweep), folder)
    with workers.processes(2) as compute:
        assert run_sweep(plan(sweep), folder, compute).computed == 0
        assert active_children() == []


SET = ("study.json", "table.csv", "table.parquet", "conclusion.json", "picture.png", "picture.svg")


@pytest.fixture
def asked(tmp_path):
    """Writes a sweep of quick cases with a picture and a conclusion."""

    def write(values):
        study = {"task": "robust", "base": str(ROOT / "studies" / "prototypes" / "tame_lag.toml")}
        key = "payload.inner_end_mass_kg"
        path = tmp_path / "asked.toml"
        path.write_text(
            tomli_w.dumps(
                {"name": "asked", "study": study, "vary": [{"key": key, "values": values}]}
                | {"specification": {"stable": {"equals": True}}}
                | {"picture": [{"kind": "lines", "x": key, "y": "bandwidth_Hz"}]}
            ),
            encoding="utf-8",
        )
        return path

    return write


def the_set(folder):
    return {name: (folder / name).read_bytes() for name in SET if (folder / name).exists()}


KILLED = """
import os, random, shutil, signal, sys
from pathlib import Path
from beamdesign.sweep.conclusion import draw
from beamdesign.sweep.sweep_run import plan, run_sweep

newer, old = (Path(name) for name in sys.argv[1:])
laid = plan(newer)
steps, kill_at = 0, None

def step(event, arguments):
    global steps
    writes = event == "open" and arguments[2] & (os.O_WRONLY | os.O_RDWR)
    if writes or event in ("os.rename", "os.link", "os.mkdir", "os.remove", "os.rmdir", "ctypes.call_function"):
        steps += 1
        if steps == kill_at:
            os.kill(os.getpid(), signal.SIGKILL)

def run(name, moment=None):
    global steps, kill_at
    folder = shutil.copytree(old, old.with_name(name))
    steps, kill_at = 0, moment
    run_sweep(laid, folder, draw=draw)

run("first")  # in which fonts are looked for
sys.addaudithook(step)
run("counted")
total = steps
for number, moment in enumerate([*random.Random(3).sample(range(1, total - 2), 8), total - 2, total]):
    if (child := os.fork()) == 0:
        run(f"killed_{number}", moment)
    assert os.waitpid(child, 0)[1] == signal.SIGKILL
"""


def test_run_killed_at_any_step_of_its_writing_leaves_the_older_files_or_the_newer_ones(asked, tmp_path):
    older = asked([2.0, 2.5]).rename(tmp_path / "older.toml")
    newer = asked([2.0, 2.5, 3.0, 3.5]).rename(tmp_path / "newer.toml")
    run_sweep(plan(newer), tmp_path / "new", draw=draw)
    shutil.copytree(tmp_path / "new" / "cases", tmp_path / "old" / "cases")
    run_sweep(plan(older), tmp_path / "old", draw=draw)
    whole = [the_set(tmp_path / "old"), the_set(tmp_path / "new")]
    assert [sorted(one) for one in whole] == [sorted(SET)] * 2
    assert all(whole[0][name] != whole[1][name] for name in SET)
    script = [sys.executable, "-c", KILLED, str(newer), str(tmp_path / "old")]
    subprocess.run(script, check=True)
    left = [the_set(folder) for folder in tmp_path.glob("killed_*")]
    assert all(one in whole for one in left)
    assert 0 < left.count(whole[1]) < len(left)
    run_sweep(plan(newer), tmp_path / "killed_0", draw=draw)
    assert the_set(tmp_path / "killed_0") == whole[1]


def test_two_runs_into_one_folder_keep_all_results_and_one_set(asked, tmp_path):
    values = [2.0 + 0.1 * k for k in range(8)]
    first = asked(values[:6]).rename(tmp_path / "first.toml")
    second = asked(values[2:]).rename(tmp_path / "second.toml")
    folder = tmp_path / "both"
    runs = [
        subprocess.Popen(command("run", path, "--out", folder), stdout=subprocess.DEVNULL) for path in (first, second)
    ]
    assert [process.wait() for process in runs] == [0, 0]
    assert len(list((folder / "cases").glob("*.json"))) == len(values)
    left = the_set(folder)
    for path in (first, second):
        assert run_sweep(plan(path), folder).computed == 0
    alone = []
    for path in (first, second):
        out = tmp_path / path.stem
        shutil.copytree(folder / "cases", out / "cases")
        run_sweep(plan(path), out, draw=draw)
        alone.append(the_set(out))
    assert left in alone
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []
