"""`beamdesign size`: the lightest sections, or a check of a rig's."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from beamdesign.cli.command import CommandResult, Figure, command, toml_files
from beamdesign.cli.output import echo, echo_table, progress, refuse
from beamdesign.json_text import picked

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
