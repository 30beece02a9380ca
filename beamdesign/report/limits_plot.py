"""The operating envelope of an actuator as a figure."""

from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter, StrMethodFormatter

from beamdesign.operating_limits import Envelope
from beamdesign.report.canvas import STYLES

_STYLES = (*STYLES, {"color": "0.45", "linestyle": "--"})


def plot_envelope(axes: Axes, envelope: Envelope, asked_N: float | None = None) -> Axes:
    """Largest amplitude of a force on the tip over its frequency: every limit, and the least of them shaded below.

    Args:
        axes: drawn on.
        envelope: one that has limits.
        asked_N: a load to be marked, such as that of the design.
    """
    frequency, least = envelope.frequency_Hz, envelope.load_N
    top = 6 * float(max(least.max(), asked_N or 0.0))
    bottom = 0.5 * float(max(least.min(), 1e-3 * top))
    axes.fill_between(frequency, bottom, least, color="0.9", linewidth=0)
    for (name, limit), style in zip(envelope.limits_N.items(), cycle(_STYLES), strict=False):
        line = axes.loglog(frequency, np.minimum(limit, 10 * top), label=name, linewidth=1.1)[0]
        line.set(**style)
    axes.loglog(frequency, least, color="black", linewidth=2.4, label="envelope")
    if asked_N is not None:
        axes.axhline(asked_N, color="black", linewidth=0.8, linestyle=(0, (8, 3)), label=f"asked for, {asked_N:g} N")
    _name_stretches(axes, envelope, bottom)
    axes.set_xlim(float(frequency[0]), float(frequency[-1]))
    axes.set_ylim(bottom, top)
    axes.set_xlabel("frequency, Hz")
    axes.set_ylabel("amplitude of the force on the tip, N")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())
    axes.grid(which="major", color="0.85", linewidth=0.6)
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return axes


def _name_stretches(axes: Axes, envelope: Envelope, bottom: float) -> None:
    """Write at the foot which limit governs, between lines where that changes; short stretches go without a name."""
    names, frequency = envelope.governing, envelope.frequency_Hz
    whole = np.log(frequency[-1] / frequency[0])
    start = 0
    for k in range(1, len(names) + 1):
        if k < len(names) and names[k] == names[start]:
            continue
        end = frequency[min(k, len(names) - 1)]
        if k < len(names):
            axes.axvline(float(end), color="0.6", linewidth=0.7, linestyle=":")
        if np.log(end / frequency[start]) > 0.08 * whole:
            words = names[start].replace(" ", "\n")
            axes.annotate(
                words, (float(np.sqrt(frequency[start] * end)), bottom), xytext=(0, 5), textcoords="offset points",
                fontsize=8, ha="center", va="bottom", style="italic",
            )  # fmt: skip
        start = k
