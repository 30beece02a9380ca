"""Opinions of witnesses about the place of a gap, and how they are weighed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from beamdesign.gap.diagnosis import Witness
from beamdesign.rig.effect import SUBSYSTEMS


@dataclass(frozen=True)
class Opinion:
    """What one witness holds.

    Attributes:
        name: of the witness.
        votes: by subsystem, from 0 to 1 in all.
        weight: of this kind of witness against the others.
        text: in words.
        table: for a report.
    """

    name: str
    votes: Mapping[str, float]
    weight: float
    text: str
    table: Mapping[str, tuple[object, ...]] = field(default_factory=dict)

    @property
    def favourite(self) -> str:
        """Where it points; empty where it says nothing, or the same of several places."""
        ranked = sorted(self.votes, key=lambda name: -self.votes[name])
        if not ranked or self.votes[ranked[0]] <= 0:
            return ""
        tied = len(ranked) > 1 and self.votes[ranked[0]] == self.votes[ranked[1]]
        return "" if tied else ranked[0]

    @property
    def witness(self) -> Witness:
        """As a diagnosis records it; its strength is its lead over the second place."""
        ranked = sorted(self.votes.values(), reverse=True)
        lead = ranked[0] - (ranked[1] if len(ranked) > 1 else 0.0) if ranked else 0.0
        return Witness(self.name, self.favourite, min(1.0, max(0.0, lead)), self.text, self.table)


def weighed(opinions: Sequence[Opinion]) -> dict[str, float]:
    """Sum of all votes times weights, by subsystem, largest first."""
    total = {name: sum(o.weight * o.votes.get(name, 0.0) for o in opinions) for name in SUBSYSTEMS}
    return dict(sorted(total.items(), key=lambda item: -item[1]))
