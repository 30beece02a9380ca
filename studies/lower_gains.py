"""Draw what a loop that need not be stable at lower gains buys, over the number of sections of its law.

Usage, from the root of the project:

    python studies/lower_gains.py studies/prototypes/structured.toml studies/lower_gains.svg

Every bar is a law that is tuned anew and proved for exactly the figures of the prototype, over its payloads and within
its other limits but for that against the rig with its servo off. Takes some ten minutes.
"""

import argparse
from math import inf
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from tolerance_cost import reached

from beamdesign import read_prototype

SECTIONS = (1, 2, 3)
WAYS = {"stable at every lower gain": True, "not at every one": False}


def plot(figure: Figure, found: dict[str, list[float]], title: str) -> Figure:
    """Bars side by side for each number of sections."""
    axes = figure.subplots()
    width = 0.8 / len(found)
    for k, (words, values) in enumerate(found.items()):
        places = np.arange(len(values)) + (k - (len(found) - 1) / 2) * width
        bars = axes.bar(places, values, width, label=words, color=f"{0.45 + 0.35 * k:g}", edgecolor="black")
        axes.bar_label(bars, fmt="%.3g")
    axes.set_xticks(range(len(SECTIONS)), [f"{n} section{'s' * (n > 1)}" for n in SECTIONS])
    axes.set_ylabel("proved bandwidth, Hz")
    axes.set_title(title)
    axes.legend(loc="upper left")
    return figure


def main() -> None:
    """Print every bar and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("prototype", type=Path)
    parser.add_argument("picture", type=Path)
    given = parser.parse_args()
    prototype, found = read_prototype(given.prototype), dict[str, list[float]]()
    for words, lower_gains in WAYS.items():
        asked = prototype.but(goal=prototype.goal.but(lower_gains=lower_gains, peak_over_passive=inf))
        for sections in SECTIONS:
            found.setdefault(words, []).append(reached(asked, "structured", sections, 0.0))
            print(f"{words}, {sections}: {found[words][-1]:.4g} Hz", flush=True)
    low, high = prototype.payload.outer_end_mass_kg or (0.0, 0.0)
    title = f"{prototype.name}: for exactly its figures, {low:g} to {high:g} kg"
    plot(Figure(figsize=(6.5, 4.0), layout="constrained"), found, title).savefig(given.picture)


if __name__ == "__main__":
    main()
