"""What a command does of one law, done of each law of a controller that has several."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from beamdesign.cli.output import say, write_json

if TYPE_CHECKING:
    from beamdesign.prototype import InStage, Prototype


def by_stage(
    record: "Prototype",
    masses_kg: tuple[float, float],
    work: "Callable[[InStage], tuple[dict[str, Any], bool]]",
    json: Path | None,
) -> None:
    """Do the work of a command stage by stage, and write its answer; a controller of one law is its only stage.

    The answer is that of the stage that governs: the first whose answer is no, else that of the least guaranteed
    bandwidth. Of several stages those of all stand in it under `stages`.

    Args:
        record: with its controller.
        masses_kg: payloads (least, most), of which each stage gets its own.
        work: gives fields of the answer, and whether it is yes.
        json: file for the answer.

    Raises:
        InputError: where some payloads are for no stage.
        typer.Exit: with status 1 where an answer is no.
    """
    found = [work(stage) for stage in record.stages(masses_kg)]
    if record.schedule is not None:
        say("each stage by itself, while the payload stays in its range; of changes: beamdesign certify-switching")
    write_json(json, of_all(record, found))
    if not all(yes for _, yes in found):
        raise typer.Exit(1)


def of_all(record: "Prototype", found: "list[tuple[dict[str, Any], bool]]") -> dict[str, Any]:
    """The answer of the stage that governs; of several stages with those of all under `stages`."""

    def reached(fields: dict[str, Any]) -> float:
        guaranteed = fields.get("guaranteed")
        return guaranteed["bandwidth_Hz"] if isinstance(guaranteed, dict) else getattr(guaranteed, "bandwidth_Hz", 0.0)

    answer, _ = min(found, key=lambda one: (one[1], reached(one[0])))
    return answer if record.schedule is None else answer | {"stages": [fields for fields, _ in found]}


def beside(path: Path | None, stage: "InStage") -> Path | None:
    """Where a stage's file goes: the path itself where there is one law, else with the stage's number in its name."""
    return path and path.with_suffix(stage.suffix + path.suffix)
