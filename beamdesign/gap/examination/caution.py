"""A named warning about data."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Caution:
    """Something about a data set that whoever reads a verdict on it should know.

    Attributes:
        name: short, for programs: `clipped`, `no_content`, `controller`, ...
        record: name of the record, empty for the set as a whole.
        text: in words, with what to do.
        left_out: whether the record was left out.
        limits_confidence: whether a verdict must not be a confident one.
    """

    name: str
    record: str
    text: str
    left_out: bool = False
    limits_confidence: bool = False

    def __str__(self) -> str:
        out = "; the record was left out" if self.left_out else ""
        return f"{self.record}: {self.text}{out}" if self.record else f"{self.text}{out}"
