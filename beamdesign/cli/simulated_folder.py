"""The folder of simulated records, for whichever command has simulated them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from beamdesign.cli.output import progress, say
from beamdesign.files import fresh_folder, settled


def write_folder(
    rig: Any, plan: Any, tables: Mapping[str, tuple[tuple[str, ...], Any]], pictures: Sequence[Any], out: Path
) -> dict[str, Any]:
    """Write records, and where there are `pictures` of them these and their page, as one set; files for the answer."""
    from beamdesign.simulate import write_tables

    drawn: dict[str, Any] = {}
    with fresh_folder(out) as fresh:
        files = write_tables(tables, fresh)
        if pictures:
            from beamdesign.report.record_plot import write_record_page

            with progress("drawing"):
                page, figures = write_record_page(rig.name, plan.name, rig.effects, pictures, fresh)
            drawn = {"report": settled(page, fresh, out), "figures": settled(figures, fresh, out)}
    say(f"records: {len(files)} files in {out}")
    if pictures:
        say(f"pictures: {drawn['report']}")
    return {"records": settled(files, fresh, out), **drawn}
