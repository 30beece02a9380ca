"""`beamdesign tune --controller scheduled`: a law for each part of the payload's range, and the switch between them."""

from dataclasses import replace
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from beamdesign.cli.output import progress, say, say_table, write_json
from beamdesign.files import write_set

if TYPE_CHECKING:
    from beamdesign.proof.lyapunov import Switching
    from beamdesign.prototype import Prototype


def tune_scheduled(
    record: "Prototype",
    masses: tuple[float, float],
    stages: int,
    largest_inner_end_mass_kg: float,
    out: Path | None,
    json: Path | None,
) -> None:
    """Tune the stages, prove each of them and the changes between them, and write what was found.

    Args:
        record: the rig; its goal holds for every stage.
        masses: range of outer end mass, kg.
        stages: how many.
        largest_inner_end_mass_kg: most mass that may be added inside.
        out: folder for the prototype and its certificates; none are written without.
        json: file for the answer.

    Raises:
        InputError: where so many stages do not fit, or for effects for which no linear loop stands.
        typer.Exit: with status 1 where a stage, or changes between stages, were not proved.
    """
    from beamdesign.design.schedule import tune_schedule
    from beamdesign.proof.lyapunov import describe, switching, switching_fields
    from beamdesign.proof.stage_family import stage_families
    from beamdesign.proof.switching_document import switching_document
    from beamdesign.records import InputError, to_toml
    from beamdesign.report.quantity import at_least, at_most, mass_range_text
    from beamdesign.study.design_run import certified

    problems = []
    if not masses[0] < masses[1]:
        problems.append(("--outer-end-mass", f"{masses[0]:g}:{masses[1]:g} holds one payload, which needs no stages"))
    if record.effects:
        names = ", ".join(record.effects)
        problems.append(("effects", f"changes of stage are proved without effects ({names}); take them out"))
    laws = () if record.controller is None else record.controller.laws
    if record.sensor.filter_Hz is None and any(law.sections for law, _ in laws):
        problems.append(
            ("sensor.filter_Hz", "missing; structured stages need a filter before them to hand over states")
        )
    if problems:
        raise InputError("tune --controller scheduled", problems)
    try:
        with progress("tuning stages") as update:
            found = tune_schedule(record, masses, stages, largest_inner_end_mass_kg, progress=update)
    except ValueError as error:
        raise InputError("--stages", [(str(stages), str(error))]) from error
    if found.rig is None:
        say(found.reason)
        write_json(json, {"controller": None, "reason": found.reason})
        raise typer.Exit(1)
    with progress("changes of stage") as update:
        proof = switching(stage_families(found.rig), *masses, update=update)
    rig = kept_apart(found.rig, proof)
    schedule = rig.schedule
    assert schedule is not None  # that was tuned
    proof = replace(proof, dwell_s=schedule.dwell_s)
    words = describe(proof)
    each = [
        certified(stage.prototype, proved, stage.outer_end_mass_kg, f"stage_{stage.number}.certificate.toml")
        for stage, proved in zip(rig.stages(masses), found.proved, strict=True)
    ]
    paths: dict[str, Path] = {}
    if out is not None:
        summary = f"{record.name}: changes between {stages} stages\n" + "\n".join(words)
        texts = {
            "prototype": ("prototype.toml", to_toml(rig)),
            "certificate_switching": ("stages.certificate.toml", switching_document(rig, proof, summary)),
        }
        for k, (certificate, _) in enumerate(each, start=1):
            texts[f"certificate_stage_{k}"] = (f"stage_{k}.certificate.toml", certificate.text)
        paths = write_set(out, texts, ("stage_*.certificate.toml",))
    rows: list[tuple[str, ...]] = [
        (
            stage,
            law,
            at_least(proved.bandwidth_Hz, "Hz"),
            at_most(proved.peak_sensitivity, "1"),
        )
        for (stage, law), proved in zip(schedule.summary(), found.proved, strict=True)
    ]
    inner = rig.payload.inner_end_mass_kg
    title = f"{record.name}: {stages} stages, {inner:g} kg inside, each stable for {mass_range_text(masses)} outside"
    say_table(title, ("payload", "law", "guaranteed bandwidth", "peak sensitivity"), rows)
    for line in words:
        say(f"  {line}")
    for kind, path in paths.items():
        say(f"{kind}: {path}")
    answer: dict[str, Any] = {
        "controller": schedule.model_dump(),
        "inner_end_mass_kg": inner,
        "guaranteed": [
            {
                "outer_end_mass_kg": list(stage.outer_end_mass_kg),
                "bandwidth_Hz": proved.bandwidth_Hz,
                "peak_sensitivity": proved.peak_sensitivity,
            }
            for stage, proved in zip(schedule.stage, found.proved, strict=True)
        ],
        "alone_bandwidth_Hz": found.alone_Hz,
        "switching": switching_fields(proof),
        **paths,
    }
    write_json(json, answer)
    if not proof.stable:
        raise typer.Exit(1)


def kept_apart(rig: "Prototype", found: "Switching") -> "Prototype":
    """The rig with changes of stage at least so far apart as is proved to be enough."""
    from beamdesign.proof.rational import nearest

    schedule = rig.schedule
    if schedule is None or found.stages.status != "proved" or found.stages.suffices(schedule.dwell_s):
        return rig
    needed = ceil(100 * nearest(found.stages.dwell_s)) / 100
    return rig.but(controller=schedule.but(dwell_s=needed))
