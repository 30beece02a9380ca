"""`beamdesign simulate` for a prototype with a scheduled controller: records with stage and estimate."""

from pathlib import Path
from typing import Any

import typer

from beamdesign.cli.output import say_table, write_json
from beamdesign.cli.simulated_folder import write_folder


def simulate_scheduled_records(path: Path, scenario: Path, out: Path, plots: bool, json: Path | None) -> None:
    """Simulate the records of a scenario, each begun with the first stage.

    Law and estimator work at the schedule's period and hear the sensor with its noise where the prototype states it.

    Args:
        path: prototype with a scheduled controller.
        scenario: what is done to it.
        out: folder for the records.
        plots: whether to draw them.
        json: file for the answer.

    Raises:
        InputError: where prototype or scenario is wrong, or asks for what a scheduled controller has not.
        typer.Exit: with status 1 where a record diverged.
    """
    from beamdesign.records import InputError, Problem
    from beamdesign.rig.effects import problems
    from beamdesign.scenario import read_scenario
    from beamdesign.scheduling.record import read_scheduled
    from beamdesign.scheduling.scenario import course_of, unfit
    from beamdesign.scheduling.simulation import COLUMNS, simulate_scheduled

    rig, plan = read_scheduled(path), read_scenario(scenario)
    if wrong := [*problems(rig.prototype.effects), *unfit(plan, rig.schedule)]:
        raise InputError(path, [Problem(*problem) for problem in wrong])
    noise = rig.prototype.sensor.noise_V or 0.0
    found = {
        row.name: simulate_scheduled(rig, course_of(row, plan), noise_V=noise, seed=plan.measurement.seed + k)
        for k, row in enumerate(plan.record)
    }
    rows = []
    for name, record in found.items():
        last = {key: float(record.column(key)[-1]) for key in ("stage", "estimate_kg", "estimate_std_kg")}
        known = last["estimate_std_kg"] <= rig.schedule.estimator.largest_std_kg
        rows.append(
            (
                name,
                "no" if record.diverged else "yes",
                float(abs(record.column("displacement_m")).max()),
                " -> ".join(["1", *(str(stage) for _, stage in record.changes)]),
                f"{last['estimate_kg']:.3g}" if known else "none",
            )
        )
    head = ("record", "within bounds", "peak displacement_m", "stages", "estimate, kg")
    say_table(f"{rig.prototype.name}: {plan.name}", head, rows)
    pictures: list[Any] = []
    if plots:
        from beamdesign.report.record_plot import PlottedRecord

        pictures = [
            PlottedRecord(
                name,
                {key: record.column(key) for key in COLUMNS},
                "diverged" if record.diverged else "within bounds",
                not record.diverged,
            )
            for name, record in found.items()
        ]
    tables = {name: record.samples for name, record in found.items()}
    files = write_folder(rig.prototype, plan, tables, COLUMNS, pictures, out)
    each = [
        {
            "name": name,
            "record": file,
            "diverged": record.diverged,
            "changes": [{"at_s": at, "stage": stage} for at, stage in record.changes],
        }
        for (name, record), file in zip(found.items(), files["records"], strict=True)
    ]
    write_json(json, {"effects": list(rig.prototype.effects), **files, "each": each})
    if any(record.diverged for record in found.values()):
        raise typer.Exit(1)
