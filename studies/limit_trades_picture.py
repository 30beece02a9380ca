"""Bandwidth against each limit in turn: what a faster valve, a better sensor or more current would buy."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from beamdesign import Prototype
from beamdesign.report.canvas import STYLES


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
