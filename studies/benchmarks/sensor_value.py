"""What an added sensor buys a controller with an observer, and what a known payload, beside what no controller passes.

For the whole range of payloads and for each end of it alone, there is a design with the displacement alone, with the
inner tip's displacement, with the load pressure and with both. Every one is proved anew, then drawn. Those for one
payload are what sensing it could buy at most. Usage, from the root of the project:

    python studies/benchmarks/sensor_value.py studies/prototypes/structured.toml studies/sensor_value

draws the designs of the folder into studies/sensor_value.svg. With --tune they are tuned first, some ten minutes on an
idle core: each set of sensors starts from what the smaller ones reached, the first from the controller of the prototype
and from those given with --start, and with --kind lqg or hinf from a synthesis as well. A design in the folder that is
better stays.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from convex_limit import convex_limit
from fundamental_limits import PHASE_AT_HZ, Limits, fundamental_limits
from sensor_picture import NAMES, payload_text, plot_sensor_value, sensors_text
from sensor_rows import SETS, SensorRow, certified_row, sensor_rows

from beamdesign import Prototype, read_prototype, write_prototype
from beamdesign.plant.members import family
from beamdesign.report.canvas import new_figure, save
from beamdesign.synthesis.synthesis import sensed_model

LARGEST_INNER_KG = 6.0


def file_of(folder: Path, row: SensorRow) -> Path:
    """Where the design of a row is kept."""
    low, high = row.outer_end_mass_kg
    return folder / f"{low:g}_to_{high:g}_kg_{'_'.join(NAMES[name].replace(' ', '_') for name in row.sensors)}.toml"


def tuned(
    folder: Path, prototype: Prototype, masses: tuple[float, float], kind: str | None, starts: list[Prototype]
) -> None:
    """Tune all sets of sensors for one payload or range; a better design that is there already stays."""
    for row in sensor_rows(prototype, masses, kind, starts=starts):
        path = file_of(folder, row)
        if row.prototype is not None and not (path.exists() and kept(path).bandwidth_Hz >= row.bandwidth_Hz):
            write_prototype(row.prototype.but(name=path.stem.replace("_", " ")), path)
        print(f"tuned: {told(row)}", flush=True)


def kept(path: Path) -> SensorRow:
    """A design of the folder, proved."""
    return certified_row(read_prototype(path))


def told(row: SensorRow) -> str:
    """A row of the table."""
    inside = row.reason if row.prototype is None else f"{row.prototype.payload.inner_end_mass_kg:.3g} kg inside"
    names = f"{payload_text(row.outer_end_mass_kg):14} {sensors_text(row.sensors):36}"
    return f"{names} {row.bandwidth_Hz:6.2f} Hz  {inside}"


def bound_Hz(prototype: Prototype, masses: tuple[float, float]) -> float:
    """Bound of displacement feedback: the largest over masses inside, of the least over the payloads."""
    payloads = np.unique(np.linspace(*masses, 5)).tolist()
    inside = np.linspace(0.0, LARGEST_INNER_KG, 25)
    return max(fundamental_limits(prototype, payloads, float(inner)).bandwidth_Hz for inner in inside)


def any_order_Hz(prototype: Prototype, ranges: list[tuple[float, float]]) -> list[float]:
    """What displacement feedback of any order reaches on samples, each payload of a range known, from 15 to 60 Hz.

    It is the largest over masses inside, of the least over the payloads.
    """
    rig, inside = family(prototype, ranges[0][1]).rest.rig, (0.0, 1.0, 2.0, 4.0)
    payloads = [np.unique(np.linspace(*masses, 3)).tolist() for masses in ranges]
    reached = {
        (mass, inner): convex_limit(sensed_model(rig, mass, inner), prototype.goal, 15.0, 60.0).bandwidth_Hz
        for mass in {mass for some in payloads for mass in some}
        for inner in inside
    }
    return [max(min(reached[mass, inner] for mass in some) for inner in inside) for some in payloads]


def tell(limits: Limits) -> None:
    """Print what no controller passes, at the prototype's own mass inside."""
    for k, mass in enumerate(limits.outer_end_mass_kg):
        print(f"{mass:g} kg: Bode's integral {limits.bode_Hz[k]:.3g} Hz, effort {limits.effort_Hz[k]:.3g} Hz", end="")
        for frequency in (10.0, 16.0, 25.0):
            at = int(np.argmin(np.abs(limits.frequency_Hz - frequency)))
            held = "" if limits.force_N is None else f", rated current holds {limits.force_N[k, at]:.0f} N"
            moved = "" if limits.noise_m is None else f", noise moves {1e6 * limits.noise_m[k, at]:.2f} um RMS at least"
            print(f"; {frequency:g} Hz{held}{moved}", end="")
        print()
        if limits.mode_Hz and limits.mode_phase_deg and limits.mode_gain:
            print(
                f"  second mode at {limits.mode_Hz[k]:.0f} Hz: {limits.mode_phase_deg[k]:+.2f} degrees at"
                f" {PHASE_AT_HZ:g} Hz, {limits.mode_gain[k]:.2g} times the plant's gain at its peak"
            )


def main() -> None:
    """Print every row and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("prototype", type=Path)
    parser.add_argument("folder", type=Path, help="of the designs; the picture is FOLDER.svg")
    parser.add_argument("--tune", action="store_true", help="first tune the designs, or better ones")
    parser.add_argument("--start", type=Path, action="append", default=[], help="a prototype to start from as well")
    parser.add_argument("--kind", choices=("lqg", "hinf"), help="start from a synthesis as well")
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    prototype, starts = read_prototype(given.prototype), [read_prototype(path) for path in given.start]
    whole = prototype.payload.outer_end_mass_kg
    if whole is None:
        raise SystemExit("the prototype needs a payload range")
    payloads = list(dict.fromkeys([whole, (whole[0], whole[0]), (whole[1], whole[1])]))
    if given.tune:
        given.folder.mkdir(parents=True, exist_ok=True)
        with ProcessPoolExecutor(given.workers) as pool:
            jobs = [pool.submit(tuned, given.folder, prototype, payload, given.kind, starts) for payload in payloads]
            for job in jobs:
                job.result()
    wanted = [file_of(given.folder, SensorRow(one, payload, 0.0)) for payload in payloads for one in SETS]
    rows = [kept(path) for path in wanted if path.exists()]
    for row in rows:
        print(told(row))
    bounds = list(zip([bound_Hz(prototype, one) for one in payloads], any_order_Hz(prototype, payloads), strict=True))
    for payload, (bound, reached) in zip(payloads, bounds, strict=True):
        print(f"{payload_text(payload):14} no displacement feedback beyond {bound:.3g} Hz (Bode)", end="; ")
        print(f"any order, each payload known, on samples: {reached:.3g} Hz")
    limits = fundamental_limits(prototype, np.unique([*whole, sum(whole) / 2]).tolist())
    tell(limits)
    mode = {"second_beam_mode": {"frequency_Hz": 327.0}}
    tell(fundamental_limits(prototype.but(effects=prototype.effects | mode), list(dict.fromkeys(whole))))
    figure = plot_sensor_value(new_figure(190.0, 85.0), rows, bounds, limits)
    print(save(figure, given.folder, ("svg",))[0])


if __name__ == "__main__":
    main()
