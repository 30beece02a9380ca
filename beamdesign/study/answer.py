"""What a task gives for one case."""

from dataclasses import dataclass, field
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
