"""Runs that are killed, interrupted, or lose a worker: what is finished stays, a second run computes the rest."""

import json
import os
import signal
import subprocess
import sys
import time
from multiprocessing import active_children
from pathlib import Path

import pytest
import tomli_w

from beamdesign.records import InputError
from beamdesign.study import workers
from beamdesign.study.case import Case
from beamdesign.study.sweep_run import plan, run_sweep

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
    """What a whole run reports."""
    subprocess.run(
        [*command("run", path, "--out", folder, *options), "--json", str(folder / "fields.json")], check=True,
        capture_output=True,
    )  # fmt: skip
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


@pytest.mark.parametrize("options", [(), ("--workers", 2)])
def test_interrupted_run_says_how_to_go_on_and_does(sweep, tmp_path, expected, options):
    folder = tmp_path / "out"
    process = begun(sweep, folder, *options)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal sends it: to the workers too
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert said.count("\n") == 1
    assert "the same command goes on" in said
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


def test_scheduler_that_does_not_answer_is_bad_input():
    with pytest.raises(InputError, match="no scheduler answers"), workers.cluster("tcp://127.0.0.1:1"):
        pass
