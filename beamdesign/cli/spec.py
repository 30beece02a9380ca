"""`beamdesign spec`: what a workshop and a controls engineer need to build a prototype and to accept it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from beamdesign.cli.command import Figure, Result, RigArgument, command, mass_range, out_folder, ready_to_run
from beamdesign.cli.output import RangeOption, default_folder, progress, say, say_table

if TYPE_CHECKING:
    from beamdesign.build.specification import Specification


@command
def spec(
    prototype: RigArgument,
    out: Annotated[Path | None, out_folder("Folder for the specification; else NAME.specification here.")] = None,
    outer_end_mass: RangeOption = None,
    sampling_rate_Hz: Annotated[
        float | None, Figure("Of the difference equation; else at least 40 times the crossover.", "SamplingRate")
    ] = None,
    load_N: Annotated[
        float | None, Figure("Load for the ratings; else the prototype's largest force or payload's weight.", "Force")
    ] = None,
    noise_share: Annotated[
        float, Figure("Share of the motion that the goal allows, which sensor noise may cause.", "Share")
    ] = 0.1,
) -> Result:
    """Specify what to build and how to accept it.

    Sections, drawing (DXF and SVG), ratings, sensor, the controller as a circuit and as code, each proved again as it
    is realised; tolerances that keep the proof; an acceptance test with limits, and the data set folder to fill in for
    `beamdesign gap diagnose`. Of a scheduled controller circuit, code and acceptance test of each law over its own
    payloads, and the rule by which they change. Exit status 1 if the loop is not stable over the range, with the
    reason.
    """
    record = ready_to_run(prototype)
    masses = mass_range(outer_end_mass, record.payload.outer_end_mass_kg or (0.0, 0.0), prototype)

    from beamdesign.build.folder import json_fields, write_specification
    from beamdesign.build.specification import specify

    folder = out or default_folder(f"{prototype.resolve().stem}.specification")
    with progress("specifying") as update:
        found = specify(record, masses, sampling_rate_Hz, load_N, noise_share, progress=update)
        update(1.0, "writing")
        paths = write_specification(found, folder)
    answer = Result(json_fields(found) | {"files": paths}, not found.reason)
    if found.reason:
        say(f"{record.name}: {found.reason}")
        return answer
    _say(found)
    if record.payload.outer_end_mass_kg is None and outer_end_mass is None:
        say("the prototype states no payload: specified without any; --outer-end-mass LO:HI asks for a range")
    for path in paths.values():
        say(str(path))
    return answer


def _say(found: "Specification") -> None:
    from decimal import ROUND_CEILING, ROUND_FLOOR

    from beamdesign.build.words_build import masses_text, optional
    from beamdesign.quantity_text import at_least, at_most, decimal

    guaranteed, tolerances, sensor = found.guaranteed, found.tolerances, found.sensor
    assert guaranteed is not None
    assert sensor is not None
    rows = [
        ("for every outer end mass of", masses_text(found.masses_kg), ""),
        ("guaranteed bandwidth", at_least(guaranteed.bandwidth_Hz, "Hz"), "proved"),
        ("guaranteed peak sensitivity", at_most(guaranteed.peak_sensitivity, "1"), "proved"),
    ]
    for law in found.laws:
        name = f"stage {law.stage.number}: " if law.stage.number else ""
        for one in law.analogue:
            verdicts = [f"{100 * t.resistors:g}/{100 * t.capacitor:g} % {t.verdict}" for t in one.tolerances]
            words = f"{name}circuit of {one.circuit.resistors}, {one.circuit.capacitors}"
            rows.append((words, "; ".join(verdicts), ""))
        assert law.digital is not None
        late = law.digital.one_period_late
        basis = "not worked out" if late is None else {True: "proved", False: "refuted", None: "undecided"}[late.stable]
        rows.append((f"{name}code at, current one period late", f"{law.digital.equation.rate_Hz:g} Hz", basis))
    rows += [
        ("sensor bandwidth, at least", optional(sensor.stable_from_Hz, "Hz", ROUND_CEILING), "proved"),
        ("sensor resolution, at most", f"{decimal(1e6 * sensor.resolution_m)} µm", "computed"),
    ]
    if tolerances is None:
        rows.append(("tolerances", "none proved", found.tolerances_reason))
    else:
        tightest, share = tolerances.figures[0], decimal(100 * tolerances.equal, 3, ROUND_FLOOR)
        alone = f"± {decimal(100 * tightest.alone, 3, ROUND_FLOOR)} %"
        rows += [
            (f"tightest figure alone: {tightest.name}", alone, "proved"),
            ("all figures at once, equal shares", f"± {share} %", "proved"),
        ]
    say_table(f"{found.prototype.name}: specification", ("figure", "value", "basis"), rows)
