"""Drawings of a loop: each function draws on the axes it is given.

A loop comes as `LoopAtMass`, several of them under the labels of the legend. Frequencies and roots are in Hz: a root s
of a polynomial is drawn as s / (2 pi).
"""

from collections.abc import Collection, Mapping, Sequence
from functools import cache
from itertools import cycle
from math import isfinite, log10, pi, sqrt
from types import MappingProxyType
from typing import Any

import numpy as np
from flint import fmpq_poly
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, MultipleLocator, NullFormatter

from beamdesign.loop import LoopAtMass
from beamdesign.plant.members import family
from beamdesign.polynomial import exact
from beamdesign.prototype import COMPLIANCE_LIMIT_M_PER_N, Prototype
from beamdesign.quantities import decibels, read_in, stated_peak
from beamdesign.report.canvas import LIMIT, finish, plain_numbers, styled
from beamdesign.structure.lumped import beam_of_equal_mass

Curves = Mapping[str, LoopAtMass]
"""Loops by the label each gets in the legend."""
_LOWEST_HZ, _HIGHEST_HZ, _MODE_HZ = 0.1, 1000.0, 30.0
"""What is shown of a rig whose first mode is about there."""
_LIGHT = 0.1
"""Damping ratio below which a root of the loop opened is taken for a mode."""

BESIDE: tuple[dict[str, Any], ...] = (
    {"color": "#3a7fc4", "linestyle": (0, (5, 1.5))},
    {"color": "#c46a2b", "linestyle": (0, (3, 1.2, 1, 1.2))},
)
"""Line styles of what a loop is compared with, in colours that are seen on light and on dark."""


def shown_Hz(loops: Sequence[LoopAtMass]) -> tuple[float, float]:
    """From 0.1 Hz to 1 kHz, so many decades lower or higher as the first mode of the loops lies from some 30 Hz."""
    poles = np.concatenate([loop.open_loop_poles() for loop in loops])
    modes = np.abs(poles[(poles.imag > 0) & (-poles.real < _LIGHT * np.abs(poles))]) / (2 * pi)
    decades = 10.0 ** round(log10(modes.min() / _MODE_HZ)) if len(modes) else 1.0
    return decades * _LOWEST_HZ, decades * _HIGHEST_HZ


def frequency_grid(loops: Sequence[LoopAtMass], wider: float = 1.0) -> np.ndarray:
    """Frequencies for a smooth curve: even in the logarithm, and denser about each lightly damped root.

    Args:
        loops: whose curves are drawn.
        wider: factor by which the ends lie beyond those of `shown_Hz`.
    """
    lowest_Hz, highest_Hz = shown_Hz(loops)
    lowest_Hz, highest_Hz = lowest_Hz / wider, highest_Hz * wider
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
    axes: Axes, curves: Curves, limit_m_per_N: float = COMPLIANCE_LIMIT_M_PER_N, beside: Curves = MappingProxyType({})
) -> Axes:
    """Closed-loop compliance |x / F_d| over frequency: m/N on the left, dB re 1 in/lbf on the right.

    The limit is drawn as a line; a dot on it marks where a stable curve first leaves it. The legend names the
    bandwidth, or says that a loop is unstable. What is drawn beside them in colour, such as `passive_curves` gives, is
    named alone.
    """
    frequencies = frequency_grid([*curves.values(), *beside.values()])
    for label, loop, style in styled(curves):
        bandwidth = loop.bandwidth_Hz(limit_m_per_N)
        name = f"{label}: {bandwidth:.2f} Hz" if loop.stable else f"{label} (unstable)"
        magnitudes = np.abs(loop.compliance_response(frequencies))
        axes.loglog(frequencies, magnitudes, label=name, linewidth=1.3, **style)
        if frequencies[0] <= bandwidth <= frequencies[-1]:
            axes.plot([bandwidth], [limit_m_per_N], "o", color=style["color"], markersize=5)
    for (label, loop), style in zip(beside.items(), cycle(BESIDE), strict=False):
        axes.loglog(frequencies, np.abs(loop.compliance_response(frequencies)), label=label, linewidth=1.2, **style)
    level = f"limit {limit_m_per_N:.3g} m/N = {limit_m_per_N * 1e5:.2g} cm/kN = {decibels(limit_m_per_N):.0f} dB"
    axes.axhline(limit_m_per_N, label=level, **LIMIT)
    _frequency_axis(axes, frequencies)
    # 10⁻⁷ and the like in plain text, which is drawn far quicker than mathtext.
    raised = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: "10" + str(round(log10(value))).translate(raised)))
    axes.yaxis.set_minor_formatter(NullFormatter())
    _decibel_axis(axes)
    return finish(axes, y="compliance |x / F_d|, m/N")


def passive_curves(prototype: Prototype, outer_end_mass: float) -> dict[str, LoopAtMass]:
    """What compliances a rig has without its servo, by label, at an outer end mass (kg); for `plot_compliance`.

    That of the rig whose actuator is asked for no current, at rest where it has effects; and, where it states sections,
    that of one tube of the outer one's outside that weighs as much as both, with the same end mass:
    1 / (K - M w^2 + j b w).
    """
    plant = family(prototype).rest.rig.plant(prototype.payload.inner_end_mass_kg)
    mass, none = exact(outer_end_mass), fmpq_poly([0])
    curves = {"servo off": LoopAtMass(plant.denominator.at(mass), none, plant.disturbance)}
    if (one := beam_of_equal_mass(prototype.outer_beam, prototype.inner_beam)) is not None:
        polynomial = fmpq_poly([exact(one.stiffness), exact(one.damping), exact(one.mass) + mass])
        lighter = ": even solid it is lighter" if one.solid else ""
        curves[f"passive beam of equal mass{lighter}"] = LoopAtMass(polynomial, none, fmpq_poly([1]))
    return curves


def shade_compliance(axes: Axes, loops: Sequence[LoopAtMass], label: str) -> Axes:
    """Shade between the least and the largest compliance of several loops, at 700 frequencies."""
    frequencies = np.geomspace(*shown_Hz(loops), 700)
    magnitudes = np.array([np.abs(loop.compliance_response(frequencies)) for loop in loops])
    axes.fill_between(
        frequencies, magnitudes.min(axis=0), magnitudes.max(axis=0), color="0.88", linewidth=0, label=label, zorder=0
    )
    return axes


def _decibel_axis(axes: Axes) -> None:
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


def plot_loop_bode(magnitude: Axes, phase: Axes, curves: Curves, marked: Collection[str] = ()) -> tuple[Axes, Axes]:
    """Bode diagram of the loop transfer function L with the lines |L| = 1 and -180 degrees, where stability is decided.

    Args:
        magnitude: upper axes.
        phase: lower axes; share the frequency axis with the upper ones.
        curves: loops by label.
        marked: labels of the stable loops whose margins are drawn and named: a bar from |L| = 1 down where the phase is
            -180 degrees, one from such a phase up at the crossover of the least margin, and dots at every crossover.

    Returns:
        Both axes.
    """
    frequencies = frequency_grid(list(curves.values()))
    for label, loop, style in styled(curves):
        response = loop.loop_response(frequencies)
        angle = np.degrees(np.unwrap(np.angle(response)))
        angle -= 360 * np.round(angle[0] / 360)
        (upper,) = magnitude.semilogx(frequencies, 20 * np.log10(np.abs(response)), label=label, linewidth=1.3, **style)
        (lower,) = phase.semilogx(frequencies, angle, linewidth=1.3, **style)
        if label not in marked or not loop.stable:
            continue
        bar: dict[str, Any] = {"color": style["color"], "marker": "_", "markersize": 9, "linewidth": 1.2}
        margins, crossovers = loop.margins(), loop.crossovers_Hz()
        magnitude.plot(crossovers, np.zeros(len(crossovers)), "o", color=style["color"], markersize=4)
        if isfinite(margins.gain_up):
            down = -20 * log10(margins.gain_up)
            upper.set_label(f"{label}: gain margin {margins.gain_up:.3g} = {-down:.1f} dB")
            magnitude.plot([margins.critical_frequency_Hz] * 2, [0, down], **bar)
        if crossovers:
            at = float(np.interp(margins.phase_Hz, frequencies, angle))
            odd = 360 * round((at - 180) / 360) + 180
            lower.set_label(f"{label}: phase margin {margins.phase_deg:.1f}°")
            phase.plot([margins.phase_Hz] * 2, [odd, at], **bar)
    for axes, level in ((magnitude, 0.0), (phase, -180.0)):
        axes.axhline(level, **LIMIT)
        _frequency_axis(axes, frequencies)
    magnitude.yaxis.set_major_locator(MultipleLocator(20))
    phase.yaxis.set_major_locator(MultipleLocator(90))
    return finish(magnitude, "", "|L|, dB"), finish(phase, y="phase of L, degrees")


def plot_nyquist(axes: Axes, curves: Curves, peak_sensitivity: float) -> Axes:
    """Nyquist diagram of L about -1, for positive frequencies, with the point of each that is nearest to it.

    Args:
        axes: drawn on; both scales are made the same.
        curves: loops by label.
        peak_sensitivity: M of a claim |1 / (1 + L)| <= M, which keeps L out of the disc |1 + L| < 1 / M.
    """
    grid = frequency_grid(list(curves.values()), wider=10.0)
    frequencies = np.interp(np.arange(0, len(grid) - 1, 0.25), np.arange(len(grid)), grid)  # round curves need more
    around = np.exp(2j * pi * np.linspace(0, 1, 181))
    disc, words = around / peak_sensitivity - 1, f"kept free: nearer than 1/{stated_peak(peak_sensitivity)}"
    axes.fill(disc.real, disc.imag, facecolor="0.88", edgecolor="black", linewidth=0.8, label=words)
    for label, loop, style in styled(curves):
        response = loop.loop_response(frequencies)
        nearest = response[np.abs(1 + response).argmin()]
        words = f"nearest 1/{loop.peak_sensitivity():.3g}" if loop.stable else "unstable"
        axes.plot(response.real, response.imag, label=f"{label}: {words}", linewidth=1.3, **style)
        axes.plot(nearest.real, nearest.imag, "o", color=style["color"], markersize=4)
    axes.plot(around.real, around.imag, color="0.45", linewidth=0.8, linestyle=":", label="|L| = 1")
    axes.plot(-1, 0, "+", color="black", markersize=9)
    axes.set_xlim(-2.6, 1.8, auto=True)  # the one that the frame allows more of is widened
    axes.set_ylim(-1.9, 1.3, auto=True)
    axes.set_aspect("equal", adjustable="datalim")
    return finish(axes, "real part of L", "imaginary part of L", legend=None)


def plot_root_locus(axes: Axes, loop: LoopAtMass, factors: Sequence[float], marked: Mapping[str, float]) -> Axes:
    """Closed-loop poles as the gain is multiplied by each factor, from the open-loop poles to the zeros.

    Args:
        axes: drawn on in Hz.
        loop: the loop at factor 1.
        factors: positive and ascending, as of `root_branches`.
        marked: factors to mark with squares, by label.
    """
    branches = root_branches(loop, factors) / (2 * pi)
    axes.plot(branches.real, branches.imag, color="0.45", linewidth=1.3)
    for (label, factor), marker in zip(marked.items(), "sD^v<>"[: len(marked)], strict=True):
        at = _poles(loop, factor) / (2 * pi)
        axes.plot(at.real, at.imag, marker, color="black", markersize=5, fillstyle="none", label=label)
    return plot_pole_zero(axes, loop.open_loop_poles(), loop.open_loop_zeros())


STEP = 0.01
"""Longest step along a branch of a root locus, as a share of the root's distance from the origin."""


def root_branches(loop: LoopAtMass, factors: Sequence[float]) -> np.ndarray:
    """Closed-loop poles as the gain is multiplied by each factor, each column the path of one root; (gains, n), rad/s.

    From gain to gain roots are told apart by which lie nearest. Where one moves by more than `STEP`, as it does where
    branches meet, further gains are put between, until the two are equal to nine digits.

    Args:
        loop: the loop at factor 1.
        factors: positive and ascending; the gains drawn at least.
    """
    from scipy.optimize import linear_sum_assignment

    poles = cache(lambda factor: _poles(loop, factor))
    least = 0.01 * np.abs(loop.open_loop_poles()).max()  # nearer to the origin steps are no shorter than there
    at, branches, waiting = factors[0], [poles(factors[0])], list(reversed(factors[1:]))
    while waiting:
        factor, here = waiting[-1], branches[-1]
        _, order = linear_sum_assignment(np.abs(here[:, None] - poles(factor)[None, :]))
        there = poles(factor)[order]
        if (np.abs(there - here) > STEP * np.maximum(np.abs(there), least)).any() and factor > at * (1 + 1e-9):
            waiting.append(sqrt(at * factor))
        else:
            at = waiting.pop()
            branches.append(there)
    return np.array(branches)


def _poles(loop: LoopAtMass, factor: float) -> np.ndarray:
    return LoopAtMass(loop.loop_denominator, loop.loop_numerator * exact(factor), loop.disturbance).poles()


def plot_pole_zero(axes: Axes, poles: np.ndarray, zeros: np.ndarray) -> Axes:
    """Poles as crosses and zeros as circles, given in rad/s and drawn in Hz, with the stability boundary drawn in."""
    for roots, marker, label in ((poles, "x", "open-loop poles"), (zeros, "o", "zeros")):
        x, y = roots.real / (2 * pi), roots.imag / (2 * pi)
        axes.plot(x, y, marker, color="black", markersize=7, fillstyle="none", label=label)
    axes.axvline(0.0, **LIMIT)
    axes.axhline(0.0, color="0.7", linewidth=0.6)
    return finish(axes, "real part, Hz", "imaginary part, Hz")


def plot_sensitivity(axes: Axes, curves: Curves, limit: float = 2.0) -> Axes:
    """Sensitivity |S| = |1 / (1 + L)| over frequency, with the limit on its peak."""
    frequencies = frequency_grid(list(curves.values()))
    for label, loop, style in styled(curves):
        peak = loop.peak_sensitivity()
        shown = f"{label}, peak {peak:.2f}" if isfinite(peak) else f"{label}, unstable"
        axes.loglog(frequencies, np.abs(loop.sensitivity_response(frequencies)), label=shown, linewidth=1.3, **style)
    axes.axhline(limit, label=f"limit {limit:g}", **LIMIT)
    _frequency_axis(axes, frequencies)
    plain_numbers(axes.yaxis)
    return finish(axes, y="|S|")


def plot_critical_gain(axes: Axes, masses_kg: Sequence[float], curves: Mapping[str, Sequence[float]]) -> Axes:
    """Critical gain in mA/V, or large ones in A/V, over the outer end mass; a jump is left as a gap.

    Args:
        axes: drawn on.
        masses_kg: outer end masses, ascending.
        curves: critical gains in A/V, one per mass, by label.
    """
    unit, factor = read_in(min((gain for gains in curves.values() for gain in gains), default=0.0), "A/V")
    for label, gains, style in styled(curves):
        known, masses = np.where(np.isfinite(gains), gains, np.nan), np.asarray(masses_kg)
        ratios = known[1:] / known[:-1]
        jumps = np.flatnonzero(~((ratios > 0.5) & (ratios < 2))) + 1
        x, y = np.insert(masses, jumps, masses[jumps]), np.insert(factor * known, jumps, np.nan)
        axes.semilogy(x, y, label=label, linewidth=1.3, **style)
    axes.set_xlim(masses_kg[0], masses_kg[-1])
    plain_numbers(axes.yaxis)
    return finish(axes, "outer end mass, kg", f"critical gain, {unit}")


def _frequency_axis(axes: Axes, frequency_Hz: np.ndarray) -> None:
    axes.set(xlim=(frequency_Hz[0], frequency_Hz[-1]), xlabel="frequency, Hz")
    plain_numbers(axes.xaxis)
