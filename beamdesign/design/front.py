"""The Pareto front of moving mass against guaranteed bandwidth against payload range, every point proved."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from beamdesign.design.codesign import Codesign, codesign
from beamdesign.problem import DesignProblem

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Front:
    """Co-designs over a grid of requirements.

    Attributes:
        designs: one per payload range and bandwidth, bandwidths within ranges; those without a point carry the reason.
        colder: how many points were found lighter from fresh samples than from their neighbours.
    """

    designs: tuple[Codesign, ...]
    colder: int

    @property
    def proved(self) -> tuple[Codesign, ...]:
        """Those with a proved design."""
        return tuple(design for design in self.designs if design.point is not None)

    @property
    def failed(self) -> tuple[Codesign, ...]:
        """Those without, each with its reason."""
        return tuple(design for design in self.designs if design.point is None)

    @property
    def efficient(self) -> tuple[Codesign, ...]:
        """The proved designs that no other one beats in mass, bandwidth and payload at once."""

        def beaten(design: Codesign) -> bool:
            return any(_better(other, design) for other in self.proved)

        return tuple(design for design in self.proved if not beaten(design))


def _better(one: Codesign, other: Codesign) -> bool:
    """Whether one design is no worse in every respect and lighter."""
    assert one.point is not None
    assert other.point is not None
    return (
        one.point.proved.bandwidth_Hz >= other.point.proved.bandwidth_Hz
        and one.outer_end_mass_kg[0] <= other.outer_end_mass_kg[0]
        and one.outer_end_mass_kg[1] >= other.outer_end_mass_kg[1]
        and one.point.moving_mass_kg < other.point.moving_mass_kg
    )


def pareto_front(
    problem: DesignProblem,
    bandwidths_Hz: Sequence[float],
    ranges_kg: Sequence[tuple[float, float]],
    progress: Progress | None = None,
) -> Front:
    """Co-design along a front, each point starting from its solved neighbours in bandwidth and in payload.

    Where the neighbours lead to no proof, fresh samples are tried; both failures together are the point's reason. A
    point that is heavier than a more demanding neighbour takes that neighbour's design, which meets it too.

    Args:
        problem: as for `codesign`.
        bandwidths_Hz: needed bandwidths.
        ranges_kg: ranges of outer end mass.
        progress: told the share done and what is being done.
    """
    told = progress or (lambda fraction, text: None)
    bandwidths = sorted(bandwidths_Hz)
    solved: dict[tuple[int, int], Codesign] = {}
    colder, total = 0, len(ranges_kg) * len(bandwidths)
    for i, masses in enumerate(ranges_kg):
        for k, bandwidth in enumerate(bandwidths):
            told(len(solved) / total, f"{bandwidth:g} Hz over {masses[0]:g} to {masses[1]:g} kg")
            before = [solved.get(key) for key in ((i, k - 1), (i - 1, k))]
            near = [design.point for design in before if design is not None and design.point is not None]
            design = codesign(problem, masses, bandwidth, near)
            if near and design.point is None:
                fresh = codesign(problem, masses, bandwidth)
                colder += fresh.point is not None
                design = fresh
            solved[i, k] = design
    return Front(tuple(solved.values()), colder)
