"""`beamdesign front`: moving mass against guaranteed bandwidth against payload range, every point proved."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from beamdesign.cli.completion import toml_files
from beamdesign.cli.figures import figures_of
from beamdesign.cli.output import JsonOption, folder_to_write, progress, say, say_table, write_csv, write_json
from beamdesign.files import fresh_folder, settled

if TYPE_CHECKING:
    from beamdesign.design.codesign import Codesign


def _row(design: "Codesign") -> dict[str, Any]:
    point = design.point
    row: dict[str, Any] = {
        "bandwidth_asked_Hz": design.bandwidth_Hz,
        "outer_end_mass_low_kg": design.outer_end_mass_kg[0],
        "outer_end_mass_high_kg": design.outer_end_mass_kg[1],
        "proved": point is not None,
        "reason": design.reason,
    }
    if point is not None:
        row |= {
            "moving_mass_kg": point.moving_mass_kg,
            "beam_mass_kg": point.beam_mass_kg,
            "inner_end_mass_kg": point.inner_end_mass_kg,
            "bandwidth_Hz": point.proved.bandwidth_Hz,
            "peak_sensitivity": point.proved.peak_sensitivity,
            "outer_width_m": point.outer.width_m,
            "outer_wall_m": point.outer.wall_m,
            "inner_width_m": point.inner.width_m,
            "inner_wall_m": point.inner.wall_m,
            **{name: value for name, value in point.proved.controller.model_dump().items() if name != "kind"},
            "governing": point.governing,
        }
    return row


def front(
    study: Annotated[Path, typer.Argument(autocompletion=toml_files, help="The study file with the design problem.")],
    out: Annotated[
        Path, typer.Option(metavar="DIR", callback=folder_to_write, help="Folder for front.csv and the picture.")
    ],
    bandwidths_Hz: Annotated[str, typer.Option("--bandwidths-Hz", help="Bandwidths to guarantee.")] = "3,4,5,6,8",
    payloads_kg: Annotated[
        str | None, typer.Option("--payloads-kg", help="Upper ends of the payload range; else the study's.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Draw moving mass against bandwidth and payload range.

    Every point is a proved design; points that failed stay in the table with their reason. Exit
    status 1 if there is no proved point at all.
    """
    from beamdesign.design.front import pareto_front
    from beamdesign.problem import read_problem
    from beamdesign.quantities import Bandwidth, Mass
    from beamdesign.report.canvas import new_figure, save
    from beamdesign.report.trade import plot_front

    problem = read_problem(study)
    masses = problem.payload.outer_end_mass_kg
    assert masses is not None  # validated
    expected = "positive figures separated by commas, such as 3,5,8"
    bandwidths = figures_of("--bandwidths-Hz", bandwidths_Hz, Bandwidth, expected)
    ends: Sequence[float] = [masses[1]]
    if payloads_kg is not None:
        ends = figures_of("--payloads-kg", payloads_kg, Mass, expected)
    with progress("front") as update:
        found = pareto_front(problem, bandwidths, [(min(masses[0], end), end) for end in ends], update)
    rows = [_row(design) for design in found.designs]
    figure = new_figure()
    plot_front(figure.add_subplot(), found)
    with fresh_folder(out) as fresh:
        write_csv(fresh / "front.csv", rows)
        pictures = save(figure, fresh / "front")
    say_table(
        f"{problem.name}: lightest proved designs",
        ("bandwidth, Hz", "payload to, kg", "moving mass, kg", "inner end mass, kg", "reason"),
        [
            (
                row["bandwidth_asked_Hz"],
                row["outer_end_mass_high_kg"],
                row.get("moving_mass_kg", "-"),
                row.get("inner_end_mass_kg", "-"),
                row["reason"],
            )
            for row in rows
        ],
    )
    for path in (out / "front.csv", *settled(pictures, fresh, out)):
        say(str(path))
    write_json(json, {"points": rows, "efficient": [_row(design) for design in found.efficient]})
    if not found.proved:
        raise typer.Exit(1)
