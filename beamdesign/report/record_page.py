"""The records of a simulation as pictures and as one self-contained HTML page."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from beamdesign.files import write_whole
from beamdesign.report.canvas import save
from beamdesign.report.quantity import quantity
from beamdesign.report.record_plot import PlottedRecord, peaks, plot_record
from beamdesign.report.svg import inline_svg


def write_record_page(
    title: str,
    scenario: str,
    effects: Mapping[str, Mapping[str, float]],
    records: Sequence[PlottedRecord],
    folder: Path,
) -> tuple[Path, list[Path]]:
    """Draw every record, each to NAME.svg and NAME.png, and the page that shows them all.

    Args:
        title: name of the prototype.
        scenario: its name.
        effects: of the prototype, by name, with the parameters it gives.
        records: in order.
        folder: an existing one; files of the same names are replaced.

    Returns:
        The page, and the pictures.
    """
    files: list[Path] = []
    shown: list[Markup] = []
    rows = []
    for position, record in enumerate(records):
        figure = plot_record(record)
        files += save(figure, folder / record.name)
        words = f"{record.name}: {record.verdict}"
        # The SVG writer escapes what it is given, so its output is markup.
        svg = Markup(inline_svg(figure, f"record{position}", words))
        shown.append(Markup("<figure>{}<figcaption>{}</figcaption></figure>").format(svg, words))
        largest = peaks(record, ("displacement_m", "current_A"))
        rows.append(
            (
                record.name,
                "yes" if record.stable else "no",
                quantity(largest["displacement_m"], "m"),
                f"{1e3 * largest['current_A']:.4g} mA" if "current_A" in largest else "",
                record.verdict,
            )
        )
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    page = folder / "records.html"
    text = environment.get_template("records.html").render(
        title=title,
        scenario=scenario,
        effects={
            name: ", ".join(f"{key} = {figure:g}" for key, figure in given.items()) for name, given in effects.items()
        },
        rows=rows,
        unstable=sum(not record.stable for record in records),
        pictures=list(zip([record.name for record in records], shown, strict=True)),
    )
    write_whole(page, text)
    return page, files
