"""What a task gives for one case."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any


@dataclass(frozen=True)
class Answer:
    """Outputs of one case.

    Attributes:
        outputs: columns of the table by name, with the unit in the name: numbers, texts, yes or no, or lists of them.
        details: what `study why` tells beyond: checks, shadow prices, certificates' words; plain values.
        reason: why the answer is no; empty where it is yes.
    """

    outputs: dict[str, Any]
    details: dict[str, Any] = field(default_factory=dict)
    reason: str = ""


def of_all(answers: Mapping[str, Answer]) -> Answer:
    """The answer of the law that governs, with the outputs of all by their names in the details.

    That is the first whose answer is no, else the one of the least bandwidth. The only one stays as it is.
    """
    worst = min(answers.values(), key=lambda one: (not one.reason, one.outputs.get("bandwidth_Hz") or 0.0))
    if len(answers) == 1:
        return worst
    return replace(worst, details=worst.details | {"stages": {name: one.outputs for name, one in answers.items()}})
