"""`beamdesign simulate`: time records of a prototype under a scenario."""

from pathlib import Path
from typing import Annotated, Any

import typer

from beamdesign.cli.output import JsonOption, say, say_table, write_json


def simulate(
    prototype: Annotated[Path, typer.Argument(help="The prototype.toml to simulate, with the effects it names.")],
    scenario: Annotated[Path, typer.Option(help="What is done to it: a scenario file.")],
    out: Annotated[Path, typer.Option(help="Folder for one CSV file per record.")],
    json: JsonOption = None,
) -> None:
    """Simulate time records of a prototype with its controller in the loop.

    A loop that diverges is an answer: it is told when and at what frequency, its record ends there, and the exit status
    is 1.
    """
    from beamdesign import simulate as engine
    from beamdesign.prototype import read_prototype
    from beamdesign.records import InputError
    from beamdesign.rig.effects import problems
    from beamdesign.scenario import read_scenario

    rig = read_prototype(prototype)
    wrong = problems(rig.effects)
    plan = read_scenario(scenario)
    if rig.controller is None and any(row.controller is None for row in plan.record):
        wrong.append(engine.without_controller())
    if wrong:
        raise InputError(prototype, wrong)
    found = engine.simulate(rig, plan)
    paths = engine.write_records(found, out)
    rows = []
    for record in found.records:
        at = record.oscillation
        peak = float(abs(record.column("displacement_m")).max())
        rows.append((record.name, "yes" if record.stable else "no", peak, "" if at is None else at.frequency_Hz))
    say_table(f"{rig.name}: {plan.name}", ("record", "stable", "peak displacement_m", "oscillation_Hz"), rows)
    for record in found.records:
        if not record.stable:
            say(f"{record.name}: {record.reason}")
    say(f"records: {len(paths)} files in {out}")
    write_json(
        json,
        {
            "stable": found.stable,
            "records": paths,
            "effects": list(rig.effects),
            "each": [_fields(record, path) for record, path in zip(found.records, paths, strict=True)],
        },
    )
    if not found.stable:
        raise typer.Exit(1)


def _fields(record: Any, path: Path) -> dict[str, Any]:
    at = record.oscillation
    return {
        "name": record.name,
        "record": path,
        "stable": record.stable,
        "reason": record.reason,
        "diverged_at_s": record.diverged_at_s,
        "oscillation_Hz": None if at is None else at.frequency_Hz,
        "oscillation_growth_per_s": None if at is None else at.growth_per_s,
    }
