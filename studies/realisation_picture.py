"""Lost margin over sampling rate, and what rounding does over word length."""

from collections.abc import Sequence
from math import isfinite

from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter, StrMethodFormatter
from rate_and_word import RateAndWord

from beamdesign.report.canvas import STYLES

_MARKERS = "s^Dvx+"


def plot_sensitivity(axes: Axes, rows: Sequence[RateAndWord], goal: float | None = None) -> Axes:
    """Worst peak sensitivity over the rate, at once and one period late, in the longest words and in shorter ones.

    Args:
        axes: drawn on.
        rows: of `rate_and_word.trade`.
        goal: limit to be drawn.
    """
    words = sorted({row.word_length for row in rows if row.word_length is not None})
    longest, shortest = (words[-1], words[0]) if words else (None, None)
    for name, when, marks, fill in (("late", "one period late", "ox", "black"), ("at_once", "at once", "o+", "white")):
        for word, mark in zip(dict.fromkeys((longest, shortest)), marks, strict=False):
            points = [(row.rate_Hz, getattr(row, name)) for row in rows if row.word_length == word]
            drawn = sorted((x, y.peak_sensitivity) for x, y in points if y is not None and isfinite(y.peak_sensitivity))
            if drawn:
                axes.semilogx(
                    *zip(*drawn, strict=True), color="black", linestyle="-" if word == longest else "none", marker=mark,
                    markerfacecolor=fill, markeredgecolor="black" if word == longest else "0.45",
                    markersize=5 if word == longest else 9, label=f"{_word(word)}, current {when}",
                )  # fmt: skip
    axes.axhline(rows[0].continuous.peak_sensitivity, color="0.45", linewidth=0.9, label="continuous design")
    if goal is not None:
        axes.axhline(goal, color="black", linewidth=0.9, linestyle=(0, (8, 3)), label=f"goal, {goal:g}")
    _in_hertz(axes)
    axes.set_ylim(1.0, 4.0)
    axes.set_ylabel("worst peak sensitivity over the payloads")
    axes.legend(fontsize=7)
    return axes


def plot_rounding(axes: Axes, rows: Sequence[RateAndWord], limit_m: float | None = None) -> Axes:
    """Bound of what rounding moves the tip, over the word length, one curve per rate; floats at the right.

    Args:
        axes: drawn on.
        rows: of `rate_and_word.trade`.
        limit_m: motion to be marked, such as the sensor's resolution.
    """
    words = sorted({row.word_length for row in rows if row.word_length is not None})
    beyond = float(words[-1] + 4 if words else 32)
    for k, rate in enumerate(sorted({row.rate_Hz for row in rows})):
        style, marker = STYLES[k % len(STYLES)], _MARKERS[k % len(_MARKERS)]
        own = [row for row in rows if row.rate_Hz == rate and isfinite(row.rounding_m)]
        fixed = sorted((float(row.word_length), 1e6 * row.rounding_m) for row in own if row.word_length is not None)
        single = [(beyond, 1e6 * row.rounding_m) for row in own if row.word_length is None]
        if fixed:
            axes.semilogy(*zip(*fixed, strict=True), marker=marker, markersize=4, label=f"{rate:g} Hz", **style)
        for x, y in single:
            axes.semilogy(x, y, marker=marker, markersize=4, color=style["color"])
    if limit_m is not None:
        axes.axhline(1e6 * limit_m, color="black", linewidth=0.9, linestyle=(0, (8, 3)), label=f"{1e6 * limit_m:g} µm")
    ends = [(beyond, "float")] if any(row.word_length is None for row in rows) else []
    places, names = zip(*[(float(word), f"{word}") for word in words], *ends, strict=True)
    axes.set_xticks(places, names)
    axes.set_xlabel("word length, bits")
    axes.set_ylabel("largest motion of the tip by rounding, µm")
    axes.grid(which="major", color="0.85", linewidth=0.6)
    axes.legend(fontsize=7, title="rate", title_fontsize=7)
    return axes


def _in_hertz(axes: Axes) -> None:
    axes.set_xlabel("sampling rate, Hz")
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(which="both", color="0.85", linewidth=0.6)


def _word(word: int | None) -> str:
    return "floats" if word is None else f"{word} bits"
