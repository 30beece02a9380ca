"""What added sensors buy, beside the bounds that no controller passes."""

from collections.abc import Sequence

import numpy as np
from fundamental_limits import Limits
from matplotlib.figure import Figure
from sensor_rows import SensorRow

NAMES = {
    "displacement_m": "displacement",
    "inner_displacement_m": "inner tip",
    "load_pressure_Pa": "pressure",
}
_GREYS = ("0.2", "0.55", "0.8")


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
