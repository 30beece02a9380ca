"""`beamdesign gap predict`: what a prototype would have recorded under the inputs of a data set."""

from pathlib import Path
from typing import Annotated

import typer

from beamdesign.cli.completion import data_sets, toml_files
from beamdesign.cli.output import JsonOption, folder_to_write, progress, say, say_table, write_json
from beamdesign.files import fresh_folder, settled


def predict(
    prototype: Annotated[
        Path,
        typer.Argument(autocompletion=toml_files, help="The prototype.toml to simulate, with the effects it names."),
    ],
    dataset: Annotated[
        Path,
        typer.Argument(
            autocompletion=data_sets, help="Folder with dataset.toml, the prototype believed and CSV files."
        ),
    ],
    out: Annotated[
        Path, typer.Option(metavar="DIR", callback=folder_to_write, help="Folder for one CSV file per record.")
    ],
    json: JsonOption = None,
) -> None:
    """Predict the records of a data set from its inputs alone.

    Times, forces, commands, end masses and controllers are read; measured columns are not, and may be missing or not
    finite. Displacements are stated as the data set states them: the sensor's volts over the gain believed there. A
    loop that diverges ends its record there, and the exit status is 1.
    """
    from beamdesign.gap.predict import predict_set
    from beamdesign.simulate import write_tables

    with progress("simulating") as update:
        found = predict_set(prototype, dataset, update)
    with fresh_folder(out) as fresh:
        written = write_tables({record.name: (record.columns, record.samples) for record in found}, fresh)
    paths = settled(written, fresh, out)
    column = found[0].columns.index("displacement_m")
    rows = [
        (record.name, len(record.samples), float(abs(record.samples[:, column]).max()), record.reason or "complete")
        for record in found
    ]
    say_table(f"{prototype} under the inputs of {dataset}", ("record", "samples", "peak displacement_m", ""), rows)
    say(f"records: {len(paths)} files in {out}")
    reasons = {record.name: record.reason for record in found if record.reason}
    write_json(json, {"records": paths, "complete": not reasons, "reasons": reasons})
    if reasons:
        raise typer.Exit(1)
