"""Notebooks: committed without outputs, executed from top to bottom at small size, true to figures known elsewhere."""

import json
import re
import shutil
from pathlib import Path

import matplotlib.font_manager  # noqa: F401  makes its cache, where there is none; a kernel would say so on stderr
import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient
from nbformat import NotebookNode
from slow_sensor import ASKED

from beamdesign import certify, read_prototype, state_space
from beamdesign.sweep.case import Answer, kept
from beamdesign.sweep.store import keep
from beamdesign.sweep.sweep_run import plan, run_sweep

pytestmark = pytest.mark.long

PROJECT = Path(__file__).resolve().parents[1]
NOTEBOOKS = {path.stem: path for path in sorted((PROJECT / "notebooks").glob("*.ipynb"))}
MAKER = (PROJECT / "studies" / "gaps" / "make_slow_sensor.py").read_text(encoding="utf-8")
EMPTY = 20_000  # characters of a picture of two empty panels

STRICT = """
import warnings
warnings.simplefilter("error")
# At its end the kernel warns of its own code.
warnings.filterwarnings("ignore", category=PendingDeprecationWarning, module=r"ipykernel\\.")
"""

COMMANDS = """
import subprocess
from typer.testing import CliRunner
from beamdesign.cli import app

begun = subprocess.run

def carried_out(words, **given):
    if words[1:3] != ["-m", "beamdesign"]:
        return begun(words, **given)
    assert given == {"check": True}
    done = CliRunner().invoke(app, words[3:])
    assert done.exit_code == 0, done.output

subprocess.run = carried_out
"""
"""Commands of the program are carried out by the kernel, which need not load it for each of them."""
QUICKER = f"""
import sys

sys.path.append({str(Path(__file__).parent)!r})
from one_start import best_start_alone, captions_alone

"""
ALONE = f"{QUICKER}alone = best_start_alone()\nalone.__enter__()\n"
"""Laws are sought from the best start alone."""
PLAIN = f"{QUICKER}plain = captions_alone()\nplain.__enter__()\n"
"""The report has captions alone. The name holds on to what undoes itself when nobody does."""
HERE = """
from contextlib import nullcontext
from beamdesign.sweep import workers

workers.processes = lambda *given: nullcontext(workers.here)
"""
"""Sweeps are computed by the kernel: see `computed_here`."""
FEW = """
from beamdesign.diagnosis.fitting import search
from beamdesign.diagnosis.fitting.hypothesis import singles

search.singles = lambda rig: tuple(h for h in singles(rig) if str(h) in %r)
"""
"""A diagnosis tries these causes; `slow_sensor.py` has all."""


def read(name: str) -> NotebookNode:
    return nbformat.read(NOTEBOOKS[name], 4)


@pytest.fixture
def execute(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Runs a notebook in a temporary folder with other parameters, and gives what its cells print and how they ran."""
    # Nothing of the kernel's belongs into a home folder, and figures are those of a notebook whatever the shell says.
    for variable in ("IPYTHONDIR", "JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR"):
        (tmp_path / variable).mkdir()
        monkeypatch.setenv(variable, str(tmp_path / variable))
    monkeypatch.delenv("MPLBACKEND", raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")

    def run(name: str, setting: str = "", **parameters: str) -> tuple[dict[str, str], NotebookNode]:
        book = read(name)
        (at,) = (k for k, cell in enumerate(book.cells) if "parameters" in cell.metadata.get("tags", ()))
        own = set(re.findall(r"^(\w+) = ", book.cells[at].source, flags=re.MULTILINE))
        assert own == set(parameters), "the test sets other parameters than the notebook has"
        lines = [f"{key} = {value}" for key, value in parameters.items()]
        book.cells.insert(
            at + 1, nbformat.v4.new_code_cell("\n".join(lines) + STRICT + setting, id="parameters-of-the-test")
        )
        work = tmp_path / "work"
        work.mkdir()
        NotebookClient(book, timeout=1800, resources={"metadata": {"path": str(work)}}).execute()
        assert list(work.iterdir()) == []  # results go where they are told to
        return {cell.id: printed(cell) for cell in book.cells if cell.cell_type == "code"}, book

    return run


def printed(cell: NotebookNode) -> str:
    return "".join(out.text for out in cell.outputs if out.output_type == "stream")


def assert_ran(book: NotebookNode, figures: int) -> None:
    """Every cell was run and complained of nothing; as many pictures came out, none of them empty."""
    cells = [cell for cell in book.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    outputs = [out for cell in cells for out in cell.outputs]
    assert [out.text for out in outputs if out.get("name") == "stderr"] == []
    pictures = [out.data["image/png"] for out in outputs if "image/png" in out.get("data", {})]
    assert len(pictures) == figures
    assert all(len(picture) > EMPTY for picture in pictures)


def path(of: Path) -> str:
    return f"Path({str(of)!r})"


def numbers(text: str) -> list[float]:
    return [float(found) for found in re.findall(r"[-+]?\d+\.?\d*", text)]


def test_there_are_few() -> None:
    assert list(NOTEBOOKS) == [
        "1_paper_to_certified_design",
        "2_trade_curves",
        "3_diagnosing_a_gap",
        "4_own_link",
    ]


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_committed_without_outputs(name: str) -> None:
    raw = json.loads(NOTEBOOKS[name].read_text(encoding="utf-8"))
    nbformat.validate(raw)
    assert raw["metadata"] == {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    for cell in raw["cells"]:
        assert set(cell["metadata"]) <= {"tags"}
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            assert cell["execution_count"] is None
            assert cell["source"]
    assert raw["cells"][0]["source"][0].startswith("# ")


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_files_and_sweeps_it_names_exist(name: str) -> None:
    text = "\n".join(cell.source for cell in read(name).cells)
    named = set(re.findall(r"studies/[\w/]+\.(?:toml|py)", text))
    assert named
    assert [file for file in named - {"studies/sweeps/NAME.toml"} if not (PROJECT / file).is_file()] == []


@pytest.fixture(scope="module")
def end_masses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sweep of end masses, which two notebooks go on from; only to be read."""
    folder = tmp_path_factory.mktemp("swept") / "end_masses"
    assert run_sweep(plan(PROJECT / "studies/sweeps/end_masses.toml"), folder).computed == 81
    return folder


def test_paper_to_certified_design(execute, end_masses: Path, tmp_path: Path) -> None:
    results = tmp_path / "results"
    shutil.copytree(end_masses, results / "end_masses")
    said, book = execute(
        "1_paper_to_certified_design", HERE + PLAIN + ALONE, PROJECT=path(PROJECT), RESULTS=path(results)
    )
    assert_ran(book, figures=4)
    assert said["results"] == "end masses: 81 cases, 0 of them computed now\n"
    low, lower_Hz, high, upper_Hz = numbers(said["stable-range"])
    assert (low, high) == (1.968, 17.79)
    # The same by floating point: eigenvalues of the closed loop as a state space, on either side of each edge.
    remedy = read_prototype(PROJECT / "studies/prototypes/paper_remedy.toml")
    for mass, frequency, above in ((low, lower_Hz, True), (high, upper_Hz, False)):
        for factor, stable in ((0.998, not above), (1.002, above)):
            poles = np.linalg.eigvals(state_space(remedy, outer_end_mass_kg=factor * mass).A)
            worst = poles[np.argmax(poles.real)]
            assert (worst.real < 0) == stable
            assert abs(worst.imag) / (2 * np.pi) == pytest.approx(frequency, abs=0.1)
    # On the axis of stability the loop transfer function is -1, that is 0 dB; more payload lowers it.
    gains = [numbers(line)[-1] for line in said["bode"].splitlines()]
    assert gains[1] == 0.0
    assert gains[0] > 0 > gains[2]
    assert "proved again: True" in said["replay"]
    bandwidth, promised_bandwidth, peak, promised_peak = (
        float(found) for found in re.findall(r"\d+\.\d+", said["conclusion"])
    )
    assert bandwidth >= promised_bandwidth > 4.5
    assert peak <= promised_peak <= 2.0
    design = read_prototype(results / "prototype" / "prototype.toml")
    assert certify(design, 0.0, 6.8).stable
    table = next(cell for cell in book.cells if cell.id == "side-by-side").outputs[0].data["text/plain"]
    assert "1.968 to 6.8" in table


def given_trade_curves(folder: Path) -> None:
    """Keep made-up results for every case of the sweep: 5 + 0.5 m + 0.1 f² for a payload m and a bandwidth f."""
    for case in plan(PROJECT / "studies/sweeps/trade_curves.toml").cases:
        payload, bandwidth = case.varied["payload.outer_end_mass_kg[1]"], case.varied["options.bandwidth_Hz"]
        mass = 5 + 0.5 * payload + 0.1 * bandwidth**2
        found = {"moving_mass_kg": mass, "bandwidth_Hz": bandwidth, "governing": "made up"}
        refused = (payload, bandwidth) == (12.0, 8.0)
        status, answer = ("no", Answer({}, reason="too fast")) if refused else ("done", Answer(found))
        keep(folder, kept(case, status, answer, 0.0))


def test_trade_curves(execute, end_masses: Path, tmp_path: Path) -> None:
    # Designing together takes long: its results are given, so that what is said of them is known beforehand as well.
    given_trade_curves(tmp_path / "trade_curves")
    shutil.copytree(end_masses, tmp_path / "end_masses")
    cases = {"link_length": 3, "materials": 3, "lag_breaks": 90}
    said, book = execute("2_trade_curves", HERE, PROJECT=path(PROJECT), RESULTS=path(tmp_path), CASES=repr(cases))
    assert_ran(book, figures=5)
    assert said["tables"].splitlines() == [
        "trade_curves: 15 cases, 0 of them computed now",
        "link_length: 3 cases, 3 of them computed now",
        "materials: 3 cases, 3 of them computed now",
        "lag_breaks: 90 cases, 90 of them computed now",
        "end_masses: 81 cases, 0 of them computed now",
    ]
    trade = said["trade-conclusion"].splitlines()
    assert trade[0].startswith("payload to 2 kg: 6.90 kg for 3 Hz, 12.40 kg for 8 Hz (+80%); up to 3 Hz")
    assert trade[2].startswith("payload to 12 kg: 11.90 kg for 3 Hz, 14.60 kg for 6 Hz (+23%)")
    assert trade[3] == "1 of 15 cases without a proved design"
    # 14.65 kg: 2.7 kg/dm³, 1.5 m, tubes of 140 x 2.3 and 100 x 3.2 mm with sharp corners, and 4.5 kg.
    published = 2700 * 1.5 * (0.140**2 - 0.1354**2 + 0.100**2 - 0.0936**2) + 4.5
    masses = [5 + 0.5 * m + 0.1 * f**2 for m in (2, 6.8, 12) for f in (3, 4, 5, 6, 8) if (m, f) != (12, 8)]
    fewer = sum(mass < published for mass in masses)
    assert trade[4] == f"{fewer} of 14 designs move less than the paper's remedy, {published:.2f} kg"
    length = said["length-conclusion"].splitlines()
    assert all(numbers(line)[1] > 2 for line in length[:2])  # twice as long and of no thinner tube
    assert [numbers(line)[0] for line in length[2:]] == [0.5, 1.75, 3.0]
    # 0.2 % proof strengths of 5083-H112 and 6063-T6 or 6005A-T6 in EN 1999-1-1, Table 3.2b: 110, 160, 200 MPa.
    assert numbers(said["materials-conclusion"])[0] == pytest.approx(200 / 110, abs=0.006)
    assert [numbers(line)[0] for line in said["lag-conclusion"].splitlines()] == [57, 100, 150]
    reach = [[numbers(line)[k] for k in (1, 3)] for line in said["lag-conclusion"].splitlines()]
    assert np.all(np.diff(reach, axis=0) < 0)  # more gain leaves less room
    assert reach[2][1] < 1.75 < reach[1][1]  # the paper's pole: not at its own gain, but at two thirds of it
    low, high = re.search(r"with (\S+) to (\S+) kg inside", said["ends-conclusion"]).groups()
    remedy = read_prototype(PROJECT / "studies/prototypes/paper_remedy.toml")
    held = [
        certify(remedy.but(payload=remedy.payload.but(inner_end_mass_kg=float(inside))), 0.0, 6.8).stable
        for inside in (float(low) - 0.1, low, high, float(high) + 0.1)  # 0.1 kg from row to row
    ]
    assert held == [False, True, True, False]


def test_diagnosing_a_gap(execute, diagnosed_slow_sensor: Path, tmp_path: Path) -> None:
    data, found = diagnosed_slow_sensor / "slow_sensor", tmp_path / "found"
    shutil.copytree(diagnosed_slow_sensor / "out", found)  # by the words that the notebook has for it
    words = re.search(
        r'beamdesign\("gap", "diagnose", DATA, "--out", FOUND, (.+)\)', read("3_diagnosing_a_gap").cells[2].source
    )
    assert tuple(word.strip(' "') for word in words[1].split(",")) == ASKED
    said, book = execute("3_diagnosing_a_gap", COMMANDS, PROJECT=path(PROJECT), DATA=path(data), FOUND=path(found))
    assert_ran(book, figures=3)
    assert "lies in the sensor" in said["indicators"]
    assert said["causes"].startswith("effect: The gap is caused by sensor_lag")
    put_in_Hz = float(re.search(r'"break_Hz": ([\d.]+)', MAKER)[1])
    value, std = map(float, re.search(r"break_Hz = (\S+) ± (\S+)", said["causes"]).groups())
    assert abs(value - put_in_Hz) < 4 * std
    assert std < 0.05 * put_in_Hz
    before, after, noise = numbers(said["closed"].splitlines()[0])
    # The error that is printed is that of the prediction which the notebook draws.
    measured, predicted = (
        np.genfromtxt(folder / "payload_disturbance.csv", delimiter=",", names=True)["displacement_m"]
        for folder in (data / "records", found / "believed")
    )
    error = np.sqrt(np.mean((measured - predicted) ** 2)) / np.std(measured)
    assert before == pytest.approx(100 * error, abs=1.0)
    assert noise < after < 0.1 * before
    redesigned = read_prototype(found / "redesigned" / "prototype.toml")
    low, high, bandwidth, peak = numbers(said["conclusion"].splitlines()[1])
    proved = certify(redesigned, low, high)
    assert proved.guaranteed is not None
    assert proved.guaranteed.bandwidth_Hz == pytest.approx(bandwidth, abs=0.006)
    assert proved.guaranteed.peak_sensitivity == pytest.approx(peak, abs=0.006)


def test_own_link(execute, tmp_path: Path) -> None:
    causes = "sensor_lag", "transport_delay", "second_beam_mode", "parameter:flow_gain", "parameter:torque_constant"
    said, book = execute(
        "4_own_link", COMMANDS + ALONE + FEW % (causes,),
        PROJECT=path(PROJECT), RESULTS=path(tmp_path / "arm"), SIGMAS="0.0", DURATION_S="0.5",
    )  # fmt: skip
    assert_ran(book, figures=3)
    assert "300 N across the tip, which grips 0 to 2 kg" in said["needs"]
    bandwidth, peak = numbers(said["design"].splitlines()[-1])
    design = read_prototype(tmp_path / "arm/design/prototype.toml")
    # The same by floating point on a grid of its own: |x / F| of python-control's state space.
    for mass in (0.0, 2.0):
        frequency_Hz = np.linspace(0.05, bandwidth - 0.01, 300)
        force_to_tip = state_space(design, mass)(2j * np.pi * frequency_Hz, squeeze=False)[0, 0]
        assert np.abs(force_to_tip).max() <= design.goal.compliance_m_per_N
    on, off = numbers(said["buys"])
    # A cantilever of the free length, 3 E I / L^3, from the tube that the design says.
    tube, beam = design.outer_beam.tube, design.outer_beam
    inside = tube.width_m - 2 * tube.wall_m
    second_moment = np.pi / 64 * (tube.width_m**4 - inside**4)
    bare = beam.free_length_m**3 / (3 * beam.material.youngs_modulus_Pa * second_moment)
    assert off == pytest.approx(1e9 * bare, rel=0.02)
    assert on < 0.1 * off
    value, std = map(float, re.search(r"break_Hz = (\S+) ± (\S+)", said["diagnosis"]).groups())
    assert abs(value - 150.0) < 4 * std + 0.05
    assert std < 5.0
    after, noise = numbers(said["diagnosis"].splitlines()[-1])[1:]
    assert noise < 1.5 * after
    new, peak = numbers(said["redesign"])
    proved = certify(read_prototype(tmp_path / "arm/diagnosis/redesigned/prototype.toml"), 0.0, 2.0).guaranteed
    assert proved is not None
    assert (proved.bandwidth_Hz, proved.peak_sensitivity) == (
        pytest.approx(new, abs=6e-3),
        pytest.approx(peak, abs=6e-3),
    )
    assert new < bandwidth
