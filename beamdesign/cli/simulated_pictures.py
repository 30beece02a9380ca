"""Pictures of simulated records, for whichever command has simulated them."""

from pathlib import Path
from typing import Any

from beamdesign.cli.output import progress, say


def drawn_records(rig: Any, plan: Any, records: list[Any], out: Path) -> dict[str, Any]:
    """Draw records and the page that shows them all; gives their files for the answer."""
    from beamdesign.report.record_page import write_record_page

    with progress("drawing"):
        page, pictures = write_record_page(rig.name, plan.name, rig.effects, records, out)
    say(f"pictures: {page}")
    return {"report": page, "figures": pictures}
