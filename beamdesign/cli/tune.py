"""`beamdesign tune`: controller and inner end mass with the largest guaranteed bandwidth."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from beamdesign.cli.command import (
    CommandResult,
    Figure,
    MassRange,
    OutFolderOrNone,
    TomlFile,
    command,
    mass_range,
    of_all,
)
from beamdesign.cli.output import echo, echo_table, progress, refuse, write_certificate
from beamdesign.cli.stiffness import give_stiffness
from beamdesign.files import write_set
from beamdesign.json_text import picked

if TYPE_CHECKING:
    from beamdesign.controllers import Sensed
    from beamdesign.proofs.certificate import Asked, Certificate
    from beamdesign.prototype import Goal, InStage, Prototype
    from beamdesign.synthesis.rig_spread import RigSpread, Shape
    from beamdesign.synthesis.tuning import Tuning


KINDS = ("lag", "proportional", "structured", "lqg", "hinf", "scheduled", "compliance")
"""Of the package itself; a kind that is registered beside them is taken as well where it has seeds."""


@command
def tune(
    prototype: TomlFile,
    outer_end_mass: MassRange = None,
    controller: str = "lag",
    largest_inner_end_mass_kg: Annotated[float, Figure("MassOrNone")] = 6.0,
    peak_sensitivity: Annotated[float | None, Figure("PeakSensitivity")] = None,
    sections: Annotated[int, typer.Option(min=1, max=3)] = 3,
    stages: Annotated[int, typer.Option(min=2, max=12)] = 3,
    added_sensor: list[str] | None = None,
    loop_gain: Annotated[float | None, Figure("LoopGain", or_infinite=True)] = None,
    loop_gain_from_Hz: Annotated[float | None, Figure("Frequency")] = None,
    controller_effort_A_per_V: Annotated[float | None, Figure("LawGain", or_infinite=True)] = None,
    robust: Annotated[float, Figure("Sigmas", metavar="SIGMAS")] = 0.0,
    robust_box: bool = False,
    end_stiffness_N_per_m: Annotated[float | None, Figure("Stiffness")] = None,
    out: OutFolderOrNone = None,
) -> CommandResult:
    """Tune for the largest bandwidth over a payload range.

    Gain, break frequencies and inner end mass are chosen for the largest bandwidth that can be guaranteed: stability,
    peak sensitivity and compliance are proved for every mass of the range, in exact arithmetic, and for all linear
    members of a prototype with effects. A structured controller is a lag with second-order sections, within limits of
    loop gain and current that its valve sets; lqg and hinf are state feedback with an observer, synthesised by Riccati
    equations, reduced to order 8 and refined within the same limits, as is the prototype's own
    controller where it is structured or an observer. A scheduled one has a law for each part of the payloads, chosen by
    an estimate of the payload and stable whichever acts when: lags, or structured ones where the prototype's own
    controller is. With --robust the same is proved of the worst rigs that the tolerances allow, one by one. Exit
    status 1 if no design can be proved.

    Args:
        prototype: the prototype.toml to tune.
        outer_end_mass: range of mass on the outer tip, kg; else the prototype's.
        controller: kind of controller: lag, proportional, structured, lqg, hinf, scheduled or compliance.
        largest_inner_end_mass_kg: most mass that may be added inside.
        peak_sensitivity: limit of the peak sensitivity; else the prototype's goal.
        sections: second-order sections of a structured controller, behind its lag.
        stages: laws of a scheduled controller, each for a part of the payloads.
        added_sensor: what lqg and hinf read beside the displacement: inner_displacement_m, load_pressure_Pa;
            repeatable.
        loop_gain: limit of |L| from --loop-gain-from-Hz up; `inf` for none. Else the goal's, or 0.25 but for lags.
        loop_gain_from_Hz: from where on it holds; else the goal's, 250 Hz.
        controller_effort_A_per_V: limit of |C/(1+L)|; `inf` for none. Else the goal's, or 0.06 but for lags.
        robust: also guarantee it for the worst rigs so many standard deviations of [tolerance] off.
        robust_box: so many of every figure at once; else of all together.
        end_stiffness_N_per_m: of a compliant end; `beamdesign stiffness` has more options.
        out: folder for prototype.toml and certificate.toml; else neither is written.
    """
    from beamdesign.proofs.lyapunov import CHANGES_NAME, describe, stages_certificate, switching_fields
    from beamdesign.proofs.tolerance_box import between, in_words
    from beamdesign.prototype import read_prototype
    from beamdesign.records import to_toml
    from beamdesign.synthesis import tuning
    from beamdesign.synthesis.design_run import certified_laws
    from beamdesign.synthesis.rig_spread import rig_spread

    record = read_prototype(prototype)
    masses = mass_range(outer_end_mass, record.outer_end_mass_kg, prototype)
    known = dict.fromkeys((*KINDS, *tuning.tunable()))
    if controller not in known:
        refuse("--controller", (controller, f"expected one of {', '.join(known)}"))
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
        if controller != "compliance":
            reason = "is for --controller compliance"
            refuse("--end-stiffness-N-per-m", (f"{end_stiffness_N_per_m:g}", reason))
        if end_stiffness_N_per_m is None:
            refuse("--controller", ("compliance", "needs --end-stiffness-N-per-m"))
        return give_stiffness(record, end_stiffness_N_per_m, masses, out=out, spread=spread)
    with progress("tuning") as update:
        asked = (record, masses, controller, largest_inner_end_mass_kg, update, sections, sensors, spread, stages)
        found = tuning.tune(*asked)
    if found.reason:
        echo(found.reason)
        nothing = dict.fromkeys(("controller", "inner_end_mass_kg", "guaranteed"))
        return CommandResult(nothing | {"reason": found.reason}, yes=False)
    guaranteed, each = certified_laws(found)
    texts = {"prototype": ("prototype.toml", to_toml(guaranteed))}
    answers = []
    for stage, law, (certificate, _) in zip(found.stages, found.each, each, strict=True):
        end = stage.suffix.replace(".", "_")
        texts[f"certificate{end}"] = (f"certificate{stage.suffix}.toml", certificate.text)
        answers.append((_of_law(stage, law, certificate), True))
        if spread is not None:
            answers[-1][0]["robust"] = words_of_rigs(stage, law, shape, texts)
        if record.effects:
            verdict = between(guaranteed, *masses)
            if words := in_words(verdict):
                echo(f"  {words}")
            if verdict is not None and verdict.certificate:
                texts["certificate_between"] = ("certificate.between.toml", verdict.certificate)
    answer = of_all(guaranteed, answers) | {"controller": guaranteed.controller and guaranteed.controller.model_dump()}
    if (changes := found.switching) is not None:
        lines = describe(changes)
        for line in (*lines, *(["changes are proved of the nominal rig alone"] if spread is not None else [])):
            echo(f"  {line}")
        summary = "\n".join((f"{record.name}: changes between {len(found.laws)} stages", *lines))
        texts["certificate_switching"] = (CHANGES_NAME, stages_certificate(guaranteed, changes, summary))
        answer |= {"alone_bandwidth_Hz": found.alone_Hz, "switching": switching_fields(changes)}
    elif found.laws:
        echo("  changes between the laws are not covered by any proof: the prototype has effects")
    paths: dict[str, Path] = {} if out is None else write_set(out, texts, ("certificate.*.toml", CHANGES_NAME))
    return CommandResult(answer | paths, changes is None or bool(changes.stable), paths.values())


def _of_law(stage: "InStage", law: "Tuning", certificate: "Certificate") -> dict[str, Any]:
    """Say what was tuned and is guaranteed of one law over its payloads; the same for the JSON file."""
    from beamdesign.proofs.near_rest import holds_for
    from beamdesign.quantity_text import guaranteed_rows

    best, goal, masses = law.best, stage.prototype.goal, stage.outer_end_mass_kg
    assert best is not None
    rows = [
        *best.controller.summary(),
        ("inner_end_mass_kg", str(best.inner_end_mass_kg)),
        *guaranteed_rows(best, masses, _kept(goal)),
    ]
    echo_table(f"{stage.prototype.name}: tuned {best.controller.kind} controller", ("figure", "value"), rows)
    echo(f"proved {holds_for(stage.prototype)}; {law.certificates} stability certificates on the way")
    for line in certificate.scope:
        echo(f"  {line}")
    return {
        "controller": best.controller.model_dump(),
        "inner_end_mass_kg": best.inner_end_mass_kg,
        "guaranteed": {
            **picked(best, "bandwidth_Hz peak_sensitivity"),
            "outer_end_mass_kg": list(masses),
            **picked(goal, "loop_gain loop_gain_from_Hz controller_effort_A_per_V"),
            **picked(certificate, "method scope"),
        },
        "starts_bandwidth_Hz": law.starts,
        "stability_certificates": law.certificates,
    }


def _sensors(kind: str, added: list[str]) -> "tuple[Sensed, ...]":
    """What the controller reads, in the order of the record."""
    from beamdesign.controllers import SENSED

    if wrong := [name for name in added if name not in SENSED[1:]]:
        refuse("--added-sensor", *((name, f"expected one of {', '.join(SENSED[1:])}") for name in wrong))
    if added and kind not in ("lqg", "hinf"):
        refuse("--added-sensor", (", ".join(added), f"a {kind} controller reads the displacement alone"))
    return tuple(name for name in SENSED if name == SENSED[0] or name in added)


def _kept(goal: "Goal") -> list[tuple[str, str]]:
    """The limits of loop gain and effort that are proved to be kept."""
    rows = []
    if goal.loop_gain is not None:
        rows.append((f"guaranteed |L| from {goal.loop_gain_from_Hz:g} Hz up", f"at most {goal.loop_gain:g}"))
    if goal.controller_effort_A_per_V is not None:
        rows.append(("guaranteed |C/(1+L)|", f"at most {goal.controller_effort_A_per_V:g} A/V"))
    return rows


DRAWS = 32
"""Rigs that are drawn at random, each decided in exact arithmetic."""


def with_stated_tolerances(record: "Prototype") -> "Prototype":
    """The prototype as it is where it states tolerances, else with typical ones, and a word on it."""
    from beamdesign.diagnosis.examination.plausibility import with_tolerances

    found, cautions = with_tolerances(record)
    for caution in cautions:
        echo(caution.text)
    return found


_DRAWN = "drawn=count drawn_bandwidth_kept=bandwidth_kept drawn_all_kept=kept least_share_bandwidth_kept=least_share"


def words_of_rigs(
    stage: "InStage", law: "Tuning", shape: tuple[float, "Shape"], texts: dict[str, tuple[str, str]]
) -> dict[str, Any]:
    """Prove the worst rigs, draw others, say what they keep; what the JSON file says of it.

    Certificates are added to `texts`, name of the file and content by kind.
    """
    from beamdesign.synthesis.design_run import CONFIDENCE, draw_rigs, prove_rigs
    from beamdesign.synthesis.rig_spread import rig_spread

    best, masses, end = law.best, stage.outer_end_mass_kg, stage.suffix
    assert best is not None
    spread = rig_spread(stage.prototype, masses[1], *shape)
    factors = list(map(spread.factors, law.worst))
    certificates = prove_rigs(list(map(spread.rig, law.worst)), best, masses)
    if refuted := [certificate.reason for certificate in certificates if not certificate.holds]:
        raise AssertionError(f"a rig that was proved is refuted: {refuted[0]}")
    for k, certificate in enumerate(certificates, start=1):
        texts[f"certificate_rig_{k}{end.replace('.', '_')}"] = (f"certificate{end}.rig-{k}.toml", certificate.text)
    _echo_rigs(spread, factors)
    echo(f"proved: these {len(certificates)} rigs and the nominal one, each for every outer end mass")
    draws = draw_rigs(spread, best, masses, DRAWS)
    echo(
        f"sampled: {reach_in_words(spread)}; of {draws.count} rigs drawn from the tolerances {draws.bandwidth_kept}"
        f" keep the bandwidth (at least {100 * draws.least_share:.0f} % of all, at {100 * CONFIDENCE:.0f} %"
        f" confidence), {draws.kept} every limit; the draws are decided in exact arithmetic, the rigs between are not"
    )
    return {
        **picked(spread, "sigmas shape"),
        "deviations": dict(spread.deviations),
        "rigs": factors,
        **picked(draws, _DRAWN),
        "confidence": CONFIDENCE,
    }


def _echo_rigs(spread: "RigSpread", factors: Sequence[dict[str, float]]) -> None:
    """What the figures of each rig are off by."""
    names = [name for name in spread.deviations if any(one.get(name, 1.0) != 1.0 for one in factors)]
    rows = [(name, *(f"{100 * (one.get(name, 1.0) - 1):+.1f}" for one in factors)) for name in names]
    echo_table("worst rigs: figures off by, %", ("figure", *(str(k + 1) for k in range(len(factors)))), rows)


def certified_rigs(
    record: "Prototype",
    masses: tuple[float, float],
    asked: Sequence["Asked"],
    sigmas: float,
    shape: "Shape",
    path: Path,
) -> tuple[bool, dict[str, Any]]:
    """Certify the worst rigs of a prototype and say what each guarantees; whether all keep what was asked, and which.

    Certificates go beside that of the nominal rig.
    """
    from beamdesign.proofs.certifying import certify
    from beamdesign.quantity_text import stated_bandwidth, stated_peak
    from beamdesign.synthesis.design_run import worst_of
    from beamdesign.synthesis.rig_spread import rig_spread

    spread = rig_spread(with_stated_tolerances(record).but(guarantee=None), masses[1], sigmas, shape)
    worst = worst_of(spread, masses)
    factors = list(map(spread.factors, worst))
    _echo_rigs(spread, factors)
    every, rows = True, []
    for k, rig in enumerate(map(spread.rig, worst), start=1):
        certificate = certify(rig, *masses, asked)
        write_certificate(path.with_suffix(f".rig-{k}.toml"), certificate.text)
        every = every and certificate.holds
        cells = ("no", "", "")
        if (reached := certificate.guaranteed) is not None:
            cells = ("yes", stated_bandwidth(reached.bandwidth_Hz), stated_peak(reached.peak_sensitivity))
        rows.append((str(k), *cells, certificate.reason))
    echo_table("proved of each", ("rig", "stable", "bandwidth", "peak sensitivity", "refuted"), rows)
    echo(f"{reach_in_words(spread)}; the rigs between are not proved")
    return every, {"robust": {"sigmas": sigmas, "shape": shape, "rigs": factors, "holds": every}}


def reach_in_words(spread: "RigSpread") -> str:
    """How far the rigs are off that the design was tuned for."""
    which = "of a box of {:g} standard deviations of every figure"
    if spread.shape != "box":
        which = "{:g} standard deviations off in all"
    return f"the worst rigs {which.format(spread.sigmas)} were sought on samples"
