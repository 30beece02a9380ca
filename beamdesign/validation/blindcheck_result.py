"""The result of a blind check: fields for programs, rows for tables, a page of Markdown, a picture."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from beamdesign.files import write_whole
from beamdesign.report.canvas import new_figure, save
from beamdesign.report.page import text_template
from beamdesign.result import Result, finite, picked
from beamdesign.spelling import in_markdown
from beamdesign.validation.baselines import NAMES
from beamdesign.validation.bounds import clopper_pearson
from beamdesign.validation.case_plan import SHARES
from beamdesign.validation.scoring import (
    NO_GAP,
    SMALL,
    Bin,
    Outcome,
    Score,
    baseline_scores,
    calibration,
    scores,
    split,
)

TARGET_COLUMNS = ("", "found", "95 % bounds", "of", "target", "reached")
BASELINE_COLUMNS = ("", "diagnosis", *NAMES)


@dataclass(frozen=True, repr=False)
class Scored(Result):
    """A blind check whose answers have been opened.

    Attributes:
        outcomes: of the cases that were diagnosed.
        setting: what the check was: its cases, seed, seal and programs.
    """

    outcomes: tuple[Outcome, ...]
    setting: Mapping[str, Any]

    @property
    def reason(self) -> str:
        """Why there is nothing to score."""
        return "" if self.outcomes else "no case is finished"

    def to_dict(self) -> dict[str, Any]:
        """Everything that the check has shown, as it stands in result.json."""
        if not self.outcomes:
            return dict(self.setting)
        large, small = split(self.outcomes)

        def rows(found: Sequence[Score]) -> list[dict[str, Any]]:
            return [asdict(score) | {"reached": score.reached} for score in found]

        fields = {
            "setting": dict(self.setting),
            "scores": rows(scores(large)),
            "scores_of_rigs": {rig: rows(found) for rig, found in of_rigs(large).items()},
            "scores_small_gaps": rows(scores(small)) if small else [],
            "baselines": {name: rows(baseline_scores(name, large)) for name in NAMES},
            "confusion": confusion(large),
            "confusion_small_gaps": confusion(small),
            "reliability": [asdict(b) for b in calibration(large)[0]],
            "cases": [picked(o, _OF_CASES) | ({"failure": o.failure} if o.failure else {}) for o in self.outcomes],
        }
        return dict(finite(fields, digits=4))

    def rows(self) -> list[tuple[str, ...]]:
        """Scores beside their targets, of the cases whose gap stands out."""
        return target_rows(scores(split(self.outcomes)[0])) if self.outcomes else []

    def markdown(self) -> str:
        """The same as a page for people, from the template beside this module."""
        large, small = split(self.outcomes)
        given = {
            "kinds": {kind: sum(o.kind == kind for o in self.outcomes) for kind in SHARES},
            "small_rows": [row[:4] for row in target_rows([score for score in scores(small) if score.of])],
            "rig_rows": [
                (rig, *(f"{s.count} of {s.of}" if s.count is not None else _figure(s, s.value) for s in found))
                for rig, found in of_rigs(large).items()
            ],
            "rig_columns": ("", *OF_RIGS.values()),
            "target_columns": TARGET_COLUMNS,
            "baseline_columns": BASELINE_COLUMNS,
        }
        own = (scores, confusion, calibration, columns_of, target_rows, baseline_rows)
        spelt: dict[str, Any] = {
            "md": lambda cell: in_markdown(str(cell)),
            "flowed": lambda text: " ".join(text.split()),
        }
        template = text_template(Path(__file__).with_name("blindcheck.md.j2"), *own, **spelt)
        return template.render(given, **vars(self), least=SMALL, large=large, small=small).rstrip() + "\n"

    def write(self, folder: Path) -> tuple[Path, ...]:
        """Write result.json, result.md and result.svg, and tell where."""
        paths = folder / "result.json", folder / "result.md"
        write_whole(paths[0], result_text(self.to_dict()))
        write_whole(paths[1], self.markdown())
        return *paths, *save(blindcheck_picture(self.outcomes), folder / "result", ("svg",))


_OF_CASES = (
    "case=key kind rig figures truth=effects gap_over_floor verdict chosen named on_truth no_gap unknown where"
    " where_truly=subsystem closed interval closed_truly left parameter_error seconds baselines"
)
"""What is told of each case."""


def result_text(fields: Mapping[str, Any]) -> str:
    """The fields as JSON, one row of a list to a line: small, and two results can be compared line by line."""
    dumps = partial(json.dumps, allow_nan=False)
    parts = []
    for key, value in fields.items():
        text, rows = dumps(value), list[str]()
        if isinstance(value, list):
            rows = [dumps(row) for row in value]
        elif isinstance(value, dict):
            rows = [f"{dumps(name)}: {dumps(row)}" for name, row in value.items()]
        inside = ",\n  ".join(rows)
        parts.append(f"{dumps(key)}: " + (f"{text[0]}\n  {inside}\n {text[-1]}" if rows else text))
    return "{\n " + ",\n ".join(parts) + "\n}\n"


OF_RIGS = {
    "gap detected": "gap detected", "false alarms": "false alarms", "single effect named first": "single named first",
    "exact pair": "exact pair", "dominant of three named first": "dominant of three",
    "subsystem right, known causes": "subsystem",
    "outside the library, confidently wrong": "outside, confidently wrong", "diagnosis broke off": "broke off",
}  # fmt: skip
"""Scores that are told of each kind of rig, with the heads of their columns."""
WITH_FIGURES = "records and figures"
"""Stands for a kind of rig in the row of the cases with frequency responses and critical gains beside the records."""


def of_rigs(outcomes: Sequence[Outcome]) -> dict[str, list[Score]]:
    """Scores of the cases of each kind of rig, where there are several kinds, and of those with more than records."""
    rigs = sorted({o.rig for o in outcomes})
    found = {rig: scores([o for o in outcomes if o.rig == rig]) for rig in rigs} if len(rigs) > 1 else {}
    if more := [o for o in outcomes if o.figures and o.kind != "alone"]:
        found[WITH_FIGURES] = scores(more)
    return {rig: [score for score in every if score.name in OF_RIGS] for rig, every in found.items()}


def target_rows(found: Sequence[Score]) -> list[tuple[str, ...]]:
    """Scores beside their targets, for `TARGET_COLUMNS`."""
    rows: list[tuple[str, ...]] = []
    for s in found:
        of = f"{s.count} of {s.of}" if s.count is not None else f"{s.of}"
        bounds = f"{_figure(s, s.low)} to {_figure(s, s.high)}" if isfinite(s.low) and s.of else ""
        reached = "" if s.reached is None else "yes" if s.reached else "no"
        rows.append((s.name, _figure(s, s.value), bounds, of, _target(s), reached))
    return rows


def baseline_rows(outcomes: Sequence[Outcome]) -> list[tuple[str, ...]]:
    """The diagnosis beside the baselines, for `BASELINE_COLUMNS`."""
    every = (scores(outcomes), *(baseline_scores(name, outcomes) for name in NAMES))
    ours, *others = ({s.name: _figure(s, s.value) for s in found} for found in every)
    return [(name, ours.get(name, ""), *(other[name] for other in others)) for name in others[0]]


def _figure(score: Score, value: float) -> str:
    if not isfinite(value) or not score.of:
        return "-"
    return f"{value:.1%}" if score.count is not None or score.name.startswith("mean prob") else f"{value:.3g}"


def _target(score: Score) -> str:
    if score.target is None:
        return ""
    shown = [f"{t:.0%}" if score.name != "calibration error" else f"{t:g}" for t in score.target]
    return f"{score.sense} {' and '.join(shown)}"


def columns_of(found: Mapping[str, Mapping[str, int]]) -> list[str]:
    """Of a matrix of confusion: wrong figures stand last."""
    return sorted({name for row in found.values() for name in row}, key=lambda n: (n.startswith("parameter:"), n))


def blindcheck_picture(outcomes: Sequence[Outcome]) -> Figure:
    """Both, over nulls and large gaps."""
    large, _ = split(outcomes)
    matrix, (bins, _) = confusion(large), calibration(large)
    figure = new_figure(240.0, max(80.0, 4.6 * len(matrix) + 40.0))
    left, right = figure.subplots(1, 2, width_ratios=(2.2, 1))
    draw_confusion(left, matrix)
    draw_reliability(right, bins)
    return figure


def confusion(outcomes: Sequence[Outcome]) -> dict[str, dict[str, int]]:
    """How often each truth (row) was named as what (column); rows and columns in order of their names."""
    rows: dict[str, Counter[str]] = {}
    for o in outcomes:
        rows.setdefault(o.label, Counter())[o.named] += 1
    return {label: dict(sorted(rows[label].items())) for label in sorted(rows, key=_place)}


def _place(label: str) -> tuple[int, str]:
    order = 0 if label == NO_GAP else 4 if ":" in label.removeprefix("parameter:") else 3 if label.endswith("+") else 1
    return (2 if label.startswith("parameter:") and order == 1 else order, label)


def draw_confusion(axes: Axes, matrix: Mapping[str, Mapping[str, int]]) -> None:
    """Counts, on a grey that goes with their share of the row; a frame where the name is right."""
    rows = list(matrix)
    named = {name for row in matrix.values() for name in row}
    columns = [label for label in rows if label in named] + sorted(named - set(rows))
    counts = np.array([[matrix[row].get(column, 0) for column in columns] for row in rows], dtype=float)
    share = counts / counts.sum(axis=1, keepdims=True)
    axes.imshow(share, cmap="Greys", vmin=0.0, vmax=2.2, aspect="auto")
    for i, row in enumerate(rows):
        for j, column in enumerate(columns):
            if counts[i, j]:
                axes.text(j, i, f"{counts[i, j]:.0f}", ha="center", va="center", fontsize=7)
            right = column == row.removeprefix("without records: ").partition(" +")[0]
            if right or (row.startswith("outside: ") and column == "unknown"):
                axes.plot(
                    (j - 0.5, j + 0.5, j + 0.5, j - 0.5, j - 0.5), (i - 0.5, i - 0.5, i + 0.5, i + 0.5, i - 0.5), "k"
                )
    axes.set_xticks(range(len(columns)), columns, rotation=60, ha="right", fontsize=7)
    axes.set_yticks(range(len(rows)), rows, fontsize=7)
    axes.set_xlabel("named first")
    axes.set_title("Truth (rows) and what was named; framed: right", fontsize=9)


def draw_reliability(axes: Axes, bins: Sequence[Bin]) -> None:
    """Share of statements that are true over the probability stated, with 95 % bounds."""
    axes.plot((0, 1), (0, 1), color="0.6", linestyle="--", label="calibrated")
    for b in bins:
        axes.plot((b.stated, b.stated), clopper_pearson(round(b.true * b.count), b.count), color="0.5")
    axes.plot([b.stated for b in bins], [b.true for b in bins], "ko", label="found, 95 % bounds")
    axes.set_xlabel("probability stated")
    axes.set_ylabel("share that is true")
    axes.set_title("Calibration", fontsize=9)
    axes.legend(fontsize=7)
