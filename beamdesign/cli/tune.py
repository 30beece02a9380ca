"""`beamdesign tune` and `stiffness`: a controller of the largest bandwidth, or for a commanded stiffness of the end."""

from collections.abc import Iterator
from functools import partial
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

import beamdesign
from beamdesign.cli.certify import echo_aside
from beamdesign.cli.command import CommandResult, Figure, by_stage, command, figures_of, in_time, mass_range, of_all
from beamdesign.cli.output import echo, echo_table, progress, refuse, spare
from beamdesign.files import write_set
from beamdesign.result import picked
from beamdesign.synthesis import RIGS, SIGMAS

if TYPE_CHECKING:
    from beamdesign.controllers import Sensed
    from beamdesign.proofs.certificate import Certificate
    from beamdesign.prototype import InStage, Prototype
    from beamdesign.synthesis.end_stiffness import EndStiffness
    from beamdesign.synthesis.tuning import Tuning


_NOMINAL = {"lag": "5 to 20 s", "proportional": "5 s"}
_USUALLY = {"lag": "10 to 60 s", "proportional": "10 to 60 s", "scheduled": "2 to 10 min"}
"""How long it takes, of exactly the figures stated and of every rig within tolerances."""


_NOT_OF_STIFFNESS = (
    "largest_inner_end_mass_kg", "peak_over_passive", "sigmas", "nominal", "lower_gains", "comes_to_rest",
)  # fmt: skip
"""Options that the search for an end stiffness does not heed."""


def _unheeded(controller: str, sections: int, stages: int, **given: Any) -> Iterator[tuple[str, str]]:
    """Options that ask for something other than usual, which the kind of controller does not heed."""
    from beamdesign.controllers import KINDS

    usual = {name: option.default for name, option in signature(tune).parameters.items()}
    if sections != usual["sections"] and not (controller in KINDS and KINDS[controller].grows):
        yield "--sections", f"is for --controller structured; a {controller} one does not grow"
    if stages != usual["stages"] and controller != "scheduled":
        yield "--stages", f"is for --controller scheduled; a {controller} one is one law"
    reason = "is not heeded with --controller compliance; see `beamdesign stiffness`"
    for name in _NOT_OF_STIFFNESS if controller == "compliance" else ():
        if given[name] != usual[name]:
            yield f"--{name.replace('_', '-')}", reason


@partial(command, problems=_unheeded)
def tune(
    prototype: Path,
    outer_end_mass: str | None = None,
    controller: str = "lag",
    largest_inner_end_mass_kg: Annotated[float | None, Figure("MassOrNone")] = None,
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
    an estimate of the payload and stable for all payloads: lags, or structured ones where the prototype's own
    controller is. All of it is proved of every rig within two standard deviations of each figure at once, with
    --nominal of exactly the figures stated; changes between the laws, whichever acts when or as far apart as the answer
    says, of exactly these in either case, and with effects not at all. Exit status 1 if no design can be proved, if
    changes are looked at and not proved, or with --nominal if stability between the ends of what effects freeze is not.

    Args:
        prototype: the prototype.toml to tune.
        controller: kind of controller: lag, proportional, structured, lqg, hinf, scheduled or compliance.
        largest_inner_end_mass_kg: most mass that may be added inside; else 6 kg of a rig as heavy as the published one
            with payloads up to 6.8 kg, of a heavier or lighter one in proportion, to a power of two.
        peak_sensitivity: limit of the peak sensitivity; else the prototype's goal.
        peak_over_passive: limit of the largest compliance at any frequency, over the largest with the servo off; `inf`
            for none. Else the prototype's goal.
        sections: second-order sections of a structured controller, behind its lag.
        stages: laws of a scheduled controller, each for a part of the payloads.
        added_sensor: what lqg and hinf read beside the displacement: inner_displacement_m, and
            load_pressure_Pa of a cylinder or screw_force_N; repeatable.
        loop_gain: limit of |L| from --loop-gain-from-Hz up; `inf` for none. Else the goal's, or 0.25 but for lags.
        loop_gain_from_Hz: from where on it holds; else the goal's, 250 Hz, of a quicker or slower rig in proportion.
        controller_effort_A_per_V: limit of |C/(1+L)|; `inf` for none. Else the goal's, or of a servovalve 0.06 but for
            lags.
        lower_gains: whether the loop is to be stable at every lower gain; else as the prototype's goal has it.
        comes_to_rest: limit it to loops proved to come to rest from every state while the law's current saturates.
        end_stiffness_N_per_m: of a compliant end; `beamdesign stiffness` has more options.
        out: folder for prototype.toml and certificate.toml; else neither is written.
    """
    from beamdesign.problem import Tuned
    from beamdesign.proofs.lyapunov import CHANGES_NAME, describe, stages_certificate
    from beamdesign.records import to_toml
    from beamdesign.synthesis.design_run import certificate_name, certified_laws
    from beamdesign.synthesis.tuning import limited, tunable

    record = beamdesign.read_prototype(prototype)
    spare([prototype], out, ["prototype.toml"])
    masses = mass_range(outer_end_mass, record.outer_end_mass_kg, prototype)
    known = dict.fromkeys((*get_args(Tuned), "compliance", *tunable()))  # and what is registered with seeds
    if controller not in known:
        refuse("--controller", (controller, f"expected one of {', '.join(known)}"))
    sensors = _sensors(controller, added_sensor or [])
    given = {
        "peak_sensitivity": peak_sensitivity,
        "peak_over_passive": peak_over_passive,
        "lower_gains": lower_gains,
        "comes_to_rest": comes_to_rest or None,
        "loop_gain": loop_gain,
        "loop_gain_from_Hz": loop_gain_from_Hz,
        "controller_effort_A_per_V": controller_effort_A_per_V,
    }
    record = limited(record, controller, given)
    if controller != "compliance" and end_stiffness_N_per_m is not None:
        refuse("--end-stiffness-N-per-m", (f"{end_stiffness_N_per_m:g}", "is for --controller compliance"))
    if controller == "compliance":
        if end_stiffness_N_per_m is None:
            refuse("--controller", ("compliance", "needs --end-stiffness-N-per-m"))
        return give_stiffness(record, end_stiffness_N_per_m, masses, out, minutes)
    within = 0.0 if nominal else sigmas
    usual, otherwise = (_NOMINAL, "1 to 10 min") if nominal or not sigmas else (_USUALLY, "5 to 40 min")
    with in_time(minutes, usual.get(controller, otherwise)) as limit, progress("tuning") as update:
        mass = largest_inner_end_mass_kg
        found = beamdesign.tune(record, masses, controller, mass, update, sections, sensors, within, stages)
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
        fields, proved = _of_law(stage, law, certificate), True
        if law.best is not None and law.best.over_box is not None:
            texts[f"certificate_box{end}"] = (certificate_name(stage.suffix, box=True), law.best.over_box.certificate)
        if record.effects:
            if (inside := certificate.between) is not None:
                echo(f"  {inside.of_frozen}")
            if inside is not None and inside.certificate:
                texts[f"certificate_between{end}"] = (f"certificate{stage.suffix}.between.toml", inside.certificate)
            proved = not law.open_between
            fields["stable_between"] = inside and (proved or inside.stable)
        answers.append((fields, proved))
    answer = of_all(guaranteed, answers) | {"controller": guaranteed.controller and guaranteed.controller.model_dump()}
    if (changes := found.switching) is not None:
        lines = describe(changes)
        echo(*lines, before="  ")
        summary = "\n".join((f"{record.name}: changes between {len(found.laws)} stages", *lines))
        texts["certificate_switching"] = (CHANGES_NAME, stages_certificate(guaranteed, changes, summary))
        answer |= {"alone_bandwidth_Hz": found.alone_Hz, "switching": changes.to_dict()}
    elif found.laws:
        echo("  changes between the laws are not covered by any proof: the prototype has effects")
    paths: dict[str, Path] = {} if out is None else write_set(out, texts, ("certificate.*.toml", CHANGES_NAME))
    return CommandResult(answer | paths | limit, found.yes and all(yes for _, yes in answers), paths.values())


def _of_law(stage: "InStage", law: "Tuning", certificate: "Certificate") -> dict[str, Any]:
    """Say what was tuned and is guaranteed of one law over its payloads; the same for the JSON file."""
    from beamdesign.proofs.certificate import describe, goal_claims
    from beamdesign.proofs.scope import holds_for, near_rest
    from beamdesign.quantities import further_rows, guaranteed_rows
    from beamdesign.structure.arm import left_aside

    best, goal, masses = law.best, stage.prototype.goal, stage.outer_end_mass_kg
    assert best is not None
    found = best.guaranteed(stage.prototype, masses)
    rows = [
        *best.controller.summary(),
        ("inner_end_mass_kg", str(best.inner_end_mass_kg)),
        *guaranteed_rows(best, masses, [("guaranteed", describe(asked)) for asked in goal_claims(goal)]),
        *further_rows(found),
    ]
    echo_table(f"{stage.prototype.name}: tuned {best.controller.kind} controller", ("figure", "value"), rows)
    echo(f"proved {holds_for(stage.prototype, best.sigmas)}; {law.certificates} stability certificates on the way")
    echo(*certificate.scope, before="  ")
    echo_aside(stage.prototype)
    limits = picked(goal, "loop_gain loop_gain_from_Hz controller_effort_A_per_V")
    return {
        "controller": best.controller.model_dump(),
        "inner_end_mass_kg": best.inner_end_mass_kg,
        "guaranteed": found | limits | picked(certificate, "method scope"),
        "holds_for": holds_for(stage.prototype, best.sigmas),
        "near_rest": near_rest(stage.prototype),
        "arm_left_aside": left_aside(stage.prototype),
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


_LowToHigh = Annotated[str, typer.Option(metavar="LO:HI")]


def _wrong_wishes(
    contact: str, end_stiffness_N_per_m: float | None, keep_controller: bool, **others: Any
) -> Iterator[tuple[str, str]]:
    if contact not in (known := ("passive", "wall", "none")):
        yield "--contact", f"must be one of {', '.join(known)}, is {contact!r}"
    if end_stiffness_N_per_m is None and keep_controller:
        yield "--keep-controller", "is for --end-stiffness-N-per-m; without it no other controller is made"


@partial(command, problems=_wrong_wishes)
def stiffness(
    prototype: Path,
    end_stiffness_N_per_m: Annotated[float | None, Figure("Stiffness")] = None,
    outer_end_mass: str | None = None,
    wall_N_per_m: _LowToHigh = "0:1e9",
    wall_damping_N_s_per_m: _LowToHigh = "0:0",
    contact: str = "wall",
    keep_controller: bool = False,
    rigs: Annotated[int, typer.Option(min=0, max=1000)] = RIGS,
    minutes: float | None = None,
    out: Path | None = None,
) -> CommandResult:
    """Give the end of the link a stiffness.

    From nearly none to that of the servo. The command moves by the force on the tip over the stiffness; the force is
    that of the outer beam's bending less the actuator's, from the sensors of displacement and of load pressure, or of
    the force of a screw, behind a low-pass filter. Lag and filter are searched for the widest band in which the end
    feels as commanded, within 10 %. Stability over the payload, passivity at the tip and contact with walls are proved
    or refuted in exact arithmetic, for the linear loop with its nominal figures; on rigs drawn from the tolerances they
    are counted. Without a stiffness the controller is judged as it is. Exit status 1 if contact is not what it has to
    be.

    Args:
        prototype: the prototype.toml of the rig.
        end_stiffness_N_per_m: static stiffness that the end is to have; without it the controller is judged as it is.
        wall_N_per_m: stiffness of the walls that it may touch.
        wall_damping_N_s_per_m: damping of these walls.
        contact: least that contact has to be: passive (with any passive surroundings), wall (stable against every
            wall of the range) or none (stable in the air). The most that can be had is looked for first.
        keep_controller: keep the prototype's controller; choose the force filter alone.
        rigs: rigs drawn from the prototype's tolerances that the law has to suit; 0: nominal alone.
        out: folder for prototype.toml and its certificates; else none is written.
    """
    from beamdesign.synthesis.end_stiffness import CONTACT_NAME, contact_text, in_words

    record = beamdesign.read_prototype(prototype)
    spare([prototype], out, ["prototype.toml"])
    low, high = figures_of("--wall-N-per-m", wall_N_per_m, "WallStiffness", "two figures as LO:HI", ":", 2)
    if high == 0:
        refuse("--wall-N-per-m", (wall_N_per_m, "is no wall; give a stiffest one, or --contact none"))
    damping = figures_of("--wall-damping-N-s-per-m", wall_damping_N_s_per_m, "Damping", "two figures as LO:HI", ":", 2)
    asked: dict[str, Any] = {"wall_N_per_m": (low, high), "wall_damping_N_s_per_m": damping, "contact": contact}
    masses = mass_range(outer_end_mass, record.outer_end_mass_kg, prototype)
    if end_stiffness_N_per_m is not None:
        asked |= {"keep_controller": keep_controller, "rigs": rigs}
        return give_stiffness(record, end_stiffness_N_per_m, masses, out, minutes, **asked)

    def judged(stage: "InStage") -> tuple[dict[str, Any], bool]:
        rig, own, _ = stage
        try:
            answer = beamdesign.stiffness(rig, None, own, **asked)
        except ValueError as error:
            refuse(prototype, ("controller", str(error)))
        found = answer.best
        assert found is not None  # it is judged as it is
        rows = [*_kept(found), *_proved_of(own)]
        echo_table(f"{rig.name}: its end, with the controller as it is", ("figure", "value"), rows)
        echo(*in_words(found))
        echo_aside(rig)
        if answer.reason:
            echo(answer.reason)
        proof = {"certificate_contact": (CONTACT_NAME, contact_text(rig, found))}
        paths = {} if out is None else write_set(out / stage.suffix[1:], proof)
        for kind, path in paths.items():
            echo(f"{kind}: {path}")
        return answer.to_dict() | paths, answer.yes

    return by_stage(record, masses, judged)


def give_stiffness(
    record: "Prototype",
    end_stiffness: float,
    masses: tuple[float, float],
    out: Path | None,
    minutes: float | None,
    **asked: Any,
) -> CommandResult:
    """Design, prove, say and write; what else is asked is as `beamdesign.stiffness` takes it.

    The rigs that the law has to suit are drawn from the tolerances.

    Raises:
        InputError: for a stiffness that is none, effects, or no controller to keep.
    """
    from beamdesign.quantities import quantity
    from beamdesign.records import to_toml
    from beamdesign.synthesis.design_run import CERTIFICATE_NAME
    from beamdesign.synthesis.end_stiffness import CONTACT_NAME, in_words, softest_N_per_m
    from beamdesign.synthesis.stiffness_search import drawn_in_words, drawn_rigs

    with in_time(minutes, "2 to 5 min") as limit, progress("end stiffness") as update:
        found = beamdesign.stiffness(record, end_stiffness, masses, progress=update, **asked)
    best = found.best
    if best is None or found.prototype is None or found.certificate is None:
        echo(found.reason)
        return CommandResult(found.to_dict() | limit, yes=False)
    assert best.law is not None  # it was searched
    softest = softest_N_per_m(record, best.law.servo, best.law.force_filter_Hz, masses)
    rows = [
        *best.law.servo.summary(),
        ("force filter", quantity(best.law.force_filter_Hz, "Hz")),
        *_kept(best),
        ("softest with this lag and filter, at either end of the payload", quantity(softest, "N/m")),
        ("stiffest, the servo alone", quantity(best.servo_N_per_m, "N/m")),
        *_proved_of(masses),
    ]
    echo_table(f"{record.name}: end stiffness {quantity(end_stiffness, 'N/m')}", ("figure", "value"), rows)
    if found.reason:
        echo(f"{found.reason}; the next best is given")
    echo(*in_words(best))
    echo_aside(record)
    others = drawn_rigs(found.prototype, masses, best.wall, RIGS)
    if others:
        echo(drawn_in_words(others))
    texts = {
        "prototype": ("prototype.toml", to_toml(found.prototype)),
        "certificate": (CERTIFICATE_NAME, found.certificate.text),
        "certificate_contact": (CONTACT_NAME, found.contact),
    }
    paths = {} if out is None else write_set(out, texts)
    return CommandResult(found.to_dict() | limit | {"drawn": others, **paths}, files=paths.values())


def _kept(found: "EndStiffness") -> list[tuple[str, Any]]:
    """Rows of what is proved of stiffness, command and sensitivity."""
    from beamdesign.quantities import at_least, quantity, stated_peak
    from beamdesign.synthesis.end_stiffness import SHARE

    return [
        ("static stiffness of the end", quantity(found.static_N_per_m, "N/m")),
        (f"apparent stiffness within {SHARE:.0%} of it", f"up to {at_least(found.band_Hz, 'Hz')}"),
        ("free end follows its command, 0.707 or more", f"up to {at_least(found.command_Hz, 'Hz')}"),
        ("command followed at rest, share of it", found.command_at_rest),
        ("guaranteed peak sensitivity", stated_peak(found.peak_sensitivity)),
    ]


def _proved_of(masses_kg: tuple[float, float]) -> list[tuple[str, str]]:
    """Rows of the payloads and rigs of which it is proved."""
    from beamdesign.quantities import mass_range_text, rigs_in_words

    return [("for every outer end mass", mass_range_text(masses_kg)), ("of", rigs_in_words(0.0))]
