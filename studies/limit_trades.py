"""Draw the proved bandwidth of a structured controller against each limit in turn.

Usage, from the root of the project:

    python studies/limit_trades.py studies/prototypes/structured_no_payload.toml studies/limit_trades.svg [--sections 1]

Every point is tuned and proved anew for exactly the figures stated; with two sections a point takes some ten seconds.
With --sigmas S it is tuned for every rig within so many standard deviations, which takes several times as long.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure
from tolerance_cost import reached

from beamdesign import Prototype, read_prototype
from beamdesign.report.canvas import STYLES

FACTORS = (0.5, 0.7, 1.0, 1.5, 2.5)
"""Of each limit's own value."""


@dataclass(frozen=True)
class Limit:
    """One figure that bounds what a controller may do.

    Attributes:
        name: in words, with its unit; the label of its axis.
        own: its value in a prototype, in that unit; None where it is not limited.
        at: the prototype with another value.
    """

    name: str
    own: Callable[[Prototype], float | None]
    at: Callable[[Prototype, float], Prototype]


LIMITS = (
    Limit(
        "natural frequency of the valve, Hz",
        lambda p: p.servovalve.natural_frequency_Hz,
        lambda p, value: p.but(servovalve=p.servovalve.but(natural_frequency_Hz=value)),
    ),
    Limit(
        "break of the sensor's filter, Hz",
        lambda p: p.sensor.filter_Hz,
        lambda p, value: p.but(sensor=p.sensor.but(filter_Hz=value)),
    ),
    Limit(
        "|L| limited from, Hz",
        lambda p: p.goal.loop_gain_from_Hz,
        lambda p, value: p.but(goal=p.goal.but(loop_gain_from_Hz=value)),
    ),
    Limit(
        "limit of |C/(1+L)|, mA/V",
        lambda p: None if p.goal.controller_effort_A_per_V is None else 1e3 * p.goal.controller_effort_A_per_V,
        lambda p, value: p.but(goal=p.goal.but(controller_effort_A_per_V=1e-3 * value)),
    ),
)


@dataclass(frozen=True)
class Trade:
    """Proved bandwidths over the values of one limit, all else unchanged.

    Attributes:
        limit: which.
        values: in its unit.
        bandwidth_Hz: proved for each; None where nothing was.
    """

    limit: Limit
    values: tuple[float, ...]
    bandwidth_Hz: tuple[float | None, ...]


def plot_limit_trades(figure: Figure, trades: Sequence[Trade], prototype: Prototype, title: str) -> Figure:
    """Draw one panel per limit, its own value as a dashed line; a cross on the axis marks where nothing was proved."""
    panels = figure.subplots(1, len(trades), sharey=True, squeeze=False)[0]
    for axes, trade in zip(panels, trades, strict=True):
        proved = [(x, y) for x, y in zip(trade.values, trade.bandwidth_Hz, strict=True) if y is not None]
        if proved:
            axes.plot(*zip(*proved, strict=True), marker="o", color=STYLES[0]["color"])
        for value, bandwidth in zip(trade.values, trade.bandwidth_Hz, strict=True):
            if bandwidth is None:
                axes.plot(value, 0.0, marker="x", color="black", clip_on=False)
        if (own := trade.limit.own(prototype)) is not None:
            axes.axvline(own, color="0.4", linestyle="--")
        axes.set_xscale("log")
        axes.set_xticks(trade.values, [f"{value:g}" for value in trade.values])
        axes.minorticks_off()
        axes.set_xlabel(trade.limit.name)
        axes.set_ylim(bottom=0.0)
        axes.grid(True, color="0.85")
    panels[0].set_ylabel("proved bandwidth, Hz")
    figure.suptitle(title)
    return figure


def trade(
    prototype: Prototype, limit: Limit, at_hand: float, factors: Sequence[float], sections: int, sigmas: float
) -> Trade:
    """Tune at multiples of a limit's own value, at which the bandwidth is at hand."""
    own = limit.own(prototype)
    if own is None:
        raise SystemExit(f"the prototype needs a figure for: {limit.name}")
    values = tuple(float(f"{factor * own:.3g}") for factor in factors)
    found = []
    for factor, value in zip(factors, values, strict=True):
        best = at_hand if factor == 1 else reached(limit.at(prototype, value), "structured", sections, sigmas)
        found.append(best or None)
        print(f"{limit.name} {value:g}: {f'{best:.4g} Hz' if best else 'nothing proved'}", flush=True)
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
    own = reached(prototype, "structured", given.sections, given.sigmas)
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
