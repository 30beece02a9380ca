"""Draw what each tolerance costs in bandwidth, and what a loop that is unstable at lower gains would buy.

Usage, from the root of the project:

    python studies/tolerance_cost.py studies/prototypes/paper_remedy.toml studies/tolerance_cost.svg

Every bar is a lag that is tuned anew and proved of every rig within two standard deviations of each figure, with one of
the tolerances taken away; a prototype that states none has typical ones. The two last bars are for exactly the figures
stated, stable at every lower gain and not. Each takes some twenty seconds; one whose proof comes to no end has no bar.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

from matplotlib.figure import Figure

from beamdesign import Prototype, read_prototype, tune
from beamdesign.parameters import stated_or_typical
from beamdesign.synthesis import SIGMAS
from beamdesign.synthesis.tuning import limited


def reached(prototype: Prototype, kind: str, sections: int, sigmas: float) -> float:
    """Bandwidth that is proved of a prototype tuned over its payload, Hz; zero where nothing is."""
    masses = prototype.asked_kg()
    found = tune(prototype.but(controller=None), masses, kind, sections=sections, sigmas=sigmas)
    return 0.0 if found.best is None else found.best.bandwidth_Hz


def bars(prototype: Prototype, kind: str, sections: int) -> Iterator[tuple[str, float]]:
    """What is varied, in words, and the bandwidth that is then proved, Hz."""
    whole = prototype.but(tolerance=stated_or_typical(prototype.tolerance, type(prototype.actuator))[0])
    yield "all tolerances", reached(whole, kind, sections, SIGMAS)
    for name, size in whole.tolerance.model_dump().items():
        if size and not (name == "sensor_filter" and whole.sensor.filter_Hz is None):
            exact = whole.but(tolerance=whole.tolerance.but(**{name: 0.0}))
            yield f"{name} (±{100 * size:g} %) exact", reached(exact, kind, sections, SIGMAS)
    yield "all exact", reached(whole, kind, sections, 0.0)
    unstable = whole.but(goal=whole.goal.but(lower_gains=False))
    yield "all exact, lower gains free", reached(unstable, kind, sections, 0.0)


def plot(figure: Figure, found: list[tuple[str, float]], title: str) -> Figure:
    """Bars one below the other, the first as a dashed line through all."""
    axes = figure.subplots()
    names, values = zip(*found, strict=True)
    places = range(len(found), 0, -1)
    axes.barh(places, values, color="0.75")
    axes.axvline(values[0], color="0.4", linestyle="--")
    for place, value in zip(places, values, strict=True):
        axes.text(value, place, f" {value:.3g}", va="center")
    axes.set_yticks(list(places), [name.replace("_", " ") for name in names])
    axes.set_xlabel("proved bandwidth, Hz")
    axes.set_title(title)
    axes.margins(x=0.1)
    return figure


def main() -> None:
    """Print every bar and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("prototype", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--controller", default="lag")
    parser.add_argument("--sections", type=int, default=1, choices=(1, 2, 3))
    given = parser.parse_args()
    prototype = read_prototype(given.prototype)
    if prototype.payload.outer_end_mass_kg is None:
        raise SystemExit("the prototype needs a payload range")
    prototype = limited(prototype, given.controller)
    found = []
    for words, bandwidth in bars(prototype, given.controller, given.sections):
        found.append((words, bandwidth))
        print(f"{words}: {bandwidth:.4g} Hz", flush=True)
    low, high = prototype.payload.outer_end_mass_kg
    rigs = f"every rig within\n{SIGMAS:g} standard deviations of each figure"
    title = f"{given.controller}, {low:g} to {high:g} kg: proved of {rigs}"
    plot(Figure(figsize=(7.5, 5.0), layout="constrained"), found, title).savefig(given.picture)
    print(given.picture)


if __name__ == "__main__":
    main()
