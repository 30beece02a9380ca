"""`beamdesign size` and `tune`: the lightest sections; controller and inner end mass with the largest bandwidth."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from beamdesign.cli.command import CommandResult, Figure, command, in_time, mass_range, of_all, toml_files
from beamdesign.cli.output import echo, echo_table, progress, refuse
from beamdesign.cli.stiffness import give_stiffness
from beamdesign.files import write_set
from beamdesign.result import picked
from beamdesign.synthesis import SIGMAS

if TYPE_CHECKING:
    from beamdesign.controllers import Sensed
    from beamdesign.proofs.certificate import Certificate
    from beamdesign.prototype import Goal, InStage
    from beamdesign.synthesis.tuning import Tuning


KINDS = ("lag", "proportional", "structured", "lqg", "hinf", "scheduled", "compliance")
"""Of the package itself; a kind that is registered beside them is taken as well where it has seeds."""

_NOMINAL = {"lag": "5 to 20 s", "proportional": "5 s"}
_USUALLY = {"lag": "10 to 60 s", "proportional": "10 to 60 s", "scheduled": "2 to 10 min"}
"""How long it takes, of exactly the figures stated and of every rig within tolerances."""


@command
def tune(
    prototype: Path,
    outer_end_mass: str | None = None,
    controller: str = "lag",
    largest_inner_end_mass_kg: Annotated[float, Figure("MassOrNone")] = 6.0,
    peak_sensitivity: Annotated[float | None, Figure("PeakSensitivity")] = None,
    peak_over_passive: Annotated[float | None, Figure("PeakOverPassive")] = None,
    sections: Annotated[int, typer.Option(min=1, max=3)] = 3,
    stages: Annotated[int, typer.Option(min=2, max=12)] = 3,
    added_sensor: list[str] | None = None,
    loop_gain: Annotated[float | None, Figure("LoopGain", or_infinite=True)] = None,
    loop_gain_from_Hz: Annotated[float | None, Figure("Frequency")] = None,
    controller_effort_A_per_V: Annotated[float | None, Figure("LawGain", or_infinite=True)] = None,
    sigmas: float = SIGMAS,
    nominal: bool = False,
    lower_gains: Annotated[bool | None, typer.Option("--lower-gains/--no-lower-gains")] = None,
    comes_to_rest: bool = False,
    end_stiffness_N_per_m: Annotated[float | None, Figure("Stiffness")] = None,
    minutes: float | None = None,
    out: Path | None = None,
) -> CommandResult:
    """Tune for the largest bandwidth over a payload range.

    Gain, break frequencies and inner end mass are chosen for the largest bandwidth that can be guaranteed: stability,
    peak sensitivity and compliance are proved for every mass of the range, in exact arithmetic, and for all linear
    members of a prototype with effects. A structured controller is a lag with second-order sections, within limits of
    loop gain and current that its valve sets; lqg and hinf are state feedback with an observer, synthesised by Riccati
    equations, reduced to order 8 and refined within the same limits, as is the prototype's own
    controller where it is structured or an observer. A scheduled one has a law for each part of the payloads, chosen by
    an estimate of the payload and stable whichever acts when: lags, or structured ones where the prototype's own
    controller is. All of it is proved of every rig within two standard deviations of each figure at once, with
    --nominal of exactly the figures stated. Exit status 1 if no design can be proved.

    Args:
        prototype: the prototype.toml to tune.
        controller: kind of controller: lag, proportional, structured, lqg, hinf, scheduled or compliance.
        largest_inner_end_mass_kg: most mass that may be added inside.
        peak_sensitivity: limit of the peak sensitivity; else the prototype's goal.
        peak_over_passive: limit of the largest compliance at any frequency, over the largest with the servo off; `inf`
            for none. Else the prototype's goal.
        sections: second-order sections of a structured controller, behind its lag.
        stages: laws of a scheduled controller, each for a part of the payloads.
        added_sensor: what lqg and hinf read beside the displacement: inner_displacement_m, and
            load_pressure_Pa of a cylinder or screw_force_N; repeatable.
        loop_gain: limit of |L| from --loop-gain-from-Hz up; `inf` for none. Else the goal's, or 0.25 but for lags.
        loop_gain_from_Hz: from where on it holds; else the goal's, 250 Hz.
        controller_effort_A_per_V: limit of |C/(1+L)|; `inf` for none. Else the goal's, or 0.06 but for lags.
        lower_gains: whether the loop is to be stable at every lower gain; else as the prototype's goal has it.
        comes_to_rest: limit it to loops proved to come to rest from every state while the current saturates.
        end_stiffness_N_per_m: of a compliant end; `beamdesign stiffness` has more options.
        out: folder for prototype.toml and certificate.toml; else neither is written.
    """
    from beamdesign.proofs.lyapunov import CHANGES_NAME, describe, stages_certificate, switching_fields
    from beamdesign.proofs.tolerance_box import between, in_words
    from beamdesign.prototype import read_prototype
    from beamdesign.records import to_toml
    from beamdesign.synthesis import tuning
    from beamdesign.synthesis.design_run import certificate_name, certified_laws

    record = read_prototype(prototype)
    masses = mass_range(outer_end_mass, record.outer_end_mass_kg, prototype)
    known = dict.fromkeys((*KINDS, *tuning.tunable()))
    if controller not in known:
        refuse("--controller", (controller, f"expected one of {', '.join(known)}"))
    wanted = {
        "peak_sensitivity": peak_sensitivity,
        "peak_over_passive": peak_over_passive,
        "lower_gains": lower_gains,
        "comes_to_rest": comes_to_rest or None,
    }
    goal = record.goal.but(**{name: value for name, value in wanted.items() if value is not None})
    sensors = _sensors(controller, added_sensor or [])
    given = {
        "loop_gain": loop_gain,
        "loop_gain_from_Hz": loop_gain_from_Hz,
        "controller_effort_A_per_V": controller_effort_A_per_V,
    }
    record = record.but(goal=tuning.limited(goal, controller, given))
    if controller == "compliance" or end_stiffness_N_per_m is not None:
        if controller != "compliance":
            reason = "is for --controller compliance"
            refuse("--end-stiffness-N-per-m", (f"{end_stiffness_N_per_m:g}", reason))
        if end_stiffness_N_per_m is None:
            refuse("--controller", ("compliance", "needs --end-stiffness-N-per-m"))
        return give_stiffness(record, end_stiffness_N_per_m, masses, out=out, minutes=minutes)
    within = 0.0 if nominal else sigmas
    usually = (
        _NOMINAL.get(controller, "1 to 10 min") if nominal or not sigmas else _USUALLY.get(controller, "5 to 40 min")
    )
    with in_time(minutes, usually) as limit, progress("tuning") as update:
        asked = (record, masses, controller, largest_inner_end_mass_kg, update, sections, sensors, within, stages)
        found = tuning.tune(*asked)
    if found.caution:
        echo(found.caution)
    if found.reason:
        echo(found.reason)
        nothing = dict.fromkeys(("controller", "inner_end_mass_kg", "guaranteed"))
        return CommandResult(nothing | {"reason": found.reason} | limit, yes=False)
    guaranteed, each = certified_laws(found)
    texts = {"prototype": ("prototype.toml", to_toml(guaranteed))}
    answers = []
    for stage, law, (certificate, _) in zip(found.stages, found.each, each, strict=True):
        end = stage.suffix.replace(".", "_")
        texts[f"certificate{end}"] = (f"certificate{stage.suffix}.toml", certificate.text)
        answers.append((_of_law(stage, law, certificate), True))
        if law.best is not None and law.best.over_box is not None:
            texts[f"certificate_box{end}"] = (certificate_name(stage.suffix, box=True), law.best.over_box.certificate)
        if record.effects:
            verdict = between(guaranteed, *masses)
            if words := in_words(verdict):
                echo(f"  {words}")
            if verdict is not None and verdict.certificate:
                texts["certificate_between"] = ("certificate.between.toml", verdict.certificate)
    answer = of_all(guaranteed, answers) | {"controller": guaranteed.controller and guaranteed.controller.model_dump()}
    if (changes := found.switching) is not None:
        lines = describe(changes)
        for line in (*lines, *(["changes are proved of exactly the figures stated"] if within else [])):
            echo(f"  {line}")
        summary = "\n".join((f"{record.name}: changes between {len(found.laws)} stages", *lines))
        texts["certificate_switching"] = (CHANGES_NAME, stages_certificate(guaranteed, changes, summary))
        answer |= {"alone_bandwidth_Hz": found.alone_Hz, "switching": switching_fields(changes)}
    elif found.laws:
        echo("  changes between the laws are not covered by any proof: the prototype has effects")
    paths: dict[str, Path] = {} if out is None else write_set(out, texts, ("certificate.*.toml", CHANGES_NAME))
    return CommandResult(answer | paths | limit, changes is None or bool(changes.stable), paths.values())


def _of_law(stage: "InStage", law: "Tuning", certificate: "Certificate") -> dict[str, Any]:
    """Say what was tuned and is guaranteed of one law over its payloads; the same for the JSON file."""
    from beamdesign.proofs.near_rest import holds_for
    from beamdesign.quantities import further_rows, guaranteed_rows

    best, goal, masses = law.best, stage.prototype.goal, stage.outer_end_mass_kg
    assert best is not None
    found = best.guaranteed(stage.prototype, masses)
    rows = [
        *best.controller.summary(),
        ("inner_end_mass_kg", str(best.inner_end_mass_kg)),
        *guaranteed_rows(best, masses, _kept(goal)),
        *further_rows(found),
    ]
    echo_table(f"{stage.prototype.name}: tuned {best.controller.kind} controller", ("figure", "value"), rows)
    echo(f"proved {holds_for(stage.prototype, best.sigmas)}; {law.certificates} stability certificates on the way")
    for line in certificate.scope:
        echo(f"  {line}")
    return {
        "controller": best.controller.model_dump(),
        "inner_end_mass_kg": best.inner_end_mass_kg,
        "guaranteed": {
            **found,
            **picked(goal, "loop_gain loop_gain_from_Hz controller_effort_A_per_V"),
            **picked(certificate, "method scope"),
        },
        "starts_bandwidth_Hz": law.starts,
        "stability_certificates": law.certificates,
    }


def _sensors(kind: str, added: list[str]) -> "tuple[Sensed, ...]":
    """What the controller reads, in the order of the record."""
    from beamdesign.controllers import SENSORS

    if wrong := [name for name in added if name not in SENSORS[1:]]:
        refuse("--added-sensor", *((name, f"expected one of {', '.join(SENSORS[1:])}") for name in wrong))
    if added and kind not in ("lqg", "hinf"):
        refuse("--added-sensor", (", ".join(added), f"a {kind} controller reads the displacement alone"))
    return tuple(name for name in SENSORS if name == SENSORS[0] or name in added)


def _kept(goal: "Goal") -> list[tuple[str, str]]:
    """The limits of loop gain and effort that are proved to be kept."""
    rows = []
    if goal.loop_gain is not None:
        rows.append((f"guaranteed |L| from {goal.loop_gain_from_Hz:g} Hz up", f"at most {goal.loop_gain:g}"))
    if goal.controller_effort_A_per_V is not None:
        rows.append(("guaranteed |C/(1+L)|", f"at most {goal.controller_effort_A_per_V:g} A/V"))
    return rows


DEFAULT_TIP_FORCE_N = 2000.0
_STUDY_TABLES = {"load", "sections", "clearance", "safety"}


@command
def size(
    study: Annotated[Path, typer.Argument(autocompletion=toml_files, metavar="STUDY-OR-PROTOTYPE")],
    tip_force_N: Annotated[float | None, Figure("Force")] = None,
) -> CommandResult:
    """Find the lightest tubes for a study, or check a rig's.

    For a study, the pair of least mass that passes every structural check; for a prototype, its own sections checked.
    Exit status 1 if no pair fits, or if a section fails a check; the reason says which requirement to relax.

    Args:
        study: a study file or a prototype.toml.
        tip_force_N: load to check a prototype for; 2000 by default.
    """
    from beamdesign.records import read_table

    if not read_table(study).keys() & _STUDY_TABLES:
        return _checked(study, tip_force_N)

    from beamdesign.problem import read_problem
    from beamdesign.sweep.answers import check_fields
    from beamdesign.synthesis.sizing import size as find_sections

    problem = read_problem(study)
    if tip_force_N is not None:
        refuse("--tip-force-N", (f"{tip_force_N:g}", f"{study} states its own load; change it there"))
    with progress("sizing") as update:
        found = find_sections(problem, update)
    echo(f"{problem.name}: {'' if found.feasible else 'NOT FEASIBLE: '}{found.reason}")
    echo_table("pairs of tubes", ("pair", "outer, mm", "inner, mm", "beam mass, kg", "checks"), found.rows())
    if found.price_of_rounding_kg is not None:
        echo(f"price of rounding to stock sizes: {found.price_of_rounding_kg:.3g} kg")
    echo_checks(f"checks of the {'chosen' if found.feasible else 'nearest'} pair", map(check_fields, found.checks))
    if found.free:
        free = found.free
        echo(f"free sizes: KKT residual {free.kkt_residual:.1e}; active: {'; '.join(free.active)}")
        prices = [(name, price) for name, price in free.shadow_prices.items() if price]
        echo_table("shadow prices: what the least mass gains per unit of each requirement", ("per unit", "kg"), prices)
    return CommandResult(found.to_dict(), found.feasible)


def _checked(path: Path, tip_force_N: float | None) -> CommandResult:
    from beamdesign.problem import Clearance, Safety, Sections
    from beamdesign.prototype import read_prototype
    from beamdesign.sweep.answers import check_fields
    from beamdesign.synthesis.sizing import check_prototype

    prototype = read_prototype(path)
    force = DEFAULT_TIP_FORCE_N if tip_force_N is None else tip_force_N
    pair = check_prototype(prototype, force, str(path))
    echo(
        f"{prototype.name}: sections checked for a tip force of {force:g} N "
        f"({'default' if tip_force_N is None else '--tip-force-N'}), with default safety factors "
        f"({Safety().strength:g} strength, {Safety().local_buckling:g} local buckling) and gaps "
        f"({1e3 * Clearance().assembly_m:g} mm at assembly, {1e3 * Clearance().under_load_m:g} mm under load): "
        "a prototype states none of these"
    )
    echo_checks("checks", map(check_fields, pair.checks))
    echo(f"both beams weigh {pair.beam_mass_kg:.4g} kg; governed by {pair.governing}")
    if not pair.feasible:
        echo(f"fails: {'; '.join(check.name for check in pair.failing)}")
    assumed = {
        "load": {"tip_force_N": force},
        "clearance": Clearance().model_dump(),
        "safety": Safety().model_dump(),
        "sections": Sections().model_dump(exclude={"choose"}),
    }
    return CommandResult(pair.to_dict() | picked(pair, "governing feasible") | {"assumed": assumed}, pair.feasible)


def echo_checks(title: str, checks: Iterable[Mapping[str, Any]]) -> None:
    """Print structural checks, given as the fields that the task `size` keeps of them."""
    rows = [
        (
            check["name"],
            check["value"],
            "at least" if check["at_least"] else "at most",
            check["limit"],
            check["unit"],
            "-" if check["utilisation"] is None else f"{100 * check['utilisation']:.0f} %",
            "" if check["satisfied"] else "FAILS",
        )
        for check in checks
    ]
    echo_table(title, ("check", "value", "", "limit", "unit", "used", ""), rows)
