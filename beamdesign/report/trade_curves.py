"""Trade curves: moving mass against guaranteed bandwidth against payload, and the four remedies side by side."""

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from beamdesign.design.front import Front
from beamdesign.design.remedies import Remedy
from beamdesign.report.canvas import STYLES


def plot_front(axes: Axes, front: Front) -> Axes:
    """Draw proved designs, one curve per payload range; a cross on the upper edge marks each that failed."""
    ranges = list(dict.fromkeys(design.outer_end_mass_kg for design in front.designs))
    for k, masses in enumerate(ranges):
        proved = [
            (design.point.proved.bandwidth_Hz, design.point.moving_mass_kg)
            for design in front.designs
            if design.point is not None and design.outer_end_mass_kg == masses
        ]
        label = f"{masses[0]:g} to {masses[1]:g} kg at the tip"
        bandwidths, moving = zip(*sorted(proved), strict=True) if proved else ((), ())
        style = STYLES[k % len(STYLES)]
        axes.plot(bandwidths, moving, marker="o", label=label, color=style["color"], linestyle=style["linestyle"])
    for design in front.failed:
        axes.plot(
            design.bandwidth_Hz, 0.97, marker="x", color="black", linestyle="none", transform=axes.get_xaxis_transform()
        )
    axes.set_xlabel("guaranteed bandwidth, Hz")
    axes.set_ylabel("moving mass, kg")
    axes.set_title("Lightest proved designs; x: no proved design found")
    axes.grid(True, color="0.85")
    axes.legend()
    return axes


def plot_remedies(axes: Axes, remedies: Sequence[Remedy]) -> Axes:
    """Draw the guaranteed bandwidth of each remedy as a bar, with the mass it adds."""
    names = [remedy.name for remedy in remedies]
    heights = [remedy.bandwidth_Hz for remedy in remedies]
    bars = axes.barh(names, heights, color="0.7", edgecolor="black")
    labels = [
        f"{remedy.bandwidth_Hz:.2f} Hz, {remedy.added_mass_kg:+.2f} kg" if not remedy.reason else "nothing proved"
        for remedy in remedies
    ]
    written = axes.bar_label(bars, labels, padding=4)
    axes.set_xlim(0, max([*heights, 1.0]))
    axes.invert_yaxis()
    axes.set_xlabel("guaranteed bandwidth, Hz")
    low, high = remedies[0].parts_kg[0]
    axes.set_title(f"Remedies for {low:g} to {high:g} kg at the tip, each proved")
    axes.set_xlim(0, _end_beyond(axes, heights, written))
    return axes


def _end_beyond(axes: Axes, heights: Sequence[float], written: Sequence[Text]) -> float:
    """End of the scale at which every bar with the text behind it lies within the frame."""
    figure = axes.figure
    assert isinstance(figure, Figure)  # not a part of one
    figure.draw_without_rendering()
    frame = axes.get_window_extent().width
    shares = [(text.get_window_extent().width + 0.03 * frame) / frame for text in written]
    return max(1.0, *(height / max(1.0 - share, 0.1) for height, share in zip(heights, shares, strict=True)))
