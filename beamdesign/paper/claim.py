"""One number of the paper beside the model's, and whether they agree."""

from dataclasses import dataclass

RELATIVE_AGREEMENT = 0.05
"""Most of the paper's numbers were read off plots; within 5 % the model is said to agree."""


@dataclass(frozen=True)
class Claim:
    """A published number, recomputed.

    Attributes:
        group: what it is about.
        quantity: what it is.
        unit: of both numbers, empty for a count or a ratio.
        paper: the published number.
        model: the recomputed one.
        source: section, table or figure of the paper.
        last_digit: worth of one in the last printed digit, in `unit`; half of it is the rounding of the print.
        note: how the model's number came about, and the reason where the two differ.
    """

    group: str
    quantity: str
    unit: str
    paper: float
    model: float
    source: str
    last_digit: float
    note: str = ""

    @property
    def agrees(self) -> bool:
        """Whether model and print differ by no more than 5 % or the print's rounding, whichever is larger."""
        return bool(abs(self.model - self.paper) <= max(RELATIVE_AGREEMENT * abs(self.paper), 0.5 * self.last_digit))

    @property
    def verdict(self) -> str:
        """Agreement, or by how much the model differs, in words."""
        if self.agrees:
            return "agrees"
        if self.paper == 0:
            return f"differs by {self.model:+.3g} {self.unit}".rstrip()
        ratio = self.model / self.paper
        return (
            f"differs by a factor of {ratio:.3g}" if not 0.5 < ratio < 2 else f"differs by {100 * (ratio - 1):+.1f} %"
        )


@dataclass(frozen=True)
class Slip:
    """A place where the paper contradicts itself, its own data or its drawings.

    Attributes:
        where: section, equation or figure.
        printed: what stands there, in our words.
        read_as: what it is taken for here.
        check: the figures that decide it, recomputed.
    """

    where: str
    printed: str
    read_as: str
    check: str
