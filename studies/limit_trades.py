"""Draw the proved bandwidth of a structured controller against each limit in turn.

Usage, from the root of the project:

    python studies/limit_trades.py studies/prototypes/structured_no_payload.toml studies/limit_trades.svg [--sections 1]

Every point is tuned and proved anew; with two sections a point takes some ten seconds. With --robust SIGMAS it is tuned
for the worst rigs within the tolerances as well, which takes several times as long.
"""

import argparse
from pathlib import Path

from matplotlib.figure import Figure

from beamdesign.design.robust_tuning import tune_robust
from beamdesign.design.tuning import tune
from beamdesign.prototype import Prototype, read_prototype
from beamdesign.report.limit_trades import LIMITS, Limit, Trade, plot_limit_trades

FACTORS = (0.5, 0.7, 1.0, 1.5, 2.5)
"""Of each limit's own value."""


def trade(prototype: Prototype, limit: Limit, sections: int, sigmas: float = 0.0) -> Trade:
    """Tune at multiples of a limit's own value, over the prototype's payload."""
    own, masses = limit.own(prototype), prototype.payload.outer_end_mass_kg
    if own is None or masses is None:
        raise SystemExit(f"the prototype needs a payload range and a figure for: {limit.name}")
    values = tuple(float(f"{factor * own:.3g}") for factor in FACTORS)
    found = []
    for value in values:
        changed = limit.at(prototype, value)
        if sigmas > 0:
            best = tune_robust(changed, masses, sigmas, "structured", sections=sections).tuning.best
        else:
            best = tune(changed, masses, "structured", sections=sections).best
        found.append(None if best is None else best.bandwidth_Hz)
        print(
            f"{limit.name} {value:g}: {'nothing proved' if best is None else f'{best.bandwidth_Hz:.4g} Hz'}", flush=True
        )
    return Trade(limit, values, tuple(found))


def main() -> None:
    """Print every point and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("prototype", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--sections", type=int, default=1, choices=(1, 2, 3))
    parser.add_argument("--robust", type=float, default=0.0, metavar="SIGMAS")
    given = parser.parse_args()
    prototype = read_prototype(given.prototype)
    trades = [trade(prototype, limit, given.sections, given.robust) for limit in LIMITS]
    low, high = prototype.payload.outer_end_mass_kg or (0.0, 0.0)
    kept = f", worst rigs within {given.robust:g} standard deviations" if given.robust else ""
    law = f"Lag with {given.sections} section{'s' * (given.sections > 1)}"
    title = f"{law}, {low:g} to {high:g} kg{kept}; dashed: as it is"
    figure = Figure(figsize=(11.0, 3.4), layout="constrained")
    plot_limit_trades(figure, trades, prototype, title).savefig(given.picture)
    print(given.picture)


if __name__ == "__main__":
    main()
