"""`beamdesign paper`: every number of Zalucky and Hardt (1984) recomputed."""

from pathlib import Path
from typing import Annotated

import typer

from beamdesign.cli.output import JsonOption, folder_to_write, progress, say, say_table, write_json


def paper(
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="DIR", callback=folder_to_write, help="Folder for paper.html, paper.json and figures."
        ),
    ],
    json: JsonOption = None,
) -> None:
    """Recompute the numbers of Zalucky and Hardt (1984).

    Every number and the figures 8 to 14, the paper's beside the model's; where they disagree, why.
    """
    from beamdesign.paper.comparison import CHOICES, compare
    from beamdesign.paper.page import write_page

    comparison = compare()
    out.mkdir(parents=True, exist_ok=True)
    with progress("drawing") as update:
        written = write_page(comparison, out, update)
    fields = comparison.fields() | {"report": written.page.name, "figures": [path.name for path in written.figures]}
    write_json(out / "paper.json", fields)
    write_json(json, fields)

    say("Two choices the paper leaves open:")
    for number, choice in enumerate(CHOICES, 1):
        say(f"  {number}. {choice}")
    say_table(
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
    say_table(
        "Bandwidth at -100 dB in/lbf, Hz",
        ["case", "gain, mA/V", "paper", "model"],
        [(row.case, row.gain_mA_per_V, row.paper_Hz, row.model_Hz) for row in comparison.bandwidths],
    )
    differing = [claim for claim in comparison.claims if not claim.agrees]
    say_table(
        f"{len(differing)} of {len(comparison.claims)} numbers differ",
        ["quantity", "paper", "model", "unit", "verdict"],
        [(claim.quantity, claim.paper, claim.model, claim.unit, claim.verdict) for claim in differing],
    )
    say(f"{len(comparison.slips)} slips of the paper, the reasons and the figures: {written.page}")
