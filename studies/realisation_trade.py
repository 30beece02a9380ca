"""What sampling rate and word length cost a controller in margin, as a table and a picture.

python studies/realisation_trade.py PROTOTYPE.toml PICTURE.svg
"""

import sys
from pathlib import Path

from rate_and_word import RATES_HZ, WORDS, RateAndWord, sufficient, trade
from realisation_picture import plot_rounding, plot_sensitivity

from beamdesign import Prototype, read_prototype
from beamdesign.report.canvas import new_figure, save

ROUNDING_M = 1e-6


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
