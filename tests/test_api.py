"""The Python interface: a handful of names, light to import, the verbs as functions on a prototype."""

import ast
import doctest
import inspect
import math
import pkgutil
import subprocess
import sys
from functools import partial
from importlib import import_module
from pathlib import Path

import control
import numpy as np
import pytest

import beamdesign
from beamdesign import InputError, Prototype
from beamdesign.cli import PANELS
from beamdesign.cli.gap import gap
from beamdesign.synthesis.operating_limits import Limits, envelope

ROOT = Path(__file__).parent.parent
STUDY = beamdesign.read_problem(ROOT / "studies" / "prototype.toml")
HEAVY = {
    "casadi", "control", "cvxpy", "flint", "jinja2", "matplotlib", "numpy", "pydantic", "rich", "scipy", "tomli_w",
    "typer",
}  # fmt: skip


def modules_after(code: str) -> set[str]:
    """Names of the top-level packages that a fresh interpreter has loaded after some code."""
    script = f"import sys\n{code}\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    return {name.split(".")[0] for name in done.stdout.split()}


def test_importing_the_package_loads_no_engine():
    assert modules_after("import beamdesign") & HEAVY == set()


def test_the_command_line_loads_no_engine_either():
    assert modules_after("import beamdesign.cli") & HEAVY == {"typer"}


def test_a_name_loads_only_what_it_needs():
    loaded = modules_after("from beamdesign import read_prototype")
    assert loaded & HEAVY == {"pydantic", "tomli_w"}


@pytest.mark.parametrize("name", beamdesign.__all__)
def test_every_public_name_is_documented_and_stays_what_it_is(name):
    first = getattr(beamdesign, name)
    assert getattr(beamdesign, name) is first
    assert callable(first)
    assert not inspect.ismodule(first)
    assert first.__name__ == name
    assert len(inspect.getdoc(first) or "") > 20


ON_RECORDS = {
    name: first
    for name in beamdesign.__all__
    if inspect.isfunction(getattr(beamdesign, name))
    and (first := next(iter(inspect.signature(getattr(beamdesign, name)).parameters.values()), None)) is not None
    and first.name in ("prototype", "problem", "data")
    and name not in ("predict", "write_prototype")  # the one reads a path itself, the other writes any record
}


@pytest.mark.parametrize("name", ON_RECORDS)
@pytest.mark.parametrize("given", ["rig.toml", Path("rig.toml"), {}, None])
def test_what_is_no_record_is_refused_with_what_reads_one(name, given):
    first = ON_RECORDS[name]
    function, more = getattr(beamdesign, name), len(inspect.signature(getattr(beamdesign, name)).parameters) * [None]
    reader = {"prototype": "read_prototype", "problem": "read_problem", "data": "read_dataset"}[first.name]
    for refused in (partial(function, given, *more[1:]), partial(function, **{first.name: given})):
        with pytest.raises(InputError, match=f"is of type {type(given).__name__}; beamdesign.{reader} reads one"):
            refused()


def test_tests_and_studies_take_public_names_from_the_package():
    public = {name: getattr(beamdesign, name) for name in beamdesign.__all__}
    deeper = []
    for path in (*(ROOT / "tests").rglob("*.py"), *(ROOT / "studies").rglob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("beamdesign."):
                own = vars(import_module(str(node.module)))
                names = [one.name for one in node.names if one.name in public]
                deeper += [f"{path.name}: {name}" for name in names if own.get(name) is public[name]]
    assert deeper == []


def test_the_tour_names_every_public_name_and_its_examples_run(monkeypatch):
    monkeypatch.chdir(ROOT)
    assert [name for name in beamdesign.__all__ if f"`{name}`" not in beamdesign.__doc__] == []
    done = doctest.testmod(beamdesign)
    assert done.attempted > 5
    assert done.failed == 0


OTHER_NAMES = {"import": "import_measured"}  # which Python keeps for itself
COMMANDS = (
    *(one.__name__ for panel, group in PANELS.items() if panel != "Begin" for one in group),
    *(OTHER_NAMES.get(one.name or "", one.name or one.callback.__name__) for one in gap.registered_commands),
    *("check", "study"),
)
FIRST = ("problem", "prototype", "source", "path", "data", "certificate", "files", "folder")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_a_function_with_the_same_conventions(name):
    """A range is a pair, a unit is in the name; progress is told by a function."""
    parameters = inspect.signature(getattr(beamdesign, name)).parameters
    masses = parameters.get("outer_end_mass_kg")
    assert masses is None or name == "limits" or "tuple[float, float]" in str(masses.annotation)
    assert next(iter(parameters), FIRST[0]) in FIRST


def test_a_range_is_a_pair_or_what_the_prototype_states(monkeypatch: pytest.MonkeyPatch):
    firm = beamdesign.read_prototype(ROOT / "studies" / "prototypes" / "paper_remedy.toml")
    pair, ends = beamdesign.certify(firm, (2.0, 6.8)), beamdesign.certify(firm, 2.0, 6.8)
    assert pair.text == ends.text
    assert beamdesign.certify(firm).outer_end_mass_kg == firm.payload.outer_end_mass_kg
    assert pair.to_dict()["outer_end_mass_kg"] == [2.0, 6.8]
    assert repr(pair).startswith("<Certificate: yes;")
    with pytest.raises(InputError, match="expected a pair of masses"):
        beamdesign.certify(firm, 2.0)
    with pytest.raises(InputError, match=r"payload\.outer_end_mass_kg: missing; give it there or as an argument"):
        beamdesign.tune(firm.but(payload={}))
    assert beamdesign.remedies(STUDY, None, 4.5, numbers=()) == ()
    with pytest.raises(InputError, match="bandwidth_Hz: is nan"):  # and not that a range is missing
        beamdesign.codesign(STUDY, None, math.nan)
    monkeypatch.setattr("beamdesign.synthesis.design_run.run_design", lambda problem, *_: problem)
    assert beamdesign.run(STUDY, outer_end_mass_kg=(1.0, 2.0)).asked_kg() == (1.0, 2.0)
    assert beamdesign.run(STUDY).asked_kg() == STUDY.payload.outer_end_mass_kg


def bearing(rig: Prototype) -> Limits:
    return Limits(rig, 3.0, 0.0, envelope(rig, 3.0))


def test_results_of_one_rig_are_equal_and_of_another_are_not():
    """Whatever they hold: crossings enclosed in balls, arrays, records."""
    firm = beamdesign.read_prototype(ROOT / "studies" / "prototypes" / "paper_remedy.toml")
    for ask in (partial(beamdesign.certify, outer_end_mass_kg=(0.0, 20.0)), bearing):
        one, again = ask(firm), ask(firm)
        assert one is not again
        assert one == again
        assert {one: "found"}[again] == "found"
        assert ask(firm.but(name="other")) != one
        assert one != firm


@pytest.mark.parametrize("mass", [-1.0, float("nan"), float("inf"), 1e9])
def test_a_payload_that_no_file_may_state_is_refused(mass: float):
    """As by every command, rather than proved or told of as a number that an engine cannot read."""
    refusal = rf"payload\.outer_end_mass_kg: is {mass:g}, outside the plausible range .* kg".replace("+", r"\+")
    firm = beamdesign.read_prototype(ROOT / "studies" / "prototypes" / "paper_remedy.toml")
    for ask in OF_PAYLOADS:
        with pytest.raises(InputError, match=refusal):
            ask(firm, outer_end_mass_kg=(mass, 6.8))
    for ask in OF_A_PAYLOAD:
        with pytest.raises(InputError, match=refusal):
            ask(firm, mass)


@pytest.mark.parametrize("given", [{}, None, STUDY])
def test_what_is_neither_a_record_nor_its_path_is_refused(given):
    firm, data = ROOT / "studies" / "prototypes" / "paper_remedy.toml", ROOT / "studies" / "gaps" / "slow_sensor"
    with pytest.raises(InputError, match=r"a Prototype, is of type .*; beamdesign\.read_prototype reads one"):
        beamdesign.predict(given, data)
    with pytest.raises(InputError, match="dataset: expected a Path, is of type"):
        beamdesign.predict(firm, dataset=given)
    with pytest.raises(InputError, match=r"scenario: expected a Scenario, is of type .*read_scenario"):
        beamdesign.simulate(beamdesign.read_prototype(firm), given)


@pytest.mark.parametrize(
    ("words", "ask"),
    [
        ("path: expected a text or a path, is None", lambda rig: beamdesign.read_prototype(None)),
        ("folder: expected a text or a path, is 3", lambda rig: beamdesign.read_dataset(3)),
        ("path: expected a text or a path, is True", lambda rig: beamdesign.read_problem(path=True)),
        ("prototype: expected a Prototype", lambda rig: beamdesign.write_prototype(STUDY, "a.toml")),
        ("nonlinear: expected True or False, is 'no'", lambda rig: beamdesign.certify(rig, (0.0, 1.0), nonlinear="no")),
        ("claims: expected a list, of each expected an Asked, is 2", lambda rig: beamdesign.certify(rig, claims=[2])),
        (
            "loop: expected 'closed' or 'open' or 'plant', is 'shut'",
            lambda rig: beamdesign.state_space(rig, 0.0, "shut"),
        ),
        ("loop: expected .* is of type ndarray", lambda rig: beamdesign.state_space(rig, loop=np.zeros(99))),
        ("word_length: expected a whole number or None", lambda rig: beamdesign.code(rig, 2e4, word_length=32.5)),
        ("files: expected a list or a path or a text", lambda rig: beamdesign.import_measured(7, "a.toml", "b")),
        ("columns: expected a list, is 't_s = t'", lambda rig: beamdesign.import_measured("a", "b", "c", "t_s = t")),
        ("only: expected a list, of each expected a text", lambda rig: beamdesign.certify_box(rig, only=[1.0])),
        ("wall_N_per_m: expected 2 numbers, is 5.0", lambda rig: beamdesign.stiffness(rig, wall_N_per_m=5.0)),
        ("wall_N_per_m: .* is 9:1$", lambda rig: beamdesign.stiffness(rig, 1e5, wall_N_per_m=(9.0, 1.0))),
        ("wall_damping_N_s_per_m: .* is -1:1$", lambda rig: beamdesign.stiffness(rig, wall_damping_N_s_per_m=(-1, 1))),
        ("contact: is 'soft'; expected passive, wall, none", lambda rig: beamdesign.stiffness(rig, contact="soft")),
        ("force_N: expected 3 numbers", lambda rig: beamdesign.arm(rig, force_N=(0.0, 1.0))),
        ("rate_kg_per_s: is -1; above 0", lambda rig: beamdesign.certify_switching(rig, (0.0, 1.0), -1.0)),
        (r"loop: s: expected a text in s or a list of coefficients, is 1\.0", lambda rig: beamdesign.prove((1.0, 2.0))),
        ("cases: expected a whole number or None", lambda rig: beamdesign.study("a.toml", "b", cases="all")),
        ("cases: expected a whole number, is None", lambda rig: beamdesign.blindcheck("a", None)),
    ],
)
def test_what_is_not_as_a_function_is_annotated_is_refused(words: str, ask) -> None:
    """By its name and in words, where Python's own would tell of what an engine did with it; or it was passed over."""
    with pytest.raises(InputError, match=words):
        ask(beamdesign.read_prototype(ROOT / "studies" / "prototypes" / "tame_lag.toml"))


OF_A_PAYLOAD = (beamdesign.limits, beamdesign.critical_gain, beamdesign.state_space)
OF_PAYLOADS = (
    beamdesign.certify, beamdesign.certify_box, beamdesign.certify_switching, beamdesign.arm, beamdesign.spec,
    beamdesign.tune, partial(beamdesign.code, rate_Hz=2e4), partial(beamdesign.stiffness, rigs=0),
    lambda _, outer_end_mass_kg: beamdesign.codesign(STUDY, outer_end_mass_kg, 3.0),
    lambda _, outer_end_mass_kg: beamdesign.front(STUDY, [3.0], [outer_end_mass_kg]),
    lambda _, outer_end_mass_kg: beamdesign.remedies(STUDY, outer_end_mass_kg, 4.5),
    lambda _, outer_end_mass_kg: beamdesign.run(STUDY, outer_end_mass_kg=outer_end_mass_kg),
)  # fmt: skip
"""Functions of a range of payloads, of which each would decide something else for what is no range."""


@pytest.mark.parametrize("ask", OF_PAYLOADS)
def test_what_is_no_range_of_payloads_is_refused(ask):
    """Neither turned round, nor read as a range of what it begins with."""
    firm = beamdesign.read_prototype(ROOT / "studies" / "prototypes" / "tame_lag.toml")
    with pytest.raises(ValueError, match="empty range: 3 is above 2"):
        ask(firm, outer_end_mass_kg=(3.0, 2.0))
    for pair in ((1.0, 2.0, 3.0), (), 3.0, {1.0: 2.0}):
        with pytest.raises(InputError, match="expected a pair of masses in kg"):
            ask(firm, outer_end_mass_kg=pair)
    for pair in ("23", ("2", "3"), (None, 3.0)):
        with pytest.raises(InputError, match="expected a number"):
            ask(firm, outer_end_mass_kg=pair)


def test_figures_may_be_numbers_and_arrays_of_numpy():
    firm = beamdesign.read_prototype(ROOT / "studies" / "prototypes" / "tame_lag.toml")
    for pair in (np.array([2, 3]), [np.float32(2.0), np.int64(3)]):
        assert beamdesign.certify(firm, pair).outer_end_mass_kg == (2.0, 3.0)
        assert beamdesign.code(firm, np.int64(20_000), pair, np.int64(24)).outer_end_mass_kg == (2.0, 3.0)
        assert beamdesign.arm(firm, pair, np.array([0.0, 0.0, -50.0])).outer_end_mass_kg == (2.0, 3.0)


def test_figures_that_no_option_may_state_are_refused_by_functions_too():
    """Rather than answered with what is not a number, or passed over."""
    firm = beamdesign.read_prototype(ROOT / "studies" / "prototypes" / "tame_lag.toml")
    for key, ask in (
        ("preload_N", lambda: beamdesign.limits(firm, 2.0, math.nan)),
        ("force_N", lambda: beamdesign.arm(firm, (0.0, 1.0), (0.0, 0.0, math.nan))),
        ("rate_Hz", lambda: beamdesign.code(firm, math.inf)),
        ("largest_current_A", lambda: beamdesign.code(firm, 2e4, largest_current_A=0.0)),
        ("full_scale_V", lambda: beamdesign.code(firm, 2e4, full_scale_V=-10.0)),
        ("load_N", lambda: beamdesign.spec(firm, load_N=math.nan)),
        ("noise_share", lambda: beamdesign.spec(firm, noise_share=-1.0)),
        ("sigmas", lambda: beamdesign.certify_box(firm, sigmas=math.nan)),
        ("delay_s", lambda: beamdesign.certify_box(firm, delay_s=-1e-3)),
        ("sigmas", lambda: beamdesign.tune(firm, (0.0, 1.0), sigmas=-2.0)),
        ("largest_inner_end_mass_kg", lambda: beamdesign.tune(firm, (0.0, 1.0), largest_inner_end_mass_kg=-1.0)),
        ("end_stiffness_N_per_m", lambda: beamdesign.stiffness(firm, math.nan)),
        ("bandwidth_Hz", lambda: beamdesign.codesign(STUDY, (0.0, 1.0), math.nan)),
        ("bandwidth_Hz", lambda: beamdesign.front(STUDY, [-3.0])),
        ("added_mass_kg", lambda: beamdesign.remedies(STUDY, (0.0, 1.0), math.nan)),
    ):
        with pytest.raises(InputError, match=f"{key}: is .*, outside the plausible range"):
            ask()
    with pytest.raises(InputError, match="a lag controller reads the displacement alone"):
        beamdesign.tune(firm, (0.0, 1.0), sensors=("displacement_m", "inner_displacement_m"))
    for sensors in (("inner_displacement_m",), ("inner_displacement_m", "displacement_m"), ()):
        with pytest.raises(InputError, match="sensors: must begin with 'displacement_m', whose volts close the loop"):
            beamdesign.tune(firm, (0.0, 1.0), "lqg", sensors=sensors)
    with pytest.raises(InputError, match="no bandwidth"):
        beamdesign.front(STUDY, [])


def test_public_names_are_listed_once_and_in_order():
    assert sorted(set(beamdesign.__all__)) == list(beamdesign.__all__) == dir(beamdesign)


def test_no_module_goes_by_the_name_of_a_function():
    """A module of that name would take the function's place as soon as anything imports it."""
    modules = {module.name for module in pkgutil.iter_modules(beamdesign.__path__)}
    assert modules & set(beamdesign.__all__) == set()


def test_functions_stay_functions_after_their_rooms_are_imported():
    """The rooms of tuning, sizing and co-design have public functions of like names inside."""
    code = """
from importlib import import_module
import pkgutil
import beamdesign
from beamdesign.cli import PANELS
for room in ("synthesis", "proofs", "sweep"):
    package = import_module(f"beamdesign.{room}")
    for module in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
        import_module(module.name)
for name in beamdesign.__all__:
    assert callable(getattr(beamdesign, name)), name
"""
    modules_after(code)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'beamdesign' has no attribute 'optimise'"):
        import_module("beamdesign").optimise  # noqa: B018


def test_the_verbs_work_on_a_prototype(tmp_path, paper: Prototype):
    """Read, certify, replay, hand to python-control: no command line in between."""
    path = tmp_path / "rig.toml"
    firm = beamdesign.read_prototype(ROOT / "studies" / "prototypes" / "paper_remedy.toml")
    beamdesign.write_prototype(firm, path)
    assert beamdesign.read_prototype(path) == firm

    certificate = beamdesign.certify(firm, 2.0, 6.8)
    assert certificate.stable
    (tmp_path / "certificate.toml").write_text(certificate.text, encoding="utf-8")
    assert beamdesign.check(tmp_path / "certificate.toml").valid

    model = beamdesign.state_space(firm, outer_end_mass_kg=3.0)
    assert isinstance(model, control.StateSpace)
    assert beamdesign.critical_gain(firm, 6.8).gain_A_per_V > firm.controller.gain_A_per_V

    assert not beamdesign.certify(firm, 0.0, 6.8).stable
    with pytest.raises(InputError, match="is a prototype, where a study is expected"):
        beamdesign.read_problem(path)


def test_what_is_proved_of_every_rig_is_one_record(tmp_path: Path):
    """The command writes what the function gives, and its certificate is proved again."""
    rig = beamdesign.read_prototype(ROOT / "studies" / "prototypes" / "tame_lag.toml")
    found = beamdesign.certify_box(rig, (0.0, 2.0), sigmas=1.0, only=["outer_stiffness", "flow_gain"])
    assert found.yes
    assert found.stable
    assert found.guaranteed["bandwidth_Hz"] > 3.0
    assert found.to_dict()["guaranteed"]["outer_end_mass_kg"] == [0.0, 2.0]
    (tmp_path / "box.toml").write_text(found.text, encoding="utf-8")
    assert beamdesign.check(tmp_path / "box.toml").valid
    assert repr(found).startswith("<BoxGuarantee: yes; stable=True")
    wild = beamdesign.certify_box(rig.but(controller=rig.controller.but(gain_A_per_V=0.5)), (0.0, 2.0), sigmas=1.0)
    assert not wild.yes
    assert not wild.claims
    assert wild.reason


def test_an_arm_without_a_load_gets_that_of_its_largest_payload():
    firm = beamdesign.read_prototype(ROOT / "studies" / "prototypes" / "paper_remedy.toml")
    found, asked = beamdesign.arm(firm, (2.0, 6.8)), beamdesign.arm(firm, (2.0, 6.8), (0.0, 0.0, -6.8 * 9.80665))
    assert firm.payload.largest_force_N is None
    assert found.with_servo.size_m == asked.with_servo.size_m > 0


def test_a_stiffness_that_is_not_asked_for_is_judged():
    rig = beamdesign.read_prototype(ROOT / "studies" / "prototypes" / "tame_lag.toml")
    found = beamdesign.stiffness(rig)
    assert found.prototype is None
    assert found.to_dict()["static_stiffness_N_per_m"] == found.best.static_N_per_m > 1e8
    with pytest.raises(InputError, match="missing, so that there is none to keep"):
        beamdesign.stiffness(rig.but(controller=None), 1e6, keep_controller=True)
