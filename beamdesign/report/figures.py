"""Drawings of a loop and of what limits it: each function draws on the axes it is given and gives them back.

A loop comes as `LoopAtMass`, several of them under the labels of the legend. Frequencies in Hz, roots in 1/s.
"""

from collections.abc import Mapping, Sequence
from itertools import cycle
from math import inf, isfinite, log10

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, MultipleLocator, NullFormatter

from beamdesign.loop import LoopAtMass
from beamdesign.polynomial import exact
from beamdesign.prototype import COMPLIANCE_LIMIT_M_PER_N
from beamdesign.quantity_text import decibels
from beamdesign.report.canvas import LIMIT, STYLES, finish, note, plain_numbers
from beamdesign.synthesis.operating_limits import Envelope

Curves = Mapping[str, LoopAtMass]
"""Loops by the label each gets in the legend."""


def frequency_grid(loops: Sequence[LoopAtMass], lowest_Hz: float = 0.1, highest_Hz: float = 1000.0) -> np.ndarray:
    """Frequencies for a smooth curve: even in the logarithm, and denser about each lightly damped root."""
    even = np.geomspace(lowest_Hz, highest_Hz, 800)
    close = [even]
    for loop in loops:
        roots = np.concatenate([loop.poles(), loop.open_loop_poles(), loop.open_loop_zeros(), loop.compliance_zeros()])
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
) -> Axes:
    """Closed-loop compliance |x / F_d| over frequency: m/N on the left, dB re 1 in/lbf on the right.

    The limit is drawn as a line; a dot on it marks where a stable curve first leaves it. The legend names the
    bandwidth, or says that a loop is unstable.
    """
    frequencies = frequency_grid(list(curves.values()), lowest_Hz, highest_Hz)
    for (label, loop), style in zip(curves.items(), _styles(len(curves)), strict=True):
        bandwidth = loop.bandwidth_Hz(limit_m_per_N) if limit_m_per_N else 0.0
        name = f"{label} (unstable)" if not loop.stable else f"{label}: {bandwidth:.2f} Hz" if limit_m_per_N else label
        magnitudes = np.abs(loop.compliance_response(frequencies))
        axes.loglog(frequencies, magnitudes, label=name, linewidth=1.3, **style)
        if limit_m_per_N and lowest_Hz <= bandwidth <= highest_Hz:
            axes.plot([bandwidth], [limit_m_per_N], "o", color=style["color"], markersize=5)
    if limit_m_per_N:
        level = f"limit {limit_m_per_N:.3g} m/N = {limit_m_per_N * 1e5:.2g} cm/kN = {decibels(limit_m_per_N):.0f} dB"
        axes.axhline(limit_m_per_N, label=level, **LIMIT)
    _frequency_axis(axes, lowest_Hz, highest_Hz)
    _powers_of_ten(axes)
    _decibel_axis(axes)
    return finish(axes, y="compliance |x / F_d|, m/N")


def shade_compliance(
    axes: Axes, loops: Sequence[LoopAtMass], label: str, lowest_Hz: float = 0.1, highest_Hz: float = 1000.0
) -> Axes:
    """Shade between the least and the largest compliance of several loops at each of 700 frequencies."""
    frequencies = np.geomspace(lowest_Hz, highest_Hz, 700)
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
    for (label, loop), style in zip(curves.items(), _styles(len(curves)), strict=True):
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
    for (label, loop), style in zip(curves.items(), _styles(len(curves)), strict=True):
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
    for (label, gains), style in zip(curves.items(), _styles(len(curves)), strict=True):
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
    axes.set_xlim(lowest_Hz, highest_Hz)
    axes.set_xlabel("frequency, Hz")
    plain_numbers(axes.xaxis)


def _powers_of_ten(axes: Axes) -> None:
    """Label a logarithmic vertical axis 10⁻⁷ and the like in plain text, which is drawn far quicker than mathtext."""
    raised = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: "10" + str(round(log10(value))).translate(raised)))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _styles(count: int) -> list[dict[str, str]]:
    return [STYLES[i % len(STYLES)] for i in range(count)]


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
        axes.axhline(asked_N, **LIMIT, label=f"asked for, {asked_N:g} N")
    _name_stretches(axes, envelope, bottom)
    axes.set_xlim(float(frequency[0]), float(frequency[-1]))
    axes.set_ylim(bottom, top)
    plain_numbers(axes.xaxis, axes.yaxis)
    finish(axes, "frequency, Hz", "amplitude of the force on the tip, N", legend=None)
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
            middle = float(np.sqrt(frequency[start] * end))
            note(axes, words, (middle, bottom), (0, 5), va="bottom", style="italic")
        start = k
