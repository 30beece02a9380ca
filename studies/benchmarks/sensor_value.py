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
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from convex_limit import convex_limit
from fundamental_limits import PHASE_AT_HZ, Limits, fundamental_limits
from matplotlib.figure import Figure

from beamdesign import Prototype, certify, read_prototype, write_prototype
from beamdesign.controllers import SENSED, Sensed
from beamdesign.plant.members import family
from beamdesign.proofs.certificate import Asked, goal_claims
from beamdesign.report.canvas import new_figure, save
from beamdesign.synthesis.law_design import Proved
from beamdesign.synthesis.law_task import Search
from beamdesign.synthesis.synthesis import sensed_model
from beamdesign.synthesis.weight_search import ADDED_SENSORS_EFFORT, EFFORT, search_observer

LARGEST_INNER_KG = 6.0
SETS: tuple[tuple[Sensed, ...], ...] = (SENSED[:1], SENSED[:2], (SENSED[0], SENSED[2]), SENSED)
"""The displacement alone, with the inner tip's displacement, with the load pressure, with both."""
NAMES = {
    "displacement_m": "displacement",
    "inner_displacement_m": "inner tip",
    "load_pressure_Pa": "pressure",
}
_GREYS = ("0.2", "0.55", "0.8")


@dataclass(frozen=True)
class SensorRow:
    """What one set of sensors reaches.

    Attributes:
        sensors: what the controller reads.
        outer_end_mass_kg: range of the payload.
        bandwidth_Hz: proved, within all limits of the goal; 0 where nothing was.
        prototype: with the controller; None where nothing was proved.
        reason: why not, empty where it was.
    """

    sensors: tuple[Sensed, ...]
    outer_end_mass_kg: tuple[float, float]
    bandwidth_Hz: float
    prototype: Prototype | None = None
    reason: str = ""


def certified_row(prototype: Prototype) -> SensorRow:
    """The row of a prototype with an observer, whose limits and bandwidth are proved here.

    Raises:
        ValueError: for a prototype without an observer, or without a range of payloads.
    """
    law, masses = prototype.controller, prototype.payload.outer_end_mass_kg
    if law is None or masses is None:
        raise ValueError(f"{prototype.name} has no controller, or no payload range")
    limits = (Asked("peak_sensitivity", prototype.goal.peak_sensitivity), *goal_claims(prototype.goal))
    found = certify(prototype, *masses, claims=limits)
    if not found.holds or found.guaranteed is None:
        return SensorRow(law.senses, masses, 0.0, None, found.reason)
    return SensorRow(law.senses, masses, found.guaranteed.bandwidth_Hz, prototype)


def sensor_rows(
    prototype: Prototype,
    outer_end_mass_kg: tuple[float, float],
    kind: str | None = None,
    sets: Sequence[tuple[Sensed, ...]] = SETS,
    largest_inner_end_mass_kg: float = 6.0,
    told: Callable[[float, str], None] = lambda share, text: None,
    starts: Sequence[Prototype] = (),
) -> Iterator[SensorRow]:
    """Tune for each set of sensors in turn, from what the smaller sets reached.

    Args:
        prototype: the rig; its controller, where it is structured or an observer, is a start.
        outer_end_mass_kg: range of the guarantee.
        kind: of synthesis, to start from that as well; None for the starts alone.
        sets: of sensors, each after those that it contains.
        largest_inner_end_mass_kg: kg.
        told: the share done and what is being done, for each set anew.
        starts: prototypes whose controllers are further starts.
    """
    members = family(prototype, outer_end_mass_kg[1]).members
    reached: list[Proved] = []
    own = [(law, one.payload.inner_end_mass_kg) for one in (prototype, *starts) if (law := one.controller) is not None]
    for sensors in sets:
        grown = [
            (proved.controller, proved.inner_end_mass_kg)
            for proved in sorted(reached, key=lambda proved: -proved.bandwidth_Hz)
            if set(proved.controller.senses) <= set(sensors)
        ]
        first = [(one, inner) for one, inner in own if set(one.senses) == set(sensors)]
        inside, effort = (0.0, largest_inner_end_mass_kg), EFFORT if len(sensors) == 1 else ADDED_SENSORS_EFFORT
        task = Search(members, prototype.goal, outer_end_mass_kg, inside, tuple(sensors), effort=effort)
        found = search_observer(task, kind, [*grown[:2], *first], told)
        if found.proved is None:
            yield SensorRow(sensors, outer_end_mass_kg, 0.0, None, found.reason)
            continue
        reached.append(found.proved)
        tuned = prototype.with_law(found.proved.controller, outer_end_mass_kg, found.proved.inner_end_mass_kg)
        yield SensorRow(sensors, outer_end_mass_kg, found.proved.bandwidth_Hz, tuned)


def sensors_text(sensors: Sequence[str]) -> str:
    """The sensors of a row, the displacement in front of the added ones."""
    return " + ".join(NAMES[name] for name in sensors)


def payload_text(masses_kg: tuple[float, float]) -> str:
    """A payload that is known, or the range of one that is not."""
    low, high = masses_kg
    return f"{low:g} kg, known" if low == high else f"{low:g} to {high:g} kg"


def plot_sensor_value(
    figure: Figure, rows: Sequence[SensorRow], bounds_Hz: Sequence[tuple[float, float]], limits: Limits
) -> Figure:
    """Draw bandwidths by sensors and payload, and the force that the rated current holds.

    Args:
        figure: drawn on.
        rows: payload by payload, each with the same sets of sensors in the same order.
        bounds_Hz: of displacement feedback for each payload: Bode's, and what any order reaches on samples.
        limits: whose force is drawn.
    """
    bars, force = figure.subplots(1, 2, width_ratios=(1.7, 1.0))
    payloads = list(dict.fromkeys(row.outer_end_mass_kg for row in rows))
    sets = list(dict.fromkeys(row.sensors for row in rows))
    width = 0.8 / len(payloads)
    for k, (payload, bound, grey) in enumerate(zip(payloads, bounds_Hz, _GREYS, strict=False)):
        own = [row for row in rows if row.outer_end_mass_kg == payload]
        places = [sets.index(row.sensors) + (k - (len(payloads) - 1) / 2) * width for row in own]
        drawn = bars.bar(places, [row.bandwidth_Hz for row in own], width, color=grey, label=payload_text(payload))
        # Within the bars, where no bound's line runs through a figure.
        bars.bar_label(drawn, fmt="%.1f", fontsize=7, label_type="center", color="white" if k == 0 else "black")
        left = places[0] - width / 2
        for height, style in zip(bound, ("-", ":"), strict=True):
            bars.plot([left, left + width], [height, height], color="black", linestyle=style, linewidth=2.0)
    bars.plot([], [], color="black", linewidth=2.0, label="Bode's bound, displacement alone")
    bars.plot([], [], color="black", linestyle=":", linewidth=2.0, label="any order, on samples, payload known")
    bars.set_xticks(range(len(sets)), [sensors_text(one).replace(" + ", "\n+ ") for one in sets], fontsize=7)
    bars.set_ylabel("bandwidth, Hz; bars are proved")
    bars.set_ylim(0, 1.35 * max(*(bound[0] for bound in bounds_Hz), *(row.bandwidth_Hz for row in rows)))
    bars.legend(fontsize=7, loc="upper right", ncols=2)
    if limits.force_N is not None:
        shown = np.where(np.isfinite(limits.force_N), limits.force_N, np.nan)
        for mass, line, style in zip(limits.outer_end_mass_kg, shown, ("-", "--", ":"), strict=False):
            force.loglog(limits.frequency_Hz, line, color="black", linestyle=style, label=f"{mass:g} kg")
        force.axhline(limits.stall_N, color="0.45", linewidth=0.9, label="stall")
        force.set_xlabel("frequency, Hz")
        force.set_ylabel("force that rated current holds, N")
        force.set_xlim(1.0, 100.0)
        force.set_ylim(10.0, 1e5)
        force.grid(True, color="0.85")
        force.legend(fontsize=7)
    return figure


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
