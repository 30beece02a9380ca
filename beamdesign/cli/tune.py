"""`beamdesign tune`: controller and inner end mass with the largest guaranteed bandwidth."""

from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from beamdesign.cli.by_stage import of_all
from beamdesign.cli.completion import toml_files
from beamdesign.cli.figures import mass_range, refuse_implausible
from beamdesign.cli.output import (
    JsonOption,
    RangeOption,
    folder_to_write,
    progress,
    say,
    say_table,
    write_json,
)
from beamdesign.files import write_set

if TYPE_CHECKING:
    from beamdesign.controllers import Sensed
    from beamdesign.design.rig_spread import RigSpread, Shape
    from beamdesign.design.tuning import Tuning
    from beamdesign.proof.certificate import Certificate
    from beamdesign.prototype import Goal, InStage, Prototype

KINDS = ("lag", "proportional", "structured", "lqg", "hinf", "scheduled", "compliance")
"""Of the package itself; a kind that is registered beside them is taken as well where it has seeds."""


def tune(
    prototype: Annotated[Path, typer.Argument(autocompletion=toml_files, help="The prototype.toml to tune.")],
    outer_end_mass: RangeOption = None,
    controller: Annotated[str, typer.Option(help="Kind of controller: " + " or ".join(KINDS) + ".")] = "lag",
    largest_inner_end_mass_kg: Annotated[
        float, typer.Option("--largest-inner-end-mass-kg", help="Most mass that may be added inside.")
    ] = 6.0,
    peak_sensitivity: Annotated[
        float | None, typer.Option(help="Limit of the peak sensitivity; else the prototype's goal.")
    ] = None,
    sections: Annotated[
        int, typer.Option(min=1, max=3, help="Second-order sections of a structured controller, behind its lag.")
    ] = 3,
    stages: Annotated[
        int, typer.Option(min=2, max=12, help="Laws of a scheduled controller, each for a part of the payloads.")
    ] = 3,
    added_sensor: Annotated[
        list[str] | None,
        typer.Option(
            "--added-sensor",
            help="What lqg and hinf read beside the displacement: inner_displacement_m, load_pressure_Pa; repeatable.",
        ),
    ] = None,
    loop_gain: Annotated[
        float | None,
        typer.Option(
            "--loop-gain",
            help="Limit of |L| from --loop-gain-from-Hz up; `inf` for none. Else the goal's, or 0.25 but for lags.",
        ),
    ] = None,
    loop_gain_from_Hz: Annotated[
        float | None, typer.Option("--loop-gain-from-Hz", help="From where on it holds; else the goal's, 250 Hz.")
    ] = None,
    controller_effort_A_per_V: Annotated[
        float | None,
        typer.Option(
            "--controller-effort-A-per-V",
            help="Limit of |C/(1+L)|; `inf` for none. Else the goal's, or 0.06 but for lags.",
        ),
    ] = None,
    robust: Annotated[
        float,
        typer.Option(
            metavar="SIGMAS",
            help="Also guarantee it for the worst rigs so many standard deviations of [tolerance] off.",
        ),
    ] = 0.0,
    robust_box: Annotated[
        bool, typer.Option("--robust-box", help="So many of every figure at once; else of all together.")
    ] = False,
    end_stiffness_N_per_m: Annotated[
        float | None,
        typer.Option("--end-stiffness-N-per-m", help="Of a compliant end; `beamdesign stiffness` has more options."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            callback=folder_to_write,
            help="Folder for prototype.toml and certificate.toml; else neither is written.",
        ),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Tune for the largest bandwidth over a payload range.

    Gain, break frequencies and inner end mass are chosen for the largest bandwidth that can be guaranteed: stability,
    peak sensitivity and compliance are proved for every mass of the range, in exact arithmetic, and for all linear
    members of a prototype with effects. A structured controller is a lag with second-order sections, within limits of
    loop gain and current that its valve sets; lqg and hinf are state feedback with an observer, synthesised by Riccati
    equations, reduced to order 8 and polished within the same limits, as is the prototype's own
    controller where it is structured or an observer. A scheduled one has a law for each part of the payloads, chosen by
    an estimate of the payload and stable whichever acts when: lags, or structured ones where the prototype's own
    controller is. With --robust the same is proved of the worst rigs that the tolerances allow, one by one. Exit
    status 1 if no design can be proved.
    """
    from beamdesign import quantities as q
    from beamdesign.cli.robustness import told_of_rigs, with_stated_tolerances
    from beamdesign.design import tuning
    from beamdesign.design.rig_spread import rig_spread
    from beamdesign.design.schedule import tune_laws
    from beamdesign.proof.between import between, in_words
    from beamdesign.proof.lyapunov import CHANGES_NAME, describe, switching_fields
    from beamdesign.proof.stage_tables import stages_certificate
    from beamdesign.prototype import read_prototype
    from beamdesign.records import InputError, to_toml
    from beamdesign.study.design_run import certified_laws

    record = read_prototype(prototype)
    masses = mass_range(outer_end_mass, record.outer_end_mass_kg, prototype)
    known = dict.fromkeys((*KINDS, *tuning.tunable()))
    if controller not in known:
        raise InputError("--controller", [(controller, f"expected one of {', '.join(known)}")])
    figures = {
        "--largest-inner-end-mass-kg": (largest_inner_end_mass_kg, q.MassOrNone),
        "--peak-sensitivity": (peak_sensitivity, q.PeakSensitivity),
        "--loop-gain": (None if loop_gain == inf else loop_gain, q.LoopGain),
        "--loop-gain-from-Hz": (loop_gain_from_Hz, q.Frequency),
        "--controller-effort-A-per-V": (
            None if controller_effort_A_per_V == inf else controller_effort_A_per_V,
            q.LawGain,
        ),
        "--robust": (robust, q.Sigmas),
        "--end-stiffness-N-per-m": (end_stiffness_N_per_m, q.Stiffness),
    }
    refuse_implausible("tune", figures)
    if peak_sensitivity is not None:
        record = record.but(goal=record.goal.but(peak_sensitivity=peak_sensitivity))
    sensors = _sensors(controller, added_sensor or [])
    given = {
        "loop_gain": loop_gain,
        "loop_gain_from_Hz": loop_gain_from_Hz,
        "controller_effort_A_per_V": controller_effort_A_per_V,
    }
    record = record.but(goal=tuning.limited(record.goal, controller, given))
    shape: tuple[float, Shape] = (robust, "box" if robust_box else "ball")
    spread = None
    if robust > 0:
        record = with_stated_tolerances(record)
        spread = rig_spread(record.but(controller=None, guarantee=None), masses[1], *shape)
    if controller == "compliance" or end_stiffness_N_per_m is not None:
        _compliant(record, controller, end_stiffness_N_per_m, masses, spread, out, json)
        return
    with progress("tuning") as update:
        asked = (record, masses, controller, largest_inner_end_mass_kg, update, sections, sensors, spread, stages)
        found = tune_laws(*asked)
    if found.reason:
        say(found.reason)
        write_json(json, {"controller": None, "inner_end_mass_kg": None, "guaranteed": None, "reason": found.reason})
        raise typer.Exit(1)
    guaranteed, each = certified_laws(found)
    texts = {"prototype": ("prototype.toml", to_toml(guaranteed))}
    answers = []
    for stage, law, (certificate, _) in zip(found.stages, found.laws, each, strict=True):
        end = stage.suffix.replace(".", "_")
        texts[f"certificate{end}"] = (f"certificate{stage.suffix}.toml", certificate.text)
        answers.append((_of_law(stage, law, certificate), True))
        if spread is not None:
            answers[-1][0]["robust"] = told_of_rigs(stage, law, shape, texts)
        if record.effects:
            verdict = between(guaranteed, *masses)
            if words := in_words(verdict):
                say(f"  {words}")
            if verdict is not None and verdict.certificate:
                texts["certificate_between"] = ("certificate.between.toml", verdict.certificate)
    answer = of_all(guaranteed, answers) | {"controller": guaranteed.controller and guaranteed.controller.model_dump()}
    if (changes := found.switching) is not None:
        lines = describe(changes)
        for line in (*lines, *(["changes are proved of the nominal rig alone"] if spread is not None else [])):
            say(f"  {line}")
        summary = "\n".join((f"{record.name}: changes between {len(found.laws)} stages", *lines))
        texts["certificate_switching"] = (CHANGES_NAME, stages_certificate(guaranteed, changes, summary))
        answer |= {"alone_bandwidth_Hz": found.alone_Hz, "switching": switching_fields(changes)}
    elif len(found.laws) > 1:
        say("  changes between the laws are not covered by any proof: the prototype has effects")
    paths = {} if out is None else write_set(out, texts, ("certificate.*.toml", CHANGES_NAME))
    for name, path in paths.items():
        say(f"{name}: {path}")
    write_json(json, answer | paths)
    if changes is not None and not changes.stable:
        raise typer.Exit(1)


def _of_law(stage: "InStage", law: "Tuning", certificate: "Certificate") -> dict[str, Any]:
    """Say what was tuned and is guaranteed of one law over its payloads; the same for the JSON file."""
    from beamdesign.report.quantity import at_least, at_most, mass_range_text

    best, goal, masses = law.best, stage.prototype.goal, stage.outer_end_mass_kg
    assert best is not None
    rows = [
        *best.controller.summary(),
        ("inner_end_mass_kg", str(best.inner_end_mass_kg)),
        ("guaranteed bandwidth", at_least(best.bandwidth_Hz, "Hz")),
        ("guaranteed peak sensitivity", at_most(best.peak_sensitivity, "1")),
        *_kept(goal),
        ("for every outer end mass", mass_range_text(masses)),
    ]
    say_table(f"{stage.prototype.name}: tuned {best.controller.kind} controller", ("figure", "value"), rows)
    say(f"proved in exact arithmetic; {law.certificates} stability certificates on the way")
    for line in certificate.scope:
        say(f"  {line}")
    return {
        "controller": best.controller.model_dump(),
        "inner_end_mass_kg": best.inner_end_mass_kg,
        "guaranteed": {
            "bandwidth_Hz": best.bandwidth_Hz,
            "peak_sensitivity": best.peak_sensitivity,
            "outer_end_mass_kg": list(masses),
            "loop_gain": goal.loop_gain,
            "loop_gain_from_Hz": goal.loop_gain_from_Hz,
            "controller_effort_A_per_V": goal.controller_effort_A_per_V,
            "method": certificate.method,
            "scope": certificate.scope,
        },
        "starts_bandwidth_Hz": law.starts,
        "stability_certificates": law.certificates,
    }


def _compliant(
    record: "Prototype",
    kind: str,
    end_stiffness: float | None,
    masses: tuple[float, float],
    spread: "RigSpread | None",
    *files: Path | None,
) -> None:
    """The controller that gives the end a stiffness, with the inner end mass as it is."""
    from beamdesign.cli.stiffness import give_stiffness
    from beamdesign.records import InputError

    if kind != "compliance":
        raise InputError("--end-stiffness-N-per-m", [(f"{end_stiffness:g}", "is for --controller compliance")])
    if end_stiffness is None:
        raise InputError("--controller", [("compliance", "needs --end-stiffness-N-per-m")])
    out, json = files
    give_stiffness(record, end_stiffness, masses, out=out, json=json, spread=spread)


def _sensors(kind: str, added: list[str]) -> "tuple[Sensed, ...]":
    """What the controller reads, in the order of the record."""
    from beamdesign.controllers import SENSED
    from beamdesign.records import InputError

    if wrong := [name for name in added if name not in SENSED[1:]]:
        raise InputError("--added-sensor", [(name, f"expected one of {', '.join(SENSED[1:])}") for name in wrong])
    if added and kind not in ("lqg", "hinf"):
        raise InputError("--added-sensor", [(", ".join(added), f"a {kind} controller reads the displacement alone")])
    return tuple(name for name in SENSED if name == SENSED[0] or name in added)


def _kept(goal: "Goal") -> list[tuple[str, str]]:
    """The limits of loop gain and effort that are proved to be kept."""
    rows = []
    if goal.loop_gain is not None:
        rows.append((f"guaranteed |L| from {goal.loop_gain_from_Hz:g} Hz up", f"at most {goal.loop_gain:g}"))
    if goal.controller_effort_A_per_V is not None:
        rows.append(("guaranteed |C/(1+L)|", f"at most {goal.controller_effort_A_per_V:g} A/V"))
    return rows
