"""`beamdesign run`, `size`, `codesign`, `front` and `remedies`: from a design problem to designs that are proved."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import beamdesign
from beamdesign.cli.command import CommandResult, Figure, command, figures_of, in_time, mass_range, write_drawn
from beamdesign.cli.output import default_folder, echo, echo_table, progress, refuse, spare
from beamdesign.cli.study import echo_checks
from beamdesign.files import write_set
from beamdesign.result import picked
from beamdesign.synthesis import SIGMAS
from beamdesign.time_limit import share

_DESIGNING = 0.85
"""Share of the time that goes into the design of `run`; the rest is for its page."""

if TYPE_CHECKING:
    from beamdesign.synthesis.codesign import Codesign
    from beamdesign.synthesis.design_run import DesignRun


@command
def run(
    study: Path,
    out: Path,
    outer_end_mass: str | None = None,
    sigmas: float = SIGMAS,
    nominal: bool = False,
    minutes: float | None = None,
) -> CommandResult:
    """Carry a study to a certified prototype.

    Sections are sized, controller and inner end mass tuned, and the guarantee proved; with the prototype come its
    certificate, a report and a specification. Exit status 1 if there is no design, or if its actuator or its sections
    do not hold load and weight, or its bandwidth is of no use, with the reason and what to change.

    Args:
        study: the study file, such as studies/prototype.toml.
        out: folder for the results; made if need be.
        outer_end_mass: range of mass on the outer tip, kg; else the study's.
    """
    from beamdesign.build.result_folder import write_result_folder
    from beamdesign.quantities import further_rows, guaranteed_rows, rigs_in_words, tube_text

    problem, within = _read(study, sigmas, nominal)
    masses = mass_range(outer_end_mass, problem.payload.outer_end_mass_kg, study)
    spare([study], out, ["prototype.toml"])
    with in_time(minutes, "10 to 60 s for a lag, minutes for other kinds") as limit, progress("designing") as update:
        with share(_DESIGNING):
            result = beamdesign.run(problem, update, within, outer_end_mass_kg=masses)
        if result.prototype is not None:
            update(0.95, "drawing the report")
            folder = write_result_folder(result, out)
    held = result.holding
    holding = {"holding": None if held is None else held.to_dict()}
    if result.prototype is None:
        return _no_design(result, "prototype certificate mass_kg report", "reason change", holding | limit)
    payload, end, reached = result.prototype.payload, result.suffix.replace(".", "_"), result.guarantees
    nonlinear = [] if result.certificate is None else [row.to_dict() for row in result.certificate.nonlinear]
    moving, proved = result.sizing.beam_mass_kg + payload.inner_end_mass_kg, result.proved
    each = [law.certificate.nonlinear if law.certificate else () for law in result.laws or (result,)]
    at_rest = all(any(row.rests for row in of_law) for of_law in each)
    rests = "comes to rest, of exactly these figures" if at_rest else "not proved to come to rest"
    rows = [
        ("outer beam", tube_text(result.sizing.outer)),
        ("inner beam", tube_text(result.sizing.inner)),
        ("mass of both beams and inner end mass", f"{moving:.3f} kg"),
        ("governing check", result.sizing.governing),
        *(row for one in reached for row in guaranteed_rows(one, one.outer_end_mass_kg)),
        *(row for one in proved for row in further_rows(one)),
        *(() if all(one["comes_to_rest"] for one in proved) else [("while the law's current saturates", rests)]),
        *(() if held is None else held.rows()),
    ]
    echo_table(f"{problem.name}: designed and certified for {rigs_in_words(reached[0].sigmas)}", ("", ""), rows)
    if held is not None and held.caution:
        echo(f"caution: it takes {held.caution}")
    fields = {
        "prototype": folder["prototype"],
        "certificate": folder[f"certificate{end}"],
        "mass_kg": moving,
        "beam_mass_kg": result.sizing.beam_mass_kg,
        "inner_end_mass_kg": payload.inner_end_mass_kg,
        "report": folder[f"report{end}"],
        "specification": folder[f"specification{end}"],
        "guaranteed": reached[0].model_dump() | proved[0],
        "nonlinear": nonlinear,
    }
    stages = {"stages": [one.model_dump() for one in reached]} if result.laws else {}
    return CommandResult(fields | holding | stages | limit, files=folder.values())


def _read(study: Path, sigmas: float, nominal: bool, free: bool = False) -> tuple["beamdesign.DesignProblem", float]:
    """The study, with a word on what of it is taken otherwise than stated, and the standard deviations that count.

    Sections of free sizes are sought whatever it says where `free` is set.
    """
    from beamdesign.parameters import stated_or_typical

    problem = beamdesign.read_problem(study)
    within = 0.0 if nominal else sigmas
    if within and (words := stated_or_typical(problem.tolerance, type(problem.actuator))[1]):
        echo(words)
    if inside := problem.payload.inner_end_mass_kg:
        found = "the mass inside is found with the controller, up to controller.largest_inner_end_mass_kg"
        echo(f"payload.inner_end_mass_kg = {inside:g} is not taken: {found}")
    choose = problem.sections.choose
    if free and choose != "free" and "choose" in problem.sections.model_fields_set:
        echo(f"sections.choose = {choose!r} is not taken: sections are sought in free sizes")
    return problem, within


def _no_design(found: "DesignRun | Codesign", absent: str, stated: str, more: dict[str, Any]) -> CommandResult:
    """Say why there is no design, and what to change so that there is one; `absent` names fields that are null."""
    echo(f"no design: {found.reason}")
    echo(*found.change, before="  change: ")
    return CommandResult(dict.fromkeys(absent.split()) | picked(found, stated) | more, yes=False)


DEFAULT_TIP_FORCE_N = 2000.0
_STUDY_TABLES = {"load", "sections", "clearance", "safety"}


@command
def size(
    study: Annotated[Path, typer.Argument(metavar="STUDY-OR-PROTOTYPE")],
    tip_force_N: Annotated[float | None, Figure("Force")] = None,
) -> CommandResult:
    """Find the lightest tubes for a study, or check a rig's.

    For a study, the pair of least mass that passes every structural check; for a prototype, its own sections checked.
    Exit status 1 if no pair fits, or if a section fails a check; the reason says which requirement to relax.

    Args:
        study: a study file or a prototype.toml.
        tip_force_N: load to check a prototype for; else its largest force, or 2000 where it states none.
    """
    from beamdesign.records import read_table

    if not read_table(study).keys() & _STUDY_TABLES:
        return _checked(study, tip_force_N)

    from beamdesign.sweep.answers import check_fields

    problem = beamdesign.read_problem(study)
    if tip_force_N is not None:
        refuse("--tip-force-N", (f"{tip_force_N:g}", f"{study} states its own load; change it there"))
    with progress("sizing") as update:
        found = beamdesign.size(problem, update)
    echo(f"{problem.name}: {'' if found.feasible else 'NOT FEASIBLE: '}{found.reason}")
    tables = {name: getattr(problem, name) for name in ("sections", "clearance", "safety")}
    assumed = {f"{name}.{key}": v for name, of in tables.items() for key, v in of if key not in of.model_fields_set}
    if usual := [f"{key} = {value!r}" for key, value in assumed.items() if value is not None]:
        echo(f"taken where the study says nothing: {', '.join(usual)}")
    echo_table("pairs of tubes", ("pair", "outer, mm", "inner, mm", "beam mass, kg", "checks"), found.rows())
    if found.price_of_rounding_kg is not None:
        echo(f"price of rounding to stock sizes: {found.price_of_rounding_kg:.3g} kg")
    echo_checks(f"checks of the {'chosen' if found.feasible else 'nearest'} pair", map(check_fields, found.checks))
    if found.free:
        free = found.free
        echo(f"free sizes: KKT residual {free.kkt_residual:.1e}; active: {'; '.join(free.active)}")
        prices = [(name, price) for name, price in free.shadow_prices.items() if price]
        echo_table("shadow prices: what the least mass gains per unit of each requirement", ("per unit", "kg"), prices)
    if found.feasible:
        _echo_weight(problem.prototype(found.outer, found.inner), problem.load.tip_force_N, "load.tip_force_N")
    return CommandResult(found.to_dict(), found.feasible)


def _echo_weight(rig: "beamdesign.Prototype", load_N: float, key: str) -> None:
    """The weight that no check of sections counts, and that it is to be no more than the load."""
    from beamdesign.plant.members import weight_N
    from beamdesign.quantities import at_most

    weight = weight_N(rig, (rig.payload.outer_end_mass_kg or (0.0, 0.0))[1])
    words = f"not counted in these checks: {at_most(weight, 'N')} of weight of the largest payload and the link, level"
    more = f"; it is more than the load of {load_N:g} N, which is to be no less ({key}), as `beamdesign run` asks"
    echo(words + more * (weight > load_N))


def _checked(path: Path, tip_force_N: float | None) -> CommandResult:
    from beamdesign.sweep.answers import check_fields
    from beamdesign.synthesis.sizing import check_prototype, problem_of

    prototype = beamdesign.read_prototype(path)
    stated, force, said = prototype.payload.largest_force_N, tip_force_N, "--tip-force-N"
    if force is None:
        force, said = (stated, "payload.largest_force_N") if stated else (DEFAULT_TIP_FORCE_N, "default")
    pair = check_prototype(prototype, force, str(path))
    asked = problem_of(prototype, force, str(path))
    whose = "those of its study" if prototype.sized_for else "the usual ones, as it states none under [sized_for]"
    echo(
        f"{prototype.name}: sections checked for a tip force of {force:g} N ({said}), with safety factors "
        f"({asked.safety.strength:g} strength, {asked.safety.local_buckling:g} local buckling) and gaps "
        f"({1e3 * asked.clearance.assembly_m:g} mm at assembly, {1e3 * asked.clearance.under_load_m:g} mm under load) "
        f"and sizes (walls of {1e3 * asked.sections.least_wall_m:g} mm or more, at most "
        f"{1e3 * asked.sections.largest_width_m:g} mm wide) that are {whose}"
    )
    echo_checks("checks", map(check_fields, pair.checks))
    echo(f"both beams weigh {pair.beam_mass_kg:.4g} kg; governed by {pair.governing}")
    if not pair.feasible:
        echo(f"fails: {'; '.join(check.name for check in pair.failing)}")
    _echo_weight(prototype, force, said)
    assumed = {
        "load": {"tip_force_N": force},
        "clearance": asked.clearance.model_dump(),
        "safety": asked.safety.model_dump(),
        "sections": asked.sections.model_dump(exclude={"choose"}),
    }
    return CommandResult(pair.to_dict() | picked(pair, "governing feasible") | {"assumed": assumed}, pair.feasible)


@command
def codesign(
    study: Path,
    bandwidth_Hz: Annotated[float, Figure("Bandwidth")],
    outer_end_mass: str | None = None,
    out: Path | None = None,
    sigmas: float = SIGMAS,
    nominal: bool = False,
    minutes: float | None = None,
) -> CommandResult:
    """Find the lightest link that guarantees a bandwidth.

    Both sections, the inner end mass and the controller are chosen together; the moving mass counts both beams over
    their full length and the inner end mass. The result is proved for every mass of the payload range, not sampled.
    Exit status 1 if no design can be proved, or if load and weight are not held, with what to change.

    Args:
        study: the study file with the design problem.
        bandwidth_Hz: bandwidth to guarantee, Hz.
        outer_end_mass: range of mass on the outer tip, kg; else the study's.
        out: folder for prototype.toml and certificate.toml; else STEM-codesign.
    """
    from beamdesign.quantities import further_rows, guaranteed_rows, rigs_in_words, tube_text
    from beamdesign.records import to_toml
    from beamdesign.synthesis.design_run import CERTIFICATE_NAME, certificate_name, certified

    problem, within = _read(study, sigmas, nominal, free=True)
    masses = mass_range(outer_end_mass, problem.payload.outer_end_mass_kg, study)
    folder = out or default_folder(f"{study.stem}-codesign")
    spare([study], folder, ["prototype.toml"])
    with in_time(minutes, "1 to 5 min") as limit, progress("co-design") as update:
        found = beamdesign.codesign(problem, masses, bandwidth_Hz, progress=update, sigmas=within)
    point = found.point
    if point is None:
        absent = "prototype moving_mass_kg beam_mass_kg inner_end_mass_kg guaranteed"
        return _no_design(found, absent, "reason change attempts", limit)
    certificate, guaranteed = certified(point.prototype, point.proved, masses)
    over_box = point.proved.over_box
    proved = point.proved.guaranteed(guaranteed, masses)
    texts = {"prototype": ("prototype.toml", to_toml(guaranteed)), "certificate": (CERTIFICATE_NAME, certificate.text)}
    if over_box is not None:
        texts["certificate_box"] = certificate_name(box=True), over_box.certificate
    paths = write_set(folder, texts, ("certificate.*.toml",))
    rows = [
        ("moving mass", f"{point.moving_mass_kg:.3f} kg"),
        ("of which both beams", f"{point.beam_mass_kg:.3f} kg"),
        ("of which inner end mass", f"{point.inner_end_mass_kg:.3f} kg"),
        ("outer beam", tube_text(point.outer)),
        ("inner beam", tube_text(point.inner)),
        *((name, str(value)) for name, value in point.proved.controller.model_dump().items()),
        ("governing structural check", point.governing),
        *guaranteed_rows(point.proved, masses),
        *further_rows(proved),
    ]
    title = f"{problem.name}: lightest design for {bandwidth_Hz:g} Hz, proved for {rigs_in_words(point.proved.sigmas)}"
    echo_table(title, ("figure", "value"), rows)
    if found.caution:
        echo(f"caution: it takes {found.caution}")
    return CommandResult(paths | found.to_dict() | {"guaranteed": proved} | limit, files=paths.values())


_REMEDY = ("remedy", "bandwidth_Hz", "added_mass_kg", "controllers", "reason")
_FRONT = ("bandwidth_asked_Hz", "outer_end_mass_high_kg", "moving_mass_kg", "inner_end_mass_kg", "reason")


@command
def front(
    study: Path,
    out: Path,
    bandwidths_Hz: str = "3,4,5,6,8",
    payloads_kg: str | None = None,
    sigmas: float = SIGMAS,
    nominal: bool = False,
    minutes: float | None = None,
) -> CommandResult:
    """Draw moving mass against bandwidth and payload range.

    Every point is a proved design; points that failed stay in the table with their reason. Exit
    status 1 if there is no proved point at all.

    Args:
        study: the study file with the design problem.
        out: folder for front.csv and the picture.
        bandwidths_Hz: bandwidths to guarantee.
        payloads_kg: upper ends of the payload range; else the study's.
    """
    from beamdesign.quantities import rigs_in_words
    from beamdesign.report.canvas import new_figure
    from beamdesign.report.charts import TradePoint, plot_trade

    problem, within = _read(study, sigmas, nominal, free=True)
    masses = problem.asked_kg()
    expected = "positive figures separated by commas, such as 3,5,8"
    bandwidths = figures_of("--bandwidths-Hz", bandwidths_Hz, "Bandwidth", expected)
    ends = (masses[1],) if payloads_kg is None else figures_of("--payloads-kg", payloads_kg, "Mass", expected)
    ranges = [(min(masses[0], end), end) for end in ends]
    count = len(ranges) * len(bandwidths)
    with in_time(minutes, f"{count:g} to {5 * count:g} min") as limit, progress("front") as update:
        found = beamdesign.front(problem, bandwidths, ranges, update, within)
    rows = [design.columns() | {"sigmas": within} for design in found.designs]
    figure, rigs = new_figure(), rigs_in_words(within)
    points = [TradePoint(*(row[key] for key in TradePoint._fields)) for row in rows if row["proved"]]
    axes = plot_trade(figure.add_subplot(), points, failed_Hz=[design.bandwidth_Hz for design in found.failed])
    axes.set_title(f"Lightest designs, x: none found;\nproved for {rigs}", fontsize=10)
    heads = ("bandwidth, Hz", "payload to, kg", "moving mass, kg", "inner end mass, kg", "reason")
    cells = [[row.get(name, "-") for name in _FRONT] for row in rows]
    echo_table(f"{problem.name}: lightest designs, proved for {rigs}", heads, cells)
    write_drawn(out, "front", figure, rows)
    return CommandResult(found.to_dict() | {"sigmas": within} | limit, found.yes)


@command
def remedies(
    study: Path,
    out: Path,
    outer_end_mass: str | None = None,
    added_mass_kg: Annotated[float, Figure("MassOrNone")] = 4.5,
    sigmas: float = SIGMAS,
    nominal: bool = False,
    minutes: float | None = None,
) -> CommandResult:
    """Compare the paper's four remedies for payload.

    They are a stiffer outer beam, a heavier or softer inner beam, more phase, and a lag scheduled on the
    payload. Each is optimised for the same payload range and limits, and proved in the same way; of the scheduled one
    each lag over its own part of the payloads while these stay, and no change between them. Exit status 1 if none of
    them is proved.

    Args:
        study: the study file; its given sections are the ones to remedy.
        out: folder for remedies.csv and the picture.
        outer_end_mass: range of mass on the outer tip, kg; else the study's.
        added_mass_kg: most moving mass that a remedy may add.
    """
    from beamdesign.quantities import rigs_in_words, stated_bandwidth
    from beamdesign.report.canvas import new_figure
    from beamdesign.report.charts import plot_remedies

    problem, within = _read(study, sigmas, nominal, free=True)
    if (kind := problem.controller.kind) != "lag":
        echo(f"controller.kind = {kind!r} is not taken: each remedy is that of a lag")
    masses = mass_range(outer_end_mass, problem.payload.outer_end_mass_kg, study)
    with in_time(minutes, "minutes to half an hour") as limit, progress("remedies") as update:
        found = beamdesign.remedies(problem, masses, added_mass_kg, update, within)
    rows = [one.to_dict() for one in found]
    shown = [row | {"bandwidth_Hz": stated_bandwidth(row["bandwidth_Hz"])} for row in rows]
    axes, rigs = plot_remedies((figure := new_figure(height_mm=80)).add_subplot(), found), rigs_in_words(within)
    axes.set_title(f"{axes.get_title()},\nfor {rigs}", fontsize=10)
    payloads = f"{masses[0]:g} to {masses[1]:g} kg at the tip"
    title = f"{problem.name}: what is proved with each remedy, {payloads}, for {rigs}"
    cells = [[row[name] for name in _REMEDY] for row in shown]
    echo_table(title, ("remedy", "bandwidth", "added mass, kg", "lag", "reason"), cells)
    for one in found:
        if len(one.parts_kg) > 1 and not one.reason:
            echo(f"{one.name}: each lag over its own part of the payloads, while these stay; no change between them")
    write_drawn(out, "remedies", figure, rows)
    fields = {"remedies": rows, "outer_end_mass_kg": masses, "added_mass_kg": added_mass_kg, "sigmas": within, **limit}
    return CommandResult(fields, yes=not all(one.reason for one in found))
