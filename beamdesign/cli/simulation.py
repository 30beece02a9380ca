"""`beamdesign simulate`: time records of a prototype or a bench, with their pictures."""

from collections.abc import Sequence
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import beamdesign
from beamdesign.cli.command import CommandResult, command, toml_files
from beamdesign.cli.output import echo, echo_table, progress, spare
from beamdesign.files import fresh_folder, settled
from beamdesign.result import picked

if TYPE_CHECKING:
    from beamdesign.report.charts import Limits
    from beamdesign.scenario import Scenario
    from beamdesign.simulation import SimulatedRecord, Simulation


@command
def simulate(
    prototype: Path,
    scenario: Annotated[Path, typer.Option(autocompletion=toml_files)],
    out: Path,
    plots: Annotated[bool, typer.Option("--plots/--no-plots")] = True,
) -> CommandResult:
    """Simulate time records of a prototype.

    A twin beam moves with its controller in the loop, an actuator bench without. A scheduled controller is sampled,
    and estimates its payload, which may change during a record.

    A loop that diverges is an answer: it is told when and at what frequency, its record ends there, and the exit status
    is 1.

    Args:
        prototype: the prototype.toml to simulate, with the effects it names.
        scenario: what is done to it: a scenario file.
        out: folder for one CSV file and one picture per record, and records.html.
        plots: whether to draw the records.
    """
    from beamdesign.bench_prototype import BenchPrototype, read_any_prototype
    from beamdesign.scenario import files_of

    rig, plan = read_any_prototype(prototype), beamdesign.read_scenario(scenario)
    spare(files_of(plan), out, [f"{row.name}.csv" for row in plan.record])
    found = beamdesign.simulate(rig, plan)
    if isinstance(rig, BenchPrototype):
        peaks = [(one.name, *map(float, abs(one.samples[:, 2:]).max(axis=0))) for one in found.records]
        heads = ("record", *(f"peak {column}" for column in found.records[0].columns[2:]))
        echo_table(f"{rig.name}: {plan.name}", heads, peaks)
        limits: Limits = {}
    else:
        limits = _echo_loop(rig, plan, found)
    files = write_folder(rig, plan, found.records, out, limits if plots else None)
    each = [_fields(record, path) for record, path in zip(found.records, files["records"], strict=True)]
    return CommandResult({"stable": found.stable, "effects": list(rig.effects), **files, "each": each}, found.stable)


def _echo_loop(rig: "beamdesign.Prototype", plan: "Scenario", found: "Simulation") -> "Limits":
    """Tell how the records of a loop went; what its pictures show as limits."""
    from beamdesign.plant.assembly import effect_parameters_of
    from beamdesign.plant.effects import laws_of
    from beamdesign.structure.arm import arm_of, left_aside

    heads = ("record", "stable", "peak displacement_m", "oscillation_Hz")
    echo_table(f"{rig.name}: {plan.name}", heads, found.rows())
    if arm_of(rig).plane is None and (words := left_aside(rig)):
        echo(f"simulated with {words}, or state arm.plane to simulate that plane")
    for record, asked in zip(found.records, plan.record, strict=True):
        echo(*filter(None, (record.reason, record.uncertain)), before=f"{record.name}: ")
        if (law := asked.controller or rig.controller) is not None and law.schedule is not None:
            stages = " -> ".join(["1", *(str(stage) for _, stage in record.changes)])
            mass, std = (float(record.column(name)[-1]) for name in ("estimate_kg", "estimate_std_kg"))
            known = f"{mass:.3g} kg, give or take {std:.2g}" if isfinite(std) else "nothing"
            if law.schedule.estimator.largest_std_kg < std < inf:  # then it may be off by much more than that
                known = f"too little to act on ({known})"
            echo(f"{record.name}: stages {stages}; of the payload it knows {known}")
    limits = {"displacement_m": (plan.displacement_limit_m, "limit")}
    limits["load_pressure_Pa"] = rig.supply.pressure_Pa, "supply"
    for name, own in effect_parameters_of(rig).items():
        if name in laws_of("current_saturation"):
            limits["current_A"] = (own["limit_A"], "amplifier's limit")
    return limits


def _fields(record: Any, path: Path) -> dict[str, Any]:
    at = record.oscillation
    changes = {"changes": [{"at_s": when, "stage": stage} for when, stage in record.changes]}
    return {
        "record": path,
        **picked(record, "name stable reason diverged_at_s certain_until_s"),
        "oscillation_Hz": None if at is None else at.frequency_Hz,
        "oscillation_growth_per_s": None if at is None else at.growth_per_s,
        **(changes if "stage" in record.columns else {}),
    }


def write_folder(
    rig: Any, plan: Any, records: "Sequence[SimulatedRecord]", out: Path, limits: "Limits | None"
) -> dict[str, Any]:
    """Write records, and where limits are given their pictures and page, as one set; files for the answer."""
    from beamdesign.columns import write_tables

    with fresh_folder(out) as fresh:
        tables = {record.name: (record.columns, record.samples) for record in records}
        files: dict[str, Any] = {"records": write_tables(tables, fresh)}
        if limits is not None:
            from beamdesign.report.charts import write_record_page

            with progress("drawing"):
                page, figures = write_record_page(rig.name, plan.name, rig.effects, records, limits, fresh)
            files |= {"report": page, "figures": figures}
    files = settled(files, fresh, out)
    echo(f"records: {len(files['records'])} files in {out}")
    if limits is not None:
        echo(f"pictures: {files['report']}")
    return files
