"""Exact proofs beside what one would use without them: one table of costs, ratios and what each method misses.

python studies/benchmarks/side_by_side.py [ROW ...] [--quick] [--repeats N] [--json FILE]

Rows: what is stable of the paper's remedy; whether a loop is stable over a range; its guaranteed figures; an unstable
range of 1 g; a sharp peak; tuning; random candidates. Costs are medians in this one process (what takes seconds is done
once), and ratios those against the first method of the row, which proves its answer. Ratios of CPU time are the ones to
quote where the machine is shared. Nothing here is a pass or a fail.
"""

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from candidates import around, compare_candidates, drawn, tuner_box
from comparison import QUICK, Comparison, Effort, record, table
from evolution import compare_tuners
from whole_range import Rig, compare_performance, compare_ranges, compare_stability

from beamdesign import Prototype, read_prototype
from beamdesign.controllers import Lag
from beamdesign.loop import loop
from beamdesign.polynomial import exact
from beamdesign.proofs.stability import stable_ranges
from beamdesign.prototype import Payload

REMEDY = Path(__file__).parent.parent / "prototypes" / "paper_remedy.toml"
PAYLOADS_KG = (0.0, 6.8)
WINDOW_KG = 1e-3
HIGH_KG = 20.0
_WIDE, _NONE = 0.015, 0.012  # A/V: gains with a wide unstable range, and with none


def lightly_damped(paper_remedy: Prototype, gain_A_per_V: float) -> Prototype:
    """The published rig with less damping and a slower sensor, and a lag with the given gain.

    It has an unstable range of outer end masses between two stable ones, which shrinks to nothing as the gain falls (a
    tangency), thinner than any grid.
    """
    return paper_remedy.but(
        name="lightly_damped",
        outer_beam=paper_remedy.outer_beam.but(damping_ratio=0.01),
        inner_beam=paper_remedy.inner_beam.but(damping_ratio=0.01),
        sensor=paper_remedy.sensor.but(filter_Hz=25.0),
        controller=Lag(gain_A_per_V=gain_A_per_V, pole_Hz=1.0, zero_Hz=30.0),
        payload=Payload(inner_end_mass_kg=5.4),
    )


def unstable_width(prototype: Prototype) -> float:
    """Distance in kg between the two stable ranges; 0 where all masses are stable."""
    found = stable_ranges(loop(prototype).characteristic, exact(0.0), exact(HIGH_KG))
    if found.stable:
        return 0.0
    (_, closes), (opens, _) = found.stable_ranges
    return opens - closes


def narrowed(paper_remedy: Prototype, width_kg: float) -> Prototype:
    """That rig with the gain, to 12 digits, whose unstable range is nearest to a given width; crossings are exact."""
    none, wide = _NONE, _WIDE
    while (middle := float(f"{(none + wide) / 2:.12g}")) not in (none, wide):
        if unstable_width(lightly_damped(paper_remedy, middle)) < width_kg:
            none = middle
        else:
            wide = middle
    return lightly_damped(paper_remedy, wide)


def _remedy() -> Prototype:
    return read_prototype(REMEDY)


def _slowed() -> Prototype:
    """The paper's remedy at the gain that keeps peak sensitivity 2 over its payloads."""
    return _remedy().but(controller=Lag(gain_A_per_V=0.057, pole_Hz=1.75, zero_Hz=26.0))


def _ranges(effort: Effort) -> Comparison:
    question = "which outer end masses of 0 to 20 kg are stable with the paper's remedy?"
    return compare_ranges(Rig(_remedy(), 20.0, effort), effort, "ranges", question)


def _stability(effort: Effort) -> Comparison:
    question = "is every outer end mass of 0 to 6.8 kg stable (the remedy at 57 mA/V)?"
    return compare_stability(Rig(_slowed(), PAYLOADS_KG[1], effort), effort, "stability", question)


def _performance(effort: Effort) -> Comparison:
    question = "which bandwidth and peak sensitivity hold for all of them (the remedy at 57 mA/V)?"
    return compare_performance(Rig(_slowed(), PAYLOADS_KG[1], effort), effort, "performance", question)


def _window(effort: Effort) -> Comparison:
    thin = narrowed(_remedy(), WINDOW_KG)
    question = f"which masses of 0 to {HIGH_KG:g} kg are stable, where 1 g of them is not?"
    return compare_ranges(Rig(thin, HIGH_KG, effort), effort, "window", question)


def _peak(effort: Effort) -> Comparison:
    thin = narrowed(_remedy(), WINDOW_KG)
    assert thin.controller is not None
    lower = lightly_damped(_remedy(), float(f"{0.9 * thin.controller.gain_A_per_V:.6g}"))
    question = "which peak sensitivity has that rig with a tenth less gain?"
    return compare_performance(Rig(lower, HIGH_KG, effort), effort, "peak", question)


def _tuner(effort: Effort) -> Comparison:
    question = f"which {effort.kind} controller and inner end mass give the largest bandwidth for 0 to 6.8 kg?"
    return compare_tuners(_remedy(), PAYLOADS_KG, effort, "tuner", question)


def _box(effort: Effort) -> Comparison:
    found = drawn("lag", effort.candidates, *tuner_box("lag"))
    question = f"which of {effort.candidates} random candidates of the tuner's box are stable (each)?"
    return compare_candidates(_remedy(), found, PAYLOADS_KG, effort, "candidates", question)


def _neighbours(effort: Effort) -> Comparison:
    slowed = _slowed()
    assert isinstance(slowed.controller, Lag)
    box = around(slowed.controller, slowed.payload.inner_end_mass_kg, 0.2)
    question = f"which of {effort.candidates} within 20 % of the remedy at 57 mA/V are stable (each)?"
    found = drawn("lag", effort.candidates, *box)
    return compare_candidates(_remedy(), found, PAYLOADS_KG, effort, "neighbours", question)


ROWS: dict[str, Callable[[Effort], Comparison]] = {
    "ranges": _ranges,
    "stability": _stability,
    "performance": _performance,
    "window": _window,
    "peak": _peak,
    "tuner": _tuner,
    "candidates": _box,
    "neighbours": _neighbours,
}


def main(arguments: Sequence[str] | None = None) -> list[Comparison]:
    """Run the rows that were asked for, print the table, and give back what is in it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("rows", nargs="*", metavar="ROW", help=f"of {', '.join(ROWS)}; all where none is named")
    parser.add_argument("--quick", action="store_true", help="few repeats, proportional tuning, few candidates")
    parser.add_argument("--repeats", type=int, help="of what takes milliseconds")
    parser.add_argument("--json", type=Path, help="also write the table to this file")
    asked = parser.parse_args(arguments)
    if unknown := [row for row in asked.rows if row not in ROWS]:
        parser.error(f"no row {', '.join(unknown)}; there are {', '.join(ROWS)}")
    if asked.repeats is not None and asked.repeats < 1:
        parser.error("--repeats must be at least 1")
    effort = QUICK if asked.quick else Effort()
    if asked.repeats is not None:
        effort = replace(effort, repeats=asked.repeats)
    found = [ROWS[row](effort) for row in asked.rows or ROWS]
    print(table(found))
    if asked.json:
        asked.json.write_text(json.dumps([record(comparison) for comparison in found], indent=2), encoding="utf-8")
    return found


if __name__ == "__main__":
    main()
