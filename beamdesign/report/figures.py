"""Drawings of a loop, of what limits it and of trade curves: each function draws on the axes it is given.

A loop comes as `LoopAtMass`, several of them under the labels of the legend. Frequencies in Hz, roots in 1/s. Trade
curves are moving mass against guaranteed bandwidth against payload, and the four remedies side by side.
"""

import csv
from collections.abc import Mapping, Sequence
from io import StringIO
from itertools import cycle
from math import inf, isfinite, log10
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from flint import fmpq_poly
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, MultipleLocator, NullFormatter

from beamdesign.files import LARGEST_TABLE, read_bytes
from beamdesign.loop import LoopAtMass
from beamdesign.plant.members import family
from beamdesign.polynomial import exact
from beamdesign.prototype import COMPLIANCE_LIMIT_M_PER_N, Prototype
from beamdesign.quantity_text import at_least, decibels
from beamdesign.report.canvas import LIMIT, STYLES, finish, note, plain_numbers
from beamdesign.structure.equal_mass import beam_of_equal_mass

if TYPE_CHECKING:
    from beamdesign.synthesis.codesign import Front
    from beamdesign.synthesis.operating_limits import Envelope
    from beamdesign.synthesis.remedies import Remedy

Curves = Mapping[str, LoopAtMass]
"""Loops by the label each gets in the legend."""

BESIDE: tuple[dict[str, Any], ...] = (
    {"color": "#3a7fc4", "linestyle": (0, (5, 1.5))},
    {"color": "#c46a2b", "linestyle": (0, (3, 1.2, 1, 1.2))},
)
"""Line styles of what a loop is compared with, in colours that are seen on light and on dark."""

T = TypeVar("T")
FRONT_NAME = "front.csv"
"""Of the table that `beamdesign front` writes."""


def frequency_grid(loops: Sequence[LoopAtMass], lowest_Hz: float = 0.1, highest_Hz: float = 1000.0) -> np.ndarray:
    """Frequencies for a smooth curve: even in the logarithm, and denser about each lightly damped root."""
    even = np.geomspace(lowest_Hz, highest_Hz, 800)
    close = [even]
    for loop in loops:
        fed_back = np.zeros(0) if loop.loop_numerator.is_zero() else loop.open_loop_zeros()
        roots = np.concatenate([loop.poles(), loop.open_loop_poles(), fed_back, loop.compliance_zeros()])
        for root in roots[roots.imag > 0]:
            spread = max(abs(root.real), 1e-4 * abs(root.imag))
            close.append((abs(root.imag) + spread * np.linspace(-4, 4, 41)) / (2 * np.pi))
    grid = np.unique(np.concatenate(close))
    return grid[(grid >= lowest_Hz) & (grid <= highest_Hz)]


def plot_compliance(
    axes: Axes,
    curves: Curves,
    limit_m_per_N: float | None = COMPLIANCE_LIMIT_M_PER_N,
    lowest_Hz: float = 0.1,
    highest_Hz: float = 1000.0,
    beside: Curves = MappingProxyType({}),
) -> Axes:
    """Closed-loop compliance |x / F_d| over frequency: m/N on the left, dB re 1 in/lbf on the right.

    The limit is drawn as a line; a dot on it marks where a stable curve first leaves it. The legend names the
    bandwidth, or says that a loop is unstable. What is drawn beside them in colour, such as `passive_curves` gives, is
    named alone.
    """
    frequencies = frequency_grid([*curves.values(), *beside.values()], lowest_Hz, highest_Hz)
    for label, loop, style in _styled(curves):
        bandwidth = loop.bandwidth_Hz(limit_m_per_N) if limit_m_per_N else 0.0
        name = f"{label} (unstable)" if not loop.stable else f"{label}: {bandwidth:.2f} Hz" if limit_m_per_N else label
        magnitudes = np.abs(loop.compliance_response(frequencies))
        axes.loglog(frequencies, magnitudes, label=name, linewidth=1.3, **style)
        if limit_m_per_N and lowest_Hz <= bandwidth <= highest_Hz:
            axes.plot([bandwidth], [limit_m_per_N], "o", color=style["color"], markersize=5)
    for (label, loop), style in zip(beside.items(), cycle(BESIDE), strict=False):
        axes.loglog(frequencies, np.abs(loop.compliance_response(frequencies)), label=label, linewidth=1.2, **style)
    if limit_m_per_N:
        level = f"limit {limit_m_per_N:.3g} m/N = {limit_m_per_N * 1e5:.2g} cm/kN = {decibels(limit_m_per_N):.0f} dB"
        axes.axhline(limit_m_per_N, label=level, **LIMIT)
    _frequency_axis(axes, lowest_Hz, highest_Hz)
    # 10⁻⁷ and the like in plain text, which is drawn far quicker than mathtext.
    raised = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: "10" + str(round(log10(value))).translate(raised)))
    axes.yaxis.set_minor_formatter(NullFormatter())
    _decibel_axis(axes)
    return finish(axes, y="compliance |x / F_d|, m/N")


def passive_curves(prototype: Prototype, outer_end_mass: float) -> dict[str, LoopAtMass]:
    """What compliances a rig has without its servo, by label, at an outer end mass (kg); for `plot_compliance`.

    That of the rig with the valve shut, at rest where it has effects; and, where it states sections, that of one tube
    of the outer one's outside that weighs as much as both, with the same end mass: 1 / (K - M w^2 + j b w).
    """
    plant = family(prototype).rest.rig.plant(prototype.payload.inner_end_mass_kg)
    mass, none = exact(outer_end_mass), fmpq_poly([0])
    curves = {"servo off": LoopAtMass(plant.denominator.at(mass), none, plant.disturbance)}
    if (one := beam_of_equal_mass(prototype.outer_beam, prototype.inner_beam)) is not None:
        polynomial = fmpq_poly([exact(one.stiffness), exact(one.damping), exact(one.mass) + mass])
        label = "passive beam of equal mass"
        curves[f"{label}: even solid it is lighter" if one.solid else label] = LoopAtMass(
            polynomial, none, fmpq_poly([1])
        )
    return curves


def shade_compliance(axes: Axes, loops: Sequence[LoopAtMass], label: str) -> Axes:
    """Shade between the least and the largest compliance of several loops at 700 frequencies from 0.1 to 1000 Hz."""
    frequencies = np.geomspace(0.1, 1000.0, 700)
    magnitudes = np.array([np.abs(loop.compliance_response(frequencies)) for loop in loops])
    axes.fill_between(
        frequencies, magnitudes.min(axis=0), magnitudes.max(axis=0), color="0.88", linewidth=0, label=label, zorder=0
    )
    return axes


def _decibel_axis(axes: Axes) -> Axes:
    """A second scale on the right that follows the left one, now and when the limits change."""
    twin = axes.twinx()
    twin.set_ylabel("dB re 1 in/lbf")
    twin.yaxis.set_major_locator(MultipleLocator(20))

    def follow(source: Axes) -> None:
        twin.set_ylim(*(float(decibels(end)) for end in source.get_ylim()))

    axes.callbacks.connect("ylim_changed", follow)
    follow(axes)
    axes.set_zorder(twin.get_zorder() + 1)
    axes.patch.set_visible(False)
    return twin


def plot_loop_bode(
    magnitude: Axes, phase: Axes, curves: Curves, lowest_Hz: float = 0.1, highest_Hz: float = 1000.0
) -> tuple[Axes, Axes]:
    """Bode diagram of the loop transfer function L with the lines |L| = 1 and -180 degrees, where stability is decided.

    Args:
        magnitude: upper axes.
        phase: lower axes; share the frequency axis with the upper ones.
        curves: loops by label.
        lowest_Hz: left end.
        highest_Hz: right end.

    Returns:
        Both axes.
    """
    frequencies = frequency_grid(list(curves.values()), lowest_Hz, highest_Hz)
    for label, loop, style in _styled(curves):
        response = loop.loop_response(frequencies)
        angle = np.degrees(np.unwrap(np.angle(response)))
        magnitude.semilogx(frequencies, 20 * np.log10(np.abs(response)), label=label, linewidth=1.3, **style)
        phase.semilogx(frequencies, angle - 360 * np.round(angle[0] / 360), linewidth=1.3, **style)
    for axes, level in ((magnitude, 0.0), (phase, -180.0)):
        axes.axhline(level, **LIMIT)
        _frequency_axis(axes, lowest_Hz, highest_Hz)
    magnitude.yaxis.set_major_locator(MultipleLocator(20))
    phase.yaxis.set_major_locator(MultipleLocator(90))
    return finish(magnitude, "", "|L|, dB"), finish(phase, y="phase of L, degrees")


def plot_root_locus(axes: Axes, loop: LoopAtMass, factors: Sequence[float], marked: Mapping[str, float]) -> Axes:
    """Closed-loop poles as the gain is multiplied by each factor, from the open-loop poles to the zeros.

    Args:
        axes: drawn on in 1/s.
        loop: the loop at factor 1.
        factors: positive and ascending; they set how fine the curves are.
        marked: factors to mark with squares, by label.
    """

    def poles(factor: float) -> np.ndarray:
        return LoopAtMass(loop.loop_denominator, loop.loop_numerator * exact(factor), loop.disturbance).poles()

    branches = _branches([poles(factor) for factor in factors])
    axes.plot(branches.real, branches.imag, color="0.45", linewidth=1.3)
    for (label, factor), marker in zip(marked.items(), "sD^v<>"[: len(marked)], strict=True):
        at = poles(factor)
        axes.plot(at.real, at.imag, marker, color="black", markersize=5, fillstyle="none", label=label)
    return plot_pole_zero(axes, loop.open_loop_poles(), loop.open_loop_zeros())


def _branches(roots: Sequence[np.ndarray]) -> np.ndarray:
    """Sets of n roots, each set put in the order in which it lies nearest to the one before; (sets, n)."""
    from scipy.optimize import linear_sum_assignment

    ordered = [roots[0]]
    for found in roots[1:]:
        _, order = linear_sum_assignment(np.abs(ordered[-1][:, None] - found[None, :]))
        ordered.append(found[order])
    return np.array(ordered)


def plot_pole_zero(
    axes: Axes, poles: np.ndarray, zeros: np.ndarray, pole_label: str = "open-loop poles", zero_label: str = "zeros"
) -> Axes:
    """Poles as crosses and zeros as circles, 1/s, with the stability boundary drawn in."""
    axes.plot(poles.real, poles.imag, "x", color="black", markersize=7, label=pole_label)
    axes.plot(zeros.real, zeros.imag, "o", color="black", markersize=7, fillstyle="none", label=zero_label)
    axes.axvline(0.0, **LIMIT)
    axes.axhline(0.0, color="0.7", linewidth=0.6)
    return finish(axes, "real part, 1/s", "imaginary part, rad/s")


def plot_sensitivity(
    axes: Axes, curves: Curves, limit: float | None = 2.0, lowest_Hz: float = 0.1, highest_Hz: float = 1000.0
) -> Axes:
    """Sensitivity |S| = |1 / (1 + L)| over frequency, with the limit on its peak."""
    frequencies = frequency_grid(list(curves.values()), lowest_Hz, highest_Hz)
    for label, loop, style in _styled(curves):
        peak = loop.peak_sensitivity()
        shown = f"{label}, peak {peak:.2f}" if isfinite(peak) else f"{label}, unstable"
        axes.loglog(frequencies, np.abs(loop.sensitivity_response(frequencies)), label=shown, linewidth=1.3, **style)
    if limit:
        axes.axhline(limit, label=f"limit {limit:g}", **LIMIT)
    _frequency_axis(axes, lowest_Hz, highest_Hz)
    plain_numbers(axes.yaxis)
    return finish(axes, y="|S|")


def plot_critical_gain(axes: Axes, masses_kg: Sequence[float], curves: Mapping[str, Sequence[float]]) -> Axes:
    """Critical gain in mA/V over the outer end mass; a jump is left as a gap.

    Args:
        axes: drawn on.
        masses_kg: outer end masses, ascending.
        curves: critical gains in A/V, one per mass, by label.
    """
    for label, gains, style in _styled(curves):
        x, y = [masses_kg[0]], [1e3 * gains[0]]
        for mass, before, after in zip(masses_kg[1:], gains[:-1], gains[1:], strict=True):
            if not 0.5 < after / before < 2:
                x.append(mass)
                y.append(inf)
            x.append(mass)
            y.append(1e3 * after)
        axes.semilogy(x, np.where(np.isfinite(y), y, np.nan), label=label, linewidth=1.3, **style)
    axes.set_xlim(masses_kg[0], masses_kg[-1])
    plain_numbers(axes.yaxis)
    return finish(axes, "outer end mass, kg", "critical gain, mA/V")


def _frequency_axis(axes: Axes, lowest_Hz: float, highest_Hz: float) -> None:
    axes.set(xlim=(lowest_Hz, highest_Hz), xlabel="frequency, Hz")
    plain_numbers(axes.xaxis)


def _styled(curves: Mapping[str, T]) -> list[tuple[str, T, dict[str, Any]]]:
    """Curves with their labels and the line style of each."""
    return [(label, curve, STYLES[k % len(STYLES)]) for k, (label, curve) in enumerate(curves.items())]


_STYLES = (*STYLES, {"color": "0.45", "linestyle": "--"})


def plot_envelope(axes: Axes, envelope: "Envelope", asked_N: float | None = None) -> Axes:
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
        axes.axhline(asked_N, **LIMIT, label=f"asked for, {asked_N:g} N")
    _name_stretches(axes, envelope, bottom)
    axes.set(xlim=(float(frequency[0]), float(frequency[-1])), ylim=(bottom, top))
    plain_numbers(axes.xaxis, axes.yaxis)
    finish(axes, "frequency, Hz", "amplitude of the force on the tip, N", legend=None)
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return axes


def _name_stretches(axes: Axes, envelope: "Envelope", bottom: float) -> None:
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
            middle = float(np.sqrt(frequency[start] * end))
            note(axes, words, (middle, bottom), (0, 5), va="bottom", style="italic")
        start = k


class TradePoint(NamedTuple):
    """A proved design of a front."""

    outer_end_mass_high_kg: float
    bandwidth_Hz: float
    moving_mass_kg: float


def read_trade(folder: Path) -> tuple[TradePoint, ...]:
    """The proved points of a folder's front; none where there is no such file, or none that can be read."""
    try:
        text = read_bytes(folder / FRONT_NAME, LARGEST_TABLE).decode()
        rows = [row for row in csv.DictReader(StringIO(text, newline="")) if row.get("proved") == "True"]
        points = tuple(TradePoint(*(float(row[key]) for key in TradePoint._fields)) for row in rows)
    except (OSError, KeyError, ValueError, TypeError, csv.Error):  # TypeError: a row that ends early
        return ()
    return points if all(isfinite(figure) for point in points for figure in point) else ()


def plot_trade(axes: Axes, points: tuple[TradePoint, ...], own: tuple[float, float]) -> Axes:
    """Moving mass over guaranteed bandwidth, one curve per payload, and this design as a square.

    Args:
        axes: drawn on: Hz and kg.
        points: proved designs.
        own: bandwidth (Hz) and moving mass (kg) of the design that is reported.
    """
    curves = {
        f"up to {payload:g} kg at the tip": [p[1:] for p in points if p.outer_end_mass_high_kg == payload]
        for payload in sorted({point.outer_end_mass_high_kg for point in points})
    }
    _draw_curves(axes, curves)
    axes.plot([own[0]], [own[1]], "s", color="black", markersize=8, fillstyle="none", label="this design")
    return finish(axes, "guaranteed bandwidth, Hz", "moving mass, kg")


def plot_front(axes: Axes, front: "Front") -> Axes:
    """Draw proved designs, one curve per payload range; a cross on the upper edge marks each that failed."""
    curves = {
        f"{masses[0]:g} to {masses[1]:g} kg at the tip": [
            (design.point.proved.bandwidth_Hz, design.point.moving_mass_kg)
            for design in front.designs
            if design.point is not None and design.outer_end_mass_kg == masses
        ]
        for masses in dict.fromkeys(design.outer_end_mass_kg for design in front.designs)
    }
    _draw_curves(axes, curves)
    for design in front.failed:
        axes.plot(
            design.bandwidth_Hz, 0.97, marker="x", color="black", linestyle="none", transform=axes.get_xaxis_transform()
        )
    axes.set_title("Lightest proved designs; x: no proved design found")
    return finish(axes, "guaranteed bandwidth, Hz", "moving mass, kg")


def _draw_curves(axes: Axes, curves: Mapping[str, Sequence[tuple[float, float]]]) -> None:
    """Bandwidth and moving mass of proved designs, joined by lines; a curve per label."""
    for label, points, style in _styled(curves):
        axes.plot(*zip(*sorted(points), strict=True) if points else ((), ()), marker="o", label=label, **style)


def plot_remedies(axes: Axes, remedies: Sequence["Remedy"]) -> Axes:
    """Draw the guaranteed bandwidth of each remedy as a bar, with the mass it adds."""
    heights = [remedy.bandwidth_Hz for remedy in remedies]
    bars = axes.barh([remedy.name for remedy in remedies], heights, color="0.7", edgecolor="black")
    labels = [
        f"{at_least(remedy.bandwidth_Hz, 'Hz', 3)}, {remedy.added_mass_kg:+.2f} kg"
        if not remedy.reason
        else "nothing proved"
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
