"""`beamdesign paper`: every number of Zalucky and Hardt (1984) recomputed."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from beamdesign.cli.command import CommandResult, OutFolder, command
from beamdesign.cli.output import echo, echo_table, progress, write_json
from beamdesign.files import fresh_folder, settled


@command
def paper(out: OutFolder, figure: Annotated[int | None, typer.Option(metavar="N")] = None) -> CommandResult:
    """Recompute the numbers of Zalucky and Hardt (1984).

    Every number and the figures 8 to 16, the paper's beside the model's; where they disagree, why. What the paper says
    about each figure is checked; --figure N does that for one of them.

    Args:
        out: folder for paper.html, paper.json and figures.
        figure: draw this figure of the paper alone, 8 to 16.
    """
    if figure is not None:
        return _one_figure(figure, out)
    from beamdesign.validation.paper.comparison import CHOICES, compare, write_page

    comparison = compare()
    with progress("drawing") as update, fresh_folder(out) as fresh:
        written = write_page(comparison, fresh, update)
        fields = comparison.fields() | {
            "report": written.page.name,
            "figures": [path.name for path in written.figures],
            "figure_claims": written.checks,
        }
        write_json(fresh / "paper.json", fields)

    echo("Two choices the paper leaves open:")
    for number, choice in enumerate(CHOICES, 1):
        echo(f"  {number}. {choice}")
    echo_table(
        "Critical gain, mA/V",
        ["case", "paper, predicted", "paper, measured", "model", "with 400 Hz filter", "and smaller side"],
        [
            (
                row.case.name, row.case.predicted_mA_per_V, row.case.measured_mA_per_V, row.model_mA_per_V,
                row.varied_mA_per_V["with_filter"], row.varied_mA_per_V["filter_and_smaller_side"],
            )
            for row in comparison.gains
        ],
    )  # fmt: skip
    echo_table(
        "Bandwidth at -100 dB in/lbf, Hz",
        ["case", "gain, mA/V", "paper", "model"],
        [(row.case, row.gain_mA_per_V, row.paper, row.model) for row in comparison.bandwidths],
    )
    differing = [claim for claim in comparison.claims if not claim.agrees]
    echo_table(
        f"{len(differing)} of {len(comparison.claims)} numbers differ",
        ["quantity", "paper", "model", "unit", "verdict"],
        [(claim.quantity, claim.paper, claim.model, claim.unit, claim.verdict) for claim in differing],
    )
    _echo_checks(written.checks)
    echo(f"{len(comparison.slips)} slips of the paper, the reasons and the figures: {out / written.page.name}")
    return CommandResult(fields)


def _one_figure(number: int, out: Path) -> CommandResult:
    from beamdesign.records import InputError
    from beamdesign.report.canvas import save
    from beamdesign.validation.paper.figures import NUMBERED

    if number not in NUMBERED:
        raise InputError("--figure", [(str(number), f"not drawn here; there are {min(NUMBERED)} to {max(NUMBERED)}")])
    drawing = NUMBERED[number]()
    with fresh_folder(out) as fresh:
        pictures = save(drawing.figure, fresh / drawing.name)
    files = settled(pictures, fresh, out)
    echo(drawing.title)
    echo(f"paper: {drawing.claim}")
    echo(f"model: {drawing.caption}")
    _echo_checks(drawing.checks)
    fields = {"figure": number, "title": drawing.title, "figures": files, "claims": drawing.checks}
    return CommandResult(fields, files=files)


def _echo_checks(checks: Sequence[Any]) -> None:
    failing = sum(not check.holds for check in checks)
    echo_table(
        f"{len(checks) - failing} of {len(checks)} claims about the figures hold",
        ["figure", "claim", "paper says", "model says", "holds"],
        [(check.figure, check.claim, check.paper, check.model, "yes" if check.holds else "no") for check in checks],
    )
