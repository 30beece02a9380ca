"""Every controller through every command, every effect and every certificate likewise, at the smallest honest size.

A cell works, or it is a hole: refused as bad input with a reason that names the kind. Holes are listed here. A new one
fails, and so does one that has closed, until its entry is taken out. Cells that would take long are looked at where
the command accepts or refuses the kind.
"""

import json
import math
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from one_start import best_start_alone, short_climbs
from rigs_of_effects import having, with_effects
from short_scenario import SCENARIO
from typer.testing import CliRunner

from beamdesign import InputError, checker, read_dataset, read_problem, read_prototype, write_prototype
from beamdesign.cli import app, output
from beamdesign.diagnosis import redesign as redesigning
from beamdesign.diagnosis.fitting.hypothesis import cause, singles
from beamdesign.diagnosis.redesign import redesign
from beamdesign.plant import linear_reach
from beamdesign.plant.effects import causes
from beamdesign.synthesis import operating_limits, tuning

pytestmark = pytest.mark.long

STUDIES = Path(__file__).parents[1] / "studies"
PAYLOAD = (2.0, 2.2)

LAG = {"kind": "lag", "gain_A_per_V": 0.05, "pole_Hz": 1.7, "zero_Hz": 20.0}
SECTION = {"zero_Hz": 30.0, "zero_damping_ratio": 0.5, "pole_Hz": 30.0, "pole_damping_ratio": 0.6}
_POLE, _SHARE = 2 * math.pi * 1.7, 1.7 / 20.0  # the lag once more, with one state
OBSERVER = {"kind": "observer", "gain_A_per_V": 0.05, "sensors": ["displacement_m"], "c": [1.0], "d": [_SHARE],
            "a": [[-_POLE]], "b": [[_POLE * (1 - _SHARE)]]}  # fmt: skip
SENSORS = {"sensors": ["displacement_m", "load_pressure_Pa"], "b": [[_POLE * (1 - _SHARE), 0.0]], "d": [_SHARE, 1e-9]}
STAGES = [LAG | {"outer_end_mass_kg": list(masses)} for masses in ((1.0, 2.6), (1.7, 3.0))]


def shipped(name: str) -> dict[str, Any]:
    """A shipped prototype or study as tables."""
    return tomllib.loads((STUDIES / name).read_text(encoding="utf-8"))


COMPLIANT = {key: shipped("prototypes/compliant.toml")[key] for key in ("controller", "compliance")}
KINDS: dict[str, dict[str, Any]] = {
    "proportional": {"controller": {"kind": "proportional", "gain_A_per_V": 0.004}},
    "lag": {"controller": LAG},
    "structured": {"controller": LAG | {"kind": "structured", "section": [SECTION]}},
    "observer": {"controller": OBSERVER},
    "sensors": {"controller": OBSERVER | SENSORS},
    "compliant": COMPLIANT,
    "scheduled": {
        "controller": {"kind": "scheduled", "stage": [{k: v for k, v in s.items() if k != "kind"} for s in STAGES]}
    },
}
"""What a prototype of each kind has; `sensors` is an observer with an added sensor."""

NAMED = {
    "observer": ("observer", "lqg"),
    "sensors": ("observer", "sensors", "lqg"),
    "compliant": ("observer", "sensors", "compliance"),
}
"""Words of which a refusal has to hold one, where the kind itself is not the word."""


class Hole(Exception):
    """An answer that is none for this kind, though nothing was refused."""


def prototype(**tables: Any) -> Path:
    """Write the tame rig over a narrow payload, with other tables."""
    rig = shipped("prototypes/tame_lag.toml")
    rig["payload"]["outer_end_mass_kg"] = list(PAYLOAD)
    Path("p.toml").write_text(tomli_w.dumps(rig | tables))
    return Path("p.toml")


def call(line: str, status: int | None = 0) -> dict[str, Any]:
    """The JSON of a command that ends with a status, or with an answer of either kind; its refusal is raised."""
    done = CliRunner().invoke(app, [*line.split(), "--json", "answer.json"])
    if isinstance(done.exception, InputError):  # which the program tells with exit status 2
        raise done.exception
    answered = isinstance(done.exception, SystemExit | None) and done.exit_code in (0, 1)
    assert answered if status is None else done.exit_code == status, f"{line}: {done.output}{done.exception!r}"
    fields: dict[str, Any] = json.loads(Path("answer.json").read_text())
    return fields


@cache
def _carried_out(line: str, given: str) -> tuple[dict[str, Any], dict[str, str]]:
    fields = call(line)
    return fields, {path.as_posix(): path.read_text() for path in Path().rglob("*.toml") if path.name != "p.toml"}


def written(line: str) -> dict[str, Any]:
    """The JSON of a command that proves `p.toml` and writes certificates, carried out once for all cells that ask."""
    fields, files = _carried_out(line, Path("p.toml").read_text())
    for path, text in files.items():
        Path(path).parent.mkdir(exist_ok=True)
        Path(path).write_text(text)
    return fields


class Begun(Exception):
    """A search that would take long has begun."""


def begins(line: str) -> None:
    """Run a command up to the first word that its search gives of how far it has got; its refusal is raised.

    Where that begins is of no account here: it begins at the starts that are given.
    """

    @contextmanager
    def first(description: str) -> Iterator[Callable[[float, str], None]]:
        def begun(share: float, words: str) -> None:
            raise Begun(words)

        yield begun

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(output, "reported", first)
        patch.setattr(tuning, "widely", lambda task, starts: [])
        done = CliRunner().invoke(app, line.split())
    if isinstance(done.exception, InputError):
        raise done.exception
    assert isinstance(done.exception, Begun), f"{line}: {done.output}{done.exception!r}"


def held(hole: str | None, words: tuple[str, ...], work: Callable[[], object]) -> None:
    """Work that succeeds unless it is a known hole, and then is refused in words of which one is asked for."""
    try:
        work()
        refusal = ""
    except (InputError, Hole) as error:
        refusal = str(error)
    if hole is None:
        assert refusal == "", "a new hole"
    else:
        assert refusal, f"the hole has closed, take out its entry: {hole}"
        assert any(word in refusal for word in words), "the refusal does not say what it refuses"


# Every controller x every command


def certificate(kind: str) -> str:
    """What proves a prototype of this kind, as a file."""
    command = "certify-switching" if kind == "scheduled" else "certify"
    written(f"{command} p.toml --out c.toml")
    return "c.toml"


def certify(kind: str) -> None:
    assert written("certify p.toml --out c.toml")["stable"]


def replayed(kind: str) -> None:
    assert call(f"certify p.toml --replay {certificate(kind)}")["valid"]


OF_BOX = "certify-box p.toml --sigmas 0.01 --only flow_gain --out b.toml"


def certify_box(kind: str) -> None:
    # The box of all figures at once is that of `MADE`; whether a kind is taken shows in one of them, and needs no
    # long search for the worst member.
    with short_climbs():
        assert written(OF_BOX)["stable"]


def certify_switching(kind: str) -> None:
    rate = "" if kind == "scheduled" else "--rate 0.01 "
    assert written(f"certify-switching p.toml {rate}--out c.toml")["certificate"] == "c.toml"


def stiffness(kind: str) -> None:
    assert call("stiffness p.toml --contact none")["stable"]


def arm(kind: str) -> None:
    assert call("arm p.toml")["stable"]


def simulate(kind: str, more: str = "") -> None:
    Path("s.toml").write_text(SCENARIO + more)
    assert call("simulate p.toml --scenario s.toml --no-plots --out out")["records"]


def simulate_sampled(kind: str) -> None:
    simulate(kind, "[sampled]\nperiod_s = 0.0005\n")


def limits(kind: str) -> None:
    # How far the linear model holds is looked at where the search for it begins, at one frequency.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(linear_reach, "_GRID", 1)
        patch.setattr(operating_limits, "LINEAR_HZ", operating_limits.LINEAR_HZ[:1])
        patch.setattr(operating_limits, "AMPLITUDES_M", operating_limits.AMPLITUDES_M[-2:])
        assert call("limits p.toml")["stable"]


def spec(kind: str) -> None:
    # Of a gain far beyond what is stable the answer is a quick no.
    rig = tomllib.loads(Path("p.toml").read_text())
    for law in (rig["controller"], *rig["controller"].get("stage", ())):
        if "gain_A_per_V" in law:
            law["gain_A_per_V"] *= 1e3
    Path("p.toml").write_text(tomli_w.dumps(rig))
    assert call("spec p.toml --out out", 1)["reason"]


def code(kind: str) -> None:
    assert call("code p.toml --rate-Hz 5000 --out out")["proved"]


def dataset() -> None:
    """A data set of one short record, taken with the controller of the prototype that was believed."""
    times = np.arange(60) * 1e-3
    columns = {"t_s": times, "disturbance_N": 50 * np.sin(120 * times), "command_V": 0 * times}
    columns |= {name: 1e-6 * np.sin(120 * times + 1) for name in ("current_A", "displacement_m")}
    table = np.column_stack(list(columns.values()))
    np.savetxt("r.csv", table, delimiter=",", header=",".join(columns), comments="")
    row = {"file": "r.csv", "outer_end_mass_kg": 2.0, "inner_end_mass_kg": 2.5}
    Path("dataset.toml").write_text(tomli_w.dumps({"name": "d", "prototype": "p.toml", "record": [row]}))


def gap_predict(kind: str) -> None:
    dataset()
    assert call("gap predict p.toml . --out out")["complete"]


def gap_read(kind: str) -> None:
    dataset()
    assert len(read_dataset(".").records) == 1


SOUGHT: dict[str, dict[str, Any]] = {
    "structured": {"kind": "structured", "sections": 1},
    "observer": {"kind": "lqg", "sensors": ("displacement_m",)},
    "sensors": {"kind": "lqg", "sensors": ("displacement_m", "load_pressure_Pa")},
    "compliant": {"end_stiffness_N_per_m": COMPLIANT["compliance"]["end_stiffness_N_per_m"]},
    "scheduled": {"stages": 2},
}
"""What a redesign asks of the tuner where the search would take long."""


def gap_redesign(kind: str) -> None:
    dataset()
    believed = read_dataset(".").prototype
    if kind in ("proportional", "lag"):
        with best_start_alone():
            found = redesign(believed, PAYLOAD).prototype
        assert found is not None
        assert found.controller is not None
        assert found.controller.kind == kind
        return

    def tuned(*asked: object, **sought: object) -> None:
        raise Begun(sought)

    def compliant(*asked: object, **more: object) -> None:
        raise Begun({"end_stiffness_N_per_m": asked[1]})

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tuning, "tune", tuned)
        patch.setattr(redesigning, "stiffness", compliant)
        with pytest.raises(Begun) as caught:
            redesign(believed, PAYLOAD)
    (sought,) = caught.value.args
    assert SOUGHT[kind].items() <= sought.items()


IN_A_STUDY = {
    "observer": {"kind": "lqg"},
    "sensors": {"kind": "lqg", "added_sensors": ["load_pressure_Pa"]},
    "compliant": {"kind": "compliance"},
}
"""What asks a study for the kinds, where it is another word."""


def run(kind: str) -> None:
    study = shipped("prototype.toml") | {"controller": IN_A_STUDY.get(kind, {"kind": kind})}
    Path("study.toml").write_text(tomli_w.dumps(study))
    read_problem("study.toml")


def study_run(kind: str) -> None:
    vary = [{"key": "sensor.gain_V_per_m", "values": [1170.0]}]
    sweep = {"name": "s", "study": {"task": "certify", "base": "p.toml"}, "vary": vary}
    Path("sweep.toml").write_text(tomli_w.dumps(sweep))
    call("study run sweep.toml --out out")
    (row,) = call("study show out")["rows"]
    if row["status"] == "refused":
        raise Hole(row["reason"])
    assert row["status"] == "done", row


TO = {
    "observer": "lqg",
    "sensors": "lqg --added-sensor load_pressure_Pa",
    "compliant": "compliance --end-stiffness-N-per-m 3e5",
    "scheduled": "scheduled --stages 2 --outer-end-mass 0:6.8",
}
"""What `tune --controller` calls the kinds, where it is another word."""


def tune_from(kind: str) -> None:
    begins("tune p.toml")


def tune_to(kind: str) -> None:
    prototype()
    begins(f"tune p.toml --controller {TO.get(kind, kind)}")


def tune_sigmas(kind: str) -> None:
    prototype()
    begins(f"tune p.toml --controller {TO.get(kind, kind)} --sigmas 0.5")


COMMANDS = {
    "certify": certify,
    "certify --replay": replayed,
    "certify-box": certify_box,
    "certify-switching": certify_switching,
    "tune from": tune_from,
    "tune to": tune_to,
    "tune --sigmas": tune_sigmas,
    "stiffness": stiffness,
    "arm": arm,
    "simulate": simulate,
    "simulate sampled": simulate_sampled,
    "limits": limits,
    "spec": spec,
    "code": code,
    "gap predict": gap_predict,
    "gap diagnose": gap_read,
    "gap diagnose --redesign": gap_redesign,
    "run": run,
    "study run": study_run,
}

_OBSERVERS = "observer, sensors, compliant"
_SENSORS = "sensors, compliant"
_LISTED = (
    (
        "code",
        "scheduled",
        "by its kind: a law takes over the current, and sections of the code have states of their own",
    ),
    ("tune --sigmas", "compliant", "by its kind: an end stiffness is proved of exactly the figures stated"),
    ("run", "compliant", "by its kind: an end stiffness is given to a prototype that stands"),
)
HOLES = {(command, kind): reason for command, kinds, reason in _LISTED for kind in kinds.split(", ")}
"""What is refused today, by command and kind of controller, and why."""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, computed_here: None) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("command", COMMANDS)
def test_every_controller_through_every_command(command: str, kind: str) -> None:
    prototype(name="rig", **KINDS[kind])
    words = NAMED.get(kind, (kind,))
    held(HOLES.get((command, kind)), words, lambda: COMMANDS[command](kind))


# Every effect x simulate, prove, explain, diagnose


def effect_simulate(name: str) -> None:
    simulate(name)


def effect_certify(name: str) -> None:
    assert written("certify p.toml --linear --out c.toml")["stable"]


def effect_replay(name: str) -> None:
    effect_certify(name)
    assert call("certify p.toml --replay c.toml")["valid"]


def effect_box(name: str) -> None:
    # What an effect spans makes boxes that take long to decide; that it is not refuted shows that it is taken.
    found = call("certify-box p.toml --sigmas 0.01 --only sensor_gain --budget 20 --out b.toml", None)
    assert found["stable"] is not False


def effect_explain(name: str) -> None:
    (told,) = call(f"explain {name}")["effects"]
    assert told["name"] == name


def effect_diagnose(name: str) -> None:
    rig = having(read_prototype(prototype()), name)
    assert cause(name) in {known for hypothesis in singles(rig) for known in hypothesis.causes}


OF_EFFECTS = {
    "simulate": effect_simulate,
    "certify": effect_certify,
    "certify --replay": effect_replay,
    "certify-box": effect_box,
    "explain": effect_explain,
    "gap diagnose": effect_diagnose,
}


@pytest.mark.parametrize("effect", causes())
@pytest.mark.parametrize("command", OF_EFFECTS)
def test_every_effect_through_what_works_on_effects(command: str, effect: str) -> None:
    write_prototype(with_effects(read_prototype(prototype()), effect), Path("p.toml"))
    OF_EFFECTS[command](effect)


# Every kind of certificate x its own prototype

MADE: dict[str, tuple[dict[str, Any], str, str]] = {
    "beamdesign.mass_range": ({"effects": {"sensor_lag": {}}}, "certify p.toml --out c.toml", "c.toml"),
    "beamdesign.box": (KINDS["lag"], OF_BOX, "b.toml"),
    "beamdesign.stages": (KINDS["scheduled"], "certify-switching p.toml --out c.toml", "c.toml"),
    "beamdesign.contact": ({}, "stiffness p.toml --contact none --out out", "out/certificate.contact.toml"),
    "beamdesign.arm_plane": (
        {"arm": shipped("prototypes/arm.toml")["arm"]},
        "arm p.toml --out out",
        "out/certificate_y.toml",
    ),
}
"""By kind of certificate: tables of a prototype, the command that writes it, and where."""


def test_no_kind_of_certificate_is_left_out_and_every_hole_is_of_a_cell() -> None:
    assert set(MADE) == set(checker.KINDS) - set(checker.OF_NO_RIG)
    assert set(HOLES) <= set(product(COMMANDS, KINDS))


@pytest.mark.parametrize("kind", MADE)
def test_every_certificate_is_valid_of_its_own_prototype(kind: str) -> None:
    tables, command, path = MADE[kind]
    prototype(name="rig", **tables)
    written(command)
    assert tomllib.loads(Path(path).read_text(encoding="utf-8"))["kind"] == kind
    assert call(f"certify --replay {path}")["valid"]
    assert call(f"certify p.toml --replay {path}")["valid"]
