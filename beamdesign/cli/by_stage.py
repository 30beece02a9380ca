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
    answer, yes = min(found, key=lambda one: (one[1], getattr(one[0].get("guaranteed"), "bandwidth_Hz", 0.0)))
    if record.schedule is not None:
        say("each stage by itself, while the payload stays in its range; of changes: beamdesign certify-switching")
        answer = answer | {"stages": [fields for fields, _ in found]}
    write_json(json, answer)
    if not yes:
        raise typer.Exit(1)


def beside(path: Path | None, stage: "InStage") -> Path | None:
    """Where a stage's file goes: the path itself where there is one law, else with the stage's number in its name."""
    return path and path.with_suffix(stage.suffix + path.suffix)
