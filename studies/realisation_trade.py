"""What sampling rate and word length cost a controller in margin, as a table and a picture.

python studies/realisation_trade.py PROTOTYPE.toml PICTURE.svg
"""

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import inf, isfinite
from pathlib import Path

from matplotlib.axes import Axes

from beamdesign import Prototype, read_prototype
from beamdesign.build.realisation.code import LoopFigures, figures_at, loop_figures, masses_between, worst
from beamdesign.build.realisation.loop import prove_sampled, realised_loop
from beamdesign.build.realisation.realise import FULL_SCALE_V, realise
from beamdesign.loop import loop
from beamdesign.report.canvas import STYLES, new_figure, plain_numbers, save

RATES_HZ = (500.0, 1000.0, 2000.0, 5000.0, 10000.0, 20000.0)
WORDS: tuple[int | None, ...] = (8, 10, 12, 16, 24, 32, None)
ROUNDING_M = 1e-6
_MARKERS = "s^Dvx+"


@dataclass(frozen=True)
class RateAndWord:
    """A controller at a rate in a word length, judged over a range of payloads.

    Attributes:
        rate_Hz: sampling rate.
        word_length: bits; None for floats of 32 bits.
        continuous: worst figures of the design over the masses looked at.
        at_once: as realised, the current put out at its sample; None where it cannot be realised.
        late: likewise one period later.
        proved: whether stability one period late is proved for the whole range; None where that is open or not asked.
        rounding_m: largest motion of the tip by rounding, one period late; infinite where that loop is not stable.
        expected_rounding_m: root mean square of it, likewise.
        reason: why it cannot be realised or proved; empty where it is.
    """

    rate_Hz: float
    word_length: int | None
    continuous: LoopFigures
    at_once: LoopFigures | None
    late: LoopFigures | None
    proved: bool | None
    rounding_m: float
    expected_rounding_m: float
    reason: str

    @property
    def lost_sensitivity(self) -> float:
        """What the peak sensitivity one period late is above that of the design."""
        return inf if self.late is None else self.late.peak_sensitivity - self.continuous.peak_sensitivity


def trade(
    prototype: Prototype,
    masses_kg: tuple[float, float],
    rates_Hz: Iterable[float] = RATES_HZ,
    words: Sequence[int | None] = WORDS,
    full_scale_V: float = FULL_SCALE_V,
    looked_at: int = 5,
    prove: bool = True,
    progress: Callable[[float, float], None] = lambda rate_Hz, word: None,
) -> list[RateAndWord]:
    """Realise a prototype's controller at every rate in every word length.

    Args:
        prototype: with a controller, without effects.
        masses_kg: range of outer end mass.
        rates_Hz: sampling rates.
        words: word lengths, None for floats.
        full_scale_V: largest error.
        looked_at: number of masses at which figures are computed.
        prove: whether each loop is proved over the range, which takes most of the time.
        progress: told rate and word length (0 for floats) of what comes next.

    Raises:
        InputError: for a prototype with effects.
        ValueError: without a controller.
    """
    if prototype.controller is None:
        raise ValueError("the prototype has no [controller]")
    rows = []
    masses = masses_between(masses_kg, looked_at)
    design = worst([loop_figures(loop(prototype).at(mass)) for mass in masses])
    for rate in rates_Hz:
        for word in words:
            progress(rate, word or 0)
            try:
                made = realise(prototype.controller, rate, word, full_scale_V)
            except ValueError as error:
                rows.append(RateAndWord(rate, word, design, None, None, None, inf, inf, str(error)))
                continue
            found = [figures_at(prototype, made, mass) for mass in masses]
            verdict = prove_sampled(realised_loop(prototype, made), *masses_kg) if prove else None
            effects = [at.rounding for at in found]
            most = max(inf if one is None else one.displacement_m for one in effects)
            expected = max(inf if one is None else one.expected_displacement_m for one in effects)
            rows.append(
                RateAndWord(
                    rate,
                    word,
                    design,
                    worst([at.at_once for at in found]),
                    worst([at.late for at in found]),
                    None if verdict is None else verdict.stable,
                    most,
                    expected,
                    "" if verdict is None else verdict.reason,
                )
            )
    return rows


def sufficient(rows: Sequence[RateAndWord], peak_sensitivity: float, rounding_m: float) -> RateAndWord | None:
    """The lowest rate, and at it the shortest word, that is proved and keeps both limits one period late.

    Args:
        rows: of `trade`.
        peak_sensitivity: largest allowed.
        rounding_m: largest motion of the tip by rounding allowed.
    """
    enough = [
        row
        for row in rows
        if row.proved
        and row.late is not None
        and row.late.peak_sensitivity <= peak_sensitivity
        and row.rounding_m <= rounding_m
    ]
    return min(enough, key=lambda row: (row.rate_Hz, row.word_length or 33), default=None)


def plot_sensitivity(axes: Axes, rows: Sequence[RateAndWord], goal: float | None = None) -> Axes:
    """Worst peak sensitivity over the rate, at once and one period late, in the longest words and in shorter ones.

    Args:
        axes: drawn on.
        rows: of `trade`.
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
        rows: of `trade`.
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
    plain_numbers(axes.xaxis)
    axes.grid(which="both", color="0.85", linewidth=0.6)


def _word(word: int | None) -> str:
    return "floats" if word is None else f"{word} bits"


def draw(rows: list[RateAndWord], goal: float, picture: Path) -> Path:
    """Draw a trade and give the path of the SVG file."""
    figure = new_figure(190, 85)
    left, right = figure.subplots(1, 2)
    plot_sensitivity(left, rows, goal)
    plot_rounding(right, rows, ROUNDING_M)
    return save(figure, picture.with_suffix(""), ("svg",))[0]


def table(rows: list[RateAndWord]) -> list[str]:
    """One line per rate and word length."""
    lines = ["rate, Hz   bits  proved  peak sensitivity at once / late  gain margin  phase, deg  rounding, um"]
    for row in rows:
        word = "float" if row.word_length is None else f"{row.word_length}"
        if row.at_once is None or row.late is None:
            lines.append(f"{row.rate_Hz:8g}  {word:>5}  {row.reason}")
            continue
        proved = {True: "yes", False: "no", None: "open"}[row.proved]
        lines.append(
            f"{row.rate_Hz:8g}  {word:>5}  {proved:>6}  {row.at_once.peak_sensitivity:18.4f} / "
            f"{row.late.peak_sensitivity:<10.4f}  {row.late.gain_up:11.4f}  {row.late.phase_deg:10.2f}  "
            f"{1e6 * row.rounding_m:12.3g}"
        )
    return lines


def words_on(prototype: Prototype, rows: list[RateAndWord]) -> str:
    """What suffices, in one sentence."""
    goal = prototype.goal.peak_sensitivity
    found = sufficient(rows, goal, ROUNDING_M)
    limits = f"the peak sensitivity within {goal:g} and what rounding moves below {1e6 * ROUNDING_M:g} um"
    if found is None or found.late is None:
        return f"{prototype.name}: none of these keeps {limits}."
    word = "floats" if found.word_length is None else f"{found.word_length} bits"
    return (
        f"{prototype.name}: {found.rate_Hz:g} Hz and {word} suffice, proved with the current one period late: they keep"
        f" {limits} (peak sensitivity {found.late.peak_sensitivity:.4f} instead of"
        f" {found.continuous.peak_sensitivity:.4f})."
    )


def main(prototype: Prototype, picture: Path) -> list[str]:
    """Work out the trade, draw it, and give what is to be printed."""
    masses = prototype.payload.outer_end_mass_kg or (0.0, 0.0)
    rows = trade(prototype, masses, RATES_HZ, WORDS)
    return [*table(rows), words_on(prototype, rows), str(draw(rows, prototype.goal.peak_sensitivity, picture))]


if __name__ == "__main__":
    given, target = sys.argv[1:]
    print("\n".join(main(read_prototype(given), Path(target))))
