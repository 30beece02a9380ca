"""What a finished sweep comes to: yield of a specification, worst and best case, sensitivities; and its pictures.

Pictures are as the sweep's file asks for them: readable in grey, with units and limits. Stable bands over a varied
figure come from the columns of a sweep's table that list their lower and upper ends.
"""

from collections.abc import Callable, Mapping, Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from beamdesign.quantities import decimal, parted
from beamdesign.report.canvas import STYLES, Place, finish, new_figure, save, styled
from beamdesign.report.charts import plot_stable_bands
from beamdesign.spelling import in_plot
from beamdesign.sweep.methods import NO_RESULT, Plan, cost, figures_of
from beamdesign.sweep.store import idle_keys
from beamdesign.sweep.sweep_file import PICTURES, Demand, Picture, Sweep, value_at
from beamdesign.sweep.sweep_run import cell

Row = Mapping[str, Any]


def conclude(laid: Plan, records: Sequence[Row]) -> dict[str, Any]:
    """What the rows of a sweep come to, by what its method is for; plain values."""
    sweep = laid.sweep
    found: dict[str, Any] = {}
    if sweep.specification and records:
        found["specification"] = met(sweep, records)
    if sweep.study.method == "optimise" and sweep.optimise is not None:
        found["best"] = _extreme(records, sweep.optimise.output, sweep.optimise.goal == "maximise")
    if sweep.study.method == "worst_case" and sweep.spread.output is not None:
        found["worst"] = _worst(sweep, records)
    if sweep.study.method == "sensitivity":
        found["sensitivity"] = sensitivity(laid, records)
    if idle := idle_keys(records):
        found["idle_keys"] = idle
    return found


def met(sweep: Sweep, records: Sequence[Row]) -> dict[str, Any]:
    """How many rows meet the specification. Only rows that are done can; yields only come from random samples."""
    from beamdesign.validation.bounds import clopper_pearson

    each = {
        name: [row["status"] == "done" and holds(demand, row["outputs"].get(name)) for row in records]
        for name, demand in sweep.specification.items()
    }
    passed = sum(map(all, zip(*each.values(), strict=True)))
    found: dict[str, Any] = {"met": passed, "of": len(records), "each": {name: sum(one) for name, one in each.items()}}
    if sweep.study.method == "tolerance":
        low, high = clopper_pearson(passed, len(records), sweep.spread.confidence)
        found |= {"yield": passed / len(records), "bounds": [low, high], "confidence": sweep.spread.confidence}
    return found


def holds(demand: Demand, value: Any) -> bool:
    """Whether an output meets a demand; one that is missing does not."""
    if value is None:
        return False
    if demand.equals is not None:
        return bool(value == demand.equals)
    if isinstance(value, str | list):
        return False
    return (demand.at_least is None or value >= demand.at_least) and (demand.at_most is None or value <= demand.at_most)


def _extreme(records: Sequence[Row], output: str, largest: bool) -> dict[str, Any] | None:
    found = [(cost(row, output, largest), number) for number, row in enumerate(records)]
    least, number = min(found, default=(NO_RESULT, 0))
    if least == NO_RESULT:
        return None
    row = records[number]
    return {"case": number, "output": output, "value": row["outputs"][output], "varied": row["varied"]}


def _worst(sweep: Sweep, records: Sequence[Row]) -> dict[str, Any] | None:
    """The worst row that the search met: one whose answer is no, or else the extreme value."""
    refusing = [number for number, row in enumerate(records) if row["status"] == "no"]
    output = sweep.spread.output or ""
    if refusing:
        row = records[refusing[0]]
        value = row["outputs"].get(output)
        return {"case": refusing[0], "output": output, "value": value, "reason": row["reason"], "varied": row["varied"]}
    return _extreme(records, output, sweep.spread.worst == "largest")


def sensitivity(laid: Plan, records: Sequence[Row]) -> list[dict[str, Any]]:
    """Sobol indices of outputs over the spreading figures, first-order and total, with half-widths of 95 %.

    Saltelli et al., Computer Physics Communications 181 (2010) 259-270, as SALib has it. An index is the share of an
    output's variance; figures of the payload range and of the beams spread as `beamdesign.sweep.methods` says. Of fewer
    than `BOUNDED_FROM` samples the half-widths are None.
    """
    from SALib.analyze import sobol

    outputs, figures = laid.sweep.spread.outputs, figures_of(laid.sweep, laid.base, laid.path)
    names = [figure.key for figure in figures]
    bounded = len(laid.cases) >= BOUNDED_FROM * (len(names) + 2)
    problem = {"num_vars": len(names), "names": names, "bounds": [[0, 1]] * len(names)}
    by_address = {row["address"]: row for row in records}
    rows = [by_address[one.address] for one in laid.cases]  # as drawn: a sample that comes twice is one row
    found: list[dict[str, Any]] = []
    for output in outputs:
        values = [row["outputs"].get(output) for row in rows]
        series = np.array(values, dtype=float)
        note = "does not vary" if np.ptp(series) == 0 else ""
        if missing := int(np.isnan(series).sum()):
            note = f"{missing} of {len(values)} cases have no number there"
        if note:
            found += [{"output": output, "figure": name, "note": note} for name in names]
            continue
        indices = sobol.analyze(problem, series, calc_second_order=False, seed=laid.sweep.study.seed)
        for k, name in enumerate(names):
            row = {
                column: float(indices[source][k]) if bounded or source in ("S1", "ST") else None
                for column, source in _INDICES.items()
            }
            found.append({"output": output, "figure": name, **row, "note": ""})
    return found


_INDICES = {"first_order": "S1", "first_order_half_width": "S1_conf", "total": "ST", "total_half_width": "ST_conf"}
"""Columns of the table of sensitivities, by SALib's names."""

BOUNDED_FROM = 128
"""Samples from which half-widths are told. They come of drawing the samples again, as if each were independent, which
those of a Sobol sequence in 2 D dimensions are not: of a sum of 13 figures, half-widths of 95 % from 32 samples hold in
45 to 100 % of draws, from 64 in 73 to 100 %, from 128 in 93 % at least."""


def in_words(found: Mapping[str, Any], sweep: Sweep) -> list[str]:
    """The conclusions as sentences."""
    said = [f"{key} changes no result; a measured figure may stand before it" for key in found.get("idle_keys", ())]
    if (asked := found.get("specification")) is not None:
        line = f"specification met by {asked['met']} of {asked['of']} cases"
        if "yield" in asked:
            low, high = asked["bounds"]
            share, least = (decimal(value, 3, ROUND_FLOOR) for value in (100 * asked["met"] / asked["of"], 100 * low))
            line += (
                f": yield {share} %, {100 * asked['confidence']:g} % bounds {least} to"
                f" {decimal(100 * high, 3, ROUND_CEILING)} % (sampled, no proof; `beamdesign certify-box` is one)"
            )
        said.append(line)
        parts = [f"{name} by {count}" for name, count in asked["each"].items()]
        if len(parts) > 1:
            said.append(f"  of its demands: {', '.join(parts)}")
    notes = {row["output"]: row["note"] for row in found.get("sensitivity", ()) if row["note"]}
    said += [f"no sensitivity of {output}: {note}" for output, note in notes.items()]
    rows = [row for row in found.get("sensitivity", ()) if not row["note"]]
    if any(row["total_half_width"] is None for row in rows):
        enough = BOUNDED_FROM * (len({row["figure"] for row in rows}) + 2)
        said.append(f"sensitivities are rough, without half-widths, which are told of {enough} cases and more")
    if "best" in found:
        best = found["best"]
        said.append(
            "no case is done, so there is no best one"
            if best is None
            else f"best {best['output']} found: {best['value']:.6g}, case {best['case']} (a search, no proof of a best)"
        )
    if "worst" in found:
        worst, reach = found["worst"], sweep.spread.sigmas
        if worst is None:
            said.append("no case has a result, so there is no worst one")
        elif worst.get("reason"):
            said.append(f"worst case within {reach:g} standard deviations: case {worst['case']}, {worst['reason']}")
        else:
            said.append(
                f"worst {worst['output']} found within {reach:g} standard deviations: {worst['value']:.6g},"
                f" case {worst['case']} (a search over corners, no proof; `beamdesign certify-box` proves stability)"
            )
    return said


def draw(sweep: Sweep, records: Sequence[Row], conclusion: Mapping[str, Any], folder: Path) -> list[Path]:
    """Draw every picture that a sweep asks for into a folder, as PNG and SVG; one without data says so."""
    written: list[Path] = []
    for number, asked in enumerate(sweep.picture):
        names = [str(getattr(asked, role)) for role in PICTURES[asked.kind][0]]
        if lacking := [name for name in names if all(value_of(row, name) is None for row in records)]:
            figure = new_figure(height_mm=60)
            axes = figure.add_subplot(title=in_plot(asked.title))
            axes.set_axis_off()
            axes.text(0.5, 0.5, f"no case has {', '.join(lacking)}", ha="center", transform=axes.transAxes)
        else:
            plot, height_mm, each_mm = _KINDS[asked.kind]
            plot(figure := new_figure(height_mm=height_mm + each_mm * len(records)), asked, records, *names)
        written += save(figure, folder / ("picture" if number == 0 else f"picture_{number + 1}"))
    if conclusion.get("sensitivity"):
        written += save(_sensitivity(conclusion["sensitivity"]), folder / "sensitivity")
    return written


def value_of(row: Row, name: str) -> Any:
    """A column of a row: an output, or as its cell has it a varied key, an option, or any key of its document."""
    if name in row["outputs"]:
        return row["outputs"][name]
    if name in row["varied"]:
        return cell(row["varied"][name])
    return cell(value_at({**row["document"], "options": row["options"]}, name))


def _number(row: Row, name: str) -> float | None:
    """A column of a row where it is a number, yes 1 and no 0; None for anything else, as of a refused case."""
    value = value_of(row, name)
    return float(value) if isinstance(value, int | float) else None


def _placed(records: Sequence[Row], *names: str) -> list[Row]:
    """Rows that have their places along axes: numbers, or texts where no row has a number."""
    found = list(records)
    for name in names:
        kind: Any = int | float if any(_number(row, name) is not None for row in found) else str
        found = [row for row in found if isinstance(value_of(row, name), kind)]
    return found


def _finish(axes: Axes, asked: Picture, x: str, y: str, legend: Place | None = "best") -> None:
    axes.set_title(in_plot(asked.title))
    finish(axes, in_plot(asked.x_label or words(x)), in_plot(asked.y_label or words(y)), legend)


def _limit(line: Callable[..., Any], asked: Picture, words: str = "limit {:g}") -> None:
    """Draw the limit of a picture that has one, in the direction of `line`."""
    if asked.limit is not None:
        line(asked.limit, color="black", linestyle=(0, (1, 1)), linewidth=1.0, label=words.format(asked.limit))


def words(name: str) -> str:
    """A column's name as a label: words, a comma, the unit."""
    return ", ".join(filter(None, parted(name.rpartition(".")[2].partition("[")[0])))


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float | int) else str(value)


def _groups(asked: Picture, records: Sequence[Row]) -> dict[str, list[Row]]:
    """Rows by the value of the series' column, in order of first appearance."""
    found: dict[str, list[Row]] = {}
    for row in records:
        label = asked.series_label or words(asked.series or "")
        name = "" if asked.series is None else f"{label}: {_text(value_of(row, asked.series))}"
        found.setdefault(in_plot(name), []).append(row)
    return found


def _lines(figure: Figure, asked: Picture, records: Sequence[Row], x: str, y: str) -> None:
    records = _placed(records, x)
    axes = figure.add_subplot()
    for name, rows, style in styled(_groups(asked, records)):
        there = [(value_of(row, x), _number(row, y)) for row in rows if _number(row, y) is not None]
        points = zip(*sorted(there), strict=True) if there else ((), ())
        axes.plot(*points, marker="o", ms=4, label=name or None, **style)
    missing = [value_of(row, x) for row in records if _number(row, y) is None]
    if missing:
        axes.plot(missing, [0.97] * len(missing), "kx", transform=axes.get_xaxis_transform(), label="no answer")
    _limit(axes.axhline, asked)
    _finish(axes, asked, x, y)


def _bars(figure: Figure, asked: Picture, records: Sequence[Row], x: str, y: str) -> None:
    names = [in_plot(_text(value_of(row, x))) for row in records]
    heights = [_number(row, y) or 0.0 for row in records]
    axes = figure.add_subplot()
    bars = axes.barh(range(len(names)), heights, color="0.7", edgecolor="black")
    answered = [row["status"] == "done" and _number(row, y) is not None for row in records]
    labels = [f"{height:.4g}" if one else "no answer" for height, one in zip(heights, answered, strict=True)]
    axes.bar_label(bars, labels, padding=4)
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.set_xlim(1.2 * min([*heights, 0.0]), 1.2 * max([*heights, 1e-12]))
    _limit(axes.axvline, asked)
    _finish(axes, asked, y, x, legend=None)
    axes.set(ylabel="", title="")
    figure.suptitle(in_plot(asked.title))  # over the whole figure: names of the bars may leave little room
    axes.grid(False, axis="y")


def _map(figure: Figure, asked: Picture, records: Sequence[Row], x: str, y: str, value: str) -> None:
    """Value of a column over two varied keys: `series` names the value here; a cross is a no."""
    records = _placed(records, x, y)
    there = [row for row in records if _number(row, value) is not None]
    axes = figure.add_subplot()
    places = [value_of(row, x) for row in there], [value_of(row, y) for row in there]
    values = [float(value_of(row, value)) for row in there]
    shown = axes.scatter(*places, c=values, cmap="gray_r", edgecolor="black", marker="s", s=60)
    no = [row for row in records if row not in there]
    crosses = [value_of(row, x) for row in no], [value_of(row, y) for row in no]
    axes.plot(*crosses, "x", color="0.4", label="no" if no else None)
    figure.colorbar(shown, label=in_plot(words(value)))
    _finish(axes, asked, x, y)


_SHADES = ("0.9", "0.75", "0.6", "0.45", "0.3")


def _stable(axes: Axes, rows: Sequence[Row], x: str, columns: tuple[str, str], name: str, number: int) -> None:
    """What two columns of lower and upper ends say is stable over x."""
    at = [float(value_of(row, x)) for row in rows]
    low, high = ([value_of(row, end) for row in rows] for end in columns)
    plot_stable_bands(axes, at, low, high, name, STYLES[number % len(STYLES)], _SHADES[number % len(_SHADES)])


def _lag_breaks(figure: Figure, asked: Picture, records: Sequence[Row], x: str) -> None:
    """Stable zeros over the pole, per gain; every edge is exact at each pole, and joined by straight lines."""
    records = _placed(records, x)
    axes = figure.add_subplot()
    highest = max((v for row in records for v in row["outputs"].get("stable_zero_from_Hz", ())), default=100.0)
    for k, (name, rows) in enumerate(_groups(asked, records).items()):
        _stable(axes, rows, x, ("stable_zero_from_Hz", "stable_zero_to_Hz"), name or "stable", k)
    axes.set(xscale="log", yscale="log")
    axes.set_ylim(top=min(1e4, max(1e3, 3 * highest)))
    _finish(axes, asked, x, "zero_frequency_Hz", "lower right")


def _end_masses(figure: Figure, asked: Picture, records: Sequence[Row], x: str) -> None:
    """Stable outer masses over the inner one, and the frequencies at which the loop oscillates at the edges."""
    records = _placed(records, x)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    _stable(upper, records, x, ("stable_from_kg", "stable_to_kg"), "stable", 0)
    crossings: list[tuple[Any, float, bool]] = []
    for row in records:
        listed = (row["outputs"].get(name, ()) for name in ("crossings_kg", "crossing_frequencies_Hz"))
        there = ((mass, frequency) for mass, frequency in zip(*listed, strict=True) if frequency is not None)
        crossings += [(value_of(row, x), frequency, mass < 5) for mass, frequency in there]
    for marker, light, words_of in (("o", True, "below 5 kg on the outer tip"), ("s", False, "at 5 kg and more")):
        points = [(at, frequency) for at, frequency, below in crossings if below is light]
        places = zip(*points, strict=True) if points else ((), ())
        lower.plot(*places, marker, ms=4, color="black", mfc="white", label=f"crossing {words_of}")
    _limit(upper.axhline, asked, "largest payload, {:g} kg")
    _finish(upper, asked, "", "mass_on_the_outer_tip_kg")
    _finish(lower, asked, x, "frequency_Hz")
    lower.set(title="", ylabel="frequency, Hz")
    upper.set_xlabel("")


def _histogram(figure: Figure, asked: Picture, records: Sequence[Row], x: str) -> None:
    values = [value for row in records if (value := _number(row, x)) is not None]
    axes = figure.add_subplot()
    axes.hist(values, bins=min(30, max(5, round(len(values) ** 0.5))), color="0.75", edgecolor="black")
    _limit(axes.axvline, asked)
    _finish(axes, asked, x, "samples")


def _sensitivity(found: Sequence[Mapping[str, Any]]) -> Figure:
    """First-order and total indices of each output, with their half-widths of 95 %."""
    outputs = list(dict.fromkeys(row["output"] for row in found if "total" in row))
    figures = list(dict.fromkeys(row["figure"] for row in found))
    figure = new_figure(height_mm=40 + 8 * len(figures) * max(1, len(outputs)))
    for number, output in enumerate(outputs):
        axes = figure.add_subplot(max(1, len(outputs)), 1, number + 1)
        rows = [row for row in found if row["output"] == output]
        for shift, name, colour in ((-0.2, "first_order", "0.8"), (0.2, "total", "0.4")):
            places, shares = [k + shift for k in range(len(rows))], [row[name] for row in rows]
            bars: dict[str, Any] = {"color": colour, "edgecolor": "black", "label": name.replace("_", "-")}
            widths = [row[f"{name}_half_width"] for row in rows]
            axes.barh(places, shares, 0.38, xerr=None if None in widths else widths, **bars)
        axes.set_yticks(range(len(rows)), [row["figure"] for row in rows], fontsize=7)
        axes.invert_yaxis()
        founded = "roughly sampled" if None in widths else "sampled, bars of 95 %"
        axes.set_xlabel(f"share of the variance of: {words(output)} ({founded})")
        axes.axvline(0, color="black", linewidth=0.8)
        axes.legend()
    return figure


_KINDS: dict[str, tuple[Callable[..., None], float, float]] = {
    "lines": (_lines, 110.0, 0.0),
    "bars": (_bars, 30.0, 9.0),
    "map": (_map, 110.0, 0.0),
    "lag_breaks": (_lag_breaks, 110.0, 0.0),
    "end_masses": (_end_masses, 150.0, 0.0),
    "histogram": (_histogram, 90.0, 0.0),
}
"""What draws each kind of picture, its height, and what each row adds to that, mm."""
