"""The Pareto front of moving mass against guaranteed bandwidth against payload range, every point proved."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from beamdesign.design.codesign import Codesign, codesign
from beamdesign.problem import DesignProblem

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Front:
    """Co-designs over a grid of requirements.

    Attributes:
        designs: one per payload range and bandwidth, bandwidths within ranges; those without a point carry the reason.
        colder: how many points fresh samples solved where the solved neighbours had led to no proof.
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
        """The proved designs that no other one beats in mass, bandwidth and payload; one of each that are equal."""
        kept: list[Codesign] = []
        for design in self.proved:
            others = [other for other in self.proved if _merits(other) != _merits(design)]
            beaten = any(_no_worse(other, design) for other in others)
            if not beaten and _merits(design) not in map(_merits, kept):
                kept.append(design)
        return tuple(kept)


def _merits(design: Codesign) -> tuple[float, ...]:
    """Moving mass, guaranteed bandwidth turned round, and the range's ends so that less is better in each."""
    assert design.point is not None
    low, high = design.outer_end_mass_kg
    return design.point.moving_mass_kg, -design.point.proved.bandwidth_Hz, low, -high


def _no_worse(one: Codesign, other: Codesign) -> bool:
    return all(mine <= yours for mine, yours in zip(_merits(one), _merits(other), strict=True))


def _answers(design: Codesign, asked: Codesign) -> bool:
    """Whether a proved design meets what was asked of another one as well."""
    return (
        design.point is not None
        and design.point.proved.bandwidth_Hz >= asked.bandwidth_Hz
        and design.outer_end_mass_kg[0] <= asked.outer_end_mass_kg[0]
        and design.outer_end_mass_kg[1] >= asked.outer_end_mass_kg[1]
    )


def _lightest_answer(asked: Codesign, designs: Sequence[Codesign]) -> Codesign:
    """What was asked with the lightest of all designs that meet it; with its own reason where none does."""
    points = [design.point for design in designs if design.point is not None and _answers(design, asked)]
    if not points:
        return asked
    return replace(asked, point=min(points, key=lambda point: point.moving_mass_kg), reason="")


def pareto_front(
    problem: DesignProblem,
    bandwidths_Hz: Sequence[float],
    ranges_kg: Sequence[tuple[float, float]],
    progress: Progress | None = None,
) -> Front:
    """Co-design along a front, each point starting from its solved neighbours in bandwidth and in payload.

    Where the neighbours lead to no proof, fresh samples are tried; both failures together are the point's reason. Where
    a design found for more bandwidth or payload is lighter, or the only one, it answers what asks for less as well.

    Args:
        problem: as for `codesign`.
        bandwidths_Hz: needed bandwidths.
        ranges_kg: ranges of outer end mass.
        progress: told the share done and what is being done.
    """
    told = progress or (lambda fraction, text: None)
    bandwidths = sorted(set(bandwidths_Hz))
    solved: dict[tuple[int, int], Codesign] = {}
    ranges = list(dict.fromkeys(ranges_kg))
    colder, total = 0, len(ranges) * len(bandwidths)
    for i, masses in enumerate(ranges):
        for k, bandwidth in enumerate(bandwidths):
            told(len(solved) / total, f"{bandwidth:g} Hz over {masses[0]:g} to {masses[1]:g} kg")
            before = [solved.get(key) for key in ((i, k - 1), (i - 1, k))]
            near = [design.point for design in before if design is not None and design.point is not None]
            design = codesign(problem, masses, bandwidth, near)
            if near and design.point is None:
                fresh = codesign(problem, masses, bandwidth)
                colder += fresh.point is not None
                reason = fresh.reason and f"{design.reason}; and from fresh samples: {fresh.reason}"
                design = replace(fresh, reason=reason)
            solved[i, k] = design
    designs = tuple(solved.values())
    return Front(tuple(_lightest_answer(design, designs) for design in designs), colder)
