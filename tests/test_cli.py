"""The manner of the commands: quiet, plain where nobody looks, interruptible, and clear about what is wrong."""

import ast
import json
import os
import pty
import re
import select
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import typer.main
from typer.testing import CliRunner

from beamdesign import InputError, check
from beamdesign.cli import PANELS, app, main, output
from beamdesign.progress import interruption_waits

ROOT = Path(__file__).parent.parent
STUDY = ROOT / "studies" / "prototype.toml"
RIG = ROOT / "studies" / "prototypes" / "paper_remedy.toml"
TABLE = ["new", "--list"]
"""A quick command that prints a table."""


def leaves(group: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from leaves(command, (*path, name))
        else:
            yield " ".join((*path, name)), command


COMMANDS = dict(leaves(typer.main.get_command(app)))


def in_terminal(code: str, type_at: tuple[bytes, bytes] | None = None, **variables: str) -> tuple[int, bytes]:
    """Run Python code in a terminal of its own; type something once some words have been shown.

    Returns:
        exit status, and all that the terminal was sent.
    """
    ours, theirs = pty.openpty()
    # The child takes the terminal as its own, so that Ctrl-C typed there becomes a signal.
    own = "import fcntl, signal, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0)\n"
    own += "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    environment = {k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "FORCE_COLOR", "TERM")}
    process = subprocess.Popen(
        [sys.executable, "-c", own + code], stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True,
        env={**environment, "TERM": "xterm-256color", **variables},
    )  # fmt: skip
    os.close(theirs)
    seen = b""
    while True:
        if select.select([ours], [], [], 0.05)[0]:
            try:
                seen += os.read(ours, 65536)
            except OSError:  # the other end is closed
                break
        elif process.poll() is not None:
            break
        if type_at is not None and type_at[0] in seen:
            os.write(ours, type_at[1])
            type_at = None
    os.close(ours)
    return process.wait(), seen


def status_of(arguments: list[str]) -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["beamdesign", *arguments])
        with pytest.raises(SystemExit) as left:
            main()
    return left.value.code


def run_main(arguments: list[str]) -> str:
    return f"import sys; sys.argv = {['beamdesign', *arguments]!r}\nfrom beamdesign.__main__ import main; main()"


def test_every_command_is_quiet_on_demand_writes_json_and_says_in_one_line_what_it_does() -> None:
    assert len(COMMANDS) >= 18
    for name, command in COMMANDS.items():
        options = {option for parameter in command.params for option in parameter.opts}
        assert {"--quiet", "-q", "--json"} <= options, name
        assert not command.get_short_help_str(70).endswith("..."), name
        assert [parameter.name for parameter in command.params if not getattr(parameter, "help", "")] == [], name


def test_the_help_leads_a_newcomer_from_a_template_to_a_built_rig() -> None:
    shown = CliRunner().invoke(app, ["--help"]).output
    places = [shown.index(f"\n{heading}:") for heading in PANELS]
    assert places == sorted(places)
    assert "Further commands" not in shown
    way = [shown.index(f"\n  {name} ") for name in ("new", "run", "spec", "simulate", "gap")]
    assert way == sorted(way)


def test_help_loads_no_engine() -> None:
    heavy = {"numpy", "scipy", "casadi", "control", "cvxpy", "flint", "matplotlib", "numba", "pandas", "dask"}
    code = f"import sys; from typer.testing import CliRunner; from beamdesign.cli import app\n" \
           f"CliRunner().invoke(app, ['--help']); sys.exit(' '.join(sorted({heavy!r} & set(sys.modules))))"  # fmt: skip
    done = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True)
    assert done.stderr.strip() == ""


@pytest.mark.parametrize("arguments", [["-q", *TABLE], [*TABLE, "--quiet"], ["--quiet", "explain", "width_m"]])
def test_quiet_is_heard_before_and_after_the_command_and_json_is_written(arguments: list[str], tmp_path: Path) -> None:
    answer = tmp_path / "answer.json"
    done = CliRunner().invoke(app, [*arguments, "--json", str(answer)])
    assert (done.exit_code, done.stdout, done.stderr) == (0, "", "")
    assert json.loads(answer.read_text())
    # The next call in the same process speaks again.
    assert CliRunner().invoke(app, TABLE).stdout


def test_quiet_leaves_errors_and_exit_statuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    unstable = CliRunner().invoke(app, ["certify", str(RIG), "--out", str(tmp_path / "proof.toml"), "--quiet"])
    assert (unstable.exit_code, unstable.output) == (1, "")
    assert (tmp_path / "proof.toml").is_file()
    assert status_of(["certify", "nothing.toml", "--quiet"]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("nothing.toml: (file): No such file")


def test_no_command_prints_past_the_one_place_that_can_be_hushed() -> None:
    for path in (ROOT / "beamdesign" / "cli").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print"):
                continue
            to = [ast.unparse(keyword.value) for keyword in node.keywords if keyword.arg == "file"]
            assert to == ["sys.stderr"] or path.name == "output.py", f"{path.name}, line {node.lineno}"


def test_colours_are_for_terminals_only(tmp_path: Path) -> None:
    _, seen = in_terminal(run_main(TABLE))
    assert b"\x1b[" in seen
    for variables in ({"NO_COLOR": "1"}, {"TERM": "dumb"}):
        _, seen = in_terminal(run_main(TABLE), **variables)
        assert b"templates" in seen
        assert b"\x1b" not in seen
    piped = subprocess.run([sys.executable, "-c", run_main(TABLE)], check=True, capture_output=True)
    assert b"templates" in piped.stdout
    assert b"\x1b" not in piped.stdout
    assert piped.stderr == b""


def test_progress_is_for_terminals_only() -> None:
    work = (
        "import time\nfrom beamdesign.cli.output import hush, progress\n{before}\n"
        "with progress('weighing') as update:\n    update(0.5, 'half of it'); time.sleep(0.25)\nprint('done')"
    )
    _, seen = in_terminal(work.format(before=""))
    assert b"weighing" in seen
    assert b"half of it" in seen
    for before, variables in (("hush()", {}), ("", {"TERM": "dumb"})):
        _, seen = in_terminal(work.format(before=before), **variables)
        assert seen.split() == [b"done"]
    piped = subprocess.run([sys.executable, "-c", work.format(before="")], check=True, capture_output=True)
    assert (piped.stdout.split(), piped.stderr) == ([b"done"], b"")
    long = work.replace("'weighing'", "'weighing', '5 to 60 s'")
    for before, told in (("", 1), ("hush()", 0)):
        piped = subprocess.run([sys.executable, "-c", long.format(before=before)], check=True, capture_output=True)
        assert piped.stderr.count(b"weighing: 5 to 60 s") == len(piped.stderr.splitlines()) == told


def test_ctrl_c_typed_at_a_terminal_is_one_line_and_status_130(tmp_path: Path) -> None:
    command = run_main(["run", str(STUDY), "--out", str(tmp_path / "out")])
    status, seen = in_terminal(command, type_at=(b"designing", b"\x03"))
    assert status == 130
    assert b"beamdesign run: interrupted" in seen
    assert b"Traceback" not in seen
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["size", str(STUDY)],
        ["certify", str(RIG)],
        ["simulate", str(RIG), "--out", "x", "--scenario", "y"],
        ["gap", "predict", str(RIG), "x", "--out", "y"],
    ],
)
def test_an_interruption_anywhere_is_one_line(arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("beamdesign.records.read_table", lambda path: signal.raise_signal(signal.SIGINT))
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        done = CliRunner().invoke(app, arguments, prog_name="beamdesign")
    finally:
        signal.signal(signal.SIGINT, previous)
    assert done.exit_code == 130
    assert done.stderr == f"beamdesign {arguments[0]}: interrupted\n"


def test_an_interruption_that_a_library_swallows_is_passed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    from beamdesign.records import read_table

    def swallowing(path: Path) -> Any:
        try:
            signal.raise_signal(signal.SIGINT)
        except BaseException:
            return read_table(path)

    monkeypatch.setattr("beamdesign.records.read_table", swallowing)
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        done = CliRunner().invoke(app, ["run", str(STUDY), "--out", "x"], prog_name="beamdesign")
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, previous)
    assert (done.exit_code, done.stderr.splitlines()[1:]) == (130, ["beamdesign run: interrupted"])


def test_an_interruption_waits_for_a_solver_and_is_not_lost() -> None:
    """CasADi would swallow it: an IPOPT run ends early and the search goes on."""
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    reached = []

    def solve() -> None:
        with interruption_waits():
            signal.raise_signal(signal.SIGINT)
            time.sleep(0.01)
            reached.append("the end of the run")
        reached.append("what comes after")

    try:
        with pytest.raises(KeyboardInterrupt):
            solve()
        assert reached == ["the end of the run"]
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, previous)


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("beamdesign tun", ["tune"]),
        ("beamdesign tune studies/prototypes/pap", ["studies/prototypes/paper_remedy.toml"]),
        ("beamdesign simulate x --scenario studies/scenarios/k", ["studies/scenarios/kick.toml"]),
        ("beamdesign gap diagnose studies/gaps/slow", ["studies/gaps/slow_sensor"]),
        ("beamdesign new bench", ["bench", "bench-scenario"]),
        ("beamdesign explain joint_b", ["joint_backlash", "joint_backlash_nut"]),
        ("beamdesign explain outer_beam.w", ["outer_beam.wall_m", "outer_beam.width_m"]),
        ("beamdesign run --qu", ["--quiet"]),
        ("beamdesign tune no_such_folder/", []),
    ],
)
def test_the_shell_completes(typed: str, offered: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    asked = {"_BEAMDESIGN_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(len(typed.split()) - 1)}
    done = CliRunner().invoke(app, [], prog_name="beamdesign", env=asked)
    assert done.stdout.split() == offered


def test_completion_can_be_installed() -> None:
    options = {option for parameter in typer.main.get_command(app).params for option in parameter.opts}
    assert {"--install-completion", "--show-completion"} <= options


def changed(source: Path, into: Path, old: str, new: str) -> Path:
    text = source.read_text(encoding="utf-8")
    assert old in text
    into.write_text(text.replace(old, new, 1), encoding="utf-8")
    return into


@pytest.mark.parametrize(
    ("old", "new", "key", "remedy"),
    [
        ("width_m = 0.140", "width_mm = 140", "outer_beam.width_mm", "wrong unit mm: give width_m, in m"),
        ("gain_V_per_m", "gian_V_per_m", "sensor.gian_V_per_m", "did you mean gain_V_per_m?"),
        ("effective_mass_kg = 3.9", "effective_mass_kg = -3.9", "outer_beam.effective_mass_kg", "1e-06 to 100000 kg"),
        ("[0.0, 6.8]", "[6.8, 0.0]", "payload.outer_end_mass_kg", "write [least, most]"),
        ('kind = "lag"', 'kind = "lagg"', "controller", "did you mean 'lag'?"),
        ('"6061-T6"', '"6061-T7"', "outer_beam.material", "6061-T6"),
        ('name = "paper_remedy"', 'name = "paper_remedy', "(file)", "a quotation mark is missing"),
        ("0.05\nwidth", "0,05\nwidth", "(file)", "write decimals with a point"),
        ("= 0.050", "=", "(file)", "the value is missing"),
    ],
)
def test_a_wrong_figure_is_told_by_file_key_reason_and_remedy(
    old: str, new: str, key: str, remedy: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if old == "= 0.050":
        old, new = "damping_ratio = 0.05\n", "damping_ratio =\n"
    path = changed(RIG, tmp_path / "rig.toml", old, new)
    assert status_of(["certify", str(path)]) == 2
    said = capsys.readouterr().err
    (line,) = [line for line in said.splitlines() if key in line and remedy in line]
    assert line.startswith(f"{path}: {key}: ")


@pytest.mark.parametrize("command", ["certify", "tune", "run", "size", "limits", "certify-box", "certify-switching",
                                     "codesign", "front", "remedies", "simulate", "spec", "study run"])  # fmt: skip
def test_what_is_no_file_is_told_by_every_command(command: str, tmp_path: Path) -> None:
    needed = {"run": ["--out", "x"], "front": ["--out", "x"], "remedies": ["--out", "x"],
              "codesign": ["--bandwidth-Hz", "3"], "simulate": ["--out", "x", "--scenario", "y"]}  # fmt: skip
    (tmp_path / "rig.toml").write_text("")
    for name, remedy in (("rigg.toml", "did you mean"), ("", "name a file in it: rig.toml")):
        path = tmp_path / name
        done = CliRunner().invoke(app, [*command.split(), str(path), *needed.get(command, [])])
        told = str(done.exception)
        assert told.startswith(f"{path}: (file): "), told
        assert remedy in told


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["certify", str(STUDY)], "is a study, where a prototype is expected; `beamdesign run"),
        (["run", str(RIG), "--out", "x"], "is a prototype, where a study is expected; `beamdesign new study`"),
        (["certify", str(ROOT / "studies" / "scenarios" / "kick.toml")], "`beamdesign simulate PROTOTYPE --scenario"),
        (["certify", str(RIG), "--outer-end-mass", "6.8"], "expected two masses in kg as LO:HI, such as 0:6.8"),
        (["tune", str(RIG), "--outer-end-mass", "6.8:0"], "6.8 is above 0"),
        (["tune", str(RIG), "--outer-end-mass", "0:inf"], "--outer-end-mass: 0:inf: is inf, outside the plausible"),
        (["gap", "diagnose", str(RIG)], "(whole file): is a prototype, where a data set is expected; `beamdesign gap"),
        (["tune", str(RIG), "--controller", "pid"], "expected one of lag, proportional"),
        (["tune", str(RIG), "--nominal", "--sigmas", "3"], "--sigmas: has no meaning with --nominal"),
        (["run", str(STUDY), "--nominal", "--sigmas", "1", "--out", "x"], "--sigmas: has no meaning with --nominal"),
    ],
)
def test_what_does_not_fit_is_told_with_what_to_do(arguments: list[str], told: str) -> None:
    done = CliRunner().invoke(app, arguments)
    assert told in str(done.exception)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ("code {lqg} --rate-Hz 3000", "{lqg}: controller: a rate of 3000 Hz"),
        ("simulate {fast} --scenario {kick}", "{fast}: controller.period_s: a rate of 2000 Hz"),
        ("simulate {scheduled} --scenario {bench}", "{bench}: record.thrown.start_m: is for an actuator bench"),
        ("simulate {scheduled} --scenario {quick}", "{quick}: sample_s: must be the period"),
        ("simulate {scheduled} --scenario {namesake}", "{scheduled} or {namesake}: sample_s: must be the period"),
        ("code {scheduled} --rate-Hz 5000", "{scheduled}: controller.kind: 'scheduled' is not for what takes one law"),
        ("arm {lumped}", "{lumped}: arm.end_polar_inertia_kg_m2: missing"),
    ],
)
def test_what_a_record_is_refused_for_is_told_of_its_file(arguments: str, told: str, tmp_path: Path) -> None:
    kick = (ROOT / "studies" / "scenarios" / "kick.toml").read_text(encoding="utf-8")
    made = {
        "bench": kick.replace('name = "with_payload"', 'name = "thrown"\nstart_m = 0.01'),
        "quick": kick.replace("duration_s", "sample_s = 1e-4\nduration_s"),
        "fast": (ROOT / "studies/scheduled/structured.toml")
        .read_text(encoding="utf-8")
        .replace("0.0002\n", "0.0005\n"),
        "lumped": "\n".join(
            line for line in RIG.read_text(encoding="utf-8").splitlines() if not line.startswith("width")
        ),
    }
    own = tomllib.loads((ROOT / "studies/scheduled/prototype.toml").read_text(encoding="utf-8"))["name"]
    made["namesake"] = re.sub(r"(?m)^name = .*$", f'name = "{own}"', made["quick"], count=1)
    for name, text in made.items():
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
    paths = {name: tmp_path / f"{name}.toml" for name in made}
    paths |= {
        "kick": ROOT / "studies/scenarios/kick.toml",
        "scheduled": ROOT / "studies/scheduled/prototype.toml",
        "lqg": ROOT / "studies/prototypes/lqg.toml",
    }
    typed = [*arguments.format(**paths).split(), "--out", str(tmp_path / "out")]
    assert told.format(**paths) in str(CliRunner().invoke(app, typed).exception)


def test_a_misspelt_command_or_option_is_guessed() -> None:
    assert "'tune'" in CliRunner().invoke(app, ["tun"]).stderr
    assert "--outer-end-mass" in CliRunner().invoke(app, ["tune", str(RIG), "--outer-end-mas", "0:1"]).stderr


def test_json_to_standard_output_is_all_that_stands_there(tmp_path: Path) -> None:
    found = CliRunner().invoke(app, ["certify", str(RIG), "--out", str(tmp_path / "c.toml"), "--json", "-"])
    fields = json.loads(found.stdout)
    assert fields["stable"] is False
    assert found.exit_code == 1
    assert os.listdir(tmp_path) == ["c.toml"]


@pytest.mark.parametrize(
    ("read", "asked"),
    [
        (STUDY, ["run"]),
        (STUDY, ["codesign", "--bandwidth-Hz", "3"]),
        (RIG, ["tune"]),
        (RIG, ["stiffness"]),
        (RIG, ["arm"]),
    ],
)
def test_no_result_takes_the_place_of_what_it_comes_from(tmp_path: Path, read: Path, asked: list[str]) -> None:
    """Which may be called as the result is, as the shipped study."""
    (tmp_path / "prototype.toml").write_bytes(read.read_bytes())
    found = CliRunner().invoke(app, [*asked, str(tmp_path / "prototype.toml"), "--out", str(tmp_path)])
    assert isinstance(found.exception, InputError)
    assert "would be written over prototype.toml, which is read" in str(found.exception)
    assert (tmp_path / "prototype.toml").read_bytes() == read.read_bytes()


def test_what_a_data_set_names_is_spared_where_it_begins_with_a_byte_order_mark(tmp_path: Path) -> None:
    (tmp_path / "dataset.toml").write_text('\ufeffprototype = "prototype.toml"\n', encoding="utf-8")
    (tmp_path / "prototype.toml").write_bytes(RIG.read_bytes())
    found = CliRunner().invoke(app, ["gap", "diagnose", str(tmp_path), "--out", str(tmp_path)])
    assert isinstance(found.exception, InputError)
    assert "would be written over prototype.toml, which is read" in str(found.exception)


def test_json_takes_the_place_of_no_other_file_of_the_command(tmp_path: Path) -> None:
    rig, out = tmp_path / "rig.toml", tmp_path / "c.toml"
    rig.write_bytes(RIG.read_bytes())
    (tmp_path / "link.toml").symlink_to(rig)
    for target in ("rig.toml", "link.toml", "c.toml"):
        asked = ["certify", str(rig), "--out", str(out), "--json", str(tmp_path / target)]
        found = CliRunner().invoke(app, asked)
        assert isinstance(found.exception, InputError)
        assert f"--json: {tmp_path / target} is another file of this command" in str(found.exception)
    table = tmp_path / "table.csv"
    table.write_text("t_s,disturbance_N\n")
    asked = ["gap", "import", str(table), "--prototype", str(rig), "--out", str(tmp_path / "set"), "--json", str(table)]
    assert isinstance(CliRunner().invoke(app, asked).exception, InputError)
    assert (rig.read_bytes(), table.read_text()) == (RIG.read_bytes(), "t_s,disturbance_N\n")
    assert not out.exists()


def test_json_takes_the_place_of_no_file_that_an_input_names(tmp_path: Path) -> None:
    """A data set's records and prototype, what that rests on, and the forces of a scenario."""
    shutil.copytree(ROOT / "studies" / "gaps" / "slow_sensor", tmp_path / "set")
    record = next(path for path in (tmp_path / "set").rglob("*.csv"))
    proof = tmp_path / "set" / "certificate.toml"
    rig = tmp_path / "set" / "prototype.toml"
    rig.write_text(rig.read_text() + f'[material.proof]\nsource = "{proof.name}"\n')
    scenario, force = tmp_path / "scenario.toml", tmp_path / "force.csv"
    scenario.write_text('name = "a"\n[[record]]\nname = "b"\n[[record.input]]\nkind = "csv"\nfile = "force.csv"\n')
    for path in (proof, force):
        path.write_text("kept")
    diagnosing, simulating = (
        ["gap", "diagnose", str(tmp_path / "set")],
        ["simulate", str(rig), "--scenario", str(scenario)],
    )
    for asked, named in ((diagnosing, record), (diagnosing, rig), (diagnosing, proof), (simulating, force)):
        before = named.read_bytes()
        found = CliRunner().invoke(app, [*asked, "--out", str(tmp_path / "out"), "--json", str(named)])
        assert f"--json: {named} is another file of this command" in str(found.exception)
        assert named.read_bytes() == before


def test_files_that_name_each_other_are_found_once(tmp_path: Path) -> None:
    """By each of two ways there are as many longer ones as one likes."""
    for name, other in (("a", "b"), ("b", "a")):
        (tmp_path / name).mkdir()
        ways = [f"../{other}/rig.toml", f"../../{tmp_path.name}/{other}/rig.toml"]
        (tmp_path / name / "rig.toml").write_text(f"names = {ways}")
    assert len(output.named_files(tmp_path / "a" / "rig.toml")) == 2


def test_json_takes_the_place_of_nothing_that_the_command_has_written(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.toml").write_bytes(RIG.read_bytes())
    found = CliRunner().invoke(app, ["certify", "rig.toml", "--json", "rig.certificate.toml"])
    assert "--json: rig.certificate.toml is another file of this command" in str(found.exception)
    assert check(tmp_path / "rig.certificate.toml").valid


@pytest.mark.skipif(os.name != "posix", reason="pipes of POSIX")
def test_where_nobody_reads_on_the_answer_is_the_same(tmp_path: Path) -> None:
    """Status 1 would be the answer no."""
    for more in ([], ["--json", "-"]):
        reading, writing = os.pipe()
        os.close(reading)
        command = [sys.executable, "-m", "beamdesign", "explain", "--reference", *more]
        done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, check=False, cwd=ROOT)
        os.close(writing)
        assert (done.returncode, done.stderr) == (0, b"")


def test_the_version_is_told() -> None:
    import beamdesign

    found = CliRunner().invoke(app, ["--version"])
    assert found.exit_code == 0
    assert found.stdout.split() == ["beamdesign", beamdesign.__version__]


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_terminals_that_lack_letters_get_the_nearest(tmp_path: Path, encoding: str) -> None:
    """Of three commands, one after another in a process of its own, in which their libraries are loaded once."""
    named = RIG.read_text(encoding="utf-8").replace('name = "', 'name = "Träger \N{GREEK CAPITAL LETTER OMEGA} ', 1)
    (tmp_path / "named.toml").write_text(named, encoding="utf-8")
    code = "import sys\nfrom beamdesign.__main__ import main\n"
    for arguments in (["explain", "--reference"], ["explain", "datasets"], ["certify", "named.toml"]):
        code += f"sys.argv = {['beamdesign', *arguments]!r}\n"
        code += "try:\n    main()\nexcept SystemExit as left:\n    assert left.code in (None, 0, 1), left.code\n"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, cwd=tmp_path, check=False,
        env=os.environ | {"PYTHONIOENCODING": encoding, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0
    assert b"Traceback" not in done.stderr
    assert ("Träger ohm" if encoding == "latin-1" else "Trager ohm").encode(encoding) in done.stdout


def test_a_certificate_of_another_prototype_is_put_aside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    rig = tmp_path / "rig.toml"
    text = RIG.read_text(encoding="utf-8")
    rig.write_text(text, encoding="utf-8")
    certify = ["certify", str(rig)]
    CliRunner().invoke(app, certify)
    first = Path("rig.certificate.toml").read_bytes()
    CliRunner().invoke(app, certify)
    assert sorted(os.listdir()) == ["rig.certificate.toml", "rig.toml"]
    rig.write_text(text.replace("1180", "1181"), encoding="utf-8")
    told = CliRunner().invoke(app, certify).stdout
    (aside,) = set(os.listdir()) - {"rig.certificate.toml", "rig.toml"}
    assert aside in told
    assert Path(aside).read_bytes() == first != Path("rig.certificate.toml").read_bytes()


def test_what_is_no_certificate_is_not_overwritten_by_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("paper_remedy.certificate.toml").write_text('kind = "notes"')
    assert status_of(["certify", str(RIG)]) == 2
    assert Path("paper_remedy.certificate.toml").read_text() == 'kind = "notes"'


def test_a_template_that_is_a_folder_is_not_named_like_a_file(tmp_path: Path) -> None:
    assert status_of(["new", "sweep", "--out", str(tmp_path / "x.toml")]) == 2
    assert os.listdir(tmp_path) == []


def test_long_work_off_a_terminal_is_told_with_share_and_estimate(capsys: pytest.CaptureFixture[str]) -> None:
    with output.lines("certify", every_s=0.01):
        time.sleep(0.05)
        with output.reported("diagnosing") as update:
            update(0.5, "fits")
            time.sleep(0.05)
    told = capsys.readouterr().err.splitlines()
    assert told[0].startswith("certify: ")
    assert re.match(r"diagnosing: 50 % done, \d+ s so far, about \d+ s to go \(fits\)", told[-1])
    output.hush()
    with output.lines("certify", every_s=0.01):
        time.sleep(0.05)
    output.speak()
    assert capsys.readouterr().err == ""


def test_a_line_on_long_work_names_the_command_where_nothing_within_it_says_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(output, "lines", partial(output.lines, every_s=0.02))
    monkeypatch.setattr("beamdesign.records.read_table", lambda path: time.sleep(0.2) or {})
    done = CliRunner().invoke(app, ["certify", str(RIG)], prog_name="beamdesign")
    assert done.stderr.startswith("certify: 0 s so far\n")
