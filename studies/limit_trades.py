"""Draw the proved bandwidth of a structured controller against each limit in turn.

Usage, from the root of the project:

    python studies/limit_trades.py studies/prototypes/structured_no_payload.toml studies/limit_trades.svg [--sections 1]

Every point is tuned and proved anew for exactly the figures stated; with two sections a point takes some ten seconds.
With --sigmas S it is tuned for every rig within so many standard deviations, which takes several times as long.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from limit_trades_picture import LIMITS, Limit, Trade, plot_limit_trades
from matplotlib.figure import Figure

from beamdesign import Prototype, read_prototype, tune

FACTORS = (0.5, 0.7, 1.0, 1.5, 2.5)
"""Of each limit's own value."""


def reached(prototype: Prototype, sections: int, sigmas: float) -> float | None:
    """Bandwidth that is proved of a prototype tuned over its payload, Hz; None where nothing is."""
    masses = prototype.payload.outer_end_mass_kg
    assert masses is not None
    best = tune(prototype, masses, "structured", sections=sections, sigmas=sigmas).best
    return None if best is None else best.bandwidth_Hz


def trade(
    prototype: Prototype, limit: Limit, at_hand: float | None, factors: Sequence[float], sections: int, sigmas: float
) -> Trade:
    """Tune at multiples of a limit's own value, at which the bandwidth is at hand."""
    own = limit.own(prototype)
    if own is None:
        raise SystemExit(f"the prototype needs a figure for: {limit.name}")
    values = tuple(float(f"{factor * own:.3g}") for factor in factors)
    found = []
    for factor, value in zip(factors, values, strict=True):
        best = at_hand if factor == 1 else reached(limit.at(prototype, value), sections, sigmas)
        found.append(best)
        print(f"{limit.name} {value:g}: {'nothing proved' if best is None else f'{best:.4g} Hz'}", flush=True)
    return Trade(limit, values, tuple(found))


def main() -> None:
    """Print every point and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("prototype", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--sections", type=int, default=1, choices=(1, 2, 3))
    parser.add_argument("--factors", type=float, nargs="+", default=FACTORS, help="of each limit's own value")
    parser.add_argument("--sigmas", type=float, default=0.0)
    given = parser.parse_args()
    prototype = read_prototype(given.prototype)
    if prototype.payload.outer_end_mass_kg is None:
        raise SystemExit("the prototype needs a payload range")
    own = reached(prototype, given.sections, given.sigmas)
    trades = [trade(prototype, limit, own, given.factors, given.sections, given.sigmas) for limit in LIMITS]
    low, high = prototype.payload.outer_end_mass_kg
    kept = f", every rig within {given.sigmas:g} standard deviations" if given.sigmas else ""
    law = f"Lag with {given.sections} section{'s' * (given.sections > 1)}"
    title = f"{law}, {low:g} to {high:g} kg{kept}; dashed: as it is"
    figure = Figure(figsize=(11.0, 3.4), layout="constrained")
    plot_limit_trades(figure, trades, prototype, title).savefig(given.picture)
    print(given.picture)


if __name__ == "__main__":
    main()
